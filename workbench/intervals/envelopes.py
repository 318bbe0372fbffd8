"""Envelopes of a free run: where the output can be at every sample when the parameters vary in their box as they like.

Two bounds, always as a pair. The outer one (`workbench.intervals.propagation`) holds every run: it is guaranteed. The inner
one was reached by runs that are kept, parameter sequence and all, and can be played again: nothing narrower can hold. Their
ratio says how much of the outer width is real.

y at one sample is affine in the parameters of each single sample, so its extremes are at sequences of box vertices. They are
found by coordinate ascent with the adjoint: with v the gradient of y(T) in x(k+1), the best delta_i(k) for given others is
sign(v'b) sign(z_i(k)). Neither random sequences nor constant vertices come near: they reach a quarter and a tenth of the width.
"""

from collections.abc import Sequence

import numpy as np

from workbench.errors import InputError
from workbench.intervals.propagation import Bounds, Recursion, hull, intervals, kernel, nominal, simulate, zonotope
from workbench.records import field, record

__all__ = [
    "Bounds",
    "FreeRun",
    "Recursion",
    "Sequences",
    "free_run",
    "hull",
    "intervals",
    "kernel",
    "nominal",
    "simulate",
    "worst_sequences",
    "zonotope",
]

INSTANTS = 15  # samples at which `free_run` looks for the worst sequences when none are given
NOTHING = 1e-9  # width relative to the signal up to which bounds are rounding, and their ratio says nothing
SWEEPS = 30  # at most; three to six are the usual
LONGEST_IN_SPACE = 500  # samples up to which three states get their exact hull: seconds; call `hull` for more


@record
class Sequences:
    """Runs that reach far: y (S, N) = simulate(recursion, delta (S, N, p), start (S, s)).

    Run i was sought as the largest (side 1) or smallest (side -1) output at sample instant[i]. Every delta is -1 or 1.
    """

    instant: np.ndarray = field("S")
    side: np.ndarray = field("S")
    delta: np.ndarray = field("S N p")
    start: np.ndarray = field("S s")
    y: np.ndarray = field()  # NaN once a run has overflowed, which a checked shape would refuse


@record
class FreeRun:
    """Outer bounds low, high and reached bounds reached_low, reached_high around the nominal run; (N) each.

    `method` names the outer bounds; `ratio` is the largest outer width over reached width at the instants: 1 is exact.
    `gain` is the kernel's, where it was used: from 1 on its bounds grow without limit, whatever the recursion does.
    """

    nominal: np.ndarray = field("N")
    low: np.ndarray = field("N")
    high: np.ndarray = field("N")
    reached_low: np.ndarray = field("N")
    reached_high: np.ndarray = field("N")
    method: str
    instants: tuple[int, ...]
    sequences: Sequences
    ratio: float
    gain: float | None = None


def free_run(recursion: Recursion, instants: Sequence[int] | None = None) -> FreeRun:
    """Guaranteed and reached envelope of y(k) over all delta(k) in the box and all initial states.

    Outer: the interval product where there is no state, the exact hull up to two states, with three states and at most
    LONGEST_IN_SPACE samples the hull and the kernel together, the kernel above. Inner: the envelope of the worst sequences
    for each of `instants` (default: where the outer bounds are widest, and INSTANTS - 1 spread over the run); it is sought
    there and only valid between.
    """
    r, n = recursion, len(recursion.b)
    if n <= 2 or (n == 3 and len(r) <= LONGEST_IN_SPACE):
        outer, method = hull(r), ("interval product", "exact segment", "exact polygon", "exact polytope")[n]
    else:
        outer, method = kernel(r), "kernel"
    if method == "exact polytope":  # its thickness of flat sets is not exact: both bounds hold, so does what they share
        other = kernel(r)
        outer = Bounds(np.maximum(outer.low, other.low), np.minimum(outer.high, other.high), other.gain)
    chosen = _spread_instants(outer) if instants is None else tuple(sorted({int(k) for k in instants}))
    found = worst_sequences(r, chosen)
    y = nominal(r).y
    reached_low = np.fmin(y, np.fmin.reduce(found.y, axis=0))
    reached_high = np.fmax(y, np.fmax.reduce(found.y, axis=0))
    at = np.array(chosen)
    ratio = _width_ratio(outer.width[at], (reached_low[at], reached_high[at]), NOTHING * float(np.abs(y).max()))
    return FreeRun(y, outer.low, outer.high, reached_low, reached_high, method, chosen, found, ratio, outer.gain)


def _spread_instants(outer: Bounds) -> tuple[int, ...]:
    N = len(outer.low)
    spread = np.linspace(0, N - 1, INSTANTS)[1:].round().astype(int)
    return tuple(int(k) for k in np.unique(np.append(spread, outer.width.argmax())))


