"""Nine machines of other people as a user would first write them: the plain model, without what its literature says it lacks.

Numbers are those of a data sheet where there is one (KUKA KR300, XL330 servo); of the others they are read off a step or a
resonance of the records to one digit, with tolerances as wide as that is rough. Nothing is fitted, and no plant holds the effect
that its label names. Where the records cannot tell the scale of a mass from that of a force, the mass is taken as known.
"""

import numpy as np

from workbench import Channel, Parameter, Plant, Start
from workbench.physics.effects import Shaft, Slide, Spring, Tank

DEGREES = 180.0 / np.pi
RATIO = 250.0  # of the gear of the robot's first axis
GRAVITY = 9.81  # m/s^2


def _ball_and_hoop(x, u, p, at):
    """J w' = k u - b w: a motor that turns a hoop."""
    return {"w": (p.k * u.u - p.b * x.w + at.hoop.torque()) / p.J}


BALL_AND_HOOP = Plant(
    name="ball-and-hoop",
    states=(Channel("w", "rad/s"),),
    inputs=(Channel("u", "V", "input"),),
    outputs=(Channel("w", "rad/s", "output"),),
    parameters=(
        Parameter("J", 2e-3, "kg m^2", meaning="inertia of motor and hoop"),
        Parameter("k", 0.04, "N m/V", tolerance=0.5, meaning="torque by voltage"),
        Parameter("b", 4e-3, "N m s/rad", tolerance=0.5, meaning="viscous friction and back EMF"),
    ),
    equation=_ball_and_hoop,
    measure=lambda x, p: {"w": x.w},
    dt=0.1,
    ports=(Shaft("hoop", "w"),),
)


def _quarter_drone(x, u, p, at):
    """J a'' = c u - G sin(a) - b a': an arm that a propeller lifts, with thrust in proportion to the command."""
    return {"a": x.da, "da": (p.c * u.u - p.G * np.sin(x.a) - p.b * x.da + at.arm.torque()) / p.J}


QUARTER_DRONE = Plant(
    name="quarter-drone",
    states=(Channel("a", "rad"), Channel("da", "rad/s")),
    inputs=(Channel("u", "%", "input"),),
    outputs=(Channel("angle", "deg", "output"),),
    parameters=(
        Parameter("J", 0.01, "kg m^2", tolerance=0.5, meaning="inertia of the arm"),
        Parameter("G", 0.2, "N m", meaning="weight of the arm times its length"),
        Parameter("c", 4e-3, "N m/%", tolerance=0.5, meaning="torque of the propeller by command"),
        Parameter("b", 0.03, "N m s/rad", tolerance=0.9, meaning="damping of the arm"),
    ),
    equation=_quarter_drone,
    measure=lambda x, p: {"angle": DEGREES * x.a},
    dt=0.05,
    ports=(Shaft("arm", "da"),),
    start=Start({"a": 0.8}, ("u",), ("da",)),
)


def _pneumatic(x, u, p, at):
    """T v' = u - v,  tau F' = A p + b v - friction - F: a piston that a bench moves, and the load cell behind it."""
    load = p.A * u.p
    return {"piston": (u.v - x.piston) / p.T, "F": (load + p.b * x.piston - at.seal.torque(load=load) - x.F) / p.tau}


PNEUMATIC_FRICTION = Plant(
    name="pneumatic-friction",
    states=(Channel("piston", "m/s"), Channel("F", "N")),
    inputs=(Channel("v", "m/s", "input"), Channel("p", "Pa", "schedule")),
    outputs=(Channel("F", "N", "output"),),
    parameters=(
        Parameter("A", 4.9e-4, "m^2", tolerance=0.1, meaning="area of a bore of 25 mm"),
        Parameter("b", 100.0, "N s/m", tolerance=0.9, meaning="viscous friction of the piston"),
        Parameter("T", 0.05, "s", tolerance=0.5, meaning="time in which the piston follows the bench"),
        Parameter("tau", 0.05, "s", tolerance=0.5, meaning="time constant of the load cell"),
    ),
    equation=_pneumatic,
    measure=lambda x, p: {"F": x.F},
    dt=0.05,
    ports=(Slide("seal", "piston", loaded=True),),
)


