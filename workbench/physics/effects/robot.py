"""Effects on a robot whose arm rides on a driven platform: a force on the platform [N], and how much its mass changes.

law(e, robot) -> (force [N], positive in the direction of positive speed; relative change of the platform's mass).
`robot` has .arm [rad], the angle of the arm, .arm_rate [rad/s], by how much it moved in the last sample, and .t [s].

A platform of changing mass m obeys m v' = F, not (m v)' = F: what comes aboard or leaves moves at the platform's own speed at
that moment (electrode systems are hung on and taken off, wire is fed from a drum that rides along), so it carries its momentum
with it and pushes nothing.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from workbench.physics.effects.effect import Domain, Effect, EffectParameter, GridUnit, Named, Port
from workbench.records import record


def _arm_gravity(e, robot):
    return -(e.sine * np.sin(robot.arm) + e.cosine * np.cos(robot.arm)), 0.0


def _rail_tilt(e, robot):
    del robot
    return -e.level, 0.0


def _platform_mass(e, robot):
    return 0.0, e.change + e.swing * np.sin(2 * np.pi * robot.t / e.period)


def _arm_reaction(e, robot):
    return -e.coefficient * robot.arm_rate, 0.0


ARM_GRAVITY = Effect(
    "arm-gravity",
    "robot",
    (EffectParameter("sine", "N"), EffectParameter("cosine", "N")),
    "The arm pulls {place} out of balance: its weight pushes the platform, with a force that changes with the arm's angle.",
    "Move the arm with the platform held: a tilt or a cable pulls with the same force at every arm angle, friction with none.",
    "force = -(sine * sin(arm) + cosine * cos(arm))",
    _arm_gravity,
    Domain.ANGLE,
)
RAIL_TILT = Effect(
    "rail-tilt",
    "robot",
    (EffectParameter("level", "N"),),
    "The platform on {place} is pulled one way: the rail is tilted or a cable pulls, with the same force everywhere.",
    "Motion both ways and a stop: dry friction changes its sign with the motion; an offset of the drive looks the same.",
    "force = -level",
    _rail_tilt,
    Domain.SPEED,
)
PLATFORM_MASS = Effect(
    "platform-mass",
    "robot",
    (
        # the lowest change and the widest swing together leave 5 % of the platform: its mass never reaches 0
        EffectParameter("change", "1", low=-0.5),
        EffectParameter("swing", "1", low=-0.45, high=0.45),
        EffectParameter("period", "s", low=0.1, default=10.0, shape=True, grid=(1.0, 20.0), grid_unit=GridUnit.CYCLES),
    ),
    "The platform on {place} is heavier or lighter than thought, or becomes so while it runs: electrode systems come and go.",
    "Runs with and without load, compared: a constant change alone looks like a wrong mass in the data sheet.",
    "mass = m * (1 + change + swing * sin(2 * pi * t / period))",
    _platform_mass,
    Domain.TIME,
)
ARM_REACTION = Effect(
    "arm-reaction",
    "robot",
    (EffectParameter("coefficient", "N s/rad"),),
    "The moving arm pushes back on {place}: a force in proportion to how fast the arm swings.",
    "Swing the arm slowly and fast through the same angles: its weight pulls with the angle alone, however fast it swings.",
    "force = -coefficient * arm'",
    _arm_reaction,
    Domain.SPEED,
)

EFFECTS = (ARM_GRAVITY, RAIL_TILT, PLATFORM_MASS, ARM_REACTION)


@record
class Robot(Port):
    """at.<place>.mass(m) v' = .. + at.<place>.force(): port for a platform whose arm stands at `arm`, an input [rad].

    >>> port = Robot("rail", arm="arm")
    >>> [name for name, effect in EFFECTS.items() if effect.family == port.family]
    ['arm-gravity', 'rail-tilt', 'platform-mass', 'arm-reaction']
    """

    arm: str
    family = "robot"
    symbols = (
        "force: on the platform, positive in the direction of positive speed; arm: angle of the arm; m: mass of the data sheet"
    )
    law = "law(e, robot) -> (force, relative change of the mass); robot has .arm, .arm_rate, .t"

    def verbs(self, effects, context) -> dict:
        """force(): all effects' forces on the platform [N]; mass(m): the platform's mass m as they change it [kg]."""
        robot = Named({"arm": context.u[self.arm], "arm_rate": context.rate[self.arm], "t": context.t})
        given = [effect.law(e, robot) for effect, e in effects]

        def force():
            return sum((push for push, _ in given), start=0.0)

        def mass(m):
            return m * (1.0 + sum((change for _, change in given), start=0.0))

        return {"force": force, "mass": mass}

    def beyond(self, effect: Effect, e: Named, some: Callable[[], Any]) -> list:
        """The force and the relative change of the mass."""
        force, change = effect.law(e, Named({"arm": some(), "arm_rate": some(), "t": some()}))
        return [force, change]
