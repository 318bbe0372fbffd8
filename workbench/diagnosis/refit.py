"""Models with effects: started from a score test, fitted with everything else, compared by their likelihood.

deviance = sum_k (|W_k e_k|^2 + log det S_k) + prior,    BIC = deviance + (number of sizes, shapes, phases) log N
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from workbench.diagnosis.fit import Fit, Term, Unknowns, _evaluate, gauss_newton, sharpened
from workbench.diagnosis.predictor import Predictor
from workbench.diagnosis.profile import dated
from workbench.diagnosis.screen import Score, Signature, dated_variants, signatures
from workbench.diagnosis.tuning import tuned
from workbench.errors import InputError
from workbench.physics.effects.effect import Domain
from workbench.records import record

CONVERGED = 3.0  # deviance: half of what a cause must be worth
SETTLINGS = 4
CLOSER = 3  # refits that are made at noise levels of their own, at least
FAN = (1.0, 0.5, 1.5, 0.75, 1.25, 0.25, 2.0)
PHASES, AMPLITUDES = 12, (1.0, 2.0, 4.0)  # of a ripple in each record; of its one-step estimate
LATE = (1.0, 3.0, 10.0, 30.0)  # samples: times of a slow sensor that are tried with gains of their own
FEW_SENSORS = 2
PLAY = "backlash@"  # of the sensor whose name follows
VALLEYS, DESCENTS = 3, 6  # of the likelihood over play, that are descended into; steps of that
PLAYS = tuple(np.geomspace(2.0, 400.0, 20))  # of the noise: play that is tried with gains and noise levels of its own
LEFT = np.sqrt(3.0)  # standard deviations of its prior at which a parameter leaves its tolerance
LEVELS = (1.0, 2.0, 0.5)  # of a special case's level, from which a more general law begins
FAR_OFF = 10.0  # deviance a sample from which a start leads nowhere
COLOURED = 0.3  # of a sensor's noise: deviation of its coloured part, before the records are looked at


@record
class Model:
    """A plant with named effects, fitted: predictor with gains and noise levels of its own, and the fit."""

    predictor: Predictor
    fit: Fit

    @property
    def terms(self) -> tuple[Term, ...]:
        return self.fit.unknowns.terms

    @property
    def keys(self) -> tuple[str, ...]:
        return tuple(t.key for t in self.terms)

    def sharpened(self) -> "Model":
        """The same with a Jacobian from which intervals may be stated."""
        return replace(self, fit=sharpened(self.predictor, self.fit))

    @property
    def numbers(self) -> int:
        """How many numbers the effects add: what BIC counts."""
        return sum(t.count(len(self.predictor.records)) for t in self.terms)

    @property
    def farthest(self) -> float:
        """The largest deviation of a parameter from nominal, in standard deviations of what the data sheet leaves open."""
        return float(np.abs(self._theta).max(initial=0.0))

    @property
    def within(self) -> float:
        """What the prior makes of the parameters' deviations from nominal, as far as they are within their tolerance."""
        return float(np.sum(np.minimum(np.abs(self._theta), LEFT) ** 2))

    @property
    def beyond(self) -> float:
        """What the prior makes of the parameters' deviations beyond their tolerance."""
        return float(np.sum(np.maximum(np.abs(self._theta) - LEFT, 0.0) ** 2))

    @cached_property
    def deviance(self) -> float:
        """-2 log likelihood, up to a constant, and what parameters beyond their tolerance cost; inf where a run was lost."""
        value = self.fit.squares + self.beyond + sum(p.log_det for p in self.predictor.passes)
        return value if np.isfinite(value) else np.inf

    @property
    def _theta(self) -> np.ndarray:
        return self.fit.z[: self.fit.unknowns.split[0]]

    @property
    def posterior(self) -> float:
        """The deviance with the prior of the parameters counted in full, within their tolerances too."""
        return self.deviance - self.beyond + float(self._theta @ self._theta)

    @property
    def sound(self) -> bool:
        """Whether its runs along the records last, and tell something: what has no slopes cannot be gone on from."""
        return bool(np.isfinite(self.deviance) and np.isfinite(self.fit.z).all() and np.isfinite(self.fit.information).all())

    @property
    def bic(self) -> float:
        samples = sum(len(r) for r in self.predictor.records)
        return self.deviance + self.numbers * float(np.log(samples))


