"""What the command `workbench diagnose` makes of records, as a row of a study's table.

A row holds an answer (verdict, causes, what is said when it is worse, CPU time), or how the command ended without one: "refused"
with its message, or "crashed" with its traceback. Held-out errors compare the plant as it was given with the plant as found.
"""

import io
import time
import traceback
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from studies.cli import NOT_HANDED_OUT
from workbench.data import Dataset, Experiment
from workbench.diagnosis.calibrate import along
from workbench.diagnosis.gains import HORIZONS, SETTLING, errors
from workbench.errors import InputError
from workbench.files import read_json
from workbench.physics.extension import extension
from workbench.physics.plant import Plant

Row = Mapping[str, Any]
Errors = dict[str, dict[str, list[float | None]]]  # {horizon: {"record, channel": [given, found]}}


def answer(records: Sequence[Path], held_out: Sequence[Path], plant: str, out: Path) -> dict[str, Any]:
    """The row of a diagnosis of the files `records` with a plant as the command line names it; its files and page go to `out`."""
    words = ["diagnose", *map(str, records), "--plant", plant, "--holdout", *map(str, held_out), "--out", str(out)]
    spoken, began = io.StringIO(), time.process_time()
    try:
        code = command(words, spoken)
    except InputError as reason:
        return {"refused": str(reason), "seconds": time.process_time() - began}
    except Exception as reason:
        return {"crashed": "".join(traceback.format_exception(reason))[-4000:], "seconds": time.process_time() - began}
    seconds = time.process_time() - began
    said = read_json(out / "diagnosis.json")
    first = spoken.getvalue().strip().splitlines()[:1]
    return {
        "code": code, "verdict": said["verdict"], "causes": [_cause(c) for c in said["causes"]], "notes": said["notes"],
        "untestable": [f"{u['effect']}@{u['at']}" for u in said["untestable"]],
        "limits": {f"{d['effect']}@{d['at']}": d["value"] for d in said["detection_limits"]},
        "remainder": [[r["channel"], r["over"], r["p_value"], r["share"]] for r in said["remainder"]],
        "recalibrated": {name: [e["nominal"], e["value"]] for name, e in said["recalibrated"].items()},
        "found": {"parameters": said["parameters"], "effects": said["effects"], "between": said["between"]},
        "first": first, "says_worse": code == NOT_HANDED_OUT or any("worse" in line.lower() for line in first),
        "seconds": seconds,
    }  # fmt: skip


def command(words: Sequence[str], spoken: io.StringIO) -> int:
    """Exit code of a command; what it says goes to `spoken`. Lets its errors through."""
    from studies.cli import parser
    from studies.commands import run

    with redirect_stdout(spoken), redirect_stderr(io.StringIO()):
        return run(parser().parse_args(list(words)))


def _cause(c: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "key": f"{c['effect']}@{c['at']}", "ties": c["ties"], "stability": c["stability"],
        "delta_bic": c["evidence"]["delta_bic"], "sure": c["sure"], "doubt": c["doubt"],
        "parameters": {name: [e["value"], e["low"], e["high"]] for name, e in c["parameters"].items()},
        "units": {name: e["unit"] for name, e in c["parameters"].items()},
    }  # fmt: skip


def plant_of(row: Row, plant: Plant) -> Plant:
    """The plant with the parameters and effects that the answer of a row has found, whether it was handed out or not."""
    found = row["found"]
    return extension(plant.with_courses(found.get("between", {})), "", found["parameters"], found["effects"]).of(plant)


def misses(plant: Plant, e: Experiment) -> dict[str, np.ndarray]:
    """Errors (N, ny) of a plant as it is along a record, by horizon; its start and its noise levels are found on the record."""
    done = along(plant.sampled(e.dt), Dataset((e,)))
    return {horizon: errors(done.predictor, done.fit.point, 0, horizon) for horizon in HORIZONS}


def compared(plants: Sequence[Plant], held_out: Dataset) -> Errors:
    """Root mean square errors of each plant on every record and channel; None where a run did not last."""
    result: Errors = {h: {} for h in HORIZONS}
    for e in held_out:
        for plant in plants:
            add(result, plant, e, misses(plant, e))
    return result


def add(result: Errors, plant: Plant, e: Experiment, missed: Mapping[str, np.ndarray]) -> None:
    """Put the root mean squares of what a plant misses on a record behind those of the plants before it."""
    for horizon, wrong in missed.items():
        for j, c in enumerate(plant.outputs):
            if c.name in e.names:
                seen = wrong[SETTLING:, j][np.isfinite(wrong[SETTLING:, j])]
                with np.errstate(over="ignore"):
                    rms = float(np.sqrt(np.mean(seen**2))) if len(seen) else np.nan
                result[horizon].setdefault(f"{e.name}, {c.name}", []).append(rms if np.isfinite(rms) else None)
