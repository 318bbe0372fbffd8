"""Nonlinear MPC by its samples: its filter beside one written by hand, the plan it starts from, what its fallback law gets."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from controllers import receding
from controllers.files import load_controller, save_controller
from controllers.nmpc import NMPC, Ipopt, RealTimeIteration, design_nmpc
from controllers.pid import pid
from controllers.plant_observer import Belief, PlantObserver, SampledPlant
from controllers.receding import Status, Weights
from plants import WEB_WINDING, WELDING_ROBOT
from tests.controllers.test_nmpc import flat, robot, somewhere, winding
from workbench.basis import PiecewiseLinear
from workbench.errors import InputError

DT = 0.04


@pytest.fixture
def no_solver(monkeypatch):
    for name in ("solved_by_daqp", "solved_by_clarabel"):
        monkeypatch.setattr(receding, name, lambda program: None)


# ---- the filter --------------------------------------------------------------------------------------------------------------


def sampled(x, u, substeps):
    """The winding machine a sample later: classic Runge-Kutta on its equation, in numbers."""
    rates = lambda x: np.array(WEB_WINDING.derivative(x, u))  # noqa: E731
    h = DT / substeps
    for _ in range(substeps):
        k1 = rates(x)
        k2 = rates(x + h / 2 * k1)
        k3 = rates(x + h / 2 * k2)
        k4 = rates(x + h * k3)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


STEPS = np.array([1e-2, 1e-2, 1e-2, 1e-4, 1e-4, 1e-6, 1e-6]), np.full(2, 1e-3)


def slopes(f, at, h=STEPS[0]):
    """Jacobian of f by central differences of steps h."""
    return np.column_stack([(f(at + d) - f(at - d)) / (2 * d[i]) for i, d in enumerate(np.diag(h))])


def linearised(x, u, substeps):
    """A and B of a sample from x under u."""
    return slopes(lambda x: sampled(x, u, substeps), x), slopes(lambda u: sampled(x, u, substeps), u, STEPS[1])


@pytest.mark.slow
def test_its_filter_is_the_extended_kalman_filter_of_the_plant():
    """Written by hand beside `step`: corrected by this sample's measurement, moved by this sample's command."""
    law = replace(winding(horizon=6), drift=0.5)
    substeps, random = law.observer.model.substeps, np.random.default_rng(11)
    noise = np.array([WEB_WINDING.noise[name] for name in WEB_WINDING.output_names])
    seen = lambda x: np.array(WEB_WINDING.output(x))  # noqa: E731
    x0, u0 = WEB_WINDING.equilibrium()
    (A, B), C = linearised(x0, u0, substeps), slopes(seen, x0)
    by_states = np.linalg.pinv(C, rcond=1e-9)
    by_inputs = np.linalg.pinv(C @ sum(np.linalg.matrix_power(A, k) @ B for k in range(50)))
    drift = np.zeros((9, 9))
    drift[:7, :7] = by_states @ np.diag(noise**2) @ by_states.T
    drift[7:, 7:] = by_inputs @ np.diag(noise**2) @ by_inputs.T

    truth, commanded = WEB_WINDING.equilibrium(r2=0.012, r1=0.0255)
    state, last, push = law.init(commanded), commanded, np.array([0.1, -0.05])
    order = [law.measured.index(name) for name in WEB_WINDING.output_names]
    for k in range(6):
        y = seen(truth) + noise * random.normal(size=5)
        if k:
            y[k % 5] = np.nan
        else:
            z = np.append(WEB_WINDING.equilibrium(w3=y[2], r2=y[4])[0], [0.0, 0.0])
            P = np.diag((0.05 * z) ** 2) + drift
        given = np.empty(5)
        given[order] = y
        u, state = law.step(state, np.array([100.0 + 3.0 * k, 1.0 - k]), given)
        assert np.abs(u - last).max() > 1e-3  # the command before is another

        there = np.isfinite(y)
        H = np.hstack([slopes(seen, z[:7]), np.zeros((5, 2))])[there]
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(noise[there] ** 2))
        z, P = z + K @ (y - seen(z[:7]))[there], P - K @ H @ P
        x, d = z[:7], z[7:]
        A, B = linearised(x, u + d, substeps)
        F = np.block([[A, B], [np.zeros((2, 7)), np.eye(2)]])
        P = F @ P @ F.T + 0.25 * drift
        P[:7, :7] += 0.01**2 * B @ B.T
        z = np.append(sampled(x, u + d, substeps), d)

        sigma = np.sqrt(np.diag(P))
        np.testing.assert_allclose((state.belief.z - z) / sigma, np.zeros(9), atol=1e-4)
        np.testing.assert_allclose(state.belief.P / np.outer(sigma, sigma), P / np.outer(sigma, sigma), atol=1e-4)
        truth, last = sampled(truth, u + push, substeps), u


PUSHED = replace(WELDING_ROBOT, disturbance={"u": 0.5}, process={"v2": 0.3})


def robot_with_push():
    """A, B over a sample of the robot's equation, with the push as third state."""
    p = dict(zip((q.name for q in WELDING_ROBOT.parameters), WELDING_ROBOT.nominal, strict=True))
    whole = np.zeros((3, 3))
    whole[0, :2] = -(p["b1"] + p["c"]) / p["m1"], p["c"] / p["m1"]
    whole[1, :2] = p["c"] / p["m2"], -(p["c"] + p["b2"]) / p["m2"]
    whole[0, 2] = 1.0 / p["m1"]
    A = expm(0.02 * whole)
    return A, np.append(A[:2, 2], 0.0)[:, None]


