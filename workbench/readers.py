"""Files to records: CSV and MAT in, CSV out; every kind of bad file has its own message with a place and a mend.

    t [s],V1 [V],w3 [rad/s],theta [deg],w3_set [rad/s]
    0.00,1.25,10.1,-0.4,10

Comma, semicolon or tab; decimal point, or decimal comma between semicolons; units in square or round brackets; UTF-8; one file
is one experiment, named by its stem.
"""

import codecs
import io
import math
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from workbench.data import Channel, Experiment, Role, span_name
from workbench.errors import InputError
from workbench.files import write_text
from workbench.formats import KINDS, Group, Sheet, loaded, on_one_clock
from workbench.logs import ROWS, counts, is_table, number, plain, time_column
from workbench.records import record
from workbench.stamps import Place, regular
from workbench.units import UNITS

TIME_NAMES = ("t", "time", "Time", "Zeit")

#: Fewer samples than this are no record.
SHORTEST = 3
YEARS = 1e11  # s: milliseconds since 1970 are more, seconds are not
DAYS, PER_DAY = (1e4, 1e6), 1.5e-5  # days since 1900 or 0 are within, and steps of a second are less of a day

#: Roles by name: the channels of the three machines and the letters of the field. The first match counts.
ROLES: tuple[tuple[str, Role], ...] = (
    (r".+_set", "reference"),
    (r"V\d+|u\d*|F", "input"),
    (r"w3|theta|y\d*|v|q", "output"),
    (r"r2|arm|p|rho", "schedule"),
)


@record
class Column:
    """A channel of a known MAT layout: `variable`, times the scalar variable `times` where one is named."""

    channel: Channel
    variable: str
    times: str = ""


@record
class Layout:
    """A MAT file whose variables are known by name; variables not listed are left out."""

    time: str
    columns: tuple[Column, ...]

    def fits(self, variables: Mapping[str, np.ndarray]) -> bool:
        needed = {self.time} | {c.variable for c in self.columns} | {c.times for c in self.columns if c.times}
        return needed <= variables.keys()


LAYOUTS: dict[str, Layout] = {
    # A. Janot, M. Gautier, M. Brunot, "Data Set and Reference Models of EMPS", 2019. The force pulses of the second
    # file act through the drive and are part of vir; kp and kv are gains of the loop.
    "EMPS": Layout(
        "t",
        (
            Column(Channel("F", "N", "input"), "vir", times="gtau"),
            Column(Channel("q", "m", "output"), "qm"),
            Column(Channel("q_set", "m", "reference"), "qg"),
        ),
    ),
}

Names = Sequence[str] | None


def read_file(path: str | Path, *, inputs: Names = None, outputs: Names = None, schedule: Names = None) -> Experiment:
    """The record of a file that holds one, see `read_records`; a file with several is refused."""
    record, *more = read_records(path)
    if more:
        mend = "cut it there into files: just one record is taken here"
        raise InputError(f"holds {1 + len(more)} records: {'; '.join(record.notes)}", file=path, mend=mend)
    return record.with_roles(inputs or (), outputs or (), schedule or ())


def read_records(path: str | Path, name: str = "", dt: float | None = None) -> tuple[Experiment, ...]:
    """The records of a file: text (.csv, .txt, .tsv), MAT, Excel, Parquet, Feather, TDMS or MDF (see `formats`).

    It is one where its stamps have no gap, and else one for each part between them (see `stamps`). They are called `name`, by
    default the file's stem, and by their times as well where they are several. Roles come from the names (`X_set` is a
    reference, see ROLES). The sample time is the mean step of the stamps; dt [s] stands for the stamps of a file that has none.
    Raises InputError with file, line, channel and mend for every fault of the file.
    """
    path = Path(path)
    _check_file(path)
    suffix = path.suffix.lower()
    if suffix not in READERS:
        known = ", ".join(READERS)
        raise InputError(
            f"file type {suffix!r} is not known", file=path, mend=f"expected {known}; text with columns can be named .csv"
        )
    return _called(name or path.stem, [replace(own, file=str(path)) for own in READERS[suffix](path, dt)])


def _called(name: str, records: Sequence[Experiment]) -> tuple[Experiment, ...]:
    if len(records) == 1:
        return (replace(records[0], name=name),)
    names = [span_name(name, own.t) for own in records]
    if len(set(names)) < len(names):  # runs that begin and end alike
        names = [f"{own}, part {k}" for k, own in enumerate(names, 1)]
    return tuple(replace(own, name=one) for own, one in zip(records, names, strict=True))


