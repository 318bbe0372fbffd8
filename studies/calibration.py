"""The command `calibrate`: physical parameters from records, the plant file that holds them, and the page that shows them."""

from argparse import Namespace
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from plants import PLANTS
from studies.arguments import Chosen, choose_plant, names, run_folder
from studies.cli import DONE
from studies.referee import handed_out
from workbench.data import Dataset, check_held_out
from workbench.decimation import thinned
from workbench.diagnose.answer import Gain
from workbench.diagnose.calibrate import Bounds, Calibration, Fitted, Trajectory, calibrate, gains, trajectories
from workbench.diagnose.check import check
from workbench.errors import InputError
from workbench.files import write_json
from workbench.physics.extension import extension
from workbench.physics.plant import Plant
from workbench.provenance import provenance
from workbench.records import record
from workbench.report import figures
from workbench.report.blocks import Picture, Provenance, Report, Section, Table, Text
from workbench.report.figures import ParameterEstimate, Trace
from workbench.report.page import write_report
from workbench.sources import read

Say = Callable[[str], None]

PLANT_FILE = "extended.json"


@record
class Records:
    """The records of a command: what is fitted, what is held out, and the files they came from."""

    own: Dataset
    held_out: Dataset | None
    files: tuple[str, ...]


def read_records(options: Namespace, plant: Plant, say: Say) -> Records:
    """The records of a command and of --holdout, checked against the plant; what is odd about them is said."""
    own, said = thinned(read(*options.records), options.dt, plant)
    held_out = read(*options.holdout) if options.holdout else None
    if held_out:
        held_out = thinned(held_out, own.dt if said else options.dt, plant)[0]
        check_held_out(own, held_out)
    if said:
        say(f"note: {', '.join(own.names)}: {said}")
    for note in check(plant, own, anyway=options.anyway):
        say(f"note: {note}")
    for note in check(plant, held_out, anyway=options.anyway) if held_out else ():
        say(f"note: {note}")
    return Records(own, held_out, (*options.records, *options.holdout))


def parse_bounds(texts: Iterable[str]) -> Bounds:
    """{"kE": (150.0, 250.0)} from kE=150:250."""
    bounds: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, equals, span = (part.strip() for part in text.partition("="))
        low, colon, high = span.partition(":")
        try:
            bound = float(low), float(high)
        except ValueError:
            bound = np.nan, np.nan
        if not (equals and colon and np.isfinite(bound).all()):
            raise InputError(f"{text!r} is not name=low:high", mend=f"write e.g. {name or 'kE'}=150:250")
        if name in bounds:
            raise InputError(f"{name} is given twice", mend="give each bound once")
        bounds[name] = bound
    return bounds


def run(options: Namespace, say: Say, progress: Say) -> int:
    """Fit, say, and write calibration.json, the plant file and the page."""
    chosen = choose_plant(options.plant)
    plant, bounds = chosen.plant, parse_bounds(options.bound)
    records = read_records(options, plant, say)
    progress("fitting parameters, starts and noise levels")
    done = calibrate(plant, records.own, records.held_out, names=names(options.parameters) or None, bounds=bounds)
    shown = records.held_out or records.own
    progress("simulating before and after")
    before, after = trajectories(plant, shown), trajectories(done.plant, shown)
    found = gains(plant, before, after)
    configuration = {
        "plant": options.plant,
        "parameters": options.parameters,
        "bounds": bounds,
        "records": list(records.own.names),
        "anyway": options.anyway,
        "dt": records.own.dt,
    }
    source = provenance(configuration, [*records.files, *chosen.files])
    folder = run_folder(options.out, "calibrate")
    code = handed_out(done.objections, options.accept, say)
    if code == DONE:
        write_extension(folder, chosen, done.values, {}, source)
    else:
        (folder / PLANT_FILE).unlink(missing_ok=True)  # that of a former calibration
    file = str(folder / PLANT_FILE) if code == DONE else None
    content = to_json(done, found, records) | {"file": file, "objections": list(done.objections), "provenance": source}
    for path in (folder / "calibration.json", options.json):
        if path:
            write_json(path, content)
    for line in described(done, found, records.held_out is not None):
        say(line)
    report = _report(done, found, (before, after), records, source)
    if file:
        say(f"plant file: {file}")
    say(f"report: {write_report(report, folder)}")
    return code


