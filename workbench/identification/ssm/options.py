"""Options of SSM identification: what is charged for a coefficient, where signals are counted from, orders and bounds."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.basis import CONSTANT, Basis, Powers, constant
from workbench.data import Dataset
from workbench.errors import InputError
from workbench.identification.schedules import polynomials_over
from workbench.identification.sparse import L2, Bound, LInf
from workbench.identification.ssm.model import observer_form
from workbench.identification.ssm.regression import Problem, middle, zero
from workbench.identification.ssm.sweep import SSMSweep, sweep
from workbench.lpv import LPVModel, OperatingPoint, scheduled
from workbench.records import field, record

# mu "slightly larger than the minimum", [1] section 1.4.3; the largest error of thousands is rarer than their energy says
FACTORS: dict[type, tuple[float, ...]] = {L2: (1.02, 1.05, 1.1, 1.2), LInf: (1.1, 1.2, 1.5, 2.0)}


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

    def of(self, problem: Problem, dataset: Dataset) -> OperatingPoint:
        del dataset
        names = problem.names
        basis = constant(len(names.schedules))
        return OperatingPoint(basis, np.zeros((1, len(names.inputs))), np.zeros((1, len(names.outputs))))


@record
class FittedZero:
    """u0 = 0, y0 constant: the reading of each output at which the recursion has no bias.

    A recursion without a constant term needs the physical zero of its outputs, and a gauge may be set to zero anywhere
    (a dancer angle that stands at 0 at the nominal tension). y0 minimises the squared one-step error, all coefficients
    refitted, at a low order; an output keeps y0 = 0 unless its own zero lowers N log(error) by more than log N (BIC).
    """

    order: int = 3

    def of(self, problem: Problem, dataset: Dataset) -> OperatingPoint:
        raw = RawSignals().of(problem, dataset)
        signals = [problem.signals_of(e, raw) for e in dataset]
        return replace(raw, y=zero(signals, problem.direct, min(self.order, max(problem.options._orders)))[None])


@record
class ScheduledMean:
    """u0(rho), y0(rho): polynomials of this degree in the schedule, fitted to the signals of the estimation records.

    Deviations lose what the levels say about the gain at low frequency; use it for a machine whose levels are not
    related by the same recursion as its deviations.
    """

    degree: int = 1

    def of(self, problem: Problem, dataset: Dataset) -> OperatingPoint:
        names = problem.names
        if problem.own:
            raise InputError(
                "the mean output at every value of an output is that value: nothing is left to model",
                channel=names.schedules[0].name,
                mend="use FittedZero or RawSignals where the schedule is an output",
            )
        rho = np.concatenate([scheduled(e, names.schedules) for e in dataset])
        if len(names.schedules) > 1:
            basis = polynomials_over(problem.spans, self.degree)
        else:
            basis = Powers(np.arange(self.degree + 1.0), middle(rho)) if names.schedules else CONSTANT
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
    A schedule that is an output is read in f and g as any other, up to y(k-1); free runs, and poles, are of the recursion that
    schedules itself.
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
        problem = Problem(self, dataset)
        return replace(observer_form(problem, sweep(problem, None).best), trained_on=dataset.fingerprints)

    def sweep(self, dataset: Dataset, validation: Dataset | None = None) -> "SSMSweep":
        """Every order and mu: support, stability, free-run FIT on the records and, where given, on held-out ones."""
        return sweep(Problem(self, dataset), validation)
