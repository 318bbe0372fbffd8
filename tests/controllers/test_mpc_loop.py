"""LPV-MPC by its samples: set-points that are known ahead, an operating point that moves, what its fallback law gets."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest

from controllers import mpc as module
from controllers import receding
from controllers.mpc import MPC, Extrapolated, MPCState, design_mpc
from controllers.pid import pid
from controllers.receding import UNPLANNED, Status, Weights
from tests.controllers.test_mpc import DT, Plant, free, law, lpv
from workbench.basis import CONSTANT, PiecewiseLinear
from workbench.data import Channel
from workbench.lpv import OperatingPoint, Predictor, Term, constant_model

N = 10
U0, Y0 = np.array([[0.3, -0.2], [1.1, 0.6]]), np.array([[5.0, 1.0], [7.0, -1.0]])  # at both ends of the schedule


def moving(delays=(0, 0)):
    """The model of test_mpc, whose outputs and operating point move with the schedule too."""
    model, point = lpv(), OperatingPoint(PiecewiseLinear((1.0, 2.0)), u=U0, y=Y0)
    terms = Term(0, delays[0]), Term(1, delays[1])
    return replace(model, C=np.stack([model.C[0], 1.2 * model.C[0]]), operating_point=point, terms=terms)


def operating(rho):
    """u0 and y0, (..., 2)."""
    share = np.asarray(rho)[..., None] - 1.0
    return U0[0] + share * (U0[1] - U0[0]), Y0[0] + share * (Y0[1] - Y0[0])


def before(z, last, rho, slope) -> MPCState:
    """A memory that sees the schedule at rho now, on a steady way."""
    return MPCState(np.array(z), np.array(last), rho - slope, slope, UNPLANNED)


def along(model, path):
    """A, B, C of every sample; the schedule has come to the path's first value as it goes on from there."""
    came = path[0] - (path[1] - path[0]) * np.arange(9, 0, -1)
    weights = model.weights(np.concatenate([came, path]))[9:]
    return [tuple(np.tensordot(weight, M, 1) for M in (model.A, model.B, model.C)) for weight in weights]


def expected_output(controller, z, path):
    """What is measured at z: nothing to correct."""
    return along(controller.model, path)[0][2] @ z[:3] + operating(path[0])[1]


def best(controller, z, last, r, path):
    """The plan for set-points r (N + 1, 2) of y_0 to y_N, with everything that moves moving; nothing but the limits of u."""
    model, w = controller.model, controller.weights
    x, u, d = cp.Variable((N + 1, 3)), cp.Variable((N, 2)), z[3:]
    (u0, y0), matrices = operating(path), along(model, path)
    A, B, C = matrices[N]
    G = C @ np.linalg.solve(np.eye(3) - A, B)
    acting = np.linalg.solve(G, r[N] - y0[N])
    xt, ut = np.linalg.solve(np.eye(3) - A, B @ acting), acting + u0[N] - d
    cost, limits, previous = 0.0, [x[0] == z[:3]], last
    for i in range(N):
        A, B, C = matrices[i]
        if i:
            cost += cp.sum_squares(cp.multiply(np.sqrt(w.outputs), C @ x[i] + y0[i] - r[i]))
        cost += cp.sum_squares(cp.multiply(np.sqrt(w.moves), u[i] - previous))
        limits += [x[i + 1] == A @ x[i] + B @ (u[i] - u0[i] + d), cp.abs(u[i] - previous) <= controller.rate * DT]
        limits += [u[i] >= controller.low, u[i] <= controller.high]
        previous = u[i]
    L = np.linalg.cholesky(controller.terminal_cost(path[N]))
    cost += cp.sum_squares(L.T @ cp.hstack([x[N] - xt, u[N - 1] - ut]))
    cp.Problem(cp.Minimize(cost), limits).solve(solver=cp.CLARABEL)
    return u.value


