"""Merging of items whose domains lie in one another: which modes are one."""

import itertools
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Generic, TypeVar

from workbench.intervals.domains.shapes import Domain
from workbench.records import record

Item = TypeVar("Item")


class Relation(Enum):
    """The three cases of [2] section 5, and the one that rounding leaves open."""

    SUBSET = "one lies in the other"
    INTERSECTING = "they intersect"
    DISJOINT = "they are disjoint"
    UNDECIDED = "they touch, or are flat"


@record
class Decision:
    """What was done with one pair; `first` and `second` name the original items (0, 1, ...) that each is made of.

    Of a subset `first` is the larger one. `merged` is False for a subset whose joint data did not keep the precision.
    """

    first: tuple[int, ...]
    second: tuple[int, ...]
    relation: Relation
    merged: bool

    def __str__(self) -> str:
        a, b = ("+".join(map(str, group)) for group in (self.first, self.second))
        if self.relation is Relation.SUBSET:
            return f"{b} lies in {a}: " + ("merged" if self.merged else "kept apart, the joint data do not keep the precision")
        return f"{a} and {b}: {self.relation.value}, kept apart"


@record
class Aggregation(Generic[Item]):
    """What is left of the items, in their order, and every decision on the way."""

    items: tuple[Item, ...]
    members: tuple[tuple[int, ...], ...]  # the original items that each is made of
    decisions: tuple[Decision, ...]


@record
class _Group(Generic[Item]):
    item: Item
    members: tuple[int, ...]
    domain: Domain


def aggregate(
    items: Sequence[Item],
    domain_of: Callable[[Item], Domain],
    join: Callable[[Item, Item], Item | None],
    tolerance: float = 0.1,
) -> Aggregation[Item]:
    """Merge items whose domain lies in that of another (every extreme point has gauge <= tolerance), if `join` allows.

    join(larger, smaller) characterises the joint data anew and returns the new item, or None where it does not keep the
    precision: two regimes that differ by a hidden quantity have the same domain and different dynamics. Domains that
    intersect or are disjoint are never joined. Repeats until no pair changes. Source: [2] section 5, where the check of
    the precision is missing.
    """
    groups = [_Group(item, (k,), domain_of(item)) for k, item in enumerate(items)]
    settled: dict[frozenset, Decision] = {}
    decisions: list[Decision] = []
    while True:
        for a, b in itertools.combinations(groups, 2):
            pair = frozenset([a.members, b.members])
            if pair in settled:
                continue
            decision, merged = _decide(a, b, domain_of, join, tolerance)
            decisions.append(decision)
            settled[pair] = decision
            if merged:
                groups = sorted([g for g in groups if g is not a and g is not b] + [merged], key=lambda g: g.members)
                break
        else:
            return Aggregation(tuple(g.item for g in groups), tuple(g.members for g in groups), tuple(decisions))


def _decide(a: _Group, b: _Group, domain_of: Callable, join: Callable, tolerance: float) -> tuple[Decision, _Group | None]:
    for larger, smaller in ((a, b), (b, a)):
        if larger.domain.contains(smaller.domain, tolerance).answer:
            item = join(larger.item, smaller.item)
            decision = Decision(larger.members, smaller.members, Relation.SUBSET, item is not None)
            if item is None:
                return decision, None
            return decision, _Group(item, tuple(sorted(a.members + b.members)), domain_of(item))
    answer = a.domain.meets(b.domain).answer
    relation = {True: Relation.INTERSECTING, False: Relation.DISJOINT, None: Relation.UNDECIDED}[answer]
    return Decision(a.members, b.members, relation, False), None
