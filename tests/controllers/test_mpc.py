"""LPV-MPC: the program against CVXPY, the regulator it must equal, offsets, limits, and what happens when solvers fail."""

from dataclasses import replace

import control
import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import lsq_linear

from controllers import mpc as module
from controllers import receding
from controllers.along import Along
from controllers.condensing import condense
from controllers.mpc import MPC, Extrapolated, Held, design_mpc
from controllers.observer import design_observer
from controllers.pid import pid
from controllers.receding import Status, Weights
from workbench.basis import CONSTANT, PiecewiseLinear
from workbench.data import Channel
from workbench.errors import InputError
from workbench.lpv import LPVModel, OperatingPoint, Predictor, Term

DT = 0.1
A = np.array([[0.9, 0.1, 0.0], [-0.1, 0.8, 0.1], [0.0, 0.0, 0.6]])
B = np.array([[0.2, 0.0], [0.1, 0.3], [0.0, 0.4]])
C = np.array([[1.0, 0.0, 0.3], [0.0, 1.0, -0.2]])
K = 0.2 * C.T
NAMES = (("a", "b"), ("c", "d"), ("c_set", "d_set"))


def lpv() -> LPVModel:
    """Three states whose input gains turn over the schedule; operating point away from zero."""
    inputs, outputs = ((Channel(n, "V", role) for n in names) for names, role in ((NAMES[0], "input"), (NAMES[1], "output")))
    two = lambda M, other: np.stack([M, other])  # noqa: E731
    turned = B @ np.array([[0.6, -0.5], [0.7, 1.2]])
    return LPVModel(
        "m", DT, tuple(inputs), tuple(outputs), (Channel("r2", "m", "schedule"),), [[1.0, 2.0]], PiecewiseLinear((1.0, 2.0)),
        (Term(0), Term(1)), two(A, 0.95 * A), two(B, turned), two(C, C), np.zeros((2, 2, 2)),
        OperatingPoint(CONSTANT, u=[[0.3, -0.2]], y=[[5.0, 1.0]]),
        Predictor(two(A - K @ C, 0.95 * A - K @ C), two(B, turned), two(K, K)), np.diag([0.01, 0.02]),
    )  # fmt: skip


def law(model=None, **options) -> MPC:
    model = model or lpv()
    fallback = pid(*NAMES, DT, [0.1, 0.1], [0.2, 0.2], low=(-3.0, -2.0), high=(2.0, 3.0), rate=(8.0, 10.0))
    return design_mpc(model, fallback, **{"weights": Weights((1.0, 2.0), (0.3, 0.2), (0.0, 0.0)), **options})


def free(**options) -> MPC:
    """Without limits."""
    far = {"low": np.full(2, -1e6), "high": np.full(2, 1e6), "rate": np.full(2, 1e9)}
    return law(**(far | options))


class Plant:
    """The model itself as the plant, at schedule values of its own, with disturbances it does not know."""

    def __init__(self, model, push=(0.0, 0.0), x=None):
        self.model, self.push = model, np.asarray(push)
        self.x = np.zeros(model.order) if x is None else x

    def measure(self, rho):
        return self.model.freeze(rho)[2] @ self.x + self.model.operating_point.y[0]

    def advance(self, u, rho):
        A, B, _, _ = self.model.freeze(rho)
        self.x = A @ self.x + B @ (u - self.model.operating_point.u[0] + self.push)


def run(controller, plant, r, rho, n=200, state=None):
    state, us, ys, states = state or controller.init(), [], [], []
    for k in range(n):
        y, at = plant.measure(rho(k)), rho(k)
        u, state = controller.step(state, r(k), y, at)
        plant.advance(u, at)
        us.append(u), ys.append(y), states.append(state)
    return np.array(us), np.array(ys), states


# ---- the program -----------------------------------------------------------------------------------------------------------


