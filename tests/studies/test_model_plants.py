"""An identified model on the command line: taken wherever a plant is."""

import json

import numpy as np
import pytest

from studies.arguments import choose_plant, find_plant
from studies.cli import main
from tests.workbench.diagnosis.black_box import MODEL, records
from tests.workbench.diagnosis.test_black_box import LIMIT, limited
from workbench.errors import InputError
from workbench.files import write_json
from workbench.intervals.model import SCHEMA as INTERVAL_MODEL
from workbench.readers import read_file, write_csv

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """m.json, and three records of it behind a drive that saturates."""
    folder = tmp_path_factory.mktemp("models")
    MODEL.save(folder / "m.json")
    for e in records(41, acting=limited, samples=400, count=3):
        write_csv(e, folder / f"{e.name[-1]}.csv")
    return folder


@pytest.fixture(scope="module")
def diagnosed(files):
    arguments = ["diagnose", str(files / "0.csv"), str(files / "1.csv"), "--plant", str(files / "m.json")]
    assert main([*arguments, "--holdout", str(files / "2.csv"), "--out", str(files / "found")]) == 0
    return files / "found"


def test_a_diagnosis_of_a_model_names_extends_and_draws(diagnosed):
    found = json.loads((diagnosed / "diagnosis.json").read_text())
    assert [f"{c['effect']}@{c['at']}" for c in found["causes"]] == ["saturation@V1"]
    assert found["causes"][0]["parameters"]["limit"]["value"] == pytest.approx(LIMIT, rel=0.05)
    assert found["recalibrated"] == {}
    assert "saturation@V1" in (diagnosed / "report.html").read_text()
    assert "m.json" in found["provenance"]["data"]


def test_the_extended_model_runs_where_the_model_does(diagnosed, files):
    """Alone: the model that it extends is a file of numbers, no code."""
    measured = read_file(files / "2.csv")
    errors = []
    for plant in (files / "m.json", diagnosed / "extended.json", f"{files / 'm.json'}+{diagnosed / 'extended.json'}"):
        out = files / f"run {len(errors)}"
        assert main(["simulate", str(plant), "--inputs-from", str(files / "2.csv"), "--noise-free", "--out", str(out)]) == 0
        errors.append(np.std(read_file(out / "2.csv")["w"] - measured["w"]))
    assert errors[1] < 0.5 * errors[0]
    assert errors[2] == errors[1]


def test_records_without_the_schedule_are_refused(files, capsys):
    e = read_file(files / "0.csv")
    kept = [i for i, name in enumerate(e.names) if name != "r2"]
    bare = type(e)(e.name, e.t, tuple(e.channels[i] for i in kept), e.values[:, kept], e.dt)
    write_csv(bare, files / "bare.csv")
    assert main(["diagnose", str(files / "bare.csv"), "--plant", str(files / "m.json"), "--out", str(files / "no")]) == 2
    assert "r2" in capsys.readouterr().err
    assert not (files / "no").exists()


def test_parameters_of_a_model_cannot_be_calibrated(files, capsys):
    assert main(["calibrate", str(files / "0.csv"), "--plant", str(files / "m.json"), "--out", str(files / "no")]) == 2
    assert "identify" in capsys.readouterr().err


def test_an_interval_model_is_told_from_a_simulation(tmp_path):
    write_json(tmp_path / "i.json", {"schema": INTERVAL_MODEL, "version": 1})
    with pytest.raises(InputError, match="interval model") as caught:
        find_plant(str(tmp_path / "i.json"))
    assert "state-space model" in caught.value.mend


def test_a_model_is_named_by_its_file(files):
    chosen = choose_plant(str(files / "m.json"))
    assert (chosen.plant.name, chosen.base, chosen.files) == ("SSM", str(files / "m.json"), (str(files / "m.json"),))
