"""Everything that reads a file of a user's, with a whole file of its kind to begin from.

A reader may give what it has read, or raise InputError; nothing else, whatever the bytes are.
"""

import io
import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from controllers.files import load_controller, save_controller
from controllers.pid import pid
from plants import PLANTS
from tests.controllers.test_mpc import law as mpc_law
from tests.controllers.test_mpc import lpv
from tests.workbench.intervals.test_model import METHODS as INTERVALS
from tests.workbench.intervals.test_model import plant as interval_records
from tests.workbench.robustness.test_verdict import drawn_loop
from workbench.curves import Curve
from workbench.data import Dataset
from workbench.errors import InputError
from workbench.hammerstein import HammersteinWienerModel, load_hammerstein
from workbench.intervals.model import IntervalModel, load_interval_model
from workbench.lpv import load_model
from workbench.physics.extension import extension, load_extension
from workbench.readers import read_file
from workbench.report import figures
from workbench.report.archive import read_report
from workbench.report.blocks import Report, Section, Table, Text
from workbench.report.page import write_report
from workbench.robustness.falsify.box import fitted_box, tolerance_box
from workbench.robustness.falsify.counterexample import load_counterexample
from workbench.robustness.falsify.search import worst_plant
from workbench.robustness.falsify.trials import Search
from workbench.robustness.limits import Limit, Manoeuvre, load_limits
from workbench.robustness.margins import margin
from workbench.robustness.sequences import Growth, load_sequence
from workbench.sweeps.design import load_sweep

CSV = b"t [s],V1 [V],w3 [rad/s],r2 [m]\n" + b"".join(
    b"%.2f,%.3f,%d,0.0%d\n" % (0.04 * k, 0.1 * k, 90 + k, 11 + k) for k in range(12)
)
LIMITS = b"""[run]
duration = 8.0
seed = 3
[run.start]
r2 = 0.012
[run.setpoints]
v = [[0.0, 0.0], [2.0, 0.2]]
[limits.v]
low = -0.2
high = 0.35
band = 0.05
settling = 3.0
[limits.u]
rate = 4.0
begin = 1.0
[loop]
stable = true
sensitivity = 1.7
margin = 1.0
disk = 0.5
"""
SWEEP = b"""run = "closed-loop"
design = "sobol"
count = 8
seeds = [1, 2]
outputs = ["v RMS"]
[parameters.m1]
low = 0.7
high = 1.5
scale = "log"
[parameters.b1]
values = [0.1, 0.2, "a"]
[fixed]
plant = "welding-robot"
controller = "pid.json"
[fixed.run]
duration = 8.0
[fixed.run.setpoints]
v = 0.1
"""


class Target:
    """A reader, the ending of its files, and a whole file."""

    def __init__(self, read: Callable[[Path], Any], ending: str, seed: bytes):
        self.read, self.ending, self.seed = read, ending, seed

    def tried(self, folder: Path, content: bytes) -> None:
        """Read these bytes; whatever is raised but InputError is a finding."""
        path = folder / f"file{self.ending}"
        path.write_bytes(content)
        with suppress(InputError):
            self.read(path)


def _mat() -> bytes:
    from scipy.io import savemat

    stream = io.BytesIO()
    t = 0.01 * np.arange(20.0)
    savemat(stream, {"t": t, "u": np.sin(t), "y": np.column_stack([t, t**2])})
    return stream.getvalue()


def _saved(save: Callable[[Path], Any], folder: Path) -> bytes:
    path = folder / "seed.json"
    save(path)
    return path.read_bytes()


def targets(folder: Path) -> dict[str, Target]:
    """By name; folder: room to write the whole files in."""
    robot = PLANTS["welding-robot"]
    law = pid(("u",), ("v",), ("v_set",), 0.02, Kp=[[6.0]], Ki=[[8.0]], low=(-4.0,), high=(4.0,))
    curved = replace(law, curves=(Curve("u", [-4.0, 0.0, 4.0], [-2.0, 0.0, 6.0]),))
    scenario = Manoeuvre(0.2, {"v": ((0.0, 0.4),)}, seed=3).scenario(robot, law)
    worst = worst_plant(Search(robot, law, scenario, [Limit("v", high=0.01)], tolerance_box(robot)[:2], runs=4, seed=1))
    lost = worst.counterexample("welding-robot", {"schema": "x"})
    interval = {"nominal": 0.3, "value": 0.4, "low": 0.35, "high": 0.45}
    cause = {"effect": "coulomb", "at": "rail", "parameters": {"level": {"value": 0.2, "low": 0.1, "high": 0.3, "unit": "N"}}}
    diagnosis = {"causes": [cause], "recalibrated": {"b1": interval}}
    t = np.linspace(0.0, 1.0, 20)
    drawn = figures.responses("Step", t, {"a": t}, "m")
    page = Report("T", "v", (Section("S", (drawn, Text("x"), Table("n", ("a", "b"), (("x", 1.5), ("y", np.inf)), best=max))),))
    write_report(page, folder)
    whole = (folder / "report.json").read_bytes()

    def known(_: str) -> Any:
        raise InputError("no plant here")

    def law_of(path: Path) -> Any:
        return load_controller(path, known)

    def reread(path: Path) -> Report:
        path.replace(folder / "report.json")
        return read_report(folder)

    return {
        "csv": Target(read_file, ".csv", CSV),
        "mat": Target(read_file, ".mat", _mat()),
        "limits": Target(load_limits, ".toml", LIMITS),
        "sweep": Target(load_sweep, ".toml", SWEEP),
        "model": Target(load_model, ".json", _saved(lpv().save, folder)),
        "hammerstein": Target(load_hammerstein, ".json", _saved(_curved().save, folder)),
        "interval": Target(load_interval_model, ".json", _saved(_interval().save, folder)),
        "pid": Target(law_of, ".json", _saved(lambda path: save_controller(curved, path), folder)),
        "mpc": Target(law_of, ".json", _saved(lambda path: save_controller(mpc_law(), path), folder)),
        "extension": Target(
            load_extension, ".json",
            _saved(extension(robot, "welding-robot", {"m1": 1.2}, {"coulomb@rail": {"level": 0.1}}).save, folder),
        ),
        "diagnosis": Target(lambda path: fitted_box(robot, path), ".json", json.dumps(diagnosis).encode()),
        "counterexample": Target(load_counterexample, ".json", _saved(lost.save, folder)),
        "sequence": Target(load_sequence, ".json", _saved(_growth().save, folder)),
        "report": Target(reread, ".json", whole),
    }  # fmt: skip


def _curved() -> HammersteinWienerModel:
    core = lpv()
    return HammersteinWienerModel(
        "h", core, (Curve(core.inputs[0].name, [-1.0, 0.0, 2.0], [-0.5, 0.0, 3.0]),), (core.outputs[1].name,), np.eye(2)
    )


def _interval() -> IntervalModel:
    return INTERVALS["by schedule"].fit(Dataset((interval_records(60, 1),)))


def _growth() -> Growth:
    found = margin(drawn_loop(3))
    return Growth("stable", found.loop, found.falsified)
