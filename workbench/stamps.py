"""Time stamps as loggers write them, brought to a constant rate: what was mended is said, what has two readings is refused.

rows logged twice              left out
stamps of too few digits       the even line that each of them is within one of its steps of
stamps that came late          put where those before and after say they belong
a few missed samples           filled in by straight lines; the error is what these make of samples that are there
a gap, or time that goes back  the table is cut there into two records
"""

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from workbench.advice import quantum
from workbench.data import GAP, bad_stamps
from workbench.errors import InputError
from workbench.records import field, record

LATE = 20  # samples after which a late stamp must have been caught up with
MISSED = 3  # samples in a row that may be filled in
FILLED = 0.02  # share of a record that may be, and
MEND = 0.1  # the error that it may have, in standard deviations of a channel
OFTEN = 0.05  # share of the stamps from which on late ones are no exception
JUMP = 4.0  # of the usual change over a line, beyond which something happened in a hole
SELDOM, FEW, COARSE = 0.005, 3, 0.05  # share and number of repeated stamps that may mean too few digits; share that must
ROWS_OFF = 1.2  # rows by which a stamp may begin off the line: one, and what the line is not quite the true one
WINDOW, RATE = 100, 0.12  # samples over which a mean step is taken, and by how much it may change
UNEVEN = 0.25  # standard deviation of steps, in sample times, from which on samples are not even
PIECES = 50  # records that a table is cut into at most
FEWEST = 25  # samples of a record that a table is cut into
ROUNDING = 1e-12  # of its largest number, by which a channel that stands still may seem to move
LOST = 0.1  # share of the samples that may be in shorter pieces
MANY = 10  # gaps above which nobody cuts a file by hand
SHOWN = 3  # cuts that a note tells of


@record
class Place:
    """Where stamps stand: the file, the name of the column, and the line of a row where rows are lines."""

    file: Path
    channel: str
    line: Callable[[int], int] | None = None

    def of(self, row: int) -> str:
        return f"line {self.line(row)}" if self.line else f"sample {row + 1}"


@record
class Piece:
    """A record of a table: stamps t (N,), and values (N, nc)."""

    t: np.ndarray = field("N", unit="s")
    values: np.ndarray = field("N nc")


@record
class Regular:
    """A table as records with one sample time dt [s], and what was done to its stamps, in sentences."""

    pieces: tuple[Piece, ...]
    dt: float = field("", unit="s")
    notes: tuple[str, ...] = ()


@record
class _Rows:
    """What is left of a table on its way: stamps, values, and the rows of the file that they stand in."""

    t: np.ndarray = field("N")
    values: np.ndarray = field("N nc")
    rows: np.ndarray = field("N")

    def take(self, kept: np.ndarray | slice) -> "_Rows":
        return _Rows(self.t[kept], self.values[kept], self.rows[kept])


def regular(t: np.ndarray, values: np.ndarray, names: Sequence[str], place: Place) -> Regular:
    """Rows values (N, nc) of the channels `names` with stamps t (N,) [s] as records at a constant rate.

    dt is the mean step, without the rounding of single stamps. Raises InputError with the place of the first fault for stamps
    that cannot be brought to a constant rate, or in more than one way.
    """
    typical = _typical(t)
    if not any(bad_stamps(t, typical)):
        _check_rate(_Rows(t, values, np.arange(len(t))), place)
        return Regular((Piece(t, values),), _mean_step([t]))
    notes: list[str] = []
    table = _Rows(t, values, np.arange(len(t)))
    found = _coarse(table, place, notes) or _mended(table, typical, names, place, notes)
    return Regular(tuple(found), _mean_step([own.t for own in found]), tuple(notes))


def _mended(table: _Rows, typical: float, names: Sequence[str], place: Place, notes: list[str]) -> list[Piece]:
    """Records of stamps that are even but for single faults."""
    table = _once(_caught_up(table, typical, place, notes), notes)
    steps = np.diff(table.t)
    if (steps == 0).any():
        raise _error(place, table, typical)
    breaks = np.flatnonzero((steps < 0) | (steps > GAP * typical)) + 1
    breaks = breaks[~_filled_in(table, breaks, typical, names, notes)]
    pieces = _cut(table, _pieces(table, breaks), typical, place, notes)
    for own in pieces:
        _check_rate(own, place, typical)
    return [_without_holes(own, typical) for own in pieces]


