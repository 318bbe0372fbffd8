"""Stability while the schedule moves: x'P(rho) x falls at every sample for |rho+ - rho| <= rate and every parameter in the boxes.

P(rho) is linear between nodes, A(rho) and the columns b lam are quadratic in a cell (gains times a model, each linear). For one
cell

    f = P(rho) - A(rho, delta)'P(rho+) A(rho, delta)

is concave in A where P(rho+) >= 0 and linear in (P, P+), so it is positive everywhere if it is at the corners: those of the pairs
(rho, rho+), six within the cell and one across each of its ends, times the three Bernstein points of A, which hold the curve in
their hull. Each is one block with its own multipliers D_i >= 0, without the corners of the box of parameters:

    [P - A'P+ A - C'D C, -A'P+ B; -B'P+ A, D - B'P+ B] > 0,   B = kappa b_j lam_i in column i

The distance of the nodes is the lever: a cell is charged for all of its plants at once. A common P for all of the schedule is one
cell with P equal at both ends.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from workbench.errors import InputError
from workbench.intervals.arithmetic import exact, positive_definite
from workbench.records import field, record
from workbench.robustness.loop import UncertainLoop
from workbench.robustness.margins import falls
from workbench.robustness.semidefinite import Block, maximise, symmetric

TRIED = (0.11, 0.25, 0.68, 0.87)  # of a cell, where it is tried whether a loop is quadratic
QUADRATIC = 1e-9  # by which a loop may differ from the quadratic through three of its values, relative to its size
STEP = 1.1  # ratio of the bounds at which a search ends


@record
class ScheduledLoop:
    """Loops at nodes (K) of the schedule and in the middle of every cell (2 K - 1), in order; C is the same everywhere.

    A (2 K - 1, n, n); columns (2 K - 1, n, p) are b_j lam_i of every parameter.
    """

    nodes: np.ndarray = field("K")
    A: np.ndarray = field("M n n")
    columns: np.ndarray = field("M n p")
    C: np.ndarray = field("p n")

    def bernstein(self, cell: int) -> tuple[np.ndarray, np.ndarray]:
        """A (3 n n) and columns (3 n p) whose hull holds those of the cell."""
        return tuple(_hull(M[2 * cell : 2 * cell + 3]) for M in (self.A, self.columns))  # type: ignore[return-value]


def scheduled_loop(
    at: Callable[[float], UncertainLoop], nodes: Sequence[float], kinks: Sequence[float] | np.ndarray = ()
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
        if np.abs(loop.C - C).max() > QUADRATIC * np.abs(C).max():
            raise InputError(f"z is another function of the state at {value:g}", file="scheduled_loop")
    found = ScheduledLoop(rho, A, columns, C)
    for cell, low in enumerate(rho[:-1]):
        for share, kind in itertools.product(TRIED, range(2)):
            between = at(float(low + share * (rho[cell + 1] - low))).moved(own)
            hull, exact_value = found.bernstein(cell)[kind], (between.A, between.columns)[kind]
            quadratic = (1 - share) ** 2 * hull[0] + 2 * share * (1 - share) * hull[1] + share**2 * hull[2]
            if np.abs(quadratic - exact_value).max() > QUADRATIC * max(np.abs(exact_value).max(), 1e-300):
                raise InputError(
                    f"the loop is not quadratic between {low:g} and {rho[cell + 1]:g}",
                    file="scheduled_loop",
                    mend="put a node where a gain table has one, and end the schedule where another mode begins",
                )
    return found


@record
class ScheduledCertificate:
    """P (K n n) at the nodes, D (cells 8 3 p) of every block, for kappa times the boxes and `rate` a sample; see the module."""

    kappa: float
    rate: float
    P: np.ndarray = field("K n n")
    D: np.ndarray = field("cells 8 3 p", low=0.0)

    def holds(self, loop: ScheduledLoop) -> bool:
        """Whether that is proved in outward-rounded arithmetic, for the quadratics through the loop's numbers."""
        K = len(loop.nodes)
        if self.P.shape != (K, *loop.A.shape[1:]) or self.D.shape != (K - 1, 8, 3, len(loop.C)):
            return False
        if not np.array_equal(self.P, self.P.swapaxes(1, 2)) or not positive_definite(self.P).all():
            return False
        if not 0.0 <= self.rate <= np.diff(loop.nodes).min():
            return False
        for cell in range(K - 1):
            A, columns = loop.bernstein(cell)
            for pair, (now, then) in pairs(loop.nodes, cell, self.rate):
                P, P_then = self._at(now), self._at(then)
                for j in range(3):
                    B = exact(columns[j]) * self.kappa
                    if not falls(P, P_then, A[j], B, loop.C, self.D[cell, pair, j]):
                        return False
        return True

    def _at(self, weights: np.ndarray):
        """P between nodes, enclosed."""
        (used,) = np.nonzero(weights)
        total = exact(self.P[used[0]]) * float(weights[used[0]])
        for i in used[1:]:
            total = total + exact(self.P[i]) * float(weights[i])
        return total


