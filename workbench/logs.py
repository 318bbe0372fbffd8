"""Text as loggers write it, written anew as `readers` takes it: one header, semicolons, numbers alone, and a factor of its time.

    sep=;
    Prüfstand 3                        -> t [s];u [V];n [1/min]
    Timestamp;u;n;remark               ->
    ms;V;1/min;                        ->
    0;1,5;980;start                    -> 0;1,5;980            and 0.001 s

What was recognised is said in a note for each thing. Lines keep their numbers, so that whatever else is wrong is refused with
its place. Nothing is guessed that has two readings: time stamps of unknown unit, and numbers that may have marks of thousands,
are asked about.
"""

import codecs
import csv
import re
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from workbench.errors import InputError
from workbench.records import record
from workbench.units import UNITS

DELIMITERS = (";", "\t", ",", "|", None)  # None: blanks, any number of them
SEPARATOR = re.compile(r'"?sep=([;,|\t])"?', re.IGNORECASE)
FEWEST = 3  # rows that look alike, for the line above them to be a header
SHORT = 12  # letters that a unit may have
MARKS = ("#", "%")  # of comments
NUMERIC = 0.5  # share of the cells of a column that are numbers, from which on others are faults and not text
DAY = 86400.0

#: Names of time, and those that say nothing of its unit.
CLOCKS = ("t", "time", "zeit", "elapsed", "elapsed time", "x_value")
COUNTERS = ("sample", "samples", "sample number", "index", "counter", "count", "row", "#", "no", "no.", "nr", "nr.")  # of samples
ROWS = -1  # in place of a column: the rows are counted
DATES = ("date", "datum")  # of clock times in a column of their own
TAGS = ("tag", "tagname", "tag name", "signal", "variable", "item", "channel")  # of values below each other
STAMPS = ("timestamp", "time stamp", "time_stamp", "zeitstempel", "datetime", "date time", "date/time", "uhrzeit", "clock")
SUFFIXED = re.compile(rf"(?i:({'|'.join(map(re.escape, (*CLOCKS[1:], *STAMPS)))})[ _]?(s|ms|us|min|h))|(t)_(s|ms|us)")
FACTORS = tuple(unit for unit, own in UNITS.items() if own.quantity == "time")
OTHERS = ("%", "°C", "degC", "K", "1")  # units that a row below the names may have, too
SPELLINGS = {"sec": "s", "secs": "s", "second": "s", "seconds": "s", "msec": "ms", "µs": "us", "μs": "us", "minutes": "min"}

_MARKED = re.compile(r"[-+\u2212]?\d[\d.,' \u00a0]*")
_WORD = re.compile(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?|[\[(][^\])]*[\])]")  # a unit in brackets goes with its name
_UNIT = re.compile(r"\[\s*(.*?)\s*\]|\(\s*(.*?)\s*\)")
_TIME = re.compile(r"(?:(.*?)[ T])?(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d+)?)(Z|[-+]\d{2}:?\d{2})?")
_DATES = ("%Y-%m-%d", "%Y/%m/%d", "%d.%m.%Y")  # in others day and month may change places


@record
class Plain:
    """Text that `readers` takes, what its time is multiplied by for s, and what was recognised, in sentences."""

    text: str
    factor: float
    notes: tuple[str, ...]


@record
class _Layout:
    """Where a table stands in a text: its delimiter, the rows of header and units (-1: none), and its first row of numbers."""

    delimiter: str | None
    header: int
    units: int
    first: int


