"""What laws that plan ahead do when no solver answers, and what a limit that is not kept costs them."""

import numpy as np
import pytest

from controllers import mpc as module
from controllers import receding
from controllers.along import Along
from controllers.mpc import MPC, Held, design_mpc
from controllers.pid import pid
from controllers.receding import Status, Weights
from tests.controllers.test_mpc import DT, NAMES, Plant, law, lpv, stated_in_cvxpy

R = np.array([5.5, 0.7])


@pytest.fixture
def solvers(monkeypatch):
    """`solvers["work"] = False` and no solver answers any more."""
    now = {"work": True}
    for name in ("solved_by_daqp", "solved_by_clarabel"):
        own = getattr(receding, name)
        monkeypatch.setattr(receding, name, lambda program, own=own: own(program) if now["work"] else None)
    monkeypatch.setattr(module, "solved_by_daqp", receding.solved_by_daqp)
    return now


def played(controller, plant, solvers, works, gaps=()):
    """Commands, states after them and measurements; no solver answers where `works` is false."""
    state, us, states, ys = controller.init(), [], [], []
    for k, solvers["work"] in enumerate(works):
        y = plant.measure(1.4)
        if k in gaps:
            y[gaps[k]] = np.nan
        u, state = controller.step(state, R, y, 1.4)
        plant.advance(u, 1.4)
        us.append(u), states.append(state), ys.append(y)
    return us, states, ys


def test_the_last_plan_is_played_sample_by_sample(solvers):
    us, states, _ = played(law(horizon=6), Plant(lpv()), solvers, [True] * 3 + [False] * 5)
    plan = states[2].plan.commands
    assert len(np.unique(plan, axis=0)) == 6  # every sample of it is another
    assert [s.status for s in states[3:]] == [Status.LAST_PLAN] * 5
    assert [s.plan.age for s in states[2:]] == list(range(6))
    np.testing.assert_array_equal(us[2:], plan)


LOW, HIGH, RATE = np.array([-1.0, -0.8]), np.array([0.9, 1.1]), np.array([2.0, 3.0])


def narrow() -> MPC:
    """A planner with narrower limits and lower rates than its fallback law, which soon wants to go far."""
    wide = pid(*NAMES, DT, [0.1, 0.1], [9.0, 9.0], low=-1e6, high=1e6)
    return design_mpc(lpv(), wide, weights=Weights((1.0, 2.0), (0.3, 0.2), (0.0, 0.0)), low=LOW, high=HIGH, rate=RATE)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("start", [0.0, 2.5, -2.5])
def test_the_fallback_law_keeps_the_limits_and_rates_of_the_planner(solvers, sign, start):
    controller, solvers["work"], way, y = narrow(), False, RATE * DT, np.array([5.0, 1.0])
    last = np.full(2, start)
    state = controller.init(last)
    for _ in range(80):
        u, state = controller.step(state, y + sign * 1e3, y, 1.4)
        assert state.status is Status.FALLBACK
        assert (np.abs(u - last) <= way + 1e-12).all()
        assert (u >= np.minimum(LOW, last + way) - 1e-12).all()  # from beyond, back as fast as it may
        assert (u <= np.maximum(HIGH, last - way) + 1e-12).all()
        last = u


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_fallback_law_leaves_a_limit_of_the_planner_when_the_error_turns(solvers, sign):
    """Its integral has not gone on while the planner's limit held it."""
    controller, solvers["work"], y = narrow(), False, np.array([5.0, 1.0])
    state = controller.init(np.zeros(2))
    for _ in range(80):
        u, state = controller.step(state, y + sign * 1e3, y, 1.4)
    np.testing.assert_allclose(u, HIGH if sign > 0 else LOW, rtol=0, atol=1e-9)
    for k in range(5):
        u, state = controller.step(state, y - sign * (1e3 + 50.0 * k), y, 1.4)
    assert (sign * ((HIGH if sign > 0 else LOW) - u) > 0.5 * RATE * DT).all()


@pytest.mark.parametrize("start", [0.0, 2.5, -2.5])
def test_the_fallback_law_goes_on_as_fast_as_the_planner_lets_it(solvers, start):
    """It takes over from the last command, comes back from beyond its limits, and then goes the whole way at the full rate."""
    controller, solvers["work"], y = narrow(), False, np.array([5.0, 1.0])
    for sign, goal in ((1.0, HIGH), (-1.0, LOW)):
        state, way = controller.init(np.full(2, start)), np.abs(goal - start) / (RATE * DT)
        for _ in range(int(np.ceil(way.max())) + 3):
            u, state = controller.step(state, y + sign * np.array([3.0, 2.7]), y, 1.4)
        np.testing.assert_allclose(u, goal, rtol=0, atol=1e-12)


def test_the_fallback_law_runs_on_until_a_solver_answers_and_starts_anew_after_that(solvers):
    """Beside it the same PID; what is not measured is where it should be."""
    controller = law(horizon=2, prediction=Held())
    works = [True] * 2 + [False] * 9 + [True] * 2 + [False] * 6
    gaps = {5: 0, 6: [0, 1], 15: 1}
    us, states, ys = played(controller, Plant(lpv(), push=(0.3, -0.2)), solvers, works, gaps)
    assert [s.status is Status.FALLBACK for s in states] == [k in (*range(3, 11), *range(14, 19)) for k in range(19)]
    for phase in (range(3, 11), range(14, 19)):
        memory = controller.fallback.init(us[phase[0] - 1])
        for k in phase:
            y = np.where(np.isnan(ys[k]), R, ys[k])
            u, memory = controller.fallback.step(memory, R, y, 1.4)
            np.testing.assert_allclose(us[k], u, rtol=0, atol=1e-12)
        assert (np.abs(us[phase[-1]] - us[phase[0]]) > 1e-3).all()  # its integral has run
    assert states[12].plan.law is None


@pytest.mark.parametrize(
    ("outputs", "z"), [((0.25, 9.0), (-0.46, 0.58, 1.47, 0.61, 1.22)), ((4.0, 0.1), (-0.39, -0.71, 1.35, -1.43, 0.38))]
)
def test_a_violated_output_limit_costs_what_is_said(outputs, z):
    """Both outputs are on their way out; at these prices neither gives way wholly."""
    weights = Weights(outputs, (0.3, 0.2), (0.0, 0.0), violation=1.5)
    controller = law(horizon=8, weights=weights, y_low=np.array([4.9, -9.0]), y_high=np.array([9.0, 1.2]), prediction=Held())
    z, last, r = np.array(z), np.array([0.2, 0.3]), np.array([4.5, 1.6])
    path, state = controller._path(1.3, 0.0), controller.init(last)
    program = controller._program(last, Along(controller, path), z, np.tile(r, (9, 1)))
    slack = receding.solved_by_daqp(program)[16:]
    assert (slack > 0.05).all()
    plan, status = controller._solved(program)
    assert status is Status.OPTIMAL
    np.testing.assert_allclose(plan, stated_in_cvxpy(controller, state, z, r, path), atol=2e-5)


@pytest.mark.parametrize("answer", [np.inf, -np.inf, np.nan])
def test_an_answer_that_is_no_number_is_not_believed_where_there_is_no_limit(answer):
    far = np.full(2, np.inf)
    program = receding.Program(np.eye(2), np.zeros(2), np.empty((0, 2)), -far, far)
    assert receding._believed(program, np.array([0.0, answer])) is None
    assert receding._believed(program, np.array([0.0, 1.0])) is not None
