"""Water in a cone:  pi (t h)^2 h' = k u - a sqrt(2 g h)."""

import numpy as np

from tests.strangers.bench import Course, Lab, Loop, Machine
from workbench import Channel, Parameter, Plant, Start


def rates(x, u, p, f):
    (h,) = x
    h = np.maximum(h, 1e-4)
    drained = p.a * np.sqrt(2.0 * 9.81 * h) + p.seepage * h**2
    return ((p.k * u[0] - drained) / (np.pi * (p.t * h + p.blunt) ** 2),)


def outputs(x, p):
    return (100.0 * x[0],)


# ---- what its user has written ---------------------------------------------------------------------------------------


def equation(x, u, p, at):
    del at
    area = np.pi * p.t**2 * x.h**2
    return {"h": (p.k * u.pump - p.a * np.sqrt(19.62 * np.maximum(x.h, 1e-4))) / area}


def measure(x, p):
    return {"level": 100 * x.h}


PLANT = Plant(
    name="conical-tank",
    states=(Channel("h", "m"),),
    inputs=(Channel("pump", "V", "input"),),
    outputs=(Channel("level", "cm", "output"),),
    parameters=(
        Parameter("k", 1e-4, "m^3/s/V", tolerance=0.1, meaning="pump"),
        Parameter("a", 3e-4, "m^2", tolerance=0.15, meaning="area of the outlet"),
        Parameter("t", 0.35, "", tolerance=0.03, meaning="radius over height"),
    ),
    equation=equation,
    measure=measure,
    dt=0.1,
    start=Start({"h": 0.2}, ("pump",), ("h",)),
    noise={"level": 0.05},
    limits={"h": (0.01, 1.0)},
)

STRANGER = Machine(
    PLANT,
    rates,
    outputs,
    start=(0.2,),
    places={},
    foreign={"seepage": 5e-3, "blunt": 0.02},
    lab=Lab(
        dts=(0.05, 0.1),
        seconds=(60.0, 90.0),
        noise=(0.05,),
        push=(0.03,),
        base=(6.0,),
        range=((0.0, 12.0),),
        open=(Course(4.8, 7.6, (4.0, 15.0)),),
        closed=(Course(14.0, 30.0, (6.0, 18.0)),),
        tracked=(0,),
        loops=(Loop(0, 0, 0.4, 0.05),),
        settle=15.0,
    ),
    fine=0.05,
    slowest=4.0,
    sound=lambda x: (x[0] > 0.02) & (x[0] < 0.9),
)