def plain(path: Path, dt: float | None = None, text: str | None = None) -> Plain | None:
    """The text of a file, or this text of it, written anew; None where it is no table, or there is nothing to write anew.

    dt [s]: between rows where there is no column of time, or between the numbers of a column that counts samples.
    Raises InputError, with both readings, where what was logged could mean two things.
    """
    decoded = _decoded(path.read_bytes()) if text is None else (text, [])
    if decoded is None:
        return None
    text, notes = decoded
    lines = re.split(r"\r\n|\n|\r", text)
    layout = _layout(lines, notes)
    if layout is None:
        return None
    cells = [_cells(line, layout.delimiter) for line in lines]
    names, units = _names(cells, layout)
    if layout.units >= 0:
        _check_units(path, cells[layout.header], cells[layout.units], layout.units + 1)
    if '"' in lines[layout.header] + lines[layout.first]:
        notes.append("cells are in quotes")
    if lines[layout.header].lstrip().startswith(MARKS):
        notes.append("the header stands in a comment")
    rows = [k for k in range(layout.first, len(lines)) if lines[k].strip()]
    if len(cells[rows[-1]]) < len(names) and len(rows) > FEWEST:
        notes.append(f"line {rows[-1] + 1}, the last one, is cut off and left out")
        rows.pop()
    kept = _kept(path, cells, rows, names, layout.header + 1, notes)
    time = _time(path, names, units, cells, rows, kept, layout.header + 1, dt, lambda j: _counting(cells, rows, j))
    if time is None:
        return None
    column, factor, said = time
    notes += said
    stamps = {} if factor else _clock(path, names, cells, rows, column)
    written = [""] * len(lines)
    for count, k in enumerate(rows):
        if len(cells[k]) < len(names):
            problem, mend = f"{len(cells[k])} cells, expected {len(names)}", "the line is cut off: complete it or delete it"
            raise InputError(problem, file=path, line=k + 1, channel=_split(names[len(cells[k])])[0] or None, mend=mend)
        own = [str(count)] * (column == ROWS) + [stamps.get(k, cells[k][j]) if j == column else cells[k][j] for j in kept]
        written[k] = ";".join([*own, *cells[k][len(names) :]])  # more cells than names: refused there
    heads = [f"{names[j]} [{units[j]}]" if units[j] and j != column else names[j] for j in kept]
    heads = ["t [s]"] * (column == ROWS) + ["t [s]" if j == column else head for j, head in zip(kept, heads, strict=True)]
    written[layout.header] = ";".join(heads)
    return Plain("\n".join(written), factor or 1.0, tuple(notes)) if notes else None


