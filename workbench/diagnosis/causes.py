"""What is said of the causes that were found: sizes, evidence, ties, doubts, limits, and the next experiment."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from workbench.diagnosis.answer import (
    NO_SIZE,
    ROUNDED,
    Cause,
    Estimate,
    Evidence,
    Finding,
    Limit,
    NextExperiment,
    Remainder,
    Untestable,
)
from workbench.diagnosis.equations import Law, instead, one_instead
from workbench.diagnosis.experiments import Template, deciding
from workbench.diagnosis.findings import Found, strongest_of
from workbench.diagnosis.lags import Other
from workbench.diagnosis.policy import ALONE, ALPHA, BESIDE, DIGITS, HARM, IDEAL, LAWS, LEFT_OVER, ONE_STEP, TIE, WIDE
from workbench.diagnosis.referee import Judge, harms
from workbench.diagnosis.refit import Model
from workbench.diagnosis.remainder import Left, trajectory
from workbench.diagnosis.rivals import reach, returns
from workbench.diagnosis.rounding import Rounded, limit
from workbench.diagnosis.scan import ONCE
from workbench.diagnosis.screen import Signature, shape_units
from workbench.diagnosis.search import Step, effect_and_place, measurable
from workbench.diagnosis.sizes import beyond_tolerance, sizes_of
from workbench.physics.effects.effect import Domain, GridUnit
from workbench.physics.effects.tank import Tank
from workbench.physics.parameters import Slot
from workbench.physics.plant import Plant

TOGETHER = "without the other causes it explains next to nothing: together they may stand for something else"


def cause_of(plant: Plant, step: Step, model: Model, gains) -> Cause:
    effect, place = step.key.split("@")
    slot = next(s for s in plant.slots if s.key == step.key)
    within = {key: reach(plant, step.key, key, step.gain) for key in step.rivals}
    near = {key: gap * TIE / within[key] for key, gap in step.rivals.items() if gap < within[key]}
    near |= {together: gap for together, gap in step.pairs.items() if gap < TIE}
    weights = {key: float(np.exp(-0.5 * max(gap, 0.0))) for key, gap in near.items()}
    total = 1.0 + sum(weights.values())
    return Cause(
        effect=effect,
        place=place,
        sentence=sentence(plant, slot),
        parameters=_spanning(sizes_of(model, step.key), step.others),
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


def sentence(plant: Plant, slot: Slot) -> str:
    """What a cause is; a static error of a sensor is not told from one of the equation that its output is computed by, nor a
    level that is read from another zero from an outlet that is there.
    """
    said = slot.effect.sentence.format(place=slot.place)
    either = slot.effect.family == "sensor" and not slot.effect.memories and slot.place in plant.computed
    if slot.effect.id == "sensor-bias" and any(isinstance(port, Tank) for port in plant.ports):
        return f"{said} Or the outlet of a tank lies lower or higher by that: records do not tell the two apart."
    return f"{said} Or the plant's own equation of {slot.place} is off: records do not tell the two apart." if either else said


def harm_of(judge: Judge, step: Step) -> str:
    """The error one step or one second ahead that a cause raises most, by more than noise and a share of HARM; empty if none."""
    found = [c for c in harms(judge.between(step.before, step.after)) if c.share < -HARM]
    return str(min(found, key=lambda c: c.share)) if found else ""


def doubted(
    found: Found,
    finding: Finding,
    laws: Mapping[str, Law],
    harm: Mapping[str, str],
    beyond: Sequence[str],
    objections: Sequence[str],
    together: bool,
    wide: Mapping[str, str],
) -> tuple[Finding, dict[str, str]]:
    """The finding, incomplete where anything speaks against a cause that was named, and the doubts about each cause.

    laws, harm: what `law_instead` and `harm_of` say of a cause, by key. beyond: parameters that left their tolerance. objections:
    of the referee against the extended plant. together: whether causes explain next to nothing without each other. wide: what
    `not_dry` says of a cause, by key.
    """
    steps = found.steps
    pairs = {s.key: pair for s in steps for pair, gap in s.pairs.items() if gap < -TIE}
    better = bool(pairs) or any(laws[s.key].gap < -TIE for s in steps if s.key in laws)
    if finding is Finding.NAMED and steps and (beyond or objections or together or better or any(harm.values())):
        finding = Finding.INCOMPLETE
    against = {s.key: said_against(laws[s.key]) if s.key in laws else _not_round(s) for s in steps}
    against |= {key: doubt for key, doubt in wide.items() if not against[key]}
    against |= {key: f"{pair} explain these records better" for key, pair in pairs.items()}
    if finding is Finding.INCOMPLETE and together:
        against = {s.key: TOGETHER for s in steps}
    elif finding is Finding.INCOMPLETE:
        plant = found.base.predictor.plant
        for s in steps:
            argument = plant.argument(effect_and_place(s.key)[1])
            doubt = doubt_about(s, bool(beyond), bool(objections), harm[s.key], found.left, found.without_size, argument)
            against[s.key] = doubt or against[s.key]
    return finding, doubts_of(steps, against)


def only_together(base: Model, steps: Sequence[Step]) -> bool:
    """Whether causes explain next to nothing where one of them is left out: two wrong ones can make up for what has no name."""
    if len(steps) < 2:
        return False
    whole = base.bic - steps[-1].after.bic
    return all(whole - s.gain < ALONE * whole for s in steps)


def doubts_of(steps: Sequence[Step], against: Mapping[str, str]) -> dict[str, str]:
    """What speaks against each cause, empty where nothing does: also one that is not sure, found before it or worth more."""
    doubts = dict(against)
    for j, s in enumerate(steps):
        beside = [o.key for i, o in enumerate(steps) if against[o.key] and (i < j or o.gain > s.gain)]
        if beside and not against[s.key]:
            doubts[s.key] = f"it was found beside {beside[0]}, which is not sure"
    return doubts


def doubt_about(
    step: Step,
    beyond: bool,
    worse_than_given: bool,
    harm: str,
    left: Sequence[Left],
    without_size: Mapping[str, float],
    argument: str = "",
) -> str:
    """What speaks against a cause of an incomplete answer, empty where nothing does.

    beyond: parameters left their tolerance. left: what is left without a name; over the `argument` of the cause's own law it is
    that law in another form. without_size: what effects that show beside the causes seem to explain, though no size of them does.
    """
    if step.stable < LEFT_OVER:
        return "its size differs between the records"
    if worse_than_given:
        return "the extended plant is worse on records that it has not seen than the plant that came"
    if harm:
        return f"it raises an error on records that it has not seen, {harm}"
    if beyond:
        return "it needs parameters far from their data sheet"
    strongest, form = strongest_of(left), strongest_of([x for x in left if x.variable == argument])
    if strongest > BESIDE * step.gain:  # the errors of the model's form are as large, and what has no name may be all there is
        return f"what is left without a name is {100 * strongest / step.gain:.0f} % of what it explains"
    if form > LAWS * step.gain:
        return f"its law has another form: what is left over {argument} is {100 * form / step.gain:.0f} % of what it explains"
    shown = max(without_size, key=lambda key: without_size[key], default="")
    if shown and without_size[shown] > BESIDE * step.gain:
        share = 100 * without_size[shown] / step.gain
        return f"{shown} shows beside it, though not with one size: {share:.0f} % of what it explains"
    return ""


def _not_round(step: Step) -> str:
    """What speaks against what comes back with every turn, where nothing turned once in the records; empty for all else."""
    model, (_, place) = step.after, effect_and_place(step.key)
    slots = [(i, slot) for i, slot in enumerate(model.predictor.plant.slots) if slot.key == step.key]
    if not slots[0][1].effect.phase or place not in model.predictor.plant.turning:
        return ""
    order = next((float(model.fit.point.eta[0, i]) for i, slot in slots if slot.parameter.unit == "1/turn"), 1.0)
    angles = [trajectory(model, i)[f"angle of {place}"] for i in range(len(model.predictor.records))]
    turns = max(float(np.ptp(angle)) for angle in angles) / (2.0 * np.pi)
    if turns * order >= ONCE:
        return ""
    return f"{place} turned {turns:.2g} times only: any torque that changes over its angle looks like that"


def laws_instead(steps: Sequence[Step], model: Model) -> dict[str, Law]:
    """By key, the law in one of the plant's own equations that explains the records as well as a cause, or as causes at one place
    that are laws of the same variable do together.
    """
    laws = {s.key: law for s in steps if (law := law_instead(s, model))}
    slots = {slot.key: slot for slot in model.predictor.plant.slots}
    groups: dict[tuple[str, Domain], list[str]] = {}
    for s in steps:
        groups.setdefault((slots[s.key].place, slots[s.key].effect.domain), []).append(s.key)
    for keys in groups.values():
        if len(keys) > 1 and (law := one_instead(model, keys)) and law.gap < TIE:
            laws |= {key: law for key in keys if key not in laws or law.gap < laws[key].gap}
    return laws


def not_dry(steps: Sequence[Step]) -> dict[str, str]:
    """What speaks against dry friction that turns its sign over a good part of all speeds, and against laws over the same speed
    beside it, by key: such a curve makes up for another one that has no name.
    """
    found: dict[str, str] = {}
    for s in steps:
        plant, place = s.after.predictor.plant, effect_and_place(s.key)[1]
        width = sizes_of(s.after, s.key).get("width")
        if width is None or place not in plant.turning:
            continue
        top = shape_units(s.after.predictor, s.after.fit.point)[GridUnit.SPEED, place]
        if width.low > WIDE * top:
            share = f"{100 * width.value / top:.0f} % of the largest speed at {place}"
            laws = [slot.key for slot in plant.slots if slot.place == place and slot.effect.domain in (Domain.SPEED, Domain.LOAD)]
            found |= {other.key: f"{s.key} beside it is no dry friction" for other in steps if other.key in laws}
            found[s.key] = f"it turns its sign over {share}: dry friction does so at rest"
    return found


def law_instead(step: Step, model: Model) -> Law | None:
    """The law in one of the plant's own equations that explains the records as well as a cause; None where none does.

    A static error of a sensor stands far from where such a law acts: there one that may explain them as well is as likely, though
    it is fitted at noise levels that suit the cause.
    """
    effect = next(slot.effect for slot in model.predictor.plant.slots if slot.key == step.key)
    static = effect.family == "sensor" and not effect.memories
    law = instead(model, step.key)
    return law if law and law.gap < (max(TIE, ONE_STEP * step.gain) if static else TIE) else None


def said_against(law: Law) -> str:
    """What a law in the plant's own equations says against a cause."""
    return f"{law}: {'that explains these records better' if law.gap < -TIE else 'these records do not tell the two apart'}"


