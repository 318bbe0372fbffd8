"""Designs as records, export as a method: the same controllers and files as the commands, and none that loses its loop."""

import json
from dataclasses import replace

import control
import numpy as np
import pytest
from scipy.linalg import expm

import controllers
from controllers import MPC, MPCDesign, ScheduledPID, ScheduledPIDDesign, load_controller
from controllers.designs import PRICES, _answered
from controllers.mpc import default_weights, design_mpc
from controllers.pid import pid
from studies.cli import main
from workbench.basis import CONSTANT, PiecewiseLinear
from workbench.data import Channel
from workbench.errors import InputError, NotHandedOutError
from workbench.identification.lti import LTI
from workbench.lpv import LPVModel, OperatingPoint, Predictor, Term, constant_model
from workbench.physics.controller import check_controller
from workbench.robustness.frozen import worst_margins
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
    np.testing.assert_array_equal(mpc.weights.moves, other.weights.moves)
    assert json.dumps(mpc.fallback.to_dict(), default=list) == json.dumps(other.fallback.to_dict(), default=list)


def test_the_bounds_of_a_design_are_kept(model):
    calm = ScheduledPIDDesign(sensitivity=1.2, effort=20.0, objective="integral").design(model)
    brisk = ScheduledPIDDesign(sensitivity=1.6, effort=20.0, objective="integral").design(model)
    assert calm.margins.sensitivity.max() <= 1.2 + 1e-6
    assert brisk.low_frequency.min() > 1.2 * calm.low_frequency.min()


def swinging(zeta, rest=2.0):
    """1 / (s^2 + 2 zeta s + 1) sampled every 0.1 s, at rest at y = `rest`."""
    A, B = np.array([[0.0, 1.0], [-1.0, -2.0 * zeta]]), np.array([[0.0], [1.0]])
    both = expm(np.block([[A, B], [np.zeros((1, 3))]]) * 0.1)
    return constant_model(
        "swing", 0.1, ((Channel("u", "V", "input"),), (Channel("y", "m", "output"),)),
        (both[:2, :2], both[:2, 2:], [[1.0, 0.0]], [[0.0]]), OperatingPoint(CONSTANT, [[rest]], [[rest]]),
    )  # fmt: skip


def cross_coupled():
    """Two lags that each input moves both of."""
    A, B = np.diag([0.8, 0.9]), np.array([[0.2, 0.05], [0.03, 0.1]])
    channels = [tuple(Channel(f"{name}{i}", "", role) for i in (1, 2)) for name, role in (("u", "input"), ("y", "output"))]
    point = OperatingPoint(CONSTANT, [[0.0, 0.0]], [[0.0, 0.0]])
    return constant_model("two", 0.1, tuple(channels), (A, B, np.eye(2), np.zeros((2, 2))), point)


def overshoot(law, zeta, rest=2.0):
    """Of a step of 1 from rest, with the machine's own integration; the law begins where it holds `rest`."""
    state = law.init()
    flow = expm(np.array([[0.0, 1.0, 0.0], [-1.0, -2.0 * zeta, 1.0], [0.0, 0.0, 0.0]]) * 0.1)
    x, highest = np.array([rest, 0.0]), 0.0
    for k in range(600):
        u, state = law.step(state, np.array([rest + (k >= 300)]), x[:1], None)
        if k < 300:
            assert x[0] == pytest.approx(rest, abs=1e-6)  # nothing but the set-point moves it
        x = (flow @ [*x, u[0]])[:2]
        highest = max(highest, x[0] - rest - 1.0)
    return highest


@pytest.mark.parametrize("zeta", [0.05, 0.15, 0.4, 1.0])
def test_set_points_overshoot_by_a_fifth_at_most(zeta):
    """A design that was as brisk as it could be overshot by 70 % under margins of 1.6."""
    model, setpoint = swinging(zeta), {"y": 2.0}
    assert overshoot(ScheduledPIDDesign(setpoint=setpoint).on(model), zeta) < 0.2
    law = ScheduledPIDDesign(setpoint=setpoint, objective="integral").on(model)
    brisk = ScheduledPIDDesign(setpoint=setpoint, reference_model={"y": np.inf}, objective="integral").on(model)
    for key in ("Kp", "Ki", "Kd", "Kr", "u0"):  # what answers to set-points is not in the loop
        np.testing.assert_array_equal(getattr(law, key), getattr(brisk, key))
    assert not brisk.shaped
    assert overshoot(brisk, zeta) > 0.5
    assert overshoot(law, zeta) < 0.2


