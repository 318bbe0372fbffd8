"""The worst regressor: f(c) = min over |psi - psi_k| <= r of c'psi + lam'|T psi|, with its proof.

f is convex and piecewise linear in psi; its minimum over a box lies at a vertex of the arrangement of the facets
psi_j = psi_kj +- r_j and the kinks t_i'psi = 0. T is block diagonal, so every block is minimised for itself by going through its
few vertices. By duality, for every s with |s_i| <= lam_i

    f(c) >= (c + T's)'psi_k - |c + T's|'r,

with equality for the s that belongs to the minimum: whoever has s needs no trust in how it was found.
"""

import itertools

import numpy as np

from workbench.errors import InputError
from workbench.intervals.regressors import Form
from workbench.records import field, record

LARGEST = 4  # entries of a block: 495 vertices; differences of higher orders are noise anyway


@record
class Minimum:
    """value (K) of f, the regressor psi (K m) where it is reached, and the multipliers s (K p) that prove it."""

    value: np.ndarray = field("K")
    psi: np.ndarray = field("K m")
    s: np.ndarray = field("K p")


class WorstRegressor:
    """Minimises c'psi + lam'|T psi| over boxes of half-width r (m) around given regressors."""

    def __init__(self, form: Form, r: np.ndarray):
        self.T, self.r = form.T, r
        self.reach = np.abs(form.T) @ r  # half-width of z = T psi
        self.blocks = [np.array(b) for b in form.blocks if np.any(r[list(b)] > 0)]
        self.coupled = [b for b in self.blocks if len(b) > 1]
        largest = max((len(b) for b in self.coupled), default=0)
        if largest > LARGEST:
            raise InputError(
                f"{largest} values of one channel with errors in delta form",
                mend=f"use an order up to {LARGEST - 1}, the shift form, or exact regressors",
            )
        self.vertices = {len(b): _vertices(form.T[np.ix_(b, b)]) for b in self.coupled}

    def bound(self, c: np.ndarray, lam: np.ndarray, z: np.ndarray) -> np.ndarray:
        """A lower bound (K) of f that takes the entries of z = T psi (K p) as independent; sharp without coupled blocks."""
        per_z = np.linalg.solve(self.T.T, c)
        value = z @ per_z + np.abs(z) @ lam
        for i in np.flatnonzero(self.reach):
            low, high = z[:, i] - self.reach[i], z[:, i] + self.reach[i]
            ends = np.minimum(per_z[i] * low + lam[i] * np.abs(low), per_z[i] * high + lam[i] * np.abs(high))
            ends = np.where((low < 0) & (high > 0), np.minimum(ends, 0.0), ends)
            value += ends - (per_z[i] * z[:, i] + lam[i] * np.abs(z[:, i]))
        return value

    def proposal(self, c: np.ndarray, lam: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Multipliers (K p) that prove `bound`."""
        at_kink = np.clip(-np.linalg.solve(self.T.T, c), -lam, lam)
        return np.where(np.abs(z) < self.reach, at_kink, lam * np.sign(z))

    def minimum(self, c: np.ndarray, lam: np.ndarray, psi: np.ndarray) -> Minimum:
        """f exactly, at the regressors psi (K m)."""
        worst = psi.copy()
        s = lam * np.sign(psi @ self.T.T)
        for block in self.blocks:
            T, r = self.T[np.ix_(block, block)], self.r[block]
            found = _in_block(T, r, c[block], lam[block], psi[:, block], self.vertices.get(len(block)))
            worst[:, block], s[:, block] = found
        value = worst @ c + np.abs(worst @ self.T.T) @ lam
        return Minimum(value, worst, s)


@record
class _Vertex:
    """psi = fixed coordinates at low or high, the others from kinks: psi = P psi_fixed; see `_vertices`."""

    sides: np.ndarray  # (n) -1 low, +1 high, 0 free
    free: np.ndarray  # coordinates inside the box
    kinks: np.ndarray  # rows of T that vanish
    solve: np.ndarray  # (free, fixed): psi_free = solve psi_fixed
    dual: np.ndarray  # inverse of T[kinks, free] transposed: s_kinks = dual (-(c + T_rest's_rest)_free)


def _vertices(T: np.ndarray) -> list[_Vertex]:
    """All vertices of the arrangement of one block."""
    n = len(T)
    found = []
    for sides in itertools.product((-1, 1, 0), repeat=n):
        side = np.array(sides)
        free, fixed = np.flatnonzero(side == 0), np.flatnonzero(side != 0)
        for kinks in itertools.combinations(range(n), len(free)):
            rows = np.array(kinks, dtype=int)
            square = T[np.ix_(rows, free)]
            if len(free) and abs(np.linalg.det(square)) < 0.5:  # T holds whole numbers
                continue
            inverse = np.linalg.inv(square) if len(free) else np.zeros((0, 0))
            found.append(_Vertex(side, free, rows, -inverse @ T[np.ix_(rows, fixed)], inverse.T))
    return found


def _in_block(T, r, c, lam, psi, vertices: list[_Vertex] | None) -> tuple[np.ndarray, np.ndarray]:
    """The minimising entries (K n) and their multipliers (K n) of one block."""
    if vertices is None:  # a block of one entry
        vertices = _vertices(T)
    low, high = psi - r, psi + r
    slack = 1e-12 * (np.abs(psi) + r)
    best = np.full(len(psi), np.inf)
    worst = psi.copy()
    which = np.zeros(len(psi), dtype=int)
    for j, vertex in enumerate(vertices):
        at = np.where(vertex.sides < 0, low, high)
        if len(vertex.free):
            fixed = np.flatnonzero(vertex.sides != 0)
            at[:, vertex.free] = at[:, fixed] @ vertex.solve.T
        value = at @ c + np.abs(at @ T.T) @ lam
        inside = ((at >= low - slack) & (at <= high + slack)).all(axis=1)
        better = inside & (value < best)
        best[better], worst[better], which[better] = value[better], at[better], j
    return np.clip(worst, low, high), _multipliers(T, c, lam, worst, which, vertices)


def _multipliers(T, c, lam, worst, which, vertices: list[_Vertex]) -> np.ndarray:
    """s (K n): lam times the sign of t_i'psi, and at a kink what makes c + T's vanish at the coordinates inside the box."""
    s = lam * np.sign(worst @ T.T)
    for j in np.unique(which):
        vertex, rows = vertices[j], np.flatnonzero(which == j)
        if not len(vertex.kinks):
            continue
        own = s[rows]
        own[:, vertex.kinks] = 0.0
        rest = c[vertex.free] + own @ T[:, vertex.free]
        own[:, vertex.kinks] = -rest @ vertex.dual.T
        s[rows] = own
    return np.clip(s, -lam, lam)
