"""The estimation records as the regressions see them: columns of past signals times basis functions, and their zero."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from workbench.basis import CONSTANT, Basis, Powers
from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.identification.feedthrough import acts_at_once
from workbench.identification.schedules import check_variables, polynomials_over, schedules_of, spans_of
from workbench.identification.sparse import orthonormal_range
from workbench.identification.subspace import channels_of
from workbench.lpv import OperatingPoint, ends, scheduled
from workbench.records import field, record

if TYPE_CHECKING:
    from workbench.identification.ssm.options import SSM

EXPONENTS = np.array([0.0, 1, 2, 3, 4, -1, -2, -3])  # [1] section 1.4.3
DEGREES = {2: 4, 3: 3, 4: 2, 5: 2, 6: 1}  # of the polynomials in several schedules: 15, 20, 15, 21, 7 of them


@record
class Names:
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    schedules: tuple[Channel, ...]


@record
class Signals:
    """One record in deviations from the operating point: u (N, nu), y (N, ny), phi (N, m)."""

    u: np.ndarray = field("N nu")
    y: np.ndarray = field("N ny")
    phi: np.ndarray = field("N m")


class Problem:
    """The estimation records as the regressions see them: basis, span, operating point, signals."""

    def __init__(self, options: "SSM", dataset: Dataset):
        self.options, self.dataset, self.dt = options, dataset, dataset.dt
        self.names = _names(dataset)
        self.basis, self.spans = _basis_and_spans(options.basis, dataset, self.names.schedules)
        self.own = any(c.has_role("output") for c in self.names.schedules)  # the schedule is an output
        longest = max(options._orders)
        for e in dataset:
            if len(e) <= 2 * longest:
                raise InputError(f"{len(e)} samples for order {longest}", file=e.name, mend="give longer records or lower orders")
        # direct(m): 1 for the constant function, by which alone u(k) is multiplied, or all 0 without a feed-through
        self.direct = _direct(self.basis, acts_at_once(dataset) if options.feedthrough is None else options.feedthrough)
        self.point = options.operating_point.of(self, dataset)
        self.signals = [self.signals_of(e, self.point) for e in dataset]

    def signals_of(self, e: Experiment, point: OperatingPoint) -> Signals:
        """The record in deviations from `point`."""
        rho = np.clip(scheduled(e, self.names.schedules), *ends(self.spans))
        level = point.basis(rho)
        u = e[[c.name for c in self.names.inputs]] - level @ point.u
        y = e[[c.name for c in self.names.outputs]] - level @ point.y
        return Signals(u, y, self.basis(rho))

    def regression(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        """Psi (rows, nr m) and Y (rows, ny), row blocks by record."""
        blocks = [regressors(s, n, self.direct) for s in self.signals]
        return np.vstack(blocks), np.vstack([s.y[n:] for s in self.signals])


def _names(dataset: Dataset) -> Names:
    first = dataset.experiments[0]
    inputs, outputs = channels_of(first)
    return Names(inputs, outputs, schedules_of(first))


def _basis_and_spans(basis: Basis | None, dataset: Dataset, schedules: Sequence[Channel]) -> tuple[Basis, np.ndarray]:
    if not schedules:
        return CONSTANT, np.zeros((0, 2))
    spans = spans_of(dataset, schedules)
    if basis is not None:
        check_variables(basis, schedules)
        return basis, spans
    if len(schedules) > 1:
        return polynomials_over(spans, DEGREES[len(schedules)]), spans
    if spans[0, 0] * spans[0, 1] <= 0:  # where it may be zero there is no 1/rho
        return Powers(EXPONENTS[EXPONENTS >= 0], float(np.abs(spans).max()) or 1.0), spans
    return Powers(EXPONENTS, middle(spans)), spans


def middle(rho: np.ndarray) -> float:
    """A positive scale at which powers of the schedule are of order one."""
    return float(np.abs(0.5 * (rho.min() + rho.max()))) or 1.0


def _direct(basis: Basis, wanted: bool) -> np.ndarray:
    if not wanted:
        return np.zeros(len(basis.names))
    constant = np.array([name == "1" for name in basis.names], dtype=float)
    if not constant.any():
        raise InputError("a feed-through needs a basis with the constant 1", mend="use Powers with exponent 0")
    return constant


def regressors(s: Signals, n: int, direct: np.ndarray) -> np.ndarray:
    """Psi (N - n, nr m): y(k-1) .. y(k-n), u(k-1) .. u(k-n) [1] eq. (1.7) times all basis functions, u(k) times `direct`."""
    k = np.arange(n, len(s.y))
    past = [s.y[k - i, :, None] * s.phi[k - n, None, :] for i in range(1, n + 1)]
    past += [s.u[k - i, :, None] * s.phi[k - i, None, :] for i in range(1, n + 1)]
    past += [s.u[k, :, None] * direct]
    return np.concatenate(past, axis=1).reshape(len(k), -1)


def zero(signals: Sequence[Signals], direct: np.ndarray, n: int) -> np.ndarray:
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


def _bias_criterion(signals: Sequence[Signals], direct: np.ndarray, n: int) -> Callable[[np.ndarray], float]:
    """y0 -> sum over outputs of log ||e||^2, e the least squares error of the recursion in y - y0.

    (y(k-i) - y0) phi_j(p(k-n)) and y(k) - y0 are sums of columns that do not depend on y0, so one triangle serves all y0.
    """
    ny, m = signals[0].y.shape[1], signals[0].phi.shape[1]
    blocks = [np.column_stack([regressors(s, n, direct), s.phi[:-n], s.y[n:], np.ones(len(s.y) - n)]) for s in signals]
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
