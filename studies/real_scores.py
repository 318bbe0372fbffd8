"""How right a diagnosis of measured machines was, from the rows of the study real-records and the labels of the machines.

Nobody has hidden anything in these machines: a label is a set of names that its literature, its authors or a with/without pair
allow. A cause is right where it, or a tie of three at most that it declares, holds an allowed name. Rounding by the step that the
record's own values show is no missing physics. Where the catalogue holds nothing of the label, no name is right, and "unknown"
is the answer.
"""

from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from typing import Any

from studies.hidden_scores import Share, beyond_rounding, misled, names, share, strangers
from studies.stranger_scores import Row, ratios, worse
from workbench.records import field, record

KEPT = "the plant keeps its own parameters"  # a note of the diagnosis, which says why


class Ending(Enum):
    """How a machine ends, in the words of the first lines; the worst first."""

    CRASHED = "Crashed"
    REFUSED = "Refused"
    WRONG = "Named against the label, with confidence"
    BESIDE = "Named against the label, and said not to be sure, or a wide tie"
    MISSED = "Said to lack nothing"
    OPEN = "Said to be unknown, though the catalogue holds a name"
    OUTSIDE = "Said to be unknown, and outside the catalogue"
    RIGHT = "Named as the label says"


@record
class Reference:
    """What others reach on a record: errors by method, with what is measured ("RMSE", or "FIT" in %) and by which rule.

    begin: samples of the record that may be used for the start, which are not counted. scale: of our unit in theirs.
    """

    record: str
    unit: str
    others: Mapping[str, float]
    begin: int
    scale: float = 1.0
    measure: str = "RMSE"
    note: str = ""


@record
class Machine:
    """A folder of records, split, the plant of studies.real_plants that is diagnosed on them, and its label.

    lacks: what the plain model lacks, as the label says. right: names "effect@place" that agree with it. shown: names that no
    label holds but the readings show without any model (one channel against another): allowed beside, never asked for. sizes:
    numbers that are known from elsewhere, {"effect@place:number": value}.
    """

    name: str
    plant: str
    records: tuple[str, ...]
    held_out: tuple[str, ...]
    lacks: str
    right: tuple[str, ...] = ()
    shown: tuple[str, ...] = ()
    sizes: Mapping[str, float] = field(default_factory=dict)
    references: tuple[Reference, ...] = ()


@record
class Summary:
    """All rates of a set of rows."""

    machines: int
    crashed: Share
    refused: Share
    wrong: Share  # of all answers: a name against the label, said to be sure
    beside: Share  # the same, said not to be sure
    right: Share  # of machines whose label the catalogue holds: an allowed name, and none against the label
    outside: Share  # of the other machines: "unknown", with no name
    lower: Share  # of all answers: held-out errors over the full run lower than those of the plant as given, or said why not
    worse: Share  # of all answers: worse a second ahead or over the full run, and not said


def labelled(row: Row, machine: Machine) -> Row:
    """The row with its label where the scores of hidden effects look for what was hidden."""
    return {**row, "truth": [{"key": key} for key in (*machine.right, *machine.shown)]}


def against(row: Row, machine: Machine) -> list[str]:
    """Causes that neither the label holds nor the readings show."""
    return strangers(labelled(row, machine)) if "verdict" in row else []


def agreeing(row: Row, machine: Machine) -> list[str]:
    """Causes that the label holds, alone or in a declared tie."""
    return [c["key"] for c in beyond_rounding(labelled(row, machine)) if names(c) & set(machine.right)]


def ending(row: Row, machine: Machine) -> Ending:
    """How a machine ends: what was said of it, against its label."""
    for fault in (Ending.CRASHED, Ending.REFUSED):
        if fault.name.lower() in row:
            return fault
    if against(row, machine):
        return Ending.WRONG if misled(labelled(row, machine)) else Ending.BESIDE
    if agreeing(row, machine):
        return Ending.RIGHT
    if row["verdict"] == "nothing":
        return Ending.MISSED
    return Ending.OPEN if machine.right else Ending.OUTSIDE


def sized(row: Row, machine: Machine) -> dict[str, tuple[float, float, float, float]]:
    """Known number, and the one found with its interval, by "effect@place:number", of what was named."""
    found = {f"{c['key']}:{name}": numbers for c in row.get("causes", ()) for name, numbers in c["parameters"].items()}
    return {key: (known, *found[key]) for key, known in machine.sizes.items() if key in found}


def lower(row: Row) -> bool:
    """Whether the held-out full-run error is lower than that of the plant as given, or the answer says why it is not."""
    ratio = ratios(row).get("full-run")
    kept = any(KEPT in note for note in row["notes"])
    return row["says_worse"] or kept or (ratio is not None and ratio < 1.0)


def summary(rows: Iterable[Row], machines: Mapping[str, Machine]) -> Summary:
    """Every rate of these rows."""
    rows = list(rows)
    pairs: Sequence[tuple[Any, Machine]] = [(row, machines[row["machine"]]) for row in rows]
    answered = [(row, machine) for row, machine in pairs if "verdict" in row]
    return Summary(
        machines=len(rows),
        crashed=share("crashed" in row for row in rows),
        refused=share("refused" in row for row in rows),
        wrong=share(ending(row, machine) is Ending.WRONG for row, machine in answered),
        beside=share(ending(row, machine) is Ending.BESIDE for row, machine in answered),
        right=share(ending(row, machine) is Ending.RIGHT for row, machine in pairs if machine.right),
        outside=share(ending(row, machine) is Ending.OUTSIDE for row, machine in pairs if not machine.right),
        lower=share(lower(row) for row, _ in answered if row.get("errors")),
        worse=share(bool(worse(row)) and not row["says_worse"] for row, _ in answered if row.get("errors")),
    )
