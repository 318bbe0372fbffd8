"""The experiment that would decide between two causes, from what the two fitted models predict of it [1].

    lambda = min_x  sum_runs |V^-1/2 (d + J x)|^2 + x' C^-1 x,    d = e_rival - e_cause along a run of the model with the cause

e are whitened one-step errors, J what the rival's parameters and sizes x do to them, C the covariance that the records already
made leave to x, V = I + what the unknown start of a run adds. lambda is the expected gain in twice the log-likelihood of the
cause over its rival, both fitted to old and new records together; its variance is 4 lambda. The two are also taken the other way
round, for it may be the rival that is true. A tie is resolved where the gap in BIC, from what it is now, gets beyond ENOUGH:

    P = Phi((lambda + gap - ENOUGH) / (2 sqrt(lambda))),    weighted with the odds of the two

Causes may be declared a tie at any gap: one beyond ENOUGH counts as ENOUGH there, for a run that shows nothing resolves nothing.

A rival with a shape (a speed at which it fades, a date) may mimic a cause from far off where it was fitted: before a template is
recommended, lambda is taken over other shapes too, each with what it costs in the records already made.

[1] G. E. P. Box, W. J. Hill, "Discrimination among mechanistic models", Technometrics 9(1), 1967.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from workbench.data import Dataset, Experiment
from workbench.diagnosis.answer import NextExperiment
from workbench.diagnosis.fit import Unknowns, gauss_newton, jacobian
from workbench.diagnosis.normal import solve
from workbench.diagnosis.predictor import Point, predictor
from workbench.diagnosis.refit import Model
from workbench.errors import InputError
from workbench.physics.controller import Controller
from workbench.physics.parameters import EffectSizes
from workbench.physics.plant import Plant
from workbench.records import field, record
from workbench.simulation import Scenario, simulate

ENOUGH = 10.0  # gap in BIC from which rivals are no tie
SURE = 0.9  # probability of that from which an experiment is recommended
MOST = 8  # runs of one template
RARE = 0.03  # probability of a rival up to which nobody asks what a run would show if it were true
BEYOND = 0.25  # of the span of an output in the records, by which a run may leave it
FACTORS = (0.05, 0.3, 3.0, 20.0)  # of a shape, where it is held otherwise
RAN_AWAY = 1e6  # whitened error of a model that does not follow the run at all
STEP = 0.1  # of a size's standard deviation, for differences
ANY_PHASE = 10.0  # standard deviations, in amplitudes, of an effect whose phase a new record does not know


@record
class Template:
    """An experiment that the machine could run: a loop and the set-points or inputs it follows, by name (N,).

    record: a run of it that was measured, along which it is judged; where there is none it is simulated under the controller.
    """

    name: str
    controller: Controller | None
    references: Mapping[str, np.ndarray]
    record: Experiment | None = None

    def __len__(self) -> int:
        return len(next(iter(self.references.values())))

    def run(self, model: Model) -> Experiment:
        """A record of it, if the model is true. Raises InputError for one that the plant cannot make."""
        if self.record is not None or self.controller is None:
            if self.record is None:
                raise InputError("an experiment without a controller", file=self.name, mend="give a record of it")
            return self.record
        plant = model.predictor.plant
        parameters = {q.name: float(v) for q, v in zip(plant.parameters, model.fit.point.p, strict=True)}
        scenario = Scenario(self.name, self.references, seed=0)
        return simulate(plant, self.controller, scenario, parameters=parameters, effects=_sizes(model)).experiment


def proposable(plant: Plant, templates: Sequence[Template], records: Dataset) -> tuple[Template, ...]:
    """Tests to run next: those of `templates` that are sampled like the records, and each record once more."""
    alike = [own for own in templates if not own.controller or abs(own.controller.dt - records.dt) < 1e-9 * records.dt]
    return (*alike, *(once_more(plant, e) for e in records))


def once_more(plant: Plant, made: Experiment) -> Template:
    """A measured record made once more, under the loop that it was made in: nobody needs to know that loop.

    It follows the record's set-points, and the inputs that no loop commands; without set-points, its inputs.
    """
    set_points = [c.name for c in made.channels if c.role == "reference"]
    inputs = [name for name in plant.input_names if name in made.names]
    free = [name for name in inputs if name not in plant.commanded] if set_points else inputs
    return Template(f"{made.name} once more", None, {name: made[name] for name in (*set_points, *free)}, made)


@record
class Foreseen:
    """What a run tells two models apart by, the one true and the other its rival: a Gaussian problem without the run's start.

    whole: d' V^-1 d; pull (n): R' J' V^-1 d; info (n, n): R' J' V^-1 J R, with C = R R'.
    """

    whole: float
    pull: np.ndarray = field("n")
    info: np.ndarray = field("n n")

    def gain(self, runs: int) -> float:
        """lambda of the module for so many runs."""
        left = solve(np.eye(len(self.pull)) + runs * self.info, self.pull)
        return max(runs * self.whole - runs**2 * float(self.pull @ left), 0.0)


@record
class Mimicry:
    """What a run tells a true model from its rival by, in whatever way the rival may mimic it.

    excess (m): what each way costs the rival in the records already made, in twice the log-likelihood.
    """

    ways: tuple[Foreseen, ...]
    excess: np.ndarray = field("m")

    def gain(self, runs: int) -> float:
        """lambda of the module for so many runs, of the best way."""
        return min(way.gain(runs) + float(more) for way, more in zip(self.ways, self.excess, strict=True))


@record
class Prospect:
    """What a run should do to a tie with a gap in BIC: `forth` if the cause is true, `back` if its rival is.

    back is None where the rival is too unlikely to be looked at (RARE): then it is taken to show nothing.
    """

    gap: float
    forth: Mimicry
    back: Mimicry | None

    def gains(self, runs: int) -> tuple[float, float]:
        return self.forth.gain(runs), self.back.gain(runs) if self.back else 0.0

    def expected(self, runs: int) -> float:
        """Mean of lambda over the odds."""
        odds = odds_of(self.gap)
        return float(np.dot((odds, 1.0 - odds), self.gains(runs)))

    @property
    def runs(self) -> int | None:
        """The fewest runs that are SURE to resolve the tie, None where MOST are not."""
        return next((n for n in range(1, MOST + 1) if resolved(self.gap, *self.gains(n)) >= SURE), None)


def deciding(
    model: Model, rival: Model, names: tuple[str, str], templates: Sequence[Template], separates: str
) -> NextExperiment | None:
    """The template, and how many runs of it, that tell the cause in `model` from that in `rival` in the shortest time.

    Where none is SURE to, what else could (`separates`), also where the plant can run none, or none stays where the machine has
    been seen. None without templates. `expected` is lambda of one run, its mean over the odds, of every template that can be run;
    with other shapes of the rival where they were looked at, which never makes it more.
    """
    if not templates:
        return None
    (own, other), dt = names, model.predictor.plant.dt
    expected, promising = {}, []
    for template in templates:
        try:
            if not _within_reach(model, template.run(model)):
                continue
            found = prospect([model], [rival], template)
        except InputError:
            continue  # a run that the plant cannot make with these parameters
        expected[template.name] = found.expected(1)
        if found.runs:
            promising.append((found.runs * len(template), template))
    chosen = _shortest(_either_way(model, rival, names) if promising else ([model], [rival]), promising, expected)
    if chosen is None:
        why = "" if expected else ": none can be run and stays where the machine has been seen"
        return NextExperiment(f"no experiment of the plan tells {own} from {other}{why}. {separates}", {}, dt, expected)
    sentence = (
        f"{own} and {other} explain these records alike; {'one run' if chosen.runs == 1 else f'{chosen.runs} runs'} of "
        f"{chosen.template.name!r} would decide (expected evidence {chosen.evidence:.0f}, {ENOUGH:.0f} is enough)"
    )
    return NextExperiment(sentence, dict(chosen.template.references), dt, expected, chosen.runs)


@record
class _Choice:
    """A template, how many runs of it decide, and lambda of so many."""

    template: Template
    runs: int
    evidence: float

    @property
    def samples(self) -> int:
        return self.runs * len(self.template)


def _either_way(model: Model, rival: Model, names: tuple[str, str]) -> tuple[list[Model], list[Model]]:
    """The two models, each with its other shapes; those of the cause only where the rival may be true."""
    likely = 1.0 - odds_of(rival.bic - model.bic) > RARE
    return otherwise(model, names[0]) if likely else [model], otherwise(rival, names[1])


def _shortest(
    ways: tuple[list[Model], list[Model]], promising: Sequence[tuple[int, Template]], expected: dict[str, float]
) -> _Choice | None:
    """The choice of the fewest samples among templates that decide with these ways too, None where none does.

    promising: with the samples that would do without other shapes, which are never more than with them: the search ends at a
    template that promises no less than what is found. What is looked at is written into `expected`.
    """
    best = None
    for samples, template in sorted(promising, key=lambda pair: pair[0]):
        if best and best.samples <= samples:
            break
        found = prospect(*ways, template)
        expected[template.name] = found.expected(1)
        if (runs := found.runs) and not (best and best.samples <= runs * len(template)):
            best = _Choice(template, runs, found.expected(runs))
    return best


def _within_reach(model: Model, run: Experiment) -> bool:
    """Whether a run stays where the records have been, but for BEYOND of that span: there may be a stop where none has been."""
    for j, name in enumerate(model.predictor.plant.output_names):
        seen = np.concatenate([r.y[:, j] for r in model.predictor.records])
        if np.isfinite(seen).any() and name in run.names:
            low, high = np.nanmin(seen), np.nanmax(seen)
            room = BEYOND * (high - low)
            if run[name].min() < low - room or run[name].max() > high + room:
                return False
    return True


def prospect(own: Sequence[Model], other: Sequence[Model], template: Template) -> Prospect:
    """See Prospect; a model as it was fitted, and otherwise. Raises InputError where the plant cannot make the run."""
    gap = other[0].bic - own[0].bic
    back = mimicry(other[0], own, template) if 1.0 - odds_of(gap) > RARE else None
    return Prospect(gap, mimicry(own[0], other, template), back)


def odds_of(gap: float) -> float:
    """Probability of a cause whose rival lies behind by a gap in BIC."""
    return float(1.0 / (1.0 + np.exp(-0.5 * np.clip(gap, -50.0, 50.0))))


def otherwise(model: Model, key: str) -> list[Model]:
    """The model, and the model with each shape of its effect `key` held elsewhere and all else fitted again to its records."""
    fit, old = model.fit, model.fit.unknowns
    found, sizes = [model], _steps(model)
    for i, (t, own) in enumerate(zip(old.terms, old.places, strict=True)):
        for j, slot in enumerate(t.free if t.key == key else ()):
            place, p = own.start + len(t.sizes) + j, old.plant.slots[slot].parameter
            for factor in FACTORS:
                base = old.base.copy()
                base[slot] = np.clip(base[slot] * np.exp(fit.z[place]) * factor, p.low, p.high)
                terms = list(old.terms)
                terms[i] = replace(t, free=tuple(s for s in t.free if s != slot))
                held = replace(old, terms=tuple(terms), base=base)
                made = gauss_newton(model.predictor, held, np.delete(fit.z, place), sizes, rounds=2, enough=0.5)
                found.append(Model(model.predictor, made))
    return found


def mimicry(true: Model, ways: Sequence[Model], template: Template) -> Mimicry:
    """See Mimicry; ways: the rival as it was fitted, and otherwise. Raises InputError where no way follows the run."""
    run, found, excess, fault = template.run(true), [], [], None
    for way in ways:
        try:
            found.append(foreseen(true, way, run))
            excess.append(max(way.deviance - ways[0].deviance, 0.0))
        except InputError as reason:
            fault = reason
    if fault and not found:
        raise fault
    return Mimicry(tuple(found), np.array(excess))


def resolved(gap: float, forth: float, back: float) -> float:
    """Probability that a tie of this gap is none afterwards: lambda is `forth` if the cause is true, `back` if its rival is.

    A gap beyond ENOUGH is taken as ENOUGH: it was declared a tie as it is. Without evidence that is 1/2 at most.
    """
    tie = float(np.clip(gap, -ENOUGH, ENOUGH))
    sure = [ndtr((gain + side - ENOUGH) / (2.0 * np.sqrt(max(gain, 1e-12)))) for gain, side in ((forth, tie), (back, -tie))]
    return float(np.dot((odds_of(gap), 1.0 - odds_of(gap)), sure))


def foreseen(true: Model, rival: Model, run: Experiment) -> Foreseen:
    """What a run would show if `true` is what it is called. Raises InputError where the rival does not follow it at all."""
    plant, at = true.predictor.plant, true.fit.point
    made = predictor(plant, Dataset((run.select([name for name in run.names if name in _logged(true)]),)))
    start, scale = (np.array([getattr(r, name) for r in made.records]) for name in ("start", "scale"))
    made = made.regained(Point(at.p, at.eta[:1], start), true.predictor.noise)
    open_ = _open(rival, start, scale)
    other = open_.unknowns.point(open_.z)
    e = made.errors(0, np.array([at.p, other.p]), np.array([at.eta[0], other.eta[0]]), start)
    d = (e[1] - e[0]).ravel()
    if not np.abs(d).max() < RAN_AWAY:
        raise InputError(f"{', '.join(rival.keys)} does not follow the run", file=run.name)
    _, (J,) = jacobian(made, open_.unknowns, open_.z, open_.steps)
    own, shared = J @ open_.of_the_run, J @ open_.shared
    inner = solve(np.eye(own.shape[1]) + own.T @ own, (own.T @ np.column_stack([d, shared])).T).T
    both = np.column_stack([d, shared]) - own @ inner  # V^-1 times d and J R
    return Foreseen(float(d @ both[:, 0]), shared.T @ both[:, 0], shared.T @ both[:, 1:])


def _logged(model: Model) -> set[str]:
    """Names of the inputs, and of the outputs that the records of a model hold."""
    plant = model.predictor.plant
    seen = [name for name, measured in zip(plant.output_names, model.predictor.measured, strict=True) if measured]
    return {*plant.input_names, *seen}


@record
class _Open:
    """What a model's records leave open for a further one: its unknowns z, roots of their covariance, steps of sizes (ne).

    shared (n, s): of what all further runs have in common; of_the_run (n, r): of starts, and of what has a phase.
    """

    unknowns: Unknowns
    z: np.ndarray = field("n")
    shared: np.ndarray = field("n s")
    of_the_run: np.ndarray = field("n r")
    steps: np.ndarray = field("ne")


def _open(model: Model, start: np.ndarray, scale: np.ndarray) -> _Open:
    """start, scale (1, nx): where the further record begins and how far off that may be."""
    fit, old = model.fit, model.fit.unknowns
    n, nx, _ = old.split
    places, phases, at = [*range(n)], [], n + old.records * nx
    for t in old.terms:
        if t.phase:
            phases += range(len(places), len(places) + len(t.sizes))
        places += range(at, at + t.count(1))
        at += t.count(old.records)
    new = replace(old, records=1, start=start, scale=scale)
    z = np.insert(fit.z[places], n, np.zeros(nx))
    value, vector = np.linalg.eigh(fit.covariance[np.ix_(places, places)])
    shared = np.insert(vector * np.sqrt(np.maximum(value, 0.0)), n, np.zeros((nx, len(places))), axis=0)
    known = np.eye(new.size)
    at = [j + nx for j in phases]
    of_the_run = np.hstack([known[:, n : n + nx], ANY_PHASE * np.linalg.norm(z[at]) * known[:, at]])
    return _Open(new, z, shared, of_the_run, _steps(model))


def _steps(model: Model) -> np.ndarray:
    """Steps (ne) of the effects' sizes for differences."""
    fit, unknowns = model.fit, model.fit.unknowns
    steps = np.zeros(len(unknowns.plant.slots))
    for t, own in zip(unknowns.terms, unknowns.places, strict=True):
        steps[list(t.sizes)] = STEP * np.sqrt(np.diag(fit.covariance)[own.start : own.start + len(t.sizes)])
    return steps


def _sizes(model: Model) -> EffectSizes:
    plant, eta = model.predictor.plant, model.fit.point.eta[0]
    return {
        key: {slot.parameter.name: float(eta[i]) for i, slot in enumerate(plant.slots) if slot.key == key} for key in model.keys
    }
