"""Certificates over the schedule: exact where the answer is known, true of every run, and rejected when broken."""

from dataclasses import replace
from math import comb

import numpy as np
import pytest

from tests.workbench.robustness.loops import robot
from workbench.errors import InputError
from workbench.robustness.lyapunov import ScheduledCertificate, certificate, largest, moves, products, scheduled_loop
from workbench.robustness.margins import margin
from workbench.robustness.uncertain import UncertainLoop


def turning(rho: float) -> UncertainLoop:
    """A lightly damped turn whose axes change with the schedule: each is stable, a fast schedule is not; quadratic in rho."""
    A = np.array([[0.2 + 0.3 * rho, 0.9 - 0.5 * rho], [-0.3 - 0.5 * rho, 0.4 - 0.2 * rho + 0.1 * rho**2]])
    return UncertainLoop(A, [[1.0], [0.3 * rho]], [[0.5, 0.2], [0.1, 0.4]], [0.1, 0.05], [0, 0])


NODES = np.linspace(0.0, 1.0, 9)


def scalar(rho: float) -> UncertainLoop:
    """x+ = (0.3 + 0.4 rho + 0.1 delta) x"""
    return UncertainLoop([[0.3 + 0.4 * rho]], [[1.0]], [[1.0]], [0.1], [0])


def test_one_state_reaches_its_exact_margin():
    """|0.7| + 0.1 kappa < 1 at the end of the schedule: no P(rho) does better, and none does worse by more than its nodes."""
    loop = scheduled_loop(scalar, NODES)
    assert certificate(loop, 2.9, 0.01) is not None
    assert certificate(loop, 3.01, 0.01) is None


@pytest.mark.slow
def test_a_certificate_is_true_of_every_run():
    """Random schedules within the rate and random parameters: x'P(rho) x falls at every sample, also where cells meet."""
    loop = scheduled_loop(turning, NODES)
    rate = 0.03
    found = largest(loop, rate, 12.0)
    random, x, rho = np.random.default_rng(0), np.array([1.0, -0.5]), 0.4
    own = turning(0.5).balance()

    def P(at):
        return np.array([[np.interp(at, NODES, found.P[:, i, j]) for j in range(2)] for i in range(2)])

    for k in range(3000):
        step = rate * (random.choice([-1.0, 1.0]) if k % 50 else 0.0)
        after = float(np.clip(rho + step, 0.0, 1.0))
        A = turning(rho).moved(own).at(found.kappa * random.choice([-1.0, 1.0], size=2))
        y = A @ x
        assert y @ P(after) @ y < x @ P(rho) @ x
        x, rho = y / np.linalg.norm(y), after


@pytest.mark.slow
def test_a_faster_schedule_leaves_less_and_no_rate_is_the_frozen_bound():
    loop = scheduled_loop(turning, NODES)
    slow, fast = (largest(loop, rate, 12.0, 1.02).kappa for rate in (1e-3, 0.125))
    assert fast < 0.99 * slow
    worst = min(margin(turning(rho)).falsified.kappa for rho in NODES)
    assert 0.7 * worst < slow < worst


@pytest.mark.slow
def test_more_nodes_come_nearer():
    """The robot as it is between the lightest and the heaviest platform: a P of one piece does not do, one of three does."""
    at = robot([0.7, 1.5])
    assert certificate(scheduled_loop(at, [0.7, 1.5]), 1.4, 0.002) is None
    assert certificate(scheduled_loop(at, [0.7, 0.95, 1.2, 1.5]), 1.4, 0.002) is not None


def test_the_blocks_are_the_coefficients_of_what_they_prove():
    """M(l)'P(l) M(l) summed from the products, against the polynomial itself."""
    random = np.random.default_rng(2)
    P, M = random.normal(size=(2, 3, 3)), random.normal(size=(3, 3, 4))
    for share in random.uniform(size=5):
        bernstein = [[comb(d, k) * share**k * (1.0 - share) ** (d - k) for k in range(d + 1)] for d in (1, 2, 5)]
        own, along = np.tensordot(bernstein[0], P, 1), np.tensordot(bernstein[1], M, 1)
        summed = sum(bernstein[2][k] * float(w) * M[i].T @ P[e] @ M[j] for k in range(6) for e, i, j, w in products(k))
        np.testing.assert_allclose(summed, along.T @ own @ along)