def pairs(nodes: np.ndarray, cell: int, rate: float) -> Iterator[tuple[int, tuple[np.ndarray, np.ndarray]]]:
    """Weights (K) of P(rho) and P(rho+) at the corners of what the schedule may do from a cell; numbered 0 to 7."""
    K, width = len(nodes), np.diff(nodes)
    share = rate / width[cell]

    def weights(at: float, of: int) -> np.ndarray:
        found = np.zeros(K)
        found[of], found[of + 1] = 1.0 - at, at
        return found

    within = [(0.0, 0.0), (0.0, share), (share, 0.0), (1.0, 1.0), (1.0, 1.0 - share), (1.0 - share, 1.0)]
    for number, (now, then) in enumerate(within):
        yield number, (weights(now, cell), weights(then, cell))
    if cell + 2 < K:
        yield 6, (weights(1.0, cell), weights(rate / width[cell + 1], cell + 1))
    if cell > 0:
        yield 7, (weights(0.0, cell), weights(1.0 - rate / width[cell - 1], cell - 1))


def certificate(loop: ScheduledLoop, kappa: float, rate: float) -> ScheduledCertificate | None:
    """The certificate for kappa times the boxes, proved; or none where it was not found."""
    K, n, p = len(loop.nodes), loop.A.shape[1], len(loop.C)
    if not 0.0 <= rate <= np.diff(loop.nodes).min():
        raise InputError(f"rate {rate:g} a sample", file="certificate", mend="from 0 to the shortest distance of two nodes")
    size = np.linalg.norm(loop.C, axis=1)  # z of size 1: multipliers of one order
    size[size == 0.0] = 1.0
    C, scaled = loop.C / size[:, None], kappa * loop.columns * size
    E = symmetric(n)
    m = len(E)
    total, blocks, places = K * m, [], []
    for cell in range(K - 1):
        A, _ = loop.bernstein(cell)
        B = _hull(scaled[2 * cell : 2 * cell + 3])
        after = [_carried(E, A[j], B[j]) for j in range(3)]
        for pair, (now, then) in pairs(loop.nodes, cell, rate):
            (used,) = np.nonzero(now + then)
            for j in range(3):
                F = np.zeros((len(used) * m + p + 1, n + p, n + p))
                for k, node in enumerate(used):
                    F[k * m : (k + 1) * m] = -then[node] * after[j]
                    F[k * m : (k + 1) * m, :n, :n] += now[node] * E
                own = F[len(used) * m : -1]
                own[:, :n, :n] = -np.einsum("ia,ib->iab", C, C)
                own[np.arange(p), n + np.arange(p), n + np.arange(p)] = 1.0
                F[-1, :n, :n] = -np.eye(n)
                at = np.concatenate([*(node * m + np.arange(m) for node in used), total + np.arange(p), [-1]])
                places.append((cell, pair, j, total))
                blocks.append((F, at))
                total += p
    middle = np.zeros(total + 1)
    middle[(K // 2) * m : (K // 2 + 1) * m] = np.trace(E, axis1=1, axis2=2)
    whole = [Block(np.zeros((n + p, n + p)), F, np.where(at < 0, total, at)) for F, at in blocks]
    cap = Block(np.ones((1, 1)), -np.ones((1, 1, 1)), np.array([total]))  # t <= 1
    x = maximise(np.eye(total + 1)[-1], [*whole, cap], (middle[None], np.array([float(n)])))
    if x is None:
        return None
    P = np.tensordot(x[: K * m].reshape(K, m), E, 1)
    D = np.zeros((K - 1, 8, 3, p))
    for cell, pair, j, at in places:
        D[cell, pair, j] = np.maximum(x[at : at + p], 0.0) / size**2
    found = ScheduledCertificate(kappa, rate, P, D)
    return found if found.holds(loop) else None


def largest(loop: ScheduledLoop, rate: float, beyond: float, step: float = STEP) -> ScheduledCertificate:
    """The certificate of the largest kappa below `beyond`, within the ratio `step`."""
    low = beyond / step
    while (best := certificate(loop, low, rate)) is None:
        low /= step**2
        if low < 1e-3 * beyond:
            raise InputError(
                f"no certificate for a schedule that moves by {rate:g} a sample",
                file="largest",
                mend="more nodes, or a lower rate",
            )
    high = best.kappa * step**2 if low < beyond / step else beyond
    while high / best.kappa > step * (1.0 + 1e-9):
        kappa = float(np.sqrt(high * best.kappa))
        found = certificate(loop, kappa, rate)
        high, best = (kappa, best) if found is None else (high, found)
    return best


def _hull(three: np.ndarray) -> np.ndarray:
    """Bernstein points of the quadratic through the values at both ends and in the middle of a cell."""
    return np.stack([three[0], 2.0 * three[1] - 0.5 * (three[0] + three[2]), three[2]])


def _carried(E: np.ndarray, A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """[A B]'E [A B] of every basis matrix."""
    M = np.hstack([A, B])
    return M.T @ E @ M
