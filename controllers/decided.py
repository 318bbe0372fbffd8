"""A design that is made calmer until every limit is decided.

law = decided(ScheduledPIDDesign(), model, "limits.toml", records).law

What is not proved of a loop is often proved of a calmer one: its bands are narrower, and its commands stay off their stops. The
bound of |S| is lowered from what the design asks for until nothing is FAILED or UNDECIDED on the identified model.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from controllers.designs import MPCDesign, ScheduledPIDDesign
from workbench.answers.check import check, counted
from workbench.data import Dataset
from workbench.errors import InputError
from workbench.hammerstein import Model
from workbench.progress import Progress, silent
from workbench.records import record
from workbench.robustness.verdict import Status, Verdict

CALMER, ATTEMPTS = 0.8, 8  # what is left of |S| - 1 after an attempt, and how many there are at most
PATIENCE = 2  # attempts that come no nearer to a decision, after which no more are made
OPEN = (Status.FAILED, Status.UNDECIDED)


@record
class Attempt:
    """A law with |S| within `sensitivity`, and the verdicts on it; refused: why there is none, "" where there is."""

    sensitivity: float
    law: Any
    verdicts: tuple[Verdict, ...]
    refused: str = ""

    @property
    def open(self) -> tuple[str, ...]:
        """The claims that are not decided for the law, and what is missing."""
        return tuple(f"{v.claim}: {v.status.value}{_missing(v)}" for v in self.verdicts if v.status in OPEN)

    def __str__(self) -> str:
        if self.refused:
            return f"|S| within {self.sensitivity:.3g}: no law, {self.refused}"
        named = f" ({'; '.join(self.open[:2])}{'; ..' * (len(self.open) > 2)})" if self.open else ""
        return f"|S| within {self.sensitivity:.3g}: {counted(self.verdicts)}{named}"


@record
class Decided:
    """What was tried, from brisk to calm, and which of it was taken: the first that leaves nothing open, or as little as any."""

    attempts: tuple[Attempt, ...]
    taken: Attempt

    @property
    def law(self) -> Any:
        return self.taken.law

    @property
    def sentences(self) -> tuple[str, ...]:
        """Each attempt, what was taken, and limits of which one asks for a calmer law than another lets it be."""
        said = [str(attempt) for attempt in self.attempts]
        if not self.taken.open:
            return (*said, f"taken: |S| within {self.taken.sensitivity:.3g}, with which nothing is left open")
        said.append(f"taken: |S| within {self.taken.sensitivity:.3g}, with which fewest limits are left open: none decides all")
        tried = [{v.claim for v in attempt.verdicts if v.status in OPEN} for attempt in self.attempts if attempt.verdicts]
        calm, brisk = sorted(tried[0] - tried[-1]), sorted(tried[-1] - tried[0])
        if calm and brisk:
            said.append(f"in conflict: {' and '.join(calm)} asks for a calmer law, {' and '.join(brisk)} for a brisker one")
        return tuple(said)


def decided(
    design: ScheduledPIDDesign | MPCDesign, model: Model, limits: Any, records: Dataset, *, lags: int = 1,
    bound: Sequence[float] | None = None, nodes: int | None = None, progress: Progress = silent,
) -> Decided:  # fmt: skip
    """The design made calmer until `check` leaves nothing FAILED or UNDECIDED on the model, whose errors the records bound.

    limits, lags, bound, nodes: as of `check`. Raises InputError where the design has no law as it is, or asks for a price of
    moves in place of a bound.

        >>> found = decided(ScheduledPIDDesign(), model, {"loop": {"stable": True}}, data)
        >>> found.taken.sensitivity, found.taken.open
        (1.6, ())
    """
    if getattr(design, "move", None) is not None:
        raise InputError("a price of moves is given", mend="leave it out: the bound of |S| sets it")
    attempts: list[Attempt] = []
    for number in range(ATTEMPTS):
        sensitivity = 1.0 + CALMER**number * (design.sensitivity - 1.0)
        progress(f"|S| within {sensitivity:.3g}")
        try:
            calmer: Any = replace(design, sensitivity=sensitivity)
            law = calmer.on(model, accept=True)  # whatever one run of its loop said: `check` tries it too
        except InputError as reason:
            if not attempts:
                raise
            attempts.append(Attempt(sensitivity, None, (), reason.problem))
            break
        answer = check(law, limits, model=model, records=records, lags=lags, bound=bound, nodes=nodes, progress=progress)
        attempts.append(Attempt(sensitivity, law, tuple(answer.verdicts)))
        if not attempts[-1].open or not _nearer(attempts):
            break
    made = [attempt for attempt in attempts if attempt.verdicts]
    return Decided(tuple(attempts), min(made, key=_left))


def _nearer(attempts: Sequence[Attempt]) -> bool:
    """Whether any of the last attempts leaves less open than the one before them, or misses a claim by a twentieth less."""
    if len(attempts) <= PATIENCE:
        return True
    before, *after = attempts[-PATIENCE - 1 :]
    missing = {v.claim: v.margin for v in before.verdicts if v.status in OPEN}
    closer = any(
        v.status not in OPEN or v.margin > missing[v.claim] + 0.05 * abs(missing[v.claim])
        for attempt in after for v in attempt.verdicts if v.claim in missing
    )  # fmt: skip
    return closer or any(_left(attempt) < _left(before) for attempt in after)


def _left(attempt: Attempt) -> list[int]:
    """How many claims fail, and how many are undecided."""
    return [sum(v.status is status for v in attempt.verdicts) for status in OPEN]


def _missing(verdict: Verdict) -> str:
    return f" ({f'{verdict.margin:+.3g} {verdict.unit}'.strip()})" if math.isfinite(verdict.margin) else ""
