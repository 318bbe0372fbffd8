"""Diagnosis: what a simulation gets wrong about measured records, its cause, its size, and what naming it gains.

recalibrate -> screen -> refit -> confirm -> extend, again while something is found -> drop and swap -> remainder -> answer
"""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from workbench.data import Dataset
from workbench.diagnosis.answer import (
    ROUNDED,
    Cause,
    Diagnosis,
    Estimate,
    Evidence,
    Finding,
    Limit,
    NextExperiment,
    Remainder,
    Untestable,
)
from workbench.diagnosis.check import check
from workbench.diagnosis.confirm import folds, left_out, stability
from workbench.diagnosis.equations import Law, instead
from workbench.diagnosis.experiments import Template, deciding
from workbench.diagnosis.fit import gauss_newton
from workbench.diagnosis.free_run import filtered, simulated
from workbench.diagnosis.gains import ahead
from workbench.diagnosis.lags import FAR, timed
from workbench.diagnosis.predictor import Noise, predictor
from workbench.diagnosis.profile import profile, rough
from workbench.diagnosis.recalibrate import recalibrated
from workbench.diagnosis.referee import Judge, as_given, harms, helps, worse
from workbench.diagnosis.refit import (
    LEFT,
    Model,
    from_special,
    is_late,
    lasting,
    refits,
    settled,
    shortlist,
    with_coloured_noise,
    without,
)
from workbench.diagnosis.remainder import Left, label, remainder
from workbench.diagnosis.rounding import Rounded, limit, rounded
from workbench.diagnosis.screen import SIGNIFICANT, Score, Signature, scores, signatures, similarity, small_sizes, variants
from workbench.physics.effects.effect import Domain
from workbench.physics.plant import EffectSizes, Plant, Slot
from workbench.records import record

ALPHA = SIGNIFICANT  # family-wise, of the screen and of the remainder where nothing is named
LEFT_OVER = 1e-4  # the same, where something is named
WORTH = 6.0  # BIC by which a cause must be better
TIE, IDEAL = 10.0, 0.1  # BIC within which rivals are a tie; or share of a cause's gain, for laws of friction are idealised
ONE_STEP = 0.5  # share of a cause's gain that a law may be worse by after one step, and tie when it is fitted
KNOWN = 0.05  # standard deviation of a size, in sizes of the named cause, below which records know it
UNSEEN = 0.9  # standard deviation of a number, in sizes of its effect or of its prior, from which on records do not show it
ASKED_FOR = 4.0  # deviance that one more number must take off: two standard deviations
BESIDE = 0.1  # share of what a cause gains from which on, left without a name, it is not sure
UNTOLD = 0.5  # share of what causes gain from which on, left without a name, they are none if their sizes differ between records
LOCAL = 20.0  # BIC from which a cause that does not hold everywhere is told
ALONE = 0.2  # share of what causes explain together, below which they are not sure where each of them left out leaves no more
LAWS = 0.05  # share of what causes gain up to which what is left may be the ideal form of their laws
PRACTICAL = 5e-4  # share of the squared errors below which an effect is of no practical size
LIKE_THE_FIRST = 0.03  # of the first cause's gain: less at the same place is the first one's form
SAME_CURVE = 0.1  # the same for effects over one and the same variable: torques over speed add up to one curve
NEARLY, FINALISTS = 0.1, 3  # share of the best refit's gain that a refit may miss and still be fitted to convergence, how many
ALIKE = 0.9  # share of a signature that another can mimic from which on both are fitted to convergence
RIVALS, SWAP = 4, 60.0  # of each cause, tried in its place beside the others; BIC that their first fit may lie behind
MOST = 3
FREED = 3  # times that what an effect gains may turn out to be a better fit of all else
MATTERS, MATTERS_ALONE = 0.01, 0.005  # share of an error that a further cause must take off; where nothing is left without a name
HARM = 0.1  # share of an error by which a cause may raise it and be sure
LONG_RUN = 0.2  # share of the error a second ahead that a search without coloured torques must take off to count
HELPFUL = 0.1  # the same for each of its causes
PLAY = "backlash"
TOGETHER = "without the other causes it explains next to nothing: together they may stand for something else"
NONE = "would explain these records at a size that they do not tell from none"
TRIFLE = "would explain a little more, but takes no error down by a share that matters"
LEAST = 0.01  # of nominal, below which a parameter is told whatever its tolerance
DIGITS = 1e-6  # relative, to which the values of a record tell a step


@record
class Rival:
    """A model in which another effect stands in the place of a cause."""

    key: str
    model: Model


@record
class Step:
    """A cause as it was accepted: models before and after, its score, rivals by BIC, and how it held on what was left out.

    others: times that suit the records as well as that of `after`, where a lag and a time constant can change places.
    """

    key: str
    before: Model
    after: Model
    score: Score
    rivals: dict[str, float]
    gain: float
    stable: float
    rival: Rival | None = None  # the closest one that ties
    others: tuple[float, ...] = ()


