"""Validity domains in regressor space: where a mode has been seen, how far a sample lies outside, which modes are one.

    domain = conv(U_k box_k) = {x: exists l >= 0, 1'l = 1, |x - V'l| <= R'l}
    gauge  = min t >= 0 such that the query box meets the domain widened by t s on every side

V (m, d) are the centres, R (m, d) the radii of the boxes, s (d) the coordinate ranges of the data: a gauge of 0.1 is a
tenth of the range outside. A hull of samples is not the true domain: outside means unknown, not invalid. A thousand
samples in eight dimensions enclose only about half of the next ones of the same regime, so ask for gauge <= 0.1, not 0.

The linear programs are solved in their dual, the widest gap a hyperplane leaves between two sets: few columns, and of the
boxes only those that matter become rows. What the solver says is checked in plain arithmetic with a rounding margin; where
neither yes nor no can be proved, as for sets that touch, the answer is None.
"""

import itertools
from collections.abc import Callable, Sequence
from enum import Enum
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np

from workbench.errors import InputError
from workbench.lp import NotSolvedError, RowProgram
from workbench.records import field, record

INSIDE = 1e-9  # a gauge below this is reported as 0: the accuracy of the linear programs
FLAT = 1e-9  # a range this small against the values is rounding
AGREES = 1e-7  # largest difference of the two bounds of a gauge
FACET_DIMENSIONS = 6  # above, the facets of a hull are too many
EPS = float(np.finfo(float).eps)

Item = TypeVar("Item")


# ---- the records ----------------------------------------------------------------------------------------------------


@record
class Hyperplane:
    """normal'x <= offset on the first set, normal'x > offset on the second; rounding is on the safe side."""

    normal: np.ndarray = field("d")
    offset: float = field("")


@record
class Containment:
    """Is every point of the other domain in this one, widened by tolerance s? `answer` None: not provable either way.

    After a no, `witness` (d) is an extreme point of the other domain, `gauge` a lower bound of its gauge in this one and
    `separation` has this domain on its lower side and the witness above.
    """

    answer: bool | None
    tolerance: float = field("", low=0.0)
    witness: np.ndarray | None = None
    gauge: float = 0.0
    separation: Hyperplane | None = None


@record
class Meeting:
    """Have two domains a common point? `answer` None: they touch, or are flat, and rounding decides.

    After a yes, `point` (d) is the common point to rounding, with its weights (m1), (m2) on the boxes of the two domains;
    after a no, `separation` has the first domain on its lower side and the second above.
    """

    answer: bool | None
    point: np.ndarray | None = None
    first_weights: np.ndarray | None = None
    second_weights: np.ndarray | None = None
    separation: Hyperplane | None = None


@record
class Choice:
    """For every sample the domain that was chosen, `index` (Q), the gauge (Q) in it, and the domains that hold it, (Q, M)."""

    index: np.ndarray
    gauge: np.ndarray = field("Q", low=0.0)
    holds: np.ndarray = field(None)


@record
class _Boxes:
    """Boxes [low_k, high_k], (m, d). With low > high a box asks to be covered rather than to be met."""

    low: np.ndarray
    high: np.ndarray

    @staticmethod
    def one(low: np.ndarray, high: np.ndarray) -> "_Boxes":
        return _Boxes(low[None], high[None])

    @property
    def size(self) -> np.ndarray:
        """Largest magnitude in every coordinate: what rounding is measured by."""
        return np.maximum(np.abs(self.low), np.abs(self.high)).max(axis=0)

    def highest(self, w: np.ndarray) -> float:
        return float((self.high @ np.maximum(w, 0.0) + self.low @ np.minimum(w, 0.0)).max())


