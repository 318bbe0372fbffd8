"""The worst regressor: f(c) = min over |psi - psi_k| <= r of c'psi + lam'|T psi|, with its proof.

By duality, for every s with |s_i| <= lam_i

    f(c) >= C'psi_k - |C|'r,   C = c + T's,                                                                          (1)

with equality for the best s: whoever has s needs no trust in how it was found. The right side is concave and piecewise linear
in s: its maximum lies at a vertex of the arrangement s_i = -+lam_i, C_j = 0. T is block diagonal; the few vertices of a block
are the same for all samples, so one product with psi tries them all. The psi that attains f lies at a vertex of the
arrangement psi_j = psi_kj -+ r_j, (T psi)_i = 0.
"""

import itertools
from collections.abc import Iterator

import numpy as np

from workbench.errors import InputError
from workbench.intervals.regressors import Form
from workbench.records import field, record

LARGEST = 4  # entries of a block: up to 321 vertices; differences of higher orders are noise anyway
AT_ONCE = 1 << 20  # numbers in one product
ROUNDING = 1e-12  # relative: a vertex on the edge of its box may lie this far outside


@record
class Minimum:
    """value (K) of f and the regressors psi (K m) where it is reached."""

    value: np.ndarray = field("K")
    psi: np.ndarray = field("K m")


class WorstRegressor:
    """Minimises c'psi + lam'|T psi| over boxes of half-width r (m) around given regressors."""

    def __init__(self, form: Form, r: np.ndarray):
        self.T, self.r = form.T, r
        self.reach = np.abs(form.T) @ r  # half-width of z = T psi
        blocks = [np.array(b) for b in form.blocks if np.any(r[list(b)] > 0)]
        largest = max((len(b) for b in blocks), default=0)
        if largest > LARGEST:
            raise InputError(
                f"{largest} values of one channel with errors in delta form",
                mend=f"use an order up to {LARGEST - 1}, the shift form, or exact regressors",
            )
        self.blocks = [_Block(entries, form.T[np.ix_(entries, entries)], r[entries]) for entries in blocks]
        self.exact = np.ones(len(r), dtype=bool)
        for block in self.blocks:
            self.exact[block.entries] = False

    def value(self, c: np.ndarray, lam: np.ndarray, psi: np.ndarray) -> np.ndarray:
        """f (K) at the regressors psi (K m)."""
        e = self.exact  # T is block diagonal: entries without error have rows of their own
        value = psi[:, e] @ c[e] + np.abs(psi[:, e] @ self.T[np.ix_(e, e)].T) @ lam[e]
        for block in self.blocks:
            value += block.prove(c, lam, psi).max(axis=1)
        return value

    def multipliers(self, c: np.ndarray, lam: np.ndarray, psi: np.ndarray) -> np.ndarray:
        """The s (K p) that prove f at the regressors psi (K m) by (1)."""
        s = lam * np.sign(psi @ self.T.T)
        for block in self.blocks:
            s[:, block.entries] = block.duals(c, lam)[block.prove(c, lam, psi).argmax(axis=1)]
        return s

    def minimum(self, c: np.ndarray, lam: np.ndarray, psi: np.ndarray) -> Minimum:
        """f and the regressors that attain it, at the regressors psi (K m)."""
        worst = psi.copy()
        for block in self.blocks:
            worst[:, block.entries] = block.attain(c, lam, psi)
        return Minimum(worst @ c + np.abs(worst @ self.T.T) @ lam, worst)


class _Block:
    """Entries of psi that share rows of T, with the vertices of both arrangements.

    Dual vertices s = of_lam lam + of_c c, primal ones psi = below (psi_k - r) + above (psi_k + r), each (V n n).
    """

    def __init__(self, entries: np.ndarray, T: np.ndarray, r: np.ndarray):
        self.entries, self.T, self.r = entries, T, r
        n = len(entries)
        of_lam, of_c, below, above = [], [], [], []
        for i, j in _minors(T):
            inverse = np.linalg.inv(T[np.ix_(i, j)])
            other_i, other_j = np.setdiff1d(range(n), i), np.setdiff1d(range(n), j)
            fixed_s, turned, fixed_psi = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
            fixed_s[other_i, other_i] = fixed_psi[other_j, other_j] = 1.0
            # C_j = 0:   T_ij's_i = -c_j - (the others)                 (T psi)_i = 0:   T_ij psi_j = -(the others)
            fixed_s[np.ix_(i, other_i)] = -inverse.T @ T[np.ix_(other_i, j)].T
            turned[np.ix_(i, j)] = -inverse.T
            fixed_psi[np.ix_(j, other_j)] = -inverse @ T[np.ix_(i, other_j)]
            for sides in itertools.product((-1.0, 1.0), repeat=len(other_i)):
                of_lam.append(_columns(fixed_s, other_i, np.array(sides)))
                of_c.append(turned)
                below.append(_columns(fixed_psi, other_j, np.array(sides) < 0))
                above.append(_columns(fixed_psi, other_j, np.array(sides) > 0))
        self.of_lam, self.of_c = np.array(of_lam), np.array(of_c)
        self.below, self.above = np.array(below), np.array(above)

    def duals(self, c: np.ndarray, lam: np.ndarray) -> np.ndarray:
        """The dual vertices (V' n) that lie within |s| <= lam."""
        lam = lam[self.entries]
        s = self.of_lam @ lam + self.of_c @ c[self.entries]
        return np.clip(s[(np.abs(s) <= lam * (1 + ROUNDING)).all(axis=1)], -lam, lam)

    def prove(self, c: np.ndarray, lam: np.ndarray, psi: np.ndarray) -> np.ndarray:
        """(K V'): the right side of (1) for every dual vertex."""
        C = c[self.entries] + self.duals(c, lam) @ self.T
        return psi[:, self.entries] @ C.T - np.abs(C) @ self.r

    def attain(self, c: np.ndarray, lam: np.ndarray, psi: np.ndarray) -> np.ndarray:
        """The minimising entries (K n)."""
        psi, c, lam = psi[:, self.entries], c[self.entries], lam[self.entries]
        found = np.empty_like(psi)
        step = max(AT_ONCE // self.below[:, 0].size, 1)
        for k in range(0, len(psi), step):
            low, high = psi[k : k + step] - self.r, psi[k : k + step] + self.r
            at = low @ self.below.transpose(0, 2, 1) + high @ self.above.transpose(0, 2, 1)  # (V step n)
            slack = ROUNDING * (np.abs(psi[k : k + step]) + self.r)
            inside = ((at >= low - slack) & (at <= high + slack)).all(axis=2)
            value = np.where(inside, at @ c + np.abs(at @ self.T.T) @ lam, np.inf)
            found[k : k + step] = np.clip(at[value.argmin(axis=0), np.arange(len(low))], low, high)
        return found


def _minors(T: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Rows i and columns j of every regular square part of T, the empty one included."""
    n = len(T)
    for size in range(n + 1):
        for i, j in itertools.product(itertools.combinations(range(n), size), repeat=2):
            if size == 0 or abs(np.linalg.det(T[np.ix_(i, j)])) > 0.5:  # T holds whole numbers
                yield np.array(i, dtype=int), np.array(j, dtype=int)


def _columns(M: np.ndarray, chosen: np.ndarray, factors: np.ndarray) -> np.ndarray:
    scaled = np.zeros_like(M)
    scaled[:, chosen] = M[:, chosen] * factors
    return scaled
