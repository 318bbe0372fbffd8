"""The Kalman filter along a given trajectory, compiled: gains, whitening and likelihood for linear time-varying models.

S = H P H' + R,  K = P H' S^-1,  P+ = F (P - K S K') F' + G Q G' + diag(added)
"""

import numpy as np
from numba import njit

from workbench.records import field, record


@record
class Linearization:
    """One record: F (N, n, n), G (N, n, nw), H (N, ny, n); present (N, ny) tells which outputs were measured; added (N, n):
    variances that the states take up from sample to sample whatever the pushes, none where it is empty.
    """

    F: np.ndarray
    G: np.ndarray
    H: np.ndarray
    present: np.ndarray
    added: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))


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
    none, last = np.empty((0, ny)), np.empty((0, n, 0))
    _, log_det = _run(line, process, measurement, K, W, np.empty((0, n, ny)), none, none, np.empty((0, 0)), last)
    return Pass(K, W, log_det)


@record
class Likelihood:
    """-2 log likelihood but for a constant, and its slopes over the variances of process (nw) and measurement noise (ny).

    decay (n): the slopes over the last diagonal entries of F.
    """

    deviance: float
    process: np.ndarray
    measurement: np.ndarray
    decay: np.ndarray


def likelihood(
    line: Linearization, process: np.ndarray, measurement: np.ndarray, gain: np.ndarray, innovations: np.ndarray, fading: int = 0
) -> Likelihood:
    """What other noise levels make of the innovations (N, ny) of a filter with `gain`; fading: how many last entries decay.

    To first order: the deviation d of the state from that filter's prediction obeys d+ = F (d - gain e) + w, e = H d + v. The
    slopes are those of the disturbance smoother: E[w w'], E[v v'] in the light of the whole record (Koopman and Shephard 1992).
    """
    N, ny, n = line.H.shape
    K, W, e = np.zeros((N, n, ny)), np.zeros((N, ny, ny)), np.zeros((N, ny))
    d, A = np.zeros((N, fading)), np.zeros((N, n, fading))
    cost, log_det = _run(line, process, measurement, K, W, gain, innovations, e, d, A)
    by_process, by_measurement, by_decay = np.zeros(len(process)), np.zeros(ny), np.zeros(fading)
    F, G, H = (np.ascontiguousarray(a) for a in (line.F, line.G, line.H))
    _slopes(F, G, H, np.ascontiguousarray(line.present), K, W, e, d, A, by_process, by_measurement, by_decay)
    return Likelihood(cost + log_det, by_process, by_measurement, by_decay)


def _run(line: Linearization, process, measurement, K, W, gain, innovations, e, d, A) -> tuple[float, float]:
    """The compiled pass; K, W, the innovations e, and of the last states d and the columns A of their covariance are filled."""
    F, G, H, present, gain, old = (
        np.ascontiguousarray(a) for a in (line.F, line.G, line.H, line.present, gain, innovations)
    )  # fmt: skip
    added = np.ascontiguousarray(line.added)
    return _filter(F, G, H, present, added, process**2, measurement**2, K, W, gain, old, e, d, A)


def response(line: Linearization, gain: np.ndarray, push: np.ndarray, shift: np.ndarray | None = None) -> np.ndarray:
    """Change of the innovations (N, ny, c) when push (N, n, c) is added to the states after each sample.

    d+ = F (d + K out) + push,  out = shift - H d:  `shift` (N, ny, c) is an error of the sensors themselves. What was not
    measured does not change.
    """
    N, ny, _ = line.H.shape
    out = np.empty((N, ny, push.shape[2]))
    shift = np.zeros_like(out) if shift is None else shift
    F, H, gain, push, shift = (np.ascontiguousarray(a) for a in (line.F, line.H, gain, push, shift))
    _respond(F, H, gain, push, shift, out)
    out[~line.present] = 0.0
    return out


# one signature each: arrays are made contiguous before they come here. Matrices are small and most entries of F, G and H are 0 in
# every sample: loops over the others, listed once, take a fraction of what calls of BLAS do. The two passes are
# long for the reason that `riccati` of the envelopes is, where it was measured: calls cost as much as such small pieces
@njit("Tuple((u8[::1], u8[:, ::1]))(f8[:, :, ::1])", cache=True)
def _entries(M):
    """For each row of M (N, rows, columns) how many entries differ from 0 in any sample, and their columns."""
    N, rows, columns = M.shape
    any_of = np.zeros((rows, columns), dtype=np.bool_)
    for k in range(N):
        for i in range(rows):
            for j in range(columns):
                any_of[i, j] |= M[k, i, j] != 0.0
    count, index = np.zeros(rows, dtype=np.uint64), np.zeros((rows, columns), dtype=np.uint64)
    for i in range(rows):
        for j in range(columns):
            if any_of[i, j]:
                index[i, count[i]] = j
                count[i] += np.uint64(1)
    return count, index


