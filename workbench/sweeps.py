"""Sweeps: one question asked of many sets of values, each answer a row in a file as soon as it is there.

A sweep is a table of points: every set of parameter values, once for each seed. `Sweep.points` is the same list whenever it is
asked, and a run's number is its place in it: what a process that was killed has left undone is what has no row yet.

Rows stand in an SQLite file, which is whole after a kill at any moment:

    about      name, value: the sweep as it was asked for, its configuration hash, versions
    columns    name, kind (parameter or output), unit
    runs       run, seed, a column for each parameter and output, error ("" where the run came to an end)
    timing     run, seconds: apart, for rows of two computers shall be equal
"""

import fcntl
import hashlib
import io
import itertools
import json
import math
import os
import sqlite3
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from workbench.errors import InputError, check_known
from workbench.files import write_bytes, write_text
from workbench.progress import Progress, Steps, silent
from workbench.provenance import versions
from workbench.records import field, record
from workbench.toml import Table, kind, read_toml

__all__ = ["load_sweep", "read_rows", "run_sweep"]  # for users; the rest is for the workbench

DRAWN = ("random", "latin-hypercube", "sobol", "morris", "sobol-indices")
DESIGNS = ("grid", "list", *DRAWN)
LEVELS = 4  # of a factor on a Morris trajectory
LONGEST, MOST = 256, 1_000_000  # runs of a block, and of a sweep
BLOCK, WAITED = 0.5, 10.0  # s that a block of runs should take, and that a scheduler is waited for
KEYS = ("run", "design", "count", "seed", "seeds", "outputs", "parameters", "fixed")
PARAMETER = ("values", "low", "high", "count", "scale")


class StoppedError(InputError):
    """What a job raises where no run makes sense any more: it ends the sweep and is nobody's row."""


PASSING = (MemoryError, ImportError, StoppedError)  # what ends the sweep: the same run may come to an end another time


@record
class Factor:
    """What varies: `values`, numbers or texts, or what lies from low to high, with log evenly in its logarithm.

    count: levels that a grid takes of a range.
    """

    name: str
    values: tuple[float | str, ...] = ()
    low: float = field("", default=0.0)
    high: float = field("", default=0.0)
    count: int = 0
    log: bool = False

    def at(self, share: float) -> float | str:
        """The value at a share in [0, 1] of the range, or of the list of values."""
        if self.values:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        if share in (0.0, 1.0):
            return self.high if share else self.low
        if self.log:
            value = math.exp((1.0 - share) * math.log(self.low) + share * math.log(self.high))
        else:
            value = (1.0 - share) * self.low + share * self.high
        return min(max(value, self.low), self.high)

    @property
    def levels(self) -> tuple[float | str, ...]:
        """What a grid takes of it."""
        return self.values or tuple(self.at(share) for share in np.linspace(0.0, 1.0, self.count).tolist())


@record
class Point:
    """One run: its number in the sweep, its seed, and a value for each parameter."""

    run: int
    seed: int
    values: Mapping[str, float | str]


@record
class Sweep:
    """What to run (`run`, by name) with which values; see `load_sweep` for the file.

    fixed: what stays, as `run` understands it.
    """

    run: str
    factors: tuple[Factor, ...]
    design: str = "grid"
    count: int = 0
    seed: int = 0
    seeds: tuple[int, ...] = (0,)
    outputs: tuple[str, ...] = ()
    fixed: Mapping[str, Any] = field(default_factory=dict)

    def points(self) -> list[Point]:
        """Every run of the sweep, the same whenever it is asked."""
        names = [p.name for p in self.factors]
        sets = [dict(zip(names, values, strict=True)) for values in self._sets()]
        runs = len(sets) * len(self.seeds)
        if runs > MOST:
            raise InputError(f"{runs} runs", mend=f"at most {MOST}: fewer levels, or a random design")
        return [Point(i, seed, own) for i, (own, seed) in enumerate(itertools.product(sets, self.seeds))]

    def _sets(self) -> list[tuple[float | str, ...]]:
        if self.design == "grid":
            sizes = [len(p.values) or p.count for p in self.factors]
            if math.prod(sizes) > MOST:
                raise InputError(f"a grid of {math.prod(sizes)} points", mend=f"at most {MOST}: fewer levels, or a random design")
            return list(itertools.product(*(p.levels for p in self.factors)))
        if self.design == "list":
            return list(zip(*(p.values for p in self.factors), strict=True))
        return [tuple(p.at(float(s)) for p, s in zip(self.factors, row, strict=True)) for row in self.shares()]

    def shares(self) -> np.ndarray:
        """(sets, factors) in [0, 1]: where a drawn design takes each factor.

        Of `count` Morris trajectories or Sobol base points there are count (factors + 1) or count (factors + 2) sets.
        """
        from scipy.stats import qmc

        n, random = len(self.factors), np.random.default_rng(self.seed)
        match self.design:
            case "random":
                return random.uniform(size=(self.count, n))
            case "latin-hypercube":
                return qmc.LatinHypercube(n, rng=random).random(self.count)
            case "sobol":
                return qmc.Sobol(n, rng=random).random_base2(math.ceil(math.log2(self.count)))[: self.count]
            case "morris":
                from SALib.sample.morris import sample

                return np.asarray(sample(self.problem, self.count, num_levels=LEVELS, seed=random))
            case _:
                from SALib.sample.sobol import sample

                return np.asarray(sample(self.problem, self.count, calc_second_order=False, seed=random))

    @property
    def problem(self) -> dict[str, Any]:
        """The factors as SALib wants them, each from 0 to 1."""
        return {
            "num_vars": len(self.factors),
            "names": [p.name for p in self.factors],
            "bounds": [[0.0, 1.0]] * len(self.factors),
        }

    def content(self) -> dict[str, Any]:
        """The sweep in plain values."""
        return {**vars(self), "factors": [vars(p) for p in self.factors], "fixed": dict(self.fixed)}


