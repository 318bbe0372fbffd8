"""An effect: one piece of physics that a nominal model leaves out, switched on by its parameters.

The same object is truth when a plant switches it on and an explanation when a diagnosis offers it.
"""

from collections.abc import Callable

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


@record
class EffectParameter:
    """One number of an effect. A size is exactly neutral at 0; a shape (width, time constant) has a default instead."""

    name: str
    unit: str
    low: float = field("", default=-np.inf)
    high: float = field("", default=np.inf)
    default: float = field("", default=0.0)
    shape: bool = False

    def __post_init__(self):
        if not self.shape and self.default != 0.0:
            raise InputError(f"size {self.name!r} must be 0 by default: 0 is neutral")


@record
class Effect:
    """Missing physics at a port.

    law: the equation; what it takes and returns is fixed by the family (its file says so).
    sentence: the cause in a technician's words; {place} is filled in.
    separates: what separates it from its look-alikes.
    regular: the response is smooth in the sizes at 0; otherwise `grid` holds finite sizes to try.
    """

    id: str
    family: str
    parameters: tuple[EffectParameter, ...]
    sentence: str
    separates: str
    law: Callable
    regular: bool = True
    grid: tuple[float, ...] = ()

    def __post_init__(self):
        if self.regular == bool(self.grid):
            raise InputError(f"effect {self.id!r}: a grid belongs to an effect that is not regular, and only to one")
