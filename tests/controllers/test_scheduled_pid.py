"""The PID law: its equation, linear theory, limits, bumps, and the compiled run."""

import json
from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.export import export
from controllers.files import load_controller, save_controller
from controllers.pid import pid, standard_form
from controllers.scheduled_pid import BackCalculation, Clamping, ScheduledPID
from plants import WEB_WINDING
from workbench.basis import PiecewiseLinear, Powers
from workbench.curves import Curve
from workbench.data import Channel
from workbench.errors import InputError
from workbench.physics import stepper
from workbench.physics.plant import Plant
from workbench.physics.rest import Start
from workbench.records import RecordError
from workbench.simulation import Scenario, simulate

DT = 0.04
NAMES = (("V2", "V1"), ("w3", "theta"), ("w3_set", "theta_set"))
KP, KI, KD = np.array([[0.8, -0.3], [0.2, 0.5]]), np.array([[0.4, 0.1], [-0.2, 0.6]]), np.array([[0.05, 0.0], [0.02, -0.03]])
KR = np.array([[0.15, -0.45], [0.35, 0.25]])


def full(**options) -> ScheduledPID:
    return pid(*NAMES, DT, KP, KI, KD, **{"Kr": KR, "Tf": 0.1, "u0": (1.0, -2.0), "b": (0.7, 1.0), "c": (0.2, 0.0), **options})


def scheduled(**options) -> ScheduledPID:
    """Gains that move linearly from one set at 0.01 to another at 0.03."""
    low = full(**options)
    stacked = {key: np.concatenate([getattr(low, key), 2.0 * getattr(low, key)]) for key in ("Kp", "Ki", "Kd", "Kr")}
    return replace(
        low,
        **stacked,
        u0=((1.0, -2.0), (1.5, -2.5)),
        basis=PiecewiseLinear((0.01, 0.03)),
        schedule="r2",
        span=(0.01, 0.03),
    )


def through(law, r, y, rho=None, state=None):
    """Commands (N, nu) of the law in open loop on given signals."""
    state, out = law.init() if state is None else state, []
    for k in range(len(r)):
        u, state = law.step(state, r[k], y[k], None if rho is None else rho[k])
        out.append(u)
    return np.array(out)


def shaped(law: ScheduledPID, **options) -> ScheduledPID:
    """The law behind a slew limit and a reference model of the first set-point, a reference model of the second."""
    Ka = np.array([[0.03, -0.01], [0.02, 0.05]]) * np.linspace(1.0, 2.0, len(law.Kp))[:, None, None]
    return replace(law, **{"slew": (4.0, np.inf), "bandwidth": (6.0, 20.0), "Ka": Ka, **options})


def signals(seed=1, n=200):
    random = np.random.default_rng(seed)
    return random.normal(size=(n, 2)), random.normal(size=(n, 2))


def test_the_law_is_its_equation():
    """The four lines of the module's docstring, written out once more with arrays and sums over the whole past."""
    r, y = signals()
    law = full(low=(-2.0, -3.0), high=(3.0, 1.0), rate=(20.0, 15.0))
    got = through(law, r, y)
    a, Tt = 0.1 / 0.14, np.linalg.norm(KP, axis=1) / np.linalg.norm(KI, axis=1)
    d = np.array([0.2, 0.0]) * r - y
    steps = np.diff(d, axis=0, prepend=d[:1]) / DT
    z = np.zeros(2)
    for k in range(len(r)):
        f = sum((1 - a) * a ** (k - i) * steps[i] for i in range(k + 1))
        v = np.array([1.0, -2.0]) + KR @ r[k] + KP @ (np.array([0.7, 1.0]) * r[k] - y[k]) + z + KD @ f
        u = v if k == 0 else np.clip(v, got[k - 1] - np.array([20.0, 15.0]) * DT, got[k - 1] + np.array([20.0, 15.0]) * DT)
        u = np.clip(u, (-2.0, -3.0), (3.0, 1.0))
        np.testing.assert_allclose(got[k], u, atol=1e-11)
        z = z + DT * KI @ (r[k] - y[k]) + DT / Tt * (u - v)


