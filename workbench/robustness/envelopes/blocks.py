"""Block matrices of numbers and of intervals, one for each sample, of which a certificate is made."""

import numpy as np

from workbench.intervals.arithmetic import Interval, exact


def bordered(P: np.ndarray, q: np.ndarray, c: np.ndarray) -> np.ndarray:
    """[P q; q' c]."""
    top = np.concatenate([P, q[..., None]], axis=-1)
    return np.concatenate([top, np.concatenate([q, c[..., None]], axis=-1)[..., None, :]], axis=-2)


def padded(V: np.ndarray, channels: int) -> Interval:
    """V with rows and columns of zeros for w before its last ones."""
    K, n = len(V), V.shape[1] - 1
    whole = np.zeros((K, n + channels + 1, n + channels + 1))
    at = np.append(np.arange(n), n + channels)
    whole[:, at[:, None], at] = V
    return exact(whole)


def diagonal(mu: Interval, n: int) -> np.ndarray:
    K, c = mu.shape
    whole = np.zeros((K, n + c + 1, n + c + 1))
    whole[:, n + np.arange(c), n + np.arange(c)] = mu.low
    return whole


def transposed(x: Interval) -> Interval:
    return Interval(x.low.swapaxes(-1, -2), x.high.swapaxes(-1, -2))


def symmetric(x: Interval) -> Interval:
    """The symmetric matrices in x, which are those in the intersection with its transpose."""
    return x.intersection(transposed(x)).interval()


def rows(parts: list[Interval], axis: int = -2) -> Interval:
    return Interval(np.concatenate([x.low for x in parts], axis=axis), np.concatenate([x.high for x in parts], axis=axis))


def columns(parts: list[Interval], last: Interval) -> Interval:
    return rows([*parts, last], axis=-1)
