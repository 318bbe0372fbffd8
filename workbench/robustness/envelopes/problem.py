"""The bound of one (signal, instant, side) as a function of its multipliers, its slope, and the certificate made of them.

The smallest V of a certificate is a Riccati recursion with R = diag(mu) - B'P B, as long as R > 0. It is convex in M, with slope
z_i^2 - (mu_j w_j lam_i / M_i)^2 along the run that attains it. The letters are those of `certificate`.
"""

import itertools
from typing import NamedTuple

import numpy as np

from workbench.intervals.propagation import ROUNDING
from workbench.robustness import rests
from workbench.robustness.envelopes.certificate import Certificate
from workbench.robustness.envelopes.course import Course, nominal
from workbench.robustness.envelopes.kernel import Kernel, window_start
from workbench.robustness.envelopes.riccati import attaining_run, riccati

GUARD = 0.01  # R >= GUARD diag(mu): beyond, rounding decides
PAID = 1e-6  # of the bound, spent on the corners of blocks and on the last one
SLACK = (1e-8, 1e-6, 1e-4, 1e-10)  # of the bound, spent on P, which may cost more: a later P is carried into the earlier ones
RAISED = (1e-8, 1e-7, 1e-10)  # by how much more P is raised in every block, relative
BLENDED = (0.0, 1e-3, 1e-2, 0.1)  # share of the first multipliers, which are far from where R breaks down, in the proved ones


class Attempt(NamedTuple):
    """Multipliers log M (K p) and log nu (h), the bound with them, its slope and a guess of its curvature."""

    x: np.ndarray
    value: float
    slope: np.ndarray
    curvature: np.ndarray


