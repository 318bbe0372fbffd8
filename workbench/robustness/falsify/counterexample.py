"""The counterexample: a run that breaks a limit, with all that is needed to run it again, and its file.

The worst run is saved as a `Counterexample` it can be replayed from: the same numbers on the same machine.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from workbench.errors import InputError, check_known
from workbench.files import read_json, write_json
from workbench.physics.controller import Controller, Stepped
from workbench.physics.parameters import EffectSizes
from workbench.physics.plant import Plant
from workbench.records import RecordError, field, record
from workbench.robustness.falsify.reading import AGAIN, expect, finite_number, finite_numbers, finite_series
from workbench.robustness.limits import BOUNDS, RANGE, Excess, Limit, resolved, setpoint_of
from workbench.simulation import Run, Scenario, simulate

SCHEMA, VERSION = "gain-scheduling-workbench/counterexample", 1
SAME = 1e-9  # relative difference up to which a replay has found the same
LIMIT_NUMBERS = ("low", "high", "rate", "band", "settling", "begin")


@record
class Counterexample:
    """A run that stands alone: plant, controller, scenario, parameters and effects, and by how much it breaks which limit.

    base: what the plant was called (a machine's name, or the user's file.py:NAME, which is never run from here). controller: the
    content of its file. parameters, effects: all of them. excess: in the unit of the bound, infinite for a run that left the
    range of the plant; it is found at `sample`, where the signal is `value`.
    """

    plant: str
    base: str
    dt: float = field("", unit="s", low=1e-12)
    controller: Mapping[str, Any]
    scenario: Scenario
    bumpless: bool
    substeps: int
    parameters: Mapping[str, float]
    effects: EffectSizes
    limit: Limit
    bound: str
    excess: float
    sample: int
    value: float

    @property
    def time(self) -> float:
        """Where the limit is broken most [s]."""
        return self.sample * self.dt

    @property
    def sentence(self) -> str:
        """What is broken, where and by how much."""
        return excess_sentence(self.limit, self.bound, self.excess, self.time, self.value)

    def to_dict(self) -> dict[str, Any]:
        """What its file holds, schema and version inside, readable without this package."""
        limit = {name: getattr(self.limit, name) for name in LIMIT_NUMBERS}
        return {
            "schema": SCHEMA, "version": VERSION, "plant": self.plant, "base": self.base, "dt": self.dt,
            "limit": {"signal": self.limit.signal, "unit": self.limit.unit}
            | {name: value for name, value in limit.items() if math.isfinite(value)},
            "bound": self.bound, "excess": _finite(self.excess), "sample": self.sample, "time": self.time,
            "value": _finite(self.value), "parameters": dict(self.parameters),
            "effects": {key: dict(numbers) for key, numbers in self.effects.items()},
            "substeps": self.substeps, "bumpless": self.bumpless,
            "scenario": {
                "name": self.scenario.name, "seed": self.scenario.seed, "start": dict(self.scenario.start),
                "references": dict(self.scenario.references), "disturbance": dict(self.scenario.disturbance),
            },
            "controller": dict(self.controller),
        }  # fmt: skip

    def save(self, path: str | Path) -> Path:
        """Write the file."""
        return write_json(path, self.to_dict())

    def replay(self, plant: Plant, controller: Controller | Stepped) -> "Replayed":
        """Run it again. Raises InputError where the plant is another one."""
        if plant.name != self.plant:
            raise InputError(f"is of plant {self.plant!r}, not {plant.name!r}", file="counterexample", mend=f"give {self.base}")
        if missing := [q.name for q in plant.parameters if q.name not in self.parameters]:
            raise InputError(f"holds no parameter {', '.join(missing)}", file="counterexample", mend="search again")
        plant = replace(plant.sampled(self.dt), effects={})  # the file holds all that acts
        limit, *_ = resolved([self.limit], plant, controller)
        run = simulate(
            plant, controller, self.scenario, parameters=self.parameters, effects=self.effects, substeps=self.substeps,
            bumpless=self.bumpless, cut=True,
        )  # fmt: skip
        values, found = judged(run, self.scenario, limit, controller)
        sample, bound = int(found.sample[0]), found.bound_of()
        at_place = bound == self.bound and sample == self.sample
        excess, value = float(found.value[0]), float(values[sample])
        return Replayed(run, excess, sample, value, at_place and same(excess, self.excess) and same(value, self.value))


@record
class Replayed:
    """A counterexample run again; same: it has found what the file says."""

    run: Run
    excess: float
    sample: int
    value: float
    same: bool


def excess_sentence(limit: Limit, bound: str, excess: float, time: float, value: float) -> str:
    unit = limit.unit_of(bound)
    if bound == RANGE:
        return f"{limit.signal}: the run leaves the range of the plant at {time:g} s"
    said = f"band of {limit.band:g}" if bound == "settling" else f"{bound} of {getattr(limit, bound):g}"
    told = "broken by" if excess > 0.0 else "kept with"
    return f"{limit.signal}: {said} {unit} {told} {abs(excess):.6g} {unit} at {time:g} s, where it is {value:.6g} {limit.unit}"


def same(found: float, stored: float) -> bool:
    """Whether a replay has found the number of the file, within SAME of it; numbers that are not finite must agree."""
    if math.isfinite(found) and math.isfinite(stored):
        return abs(found - stored) <= SAME * max(abs(found), abs(stored))
    return found == stored or (math.isnan(found) and math.isnan(stored))


def _finite(value: float) -> float | None:
    """The number, None where it is none: JSON has no infinity."""
    return value if math.isfinite(value) else None


def judged(run: Run, scenario: Scenario, limit: Limit, controller: Any) -> tuple[np.ndarray, Excess]:
    """The signal (N), NaN from where the run has left the range, and by how much it breaks the limit."""
    values = np.full(len(scenario), np.nan)
    values[: len(run.experiment)] = run.experiment[limit.signal]
    reference = setpoint_of(limit, controller)
    t = run.experiment.dt * np.arange(len(scenario))
    return values, limit.excess(t, values, scenario.references[reference] if reference else None)


def load_counterexample(path: str | Path) -> Counterexample:
    """Read a file written by `Counterexample.save`. Raises InputError naming what is missing, foreign or not a number."""
    return counterexample_of(read_json(path), path)


def counterexample_of(content: Any, path: str | Path = "a counterexample") -> Counterexample:
    """The counterexample that the content of a file makes; path: the file that holds it, for messages."""
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise InputError("not a counterexample", file=path, mend=f"expected a JSON object with schema {SCHEMA!r}")
    if content.get("version") != VERSION:
        raise InputError(f"counterexample version {content.get('version')}, this program reads {VERSION}", file=path, mend=AGAIN)
    kinds = {
        "plant": str, "base": str, "controller": dict, "scenario": dict, "bumpless": bool, "substeps": int, "parameters": dict,
        "effects": dict, "limit": dict, "bound": str, "sample": int,
    }  # fmt: skip
    for name, kind in kinds.items():
        expect(path, name, content.get(name), kind)
    limit, own = content["limit"], content["scenario"]
    for place, value, kind in (
        ("signal", limit.get("signal"), str), ("unit", limit.get("unit"), str), ("name", own.get("name"), str),
        ("references", own.get("references"), dict), ("start", own.get("start"), dict),
        ("disturbance", own.get("disturbance"), dict),
    ):  # fmt: skip
        expect(path, place, value, kind)
    seed = own.get("seed")
    if seed is not None:
        expect(path, "seed", seed, int)
    if not own["name"] or Path(own["name"]).name != own["name"]:  # records are named by it, and stay in their folder
        raise InputError(f"scenario {own['name']!r} is no name for a record", file=path, mend=AGAIN)
    check_known("bound", content["bound"], (*BOUNDS, RANGE), file=path)
    scenario = Scenario(
        own["name"], finite_series(path, own["references"]), seed, finite_numbers(path, "start", own["start"]),
        finite_series(path, own["disturbance"]),
    )  # fmt: skip
    if not 0 <= content["sample"] < len(scenario) or content["substeps"] < 1 or (seed is not None and seed < 0):
        raise InputError("sample, substeps or seed out of range", file=path, mend=AGAIN)
    bounds = {name: finite_number(path, f"limit, {name}", limit[name]) for name in LIMIT_NUMBERS if name in limit}
    lost = content["bound"] == RANGE
    try:
        return Counterexample(
            content["plant"], content["base"], finite_number(path, "dt", content.get("dt")), content["controller"], scenario,
            content["bumpless"], content["substeps"], finite_numbers(path, "parameters", content["parameters"]),
            {key: finite_numbers(path, key, numbers) for key, numbers in content["effects"].items()},
            Limit(limit["signal"], unit=limit["unit"], **bounds), content["bound"],
            np.inf if lost else finite_number(path, "excess", content.get("excess")), content["sample"],
            np.nan if lost else finite_number(path, "value", content.get("value")),
        )  # fmt: skip
    except RecordError as reason:
        raise InputError(str(reason), file=path, mend=AGAIN) from None
