"""How right a diagnosis was, from the rows of the study hidden-effects alone: rates with their 95 % intervals.

A row says what was hidden (truth) and what was said (verdict, causes with ties). A name counts as right only if nothing wrong is
named beside it, and a tie only if it declares three effects at most. Failed cases are not left out: they are misses. Where a tie
holds what was hidden, a row also says which experiment was recommended and what was said after it (experiment).
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import Enum
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import binomtest

from workbench.diagnosis.answer import ROUNDED
from workbench.records import field, record

Row = Mapping[str, Any]

TESTABLE = 2.0  # multiples of the detection limit from which an effect must be found
FAR_OUTSIDE = 5.0  # the same for physics outside the catalogue
WIDEST_TIE = 3
SIZES = (0.5, 1.0, 2.0, 4.0, 8.0, 20.0)  # bins of the multiple
WEIGHTS = (0.0, 0.2, 0.5, 0.8, 0.99, 1.0)  # bins of the stated posterior
SAME_STEP = 1e-3


class Outcome(Enum):
    """What was said about a single hidden effect."""

    RIGHT = "right name"
    TIE = "declared tie that holds it"
    BESIDE = "right, and a wrong name beside it"
    WRONG = "confident wrong name"
    FLAGGED = "wrong name, said to be uncertain, or a wide tie"
    UNKNOWN = "something missing, no name"
    MISSED = "nothing said"


class Resolution(Enum):
    """What became of a tie that held what was hidden."""

    RESOLVED = "the true name alone"
    TIED = "still tied"
    LOST = "a wrong name, or none"
    FAILED = "the experiment could not be run"
    UNDECIDABLE = "no experiment can"


@record
class Share:
    """hits of `of` trials, with the exact binomial 95 % interval (Clopper and Pearson)."""

    hits: int
    of: int

    @property
    def rate(self) -> float:
        return self.hits / self.of if self.of else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """(0, 1) where there was no trial."""
        if not self.of:
            return 0.0, 1.0
        found = binomtest(self.hits, self.of).proportion_ci(0.95, method="exact")
        return float(found.low), float(found.high)

    def __str__(self) -> str:
        if not self.of:
            return "no case"
        low, high = self.interval
        return f"{self.hits} of {self.of} ({100 * self.rate:.1f} %, 95 % interval {100 * low:.1f} to {100 * high:.1f} %)"

    def to_dict(self) -> dict[str, Any]:
        low, high = self.interval
        return {"hits": self.hits, "of": self.of, "low": low, "high": high}


def share(hits: Iterable[bool]) -> Share:
    """The share of true values."""
    found = list(hits)
    return Share(sum(map(bool, found)), len(found))


@record
class Bin:
    """A share of the cases between two bounds; mean: of what is binned."""

    low: float
    high: float
    mean: float
    share: Share


@record
class Confusion:
    """How often `named` was named where `hidden` was hidden and not named. tied: how often the tie held what was hidden."""

    hidden: str
    named: str
    count: int
    tied: int
    machine: str


@record
class Seconds:
    """CPU time of a kind of case [s]."""

    kind: str
    cases: int
    median: float
    p90: float
    longest: float


@record
class Summary:
    """All rates of a set of rows; see the fields' comments for what each is a share of."""

    cases: int
    errors: int
    right: Share  # of single effects that are testable
    right_or_tie: Share
    wrong: Share  # confident wrong name
    missed: Share  # nothing said
    right_or_tie_by_multiple: Share  # of all single effects at TESTABLE or more, whatever limits their own records state
    wrong_at_any_size: Share  # of all single effects
    false_alarms: Share  # of cases with nothing hidden: a cause is named
    unknown_of_nothing: Share  # the same: something is missing, no name
    both: Share  # of pairs of which both are testable
    one: Share
    both_by_multiple: Share  # of pairs of which both are at TESTABLE or more, whatever limits their own records state
    wrong_in_pairs: Share  # a cause that is said to be sure is neither of the two
    outside: Share  # of cases outside the catalogue at FAR_OUTSIDE or more: "unknown" or "incomplete"
    inside: Share  # of stated intervals of right causes: the true number lies inside
    gained: Share  # of named causes: the one-step error on held-out records is lower with it
    resolved: Share  # of recommended experiments for ties that hold what was hidden: afterwards the true name stands alone
    undecidable: Share  # of such ties: no experiment is recommended, for none of the plan would decide
    ties: Mapping[str, int]  # the same by what became of them
    outcomes: Mapping[str, int]  # of testable single effects
    detection: tuple[Bin, ...]  # single effects by multiple: right or tie
    noticed: tuple[Bin, ...]  # the same: anything said
    calibration: tuple[Bin, ...]  # every name and rival by its stated posterior: it was hidden
    confusions: tuple[Confusion, ...]
    seconds: tuple[Seconds, ...] = field(default=())