def lasting(model: Model, plant: str) -> Model:
    """The model as it is. Raises InputError, which names the plant, where its runs along the records are lost or tell nothing."""
    if model.sound:
        return model
    raise InputError(
        "the simulation leaves every range along these records, however it is corrected",
        file=plant,
        mend="check the equation, the units, and the values of the parameters at the records' operating points; of an unstable "
        "machine log what shows that it runs away",
    )


def fitted_shapes(plant, key: str) -> tuple[int, ...]:
    """Shapes that a refit moves: positive ones with a grid; a whole number per turn is scanned, not fitted."""
    return tuple(
        i
        for i, slot in enumerate(plant.slots)
        if slot.key == key
        and slot.parameter.shape
        and slot.parameter.grid
        and slot.parameter.low >= 0.0
        and slot.parameter.unit != "1/turn"
    )


def candidates(model: Model, score: Score, sizes: np.ndarray) -> list[Signature]:
    """The variants worth a start: the two that promise most, of irregular effects by what their own finite size would leave.

    Of an effect with a date all dates of its grid are looked at first: its likelihood has a peak at each.
    """
    dated = dated_variants(model.predictor, score.best.variant)
    if dated:
        return sorted(signatures(model.predictor, model.fit, dated, sizes), key=lambda s: -s.statistic)[:3]
    if np.isnan(score.best.variant.finite):
        return sorted(score.all, key=lambda s: -s.statistic)[:2]
    return sorted(score.all, key=lambda s: 2.0 * s.b[0] + s.S[0, 0])[:3]


def start(model: Model, signature: Signature) -> tuple[Unknowns, list[np.ndarray]]:
    """Unknowns with the effect of a signature as a new term, and a fan of first guesses along its one-step estimate."""
    old, v = model.fit.unknowns, signature.variant
    plant = old.plant
    base = old.base.copy()
    for slot, value in v.shapes:
        base[slot] = value
    free = fitted_shapes(plant, v.key)
    new = Term(v.key, v.sizes, tuple(slot for slot, _ in v.shapes), free, v.phase)
    unknowns = replace(old, terms=(*old.terms, new), base=base)
    irregular = not np.isnan(v.finite)
    move = np.ones(1) if irregular else signature.size / signature.scale
    guesses = []
    for share in FAN:
        delta = share * move
        sizes = delta * signature.scale
        turns = np.zeros(0)
        if v.phase:
            by_record = sizes[0::2] + 1j * sizes[1::2]
            amplitude = np.sqrt(np.mean(np.abs(by_record) ** 2))
            turns = np.angle(by_record[1:] / by_record[0])
            first = amplitude * by_record[0] / abs(by_record[0])
            sizes = np.array([first.real, first.imag])
        own = np.concatenate([sizes, np.zeros(len(free)), turns])
        guesses.append(unknowns.clip(np.concatenate([model.fit.z - signature.weights @ delta, own])))
    return unknowns, guesses


def _all_round(model: Model, unknowns: Unknowns, guess: np.ndarray) -> list[np.ndarray]:
    """Guesses of the last term, a periodic one, with the likeliest of PHASES phases in each record, for several amplitudes.

    A filter whose noise has taken in a large ripple halves its one-step estimate and turns it, and likelihoods over a phase have
    more than one peak.
    """
    own, found = unknowns.places[-1].start, []
    turns = own + 2 + len(unknowns.terms[-1].free)
    amplitude = float(np.hypot(*guess[own : own + 2]))
    phases = 2.0 * np.pi / PHASES * np.arange(PHASES)
    for share in AMPLITUDES:
        z = np.tile(np.concatenate([model.fit.z, np.zeros(len(guess) - own)]), (PHASES, 1))
        z[:, own : own + 2] = share * amplitude * np.column_stack([np.cos(phases), np.sin(phases)])
        tried = _evaluate(model.predictor, unknowns, list(z), model.fit.jacobian)
        squares = np.nan_to_num([[np.sum(e**2) for e in f.errors] for f in tried], nan=np.inf)
        best = squares.argmin(axis=0)
        z[best[0], turns:] = phases[best[1:]] - phases[best[0]]
        found.append(unknowns.clip(z[best[0]]))
    return found


