"""The widest gap that a hyperplane leaves between two sets: a linear program with bounds of its optimum from both sides.

The linear programs of domains are solved in their dual, the widest gap a hyperplane leaves between two sets: few columns, and
of the boxes only those that matter become rows. What the solver says is checked in plain arithmetic.
"""

from collections.abc import Sequence

import numpy as np

from workbench.intervals.domains.boxes import INSIDE, Boxes
from workbench.lp import NotSolvedError, RowProgram
from workbench.records import record

AGREES = 1e-7  # largest difference of the two bounds of a gauge


@record
class GapAnswer:
    """lower <= t <= upper in units of the scale; `normal` (d) proves the first, `weights` of every family the second."""

    lower: float
    upper: float
    normal: np.ndarray
    weights: tuple[np.ndarray, ...]

    @property
    def value(self) -> float:
        return 0.0 if self.upper < INSIDE else max(self.lower, 0.0)


class Gap:
    """max cost'z - sum_f max_k F_f,k z over z = (p, q) >= 0 with 1'z <= 1: the dual of the gauge and of the meeting.

    A hyperplane with normal p - q leaves the gap. Only the boxes k that once decided become rows of the program, so that
    its size does not grow with the number of samples; it is made small again when too many have gathered.
    """

    def __init__(self, families: Sequence[np.ndarray]):
        self.families = tuple(families)  # (m_f, 2 d) each
        count = len(families)
        self.n = n = families[0].shape[1]
        self.size = 4 * n  # rows above which the program is made anew
        self.program = RowProgram(
            np.append(np.zeros(n), np.ones(count)),
            np.append(np.zeros(n), -np.full(count, 4.0)),
            np.append(np.ones(n), np.full(count, 4.0)),
        )
        self._start()

    def _start(self) -> None:
        self.program.clear()
        self.program.add(np.append(np.ones(self.n), np.zeros(len(self.families)))[None], -np.inf, 1.0)
        self.rows: list[np.ndarray] = [np.empty(0, dtype=int) for _ in self.families]
        self.order: list[int] = []  # the family of every row
        for f, F in enumerate(self.families):
            self._add(f, np.unique(F.argmax(axis=0)))

    def _add(self, family: int, rows: np.ndarray) -> None:
        tau = np.zeros((len(rows), len(self.families)))
        tau[:, family] = -1.0
        self.program.add(np.hstack([self.families[family][rows], tau]), -np.inf, 0.0)
        self.rows[family] = np.append(self.rows[family], rows)
        self.order += [family] * len(rows)

    def solve(self, cost: np.ndarray, enough: float = 0.0) -> GapAnswer:
        """Both bounds; they agree, or the upper one is below `enough`, or the lower one above it where it is not 0."""
        if len(self.order) > self.size:
            self._start()
        for _ in range(2):
            try:
                answer = self._solve(cost, enough)
            except NotSolvedError:
                answer = None
            if answer and (answer.upper - answer.lower <= AGREES or answer.upper <= enough or answer.lower > enough > 0):
                return answer
            self._start()  # rounding has gathered in the factors: once more from the beginning
        raise NotSolvedError("the gauge has no answer that stands the check outside the solver")

    def _solve(self, cost: np.ndarray, enough: float, rounds: int = 200) -> GapAnswer:
        self.program.change_cost(np.append(-cost, np.ones(len(self.families))))
        for _ in range(rounds):
            x, multipliers = self.program.solve()
            z = np.maximum(x[: self.n], 0.0)
            reach = [F @ z for F in self.families]
            value = float(cost @ z) - float(x[self.n :].sum())  # of the rows so far: never below the true one
            lower = float(cost @ z) - sum(float(r.max()) for r in reach)
            if value <= enough or lower > enough > 0 or value - lower <= 1e-11:
                break
            grown = False
            for f, r in enumerate(reach):
                worst = np.argpartition(-r, min(self.n, len(r)) - 1)[: self.n]
                worst = np.setdiff1d(worst[r[worst] > x[self.n + f] + 1e-11], self.rows[f])
                if len(worst):
                    self._add(f, worst)
                    grown = True
            if not grown:
                break
        return self._checked(cost, z, lower, multipliers)

    def _checked(self, cost: np.ndarray, z: np.ndarray, lower: float, multipliers: np.ndarray) -> GapAnswer:
        weights, family = [], np.array(self.order)
        for f, F in enumerate(self.families):
            weight = np.zeros(len(F))
            weight[self.rows[f]] = np.abs(multipliers[1:][family == f])
            weights.append(weight / max(weight.sum(), 1e-300))
        upper = float((cost - sum(weight @ F for weight, F in zip(weights, self.families, strict=True))).max())
        lower = lower / float(z.sum()) if lower > 0 else 0.0
        p, q = np.split(z, 2)
        return GapAnswer(lower, max(upper, 0.0), p - q, tuple(weights))


def gap_rows(boxes: Boxes, middle: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(high, -low) of the boxes in units of the scale: its product with (p, q) is the highest point along p - q."""
    return np.hstack([(boxes.high - middle) / scale, (middle - boxes.low) / scale])
