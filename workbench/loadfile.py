"""The numeric columns of a file that is no text, as NPZ on standard output: python loadfile.py KIND FILE

Run in a process of its own: on a damaged file some readers end their process with a segmentation fault. The first array is JSON:
{"text": .., "notes": [..]} of a spreadsheet, or groups

    {"time": number of its array or null, "columns": [[name, unit, number of its array], ..], "left": [name, ..]}
"""

import csv
import datetime
import io
import json
import sys
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

#: Stamps [s] or None; name, unit and values of each column; names of what is left out.
Group = tuple[Any, list[tuple[str, str, Any]], list[str]]
TIMES = ("t", "time", "zeit", "elapsed", "elapsed time", "timestamp", "x_value")
TAGS = ("tag", "tagname", "tag name", "signal", "variable", "item", "channel")


def mat(path: str) -> list[Group]:
    """Real numeric variables, of versions up to 7 and of 7.3, which is HDF5."""
    with open(path, "rb") as stream:
        start = stream.read(520)
    if b"MATLAB 7.3" in start or b"\x89HDF" in start:
        import h5py

        with h5py.File(path) as file:  # columns are the first axis there
            found = {name: np.asarray(item).T for name, item in file.items() if isinstance(item, h5py.Dataset) and _numeric(item)}
    else:
        from scipy.io import loadmat

        found = {name: array for name, array in loadmat(path).items() if isinstance(array, np.ndarray) and _numeric(array)}
    return [(None, [(name, "", np.asarray(array, float)) for name, array in found.items() if not name.startswith("__")], [])]


def _numeric(array: Any) -> bool:
    text = getattr(array, "attrs", {}).get("MATLAB_class", b"") == b"char"
    return len(array.shape) == 2 and array.dtype.kind in "buif" and not text


def parquet(path: str) -> list[Group]:
    import pyarrow.parquet

    return [_of_table(pyarrow.parquet.read_table(path))]


def feather(path: str) -> list[Group]:
    import pyarrow.feather

    return [_of_table(pyarrow.feather.read_table(path))]


def _of_table(table: Any) -> Group:
    """Columns that are numbers; the first one of dates or durations is the time where none is called so."""
    from pyarrow import types

    stamps, columns, left = None, [], []
    named = any(
        _is_time(name) and not types.is_temporal(c.type) for name, c in zip(table.column_names, table.columns, strict=True)
    )
    for name, column in zip(table.column_names, table.columns, strict=True):
        kind = column.type
        if types.is_temporal(kind) and stamps is None and not named and (values := column.to_numpy()).dtype.kind in "mM":
            stamps = (values - values[0]) / np.timedelta64(1, "s") if len(values) else np.zeros(0)
        elif types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind) or types.is_decimal(kind):
            columns.append((name, "", np.asarray(column.cast("float64").to_numpy(), float)))
        elif name.lower() in TAGS and len(column.unique()) > 1 and any(n.lower() == "value" for n in table.column_names):
            raise LookupError(f"values of several {name} below each other; give each {name} a column of its own")
        else:
            left.append(name)
    return stamps, columns, left


def _is_time(name: str) -> bool:
    return name.split("[")[0].split("(")[0].strip().lower() in TIMES


def tdms(path: str) -> list[Group]:
    """A group for each group and rate of the file; a waveform's time is its own, unless the group has a column of time.

    Instants are counted from the first of the file. LookupError where only some groups say when they began, and for waveforms
    that are not over time.
    """
    import nptdms

    channels = [(group.name, channel) for group in nptdms.TdmsFile.read(path).groups() for channel in group.channels()]
    every = [(group, channel, np.asarray(channel[:])) for group, channel in channels if len(channel)]
    began = {id(channel): channel.properties["wf_start_time"] for _, channel, _ in every if "wf_start_time" in channel.properties}
    instants = [np.datetime64(value) for value in began.values()]
    instants += [values.min() for _, _, values in every if values.dtype.kind == "M"]
    origin = min(instants, default=None)
    clocks = {group for group, channel, values in every if values.dtype.kind == "M" or _is_time(channel.name)}
    found: dict[Any, Group] = {}
    for group, channel, values in every:
        step, offset = (float(channel.properties.get(key, 0.0)) for key in ("wf_increment", "wf_start_offset"))
        waves = step > 0.0 and group not in clocks
        if waves and channel.properties.get("wf_xunit_string", "s") not in ("", "s", "sec", "Seconds"):
            raise LookupError(f"{channel.name} is over {channel.properties['wf_xunit_string']}, not over time")
        if waves and began and id(channel) not in began:
            raise LookupError(f"{channel.name} does not say when it began, and other channels do")
        if waves and began:
            offset += (np.datetime64(began[id(channel)]) - origin) / np.timedelta64(1, "s")
        stamps = offset + step * np.arange(len(values)) if waves else None
        own = found.setdefault((group, step if waves else 0.0, offset if waves else 0.0, len(values)), (stamps, [], []))
        if values.dtype.kind == "M":
            own[1].append(("t", "s", (values - origin) / np.timedelta64(1, "s")))
        elif values.dtype.kind in "buif":
            own[1].append((channel.name, str(channel.properties.get("unit_string", "")), values))
        else:
            own[2].append(channel.name)
    return list(found.values())


