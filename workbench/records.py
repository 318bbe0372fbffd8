"""Frozen records: a field declares its shape, unit and bounds once, and one check serves them all.

    @record
    class Line:
        gain: np.ndarray = field("N nu", unit="V/rad", low=0.0)
        offset: np.ndarray = field("nu")

Every name in a shape ("N", "nu") stands for one number throughout a record: two fields that disagree are refused with
the place, the shape found and the shape expected. Arrays become read-only float64 copies.
"""

import dataclasses
import math
from typing import Any, dataclass_transform

import numpy as np


class RecordError(ValueError):
    """A field of a record has the wrong shape, unit range or content."""


def field(shape: str | None = None, *, unit: str = "", low: float = -math.inf, high: float = math.inf, **options) -> Any:
    """Declare a field: `shape` is sizes or names ("N 2"), "" a scalar, None anything; bounds are inclusive.

    "N ...": any axes may follow.
    """
    return dataclasses.field(metadata={"shape": shape, "unit": unit, "low": low, "high": high}, **options)


@dataclass_transform(frozen_default=True, field_specifiers=(field, dataclasses.field))
def record(cls: type) -> Any:
    """Make `cls` a frozen dataclass whose declared fields are checked when it is made."""
    own = cls.__dict__.get("__post_init__")

    def check(self):
        sizes: dict[str, tuple[int, str]] = {}
        for f in dataclasses.fields(self):
            if f.metadata.get("shape") is not None:
                value = _checked(cls.__name__, f, getattr(self, f.name), sizes)
                object.__setattr__(self, f.name, value)
        if own:
            own(self)

    cls.__post_init__ = check
    return dataclasses.dataclass(frozen=True, eq=False)(cls)


def _settled(value: Any) -> bool:
    """Whether a value is an array that nobody can change any more: records hand such ones on without a copy."""
    if not isinstance(value, np.ndarray) or type(value) is not np.ndarray or value.dtype != float:
        return False
    owner = value if value.base is None else value.base
    return isinstance(owner, np.ndarray) and not (value.flags.writeable or owner.flags.writeable)


def _checked(owner: str, f: dataclasses.Field, value: Any, sizes: dict[str, tuple[int, str]]) -> Any:
    place = f"{owner}.{f.name}"
    names = f.metadata["shape"].split()
    try:
        array = value if _settled(value) else np.array(value, dtype=float)
    except (TypeError, ValueError) as reason:
        raise RecordError(f"{place}: not numbers ({reason}); expected shape ({', '.join(names)})") from None
    if names[-1:] == ["..."]:
        names = names[:-1] + [str(size) for size in array.shape[len(names) - 1 :]]
    if array.ndim != len(names):
        raise RecordError(f"{place}: shape {array.shape}, expected ({', '.join(names)})")
    for size, name in zip(array.shape, names, strict=True):
        expected, source = sizes.setdefault(name, (int(name), place) if name.isdigit() else (size, place))
        if size != expected:
            raise RecordError(f"{place}: shape {array.shape}, expected {name} = {expected} as in {source}")
    low, high = f.metadata["low"], f.metadata["high"]
    # NaN compares false with everything, so the test is written to fail on it
    if not np.all((array >= low) & (array <= high)):
        bad = array[~((array >= low) & (array <= high))].flat[0]
        unit = f" {f.metadata['unit']}" * bool(f.metadata["unit"])
        if math.isnan(bad):
            raise RecordError(f"{place}: a hole (not a number) at {np.argwhere(np.isnan(array))[0].tolist()}")
        raise RecordError(f"{place}: {bad:g}{unit} is outside [{low:g}, {high:g}]")
    if not names:
        return float(array)
    array.setflags(write=False)
    return array
