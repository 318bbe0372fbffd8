"""Designs of least variance: what they say of noise and load steps is so, and no law within the bounds does better.

Judges share no code with the design: responses of transfer functions, minimum-variance laws of textbooks, finite responses.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal
from scipy.linalg import solve_discrete_lyapunov
from scipy.optimize import approx_fprime

from controllers.pid_design import design_pid
from controllers.tuning import Task, Tuning
from controllers.variance import LOST, Disturbed, Variance, lyapunov
from tests.controllers.drawn import FREE, KINDS, LAWS, Asked, ask, best_at_random, draw, judge, variances
from workbench.basis import CONSTANT
from workbench.data import Channel
from workbench.lpv import OperatingPoint, Predictor, constant_model
from workbench.rehearsal import rehearsal
from workbench.robustness.frozen import Bounds

ROUNDING = 1e-4  # by which a peak between the frequencies of the program may pass a bound


def stands(plant, asked, random, laws, room=1.02):
    """The variance is what the judge says, within the bounds, and no law at random or nearby has less.

    room: a design keeps half a percent off its bounds, which costs that; where a mass is free the variance falls with the cube of
    the effort.
    """
    model = replace(plant.model(), noise=np.eye(1))
    d, every = 10.0 ** random.uniform(-0.5, 1.5) / abs(plant.steady), plant.dt * 10.0 ** random.uniform(1.5, 3.0)
    load = d**2 * plant.dt / every
    found = design_pid(model, bounds=asked.bounds, load=np.array([d]), load_every=every)
    gains = np.array([[found.law.Kp[0, 0, 0], found.law.Ki[0, 0, 0], found.law.Kd[0, 0, 0]]])
    (reached,) = variances(plant, gains, load)
    assert judge(plant, gains).kept(asked, -ROUNDING)[0]
    assert found.deviation[0, 0] ** 2 == pytest.approx(reached, rel=1e-4)
    assert found.least[0, 0] ** 2 <= reached * (1.0 + 1e-6)
    best = -best_at_random(plant, [asked], random, laws, lambda _, own: -variances(plant, own, load))[0]
    near = gains * (1.0 + random.normal(size=(200, 3)) * 10.0 ** random.uniform(-2.5, -0.5, (200, 1)))
    near = near[judge(plant, near).kept(asked)]
    assert reached <= room * min(best, variances(plant, near, load).min(initial=np.inf)), f"{plant} {asked} {d:.4g} {every:.4g}"


@pytest.mark.parametrize("kind", KINDS)
def test_no_law_within_the_bounds_has_less_variance(kind):
    random = np.random.default_rng([51, KINDS.index(kind)])
    stands(draw(random, kind), ask(random), random, 300)


@pytest.mark.parametrize("kind", FREE)
def test_plants_that_run_away_are_held_with_the_least_variance(kind):
    for case in range(2):
        random = np.random.default_rng([60, FREE.index(kind), case])
        stands(draw(random, kind), Asked(1.7, 2.0, 5.0), random, 300, 1.05)


@pytest.mark.slow
@pytest.mark.parametrize("kind", FREE)
def test_twenty_plants_that_run_away_are_held_with_the_least_variance(kind):
    for case in range(20):
        random = np.random.default_rng([61, FREE.index(kind), case])
        stands(
            draw(random, kind), Asked(float(random.choice([1.7, 2.0])), 2.0, float(random.choice([3.0, 10.0]))), random, 500, 1.05
        )


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_no_law_within_the_bounds_of_twenty_has_less_variance(kind):
    for case in range(20):
        random = np.random.default_rng([52, KINDS.index(kind), case])
        stands(draw(random, kind), ask(random), random, LAWS // 2)


def several(random, D=0.0):
    """Disturbed plants with two inputs and two outputs of orders 3 and 4, two knots, and gains with which they are stable."""
    plants = []
    for nx in (3, 4):
        A = random.normal(size=(nx, nx))
        A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
        B, C, K = (random.normal(size=shape) for shape in ((nx, 2), (2, nx), (nx, 2)))
        root = random.normal(size=(2, 2))
        plants.append(Disturbed(A, B, C, D * random.normal(size=(2, 2)), 0.3 * K, 0.1 * root @ root.T, np.array([0.01, 0.02])))
    X = random.normal(size=(3, 2, 2, 2)) * np.array([0.01, 0.0, 0.001])[:, None, None, None]
    for j, own in enumerate(plants):
        X[1, j] = 0.1 * np.linalg.inv(own.C @ np.linalg.solve(np.eye(len(own.A)) - own.A, own.B) + own.D)
    return plants, np.array([[0.97, 0.03], [0.02, 0.98]]), X


@pytest.mark.parametrize("D", [0.0, 0.1])
@pytest.mark.parametrize("Tf", [0.0, 0.25])
def test_the_gradient_is_the_slope_of_the_variance(D, Tf):
    stable = 0
    for seed in range(6):
        plants, weights, X = several(np.random.default_rng([53, seed]), D)
        variance = Variance(plants, weights, 0.1, Tf)
        value, slope = variance.log(X)
        if value < LOST:
            stable += 1
            assert value == pytest.approx(np.mean([np.log(np.trace(own)) for own in variance.covariance(X)]))
            numeric = approx_fprime(X.ravel(), lambda x, own=variance, X=X: own.log(x.reshape(X.shape))[0], 1e-7)
            np.testing.assert_allclose(slope.ravel(), numeric, atol=1e-4 * np.abs(numeric).max())
    assert stable >= 3


@pytest.mark.parametrize("broken", ["input", "output"])
def test_the_gradient_is_the_slope_of_the_penalty(broken):
    random = np.random.default_rng(54)

    class Plant:
        rho, gain = None, np.array([[1.0, 0.3], [-0.2, 0.5]])

        def response(self, omega):
            return (
                self.gain
                * np.exp(-0.3j * omega[:, None, None])
                / (1.0 + 1j * omega[:, None, None] * np.array([[1.0, 2.0], [0.5, 1.0]]))
            )

    omega = np.geomspace(0.01, 3.0, 12)
    parts = lambda w: np.stack([np.ones_like(w), 1.0 / (1j * w), 1j * w], axis=1)  # noqa: E731
    task = Task(Tuning([Plant(), Plant()], np.array([[0.7, 0.3], [0.2, 0.8]]), parts, omega, Bounds(1.3, 1.1, 1.2, broken)))
    X = random.normal(size=(3, 2, 2, 2)) * np.array([3.0, 1.0, 0.5])[:, None, None, None]
    value, slope = task.penalty(X, 0.1)
    over = np.maximum(task.excess(X) / 0.9 - 1.0, 0.0)  # every bound is broken somewhere
    assert np.all(over.max(axis=(0, 1)) > 0.0)
    assert value == pytest.approx(np.sum(over**2) / 2)
    numeric = approx_fprime(X.ravel(), lambda x: task.penalty(x.reshape(X.shape), 0.1)[0], 1e-7)
    np.testing.assert_allclose(slope.ravel(), numeric, atol=1e-5 * np.abs(numeric).max())


def test_sums_by_doubling_are_those_of_scipy_and_know_an_unstable_loop():
    random = np.random.default_rng(55)
    for radius in (0.3, 0.99, 0.99999):
        F = random.normal(size=(5, 5))
        F *= radius / np.abs(np.linalg.eigvals(F)).max()
        W, Q = (own @ own.T for own in random.normal(size=(2, 5, 2)))
        X, Y = lyapunov(F, W, Q)
        np.testing.assert_allclose(X, solve_discrete_lyapunov(F, W), rtol=1e-6, atol=1e-8 * np.abs(X).max())
        np.testing.assert_allclose(Y, solve_discrete_lyapunov(F.T, Q), rtol=1e-6, atol=1e-8 * np.abs(Y).max())
        assert lyapunov(F / radius * 1.00001, W) is None
        assert lyapunov(F / radius, W) is None
        assert lyapunov(F * np.inf, W) is None


# ---- the least that a linear law reaches --------------------------------------------------------------------------------


@pytest.mark.parametrize("late", [1, 2, 3])
def test_the_least_variance_is_that_of_the_textbook(late):
    """y(k) = a y(k-1) + b u(k-late) + e(k) + c e(k-1): the first `late` terms of (1 + c/z) / (1 - a/z) are nobody's to change."""
    a, b, c, variance = 0.9, 0.5, 0.3, 2.0
    A = np.zeros((late, late))
    A[0, 0], A[0, 1:2] = a, b
    A[np.arange(1, late - 1), np.arange(2, late)] = 1.0
    B = np.zeros((late, 1))
    B[-1] = b if late == 1 else 1.0
    plant = Disturbed(A, B, np.eye(1, late), [[0.0]], (a + c) * np.eye(late, 1), [[variance]], [0.0])
    expected = variance * (1.0 + sum(((a + c) * a**k) ** 2 for k in range(late - 1)))
    assert plant.least()[0, 0] == pytest.approx(expected, rel=1e-5)


