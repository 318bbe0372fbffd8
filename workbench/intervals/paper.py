"""The paper's inclusion at interval regressors: [2] (8) with the outer product (7), one mixed-integer program.

    upper   centre'z + |centre|'r + radius'(|z| + r) >= y + e        lower   -centre'z + |centre|'r + radius'(|z| + r) >= -(y - e)
    min mean over k of  radius'(|z_k| + r) + |centre|'r

|centre| on the large side of a >= is not convex, but its n signs are shared by all samples: centre = p - m with p <= M b,
m <= M (1 - b) and n binaries b [methods: one program instead of 2^n]. Kept to compare with; see `semantics` for what is wrong.

[2] Linear time-varying models with interval parameters, sections 4.2 and 4.3.
"""

from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from workbench.errors import InputError
from workbench.intervals.arithmetic import dot, matmul
from workbench.intervals.boxes import BoxProgram, Rows
from workbench.intervals.semantics import ParameterBox
from workbench.lp import InfeasibleError

LARGE = 1e3  # of scaled parameters; an answer that touches it is refused


class PaperProgram(BoxProgram):
    """`BoxProgram` with |centre| in it: rows are collected, and HiGHS' branch and bound starts anew for each solve."""

    def start(self, first: int, last: int) -> None:
        self.rows: list[Rows] = []
        self.limits: list[tuple[np.ndarray, float]] = []
        super().start(first, last)

    def add(self, rows: Rows) -> None:
        self.rows.append(rows)

    def add_limit(self, k: np.ndarray, limit: float) -> None:
        self.limits.append((self.weight[k] / self.scale, limit / self.unit))

    def rows_at(self, k: np.ndarray, psi: np.ndarray, side: float) -> Rows:
        del psi  # (7) is evaluated at the measured regressor
        return super().rows_at(k, self.S.psi[k], side)

    def relaxed(self, cost: np.ndarray) -> ParameterBox:
        """The optimum over the rows so far, scaled as in `BoxProgram`."""
        r = self.worst.reach / self.scale
        z = np.concatenate([rows.z for rows in self.rows]) / self.scale
        side = np.concatenate([rows.side for rows in self.rows])
        rhs = np.concatenate([rows.rhs for rows in self.rows]) / self.unit
        box = signed_optimum(z, np.broadcast_to(r, z.shape), side, rhs, (cost / self.scale, r), self.limits)
        factor = self.unit / self.scale
        return ParameterBox(box.centre * factor, box.radius * factor)

    def slack(self, box: ParameterBox, first: int, last: int) -> np.ndarray:
        span = slice(first, last)
        centre = self.z[span] @ box.centre
        half = self.weight[span] @ box.radius + self.worst.reach @ np.abs(box.centre)
        return np.column_stack([centre + half - self.top[span], half - centre + self.bottom[span]])

    def proven_slack(self, box: ParameterBox, k: np.ndarray) -> np.ndarray:
        z = matmul(self.S.psi[k], self.form.T.T)
        half = (abs(z) * box.radius).sum(axis=1) + dot(self.worst.reach[None], np.abs(box.centre) + box.radius)
        centre = (z * box.centre).sum(axis=1)
        sides = [centre + half - self.proven_end(k, 1.0), half - centre - self.proven_end(k, -1.0)]
        return np.column_stack([side.low for side in sides])

    def gain(self, box: ParameterBox, k: np.ndarray) -> np.ndarray:
        return np.repeat((self.weight[k] @ box.radius)[:, None], 2, axis=1)

    def may_vanish(self) -> np.ndarray:
        return np.all(self.weight == 0.0, axis=1)

    def constant_radius(self, box: ParameterBox) -> float:
        return float(self.worst.reach @ np.abs(box.centre))


def signed_optimum(
    z: np.ndarray,
    reach: np.ndarray,
    side: np.ndarray,
    rhs: np.ndarray,
    cost: tuple[np.ndarray, np.ndarray],
    limits: Sequence[tuple[np.ndarray, float]] = (),
) -> ParameterBox:
    """min cost[0]'radius + cost[1]'|centre|  subject to  side z'centre + reach'|centre| + (|z| + reach)'radius >= rhs.

    Rows z, reach (R, n), side, rhs (R); limits: (weights (L, n), bound) keep weights'radius + cost[1]'|centre| <= bound.
    Variables p, m, radius, b of the module. A binary that is whole to 1e-6 still lets p and m be 1e-6 LARGE at once: only the
    signs are taken from it, and the linear program with these signs says the rest.
    Raises InfeasibleError, InputError where a parameter runs to LARGE.
    """
    from scipy.optimize import Bounds, LinearConstraint, linprog, milp

    n = z.shape[1]
    signed = side[:, None] * z
    keep = LinearConstraint(np.hstack([signed + reach, -signed + reach, np.abs(z) + reach, np.zeros_like(z)]), lb=cast(Any, rhs))
    eye, none = np.eye(n), np.zeros((n, n))
    positive = LinearConstraint(np.hstack([eye, none, none, -LARGE * eye]), ub=0.0)
    negative = LinearConstraint(np.hstack([none, eye, none, LARGE * eye]), ub=LARGE)
    both = np.concatenate([cost[1], cost[1]])
    narrow = [LinearConstraint(np.hstack([np.tile(both, (len(w), 1)), w, np.zeros_like(w)]), ub=limit) for w, limit in limits]
    answer = milp(
        np.concatenate([both, cost[0], np.zeros(n)]),
        constraints=[keep, positive, negative, *narrow],
        bounds=Bounds(0.0, cast(Any, np.repeat([LARGE, LARGE, np.inf, 1.0], n))),
        integrality=np.repeat([0, 0, 0, 1], n),
    )
    if answer.x is None:
        raise InfeasibleError("no box keeps these samples in the paper's sense")
    if answer.x[: 2 * n].max() > 0.99 * LARGE:
        raise InputError("a parameter runs to its limit", mend="some regressors do not move: leave their channel out")
    sign = np.where(answer.x[3 * n :] > 0.5, 1.0, -1.0)
    rows = np.hstack([signed * sign + reach, np.abs(z) + reach])
    most = [np.append(cost[1], w) for weights, _ in limits for w in weights]
    exact = linprog(
        np.append(cost[1], cost[0]),
        np.vstack([-rows, *most]),
        np.concatenate([-rhs, *(np.full(len(weights), limit) for weights, limit in limits)]),
        bounds=(0.0, None),
        method="highs-ds",
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )
    if exact.x is None:
        raise InfeasibleError("no box keeps these samples in the paper's sense")
    return ParameterBox(sign * exact.x[:n], np.maximum(exact.x[n:], 0.0))
