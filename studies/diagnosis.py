"""The command `diagnose`: what a simulation gets wrong on records, in one sentence, in files, and on a page."""

from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from studies.arguments import choose_plant, run_folder
from studies.calibration import PLANT_FILE, Records, again, notes, read_records, traces, write_extension
from studies.catalogue import equation, symbols
from studies.cli import DONE
from studies.referee import handed_out
from studies.verdict import ended, next_step, sentences, stated, where
from workbench.data import Channel, Dataset, Experiment
from workbench.diagnose.answer import Cause, Diagnosis, NextExperiment
from workbench.diagnose.calibrate import trajectories
from workbench.diagnose.domains import shown
from workbench.diagnose.experiments import Template, once_more
from workbench.diagnose.stages import StageError, Stages, stages
from workbench.files import nullable, write_json
from workbench.physics.extension import extension
from workbench.physics.plant import Plant
from workbench.provenance import provenance
from workbench.readers import write_csv
from workbench.report import figures
from workbench.report.blocks import Block, Picture, Provenance, Report, Section, Table, Text
from workbench.report.figures import ParameterEstimate, Trace
from workbench.report.page import write_report

Say = Callable[[str], None]

EXPERIMENT_FILE = "next_experiment.csv"
WINDOW = 60  # samples of a picture that shows a shift in time


def run(options: Namespace, say: Say, progress: Say) -> int:
    """Diagnose, say the verdict first, and write diagnosis.json, the plant file, the next experiment and the page."""
    from workbench.diagnose.diagnosis import diagnose

    chosen = choose_plant(options.plant)
    heard: list[str] = []
    records = read_records(options, chosen.plant, heard.append)
    templates = templates_of(chosen.machine, chosen.plant, records.own)
    found = diagnose(chosen.plant, records.own, records.held_out, templates=templates, progress=progress, anyway=options.anyway)
    progress("simulating data sheet, recalibrated and extended plant")
    shown_at = stages(chosen.plant, found, records.own, records.held_out or records.own)
    code = handed_out(found.objections, options.accept, say)
    for sentence in sentences(found, records.held_out is not None, shown_at.errors):
        say(sentence)
    for sentence in dict.fromkeys([*heard, *(f"note: {note}" for note in found.notes)]):
        say(sentence)
    source = provenance(_configuration(options, records), [*records.files, *chosen.files])
    folder = run_folder(options.out, "diagnose")
    extended = write_extension(folder, chosen, found.parameters, found.effects, source) if code == DONE else None
    if not extended:
        (folder / PLANT_FILE).unlink(missing_ok=True)  # that of a former diagnosis
    if found.next_experiment and found.next_experiment.signals:
        write_csv(_experiment(chosen.plant, found.next_experiment), folder / EXPERIMENT_FILE)
        say(f"next experiment: {folder / EXPERIMENT_FILE}")
    else:
        (folder / EXPERIMENT_FILE).unlink(missing_ok=True)  # that of a former diagnosis decides nothing here
    content = to_json(found, folder, source) | {"stages": nullable([vars(e) for e in shown_at.errors])}
    content["extended"] = str(extended) if extended else None
    for path in (folder / "diagnosis.json", options.json):
        if path:
            write_json(path, content)
    progress("drawing")
    report = page(chosen.plant, found, records, shown_at, source)
    if extended:
        say(f"extended plant, for --plant and simulate: {again(chosen, extended)}")
    say(f"report: {write_report(report, folder)}")
    return code


def _configuration(options: Namespace, records: Records) -> dict[str, Any]:
    return {"plant": options.plant, "holdout": options.holdout, "anyway": options.anyway, "dt": records.own.dt}