def _decoded(content: bytes) -> tuple[str, list[str]] | None:
    """The text, and a note where it is not UTF-8; None of what is no text."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        try:
            return content.decode("utf-16"), ["read as UTF-16"]
        except UnicodeDecodeError:
            return None
    if b"\0" in content:
        return None
    try:
        return content.decode("utf-8-sig"), []
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace"), ["not UTF-8, read as Windows-1252: look at names and units"]


def _layout(lines: Sequence[str], notes: list[str]) -> _Layout | None:
    """The table of a text, by the delimiter that makes most columns of it."""
    begin = next((k for k, line in enumerate(lines) if line.strip()), 0)
    given = SEPARATOR.fullmatch(lines[begin].strip()) if lines else None
    found = [own for d in ((given[1],) if given else DELIMITERS) if (own := _table(lines, d, begin + bool(given)))]
    if not found:
        return None
    widest = max(len(_cells(lines[own.header], own.delimiter)) for own in found)
    layout = next(own for own in found if len(_cells(lines[own.header], own.delimiter)) == widest)
    if given:
        notes.append(f"sep={given[1]} says how columns are separated")
    above = sum(bool(line.strip()) for line in lines[begin + bool(given) : layout.header])
    if above:
        notes.append(f"{above} line{'s' * (above > 1)} above the header left out")
    if layout.units >= 0:
        notes.append("units are in a row of their own")
    if layout.delimiter in ("|", None):
        notes.append(f"columns are separated by {'blanks' if layout.delimiter is None else '|'}")
    return layout


def _table(lines: Sequence[str], delimiter: str | None, begin: int) -> _Layout | None:
    """Where rows of numbers begin that have a header above; None where there are none."""
    filled = [k for k in range(begin, len(lines)) if lines[k].strip()]
    cells = {k: _cells(lines[k], delimiter) for k in filled[:200]}  # a header is near the top
    filled = [k for k in filled if k in cells]
    for at in range(1, len(filled) - FEWEST + 1):
        rows = [cells[k] for k in filled[at : at + FEWEST]]
        width = len(rows[0])
        if width < 2 or any(len(row) != width or not _measured(row, delimiter) for row in rows):
            continue
        above = [k for k in filled[:at] if len(cells[k]) == width and not _measured(cells[k], delimiter)]
        if not above or above[-1] != filled[at - 1]:
            return None
        if len(above) > 1 and above[-2] == filled[at - 2] and _are_units(cells[above[-1]]):
            return _Layout(delimiter, above[-2], above[-1], filled[at])
        return _Layout(delimiter, above[-1], -1, filled[at])
    return None


def _cells(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return _WORD.findall(line.lstrip("".join(MARKS)))
    try:
        split = next(csv.reader([line], delimiter=delimiter), []) if '"' in line else line.split(delimiter)
    except csv.Error:  # a cell of megabytes
        split = line.split(delimiter)
    return [cell.strip() for cell in split]


def _measured(row: Sequence[str], delimiter: str | None) -> bool:
    """Whether a row holds numbers or clock times, at least two and in half of its cells."""
    filled = [cell for cell in row if cell]
    numbers = sum(_is_number(cell, delimiter != ",") or bool(_TIME.fullmatch(cell)) for cell in filled)
    return numbers >= 2 and 2 * numbers >= len(filled)


def number(text: str) -> float | None:
    """The number that a text is; None where it is none."""
    try:
        return None if "_" in text else float(text)
    except ValueError:
        return None


def _is_number(cell: str, commas: bool) -> bool:
    return number(cell.replace(",", ".") if commas else cell) is not None


def _are_units(row: Sequence[str]) -> bool:
    """Whether cells are units: half of them known ones or in brackets, the others short."""
    filled = [cell for cell in row if _inner(cell)]
    known = sum(_inner(cell) != cell or cell in UNITS or cell in SPELLINGS or cell in OTHERS for cell in filled)
    numbers = any(_is_number(cell, True) for cell in filled if cell != "1")
    return 2 * known >= len(filled) > 0 and not numbers and all(len(_inner(cell)) <= SHORT for cell in filled)


def _inner(cell: str) -> str:
    """A unit without the brackets around it; "-" is none."""
    match = _UNIT.fullmatch(cell)
    inner = (match[1] or match[2] or "") if match else cell
    return "" if inner in ("-", "--") else inner


def _names(cells: Sequence[Sequence[str]], layout: _Layout) -> tuple[list[str], list[str]]:
    """Names of columns, as they stand where no row of units follows, and units by column where one does."""
    header = [cell.strip().strip('"').strip() for cell in cells[layout.header]]
    header[0] = header[0].lstrip("".join(MARKS)).strip()
    if layout.units < 0:
        return header, [""] * len(header)
    units = [_inner(cell) for cell in cells[layout.units]]
    return header, [unit if not _UNIT.search(name) else "" for name, unit in zip(header, units, strict=True)]


def _check_units(path: Path, header: Sequence[str], row: Sequence[str], line: int) -> None:
    """Refuse a unit in the header and another one below."""
    for (name, unit), below in zip(map(_split, header), map(_inner, row), strict=True):
        if unit and below and unit != below:
            mend = "keep the one that is right"
            raise InputError(
                f"in {unit} by the header, in {below} by the row below", file=path, line=line, channel=name, mend=mend
            )


def _kept(path, cells, rows: Sequence[int], names: list[str], line: int, notes: list[str]) -> list[int]:
    """Columns that are taken: not empty ones, not text, and of equal ones the first."""
    kept: list[int] = []
    columns = [[cells[k][j] if j < len(cells[k]) else "" for k in rows] for j in range(len(names))]
    for j, (name, own) in enumerate(zip(names, columns, strict=True)):
        numbers = sum(_is_number(cell, True) or bool(_TIME.fullmatch(cell)) for cell in own)
        marked = all(_MARKED.fullmatch(cell) for cell in own if cell)  # numbers with marks of thousands: refused where they stand
        slow = numbers == sum(map(bool, own))  # of another rate: numbers and empty cells
        if not any(own):
            notes += [f"{name}: an empty column left out"] if name else ["an empty column left out"]
        elif name.lower() in DATES and not numbers and all(_is_date(cell) for cell in own if cell):
            notes.append(f"{name} holds dates")
        elif numbers < NUMERIC * len(own) and (slow or not marked):
            if name.lower() in TAGS and len(set(own)) > 1 and any(other.lower() == "value" for other in names):
                mend = f"give each {name} a column of its own"
                raise InputError(f"values of several {name} below each other", file=path, line=line, channel=name, mend=mend)
            holds = f"has numbers in {numbers} of {len(own)} rows" if slow else "holds text"
            notes.append(f"{name or f'column {j + 1}'} {holds} and is left out")
        elif any(name == names[i] and own == columns[i] for i in kept):
            notes.append(f"{name} stands there twice with the same numbers")
        else:
            kept.append(j)
    return kept


def _time(
    path, names, units, cells, rows, kept, line: int | None, dt: float | None, counting: Callable[[int], bool]
) -> tuple[int, float, list[str]] | None:
    """The column of time, what its numbers are multiplied by (0: clock times), and a note where it is not in seconds already.

    With dt [s] it may be a column that counts samples, or ROWS. None where its times are no numbers or in no unit of time.
    Raises InputError where there is none, or more than one.
    """
    found = []
    for j in kept:
        name, unit = _split(names[j])
        unit, match = unit or units[j], SUFFIXED.fullmatch(name)
        if match:
            name, unit = match[1] or match[3], unit or match[2] or match[4]
        if name.lower() in (*CLOCKS, *STAMPS) and (name != "T" or unit in FACTORS):  # T alone is a temperature
            found.append((j, name, SPELLINGS.get(unit, unit)))
    if len(found) != 1:
        if any(_split(name)[0].lower() in (*CLOCKS, *STAMPS) for k, name in enumerate(names) if k not in kept):
            return None  # its times are no numbers: the first of them is refused
        clocks = [j for j in kept if rows and all(_dated(cells[k][j]) for k in rows if j < len(cells[k]))]
        if len(clocks) == 1 and not found:
            return clocks[0], 0.0, [f"{names[clocks[0]]} holds dates and clock times: t is 0 at the first"]
        counter = next((j for j in kept if names[j].lower() in COUNTERS and counting(j)), None)
        if dt and not found:
            if counter is None:
                return ROWS, dt, [f"no time column: a sample every {dt:g} s, as asked"]
            return counter, dt, [f"{names[counter]} counts samples, one every {dt:g} s as asked"]
        told, mend = (
            f"no time column among {', '.join(names)}",
            "name the time column t [s], or give its sample time: --file-dt, in Python read(.., dt=)",
        )
        if found:
            told, mend = f"two time columns, {' and '.join(names[k] for k, _, _ in found)}", "keep one"
        raise InputError(told, file=path, line=line, mend=mend)
    j, name, unit = found[0]
    if sum(bool(_TIME.fullmatch(cells[k][j])) for k in rows if j < len(cells[k])) > NUMERIC * len(rows):
        return j, 0.0, [f"{name} holds clock times: t is 0 at the first"]
    if not unit and name.lower() in STAMPS:
        mend = f"write {name} [s] or {name} [ms] in the header"
        raise InputError("a time of unknown unit: is it in s, or in ms?", file=path, line=line, channel=name, mend=mend)
    known = UNITS.get(unit or "s")
    if known is None or known.quantity != "time":
        return None
    if known.factor != 1.0:
        return j, known.factor, [f"{name} is in {unit}, taken as t in s"]
    plainly = names[j] in ("t", "t [s]", "time", "Time", "Zeit")
    return j, 1.0, [] if plainly else [f"{name} is taken as time in s"]


def _dated(cell: str) -> bool:
    match = _TIME.fullmatch(cell)
    return bool(match and match[1])


def is_table(path: Path) -> bool:
    """Whether a text has rows of numbers below a row of names."""
    decoded = _decoded(path.read_bytes())
    return decoded is not None and _layout(re.split(r"\r\n|\n|\r", decoded[0]), []) is not None


def counts(values: np.ndarray) -> bool:
    """Whether values (N,) are those of a counter of samples: most go up by one."""
    steps = np.diff(values)
    return bool(len(steps)) and bool(np.mean(steps == 1.0) > NUMERIC)


def _counting(cells: Sequence[Sequence[str]], rows: Sequence[int], column: int) -> bool:
    """Whether a column of text counts samples."""
    values = [number(cells[k][column].replace(",", ".")) for k in rows if column < len(cells[k])]
    return None not in values and counts(np.array(values, float))


def time_column(
    path: Path, names: Sequence[str], units: Sequence[str], dt: float | None, counting: Callable[[int], bool]
) -> tuple[int, float, list[str]]:
    """The number of the column of time, what it is multiplied by for s, and a note where it is not in s already.

    dt [s]: between rows, which ROWS stands for, or between the numbers of a counter, where there is no column of time. Raises
    InputError where there is none, or more than one, or its unit is none of time. counting: whether a column counts samples.
    """
    found = _time(path, names, units, [], [], range(len(names)), None, dt, counting)
    if found is None:
        raise InputError(f"no column of time in s among {', '.join(names)}", file=path, mend="name it t [s]")
    return found


def _split(name: str) -> tuple[str, str]:
    """Name and unit of a header's cell such as Time (ms)."""
    match = _UNIT.search(name)
    return (name[: match.start()].strip(), match[1] or match[2] or "") if match else (name, "")


