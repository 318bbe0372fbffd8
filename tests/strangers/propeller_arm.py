"""An arm that a propeller lifts:  tau w' = k u - w,   I a'' = c w^2 - G sin(a) - b a'."""

import numpy as np

from tests.strangers.bench import Course, Lab, Loop, Machine, Place
from workbench import Channel, Parameter, Plant, Start
from workbench.physics.effects import Shaft


def rates(x, u, p, f):
    a, spin, w = x
    thrust = p.c * w**2 * (1.0 - p.ground * np.cos(a))
    torque = thrust - p.G * np.sin(a) - p.b * spin - p.swirl * w * spin
    return spin, (torque + f.arm) / p.I, (p.k * u[0] - w) / p.tau


def outputs(x, p):
    return (np.degrees(x[0]),)


# ---- what its user has written ---------------------------------------------------------------------------------------


def equation(x, u, p, at):
    lift = p.c * x.w**2 - p.G * np.sin(x.a)
    return {"a": x.da, "da": (lift - p.b * x.da + at.arm.torque()) / p.I, "w": (p.k * u.u - x.w) / p.tau}


def measure(x, p):
    return {"angle": 180 / np.pi * x.a}


PLANT = Plant(
    name="propeller-arm",
    states=(Channel("a", "rad"), Channel("da", "rad/s"), Channel("w", "rad/s")),
    inputs=(Channel("u", "V", "input"),),
    outputs=(Channel("angle", "deg", "output"),),
    parameters=(
        Parameter("I", 0.02, "kg m^2", tolerance=0.15, meaning="inertia of the arm"),
        Parameter("G", 0.4, "N m", tolerance=0.1, meaning="weight of the arm times its length"),
        Parameter("b", 0.03, "N m s/rad", tolerance=0.4, meaning="damping of the arm"),
        Parameter("c", 5e-6, "N m s^2/rad^2", tolerance=0.15, meaning="thrust of the propeller"),
        Parameter("k", 50.0, "rad/s/V", tolerance=0.05, meaning="speed of the propeller"),
        Parameter("tau", 0.15, "s", tolerance=0.2, meaning="time constant of the propeller"),
    ),
    equation=equation,
    measure=measure,
    dt=0.01,
    ports=(Shaft("arm", "da"),),
    start=Start({"a": 0.5}, ("w", "u"), ("da", "w"), {"w": 200.0, "u": 4.0}),
    noise={"angle": 0.1},
)

STRANGER = Machine(
    PLANT,
    rates,
    outputs,
    start=(0.5, 0.0, 196.0),
    places={"arm": Place(1, 0.12, 1.5)},
    foreign={"swirl": 2e-4, "ground": 0.3},
    lab=Lab(
        dts=(0.01, 0.02),
        seconds=(30.0, 60.0),
        noise=(0.1,),
        push=(0.03,),
        base=(3.9,),
        range=((0.0, 8.0),),
        open=(Course(2.6, 4.8, (0.6, 3.0)),),
        closed=(Course(10.0, 55.0, (1.0, 4.0)),),
        tracked=(0,),
        loops=(Loop(0, 0, 0.02, 0.02, 0.008),),
        settle=4.0,
    ),
    fine=0.01,
    slowest=0.15,
    sound=lambda x: (np.abs(x[0]) < 1.9) & (x[2] > 0.0),
)