def test_a_reference_model_is_its_equation():
    """Slew written out sample by sample, the critically damped model by python-control, and what they change in the law's sum."""
    r, y = signals()
    r = np.repeat(r[::8], 8, axis=0)[: len(r)]  # steps
    law, plain = shaped(full()), full()
    s = r.copy()
    for k in range(len(r)):
        last = s[k - 1, 0] if k else y[0, 0]  # a start begins at rest at what is measured
        s[k, 0] = last + np.clip(r[k, 0] - last, -4.0 * DT, 4.0 * DT)
    assert np.ptp(np.diff(s[:, 0])) < 1.01 * np.ptp(np.clip(np.diff(r[:, 0]), -4.0 * DT, 4.0 * DT)) < np.ptp(np.diff(r[:, 0]))
    m, rate = np.empty_like(s), np.empty_like(s)
    for j, w in enumerate((6.0, 20.0)):
        model = control.ss([[0.0, 1.0], [-w * w, -2 * w]], [[0.0], [w * w]], np.eye(2), 0.0)
        held = np.append(s[:, j], s[-1, j])  # each sample's set-point stands since the one before
        found = control.forced_response(control.sample_system(model, DT), T=DT * np.arange(len(held)), U=held, X0=[y[0, j], 0.0])
        m[:, j], rate[:, j] = found.outputs[:, 1:]
    expected = through(plain, m, y) + rate @ law.Ka[0].T
    np.testing.assert_allclose(through(law, r, y), expected, atol=1e-11)
    assert np.abs(expected - through(plain, r, y)).max() > 0.5


def test_a_reference_model_begins_at_rest_and_ends_at_the_set_point():
    law, steady = shaped(full()), full()
    r, y = np.tile([3.0, -2.0], (400, 1)), np.tile([3.0, -2.0], (400, 1))
    np.testing.assert_allclose(through(law, r, y), through(steady, r, y), atol=1e-12)  # as if it had stood there for ever
    state = law.init(np.array([0.3, 0.4]))
    np.testing.assert_allclose(through(law, r, y, state=state)[0], [0.3, 0.4])
    first, began = law.step(law.init(np.array([0.3, 0.4])), r[0] + 1.0, y[0])
    np.testing.assert_allclose(first, [0.3, 0.4])
    np.testing.assert_allclose(began[-6], y[0, 0] + 4.0 * DT)  # from where the machine is, not from the set-point
    r[10:] += 1.0
    for k in range(400):
        _, state = law.step(state, r[k], y[k])
    np.testing.assert_allclose(state[-6:-2], [*r[-1], *r[-1]], atol=1e-9)  # s and m stand at r
    np.testing.assert_allclose(state[-2:], 0.0, atol=1e-9)


@pytest.mark.parametrize("bandwidth", [(6.0, 20.0), (6.0, np.inf)])
def test_the_linear_system_has_the_reference_models(bandwidth):
    r, y = signals(2)
    law = shaped(full(), slew=np.inf, bandwidth=bandwidth, Ka=np.array([[[0.03, 0.0], [0.02, 0.0]]]))
    linear, n = law.at(), int(np.isfinite(bandwidth).sum())
    assert linear.nstates == 6 + 2 * n
    first = y[0].copy()  # what the loop follows, one sample on from rest at the first measurement
    a, _, c = law.reference_model[:n, :3].T
    first[:n] = a * y[0, :n] + c * r[0, :n]
    first[n:] = r[0, n:]
    start = np.concatenate([np.zeros(4), law.c * first - y[0], y[0, :n], np.zeros(n)])
    _, expected = control.forced_response(linear, T=DT * np.arange(len(r)), U=np.hstack([r, y]).T, X0=start)
    np.testing.assert_allclose(through(law, r, y), expected.T + law.u0[0], atol=1e-11)
    of_y = linear.frequency_response(np.array([1.0, 9.0])).complex[:, 2:]
    np.testing.assert_allclose(of_y, full().at().frequency_response(np.array([1.0, 9.0])).complex[:, 2:], atol=1e-12)


def test_a_reference_model_that_is_faster_than_a_sample_is_none():
    r, y = signals()
    for w in (1e5, 1e200, 1e300):
        np.testing.assert_allclose(through(replace(full(), bandwidth=w), r, y), through(full(), r, y), atol=1e-9)


