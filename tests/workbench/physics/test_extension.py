"""Plant files: an extended plant runs as its base does with the same numbers given by hand."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plants import PLANTS, WEB_WINDING
from workbench.errors import InputError
from workbench.physics.controller import Playback
from workbench.physics.extension import extension, load_extension
from workbench.simulation import Scenario, simulate

AXIS = PLANTS["positioning-axis"]
FOUND = extension(
    AXIS,
    "positioning-axis",
    {"M": 97.0},
    {"coulomb@slide": {"level": 20.0, "width": 0.02}},
    {"configuration": {"made by": "hand"}},
)


def run(plant, **options):
    push = Scenario("push", {"F": 60.0 * np.sign(np.sin(0.01 * np.arange(400)))})
    return simulate(plant, Playback(("F",), plant.dt), push, **options).states.values


def test_an_extended_plant_runs_as_its_base_with_the_same_parameters_and_effects():
    effects = {"coulomb@slide": {"level": 20.0, "width": 0.02}}
    np.testing.assert_array_equal(run(FOUND.of(AXIS)), run(AXIS, parameters={"M": 97.0}, effects=effects))
    assert np.abs(run(FOUND.of(AXIS)) - run(AXIS)).max() > 1e-3


def test_an_effect_on_top_changes_its_own_numbers_and_leaves_the_others():
    on_top = {"coulomb@slide": {"level": 30.0}, "input-delay@F": {"time": 0.003}}
    both = {"coulomb@slide": {"level": 30.0, "width": 0.02}, "input-delay@F": {"time": 0.003}}
    np.testing.assert_array_equal(run(FOUND.of(AXIS), effects=on_top), run(AXIS, parameters={"M": 97.0}, effects=both))


def test_it_is_linearized_with_its_effects_and_starts_like_its_base():
    plant = FOUND.of(AXIS)
    A = plant.linearize(np.zeros(2), np.zeros(1))[0]
    assert A[1, 1] == pytest.approx(-(200.0 + 20.0 / 0.02) / 97.0)  # d/dv of Fv v + 20 tanh(v/0.02), at rest
    winding = extension(WEB_WINDING, "web-winding", {}, {"coulomb@rewind": {"level": 0.002}}).of(WEB_WINDING)
    np.testing.assert_array_equal(winding.equilibrium()[0], WEB_WINDING.equilibrium()[0])


def test_what_is_found_about_an_extended_plant_is_added_to_what_it_has():
    again = extension(FOUND.of(AXIS), "positioning-axis", {"Fv": 210.0}, {"coulomb@slide": {"level": 19.0}})
    assert again.parameters == {"M": 97.0, "Fv": 210.0}
    assert again.effects == {"coulomb@slide": {"level": 19.0, "width": 0.02}}
    assert again.of(AXIS).effects == again.effects


@pytest.mark.slow
@given(st.floats(1e-9, 1e9), st.floats(0.0, 1e9))
def test_numbers_survive_the_file_exactly(tmp_path_factory, mass, level):
    path = tmp_path_factory.mktemp("plant") / "p.json"
    extension(AXIS, "positioning-axis", {"M": mass}, {"coulomb@slide": {"level": level}}).save(path)
    back = load_extension(path)
    assert back.parameters == {"M": mass, "Fv": 200.0}
    assert back.effects == {"coulomb@slide": {"level": level}}


def test_a_file_is_read_without_the_package_and_names_every_parameter(tmp_path):
    content = json.loads(FOUND.save(tmp_path / "p.json").read_text())
    assert content["schema"].endswith("/plant")
    assert content["version"] == 1
    assert content["parameters"] == {"M": 97.0, "Fv": 200.0}
    assert content["provenance"] == {"configuration": {"made by": "hand"}}


def test_a_file_of_another_plant_and_malformed_files_are_refused_by_name(tmp_path):
    path = FOUND.save(tmp_path / "p.json")
    with pytest.raises(InputError, match="extends plant 'positioning-axis', not 'web-winding'"):
        load_extension(path).of(WEB_WINDING)
    good = json.loads(path.read_text())
    for change, said in (
        ({"schema": "other"}, "not a plant file"),
        ({"version": 2}, "version 2"),
        ({"parameters": [1.0]}, "'parameters' is missing or no dict"),
        ({"parameters": {"M": "97"}}, "M = '97' is not a finite number"),
        ({"parameters": {"M": True}}, "not a finite number"),
        ({"parameters": {"M": -1.0}}, "must be greater than 0"),
        ({"parameters": {"Mass": 1.0}}, "unknown parameter 'Mass'"),
        ({"effects": {"coulomb@slide": 3.0}}, "expected numbers by name"),
        ({"effects": {"coulomb@side": {"level": 1.0}}}, "did you mean 'coulomb@slide'"),
        ({"effects": {"coulomb@slide": {"level": -1.0}}}, "lies in"),
    ):
        path.write_text(json.dumps(good | change))
        with pytest.raises(InputError, match=said):
            load_extension(path).of(AXIS)
    path.write_text("[]")
    with pytest.raises(InputError, match="not a plant file"):
        load_extension(path).of(AXIS)