@pytest.mark.slow
def test_pushes_at_inputs_and_noise_of_the_process_are_in_the_filter():
    observer = PlantObserver(SampledPlant(PUSHED, ("u",)), drift=1.5)
    A, B = robot_with_push()
    gain = sum(np.linalg.matrix_power(A, k) @ B for k in range(50))[0, 0]
    Q = np.diag([(1.5 * 0.002) ** 2, 0.0, (1.5 * 0.002 / gain) ** 2])
    Q += B @ B.T * 0.5**2 + np.diag([0.0, (0.02 * 0.3) ** 2, 0.0])
    H, R = np.array([[1.0, 0.0, 0.0]]), np.array([[0.002**2]])
    steady = solve_discrete_are(A.T, H.T, Q, R)
    for start in (0.5 * steady, steady, 2.0 * steady):
        belief = Belief(np.zeros(3), start)
        for _ in range(2 if start is steady else 2500):
            belief = observer.moved(observer.corrected(belief, np.zeros(1)), np.zeros(1))
        np.testing.assert_allclose(belief.P, steady, rtol=1e-3)


def test_the_first_sample_is_corrected_by_its_measurement():
    """The robot starts at rest, as uncertain as its sensor: half of what is seen is believed."""
    law = replace(robot(), drift=0.7)
    u, state = law.step(law.init(np.array([0.5])), np.array([1.0]), np.array([0.3]))
    A, B = robot_with_push()
    np.testing.assert_allclose(state.belief.z, A @ [0.15, 0.0, 0.0] + B[:, 0] * u[0], rtol=1e-4, atol=1e-9)


def test_the_first_guess_is_as_uncertain_as_is_said():
    """A twentieth of every start value, and all that the noise hides, whatever the drift."""
    for drift in (0.1, 0.6):
        observer = PlantObserver(SampledPlant(WEB_WINDING, ("V1", "V2")), drift=drift)
        y = np.array([40.0, 90.0, 97.0, 0.5, 0.0125])
        belief = observer.first(y)
        x = WEB_WINDING.equilibrium(w3=97.0, r2=0.0125)[0]
        np.testing.assert_allclose(belief.z, np.append(x, [0.0, 0.0]), rtol=1e-12)
        hidden = observer._wander / drift**2
        np.testing.assert_allclose(belief.P, np.diag(np.append(0.05 * x, [0.0, 0.0]) ** 2) + hidden, rtol=1e-12)
        np.testing.assert_allclose(np.diag(hidden)[[0, 1, 2]], np.array([0.2, 0.2, 0.3]) ** 2, rtol=1e-9)  # seen directly


