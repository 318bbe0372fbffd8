"""The quadratic program of a linear time-varying prediction, with the states eliminated: compiled.

    x_{i+1} = A_i x_i + B_i u_i + c_i,   y_i = C_i x_i + g_i,   i = 0..N-1
    2 J = sum_{i=1}^{N-1} |y_i - r_i|_Q^2 + sum_{i=0}^{N-1} (|u_i - u_{i-1}|_S^2 + |u_i - ut|_R^2)
          + |(x_N - xt, u_{N-1} - ut)|_P^2
      J = 1/2 U' H U + f' U + constant,   y_{1..N} = Y U + y_free

What u_i moves later is zero in T and Y before; the loops run over the rest.
"""

import numpy as np
from numba import njit

_MATRIX, _VECTOR = "f8[:, ::1]", "f8[::1]"
_PROGRAM = f"Tuple(({_MATRIX}, {_VECTOR}, {_MATRIX}, {_VECTOR}))"


@njit(cache=True, nogil=True, error_model="numpy")
def _move(M, c, i, nu, T, x, after, moved):
    """x_{i+1} = after U + moved from x_i = T U + x."""
    nx, width = len(x), i * nu  # of the commands that have moved x_i
    for a in range(nx):
        total = c[i, a]
        for k in range(nx):
            total += M[i, a * nx + k] * x[k]
        moved[a] = total
        for j in range(width):
            after[a, j] = 0.0
        for k in range(nx):
            entry = M[i, a * nx + k]
            if entry != 0.0:
                for j in range(width):
                    after[a, j] += entry * T[k, j]
        for j in range(nu):
            after[a, width + j] = M[i, nx * nx + a * nu + j]


@njit(cache=True, nogil=True, error_model="numpy")
def _add_errors(H, f, Y, first, error, Q, QY, width):
    """|Y U + error|_Q^2 of the rows from `first` on; QY: room for Q Y; width: of the commands that have moved them."""
    ny = len(error)
    for a in range(ny):
        for j in range(width):
            QY[a, j] = 0.0
        for k in range(ny):
            for j in range(width):
                QY[a, j] += Q[a, k] * Y[first + k, j]
    for a in range(ny):
        for j in range(width):
            f[j] += QY[a, j] * error[a]
            entry = Y[first + a, j]
            for m in range(width):
                H[j, m] += entry * QY[a, m]


@njit(cache=True, nogil=True, error_model="numpy")
def _add_end(H, f, T, x, target, P):
    """The terminal cost on (x_N - xt, u_{N-1} - ut), x_N = T U + x."""
    xt, ut = target
    nx, nu, n = len(xt), len(ut), len(f)
    m = nx + nu
    end, offset = np.zeros((m, n)), np.empty(m)
    end[:nx] = T
    for j in range(nu):
        end[nx + j, n - nu + j] = 1.0
        offset[nx + j] = -ut[j]
    for a in range(nx):
        offset[a] = x[a] - xt[a]
    PE = P @ end
    H += end.T @ PE
    f += offset @ PE


