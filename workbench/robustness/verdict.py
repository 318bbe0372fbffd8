"""Verdicts: what is claimed of a loop, whether it is proved or refuted, by how much, and what shows it.

    PROVED      a certificate holds, checked in outward-rounded arithmetic outside the solver; or the kernel's bound does, which
                needs no solver and has its own rounding in it
    PASSED      no counterexample among N runs: sampling never proves
    FAILED      a counterexample was found, and replayed
    UNDECIDED   everything else: neither a proof nor a counterexample

A margin is signed: what is left to the limit, in its unit; negative where the limit is broken. Of what is proved it is what the
certificate leaves, of what failed by how much the counterexample breaks the limit: the true value lies on its better side for the
first, on its worse side for the second.

Stability and bounds are of the linear law: they hold as long as no command is at its stop. `bounds_kept` finds out how long.

A run begins at the rest of any machine of the boxes, which is not that of the middle: other gains, other integrals.

What is proved holds for parameters that are others at every sample, and so for those that stand still; unless they are said to
move, a bound along a run may also be proved for constant ones alone, and says so. What refutes is another matter: unless
parameters are said to move, only a run with constant ones does that no record refutes; where they are, it refutes too, and so
does every sequence within the boxes.

The margin of what is undecided is what is missing to the proof.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import Enum
from typing import NamedTuple

import numpy as np

from workbench.errors import InputError
from workbench.records import field, record
from workbench.robustness.envelopes.adversary import worst
from workbench.robustness.envelopes.certificate import Certificate
from workbench.robustness.envelopes.constant import constant_kernel
from workbench.robustness.envelopes.course import Course, explained, replay
from workbench.robustness.envelopes.dual import dual
from workbench.robustness.envelopes.kernel import Kernel, at_rest, kernel
from workbench.robustness.linear_law import Affine
from workbench.robustness.loop import PLANNED
from workbench.robustness.margins import Falsified, Margin
from workbench.robustness.proof import Shown, falls, grows, leaves, limits, stays

DUALS = 8  # samples of one signal and side at which a tighter bound is sought
INSTANTS = 4  # samples of one signal and side at which the adversary is asked
SLACK = 1e-9  # of the signal or its limit, by which a run must break a bound: more than rounding
GROWS = 1.0 + 1e-9  # of a pole that is lost: more than rounding


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
    every: what is proved that every run stays between, where that is known. shown: what someone else checks it by, see `proof`.
    """

    claim: str
    of: str
    status: Status
    margin: float
    unit: str
    sentence: str
    witness: str = ""
    every: tuple[float, float] | None = None
    shown: Shown | None = None

    def __str__(self) -> str:
        amount = "" if math.isnan(self.margin) else f" ({self.margin:+.3g}{self.unit and ' ' + self.unit})"
        return f"{self.status.value:9} {self.claim}{amount}: {self.sentence}"

    def to_dict(self) -> dict[str, object]:
        """Plain values; a margin that is no number is null."""
        margin = self.margin if math.isfinite(self.margin) else None
        said = {name: value for name, value in vars(self).items() if name != "shown"}
        return {**said, "status": self.status.value, "margin": margin}

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


def stability(
    found: Margin, needed: float, claim: str, of: str, *, possible: np.ndarray | None = None, moving: bool = False
) -> Verdict:
    """Whether the boxes may be `needed` times as wide.

    possible (R p): constant parameters of the boxes that may be the machine's, and refute it. moving, or possible None: sequences
    within boxes that wide refute it too.
    """
    low, high, lost = found.certified.kappa, found.falsified.kappa, refuting(found, needed, possible, moving)
    if low >= needed and found.certified.holds(found.loop):
        return Verdict(
            claim, of, Status.PROVED, low - needed, "boxes",
            f"off the stops a quadratic function of the state falls at every sample, whatever the parameters do, "
            f"up to boxes {low:.3g} times as wide; from {high:.3g} on a sequence is known that the loop does not survive",
            shown=falls(found.loop, found.certified, needed),
        )  # fmt: skip
    if lost is not None and lost.replay(found.loop) >= 1.0:
        shown = grows(found.loop, lost, needed)
        if lost is found.falsified:
            said = f"in boxes {lost.kappa:.3g} times as wide {len(lost.delta)} sets of parameters in turn let a state grow"
            return Verdict(claim, of, Status.FAILED, lost.kappa - needed, "boxes", said, shown=shown)
        said = f"constant parameters that no record refutes let a state grow, by {lost.growth:.4g} at every sample"
        return Verdict(claim, of, Status.FAILED, 1.0 - lost.growth, "", said, shown=shown)
    said = f"proved up to boxes {low:.3g} times as wide, moving parameters refute it from {high:.3g} times on"
    said += "" if possible is None else f"; none of {len(possible)} constant ones that may be the machine's does"
    return Verdict(claim, of, Status.UNDECIDED, low - needed, "boxes", said)