def load_sweep(path: str | Path) -> Sweep:
    """Read a sweep from TOML; what is unknown, missing or makes no sense is refused with key, what was expected and the mend.

    run: what is done with each set of values. design, count: grid (default), list, or one that is drawn from `seed`: random,
    latin-hypercube or sobol, and how many sets; morris or sobol-indices, whose outputs tell what each factor does, and how many
    trajectories or base points (a power of two). seeds: each set once for every one. [parameters.NAME]: values, or low and high,
    with scale = "log" for one that varies by factors, and count levels in a grid. outputs: those wanted, by default all. [fixed]:
    what stays.

        >>> [point.values for point in load_sweep("sweep.toml").points()]
        [{'J': 0.001}, {'J': 0.002}, {'J': 0.004}]
    """
    top = read_toml(path, KEYS)
    run, design = top.text("run", None), check_known("design", top.text("design", "grid"), DESIGNS, file=path)
    named = top.table("parameters", None)
    if not named.content:
        raise InputError("nothing varies", file=path, mend="give [parameters.NAME] with values = [..], or low and high")
    factors = tuple(_factor(named.table(name, PARAMETER), name, design) for name in named.content)
    count = top.whole("count", 0)
    if design in ("grid", "list") and count:
        raise top.refused("count", str(count), f"a {design} has as many points as its values make: leave it out")
    if count > MOST:
        raise top.refused("count", str(count), f"at most {MOST}")
    if design == "sobol-indices" and count & (count - 1):
        raise top.refused("count", str(count), f"a power of two: {2 ** (count.bit_length() - 1)} or {2 ** count.bit_length()}")
    if design in ("morris", "sobol-indices") and len(factors) < 2:
        raise InputError(f"design {design} with one parameter", file=path, mend="give two or more: their effects are compared")
    if design == "morris" and (odd := [p for p in factors if p.values and len(p.values) not in (2, LEVELS)]):
        problem = f"{odd[0].name} has {len(odd[0].values)} values, a Morris trajectory takes 2 or {LEVELS}"
        raise InputError(problem, file=path, mend="give 2 or 4 values, or low and high")
    if design in ("morris", "sobol-indices") and count == 1:
        raise top.refused("count", "1", "two or more, usual are 10 to 50 trajectories, 256 to 4096 base points")
    if design not in ("grid", "list") and count < 1:
        raise InputError(f"design {design} without count", file=path, mend="give count = 100, the sets of values to draw")
    lengths = {len(p.values) for p in factors}
    if design == "list" and len(lengths) > 1:
        said = ", ".join(f"{p.name} {len(p.values)}" for p in factors)
        raise InputError(f"a list of values of different lengths: {said}", file=path, mend="one value of each for every run")
    seeds = top.content.get("seeds", [top.whole("seed", 0)])
    if (
        not isinstance(seeds, list)
        or not seeds
        or not all(type(s) is int and 0 <= s < 2**63 for s in seeds)
        or len({*seeds}) < len(seeds)
    ):
        raise top.refused("seeds", kind(seeds), "expected whole numbers from 0 on, each once: seeds = [1, 2, 3]")
    fixed = top.table("fixed", None).content
    return Sweep(run, factors, design, count, top.whole("seed", 0), tuple(seeds), top.texts("outputs", ()), fixed)


