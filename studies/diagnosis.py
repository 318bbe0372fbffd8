"""The command `diagnose`: what a simulation gets wrong on records, in one sentence, in files, and on a page."""

from argparse import Namespace
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from studies.arguments import choose_plant, run_folder
from studies.calibration import PLANT_FILE, Records, again, notes, read_records, traces, write_extension
from workbench.data import Channel, Dataset, Experiment
from workbench.diagnose.answer import Cause, Diagnosis, Finding, Gain, NextExperiment
from workbench.diagnose.calibrate import trajectories
from workbench.diagnose.domains import shown
from workbench.diagnose.experiments import Template
from workbench.files import write_json
from workbench.physics.extension import extension
from workbench.physics.plant import Plant
from workbench.provenance import provenance
from workbench.readers import write_csv
from workbench.report import figures
from workbench.report.figures import ParameterEstimate, Trace
from workbench.report.page import Block, Picture, Provenance, Report, Section, Table, Text, write_report

Say = Callable[[str], None]

EXPERIMENT_FILE = "next_experiment.csv"
WINDOW = 60  # samples of a picture that shows a shift in time


def run(options: Namespace, say: Say, progress: Say) -> int:
    """Diagnose, say the verdict first, and write diagnosis.json, the plant file, the next experiment and the page."""
    from workbench.diagnose.diagnosis import diagnose

    chosen = choose_plant(options.plant)
    heard: list[str] = []
    records = read_records(options, chosen.plant, heard.append)
    found = diagnose(
        chosen.plant, records.own, records.held_out, templates=_templates(options.plant, records.own.dt), progress=progress
    )
    say(verdict(found, records.held_out is not None))
    for sentence in dict.fromkeys([*heard, *(f"note: {note}" for note in found.notes)]):
        say(sentence)
    source = provenance({"plant": options.plant, "holdout": options.holdout}, [*records.files, *chosen.files])
    folder = run_folder(options.out, "diagnose")
    extended = write_extension(folder, chosen, found.parameters, found.effects, source)
    if found.next_experiment and found.next_experiment.signals:
        write_csv(_experiment(chosen.plant, found.next_experiment), folder / EXPERIMENT_FILE)
        say(f"next experiment: {folder / EXPERIMENT_FILE}")
    else:
        (folder / EXPERIMENT_FILE).unlink(missing_ok=True)  # that of a former diagnosis decides nothing here
    for path in (folder / "diagnosis.json", options.json):
        if path:
            write_json(path, to_json(found, folder, source))
    progress("drawing")
    report = page(chosen.plant, found, records, source)
    say(f"extended plant, for --plant and simulate: {again(chosen, extended)}")
    say(f"report: {write_report(report, folder)}")
    return 0


def _templates(name: str, dt: float) -> tuple[Template, ...]:
    """The experiments of a machine's plan as tests to run next; none for a user's own plant or at another sampling time."""
    from studies.experiments import EXPERIMENTS

    made = []
    for experiment, plan in EXPERIMENTS.get(name, {}).items():
        if not plan.effects and abs(plan.controller.dt - dt) < 1e-9 * dt:
            made.append(Template(experiment, plan.controller, plan.scenario(0).references))
    return tuple(made)


# ---- the verdict -----------------------------------------------------------------------------------------------------------


def verdict(found: Diagnosis, held_out: bool) -> str:
    """What is missing, how large, how sure, what naming it gains, and what to do next; a few plain sentences."""
    match found.finding:
        case Finding.NOTHING:
            said = [f"Nothing is missing from the simulation of {found.plant} that these records can show."]
        case Finding.UNKNOWN:
            said = ["Something is missing from the simulation, and no effect of the catalogue explains it."]
        case _:
            said = [_named(cause, held_out) for cause in found.causes]
    if found.finding is Finding.INCOMPLETE:
        said.append("Something is left that no further effect of the catalogue explains.")
    if found.finding in (Finding.UNKNOWN, Finding.INCOMPLETE) and found.remainder:
        said.append(_ended(found.remainder[0].sentence))
    if found.next_experiment:
        said.append(f"What to measure next: {_ended(found.next_experiment.sentence)}")
    return " ".join(said)


