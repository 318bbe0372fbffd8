"""What does one interval model of the welding robot hold in which three perturbations act, and how wide is it?

The question of [2]: static friction, arm gravity and a changing platform mass act at once; the model knows force and speed
only. One box, modes along time and a simulation box are identified on two records, and judged on records of another seed and
on the four curves of [2] Fig. 4, beside an LTI model plus a bound on its error. Or on a user's own records.

[2] Linear time-varying models with interval parameters.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from plants.welding_robot import frozen_course
from studies.experiments import CURVES
from studies.robot_envelopes import (
    HORIZONS,
    ORDER,
    OUTPUT,
    PERTURBED,
    Identified,
    Judged,
    Records,
    Sampling,
    Say,
    identify,
    judge,
    known_records,
    mean_radius,
    sampled_boxes,
    simulated_records,
)
from workbench.answers.envelopes import (
    along_time,
    described_modes,
    domain_picture,
    envelope_pictures,
    envelope_table,
    mode_tables,
    truth_held,
    width_picture,
)
from workbench.answers.scored import ScoredModel, scores_file
from workbench.data import Channel, Experiment
from workbench.files import write_json
from workbench.intervals.coverage import SAYS_NOTHING, Coverage, pooled
from workbench.intervals.model import IntervalModel
from workbench.provenance import provenance
from workbench.records import record
from workbench.report import figures
from workbench.report.blocks import Badge, Block, Brief, Provenance, Report, Section, Standing, Table, Text
from workbench.report.page import write_report


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
    """Run the study and write records, models, scores and the report into `folder`; returns the report's path."""
    logged = known_records(Path(data)) if data else simulated_records(seed, quick, folder, progress)
    samplings = sampled_boxes(logged.estimation, quick, progress)
    records = logged.at(min(samplings, key=lambda s: s.simulation).dt)
    identified = identify(records, samplings, quick, progress)
    progress("envelopes of every record")
    judged = judge(identified, records)
    identified.lti.model.save(folder / "lti.json")
    for name, model in identified.models.items():
        model.save(folder / f"{name}.json")
    configuration = {
        "study": "welding-robot",
        "quick": quick,
        "data": data,
        "estimation": list(records.estimation.names),
        "held-out": list(records.held_out.names),
        "sample time": records.estimation.dt,
        "order": ORDER,
    }
    if not data:
        configuration["perturbations"] = {key: dict(sizes) for key, sizes in PERTURBED.items()}
    source = provenance(configuration, records.files, None if data else seed)
    results = [ScoredModel(identified.lti.model, "lti.json", judged.scores, judged.of(identified.lti.name))]
    for name, model in identified.models.items():
        results.append(ScoredModel(model, f"{name}.json", tuple(c.nominal for c in judged.of(name)), judged.of(name)))
    content = scores_file(results, source)
    write_json(folder / "scores.json", content)
    if json:
        write_json(json, content)
    progress("report")
    path = write_report(_report(logged, records, identified, judged, source, quick), folder)
    _say_table(identified, judged, say)
    say(f"\n{verdict(identified, judged, records, quick)}\n\nreport: {path}")
    return path


def _inside(lines: list[Coverage]) -> float:
    """Percent of the measured values of all lines."""
    return 100.0 * pooled(lines, lambda line: line.coverage)


def _valid(lines: list[Coverage]) -> float:
    return 100.0 * pooled(lines, lambda line: line.valid)


def verdict(identified: Identified, judged: Judged, records: Records, quick: bool = False) -> str:
    """What to use and what not: one step of the box, and free runs. The numbers behind it are the findings."""
    one, lti, unit = identified.models["one-box"], identified.lti, records.held_out.experiments[0].channel(OUTPUT).unit
    step, free = judged.held("one-box", "one-step"), judged.held("one-box", "free-run")
    broken = sum(judged.violations.values())
    text = f"{broken} estimation samples lie outside an envelope that promised to hold them: trust nothing below. " * bool(broken)
    text += (
        f"One box leaves {judged.violations['one-box']} of {one.modes[0].samples} estimation samples outside. "
        f"One step ahead it holds {_inside(step):.1f} % of {sum(c.samples for c in step)} values of {len(records.held_out)} "
        f"records that no model has seen within {_width(step, one, unit)}; {lti.name} holds "
        f"{_inside(judged.held(lti.name, 'one-step')):.1f} % within {_width(judged.held(lti.name, 'one-step'), one, unit)}. "
    )
    text += f"In a free run that box reaches {_width(free, one, unit)}"
    text += (
        ", as wide as the speed moves: it says nothing there. " if mean_radius(free) >= SAYS_NOTHING * one.unit_range else ". "
    )
    box = judged.held("simulation-box", "free-run")
    text += (
        f"The simulation box holds {_inside(box):.1f} % within {_width(box, one, unit)}: no bound for inputs of another kind. "
    )
    text += "Use the one-step envelope to test measured values and to design a loop with; it says nothing about a free run."
    return text + " This was a quick look: few precisions and records, one sample time." * quick