# ---- one row ----------------------------------------------------------------------------------------------------------------


def hidden_in(row: Row) -> list[str]:
    """The keys of what was hidden."""
    return [t["key"] for t in row["truth"]]


def names(cause: Mapping[str, Any], hidden: Iterable[str] = ()) -> set[str]:
    """The cause and its declared rivals, where there are at most three in all; of a wider tie the cause alone.

    Of two effects that are a rival together, "a + b", each counts if both are `hidden`.
    """
    both = {cause["key"], *cause["ties"]}
    both = both if len(both) <= WIDEST_TIE else {cause["key"]}
    return both.union(*_together(both, hidden))


def _together(names: Iterable[str], hidden: Iterable[str]) -> list[set[str]]:
    """The effects of every "a + b" among names of which all are hidden."""
    pairs = [set(name.split(" + ")) for name in names if " + " in name]
    return [pair for pair in pairs if pair <= set(hidden)]


def found(row: Row) -> int:
    """How many of the hidden effects are named or in a tie, each by a cause of its own or by a pair that a cause ties with."""
    keys, causes = hidden_in(row), beyond_rounding(row)
    said = [names(c, keys) for c in causes]
    return _matched(keys, said + [pair for c in causes for pair in _together(names(c), keys)[:1]])


def _matched(keys: Sequence[str], said: Sequence[set[str]]) -> int:
    """The largest number of keys that causes of their own can stand for."""
    if not keys:
        return 0
    skipped = _matched(keys[1:], said)
    taken = [1 + _matched(keys[1:], [*said[:i], *said[i + 1 :]]) for i, own in enumerate(said) if keys[0] in own]
    return max([skipped, *taken])


def strangers(row: Row) -> list[str]:
    """Causes that stand for nothing that was hidden."""
    keys = set(hidden_in(row))
    return [c["key"] for c in beyond_rounding(row) if not keys & names(c, keys)]


def misled(row: Row) -> list[str]:
    """Causes that are said to be sure, though neither they nor any effect that is declared a tie with them was hidden."""
    keys = set(hidden_in(row))
    sure = [c for c in beyond_rounding(row) if c["sure"]]
    said = {c["key"]: {c["key"], *c["ties"]} for c in sure}
    return [key for key, own in said.items() if not keys & own.union(*_together(own, keys))]


def disordered(rows: Iterable[Row]) -> list[str]:
    """Sizes whose interval does not hold them: such a sentence contradicts itself."""
    sizes = (
        (row["seed"], c["key"], name, *size)
        for row in rows
        for c in row.get("causes", ())
        for name, size in c["parameters"].items()
    )
    return [
        f"{seed}: {key} {name} {value:.4g} in [{low:.4g}, {high:.4g}]"
        for seed, key, name, value, low, high in sizes
        if not low <= value <= high
    ]


def outcome(row: Row) -> Outcome:
    """What was said about the single effect of a row."""
    key, causes = row["truth"][0]["key"], beyond_rounding(row)
    if not causes:
        return Outcome.UNKNOWN if row.get("verdict") in ("unknown", "incomplete") else Outcome.MISSED
    if found(row):
        if len(causes) > 1:
            return Outcome.BESIDE
        return Outcome.RIGHT if causes[0]["key"] == key else Outcome.TIE
    return Outcome.WRONG if misled(row) else Outcome.FLAGGED


