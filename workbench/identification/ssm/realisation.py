"""The block observer form of a recursion as an LPV model."""

import numpy as np

from workbench.basis import Basis, Powers, unity
from workbench.errors import InputError
from workbench.identification.ssm.recursion import coefficients
from workbench.identification.ssm.regression import Problem
from workbench.lpv import LPVModel, Predictor, Term


def realised(problem: Problem, theta: np.ndarray, n: int) -> LPVModel:
    """The model of coefficients theta (ny, nr, m) of order n."""
    names = problem.names
    basis, unity = _with_unity(problem.basis)
    A, B, C, F, terms = _realise(theta, n, unity)
    D0 = coefficients(theta, n).D
    D = np.zeros((len(terms), *D0.shape))
    D[: np.count_nonzero(unity)] = unity[unity != 0, None, None] * D0
    K = np.zeros((*A.shape[:2], len(names.outputs)))
    K[:] = (A - F)[:, :, : len(names.outputs)]
    return LPVModel(
        name=problem.options.name,
        dt=problem.dt,
        inputs=names.inputs,
        outputs=names.outputs,
        schedules=names.schedules,
        spans=problem.spans,
        basis=basis,
        terms=terms,
        A=A,
        B=B + K @ D0,  # x_i+ = x_(i+1) + a_i y + b_i u with y = x_1 + D u
        C=C,
        D=D,
        operating_point=problem.point,
        predictor=Predictor(F, B, K, warmup=n),
    )


def _with_unity(basis: Basis) -> tuple[Basis, np.ndarray]:
    """A basis that can write the constant 1, and the weights (m) with sum_j weight_j phi_j = 1."""
    if isinstance(basis, Powers) and not np.any(basis.exponents == 0):
        basis = Powers(np.append(basis.exponents, 0.0), basis.scale)
    weight = unity(basis)
    if weight is None:
        problem = "these functions do not add up to a constant, which a delay in the model needs"
        raise InputError(problem, mend="use Gaussian(..., normalised=True), PiecewiseLinear or Powers, or Products of them")
    return basis, weight


def _realise(theta: np.ndarray, n: int, unity: np.ndarray):
    """A, B, C and the shift F by term, and the terms: one per (function, delay) that is used."""
    f, g = coefficients(theta, n).f, coefficients(theta, n).g
    ny, nu = f.shape[1], g.shape[2]
    used: dict[tuple[int, int], int] = {}
    for j in np.flatnonzero(unity):
        used.setdefault((int(j), 0), len(used))
    for i, j in np.argwhere(np.any(f != 0, axis=(1, 2))):
        used.setdefault((int(j), n - 1 - int(i)), len(used))
    for j in np.flatnonzero(np.any(g != 0, axis=(0, 1, 2))):
        used.setdefault((int(j), 0), len(used))
    A = np.zeros((len(used), n * ny, n * ny))
    B, C = np.zeros((len(used), n * ny, nu)), np.zeros((len(used), ny, n * ny))
    for j in np.flatnonzero(unity):
        t = used[int(j), 0]
        A[t, : (n - 1) * ny, ny:] = unity[j] * np.eye((n - 1) * ny)
        C[t, :, :ny] = unity[j] * np.eye(ny)
    F = A.copy()
    for (j, delay), t in used.items():
        i = n - 1 - delay  # lag i + 1: x_{i+1} receives f(p(k - delay)) y(k)
        rows = slice(i * ny, (i + 1) * ny)
        if j < f.shape[3]:
            A[t, rows, :ny] += f[i, :, :, j]
            if delay == 0:
                B[t] = g[:, :, :, j].reshape(n * ny, nu)
    return A, B, C, F, tuple(Term(j, delay) for j, delay in used)
