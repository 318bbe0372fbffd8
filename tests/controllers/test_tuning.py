"""Tuning under bounds: the published example, optimality against brute force, and bounds kept where nobody looked."""

import control
import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import brute

from controllers.pid import pid
from controllers.scheduled_pid import parts
from controllers.tuning import Tuning, cones, tune
from workbench.errors import InputError
from workbench.robustness.frozen import Bounds
from workbench.robustness.semidefinite import conic

TAU = 0.3


class WoodBerry:
    """The distillation column of Wood and Berry (1973) with its exact delays, continuous in time."""

    rho = None

    def response(self, omega):
        s = 1j * np.asarray(omega)
        entry = lambda gain, delay, lag: gain * np.exp(-delay * s) / (lag * s + 1)  # noqa: E731
        rows = [[entry(12.8, 1, 16.7), entry(-18.9, 3, 21.0)], [entry(6.6, 7, 10.9), entry(-19.4, 3, 14.4)]]
        return np.moveaxis(np.array(rows), 2, 0)

    @property
    def gain(self):
        return np.real(self.response(np.zeros(1))[0])


class Sampled:
    """A frozen plant given by python-control."""

    rho = 0.5

    def __init__(self, system):
        self.system = system

    def response(self, omega):
        return np.moveaxis(self.system(np.exp(1j * np.asarray(omega) * self.system.dt), squeeze=False), 2, 0)

    @property
    def gain(self):
        return np.real(self.system(1.0, squeeze=False))


def continuous(omega):
    """1, 1/s and s / (1 + tau s) at s = j omega."""
    s = 1j * np.asarray(omega)
    return np.stack([np.ones_like(s), 1 / s, s / (1 + TAU * s)], axis=-1)


def norms(plant, X, omega, laws=continuous):
    """|S|, |T|, |Q| with the loop broken at the output, written out once more."""
    P, K = plant.response(omega), np.einsum("wq,qab->wab", laws(omega), X[:, 0])
    S = np.linalg.inv(np.eye(P.shape[1]) + P @ K)
    return np.array([np.linalg.norm(M, 2, axis=(1, 2)).max() for M in (S, np.eye(P.shape[1]) - S, K @ S)])


@pytest.mark.slow
def test_the_published_mimo_example():
    """Boyd, Hast, Astrom (2016) section 6: Wood-Berry, 300 frequencies, |S|, |T| <= 1.4, |Q| <= 3 / sigma_min(P(0)).

    Printed: |(P(0) Ki)^-1| = 2.25, and the gains to four digits.
    """
    plant, omega = WoodBerry(), np.geomspace(1e-3, 1e3, 300)
    found = tune(Tuning([plant], np.ones((1, 1)), continuous, omega, Bounds(1.4, 1.4, 3.0, "output")))
    assert 1.0 / found.low_frequency[0] == pytest.approx(2.25, abs=0.006)
    Kp, Ki, Kd = found.X[:, 0]
    np.testing.assert_allclose(Kp, [[0.1750, -0.0470], [-0.0751, -0.0709]], atol=5e-4)
    np.testing.assert_allclose(Ki, [[0.0913, -0.0345], [0.0402, -0.0328]], atol=2e-4)
    np.testing.assert_allclose(Kd, [[0.1601, -0.0051], [0.0201, -0.1768]], atol=5e-4)
    least = np.linalg.svd(plant.gain, compute_uv=False)[-1]
    reached = norms(plant, found.X, np.geomspace(1e-3, 1e3, 3000)) / [1.4, 1.4, 3.0 / least]
    assert (reached < 1.002).all()  # also between the frequencies of the program
    assert (reached > 0.999).all()  # all three bind, as in the paper
    assert (np.diff(found.steps) > -1e-9).all()
    np.testing.assert_allclose(found.peaks[0], norms(plant, found.X, omega), rtol=1e-9)


