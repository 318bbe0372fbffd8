"""Likeness of two channels: their correlation, the ratio of their spreads, and the distance that both make.

    d(y, z) = |log(std y / std z)| + 2 (1 - corr(y, z))

tells a measured channel y from a free run z of the plant under the logged inputs: 0 where they follow one course. It is taken of
the whole channels and of their fast parts, around a moving average: what a free run misses most is slow.
"""

import numpy as np

from workbench.records import record

SLOW = 40  # moving averages over a record: its length by this number


@record
class Likeness:
    """Correlation of two channels and ratio of their spreads."""

    correlation: float
    ratio: float

    @property
    def distance(self) -> float:
        return abs(float(np.log(self.ratio))) + 2.0 * (1.0 - self.correlation) if self.ratio > 0.0 else np.inf


def likeness(y: np.ndarray, z: np.ndarray) -> Likeness:
    """Of two channels (N,) as they are."""
    a, b = y - y.mean(), z - z.mean()
    spread, other = float(np.sqrt(np.mean(a**2))), float(np.sqrt(np.mean(b**2)))
    if not (spread > 0.0 and other > 0.0):
        return Likeness(0.0, 0.0)
    return Likeness(float(np.mean(a * b) / (spread * other)), spread / other)


def nearest(y: np.ndarray, z: np.ndarray) -> Likeness:
    """Of two channels (N,) as a whole or of their fast parts, whichever correlate better."""
    return max(likeness(y, z), likeness(_fast(y), _fast(z)), key=lambda one: one.correlation)


def _fast(y: np.ndarray) -> np.ndarray:
    """A channel (N,) around its moving average."""
    half = max(len(y) // (2 * SLOW), 1)
    odd = np.concatenate([2 * y[0] - y[half:0:-1], y, 2 * y[-1] - y[-2 : -half - 2 : -1]])  # a slope goes on at the ends
    total = np.concatenate([[0.0], np.cumsum(odd - y[0])])
    return y - y[0] - (total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1)