@njit(
    "UniTuple(f8, 2)(f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], b1[:, ::1], f8[:, ::1], f8[::1], f8[::1], f8[:, :, ::1],"
    "f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, :, ::1])",
    cache=True, error_model="numpy",
)  # fmt: skip
def _filter(F, G, H, present, added, q, r, K, W, old, told, e, last, columns):
    N, ny, n = H.shape
    (f_count, f_index), (g_count, g_index), (h_count, h_index) = _entries(F), _entries(G), _entries(H)
    P, B = np.zeros((n, n)), np.zeros((n, n))
    S, L, HP, M = np.zeros((ny, ny)), np.zeros((ny, ny)), np.zeros((ny, n)), np.zeros((ny, n))
    d, ahead = np.zeros(n), np.zeros(n)
    cost, log_det = 0.0, 0.0
    for k in range(N):
        for i in range(ny):
            HP[i, :] = 0.0
            if present[k, i]:
                for x in range(h_count[i]):
                    m = h_index[i, x]
                    h = H[k, i, m]
                    for j in range(n):
                        HP[i, j] += h * P[m, j]
        for i in range(ny):
            for j in range(i + 1):
                total = 0.0
                if present[k, i] and present[k, j]:
                    for x in range(h_count[j]):
                        m = h_index[j, x]
                        total += HP[i, m] * H[k, j, m]
                if i == j:
                    total = total + r[i] if present[k, i] else 1.0
                S[i, j] = total
        det = 1.0
        for i in range(ny):  # Cholesky
            for j in range(i + 1):
                total = S[i, j]
                for m in range(j):
                    total -= L[i, m] * L[j, m]
                L[i, j] = np.sqrt(total) if i == j else total / L[j, j]
            det *= L[i, i]
        log_det += 2.0 * np.log(det)
        for j in range(ny):  # W = L^-1
            for i in range(ny):
                if i < j:
                    W[k, i, j] = 0.0
                    continue
                total = 1.0 if i == j else 0.0
                for m in range(j, i):
                    total -= L[i, m] * W[k, m, j]
                W[k, i, j] = total / L[i, i]
        for i in range(ny):  # M = W HP
            for j in range(n):
                M[i, j] = W[k, i, i] * HP[i, j]
            for m in range(i):
                for j in range(n):
                    M[i, j] += W[k, i, m] * HP[m, j]
        for i in range(n):  # K = M' W; columns of what was not measured are 0, for so are rows of HP
            for j in range(ny):
                total = 0.0
                for m in range(j, ny):
                    total += M[m, i] * W[k, m, j]
                K[k, i, j] = total
        if len(told) > 0:
            for i in range(ny):
                total = 0.0
                if present[k, i]:
                    total = told[k, i]
                    for x in range(h_count[i]):
                        m = h_index[i, x]
                        total -= H[k, i, m] * d[m]
                e[k, i] = total
            for i in range(ny):
                total = 0.0
                for j in range(i + 1):
                    total += W[k, i, j] * e[k, j]
                cost += total * total
            for i in range(n):
                for j in range(ny):
                    d[i] += K[k, i, j] * e[k, j]
                    if present[k, j]:
                        d[i] -= old[k, i, j] * told[k, j]
            for i in range(last.shape[1]):
                last[k, i] = d[n - last.shape[1] + i]
            for i in range(n):
                total = 0.0
                for x in range(f_count[i]):
                    m = f_index[i, x]
                    total += F[k, i, m] * d[m]
                ahead[i] = total
            d[:] = ahead
        for m in range(ny):  # A = P - K HP = P - M' M, in place of P: its lower half, mirrored
            for i in range(n):
                for j in range(i + 1):
                    P[i, j] -= M[m, i] * M[m, j]
        for i in range(n):
            for j in range(i):
                P[j, i] = P[i, j]
        for i in range(columns.shape[2]):
            for j in range(n):
                columns[k, j, i] = P[j, n - columns.shape[2] + i]
        for i in range(n):  # B = F A
            B[i, :] = 0.0
            for x in range(f_count[i]):
                m = f_index[i, x]
                f = F[k, i, m]
                for j in range(n):
                    B[i, j] += f * P[m, j]
        for i in range(n):  # P = B F' + G Q G'
            for j in range(i + 1):
                total = 0.0
                for x in range(f_count[j]):
                    m = f_index[j, x]
                    total += B[i, m] * F[k, j, m]
                for x in range(g_count[i]):
                    m = g_index[i, x]
                    total += G[k, i, m] * q[m] * G[k, j, m]
                P[i, j] = P[j, i] = total
        for i in range(added.shape[1]):
            P[i, i] += added[k, i]
    return cost, log_det


@njit(inline="always")
def _gathered(K, B, KB):
    """KB = K' B."""
    n, ny = K.shape
    KB[:, :] = 0.0
    for i in range(n):
        for b in range(ny):
            f = K[i, b]
            for j in range(n):
                KB[b, j] += f * B[i, j]