# ---- the plan ----------------------------------------------------------------------------------------------------------------


def test_a_plan_starts_from_the_last_one_a_sample_later(monkeypatch):
    law, given, works = winding(horizon=5), [], {"now": True}
    program, solved = NMPC._program, NMPC._solved
    monkeypatch.setattr(NMPC, "_program", lambda self, *a: given.append(np.array(a[4])) or program(self, *a))
    monkeypatch.setattr(NMPC, "_solved", lambda self, p: solved(self, p) if works["now"] else (None, Status.FALLBACK))
    state, (x, start) = law.init(), WEB_WINDING.equilibrium()
    y = np.array(WEB_WINDING.output(x))[[2, 3, 0, 1, 4]]
    held, found = np.tile(start, (5, 1)), None
    for k in range(9):
        works["now"] = k not in (3, 4)
        _, state = law.step(state, np.array([103.0 + k, -2.0]), y)
        np.testing.assert_array_equal(given[k], held)
        found = found if state.status is Status.LAST_PLAN else state.plan.commands
        left = found[1 + state.plan.age :]
        held = np.vstack([left, np.tile(left[-1], (5 - len(left), 1))])
        assert np.abs(np.diff(found, axis=0)).max() > 1e-3
    assert len(given) == 9


@pytest.mark.parametrize(
    ("answers", "expected", "steps"),
    [
        ((Status.OPTIMAL, Status.OPTIMAL, Status.OPTIMAL), Status.OPTIMAL, 3),
        ((Status.SECOND_SOLVER, Status.OPTIMAL, Status.OPTIMAL), Status.SECOND_SOLVER, 3),
        ((Status.OPTIMAL, Status.OPTIMAL, None), Status.SECOND_SOLVER, 2),
        ((None,), Status.FALLBACK, 0),
    ],
)
def test_several_steps_are_optimal_where_each_of_them_is(monkeypatch, answers, expected, steps):
    """Where one has no answer, the plan of those before it is taken."""
    law, left, found, solved = winding(horizon=4, solver=RealTimeIteration(3)), list(answers), [], NMPC._solved

    def answered(self, program):
        how = left.pop(0)
        if how is None:
            return None, Status.FALLBACK
        found.append(solved(self, program)[0])
        return found[-1], how

    monkeypatch.setattr(NMPC, "_solved", answered)
    (x, u), r = WEB_WINDING.equilibrium(), np.tile([103.0, -2.0], (4, 1))
    plan, status = law._planned(law.init(u), x, np.zeros(2), r)
    assert (status, len(found), left) == (expected, steps, [])
    assert (plan is None) if steps == 0 else np.array_equal(plan, found[-1])


@pytest.mark.slow
def test_ipopt_is_not_believed_before_it_has_converged():
    (x, u), d = somewhere(np.random.default_rng(12)), np.array([0.1, -0.05])
    r = np.tile([104.0, -2.0], (8, 1))
    short, long, one = (winding(horizon=8, solver=s) for s in (Ipopt(iterations=1), Ipopt(), RealTimeIteration()))
    plan, status = short._planned(short.init(u), x, d, r)
    assert status is not Status.OPTIMAL
    np.testing.assert_allclose(plan, one._planned(one.init(u), x, d, r)[0], atol=1e-9)  # a Gauss-Newton step instead
    assert long._planned(long.init(u), x, d, r)[1] is Status.OPTIMAL
    _, state = short.step(short.init(u), r[0], np.array(WEB_WINDING.output(x))[[2, 3, 0, 1, 4]])
    assert state.status is Status.SECOND_SOLVER


