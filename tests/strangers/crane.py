"""A trolley with a load on a rope, a the angle of the rope:

(M + m) v' + m l (cos(a) w' - sin(a) w^2) = k u - b v,   m l cos(a) v' + m l^2 w' = -m g l sin(a) - c w
"""

import numpy as np

from tests.strangers.bench import Course, Lab, Loop, Machine, Place
from workbench import Channel, Parameter, Plant
from workbench.physics.effects import Shaft, Slide


def rates(x, u, p, f):
    q, v, a, w = x
    length = p.l * (1.0 + p.slanted * q)  # a rail that comes down on one side
    m12, m22 = p.m * length * np.cos(a), p.m * length**2
    across = w * length + v * np.cos(a)  # the load's through the air; the rope's is the swing's friction
    drag = p.wind * across * np.abs(across)
    r1 = p.k * u[0] - p.b * v + p.m * length * np.sin(a) * w**2 - drag * np.cos(a) + f.trolley
    r2 = f.swing - p.m * 9.81 * length * np.sin(a) - p.c * w - drag * length
    det = (p.M + p.m) * m22 - m12**2
    return v, (m22 * r1 - m12 * r2) / det, w, ((p.M + p.m) * r2 - m12 * r1) / det


def outputs(x, p):
    return x[0], np.degrees(x[2])


# ---- what its user has written ---------------------------------------------------------------------------------------


def equation(x, u, p, at):
    s, c = np.sin(x.a), np.cos(x.a)
    moment = (at.swing.torque() - p.c * x.w) / (p.m * p.l)
    force = p.k * u.u - p.b * x.v + at.trolley.torque()
    dv = (force + p.m * s * (p.l * x.w**2 + 9.81 * c) - p.m * c * moment) / (p.M + p.m * s**2)
    return {"x": x.v, "v": dv, "a": x.w, "w": (moment - 9.81 * s - c * dv) / p.l}


def measure(x, p):
    return {"x": x.x, "swing": 180 / np.pi * x.a}


PLANT = Plant(
    name="crane",
    states=(Channel("x", "m"), Channel("v", "m/s"), Channel("a", "rad"), Channel("w", "rad/s")),
    inputs=(Channel("u", "V", "input"),),
    outputs=(Channel("x", "m", "output"), Channel("swing", "deg", "output")),
    parameters=(
        Parameter("M", 4.0, "kg", tolerance=0.1, meaning="mass of the trolley"),
        Parameter("m", 2.0, "kg", tolerance=0.1, meaning="mass of the load"),
        Parameter("l", 0.8, "m", tolerance=0.05, meaning="length of the rope"),
        Parameter("b", 12.0, "N s/m", tolerance=0.3, meaning="friction of the trolley"),
        Parameter("c", 0.02, "N m s/rad", tolerance=0.5, meaning="friction of the rope's bearing"),
        Parameter("k", 5.0, "N/V", tolerance=0.1, meaning="force of the drive"),
    ),
    equation=equation,
    measure=measure,
    dt=0.02,
    ports=(Slide("trolley", "v"), Shaft("swing", "w")),
    noise={"x": 1e-3, "swing": 0.05},
)

STRANGER = Machine(
    PLANT,
    rates,
    outputs,
    start=(0.0, 0.0, 0.0, 0.0),
    places={"trolley": Place(1, 5.0, 0.5, 0.01), "swing": Place(3, 0.15, 0.5)},
    foreign={"slanted": 0.2, "wind": 1.0},
    lab=Lab(
        dts=(0.01, 0.02, 0.05),
        seconds=(30.0, 60.0),
        noise=(1e-3, 0.05),
        push=(0.03,),
        base=(0.0,),
        range=((-10.0, 10.0),),
        open=(Course(-3.0, 3.0, (0.4, 1.5)),),
        closed=(Course(-0.8, 0.8, (2.0, 6.0)),),
        tracked=(0,),
        loops=(Loop(0, 0, 6.0, 0.0, 3.0),),
        settle=4.0,
        window=10.0,
    ),
    fine=0.01,
    slowest=0.15,
    sound=lambda x: np.abs(x[2]) < 1.2,
)