def test_the_least_variance_beyond_a_wrong_zero():
    """A zero at -2 must not be cancelled: the variance is above that of the noise, which a law would reach that cancels it."""
    a, zero = 0.8, 2.0
    A, B = np.array([[a, zero], [0.0, 0.0]]), np.array([[1.0], [1.0]])
    plant = Disturbed(A, B, [[1.0, 0.0]], [[0.0]], [[a], [0.0]], [[1.0]], [0.0])
    assert plant.least()[0, 0] == pytest.approx(_least_by_responses(plant, 300, 120), rel=1e-3)
    assert plant.least()[0, 0] > 1.05


@pytest.mark.parametrize("seed", range(4))
def test_no_finite_response_does_better_and_a_long_one_does_as_well(seed):
    random = np.random.default_rng([56, seed])
    nx, n = 3, 1 + seed % 2
    A = random.normal(size=(nx, nx))
    A *= 0.7 / np.abs(np.linalg.eigvals(A)).max()
    B, C, K = (random.normal(size=shape) for shape in ((nx, n), (n, nx), (nx, n)))
    root = random.normal(size=(n, n))
    plant = Disturbed(A, B, C, np.zeros((n, n)), 0.5 * K, root @ root.T, random.uniform(0.01, 0.5, n))
    least, reached = np.trace(plant.least()), _least_by_responses(plant, 260, 90)
    assert least <= reached * (1.0 + 1e-6)
    assert least == pytest.approx(reached, rel=2e-3)


