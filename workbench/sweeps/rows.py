"""The rows of a sweep read back, and written as CSV or Parquet."""

import io
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from workbench.errors import InputError
from workbench.files import write_bytes, write_text
from workbench.records import record
from workbench.sweeps.database import connected


@record
class Rows:
    """What a sweep's file holds, in the order of the runs: names, units and rows; `error` is the last of each row."""

    names: tuple[str, ...]
    units: Mapping[str, str]
    parameters: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    def column(self, name: str) -> np.ndarray:
        """The numbers of a column, NaN where there are none."""
        i = self.names.index(name)
        return np.array([v if isinstance(v := row[i], int | float) else np.nan for row in self.rows], dtype=float)


def read_rows(database: str | Path) -> Rows:
    """Every row that is there, also while the sweep goes on: names, units, and columns (runs,) of numbers.

    Raises InputError for a file that holds no sweep.

        >>> done = run_sweep(load_sweep("sweep.toml"), TimeConstant(), "rows.sqlite")
        >>> read_rows("rows.sqlite").column("time constant").round(3)
        array([0.067, 0.133, 0.267])
    """
    if not Path(database).is_file():
        raise InputError("no such file", file=database, mend="check the path")
    with closing(connected(Path(database))) as connection:
        try:
            columns = list(connection.execute("SELECT name, kind, unit FROM columns"))
            cursor = connection.execute("SELECT * FROM runs ORDER BY run")
        except sqlite3.Error:
            raise InputError("holds no sweep", file=database, mend="give the file that a sweep has written") from None
        names = tuple(own[0] for own in cursor.description)
        units = {name: unit for name, _, unit in columns}
        return Rows(names, units, tuple(name for name, sort, _ in columns if sort == "parameter"), tuple(cursor.fetchall()))


def export_csv(database: str | Path, path: str | Path) -> Path:
    """The rows as CSV, a unit in brackets behind each name; what is no number is left empty."""
    import csv
    import io

    found, text = read_rows(database), io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([f"{name} [{unit}]" if (unit := found.units.get(name)) else name for name in found.names])
    writer.writerows(["" if v is None else repr(v) if isinstance(v, float) else v for v in row] for row in found.rows)
    return write_text(path, text.getvalue())


def require_parquet() -> Any:
    """pyarrow, which writes Parquet. Raises InputError where it is not installed."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        mend = 'python -m pip install "gain-scheduling-workbench[parquet]", or use sweep.csv'
        raise InputError("pyarrow is not installed", file="--parquet", mend=mend) from None
    return pyarrow


def export_parquet(database: str | Path, path: str | Path) -> Path:
    """The rows as Parquet: types are kept, units are metadata of the columns."""
    arrow: Any = require_parquet()
    found = read_rows(database)
    columns, fields = [], []
    for i, name in enumerate(found.names):
        values = [row[i] for row in found.rows]
        mixed = len({isinstance(v, str) for v in values if v is not None}) > 1
        column = arrow.array([None if v is None else str(v) for v in values] if mixed else values)
        columns.append(column)
        fields.append(arrow.field(name, column.type, metadata={"unit": found.units.get(name, "")}))
    whole = io.BytesIO()
    arrow.parquet.write_table(arrow.Table.from_arrays(columns, schema=arrow.schema(fields)), whole)
    return write_bytes(path, whole.getvalue())
