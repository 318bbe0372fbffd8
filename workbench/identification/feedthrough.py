"""Does an input act on an output within the sample? A held input of a sampled machine does not, a measured signal may."""

import numpy as np

from workbench.advice import feedback
from workbench.data import Dataset, Experiment
from workbench.metrics import fit

#: FIT points by which a free run must improve: in open loop, and where feedback could have put noise into the inputs.
GAIN_OPEN, GAIN_CLOSED = 2.0, 10.0


def acts_at_once(dataset: Dataset, order: int = 4) -> bool:
    """Whether y(k) = sum_i a_i y(k-i) + sum_i b_i u(k-i) + c runs free clearly better with b_0 u(k) than without it.

    A controller computes u(k) from y(k), noise included, so in closed loop a regression on u(k) explains noise. A record
    that logs its set-points is a controlled loop with held inputs, and there the answer is no. Where feedback is found
    without them, the free run must gain 10 points of FIT (mean over outputs), in open loop 2.
    """
    first = dataset.experiments[0]
    unknowns = order * len(first.names_of("output")) + (order + 1) * len(first.names_of("input")) + 1
    if min(len(e) for e in dataset) < 2 * unknowns + order:  # too short to tell; the method says so itself
        return False
    if any(e.names_of("reference") for e in dataset) or not (first.names_of("input") and first.names_of("output")):
        return False
    gain = _free_run_fit(dataset, order, first=0) - _free_run_fit(dataset, order, first=1)
    if gain < GAIN_OPEN:
        return False
    return bool(gain >= GAIN_CLOSED or not any(feedback(e).detected for e in dataset))


def _free_run_fit(dataset: Dataset, order: int, first: int) -> float:
    """Mean free-run FIT [%] on the records of an ARX model with bias whose inputs begin at lag `first`; floored at 0."""
    signals = [_signals(e) for e in dataset]
    rows = [(_past(y, order, 1), _past(u, order, first), y[order:]) for u, y in signals]
    Phi = np.vstack([np.column_stack([a, b, np.ones(len(a))]) for a, b, _ in rows])
    theta = np.linalg.lstsq(Phi, np.vstack([target for *_, target in rows]), rcond=None)[0]
    fits = []
    for (_, driven, target), (_, y) in zip(rows, signals, strict=True):
        back = y.shape[1] * order
        forced = np.column_stack([driven, np.ones(len(driven))]) @ theta[back:]
        simulated = y.copy()
        with np.errstate(over="ignore", invalid="ignore"):
            for k in range(order, len(y)):
                simulated[k] = simulated[k - order : k][::-1].ravel() @ theta[:back] + forced[k - order]
        fits += [max(fit(target[:, i], simulated[order:, i]), 0.0) for i in range(y.shape[1])]
    return float(np.mean(fits))


def _signals(e: Experiment) -> tuple[np.ndarray, np.ndarray]:
    return e[e.names_of("input")], e[e.names_of("output")]


def _past(x: np.ndarray, order: int, first: int) -> np.ndarray:
    """x(k - first), .., x(k - order) side by side for k = order .. N - 1."""
    return np.column_stack([x[order - i : len(x) - i] for i in range(first, order + 1)])
