"""Effects on a turning or sliding shaft: an additional torque [N m] (or force [N]) from speed, angle, load and time.

law(e, shaft) -> torque, positive in the direction of positive speed.
`shaft` has .speed [rad/s], .angle [rad], .load (the equation's own, N m or N) and .t [s].

Parameters are written for a shaft that turns. On one that slides the same laws hold with N, m and m/s: see `Slide`.
"""

from dataclasses import replace

import numpy as np

from workbench.physics.effects.effect import Effect, EffectParameter, Named
from workbench.records import field, record


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

    def fitted(self, parameter: EffectParameter) -> EffectParameter:
        """A parameter of an effect as it reads at this port."""
        return parameter

    def verbs(self, effects, context) -> dict:
        """torque(load=0.0): the sum of all effects' torques on this shaft."""
        view = {"speed": context.x[self.speed], "angle": context.angle[self.place], "t": context.t}

        def torque(load=0.0):
            shaft = Named(view | {"load": load})
            return sum((effect.law(e, shaft) for effect, e in effects), start=0.0)

        return {"torque": torque}


@record
class Slide(Shaft):
    """Port for forces on a body that slides at the speed of the state `speed`: a shaft in N, m and m/s.

    travel: length [m] that stands for the radian of a turning shaft, so that default widths given in rad/s fit the speeds met
    here: 0.01 m/s, a hundredth of a body that moves at 1 m/s, as 1 rad/s is of a shaft that turns at 100 rad/s.
    """

    travel: float = field("", unit="m/rad", low=1e-9, default=0.01)

    def fitted(self, parameter: EffectParameter) -> EffectParameter:
        """The parameter in N for N m and m for rad, its default scaled where it is a speed."""
        unit = parameter.unit.replace("N m", "N").replace("rad", "m")
        scale = self.travel if parameter.unit == "rad/s" else 1.0
        return replace(parameter, unit=unit, low=scale * parameter.low, default=scale * parameter.default)
