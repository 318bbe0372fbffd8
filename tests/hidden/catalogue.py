"""What can be hidden, where, in which unit, and how large at most: names and units of the catalogue, nothing of its laws."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from workbench.records import field, record

#: Effect -> (the parameter that is its size, unit where shafts turn). "amplitude" is sqrt(cosine^2 + sine^2).
SIZE = {
    "coulomb": ("level", "N m"),
    "stribeck": ("level", "N m"),
    "asymmetric-friction": ("forward", "N m"),
    "quadratic-friction": ("coefficient", "N m s^2/rad^2"),
    "load-friction": ("coefficient", "1"),
    "imbalance": ("amplitude", "N m"),
    "torque-ripple": ("amplitude", "N m"),
    "friction-jump": ("level", "N m"),
    "eccentricity": ("amplitude", "m"),
    "offset": ("level", "unit of the input"),
    "dead-zone": ("half_width", "unit of the input"),
    "saturation": ("limit", "unit of the input"),
    "input-delay": ("time", "s"),
    "heating": ("fall", "1"),
    "gear-backlash": ("play", "unit of the input s"),
    "sensor-lag": ("time", "s"),
    "sensor-resonance": ("time", "s"),
    "sensor-bias": ("level", "unit of the output"),
    "sensor-gain": ("error", "1"),
    "sensor-nonlinearity": ("curvature", "1/(unit of the output)"),
    "quantisation": ("step", "unit of the output"),
    "backlash": ("half_width", "unit of the output"),
    "slip": ("creep", "m/s/N"),
    "nonlinear-elasticity": ("change", "1"),
    "viscoelastic": ("share", "1"),
    "periodic-tension": ("amplitude", "N/s"),
    "stiffness-jump": ("change", "1"),
    "air-entrainment": ("share", "1"),
    "arm-gravity": ("amplitude", "N"),
    "rail-tilt": ("level", "N"),
    "platform-mass": ("swing", "1"),
    "arm-reaction": ("coefficient", "N s/rad"),
}

#: Sizes that may have either sign.
SIGNED = {
    "offset", "sensor-bias", "sensor-gain", "sensor-nonlinearity", "nonlinear-elasticity", "stiffness-jump", "rail-tilt",
    "platform-mass", "arm-reaction",
}  # fmt: skip

SHAFT = (
    "coulomb", "stribeck", "asymmetric-friction", "quadratic-friction", "load-friction", "imbalance", "torque-ripple",
    "friction-jump",
)  # fmt: skip
SLIDE = tuple(effect for effect in SHAFT if effect != "load-friction")
ACTUATOR = ("offset", "dead-zone", "saturation", "input-delay", "heating", "gear-backlash")
SENSOR = (
    "sensor-lag", "sensor-resonance", "sensor-bias", "sensor-gain", "sensor-nonlinearity", "quantisation", "backlash",
)  # fmt: skip
SPAN = ("nonlinear-elasticity", "viscoelastic", "periodic-tension", "stiffness-jump")
ROBOT = ("arm-gravity", "rail-tilt", "platform-mass", "arm-reaction")


@record
class Hidden:
    """One piece of physics that a record holds and a nominal model does not.

    parameters: sizes and shapes by the catalogue's names, in `unit` and SI. size: the one that SIZE names. multiple: of its
    detection limit; of a saturation, by how much it clips the largest command. catalogued False: outside the catalogue, with
    a limit of our own (see case.py).
    """

    effect: str
    place: str
    parameters: Mapping[str, float]
    multiple: float = field("", low=0.0)
    catalogued: bool = True

    @property
    def key(self) -> str:
        return f"{self.effect}@{self.place}"

    @property
    def size(self) -> float:
        return self.parameters[SIZE[self.effect][0] if self.catalogued else "size"]

    @property
    def unit(self) -> str:
        return SIZE[self.effect][1] if self.catalogued else ""


class Ranges(NamedTuple):
    """Where shapes are drawn on one machine: what a length of record, a speed and a tooth mean there."""

    duration: float  # s
    radian: float  # 1 where shafts turn, m/rad where bodies slide
    orders: int  # highest order of a ripple
    least: int = 2  # lowest order of a ripple
    fading: tuple[float, float] = (3.0, 30.0)  # rad/s, at which friction of low speed is gone


def shapes(effect: str, ranges: Ranges, size: float, random: np.random.Generator) -> dict[str, float]:
    """The other parameters of an effect, drawn; the same number of draws for each, so that a seed keeps its meaning."""
    where, angle, order = random.random(), random.uniform(0.0, 2 * np.pi), random.integers(ranges.least, ranges.orders + 1)

    def between(low: float, high: float) -> float:
        return float(low * (high / low) ** where)

    match effect:
        case "stribeck":
            return {"speed": between(*ranges.fading) * ranges.radian}
        case "asymmetric-friction":
            return {"backward": 0.0 if ranges.radian == 1.0 else 0.4 * where * size}
        case "torque-ripple":
            return {"order": float(order)}
        case "friction-jump" | "stiffness-jump":
            return {"time": (0.3 + 0.4 * where) * ranges.duration}
        case "heating":
            return {"time": between(0.15, 0.6) * ranges.duration}
        case "sensor-resonance":
            return {"damping": between(0.1, 0.5)}
        case "viscoelastic":
            return {"time": between(0.1, 5.0)}
        case "periodic-tension":
            return {"frequency": between(0.3, 5.0)}
        case "arm-gravity":
            return {"sine": size * float(np.cos(angle)), "cosine": size * float(np.sin(angle))}
        case "platform-mass":
            return {"period": between(4.0, 15.0)}
    return {}


def fields_of(part: type, hidden: tuple[Hidden, ...], place: str, phases: np.random.Generator) -> dict[str, float]:
    """Field values of a part (Shaft, Drive, ...) at `place`: sizes, shapes, and a phase of its own for all that turns."""
    values = {name: phases.uniform(0.0, 2 * np.pi) for name in part._fields if name.endswith("_phase")}
    for h in hidden:
        base = h.effect.replace("-", "_")
        for name, value in h.parameters.items():
            own = base if h.catalogued and name == SIZE[h.effect][0] else f"{base}_{name}"
            if h.catalogued and h.place == place and own in part._fields:
                values[own] = float(value)
    return values


def foreign_fields(part: type, hidden: tuple[Hidden, ...]) -> dict[str, float]:
    """Field values of a machine's foreign physics."""
    return {h.effect.replace("-", "_"): float(h.size) for h in hidden if not h.catalogued}
