"""Margins of a schedule that moves: exact where the answer is known, bounds in order, and witnesses that anyone can replay."""

from dataclasses import replace

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.robustness.lyapunov import scheduled_loop
from workbench.robustness.margins import margin
from workbench.robustness.schedules import ScheduledFalsified, falsified_schedule, scheduled_margin
from workbench.robustness.uncertain import UncertainLoop

pytestmark = pytest.mark.slow


def scalar(rho: float) -> UncertainLoop:
    """x+ = (0.3 + 0.4 rho + 0.1 delta) x"""
    return UncertainLoop([[0.3 + 0.4 * rho]], [[1.0]], [[1.0]], [0.1], [0])


def swing(rho: float) -> UncertainLoop:
    """x1+ = a(rho) x2, x2+ = -(b(rho) + 0.05 delta) x1: a falls where b grows, so that standing still the product a b is small.

    Moving from 0 to r and back at every sample, a = 0.9 meets b = 0.225 + 0.675 r: lost where 0.9 (b + 0.05 kappa) = 1. Nothing
    that moves by up to r does better, for 0.9 (0.225 + 0.675 r) is the largest a(rho) b(rho+), and two samples make a product.
    """
    a, b = 0.9 - 0.675 * rho, 0.225 + 0.675 * rho
    return UncertainLoop([[0.0, a], [-b, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [0.05], [0])


def lost(rate):
    return (1.0 / 0.9 - 0.225 - 0.675 * rate) / 0.05


def drawn(seed) -> tuple:
    """A small loop with random numbers, linear from one end of the schedule to the other; nodes and a rate."""
    random = np.random.default_rng(seed)
    n, p, q, K = random.integers(1, 4), random.integers(1, 4), random.integers(1, 3), random.integers(2, 5)
    A, B, C = random.normal(size=(2, n, n)), random.normal(size=(2, n, q)), random.normal(size=(p, n))
    A *= random.uniform(0.3, 0.8) / np.abs(np.linalg.eigvals(A)).max()
    lam, channel = random.uniform(0.02, 0.2, p), random.permutation(np.arange(p) % q)

    def at(rho):
        return UncertainLoop((1 - rho) * A[0] + rho * A[1], (1 - rho) * B[0] + rho * B[1], C, lam, channel)

    return at, np.linspace(0.0, 1.0, K), float(random.choice([0.0, 0.03, 0.3, 1.0]))


def simulated(at, found, periods) -> float:
    """Logarithm of how much a run grows: nothing but the loop's equation, sample by sample."""
    loops, grown = [at(float(value)) for value in found.rho], 0.0
    x = np.random.default_rng(0).normal(size=len(loops[0].A))
    for _ in range(periods):
        for loop, delta in zip(loops, found.delta, strict=True):
            e = delta * found.kappa * loop.lam * (loop.C @ x)
            x = loop.A @ x + loop.B @ np.array([e[loop.channel == j].sum() for j in range(loop.B.shape[1])])
            grown, x = grown + np.log(np.linalg.norm(x)), x / np.linalg.norm(x)
    return grown


# ---- exact answers --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [0.0, 0.5])
def test_one_state_is_lost_where_its_pole_is_largest(rate):
    """|0.7| + 0.1 kappa = 1 at the end of the schedule; moving does not help."""
    found = scheduled_margin(scalar, [0.0, 0.25, 0.5, 1.0], rate)
    assert found.falsified.kappa == pytest.approx(3.0, rel=1e-6)
    assert 3.0 / 1.05 <= found.certified.kappa <= 3.0
    assert not found.falsified.moves
    assert found.certified.holds(found.loop)


@pytest.mark.parametrize(("rate", "cells"), [(1.0, 1), (1.0, 4), (0.1, 10)])
def test_a_schedule_that_swings_loses_a_loop_that_is_stable_wherever_it_stands(rate, cells):
    nodes = np.linspace(0.0, 1.0, cells + 1)
    found = scheduled_margin(swing, nodes, rate)
    worst = found.falsified
    assert worst.moves
    assert worst.kappa == pytest.approx(lost(rate), rel=1e-5)
    assert lost(rate) / 1.06 < found.certified.kappa < lost(rate)
    assert found.certified.holds(found.loop)
    standing = min(margin(swing(rho)).falsified.kappa for rho in nodes)
    assert found.standing.kappa == pytest.approx(standing, rel=1e-5)
    assert worst.kappa < 0.95 * standing


def test_a_schedule_that_alone_loses_the_loop_is_said_to():
    def wild(rho):
        own = swing(rho)
        return replace(own, A=1.3 * own.A)

    loop = scheduled_loop(wild, [0.0, 1.0])
    still, worst = falsified_schedule(wild, loop, 1.0)
    assert worst.kappa == 0.0
    assert worst.replay(wild) >= 1.0
    assert still.kappa > 1.0
    with pytest.raises(InputError, match="loses the loop in the middle of the boxes"):
        scheduled_margin(wild, [0.0, 1.0], 1.0)


# ---- both sides -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_certified_is_never_above_falsified(seed):
    at, nodes, rate = drawn(seed)
    found = scheduled_margin(at, nodes, rate)
    worst = found.falsified
    assert found.certified.holds(found.loop)
    assert found.certified.kappa <= worst.kappa <= found.standing.kappa
    assert found.gap < 1.5
    assert np.abs(np.diff(worst.rho, append=worst.rho[0])).max() <= rate
    assert nodes[0] <= worst.rho.min()
    assert worst.rho.max() <= nodes[-1]
    assert np.abs(worst.delta).max() <= 1.0
    assert worst.replay(at) == pytest.approx(worst.growth, rel=1e-9)
    assert worst.growth >= 1.0
    assert abs(simulated(at, worst, 600) - simulated(at, worst, 300)) < 0.3  # at kappa the run neither dies out nor blows up


def test_what_is_certified_no_schedule_breaks():
    """The certificate's kappa under the falsified schedule, and under schedules and parameters drawn anew: every run dies out."""
    found = scheduled_margin(swing, [0.0, 0.5, 1.0], 0.5)
    worst = replace(found.falsified, kappa=found.certified.kappa)
    assert simulated(swing, worst, 1000) < -7.0
    random = np.random.default_rng(0)
    for _ in range(20):
        rho = np.abs((np.cumsum(random.uniform(-0.5, 0.5, 400)) + 1.0) % 2.0 - 1.0)  # folded into 0 to 1: no step is longer
        assert np.abs(np.diff(rho)).max() <= 0.5
        x = np.ones(2)
        for value in rho:
            x = swing(value).at(worst.kappa * random.choice([-1.0, 1.0], size=1)) @ x
        assert np.linalg.norm(x) < 1e-3


def test_a_schedule_faster_than_its_rate_is_no_witness():
    with pytest.raises(InputError, match=r"moves by 0\.5 a sample, not 0\.2"):
        ScheduledFalsified(1.0, 0.2, [0.0, 0.1, 0.3, 0.5], np.ones((4, 1)), 1.1)  # from the last sample to the first


def test_a_loop_that_nothing_loses_is_refused():
    def idle(rho):
        return UncertainLoop([[0.5, 0.0], [0.0, 0.3 + 0.1 * rho]], [[1.0], [0.0]], [[0.0, 1.0]], [0.1], [0])

    with pytest.raises(InputError, match="no parameters were found"):
        scheduled_margin(idle, [0.0, 1.0], 0.5)