def test_gains_change_from_a_law_with_a_reference_model_to_one_without_and_back():
    with_one, without, r, away = shaped(full()), full(), np.array([3.0, -2.0]), np.array([2.0, -1.0])
    held = np.array([0.3, -0.4])
    for old, new, y in ((without, with_one, r), (with_one, without, r), (with_one, without, away)):
        state = old.init()
        for _ in range(400):  # until what the loop follows stands at the set-point
            _, state = old.step(state, r, y)
        state = new.follow(state, held, r, y)
        assert len(state) == len(new.init())
        np.testing.assert_allclose(new.step(state, r, y)[0], held, atol=1e-12)
    state = with_one.follow(without.step(without.init(), r, away)[1], held, r, away)
    np.testing.assert_allclose(state[-6], away[0] + 4.0 * DT)  # from what is measured, within the slew
    with pytest.raises(InputError, match="memory of 3 numbers"):
        without.follow(np.zeros(3), held, r, y)


def test_a_file_with_reference_models_is_of_another_version():
    assert "version" not in full().to_dict()
    content = shaped(full()).to_dict()
    assert content["version"] == 2
    again = ScheduledPID.from_dict(content)
    for key in ("slew", "bandwidth", "Ka"):
        np.testing.assert_array_equal(getattr(again, key), getattr(shaped(full()), key))


def test_without_limits_it_is_the_linear_system_of_python_control():
    r, y = signals(2)
    law = full()
    linear = law.at()
    # the law starts without a past: its first derivative is nought, as if the first c r - y had stood for ever
    start = np.concatenate([np.zeros(4), law.c * r[0] - y[0]])
    _, expected = control.forced_response(linear, T=DT * np.arange(len(r)), U=np.hstack([r, y]).T, X0=start)
    np.testing.assert_allclose(through(law, r, y), expected.T + law.u0[0], atol=1e-11)


def test_without_integral_there_is_no_pole_at_one():
    """The first command integrates nothing: its z stays at 0, and the linear system has none."""
    r, y = signals(3)
    law = replace(full(), Ki=np.array([[[0.0, 0.0], KI[1]]]))
    linear = law.at()
    assert linear.nstates == 5
    start = np.concatenate([np.zeros(3), law.c * r[0] - y[0]])
    _, expected = control.forced_response(linear, T=DT * np.arange(len(r)), U=np.hstack([r, y]).T, X0=start)
    np.testing.assert_allclose(through(law, r, y), expected.T + law.u0[0], atol=1e-11)
    assert np.abs(replace(full(), Ki=np.zeros((1, 2, 2))).at().poles()).max() < 1.0


@pytest.mark.parametrize("Tf", [0.0, 0.1])
def test_its_frequency_response_is_that_of_the_linear_system(Tf):
    law = full(b=1.0, c=1.0, Tf=Tf, Kr=np.zeros((2, 2)))
    omega = np.geomspace(1e-3, 0.999 * np.pi / DT, 50)
    linear = law.at()(np.exp(1j * omega * DT))  # (nu, 2 ny, N) from (r, y)
    np.testing.assert_allclose(law.response(omega), np.moveaxis(linear, 2, 0)[:, :, :2], rtol=1e-9)
    np.testing.assert_allclose(law.response(omega), -np.moveaxis(linear, 2, 0)[:, :, 2:], rtol=1e-9)


def test_for_slow_signals_it_is_the_continuous_pid():
    """Kp + Ki / s + Kd s / (1 + Tf s), with an error that falls with the first power of dt."""
    s = 1j * np.array([0.3, 1.0])
    errors = []
    for dt in (1e-3, 5e-4):
        law = replace(full(b=1.0, c=1.0), dt=dt)
        exact = KP + KI / s[:, None, None] + KD * (s / (1 + 0.1 * s))[:, None, None]
        errors.append(np.abs(law.response(s.imag) - exact).max())
    assert errors[1] < 1e-3
    assert 1.8 < errors[0] / errors[1] < 2.2


def test_standard_form():
    Kp, Ki, Kd = standard_form(2.0, 4.0, 0.5)
    assert (Kp, Ki, Kd) == (2.0, 0.5, 1.0)


def test_gains_between_and_outside_the_knots():
    law = scheduled()
    np.testing.assert_allclose(law.gains_at(0.02)[0], 1.5 * KP)
    np.testing.assert_allclose(law.gains_at(0.05)[1], 2.0 * KI)  # the edge value
    assert law.outside(np.array([0.02, 0.05])) == pytest.approx(1.0)
    assert law.outside(np.array([0.01, 0.03])) == 0.0
    r, y = signals(3, 50)
    np.testing.assert_array_equal(through(law, r, y, np.full(50, 0.04)), through(law, r, y, np.full(50, 0.03)))


