"""Whatever holds records, to one set of records: files, data frames, mappings of arrays.

data = read("a.csv", "b.csv", inputs=["V1", "V2"], outputs=["w3", "theta"], schedule="r2")
data = read({"t": t, "u [V]": u, "y [rad]": y}, inputs="u", outputs="y")
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from workbench.data import SAME_DT, Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.readers import TIME_NAMES, from_columns, name_and_unit, read_records, role_of

Names = str | Sequence[str]


def read(*sources: Any, inputs: Names = (), outputs: Names = (), schedule: Names = (), dt: float | None = None) -> Dataset:
    """Every source as one record of a set, with the roles of its channels.

    A source is the path of a file (see `read_records`), a mapping or a data frame that holds an array (N,) for each channel,
    named with its unit in brackets where it has one, or an `Experiment`; it is several records where its stamps have gaps. Time
    is a channel t [s], the frame's index of dates or durations, or k dt with the sample time dt [s] where there is neither.
    Roles come from the names or from the options, which win. Records are named by their files, two of one stem by their
    folders too; others are counted.

    Raises InputError with file, line, channel and mend for every fault of a source, for a file named twice, and for records that
    do not fit together.

        >>> read({"u [V]": [0, 1, 1], "y [rad]": [0, 0, 0.1]}, inputs="u", outputs="y", dt=0.01).experiments[0].names
        ('u', 'y')
    """
    paths = [Path(source) for source in sources if isinstance(source, str | Path)]
    names, made = _names(paths), []
    for number, source in enumerate(sources, 1):
        if isinstance(source, str | Path):
            own = read_records(source, names[Path(source)], dt)
        elif isinstance(source, Experiment):
            own = (source,)
        else:
            own = _from_arrays(f"record {number}", source, dt)
        if dt is not None and abs(own[0].dt - dt) > SAME_DT * dt:
            said = f"has its own time, a sample every {own[0].dt:g} s, and {dt:g} s was given"
            raise InputError(said, file=own[0].name, mend="leave dt out, and bring each record to it with .resample(dt)")
        made += [e.with_roles(inputs, outputs, schedule) for e in own]
    return Dataset(tuple(made))


def read_files(paths: Sequence[str], dt: float | None, **roles: Names) -> list[Dataset]:
    """Each file as `read` does; dt [s] is for those without time of their own, whatever that of the others is."""
    names = _names([Path(path) for path in paths])
    each = [read_records(path, names[Path(path)], dt) for path in paths]
    return [Dataset(tuple(e.with_roles(**roles) for e in own)) for own in each]


def _names(paths: Sequence[Path]) -> dict[Path, str]:
    """The stem of every path, with its folder where two share it. Raises InputError for a file that is named twice."""
    seen: set[Path] = set()
    for path in paths:
        if path.resolve() in seen:
            raise InputError("is named twice", file=path, mend="name each record once")
        seen.add(path.resolve())
    stems = [path.stem for path in paths]
    return {path: path.stem if stems.count(path.stem) == 1 else f"{path.parent.name}/{path.name}" for path in paths}


def _from_arrays(name: str, source: Any, dt: float | None) -> tuple[Experiment, ...]:
    """A mapping or a data frame as a record, or as several where its stamps have gaps."""
    if isinstance(source, Mapping):
        columns = {str(key): source[key] for key in source}
    elif hasattr(source, "columns"):
        columns = {str(key): source[key].to_numpy() for key in source.columns}
    else:
        mend = "give the path of a file, a data frame, or a mapping of arrays such as {'u [V]': u, 'y [rad]': y}"
        raise InputError(f"a {type(source).__name__} is no source of a record", file=name, mend=mend)
    channels = _channels(name, columns)
    stamps = _stamps(name, source, channels)
    lengths = {c.name: len(values) for c, values in channels.items()}
    if not channels:
        raise InputError("no channels", file=name, mend="give at least one array beside the time")
    if (stamps is None) == (dt is None):
        said = "neither a time column nor a sample time" if dt is None else "its own time, and a sample time was given"
        raise InputError(f"has {said}", file=name, mend="give a column t [s], or dt in seconds, and not both")
    t = float(dt) * np.arange(max(lengths.values())) if stamps is None and dt is not None else np.asarray(stamps)
    for channel, length in lengths.items():
        if length != len(t):
            raise InputError(f"{length} samples, expected {len(t)}", file=name, channel=channel, mend="give arrays of one length")
    return from_columns(name, t, list(channels.items()))


def _channels(name: str, columns: Mapping[str, Any]) -> dict[Channel, np.ndarray]:
    """Columns by their channels, which are told from names such as "w3 [rad/s]"."""
    found: dict[Channel, np.ndarray] = {}
    for cell, values in columns.items():
        channel, unit = name_and_unit(cell)
        if not channel:
            mend = "write name [unit], the unit in brackets or left out"
            raise InputError(f"{cell!r} is no channel name", file=name, mend=mend)
        if channel in (c.name for c in found):
            raise InputError("appears twice", file=name, channel=channel, mend="give each column its own name")
        found[Channel(channel, unit, role_of(channel))] = _numbers(name, channel, values)
    return found


def _stamps(name: str, source: Any, channels: dict[Channel, np.ndarray]) -> np.ndarray | None:
    """The column of time, taken out of `channels`, or the index of a frame; None where there is neither."""
    clocks = [c for c in channels if c.name in TIME_NAMES]
    if not clocks:
        return _index(source)
    if len(clocks) > 1:
        raise InputError(f"two time columns, {' and '.join(c.name for c in clocks)}", file=name, mend="keep one")
    (clock,) = clocks
    if clock.unit not in ("", "s"):
        mend = f"give the column in seconds, as {clock.name} [s]"
        raise InputError(f"time is in {clock.unit}, expected s", file=name, channel=clock.name, mend=mend)
    return channels.pop(clock)


def _numbers(name: str, channel: str, values: Any) -> np.ndarray:
    """Values (N,) as real numbers."""
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(
            "holds something that is no number", file=name, channel=channel, mend="give one number a sample"
        ) from None
    if array.ndim != 1:
        raise InputError(f"shape {array.shape}, expected (N,)", file=name, channel=channel, mend="give one number a sample")
    return array


def _index(frame: Any) -> np.ndarray | None:
    """Seconds (N,) since its first entry of a frame's index, where it holds dates or durations."""
    index = np.asarray(getattr(frame, "index", ()))
    return (index - index[0]) / np.timedelta64(1, "s") if index.dtype.kind in "mM" and len(index) else None