def refuting(found: Margin, needed: float, possible: np.ndarray | None, moving: bool = False) -> Falsified | None:
    """What refutes, as in `stability`: a sequence in boxes less than `needed` times as wide, or the worst constant parameters."""
    if (moving or possible is None) and found.falsified.kappa < needed:
        return found.falsified
    if possible is None or not len(possible):
        return None
    radii = np.abs(np.linalg.eigvals(found.loop.at(possible))).max(axis=1)
    worst = possible[int(radii.argmax())][None]
    lost = Falsified(1.0, worst, 1.0).replay(found.loop)
    return Falsified(1.0, worst, lost) if lost >= GROWS else None


# ---- bounds along a run --------------------------------------------------------------------------------------------


@record
class Bound:
    """low <= signal <= high at every sample (N), infinite where nothing is asked; claim, unit: how it is told."""

    claim: str
    signal: str
    unit: str
    low: np.ndarray = field("N", low=-np.inf)
    high: np.ndarray = field("N", high=np.inf)

    @property
    def limits(self) -> Shown:
        return limits(self.signal, self.low, self.high)


@record
class Region:
    """low <= signals <= high at every sample (k): within it the law is linear."""

    signals: tuple[str, ...]
    low: np.ndarray = field("k", low=-np.inf)
    high: np.ndarray = field("k", high=np.inf)

    @classmethod
    def of(cls, form: Affine) -> "Region":
        """Where a law is this affine form of it, by the signals that `driven` calls so."""
        return cls(tuple(f"{PLANNED} {i}" for i in range(len(form.w))), form.low, form.high)


EVERYWHERE = Region((), np.empty(0), np.empty(0))


@record
class Tried:
    """Runs v (R N s) under parameters delta (R N p), from the states start (R n).

    These are the rests with parameters before (R p) at the shares (R g) of what is open of the set-points before the run.
    """

    v: np.ndarray = field("R N s")
    delta: np.ndarray = field("R N p")
    before: np.ndarray = field("R p")
    share: np.ndarray = field("R g")
    start: np.ndarray = field("R n")

    def row(self, i: int) -> "Tried":
        """One of the runs."""
        return Tried(*(value[i : i + 1] for value in vars(self).values()))

    def beside(self, other: "Tried") -> "Tried":
        """These runs, and the others."""
        return Tried(*(np.concatenate(pair) for pair in zip(vars(self).values(), vars(other).values(), strict=True)))


@record
class Kept:
    """The verdict on a bound, and the run that comes nearest to breaking it, at `sample`.

    outer: what holds every run, or, if `constant`, every run with constant parameters.
    """

    bound: Bound
    verdict: Verdict
    run: Tried
    sample: int
    outer: Kernel
    constant: bool


