"""Sparse set membership identification (SSM) of LPV models, one regression per output:

    y(k) = sum_{i=1..n} f_i(p(k-n)) y(k-i) + sum_{i=1..n} g_i(p(k-i)) u(k-i) + d(k),    ||d||_h <= mu      # [1] eq. (1.3)
    f_i = sum_j alpha_ij beta_j,  g_i likewise

which is Y = Psi theta + d with one column per (past signal, basis function). Step 1 finds the sparsest theta (in the l1
sense) that the bound allows, step 2 fits best on its support. With several outputs every regression contains the past
of all outputs and all inputs. Several records give rows of their own; no row reaches across a joint.

The model is the block observer form of the recursion, exact for schedules that move however fast:

    y(k) = x_1(k),   x_i(k+1) = x_{i+1}(k) + f_i(p(k+i-n)) y(k) + g_i(p(k)) u(k),   i = 1..n, x_{n+1} = 0

so f_i enters with delay n - i and g_i with none. Its one-step predictor is the same with y measured: F is the shift and
forgets its initial state after n samples.

[1] Sparse set membership identification of LPV systems and the web winding machine, sections 1.2 and 1.4.3.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.identification.feedthrough import acts_at_once
from workbench.identification.sparse import L2, Bound, LInf, NotSolvedError, Solution, orthonormal_range
from workbench.lpv import (
    CONSTANT,
    Basis,
    Estimate,
    Gaussian,
    LPVModel,
    OperatingPoint,
    Powers,
    Predictor,
    Term,
)
from workbench.records import field, record

EXPONENTS = np.array([0.0, 1, 2, 3, 4, -1, -2, -3])  # [1] section 1.4.3
# mu "slightly larger than the minimum", [1] section 1.4.3; the largest error of thousands is rarer than their energy says
FACTORS: dict[type, tuple[float, ...]] = {L2: (1.02, 1.05, 1.1, 1.2), LInf: (1.1, 1.2, 1.5, 2.0)}
TOLERANCE = 0.2  # FIT points by which a sparser candidate may be worse and still be taken
DIVERGED = 1e3  # a free run beyond this many times the measured range has diverged


# ---- options --------------------------------------------------------------------------------------------------------


@record
class UnitColumns:
    """sum_j rms(Psi_j) |theta_j|: each term is charged for what it adds to the output.

    The selection then depends neither on the units of the channels nor on the scale of the basis.
    """

    def scale(self, Psi: np.ndarray) -> np.ndarray:
        size = np.sqrt(np.mean(Psi**2, axis=0))
        return np.where(size > 0, size, 1.0)


@record
class Plain:
    """||theta||_1 as printed in [1] eq. (1.8): another unit of an input or of the schedule gives another support."""

    def scale(self, Psi: np.ndarray) -> np.ndarray:
        return np.ones(Psi.shape[1])


@record
class RawSignals:
    """u0 = 0, y0 = 0: the schedule-dependent coefficients carry the relation between the levels, as in [1]."""

    def of(self, problem: "_Problem", dataset: Dataset) -> OperatingPoint:
        del dataset
        names = problem.names
        return OperatingPoint(CONSTANT, np.zeros((1, len(names.inputs))), np.zeros((1, len(names.outputs))))


@record
class FittedZero:
    """u0 = 0, y0 constant: the reading of each output at which the recursion has no bias.

    A recursion without a constant term needs the physical zero of its outputs, and a gauge may be set to zero anywhere
    (a dancer angle that stands at 0 at the nominal tension). y0 minimises the squared one-step error, all coefficients
    refitted, at a low order; an output keeps y0 = 0 unless its own zero lowers N log(error) by more than log N (BIC).
    """

    order: int = 3

    def of(self, problem: "_Problem", dataset: Dataset) -> OperatingPoint:
        raw = RawSignals().of(problem, dataset)
        signals = [problem.signals_of(e, raw) for e in dataset]
        return replace(raw, y=_zero(signals, problem.direct, min(self.order, max(problem.options._orders)))[None])


@record
class ScheduledMean:
    """u0(rho), y0(rho): polynomials of this degree in the schedule, fitted to the signals of the estimation records.

    Deviations lose what the levels say about the gain at low frequency; use it for a machine whose levels are not
    related by the same recursion as its deviations.
    """

    degree: int = 1

    def of(self, problem: "_Problem", dataset: Dataset) -> OperatingPoint:
        names = problem.names
        if names.schedule is None:
            basis, rho = CONSTANT, np.zeros(sum(len(e) for e in dataset))
        else:
            rho = np.concatenate([e[names.schedule.name] for e in dataset])
            basis = Powers(np.arange(self.degree + 1.0), _middle(rho))
        signals = np.concatenate([e[[c.name for c in names.inputs + names.outputs]] for e in dataset])
        level = np.linalg.lstsq(basis(rho), signals, rcond=None)[0]
        return OperatingPoint(basis, level[:, : len(names.inputs)], level[:, len(names.inputs) :])


@record
class SSM:
    """y(k) = sum_i f_i(p(k-n)) y(k-i) + sum_i g_i(p(k-i)) u(k-i) + d(k), ||d||_h <= mu: sparse set membership identification.

    `fit` gives the model of the sparsest f and g that keep the bound mu, `sweep` shows what was tried.

    order: the number of past samples n; None takes the one of `orders` whose model simulates the estimation records
    best. mu_factor: mu over its smallest feasible value, per output and order; None chooses among `factors` the same
    way (None: the ones in FACTORS). mu: the bound itself where the noise is known, in units of the output; it
    overrules mu_factor.
    basis: None is {1, rho, .., rho^4, rho^-1, .., rho^-3} of [1] with rho over its middle value; where the records' schedule
    reaches zero, {1, rho, .., rho^4} with rho over its largest size.
    feedthrough: a term D u(k) with constant D; None where the records show that inputs act within the sample.

        >>> SSM(order=1, mu_factor=1.1).fit(data).to_control(10.0).poles().round(2)  # frozen at way = 10 mm
        array([0.89+0.j])
    """

    order: int | None = None
    bound: Bound = field(default=L2())
    basis: Basis | None = None
    mu_factor: float | None = None
    mu: float | None = None
    orders: Sequence[int] = tuple(range(1, 16))
    factors: Sequence[float] | None = None
    penalty: UnitColumns | Plain = field(default=UnitColumns())
    operating_point: FittedZero | RawSignals | ScheduledMean = field(default=FittedZero())
    feedthrough: bool | None = None
    name: str = "SSM"

    def __post_init__(self):
        for n in self._orders:
            if n != int(n) or n < 1:
                raise InputError(f"order {n}", mend="an order is a whole number of samples, at least 1")
        for factor in self._factors:
            if not factor > 1.0:
                raise InputError(f"mu_factor {factor:g}", mend="it must exceed 1: at 1 only the smallest bound is left")
        if self.mu is not None and not self.mu > 0:
            raise InputError(f"mu {self.mu:g}", mend="a bound on the noise is positive")

    @property
    def _orders(self) -> tuple[int, ...]:
        return tuple(self.orders) if self.order is None else (self.order,)

    @property
    def _factors(self) -> tuple[float, ...]:
        if self.mu_factor is not None:
            return (self.mu_factor,)
        return FACTORS[type(self.bound)] if self.factors is None else tuple(self.factors)

    def fit(self, dataset: Dataset) -> LPVModel:
        """The model of the order and mu that simulate the records best, with intervals and notes.

        Raises InputError for records without input or output, too short, or without any model that can be simulated.
        """
        problem = _Problem(self, dataset)
        return replace(_model(problem, _sweep(problem, None).best), trained_on=dataset.fingerprints)

    def sweep(self, dataset: Dataset, validation: Dataset | None = None) -> "SSMSweep":
        """Every order and mu: support, stability, free-run FIT on the records and, where given, on held-out ones."""
        return _sweep(_Problem(self, dataset), validation)


# ---- results --------------------------------------------------------------------------------------------------------


@record
class Candidate:
    """One order and one bound: what the sparse programs and the free run gave.

    mu, smallest (ny): the bound and its smallest feasible value, per output; error (ny): ||Y - Psi theta||_h after
    step 2; support: coefficients that are not zero, all outputs together; radius: largest spectral radius of the frozen
    model over the schedule's range; fit: mean free-run FIT [%] on the estimation records, -inf where the run diverged;
    held_out likewise on the validation records; theta (ny, regressors, m).
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


