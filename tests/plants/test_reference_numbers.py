"""The plants' numbers against the agreed ones in tests/published."""

import tomllib
from pathlib import Path

import pytest

from plants import PLANTS
from studies.experiments import SAMPLES, web_winding_loops

TOML = tomllib.loads((Path(__file__).parents[1] / "published" / "reference_machine.toml").read_text())


@pytest.mark.parametrize("name", PLANTS)
def test_parameters_are_those_of_the_reference_file(name):
    plant, table = PLANTS[name], TOML[name.replace("-", "_")]
    ours = {p.name: p for p in plant.parameters}
    assert plant.dt == table["sample_time"]
    for key, row in table["parameters"].items():
        assert ours.pop(key).value == row["value"], key
    assert set(ours) <= {"T_set"}
    for key, row in table["parameters"].items():
        p = next(q for q in plant.parameters if q.name == key)
        assert (p.unit, p.tolerance) == (row["unit"], row["tolerance"])


def test_noise_loops_and_duration_of_the_winding_machine():
    table, plant, loops = TOML["web_winding"], PLANTS["web-winding"], web_winding_loops()
    noise = dict(table["noise"])
    assert set(plant.disturbance.values()) == {noise.pop("voltage_disturbance")}
    assert dict(plant.noise) == noise
    pid = table["pid"]
    assert loops.Kp.tolist() == [[[pid["kp_w"], 0.0], [0.0, -pid["kp_t"]]]]
    assert loops.Ki.tolist() == [[[pid["ki_w"], 0.0], [0.0, -pid["ki_t"]]]]
    assert SAMPLES * plant.dt == table["duration"]
