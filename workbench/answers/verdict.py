"""The words of a diagnosis: the verdict first and what it means, then causes, what they gain, limits, and what to do next."""

from collections.abc import Sequence

import numpy as np

from workbench.diagnosis.answer import NO_SIZE, ROUNDED, Cause, Diagnosis, Finding, Gain, Limit
from workbench.diagnosis.stages import StageError

MOST_DIGITS = 10
HEADLINES = {
    Finding.NAMED: "NAMED: what the simulation of {plant} lacks has a name and a size; mend the machine, or go on with the "
    "extended plant.",
    Finding.NOTHING: "NOTHING: these records show nothing that the simulation of {plant} lacks; trust it within their limits.",
    Finding.UNKNOWN: "UNKNOWN: the simulation of {plant} lacks something that no effect of the catalogue explains; do not "
    "build on it before that is found.",
    Finding.INCOMPLETE: "INCOMPLETE: causes are named, and something is left that no further effect of the catalogue explains; "
    "use what is named, and look at what is left.",
}
#: The headline of causes of which not all are sure; sure: those that are, if any.
UNSURE = (
    "INCOMPLETE: what the simulation of {plant} lacks is explained in part; {sure}. Mend nothing for the sake of what is not "
    "sure, and look at what is left."
)
#: The headline of what is named, where rivals or a law in the plant's own equations explain it as well.
TIED = (
    "NAMED, with a tie: what the simulation of {plant} lacks has a size, and more than one name that these records cannot tell "
    "apart; go on with the extended plant, and tell the causes apart before mending the machine."
)
#: What an all-clear is asked about first, in plain words.
COMMON = {"coulomb": "dry friction", "offset": "an offset", "input-delay": "a dead time", "sensor-gain": "a wrong scale"}


def verdict(found: Diagnosis, held_out: bool, errors: Sequence[StageError] = ()) -> str:
    """All sentences in one paragraph."""
    return " ".join(sentences(found, held_out, errors))


def sentences(found: Diagnosis, held_out: bool, errors: Sequence[StageError] = ()) -> list[str]:
    """The verdict and what it means, what is missing, how large, how sure, what naming it gains, and what to do next."""
    said = [_headline(found), *map(ended, found.signs)]
    if found.finding is Finding.NOTHING:
        said.append(reach(found))
    else:
        said += [_named(cause, held_out) for cause in found.causes]
    if staged := _staged(errors, held_out):
        said.append(staged)
    if found.compared:
        said.append(ended(found.compared))
    if found.finding in (Finding.UNKNOWN, Finding.INCOMPLETE) and found.remainder:
        said.append(ended(found.remainder[0].sentence))
    said.append(next_step(found))
    return [sentence for sentence in said if sentence]


def _headline(found: Diagnosis) -> str:
    """What was found, and whether it is sure."""
    if found.finding is Finding.NAMED and any(cause.ties or cause.doubt for cause in found.causes):
        return TIED.format(plant=found.plant)
    if any(cause.doubt for cause in found.causes):
        sure = [cause.key for cause in found.causes if not cause.doubt and cause.effect != ROUNDED]
        apart = ", the rounding of readings apart" if any(cause.effect == ROUNDED for cause in found.causes) else ""
        which = f"sure is {' and '.join(sure)}" if sure else f"none of the causes below is sure{apart}"
        return UNSURE.format(plant=found.plant, sure=which)
    return HEADLINES[found.finding].format(plant=found.plant)


def advice(found: Diagnosis, handed_out: bool) -> str:
    """What to do, in a technician's words; handed_out: whether the extended plant is."""
    if not handed_out:
        said = " ".join(ended(cause.sentence) for cause in found.causes[:2])
        return f"Keep the plant as it was: what was found makes it worse on records. {said}".rstrip()
    if found.finding is Finding.NOTHING:
        return "Trust the simulation: within what these records can show it lacks nothing."
    if not found.causes:
        return "Do not build on this simulation yet: it lacks something that has no name here."
    sure = [cause for cause in found.causes if not cause.doubt and not cause.ties]
    said = " ".join(ended(cause.sentence) for cause in (sure or found.causes)[:2])
    if not sure:
        rivals = [key for cause in found.causes for key in cause.ties]
        apart = f"tell it from {' and '.join(rivals[:2])}" if rivals else "make it sure"
        return f"Perhaps: {said} Go on with the extended plant, but {apart} before you mend the machine."
    more = " Something more is missing: look at what is left." if found.finding is Finding.INCOMPLETE else ""
    return f"{said} Mend that, or go on with the extended plant.{more}"


def _named(cause: Cause, held_out: bool) -> str:
    """The cause with its size, what speaks against it, its gain and its rivals."""
    said = [stated(cause)]
    if best := _best_gain(cause.gains):
        change = f"from {best.before:.3g} to {best.after:.3g}{_unit(best.unit)}"
        said.append(
            f"With the parameters recalibrated it takes the {best.horizon} error of {best.channel} on {where(held_out)} {change}."
        )
    if cause.ties:
        rivals = ", ".join(f"{key} ({100 * weight:.0f} %)" for key, weight in cause.ties.items())
        said.append(f"These records cannot tell it ({100 * cause.evidence.posterior:.0f} %) from {rivals}.")
    return " ".join(said)


