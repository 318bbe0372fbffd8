"""`workbench design`: files that come back as they went, what is said, and what is refused."""

import csv
import json
from dataclasses import replace
from types import SimpleNamespace

import control
import numpy as np
import pytest

import studies.design as design_module
from controllers.designs import ScheduledPIDDesign
from controllers.files import load_controller, save_controller
from controllers.pictures import _step
from controllers.pid import pid
from controllers.pid_design import design_pid
from controllers.scheduled_pid import BackCalculation, Clamping, Gains
from plants import WEB_WINDING
from studies.cli import main
from studies.design import _limits, _setpoints_said
from studies.experiments import plan, web_winding_loops
from workbench.basis import CONSTANT, PiecewiseLinear
from workbench.data import Channel, Dataset
from workbench.errors import InputError
from workbench.identification.ssm import SSM
from workbench.lpv import LPVModel, OperatingPoint, Term, load_model
from workbench.simulation import simulate
from workbench.verification.trial import Trial

pytestmark = pytest.mark.slow


def turning_model() -> LPVModel:
    """Two quick lags behind steady gains that turn with the radius; sampled as the winding machine is."""
    A, gains = 0.7 * np.eye(2), (np.array([[20.0, 45.0], [-30.0, 15.0]]), np.array([[45.0, 20.0], [-15.0, 30.0]]))
    return LPVModel(
        "turning", 0.04, (Channel("V1", "V", "input"), Channel("V2", "V", "input")),
        (Channel("w3", "rad/s", "output"), Channel("theta", "deg", "output")), (Channel("r2", "m", "schedule"),),
        [[0.011, 0.0264]], PiecewiseLinear((0.011, 0.0264)), (Term(0), Term(1)), np.stack([A, A]),
        np.stack([0.3 * G for G in gains]), np.stack([np.eye(2)] * 2), np.zeros((2, 2, 2)),
        OperatingPoint(CONSTANT, u=[[0.3, 2.0]], y=[[100.0, 0.0]]),
    )  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A designed law: its folder, and the model it was made from."""
    place = tmp_path_factory.mktemp("design")
    turning_model().save(place / "m.json")
    options = ["--knots", "2", "--low", "V1=0,V2=0", "--high", "V2=10", "--setpoint", "w3=100,theta=0"]
    files = ["--model", str(place / "m.json"), "--out", str(place / "out"), "--json", str(place / "d.json")]
    code = main(["design", "scheduled-pid", *options, *files])
    assert code == 0
    return place


def test_what_design_writes(folder):
    law, result = load_controller(folder / "out" / "scheduled-pid.json"), json.loads((folder / "d.json").read_text())
    assert law.schedule == "r2"
    np.testing.assert_array_equal(law.low, [0.0, 0.0])
    np.testing.assert_array_equal(law.high, [np.inf, 10.0])
    assert result == json.loads((folder / "out" / "design.json").read_text())
    assert max(result["margins"]["sensitivity"]) <= 1.6
    assert result["provenance"]["data"].keys() == {"m.json"}
    with open(folder / "out" / "margins.csv") as stream:
        rows = list(csv.DictReader(stream))
    np.testing.assert_allclose([float(row["S"]) for row in rows], result["margins"]["sensitivity"], rtol=1e-8)


def test_the_gain_table_holds_the_gains_of_the_law(folder):
    law = load_controller(folder / "out" / "scheduled-pid.json")
    with open(folder / "out" / "gains.csv") as stream:
        rows = list(csv.DictReader(stream))
    assert "Ki_V1_theta [V/(deg)/s]" in rows[0]
    assert len(rows) == 2
    for row in rows:
        Kp, Ki, Kd, Kr, _, Kaa, u0 = law.gains_at(float(row["r2 [m]"]))
        assert float(row["Kaa_V2_w3 [V/(rad/s) s^2]"]) == Kaa[1, 0]
        assert float(row["Kp_V2_w3 [V/(rad/s)]"]) == Kp[1, 0]
        assert float(row["Ki_V1_theta [V/(deg)/s]"]) == Ki[0, 1]
        assert float(row["Kd_V2_theta [V/(deg) s]"]) == Kd[1, 1]
        assert float(row["Kr_V2_w3 [V/(rad/s)]"]) == Kr[1, 0]
        assert float(row["u0_V2 [V]"]) == u0[1]


def test_simulate_closes_the_loop_with_the_file(folder, capsys):
    file = str(save_controller(web_winding_loops(), folder / "scheduled-pid.json"))
    code = main(["simulate", "web-winding", "--experiment", "staircase", "--controller", file, "--out", str(folder / "sim")])
    assert code == 0
    assert "w3: error RMS" in capsys.readouterr().out
    run = json.loads((folder / "sim" / "simulate.json").read_text())
    assert run["runs"][0]["tracking"][0]["RMS"] == pytest.approx(5.5, abs=0.5)
    assert "scheduled-pid.json" in run["provenance"]["data"]


@pytest.mark.parametrize("anti_windup", [Clamping(), BackCalculation(), BackCalculation(np.array([0.5, 1.0]))])
def test_a_law_comes_back_as_it_went(tmp_path, anti_windup):
    law = pid(("a", "b"), ("c", "d"), ("r", "s"), 0.1, np.eye(2), [[0.1, 0.2], [0.3, 0.4]], Tf=0.3, high=(1.0, np.inf),
              anti_windup=anti_windup)  # fmt: skip
    law = replace(law, name="mine")
    back = load_controller(save_controller(law, tmp_path / "c.json"))
    np.testing.assert_array_equal(back.gains, law.gains)
    assert (back.name, back.schedule, type(back.anti_windup), back.basis.names) == ("mine", None, type(anti_windup), ("1",))
    np.testing.assert_array_equal(back.span, law.span)
    assert "NaN" not in (tmp_path / "c.json").read_text()


def test_a_fixed_law_says_where_it_breaks_its_bounds(folder, capsys):
    assert main(["design", "pid", "--model", str(folder / "m.json"), "--out", str(folder / "fixed")]) == 0
    said = capsys.readouterr().out
    assert f"workbench check --controller {folder / 'fixed' / 'pid.json'} --limits limits.toml --model" in said
    assert "the fixed law breaks its bounds at" in said
    assert "workbench design scheduled-pid keeps them" in said
    # where it was made it keeps them, the effort too, which counts outputs in the design's own units
    found = design_pid(turning_model(), knots=1)
    over = json.loads((folder / "fixed" / "design.json").read_text())["margins"]
    assert over["effort"][12] == pytest.approx(found.margins.effort[0], rel=1e-3)


def test_an_mpc_comes_back_as_it_went_and_closes_the_loop(tmp_path, capsys):
    """On a model of the machine's own records, with the identification loops as fallback."""
    plans = [plan("web-winding", name) for name in ("prbs1", "rbs")]
    runs = [simulate(WEB_WINDING, p.controller, p.scenario(1)).experiment for p in plans]
    SSM(order=4, mu_factor=1.1).fit(Dataset(tuple(e.with_roles(("V1", "V2"), ("w3", "theta"), ("r2",)) for e in runs))).save(
        tmp_path / "m.json"
    )
    fallback = replace(web_winding_loops(), actuated=("V1", "V2"), measured=("w3", "theta"), u0=web_winding_loops().u0[:, ::-1],
                       Kp=web_winding_loops().Kp[:, ::-1], Ki=web_winding_loops().Ki[:, ::-1])  # fmt: skip
    save_controller(fallback, tmp_path / "pid.json")
    files = ["--model", str(tmp_path / "m.json"), "--fallback", str(tmp_path / "pid.json"), "--out", str(tmp_path / "out")]
    limits = ["--low", "V1=-1,V2=0", "--high", "V1=4,V2=5", "--rate", "V1=20", "--keep", "theta=-15:15"]
    assert main(["design", "mpc", *files, *limits, "--horizon", "10"]) == 0
    said = capsys.readouterr().out
    assert "theta is kept from -15 to 15 deg" in said
    assert "V1 from -1 to 4 V, at most 20 V/s: always" in said
    law = load_controller(tmp_path / "out" / "mpc.json")
    again = load_controller(save_controller(law, tmp_path / "again.json"))
    r, y = np.array([100.0, 0.0]), np.array([99.0, 1.0])
    one, other = law.init(np.array([0.1, 2.3])), again.init(np.array([0.1, 2.3]))
    for _ in range(5):
        (u, one), (v, other) = law.step(one, r, y, 0.015), again.step(other, r, y, 0.015)
        np.testing.assert_array_equal(u, v)
    code = main(["simulate", "web-winding", "--experiment", "rbs", "--controller", str(tmp_path / "out" / "mpc.json"),
                 "--out", str(tmp_path / "sim")])  # fmt: skip
    assert code == 0
    run = json.loads((tmp_path / "sim" / "simulate.json").read_text())["runs"][0]
    assert run["statuses"] == {"optimal": 2250}
    assert run["tracking"][0]["RMS"] < 15.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["scheduled-pi"], "unknown controller 'scheduled-pi'"),
        (["scheduled-pid", "--sensitivity", "0.9"], "--sensitivity 0.9"),
        (["scheduled-pid", "--knots", "1"], "a scheduled law has two or more"),
        (["scheduled-pid", "--setpoint", "w3=100"], "no set-point for theta"),
        (["scheduled-pid", "--setpoint", "w4=100"], "unknown output 'w4'"),
        (["scheduled-pid", "--high", "V3=10"], "unknown input 'V3'"),
        (["scheduled-pid", "--low", "V1=2", "--high", "V1=1"], "V1: lower limit 2 is not below the upper 1"),
        (["pid", "--at", "0.5"], "the model knows r2 from 0.011 to 0.0264 m"),
        (["scheduled-pid", "--at", "0.02"], "--at is for a fixed law"),
        (["mpc", "--keep", "theta=5"], "write theta=LOW:HIGH"),
        (["mpc", "--keep", "phi=1:2"], "unknown output 'phi'"),
    ],
)
def test_slips_are_named(folder, capsys, arguments, message):
    assert main(["design", *arguments, "--model", str(folder / "m.json"), "--out", str(folder / "none")]) == 2
    assert message in capsys.readouterr().err
    assert not (folder / "none").exists()


