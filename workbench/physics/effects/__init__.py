"""The catalogue of missing physics: one file per port family, one registry. A plant may have effects of its own beside it."""

from collections.abc import Sequence

from workbench.physics.effects import actuator, pulley, reel, robot, sensor, shaft, span, winding
from workbench.physics.effects.effect import Effect

EFFECTS: dict[str, Effect] = {
    effect.id: effect for family in (shaft, reel, pulley, span, winding, robot, actuator, sensor) for effect in family.EFFECTS
}


def effects_of(family: str, own: Sequence[Effect] = ()) -> tuple[Effect, ...]:
    """All effects of a port family, in the order in which they act; those of `own` before the last of the catalogue.

    The last one of a sensor is its converter, of an actuator its dead time; of the other families the order says nothing.
    """
    listed, joining = (tuple(effect for effect in some if effect.family == family) for some in (EFFECTS.values(), own))
    return (*listed[:-1], *joining, *listed[-1:])
