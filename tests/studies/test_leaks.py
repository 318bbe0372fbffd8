"""Too good is wrong too: an output that is handed to a model is told before any score; what only looks so is not accused."""

import json

import numpy as np
import pytest
from scipy.signal import lfilter

from studies.cli import main
from workbench.data import Dataset, Experiment
from workbench.identification.leaks import leaks
from workbench.readers import write_csv


def machine(seed, count=1500, *, noise=0.02, schedule=None, law=None):
    """y+ = a(p) y + 0.1 u under a binary input, its schedule p as a slow wave, or what `schedule` makes of the output."""
    g = np.random.default_rng(seed)
    u, p = np.repeat(g.choice([-1.0, 1.0], count), 7)[:count], np.sin(np.arange(count) / 90.0 + seed)
    x, y, n = 0.0, np.zeros(count), noise * g.standard_normal(count)
    for k in range(count):
        y[k] = x + n[k]
        if law:
            u[k] = law(u[k], y[k])
        x = (0.9 + 0.05 * p[k]) * x + 0.1 * u[k]
    p = p if schedule is None else schedule(y, g)
    return Experiment.from_arrays(f"r{seed}", 0.1, inputs={"u": u}, outputs={"y": y}, schedule={"p": p}, units={"y": "V"})


LEAKS = {
    "a copy": lambda y, g: 1.0 * y,
    "scaled and shifted": lambda y, g: 30.0 - 57.3 * y,
    "late": lambda y, g: np.concatenate([np.full(4, y[0]), y[:-4]]),
    "early": lambda y, g: np.concatenate([y[9:], np.full(9, y[-1])]),
    "filtered": lambda y, g: lfilter([0.4], [1, -0.6], y),
}


@pytest.mark.parametrize("noise", [0.02, 0.2])
@pytest.mark.parametrize("kind", LEAKS)
def test_a_schedule_that_is_the_output_is_told(kind, noise):
    for seed in range(4):
        (said,) = leaks(Dataset((machine(seed, schedule=LEAKS[kind], noise=noise),)))
        assert said.startswith("schedule p is output y")


@pytest.mark.parametrize("late", [0, 3])
def test_a_copied_input_is_told_without_noise_too(late):
    for noise in (0.0, 0.05):
        e = machine(1, noise=noise)
        copied = np.concatenate([np.zeros(late), 2.0 * e["y"][: len(e) - late]])
        both = Experiment.from_arrays("r", 0.1, inputs={"u": e["u"], "v": copied}, outputs={"y": e["y"]})
        (said,) = leaks(Dataset((both,)))
        assert said.startswith("input v is output y times 2")
        assert (f"{late} samples late" in said) == (late > 0)


HONEST = {
    "a cause": lambda y, g: np.sin(np.arange(len(y)) / 90.0),
    "an integral of the output": lambda y, g: np.cumsum(y - y.mean()),
    "a radius": lambda y, g: 0.01 + 1e-6 * np.cumsum(3.0 + y) + 1e-7 * g.standard_normal(len(y)),
    "another sensor of it": lambda y, g: lfilter([0.1], [1, -0.9], y) + 0.02 * g.standard_normal(len(y)),
    "noise": lambda y, g: g.standard_normal(len(y)),
}


@pytest.mark.parametrize("noise", [0.0, 1e-6, 0.02, 0.2])
@pytest.mark.parametrize("kind", HONEST)
def test_no_honest_schedule_is_accused(kind, noise):
    for seed in range(4):
        assert leaks(Dataset((machine(seed, schedule=HONEST[kind], noise=noise),))) == ()


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_feedback_is_no_leak(noise):
    for law in (lambda r, y: 2.0 * (r - y), lambda r, y: r - 0.5 * y):
        assert leaks(Dataset((machine(2, noise=noise, law=law),))) == ()


# ---- on the command line -------------------------------------------------------------------------------------------------


def identified(folder, *records, words=()):
    paths = []
    for e in records:
        write_csv(e, folder / f"{e.name}.csv")
        paths.append(str(folder / f"{e.name}.csv"))
    roles = ("--output", "y", "--inputs", "u", "--schedule", "p", "--model", "ssm", "--order", "2", "--out", str(folder / "m"))
    return main(["identify", paths[0], *roles, "--holdout", *paths[1:], *words])


@pytest.mark.slow
def test_a_leak_is_said_before_any_score_and_no_model_is_handed_out(tmp_path, capsys):
    both = [machine(seed, 600, schedule=LEAKS["late"]) for seed in (1, 2)]
    assert identified(tmp_path, *both) == 3
    said = capsys.readouterr().out
    assert "NOT HANDED OUT: schedule p is output y times 1, 4 samples late" in said
    assert "FIT" not in said
    assert not (tmp_path / "m" / "ssm.json").exists()
    assert "NOT HANDED OUT" in (tmp_path / "m" / "report.html").read_text()
    (entry,) = json.loads((tmp_path / "m" / "scores.json").read_text())["models"]
    assert entry["file"] == ""
    assert "is output y" in entry["against"][0]
    assert identified(tmp_path, *both, words=["--accept"]) == 0  # the user's word that the schedule truly is the output
    assert "FIT" in capsys.readouterr().out
    assert (tmp_path / "m" / "ssm.json").exists()


@pytest.mark.slow
def test_a_model_worse_than_the_mean_is_not_handed_out_and_not_scored(tmp_path, capsys):
    good, other = machine(1, 600), machine(2, 600)
    other = Experiment.from_arrays(
        "other", 0.1, inputs={"u": -other["u"]}, outputs={"y": other["y"]}, schedule={"p": other["p"]}, units={"y": "V"}
    )
    assert identified(tmp_path, good, other) == 3
    said = capsys.readouterr().out
    assert "worse than the mean of the record: its free run misses y by" in said
    assert "FIT" not in said
    assert identified(tmp_path, good, machine(3, 600)) == 0
    model = str(tmp_path / "m" / "ssm.json")
    assert main(["compare", model, "--holdout", str(tmp_path / "other.csv"), "--out", str(tmp_path / "c")]) == 3
    assert (tmp_path / "m" / "ssm.json").exists()  # compare takes no model away