@pytest.mark.parametrize("rate", [0.07, 0.25, 2.0])
def test_what_the_schedule_crosses_is_charged(rate):
    """P(rho+) - P(rho) of every move is at most the W that `moves` asks for; P of one number, over cells of unequal width."""
    random, nodes = np.random.default_rng(2), np.array([0.0, 0.1, 0.3, 0.6, 1.0])
    P = random.normal(size=5)
    cell, crossed, sign = moves(nodes, rate)
    W = np.full(4, -np.inf)
    np.maximum.at(W, cell, rate * sign * (np.diff(P) / np.diff(nodes))[crossed])
    rho = random.uniform(0.0, 1.0, 2000)
    after = np.clip(rho + random.uniform(-rate, rate, 2000), 0.0, 1.0)
    change = np.interp(after, nodes, P) - np.interp(rho, nodes, P)
    assert np.all(change <= W[np.searchsorted(nodes, rho, side="right") - 1] + 1e-12)


def test_a_broken_certificate_is_rejected():
    loop = scheduled_loop(turning, NODES)
    good = largest(loop, 0.01, 12.0)
    assert good.holds(loop)
    assert not replace(good, kappa=3.0 * good.kappa).holds(loop)
    assert not replace(good, rate=0.125).holds(loop)
    assert not replace(good, W=0.0 * good.W).holds(loop)
    assert not replace(good, W=-good.W).holds(loop)
    assert not replace(good, rate=0.0).holds(loop)  # W for a schedule that stands still is 0
    assert not replace(good, D=0.0 * good.D).holds(loop)
    W = good.W.copy()
    W[3, 0, 1] *= 1.0 + 1e-9  # not symmetric
    assert not replace(good, W=W).holds(loop)
    assert not replace(good, W=good.W[:-1], D=good.D[:-1]).holds(loop)
    for i in range(len(NODES)):
        P = good.P.copy()
        P[i] = -P[i]
        assert not replace(good, P=P).holds(loop)
    P = good.P.copy()
    P[4] *= 3.0
    assert not replace(good, P=P).holds(loop)
    assert not good.holds(replace(loop, A=1.3 * loop.A))
    middle = loop.A.copy()
    middle[7] *= 1.5  # the middle of a cell alone
    assert not good.holds(replace(loop, A=middle))


def test_odd_schedules_are_refused():
    with pytest.raises(InputError, match="1 nodes"):
        scheduled_loop(turning, [0.5])
    with pytest.raises(InputError, match=r"not quadratic between 0 and 0\.5"):
        scheduled_loop(lambda rho: replace(scalar(0.0), A=np.array([[0.3 + 0.2 * abs(rho - 0.3)]])), [0.0, 0.5, 1.0])
    with pytest.raises(InputError, match=r"kink at 0\.3, between two nodes"):
        scheduled_loop(scalar, [0.0, 0.5, 1.0], kinks=[0.3])
    scheduled_loop(scalar, [0.0, 0.3, 1.0], kinks=[0.3, 0.0, 1.0, 2.0])
    with pytest.raises(InputError, match="another function of the state"):
        scheduled_loop(lambda rho: replace(scalar(rho), C=np.array([[1.0 + rho]])), NODES)
    with pytest.raises(InputError, match="rate"):
        certificate(scheduled_loop(scalar, NODES), 1.0, -0.2)
    with pytest.raises(InputError, match="no certificate for a schedule"):
        largest(scheduled_loop(lambda rho: replace(scalar(0.0), A=np.array([[0.7 + 0.4 * rho]])), NODES), 0.01, 1.0)


def test_a_certificate_of_other_shapes_is_none():
    loop = scheduled_loop(scalar, NODES)
    good = certificate(loop, 1.0, 0.01)
    assert isinstance(good, ScheduledCertificate)
    assert not replace(good, P=good.P[:-1]).holds(loop)
