"""`workbench check` as a user runs it: verdicts, exit codes, files that show what failed, and what wrong input is told."""

import json
from dataclasses import replace

import pytest

from controllers.files import save_controller
from controllers.pid import pid
from studies.cli import main
from tests.checker import checker
from workbench.data import Dataset
from workbench.identification.lti import LTI
from workbench.readers import read_file

pytestmark = pytest.mark.slow

LOOKED_AT = ("peak |S|", "disk margin", "the loop holds")  # refuted by a number, which is in the sentence
LIMITS = """
[run]
duration = 6.0
[run.setpoints]
v = [[0.0, 0.0], [2.0, {step}]]
[limits.v]
low = {low}
high = {high}
[limits.u]
low = -50.0
high = 50.0
[loop]
stable = true
{more}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Records of the robot, a model of them, and a PI law with and without integral action to spare."""
    folder = tmp_path_factory.mktemp("check")
    assert main(["simulate", "welding-robot", "--experiment", "prbs", "rbs", "--seed", "3", "--out", str(folder)]) == 0
    records = [read_file(folder / f"{name}.csv").with_roles(inputs=("u",), outputs=("v",)) for name in ("prbs", "rbs")]
    model = LTI(order=2, feedthrough=False).fit(Dataset(tuple(records)))
    model.save(folder / "lti.json")
    law = pid(("u",), ("v",), ("v_set",), model.dt, [2.0], [3.0], low=[-60.0], high=[60.0])
    save_controller(law, folder / "pid.json")
    return folder


def limits(folder, name="limits.toml", step=0.2, low=-0.5, high=0.6, more=""):
    path = folder / name
    path.write_text(LIMITS.format(step=step, low=low, high=high, more=more))
    return str(path)


def run(folder, *more, out="out"):
    """Exit code and check.json; the checker accepts all that is proved or refuted on the model."""
    proof = folder / out / "proof.json"
    wanted = ["check", "--controller", str(folder / "pid.json"), "--out", str(folder / out), "--proof", str(proof), *more]
    code, found = main(wanted), json.loads((folder / out / "check.json").read_text())
    checked = checker.check(shown := json.loads(proof.read_text())) if found["verdicts"] else []
    assert [said for _, accepted, said in checked if not accepted] == []
    decided = [(v["claim"], v["status"]) for v in found["verdicts"]
               if v["of"].startswith("model") and v["status"] in ("PROVED", "FAILED")]  # fmt: skip
    told = [(c["claim"], c["status"]) for c in shown["claims"]]
    assert told == [(claim, status) for claim, status in decided if not claim.startswith(LOOKED_AT)]
    return code, found


def on_model(folder):
    return ["--model", str(folder / "lti.json"), "--records", str(folder / "prbs.csv"), str(folder / "rbs.csv")]


def test_limits_with_room_are_proved_on_the_model_and_pass_on_the_plant(folder, capsys):
    code, found = run(
        folder, "--limits", limits(folder), *on_model(folder), "--plant", "welding-robot", "--runs", "40", out="good"
    )
    said = capsys.readouterr().out
    assert code == 0, said
    verdicts = {(v["claim"], v["of"]): v["status"] for v in found["verdicts"]}
    assert verdicts["stable", "model LTI"] == "PROVED"
    assert verdicts["v: high 0.6 m/s", "model LTI"] == "PROVED", said
    assert verdicts["v: low and high", "plant welding-robot"] == "PASSED"
    assert found["status"] == "PASSED"
    assert "PROVED" in (folder / "good" / "report.html").read_text()
    assert "report:" in said


def test_what_fails_exits_with_1_and_runs_again(folder, capsys):
    path = limits(folder, "tight.toml", step=0.4, high=0.38)
    code, found = run(folder, "--limits", path, *on_model(folder), "--plant", "welding-robot", "--runs", "30", out="bad")
    assert code == 1
    failed = [v for v in found["verdicts"] if v["status"] == "FAILED"]
    assert {v["of"] for v in failed} == {"model LTI", "plant welding-robot"}
    capsys.readouterr()
    for v in failed:
        assert v["margin"] < 0.0
        again = ["simulate", "--replay", str(folder / "bad" / v["witness"]), "--out", str(folder / "again")]
        assert main(again) == 0
        assert "the counterexample stands" in capsys.readouterr().out
    witness = next(folder / "bad" / v["witness"] for v in failed if v["of"] == "model LTI")
    content = json.loads(witness.read_text())
    content["controller"]["Kp"][0][0][0] *= 1.01
    witness.write_text(json.dumps(content))
    assert main(["simulate", "--replay", str(witness)]) == 1
    assert "does not stand" in capsys.readouterr().out


