"""A hydraulic cylinder behind a valve, pressures of the load in Pa:

m v' = A pL - b v,   pL' = E (kq u sqrt(ps - sgn(u) pL) - A v - cl pL)
"""

import numpy as np

from tests.strangers.bench import Course, Lab, Loop, Machine, Place
from workbench import Channel, Parameter, Plant
from workbench.physics.effects import Slide


def rates(x, u, p, f):
    q, v, load = x
    opened = np.where(u[0] >= 0.0, np.sqrt(np.maximum(p.ps - load, 0.0)), np.sqrt(np.maximum(p.ps + load, 0.0)))
    flow = p.kq * u[0] * opened - p.A * v - p.cl * load
    return v, (p.A * load - p.b * v - p.spring * q + f.piston) / p.m, p.E * (1.0 + p.air * np.abs(load) / 1e6) * flow


def outputs(x, p):
    return 1e3 * x[0], 1e-5 * x[2]


# ---- what its user has written ---------------------------------------------------------------------------------------


def equation(x, u, p, at):
    drop = np.maximum(p.ps - np.sign(u.u) * x.pL, 0.0)
    return {
        "x": x.v,
        "v": (p.A * x.pL - p.b * x.v + at.piston.torque()) / p.m,
        "pL": p.E * (p.kq * u.u * np.sqrt(drop) - p.A * x.v - p.cl * x.pL),
    }


def measure(x, p):
    return {"x": 1000 * x.x, "pL": x.pL / 1e5}


PLANT = Plant(
    name="cylinder",
    states=(Channel("x", "m"), Channel("v", "m/s"), Channel("pL", "Pa")),
    inputs=(Channel("u", "V", "input"),),
    outputs=(Channel("x", "mm", "output"), Channel("pL", "bar", "output")),
    parameters=(
        Parameter("m", 200.0, "kg", tolerance=0.1, meaning="mass of the load"),
        Parameter("A", 5e-4, "m^2", tolerance=0.02, meaning="area of the piston"),
        Parameter("b", 2500.0, "N s/m", tolerance=0.4, meaning="friction of the guide"),
        Parameter("ps", 7e6, "Pa", tolerance=0.05, meaning="pressure of the supply"),
        Parameter("kq", 7.5e-9, "m^3/s/V/Pa^0.5", tolerance=0.15, meaning="flow of the valve"),
        Parameter("E", 4e12, "Pa/m^3", tolerance=0.3, meaning="stiffness of the oil"),
        Parameter("cl", 3e-12, "m^3/s/Pa", tolerance=0.5, meaning="leak of the piston"),
    ),
    equation=equation,
    measure=measure,
    dt=0.005,
    ports=(Slide("piston", "v"),),
    noise={"x": 0.05, "pL": 0.1},
)

STRANGER = Machine(
    PLANT,
    rates,
    outputs,
    start=(0.0, 0.0, 0.0),
    places={"piston": Place(1, 500.0, 0.1, 0.01)},
    foreign={"spring": 5000.0, "air": 0.5},
    lab=Lab(
        dts=(0.005, 0.01),
        seconds=(10.0, 20.0),
        noise=(0.05, 0.1),
        push=(0.01,),
        base=(0.0,),
        range=((-10.0, 10.0),),
        closed=(Course(-80.0, 80.0, (0.8, 2.5)),),
        tracked=(0,),
        loops=(Loop(0, 0, 0.1),),
        settle=1.0,
        window=4.0,
    ),
    fine=0.0025,
    slowest=0.05,
    sound=lambda x: np.abs(x[0]) < 0.5,
)