def test_the_rate_of_a_reference_model_is_fed_forward():
    """1 / P(s) = 1 + 2 zeta s + s^2, and commands are held for half a sample longer: Ka = 2 zeta + dt / 2."""
    for zeta in (0.15, 1.0):
        law = ScheduledPIDDesign(reference_model={"y": 2.0}).on(swinging(zeta))
        np.testing.assert_allclose(law.Ka, 2.0 * zeta + 0.05, atol=1e-6)
        np.testing.assert_allclose(law.Kr, 1.0, atol=1e-9)
        np.testing.assert_allclose(law.Kaa, 1.0 + 0.1 * zeta + 0.1**2 / 6.0 * 0.5, atol=2e-3)  # s^2, and what half a sample makes
    assert not ScheduledPIDDesign(reference_model={"y": 2.0}, feedforward=False).on(swinging(1.0)).Ka.any()


def followed(law, zeta, r):
    """Output of the oscillator under set-points r, from rest at 2."""
    flow = expm(np.array([[0.0, 1.0, 0.0], [-1.0, -2.0 * zeta, 1.0], [0.0, 0.0, 0.0]]) * 0.1)
    x, state, y = np.array([2.0, 0.0]), law.init(), []
    for now in r:
        y.append(x[0])
        u, state = law.step(state, np.array([now]), x[:1])
        x = (flow @ [*x, u[0]])[:2]
    return np.array(y)


@pytest.mark.parametrize("zeta", [0.05, 0.4, 1.0])
def test_outputs_follow_reference_models_and_paths(zeta):
    """m of a reference model is written out here; a path is followed itself. The PID alone would be late by its whole error."""
    t = 0.1 * np.arange(400)
    r = np.where(t < 5.0, 2.0, 3.0)
    law = ScheduledPIDDesign(reference_model={"y": 1.5}).on(swinging(zeta))
    passed = np.maximum(t - 5.0 + 0.1, 0.0)  # a step at a sample acts from the one before on: it was held since then
    m = 2.0 + 1.0 - (1.0 + 1.5 * passed) * np.exp(-1.5 * passed)
    assert np.abs(followed(law, zeta, r) - m).max() < 0.08
    plain = replace(law, c=0.0 * law.c, Kaa=0.0)
    assert np.abs(followed(plain, zeta, r) - m).max() > 0.1
    share = np.clip(t / 8.0 - 0.5, 0.0, 1.0)
    path = 2.0 + share**3 * (10.0 + share * (6.0 * share - 15.0))
    law = ScheduledPIDDesign(paths=("y",)).on(swinging(zeta))
    assert law.paths.all()
    assert np.isinf(law.bandwidth).all()
    assert np.abs(followed(law, zeta, path) - path).max() < 0.02  # an acceleration is a sample late
    bare = ScheduledPIDDesign(reference_model={"y": np.inf}).on(swinging(zeta))
    assert np.abs(followed(bare, zeta, path) - path).max() > 0.03


def test_a_law_is_tried_with_the_steps_that_are_given():
    found = ScheduledPIDDesign(steps={"y": 0.25})
    assert "steps of y 0.25 m from" in found.calmed(found.design(swinging(0.4)), swinging(0.4))[1].sentence
    with pytest.raises(InputError, match="steps 0"):
        ScheduledPIDDesign(steps={"y": 0.0})
    with pytest.raises(InputError, match="unknown output 'z'"):
        ScheduledPIDDesign(steps={"z": 1.0}).design(swinging(0.4))


def test_paths_that_make_no_sense_are_refused():
    with pytest.raises(InputError, match="unknown output 'z'"):
        ScheduledPIDDesign(paths=("z",)).design(swinging(0.4))
    with pytest.raises(InputError, match="nothing is fed forward"):
        ScheduledPIDDesign(paths=("y",), feedforward=False)
    with pytest.raises(InputError, match="a path goes through no reference model"):
        ScheduledPIDDesign(paths=("y",), reference_model={"y": 2.0})


def test_what_is_said_of_set_points_stays():
    model = swinging(0.15)
    for b, feedforward, w in ((1.0, True, 0.7), (0.7, True, np.inf), (1.0, False, 30.0)):
        law = ScheduledPIDDesign(setpoint_weight=b, feedforward=feedforward, reference_model={"y": w}, slew={"y": 3.0}).on(model)
        assert (law.b.tolist(), law.bandwidth.tolist(), law.slew.tolist()) == ([b], [w], [3.0])
        assert bool(law.Kr.any()) is feedforward
    for bad in ({"reference_model": {"y": 0.0}}, {"slew": {"y": -1.0}}):
        with pytest.raises(InputError, match="channel y"):
            ScheduledPIDDesign(**bad)
    with pytest.raises(InputError, match="z"):
        ScheduledPIDDesign(reference_model={"z": 1.0}).on(model)


