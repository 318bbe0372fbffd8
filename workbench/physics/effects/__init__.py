"""The catalogue of missing physics: one file per port family, one registry."""

from workbench.physics.effects import actuator, pulley, reel, robot, sensor, shaft, span, winding
from workbench.physics.effects.effect import Effect

EFFECTS: dict[str, Effect] = {
    effect.id: effect for family in (shaft, reel, pulley, span, winding, robot, actuator, sensor) for effect in family.EFFECTS
}


def effects_of(family: str) -> tuple[Effect, ...]:
    """All effects of a port family, in the order in which they act."""
    return tuple(effect for effect in EFFECTS.values() if effect.family == family)
