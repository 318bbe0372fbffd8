"""Stability while the schedule moves: x'P(rho) x falls at every sample for |rho+ - rho| <= rate and every parameter in the boxes.

P(rho) is linear between nodes, A(rho) and the columns b lam are quadratic there (gains times a model, each linear). In a cell let
l run from 0 to 1, and let M = [A B], B = kappa b_j lam_i in column i. With a matrix W for each cell and multipliers D_i >= 0,

    f(l) = [P(l) - C'D C, 0; 0, D] - M(l)'(P(l) + W) M(l) > 0   and   P(rho+) <= P(rho) + W wherever the rate lets rho+ lie

are enough. f is a polynomial of degree 5 and lies in the hull of its Bernstein coefficients: six blocks, each with its own D,
say so for every l. They follow the curve, and do not set every A of a cell against every P of it, so that what a cell costs falls
with the square of its width. On its way from a cell the schedule crosses that cell and those within reach, by `rate` in all, so

    W >= +- rate (P_1 - P_0) / width,   W >= rate (slope of P in a cell above),   W >= -rate (slope of P in a cell below)

A common P for all of the schedule is one cell with P equal at both ends.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from math import comb
from typing import Any

import numpy as np

from workbench.errors import InputError
from workbench.intervals.arithmetic import Interval, exact, positive_definite
from workbench.records import field, record
from workbench.robustness.semidefinite import Block, maximise, symmetric
from workbench.robustness.uncertain import UncertainLoop

TRIED = (0.11, 0.25, 0.68, 0.87)  # of a cell, where it is tried whether a loop is quadratic
QUADRATIC = 1e-9  # by which a loop may differ from the quadratic through three of its values, relative to its size
DEGREE = 5  # of f: one of P, two of each M
FIRST = 1.1  # ratio of `beyond` to the kappa that a search begins with
STEP = 1.05  # ratio of the bounds at which a search ends
SOLVED = 8  # programs that a search solves at most
ACCURACY = 1e-6  # of the program: what it ends with is asked how far it reaches
INSIDE = 1e-6  # by which kappa stays below what a P reaches in floating point, so that it can be proved


@record
class ScheduledLoop:
    """Loops at nodes (K) of the schedule and in the middle of every cell (2 K - 1), in order; C is the same everywhere.

    A (2 K - 1, n, n); columns (2 K - 1, n, p) are b_j lam_i of every parameter.
    """

    nodes: np.ndarray = field("K")
    A: np.ndarray = field("M n n")
    columns: np.ndarray = field("M n p")
    C: np.ndarray = field("p n")

    @property
    def alive(self) -> np.ndarray:
        """Whether each parameter (p) changes anything, anywhere."""
        return np.any(self.columns, axis=(0, 1)) & np.any(self.C, axis=1)

    def only(self, chosen: np.ndarray) -> "ScheduledLoop":
        """The loop with the chosen (p) of its parameters uncertain and the others in the middle of their boxes."""
        return ScheduledLoop(self.nodes, self.A, self.columns[..., chosen], self.C[chosen])

    def at(self, rho: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A (.., n, n) and columns (.., n, p) of the quadratics at schedule values (..), which must lie within the nodes."""
        cell = np.clip(np.searchsorted(self.nodes, rho, side="right") - 1, 0, len(self.nodes) - 2)
        share = (np.asarray(rho) - self.nodes[cell]) / np.diff(self.nodes)[cell]
        weight = np.stack([(1.0 - share) ** 2, 2.0 * share * (1.0 - share), share**2], axis=-1)[..., None, None]
        A, columns = ((np.stack(hull(M), axis=1)[cell] * weight).sum(axis=-3) for M in (self.A, self.columns))
        return A, columns