def mdf(path: str) -> list[Group]:
    """A group for each channel group of the file, with its master channel as the time; samples marked as invalid are no numbers.

    LookupError where a master is an angle, a distance or an index.
    """
    import asammdf

    found: dict[int, Group] = {}
    with asammdf.MDF(path) as file:
        for signal in file.iter_channels():
            stamps, columns, left = found.setdefault(signal.group_index, (np.asarray(signal.timestamps, float), [], []))
            if signal.samples.dtype.kind not in "buif" or signal.samples.ndim != 1 or len(stamps) != len(signal.samples):
                left.append(signal.name)
                continue
            master, sync = signal.master_metadata or ("", 1)
            if sync not in (0, 1):
                raise LookupError(f"{signal.name} is over {master}, not over time")
            values = np.asarray(signal.samples, float)
            if signal.invalidation_bits is not None:
                values = np.where(np.asarray(signal.invalidation_bits, bool), np.nan, values)
            columns.append((signal.name, signal.unit or "", values))
    return list(found.values())


def excel(path: str) -> dict[str, Any]:
    """The one sheet with numbers as text, cells between semicolons. LookupError where there are several, or none."""
    import openpyxl

    book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    for sheet in book.worksheets:
        sheet.reset_dimensions()  # what a file says of its size may be wrong
    sheets = {sheet.title: [list(row) for row in sheet.iter_rows(values_only=True)] for sheet in book.worksheets}
    full = {title: rows for title, rows in sheets.items() if sum(_filled(row) for row in rows) > 2}
    if len(full) != 1:
        raise LookupError(f"sheets with numbers: {', '.join(full) or 'none'}; save the one that is meant in a file of its own")
    rows = next(iter(full.values()))
    used = [k for row in rows for k, cell in enumerate(row) if cell is not None]
    rows = [(row + [None] * (max(used) + 1))[: max(used) + 1] for row in rows]
    dates = [_are_days(column) for column in zip(*rows, strict=True)]
    room = io.StringIO()
    writer = csv.writer(room, delimiter=";", lineterminator="\n")
    for row in rows:
        if any(cell is not None for cell in row):
            writer.writerow([_cell(cell, days) for cell, days in zip(row, dates, strict=True)])
        else:
            room.write("\n")
    return {"text": room.getvalue(), "notes": [f"sheet {next(iter(full))}, the only one with numbers"] * (len(sheets) > 1)}


def _filled(row: Iterable[Any]) -> bool:
    return any(isinstance(cell, int | float) for cell in row)


def _are_days(column: Iterable[Any]) -> bool:
    """Whether all instants of a column are midnights: it holds dates, and times are elsewhere."""
    return all(cell.time() == datetime.time() for cell in column if isinstance(cell, datetime.datetime))


def _cell(cell: Any, days: bool) -> str:
    match cell:
        case None:
            return ""
        case datetime.datetime():
            return cell.date().isoformat() if days else cell.isoformat(sep=" ")
        case datetime.date() | datetime.time():
            return cell.isoformat()
        case datetime.timedelta():
            return repr(cell.total_seconds())
        case int() | float():
            return repr(float(cell))
        case _:
            return str(cell).replace("\n", " ")


KINDS: dict[str, Callable[[str], list[Group] | dict[str, Any]]] = {
    "mat": mat, "parquet": parquet, "feather": feather, "tdms": tdms, "mdf": mdf, "excel": excel
}  # fmt: skip


def main(kind: str, path: str) -> None:
    """Write the columns of a file, or raise what its reader raises."""
    found = KINDS[kind](path)
    arrays: list[np.ndarray] = []

    def place(array: Any) -> int:
        arrays.append(np.asarray(array, float))
        return len(arrays)

    head = found if isinstance(found, dict) else [
        {
            "time": None if t is None else place(t),
            "columns": [[name, unit, place(x)] for name, unit, x in columns],
            "left": left,
        }
        for t, columns, left in found
    ]  # fmt: skip
    room = io.BytesIO()
    np.savez(room, np.array(json.dumps(head)), *arrays)
    sys.stdout.buffer.write(room.getvalue())


if __name__ == "__main__":
    try:
        main(sys.argv[1], sys.argv[2])
    except ModuleNotFoundError as reason:
        sys.exit(f"needs {reason.name}")
    except LookupError as reason:
        sys.exit(str(reason) if type(reason) is LookupError else type(reason).__name__)
    except Exception as reason:
        sys.exit(type(reason).__name__)