def test_set_points_of_the_samples_to_come_are_those_of_their_samples():
    """r[i] is wanted of y_i, r[0] of now, the last of all that follows."""
    controller = free(model=moving(), horizon=N)
    z, last = np.array([0.3, -0.2, 0.1, 0.2, -0.1]), np.array([0.4, 0.1])
    r = np.vstack([np.tile([6.0, 0.5], (4, 1)), np.tile([7.5, -0.5], (3, 1)), np.tile([6.8, 1.0], (3, 1))])
    path = np.full(N + 1, 1.3)
    y = expected_output(controller, z, path)
    u, _ = controller.step(before(z, last, 1.3, 0.0), r, y, 1.3)
    wanted = best(controller, z, last, np.vstack([r, r[-1:]]), path)
    np.testing.assert_allclose(u, wanted[0], atol=2e-5)
    early = best(controller, z, last, np.vstack([r[1:], r[-1:], r[-1:]]), path)
    assert (np.abs(early[0] - wanted[0]) > 1e-3).all()  # one sample off is another command
    other, _ = controller.step(before(z, last, 1.3, 0.0), np.vstack([[[99.0, 99.0]], r[1:]]), y, 1.3)
    np.testing.assert_allclose(other, u, atol=1e-9)  # what is wanted of now comes too late


@pytest.mark.parametrize(("slope", "delays"), [(0.03, (0, 0)), (-0.02, (0, 0)), (0.03, (0, 3)), (-0.02, (2, 0)), (0.03, (2, 2))])
def test_matrices_and_operating_point_move_with_the_schedule_over_the_horizon(slope, delays):
    controller = free(model=moving(delays), horizon=N, prediction=Extrapolated(memory=10.0))
    random = np.random.default_rng(8)
    for _ in range(3):
        z, last, rho = 0.5 * random.normal(size=5), random.normal(size=2), random.uniform(1.3, 1.6)
        r = np.tile(random.normal((6.0, 0.0)), (N + 1, 1))
        path = rho + slope * np.arange(N + 1)
        y = expected_output(controller, z, path)
        u, state = controller.step(before(z, last, rho, slope), r[0], y, rho)
        np.testing.assert_allclose(state.plan.commands, best(controller, z, last, r, path), atol=3e-5)
        A, B, _ = along(controller.model, path)[0]
        np.testing.assert_allclose(state.z[:3], A @ z[:3] + B @ (u - operating(rho)[0] + z[3:]), atol=1e-9)
        np.testing.assert_allclose(state.z[3:], z[3:], atol=1e-9)


@pytest.mark.parametrize("at_inputs", [True, False])
def test_the_first_sample_counts_from_the_operating_point_of_its_schedule(at_inputs):
    """At rest at the operating point nothing acts: no state, no disturbance."""
    model = moving()
    controller = law(model=model, observer=module.design_observer(model, at_inputs=at_inputs))
    u0, y0 = operating(1.7)
    u, state = controller.step(controller.init(u0), y0, y0, 1.7)
    np.testing.assert_allclose(u, u0, atol=1e-7)
    np.testing.assert_allclose(state.z, np.zeros(5), atol=1e-7)
    np.testing.assert_allclose(controller.init().u, operating(1.5)[0], atol=1e-12)  # of the middle, where nothing was commanded


def test_no_offset_at_an_operating_point_that_moves():
    model = moving()
    controller, plant = law(model=model), Plant(model, push=(0.2, -0.1))
    state, r = controller.init(), np.array([6.2, 0.3])
    for k in range(500):
        rho = min(1.2 + 0.002 * k, 1.8)
        u0, y0 = operating(rho)
        A, B, C, _ = model.freeze(rho)
        y = C @ plant.x + y0
        u, state = controller.step(state, r, y, rho)
        plant.x = A @ plant.x + B @ (u - u0 + plant.push)
    np.testing.assert_allclose(y, r, atol=1e-3)


# ---- what the fallback law gets ----------------------------------------------------------------------------------------------


def scheduled(horizon=1) -> MPC:
    """A law whose fallback moves with the schedule, without limits that act; no plan that lasts."""
    base = free(model=moving(), horizon=horizon)
    one = base.fallback
    fallback = replace(
        one, Kp=np.concatenate([one.Kp, 3.0 * one.Kp]), Ki=np.concatenate([one.Ki, -2.0 * one.Ki]),
        Kd=np.zeros((2, 2, 2)), Kr=np.full((2, 2, 2), 0.3), u0=np.zeros((2, 2)), basis=PiecewiseLinear((1.0, 2.0)),
        schedule="r2", span=np.array([1.0, 2.0]),
        low=np.full(2, -1e6), high=np.full(2, 1e6), rate=np.full(2, 1e9),
    )  # fmt: skip
    return replace(base, fallback=fallback)


