"""Files that are no text, by well-kept readers in a process of their own, and several rates of one file on the stamps of one.

runs.xlsx           the one sheet with numbers, as text       openpyxl
runs.mat            variables; version 7.3 is HDF5            scipy, h5py
runs.parquet        columns; .feather too                     pyarrow
runs.tdms           groups and waveforms of LabVIEW           npTDMS
runs.mf4            channel groups of MDF 4 and 3             asammdf
"""

import io
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from workbench.errors import InputError
from workbench.records import field, record
from workbench.stamps import Place, Regular, regular

LOADER = Path(__file__).with_name("loadfile.py")

#: Kinds of files by their suffix, and what is installed for them: gain-scheduling-workbench[excel].
KINDS = {
    ".xlsx": "excel", ".xlsm": "excel", ".mat": "mat", ".parquet": "parquet", ".feather": "feather", ".tdms": "tdms",
    ".mf4": "mdf", ".mdf": "mdf",
}  # fmt: skip
EXTRAS = {"excel": "excel", "mat": "hdf5", "parquet": "parquet", "feather": "parquet", "tdms": "tdms", "mdf": "mdf"}
CALLED = {"excel": "an Excel", "mat": "a MAT", "parquet": "a Parquet", "feather": "a Feather", "tdms": "a TDMS", "mdf": "an MDF"}
MENDS = {"mat": "is the file whole? save with -v7", "excel": "is the file whole? export the sheet as CSV"}
SAME = 1e-6  # of a step, by which stamps of two groups may differ
FEWEST = 5  # samples of a group that is no list of events
SHARE = 0.5  # of the longest group's time, that others must cover


@record
class Column:
    """A column of a file: its name, its unit where the file says one, and its values."""

    name: str
    unit: str
    values: np.ndarray


@record
class Group:
    """Columns of one length with their stamps t [s]; t is empty where the file has none apart from the columns.

    left: names of what is no column of numbers.
    """

    t: np.ndarray = field("N")
    columns: tuple[Column, ...]
    left: tuple[str, ...] = ()


@record
class Sheet:
    """A spreadsheet as text, and what is to be said of it."""

    text: str
    notes: tuple[str, ...]


def loaded(path: Path) -> list[Group] | Sheet:
    """What a file holds: groups of columns, or a sheet. Raises InputError where it cannot be read."""
    kind = KINDS[path.suffix.lower()]
    done = subprocess.run([sys.executable, "-I", str(LOADER), kind, str(path)], capture_output=True, check=False)
    if done.returncode:
        lines = done.stderr.decode(errors="replace").strip().splitlines()
        reason = lines[-1] if lines and done.returncode > 0 else "crash of its reader"
        if reason.startswith("needs "):
            mend = f"pip install 'gain-scheduling-workbench[{EXTRAS[kind]}]'"
            raise InputError(f"{reason}, which is not installed", file=path, mend=mend)
        mend = MENDS.get(kind, "is the file whole?")
        raise InputError(f"cannot be read as {CALLED[kind]} file ({reason})", file=path, mend=mend)
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as content:
        head = json.loads(str(content["arr_0"]))
        if isinstance(head, dict):
            return Sheet(head["text"], tuple(head["notes"]))
        found = [
            (
                np.zeros(0) if own["time"] is None else content[f"arr_{own['time']}"],
                tuple(Column(name, unit, content[f"arr_{k}"]) for name, unit, k in own["columns"]),
                tuple(own["left"]),
            )
            for own in head
        ]
    for t, columns, _ in found:
        if not np.isfinite(t).all():
            first = int(np.flatnonzero(~np.isfinite(t))[0])
            names = ", ".join(c.name for c in columns)
            raise InputError(f"sample {first + 1} of {names} has no time", file=path, mend="delete the row, or give it its time")
    return [Group(*own) for own in found]


def on_one_clock(path: Path, groups: Sequence[Group]) -> tuple[Group, list[str]]:
    """All columns on the stamps of the fastest group, and what was done, in sentences.

    Each group is brought to a constant rate first. Slower ones are straight lines between their samples, within the time that all
    groups cover. Left out, and said so, are groups that are much shorter than the longest, and slower ones with gaps, over which
    nothing is drawn.
    """
    own = [group for group in groups if len(group.t) and group.columns]
    if len(own) == 1:
        return own[0], []
    longest = max((group.t[-1] - group.t[0] for group in own), default=0.0)
    notes: list[str] = []
    kept: list[tuple[Regular, Group]] = []
    for group in own:
        names = ", ".join(c.name for c in group.columns)
        if len(group.t) < FEWEST or group.t[-1] - group.t[0] < SHARE * longest:
            notes.append(f"{names}: {len(group.t)} samples only, left out")
            continue
        place = Place(path, f"time of {names}")
        values = np.column_stack([_finite(path, c) for c in group.columns])
        try:
            kept.append((regular(group.t, values, [c.name for c in group.columns], place), group))
        except InputError as reason:
            notes.append(f"{names}: left out ({reason.problem})")
    if not kept:
        raise InputError("; ".join(notes) or "holds no numbers over time", file=path, mend="is the file whole?")
    base = min(kept, key=lambda pair: pair[0].dt)
    t = np.concatenate([piece.t for piece in base[0].pieces])
    if (np.diff(t) <= 0).any():
        raise InputError("time goes back", file=path, channel=base[1].columns[0].name, mend="cut the file there")
    stay = []
    for found, group in kept:
        if len(found.pieces) > 1 and found is not base[0] and not _on(found, t):
            notes.append(f"{', '.join(c.name for c in group.columns)}: left out, for nothing is drawn over gaps")
        else:
            stay.append((found, group))
    kept = stay
    low, high = (end(p.pieces[k].t[k] for p, _ in kept) for end, k in ((max, 0), (min, -1)))
    within = (t >= low - SAME * base[0].dt) & (t <= high + SAME * base[0].dt)
    if within.sum() < 3:
        mend = "save the channels that belong together in a file of their own"
        raise InputError("its groups of channels share no time", file=path, mend=mend)
    columns: list[Column] = []
    slower: list[str] = []
    for found, group in kept:
        names = ", ".join(c.name for c in group.columns)
        stamps = np.concatenate([piece.t for piece in found.pieces])
        values = np.vstack([piece.values for piece in found.pieces])
        notes += [f"{names}: {note}" for note in found.notes]
        same = _on(found, t)
        if not same:
            slower.append(f"{names} (every {found.dt:.4g} s)")
        for j, c in enumerate(group.columns):
            columns.append(Column(c.name, c.unit, values[within, j] if same else np.interp(t[within], stamps, values[:, j])))
    notes += [f"straight lines between the samples of {'; '.join(slower)}"] if slower else []
    if not within.all():
        notes.append(f"taken from {low:g} to {high:g} s, where all channels are")
    return Group(t[within], tuple(columns)), notes


def _on(found: Regular, t: np.ndarray) -> bool:
    """Whether these are the stamps t (N,)."""
    stamps = np.concatenate([piece.t for piece in found.pieces])
    return len(stamps) == len(t) and bool(np.abs(stamps - t).max() <= SAME * found.dt)


def _finite(path: Path, column: Column) -> np.ndarray:
    bad = np.flatnonzero(~np.isfinite(column.values))
    if len(bad):
        mend = "repair the value, or leave the channel out"
        raise InputError(f"sample {bad[0] + 1} is no valid number", file=path, channel=column.name, mend=mend)
    return column.values