def _named(cause: Cause, held_out: bool) -> str:
    """The cause with its size, its gain and its rivals."""
    said = [_ended(cause.sentence), f"{cause.key}: {sizes(cause)}."]
    if best := _best_gain(cause.gains):
        where = "held-out records" if held_out else "these records (none was held out)"
        change = f"from {best.before:.3g} to {best.after:.3g}{_unit(best.unit)}"
        said.append(f"It takes the {best.horizon} error of {best.channel} on {where} {change}.")
    if cause.ties:
        rivals = ", ".join(f"{key} ({100 * weight:.0f} %)" for key, weight in cause.ties.items())
        said.append(f"These records cannot tell it ({100 * cause.evidence.posterior:.0f} %) from {rivals}.")
    return " ".join(said)


def sizes(cause: Cause) -> str:
    """The numbers of a cause with 95 % intervals and units."""
    return ", ".join(
        f"{name} {e.value:.4g}{_unit(e.unit)} (95 %: {e.low:.4g} to {e.high:.4g})" for name, e in cause.parameters.items()
    )


def _unit(unit: str) -> str:
    return "" if unit in ("", "1") else f" {unit}"


def _ended(sentence: str) -> str:
    sentence = sentence.strip().rstrip(".")
    return f"{sentence[:1].upper()}{sentence[1:]}."


def _best_gain(gains: Sequence[Gain]) -> Gain | None:
    """The channel and horizon that gain most, as a mean over records; a run that did not last counts for nothing."""
    rows = []
    for key in dict.fromkeys((g.channel, g.horizon) for g in gains):
        own = [g for g in gains if (g.channel, g.horizon) == key]
        before, after = (float(np.mean([getattr(g, side) for g in own])) for side in ("before", "after"))
        if np.isfinite(before) and np.isfinite(after) and before > 0.0:
            rows.append(Gain(*key, before, after, own[0].unit, own[0].record))
    return min(rows, key=lambda g: g.after / g.before, default=None)


# ---- files -------------------------------------------------------------------------------------------------------------------