def _brief(identified: Identified, judged: Judged, records: Records) -> Brief:
    """What to use the models for, and what their envelopes hold."""
    one, unit = identified.models["one-box"], records.held_out.experiments[0].channel(OUTPUT).unit
    step, free = judged.held("one-box", "one-step"), judged.held("one-box", "free-run")
    box = judged.held("simulation-box", "free-run")
    broken, silent = sum(judged.violations.values()), mean_radius(free) >= SAYS_NOTHING * one.unit_range
    badges = (
        Badge(
            "Promise", "broken" if broken else "kept", f"{broken} estimation samples lie outside an envelope that holds them.",
            Standing.BAD if broken else Standing.GOOD,
        ),
        Badge("One step ahead", f"{_inside(step):.1f} % inside", f"One box, within {_width(step, one, unit)}.", Standing.GOOD),
        Badge(
            "Free run", f"{_inside(box):.1f} % inside",
            f"The simulation box, within {_width(box, one, unit)}{'; one box says nothing there' * silent}.", Standing.OPEN,
        ),
    )  # fmt: skip
    todo = "Use the one-step envelope to test measured values and to design a loop with; trust no free run of it."
    return Brief("What does an interval model of the robot hold of records that it has not seen?", todo, badges)


def findings(identified: Identified, judged: Judged, records: Records) -> tuple[str, ...]:
    """Paragraphs: the box beside LTI plus bound, what modes buy, free runs, and what the numbers do not say."""
    lti, one = identified.lti, identified.models["one-box"]
    held = {name: {h: judged.held(name, h) for h in HORIZONS} for name in (lti.name, *identified.models)}
    ratio = mean_radius(held["one-box"]["one-step"]) / mean_radius(held[lti.name]["one-step"])
    own = mean_radius(held["one-box-as-measured"]["one-step"]) / mean_radius(held[lti.name]["one-step"])
    beside = (
        f"One box of order {ORDER} at {one.dt:g} s is {ratio:.2g} times as wide as the bound around LTI, and {own:.2g} times if "
        "it promises, as that bound does, nothing but the measured values of the estimation records. "
        f"{_sampling_said(identified.samplings)}"
    )
    modes = _modes_said(identified, held["one-box"]["one-step"], held["modes"]["one-step"])
    kept = [c for c in judged.lines if c.split == "held-out" and c.coverage < 1.0]
    free = _curves_said(identified, judged) if records.mass else ""
    if kept:
        worst = min(kept, key=lambda c: c.coverage)
        free += (
            f"The lowest coverage of all is {100 * worst.coverage:.1f} %: {worst.model}, {worst.horizon}, record {worst.record}. "
        )
    domain = (
        f"{_valid(held['one-box']['one-step']):.0f} % of the held-out regressors lie in the hull of what the box has seen: the "
        "hull is not the true domain, outside it the envelope is no promise."
    )
    return tuple(paragraph.strip() for paragraph in (beside, modes, free, domain) if paragraph)


def _width(lines: list[Coverage], model: IntervalModel, unit: str) -> str:
    width = mean_radius(lines)
    return f"\N{PLUS-MINUS SIGN}{width:.3g} {unit} ({_percent(100 * width / model.unit_range)} % of the range)"


def _sampling_said(samplings: tuple[Sampling, ...]) -> str:
    """The comparison with LTI at every sample time that was tried: the one chosen may favour either side."""
    if len(samplings) == 1:
        return f"That is at {samplings[0].dt:g} s, the one sample time tried; it may be otherwise at another. "
    ratios = [f"{s.one_step / s.lti_one_step:.2g} at {s.dt:g} s" for s in samplings]
    spread = max(s.simulation for s in samplings) / min(s.simulation for s in samplings) - 1.0
    return (
        f"That ratio depends on the sample time; on the estimation records it is {', '.join(ratios)}. The choice among them, by "
        f"the width of the simulation box, rests on differences of {100 * spread:.2g} % at most. "
    )


def _modes_said(identified: Identified, one: list[Coverage], modes: list[Coverage]) -> str:
    count = len(identified.models["modes"].modes)
    if count == 1:
        return "No precision tighter than that of one box can be met by modes along time. "
    narrower = 100.0 * (1.0 - mean_radius(modes) / mean_radius(one))
    inside = f"{_inside(modes):.1f} % inside instead of {_inside(one):.1f} %"
    return f"{count} modes along time make it {narrower:.0f} % narrower, {inside}. "


def _percent(value: float) -> str:
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}"


