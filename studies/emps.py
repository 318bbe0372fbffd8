"""What does a positioning axis with mass and viscous friction leave out of its measured records, and what does naming it gain?

    M q'' = F - Fv q' + what is missing

The records are those of the EMPS benchmark: a ball-screw slide in closed loop, drive force and position every millisecond. The
first is diagnosed, the second, under pulses of force, is only predicted. Laws of friction are then compared by hand, the
published one among them, and one that the catalogue of effects does not hold.

A. Janot, M. Gautier, M. Brunot, "Data Set and Reference Models of EMPS", Workshop on Nonlinear System Identification Benchmarks,
Eindhoven 2019.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from plants import POSITIONING_AXIS
from studies.emps_laws import (
    BAND,
    BY_SIDE,
    COULOMB,
    DELAY,
    DELAYED,
    DRIFTING,
    DRY_BY_SIDE,
    DRY_OFFSET,
    FREE_RUNS,
    OFFSET,
    PUBLISHED,
    SHORT,
    SOURCE,
    SPEEDS,
    TWO_SIDED,
    TWO_SIDED_OFFSET,
    FreeRuns,
    Judged,
    Records,
    compared,
    emps_records,
    in_free_run,
    is_named,
    judged,
    over_speed,
    pulse_force,
)
from workbench.answers.answer import PLANT_FILE
from workbench.answers.diagnose import DIAGNOSIS_FILE, to_dict
from workbench.answers.verdict import sizes as described
from workbench.answers.verdict import verdict as diagnosed
from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis.answer import Diagnosis, Finding
from workbench.diagnosis.diagnosis import diagnose
from workbench.diagnosis.gains import HORIZONS
from workbench.files import write_json
from workbench.physics.extension import extension
from workbench.provenance import provenance
from workbench.report import figures
from workbench.report.blocks import Block, Picture, Provenance, Report, Section, Table, Text
from workbench.report.figures import Trace
from workbench.report.page import write_report

Say = Callable[[str], None]


def main(
    quick: bool = False,
    *,
    folder: Path,
    data: str | None = None,
    seed: int = 1,
    json: str | None = None,
    say: Say = print,
    progress: Say = lambda _: None,
) -> Path:
    """Diagnose the records in the folder `data`, compare laws of friction, write the report into `folder`; returns its path."""
    del seed  # measured records
    records = emps_records(data, quick)
    # every force but friction was logged: slow noise would take friction in, see the notes of the page
    found = diagnose(
        POSITIONING_AXIS, Dataset((records.estimation,)), Dataset((records.held_out,)), drift=False, progress=progress
    )
    laws = []
    for law in compared(found, quick):
        progress(f"fitting: {law.name}")
        laws.append(judged(law, records))
    free = {one.law.name: in_free_run(one, records) for one in laws if one.law in FREE_RUNS and not quick}
    source = provenance({"study": "emps", "quick": quick, "data": data}, records.files)
    axis = POSITIONING_AXIS.with_courses(found.between)
    extension(axis, axis.name, found.parameters, found.effects, source).save(folder / PLANT_FILE)
    numbers = [_law_json(one, laws[0], records) for one in laws]
    content = to_dict(found) | {"extended": str(folder / PLANT_FILE), "laws": numbers, "fitted to free runs": free}
    content["provenance"] = source
    for path in (folder / DIAGNOSIS_FILE, json):
        if path:
            write_json(path, content)
    progress("report")
    path = write_report(_report(found, laws, free, records, source, quick), folder)
    _say_table(laws, records, say)
    say(f"\n{verdict(found, laws, records)}\n\nreport: {path}")
    return path


def verdict(found: Diagnosis, laws: list[Judged], records: Records) -> str:
    """What is missing, its size beside the published one, what naming it gains on the record never seen, and what is left."""
    named = next((one for one in laws if found.effects and is_named(one.law, found)), None)
    if named is None:
        return diagnosed(found, True)
    said = [f"{c.sentence} {c.key}: {described(c)}." for c in found.causes]
    name, before = records.held_out.name, laws[0]
    ahead, run = ((1e3 * before.rms(name, h), 1e3 * named.rms(name, h)) for h in HORIZONS[1:])
    said.append(
        f"On the second record, which took no part in the fit, the error one second ahead falls from {ahead[0]:.3g} to "
        f"{ahead[1]:.3g} mm, and that of a free run of {records.held_out.dt * len(records.held_out):.1f} s from {run[0]:.3g} to "
        f"{run[1]:.3g} mm."
    )
    if BY_SIDE in named.effects:
        forward, backward = (named.effects[BY_SIDE][side] for side in ("forward", "backward"))
        said.append(
            f"In the terms of the literature: dry friction {0.5 * (forward + backward):.4g} N and offset "
            f"{0.5 * (forward - backward):.3g} N; published {PUBLISHED['Fc']:.4g} N and {PUBLISHED['offset']:.3g} N ({SOURCE})."
        )
    match found.finding:
        case Finding.INCOMPLETE:
            said.append("The diagnosis says that something is left.")
        case Finding.UNKNOWN:
            said.append("The diagnosis says that something is left, and that parts of the record disagree on the size.")
    said.append(_beyond(named, laws, records))
    return " ".join(said)


def _beyond(named: Judged, laws: list[Judged], records: Records) -> str:
    """What a law outside the catalogue does better, or does not."""
    two = next(one for one in laws if one.law.name == TWO_SIDED.name)
    gain = named.model.bic - two.model.bic
    if gain < 10.0:
        return "Viscous friction that differs between the directions explains no more."
    ahead = ", ".join(
        f"{1e3 * named.rms(e.name, 'one-second'):.3g} to {1e3 * two.rms(e.name, 'one-second'):.3g} mm" for e in records.both
    )
    run = 1e3 * named.rms(records.held_out.name, "full-run"), 1e3 * two.rms(records.held_out.name, "full-run")
    return (
        "A law that the catalogue lacks, equal dry friction with viscous friction of its own in each direction "
        f"({two.parameters['Fv_forward']:.0f} forward, {two.parameters['Fv_backward']:.0f} N s/m backward), lowers the error one "
        f"second ahead again (first and second record: {ahead}): the difference between the directions grows with speed. The "
        f"free run of the second record {'does not gain' if run[1] >= run[0] else 'gains too'} ({run[0]:.3g} to {run[1]:.3g} mm)."
    )


def findings(laws: list[Judged], free: FreeRuns, records: Records) -> tuple[str, ...]:
    """What these records cannot tell apart and why, and what was looked at and left out; a paragraph each."""
    by_name, second = {one.law.name: one for one in laws}, records.held_out.name
    side, offset, two = by_name[DRY_BY_SIDE.name], by_name[DRY_OFFSET.name], by_name[TWO_SIDED.name]
    gain = laws[0].model.bic - side.model.bic
    apart, errors_of = side.model.bic - offset.model.bic, [1e3 * one.rms(second, "one-second") for one in (side, offset)]
    said = [
        "Offset or dry friction that differs by direction: at any speed but the smallest both are the same force, so only the "
        f"reversals tell. The offset is better by {apart:+.0f} in BIC, {100 * abs(apart) / gain:.1f} % of what either gains; one "
        f"second ahead on the second record both err: by {errors_of[0]:.3g} and {errors_of[1]:.3g} mm. The diagnosis adds one "
        "effect at a time and has the one that does it alone. What the slide does when the drive is off, at a small tilt, would "
        "decide."
    ]
    if TWO_SIDED_OFFSET.name in by_name:
        rest = by_name[TWO_SIDED_OFFSET.name]
        said.append(
            f"Dry or viscous: beside viscous friction by direction an offset of {rest.effects[OFFSET]['level']:.2g} N is left of "
            f"{offset.effects[OFFSET]['level']:.3g} N, for {two.model.bic - rest.model.bic:+.0f} in BIC. The published offset "
            "stands for a difference of viscous friction at the speeds that occur most. No effect of the catalogue is that, so "
            "the diagnosis says that something is left."
        )
    if DELAYED.name in by_name:
        late = by_name[DELAYED.name]
        steps = 1e9 * side.rms(second, "one-step"), 1e9 * late.rms(second, "one-step")
        said.append(
            f"Delay: {1e3 * late.effects[DELAY]['time']:.2g} ms, less than a sample, would gain "
            f"{side.model.bic - late.model.bic:.0f} in BIC on the first record; on the second the error of one step goes from "
            f"{steps[0]:.3g} to {steps[1]:.3g} nm. What is left is of the size of the position's resolution, 50 nm: these "
            "records do not show a dead time."
        )
    pulse = pulse_force(two, records)
    if pulse is not None:
        said.append(
            f"Pulses of the second record (pulses_N, 0 or {pulse.value:g} in its file): while they are on, {pulse.force:+.2g} N "
            f"(standard deviation {pulse.deviation:.2g} N) act that the logged drive force does not hold. They are part of that "
            "force, not a second input, and nothing is added for them."
        )
    if DRIFTING.name in by_name:
        slow = by_name[DRIFTING.name]
        levels = " and ".join(f"{slow.effects[BY_SIDE][way]:.3g} N {way}" for way in ("forward", "backward"))
        run = 1e3 * slow.rms(second, "full-run")
        said.append(
            "Noise: white force and white position error. Where a slow force may be noise too, one step is more likely "
            f"({side.model.bic - slow.model.bic:+.0f} in BIC), but the slow force takes in what changes at reversals only: dry "
            f"friction comes out as {levels}, and the free run of the second record is off by {run:.3g} mm. All that drives this "
            "axis was logged, so the diagnosis admits no such force here."
        )
    said.append(
        "Free runs: a slide without a spring keeps every error of speed. A tenth of a newton moves it by half a millimetre each "
        "second, so a free run asks for friction to a few hundredths of a newton, far finer than its 95 % interval: errors one "
        "second ahead say more about the law."
    )
    for name, errors_by_record in free.items():
        both = " and ".join(f"{1e3 * errors_by_record[e.name]:.3g}" for e in records.both)
        said[-1] += f' Fitted to the free run itself, "{name}" leaves {both} mm on the first and second record.'
    return tuple(said)


def _say_table(laws: list[Judged], records: Records, say: Say) -> None:
    say(f"\n{'':36}{'one step [nm]':>20}{'one second [mm]':>20}{'free run [mm]':>20}")
    say(f"{'friction':36}" + f"{'first':>10}{'second':>10}" * 3)
    for one in laws:
        cells = [scale * one.rms(e.name, h) for h, scale in zip(HORIZONS, (1e9, 1e3, 1e3), strict=True) for e in records.both]
        say(f"{one.law.name:36}" + "".join(f"{value:10.3g}" for value in cells))


def _law_json(one: Judged, viscous: Judged, records: Records) -> dict[str, Any]:
    return {
        "law": one.law.name,
        "parameters": one.parameters,
        "effects": one.effects,
        "gain_in_bic": viscous.model.bic - one.model.bic,
        "rms": {e.name: {h: one.rms(e.name, h) for h in HORIZONS} for e in records.both},
    }


def _report(
    found: Diagnosis, laws: list[Judged], free: FreeRuns, records: Records, source: dict[str, Any], quick: bool
) -> Report:
    named = next((one for one in laws if found.effects and is_named(one.law, found)), laws[0])
    sections = (
        Section("Friction over speed", _friction(named, laws, records)),
        Section("Free runs", tuple(_run(e, laws[0], named) for e in records.both)),
        Section(
            "Laws of friction",
            (_error_table(laws, records), *_free_table(free, records), _parameter_table(found, laws), _other_table(laws)),
        ),
        Section("What these records cannot tell", (Text("\n\n".join(findings(laws, free, records))),)),
        Section("The diagnosis", _diagnosis_blocks(found)),
        Section("Provenance", (Provenance(source),)),
    )
    short = f"Quick: the first {SHORT:g} s of both records. " if quick else ""
    return Report("EMPS: what a positioning axis leaves out", short + verdict(found, laws, records), sections)


def _friction(named: Judged, laws: list[Judged], records: Records) -> tuple[Block, ...]:
    """Measured force over speed beyond viscous friction, and what the named law leaves of it on either record."""
    two = next(one for one in laws if one.law.name == TWO_SIDED.name)
    mass, viscous = named.parameters["M"], named.parameters["Fv"]
    first = over_speed(records.estimation, mass)
    how = (
        f"Drive force less {mass:.4g} kg times acceleration, both below {BAND:g} Hz, in {SPEEDS} bins of speed; two standard "
        "deviations, counted by passages."
    )
    over, beyond = Channel("v", "m/s"), Channel("force less Fv v", "N")
    pictures: list[Block] = [
        replace(
            figures.missing(
                f"Force over speed, {records.estimation.name}",
                over,
                Trace(beyond, first.force - viscous * first.v),
                first.v,
                first.deviation,
                named.force(first.v) - viscous * first.v,
            ),
            caption=f"{how} {viscous:.4g} N s/m times speed are taken off; after: {named.law.name}.",
        )
    ]
    for e in records.both:
        seen = over_speed(e, mass)
        picture = figures.missing(
            f"What {named.law.name} leaves over speed, {e.name}",
            over,
            Trace(Channel("force left over", "N"), seen.force - named.force(seen.v)),
            seen.v,
            seen.deviation,
            two.force(seen.v) - named.force(seen.v),
        )
        caption = f"{how} Before: {named.law.name}. After: {two.law.name}, fitted to the first record."
        pictures.append(replace(picture, caption=caption))
    return tuple(pictures)


def _run(e: Experiment, before: Judged, after: Judged) -> Picture:
    runs = {"before": e["q"] - before.errors[e.name, "full-run"], "after": e["q"] - after.errors[e.name, "full-run"]}
    picture = figures.measured_and_simulated(e.name, e.t, Trace(e.channel("q"), e["q"]), runs)
    return replace(
        picture,
        title=f"Free run, {e.name}",
        caption=f"{picture.caption} From the estimated start on, driven by the logged force alone. Before: {before.law.name}; "
        f"after: {after.law.name}.",
    )


def _error_table(laws: list[Judged], records: Records) -> Table:
    units = dict(zip(HORIZONS, ("nm", "mm", "mm"), strict=True))
    scale = {"nm": 1e9, "mm": 1e3}
    header = tuple(f"{h}, {which} [{units[h]}]" for h in HORIZONS for which in ("first", "second"))
    rows = tuple(
        (
            one.law.name,
            laws[0].model.bic - one.model.bic,
            *(scale[units[h]] * one.rms(e.name, h) for h in HORIZONS for e in records.both),
        )
        for one in laws
    )
    return Table(
        "Errors by horizon, root mean square",
        ("friction", "gain in BIC", *header),
        rows,
        caption="All laws are fitted to the first record by their errors of one step, but for the published one, whose numbers "
        "are taken as they are. The start of a run is estimated on each record. One second: from the filtered state.",
        digits=3,
    )


def _free_table(free: FreeRuns, records: Records) -> tuple[Table, ...]:
    if not free:
        return ()
    table = Table(
        "Free runs of laws that were fitted to the free run",
        ("friction", "first [mm]", "second [mm]"),
        tuple((name, *(1e3 * errors[e.name] for e in records.both)) for name, errors in free.items()),
        caption="Root mean square over the whole run. Numbers and start are fitted to the free run of the first record; of the "
        "second only the start is.",
        digits=3,
    )
    return (table,)


def _parameter_table(found: Diagnosis, laws: list[Judged]) -> Table:
    """Published numbers beside those of the diagnosis and of the same law fitted here."""
    fitted = next(one for one in laws if one.law.name == DRY_OFFSET.name)
    own = {**fitted.parameters, "Fc": fitted.effects[COULOMB]["level"], "offset": -fitted.effects[OFFSET]["level"]}
    rows: list[tuple] = [
        (name, unit, PUBLISHED[name], own[name], *_interval(found, name))
        for name, unit in (("M", "kg"), ("Fv", "N s/m"), ("Fc", "N"), ("offset", "N"))
    ]
    rows += [
        (
            f"Fc {way} offset",
            "N",
            PUBLISHED["Fc"] + sign * PUBLISHED["offset"],
            own["Fc"] + sign * own["offset"],
            *_interval(found, side),
        )
        for way, sign, side in (("+", 1.0, "forward"), ("\N{MINUS SIGN}", -1.0, "backward"))
    ]
    return Table(
        "Parameters",
        ("quantity", "unit", "published", DRY_OFFSET.name, "diagnosis", "low", "high"),
        tuple(rows),
        caption=f"Published: {SOURCE}. Force = M a + Fv v + Fc sign(v) + offset: dry friction forward is Fc + offset, "
        "backward Fc - offset, which is what the diagnosis states with its 95 % interval.",
    )


def _interval(found: Diagnosis, name: str) -> tuple[float, float, float]:
    """Value and 95 % interval in the diagnosis; Fc and offset are mean and half the difference of both sides of dry friction."""
    sides = next((c.parameters for c in found.causes if c.key == BY_SIDE), {})
    estimate = found.recalibrated.get(name) or sides.get(name)
    if estimate:
        return estimate.value, estimate.low, estimate.high
    if sides and name in ("Fc", "offset"):
        sign = 1.0 if name == "Fc" else -1.0
        return 0.5 * (sides["forward"].value + sign * sides["backward"].value), math.nan, math.nan
    return math.nan, math.nan, math.nan


def _other_table(laws: list[Judged]) -> Table:
    """Every number of every law."""
    rows = []
    for one in laws:
        units = {q.name: q.unit for q in one.law.plant.parameters}
        rows += [(one.law.name, name, value, units[name]) for name, value in one.parameters.items()]
        slots = {(s.key, s.parameter.name): s.parameter.unit for s in one.law.plant.slots}
        rows += [
            (one.law.name, f"{key}:{name}", value, slots[key, name])
            for key, numbers in one.effects.items()
            for name, value in numbers.items()
        ]
    return Table("Numbers of all laws", ("friction", "number", "value", "unit"), tuple(rows))


def _diagnosis_blocks(found: Diagnosis) -> tuple[Block, ...]:
    causes = Table(
        "Named causes",
        ("effect", "gain in BIC", "p-value", "odds in its tie [%]", "p of one size in all parts"),
        tuple((c.key, c.evidence.delta_bic, c.evidence.p_value, 100 * c.evidence.posterior, c.stability) for c in found.causes),
    )
    left = Table(
        "What is left",
        ("channel", "over", "p-value", "of the squared errors [%]"),
        tuple((r.channel, r.variable, r.p_value, 100 * r.share) for r in found.remainder),
        caption="A test without a catalogue: what still enters at a channel and varies with a variable.",
        digits=3,
    )
    reach = Table(
        "Detection limits",
        ("effect", "at", "smallest size shown", "unit"),
        tuple((d.effect, d.place, d.value, d.unit) for d in found.limits),
        caption="5 standard deviations, with viscous friction alone in the model. Not shown at any size: "
        f"{', '.join(f'{u.effect}@{u.place}' for u in found.untestable) or 'none'}.",
        digits=3,
    )
    return tuple(table for table in (causes, left, reach) if table.rows)