def _width_ratio(outer: np.ndarray, reached: tuple[np.ndarray, np.ndarray], nothing: float) -> float:
    """Largest outer / inner; 1 where both are narrower than `nothing`, the size of rounding."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        ratio = np.where(outer <= nothing, 1.0, outer / (reached[1] - reached[0]))
    return float(np.where(np.isnan(ratio), np.inf, ratio).max())


# ---- the adversary --------------------------------------------------------------------------------------------------


def worst_sequences(recursion: Recursion, instants: Sequence[int], *, starts: int = 32, seed: int = 0) -> Sequences:
    """For each instant T and side: delta(k), e that maximise or minimise y(T), as far as coordinate ascent gets.

    Forward sweeps choose delta(k) for the later ones of the sweep before, backward sweeps for the earlier ones; neither can
    make y(T) worse. Starts for each: the nominal run's gradient (optimal to first order), a constant sign, and random
    signs drawn from `seed`; the best is kept and replayed by `simulate`. After T the run keeps pushing to its side.
    Raises InputError for instants outside the run.
    """
    chosen = np.unique(np.asarray(instants, dtype=int))
    if len(chosen) == 0 or chosen[0] < 0 or chosen[-1] >= len(recursion):
        raise InputError(f"instants {list(instants)}", mend=f"give at least one, each from 0 to {len(recursion) - 1}")
    if starts < 2:
        raise InputError(f"{starts} starts", mend="two are fixed, every further one is random: give at least 2")
    instant, side = np.repeat(chosen, 2), np.tile([1.0, -1.0], len(chosen))
    S, N = len(instant), len(recursion)
    # rows: one per sample, then one per direction of the initial state, which can trap the ascent as well
    random = np.random.default_rng(seed).choice([-1.0, 1.0], (N + recursion.spread.shape[1], S * (starts - 2)))
    signs = np.concatenate([np.zeros((len(random), S)), np.ones((len(random), S)), random], axis=1)
    ascent = _Ascent(recursion, np.tile(instant, starts), np.tile(side, starts), signs[:N], signs[N:].T)
    with np.errstate(over="ignore", invalid="ignore"):
        best = ascent.run().reshape(starts, S).argmax(axis=0) * S + np.arange(S)
    delta = (ascent.sigma[:, best, None] * ascent.sign[:, best]).transpose(1, 0, 2)
    y = simulate(recursion, delta, ascent.start[best])
    return Sequences(instant, side, delta, ascent.start[best], y)


class _Ascent:
    """Coordinate ascent of side y(T) in lanes (L): w(k) = sigma(k) lam'|z(k)|, delta_i(k) = sigma(k) sign z_i(k)."""

    def __init__(self, recursion: Recursion, instant: np.ndarray, side: np.ndarray, sigma: np.ndarray, start: np.ndarray):
        r, L = recursion, len(instant)
        self.r, self.m, self.side = r, r.modes, side
        self.ends = {int(k): np.flatnonzero(instant == k) for k in np.unique(instant)}
        self.last = int(instant.max())
        self.push = side * (1.0 if r.through >= 0 else -1.0)  # where nothing depends on w(k), and at T itself
        self.sigma = sigma  # (N, L)
        self.sign = np.ones((len(r), L, len(r.C)), dtype=np.int8)
        self.start = start  # (L, s)

    def run(self) -> np.ndarray:
        """side y(T) of every lane (L,), after the last sweep that improved one of them."""
        value = self.forward()
        for _ in range(SWEEPS):
            self.backward()
            former, value = value, self.forward()
            if not np.any(value > former + 1e-12 * np.abs(former)):
                break
        return np.where(np.isnan(value), -np.inf, value)

    def forward(self) -> np.ndarray:
        """Run with the signs sigma of the gradient, whatever the sign of z becomes; side y(T) of each lane."""
        r, m, side = self.r, self.m, self.side
        x, value = r.start + self.start @ r.spread.T, np.empty(len(side))
        C, b = r.C.T, r.b
        for k in range(len(r)):
            i = m[k]
            z = x @ C + r.f[k]
            self.sign[k] = np.where(z < 0, -1, 1)
            w = self.sigma[k] * (np.abs(z) @ r.lam[i])
            if k in self.ends:
                at = self.ends[k]
                value[at] = side[at] * (x[at] @ r.c[i] + r.g[k] + r.through * w[at])
            x = x @ r.A[i].T + r.q[k] + w[:, None] * b
        return value

    def backward(self) -> None:
        """v(k) = A'v(k+1) + C'(lam delta(k)) v(k+1)'b along the run: new signs sigma and new initial states."""
        r, m = self.r, self.m
        v = np.zeros((len(self.side), len(r.b)))
        self.sigma[self.last + 1 :] = self.push
        for k in range(self.last, -1, -1):
            i = m[k]
            influence = v @ r.b
            sigma = np.where(influence > 0, 1.0, np.where(influence < 0, -1.0, self.push))
            self.sigma[k] = sigma
            slope = (self.sign[k] * r.lam[i]) @ r.C  # gradient of lam'|z| in x
            v = v @ r.A[i] + (influence * sigma)[:, None] * slope
            if k in self.ends:
                at = self.ends[k]
                v[at] += self.side[at, None] * r.c[i] + abs(r.through) * slope[at]
        pull = v @ r.spread
        self.start = np.where(pull < 0, -1.0, 1.0)