def test_the_condensed_program_is_the_cost_of_the_prediction():
    random, (N, nx, nu, ny) = np.random.default_rng(1), (7, 4, 2, 3)
    M, c, g = random.normal(size=(N + 1, nx * (nx + nu + ny))) * 0.4, random.normal(size=(N, nx)), random.normal(size=(N + 1, ny))
    x0, r, last, xt, ut = (random.normal(size=n) for n in (nx, (N + 1, ny), nu, nx, nu))
    Q, S, R, P = (V @ V.T for V in (random.normal(size=(n, n)) for n in (ny, nu, nu, nx + nu)))
    H, f, Y, y_free = condense(M, c, g, x0, r, last, (xt, ut), (Q, S, R, P))
    np.testing.assert_allclose(H, H.T, atol=1e-10)

    def simulated(U):
        x, before, total, outputs = x0, last, 0.0, []
        for i, u in enumerate(U.reshape(N, nu)):
            Ai, Bi, Ci = np.split(M[i], [nx * nx, nx * (nx + nu)])
            e = Ci.reshape(ny, nx) @ x + g[i] - r[i]
            total += (e @ Q @ e if i else 0.0) + (u - before) @ S @ (u - before) + (u - ut) @ R @ (u - ut)
            x, before = Ai.reshape(nx, nx) @ x + Bi.reshape(nx, nu) @ u + c[i], u
            outputs.append(M[i + 1, nx * (nx + nu) :].reshape(ny, nx) @ x + g[i + 1])
        end = np.concatenate([x - xt, before - ut])
        return 0.5 * (total + end @ P @ end), np.concatenate(outputs)

    rest = simulated(np.zeros(N * nu))[0]
    for _ in range(5):
        U = random.normal(size=N * nu)
        cost, outputs = simulated(U)
        assert 0.5 * U @ H @ U + f @ U == pytest.approx(cost - rest, rel=1e-10, abs=1e-9)
        np.testing.assert_allclose(Y @ U + y_free, outputs, atol=1e-10)


@pytest.mark.parametrize("horizon", [1, 4, 20])
@pytest.mark.parametrize("inputs", [0.0, 0.5])
def test_without_active_limits_it_is_the_regulator_of_python_control(horizon, inputs):
    """At a frozen schedule the first move is -F (x - xt, last - ut) with F from python-control's dlqr, whatever the horizon."""
    weights, rho = Weights((1.0, 2.0), (0.3, 0.2), (inputs, inputs)), 1.4
    controller = free(horizon=horizon, weights=weights, prediction=Held())
    Af, Bf, Cf, _ = lpv().freeze(rho)
    Az, Bz = np.block([[Af, Bf], [np.zeros((2, 3)), np.eye(2)]]), np.vstack([Bf, np.eye(2)])
    Q = np.zeros((5, 5))
    Q[:3, :3], Q[3:, 3:] = Cf.T @ np.diag([1.0, 2.0]) @ Cf, inputs * np.eye(2)
    S, N = np.diag([0.3, 0.2]) + inputs * np.eye(2), np.vstack([np.zeros((3, 2)), inputs * np.eye(2)])
    F, _, _ = control.dlqr(Az, Bz, Q, S, N)
    random = np.random.default_rng(2)
    for _ in range(5):
        z, last, r = random.normal(size=5), random.normal(size=2), random.normal((5.0, 1.0))
        along, state = Along(controller, controller._path(rho, 0.0)), controller.init(last)
        plan, status = controller._solved(controller._program(state.u, along, z, np.tile(r, (horizon + 1, 1))))
        xt, ut, _ = controller._target(last, along, z, r)
        expected = last - F @ np.concatenate([z[:3] - xt, last - ut])
        # the terminal cost is interpolated between eleven schedule values; at one of them it is exact
        np.testing.assert_allclose(plan[0], expected, atol=1e-6)
        assert status is Status.OPTIMAL