def test_files_that_are_no_controllers_are_refused(folder, tmp_path):
    with pytest.raises(InputError, match="not a controller"):
        load_controller(folder / "m.json")
    content = json.loads((folder / "out" / "scheduled-pid.json").read_text())
    for change, message in (
        ({"version": 9}, "version 9"),
        ({"kind": "lqr"}, "unknown kind of controller 'lqr'"),
        ({"Kp": [[[1.0]]]}, "malformed controller"),
        ({"high": [-1.0, 5.0]}, "lower limit 0 is not below the upper -1"),
        ({"anti_windup": {"kind": "none"}}, "unknown anti-windup 'none'"),
    ):
        (tmp_path / "c.json").write_text(json.dumps(content | change))
        with pytest.raises(InputError, match=message):
            load_controller(tmp_path / "c.json")
    del content["Ki"]
    (tmp_path / "c.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="field 'Ki' is missing"):
        load_controller(tmp_path / "c.json")


def test_nonlinear_mpc_is_designed_and_runs(folder, tmp_path, capsys):
    limits = ["--low", "V1=-1,V2=0", "--high", "V1=5,V2=5", "--keep", "theta=-20:20"]
    fallback = ["--model", str(folder / "m.json"), "--fallback", str(folder / "out" / "scheduled-pid.json")]
    assert main(["design", "nmpc", "--plant", "web-winding", *fallback, *limits, "--out", str(tmp_path)]) == 0
    assert "theta is kept from -20 to 20 deg" in capsys.readouterr().out
    options = ["--experiment", "ramp", "--controller", str(tmp_path / "nmpc.json"), "--json", str(tmp_path / "s.json")]
    assert main(["simulate", "web-winding", *options, "--out", str(tmp_path / "run")]) == 0
    run = json.loads((tmp_path / "s.json").read_text())["runs"][0]
    assert run["statuses"] == {"optimal": 2250}
    assert {score["output"]: score["RMS"] < limit for score, limit in zip(run["tracking"], (2.0, 0.8), strict=True)} == {
        "w3": True, "theta": True
    }  # fmt: skip


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["nmpc"], "which plant does it predict with"),
        (["nmpc", "--plant", "welding-robot"], "unknown output 'w3'"),
        (["nmpc", "--plant", "web-winding", "--solver", "simplex"], "unknown solver 'simplex'"),
        (["nmpc", "--plant", "web-winding", "--horizon", "0"], "horizon 0"),
    ],
)
def test_what_a_nonlinear_mpc_needs(folder, options, message, capsys, tmp_path):
    files = ["--model", str(folder / "m.json"), "--fallback", str(folder / "out" / "scheduled-pid.json")]
    assert main(["design", *options, *files, "--out", str(tmp_path / "o")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def test_a_controller_file_never_runs_code_of_its_own(folder, tmp_path, capsys):
    limits = ["--plant", "web-winding", "--model", str(folder / "m.json")]
    fallback = ["--fallback", str(folder / "out" / "scheduled-pid.json")]
    assert main(["design", "nmpc", *limits, *fallback, "--out", str(tmp_path)]) == 0
    content = json.loads((tmp_path / "nmpc.json").read_text())
    content["plant"]["base"] = "evil.py:PLANT"
    (tmp_path / "nmpc.json").write_text(json.dumps(content))
    options = ["--experiment", "ramp", "--controller", str(tmp_path / "nmpc.json"), "--out", str(tmp_path / "run")]
    assert main(["simulate", "web-winding", *options]) == 2
    assert "evil.py:PLANT, which is no machine of the workbench" in capsys.readouterr().err


def test_a_schedule_beyond_the_law_is_said(tmp_path, capsys):
    loops = web_winding_loops()
    twice = {key: np.repeat(getattr(loops, key), 2, axis=0) for key in Gains._fields}
    for name, span in (("wide", (0.011, 0.0264)), ("narrow", (0.011, 0.02))):
        own = replace(loops, **twice, schedule="r2", span=np.array(span), basis=PiecewiseLinear(span))
        save_controller(own, tmp_path / f"{name}.json")
        options = ["--experiment", "ramp", "--controller", str(tmp_path / f"{name}.json"), "--out", str(tmp_path / name)]
        assert main(["simulate", "web-winding", *options]) == 0
    said = capsys.readouterr().out
    assert said.count("left the range that the law was made for") == 1
    beyond = float(said.partition("was made for by ")[2].partition("%")[0])
    with open(tmp_path / "narrow" / "ramp.csv") as stream:
        largest = max(float(row["r2 [m]"]) for row in csv.DictReader(stream))
    assert beyond == pytest.approx(100.0 * (largest - 0.02) / 0.009, abs=1.0)


@pytest.mark.parametrize(
    "edit",
    [{"kind": 5}, {"Tf": float("inf")}, {"dt": "fast"}, {"basis": {"kind": 3}}, {"measured": 7}, {"anti_windup": {"kind": None}}],
    ids=lambda edit: next(iter(edit)),
)
def test_a_controller_file_with_a_foreign_value_is_refused_in_a_sentence(folder, tmp_path, edit):
    content = json.loads((folder / "out" / "scheduled-pid.json").read_text())
    (tmp_path / "c.json").write_text(json.dumps(content | edit))
    with pytest.raises(InputError, match=r"c\.json"):
        load_controller(tmp_path / "c.json")


# ---- closing the loop by hand ------------------------------------------------------------------------------------------------


def test_simulate_holds_set_points_on_the_model_and_on_the_plant(folder, capsys):
    law, held = str(folder / "out" / "scheduled-pid.json"), ["--setpoint", "w3=100,theta=0", "--duration", "4"]
    assert main(["simulate", str(folder / "m.json"), "--controller", law, *held, "--out", str(folder / "on-model")]) == 0
    said = capsys.readouterr().out
    assert "setpoint: 100 samples at 0.04 s" in said
    assert "V1: from " in said
    with open(folder / "on-model" / "setpoint.csv") as stream:
        rows = list(csv.DictReader(stream))
    assert [float(rows[i]["r2 [m]"]) for i in (0, -1)] == pytest.approx([0.011, 0.0264])
    assert max(abs(float(row["w3 [rad/s]"]) - 100.0) for row in rows) < 0.5
    loops = str(save_controller(web_winding_loops(), folder / "loops.json"))
    plant = ["simulate", "web-winding", "--controller", loops, *held]
    assert main([*plant, "--out", str(folder / "on-plant")]) == 0
    assert main([*plant, "--effect", "input-delay@V1:time=0.02", "--out", str(folder / "late")]) == 0
    runs = [json.loads((folder / place / "simulate.json").read_text())["runs"][0] for place in ("on-plant", "late")]
    assert runs[0]["tracking"][0]["RMS"] != runs[1]["tracking"][0]["RMS"]
    assert runs[0]["at_limit"] == {"V2": 0.0, "V1": 0.0}


def test_steps_of_the_frozen_loop_are_those_of_the_linear_closed_loop(folder):
    """Python-control closes the law, a linear system of set-points and outputs, around the same frozen model."""
    law, model = load_controller(folder / "out" / "scheduled-pid.json"), load_model(folder / "m.json")
    law = replace(law, low=np.full(2, -np.inf), high=np.full(2, np.inf), rate=np.full(2, np.inf))
    rho = 0.3 * model.span[0] + 0.7 * model.span[1]
    A, B, C, D = model.freeze(rho)
    P = control.ss(A, B, C, D, model.dt, inputs=list(law.actuated), outputs=list(law.measured), name="P")
    whole = control.interconnect([P, law.at(rho)], inputs=list(law.references), outputs=list(law.measured))
    t = model.dt * np.arange(80)
    for j in range(2):
        expected = control.forced_response(whole, t, np.outer(np.eye(2)[j], np.ones(80))).y[j]
        found = _step(law, model, rho, j, 80)
        np.testing.assert_allclose(found, expected, atol=1e-9)
        assert found[-1] == pytest.approx(1.0, abs=0.02)


def test_simulate_follows_the_run_of_a_file_of_limits(folder, capsys):
    """The same set-points as the check: steps where the file has them; the seed and --start are those of the command line."""
    limits = folder / "limits.toml"
    limits.write_text(
        "[run]\nduration = 6.0\n[run.setpoints]\nw3 = [[0.0, 100.0], [2.0, 104.0]]\ntheta = 1.0\n[limits.w3]\nhigh = 200.0\n"
    )
    loops = str(save_controller(web_winding_loops(), folder / "loops.json"))
    own = ["simulate", "web-winding", "--controller", loops, "--limits", str(limits), "--out", str(folder / "along")]
    assert main([*own, "--seed", "4"]) == 0
    with open(folder / "along" / "limits.csv") as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["w3_set [rad/s]"]) for row in rows] == [100.0] * 50 + [104.0] * 100
    assert {float(row["theta_set [deg]"]) for row in rows} == {1.0}
    first = (folder / "along" / "limits.csv").read_bytes()
    assert main([*own, "--seed", "5"]) == 0
    assert (folder / "along" / "limits.csv").read_bytes() != first
    capsys.readouterr()
    limits.write_text("[loop]\nstable = true\n")
    assert main(own) == 2
    assert "[run] is missing" in capsys.readouterr().err
    limits.write_text("[run]\nduration = 6.0\n[run.setpoints]\nw3 = 100.0\ntheta = 1.0\n[limits.w3]\nhigh = 200.0\n")
    assert main(["simulate", str(folder / "m.json"), *own[2:]]) == 2
    assert "--limits runs on a plant" in capsys.readouterr().err
    assert main(["simulate", "web-winding", "--limits", str(limits)]) == 2
    assert "--limits is for a controller to follow" in capsys.readouterr().err


