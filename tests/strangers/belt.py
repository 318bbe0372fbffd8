"""Two drives on one belt:

J1 w1' = k1 i1 - b1 w1 - r1 B,   J2 w2' = k2 i2 - b2 w2 + r2 B,   B = K e + D e',   e' = r1 w1 - r2 w2
"""

import numpy as np

from tests.strangers.bench import Course, Lab, Loop, Machine, Place
from workbench import Channel, Parameter, Plant
from workbench.physics.effects import Shaft

R1, R2 = 0.04, 0.06  # m


def pull(x, p):
    w1, w2, e = x
    rate = R1 * w1 - R2 * w2
    return p.K * e * (1.0 + p.rubber * e**2) + p.D * rate, rate


def rates(x, u, p, f):
    B, rate = pull(x, p)
    return (
        (p.k1 * u[0] - p.b1 * x[0] - R1 * B + f.first) / p.J1,
        (p.k2 * u[1] - p.b2 * x[1] - p.mixer * x[1] ** 3 + R2 * B + f.second) / p.J2,
        rate,
    )


def outputs(x, p):
    return x[0] * 30.0 / np.pi, x[1] * 30.0 / np.pi, pull(x, p)[0]


# ---- what its user has written ---------------------------------------------------------------------------------------


def force(x, p):
    return p.K * x.e + p.D * (0.04 * x.w1 - 0.06 * x.w2)


def equation(x, u, p, at):
    B = force(x, p)
    return {
        "w1": (p.k1 * u.i1 + at.first.torque() - 0.04 * B - p.b1 * x.w1) / p.J1,
        "w2": (p.k2 * u.i2 + at.second.torque() + 0.06 * B - p.b2 * x.w2) / p.J2,
        "e": 0.04 * x.w1 - 0.06 * x.w2,
    }


def measure(x, p):
    return {"n1": 30 / np.pi * x.w1, "n2": 30 / np.pi * x.w2, "B": force(x, p)}


PLANT = Plant(
    name="belt",
    states=(Channel("w1", "rad/s"), Channel("w2", "rad/s"), Channel("e", "m")),
    inputs=(Channel("i1", "A", "input"), Channel("i2", "A", "input")),
    outputs=(Channel("n1", "1/min", "output"), Channel("n2", "1/min", "output"), Channel("B", "N", "output")),
    parameters=(
        Parameter("J1", 3e-3, "kg m^2", tolerance=0.2, meaning="inertia of drive 1"),
        Parameter("J2", 8e-3, "kg m^2", tolerance=0.2, meaning="inertia of drive 2"),
        Parameter("b1", 0.01, "N m s/rad", tolerance=0.4, meaning="friction of drive 1"),
        Parameter("b2", 0.02, "N m s/rad", tolerance=0.4, meaning="friction of drive 2"),
        Parameter("k1", 0.4, "N m/A", tolerance=0.05, meaning="torque of drive 1"),
        Parameter("k2", 0.5, "N m/A", tolerance=0.05, meaning="torque of drive 2"),
        Parameter("K", 3000.0, "N/m", tolerance=0.3, meaning="stiffness of the belt"),
        Parameter("D", 15.0, "N s/m", tolerance=0.5, meaning="damping of the belt"),
    ),
    equation=equation,
    measure=measure,
    dt=0.005,
    ports=(Shaft("first", "w1"), Shaft("second", "w2")),
    noise={"n1": 1.0, "n2": 1.0, "B": 0.2},
)

STRANGER = Machine(
    PLANT,
    rates,
    outputs,
    start=(0.0, 0.0, 0.0),
    places={"first": Place(0, 0.5, 30.0), "second": Place(1, 0.6, 20.0)},
    foreign={"rubber": 3e4, "mixer": 4e-5},
    lab=Lab(
        dts=(0.005, 0.01),
        seconds=(15.0, 25.0),
        noise=(1.0, 1.0, 0.2),
        push=(0.02, 0.02),
        base=(0.0, 0.0),
        range=((-6.0, 6.0), (-6.0, 6.0)),
        open=(Course(-3.0, 3.0, (0.3, 1.5)),),
        closed=(Course(-300.0, 300.0, (0.6, 2.0)),),
        tracked=(0,),
        loops=(Loop(0, 0, 0.01, 0.05),),
        free={1: Course(-1.5, 1.5, (0.5, 2.0))},
        settle=1.0,
    ),
    fine=0.005,
    slowest=0.05,
)
