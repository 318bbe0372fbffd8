"""The dual: a proved bound of what the adversary reaches at one (signal, instant, side).

The first multipliers are those for which the adversary's run is stationary. From them the lowest bound is sought (`search`), and
what was found is proved block by block (`problem`, `certificate`). Of a long run only a window up to the instant is looked at,
and what happened before it is left to the kernel.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from workbench.robustness.envelopes.adversary import Reached
from workbench.robustness.envelopes.certificate import Certificate
from workbench.robustness.envelopes.course import Course
from workbench.robustness.envelopes.kernel import Kernel
from workbench.robustness.envelopes.problem import Problem
from workbench.robustness.envelopes.search import searched

SOFTENED = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)  # of the size of z, added to |z| in the first multipliers
SMOOTHED = (2, 5, 10, 20, 50, 10**6)  # samples on both sides over which the slopes in the first multipliers are averaged
SPARED = 20  # samples at least that a window spares
FORGOTTEN = 1e-4  # share of what the adversary reached that a window may leave to the kernel's box
TRIED = 2  # first multipliers that are searched from, until one leads to a proof


def dual(course: Course, found: Reached, question: int = 0, outer: Kernel | None = None) -> Certificate | None:
    """A proved bound of the question that `found` answers from the other side, or None where none was found; see `certificate`.

    outer: the kernel of the course, if it is at hand. Far-off samples are then left to its box.
    """
    signal, instant = int(found.signal[question]), int(found.instant[question])
    side, delta = float(found.side[question]), found.delta[question]
    path = _along(course, signal, instant, side, delta, found.start[question])
    first = _first(path, instant, outer)
    for begin in (first, 0) if first > 0 else (0,):  # a window may forget what the first multipliers need
        problem = Problem(course, signal, instant, side, begin, outer)
        tried = [problem.started(M) for M in _first_multipliers(course, path, problem.k)]
        tried = sorted((attempt for attempt in tried if attempt is not None), key=lambda attempt: attempt.value)
        for start in tried[:TRIED]:
            proof = problem.certified(start, searched(problem, start))
            if proof is not None:
                return proof
    return None


class _Path(NamedTuple):
    """Along one sequence: z (N p), w (N c), and the slope of side v(T) in w, influence (N c)."""

    z: np.ndarray
    w: np.ndarray
    influence: np.ndarray


def _along(course: Course, signal: int, instant: int, side: float, delta: np.ndarray, x: np.ndarray) -> _Path:
    m, members, own = course.modes, course.members, course.channel.astype(int)
    z = np.zeros((instant + 1, course.f.shape[1]))
    w, influence = np.zeros((instant + 1, course.B.shape[2])), np.zeros((instant + 1, course.B.shape[2]))
    for k in range(instant + 1):
        i = m[k]
        z[k] = course.C[i] @ x + course.f[k]
        w[k] = (delta[k] * course.lam[i] * z[k]) @ members
        x = course.A[i] @ x + course.q[k] + course.B[i] @ w[k]
    p = np.zeros(len(course.start))
    for k in range(instant, -1, -1):
        i = m[k]
        influence[k] = p @ course.B[i] + (side * course.F[i, signal] if k == instant else 0.0)
        p = p @ course.A[i] + (influence[k][own] * course.lam[i] * delta[k]) @ course.C[i]
        if k == instant:
            p = p + side * course.E[i, signal]
    return _Path(z, w, influence)


def _first_multipliers(course: Course, path: _Path, k: np.ndarray) -> Iterator[np.ndarray]:
    """M_i = |p'b_j| lam_i / (2 |z_i|), for which the adversary's run is stationary.

    Where z_i or p'b_j pass zero these are extreme and R breaks down around them: |z_i| is lifted, |p'b_j| averaged.
    """
    z, own, lam = np.abs(path.z[k]), course.channel.astype(int), course.lam[course.modes[k]]
    size = np.sqrt((z**2).mean(axis=0))
    size = np.maximum(size, max(1e-9 * float(size.max(initial=0.0)), 1e-150))
    squares = np.concatenate([np.zeros((1, len(course.B[0, 0]))), np.cumsum(path.influence[k] ** 2, axis=0)])
    at = np.arange(len(k))
    for width in SMOOTHED:
        low, high = np.maximum(at - width, 0), np.minimum(at + width + 1, len(k))
        slope = np.sqrt(np.maximum((squares[high] - squares[low]) / (high - low)[:, None], 0.0))
        slope = np.maximum(slope, max(1e-9 * float(slope.max(initial=0.0)), 1e-150))
        for softened in SOFTENED:
            yield 0.5 * slope[:, own] * lam / (z + softened * size)


def _first(path: _Path, instant: int, outer: Kernel | None) -> int:
    """Where a window may begin: what happened before adds less than FORGOTTEN of what was reached."""
    if outer is None:
        return 0
    share = np.cumsum(np.abs(path.w * path.influence).sum(axis=1))
    first = int(np.searchsorted(share, FORGOTTEN * share[-1]))
    return first if first >= SPARED and np.isfinite(outer.state[first]).all() else 0