def diagnose(
    plant: Plant,
    dataset: Dataset,
    held_out: Dataset | None = None,
    *,
    templates: Sequence[Template] = (),
    drift: bool = True,
    threads: int = 1,
    anyway: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """What `plant` lacks to explain the records of `dataset`; gains are of `held_out`; where there is none, of parts of
    `dataset`, each left out of the fit in turn.

    templates: experiments that the machine could run, among which the one is sought that would tell causes apart which tie.
    drift: whether torques that nobody logged may come and go as noise. Such a noise may take in what changes at reversals only,
    friction and offset: where it leaves something that no effect explains, the search is made again without it, and counts if
    what it names helps a second ahead. Parameters and sizes are those of the likelihood or of the free run, whichever errs less
    a second and the full run ahead. Raises InputError for records that cannot be of this plant, unless the user takes them
    `anyway`; see `check`.
    """
    began = time.perf_counter()
    notes = [str(note) for note in check(plant, dataset, anyway=anyway)]
    judge = Judge(held_out or dataset, held_out is not None)
    progress("recalibrating")
    given = as_given(plant, dataset, drift=drift, threads=threads)
    base = _as_coloured(lasting(_no_worse(given, _recalibrated(plant, dataset, drift, threads)), plant.name))
    found = _judged(_searched(base, np.inf if drift else 1.0 - HELPFUL, progress), judge, longer=not drift)
    torques = len(base.predictor.noise.drift) > 0  # a plant without shafts has none that come and go
    if torques and (found.finding in (Finding.UNKNOWN, Finding.INCOMPLETE) or _forgiven(judge, found)):
        progress("again, without torques that come and go")
        bare = _as_coloured(_recalibrated(plant, dataset, False, threads))
        again = _judged(_searched(bare, 1.0 - HELPFUL, progress), judge, longer=True) if bare.sound else None
        if again and again.steps and not _tells(found.local, again) and judge.longer(found.model, again.model) < 1.0 - LONG_RUN:
            found = replace(again, local=again.local or found.local)
            notes.append(
                "unlogged torques that come and go were not allowed as noise: they would have taken in what is named here"
            )
    following = _next(found.steps, templates)
    progress("free runs")
    only_together = _only_together(found.base, found.steps)
    laws = {s.key: law for s in found.steps if (law := _instead(s, found.model))}  # free runs have gains in another unit
    found = _by_free_runs(found, judge)
    progress("gains on held-out records")
    base, model, steps, tested = found.base, found.model, found.steps, found.tested
    if len(base.predictor.noise.drift) < len(given.predictor.noise.drift):  # such a filter errs less, whatever the plant
        given = as_given(plant, dataset, drift=False, threads=threads)
    if len(base.predictor.noise.coloured):
        coloured = with_coloured_noise(given, np.zeros(len(plant.slots)))
        given = coloured if coloured.sound else given
    objections = judge.objections("extended" if steps else "recalibrated", given, model)
    kept = bool(objections) and not steps  # what names nothing must not bend parameters either
    rounds = tuple(_rounded(plant, r) for r in rounded(filtered(model).predictor))
    whole = sum(float(np.sum(e**2)) for e in base.fit.errors)
    finding, beyond = _with_rounding(found, [c.place for c in rounds]), _beyond(base, model)
    harm = {s.key: _harm(judge, s) for s in steps}
    model = model.sharpened()
    only_together = only_together and len(steps) > 1
    better = any(laws[s.key].gap < -TIE for s in steps if s.key in laws)
    if finding is Finding.NAMED and steps and (beyond or objections or only_together or better or any(harm.values())):
        finding = Finding.INCOMPLETE
    left = _strongest(found.left)
    against = {s.key: _against(laws[s.key]) if s.key in laws else "" for s in steps}
    if finding is Finding.INCOMPLETE:
        if only_together:
            against = {s.key: TOGETHER for s in steps}
        else:
            against = {s.key: _doubt(s, bool(beyond), bool(objections), harm[s.key], left) or against[s.key] for s in steps}
    doubts = _doubts(steps, against)
    causes = tuple(replace(_cause(plant, s, model, judge.gained(s.before, s.after)), doubt=doubts[s.key]) for s in steps)
    return Diagnosis(
        plant=plant.name,
        finding=finding,
        causes=(*causes, *rounds),
        recalibrated=_parameters(model),
        untestable=_untestable(base, tested),
        limits=(*_limits(plant, tested), *_rounding_limits(base)),
        remainder=tuple(_remainder(x, whole) for x in found.left[:5] if x.p_family < ALPHA),
        next_experiment=following,
        effects={**_effects(model), **{c.key: {name: e.value for name, e in c.parameters.items()} for c in rounds}},
        parameters={q.name: q.value if kept else float(v) for q, v in zip(plant.parameters, model.fit.point.p, strict=True)},
        tested=tuple(s.variant.key for s in tested),
        similarity=similarity(tested),
        notes=(
            *notes,
            *([str(found.local)] if found.local else []),
            *([str(found.unresolved)] if found.unresolved and found.finding in (Finding.UNKNOWN, Finding.INCOMPLETE) else []),
            *map(str, found.refused),
            *_exchanged(steps),
            *(f"the plant keeps its own parameters: {objection}" for objection in objections if kept),
        ),
        signs=beyond,
        objections=() if kept else objections,
        seconds=time.perf_counter() - began,
    )


@record
class Local:
    """An effect that explains much, but in the records or parts of one that are named only: the machine does not have it."""

    key: str
    gain: float
    records: tuple[str, ...]

    def __str__(self) -> str:
        where = ", ".join(self.records) or "no record by itself"
        return f"{self.key} would explain something, but in {where} only: look at what was different there"


@record
class Refused:
    """An effect that the search took for a cause and the referee does not; gain: BIC beside the others."""

    key: str
    why: str
    gain: float

    def __str__(self) -> str:
        return f"{self.key} {self.why}"


@record
class Unresolved:
    """An effect that shows beside what was found, but that no size explains; statistic: what it seemed to explain."""

    key: str
    statistic: float

    def __str__(self) -> str:
        return f"{self.key} shows in these records, but no size of it explains them: something like it is missing"


@record
class _Found:
    """What a search found: the base model, the steps from it, what is left, and the signatures of all effects at the base.

    refused: effects that held on the records of the search, but are no causes: see `_judged`.
    """

    base: Model
    steps: tuple[Step, ...]
    left: tuple[Left, ...]
    tested: tuple[Signature, ...]
    lesser: "_Lesser"
    most: float  # see `_searched`
    local: Local | None = None
    refused: tuple[Refused, ...] = ()
    unresolved: Unresolved | None = None
    runs: Model | None = None  # the base with parameters of the free run, where nothing is named and they are better

    @property
    def model(self) -> Model:
        return self.steps[-1].after if self.steps else self.runs or self.base

    @property
    def finding(self) -> Finding:
        found = _finding(self.steps, self.left, self.model)
        told = LAWS * sum(s.gain for s in self.steps)
        odd = self.local is not None and self.local.gain > told
        # all is not well, whatever the remainder is like; what takes no error down by a share that matters takes nothing away
        if odd or any(r.gain > told and not (self.steps and r.why == TRIFLE) for r in self.refused):
            return {Finding.NOTHING: Finding.UNKNOWN, Finding.NAMED: Finding.INCOMPLETE}.get(found, found)
        return found


def _recalibrated(plant: Plant, dataset: Dataset, drift: bool, threads: int) -> Model:
    made = recalibrated(predictor(plant, dataset, drift=drift, threads=threads), rounds=1)
    return settled(Model(made.predictor, made.fit), np.zeros(len(plant.slots)))


def _no_worse(given: Model, base: Model) -> Model:
    """The recalibrated model; begun again from the plant as it came where it is less likely: its noise levels sit elsewhere."""
    if base.posterior <= given.posterior:
        return base
    own, nothing = base.fit.unknowns, np.zeros(len(base.predictor.plant.slots))
    z = own.vector(given.fit.point, [])
    again = settled(Model(given.predictor, gauss_newton(given.predictor, own, z, nothing)), nothing)
    return min((base, again), key=lambda m: m.posterior)


def _as_coloured(base: Model) -> Model:
    """The model with a coloured part in the noise of its sensors, if these records have one; else as it is.

    Without it, what a sensor's noise was a sample ago looks like something that the machine lacks: under feedback above all,
    where the inputs carry it.
    """
    tried = with_coloured_noise(base, np.zeros(len(base.predictor.plant.slots))) if base.sound else base
    more = (np.sum(base.predictor.measured) + 1) * np.log(sum(map(len, base.predictor.records)))
    return tried if tried.sound and tried.deviance + more < base.deviance else base


def _forgiven(judge: Judge, found: _Found) -> bool:
    """Whether a model in which nothing is missing one step ahead is far from the best that its parameters can do in free runs."""
    runs = simulated(found.base) if found.finding is Finding.NOTHING else None
    return runs is not None and judge.longer(found.base, runs) < 1.0 - LONG_RUN


def _by_free_runs(found: _Found, judge: Judge) -> _Found:
    """With parameters and sizes that are fitted to free runs, where these err less a second and the full run ahead."""
    model = judge.better_ahead(found.model)
    if model is found.model:
        return found
    if not found.steps:
        return replace(found, runs=model)
    steps = tuple(replace(s, before=simulated(s.before) or s.before, after=model) for s in found.steps)
    unsure = [s for s, run in zip(found.steps, steps, strict=True) if _none(run)]
    if unsure:
        return _by_free_runs(_dropped(found, min(unsure, key=lambda s: s.gain), NONE), judge)
    return replace(found, steps=steps)


def _searched(base: Model, most: float, progress: Callable[[str], None]) -> _Found:
    """Search from a recalibrated model, drop, and look at what is left.

    most: errors a second ahead, after over before, of every cause. Without coloured torques, and in free runs, everything is
    significant: there only what a second ahead shows counts.
    """
    plant = base.predictor.plant
    search = _Search([slot.key for slot in plant.slots], np.zeros(len(plant.slots)), most, progress)
    base, steps = search.path(base)
    lesser = search.lesser
    if len(steps) > 1 or search.stuck:
        progress("dropping and swapping")
        steps = _kept(base, steps, lesser, most)
    progress("what is left")
    left = remainder(steps[-1].after if steps else base)
    return _Found(base, tuple(steps), tuple(left), tuple(search.tested), lesser, most, search.local, unresolved=search.unresolved)


class _Search:
    """A greedy path through the catalogue; remembers the steps of its differences and the first screen."""

    def __init__(self, keys: Sequence[str], sizes: np.ndarray, most: float, progress: Callable[[str], None]):
        self.keys, self.most, self.progress = list(dict.fromkeys(keys)), most, progress
        self.lesser = _Lesser(sizes)
        self.tested: list[Signature] = []
        self.local: Local | None = None
        self.unresolved: Unresolved | None = None
        self.stuck = False  # whether a cause was chosen by a fit that was stuck

    def path(self, base: Model) -> tuple[Model, list[Step]]:
        """One effect after the other, as long as something is found; and the base.

        A model that is less likely than the one with an effect, freed of it again, was stuck: the effect has led its parameters
        out, and counts for what it gains beside the better model.
        """
        steps: list[Step] = []
        freed = 0
        while len(steps) < MOST:
            model = steps[-1].after if steps else base
            self.progress(f"screening beside {', '.join(model.keys)}" if steps else "screening")
            found = self.screened(model)
            self.lesser.met.append(model)
            if not found or (found[0].p_family > ALPHA and model.farthest <= LEFT):
                break
            step = _step(model, found, self.lesser, steps, self.most, self.progress)
            if not isinstance(step, Step):
                self.local = step
                self.unresolved = _unresolved(found, model)
                break
            less = self.lesser.of(step.after, step.key)
            stuck = less.bic < model.bic - WORTH and less.sound
            before = less if stuck else model
            if stuck and steps:
                steps[-1], self.stuck = replace(steps[-1], after=before), True
            elif stuck:
                base = before
            gain = before.bic - step.after.bic
            if gain >= WORTH:
                steps.append(replace(step, before=before, gain=gain))
            elif (freed := freed + 1) > FREED:
                break
        return base, steps

    def screened(self, model: Model) -> list[Score]:
        """Score tests of every effect that the model does not hold yet."""
        first = not self.tested
        if first:
            self.lesser = _Lesser(small_sizes(model.predictor, model.fit))
        found = _screened(model, [k for k in self.keys if k not in model.keys], self.lesser.sizes, columns=first)
        if first:
            self.tested = [min(s.all, key=_most_shown) for s in found]
        return found


def _screened(model: Model, keys: Sequence[str], sizes: np.ndarray, *, columns: bool = False) -> list[Score]:
    """Score tests of the effects `keys` that the channels of the records could show."""
    tried = variants(model.predictor, model.fit, [k for k in keys if _measurable(model, k)])
    felt = [v for v in tried if not np.isnan(v.finite) or all(sizes[s] > 0.0 for s in v.sizes)]
    return scores(signatures(model.predictor, model.fit, felt, sizes, columns=columns))


def _measurable(model: Model, key: str) -> bool:
    """A sensor that nobody logged cannot be wrong; a rounded one is told by its values, not by a fit."""
    plant = model.predictor.plant
    slot = next(s for s in plant.slots if s.key == key)
    if slot.effect.family != "sensor":
        return True
    if slot.effect.id == ROUNDED:
        return False
    j = plant.output_names.index(slot.place)
    return bool(model.predictor.measured[j])


def _step(
    model: Model,
    found: Sequence[Score],
    lesser: "_Lesser",
    steps: Sequence[Step],
    most: float,
    progress: Callable[[str], None],
) -> Step | Local | None:
    """The best extension of the model by one effect, if it holds; most: errors a second ahead, after over before.

    Where none holds, the one that would but for the records that are left out.
    """
    sizes = lesser.sizes
    short = _with_late(model, shortlist([s for s in found if s.p_family < ALPHA]), found)
    short = _with_family(model.predictor.plant, short, found)
    if not short:
        return None
    progress(f"refitting {', '.join(s.key for s in short)}")
    trials = refits(model, short, sizes)
    slack = max(3.0 * TIE, NEARLY * (model.bic - trials[0][0].bic))
    near = {s.key for trial, s in trials[:FINALISTS] if trial.bic < trials[0][0].bic + slack}
    near |= _alike(model, [s for _, s in trials], sizes)
    if model.farthest > LEFT:  # first fits stay where parameters have made up for a sensor that is late: its profile does not
        near |= {s.key for s in short if is_late(model.predictor, s.key)}
    others: dict[str, tuple[float, ...]] = {}

    def final(trial: Model, key: str, noise: Noise | None = None) -> Model:
        found = timed(model, settled(trial, sizes, noise), key, sizes)
        others[key] = found.others
        return found.model

    first = final(trials[0][0], trials[0][1].key)
    # rivals begin where the first one ended: what looks alike must not differ by the way that its noise levels went
    finals = [(first, trials[0][1])]
    finals += [(final(t, s.key, first.predictor.noise), s) for t, s in trials[1:] if s.key in near]
    for special, s in list(finals):  # a law that fits worse than its special case is not fitted yet
        for general in (g for g in short if _included(model.predictor.plant, s.key, g.key)):
            begun = from_special(special, model, general, sizes)
            if begun.bic < special.bic + TIE:
                finals.append((final(begun, general.key), general))
                near.add(general.key)
    finals = _best_first(finals)
    best = finals[0][0]
    if best is not first:  # nor by that of the one which has come out best
        finals = _best_first(
            [*finals, *((final(m, s.key, best.predictor.noise), s) for m, s in finals[1:] if m.bic < best.bic + SWAP)]
        )
    worthy = [(m, s) for m, s in finals if _worthy(model, m, s.key, steps, most)]
    behind = (pair for pair in trials[1:] if pair[1].key not in near)

    def holds(m: Model, s: Score) -> bool:
        # what shows by no score of its own is a cause only where nothing explains more
        return (s.p_family < ALPHA or m is finals[0][0]) and left_out(model, m).holds

    while not any(holds(m, s) for m, s in worthy) and (pair := next(behind, None)):
        # what came first holds in some records only: another cause may hold in all
        near.add(pair[1].key)
        tried = final(pair[0], pair[1].key, first.predictor.noise)
        worthy += [(tried, pair[1])] if _worthy(model, tried, pair[1].key, steps, most) else []
    held = [(m, s) for m, s in worthy if holds(m, s)]
    if not worthy and np.isfinite(most):
        # what the likelihood puts first helps nothing a second ahead: what it puts behind may
        tried, significant = {s.key for s in short}, [s for s in found if s.p_family < ALPHA]
        if rest := [s for s in significant if s.key not in tried]:
            return _step(model, rest, lesser, steps, most, progress)
    if not held:
        told = (
            _local(model, m, s.key)
            for m, s in worthy
            if (model.bic - m.bic > LOCAL or s.p_family < LEFT_OVER) and lesser.of(m, s.key).bic - m.bic > WORTH
        )
        return next(told, None)
    best, score = held[0]
    tying = _rivals(model, best, score.key, worthy)
    rivals = {s.key: _gap(best, score.key, m, s.key) for m, s in tying}
    rivals |= {s.key: m.bic - trials[0][0].bic for m, s in trials if s.key not in near and s.key != score.key}
    return Step(
        score.key,
        model,
        best,
        score,
        rivals,
        model.bic - best.bic,
        stability(best, score.key),
        _closest(model, best, score.key, tying),
        others[score.key],
    )


def _best_first(tried: Sequence[tuple[Model, Score]]) -> list[tuple[Model, Score]]:
    """Models with the effects of scores by BIC, of each effect the best."""
    best = {s.key: (m, s) for m, s in sorted(tried, key=lambda pair: -pair[0].bic)}
    return sorted(best.values(), key=lambda pair: pair[0].bic)


def _reach(plant: Plant, key: str, rival: str, gain: float) -> float:
    """BIC within which a rival ties with a cause of this gain; between two forms of one friction a share of the gain."""
    one, other = (next(slot for slot in plant.slots if slot.key == k) for k in (key, rival))
    forms = one.place == other.place and {one.effect.domain, other.effect.domain} <= {Domain.SPEED, Domain.LOAD}
    # between a law and a special case of it there is no question of form
    exact = not forms or _included(plant, key, rival) or _included(plant, rival, key)
    return TIE if exact else max(TIE, IDEAL * gain)


def _rivals(before: Model, named: Model, key: str, tried: Sequence[tuple[Model, Score]]) -> list[tuple[Model, Score]]:
    """Those of the models that may be the truth as well: what left-out records speak against by a hair is among them."""
    found = []
    for m, s in tried:
        if s.key == key or _only_more(named, key, m, s.key):
            continue
        elsewhere = left_out(before, m)
        if elsewhere.holds or (m.bic - named.bic > -TIE and elsewhere.total > -2.0 * elsewhere.error):
            found.append((m, s))
    return sorted(found, key=lambda pair: pair[0].bic)


def _tells(local: Local | None, again: _Found) -> bool:
    """Whether what another search names first is what an effect in some records only has told already."""
    if local is None:
        return False
    slots = {slot.key: slot for slot in again.base.predictor.plant.slots}
    one, other = slots[local.key], slots[again.steps[0].key]
    return one.place == other.place and one.effect.domain is other.effect.domain


def _worthy(before: Model, after: Model, key: str, steps: Sequence[Step], most: float) -> bool:
    """Whether an effect would be a cause beside those of `steps`: worth its numbers, of practical size, and its own."""
    gain = before.bic - after.bic
    return (
        after.sound
        # also where the parameters' moves within their tolerance are paid for: what needs them to move is no cause
        and min(gain, gain + before.within - after.within) >= WORTH
        and _practical(before, after)
        and _of_its_own(before.predictor.plant, key, gain, steps)
        and not _is_rounding(after, key)
        and (np.isinf(most) or ahead(before, after) <= most)
    )


def _unresolved(found: Sequence[Score], model: Model) -> Unresolved | None:
    """What shows most clearly of effects that none of the records' extensions holds, if it is of practical size."""
    clear = [s for s in found if s.p_family < LEFT_OVER and s.statistic > PRACTICAL * model.predictor.samples]
    return Unresolved(clear[0].key, float(clear[0].statistic)) if clear else None


def _local(before: Model, after: Model, key: str) -> Local:
    """Where an effect explains something that does not hold elsewhere."""
    records, tested = before.predictor.records, folds(before)
    names = [records[f.record].name if len(records) > 1 else f"samples {f.first} to {f.last}" for f in tested]
    gains = left_out(before, after).by_fold
    return Local(key, before.bic - after.bic, tuple(name for name, gain in zip(names, gains, strict=True) if gain > WORTH))


def _with_late(model: Model, short: list[Score], found: Sequence[Score]) -> list[Score]:
    """The shortlist with late sensors, however small their scores: where it holds one, all that its sensor may be; where it
    holds something else that is late, all of them.

    So it is where nothing shows, but a parameter has left its tolerance: it may have made up for a sensor that is late, and a
    filter follows the rest.
    """
    late = {slot.key for slot in model.predictor.plant.slots if slot.effect.domain is Domain.SHIFT}
    keys = {s.key for s in short}
    slow = [s for s in found if is_late(model.predictor, s.key)]
    places = {_at(s.key)[1] for s in slow if s.key in keys}
    if places:
        slow = [s for s in slow if _at(s.key)[1] in places]
    elif not (late & keys or (not keys and model.farthest > LEFT)):
        slow = []
    return short + [s for s in slow if s.key not in keys]


def _with_family(plant: Plant, short: list[Score], found: Sequence[Score]) -> list[Score]:
    """The shortlist with the special cases of its effects, and with the laws that these are special cases of.

    What a law with more numbers explains, it may explain with fewer: then its significance is that of the law that brings it in.
    """
    keys, whole = {s.key for s in short}, list(short)
    for s in found:
        by = [general.p_family for general in short if _included(plant, s.key, general.key)]
        if s.key not in keys and by:
            whole.append(replace(s, p_family=min(by)))
    special = [s.key for s in whole]
    keys |= set(special)
    return whole + [s for s in found if s.key not in keys and any(_included(plant, key, s.key) for key in special)]


def _alike(model: Model, found: Sequence[Score], sizes: np.ndarray) -> set[str]:
    """Keys of the effects whose signatures are those of the first one, but for a share of 1 - ALIKE."""
    made = signatures(model.predictor, model.fit, [s.best.variant for s in found], sizes, columns=True)
    return {s.variant.key for s, share in zip(made, similarity(made)[:, 0], strict=True) if share > ALIKE}


def _is_rounding(model: Model, key: str) -> bool:
    """Whether the play of a sensor is less than the step that its readings are rounded to: rounding looks like play."""
    effect, place = _at(key)
    if effect != PLAY:
        return False
    size = max(abs(float(model.fit.point.eta[0, i])) for i, slot in enumerate(model.predictor.plant.slots) if slot.key == key)
    return any(r.channel == place and size < r.step for r in rounded(model.predictor))


def _practical(before: Model, after: Model) -> bool:
    """Whether the likelihood gains what an explained share of PRACTICAL of the squared errors would."""
    return before.deviance - after.deviance > PRACTICAL * before.predictor.samples


def _of_its_own(plant: Plant, key: str, gain: float, steps: Sequence[Step]) -> bool:
    """A small gain at the place of an earlier cause is that cause's form, not another cause."""
    slots = {slot.key: slot for slot in plant.slots}
    own = slots[key]

    def least(first: Slot) -> float:
        return SAME_CURVE if first.effect.domain is own.effect.domain else LIKE_THE_FIRST

    return all(gain > least(slots[s.key]) * s.gain for s in steps if slots[s.key].place == own.place)


class _Lesser:
    """Models without one of their effects, with noise levels of their own, each made once.

    Levels that suit the effect would make it look worth too much. A model with the same effects that the search has met on its
    way stands in where it is more likely: what is freed of an effect may be lost where that one has led it.
    """

    def __init__(self, sizes: np.ndarray):
        self.sizes, self.made = sizes, []
        self.met: list[Model] = []

    def of(self, model: Model, key: str) -> Model:
        for known, left, less in self.made:
            if known is model and left == key:
                return less
        less = settled(without(model, key, self.sizes), self.sizes)
        less = min((less, *(m for m in self.met if set(m.keys) == set(less.keys))), key=lambda m: m.deviance)
        self.made.append((model, key, less))
        return less


def _judged(found: _Found, judge: Judge, *, longer: bool) -> _Found:
    """Without what is no cause, the weakest first; each time the others are fitted again, and what is left is looked at anew.

    What is known to be left shows how large the errors of the model's form are, and these are the same on held-out records: an
    effect that explains less than the strongest term without a name is not told from them. Where its place in the machine is
    right, what is said of its size is not. longer: causes are judged a second ahead, not by the likelihood one step ahead.
    """
    while found.steps:
        shown = [float(x.statistic) for x in found.left if x.p_family < ALPHA]
        if found.unresolved:
            shown.append(found.unresolved.statistic)
        strongest = max(shown, default=0.0)
        first = max(found.steps, key=lambda step: step.gain)
        objected = [(step, why) for step in found.steps if (why := _objection(step, step is first, strongest, judge, longer))]
        if not objected:
            break
        found = _dropped(found, *min(objected, key=lambda pair: pair[0].gain))
    if found.finding is Finding.UNKNOWN and found.steps:
        # what does not hold everywhere beside so much that is left is no name
        why = "would explain part of it, but not with one size in all records"
        refused = (*found.refused, *(Refused(s.key, why, s.gain) for s in found.steps))
        found = replace(found, steps=(), left=tuple(remainder(found.base)), refused=refused)
    return found


def _dropped(found: _Found, step: Step, why: str) -> _Found:
    """Without a step that is no cause; the others are fitted again."""
    rest = _facing([replace(s, after=step.before) for s in found.steps if s is not step], [step.key])
    steps = _kept(found.base, rest, found.lesser, found.most) if rest else []
    left = remainder(steps[-1].after if steps else found.base)
    return replace(found, steps=tuple(steps), left=tuple(left), refused=(*found.refused, Refused(step.key, why, step.gain)))


def _objection(step: Step, first: bool, strongest: float, judge: Judge, longer: bool) -> str:
    """Why an effect is no cause; empty where nothing speaks against it. strongest: statistic of what is left without a name."""
    found = judge.between(step.before, step.after)
    if step.gain < strongest:
        return "would explain part of it, but more is left beside it than it explains"
    if _none(step):
        return NONE
    ahead_of = any(c.sure and c.share > 0.0 for c in found if c.horizon == "one-second")
    surprised = not ahead_of if longer else judge.held_out and judge.surprise(step.before, step.after) >= 0.0
    if surprised and not _helps_free_runs(step, judge):
        return "would explain these records, but predicts the held-out ones no better: something else is behind it"
    if first:
        return ""
    if step.after.farthest > FAR > step.before.farthest:
        return "would explain a little more, but with parameters far from their data sheet"
    if not helps(found, MATTERS if strongest else MATTERS_ALONE):
        return TRIFLE
    if harmed := harms(found):
        return f"would explain a little more, but makes an error worse ({harmed[0]})"
    return ""


def _kept(base: Model, steps: list[Step], lesser: _Lesser, most: float) -> list[Step]:
    """Steps that none of their rivals replaces and none of the others makes superfluous; what ties beside all is not what ties
    beside fewer.
    """
    while True:
        steps = _swapped(steps, lesser, most)
        kept = _pruned(base, steps, lesser)
        if len(kept) == len(steps):
            return kept
        steps = _facing(kept, {s.key for s in steps} - {s.key for s in kept})


def _facing(steps: Sequence[Step], dropped: Iterable[str]) -> list[Step]:
    """Steps that are to be compared, first of all, with what no longer stands beside them."""
    return [replace(s, rivals=s.rivals | dict.fromkeys(dropped, 0.0)) for s in steps]


def _swapped(steps: list[Step], lesser: _Lesser, most: float) -> list[Step]:
    """Steps of which none gives way to one of its rivals beside all others; what came first was chosen without them."""
    steps, model, sizes = list(steps), steps[-1].after, lesser.sizes
    for j, step in enumerate(steps):
        rivals = [key for key in sorted(step.rivals, key=lambda key: step.rivals[key]) if key not in model.keys][:RIVALS]
        if not rivals or not (less := lesser.of(model, step.key)).sound:
            continue
        others = steps[:j] + steps[j + 1 :]
        found = _screened(less, rivals, sizes)
        trials = refits(less, found, sizes) if found else []
        # a first fit lies far behind where noise levels do not suit it yet, but all that have a chance lie behind alike
        near = [(m, s) for m, s in trials if m.bic < trials[0][0].bic + SWAP and m.bic < 0.5 * (less.bic + model.bic)]
        tried = [(timed(less, settled(m, sizes, model.predictor.noise), s.key, sizes), s) for m, s in near]
        times = {s.key: t.others for t, s in tried} | {step.key: step.others}
        finals = [(t.model, s) for t, s in tried if _worthy(less, t.model, s.key, others, most)]
        better = [(m, s) for m, s in finals if m.bic < model.bic and left_out(less, m).holds]
        finals.append((model, step.score))
        model, score = min(better, key=lambda pair: pair[0].bic, default=(model, step.score))
        tying = _rivals(less, model, score.key, finals)
        # what does not tie beside these may tie beside fewer
        gaps = dict.fromkeys(step.rivals, np.inf) | {s.key: _gap(model, score.key, m, s.key) for m, s in tying}
        closest = _closest(less, model, score.key, tying)
        steps[j] = replace(step, key=score.key, score=score, rivals=gaps, rival=closest, others=times[score.key])
    steps[-1] = replace(steps[-1], after=model)
    return steps


def _closest(before: Model, named: Model, key: str, tying: Sequence[tuple[Model, Score]]) -> Rival | None:
    """The best of the rivals that tie."""
    plant, gain = before.predictor.plant, before.bic - named.bic
    near = [Rival(s.key, m) for m, s in tying if _gap(named, key, m, s.key) < _reach(plant, key, s.key, gain)]
    return near[0] if near else None


def _gap(named: Model, key: str, other: Model, other_key: str) -> float:
    """BIC by which a rival is worse; one that includes the named cause cannot be worse than by its further numbers.

    Only numbers that the records tell are counted: that nothing ran backwards is no evidence against a friction of its own there.
    """
    samples = sum(len(r) for r in named.predictor.records)
    more = (_seen(other, other_key) - _seen(named, key)) * float(np.log(samples))
    gap = other.deviance - named.deviance + more
    return min(gap, max(more, 0.0)) if _included(named.predictor.plant, key, other_key) else gap


def _seen(model: Model, key: str) -> int:
    """How many numbers of an effect the records tell from none, or from what was believed before."""
    sizes, deviation = _numbers(model, key)
    scale = np.where(np.arange(len(deviation)) < len(sizes), float(np.abs(sizes).max()), 1.0)
    return int(np.sum(deviation < UNSEEN * scale))


def _included(plant: Plant, key: str, other_key: str) -> bool:
    """Whether an effect is a special case of another one at its place."""
    slots = {slot.key: slot for slot in plant.slots}
    own, other = slots[key], slots[other_key]
    return own.place == other.place and own.effect.id in other.effect.includes


def _only_more(named: Model, key: str, other: Model, other_key: str) -> bool:
    """Whether a rival is the named cause with numbers more that the records know and do not ask for: the same, no other cause."""
    if not _included(named.predictor.plant, key, other_key):
        return False
    (size, _), (sizes, deviation) = _numbers(named, key), _numbers(other, other_key)
    known = bool(
        np.all(deviation[: len(sizes)] < KNOWN * np.abs(size).max())
    )  # friction of a direction in which nothing moved is not
    return known and named.deviance - other.deviance < ASKED_FOR * (other.numbers - named.numbers)


def _numbers(model: Model, key: str) -> tuple[np.ndarray, np.ndarray]:
    """Sizes of an effect, and standard deviations of all its numbers: of these first, then of its fitted shapes and rotations."""
    fit = model.fit
    t, own = next((t, own) for t, own in zip(fit.unknowns.terms, fit.unknowns.places, strict=True) if t.key == key)
    return fit.z[own][: len(t.sizes)], np.sqrt(np.diag(fit.covariance)[own])


def _pruned(base: Model, steps: list[Step], lesser: _Lesser) -> list[Step]:
    """Steps without those that the others make superfluous, each with what it gains beside all others."""
    model = steps[-1].after
    while len(steps) > 1:
        less = {step.key: lesser.of(model, step.key) for step in steps}
        weakest = min(less, key=lambda key: less[key].bic)
        if less[weakest].bic - model.bic >= WORTH:
            return [
                replace(
                    step,
                    before=less[step.key],
                    after=model,
                    gain=less[step.key].bic - model.bic,
                    stable=stability(model, step.key),
                )
                for step in steps
            ]
        model, steps = less[weakest], [s for s in steps if s.key != weakest]
    return [replace(steps[0], before=base, after=model, gain=base.bic - model.bic, stable=stability(model, steps[0].key))]


def _helps_free_runs(step: Step, judge: Judge) -> bool:
    """Whether the effect, fitted to free runs, takes off the errors a second and the full run ahead what counts.

    One step ahead a filter with other parameters makes up for much that a free run shows.
    """
    before, after = simulated(step.before), simulated(step.after)
    if before is None or after is None:
        return False
    return judge.longer(before, after) < 1.0 - LONG_RUN and not worse(judge.between(before, after))


def _none(step: Step) -> bool:
    """Whether the interval of every size of the effect, but of those of its shape, holds 0."""
    return all(e.low <= 0.0 <= e.high for name, e in _sizes(step.after, step.key).items() if name not in _shapes(step))


def _shapes(step: Step) -> set[str]:
    slots = step.after.predictor.plant.slots
    return {slot.parameter.name for slot in slots if slot.key == step.key and slot.parameter.shape}


def _with_rounding(found: _Found, channels: Sequence[str]) -> Finding:
    """The finding where `channels` are rounded: what is left in their readings only has its name."""
    left = {x.channel for x in found.left if x.p_family < ALPHA}
    if channels and not found.steps and not found.local and left <= {label(("sensor", name)) for name in channels}:
        return Finding.NAMED
    return found.finding


def _finding(steps: Sequence[Step], left: Sequence[Left], model: Model) -> Finding:
    worst = min((x.p_family for x in left), default=1.0)
    if not steps:
        return Finding.UNKNOWN if worst < ALPHA and _visible(left, model) else Finding.NOTHING
    strongest = _strongest(left)
    if strongest > LAWS * sum(s.gain for s in steps) and _visible(left, model):
        unstable = any(s.stable < LEFT_OVER for s in steps)
        return Finding.UNKNOWN if strongest > UNTOLD * sum(s.gain for s in steps) and unstable else Finding.INCOMPLETE
    return Finding.INCOMPLETE if any(s.stable < LEFT_OVER for s in steps) else Finding.NAMED


def _strongest(left: Sequence[Left]) -> float:
    """Statistic of what is left for sure beside causes."""
    return max((x.statistic for x in left if x.p_family < LEFT_OVER), default=0.0)


def _visible(left: Sequence[Left], model: Model) -> bool:
    """Whether what is left is of practical size."""
    return max(x.statistic for x in left) > PRACTICAL * model.predictor.samples


def _cause(plant: Plant, step: Step, model: Model, gains) -> Cause:
    effect, place = step.key.split("@")
    slot = next(s for s in plant.slots if s.key == step.key)
    reach = {key: _reach(plant, step.key, key, step.gain) for key in step.rivals}
    near = {key: gap * TIE / reach[key] for key, gap in step.rivals.items() if gap < reach[key]}
    weights = {key: float(np.exp(-0.5 * max(gap, 0.0))) for key, gap in near.items()}
    total = 1.0 + sum(weights.values())
    return Cause(
        effect=effect,
        place=place,
        sentence=_sentence(plant, slot),
        parameters=_spanning(_sizes(model, step.key), step.others),
        gains=gains,
        evidence=Evidence(step.gain, _significance(step), 1.0 / total),
        ties={key: w / total for key, w in sorted(weights.items(), key=lambda item: -item[1])},
        stability=step.stable,
        separates=slot.effect.separates,
    )


def _significance(step: Step) -> float:
    """The p-value of a cause's score; where it was tried without one, the chance that a ratio of likelihoods has at most."""
    p = step.score.p_family
    return p if p < ALPHA else min(p, float(np.exp(-0.5 * step.gain)))


def _sentence(plant: Plant, slot: Slot) -> str:
    """What a cause is; a static error of a sensor is not told from one of the equation that its output is computed by."""
    said = slot.effect.sentence.format(place=slot.place)
    either = slot.effect.family == "sensor" and not slot.effect.memories and slot.place in plant.computed
    return f"{said} Or the plant's own equation of {slot.place} is off: records do not tell the two apart." if either else said


def _harm(judge: Judge, step: Step) -> str:
    """The error one step or one second ahead that a cause raises most, by more than noise and a share of HARM; empty if none."""
    found = [c for c in harms(judge.between(step.before, step.after)) if c.share < -HARM]
    return str(min(found, key=lambda c: c.share)) if found else ""


def _only_together(base: Model, steps: Sequence[Step]) -> bool:
    """Whether causes explain next to nothing where one of them is left out: two wrong ones can make up for what has no name."""
    if len(steps) < 2:
        return False
    whole = base.bic - steps[-1].after.bic
    return all(whole - s.gain < ALONE * whole for s in steps)


def _doubts(steps: Sequence[Step], against: Mapping[str, str]) -> dict[str, str]:
    """What speaks against each cause, empty where nothing does: also that it was found beside one that is not sure."""
    doubts, unsure = {}, ""
    for s in sorted(steps, key=lambda s: -s.gain):
        doubts[s.key] = against[s.key] or (f"it was found beside {unsure}, which is not sure" if unsure else "")
        unsure = unsure or (s.key if against[s.key] else "")
    return doubts


def _doubt(step: Step, beyond: bool, worse_than_given: bool, harm: str, left: float) -> str:
    """What speaks against a cause of an incomplete answer, empty where nothing does; beyond: parameters left their tolerance."""
    if step.stable < LEFT_OVER:
        return "its size differs between the records"
    if worse_than_given:
        return "the extended plant is worse on records that it has not seen than the plant that came"
    if harm:
        return f"it raises an error on records that it has not seen, {harm}"
    if beyond:
        return "it needs parameters far from their data sheet"
    if left > BESIDE * step.gain:  # the errors of the model's form are as large, and what has no name may be all there is
        return f"what is left without a name is {100 * left / step.gain:.0f} % of what it explains"
    return ""


def _instead(step: Step, model: Model) -> Law | None:
    """The law in one of the plant's own equations that explains the records as well as a cause; None where none does.

    A static error of a sensor stands far from where such a law acts: there one that may explain them as well is as likely. The
    law has taken one step of its fit only, at noise levels that suit the cause.
    """
    effect = next(slot.effect for slot in model.predictor.plant.slots if slot.key == step.key)
    static = effect.family == "sensor" and not effect.memories
    law = instead(model, step.key)
    return law if law and law.gap < (max(TIE, ONE_STEP * step.gain) if static else TIE) else None


def _against(law: Law) -> str:
    """What a law in the plant's own equations says against a cause."""
    return f"{law}: {'that explains these records better' if law.gap < -TIE else 'these records do not tell the two apart'}"


def _spanning(sizes: dict[str, Estimate], others: Sequence[float]) -> dict[str, Estimate]:
    """Sizes whose first, a time, has an interval that holds the other times too."""
    name, found = next(iter(sizes.items()))
    return sizes | {name: replace(found, low=min(found.low, *others), high=max(found.high, *others))} if others else sizes


def _exchanged(steps: Sequence[Step]) -> list[str]:
    """A sentence for every time that may have changed places with a time constant of the machine."""
    return [
        f"{s.key}: {' or '.join(f'{other:.3g} s' for other in s.others)} explains these records as well, with other parameters "
        "of the machine: its time and the machine's can change places, and only a parameter that is known better decides"
        for s in steps
        if s.others
    ]


def _rounded(plant: Plant, r: Rounded) -> Cause:
    """A rounded channel as a cause: it gains nothing in prediction, it says how good a prediction can be."""
    slot = next(s for s in plant.slots if s.effect.id == ROUNDED and s.place == r.channel)
    step = Estimate(r.step, r.step * (1.0 - DIGITS), r.step * (1.0 + DIGITS), r.unit)
    evidence = Evidence(float(r.samples), 0.0, 1.0)
    return Cause(ROUNDED, r.channel, slot.effect.sentence.format(place=r.channel), {slot.parameter.name: step}, (), evidence)


def _rounding_limits(base: Model) -> tuple[Limit, ...]:
    outputs = base.predictor.plant.outputs
    return tuple(
        Limit(ROUNDED, channel.name, limit(base.predictor, j), channel.unit)
        for j, channel in enumerate(outputs)
        if base.predictor.measured[j]
    )


def _next(steps: Sequence[Step], templates: Sequence[Template]) -> NextExperiment | None:
    """The experiment that decides the closest tie; None where nothing ties."""
    for step in steps:
        if step.rival:
            slot = next(s for s in step.after.predictor.plant.slots if s.key == step.key)
            return deciding(step.after, step.rival.model, (step.key, step.rival.key), templates, slot.effect.separates)
    return None


def _beyond(base: Model, model: Model) -> tuple[str, ...]:
    """A sentence for every parameter that left its tolerance; what a named cause has pulled out is a sign of something else."""
    unknowns, plant = model.fit.unknowns, model.predictor.plant
    said = []
    for j, i in enumerate(unknowns.parameters):
        q, now = plant.parameters[i], float(model.fit.point.p[i])
        if not _left_open(q.tolerance, float(model.fit.z[j] * unknowns.sigma[j])):
            pulled = bool(model.keys) and abs(base.fit.z[j]) < np.sqrt(3.0)
            sign = ": a sign of another missing piece" if pulled else ""
            said.append(
                f"{q.name} ({q.meaning or 'parameter'}) is {now:.4g} {q.unit}, {100 * (now / q.value - 1):+.0f} % off the data "
                f"sheet, which leaves {100 * q.tolerance:.0f} % open{sign}"
            )
    return tuple(said)


def _left_open(tolerance: float, off: float) -> bool:
    """Whether the logarithm of a parameter over nominal leaves what its tolerance allows by half of that at most.

    A tolerance of 90 % leaves open a tenth of nominal: downwards it is wider in the logarithm.
    """
    lowest = -np.log(max(1.0 - tolerance, LEAST)) + 0.5 * tolerance
    return bool(-lowest <= off <= 1.5 * tolerance)


def _spread(model: Model) -> np.ndarray:
    """Standard deviations of the unknowns: the larger of the likelihood's and of the scores of blocks of a second (sandwich)."""
    fit, unknowns = model.fit, model.fit.unknowns
    meat = np.diag(unknowns.believed.astype(float))
    length = model.predictor.block
    for i, (J, e) in enumerate(zip(fit.jacobian, fit.errors, strict=True)):
        own, ny = unknowns.columns(i), e.shape[1]
        first = ny * np.arange(0, max(1, len(e) - length // 2), length)
        g = np.add.reduceat(J * e.ravel()[:, None], first, axis=0)
        meat[np.ix_(own, own)] += g.T @ g
    C = fit.covariance
    return np.sqrt(np.maximum(np.diag(C), np.diag(C @ meat @ C)))


def _sizes(model: Model, key: str) -> dict[str, Estimate]:
    """Sizes and fitted shapes of an effect with 95 % intervals; of one with a phase, its amplitude."""
    unknowns, plant = model.fit.unknowns, model.predictor.plant
    sd, z = _spread(model), model.fit.z
    found = {}
    ends = {j: (v - 1.96 * s, v + 1.96 * s) for j, (v, s) in enumerate(zip(z, sd, strict=True))}
    for t, own in zip(unknowns.terms, unknowns.places, strict=True):
        if t.key == key:
            at = own.start
            for j, width in rough(model.fit, sd).items():
                if at <= j < own.stop:
                    inflation = sd[j] ** 2 / max(model.fit.covariance[j, j], 1e-300)
                    low, high = profile(model.predictor, model.fit, j, width).interval(inflation)
                    ends[j] = (min(low, ends[j][0]), max(high, ends[j][1]))
            if t.phase:
                pair = z[at : at + 2]
                size = float(np.linalg.norm(pair))
                C = model.fit.covariance[at : at + 2, at : at + 2]
                ratio = max(1.0, float(np.max(sd[at : at + 2] ** 2 / np.diag(C))))
                width = 1.96 * float(np.sqrt(ratio * pair @ C @ pair)) / max(size, 1e-300)
                found["amplitude"] = Estimate(size, max(0.0, size - width), size + width, plant.slots[t.sizes[0]].parameter.unit)
            else:
                for j, slot in enumerate(t.sizes):
                    q, value, (low, high) = plant.slots[slot].parameter, float(z[at + j]), ends[at + j]
                    found[q.name] = Estimate(value, max(q.low, float(low)), min(q.high, float(high)), q.unit)
            for j, slot in enumerate(t.free, start=at + len(t.sizes)):
                q, value = plant.slots[slot].parameter, float(unknowns.base[slot])
                now, low, high = (float(value * np.exp(x)) for x in (z[j], *ends[j]))
                found[q.name] = Estimate(now, low, high, q.unit)
            for slot in t.shapes:
                if slot not in t.free:
                    q, value = plant.slots[slot].parameter, float(unknowns.base[slot])
                    found[q.name] = Estimate(value, value, value, q.unit)
    return found


def _parameters(model: Model) -> dict[str, Estimate]:
    unknowns, plant, sd = model.fit.unknowns, model.predictor.plant, _spread(model)
    found = {}
    for j, i in enumerate(unknowns.parameters):
        q, now, wide = plant.parameters[i], float(model.fit.point.p[i]), 1.96 * float(unknowns.sigma[j] * sd[j])
        found[q.name] = Estimate(now, now * float(np.exp(-wide)), now * float(np.exp(wide)), q.unit, q.value)
    return found


def _effects(model: Model) -> EffectSizes:
    """The effects of the extended plant; an effect with a phase has that of the first record."""
    plant, eta = model.predictor.plant, model.fit.point.eta[0]
    return {
        key: {slot.parameter.name: float(eta[i]) for i, slot in enumerate(plant.slots) if slot.key == key} for key in model.keys
    }


def _most_shown(s: Signature) -> float:
    """Smallest for the variant that shows at the smallest size; an actuator's limit shows best where it is highest."""
    return -s.limit if s.variant.key.startswith("saturation@") and np.isfinite(s.limit) else s.limit


def _at(key: str) -> tuple[str, str]:
    """("coulomb", "unwind") of "coulomb@unwind"."""
    effect, place = key.split("@")
    return effect, place


def _limits(plant: Plant, tested: Sequence[Signature]) -> tuple[Limit, ...]:
    return tuple(
        Limit(*_at(s.variant.key), float(s.limit), plant.slots[s.variant.sizes[0]].parameter.unit)
        for s in tested
        if np.isfinite(s.limit) and not _hidden(s)
    )


def _hidden(s: Signature) -> bool:
    """Whether no size that can be meant would show: beyond the effect's bounds, or without any response."""
    return not np.isfinite(s.limit) or np.trace(s.S) < 1e-12 or (not np.isnan(s.variant.finite) and s.S[0, 0] < 1.0)


def _untestable(model: Model, tested: Sequence[Signature]) -> tuple[Untestable, ...]:
    plant = model.predictor.plant
    shown = {s.variant.key for s in tested if not _hidden(s)}
    found = []
    for key in dict.fromkeys(slot.key for slot in plant.slots):
        if key in shown:
            continue
        why = "nothing that it would change was excited in these records"
        if key.startswith(f"{ROUNDED}@"):
            continue
        if not _measurable(model, key):
            why = "this channel was not measured"
        found.append(Untestable(*_at(key), why))
    return tuple(found)


def _remainder(x: Left, whole: float) -> Remainder:
    share = x.statistic / whole
    sentence = f"{x.channel} holds something that varies with {x.variable}: {100 * share:.2g} % of the squared errors"
    return Remainder(x.channel, x.variable, x.p_family, share, sentence, x.grid, x.curve)
