"""Sweeps: the same points whenever they are asked for, a row for each, and nothing lost or done twice by whatever is killed."""

import csv
import json
import math
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import qmc

from workbench.errors import InputError
from workbench.records import record
from workbench.sweeps.design import Factor, Sweep, load_sweep
from workbench.sweeps.job import StoppedError
from workbench.sweeps.rows import export_csv, read_rows
from workbench.sweeps.run import run_sweep


@record
class Areas:
    """area = a b (1 + seed); a below 0 has none, a above 90 fails for everybody beside it."""

    pause: float = 0.0
    scale: float = 1.0

    @property
    def configuration(self) -> Mapping[str, float]:
        return {"scale": self.scale}

    @property
    def units(self) -> Mapping[str, str]:
        return {"a": "m", "b": "m"}

    @property
    def outputs(self) -> Mapping[str, str]:
        return {"area": "m^2", "root of a": "m^0.5"}

    def on_threads(self, count):
        return None  # what it counts is told by processes

    def __call__(self, points):
        time.sleep(self.pause * len(points))
        if any(point.values["a"] > 90.0 for point in points):
            raise ZeroDivisionError("beyond 90")
        return [
            InputError("no area", file="Areas", mend="a from 0 on") if p.values["a"] < 0.0
            else {"area": self.scale * p.values["a"] * p.values["b"] * (1 + p.seed), "root of a": math.nan}
            for p in points
        ]  # fmt: skip


class Free(Areas):
    """Takes whatever there is, counts its blocks, and raises what it is told to."""

    def __init__(self, fault: Exception | None = None):
        super().__init__()
        vars(self).update(seen=[], fault=fault)

    def __call__(self, points):
        if self.fault:
            raise self.fault
        self.seen.append(len(points))
        return [{"area": 1.0}] * len(points)


class Deadly(Areas):
    def __call__(self, points):
        os._exit(3)


A, B = Factor("a", (1.0, 2.0, 3.0)), Factor("b", (), 10.0, 20.0, 3)


def rows(database):
    return read_rows(database).rows


# ---- points -------------------------------------------------------------------------------------------------------------------


def test_a_grid_is_every_pair_and_every_seed():
    points = Sweep("areas", (A, B), seeds=(5, 6)).points()
    assert [p.run for p in points] == list(range(18))
    assert [(p.values["a"], p.values["b"], p.seed) for p in points[:4]] == [(1, 10, 5), (1, 10, 6), (1, 15, 5), (1, 15, 6)]
    assert len({(*p.values.values(), p.seed) for p in points}) == 18


def test_a_list_goes_through_its_values_side_by_side():
    points = Sweep("areas", (A, Factor("law", ("pid", "mpc", "pid"))), "list").points()
    assert [tuple(p.values.values()) for p in points] == [(1.0, "pid"), (2.0, "mpc"), (3.0, "pid")]


@settings(max_examples=30)
@given(st.sampled_from(["random", "latin-hypercube", "sobol"]), st.integers(1, 60), st.integers(0, 1000), st.booleans())
def test_what_is_drawn_lies_within_and_is_the_same_again(design, count, seed, log):
    sweep = Sweep("areas", (Factor("a", (), 0.5, 8.0, 0, log), Factor("law", ("x", "y"))), design, count, seed)
    points = sweep.points()
    assert [vars(p) for p in points] == [vars(p) for p in sweep.points()]
    assert len(points) == count
    assert all(0.5 <= p.values["a"] <= 8.0 and p.values["law"] in ("x", "y") for p in points)
    if design == "latin-hypercube":
        share = np.array([np.log(p.values["a"] / 0.5) / np.log(16.0) if log else (p.values["a"] - 0.5) / 7.5 for p in points])
        assert sorted(np.floor(share * count).astype(int)) == list(range(count))


def test_sobol_covers_more_evenly_than_chance():
    def discrepancy(design):
        sweep = Sweep("areas", (Factor("a", (), 0.0, 1.0), Factor("b", (), 0.0, 1.0)), design, 128)
        return qmc.discrepancy(np.array([[*p.values.values()] for p in sweep.points()]))

    assert discrepancy("sobol") < 0.2 * discrepancy("random")


