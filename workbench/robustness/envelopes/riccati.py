"""Compiled recursions of the dual: the Riccati recursion backward, and forward the run that attains the bound."""

import numpy as np
from numba import njit


# One function: in loops of two or three states, calls of functions for its steps cost 12 to 40 % of the recursion, inlined too.
@njit(cache=True, nogil=True, error_model="numpy")
def riccati(loop, multipliers, z, end, slack, guard, floor, into):
    """P, q, v (K + 1) and w = G d + r (K) backward; False where R - guard diag(mu) is not positive definite.

    loop: A, B, C and mode; multipliers: M and mu; end: c and f of the last sample; into: P, q, v, G and r.
    """
    A, B, C, mode = loop
    M, mu = multipliers
    c_end, f_end = end
    P, q, v, G, r = into
    K, p = M.shape
    n, c = B.shape[1], B.shape[2]
    PA, PB, cross = np.empty((n, n)), np.empty((n, c)), np.empty((c, n))
    R, L, base, seen = np.empty((c, c)), np.empty((c, c)), np.empty(c), np.empty(n)
    for i in range(n):
        q[K, i] = 0.0
        for j in range(n):
            P[K, i, j] = 0.0
    v[K] = 0.0
    for k in range(K - 1, -1, -1):
        a, b, own = A[mode[k]], B[mode[k]], C[mode[k]]
        for i in range(n):
            for j in range(n):
                total = 0.0
                for h in range(n):
                    total += P[k + 1, i, h] * a[h, j]
                PA[i, j] = total
            for j in range(c):
                total = 0.0
                for h in range(n):
                    total += P[k + 1, i, h] * b[h, j]
                PB[i, j] = total
        for i in range(c):
            for j in range(c):
                total = 0.0
                for h in range(n):
                    total += b[h, i] * PB[h, j]
                R[i, j] = -total
            for j in range(n):
                total = 0.0
                for h in range(n):
                    total += b[h, i] * PA[h, j]
                cross[i, j] = total
            total = f_end[i] if k == K - 1 else 0.0
            for h in range(n):
                total += b[h, i] * q[k + 1, h]
            base[i] = total
        if floor:
            needed = 0.0  # the trace: no less than the largest eigenvalue
            for i in range(c):
                needed -= 1.1 * R[i, i] / mu[k, i]
            if needed > 1.0:
                for h in range(p):
                    M[k, h] *= needed
                for h in range(c):
                    mu[k, h] *= needed
        for i in range(c):
            R[i, i] += (1.0 - guard) * mu[k, i]
        if not _factor(R, L):
            return False
        for i in range(c):
            R[i, i] += guard * mu[k, i]
        if not _factor(R, L):
            return False
        for j in range(n + 1):  # R^-1 [cross base]
            for i in range(c):
                total = base[i] if j == n else cross[i, j]
                for h in range(i):
                    total -= L[i, h] * (r[k, h] if j == n else G[k, h, j])
                if j == n:
                    r[k, i] = total / L[i, i]
                else:
                    G[k, i, j] = total / L[i, i]
            for i in range(c - 1, -1, -1):
                total = r[k, i] if j == n else G[k, i, j]
                for h in range(i + 1, c):
                    total -= L[h, i] * (r[k, h] if j == n else G[k, h, j])
                if j == n:
                    r[k, i] = total / L[i, i]
                else:
                    G[k, i, j] = total / L[i, i]
        value = v[k + 1] + slack[n]
        for i in range(n):
            seen[i] = c_end[i] if k == K - 1 else 0.0
            for h in range(n):
                seen[i] += a[h, i] * q[k + 1, h]
            for h in range(c):
                seen[i] += cross[h, i] * r[k, h]
        for i in range(c):
            value += base[i] * r[k, i]
        for i in range(n):
            for j in range(i, n):
                total = slack[i] if i == j else 0.0
                for h in range(n):
                    total += a[h, i] * PA[h, j]
                for h in range(c):
                    total += cross[h, i] * G[k, h, j]
                P[k, i, j] = total
        for h in range(p):
            if M[k, h] == 0.0:
                continue
            value += M[k, h] * z[k, h] * z[k, h]
            for i in range(n):
                weighted = M[k, h] * own[h, i]
                seen[i] += weighted * z[k, h]
                for j in range(i, n):
                    P[k, i, j] += weighted * own[h, j]
        for i in range(n):
            q[k, i] = seen[i]
            P[k, i, i] *= 1.0 + slack[n + 1]
            for j in range(i):
                P[k, i, j] = P[k, j, i]
        v[k] = value
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _factor(R, L):
    """Cholesky R = L L'; False where R is not positive definite."""
    for i in range(len(R)):
        for j in range(i + 1):
            total = R[i, j]
            for h in range(j):
                total -= L[i, h] * L[j, h]
            if i == j:
                if not total > 0.0:
                    return False
                L[i, i] = np.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def attaining_run(A, B, mode, G, r, start, d, w):
    """d(k+1) = A d + B w with w = G d + r: the run that attains the bound."""
    K, n, c = len(mode), B.shape[1], B.shape[2]
    for i in range(n):
        d[0, i] = start[i]
    for k in range(K):
        a, b = A[mode[k]], B[mode[k]]
        for i in range(c):
            total = r[k, i]
            for h in range(n):
                total += G[k, i, h] * d[k, h]
            w[k, i] = total
        if k + 1 < K:
            for i in range(n):
                total = 0.0
                for h in range(n):
                    total += a[i, h] * d[k, h]
                for h in range(c):
                    total += b[i, h] * w[k, h]
                d[k + 1, i] = total
