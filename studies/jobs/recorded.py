"""Records of a machine of the workbench, for jobs that begin with some; and the numbers that such a job can vary."""

import math
from abc import ABC, abstractmethod
from argparse import Namespace
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from plants import PLANTS
from studies.experiments import EXPERIMENTS, measured, plan
from workbench.data import Dataset, Experiment
from workbench.errors import InputError, check_known
from workbench.physics.parameters import EffectSizes
from workbench.physics.plant import Plant
from workbench.records import field, record
from workbench.sweeps.design import Factor, Point
from workbench.toml import Table

Value = float | str


@record
class Setting:
    """A number of a job: what it is unless it is given, its unit, least and most that makes sense; whole: no fractions."""

    usual: float = field("")
    unit: str = ""
    low: float = field("", default=0.0)
    high: float = field("", default=math.inf)
    whole: bool = False

    def checked(self, name: str, value: Value) -> float:
        """The value, if it is one. Raises InputError."""
        if isinstance(value, str) or not self.low <= value <= self.high or (self.whole and value != int(value)):
            what = "a whole number" if self.whole else "a number"
            most = f" to {self.high:g}" * math.isfinite(self.high)
            raise InputError(
                f"{name} = {value}", file="sweep", mend=f"expected {what} from {self.low:g}{most} {self.unit}".rstrip()
            )
        return float(value)


#: Of records: sample time (0: the machine's own), factor of the sensors' noise, how many records.
RECORDING = {"dt": Setting(0.0, "s"), "noise": Setting(1.0), "records": Setting(0.0, low=0.0, high=100.0, whole=True)}


def settings(known: Mapping[str, Setting], fixed: Mapping[str, float], point: Point) -> dict[str, float]:
    """Every setting of a run: as the point has it, else as fixed, else as usual."""
    return {name: own.checked(name, point.values.get(name, fixed.get(name, own.usual))) for name, own in known.items()}


def check_settings(known: Mapping[str, Setting], varied: Iterable[Factor], own: Table) -> dict[str, float]:
    """The settings that [fixed] gives, checked; those that vary are checked too, and must be known and given once."""
    for factor in varied:
        name = check_known("parameter", factor.name, known, file=own.file)
        if name in own.content:
            raise own.refused(name, f"{own.content[name]}", "leave it out: it is varied")
        for value in factor.values or (factor.low, factor.high):
            known[name].checked(name, value)
    return {name: known[name].checked(name, value) for name in known if (value := own.number(name)) is not None}


@record
class Recorded:
    """A machine under experiments of its own, of which records are taken in turn, each round drawn anew; channels by role."""

    plant: str
    experiments: tuple[str, ...]
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    schedule: str = ""

    def __post_init__(self):
        check_known("machine with experiments", self.plant, EXPERIMENTS)
        for name in self.experiments:
            plan(self.plant, name)
        if not self.experiments:
            raise InputError("no experiments", file=self.plant, mend=f"some of {', '.join(EXPERIMENTS[self.plant])}")
        channels = (*self.machine.input_names, *self.machine.output_names)
        for name in (*self.inputs, *filter(None, [self.schedule])):
            check_known("channel", name, channels, file=self.plant)
        for name in self.outputs:
            check_known("output", name, self.machine.output_names, file=self.plant)

    @property
    def machine(self) -> Plant:
        return PLANTS[self.plant]

    def sampled(self, at: Mapping[str, float]) -> Plant:
        """The machine at these settings. What disturbs it has the same power over frequency at every sample time."""
        own = self.machine
        plant = own.sampled(at["dt"]) if at["dt"] else own
        spread = math.sqrt(own.dt / plant.dt)
        return replace(
            plant,
            noise={name: at["noise"] * value for name, value in own.noise.items()},
            disturbance={name: spread * value for name, value in own.disturbance.items()},
        )

    def records(
        self, seed: int, at: Mapping[str, float], *, held_out: bool = False, effects: EffectSizes | None = None
    ) -> Dataset:
        """As many as the settings say, by default one of each experiment; held_out: drawn apart from the others."""
        plant, n = self.sampled(at), len(self.experiments)
        found = []
        for i in range(int(at["records"]) or n):
            name = self.experiments[i % n]
            drawn = int(np.random.SeedSequence([seed, int(held_out), i // n]).generate_state(1)[0])
            found.append(self._named(measured(plant, name, drawn, effects), name, i // n))
        return Dataset(tuple(found))

    def _named(self, e: Experiment, name: str, again: int) -> Experiment:
        if self.inputs:
            schedule = (self.schedule,) if self.schedule else ()
            e = e.with_roles(inputs=self.inputs, outputs=self.outputs, schedule=schedule)
        return replace(e, name=f"{name} {again + 1}") if again else e


class OneByOne(ABC):
    """A job whose runs are made one after the other, by `one`: they hold Python's lock, so that threads would not help."""

    @abstractmethod
    def one(self, point: Point) -> Mapping[str, float] | Exception:
        """The numbers of a run, or why it has none."""

    def __call__(self, points: Sequence[Point]) -> list[Mapping[str, float] | Exception]:
        return [self.one(point) for point in points]

    def on_threads(self, count: int) -> None:
        """Threads of one process gain nothing."""
        return None


def recorded(own: Table, options: Namespace, *, roles: bool = True) -> Recorded:
    """Plant, experiments and, with `roles`, inputs, outputs and schedule, as [fixed] names them; --plant goes first."""
    if options.controller:
        raise InputError("--controller belongs to closed loops", mend='leave it out, or run = "closed-loop"')
    plant = options.plant or own.text("plant", None)
    if not roles:
        return Recorded(plant, own.texts("experiments"))
    schedule = own.text("schedule", "")
    return Recorded(plant, own.texts("experiments"), own.texts("inputs"), own.texts("outputs"), schedule)
