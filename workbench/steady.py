"""What a linear system x+ = A x + B u, y = C x + D u is at rest, also where it integrates or is unstable.

P(z) = C (z - A)^-1 B + D has no value at z = 1 where the system integrates, and none that tells anything where it is unstable.
"""

import numpy as np
from scipy.linalg import null_space, schur, solve_discrete_lyapunov, solve_sylvester

SLOW = 1e-5  # a pole no further than this within the unit circle integrates: no record is so long that it tells it from one
BEYOND = 0.1  # the outermost pole, where such a system is looked at: as fast as a tenth of a radian a sample
NOUGHT = 1e-6  # of what an output is moved by: what is less is rounding
REACHED = 1e-12  # of the largest: directions of the state that inputs move


def integrates(A: np.ndarray) -> bool:
    """Whether a pole is outside the unit circle, or so near to it that no record tells it from one."""
    return bool(np.abs(np.linalg.eigvals(A)).max(initial=0.0) > 1.0 - SLOW)


def gain(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, free: bool | None = None) -> np.ndarray:
    """P(1) (ny, nu); where the system integrates or is unstable, what tells as much.

    There an output that slow modes move counts by these alone, P(z) at a real z a tenth beyond all poles: dead time and fast
    modes are as at rest. free: whether the system is taken for such a one, so that all of a family are taken alike; default:
    whether it integrates.
    """
    if not (integrates(A) if free is None else free):
        return C @ np.linalg.solve(np.eye(len(A)) - A, B) + D
    T, Z, slow = schur(A, output="real", sort=lambda re, im: abs(complex(re, im)) > 1.0 - BEYOND)  # type: ignore[misc]
    B, C, n = Z.T @ B, C @ Z, len(A)
    Y = np.zeros((slow, n - slow))
    if 0 < slow < n:
        Y = solve_sylvester(T[:slow, :slow], -T[slow:, slow:], -T[:slow, slow:])
    z = max(np.abs(np.linalg.eigvals(A)).max(initial=0.0), 1.0) + BEYOND
    moved = C[:, :slow] @ np.linalg.solve(z * np.eye(slow) - T[:slow, :slow], B[:slow] - Y @ B[slow:])
    at_rest = (C[:, :slow] @ Y + C[:, slow:]) @ np.linalg.solve(np.eye(n - slow) - T[slow:, slow:], B[slow:]) + D
    sizes = np.linalg.norm(moved, axis=1), np.linalg.norm(at_rest, axis=1)
    return np.where((sizes[0] > NOUGHT * sizes[1])[:, None], moved, at_rest)


def dying(A: np.ndarray, X: np.ndarray, samples: float, points: int) -> tuple[int, np.ndarray]:
    """How many samples lie between them, and A^k X (points, nx, n) of so many k from 0 on that reach as far as `samples`."""
    every, found = int(np.ceil(samples / points)), []
    stride = np.linalg.matrix_power(A, every)
    for _ in range(points):
        found.append(X)
        X = stride @ X
    return every, np.array(found)


def rests(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States (nx, ny) and inputs (nu, ny) of the rests at which one output is 1 and the others 0, or as near to that as they go.

    The least inputs that do it; where the system integrates the least states and inputs together, both in units of what moves
    them, and no states that inputs do not move.
    """
    if not integrates(A):
        U = np.linalg.pinv(gain(A, B, C, D))
        return np.linalg.solve(np.eye(len(A)) - A, B @ U), U
    T, unit = _reached(A, B)
    both = null_space(np.hstack([T - A @ T, -B * unit]))
    both = both @ np.linalg.pinv(np.hstack([C @ T, D * unit]) @ both)
    return T @ both[: T.shape[1]], unit[:, None] * both[T.shape[1] :]


def follows(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States W (nx, n) and inputs V (nu, n) that are added to those at rest while states rise by X (nx, n) a sample, and outputs
    with them, none late.

    x_k = X k + W and x_(k+1) = A x_k + B u_k give (1 - A) W - B V = -X and C W + D V = 0, or as near to that as they go.
    """
    if not integrates(A):
        rest = np.eye(len(A)) - A
        V = np.linalg.pinv(gain(A, B, C, D)) @ C @ np.linalg.solve(rest, X)
        return np.linalg.solve(rest, B @ V - X), V
    T, unit = _reached(A, B)
    rest, reads = np.hstack([T - A @ T, -B * unit]), np.hstack([C @ T, D * unit])
    moving, still = np.linalg.lstsq(rest, -X, rcond=None)[0], null_space(rest)
    both = moving - still @ np.linalg.pinv(reads @ still) @ reads @ moving
    return T @ both[: T.shape[1]], unit[:, None] * both[T.shape[1] :]


def _reached(A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions of the state that inputs move, in what they are moved by, and units of the inputs."""
    size = np.linalg.norm(B, axis=0)
    unit = 1.0 / np.where(size > 0.0, size, 1.0)
    calmed = A * 0.9 / max(1.0, np.abs(np.linalg.eigvals(A)).max())  # it moves the same directions
    moved = solve_discrete_lyapunov(calmed, (B * unit) @ (B * unit).T)
    x = np.sqrt(np.maximum(np.diagonal(moved), 0.0))
    x = np.where(x > 0.0, x, 1.0)
    values, vectors = np.linalg.eigh(moved / np.outer(x, x))
    kept = values > REACHED * values.max()
    return x[:, None] * vectors[:, kept] * np.sqrt(values[kept]), unit
