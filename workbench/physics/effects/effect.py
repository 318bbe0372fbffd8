"""An effect: one piece of physics that a nominal model leaves out, switched on by its parameters.

The same object is truth when a plant switches it on and an explanation when a diagnosis offers it.
"""

import re
from collections.abc import Callable
from enum import Enum
from typing import Any, ClassVar

import numpy as np

from workbench.errors import InputError
from workbench.records import field, record


class UnknownNameError(InputError, AttributeError):
    """An equation asks for a name that its plant does not have."""


class Named:
    """Numbers by name: `p.J0`. Values may be floats, arrays or CasADi symbols; it only holds them."""

    def __init__(self, values: dict):
        self.__dict__.update(values)

    def __getattr__(self, name: str):
        if name.startswith("__"):
            raise AttributeError(name)
        raise UnknownNameError(f"the equation asks for {name!r}", mend=f"here are: {', '.join(self.__dict__) or 'no names'}")


class GridUnit(Enum):
    """What the numbers of a grid are multiplied by before they are tried."""

    ONE = "1: they are in the parameter's own unit"
    COMMAND = "the largest |logged command| of the actuator"
    IMPULSE = "the largest |logged command| of the actuator times the sample time"
    SAMPLE = "the sample time"
    NOISE = "the standard deviation of the channel's noise"
    RECORD = "the length of the record"
    SPEED = "the largest speed of what turns or slides"
    LEVEL = "the highest level of the tank"
    CYCLES = "1: they are the shortest and the longest period, between which all that the record tells apart are tried"


class Domain(Enum):
    """What an effect is drawn over, so that a reader sees it.

    >>> sorted(effect.id for effect in EFFECTS.values() if effect.domain is Domain.TENSION)
    ['nonlinear-elasticity']
    """

    SPEED = "what is missing over speed"
    ANGLE = "what is missing over the angle of what turns"
    LOAD = "what is missing over the load"
    TENSION = "what is missing over the tension"
    STRETCH = "what is missing over the stretch of a spring"
    HEAD = "what is missing over the level of a tank"
    COMMAND = "what acts over what was commanded"
    LEVEL = "what is read over what there is"
    SHIFT = "measured and simulated over time, one later than the other"
    TIME = "what is missing over time"


PER_TURN = "1/turn"


@record
class EffectParameter:
    """One number of an effect. A size is exactly neutral at 0; a shape (width, time constant) has a default instead.

    grid: values of a shape that a search tries before it refines them, in grid_unit.

        >>> level = EffectParameter("level", "N m", low=0.0)
        >>> speed = EffectParameter("speed", "rad/s", low=0.1, default=10.0, shape=True)
    """

    name: str
    unit: str
    low: float = field("", default=-np.inf)
    high: float = field("", default=np.inf)
    default: float = field("", default=0.0)
    shape: bool = False
    grid: tuple[float, ...] = ()
    grid_unit: GridUnit = GridUnit.ONE

    def __post_init__(self):
        if not self.shape and self.default != 0.0:
            raise InputError(f"size {self.name!r} must be 0 by default: 0 is neutral")
        if not self.shape and self.grid:
            raise InputError(f"size {self.name!r} has a grid: the grid of a size belongs to its effect")
        if not self.low <= self.default <= self.high:
            raise InputError(f"{self.name!r} is {self.default:g} by default, outside [{self.low:g}, {self.high:g}]")
        if not self.name.isidentifier():
            raise InputError(f"number {self.name!r}: expected a name as in Python, a law asks for it as e.name")


