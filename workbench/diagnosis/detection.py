"""Detection limits that hold at the size that they state.

A limit is read off straight lines: what a small step of an effect changes, less what the fitted unknowns mimic of it, made larger
until it counts SHOWN. Here the effect has that size, and the unknowns mimic it as well as they can:

    m^2 = min over d of  |e(z + d, eta) - e(z, 0)|^2 + |d|^2 of the prior

Where m is far from what the lines say, as where errors grow along a record and a step is long against that, no limit is stated.
Of an effect whose response is no line, and less, the finite size is that was tried, if that shows.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.diagnosis.fit import Fit
from workbench.diagnosis.predictor import Predictor
from workbench.diagnosis.screen import SHOWN, Signature

ROUNDS = 6  # chords of the fit
SHARES = (0.25, 0.5, 0.75, 1.0)  # of the size, one after the other
HOLDS = 2.0  # factor within which m is what was said
ENOUGH = 0.05  # share of m^2 that a chord must take off to be followed by another


def holding(predictor: Predictor, fit: Fit, tested: Sequence[Signature]) -> list[Signature]:
    """The signatures with limits that hold."""
    asked = [s for s in tested if np.isfinite(s.limit) and s.responds and not s.is_level]
    if not asked:
        return list(tested)
    sizes = [_of_limit(s, len(predictor.records)) for s in asked]
    said = np.array([np.sqrt(d @ s.S @ d) for s, d in zip(asked, sizes, strict=True)])
    found = _mimicked(predictor, fit, asked, sizes, said) / said
    checked = {id(s): _checked(s, float(ratio)) for s, ratio in zip(asked, found, strict=True)}
    return [replace(s, checked=checked.get(id(s), np.nan)) for s in tested]


def _checked(s: Signature, ratio: float) -> float:
    """The limit where an effect of its size changes `ratio` times what lines say."""
    if 1.0 / HOLDS <= ratio <= HOLDS:
        return s.limit
    shows = not np.isnan(s.variant.finite) and s.S[0, 0] > SHOWN**2
    return s.variant.finite if shows and ratio < 1.0 else np.inf


def _of_limit(s: Signature, records: int) -> np.ndarray:
    """The limit as steps of the columns (c); of a phase that which shows most, of several sizes the one that does."""
    d = np.zeros(len(s.b))
    if not s.variant.phase:
        j = int(np.argmin(s.scale / np.sqrt(np.maximum(np.diag(s.S), 1e-300))))
        d[j] = s.limit / s.scale[j]
        return d
    c = len(d) // records
    for own in (slice(i * c, (i + 1) * c) for i in range(records)):
        d[own] = np.linalg.eigh(s.S[own, own])[1][:, -1] * s.limit / s.scale[0]
    return d


def _mimicked(
    predictor: Predictor, fit: Fit, asked: Sequence[Signature], sizes: Sequence[np.ndarray], said: np.ndarray
) -> np.ndarray:
    """m of every signature at its size; see the module. Where chords do not lead there at once, by way of smaller sizes."""
    straight = -np.array([s.weights @ d for s, d in zip(asked, sizes, strict=True)])
    found, _ = _chords(predictor, fit, asked, sizes, straight)
    far = [int(j) for j in np.flatnonzero(found > HOLDS * said)]
    if far:
        moves, before = straight[far], 1.0
        for share in SHARES:
            own = [share * sizes[j] for j in far]
            m, moves = _chords(predictor, fit, [asked[j] for j in far], own, share / before * moves)
            before = share
        found[far] = np.minimum(found[far], m)
    return found


def _chords(
    predictor: Predictor, fit: Fit, asked: Sequence[Signature], sizes: Sequence[np.ndarray], moves: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """m of every signature at its size, by chords of the fit from `moves` (R, n) of the unknowns, and the moves there."""
    moves, best, reached = moves.copy(), np.full(len(asked), np.inf), moves.copy()
    on = np.arange(len(asked))
    for _ in range(ROUNDS):
        own = [(asked[int(j)], sizes[int(j)]) for j in on]
        changes = [_changes(predictor, fit, i, own, moves[on]) for i in range(len(fit.errors))]
        prior = np.where(fit.unknowns.believed, moves[on], 0.0)
        with np.errstate(over="ignore", invalid="ignore"):
            cost = sum((r**2).sum(axis=1) for r in changes) + (prior**2).sum(axis=1)
        gains = np.asarray(cost < (1.0 - ENOUGH) * best[on])
        better = cost < best[on]
        best[on[better]], reached[on[better]] = cost[better], moves[on[better]]
        if not gains.any():
            break
        pull = prior[gains]
        for i, r in enumerate(changes):
            pull[:, fit.unknowns.columns(i)] += r[gains] @ fit.jacobian[i]
        on = on[gains]
        moves[on] -= pull @ fit.covariance
    return np.sqrt(best), reached


def _changes(
    predictor: Predictor, fit: Fit, i: int, asked: Sequence[tuple[Signature, np.ndarray]], moves: np.ndarray
) -> np.ndarray:
    """What the effects, and moves (R, n) of the unknowns with them, do to the errors of record i: (R, N ny)."""
    points = [fit.unknowns.point(fit.z + move) for move in moves]
    low, high = (np.array([getattr(slot.parameter, side) for slot in predictor.plant.slots]) for side in ("low", "high"))
    eta = np.array([q.eta[i] for q in points])
    for own, (s, d) in zip(eta, asked, strict=True):
        for j, value in s.variant.shapes:
            own[j] = value
        heads = s.variant.sizes if np.isnan(s.variant.finite) else s.variant.sizes[:1]
        at = i * len(heads) if s.variant.phase else 0
        own[list(heads)] += (d * s.scale)[at : at + len(heads)]
    eta = np.clip(eta, low, high)
    e = predictor.errors(i, np.array([q.p for q in points]), eta, np.array([q.start[i] for q in points]))
    return (e - fit.errors[i]).reshape(len(moves), -1)