@pytest.mark.parametrize("violation", [0.4, 1.0])
def test_a_violated_output_limit_costs_both_solvers_the_same(violation):
    """Both outputs start beyond limits that cannot be kept."""
    (x, u), d = WEB_WINDING.equilibrium(r2=0.015, w3=100.0), np.zeros(2)
    weights = Weights((2.4e-4, 8e-3), (0.5, 0.8), (0.0, 0.0), violation)
    limits = {"y_low": np.array([125.0, -30.0]), "y_high": np.array([150.0, -8.0]), "horizon": 8, "weights": weights}
    r = np.tile([98.0, 1.0], (8, 1))
    ours, theirs = winding(**limits, solver=RealTimeIteration(10)), winding(**limits, solver=Ipopt())
    one, other = ours._planned(ours.init(u), x, d, r)[0], theirs._planned(theirs.init(u), x, d, r)
    assert other[1] is Status.OPTIMAL
    np.testing.assert_allclose(one, other[0], atol=5e-5)
    y = []
    for v in one:
        x = flat(ours.observer.model.step(x, v))
        y.append(np.array(WEB_WINDING.output(x))[2:4])
    assert (np.maximum(ours.y_low - y, y - ours.y_high).max(axis=0) > 0.05).all()


# ---- what the fallback law gets ----------------------------------------------------------------------------------------------


def scheduled(**options) -> NMPC:
    """The winding machine's law, whose fallback has other gains at another radius, and limits that are not reached."""
    base = winding(horizon=3).fallback
    fallback = replace(
        base, Kp=np.concatenate([base.Kp, -3.0 * base.Kp]), Ki=np.concatenate([base.Ki, 4.0 * base.Ki]), Kd=np.zeros((2, 2, 2)),
        Kr=np.stack([np.full((2, 2), 0.2), np.full((2, 2), -0.1)]),
        u0=np.zeros((2, 2)), basis=PiecewiseLinear((0.01, 0.03)), schedule="r2", span=np.array([0.01, 0.03]),
        low=np.full(2, -50.0), high=np.full(2, 50.0),
    )  # fmt: skip
    return winding_with(fallback, **options)


def winding_with(fallback, **options) -> NMPC:
    return design_nmpc(WEB_WINDING, fallback, **{"weights": winding().weights, "horizon": 3, **options})


def test_the_fallback_law_gets_its_channels_and_the_set_point_and_schedule_of_this_sample(no_solver):
    """The schedule as the filter sees it, measured or not; what else is not measured counts as where it should be."""
    law, random = scheduled(), np.random.default_rng(13)
    start = np.array([0.4, 1.2])
    state, memory, radii = law.init(start), law.fallback.init(start), []
    for k in range(8):
        y = np.array([97.0 + k, 0.5 * k, 41.0, 88.0, 0.012 + 0.001 * k]) + 0.1 * random.normal(size=5) * [1, 1, 1, 1, 0]
        r = random.normal((100.0, 0.0), size=(3, 2))
        y[[[], [], [0], [4], [], [1], [4, 0], []][k]] = np.nan
        seen = y[[2, 3, 0, 1, 4]]
        belief = law.observer.first(seen) if k == 0 else state.belief
        radii.append(law.observer.corrected(belief, seen).z[6])
        u, state = law.step(state, r, y)
        wanted, memory = law.fallback.step(memory, r[0], np.where(np.isnan(y[:2]), r[0], y[:2]), radii[-1])
        assert state.status is Status.FALLBACK
        np.testing.assert_allclose(u, wanted, rtol=0, atol=1e-12)
    assert np.ptp(radii) > 0.003


def test_a_schedule_that_is_never_measured_leaves_the_fallback_law_a_command(no_solver):
    law = scheduled()
    state = law.init(np.array([0.4, 1.2]))
    for _ in range(4):
        u, state = law.step(state, np.array([100.0, 0.0]), np.array([97.0, 0.5, 41.0, 88.0, np.nan]))
        assert state.status is Status.FALLBACK
        assert np.isfinite(u).all()
    assert np.abs(u - [0.4, 1.2]).max() > 1e-3