def write_extension(folder: Path, chosen: Chosen, parameters, effects, source: dict[str, Any]) -> Path:
    """The plant file of a run; a user's own plant is named in it, and never run from it."""
    return extension(chosen.plant, chosen.base, parameters, effects, source).save(folder / PLANT_FILE)


def again(chosen: Chosen, path: Path) -> str:
    """How the plant of a plant file is written on the command line."""
    return str(path) if chosen.base in PLANTS else f"{chosen.base}+{path}"


# ---- what is said and written ----------------------------------------------------------------------------------------------


def described(done: Calibration, found: Sequence[Gain], held_out: bool) -> list[str]:
    """A line for each parameter, for what is odd, and for each error."""
    lines = [f"{'parameter':10} {'nominal':>11} {'value':>11} {'95 % interval':>25}  {'from nominal':>12} {'records say':>12}"]
    for p in done.parameters:
        interval = f"{p.low:.5g} to {p.high:.5g}"
        lines.append(
            f"{p.name:10} {p.nominal.value:11.4g} {p.value:11.5g} {interval:>25}  {100 * p.shift:+11.2f}% {100 * p.told:11.0f}%"
            f"  {p.nominal.unit}"
        )
    lines += [f"warning: {sentence}" for sentence in done.warnings]
    lines += [f"note: {pair.sentence} (correlation {pair.correlation:.3f})" for pair in done.pairs]
    where = "held-out" if held_out else "fitted"
    lines += [
        f"{g.record}, {where}: {g.channel} {g.horizon} error {_said(g.before)} before, {_said(g.after)} after [{g.unit}]"
        for g in sorted(found, key=lambda g: g.horizon != "full-run")
    ]
    if not held_out:
        lines.append("no held-out records: these errors are of the records that were fitted. Add --holdout RECORD.")
    return lines


def to_json(done: Calibration, found: Sequence[Gain], records: Records) -> dict[str, Any]:
    """Every number of a calibration; an error that is no number, for the run left the plant's range, is null."""
    return {
        "plant": done.plant.name,
        "parameters": {p.name: _parameter(p) for p in done.parameters},
        "pairs": [vars(pair) for pair in done.pairs],
        "starts": done.starts,
        "noise": done.noise,
        "errors": [
            {
                "record": g.record, "split": "held-out" if records.held_out else "estimation", "channel": g.channel,
                "horizon": g.horizon, "before": finite(g.before), "after": finite(g.after), "unit": g.unit,
            }
            for g in found
        ],
    }  # fmt: skip


def finite(value: float) -> float | None:
    """The number, None where it is none: JSON has no NaN."""
    return value if np.isfinite(value) else None


def _parameter(p: Fitted) -> dict[str, Any]:
    q = p.nominal
    return {
        "nominal": q.value, "tolerance": q.tolerance, "value": p.value, "low": p.low, "high": p.high, "unit": q.unit,
        "meaning": q.meaning, "told": p.told, "at_bound": p.held, "warning": p.warning,
    }  # fmt: skip


# ---- the page ------------------------------------------------------------------------------------------------------------


def _report(done: Calibration, found: Sequence[Gain], runs, records: Records, source: dict[str, Any]) -> Report:
    before, after = runs
    sections = [
        Section("Parameters", (figures.parameters([estimate(p) for p in done.parameters]), _parameter_table(done))),
        Section("Errors before and after", (gain_table(found, records.held_out is not None),)),
        Section("Measured and simulated", tuple(traces(done.plant, {"before": before, "calibrated": after}))),
        Section("Starts and noise", (_start_table(done), _noise_table(done))),
        Section("Provenance", (Provenance(source),)),
    ]
    return Report(f"Calibration of {done.plant.name}", verdict(done, found, records.held_out is not None), tuple(sections))


