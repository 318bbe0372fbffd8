"""Effects on a turning or sliding shaft: an additional torque [N m] (or force [N]) from speed, angle, load and time.

law(e, shaft) -> torque, positive in the direction of positive speed.
`shaft` has .speed [rad/s], .angle [rad], .load (the equation's own, N m or N) and .t [s].
"""

import numpy as np

from workbench.physics.effects.effect import Effect, EffectParameter, Named
from workbench.records import record


def _coulomb(e, shaft):
    # the sign of the speed, smoothed over `width` so that the equation has no branch
    return -e.level * np.tanh(shaft.speed / e.width)


COULOMB = Effect(
    "coulomb",
    "shaft",
    (
        EffectParameter("level", "N m", low=0.0),
        EffectParameter("width", "rad/s", low=1e-6, default=1.0, shape=True),
    ),
    "Dry friction at {place}: a constant torque against the direction of motion.",
    "A stop or a reversal: while the shaft turns one way it looks like an amplifier offset or a dead zone.",
    _coulomb,
)

EFFECTS = (COULOMB,)


@record
class Shaft:
    """Port for torques on a shaft whose speed is the state `speed`."""

    place: str
    speed: str
    family = "shaft"

    def verbs(self, effects, context) -> dict:
        """torque(load=0.0): the sum of all effects' torques on this shaft."""
        view = {"speed": context.x[self.speed], "angle": context.angle[self.place], "t": context.t}

        def torque(load=0.0):
            shaft = Named(view | {"load": load})
            return sum((effect.law(e, shaft) for effect, e in effects), start=0.0)

        return {"torque": torque}