def must_be_found(row: Row) -> bool:
    """Whether every hidden effect is TESTABLE times its limit, that of records without it and that of the row's own records.

    A rounded channel has no limit of its own: its step is part of the noise from which the diagnosis states that limit.
    """
    return by_multiple(row) and all(_shown(row, t) for t in row["truth"])


def by_multiple(row: Row) -> bool:
    """Whether every hidden effect is TESTABLE times the limit of records without it, and not among what could not be tested."""
    return all(t["multiple"] >= TESTABLE and t["key"] not in row.get("untestable", ()) for t in row["truth"])


def _shown(row: Row, truth: Mapping[str, Any]) -> bool:
    if "error" in row or truth["key"].startswith(f"{ROUNDED}@"):
        return True
    limit = row["own_limits"].get(truth["key"])
    return limit is not None and truth["size"] >= TESTABLE * limit


def tied(row: Row) -> set[str]:
    """The hidden effects that a declared tie holds."""
    keys = hidden_in(row)
    return {key for key in keys for c in beyond_rounding(row) if c["ties"] and key in names(c, keys)}


def resolution(row: Row) -> Resolution | None:
    """What the recommended experiment made of a tie; None where no tie holds what was hidden, or there is no plan to choose from.

    Strict: every effect that was in a tie is named alone, and nothing wrong is named beside it, whatever was there before. Two
    effects that are a rival together were in no tie that the experiment was chosen for.
    """
    keys, experiment = tied(row), row.get("experiment")
    if not keys or experiment is None:
        return None
    if not experiment["runs"]:
        return Resolution.UNDECIDABLE
    if "fault" in experiment:
        return Resolution.FAILED
    after = {"truth": row["truth"], "causes": experiment["after"]["causes"]}
    if strangers(after) or not keys <= set().union(*map(names, after["causes"])):
        return Resolution.LOST
    alone = {c["key"] for c in after["causes"] if all(" + " in rival for rival in c["ties"])}
    return Resolution.RESOLVED if keys <= alone else Resolution.TIED


def beyond_rounding(row: Row) -> Sequence[Mapping[str, Any]]:
    """What was named, without the rounding that a sensor has in every record: that is there, and is not what was hidden."""
    steps = {f"{ROUNDED}@{name}": step for name, step in row.get("resolutions", {}).items()}
    hidden = set(hidden_in(row))
    return [c for c in row.get("causes", ()) if c["key"] in hidden or not _is_step(c, steps.get(c["key"]))]


def _is_step(cause: Mapping[str, Any], step: float | None) -> bool:
    return bool(step) and abs(cause["parameters"]["step"][0] / step - 1.0) < SAME_STEP


# ---- many rows ----------------------------------------------------------------------------------------------------------------


def summary(rows: Iterable[Row]) -> Summary:
    """Every rate of these rows."""
    rows = [row for row in rows if "undrawn" not in row]
    nothing, outside, pairs, single = (
        [row for row in rows if row["kind"] == kind] for kind in ("nothing", "outside", "pair", "single")
    )
    far = [row for row in outside if row["truth"][0]["multiple"] >= FAR_OUTSIDE]
    shown, both = [row for row in single if must_be_found(row)], [row for row in pairs if must_be_found(row)]
    said = [outcome(row) for row in shown]
    held = (Outcome.RIGHT, Outcome.TIE)
    ties = [r for row in rows if (r := resolution(row))]
    return Summary(
        cases=len(rows),
        errors=sum("error" in row for row in rows),
        right=share(o is Outcome.RIGHT for o in said),
        right_or_tie=share(o in held for o in said),
        wrong=share(o is Outcome.WRONG for o in said),
        missed=share(o is Outcome.MISSED for o in said),
        right_or_tie_by_multiple=share(outcome(row) in held for row in single if by_multiple(row)),
        wrong_at_any_size=share(outcome(row) is Outcome.WRONG for row in single),
        false_alarms=share(bool(beyond_rounding(row)) for row in nothing),
        unknown_of_nothing=share(row.get("verdict") == "unknown" for row in nothing),
        both=share(found(row) == 2 for row in both),
        one=share(found(row) == 1 for row in both),
        both_by_multiple=share(found(row) == 2 for row in pairs if by_multiple(row)),
        wrong_in_pairs=share(bool(misled(row)) for row in both),
        outside=share(row.get("verdict") in ("unknown", "incomplete") for row in far),
        inside=share(inside(rows)),
        gained=share(_gained(rows)),
        resolved=share(r is Resolution.RESOLVED for r in ties if r is not Resolution.UNDECIDABLE),
        undecidable=share(r is Resolution.UNDECIDABLE for r in ties),
        ties={r.value: n for r in Resolution if (n := ties.count(r))},
        outcomes={o.value: n for o in Outcome if (n := said.count(o))},
        detection=_by_size(single, lambda row: outcome(row) in held),
        noticed=_by_size(single, lambda row: outcome(row) is not Outcome.MISSED),
        calibration=_calibration([*nothing, *pairs, *single]),
        confusions=_confusions([*pairs, *single]),
        seconds=_seconds(rows),
    )


