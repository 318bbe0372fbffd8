"""A steered run against the same arithmetic in numpy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from plants import POSITIONING_AXIS, WEB_WINDING
from workbench.physics import stepper
from workbench.physics.controller import Playback

N = 60


def lanes(plant, u, start, effects=None, R=1):
    eta = plant.effect_vector(effects)
    each = {
        "parameters": plant.nominal, "effects": eta, "gains": np.empty(0), "memory": np.empty(0),
        "start": start, "hold": u[0],
    }  # fmt: skip
    own = {name: np.broadcast_to(value, (R, len(value))) for name, value in each.items()}
    quiet = np.zeros((R, len(u), len(plant.outputs)))
    return stepper.Lanes(
        **own, reference=np.broadcast_to(u, (R, *u.shape)), disturbance=np.zeros((R, *u.shape)), noise=quiet
    )  # fmt: skip


def run(plant, u, start, steering, substeps=8, **options):
    return stepper.run(plant, Playback(plant.input_names, plant.dt), lanes(plant, u, start, **options), substeps, 1, steering)


def axis_matrices(dt):
    M, Fv = POSITIONING_AXIS.nominal
    A = np.zeros((4, 4))
    A[0, 1], A[1, 1], A[1, 2], A[1, 3] = 1.0, -Fv / M, 1.0 / M, 1.0
    F = expm(A * dt)
    return F[:2, :2], F[:2, 2], F[:2, 3]  # state, force, push on the rate of v


def test_a_corrected_run_of_a_linear_plant_is_the_innovations_form():
    random = np.random.default_rng(0)
    F, G, _ = axis_matrices(POSITIONING_AXIS.dt)
    u, y = 100 * random.standard_normal((N, 1)), 0.01 * random.standard_normal((N, 1))
    y[17] = np.nan  # not observed
    gain = np.zeros((N, 2 + 1 + len(POSITIONING_AXIS.memories), 1))
    gain[:, :2, 0] = random.uniform(0, 0.5, (N, 2))
    done = run(POSITIONING_AXIS, u, np.array([0.01, -0.2]), stepper.Steering(observed=y, gain=gain))
    x, expected = np.array([0.01, -0.2]), []
    for k in range(N):
        expected.append(x)
        x = x + gain[k, :2, 0] * np.nan_to_num(y[k, 0] - x[0])
        x = F @ x + G * u[k, 0]
    assert done.states[0] == pytest.approx(np.array(expected), rel=1e-9, abs=1e-12)
    assert done.measured[0, :, 0] == pytest.approx(np.array(expected)[:, 0], rel=1e-9, abs=1e-12)


def test_entries_that_are_named_are_corrected_as_by_a_gain_of_0_for_all_others():
    """Also drifts and memories of sensors, which stand elsewhere in the kernel, in whatever order they are named."""
    random, plant = np.random.default_rng(1), WEB_WINDING
    nx, na, nm = len(plant.states), len(plant.turning), len(plant.memories)
    n = nx + na + len(plant.inner) + nm
    (start, u0), decay = plant.equilibrium(), np.full(nx, 0.9)
    u = u0 + 0.05 * random.standard_normal((N, 2))
    named = np.array([n + 1, 2, n - nm + 4, 0, nx])
    gain = 1e-3 * random.standard_normal((N, len(named), len(plant.outputs)))
    whole = np.zeros((N, n + nx, len(plant.outputs)))
    whole[:, named] = gain
    y = random.standard_normal((N, len(plant.outputs)))
    lag = {f"sensor-lag@{plant.output_names[1]}": {"time": 0.05}}
    for R in (1, 3):
        few, every = (
            run(plant, u, start, stepper.Steering(y, *own, decay=decay, full=True), effects=lag, R=R)
            for own in ((gain, named), (whole, None))
        )
        np.testing.assert_array_equal(few.full, every.full)
    assert np.abs(few.full - run(plant, u, start, stepper.Steering(full=True), effects=lag).full).max() > 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("R", [2, 3, 17, 18, 19])
def test_every_run_of_a_batch_is_the_run_alone_whichever_kernel_it_goes_through(R):
    random, plant = np.random.default_rng(2), WEB_WINDING
    x0, u0 = plant.equilibrium()
    y = random.standard_normal((N, len(plant.outputs)))
    gain = 1e-3 * random.standard_normal((N, 5, len(plant.outputs)))
    steering = stepper.Steering(y, gain, np.arange(5), full=True)
    each = lanes(plant, np.tile(u0, (N, 1)), x0, R=R)
    each = replace(each, start=x0 * random.uniform(0.9, 1.1, (R, len(x0))))
    whole = stepper.run(plant, Playback(plant.input_names, plant.dt), each, 8, 2, steering)
    for r in range(R):
        alone = replace(lanes(plant, np.tile(u0, (N, 1)), x0), start=each.start[r : r + 1])
        one = stepper.run(plant, Playback(plant.input_names, plant.dt), alone, 8, 1, steering)
        for name in ("states", "measured", "commands", "full"):
            np.testing.assert_array_equal(getattr(whole, name)[r], getattr(one, name)[0])


def test_a_push_adds_to_the_rate_of_its_state_alone():
    _, _, P = axis_matrices(POSITIONING_AXIS.dt)
    u = np.zeros((2, 1))
    push = np.zeros((2, 2, 3))
    push[0, 1] = [0.0, 1.0, -2.0]
    done = run(POSITIONING_AXIS, u, np.zeros(2), stepper.Steering(push=push), R=3)
    assert done.states[:, 1] == pytest.approx(np.outer([0.0, 1.0, -2.0], P), rel=1e-9, abs=1e-15)


def test_a_run_restarted_from_its_own_states_is_the_same_run():
    plant = WEB_WINDING
    x0, u0 = plant.equilibrium()
    u = u0 + 0.05 * np.random.default_rng(1).standard_normal((N, 2))
    effects = {"coulomb@unwind": {"level": 0.001}, "sensor-lag@theta": {"time": 0.05}, "backlash@r2": {"half_width": 1e-5}}
    free = run(plant, u, x0, stepper.Steering(full=True), effects=effects)
    assert free.full is not None
    again = run(
        plant, u, x0, stepper.Steering(restart=np.ascontiguousarray(free.full.transpose(1, 2, 0)), full=True), effects=effects
    )
    assert np.array_equal(free.full, again.full)
    assert np.array_equal(free.measured, again.measured)
    elsewhere = free.full.transpose(1, 2, 0).copy()
    elsewhere[30:] *= 1.001
    assert not np.array_equal(
        run(plant, u, x0, stepper.Steering(restart=elsewhere), effects=effects).measured[0, 31], free.measured[0, 31]
    )


def test_a_correction_reaches_sensors_with_memory_as_a_jump_of_their_input():
    """A lag does not jump when the state behind it is corrected; without the lag the reading is the corrected output."""
    plant = POSITIONING_AXIS
    T, dt = 0.02, plant.dt
    gain = np.zeros((3, 3 + len(plant.memories), 1))
    gain[0, 0, 0] = 1.0
    y = np.full((3, 1), np.nan)
    y[0] = 0.3
    u = np.zeros((3, 1))
    steer = stepper.Steering(observed=y, gain=gain)
    lagging = run(plant, u, np.zeros(2), steer, effects={"sensor-lag@q": {"time": T}}).measured[0, :, 0]
    assert lagging == pytest.approx(0.3 * (1 - np.exp(-dt / T * np.arange(3))), rel=1e-9)
    assert run(plant, u, np.zeros(2), steer).measured[0, :, 0] == pytest.approx([0.0, 0.3, 0.3])
