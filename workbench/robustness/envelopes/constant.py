"""Guaranteed bounds of the runs whose parameters stand still: a power series in them, and the kernel of what is left.

With delta constant, d = x - x_nom is a power series, whose terms are runs of the loop in the middle of the boxes:

    d = sum over monomials a of degree 1 to m of delta^a D_a  +  R,        D_a(k+1) = A D_a + B W_a
    W_i = lam_i z_nom,i e_channel(i),    W_a = sum over i in a of lam_i (C_i D_(a - i)) e_channel(i)

R obeys the equations of d with sum over the monomials of degree m of delta^a (C D_a) for z_nom, so that the kernel bounds it, for
parameters that move as they like. It begins small, and what the kernel gives away by moving parameters it gives away of R only:

    |v - v_nom|  <=  sum over a of |E D_a + F W_a|  +  kernel of R

A run begins at the rest with the same delta, which is a power series like it. Where set-points before the run are known within an
interval only, their shares are of degree 1 as well and drive nothing but the start. Errors that no parameter explains are others
at every sample: they drive R. All that rounding takes from the terms is in the kernel of R too.
"""

from math import comb
from typing import NamedTuple

import numpy as np

from workbench.records import field, record
from workbench.robustness import rests
from workbench.robustness.envelopes.course import Course, explained
from workbench.robustness.envelopes.kernel import HUGE, Drive, Kernel, carried, channels_of, rounded_run, rounding, rows_of
from workbench.robustness.rests import TINY, Start

DEGREE = 3  # of the power series, at most
TERMS = 800  # of it, at most: beyond, its degree is lower


def constant_kernel(course: Course, outer: Kernel) -> Kernel:
    """The kernel of all runs whose explained parameters stand still, nowhere wider than `outer`, that of parameters that move.

    Parameters are shares of their boxes in all modes: they stand still where the boxes do.
    """
    series = _series(course)
    if outer.start is None or not series.degrees[-1]:
        return outer
    rows = rows_of(course)
    own, missed, unseen = rounded_run(course, outer.nominal, rows, ~explained(course))
    with np.errstate(over="ignore", invalid="ignore"):
        start, begun = _begun(course, series)
        run = _along(course, series, outer, begun, rows)
        rest = carried(course, outer.nominal, Drive(own + run.own, missed + run.missed, unseen + run.unseen, start))
        half, state = run.seen + rest.half, run.size + rest.state
    lost = ~(np.isfinite(half).all(axis=1) & (np.maximum.accumulate(run.size.max(axis=1)) <= HUGE))
    half[lost], state[lost] = np.inf, np.inf
    return Kernel(np.minimum(half, outer.half), np.minimum(state, outer.state), outer.gain, outer.nominal, outer.start)


class _Series(NamedTuple):
    """Its monomials, degree by degree: degrees (m + 1) are where each begins. Every product of one that is not of the last degree
    with a parameter is a triple (source, parameter, target). shares: of the set-points before the run, the last ones of degree 1.
    """

    degrees: np.ndarray
    source: np.ndarray
    parameter: np.ndarray
    target: np.ndarray
    parameters: np.ndarray
    shares: int

    @property
    def last(self) -> slice:
        return slice(int(self.degrees[-2]), int(self.degrees[-1]))


def _series(course: Course) -> _Series:
    own = np.flatnonzero(explained(course) & (course.lam > 0.0).any(axis=0)).tolist()
    p, shares = course.f.shape[1], course.before.Q.shape[1] if course.before else 0
    level = [(i,) for i in own] + [(p + h,) for h in range(shares)]
    most = next((m for m in range(DEGREE, 1, -1) if comb(len(level) + m, m) <= TERMS), 1)
    degrees, products = [0, len(level)], []
    for _ in range(most - 1 if own else 0):
        first, below = degrees[-1], degrees[-2]
        number: dict[tuple[int, ...], int] = {}
        for at, monomial in enumerate(level):
            for i in own:
                key = tuple(sorted((*monomial, i)))
                products.append((below + at, i, number.setdefault(key, first + len(number))))
        level = list(number)
        degrees.append(first + len(level))
    source, parameter, target = np.array(products, dtype=int).reshape(-1, 3).T
    return _Series(np.array(degrees), source, parameter, target, np.array(own, dtype=int), shares)


def _driven(course: Course, series: _Series, i: int, z: np.ndarray, D: np.ndarray) -> np.ndarray:
    """W (c a) of all monomials in a mode, of z (p) without deviations and of the terms D (n a)."""
    c, count = course.B.shape[2], int(series.degrees[-1])
    W, channel = np.zeros((c, count)), course.channel.astype(int)
    q = series.parameters
    W[channel[q], np.arange(len(q))] = course.lam[i, q] * z[q]
    seen = course.lam[i][:, None] * (course.C[i] @ D)
    at = channel[series.parameter] * count + series.target
    return W + np.bincount(at, seen[series.parameter, series.source], c * count).reshape(c, count)


