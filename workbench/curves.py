"""Static curves of actuators: what arrives at a machine, v = f(u), straight lines between nodes."""

from collections.abc import Iterable
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import isotonic_regression

from workbench.errors import InputError
from workbench.records import field, record

FLATTEST = 0.05  # slope of an inverted curve anywhere, at least, as a share of its mean slope
OFF = 0.02  # of the range of v, by which an inverted curve may differ from the one that was found


@record
class Curve:
    """v = f(u) of one input: straight lines between nodes (u, v), and on along the first and the last one.

    v is in the unit of u, with the mean and the standard deviation of u in the estimation records: the gain is the model's.

        >>> Curve("valve", [0.0, 1.0, 2.0], [0.0, 0.5, 2.0])(np.array([0.5, 1.5, 3.0]))
        array([0.25, 1.25, 3.5 ])
    """

    input: str
    u: np.ndarray = field("n")
    v: np.ndarray = field("n")

    def __post_init__(self):
        if len(self.u) < 2 or np.any(np.diff(self.u) <= 0.0):
            raise InputError("nodes of a curve", channel=self.input, mend="give at least two, from the lowest u to the highest")

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """f(u) of any shape."""
        i = self._segment(u)
        return self.v[i] + self.slopes[i] * (u - self.u[i])

    def slope(self, u: np.ndarray) -> np.ndarray:
        """df/du; at a node that of the line after it."""
        return self.slopes[self._segment(u)]

    @cached_property
    def slopes(self) -> np.ndarray:
        """Slope of each line, (n - 1,)."""
        return np.diff(self.v) / np.diff(self.u)

    @property
    def rising(self) -> bool:
        """Whether it rises everywhere: then every v has one u."""
        return bool(np.all(self.slopes > 0.0))

    def check_rising(self) -> None:
        """Refuse a curve that does not rise everywhere."""
        if not self.rising:
            mend = "take the nearest curve that rises: invertible"
            raise InputError("the curve does not rise everywhere: some v have several u, or none", channel=self.input, mend=mend)

    @cached_property
    def back(self) -> "Curve":
        """The curve from v to u. Raises InputError for one that does not rise everywhere."""
        self.check_rising()
        return Curve(self.input, self.v, self.u)

    def inverse(self, v: np.ndarray) -> np.ndarray:
        """The u with f(u) = v. Raises InputError for a curve that does not rise everywhere."""
        return self.back(v)

    def nearest(self, v: float) -> float:
        """A u whose f(u) is nearest to v, between the first and the last node; the lowest of several."""
        reached = np.clip(v, np.minimum(self.v[:-1], self.v[1:]), np.maximum(self.v[:-1], self.v[1:]))  # by each line
        i = int(np.abs(reached - v).argmin())
        rise = self.v[i + 1] - self.v[i]
        return float(self.u[i] + ((reached[i] - self.v[i]) / rise if rise else 0.0) * (self.u[i + 1] - self.u[i]))

    @property
    def flattest(self) -> float:
        """The slope that its inverse takes at least: FLATTEST of the mean one."""
        return float(FLATTEST * (self.v[-1] - self.v[0]) / (self.u[-1] - self.u[0]))

    @property
    def invertible(self) -> "Curve":
        """min sum_i (w_i - v_i)^2 over curves (u, w) whose slope is FLATTEST of the mean one at least: itself where it is.

        Where a dead zone was, the inverse is steep. Raises InputError where that is another curve, more than OFF of the range of
        v away.

            >>> Curve("valve", [-2.0, -1.0, 1.0, 2.0], [-1.0, 0.0, 0.0, 1.0]).invertible.slopes
            array([0.975, 0.025, 0.975])
        """
        rise = self.flattest
        if rise > 0.0 and np.all(self.slopes >= rise):
            return self
        near = isotonic_regression(self.v - rise * self.u).x + rise * self.u if rise > 0.0 else np.full(len(self.u), np.inf)
        if np.abs(near - self.v).max() > OFF * np.ptp(self.v):
            falls = self.u[:-1][self.slopes <= max(rise, 0.0)]
            said = f"f(u) turns back or stands still from {falls[0]:.4g} on: no u gives every v, and the inverse is another curve"
            raise InputError(said, channel=self.input, mend="keep the commands where it rises, or control without an inverse")
        return Curve(self.input, self.u, near)

    @cached_property
    def bends(self) -> np.ndarray:
        """u and v of the first node, the slope after it, then u and change of slope of each one between: what `bent` takes."""
        inner = np.column_stack([self.u[1:-1], np.diff(self.slopes)]).ravel()
        return np.concatenate([[self.u[0], self.v[0], self.slopes[0]], inner])

    def to_dict(self) -> dict[str, Any]:
        """Its input and nodes as plain values."""
        return {"input": self.input, "u": self.u, "v": self.v}

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> "Curve":
        """The curve that `to_dict` wrote."""
        return cls(content["input"], content["u"], content["v"])

    def _segment(self, u: np.ndarray) -> np.ndarray:
        return np.clip(np.searchsorted(self.u, u, side="right") - 1, 0, len(self.u) - 2)


def check_single(inputs: Iterable[str], file: str, what: str = "curves") -> None:
    """Refuse several curves of one input."""
    seen = []
    for name in inputs:
        if name in seen:
            raise InputError(f"two {what} of one input", file=file, channel=name, mend="give it one")
        seen.append(name)


def bent(u: Any, bends: Any) -> Any:
    """f(u) by the `bends` of a curve, on numbers, arrays or symbols."""
    v = bends[1] + bends[2] * (u - bends[0])
    for node, change in zip(bends[3::2], bends[4::2], strict=True):
        v = v + change * np.maximum(u - node, 0.0)
    return v
