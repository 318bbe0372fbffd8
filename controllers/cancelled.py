"""What a law adds to its commands to cancel an effect that a diagnosis has named: curves over the set-points, inverses.

An inverse stands between the linear command v and the command u:

    u = v + w s + (p s / 2 - g) / dt,     s: the sign of v, which changes once |v| > keep on the other side

w: half width of a dead zone, which takes it off again. p: play of a gear, the impulse that is lost from one flank of the teeth to
the other; g: where the teeth stand, as the impulse that brought them there, g+ = min(max(g + (u - w s) dt, -p / 2), p / 2).

Source: Tao and Kokotovic, "Adaptive Control of Systems with Actuator and Sensor Nonlinearities", Wiley 1996, chapters 2 and 3.
"""

from typing import Any

import numpy as np

from workbench.curves import Curve
from workbench.records import field, record

FAR = 1e300  # no limit at all, in numbers


@record
class Compensation:
    """g(s), added to the command of `input`, s = position m + motion m': what cancels an effect that acts by a curve over s.

    effect: what it cancels, such as coulomb@slide. position (ny), motion (ny) [s]: s from the set-points and their rates. over:
    s in words with its unit, such as v [m/s]. curve: g over s, in the unit of the command.

        >>> friction = Compensation("F", "coulomb@slide", [0.0], [1.0], Curve("F", [-0.01, 0.01], [-20.0, 20.0]), "v [m/s]")
    """

    input: str
    effect: str
    position: np.ndarray = field("ny", low=-FAR, high=FAR)
    motion: np.ndarray = field("ny", unit="s", low=-FAR, high=FAR)
    curve: Curve
    over: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Its weights and the nodes of its curve as plain values."""
        return vars(self) | {"curve": self.curve.to_dict()}

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> "Compensation":
        """The compensation that `to_dict` wrote."""
        curve, own = Curve.from_dict(content["curve"]), content
        return cls(own["input"], own["effect"], own["position"], own["motion"], curve, own["over"])


@record
class Inverse:
    """u of a v, where the actuator of `input` has a dead zone or play: see the module. keep: |v| up to which the side stays.

    >>> zone = Inverse("F", "dead-zone@F", half_width=12.0, keep=0.5)  # v = 3 N is commanded as 15 N
    """

    input: str
    effect: str
    half_width: float = field("", low=0.0, high=FAR, default=0.0)
    play: float = field("", low=0.0, high=FAR, default=0.0)
    keep: float = field("", low=0.0, high=FAR, default=0.0)

    @property
    def numbers(self) -> np.ndarray:
        """Half width, play, keep."""
        return np.array([self.half_width, self.play, self.keep])
