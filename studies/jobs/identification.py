"""A model of a machine's records: how well it runs free on records that it never saw, and how wide and true its envelope is."""

from argparse import Namespace
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from studies.jobs.recorded import RECORDING, OneByOne, Recorded, Setting, check_settings, recorded, settings
from workbench.data import Dataset
from workbench.errors import InputError, check_known
from workbench.identification import METHODS
from workbench.intervals.coverage import cover, pooled
from workbench.intervals.regression import BySchedule, IntervalRegression, OneMode
from workbench.intervals.regressors import ARX
from workbench.intervals.semantics import InclusionExact
from workbench.metrics import fit, score
from workbench.records import record
from workbench.simulation import replay
from workbench.sweeps.design import Point, Sweep
from workbench.toml import Table

INTERVAL = "interval"
MODELS = (*METHODS, INTERVAL)
KNOWN = RECORDING | {
    "order": Setting(0.0, high=50.0, whole=True),  # 0: chosen by the method, 2 of an interval model
    "intervals": Setting(5.0, low=1.0, high=50.0, whole=True),  # of the schedule, each with a box of its own
}
FIXED = ("plant", "inputs", "outputs", "schedule", "experiments", "held_out", "model", *KNOWN)


@record
class Identification(OneByOne):
    """Models of `recorded`, judged on the experiments `held_out`, one record of each.

    A run gives for every output the mean FIT [%] of free runs, and that of the true machine without noise, which no model
    beats by more than luck; of an interval model instead how many values its one-step envelope holds [%], and its mean radius.
    What varies: `KNOWN`, and `model`, one of `MODELS`. Boxes hold the records as they were measured.
    """

    recorded: Recorded
    held_out: tuple[str, ...]
    fixed: Mapping[str, float]
    models: tuple[str, ...]
    parameters: tuple[str, ...]

    def __post_init__(self):
        for name in self.models:
            check_known("model", name, MODELS, file="sweep")
        replace(self.recorded, experiments=self.held_out)  # refuses what it does not know

    @property
    def configuration(self) -> Mapping[str, Any]:
        return {**vars(self), "recorded": vars(self.recorded)}

    @property
    def units(self) -> Mapping[str, str]:
        return {name: KNOWN[name].unit if name in KNOWN else "" for name in self.parameters}

    @property
    def outputs(self) -> Mapping[str, str]:
        plant, found = self.recorded.machine, {}
        for c in (c for c in plant.outputs if c.name in self.recorded.outputs):
            found |= {f"{c.name} FIT": "%", f"{c.name} machine FIT": "%"} if {*self.models} - {INTERVAL} else {}
            found |= {f"{c.name} inside": "%", f"{c.name} width": c.unit} if INTERVAL in self.models else {}
        return found

    def one(self, point: Point) -> Mapping[str, float]:
        at = settings(KNOWN, self.fixed, point)
        model = check_known("model", str(point.values.get("model", self.models[0])), MODELS, file="sweep")
        estimation = self.recorded.records(point.seed, at)
        held_out = replace(self.recorded, experiments=self.held_out).records(point.seed, at | {"records": 0.0}, held_out=True)
        order = int(at["order"])
        if model == INTERVAL:
            return self._bounded(estimation, held_out, order or 2, int(at["intervals"]))
        found = METHODS[model](**({"order": order} if order else {})).fit(estimation)
        scores = score(found, held_out, "held-out", ("free-run",))
        true = [(e, replay(self.recorded.sampled(at), e).experiment) for e in held_out]
        said = {}
        for y in self.recorded.outputs:
            said[f"{y} FIT"] = float(np.mean([s.FIT for s in scores if s.output == y]))
            said[f"{y} machine FIT"] = float(np.mean([fit(e[y], run[y]) for e, run in true]))
        return said

    def _bounded(self, estimation: Dataset, held_out: Dataset, order: int, intervals: int) -> dict[str, float]:
        modes = BySchedule(intervals) if self.recorded.schedule else OneMode()
        method, found = IntervalRegression(ARX(order), InclusionExact(), modes, 0.0, 0.0), {}
        for y in self.recorded.outputs:
            lines = cover(method.fit(estimation, y), held_out, "held-out", free_run=False)
            found[f"{y} inside"] = 100.0 * pooled(lines, lambda line: line.coverage)
            found[f"{y} width"] = pooled(lines, lambda line: line.mean_radius)
        return found


def from_file(sweep: Sweep, file: Path, options: Namespace) -> Identification:
    """[fixed] plant, inputs, outputs, schedule, experiments, held_out, model, and any of `KNOWN`."""
    own = Table(file, "fixed", dict(sweep.fixed), FIXED)
    varied = {p.name: p for p in sweep.factors}
    if "model" in varied and "model" in own.content:
        raise own.refused("model", repr(own.content["model"]), "leave it out: it is varied")
    models = varied["model"].values if "model" in varied else (own.text("model", None),)
    if not all(isinstance(name, str) for name in models) or not models:
        raise InputError("[parameters.model] has numbers", file=file, mend=f"give texts: some of {', '.join(MODELS)}")
    fixed = check_settings(KNOWN, [p for p in sweep.factors if p.name != "model"], own)
    logged = recorded(own, options)
    return Identification(logged, own.texts("held_out"), fixed, tuple(map(str, models)), tuple(varied))