def _least_by_responses(plant, horizon, taps):
    """min over finite responses Q of E y'y with y = v - P Q v, v what y is without commands: linear least squares.

    Every stabilising law of a stable plant has this form; e counts by the root of its covariance, a load step as a step.
    """
    n, nu, ny = len(plant.A), plant.B.shape[1], len(plant.C)
    root = np.linalg.cholesky(plant.noise)
    powers = [np.eye(n)]
    for _ in range(horizon):
        powers.append(plant.A @ powers[-1])
    P = np.array([np.zeros((ny, nu)), *(plant.C @ M @ plant.B for M in powers[: horizon - 1])])
    noise = np.array([np.eye(ny), *(plant.C @ M @ plant.K for M in powers[: horizon - 1])]) @ root
    steps = np.cumsum(P, axis=0) @ np.diag(np.sqrt(plant.load))
    v = np.concatenate([noise, steps[:, :, plant.load > 0.0]], axis=2)  # (horizon, ny, nv)
    nv = v.shape[2]
    # y_k = v_k - sum_t sum_s P_(k-t-s) Q_t v_s: columns for each entry of each Q_t
    columns = []
    for t in range(taps):
        for i in range(nu):
            for j in range(ny):
                w = np.zeros((horizon, nv))
                w[t:] = v[: horizon - t, j]
                moved = signal.fftconvolve(P[:, :, i][:, :, None], w[:, None, :], axes=0)[:horizon]
                columns.append(moved.ravel())
    M = np.array(columns).T
    answer = np.linalg.lstsq(M, v.ravel(), rcond=None)[0]
    return float(np.sum((v.ravel() - M @ answer) ** 2))


@pytest.mark.parametrize("kind", KINDS)
def test_there_is_a_least_variance_of_plants_in_any_units(kind):
    for case in range(20):
        random = np.random.default_rng([58, KINDS.index(kind), case])
        plant = draw(random, kind).model()
        A, B, C, D = (own[0] for own in (plant.A, plant.B, plant.C, plant.D))
        noise, load = 10.0 ** random.uniform(-12.0, 6.0, 2)
        disturbed = Disturbed(A, B, C, D, np.zeros((len(A), 1)), [[noise]], [load])
        assert disturbed.least() is not None
        if case < 5:
            x = 10.0 ** random.uniform(-3.0, 3.0, len(A))  # other states, the same plant
            other = Disturbed(A / x[:, None] * x, B / x[:, None], C * x, D, np.zeros((len(A), 1)), [[noise]], [load])
            assert other.least()[0, 0] == pytest.approx(disturbed.least()[0, 0], rel=1e-4)


def test_a_model_without_noise_or_with_feedthrough_is_designed_for_too():
    plant = draw(np.random.default_rng(59), "resonance").model()
    found = design_pid(plant)
    assert found.margins.sensitivity.max() <= 1.6
    assert found.deviation[0, 0] > 0.0
    assert found.least is not None
    seeing = replace(plant, D=0.01 * np.abs(plant.C[:, :, :1] @ plant.B[:, :1]) + 1e-3, noise=np.eye(1))
    found = design_pid(seeing)
    assert found.margins.sensitivity.max() <= 1.6
    assert found.least is None


# ---- the model's own noise -------------------------------------------------------------------------------------------------


def test_a_long_run_of_the_model_varies_as_the_design_says():
    """Two inputs, two outputs in units of their own, coloured noise: the law runs sample by sample on the model."""
    random = np.random.default_rng(57)
    A = np.diag([0.9, 0.7, -0.3]) + 0.1 * random.normal(size=(3, 3))
    B, C = random.normal(size=(3, 2)), np.diag([1.0, 40.0]) @ random.normal(size=(2, 3))
    channels = tuple(tuple(Channel(name, "V", role) for name in names) for names, role in (("ab", "input"), ("yz", "output")))
    K = 0.4 * random.normal(size=(3, 2)) / [1.0, 40.0]
    model = constant_model(
        "two", 0.1, channels, (A, B, C, np.zeros((2, 2))), OperatingPoint(CONSTANT, [[0.0, 0.0]], [[0.0, 0.0]]),
        noise=np.array([[0.04, 0.5], [0.5, 40.0]]), predictor=Predictor((A - K @ C)[None], B[None], K[None]),
    )  # fmt: skip
    found = design_pid(model, load=np.zeros(2))
    _, y = rehearsal(model, np.zeros(2), np.zeros(2), 8000, 1).run(found.law)
    np.testing.assert_allclose(y[200:].std(axis=0), found.deviation[0], rtol=0.05)
    assert np.all(found.deviation[0] > 1.05 * np.sqrt(np.diagonal(model.noise)))
