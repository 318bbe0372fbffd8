"""A motor turns a load through a soft shaft with play:

Jm m' = kT (V - kT m) / R - T,   Jl l' = T - b l,   q' = m - l,   T = k (what q is beyond +-gap) + d (m - l)
"""

import numpy as np

from tests.strangers.bench import Course, Lab, Loop, Machine, Place
from workbench import Channel, Parameter, Plant
from workbench.physics.effects import Shaft

PER_MINUTE = 60.0 / (2.0 * np.pi)


def rates(x, u, p, f):
    m, load, q = x
    beyond = np.sign(q) * np.maximum(np.abs(q) - p.gap, 0.0)
    twisted = p.k * (beyond + p.hardening * beyond**3) + p.d * (m - load)
    motor = p.kT * (u[0] - p.kT * m) / p.R
    return (motor - twisted + f.motor) / p.Jm, (twisted - p.b * load - p.fan * load**3 + f.load) / p.Jl, m - load


def outputs(x, p):
    return x[0] * PER_MINUTE, x[1] * PER_MINUTE


# ---- what its user has written ---------------------------------------------------------------------------------------


def equation(x, u, p, at):
    free = np.minimum(np.maximum(x.twist, -p.gap), p.gap)
    coupling = p.k * (x.twist - free) + p.d * (x.w_motor - x.w_load)
    return {
        "w_motor": (p.kT / p.R * (u.V - p.kT * x.w_motor) - coupling + at.motor.torque()) / p.Jm,
        "w_load": (coupling - p.b * x.w_load + at.load.torque()) / p.Jl,
        "twist": x.w_motor - x.w_load,
    }


def measure(x, p):
    return {"n_motor": 30 / np.pi * x.w_motor, "n_load": 30 / np.pi * x.w_load}


PLANT = Plant(
    name="two-mass",
    states=(Channel("w_motor", "rad/s"), Channel("w_load", "rad/s"), Channel("twist", "rad")),
    inputs=(Channel("V", "V", "input"),),
    outputs=(Channel("n_motor", "1/min", "output"), Channel("n_load", "1/min", "output")),
    parameters=(
        Parameter("Jm", 4e-4, "kg m^2", tolerance=0.2, meaning="motor inertia"),
        Parameter("Jl", 1.5e-3, "kg m^2", tolerance=0.2, meaning="load inertia"),
        Parameter("k", 6.0, "N m/rad", tolerance=0.3, meaning="stiffness of the shaft"),
        Parameter("d", 0.015, "N m s/rad", tolerance=0.5, meaning="damping of the shaft"),
        Parameter("b", 1e-3, "N m s/rad", tolerance=0.5, meaning="bearing of the load"),
        Parameter("gap", 0.015, "rad", tolerance=0.3, meaning="half of the play"),
        Parameter("kT", 0.12, "V s/rad", tolerance=0.1, meaning="motor constant"),
        Parameter("R", 1.0, "ohm", tolerance=0.1, meaning="armature resistance"),
    ),
    equation=equation,
    measure=measure,
    dt=0.002,
    ports=(Shaft("motor", "w_motor"), Shaft("load", "w_load")),
    noise={"n_motor": 2.0, "n_load": 2.0},
)

STRANGER = Machine(
    PLANT,
    rates,
    outputs,
    start=(0.0, 0.0, 0.0),
    places={"motor": Place(0, 0.3, 30.0), "load": Place(1, 0.3, 30.0)},
    foreign={"hardening": 200.0, "fan": 3e-6},
    lab=Lab(
        dts=(0.002, 0.005),
        seconds=(8.0, 12.0),
        noise=(2.0, 2.0),
        push=(0.05,),
        base=(0.0,),
        range=((-12.0, 12.0),),
        open=(Course(-6.0, 6.0, (0.15, 0.7)),),
        closed=(Course(-400.0, 400.0, (0.3, 1.2)),),
        tracked=(0,),
        loops=(Loop(0, 0, 0.01, 0.06),),
        settle=0.5,
    ),
    fine=0.001,
    slowest=0.03,
)