def stated_in_cvxpy(controller, state, z, r, path):
    """The same problem with states and slacks as variables, as it stands in the module's docstring; the commands."""
    model, N, w = controller.model, controller.horizon, controller.weights
    nx, along = model.order, Along(controller, path)
    xt, ut, yt = controller._target(state.u, along, z, r)
    now = model.freeze(path[0])[2] @ z[:nx] + [5.0, 1.0]
    way = z[:nx]  # under the command of the steady state, of which what is beyond its limit now asks no more
    x, u, s = cp.Variable((N + 1, nx)), cp.Variable((N, 2)), cp.Variable(2, nonneg=True)
    cost, limits = 0.0, [x[0] == z[:nx]]
    before, price = state.u, w.violation
    for i in range(N):
        Ai, Bi, Ci, _ = model.freeze(path[i])
        if i:
            cost += cp.sum_squares(cp.multiply(np.sqrt(w.outputs), Ci @ x[i] + [5.0, 1.0] - yt))
        cost += cp.sum_squares(cp.multiply(np.sqrt(w.moves), u[i] - before))
        limits += [x[i + 1] == Ai @ x[i] + Bi @ (u[i] - [0.3, -0.2] + z[nx:]), cp.abs(u[i] - before) <= controller.rate * DT]
        limits += [u[i] >= controller.low, u[i] <= controller.high]
        y = model.freeze(path[i + 1])[2] @ x[i + 1] + [5.0, 1.0]
        way = Ai @ way + Bi @ (ut - [0.3, -0.2] + z[nx:])
        allowed = model.freeze(path[i + 1])[2] @ way + [5.0, 1.0]
        high, low = controller.y_high, controller.y_low
        for j in range(2):
            if now[j] > high[j]:
                high = np.where(np.arange(2) == j, min(max(high[j], allowed[j]), high[j] + 2.0 * (now[j] - high[j])), high)
            if now[j] < low[j]:
                low = np.where(np.arange(2) == j, max(min(low[j], allowed[j]), low[j] - 2.0 * (low[j] - now[j])), low)
        limits += [y - s <= high, y + s >= low]
        before = u[i]
    L = np.linalg.cholesky(controller.terminal_cost(path[-1]))
    cost += cp.sum_squares(L.T @ cp.hstack([x[N] - xt, u[N - 1] - ut]))
    penalty = price * (np.sqrt(w.outputs) @ s + 0.5 * w.outputs @ cp.square(s))
    cp.Problem(cp.Minimize(0.5 * cost + penalty), limits).solve(solver=cp.CLARABEL)
    return u.value


@pytest.mark.slow
def test_the_first_move_is_that_of_cvxpy_and_clarabel():
    controller = law(horizon=12, y_low=np.array([4.0, -1.0]), y_high=np.array([6.0, 2.0]))
    random, active = np.random.default_rng(3), 0
    for _ in range(12):
        z = random.normal(size=5) * [1.0, 1.0, 1.0, 0.5, 0.5]
        state = controller.init(random.uniform(-1.0, 1.0, 2))
        r, rho, slope = random.uniform((3.0, -1.0), (7.0, 3.0)), random.uniform(1.0, 1.8), 0.01
        path = controller._path(rho, slope)
        program = controller._program(state.u, Along(controller, path), z, np.tile(r, (13, 1)))
        plan, _ = controller._solved(program)
        np.testing.assert_allclose(plan[0], stated_in_cvxpy(controller, state, z, r, path)[0], atol=3e-5)
        room = np.minimum(controller.high - plan, plan - controller.low)
        active += bool((room < 1e-6).any() or (np.abs(np.diff(plan, axis=0)) > controller.rate * DT - 1e-6).any())
    assert active >= 6  # limits were really in play


def test_a_limit_that_is_hardly_exceeded_is_hardly_moved(monkeypatch):
    """However far the command of the steady state would throw the output: by twice its excess at most."""
    controller, random = law(horizon=12, y_high=np.array([5.2, 1.2])), np.random.default_rng(6)
    give_way, moved = MPC._give_way, []
    for _ in range(60):
        z, last = random.normal(size=5) * [0.4, 0.4, 0.4, 0.5, 0.5], random.uniform(-1.0, 1.0, 2)
        along = Along(controller, controller._path(1.3, 0.0))
        excess = np.maximum(along.outputs(z) - controller.y_high, 0.0)
        programs = []
        for way in (give_way, lambda *_: None):
            monkeypatch.setattr(MPC, "_give_way", way)
            programs.append(controller._program(last, along, z, np.tile([4.0, 0.5], (13, 1))))
        there = np.isfinite(programs[1].upper)
        by = programs[0].upper[there] - programs[1].upper[there]
        assert by.min() >= 0.0
        assert by.max() <= 2.0 * excess.max() + 1e-12
        moved.append(by.max())
    assert max(moved) > 0.1
    assert 0.0 in moved


def test_both_solvers_give_one_answer():
    controller = law(y_high=np.array([5.5, 1.5]))
    random = np.random.default_rng(4)
    for _ in range(10):
        last, z = random.uniform(-1, 1, 2), random.normal(size=5)
        along = Along(controller, controller._path(1.3, 0.0))
        program = controller._program(last, along, z, np.tile([6.0, 2.0], (21, 1)))
        one, other = receding.solved_by_daqp(program), receding.solved_by_clarabel(program)
        np.testing.assert_allclose(one[:2], other[:2], atol=1e-4)