def refits(model: Model, found: Sequence[Score], sizes: np.ndarray) -> list[tuple[Model, Score]]:
    """The model with the effect of each score added, best first: fitted, the more promising ones at noise levels of their own."""
    quick = [(*_refit(model, score, sizes), score) for score in found]
    best = max(model.bic - fitted.bic for fitted, _, _ in quick)
    done = []
    for rank, (fitted, start, score) in enumerate(sorted(quick, key=lambda item: item[0].bic)):
        if rank < CLOSER or model.bic - fitted.bic > 0.5 * best:
            # a start that was found with gains of its own keeps them: those of the model know nothing of a sensor's memory
            lent = fitted.predictor if start is fitted.fit else model.predictor
            fitted = min((fitted, _at_own_noise(lent, start, sizes)), key=lambda m: m.bic)
        done.append((fitted, score))
    return sorted(done, key=lambda item: item[0].bic)


def refit(model: Model, score: Score, sizes: np.ndarray) -> Model:
    """The model with the effect of a score added."""
    return refits(model, [score], sizes)[0][0]


def _refit(model: Model, score: Score, sizes: np.ndarray) -> tuple[Model, Fit]:
    """A fit with the effect of a score at the model's noise levels, and the best start of all its variants that it came from."""
    best: Fit | None = None
    for signature in candidates(model, score, sizes):
        unknowns, guesses = start(model, signature)
        if signature.variant.phase:
            guesses += _all_round(model, unknowns, guesses[0])
        J = model.fit.jacobian  # stands in until the fit makes its own
        tried = min(_evaluate(model.predictor, unknowns, guesses, J), key=lambda f: f.cost)
        if best is None or tried.cost < best.cost:
            best = tried
    assert best is not None
    unknowns = best.unknowns

    def fit(z: np.ndarray) -> Model:
        return Model(model.predictor, gauss_newton(model.predictor, unknowns, z, sizes, rounds=1, chords=4, enough=0.5))

    fitted = fit(best.z)
    if not fitted.deviance < model.deviance:  # from an estimate that is far off; nothing of the effect does no harm
        none = fit(unknowns.clip(np.concatenate([model.fit.z, np.zeros(len(best.z) - len(model.fit.z))])))
        fitted, best = (none, none.fit) if none.deviance < fitted.deviance else (fitted, best)
    if is_late(model.predictor, score.key):
        other = _from_late(model, best, sizes)
    else:
        few = np.sum(model.predictor.measured) <= FEW_SENSORS
        other = _from_play(model, best, sizes) if few and score.key.startswith(PLAY) else None
    return (other, other.fit) if other and other.bic < fitted.bic else (fitted, best)


def from_special(special: Model, model: Model, score: Score, sizes: np.ndarray) -> Model:
    """The model with the law of `score`, from where a special case of it ended and at its noise levels, over all its shapes.

    From a linear start a law with a shape may end behind the law that it includes. The last term of `special` is that one.
    """
    key, old, slots = special.keys[-1], special.fit.unknowns, model.predictor.plant.slots
    shapes = {q.parameter.name: special.fit.point.eta[0, i] for i, q in enumerate(slots) if q.key == key}
    level = old.of_terms(special.fit.z)[-1][0]
    best: Fit | None = None
    for signature in score.all:
        unknowns, guesses = start(model, signature)
        base = unknowns.base.copy()
        for slot in unknowns.terms[-1].free:
            base[slot] = shapes.get(slots[slot].parameter.name, base[slot])
        unknowns = replace(unknowns, base=base)
        head, own = len(model.fit.z), unknowns.places[-1].start
        z = np.tile(guesses[0], (len(LEVELS), 1))
        z[:, :head] = special.fit.z[:head]
        z[:, own:] = 0.0
        z[:, own : own + len(unknowns.terms[-1].sizes)] = level * np.array(LEVELS)[:, None]
        tried = min(_evaluate(special.predictor, unknowns, list(z), special.fit.jacobian), key=lambda f: f.cost)
        if best is None or tried.cost < best.cost:
            best = tried
    assert best is not None
    return Model(special.predictor, gauss_newton(special.predictor, best.unknowns, best.z, sizes, rounds=3, enough=0.5))