def bounds_kept(
    course: Course,
    bounds: Sequence[Bound],
    stops: Sequence[Bound] = (),
    *,
    region: Region = EVERYWHERE,
    of: str,
    dt: float,
    possible: np.ndarray | None = None,
    moving: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Kept]:
    """A verdict on every bound over all parameters within their boxes and all starts of the course, samples dt [s] apart.

    stops: of the commands, within which the law is linear; region: of what a law plans. From where it is not proved that they are
    kept nothing else is.
    possible (R p): constant parameters of the boxes that may be the machine's, and refute, each from its own rest. moving, or
    possible None: sequences within the boxes refute too, and nothing is proved for constant parameters alone. Raises InputError
    for a bound that asks nothing.
    """
    for bound in bounds:
        if not (np.isfinite(bound.low) | np.isfinite(bound.high)).any():
            raise InputError("asks nothing within the run", file=bound.claim, mend="a longer run, or an earlier begin")
    outer, of_constant, found = kernel(course), None, []
    linear = _Linear(tuple(stops), region)
    of_any = _proved(course, outer, linear, of, dt, False, progress)
    still = None if possible is None else _constant_runs(course, possible)
    for bound in bounds:
        progress(bound.claim)
        furthest = tried = _moving_runs(course, outer.nominal.v, bound)
        if still is not None:
            tried = _with_noise(course, still, bound, linear)
            furthest = furthest.beside(tried)
        tried = furthest if moving else tried
        kept = _judged(of_any, bound, tried, furthest)
        if kept.verdict.status is Status.UNDECIDED and tried is not furthest:
            of_constant = of_constant or _proved(course, constant_kernel(course, outer), linear, of, dt, True, progress)
            kept = _judged(of_constant, bound, tried, furthest)
        found.append(kept)
    return found


def _sides(bound: Bound) -> list[tuple[int, np.ndarray]]:
    """(side, limit): side v <= limit, for the sides at which anything is asked."""
    both = ((1, bound.high), (-1, -bound.low))
    return [(side, limit) for side, limit in both if np.isfinite(limit).any()]


def _moving_runs(course: Course, run: np.ndarray, bound: Bound) -> Tried:
    """The adversary, where the run in the middle comes nearest to the bound and at samples spread over it."""
    i, questions = course.number(bound.signal), []
    for side, limit in _sides(bound):
        counted = np.flatnonzero(np.isfinite(limit))
        nearest = counted[(side * run[counted, i] - limit[counted]).argmax()]
        spread = counted[np.linspace(0, len(counted) - 1, INSTANTS + 1).round().astype(int)[1:]]
        questions += [(bound.signal, int(k), side) for k in np.unique(np.append(spread, nearest))]
    found = worst(course, questions)
    return Tried(found.v, found.delta, found.before, found.share, found.start)


def _noisy(course: Course) -> bool:
    """Whether errors act that no parameter explains."""
    return bool((course.lam[:, ~explained(course)] > 0.0).any())


def _constant_runs(course: Course, possible: np.ndarray) -> Tried:
    """Runs with constant parameters (R p), each from its own rests, without errors that no parameter explains.

    Those that do not come to rest begin at that of the middle.
    """
    own = np.where(explained(course) & (course.lam.max(axis=0) > 0.0), possible, 0.0)
    open_ = course.before.Q.shape[1] if course.before else 0
    share = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=open_)))
    own, share = np.repeat(own, len(share), axis=0), np.tile(share, (len(own), 1))
    every = np.broadcast_to(own[:, None, :], (len(own), len(course), own.shape[1]))
    begins, start = course.rests(own)[:, None], course.begun(own, share)
    return Tried(replay(course, every, start), every, np.where(begins, own, 0.0), np.where(begins, share, 0.0), start)


def _with_noise(course: Course, constant: Tried, bound: Bound, linear: "_Linear") -> Tried:
    """The constant run that comes nearest to a bound, and the worst errors on top of it."""
    i = course.number(bound.signal)
    excess = _excess(constant.v, bound, i, linear.until(course, constant))
    best = constant.row(int(excess.max(axis=1).argmax()))
    if not _noisy(course):
        return best
    fixed = course.at(best.delta[0, 0])
    errors = _moving_runs(fixed, best.v[0], bound)
    delta, before = best.delta + np.where(explained(course), 0.0, errors.delta), best.before + errors.before
    share = errors.share if fixed.before else np.repeat(best.share, len(delta), axis=0)
    start = course.begun(before, share)
    return Tried(replay(course, delta, start), delta, before, share, start)


def _excess(v: np.ndarray, bound: Bound, signal: int, linear: np.ndarray) -> np.ndarray:
    """By how much runs v (R N s) break a bound, (R N); -inf from where a command is at its stop."""
    excess = np.maximum(bound.low - v[:, :, signal], v[:, :, signal] - bound.high)
    return np.where(np.arange(v.shape[1]) >= linear[:, None], -np.inf, np.nan_to_num(excess, nan=-np.inf, neginf=-np.inf))