@record
class Effect:
    """Missing physics at a port: a law that vanishes when its sizes are 0.

    law: the equation; what it takes and returns is fixed by the family (its file says so).
    sentence: the cause in a technician's words; {place} is filled in.
    separates: what separates it from its look-alikes.
    equation: the law as text, in the names of the parameters and the symbols of the port; with "^" for powers it can be computed.
    domain: what it is drawn over.
    regular: the response is smooth in the sizes at 0; otherwise `grid` holds finite sizes to try, in grid_unit.
    phase: the sizes (cosine, sine) hold a phase that differs from record to record; their amplitude does not.
    state: it has a state of its own, integrated with those of the plant. memories: numbers that it keeps from one step, or of an
    actuator from one sample, to the next. middle: the law of a sensor is also given the quantity in the middle of the step.
    includes: ids of effects that it becomes for some of its numbers.

        >>> EFFECTS["coulomb"].equation, EFFECTS["coulomb"].sentence.format(place="the spindle")
        ('torque = -level * tanh(v / width)', 'Dry friction at the spindle: a constant torque against the direction of motion.')
    """

    id: str
    family: str
    parameters: tuple[EffectParameter, ...]
    sentence: str
    separates: str
    equation: str
    law: Callable
    domain: Domain
    regular: bool = True
    grid: tuple[float, ...] = ()
    grid_unit: GridUnit = GridUnit.ONE
    phase: bool = False
    state: bool = False
    memories: int = 0
    middle: bool = False
    includes: tuple[str, ...] = ()

    def __post_init__(self):
        if self.regular == bool(self.grid):
            raise InputError(f"effect {self.id!r}: a grid belongs to an effect that is not regular, and only to one")
        if not self.regular and len(self.sizes) != 1:
            raise InputError(f"effect {self.id!r}: a grid is for one size, here are {len(self.sizes)}")
        if self.phase and [p.name for p in self.sizes] != ["cosine", "sine"]:
            raise InputError(f"effect {self.id!r}: a phase needs the sizes cosine and sine")
        if self.phase and [p.unit for p in self.parameters if p.shape] not in ([], [PER_TURN], ["Hz"]):
            raise InputError(f"effect {self.id!r}: a phase goes with one shape at most, an order in 1/turn or a frequency in Hz")
        if not self.id.replace("-", "_").isidentifier():
            raise InputError(f"effect {self.id!r}: an id is made of letters, digits and hyphens, such as air-drag")
        if not self.sizes:
            raise InputError(f"effect {self.id!r}: one number at least must be a size, which at 0 is no effect")

    @property
    def sizes(self) -> tuple[EffectParameter, ...]:
        """The parameters that are neutral at 0."""
        return tuple(p for p in self.parameters if not p.shape)

    @property
    def stated(self) -> str:
        """The equation; of an effect with a phase also what its amplitude is, which a diagnosis states."""
        return f"{self.equation}, amplitude = sqrt(cosine^2 + sine^2)" if self.phase else self.equation


@record
class Port:
    """Where effects of one family act; `place` names it in an equation and in effect keys, such as coulomb@unwind.

    memories: how many numbers an effect may keep here from step to step; states: whether it may have a state of its own.
    """

    place: str
    family = ""
    symbols = ""  # of the equations of its effects, with their signs
    law = ""  # what the laws of its effects take and return
    memories: ClassVar[float] = 0
    states: ClassVar[bool] = False

    def symbols_of(self, effect: Effect) -> str:
        """What the symbols in the equation of an effect mean here, with their signs."""
        words = set(re.findall(r"\w+", effect.equation))
        return "; ".join(part for part in self.symbols.split("; ") if words & set(part.split(":")[0].split(", ")))

    def fits(self, effect: Effect) -> bool:
        """Whether an effect of the family makes sense at this port."""
        del effect
        return True

    def fitted(self, parameter: EffectParameter) -> EffectParameter:
        """A parameter of an effect as it reads at this port."""
        return parameter

    def worded(self, effect: Effect) -> Effect:
        """An effect whose texts are those of this port."""
        return effect

    def beyond(self, effect: Effect, e: Named, some: Callable[[], Any]) -> list:
        """What a law does with the numbers `e`: all 0 while its sizes are 0. `some` makes an argument of it."""
        del effect, e, some
        return []


FOREVER = 1e9  # s: after a hold of this length nothing moves any more
STEP_RISE = 0.05  # s: a jump is 95 % done 0.075 s after its time, and a sampled record cannot tell it from a sudden one


def smooth_step(t, time):
    """0 long before `time`, 1/2 at it, 1 long after it."""
    return 0.5 * (1.0 + np.tanh((t - time) / STEP_RISE))


def jump_time() -> EffectParameter:
    """The shape of every effect that sets in during a record: when."""
    return EffectParameter(
        "time", "s", low=0.0, default=10.0, shape=True,
        grid=tuple(round(0.05 * k, 2) for k in range(1, 20)), grid_unit=GridUnit.RECORD,
    )  # fmt: skip