def write_csv(experiment: Experiment, path: str | Path) -> Path:
    """Write a record as CSV with 17 significant digits: reading it gives the same numbers, bit for bit.

    Roles are kept by name only. Raises InputError for a channel name that a CSV header cannot hold.

        >>> read(write_csv(data.experiments[0], "again.csv")).experiments[0].names
        ('U', 'n', 'way')
    """
    for channel in experiment.channels:
        cell = _HEADER_CELL.fullmatch(str(channel))
        if not cell or cell[1] != channel.name or channel.name in ("", *TIME_NAMES) or number(channel.name) is not None:
            raise InputError(
                "cannot stand in a CSV header",
                file=path,
                channel=channel.name,
                mend="use a name without commas, semicolons, quotes, brackets and line ends, other than t",
            )
    text = io.StringIO()
    header = ",".join(["t [s]", *map(str, experiment.channels)])
    table = np.column_stack([experiment.t, experiment.values])
    np.savetxt(text, table, fmt="%.17g", delimiter=",", header=header, comments="")
    return write_text(path, text.getvalue())


def _check_file(path: Path) -> None:
    if path.is_dir():
        raise InputError("is a folder, expected a file", file=path, mend="name the record files in it")
    try:
        with open(path, "rb") as stream:
            empty = not stream.read(1)
    except FileNotFoundError:
        near = sorted(p.name for p in path.parent.glob(f"*{path.suffix}"))[:5] if path.parent.is_dir() else []
        mend = f"files there: {', '.join(near)}" if near else "check the path"
        raise InputError("no such file", file=path, mend=mend) from None
    except OSError as reason:
        raise InputError(f"cannot read: {reason.strerror}", file=path, mend="check the permissions") from None
    if empty:
        raise InputError("is empty", file=path, line=1, mend="expected a header and one row for each sample")


# ---- CSV -------------------------------------------------------------------------------------------------------------

# name, then a unit in square or round brackets where there is one; y(1) is no unit
_HEADER_CELL = re.compile(
    r"\s*([^\[\](),;\t\r\n\"]*?)\s*(?:\[\s*([^\[\],;\t\r\n\"]*?)\s*\]|\(\s*(?!\d*\s*\))([^\[\](),;\t\r\n\"]+?)\s*\))?\s*"
)


def name_and_unit(cell: str) -> tuple[str, str]:
    """("w3", "rad/s") of "w3 [rad/s]" or "w3 (rad/s)"; empty where the cell is no channel name."""
    match = _HEADER_CELL.fullmatch(cell)
    return (match[1], match[2] or match[3] or "") if match else ("", "")


@record
class _Header:
    """The first row of a CSV file: its delimiter, and a name and a unit for each cell."""

    line: int
    delimiter: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    time: int


@record
class _Source:
    """A file, and its text where that was written anew."""

    path: Path
    text: str | None = None


def _read_csv(path: Path, dt: float | None) -> tuple[Experiment, ...]:
    """A table as it is; where it does not keep the contract, as it is understood, which the record's notes say."""
    try:
        return _read_text(_Source(path))
    except InputError as reason:
        found = plain(path, dt)
        if found is None and reason.problem.startswith("no time column") and not is_table(path):
            mend = "expected one row of names and rows of numbers below it"
            raise InputError("is no table of numbers", file=path, mend=mend) from None
        if found is None:
            raise
    records = _read_text(_Source(path, found.text), found.factor)
    return tuple(replace(own, notes=found.notes + own.notes) for own in records)


def _read_text(source: _Source, factor: float = 1.0) -> tuple[Experiment, ...]:
    """factor: of the time column, for s."""
    path, header = source.path, _header(source)
    table = _table(source, header)
    if len(table) < SHORTEST:
        raise InputError(
            f"{len(table)} samples are no record, expected at least {SHORTEST}",
            file=path,
            line=header.line,
            mend="is the file whole?",
        )
    t = factor * table[:, header.time]
    kept = [k for k in range(len(header.names)) if k != header.time]
    channels = tuple(Channel(header.names[k], header.units[k], role_of(header.names[k])) for k in kept)
    place = Place(path, header.names[header.time], lambda row: _line_of_row(source, header, row))
    values = table[:, kept]
    del table  # of a long file there is not room for many
    for own in (t, values):
        own.setflags(write=False)  # so that no record copies it
    return _records(t, channels, values, place)


