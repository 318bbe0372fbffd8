"""One run behind every law: a loop that is lost is said first and not handed out, and no proof stands beside it unexplained."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from controllers.files import load_controller, save_controller
from controllers.mpc import design_mpc
from controllers.pid import pid
from controllers.pid_design import design_pid
from studies.cli import main
from tests.controllers.test_pid_design import machine
from workbench.basis import CONSTANT, PiecewiseLinear
from workbench.data import Channel
from workbench.lpv import LPVModel, OperatingPoint, Predictor, Term, constant_model
from workbench.physics.plant import Plant
from workbench.physics.rest import Start
from workbench.verification.trial import along, followed, on_model, on_plant

DT, WEIGHT, GAIN, DAMPING, LAG = 0.02, 20.0, 40.0, 1.5, 0.1
DEG = np.pi / 180.0


def equation(x, u, p, at):
    """theta'' = GAIN f - WEIGHT sin(theta) - DAMPING theta', the propeller's push f lags behind its command."""
    push = GAIN * x.f - WEIGHT * np.sin(x.theta * DEG) - DAMPING * x.rate * DEG
    return {"theta": x.rate, "rate": push / DEG, "f": (u.v - x.f) / LAG}


ARM = Plant(
    name="arm",
    states=(Channel("theta", "deg"), Channel("rate", "deg/s"), Channel("f", "")),
    inputs=(Channel("v", "V", "input"),),
    outputs=(Channel("theta", "deg", "output"),),
    parameters=(),
    equation=equation,
    measure=lambda x, p: {"theta": x.theta},
    dt=DT,
    start=Start({"theta": 20.0}, ("rate", "f", "v"), ("theta", "rate", "f")),
    limits={"theta": (-90.0, 180.0)},
)


def arm_model() -> LPVModel:
    """The arm's linearisations from 5 to 70 deg, scheduled on its own angle, with the command that holds each."""
    knots = np.linspace(5.0, 70.0, 14)
    A, B = [], []
    for theta in knots:
        own = [[0.0, 1.0, 0.0], [-WEIGHT * np.cos(theta * DEG), -DAMPING, GAIN / DEG], [0.0, 0.0, -1.0 / LAG]]
        whole = expm(np.block([[np.array(own), np.array([[0.0], [0.0], [1.0 / LAG]])], [np.zeros((1, 4))]]) * DT)
        A, B = [*A, whole[:3, :3]], [*B, whole[:3, 3:]]
    basis, m = PiecewiseLinear(tuple(knots)), len(knots)
    point = OperatingPoint(basis, u=(WEIGHT / GAIN * np.sin(knots * DEG))[:, None], y=knots[:, None])
    return LPVModel(
        "arm-model", DT, (Channel("v", "V", "input"),), (Channel("theta", "deg", "output"),),
        (Channel("theta", "deg", "schedule"),), [[5.0, 70.0]], basis, tuple(Term(j) for j in range(m)), np.array(A), np.array(B),
        np.tile([[[1.0, 0.0, 0.0]]], (m, 1, 1)), np.zeros((m, 1, 1)), point,
    )  # fmt: skip


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """A folder with the arm's model, and the law that is made for it."""
    folder = tmp_path_factory.mktemp("arm")
    arm_model().save(folder / "m.json")
    return folder, design_pid(arm_model(), knots=3)


def test_an_arm_with_fine_margins_is_lost(arm):
    """Its feed-forward over a schedule that is its output is feedback: every frozen |S| is kept, and the arm is not."""
    _, found = arm
    assert found.margins.sensitivity.max() <= 1.6
    lost = on_plant(found.law, ARM, arm_model())
    assert lost.lost
    assert lost.sentence.startswith("the loop is lost on the plant arm: ")
    # with the same gains and the feed-forward of one angle nothing feeds back but the gains
    still = replace(
        found.law, u0=np.broadcast_to(found.law.gains_at(20.0).u0, found.law.u0.shape), Kr=np.zeros_like(found.law.Kr)
    )
    assert not along(still, ARM, np.repeat([[20.0], [22.0]], 1000, axis=0), 800).lost


