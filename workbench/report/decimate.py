"""Fewer points for the same picture: of a long trace, a line keeps the lowest and highest sample of each pixel column."""

import numpy as np


def extremes(x: np.ndarray, y: np.ndarray, columns: int) -> np.ndarray:
    """Indices, in order, of the samples that a line over `columns` pixel columns needs: at most 3 a column and both ends.

    x (N) never decreases. Kept are, of each column, the lowest and the highest y, and one y that is not finite where
    there is one: it breaks the line. Traces of up to 2 samples a column are kept whole.
    """
    x, y = np.asarray(x, float), np.asarray(y, float)
    N = len(x)
    if 2 * columns >= N:
        return np.arange(N)
    width = x[-1] - x[0]
    share = (x - x[0]) / width if width > 0 else np.arange(N) / N
    column = np.minimum((share * columns).astype(int), columns - 1)
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    finite = np.isfinite(y)
    low = _first_of_each(starts, np.where(finite, y, np.inf))
    high = _first_of_each(starts, np.where(finite, -y, np.inf))
    gap = _first_of_each(starts, finite.astype(float)) if not finite.all() else np.array([], int)
    return np.unique(np.concatenate([[0, N - 1], low, high, gap[~finite[gap]]]))


def _first_of_each(starts: np.ndarray, rank: np.ndarray) -> np.ndarray:
    """Of each stretch that begins at `starts`, the index of the sample of the lowest rank, the earliest of equals."""
    lowest = np.minimum.reduceat(rank, starts)
    hits = np.flatnonzero(rank == np.repeat(lowest, np.diff(starts, append=len(rank))))
    stretch = np.searchsorted(starts, hits, side="right")
    return hits[np.diff(stretch, prepend=0) > 0]