def _spanning(sizes: dict[str, Estimate], others: Sequence[Other]) -> dict[str, Estimate]:
    """Sizes whose first, a time where it has others, has an interval that holds those of the other times too."""
    if not others:
        return sizes
    name, found = next(iter(sizes.items()))
    low, high = (end(getattr(own, side) for own in (found, *others)) for end, side in ((min, "low"), (max, "high")))
    return sizes | {name: replace(found, low=max(low, 0.0), high=high)}


def exchanges(steps: Sequence[Step]) -> list[str]:
    """A sentence for every time that may have changed places with a time constant of the machine."""
    return [
        f"{s.key}: {' or '.join(f'{o.time:.3g} s' for o in s.others)} explains these records as well, with other parameters "
        "of the machine: its time and the machine's can change places, and only a parameter that is known better decides"
        for s in steps
        if s.others
    ]


def instead_of_parameters(steps: Sequence[Step]) -> list[str]:
    """A sentence for each cause that takes the place of parameters far from their data sheet, which explain the same."""
    return [
        f"{s.key} takes the place of a parameter, the records alone do not tell the two apart: without it "
        + " and ".join(beyond_tolerance(s.before, s.before))
        for s in steps
        if returns(s.before, s.after) and s.gain - (s.before.beyond - s.after.beyond) < max(TIE, IDEAL * s.gain)
    ]


