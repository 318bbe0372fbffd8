"""The filter: against python-control, against its own equations, and the offset it must find."""

from dataclasses import replace

import control
import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from controllers.observer import augmented, design_observer
from workbench.basis import CONSTANT, PiecewiseLinear
from workbench.data import Channel
from workbench.errors import InputError
from workbench.lpv import LPVModel, OperatingPoint, Predictor, Term

A = np.array([[0.8, 0.1], [0.0, 0.6]])
B = np.array([[0.5, 0.1], [-0.2, 0.7]])
C = np.array([[1.0, 0.2], [0.3, 1.0]])
K = np.array([[0.3, 0.05], [0.0, 0.2]])
R = np.array([[0.04, 0.01], [0.01, 0.09]])


def model(gain=K, schedule=False) -> LPVModel:
    two = lambda M, factor=1.0: np.stack([M, factor * M])  # noqa: E731
    F = A - gain @ C
    inputs, outputs = (
        (Channel(a, "V", role), Channel(b, "V", role)) for a, b, role in (("a", "b", "input"), ("c", "d", "output"))
    )
    return LPVModel(
        "m", 0.1, inputs, outputs,
        (Channel("r", "m", "schedule"),) if schedule else (), [[1.0, 2.0]] if schedule else np.zeros((0, 2)),
        PiecewiseLinear((1.0, 2.0)) if schedule else CONSTANT, (Term(0), Term(1)) if schedule else (Term(0),),
        two(A) if schedule else A[None], two(B, 1.5) if schedule else B[None], two(C) if schedule else C[None],
        np.zeros((2 if schedule else 1, 2, 2)), OperatingPoint(CONSTANT, u=[[0.0, 0.0]], y=[[0.0, 0.0]]),
        Predictor(two(F) if schedule else F[None], two(B, 1.5) if schedule else B[None], two(gain) if schedule else gain[None]),
        R,
    )  # fmt: skip


@pytest.mark.parametrize("at_inputs", [True, False])
def test_without_process_noise_it_is_the_filter_of_python_control(at_inputs):
    found = design_observer(model(0.0 * K), at_inputs=at_inputs, drift=0.2)
    Az, _, Cz = augmented(A, B, C, at_inputs)
    inverse = np.linalg.inv(C @ np.linalg.solve(np.eye(2) - A, B)) if at_inputs else np.eye(2)
    Q = np.zeros((4, 4))
    Q[2:, 2:] = 0.04 * inverse @ R @ inverse.T
    predictor, _, _ = control.dlqe(Az, np.eye(4), Cz, Q, R)
    np.testing.assert_allclose(Az @ found.L[0] + found.J[0], predictor, atol=1e-9)


def test_of_all_gains_it_leaves_the_smallest_error():
    """The stationary error covariance of any other gain, by its Lyapunov equation, is larger in every direction."""
    found = design_observer(model(), at_inputs=True, drift=0.3)
    Az, _, Cz = augmented(A, B, C, True)
    inverse = np.linalg.inv(C @ np.linalg.solve(np.eye(2) - A, B))
    noise = np.zeros((4, 4))
    noise[2:, 2:] = 0.09 * inverse @ R @ inverse.T
    pushed = np.vstack([K, np.zeros((2, 2))])

    def covariance(gain):
        F = Az - gain @ Cz
        return solve_discrete_lyapunov(F, noise + (pushed - gain) @ R @ (pushed - gain).T)

    best = Az @ found.L[0] + found.J[0]
    least, random = covariance(best), np.random.default_rng(1)
    for _ in range(20):
        other = covariance(best + 0.02 * random.normal(size=best.shape))
        assert np.linalg.eigvalsh(other - least).min() > -1e-10
        assert np.trace(other) > np.trace(least)


@pytest.mark.parametrize("at_inputs", [True, False])
def test_it_finds_a_constant_disturbance_and_predicts_without_offset(at_inputs):
    found = design_observer(model(), at_inputs=at_inputs)
    Az, Bz, Cz = augmented(A, B, C, at_inputs)
    truth, u = np.array([0.7, -0.4]), np.array([1.0, 2.0])
    x, z = np.zeros(2), np.zeros(4)
    for _ in range(400):
        y = C @ x + (0.0 if at_inputs else truth)
        e = y - Cz @ z
        z = z + found.L[0] @ e
        z = Az @ z + Bz @ u + found.J[0] @ e
        x = A @ x + B @ (u + (truth if at_inputs else 0.0))
    np.testing.assert_allclose(z[2:], truth, atol=1e-6)
    np.testing.assert_allclose(Cz @ z, C @ x + (0.0 if at_inputs else truth), atol=1e-6)


def test_gains_between_the_points_are_interpolated():
    found = design_observer(model(schedule=True), points=3)
    np.testing.assert_array_equal(found.gains(1.5)[0], found.L[1])
    np.testing.assert_allclose(found.gains(1.25)[0], 0.5 * (found.L[0] + found.L[1]))
    np.testing.assert_array_equal(found.gains(9.0)[1], found.J[2])
    exact = design_observer(model(schedule=True), points=5)
    np.testing.assert_allclose(found.gains(1.25)[0], exact.L[1], atol=0.02)


def test_models_without_what_it_needs_are_refused():
    with pytest.raises(InputError, match="no predictor and no noise"):
        design_observer(replace(model(), predictor=None))
    with pytest.raises(InputError, match="see the command of their own sample"):
        design_observer(replace(model(), D=np.ones((1, 2, 2))))
    with pytest.raises(InputError, match="leaves no trace"):
        design_observer(replace(model(), B=np.ones((1, 2, 2))), at_inputs=True)
    with pytest.raises(InputError, match="drift 0"):
        design_observer(model(), drift=0.0)