def _begun(course: Course, series: _Series) -> tuple[Start | None, np.ndarray]:
    """In which set R begins, None where none is proved, and the terms at the start, (n a)."""
    n, count, rest = len(course.start), int(series.degrees[-1]), course.before
    D = np.zeros((n, count))
    if rest is None:
        return rests.known(n), D
    i, first = int(course.modes[0]), len(series.parameters)
    A, B, C, lam, channel = course.A[i], course.B[i], course.C[i], course.lam[i], course.channel.astype(int)
    try:
        X, G = np.split(np.linalg.solve(np.eye(n) - A, np.hstack([rest.Q, B])), [series.shares], axis=1)
    except np.linalg.LinAlgError:
        return None, D
    shared = slice(first, first + series.shares)
    D[:, shared] = X
    z, Z = C @ course.start + rest.f, np.zeros((len(C), count))
    Z[:, shared] = rest.J
    through = np.zeros((len(B[0]), count))  # by the set-points: what the regressors see of them at once
    np.add.at(through, (channel[series.parameter], series.target), (lam[:, None] * Z)[series.parameter, series.source])
    for low, high in zip(series.degrees[:-1], series.degrees[1:], strict=True):
        W = _driven(course, series, i, z, D) + through
        D[:, low:high] += G @ W[:, low:high]
    W, unit = _driven(course, series, i, z, D) + through, rounding(n + len(C) + len(B[0]))
    up = 1.0 + rounding(count)
    drive = np.zeros((n, count))
    drive[:, shared] = rest.Q
    size, driving = np.abs(D).sum(axis=1), np.abs(W).sum(axis=1)
    off = np.abs(A @ D + B @ W + drive - D).sum(axis=1) + np.abs(A @ course.start + rest.q - course.start)
    off = off + unit * (np.abs(A) @ (size + np.abs(course.start)) + np.abs(B) @ driving + size + np.abs(course.start))
    off = (off + unit * (np.abs(rest.q) + np.abs(rest.Q).sum(axis=1))) * up + TINY
    own, still = [], ~explained(course)
    last = Z[:, series.last] + C @ D[:, series.last]
    felt = lam * (np.abs(C) @ (size + np.abs(course.start)) + np.abs(rest.f) + np.abs(rest.J).sum(axis=1))
    for signs, _ in channels_of(course):
        left = np.abs((signs * lam) @ last).sum(axis=1) + np.abs(signs @ (lam * z * still))
        left = left + np.abs((signs * lam * still) @ rest.J).sum(axis=1)
        own.append((left + unit * (np.abs(signs) @ felt)) * up + TINY)
    return rests.remaining(A, B, C, lam, channels_of(course), off, own), D


@record
class _Run:
    """Of all terms along the run: |E D + F W| (N s) and |D| (N n), what the last degree drives (N J), what rounding takes."""

    seen: np.ndarray = field("N s")
    size: np.ndarray = field("N n")
    own: np.ndarray = field("N J")
    missed: np.ndarray = field("N n")
    unseen: np.ndarray = field("N s")


def _along(course: Course, series: _Series, outer: Kernel, D: np.ndarray, rows: np.ndarray) -> _Run:
    (N, n), s, c, z = course.q.shape, len(course.signals), course.B.shape[2], outer.nominal.z
    unit, up = rounding(n + c + course.f.shape[1]), 1.0 + rounding(D.shape[1])
    seen, size, own = np.empty((N, s)), np.empty((N, n)), np.empty((N, len(rows)))
    missed, unseen = np.empty((N, n)), np.empty((N, s))
    for k, i in enumerate(course.modes):
        W = _driven(course, series, i, z[k], D)
        seen[k] = np.abs(course.E[i] @ D + course.F[i] @ W).sum(axis=1) * up
        size[k], driving = np.abs(D).sum(axis=1) * up, np.abs(W).sum(axis=1) * up
        through = rows * course.lam[i]
        left = np.abs((through @ course.C[i]) @ D[:, series.last]).sum(axis=1) * up
        own[k] = (left + unit * (np.abs(through) @ (np.abs(course.C[i]) @ size[k]))) * up
        missed[k] = unit * (np.abs(course.A[i]) @ size[k] + np.abs(course.B[i]) @ driving) * up
        unseen[k] = unit * (np.abs(course.E[i]) @ size[k] + np.abs(course.F[i]) @ driving) * up
        D = course.A[i] @ D + course.B[i] @ W
    return _Run(seen, size, own, missed, unseen)
