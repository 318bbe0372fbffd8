"""A linear system sampled with its inputs held."""

import numpy as np


def held(A: np.ndarray, B: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """A (n, n) and B (n, m) of x+ = A x + B u from those of x' = A x + B u, with u held over dt [s]: exp([A B; 0 0] dt)."""
    from scipy.linalg import expm

    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A * dt, B * dt
    both = expm(block)
    return both[:n, :n], both[:n, n:]
