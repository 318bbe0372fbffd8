"""How sure a refined model is: DC gains and slowest poles with standard deviations that coloured errors do not fool.

    cov(theta) = H^-1 (sum_b g_b g_b') H^-1,   H = J'J,   g_b = J'e of the b-th block of a record, its start eliminated

The errors of a free run are coloured by all that pushes the machine, so that H^-1 alone would be far too small. Blocks as long as
the errors last make no claim about their colour. P. Huber, "The behavior of maximum likelihood estimates under nonstandard
conditions", Proc. 5th Berkeley Symposium (1967); L. Ljung, "System Identification", section 9.4.
"""

import numpy as np

from workbench.identification.output_error.free_numbers import FreeNumbers
from workbench.lpv import Estimate, LPVModel, ends

STEP = 1e-5  # standard deviations, for differences


def estimates(own: FreeNumbers, H: np.ndarray, blocks: list[np.ndarray]) -> tuple[Estimate, ...]:
    """DC gains and moduli of the slowest pole, at both ends and in the middle of the span; H, blocks: see `Runs.normal`."""
    P = len(own.places)
    A, scores = np.zeros((P, P)), []
    for h, b in zip(H, blocks, strict=True):
        by_start = np.linalg.pinv(h[P:, P:], rcond=1e-12) @ h[P:, :P]
        A += h[:P, :P] - h[:P, P:] @ by_start
        scores.append(b[:, :P] - b[:, P:] @ by_start)
    G = np.concatenate(scores)
    d = np.sqrt(np.maximum(np.diag(A), 1e-300))
    inverse = np.linalg.pinv(A / np.outer(d, d), rcond=1e-9, hermitian=True)  # state coordinates: a direction without effect
    root = (G / d) @ inverse / d  # (blocks, P): cov = root' root
    value, names = _features(own.model)
    size = np.sqrt(np.sum(root**2, axis=0))
    slopes = np.zeros((len(value), P))
    for i in np.flatnonzero(size):
        moved = own.values.copy()
        moved[i] += STEP * size[i]
        slopes[:, i] = (_features(own.moved(moved).model)[0] - value) / (STEP * size[i])
    std = np.sqrt(np.sum((root @ slopes.T) ** 2, axis=0) * len(G) / max(len(G) - P, 1))
    return tuple(Estimate(name, float(v), float(s), unit=unit) for (name, unit), v, s in zip(names, value, std, strict=True))


def _features(model: LPVModel) -> tuple[np.ndarray, list[tuple[str, str]]]:
    """Values, and their names and units."""
    values: list[float] = []
    names: list[tuple[str, str]] = []
    for rho in [*ends(model.spans), model.middle] if model.schedules else [None]:
        A, B, C, D = model.freeze(rho)
        gain = C @ np.linalg.solve((1.0 + 1e-12) * np.eye(len(A)) - A, B) + D  # an exact integrator gets a huge gain
        at = f" at {model.named(rho)}" if model.schedules else ""
        for y, row in zip(model.outputs, gain, strict=True):
            for u, value in zip(model.inputs, row, strict=True):
                values.append(float(value))
                names.append((f"DC gain {u.name} to {y.name}{at}", f"{y.unit or 1}/({u.unit})" if u.unit else y.unit))
        values.append(float(np.abs(np.linalg.eigvals(A)).max(initial=0.0)))
        names.append((f"modulus of the slowest pole{at}", ""))
    return np.array(values), names
