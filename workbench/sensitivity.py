"""What an output of a sweep depends on: each factor's share, with its 95 % interval.

    Morris      mu* = mean |f(.., x_i + step, ..) - f(x)| / step       over trajectories through the whole range of all factors
    Sobol       S_i = V(E(f | x_i)) / V(f),   S_Ti = 1 - V(E(f | x_others)) / V(f)      alone, and with all that it acts with
    rank        Spearman's correlation of factor and output, where the design is neither of the two

A factor counts from 0 to 1 over its range (its logarithm where it varies by factors, its place in a list of values): mu* is what
going through all of the range changes. Outputs of one set of values are averaged over the seeds first. Computed by SALib [1].

[1] J. Herman, W. Usher, "SALib: an open-source Python library for sensitivity analysis", JOSS 2(9), 2017.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from workbench.errors import InputError
from workbench.records import record
from workbench.sweeps.design import LEVELS, Sweep
from workbench.sweeps.rows import Rows

SURE = 0.95


@record
class Index:
    """How much one output depends on one factor: the number of `kind` with its interval; unit: of the number.

    beside: for Morris the spread sigma of the effects (large: curved, or together with others), for Sobol the total S_T.
    """

    output: str
    factor: str
    kind: str
    value: float
    low: float
    high: float
    unit: str = ""
    beside: float = float("nan")

    @property
    def weight(self) -> float:
        """What factors are ordered by: a share of the variance with all that it acts together with, else the size."""
        return max(self.beside, 0.0) if self.kind == "S" else abs(self.value)


def sensitivity(sweep: Sweep, found: Rows) -> tuple[Index, ...]:
    """An index for every output and factor that has one. Raises InputError where runs of a Morris or Sobol design are missing.

    Rank correlations leave out runs that failed, outputs that never change, and factors that are texts.
    """
    outputs = [n for n in found.names if n in found.units and n not in found.parameters]
    values = {name: _averaged(sweep, found, name) for name in outputs}
    if sweep.design not in ("morris", "sobol-indices"):
        return tuple(i for name in outputs for i in _ranked(sweep, found, name, values[name]))
    if missing := [name for name in outputs if not np.isfinite(values[name]).all()]:
        failed = int(sum(~np.isfinite(values[missing[0]])))
        mend = "a narrower range in which every run comes to its end"
        raise InputError(f"no indices of {missing[0]}: {failed} sets of values have no number", file="sweep", mend=mend)
    X, problem = sweep.shares(), sweep.problem
    # of two values the second is reached by every step, which is LEVELS / 2 of LEVELS - 1 parts of a range
    scale = np.array([0.5 * LEVELS / (LEVELS - 1) if len(p.values) == 2 else 1.0 for p in sweep.factors])
    made: list[Index] = []
    for name in outputs:
        Y = values[name]
        if np.ptp(Y) <= 1e-12 * np.abs(Y).max():
            continue  # nothing moves it
        made += _morris(problem, X, Y, name, found.units[name], scale) if sweep.design == "morris" else _sobol(problem, Y, name)
    return tuple(made)


def _averaged(sweep: Sweep, found: Rows, name: str) -> np.ndarray:
    """The output of every set of values, its mean over the seeds; NaN where a run is missing."""
    seeds, i, run = len(sweep.seeds), found.names.index(name), found.names.index("run")
    every = np.full(len(sweep.points()), np.nan)
    for row in found.rows:
        every[row[run]] = np.nan if row[i] is None else row[i]
    return every.reshape(-1, seeds).mean(axis=1)


def _morris(
    problem: dict[str, Any], X: np.ndarray, Y: np.ndarray, output: str, unit: str, scale: np.ndarray
) -> list[Index]:  # fmt: skip
    """scale: what a step of the design is of the step that the factor really makes."""
    from SALib.analyze.morris import analyze

    got = analyze(problem, X, Y, conf_level=SURE, num_levels=LEVELS, seed=0)
    parts = zip(got["names"], got["mu_star"], got["mu_star_conf"], got["sigma"], strict=True)
    return [
        Index(output, name, "mu*", m * k, max((m - c) * k, 0.0), (m + c) * k, unit, s * k)
        for (name, *rest), k in zip(parts, scale, strict=True)
        for m, c, s in [map(float, rest)]
    ]


def _sobol(problem: dict[str, Any], Y: np.ndarray, output: str) -> list[Index]:
    from SALib.analyze.sobol import analyze

    got = analyze(problem, Y, calc_second_order=False, conf_level=SURE, seed=0)
    parts = zip(problem["names"], got["S1"], got["S1_conf"], got["ST"], strict=True)
    return [Index(output, name, "S", float(v), float(v - c), float(v + c), "", float(t)) for name, v, c, t in parts]


def _ranked(sweep: Sweep, found: Rows, output: str, Y: np.ndarray) -> list[Index]:
    from scipy.stats import spearmanr

    sets = sweep.points()[:: len(sweep.seeds)]
    made = []
    for factor in sweep.factors:
        x = [point.values[factor.name] for point in sets]
        if any(isinstance(v, str) for v in x):
            continue
        keep, numbers = np.isfinite(Y), np.array(x, dtype=float)
        if keep.sum() < 4 or np.ptp(numbers[keep]) == 0.0 or np.ptp(Y[keep]) == 0.0:
            continue
        result: Any = spearmanr(numbers[keep], Y[keep])
        r = float(result.statistic)
        # Fisher's transformation, with the variance of ranks (Fieller, Hartley and Pearson 1957)
        width = 1.959964 * np.sqrt(1.06 / (keep.sum() - 3))
        middle = np.arctanh(np.clip(r, -1.0 + 1e-12, 1.0 - 1e-12))
        made.append(Index(output, factor.name, "rank", r, float(np.tanh(middle - width)), float(np.tanh(middle + width))))
    return made


@record
class ResponseSurface:
    """f ~ c0 + sum_i c_i z_i + sum_ij c_ij z_i z_j,   z: factors from -1 to 1 over the range of the runs.

    coefficients in the order of `_terms`; explained: share of the variance between runs that it explains (R squared, adjusted).
    """

    names: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray
    coefficients: np.ndarray
    explained: float

    def over(self, x: str, y: str) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        """f over two factors, the others in the middle of their ranges; arrays of one shape."""
        i, j = self.names.index(x), self.names.index(y)

        def value(a: np.ndarray, b: np.ndarray) -> np.ndarray:
            Z = np.zeros((a.size, len(self.names)))
            for k, own in ((i, a), (j, b)):
                Z[:, k] = 2.0 * (own.ravel() - self.low[k]) / (self.high[k] - self.low[k]) - 1.0
            return (_terms(Z) @ self.coefficients).reshape(a.shape)

        return value


def response_surface(factors: Mapping[str, np.ndarray], output: np.ndarray) -> ResponseSurface | None:
    """The quadratic polynomial that fits the runs best; None where there are too few of them for its coefficients."""
    keep = np.isfinite(output)
    X, f = np.column_stack([v[keep] for v in factors.values()]), output[keep]
    if not len(f) or (np.ptp(X, axis=0) == 0.0).any() or np.ptp(f) == 0.0:
        return None
    low, high = X.min(axis=0), X.max(axis=0)
    A = _terms(2.0 * (X - low) / (high - low) - 1.0)
    coefficients, _, rank, _ = np.linalg.lstsq(A, f, rcond=1e-10)
    spare = len(f) - A.shape[1]
    if rank < A.shape[1] or spare < 1:
        return None
    left = float(np.sum((f - A @ coefficients) ** 2)) / spare
    return ResponseSurface(tuple(factors), low, high, coefficients, 1.0 - left / float(np.var(f, ddof=1)))


def _terms(Z: np.ndarray) -> np.ndarray:
    """1, z_i and z_i z_j with i <= j, of points (R, n)."""
    i, j = np.triu_indices(Z.shape[1])
    return np.column_stack([np.ones(len(Z)), Z, Z[:, i] * Z[:, j]])