def _pieces(table: _Rows, breaks: np.ndarray) -> list[_Rows]:
    return [table.take(slice(*edges)) for edges in itertools.pairwise([0, *breaks, len(table.t)])]


def _cut(table: _Rows, pieces: list[_Rows], dt: float, place: Place, notes: list[str]) -> list[_Rows]:
    """The pieces of a table without those that are too short; refused where too much would be lost."""
    kept = [own for own in pieces if len(own.t) >= FEWEST] if len(pieces) > 1 else pieces
    lost = sum(len(own.t) for own in pieces) - sum(len(own.t) for own in kept)
    if not kept or lost > LOST * len(table.t) or len(pieces) > PIECES:
        raise _error(place, table, dt)
    if len(pieces) > 1:
        notes.append(_told(pieces, place))
    if lost:
        notes.append(f"{_counted(lost, 'sample')} in pieces of fewer than {FEWEST} left out")
    return kept


def _coarse(table: _Rows, place: Place, notes: list[str]) -> list[Piece]:
    """Records of stamps whose steps are larger than the sample time; none where they have enough digits.

    Stamp s appears first in row k(s) = ceil((s + c) / dt): the line through these rows gives dt, and it must miss none of them by
    more than one row. One row lost in a long record cannot be told from a slightly larger dt; more are.
    """
    steps = np.diff(table.t)
    repeats, forward = int((steps == 0).sum()), steps[steps > 0]
    if repeats < max(FEW, SELDOM * len(steps)) or not len(forward):
        return []
    step = float(np.median(forward))
    breaks = np.flatnonzero((steps < 0) | (steps > 2.5 * step)) + 1
    if len(breaks) > PIECES:
        return []
    certain = repeats > COARSE * len(steps)
    pieces = _pieces(table, breaks)
    lines = [_on_a_line(own) for own in pieces if len(own.t) >= FEWEST or len(pieces) == 1]
    even = [own for own in lines if own]
    if not even or len(even) < len(lines):
        if certain:
            raise _uneven(place, table, step)
        return []
    _cut(table, pieces, step, place, notes)
    dt = _mean_step([own.t for own in even])
    notes.append(f"stamps in steps of {step:.6g} s: samples taken as even, every {dt:.6g} s, within one step of them")
    return even


def _check_rate(table: _Rows, place: Place, dt: float = 0.0) -> None:
    """Refuse stamps whose mean step changes along the record, or whose steps vary much: even samples would be at other times."""
    t = table.t
    window = max(min(WINDOW, len(t) // 3), 1)
    if len(t) >= 3 * FEWEST:
        _check_windows(table, window, place, dt)
    single = np.diff(t) / (dt or np.mean(np.diff(t)))
    if len(t) >= FEWEST and np.std(single - np.where(single > GAP, np.rint(single) - 1.0, 0.0)) > UNEVEN:
        said = f"steps of time vary by {100 * np.std(single):.0f} % of {dt or np.mean(np.diff(t)):.4g} s on the average"
        mend = "sampled at uneven steps? Write it anew at one sample time, interpolated between the samples"
        raise InputError(said, file=place.file, channel=place.channel, mend=mend)


def _check_windows(table: _Rows, window: int, place: Place, dt: float) -> None:
    """Refuse a mean step that is another one in some window of so many samples."""
    t = table.t
    steps = (t[window::window] - t[:-window:window][: len(t[window::window])]) / window
    if dt:  # holes are to be filled in
        holes = np.diff(t) / dt
        extra = np.concatenate([[0.0], np.cumsum(np.where(holes > GAP, np.rint(holes) - 1.0, 0.0))])
        count = window + extra[window::window] - extra[:-window:window][: len(steps)]
        steps = steps * window / count
    off = steps / np.median(steps)
    if off.max() > 1.0 + RATE or off.min() < 1.0 - RATE:
        k = int(np.argmax(np.abs(np.diff(np.log(np.maximum(steps, 1e-300))))))
        row = int(table.rows[(k + 1) * window])
        said = f"the sample time changes: {steps[k]:.4g} s on the average before {place.of(row)}, {steps[k + 1]:.4g} s after it"
        mend = "cut it there into two files, or write it anew at one sample time"
        raise InputError(said, file=place.file, line=place.line(row) if place.line else None, channel=place.channel, mend=mend)


def _typical(t: np.ndarray) -> float:
    steps = np.diff(t)
    typical = float(np.median(steps))
    if typical <= 0:  # most steps are faulty: judge them by the ones that are not
        forward = steps[steps > 0]
        typical = float(np.median(forward)) if len(forward) else 1.0
    return typical


def _mean_step(pieces: Sequence[np.ndarray]) -> float:
    return float(f"{sum(t[-1] - t[0] for t in pieces) / sum(len(t) - 1 for t in pieces):.12g}")


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count > 1)}"