def scheduled_loop(
    at: Callable[[float], UncertainLoop], nodes: Sequence[float] | np.ndarray, kinks: Sequence[float] | np.ndarray = ()
) -> ScheduledLoop:
    """The loops at(rho) between the nodes, in coordinates that suit the middle one.

    kinks: schedule values at which the law's gain table or the model has a point of its own; each must be a node, for between
    two nodes the loop has to be quadratic. That is the caller's word: here it is tried at some points, which proves nothing.
    Raises InputError where a kink is no node, a loop is seen not to be quadratic, or z is another function of the state.
    """
    rho = np.unique(np.asarray(nodes, dtype=float))
    for kink in kinks:
        if rho[0] < kink < rho[-1] and np.abs(rho - kink).min() > QUADRATIC * np.ptp(rho):
            raise InputError(f"the loop has a kink at {kink:g}, between two nodes", file="scheduled_loop", mend="make it a node")
    if len(rho) < 2:
        raise InputError(f"{len(rho)} nodes", file="scheduled_loop", mend="a schedule that moves has two or more")
    grid = np.sort(np.concatenate([rho, 0.5 * (rho[1:] + rho[:-1])]))
    own = at(float(grid[len(rho) - 1])).balance()
    loops = [at(float(value)).moved(own) for value in grid]
    A, columns, C = np.array([loop.A for loop in loops]), np.array([loop.columns for loop in loops]), loops[0].C
    for value, loop in zip(grid, loops, strict=True):
        if (np.abs(loop.C - C) > QUADRATIC * np.abs(C).max(axis=1, keepdims=True)).any():
            raise InputError(f"z is another function of the state at {value:g}", file="scheduled_loop")
    found = ScheduledLoop(rho, A, columns, C)
    sizes = np.abs(A).max(), np.abs(columns).max(axis=(0, 1))  # every parameter has units of its own
    for cell, share in itertools.product(range(len(rho) - 1), TRIED):
        value = float(rho[cell] + share * (rho[cell + 1] - rho[cell]))
        between = at(value).moved(own)
        for quadratic, true, size in zip(found.at(np.array(value)), (between.A, between.columns), sizes, strict=True):
            if (np.abs(quadratic - true) > QUADRATIC * size).any():
                raise InputError(
                    f"the loop is not quadratic between {rho[cell]:g} and {rho[cell + 1]:g}",
                    file="scheduled_loop",
                    mend="put a node where a gain table has one, and end the schedule where another mode begins",
                )
    return found


@record
class ScheduledCertificate:
    """P (K n n) at the nodes, W (cells n n) and D (cells 6 p), for kappa times the boxes and `rate` a sample; see the module."""

    kappa: float
    rate: float = field("", low=0.0)
    P: np.ndarray = field("K n n")
    W: np.ndarray = field("cells n n")
    D: np.ndarray = field("cells 6 p", low=0.0)

    def holds(self, loop: ScheduledLoop) -> bool:
        """Whether that is proved in outward-rounded arithmetic, for the quadratics through the loop's numbers.

        Parameters that change nothing need no multipliers.
        """
        K, n, p, alive = len(loop.nodes), loop.A.shape[1], len(loop.C), loop.alive
        if self.P.shape != (K, n, n) or self.W.shape != (K - 1, n, n) or self.D.shape != (K - 1, DEGREE + 1, p):
            return False
        if any(not np.array_equal(M, M.swapaxes(1, 2)) for M in (self.P, self.W)) or not positive_definite(self.P).all():
            return False
        loop, D = loop.only(alive), self.D[..., alive]
        P, W = exact(self.P), exact(self.W)
        if self.rate > 0.0:
            slope = (P[1:] - P[:-1]) / (exact(loop.nodes[1:]) - loop.nodes[:-1])[:, None, None] * self.rate
            cell, crossed, sign = moves(loop.nodes, self.rate)
            if not positive_definite(W[cell] - slope[crossed] * sign[:, None, None]).all():
                return False
        elif self.W.any():
            return False
        M = [_beside(A, B * self.kappa) for A, B in zip(hull(exact(loop.A)), hull(exact(loop.columns)), strict=True)]
        ends = P[:-1], P[1:]
        for k in range(DEGREE + 1):
            first = (ends[0] * (DEGREE - k) + ends[1] * k) / DEGREE - loop.C.T @ (exact(D[:, k])[:, :, None] * loop.C)
            block = _cornered(first, D[:, k])
            for end, i, j, share in products(k):
                block = block - _transposed(M[i]) @ ((ends[end] + W) @ M[j]) * share.numerator / share.denominator
            if not positive_definite(block).all():
                return False
        return True


def certificate(loop: ScheduledLoop, kappa: float, rate: float) -> ScheduledCertificate | None:
    """A certificate for kappa times the boxes or more, proved; or none where it was not found."""
    found = _reaching(loop, kappa, rate)
    return found if found is not None and found.kappa >= kappa and found.holds(loop) else None


def largest(loop: ScheduledLoop, rate: float, beyond: float, step: float = STEP) -> ScheduledCertificate:
    """The certificate of the largest kappa below `beyond`, within the ratio `step` of what the program is found to allow.

    A P that fails for the kappa it was made for still holds for a smaller one: a handful of programs is enough.
    """
    high, kappa, best = beyond, beyond / FIRST, None
    for _ in range(SOLVED):
        found = _reaching(loop, kappa, rate)
        if found is None or found.kappa < kappa:
            high = kappa
        if found is not None and (best is None or found.kappa > best.kappa) and found.holds(loop):
            best = found
        if best is not None and high / best.kappa <= step:
            break
        kappa = 0.5 * high if best is None else float(np.sqrt(high * best.kappa))
    if best is None:
        raise InputError(
            f"no certificate for a schedule that moves by {rate:g} a sample", file="largest", mend="more nodes, or a lower rate"
        )
    return best