def _curves_said(identified: Identified, judged: Judged) -> str:
    """Free runs on records drawn like the estimation records, and on the four curves, whose arm rests and whose mass differs."""
    parts = []
    for name in ("simulation-box", identified.lti.name):
        lines = judged.held(name, "free-run")
        like, curves = [c for c in lines if c.record not in CURVES], [c for c in lines if c.record in CURVES]
        parts.append(f"{name} {_inside(like):.1f} and {_inside(curves):.1f} %")
    return f"Inside on records drawn like those of estimation, and on the curves of [2] Fig. 4: {'; '.join(parts)}. "


@record
class Line:
    """One model on all held-out records together: cells by name; NaN where there is nothing to say."""

    model: str
    widths: tuple[float, ...]  # inside [%], mean radius [unit], share of range [%]; one step, then free run
    ratio: float
    known: float
    modes: int | None
    violations: int | None
    inflated: int | None
    seconds: float


def _lines(identified: Identified, judged: Judged) -> list[Line]:
    found = []
    for name in (*identified.models, identified.lti.name):
        model, widths = identified.models.get(name), []
        one, free = (judged.held(name, horizon) for horizon in HORIZONS)
        for lines in (one, free):
            radius = mean_radius(lines)
            widths += [_inside(lines), radius, 100 * radius / identified.lti.unit_range]
        found.append(
            Line(
                name,
                tuple(widths),
                max((c.ratio for c in free if c.ratio is not None), default=math.nan),
                _valid(one) if model else math.nan,
                len(model.modes) if model else None,
                judged.violations.get(name),
                sum(mode.inflated for mode in model.modes) if model else None,
                identified.seconds[name],
            )
        )
    return found


def _say_table(identified: Identified, judged: Judged, say: Say) -> None:
    say(f"\n{'held-out records':20}{'one step':>27}{'free run':>27}")
    say(f"{'model':20}" + f"{'inside':>11}{'radius':>8}{'range':>8}" * 2 + f"{'known':>9}{'violations':>12}{'time':>9}")
    for line in _lines(identified, judged):
        widths = (f"{inside:10.1f}%{r:8.3f}{share:7.1f}%" for inside, r, share in (line.widths[:3], line.widths[3:]))
        violations = "-" if line.violations is None else line.violations
        row = f"{line.model:20}{''.join(widths)}{line.known:8.0f}%{violations:>12}{line.seconds:8.2f}s"
        say(row.replace("nan%", "  - ").replace("nan", "  -"))


def _report(
    logged: Records, records: Records, identified: Identified, judged: Judged, source: dict[str, Any], quick: bool
) -> Report:
    unit = records.estimation.experiments[0].channel(OUTPUT).unit
    curves = [e for e in logged.held_out if e.name in CURVES]
    first = [Section("The robot and its perturbations", (_curves(curves),))] if logged.mass and curves else []
    sections = [
        *first,
        Section(
            "Width and coverage",
            (Text("\n\n".join(findings(identified, judged, records))), *_widths(identified, judged, unit)),
        ),
        Section("Responses and their envelopes", tuple(_envelopes(identified, records))),
        Section("Modes", tuple(_mode_blocks(identified, records, unit))),
        Section("Choice of the sample time", (_sampling_table(identified, unit),)),
        Section("Records", (_data_table(logged),)),
        Section("Numbers", (envelope_table(judged.lines), *(t for m in identified.models.values() for t in mode_tables(m)))),
        Section("Notes", (Text("\n\n".join(line for m in identified.models.values() for line in described_modes(m))),)),
        Section("Provenance", (Provenance(source),)),
    ]
    return Report(
        "Welding robot: what an interval model holds and costs", verdict(identified, judged, records, quick), tuple(sections),
        _brief(identified, judged, records),
    )  # fmt: skip


def _curves(curves: list[Experiment]) -> Block:
    """[2] Fig. 4."""
    meaning = {name: " + ".join(key.partition("@")[0] for key in CURVES[name]) or "no perturbation" for name in CURVES}
    named = {f"{e.name[-1]}: {meaning[e.name]}": e[OUTPUT] for e in curves}
    picture = figures.responses(
        "Response to one input with and without perturbation", curves[0].t, named, curves[0].channel(OUTPUT).unit
    )
    return replace(
        picture,
        caption=f"{picture.caption} The numbers are those of [2] Fig. 4, which prints neither sizes nor which perturbation is "
        "which: both are ours. The estimation records hold friction and gravity of this size and a changing mass at once.",
    )