def _kuka(x, u, p, at):
    """J w' = tau - b w: the first axis of a robot, on the side of its motor."""
    return {"w": (u.tau - p.b * x.w + at.axis.torque()) / p.J}


KUKA_KR300 = Plant(
    name="kuka-kr300",
    states=(Channel("w", "rad/s"),),
    inputs=(Channel("tau", "N m", "input"),),
    outputs=(Channel("v", "deg/s", "output"),),
    parameters=(
        Parameter("J", 0.035, "kg m^2", tolerance=0.5, meaning="inertia of the axis on the side of the motor"),
        Parameter("b", 0.03, "N m s/rad", tolerance=0.9, meaning="viscous friction"),
    ),
    equation=_kuka,
    measure=lambda x, p: {"v": DEGREES / RATIO * x.w},
    dt=0.004,
    ports=(Shaft("axis", "w"),),
)


def _bam(x, u, p, at):
    """(m l^2 + J) q'' = kt (U - kt q') / R - m g l sin(q) - b q': a servo that swings a pendulum."""
    weight = p.m * GRAVITY * p.l * np.sin(x.q)
    torque = p.kt * (u.U - p.kt * x.w) / p.R - weight - p.b * x.w + at.joint.torque(load=weight)
    return {"q": x.w, "w": torque / (p.m * p.l**2 + p.J)}


BAM_XL330 = Plant(
    name="bam-xl330",
    states=(Channel("q", "rad"), Channel("w", "rad/s")),
    inputs=(Channel("U", "V", "input"),),
    outputs=(Channel("q", "rad", "output"), Channel("v", "rad/s", "output")),
    parameters=(
        Parameter("m", 0.49, "kg", tolerance=0.02, meaning="mass of the pendulum"),
        Parameter("l", 0.1, "m", tolerance=0.05, meaning="length of the pendulum"),
        Parameter("J", 2e-3, "kg m^2", tolerance=0.9, meaning="inertia of rotor and gears at the output"),
        Parameter("kt", 0.35, "N m/A", tolerance=0.3, meaning="torque constant at the output: 0.52 N m at 1.47 A"),
        Parameter("R", 3.4, "ohm", tolerance=0.3, meaning="5 V at a stall current of 1.47 A"),
        Parameter("b", 0.01, "N m s/rad", tolerance=0.9, meaning="viscous friction"),
    ),
    equation=_bam,
    measure=lambda x, p: {"q": x.q, "v": x.w},
    dt=0.005,
    ports=(Shaft("joint", "w", loaded=True),),
)


def _tanks(x, u, p, at):
    """T1 x1' = g u - x1,  T2 x2' = x1 - x2: two tanks, one below the other, each with outflow in proportion to its level."""
    upper, lower = at.upper.flows(x.x1), at.lower.flows(x.x2)
    between = x.x1 + upper.outlet
    return {"x1": (p.g * u.u - between - upper.spill) / p.T1, "x2": (between - x.x2 - lower.outlet - lower.spill) / p.T2}


CASCADED_TANKS = Plant(
    name="cascaded-tanks",
    states=(Channel("x1", "V"), Channel("x2", "V")),
    inputs=(Channel("u", "V", "input"),),
    outputs=(Channel("y", "V", "output"),),
    parameters=(
        Parameter("T1", 80.0, "s", tolerance=0.6, meaning="time constant of the upper tank"),
        Parameter("T2", 80.0, "s", tolerance=0.6, meaning="time constant of the lower tank"),
        Parameter("g", 2.0, "", tolerance=0.5, meaning="level by voltage of the pump"),
    ),
    equation=_tanks,
    measure=lambda x, p: {"y": x.x2},
    dt=4.0,
    ports=(Tank("upper", "x1", rest=5.0, unit="V", flow="V"), Tank("lower", "x2", rest=5.0, unit="V", flow="V")),
    start=Start({"u": 2.8}, ("x1", "x2"), ("x1", "x2")),
)


def _drives(x, u, p, at):
    """J1 w1' = k u - b w1 - T,  T' = K (w1 - w2),  J2 w2' = T - b w2: motors that turn a pulley through a belt."""
    return {
        "w1": (p.k * u.u - p.b * x.w1 - x.T + at.motors.torque()) / p.J1,
        "w2": (x.T - p.b * x.w2 + at.pulley.torque()) / p.J2,
        "T": p.K * (x.w1 - x.w2),
    }