def is_late(predictor: Predictor, key: str) -> bool:
    """Whether an effect is a slow sensor that a filter may follow, so that next to nothing of it is left in the errors.

    Where there are more sensors the others contradict it.
    """
    effect = next(slot.effect for slot in predictor.plant.slots if slot.key == key)
    return effect.domain is Domain.SHIFT and effect.memories > 0 and np.sum(predictor.measured) <= FEW_SENSORS


def _from_late(model: Model, start: Fit, sizes: np.ndarray) -> Model | None:
    """A fit of a late sensor from times far above the sample time, with gains that know of them; None where all are far off.

    It begins at the model's parameters, and at those of the data sheet where one of them has left its tolerance: it may have
    made up for the sensor.
    """
    heads = [model.fit.z]
    if model.farthest > LEFT:
        heads.append(np.where(np.arange(len(model.fit.z)) < model.fit.unknowns.split[0], 0.0, model.fit.z))
    found = [fitted for head in heads if (fitted := _from_times(model, start, head, sizes))]
    return min(found, key=lambda m: m.bic, default=None)


def _from_times(model: Model, start: Fit, head: np.ndarray, sizes: np.ndarray) -> Model | None:
    """The best of the fits from the times LATE, all other unknowns at `head`; a start that is far off may end closest.

    Each time begins with the gains of the one before: those of a filter without a memory would run away.
    """
    unknowns, plant, predictor = start.unknowns, model.predictor.plant, model.predictor
    at, best = unknowns.places[-1].start, None
    for samples in LATE:
        z = start.z.copy()
        z[:at], z[at] = head, samples * plant.dt
        predictor = predictor.regained(unknowns.point(z))
        tried = _evaluate(predictor, unknowns, [z], start.jacobian)[0]
        if not Model(predictor, tried).deviance < model.deviance + FAR_OFF * predictor.samples:
            break
        fitted = Model(predictor, gauss_newton(predictor, unknowns, z, sizes, rounds=2, chords=4, enough=0.5))
        best = min((best or fitted, fitted), key=lambda m: m.deviance)
    return best


def _from_play(model: Model, start: Fit, sizes: np.ndarray) -> Model:
    """A fit of the play of a sensor from the likeliest of PLAYS, each with gains and noise levels of its own.

    Noise levels of the model without it have taken it for pushes, and for a colour of the readings: at these a play far above the
    noise is no likelier than none.
    """
    unknowns = start.unknowns
    at, place = unknowns.places[-1].start, unknowns.terms[-1].key.partition("@")[2]
    j, levels = model.predictor.plant.output_names.index(place), model.predictor.noise
    white = np.hypot(levels.measurement, levels.coloured) if len(levels.coloured) else levels.measurement
    bare, noise = replace(model.predictor, expected=replace(model.predictor.expected, coloured=np.empty(0))), white[j]
    bare = bare.regained(model.fit.point, replace(levels, measurement=white, coloured=np.empty(0)))
    tried: list[Model] = []
    for play in PLAYS:
        z = start.z.copy()
        z[:at], z[at] = model.fit.z, play * noise
        predictor = (tried[-1].predictor if tried else bare).regained(unknowns.point(z))
        predictor = predictor.with_noise(tuned(predictor, share=0.5))
        tried.append(Model(predictor, _evaluate(predictor, unknowns, [z], start.jacobian)[0]))
    cost = [np.inf, *(m.deviance for m in tried), np.inf]
    valleys = [m for m, left, own, right in zip(tried, cost, cost[1:], cost[2:], strict=False) if own <= min(left, right)]
    deepest = sorted(valleys, key=lambda m: m.deviance)[:VALLEYS]
    return min((_descended(m, sizes) for m in deepest), key=lambda m: m.bic, default=model)


def _descended(model: Model, sizes: np.ndarray) -> Model:
    """The model at noise levels of its own, again and again: a filter whose levels know of an effect shows it better."""
    model = _at_own_noise(model.predictor, model.fit, sizes)
    for _ in range(DESCENTS):
        better = _at_own_noise(model.predictor, model.fit, sizes)
        if not better.bic < model.bic - CONVERGED:
            break
        model = better
    return model


def _at_own_noise(predictor: Predictor, at: Fit, sizes: np.ndarray) -> Model:
    """A fit from the point of another, with gains and noise levels made there.

    The filter of a model without an effect neither carries what the effect remembers nor has noise levels that suit it.
    """
    predictor = predictor.regained(at.point)
    predictor = predictor.with_noise(tuned(predictor, share=0.5))
    return Model(predictor, gauss_newton(predictor, at.unknowns, at.z, sizes, rounds=3, chords=4, enough=0.5))