def _factor(own: Table, name: str, design: str) -> Factor:
    given, low, high = own.content.get("values"), own.number("low"), own.number("high")
    if given is not None:
        if not isinstance(given, list) or not given or not all(_is_value(v) for v in given):
            raise own.refused("values", kind(given), "expected numbers or texts: values = [0.5, 1.0, 2.0]")
        if other := [key for key in own.content if key != "values"]:
            raise own.refused(other[0], kind(own.content[other[0]]), "leave it out: the values are given")
        return Factor(name, tuple(v if isinstance(v, str) else float(v) for v in given))
    if low is None or high is None or design == "list":
        mend = "give values = [..]" + ("" if design == "list" else ", or low and high")
        raise InputError(f"[{own.name}] has no values", file=own.file, mend=mend)
    if not low < high:
        raise own.refused("high", f"{high:g}", f"expected more than low = {low:g}")
    scale = check_known("scale", own.text("scale", "linear"), ("linear", "log"), file=own.file)
    if scale == "log" and low <= 0.0:
        raise own.refused("low", f"{low:g}", "expected a number above 0 for a logarithmic scale")
    count = own.whole("count", 0)
    if design == "grid" and count < 2:
        raise InputError(f"[{own.name}] has no levels", file=own.file, mend="give count = 5, or values = [..]")
    if design != "grid" and count:
        raise own.refused("count", str(count), f"levels belong to a grid, the design is {design}: leave it out")
    return Factor(name, (), low, high, count, scale == "log")


