"""Checks a proof file: `python checker.py FILE..` accepts or rejects every claim in it. Its only library is numpy.

It shares nothing with the program that wrote the file, neither code nor intermediate results: of a bound along a run it reads
matrices and limits and finds a bound of its own. The format and the mathematics are in docs/proofs.md.

All that is proved is proved in balls, a double with a radius that holds the exact number: a product of floats is off by at most
k u |A| |B|, whatever the order of its sums (Higham, Accuracy and Stability of Numerical Algorithms, section 3.5).
"""

import itertools
import json
import math
import sys
from fractions import Fraction
from types import SimpleNamespace

import numpy as np

FORMAT, VERSION = "gain-scheduling proof", 1
U, TINY, UP = 2.0**-53, 1e-250, 1.0 + 1e-10  # rounding, more than underflow takes, more than sums of 10^5 terms are off
GROWS = 1e-6  # share by which kappa may be raised, within what is needed, to see a sequence grow
DEGREE, TERMS, SIGNS = 3, 800, 10  # of the series of constant parameters; signs of parameters beyond are summed one by one
FRESH, FADED = 8, 1e-14  # samples after which rounding is carried on as columns; share of a column that is rounding


class RejectedError(Exception):
    """A claim that the file does not show."""


def need(holds, said):
    if not holds:
        raise RejectedError(said)


# ---- balls -----------------------------------------------------------------------------------------------------------------


class Ball:
    """Real numbers within `rad` of `mid`, entry by entry."""

    __array_ufunc__ = None

    def __init__(self, mid, rad=0.0):
        self.mid = np.asarray(mid, dtype=float)
        self.rad = np.broadcast_to(np.asarray(rad, dtype=float), self.mid.shape)

    @property
    def top(self):
        """No absolute value is larger."""
        return (np.abs(self.mid) + self.rad) * UP

    @property
    def T(self):
        return Ball(self.mid.swapaxes(-1, -2), self.rad.swapaxes(-1, -2))

    def __getitem__(self, at):
        return Ball(self.mid[at], self.rad[at])

    def __add__(self, other):
        other = ball(other)
        mid = self.mid + other.mid
        return Ball(mid, (self.rad + other.rad + U * np.abs(mid)) * UP + TINY)

    def __sub__(self, other):
        return self + ball(other) * -1.0

    def __rsub__(self, other):
        return ball(other) - self

    def __mul__(self, other):
        other = ball(other)
        mid, a, b = self.mid * other.mid, np.abs(self.mid), np.abs(other.mid)
        return Ball(mid, (U * np.abs(mid) + a * other.rad + self.rad * (b + other.rad)) * UP + TINY)

    def __matmul__(self, other):
        other = ball(other)
        a, b, k = np.abs(self.mid), np.abs(other.mid), self.mid.shape[-1]
        rad = (k + 2) * U * (a @ b) + a @ other.rad + self.rad @ (b + other.rad)
        return Ball(self.mid @ other.mid, rad * UP + TINY)

    def __rmatmul__(self, other):
        return ball(other) @ self


def ball(x):
    return x if isinstance(x, Ball) else Ball(x)


def joined(parts, axis):
    parts = [ball(p) for p in parts]
    return Ball(np.concatenate([p.mid for p in parts], axis), np.concatenate([p.rad for p in parts], axis))


def positive(M):
    """Whether every symmetric matrix in the balls (.., n, n) is positive definite: X M X' has a dominant diagonal, X being about
    the inverse of a Cholesky factor of M. Of a dominant diagonal neither X nor X M X' is singular, so that X need not be exact.
    """
    try:
        X = np.linalg.inv(np.linalg.cholesky(0.5 * (M.mid + M.mid.swapaxes(-1, -2))))
    except np.linalg.LinAlgError:
        return False
    G = X @ M @ X.swapaxes(-1, -2)
    least, most = (np.diagonal(own, axis1=-2, axis2=-1) for own in (G.mid - G.rad, G.top))
    return bool((least > (G.top.sum(axis=-1) - most) * UP + UP - 1.0).all())


def outside(M):
    """Whether M has a pole on the unit circle or beyond: else X - M'X M > 0 would have X > 0 (Stein), and x'X x < 0 somewhere."""
    n, one = len(M.mid), np.eye(len(M.mid))
    if not np.abs(np.linalg.eigvals(M.mid)).max() > 1.0 - GROWS:
        return False
    X = np.linalg.solve(np.eye(n * n) - np.kron(M.mid.T, M.mid.T), one.ravel()).reshape(n, n)
    X = X + X.T
    x = np.linalg.eigh(X)[1][:, 0]
    least = x @ ball(X) @ x
    return positive(X - M.T @ X @ M) and least.mid + least.rad < 0.0


