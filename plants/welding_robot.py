"""The mobile arc-welding robot of [2]: a driven platform on a rail and an arm assembly, coupled by a damper.

    m1 v1' = u - b1 v1 - c (v1 - v2)        y = v1
    m2 v2' = c (v1 - v2) - b2 v2

With the values below y/u is the reduced model (9) of [2]: G(s) = (s + 2.3)/(s^2 + 6.6 s + 1.67).

[2] names three perturbations, all of them effects at `rail`: static friction between wheels and rail (coulomb), gravity
unbalance that changes with the arm's configuration (arm-gravity), and a platform mass that changes with the electrode systems
(platform-mass). The arm's angle `arm` moves on its own; the nominal model does not depend on it.

[2] the mobile arc-welding robot with interval parameters, equation (9).
"""

from workbench.data import Channel
from workbench.physics.effects.robot import Robot
from workbench.physics.effects.shaft import Slide
from workbench.physics.parameters import Parameter
from workbench.physics.plant import Plant


def equation(x, u, p, at):
    coupling = p.c * (x.v1 - x.v2)
    return {
        "v1": (u.u - p.b1 * x.v1 - coupling + at.rail.torque() + at.rail.force()) / at.rail.mass(p.m1),
        "v2": (coupling - p.b2 * x.v2) / p.m2,
    }


def measure(x, p):
    del p
    return {"v": x.v1}


WELDING_ROBOT = Plant(
    name="welding-robot",
    description="mobile arc-welding robot: a driven platform on a rail with an arm assembly",
    states=(Channel("v1", "m/s"), Channel("v2", "m/s")),
    inputs=(Channel("u", "N", "input"), Channel("arm", "rad", "schedule")),
    outputs=(Channel("v", "m/s", "output"),),
    parameters=(
        Parameter("m1", 1.0, "kg", 0.15, "platform with electrode feed"),
        Parameter("m2", 1.9464720194647203, "kg", 0.15, "arm assembly"),
        Parameter("c", 4.0, "N s/m", 0.20, "coupling damper"),
        Parameter("b1", 0.3, "N s/m", 0.30, "rail friction of the platform"),
        Parameter("b2", 0.4768856447688564, "N s/m", 0.30, "arm bearing friction"),
    ),
    equation=equation,
    measure=measure,
    dt=0.020,
    ports=(Slide("rail", "v1"), Robot("rail", "arm")),
    # ours, [2] prints none: an encoder of 0.1 mm, differenced over a sample, errs by 0.1 mm sqrt(2/12)/20 ms = 2 mm/s. With no
    # noise at all an effect of any size could be named.
    noise={"v": 0.002},
    meaning={
        "u": "force of the drive on the platform",
        "arm": "angle of the arm; it moves on its own",
        "v": "speed of the platform",
        "v1": "speed of the platform",
        "v2": "speed of the arm assembly",
        "rail": "the platform on its rail",
    },
)
"""m1 v1' = u - b1 v1 - c (v1 - v2): a mobile platform on a rail that carries a moving arm; the schedule is the arm's angle.

    >>> [f"{channel.name} [{channel.unit}]" for channel in WELDING_ROBOT.inputs]
    ['u [N]', 'arm [rad]']
"""