def test_at_a_frozen_schedule_it_is_the_fixed_law_there():
    law, r, y = scheduled(), *signals(4, 60)
    frozen = {key: K[None] for key, K in law.gains_at(0.017)._asdict().items()}
    fixed = replace(full(), **frozen, anti_windup=BackCalculation(law.tracking))
    np.testing.assert_allclose(through(law, r, y, np.full(60, 0.017)), through(fixed, r, y), atol=1e-12)


# ---- bumps ---------------------------------------------------------------------------------------------------------------


def test_it_takes_over_without_a_bump():
    law, r, y = scheduled(), *signals(5, 3)
    held = np.array([0.37, -4.2])
    u, _ = law.step(law.init(held), r[0], y[0], 0.02)
    np.testing.assert_allclose(u, held, rtol=0, atol=1e-14)


def test_manual_to_automatic_and_a_change_of_gains_make_no_bump():
    law, (r, y) = full(), signals(6, 60)
    r, y = r[:1].repeat(60, 0), y[:1].repeat(60, 0)  # at rest, far from the set-point
    state, manual = law.init(), np.array([0.3, -0.4])
    for k in range(30):
        state = law.follow(state, manual, r[k], y[k])
    first, state = law.step(state, r[30], y[30])
    np.testing.assert_allclose(first, manual, atol=1e-14)
    second, after = law.step(state, r[31], y[31])
    np.testing.assert_allclose(second - first, DT * KI @ (r[31] - y[31]), atol=1e-13)  # from there the integral goes on
    other = replace(law, Kp=5.0 * law.Kp, Kd=-law.Kd, u0=law.u0 + 1.0)
    changed, _ = other.step(other.follow(state, second, r[31], y[31]), r[32], y[32])
    np.testing.assert_allclose(changed, second, atol=1e-13)
    jump, _ = other.step(after, r[32], y[32])
    assert np.abs(jump - second).max() > 0.5  # without it there is one


class MisplacedPI(ScheduledPID):
    """The same surfaces with Ki(rho) times the integral of e: same frozen law, another scheduled one."""

    def law(self, gains, state, r, y, rho=None):
        Kp, Ki, *_, u0 = self.gains_at(rho)
        e = np.asarray(r) - np.asarray(y)
        u = u0 + Kp @ e + Ki @ state[:2]
        return list(u), [*(state[:2] + self.dt * e), *state[2:]]


def test_a_moving_schedule_moves_the_command_only_where_the_integral_is_misplaced():
    """Steady state under load, e = 0, then the schedule moves with e still 0: nothing but u0 and Kr r may move the command."""
    base = scheduled(b=1.0)
    nothing = {key: np.zeros_like(getattr(base, key)) for key in ("u0", "Kd", "Kr")}
    right = replace(base, **nothing)
    wrong = MisplacedPI(**{name: getattr(right, name) for name in right.__dataclass_fields__})
    n = 100
    r, y, rho = np.zeros((n, 2)), np.zeros((n, 2)), np.full(n, 0.01)
    r[:50] = 1.0  # loads the integrals
    rho[60:] = np.linspace(0.01, 0.03, 40)
    one, other = through(right, r, y, rho), through(wrong, r, y, rho)
    np.testing.assert_allclose(one[:60], other[:60], atol=1e-12)  # the same law while the schedule stands
    assert np.abs(one[59]).max() > 0.5
    np.testing.assert_allclose(one[60:], one[59:60].repeat(40, 0), atol=1e-13)
    np.testing.assert_allclose(other[-1], 2.0 * other[59], rtol=1e-12)  # its whole steady command doubles with the gains


@pytest.mark.slow
def test_a_moving_schedule_in_closed_loop():
    """On a first-order plant under a constant load the misplaced integral kicks the output; the right one leaves it alone."""
    n = 1300
    rho = np.interp(np.arange(n), [1000, 1050], [0.01, 0.03])
    swing = {}
    law = replace(scheduled(b=1.0), Kd=np.zeros((2, 2, 2)), Kr=np.zeros((2, 2, 2)), u0=np.zeros((2, 2)))
    for kind, one in (("right", law), ("wrong", MisplacedPI(**{f: getattr(law, f) for f in law.__dataclass_fields__}))):
        x, state, out = np.zeros(2), one.init(), []
        for k in range(n):
            out.append(x)
            u, state = one.step(state, np.zeros(2), x, rho[k])
            x = x + DT * (u - 3.0 - x)  # settles at nought under u = 3
        assert np.abs(out[999]).max() < 5e-3
        swing[kind] = np.abs(np.array(out[1000:])).max()
    assert swing["right"] < 5e-3
    assert swing["wrong"] > 20.0 * swing["right"]