def _proved_until(course: Course, outer: Kernel, bound: Bound) -> tuple[int, list[Certificate]]:
    """The first sample at which the bound is not proved, all of them where it is; and what proves it beside the kernel.

    Where the kernel does not suffice the dual is asked, from the sample on that misses most: if that one fails the others need
    not be tried.
    """
    i, until, proofs = course.number(bound.signal), len(course), []
    for side, limit in _sides(bound):
        over = (outer.high[:, i] if side == 1 else -outer.low[:, i]) - limit
        open_at = np.flatnonzero(over > 0.0)
        if not len(open_at):
            continue
        if len(open_at) <= DUALS and np.isfinite(over[open_at]).all():
            for k in open_at[np.argsort(-over[open_at])]:
                proof = dual(course, worst(course, [(bound.signal, int(k), side)]), 0, outer)
                if proof is None or not proof.bound <= limit[k]:
                    break
                proofs.append(proof)
            else:
                continue
        until = min(until, int(open_at[0]))
    return until, proofs


class _Linear(NamedTuple):
    """What ends the linear law: stops of commands, and the region of what it plans."""

    stops: tuple[Bound, ...]
    region: Region

    @property
    def limits(self) -> Shown:
        """What must hold at every sample and at the rest before the run."""
        own = zip(self.region.signals, self.region.low, self.region.high, strict=True)
        return {"linear": [*(stop.limits for stop in self.stops), *(limits(*each) for each in own)]}

    def ends(self, course: Course, low: np.ndarray, high: np.ndarray) -> bool:
        """Whether signals between these values (s) at the rest before the run may be beyond what the law is linear in."""
        own = [course.number(name) for name in self.region.signals]
        at = [course.number(stop.signal) for stop in self.stops]
        lows = np.append(self.region.low, [stop.low[0] for stop in self.stops])
        highs = np.append(self.region.high, [stop.high[0] for stop in self.stops])
        return bool(np.any(low[own + at] < lows) or np.any(high[own + at] > highs))

    def until(self, course: Course, tried: Tried) -> np.ndarray:
        """The first sample (R) of runs that is not the linear law's; after that the run is not either."""
        v = tried.v
        own = v[:, :, [course.number(name) for name in self.region.signals]]
        beyond = np.asarray((own < self.region.low) | (own > self.region.high)).any(axis=2)
        for stop in self.stops:
            command = v[:, :, course.number(stop.signal)]
            beyond = beyond | (command < stop.low) | (command > stop.high)
        if course.before is not None:
            rest = course.rested(course.before, tried.before, tried.share)
            beyond = beyond | np.array([self.ends(course, one, one) for one in rest])[:, None]
        return np.array([_first(row) for row in np.asarray(beyond)], dtype=int)


def _first(at: np.ndarray) -> int:
    """The first sample of (N,) at which something is; N where it never is."""
    return int(at.argmax()) if at.any() else len(at)


@record
class _Proved:
    """What the verdicts of one course share: the kernel around all runs, if `constant` around those whose parameters stand still,
    and the samples before any command may be at its stop, by the kernel and `duals`.
    """

    course: Course
    outer: Kernel
    free: int
    duals: tuple[Certificate, ...]
    linear: _Linear
    of: str
    dt: float
    constant: bool


def _proved(
    course: Course, outer: Kernel, linear: _Linear, of: str, dt: float, constant: bool, progress: Callable[[str], None]
) -> _Proved:
    own = [course.number(name) for name in linear.region.signals]
    within = (outer.low[:, own] >= linear.region.low) & (outer.high[:, own] <= linear.region.high)
    free, before = _first(np.asarray(~np.all(within, axis=1))), course.before
    if before is not None and outer.start is not None and linear.ends(course, *at_rest(course, before, outer.start)):
        free = 0
    duals: list[Certificate] = []
    for stop in linear.stops:
        progress(stop.claim)
        until, own = _proved_until(course, outer, stop)
        free, duals = min(free, until), duals + own
    return _Proved(course, outer, free, tuple(duals), linear, of, dt, constant)


