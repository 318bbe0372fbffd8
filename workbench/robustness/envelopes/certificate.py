"""The certificate: what proves a bound of one (signal, instant, side), and the check that it does.

By Cauchy w_j^2 sum_i lam_i^2 / M_i <= sum_i M_i z_i^2 for every M_i > 0. With mu_j = 1 / (sum_i lam_i^2 / M_i), for any M(k) and
functions V_k(d) = d'P d + 2 q'd + c for which

    V_k(d) >= sum_i M_i z_i^2 - sum_j mu_j w_j^2 + V_k+1(A d + B w)     for all d and w       (and + E d + F w at the instant T)

side (v(T) - v_nom(T)) <= V_0(0). Each inequality is one block of size n + channels + 1 that has to be positive definite, and
every block is proved for itself in outward-rounded arithmetic: nothing accumulates, and neither the optimiser nor the recursion
is trusted. d(0) is T u, which costs one block more; what happened before a window is the box |d_i| <= e_i that the kernel knows.
The equations are those of `course`.
"""

import numpy as np

from workbench.intervals.arithmetic import Interval, exact, positive_definite
from workbench.records import field, record
from workbench.robustness.envelopes.blocks import bordered, columns, diagonal, padded, rows, symmetric, transposed
from workbench.robustness.envelopes.course import Course
from workbench.robustness.envelopes.kernel import Kernel, kernel, window_start


