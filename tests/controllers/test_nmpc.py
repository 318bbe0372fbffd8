"""Nonlinear MPC: the plant at its samples, its filter, the optimal course against independent solvers, and what happens when
solvers fail."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import LinearConstraint, lsq_linear, minimize

from controllers import receding
from controllers.files import load_controller, save_controller
from controllers.nmpc import NMPC, Ipopt, RealTimeIteration, default_weights, design_nmpc
from controllers.pid import pid
from controllers.plant_observer import PlantObserver, SampledPlant
from controllers.receding import Status, Weights
from plants import WEB_WINDING, WELDING_ROBOT
from workbench.errors import InputError
from workbench.physics.controller import Playback
from workbench.simulation import Scenario, simulate


def flat(values) -> np.ndarray:
    """Numbers of CasADi in a row."""
    return np.array(values).ravel()


WINDING = ("V1", "V2"), ("w3", "theta"), ("w3_set", "theta_set")


def winding(**options) -> NMPC:
    fallback = pid(*WINDING, 0.04, [[0.0, -0.005], [0.01, 0.0]], [[0.0, -0.02], [0.05, 0.0]], low=(-1.0, 0.0), high=(5.0, 5.0))
    weights = Weights((2.4e-4, 8e-4), (0.1, 0.15), (0.0, 0.0))
    return design_nmpc(WEB_WINDING, fallback, **{"weights": weights, "rate": np.array([5.0, 4.0]), **options})


def robot(**options) -> NMPC:
    fallback = pid(("u",), ("v",), ("v_set",), 0.02, [0.5], [1.0], low=-10.0, high=10.0)
    return design_nmpc(WELDING_ROBOT, fallback, **{"weights": Weights((1.0,), (0.02,), (0.0,)), **options})


def somewhere(random) -> tuple[np.ndarray, np.ndarray]:
    """A state of the winding machine beside an equilibrium within the reel, and the inputs of that equilibrium."""
    x, u = WEB_WINDING.equilibrium(r2=random.uniform(0.012, 0.025), w3=random.uniform(60.0, 120.0))
    return x * (1.0 + 0.05 * random.normal(size=7) * [1, 1, 1, 1, 1, 0, 0]), u


# ---- the plant at its samples ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_sample_is_that_of_the_stepper():
    model, random = SampledPlant(WEB_WINDING, ("V2", "V1")), np.random.default_rng(1)
    for _ in range(3):
        x, u = somewhere(random)
        u = u + random.uniform(-0.5, 0.5, 2)
        start = dict(zip(WEB_WINDING.state_names, x, strict=True))
        scenario = Scenario("held", {name: np.full(3, v) for name, v in zip(("V1", "V2"), u, strict=True)}, start=start)
        once = flat(model.step(x, u[::-1]))
        for substeps, near in ((model.substeps, 1e-10), (80, 5e-3)):
            run = simulate(WEB_WINDING, Playback(("V1", "V2"), 0.04), scenario, substeps=substeps)
            np.testing.assert_allclose(once, run.states.values[1], rtol=near)
        y, _ = model.seen(x)
        np.testing.assert_allclose(flat(y), run.experiment.values[0, 2:], rtol=1e-12)


def test_jacobians_are_the_slopes_of_what_they_belong_to():
    model, random = SampledPlant(WEB_WINDING, ("V1", "V2")), np.random.default_rng(2)
    x, u = somewhere(random)
    _, A, B = (np.array(a) for a in model.linear(x, u))
    C = np.array(model.seen(x)[1])
    for i in range(7):
        h = 1e-5 * max(abs(x[i]), 1e-3) * np.eye(7)[i]
        slope = (np.array(model.step(x + h, u)) - np.array(model.step(x - h, u))).ravel() / (2 * h[i])
        np.testing.assert_allclose(A[:, i], slope, rtol=1e-5, atol=1e-6 * np.abs(A[:, i]).max())
        slope = (np.array(model.seen(x + h)[0]) - np.array(model.seen(x - h)[0])).ravel() / (2 * h[i])
        np.testing.assert_allclose(C[:, i], slope, rtol=1e-6, atol=1e-9)
    for i in range(2):
        h = 1e-4 * np.eye(2)[i]
        slope = (np.array(model.step(x, u + h)) - np.array(model.step(x, u - h))).ravel() / 2e-4
        np.testing.assert_allclose(B[:, i], slope, rtol=1e-6, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("plant", [WEB_WINDING, WELDING_ROBOT], ids=lambda plant: plant.name)
def test_what_the_equation_alone_does_not_say_is_refused(plant):
    """Every effect on its own: what needs a memory, an angle, the time or another input is refused by name, the rest is not."""
    needs_more = {
        "imbalance", "torque-ripple", "friction-jump", "eccentricity", "viscoelastic", "periodic-tension", "stiffness-jump",
        "arm-gravity", "platform-mass", "arm-reaction",
    }  # fmt: skip
    seen = set()
    for slot in plant.slots:
        if slot.parameter.shape or slot.key in seen:
            continue
        seen.add(slot.key)
        size = min(0.1, 0.5 * slot.parameter.high) if slot.parameter.high > 0.0 else -0.1
        own = replace(plant, effects={slot.key: {slot.parameter.name: size}})
        foreign = slot.effect.id in needs_more or slot.effect.family in ("actuator", "sensor")
        if slot.key == "platform-mass@rail":
            foreign = False  # its change alone is a mass; its swing is another size
        if foreign:
            with pytest.raises(InputError, match=slot.key):
                SampledPlant(own, plant.commanded)
        else:
            assert SampledPlant(own, plant.commanded).unpredicted == []
    assert len(seen) > 20


def test_a_swing_of_the_mass_with_the_arm_is_refused():
    with pytest.raises(InputError, match="platform-mass@rail"):
        SampledPlant(replace(WELDING_ROBOT, effects={"platform-mass@rail": {"swing": 0.3}}), ("u",))


def winding_of(plant) -> NMPC:
    own = winding()
    return design_nmpc(plant, own.fallback, weights=own.weights)


def test_friction_of_an_extended_plant_is_in_the_prediction():
    plant = replace(WEB_WINDING, effects={"coulomb@unwind": {"level": 0.002}})
    bare, rubbing = SampledPlant(WEB_WINDING, ("V1", "V2")), SampledPlant(plant, ("V1", "V2"))
    x, u = WEB_WINDING.equilibrium()
    J1 = WEB_WINDING.nominal[[q.name for q in WEB_WINDING.parameters].index("J0")]
    assert flat(rubbing.step(x, u))[0] - flat(bare.step(x, u))[0] < -0.1 * 0.04 * 0.002 / (20 * J1)


# ---- the filter --------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_filter_of_a_linear_plant_settles_at_the_riccati_solution():
    observer = PlantObserver(SampledPlant(WELDING_ROBOT, ("u",)))
    p = dict(zip((q.name for q in WELDING_ROBOT.parameters), WELDING_ROBOT.nominal, strict=True))
    F = np.array([[-(p["b1"] + p["c"]) / p["m1"], p["c"] / p["m1"]], [p["c"] / p["m2"], -(p["c"] + p["b2"]) / p["m2"]]])
    whole = np.zeros((3, 3))
    whole[:2, :2], whole[0, 2] = F, 1.0 / p["m1"]
    A = expm(0.02 * whole)  # d stands at the input
    belief, u = observer.first(np.zeros(1)), np.zeros(1)
    for _ in range(3000):
        belief = observer.moved(observer.corrected(belief, np.zeros(1)), u)
    H, R = np.array([[1.0, 0.0, 0.0]]), np.array([[0.002**2]])
    P = solve_discrete_are(A.T, H.T, observer._wander, R)
    np.testing.assert_allclose(belief.P, P, rtol=1e-4, atol=1e-12)
    # d wanders by 0.3 of what, held for a second, moves v by the noise; x by 0.3 of the noise
    gain = sum(np.linalg.matrix_power(A[:2, :2], k) @ A[:2, 2:] for k in range(50))[0, 0]
    np.testing.assert_allclose(np.sqrt(np.diag(observer._wander)), [6e-4, 0.0, 6e-4 / gain], rtol=1e-6)


def test_the_filter_finds_a_wrong_start_and_an_unlogged_push():
    observer = PlantObserver(SampledPlant(WEB_WINDING, ("V1", "V2")))
    x, u = WEB_WINDING.equilibrium(r2=0.015, r1=0.024)
    random, push = np.random.default_rng(3), np.array([0.1, -0.05])
    noise = np.array([WEB_WINDING.noise[name] for name in WEB_WINDING.output_names])
    y = lambda: np.array(WEB_WINDING.output(x)) + noise * random.normal(size=5)  # noqa: E731
    belief = observer.first(y())
    assert belief.z[6] == pytest.approx(0.015, abs=3e-5)  # r2 is measured; r1 is not, and starts at the full reel
    assert belief.z[5] == pytest.approx(0.0264)
    for k in range(400):
        seen = y()
        if k % 7 == 0:
            seen[k % 5] = np.nan
        belief = observer.moved(observer.corrected(belief, seen), u)
        x = flat(observer.model.step(x, u + push))
    sigma = np.sqrt(np.diag(belief.P))
    error = belief.z - np.concatenate([x, push])
    assert (np.abs(error) < 4.0 * sigma).all()
    assert np.abs(error[5]) < 3e-4  # of 2.4e-3 at the start
    assert (np.abs(error[7:]) < 0.02).all()


def test_what_is_not_measured_corrects_nothing():
    observer = PlantObserver(SampledPlant(WEB_WINDING, ("V1", "V2")))
    belief = observer.first(np.full(5, np.nan))
    np.testing.assert_array_equal(belief.z[:7], WEB_WINDING.equilibrium()[0])
    assert observer.corrected(belief, np.full(5, np.nan)) is belief
    other = observer.corrected(belief, np.array([np.nan, np.nan, 101.0, np.nan, np.nan]))
    assert 100.0 < other.z[2] <= 101.0
    assert (np.linalg.eigvalsh(other.P) > -1e-12).all()


# ---- the optimal course ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_many_gauss_newton_steps_arrive_where_ipopt_does():
    limits = {"y_low": np.array([95.0, -5.0]), "y_high": np.array([110.0, 5.0]), "horizon": 15}
    ours, theirs = winding(**limits, solver=RealTimeIteration(8)), winding(**limits, solver=Ipopt())
    random, active = np.random.default_rng(4), set()
    for _ in range(5):
        (x, u), d = somewhere(random), 0.1 * random.normal(size=2)
        last, r = u + 0.3 * random.normal(size=2), random.normal(size=(15, 2)) * [10.0, 3.0] + [100.0, 0.0]
        state = ours.init(last)
        one, status = ours._planned(state, x, d, r)
        other, second = theirs._planned(state, x, d, r)
        np.testing.assert_allclose(one, other, atol=5e-5)
        assert (status, second) == (Status.OPTIMAL, Status.OPTIMAL)
        active |= {"rate"} if (np.abs(np.diff(one, axis=0)) > ours.rate * 0.04 - 1e-6).any() else set()
        active |= {"limit"} if ((one < ours.low + 1e-6) | (one > ours.high - 1e-6)).any() else set()
        y = [WEB_WINDING.output(x)]
        for v in one:
            x = flat(ours.observer.model.step(x, v + d))
            y.append(WEB_WINDING.output(x))
        beyond = np.array(y)[1:, 2:4]
        active |= {"output"} if ((beyond < ours.y_low + 1e-4) | (beyond > ours.y_high - 1e-4)).any() else set()
    assert {"rate", "output"} <= active


@pytest.mark.slow
def test_the_optimal_course_is_that_of_scipy_on_the_simulated_plant():
    """The cost as stated, from runs of the stepper; a solver that knows nothing of it but its value."""
    N, random = 4, np.random.default_rng(5)
    law = winding(horizon=N, solver=RealTimeIteration(10), weights=Weights((0.01, 0.02), (0.5, 0.4), (0.0, 0.0)))
    substeps = law.observer.model.substeps
    (x, u), d = somewhere(random), np.array([0.05, -0.02])
    last, r = u + np.array([0.05, -0.05]), np.array([[200.0, 50.0], [97.0, 1.0], [99.0, -1.0], [101.0, 0.5]])
    ahead = np.vstack([r, r[-1:]])[1:]
    start = dict(zip(WEB_WINDING.state_names, x, strict=True))

    def cost(flat):
        plan = flat.reshape(N, 2)
        held = np.vstack([plan, plan[-1:]])  # the last sample shows y_N
        scenario = Scenario("p", {"V1": held[:, 0], "V2": held[:, 1]}, start=start, disturbance={})
        pushed = replace(scenario, disturbance={"V1": np.full(N + 1, d[0]), "V2": np.full(N + 1, d[1])})
        y = simulate(WEB_WINDING, Playback(("V1", "V2"), 0.04), pushed, substeps=substeps).experiment
        e = np.column_stack([y["w3"], y["theta"]])[1:] - ahead
        return 0.5 * np.sum(law.weights.outputs * e**2) + 0.5 * np.sum(
            law.weights.moves * np.diff(plan, axis=0, prepend=[last]) ** 2
        )

    ours, _ = law._planned(law.init(last), x, d, r)
    D = np.kron(np.eye(N) - np.eye(N, k=-1), np.eye(2))
    moves = LinearConstraint(D, *(s * np.tile(law.rate * 0.04, N) + np.concatenate([last, np.zeros(2 * N - 2)]) for s in (-1, 1)))
    found = minimize(cost, np.tile(last, N), method="SLSQP", constraints=moves, options={"ftol": 1e-13, "maxiter": 300})
    assert cost(ours.ravel()) <= found.fun + 1e-8
    np.testing.assert_allclose(ours.ravel(), found.x, atol=2e-3)


def test_on_a_linear_plant_one_step_is_the_least_squares_solution():
    N, law = 12, robot(horizon=12)
    model = law.observer.model
    A, B = (np.array(a) for a in model.linear(np.zeros(2), np.zeros(1))[1:])
    x, d, last, r = np.array([0.3, -0.2]), np.array([0.4]), np.array([1.0]), np.full((N, 1), 0.8)
    G, free = np.zeros((N, N)), np.empty(N)
    for i in range(N):
        free[i] = (np.linalg.matrix_power(A, i + 1) @ x + sum(np.linalg.matrix_power(A, k) @ B @ d for k in range(i + 1)))[0]
        G[i, : i + 1] = [(np.linalg.matrix_power(A, i - j) @ B)[0, 0] for j in range(i + 1)]
    D, first = np.eye(N) - np.eye(N, k=-1), np.eye(N)[0] * last
    rows, wanted = np.vstack([G, np.sqrt(0.02) * D]), np.concatenate([0.8 - free, np.sqrt(0.02) * first])
    expected = lsq_linear(rows, wanted, (-10.0, 10.0), tol=1e-14).x
    found, _ = law._newton(last, x, d, r, np.zeros((N, 1)))
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-6)


# ---- in the loop -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_no_offset_under_a_push_it_does_not_know_and_a_wrong_parameter():
    law, N = winding(), 200
    references = {"w3_set": np.full(N, 95.0), "theta_set": np.full(N, 2.0)}
    scenario = Scenario("push", references, disturbance={"V1": np.full(N, 0.1), "V2": np.full(N, -0.15)})
    run = simulate(WEB_WINDING, law, scenario, parameters={"kT": 0.021, "B1": 2.5e-5}).experiment
    assert np.abs(run["w3"][-50:] - 95.0).max() < 0.05
    assert np.abs(run["theta"][-50:] - 2.0).max() < 0.05


@pytest.mark.slow
def test_random_set_points_limits_and_missing_measurements_never_break_it():
    law, random, N = (
        winding(y_low=np.array([80.0, -10.0]), y_high=np.array([115.0, 10.0]), horizon=10),
        np.random.default_rng(6),
        250,
    )
    state, x = law.init(np.array([-2.0, 6.0])), WEB_WINDING.equilibrium()[0]  # both beyond their limits
    at, last, counted = [WEB_WINDING.output_names.index(name) for name in law.measured], np.array([-2.0, 6.0]), set()
    for k in range(N):
        if k % 25 == 0:
            r = random.uniform((40.0, -30.0), (160.0, 30.0))
        y = np.array(WEB_WINDING.output(x))[at] + random.normal(size=5) * [0.3, 0.2, 0.2, 0.2, 5e-6]
        y[random.uniform(size=5) < 0.1] = np.nan
        u, state = law.step(state, np.where(random.uniform(size=2) < 0.02, np.nan, r), y)
        assert np.isfinite(u).all()
        assert (np.abs(u - last) <= law.rate * 0.04 + 1e-9).all()
        if k > 60:
            assert ((u >= law.low - 1e-9) & (u <= law.high + 1e-9)).all()
        counted.add(state.status)
        x, last = flat(law.observer.model.step(x, u)), u
    assert Status.OPTIMAL in counted
    assert Status.FALLBACK not in counted


@pytest.mark.parametrize("solver", [RealTimeIteration(), Ipopt()])
def test_a_second_solver_then_the_last_plan_then_the_pid_and_back(monkeypatch, solver):
    law, now = robot(horizon=4, solver=solver), {"k": 0}
    first, second, program = receding.solved_by_daqp, receding.solved_by_clarabel, NMPC._by_ipopt
    fails = {"first": range(5, 20), "second": range(10, 20)}
    monkeypatch.setattr(NMPC, "_by_ipopt", lambda self, *a: None if now["k"] in fails["first"] else program(self, *a))
    if isinstance(solver, RealTimeIteration):
        monkeypatch.setattr(receding, "solved_by_daqp", lambda p: None if now["k"] in fails["first"] else first(p))
    else:
        monkeypatch.setattr(receding, "solved_by_daqp", lambda p: None if now["k"] in fails["second"] else first(p))
    monkeypatch.setattr(receding, "solved_by_clarabel", lambda p: None if now["k"] in fails["second"] else second(p))
    state, x, how = law.init(), np.zeros(2), []
    for k in range(25):
        now["k"] = k
        u, state = law.step(state, np.array([1.0]), x[:1])
        x = flat(law.observer.model.step(x, u))
        how.append(state.status)
    times = ((Status.OPTIMAL, 5), (Status.SECOND_SOLVER, 5), (Status.LAST_PLAN, 3), (Status.FALLBACK, 7), (Status.OPTIMAL, 5))
    assert how == [status for status, n in times for _ in range(n)]


# ---- files and refusals ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_it_comes_back_from_its_file_as_it_went(tmp_path):
    plant = replace(WEB_WINDING, effects={"coulomb@unwind": {"level": 0.002}})
    own = winding()
    law = design_nmpc(plant, own.fallback, weights=own.weights, solver=Ipopt(1e-9, 50), y_high=np.array([120.0, np.inf]))
    path = save_controller(law, tmp_path / "n.json")
    back = load_controller(path, {"web-winding": WEB_WINDING}.__getitem__)
    assert json.dumps(back.to_dict(), default=list) == json.dumps(law.to_dict(), default=list)
    assert (vars(back.solver), back.plant.effects) == ({"tolerance": 1e-9, "iterations": 50}, plant.effects)
    assert back.y_high.tolist() == [120.0, np.inf]
    state, again = law.init(), back.init()
    for y in ([99.0, 0.5, 40.0, 90.0, 0.0111], [99.5, 0.2, 40.0, 90.0, 0.0111]):
        one, state = law.step(state, np.array([100.0, 0.0]), np.array(y))
        other, again = back.step(again, np.array([100.0, 0.0]), np.array(y))
        np.testing.assert_array_equal(one, other)
    with pytest.raises(InputError, match="predicts with the plant web-winding"):
        load_controller(path)


def test_what_it_refuses(tmp_path):
    own = winding()
    for change, message in (
        ({"horizon": 0}, "horizon 0"),
        ({"low": np.array([6.0, 0.0])}, "not below the upper"),
        ({"y_low": np.array([0.0, 3.0]), "y_high": np.array([1.0, 2.0])}, "not below the upper"),
        ({"solver": RealTimeIteration(0)}, "0 steps a sample"),
    ):
        with pytest.raises(InputError, match=message):
            winding(**change)
    with pytest.raises(InputError, match=r"every 0\.02 s, this one every 0\.04 s"):
        design_nmpc(WEB_WINDING, replace(own.fallback, dt=0.02), weights=own.weights)
    with pytest.raises(InputError, match="unknown input 'V3'"):
        design_nmpc(WEB_WINDING, replace(own.fallback, actuated=("V1", "V3")), weights=own.weights)
    with pytest.raises(InputError, match="unknown schedule of the fallback law"):
        design_nmpc(WEB_WINDING, replace(own.fallback, schedule="r9", span=np.array([0.0, 1.0])), weights=own.weights)


def test_default_weights_count_outputs_in_what_inputs_move():
    model = SampledPlant(WELDING_ROBOT, ("u",))
    scenario = Scenario("step", {"u": np.ones(31)})
    moved = simulate(WELDING_ROBOT, Playback(("u",), 0.02), scenario).states["v1"][30]
    assert default_weights(model, ("v",), 30).outputs == pytest.approx([1.0 / moved**2], rel=1e-4)
