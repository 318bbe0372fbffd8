"""`workbench autotune`: from one record of a step, a relay or a loop to the gains of a PID, in every form."""

from argparse import Namespace

from controllers.autotune import AUTOTUNE_FILE, PID_FILE, TIME_UNITS, autotune
from studies.arguments import names, numbers, run_folder
from studies.cli import DONE
from studies.terminal import progress, say
from workbench.errors import check_known
from workbench.files import write_bytes
from workbench.provenance import provenance
from workbench.sources import read
from workbench.units import UNITS


def run(options: Namespace) -> int:
    """Say the gains first, then what they rest on; write autotune.json, pid.json, process.json and the page."""
    unit = check_known("unit of time", options.time_unit, TIME_UNITS)
    seconds, given = UNITS[unit].factor, numbers(options.present, "--present")
    present = None if not given else (given[0], *(seconds * value for value in given[1:]))
    records = read(*options.records, inputs=names(options.inputs), outputs=names(options.outputs), dt=options.file_dt)
    found = autotune(
        records, sensitivity=options.sensitivity, derivative=not options.no_derivative, effort=options.effort,
        cycle=options.cycle, present=present, progress=progress,
    )  # fmt: skip
    for form, values in found.gains.items():
        say(f"{form + ':':10} " + ", ".join(f"{name} = {_scaled(name, value, seconds):.5g}" for name, value in values.items()))
    say(f"times in {unit}, Ki per {unit}" if unit != "s" else "times in s")
    for sentence in found.sentences:
        say(sentence)
    for note in found.records.notes:
        say(f"note: {note}")
    asked = {"sensitivity": options.sensitivity, "effort": options.effort, "cycle": options.cycle, "present": options.present}
    folder = found.save(run_folder(options.out, "autotune"), source=provenance(asked, found.records.files))
    if options.json:
        write_bytes(options.json, (folder / AUTOTUNE_FILE).read_bytes())
    say(f"controller -> {folder / PID_FILE}")
    say(f"report: {folder / 'report.html'}")
    return DONE


def _scaled(name: str, value: float, seconds: float) -> float:
    """A gain in another unit of time."""
    return value / seconds if name in ("Ti", "Td", "Kd") else value * seconds if name == "Ki" else value
