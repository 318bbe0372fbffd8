"""Linear matrix inequalities, given to Clarabel as they are: maximise c'x such that F0 + sum_v x_v F_v >= 0 in every block.

A modelling layer takes longer to state such a program with hundreds of blocks than the solver to solve it. Nothing here is
believed: near a margin "almost solved" is the rule, and whoever asks checks the answer.
"""

from collections.abc import Sequence
from enum import Enum
from typing import Any

import numpy as np
from scipy import sparse

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
    cones: list[tuple[Any, np.ndarray, Cone]] = [(equal[0], equal[1], Cone.ZERO)] if equal is not None else []
    for block in blocks:
        own = -vector(block.F).T
        row, column = np.nonzero(own)
        place = row, block.at.astype(int)[column]
        cones.append((sparse.csc_matrix((own[row, column], place), shape=(len(own), len(c))), vector(block.F0), Cone.PSD))
    return conic(c, cones, accuracy)


class Cone(Enum):
    """What rows b - A x lie in: 0; the nonnegative numbers; (p, q) with p >= |q|; `vector` of a matrix >= 0."""

    ZERO = "ZeroConeT"
    NONNEGATIVE = "NonnegativeConeT"
    SECOND_ORDER = "SecondOrderConeT"
    PSD = "PSDTriangleConeT"


def conic(c: np.ndarray, cones: Sequence[tuple[Any, np.ndarray, Cone]], accuracy: float = ACCURACY) -> np.ndarray | None:
    """x that Clarabel ends with, or None: maximise c'x with b - A x in a cone, for each (A, b, cone)."""
    import clarabel as compiled  # its names are not visible to the type checker

    clarabel: Any = compiled
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = accuracy
    n = len(c)
    kinds = [
        getattr(clarabel, cone.value)(round((np.sqrt(8 * len(b) + 1) - 1) / 2) if cone is Cone.PSD else len(b))
        for _, b, cone in cones
    ]
    parts, values = [A for A, _, _ in cones], np.concatenate([b for _, b, _ in cones])
    dense = all(isinstance(A, np.ndarray) for A in parts)
    A = sparse.csc_matrix(np.concatenate(parts)) if dense else sparse.vstack(parts, format="csc")
    solver = clarabel.DefaultSolver(sparse.csc_matrix((n, n)), -np.asarray(c, dtype=float), A, values, kinds, settings)
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
