"""Is a named effect real? What it gains on records left out, and whether it has the same size in all of them.

Both use the normal equations of the fit: without a record, parameters and effects move to (A - A_f)^-1 (b_f - b); where that
record starts, and its phases, are found on the record itself.
"""

from functools import cached_property

import numpy as np
from scipy.stats import chi2

from workbench.diagnose.fit import Fit, _inverse
from workbench.diagnose.refit import Model
from workbench.records import field, record

SURE = 40.0  # twice the log-likelihood
PIECES = 4  # one record is cut into so many


@record
class Fold:
    """Samples of record i that are left out together."""

    record: int
    first: int
    last: int
    whole: bool


def folds(model: Model) -> list[Fold]:
    """Every record, or pieces of a single one."""
    lengths = [len(r) for r in model.predictor.records]
    if len(lengths) > 1:
        return [Fold(i, 0, N, True) for i, N in enumerate(lengths)]
    return [Fold(0, lengths[0] * k // PIECES, lengths[0] * (k + 1) // PIECES, False) for k in range(PIECES)]


@record
class LeftOut:
    """Gain of log-likelihood, twice, on what was left out: by fold, and its standard error from blocks of a second."""

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


def left_out(base: Model, extended: Model) -> LeftOut:
    """What the extension gains on each fold when that fold takes no part in the fit."""
    length = max(5, round(1.0 / base.predictor.plant.dt))
    gains, blocks = [], []
    for fold in folds(base):
        before, after = _predictive(base, fold), _predictive(extended, fold)
        gain = before - after
        gains.append(gain.sum())
        blocks.append(np.add.reduceat(gain, np.arange(0, max(1, len(gain) - length // 2), length)))
    joined = np.concatenate(blocks)
    return LeftOut(np.array(gains), float(np.sqrt(len(joined)) * joined.std()))


def _predictive(model: Model, fold: Fold) -> np.ndarray:
    """-2 log likelihood of every sample of a fold, predicted by a fit without it."""
    fit, unknowns = model.fit, model.fit.unknowns
    i, ny = fold.record, fit.errors[fold.record].shape[1]
    rows = slice(fold.first * ny, fold.last * ny)
    own = unknowns.columns(i)
    J, e = fit.jacobian[i][rows], fit.errors[i][fold.first : fold.last].ravel()
    A = fit.information.copy()
    A[np.ix_(own, own)] -= J.T @ J
    b = fit.gradient.copy()
    b[own] -= J.T @ e
    A[np.diag_indices_from(A)] += 1e-9 * np.abs(np.diag(fit.information)) + 1e-12
    D = _own_directions(fit, fold)
    A += D @ (D.T @ fit.information @ D) @ D.T  # what only the fold tells must not run away where the others are silent
    move = -_inverse(A) @ b
    e = e + J @ (move - D @ (D.T @ move))[own]
    if D.size:
        N = J @ D[own]
        prior, pull = D.T @ np.diag(unknowns.believed.astype(float)) @ D, D.T @ fit.prior
        e = e - N @ np.linalg.lstsq(N.T @ N + prior, N.T @ e + pull, rcond=None)[0]
    W = model.predictor.passes[i].whitening[fold.first : fold.last]
    log_det = -2.0 * np.log(np.einsum("kii->ki", W)).sum(axis=1)
    return (e.reshape(-1, ny) ** 2).sum(axis=1) + log_det


def _own_directions(fit: Fit, fold: Fold) -> np.ndarray:
    """Orthonormal directions (n, c) of the unknowns that a fold alone determines: where its record starts, and its phases.

    A rotation is a record's own but for the first record: there it is the direction in which cosine and sine turn.
    """
    unknowns, i = fit.unknowns, fold.record
    n, nx, _ = unknowns.split
    found = []
    if fold.first == 0:  # only these samples tell where the record starts
        found += list(np.eye(unknowns.size)[n + i * nx : n + (i + 1) * nx])
    at = n + unknowns.records * nx
    for t in unknowns.terms:
        if t.phase and fold.whole:
            turn = np.zeros(unknowns.size)
            if i > 0:
                turn[at + len(t.sizes) + len(t.free) + i - 1] = 1.0
            else:
                cosine, sine = fit.z[at : at + 2]
                turn[at : at + 2] = np.array([-sine, cosine]) / max(np.hypot(cosine, sine), 1e-300)
            found.append(turn)
        at += t.count(unknowns.records)
    return np.array(found).reshape(len(found), unknowns.size).T


def stability(model: Model, key: str) -> float:
    """p-value of one and the same size of the effect in all folds: chi squared of the scores of fold-specific sizes.

    Phases and shapes are not among the sizes. The statistic is scaled by the spread of the scores of blocks, so that errors
    which are not white do not count as unstable.
    """
    fit, unknowns = model.fit, model.fit.unknowns
    at, mine = unknowns.size - unknowns.split[2], np.zeros(0, dtype=int)
    for t in unknowns.terms:
        if t.key == key:
            mine = np.arange(at, at + len(t.sizes))
        at += t.count(unknowns.records)
    others = np.setdiff1d(np.arange(unknowns.size), mine)
    mimic = _inverse(fit.information[np.ix_(others, others)]) @ fit.information[np.ix_(others, mine)]
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
        length = ny * max(5, round(1.0 / model.predictor.plant.dt))
        parts = np.add.reduceat(G * e[:, None], np.arange(0, max(1, len(e) - length // 2), length), axis=0)
        spread = (parts - parts.mean(axis=0)).T @ (parts - parts.mean(axis=0))
        ratio = max(1.0, float(np.trace(np.linalg.pinv(S) @ spread)) / len(mine))
        chi += float(b @ np.linalg.pinv(S) @ b) / ratio
        b_all, S_all, freedom = b_all + b, S_all + S, freedom + len(mine)
    if freedom <= 0:
        return 1.0
    return float(chi2.sf(max(chi - float(b_all @ np.linalg.pinv(S_all) @ b_all), 0.0), freedom))
