"""The Kalman filter along a given trajectory, compiled: gains, whitening and likelihood for linear time-varying models.

S = H P H' + R,  K = P H' S^-1,  P+ = F (P - K S K') F' + G Q G'
"""

import numpy as np
from numba import njit

from workbench.records import record


@record
class Linearization:
    """One record: F (N, n, n), G (N, n, nw), H (N, ny, n); present (N, ny) tells which outputs were measured."""

    F: np.ndarray
    G: np.ndarray
    H: np.ndarray
    present: np.ndarray


@record
class Pass:
    """Gains K (N, n, ny), whitening W (N, ny, ny) with W S W' = I, and the sum of log det S over the samples."""

    gain: np.ndarray
    whitening: np.ndarray
    log_det: float


def gains(line: Linearization, process: np.ndarray, measurement: np.ndarray) -> Pass:
    """Kalman gains from a known start (P = 0) for standard deviations of process (nw) and measurement noise (ny)."""
    N, ny, n = line.H.shape
    K, W = np.zeros((N, n, ny)), np.zeros((N, ny, ny))
    nothing = np.empty((0, n, ny))
    _, log_det = _run(line, process, measurement, K, W, nothing, np.empty((0, ny)))
    return Pass(K, W, log_det)


def deviance(line: Linearization, process, measurement, gain: np.ndarray, innovations: np.ndarray) -> float:
    """-2 log likelihood (but for a constant) that other noise levels give the innovations (N, ny) of a filter with `gain`.

    To first order: the deviation d of the state from that filter's prediction obeys d+ = F (d - gain e) + w, e = H d + v.
    """
    N, ny, n = line.H.shape
    K, W = np.zeros((N, n, ny)), np.zeros((N, ny, ny))
    cost, log_det = _run(line, process, measurement, K, W, gain, innovations)
    return cost + log_det


def _run(line: Linearization, process, measurement, K, W, gain, innovations) -> tuple[float, float]:
    """The compiled pass; K and W are filled."""
    F, G, H, present, gain, e = (
        np.ascontiguousarray(a) for a in (line.F, line.G, line.H, line.present, gain, innovations)
    )  # fmt: skip
    return _filter(F, G, H, present, process**2, measurement**2, K, W, gain, e)


def response(line: Linearization, gain: np.ndarray, push: np.ndarray, shift: np.ndarray | None = None) -> np.ndarray:
    """Change of the innovations (N, ny, c) when push (N, n, c) is added to the states after each sample.

    d+ = F (d + K out) + push,  out = shift - H d:  `shift` (N, ny, c) is an error of the sensors themselves.
    """
    N, ny, _ = line.H.shape
    out = np.empty((N, ny, push.shape[2]))
    shift = np.zeros_like(out) if shift is None else shift
    F, H, gain, push, shift = (np.ascontiguousarray(a) for a in (line.F, line.H, gain, push, shift))
    _respond(F, H, gain, push, shift, out)
    return out