# ---- the regression -------------------------------------------------------------------------------------------------


@record
class _Names:
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    schedule: Channel | None


@record
class _Signals:
    """One record in deviations from the operating point: u (N, nu), y (N, ny), phi (N, m)."""

    u: np.ndarray = field("N nu")
    y: np.ndarray = field("N ny")
    phi: np.ndarray = field("N m")


class _Problem:
    """The estimation records as the regressions see them: basis, span, operating point, signals."""

    def __init__(self, options: SSM, dataset: Dataset):
        self.options, self.dt = options, dataset.dt
        self.names = _names(dataset)
        self.basis, self.span = _basis_and_span(options.basis, dataset, self.names.schedule)
        longest = max(options._orders)
        for e in dataset:
            if len(e) <= 2 * longest:
                raise InputError(f"{len(e)} samples for order {longest}", file=e.name, mend="give longer records or lower orders")
        # direct(m): 1 for the constant function, by which alone u(k) is multiplied, or all 0 without a feed-through
        self.direct = _direct(self.basis, acts_at_once(dataset) if options.feedthrough is None else options.feedthrough)
        self.point = options.operating_point.of(self, dataset)
        self.signals = [self.signals_of(e, self.point) for e in dataset]

    def signals_of(self, e: Experiment, point: OperatingPoint) -> _Signals:
        """The record in deviations from `point`."""
        schedule = self.names.schedule
        rho = np.zeros(len(e)) if schedule is None else np.clip(e[schedule.name], *self.span)
        level = point.basis(rho)
        u = e[[c.name for c in self.names.inputs]] - level @ point.u
        y = e[[c.name for c in self.names.outputs]] - level @ point.y
        return _Signals(u, y, self.basis(rho))

    def regression(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        """Psi (rows, nr m) and Y (rows, ny), row blocks by record."""
        blocks = [_regressors(s, n, self.direct) for s in self.signals]
        return np.vstack(blocks), np.vstack([s.y[n:] for s in self.signals])


def _names(dataset: Dataset) -> _Names:
    first = dataset.experiments[0]
    inputs, outputs, schedule = (tuple(c for c in first.channels if c.role == role) for role in ("input", "output", "schedule"))
    for role, found in (("input", inputs), ("output", outputs)):
        if not found:
            raise InputError(f"no {role} channel", file=first.name, mend="name one with with_roles")
    if len(schedule) > 1:
        names = ", ".join(c.name for c in schedule)
        raise InputError("several schedule channels", file=first.name, channel=names, mend="keep one of them")
    return _Names(inputs, outputs, schedule[0] if schedule else None)


def _basis_and_span(basis: Basis | None, dataset: Dataset, schedule: Channel | None) -> tuple[Basis, np.ndarray]:
    if schedule is None:
        return CONSTANT, np.zeros(2)
    rho = np.concatenate([e[schedule.name] for e in dataset])
    span = np.array([rho.min(), rho.max()])
    if basis is not None:
        return basis, span
    if span[0] * span[1] <= 0:  # where it may be zero there is no 1/rho
        return Powers(EXPONENTS[EXPONENTS >= 0], float(np.abs(span).max()) or 1.0), span
    return Powers(EXPONENTS, _middle(rho)), span


def _middle(rho: np.ndarray) -> float:
    """A positive scale at which powers of the schedule are of order one."""
    return float(np.abs(0.5 * (rho.min() + rho.max()))) or 1.0


def _direct(basis: Basis, wanted: bool) -> np.ndarray:
    if not wanted:
        return np.zeros(len(basis.names))
    if not isinstance(basis, Powers) or not np.any(basis.exponents == 0):
        raise InputError("a feed-through needs a basis with the constant 1", mend="use Powers with exponent 0")
    return (basis.exponents == 0).astype(float)


def _regressors(s: _Signals, n: int, direct: np.ndarray) -> np.ndarray:
    """Psi (N - n, nr m): y(k-1) .. y(k-n), u(k-1) .. u(k-n) [1] eq. (1.7) times all basis functions, u(k) times `direct`."""
    k = np.arange(n, len(s.y))
    past = [s.y[k - i, :, None] * s.phi[k - n, None, :] for i in range(1, n + 1)]
    past += [s.u[k - i, :, None] * s.phi[k - i, None, :] for i in range(1, n + 1)]
    past += [s.u[k, :, None] * direct]
    return np.concatenate(past, axis=1).reshape(len(k), -1)


def _zero(signals: Sequence[_Signals], direct: np.ndarray, n: int) -> np.ndarray:
    """y0 (ny) of `FittedZero`. The valley around the right value is wide at order 1 and narrow at higher ones."""
    from scipy.optimize import minimize

    y = np.concatenate([s.y for s in signals])
    spread = np.where(y.std(axis=0) > 0, y.std(axis=0), 1.0)
    coarse, fine = _bias_criterion(signals, direct, 1), _bias_criterion(signals, direct, n)
    steps = np.concatenate([[0.0], *([x, -x] for x in np.geomspace(0.25, 64, 17))])
    y0 = np.zeros(y.shape[1])
    for _ in range(2):
        for unit in np.diag(spread):
            trials = [np.where(unit > 0, 0.0, y0) + step * unit for step in steps]
            y0 = trials[int(np.argmin([coarse(trial) for trial in trials]))]
    for criterion in (coarse, fine):
        simplex = np.vstack([y0, y0 + 0.5 * np.diag(spread)])
        # [scipy] Nelder-Mead: one to three unknowns, and the criterion has no simple gradient
        y0 = minimize(
            criterion,
            y0,
            method="Nelder-Mead",
            bounds=[(-100 * size, 100 * size) for size in spread],
            options={"initial_simplex": simplex, "xatol": 1e-4 * spread.min(), "fatol": 1e-6},
        ).x
    for b in range(len(y0)):
        without = np.where(np.arange(len(y0)) == b, 0.0, y0)
        if len(y) * (fine(without) - fine(y0)) < np.log(len(y)):
            y0 = without
    return y0


def _bias_criterion(signals: Sequence[_Signals], direct: np.ndarray, n: int) -> Callable[[np.ndarray], float]:
    """y0 -> sum over outputs of log ||e||^2, e the least squares error of the recursion in y - y0.

    (y(k-i) - y0) phi_j(p(k-n)) and y(k) - y0 are sums of columns that do not depend on y0, so one triangle serves all y0.
    """
    ny, m = signals[0].y.shape[1], signals[0].phi.shape[1]
    blocks = [np.column_stack([_regressors(s, n, direct), s.phi[:-n], s.y[n:], np.ones(len(s.y) - n)]) for s in signals]
    R: Any = np.linalg.qr(np.vstack(blocks), mode="r")
    columns = R.shape[1] - m - ny - 1
    past, forced = R[:, : n * ny * m].reshape(len(R), n, ny, m), R[:, n * ny * m : columns]
    phi, target, one = R[:, columns : columns + m], R[:, columns + m : -1], R[:, -1:]

    def criterion(y0: np.ndarray) -> float:
        moved = past - y0[:, None] * phi[:, None, None, :]
        Q, _ = orthonormal_range(np.hstack([moved.reshape(len(R), -1), forced]))
        e = target - y0 * one
        e = e - Q @ (Q.T @ e)
        return float(np.log(np.maximum(np.sum(e**2, axis=0), 1e-300)).sum())

    return criterion


@record
class _Parts:
    """theta (ny, nr, m) by meaning: f (n, ny, ny, m), g (n, ny, nu, m) by lag, output, past signal, function; D (ny, nu)."""

    f: np.ndarray = field("n ny ny m")
    g: np.ndarray = field("n ny nu m")
    D: np.ndarray = field("ny nu")


def _parts(theta: np.ndarray, n: int) -> _Parts:
    ny, nr, m = theta.shape
    nu = (nr - n * ny) // (n + 1)
    f = theta[:, : n * ny].reshape(ny, n, ny, m).transpose(1, 0, 2, 3)
    g = theta[:, n * ny : n * (ny + nu)].reshape(ny, n, nu, m).transpose(1, 0, 2, 3)
    return _Parts(f, g, theta[:, n * (ny + nu) :].sum(axis=2))


# ---- the sweep ------------------------------------------------------------------------------------------------------


def _sweep(problem: _Problem, validation: Dataset | None) -> SSMSweep:
    options = problem.options
    start = max(options._orders)  # every order is scored on the same samples
    held_out = [problem.signals_of(e, problem.point) for e in validation] if validation else []
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
                    _radius(theta, n, problem),
                    float(np.mean([_free_run_fit(theta, n, s, start) for s in problem.signals])),
                    float(np.mean([_free_run_fit(theta, n, s, start) for s in held_out])) if held_out else None,
                    theta,
                )
            )
    return SSMSweep(tuple(path), tuple(skipped))


