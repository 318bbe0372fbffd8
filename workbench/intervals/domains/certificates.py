"""Certificates of separation, inclusion and common points: the answers of a solver, checked with a rounding margin.

Where neither yes nor no can be proved, as for sets that touch, there is no answer.
"""

import numpy as np

from workbench.intervals.domains.boxes import FLAT, INSIDE, Boxes
from workbench.records import field, record

EPS = float(np.finfo(float).eps)


@record
class Hyperplane:
    """normal'x <= offset on the first set, normal'x > offset on the second; rounding is on the safe side."""

    normal: np.ndarray = field("d")
    offset: float = field("")


def separation(first: Boxes, second: Boxes, normal: np.ndarray, slack: np.ndarray | float = 0.0) -> Hyperplane | None:
    """The hyperplane, if `second` lies above the highest point of `first` by more than the slack and rounding."""
    size = np.abs(normal)
    error = 4 * (len(normal) + 4) * EPS * float(size @ (first.size + second.size + slack))
    offset = first.highest(normal) + error
    above = -second.highest(-normal) - error
    return Hyperplane(normal, offset) if above > offset + float((size * slack).sum()) else None


def weights_proved(first: Boxes, a: np.ndarray, second: Boxes, b: np.ndarray, slack: np.ndarray, scale: np.ndarray) -> bool:
    """Are there exact weights near a (m1), b (m2) with low1'a <= high2'b + slack and low2'b <= high1'a + slack?

    An inequality is sure when it holds beyond rounding, or for every pair of boxes that has weight. The others hold as
    equations after a small change of the weights, which exists if their matrix has full rank: change <= error / sigma_min.
    It must leave the weights positive and the sure inequalities true.
    """
    used = a > 1e-12, b > 1e-12
    a, b = a[used[0]] / a[used[0]].sum(), b[used[1]] / b[used[1]].sum()
    left = np.hstack([first.low[used[0]], -first.high[used[0]]])
    right = np.hstack([-second.high[used[1]], second.low[used[1]]])
    slack, scale = np.tile(slack, 2), np.tile(scale, 2)
    count = len(a) + len(b)
    error = 4 * (count + 4) * EPS * (np.abs(left).max(axis=0) + np.abs(right).max(axis=0) + slack)
    value = a @ left + b @ right - slack
    each = (left.max(axis=0) <= -right.max(axis=0)) if not slack.any() else np.zeros(len(value), dtype=bool)
    # an equation met to the solver's accuracy shows up in one row as room: that is not sure
    tight = ~(each | (value < -error - np.where(slack > 0, 0.0, INSIDE * scale)))
    if not tight.any():
        return True
    # rows from a middle point, so that the change of the weights is measured by the size of the sets; the two rows of a
    # coordinate without radii are one equation
    base = left[0]
    whole = np.vstack([left - base, right + base]) / scale
    rows = np.unique(_without_opposites(whole.T[tight]), axis=0)
    simplex = np.zeros((2, count))
    simplex[0, : len(a)] = simplex[1, len(a) :] = 1.0
    M = np.vstack([rows, simplex])
    if len(M) > count:
        return False
    sigma = float(np.linalg.svd(M, compute_uv=False).min())
    if sigma <= FLAT:
        return False
    missing = np.append(((np.abs(value) + error) / scale)[tight], [count * EPS] * 2)
    change = 2 * float(np.linalg.norm(missing)) / sigma
    room = (-(value + error) / scale)[~tight & ~each]
    size = float(np.linalg.norm(whole, axis=0).max())
    return change < min(a.min(), b.min()) and bool(np.all(change * size < room))


def _without_opposites(rows: np.ndarray) -> np.ndarray:
    """Of two rows that are each other's negative only one: the sign is set by the first entry that is not 0."""
    lead = rows[np.arange(len(rows)), np.argmax(rows != 0, axis=1)]
    return rows * np.where(lead < 0, -1.0, 1.0)[:, None]