def stated(cause: Cause) -> str:
    """What a cause is, its size, and what speaks against it."""
    doubt = f" Not sure: {ended(cause.doubt)}" if cause.doubt else ""
    return f"{ended(cause.sentence)} {cause.key}: {sizes(cause)}.{doubt}"


def sizes(cause: Cause) -> str:
    """The numbers of a cause with 95 % intervals and units."""
    said = []
    for name, e in cause.parameters.items():
        value, low, high = _told((e.value, e.low, e.high))
        interval = "held, not estimated" if e.low == e.high else f"95 %: {low} to {high}"
        said.append(f"{name} {value}{_unit(e.unit)} ({interval})")
    return ", ".join(said)


def _told(numbers: tuple[float, float, float]) -> list[str]:
    """A value and the ends of its interval, in as many digits as tell these from each other, four at least."""
    width, size = numbers[2] - numbers[1], max(map(abs, numbers))
    digits = 4 if not 0.0 < width < np.inf else int(np.clip(np.ceil(np.log10(size / width)) + 2, 4, MOST_DIGITS))
    return [f"{number:.{digits}g}" for number in numbers]


def _staged(errors: Sequence[StageError], held_out: bool) -> str:
    """The full-run error of the channel that gains most, as a mean over records, at each stage."""
    means = []
    for name in dict.fromkeys(e.channel for e in errors):
        own = [e for e in errors if e.channel == name]
        levels = [float(np.mean([getattr(e, stage) for e in own])) for stage in ("data_sheet", "recalibrated", "extended")]
        if np.isfinite(levels[2]):
            means.append((name, own[0].unit, levels))
    if not means:
        return ""
    name, unit, levels = min(means, key=lambda m: m[2][2] / m[2][0] if m[2][0] > 0.0 else np.inf)
    names = ("from the data sheet", "recalibrated", "extended")
    steps = [f"{level:.3g}{_unit(unit)} {stage}" for level, stage in zip(levels, names, strict=True) if np.isfinite(level)]
    same = levels[1] == levels[2]
    on = "held-out records" if held_out else "these records (none was held out)"
    return f"Full-run error of {name} on {on}: {', '.join(steps[:-1] if same else steps)}."


def reach(found: Diagnosis) -> str:
    """What an all-clear means: from which sizes on common faults would have shown, each at the place where it shows least."""
    worst: dict[str, Limit] = {}
    for limit in found.limits:
        if limit.effect in COMMON and limit.value >= getattr(worst.get(limit.effect), "value", 0.0):
            worst[limit.effect] = limit
    shown = [f"{plain} from {_size(worst[name])} ({worst[name].place})" for name, plain in COMMON.items() if name in worst]
    said = f"They would have shown {', '.join(shown)}; less may be there." if shown else ""
    if unsure := [f"{COMMON[u.effect]} ({u.place})" for u in found.untestable if u.why == NO_SIZE and u.effect in COMMON]:
        said = f"{said} From which size on they would have shown {' or '.join(unsure)} is not known.".strip()
    silent = [u for u in found.untestable if u.why != NO_SIZE]
    count = len(silent)
    hidden = ", ".join(f"{u.effect}@{u.place}" for u in silent[:3])
    if not count:
        return said
    return f"{said} They cannot show {hidden}{f' and {count - 3} more' if count > 3 else ''} at any size.".strip()


def _size(limit: Limit) -> str:
    return f"{100 * limit.value:.2g} %" if limit.unit in ("", "1") else f"{limit.value:.2g} {limit.unit}"


def next_step(found: Diagnosis) -> str:
    """What to measure next, or why nothing is proposed."""
    if found.next_experiment:
        return f"What to measure next: {ended(found.next_experiment.sentence)}"
    for cause in found.causes:
        if cause.ties:
            return (
                f"No experiment was found that would tell {cause.key} from {', '.join(cause.ties)}; what would: {cause.separates}"
            )
        if cause.doubt and found.finding is Finding.NAMED:
            return f"No experiment was found that would make {cause.key} sure; what might: {cause.separates}"
    if found.finding is Finding.NAMED:
        return "No further experiment is proposed: no other effect explains these records as well."
    if found.finding is Finding.NOTHING:
        return "No further experiment is proposed: longer records with larger motion would show smaller sizes."
    return "No further experiment is proposed: experiments are chosen between effects, and what is left has no name."


def ended(sentence: str) -> str:
    """A sentence with a capital and a full stop."""
    sentence = sentence.strip().rstrip(".")
    return f"{sentence[:1].upper()}{sentence[1:]}."


def where(held_out: bool) -> str:
    """The records on which a gain is measured."""
    return "held-out records" if held_out else "parts of these records, each left out of the fit in turn (none was held out)"


def _unit(unit: str) -> str:
    return "" if unit in ("", "1") else f" {unit}"


def _best_gain(gains: Sequence[Gain]) -> Gain | None:
    """The channel and horizon that gain most, as a mean over records; a run that did not last counts for nothing."""
    rows = []
    for key in dict.fromkeys((g.channel, g.horizon) for g in gains):
        own = [g for g in gains if (g.channel, g.horizon) == key]
        before, after = (float(np.mean([getattr(g, side) for g in own])) for side in ("before", "after"))
        if np.isfinite(before) and np.isfinite(after) and before > 0.0:
            rows.append(Gain(*key, before, after, own[0].unit, own[0].record))
    return min(rows, key=lambda g: g.after / g.before, default=None)