def _caught_up(table: _Rows, dt: float, place: Place, notes: list[str]) -> _Rows:
    """Stamps that came late, with as many samples after them as if they had not, put evenly between their neighbours.

    Refused where many did: such stamps may be right, and the samples uneven.
    """
    t, worst, count = table.t.copy(), 0.0, 0
    for k in np.flatnonzero(np.diff(t) > GAP * dt) + 1:
        if t[k] - t[k - 1] <= GAP * dt:
            continue  # among those that were put in their place
        later = np.arange(1, min(LATE, len(t) - 1 - k) + 1)
        meets = np.abs(t[k + later] - t[k - 1] - (later + 1) * dt) <= 0.5 * dt
        forward = np.cumprod(t[k + later] >= t[k + later - 1]).astype(bool)
        if (meets & forward).any():
            m = int(later[np.argmax(meets & forward)])
            even = np.linspace(t[k - 1], t[k + m], m + 2)[1:-1]
            worst, count = max(worst, float(np.max(np.abs(t[k : k + m] - even)))), count + m
            t[k : k + m] = even
    if count > OFTEN * len(t):
        raise _error(place, table, dt)
    if count:
        came = f"{_counted(count, 'stamp')} that came late"
        notes.append(f"{came}, off by at most {worst:.3g} s, put evenly between those before and after")
    return _Rows(t, table.values, table.rows)


def _once(table: _Rows, notes: list[str]) -> _Rows:
    """Without rows that say the same as the one before, time included."""
    twice = np.zeros(len(table.t), bool)
    twice[1:] = (np.diff(table.t) == 0) & (np.diff(table.values, axis=0) == 0).all(axis=1)
    if not twice.any():
        return table
    notes.append(f"{_counted(int(twice.sum()), 'row')} logged twice left out")
    return table.take(~twice)


def _filled_in(table: _Rows, breaks: np.ndarray, dt: float, names: Sequence[str], notes: list[str]) -> np.ndarray:
    """Which of the breaks (m,) are a few missed samples that straight lines fill in well enough."""
    missed = np.rint((table.t[breaks] - table.t[breaks - 1]) / dt).astype(int) - 1
    short = (missed > 0) & (missed <= MISSED)
    count = int(missed[short].sum())
    if not count or count > FILLED * len(table.t):
        return np.zeros(len(breaks), bool)
    errors, usual = _errors_of_lines(table, int(missed[short].max()), dt)
    jumps = np.abs(table.values[breaks] - table.values[breaks - 1])[short]
    worst = int(np.argmax(errors))
    if not errors[worst] <= MEND or np.any(jumps > JUMP * usual):
        return np.zeros(len(breaks), bool)
    notes.append(
        f"{_counted(count, 'missed sample')} filled in by straight lines, which miss samples that are there by"
        f" {errors[worst]:.2g} standard deviations or less ({names[worst]})"
    )
    return short