def _widths(identified: Identified, judged: Judged, unit: str) -> list[Block]:
    held = [c for c in judged.lines if c.split == "held-out"]
    pictures = [
        width_picture(f"{name}: coverage against width on held-out records", held, horizon)
        for name, horizon in zip(("One step ahead", "Free run"), HORIZONS, strict=True)
    ]
    lines = _lines(identified, judged)
    said = ("inside [%]", f"mean radius [{unit}]", "of range [%]")
    table = Table(
        "Models on held-out records",
        ("model", *(f"{horizon}: {what}" for horizon in ("one step", "free run") for what in said)),
        tuple((line.model, *line.widths) for line in lines),
        caption="Over all values of all held-out records; range: of the speed in the estimation records. One box and modes hold "
        "the true speed for every regressor within the noise; as measured, and the bound around LTI (its largest error on the "
        "estimation records), count the measured values only. The simulation box promises free runs only.",
        digits=3,
    )
    checks = Table(
        "What the models promise and cost",
        ("model", "modes", "violations", "inflated", "known [%]", "outer/reached", "time [s]"),
        tuple((n.model, n.modes, n.violations, n.inflated, n.known, n.ratio, n.seconds) for n in lines),
        caption="violations: estimation samples outside the envelope that promised to hold them. inflated: samples for which the "
        "verification widened a box. known: held-out regressors within the domain of a mode; elsewhere the nearest mode speaks. "
        "outer/reached: guaranteed over reached width of a free run, the largest over the records; 1 is exact.",
        digits=3,
    )
    return [table, checks, *pictures]


def _envelopes(identified: Identified, records: Records) -> list[Block]:
    """[2] Fig. 8: one step ahead once, free runs on every shown record."""
    models, shown = identified.models, records.shown
    step, *free = envelope_pictures(models["one-box"], shown[0])
    blocks: list[Block] = [step]
    for e in shown:
        blocks += envelope_pictures(models["simulation-box"], e)
    return [*blocks, *envelope_pictures(models["modes"], shown[0])[1:], *free]


def _mode_blocks(identified: Identified, records: Records, unit: str) -> list[Block]:
    """[2] Fig. 9, the number of modes against precision, and the validity domains."""
    steps, modes = identified.steps, identified.models["modes"]
    precision, count, radius = (np.array([getattr(s, a) for s in steps], float) for a in ("precision", "modes", "mean_radius"))
    picture = figures.modes_against_precision(precision, count, radius, steps[-1].precision, unit)
    raised = steps[-1].reached
    said = (
        "" if raised is None else f" With no more stretches its precision can be raised from {precision[-1]:.5g} to {raised:.5g}."
    )
    blocks: list[Block] = [
        replace(
            picture,
            caption=f"{picture.caption} The first is one box, the last the tightest of those tried that modes of at least "
            f"{5 * len(modes.form.names) + 1} samples can meet.{said}",
        )
    ]
    first = records.estimation.experiments[0]
    if identified.mass is not None and records.mass is not None:
        mass, e = identified.mass, records.mass
        truth = frozen_course(e.t, e.dt, CURVES["curve4"])
        along, parameters = along_time(mass, e, "while only the mass changes", truth)
        note = (
            "Truth: the robot frozen at its present mass, sampled with a held force. It lies within the intervals at "
            f"{100 * truth_held(mass, e, truth):.0f} % of samples and parameters: a box is the narrowest that holds the outputs, "
            "not a confidence region of each parameter, and a parameter with no width is one that the outputs did not ask to "
            "move."
        )
        blocks += [along, replace(parameters, caption=f"{parameters.caption} {note}")]
    else:
        blocks += along_time(modes, first, f"on {first.name}")
    return [*blocks, domain_picture(modes, records.shown[0])]


def _sampling_table(identified: Identified, unit: str) -> Table:
    chosen = identified.models["one-box"].dt
    return Table(
        f"Mean radii [{unit}] by sample time on the estimation records",
        (
            "sample time [s]",
            "one box, one step",
            "one box, free run",
            "simulation box",
            "LTI bound, one step",
            "LTI bound, free run",
        ),
        tuple((s.dt, s.one_step, s.free_run, s.simulation, s.lti_one_step, s.lti_free_run) for s in identified.samplings),
        caption=f"Chosen: {chosen:g} s, where the simulation box is narrowest, be it by little: the comparison of one step with "
        "the LTI bound is to be read at every sample time, not at the chosen one alone.",
        digits=3,
    )


def _data_table(records: Records) -> Table:
    rows = []
    for split, dataset in (("estimation", records.estimation), ("held-out", records.held_out)):
        rows += [(e.name, split, len(e), e.dt * len(e), float(e[OUTPUT].min()), float(e[OUTPUT].max())) for e in dataset]
    unit = Channel(OUTPUT, records.estimation.experiments[0].channel(OUTPUT).unit)
    return Table(
        "Records as logged", ("record", "split", "samples", "duration [s]", f"from: {unit}", f"to: {unit}"), tuple(rows), digits=3
    )