# ---- rows ---------------------------------------------------------------------------------------------------------------------


def test_every_run_has_its_row(tmp_path):
    path = tmp_path / "rows.sqlite"
    done = run_sweep(Sweep("areas", (A, B), seeds=(0, 1)), Areas(), path)
    assert (done.runs, done.failed, done.made) == (18, 0, 18)
    found = read_rows(path)
    assert found.names == ("run", "seed", "a", "b", "area", "root of a", "error")
    assert dict(found.units) == {"a": "m", "b": "m", "area": "m^2", "root of a": "m^0.5"}
    assert [row[4] for row in found.rows] == [a * b * (1 + s) for a in (1, 2, 3) for b in (10, 15, 20) for s in (0, 1)]
    assert {row[5] for row in found.rows} == {None}  # no number
    with sqlite3.connect(path) as connection:
        assert connection.execute("SELECT COUNT(*), MIN(seconds) >= 0 FROM timing").fetchone() == (18, 1)


def test_what_fails_is_a_row_and_takes_nobody_with_it(tmp_path):
    path = tmp_path / "rows.sqlite"
    said = []
    done = run_sweep(Sweep("areas", (Factor("a", (1.0, -1.0, 95.0, 2.0)), B)), Areas(), path, progress=said.append)
    assert (done.runs, done.failed) == (12, 6)
    assert "12 of 12 runs, 6 failed" in said[-1]
    by_a = {row[2]: (row[4] is None, row[6]) for row in rows(path)}
    assert by_a == {
        1.0: (False, ""), -1.0: (True, "Areas: no area\n  mend: a from 0 on"), 95.0: (True, "ZeroDivisionError: beyond 90"),
        2.0: (False, ""),
    }  # fmt: skip


def test_only_the_outputs_that_are_wanted_have_a_column(tmp_path):
    run_sweep(Sweep("areas", (A, B), outputs=("area",)), Areas(), tmp_path / "r.sqlite")
    assert read_rows(tmp_path / "r.sqlite").names == ("run", "seed", "a", "b", "area", "error")
    with pytest.raises(InputError, match="unknown output 'aera'"):
        run_sweep(Sweep("areas", (A, B), outputs=("aera",)), Areas(), tmp_path / "s.sqlite")
    assert not (tmp_path / "s.sqlite").exists()


def test_as_csv(tmp_path):
    run_sweep(Sweep("areas", (Factor("a", (-1.0, 1.0)), Factor("b", (0.1,)))), Areas(), tmp_path / "r.sqlite")
    with export_csv(tmp_path / "r.sqlite", tmp_path / "r.csv").open(newline="") as file:
        header, first, second = csv.reader(file)
    assert header == ["run", "seed", "a [m]", "b [m]", "area [m^2]", "root of a [m^0.5]", "error"]
    assert first == ["0", "0", "-1.0", "0.1", "", "", "Areas: no area\n  mend: a from 0 on"]
    assert second[:5] == ["1", "0", "1.0", "0.1", "0.1"]


def test_a_name_of_another_column_is_refused(tmp_path):
    for names in (("Area",), ("seed",), ("error",), ("a", "A")):
        with pytest.raises(InputError, match="is the name of another column"):
            run_sweep(Sweep("areas", tuple(Factor(name, (1.0,)) for name in names)), Areas(), tmp_path / "r.sqlite")
    assert not list(tmp_path.iterdir())


def test_values_come_back_as_they_went(tmp_path):
    """Also numbers among texts, and the ends of a logarithmic range."""
    b = Factor("b", (), 0.1, 10.0, 5, True)
    assert (b.levels[0], b.levels[-1]) == (0.1, 10.0)
    assert all(0.1 <= level <= 10.0 for level in b.levels)
    run_sweep(
        Sweep("areas", (Factor("a", (0.1 + 0.2, 2.0)), Factor("law", ("pid", 0.1 + 0.2, 2.0)))), Free(), tmp_path / "r.sqlite"
    )
    assert [row[2:4] for row in rows(tmp_path / "r.sqlite")] == [
        (a, law) for a in (0.1 + 0.2, 2.0) for law in ("pid", 0.1 + 0.2, 2.0)
    ]


