"""A black box and its records, written a second time in plain arithmetic: what is hidden does not come from the catalogue.

x+ = A(rho) x + B(rho) (u - u0) + K e, y = C(rho) x + D (u - u0) + y0 + e, scheduled by a radius and its value a sample earlier.
"""

import numpy as np

from workbench.basis import Powers
from workbench.data import Channel, Dataset, Experiment
from workbench.lpv import LPVModel, OperatingPoint, Predictor, Term
from workbench.physics.identified import identified

DT, SPREAD = 0.1, 0.02
V1, V2, W, R = (
    Channel("V1", "V", "input"), Channel("V2", "V", "input"), Channel("w", "rad/s", "output"), Channel("r2", "m", "schedule"),
)  # fmt: skip


def black_box() -> LPVModel:
    """Order 2, two inputs, one output; slower and weaker as the radius grows."""
    A = np.array([[[0.80, 0.15], [-0.20, 0.70]], [[0.4, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 0.3]]])
    B = np.array([[[0.30, 0.05], [0.10, -0.25]], [[-0.8, 0.0], [0.0, 0.5]], [[0.0, 0.0], [0.0, 0.0]]])
    C = np.array([[[1.0, 0.4]], [[0.5, 0.0]], [[0.0, 0.0]]])
    K = np.array([[[0.5], [0.1]], [[0.0], [0.0]], [[0.0], [0.0]]])
    D = np.array([[[0.2, 0.0]], [[0.0, 0.4]], [[0.0, 0.0]]])
    F, G = (M - np.einsum("ij,tjk->tik", K[0], N) for M, N in ((A, C), (B, D)))
    point = OperatingPoint(Powers([0.0]), np.array([[0.2, -0.1]]), np.array([[3.0]]))
    terms, span = (Term(0), Term(1), Term(1, 1)), np.array([0.05, 0.15])
    return LPVModel(
        "SSM", DT, (V1, V2), (W,), (R,), span[None], Powers([0.0, 1.0]), terms, A, B, C, D, point,
        predictor=Predictor(F, G, K, warmup=10), noise=np.array([[SPREAD**2]]),
    )  # fmt: skip


MODEL = black_box()
PLANT = identified(MODEL)


def still(u: np.ndarray) -> np.ndarray:
    """The command acts as it is."""
    return u


def records(seed: int, *, acting=still, reading=still, samples=600, count=2, model=MODEL) -> Dataset:
    """Records of the model in which `acting` (of the commands (N, 2)) drives it and `reading` (of y (N, 1)) is logged."""
    made = []
    for i in range(count):
        random = np.random.default_rng([seed, i])
        u = np.repeat(random.uniform(-1.0, 1.0, (samples // 5 + 1, 2)), 5, axis=0)[:samples]
        rho = np.linspace(0.06, 0.14, samples) + 0.005 * np.sin(0.05 * np.arange(samples))
        e = SPREAD * random.standard_normal(samples)
        w = acting(u.copy()) - model.operating_point.u[0]
        weights = model.weights(rho)
        x, y = np.zeros(2), np.empty((samples, 1))
        assert model.predictor is not None
        for k in range(samples):
            A, B, C, D, K = (np.tensordot(weights[k], M, 1) for M in (model.A, model.B, model.C, model.D, model.predictor.K))
            y[k] = C @ x + D @ w[k] + model.operating_point.y[0] + e[k]
            x = A @ x + B @ w[k] + K[:, 0] * e[k]
        channels = (V1, V2, W, R)
        made.append(Experiment(f"record {i}", DT * np.arange(samples), channels, np.column_stack([u, reading(y), rho]), DT))
    return Dataset(tuple(made))
