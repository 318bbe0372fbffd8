"""The free run of an LPV model along a record and what every free number does to it, compiled.

    x(k+1) = A(k) x(k) + B(k) v(k) + share K(k) e(k),   e(k) = y(k) - C(k) x(k) - D(k) v(k) - phi(k) y0,   v(k) = u(k) - phi(k) u0

share = 1 is the one-step predictor, 0 the free run; between them a run that is held a little. The sensitivities S = dx/dtheta
obey the same recursion, so J'J and J'e of all free numbers come from one pass, in memory that does not grow with the record.
"""

import numpy as np
from numba import njit

IN_A, IN_B, IN_C, IN_D, IN_OFFSET, IN_GAIN, IN_ZERO = range(7)  # where a free number stands: kind, term, row, column
ROWS = 64  # of the Jacobian that are multiplied at once


@njit(
    "void(f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1],"
    "f8[:, ::1], f8[:, ::1], f8[:, ::1], f8, f8[::1], f8[::1], i8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], i8, b1)",
    cache=True, nogil=True, error_model="numpy",
)  # fmt: skip
def along(A, B, C, D, K, u0, y0, w, phi, u, y, share, scale, x, free, e, H, b, block, slopes):
    """Errors e (N, ny) of the run from x (nx), over `scale` (ny), 0 where y is NaN; with `slopes` H += J'J, b += J'e.

    b (blocks, P + nx) by blocks of so many samples, a row each: what they have in common is for the uncertainty.

    A .. K: by term, weights w (N, nt); u0 (m, nu) and y0 (m, ny) by operating-point function, phi (N, m). free (P, 4): see
    IN_A ..; the columns of H (P + nx) are these and then the start x. J = -de/dtheta. A run that is lost ends: its errors from
    there are inf.
    """
    N, ny = y.shape
    nt, nx, nu, m, P = A.shape[0], A.shape[1], B.shape[2], phi.shape[1], len(free)
    Ak, Bk, Ck, Dk, Kk = np.empty((nx, nx)), np.empty((nx, nu)), np.empty((ny, nx)), np.empty((ny, nu)), np.empty((nx, ny))
    S, T = np.zeros((nx, P + nx)), np.zeros((nx, P + nx))
    J, Jy = np.zeros((ROWS + ny, P + nx)), np.zeros((ny, P + nx))
    R = np.zeros(ROWS + ny)
    for i in range(nx if slopes else 0):
        S[i, P + i] = 1.0
    z, missed, v = np.empty(nx), np.empty(ny), np.empty(nu)
    filled = 0
    for k in range(N):
        Ak[:], Bk[:], Ck[:], Dk[:], Kk[:] = 0.0, 0.0, 0.0, 0.0, 0.0
        for t in range(nt):
            if w[k, t] != 0.0:
                Ak += w[k, t] * A[t]
                Bk += w[k, t] * B[t]
                Ck += w[k, t] * C[t]
                Dk += w[k, t] * D[t]
                Kk += w[k, t] * K[t]
        for i in range(nu):
            v[i] = u[k, i]
            for t in range(m):
                v[i] -= phi[k, t] * u0[t, i]
        for r in range(ny):
            total = y[k, r]
            for i in range(nx):
                total -= Ck[r, i] * x[i]
            for i in range(nu):
                total -= Dk[r, i] * v[i]
            for i in range(m):
                total -= phi[k, i] * y0[i, r]
            if abs(total) > 1e100:
                e[k:] = np.inf
                return
            missed[r] = total if total == total else 0.0
            e[k, r] = missed[r] / scale[r]
        if slopes:
            np.dot(Ck, S, Jy)
            for p in range(P):
                kind, t, r, c = free[p]
                if kind == IN_C:
                    Jy[r, p] += w[k, t] * x[c]
                elif kind == IN_D:
                    Jy[r, p] += w[k, t] * v[c]
                elif kind == IN_OFFSET:
                    Jy[r, p] += phi[k, t]
                elif kind == IN_ZERO:
                    for i in range(ny):
                        Jy[i, p] -= phi[k, t] * Dk[i, c]
            for r in range(ny):
                if y[k, r] == y[k, r]:
                    J[filled] = Jy[r] / scale[r]
                    R[filled] = e[k, r]
                    filled += 1
                else:
                    Jy[r] = 0.0
            if filled > ROWS - ny or (k + 1) % block == 0 or k == N - 1:
                H += J[:filled].T @ J[:filled]
                b[k // block] += J[:filled].T @ R[:filled]
                filled = 0
            np.dot(Ak, S, T)
            for p in range(P):
                kind, t, r, c = free[p]
                if kind == IN_A:
                    T[r, p] += w[k, t] * x[c]
                elif kind == IN_B:
                    T[r, p] += w[k, t] * v[c]
                elif kind == IN_GAIN:
                    T[r, p] += share * missed[c]
                elif kind == IN_ZERO:
                    for i in range(nx):
                        T[i, p] -= phi[k, t] * Bk[i, c]
            if share > 0.0:
                T -= share * (Kk @ Jy)
            S[:] = T
        for i in range(nx):
            total = 0.0
            for j in range(nx):
                total += Ak[i, j] * x[j]
            for j in range(nu):
                total += Bk[i, j] * v[j]
            for j in range(ny):
                total += share * Kk[i, j] * missed[j]
            z[i] = total
        x[:] = z
