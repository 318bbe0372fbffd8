"""Choosing what robustness leaves open before a law has seen the machine: candidates follow set-points on the identified model.

    x+ = A(rho) x + B(rho) (u - u0) + K(rho) e,     y = C(rho) x + y0 + e,     e white with the model's own covariance
    cost = mean over outputs and samples of ((r - y) / size)^2,   size: the output's largest set-point step

The model moves along a given schedule; u is what the law commands of r and y, its limits included.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from workbench.lpv import LPVModel
from workbench.records import field, record

HOLD = (1.0, 4.0)  # s, shortest and longest stay at a set-point
NO_WORSE = 1.01  # ratio of costs up to which a calmer candidate is taken


@record
class Rehearsal:
    """Set-points (N, ny) in the model's units along a schedule (N,), noise e (N, ny), and what counts as 1 in each output."""

    model: LPVModel
    references: np.ndarray = field("N ny")
    rho: np.ndarray = field("N")
    e: np.ndarray = field("N ny")
    size: np.ndarray = field("ny")

    def cost(self, law: Any) -> float:
        """Mean square of the errors under the law; infinite where the loop runs away."""
        errors = np.empty_like(self.references)
        model, point = self.model, self.model.operating_point
        weights, phi = model.weights(self.rho), point.basis(self.rho)
        u0, y0 = phi @ point.u, phi @ point.y
        K = model.predictor.K if model.predictor else np.zeros((len(model.terms), model.order, len(self.size)))
        x, state = np.zeros(model.order), law.init(u0[0])
        for k, r in enumerate(self.references):
            A, B, C, K_k = (np.tensordot(weights[k], M, 1) for M in (model.A, model.B, model.C, K))
            y = C @ x + y0[k] + self.e[k]
            u, state = law.step(state, r, y, self.rho[k] if law.schedule else None)
            x = A @ x + B @ (u - u0[k]) + K_k @ self.e[k]
            errors[k] = (r - y) / self.size
        return float(np.mean(errors**2)) if np.isfinite(errors).all() else np.inf


def rehearsal(model: LPVModel, centre: Sequence[float], size: Sequence[float], samples: int, seed: int) -> Rehearsal:
    """Random steps of every output up to `size` around `centre`, at times of their own, once along the whole schedule."""
    random = np.random.default_rng(seed)
    ny = len(model.outputs)
    low, high = (round(s / model.dt) for s in HOLD)
    references = np.empty((samples, ny))
    for j in range(ny):
        stays = random.integers(low, high, endpoint=True, size=samples // low + 1)
        references[:, j] = np.repeat(centre[j] + size[j] * random.uniform(-1.0, 1.0, len(stays)), stays)[:samples]
    rho = np.linspace(model.span[0], model.span[1], samples) if model.schedule else np.zeros(samples)
    spread = np.linalg.cholesky(model.noise) if model.noise is not None else np.zeros((ny, ny))
    return Rehearsal(model, references, rho, random.normal(size=(samples, ny)) @ spread.T, np.asarray(size, dtype=float))


def calmest(candidates: Mapping[str, Any], rehearsals: Sequence[Rehearsal]) -> tuple[str, dict[str, float]]:
    """Of candidates from calm to brisk the first that costs no more than the cheapest, and the mean cost of each."""
    costs = {name: float(np.mean([own.cost(law) for own in rehearsals])) for name, law in candidates.items()}
    return next(name for name, cost in costs.items() if cost <= NO_WORSE * min(costs.values())), costs