def to_json(found: Diagnosis, folder: Path, source: dict[str, Any]) -> dict[str, Any]:
    """The contract of a diagnosis, with what was tested, what looks alike, and where the files are; no number is null."""
    todo = found.next_experiment
    content = found.to_dict() | {
        "next_experiment": {
            "sentence": todo.sentence,
            "file": str(folder / EXPERIMENT_FILE) if todo.signals else None,
            "expected": dict(todo.expected),
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
    return _finite(content)


def _finite(content: Any) -> Any:
    """The same with null for every number that is none: JSON has no NaN."""
    match content:
        case dict():
            return {key: _finite(value) for key, value in content.items()}
        case list() | tuple():
            return [_finite(value) for value in content]
        case np.ndarray():
            return _finite(content.tolist())
        case float() | np.floating():
            return float(content) if np.isfinite(content) else None
        case _:
            return content


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


def page(plant: Plant, found: Diagnosis, records: Records, source: dict[str, Any]) -> Report:
    """Verdict; causes in their domains; held-out runs; rivals; parameters; limits; what is left; what to measure next."""
    held = records.held_out or records.own
    nominal = extension(plant, "", found.parameters).of(plant)
    extended = extension(plant, "", found.parameters, found.effects).of(plant)
    before = trajectories(nominal, held)
    after = trajectories(extended, held) if found.effects else before
    runs = traces(plant, before, after, "extended" if found.effects else "recalibrated")
    sections = [
        *([Section("What is missing", _cause_blocks(nominal, found, records.own, held))] if found.causes else []),
        Section(
            "Held-out records" if records.held_out else "Records", (*_gain_tables(found, records.held_out is not None), *runs)
        ),
        *([Section("What is left", _left_blocks(plant, found))] if found.remainder else []),
        Section("Parameters", _parameter_blocks(plant, found)),
        *([Section("What to measure next", _next_blocks(plant, found.next_experiment))] if found.next_experiment else []),
        Section("What these records can show", _reach_blocks(found)),
        *([Section("Notes", notes(found.notes))] if found.notes else []),
        Section("Provenance", (Provenance(source),)),
    ]
    return Report(f"Diagnosis of {found.plant}", verdict(found, records.held_out is not None), tuple(sections))


def _cause_blocks(nominal: Plant, found: Diagnosis, own: Dataset, held: Dataset) -> tuple[Block, ...]:
    """A sentence and a picture for each cause, then the evidence; nominal: the plant with recalibrated parameters."""
    blocks: list[Block] = []
    for cause in found.causes:
        blocks.append(Text(f"{_ended(cause.sentence)} {cause.key}: {sizes(cause)}."))
        drawn = shown(nominal, found.effects, cause.key, own)
        if drawn is None:
            blocks.append(_shifted(nominal, found, cause, Dataset(held.experiments[:1])))
        else:
            what = Trace(drawn.what, drawn.measured)
            blocks.append(figures.missing(cause.key, drawn.over, what, drawn.x, drawn.deviation, drawn.after))
    return (*blocks, _evidence_table(found))


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
    runs = {"simulated before": old.simulated[at, i], "simulated after": new.simulated[at, i]}
    return figures.measured_and_simulated(f"{old.record}, {cause.key}", old.t[at], Trace(nominal.outputs[i], y[at]), runs)


def _evidence_table(found: Diagnosis) -> Table:
    """Every cause and its rivals, with odds."""
    rows: list[tuple] = []
    for c in found.causes:
        rows.append((c.key, "named", 100 * c.evidence.posterior, c.evidence.delta_bic, c.evidence.p_value, c.stability))
        rows += [(key, f"rival of {c.key}", 100 * weight, None, None, None) for key, weight in c.ties.items()]
    header = ("effect", "is", "odds [%]", "gain in BIC", "p-value", "p of one size in all records")
    caption = (
        "Odds within a tie. Gain in BIC: by how much the records prefer the model with the effect; 10 is much. P-value: the "
        "chance of such a gain where nothing is missing, over all effects tried. A small p of one size: records disagree on it."
    )
    return Table("Causes and rivals", header, tuple(rows), caption=caption, digits=3)


def _gain_tables(found: Diagnosis, held_out: bool) -> tuple[Table, ...]:
    rows = tuple((c.key, g.record, g.channel, g.horizon, g.before, g.after, g.unit) for c in found.causes for g in c.gains)
    if not rows:
        return ()
    where = "held-out records" if held_out else "the records themselves: none was held out"
    caption = f"Root mean square on {where}, before and after each cause is added to those above it."
    return (Table("Gain", ("cause", "record", "channel", "horizon", "before", "after", "unit"), rows, caption=caption),)


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
    rows = tuple((e.name, e.unit, e.nominal, 100 * e.tolerance, e.value, e.low, e.high) for e in estimates)
    header = ("parameter", "unit", "nominal", "tolerance [%]", "value", "low", "high")
    picture = (figures.parameters(estimates),) if estimates else ()
    return (*picture, Table("Recalibrated parameters", header, rows))


def _next_blocks(plant: Plant, todo: NextExperiment) -> tuple[Block, ...]:
    rows = tuple(sorted(todo.expected.items(), key=lambda item: -item[1]))
    caption = "Twice the gain of log-likelihood by which an experiment should tell the rivals apart; below 10 it does not."
    table = Table("Expected evidence", ("experiment", "expected evidence"), rows, caption=caption, digits=3)
    if not todo.signals:
        return (Text(_ended(todo.sentence)), table)
    caption = f"{_ended(todo.sentence)} Also beside this page as {EXPERIMENT_FILE}."
    return (figures.signals("Next experiment", todo.dt, _signals(plant, todo), caption), table)


def _reach_blocks(found: Diagnosis) -> tuple[Block, ...]:
    limits = Table(
        "Detection limits",
        ("effect", "at", "smallest size shown", "unit"),
        tuple((d.effect, d.place, d.value, d.unit) for d in found.limits),
        caption="The smallest size of each effect that these records would show (5 standard deviations).",
        digits=3,
    )
    untestable = Table(
        "Could not be tested", ("effect", "at", "why"), tuple((u.effect, u.place, u.why) for u in found.untestable)
    )
    alike = (figures.similarity(found.tested, found.similarity),) if len(found.tested) else ()
    return (limits, untestable, *alike)
