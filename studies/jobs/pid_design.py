"""A scheduled PID from a machine's records: identified, designed, and run on the machine."""

from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from controllers.pid_design import Structure, design_pid
from studies.jobs.closed_loop import run_of, score_units, scores, single_run
from studies.jobs.recorded import RECORDING, OneByOne, Recorded, Setting, check_settings, recorded, settings
from workbench.errors import InputError, check_known
from workbench.identification.lti import LTI
from workbench.identification.ssm import SSM
from workbench.records import record
from workbench.robustness.frozen import DEFAULT, Bounds
from workbench.robustness.limits import Manoeuvre
from workbench.sweeps.design import Point, Sweep
from workbench.toml import Table

KNOWN = RECORDING | {
    "order": Setting(0.0, high=50.0, whole=True),  # 0: chosen by the method
    "peak": Setting(DEFAULT.sensitivity, low=1.05, high=10.0),  # bound on |S| and |T|
    "effort": Setting(DEFAULT.effort, low=1.05, high=1e3),
    "knots": Setting(3.0, low=1.0, high=20.0, whole=True),
}
LIMITS = {"low": -np.inf, "high": np.inf, "rate": np.inf}
FIXED = ("plant", "inputs", "outputs", "schedule", "experiments", "run", *LIMITS, *KNOWN)
MARGINS = {"bandwidth": "rad/s", "sensitivity": "", "delay margin": "s", "integral action": "1/s"}


@record
class DesignedLoop(OneByOne):
    """For every run records are made, a model, a PID whose frozen loops keep their bounds, and a run of the machine under it.

    A run gives, the worst over the schedule each: bandwidth (|S| first reaches 1 / sqrt(2)), largest |S|, delay margin and
    integral action; and the scores of the closed loop, at the samples. What varies: `KNOWN`. limits: low, high and rate of
    commands by name.
    """

    recorded: Recorded
    run: Manoeuvre
    limits: Mapping[str, Mapping[str, float]]
    fixed: Mapping[str, float]
    parameters: tuple[str, ...]

    def __post_init__(self):
        for name in (name for own in self.limits.values() for name in own):
            check_known("input", name, self.recorded.inputs, file="sweep")
        if {*self.run.setpoints} != {*self.recorded.outputs}:
            missing = ", ".join(sorted({*self.run.setpoints} ^ {*self.recorded.outputs}))
            raise InputError(f"outputs and set-points differ: {missing}", file="sweep", mend="give each output one set-point")

    @property
    def configuration(self) -> Mapping[str, Any]:
        return {**vars(self), "recorded": vars(self.recorded), "run": vars(self.run)}

    @property
    def units(self) -> Mapping[str, str]:
        return {name: KNOWN[name].unit for name in self.parameters}

    @property
    def outputs(self) -> Mapping[str, str]:
        return MARGINS | score_units(self.recorded.machine, self.recorded.outputs, self.recorded.inputs)

    def one(self, point: Point) -> Mapping[str, float] | Exception:
        at = settings(KNOWN, self.fixed, point)
        method = SSM if self.recorded.schedule else LTI
        # held commands cannot act on the output of their own sample
        model = method(order=int(at["order"]) or None, feedthrough=False).fit(self.recorded.records(point.seed, at))
        found = design_pid(
            model,
            knots=int(at["knots"]) if self.recorded.schedule else 1,
            bounds=Bounds(at["peak"], at["peak"], at["effort"]),
            structure=Structure(**self._limits()),
            setpoint=[self.run.setpoints[y][0][1] for y in self.recorded.outputs],
        )
        plant, law, m = self.recorded.sampled(at), found.law, found.margins
        scenario = Manoeuvre(self.run.duration, self.run.setpoints, self.run.start, point.seed).scenario(plant, law, "sweep")
        seen = scores(plant, law, scenario, *single_run(plant, law, scenario))
        if isinstance(seen, Exception):
            return seen
        worst = (m.bandwidth.min(), m.sensitivity.max(), m.delay.min(), found.low_frequency.min())
        return dict(zip(MARGINS, map(float, worst), strict=True)) | dict(seen)

    def _limits(self) -> dict[str, Any]:
        return {
            key: np.array([own.get(name, LIMITS[key]) for name in self.recorded.inputs])
            for key, own in self.limits.items()
            if own
        }


def from_file(sweep: Sweep, file: Path, options: Namespace) -> DesignedLoop:
    """[fixed] plant, inputs, outputs, schedule, experiments, run, tables low, high and rate, and any of `KNOWN`."""
    own = Table(file, "fixed", dict(sweep.fixed), FIXED)
    names = tuple(p.name for p in sweep.factors)
    fixed = check_settings(KNOWN, sweep.factors, own)
    logged = recorded(own, options)
    limits = {}
    for key in LIMITS:
        table = own.table(key, logged.inputs)
        limits[key] = {name: value for name in table.content if (value := table.number(name)) is not None}
    return DesignedLoop(logged, run_of(own), limits, fixed, names)
