"""The numbers of a plant: its physical parameters, and the numbers of effects at its places."""

from collections.abc import Mapping

from workbench.physics.effects.effect import Effect, EffectParameter
from workbench.records import field, record


@record
class Parameter:
    """A physical constant; tolerance is the relative half-width that a data sheet leaves open.

    signed: it may be zero or negative; what is not (a mass, a stiffness, a resistance) is refused at such values.

        >>> Parameter("J", 0.002, "kg m^2", tolerance=0.2, meaning="inertia").tolerance
        0.2
    """

    name: str
    value: float = field("")
    unit: str = ""
    tolerance: float = field("", low=0.0, default=0.0)
    meaning: str = ""
    signed: bool = False


@record
class Slot:
    """One number of one effect at one place: coulomb@unwind:level."""

    effect: Effect
    place: str
    parameter: EffectParameter

    @property
    def key(self) -> str:
        return f"{self.effect.id}@{self.place}"

    def __str__(self) -> str:
        return f"{self.key}:{self.parameter.name}"


EffectSizes = Mapping[str, Mapping[str, float]]  # {"coulomb@unwind": {"level": 0.002}}
