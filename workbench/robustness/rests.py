"""Where a run begins: at the rest of any machine of the boxes, before which nothing has moved.

    x = A x + q + Q e + B w,   w_j = sum over the parameters i of channel j of delta_i lam_i z_i,   z = C x + f + J e
    |delta_i| <= 1 and |e_h| <= 1, all of them constant

The middle (delta = 0, e = 0) rests at `start`, and with X = (I - A)^-1 Q and G = (I - A)^-1 B any machine at start + X e + G w.
Of w is known

    |w_j| <= W_j = max over signs s of channel j of |s'(lam z)| + sum_h |s'(lam (C X + J)_h)| + sum_c |s'(lam C G_c)| W_c

z being that of `start`, as soon as one W is found that is no less than the right side: the map of w to w then contracts for every
delta, so that each machine has one rest, and its w is within W. All of it in outward-rounded arithmetic: X, G and `start` are
floating-point numbers, and what they miss is in the box |r| <= slack,

    x(0) in start + spread u + r,   spread = [X G],   |u| <= size = (1, W)

With parameters that move, the run begins at such a rest all the same: they move from its first sample on.
"""

from collections.abc import Sequence

import numpy as np

from workbench.intervals.arithmetic import Interval, exact
from workbench.records import field, record

TINY = 1e-110  # of W: so that it is no less than something positive
WIDER = 1e-9  # by which W is widened, relative, before it is proved
POLICIES = 50  # rows that are tried in search of W
REFINED = 20  # guesses of what the solution of a linear system may be off
UP = 1.0 + 1e-12  # more than the rounding of a sum of some positive terms


@record
class Rest:
    """What drives the loop before the run, see the module; g numbers e, none where all of it is known.

    Watched is E x + v + V e + F w.
    """

    q: np.ndarray = field("n")
    Q: np.ndarray = field("n g")
    f: np.ndarray = field("p")
    J: np.ndarray = field("p g")
    v: np.ndarray = field("s")
    V: np.ndarray = field("s g")


@record
class Start:
    """x(0) in start + spread u + r, |u| <= size, |r| <= slack; see the module."""

    spread: np.ndarray = field("n h")
    size: np.ndarray = field("h", low=0.0)
    slack: np.ndarray = field("n", low=0.0)


def known(n: int) -> Start:
    """A start that is known exactly."""
    return Start(np.zeros((n, 0)), np.zeros(0), np.zeros(n))


def holding(
    rest: Rest, A: np.ndarray, B: np.ndarray, C: np.ndarray, lam: np.ndarray, start: np.ndarray,
    channels: Sequence[tuple[np.ndarray, bool]],
) -> Start | None:  # fmt: skip
    """A set that holds the rests of all machines, or None where no bound on them is proved: some may have none.

    channels: rows s (J p) of signs of each, and whether the bound is their sum instead of their maximum.
    """
    if (found := _inverted(A)) is None:
        return None
    left, inverse = found
    right = np.column_stack([rest.q, rest.Q, B])
    X = inverse @ right
    X[:, 0] = start
    J = np.hstack([rest.f[:, None], rest.J, np.zeros((len(rest.f), B.shape[1]))])
    nothing = [np.zeros(len(signs)) for signs, _ in channels]
    return _bounded(left, inverse, X, exact(right) - left @ X, C, J, lam, channels, nothing)


def remaining(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, lam: np.ndarray, channels: Sequence[tuple[np.ndarray, bool]],
    missed: np.ndarray, own: Sequence[np.ndarray],
) -> Start | None:  # fmt: skip
    """A set that holds every x = A x + q + B w with |q| <= missed (n), or None where none is proved.

    w_j is what the parameters of channel j make of C x, and besides at most own_j (J) for each of its rows of signs.
    """
    if (found := _inverted(A)) is None:
        return None
    left, inverse = found
    X = np.column_stack([np.zeros(len(A)), inverse @ B])
    residual = exact(np.column_stack([np.zeros(len(A)), B])) - left @ X
    wider = np.column_stack([missed, np.zeros(B.shape)])
    residual = residual + Interval(-wider, wider)
    return _bounded(left, inverse, X, residual, C, np.zeros((len(C), X.shape[1])), lam, channels, own)