@njit(cache=True, nogil=True, error_model="numpy")
def _add_commands(H, f, last, ut, S, R):
    """The costs of moves and of commands off their target."""
    nu = len(last)
    for i in range(len(f) // nu):
        for j in range(nu):
            for k in range(nu):
                p, q = i * nu + j, i * nu + k
                H[p, q] += S[j, k] + R[j, k]
                f[p] -= R[j, k] * ut[k]
                if i == 0:
                    f[p] -= S[j, k] * last[k]
                else:
                    H[p - nu, q - nu] += S[j, k]
                    H[p - nu, q] -= S[j, k]
                    H[p, q - nu] -= S[j, k]


@njit(
    f"{_PROGRAM}({_MATRIX}, {_MATRIX}, {_MATRIX}, {_VECTOR}, {_MATRIX}, {_VECTOR}, UniTuple({_VECTOR}, 2),"
    f"UniTuple({_MATRIX}, 4))",
    cache=True, nogil=True, error_model="numpy",
)  # fmt: skip
def condense(M, c, g, x0, r, last, target, weights):
    """H (n, n), f (n), Y (N ny, n) and y_free (N ny), n = N nu.

    M (N + 1, nx nx + nx nu + ny nx): A, B, C of every step, flat side by side. c (N, nx), g (N + 1, ny), x0 (nx), r (N + 1, ny),
    last (nu): the command before; target: xt (nx) and ut (nu); weights: Q, S, R and P.
    """
    N, nx, nu, ny = len(c), len(x0), len(last), g.shape[1]
    n, o = N * nu, nx * nx + nx * nu  # o: where C begins
    Q, S, R, P = weights
    H, f, Y, free = np.zeros((n, n)), np.zeros(n), np.zeros((N * ny, n)), np.empty(N * ny)
    T, after = np.zeros((nx, n)), np.zeros((nx, n))  # x_i = T U + x
    x, moved, QY, error = x0.copy(), np.empty(nx), np.empty((ny, n)), np.empty(ny)
    for i in range(N):
        _move(M, c, i, nu, T, x, after, moved)
        T, after = after, T
        x, moved = moved, x
        width = (i + 1) * nu
        for a in range(ny):
            row = i * ny + a
            total = g[i + 1, a]
            for k in range(nx):
                entry = M[i + 1, o + a * nx + k]
                total += entry * x[k]
                for j in range(width):
                    Y[row, j] += entry * T[k, j]
            free[row] = total
            error[a] = total - r[i + 1, a]
        if i < N - 1:
            _add_errors(H, f, Y, i * ny, error, Q, QY, width)
    _add_end(H, f, T, x, target, P)
    _add_commands(H, f, last, target[1], S, R)
    return H, f, Y, free


@njit(
    f"Tuple(({_VECTOR}, {_MATRIX}, {_VECTOR}, {_MATRIX}))({_VECTOR}, i8, i8, i8, {_VECTOR}, {_VECTOR})",
    cache=True, nogil=True, error_model="numpy",
)  # fmt: skip
def steady(M, nx, nu, ny, u, y):
    """What inputs do in the steady state: x = X v + x0 and y = G v + y0 for commands v; returns x0, X, y0, G.

    M: A, B, C flat side by side; u (nu,): what acts beside v; y (ny,): what is measured at x = 0.
    """
    A, B = np.eye(nx) - M[: nx * nx].reshape(nx, nx), M[nx * nx : nx * (nx + nu)].copy().reshape(nx, nu)
    X = np.ascontiguousarray(np.linalg.solve(A, B))
    G = M[nx * (nx + nu) :].copy().reshape(ny, nx) @ X
    return X @ u, X, G @ u + y, G


@njit(
    f"Tuple(({_MATRIX}, {_VECTOR}, {_MATRIX}, {_VECTOR}, {_VECTOR}))({_PROGRAM}, UniTuple({_MATRIX}, 2), {_VECTOR},"
    f"Tuple(({_VECTOR}, {_VECTOR}, i8[::1], {_MATRIX})), f8)",
    cache=True, nogil=True, error_model="numpy",
)  # fmt: skip
def with_limits(program, reach, way, outputs, ridge):
    """The program in (U, s): its H, f, rows, and lower and upper limits, those of the variables first.

    program: as `condense` gives it; reach: lowest and highest commands (N, nu); way (nu,): largest move; outputs: their lower and
    upper limits (ny), those that have any (k,), and the prices (2, k) of breaking them, linear and squared; ridge: what is added
    to H's diagonal, in its mean.
    """
    H, f, Y, free = program
    low, high = reach
    y_low, y_high, soft, prices = outputs
    N, nu = low.shape
    n, k, ny = N * nu, len(soft), len(y_low)
    moves = n - nu
    rows = moves + 2 * k * N
    whole, linear, A = np.zeros((n + k, n + k)), np.empty(n + k), np.zeros((rows, n + k))
    lower, upper = np.empty(n + k + rows), np.empty(n + k + rows)
    mean = 0.0
    for i in range(n):
        mean += H[i, i] / n
    for i in range(n):
        for j in range(n):
            whole[i, j] = H[i, j]
        whole[i, i] += ridge * mean
        linear[i], lower[i], upper[i] = f[i], low[i // nu, i % nu], high[i // nu, i % nu]
    for j in range(k):
        whole[n + j, n + j], linear[n + j], lower[n + j], upper[n + j] = prices[1, j], prices[0, j], 0.0, np.inf
    for i in range(moves):
        A[i, i], A[i, i + nu] = -1.0, 1.0
        lower[n + k + i], upper[n + k + i] = -way[i % nu], way[i % nu]
    for j in range(k):
        for i in range(N):
            row, source = moves + 2 * j * N + i, i * ny + soft[j]
            for m in range((i + 1) * nu):
                A[row, m] = A[row + N, m] = Y[source, m]
            A[row, n + j], A[row + N, n + j] = -1.0, 1.0
            lower[n + k + row], upper[n + k + row] = -np.inf, y_high[soft[j]] - free[source]
            lower[n + k + row + N], upper[n + k + row + N] = y_low[soft[j]] - free[source], np.inf
    return whole, linear, A, lower, upper


@njit(f"{_MATRIX}({_MATRIX}, f8[:, :, ::1], {_VECTOR})", cache=True, nogil=True, error_model="numpy")
def carried(M, K, d):
    """C_i x_i + d, i = 1..N, (N, ny), of x_{i+1} = A_i x_i + K_i d from x_1 = 0; M as in `condense`, K (N + 1, nx, ny)."""
    N, nx, ny = len(M) - 1, K.shape[1], len(d)
    o = M.shape[1] - ny * nx
    out, x, moved = np.empty((N, ny)), np.zeros(nx), np.empty(nx)
    for i in range(1, N + 1):
        for a in range(ny):
            total = d[a]
            for k in range(nx):
                total += M[i, o + a * nx + k] * x[k]
            out[i - 1, a] = total
        for a in range(nx):
            total = 0.0
            for k in range(nx):
                total += M[i, a * nx + k] * x[k]
            for k in range(ny):
                total += K[i, a, k] * d[k]
            moved[a] = total
        x, moved = moved, x
    return out


@njit(f"b1({_MATRIX}, {_VECTOR}, {_VECTOR}, {_VECTOR}, f8)", cache=True, nogil=True, error_model="numpy")
def kept(A, x, lower, upper, slack):
    """Whether x is finite and within its limits, those of the variables first, then of A x; slack: relative to 1 + |value|."""
    bounds = len(lower) - len(A)
    for i in range(len(lower)):
        value = x[i] if i < bounds else 0.0
        if i >= bounds:
            for j in range(len(x)):
                value += A[i - bounds, j] * x[j]
        room = slack * (1.0 + abs(value))
        if not np.isfinite(value) or not (value <= upper[i] + room and value >= lower[i] - room):
            return False
    return True