def test_a_run_begins_at_rest_under_the_set_points_that_were_before_it(folder, capsys):
    """From a rest at 0 to 0.7 m/s the speed is above 0.6 at once; from one at 0 it stays below."""
    path, text = folder / "before.toml", LIMITS.format(step=0.2, low=-0.5, high=0.6, more="")
    path.write_text(text.replace("duration = 6.0", "duration = 6.0\ninitial = {v = [0.0, 0.7]}"))
    code, found = run(folder, "--limits", str(path), *on_model(folder), out="before")
    assert code == 1
    (high,) = [v for v in found["verdicts"] if v["claim"].startswith("v: high")]
    assert (high["status"], high["margin"]) == ("FAILED", pytest.approx(-0.1, rel=1e-6))
    assert main(["simulate", "--replay", str(folder / "before" / high["witness"])]) == 0
    content = json.loads((folder / "before" / high["witness"]).read_text())
    content["share"] = [0.5]
    (folder / "changed.json").write_text(json.dumps(content))
    assert main(["simulate", "--replay", str(folder / "changed.json")]) == 1
    path.write_text(text.replace("duration = 6.0", "duration = 6.0\ninitial = {u = 1.0}"))
    capsys.readouterr()
    assert main(["check", "--controller", str(folder / "pid.json"), "--limits", str(path), *on_model(folder)]) == 2
    assert "output of the controller 'u'" in capsys.readouterr().err


def test_a_law_without_integral_is_checked_like_any_other(folder):
    """Its integral is no pole at 1 that is lost."""
    save_controller(pid(("u",), ("v",), ("v_set",), 0.02, [2.0], [0.0]), folder / "p.json")
    path = limits(folder, "p.toml", low=-0.5, high=0.6, more="sensitivity = 5.0")
    wanted = ["check", "--controller", str(folder / "p.json"), "--limits", path, *on_model(folder), "--out", str(folder / "pout")]
    assert main(wanted) == 0
    verdicts = {v["claim"]: v["status"] for v in json.loads((folder / "pout" / "check.json").read_text())["verdicts"]}
    assert (verdicts["stable"], verdicts["peak |S| at most 5"], verdicts["v: high 0.6 m/s"]) == ("PROVED", "PASSED", "PROVED")


def test_a_margin_that_is_not_there_fails_or_stays_open(folder):
    code, found = run(
        folder, "--limits", limits(folder, "m.toml", more="margin = 1000.0\nmoving = true"), *on_model(folder), out="m"
    )
    (verdict,) = [v for v in found["verdicts"] if v["claim"].startswith("stable")]
    assert verdict["status"] == "FAILED"
    assert code == 1
    assert main(["simulate", "--replay", str(folder / "m" / verdict["witness"])]) == 0


def test_sensitivity_is_looked_at_where_it_is_asked(folder):
    for asked, status in ((5.0, "PASSED"), (1.001, "FAILED")):
        _, found = run(folder, "--limits", limits(folder, "s.toml", more=f"sensitivity = {asked}"), *on_model(folder), out="s")
        (verdict,) = [v for v in found["verdicts"] if v["claim"].startswith("peak")]
        assert verdict["status"] == status


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        ([], "check on what?"),
        (["--model", "lti.json"], "go together"),
        (["--fitted", "d.json"], "check on what?"),
        (["--plant", "welding-robots"], "did you mean"),
        (["--plant", "welding-robot", "--limits", "none.toml"], "none.toml"),
        (["--plant", "welding-robot", "--controller", "lti.json"], "not a controller"),
    ],
)
def test_wrong_input_is_told(folder, capsys, monkeypatch, more, problem):
    monkeypatch.chdir(folder)
    wanted = ["check", "--controller", "pid.json", "--limits", limits(folder), *more]
    assert main(wanted) == 2
    assert problem in capsys.readouterr().err


def test_a_limit_of_a_signal_that_is_not_there_is_told(folder, capsys):
    path = folder / "w.toml"
    path.write_text(LIMITS.format(step=0.1, low=-1, high=1, more="").replace("[limits.u]", "[limits.w]"))
    assert main(["check", "--controller", str(folder / "pid.json"), "--limits", str(path), *on_model(folder)]) == 2
    assert "not a signal of this loop" in capsys.readouterr().err