class Problem:
    """The bound of one question as a function of its multipliers, and the proof of it."""

    def __init__(self, course: Course, signal: int, instant: int, side: float, first: int, outer: Kernel | None):
        self.course, self.outer = course, outer
        self.signal, self.instant, self.side, self.first = signal, instant, side, first
        self.k = np.arange(first, instant + 1)
        run, m = nominal(course) if outer is None else outer.nominal, course.modes[self.k]
        self.x, self.z, self.base = run.x[self.k], run.z[self.k].copy(), side * float(run.v[instant, signal])
        self.lam, self.own = course.lam[m], course.channel.astype(int)
        live = (self.lam > 0.0) @ course.members > 0.0
        self.used, self.live = self.lam > 0.0, live
        self.mode = m.astype(np.int64)
        self.A, self.B, self.C = (np.array(M, order="C") for M in (course.A, course.B, course.C))
        dead = (course.lam > 0.0) @ course.members == 0.0  # (M c)
        self.B[np.broadcast_to(dead[:, None, :], self.B.shape)] = 0.0
        self.c = 0.5 * side * course.E[m[-1], signal]
        self.f = np.where(live[-1], 0.5 * side * course.F[m[-1], signal], 0.0)
        begun = window_start(course, first, outer)
        self.begins, start = begun is not None, begun or rests.known(len(self.c))
        self.T, length = start.spread, np.linalg.norm(start.spread, axis=0)
        least = 1e-12 * float((length * start.size).max(initial=0.0))
        self.box = np.maximum(start.size, least / np.where(length > 0.0, length, 1.0))
        K, n, c = len(self.k), len(self.c), self.B.shape[2]
        self.P, self.q, self.v = np.zeros((K + 1, n, n)), np.zeros((K + 1, n)), np.zeros(K + 1)
        self.G, self.r = np.zeros((K, c, n)), np.zeros((K, c))
        self.d, self.w = np.zeros((K, n)), np.zeros((K, c))

    def mu(self, M: np.ndarray) -> np.ndarray:
        """1 / (sum_i lam_i^2 / M_i) of every channel (K c), 1 where there is nothing."""
        ratio = np.where(self.used, self.lam**2 / np.where(self.used, M, 1.0), 0.0) @ self.course.members
        return np.where(self.live, 1.0 / np.where(self.live, ratio, 1.0), 1.0)

    def backward(self, M: np.ndarray, mu: np.ndarray, floor: bool = False, slack: np.ndarray | None = None) -> bool:
        """V of every sample into P, q, v; False where R < GUARD diag(mu). floor: M and mu are raised until it is not."""
        extra = np.zeros(len(self.c) + 2) if slack is None else slack
        loop, into = (self.A, self.B, self.C, self.mode), (self.P, self.q, self.v, self.G, self.r)
        return bool(riccati(loop, (M, mu), self.z, (self.c, self.f), extra, GUARD, floor, into))

    def started(self, M: np.ndarray) -> Attempt | None:
        """The first multipliers, raised where R would not be positive definite."""
        M = np.where(self.used, M, 0.0)
        mu = self.mu(M)
        if not self.backward(M, mu, floor=True) or not np.isfinite(self.P).all():
            return None
        # the smallest of nu u^2 + q'T (diag(nu) - T'P T)^-1 T'q, one direction at a time, and above T'P T
        nu = np.abs(self.q[0] @ self.T) / self.box + 2.0 * np.abs(self.T.T @ self.P[0] @ self.T).sum(axis=1)
        return self.at(np.log(np.maximum(np.concatenate([M.ravel(), nu]), 1e-300)))

    def at(self, x: np.ndarray) -> Attempt | None:
        """The bound of multipliers exp(x); None where there is none."""
        with np.errstate(over="ignore", under="ignore", invalid="ignore", divide="ignore"):
            M, nu = self.multipliers(x)
            mu = self.mu(M)
            found = self.bound(nu) if self.backward(M, mu) else None
            if found is None:
                return None
            value, u = found
            attaining_run(self.A, self.B, self.mode, self.G, self.r, self.T @ u, self.d, self.w)
            z = self.z + np.einsum("kpn,kn->kp", self.C[self.mode], self.d)
            share = np.where(self.used, (mu * self.w)[:, self.own] * self.lam / np.where(self.used, M, 1.0), 0.0)
            z2, s2, b2, u2 = M * z**2, M * share**2, nu * self.box**2, nu * u**2
            slope, curvature = np.append((z2 - s2).ravel(), b2 - u2), np.append((z2 + s2).ravel(), b2 + u2)
            return Attempt(x, value, slope, curvature) if np.isfinite(curvature).all() else None

    def multipliers(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """M (K p) and nu (h) of their logarithms."""
        K, p = self.z.shape
        M = np.where(self.used, np.exp(x[: K * p]).reshape(K, p), 0.0)
        return M, np.exp(x[K * p :])

    def blended(self, one: Attempt, other: Attempt, share: float) -> np.ndarray:
        """Logarithms of the multipliers between two, in which the bound is convex."""
        M, nu = ((1.0 - share) * a + share * b for a, b in zip(self.multipliers(one.x), self.multipliers(other.x), strict=True))
        return np.log(np.maximum(np.append(M.ravel(), nu), 1e-300))

    def bound(self, nu: np.ndarray) -> tuple[float, np.ndarray] | None:
        """The largest V of the starts T u, and u; None where it has no bound."""
        value, P, q = float(self.v[0]), self.T.T @ self.P[0] @ self.T, self.q[0] @ self.T
        if not (self.begins and np.isfinite(self.P[0]).all() and np.isfinite(self.q[0]).all() and np.isfinite(value)):
            return None
        if not len(nu):
            return value, q
        S, scale = np.diag(nu) - P, 1.0 / np.sqrt(nu)
        if not (np.isfinite(scale).all() and np.linalg.eigvalsh(S * np.outer(scale, scale))[0] > GUARD):
            return None
        u = np.linalg.solve(S, q)
        return value + float(nu @ self.box**2 + q @ u), u

    def certified(self, first: Attempt, best: Attempt) -> Certificate | None:
        """The proof: V with some slack in every block; where that fails, further inside, for V is convex in M."""
        if self.at(best.x) is None:
            return None
        K, n = len(self.k), len(self.c)
        # a share of P, and where P is small of what it would weigh along the run that attains the bound
        size = np.abs(self.d).max(axis=0)
        size = np.maximum(size, max(1e-6 * float(size.max()), 1e-150))
        for blend, raised, share in itertools.product(BLENDED, RAISED, SLACK):
            M, nu = self.multipliers(self.blended(best, first, blend))
            own, paid = (part * max(best.value, 1e-300) / K for part in (share, PAID))
            with np.errstate(over="ignore", under="ignore", invalid="ignore", divide="ignore"):
                found = (
                    self.bound(nu)
                    if self.backward(M, self.mu(M), slack=np.concatenate([own / (n * size**2), [paid, raised]]))
                    else None
                )
            if found is None:
                continue
            rounding = ROUNDING * n * (abs(self.base) + float(np.abs(self.x[-1]) @ np.abs(self.c)))
            bound = self.base + found[0] + PAID * abs(found[0]) + rounding
            proof = Certificate(
                self.course.signals[self.signal], self.instant, int(self.side), self.first, bound, M,
                0.5 * (self.P + self.P.swapaxes(1, 2)), self.q.copy(), self.v.copy(), self.x, self.box, nu,
            )  # fmt: skip
            if proof.holds(self.course, self.outer):
                return proof
        return None