def by_machine(rows: Sequence[Row]) -> dict[str, Summary]:
    """The summary of all rows, and that of every machine."""
    machines = sorted({row["machine"] for row in rows})
    return {"all": summary(rows)} | {name: summary([row for row in rows if row["machine"] == name]) for name in machines}


def inside(rows: Iterable[Row]) -> Iterable[bool]:
    """Whether a true number lies in its stated interval; a number that is stated without one is not asked."""
    for row in rows:
        truth = {t["key"]: t["parameters"] for t in row["truth"]}
        for cause in beyond_rounding(row):
            for name, true in truth.get(cause["key"], {}).items():
                _, low, high = cause["parameters"].get(name, (0.0, 0.0, 0.0))
                if low < high:
                    yield low <= true <= high


def _gained(rows: Iterable[Row]) -> Iterable[bool]:
    return (c["improved"] < 1.0 for row in rows for c in beyond_rounding(row) if c["improved"] is not None)


def _binned(values: Sequence[float], hits: Sequence[bool], edges: Sequence[float]) -> tuple[Bin, ...]:
    """A bin between each two edges, the upper one outside but for the last."""
    at = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    found = []
    for k, (low, high) in enumerate(pairwise(edges)):
        own = np.flatnonzero(at == k).tolist()
        if own:
            found.append(Bin(low, high, float(np.mean([values[i] for i in own])), share(hits[i] for i in own)))
    return tuple(found)


def _by_size(rows: Sequence[Row], hit: Callable[[Row], bool]) -> tuple[Bin, ...]:
    return _binned([row["truth"][0]["multiple"] for row in rows], [hit(row) for row in rows], SIZES)


def _calibration(rows: Iterable[Row]) -> tuple[Bin, ...]:
    """Every name with its posterior and every rival with its weight, against whether it was hidden."""
    stated, hits = [], []
    for row in rows:
        keys = set(hidden_in(row))
        for cause in beyond_rounding(row):
            for key, weight in {cause["key"]: cause["posterior"], **cause["ties"]}.items():
                stated.append(weight)
                hits.append(set(key.split(" + ")) <= keys)
    return _binned(stated, hits, WEIGHTS)


def _confusions(rows: Iterable[Row]) -> tuple[Confusion, ...]:
    """What was named where something else was hidden, the most frequent first."""
    counts, tied = Counter(), Counter()
    for row in rows:
        keys, said = hidden_in(row), {c["key"] for c in beyond_rounding(row)}
        for cause in beyond_rounding(row):
            for key in keys:
                if key not in said and cause["key"] not in keys:
                    pair = row["machine"], key, cause["key"]
                    counts[pair] += 1
                    tied[pair] += key in names(cause, keys)
    return tuple(Confusion(hidden, named, n, tied[m, hidden, named], m) for (m, hidden, named), n in counts.most_common())


def _seconds(rows: Sequence[Row]) -> tuple[Seconds, ...]:
    found = []
    for machine in sorted({row["machine"] for row in rows}):
        for kind in ("nothing", "single", "pair", "outside"):
            own = [row["seconds"] for row in rows if (row["machine"], row["kind"]) == (machine, kind) and "seconds" in row]
            if own:
                found.append(
                    Seconds(f"{machine}, {kind}", len(own), float(np.median(own)), float(np.quantile(own, 0.9)), max(own))
                )
    return tuple(found)