def test_the_disk_margin_of_the_worst_corner_counts(folder):
    """Below that of the middle of the boxes, and refused where it is asked beyond what a disk margin can be."""
    for asked, status in ((0.05, "PASSED"), (1.99, "FAILED")):
        _, found = run(folder, "--limits", limits(folder, "d.toml", more=f"disk = {asked}"), *on_model(folder), out="d")
        (verdict,) = [v for v in found["verdicts"] if v["claim"].startswith("disk")]
        assert verdict["status"] == status
        words = verdict["sentence"].split()
        assert 0.0 < float(words[0]) < float(words[words.index("middle") - 3])
    wanted = ["check", "--controller", str(folder / "pid.json"), "--limits", limits(folder, "x.toml", more="disk = 2.5")]
    assert main([*wanted, *on_model(folder)]) == 2


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("[limits.u]", '[limits.u]\nunit = "kN"', "the model has it in N"),
        ("[limits.u]", "[limits.u]\nbegin = 5.99", "asks nothing within the run"),
        ("[2.0, 0.1]", "[7.0, 0.1]", "after the run's end"),
        ("duration = 6.0", "duration = 6.0\nstart = {v = 0.5}", "start is of a plant"),
        ("[limits.u]", "[limits.u]\nband = 0.1\nsettling = 1.0", "set-point"),
    ],
)
def test_limits_that_say_nothing_of_the_model_are_refused(folder, capsys, old, new, problem):
    path = folder / "n.toml"
    text = LIMITS.format(step=0.1, low=-1, high=1, more="")
    assert old in text
    path.write_text(text.replace(old, new))
    assert main(["check", "--controller", str(folder / "pid.json"), "--limits", str(path), *on_model(folder)]) == 2
    assert problem in capsys.readouterr().err


def test_a_law_of_another_clock_or_schedule_is_refused(folder, capsys):
    law = pid(("u",), ("v",), ("v_set",), 0.2, [2.0], [3.0])
    moving = replace(law, dt=0.02, schedule="arm", span=(0.0, 1.0))
    for other, problem in ((law, "sampled every 0.2 s"), (moving, "scheduled on arm, the model on nothing")):
        save_controller(other, folder / "other.json")
        wanted = ["check", "--controller", str(folder / "other.json"), "--limits", limits(folder), *on_model(folder)]
        assert main(wanted) == 2
        assert problem in capsys.readouterr().err


def test_what_is_not_checked_is_said(folder):
    """On the plant alone nothing is said of the loop, and the status is no better than that."""
    code, found = run(folder, "--limits", limits(folder), "--plant", "welding-robot", "--runs", "20", out="p")
    assert code == 0
    assert [v["status"] for v in found["verdicts"] if v["claim"] == "stable"] == ["UNDECIDED"]
    assert found["status"] == "UNDECIDED"


def test_a_loop_that_is_lost_fails_with_a_file(folder, capsys):
    save_controller(pid(("u",), ("v",), ("v_set",), 0.02, [2000.0], [3.0]), folder / "wild.json")
    wanted = ["check", "--controller", str(folder / "wild.json"), "--limits", limits(folder, "l.toml", more="sensitivity = 2.0")]
    assert main([*wanted, *on_model(folder), "--out", str(folder / "lost")]) == 1
    verdicts = json.loads((folder / "lost" / "check.json").read_text())["verdicts"]
    assert [v["status"] for v in verdicts if v["claim"].startswith(("stable", "peak"))] == ["FAILED", "FAILED"]
    assert not [v for v in verdicts if v["status"] == "PROVED"]
    assert main(["simulate", "--replay", str(folder / "lost" / verdicts[0]["witness"])]) == 0


def test_a_sequence_that_breaks_nothing_does_not_stand(folder, capsys):
    path = limits(folder, "tight.toml", step=0.4, high=0.38)
    _, found = run(folder, "--limits", path, *on_model(folder), out="bad2")
    witness = next(folder / "bad2" / v["witness"] for v in found["verdicts"] if v["status"] == "FAILED")
    content = json.loads(witness.read_text())
    content["high"] = content["value"] + 1.0
    witness.write_text(json.dumps(content))
    assert main(["simulate", "--replay", str(witness)]) == 1
    assert "does not stand" in capsys.readouterr().out


def test_noise_is_in_the_worst_order_where_a_seed_asks_for_it(folder):
    plain = limits(folder, "q.toml")
    noisy = folder / "noisy.toml"
    noisy.write_text(LIMITS.format(step=0.2, low=-0.5, high=0.6, more="").replace("duration = 6.0", "duration = 6.0\nseed = 1"))
    every = []
    for path in (plain, str(noisy)):
        _, found = run(folder, "--limits", path, *on_model(folder), out="n")
        every.append(next(v["every"] for v in found["verdicts"] if v["claim"].startswith("v: high")))
    assert every[1][1] > every[0][1] + 0.02  # the bound on what no parameter explains is 0.0206
