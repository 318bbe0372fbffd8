"""The robot against [2] and against its written equations, integrated by another hand: scipy, not the workbench."""

from dataclasses import replace

import control
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

from plants.welding_robot import WELDING_ROBOT as ROBOT
from plants.welding_robot import frozen_course, frozen_parameters
from studies.experiments import CURVES
from workbench.data import Experiment
from workbench.errors import InputError
from workbench.physics.controller import Playback
from workbench.physics.effects.robot import Robot
from workbench.simulation import Scenario, replay, simulate

M1, M2, C, B1, B2 = ROBOT.nominal
N, DT = 300, 0.020
T = DT * np.arange(N)
FORCE = 2.0 * np.sign(np.sin(2.2 * T + 0.1))  # reverses, so that friction has to change its sign
ARM = 1.3 * np.sin(1.7 * T + 0.4)
LOOP = Playback(("u", "arm"), DT)
SCENARIO = Scenario("run", {"u": FORCE, "arm": ARM})


def test_transfer_function_is_the_papers_reduced_model():
    """[2] eq. (9): G(s) = (s + 2.3)/(s^2 + 6.6 s + 1.67)."""
    A, B, c, D = ROBOT.linearize([0.0, 0.0], [0.0, 0.0])
    assert not B[:, 1].any()  # the arm
    G = control.ss2tf(control.ss(A, B[:, :1], c, D[:, :1]))
    np.testing.assert_allclose(G.num[0][0], [1.0, 2.3], rtol=1e-9)
    np.testing.assert_allclose(G.den[0][0], [1.0, 6.6, 1.67], rtol=1e-9)


def written_equation(force, mass=lambda t: M1):
    """States at the samples from m1(t) v1' = u - b1 v1 - c (v1 - v2) + force(v1, arm), m2 v2' = c (v1 - v2) - b2 v2."""
    x = np.zeros((N, 2))
    for k in range(N - 1):  # the inputs are held: one piece of the integral for each sample

        def rate(t, x, k=k):
            v1, v2 = x
            return [
                (FORCE[k] - B1 * v1 - C * (v1 - v2) + force(v1, ARM[k])) / mass(t),
                (C * (v1 - v2) - B2 * v2) / M2,
            ]

        x[k + 1] = solve_ivp(rate, (T[k], T[k + 1]), x[k], rtol=1e-10, atol=1e-12).y[:, -1]
    return x


PERTURBED = {
    "nothing": ({}, lambda v, a: 0.0, lambda t: M1),
    "friction": ({"coulomb@rail": {"level": 0.3}}, lambda v, a: -0.3 * np.tanh(v / 0.01), lambda t: M1),
    "gravity": (
        {"arm-gravity@rail": {"sine": 0.5, "cosine": -0.2}},
        lambda v, a: -(0.5 * np.sin(a) - 0.2 * np.cos(a)),
        lambda t: M1,
    ),
    "mass": (
        {"platform-mass@rail": {"change": 0.5, "swing": 0.3, "period": 1.7}},
        lambda v, a: 0.0,
        lambda t: M1 * (1.5 + 0.3 * np.sin(2 * np.pi * t / 1.7)),
    ),
    "all three": (
        {
            "coulomb@rail": {"level": 0.2, "width": 0.05},
            "arm-gravity@rail": {"sine": 0.3},
            "platform-mass@rail": {"change": -0.3, "swing": 0.2},
        },
        lambda v, a: -0.2 * np.tanh(v / 0.05) - 0.3 * np.sin(a),
        lambda t: M1 * (0.7 + 0.2 * np.sin(2 * np.pi * t / 10.0)),
    ),
}


@pytest.mark.parametrize("name", PERTURBED)
def test_each_perturbation_is_its_written_equation(name):
    sizes, force, mass = PERTURBED[name]
    found = simulate(ROBOT, LOOP, SCENARIO, effects=sizes).states.values
    np.testing.assert_allclose(found, written_equation(force, mass), atol=2e-5 if "coulomb@rail" in sizes else 1e-8)


def test_the_nominal_robot_does_not_feel_its_arm():
    moved = simulate(ROBOT, LOOP, SCENARIO).states.values
    still = simulate(ROBOT, Playback(("u",), DT), Scenario("run", {"u": FORCE})).states.values
    assert np.array_equal(moved, still)


def test_friction_only_ever_takes_energy():
    """No force: from any speed the energy falls faster than in the frictionless robot, and the platform does not reverse."""
    rest = Scenario("coast", {"u": np.zeros(N), "arm": ARM}, start={"v1": 1.0, "v2": 1.0})

    def energy(sizes):
        v = simulate(ROBOT, LOOP, rest, effects=sizes).states.values
        return v, 0.5 * v**2 @ [M1, M2]

    v, rubbing = energy({"coulomb@rail": {"level": 0.5}})
    _, free = energy({})
    assert np.all(np.diff(rubbing) <= 0.0)
    assert np.all(rubbing[1:] < free[1:])
    assert v[:, 0].min() > -1e-9
    # power at the start: level v, viscous losses apart
    assert (free[1] - rubbing[1]) / DT == pytest.approx(0.5 * 1.0, rel=0.05)


@pytest.mark.parametrize("change", [-0.4, 0.0, 0.25, 1.0])
def test_mass_divides_the_first_acceleration(change):
    eta = ROBOT.effect_vector({"platform-mass@rail": {"change": change}})
    assert ROBOT.derivative([0.0, 0.0], [2.0, 0.7], eta=eta)[0] == pytest.approx(2.0 / M1 / (1 + change), rel=1e-14)


