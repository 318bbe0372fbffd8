"""Is a named effect real? What it gains on records left out, and whether it has the same size in all of them.

All use the normal equations of the fit. A fold f in the light of the others r, with A = J'J + priors and b = J'e + priors:

    -2 log p(y_f | y_r) = |e_f|^2 + log det S_f + (b_r' A_r^-1 b_r - b' A^-1 b) + (log det A - log det A_r)
"""

from functools import cached_property

import numpy as np
from scipy.stats import chi2

from workbench.diagnosis.fit import _evaluate
from workbench.diagnosis.normal import eigen, inverse, solve
from workbench.diagnosis.predictor import Point
from workbench.diagnosis.refit import Model
from workbench.records import field, record

BLOCKS = 8  # at least, for a standard error
SURE, HAIR = 40.0, 6.0  # twice the log-likelihood: a gain that no chance gives, and a loss that says nothing
ORDER = 3.0  # standard deviations of a size before anything is seen, over the size that was found
NONE = 1e-100  # a size at its bound of 0 stays there
PIECES = 4  # one record is cut into so many
SHARES = (1.0, 0.5, 0.25, 0.0)  # of a step to the fit without a fold, of which the best is taken


@record
class Fold:
    """Samples of record i that are left out together."""

    record: int
    first: int
    last: int


