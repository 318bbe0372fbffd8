"""The free run of an LPV model along a record and what every free number does to it, compiled.

    x(k+1) = A(k) x(k) + B(k) v(k) + share K(k) e(k),   e(k) = y(k) - C(k) x(k) - D(k) v(k) - phi(k) y0,   v(k) = u(k) - phi(k) u0

share = 1 is the one-step predictor, 0 the free run; between them a run that is held a little. The sensitivities S = dx/dtheta
obey the same recursion, so J'J and J'e of all free numbers come from one pass, in memory that does not grow with the record.

A schedule that is an output is the run's own, rho = ys + share (y - ys), and answers to every free number:

    S(k+1) = A S + .. + sum_t phi_t'(rho) (A_t x + B_t v + share K_t e) (1 - share) dys/dtheta
"""

import numpy as np
from numba import njit

IN_A, IN_B, IN_C, IN_D, IN_OFFSET, IN_GAIN, IN_ZERO = range(7)  # where a free number stands: kind, term, row, column
ROWS = 64  # of the Jacobian that are multiplied at once


@njit("void(f8[:, :, ::1], f8, f8, f8, f8[::1], f8[::1])", cache=True, nogil=True, error_model="numpy")
def read(table, low, high, rho, value, slope):
    """Basis functions (m) and their slopes at rho, between the nodes of table (M, m, 2) by cubics that meet both."""
    M = len(table)
    h = (high - low) / (M - 1)
    j = min(max(int((rho - low) / h), 0), M - 2)
    t = (rho - low) / h - j
    for i in range(len(value)):
        a, p, b, q = table[j, i, 0], h * table[j, i, 1], table[j + 1, i, 0], h * table[j + 1, i, 1]
        third, second = 2.0 * (a - b) + p + q, 3.0 * (b - a) - 2.0 * p - q
        value[i] = a + t * (p + t * (second + t * third))
        slope[i] = (p + t * (2.0 * second + 3.0 * t * third)) / h


@njit(
    "void(f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1],"
    "f8[:, ::1], f8[:, ::1], f8[:, ::1], f8, f8[::1], f8[::1], i8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], i8, b1,"
    "i8, i8[:, ::1], f8[:, :, ::1], f8, f8)",
    cache=True, nogil=True, error_model="numpy",
)  # fmt: skip
def along(A, B, C, D, K, u0, y0, w, phi, u, y, share, scale, x, free, e, H, b, block, slopes, own, terms, table, low, high):
    """Errors e (N, ny) of the run from x (nx), over `scale` (ny), 0 where y is NaN; with `slopes` H += J'J, b += J'e.

    b (blocks, P + nx) by blocks of so many samples, a row each: what they have in common is for the uncertainty.

    A .. K: by term, weights w (N, nt); u0 (m, nu) and y0 (m, ny) by operating-point function, phi (N, m). free (P, 4): see
    IN_A ..; the columns of H (P + nx) are these and then the start x. J = -de/dtheta. A run that is lost ends: its errors from
    there are inf.

    own: the output that is the schedule, between low and high, or -1: then w and phi hold it. terms (nt, 2): delay and function
    of each term, table: see `read`. Such a model has one operating point, and C and D that do not move.
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
    late, functions = 1 + terms[:, 0].max() if own >= 0 else 1, table.shape[1]
    values, bends = np.zeros((late, functions)), np.zeros((late, functions))  # at rho(k), rho(k-1), ..
    led, weight, moved = np.zeros((late, P + nx)), np.zeros(nt), np.empty(nx)  # led: d rho / d theta
    for i in range(late if own >= 0 else 0):
        read(table, low, high, 0.5 * (low + high), values[i], bends[i])
    filled, rho, held = 0, 0.0, 0.0
    for k in range(N):
        if own >= 0:
            for i in range(late - 1, 0, -1):
                values[i], bends[i], led[i] = values[i - 1], bends[i - 1], led[i - 1]
        for t in range(nt):
            weight[t] = values[terms[t, 0], terms[t, 1]] if own >= 0 else w[k, t]
        Ck[:], Dk[:] = 0.0, 0.0
        for t in range(nt):
            if weight[t] != 0.0:
                Ck += weight[t] * C[t]
                Dk += weight[t] * D[t]
        for i in range(nu):
            v[i] = u[k, i]
            for t in range(m):
                v[i] -= phi[k, t] * u0[t, i]
        for r in range(ny):
            total = 0.0
            for i in range(nx):
                total += Ck[r, i] * x[i]
            for i in range(nu):
                total += Dk[r, i] * v[i]
            for i in range(m):
                total += phi[k, i] * y0[i, r]
            if not abs(total) < 1e100:
                e[k:] = np.inf
                return
            missed[r] = y[k, r] - total if y[k, r] == y[k, r] else 0.0
            e[k, r] = missed[r] / scale[r]
            if r == own:
                held = share if y[k, r] == y[k, r] else 0.0
                rho = total + held * missed[r]
        if slopes:
            np.dot(Ck, S, Jy)
            for p in range(P):
                kind, t, r, c = free[p]
                if kind == IN_C:
                    Jy[r, p] += weight[t] * x[c]
                elif kind == IN_D:
                    Jy[r, p] += weight[t] * v[c]
                elif kind == IN_OFFSET:
                    Jy[r, p] += phi[k, t]
                elif kind == IN_ZERO:
                    for i in range(ny):
                        Jy[i, p] -= phi[k, t] * Dk[i, c]
            if own >= 0:
                led[0] = (1.0 - held) * Jy[own]
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
        if own >= 0:
            if not low < rho < high:
                led[0], rho = 0.0, min(max(rho, low), high)
            read(table, low, high, rho, values[0], bends[0])
            for t in range(nt):
                weight[t] = values[terms[t, 0], terms[t, 1]]
        Ak[:], Bk[:], Kk[:] = 0.0, 0.0, 0.0
        for t in range(nt):
            if weight[t] != 0.0:
                Ak += weight[t] * A[t]
                Bk += weight[t] * B[t]
                Kk += weight[t] * K[t]
        if slopes:
            np.dot(Ak, S, T)
            for p in range(P):
                kind, t, r, c = free[p]
                if kind == IN_A:
                    T[r, p] += weight[t] * x[c]
                elif kind == IN_B:
                    T[r, p] += weight[t] * v[c]
                elif kind == IN_GAIN:
                    T[r, p] += share * missed[c]
                elif kind == IN_ZERO:
                    for i in range(nx):
                        T[i, p] -= phi[k, t] * Bk[i, c]
            if share > 0.0:
                T -= share * (Kk @ Jy)
            for t in range(nt if own >= 0 else 0):
                moved[:] = bends[terms[t, 0], terms[t, 1]] * (A[t] @ x + B[t] @ v + share * (K[t] @ missed))
                for i in range(nx):
                    if moved[i] != 0.0:
                        T[i] += moved[i] * led[terms[t, 0]]
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