def templates_of(name: str, plant: Plant, records: Dataset) -> tuple[Template, ...]:
    """Tests to run next: the experiments of a machine's plan that are sampled like the records, and each record once more."""
    from studies.experiments import EXPERIMENTS

    made = []
    for experiment, plan in EXPERIMENTS.get(name, {}).items():
        if not plan.effects and abs(plan.controller.dt - records.dt) < 1e-9 * records.dt:
            made.append(Template(experiment, plan.controller, plan.scenario(0).references))
    return (*made, *(once_more(plant, e) for e in records))


# ---- files -------------------------------------------------------------------------------------------------------------------


def to_json(found: Diagnosis, folder: Path, source: dict[str, Any]) -> dict[str, Any]:
    """The contract of a diagnosis, with what was tested, what looks alike, and where the files are; no number is null."""
    todo = found.next_experiment
    content = found.to_dict() | {
        "next_experiment": {
            "sentence": todo.sentence,
            "file": str(folder / EXPERIMENT_FILE) if todo.signals else None,
            "expected": dict(todo.expected),
            "runs": todo.runs,
        }
        if todo
        else None,
        "extended": str(folder / PLANT_FILE),
        "parameters": dict(found.parameters),
        "effects": {key: dict(numbers) for key, numbers in found.effects.items()},
        "similarity": {"effects": list(found.tested), "share": found.similarity},
        "seconds": found.seconds,
        "provenance": source,
    }
    return nullable(content)


def _experiment(plant: Plant, todo: NextExperiment) -> Experiment:
    """The signals to be played as a record: set-points as references, inputs as inputs."""
    channels = tuple(
        Channel(trace.channel.name, trace.channel.unit, "reference" if name.endswith("_set") else "input")
        for name, trace in _signals(plant, todo).items()
    )
    values = np.column_stack([todo.signals[channel.name] for channel in channels])
    return Experiment("next_experiment", todo.dt * np.arange(len(values)), channels, values, todo.dt)


def _signals(plant: Plant, todo: NextExperiment) -> dict[str, Trace]:
    units = {c.name: c.unit for c in (*plant.inputs, *plant.outputs)}
    return {name: Trace(Channel(name, units.get(name.removesuffix("_set"), "")), values) for name, values in todo.signals.items()}


# ---- the page ----------------------------------------------------------------------------------------------------------------


def page(plant: Plant, found: Diagnosis, records: Records, at: Stages, source: dict[str, Any]) -> Report:
    """Verdict; causes in their domains; held-out runs; rivals; parameters; limits; what is left; what to measure next."""
    held = records.held_out or records.own
    nominal = extension(plant, "", found.parameters).of(plant)
    named = {"recalibrated": at.recalibrated, "extended": at.extended}
    runs = traces(plant, named if found.effects else {"data sheet": at.data_sheet, "recalibrated": at.recalibrated})
    sections = [
        *([Section("What is missing", _cause_blocks(nominal, found, records.own, held))] if found.causes else []),
        Section(
            "Held-out records" if records.held_out else "Records",
            (_stage_table(at.errors, records.held_out is not None), *_gain_tables(found, records.held_out is not None), *runs),
        ),
        *([Section("What is left", _left_blocks(plant, found))] if found.remainder else []),
        Section("Parameters", _parameter_blocks(plant, found)),
        Section("What to measure next", _next_blocks(plant, found)),
        Section("What these records can show", _reach_blocks(found)),
        *([Section("Notes", notes(found.notes))] if found.notes else []),
        Section("Provenance", (Provenance(source),)),
    ]
    said = [*map(ended, found.objections), *sentences(found, records.held_out is not None, at.errors)]
    return Report(f"Diagnosis of {found.plant}", "\n\n".join(said), tuple(sections))


def _cause_blocks(nominal: Plant, found: Diagnosis, own: Dataset, held: Dataset) -> tuple[Block, ...]:
    """A sentence and a picture for each cause, then the evidence; nominal: the plant with recalibrated parameters."""
    blocks: list[Block] = []
    for cause in found.causes:
        blocks.append(Text(f"{stated(cause)}\n\n{_equation(nominal, cause)}"))
        drawn = shown(nominal, found.effects, cause.key, own)
        if drawn is None:
            blocks.append(_shifted(nominal, found, cause, Dataset(held.experiments[:1])))
        else:
            what = Trace(drawn.what, drawn.measured)
            blocks.append(figures.missing(cause.key, drawn.over, what, drawn.x, drawn.deviation, drawn.after))
    return (*blocks, _evidence_table(found))


