"""Linear programs  min cost'x, low <= x <= high, bottom <= M x <= top  whose rows come, change and go.

The solver keeps its basis from one call to the next, so a new row costs a few dual simplex steps and a new cost a few
primal ones. Its word is not taken for anything: whoever asks checks the answer outside the solver.
"""

from typing import Any

import numpy as np

DUAL, PRIMAL = 1, 4  # HiGHS' numbers of the simplex strategies


class NotSolvedError(RuntimeError):
    """No solver gave an answer that stands the check outside the solver, or the program has no solution."""


class InfeasibleError(NotSolvedError):
    """No x keeps all rows and bounds."""


class UnboundedError(NotSolvedError):
    """The cost falls without end."""


class RowProgram:
    """min cost'x, low <= x <= high, with rows that are added, replaced and deleted between solves."""

    def __init__(self, cost: np.ndarray, low: np.ndarray | float, high: np.ndarray | float):
        import highspy

        n = len(cost)
        self.columns = n
        self.count = 0  # rows
        self.solver: Any = highspy.Highs()
        # no presolve: the rows are dense and there is nothing to remove; no scaling: it would change with the rows, and then
        # a kept basis costs a thousand steps instead of one
        options = {"output_flag": False, "presolve": "off", "solver": "simplex", "threads": 1, "simplex_scale_strategy": 0,
                   "primal_feasibility_tolerance": 1e-9, "dual_feasibility_tolerance": 1e-9}  # fmt: skip
        for name, value in options.items():
            self.solver.setOptionValue(name, value)
        none, whole = np.empty(0), np.empty(0, dtype=np.int32)
        spread = [np.broadcast_to(np.asarray(bound, float), n) * np.ones(n) for bound in (low, high)]
        self.solver.addCols(n, np.asarray(cost, float), *spread, 0, whole, whole, none)
        self.new_cost = self.new_rows = False

    def add(self, M: np.ndarray, bottom: np.ndarray | float, top: np.ndarray | float = np.inf) -> None:
        """Rows bottom <= M x <= top; M (count, n)."""
        count, n = M.shape
        ends = [np.broadcast_to(np.asarray(bound, float), count) * np.ones(count) for bound in (bottom, top)]
        starts = np.arange(count, dtype=np.int32) * n
        index = np.tile(np.arange(n, dtype=np.int32), count)
        self.solver.addRows(count, *ends, count * n, starts, index, np.ascontiguousarray(M, float).ravel())
        self.count += count
        self.new_rows = True

    def clear(self) -> None:
        """Delete every row."""
        if self.count:
            self.solver.deleteRows(self.count, np.arange(self.count, dtype=np.int32))
            self.count = 0
            self.new_rows = True

    def change_cost(self, cost: np.ndarray) -> None:
        self.solver.changeColsCost(len(cost), np.arange(len(cost), dtype=np.int32), np.asarray(cost, float))
        self.new_cost = True

    def change_rows(self, bottom: np.ndarray, top: np.ndarray, first: int = 0) -> None:
        """New bounds of the rows `first` to `first + len(bottom)`."""
        rows = np.arange(first, first + len(bottom), dtype=np.int32)
        self.solver.changeRowsBounds(len(rows), rows, np.asarray(bottom, float), np.asarray(top, float))
        self.new_rows = True

    def solve(self) -> tuple[np.ndarray, np.ndarray]:
        """x (n) and the row multipliers (count); raises InfeasibleError, UnboundedError, NotSolvedError."""
        import highspy

        status: Any = highspy.HighsModelStatus
        # after a change of the cost alone the old point is still feasible; otherwise the dual method has the shorter way
        self.solver.setOptionValue("simplex_strategy", PRIMAL if self.new_cost and not self.new_rows else DUAL)
        self.new_cost = self.new_rows = False
        self.solver.run()
        found = self.solver.getModelStatus()
        if found == status.kOptimal:
            answer = self.solver.getSolution()
            return np.array(answer.col_value), np.array(answer.row_dual)
        kind = {status.kInfeasible: InfeasibleError, status.kUnbounded: UnboundedError}.get(found, NotSolvedError)
        raise kind(f"HiGHS: {self.solver.modelStatusToString(found)}")