def _solved(problem: _Problem, n: int) -> Iterator[tuple[str, str | list[tuple[float, float, Solution]]]]:
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


def _radius(theta: np.ndarray, n: int, problem: _Problem, points: int = 21) -> float:
    """Largest spectral radius of the frozen recursion over the schedule's span."""
    f = _parts(theta, n).f
    ny = f.shape[1]
    grid = problem.basis(np.linspace(problem.span[0], problem.span[1], points))
    A = np.zeros((points, n * ny, n * ny))
    A[:, :, :ny] = np.einsum("iabm,rm->riab", f, grid).reshape(points, n * ny, ny)
    A[:, : (n - 1) * ny, ny:] += np.eye((n - 1) * ny)
    return float(np.abs(np.linalg.eigvals(A)).max())


def _free_run_fit(theta: np.ndarray, n: int, s: _Signals, start: int) -> float:
    """FIT [%] of the free run, mean over outputs, from sample `start` on; -inf where it diverges.  [1] eq. (1.17)"""
    y = _free_run(theta, n, s, start)
    if y is None:
        return -np.inf
    truth = s.y[start:]
    spread = np.linalg.norm(truth - truth.mean(axis=0), axis=0)
    return float(np.mean(100 * (1 - np.linalg.norm(truth - y[start:], axis=0) / np.where(spread > 0, spread, 1.0))))


