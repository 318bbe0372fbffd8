"""What a model leaves of an output, as white noise behind a filter: v(k) = C(1/z) / A(1/z) e(k), an ARMA process.

A disturbance that wanders through the process and the white noise of a sensor are one of a low order, where autoregression alone
takes as many numbers as the process takes samples to forget; and what it misses biases a model that is identified in a closed
loop. Begun by E. J. Hannan and J. Rissanen's regression (Biometrika 69, 1982), then the least squares of e (Gauss-Newton).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

LONG, SHARE = 50, 8  # order of the autoregression that it begins with, and samples for each of its numbers
STEPS, HALVES = 8, 6  # of Gauss-Newton, and how often one is halved
LARGEST = 0.995  # modulus of a root of C
STILL = 1e-5  # share by which a step must lower the sum of squares, for another one


class NoiseModel(NamedTuple):
    """A and C, monic: coefficients of 1, 1/z, .."""

    A: np.ndarray
    C: np.ndarray

    def innovations(self, v: np.ndarray) -> np.ndarray:
        """e (N, ..) of v (N, ..), which was 0 before."""
        return np.asarray(lfilter(self.A, self.C, v, axis=0))

    @property
    def numbers(self) -> int:
        return len(self.A) + len(self.C) - 2


def fit_noise(series: Sequence[np.ndarray], order: int) -> NoiseModel:
    """The ARMA process of an order, of each polynomial, that leaves the least innovations in series (N,), each its own run."""
    found = _begun(series, order)
    cost = _cost(found, series)
    for _ in range(STEPS):
        step = _step(found, series, order)
        for half in range(HALVES):
            tried = _shifted(found, 0.5**half * step, order)
            lower = _cost(tried, series)
            if lower < cost:
                break
        else:
            return found
        found, cost, before = tried, lower, cost
        if cost > (1.0 - STILL) * before:
            break
    return found


def _begun(series: Sequence[np.ndarray], order: int) -> NoiseModel:
    """From the innovations of a long autoregression, taken for known."""
    long = max(order, min(LONG, min(map(len, series)) // SHARE))
    rows, y = _former(series, long)
    auto = np.concatenate([[1.0], -np.linalg.lstsq(rows, y, rcond=None)[0]])
    e = [np.asarray(lfilter(auto, [1.0], v))[long:] for v in series]
    past, _ = _former(e, order)
    rows, y = _former([v[long:] for v in series], order)
    numbers = np.linalg.lstsq(np.column_stack([-rows, past]), y, rcond=None)[0]
    return _shifted(NoiseModel(np.eye(1, order + 1)[0], np.eye(1, order + 1)[0]), numbers, order)


def _step(at: NoiseModel, series: Sequence[np.ndarray], order: int) -> np.ndarray:
    """Of Gauss-Newton: de / da_i = v(k - i) / C, de / dc_i = -e(k - i) / C."""
    slopes, left = [], []
    for v in series:
        e = at.innovations(v)
        by_a, by_c = (np.asarray(lfilter([1.0], at.C, x)) for x in (v, -e))
        shifted = [np.concatenate([np.zeros(i), x[: len(x) - i]]) for x in (by_a, by_c) for i in range(1, order + 1)]
        slopes.append(np.column_stack(shifted)[order:])
        left.append(e[order:])
    return -np.linalg.lstsq(np.concatenate(slopes), np.concatenate(left), rcond=None)[0]


def _shifted(at: NoiseModel, step: np.ndarray, order: int) -> NoiseModel:
    """By a step, with the roots of C brought into the circle."""
    C = at.C + np.append(0.0, step[order:])
    roots = np.roots(C)
    size = np.abs(roots)
    roots = np.where(size > 1.0, roots / np.maximum(size, 1e-300) ** 2, roots)
    roots *= np.minimum(1.0, LARGEST / np.maximum(np.abs(roots), 1e-300))
    C = np.concatenate([np.real(np.poly(roots)), np.zeros(order - len(roots))])
    return NoiseModel(at.A + np.append(0.0, step[:order]), C)


def _cost(at: NoiseModel, series: Sequence[np.ndarray]) -> float:
    skip = len(at.A) - 1
    found = sum(float(np.sum(at.innovations(v)[skip:] ** 2)) for v in series)
    return found if np.isfinite(found) else np.inf


def _former(series: Sequence[np.ndarray], order: int) -> tuple[np.ndarray, np.ndarray]:
    """The `order` samples before each sample of every series, the last one first, and these samples."""
    rows = [np.column_stack([e[order - j : len(e) - j] for j in range(1, order + 1)]) for e in series]
    return np.concatenate(rows), np.concatenate([e[order:] for e in series])
