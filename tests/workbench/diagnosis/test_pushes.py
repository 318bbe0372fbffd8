"""What nobody logged enters where inputs do: a force on a cart also swings the rod on it. The rod is written a second time, as
matrices, and runs under a state feedback of its readings and their differences.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from workbench import Parameter, Plant
from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis.answer import Finding
from workbench.diagnosis.diagnosis import diagnose
from workbench.diagnosis.predictor import predictor

M, m, length, b, k, g = 0.8, 0.2, 0.4, 6.0, 1.8, 9.81
NOISE, DT = np.array([5e-4, 1e-3]), 0.01
A = np.array(
    [[0, 1, 0, 0], [0, -b / M, -m * g / M, 0], [0, 0, 0, 1], [0, b / (M * length), (M + m) * g / (M * length), 0]], dtype=float
)
B = np.array([0.0, k / M, 0.0, -k / (M * length)])


def equation(x, u, p, at):
    force = p.k * u.V - p.b * x.v
    return {"x": x.v, "v": (force - p.m * g * x.a) / p.M, "a": x.w, "w": ((p.M + p.m) * g * x.a - force) / (p.M * p.l)}


ROD = Plant(
    name="rod on a cart",
    states=(Channel("x", "m"), Channel("v", "m/s"), Channel("a", "rad"), Channel("w", "rad/s")),
    inputs=(Channel("V", "V", "input"),),
    outputs=(Channel("y", "m", "output"), Channel("angle", "rad", "output")),
    parameters=(
        Parameter("M", M, "kg", tolerance=0.1),
        Parameter("m", m, "kg", tolerance=0.1),
        Parameter("l", length, "m", tolerance=0.05),
        Parameter("b", b, "N s/m", tolerance=0.3),
        Parameter("k", k, "N/V", tolerance=0.1),
    ),
    equation=equation,
    measure=lambda x, p: {"y": x.x, "angle": x.a},
    dt=DT,
    noise={"y": NOISE[0], "angle": NOISE[1]},
)


def flow():
    """F (4, 4) and G (4,) over a sample of held input."""
    both = expm(DT * np.block([[A, B[:, None]], [np.zeros((1, 5))]]))
    return both[:4, :4], both[:4, 4]


def record(seed: int, samples: int = 1500, push: float = 0.5) -> Experiment:
    """The cart follows steps, and balances the rod, while a voltage that nobody logged comes and goes."""
    F, G = flow()
    P = solve_discrete_are(F, G[:, None], np.diag([50.0, 1.0, 50.0, 1.0]), np.array([[0.05]]))
    K = G @ P @ F / (0.05 + G @ P @ G)
    random, decay = np.random.default_rng(seed), np.exp(-DT / 0.3)
    x, d, last, rows = np.zeros(4), 0.0, np.zeros(2), []
    targets = np.repeat(0.2 * random.standard_normal(samples // 100 + 1), 100)
    for j in range(-200, samples):
        y = x[[0, 2]] + NOISE * random.standard_normal(2)
        rate, last = (y - last) / DT, y
        V = -K @ np.array([y[0] - targets[max(j, 0)], rate[0], y[1], rate[1]])
        if j >= 0:
            rows.append((V, *y))
        d = decay * d + push * np.sqrt(1.0 - decay**2) * random.standard_normal()
        x = F @ x + G * (V + d)
    channels = (Channel("V", "V", "input"), Channel("y", "m", "output"), Channel("angle", "rad", "output"))
    return Experiment(f"rod {seed}", DT * np.arange(samples), channels, np.array(rows), DT)


def test_an_input_that_moves_two_states_is_pushed_as_one_and_the_filter_carries_what_comes_and_goes_at_it():
    """x+ = F (x + K e) + G u, e = y - H x, written out with the matrices of the rod."""
    made = predictor(ROD, Dataset((record(1, 400),)))
    assert made.entries == ("V", "v", "w")
    levels = replace(made.noise, process=np.array([0.1, 1e-9, 1e-9]), drift=np.array([0.3, 1e-9, 1e-9]), memory=0.3)
    made = replace(made, substeps=16).regained(made.point, levels)
    F, G = flow()
    line, r, gain = made.lines[0], made.records[0], made.passes[0].gain
    assert line.F.shape == (400, 7, 7)
    np.testing.assert_allclose(line.F[50][:4, :4], F, rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(line.F[50][:4, 4], G, rtol=1e-4, atol=1e-8)
    np.testing.assert_allclose(line.G[50][:4, 0], G, rtol=1e-4, atol=1e-8)
    x, e = np.concatenate([r.start, np.zeros(3)]), np.zeros((len(r), 2))
    for j, y in enumerate(r.seen):
        e[j] = np.where(np.isnan(y), 0.0, y - line.H[j] @ x)
        x = line.F[j] @ (x + gain[j] @ e[j])
        x[:4] += G * r.u[j, 0]
    at = made.point
    errors = made.errors(0, at.p[None], at.eta[:1], at.start[:1], white=False)[0]
    np.testing.assert_allclose(errors, e, rtol=1e-4, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 10])
def test_a_voltage_that_comes_and_goes_is_no_missing_physics_of_two_states(seed):
    """Pushes of the two states by themselves stand for it badly, and under feedback the input shows it: UNKNOWN three times of
    three."""
    found = diagnose(ROD, Dataset((record(seed), record(seed + 1))), Dataset((record(seed + 2),)))
    assert found.finding is Finding.NOTHING
