"""`workbench simulate --replay`: what was found is found again, and nothing is run that the user has not named."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from controllers.pid import pid
from plants import WELDING_ROBOT
from studies.cli import main
from studies.replays import replay_command
from workbench.physics.controller import content_of
from workbench.readers import read_file
from workbench.robustness.falsify.box import Dimension, tolerance_box
from workbench.robustness.falsify.search import worst_plant
from workbench.robustness.falsify.trials import Search
from workbench.robustness.limits import Limit, Manoeuvre

LAW = pid(("u",), ("v",), ("v_set",), 0.02, Kp=[[6.0]], Ki=[[8.0]], low=(-4.0,), high=(4.0,))
SPY = """
from pathlib import Path
Path(__file__).with_suffix(".ran").write_text("ran")
from plants import PLANTS
PLANT = PLANTS["welding-robot"]
"""


def found(plant=WELDING_ROBOT):
    manoeuvre = Manoeuvre(4.0, {"v": ((0.0, 0.0), (0.5, 0.4), (2.5, -0.3))}, seed=3)
    box = (*tolerance_box(plant), Dimension("level", 0.0, 0.3, effect="coulomb@rail"))
    limits = [Limit("v", high=0.42), Limit("v", band=0.02, settling=1.0)]
    return worst_plant(Search(plant, LAW, manoeuvre.scenario(plant, LAW), limits, box, runs=30))


@pytest.fixture(scope="module")
def worst():
    return found()


@pytest.fixture
def file(worst, tmp_path):
    return worst.counterexample("welding-robot", content_of(LAW)).save(tmp_path / "c.json")


def changed(path, change):
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    return str(path)


@pytest.mark.parametrize("plant", [[], ["welding-robot"]])
def test_a_counterexample_is_run_again(file, worst, tmp_path, capsys, plant):
    said = tmp_path / "said.json"
    assert main(["simulate", *plant, "--replay", str(file), "--out", str(tmp_path / "out"), "--json", str(said)]) == 0
    out = capsys.readouterr().out
    assert "band of 0.02 m/s broken by" in out
    assert f"stored {worst.excess:.12g} m/s, found now {worst.excess:.12g} m/s" in out
    assert "the counterexample stands" in out
    record = read_file(tmp_path / "out" / "limits.csv")
    assert record["v"][worst.sample] == pytest.approx(worst.value, rel=1e-8)
    assert set(record.names) == {"u", "v", "v_set"}
    assert (tmp_path / "out" / "states" / "limits.csv").is_file()
    content = json.loads(said.read_text())
    assert content == json.loads((tmp_path / "out" / "simulate.json").read_text())
    assert (content["runs"][0]["same"], content["runs"][0]["stored"]) == (True, worst.excess)
    assert "c.json" in content["provenance"]["data"]


def test_a_file_that_was_changed_ends_with_1_and_a_sentence(file, tmp_path, capsys):
    path = changed(file, lambda c: c.update(excess=c["excess"] * 1.001))
    assert main(["simulate", "--replay", path, "--out", str(tmp_path / "out")]) == 1
    assert "not the same" in capsys.readouterr().out
    assert json.loads((tmp_path / "out" / "simulate.json").read_text())["runs"][0]["same"] is False
    path = changed(file, lambda c: c["parameters"].update(m1=1.0))
    assert main(["simulate", "--replay", path, "--out", str(tmp_path / "out")]) == 1


@pytest.mark.parametrize(
    ("words", "change", "place", "mend"),
    [
        (["web-winding"], {}, "is of plant 'welding-robot', not 'web-winding'", "give welding-robot or leave it out"),
        ([], {"version": 2}, "version 2", "search again"),
        ([], {"plant": "web-winding"}, "is of plant 'web-winding', not 'welding-robot'", ""),
        ([], {"schema": "gain-scheduling-workbench/plant"}, "not a counterexample", "expected a JSON object"),
        ([], {"controller": {"schema": "x"}}, "not a controller", "workbench design"),
        ([], {"base": "this:d"}, "is of this:d, which is no machine", "simulate this:d --replay"),
        (["--seed", "0"], {}, "--seed goes not with --replay", "the file holds the whole run"),
        (["--noise-free"], {}, "--noise-free goes not with", "leave it out"),
        (["--experiment", "rbs"], {}, "--experiment goes not with", "leave it out"),
        (["--inputs-from", "a.csv"], {}, "--inputs-from goes not with", "leave it out"),
        (["--effect", "coulomb@rail:level=0.1"], {}, "--effect goes not with", "leave it out"),
        (["--parameter", "m1=1"], {}, "--parameter goes not with", "leave it out"),
        (["--start", "v1=1"], {}, "--start goes not with", "leave it out"),
        (["--controller", "c.json"], {}, "--controller goes not with", "leave it out"),
        (["--setpoint", "v=1"], {}, "--setpoint goes not with", "leave it out"),
        (["--duration", "3"], {}, "--duration goes not with", "leave it out"),
    ],
)
def test_what_cannot_be_replayed_is_refused_and_nothing_written(file, tmp_path, capsys, words, change, place, mend):
    path = changed(file, lambda c: c.update(change))
    assert main(["simulate", *words, "--replay", path, "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert place in said
    assert mend in said
    assert not (tmp_path / "out").exists()


def test_without_a_replay_the_plant_must_be_named(capsys):
    assert main(["simulate", "--experiment", "rbs"]) == 2
    assert "name one: web-winding" in capsys.readouterr().err


def test_a_plant_of_the_users_own_runs_only_where_the_user_names_it(worst, tmp_path, capsys):
    code = tmp_path / "mine.py"
    code.write_text(SPY)
    path = str(worst.counterexample(f"{code}:PLANT", content_of(LAW)).save(tmp_path / "c.json"))
    assert main(["simulate", "--replay", path, "--out", str(tmp_path / "a")]) == 2
    assert f"simulate {code}:PLANT --replay {path}" in capsys.readouterr().err
    assert main(["simulate", "web-winding", "--replay", path, "--out", str(tmp_path / "a")]) == 2
    assert f"give {code}:PLANT" in capsys.readouterr().err
    assert not code.with_suffix(".ran").exists()
    assert main(["simulate", f"{code}:PLANT", "--replay", path, "--out", str(tmp_path / "a")]) == 0
    assert code.with_suffix(".ran").exists()


def test_the_command_that_is_told_names_what_the_file_may_not():
    file = Path("run/counterexample-2.json")
    assert replay_command(file, "welding-robot", "") == "workbench simulate --replay run/counterexample-2.json"
    assert replay_command(file, "own.py:AXIS", "law.py:LAW").split()[2:] == [
        "own.py:AXIS", "--replay", str(file), "--controller", "law.py:LAW",
    ]  # fmt: skip
    assert replay_command(Path("sequence-1.json"), "own.py:AXIS", "law.py:LAW") == "workbench simulate --replay sequence-1.json"


def test_a_run_that_left_the_range_is_replayed_up_to_there(tmp_path, capsys):
    (tmp_path / "narrow.py").write_text(
        "from dataclasses import replace\nfrom plants import PLANTS\n"
        "PLANT = replace(PLANTS['welding-robot'], limits={'v1': (-1.0, 0.41)})\n"
    )
    narrow = replace(WELDING_ROBOT, limits={"v1": (-1.0, 0.41)})
    worst = found(narrow)
    assert worst.bound == "range"
    path = str(worst.counterexample("narrow.py:PLANT", content_of(LAW)).save(tmp_path / "c.json"))
    plant = f"{tmp_path / 'narrow.py'}:PLANT"
    assert main(["simulate", plant, "--replay", path, "--out", str(tmp_path / "out")]) == 0
    assert "leaves the range of the plant" in capsys.readouterr().out
    record = read_file(tmp_path / "out" / "limits.csv")
    assert len(record) == worst.sample < 200
    assert np.max(record["v"]) > 0.3
    assert json.loads((tmp_path / "out" / "simulate.json").read_text())["runs"][0]["stored"] is None


def test_a_record_is_told_from_a_stored_run(capsys):
    assert main(["simulate", "welding-robot", "--replay", "c.csv"]) == 2
    said = capsys.readouterr().err
    assert "c.csv: a record, and no stored counterexample\n  mend: to run the inputs of a record: --inputs-from c.csv" in said
