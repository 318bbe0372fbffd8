"""`workbench calibrate`: fit physical parameters of a plant to records and save the plant with them."""

from argparse import Namespace
from collections.abc import Iterable

import numpy as np

from studies.arguments import choose_plant, names, run_folder
from studies.cli import DONE
from studies.commands.records import configuration, read_both
from studies.referee import handed_out
from studies.terminal import progress, say
from workbench.answers.answer import PLANT_FILE
from workbench.answers.calibrate import CALIBRATION_FILE, CalibrationResult, calibrate, error_said
from workbench.diagnosis.calibrate import Bounds
from workbench.errors import InputError
from workbench.files import write_bytes
from workbench.provenance import provenance


def run(options: Namespace) -> int:
    """Fit, say what was fitted, and write calibration.json, the plant file and the page."""
    chosen = choose_plant(options.plant)
    bounds, (own, held_out) = parse_bounds(options.bound), read_both(options)
    done = calibrate(
        chosen.plant, own, held_out, parameters=names(options.parameters) or None, bounds=bounds, dt=options.dt,
        anyway=options.anyway, accept=options.accept, progress=progress,
    )  # fmt: skip
    for note in done.records.notes:
        say(f"note: {note}")
    source = provenance(
        configuration(options, done.records, "plant", "parameters", "anyway") | {"bounds": bounds},
        [*done.records.files, *chosen.files],
    )
    folder = done.save(run_folder(options.out, "calibrate"), base=chosen.base, source=source)
    code = handed_out(done.objections, options.accept, say)
    for line in _table(done):
        say(line)
    if options.json:
        write_bytes(options.json, (folder / CALIBRATION_FILE).read_bytes())
    if code == DONE:
        say(f"plant file: {folder / PLANT_FILE}")
    say(f"report: {folder / 'report.html'}")
    return code


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


def _table(done: CalibrationResult) -> list[str]:
    """A line for each parameter, for what is odd, and for each error."""
    found, held_out = done.calibration, done.records.held_out is not None
    lines = [f"{'parameter':10} {'nominal':>11} {'value':>11} {'95 % interval':>25}  {'from nominal':>12} {'records say':>12}"]
    for p in found.parameters:
        interval = f"{p.low:.5g} to {p.high:.5g}"
        lines.append(
            f"{p.name:10} {p.nominal.value:11.4g} {p.value:11.5g} {interval:>25}  {100 * p.shift:+11.2f}% {100 * p.told:11.0f}%"
            f"  {p.nominal.unit}"
        )
    lines += [f"warning: {sentence}" for sentence in found.warnings]
    lines += [f"note: {pair.sentence} (correlation {pair.correlation:.3f})" for pair in found.pairs]
    where = "held-out" if held_out else "fitted"
    lines += [
        f"{g.record}, {where}: {g.channel} {g.horizon} error {error_said(g.before)} before, {error_said(g.after)} after "
        f"[{g.unit}]"
        for g in sorted(done.gains, key=lambda g: g.horizon != "full-run")
    ]
    if not held_out:
        lines.append("no held-out records: these errors are of the records that were fitted. Add --holdout RECORD.")
    return lines