def _records(t: np.ndarray, channels: tuple[Channel, ...], values: np.ndarray, place: Place) -> tuple[Experiment, ...]:
    """Samples as one record, or as one for each part between gaps. Stamps that are no seconds are refused."""
    line = place.line(0) - 1 if place.line else None
    if abs(t[0]) > YEARS:
        mend = f"write {place.channel} [ms] in the header, or {place.channel} [us]"
        raise InputError(f"{t[0]:g} s is no time of this age", file=place.file, line=line, channel=place.channel, mend=mend)
    found = regular(t, values, [channel.name for channel in channels], place)
    per_day = 86400.0 * found.dt
    if found.dt < PER_DAY and (DAYS[0] < t[0] < DAYS[1] or abs(per_day / float(f"{per_day:.2g}") - 1.0) < 1e-5):
        mend = f"if it is in days, multiply it by 86400 and write {place.channel} [s]"
        raise InputError(
            f"steps of {found.dt:.3g} s at {t[0]:.6g} s: is it in days?", file=place.file, channel=place.channel, mend=mend
        )
    return tuple(Experiment(str(place.file), own.t, channels, own.values, found.dt, notes=found.notes) for own in found.pieces)


def role_of(name: str) -> Role:
    """The role that a channel's name tells, see ROLES."""
    for pattern, role in ROLES:
        if re.fullmatch(pattern, name):
            return role
    return "other"


def _header(source: _Source) -> _Header:
    path, (line, text) = source.path, _first_line(source)
    delimiter = next((d for d in (";", "\t") if d in text), ",")
    cells = [cell.strip().strip('"').strip() for cell in text.split(delimiter)]
    if all(number(word) is not None for cell in cells for word in cell.split()):
        raise InputError(
            "no header: the first row holds numbers only",
            file=path,
            line=line,
            mend="put the channel names in the first row, such as: t [s],u [V],y [rad/s]",
        )
    names, units = [], []
    for k, cell in enumerate(cells, 1):
        name, unit = name_and_unit(cell)
        if not name:
            problem = f"column {k} has no name" if not cell else f"column {k}: {cell!r} is no channel name"
            mend = "write name [unit], the unit in brackets or left out; no delimiter at the end of the line"
            raise InputError(problem, file=path, line=line, mend=mend)
        names.append(name)
        units.append(unit)
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"appears {names.count(name)} times in the header",
                file=path,
                line=line,
                channel=name,
                mend="give each column its own name",
            )
    return _Header(line, delimiter, tuple(names), tuple(units), _time_column(path, line, names, units))


def _time_column(path: Path, line: int, names: Sequence[str], units: Sequence[str]) -> int:
    found = [k for k, name in enumerate(names) if name in TIME_NAMES]
    if not found:
        mend = "name the time column t [s], or give its sample time: --file-dt, in Python read(.., dt=)"
        if len(names) == 1:
            mend += "; columns are separated by comma, semicolon or tab"
        raise InputError(f"no time column among {', '.join(names)}", file=path, line=line, mend=mend)
    if len(found) > 1:
        both = " and ".join(names[k] for k in found)
        raise InputError(f"two time columns, {both}", file=path, line=line, mend="keep one")
    if len(names) == 1:
        mend = "columns are separated by comma, semicolon or tab"
        raise InputError("the time column is the only one", file=path, line=line, mend=mend)
    k = found[0]
    if units[k] not in ("", "s"):
        unit = UNITS.get(units[k])
        factor = f"multiply the column by {unit.factor:g}" if unit and unit.quantity == "time" else "convert the column"
        raise InputError(
            f"time is in {units[k]}, expected s",
            file=path,
            line=line,
            channel=names[k],
            mend=f"{factor} and write {names[k]} [s] in the header",
        )
    return k


def _first_line(source: _Source) -> tuple[int, str]:
    """Number and text of the first line that is not blank."""
    path, start = source.path, b""
    if source.text is None:
        with open(path, "rb") as stream:
            start = stream.read(65536)
    if start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise InputError("text is UTF-16, expected UTF-8", file=path, line=1, mend="save the file as CSV UTF-8")
    if b"\0" in start:
        mend = "expected text; export the sheet as CSV" if start.startswith(b"PK") else "expected text as in CSV"
        raise InputError("is a binary file", file=path, mend=mend)
    for line, text in _lines(source):
        if text.strip():
            return line, text
    raise InputError("is empty", file=path, line=1, mend="expected a header and one row for each sample")


