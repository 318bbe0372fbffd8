"""A servo motor that lifts an arm against gravity:  J a'' = kT i - b a' - G sin a,  i = (V - kT a') / R."""

import numpy as np

from tests.strangers.bench import Course, Lab, Loop, Machine, Place
from workbench import Channel, Parameter, Plant
from workbench.physics.effects import Shaft


def rates(x, u, p, f):
    a, w = x
    current = (u[0] - p.kT * w) / p.R
    lifted = p.G * np.sin(a) + p.cable * a**3
    return w, (p.kT * current - (p.b + p.bent_bearing * a**2) * w - lifted + f.joint) / p.J


def outputs(x, p):
    return (x[0],)


# ---- what its user has written ---------------------------------------------------------------------------------------


def equation(x, u, p, at):
    drive = p.kT / p.R * u.V - (p.kT**2 / p.R + p.b) * x.w
    return {"a": x.w, "w": (drive - p.G * np.sin(x.a) + at.joint.torque()) / p.J}


def measure(x, p):
    return {"a": x.a}


PLANT = Plant(
    name="servo",
    states=(Channel("a", "rad"), Channel("w", "rad/s")),
    inputs=(Channel("V", "V", "input"),),
    outputs=(Channel("a", "rad", "output"),),
    parameters=(
        Parameter("J", 2e-3, "kg m^2", tolerance=0.2, meaning="inertia of arm and motor"),
        Parameter("b", 0.01, "N m s/rad", tolerance=0.5, meaning="friction of the bearing"),
        Parameter("G", 0.3, "N m", tolerance=0.15, meaning="weight of the arm times its length"),
        Parameter("kT", 0.3, "V s/rad", tolerance=0.1, meaning="motor constant at the joint"),
        Parameter("R", 2.0, "ohm", tolerance=0.1, meaning="armature resistance"),
    ),
    equation=equation,
    measure=measure,
    dt=0.001,
    ports=(Shaft("joint", "w"),),
    noise={"a": 5e-4},
)

STRANGER = Machine(
    PLANT,
    rates,
    outputs,
    start=(0.0, 0.0),
    places={"joint": Place(1, 0.4, 6.0)},
    foreign={"cable": 0.3, "bent_bearing": 0.05},
    lab=Lab(
        dts=(0.001, 0.005, 0.01),
        seconds=(8.0, 15.0),
        noise=(5e-4,),
        push=(0.02,),
        base=(0.0,),
        range=((-12.0, 12.0),),
        open=(Course(-1.4, 1.4, (0.15, 0.8)),),
        closed=(Course(-1.2, 1.2, (0.2, 1.0)),),
        tracked=(0,),
        loops=(Loop(0, 0, 8.0, 20.0, 0.35),),
        settle=1.0,
    ),
    fine=0.001,
    slowest=0.05,
)