def test_commands_at_their_limits_are_said(folder, capsys):
    law = load_controller(folder / "out" / "scheduled-pid.json")
    file = str(save_controller(replace(law, high=np.array([np.inf, 1.0])), folder / "weak.json"))
    held = ["--setpoint", "w3=100,theta=0", "--duration", "4", "--out", str(folder / "weak")]
    assert main(["simulate", str(folder / "m.json"), "--controller", file, *held]) == 0
    assert "V2: from 1 to 1, at a limit for 100.0% of the time" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--setpoint", "w3=100"], "no set-point for theta"),
        (["--setpoint", "w4=100,theta=0"], "w4"),
        (["--setpoint", "w3=100,theta=0", "--experiment", "ramp"], "--setpoint goes with no other run"),
        (["--setpoint", "w3=100,theta=0", "--limits", "l.toml"], "--setpoint goes with no other run"),
        (["--limits", "no-such.toml"], "no-such.toml"),
        (["--setpoint", "w3=100,theta=0", "--effect", "input-delay@V1:time=0.02"], "has no --effect"),
        (["--duration", "3"], "--duration is for --setpoint"),
        ([], "which experiment?\n  mend: give --setpoint"),
        (["--inputs-from", "a.csv"], "exclude each other"),
    ],
)
def test_slips_with_set_points_are_named(folder, capsys, options, message):
    law = str(folder / "out" / "scheduled-pid.json")
    assert main(["simulate", str(folder / "m.json"), "--controller", law, *options, "--out", str(folder / "slip")]) == 2
    assert message in capsys.readouterr().err
    assert not (folder / "slip").exists()