@pytest.fixture
def no_solver(monkeypatch):
    for where, name in ((receding, "solved_by_daqp"), (receding, "solved_by_clarabel"), (module, "solved_by_daqp")):
        monkeypatch.setattr(where, name, lambda program: None)


def test_the_fallback_law_gets_the_set_point_and_the_schedule_of_this_sample(no_solver):
    """Missing set-points are where the model says it is, a missing schedule is where it was, and now comes first."""
    controller, random = scheduled(horizon=4), np.random.default_rng(9)
    z, last, rho = np.array([0.3, -0.2, 0.1, 0.2, -0.1]), np.array([0.4, 0.1]), 1.2
    state, memory = before(z, last, rho, 0.0), controller.fallback.init(last)
    for k, at in enumerate((1.2, 1.9, np.nan, 1.4, 1.1)):
        rho = at if np.isfinite(at) else rho
        y, r = random.normal((5.0, 1.0)), random.normal((6.0, 0.0), size=(4, 2))
        given = r.copy()
        if k in (1, 3):
            given[:, 1] = np.nan
            L, _ = controller.observer.gains(rho)
            C = controller.model.freeze(rho)[2]
            corrected = state.z + L @ (y - C @ state.z[:3] - operating(rho)[1])
            r[:, 1] = C[1] @ corrected[:3] + operating(rho)[1][1]
        wanted, memory = controller.fallback.step(memory, r[0], y, rho)
        u, state = controller.step(state, given, y, at)
        assert state.status is Status.FALLBACK
        np.testing.assert_allclose(u, wanted, rtol=0, atol=1e-10)


def test_without_a_set_point_an_output_stays_where_it_is():
    controller = free(model=moving(), horizon=N)
    z, last, rho = np.array([0.3, -0.2, 0.1, 0.2, -0.1]), np.array([0.4, 0.1]), 1.3
    y = expected_output(controller, z, np.full(2, rho))
    state = before(z, last, rho, 0.0)
    given, _ = controller.step(state, np.array([6.0, y[1]]), y, rho)
    missing, _ = controller.step(state, np.array([6.0, np.nan]), y, rho)
    np.testing.assert_allclose(missing, given, rtol=0, atol=1e-9)


def test_limits_default_to_those_of_the_fallback_law():
    own = law()
    for key in ("low", "high", "rate"):
        np.testing.assert_array_equal(getattr(own, key), getattr(own.fallback, key))
    other = design_mpc(lpv(), own.fallback, rate=np.array([1.0, 2.0]), weights=Weights((1.0, 1.0), (1.0, 1.0), (0.0, 0.0)))
    np.testing.assert_array_equal(other.rate, [1.0, 2.0])
    np.testing.assert_array_equal(other.low, own.fallback.low)


def test_a_machine_that_first_goes_the_other_way_comes_back_into_its_limits():
    """y = 400 slow - 60 fast of u: what brings y down in the end moves it up within the horizon, and the cold is far away."""
    A, B, C = np.diag([0.99, 0.6]), np.array([[0.01], [0.4]]), np.array([[400.0, -60.0]])
    K = np.array([[2e-3], [0.0]])
    model = constant_model(
        "heater", 0.1, ((Channel("u", "%", "input"),), (Channel("T", "degC", "output"),)), (A, B, C, np.zeros((1, 1))),
        OperatingPoint(CONSTANT, [[0.0]], [[20.0]]), predictor=Predictor((A - K @ C)[None], B[None], K[None], 20),
        noise=np.array([[0.01]]),
    )  # fmt: skip
    fallback = pid(("u",), ("T",), ("T_set",), 0.1, [1e-3], [1e-3], low=[0.0], high=[1.0])
    law = design_mpc(model, fallback, horizon=10, y_low=np.array([100.0]), y_high=np.array([240.0]))
    u, runs = np.array([0.9]), []
    x, state = np.array([0.9, 0.9]), law.init(u)
    for _ in range(600):
        y = C @ x + 20.0
        u, state = law.step(state, np.array([180.0]), y)
        x = A @ x + B @ u
        runs.append(y[0])
    assert runs[0] > 320.0
    assert max(runs[150:]) < 240.0
    assert abs(runs[-1] - 180.0) < 2.0
