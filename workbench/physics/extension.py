"""What was found out about a plant, kept apart from its equation: parameters and effects, and the file that holds them.

A plant file is JSON with plain numbers, readable without this package. It names the plant that it extends and holds no code: a
machine of the workbench is found by its name, a user's own plant must be given again beside the file.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from workbench.errors import InputError
from workbench.files import read_json, write_json
from workbench.physics.parameters import EffectSizes
from workbench.physics.plant import Plant
from workbench.records import field, record

SCHEMA, VERSION = "gain-scheduling-workbench/plant", 1


@record
class Extension:
    """Parameters and effects of the plant called `plant`, which `base` says where to find, and where the numbers come from.

    between: what inputs of a record do between their samples, see `Plant`.
    """

    plant: str
    base: str
    parameters: Mapping[str, float]
    effects: EffectSizes = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    between: Mapping[str, str] = field(default_factory=dict)

    def of(self, plant: Plant, *, file: object = None) -> Plant:
        """The plant with these numbers as its new normal: whatever runs it runs with them, and effects may be added on top.

        Raises InputError where it is another plant, and for names and numbers that do not fit it.
        """
        if plant.name != self.plant:
            raise InputError(f"extends plant {self.plant!r}, not {plant.name!r}", file=file, mend=f"give {self.base} instead")
        extended = replace(plant.with_courses(self.between), effects=_together(plant.effects, self.effects))
        extended.effect_vector()  # refuses what does not fit
        return extended.with_parameters(self.parameters)  # last: what it traces is what is handed out

    def save(self, path: str | Path) -> Path:
        """Write the plant file (schema and version inside)."""
        content = {"schema": SCHEMA, "version": VERSION, "plant": self.plant, "base": self.base}
        numbers = {"parameters": self.parameters, "effects": self.effects}
        between = {"between": dict(self.between)} if self.between else {}
        return write_json(path, content | numbers | between | {"provenance": self.provenance})


def extension(
    plant: Plant,
    base: str,
    parameters: Mapping[str, float],
    effects: EffectSizes | None = None,
    provenance: Mapping | None = None,
) -> Extension:
    """`plant` with fitted parameters and effects beside those it already has; every parameter is named, fitted or not.

    What its inputs do between samples is kept too.
    """
    values = dict(zip((q.name for q in plant.parameters), plant.parameter_vector(parameters).tolist(), strict=True))
    return Extension(plant.name, base, values, _together(plant.effects, effects or {}), provenance or {}, dict(plant.between))


def load_extension(path: str | Path) -> Extension:
    """Read a plant file written by `Extension.save`. Raises InputError naming what is missing, foreign or not a number."""
    content = read_json(path)
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise InputError("not a plant file", file=path, mend=f"expected a JSON object with schema {SCHEMA!r}")
    if content.get("version") != VERSION:
        raise InputError(f"plant file version {content.get('version')}, this program reads {VERSION}", file=path)
    for name, kind in (("plant", str), ("base", str), ("parameters", dict), ("effects", dict)):
        if not isinstance(content.get(name), kind):
            raise InputError(f"field {name!r} is missing or no {kind.__name__}", file=path, mend="write the plant file again")
    effects = {key: _numbers(path, key, numbers) for key, numbers in content["effects"].items()}
    parameters = _numbers(path, "parameters", content["parameters"])
    between = content.get("between", {})
    if not isinstance(between, dict):
        raise InputError("field 'between' is no dict", file=path, mend='{"F": "linear"}, or leave it out')
    return Extension(content["plant"], content["base"], parameters, effects, content.get("provenance", {}), between)


def _numbers(path: str | Path, place: str, content: Any) -> dict[str, float]:
    if not isinstance(content, dict):
        raise InputError(f"{place}: expected numbers by name", file=path, mend="write the plant file again")
    for name, value in content.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise InputError(f"{place}: {name} = {value!r} is not a finite number", file=path, mend="give a number")
    return {name: float(value) for name, value in content.items()}


def _together(first: EffectSizes, second: EffectSizes) -> dict[str, dict[str, float]]:
    """The numbers of both; where both name one, the second counts."""
    return {key: {**first.get(key, {}), **second.get(key, {})} for key in {**first, **second}}