def test_set_points_need_a_controller(folder, capsys):
    assert main(["simulate", "web-winding", "--setpoint", "w3=100,theta=0", "--out", str(folder / "slip")]) == 2
    assert "--setpoint is for a controller to follow" in capsys.readouterr().err


# ---- limits and set-points of a design ---------------------------------------------------------------------------------------


def test_what_a_set_point_takes_is_said_and_held_against_the_limits(folder, capsys):
    common = ["design", "pid", "--model", str(folder / "m.json"), "--out", str(folder / "held")]
    assert main([*common, "--setpoint", "w3=100,theta=0", "--high", "V1=5,V2=5"]) == 0
    said = capsys.readouterr().out
    assert "the set-point takes V1 from 0.3 to 0.3 V over r2" in said  # the operating point of every radius
    assert "V1 from -inf to 5 V: always" in said
    assert "warning" not in said
    assert main([*common, "--setpoint", "w3=200,theta=0", "--high", "V2=3"]) == 3  # a run that cannot hold its set-point is lost
    said = capsys.readouterr().out
    assert said.startswith("NOT HANDED OUT")
    assert "warning: V2: its limits, -inf to 3 V, do not let it hold this set-point everywhere" in said
    assert "V1 has no limits" in said


def test_limits_of_an_mpc_that_are_not_given_are_those_of_its_fallback_law(folder):
    fallback = load_controller(folder / "out" / "scheduled-pid.json")
    options = type("Options", (), {"low": [], "high": ["V1=4"], "rate": []})()
    found = _limits(options, turning_model(), fallback)
    np.testing.assert_array_equal(found["high"], [4.0, 10.0])
    assert found["low"] is None