def _free_run(theta: np.ndarray, n: int, s: _Signals, start: int) -> np.ndarray | None:
    """y (N, ny) of the recursion from measured inputs and schedule; measured outputs before `start`; None: diverged."""
    parts = _parts(theta, n)
    f, g = parts.f, parts.g
    N, ny = s.y.shape
    forced = s.u @ parts.D.T
    for i in range(1, n + 1):
        forced[i:] += np.einsum("kab,kb->ka", np.tensordot(s.phi, g[i - 1], (1, 2)), s.u)[: N - i]
    # newest sample last, as it lies in memory: y(k-n) .. y(k-1)
    memory = np.tensordot(s.phi, f[::-1], (1, 3)).transpose(0, 2, 1, 3).reshape(N, ny, n * ny)
    y = s.y.flatten()
    limit = DIVERGED * float(np.abs(s.y).max())
    for k in range(start, N):
        new = memory[k - n] @ y[(k - n) * ny : k * ny] + forced[k]
        if not np.abs(new).max() <= limit:
            return None
        y[k * ny : (k + 1) * ny] = new
    return y.reshape(N, ny)


# ---- the model ------------------------------------------------------------------------------------------------------


def _model(problem: _Problem, best: Candidate) -> LPVModel:
    names, n = problem.names, best.order
    basis, unity = _with_unity(problem.basis)
    A, B, C, F, terms = _realise(best.theta, n, unity)
    D0 = _parts(best.theta, n).D
    D = np.zeros((len(terms), *D0.shape))
    D[: np.count_nonzero(unity)] = unity[unity != 0, None, None] * D0
    K = np.zeros((*A.shape[:2], len(names.outputs)))
    K[:] = (A - F)[:, :, : len(names.outputs)]
    estimates, noise = _uncertainty(problem, best)
    model = LPVModel(
        name=problem.options.name,
        dt=problem.dt,
        inputs=names.inputs,
        outputs=names.outputs,
        schedule=names.schedule,
        span=problem.span,
        basis=basis,
        terms=terms,
        A=A,
        B=B + K @ D0,  # x_i+ = x_(i+1) + a_i y + b_i u with y = x_1 + D u
        C=C,
        D=D,
        operating_point=problem.point,
        predictor=Predictor(F, B, K, warmup=n),
        noise=noise,
        estimates=estimates,
    )
    return replace(model, notes=_notes(model, best))