def _inverted(A: np.ndarray) -> tuple[Interval, np.ndarray] | None:
    """I - A, and what is about its inverse; None where it has none."""
    left = exact(np.eye(len(A))) - A
    try:
        return left, np.linalg.inv(left.mid)
    except np.linalg.LinAlgError:
        return None


def _bounded(
    left: Interval, inverse: np.ndarray, X: np.ndarray, residual: Interval, C: np.ndarray, J: np.ndarray, lam: np.ndarray,
    channels: Sequence[tuple[np.ndarray, bool]], beside: Sequence[np.ndarray],
) -> Start | None:  # fmt: skip
    """A set that holds every (X + E) (1, e, w), with left E = residual; the last columns of X are those of w, which is bounded by
    what the parameters make of C x + J (1, e, w) and by `beside` (J) of each channel.
    """
    if not np.isfinite(X).all() or (off := _missed(left, inverse, residual)) is None:
        return None
    x, known = exact(X) + Interval(-off, off), X.shape[1] - len(channels)
    z = exact(C) @ x + J
    own, through = [], []  # of each channel the rows of a + M W
    for (signs, summed), more in zip(channels, beside, strict=True):
        seen = np.column_stack([abs(exact(signs * lam) @ z).high, more])
        seen = seen.sum(axis=0, keepdims=True) if summed else seen
        own.append((seen[:, :known].sum(axis=1) + seen[:, -1]) * UP)
        through.append(seen[:, known:-1] * UP)
    W = _fixed(own, through)
    if W is None:
        return None
    size = np.append(np.ones(known - 1), W)
    return Start(X[:, 1:], size, (off[:, 0] + off[:, 1:] @ size) * UP + TINY)


def _missed(left: Interval, inverse: np.ndarray, residual: Interval) -> np.ndarray | None:
    """E >= |X - X~| entry by entry, of left X = right and left X~ = right - residual; None where none is proved.

    X - X~ = R residual + (I - R left) (X - X~), and a box E that this maps into itself holds it.
    """
    first = abs(exact(inverse) @ residual).high
    turned = abs(exact(np.eye(len(inverse))) - exact(inverse) @ left).high
    E = 2.0 * first + TINY
    for _ in range(REFINED):
        mapped = (first + turned @ E) * UP + 0.5 * TINY
        if not np.isfinite(mapped).all():
            return None
        if np.all(mapped <= E):
            return E
        E = 2.0 * mapped
    return None


def _fixed(own: Sequence[np.ndarray], through: Sequence[np.ndarray]) -> np.ndarray | None:
    """W (c) with W_j >= the largest of own_j + through_j W, own_j (J), through_j (J c); None where there is none.

    Row by row: the solution of the rows that are largest at the last one.
    """
    c = len(own)
    W, rows = np.zeros(c), None
    for _ in range(POLICIES):
        largest = [int((a + M @ W).argmax()) if len(a) else -1 for a, M in zip(own, through, strict=True)]
        if largest == rows:
            break
        rows = largest
        a = np.array([a[i] if len(a) else 0.0 for a, i in zip(own, rows, strict=True)])
        M = np.array([M[i] if len(M) else np.zeros(c) for M, i in zip(through, rows, strict=True)])
        if not (np.isfinite(M).all() and np.abs(np.linalg.eigvals(M)).max(initial=0.0) < 1.0):
            return None
        try:
            W = np.linalg.solve(np.eye(c) - M, a + TINY)  # TINY is seen through M too, and where a is 0 nothing hides it
        except np.linalg.LinAlgError:  # an eigenvalue of 1 but for rounding
            return None
    W = np.maximum(W, 0.0) * (1.0 + WIDER) + TINY
    again = np.array([((a + M @ W) * UP).max(initial=0.0) for a, M in zip(own, through, strict=True)]) + 0.5 * TINY
    return W if np.all(again <= W) else None