COUPLED_DRIVES = Plant(
    name="coupled-drives",
    states=(Channel("w1", "rad/s"), Channel("w2", "rad/s"), Channel("T", "N m")),
    inputs=(Channel("u", "V", "input"),),
    outputs=(Channel("y", "V", "output"),),
    parameters=(
        Parameter("J1", 0.01, "kg m^2", meaning="inertia of the motors"),
        Parameter("J2", 0.01, "kg m^2", tolerance=0.6, meaning="inertia of the pulley"),
        Parameter("k", 0.2, "N m/V", tolerance=0.5, meaning="torque by voltage"),
        Parameter("b", 0.03, "N m s/rad", tolerance=0.6, meaning="viscous friction of either"),
        Parameter("K", 3.0, "N m/rad", tolerance=0.6, meaning="stiffness of the belt"),
    ),
    equation=_drives,
    measure=lambda x, p: {"y": x.w2},
    dt=0.02,
    ports=(Shaft("motors", "w1"), Shaft("pulley", "w2")),
)


def _silverbox(x, u, p, at):
    """m q'' = V1 - k q - d q': a mass on a spring, as an electronic circuit; its position is read in volts."""
    return {"q": x.v, "v": (u.V1 - p.k * x.q - p.d * x.v + at.spring.push(x.q) + at.mass.torque()) / p.m}


SILVERBOX = Plant(
    name="silverbox",
    states=(Channel("q", "m"), Channel("v", "m/s")),
    inputs=(Channel("V1", "V", "input"),),
    outputs=(Channel("V2", "V", "output"),),
    parameters=(
        Parameter("m", 5e-6, "kg", tolerance=0.2, meaning="mass: 1 V is 1 N"),
        Parameter("d", 2e-4, "N s/m", tolerance=0.5, meaning="damping"),
        Parameter("k", 1.0, "N/m", tolerance=0.2, meaning="stiffness of the spring: 1 V is 1 m"),
    ),
    equation=_silverbox,
    measure=lambda x, p: {"V2": x.q},
    dt=1.0 / 610.35,
    ports=(Slide("mass", "v"), Spring("spring")),
)


def _gyroscope(x, u, p, at):
    """J2 w2' = k i + h w4 - b2 w2,  J4 w4' = -h w2 - b4 w4,  h = J1 W: a gyroscope whose disc always turns at W = 40 rad/s."""
    h = p.J1 * p.W
    return {
        "w2": (p.k * u.exp_u + h * x.w4 - p.b2 * x.w2 + at.gimbal.torque()) / p.J2,
        "w4": (-h * x.w2 - p.b4 * x.w4 + at.frame.torque()) / p.J4,
    }


GYROSCOPE = Plant(
    name="gyroscope",
    states=(Channel("w2", "rad/s"), Channel("w4", "rad/s")),
    inputs=(Channel("exp_u", "A", "input"), Channel("exp_p2", "rad/s", "schedule")),
    outputs=(Channel("exp_y", "rad/s", "output"),),
    parameters=(
        Parameter("J1", 0.027, "kg m^2", tolerance=0.1, meaning="inertia of the disc"),
        Parameter("W", 40.0, "rad/s", meaning="speed of the disc"),
        Parameter("J2", 0.03, "kg m^2", tolerance=0.5, meaning="inertia of the gimbal"),
        Parameter("J4", 0.2, "kg m^2", tolerance=0.5, meaning="inertia of the frame"),
        Parameter("k", 0.5, "N m/A", tolerance=0.3, meaning="torque of the motor of the gimbal"),
        Parameter("b2", 0.02, "N m s/rad", tolerance=0.9, meaning="friction of the gimbal"),
        Parameter("b4", 0.02, "N m s/rad", tolerance=0.9, meaning="friction of the frame"),
    ),
    equation=_gyroscope,
    measure=lambda x, p: {"exp_y": x.w4},
    dt=0.01,
    ports=(Shaft("gimbal", "w2"), Shaft("frame", "w4")),
    meaning={"exp_u": "current of the gimbal", "exp_y": "speed of the frame", "exp_p2": "speed of the disc"},
)