def _with_unity(basis: Basis) -> tuple[Basis, np.ndarray]:
    """A basis that can write the constant 1, and the weights (m) with sum_j weight_j phi_j = 1."""
    if isinstance(basis, Powers):
        if not np.any(basis.exponents == 0):
            basis = Powers(np.append(basis.exponents, 0.0), basis.scale)
        weight = np.zeros(len(basis.exponents))
        weight[np.flatnonzero(basis.exponents == 0)[0]] = 1.0
        return basis, weight
    if isinstance(basis, Gaussian) and not basis.normalised:
        raise InputError(
            "plain Gaussian functions do not add up to a constant, which a delay in the model needs",
            mend="use Gaussian(..., normalised=True), PiecewiseLinear or Powers",
        )
    return basis, np.ones(len(basis.names))


def _realise(theta: np.ndarray, n: int, unity: np.ndarray):
    """A, B, C and the shift F by term, and the terms: one per (function, delay) that is used."""
    f, g = _parts(theta, n).f, _parts(theta, n).g
    ny, nu = f.shape[1], g.shape[2]
    used: dict[tuple[int, int], int] = {}
    for j in np.flatnonzero(unity):
        used.setdefault((int(j), 0), len(used))
    for i, j in np.argwhere(np.any(f != 0, axis=(1, 2))):
        used.setdefault((int(j), n - 1 - int(i)), len(used))
    for j in np.flatnonzero(np.any(g != 0, axis=(0, 1, 2))):
        used.setdefault((int(j), 0), len(used))
    A = np.zeros((len(used), n * ny, n * ny))
    B, C = np.zeros((len(used), n * ny, nu)), np.zeros((len(used), ny, n * ny))
    for j in np.flatnonzero(unity):
        t = used[int(j), 0]
        A[t, : (n - 1) * ny, ny:] = unity[j] * np.eye((n - 1) * ny)
        C[t, :, :ny] = unity[j] * np.eye(ny)
    F = A.copy()
    for (j, delay), t in used.items():
        i = n - 1 - delay  # lag i + 1: x_{i+1} receives f(p(k - delay)) y(k)
        rows = slice(i * ny, (i + 1) * ny)
        if j < f.shape[3]:
            A[t, rows, :ny] += f[i, :, :, j]
            if delay == 0:
                B[t] = g[:, :, :, j].reshape(n * ny, nu)
    return A, B, C, F, tuple(Term(j, delay) for j, delay in used)