def test_the_schedule_is_predicted_along_its_slope():
    controller = law(prediction=Extrapolated(memory=5.0))
    state = controller.init()
    for k in range(100):
        rho, slope = controller._followed(state, 1.0 + 0.002 * k)
        state = state._replace(rho=rho, slope=slope)
    np.testing.assert_allclose(controller._path(rho, slope), 1.198 + 0.002 * np.arange(21), atol=1e-9)
    assert controller._path(1.999, 0.01).max() == 2.0  # never beyond what the model knows
    held = law(prediction=Held())
    assert held._followed(state, 1.5)[1] == 0.0


# ---- in closed loop --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("at_inputs", [True, False])
def test_no_offset_under_disturbances_it_does_not_know(at_inputs):
    controller = law(observer=design_observer(lpv(), at_inputs=at_inputs))
    plant = Plant(lpv(), push=(0.4, -0.3))
    _, ys, states = run(controller, plant, lambda k: np.array([5.5, 0.7]), lambda k: 1.0 + 0.002 * min(k, 200), n=600)
    np.testing.assert_allclose(ys[-1], [5.5, 0.7], atol=2e-3)
    assert all(s.status is Status.OPTIMAL for s in states)


def test_no_offset_on_another_machine_than_its_model():
    other = replace(lpv(), B=0.7 * lpv().B, A=1.02 * lpv().A)
    _, ys, _ = run(law(), Plant(other), lambda k: np.array([5.5, 0.7]), lambda k: 1.5, n=400)
    np.testing.assert_allclose(ys[-1], [5.5, 0.7], atol=1e-3)


def test_it_takes_over_at_rest_without_a_bump():
    model, u = lpv(), np.array([0.5, 0.1])
    Af, Bf, _, _ = model.freeze(1.2)
    plant = Plant(model, x=np.linalg.solve(np.eye(3) - Af, Bf @ (u - [0.3, -0.2])))
    controller = law(prediction=Held())
    y = plant.measure(1.2)
    us, _, _ = run(controller, plant, lambda k: y, lambda k: 1.2, n=20, state=controller.init(u))
    np.testing.assert_allclose(us, np.tile(u, (20, 1)), atol=1e-7)


def test_a_setpoint_out_of_reach_becomes_the_nearest_steady_state():
    controller, rho, far = law(), 1.3, np.array([30.0, -9.0])
    us, ys, _ = run(controller, Plant(lpv()), lambda k: far, lambda k: rho, n=300)
    Af, Bf, Cf, _ = lpv().freeze(rho)
    G = Cf @ np.linalg.solve(np.eye(3) - Af, Bf)
    weight = np.sqrt([1.0, 2.0])
    offset = np.array([5.0, 1.0]) - G @ [0.3, -0.2]
    best = lsq_linear(weight[:, None] * G, weight * (far - offset), (controller.low, controller.high), tol=1e-12)
    np.testing.assert_allclose(us[-1], best.x, atol=1e-4)
    np.testing.assert_allclose(ys[-1], G @ best.x + offset, atol=1e-3)


def test_limits_of_outputs_are_kept_where_they_can_be():
    controller = law(y_high=np.array([5.4, 9.0]))
    steep = free(y_high=np.array([np.inf, np.inf]))
    reference = lambda k: np.array([5.4, 1.0 + (k > 50)])  # noqa: E731
    _, kept, _ = run(controller, Plant(lpv()), reference, lambda k: 1.8, n=200)
    _, wild, _ = run(steep, Plant(lpv()), reference, lambda k: 1.8, n=200)
    assert wild[:, 0].max() > 5.41
    assert kept[:, 0].max() < 5.4 + 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_2000_steps_of_whatever_comes_each(seed):
    """Random set-points, limits, starts outside of them, gaps in the measurements: always a number, within limits and rates."""
    random = np.random.default_rng(seed)
    middle, width = random.uniform(-2.0, 2.0, 2), random.uniform(0.2, 3.0, 2)
    low, high = middle - width, middle + width
    above = random.uniform(4.0, 8.0, 2)
    controller = law(low=low, high=high, rate=random.uniform(0.5, 20.0, 2), y_low=above - [2.0, np.inf], y_high=above)
    plant, state, r, last = Plant(lpv(), x=random.normal(size=3)), controller.init(random.uniform(-6.0, 6.0, 2)), None, None
    last, seen = state.u, set()
    for k in range(2000):
        if k % 37 == 0:
            r = random.normal(size=2) * 10.0 ** random.uniform(-1.0, 3.0)
            plant.push = random.normal(size=2)
        rho = 1.5 + 0.7 * np.sin(0.01 * k)
        y = plant.measure(np.clip(rho, 1.0, 2.0)) + 0.1 * random.normal(size=2)
        if random.random() < 0.02:
            y = np.array([np.nan, y[1]])
        if random.random() < 0.01:
            rho = np.nan
        u, state = controller.step(state, r, y, rho)
        assert np.isfinite(u).all()
        way = controller.rate * DT
        assert (np.abs(u - last) <= way + 1e-12).all()
        assert (u >= np.minimum(low, last + way) - 1e-12).all()
        assert (u <= np.maximum(high, last - way) + 1e-12).all()
        plant.advance(u, np.clip(np.nan_to_num(rho, nan=1.5), 1.0, 2.0))
        last = u
        seen.add(state.status)
    assert Status.OPTIMAL in seen
    assert Status.FALLBACK not in seen


