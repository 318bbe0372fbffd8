"""What every validity domain can do: the gauge of samples, inclusion of another domain, and a common point with it.

    domain = conv(U_k box_k) = {x: exists l >= 0, 1'l = 1, |x - V'l| <= R'l}
    gauge  = min t >= 0 such that the query box meets the domain widened by t s on every side

V (m, d) are the centres, R (m, d) the radii of the boxes, s (d) the coordinate ranges of the data: a gauge of 0.1 is a
tenth of the range outside.
"""

from functools import cached_property

import numpy as np

from workbench.errors import InputError
from workbench.intervals.domains.boxes import FLAT, Boxes
from workbench.intervals.domains.certificates import Hyperplane, separation, weights_proved
from workbench.intervals.domains.gap import Gap, GapAnswer, gap_rows
from workbench.records import field, record


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


class Region:
    """What every domain can do: it only needs its boxes."""

    boxes: Boxes

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
        x, radius = checked_queries(x, radius, len(self.low))
        return self.gauge_of_boxes(x - radius, x + radius)

    def outer_gauge(self, x: np.ndarray, radius: np.ndarray | None = None) -> np.ndarray:
        """The gauge in the outer box: a lower bound of the gauge that costs nothing; shapes as there."""
        x, radius = checked_queries(x, radius, len(self.low))
        return self.outer_gauge_of_boxes(x - radius, x + radius)

    def outer_gauge_of_boxes(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """The outer gauge (Q) of boxes from low to high, (Q, d) each, which are not checked."""
        return np.maximum((low - self.high) / self.scale, (self.low - high) / self.scale).max(axis=-1).clip(min=0.0)

    def gauge_of_boxes(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """The gauge (Q) of boxes from low to high, (Q, d) each, which are not checked."""
        raise NotImplementedError

    def contains(self, other: "Region", tolerance: float = 0.0) -> Containment:
        """Has every extreme point of `other` a gauge <= tolerance here? Most extreme first; the first that has not decides."""
        check_same_dimension(self, other)
        if not 0.0 <= tolerance < np.inf:
            raise InputError(f"tolerance {tolerance:g}", mend="a share of the coordinate ranges, 0 or more")
        return _Inclusion(self, tolerance).of(other)

    def meets(self, other: "Region") -> Meeting:
        """min t such that |V1'l - V2'm| <= R1'l + R2'm + t s: a common point where it is 0, a hyperplane between where not."""
        check_same_dimension(self, other)
        first, second = self.boxes, other.boxes
        apart = np.maximum((other.low - self.high), (self.low - other.high))
        scale, d = np.maximum(self.scale, other.scale), len(self.low)
        widest = int(np.argmax(apart / scale))
        axis = np.where(np.arange(d) == widest, np.where(other.low > self.high, 1.0, -1.0), 0.0)
        plane = separation(first, second, axis) if apart[widest] > 0 else None
        if plane:
            return Meeting(False, separation=plane)
        middle = (np.minimum(self.low, other.low) + np.maximum(self.high, other.high)) / 2
        program = Gap([gap_rows(first, middle, scale), gap_rows(second, middle, scale)[:, [*range(d, 2 * d), *range(d)]]])
        gap = program.solve(np.zeros(2 * d))
        plane = separation(first, second, gap.normal / scale)
        if plane:
            return Meeting(False, separation=plane)
        a, b = gap.weights
        if not weights_proved(first, a, second, b, np.zeros(d), scale):
            return Meeting(None)
        low, high = np.maximum(a @ first.low, b @ second.low), np.minimum(a @ first.high, b @ second.high)
        return Meeting(True, (low + high) / 2, a, b)

    @cached_property
    def _program(self) -> Gap:
        return Gap([gap_rows(self.boxes, self._middle, self.scale)])

    @cached_property
    def _middle(self) -> np.ndarray:
        return (self.low + self.high) / 2

    def _gap(self, low: np.ndarray, high: np.ndarray, enough: float = 0.0) -> GapAnswer:
        """Both bounds of the gauge of one query box, good enough to tell whether it is below `enough`."""
        cost = np.concatenate([(low - self._middle) / self.scale, (self._middle - high) / self.scale])
        return self._program.solve(cost, enough)


class _Inclusion:
    """Is a domain part of `region` widened by tolerance s?"""

    def __init__(self, region: Region, tolerance: float):
        self.region, self.tolerance = region, tolerance
        self.slack = tolerance * region.scale
        # a box that is no wider than every box of the region and the slack can be taken as a whole
        boxes = region.boxes
        self.whole = (boxes.high - boxes.low).min(axis=0) + 2 * self.slack

    def of(self, other: Region) -> Containment:
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
        if weights_proved(region.boxes, gap.weights[0], Boxes.one(high, low), np.ones(1), self.slack, region.scale):
            return Containment(True, self.tolerance)
        normal = gap.normal / region.scale
        corner = np.where(normal > 0, high, low)
        plane = separation(region.boxes, Boxes.one(corner, corner), normal, self.slack)
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


def checked_queries(x: np.ndarray, radius: np.ndarray | None, d: int) -> tuple[np.ndarray, np.ndarray]:
    x = np.asarray(x, dtype=float)
    if x.ndim != 2 or x.shape[1] != d:
        raise InputError(f"queries of shape {x.shape}", mend=f"one row of {d} values per sample")
    radius = np.zeros_like(x) if radius is None else np.asarray(radius, dtype=float)
    if radius.shape != x.shape:
        raise InputError(f"radii of shape {radius.shape} for queries of shape {x.shape}", mend="one radius per value")
    if not (np.isfinite(x).all() and np.isfinite(radius).all() and np.all(radius >= 0)):
        raise InputError("queries must be finite, their radii not negative", mend="leave out samples with missing values")
    return x, radius


def check_same_dimension(a: Region, b: Region) -> None:
    if len(a.low) != len(b.low):
        raise InputError(f"domains of {len(a.low)} and {len(b.low)} coordinates", mend="use the same regressors for both")
