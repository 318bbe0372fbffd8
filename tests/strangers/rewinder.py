"""A web between a driven nip and a reel that grows:

J1 w1' = kT (V - kT w1) / R - b1 w1 + rn T,   T' = K (r w2 - rn w1) - T rn w1 / L,
J2(r) w2' = kI i - r T - b2 w2,   J2 = J0 + c (r^4 - r0^4),   r' = s w2 / (2 pi)
"""

import numpy as np

from tests.strangers.bench import Course, Lab, Machine, Place
from workbench import Channel, Parameter, Plant, Start
from workbench.physics.effects import Shaft, Span

CORE = 0.05  # m


def rates(x, u, p, f):
    w1, w2, T, r = x
    surface, nip = r * w2, p.rn * w1
    stretch = p.K * (1.0 + p.stiffening * (T - 20.0) / 20.0) * (surface - nip)
    inertia = p.J0 + p.c * (r**4 - CORE**4)
    return (
        (p.kT * (u[0] - p.kT * w1) / p.R - p.b1 * w1 + p.rn * T + f.nip) / p.J1,
        (p.kI * u[1] - T * (r + p.hard_nip * T) - p.b2 * w2 - p.squeezing * (r - CORE) * w2 + f.reel) / inertia,
        stretch - T * nip / p.L + f.web,
        p.s * w2 / (2.0 * np.pi),
    )


def outputs(x, p):
    return x[0], x[1], x[2], 1e3 * x[3]


# ---- what its user has written ---------------------------------------------------------------------------------------


def equation(x, u, p, at):
    J2 = p.J0 + p.c * (x.r**4 - 0.05**4)
    stretch = x.r * x.w2 - p.rn * x.w1
    return {
        "w1": (p.kT / p.R * u.V - (p.kT**2 / p.R + p.b1) * x.w1 + p.rn * x.T + at.nip.torque()) / p.J1,
        "w2": (p.kI * u.i - x.r * x.T - p.b2 * x.w2 + at.reel.torque()) / J2,
        "T": p.K * stretch + at.web.rate(stretch, p.K, 20.0) - p.rn * x.w1 * x.T / p.L,
        "r": p.s / (2 * np.pi) * x.w2,
    }


def measure(x, p):
    return {"w1": x.w1, "w2": x.w2, "T": x.T, "r": 1000 * x.r}


PLANT = Plant(
    name="rewinder",
    states=(Channel("w1", "rad/s"), Channel("w2", "rad/s"), Channel("T", "N"), Channel("r", "m")),
    inputs=(Channel("V", "V", "input"), Channel("i", "A", "input")),
    outputs=(
        Channel("w1", "rad/s", "output"),
        Channel("w2", "rad/s", "output"),
        Channel("T", "N", "output"),
        Channel("r", "mm", "schedule"),
    ),
    parameters=(
        Parameter("J1", 2e-3, "kg m^2", tolerance=0.2, meaning="inertia of the nip"),
        Parameter("J0", 5e-3, "kg m^2", tolerance=0.2, meaning="inertia of the empty reel"),
        Parameter("c", 300.0, "kg/m^2", tolerance=0.2, meaning="what a wound layer adds to it"),
        Parameter("K", 2000.0, "N/m", tolerance=0.3, meaning="stiffness of the web"),
        Parameter("L", 1.0, "m", meaning="length of the web"),
        Parameter("rn", 0.05, "m", meaning="radius of the nip"),
        Parameter("kT", 0.3, "V s/rad", tolerance=0.1, meaning="motor constant of the nip"),
        Parameter("R", 1.0, "ohm", tolerance=0.1, meaning="armature resistance of the nip"),
        Parameter("kI", 0.5, "N m/A", tolerance=0.1, meaning="torque of the reel's drive"),
        Parameter("b1", 3e-3, "N m s/rad", tolerance=0.5, meaning="bearing of the nip"),
        Parameter("b2", 5e-3, "N m s/rad", tolerance=0.5, meaning="bearing of the reel"),
        Parameter("s", 1e-4, "m", tolerance=0.1, meaning="thickness of the web"),
    ),
    equation=equation,
    measure=measure,
    dt=0.01,
    ports=(Shaft("nip", "w1"), Shaft("reel", "w2"), Span("web", "T")),
    start=Start({"w1": 40.0, "T": 20.0, "r": 0.05}, ("w2", "V", "i"), ("w1", "w2", "T"), {"w2": 40.0, "V": 10.0}),
    noise={"w1": 0.05, "w2": 0.05, "T": 0.1, "r": 0.05},
    limits={"T": (0.0, 200.0), "r": (0.04, 0.2)},
)

STRANGER = Machine(
    PLANT,
    rates,
    outputs,
    start=(40.0, 40.8, 20.0, CORE),
    places={"nip": Place(0, 0.6, 40.0), "reel": Place(1, 0.6, 40.0), "web": Place(2, 0.0, 1.0)},
    foreign={"squeezing": 3.0, "hard_nip": 4e-4},
    inside={"nonlinear-elasticity@web": "stiffening"},
    lab=Lab(
        dts=(0.01, 0.02),
        seconds=(20.0, 40.0),
        noise=(0.05, 0.05, 0.1, 0.05),
        push=(0.05, 0.02),
        base=(9.0, 2.6),
        range=((0.0, 20.0), (0.0, 8.0)),
        open=(Course(8.5, 11.0, (1.0, 4.0)), Course(2.4, 4.2, (0.7, 3.0))),
        settle=2.0,
    ),
    fine=0.005,
    slowest=0.1,
    sound=lambda x: (x[2] > 1.0) & (x[0] > 5.0) & (x[3] < 0.15),
    caps={"periodic-tension@web": 100.0, "nonlinear-elasticity@web": 0.5},
)