def test_a_law_that_cannot_be_tried_is_not_handed_out(tmp_path, capsys):
    """A model whose outputs see the command of their own sample is no run for a law that holds its commands."""
    one = np.ones((1, 1))
    model = constant_model(
        "direct", DT, ((Channel("u", "V", "input"),), (Channel("y", "m", "output"),)), (0.5 * one, one, one, 0.2 * one),
        OperatingPoint(CONSTANT, 0.0 * one, 0.0 * one),
    )  # fmt: skip
    model.save(tmp_path / "m.json")
    words = ["design", "pid", "--model", str(tmp_path / "m.json"), "--out", str(tmp_path / "kept")]
    assert main(words) == 3
    assert capsys.readouterr().out.startswith("NOT HANDED OUT: not tried on the model direct: its outputs see the command")
    assert not (tmp_path / "kept" / "pid.json").exists()
    replace(model, D=np.zeros((1, 1, 1))).save(tmp_path / "m.json")
    assert main(words) == 0


@pytest.mark.slow
def test_the_model_itself_loses_it_where_its_schedule_is_its_output(arm):
    _, found = arm
    assert followed(arm_model()) == 0
    assert on_model(found.law, arm_model()).lost


@pytest.mark.slow
def test_design_hands_it_out_only_if_it_is_accepted(arm, capsys):
    folder, _ = arm
    words = ["design", "scheduled-pid", "--knots", "3", "--model", str(folder / "m.json")]
    assert main([*words, "--out", str(folder / "kept")]) == 3
    said = capsys.readouterr().out
    assert said.splitlines()[0].startswith("NOT HANDED OUT: the loop is lost on the model arm-model")
    assert not (folder / "kept" / "scheduled-pid.json").exists()
    assert json.loads((folder / "kept" / "design.json").read_text())["trial"]["lost"]
    assert main([*words, "--accept", "--out", str(folder / "taken")]) == 0
    assert capsys.readouterr().out.startswith("ACCEPTED ALL THE SAME: the loop is lost")
    assert load_controller(folder / "taken" / "scheduled-pid.json").schedule == "theta"


def test_check_says_that_the_plant_loses_what_is_proved_of_frozen_points(arm, capsys, monkeypatch):
    folder, found = arm
    save_controller(found.law, folder / "law.json")
    (folder / "limits.toml").write_text(
        "[run]\nduration = 30.0\n[run.setpoints]\ntheta = [[0.0, 20.0], [5.0, 60.0]]\n[limits.v]\nlow = -1e9\n"
    )
    monkeypatch.setitem(sys.modules, "arm_of_test", sys.modules[__name__])
    words = ["check", "--controller", str(folder / "law.json"), "--limits", str(folder / "limits.toml"), "--runs", "5"]
    assert main([*words, "--plant", "arm_of_test:ARM", "--out", str(folder / "checked")]) == 1
    assert capsys.readouterr().out.splitlines()[0].startswith("LOST: the loop is lost on the plant arm")
    content = json.loads((folder / "checked" / "check.json").read_text())
    assert content["status"] == "FAILED"
    assert content["verdicts"][-1]["claim"] == "the loop holds along one run"


def lag(pole=0.9) -> LPVModel:
    channels = (Channel("u", "V", "input"),), (Channel("y", "m", "output"),)
    return constant_model(
        "lag", 0.1, channels, ([[pole]], [[1.0]], [[1.0 - pole]], [[0.0]]), OperatingPoint(CONSTANT, [[0.5]], [[2.0]])
    )


@pytest.mark.slow
@pytest.mark.parametrize(("Ki", "lost"), [(0.5, ""), (-0.5, "runs away"), (60.0, "runs away")])
def test_a_loop_is_lost_if_theory_says_so(Ki, lost):
    law = pid(("u",), ("y",), ("y_set",), 0.1, [[0.0]], [[Ki]], u0=np.array([0.5]))
    found = on_model(law, lag())
    assert lost in found.lost
    assert bool(found.lost) == bool(lost)


def test_a_command_that_cannot_reach_far_steps_less():
    """Limits leave 0.1 V: the step is half of what that holds, and not lost."""
    law = pid(("u",), ("y",), ("y_set",), 0.1, [[0.0]], [[0.5]], u0=np.array([0.5]), low=np.array([0.4]), high=np.array([0.6]))
    found = on_model(law, lag())
    assert not found.lost
    assert "steps of y 0.05 m" in found.sentence