# one signature each: arrays are made contiguous before they come here
@njit(
    "UniTuple(f8, 2)(f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], b1[:, ::1], f8[::1], f8[::1], f8[:, :, ::1], f8[:, :, ::1],"
    "f8[:, :, ::1], f8[:, ::1])",
    cache=True, error_model="numpy",
)  # fmt: skip
def _filter(F, G, H, present, q, r, K, W, old, e):
    N, ny, n = H.shape
    nw = G.shape[2]
    P, A, B = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    S, L, HP = np.zeros((ny, ny)), np.zeros((ny, ny)), np.zeros((ny, n))
    d, ahead, w = np.zeros(n), np.zeros(n), np.zeros(ny)
    cost, log_det = 0.0, 0.0
    for k in range(N):
        for i in range(ny):
            for j in range(n):
                total = 0.0
                if present[k, i]:
                    for m in range(n):
                        if H[k, i, m] != 0.0:
                            total += H[k, i, m] * P[m, j]
                HP[i, j] = total
        for i in range(ny):
            for j in range(i + 1):
                total = 0.0
                if present[k, i] and present[k, j]:
                    for m in range(n):
                        total += HP[i, m] * H[k, j, m]
                if i == j:
                    total = total + r[i] if present[k, i] else 1.0
                S[i, j] = total
        for i in range(ny):  # Cholesky
            for j in range(i + 1):
                total = S[i, j]
                for m in range(j):
                    total -= L[i, m] * L[j, m]
                L[i, j] = np.sqrt(total) if i == j else total / L[j, j]
            log_det += 2.0 * np.log(L[i, i])
        for j in range(ny):  # W = L^-1
            for i in range(ny):
                if i < j:
                    W[k, i, j] = 0.0
                    continue
                total = 1.0 if i == j else 0.0
                for m in range(j, i):
                    total -= L[i, m] * W[k, m, j]
                W[k, i, j] = total / L[i, i]
        for i in range(n):  # K = (W HP)' W
            for a in range(ny):
                w[a] = 0.0
                for b in range(a + 1):
                    w[a] += W[k, a, b] * HP[b, i]
            for j in range(ny):
                total = 0.0
                for a in range(j, ny):
                    total += w[a] * W[k, a, j]
                K[k, i, j] = total if present[k, j] else 0.0
        if len(e) > 0:
            for i in range(ny):
                total = 0.0
                if present[k, i]:
                    total = e[k, i]
                    for m in range(n):
                        total -= H[k, i, m] * d[m]
                w[i] = total
            for i in range(ny):
                total = 0.0
                for j in range(i + 1):
                    total += W[k, i, j] * w[j]
                cost += total * total
            for i in range(n):
                for j in range(ny):
                    d[i] += K[k, i, j] * w[j]
                    if present[k, j]:
                        d[i] -= old[k, i, j] * e[k, j]
            for i in range(n):
                ahead[i] = 0.0
                for j in range(n):
                    ahead[i] += F[k, i, j] * d[j]
            d[:] = ahead
        for i in range(n):
            for j in range(n):
                total = P[i, j]
                for a in range(ny):
                    total -= K[k, i, a] * HP[a, j]
                A[i, j] = total
        for i in range(n):
            for j in range(n):
                A[i, j] = A[j, i] = 0.5 * (A[i, j] + A[j, i])
        B[:, :] = 0.0
        for i in range(n):
            for m in range(n):
                f = F[k, i, m]
                if f != 0.0:
                    for j in range(n):
                        B[i, j] += f * A[m, j]
        for i in range(n):
            for j in range(i + 1):
                total = 0.0
                for m in range(n):
                    total += B[i, m] * F[k, j, m]
                for m in range(nw):
                    total += G[k, i, m] * q[m] * G[k, j, m]
                P[i, j] = P[j, i] = total
    return cost, log_det


@njit(
    "void(f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1])",
    cache=True, error_model="numpy",
)  # fmt: skip
def _respond(F, H, K, push, shift, out):
    N, ny, n = H.shape
    c = push.shape[2]
    d, x = np.zeros((n, c)), np.zeros((n, c))
    for k in range(N):
        for i in range(ny):
            for j in range(c):
                out[k, i, j] = shift[k, i, j]
            for m in range(n):
                if H[k, i, m] != 0.0:
                    for j in range(c):
                        out[k, i, j] -= H[k, i, m] * d[m, j]
        for i in range(n):
            for j in range(c):
                x[i, j] = d[i, j]
            for m in range(ny):
                if K[k, i, m] != 0.0:
                    for j in range(c):
                        x[i, j] += K[k, i, m] * out[k, m, j]
        for i in range(n):
            for j in range(c):
                d[i, j] = push[k, i, j]
            for m in range(n):
                if F[k, i, m] != 0.0:
                    for j in range(c):
                        d[i, j] += F[k, i, m] * x[m, j]