def _clock(path, names: Sequence[str], cells, rows: Sequence[int], column: int) -> dict[int, str]:
    """Seconds since the first by row, as text, of clock times with a date or without, which may pass midnight.

    What is no clock time is refused where it stands. Written without point or comma, which would say how others are meant.
    """
    beside = next((j for j, name in enumerate(names) if name.lower() in DATES), None)
    found: dict[int, str] = {}
    dates: dict[str, float] = {}
    zones, first, before, days = set(), None, 0.0, 0.0
    for k in rows:
        if column >= len(cells[k]):
            continue
        match = _TIME.fullmatch(cells[k][column])
        if not match:
            found[k] = f"{cells[k][column]} is no clock time"
            continue
        date = match[1] or (cells[k][beside] if beside is not None and beside < len(cells[k]) else "")
        fault, mend = "", f"write {names[column]} as 2024-12-31 12:00:00.000"
        if date not in dates:
            dates[date] = _day(date, next(iter(dates))) if dates else 0.0
            fault = f"the date {date!r} may be read two ways" if len(dates) > 1 and not dates[date] else ""
        zones.add(match[5])
        if fault or len(zones) > 1:
            problem = fault or "the time zone changes"
            raise InputError(problem, file=path, line=k + 1, channel=names[column], mend=mend)
        now = 3600.0 * int(match[2]) + 60.0 * int(match[3]) + float(match[4].replace(",", "."))
        days += DAY * (not date and now < before - 0.5 * DAY)
        before, at = now, now + days + dates[date]
        first = at if first is None else first
        found[k] = f"{round((at - first) * 1e9)}e-9"
    return found


def _is_date(cell: str) -> bool:
    return any(_read_date(cell, form) for form in _DATES)


def _read_date(cell: str, form: str) -> datetime | None:
    try:
        return datetime.strptime(cell, form)
    except ValueError:
        return None


def _day(date: str, first: str) -> float:
    """Seconds from midnight of one date to that of another; 0 where they cannot be read in one way only."""
    for form in _DATES:
        own, begin = _read_date(date, form), _read_date(first, form)
        if own and begin:
            return (own - begin).total_seconds()
    return 0.0