@record
class Certificate:
    """side v(instant) <= bound, proved by M (K p) and V_k(d) = d'P d + 2 q'd + c, K + 1 each, from sample `first` to `instant`.

    x (K n): the run that d counts from, of which nothing is assumed. box (h): the set in which it begins is T u, |u| <= box, and
    nu (h) >= 0 are its multipliers: the starts of the course, or where `first` is not 0 what the kernel knows of x(first), T = I.
    """

    signal: str
    instant: int
    side: int
    first: int
    bound: float
    M: np.ndarray = field("K p", low=0.0)
    P: np.ndarray = field("K+1 n n")
    q: np.ndarray = field("K+1 n")
    c: np.ndarray = field("K+1")
    x: np.ndarray = field("K n")
    box: np.ndarray = field("h", low=0.0)
    nu: np.ndarray = field("h", low=0.0)

    def holds(self, course: Course, outer: Kernel | None = None) -> bool:
        """Whether every block is positive definite and the bound is no less than V says, in outward-rounded arithmetic.

        outer: the kernel of the course, which knows where it begins, and what a window rests on; computed where it is not given.
        """
        s = course.number(self.signal)
        if not self._fits(course):
            return False
        blocks = self._steps(course, s)
        if blocks is None or not positive_definite(symmetric(blocks)).all():
            return False
        block = self._beginning(course, s, outer)
        return block is not None and bool(positive_definite(symmetric(block)))

    def _fits(self, course: Course) -> bool:
        """Whether it is of a course of this size, finite, with symmetric P, and with nothing to gain after the instant."""
        K, n, p = len(self.M), len(course.start), course.f.shape[1]
        k = np.arange(self.first, self.instant + 1)
        if not 0 <= self.first <= self.instant < len(course) or len(k) != K or self.side not in (1, -1):
            return False
        if self.M.shape != (K, p) or self.P.shape != (K + 1, n, n) or not np.array_equal(self.P, self.P.swapaxes(1, 2)):
            return False
        if self.x.shape != (K, n) or self.P[-1].any() or self.q[-1].any() or self.c[-1] < 0.0:
            return False
        return all(np.isfinite(each).all() for each in (self.M, self.P, self.q, self.c, self.x, self.box, self.nu, self.bound))

    def _steps(self, course: Course, s: int) -> Interval | None:
        """The blocks of the inequalities of V_k and V_k+1, (K n+c+1 n+c+1); None where a mu may not be positive."""
        K, n, p = len(self.M), len(course.start), course.f.shape[1]
        k = np.arange(self.first, self.instant + 1)
        mu, live = _weights(course, k, self.M)
        if not (mu.low > 0.0).all():
            return None
        m = course.modes[k]
        A, C, lost = course.A[m], course.C[m], np.zeros((K, 1, course.B.shape[2]))
        B, F = course.B[m] * live[:, None, :], course.F[m, s] * live
        # the step from the run that d counts from: zero but for rounding
        step = (exact(A[:-1]) @ self.x[:-1, :, None])[..., 0] + course.q[k[:-1]] - self.x[1:]
        last = np.zeros((1, n))  # V of the sample after the last one is c alone
        away = Interval(np.concatenate([step.low, last]), np.concatenate([step.high, last]))
        z = (exact(C) @ self.x[:, :, None])[..., 0] + course.f[k]
        one = np.ones((K, 1, 1))
        H = columns(
            [exact(np.concatenate([A, np.zeros((K, 1, n))], axis=1)), exact(np.concatenate([B, lost], axis=1))],
            rows([away[..., None], exact(one)]),
        )
        Z = columns([exact(C), exact(np.zeros((K, p, B.shape[2])))], z[..., None])
        blocks = padded(bordered(self.P, self.q, self.c)[:-1], B.shape[2]) - transposed(H) @ (
            exact(bordered(self.P, self.q, self.c)[1:]) @ H
        )
        blocks = blocks - transposed(Z) @ (exact(self.M)[..., None] * Z) + diagonal(mu, n)
        linear = np.zeros((1, *blocks.shape[1:]))
        linear[0, :n, -1] = linear[0, -1, :n] = 0.5 * self.side * course.E[m[-1], s]
        linear[0, n:-1, -1] = linear[0, -1, n:-1] = 0.5 * self.side * F[-1]
        return rows([blocks[:-1], blocks[-1:] - linear], axis=0)

    def _beginning(self, course: Course, s: int, outer: Kernel | None) -> Interval | None:
        """The block of V_0 over the set in which it begins; None where the box does not hold that set."""
        last = course.E[course.modes[self.instant], s]
        base = (exact(last[None]) @ self.x[-1][:, None])[0, 0] + float(course.g[self.instant, s])
        room = exact(self.bound) - base * float(self.side)
        outer = kernel(course) if outer is None and self.first > 0 else outer
        start = window_start(course, self.first, outer)
        away = abs(exact(course.start if self.first == 0 or outer is None else outer.nominal.x[self.first]) - self.x[0])
        if start is None or self.box.shape != start.size.shape or not np.all(self.box >= start.size):
            return None
        # V(T u + r) <= u'T'P T u + 2 q'T u + c + what |r| <= off adds, and that is no more than nu'box^2 - u'diag(nu) u leaves
        P, q, T, off = exact(self.P[0]), exact(self.q[0]), exact(start.spread), away + start.slack
        turned = transposed(T) @ P
        felt = abs(P) @ ((abs(T) @ self.box[:, None])[:, 0] * 2.0 + off)[:, None]
        added = ((felt[:, 0] + abs(q) * 2.0) * off).sum()
        corner = room - float(self.c[0]) - (exact(self.nu) * (exact(self.box) * self.box)).sum() - added
        side = -(transposed(T) @ q[:, None])
        top = exact(np.diag(self.nu)) - turned @ T
        return rows([columns([top], side), columns([transposed(side)], corner[None, None])], axis=0)


def _weights(course: Course, k: np.ndarray, M: np.ndarray) -> tuple[Interval, np.ndarray]:
    """mu (K c), no more than 1 / (sum_i lam_i^2 / M_i) where its low end is taken; live (K c): channels with a parameter."""
    lam = course.lam[course.modes[k]]
    used = lam > 0.0
    lost = (used & (M == 0.0)) @ course.members > 0.0
    ratio = (exact(lam) * lam) / np.where(M > 0.0, M, 1.0)
    total = (ratio[..., None] * course.members).sum(axis=1)
    live = used @ course.members > 0.0
    filled = Interval(np.where(live, total.low, 1.0), np.where(live, total.high, 1.0))
    low = np.where(lost | (filled.low <= 0.0), 0.0, (1.0 / Interval(np.maximum(filled.low, 1e-300), filled.high)).low)
    return exact(low), live.astype(float)
