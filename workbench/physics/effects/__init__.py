"""The catalogue of missing physics: one file per port family, one registry. A plant may have effects of its own beside it.

Here are the port families that a plant's equation may ask (`Shaft`, `Slide`, `Spring`, `Tank`, `Reel`, `Winding`, `Pulley`,
`Span`, `Robot`), what an effect of your own is made of (`Effect`, `EffectParameter`, `Domain`), and the catalogue by id
(`EFFECTS`).
"""

from collections.abc import Sequence

from workbench.physics.effects import actuator, pulley, reel, robot, sensor, shaft, span, spring, tank, winding
from workbench.physics.effects.effect import Domain, Effect, EffectParameter
from workbench.physics.effects.pulley import Pulley
from workbench.physics.effects.reel import Reel
from workbench.physics.effects.robot import Robot
from workbench.physics.effects.shaft import Shaft, Slide
from workbench.physics.effects.span import Span
from workbench.physics.effects.spring import Spring
from workbench.physics.effects.tank import Tank
from workbench.physics.effects.winding import Winding

__all__ = [
    "EFFECTS", "Domain", "Effect", "EffectParameter", "Pulley", "Reel", "Robot", "Shaft", "Slide", "Span", "Spring", "Tank",
    "Winding",
]  # fmt: skip

EFFECTS: dict[str, Effect] = {
    effect.id: effect
    for family in (shaft, spring, tank, reel, pulley, span, winding, robot, actuator, sensor)
    for effect in family.EFFECTS
}
"""The catalogue by the id of each effect; docs/effects.md lists it.

    >>> EFFECTS["coulomb"].equation
    'torque = -level * tanh(v / width)'
"""


def effects_of(family: str, own: Sequence[Effect] = ()) -> tuple[Effect, ...]:
    """All effects of a port family, in the order in which they act; those of `own` before the last of the catalogue.

    The last one of a sensor is its converter, of an actuator its dead time; of the other families the order says nothing.
    """
    listed, joining = (tuple(effect for effect in some if effect.family == family) for some in (EFFECTS.values(), own))
    return (*listed[:-1], *joining, *listed[-1:])