def test_blocks_grow_no_faster_than_by_doubling(tmp_path):
    """Where the first runs are quick the next ones may be slow."""
    job = Free()
    run_sweep(Sweep("areas", (Factor("a", (), 1.0, 2.0),), "random", 100), job, tmp_path / "r.sqlite")
    assert job.seen[:3] == [1, 2, 4]
    assert max(job.seen) > 8
    assert sum(job.seen) == 100


def test_what_makes_no_sense_any_more_ends_the_sweep(tmp_path):
    with pytest.raises(StoppedError, match="has changed"):
        run_sweep(Sweep("areas", (A, B)), Free(StoppedError("has changed", file="plant.py")), tmp_path / "r.sqlite")
    assert not rows(tmp_path / "r.sqlite")
    with pytest.raises(MemoryError):
        run_sweep(Sweep("areas", (A, B)), Free(MemoryError()), tmp_path / "s.sqlite")


@pytest.mark.slow
def test_a_run_that_ends_its_process_is_said(tmp_path):
    with pytest.raises(InputError, match="a run has ended its whole process"):
        run_sweep(Sweep("areas", (A, B)), Deadly(), tmp_path / "r.sqlite", jobs=2)


# ---- what was cut off goes on -------------------------------------------------------------------------------------------------


class CutError(Exception):
    pass


@pytest.mark.parametrize("after", [1, 2, 4])
def test_what_was_cut_off_goes_on(tmp_path, after):
    sweep, said = Sweep("areas", (A, B), seeds=(0, 1, 2)), []

    def cut(text):
        said.append(text)
        if len(said) == after:
            raise CutError

    with pytest.raises(CutError):
        run_sweep(sweep, Areas(), tmp_path / "r.sqlite", progress=cut)
    before = len(rows(tmp_path / "r.sqlite"))
    assert 0 < before < 27
    done = run_sweep(sweep, Areas(), tmp_path / "r.sqlite", resume=True)
    assert (done.runs, done.made) == (27, 27 - before)
    run_sweep(sweep, Areas(), tmp_path / "whole.sqlite")
    assert rows(tmp_path / "r.sqlite") == rows(tmp_path / "whole.sqlite")


def test_a_file_of_something_else_is_refused(tmp_path):
    sweep, path = Sweep("areas", (A, B)), tmp_path / "r.sqlite"
    with pytest.raises(InputError, match="there is nothing to resume"):
        run_sweep(sweep, Areas(), path, resume=True)
    run_sweep(sweep, Areas(), path)
    with pytest.raises(InputError, match="holds a sweep already"):
        run_sweep(sweep, Areas(), path)
    for other, job in ((Sweep("areas", (A, B), seed=1), Areas()), (sweep, Areas(scale=2.0))):
        with pytest.raises(InputError, match="holds rows of another sweep, job or version"):
            run_sweep(other, job, path, resume=True)
    (tmp_path / "no.sqlite").write_text("hello, this is no database at all")
    with pytest.raises(InputError, match="no database"):
        run_sweep(sweep, Areas(), tmp_path / "no.sqlite", resume=True)
    with pytest.raises(InputError, match="no such file"):
        read_rows(tmp_path / "absent.sqlite")
    sqlite3.connect(tmp_path / "empty.sqlite").close()
    with pytest.raises(InputError, match="holds no sweep"):
        read_rows(tmp_path / "empty.sqlite")


def test_rows_of_another_version_are_refused(tmp_path, monkeypatch):
    run_sweep(Sweep("areas", (A, B)), Areas(), tmp_path / "r.sqlite")
    monkeypatch.setattr("workbench.sweeps.database.versions", lambda: {"numpy": "0.1"})
    with pytest.raises(InputError, match="holds rows of another sweep, job or version"):
        run_sweep(Sweep("areas", (A, B)), Areas(), tmp_path / "r.sqlite", resume=True)


