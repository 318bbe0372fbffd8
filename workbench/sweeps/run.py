"""A row for every point: blocks under way, the share that is done, resuming."""

import sqlite3
import time
from collections import Counter
from pathlib import Path

from workbench.errors import InputError, check_known
from workbench.progress import Progress, Steps, silent
from workbench.records import record
from workbench.sweeps.database import opened, put
from workbench.sweeps.design import Sweep
from workbench.sweeps.job import Job
from workbench.sweeps.workers import answered


@record
class Swept:
    """runs: rows that the file holds now; failed: of these; made: by this call; seconds: wall time of this call."""

    runs: int
    failed: int
    made: int
    seconds: float


def run_sweep(
    sweep: Sweep,
    job: Job,
    database: str | Path,
    *,
    resume: bool = False,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Progress = silent,
) -> Swept:
    """A row for every point, `jobs` processes or threads side by side; resume: those that `database` holds are not run again.

    scheduler: address of a Dask scheduler, whose workers then run it instead; a block whose worker dies goes to another one.

    A run that fails is a row with its error. Killed at any moment, only the blocks under way are lost: single runs, or as many as
    take half a second. Raises InputError for a file that exists (without resume), that another sweep, job or version wrote, or
    that another process writes to.

        >>> done = run_sweep(load_sweep("sweep.toml"), TimeConstant(), "sweep.sqlite")
        >>> done.runs, done.failed
        (3, 0)
    """
    database, began = Path(database), time.monotonic()
    names = tuple(p.name for p in sweep.factors)
    for name in sweep.outputs:
        check_known("output", name, job.outputs)
    outputs = {name: unit for name, unit in job.outputs.items() if not sweep.outputs or name in sweep.outputs}
    columns = Counter(name.casefold() for name in (*names, *outputs, "run", "seed", "error"))
    if doubled := [name for name in names if columns[name.casefold()] > 1]:
        raise InputError(f"{', '.join(sorted(doubled))} is the name of another column", mend="give the parameter another name")
    points = sweep.points()
    with opened(database, sweep, job, outputs, resume) as connection:
        have = {run for (run,) in connection.execute("SELECT run FROM runs")}
        todo = [point for point in points if point.run not in have]
        steps = Steps(progress, len(points), "runs", before=len(points) - len(todo))
        threaded = job.on_threads(jobs) if jobs > 1 and scheduler is None else None
        for block, answers, seconds in answered(threaded or job, todo, 1 if threaded else jobs, scheduler):
            put(connection, block, answers, seconds, names, tuple(outputs))
            steps.done(len(block), aside=_failures(connection))
        total, failed = connection.execute("SELECT COUNT(*), COUNT(NULLIF(error, '')) FROM runs").fetchone()
    return Swept(total, failed, steps.made, time.monotonic() - began)


def _failures(connection: sqlite3.Connection) -> str:
    (failed,) = connection.execute("SELECT COUNT(*) FROM runs WHERE error != ''").fetchone()
    return f"{failed} failed" if failed else ""