def _judged(proved: _Proved, bound: Bound, tried: Tried, furthest: Tried) -> Kept:
    """The verdict on a bound, of runs that were tried and of the furthest ones."""
    course, outer, free, dt = proved.course, proved.outer, proved.free, proved.dt
    until, duals = _proved_until(course, outer, bound)
    i, unit = course.number(bound.signal), bound.unit
    excess = _excess(tried.v, bound, i, proved.linear.until(course, tried))
    row, k = (int(number) for number in np.unravel_index(int(excess.argmax()), excess.shape))
    reached = float(excess[row, k])
    beyond = float(_excess(furthest.v, bound, i, np.full(len(furthest.v), len(course))).max())
    asked, below, above = np.isfinite(bound.low) | np.isfinite(bound.high), outer.low[:, i], outer.high[:, i]
    floor, roof = np.isfinite(bound.low), np.isfinite(bound.high)
    left = float(np.concatenate([below[floor] - bound.low[floor], bound.high[roof] - above[roof]]).min())
    if until == len(course):  # at single samples by a dual, which is tighter
        below, above = np.maximum(below, bound.low), np.minimum(above, bound.high)
    every = (float(below[asked].min()), float(above[asked].max())) if free == len(course) else None

    def kept(status: Status, margin: float, said: str, shown: Shown | None = None) -> Kept:
        found = Verdict(bound.claim, proved.of, status, margin, unit, said, every=every, shown=shown)
        return Kept(bound, found, tried.row(row), k, outer, proved.constant)

    moving, noisy = tried is furthest, _noisy(course)
    limits = np.concatenate([bound.low[np.isfinite(bound.low)], bound.high[np.isfinite(bound.high)]])
    if reached > SLACK * float(max(np.abs(outer.nominal.v[:, i]).max(), np.abs(limits).max())):
        who = "parameters that move within their boxes" if moving else "constant parameters that no record refutes"
        who += " and noise in the worst order" * noisy
        run = tried.row(row)
        linear = proved.linear.limits
        shown = leaves(course, bound.limits, linear, not moving, k, run.delta[0], run.before[0], run.share[0])
        return kept(Status.FAILED, -reached, f"{who} bring it to {tried.v[row, k, i]:.4g} {unit} after {k * dt:.4g} s", shown)
    if until == len(course) and free == len(course):
        begun = "from the rest of any machine of the boxes" if course.before else "from its start"
        begun += ", and whatever the noise does" if noisy else ", without noise"
        said = (
            f"whatever the parameters do at {len(course)} samples, {begun}; the worst sequences found leave {-beyond:.3g} {unit}"
        )
        if proved.constant:
            said = f"whatever constant parameters of the boxes at {len(course)} samples, {begun}; {_tried(reached, beyond, unit)}"
        shown = stays(course, bound.limits, proved.linear.limits, proved.constant, (*proved.duals, *duals))
        return kept(Status.PROVED, max(left, 0.0), said, shown)
    if outer.start is None:
        said = "no set is known that holds the rests of all machines of the boxes: a run may begin anywhere"
        return kept(Status.UNDECIDED, math.nan, said)
    said = (
        f"proved for the first {until * dt:.4g} s of {len(course) * dt:.4g} s" if until < len(course) else "proved while linear"
    )
    if free < len(course):
        said += f", but {f'after {free * dt:.4g} s' if free else 'already at the rest before it'} a command may be at its stop"
    elif every is not None:
        said += f"; every run stays within {every[0]:.4g} to {every[1]:.4g} {unit}"
    said += f"; {_tried(reached, beyond, unit)}" if not moving else f"; moving parameters {_beside(beyond, unit)}"
    return kept(Status.UNDECIDED, left if free == len(course) else math.nan, said)


def _tried(reached: float, beyond: float, unit: str) -> str:
    """How near to a bound constant parameters bring a run, and any."""
    constant = (
        f"constant ones that were tried leave {-reached:.3g} {unit}" if np.isfinite(reached) else "nothing was tried before"
    )
    return f"{constant}, moving ones {_beside(beyond, unit)}"


def _beside(beyond: float, unit: str) -> str:
    return f"{'leave' if beyond <= 0.0 else 'go beyond it by'} {abs(beyond):.3g} {unit}"