def test_a_block_is_there_or_not_at_all(tmp_path):
    """Where the second table refuses, the first has nothing of it either."""
    path, sweep = tmp_path / "r.sqlite", Sweep("areas", (A, B), seeds=(0, 1, 2))

    def obstructed(_):
        with sqlite3.connect(path) as connection:
            connection.execute("INSERT INTO timing VALUES (2, 0.0)")

    with pytest.raises(InputError, match="cannot be written: UNIQUE"):
        run_sweep(sweep, Areas(), path, progress=obstructed)
    assert [row[0] for row in rows(path)] == [0]
    with sqlite3.connect(path) as connection:
        connection.execute("DELETE FROM timing WHERE run = 2")
    assert run_sweep(sweep, Areas(), path, resume=True).made == 26


def test_tables_are_there_or_not_at_all(tmp_path, monkeypatch):
    path, calls = tmp_path / "r.sqlite", []

    def failing():
        calls.append(0)
        if len(calls) > 1:  # for the hash first, then inside of what makes the tables
            raise CutError
        return {}

    with monkeypatch.context() as patch:
        patch.setattr("workbench.sweeps.database.versions", failing)
        with pytest.raises(CutError):
            run_sweep(Sweep("areas", (A, B)), Areas(), path)
    with pytest.raises(InputError, match="holds no sweep"):
        read_rows(path)
    assert run_sweep(Sweep("areas", (A, B)), Areas(), path, resume=True).made == 9


def test_who_reads_does_not_stop_who_writes(tmp_path):
    path, readers = tmp_path / "r.sqlite", []

    def reading(_):
        readers.append(sqlite3.connect(path).execute("SELECT * FROM runs, columns"))
        assert readers[-1].fetchone()

    done = run_sweep(Sweep("areas", (A, B), seeds=(0, 1, 2)), Areas(), path, progress=reading)
    assert done.runs == 27
    for reader in readers:
        reader.connection.close()


def test_two_writers_are_one_too_many(tmp_path):
    sweep, path, refused = Sweep("areas", (A, B)), tmp_path / "r.sqlite", []

    def second(_):
        with pytest.raises(InputError, match="another process writes to this sweep") as reason:
            run_sweep(sweep, Areas(), path, resume=True)
        refused.append(reason)

    run_sweep(sweep, Areas(), path, progress=second)
    assert refused
    assert len(rows(path)) == 9


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_killed_again_and_again(tmp_path, jobs):
    """kill -9 at random moments: what is there stays, nothing is there twice, and the end is that of an undisturbed run."""
    root, path = Path(__file__).parents[2], tmp_path / "killed.sqlite"
    code = f"""
import sys
sys.path.insert(0, {str(root)!r})
from pathlib import Path
from tests.workbench.test_sweeps import Areas, MANY
from workbench.sweeps.run import run_sweep
path = Path({str(path)!r})
run_sweep(MANY, Areas(pause=0.004), path, resume=path.exists(), jobs={jobs})
"""
    moments, seen = random.Random(1), 0
    for kills in range(6):
        process = subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True,
            env=os.environ | {"PYTHONPATH": str(root)},
        )  # fmt: skip
        while process.poll() is None and held(path) <= seen:
            time.sleep(0.01)
        time.sleep(moments.uniform(0.0, 0.1))
        if kills < 5:
            os.killpg(process.pid, signal.SIGKILL)
        _, complaint = process.communicate()
        assert process.returncode == (-signal.SIGKILL if kills < 5 else 0), complaint.decode()
        assert held(path) > seen
        seen = held(path)
    with sqlite3.connect(path) as connection:
        assert connection.execute("SELECT COUNT(*), COUNT(DISTINCT run) FROM timing").fetchone() == (500, 500)
    run_sweep(MANY, Areas(), tmp_path / "whole.sqlite")
    assert rows(path) == rows(tmp_path / "whole.sqlite")


#: For the test above, which other processes run.
MANY = Sweep("areas", (Factor("a", (), 1.0, 2.0), Factor("b", (), 1.0, 2.0)), "random", 500)


def held(path) -> int:
    """Rows of a file that may not have come into being."""
    try:
        return len(rows(path))
    except InputError:
        return 0


# ---- the file that asks -------------------------------------------------------------------------------------------------------

