"""The smallest box of parameters that keeps a promise about samples: a linear program on the few rows that matter.

    min  mean over k of radius'(|z_k| + |T| r)       subject to the rows of `semantics`, radius >= 0               # [2] (8)

Rows join as they are violated. The solver's tolerance is no promise: afterwards every sample is checked in outward-rounded
arithmetic and the radii grow by the smallest common factor with which all of them keep it.

[2] Linear time-varying models with interval parameters, section 4.
"""

import numpy as np

from workbench.errors import InputError
from workbench.intervals.arithmetic import Interval, dot, exact, matmul
from workbench.intervals.regressors import Samples
from workbench.intervals.semantics import InclusionPaper, Overlap, ParameterBox, Semantics
from workbench.intervals.worst import WorstRegressor
from workbench.lp import InfeasibleError, RowProgram
from workbench.records import field, record

ROUNDS = 200
TOLERANCE = 2e-9  # of the output's range: what the program calls kept; the rest is the verification's
GROWTHS = 100  # of the radii in the verification; steps that rounding swallows are doubled


@record
class Rows:
    """Rows of the program at regressors z (count p): side z'centre + |z|'radius >= rhs, side +1 above, -1 below."""

    z: np.ndarray = field("count p")
    side: np.ndarray = field("count")
    rhs: np.ndarray = field("count")


