"""Two poles and a dead time as the floor of an identification, and the criterion, by verb and by command."""

import json

import numpy as np
import pytest

import workbench as wb
from studies.cli import main
from workbench.data import Dataset, Experiment


def lag(name: str, seed: int, N: int) -> Experiment:
    """y+ = 0.97 y + 0.03 u (k - 2), read with noise."""
    random = np.random.default_rng(seed)
    u, y = np.repeat(random.choice([-1.0, 1.0], N // 15 + 1), 15)[:N], np.zeros(N)
    for k in range(N - 1):
        y[k + 1] = 0.97 * y[k] + 0.03 * u[max(k - 2, 0)]
    return Experiment.from_arrays(name, 1.0, inputs={"u": u}, outputs={"y": y + 0.05 * random.normal(size=N)})


def test_a_model_that_loses_to_the_floor_is_said_to_and_is_not_the_headline():
    """Few noisy samples, and a model of far too many numbers."""
    data, held_out = Dataset((lag("a", 1, 120),)), Dataset((lag("b", 2, 400),))
    methods = {"ssm": wb.SSM(order=12, mu_factor=1.0001), "oe": wb.OutputError()}
    found = wb.identify(data, held_out, methods=methods, criterion="prediction")
    fits = {s.model: s.FIT for s in found.scores if (s.split, s.horizon) == ("held-out", "free-run")}
    assert fits["OE"] > fits["SSM"] + 0.5
    assert "held-out records. OE:" in found.sentences[0]
    assert any("SSM runs worse than OE, one or two poles with a dead time" in remark for remark in found.remarks)


def test_a_floor_that_cannot_follow_is_left_out_beside_a_model_that_can():
    """A machine whose gain turns its sign with the schedule, mostly positive in one record and mostly negative in the other."""

    def record(name: str, seed: int, mean: float) -> Experiment:
        random, N = np.random.default_rng(seed), 800
        u, y = np.repeat(random.choice([-1.0, 1.0], N // 8), 8), np.zeros(N)
        p = mean + np.sin(0.03 * np.arange(N))
        for k in range(N - 1):
            y[k + 1] = 0.8 * y[k] + 0.2 * p[k] * u[k]
        outputs = {"y": y + 0.01 * random.normal(size=N)}
        return Experiment.from_arrays(name, 0.1, inputs={"u": u}, outputs=outputs, schedule={"p": p})

    data, fresh = Dataset((record("a", 1, 0.6),)), Dataset((record("b", 2, -0.6),))
    alone = wb.identify(data, fresh, methods=["oe"], accept=True)
    assert "worse than the mean" in alone.results[0].against[0]
    found = wb.identify(data, fresh, methods={"ssm": wb.SSM(order=1), "oe": wb.OutputError()})
    assert [result.model.name for result in found.results] == ["SSM"]
    assert found.model.name == "SSM"
    assert any("cannot follow these records" in remark for remark in found.remarks)


def test_the_command_takes_a_criterion_and_refuses_another(tmp_path, capsys):
    paths = [str(wb.write_csv(lag(name, seed, 400), tmp_path / f"{name}.csv")) for seed, name in enumerate("ab")]
    words = ["identify", paths[0], "--inputs", "u", "--output", "y", "--holdout", paths[1], "--model", "lti,oe", "--order", "3"]
    assert main([*words, "--criterion", "simulation", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "refined by the error of its free runs" in said
    assert "dead time from u to y: 2 s" in said
    assert {path.name for path in (tmp_path / "out").glob("*.json")} >= {"lti.json", "oe.json", "scores.json"}
    model = wb.load_model(tmp_path / "out" / "oe.json")
    again = wb.read(paths[1], inputs="u", outputs="y").experiments[0]
    assert np.sqrt(np.mean((model.simulate(again) - again[["y"]])[model.warmup :] ** 2)) == pytest.approx(0.05, rel=0.25)
    assert main([*words, "--criterion", "simulatoin"]) == 2
    assert "simulation" in capsys.readouterr().err


def test_the_command_takes_an_output_as_schedule_and_a_design_refuses_its_model(tmp_path, capsys):
    """A tank, h+ = h + 0.05 (u - sqrt(h)): by command, to a model that schedules itself."""

    def record(name: str, seed: int) -> str:
        random, N = np.random.default_rng(seed), 700
        u, h = np.repeat(random.uniform(0.3, 1.0, N // 50), 50), np.full(N, 0.4)
        for k in range(N - 1):
            h[k + 1] = h[k] + 0.05 * (u[k] - np.sqrt(h[k]))
        outputs = {"level": h + 0.002 * random.normal(size=N)}
        e = Experiment.from_arrays(name, 0.5, inputs={"u": u}, outputs=outputs)
        return str(wb.write_csv(e, tmp_path / f"{name}.csv"))

    words = ["identify", record("a", 1), "--inputs", "u", "--output", "level", "--schedule", "level", "--holdout", record("b", 2)]
    assert main([*words, "--model", "lti,ssm", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "hidden coupling: modulus of the largest pole" in said
    assert "is output" not in said  # no leak
    scores = {s["model"]: s for s in json.loads((tmp_path / "out" / "scores.json").read_text())["models"]}
    free = {
        name: next(s["RMSE"] for s in own["scores"] if (s["split"], s["horizon"]) == ("held-out", "free-run"))
        for name, own in scores.items()
    }
    assert free["SSM"] < 0.5 * free["LTI"]
    for law in ("scheduled-pid", "mpc"):
        assert main(["design", law, "--model", str(tmp_path / "out" / "ssm.json"), "--out", str(tmp_path / law)]) == 2
        assert "level is schedule and output of this model" in capsys.readouterr().err


@pytest.mark.slow
def test_the_slowest_method_is_tried_where_the_others_leave_much_to_do():
    """A heater: what cools it, and so its gain and its time constant, is the flow; seen late, and in steps of 0.25."""

    def record(name: str, seed: int) -> Experiment:
        random, N = np.random.default_rng(seed), 450
        flow = np.clip(np.repeat(random.uniform(0.5, 3.0, N // 50), 50) + 0.02 * np.cumsum(random.normal(size=N)), 0.4, 3.2)
        u, T = np.repeat(random.uniform(10.0, 90.0, N // 30), 30), np.full(N, 80.0)
        for k in range(N - 1):
            T[k + 1] = T[k] + 0.2 * (1.5 * u[max(k - 4, 0)] - flow[k] * (T[k] - 20.0) * 0.5) / 2.0
        outputs = {"T": np.round((T + 0.2 * random.normal(size=N)) / 0.25) * 0.25}
        return Experiment.from_arrays(name, 0.2, inputs={"u": u}, outputs=outputs, schedule={"flow": flow})

    data, fresh = Dataset((record("a", 1), record("b", 2))), Dataset((record("c", 3),))
    found = wb.identify(data, fresh)
    others = [fit for name, fit in found.choice.fit.items() if name != "lpv-oe"]
    assert max(others) < 90.0
    assert len(others) == 4
    assert found.choice.fit[found.choice.method] == max(found.choice.fit.values())
    assert "lpv-oe" in {*found.choice.fit, *found.choice.failed}
    assert found.model.name == found.choice.model.name
    several = wb.identify(data, fresh, methods=["lti", "oe"])
    assert not any("lpv-oe" in remark for remark in several.remarks)  # it was not among what was asked for


def test_records_of_different_sample_times_are_brought_to_the_one_asked_for(tmp_path, capsys):
    fast, slow = lag("a", 1, 800), lag("b", 2, 400)
    fast = Experiment.from_arrays("a", 0.5, inputs={"u": fast["u"]}, outputs={"y": fast["y"]})
    paths = [str(wb.write_csv(e, tmp_path / f"{e.name}.csv")) for e in (fast, slow)]
    words = ["identify", *paths, "--inputs", "u", "--output", "y", "--model", "lti", "--order", "2", "--accept"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 2
    assert "identify --dt" in capsys.readouterr().err
    assert main([*words, "--dt", "1", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "a: sampled every 0.5 s, used every 1 s" in said
    assert "a (400 samples), b (400 samples), sampled every 1 s" in said
    assert wb.load_model(tmp_path / "out" / "lti.json").dt == 1.0
