"""How fast what is off grows along records: rate = log|largest eigenvalue of F_N .. F_2 F_1| / (N Ts), F_k the steps of a filter.

What an unstable plant does in free runs is told by the first few e-folds. Further ahead a run has left its record whatever its
model, by as much as the equations let it: two such errors, one of a kilometre and one of ten, tell nothing about their models.
"""

import numpy as np

from workbench.diagnosis.predictor import Predictor

GROWN = 100.0  # times that what is off grows along a record of a plant that is unstable
SECOND, MOST = 1.0, 6.0  # s, how far ahead runs are compared, beside the full run; times that what is off may grow e-fold in it
FOLDS = 4.0  # the same up to where runs are compared if it grows more often
FAR, GONE = 3.0, 10.0  # standard deviations of a channel, beyond which a run does not follow its record, and is nowhere near it


def unstable(predictor: Predictor) -> bool:
    """Whether what is off in the states grows along a record by GROWN or more."""
    lengths = [predictor.plant.dt * len(r) for r in predictor.records]
    return any(rate * length > np.log(GROWN) for rate, length in zip(_rates(predictor), lengths, strict=False))


def reach(predictor: Predictor) -> float:
    """How far ahead runs are compared [s]: a second, or where it grows too much as long as that is by e^FOLDS, to two digits."""
    fastest = max(_rates(predictor), default=0.0) if unstable(predictor) else 0.0
    return SECOND if fastest * SECOND <= MOST else float(f"{FOLDS / fastest:.2g}")


def fold(predictor: Predictor) -> float:
    """The time [s] in which what is off grows e-fold."""
    return 1.0 / max(_rates(predictor))


def left(errors: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Which outputs (ny) a run with such errors (N, ny) does not follow, by more than FAR of the spread of what was measured."""
    with np.errstate(over="ignore", invalid="ignore"):
        sizes = np.array([np.sqrt(np.mean(e[np.isfinite(y)] ** 2)) for e, y in zip(errors.T, measured.T, strict=True)])
    return ~(sizes <= FAR * spread(measured)) & np.isfinite(measured).any(axis=0)


def spread(measured: np.ndarray) -> np.ndarray:
    """Standard deviations (ny) of outputs (N, ny), 0 of what was not measured."""
    own = [y[np.isfinite(y)] for y in measured.T]
    return np.array([float(np.std(y)) if len(y) else 0.0 for y in own])


def _rates(predictor: Predictor) -> list[float]:
    return [log_growth(line.F) / (predictor.plant.dt * len(line.F)) for line in predictor.lines]


def log_growth(F: np.ndarray) -> float:
    """Logarithm of the largest eigenvalue, in size, of the product of F (N, n, n) in their order; 0 where F is not finite."""
    if not np.isfinite(F).all() or not F.size:
        return 0.0
    scale = np.zeros(len(F))
    while len(F) > 1:  # by pairs, each product brought to a size of 1
        even = len(F) // 2 * 2
        pairs, scales = F[1:even:2] @ F[:even:2], scale[1:even:2] + scale[:even:2]
        size = np.maximum(np.abs(pairs).max(axis=(1, 2)), 1e-300)
        F, scale = (np.concatenate([a, b[even:]]) for a, b in ((pairs / size[:, None, None], F), (scales + np.log(size), scale)))
    return float(np.log(max(np.abs(np.linalg.eigvals(F[0])).max(), 1e-300)) + scale[0])
