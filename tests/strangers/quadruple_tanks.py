"""Four tanks, of which the upper two drain into the lower two [1]; every pump feeds one lower and one upper tank across.

[1] K. H. Johansson, "The quadruple-tank process", IEEE Transactions on Control Systems Technology 8(3), 2000.
"""

import numpy as np

from tests.strangers.bench import Course, Lab, Loop, Machine
from workbench import Channel, Parameter, Plant, Start


def rates(x, u, p, f):
    h1, h2, h3, h4 = (np.maximum(h, 1e-5) for h in x)
    out = [a * np.sqrt(2.0 * 9.81 * h) for a, h in ((p.a1, h1), (p.a2, h2), (p.a3, h3), (p.a4, h4))]
    across = p.joined * (h1 - h2)  # a laminar leak between the lower tanks
    out[0] = out[0] * (1.0 - p.clogged * h1)
    return (
        (p.g1 * p.k1 * u[0] + out[2] - out[0] - across) / p.A,
        (p.g2 * p.k2 * u[1] + out[3] - out[1] + across) / p.A,
        ((1.0 - p.g2) * p.k2 * u[1] - out[2]) / p.A,
        ((1.0 - p.g1) * p.k1 * u[0] - out[3]) / p.A,
    )


def outputs(x, p):
    return 100.0 * x[0], 100.0 * x[1]


# ---- what its user has written ---------------------------------------------------------------------------------------


def equation(x, u, p, at):
    del at
    q1, q2, q3, q4 = (
        a * np.sqrt(19.62 * np.maximum(h, 1e-5)) for a, h in zip((p.a1, p.a2, p.a3, p.a4), (x.h1, x.h2, x.h3, x.h4), strict=True)
    )
    return {
        "h1": (q3 - q1 + p.g1 * p.k1 * u.v1) / p.A,
        "h2": (q4 - q2 + p.g2 * p.k2 * u.v2) / p.A,
        "h3": (p.k2 * u.v2 * (1 - p.g2) - q3) / p.A,
        "h4": (p.k1 * u.v1 * (1 - p.g1) - q4) / p.A,
    }


def measure(x, p):
    return {"y1": 100 * x.h1, "y2": 100 * x.h2}


PLANT = Plant(
    name="quadruple-tanks",
    states=tuple(Channel(f"h{k}", "m") for k in (1, 2, 3, 4)),
    inputs=(Channel("v1", "V", "input"), Channel("v2", "V", "input")),
    outputs=(Channel("y1", "cm", "output"), Channel("y2", "cm", "output")),
    parameters=(
        Parameter("A", 2.8e-3, "m^2", tolerance=0.03, meaning="area of every tank"),
        Parameter("a1", 2.8e-5, "m^2", tolerance=0.1, meaning="outlet of tank 1"),
        Parameter("a2", 2.8e-5, "m^2", tolerance=0.1, meaning="outlet of tank 2"),
        Parameter("a3", 2.4e-5, "m^2", tolerance=0.1, meaning="outlet of tank 3"),
        Parameter("a4", 2.4e-5, "m^2", tolerance=0.1, meaning="outlet of tank 4"),
        Parameter("k1", 1.1e-5, "m^3/s/V", tolerance=0.1, meaning="pump 1"),
        Parameter("k2", 1.1e-5, "m^3/s/V", tolerance=0.1, meaning="pump 2"),
        Parameter("g1", 0.7, "", tolerance=0.05, meaning="share of pump 1 to tank 1"),
        Parameter("g2", 0.6, "", tolerance=0.05, meaning="share of pump 2 to tank 2"),
    ),
    equation=equation,
    measure=measure,
    dt=0.1,
    start=Start(
        {"v1": 4.0, "v2": 4.0},
        ("h1", "h2", "h3", "h4"),
        ("h1", "h2", "h3", "h4"),
        {"h1": 0.1, "h2": 0.1, "h3": 0.02, "h4": 0.02},
    ),
    noise={"y1": 0.03, "y2": 0.03},
)

STRANGER = Machine(
    PLANT,
    rates,
    outputs,
    start=(0.12, 0.12, 0.03, 0.02),
    places={},
    foreign={"joined": 2e-4, "clogged": 2.0},
    lab=Lab(
        dts=(0.1,),
        seconds=(80.0, 120.0),
        noise=(0.03, 0.03),
        push=(0.02, 0.02),
        base=(4.0, 4.0),
        range=((0.0, 10.0), (0.0, 10.0)),
        open=(Course(3.0, 5.0, (6.0, 20.0)), Course(3.0, 5.0, (6.0, 20.0))),
        closed=(Course(9.0, 15.0, (10.0, 25.0)), Course(9.0, 15.0, (10.0, 25.0))),
        tracked=(0, 1),
        loops=(Loop(0, 0, 0.3, 0.015), Loop(1, 1, 0.3, 0.015)),
        settle=25.0,
    ),
    fine=0.1,
    slowest=4.0,
    sound=lambda x: np.all(x > 5e-4, axis=0) & np.all(x < 0.5, axis=0),
)
