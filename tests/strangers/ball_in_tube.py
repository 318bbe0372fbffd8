"""A ball that a fan holds in a tube:  tau a' = k u - a,  m z'' = c (a - z') |a - z'| - m g."""

import numpy as np

from tests.strangers.bench import Course, Lab, Loop, Machine, Place
from workbench import Channel, Parameter, Plant, Start
from workbench.physics.effects import Slide


def rates(x, u, p, f):
    z, v, air = x
    past = air * (1.0 - p.widening * z) - v
    drag = p.c * past * np.abs(past)
    return v, (drag + f.ball) / p.m - 9.81 - p.string * (z - 0.5), (p.k * u[0] - air) / p.tau


def outputs(x, p):
    return (100.0 * x[0],)


# ---- what its user has written ---------------------------------------------------------------------------------------


def equation(x, u, p, at):
    relative = x.air - x.v
    return {
        "z": x.v,
        "v": p.c / p.m * relative * abs(relative) - 9.81 + at.ball.torque() / p.m,
        "air": (p.k * u.fan - x.air) / p.tau,
    }


def measure(x, p):
    return {"height": 100 * x.z}


PLANT = Plant(
    name="ball-in-tube",
    states=(Channel("z", "m"), Channel("v", "m/s"), Channel("air", "m/s")),
    inputs=(Channel("fan", "V", "input"),),
    outputs=(Channel("height", "cm", "output"),),
    parameters=(
        Parameter("m", 3e-3, "kg", tolerance=0.05, meaning="mass of the ball"),
        Parameter("c", 1.2e-3, "N s^2/m^2", tolerance=0.2, meaning="drag of the ball"),
        Parameter("k", 1.0, "m/s/V", tolerance=0.1, meaning="speed of the air"),
        Parameter("tau", 0.25, "s", tolerance=0.2, meaning="time constant of the fan"),
    ),
    equation=equation,
    measure=measure,
    dt=0.02,
    ports=(Slide("ball", "v"),),
    start=Start({"z": 0.5}, ("air", "fan"), ("v", "air"), {"air": 5.0, "fan": 5.0}),
    noise={"height": 0.2},
)

STRANGER = Machine(
    PLANT,
    rates,
    outputs,
    start=(0.5, 0.0, 4.95),
    places={"ball": Place(1, 0.015, 0.3, 0.01)},
    foreign={"widening": 0.2, "string": 1.0},
    lab=Lab(
        dts=(0.01, 0.02),
        seconds=(30.0, 60.0),
        noise=(0.2,),
        push=(0.02,),
        base=(4.95,),
        range=((0.0, 10.0),),
        closed=(Course(25.0, 80.0, (1.5, 5.0)),),
        tracked=(0,),
        loops=(Loop(0, 0, 0.02, 0.008, 0.012),),
        settle=6.0,
        window=3.0,
    ),
    fine=0.01,
    slowest=0.1,
    sound=lambda x: (x[0] > 0.02) & (x[0] < 1.5),
)
