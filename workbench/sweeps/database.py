"""The SQLite file of a sweep, which is whole after a kill at any moment.

    about      name, value: the sweep as it was asked for, its configuration hash, versions
    columns    name, kind (parameter or output), unit
    runs       run, seed, a column for each parameter and output, error ("" where the run came to an end)
    timing     run, seconds: apart, for rows of two computers shall be equal

One process writes to it at a time, a block of rows or nothing of it.
"""

import fcntl
import hashlib
import json
import math
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from workbench.errors import InputError
from workbench.provenance import versions
from workbench.sweeps.design import Factor, Point, Sweep
from workbench.sweeps.job import Job

WAITED = 10.0  # s that another process is waited for which has locked the file


def configuration(sweep: Sweep, job: Job) -> str:
    """What rows must share to stand in one file: a hash of the sweep, of the job and of the versions of all that computes."""
    asked = [sweep.content(), job.configuration, job.units, job.outputs, versions()]
    return hashlib.sha256(json.dumps(asked, sort_keys=True, default=_plain).encode()).hexdigest()[:16]


def _plain(value: Any) -> Any:
    return dict(value) if isinstance(value, Mapping) else list(value)


@contextmanager
def opened(database: Path, sweep: Sweep, job: Job, outputs: Mapping[str, str], resume: bool) -> Iterator[sqlite3.Connection]:
    """The file, made where there is none, and nobody else's while it is open."""
    if database.exists() and not resume:
        raise InputError("holds a sweep already", file=database, mend="--resume finishes it; or choose another --out folder")
    if resume and not database.exists():
        raise InputError("there is nothing to resume", file=database, mend="leave --resume out, or give the folder of that sweep")
    try:
        database.parent.mkdir(parents=True, exist_ok=True)
        # beside the database: closing a descriptor of its own would drop what SQLite has locked
        handle = os.open(f"{database}.lock", os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as reason:
        raise InputError(f"cannot write: {reason.strerror}", file=database, mend="choose another --out folder") from None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise InputError("another process writes to this sweep", file=database, mend="wait for it, or stop it") from None
    try:
        with closing(connected(database)) as connection:
            _prepared(connection, database, sweep, job, outputs)
            yield connection
    except sqlite3.Error as reason:
        mend = "stop what else writes to it" if "locked" in str(reason) else "free some space"
        raise InputError(f"cannot be written: {reason}", file=database, mend=f"{mend}, then --resume") from None
    finally:
        os.close(handle)


def connected(database: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(database, isolation_level=None, timeout=WAITED)
    try:
        connection.execute("SELECT * FROM sqlite_master")
    except sqlite3.OperationalError as reason:
        connection.close()
        raise InputError(f"cannot be read: {reason}", file=database, mend="try again when nobody writes to it") from None
    except sqlite3.DatabaseError as reason:
        connection.close()
        raise InputError(f"no database: {reason}", file=database, mend="give the file that a sweep has written") from None
    return connection


def _prepared(connection: sqlite3.Connection, database: Path, sweep: Sweep, job: Job, outputs: Mapping[str, str]) -> None:
    """The tables: made at once or not at all; those of another sweep are refused."""
    connection.execute("PRAGMA journal_mode=WAL")  # who reads does not stop who writes, nor the other way round
    wanted = configuration(sweep, job)
    if connection.execute("SELECT COUNT(*) FROM sqlite_master WHERE name = 'about'").fetchone()[0]:
        held = dict(connection.execute("SELECT name, value FROM about"))
        if held.get("configuration") != wanted:
            raise InputError(
                f"holds rows of another sweep, job or version ({held.get('configuration')}, now {wanted})",
                file=database, mend="resume with the sweep file and the workbench that began it, or choose another --out folder",
            )  # fmt: skip
        return
    units = {p.name: (job.units.get(p.name, ""), _kind_of(p)) for p in sweep.factors}
    with _whole(connection):
        connection.execute("CREATE TABLE about (name TEXT PRIMARY KEY, value TEXT NOT NULL)")
        connection.execute("CREATE TABLE columns (name TEXT PRIMARY KEY, kind TEXT NOT NULL, unit TEXT NOT NULL)")
        own = [f"{_quoted(name)} {sort}" for name, (_, sort) in units.items()] + [f"{_quoted(name)} REAL" for name in outputs]
        listed = ", ".join(["run INTEGER PRIMARY KEY", "seed INTEGER NOT NULL", *own, "error TEXT NOT NULL"])
        connection.execute(f"CREATE TABLE runs ({listed})")
        connection.execute("CREATE TABLE timing (run INTEGER PRIMARY KEY, seconds REAL NOT NULL)")
        about = {
            "sweep": json.dumps(sweep.content(), default=_plain),
            "configuration": wanted,
            "versions": json.dumps(versions()),
        }
        connection.executemany("INSERT INTO about VALUES (?, ?)", about.items())
        rows = [(name, "parameter", unit) for name, (unit, _) in units.items()] + [(n, "output", u) for n, u in outputs.items()]
        connection.executemany("INSERT INTO columns VALUES (?, ?, ?)", rows)


def _kind_of(factor: Factor) -> str:
    """The type of its column; none, which changes no value, where numbers and texts are mixed."""
    return "" if any(isinstance(value, str) for value in factor.values) else "REAL"


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


@contextmanager
def _whole(connection: sqlite3.Connection) -> Iterator[None]:
    """All of it or nothing."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
    except BaseException:
        connection.execute("ROLLBACK")
        raise
    connection.execute("COMMIT")


def put(
    connection: sqlite3.Connection, block: Sequence[Point], answers: Sequence[Any], seconds: float,
    names: Sequence[str], outputs: Sequence[str],
) -> None:  # fmt: skip
    """The rows of a block, all or none; an output that is no number, or is missing, is NULL."""
    rows = []
    for point, answer in zip(block, answers, strict=True):
        found = {} if isinstance(answer, str) else answer
        numbers = [value if math.isfinite(value := found.get(name, math.nan)) else None for name in outputs]
        error = answer if isinstance(answer, str) else ""
        rows.append((point.run, point.seed, *(point.values[name] for name in names), *numbers, error))
    marks = ", ".join("?" * (3 + len(names) + len(outputs)))
    with _whole(connection):
        connection.executemany(f"INSERT INTO runs VALUES ({marks})", rows)
        connection.executemany("INSERT INTO timing VALUES (?, ?)", [(point.run, seconds / len(block)) for point in block])
