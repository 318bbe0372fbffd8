"""A user's ball under a magnet: the plant as its owner writes it, and the machine in its loop by Euler steps of its own.

m s'' = m g - C (i / s)^2,   L i' = U - R i,   s the gap: what is off grows e-fold in 1/44 s
"""

import numpy as np

from workbench import Channel, Parameter, Plant, Start
from workbench.data import Experiment
from workbench.physics.effects import Slide

DT, g = 0.001, 9.81
M, C, R, L = 0.54, 1.30e-4, 4.3, 0.046  # the machine
GAP, GAINS = 0.01, (3303.0, 68.9, -5.15, 4472.0)  # where the law holds the ball; of gap, speed, current and the integral
NOISE = 0.01  # mm, A
LEAST = 0.002  # m, a stop of the machine


def _equation(least):
    def equation(x, u, p, at):
        s = np.maximum(x.s, least) if least else x.s
        return {
            "s": x.v,
            "v": g + (at.ball.torque() - p.C * x.i**2 / s**2) / p.m,
            "i": (u.U - p.R * x.i) / p.L,
        }

    return equation


def plant(least: float = 0.0) -> Plant:
    """The plant from the data sheet; least: gap in m below which the force grows no further."""
    return Plant(
        name="maglev",
        states=(Channel("s", "m"), Channel("v", "m/s"), Channel("i", "A")),
        inputs=(Channel("U", "V", "input"),),
        outputs=(Channel("gap", "mm", "output"), Channel("cur", "A", "output")),
        parameters=(
            Parameter("m", 0.5, "kg", tolerance=0.1),
            Parameter("C", 1.226e-4, "N m^2/A^2", tolerance=0.15),
            Parameter("R", 4.0, "ohm", tolerance=0.1),
            Parameter("L", 0.05, "H", tolerance=0.2),
        ),
        equation=_equation(least),
        measure=lambda x, p: {"gap": 1000.0 * x.s, "cur": x.i},
        dt=DT,
        ports=(Slide("ball", "v"),),
        start=Start({"s": GAP}, ("v", "i", "U"), ("s", "v", "i"), guess={"i": 2.0, "U": 8.0}),
        noise={"gap": NOISE, "cur": NOISE},
    )


MAGLEV, GUARDED = plant(), plant(LEAST)


def record(seed: int, samples: int, *, offset: float = 0.0, move: float = 1.0, lag: float = 0.0, pieces: int = 4) -> Experiment:
    """A record under set-points that move by up to `move` in mm; offset: of the amplifier in V; lag: of the gap sensor in s."""
    random, h = np.random.default_rng(seed), DT / pieces
    rest = np.sqrt(M * g / C) * GAP
    s, v, i, total, slow, speed, late = GAP, 0.0, rest, 0.0, GAP, 0.0, GAP
    steps = np.repeat(random.uniform(-move, move, samples // 200 + 1), 200)[:samples]
    steps[:200] = 0.0
    rows = []
    for k in range(samples):
        gap = np.round((1e3 * (late if lag else s) + NOISE * random.standard_normal()) / 0.005) * 0.005
        current = np.round((i + NOISE * random.standard_normal()) / 0.005) * 0.005
        speed, slow = (1e-3 * gap - slow) / 0.003, slow + DT * (1e-3 * gap - slow) / 0.003
        off = 1e-3 * gap - GAP - 1e-3 * steps[k]
        total += off * DT
        U = 8.0 + np.dot(GAINS, (off, speed, current - 2.0, total))
        U = np.round(np.clip(U, -2.0, 24.0) / 0.01) * 0.01
        rows.append((U, gap, current))
        for _ in range(pieces):
            late += h * (s - late) / lag if lag else 0.0
            v += h * (g - C * i**2 / s**2 / M)
            s, i = s + h * v, i + h * (U + offset - R * i) / L
        assert LEAST < s < 0.03, f"the loop loses the ball at {k * DT:g} s"
    U, gap, current = np.array(rows).T
    units = {"U": "V", "gap": "mm", "cur": "A"}
    return Experiment.from_arrays(f"maglev {seed}", DT, inputs={"U": U}, outputs={"gap": gap, "cur": current}, units=units)
