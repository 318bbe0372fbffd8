"""Verdicts: what is claimed of a loop, whether it is proved or refuted, by how much, and what shows it.

    PROVED      a certificate holds, checked in outward-rounded arithmetic outside the solver
    PASSED      no counterexample among N runs: sampling never proves
    FAILED      a counterexample was found, and replayed
    UNDECIDED   everything else: neither a proof nor a counterexample

A margin is signed: what is left to the limit, in its unit; negative where the limit is broken. Of what is proved it is what the
certificate leaves, of what failed by how much the counterexample breaks the limit: the true value lies on its better side for the
first, on its worse side for the second.

Stability and bounds are of the linear law: they hold as long as no command is at its stop. `bounds_kept` finds out how long.

What is proved holds for parameters that are others at every sample, and so for those that stand still. What refutes is another
matter: unless parameters are said to move, only a run with constant ones does.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import Enum

import numpy as np

from workbench.errors import InputError
from workbench.records import field, record
from workbench.robustness.envelopes import Course, Kernel, dual, kernel, nominal, replay, worst
from workbench.robustness.margins import Falsified, Margin, corners

DUALS = 8  # samples of one signal and side at which a tighter bound is sought
INSTANTS = 4  # samples of one signal and side at which the adversary is asked
MOST_CONSTANT = 8  # parameters up to which all constant corners are run; above, CORNERS of them drawn at random
CORNERS = 256


class Status(Enum):
    """See the module."""

    PROVED = "PROVED"
    PASSED = "PASSED"
    FAILED = "FAILED"
    UNDECIDED = "UNDECIDED"


@record
class Verdict:
    """claim: what is said of the loop; margin [unit]: signed, NaN where there is none; sentence: what it rests on.

    of: what the claim is about, the identified model or the simulated plant. witness: the file that shows it, "" for none.
    every: what is proved that every run stays between, where that is known.
    """

    claim: str
    of: str
    status: Status
    margin: float
    unit: str
    sentence: str
    witness: str = ""
    every: tuple[float, float] | None = None

    def __str__(self) -> str:
        amount = "" if math.isnan(self.margin) else f" ({self.margin:+.3g}{self.unit and ' ' + self.unit})"
        return f"{self.status.value:9} {self.claim}{amount}: {self.sentence}"

    def to_dict(self) -> dict[str, object]:
        """Plain values; a margin that is no number is null."""
        margin = self.margin if math.isfinite(self.margin) else None
        return {**vars(self), "status": self.status.value, "margin": margin}

    def shown_by(self, witness: str) -> "Verdict":
        return replace(self, witness=witness)


#: From good to bad.
ORDER = (Status.PROVED, Status.PASSED, Status.UNDECIDED, Status.FAILED)


def overall(verdicts: Sequence[Verdict]) -> Status:
    """The worst of them."""
    if not verdicts:
        raise InputError("no claim", mend="give limits")
    return max((v.status for v in verdicts), key=ORDER.index)


# ---- stability -----------------------------------------------------------------------------------------------------


def refuting(found: Margin, moving: bool) -> Falsified:
    """The sequence that refutes: of parameters that move, or of constant ones."""
    if moving:
        return found.falsified
    kappa, delta = found.frozen.kappa * (1.0 + 1e-9), np.atleast_2d(found.frozen.delta)
    return Falsified(kappa, delta, Falsified(kappa, delta, 1.0).replay(found.loop))


def stability(found: Margin, needed: float, claim: str, of: str, *, moving: bool) -> Verdict:
    """Whether the boxes may be `needed` times as wide; moving: whether parameters that move refute it too."""
    low, high, lost = found.certified.kappa, found.falsified.kappa, refuting(found, moving)
    if low >= needed and found.certified.holds(found.loop):
        return Verdict(
            claim, of, Status.PROVED, low - needed, "boxes",
            f"a quadratic function of the state falls at every sample, whatever the parameters do, up to boxes {low:.3g} times "
            f"as wide; from {high:.3g} on a sequence is known that the loop does not survive",
        )  # fmt: skip
    if lost.kappa < needed and lost.replay(found.loop) >= 1.0:
        what = f"{len(lost.delta)} sets of parameters in turn let" if moving else "constant parameters let"
        said = f"in boxes {lost.kappa:.3g} times as wide {what} a state grow without end"
        return Verdict(claim, of, Status.FAILED, lost.kappa - needed, "boxes", said)
    said = f"proved up to boxes {low:.3g} times as wide; moving parameters refute it from {high:.3g} on"
    said += "" if moving else f", constant ones from {lost.kappa:.3g} on"
    return Verdict(claim, of, Status.UNDECIDED, low - needed, "boxes", said)


# ---- bounds along a run --------------------------------------------------------------------------------------------


@record
class Bound:
    """low <= signal <= high at every sample (N), infinite where nothing is asked; claim, unit: how it is told."""

    claim: str
    signal: str
    unit: str
    low: np.ndarray = field("N", low=-np.inf)
    high: np.ndarray = field("N", high=np.inf)


@record
class Tried:
    """Runs v (R N s) under parameters delta (R N p)."""

    v: np.ndarray
    delta: np.ndarray


@record
class Kept:
    """The verdict on a bound; the run v (N s), delta (N p) that comes nearest to breaking it, parameters moving or constant."""

    bound: Bound
    verdict: Verdict
    v: np.ndarray = field()
    delta: np.ndarray = field()


def bounds_kept(
    course: Course,
    bounds: Sequence[Bound],
    stops: Sequence[Bound] = (),
    *,
    of: str,
    moving: bool,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Kept]:
    """A verdict on every bound over all parameters within their boxes.

    stops: of the commands, within which the law is linear. From where it is not proved that they are kept nothing else is.
    moving: whether parameters that move refute a bound too.
    """
    outer, run = kernel(course), nominal(course).v
    free = len(course)
    for stop in stops:
        progress(stop.claim)
        free = min(free, _proved_until(course, outer, run, stop))
    constant = None if moving else _constant_runs(course, seed)
    found = []
    for bound in bounds:
        progress(bound.claim)
        furthest = _moving_runs(course, run, bound, seed)
        tried = furthest if constant is None else _with_noise(course, constant, bound, stops, seed)
        until = _proved_until(course, outer, run, bound)
        found.append(_judged(course, outer, run, bound, tried, furthest, until, free, stops, of))
    return found


def _sides(bound: Bound) -> list[tuple[int, np.ndarray]]:
    """(side, limit): side v <= limit, for the sides at which anything is asked."""
    both = ((1, bound.high), (-1, -bound.low))
    return [(side, limit) for side, limit in both if np.isfinite(limit).any()]


def _moving_runs(course: Course, run: np.ndarray, bound: Bound, seed: int) -> Tried:
    """The adversary, where the run in the middle comes nearest to the bound and at samples spread over it."""
    i, questions = course.number(bound.signal), []
    for side, limit in _sides(bound):
        counted = np.flatnonzero(np.isfinite(limit))
        nearest = counted[(side * run[counted, i] - limit[counted]).argmax()]
        spread = counted[np.linspace(0, len(counted) - 1, INSTANTS + 1).round().astype(int)[1:]]
        questions += [(bound.signal, int(k), side) for k in np.unique(np.append(spread, nearest))]
    found = worst(course, questions, seed=seed)
    return Tried(found.v, found.delta)


def _explained(course: Course) -> np.ndarray:
    """Which parameters (p) belong to regressors that move with the loop; the others are errors that come new at every sample."""
    return np.abs(course.C).max(axis=(0, 2), initial=0.0) > 0.0


def _constant_runs(course: Course, seed: int) -> Tried:
    """Runs at constant corners of the box, without errors that no parameter explains."""
    own = np.flatnonzero(_explained(course) & (course.lam.max(axis=0) > 0.0))
    if len(own) <= MOST_CONSTANT:
        at = corners(len(own))
    else:
        at = np.random.default_rng(seed).choice([-1.0, 1.0], size=(CORNERS, len(own)))
    delta = np.zeros((len(at), course.lam.shape[1]))
    delta[:, own] = at
    every = np.broadcast_to(delta[:, None, :], (len(at), len(course), delta.shape[1]))
    return Tried(replay(course, every), every)


def _with_noise(course: Course, constant: Tried, bound: Bound, stops: Sequence[Bound], seed: int) -> Tried:
    """The constant run that comes nearest to a bound, and the worst errors on top of it."""
    i = course.number(bound.signal)
    excess = _excess(constant.v, bound, i, _linear_until(course, constant.v, stops))
    at = int(excess.max(axis=1).argmax())
    best = Tried(constant.v[at : at + 1], constant.delta[at : at + 1])
    if not (course.lam[:, ~_explained(course)] > 0.0).any():
        return best
    fixed = course.at(best.delta[0, 0])
    errors = _moving_runs(fixed, best.v[0], bound, seed)
    delta = best.delta + np.where(_explained(course), 0.0, errors.delta)
    return Tried(replay(course, delta), delta)


def _excess(v: np.ndarray, bound: Bound, signal: int, linear: np.ndarray) -> np.ndarray:
    """By how much runs v (R N s) break a bound, (R N); -inf from where a command is at its stop."""
    excess = np.maximum(bound.low - v[:, :, signal], v[:, :, signal] - bound.high)
    return np.where(np.arange(v.shape[1]) >= linear[:, None], -np.inf, np.nan_to_num(excess, nan=-np.inf))


def _proved_until(course: Course, outer: Kernel, run: np.ndarray, bound: Bound) -> int:
    """The first sample at which the bound is not proved; all of them where it is.

    Where the kernel does not suffice the dual is asked, from the sample on that misses most: if that one fails the others need
    not be tried.
    """
    i, until = course.number(bound.signal), len(course)
    for side, limit in _sides(bound):
        over = side * run[:, i] + outer.half[:, i] - limit
        open_at = np.flatnonzero(over > 0.0)
        if not len(open_at):
            continue
        if len(open_at) <= DUALS and np.isfinite(over[open_at]).all():
            for k in open_at[np.argsort(-over[open_at])]:
                proof = dual(course, worst(course, [(bound.signal, int(k), side)]), 0, outer)
                if proof is None or not proof.bound <= limit[k]:
                    break
            else:
                continue
        until = min(until, int(open_at[0]))
    return until


def _judged(
    course: Course, outer: Kernel, run: np.ndarray, bound: Bound, tried: Tried, furthest: Tried, until: int, free: int,
    stops: Sequence[Bound], of: str,
) -> Kept:  # fmt: skip
    i, unit = course.number(bound.signal), bound.unit
    excess = _excess(tried.v, bound, i, _linear_until(course, tried.v, stops))
    row, k = np.unravel_index(int(excess.argmax()), excess.shape)
    reached, v, delta = float(excess[row, k]), tried.v[row], tried.delta[row]
    beyond = _excess(furthest.v, bound, i, np.full(len(furthest.v), len(course)))

    asked = np.isfinite(bound.low) | np.isfinite(bound.high)
    half = outer.half[:, i]
    every = (float((run[:, i] - half)[asked].min()), float((run[:, i] + half)[asked].max())) if free == len(course) else None

    def kept(status: Status, margin: float, said: str) -> Kept:
        return Kept(bound, Verdict(bound.claim, of, status, margin, unit, said, every=every), v, delta)

    moves = "parameters that move" if tried is furthest else "constant parameters"
    if reached > 0.0:
        return kept(Status.FAILED, -reached, f"{moves} within their boxes bring it to {v[k, i]:.4g} {unit} at sample {k}")
    if until == len(course) and free == len(course):
        left = max(float(np.minimum(run[:, i] - half - bound.low, bound.high - run[:, i] - half).min()), 0.0)
        said = (
            f"whatever the parameters do at {len(course)} samples; the worst run found leaves {-float(beyond.max()):.3g} {unit}"
        )
        return kept(Status.PROVED, left, said)
    said = f"proved up to sample {until} of {len(course)}" if until < len(course) else "proved for the linear law"
    if free < len(course):
        said += f", but from sample {free} on a command may be at its stop"
    elif every is not None:
        said += f"; every run stays within {every[0]:.4g} to {every[1]:.4g} {unit}"
    said += f"; {moves} leave {-reached:.3g} {unit}"
    if tried is not furthest:
        worse = float(beyond.max())
        said += f", moving ones {'leave' if worse <= 0.0 else 'miss it by'} {abs(worse):.3g} {unit}"
    return kept(Status.UNDECIDED, -reached, said)


def _linear_until(course: Course, v: np.ndarray, stops: Sequence[Bound]) -> np.ndarray:
    """The first sample (R) of runs v (R N s) at which a command is beyond its stop; after that the run is not the law's."""
    until = np.full(len(v), len(course))
    for stop in stops:
        own = v[:, :, course.number(stop.signal)]
        beyond = (own < stop.low) | (own > stop.high)
        until = np.minimum(until, np.where(beyond.any(axis=1), beyond.argmax(axis=1), len(course)))
    return until