class _Region:
    """What every domain can do: it only needs its boxes."""

    boxes: _Boxes

    @cached_property
    def low(self) -> np.ndarray:
        """Lower corner (d) of the outer box."""
        return self.boxes.low.min(axis=0)

    @cached_property
    def high(self) -> np.ndarray:
        """Upper corner (d) of the outer box."""
        return self.boxes.high.max(axis=0)

    @cached_property
    def scale(self) -> np.ndarray:
        """s (d): coordinate ranges; where the data are flat the size of the value, and 1 where that is 0 too."""
        size = self.boxes.size
        span = self.high - self.low
        return np.where(span > FLAT * size, span, np.where(size > 0, size, 1.0))

    def gauge(self, x: np.ndarray, radius: np.ndarray | None = None) -> np.ndarray:
        """min t: the box x -+ radius meets the domain widened by t s; (Q), 0 inside. x (Q, d), radius (Q, d) or None.

        Exact to 1e-9 (values below are 0). Raises InputError for a wrong shape, a number that is none, a negative radius.
        """
        x, radius = _queries(x, radius, len(self.low))
        return self._gauge(x - radius, x + radius)

    def outer_gauge(self, x: np.ndarray, radius: np.ndarray | None = None) -> np.ndarray:
        """The gauge in the outer box: a lower bound of the gauge that costs nothing; shapes as there."""
        x, radius = _queries(x, radius, len(self.low))
        return self._outer(x - radius, x + radius)

    def _outer(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        return np.maximum((low - self.high) / self.scale, (self.low - high) / self.scale).max(axis=-1).clip(min=0.0)

    def _gauge(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def contains(self, other: "Domain", tolerance: float = 0.0) -> Containment:
        """Has every extreme point of `other` a gauge <= tolerance here? Most extreme first; the first that has not decides."""
        _same_dimension(self, other)
        if not 0.0 <= tolerance < np.inf:
            raise InputError(f"tolerance {tolerance:g}", mend="a share of the coordinate ranges, 0 or more")
        return _Inclusion(self, tolerance).of(other)

    def meets(self, other: "Domain") -> Meeting:
        """min t such that |V1'l - V2'm| <= R1'l + R2'm + t s: a common point where it is 0, a hyperplane between where not."""
        _same_dimension(self, other)
        first, second = self.boxes, other.boxes
        apart = np.maximum((other.low - self.high), (self.low - other.high))
        scale, d = np.maximum(self.scale, other.scale), len(self.low)
        widest = int(np.argmax(apart / scale))
        axis = np.where(np.arange(d) == widest, np.where(other.low > self.high, 1.0, -1.0), 0.0)
        plane = _separation(first, second, axis) if apart[widest] > 0 else None
        if plane:
            return Meeting(False, separation=plane)
        middle = (np.minimum(self.low, other.low) + np.maximum(self.high, other.high)) / 2
        program = _Gap([_rows(first, middle, scale), _rows(second, middle, scale)[:, [*range(d, 2 * d), *range(d)]]])
        gap = program.solve(np.zeros(2 * d))
        plane = _separation(first, second, gap.normal / scale)
        if plane:
            return Meeting(False, separation=plane)
        a, b = gap.weights
        if not _proved(first, a, second, b, np.zeros(d), scale):
            return Meeting(None)
        low, high = np.maximum(a @ first.low, b @ second.low), np.minimum(a @ first.high, b @ second.high)
        return Meeting(True, (low + high) / 2, a, b)

    @cached_property
    def _program(self) -> "_Gap":
        return _Gap([_rows(self.boxes, self._middle, self.scale)])

    @cached_property
    def _middle(self) -> np.ndarray:
        return (self.low + self.high) / 2

    def _gap(self, low: np.ndarray, high: np.ndarray, enough: float = 0.0) -> "_Answer":
        """Both bounds of the gauge of one query box, good enough to tell whether it is below `enough`."""
        cost = np.concatenate([(low - self._middle) / self.scale, (self._middle - high) / self.scale])
        return self._program.solve(cost, enough)


@record
class Hull(_Region):
    """conv(U_k box_k) of boxes points_k -+ radii_k; points (m, d), radii (m, d) or anything that fills that shape.

    Where all radii are the same it is conv(points) + box, and up to six dimensions only the corners of conv(points) are
    kept. Flat, repeated or single points are fine. Raises InputError for no points, infinite numbers, negative radii.
    """

    points: np.ndarray = field("m d")
    radii: np.ndarray = field(None, default=0.0)

    def __post_init__(self):
        if self.points.size == 0 or not np.isfinite(self.points).all():
            raise InputError("a hull needs points, all finite", mend="leave out rows with missing values")
        try:
            radii = np.array(np.broadcast_to(np.asarray(self.radii, float), self.points.shape))
        except ValueError:
            raise InputError(f"radii {np.shape(self.radii)} for points {self.points.shape}", mend="one row per point") from None
        if not (np.isfinite(radii).all() and np.all(radii >= 0)):
            raise InputError("radii must be finite and not negative")
        both = np.unique(np.hstack([self.points, radii]), axis=0)
        points, radii = np.hsplit(both, 2)
        span, size = np.ptp(points, axis=0), np.abs(points).max(axis=0)
        facets, corners = _facets(points, np.where(span > FLAT * size, span, np.where(size > 0, size, 1.0)))
        if corners is not None and np.all(radii == radii[0]):
            points, radii = points[corners], radii[corners]
        for name, value in (("points", points), ("radii", radii)):
            value = np.ascontiguousarray(value)
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        object.__setattr__(self, "_inner", facets)

    @cached_property
    def boxes(self) -> _Boxes:  # type: ignore[override]
        return _Boxes(self.points - self.radii, self.points + self.radii)

    def _gauge(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        value = self._outer(low, high)
        if len(self.low) == 1 or len(self.points) == 1:
            return np.where(value < INSIDE, 0.0, value)
        # a query whose centre lies in conv(points) needs no program
        for k in np.flatnonzero(~((value == 0) & (self._side((low + high) / 2) > 0))):
            value[k] = self._gap(low[k], high[k]).value
        return value

    def holds(self, x: np.ndarray) -> np.ndarray:
        """Which of the points x (Q, d) lie in the domain: gauge == 0, without a program but for those too close to a facet."""
        x = _queries(x, None, len(self.low))[0]
        held = self._outer(x, x) < INSIDE
        if np.all(self.radii == 0.0):
            side = self._side(x)
            doubtful = np.flatnonzero(held & (side == 0))
            held &= side > 0
        else:  # facets of the points alone: outside of them the radii decide
            doubtful = np.flatnonzero(held & (self._side(x) <= 0))
        held[doubtful] = self._gauge(x[doubtful], x[doubtful]) == 0.0
        return held

    def _side(self, x: np.ndarray) -> np.ndarray:
        facets: _Facets | None = self._inner  # type: ignore[attr-defined]
        return np.zeros(len(x), dtype=int) if facets is None else facets.side(x)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers: {"points": [[...]], "radii": [[...]]}."""
        return {"points": self.points.tolist(), "radii": self.radii.tolist()}


@record
class Box(_Region):
    """low <= x <= high, (d) each; also the interval of a schedule. Raises InputError where low > high or not finite."""

    low: np.ndarray = field("d")  # type: ignore[assignment]
    high: np.ndarray = field("d")  # type: ignore[assignment]

    def __post_init__(self):
        if not (np.isfinite(self.low).all() and np.isfinite(self.high).all() and np.all(self.low <= self.high)):
            raise InputError(f"a box from {self.low} to {self.high}", mend="low <= high, both finite")

    @cached_property
    def boxes(self) -> _Boxes:  # type: ignore[override]
        return _Boxes.one(self.low, self.high)

    def _gauge(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        value = self._outer(low, high)
        return np.where(value < INSIDE, 0.0, value)

    def holds(self, x: np.ndarray) -> np.ndarray:
        """Which of the points x (Q, d) lie in the box."""
        return self.gauge(x) == 0.0

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers: {"low": [...], "high": [...]}."""
        return {"low": self.low.tolist(), "high": self.high.tolist()}


Domain = Hull | Box


def outer_box(domain: Domain) -> Box:
    """The smallest box around a domain."""
    return Box(domain.low, domain.high)


def domain_from_dict(entry: dict[str, Any], file: object = None) -> Domain:
    """The domain that `to_dict` wrote; raises InputError for anything else."""
    for names, kind in ((("points", "radii"), Hull), (("low", "high"), Box)):
        if set(entry) == set(names):
            return kind(*(entry[name] for name in names))
    raise InputError(f"no domain in {sorted(entry)}", file=file, mend="expected points and radii, or low and high")


def shadow(domain: Domain, first: int, second: int) -> np.ndarray:
    """Corners (v, 2), counter-clockwise, of the domain's projection onto two coordinates; exact, two or one if it is flat."""
    d = len(domain.low)
    if not (0 <= first < d and 0 <= second < d):
        raise InputError(f"coordinates {first} and {second} of a domain with {d}", mend=f"0 to {d - 1}")
    low, high = domain.boxes.low[:, [first, second]], domain.boxes.high[:, [first, second]]
    corners = np.vstack([np.column_stack([a[:, 0], b[:, 1]]) for a in (low, high) for b in (low, high)])
    corners = np.unique(corners, axis=0)
    if len(corners) < 3:
        return corners
    return np.array([*_chain(corners)[:-1], *_chain(corners[::-1])[:-1]])


def _chain(corners: np.ndarray) -> list[np.ndarray]:
    """The corners of sorted points that only turn left (Andrew's monotone chain)."""
    chain: list[np.ndarray] = []
    for p in corners:
        while len(chain) > 1 and np.linalg.det(np.array([chain[-1] - chain[-2], p - chain[-2]])) <= 0:
            chain.pop()
        chain.append(p)
    return chain


def nearest(domains: Sequence[Domain], x: np.ndarray, *, hold: bool = False) -> Choice:
    """The domain with the smallest gauge for every sample; x (Q, d), samples in the order of time.

    Ties go to the first domain. With `hold` a sample inside the domain chosen for the sample before stays there, so that
    overlapping domains do not make a model switch to and fro.
    """
    if not domains:
        raise InputError("no domains to choose from")
    for other in domains[1:]:
        _same_dimension(domains[0], other)
    x, _ = _queries(x, None, len(domains[0].low))
    holds = np.column_stack([domain.holds(x) for domain in domains])
    index, gauge = np.argmax(holds, axis=1), np.zeros(len(x))
    outside = np.flatnonzero(~holds.any(axis=1))
    index[outside], gauge[outside] = _closest(domains, x[outside])
    if hold:
        for k in range(1, len(index)):
            if holds[k, index[k - 1]]:
                index[k] = index[k - 1]
    return Choice(index, gauge, holds)


def _closest(domains: Sequence[Domain], x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Domain of smallest gauge and that gauge for every sample outside all of them; outer boxes spare what cannot win."""
    bound = np.column_stack([domain._outer(x, x) for domain in domains])
    gauge, best = np.full(bound.shape, np.inf), np.full(len(x), np.inf)
    order = np.argsort(bound, axis=1, kind="stable")
    for rank in range(len(domains)):
        for j, domain in enumerate(domains):
            ask = np.flatnonzero((order[:, rank] == j) & (bound[:, j] <= best))
            if len(ask):
                gauge[ask, j] = domain._gauge(x[ask], x[ask])
                best[ask] = np.minimum(best[ask], gauge[ask, j])
    index = np.argmin(gauge, axis=1)
    return index, gauge[np.arange(len(x)), index]


# ---- aggregation ----------------------------------------------------------------------------------------------------


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


# ---- inclusion ------------------------------------------------------------------------------------------------------


class _Inclusion:
    """Is a domain part of `region` widened by tolerance s?"""

    def __init__(self, region: _Region, tolerance: float):
        self.region, self.tolerance = region, tolerance
        self.slack = tolerance * region.scale
        # a box that is no wider than every box of the region and the slack can be taken as a whole
        boxes = region.boxes
        self.whole = (boxes.high - boxes.low).min(axis=0) + 2 * self.slack

    def of(self, other: Domain) -> Containment:
        low, high = other.boxes.low, other.boxes.high
        answer: bool | None = True
        for k in self._most_extreme_first(low, high):
            found = self._box(low[k], high[k])
            if found.answer is False:
                return found
            answer = answer and found.answer
        return Containment(answer, self.tolerance)

    def _most_extreme_first(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """First those beyond the outer box, then by the distance in the principal axes of the region's own boxes."""
        region = self.region
        outer = np.maximum((high - region.high) / region.scale, (region.low - low) / region.scale).max(axis=1).clip(min=0.0)
        own = (region.boxes.low + region.boxes.high) / 2 - region._middle
        centre = own.mean(axis=0)
        _, size, axes = np.linalg.svd((own - centre) / region.scale, full_matrices=False)
        kept = size > 1e-6 * max(size[0], 1e-300)
        away = ((low + high) / 2 - region._middle - centre) / region.scale @ (axes[kept].T / size[kept])
        return np.lexsort([-(away**2).sum(axis=1), -outer])

    def _box(self, low: np.ndarray, high: np.ndarray) -> Containment:
        """One box: as a whole, else by the two faces of its widest side, down to its corners if need be."""
        region = self.region
        gap = region._gap(high, low, self.tolerance)  # swapped ends: to be covered, not met
        if _proved(region.boxes, gap.weights[0], _Boxes.one(high, low), np.ones(1), self.slack, region.scale):
            return Containment(True, self.tolerance)
        normal = gap.normal / region.scale
        corner = np.where(normal > 0, high, low)
        plane = _separation(region.boxes, _Boxes.one(corner, corner), normal, self.slack)
        if plane:
            size = float(np.abs(plane.normal) @ region.scale)
            return Containment(False, self.tolerance, corner, (float(plane.normal @ corner) - plane.offset) / size, plane)
        excess = (high - low - self.whole) / region.scale
        side = int(np.argmax(excess))
        if excess[side] <= FLAT:
            return Containment(None, self.tolerance)
        answer: bool | None = True
        for ends in ((low[side], low[side] + self.whole[side]), (high[side] - self.whole[side], high[side])):
            face_low, face_high = low.copy(), high.copy()
            face_low[side], face_high[side] = ends
            found = self._box(face_low, face_high)
            if found.answer is False:
                return found
            answer = answer and found.answer
        return Containment(answer, self.tolerance)


# ---- the widest gap -------------------------------------------------------------------------------------------------


@record
class _Answer:
    """lower <= t <= upper in units of the scale; `normal` (d) proves the first, `weights` of every family the second."""

    lower: float
    upper: float
    normal: np.ndarray
    weights: tuple[np.ndarray, ...]

    @property
    def value(self) -> float:
        return 0.0 if self.upper < INSIDE else max(self.lower, 0.0)


class _Gap:
    """max cost'z - sum_f max_k F_f,k z over z = (p, q) >= 0 with 1'z <= 1: the dual of the gauge and of the meeting.

    A hyperplane with normal p - q leaves the gap. Only the boxes k that once decided become rows of the program, so that
    its size does not grow with the number of samples; it is made small again when too many have gathered.
    """

    def __init__(self, families: Sequence[np.ndarray]):
        self.families = tuple(families)  # (m_f, 2 d) each
        count = len(families)
        self.n = n = families[0].shape[1]
        self.size = 4 * n  # rows above which the program is made anew
        self.program = RowProgram(
            np.append(np.zeros(n), np.ones(count)),
            np.append(np.zeros(n), -np.full(count, 4.0)),
            np.append(np.ones(n), np.full(count, 4.0)),
        )
        self._start()

    def _start(self) -> None:
        self.program.clear()
        self.program.add(np.append(np.ones(self.n), np.zeros(len(self.families)))[None], -np.inf, 1.0)
        self.rows: list[np.ndarray] = [np.empty(0, dtype=int) for _ in self.families]
        self.order: list[int] = []  # the family of every row
        for f, F in enumerate(self.families):
            self._add(f, np.unique(F.argmax(axis=0)))

    def _add(self, family: int, rows: np.ndarray) -> None:
        tau = np.zeros((len(rows), len(self.families)))
        tau[:, family] = -1.0
        self.program.add(np.hstack([self.families[family][rows], tau]), -np.inf, 0.0)
        self.rows[family] = np.append(self.rows[family], rows)
        self.order += [family] * len(rows)

    def solve(self, cost: np.ndarray, enough: float = 0.0) -> _Answer:
        """Both bounds; they agree, or the upper one is below `enough`, or the lower one above it where it is not 0."""
        if len(self.order) > self.size:
            self._start()
        for _ in range(2):
            try:
                answer = self._solve(cost, enough)
            except NotSolvedError:
                answer = None
            if answer and (answer.upper - answer.lower <= AGREES or answer.upper <= enough or answer.lower > enough > 0):
                return answer
            self._start()  # rounding has gathered in the factors: once more from the beginning
        raise NotSolvedError("the gauge has no answer that stands the check outside the solver")

    def _solve(self, cost: np.ndarray, enough: float, rounds: int = 200) -> _Answer:
        self.program.change_cost(np.append(-cost, np.ones(len(self.families))))
        for _ in range(rounds):
            x, multipliers = self.program.solve()
            z = np.maximum(x[: self.n], 0.0)
            reach = [F @ z for F in self.families]
            value = float(cost @ z) - float(x[self.n :].sum())  # of the rows so far: never below the true one
            lower = float(cost @ z) - sum(float(r.max()) for r in reach)
            if value <= enough or lower > enough > 0 or value - lower <= 1e-11:
                break
            grown = False
            for f, r in enumerate(reach):
                worst = np.argpartition(-r, min(self.n, len(r)) - 1)[: self.n]
                worst = np.setdiff1d(worst[r[worst] > x[self.n + f] + 1e-11], self.rows[f])
                if len(worst):
                    self._add(f, worst)
                    grown = True
            if not grown:
                break
        return self._checked(cost, z, lower, multipliers)

    def _checked(self, cost: np.ndarray, z: np.ndarray, lower: float, multipliers: np.ndarray) -> _Answer:
        weights, family = [], np.array(self.order)
        for f, F in enumerate(self.families):
            weight = np.zeros(len(F))
            weight[self.rows[f]] = np.abs(multipliers[1:][family == f])
            weights.append(weight / max(weight.sum(), 1e-300))
        upper = float((cost - sum(weight @ F for weight, F in zip(weights, self.families, strict=True))).max())
        lower = lower / float(z.sum()) if lower > 0 else 0.0
        p, q = np.split(z, 2)
        return _Answer(lower, max(upper, 0.0), p - q, tuple(weights))


def _rows(boxes: _Boxes, middle: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(high, -low) of the boxes in units of the scale: its product with (p, q) is the highest point along p - q."""
    return np.hstack([(boxes.high - middle) / scale, (middle - boxes.low) / scale])


# ---- certificates ---------------------------------------------------------------------------------------------------


def _separation(first: _Boxes, second: _Boxes, normal: np.ndarray, slack: np.ndarray | float = 0.0) -> Hyperplane | None:
    """The hyperplane, if `second` lies above the highest point of `first` by more than the slack and rounding."""
    size = np.abs(normal)
    error = 4 * (len(normal) + 4) * EPS * float(size @ (first.size + second.size + slack))
    offset = first.highest(normal) + error
    above = -second.highest(-normal) - error
    return Hyperplane(normal, offset) if above > offset + float((size * slack).sum()) else None


def _proved(first: _Boxes, a: np.ndarray, second: _Boxes, b: np.ndarray, slack: np.ndarray, scale: np.ndarray) -> bool:
    """Are there exact weights near a (m1), b (m2) with low1'a <= high2'b + slack and low2'b <= high1'a + slack?

    An inequality is sure when it holds beyond rounding, or for every pair of boxes that has weight. The others hold as
    equations after a small change of the weights, which exists if their matrix has full rank: change <= error / sigma_min.
    It must leave the weights positive and the sure inequalities true.
    """
    used = a > 1e-12, b > 1e-12
    a, b = a[used[0]] / a[used[0]].sum(), b[used[1]] / b[used[1]].sum()
    left = np.hstack([first.low[used[0]], -first.high[used[0]]])
    right = np.hstack([-second.high[used[1]], second.low[used[1]]])
    slack, scale = np.tile(slack, 2), np.tile(scale, 2)
    count = len(a) + len(b)
    error = 4 * (count + 4) * EPS * (np.abs(left).max(axis=0) + np.abs(right).max(axis=0) + slack)
    value = a @ left + b @ right - slack
    each = (left.max(axis=0) <= -right.max(axis=0)) if not slack.any() else np.zeros(len(value), dtype=bool)
    # an equation met to the solver's accuracy shows up in one row as room: that is not sure
    tight = ~(each | (value < -error - np.where(slack > 0, 0.0, INSIDE * scale)))
    if not tight.any():
        return True
    # rows from a middle point, so that the change of the weights is measured by the size of the sets; the two rows of a
    # coordinate without radii are one equation
    base = left[0]
    whole = np.vstack([left - base, right + base]) / scale
    rows = np.unique(_without_opposites(whole.T[tight]), axis=0)
    simplex = np.zeros((2, count))
    simplex[0, : len(a)] = simplex[1, len(a) :] = 1.0
    M = np.vstack([rows, simplex])
    if len(M) > count:
        return False
    sigma = float(np.linalg.svd(M, compute_uv=False).min())
    if sigma <= FLAT:
        return False
    missing = np.append(((np.abs(value) + error) / scale)[tight], [count * EPS] * 2)
    change = 2 * float(np.linalg.norm(missing)) / sigma
    room = (-(value + error) / scale)[~tight & ~each]
    size = float(np.linalg.norm(whole, axis=0).max())
    return change < min(a.min(), b.min()) and bool(np.all(change * size < room))


def _without_opposites(rows: np.ndarray) -> np.ndarray:
    """Of two rows that are each other's negative only one: the sign is set by the first entry that is not 0."""
    lead = rows[np.arange(len(rows)), np.argmax(rows != 0, axis=1)]
    return rows * np.where(lead < 0, -1.0, 1.0)[:, None]


# ---- facets and checks ----------------------------------------------------------------------------------------------


@record
class _Facets:
    """normals (x - middle) <= offsets: conv(points) within its affine hull, flat (x - middle) = 0 where it is not full.

    Rows are of unit length in whitened coordinates. reach, flat_reach: how far a row moves when the domain is widened by 1 s.
    """

    normals: np.ndarray
    offsets: np.ndarray
    flat: np.ndarray
    middle: np.ndarray
    reach: np.ndarray
    flat_reach: np.ndarray

    def side(self, x: np.ndarray) -> np.ndarray:
        """For x (Q, d): 1 inside to 1e-12 of the cloud's spread, -1 outside by a gauge above INSIDE, 0 too close to tell.

        Samples of a two-valued input all lie on facets: those must count without a program.
        """
        rows = len(self.normals) + len(self.flat)
        chunk = max(1, 4_000_000 // max(rows, 1))  # keeps the products small
        parts = [self._sides(x[k : k + chunk] - self.middle) for k in range(0, len(x), chunk)]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=int)

    def _sides(self, part: np.ndarray) -> np.ndarray:
        found = np.ones(len(part), dtype=int)
        for rows, offsets, reach, two in (
            (self.normals, self.offsets, self.reach, False),
            (self.flat, 0.0, self.flat_reach, True),
        ):
            if not len(rows):
                continue
            beyond = part @ rows.T
            beyond = np.abs(beyond) if two else np.subtract(beyond, offsets, out=beyond)
            near = np.flatnonzero(beyond.max(axis=1) > 1e-12)
            outside = np.any(beyond[near] > 2 * INSIDE * reach + 1e-12, axis=1)
            found[near] = np.minimum(found[near], np.where(outside, -1, 0))
        return found


def _facets(points: np.ndarray, scale: np.ndarray) -> tuple[_Facets | None, np.ndarray | None]:
    """Facets of conv(points) by Qhull, and its corners where it is not flat; None in too many dimensions."""
    m, d = points.shape
    middle = points.mean(axis=0)
    # delayed values of one signal lie near a plane: whitened, they do not trouble Qhull
    triangle: Any = np.linalg.qr((points - middle) / scale, mode="r")
    _, size, axes = np.linalg.svd(triangle, full_matrices=True)
    size = np.concatenate([size, np.zeros(d - len(size))])
    rank = int(np.sum(size > FLAT * max(size[0], FLAT * np.sqrt(m))))
    if d < 2 or rank > FACET_DIMENSIONS:
        return None, None
    whiten = axes[:rank].T * (np.sqrt(m) / size[:rank]) / scale[:, None]
    equations, corners = _hull_equations((points - middle) @ whiten)
    if equations is None:
        return None, None
    normals, flat = equations[:, :-1] @ whiten.T, axes[rank:] / scale
    facets = _Facets(normals, -equations[:, -1], flat, middle, np.abs(normals) @ scale, np.abs(flat) @ scale)
    return facets, corners if rank == d else None


def _hull_equations(points: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Rows normal'x + offset <= 0 of conv(points) (m, r), and the corners' numbers."""
    from scipy.spatial import ConvexHull, QhullError

    r = points.shape[1]
    if r == 0:
        return np.zeros((0, 1)), None
    if r == 1:
        return np.array([[1.0, -points.max()], [-1.0, points.min()]]), None
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None, None
    return np.unique(hull.equations, axis=0), np.sort(hull.vertices)


def _queries(x: np.ndarray, radius: np.ndarray | None, d: int) -> tuple[np.ndarray, np.ndarray]:
    x = np.asarray(x, dtype=float)
    if x.ndim != 2 or x.shape[1] != d:
        raise InputError(f"queries of shape {x.shape}", mend=f"one row of {d} values per sample")
    radius = np.zeros_like(x) if radius is None else np.asarray(radius, dtype=float)
    if radius.shape != x.shape:
        raise InputError(f"radii of shape {radius.shape} for queries of shape {x.shape}", mend="one radius per value")
    if not (np.isfinite(x).all() and np.isfinite(radius).all() and np.all(radius >= 0)):
        raise InputError("queries must be finite, their radii not negative", mend="leave out samples with missing values")
    return x, radius


def _same_dimension(a: _Region, b: _Region) -> None:
    if len(a.low) != len(b.low):
        raise InputError(f"domains of {len(a.low)} and {len(b.low)} coordinates", mend="use the same regressors for both")