FINE = Trial("", "", "", [0.1, 0.1], [1.0, 1.0])


def test_each_set_point_has_the_calmest_of_the_reference_models_after_which_outputs_settle_about_soonest(monkeypatch):
    def answered(law, *_):
        x = law.bandwidth * law.dt  # bandwidths in samples
        first = 3.0 if x[0] > 0.2 else 1.0 / x[0]
        second = 1.0 if x[1] >= 0.5 else 1.05 if x[1] > 0.1 else 9.0
        return np.array([0.5 if x[0] > 0.3 else 0.1, 0.1]), np.array([first, second]), np.ones((2, 2))

    model = cross_coupled()
    monkeypatch.setattr("controllers.designs.tried", lambda *_: FINE)
    monkeypatch.setattr("controllers.designs._answered", answered)
    np.testing.assert_allclose(ScheduledPIDDesign().on(model).bandwidth * model.dt, [0.25, 0.125])
    monkeypatch.setattr("controllers.designs._answered", lambda *_: (np.array([0.6, 0.1]), np.ones(2), np.ones((2, 2))))
    law = ScheduledPIDDesign(reference_model={"y2": 7.0}).on(model)
    assert law.bandwidth.tolist() == [np.inf, 7.0]  # nothing helps: the briskest


@pytest.mark.parametrize("dt", [0.1, 0.01, 1e-3])
def test_a_reference_model_commands_no_more_than_the_set_point_itself_would(dt):
    """The finer the sampling the more a brisk one kicks: 184 times the steady command at 1 ms."""
    a = np.exp(-dt)
    model = constant_model(
        "lag", dt, ((Channel("u", "V", "input"),), (Channel("y", "m", "output"),)),
        ([[a]], [[1.0 - a]], [[1.0]], [[0.0]]), OperatingPoint(CONSTANT, [[0.0]], [[0.0]]),
    )  # fmt: skip
    found = ScheduledPIDDesign().design(model)
    law = ScheduledPIDDesign().calmed(found, model)[0].law
    peaks = []
    for own in (found.law, law):
        x, state, most = 0.0, own.init(), 0.0
        for k in range(int(3.0 / dt)):
            u, state = own.step(state, np.array([float(k > 0)]), np.array([x]))
            x, most = a * x + (1.0 - a) * u[0], max(most, abs(u[0]))
        peaks.append(most)
    assert law.shaped
    assert peaks[1] <= 1.02 * peaks[0]


def test_where_the_run_overshoots_or_is_lost_slower_reference_models_are_tried(monkeypatch):
    model = cross_coupled()

    def tried(law, *_):
        x = law.bandwidth * law.dt
        return Trial("", "it runs away", "") if x[1] > 0.6 else Trial("", "", "", [0.1, x[1]], [1.0, 1.0])

    monkeypatch.setattr("controllers.designs.tried", tried)
    monkeypatch.setattr("controllers.designs._answered", lambda *_: (np.zeros(2), np.ones(2), np.ones((2, 2))))
    monkeypatch.setattr("controllers.designs._soonest", lambda *_: 0)  # none
    np.testing.assert_allclose(ScheduledPIDDesign().on(model).bandwidth * model.dt, [0.5, 0.125])
    monkeypatch.setattr("controllers.designs.tried", lambda *_: Trial("", "", "", [0.1, 0.6], [1.0, 1.0]))
    assert ScheduledPIDDesign().on(model).bandwidth.tolist() == [np.inf, np.inf]  # nothing helps: the briskest


@pytest.mark.parametrize("zeta", [None, 0.4, 1.0])
def test_what_the_frozen_loops_are_said_to_do_is_what_the_controller_does_sample_by_sample(zeta):
    model = cross_coupled() if zeta is None else swinging(zeta, rest=0.0)
    found = ScheduledPIDDesign().design(model)
    for w in (np.inf, 0.7):
        law = found.following(w)
        beyond, settled, moved = _answered(law, model, found.scale)
        for j in range(len(found.scale)):
            r, x, state, y, most = np.zeros(len(beyond)), np.zeros(len(model.A[0])), law.init(), [], 0.0
            for _ in range(4000):
                y.append(model.C[0] @ x)
                u, state = law.step(state, r, y[-1])
                most = np.maximum(most, np.abs(u))
                r[j] = found.scale[j]  # after one sample at rest
                x = model.A[0] @ x + model.B[0] @ u
            off = (np.array(y[1:]) - r) / found.scale
            late = np.flatnonzero((np.abs(off) > 0.05).any(axis=1))[-1] + 1
            assert beyond[j] == pytest.approx(max(off[:, j].max(), 0.0), abs=2e-3)
            np.testing.assert_allclose(moved[j], most, rtol=0.02, atol=1e-6)
            assert settled[j] == pytest.approx(late * model.dt, abs=1.5 * model.dt + 0.01 * late * model.dt)