def _lines(source: _Source) -> Iterator[tuple[int, str]]:
    """Numbered lines without their ends; bytes that are not UTF-8 are refused with their line."""
    path, line = source.path, 0
    if source.text is not None:
        yield from enumerate(source.text.split("\n"), 1)
        return
    with open(path, encoding="utf-8-sig", errors="surrogateescape") as stream:
        for line, text in enumerate(stream, 1):
            bad = next((c for c in text if "\ud800" <= c <= "\udfff"), "") if not text.isascii() else ""
            if bad:
                raise InputError(
                    f"byte 0x{ord(bad) & 0xFF:02X} is not UTF-8", file=path, line=line, mend="save the file as CSV UTF-8"
                )
            yield line, text.rstrip("\r\n")


def _table(source: _Source, header: _Header) -> np.ndarray:
    """All rows as numbers (N, cells): C-fast, and line by line only to say what is wrong."""
    wanted = len(header.names)
    # an absolute path: numpy opens what looks like an address, and reads a path in large blocks
    table = _numbers(str(source.path.resolve()) if source.text is None else source.text.split("\n"), header)
    if table is None and header.delimiter in _MAY_HAVE_COMMAS:
        table = _numbers((text.translate(_POINTS) for _, text in _lines(source)), header)
        if table is not None:
            _check_thousands(source, header)
    if table is not None and not table.size:
        return np.empty((0, wanted))
    if table is None or table.shape[1] != wanted or not np.isfinite(table).all():
        table = np.array(list(_rows(source, header)))
    return table


def _check_thousands(source: _Source, header: _Header) -> None:
    """Refuse a column whose commas may all be marks of thousands: 999 and 1,234 in one column, or no other comma in the file."""
    marks: dict[int, tuple[int, str]] = {}  # by column the first cell with a comma
    decimal, plain = set(), set()
    for line, text in _lines(source):
        if line > header.line:
            for j, cell in enumerate(text.split(header.delimiter)):
                if "," not in cell:
                    plain.add(j)
                elif _THOUSANDS.fullmatch(cell.strip()):
                    marks.setdefault(j, (line, cell.strip()))
                else:
                    decimal.add(j)
    for j, (line, cell) in marks.items():
        if not decimal or (j in plain and j not in decimal):
            mend = f"write {cell.replace(',', '.')} if it is decimal, {cell.replace(',', '')} if not"
            beside = " beside numbers without a comma" * (j in plain)
            said = f"{cell!r}{beside}: is it a decimal comma, or a mark of thousands?"
            raise InputError(said, file=source.path, line=line, channel=header.names[j], mend=mend)


_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(,\d{3})+")

#: Decimal commas to points; a point beside them, of thousands, makes no number.
_POINTS = str.maketrans({",": ".", ".": "_"})
_MAY_HAVE_COMMAS = (";", "\t")  # delimiters between which a comma is a decimal one


