"""Normal equations A x = b of what runs gave: A symmetric, J'J and a prior, with a unit diagonal while they are solved.

A run that falls through the range of its plant gives numbers all the same: rows of 1e150, or none that depends on an unknown.
Whatever it gave, nothing is raised here: directions without information stay finite, and what is not finite gives NaN.
"""

import numpy as np

UNDERFLOW = 1e-200  # of a diagonal entry: one over its root must not overflow
RIDGE, LEAST = 1e-12, 1e-13  # added to the unit diagonal of what is solved; least eigenvalue of what is inverted


def solve(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """x (.., n) of A (.., n, n) and b (.., n); NaN where A or b is not finite."""
    diagonal = np.diagonal(A, axis1=-2, axis2=-1)
    with np.errstate(over="ignore", invalid="ignore"):
        d = np.sqrt(np.maximum(diagonal, 1e-300))
        scaled, aim = A / (d[..., :, None] * d[..., None, :]), b / d
        known = np.asarray(np.isfinite(scaled).all(axis=(-2, -1)) & np.isfinite(aim).all(axis=-1))
        own = np.where(known[..., None, None], scaled, 0.0) + np.where(known, RIDGE, 1.0)[..., None, None] * np.eye(A.shape[-1])
        x = np.linalg.solve(own, np.where(known[..., None], aim, np.nan)[..., None])[..., 0]
        return x / d


def inverse(A: np.ndarray) -> np.ndarray:
    """Inverse of an information matrix A (n, n); NaN where it is not finite."""
    value, vector, d = eigen(A)
    return (vector / value) @ vector.T / np.outer(d, d)


def eigen(A: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eigenvalues (n), LEAST or more, and eigenvectors (n, n) of A / (d d'), and d (n); NaN where A is not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        diagonal = np.diag(A)
        d = np.sqrt(np.where(diagonal > UNDERFLOW, diagonal, 1.0))
        scaled = A / np.outer(d, d)
    if not np.isfinite(scaled).all():
        return np.full(len(A), np.nan), np.full(A.shape, np.nan), np.full(len(A), np.nan)
    value, vector = np.linalg.eigh(scaled)
    return np.maximum(value, LEAST), vector, d
