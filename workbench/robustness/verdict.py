"""Verdicts: what is claimed of a loop, whether it is proved or refuted, by how much, and what shows it.

    PROVED      a certificate holds, checked in outward-rounded arithmetic outside the solver
    PASSED      no counterexample among N runs: sampling never proves
    FAILED      a counterexample was found, and replayed
    UNDECIDED   everything else: neither a proof nor a counterexample

A margin is signed: what is left to the limit, in its unit; negative where the limit is broken. Of what is proved it is what the
certificate leaves, of what failed by how much the counterexample breaks the limit: the true value lies on its better side for the
first, on its worse side for the second.

Stability and bounds are of the linear law: they hold as long as no command is at its stop. `bounds_kept` finds out how long.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import Enum

import numpy as np

from workbench.errors import InputError
from workbench.records import field, record
from workbench.robustness.envelopes import Course, Kernel, Reached, dual, kernel, nominal, worst
from workbench.robustness.margins import Margin

DUALS = 8  # samples of one signal and side at which a tighter bound is sought
INSTANTS = 4  # samples of one signal and side at which the adversary is asked


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
    """

    claim: str
    of: str
    status: Status
    margin: float
    unit: str
    sentence: str
    witness: str = ""

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


def stability(found: Margin, needed: float, claim: str, of: str) -> Verdict:
    """Whether the boxes may be `needed` times as wide, with parameters that move as they like at every sample."""
    low, high = found.certified.kappa, found.falsified.kappa
    if low >= needed and found.certified.holds(found.loop):
        return Verdict(
            claim, of, Status.PROVED, low - needed, "boxes",
            f"a quadratic function of the state falls at every sample, whatever the parameters do, up to boxes {low:.3g} times "
            f"as wide; from {high:.3g} on a sequence is known that the loop does not survive",
        )  # fmt: skip
    if high < needed and found.falsified.replay(found.loop) >= 1.0:
        return Verdict(
            claim, of, Status.FAILED, high - needed, "boxes",
            f"in boxes {high:.3g} times as wide {len(found.falsified.delta)} sets of parameters in turn let a state grow for ever",
        )  # fmt: skip
    return Verdict(
        claim, of, Status.UNDECIDED, low - needed, "boxes",
        f"proved up to boxes {low:.3g} times as wide, refuted from {high:.3g} times on",
    )  # fmt: skip


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
class Kept:
    """The verdict on a bound, and the run that comes nearest to breaking it: number `question` of `reached`."""

    bound: Bound
    verdict: Verdict
    reached: Reached
    question: int


def bounds_kept(
    course: Course,
    bounds: Sequence[Bound],
    stops: Sequence[Bound] = (),
    *,
    of: str,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Kept]:
    """A verdict on every bound over all parameters that move as they like.

    stops: of the commands, within which the law is linear. From where it is not proved that they are kept nothing else is.
    """
    outer, run = kernel(course), nominal(course).v
    free = len(course)
    for stop in stops:
        progress(stop.claim)
        free = min(free, _proved_until(course, outer, run, stop, _asked(course, run, stop, seed)))
    found = []
    for bound in bounds:
        progress(bound.claim)
        asked = _asked(course, run, bound, seed)
        until = _proved_until(course, outer, run, bound, asked)
        found.append(_judged(course, outer, run, bound, asked, until, free, stops, of))
    return found


def _sides(bound: Bound) -> list[tuple[int, np.ndarray]]:
    """(side, limit): side v <= limit, for the sides at which anything is asked."""
    both = ((1, bound.high), (-1, -bound.low))
    return [(side, limit) for side, limit in both if np.isfinite(limit).any()]


def _asked(course: Course, run: np.ndarray, bound: Bound, seed: int) -> Reached:
    """The adversary, where the nominal run comes nearest to the bound and at samples spread over the run."""
    i, questions = course.number(bound.signal), []
    for side, limit in _sides(bound):
        counted = np.flatnonzero(np.isfinite(limit))
        nearest = counted[(side * run[counted, i] - limit[counted]).argmax()]
        spread = counted[np.linspace(0, len(counted) - 1, INSTANTS + 1).round().astype(int)[1:]]
        questions += [(bound.signal, int(k), side) for k in np.unique(np.append(spread, nearest))]
    return worst(course, questions, seed=seed)


def _proved_until(course: Course, outer: Kernel, run: np.ndarray, bound: Bound, asked: Reached) -> int:
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
        first = int(open_at[0])
        if len(open_at) <= DUALS and np.isfinite(over[open_at]).all():
            for k in open_at[np.argsort(-over[open_at])]:
                own = worst(course, [(bound.signal, int(k), side)])
                proof = dual(course, own, 0, outer)
                if proof is None or not proof.bound <= limit[k]:
                    break
            else:
                continue
        until = min(until, first)
    return until


def _judged(
    course: Course, outer: Kernel, run: np.ndarray, bound: Bound, asked: Reached, until: int, free: int,
    stops: Sequence[Bound], of: str,
) -> Kept:  # fmt: skip
    i = course.number(bound.signal)
    v = asked.v[:, :, i]  # (questions, N): what the worst sequences do at every sample
    excess = np.maximum(bound.low - v, v - bound.high)
    linear = _linear_until(course, asked, stops)
    excess[np.arange(len(course))[None, :] >= linear[:, None]] = -np.inf
    question, k = np.unravel_index(int(np.nanargmax(excess)), excess.shape)
    reached = float(excess[question, k])
    if reached > 0.0:
        said = f"parameters within their boxes bring it to {v[question, k]:.4g} {bound.unit} at sample {k}"
        return Kept(bound, Verdict(bound.claim, of, Status.FAILED, -reached, bound.unit, said), asked, int(question))
    if until == len(course) and free == len(course):
        left = np.minimum(run[:, i] - outer.half[:, i] - bound.low, bound.high - run[:, i] - outer.half[:, i])
        margin = max(float(left.min()), 0.0)
        said = f"whatever the parameters do at {len(course)} samples; the worst run found leaves {-reached:.3g} {bound.unit}"
        return Kept(bound, Verdict(bound.claim, of, Status.PROVED, margin, bound.unit, said), asked, int(question))
    why = f"proved up to sample {until} of {len(course)}" if until < len(course) else "proved for the linear law"
    if free < len(course):
        why += f", but from sample {free} on a command may be at its stop"
    said = f"{why}; the worst run found leaves {-reached:.3g} {bound.unit}"
    return Kept(bound, Verdict(bound.claim, of, Status.UNDECIDED, -reached, bound.unit, said), asked, int(question))


def _linear_until(course: Course, asked: Reached, stops: Sequence[Bound]) -> np.ndarray:
    """The first sample (questions) of each run at which a command is beyond its stop; after that the run is not the law's."""
    until = np.full(len(asked.v), len(course))
    for stop in stops:
        v = asked.v[:, :, course.number(stop.signal)]
        beyond = (v < stop.low) | (v > stop.high)
        until = np.minimum(until, np.where(beyond.any(axis=1), beyond.argmax(axis=1), len(course)))
    return until
