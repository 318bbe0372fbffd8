"""Stages: what was computed is kept, what changed is computed, what was cut off is computed again, and foreign files stay."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from studies.stages import BEGUN, MARK, Stage, run_stages
from workbench.errors import InputError

pytestmark = pytest.mark.slow

RECORD = Stage("record", ("simulate", "welding-robot", "--experiment", "rbs", "--seed", "3"))
MODEL = Stage(
    "model",
    ("identify", "record/rbs.csv", "--output", "v", "--inputs", "u", "--schedule", "none", "--model", "lti", "--order", "2"),
)
AGAIN = Stage("again", ("simulate", "model/lti.json", "--inputs-from", "record/rbs.csv"))
CHAIN = (AGAIN, MODEL, RECORD)  # in no order of their own


@pytest.fixture
def room(tmp_path, monkeypatch):
    """An own cache, but the kernels of the user's."""
    from workbench.physics.kernel import cache_folder

    own = tmp_path / "cache" / "gain-scheduling-workbench"
    own.mkdir(parents=True)
    (own / "kernels").symlink_to(cache_folder())
    monkeypatch.setenv("WORKBENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_a_chain_runs_once_and_again_only_where_something_changed(room):
    folder = room / "run"
    folder.mkdir()
    done = run_stages(CHAIN, folder, jobs=2)
    assert list(done) == ["again", "model", "record"]
    assert all(d.fresh and d.code == 0 for d in done.values())
    assert "rbs: 2000 samples" in done["record"].said[0] or done["record"].said[0].startswith("rbs:")
    before = contents(folder)
    assert not any(d.fresh for d in run_stages(CHAIN, folder).values())
    assert contents(folder) == before
    (folder / "record" / "rbs.csv").write_bytes((folder / "record" / "rbs.csv").read_bytes() + b"\n")
    found = run_stages((MODEL, AGAIN), folder)  # the record itself is now the user's
    assert found["model"].fresh
    assert found["again"].fresh
    other = Stage("model", (*MODEL.words[:-1], "3"))
    found = run_stages((RECORD, other, AGAIN), folder)
    assert {name: d.fresh for name, d in found.items()} == {"record": False, "model": True, "again": True}
    assert json.loads((folder / "model" / "lti.json").read_text())["schema"]


def test_another_folder_gets_the_same_files_from_the_cache(room):
    first, second = room / "one", room / "two"
    for folder in (first, second):
        folder.mkdir()
    run_stages(CHAIN, first)
    found = run_stages(CHAIN, second)
    assert not any(d.fresh for d in found.values())
    assert contents(first) == contents(second)
    anew = run_stages((RECORD,), room / "three", cached=False)
    assert anew["record"].fresh


def test_what_was_cut_off_runs_again(room):
    folder = room / "run"
    (folder / "record").mkdir(parents=True)
    (folder / "record" / BEGUN).touch()
    (folder / "record" / "rbs.csv").write_text("t [s],u")  # of a killed run
    assert run_stages((RECORD,), folder)["record"].fresh
    mark = folder / "record" / MARK
    for spoilt in (mark.read_text()[:40], mark.read_text().replace('"key": "', '"key": "0')):
        mark.write_text(spoilt)
        found = run_stages((RECORD,), folder)  # from the cache
        assert found["record"].code == 0
        assert mark.read_text() != spoilt
    (folder / "record" / "rbs.csv").unlink()
    run_stages((RECORD,), folder)
    assert (folder / "record" / "rbs.csv").stat().st_size > 10_000


def test_files_of_the_user_stay(room):
    folder = room / "run"
    (folder / "record").mkdir(parents=True)
    (folder / "record" / "mine.txt").write_text("keep me")
    with pytest.raises(InputError, match=r"(?s)holds files that no stage.*another --out"):
        run_stages((RECORD,), folder)
    assert (folder / "record" / "mine.txt").read_text() == "keep me"


def test_a_refusal_is_told_in_the_commands_own_words(room):
    folder = room / "run"
    folder.mkdir()
    with pytest.raises(InputError, match=r"(?s)did not give an answer.*'rbz'.*rbs"):
        run_stages((Stage("record", (*RECORD.words[:3], "rbz")),), folder)
    assert not (folder / "record" / MARK).exists()
    with pytest.raises(ValueError, match="wait for each other"):
        run_stages((Stage("a", ("compare", "b/x.json")), Stage("b", ("compare", "a/x.json"))), folder)


def test_a_file_that_is_not_what_was_written_is_made_again(room):
    """In the run's folder and in the cache; and what is asked for anew is not taken from either."""
    first, second = room / "one", room / "two"
    first.mkdir()
    second.mkdir()
    run_stages((RECORD,), first)
    good = (first / "record" / "rbs.csv").read_bytes()
    (first / "record" / "rbs.csv").write_bytes(good[: len(good) // 3])
    assert not run_stages((RECORD,), first)["record"].fresh  # from the cache
    assert (first / "record" / "rbs.csv").read_bytes() == good
    (stored,) = (room / "cache" / "gain-scheduling-workbench" / "stages").glob("*/rbs.csv")
    stored.write_bytes(good[:1000])
    assert run_stages((RECORD,), second)["record"].fresh
    assert (second / "record" / "rbs.csv").read_bytes() == good
    assert run_stages((RECORD,), second, cached=False)["record"].fresh
    for mark in ("[]", '{"key": 3}', "{"):
        (second / "record" / MARK).write_text(mark)
        run_stages((RECORD,), second)
        assert (second / "record" / "rbs.csv").read_bytes() == good


def test_what_the_user_put_beside_a_stage_stays(room):
    folder = room / "run"
    folder.mkdir()
    run_stages((RECORD,), folder)
    (folder / "record" / "notes.txt").write_text("mine")
    other = Stage("record", (*RECORD.words[:-1], "4"))
    with pytest.raises(InputError, match=r"notes\.txt"):
        run_stages((other,), folder)
    assert (folder / "record" / "notes.txt").read_text() == "mine"


def test_a_command_that_crashes_has_given_no_answer(room, monkeypatch):
    """An exception that nobody caught is no answer no: nothing is marked, nothing goes into the cache."""
    folder = room / "run"
    folder.mkdir()
    bad = room / "broken"
    bad.mkdir()
    (bad / "sitecustomize.py").write_text("import numpy\nnumpy.random.default_rng = None\n")
    with monkeypatch.context() as patch:
        patch.setenv("PYTHONPATH", str(bad))
        with pytest.raises(InputError, match="did not give an answer"):
            run_stages((RECORD,), folder)
    assert not (folder / "record" / MARK).exists()
    assert not list((room / "cache" / "gain-scheduling-workbench").glob("stages/*/" + MARK))
    assert run_stages((RECORD,), folder)["record"].fresh


def test_an_input_that_changes_while_it_is_read_is_told(room, monkeypatch):
    from studies import stages

    folder = room / "run"
    folder.mkdir()
    keys = iter(["a" * 32, "b" * 32])
    monkeypatch.setattr(stages, "_key", lambda stage, place: next(keys))
    with pytest.raises(InputError, match="has changed while it ran"):
        run_stages((RECORD,), folder)
    assert not (folder / "record" / MARK).exists()


def test_what_lies_in_the_run_folder_is_not_imported(room):
    folder = room / "run"
    folder.mkdir()
    (folder / "numpy.py").write_text("raise SystemExit('imported')")
    (folder / "studies").mkdir()
    assert run_stages((RECORD,), folder)["record"].code == 0


def test_a_kill_leaves_whole_stages_and_nothing_running(room):
    """Killed while the second stage runs: the first one is kept, and the next run ends with what an undisturbed one has."""
    folder = room / "run"
    folder.mkdir()
    slow = Stage("slow", ("diagnose", "record/rbs.csv", "--plant", "welding-robot"))
    code = (
        "from pathlib import Path\nfrom studies.stages import *\n"
        f"run_stages(({RECORD!r}, {slow!r}), Path({str(folder)!r}), cached=False)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], start_new_session=True)
    deadline = time.monotonic() + 120.0
    while not (folder / "slow" / BEGUN).exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(1.0)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert (folder / "record" / MARK).is_file()
    assert not (folder / "slow" / MARK).is_file()
    found = run_stages((RECORD, slow), folder)
    assert {name: d.fresh for name, d in found.items()} == {"record": False, "slow": True}
    assert not (folder / "slow" / BEGUN).exists()
    assert (folder / "slow" / "report.html").is_file()
