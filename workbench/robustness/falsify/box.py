"""The box of a search: intervals of a plant's parameters and of its effects' numbers, and the machines within.

An interval is a tolerance of the plant, or what a diagnosis or calibration has fitted.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from workbench.errors import InputError, check_known
from workbench.files import read_json
from workbench.physics.plant import Plant
from workbench.records import field, record
from workbench.robustness.falsify.reading import finite_number

AMPLITUDE, PHASE = "amplitude", "phase"  # of an effect that has the sizes cosine and sine


@record
class Dimension:
    """A number that is only known to lie in [low, high]: a physical parameter or, where `effect` names one, a number of it.

    An effect with a phase has the numbers `amplitude` and `phase` [rad] besides its own: cosine = amplitude cos(phase), ...
    """

    name: str
    low: float = field("")
    high: float = field("")
    effect: str | None = None

    def __post_init__(self):
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low <= self.high):
            raise InputError(f"interval from {self.low:g} to {self.high:g}", file=str(self), mend="give low <= high, both finite")

    def __str__(self) -> str:
        return f"{self.effect}:{self.name}" if self.effect else self.name


def tolerance_box(plant: Plant, names: Sequence[str] | None = None) -> tuple[Dimension, ...]:
    """value (1 -+ tolerance) of the plant's parameters: of those named, else of all that have a tolerance."""
    known = {q.name: q for q in plant.parameters}
    chosen = [q.name for q in plant.parameters if q.tolerance > 0.0] if names is None else list(names)
    box = []
    for name in chosen:
        q = known[check_known("parameter", name, known, file=plant.name)]
        if q.tolerance == 0.0:
            raise InputError(f"parameter {name} has no tolerance", file=plant.name, mend="give its interval as a Dimension")
        if q.tolerance >= 1.0 and not q.signed:
            mend = "give its interval as a Dimension"
            raise InputError(f"a tolerance of {q.tolerance:.0%} reaches to 0", file=f"{plant.name}, {name}", mend=mend)
        low, high = sorted((q.value * (1.0 - q.tolerance), q.value * (1.0 + q.tolerance)))
        box.append(Dimension(name, low, high))
    return tuple(box)


def fitted_box(plant: Plant, path: str | Path) -> tuple[Dimension, ...]:
    """The 95 % intervals of a diagnosis.json or calibration.json: of recalibrated parameters, and of the numbers of causes.

    Within the bounds that the plant has for an effect's number. Raises InputError for other files, and names the plant lacks.
    """
    return fitted_box_of(plant, read_json(path), path)


def fitted_box_of(plant: Plant, content: Any, path: str | Path = "fitted intervals") -> tuple[Dimension, ...]:
    """The box of what such a file holds; path: the file, for messages."""
    if not isinstance(content, dict) or not ("causes" in content or "starts" in content):
        mend = "give the diagnosis.json or calibration.json beside it: a plant file holds values without intervals"
        raise InputError("holds no intervals", file=path, mend=mend)
    try:
        fitted = content["recalibrated"] if "causes" in content else content["parameters"]
        box = [_fitted(path, name, own, -np.inf, np.inf, None) for name, own in fitted.items()]
        bounds = {(slot.key, slot.parameter.name): slot.parameter for slot in plant.slots}
        for cause in content.get("causes", []):
            key = f"{cause['effect']}@{cause['at']}"
            check_known("effect", key, plant.effect_keys, file=path)
            phased = any(slot.key == key and slot.effect.phase for slot in plant.slots)
            for name, own in cause["parameters"].items():
                if phased and name == AMPLITUDE:  # where a run meets it nobody knows
                    box.append(_fitted(path, name, own, 0.0, bounds[key, "cosine"].high, key))
                    box.append(Dimension(PHASE, -math.pi, math.pi, key))
                    continue
                check_known(f"parameter of {key}", name, [n for k, n in bounds if k == key], file=path)
                box.append(_fitted(path, name, own, bounds[key, name].low, bounds[key, name].high, key))
    except (KeyError, TypeError, AttributeError) as reason:
        raise InputError(f"malformed: {reason!r}", file=path, mend="write the file again") from None
    for dimension in box:
        if dimension.effect is None:
            check_known("parameter", dimension.name, [q.name for q in plant.parameters], file=path)
    return tuple(box)


