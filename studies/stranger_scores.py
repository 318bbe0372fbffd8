"""How right a diagnosis of strangers' machines was, from the rows of the study strangers alone.

A row says what was hidden (truth), what the command said (verdict, causes with ties), or how it ended without an answer: refused,
with its message, or crashed, with its traceback. A name counts as right only if nothing wrong is named beside it, a tie only if
it declares three effects at most. errors: root mean square on held-out records of the plant as it was given and as it was handed
out, by horizon.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from typing import Any

import numpy as np

from studies.hidden_scores import Share, found, inside, misled, share, strangers
from workbench.records import record

Row = Mapping[str, Any]

HORIZONS = ("one-step", "one-second", "full-run")
NOISE = 0.02  # share by which an error may grow that nobody calls worse
UNSTABLE = "free runs are compared up to"  # in an answer's note: of an unstable machine


class Outcome(Enum):
    """What was said about a case."""

    RIGHT = "right"
    TIE = "tie"
    UNKNOWN = "unknown"
    INCOMPLETE = "incomplete"
    HALF = "one of two"
    MISSED = "missed"
    WRONG = "wrong"
    REFUSED = "refused"
    CRASHED = "crashed"


@record
class Summary:
    """All rates of a set of rows."""

    cases: int
    outcomes: Mapping[str, int]
    crashed: Share
    refused: Share
    wrong: Share  # of all answers: a name that was not hidden, said to be sure
    unsure: Share  # of all answers: a name that was not hidden, said not to be sure or a tie of more than three
    false_alarms: Share  # of answers where nothing is hidden: a cause is named
    right_or_tie: Share  # of single effects
    both: Share  # of pairs: both found, alone or in ties, and nothing wrong beside them
    outside: Share  # of cases outside the catalogue: "unknown" or "incomplete"
    inside: Share  # of stated intervals of right causes: the true number lies inside
    worse: Share  # of answers that hand out a changed plant: worse a second ahead or over the full run, and not said
    seconds: tuple[float, float, float]  # CPU time of a diagnosis: median, nine tenths, longest


def outcome(row: Row) -> Outcome:
    """What was said about what a row hides."""
    for fault in (Outcome.CRASHED, Outcome.REFUSED):
        if fault.value in row:
            return fault
    verdict, hidden = row["verdict"], [t for t in row["truth"] if t["catalogued"]]
    if misled(row):
        return Outcome.WRONG
    if verdict == "incomplete":
        return Outcome.INCOMPLETE
    if row["kind"] == "nothing" and verdict == "named":  # the quantum of the logger, which is there
        return Outcome.RIGHT
    if row["kind"] in ("nothing", "outside"):
        expected = "nothing" if row["kind"] == "nothing" else "unknown"
        return Outcome.RIGHT if verdict == expected else Outcome.UNKNOWN if verdict == "unknown" else Outcome.MISSED
    if verdict == "unknown":
        return Outcome.UNKNOWN
    if not (seen := found(row)):
        return Outcome.MISSED
    if seen < len(hidden):
        return Outcome.HALF
    return Outcome.RIGHT if {t["key"] for t in hidden} <= {c["key"] for c in row["causes"]} else Outcome.TIE


def ratios(row: Row) -> dict[str, float]:
    """Held-out errors after over before, by horizon: geometric mean over records and channels."""
    result = {}
    for horizon in HORIZONS:
        pairs = [p for p in row.get("errors", {}).get(horizon, {}).values() if p[0] and p[1] is not None and p[0] > 0.0]
        if pairs:
            result[horizon] = float(np.exp(np.mean([np.log(max(after, 1e-300) / before) for before, after in pairs])))
    return result


def worse(row: Row) -> list[str]:
    """The horizons at which what is handed out is worse than what was given, one second ahead or over the full run.

    Of an unstable machine, where the answer says that its full runs leave the records and are not compared: a second ahead.
    """
    found, compared = ratios(row), HORIZONS[1:2] if any(UNSTABLE in note for note in row.get("notes", ())) else HORIZONS[1:]
    return [h for h in compared if found.get(h, 0.0) > 1.0 + NOISE]


def summary(rows: Iterable[Row]) -> Summary:
    """Every rate of these rows; a case that could not be drawn is none."""
    rows = [row for row in rows if "undrawn" not in row]
    answered = [row for row in rows if "verdict" in row]
    by = {kind: [row for row in rows if row["kind"] == kind] for kind in ("nothing", "single", "pair", "outside")}
    said, held = Counter(outcome(row).value for row in rows), (Outcome.RIGHT, Outcome.TIE)
    times = [row["seconds"] for row in answered] or [float("nan")]
    return Summary(
        cases=len(rows),
        outcomes={o.value: said[o.value] for o in Outcome},
        crashed=share("crashed" in row for row in rows),
        refused=share("refused" in row for row in rows),
        wrong=share(bool(misled(row)) for row in answered),
        unsure=share(len(strangers(row)) > len(misled(row)) for row in answered),
        false_alarms=share(bool(strangers(row)) for row in by["nothing"] if "verdict" in row),
        right_or_tie=share(outcome(row) in held for row in by["single"]),
        both=share(outcome(row) in held for row in by["pair"]),
        outside=share(row.get("verdict") in ("unknown", "incomplete") for row in by["outside"]),
        inside=share(inside(answered)),
        worse=share(bool(worse(row)) and not row["says_worse"] for row in answered if row.get("errors")),
        seconds=(float(np.median(times)), float(np.quantile(times, 0.9)), float(max(times))),
    )


def by_machine(rows: Sequence[Row]) -> dict[str, Summary]:
    """The summary of all rows, and that of every machine."""
    machines = sorted({row["machine"] for row in rows})
    return {"all": summary(rows)} | {name: summary([row for row in rows if row["machine"] == name]) for name in machines}
