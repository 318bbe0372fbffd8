"""The command `calibrate`: what it says, what it writes, and the plant file that other commands take."""

import json
from dataclasses import replace

import pytest

from studies.cli import main
from studies.commands.calibrate import parse_bounds
from workbench.errors import InputError
from workbench.readers import read_file, write_csv

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    folder = tmp_path_factory.mktemp("records")
    words = ["--experiment", "prbs", "rbs", "multisine", "--parameter", "m1=1.1", "--parameter", "b1=0.5", "--seed", "4"]
    assert main(["simulate", "welding-robot", *words, "--out", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def calibrated(records, tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibrated")
    own, held = [str(records / f"{name}.csv") for name in ("prbs", "rbs")], str(records / "multisine.csv")
    words = [*own, "--plant", "welding-robot", "--parameters", "m1,b1", "--bound", "b1=0.2:0.45", "--holdout", held]
    assert main(["calibrate", *words, "--out", str(folder), "--json", str(folder / "c.json")]) == 0
    return folder


def test_the_numbers_of_the_file_are_the_fit(calibrated):
    content = json.loads((calibrated / "c.json").read_text())
    assert content == json.loads((calibrated / "calibration.json").read_text())
    m1, b1 = content["parameters"]["m1"], content["parameters"]["b1"]
    assert m1["low"] < m1["value"] < m1["high"]
    assert (m1["nominal"], m1["tolerance"], m1["unit"], m1["at_bound"]) == (1.0, 0.15, "kg", False)
    assert m1["told"] > 0.9
    assert (b1["value"], b1["at_bound"]) == (0.45, True)
    assert "stands at its bound" in b1["warning"]
    assert set(content["starts"]) == {"prbs", "rbs"}
    assert {(e["record"], e["split"], e["horizon"]) for e in content["errors"]} == {
        ("multisine", "held-out", "one-step"), ("multisine", "held-out", "full-run"),
    }  # fmt: skip
    full = next(e for e in content["errors"] if e["horizon"] == "full-run")
    assert full["after"] < 0.5 * full["before"]
    assert set(content["provenance"]["data"]) == {"prbs.csv", "rbs.csv", "multisine.csv"}


def test_the_page_shows_parameters_errors_and_runs(calibrated):
    page = (calibrated / "report.html").read_text()
    for text in (
        "Calibration of welding-robot",
        "Fitted parameters",
        "Records say",
        "multisine",
        "b1 stands at its bound",
        "Starts",
    ):
        assert text in page


def test_the_plant_file_is_taken_by_the_next_command(calibrated, records, tmp_path, capsys):
    path = str(calibrated / "extended.json")
    assert main(["simulate", path, "--inputs-from", str(records / "multisine.csv"), "--out", str(tmp_path)]) == 0
    fits = json.loads((tmp_path / "simulate.json").read_text())["runs"][0]["scores"]
    assert fits[0]["FIT"] > 90.0
    capsys.readouterr()
    words = [str(records / "rbs.csv"), "--plant", path, "--parameters", "b1", "--out", str(tmp_path / "again")]
    assert main(["calibrate", *words]) == 0
    said = capsys.readouterr().out
    assert "b1                0.45 " in said  # the new nominal value
    assert "no held-out records" in said


def test_a_users_own_plant_is_named_beside_its_file(records, tmp_path):
    code = tmp_path / "mine.py"
    code.write_text("from plants import PLANTS\nMINE = PLANTS['welding-robot']\n")
    record = str(records / "prbs.csv")
    words = ["calibrate", record, "--plant", f"{code}:MINE", "--parameters", "m1", "--out", str(tmp_path / "c")]
    assert main(words) == 0
    file = tmp_path / "c" / "extended.json"
    assert main(["simulate", str(file), "--inputs-from", record, "--out", str(tmp_path / "s")]) == 2
    assert main(["simulate", f"{code}:MINE+{file}", "--inputs-from", record, "--out", str(tmp_path / "s")]) == 0


def test_bounds_are_read_and_bad_ones_refused():
    assert parse_bounds(["kE=150:250", "B1 = 1e-5 : 3e-5"]) == {"kE": (150.0, 250.0), "B1": (1e-5, 3e-5)}
    for text in ("kE", "kE=150", "kE=a:b", "kE=1:nan", "=:"):
        with pytest.raises(InputError, match="name=low:high"):
            parse_bounds([text])
    with pytest.raises(InputError, match="given twice"):
        parse_bounds(["kE=1:2", "kE=1:3"])


def test_a_held_out_record_among_the_fitted_ones_is_refused(records, tmp_path, capsys):
    path = str(records / "prbs.csv")
    assert main(["calibrate", path, "--plant", "welding-robot", "--holdout", path, "--out", str(tmp_path / "o")]) == 2
    assert "prbs" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def test_a_held_out_record_in_another_unit_is_refused_before_anything_is_fitted(records, tmp_path, capsys):
    e = read_file(records / "rbs.csv")
    values = e.values.copy()
    values[:, e.names.index("v")] *= 1000.0
    write_csv(replace(e, values=values), tmp_path / "held.csv")
    words = [str(records / "prbs.csv"), "--plant", "welding-robot", "--holdout", str(tmp_path / "held.csv")]
    assert main(["calibrate", *words, "--out", str(tmp_path / "o")]) == 2
    said = capsys.readouterr().err
    assert "held" in said
    assert "channel v: looks like mm/s, expected m/s" in said
    assert "fitting" not in said