def _errors_of_lines(table: _Rows, missed: int, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """RMS by channel (nc,), in its standard deviations, by which lines over so many samples miss the middle one of them; and
    the RMS by which a channel changes over such a line.
    """
    ahead, whole = (missed + 1) // 2, missed + 1
    t, x = table.t, table.values
    first = np.flatnonzero(np.abs(t[whole:] - t[:-whole] - whole * dt) <= 0.5 * dt) if len(t) > whole else np.array([], int)
    if not len(first):
        return np.full(x.shape[1], np.inf), np.zeros(x.shape[1])
    share = ahead / whole
    error = x[first + ahead] - (1.0 - share) * x[first] - share * x[first + whole]
    deviation = x.std(axis=0)
    moves = deviation > ROUNDING * np.abs(x).max(axis=0)
    usual = np.sqrt(np.mean((x[first + whole] - x[first]) ** 2, axis=0))
    return np.where(moves, np.sqrt(np.mean(error**2, axis=0)) / np.where(moves, deviation, 1.0), 0.0), usual


def _without_holes(table: _Rows, dt: float) -> Piece:
    """The rows with straight lines where samples were missed."""
    steps = np.maximum(np.rint(np.diff(table.t) / dt).astype(int), 1)
    at = np.concatenate([[0], np.cumsum(steps)])  # of every row on the grid
    if at[-1] == len(at) - 1:
        return Piece(table.t, table.values)
    grid = np.arange(at[-1] + 1)
    columns = [_on_steps(np.interp(grid, at, column), column) for column in table.values.T]
    return Piece(np.interp(grid, at, table.t), np.column_stack(columns))


def _on_steps(filled: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Values rounded to the steps of those that were measured, where these have steps."""
    q = quantum(measured)
    return (
        filled if q == 0.0 else np.where(np.isin(filled, measured), filled, measured[0] + q * np.rint((filled - measured[0]) / q))
    )


def _on_a_line(table: _Rows) -> Piece | None:
    """Even stamps from the rows in which a new stamp begins; None where some of these are off by more than a row."""
    t = table.t - table.t[0]
    k = np.flatnonzero(np.diff(t) > 0) + 1
    if len(k) < 2:
        return None
    slope = float(np.polyfit(t[k], k, 1)[0]) if len(k) > 2 else float((k[1] - k[0]) / (t[k[1]] - t[k[0]]))
    off = k - slope * t[k]
    if slope <= 0.0 or np.ptp(off) > ROWS_OFF:
        return None
    return Piece(table.t[0] + (np.arange(len(t)) - off.min()) / slope, table.values)


def _uneven(place: Place, table: _Rows, step: float) -> InputError:
    """What to say of stamps with too few digits between which not always the same number of samples was logged."""
    first = np.flatnonzero(np.diff(table.t, prepend=table.t[0] - 1.0) != 0)
    counts = np.diff(first)
    usual = int(np.median(counts))
    k = int(np.argmax(np.abs(counts - usual))) if len(counts) else 0
    row = int(table.rows[first[k]])
    said = f"stamps in steps of {step:.6g} s have {usual} rows each, and {counts[k] if len(counts) else 0} at {place.of(row)}"
    mend = "samples were lost or came unevenly: log the time with more digits, or cut the file there"
    return InputError(said, file=place.file, line=place.line(row) if place.line else None, channel=place.channel, mend=mend)


def _told(pieces: Sequence[_Rows], place: Place) -> str:
    """That the table was cut, and where, in the words of its file."""
    said = []
    for before, after in itertools.islice(itertools.pairwise(pieces), SHOWN):
        step = after.t[0] - before.t[-1]
        where = f"t = {before.t[-1]:.6g} s ({place.of(int(after.rows[0]))})"
        said.append(f"gap of {step:.4g} s after {where}" if step > 0 else f"time goes back to {after.t[0]:.6g} s after {where}")
    more = f", and {len(pieces) - 1 - SHOWN} more" if len(pieces) - 1 > SHOWN else ""
    return f"{', '.join(said)}{more}: cut there into records of their own"


def _error(place: Place, table: _Rows, dt: float) -> InputError:
    """What is wrong with stamps that cannot be mended, by the first fault."""
    faults = list(bad_stamps(table.t, dt))
    bad, gaps = faults[0], sum(own.fault == "gap" for own in faults)
    index = int(table.rows[bad.index])
    line = place.line(index) if place.line else None
    row = place.of(index)
    header = ", the header on top of both" if place.line else ""
    if bad.fault == "gap":
        problem = f"gap of {bad.after - bad.before:.6g} s before t = {bad.after:.10g} s, expected steps of {dt:.6g} s"
        mend = f"cut it there into two files: what comes before {row}, and {row} and what follows{header}"
        if gaps > MANY:
            problem += f", and {gaps - 1} more such gaps"
            mend = f"sampled at uneven steps? Write it anew every {dt:.6g} s, interpolated between the samples"
    elif bad.fault == "repeated":
        problem = f"time stamp {bad.after:.10g} s is repeated, expected steps of {dt:.6g} s"
        mend = "delete the row that was logged twice, or log the time with more digits"
    else:
        problem = f"time goes back from {bad.before:.10g} s to {bad.after:.10g} s"
        mend = "two runs in one file? cut it there into two files; otherwise sort the rows by time"
    if line is None:
        problem = f"sample {index + 1}: {problem}"
    return InputError(problem, file=place.file, line=line, channel=place.channel, mend=mend)
