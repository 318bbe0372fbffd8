"""Checked values of a JSON file: numbers, mappings of numbers and series, or an InputError that names the place."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from workbench.errors import InputError

AGAIN = "search again"


def expect(path: str | Path, name: str, value: Any, kind: type) -> None:
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise InputError(f"field {name!r} is missing or no {kind.__name__}", file=path, mend=AGAIN)


def finite_number(path: str | Path, place: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{place}: {value!r} is not a finite number", file=path, mend=AGAIN)
    return float(value)


def finite_numbers(path: str | Path, place: str, content: Any) -> dict[str, float]:
    expect(path, place, content, dict)
    return {name: finite_number(path, f"{place}, {name}", value) for name, value in content.items()}


def finite_series(path: str | Path, content: Mapping[str, Any]) -> dict[str, np.ndarray]:
    for name, values in content.items():
        expect(path, name, values, list)
    return {name: np.array([finite_number(path, name, value) for value in values]) for name, values in content.items()}