def _notes(model: LPVModel, best: Candidate) -> tuple[str, ...]:
    stability = model.stability()
    notes = []
    if not stability.stable:
        place = "" if model.schedule is None else f" at {model.schedule.name} = {stability.at:.4g}"
        notes.append(f"unstable: the frozen model has spectral radius {stability.radius:.4f}{place}")
    if not np.isfinite(best.fit) or best.fit < 50:
        notes.append(f"the free run on the estimation records has FIT {best.fit:.0f} %: do not simulate with it")
    return tuple(notes)


# ---- uncertainty ----------------------------------------------------------------------------------------------------


def _uncertainty(problem: _Problem, best: Candidate) -> tuple[tuple[Estimate, ...], np.ndarray]:
    """Estimates by coefficient and the covariance (ny, ny) of the one-step error.

    The interval is the set membership one, {theta on the support: ||Y - Psi theta||_h <= mu}: it contains the truth
    whenever the true coefficients outside the support are zero and the noise keeps the bound. A mu a few percent above its
    smallest value is a choice of sparsity and says nothing about the noise: unless the user gave mu, the intervals use the
    bound that the residuals support, where it is larger. The standard deviation is
    that of least squares on the same support, with the covariance of coloured errors (Newey and West 1987, Bartlett
    weights); it needs regressors that are independent of the error, which past outputs are only for white errors.
    """
    n, bound = best.order, problem.options.bound
    Psi, Y = problem.regression(n)
    flat = best.theta.reshape(len(best.theta), -1)
    lengths = [len(s.y) - n for s in problem.signals]
    labels = _labels(problem, n)
    estimates = []
    for y, theta, mu, output in zip(Y.T, flat, best.mu, problem.names.outputs, strict=True):
        S = np.flatnonzero(theta)
        if len(S) == 0:
            continue
        if problem.options.mu is None:
            e = y - Psi[:, S] @ np.linalg.lstsq(Psi[:, S], y, rcond=None)[0]
            mu = max(mu, bound.noise_bound(e, len(S)))
        intervals = bound.intervals(*bound.compress(Psi[:, S], y), mu)
        std = _standard_deviation(Psi[:, S], y, lengths)
        for j, low, high, deviation in zip(S, intervals.low, intervals.high, std, strict=True):
            label, unit = labels[j]
            ends = (float(e) if np.isfinite(e) else None for e in (low, high))
            per = f"{output.unit or '1'}/({unit})" if unit else output.unit
            estimates.append(Estimate(f"{output.name}: {label}", theta[j], deviation, *ends, unit=per))
    error = Y - Psi @ flat.T
    return tuple(estimates), np.atleast_2d(error.T @ error) / len(error)


