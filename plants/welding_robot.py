"""The mobile arc-welding robot of [2]: a driven platform on a rail and an arm assembly, coupled by a damper.

    m1 v1' = u - b1 v1 - c (v1 - v2)        y = v1
    m2 v2' = c (v1 - v2) - b2 v2

With the values below y/u is the reduced model (9) of [2]: G(s) = (s + 2.3)/(s^2 + 6.6 s + 1.67).

[2] names three perturbations, all of them effects at `rail`: static friction between wheels and rail (coulomb), gravity
unbalance that changes with the arm's configuration (arm-gravity), and a platform mass that changes with the electrode systems
(platform-mass). The arm's angle `arm` moves on its own; the nominal model does not depend on it.

[2] the mobile arc-welding robot with interval parameters, equation (9).
"""

import numpy as np

from workbench.data import Channel
from workbench.physics.effects.robot import Robot
from workbench.physics.effects.shaft import Slide
from workbench.physics.held import held
from workbench.physics.parameters import EffectSizes, Parameter
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


def frozen_parameters(mass: float, dt: float) -> np.ndarray:
    """alpha_1, alpha_2, beta_1, beta_0 (4,) of the robot with its platform held at `mass` [kg], sampled with a held force.

    With the zero-order hold of [A B; 0 0] and D = q - 1:  D^2 v = -alpha_1 D v - alpha_2 v + beta_1 D u + beta_0 u.
    """
    p = WELDING_ROBOT.parameter_vector({"m1": mass})
    A, B, C, _ = WELDING_ROBOT.linearize(*WELDING_ROBOT.equilibrium(p), p)
    n = len(A)
    Ad, Bd = held(A, B[:, [WELDING_ROBOT.input_names.index("u")]], dt)
    F, g, c = Ad - np.eye(n), Bd[:, 0], C[0]  # in delta form D x = F x + g u
    alpha_1, alpha_2 = -np.trace(F), np.linalg.det(F)
    return np.array([alpha_1, alpha_2, c @ g, c @ (F + alpha_1 * np.eye(n)) @ g])


def frozen_course(t: np.ndarray, dt: float, effects: EffectSizes) -> np.ndarray:
    """The frozen parameters (len(t), 4) at the mass that the platform has at every instant t [s]."""
    values = zip(WELDING_ROBOT.slots, WELDING_ROBOT.effect_vector(effects), strict=True)
    size = {slot.parameter.name: value for slot, value in values if slot.key == "platform-mass@rail"}
    nominal = next(q.value for q in WELDING_ROBOT.parameters if q.name == "m1")
    mass = nominal * (1.0 + size["change"] + size["swing"] * np.sin(2 * np.pi * t / size["period"]))
    return np.array([frozen_parameters(m, dt) for m in mass])