def verdict(done: Calibration, found: Sequence[Gain], held_out: bool) -> str:
    """What was fitted, what it gains, and what is odd, in a few sentences."""
    told = [p.name for p in done.parameters if p.told >= 0.5]
    said = [f"{objection[:1].upper()}{objection[1:]}." for objection in done.objections]
    said += [f"{len(done.parameters)} parameters fitted; the records decide {', '.join(told) if told else 'none of them'}."]
    said.append(gained(found, held_out))
    said += [f"{sentence}." for sentence in done.warnings if "say nothing" not in sentence]
    said += [f"{pair.sentence}." for pair in done.pairs]
    return " ".join(said)


def gained(found: Sequence[Gain], held_out: bool) -> str:
    """The full-run errors of each channel, the mean over records, before and after."""
    free = [g for g in found if g.horizon == "full-run"]
    parts = []
    for name in dict.fromkeys(g.channel for g in free):
        own = [g for g in free if g.channel == name]
        old, new = (float(np.mean([getattr(g, side) for g in own])) for side in ("before", "after"))
        parts.append(f"{name} {_said(old)} before, {_said(new)} after [{own[0].unit}]")
    where = "held-out records" if held_out else "the fitted records (none was held out)"
    return f"Full-run error on {where}: {'; '.join(parts)}." if parts else ""


def _said(error: float) -> str:
    return f"{error:.4g}" if np.isfinite(error) else "a run that left the range"


def estimate(p: Fitted) -> ParameterEstimate:
    q = p.nominal
    return ParameterEstimate(q.name, q.unit, q.value, p.value, p.low, p.high, q.tolerance)


def _parameter_table(done: Calibration) -> Table:
    rows = [
        (p.name, p.nominal.unit, p.nominal.value, 100 * p.nominal.tolerance, p.value, p.low, p.high, 100 * p.told, p.warning)
        for p in done.parameters
    ]
    header = ("parameter", "unit", "nominal", "tolerance [%]", "value", "low", "high", "records say [%]", "note")
    caption = "Records say: by how much the interval is narrower than what the data sheet leaves open; 0 is nothing, 100 all."
    return Table("Parameters", header, tuple(rows), caption=caption)


def gain_table(found: Sequence[Gain], held_out: bool) -> Table:
    """Errors of every record, channel and horizon, before and after."""
    rows = tuple((g.record, g.channel, g.horizon, g.before, g.after, g.unit) for g in found)
    where = "held-out records" if held_out else "the records that were fitted"
    caption = f"Root mean square on {where}; the start of each record is estimated, full runs are driven by the inputs alone."
    return Table("Errors", ("record", "channel", "horizon", "before", "after", "unit"), rows, caption=caption)


def traces(plant: Plant, runs: Mapping[str, Sequence[Trajectory]]) -> list[Picture]:
    """Measured against full runs by name, a picture for each record and measured channel."""
    pictures = []
    for own in zip(*runs.values(), strict=True):
        for i, channel in enumerate(plant.outputs):
            if np.isfinite(own[0].measured[:, i]).all():
                measured = Trace(channel, own[0].measured[:, i])
                simulated = {name: run.simulated[:, i] for name, run in zip(runs, own, strict=True)}
                pictures.append(figures.measured_and_simulated(own[0].record, own[0].t, measured, simulated))
    return pictures


def _start_table(done: Calibration) -> Table:
    header = ("record", *(str(c) for c in done.plant.states))
    return Table("Estimated starts", header, tuple((name, *start.values()) for name, start in done.starts.items()))


def _noise_table(done: Calibration) -> Table:
    units = {c.name: c.unit for c in done.plant.outputs}
    rows = tuple((name, level, units[name]) for name, level in done.noise.items())
    return Table("Noise levels from the likelihood", ("channel", "standard deviation", "unit"), rows)


def notes(sentences: Iterable[str]) -> tuple[Text, ...]:
    """Sentences as a block, or nothing."""
    text = "\n\n".join(sentences)
    return (Text(text),) if text else ()