WHOLE = """
run = "areas"
design = "latin-hypercube"
count = 40
seed = 3
seeds = [1, 2]
outputs = ["area"]
[parameters.a]
low = 0.1
high = 10
scale = "log"
[parameters.law]
values = ["pid", 2]
[fixed]
plant = "web-winding"
[fixed.run]
duration = 20
"""


def written(tmp_path, text):
    path = tmp_path / "sweep.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_is_the_sweep_it_says(tmp_path):
    found = load_sweep(written(tmp_path, WHOLE))
    law = Factor("law", ("pid", 2.0))
    fixed = {"plant": "web-winding", "run": {"duration": 20}}
    a = Factor("a", (), 0.1, 10.0, 0, True)
    assert found.content() == Sweep("areas", (a, law), "latin-hypercube", 40, 3, (1, 2), ("area",), fixed).content()
    assert json.loads(json.dumps(found.content(), default=list))["factors"][1]["values"] == ["pid", 2.0]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('run = "areas"\n', "", "run is missing"),
        ('"latin-hypercube"', '"latin"', "unknown design 'latin'"),
        ("count = 40\n", "", "design latin-hypercube without count"),
        ("count = 40", "count = 1.5", "count = 1.5"),
        ("count = 40", "cuont = 40", "unknown table 'cuont'"),
        ("[1, 2]", "[1, 1]", "seeds = a list"),
        ("[1, 2]", "[]", "seeds = a list"),
        ("[1, 2]", f"[1, {10**20}]", "seeds = a list"),
        ("seed = 3", f"seed = {10**20}", "seed = 1000"),
        ("count = 40", f"count = {10**12}", "at most 1000000"),
        ("high = 10", "high = 1" + 400 * "0", "expected a finite number"),
        ("high = 10", "high = 1" + 5000 * "0", "not TOML that makes sense"),
        ('["pid", 2]', f"[1{400 * '0'}]", "values = a list"),
        ('["area"]', '"area"', "outputs = 'area'"),
        ("low = 0.1", "low = 0", "a logarithmic scale"),
        ("low = 0.1", "low = 11", "expected more than low = 11"),
        ("low = 0.1\n", "", r"\[parameters.a\] has no values"),
        ('scale = "log"', "count = 4", "levels belong to a grid"),
        ('["pid", 2]', "[nan]", "values = a list"),
        ('["pid", 2]', "[]", "values = a list"),
        ('["pid", 2]', "[1]\nlow = 0", "leave it out: the values are given"),
        ('design = "latin-hypercube"\ncount = 40', 'design = "list"', r"\[parameters.a\] has no values"),
        ('design = "latin-hypercube"\ncount = 40', 'design = "grid"', "has no levels"),
        ("seed = 3", "seed =", "not TOML"),
    ],
)
def test_a_file_that_makes_no_sense_is_refused(tmp_path, old, new, said):
    assert old in WHOLE
    path = written(tmp_path, WHOLE.replace(old, new))
    with pytest.raises(InputError, match=said) as reason:
        load_sweep(path)
    assert "sweep.toml" in str(reason.value)
    assert "mend:" in str(reason.value)


def test_a_grid_counts_itself(tmp_path):
    text = 'run = "x"\ncount = 3\n[parameters.a]\nvalues = [1, 2]\n'
    with pytest.raises(InputError, match="a grid has as many points as its values make"):
        load_sweep(written(tmp_path, text))


def test_lists_of_different_lengths_and_nothing_that_varies_are_refused(tmp_path):
    text = 'run = "x"\ndesign = "list"\n[parameters.a]\nvalues = [1, 2]\n[parameters.b]\nvalues = [1]\n'
    with pytest.raises(InputError, match="different lengths: a 2, b 1"):
        load_sweep(written(tmp_path, text))
    with pytest.raises(InputError, match="nothing varies"):
        load_sweep(written(tmp_path, 'run = "x"\n'))
    with pytest.raises(InputError, match="a grid of 1002001 points"):
        Sweep("x", (Factor("a", (), 0.0, 1.0, 1001), Factor("b", (), 0.0, 1.0, 1001))).points()
