"""`workbench new`: the folder runs as it stands, the example hides what its plant lacks, own logs give their names."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from studies.arguments import choose_plant
from studies.cli import main
from tests.test_docs import run_blocks
from workbench.data import Channel, Experiment
from workbench.readers import read_file, write_csv


def log(path, seed, name="speed", dt=0.01, samples=3000, gain=-1.5):
    """0.4 s y' = 2 + 3 u + gain v - y under steps, with noise of 0.02."""
    random = np.random.default_rng(seed)
    u, v = (np.repeat(random.uniform(-1.0, 1.0, samples // 50), 50) for _ in range(2))
    y, a = np.zeros(samples), np.exp(-dt / 0.4)
    for k in range(samples - 1):
        y[k + 1] = a * y[k] + (1.0 - a) * (2.0 + 3.0 * u[k] + gain * v[k])
    y += random.normal(0.0, 0.02, samples)
    channels = (Channel("u", "V", "input"), Channel("v", "V", "input"), Channel(name, "rad/s", "output"))
    write_csv(Experiment(path.stem, dt * np.arange(samples), channels, np.column_stack([u, v, y]), dt), path)
    return str(path)


def test_the_example_is_there_whole_and_its_plant_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "my-machine", "--json", "said.json"]) == 0
    made = json.loads(Path("said.json").read_text())
    assert {"README.md", "plant.py", "limits.toml", "sweep.toml", "chain.py", "records/held-out.csv"} <= set(made["files"])
    assert "cd my-machine" in capsys.readouterr().out
    assert choose_plant("my-machine/plant.py:PLANT").plant.output_names == ("n",)
    e = read_file("my-machine/records/a.csv")
    assert (e.dt, e.names) == (0.005, ("U", "way", "n"))
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".my")] == []


def test_logs_of_ones_own_give_channels_and_rough_numbers(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    logs = [log(tmp_path / f"{day}.csv", seed) for seed, day in enumerate(("monday", "tuesday"))]
    assert main(["new", "deep/own", *logs, "--inputs", "u,v", "--outputs", "speed"]) == 0
    plant = choose_plant("deep/own/plant.py:PLANT").plant
    assert (plant.input_names, plant.output_names, plant.dt) == (("u", "v"), ("speed",), 0.01)
    numbers = {p.name: p.value for p in plant.parameters}
    assert numbers["T_speed"] == pytest.approx(0.4, rel=0.1)
    assert numbers["k_speed_u"] == pytest.approx(3.0, rel=0.03)
    assert numbers["k_speed_v"] == pytest.approx(-1.5, rel=0.03)
    assert numbers["c_speed"] == pytest.approx(2.0, rel=0.03)
    readme = Path("deep/own/README.md").read_text()
    assert "identify records/monday.csv --holdout records/tuesday.csv --outputs speed --inputs u,v --schedule none" in readme


def test_how_a_log_was_understood_is_said(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    whole = Path(log(tmp_path / "cut.csv", 0, samples=400)).read_text()
    Path("cut.csv").write_text(whole.rsplit(",", 1)[0])  # the last row lacks its last number
    assert main(["new", "own", "cut.csv", "--inputs", "u,v", "--outputs", "speed"]) == 0
    assert "note: cut" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["there"], "is there already, and not empty"),
        (["n", "--inputs", "u"], "roles of channels without records"),
        (["n", "monday.csv", "--outputs", "u,v,speed"], "which channel is an input"),
        (["n", "odd.csv", "--inputs", "u,v", "--outputs", "class"], "cannot be a name in an equation"),
        (["n", "monday.csv", "other/monday.csv", "--inputs", "u,v", "--outputs", "speed"], "two files of this name"),
        (["n", "none.csv", "--inputs", "u"], "none.csv"),
        (["there/file.txt"], "is there already"),
    ],
)
def test_what_cannot_be_is_said_and_nothing_is_left_behind(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "file.txt").write_text("mine")
    (tmp_path / "other").mkdir()
    log(tmp_path / "monday.csv", 0, samples=400)
    log(tmp_path / "other" / "monday.csv", 1, samples=400)
    log(tmp_path / "odd.csv", 2, name="class", samples=400)
    before = sorted(tmp_path.rglob("*"))
    assert main(["new", *words]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert "mend:" in told
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.slow
def test_every_command_of_the_examples_readme_runs_and_the_friction_is_found(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "my-machine"]) == 0
    monkeypatch.chdir(tmp_path / "my-machine")
    run_blocks(Path("README.md"), {})
    found = json.loads(Path("found/diagnosis.json").read_text())
    assert [f"{c['effect']}@{c['at']}" for c in found["causes"]] == ["coulomb@shaft"]
    level = found["causes"][0]["parameters"]["level"]
    assert level["low"] < 0.04 < level["high"]
    assert json.loads(Path("checked/check.json").read_text())["status"] in ("PROVED", "PASSED")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([".", *sys.path])}
    done = subprocess.run([sys.executable, "chain.py"], capture_output=True, text=True, env=environment, timeout=600)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "coulomb@shaft" in done.stdout
    assert Path("checked-in-python/check.json").is_file()


@pytest.mark.slow
def test_every_command_around_ones_own_logs_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    logs = [log(tmp_path / f"{day}.csv", seed, gain=0.0) for seed, day in enumerate(("monday", "tuesday", "friday"))]
    assert main(["new", "own", *logs, "--inputs", "u", "--outputs", "speed"]) == 0
    monkeypatch.chdir(tmp_path / "own")
    run_blocks(Path("README.md"), {})
    assert Path("firmware").is_dir()
