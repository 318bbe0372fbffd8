"""Linear matrix inequalities, given to Clarabel as they are: maximise c'x such that F0 + sum_v x_v F_v >= 0 in every block.

A modelling layer takes longer to state such a program with hundreds of blocks than the solver to solve it. Nothing here is
believed: near a margin "almost solved" is the rule, and whoever asks checks the answer.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from workbench.records import field, record

ACCURACY = 1e-9


@record
class Block:
    """F0 + sum_v x_at[v] F_v >= 0: F0 (k k) and F (m k k), symmetric; at (m): the variables that stand in it."""

    F0: np.ndarray = field("k k")
    F: np.ndarray = field("m k k")
    at: np.ndarray = field("m")


def maximise(
    c: np.ndarray,
    blocks: Sequence[Block],
    equal: tuple[np.ndarray, np.ndarray] | None = None,
    accuracy: float = ACCURACY,
) -> np.ndarray | None:
    """x that Clarabel ends with, or None; equal: rows (r, len(c)) and values (r) of rows x = values."""
    import clarabel as compiled  # its names are not visible to the type checker
    from scipy import sparse

    clarabel: Any = compiled
    rows, values, cones = [], [], []
    if equal is not None:
        rows.append(sparse.csc_matrix(equal[0]))
        values.append(equal[1])
        cones.append(clarabel.ZeroConeT(len(equal[1])))
    for block in blocks:
        own = -vector(block.F).T
        row, column = np.nonzero(own)
        place = row, block.at.astype(int)[column]
        rows.append(sparse.csc_matrix((own[row, column], place), shape=(len(own), len(c))))
        values.append(vector(block.F0))
        cones.append(clarabel.PSDTriangleConeT(block.F0.shape[0]))
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = accuracy
    n = len(c)
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix((n, n)), -np.asarray(c, dtype=float), sparse.vstack(rows, format="csc"), np.concatenate(values), cones,
        settings,
    )  # fmt: skip
    x = np.array(solver.solve().x)
    return x if np.isfinite(x).all() else None


def vector(M: np.ndarray) -> np.ndarray:
    """Upper triangles by columns, off-diagonals times sqrt 2: (.., k, k) -> (.., k (k + 1) / 2)."""
    k = M.shape[-1]
    i, j = triangle(k)
    return M[..., i, j] * np.where(i == j, 1.0, np.sqrt(2.0))


def triangle(k: int) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the entries of an upper triangle, column by column."""
    j, i = np.tril_indices(k)
    return i, j


def symmetric(k: int) -> np.ndarray:
    """A basis of the symmetric matrices (k (k + 1) / 2, k, k): ones at (i, j) and (j, i), in the order of `triangle`."""
    i, j = triangle(k)
    E = np.zeros((len(i), k, k))
    E[np.arange(len(i)), i, j] = E[np.arange(len(i)), j, i] = 1.0
    return E