# ---- limits ---------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@settings(max_examples=60)
@given(st.integers(0, 10_000), st.booleans(), st.floats(0.1, 3.0), st.floats(1.0, 50.0))
def test_commands_keep_their_limits_and_rates(seed, clamping, limit, rate):
    law = full(low=-limit, high=2.0 * limit, rate=rate, anti_windup=Clamping() if clamping else None)
    r, y = signals(seed, 80)
    u = through(law, 10.0 * r, y)
    assert np.isfinite(u).all()
    assert u.min() >= -limit
    assert u.max() <= 2.0 * limit
    assert np.abs(np.diff(u, axis=0)).max() <= rate * DT * (1 + 1e-12) + 1e-12


def overshoot(anti_windup):
    """Of a step that saturates for long, relative to it: x' = u - x / 5 under a PI with two real poles."""
    law = pid(("u",), ("y",), ("r",), 0.05, [[2.0]], [[1.0]], low=-1.0, high=1.0, anti_windup=anti_windup)
    x, state, out = 0.0, law.init(), []
    for _ in range(1500):
        out.append(x)
        u, state = law.step(state, np.array([4.0]), np.array([x]))
        x += 0.05 * (u[0] - x / 5.0)
    assert out[-1] == pytest.approx(4.0, abs=1e-3)
    return max(out) / 4.0 - 1.0


@pytest.mark.slow
def test_it_leaves_saturation_without_overshoot():
    wound = overshoot(BackCalculation(np.array([1e9])))
    assert wound > 0.10
    linear_limit = 0.02
    assert overshoot(None) < linear_limit
    assert overshoot(Clamping()) < 0.06
    assert overshoot(BackCalculation(np.array([0.5]))) < linear_limit


def test_clamping_holds_the_integral_only_while_it_pushes_outward():
    law = pid(("u",), ("y",), ("r",), 0.1, [[1.0]], [[1.0]], high=1.0, anti_windup=Clamping())
    z = lambda state: state[0]  # noqa: E731
    _, state = law.step(law.init(), [5.0], [0.0])  # beyond the limit, pushing on
    assert z(state) == 0.0
    state = np.array([3.0, *state[1:]])
    _, after = law.step(state, [-0.5], [0.0])  # still beyond, but pulling back
    assert z(after) == pytest.approx(2.95)
    _, after = law.step(state, [0.0], [0.0])  # beyond, and nothing pushes
    assert z(after) == 3.0


# ---- curves of actuators -------------------------------------------------------------------------------------------------

VALVE = Curve("V2", [-3.0, -0.4, 0.3, 4.0], [-2.0, -0.1, 0.1, 5.0])
SQUARE = Curve("V1", [-2.0, 0.0, 2.0], [-3.0, 0.0, 1.0])


@pytest.mark.parametrize("anti_windup", [BackCalculation(), Clamping()])
@pytest.mark.parametrize("limits", [{}, {"low": (-0.6, -1.5), "high": (1.5, 1.1)}])
def test_behind_its_curves_it_is_the_law_without(anti_windup, limits):
    law, (r, y) = scheduled(anti_windup=anti_windup, **limits), signals(11)
    rho = np.linspace(0.005, 0.035, len(r))
    curved = replace(law, curves=(SQUARE, VALVE))
    u, v = through(curved, r, y, rho), through(curved.inside, r, y, rho)
    assert not curved.inside.curves
    np.testing.assert_allclose(np.column_stack([VALVE(u[:, 0]), SQUARE(u[:, 1])]), v, atol=1e-10)
    if limits:
        assert (u == curved.high).any()
        assert (u == curved.low).any()
        np.testing.assert_allclose(curved.inside.high, [VALVE(np.array(1.5)), SQUARE(np.array(1.1))])


