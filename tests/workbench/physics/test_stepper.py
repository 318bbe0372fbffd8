"""The compiled stepper against independent integrators and against what each effect must do."""

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plants import POSITIONING_AXIS, WEB_WINDING, WELDING_ROBOT
from studies.experiments import plan, web_winding_loops
from workbench.data import Channel
from workbench.errors import InputError
from workbench.physics import kernel
from workbench.physics.controller import Playback
from workbench.physics.effects.shaft import Shaft
from workbench.physics.plant import Plant
from workbench.simulation import Scenario, replay, simulate, simulate_batch

LOOPS = web_winding_loops()


def steps(samples=60, seed=None):
    k = np.arange(samples)
    speed, angle = 100 + 10.0 * np.sign(np.sin(k / 7)), 2.0 * np.sign(np.cos(k / 5))
    return Scenario("steps", {"w3_set": speed, "theta_set": angle}, seed=seed)


def reference_loop(scenario, effects=None, **tolerances):
    """The same loop by solve_ivp sample by sample, with the PI laws of the reference machine written out here."""
    plant, eta = WEB_WINDING, WEB_WINDING.effect_vector(effects)
    x, u0 = plant.equilibrium()
    full = np.concatenate([x, np.zeros(len(plant.turning))])
    integral_w = integral_t = 0.0
    states = []
    for k in range(len(scenario)):
        states.append(full[: len(x)])
        y = dict(zip(plant.output_names, plant.output(full[: len(x)]), strict=True))
        e_w = scenario.references["w3_set"][k] - y["w3"]
        e_t = scenario.references["theta_set"][k] - y["theta"]
        u = [u0[0] - 0.005 * e_t - 0.02 * integral_t, u0[1] + 0.01 * e_w + 0.05 * integral_w]
        integral_w, integral_t = integral_w + 0.04 * e_w, integral_t + 0.04 * e_t

        def rate(t, z, u=u):
            rates = plant.derivative(z[:7], plant.drive(u, eta, t), eta=eta, t=t, angle=z[7:])
            return [*rates, z[0], z[1], z[2]]

        full = solve_ivp(rate, (k * 0.04, (k + 1) * 0.04), full, method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    return np.array(states)


def relative(states, truth):
    return np.abs(states - truth).max(axis=0) / np.abs(truth).max(axis=0)


@pytest.mark.slow
def test_closed_loop_equals_solve_ivp_with_the_loops_of_the_reference_file():
    scenario = steps()
    run = simulate(WEB_WINDING, LOOPS, scenario)
    assert relative(run.states.values, reference_loop(scenario)).max() < 1e-4


@pytest.mark.slow
def test_closed_loop_with_effects_equals_solve_ivp():
    scenario = steps()
    effects = {
        "coulomb@rewind": {"level": 0.002},
        "eccentricity@unwind": {"cosine": 2e-4, "sine": -1e-4},
        "slip@pulley": {"creep": 0.05},
        "saturation@V2": {"limit": 2.4},
    }
    run = simulate(WEB_WINDING, LOOPS, scenario, effects=effects)
    nominal = simulate(WEB_WINDING, LOOPS, scenario)
    assert relative(run.states.values, reference_loop(scenario, effects)).max() < 1e-4
    assert relative(run.states.values, nominal.states.values).max() > 1e-2


@pytest.mark.slow
def test_integrator_has_order_four():
    truth = reference_loop(steps(25))
    error = [relative(simulate(WEB_WINDING, LOOPS, steps(25), substeps=m).states.values, truth).max() for m in (20, 40, 80)]
    order = np.log2(np.array(error[:-1]) / error[1:])
    assert np.all(order > 3.7)
    assert np.all(order < 4.6)


def test_batch_equals_single_runs_to_the_last_bit():
    scenarios = [steps(40, seed) for seed in range(19)]
    random = np.random.default_rng(0)
    parameters = WEB_WINDING.nominal * random.uniform(0.9, 1.1, (19, len(WEB_WINDING.nominal)))
    names = [p.name for p in WEB_WINDING.parameters]
    batch = simulate_batch(WEB_WINDING, LOOPS, scenarios, parameters=parameters, substeps=10, threads=2)
    for i in (0, 7, 16, 18):
        changed = dict(zip(names, parameters[i], strict=True))
        run = simulate(WEB_WINDING, LOOPS, scenarios[i], parameters=changed, substeps=10)
        assert np.array_equal(batch.states[i], run.states.values)
        assert np.array_equal(batch.measured[i], run.experiment[list(WEB_WINDING.output_names)])


def test_switching_effects_on_compiles_nothing(monkeypatch):
    simulate(WEB_WINDING, LOOPS, steps(5))
    monkeypatch.setattr(kernel, "write_text", lambda *_: pytest.fail("a kernel was written"))
    simulate(WEB_WINDING, LOOPS, steps(5), effects={"coulomb@unwind": {"level": 0.001}, "input-delay@V1": {"time": 0.013}})
    simulate(WEB_WINDING, replace(LOOPS, Kp=2 * LOOPS.Kp), steps(5))


def test_a_neutral_run_beside_affected_ones_is_the_neutral_run():
    """Nominal runs leave out the effects' code, a block with an affected run does not: same numbers to the last bit."""
    eta = np.repeat(WEB_WINDING.effect_vector()[None], 3, axis=0)
    eta[1] = WEB_WINDING.effect_vector({
        "coulomb@unwind": {"level": 1e-3}, "eccentricity@rewind": {"cosine": 1e-4}, "slip@pulley": {"creep": 0.05},
        "sensor-lag@theta": {"time": 0.02}, "backlash@w3": {"half_width": 0.1}, "saturation@V2": {"limit": 2.2},
    })  # fmt: skip
    batch = simulate_batch(WEB_WINDING, LOOPS, steps(60, seed=2), effects=eta, substeps=10)
    alone = simulate(WEB_WINDING, LOOPS, steps(60, seed=2), substeps=10)
    assert np.array_equal(batch.states[0], alone.states.values)
    assert np.array_equal(batch.measured[2], alone.experiment[list(WEB_WINDING.output_names)])
    assert not np.array_equal(batch.states[1], batch.states[0])


def robot_run(u, **effects):
    scenario = Scenario("u", {"u": u})
    sizes = {key.replace("_at_", "@").replace("_", "-"): value for key, value in effects.items()}
    return simulate(WELDING_ROBOT, Playback(("u",), 0.02), scenario, effects=sizes)


INPUT = np.random.default_rng(4).normal(0, 2, 200).round(3)


def test_saturation_equals_clipping_the_command():
    limited = robot_run(INPUT, saturation_at_u={"limit": 1.5})
    assert np.array_equal(limited.states.values, robot_run(np.clip(INPUT, -1.5, 1.5)).states.values)
    assert np.array_equal(limited.experiment["u"], INPUT)  # the log keeps the command


@pytest.mark.parametrize("samples", [1, 3])
def test_delay_of_whole_samples_shifts_the_command(samples):
    delayed = robot_run(INPUT, input_delay_at_u={"time": samples * 0.02})
    shifted = np.concatenate([np.zeros(samples), INPUT[:-samples]])
    np.testing.assert_allclose(delayed.states.values, robot_run(shifted).states.values, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("delay", [0.0031, 0.0249, 0.0577])
def test_fractional_delay_is_exact(delay):
    """Against the matrix exponential over the two parts of every hold: no integrator error is allowed to hide here."""
    from scipy.linalg import expm

    A, B, _, _ = WELDING_ROBOT.linearize([0.0, 0.0], [0.0, 0.0])

    def advance(x, u, h):
        block = np.zeros((3, 3))
        block[:2, :2], block[:2, 2:] = A * h, B[:, :1] * h
        return (expm(block) @ np.concatenate([x, [u]]))[:2]

    whole, rest = int(delay // 0.02), delay % 0.02
    command = np.concatenate([np.zeros(whole + 1), INPUT])
    x, truth = np.zeros(2), []
    for k in range(len(INPUT)):
        truth.append(x)
        x = advance(advance(x, command[k], rest), command[k + 1], 0.02 - rest)
    run = robot_run(INPUT, input_delay_at_u={"time": delay})
    # Runge-Kutta at 10 steps a sample leaves some 1e-9 here; a switch on the wrong side of one step leaves 1e-2
    np.testing.assert_allclose(run.states.values, truth, atol=2e-8)


@pytest.mark.parametrize("delay", [0.02 * 200, 0.02 * 200 + 0.013, 1e3, 1e9, 1e300])
def test_what_is_later_than_the_run_never_arrives(delay):
    """A fit may try any dead time: it costs no memory, and what was held before goes on."""
    late = robot_run(INPUT, input_delay_at_u={"time": delay}).states.values
    assert np.array_equal(late, robot_run(np.zeros(200)).states.values)


def test_sensor_lag_solves_its_differential_equation():
    tau, run = 0.05, robot_run(INPUT, sensor_lag_at_v={"time": 0.05})
    A, B, C, _ = WELDING_ROBOT.linearize([0.0, 0.0], [0.0, 0.0])
    full_A = np.block([[A, np.zeros((2, 1))], [C / tau, -np.ones((1, 1)) / tau]])

    def rate(t, z, u):
        return full_A @ z + np.append(B[:, 0] * u, 0.0)

    z, truth = np.zeros(3), []
    for u in INPUT:
        truth.append(z[2])
        z = solve_ivp(rate, (0, 0.02), z, args=(u,), rtol=1e-9, atol=1e-12).y[:, -1]
    error = np.abs(run.experiment["v"] - truth).max() / np.abs(truth).max()
    assert error < 1e-9  # halving the step divides it by sixteen: test_effect_laws


def test_backlash_is_the_play_operator_and_symmetric():
    width, run = 0.05, robot_run(INPUT, backlash_at_v={"half_width": 0.05})
    truth, logged = run.states["v1"], run.experiment["v"]
    assert np.all(np.abs(logged - truth) <= width + 1e-12)
    moved = np.diff(logged) != 0
    # wherever the sensor moved it stands at one edge of the play
    assert np.allclose(np.abs(logged - truth)[1:][moved], width, atol=2e-3 * width)
    assert moved.mean() > 0.2
    assert (~moved).sum() > 10
    mirrored = robot_run(-INPUT, backlash_at_v={"half_width": 0.05})
    np.testing.assert_allclose(mirrored.experiment["v"], -logged, atol=1e-15)


def test_coulomb_friction_only_takes_energy_and_holds_a_small_force():
    level = {"level": 5.0, "width": 0.001}
    t = np.arange(2000) * 0.001
    push = simulate(
        POSITIONING_AXIS,
        Playback(("F",), 0.001),
        Scenario("push", {"F": np.where(t < 1, 4.0, 0.0)}),
        effects={"coulomb@slide": level},
    )
    free = simulate(POSITIONING_AXIS, Playback(("F",), 0.001), Scenario("push", {"F": np.where(t < 1, 4.0, 0.0)}))
    # 4 N against 5 N of dry friction: the slide creeps with the smoothed law, F = level tanh(v/width) + Fv v
    assert free.states["v"].max() > 10 * push.states["v"].max()
    v = push.states["v"][990]
    assert 5.0 * np.tanh(v / 0.001) + 200 * v == pytest.approx(4.0, rel=1e-2)
    assert np.all(np.diff(push.states["v"][1001:]) <= 1e-15)


def test_noise_has_the_stated_deviation_and_follows_the_seed():
    runs = [simulate(WEB_WINDING, LOOPS, steps(2000, seed)) for seed in (5, 5, 6)]
    assert np.array_equal(runs[0].experiment.values, runs[1].experiment.values)
    assert not np.array_equal(runs[0].experiment.values, runs[2].experiment.values)
    for name, std in WEB_WINDING.noise.items():
        truth = runs[0].states[name] if name != "theta" else (runs[0].states["T1"] - 0.30) / 0.01
        assert np.std(runs[0].experiment[name] - truth) == pytest.approx(std, rel=0.08)


def test_replaying_the_inputs_of_a_run_gives_its_outputs():
    run = simulate(WEB_WINDING, LOOPS, steps(200))
    again = replay(WEB_WINDING, run.experiment)
    for name in WEB_WINDING.output_names:
        np.testing.assert_allclose(again.experiment[name], run.experiment[name], rtol=1e-9, atol=1e-9)


def test_slow_controller_holds_its_output():
    u = simulate(WEB_WINDING, replace(LOOPS, dt=0.12), steps(31, seed=1)).experiment[["V1", "V2"]]
    assert np.array_equal(u[1::3], u[0:30:3])
    assert np.array_equal(u[2::3], u[0:29:3])
    assert not np.array_equal(u[3], u[2])


def test_bad_requests_are_refused_by_name():
    with pytest.raises(InputError, match=r"coulomb@unwnd.*\n.*coulomb@unwind"):
        simulate(WEB_WINDING, LOOPS, steps(5), effects={"coulomb@unwnd": {"level": 1.0}})
    with pytest.raises(InputError, match=r"coulomb@unwind:level: -1 N m\n.*\[0, inf\]"):
        simulate(WEB_WINDING, LOOPS, steps(5), effects={"coulomb@unwind": {"level": -1.0}})
    with pytest.raises(InputError, match="whole multiple"):
        simulate(WEB_WINDING, replace(LOOPS, dt=0.05), steps(5))
    with pytest.raises(InputError, match="no set-point 'theta_set'"):
        simulate(WEB_WINDING, LOOPS, Scenario("half", {"w3_set": np.full(5, 100.0)}))
    with pytest.raises(InputError, match=r"channel T1: .* N at t = .* s, outside \[-5, 50\] N"):
        simulate(WEB_WINDING, replace(LOOPS, Kp=300 * LOOPS.Kp), steps(2000))


@pytest.mark.slow
def test_plans_of_every_machine_run():
    from studies.experiments import EXPERIMENTS, PLANTS

    assert set(EXPERIMENTS) == set(PLANTS)
    for plant, experiments in EXPERIMENTS.items():
        for name in experiments:
            chosen = plan(plant, name)
            run = simulate(PLANTS[plant], chosen.controller, chosen.scenario(1))
            assert len(run.experiment) >= 2000


# ---- what must never pass for a number ---------------------------------------------------------------------------------


def one_state(rate, **options):
    """x' = rate(x), y = x, from x = start."""
    return Plant(
        "one",
        (Channel("x", "m"),),
        (Channel("u", "V", "input"),),
        (Channel("y", "m", "output"),),
        (),
        lambda x, u, p, at: {"x": rate(x.x) + 0.0 * u.u},
        lambda x, p: {"y": x.x},
        dt=0.1,
        **options,
    )


@pytest.mark.parametrize(
    ("rate", "start"),
    [(lambda x: -np.tanh(np.sqrt(x)) - 0.1, 0.2), (lambda x: np.minimum(np.sqrt(x), 1.0) - 1.0, 0.05), (lambda x: x**2 + 1, 1.0)],
    ids=["tanh", "minimum", "overflow"],
)
def test_not_a_number_stays_not_a_number_in_the_compiled_engine(rate, start):
    """numpy gives NaN or infinity here; a compiled clamp must not turn that into a plausible value."""
    plant, scenario = one_state(rate), Scenario("s", {"u": np.zeros(60)}, start={"x": start})
    with pytest.raises(InputError, match=r"channel x: (nan|inf|-inf)"):
        simulate(plant, Playback(("u",), 0.1), scenario)
    batch = simulate_batch(plant, Playback(("u",), 0.1), [scenario, Scenario("still", {"u": np.zeros(60)}, start={"x": start})])
    lost = np.isnan(batch.states[0, :, 0])
    assert lost[-1]
    assert np.array_equal(np.isnan(batch.measured[0, :, 0]), lost)
    assert np.array_equal(np.isnan(batch.commands[0, :, 0]), lost)


def test_a_batch_marks_runs_that_leave_the_plants_limits():
    plant = one_state(lambda x: 1.0 + 0.0 * x, limits={"x": (-1.0, 2.05)})
    each = [Scenario("s", {"u": np.zeros(30)}, start={"x": x}) for x in (-0.5, 1.0)]
    batch = simulate_batch(plant, Playback(("u",), 0.1), each)
    # x rises by 0.1 a sample: the first passes 2.05 at sample 26, the second at 11
    assert [int(np.isnan(run[:, 0]).argmax()) for run in batch.states] == [26, 11]
    assert np.isfinite(batch.states[0, :26]).all()


def test_batches_refuse_impossible_numbers():
    loop, scenario = Playback(("u",), 0.02), Scenario("s", {"u": np.zeros(5)})
    eta = WELDING_ROBOT.effect_vector()
    eta[[str(slot) for slot in WELDING_ROBOT.slots].index("input-delay@u:time")] = -0.1
    with pytest.raises(InputError, match=r"input-delay@u:time: -0.1 s"):
        simulate_batch(WELDING_ROBOT, loop, scenario, effects=eta)
    with pytest.raises(InputError, match="expected 5"):
        simulate_batch(WELDING_ROBOT, loop, scenario, parameters=np.ones((3, 4)))
    with pytest.raises(InputError, match="m1 = -1 kg"):
        simulate_batch(WELDING_ROBOT, loop, scenario, parameters=WELDING_ROBOT.nominal * [-1, 1, 1, 1, 1])
    with pytest.raises(InputError, match="substeps -1"):
        simulate(WELDING_ROBOT, loop, scenario, substeps=-1)


@pytest.mark.slow
def test_a_kernel_file_that_was_cut_short_is_mended(tmp_path, monkeypatch):
    kernel.cache_folder.cache_clear()
    monkeypatch.setenv("WORKBENCH_CACHE", str(tmp_path))
    plant, scenario = one_state(lambda x: -2.5 * x), Scenario("s", {"u": np.zeros(5)}, start={"x": 1.0})
    first = simulate(plant, Playback(("u",), 0.1), scenario).states.values
    (path,) = kernel.cache_folder().glob("kernel_*.py")
    whole = path.read_text()
    path.write_text(whole[:200])
    sys.modules.pop(path.stem)
    again = simulate(one_state(lambda x: -2.5 * x), Playback(("u",), 0.1), scenario).states.values
    assert np.array_equal(first, again)
    assert path.read_text() == whole
    kernel.cache_folder.cache_clear()


def test_threads_that_meet_a_new_plant_together_all_get_its_kernel():
    plant, scenario = one_state(lambda x: -1.7 * x), Scenario("s", {"u": np.zeros(5)}, start={"x": 1.0})
    with ThreadPoolExecutor(4) as pool:
        runs = list(pool.map(lambda _: simulate(plant, Playback(("u",), 0.1), scenario).states.values, range(4)))
    assert all(np.array_equal(run, runs[0]) for run in runs)


def test_malformed_plants_are_refused_by_name():
    good = one_state(lambda x: -x)
    for change, said in (
        ({"states": ()}, "at least one state"),
        ({"inputs": ()}, "at least one input"),
        ({"outputs": ()}, "at least one output"),
        ({"ports": (Shaft("a", "x"), Shaft("a", "x"))}, "two shaft ports"),
    ):
        with pytest.raises(InputError, match=said):
            replace(good, **change)
    listing = replace(good, equation=lambda x, u, p, at: [x.x])
    with pytest.raises(InputError, match="returns list"):
        simulate(listing, Playback(("u",), 0.1), Scenario("s", {"u": np.zeros(3)}))
    constant = replace(good, measure=lambda x, p: {"y": 3})
    assert simulate(constant, Playback(("u",), 0.1), Scenario("s", {"u": np.zeros(3)})).experiment["y"].tolist() == [3.0] * 3
