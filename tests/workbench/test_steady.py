"""Rests and slow motions of linear systems, those that integrate or are unstable among them, against their own equations."""

import control
import numpy as np
import pytest

from controllers.pid_design import FrozenPoint
from workbench.steady import follows, gain, integrates, rests

DT = 0.01


def sampled(num, den):
    plant = control.sample_system(control.ss(control.tf(num, den)), DT)
    return plant.A, plant.B, plant.C, plant.D


@pytest.mark.parametrize(
    ("num", "den", "Kr", "Ka"),
    [
        ([1.0], [0.5, 20.0, 0.0], 0.0, 20.0),  # mass and friction: what holds a speed is 20
        ([2.0], [1.0, 0.0], 0.0, 0.5),
        ([1.0], [0.5, 0.0, 0.0], 0.0, 0.0),  # a free mass
        ([1.0], [1.0, 0.3, -4.0], -4.0, 0.3),  # a pendulum upright
        ([3.0], [0.2, 1.0], 1.0 / 3.0, 0.2 / 3.0),
        ([1.0], [1.0, 1e-6], 1e-6, 1.0),  # a leak that no record tells from none
    ],
)
def test_what_holds_an_output_and_its_rate(num, den, Kr, Ka):
    """1 / P(s) = Kr + Ka s + .. ; commands are held, which is half a sample of its s^2 later."""
    A, B, C, D = sampled(num, den)
    X, U = rests(A, B, C, D)
    np.testing.assert_allclose(U, [[Kr]], atol=1e-9)
    np.testing.assert_allclose(C @ X + D @ U, [[1.0]])
    np.testing.assert_allclose(A @ X + B @ U, X, atol=1e-9)
    late = 0.5 * DT * Kr
    np.testing.assert_allclose(follows(A, B, C, D, DT * X)[1], [[Ka + late]], atol=2e-3 * max(abs(Ka), 0.01))


@pytest.mark.parametrize("seed", range(6))
def test_outputs_follow_a_ramp_without_being_late(seed):
    """Two outputs of a system with an integrator in it, simulated along u = U r + V r' from where it moves with the ramp."""
    random = np.random.default_rng([71, seed])
    poles = [1.0, 0.7, -0.2] if seed % 2 else [1.02, 0.8, 0.5]
    T = random.normal(size=(3, 3))
    A = T @ np.diag(poles) @ np.linalg.inv(T)
    B, C, D = random.normal(size=(3, 2 + seed % 3 // 2)), random.normal(size=(2, 3)), np.zeros((2, 2 + seed % 3 // 2))
    assert integrates(A)
    X, U = rests(A, B, C, D)
    V = follows(A, B, C, D, DT * X)[1]
    rate = random.normal(size=2)
    W = np.linalg.lstsq(np.vstack([np.eye(3) - A, C]), np.vstack([B @ V - DT * X, -D @ V]), rcond=None)[0]
    x = W @ rate
    for k in range(60):
        r = rate * DT * k
        np.testing.assert_allclose(C @ x + D @ (U @ r + V @ rate), r, atol=1e-6)
        x = A @ x + B @ (U @ r + V @ rate)


def test_the_gain_of_what_integrates_is_finite_and_has_its_sign():
    for num, den, sign in (
        ([5.0], [1.0, 0.0], 1),
        ([-5.0], [1.0, 1.0, 0.0], -1),
        ([1.0], [1.0, -2.0], 1),
        ([1.0], [1.0, 1.0], 1),
    ):
        P = gain(*sampled(num, den))
        assert np.isfinite(P).all()
        assert np.sign(P[0, 0]) == sign
    np.testing.assert_allclose(gain(*sampled([3.0], [1.0, 1.0])), 3.0)


def test_dead_time_and_a_wrong_zero_do_not_change_the_gain_of_an_integrator():
    for late in (0, 5, 40):
        den = np.append([1.0, -1.0], np.zeros(late))
        plant = control.ss(control.tf([0.02], den, DT))
        np.testing.assert_allclose(gain(plant.A, plant.B, plant.C, plant.D), 0.2, rtol=1e-3)
    for zero in (0.0, 0.5, 1.0, 2.0):  # 1 - zero s: its sign is that of what it comes to in the end
        plant = control.sample_system(control.ss(control.tf([-zero, 1.0], [0.01, 1.0, 0.0])), 0.1)
        np.testing.assert_allclose(gain(plant.A, plant.B, plant.C, plant.D), 1.0, rtol=1e-6)


def test_states_that_no_input_moves_hold_nothing():
    """A lag of gain 10 and a disturbance that wanders: the output is held by the input, not by the disturbance."""
    A, B, C, D = np.diag([0.9, 1.0]), np.array([[1.0], [0.0]]), np.ones((1, 2)), np.zeros((1, 1))
    np.testing.assert_allclose(gain(A, B, C, D), 10.0)
    X, U = rests(A, B, C, D)
    np.testing.assert_allclose(U, 0.1)
    np.testing.assert_allclose(X, [[1.0], [0.0]], atol=1e-9)


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
def test_units_do_not_matter(unit):
    A, B, C, D = sampled([1.0], [0.5, 20.0, 0.0])
    x = 10.0 ** np.linspace(-3.0, 3.0, len(A))
    X, U = rests(A / x[:, None] * x, B / x[:, None] * unit, C * x, D)
    np.testing.assert_allclose(U * unit, 0.0, atol=1e-6)
    V = follows(A / x[:, None] * x, B / x[:, None] * unit, C * x, D, DT * X)[1]
    np.testing.assert_allclose(V * unit, 20.0, rtol=1e-3)


@pytest.mark.parametrize("seed", range(6))
def test_outputs_follow_a_parabola_at_the_samples(seed):
    """Two outputs, with an integrator or without, along u = Kr r + Ka r' + Kaa r'', from the states that move with r."""
    random = np.random.default_rng([72, seed])
    T = random.normal(size=(4, 4))
    A = T @ np.diag([[1.0, 0.7, -0.2, 0.5], [0.9, 0.8, 0.5, 0.3]][seed % 2]) @ np.linalg.inv(T)
    B, C, D = random.normal(size=(4, 2)), random.normal(size=(2, 4)), np.zeros((2, 2))
    scale = np.array([2.0, 0.03])
    point = FrozenPoint(None, DT, A, B, C, D, scale, np.zeros((4, 2)), np.eye(2), integrates(A))
    Kr, Ka, Kaa = point.held(np.ones((2, 2), dtype=bool))
    a, b, c = random.normal(size=(3, 2))

    def u(k):
        t = DT * k
        return Kr @ (a + b * t + 0.5 * c * t**2) + Ka @ (b + c * t) + Kaa @ c

    # states that move with r are a parabola too: x = X0 + X1 k + X2 k^2, with x(k + 1) = A x(k) + B u(k) at every k
    u0, u1, u2 = u(0), (u(1) - u(-1)) / 2.0, (u(1) + u(-1)) / 2.0 - u(0)
    rest = lambda forced, rate: np.linalg.lstsq(  # noqa: E731
        np.vstack([np.eye(4) - A, C]), np.concatenate([B @ forced - rate[0], rate[1]]), rcond=None
    )[0]
    X2 = rest(u2, (np.zeros(4), 0.5 * c * DT**2))
    X1 = rest(u1, (2.0 * X2, b * DT))
    x = rest(u0, (X1 + X2, a))
    for k in range(60):
        t = DT * k
        np.testing.assert_allclose(C @ x, a + b * t + 0.5 * c * t**2, atol=1e-6)
        x = A @ x + B @ u(k)
