"""Does an input act on an output within the sample? A held input of a sampled machine does not, a measured signal may."""

import numpy as np

from workbench.advice import feedback
from workbench.data import Dataset, Experiment
from workbench.metrics import fit
from workbench.records import field, record

#: FIT points by which a free run must improve: in open loop, and where feedback could have put noise into the inputs.
GAIN_OPEN, GAIN_CLOSED = 2.0, 10.0


def acts_at_once(dataset: Dataset, order: int = 4) -> bool:
    """Whether y(k) = sum_i a_i y(k-i) + sum_i b_i u(k-i) + c runs free clearly better with b_0 u(k) than without it.

    A controller computes u(k) from y(k), noise included, so in closed loop a regression on u(k) explains noise. A record
    that logs its set-points is a controlled loop with held inputs, and there the answer is no. Where feedback is found
    without them, the free run must gain 10 points of FIT (mean over outputs), in open loop 2. A machine that only its loop
    holds has no free run to compare: there u(k) tells y(k) by the inverse of the controller, and the answer is no.
    """
    first = dataset.experiments[0]
    unknowns = order * len(first.names_of("output")) + (order + 1) * len(first.names_of("input")) + 1
    if min(len(e) for e in dataset) < 2 * unknowns + order:  # too short to tell; the method says so itself
        return False
    if any(e.names_of("reference") for e in dataset) or not (first.names_of("input") and first.names_of("output")):
        return False
    at_once, late = (Arx.of(dataset, order, first) for first in (0, 1))
    gain = at_once.free_fit(dataset) - late.free_fit(dataset)
    if gain < GAIN_OPEN:
        return False
    return not any(feedback(e).detected for e in dataset) or (gain >= GAIN_CLOSED and late.radius < 1.0)


@record
class Arx:
    """y(k) = sum_i a_i y(k-i) + sum_i b_i u(k-i) + c, i of u from `first` on: coefficients theta (rows, ny) by least squares."""

    order: int
    first: int
    theta: np.ndarray = field("rows ny")

    @classmethod
    def of(cls, dataset: Dataset, order: int, first: int) -> "Arx":
        rows = [_regressors(e, order, first) for e in dataset]
        Phi, Y = (np.vstack(side) for side in zip(*rows, strict=True))
        return cls(order, first, np.linalg.lstsq(Phi, Y, rcond=None)[0])

    @property
    def radius(self) -> float:
        """Largest modulus of a pole."""
        ny = self.theta.shape[1]
        companion = np.eye(ny * self.order, k=-ny)
        companion[:ny] = self.theta[: ny * self.order].T
        return float(np.abs(np.linalg.eigvals(companion)).max())

    def free_fit(self, dataset: Dataset) -> float:
        """Mean free-run FIT [%] on the records; floored at 0."""
        fits, order = [], self.order
        for e in dataset:
            y = e[e.names_of("output")]
            back = y.shape[1] * order
            forced = _regressors(e, order, self.first)[0][:, back:] @ self.theta[back:]
            simulated = y.copy()
            with np.errstate(over="ignore", invalid="ignore"):
                for k in range(order, len(y)):
                    simulated[k] = simulated[k - order : k][::-1].ravel() @ self.theta[:back] + forced[k - order]
            fits += [max(fit(y[order:, i], simulated[order:, i]), 0.0) for i in range(y.shape[1])]
        return float(np.mean(fits))


def _regressors(e: Experiment, order: int, first: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of y(k-1), .., u(k-first), .., 1, and the outputs y(k), k from `order` on."""
    u, y = e[e.names_of("input")], e[e.names_of("output")]
    return np.column_stack([_past(y, order, 1), _past(u, order, first), np.ones(len(y) - order)]), y[order:]


def _past(x: np.ndarray, order: int, first: int) -> np.ndarray:
    """x(k - first), .., x(k - order) side by side for k = order .. N - 1."""
    return np.column_stack([x[order - i : len(x) - i] for i in range(first, order + 1)])
