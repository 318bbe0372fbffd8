"""Validity domains in regressor space: hulls of boxes and single boxes, where a mode has been seen.

A hull of samples is not the true domain: outside means unknown, not invalid. A thousand samples in eight dimensions enclose
only about half of the next ones of the same regime, so ask for gauge <= 0.1, not 0.
"""

from functools import cached_property
from typing import Any

import numpy as np

from workbench.errors import InputError
from workbench.intervals.domains.boxes import FLAT, INSIDE, Boxes
from workbench.intervals.domains.facets import Facets, facets_of
from workbench.intervals.domains.region import Region, checked_queries
from workbench.records import field, record


@record
class Hull(Region):
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
        facets, corners = facets_of(points, np.where(span > FLAT * size, span, np.where(size > 0, size, 1.0)))
        if corners is not None and np.all(radii == radii[0]):
            points, radii = points[corners], radii[corners]
        for name, value in (("points", points), ("radii", radii)):
            value = np.ascontiguousarray(value)
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        object.__setattr__(self, "_inner", facets)

    @cached_property
    def boxes(self) -> Boxes:  # type: ignore[override]
        return Boxes(self.points - self.radii, self.points + self.radii)

    def gauge_of_boxes(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        value = self.outer_gauge_of_boxes(low, high)
        if len(self.low) == 1 or len(self.points) == 1:
            return np.where(value < INSIDE, 0.0, value)
        # a query whose centre lies in conv(points) needs no program
        for k in np.flatnonzero(~((value == 0) & (self._side((low + high) / 2) > 0))):
            value[k] = self._gap(low[k], high[k]).value
        return value

    def holds(self, x: np.ndarray) -> np.ndarray:
        """Which of the points x (Q, d) lie in the domain: gauge == 0, without a program but for those too close to a facet."""
        x = checked_queries(x, None, len(self.low))[0]
        held = self.outer_gauge_of_boxes(x, x) < INSIDE
        if np.all(self.radii == 0.0):
            side = self._side(x)
            doubtful = np.flatnonzero(held & (side == 0))
            held &= side > 0
        else:  # facets of the points alone: outside of them the radii decide
            doubtful = np.flatnonzero(held & (self._side(x) <= 0))
        held[doubtful] = self.gauge_of_boxes(x[doubtful], x[doubtful]) == 0.0
        return held

    def _side(self, x: np.ndarray) -> np.ndarray:
        facets: Facets | None = self._inner  # type: ignore[attr-defined]
        return np.zeros(len(x), dtype=int) if facets is None else facets.side(x)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers: {"points": [[...]], "radii": [[...]]}."""
        return {"points": self.points.tolist(), "radii": self.radii.tolist()}


@record
class Box(Region):
    """low <= x <= high, (d) each; also the interval of a schedule. Raises InputError where low > high or not finite."""

    low: np.ndarray = field("d")  # type: ignore[assignment]
    high: np.ndarray = field("d")  # type: ignore[assignment]

    def __post_init__(self):
        if not (np.isfinite(self.low).all() and np.isfinite(self.high).all() and np.all(self.low <= self.high)):
            raise InputError(f"a box from {self.low} to {self.high}", mend="low <= high, both finite")

    @cached_property
    def boxes(self) -> Boxes:  # type: ignore[override]
        return Boxes.one(self.low, self.high)

    def gauge_of_boxes(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        value = self.outer_gauge_of_boxes(low, high)
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
