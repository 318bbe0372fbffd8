"""The search for causes: one effect after the other, then without what others make superfluous, then with rivals in their place.

screen -> shortlist -> refit -> confirm -> extend, again while something is found -> drop and swap
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from workbench.diagnosis.answer import ROUNDED
from workbench.diagnosis.confirm import folds, left_out, stability
from workbench.diagnosis.detection import holding
from workbench.diagnosis.gains import ahead
from workbench.diagnosis.lags import Other, timed
from workbench.diagnosis.policy import (
    ALIKE,
    ALPHA,
    FINALISTS,
    FREED,
    LEFT_OVER,
    LIKE_THE_FIRST,
    LOCAL,
    MOST,
    NEARLY,
    PRACTICAL,
    RIVALS,
    SAME_CURVE,
    SWAP,
    TIE,
    WORTH,
)
from workbench.diagnosis.refit import (
    LEFT,
    Model,
    begun_beside,
    from_special,
    is_late,
    refits,
    settled,
    shortlist,
    stepped,
    without,
)
from workbench.diagnosis.rivals import Rival, best_first, close_rivals, gap_between, is_case_of, returns, rivals_of
from workbench.diagnosis.rounding import rounded
from workbench.diagnosis.screen import Score, Signature, scores, signatures, similarity, small_sizes, variants
from workbench.physics.effects.effect import Domain
from workbench.physics.parameters import Slot
from workbench.physics.plant import Plant
from workbench.records import field, record

PLAY, RESONANCE = "backlash", "sensor-resonance"


@record
class Step:
    """A cause as it was accepted: models before and after, its score, rivals by BIC, and how it held on what was left out.

    others: times that suit the records as well as that of `after`, where a lag and a time constant can change places.
    pairs: BIC by which two effects together, "a + b", are worse.
    """

    key: str
    before: Model
    after: Model
    score: Score
    rivals: dict[str, float]
    gain: float
    stable: float
    tying: tuple[Rival, ...] = ()  # rivals that tie, the closest first
    others: tuple[Other, ...] = ()
    pairs: Mapping[str, float] = field(default_factory=dict)

    @property
    def rival(self) -> Rival | None:
        """The closest one that ties."""
        return self.tying[0] if self.tying else None


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
class Unresolved:
    """An effect that shows beside what was found, but that no size explains; statistic: what it seemed to explain."""

    key: str
    statistic: float

    def __str__(self) -> str:
        return f"{self.key} shows in these records, but no size of it explains them: something like it is missing"


class Search:
    """A greedy path through the catalogue; remembers the steps of its differences and the first screen."""

    def __init__(self, keys: Sequence[str], sizes: np.ndarray, most: float, progress: Callable[[str], None]):
        self.keys, self.most, self.progress = list(dict.fromkeys(keys)), most, progress
        self.lesser = Lesser(sizes)
        self.tested: list[Signature] = []
        self.local: Local | None = None
        self.unresolved: Unresolved | None = None
        self.stuck = False  # whether a cause was chosen by a fit that was stuck

    def path(self, base: Model, steps: Sequence[Step] = (), hidden: Sequence[str] = ()) -> tuple[Model, list[Step]]:
        """One effect after the other, as long as something is found; and the base. steps: where it goes on. hidden: effects that
        are tried first, whatever their scores.

        A model that is less likely than the one with an effect, freed of it again, was stuck: the effect has led its parameters
        out, and counts for what it gains beside the better model.
        """
        steps, freed = list(steps), 0
        while len(steps) < MOST:
            model = steps[-1].after if steps else base
            self.progress(f"screening beside {', '.join(model.keys)}" if steps else "screening")
            found = self.screened(model)
            if hidden:
                found, hidden = [replace(s, p_family=0.0) for s in found if s.key in hidden], ()
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
            self.lesser = Lesser(small_sizes(model.predictor, model.fit))
        found = screen_effects(model, [k for k in self.keys if k not in model.keys], self.lesser.sizes, columns=first)
        if first:
            self.tested = holding(model.predictor, model.fit, [min(s.all, key=_most_shown) for s in found])
        return found


def screen_effects(model: Model, keys: Sequence[str], sizes: np.ndarray, *, columns: bool = False) -> list[Score]:
    """Score tests of the effects `keys` that the channels of the records could show."""
    tried = variants(model.predictor, model.fit, [k for k in keys if measurable(model, k)], sizes)
    felt = [v for v in tried if not np.isnan(v.finite) or all(sizes[s] > 0.0 for s in v.sizes)]
    return scores(signatures(model.predictor, model.fit, felt, sizes, columns=columns))


def measurable(model: Model, key: str) -> bool:
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
    lesser: "Lesser",
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
    race = _Race(model, short, sizes)
    trials, near, finals = race.trials, race.near, race.finals()
    worthy = [(m, s) for m, s in finals if _worthy(model, m, s.key, steps, most)]
    behind = (pair for pair in trials[1:] if pair[1].key not in near)

    def holds(m: Model, s: Score) -> bool:
        # what shows by no score of its own is a cause only where nothing explains more
        if (s.p_family >= ALPHA and m is not finals[0][0]) or _is_rounding(m, s.key):
            return False
        gain = left_out(model, m)
        return gain.holds or (returns(model, m) and not gain.loses)

    while not any(holds(m, s) for m, s in worthy) and (pair := next(behind, None)):
        # what came first holds in some records only: another cause may hold in all
        near.add(pair[1].key)
        tried = race.final(*pair)
        worthy += [(tried, pair[1])] if _worthy(model, tried, pair[1].key, steps, most) else []
    held = [(m, s) for m, s in worthy if holds(m, s)]
    named = [(m, s) for m, s in worthy if not _is_rounding(m, s.key)]
    if not named and np.isfinite(most):
        # what the likelihood puts first helps nothing a second ahead: what it puts behind may
        tried, significant = {s.key for s in short}, [s for s in found if s.p_family < ALPHA]
        if rest := [s for s in significant if s.key not in tried]:
            return _step(model, rest, lesser, steps, most, progress)
    if not held:
        told = (
            _local(model, m, s.key)
            for m, s in named
            if (model.bic - m.bic > LOCAL or s.p_family < LEFT_OVER) and lesser.of(m, s.key).bic - m.bic > WORTH
        )
        return next(told, None)
    best, score = held[0]
    tying = rivals_of(model, best, score.key, [*worthy, *((m, s) for m, s in finals if _as_form(model, m, s.key, steps, most))])
    rivals = {s.key: gap_between(model, best, score.key, m, s.key) for m, s in tying}
    rivals |= {s.key: m.bic - race.first.bic for m, s in trials if s.key not in near and s.key != score.key}
    return Step(
        score.key,
        model,
        best,
        score,
        rivals,
        model.bic - best.bic,
        stability(best, score.key),
        close_rivals(model, best, score.key, tying),
        race.others[score.key],
    )


class _Race:
    """A model extended by one of several effects each: first fits, those that may be the best, and these fitted to convergence.

    trials: the best of the first fits, then the others, begun beside it too, best first. near: keys of those with a chance.
    first: the best of the first fits, converged. others: times of a late effect that explain the records as well, by key.
    """

    def __init__(self, model: Model, short: Sequence[Score], sizes: np.ndarray):
        self.model, self.short, self.sizes = model, short, sizes
        self.others: dict[str, tuple[Other, ...]] = {}
        self.trials = refits(model, short, sizes)
        self.first = self.final(*self.trials[0])
        # what looks alike must not differ by the way that its noise levels went: all begin where the first one ended, too
        others = [(begun_beside(m, self.first, sizes), s) for m, s in self.trials[1:]]
        self.trials[1:] = sorted(others, key=lambda pair: pair[0].bic)
        self.near = self._near()

    def _near(self) -> set[str]:
        first, best = self.trials[0]
        slack = max(3.0 * TIE, NEARLY * (self.model.bic - first.bic))
        ranked = sorted(self.trials, key=lambda pair: pair[0].bic)
        near = {best.key} | {s.key for m, s in ranked[:FINALISTS] if m.bic < first.bic + slack}
        near |= _alike(self.model, [s for _, s in self.trials], self.sizes)
        if self.model.farthest > LEFT:
            # first fits stay where parameters have made up for a sensor that is late: its profile does not
            near |= {s.key for s in self.short if is_late(self.model.predictor, s.key)}
        return near

    def final(self, trial: Model, score: Score, beside: Model | None = None) -> Model:
        """A first fit, converged; beside: see `settled`."""
        found = timed(self.model, settled(trial, self.sizes, beside), score.key, self.sizes)
        self.others[score.key] = found.others
        return found.model

    def finals(self) -> list[tuple[Model, Score]]:
        """What has a chance, converged, best first."""
        plant, first = self.model.predictor.plant, self.first
        finals = [(first, self.trials[0][1])]
        finals += [(self.final(t, s), s) for t, s in self.trials[1:] if s.key in self.near]
        for special, s in list(finals):  # a law that fits worse than its special case is not fitted yet
            for general in (g for g in self.short if is_case_of(plant, s.key, g.key)):
                begun = from_special(special, self.model, general, self.sizes)
                if begun.bic < special.bic + TIE:
                    finals.append((self.final(begun, general), general))
                    self.near.add(general.key)
        finals = best_first(finals)
        best = finals[0][0]
        if best is not first:  # nor by where the first one ended if another has come out best
            near = [(m, s) for m, s in finals[1:] if m.bic < best.bic + SWAP]
            finals = best_first([*finals, *((self.final(m, s, best), s) for m, s in near)])
        return _alike_stepped(finals, self.sizes)


def _alike_stepped(finals: Sequence[tuple[Model, Score]], sizes: np.ndarray) -> list[tuple[Model, Score]]:
    """Models, best first, of which those that come near the best one have as many integrator steps as any of these."""
    near = finals[0][0].bic + SWAP
    finest = max(m.predictor.substeps for m, _ in finals if m.bic <= near)
    return best_first([(stepped(m, finest, sizes) if m.bic <= near else m, s) for m, s in finals])


def _worthy(before: Model, after: Model, key: str, steps: Sequence[Step], most: float) -> bool:
    """Whether an effect would be a cause beside those of `steps`: worth its numbers, of practical size, and its own."""
    gain = before.bic - after.bic
    return (
        after.sound
        # also where the parameters' moves within their tolerance are paid for: what needs them to move is no cause
        and min(gain, gain + before.within - after.within) >= WORTH
        and _practical(before, after)
        and _of_its_own(before.predictor.plant, key, gain, steps)
        and not _is_alias(after, key)
        and (np.isinf(most) or ahead(before, after) <= most)
    )


def _as_form(before: Model, after: Model, key: str, steps: Sequence[Step], most: float) -> bool:
    """Whether only its place speaks against an effect, where an earlier cause is whose form it may be: no cause, but a rival."""
    own = _of_its_own(before.predictor.plant, key, before.bic - after.bic, steps)
    return not own and _worthy(before, after, key, (), most)


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
    places = {effect_and_place(s.key)[1] for s in slow if s.key in keys}
    if places:
        slow = [s for s in slow if effect_and_place(s.key)[1] in places]
    elif not (late & keys or (not keys and model.farthest > LEFT)):
        slow = []
    return short + [s for s in slow if s.key not in keys]


def _with_family(plant: Plant, short: list[Score], found: Sequence[Score]) -> list[Score]:
    """The shortlist with the special cases of its effects, and with the laws that these are special cases of.

    What a law with more numbers explains, it may explain with fewer: then its significance is that of the law that brings it in.
    """
    keys, whole = {s.key for s in short}, list(short)
    for s in found:
        by = [general.p_family for general in short if is_case_of(plant, s.key, general.key)]
        if s.key not in keys and by:
            whole.append(replace(s, p_family=min(by)))
    special = [s.key for s in whole]
    keys |= set(special)
    return whole + [s for s in found if s.key not in keys and any(is_case_of(plant, key, s.key) for key in special)]


def _alike(model: Model, found: Sequence[Score], sizes: np.ndarray) -> set[str]:
    """Keys of the effects whose signatures are those of the first one, but for a share of 1 - ALIKE."""
    made = signatures(model.predictor, model.fit, [s.best.variant for s in found], sizes, columns=True)
    return {s.variant.key for s, share in zip(made, similarity(made)[:, 0], strict=True) if share > ALIKE}


def _is_rounding(model: Model, key: str) -> bool:
    """Whether the play of a sensor is less than the step that its readings are rounded to: rounding looks like play.

    Then it is not named; but what it explains as well as another cause may be it.
    """
    effect, place = effect_and_place(key)
    if effect != PLAY:
        return False
    size = max(abs(float(model.fit.point.eta[0, i])) for i, slot in enumerate(model.predictor.plant.slots) if slot.key == key)
    return any(r.channel == place and size < r.step for r in rounded(model.predictor))


def _is_alias(model: Model, key: str) -> bool:
    """Whether a sensor rings on from sample to sample with more than one turn in each: its frequency is not in such records."""
    if effect_and_place(key)[0] != RESONANCE:
        return False
    plant = model.predictor.plant
    at = {slot.parameter.name: float(model.fit.point.eta[0, i]) for i, slot in enumerate(plant.slots) if slot.key == key}
    return 2.0 * np.pi * at["time"] < plant.dt < at["time"] / at["damping"]


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


class Lesser:
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
        met = (stepped(m, less.predictor.substeps, self.sizes) for m in self.met if set(m.keys) == set(less.keys))
        less = min((less, *met), key=lambda m: m.deviance)
        self.made.append((model, key, less))
        return less


def kept(base: Model, steps: list[Step], lesser: Lesser, most: float) -> list[Step]:
    """Steps that none of their rivals replaces and none of the others makes superfluous; what ties beside all is not what ties
    beside fewer.
    """
    while True:
        steps = _swapped(steps, lesser, most)
        kept = pruned(base, steps, lesser)
        if len(kept) == len(steps):
            return kept
        steps = facing(kept, {s.key for s in steps} - {s.key for s in kept})


def facing(steps: Sequence[Step], dropped: Iterable[str]) -> list[Step]:
    """Steps that are to be compared, first of all, with what no longer stands beside them."""
    return [replace(s, rivals=s.rivals | dict.fromkeys(dropped, 0.0)) for s in steps]


def _swapped(steps: list[Step], lesser: Lesser, most: float) -> list[Step]:
    """Steps of which none gives way to one of its rivals beside all others; what came first was chosen without them."""
    steps, model, sizes = list(steps), steps[-1].after, lesser.sizes
    for j, step in enumerate(steps):
        rivals = [key for key in sorted(step.rivals, key=lambda key: step.rivals[key]) if key not in model.keys][:RIVALS]
        if not rivals or not (less := lesser.of(model, step.key)).sound:
            continue
        others = steps[:j] + steps[j + 1 :]
        found = screen_effects(less, [*rivals, step.key], sizes)
        trials = refits(less, found, sizes) if found else []
        # the cause stands where it was found: it begins anew as its rivals do, and where the best of them has come to
        anew = [timed(less, settled(m, sizes, model), step.key, sizes) for m, s in trials if s.key == step.key]
        if anew and anew[0].model.bic < model.bic:
            model, step = anew[0].model, replace(step, others=anew[0].others)
        trials = [(m, s) for m, s in trials if s.key != step.key]
        # a first fit lies far behind where noise levels do not suit it yet, but all that have a chance lie behind alike
        near = [(m, s) for m, s in trials if m.bic < trials[0][0].bic + SWAP and m.bic < 0.5 * (less.bic + model.bic)]
        tried = [(timed(less, settled(m, sizes, model), s.key, sizes), s) for m, s in near]
        best = min((t.model for t, _ in tried), key=lambda m: m.bic, default=model)
        if best.bic < model.bic:
            again = timed(less, settled(model, sizes, best), step.key, sizes)
            if again.model.bic < model.bic:
                model, step = again.model, replace(step, others=again.others)
        times = {s.key: t.others for t, s in tried} | {step.key: step.others}
        # rivals that have fitted better where they were first tried are not forgotten
        before = [(own.model, s) for own in step.tying for s in found if s.key == own.key]
        before = [(m, s) for m, s in before if {*m.keys} == {*less.keys, s.key}]
        alike = _alike_stepped(best_first([(model, step.score), *((t.model, s) for t, s in tried), *before]), sizes)
        model = next(m for m, s in alike if s is step.score)
        finals = [(m, s) for m, s in alike if s is step.score or _worthy(less, m, s.key, others, most)]
        better = [(m, s) for m, s in finals if m.bic < model.bic and not _is_rounding(m, s.key) and left_out(less, m).holds]
        model, score = min(better, key=lambda pair: pair[0].bic, default=(model, step.score))
        forms = [(m, s) for m, s in alike if s is not step.score and _as_form(less, m, s.key, others, most)]
        tying = rivals_of(less, model, score.key, [*finals, *forms])
        # what does not tie beside these may tie beside fewer
        gaps = dict.fromkeys(step.rivals, np.inf) | {s.key: gap_between(less, model, score.key, m, s.key) for m, s in tying}
        close = close_rivals(less, model, score.key, tying)
        pairs = step.pairs if score.key == step.key else {}
        steps[j] = replace(step, key=score.key, score=score, rivals=gaps, tying=close, others=times[score.key], pairs=pairs)
    steps[-1] = replace(steps[-1], after=model)
    return steps


def pruned(base: Model, steps: list[Step], lesser: Lesser) -> list[Step]:
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


def _most_shown(s: Signature) -> float:
    """Smallest for the variant that shows at the smallest size; an actuator's limit shows best where it is highest."""
    return -s.limit if s.is_level and np.isfinite(s.limit) else s.limit


def effect_and_place(key: str) -> tuple[str, str]:
    """("coulomb", "unwind") of "coulomb@unwind"."""
    effect, place = key.split("@")
    return effect, place