class BoxProgram:
    """The program over samples S, to be solved over all of them or over a window that moves: rows and basis are kept.

    Internally parameters are scaled by the largest regressor of their column and outputs by their range; the optimum does not
    depend on it.
    """

    def __init__(self, S: Samples, semantics: Semantics):
        self.S, self.semantics = S, semantics
        self.form = S.form
        self.z, self.top, self.bottom = S.z, *semantics.ends(S)
        self.size_of_z = np.abs(self.z)
        self.worst = WorstRegressor(S.form, semantics.regressor_radius(S))
        self.weight = self.size_of_z + self.worst.reach  # (K p): the cost of a radius at each sample
        self.unit = float(np.ptp(S.y)) or float(np.abs(S.y).max()) or 1.0
        self.tolerance = TOLERANCE * self.unit
        self.scale = self.weight.max(axis=0)
        self.scale[self.scale == 0.0] = 1.0
        _check_regressors(self)
        self.solver = self._new_solver()

    # ---- the program ----------------------------------------------------------------------------------------------

    def start(self, first: int, last: int) -> None:
        """Forget all rows; begin with some spread over [first, last) and those that least squares explains worst."""
        self.solver.clear()
        count = 4 * len(self.scale)
        z, target = self.z[first:last], (self.S.y - self.S.psi @ self.form.d)[first:last]
        theta = np.linalg.lstsq(z / self.scale, target / self.unit, rcond=None)[0]
        error = np.abs(target / self.unit - z / self.scale @ theta)
        worst = np.argpartition(-error, count)[:count] if len(error) > count else np.arange(len(error))
        rows = np.union1d(worst, np.linspace(0, len(error) - 1, min(count, len(error))).astype(int)) + first
        for side in (1.0, -1.0):
            self.add(self.rows_at(rows, self.S.psi[rows], side))

    def rows_at(self, k: np.ndarray, psi: np.ndarray, side: float) -> Rows:
        """The rows of samples k (count) at regressors psi (count m)."""
        end = self.top[k] if side > 0 else -self.bottom[k]
        return Rows(psi @ self.form.T.T, np.full(len(k), side), end - side * (psi @ self.form.d))

    def add(self, rows: Rows) -> None:
        z = rows.z / self.scale
        self.solver.add(np.hstack([rows.side[:, None] * z, np.abs(z)]), rows.rhs / self.unit)

    def add_limit(self, k: np.ndarray, limit: float) -> None:
        """Rows that keep the envelope's radius at samples k at most `limit`."""
        w = self.weight[k] / self.scale
        self.solver.add(np.hstack([np.zeros_like(w), -w]), np.full(len(k), -limit / self.unit))

    def relaxed(self, cost: np.ndarray) -> ParameterBox:
        """The optimum over the rows so far, for the cost (p) of each radius: its value bounds the true optimum from below.

        Raises InfeasibleError.
        """
        p, own = len(self.scale), cost / self.scale
        self.solver.change_cost(np.concatenate([np.zeros(p), own / (own.max() or 1.0)]))
        x, _ = self.solver.solve()
        factor = self.unit / self.scale
        return ParameterBox(x[:p] * factor, np.maximum(x[p:], 0.0) * factor)

    def solve(self, first: int, last: int, rounds: int = ROUNDS) -> ParameterBox:
        """The smallest box over samples [first, last), from the rows so far."""
        cost = self.weight[first:last].mean(axis=0)
        for _ in range(rounds):
            try:
                box = self.relaxed(cost)
            except InfeasibleError:
                raise InputError("no box keeps these samples", mend="look for contradictory error bounds") from None
            rows = self.violated(box, first, last, 4 * len(self.scale))
            if not rows:
                return box
            for some in rows:
                self.add(some)
        raise InputError(f"rows are still violated after {rounds} rounds", mend="look for outliers of many orders of magnitude")

    # ---- what a box leaves open ------------------------------------------------------------------------------------

    def slack(self, box: ParameterBox, first: int, last: int) -> np.ndarray:
        """(last - first, 2): by how much the upper and the lower side are kept at the worst regressors; negative: violated."""
        span = slice(first, last)
        if not self.worst.blocks:
            centre = self.z[span] @ box.centre + self.S.psi[span] @ self.form.d
            half = self.size_of_z[span] @ box.radius
            return np.column_stack([centre + half - self.top[span], half - centre + self.bottom[span]])
        c = self.form.d + self.form.T.T @ box.centre
        above, below = (self.worst.value(side * c, box.radius, self.S.psi[span]) for side in (1.0, -1.0))
        return np.column_stack([above - self.top[span], below + self.bottom[span]])

    def violated(self, box: ParameterBox, first: int, last: int, count: int) -> list[Rows]:
        """Up to `count` of the most violated rows of each side, at their worst regressors; empty where all are kept."""
        slack = self.slack(box, first, last)
        found = []
        for column, side in enumerate((1.0, -1.0)):
            k = np.flatnonzero(slack[:, column] < -self.tolerance)
            if len(k) > count:
                k = k[np.argpartition(slack[k, column], count)[:count]]
            if len(k):
                psi = self.S.psi[first + k]
                if self.worst.blocks:
                    c = side * (self.form.d + self.form.T.T @ box.centre)
                    psi = self.worst.minimum(c, box.radius, psi).psi
                found.append(self.rows_at(first + k, psi, side))
        return found

    def proven_slack(self, box: ParameterBox, k: np.ndarray) -> np.ndarray:
        """Lower bounds (len(k), 2) of the slack of samples k, proven in outward-rounded arithmetic.

        With c = d + T'centre and any |s| <= radius, slack >= (c + T's)'psi_k - |c + T's|'r - top_k: the multipliers s are only
        proposed in floating point.
        """
        psi, T, r = self.S.psi[k], self.form.T, self.worst.r
        c, proposed = dot(T.T, box.centre) + self.form.d, self.form.d + T.T @ box.centre
        slack = np.empty((len(k), 2))
        for column, side in enumerate((1.0, -1.0)):
            C = matmul(self.worst.multipliers(side * proposed, box.radius, psi), T) + c * side
            value = (C * psi).sum(axis=1)
            if self.worst.blocks:
                value = value - (abs(C) * r).sum(axis=1)
            slack[:, column] = (value - self.proven_end(k, side)).low
        return slack

    def proven_end(self, k: np.ndarray, side: float) -> Interval:
        """top or -bottom of samples k: y +- e is rounded, too."""
        e = -self.S.output_error if isinstance(self.semantics, Overlap) else self.S.output_error
        return exact(side * self.S.y[k]) + e

    def gain(self, box: ParameterBox, k: np.ndarray) -> np.ndarray:
        """(len(k), 2): radius'|T psi| at the worst regressors, the slack's derivative by a common factor of the radii."""
        c = self.form.d + self.form.T.T @ box.centre
        worst = [self.worst.minimum(side * c, box.radius, self.S.psi[k]).psi for side in (1.0, -1.0)]
        return np.column_stack([np.abs(psi @ self.form.T.T) @ box.radius for psi in worst])

    def may_vanish(self) -> np.ndarray:
        """(K,) samples at which the promise includes regressors that are all 0; a bias cannot be."""
        return np.all(self.size_of_z <= self.worst.reach, axis=1)

    def mean_radius(self, box: ParameterBox, first: int, last: int) -> float:
        """OC of [2] definition 4 over samples [first, last)."""
        return float(self.weight[first:last].mean(axis=0) @ box.radius) + self.constant_radius(box)

    def constant_radius(self, box: ParameterBox) -> float:
        """The part of the envelope's radius that no sample and no radius changes."""
        del box
        return 0.0

    def _new_solver(self) -> RowProgram:
        # centres are free: a parameter that no sample determines stays at 0, where a bound would hold it far away
        p = len(self.scale)
        return RowProgram(np.zeros(2 * p), np.repeat([-np.inf, 0.0], p), np.inf)


