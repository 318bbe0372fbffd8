"""What the world does to a program: a full disk, folders that cannot be written, others beside it, other habits of writing."""

import os
import resource
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from studies.arguments import run_folder
from studies.cli import main

ROOT = Path(__file__).resolve().parents[2]
SIMULATE = ("simulate", "welding-robot", "--experiment", "rbs", "--seed", "3")


def command(*words, room=None, **environment):
    """The program in a process of its own; room: bytes that a file may have."""
    limit = (lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))) if room else None
    env = os.environ | {"PYTHONPATH": str(ROOT)} | environment
    return subprocess.run(
        [sys.executable, "-m", "studies.cli", *words], capture_output=True, text=True, env=env, preexec_fn=limit, check=False
    )


@pytest.mark.slow
def test_a_disk_without_room_is_said_and_nothing_half_written_stays(tmp_path):
    assert command(*SIMULATE, "--out", str(tmp_path / "warm")).returncode == 0  # kernels are compiled now
    done = command(*SIMULATE, "--out", str(tmp_path / "o"), room=20_000)
    assert done.returncode == 2
    assert "cannot write" in done.stderr
    assert "free some space or choose --out" in done.stderr
    assert "Traceback" not in done.stderr
    assert not [path for path in (tmp_path / "o").rglob("*") if path.is_file()]


@pytest.mark.parametrize("out", ["/proc/no", "{}/file/below", "{}/file"])
def test_a_folder_that_cannot_be_written_is_said_before_any_work(tmp_path, capsys, out):
    (tmp_path / "file").write_text("mine")
    assert main([*SIMULATE, "--out", out.format(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "cannot make the folder" in said
    assert "choose another --out" in said
    assert (tmp_path / "file").read_text() == "mine"


def test_runs_of_one_second_have_folders_of_their_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with ThreadPoolExecutor(16) as pool:
        folders = list(pool.map(lambda _: run_folder(None, "check"), range(64)))
    assert len(set(folders)) == 64
    assert all(folder.is_dir() for folder in folders)


@pytest.mark.slow
def test_two_runs_into_one_folder_leave_whole_files(tmp_path):
    """Each file is one run's or the other's."""
    out = ["--out", str(tmp_path / "o")]
    with ThreadPoolExecutor(2) as pool:
        both = list(pool.map(lambda seed: command(*SIMULATE[:-1], seed, *out), ("3", "4")))
    assert [done.returncode for done in both] == [0, 0]
    alone = [command(*SIMULATE[:-1], seed, "--out", str(tmp_path / seed)) for seed in ("3", "4")]
    assert [done.returncode for done in alone] == [0, 0]
    wanted = {(tmp_path / seed / "rbs.csv").read_bytes() for seed in ("3", "4")}
    assert (tmp_path / "o" / "rbs.csv").read_bytes() in wanted
    assert sorted(p.name for p in (tmp_path / "o").iterdir()) == ["rbs.csv", "simulate.json", "states"]


@pytest.mark.slow
def test_the_habits_of_a_country_do_not_change_a_number(tmp_path):
    """Decimal commas, another alphabet, another zone: the same bytes."""
    habits = {"LC_ALL": "de_DE.UTF-8", "LANG": "de_DE.UTF-8", "LANGUAGE": "de", "TZ": "Asia/Kathmandu"}
    for name, own in (("here", {}), ("there", habits), ("plain", {"LC_ALL": "C"})):
        done = command(*SIMULATE, "--out", str(tmp_path / name), **own)
        assert done.returncode == 0, done.stderr
    files = [(tmp_path / name / "rbs.csv").read_bytes() for name in ("here", "there", "plain")]
    assert files[0] == files[1] == files[2]


def test_a_clock_that_is_put_back_does_not_stop_a_sweep(tmp_path, monkeypatch):
    """Durations are not told by the time of day: here it runs backwards, an hour at every look."""
    import time

    from tests.workbench.test_sweeps import Areas
    from workbench.sweeps.design import Factor, Sweep
    from workbench.sweeps.rows import read_rows
    from workbench.sweeps.run import run_sweep

    hours = iter(range(10**9, 0, -3600))
    monkeypatch.setattr(time, "time", lambda: next(hours))
    said = []
    sweep = Sweep("areas", (Factor("a", (1.0, 2.0, 3.0)), Factor("b", (1.0, 2.0))))
    done = run_sweep(sweep, Areas(), tmp_path / "s.sqlite", progress=said.append)
    assert done.seconds >= 0.0
    assert len(read_rows(tmp_path / "s.sqlite").rows) == 6
    assert not any("-" in text.split(",")[-1] for text in said)  # no time left that is negative
