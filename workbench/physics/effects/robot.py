"""Effects on a robot whose arm rides on a driven platform: a force on the platform [N], and how much its mass changes.

law(e, robot) -> (force [N], positive in the direction of positive speed; relative change of the platform's mass).
`robot` has .arm [rad], the angle of the arm, and .t [s].

A platform of changing mass m obeys m v' = F, not (m v)' = F: what comes aboard or leaves moves at the platform's own speed at
that moment (electrode systems are hung on and taken off, wire is fed from a drum that rides along), so it carries its momentum
with it and pushes nothing.
"""

import numpy as np

from workbench.physics.effects.effect import Effect, EffectParameter, Named
from workbench.records import record


def _arm_gravity(e, robot):
    return -(e.sine * np.sin(robot.arm) + e.cosine * np.cos(robot.arm)), 0.0


def _platform_mass(e, robot):
    return 0.0, e.change + e.swing * np.sin(2 * np.pi * robot.t / e.period)


ARM_GRAVITY = Effect(
    "arm-gravity",
    "robot",
    (EffectParameter("sine", "N"), EffectParameter("cosine", "N")),
    "The arm pulls {place} out of balance: its weight pushes the platform, with a force that changes with the arm's angle.",
    "Move the arm with the platform held: a tilt or a cable pulls with the same force at every arm angle, friction with none.",
    _arm_gravity,
)
PLATFORM_MASS = Effect(
    "platform-mass",
    "robot",
    (
        # the lowest change and the widest swing together leave 5 % of the platform: its mass never reaches 0
        EffectParameter("change", "1", low=-0.5),
        EffectParameter("swing", "1", low=-0.45, high=0.45),
        EffectParameter("period", "s", low=0.1, default=10.0, shape=True),
    ),
    "The platform on {place} is heavier or lighter than thought, or becomes so while it runs: electrode systems come and go.",
    "Runs with and without load, compared: a constant change alone looks like a wrong mass in the data sheet.",
    _platform_mass,
)

EFFECTS = (ARM_GRAVITY, PLATFORM_MASS)


@record
class Robot:
    """Port for a platform whose arm stands at the angle `arm`, an input of the plant."""

    place: str
    arm: str
    family = "robot"

    def verbs(self, effects, context) -> dict:
        """force(): all effects' forces on the platform [N]; mass(m): the platform's mass m as they change it [kg]."""
        robot = Named({"arm": context.u[self.arm], "t": context.t})

        def force():
            return sum((effect.law(e, robot)[0] for effect, e in effects), start=0.0)

        def mass(m):
            return m * (1.0 + sum((effect.law(e, robot)[1] for effect, e in effects), start=0.0))

        return {"force": force, "mass": mass}