def test_a_controller_that_loses_its_loop_is_not_handed_out(model, monkeypatch):
    said = "the loop is lost on the model lti: y stays away"
    monkeypatch.setattr("controllers.designs.tried", lambda *_: Trial("the model lti", "y stays away", said))
    with pytest.raises(NotHandedOutError, match="y stays away"):
        ScheduledPIDDesign().on(model)
    assert isinstance(ScheduledPIDDesign().on(model, accept=True), ScheduledPID)


def test_a_controller_is_tried_on_the_plant_that_is_given_and_at_the_usual_set_point(model, monkeypatch):
    asked = []
    monkeypatch.setattr("controllers.designs.tried", lambda *given: asked.append(given) or Trial("", "", "", [0.0], [1.0]))
    plant = object()
    for design in (ScheduledPIDDesign(setpoint={"y": 0.5}), MPCDesign(setpoint={"y": 0.5})):
        law = design.on(model, plant)
        assert all(own[1:4] == (model, plant, [0.5]) for own in asked)
        assert any(own[0] is law for own in asked)


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


def free_mass(friction=20.0):
    """A position from a force, 0.5 y" + friction y' = F, sampled every 0.01 s."""
    plant = control.sample_system(control.ss(control.tf([1.0], [0.5, friction, 0.0])), 0.01)
    return constant_model(
        "axis", 0.01, ((Channel("F", "N", "input"),), (Channel("q", "m", "output"),)),
        (plant.A, plant.B, plant.C, plant.D), OperatingPoint(CONSTANT, [[0.0]], [[0.0]]), noise=[[1e-10]],
    )  # fmt: skip


def test_an_axis_that_integrates_goes_to_its_set_point_within_its_limits():
    """It was refused; far set-points wound its integral up. Now they are slewed to what 80 % of the force keeps up: 0.2 m/s."""
    law = ScheduledPIDDesign(low={"F": -5.0}, high={"F": 5.0}).on(free_mass())
    np.testing.assert_allclose(law.slew, 0.2, rtol=1e-6)
    A, B = np.array([[0.0, 1.0], [0.0, -40.0]]), np.array([[0.0], [2.0]])
    both = expm(np.block([[A, B], [np.zeros((1, 3))]]) * 0.01)
    x, state, places = np.zeros(2), law.init(), []
    for _ in range(600):  # half a metre, 100 times what a step of the trial is
        u, state = law.step(state, np.array([0.5]), x[:1])
        assert abs(u[0]) <= 5.0
        x = both[:2, :2] @ x + both[:2, 2] * u[0]
        places.append(x[0])
    assert max(places) < 0.55
    np.testing.assert_allclose(places[-100:], 0.5, atol=0.005)
    assert np.diff(places).max() < 1.3 * 0.2 * 0.01


def test_a_slew_is_chosen_where_the_rate_takes_a_command_alone():
    bare = ScheduledPIDDesign(low={"F": -5.0}, high={"F": 5.0}, feedforward=False)
    assert np.isinf(bare.on(free_mass()).slew).all()
    assert np.isinf(ScheduledPIDDesign().on(free_mass()).slew).all()  # no limits
    given = ScheduledPIDDesign(low={"F": -5.0}, high={"F": 5.0}, slew={"q": np.inf}).on(free_mass())
    assert np.isinf(given.slew).all()


def test_a_law_for_more_inputs_than_outputs_is_refused_at_once():
    plant = free_mass()
    wide = replace(plant, inputs=(*plant.inputs, Channel("G", "N", "input")), B=np.tile(plant.B, 2), D=np.zeros((1, 1, 2)),
                   operating_point=OperatingPoint(CONSTANT, [[0.0, 0.0]], [[0.0]]))  # fmt: skip
    with pytest.raises(InputError, match=r"2 inputs \(F, G\) for 1 outputs"):
        ScheduledPIDDesign().design(wide)
    with pytest.raises(InputError, match="neither noise nor a load step"):
        ScheduledPIDDesign(load={"F": 0.0}).design(replace(plant, noise=None))
    mended = ScheduledPIDDesign(load={"F": 0.0}, objective="integral").design(replace(plant, noise=None))
    np.testing.assert_allclose(mended.deviation, 0.0, atol=1e-12)