def folds(model: Model, *, least: int = 1) -> list[Fold]:
    """Every record, or pieces of a single one; least: the number of pieces that a record is cut into where there are more."""
    lengths = [len(r) for r in model.predictor.records]
    pieces = least if len(lengths) > 1 else PIECES
    return [Fold(i, N * k // pieces, N * (k + 1) // pieces) for i, N in enumerate(lengths) for k in range(pieces)]


def left_out_points(model: Model) -> list[tuple[Fold, Point]]:
    """Parts that cover the records, and for each what the fit finds without it; where the record starts is found with it.

    From the fit to all a Gauss-Newton step, of which the share is taken that suits the other parts best. No record is left out
    whole: the others do not know at which angle its periodic effects are.
    """
    fit, found, A, nx = model.fit, [], model.fit.information, model.fit.unknowns.split[1]
    for fold in folds(model, least=max(2, -(-PIECES // len(model.predictor.records)))):
        A_r, _, _, b_f = _normal(model, fold)
        step = solve(A_r, b_f)
        begins = fit.unknowns.split[0] + fold.record * nx + np.arange(nx)
        rest = np.delete(np.arange(len(step)), begins)
        step[begins] = -inverse(A[np.ix_(begins, begins)]) @ A[np.ix_(begins, rest)] @ step[rest]
        step = step if np.isfinite(step).all() else np.zeros(len(step))  # a plant that is lost along its records stays so
        tried = _evaluate(model.predictor, fit.unknowns, [fit.unknowns.clip(fit.z + s * step) for s in SHARES], fit.jacobian)
        costs = []
        for one in tried:
            own = float(np.sum(one.errors[fold.record][fold.first : fold.last] ** 2))
            costs.append(one.cost - own if np.isfinite(one.cost) else np.inf)
        found.append((fold, fit.unknowns.point(tried[int(np.argmin(costs))].z)))
    return found


@record
class LeftOut:
    """Gain of log-likelihood, twice, on what was left out: by fold, and the standard error of the sum by blocks of a second."""

    by_fold: np.ndarray = field("f")
    error: float

    @cached_property
    def total(self) -> float:
        return float(self.by_fold.sum())

    @property
    def holds(self) -> bool:
        """More than two standard errors in all, or a gain that no chance gives; and no loss in most folds.

        What shows in a few blocks only has a large standard error however sure it is. A fold that the effect does not touch
        neither gains nor loses.
        """
        return (self.total > 2.0 * self.error or self.total > SURE) and bool(np.mean(self.by_fold > -1.0) > 0.5)

    @property
    def loses(self) -> bool:
        """Whether what was left out is predicted worse, by more than two standard errors and more than a HAIR."""
        return self.total < -max(2.0 * self.error, HAIR)


def left_out(base: Model, extended: Model) -> LeftOut:
    """What the extension gains on each fold, predicted from the others with all that they leave open."""
    gains = np.array([_surprise(base, fold) - _surprise(extended, fold) for fold in folds(base)])
    joined = by_block(base, extended)
    return LeftOut(gains, float(np.sqrt(len(joined)) * joined.std()))


def by_block(base: Model, extended: Model) -> np.ndarray:
    """By how much the deviance of the extended model is lower in each block of the records, long enough to be independent."""
    total = sum(len(r) for r in base.predictor.records)
    length = max(5, min(base.predictor.block, total // BLOCKS))
    blocks = []
    for i in range(len(base.predictor.records)):
        gain = _deviances(base, i) - _deviances(extended, i)
        blocks.append(np.add.reduceat(gain, np.arange(0, max(1, len(gain) - length // 2), length)))
    return np.concatenate(blocks)


def _deviances(model: Model, i: int) -> np.ndarray:
    """-2 log likelihood of every sample of record i."""
    return model.predictor.deviances(i, model.fit.errors[i])


def _surprise(model: Model, fold: Fold) -> float:
    """-2 log p(y_f | y_r) of a fold f in the light of the others r; see the module."""
    A_r, b_r, A_f, b_f = _normal(model, fold)
    (reach, log_det), (reach_r, log_det_r) = _solved(A_r + A_f, b_r + b_f), _solved(A_r, b_r)
    return float(_deviances(model, fold.record)[fold.first : fold.last].sum()) + reach_r - reach + log_det - log_det_r


def _normal(model: Model, fold: Fold) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A and b of the others with the priors, and of the fold."""
    fit, unknowns, i = model.fit, model.fit.unknowns, fold.record
    lent, pull = _lent(model)
    A_r, b_r = np.diag(unknowns.believed + lent), fit.prior + pull
    A_f, b_f = np.zeros_like(A_r), np.zeros_like(b_r)
    for j, (J, e) in enumerate(zip(fit.jacobian, fit.errors, strict=True)):
        own, ny = unknowns.columns(j), e.shape[1]
        inside = np.zeros(len(J), dtype=bool)
        if j == i:
            inside[fold.first * ny : fold.last * ny] = True
        for A, b, rows in ((A_f, b_f, inside), (A_r, b_r, ~inside)):
            A[np.ix_(own, own)] += J[rows].T @ J[rows]
            b[own] += J[rows].T @ e.ravel()[rows]
    return A_r, b_r, A_f, b_f


def _lent(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Information (n) for what has no prior, and its pull: without any, a fold could not be predicted from the others at all.

    A size is taken to be of the order of what was found, a rotation is anything from -pi to pi about what was found.
    """
    unknowns, z = model.fit.unknowns, model.fit.z
    information, pull = np.zeros(unknowns.size), np.zeros(unknowns.size)
    at = unknowns.size - unknowns.split[2]
    for t, own in zip(unknowns.terms, unknowns.of_terms(z), strict=True):
        sizes = slice(at, at + len(t.sizes))
        information[sizes] = 1.0 / max(ORDER * float(np.linalg.norm(z[sizes])), NONE) ** 2
        pull[sizes] = information[sizes] * z[sizes]
        information[at + len(t.sizes) + len(t.free) : at + len(own)] = 3.0 / np.pi**2
        at += len(own)
    return information, pull


def _solved(A: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """b' A^-1 b and log det A."""
    value, vector, d = eigen(A)
    x = vector.T @ (b / d)
    return float(x @ (x / value)), float((np.log(value) + 2.0 * np.log(d)).sum())


def stability(model: Model, key: str) -> float:
    """p-value of one and the same size of the effect in all folds: chi squared of the scores of fold-specific sizes.

    Phases and shapes are not among the sizes. The statistic is scaled by the spread of the scores of blocks, so that errors
    which are not white do not count as unstable.
    """
    fit, unknowns = model.fit, model.fit.unknowns
    mine = np.zeros(0, dtype=int)
    for t, own in zip(unknowns.terms, unknowns.places, strict=True):
        if t.key == key:
            mine = np.arange(own.start, own.start + len(t.sizes))
    others = np.setdiff1d(np.arange(unknowns.size), mine)
    mimic = inverse(fit.information[np.ix_(others, others)]) @ fit.information[np.ix_(others, mine)]
    weights = np.zeros((unknowns.size, len(mine)))
    weights[mine] = np.eye(len(mine))
    weights[others] = -mimic
    b_all, S_all, chi, freedom = np.zeros(len(mine)), np.zeros((len(mine),) * 2), 0.0, -len(mine)
    for fold in folds(model):
        ny = fit.errors[fold.record].shape[1]
        rows = slice(fold.first * ny, fold.last * ny)
        G = fit.jacobian[fold.record][rows] @ weights[unknowns.columns(fold.record)]
        e = fit.errors[fold.record][fold.first : fold.last].ravel()
        b, S = G.T @ e, G.T @ G
        if np.trace(S) < 1e-6 * np.trace(fit.information[np.ix_(mine, mine)]):
            continue
        length = ny * model.predictor.block
        parts = np.add.reduceat(G * e[:, None], np.arange(0, max(1, len(e) - length // 2), length), axis=0)
        spread = (parts - parts.mean(axis=0)).T @ (parts - parts.mean(axis=0))
        ratio = max(1.0, float(np.trace(np.linalg.pinv(S) @ spread)) / len(mine))
        chi += float(b @ np.linalg.pinv(S) @ b) / ratio
        b_all, S_all, freedom = b_all + b, S_all + S, freedom + len(mine)
    if freedom <= 0:
        return 1.0
    return float(chi2.sf(max(chi - float(b_all @ np.linalg.pinv(S_all) @ b_all), 0.0), freedom))