def _numbers(source: str | Iterable[str], header: _Header) -> np.ndarray | None:
    """The rows below the header; None where something in them is no number."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # "no data": the caller reports it, with the place
            return np.loadtxt(
                source, delimiter=header.delimiter, skiprows=header.line, comments=None, ndmin=2, encoding="utf-8-sig"
            )
    except (ValueError, UnicodeDecodeError):
        return None


def _rows(source: _Source, header: _Header) -> Iterator[list[float]]:
    """The numbers of each row; the first row that breaks the contract is refused."""
    path, below = source.path, [own for own in _lines(source) if own[0] > header.line]
    commas = header.delimiter in _MAY_HAVE_COMMAS and any("," in text for _, text in below)
    for line, text in below:
        if text.strip():
            cells = text.split(header.delimiter)
            if len(cells) != len(header.names):
                raise _wrong_count(path, header, line, cells)
            yield [_cell(path, header, line, k, cell, commas) for k, cell in enumerate(cells)]


def _wrong_count(path: Path, header: _Header, line: int, cells: list[str]) -> InputError:
    found, wanted = len(cells), len(header.names)
    problem = f"{found} cells, expected {wanted}"
    if found < wanted:
        channel = header.names[found]
        mend = "the line is cut off: complete it or delete it"
        return InputError(problem, file=path, line=line, channel=channel, mend=mend)
    if not cells[-1].strip() and found == wanted + 1:
        mend = "take the delimiter off the end of the line"
    elif header.delimiter == "," and found >= 2 * wanted - 1:
        mend = "decimal commas? write decimal points, or points with semicolons between cells"
    else:
        mend = "one cell for each name in the header"
    return InputError(problem, file=path, line=line, mend=mend)


def _cell(path: Path, header: _Header, line: int, k: int, text: str, commas: bool) -> float:
    text = text.strip()
    value = number(text.translate(_POINTS) if commas else text)
    if value is not None and math.isfinite(value):
        return value
    mend = "repair the value, or cut the record there into two files"
    if not text:
        problem = "empty cell, expected a number"
    elif value is not None:
        problem = f"{text} is not finite, expected a number"
    elif commas and "." in text:
        problem = f"a point in {text[:40]!r}, and other cells have decimal commas"
        mend = "write all numbers of the file one way, without a mark for thousands"
    elif re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", text):
        problem = f"decimal comma in {text!r}, expected a decimal point"
        mend = "export with decimal points, or with semicolons between the cells"
    else:
        problem, mend = f"text {text[:40]!r}, expected a number", "write a plain number with a decimal point"
    raise InputError(problem, file=path, line=line, channel=header.names[k], mend=mend)


def _line_of_row(source: _Source, header: _Header, row: int) -> int:
    numbered = (line for line, text in _lines(source) if line > header.line and text.strip())
    return next(line for k, line in enumerate(numbered) if k == row)


# ---- files that are no text ------------------------------------------------------------------------------------------


def _read_other(path: Path, dt: float | None) -> tuple[Experiment, ...]:
    """A sheet as the text that it would be exported as; groups of columns on the stamps of the fastest."""
    found = loaded(path)
    if isinstance(found, Sheet):
        written = plain(path, dt, found.text)
        records = _read_text(_Source(path, written.text if written else found.text), written.factor if written else 1.0)
        said = (*found.notes, *(written.notes if written else ()))
        return tuple(replace(own, notes=said + own.notes) for own in records)
    groups, notes = _with_stamps(path, [own for own in found if own.columns], dt)
    left = [name for own in found for name in own.left]
    notes += [f"left out, for they are no numbers: {', '.join(left)}"] if left else []
    one, said = on_one_clock(path, groups)
    columns: list[tuple[Channel, np.ndarray]] = []
    for c in one.columns:
        name, unit = name_and_unit(c.name)
        if not name or unit.isdigit():  # of a vector
            name, unit = (f"{name} {unit}" if name else c.name), ""
        taken = {channel.name for channel, _ in columns}
        number = next(k for k in range(1, len(taken) + 2) if (name if k == 1 else f"{name} {k}") not in taken)
        own_name = name if number == 1 else f"{name} {number}"
        columns.append((Channel(own_name, c.unit or unit, role_of(name)), c.values))
    return tuple(replace(own, notes=(*notes, *said, *own.notes)) for own in _from_columns(path, one.t, columns))


def _with_stamps(path: Path, groups: Sequence[Group], dt: float | None) -> tuple[list[Group], list[str]]:
    """The groups with the stamps that one of their columns holds; what has none is left out where others have, and said."""
    made, notes, faults = [], [], []
    for own in groups:
        if len(own.t):
            made.append(own)
            continue
        names = [c.name for c in own.columns]
        try:
            units, columns = [c.unit for c in own.columns], own.columns
            k, factor, said = time_column(path, names, units, dt, lambda j, columns=columns: counts(columns[j].values))
        except InputError as reason:
            faults.append(reason)
            notes.append(f"{', '.join(names)}: no time, left out")
            continue
        t = factor * (own.columns[k].values if k != ROWS else np.arange(len(own.columns[0].values)))
        if not np.isfinite(t).all():
            raise InputError("has no number in each row", file=path, channel=names[k], mend="delete such rows")
        notes += said
        made.append(Group(t, tuple(c for j, c in enumerate(own.columns) if j != k)))
    if not made:
        raise faults[0] if faults else InputError("holds no columns of numbers", file=path, mend="is the file whole?")
    return made, notes


def _read_mat(path: Path, dt: float | None) -> tuple[Experiment, ...]:
    variables = _variables(path)
    for layout in LAYOUTS.values():
        if layout.fits(variables):
            return _from_layout(path, layout, variables)
    t = _time_vector(path, variables, dt)
    columns: list[tuple[Channel, np.ndarray]] = []
    left = []
    for name, array in variables.items():
        if name not in TIME_NAMES and len(array) == len(t):
            width = array.shape[1]
            names = [name] if width == 1 else [f"{name}{k + 1}" for k in range(width)]
            columns += [(Channel(key, "", role_of(key)), array[:, k]) for k, key in enumerate(names)]
        elif array.size > 1 and name not in TIME_NAMES:
            left.append(f"{name} ({' x '.join(map(str, array.shape))})")
    records = _from_columns(path, t, columns)
    note = [f"left out, for they have not the {len(t)} samples of the others: {', '.join(left)}"] if left else []
    return tuple(replace(own, notes=(*note, *own.notes)) for own in records)


def _variables(path: Path) -> dict[str, np.ndarray]:
    """Real numeric variables by name, vectors as one column (N, 1)."""
    found = loaded(path)
    assert not isinstance(found, Sheet)
    arrays = {c.name: c.values for group in found for c in group.columns}
    return {name: array.reshape(-1, 1) if 1 in array.shape else array for name, array in arrays.items()}


def _time_vector(path: Path, variables: Mapping[str, np.ndarray], dt: float | None) -> np.ndarray:
    for name in TIME_NAMES:
        if name in variables and variables[name].shape[1:] == (1,) and len(variables[name]) > 1:
            return variables[name][:, 0]
    given = [variables[name].flat[0] for name in ("Ts", "dt") if name in variables and variables[name].size == 1]
    if step := next(iter(given), dt):
        lengths = [len(v) for v in variables.values() if len(v) > 1]
        return step * np.arange(max(lengths, key=lambda n: n * lengths.count(n)) if lengths else 0)  # most samples
    listed = ", ".join(variables) or "none"
    raise InputError(
        f"no time vector; numeric variables: {listed}",
        file=path,
        mend="save a vector t in seconds, or the sample time as the number Ts, and each channel as a vector",
    )


def _from_layout(path: Path, layout: Layout, variables: Mapping[str, np.ndarray]) -> tuple[Experiment, ...]:
    t = variables[layout.time][:, 0]
    columns = []
    for column in layout.columns:
        array = variables[column.variable][:, 0]
        if len(array) != len(t):
            raise InputError(
                f"{len(array)} samples of {column.variable}, expected {len(t)} as in {layout.time}",
                file=path,
                channel=column.channel.name,
                mend="save vectors of equal length",
            )
        columns.append((column.channel, array * variables[column.times].flat[0] if column.times else array))
    return _from_columns(path, t, columns)


def from_columns(name: str, t: np.ndarray, columns: Sequence[tuple[Channel, np.ndarray]]) -> tuple[Experiment, ...]:
    """Columns (N,) with their stamps t (N,) as records of this name; faulty stamps and numbers are refused."""
    return _called(name, _from_columns(Path(name), t, columns))


def _from_columns(path: Path, t: np.ndarray, columns: Sequence[tuple[Channel, np.ndarray]]) -> tuple[Experiment, ...]:
    if not columns:
        raise InputError(
            f"no variable has the {len(t)} samples of the time vector", file=path, mend="save each channel as a vector"
        )
    if len(t) < SHORTEST:
        problem = f"{len(t)} samples are no record, expected at least {SHORTEST}"
        raise InputError(problem, file=path, mend="is the file whole?")
    for name, array in [("t", t), *((channel.name, array) for channel, array in columns)]:
        bad = np.flatnonzero(~np.isfinite(array))
        if len(bad):
            raise InputError(
                f"sample {bad[0] + 1} is {array[bad[0]]}, expected a finite number",
                file=path,
                channel=name,
                mend="repair the value, or cut the record there into two files",
            )
    channels, values = tuple(channel for channel, _ in columns), np.column_stack([array for _, array in columns])
    return _records(t, channels, values, Place(path, "t"))


READERS = dict.fromkeys((".csv", ".txt", ".tsv"), _read_csv) | dict.fromkeys(KINDS, _read_other) | {".mat": _read_mat}
