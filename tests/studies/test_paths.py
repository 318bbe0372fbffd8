"""Spaces, umlauts and other letters in the paths of records, plants and results, through a whole chain of commands."""

import subprocess
import sys

import pytest

from studies.cli import main

pytestmark = pytest.mark.slow

PLANT = """
from workbench import Channel, Parameter, Plant, Start
from workbench.physics.effects import Shaft


def equation(x, u, p, at):
    return {"w": (p.k * u.U - p.b * x.w + at.shaft.torque()) / p.J}


MOTOR = Plant(
    name="motor",
    states=(Channel("w", "rad/s"),),
    inputs=(Channel("U", "V", "input"),),
    outputs=(Channel("n", "rad/s", "output"),),
    parameters=(
        Parameter("J", 0.002, "kg m^2", 0.2), Parameter("b", 0.015, "N m s/rad", 0.3), Parameter("k", 0.1, "N m/V", 0.1)
    ),
    equation=equation,
    measure=lambda x, p: {"n": x.w},
    dt=0.01,
    ports=(Shaft("shaft", "w"),),
    start=Start({"w": 0.0}, ("U",), ("w",)),
    noise={"n": 0.05},
)
"""
LIMITS = """
[run]
duration = 2.0

[run.setpoints]
n = [[0.0, 0.0], [0.5, 20.0]]

[limits.n]
high = 40.0
"""
SWEEP = """
run = "closed-loop"

[parameters.J]
values = [0.002, 0.003]

[fixed]
plant = "motor"
controller = "Regler für Motor/pid.json"

[fixed.run]
duration = 2.0

[fixed.run.setpoints]
n = [[0.0, 0.0], [0.5, 20.0]]
"""


def test_paths_may_hold_spaces_and_umlauts(tmp_path, monkeypatch):
    import numpy as np

    folder = tmp_path / "Messung Müller (März) №1"
    folder.mkdir()
    monkeypatch.chdir(folder)
    plant = folder / "Mein Prüfstand.py"
    plant.write_text(PLANT, encoding="utf-8")
    for seed, name in ((1, "Fahrt März"), (2, "Fahrt größer")):
        U = np.repeat(np.random.default_rng(seed).uniform(-10, 10, 20), 15)
        rows = [f"{0.01 * k:.2f},{u}" for k, u in enumerate(U)]
        (folder / f"{name}.csv").write_text("\n".join(["t [s],U [V]", *rows]), encoding="utf-8")
    motor, effect = f"{plant}:MOTOR", "coulomb@shaft:level=0.1"

    def run(*words):
        assert main(list(words)) == 0, words

    run("simulate", motor, "--inputs-from", "Fahrt März.csv", "Fahrt größer.csv", "--effect", effect, "--out", "Läufe von heute")
    records = [str(folder / "Läufe von heute" / f"{name}.csv") for name in ("Fahrt März", "Fahrt größer")]
    run("identify", records[0], "--output", "n", "--inputs", "U", "--model", "lti", "--holdout", records[1], "--out", "Modelle ä")
    run("diagnose", records[0], "--plant", motor, "--holdout", records[1], "--out", "Befund ö")
    run("design", "pid", "--model", "Modelle ä/lti.json", "--setpoint", "n=20", "--low", "U=-12", "--high", "U=12",
        "--out", "Regler für Motor")  # fmt: skip
    extended, law = f"{motor}+Befund ö/extended.json", "Regler für Motor/pid.json"
    run("simulate", extended, "--controller", law, "--setpoint", "n=20", "--duration", "2", "--out", "Kreis geschlossen")
    (folder / "Grenzen für alle.toml").write_text(LIMITS, encoding="utf-8")
    run("check", "--controller", law, "--limits", "Grenzen für alle.toml", "--plant", extended, "--fitted",
        "Befund ö/diagnosis.json", "--runs", "10", "--out", "Geprüft")  # fmt: skip
    run("export", law, "--to", "c", "--out", "Steuergerät Süd")
    (folder / "Reihe größer.toml").write_text(SWEEP, encoding="utf-8")
    run("sweep", "Reihe größer.toml", "--plant", extended, "--out", "Reihe läuft")
    run("report", "Modelle ä", "Befund ö", "--out", "Seite für alle")
    for name in ("Modelle ä", "Befund ö", "Geprüft", "Reihe läuft", "Seite für alle"):
        assert (folder / name / "report.html").is_file()


SPAWNED = """
from joblib.externals.loky.backend.context import set_start_method

from studies.cli import main

if __name__ == "__main__":
    set_start_method("spawn", force=True)
    raise SystemExit(main(["sweep", "Reihe größer.toml", "--jobs", "2", "--out", "Reihe läuft"]))
"""
IDENTIFICATION = """
run = "identification"
seeds = [1, 2]

[parameters.model]
values = ["lti"]

[fixed]
plant = "welding-robot"
inputs = ["u"]
outputs = ["v"]
experiments = ["rbs"]
held_out = ["prbs"]
"""


def test_processes_of_a_sweep_may_be_spawned(tmp_path):
    (tmp_path / "Reihe größer.toml").write_text(IDENTIFICATION, encoding="utf-8")
    (tmp_path / "läuft an.py").write_text(SPAWNED, encoding="utf-8")
    done = subprocess.run([sys.executable, "läuft an.py"], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert "2 runs, 0 failed" in done.stdout
