"""A pendulum that a cart holds upright, a the angle from the top:

(M + m) v' + m l cos(a) w' = k V - b v + m l w^2 sin(a),   m l cos(a) v' + (I + m l^2) w' = m g l sin(a) - c w
"""

import numpy as np

from tests.strangers.bench import Course, Lab, Loop, Machine, Place
from workbench import Channel, Parameter, Plant
from workbench.physics.effects import Shaft, Slide

g = 9.81


def rates(x, u, p, f):
    _, v, a, w = x
    m11, m12, m22 = p.M + p.m, p.m * p.l * np.cos(a), 4.0 / 3.0 * p.m * p.l**2  # a rod of length 2 l
    r1 = p.k * u[0] - (p.b + p.worn_rail * x[0] ** 2) * v + p.m * p.l * w**2 * np.sin(a) + f.cart
    r2 = p.m * g * p.l * np.sin(a) - p.c * w + f.pivot - p.draught * w * np.abs(w) * w
    det = m11 * m22 - m12**2
    return v, (m22 * r1 - m12 * r2) / det, w, (m11 * r2 - m12 * r1) / det


def outputs(x, p):
    return x[0], np.degrees(x[2])


# ---- what its user has written ---------------------------------------------------------------------------------------


def equation(x, u, p, at):
    sin, cos = np.sin(x.a), np.cos(x.a)
    force = p.k * u.V - p.b * x.v + at.cart.torque()
    moment = at.pivot.torque() - p.c * x.w
    inner = (force + p.m * p.l * x.w**2 * sin) / (p.M + p.m)
    turning = (g * sin - cos * inner + moment / (p.m * p.l)) / (p.l * (4.0 / 3.0 - p.m * cos**2 / (p.M + p.m)))
    return {"x": x.v, "v": inner - p.m * p.l * turning * cos / (p.M + p.m), "a": x.w, "w": turning}


def measure(x, p):
    return {"x": x.x, "a": 180.0 / np.pi * x.a}


PLANT = Plant(
    name="cart-pendulum",
    states=(Channel("x", "m"), Channel("v", "m/s"), Channel("a", "rad"), Channel("w", "rad/s")),
    inputs=(Channel("V", "V", "input"),),
    outputs=(Channel("x", "m", "output"), Channel("a", "deg", "output")),
    parameters=(
        Parameter("M", 0.8, "kg", tolerance=0.1, meaning="mass of the cart"),
        Parameter("m", 0.2, "kg", tolerance=0.1, meaning="mass of the rod"),
        Parameter("l", 0.3, "m", tolerance=0.05, meaning="half the length of the rod"),
        Parameter("b", 6.0, "N s/m", tolerance=0.3, meaning="friction of the cart, with that of the motor"),
        Parameter("c", 0.003, "N m s/rad", tolerance=0.5, meaning="friction of the pivot"),
        Parameter("k", 1.8, "N/V", tolerance=0.1, meaning="force of the motor"),
    ),
    equation=equation,
    measure=measure,
    dt=0.005,
    ports=(Slide("cart", "v"), Shaft("pivot", "w")),
    noise={"x": 5e-4, "a": 0.05},
)

STRANGER = Machine(
    PLANT,
    rates,
    outputs,
    start=(0.0, 0.0, 0.01, 0.0),
    places={"cart": Place(1, 2.0, 0.5, 0.01), "pivot": Place(3, 0.05, 1.5)},
    foreign={"worn_rail": 300.0, "draught": 0.02},
    lab=Lab(
        dts=(0.005, 0.01),
        seconds=(12.0, 25.0),
        noise=(5e-4, 0.05),
        push=(0.1,),
        base=(0.0,),
        range=((-15.0, 15.0),),
        closed=(Course(-0.25, 0.25, (1.5, 4.0)),),
        tracked=(0,),
        loops=(Loop(0, 0, -11.5, 0.0, -15.4), Loop(0, 1, -0.96, 0.0, -0.194)),
        settle=3.0,
        window=0.6,
    ),
    fine=0.0025,
    slowest=0.02,
    sound=lambda x: (np.abs(x[2]) < 0.6) & (np.abs(x[0]) < 1.5),
    caps={"coulomb@cart": 1.0, "asymmetric-friction@cart": 1.0, "stribeck@cart": 1.0, "friction-jump@cart": 1.0},
)
