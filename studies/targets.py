"""What a rate must come to, and how a study says which of them it reached."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from studies.hidden_scores import Bin, Confusion, Seconds, Share
from workbench.records import record
from workbench.report.blocks import Table


@record
class Target:
    """The range that a rate must lie in; rate: a field of a summary that is a Share."""

    what: str
    rate: str
    low: float = 0.0
    high: float = 1.0

    def reached(self, share: Share) -> bool:
        return self.low <= share.rate <= self.high

    def __str__(self) -> str:
        if self.low == 0.0:
            return "none" if self.high == 0.0 else f"{100 * self.high:g} % or less"
        if self.high == 1.0:
            return "all" if self.low == 1.0 else f"{100 * self.low:g} % or more"
        return f"{100 * self.low:g} to {100 * self.high:g} %"


def reached(targets: Sequence[Target], summary: Any) -> list[str]:
    """What falls short first, then what was reached, then what no case asked: a sentence each, where there is any."""
    judged = [(t, getattr(summary, t.rate)) for t in targets]
    said = []
    for title, own in (
        ("Falls short", [(t, share) for t, share in judged if share.of and not t.reached(share)]),
        ("Reached", [(t, share) for t, share in judged if share.of and t.reached(share)]),
    ):
        if own:
            said.append(f"{title}: " + "; ".join(f"{t.what}: {share}, target {t}" for t, share in own) + ".")
    if open_ := [t.what for t, share in judged if not share.of]:
        said.append(f"Without a case: {'; '.join(open_)}.")
    return said


def target_table(targets: Sequence[Target], found: Mapping[str, Any], columns: Sequence[str] = (), caption: str = "") -> Table:
    """Targets against the summary `found["all"]`, and the cases of each of the `columns` of `found` beside it."""
    rows = []
    for t in targets:
        share = getattr(found["all"], t.rate)
        low, high = (100 * end for end in share.interval)
        met = "no case" if not share.of else "yes" if t.reached(share) else "no"
        numbers = [f"{s.hits} of {s.of}" for s in (share, *(getattr(found[name], t.rate) for name in columns))]
        rows.append((t.what, str(t), met, 100 * share.rate if share.of else None, low, high, *numbers))
    header = ("what", "target", "reached", "share [%]", "low [%]", "high [%]", "cases", *columns)
    caption = f"{caption} Intervals: Clopper and Pearson, 95 %.".strip()
    return Table("Targets and what was reached", header, tuple(rows), caption=caption, digits=3)


def to_json(summary: Any) -> dict[str, Any]:
    """A summary as plain numbers."""
    return {f.name: _plain(getattr(summary, f.name)) for f in fields(summary)}


def _plain(value: Any) -> Any:
    match value:
        case Share():
            return value.to_dict()
        case Bin():
            return {"low": value.low, "high": value.high, "mean": value.mean} | value.share.to_dict()
        case Confusion() | Seconds():
            return {f.name: getattr(value, f.name) for f in fields(value)}
        case tuple():
            return [_plain(x) for x in value]
    return value
