"""The numeric columns of a file that is no text, as NPZ on standard output: python loadfile.py KIND FILE

Run in a process of its own: on a damaged file some readers end their process with a segmentation fault. The first array is JSON:
the text of a spreadsheet, or groups {"time": number of its array or null, "columns": [[name, unit, number of its array], ..]}.
"""

import csv
import io
import json
import sys
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

Group = tuple[Any, list[tuple[str, str, Any]]]  # stamps [s] or None, and name, unit, values of each column


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
    return [(None, [(name, "", np.asarray(array, float)) for name, array in found.items() if not name.startswith("__")])]


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
    """Columns that are numbers; the first one of dates or durations is the time."""
    import pyarrow

    stamps, columns = None, []
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pyarrow.types.is_temporal(column.type):
            if stamps is None and (values := column.to_numpy()).dtype.kind in "mM":
                stamps = (values - values[0]) / np.timedelta64(1, "s")
        elif pyarrow.types.is_integer(column.type) or pyarrow.types.is_floating(column.type):
            columns.append((name, "", np.asarray(column.to_numpy(), float)))
    return stamps, columns


def tdms(path: str) -> list[Group]:
    """A group for each group and rate of the file; a channel's time is its waveform's."""
    import nptdms

    found: dict[tuple[str, float, float, int], Group] = {}
    for group in nptdms.TdmsFile.read(path).groups():
        for channel in group.channels():
            values = np.asarray(channel[:])
            if values.dtype.kind in "mM" and len(values):
                values = (values - values[0]) / np.timedelta64(1, "s")
                name = "t"
            elif values.dtype.kind in "buif" and len(values):
                name = channel.name
            else:
                continue
            step, offset = (float(channel.properties.get(key, 0.0)) for key in ("wf_increment", "wf_start_offset"))
            key = (group.name, step, offset, len(values))
            stamps = offset + step * np.arange(len(values)) if step > 0.0 else None
            found.setdefault(key, (stamps, []))[1].append((name, str(channel.properties.get("unit_string", "")), values))
    return list(found.values())


def mdf(path: str) -> list[Group]:
    """A group for each channel group of the file, with its master channel as the time."""
    import asammdf

    found: dict[int, Group] = {}
    with asammdf.MDF(path) as file:
        for signal in file.iter_channels():
            if signal.samples.dtype.kind in "buif" and signal.samples.ndim == 1 and len(signal.samples):
                stamps, columns = found.setdefault(signal.group_index, (np.asarray(signal.timestamps, float), []))
                if len(stamps) == len(signal.samples):
                    columns.append((signal.name, signal.unit or "", signal.samples))
    return list(found.values())


def excel(path: str) -> str:
    """The one sheet with numbers as text, cells between semicolons. LookupError where there are several, or none."""
    import openpyxl

    book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    sheets = {sheet.title: [list(row) for row in sheet.iter_rows(values_only=True)] for sheet in book.worksheets}
    full = {title: rows for title, rows in sheets.items() if sum(_filled(row) for row in rows) > 2}
    if len(full) != 1:
        raise LookupError(f"sheets with numbers: {', '.join(full) or 'none'}; save the one that is meant in a file of its own")
    room = io.StringIO()
    rows = next(iter(full.values()))
    width = max((k + 1 for row in rows for k, cell in enumerate(row) if cell is not None), default=0)
    csv.writer(room, delimiter=";", lineterminator="\n").writerows([_cell(cell) for cell in row[:width]] for row in rows)
    return room.getvalue()


def _filled(row: Iterable[Any]) -> bool:
    return any(isinstance(cell, int | float) for cell in row)


def _cell(cell: Any) -> str:
    if cell is None:
        return ""
    if hasattr(cell, "isoformat"):
        return cell.isoformat(sep=" ") if hasattr(cell, "date") else cell.isoformat()
    return repr(float(cell)) if isinstance(cell, int | float) else str(cell).replace("\n", " ")


KINDS: dict[str, Callable[[str], list[Group] | str]] = {
    "mat": mat, "parquet": parquet, "feather": feather, "tdms": tdms, "mdf": mdf, "excel": excel
}  # fmt: skip


def main(kind: str, path: str) -> None:
    """Write the columns of a file, or raise what its reader raises."""
    found = KINDS[kind](path)
    arrays: list[np.ndarray] = []

    def place(array: Any) -> int:
        arrays.append(np.asarray(array, float))
        return len(arrays)

    head = found if isinstance(found, str) else [
        {"time": None if t is None else place(t), "columns": [[name, unit, place(x)] for name, unit, x in columns]}
        for t, columns in found
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
