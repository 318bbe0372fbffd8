"""The margin of a loop whose schedule moves, from both sides: certified <= margin <= falsified.

Falsified: a schedule rho(k) and parameters delta(k) that repeat after L samples, the schedule within its range and never faster
than its rate, from the last sample to the first too, with which the loop grows:

    |pole of A(rho(L-1), kappa delta(L-1)) .. A(rho(0), kappa delta(0))| >= 1

delta steps to the signs of its slopes as in `margins`, where the slope of |pole| along a change dA of one matrix is Re(l' dA x).
The schedules of one rate and range are a convex set, over which the slope is linear: a linear program says where the schedule
would go if the slope stayed what it is, and the best of a few points on the way there is taken (Frank and Wolfe 1956). Both
start from schedules that stand still at their worst, and from schedules that move back and forth as fast as they may.

What is found is replayed with the matrices of the loop itself, not with those between the nodes of its certificate.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from workbench.errors import InputError
from workbench.records import field, record
from workbench.robustness.lyapunov import STEP, ScheduledCertificate, ScheduledLoop, largest, scheduled_loop
from workbench.robustness.margins import MOST, SWEEPS, Orbits, falsified, frozen_margin, orbits
from workbench.robustness.uncertain import UncertainLoop

LENGTHS = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 20, 25, 32)  # samples of a periodic sequence
LONGEST = 64  # a schedule that needs longer from end to end and back is slow: it gains little over one that stands still
ROOM = 30  # samples up to which a sequence found for a schedule that stands still is repeated, to give the schedule room
WAYS = (1.0, 0.5, 0.2, 0.05)  # of the way to where a slope leads, that are tried
GROWS = 1.0 + 1e-9  # what a sequence must reach: more than whoever replays it in another order of operations rounds away
WITHIN = 1.0 - 1e-9  # of its movement that is left of a schedule, so that it is within its rate when rounded


@record
class ScheduledFalsified:
    """kappa, and a schedule rho (L) and parameters delta (L p) which, repeated, multiply a state by `growth` >= 1 each time."""

    kappa: float
    rate: float
    rho: np.ndarray = field("L")
    delta: np.ndarray = field("L p", low=-1.0, high=1.0)
    growth: float

    def __post_init__(self):
        fastest = np.abs(np.diff(self.rho, append=self.rho[:1])).max()
        if fastest > self.rate:
            raise InputError(f"a schedule that moves by {fastest:g} a sample, not {self.rate:g}", file="ScheduledFalsified")

    @property
    def moves(self) -> bool:
        """Whether the schedule moves at all."""
        return bool(np.ptp(self.rho) > 0.0)

    def replay(self, at: Callable[[float], UncertainLoop]) -> float:
        """Largest modulus of a pole of the product over one period, of the loop's own matrices."""
        return float(_grown(_Sampled.of(at, self.rho), self.kappa, self.delta))


@record
class ScheduledMargin:
    """certified.kappa <= the margin for a schedule within its rate and parameters that move as they like <= falsified.kappa.

    standing: the worst found of schedules that do not move. loop: of whose numbers the certificate is proved.
    """

    loop: ScheduledLoop
    certified: ScheduledCertificate
    falsified: ScheduledFalsified
    standing: ScheduledFalsified

    @property
    def gap(self) -> float:
        """falsified / certified, 1 where nothing is left open."""
        return self.falsified.kappa / self.certified.kappa


def scheduled_margin(
    at: Callable[[float], UncertainLoop],
    nodes: Sequence[float] | np.ndarray,
    rate: float,
    kinks: Sequence[float] | np.ndarray = (),
    step: float = STEP,
    seed: int = 0,
) -> ScheduledMargin:
    """Both bounds of the margin of the loops at(rho), over the range of the nodes, for |rho+ - rho| <= rate a sample.

    nodes, kinks: see `scheduled_loop`; step: see `largest`. Raises InputError where no bound is found.
    """
    loop = scheduled_loop(at, nodes, kinks)
    standing, worst = falsified_schedule(at, loop, rate, seed)
    if worst.kappa == 0.0:
        raise InputError(
            f"a schedule that moves by {rate:g} a sample loses the loop in the middle of the boxes",
            file="scheduled_margin",
            mend="a slower schedule, or a law whose gains differ less",
        )
    return ScheduledMargin(loop, largest(loop, rate, worst.kappa, step), worst, standing)


def falsified_schedule(
    at: Callable[[float], UncertainLoop], loop: ScheduledLoop, rate: float, seed: int = 0
) -> tuple[ScheduledFalsified, ScheduledFalsified]:
    """The smallest kappa found at which the loop grows: of schedules that stand still, and of all that the rate allows.

    loop: `scheduled_loop` of at; it stands in for at during the search. Raises InputError where no sequence grows.
    """
    random = np.random.default_rng(seed)
    ends = float(loop.nodes[0]), float(loop.nodes[-1])
    best = None
    for sequences in _standing(at, loop, random):
        best = _lost(loop, 0.0, sequences, best) or best
    standing = best
    for sequences in _moving(loop, rate, best, random) if rate > 0.0 else ():
        best = _lost(loop, rate, sequences, best) or best
    if best is None or standing is None:
        raise InputError(
            "no parameters were found that move a pole to the unit circle",
            file="falsified_schedule",
            mend="do the uncertain regressors see what they drive?",
        )
    still, worst = (_replayed(at, found, rate, ends) for found in (standing, best))
    return still, worst if worst.kappa < still.kappa else still