def settled(model: Model, sizes: np.ndarray, beside: Model | None = None) -> Model:
    """The model with gains and noise levels of its own, fitted to convergence: as long as that gains more than CONVERGED.

    beside: another model of these records, which is begun from too; see `begun_beside`.
    """
    model = begun_beside(model, beside, sizes) if beside else model
    z = dated(model.predictor, model.fit)
    if not np.array_equal(z, model.fit.z):
        moved = Model(model.predictor, gauss_newton(model.predictor, model.fit.unknowns, z, sizes, enough=0.2))
        model = min((model, moved), key=lambda m: m.deviance)
    for settling in range(SETTLINGS):
        unknowns, z = model.fit.unknowns.recentred(model.fit.z)
        predictor = model.predictor.regained(model.fit.point)
        predictor = predictor.with_noise(tuned(predictor, again=settling > 0)).finer()
        fit = gauss_newton(predictor, unknowns, z, sizes, enough=0.2)
        better = Model(replace(predictor, point=fit.point), fit)
        finer, gained = predictor.substeps > model.predictor.substeps, model.deviance - better.deviance
        model = better if finer or gained > 0.0 else model
        if gained < CONVERGED and not finer:
            break
    return model


def stepped(model: Model, substeps: int, sizes: np.ndarray) -> Model:
    """The model with no fewer integrator steps a sample than this, settled: what is compared is integrated alike.

    A fit makes up for steps that are too long as it does for an effect.
    """
    if model.predictor.substeps >= substeps:
        return model
    predictor, fit = replace(model.predictor, substeps=substeps), model.fit
    return settled(Model(predictor, gauss_newton(predictor, fit.unknowns, fit.z, sizes, enough=0.2)), sizes)


def begun_beside(model: Model, other: Model, sizes: np.ndarray) -> Model:
    """The best of the model as it is, fitted again at the noise levels of another one, and there from its parameters and starts.

    What looks alike must not differ by the way that a fit took: at levels that were tuned while a law did not fit yet, it may
    stay where it is.
    """
    own, unknowns, tried = model.fit.z, model.fit.unknowns, [model]
    head = unknowns.size - unknowns.split[2]
    for z in (own, np.concatenate([other.fit.z[:head], own[head:]])):
        predictor = model.predictor.regained(unknowns.point(z)).with_noise(other.predictor.noise)
        tried.append(Model(predictor, gauss_newton(predictor, unknowns, z, sizes, enough=0.2)))
    return min(tried, key=lambda m: m.deviance)


def with_coloured_noise(model: Model, sizes: np.ndarray) -> Model:
    """The model with a coloured part in the noise of its sensors; see Noise. Begins with what is expected of one."""
    predictor = model.predictor
    expected = replace(predictor.expected, coloured=COLOURED * predictor.expected.measurement)
    fresh = 1.0 - expected.decays(predictor.plant.dt)[-1] ** 2  # share of its variance that is new in every sample
    expected = replace(expected, coloured=np.sqrt(fresh) * expected.coloured)
    noise = replace(predictor.noise, coloured=expected.coloured, correlation_time=expected.correlation_time)
    return settled(replace(model, predictor=replace(predictor, expected=expected).regained(model.fit.point, noise)), sizes)


def without(model: Model, key: str, sizes: np.ndarray) -> Model:
    """The model without one of its effects, fitted again."""
    old = model.fit.unknowns
    keep = [j for j, t in enumerate(old.terms) if t.key != key]
    terms = tuple(old.terms[j] for j in keep)
    parts = old.of_terms(model.fit.z)
    head = model.fit.z[: old.size - old.split[2]]
    unknowns = replace(old, terms=terms)
    z = np.concatenate([head, *(parts[j] for j in keep)])
    return Model(model.predictor, gauss_newton(model.predictor, unknowns, z, sizes, rounds=3, enough=0.2))


def shortlist(found: Sequence[Score], *, share: float = 0.2, most: int = 6) -> list[Score]:
    """The effects whose statistic is at least `share` of the best, at most `most`."""
    return [s for s in found if s.statistic > share * found[0].statistic][:most]
