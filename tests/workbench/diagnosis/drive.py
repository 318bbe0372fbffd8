"""A user's drive with a tacho: the plant as its owner writes it, and the machine itself by Euler steps of its own.

J w' = kT (U - kT w) / Ra - c w,   tacho: lag y' = 30/pi w - y
"""

import numpy as np

from workbench import Channel, Parameter, Plant
from workbench.data import Dataset, Experiment
from workbench.physics.effects import Shaft

DT = 0.005
RPM = 30.0 / np.pi
J, RA, KT, C = 2e-3, 1.0, 0.12, 2e-4
READING = 1.0  # 1/min


def _equation(x, u, p, at):
    return {"w": (p.kT * (u.U - p.kT * x.w) / p.Ra - p.c * x.w + at.shaft.torque()) / p.J0}


def _measure(x, p):
    return {"n": RPM * x.w}


DRIVE = Plant(
    name="drive",
    states=(Channel("w", "rad/s"),),
    inputs=(Channel("U", "V", "input"),),
    outputs=(Channel("n", "1/min", "output"),),
    parameters=(
        Parameter("J0", J, "kg m^2", tolerance=0.2),
        Parameter("Ra", RA, "ohm", tolerance=0.1),
        Parameter("kT", KT, "V s/rad", tolerance=0.05),
        Parameter("c", C, "N m s/rad", tolerance=0.5),
    ),
    equation=_equation,
    measure=_measure,
    dt=DT,
    ports=(Shaft("shaft", "w"),),
    noise={"n": READING},
)


def records(seed: int, *, lag: float = 0.0, count: int = 2, samples: int = 3000, inertia: float = 1.1) -> Dataset:
    """Records of the drive under random steps of the voltage; lag: time constant of the tacho's filter in s."""
    random = np.random.default_rng(seed)
    pieces = 20
    h = DT / pieces
    made = []
    for i in range(count):
        U = np.repeat(random.uniform(2.0, 12.0, samples // 60 + 1), 60)[:samples]
        w, y, rows = 20.0, 20.0 * RPM, []
        for k in range(samples):
            rows.append((U[k], (y if lag else RPM * w) + READING * random.standard_normal()))
            for _ in range(pieces):
                if lag:
                    y += h * (RPM * w - y) / lag
                w += h * (KT * (U[k] - KT * w) / RA - C * w) / (inertia * J)
        channels = (Channel("U", "V", "input"), Channel("n", "1/min", "output"))
        made.append(Experiment(f"drive {i}", DT * np.arange(samples), channels, np.array(rows), DT))
    return Dataset(tuple(made))