class _Found(NamedTuple):
    """kappa, rho (L), delta (L p) with the numbers of a ScheduledLoop."""

    kappa: float
    rho: np.ndarray
    delta: np.ndarray


class _Sampled(NamedTuple):
    """A (.., L n n), columns (.., L n p) and C of the loops along schedules."""

    A: np.ndarray
    columns: np.ndarray
    C: np.ndarray

    @classmethod
    def of(cls, at: Callable[[float], UncertainLoop], rho: np.ndarray) -> "_Sampled":
        loops = [at(float(value)) for value in rho]
        return cls(*(np.array([getattr(loop, key) for loop in loops]) for key in cls._fields))

    @classmethod
    def between(cls, loop: ScheduledLoop, rho: np.ndarray) -> "_Sampled":
        return cls(*loop.at(rho), loop.C)

    def __call__(self, scaled: np.ndarray) -> np.ndarray:
        """A for parameters kappa delta (.., L p)."""
        return self.A + (self.columns * scaled[..., None, :]) @ self.C


def _grown(loop: _Sampled, kappa: float, delta: np.ndarray) -> np.ndarray:
    """Largest modulus of a pole of the product over one period, (..)."""
    A = loop(kappa * delta)
    whole = A[..., 0, :, :]
    for k in range(1, A.shape[-3]):
        whole = A[..., k, :, :] @ whole
    return np.abs(np.linalg.eigvals(whole)).max(axis=-1)


def _replayed(at: Callable[[float], UncertainLoop], found: _Found, rate: float, ends: tuple[float, float]) -> ScheduledFalsified:
    """What was found, at the kappa at which the loop itself grows."""
    middle = float(found.rho.mean())
    rho = np.clip(middle + WITHIN * (found.rho - middle), *ends) if np.ptp(found.rho) > 0.0 else found.rho
    loop, kappa, more = _Sampled.of(at, rho), found.kappa, 1e-10
    while (growth := _grown(loop, kappa, found.delta)) < GROWS and kappa > 0.0:
        kappa, more = found.kappa * (1.0 + more), 2.0 * more
    return ScheduledFalsified(kappa, rate, rho, found.delta, float(growth))


# ---- where a search begins ------------------------------------------------------------------------------------------------

Sequences = tuple[np.ndarray, np.ndarray]  # rho (S L), delta (S L p)


def _standing(at: Callable[[float], UncertainLoop], loop: ScheduledLoop, random: np.random.Generator) -> Iterator[Sequences]:
    """What loses the loop at both ends and in the middle, tried at every node and in the middle of every cell."""
    grid = np.sort(np.concatenate([loop.nodes, 0.5 * (loop.nodes[1:] + loop.nodes[:-1])]))
    for value in (grid[0], grid[len(loop.nodes) - 1], grid[-1]):
        own = at(float(value)).balanced()
        try:
            delta = falsified(own, frozen_margin(own), int(random.integers(2**31))).delta
        except InputError:  # a loop that nothing loses here may be lost elsewhere
            delta = random.choice([-1.0, 1.0], size=(8, len(loop.C)))
        yield np.repeat(grid[:, None], len(delta), axis=1), np.repeat(delta[None], len(grid), axis=0)