@njit(
    "void(f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], b1[:, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1],"
    "f8[:, :, ::1], f8[::1], f8[::1], f8[::1])",
    cache=True, error_model="numpy",
)  # fmt: skip
def _slopes(F, G, H, present, K, W, e, last, columns, by_q, by_r, by_decay):
    """Slopes of the deviance, from the end back: r- = H' S^-1 e + (I - K H)' F' r, and X its covariance."""
    N, ny, n = H.shape
    nw = G.shape[2]
    (f_count, f_index), (g_count, g_index), (h_count, h_index) = _entries(F), _entries(G), _entries(H)
    X, B, C = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    r, back, u, w = np.zeros(n), np.zeros(n), np.zeros(ny), np.zeros(ny)
    along, bend = np.zeros(nw), np.zeros(nw)
    KB, SI = np.zeros((ny, n)), np.zeros((ny, ny))
    fading = last.shape[1]
    for k in range(N - 1, -1, -1):
        along[:], bend[:] = 0.0, 0.0
        for i in range(n):
            for x in range(g_count[i]):
                m = g_index[i, x]
                along[m] += G[k, i, m] * r[i]
                total = 0.0
                for j in range(n):
                    total += X[i, j] * G[k, j, m]
                bend[m] += G[k, i, m] * total
        for m in range(nw):
            by_q[m] += bend[m] - along[m] * along[m]
        back[:] = 0.0
        for i in range(n):
            for x in range(f_count[i]):
                m = f_index[i, x]
                back[m] += F[k, i, m] * r[i]
        C[:, :], B[:, :] = 0.0, 0.0
        for i in range(n):  # C = F' X
            for x in range(f_count[i]):
                m = f_index[i, x]
                f = F[k, i, m]
                for j in range(n):
                    C[m, j] += f * X[i, j]
        for i in range(n):  # B = F' X F
            for x in range(f_count[i]):
                m = f_index[i, x]
                f = F[k, i, m]
                for j in range(m + 1):
                    B[m, j] += f * C[j, i]
        for i in range(n):
            for j in range(i):
                B[j, i] = B[i, j]
        for f in range(fading):  # E[r d'] - X F A, of the last states
            i = n - fading + f
            there = last[k, f]
            for j in range(n):
                there += columns[k, j, f] * back[j]
                by_decay[f] += 2.0 * C[j, i] * columns[k, j, f]
            by_decay[f] -= 2.0 * r[i] * there
        for a in range(ny):
            w[a] = 0.0
            for b in range(a + 1):
                w[a] += W[k, a, b] * e[k, b]
        for b in range(ny):  # u = S^-1 e - K' F' r
            u[b] = 0.0
            for a in range(b, ny):
                u[b] += W[k, a, b] * w[a]
            for i in range(n):
                u[b] -= K[k, i, b] * back[i]
        _gathered(K[k], B, KB)
        for a in range(ny):
            for b in range(ny):
                SI[a, b] = 0.0
                for m in range(max(a, b), ny):
                    SI[a, b] += W[k, m, a] * W[k, m, b]
            if present[k, a]:
                by_r[a] += SI[a, a] - u[a] * u[a]
                for i in range(n):
                    by_r[a] += KB[a, i] * K[k, i, a]
        # r = H' u + F' r, X = (I - K H)' B (I - K H) + H' S^-1 H, one factor after the other: multiplied out it is unstable
        for b in range(ny):
            if present[k, b]:
                for x in range(h_count[b]):
                    j = h_index[b, x]
                    h = H[k, b, j]
                    back[j] += h * u[b]
                    for i in range(n):
                        B[i, j] -= KB[b, i] * h
        _gathered(K[k], B, KB)
        for a in range(ny):
            if present[k, a]:
                for x in range(h_count[a]):
                    i = h_index[a, x]
                    h = H[k, a, i]
                    for j in range(n):
                        B[i, j] -= h * KB[a, j]
                    for b in range(ny):
                        if present[k, b]:
                            for z in range(h_count[b]):
                                j = h_index[b, z]
                                B[i, j] += h * SI[a, b] * H[k, b, j]
        for i in range(n):
            for j in range(i + 1):
                X[i, j] = X[j, i] = 0.5 * (B[i, j] + B[j, i])
        r[:] = back


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
        np.dot(K[k], out[k], x)
        x += d
        np.dot(F[k], x, d)
        d += push[k]


def drifted(F: np.ndarray, G: np.ndarray, H: np.ndarray, process: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Variance (N) of h x after each of the samples F (N, n, n), G (N, n, nw), h (N, n), for pushes of deviations `process` (nw)
    that nothing corrects; it begins anew after every sample in which h x is `known` (N).
    """
    F, G, H = (np.ascontiguousarray(a) for a in (F, G, H))
    return _drifted(F, G, H, process**2, known)


@njit("f8[::1](f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1], f8[::1], b1[::1])", cache=True)
def _drifted(F, G, H, process, known):
    N, n = H.shape
    P, found = np.zeros((n, n)), np.zeros(N)
    for k in range(N):
        P = F[k] @ P @ F[k].T + (G[k] * process) @ G[k].T
        found[k] = np.sum(H[k] * (P @ H[k]))
        if known[k]:
            P[:] = 0.0
    return found
