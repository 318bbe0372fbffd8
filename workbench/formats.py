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

from workbench.data import bad_stamps
from workbench.errors import InputError
from workbench.records import field, record

LOADER = Path(__file__).with_name("loadfile.py")

#: Kinds of files by their suffix, and what is installed for them: gain-scheduling-workbench[excel].
KINDS = {
    ".xlsx": "excel", ".xlsm": "excel", ".mat": "mat", ".parquet": "parquet", ".feather": "feather", ".tdms": "tdms",
    ".mf4": "mdf", ".mdf": "mdf",
}  # fmt: skip
EXTRAS = {"excel": "excel", "mat": "hdf5", "parquet": "parquet", "feather": "parquet", "tdms": "tdms", "mdf": "mdf"}
CALLED = {"excel": "an Excel", "mat": "a MAT", "parquet": "a Parquet", "feather": "a Feather", "tdms": "a TDMS", "mdf": "an MDF"}
MENDS = {"mat": "is the file whole? save with -v7", "excel": "is the file whole? export the sheet as CSV"}
SAME = 1e-9  # of a step, by which stamps of two groups may differ


@record
class Column:
    """A column of a file: its name, its unit where the file says one, and its values."""

    name: str
    unit: str
    values: np.ndarray


@record
class Group:
    """Columns of one length with their stamps t [s]; t is empty where the file has none apart from the columns."""

    t: np.ndarray = field("N")
    columns: tuple[Column, ...]


def loaded(path: Path) -> list[Group] | str:
    """What a file holds: groups of columns, or text. Raises InputError where it cannot be read, with what is to be installed."""
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
        if isinstance(head, str):
            return head
        return [
            Group(
                np.zeros(0) if own["time"] is None else content[f"arr_{own['time']}"],
                tuple(Column(name, unit, content[f"arr_{k}"]) for name, unit, k in own["columns"]),
            )
            for own in head
        ]


def on_one_clock(path: Path, groups: Sequence[Group]) -> tuple[Group, list[str]]:
    """All columns on the stamps of the fastest group, and what was done, in sentences.

    Slower ones are straight lines between their samples, within the time that all groups cover. Raises InputError for groups
    that share no time, and for gaps in slower ones, over which nothing is drawn.
    """
    groups = [own for own in groups if len(own.t) > 2 and own.columns]
    if not groups:
        raise InputError("holds no numbers over time", file=path, mend="is the file whole?")
    base = min(groups, key=_step)
    low, high = max(own.t[0] for own in groups), min(own.t[-1] for own in groups)
    within = (base.t >= low - SAME * _step(base)) & (base.t <= high + SAME * _step(base))
    if within.sum() < 3:
        mend = "save the channels that belong together in a file of their own"
        raise InputError("its groups of channels share no time", file=path, mend=mend)
    t, columns, slower = base.t[within], [], []
    for own in groups:
        same = len(own.t) == len(base.t) and np.abs(own.t - base.t).max() <= SAME * _step(base)
        if not same:
            bad = next(bad_stamps(own.t, _step(own)), None)
            if bad:
                names = ", ".join(c.name for c in own.columns)
                mend = "leave these channels out, or cut the file there"
                raise InputError(f"{bad.fault} stamp at {bad.after:g} s", file=path, channel=names, mend=mend)
            slower.append(f"{', '.join(c.name for c in own.columns)} (every {_step(own):.4g} s)")
        for c in own.columns:
            columns.append(Column(c.name, c.unit, c.values[within] if same else np.interp(t, own.t, c.values)))
    notes = [f"straight lines between the samples of {'; '.join(slower)}"] if slower else []
    if not within.all():
        notes.append(f"taken from {low:g} to {high:g} s, where all channels are")
    return Group(t, tuple(columns)), notes


def _step(group: Group) -> float:
    return float(np.median(np.diff(group.t)))
