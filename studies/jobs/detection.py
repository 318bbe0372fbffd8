"""An effect of a given size, hidden in a machine's records: is it found, and is it the one that is named?

What is hidden comes from the catalogue itself: the study hidden-effects hides physics with equations of its own.
"""

from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from studies.jobs.recorded import RECORDING, OneByOne, Recorded, Setting, check_settings, recorded, settings
from workbench.diagnosis.diagnosis import diagnose
from workbench.errors import InputError, check_known
from workbench.records import record
from workbench.sweeps.design import Point, Sweep
from workbench.toml import Table

KNOWN = RECORDING | {"size": Setting(0.0, low=-1e300)}
FIXED = ("plant", "experiments", "effect", *KNOWN)
SAID = ("found", "named", "wrong", "inside")


@record
class Detection(OneByOne):
    """Records of a machine with effect@place:parameter = size in them, diagnosed against the machine without it.

    A run gives, 1 or 0: found (named, or one of a tie), named (alone), wrong (a cause is named that is not there, nor tied with
    what is); the estimated size, and whether the true one is inside its 95 % interval (nothing where it was not found); and the
    smallest size that the diagnosis says these records show. What varies: `KNOWN`.
    """

    recorded: Recorded
    effect: str
    fixed: Mapping[str, float]
    parameters: tuple[str, ...]

    def __post_init__(self):
        known = {str(slot): slot for slot in self.recorded.machine.slots}
        check_known("effect", self.effect, known, file=self.recorded.plant)
        if known[self.effect].parameter.shape:
            raise InputError(f"{self.effect} is a shape", file="sweep", mend="hide a size of the effect: it is neutral at 0")

    @property
    def configuration(self) -> Mapping[str, Any]:
        return {**vars(self), "recorded": vars(self.recorded)}

    @property
    def unit(self) -> str:
        return next(slot.parameter.unit for slot in self.recorded.machine.slots if str(slot) == self.effect)

    @property
    def units(self) -> Mapping[str, str]:
        return {name: self.unit if name == "size" else KNOWN[name].unit for name in self.parameters}

    @property
    def outputs(self) -> Mapping[str, str]:
        return dict.fromkeys(SAID, "") | {"estimate": self.unit, "limit": self.unit}

    def one(self, point: Point) -> Mapping[str, float]:
        at = settings(KNOWN, self.fixed, point)
        key, _, parameter = self.effect.rpartition(":")
        hidden = {key: {parameter: at["size"]}} if at["size"] else {}
        found = diagnose(self.recorded.sampled(at), self.recorded.records(point.seed, at, effects=hidden))
        own = [cause for cause in found.causes if cause.key == key or key in cause.ties] if hidden else []
        alone = [cause for cause in own if cause.key == key and not cause.ties]
        said = {"found": bool(own), "named": bool(alone), "wrong": len(found.causes) > len(own)}
        limits = [limit.value for limit in found.limits if f"{limit.effect}@{limit.place}" == key]
        seen = {name: float(value) for name, value in said.items()} | {"limit": limits[0] if limits else float("nan")}
        for cause in own:
            if cause.key == key and parameter in cause.parameters:
                p = cause.parameters[parameter]
                seen |= {"estimate": p.value, "inside": float(p.low <= at["size"] <= p.high)}
        return seen


def from_file(sweep: Sweep, file: Path, options: Namespace) -> Detection:
    """[fixed] plant, experiments, effect (id@place:parameter), and any of `KNOWN`."""
    own = Table(file, "fixed", dict(sweep.fixed), FIXED)
    names = tuple(p.name for p in sweep.factors)
    logged = recorded(own, options, roles=False)
    return Detection(logged, own.text("effect", None), check_settings(KNOWN, sweep.factors, own), names)
