"""`workbench design mpc --tube`: what it writes and says, and what it refuses."""

import json

import numpy as np
import pytest

from controllers.files import load_controller, save_controller
from controllers.pid import pid
from controllers.tube import taken
from studies.cli import main
from workbench.basis import CONSTANT
from workbench.data import Channel, Experiment
from workbench.lpv import OperatingPoint, Predictor, constant_model
from workbench.readers import write_csv

A, B, C, K = np.array([[0.8, 0.1], [0.0, 0.6]]), np.array([[0.2], [0.4]]), np.array([[1.0, 0.2]]), np.array([[0.2], [0.1]])
DT, U, Y = 0.1, Channel("a", "V", "input"), Channel("c", "m", "output")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A model, a fallback law, and a record of the model with small errors of its own."""
    place, random, N = tmp_path_factory.mktemp("tube"), np.random.default_rng(6), 800
    constant_model(
        "m", DT, ((U,), (Y,)), (A, B, C, np.zeros((1, 1))), OperatingPoint(CONSTANT, u=[[0.3]], y=[[5.0]]),
        predictor=Predictor((A - K @ C)[None], B[None], K[None]), noise=np.array([[0.01]]),
    ).save(place / "m.json")  # fmt: skip
    save_controller(pid(("a",), ("c",), ("c_set",), DT, 0.1, 0.2), place / "pid.json")
    u, y, x, last = random.choice([-1.0, 1.0], (N, 1)), np.empty((N, 1)), np.zeros(2), 0.0
    for k in range(N):
        e = 0.005 * last + random.uniform(-0.01, 0.01, 1)
        y[k] = last = C @ x + e
        x = A @ x + B @ u[k] + K @ e
    write_csv(Experiment("a", np.arange(N) * DT, (U, Y), np.hstack([u + 0.3, y + 5.0]), DT), place / "a.csv")
    return place


def design(folder, *more, kind="mpc", keep="c=3:7"):
    files = ["--model", str(folder / "m.json"), "--fallback", str(folder / "pid.json"), "--out", str(folder / "out")]
    limits = ["--low", "a=-3", "--high", "a=3", "--rate", "a=20", "--keep", keep]
    return main(["design", kind, *files, *limits, "--move", "0.3", *more])


@pytest.mark.slow
def test_design_writes_a_tube_and_says_what_it_takes(folder, capsys):
    assert design(folder, "--tube", "--records", str(folder / "a.csv")) == 0
    said = capsys.readouterr().out
    assert "c: errors up to" in said
    assert "% of half their width" in said
    assert "proved at 1 value of the schedule" in said
    law = load_controller(folder / "out" / "mpc.json")
    result = json.loads((folder / "out" / "design.json").read_text())
    np.testing.assert_allclose(result["tube"]["outputs"], law.tube.y[-1])
    assert result["provenance"]["data"].keys() == {"m.json", "pid.json", "a.csv"}
    assert np.all((taken(law, law.tube) > 0.0) & (taken(law, law.tube) < 0.5))
    assert main(["export", str(folder / "out" / "mpc.json"), "--to", "json", "--out", str(folder / "text")]) == 2
    assert "tightened by a tube" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("kind", "more", "keep", "problem"),
    [
        ("mpc", ["--tube"], "c=3:7", "--tube without records"),
        ("mpc", ["--records", "{}/a.csv"], "c=3:7", "--records is for --tube"),
        ("mpc", ["--tube", "--records", "{}/a.csv", "--bound", "x"], "c=3:7", "--bound 'x' is not a number"),
        ("mpc", ["--tube", "--records", "{}/a.csv"], "c=4.99:5.01", "nothing is left"),
        ("mpc", ["--tube", "--records", "{}/a.csv"], "c=:7", "errors grow with c, which has no limits"),
        ("scheduled-pid", ["--tube"], "c=3:7", "--tube is for mpc"),
    ],
)
def test_wrong_options_are_told(folder, capsys, kind, more, keep, problem):
    assert design(folder, *(part.format(folder) for part in more), kind=kind, keep=keep) == 2
    assert problem in capsys.readouterr().err