def test_a_rate_holds_for_the_command_and_not_for_what_arrives():
    curved, (r, y) = full(rate=(3.0, 2.0), low=(-3.0, -2.0), high=(4.0, 2.0)), signals(12)
    curved = replace(curved, curves=(SQUARE, VALVE))
    u = through(curved, r, y)
    most = np.abs(np.diff(u, axis=0)).max(axis=0)
    np.testing.assert_allclose(most, DT * np.array([3.0, 2.0]), rtol=1e-9)
    np.testing.assert_allclose(curved.inside.rate, [3.0 * VALVE.slopes.min(), 2.0 * SQUARE.slopes.min()])


def test_a_law_with_curves_takes_over_without_a_bump():
    law, (r, y) = replace(full(), curves=(SQUARE, VALVE)), signals(6, 60)
    r, y = r[:1].repeat(60, 0), y[:1].repeat(60, 0)
    held = np.array([0.37, -1.2])
    np.testing.assert_allclose(law.step(law.init(held), r[0], y[0])[0], held, atol=1e-13)
    state = law.init()
    for k in range(30):
        state = law.follow(state, held, r[k], y[k])
    np.testing.assert_allclose(law.step(state, r[29], y[29])[0], held, atol=1e-13)


def test_a_file_with_curves_is_of_another_version(tmp_path):
    law = replace(full(), curves=(SQUARE, VALVE))
    again = load_controller(save_controller(law, tmp_path / "pid.json"))
    assert json.loads((tmp_path / "pid.json").read_text())["version"] == 3
    assert [(c.input, c.u.tolist(), c.v.tolist()) for c in again.curves] == [
        (c.input, c.u.tolist(), c.v.tolist()) for c in law.curves
    ]
    np.testing.assert_array_equal(through(again, *signals(7)), through(law, *signals(7)))
    law.export("csv", tmp_path)
    assert (tmp_path / "curves.csv").read_text().splitlines()[:2] == ["command,u,v", "V1,-2.0,-3.0"]


def test_a_law_and_an_actuator_with_its_curve_are_the_law_and_an_actuator_without():
    """In compiled runs: x' = f(u) - x under the law of u, and x' = v - x under that of v."""

    def plant(name, arrives):
        return Plant(
            name=name, description="", states=(Channel("x", ""),), inputs=(Channel("u", "", "input"),),
            outputs=(Channel("x", "", "output"),), parameters=(), equation=lambda x, u, p, at: {"x": arrives(u.u) - x.x},
            measure=lambda x, p: {"x": x.x}, dt=0.1, ports=(), start=Start(fixed={"x": 0.0}, solve_for=("u",), zero=("x",)),
        )  # fmt: skip

    def square(u):  # straight lines, in other words than the curve's
        return np.maximum(2.0 * u, 0.5 * u)

    curve = Curve("u", [-1.0, 0.0, 1.0], [-0.5, 0.0, 2.0])
    law = replace(pid(("u",), ("x",), ("r",), 0.1, [[1.5]], [[0.8]], [[0.1]], Tf=0.3, low=(-2.0,), high=(1.2,)), curves=(curve,))
    r = np.repeat([0.0, 2.0, -0.7, 0.3], 60)
    curved = simulate(plant("curved", square), law, Scenario("steps", {"r": r})).experiment
    straight = simulate(plant("straight", lambda u: u), law.inside, Scenario("steps", {"r": r})).experiment
    np.testing.assert_allclose(curved["x"], straight["x"], atol=1e-9)
    np.testing.assert_allclose(curve(curved["u"]), straight["u"], atol=1e-9)
    assert (curved["u"] == 1.2).any()
    assert np.abs(curved["x"] - curved["u"]).max() > 0.5