def _fitted(path: str | Path, name: str, own: Mapping[str, Any], low: float, high: float, effect: str | None) -> Dimension:
    bounds = [finite_number(path, f"{side} of {name}", own[side]) for side in ("low", "high")]
    return Dimension(name, *np.clip(bounds, low, high).tolist(), effect=effect)


def polar(own: Mapping[str, float]) -> dict[str, float]:
    """Numbers of an effect, amplitude and phase among them where it has them."""
    if "cosine" not in own:
        return dict(own)
    c, s = own["cosine"], own["sine"]
    return {**own, AMPLITUDE: math.hypot(c, s), PHASE: math.atan2(s, c)}


class ParameterBox:
    """Points z (R, n) of the unit cube as parameter vectors (R, np) and effect vectors (R, ne) of a plant."""

    def __init__(self, plant: Plant, dimensions: Sequence[Dimension]):
        given = [str(dimension) for dimension in dimensions]
        for name in given:
            if given.count(name) > 1:
                raise InputError(f"{name} is given twice", file=plant.name, mend="give each interval once")
        self.plant, self.dimensions = plant, [d for d in dimensions if d.high > d.low]
        self.fixed = [d for d in dimensions if d.high == d.low]
        self.low = np.array([d.low for d in self.dimensions])
        self.width = np.array([d.high - d.low for d in self.dimensions])
        p, eta = self.vectors(np.vstack([np.zeros(self.n), np.ones(self.n)]))  # both ends are refused here, if at all
        plant.check_parameters(p)
        plant.check_effects(eta)

    @property
    def n(self) -> int:
        return len(self.dimensions)

    @cached_property
    def nominal(self) -> np.ndarray:
        """The plant's own numbers (n), or what in the box is nearest to them."""
        p, eta = self.plant.nominal, self.plant.effect_vector()
        effects: dict[str, dict[str, float]] = {}
        for slot, value in zip(self.plant.slots, eta.tolist(), strict=True):
            effects.setdefault(slot.key, {})[slot.parameter.name] = value
        own = np.array([polar(effects[d.effect])[d.name] if d.effect else p[self._at(d)] for d in self.dimensions])
        return np.clip((own - self.low) / self.width, 0.0, 1.0) if self.n else own

    def vectors(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p = np.repeat(self.plant.nominal[None], len(z), axis=0)
        eta = np.repeat(self.plant.effect_vector()[None], len(z), axis=0)
        polar: dict[str, dict[str, np.ndarray]] = {}
        # the ends are met exactly, and never missed by a rounding error
        values = [np.clip(self.low[i] + z[:, i] * self.width[i], d.low, d.high) for i, d in enumerate(self.dimensions)]
        for d, value in zip(
            (*self.dimensions, *self.fixed), (*values, *(np.full(len(z), d.low) for d in self.fixed)), strict=True
        ):
            if d.effect and d.name in (AMPLITUDE, PHASE):
                polar.setdefault(d.effect, {})[d.name] = value
            else:
                (eta if d.effect else p)[:, self._at(d)] = value
        for effect, own in polar.items():
            c, s = (self._at(Dimension(name, 0.0, 0.0, effect)) for name in ("cosine", "sine"))
            amplitude = own.get(AMPLITUDE, np.hypot(eta[:, c], eta[:, s]))
            phase = own.get(PHASE, np.arctan2(eta[:, s], eta[:, c]))
            eta[:, c], eta[:, s] = amplitude * np.cos(phase), amplitude * np.sin(phase)
        return p, eta

    def _at(self, d: Dimension) -> int:
        if d.effect is None:
            names = [q.name for q in self.plant.parameters]
            return names.index(check_known("parameter", d.name, names, file=self.plant.name))
        check_known("effect", d.effect, self.plant.effect_keys, file=self.plant.name)
        own = {slot.parameter.name: i for i, slot in enumerate(self.plant.slots) if slot.key == d.effect}
        return own[check_known(f"parameter of {d.effect}", d.name, own, file=self.plant.name)]
