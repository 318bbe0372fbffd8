"""Designs as records, export as a method: the same controllers and files as the commands, and none that loses its loop."""

import json

import numpy as np
import pytest

import controllers
from controllers import MPC, MPCDesign, ScheduledPID, ScheduledPIDDesign, load_controller
from studies.cli import main
from workbench.errors import InputError, NotHandedOutError
from workbench.identification.lti import LTI
from workbench.physics.controller import check_controller
from workbench.sources import read
from workbench.verification.trial import Trial

LIMITS = {"low": {"u": -4.0}, "high": {"u": 4.0}}


@pytest.fixture(scope="module")
def model():
    """y+ = 0.9 y + 0.1 u, a sample late."""
    random = np.random.default_rng(2)
    u = np.repeat(random.normal(size=200), 5)
    y = np.zeros(len(u))
    for k in range(len(u) - 1):
        y[k + 1] = 0.9 * y[k] + 0.1 * u[k]
    data = read({"u": u, "y": y + 1e-3 * random.normal(size=len(u))}, inputs="u", outputs="y", dt=0.1)
    return LTI(order=1, feedthrough=False).fit(data)


@pytest.fixture(scope="module")
def law(model):
    return ScheduledPIDDesign(**LIMITS, setpoint={"y": 0.0}).on(model)


@pytest.mark.slow
def test_a_design_is_the_controller_that_the_command_writes(model, law, tmp_path):
    path = tmp_path / "model.json"
    model.save(path)
    words = ["design", "pid", "--model", str(path), "--low", "u=-4", "--high", "u=4", "--setpoint", "y=0"]
    assert main([*words, "--out", str(tmp_path / "pid")]) == 0
    written = load_controller(tmp_path / "pid" / "pid.json")
    for key in ("Kp", "Ki", "Kd", "Kr", "u0", "low", "high", "rate"):
        np.testing.assert_array_equal(getattr(law, key), getattr(written, key))
    words = ["design", "mpc", "--model", str(path), "--low", "u=-4", "--high", "u=4", "--keep", "y=-1:1", "--setpoint", "y=0"]
    assert main([*words, "--out", str(tmp_path / "mpc")]) == 0
    mpc = MPCDesign(**LIMITS, keep={"y": (-1.0, 1.0)}, setpoint={"y": 0.0}).on(model)
    other = load_controller(tmp_path / "mpc" / "mpc.json")
    assert isinstance(mpc, MPC)
    for key in ("low", "high", "rate", "y_low", "y_high", "horizon"):
        np.testing.assert_array_equal(getattr(mpc, key), getattr(other, key))
    assert json.dumps(mpc.fallback.to_dict(), default=list) == json.dumps(other.fallback.to_dict(), default=list)


def test_the_bounds_of_a_design_are_kept(model):
    calm = ScheduledPIDDesign(sensitivity=1.2, effort=20.0).design(model)
    brisk = ScheduledPIDDesign(sensitivity=1.6, effort=20.0).design(model)
    assert calm.margins.sensitivity.max() <= 1.2 + 1e-6
    assert brisk.low_frequency.min() > 1.2 * calm.low_frequency.min()


def test_a_controller_that_loses_its_loop_is_not_handed_out(model, monkeypatch):
    said = "the loop is lost on the model lti: y stays away"
    monkeypatch.setattr("controllers.designs.tried", lambda *_: Trial("the model lti", "y stays away", said))
    with pytest.raises(NotHandedOutError, match="y stays away"):
        ScheduledPIDDesign().on(model)
    assert isinstance(ScheduledPIDDesign().on(model, accept=True), ScheduledPID)


def test_a_controller_is_tried_on_the_plant_that_is_given_and_at_the_usual_set_point(model, monkeypatch):
    asked = []
    monkeypatch.setattr("controllers.designs.tried", lambda *given: asked.append(given) or Trial("", "", ""))
    plant = object()
    for design in (ScheduledPIDDesign(setpoint={"y": 0.5}), MPCDesign(setpoint={"y": 0.5})):
        law = design.on(model, plant)
        assert asked[-1] == (law, model, plant, [0.5])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"low": {"v": 0.0}}, "v"),
        ({"setpoint": {"z": 1.0}}, "z"),
        ({"rate": {"u": -1.0}}, "rate"),
    ],
)
def test_a_channel_that_the_model_does_not_have_is_named(model, options, said):
    with pytest.raises((InputError, ValueError), match=said):
        ScheduledPIDDesign(**options).on(model)


def test_what_is_no_model_and_no_range_is_named():
    with pytest.raises(InputError, match="a str, expected an LPV model"):
        ScheduledPIDDesign().on("ssm.json")
    with pytest.raises(InputError, match="keep y: 3"):
        MPCDesign(keep={"y": 3})


def test_export_writes_what_the_command_writes(law, tmp_path):
    path = controllers.save_controller(law, tmp_path / "pid.json")
    for form in ("c", "st", "csv", "json"):
        paths = law.export(form, tmp_path / "method" / form)
        assert main(["export", str(path), "--to", form, "--out", str(tmp_path / "command" / form)]) == 0
        for own in paths:
            assert own.read_text() == (tmp_path / "command" / form / own.name).read_text()
        assert paths


@pytest.mark.slow
def test_the_house_s_own_controllers_pass_what_is_asked_of_a_user_s(model, law):
    check_controller(law, "law")
    check_controller(MPCDesign(**LIMITS).on(model), "mpc")
    other = ScheduledPIDDesign(sensitivity=1.2).design(model).law

    class Liar(ScheduledPID):
        def step(self, state, r, y, rho=None):
            return other.step(state, r, y, rho)

    with pytest.raises(InputError, match="has law and step, which command"):
        check_controller(Liar(**{key: getattr(law, key) for key in law.__dataclass_fields__}), "liar")


def test_every_public_name_of_controllers_loads():
    for name in controllers.__all__:
        assert getattr(controllers, name) is not None
