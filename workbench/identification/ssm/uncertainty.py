"""Intervals and standard deviations of the coefficients, and the covariance of the one-step error."""

from collections.abc import Sequence

import numpy as np

from workbench.identification.sparse import orthonormal_range
from workbench.identification.ssm.regression import Problem
from workbench.identification.ssm.sweep import Candidate
from workbench.lpv import Estimate


def uncertainty(problem: Problem, best: Candidate) -> tuple[tuple[Estimate, ...], np.ndarray]:
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


def _labels(problem: Problem, n: int) -> list[tuple[str, str]]:
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