@record
class _Layout:
    """The variables of the program: P of every node, W of every cell, D of every cell and block, and t, which is the last.

    E (m n n): basis of P and W. K nodes, p parameters; W, D, t: where these begin.
    """

    E: np.ndarray = field("m n n")
    K: int
    p: int
    W: int
    D: int
    t: int

    @classmethod
    def of(cls, n: int, K: int, p: int, moving: bool) -> "_Layout":
        E = symmetric(n)
        D = (K + (K - 1) * moving) * len(E)
        return cls(E, K, p, K * len(E), D, D + (K - 1) * (DEGREE + 1) * p)

    def matrices(self, x: np.ndarray, first: int, count: int) -> np.ndarray:
        """(count, n, n) from the variables that begin at `first`."""
        return np.tensordot(x[first : first + count * len(self.E)].reshape(count, len(self.E)), self.E, 1)

    def multipliers(self, x: np.ndarray) -> np.ndarray:
        """D (K - 1, DEGREE + 1, p)."""
        return x[self.D : self.t].reshape(self.K - 1, DEGREE + 1, self.p)


def _reaching(loop: ScheduledLoop, kappa: float, rate: float) -> ScheduledCertificate | None:
    """P, W and D from the program for kappa, with the largest kappa that they reach in floating point; or none.

    The blocks are to be >= t diag(1, 0), t as large as can be; trace P = n in the middle. With D = kappa^2 E a block is

        [R - kappa^2 C'E C, -S; -S', E - T],   so that kappa^2 C'E C < R - S (E - T)^-1 S' says how far it reaches.
    """
    alive = loop.alive
    loop = loop.only(alive)
    K, n, p = len(loop.nodes), loop.A.shape[1], len(loop.C)
    width = np.diff(loop.nodes)
    if not rate >= 0.0:
        raise InputError(f"rate {rate:g} a sample", file="certificate", mend="0 or more, in units of the schedule")
    size = np.linalg.norm(loop.C, axis=1)  # z of size 1: multipliers of one order
    C = loop.C / size[:, None]
    M = np.concatenate([np.stack(hull(part), axis=1) for part in (loop.A, kappa * loop.columns * size)], axis=3)
    layout = _Layout.of(n, K, p, rate > 0.0)
    blocks = [Block(np.ones((1, 1)), -np.ones((1, 1, 1)), np.array([layout.t]))]  # t <= 1
    blocks += [*_blocks_of_cells(layout, M, C, rate / width), *_blocks_of_moves(layout, loop.nodes, rate)]
    m, trace = len(layout.E), np.zeros(layout.t + 1)
    trace[(K // 2) * m + np.arange(m)] = np.trace(layout.E, axis1=1, axis2=2)
    x = maximise(np.eye(layout.t + 1)[-1], blocks, (trace[None], np.array([float(n)])), ACCURACY)
    if x is None:
        return None
    P = layout.matrices(x, 0, K)
    W = layout.matrices(x, layout.W, K - 1) * (rate / width)[:, None, None] if rate > 0.0 else np.zeros((K - 1, n, n))
    D = np.maximum(layout.multipliers(x), 0.0) / kappa**2
    M[..., n:] /= kappa
    reached = _reached(M, C, P, W, D)
    if reached is None:
        return None
    reached *= 1.0 - INSIDE
    return ScheduledCertificate(reached, rate, P, W, reached**2 * D / size**2 @ np.eye(len(alive))[alive])


def _blocks_of_cells(layout: _Layout, M: np.ndarray, C: np.ndarray, speed: np.ndarray) -> Iterator[Block]:
    """For every cell the coefficients of the Lyapunov inequality in it; speed (K - 1): cells that are crossed a sample."""
    p, n = C.shape
    E, m, of_D = layout.E, len(layout.E), np.arange(p)
    of_C, of_t = np.zeros((p, n + p, n + p)), np.zeros((1, n + p, n + p))
    of_C[:, :n, :n], of_C[of_D, n + of_D, n + of_D] = -np.einsum("ia,ib->iab", C, C), 1.0
    of_t[0, :n, :n] = -np.eye(n)
    E_then = np.zeros((m, n + p, n + p))
    E_then[:, :n, :n] = E
    for cell in range(layout.K - 1):
        own, step = cell * m + np.arange(m), layout.W + cell * m + np.arange(m)
        for k in range(DEGREE + 1):
            after = np.zeros((2, m, n + p, n + p))
            for end, i, j, share in products(k):
                after[end] += float(share) * (M[cell, i].T @ E @ M[cell, j])
            share = k / DEGREE
            F = [(1.0 - share) * E_then - after[0], share * E_then - after[1], of_C, of_t]
            at = [own, own + m, layout.D + (cell * (DEGREE + 1) + k) * p + of_D, [layout.t]]
            if speed[cell] > 0.0:
                F.append(-speed[cell] * after.sum(axis=0))
                at.append(step)
            yield Block(np.zeros((n + p, n + p)), np.concatenate(F), np.concatenate(at))


def _blocks_of_moves(layout: _Layout, nodes: np.ndarray, rate: float) -> Iterator[Block]:
    """For every way to move from cell to cell: W bounds what P changes along it."""
    if not rate > 0.0:
        return
    E, m, width = layout.E, len(layout.E), np.diff(nodes)
    entries = np.arange(m)
    for cell, by, sign in zip(*moves(nodes, rate), strict=True):
        along = sign * width[cell] / width[by]  # W of the program is width / rate times W, and of the size of P
        F = [E, -along * E, along * E, -np.eye(E.shape[1])[None]]
        at = [layout.W + cell * m + entries, (by + 1) * m + entries, by * m + entries, [layout.t]]
        yield Block(np.zeros(E.shape[1:]), np.concatenate(F), np.concatenate(at))


def _reached(M: np.ndarray, C: np.ndarray, P: np.ndarray, W: np.ndarray, D: np.ndarray) -> float | None:
    """The largest kappa at which all blocks of the cells are positive definite; none where one is not, however small kappa."""
    p, n = C.shape
    cells, of_D, reached = len(W), np.arange(p), np.inf
    for k in range(DEGREE + 1):
        R = np.zeros((cells, n + p, n + p))
        for end, i, j, share in products(k):
            R -= float(share) * (M[:, i].mT @ (P[end : cells + end] + W) @ M[:, j])
        R[:, :n, :n] += P[:-1] * (1.0 - k / DEGREE) + P[1:] * (k / DEGREE)
        R[:, n + of_D, n + of_D] += D[:, k]
        if np.linalg.eigvalsh(R)[:, 0].min() <= 0.0:
            return None
        rest = R[:, :n, :n] - R[:, :n, n:] @ np.linalg.solve(R[:, n:, n:], R[:, n:, :n])
        into = np.linalg.inv(np.linalg.cholesky(0.5 * (rest + rest.mT))) @ C.T * np.sqrt(D[:, k])[:, None, :]
        reached = min(reached, float(np.linalg.norm(into, 2, axis=(1, 2)).max()) ** -1)
    return reached


def moves(nodes: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each way to move: the cell that it begins in, a cell that it may cross, and 1 upwards, -1 downwards."""
    cells = range(len(nodes) - 1)
    # a difference that is below the rate is not above it when rounded
    up = [(c, by, 1.0) for c in cells for by in cells if by == c or (by > c and nodes[by] - nodes[c + 1] <= rate)]
    down = [(c, by, -1.0) for c in cells for by in cells if by == c or (by < c and nodes[c] - nodes[by + 1] <= rate)]
    cell, crossed, sign = zip(*up, *down, strict=True)
    return np.array(cell), np.array(crossed), np.array(sign)


def products(k: int) -> Iterator[tuple[int, int, int, Fraction]]:
    """(l, i, j, share) with which M_i'P_l M_j stands in coefficient k of M'P M: of degree 1 in P, of degree 2 in each M."""
    for end, i, j in itertools.product(range(2), range(3), range(3)):
        if end + i + j == k:
            yield end, i, j, Fraction(comb(2, i) * comb(2, j), comb(DEGREE, k))


def hull(M: Any) -> tuple[Any, Any, Any]:
    """Bernstein points of the quadratics through the values (2 K - 1, ..) at both ends and in the middle of every cell.

    Three of shape (cells, ..), which hold the curve in their hull; of intervals or of floats.
    """
    return M[:-1:2], 2.0 * M[1::2] - 0.5 * (M[:-1:2] + M[2::2]), M[2::2]


def _beside(a: Interval, b: Interval) -> Interval:
    return Interval(np.concatenate([a.low, b.low], axis=-1), np.concatenate([a.high, b.high], axis=-1))


def _cornered(first: Interval, last: np.ndarray) -> Interval:
    """[first, 0; 0, diag(last)], (.., n + p, n + p)."""
    n, p = first.shape[-1], last.shape[-1]
    low = np.zeros((*last.shape[:-1], n + p, n + p))
    low[..., n + np.arange(p), n + np.arange(p)] = last
    high = low.copy()
    low[..., :n, :n], high[..., :n, :n] = first.low, first.high
    return Interval(low, high)


def _transposed(x: Interval) -> Interval:
    return Interval(x.low.swapaxes(-1, -2), x.high.swapaxes(-1, -2))