def rounded_cause(plant: Plant, r: Rounded) -> Cause:
    """A rounded channel as a cause: it gains nothing in prediction, it says how good a prediction can be."""
    slot = next(s for s in plant.slots if s.effect.id == ROUNDED and s.place == r.channel)
    step = Estimate(r.step, r.step * (1.0 - DIGITS), r.step * (1.0 + DIGITS), r.unit)
    evidence = Evidence(float(r.samples), 0.0, 1.0)
    return Cause(ROUNDED, r.channel, slot.effect.sentence.format(place=r.channel), {slot.parameter.name: step}, (), evidence)


def rounding_limits(base: Model) -> tuple[Limit, ...]:
    outputs = base.predictor.plant.outputs
    return tuple(
        Limit(ROUNDED, channel.name, limit(base.predictor, j), channel.unit)
        for j, channel in enumerate(outputs)
        if base.predictor.measured[j]
    )


def next_experiment(steps: Sequence[Step], templates: Sequence[Template]) -> NextExperiment | None:
    """The experiment that decides the closest tie; None where nothing ties."""
    for step in steps:
        if step.rival:
            slot = next(s for s in step.after.predictor.plant.slots if s.key == step.key)
            return deciding(step.after, step.rival.model, (step.key, step.rival.key), templates, slot.effect.separates)
    return None


def limits_of(plant: Plant, tested: Sequence[Signature]) -> tuple[Limit, ...]:
    return tuple(
        Limit(*effect_and_place(s.variant.key), float(s.limit), plant.slots[s.variant.sizes[0]].parameter.unit)
        for s in tested
        if np.isfinite(s.limit) and not _hidden(s)
    )


def _hidden(s: Signature) -> bool:
    """Whether no size that can be meant would show: beyond the effect's bounds, or without any response."""
    return not np.isfinite(s.limit) or not s.responds or (not np.isnan(s.variant.finite) and s.S[0, 0] < 1.0)


def untestable_effects(model: Model, tested: Sequence[Signature]) -> tuple[Untestable, ...]:
    plant = model.predictor.plant
    shown = {s.variant.key for s in tested if not _hidden(s)}
    unsure = {s.variant.key for s in tested if np.isinf(s.checked)}
    found = []
    for key in plant.effect_keys:
        if key in shown:
            continue
        why = NO_SIZE if key in unsure else "nothing that it would change was excited in these records"
        if key.startswith(f"{ROUNDED}@"):
            continue
        if not measurable(model, key):
            why = "this channel was not measured"
        found.append(Untestable(*effect_and_place(key), why))
    return tuple(found)


def remainder_said(x: Left, whole: float) -> Remainder:
    share = x.statistic / whole
    sentence = f"{x.channel} holds something that varies with {x.variable}: {100 * share:.2g} % of the squared errors"
    return Remainder(x.channel, x.variable, x.p_family, share, sentence, x.grid, x.curve)