@pytest.mark.slow
def test_the_published_decentralised_example_is_reached_or_beaten():
    """The same with diagonal gains; printed Ki = diag(0.0210, -0.0136): a local optimum, and ours may not be a worse one."""
    plant, omega = WoodBerry(), np.geomspace(1e-3, 1e3, 150)
    found = tune(Tuning([plant], np.ones((1, 1)), continuous, omega, Bounds(1.4, 1.4, 3.0, "output"), allowed=np.eye(2)))
    printed = np.linalg.svd(plant.gain @ np.diag([0.0210, -0.0136]), compute_uv=False)[-1]
    assert found.low_frequency[0] >= 0.99 * printed
    assert (found.X[:, 0][:, [0, 1], [1, 0]] == 0.0).all()


def first_order(dt=0.1, lag=1.0, gain=2.0, delay=3):
    """gain / (lag s + 1), sampled, behind `delay` samples."""
    sampled = control.sample_system(control.tf([gain], [lag, 1.0]), dt)
    return control.ss(sampled * control.tf([1.0], [1.0] + [0.0] * delay, dt))


def discrete(dt):
    return lambda omega: parts(omega, dt, 0.0)[:, :2]


def test_one_loop_reaches_what_brute_force_reaches():
    """A PI for a first-order plant with a delay: the largest Ki with |S| <= 1.4 over a fine grid of all (Kp, Ki)."""
    plant, omega = Sampled(first_order()), np.linspace(1e-3, 0.9999, 400) * np.pi / 0.1
    bounds = Bounds(1.4, 5.0, 1e3)
    found = tune(Tuning([plant], np.ones((1, 1)), discrete(0.1), omega, bounds))
    P, (one, integral) = plant.response(omega)[:, 0, 0], discrete(0.1)(omega).T

    def cost(gains):
        S = 1.0 / np.abs(1.0 + P * (gains[0] * one + gains[1] * integral))
        return -gains[1] if S.max() <= 1.4 else 0.0

    best = brute(cost, ((0.3, 0.6), (0.5, 0.7)), Ns=80, finish=None)
    assert found.X[1, 0, 0, 0] == pytest.approx(best[1], rel=0.01)


def test_it_is_robust_to_every_plant_of_the_list():
    omega = np.linspace(1e-3, 0.9999, 200) * np.pi / 0.1
    slow, fast = Sampled(first_order()), Sampled(first_order(gain=4.0, delay=5))
    bounds = Bounds(1.5, 1.5, 20.0, "output")
    alone = tune(Tuning([slow], np.ones((1, 1)), discrete(0.1), omega, bounds))
    # half the gains that leave |S| small at every frequency belong to unstable loops: a high gain with the sign turned
    assert 1.0 < alone.low_frequency[0] < 2.0
    assert norms(fast, alone.X, omega, discrete(0.1))[0] > 2.0  # what suits the one breaks the other
    both = tune(Tuning([slow, fast], np.ones((2, 1)), discrete(0.1), omega, bounds))
    for plant in (slow, fast):
        assert norms(plant, both.X, omega, discrete(0.1))[0] <= 1.5
    assert both.low_frequency[0] < alone.low_frequency[0]


