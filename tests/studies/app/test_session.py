"""A session is a folder: what the page starts is a command in a process of its own, whose state is in files."""

import json
import os
import signal
import socketserver
import subprocess
import sys
import time

import pytest

from studies.app import session as sessions
from studies.app.lines import python_lines
from studies.app.session import Session
from studies.cli import main as command
from tests.studies.app.conftest import record
from workbench.errors import InputError


def ended(session, name, seconds=120.0):
    """The step once it no longer runs."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        step = session.step(name)
        if step["state"] != "running":
            return step
        time.sleep(0.1)
    raise AssertionError(session.step(name))


def test_a_command_runs_in_the_folder_and_is_there_for_a_second_server(session):
    record(session.records / "a.csv", 1)
    name = session.begin(["look", "records/a.csv", "--inputs", "U", "--outputs", "n"])
    assert name == "01-look"
    assert session.step(name)["state"] == "running"
    step = ended(Session(session.folder), name)
    assert (step["state"], step["code"], step["page"]) == ("done", 0, True)
    assert "1 record" in step["log"]
    assert step["command"] == "workbench look records/a.csv --inputs U --outputs n --out 01-look"
    assert [c["name"] for c in session.state()["channels"]] == ["U", "n"]
    assert not list(session.folder.glob(".steps/*.alive"))


def test_a_refusal_is_told_with_its_mend(session):
    (session.records / "a.csv").write_text("no record\n")
    step = ended(session, session.begin(["look", "records/a.csv"]))
    assert (step["code"], step["page"]) == (2, False)
    assert "mend" in step["log"]


@pytest.fixture
def slow(monkeypatch, tmp_path):
    """Commands that take a minute: `look` waits before it begins."""
    (tmp_path / "sitecustomize.py").write_text(
        "import sys, time\nif 'studies.app.job' in ' '.join(sys.orig_argv):\n"
        "    import studies.commands.look as own\n    own.run = lambda options: time.sleep(60)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))


def begun(session, name):
    """Wait until the process shows that it lives."""
    until = time.monotonic() + 60.0
    while not (session.folder / ".steps" / f"{name}.alive").exists():
        assert time.monotonic() < until
        time.sleep(0.05)


def test_a_step_is_stopped_and_its_process_is_gone(session, slow):
    record(session.records / "a.csv", 1)
    name = session.begin(["look", "records/a.csv"])
    begun(session, name)
    session.stop(name)
    step = ended(session, name, 30.0)
    assert (step["state"], step["code"]) == ("done", 130)
    with pytest.raises(InputError, match="not running"):
        session.stop(name)


def test_a_killed_process_is_told_from_a_running_one(session, slow, monkeypatch):
    record(session.records / "a.csv", 1)
    started = []
    popen = subprocess.Popen
    monkeypatch.setattr(subprocess, "Popen", lambda *given, **own: started.append(popen(*given, **own)) or started[-1])
    name = session.begin(["look", "records/a.csv"])
    begun(session, name)
    os.kill(started[0].pid, signal.SIGKILL)
    monkeypatch.setattr(sessions, "GONE", 1.0)
    time.sleep(1.2)
    assert session.step(name)["state"] == "killed"


def test_no_more_than_two_run_together_and_numbers_are_not_given_twice(session, slow):
    record(session.records / "a.csv", 1)
    both = [session.begin(["look", "records/a.csv"]) for _ in range(2)]
    assert both == ["01-look", "02-look"]
    with pytest.raises(InputError, match="01-look and 02-look are under way"):
        session.begin(["look", "records/a.csv"])
    for name in both:
        begun(session, name)
        session.stop(name)
    for name in both:
        ended(session, name, 30.0)


def test_what_the_command_line_writes_beside_it_is_a_step_too(session, monkeypatch, capsys):
    record(session.records / "a.csv", 1)
    monkeypatch.chdir(session.folder)
    assert command(["look", "records/a.csv", "--inputs", "U", "--outputs", "n", "--out", "by-hand"]) == 0
    (step,) = session.state()["steps"]
    assert (step["name"], step["kind"], step["state"], step["page"]) == ("by-hand", "look", "done", True)
    assert session.state()["channels"]


def test_the_last_of_several_records_is_held_out_unless_something_else_is_said(session):
    uses = lambda: [own["use"] for own in session.state()["records"]]  # noqa: E731
    record(session.records / "a.csv", 1)
    assert uses() == ["model"]
    record(session.records / "b.csv", 2)
    assert uses() == ["model", "held-out"]
    session.choose(0, {"files": {"a.csv": "held-out", "b.csv": "model"}})
    assert uses() == ["held-out", "model"]


def test_a_plant_and_limits_are_guessed_from_the_records_and_run(session):
    record(session.records / "a.csv", 1)
    record(session.records / "b.csv", 2)
    with pytest.raises(InputError, match="which channel is an input"):
        session.guess("plant.py")
    session.choose(0, {"roles": {"U": "input", "n": "output"}})
    session.guess("plant.py")
    session.guess("limits.toml")
    step = ended(session, session.begin(["effects", "plant.py:PLANT"]))
    assert step["code"] == 0, step["log"]
    assert "[limits.n]" in session.state()["texts"]["limits.toml"]


def test_a_folder_of_workbench_new_is_a_session(tmp_path, capsys):
    log = record(tmp_path / "a.csv", 1)
    assert command(["new", str(tmp_path / "mine"), str(log), "--inputs", "U", "--outputs", "n"]) == 0
    state = Session(tmp_path / "mine").state()
    assert [own["name"] for own in state["records"]] == ["a.csv"]
    assert set(state["texts"]) == {"plant.py", "limits.toml"}


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # uvicorn leaves the socket that it could not bind
def test_what_cannot_be_served_is_refused_with_its_mend(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for words, said in ((["x", "--port", "70000"], "up to 65535"), ([str(tmp_path / "file")], "choose a folder")):
        assert command(["app", *words, "--no-browser"]) == 2
        assert said in capsys.readouterr().err
    with socketserver.TCPServer(("127.0.0.1", 0), None) as taken:
        assert command(["app", str(tmp_path / "new"), "--port", str(taken.server_address[1]), "--no-browser"]) == 2
    assert "is taken" in capsys.readouterr().err


def test_a_users_own_folders_do_not_stand_in_for_this_program(session):
    """A session that holds a folder `plants` and a file `studies.py` runs the commands of this program all the same."""
    (session.folder / "plants").mkdir()
    (session.folder / "plants" / "__init__.py").write_text("raise RuntimeError('not this one')")
    (session.folder / "studies.py").write_text("raise RuntimeError('not this one')")
    record(session.records / "a.csv", 1)
    assert ended(session, session.begin(["look", "records/a.csv"]))["code"] == 0


LINES = {
    "look records/a.csv --inputs U,V --outputs n": 'found = wb.look("records/a.csv", inputs=["U", "V"], outputs="n")',
    "look a.csv --file-dt 0.01": 'found = wb.look("a.csv", dt=0.01)',
    "identify a.csv --inputs U --outputs n --schedule none --model ssm": 'models = wb.identify(data, methods=[\'ssm\'])',
    "diagnose a.csv --plant plant.py:PLANT --holdout b.csv": "found = wb.diagnose(plant, data, held)",
    "design pid --model 02/lti.json --low U=-1,V=0 --sensitivity 1.4":
        'law = ScheduledPIDDesign(sensitivity=1.4, complementary=1.6, effort=3, knots=1, low={"U": -1, "V": 0}).on(model)',
    "design scheduled-pid --model m.json --knots 3 --path q,v --slew q=2 --reference-model v=inf --load U=1 --no-derivative":
        'law = ScheduledPIDDesign(sensitivity=1.6, complementary=1.6, effort=3, knots=3, derivative=False, '
        'reference_model={"v": float("inf")}, slew={"q": 2}, load={"U": 1}, paths=("q", "v",)).on(model)',
    "design pid --model m.json --at 0.02 --fixed-gains --plant web-winding --filter 0.1 --setpoint-weight 0.5 --robust-to h.json":
        'law = ScheduledPIDDesign(sensitivity=1.6, complementary=1.6, effort=3, knots=[0.02], moving=False, filter=0.1, '
        'setpoint_weight=0.5, robust_to=(wb.load_model("h.json"),)).on(model, plant)',
    "design mpc --model m.json --keep y=-1:inf --fallback p.json --horizon 10 --move 0.1":
        'law = MPCDesign(sensitivity=1.6, horizon=10, move=0.1, keep={"y": (-1, float("inf"))}, fallback=fallback).on(model)',
    "design mpc --model m.json --accept": 'law = MPCDesign(sensitivity=1.6, horizon=20).on(model, accept=True)',
    "export pid.json --to c": 'law.export("c", "exported")',
}  # fmt: skip


@pytest.mark.parametrize("words", LINES)
def test_the_python_lines_say_what_the_command_does(words):
    lines = python_lines(tuple(words.split()))
    assert LINES[words] in lines.splitlines()
    compile(lines, "lines", "exec")
    nothing = (
        "nonsense", "design pid --model m.json --diagnosis d.json", "design mpc --model m.json --tube --records a.csv",
        "design pid --model m.json --until limits.toml --records a.csv", "design mpc --model m.json --sensitivity 1.4",
        "design mpc --model m.json --filter 0.1",
    )  # fmt: skip
    for words in nothing:
        assert python_lines(tuple(words.split())) == ""


@pytest.mark.slow
def test_the_python_lines_of_a_chain_give_what_its_commands_gave(session):
    """Run every line beside the commands: the same files come out."""
    for name, seed in (("a", 1), ("b", 2), ("c", 3)):
        record(session.records / f"{name}.csv", seed, 1500)
    session.choose(0, {"roles": {"U": "input", "n": "output"}})
    session.guess("plant.py")
    session.guess("limits.toml")
    own, held = ["records/a.csv", "records/b.csv"], ["--holdout", "records/c.csv"]
    chain = [
        ["look", *own, "--inputs", "U", "--outputs", "n"],
        ["identify", *own, "--outputs", "n", "--inputs", "U", "--schedule", "none", "--model", "lti", *held],
        ["diagnose", *own, "--plant", "plant.py:PLANT", *held],
        ["design", "pid", "--model", "02-identify/lti.json", "--low", "U=-10", "--high", "U=10"],
        ["check", "--controller", "04-design/pid.json", "--limits", "limits.toml", "--model", "02-identify/lti.json",
         "--records", *own],
    ]  # fmt: skip
    paths = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, [str(sessions.ROOT), os.environ.get("PYTHONPATH", "")]))}
    for words in chain:
        step = ended(session, session.begin(words), 300.0)
        assert step["code"] == 0, step["log"]
        lines = step["python"].replace(step["name"], f"again-{step['name']}")
        done = subprocess.run(
            [sys.executable, "-c", lines], cwd=session.folder, capture_output=True, text=True, check=False, env=paths
        )
        assert done.returncode == 0, done.stderr
    told = {"02-identify": ("scores", "models"), "03-diagnose": ("diagnosis", "causes"), "05-check": ("check", "verdicts")}
    for step, (file, key) in told.items():
        once, again = ((session.folder / name / f"{file}.json").read_text() for name in (step, f"again-{step}"))
        assert json.loads(once)[key] == json.loads(again.replace(f"again-{step}", step))[key], step
