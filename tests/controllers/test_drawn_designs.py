"""Designs of plants that nobody has chosen: each ends, keeps its bounds before another judge, and beats laws drawn at random."""

import time

import control
import numpy as np
import pytest
from scipy import signal

from controllers.pid import pid
from controllers.pid_design import FrozenPoint, Loads, design_pid
from controllers.tuning import Tuning, tune
from controllers.variance import Variance
from tests.controllers.drawn import (
    COMPLEMENTARY,
    EFFORT,
    KINDS,
    LAWS,
    SENSITIVITY,
    Asked,
    Drawn,
    ask,
    best_at_random,
    draw,
    judge,
)
from workbench.robustness.frozen import Bounds

LONGEST = 20.0  # s of the processor, for one design
ROUNDING = 1e-4  # by which a peak between the frequencies of the program may pass a bound


def designed(plant, asked):
    """Kp, Ki, Kd (1 3), within the time that a user waits."""
    begun = time.process_time()
    law = design_pid(plant.model(), bounds=asked.bounds, objective="integral").law
    assert time.process_time() - begun < LONGEST, f"{plant} {asked}"
    return np.array([[law.Kp[0, 0, 0], law.Ki[0, 0, 0], law.Kd[0, 0, 0]]])


def stands(plant, asked, best):
    """A law exists (integral action alone, if nothing else), so one is found; and by the judge it keeps what was asked."""
    found = judge(plant, designed(plant, asked))
    assert found.kept(asked, -ROUNDING)[0], f"{plant} {asked}: {found}"
    assert found.action[0] >= 0.99 * best, f"{plant} {asked}: {found.action[0]:.4g}, at random {best:.4g}"


@pytest.mark.parametrize("kind", KINDS)
def test_a_design_keeps_its_bounds_and_beats_laws_at_random(kind):
    random = np.random.default_rng([41, KINDS.index(kind)])
    plant, asked = draw(random, kind), ask(random)
    stands(plant, asked, best_at_random(plant, [asked], random, 300)[0])


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_hundred_designs(kind):
    for case in range(10):
        random = np.random.default_rng([42, KINDS.index(kind), case])
        plant, bounds = draw(random, kind), [ask(random) for _ in range(2)]
        for asked, best in zip(bounds, best_at_random(plant, bounds, random, LAWS), strict=True):
            stands(plant, asked, best)


def monotone(seed):
    """Bounds loosened step by step, one or all at a time: no refusal, and never less integral action."""
    random = np.random.default_rng([43, seed])
    plant = draw(random, KINDS[seed % len(KINDS)])
    at, reached = np.array([0, 0, 0]), 0.0
    ladders = SENSITIVITY, COMPLEMENTARY, EFFORT
    for _ in range(6):
        asked = Asked(*(ladder[min(i, len(ladder) - 1)] for ladder, i in zip(ladders, at, strict=True)))
        action = judge(plant, designed(plant, asked)).action[0]
        assert action >= 0.985 * reached, f"{plant} {asked}: {action:.5g}, tighter {reached:.5g}"
        reached = max(reached, action)
        at += random.integers(0, 2, 3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_looser_bounds_are_never_worse(seed):
    monotone(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10, 18))
def test_looser_bounds_are_never_worse_on_more_plants(seed):
    monotone(seed)


@pytest.mark.slow
def test_what_was_refused_or_did_not_end():
    """1 / (s^2 + 0.6 s + 1): effort 10 was found and 20 refused. All efforts now, and never less."""
    second_order = signal.cont2discrete(([1.0], [1.0, 0.6, 1.0]), 0.1, "zoh")
    plant, reached = Drawn("resonance", second_order[0][0], second_order[1], 0.1, "zeta 0.3"), 0.0
    for effort in (3.0, 10.0, 20.0, 50.0):
        asked = Asked(1.6, 1.6, effort)
        stands(plant, asked, reached)
        reached = judge(plant, designed(plant, asked)).action[0]


def loops(point, Tf):
    return Variance([point.disturbed(Loads(np.zeros(point.B.shape[1]), 1.0))], np.ones((1, 1)), point.dt, Tf)


@pytest.mark.parametrize("feedthrough", [0.0, 0.1])
@pytest.mark.parametrize("Tf", [0.0, 0.25])
def test_poles_are_those_of_python_control(feedthrough, Tf):
    random, dt = np.random.default_rng(5), 0.1
    A, B, C = np.diag([0.9, 0.6, -0.2]), random.normal(size=(3, 3)), random.normal(size=(2, 3))
    D, scale = feedthrough * random.normal(size=(2, 3)), np.array([2.0, 0.5])
    Kp, Ki, Kd = (random.normal(size=(3, 2)) * size for size in (0.3, 0.5, 0.02))
    point = FrozenPoint(None, dt, A, B, C, D, scale, np.zeros((3, 2)), np.zeros((2, 2)))
    found = loops(point, Tf).poles(np.stack([Kp, Ki, Kd])[:, None])[0]
    law = pid("abc", "de", ("r", "s"), dt, Kp, Ki, Kd, Tf=Tf).at()
    plant = control.ss(A, B, C / scale[:, None], D / scale[:, None], dt)
    expected = control.feedback(plant, control.ss(law.A, -law.B[:, 2:], law.C, -law.D[:, 2:], dt)).poles()
    for pole in found:  # it remembers y beside the filter: poles at 0
        assert np.abs(expected - pole).min() < 1e-8
    assert np.sort(np.abs(expected))[-len(found) :] == pytest.approx(np.sort(np.abs(found)), abs=1e-8)


class Between:
    """A plant with a peak so narrow that no frequency of the program sees it."""

    rho = None
    A, B = np.array([[0.0, 1.0], [-0.9998, 1.2]]), np.array([[0.0], [1.0]])
    C = np.array([[0.1, 0.7]])

    def response(self, omega):
        z = np.exp(1j * np.asarray(omega))
        return np.array([self.C @ np.linalg.solve(v * np.eye(2) - self.A, self.B) for v in z])

    @property
    def gain(self):
        return np.real(self.response(np.zeros(1))[0])


def test_a_step_that_loses_the_loop_is_never_taken():
    """With frequencies that miss the resonance: without poles the answer may be any loop, with them it is a stable one."""
    plant = Between()
    point = FrozenPoint(None, 1.0, plant.A, plant.B, plant.C, np.zeros((1, 1)), np.ones(1), np.zeros((2, 1)), np.zeros((1, 1)))
    looked = []

    def closed(X):
        poles = loops(point, 0.0).poles(X)[0]
        looked.append(np.abs(poles).max())
        return np.unique(np.abs(np.angle(poles))) + 1e-6 if looked[-1] < 1.0 else None

    def parts(omega):
        z = np.exp(1j * omega)
        return np.stack([np.ones_like(z), 1.0 / (z - 1.0)], axis=-1)

    omega = np.array([1e-4, 1e-3, 1e-2, 0.1, 0.2, 0.4, 1.4, 2.0, 3.0])
    found = tune(Tuning([plant], np.ones((1, 1)), parts, omega, Bounds(2.0, 2.0, 5.0), closed=closed))
    for X in found.path:
        assert np.abs(loops(point, 0.0).poles(X)).max() < 1.0
    blind = tune(Tuning([plant], np.ones((1, 1)), parts, omega, Bounds(2.0, 2.0, 5.0)))
    lost = np.abs(loops(point, 0.0).poles(blind.X)).max()
    assert lost > 1.0  # the frequencies alone do lose it: the poles are what keeps it
