"""Are a model's one-step residuals white, and free of the inputs? Calibrated tests, family-wise over all channels.

[1] G. M. Ljung, G. E. P. Box, "On a measure of lack of fit in time series models", Biometrika 65 (1978).
[2] M. S. Bartlett, "Some aspects of the time-correlation problem in regard to tests of significance", J. Royal Statistical
    Society 98 (1935).
[3] L. Ljung, "System Identification: Theory for the User", 2nd ed. (1999), section 16.6.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from workbench.advice import feedback
from workbench.data import Experiment
from workbench.errors import InputError
from workbench.hammerstein import Model
from workbench.records import field, record

Kind = Literal["whiteness", "input"]


@record
class ResidualCheck:
    """One hypothesis: the residual of `output` is white, or uncorrelated with `input` shifted by `lags`.

    correlation[i] belongs to lags[i]; `bound` is the 99 % limit of a single lag under the hypothesis. `p_family` is
    `p_value` corrected for all checks of the test (Holm): below 0.05, the hypothesis is rejected.
    """

    kind: Kind
    output: str
    input: str
    lags: np.ndarray = field("n")
    correlation: np.ndarray = field("n", low=-1.0 - 1e-9, high=1.0 + 1e-9)
    bound: float = field("", low=0.0)
    statistic: float = field("", low=0.0)
    dof: int
    p_value: float = field("", low=0.0, high=1.0)
    p_family: float = field("", low=0.0, high=1.0, default=1.0)


@record
class ResidualTest:
    """All checks of one model on one record; `closed_loop` says which lags of the inputs could be judged."""

    model: str
    record: str
    closed_loop: bool
    checks: tuple[ResidualCheck, ...]
    level: float = 0.05

    @property
    def rejected(self) -> tuple[ResidualCheck, ...]:
        return tuple(c for c in self.checks if c.p_family < self.level)

    @property
    def passed(self) -> bool:
        return not self.rejected

    def __str__(self) -> str:
        head = f"{self.model} on {self.record}: "
        if self.passed:
            return head + "residuals are white and free of the inputs, as far as this record shows"
        what = [
            f"{c.output} is not white" if c.kind == "whiteness" else f"{c.output} still contains {c.input}" for c in self.rejected
        ]
        return head + "residual of " + ", of ".join(what)


def residual_test(model: Model, experiment: Experiment, *, lags: int = 25, closed_loop: bool | None = None) -> ResidualTest:
    """e(k) = y(k) - y(k | k-1) after the warm-up: whiteness of each output's, and correlation with each input.

    Open loop: e(t) against u(t - k), k = -lags .. lags. Closed loop: k = 1 .. lags only, because later inputs answer past
    noise whatever the model. closed_loop: default what the record shows (`advice.feedback`).
    The p-values hold for records that the model was not estimated on; on those that it was, they are too large.
    Raises InputError for fewer than four times `lags` samples after the warm-up.

    Sources: Ljung and Box, Biometrika 65 (1978); Bartlett, J. Royal Statistical Society 98 (1935); L. Ljung, "System
    Identification", 2nd ed. (1999), section 16.6.

        >>> residual_test(model, held_out.experiments[0]).passed
        False
    """
    warmup = model.warmup
    if len(experiment) - warmup < 4 * lags:
        raise InputError(
            f"{len(experiment) - warmup} samples after the warm-up for {lags} lags",
            file=experiment.name,
            mend="use a longer record or, in Python, fewer lags",
        )
    names = [c.name for c in model.outputs]
    e = (experiment[names] - model.predict(experiment))[warmup:]
    if not np.isfinite(e).all():
        raise InputError(
            f"one-step predictions of model {model.name!r} leave the numbers: it is unstable on this record",
            file=experiment.name,
            mend="identify again, with another order or method",
        )
    u = experiment[[c.name for c in model.inputs]][warmup:]
    closed = feedback(experiment).detected if closed_loop is None else closed_loop
    checks = [_whiteness(name, e[:, j], lags) for j, name in enumerate(names)]
    checks += [
        _cross(name, channel.name, e[:, j], u[:, i], lags, closed)
        for j, name in enumerate(names)
        for i, channel in enumerate(model.inputs)
        if np.ptp(u[:, i]) > 0
    ]
    return ResidualTest(model.name, experiment.name, closed, _holm(checks))


def _whiteness(output: str, e: np.ndarray, lags: int) -> ResidualCheck:
    """Q = N (N + 2) sum_k r(k)^2 / (N - k), chi-squared with `lags` degrees of freedom for white e. [1]"""
    from scipy.stats import chi2

    N, k = len(e), np.arange(1, lags + 1)
    r = _correlation(e, e, k)
    Q = N * (N + 2) * np.sum(r**2 / (N - k))
    return ResidualCheck("whiteness", output, "", k, r, 2.576 / np.sqrt(N), float(Q), lags, float(chi2.sf(Q, lags)))


def _cross(output: str, source: str, e: np.ndarray, u: np.ndarray, lags: int, closed: bool) -> ResidualCheck:
    """Q = N r' P^-1 r, P(i, j) = sum_k r_e(k) r_u(k + i - j): chi-squared for e independent of u. [2], [3] (16.69)

    Neighbouring lags of a smooth input are nearly the same test: P takes that out, and its rank is what is left. In closed
    loop e is an innovation under the hypothesis, so r_e is 1 at lag 0 and nothing else.
    """
    from scipy.stats import chi2

    N = len(e)
    k = np.arange(1, lags + 1) if closed else np.arange(-lags, lags + 1)
    r = _correlation(e, u, k)
    reach = len(k) - 1
    r_u = _correlation(u, u, np.arange(reach + 2 * lags + 1))
    r_e = np.zeros(2 * lags + 1)
    r_e[0] = 1.0
    if not closed:
        # the triangle keeps P non-negative
        r_e = _correlation(e, e, np.arange(2 * lags + 1)) * (1.0 - np.arange(2 * lags + 1) / (2 * lags + 1))
    both = np.concatenate([r_e[:0:-1], r_e])
    shifts = np.arange(-2 * lags, 2 * lags + 1)
    row = np.array([both @ r_u[np.abs(shifts + d)] for d in range(reach + 1)])
    value, vector = np.linalg.eigh(row[np.abs(np.subtract.outer(k, k))])
    seen = value > 1e-3 * value[-1]  # directions the input does not excite carry no test
    Q = float(N * np.sum((vector[:, seen].T @ r) ** 2 / value[seen]))
    dof = int(seen.sum())
    bound = 2.576 * float(np.sqrt(max(row[0], 0.0) / N))
    return ResidualCheck("input", output, source, k, r, bound, Q, dof, float(chi2.sf(Q, dof)))


def _correlation(a: np.ndarray, b: np.ndarray, lags: Sequence[int] | np.ndarray) -> np.ndarray:
    """r(k) = sum_t a(t) b(t - k) / sqrt(sum a^2 sum b^2), means taken out."""
    a, b = (x / max(float(np.abs(x).max()), 1e-300) for x in (a, b))  # what is huge has no square
    a, b = a - a.mean(), b - b.mean()
    size = np.sqrt((a @ a) * (b @ b))
    if size == 0.0:
        return np.zeros(len(lags))
    return np.array([a[k:] @ b[: len(b) - k] if k >= 0 else a[:k] @ b[-k:] for k in map(int, lags)]) / size


def _holm(checks: Sequence[ResidualCheck]) -> tuple[ResidualCheck, ...]:
    """Family-wise p-values: sorted, times the number of hypotheses still standing, never decreasing."""
    order = np.argsort([c.p_value for c in checks])
    corrected, floor = list(checks), 0.0
    for rank, i in enumerate(order):
        floor = min(1.0, max(floor, (len(checks) - rank) * checks[i].p_value))
        corrected[i] = replace(checks[i], p_family=floor)
    return tuple(corrected)