def test_a_rate_that_is_none_is_named(folder, capsys):
    assert main(["design", "pid", "--model", str(folder / "m.json"), "--rate", "V1=-5", "--out", str(folder / "rate")]) == 2
    assert "channel V1: --rate V1=-5" in capsys.readouterr().err


def test_knots_belong_to_a_scheduled_law(folder, capsys):
    assert main(["design", "pid", "--model", str(folder / "m.json"), "--knots", "3", "--out", str(folder / "knots")]) == 2
    assert "--knots is for a scheduled law" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("models", "slew", "given", "over", "said"),
    [
        ((np.inf, np.inf), np.inf, {}, 0.1, ""),
        ((np.inf, np.inf), np.inf, {}, 0.3, "steps still overshoot: limit their rate with --slew"),
        (
            (8.0, np.inf), np.inf, {}, 0.1,
            "set-points: y1 through a reference model of 8 rad/s; --reference-model y1=inf is as brisk as the margins allow",
        ),
        ((8.0, np.inf), np.inf, {"y1": 8.0}, 0.1, "set-points: y1 through a reference model of 8 rad/s"),
        (
            (8.0, 4.0), 2.0, {"y1": 8.0, "y2": 4.0}, 0.3,
            "set-points: y1 through a slew of 2 m/s and a reference model of 8 rad/s, y2 through a slew of 2 rad/s and a "
            "reference model of 4 rad/s; steps still overshoot: a smaller --reference-model",
        ),
    ],
)  # fmt: skip
def test_what_set_points_go_through_is_said(models, slew, given, over, said):
    model = SimpleNamespace(outputs=(Channel("y1", "m", "output"), Channel("y2", "rad", "output")))
    law = SimpleNamespace(bandwidth=np.array(models), slew=np.full(2, slew), paths=np.zeros(2, dtype=bool))
    wanted, trial = ScheduledPIDDesign(reference_model=given), Trial("", "", "", [over, 0.0], [1.0, 1.0])
    assert _setpoints_said(law, model, wanted, trial) == said


