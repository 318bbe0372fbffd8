"""The recursion of given coefficients: its parts by lag, its frozen poles and its free runs under a schedule from outside."""

import numpy as np

from workbench.identification.ssm.regression import Problem, Signals
from workbench.lpv import lattice
from workbench.records import field, record

DIVERGED = 1e3  # a free run beyond this many times the measured range has diverged


@record
class Coefficients:
    """theta (ny, nr, m) by meaning: f (n, ny, ny, m), g (n, ny, nu, m) by lag, output, past signal, function; D (ny, nu)."""

    f: np.ndarray = field("n ny ny m")
    g: np.ndarray = field("n ny nu m")
    D: np.ndarray = field("ny nu")


def coefficients(theta: np.ndarray, n: int) -> Coefficients:
    ny, nr, m = theta.shape
    nu = (nr - n * ny) // (n + 1)
    f = theta[:, : n * ny].reshape(ny, n, ny, m).transpose(1, 0, 2, 3)
    g = theta[:, n * ny : n * (ny + nu)].reshape(ny, n, nu, m).transpose(1, 0, 2, 3)
    return Coefficients(f, g, theta[:, n * (ny + nu) :].sum(axis=2))


def radius(theta: np.ndarray, n: int, problem: Problem, points: int = 21) -> float:
    """Largest spectral radius of the frozen recursion over the schedule's spans; see `lattice`."""
    f = coefficients(theta, n).f
    ny = f.shape[1]
    grid = problem.basis(lattice(problem.spans, points))
    A = np.zeros((len(grid), n * ny, n * ny))
    A[:, :, :ny] = np.einsum("iabm,rm->riab", f, grid).reshape(len(grid), n * ny, ny)
    A[:, : (n - 1) * ny, ny:] += np.eye((n - 1) * ny)
    return float(np.abs(np.linalg.eigvals(A)).max())


def mean_fit(measured: np.ndarray, y: np.ndarray | None) -> float:
    """FIT [%] of a free run y (N, ny), mean over outputs; -inf where it has diverged.  [1] eq. (1.17)"""
    if y is None or not np.abs(y).max() <= DIVERGED * np.abs(measured).max():
        return -np.inf
    spread = np.linalg.norm(measured - measured.mean(axis=0), axis=0)
    return float(np.mean(100 * (1 - np.linalg.norm(measured - y, axis=0) / np.where(spread > 0, spread, 1.0))))


def free_run(theta: np.ndarray, n: int, s: Signals, start: int) -> np.ndarray | None:
    """y (N, ny) of the recursion from measured inputs and schedule; measured outputs before `start`; None: diverged."""
    own = coefficients(theta, n)
    f, g = own.f, own.g
    N, ny = s.y.shape
    forced = s.u @ own.D.T
    for i in range(1, n + 1):
        forced[i:] += np.einsum("kab,kb->ka", np.tensordot(s.phi, g[i - 1], (1, 2)), s.u)[: N - i]
    # newest sample last, as it lies in memory: y(k-n) .. y(k-1)
    memory = np.tensordot(s.phi, f[::-1], (1, 3)).transpose(0, 2, 1, 3).reshape(N, ny, n * ny)
    y = s.y.flatten()
    limit = DIVERGED * float(np.abs(s.y).max())
    for k in range(start, N):
        new = memory[k - n] @ y[(k - n) * ny : k * ny] + forced[k]
        if not np.abs(new).max() <= limit:
            return None
        y[k * ny : (k + 1) * ny] = new
    return y.reshape(N, ny)