# ---- in the compiled step ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("reference_model", [False, True])
@pytest.mark.parametrize("anti_windup", [BackCalculation(), Clamping()])
def test_the_compiled_law_commands_what_the_law_commands(anti_windup, reference_model):
    _, u0 = WEB_WINDING.equilibrium()
    law = ScheduledPID(
        *NAMES, DT, Kp=np.array([[[0.01, 0.001], [0.0, -0.005]]] * 2) * [[[1.0]], [[1.5]]],
        Ki=np.array([[[0.05, 0.0], [0.01, -0.02]]] * 2), Kd=np.array([[[1e-3, 0.0], [0.0, -1e-4]]] * 2),
        Kr=np.array([[[2e-3, -1e-3], [4e-3, 3e-3]], [[1e-3, -2e-3], [5e-3, 2e-3]]]), u0=np.tile(u0[::-1], (2, 1)),
        b=(1.0, 0.8), c=(0.0, 0.0), low=(0.0, 0.0), high=(2.6, 2.0), rate=(2.0, np.inf), Tf=0.08,
        anti_windup=anti_windup, basis=PiecewiseLinear((0.0115, 0.0125)), schedule="r2", span=(0.0115, 0.0125),
    )  # fmt: skip
    n = 500
    speed = 100.0 + 25.0 * np.sign(np.sin(0.05 * np.arange(n)))
    scenario = Scenario("steps", {"w3_set": speed, "theta_set": np.zeros(n)}, seed=3)
    law = shaped(law, slew=(200.0, np.inf), Ka=0.01 * law.Kr) if reference_model else law
    for bumpless in (False, True):
        run = simulate(WEB_WINDING, law, scenario, bumpless=bumpless).experiment
        r, y = run[["w3_set", "theta_set"]], run[["w3", "theta"]]
        start = law.init(u0[::-1]) if bumpless else law.init()
        np.testing.assert_allclose(run[["V2", "V1"]], through(law, r, y, run["r2"], start), atol=1e-12)
        assert (run["V2"] == 2.6).any() or reference_model
        if bumpless:
            np.testing.assert_allclose(run[["V2", "V1"]][0], u0[::-1], atol=1e-14)


def test_other_gains_and_knots_need_no_other_kernel():
    other = replace(scheduled(), Kp=scheduled().Kp * 3, basis=PiecewiseLinear((0.012, 0.02)), span=(0.012, 0.02))
    assert stepper._kernel(WEB_WINDING, scheduled(), 1)[0] is stepper._kernel(WEB_WINDING, other, 1)[0]


@pytest.mark.slow
def test_closed_loop_equals_linear_theory_on_a_linear_plant():
    """x' = -x + u sampled exactly, under the law: the run equals python-control's feedback connection."""
    plant = Plant(
        name="lag", description="", states=(Channel("x", ""),), inputs=(Channel("u", "", "input"),),
        outputs=(Channel("x", "", "output"),), parameters=(), equation=lambda x, u, p, at: {"x": -x.x + u.u},
        measure=lambda x, p: {"x": x.x}, dt=0.1, ports=(), start=Start(fixed={"x": 0.0}, solve_for=("u",), zero=("x",)),
    )  # fmt: skip
    law = pid(("u",), ("x",), ("r",), 0.1, [[1.5]], [[0.8]], [[0.2]], Kr=[[0.4]], Tf=0.3, b=0.6)
    n = 120
    r = np.concatenate([np.zeros(1), np.ones(n - 1)])
    run = simulate(plant, law, Scenario("step", {"r": r}), substeps=40).experiment
    machine = control.sample_system(control.ss(-1.0, 1.0, 1.0, 0.0, inputs="u", outputs="x"), 0.1)
    loop = control.interconnect([machine, law.at()], inplist=["r"], outlist=["x", "u"], inputs=["r"], outputs=["x", "u"])
    _, expected = control.forced_response(loop, T=0.1 * np.arange(n), U=r)
    np.testing.assert_allclose(run[["x", "u"]], expected.T, atol=1e-9)


def test_it_writes_itself_for_other_programs(tmp_path):
    for form in ("csv", "json", "c", "st"):
        own, expected = scheduled().export(form, tmp_path / form, name="web_pid"), export(scheduled(), form, name="web_pid")
        assert {path.name: path.read_text() for path in own} == {
            path.name: path.read_text() for path in expected.save(tmp_path / f"{form}-again")
        }
        assert own


# ---- refused ---------------------------------------------------------------------------------------------------------------