def test_a_surface_brings_every_point_near_what_it_reaches_alone():
    """Gain 1 to 4 over the schedule: with the inverse gain in the basis the surface loses nothing, with a constant it must."""
    rho = np.linspace(1.0, 4.0, 4)
    plants = [Sampled(first_order(gain=g)) for g in rho]
    omega = np.linspace(1e-3, 0.9999, 200) * np.pi / 0.1
    bounds = Bounds(1.5, 1.5, 20.0)
    goals = np.array([tune(Tuning([p], np.ones((1, 1)), discrete(0.1), omega, bounds)).low_frequency[0] for p in plants])
    np.testing.assert_allclose(goals, goals[0], rtol=2e-3)  # t is P(0) Ki: the gain drops out
    surface = tune(Tuning(plants, 1.0 / rho[:, None], discrete(0.1), omega, bounds, goals=goals))
    assert surface.steps[-1] == pytest.approx(1.0, abs=5e-3)
    constant = tune(Tuning(plants, np.ones((4, 1)), discrete(0.1), omega, bounds, goals=goals))
    assert constant.steps[-1] < 0.45


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_bounds_are_kept_and_the_loop_is_stable_on_drawn_plants(seed):
    random, dt = np.random.default_rng(seed), 0.1
    omega = np.concatenate([np.geomspace(1e-4, 0.05, 20), np.linspace(0.06, 0.9999, 40)]) * np.pi / dt
    A = np.diag(random.uniform(0.3, 0.95, 4))
    plant = Sampled(control.ss(A, random.normal(size=(4, 2)), random.normal(size=(2, 4)), np.zeros((2, 2)), dt))
    found = tune(Tuning([plant], np.ones((1, 1)), lambda w: parts(w, dt, 0.2), omega, Bounds(1.6, 1.6, 5.0, "output")))
    dense = np.linspace(1e-3, 0.9999, 3000) * np.pi / dt
    assert norms(plant, found.X, dense, lambda w: parts(w, dt, 0.2))[0] <= 1.65
    law = pid(("a", "b"), ("c", "d"), ("r", "s"), dt, *found.X[:, 0], Tf=0.2).at()
    loop = plant.system.feedback(control.ss(law.A, -law.B[:, 2:], law.C, -law.D[:, 2:], dt))
    assert np.abs(loop.poles()).max() < 1.0


def test_what_cannot_be_designed_is_refused():
    omega = np.geomspace(1e-3, 30.0, 50)
    singular = Sampled(control.ss([[0.5]], [[1.0, 2.0]], [[1.0], [3.0]], np.zeros((2, 2)), 0.1))
    with pytest.raises(InputError, match=r"steady gains at 0\.5 cannot move every output on its own"):
        tune(Tuning([singular], np.ones((1, 1)), discrete(0.1), omega))
    up, down = Sampled(first_order()), Sampled(first_order(gain=-2.0))
    with pytest.raises(InputError, match="no integral action of this structure suits every plant"):
        tune(Tuning([up, down], np.ones((2, 1)), discrete(0.1), omega))
    with pytest.raises(InputError, match="broken at the 'middle'"):
        Bounds(broken="middle")


@pytest.mark.filterwarnings("ignore:Solution may be inaccurate")
@pytest.mark.parametrize("k", [1, 2, 4])
@pytest.mark.parametrize("kind", [float, complex])
def test_cones_say_what_the_matrix_inequalities_say(k, kind):
    """The largest step along a direction, by CVXPY with the Hermitian matrices as they are, and by bisection on eigenvalues."""
    random = np.random.default_rng(k)

    def hermitian(shape):
        M = random.normal(size=shape) + (1j * random.normal(size=shape) if kind is complex else 0.0)
        return (M + np.conj(np.swapaxes(M, -1, -2))) / 2.0

    F, f = hermitian((5, 3, k, k)), np.tile(3.0 * np.eye(k), (5, 1, 1)).astype(kind)
    c = np.array([1.0, 0.3, -0.2])
    x = conic(c, [*cones(F, f), *cones(-np.eye(3)[:, :, None, None], np.full((3, 1, 1), 9.0))])
    v = cp.Variable(3)
    sums = [f[m] + sum(v[i] * F[m, i] for i in range(3)) for m in range(5)]
    wrapped = [cp.bmat([[cp.real(M), -cp.imag(M)], [cp.imag(M), cp.real(M)]]) if kind is complex else M for M in sums]
    problem = cp.Problem(cp.Maximize(c @ v), [(W + W.T) / 2 >> 0 for W in wrapped] + [v <= 9.0])
    problem.solve(solver=cp.CLARABEL)
    assert c @ x == pytest.approx(problem.value, rel=1e-5)
    least = [np.linalg.eigvalsh(f[m] + np.tensordot(x, F[m], 1)).min() for m in range(5)]
    assert min(least) == pytest.approx(0.0, abs=1e-6)  # on the boundary, and not beyond