def test_a_swinging_mass_carries_its_momentum_with_it():
    """m v' = F: without a force the speed stays, whatever the mass does; (m v)' = F would change it by -m' v/m."""
    eta = ROBOT.effect_vector({"platform-mass@rail": {"swing": 0.4, "period": 2.0}})
    free = np.array([M1, M2, C, 0.0, 0.0])  # no friction to the rail and in the bearing
    for t in (0.0, 0.3, 1.1):
        assert ROBOT.derivative([1.5, 1.5], [0.0, 0.0], free, eta, t=t) == pytest.approx([0.0, 0.0], abs=1e-15)


def test_the_platform_never_loses_its_mass():
    sizes = {s.parameter.name: s.parameter for s in ROBOT.slots if s.key == "platform-mass@rail"}
    assert 1 + sizes["change"].low - max(sizes["swing"].high, -sizes["swing"].low) > 0
    with pytest.raises(InputError, match="platform-mass@rail:change"):
        ROBOT.effect_vector({"platform-mass@rail": {"change": -1.0}})


def test_arm_gravity_at_known_angles():
    eta = ROBOT.effect_vector({"arm-gravity@rail": {"sine": 3.0, "cosine": 2.0}})
    for arm, force in ((0.0, -2.0), (np.pi / 2, -3.0), (np.pi, 2.0), (-np.pi / 2, 3.0)):
        assert ROBOT.derivative([0.0, 0.0], [0.0, arm], eta=eta)[0] == pytest.approx(force / M1)


# ---- the arm: an input that moves on its own --------------------------------------------------------------------------


def record(**inputs):
    schedule = {"arm": inputs.pop("arm")} if "arm" in inputs else {}
    return Experiment.from_arrays("logged", DT, inputs=inputs, outputs={"v": np.zeros(N)}, schedule=schedule)


GRAVITY = {"arm-gravity@rail": {"sine": 0.5, "cosine": 0.3}}


def test_replay_takes_the_arm_from_a_record_that_holds_it():
    run = replay(ROBOT, record(u=FORCE, arm=ARM), effects=GRAVITY)
    assert np.array_equal(run.states.values, simulate(ROBOT, LOOP, SCENARIO, effects=GRAVITY).states.values)
    assert run.experiment.names == ("u", "arm", "v")
    assert run.experiment.names_of("schedule") == ("arm",)
    assert np.array_equal(run.experiment["arm"], ARM)


def test_replay_of_a_record_without_the_arm_holds_it_at_0():
    run = replay(ROBOT, record(u=FORCE), effects=GRAVITY)
    held = simulate(ROBOT, LOOP, Scenario("held", {"u": FORCE, "arm": np.zeros(N)}), effects=GRAVITY)
    assert np.array_equal(run.states.values, held.states.values)
    assert run.experiment.names == ("u", "v")  # no column that nobody measured
    with pytest.raises(InputError, match="unknown channel 'u'"):
        replay(ROBOT, record(arm=ARM))


def test_the_arm_can_be_held_at_another_angle():
    run = replay(ROBOT, record(u=FORCE), effects=GRAVITY, start={"arm": 0.8})
    held = simulate(ROBOT, LOOP, Scenario("held", {"u": FORCE, "arm": np.full(N, 0.8)}), effects=GRAVITY)
    assert np.array_equal(run.states.values, held.states.values)


def test_only_what_is_commanded_has_an_actuator():
    assert ROBOT.commanded == ("u",)
    assert {slot.place for slot in ROBOT.slots if slot.effect.family == "actuator"} == {"u"}
    # its saturation and dead time leave the arm alone
    sizes = {"saturation@u": {"limit": 0.5}, "input-delay@u": {"time": 0.05}} | GRAVITY
    late = np.concatenate([np.zeros(5), np.repeat(np.clip(FORCE, -0.5, 0.5), 2)])[: 2 * N]  # at 0.01 s: 5 steps of dead time
    fine = replace(ROBOT, dt=0.01)
    same = Scenario("same", {"u": late, "arm": np.repeat(ARM, 2)})
    expected = simulate(fine, Playback(("u", "arm"), 0.01), same, effects=GRAVITY).states.values[::2]
    np.testing.assert_allclose(simulate(ROBOT, LOOP, SCENARIO, effects=sizes).states.values, expected, atol=1e-9)


def test_a_linearisation_without_the_arm_is_refused():
    """One number for two inputs would have turned the arm by the force."""
    with pytest.raises(InputError, match="expected u, arm"):
        ROBOT.linearize([0.0, 0.0], [1.0])


def test_an_arm_that_is_no_input_is_refused():
    with pytest.raises(InputError, match="did you mean 'arm'"):
        replace(ROBOT, ports=(Robot("rail", "arms"),))


def test_frozen_parameters_are_those_of_the_published_transfer_function():
    """G(s) = (s + 2.3)/(s^2 + 6.6 s + 1.67) sampled with a held input, [2] (9), in delta form."""
    b, a, _ = cont2discrete(([1.0, 2.3], [1.0, 6.6, 1.67]), 0.1)
    delta = [2 + a[1], 1 + a[1] + a[2], b[0, 1], b[0, 1] + b[0, 2]]
    np.testing.assert_allclose(frozen_parameters(1.0, 0.1), delta, rtol=1e-10)


def test_the_course_of_the_truth_follows_the_mass():
    """Curve 4 starts at twice the mass; a quarter of the period later it is at 2.4 times."""
    course = frozen_course(np.array([0.0, 2.5]), 0.1, CURVES["curve4"])
    np.testing.assert_allclose(course[0], frozen_parameters(2.0, 0.1))
    np.testing.assert_allclose(course[1], frozen_parameters(2.4, 0.1))