def _moving(loop: ScheduledLoop, rate: float, standing: _Found | None, random: np.random.Generator) -> Iterator[Sequences]:
    """Schedules back and forth as fast as they may, around several values, and at random; with the worst of the parameters."""
    low, high = loop.nodes[0], loop.nodes[-1]
    lengths = set(LENGTHS)
    across = 2 * int(np.ceil((high - low) / rate))  # samples to the other end and back
    lengths |= {length for length in (across, across + 2, across + 6) if length <= LONGEST}
    repeated = [standing.delta] if standing is not None else []
    if repeated:
        own = len(repeated[0])
        lengths |= {own * times for times in (1, 2, max(1, ROOM // own))}
    for length in sorted(lengths):
        turn = np.minimum(np.arange(length), length - np.arange(length)) * rate
        waves = [np.zeros(length), turn, *(np.roll(turn, shift) for shift in random.integers(0, length, 2))]
        waves += [np.minimum(turn, share * turn.max()) for share in (0.5, 0.25)]
        centres = [low, 0.5 * (low + high), high] + ([float(standing.rho.mean())] if standing is not None else [])
        rho = [np.clip(centre + wave - 0.5 * np.ptp(wave), low, high) for centre in centres for wave in waves]
        delta = list(random.choice([-1.0, 1.0], size=(len(rho), length, len(loop.C))))
        if repeated and length % len(repeated[0]) == 0:
            rho, delta = rho * 2, delta + [np.tile(repeated[0], (length // len(repeated[0]), 1))] * len(rho)
        yield np.array(rho), np.array(delta)


# ---- the search -----------------------------------------------------------------------------------------------------------


def _lost(loop: ScheduledLoop, rate: float, sequences: Sequences, best: _Found | None) -> _Found | None:
    """The smallest kappa, below that of the best so far, at which one of the sequences, improved, grows; or None."""
    below, found = MOST if best is None else best.kappa, None
    kappa = below * (1.0 - 1e-6)
    if best is None:  # nobody knows where the margin lies: from below, for far beyond it every sequence grows
        kappa = 1.0 / MOST
        while kappa < MOST and _improved(loop, rate, kappa, sequences)[1].max() < GROWS:
            kappa *= 10.0
    while True:
        sequences, size = _improved(loop, rate, kappa, sequences)
        if size.max() < GROWS:
            return found
        rho, delta = (part[size.argmax()] for part in sequences)
        own = _Sampled.between(loop, rho)
        low, high = 0.0, kappa
        if _grown(own, 0.0, delta) >= GROWS:
            return _Found(0.0, rho, delta)
        while high - low > 1e-7 * high:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if _grown(own, middle, delta) >= GROWS else (middle, high)
        found = _Found(high, rho, delta)
        if high >= kappa * (1.0 - 1e-4):
            return found
        kappa = high * (1.0 - 1e-6)


def _improved(loop: ScheduledLoop, rate: float, kappa: float, sequences: Sequences) -> tuple[Sequences, np.ndarray]:
    """Sequences after steps along their own slopes, while that helps, and their growth (S)."""
    rho, delta = sequences
    own = _Sampled.between(loop, rho)
    at = orbits(own(kappa * delta))
    for _ in range(SWEEPS):
        slope = np.real((at.left[..., None, :] @ own.columns)[..., 0, :] * (at.right @ own.C.T))
        other = np.where(slope == 0.0, delta, np.sign(slope))
        tried_rho, tried_delta = rho[None], other[None]
        if rate > 0.0:
            far = _furthest(loop, rate, _slope(loop, kappa, rho, delta, at))
            on = rho + np.multiply.outer(WAYS, far - rho)
            tried_rho = np.concatenate([tried_rho, on, on])
            tried_delta = np.concatenate([tried_delta, *([which] for which in (delta, other) for _ in WAYS)])
        size = _grown(_Sampled.between(loop, tried_rho), kappa, tried_delta)
        best = size.argmax(axis=0), np.arange(len(rho))
        better = size[best] > at.size * (1.0 + 1e-9)
        if not better.any():
            break
        rho = np.where(better[:, None], tried_rho[best], rho)
        delta = np.where(better[:, None, None], tried_delta[best], delta)
        own = _Sampled.between(loop, rho)
        at = orbits(own(kappa * delta))
    return (rho, delta), at.size


def _slope(loop: ScheduledLoop, kappa: float, rho: np.ndarray, delta: np.ndarray, at: Orbits) -> np.ndarray:
    """Slope of the growth along rho (S L), by differences of the quadratics over a thousandth of the range."""
    by = 1e-3 * float(np.ptp(loop.nodes))
    above, below = np.minimum(rho + by, loop.nodes[-1]), np.maximum(rho - by, loop.nodes[0])
    change = _Sampled.between(loop, above)(kappa * delta) - _Sampled.between(loop, below)(kappa * delta)
    along = np.real((at.left[..., None, :] @ change @ at.right[..., :, None])[..., 0, 0])
    return along / (above - below)


def _furthest(loop: ScheduledLoop, rate: float, slope: np.ndarray) -> np.ndarray:
    """The periodic schedules (S L) within range and rate with the largest slope'rho each: one linear program for all of them."""
    from scipy import sparse
    from scipy.optimize import linprog

    S, L = slope.shape
    if L == 1:
        return np.where(slope >= 0.0, loop.nodes[-1], loop.nodes[0])
    steps = sparse.block_diag([np.roll(np.eye(L), 1, axis=1) - np.eye(L)] * S, format="csr")
    size, range_of = np.maximum(np.abs(slope).max(axis=1, keepdims=True), 1e-300), float(np.ptp(loop.nodes))
    found = linprog(  # of the share of the range, whatever unit the schedule has
        -(slope / size).ravel(),
        sparse.vstack([steps, -steps]),
        np.full(2 * S * L, rate / range_of),
        bounds=(0.0, 1.0),
        method="highs-ds",
    )
    share = np.zeros(S * L) if found.x is None else np.clip(found.x, 0.0, 1.0)
    return (loop.nodes[0] + range_of * share).clip(*loop.nodes[[0, -1]]).reshape(S, L)