# ---- when solvers fail -------------------------------------------------------------------------------------------------------


def test_a_second_solver_then_the_last_plan_then_the_pid_and_back(monkeypatch):
    controller, plant, daqp, clarabel = law(horizon=5), Plant(lpv()), receding.solved_by_daqp, receding.solved_by_clarabel
    fails = {"daqp": set(range(10, 40)), "clarabel": set(range(20, 40))}
    now = {"k": 0}
    for used_in in (module, receding):
        monkeypatch.setattr(used_in, "solved_by_daqp", lambda p: None if now["k"] in fails["daqp"] else daqp(p))
    monkeypatch.setattr(receding, "solved_by_clarabel", lambda p: None if now["k"] in fails["clarabel"] else clarabel(p))
    state, us, how = controller.init(), [], []
    for k in range(60):
        now["k"] = k
        y = plant.measure(1.4)
        u, state = controller.step(state, np.array([5.5, 0.7]), y, 1.4)
        plant.advance(u, 1.4)
        us.append(u), how.append(state.status)
    times = ((Status.OPTIMAL, 10), (Status.SECOND_SOLVER, 10), (Status.LAST_PLAN, 4), (Status.FALLBACK, 16), (Status.OPTIMAL, 20))
    assert how == [status for status, n in times for _ in range(n)]
    us = np.array(us)
    assert np.isfinite(us).all()
    np.testing.assert_allclose(us[24], us[23], atol=1e-12)  # the PID takes over from the last command
    assert (np.abs(np.diff(us, axis=0)) <= controller.rate * DT + 1e-12).all()
    np.testing.assert_allclose(plant.measure(1.4), [5.5, 0.7], atol=0.05)


def test_an_answer_that_breaks_the_limits_is_not_believed():
    program = receding.Program(np.eye(1), np.array([-5.0]), np.empty((0, 1)), np.array([-1.0]), np.array([1.0]))
    assert receding.solved_by_daqp(program) == pytest.approx([1.0])
    assert receding._believed(program, np.array([1.1])) is None
    assert receding._believed(program, np.array([np.nan])) is None
    crossed = program._replace(lower=np.array([2.0]))
    assert receding.solved_by_daqp(crossed) is None
    assert receding.solved_by_clarabel(crossed) is None


def test_bad_designs_are_refused():
    with pytest.raises(InputError, match="horizon 0"):
        law(horizon=0)
    with pytest.raises(InputError, match="channel a: lower limit 5 is not below the upper 2"):
        law(low=np.array([5.0, 0.0]))
    with pytest.raises(InputError, match="channel d: lower limit 3 is not below"):
        law(y_low=np.array([0.0, 3.0]), y_high=np.array([1.0, 2.0]))
    with pytest.raises(InputError, match="no regulator at r2 = 1"):
        law(weights=Weights((0.0, 0.0), (1.0, 1.0), (0.0, 0.0)))
    swapped = pid(("b", "a"), NAMES[1], NAMES[2], DT, [0.1, 0.1], [0.1, 0.1])
    with pytest.raises(InputError, match="the fallback law goes from c, d to b, a"):
        design_mpc(lpv(), swapped)
    elsewhere = replace(law().fallback, schedule="arm", span=(0.0, 1.0))
    with pytest.raises(InputError, match="the fallback law is scheduled on arm, the model on r2"):
        design_mpc(lpv(), elsewhere)