@pytest.mark.parametrize("high", [0.9, np.inf])
def test_a_model_that_counts_from_where_no_command_comes_is_tried_where_commands_reach(high):
    """A pump's model at standstill, a law that commands 0.6 to 0.9 of its speed: the loop is as sound as its margins say."""
    ends = {"low": np.array([0.6]), "high": np.array([high])}
    law = pid(("u",), ("y",), ("y_set",), 0.1, [[0.0]], [[0.5]], u0=np.array([0.7]), **ends)
    still = replace(lag(), operating_point=OperatingPoint(CONSTANT, [[0.0]], [[-5.8]]))
    found = on_model(law, still)
    assert not found.lost
    assert -5.8 + 0.6 <= float(found.sentence.split("from ")[1].split()[0]) <= -5.8 + 0.9


@pytest.mark.slow
def test_a_limit_cycle_at_the_stops_is_lost():
    law = pid(("u",), ("y",), ("y_set",), 0.1, [[0.0]], [[60.0]], u0=np.array([0.5]), low=np.array([-9.0]), high=np.array([10.0]))
    assert "away from its set-point" in on_model(law, lag()).lost


@pytest.mark.slow
def test_every_designed_law_of_a_sound_machine_is_handed_out():
    """The schedule of this machine is no output, and goes once along its span."""
    assert followed(machine()) is None
    trial = on_model(design_pid(machine(), knots=1).law, machine())
    assert not trial.lost
    assert "r2 going once along its span" in trial.sentence


def test_an_mpc_is_tried_within_the_limits_that_it_keeps():
    """The model rests at 0, far below them: that a set-point there is not followed is no loss."""
    model = constant_model(
        "tank", 0.1, ((Channel("u", "V", "input"),), (Channel("y", "m", "output"),)),
        ([[0.9]], [[0.1]], [[1.0]], [[0.0]]), OperatingPoint(CONSTANT, [[0.0]], [[0.0]]),
        predictor=Predictor([[[0.5]]], [[[0.1]]], [[[0.4]]], 5), noise=np.array([[1e-4]]),
    )  # fmt: skip
    fallback = pid(("u",), ("y",), ("y_set",), 0.1, [0.5], [0.5], low=[0.0], high=[10.0])
    for keep in ((5.0, 7.0), (5.0, np.inf), (-np.inf, -0.5)):
        law = design_mpc(model, fallback, horizon=10, y_low=np.array(keep[:1]), y_high=np.array(keep[1:]), low=np.array([-10.0]))
        trial = on_model(law, model)
        assert not trial.lost
        first = 6.0 if np.isfinite(keep).all() else keep[0] if np.isfinite(keep[0]) else keep[1]
        assert f"from {first:.4g}" in trial.sentence


@pytest.mark.parametrize(("b", "overshoots"), [(1.0, True), (0.0, False)])
def test_an_overshoot_is_said(b, overshoots):
    """A lag of 1 s under Kp = 3, Ki = 14: the set-point's zero makes it overshoot by a fifth and more, without it by less."""
    a = np.exp(-0.02)
    model = constant_model(
        "lag", 0.02, ((Channel("u", "V", "input"),), (Channel("y", "m", "output"),)),
        ([[a]], [[1.0 - a]], [[1.0]], [[0.0]]), OperatingPoint(CONSTANT, [[0.0]], [[0.0]]),
    )  # fmt: skip
    law = pid(("u",), ("y",), ("y_set",), 0.02, [3.0], [14.0], b=[b])
    trial = on_model(law, model, [1.0])
    assert not trial.lost
    assert ("overshoots by up to" in trial.sentence) is overshoots
    assert trial.overshoot == pytest.approx(stepped_by_hand(3.0, 14.0, b, a), abs=0.006)
    if overshoots:
        said = float(trial.sentence.split("by up to ")[1].split("%")[0]) / 100.0
        assert said == pytest.approx(stepped_by_hand(3.0, 14.0, b, a), abs=0.006)


def stepped_by_hand(Kp, Ki, b, a):
    """The largest y - 1 after a unit step."""
    x, z, found = 0.0, 0.0, []
    for _ in range(1000):
        found.append(x - 1.0)
        u = Kp * (b - x) + z
        z += 0.02 * Ki * (1.0 - x)
        x = a * x + (1.0 - a) * u
    return max(found)
