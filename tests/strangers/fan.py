"""A fan blows into a duct:  J w' = kT (V - kT w) / R - b w - cm q w,   L q' = a w^2 - z q^2  (q in m^3/s, pressures in Pa)."""

import numpy as np

from tests.strangers.bench import Course, Lab, Loop, Machine, Place
from workbench import Channel, Parameter, Plant, Start
from workbench.physics.effects import Shaft


def rates(x, u, p, f):
    w, q = x
    drive = p.kT * (u[0] - p.kT * w) / p.R
    lost = p.z * q * np.abs(q) * (1.0 + p.fouling * q) + p.laminar * q
    return (drive - p.b * w - p.cm * q * w + f.fan) / p.J, (p.a * w**2 - lost) / p.L


def outputs(x, p):
    return x[0] * 30.0 / np.pi, 3600.0 * x[1]


# ---- what its user has written ---------------------------------------------------------------------------------------


def equation(x, u, p, at):
    return {
        "w": (p.kT / p.R * (u.V - p.kT * x.w) - (p.b + p.cm * x.q) * x.w + at.fan.torque()) / p.J,
        "q": (p.a * x.w * x.w - p.z * x.q * x.q) / p.L,
    }


def measure(x, p):
    return {"n": 30 / np.pi * x.w, "Q": 3600 * x.q}


PLANT = Plant(
    name="fan",
    states=(Channel("w", "rad/s"), Channel("q", "m^3/s")),
    inputs=(Channel("V", "V", "input"),),
    outputs=(Channel("n", "1/min", "output"), Channel("Q", "m^3/h", "output")),
    parameters=(
        Parameter("J", 1.5e-3, "kg m^2", tolerance=0.2, meaning="inertia of the fan"),
        Parameter("kT", 0.1, "V s/rad", tolerance=0.08, meaning="motor constant"),
        Parameter("R", 1.5, "ohm", tolerance=0.1, meaning="armature resistance"),
        Parameter("b", 3e-4, "N m s/rad", tolerance=0.5, meaning="bearing"),
        Parameter("cm", 0.03, "N s/m^3 m", tolerance=0.2, meaning="torque of the air"),
        Parameter("a", 0.01, "Pa s^2/rad^2", tolerance=0.1, meaning="pressure of the fan"),
        Parameter("z", 2e4, "Pa s^2/m^6", tolerance=0.2, meaning="resistance of the duct"),
        Parameter("L", 400.0, "Pa s^2/m^3", tolerance=0.2, meaning="inertia of the air"),
    ),
    equation=equation,
    measure=measure,
    dt=0.02,
    ports=(Shaft("fan", "w"),),
    start=Start({"w": 120.0}, ("V", "q"), ("w", "q"), {"V": 14.0, "q": 0.08}),
    noise={"n": 3.0, "Q": 2.0},
)

STRANGER = Machine(
    PLANT,
    rates,
    outputs,
    start=(120.0, 0.085),
    places={"fan": Place(0, 0.3, 120.0)},
    foreign={"fouling": 3.0, "laminar": 500.0},
    lab=Lab(
        dts=(0.01, 0.02, 0.05),
        seconds=(20.0, 60.0),
        noise=(3.0, 2.0),
        push=(0.05,),
        base=(16.0,),
        range=((0.0, 30.0),),
        open=(Course(9.0, 24.0, (0.5, 3.0)),),
        closed=(Course(700.0, 1500.0, (1.0, 4.0)),),
        tracked=(0,),
        loops=(Loop(0, 0, 0.02, 0.05),),
        settle=3.0,
    ),
    fine=0.01,
    slowest=0.2,
    sound=lambda x: (x[0] > 5.0) & (x[1] > 0.0),
)