def test_a_diagnosis_needs_its_plant_and_a_pid(folder, capsys):
    """What cannot be cancelled is refused before any work."""
    model = str(folder / "m.json")
    found = folder / "alone" / "diagnosis.json"
    found.parent.mkdir()
    found.write_text(json.dumps({"causes": [], "recalibrated": {}, "moved": {}}))
    assert main(["design", "mpc", "--model", model, "--diagnosis", str(found)]) == 2
    assert "--diagnosis is for PIDs" in capsys.readouterr().err
    assert main(["design", "pid", "--model", model, "--diagnosis", str(found)]) == 2
    assert "no extended.json beside it" in capsys.readouterr().err
    assert main(["design", "pid", "--model", model, "--dt", "0.01"]) == 2
    assert "--dt is for a plant as --model" in capsys.readouterr().err
    assert main(["design", "pid", "--model", "welding-robot"]) == 2
    assert "it moves on its own" in capsys.readouterr().err


def test_a_plant_is_a_model_about_its_start(folder, capsys):
    out = folder / "axis"
    given = ["--dt", "0.01", "--path", "q", "--step", "q=0.1", "--out", str(out)]
    assert main(["design", "pid", "--model", "positioning-axis", *given]) == 0
    said = capsys.readouterr().out
    assert "q from F, order 2, sampled every 0.01 s" in said
    assert "steps of q 0.1 m" in said
    assert "q through the feedforward of its rate and acceleration" in said
    law = load_controller(out / "pid.json")
    np.testing.assert_allclose(law.Ka, 200.0, rtol=1e-3)
    np.testing.assert_allclose(law.Kaa, 95.0 + 0.01 * 200.0, rtol=5e-3)  # M, half a sample of Fv, half of a path's rate


@pytest.mark.parametrize(("model", "plant", "taken"), [
    ("own.py:AXIS+found/extended.json", None, "own.py:AXIS+found/extended.json"), ("lti.json", "robot", "robot"),
])  # fmt: skip
def test_a_compensation_is_tried_on_the_extended_plant_that_is_the_model(model, plant, taken, monkeypatch):
    monkeypatch.setattr(design_module, "choose_plant", lambda text: text)
    options = SimpleNamespace(model=model, plant=plant, diagnosis="found/diagnosis.json")
    assert design_module._tried_on(options) == taken