def _check_regressors(program: BoxProgram) -> None:
    """Refuse samples that no box can keep: all regressors 0, but an output that must be something else."""
    if np.all(program.weight == 0.0):
        raise InputError("all regressors are 0", mend="use a bias (bias=True), or records in which something moves")
    hopeless = program.may_vanish() & ((program.top > 0.0) | (program.bottom < 0.0))
    if hopeless.any():
        k = int(np.argmax(hopeless))
        S = program.S
        raise InputError(
            f"sample {int(S.index[k]) + 1}: all regressors may be 0, but the output is not ({S.y[k]:g})",
            file=S.records[int(S.piece[k])],
            mend="use a bias (bias=True)",
        )


# ---- verification -----------------------------------------------------------------------------------------------------


@record
class Verified:
    """A box that keeps its promise at every sample in outward-rounded arithmetic.

    mean_radius: of the envelope over the samples [unit of the output]; inflation: common factor by which the radii grew;
    inflated: samples that asked for it.
    """

    box: ParameterBox
    mean_radius: float
    inflation: float = field("", low=1.0)
    inflated: int = 0


def box_program(S: Samples, semantics: Semantics) -> BoxProgram:
    """The program of a promise: linear, but for the paper's inclusion at regressors with errors."""
    if isinstance(semantics, InclusionPaper) and np.any(S.error > 0):
        from workbench.intervals.paper import PaperProgram

        return PaperProgram(S, semantics)
    return BoxProgram(S, semantics)


def smallest_box(S: Samples, semantics: Semantics) -> Verified:
    """The box of least mean radius that keeps the promise on all samples, verified."""
    return smallest_of(box_program(S, semantics), 0, len(S))


def smallest_of(program: BoxProgram, first: int, last: int) -> Verified:
    """The same for the samples [first, last) of a program."""
    program.start(first, last)
    return verified(program, program.solve(first, last), first, last)


def verified(program: BoxProgram, box: ParameterBox, first: int, last: int) -> Verified:
    """The box with its radii enlarged by the smallest common factor that keeps every sample in [first, last).

    The slack is a concave function of the factor, so that Newton's method from 1 rises to the smallest one and not beyond. Where
    radii are 0, or so small that the factor would exceed 2, every parameter gets a little radius of its own as well.
    """
    factor, floor, push, before, inflated = 1.0, 0.0, 1.0, np.inf, None
    for _ in range(GROWTHS):
        grown = ParameterBox(box.centre, box.radius * factor + floor / program.scale)
        k = _doubtful(program, grown, first, last)
        short = np.maximum(-program.proven_slack(grown, k), 0.0)
        inflated = int(np.count_nonzero(short.any(axis=1))) if inflated is None else inflated
        if not short.any():
            return Verified(grown, program.mean_radius(grown, first, last), factor, inflated)
        # a step below the rounding of large parameters leads nowhere: double it until something moves
        push, before = (2.0 * push if short.max() >= before else 1.0), float(short.max())
        needed = float(np.max(short / np.maximum(program.gain(grown, k), 1e-300)))
        if needed < 1.0:
            factor *= 1.0 + push * (needed * (1.0 + 1e-6) + 1e-15)
        else:
            floor += push * max(floor, before)
    raise InputError("no inflation makes this box keep every sample", mend="report this: the check outside the solver failed")


def _doubtful(program: BoxProgram, box: ParameterBox, first: int, last: int) -> np.ndarray:
    """The samples whose slack in floating point is too small to be believed.

    The slack is a sum of fewer than 100 (m + p) products; its rounding error is far below 1e-9 of the sum of their magnitudes.
    """
    S = program.S
    largest = np.abs(S.psi[first:last]).max(axis=0) + program.worst.r
    terms = np.abs(S.form.d) + np.abs(S.form.T).T @ (np.abs(box.centre) + box.radius)
    magnitude = float(terms @ largest) + float(np.abs(S.y[first:last]).max()) + S.output_error
    return first + np.flatnonzero(program.slack(box, first, last).min(axis=1) < 1e-9 * magnitude)