def _labels(problem: _Problem, n: int) -> list[tuple[str, str]]:
    """Name and unit of each column: "w3(k-3) rho^-2"."""
    names = problem.names
    functions = ["" if name == "1" else f" {name}" for name in problem.basis.names]
    signals = [(c, i) for i in range(1, n + 1) for c in names.outputs]
    signals += [(c, i) for i in (*range(1, n + 1), 0) for c in names.inputs]
    return [(f"{c.name}(k{f'-{i}' * (i > 0)}){function}", c.unit) for c, i in signals for function in functions]


def _standard_deviation(Psi: np.ndarray, y: np.ndarray, lengths: Sequence[int]) -> np.ndarray:
    """sqrt diag (Psi'Psi)^-1 M (Psi'Psi)^-1 with M the long-run covariance of psi(k) e(k), summed within records."""
    Q, back = orthonormal_range(Psi)
    e = y - Q @ (Q.T @ y)
    score = Q * e[:, None]
    lags = int(4 * (len(y) / 100) ** (2 / 9))  # Newey and West 1994
    M = np.zeros((Q.shape[1], Q.shape[1]))
    for part in np.split(score, np.cumsum(lengths)[:-1]):
        M += part.T @ part
        for lag in range(1, min(lags, len(part) - 1) + 1):
            cross = (1 - lag / (lags + 1)) * part[lag:].T @ part[:-lag]
            M += cross + cross.T
    return np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", back, M, back), 0.0))


__all__ = [
    "L2",
    "SSM",
    "Candidate",
    "FittedZero",
    "LInf",
    "NotSolvedError",
    "Plain",
    "RawSignals",
    "SSMSweep",
    "ScheduledMean",
    "UnitColumns",
]
