"""Every order and bound that is tried: sparse programs, refits, free runs, and the choice among them."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from workbench.data import Dataset
from workbench.errors import InputError
from workbench.identification.sparse import Bound, Solution
from workbench.identification.ssm.realisation import realised
from workbench.identification.ssm.recursion import free_run, mean_fit, radius
from workbench.identification.ssm.regression import Problem, Signals
from workbench.lpv import LPVModel
from workbench.records import field, record

TOLERANCE = 0.2  # FIT points by which a sparser candidate may be worse and still be taken


@record
class Candidate:
    """One order and one bound: what the sparse programs and the free run gave.

    mu, smallest (ny): the bound and its smallest feasible value, per output; error (ny): ||Y - Psi theta||_h after
    step 2; support: coefficients that are not zero, all outputs together; radius: largest spectral radius of the frozen
    model over the schedule's range, of the linearised one where the schedule is an output; fit: mean free-run FIT [%] on
    the estimation records, -inf where the run diverged; held_out likewise on the validation records; theta (ny,
    regressors, m).
    """

    order: int
    mu: np.ndarray = field("ny")
    smallest: np.ndarray = field("ny")
    error: np.ndarray = field("ny")
    support: int
    radius: float
    fit: float
    held_out: float | None
    theta: np.ndarray = field("ny nr m")

    @property
    def stable(self) -> bool:
        return self.radius < 1.0


@record
class SSMSweep:
    """The sparsity path: candidates by order and bound, and in plain words why others are missing."""

    path: tuple[Candidate, ...]
    skipped: tuple[str, ...]

    @property
    def best(self) -> Candidate:
        """The sparsest candidate within 0.2 points of the best free-run FIT on the estimation records.

        Of the stable ones where there are any. Without that margin the records on which the coefficients were fitted
        always ask for a few more of them.
        """
        finite = [c for c in self.path if np.isfinite(c.fit)]
        if not finite:
            reasons = "; ".join(self.skipped[:3]) or "every free run diverged"
            raise InputError(f"no model simulates the estimation records: {reasons}", mend="give another basis or order")
        able = [c for c in finite if c.stable] or finite
        top = max(c.fit for c in able)
        return min((c for c in able if c.fit >= top - TOLERANCE), key=lambda c: (c.support, -c.fit))


def sweep(problem: Problem, validation: Dataset | None) -> SSMSweep:
    options = problem.options
    start = max(options._orders)  # every order is scored on the same samples
    judged = _SelfScheduled(problem, start, validation) if problem.own else _Scheduled(problem, start, validation)
    path, skipped = [], []
    for n in options._orders:
        for factor, found in _solved(problem, n):
            if isinstance(found, str):
                skipped.append(f"order {n}, {factor}: {found}")
                continue
            theta = np.stack([fit.theta for _, _, fit in found]).reshape(len(found), -1, problem.signals[0].phi.shape[1])
            path.append(
                Candidate(
                    n,
                    np.array([mu for mu, _, _ in found]),
                    np.array([smallest for _, smallest, _ in found]),
                    np.array([fit.mu for _, _, fit in found]),
                    int(np.count_nonzero(theta)),
                    *judged(theta, n),
                    theta,
                )
            )
    return SSMSweep(tuple(path), tuple(skipped))


class _Scheduled:
    """Spectral radius, FIT and held-out FIT of coefficients under the measured schedule."""

    def __init__(self, problem: Problem, start: int, validation: Dataset | None):
        self.problem, self.start = problem, start
        self.held_out = [problem.signals_of(e, problem.point) for e in validation] if validation else []

    def __call__(self, theta: np.ndarray, n: int) -> tuple[float, float, float | None]:
        held_out = self._fit(theta, n, self.held_out) if self.held_out else None
        return radius(theta, n, self.problem), self._fit(theta, n, self.problem.signals), held_out

    def _fit(self, theta: np.ndarray, n: int, signals: Sequence[Signals]) -> float:
        runs = [(s.y, free_run(theta, n, s, self.start)) for s in signals]
        return float(np.mean([mean_fit(y[self.start :], None if run is None else run[self.start :]) for y, run in runs]))


class _SelfScheduled:
    """The same of a recursion whose schedule is its own output: of the model itself."""

    def __init__(self, problem: Problem, start: int, validation: Dataset | None):
        self.problem, self.start, self.validation = problem, start, validation

    def __call__(self, theta: np.ndarray, n: int) -> tuple[float, float, float | None]:
        model = realised(self.problem, theta, n)
        held_out = self._fit(model, self.validation) if self.validation else None
        return model.stability(points=21).radius, self._fit(model, self.problem.dataset), held_out

    def _fit(self, model: LPVModel, dataset: Dataset) -> float:
        y0 = self.problem.point.y[0]
        runs = [(e[[c.name for c in model.outputs]] - y0, model.simulate(e, warmup=self.start) - y0) for e in dataset]
        return float(np.mean([mean_fit(y[self.start :], run[self.start :]) for y, run in runs]))


def _solved(problem: Problem, n: int) -> Iterator[tuple[str, str | list[tuple[float, float, Solution]]]]:
    """For each bound: its name and, per output, (mu, smallest mu, step 2 in theta), or why there is none."""
    options, bound = problem.options, problem.options.bound
    Psi, Y = problem.regression(n)
    scale = options.penalty.scale(Psi)
    Psi = Psi / scale
    columns = []
    for y in Y.T:
        small, target = bound.compress(Psi, y)
        smallest = bound.smallest(small, target).mu
        mus = [factor * smallest for factor in options._factors] if options.mu is None else [options.mu]
        # the smallest bound is compared first: a solver may take very long to find that there is no solution
        answers = bound.path(small, target, mus) if mus[0] >= smallest else [None] * len(mus)
        columns.append([
            (mu, smallest, _refit(bound, small, target, answer, scale)) if answer is not None else smallest
            for mu, answer in zip(mus, answers, strict=True)
        ])  # fmt: skip
    labels = [f"mu = {f:g} mu_min" for f in options._factors] if options.mu is None else [f"mu = {options.mu:g}"]
    for label, row in zip(labels, zip(*columns, strict=True), strict=True):
        failed = [x for x in row if isinstance(x, float)]
        infeasible = options.mu is not None and any(x > options.mu for x in failed)
        reason = f"the smallest feasible mu is {max(failed):g}" if infeasible else "no solution was proved optimal"
        yield label, reason if failed else list(row)


def _refit(bound: Bound, Psi: np.ndarray, Y: np.ndarray, first: Solution, scale: np.ndarray) -> Solution:
    """Step 2, [1] eq. (1.9): the best fit on the support of step 1, in unscaled coefficients."""
    S = first.support
    best = bound.smallest(Psi[:, S], Y)
    theta = np.zeros(Psi.shape[1])
    theta[S] = best.theta / scale[S]
    return replace(best, theta=theta)