@pytest.mark.parametrize("works", [True, False])
def test_without_a_set_point_an_output_stays_where_the_filter_says_it_is(monkeypatch, works):
    if not works:
        for name in ("solved_by_daqp", "solved_by_clarabel"):
            monkeypatch.setattr(receding, name, lambda program: None)
    law = winding(horizon=5)
    state, y = law.init(), np.array([100.2, 0.7, 37.9, 90.7, 0.0110])
    _, state = law.step(state, np.array([100.0, 0.5]), y)
    belief = law.observer.corrected(state.belief, y[[2, 3, 0, 1, 4]])
    now = np.array(WEB_WINDING.output(belief.z[:7]))[2:4]
    given, after = law.step(state, np.array([100.5, now[1]]), y)
    missing, other = law.step(state, np.array([100.5, np.nan]), y)
    np.testing.assert_allclose(missing, given, rtol=0, atol=1e-9)
    zero, _ = law.step(state, np.array([100.5, 0.0]), y)
    assert works is False or np.abs(zero - given).max() > 1e-3
    assert after.status is other.status is (Status.OPTIMAL if works else Status.FALLBACK)


# ---- what it starts with -----------------------------------------------------------------------------------------------------


def test_the_first_command_is_that_of_the_actuated_inputs_in_their_order():
    one = winding()
    fallback = pid(("V2", "V1"), ("theta", "w3"), ("theta_set", "w3_set"), DT, [0.01, 0.01], [0.05, 0.05], low=-9.0, high=9.0)
    law = design_nmpc(WEB_WINDING, fallback, weights=one.weights, horizon=5)
    _, u = WEB_WINDING.equilibrium()
    assert abs(u[0] - u[1]) > 0.1
    np.testing.assert_array_equal(law.init().u, u[::-1])
    np.testing.assert_array_equal(one.init().u, u)
    only = pid(("V2",), ("w3",), ("w3_set",), DT, [0.01], [0.05], low=-9.0, high=9.0)
    single = design_nmpc(WEB_WINDING, only, weights=Weights((1.0,), (1.0,), (0.0,)), horizon=5)
    np.testing.assert_array_equal(single.init().u, u[1:])


def test_limits_and_rates_default_to_those_of_the_fallback_law():
    base = replace(winding().fallback, rate=np.array([3.0, 7.0]))
    law = winding_with(base)
    for key in ("low", "high", "rate"):
        np.testing.assert_array_equal(getattr(law, key), getattr(base, key))
    other = winding_with(base, rate=np.array([1.0, 2.0]), low=np.array([-2.0, -2.0]))
    assert (other.rate.tolist(), other.low.tolist(), other.high.tolist()) == ([1.0, 2.0], [-2.0, -2.0], base.high.tolist())


def test_the_drift_of_its_filter_comes_back_from_a_file(tmp_path):
    law = replace(robot(horizon=4), drift=0.07)
    back = load_controller(save_controller(law, tmp_path / "n.json"), {"welding-robot": WELDING_ROBOT}.__getitem__)
    assert (back.drift, back.observer.drift) == (0.07, 0.07)


@pytest.mark.parametrize(
    ("effects", "named"),
    [
        ({"viscoelastic@T1": {"share": 0.5}}, "viscoelastic@T1"),  # a state of its own
        ({"gear-backlash@V1": {"play": 0.01}}, "gear-backlash@V1"),  # a memory
        ({"periodic-tension@T2": {"cosine": 0.1}}, "periodic-tension@T2"),  # an angle
    ],
)
def test_an_effect_that_remembers_is_refused(effects, named):
    with pytest.raises(InputError, match=named):
        SampledPlant(replace(WEB_WINDING, effects=effects), ("V1", "V2"))
