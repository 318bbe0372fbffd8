"""A margin, a certificate and a box are the same in whatever units states, inputs, outputs and parameters are counted.

Every channel has its own power of ten, of both signs, up to 1e9: metres against newtons, bars against strokes of a valve.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete

from controllers.pid import pid
from tests.workbench.intervals.test_semantics import STRUCTURES, measured
from tests.workbench.robustness.loops import DT, model
from tests.workbench.robustness.test_lyapunov import turning
from workbench.intervals.boxes import smallest_box
from workbench.intervals.regressors import ARX, FIR
from workbench.intervals.semantics import InclusionAll, InclusionExact, InclusionPaper, Overlap
from workbench.robustness.loop import close
from workbench.robustness.lyapunov import largest, scheduled_loop
from workbench.robustness.margins import Margin, falsified, margin
from workbench.robustness.schedules import scheduled_margin
from workbench.robustness.uncertain import UncertainLoop

MOST = 9  # powers of ten


def units(random, count, most=MOST):
    """Factors 10^-most to 10^most, one for each channel."""
    return 10.0 ** random.uniform(-most, most, count)


def drawn(random) -> UncertainLoop:
    """A stable loop with random numbers, and one parameter in three of zero radius."""
    n, p, q = int(random.integers(1, 6)), int(random.integers(1, 5)), int(random.integers(1, 3))
    A = random.normal(size=(n, n))
    A *= random.uniform(0.3, 0.97) / np.abs(np.linalg.eigvals(A)).max()
    lam = random.uniform(0.02, 0.2, p) * np.append(1.0, random.integers(0, 3, p - 1) > 0)
    return UncertainLoop(A, random.normal(size=(n, q)), random.normal(size=(p, n)), lam, random.permutation(np.arange(p) % q))


def counted(loop: UncertainLoop, x, w, z) -> UncertainLoop:
    """The loop with other units of its states, of what enters and of its regressors."""
    of = loop.channel.astype(int)
    return replace(
        loop, A=loop.A * x[:, None] / x, B=loop.B * x[:, None] / w, C=loop.C * z[:, None] / x, lam=loop.lam * w[of] / z
    )


def closed(seed, outputs, of_y, of_u) -> UncertainLoop:
    """As many machines of two lags as outputs, coupled, 10 % wide, under P and I; y and u in other units."""
    random = np.random.default_rng(seed)
    names = [f"y{j}" for j in range(outputs)], [f"u{j}" for j in range(outputs)]
    structure, machines = ARX(order=2, delta=bool(seed % 2), bias=False), []
    form = structure.form("y", list(names[1]))
    for j, name in enumerate(names[0]):
        rows = []
        bottom = np.polymul([random.uniform(0.2, 1.0), 1.0], [random.uniform(0.05, 0.3), 1.0])
        for i in range(outputs):
            b, a, _ = cont2discrete(([1.0 if i == j else random.uniform(-0.2, 0.2)], bottom), DT)
            rows.append(np.ravel(b)[1:] * of_y[j] / of_u[i])
        theta = np.linalg.solve(form.T.T, np.concatenate([-a[1:], *rows]) - form.d)
        machines.append(model(name, names[1], structure, theta, 0.1 * np.abs(theta)))
    into = of_u[:, None] / of_y
    gains = random.uniform(0.5, 2.0, outputs)
    return close(
        machines, pid(*reversed(names), [f"r{j}" for j in range(outputs)], DT, np.diag(gains) * into, np.diag(gains) * into)
    )


def same(one: Margin, other: Margin):
    """Every number that a margin states, within 1 %."""
    for key in ("certified", "falsified", "frozen"):
        assert getattr(other, key).kappa == pytest.approx(getattr(one, key).kappa, rel=0.01), key
    assert other.certified.holds(other.loop)
    assert other.falsified.replay(other.loop) == pytest.approx(1.0, abs=1e-3)


def in_any_units(random):
    loop = drawn(random)
    one = margin(loop)
    n, q, p = len(loop.A), loop.B.shape[1], len(loop.lam)
    same(one, margin(counted(loop, units(random, n), units(random, q), units(random, p))))
    return loop, one


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2])
def test_margins_are_the_same_in_any_units(seed):
    in_any_units(np.random.default_rng(seed))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 125))
def test_margins_of_many_loops_are_the_same_in_any_units(seed):
    """And in boxes of any width."""
    random = np.random.default_rng(seed)
    loop, one = in_any_units(random)
    wide = float(units(random, 1)[0])
    other = margin(replace(loop, lam=wide * loop.lam))
    for key in ("certified", "falsified", "frozen"):
        assert getattr(other, key).kappa * wide == pytest.approx(getattr(one, key).kappa, rel=0.01), key


@pytest.mark.parametrize(
    ("seed", "outputs"), [(1, 1), pytest.param(0, 1, marks=pytest.mark.slow), pytest.param(1, 2, marks=pytest.mark.slow)]
)
def test_the_loop_of_a_law_has_one_margin(seed, outputs):
    """The same machine and law, with outputs and inputs counted in other units."""
    random, ones = np.random.default_rng(seed), np.ones(outputs)
    one = margin(closed(seed, outputs, ones, ones))
    same(one, margin(closed(seed, outputs, units(random, outputs), units(random, outputs))))
    same(one, margin(closed(seed, outputs, 1e9 * ones, 1e-9 * ones)))


def test_parameters_of_zero_radius_change_nothing():
    """Nor do those whose regressor does not move; what is found has a place for them."""
    loop = drawn(np.random.default_rng(11))
    n, p = len(loop.A), len(loop.lam)
    more = replace(
        loop, C=np.vstack([loop.C[:1], np.zeros((1, n)), loop.C]), lam=np.concatenate([[0.0, 0.3], loop.lam]),
        channel=np.concatenate([[0, 0], loop.channel]),
    )  # fmt: skip
    one, other = margin(loop), margin(more)
    same(one, other)
    assert other.falsified.delta.shape[1] == other.frozen.delta.size == p + 2
    assert other.falsified.replay(more) == pytest.approx(other.falsified.growth, rel=1e-6)
    assert not other.falsified.delta[:, :2].any()
    assert not replace(other.certified, kappa=1.01 * other.falsified.kappa).holds(other.loop)


def in_units(of_rho, of_x):
    """`turning` with other units of the schedule, of a state and of a regressor, and a parameter of zero radius."""

    def at(rho):
        loop = counted(turning(rho / of_rho), np.array([of_x, 1.0]), np.ones(1), np.array([of_x, 1.0]))
        return replace(loop, C=np.vstack([loop.C, loop.C[:1]]), lam=np.append(loop.lam, 0.0), channel=np.append(loop.channel, 0))

    return at


OTHERS, NODES = [(1e9, 1e-9), (1e-9, 1e9)], np.linspace(0.0, 1.0, 5)


@pytest.mark.parametrize(("of_rho", "of_x"), OTHERS)
def test_certificates_in_motion_are_the_same_in_any_units(of_rho, of_x):
    one = largest(scheduled_loop(turning, NODES), 0.05, 12.0, 1.02)
    loop = scheduled_loop(in_units(of_rho, of_x), of_rho * NODES)
    other = largest(loop, of_rho * 0.05, 12.0, 1.02)
    assert other.kappa == pytest.approx(one.kappa, rel=0.01)
    assert other.holds(loop)
    assert not replace(other, kappa=1.5 * other.kappa).holds(loop)


@pytest.mark.slow
@pytest.mark.parametrize(("of_rho", "of_x"), OTHERS)
def test_margins_in_motion_are_the_same_in_any_units(of_rho, of_x):
    one = scheduled_margin(turning, NODES[::2], 0.05)
    other = scheduled_margin(in_units(of_rho, of_x), of_rho * NODES[::2], of_rho * 0.05)
    for key in ("certified", "falsified", "standing"):
        assert getattr(other, key).kappa == pytest.approx(getattr(one, key).kappa, rel=0.01), key


@pytest.mark.parametrize("structure", [*STRUCTURES, ARX(2, bias=False), FIR(3, bias=False)], ids=str)
@pytest.mark.parametrize("semantics", [Overlap(), InclusionExact(), InclusionAll(), InclusionPaper()], ids=lambda s: s.name)
def test_the_smallest_box_is_the_same_in_any_units(structure, semantics):
    if isinstance(semantics, InclusionPaper) and getattr(structure, "delta", False):
        pytest.skip("the paper's inclusion has no delta form")
    random = np.random.default_rng(5)
    error = 1e-6 if isinstance(semantics, InclusionPaper) or not structure.bias else 0.02
    one = smallest_box(measured(structure, error=error), semantics)
    for of_y, of_u in [(1e9, 1e-9), (1e-9, 1e9), (1e9, 1.0), (1.0, 1e9), units(random, 2)]:
        S = measured(structure, error=error, scale=of_y, of_u=of_u)
        other = smallest_box(S, semantics)
        assert other.mean_radius == pytest.approx(of_y * one.mean_radius, rel=1e-6)


def test_a_search_ends_beside_a_parameter_that_does_nothing():
    """`falsified` itself takes loops with parameters of zero radius."""
    loop = UncertainLoop([[0.3, -0.8], [1.0, 0.0]], [[1.0], [0.0]], np.eye(2), [0.1, 0.0], [0, 0])
    found = margin(loop)
    assert falsified(found.loop, found.frozen).kappa == pytest.approx(found.falsified.kappa, rel=1e-3)