def _equation(plant: Plant, cause: Cause) -> str:
    """The equation in which the sizes stand, and what its symbols and signs mean."""
    effect = next(slot.effect for slot in plant.slots if slot.key == cause.key)
    port = next(q for q in plant.all_ports if (q.family, q.place) == (effect.family, cause.place))
    said = symbols(port, effect)
    return f"{equation(effect)}{f'   ({said})' if said else ''}"


def _shifted(nominal: Plant, found: Diagnosis, cause: Cause, one: Dataset) -> Picture:
    """A few samples around the fastest change of the channel where the cause shows most; the other causes are in both runs."""
    others = {key: numbers for key, numbers in found.effects.items() if key != cause.key}
    old, new = (trajectories(extension(nominal, "", {}, effects).of(nominal), one)[0] for effects in (others, found.effects))
    seen = [i for i in range(len(nominal.outputs)) if np.isfinite(old.measured[:, i]).all()]
    away = [np.nanmean((new.simulated[:, i] - old.simulated[:, i]) ** 2) / np.var(old.measured[:, i]) for i in seen]
    i = next((i for i in seen if nominal.output_names[i] == cause.place), seen[int(np.nanargmax(away))])
    y = old.measured[:, i]
    middle = int(np.argmax(np.abs(np.convolve(np.diff(y), np.ones(3), "same"))))
    at = slice(max(middle - WINDOW // 3, 0), middle + WINDOW)
    runs = {"without the effect": old.simulated[at, i], "with the effect": new.simulated[at, i]}
    return figures.measured_and_simulated(f"{old.record}, {cause.key}", old.t[at], Trace(nominal.outputs[i], y[at]), runs)


def _evidence_table(found: Diagnosis) -> Table:
    """Every cause and its rivals; odds only where something ties."""
    rows: list[tuple] = []
    for c in found.causes:
        rows.append((c.key, "named", c.evidence.delta_bic, c.evidence.p_value, c.stability, 100 * c.evidence.posterior))
        rows += [(key, f"rival of {c.key}", None, None, None, 100 * weight) for key, weight in c.ties.items()]
    header = ("effect", "is", "gain in BIC", "p-value", "p of one size in all records", "odds [%]")
    caption = (
        "Gain in BIC: by how much the records prefer the model with the effect; 10 is much. P-value: the chance of such a gain "
        "where nothing is missing, over all effects tried. A small p of one size: records disagree on it."
    )
    if any(c.ties for c in found.causes):
        return Table("Causes and rivals", header, tuple(rows), caption=f"{caption} Odds: within a tie.", digits=3)
    return Table("Causes", header[:-1], tuple(row[:-1] for row in rows), caption=f"{caption} Nothing ties.", digits=3)


def _stage_table(errors: tuple[StageError, ...], held_out: bool) -> Table:
    """Data sheet, recalibrated, extended: full-run errors of every record and channel."""
    header = ("record", "channel", "data sheet", "recalibrated", "extended", "unit")
    rows = tuple((e.record, e.channel, e.data_sheet, e.recalibrated, e.extended, e.unit) for e in errors)
    caption = (
        f"Full-run error, root mean square, on {_on(held_out)}. Data sheet: nominal parameters, no effects. "
        "Recalibrated: parameters fitted without any effect. Extended: parameters and effects as found. A full run is driven by "
        "the logged inputs alone."
    )
    return Table("From the data sheet to the extended plant", header, rows, caption=caption)


def _gain_tables(found: Diagnosis, held_out: bool) -> tuple[Table, ...]:
    rows = tuple((c.key, g.record, g.channel, g.horizon, g.before, g.after, g.unit) for c in found.causes for g in c.gains)
    if not rows:
        return ()
    header = ("cause", "record", "channel", "horizon", "without", "with", "unit")
    caption = (
        f"Root mean square on {where(held_out)}, without each cause and with it; all other causes are in both, and the "
        "parameters are recalibrated in both."
    )
    return (Table("Gain of each cause", header, rows, caption=caption),)


def _on(held_out: bool) -> str:
    return "held-out records" if held_out else "the records themselves: none was held out"


def _left_blocks(plant: Plant, found: Diagnosis) -> tuple[Block, ...]:
    units = {c.name: c.unit for c in (*plant.states, *plant.inputs, *plant.outputs)} | {"t": "s", "time": "s"}
    blocks: list[Block] = []
    for r in found.remainder:
        if len(r.grid):
            what = Trace(Channel(r.channel, units.get(r.channel, "")), r.curve)
            over = Channel(r.variable, units.get(r.variable, ""))
            blocks.append(figures.left_over(f"{r.channel} over {r.variable}", over, what, r.grid))
    rows = tuple((r.channel, r.variable, r.p_value, 100 * r.share, r.sentence) for r in found.remainder)
    return (
        *blocks,
        Table("What is left", ("enters at", "varies with", "p-value", "share of the error [%]", "said"), rows, digits=3),
    )


def _parameter_blocks(plant: Plant, found: Diagnosis) -> tuple[Block, ...]:
    tolerance = {q.name: q.tolerance for q in plant.parameters}
    estimates = [
        ParameterEstimate(name, e.unit, e.nominal, e.value, e.low, e.high, tolerance.get(name, 0.0))
        for name, e in found.recalibrated.items()
    ]
    if not estimates:
        return (Text("No parameter is open: none has a tolerance."),)
    meaning = {q.name: q.meaning for q in plant.parameters}
    rows = tuple((e.name, e.unit, e.nominal, 100 * e.tolerance, e.value, e.low, e.high, meaning[e.name]) for e in estimates)
    header = ("parameter", "unit", "data sheet", "tolerance [%]", "value", "low", "high", "meaning")
    caption = "Fitted together with the effects that are named, with 95 % intervals."
    return (figures.parameters(estimates), Table("Parameters of the extended plant", header, rows, caption=caption))


def _next_blocks(plant: Plant, found: Diagnosis) -> tuple[Block, ...]:
    todo = found.next_experiment
    if todo is None:
        return (Text(next_step(found)),)
    rows = tuple(sorted(todo.expected.items(), key=lambda item: -item[1]))
    caption = "Twice the gain of log-likelihood by which an experiment should tell the rivals apart; below 10 it does not."
    table = (Table("Expected evidence", ("experiment", "expected evidence"), rows, caption=caption, digits=3),) if rows else ()
    if not todo.signals:
        return (Text(ended(todo.sentence)), *table)
    caption = f"{ended(todo.sentence)} Also beside this page as {EXPERIMENT_FILE}."
    return (figures.signals("Next experiment", todo.dt, _signals(plant, todo), caption), *table)


def _reach_blocks(found: Diagnosis) -> tuple[Block, ...]:
    limits = Table(
        "Detection limits",
        ("at", "effect", "smallest size shown", "unit"),
        tuple((d.place, d.effect, d.value, d.unit) for d in sorted(found.limits, key=lambda d: (d.place, d.effect))),
        caption="The smallest size of each effect that these records would show (5 standard deviations).",
        digits=3,
    )
    rows = tuple((u.place, u.effect, u.why) for u in sorted(found.untestable, key=lambda u: (u.place, u.effect)))
    untestable = (Table("Could not be tested", ("at", "effect", "why"), rows),) if rows else ()
    alike = (figures.similarity(found.tested, found.similarity),) if len(found.tested) else ()
    return (limits, *untestable, *alike)