def _is_value(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return isinstance(value, str) or number


# ---- running it ---------------------------------------------------------------------------------------------------------------


class Job(Protocol):
    """What a sweep runs. It is sent to other processes as it is, and must give the same answers there."""

    @property
    def configuration(self) -> Mapping[str, Any]:
        """What its answers depend on beside the points, in plain values: the content of files rather than their names."""
        ...

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of every parameter, by name."""
        ...

    @property
    def outputs(self) -> Mapping[str, str]:
        """Unit of every output, by name."""
        ...

    def on_threads(self, count: int) -> "Job | None":
        """The same job on threads of this process, where it is as fast on them as on as many processes; else None."""
        ...

    def __call__(self, points: Sequence[Point]) -> list[Mapping[str, float] | Exception]:
        """The outputs of each, or why there are none. A run's answer must not depend on which others are beside it."""
        ...


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
    with _opened(database, sweep, job, outputs, resume) as connection:
        have = {run for (run,) in connection.execute("SELECT run FROM runs")}
        todo = [point for point in points if point.run not in have]
        steps = Steps(progress, len(points), "runs", before=len(points) - len(todo))
        threaded = job.on_threads(jobs) if jobs > 1 and scheduler is None else None
        for block, answers, seconds in _answers(threaded or job, todo, 1 if threaded else jobs, scheduler):
            _put(connection, block, answers, seconds, names, tuple(outputs))
            steps.done(len(block), aside=_failures(connection))
        total, failed = connection.execute("SELECT COUNT(*), COUNT(NULLIF(error, '')) FROM runs").fetchone()
    return Swept(total, failed, steps.made, time.monotonic() - began)


def _failures(connection: sqlite3.Connection) -> str:
    (failed,) = connection.execute("SELECT COUNT(*) FROM runs WHERE error != ''").fetchone()
    return f"{failed} failed" if failed else ""


def _answers(
    job: Job, todo: Sequence[Point], jobs: int, scheduler: str | None
) -> Iterator[tuple[Sequence[Point], list[Any], float]]:
    """Blocks of points with their answers, in the order in which they are done; blocks grow to BLOCK seconds."""
    if not todo:
        return
    with _workers(jobs, scheduler) as (count, spread):
        size, taken = [1], [0]

        def blocks() -> Iterator[Sequence[Point]]:
            while taken[0] < len(todo):
                own = todo[taken[0] : taken[0] + size[0]]
                taken[0] += len(own)
                yield own

        for block, answers, seconds in spread(job, blocks()):
            fair = max(1, (len(todo) - taken[0]) // (2 * count)) if count > 1 else LONGEST  # the last ones end together
            size[0] = max(1, min(LONGEST, fair, 2 * len(block), round(BLOCK * len(block) / max(seconds, 1e-6))))
            yield block, answers, seconds


@contextmanager
def _workers(jobs: int, scheduler: str | None) -> Iterator[tuple[int, Callable[[Job, Iterable[Sequence[Point]]], Iterable[Any]]]]:
    """How many run side by side, and what sends them blocks and gives the answers."""
    if jobs == 1 and scheduler is None:
        yield 1, lambda job, blocks: (_block(job, block) for block in blocks)
        return
    from joblib import Parallel, delayed, parallel_config

    def spread(job: Job, blocks: Iterable[Sequence[Point]], count: int) -> Iterable[Any]:
        pool: Any = Parallel(n_jobs=count, return_as="generator_unordered", pre_dispatch=f"2 * {count}")
        return pool(delayed(_block)(job, block) for block in blocks)

    if scheduler is None:
        from joblib.externals.loky.process_executor import TerminatedWorkerError

        try:
            yield jobs, partial(spread, count=jobs)
        except TerminatedWorkerError:
            mend = "--resume --jobs 1 goes on, and shows at which run; is there enough memory?"
            raise InputError("a run has ended its whole process", file="sweep", mend=mend) from None
        return
    with _cluster(scheduler) as count, parallel_config(backend="dask"):
        yield count, partial(spread, count=count)


@contextmanager
def _cluster(scheduler: str) -> Iterator[int]:
    """Threads of all workers of a Dask scheduler, which must have this very software, and be asked by joblib from now on."""
    try:
        from distributed import Client
    except ImportError:
        mend = 'python -m pip install "gain-scheduling-workbench[cluster]"'
        raise InputError("Dask is not installed", file=scheduler, mend=mend) from None
    try:
        client: Any = Client(scheduler, timeout=WAITED)
    except (OSError, ValueError, TypeError) as reason:
        mend = "start one with `dask scheduler`, and give the address that it prints: tcp://HOST:8786"
        raise InputError(f"no Dask scheduler: {reason}", file=scheduler, mend=mend) from None
    with client:
        threads = sum(client.nthreads().values())
        if not threads:
            raise InputError("the scheduler has no workers", file=scheduler, mend=f"start some: dask worker {scheduler}")
        for worker, theirs in client.run(versions).items():
            if other := [f"{name} {theirs.get(name)}, here {own}" for name, own in versions().items() if theirs.get(name) != own]:
                mend = "install the same versions there: rows would not be those of one machine"
                raise InputError(f"worker {worker} has {'; '.join(other)}", file=scheduler, mend=mend)
        yield threads


def _block(job: Job, block: Sequence[Point]) -> tuple[Sequence[Point], list[Any], float]:
    """One block, with BLAS on one thread; what goes wrong for all of them is looked for in each by itself."""
    from threadpoolctl import threadpool_limits

    began = time.perf_counter()
    with threadpool_limits(1):
        try:
            answers = job(block)
        except PASSING:
            raise
        except Exception as reason:
            answers = [_alone(job, point) for point in block] if len(block) > 1 else [reason]
    plain = [_said(a) if isinstance(a, Exception) else {k: float(v) for k, v in a.items()} for a in answers]
    return block, plain, time.perf_counter() - began


def _alone(job: Job, point: Point) -> Any:
    try:
        return job([point])[0]
    except PASSING:
        raise
    except Exception as reason:
        return reason


def _said(reason: Exception) -> str:
    text = str(reason) or type(reason).__name__
    return text if isinstance(reason, InputError) else f"{type(reason).__name__}: {text}"


# ---- the file -----------------------------------------------------------------------------------------------------------------


def configuration(sweep: Sweep, job: Job) -> str:
    """What rows must share to stand in one file: a hash of the sweep, of the job and of the versions of all that computes."""
    asked = [sweep.content(), job.configuration, job.units, job.outputs, versions()]
    return hashlib.sha256(json.dumps(asked, sort_keys=True, default=_plain).encode()).hexdigest()[:16]


def _plain(value: Any) -> Any:
    return dict(value) if isinstance(value, Mapping) else list(value)


@contextmanager
def _opened(database: Path, sweep: Sweep, job: Job, outputs: Mapping[str, str], resume: bool) -> Iterator[sqlite3.Connection]:
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
        with closing(_connected(database)) as connection:
            _prepared(connection, database, sweep, job, outputs)
            yield connection
    except sqlite3.Error as reason:
        mend = "stop what else writes to it" if "locked" in str(reason) else "free some space"
        raise InputError(f"cannot be written: {reason}", file=database, mend=f"{mend}, then --resume") from None
    finally:
        os.close(handle)


def _connected(database: Path) -> sqlite3.Connection:
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


def _put(
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
    with closing(_connected(Path(database))) as connection:
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