class Dyadic:
    """Exact numbers whole 2^exponent: doubles are such, and so is all that sums and products make of them."""

    def __init__(self, whole, exponent=0):
        self.whole, self.exponent = whole, exponent

    def __add__(self, other):
        low = min(self.exponent, other.exponent)
        return Dyadic(sum(d.whole * 2 ** (d.exponent - low) for d in (self, other)), low)

    def __mul__(self, other):
        return Dyadic(self.whole * other.whole, self.exponent + other.exponent)

    def __matmul__(self, other):
        return Dyadic(self.whole @ other.whole, self.exponent + other.exponent)

    @property
    def fractions(self):
        return self.whole * Fraction(2) ** self.exponent


def dyadic(values):
    ratios = [float(v).as_integer_ratio() for v in np.ravel(values)]
    bits = max((below.bit_length() - 1 for _, below in ratios), default=0)
    whole = np.array([(above << bits) // below for above, below in ratios], dtype=object)
    return Dyadic(whole.reshape(np.shape(values)), -bits)


# ---- what a file holds -----------------------------------------------------------------------------------------------------


def read(own, **shapes):
    """Arrays of an entry; in their shapes the same letter is the same number."""
    sizes, found = {}, SimpleNamespace()
    for name, shape in shapes.items():
        value = np.array(own[name], dtype=float)
        need(value.ndim == len(shape) and np.isfinite(value).all(), f"{name} has {value.ndim} axes or is not finite")
        for letter, size in zip(shape, value.shape, strict=True):
            need(sizes.setdefault(letter, size) == size, f"{name} has shape {value.shape}")
        setattr(found, name, value)
    return found


def loop_of(own):
    loop = read(own, A="nn", B="nq", C="pn", lam="p", channel="p")
    need((loop.lam >= 0.0).all() and np.isin(loop.channel, range(loop.B.shape[1])).all(), "boxes or channels make no sense")
    loop.columns = ball(loop.B[:, loop.channel.astype(int)]) * loop.lam
    return loop


def course_of(own):
    """A loop along a run; rows (J p) are the signs of every channel, up to a common one, of is the channel of each."""
    c = read(own, A="Mnn", B="Mnc", C="Mpn", E="Msn", F="Msc", lam="Mp", channel="p", mode="N", q="Nn", g="Ns", f="Np", start="n")
    c.mode, c.channel, c.signals = c.mode.astype(int), c.channel.astype(int), list(own["signals"])
    need(np.isin(own["mode"], range(len(c.A))).all() and np.isin(own["channel"], range(c.B.shape[2])).all(), "no such mode")
    need(len(set(c.signals)) == len(c.signals) == c.E.shape[1] and (c.lam >= 0.0).all(), "signals or boxes make no sense")
    c.before = own["before"] and read(own["before"], q="n", Q="ng", f="p", J="pg", v="s", V="sg")
    sizes = len(c.start), len(c.channel), len(c.signals)
    need(c.before is None or tuple(map(len, (c.before.q, c.before.f, c.before.v))) == sizes, "the rest is of another loop")
    c.known, c.constant = {}, (c.C != 0.0).any(axis=(0, 2))  # the others are errors, new at every sample
    c.rows, c.of, c.summed = [], [], []
    for j in range(c.B.shape[2]):
        used = np.flatnonzero((c.channel == j) & (c.lam > 0.0).any(axis=0))
        c.summed.append(len(used) > SIGNS)
        signs = np.eye(len(used)) if c.summed[j] else np.array(list(itertools.product((1.0, -1.0), repeat=len(used))))
        signs = signs if c.summed[j] or not len(used) else signs[: len(signs) // 2]
        c.rows.append(np.zeros((len(signs), sizes[1])))
        c.rows[j][:, used] = signs
        c.of += [j] * len(signs)
    c.rows, c.of = np.vstack(c.rows), np.array(c.of)
    return c


def limits_of(c, own):
    """Signal, low and high (N) of a limit; null is none."""
    need(own["signal"] in c.signals, f"no signal {own['signal']}")
    ends = [np.array(own[side], dtype=object) for side in ("low", "high")]
    ends = [np.where(np.equal(e, None), far, e).astype(float) for e, far in zip(ends, (-math.inf, math.inf), strict=True)]
    need(not any(np.isnan(e).any() for e in ends), "a limit is no number")
    return c.signals.index(own["signal"]), *(np.broadcast_to(e, c.mode.shape) for e in ends)


# ---- stability -------------------------------------------------------------------------------------------------------------


def falls(claim, _):
    """P - A(d)'P A(d) > 0 for every d in the boxes: by multipliers D, or at the corners of `steps` samples."""
    loop, needed, kappa, P = loop_of(claim["loop"]), float(claim["needed"]), float(claim["kappa"]), read(claim, P="nn").P
    need(
        0.0 < needed <= kappa < math.inf and P.shape == loop.A.shape,
        "wider boxes are asked for than are shown, or P is of another loop",
    )
    need((P == P.T).all() and positive(ball(P)), "P is not symmetric and positive definite")
    at = alive(loop.B[:, loop.channel.astype(int)] * (loop.lam > 0.0), loop.C)
    A, B, C, P = ball(loop.A), loop.columns[:, at] * kappa, ball(loop.C[at]), ball(P)
    if claim["D"] is None:
        need(claim["steps"] in range(1, 13) and claim["steps"] * at.sum() <= 12, "too many corners")
        whole = each = A + (B * np.array(list(itertools.product((-1.0, 1.0), repeat=at.sum()))).reshape(-1, 1, at.sum())) @ C
        for _ in range(claim["steps"] - 1):
            whole = each[:, None] @ whole
            whole = Ball(whole.mid.reshape(-1, *P.mid.shape), whole.rad.reshape(-1, *P.mid.shape))
        need(positive(P - whole.T @ P @ whole), "P does not fall at a corner")
        return f"x'P x falls over {claim['steps']} samples in boxes {kappa:.4g} times as wide"
    D = read(claim, D="p").D
    need(D.shape == at.shape and (D >= 0.0).all(), "D is not a number of 0 or more for each parameter")
    M, D = joined([A, B], 1), np.diag(D[at])
    need(positive(bordered(P - C.T @ D @ C, D) - M.T @ P @ M), "the block of P and D is not positive definite")
    return f"x'P x falls in boxes {kappa:.4g} times as wide"


def alive(columns, C):
    """Parameters that act on the state and whose regressor moves with it; the others change nothing."""
    return (columns != 0.0).any(axis=tuple(range(columns.ndim - 1))) & (C != 0.0).any(axis=1)


def bordered(first, last):
    """[first, 0; 0, last]."""
    zero = np.zeros((*first.mid.shape[:-2], first.mid.shape[-1], len(last)))
    last = np.broadcast_to(last, (*zero.shape[:-2], *last.shape))
    return joined([joined([first, zero], -1), joined([zero.swapaxes(-1, -2), last], -1)], -2)


def grows(claim, _):
    """|pole of A(delta(L-1)) .. A(delta(0))| >= 1 within the boxes."""
    loop, needed, kappa = loop_of(claim["loop"]), float(claim["needed"]), float(claim["kappa"])
    delta, product = read(claim, delta="Lp").delta, dyadic(np.eye(len(loop.A)))
    need(0.0 < kappa <= needed and delta.shape[1:] == loop.lam.shape and len(delta), "the sequence is not of this loop")
    need((np.abs(delta) <= 1.0).all(), "delta leaves the box")
    A, C, columns = dyadic(loop.A), dyadic(loop.C), dyadic(loop.B[:, loop.channel.astype(int)]) * dyadic(loop.lam)
    for d in min(needed, kappa * (1.0 + GROWS)) * delta:
        product = (A + columns * dyadic(d) @ C) @ product
    down = 2 ** max(-product.exponent, 0)
    product = (product.whole * 2 ** max(product.exponent, 0) / down).astype(float)
    need(outside(Ball(product, 2.0 * U * np.abs(product) + TINY)), "no state grows")
    return f"{len(delta)} sets of parameters in boxes {kappa:.4g} times as wide let a state grow"


def falls_in_motion(claim, _):
    """x'P(rho) x falls while rho moves by up to `rate` a sample: six Bernstein coefficients in every cell."""
    own, got = read(claim["loop"], nodes="K", A="Mnn", columns="Mnp", C="pn"), read(claim, P="Knn", W="Jnn", D="Jip")
    needed, kappa, rate = (float(claim[name]) for name in ("needed", "kappa", "rate"))
    K, n, at, width = len(own.nodes), own.A.shape[1], alive(own.columns, own.C), np.diff(own.nodes)
    need(0.0 < needed <= kappa < math.inf and 0.0 <= rate < math.inf, "less is shown than is asked for")
    need(K >= 2 and ((width > 0.0) & (width < math.inf)).all() and len(own.A) == 2 * K - 1, "the nodes make no sense")
    need((*got.P.shape, *got.D.shape) == (K, n, n, K - 1, 6, len(own.C)) and got.W.shape == (K - 1, n, n), "sizes differ")
    need(all((S.swapaxes(1, 2) == S).all() for S in (got.P, got.W)) and (got.D >= 0.0).all(), "P, W or D is no such matrix")
    P, W, C = ball(got.P), ball(got.W), ball(own.C[at])
    need(positive(P) and (rate > 0.0 or not got.W.any()), "P is not positive definite")
    for g, h in itertools.product(range(K - 1), repeat=2):  # what P rises by in cell h, on a way that leaves cell g
        between = max(own.nodes[h] - own.nodes[g + 1], own.nodes[g] - own.nodes[h + 1], 0.0)
        for sign in (1.0, -1.0) if g == h else (math.copysign(1.0, h - g),):
            if rate > 0.0 and between <= rate * UP:
                rise = (P[h + 1] - P[h]) * (Ball(sign * rate / width[h], 4.0 * U * rate / width[h]))
                need(positive(W[g] - rise), f"P may rise by more than W of cell {g}")
    for g, k in itertools.product(range(K - 1), range(6)):
        first, middle, last = (joined([own.A[m], ball(own.columns[m][:, at]) * kappa], 1) for m in range(2 * g, 2 * g + 3))
        M, D = (first, (middle * 4.0 - first - last) * 0.5, last), np.diag(got.D[g, k][at])  # Bernstein coefficients of M
        P_k = P[g] * Ball((5 - k) / 5.0, U) + P[g + 1] * Ball(k / 5.0, U)
        block = bordered(P_k - C.T @ D @ C, D)
        for i, j in itertools.product(range(3), repeat=2):
            if k - i - j in (0, 1):
                share = math.comb(2, i) * math.comb(2, j) / math.comb(5, k)
                block = block - M[i].T @ (P[g + k - i - j] + W[g]) @ M[j] * Ball(share, U)
        need(positive(block), f"P does not fall in cell {g}")
    return f"x'P(rho) x falls in boxes {kappa:.4g} times as wide while rho moves by up to {rate:.4g} a sample"


# ---- all runs --------------------------------------------------------------------------------------------------------------


def largest(c, rows):
    """Of bounds (J) by row of signs the largest of each channel, or the sum where its rows are single parameters."""
    own = [rows[c.of == j] for j in range(len(c.summed))]
    return np.array([r.sum() if s else r.max(initial=0.0) for r, s in zip(own, c.summed, strict=True)]) * UP + TINY


def all_runs(c, still):
    """Between which values (N s) all runs stay whose parameters `still` (p) are constant; of the states the nominal run x (N n)
    and how far off (N n) they are; and the set in which they begin: x(0) + T u + r, |u| <= size, |r| <= slack.
    """
    (N, n), p, of_share = c.q.shape, len(c.channel), [] if c.before is None else range(c.before.Q.shape[1])
    own = np.flatnonzero(still & (c.lam > 0.0).any(axis=0)).tolist()
    level = [(i,) for i in own] + [(p + h,) for h in of_share]
    degree = next(m for m in range(DEGREE, 0, -1) if m == 1 or math.comb(len(level) + m, m) <= TERMS) if own else 1
    number, products = {a: k for k, a in enumerate(level)}, []
    for _ in range(degree - 1):
        below, level = level, []
        for a, i in itertools.product(below, own):
            b = tuple(sorted((*a, i)))
            level += [] if b in number else [b]
            products.append((number[a], i, number.setdefault(b, len(number))))
    (source, factor, target), count = np.array(products, dtype=int).reshape(-1, 3).T, len(number)
    last, moves, shares = slice(count - len(level), count), ~still, [number[p + h,] for h in of_share]

    def driven(i, z, felt):
        """w (c a) of every monomial, of the regressors z (p) without deviations and felt (p a) of the terms."""
        felt, mid, size, rad = felt * c.lam[i][:, None], *np.zeros((3, c.B.shape[2], count))
        first = z * c.lam[i]
        at, to = (c.channel[own], np.arange(len(own))), (c.channel[factor], target)
        mid[at], size[at], rad[at] = first.mid[own], np.abs(first.mid[own]), first.rad[own]
        for whole, part in ((mid, felt.mid), (size, np.abs(felt.mid)), (rad, felt.rad)):
            np.add.at(whole, to, part[factor, source])
        return Ball(mid, (rad + 4.0 * degree * U * size) * UP)

    x, D, T, W0, lost = c.start, np.zeros((n, count)), np.zeros((n, 0)), np.zeros(0), np.zeros(n)
    if (b := c.before) is not None:
        i = c.mode[0]
        signs, Q, J = ball(c.rows * c.lam[i]), np.zeros((n, count)), np.zeros((p, count))
        Q[:, shares], J[:, shares], z = b.Q, b.J, c.C[i] @ ball(x) + b.f
        for _ in range(degree):
            D = np.linalg.solve(np.eye(n) - c.A[i], Q + c.B[i] @ driven(i, z, c.C[i] @ ball(D) + J).mid)
        off = c.A[i] @ ball(D) + Q + c.B[i] @ driven(i, z, c.C[i] @ ball(D) + J) - D
        drive = (signs @ (c.C[i] @ ball(D[:, last]) + J[:, last])).top.sum(axis=1) + (signs * moves @ z).top
        drive = drive + (signs * moves @ J[:, : last.start]).top.sum(axis=1)
        T, W0, lost = rest(c, (c.A[i] @ ball(x) + b.q - x).top + off.top.sum(axis=1), drive * UP)
    start = np.hstack([D[:, shares], T]), np.append(np.ones(len(shares)), W0), lost
    Z, weight, low, high = T, W0, *np.full((2, N, len(c.signals)), -math.inf)
    high, states, away = -high, np.zeros((N, n)), np.full((N, n), math.inf)
    for k, i in enumerate(c.mode):
        A, B, C, E, F, signs = c.A[i], c.B[i], ball(c.C[i]), c.E[i], c.F[i], ball(c.rows * c.lam[i])
        z, v, W = C @ x + c.f[k], E @ ball(x) + c.g[k], driven(i, C @ x + c.f[k], C @ D)
        size, dust, look = (np.abs(Z) @ weight + lost) * UP + TINY, TINY * (1.0 + weight.sum()), joined([signs @ C, E], 0)
        felt = ((np.abs(look.mid @ Z) @ weight) + look.top @ lost + (look.rad + (n + 2) * U * look.top) @ size) * UP + dust
        drive = felt[: len(c.rows)] + (signs @ C @ D[:, last]).top.sum(axis=1) + (signs * moves @ z).top
        w = largest(c, drive * UP)
        half = felt[len(c.rows) :] + np.abs(F) @ w + (E @ ball(D) + F @ W).top.sum(axis=1) + v.rad
        states[k], away[k] = x, (size + np.abs(D).sum(axis=1)) * UP
        if not (np.isfinite(half).all() and max(away[k].max(), w.max(initial=0.0), np.abs(D).max(initial=0.0)) < 1e100):
            away[k:] = math.inf
            break
        low[k], high[k] = v.mid - half * UP - 2.0 * U * np.abs(v.mid), v.mid + half * UP + 2.0 * U * np.abs(v.mid)
        after, onwards = A @ x + c.q[k], A @ D + B @ W.mid
        missed = (A @ ball(x) + c.q[k] - after).top + (A @ ball(D) + B @ W - onwards).top.sum(axis=1)
        lost = (np.abs(A) @ (lost + (n + 2) * U * size) + missed) * UP + dust
        x, D, Z, weight = after, onwards, np.hstack([A @ Z, B]), np.append(weight, w)
        if k % FRESH == FRESH - 1:  # what rounding has taken goes on as columns, and takes what has faded with it
            faded = (np.abs(Z) * weight <= FADED * lost[:, None]).all(axis=0)
            lost = (lost + np.abs(Z[:, faded]) @ weight[faded]) * UP
            Z, weight, lost = np.hstack([Z[:, ~faded], np.eye(n)]), np.append(weight[~faded], lost), np.zeros(n)
    return SimpleNamespace(low=low, high=high, x=states, away=away, start=start)


def runs_of(c, still):
    """`all_runs`, computed once."""
    key = tuple(still)
    if key not in c.known:
        c.known[key] = all_runs(c, still)
    return c.known[key]


def rest(c, missed, drive):
    """T, W, slack: every d = A d + m + B w with |m| <= missed is T w + r, |w| <= W, |r| <= slack, where w_j is what the
    parameters make of C d, and at most `drive` (J) besides for each row of signs.

    (|w|, |r|) is no larger than an affine map of itself with positive coefficients. A point that this map moves down is above all
    solutions; and what nothing drives is 0, so that each machine has one rest.
    """
    i, one = c.mode[0], np.eye(len(c.start))
    inverse = np.linalg.inv(one - c.A[i])
    T, signs = inverse @ c.B[i], ball(c.rows * c.lam[i])
    Y, off, lost = (one - inverse @ (ball(one) - c.A[i])).top, (inverse @ ball(c.B[i]) - T).top, np.abs(inverse) @ missed * UP
    seen, through = (signs @ (c.C[i] @ ball(T))).top, (signs @ c.C[i]).top

    def mapped(W, r):
        w = largest(c, (drive + seen @ W + through @ r) * UP)
        return w, (lost + off @ W + Y @ (np.abs(T) @ W + r)) * UP + TINY

    W, r = np.zeros(len(c.summed)), np.zeros(len(one))
    for _ in range(20000):
        last, (W, r) = np.append(W, r), mapped(W, r)
        if np.all(np.append(W, r) <= last * (1.0 + 1e-11)) or W.max(initial=0.0) > 1e100:
            break
    W, r = W * (1.0 + 1e-9), r * (1.0 + 1e-8)
    need(all((after < before).all() for after, before in zip(mapped(W, r), (W, r), strict=True)), "no set holds all rests")
    return T, W, r


def stays(claim, courses):
    """low <= signal <= high along every run; and until its end the law is linear, at the rest before it too."""
    c = courses[claim["course"]]
    still = c.constant if claim["constant"] else np.zeros(len(c.channel), dtype=bool)
    any_run, own = runs_of(c, c.constant & False), runs_of(c, still)
    low, high = np.maximum(own.low, any_run.low), np.minimum(own.high, any_run.high)
    away = np.minimum(own.away, any_run.away)
    for d in claim["duals"]:
        s, at, bound = dual(c, d, any_run, away)
        low[at, s], high[at, s] = (
            (max(low[at, s], -bound), high[at, s]) if d["side"] < 0 else (low[at, s], min(high[at, s], bound))
        )
    for own in (claim["bound"], *claim["linear"]):
        s, least, most = limits_of(c, own)
        need((low[:, s] >= least).all() and (high[:, s] <= most).all(), f"{own['signal']} may leave its limits")
    for own in claim["linear"] if c.before else ():  # of which the first value counts at the rest
        (s, least, most), (T, size, slack), i = limits_of(c, own), any_run.start, c.mode[0]
        through = c.E[i, s] @ ball(T) + np.append(c.before.V[s], c.F[i, s])
        middle = c.E[i, s] @ ball(c.start) + c.before.v[s]
        half = (through.top @ size + np.abs(c.E[i, s]) @ slack + middle.rad + 2.0 * U * np.abs(middle.mid)) * UP + TINY
        need(least[0] <= middle.mid - half and middle.mid + half <= most[0], f"{own['signal']} may leave its limits at rest")
    s, least, most = limits_of(c, claim["bound"])
    at = np.flatnonzero(np.isfinite(least) | np.isfinite(most))
    need(len(at), "nothing is asked")
    which = "constant parameters" if claim["constant"] else "parameters that move"
    return (
        f"{c.signals[s]} stays within {least[at].min():.4g} to {most[at].max():.4g} from sample {at[0]} to {at[-1]}, for {which}"
    )


def dual(c, d, any_run, away):
    """Signal, instant and what side v is below there: V_k >= sum M z^2 - sum mu w^2 + V_k+1 at every sample of a window."""
    got = read(d, M="Kp", P="Lnn", q="Ln", c="L", x="Kn", nu="h")
    first, instant, side, s, bound = d["first"], d["instant"], d["side"], c.signals.index(d["signal"]), float(d["bound"])
    k = np.arange(first, instant + 1)
    need(type(first) is type(instant) is int and side in (1, -1), "no such sample")
    need(0 <= first <= instant < len(c.mode) and len(k) == len(got.M) == len(got.P) - 1, "sizes differ")
    need(not (got.P[-1].any() or got.q[-1].any() or got.c[-1] < 0.0) and (got.nu >= 0.0).all(), "V ends below 0")
    m, n, lam = c.mode[k], len(c.start), c.lam[c.mode[k]]
    need(got.M.shape == lam.shape and got.x.shape[1] == n and (1e-300 * (lam > 0.0) <= got.M).all(), "no such multipliers")
    ratio = np.where(lam > 0.0, lam**2 / np.where(lam > 0.0, got.M, 1.0), 0.0)
    need(((lam == 0.0) | (np.minimum(lam**2, ratio) > TINY)).all(), "multipliers are out of range")
    ratio = ratio @ np.eye(c.B.shape[2])[c.channel]
    mu, live = (
        np.where(ratio > 0.0, (1.0 - 4.0 * (lam.shape[1] + 4) * U) / np.where(ratio > 0.0, ratio, 1.0), 1.0),
        (ratio > 0.0)[:, None, :],
    )
    x, A, B, C, E, F = ball(got.x[..., None]), c.A[m], c.B[m] * live, c.C[m], c.E[m[-1], s], c.F[m[-1], s] * live[-1, 0]
    step = A @ x + c.q[k][..., None] - np.concatenate([got.x[1:], got.x[-1:]])[..., None]
    one = np.zeros((len(k), 1, n + B.shape[2])), np.ones((len(k), 1, 1))
    H = joined([joined([A, B, step], -1), joined(one, -1)], -2)
    Z = joined([C, np.zeros((len(k), C.shape[1], B.shape[2])), C @ x + c.f[k][..., None]], -1)
    V = np.concatenate([np.concatenate([got.P, got.q[..., None]], -1), np.concatenate([got.q, got.c[:, None]], -1)[:, None]], 1)
    block = 0.0 - H.T @ V[1:] @ H - Z.T @ (Z * got.M[..., None])
    own = np.zeros(block.mid.shape)
    at = np.r_[:n, -1]
    own[:, at[:, None], at] = V[:-1]
    own[:, range(n, n + len(F)), range(n, n + len(F))] = mu
    own[-1, :-1, -1] -= 0.5 * side * np.append(E, F)
    own[-1, -1, :-1] -= 0.5 * side * np.append(E, F)
    need(positive(block + own), "a block of V is not positive definite")
    T, size, slack = any_run.start if first == 0 else (np.eye(n), away[first], np.zeros(n))
    need(len(size) == len(got.nu) and np.isfinite(size).all() and (got.P.swapaxes(1, 2) == got.P).all(), "no start is known")
    off = (any_run.x[first] - x[0, :, 0]).top + slack
    P, q, reached = ball(got.P[0]), ball(got.q[0]), (np.abs(T) @ size) * UP
    beside = (P.top @ (2.0 * reached + off) + 2.0 * q.top) @ off * UP
    base = (E @ x[-1] + c.g[instant, s])[0]
    corner = bound - base * side - got.c[0] - (ball(size) * size * got.nu).top.sum() * UP - beside
    whole = [[np.diag(got.nu) - T.T @ P @ T, 0.0 - T.T @ q[:, None]], [0.0 - q[None] @ T, corner.mid[None, None]]]
    block = joined([joined(row, 1) for row in whole], 0)
    block.rad = block.rad + np.pad(corner.rad[None, None], ((len(size), 0), (len(size), 0)))
    need(positive(block), "V of the start is larger than the bound")
    return s, instant, bound


def leaves(claim, courses):
    """A run from the rest of its machine is beyond a limit at a sample, and within those of the linear law until then."""
    c, at, got = courses[claim["course"]], claim["sample"], read(claim, delta="Np", before="p", share="g")
    need(got.delta.shape == c.f.shape and type(at) is int and at in range(len(c.mode)), "the run is of another loop")
    need(all((np.abs(own) <= 1.0).all() for own in vars(got).values()), "parameters leave their boxes")
    need(c.before is None or len(got.share) == c.before.Q.shape[1], "the shares are of another rest")
    own = c.constant & (c.lam > 0.0).any(axis=0)
    need(not claim["constant"] or (got.delta[:, own] == got.delta[0, own]).all(), "the parameters are not constant")
    of, i, share, x, watched = dyadic(np.eye(c.B.shape[2])[c.channel].T), c.mode[0], Dyadic(1), dyadic(c.start), []

    def step(i, x, delta, q, f, g):
        """The next state and the signals."""
        w = of @ (dyadic(c.lam[i]) * dyadic(delta) * (dyadic(c.C[i]) @ x + f))
        return dyadic(c.A[i]) @ x + dyadic(c.B[i]) @ w + q, dyadic(c.E[i]) @ x + dyadic(c.F[i]) @ w + g

    if b := c.before:
        unstable = outside((ball(c.B[i][:, c.channel]) * c.lam[i] * got.delta[0]) @ c.C[i] + c.A[i])
        begun = got.before == (0.0 if unstable else got.delta[0])  # what comes to no rest begins at that of the middle
        need(not claim["constant"] or begun[own].all(), "the run begins at the rest of another machine")
        q, f, g = (dyadic(h) + dyadic(H) @ dyadic(got.share) for h, H in ((b.q, b.Q), (b.f, b.J), (b.v, b.V)))
        gain = dyadic(c.B[i]) @ (of * dyadic(c.lam[i]) * dyadic(got.before))
        left, right = dyadic(c.A[i]) + gain @ dyadic(c.C[i]), q + gain @ f
        x = solved(np.eye(len(c.start), dtype=int) - left.fractions, right.fractions)
        share = Dyadic(math.lcm(*(v.denominator for v in x)))  # times it all is dyadic
        x = Dyadic(np.array([int(v * share.whole) for v in x], dtype=object))
        watched.append(step(i, x, got.before, *(share * h for h in (q, f, g)))[1])
    for k, i in enumerate(c.mode[: at + 1]):
        x, v = step(i, x, got.delta[k], *(share * dyadic(h[k]) for h in (c.q, c.f, c.g)))
        watched.append(v)
    values = [v.fractions / share.whole for v in watched]
    for own in claim["linear"]:
        s, low, high = limits_of(c, own)
        need((low == low[0]).all() and (high == high[0]).all(), "a limit of the law changes")
        need(all(float(low[0]) <= v[s] <= float(high[0]) for v in values), f"{own['signal']} has left its limits before")
    s, low, high = limits_of(c, claim["bound"])
    v = values[-1][s]
    need(not float(low[at]) <= v <= float(high[at]), f"{c.signals[s]} is within {low[at]} to {high[at]}")
    return f"{c.signals[s]} is {float(v):.6g} at sample {at}, beyond {low[at]:.4g} to {high[at]:.4g}"


def solved(M, right):
    """x of M x = right in fractions."""
    rows = np.column_stack([M, right])
    for k in range(len(rows)):
        pivot = k + int(np.argmax(np.abs(rows[k:, k].astype(float))))
        need(rows[pivot, k] != 0, "the machine has no rest")
        rows[[k, pivot]] = rows[[pivot, k]]
        rows[k] = rows[k] / rows[k, k]
        others = np.arange(len(rows)) != k
        rows[others] = rows[others] - np.outer(rows[others, k], rows[k])
    return rows[:, -1]


def clipped(claim, _):
    """Limits of the law itself are no wider than what is asked."""
    need(len(claim["bounds"]) == len(claim["own"]) > 0, "not every bound has a limit of the law")
    for asked, own in zip(claim["bounds"], claim["own"], strict=True):
        low, high = (np.array([e for e in np.ravel(asked[side]) if e is not None], dtype=float) for side in ("low", "high"))
        need(asked["signal"] == own["signal"] and len(low) + len(high), "nothing is asked, or of another signal")
        need(not len(low) or (own["low"] is not None and low.max() <= float(own["low"])), "the law may go lower")
        need(not len(high) or (own["high"] is not None and high.min() >= float(own["high"])), "the law may go higher")
    return "the limits of the law itself are no wider"


KINDS = {"falls": ("PROVED", falls), "falls in motion": ("PROVED", falls_in_motion), "stays": ("PROVED", stays),
         "clipped": ("PROVED", clipped), "grows": ("FAILED", grows), "leaves": ("FAILED", leaves)}  # fmt: skip


def check(content):
    """[(claim, accepted, what is shown or why it is rejected)] of the content of a file; an error where it is no proof file."""
    with np.errstate(all="ignore"):
        try:
            need((content["format"], content["version"]) == (FORMAT, VERSION), f"not a {FORMAT} of version {VERSION}")
            courses, found = [course_of(own) for own in content["courses"]], []
            for claim in content["claims"]:
                status, checked = KINDS.get(claim["kind"], ("", None))
                try:
                    need(checked and claim["status"] == status, f"{claim['kind']} does not show that it is {claim['status']}")
                    need(claim.get("course", 0) in range(max(len(courses), 1)), "no such course")
                    found.append((claim["claim"], True, checked(claim, courses)))
                except RejectedError as reason:
                    found.append((claim["claim"], False, str(reason)))
            return found
        except (KeyError, TypeError, ValueError, IndexError, AttributeError, ArithmeticError, np.linalg.LinAlgError) as reason:
            raise RejectedError(f"malformed: {type(reason).__name__} {reason}") from None


def main(paths):
    accepted = bool(paths)
    for path in paths:
        try:
            with open(path, encoding="utf-8") as file:
                found = check(json.load(file))
        except (RejectedError, OSError, ValueError) as reason:
            found = [("the file", False, str(reason))]
        for claim, holds, said in found:
            print(f"{'accepted' if holds else 'REJECTED'}  {' '.join(str(claim).split())}: {said}")
        accepted &= bool(found) and all(holds for _, holds, _ in found)
    return 0 if accepted else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