def test_bad_laws_are_refused():
    with pytest.raises(InputError, match="unknown actuated channel 'V3'"):
        replace(full(), curves=(Curve("V3", [0.0, 1.0], [0.0, 1.0]),))
    with pytest.raises(InputError, match="does not rise everywhere"):
        replace(full(), curves=(Curve("V1", [0.0, 1.0, 2.0], [0.0, 1.0, 0.5]),))
    with pytest.raises(RecordError, match=r"Ki: a hole \(not a number\) at \[0, 0, 1\]"):
        pid(*NAMES, DT, KP, np.array([[0.1, np.nan], [0.0, 0.1]]))
    with pytest.raises(InputError, match="V1: lower limit 2 is not below the upper 1"):
        full(low=(0.0, 2.0), high=1.0)
    with pytest.raises(InputError, match="not named"):
        replace(
            full(),
            **{k: np.tile(getattr(full(), k), (2, 1, 1)) for k in ("Kp", "Ki", "Kd", "Kr")},
            u0=np.zeros((2, 2)),
            basis=Powers((0, 1)),
        )
    with pytest.raises(InputError, match="span"):
        replace(scheduled(), span=(0.03, 0.01))
    with pytest.raises(InputError, match="3 measured names"):
        pid(("a", "b"), ("c", "d", "e"), ("f", "g"), DT, KP, KI)
    with pytest.raises(InputError, match=r"at least 0\.04 s"):
        full(anti_windup=BackCalculation(np.array([0.01, 1.0])))
    with pytest.raises(InputError, match="2 coefficients for 1 basis"):
        replace(scheduled(), basis=Powers((0.0,)))
    with pytest.raises(RecordError, match="rate"):
        full(rate=-1.0)


@pytest.mark.parametrize("lost", [{"y": [np.nan, 1.0]}, {"r": [1.0, np.inf]}, {"rho": np.nan}])
def test_a_lost_sample_is_left_out(lost):
    """The last command is held, and the samples after it are those of a law that was never asked."""
    law = scheduled()
    given = {"r": [1.0, 0.5], "y": [0.2, 0.1], "rho": 0.02}
    state = law.init(np.array([0.1, -0.1]))
    for _ in range(3):
        u, state = law.step(state, **given)
    held, after = law.step(state, **(given | lost))
    np.testing.assert_array_equal(held, u)
    np.testing.assert_array_equal(after, state)
    first, _ = law.step(law.init(), **(given | lost))
    np.testing.assert_array_equal(first, np.clip(0.0, law.low, law.high))


def path_law():
    """A path of 0.3 m/s is held by 60 N and 95 kg are fed forward; without friction and feedback to speak of."""
    return ScheduledPID(
        ("F",), ("q",), ("q_set",), 0.004, [[[2e4]]], [[[100.0]]], [[[1500.0]]], [[[0.0]]], [[0.0]], [1.0], [1.0],
        [-np.inf], [np.inf], [np.inf], 0.008, Ka=[[[200.0]]], Kaa=[[[95.0]]],
    )  # fmt: skip


def followed_path(law, state, ks, lost=(), path=lambda t: 0.3 * t):
    """Commands along a path that the machine follows exactly; samples in `lost` have no measurement, or no set-point."""
    said = []
    for k in ks:
        r = path(0.004 * k)
        gone = dict(lost).get(k)
        u, state = law.step(state, np.array([np.nan if gone == "r" else r]), np.array([np.nan if gone == "y" else r]))
        said.append(u[0])
    return np.array(said), state


@pytest.mark.parametrize("gone", ["y", "r"])
def test_a_path_goes_on_while_samples_are_left_out(gone):
    """Its difference over a gap was taken for that of one sample, and kicked by a hundred times the load."""
    said, _ = followed_path(path_law(), path_law().init(), range(60), [(k, gone) for k in range(30, 36)])
    np.testing.assert_allclose(said[5:], 60.0, atol=0.5)
    bent = lambda t: 0.5 * t**2  # noqa: E731 - 1 m/s^2: what is guessed is not the path
    said, _ = followed_path(path_law(), path_law().init(), range(60), [(k, gone) for k in range(30, 36)], bent)
    whole, _ = followed_path(path_law(), path_law().init(), range(60), (), bent)
    assert np.abs(said[36:] - whole[36:]).max() < 20.0


def test_a_law_takes_over_on_a_path_that_moves_without_a_bump():
    law = path_law()
    said, _ = followed_path(law, law.init(np.array([60.0])), range(100, 200))
    np.testing.assert_allclose(said, 60.0, atol=0.5)
    modelled = replace(law, bandwidth=10.0)
    _, state = followed_path(modelled, modelled.init(np.array([60.0])), range(100, 160))
    state = law.follow(state, np.array([60.0]), np.array([0.3 * 0.64]), np.array([0.3 * 0.64]))
    said, _ = followed_path(law, state, range(161, 220))
    np.testing.assert_allclose(said, 60.0, atol=0.5)


def test_a_path_that_moves_already_does_not_kick_at_the_first_samples():
    said, _ = followed_path(path_law(), path_law().init(), range(100, 130))
    assert np.abs(said).max() < 62.0
