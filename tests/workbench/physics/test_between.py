"""Inputs that go on between their samples, against matrix exponentials of the axis with a chain of integrators before it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.linalg import expm

from controllers.pid import pid
from plants import POSITIONING_AXIS, WELDING_ROBOT
from workbench.errors import InputError
from workbench.physics import stepper
from workbench.physics.controller import Playback
from workbench.simulation import Scenario, simulate

AXIS = replace(POSITIONING_AXIS, dt=0.02, substeps=8, noise={}, disturbance={})
N = 120
FORCE = 200.0 * np.sin(0.14 * np.arange(N)) + 100.0 * np.sin(0.7 * np.arange(N) + 1.0)


def by_hand(parts, start=(0.0, 0.0)):
    """q (N) of the axis under u = u_k + b1 s + b2 s^2 + b3 s^3 over each sample; parts (N, 4): u_k, b1, b2, b3."""
    M, Fv = AXIS.nominal
    A = np.zeros((6, 6))
    A[0, 1], A[1, 1], A[1, 2] = 1.0, -Fv / M, 1.0 / M
    A[[2, 3, 4], [3, 4, 5]] = 1.0 / AXIS.dt  # u, its slope, its curvature, the slope of that
    F, x, q = expm(A * AXIS.dt), np.array(start, float), []
    for u, b1, b2, b3 in parts:
        q.append(x[0])
        x = (F @ [*x, u, b1, 2.0 * b2, 6.0 * b3])[:2]
    return np.array(q)


def parts_of(u, course):
    own = np.zeros((len(u), 4))
    own[:, 0] = u
    if course == "linear":
        own[:-1, 1] = np.diff(u)
    if course == "spline":
        own[:-1] = CubicSpline(np.arange(len(u)), u).c[::-1].T
    return own


def run(plant, u, effects=None, **options):
    scenario = Scenario("a", {"F": u}, start={"q": 0.0, "v": 0.0})
    return simulate(plant, Playback(("F",), plant.dt), scenario, effects=effects, **options).experiment["q"]


@pytest.mark.parametrize("course", ["held", "linear", "spline"])
def test_an_input_goes_on_between_its_samples_as_the_plant_says(course):
    expected = by_hand(parts_of(FORCE, course))
    assert run(replace(AXIS, between={"F": course}), FORCE) == pytest.approx(expected, abs=1e-7 * np.abs(expected).max())
    others = [by_hand(parts_of(FORCE, other)) for other in ("held", "linear", "spline") if other != course]
    assert min(np.abs(other - expected).max() for other in others) > 1e-3 * np.abs(expected).max()


@pytest.mark.parametrize("course", ["linear", "spline"])
def test_what_an_actuator_makes_of_it_goes_on_too(course):
    """An amplifier with an offset, whose gain has fallen by a third at the second sample."""
    effects = {"offset@F": {"level": -40.0}, "heating@F": {"fall": 1.0 / 3.0, "time": 1e-3}}
    bare = parts_of(FORCE - 40.0, course)
    own = np.vstack([bare[:1], 2.0 / 3.0 * bare[1:]])
    own[0, 1] -= (FORCE[1] - 40.0) / 3.0  # the very first sample begins cold, and leads to the second
    expected = by_hand(own)
    found = run(replace(AXIS, between={"F": course}), FORCE, effects)
    assert found == pytest.approx(expected, abs=1e-7 * np.abs(expected).max())


def test_an_input_that_stands_at_0_for_a_sample_goes_on_as_the_others():
    """Where kinks of dead zones and limits would be that are not there."""
    u = FORCE * (np.arange(N) - 50.0)
    expected = by_hand(parts_of(u, "spline"))
    assert u[50] == 0.0
    assert run(replace(AXIS, between={"F": "spline"}), u) == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("samples", [1.0, 1.37, 2.5])
def test_a_dead_time_shifts_the_whole_course(samples):
    """By integration of the shifted spline in pieces of a hundredth of a sample; before the record nothing moves."""
    plant, fine = replace(AXIS, between={"F": "spline"}), 100
    ramped = FORCE * np.minimum(np.arange(N) / 20.0, 1.0) ** 2
    spline = CubicSpline(np.arange(N), ramped)
    at = (np.arange(N * fine) + 0.5) / fine - samples
    held = np.where(at > 0.0, spline(np.maximum(at, 0.0)), 0.0)
    expected = run(replace(AXIS, dt=AXIS.dt / fine, substeps=1), held)[::fine]
    found = run(plant, ramped, {"input-delay@F": {"time": samples * AXIS.dt}})
    assert found == pytest.approx(expected, abs=2e-5 * np.abs(expected).max())


def test_a_limit_is_kept_but_for_the_samples_in_which_it_is_reached():
    """Its kinks lie between samples: with finer ones the course with a limit converges by the square of their length."""
    errors = []
    for finer in (1, 2, 4):
        plant = replace(AXIS, dt=AXIS.dt / finer, substeps=8, between={"F": "linear"})
        u = np.interp(np.arange(finer * N) / finer, np.arange(N), FORCE)
        exact = run(
            replace(AXIS, dt=AXIS.dt / 100, substeps=1),
            np.interp((np.arange(100 * N) + 0.5) / 100, np.arange(N), FORCE),
            {"saturation@F": {"limit": 150.0}},
        )[::100]
        errors.append(np.abs(run(plant, u, {"saturation@F": {"limit": 150.0}})[::finer] - exact).max() / np.abs(exact).max())
    assert errors[0] < 0.05
    assert errors[2] < 0.15 * errors[0]


def test_blocks_of_runs_give_the_numbers_of_single_ones_to_the_last_bit():
    plant = replace(AXIS, between={"F": "spline"})
    random, R = np.random.default_rng(0), 19
    eta = np.repeat(plant.effect_vector()[None], R, axis=0)
    eta[:, [str(s) for s in plant.slots].index("input-delay@F:time")] = random.uniform(0.0, 0.05, R)
    eta[:, [str(s) for s in plant.slots].index("gear-backlash@F:play")] = random.uniform(0.0, 40.0, R)
    u = FORCE[None, :, None] * random.uniform(0.5, 2.0, (R, 1, 1))

    def lanes(rows):
        n = len(range(R)[rows])
        quiet = np.zeros((n, N, 1))
        return stepper.Lanes(
            parameters=np.repeat(plant.nominal[None], n, axis=0), effects=eta[rows], gains=np.empty((n, 0)),
            memory=np.empty((n, 0)), start=np.zeros((n, 2)), hold=np.zeros((n, 1)), reference=u[rows], disturbance=quiet,
            noise=quiet,
        )  # fmt: skip

    together = stepper.run(plant, Playback(("F",), plant.dt), lanes(slice(None)), 8)
    for i in range(R):
        alone = stepper.run(plant, Playback(("F",), plant.dt), lanes(slice(i, i + 1)), 8)
        np.testing.assert_array_equal(together.measured[i], alone.measured[0])


def test_what_a_controller_commands_is_held():
    loop = pid(("F",), ("q",), ("q_set",), AXIS.dt, np.array([[3000.0]]), np.array([[500.0]]))
    scenario = Scenario("a", {"q_set": np.where(np.arange(N) > 10, 0.1, 0.0)}, start={"q": 0.0, "v": 0.0})
    runs = [simulate(plant, loop, scenario).experiment for plant in (AXIS, replace(AXIS, between={"F": "spline"}))]
    np.testing.assert_array_equal(runs[0]["q"], runs[1]["q"])


def test_the_rate_of_an_input_is_that_of_its_course():
    """The arm's acceleration pushes the robot: of a smooth angle a coarse record with a spline tells what a fine one does."""

    def speed(finer, course, samples=200):
        plant = replace(WELDING_ROBOT, dt=0.05 / finer, noise={}, disturbance={}, between={"arm": course})
        t = plant.dt * np.arange(finer * samples)
        inputs = {"u": np.zeros(len(t)), "arm": 0.8 * np.sin(2.0 * t) ** 2}
        scenario = Scenario("a", inputs, start={"v1": 0.0, "v2": 0.0})
        done = simulate(plant, Playback(("u", "arm"), plant.dt), scenario, effects={"arm-reaction@rail": {"coefficient": 1.0}})
        return done.experiment["v"][::finer]

    exact = speed(20, "spline")
    size = np.abs(exact).max()
    assert np.abs(speed(1, "spline") - exact).max() < 0.003 * size
    assert np.abs(speed(1, "held") - exact).max() > 0.03 * size


@pytest.mark.parametrize(("between", "said"), [({"F": "cubic"}, "held, linear, spline"), ({"f": "linear"}, "unknown input 'f'")])
def test_courses_and_inputs_that_are_not_there_are_refused(between, said):
    with pytest.raises(InputError, match=said):
        replace(AXIS, between=between)
