"""What a search found, and what of it stands before the referee."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from workbench.diagnosis.answer import Finding
from workbench.diagnosis.combinations import united
from workbench.diagnosis.free_run import simulated
from workbench.diagnosis.lags import FAR
from workbench.diagnosis.policy import ALPHA, LAWS, LEFT_OVER, LONG_RUN, MATTERS, MATTERS_ALONE, PRACTICAL, UNTOLD
from workbench.diagnosis.referee import Judge, harms, helps, worse
from workbench.diagnosis.refit import FEW_SENSORS, Model
from workbench.diagnosis.remainder import Left, label, remainder
from workbench.diagnosis.rivals import returns
from workbench.diagnosis.screen import Signature
from workbench.diagnosis.search import PLAY, Lesser, Local, Search, Step, Unresolved, facing, kept
from workbench.diagnosis.sizes import sizes_of
from workbench.records import record

TRIFLE = "would explain a little more, but takes no error down by a share that matters"

NONE = "would explain these records at a size that they do not tell from none"


@record
class Refused:
    """An effect that the search took for a cause and the referee does not; gain: BIC beside the others."""

    key: str
    why: str
    gain: float

    def __str__(self) -> str:
        return f"{self.key} {self.why}"


@record
class Found:
    """What a search found: the base model, the steps from it, what is left, and the signatures of all effects at the base.

    refused: effects that held on the records of the search, but are no causes: see `judged`.
    """

    base: Model
    steps: tuple[Step, ...]
    left: tuple[Left, ...]
    tested: tuple[Signature, ...]
    lesser: "Lesser"
    most: float  # see `searched`
    local: Local | None = None
    refused: tuple[Refused, ...] = ()
    unresolved: Unresolved | None = None
    runs: Model | None = None  # the base with parameters of the free run, where nothing is named and they are better

    @property
    def model(self) -> Model:
        return self.steps[-1].after if self.steps else self.runs or self.base

    @property
    def without_size(self) -> dict[str, float]:
        """What effects seem to explain beside the causes, though no size of them does in all records, by key."""
        local = {self.local.key: self.local.gain} if self.local else {}
        shown = local | ({self.unresolved.key: self.unresolved.statistic} if self.unresolved else {})
        return {key: value for key, value in shown.items() if key not in self.model.keys}

    @property
    def finding(self) -> Finding:
        found = _finding(self.steps, self.left, self.model)
        told = LAWS * sum(s.gain for s in self.steps)
        odd = self.local is not None and self.local.gain > told
        # all is not well, whatever the remainder is like; what takes no error down by a share that matters takes nothing away
        if odd or any(r.gain > told and not (self.steps and r.why == TRIFLE) for r in self.refused):
            return {Finding.NOTHING: Finding.UNKNOWN, Finding.NAMED: Finding.INCOMPLETE}.get(found, found)
        return found


def forgiven(judge: Judge, found: Found) -> bool:
    """Whether a model in which nothing is missing one step ahead is far from the best that its parameters can do in free runs."""
    runs = simulated(found.base) if found.finding is Finding.NOTHING else None
    return runs is not None and judge.longer(found.base, runs) < 1.0 - LONG_RUN


def with_free_runs(found: Found, given: Model, judge: Judge) -> Found:
    """With parameters and sizes that are fitted to free runs, where these err less a second and the full run ahead.

    given: the plant as it came.
    """
    model = judge.better_ahead(given, found.model)
    if model is found.model:
        return found
    if not found.steps:
        return replace(found, runs=model)
    steps = tuple(replace(s, before=simulated(s.before) or s.before, after=model) for s in found.steps)
    unsure = [s for s, run in zip(found.steps, steps, strict=True) if _none(run)]
    if unsure:
        return with_free_runs(_dropped(found, min(unsure, key=lambda s: s.gain), NONE), given, judge)
    return replace(found, steps=steps)


def searched(base: Model, most: float, progress: Callable[[str], None]) -> Found:
    """Search from a recalibrated model, drop, and look at what is left.

    most: errors a second ahead, after over before, of every cause. Without coloured torques, and in free runs, everything is
    significant: there only what a second ahead shows counts.
    """
    plant = base.predictor.plant
    search = Search([slot.key for slot in plant.slots], np.zeros(len(plant.slots)), most, progress)
    base, steps = search.path(base)
    if played := _followed_play(steps[-1].after if steps else base):
        base, steps = search.path(base, steps, played)
    lesser = search.lesser
    if len(steps) > 1 or search.stuck:
        progress("dropping and swapping")
        steps = united(base, kept(base, steps, lesser, most), lesser)
    progress("what is left")
    left = remainder(steps[-1].after if steps else base)
    return Found(base, tuple(steps), tuple(left), tuple(search.tested), lesser, most, search.local, unresolved=search.unresolved)


def _followed_play(model: Model) -> list[str]:
    """Plays of sensors in which something is left that may be theirs.

    Where there are few sensors a filter takes what play does for pushes and follows it: no score one step ahead shows it.
    """
    left, predictor = {x.channel for x in remainder(model) if x.p_family < ALPHA}, model.predictor
    places = {slot.key: label(("sensor", slot.place)) for slot in predictor.plant.slots if slot.effect.id == PLAY}
    keys = [key for key, place in places.items() if place in left and key not in model.keys]
    return keys if keys and not predictor.simulated and np.sum(predictor.measured) <= FEW_SENSORS else []


def tells(local: Local | None, again: Found) -> bool:
    """Whether what another search names first is what an effect in some records only has told already."""
    if local is None:
        return False
    slots = {slot.key: slot for slot in again.base.predictor.plant.slots}
    one, other = slots[local.key], slots[again.steps[0].key]
    return one.place == other.place and one.effect.domain is other.effect.domain


def judged(found: Found, judge: Judge, *, longer: bool) -> Found:
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


def _dropped(found: Found, step: Step, why: str) -> Found:
    """Without a step that is no cause; the others are fitted again."""
    rest = facing([replace(s, after=step.before) for s in found.steps if s is not step], [step.key])
    steps = united(found.base, kept(found.base, rest, found.lesser, found.most), found.lesser) if rest else []
    left = remainder(steps[-1].after if steps else found.base)
    return replace(found, steps=tuple(steps), left=tuple(left), refused=(*found.refused, Refused(step.key, why, step.gain)))


def _objection(step: Step, first: bool, strongest: float, judge: Judge, longer: bool) -> str:
    """Why an effect is no cause; empty where nothing speaks against it. strongest: statistic of what is left without a name."""
    found = judge.between(step.before, step.after)
    if step.gain < strongest:
        return "would explain part of it, but more is left beside it than it explains"
    if _none(step):
        return NONE
    ahead_of = any(c.sure and c.share > 0.0 for c in found if c.ahead)
    surprised = not ahead_of if longer else judge.held_out and judge.surprise(step.before, step.after) >= 0.0
    returned = returns(step.before, step.after) and not harms(found)
    if surprised and not returned and not _helps_free_runs(step, judge):
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
    return all(e.low <= 0.0 <= e.high for name, e in sizes_of(step.after, step.key).items() if name not in _shapes(step))


def _shapes(step: Step) -> set[str]:
    slots = step.after.predictor.plant.slots
    return {slot.parameter.name for slot in slots if slot.key == step.key and slot.parameter.shape}


def with_rounding(found: Found, channels: Sequence[str]) -> Finding:
    """The finding where `channels` are rounded: what is left in their readings only has its name."""
    left = {x.channel for x in found.left if x.p_family < ALPHA}
    if channels and not found.steps and not found.local and left <= {label(("sensor", name)) for name in channels}:
        return Finding.NAMED
    return found.finding


def _finding(steps: Sequence[Step], left: Sequence[Left], model: Model) -> Finding:
    worst = min((x.p_family for x in left), default=1.0)
    if not steps:
        return Finding.UNKNOWN if worst < ALPHA and _visible(left, model) else Finding.NOTHING
    strongest = strongest_of(left)
    if strongest > LAWS * sum(s.gain for s in steps) and _visible(left, model):
        unstable = any(s.stable < LEFT_OVER for s in steps)
        return Finding.UNKNOWN if strongest > UNTOLD * sum(s.gain for s in steps) and unstable else Finding.INCOMPLETE
    return Finding.INCOMPLETE if any(s.stable < LEFT_OVER for s in steps) else Finding.NAMED


def strongest_of(left: Sequence[Left]) -> float:
    """Statistic of what is left for sure beside causes."""
    return max((x.statistic for x in left if x.p_family < LEFT_OVER), default=0.0)


def _visible(left: Sequence[Left], model: Model) -> bool:
    """Whether what is left is of practical size."""
    return max(x.statistic for x in left) > PRACTICAL * model.predictor.samples