def test_a_quiet_sensor_beside_a_noisy_one_does_not_end_the_integral_action():
    A, B = np.diag([0.9, 0.8]), np.array([[1.0, 0.3], [0.2, 1.0]])
    channels = tuple(tuple(Channel(name, "V", role) for name in own) for own, role in (("ab", "input"), ("yz", "output")))
    shares = []
    for quiet in (0.1, 1e-3, 0.0):
        model = constant_model(
            "two", 0.1, channels, (A, B, np.eye(2), np.zeros((2, 2))), OperatingPoint(CONSTANT, [[0.0, 0.0]], [[0.0, 0.0]]),
            noise=np.diag([0.01, quiet**2]),
        )  # fmt: skip
        found = ScheduledPIDDesign().design(model)
        shares.append((found.low_frequency / found.alone)[0])
    assert min(shares) > 0.05


def drawn(seed):
    """A model of two inputs and outputs and four states, whose gains change over a schedule."""
    random = np.random.default_rng(seed)
    A, C, first = np.diag(random.uniform(0.5, 0.98, 4)), random.normal(size=(2, 4)), random.normal(size=(4, 2))
    B = np.stack([first, first * random.uniform(0.7, 1.5, (4, 2))])
    two, point = np.stack([A, A]), OperatingPoint(CONSTANT, u=[[0.0, 0.0]], y=[[0.0, 0.0]])
    K = 0.1 * C.T
    return LPVModel(
        "drawn", 0.1, tuple(Channel(u, "V", "input") for u in "ab"), tuple(Channel(y, "m", "output") for y in "cd"),
        (Channel("s", "", "schedule"),), [[0.0, 1.0]], PiecewiseLinear((0.0, 1.0)), (Term(0), Term(1)), two, B,
        np.stack([C, C]), np.zeros((2, 2, 2)), point, Predictor(two - K @ C, B, np.stack([K, K])), 1e-2 * np.eye(2),
    )  # fmt: skip


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_moves_of_an_mpc_cost_as_little_as_its_sensitivity_allows(seed):
    """At that price |S| keeps the bound over the schedule, and at lower ones it does not."""
    model = drawn(seed)
    fallback, grid = pid(("a", "b"), ("c", "d"), ("c_set", "d_set"), 0.1, np.zeros(2), np.full(2, 1e-3)), model.frozen_values(25)

    def largest(weights):
        return worst_margins(design_mpc(model, fallback, weights=weights), [model], grid).sensitivity.max()

    most, least = (worst(largest(default_weights(model, price)) for price in PRICES[::8]) for worst in (max, min))
    for bound in (0.7 * most + 0.3 * least, 0.3 * most + 0.7 * least, 1.001 * most):
        weights = MPCDesign(sensitivity=bound).weights(model, fallback)
        number = PRICES.index(float(weights.moves[0]))
        assert largest(weights) <= 1.02 * bound
        for lower in {*range(0, number, 8), max(0, number - 1)} - {number}:
            assert largest(default_weights(model, PRICES[lower])) > 0.99 * bound
    assert MPCDesign(move=0.2).weights(model, fallback).moves == pytest.approx([0.2, 0.2])


def test_where_no_price_keeps_the_sensitivity_the_least_is_taken():
    """An unstable plant: |S| is above 1.2 whatever the moves cost."""
    unstable = constant_model(
        "runaway", 0.1, ((Channel("u", "V", "input"),), (Channel("y", "m", "output"),)),
        (np.array([[1.2]]), np.array([[1.0]]), np.array([[1.0]]), np.zeros((1, 1))),
        OperatingPoint(CONSTANT, u=[[0.0]], y=[[0.0]]),
    )  # fmt: skip
    unstable = replace(unstable, predictor=Predictor([[[0.9]]], [[[1.0]]], [[[0.3]]]), noise=np.eye(1))
    fallback = pid(("u",), ("y",), ("y_set",), 0.1, [0.5], [0.1])
    price = float(MPCDesign(sensitivity=1.05).weights(unstable, fallback).moves[0])
    laws = [design_mpc(unstable, fallback, weights=default_weights(unstable, own)) for own in (price, PRICES[0], PRICES[-1])]
    peaks = [worst_margins(law, [unstable], [None]).sensitivity.max() for law in laws]
    assert peaks[0] > 1.05
    assert peaks[0] <= min(peaks[1:])


@pytest.mark.parametrize("move", [0.0, -1.0, np.inf, np.nan])
def test_a_price_that_is_none_is_refused(move):
    with pytest.raises(InputError, match="above 0, or None"):
        MPCDesign(move=move)
