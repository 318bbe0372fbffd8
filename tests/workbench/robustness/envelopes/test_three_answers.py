"""Kernel, adversary and dual side by side: closed forms, the exact hull of the open-loop module, every run within them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.workbench.robustness.envelopes.courses import both_sides, deviation, drawn, scalar, some, within
from workbench.intervals import envelopes as open_loop
from workbench.intervals import propagation
from workbench.intervals.propagation import Recursion
from workbench.robustness.envelopes.adversary import worst
from workbench.robustness.envelopes.course import Course, nominal, replay
from workbench.robustness.envelopes.dual import dual
from workbench.robustness.envelopes.kernel import kernel

SEEDS = st.integers(0, 10**6)


def recursion(seed, n=2, p=3, N=60, through=1.0) -> tuple[Recursion, Course]:
    """The same open-loop recursion to both modules."""
    random = np.random.default_rng(seed)
    A = random.standard_normal((2, n, n))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max(axis=1)[:, None, None]
    A[1] = A[0] + 0.1 * (A[1] - A[0])
    r = Recursion(
        A, random.standard_normal(n), random.standard_normal((2, n)), random.standard_normal((p, n)),
        0.05 * random.uniform(0, 1, (2, p)), random.standard_normal((N, n)), random.standard_normal(N),
        random.standard_normal((N, p)), random.integers(0, 2, N), random.standard_normal(n), np.zeros((n, 0)), through,
    )  # fmt: skip
    both = (2, 1, 1)
    course = Course(
        r.A, np.tile(r.b[:, None], both), np.tile(r.C, both), r.c[:, None], np.full(both, through), r.lam, np.zeros(p), r.mode,
        r.q, r.g[:, None], r.f, r.start, ("y",),
    )  # fmt: skip
    return r, course


# ---- closed forms ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_one_state_lies_between_two_products():
    """v(k) in 2 prod (a(l) -+ lam(l)) for slopes a > lam: upward the kernel is exact as well, and all three know it."""
    random = np.random.default_rng(0)
    a, lam = random.uniform(0.6, 1.0, 40), random.uniform(0.0, 0.1, 40)
    course = scalar(a, lam, 40, start=2.0)
    run, outer = nominal(course), kernel(course)
    high, low = 2.0 * np.cumprod(np.append(1.0, a + lam))[:40], 2.0 * np.cumprod(np.append(1.0, a - lam))[:40]
    np.testing.assert_allclose(run.v[:, 0] + outer.half[:, 0], high, rtol=1e-8)
    np.testing.assert_allclose(outer.state[:, 0], high - run.v[:, 0], rtol=1e-8, atol=1e-12)
    for k in (1, 7, 39):
        found = worst(course, both_sides(course, k))
        np.testing.assert_allclose(found.value, [high[k], low[k]], rtol=1e-12)
        above, below = (dual(course, found, i) for i in range(2))
        assert high[k] <= above.bound <= high[k] + 1e-4 * (high[k] - run.v[k, 0])
        assert -below.bound <= low[k]
        if k < 39:  # where the slowest run is left far behind by the others the relaxation is wider than it
            assert -below.bound >= low[k] - 1e-3 * (run.v[k, 0] - low[k])


def test_the_signal_itself_sees_the_equation_error():
    """v = x + F w at the instant: (a + lam)^k 2 (1 + F lam) for F > 0, and the other sign of delta for F < 0."""
    for through in (0.7, -0.7):
        course = scalar(0.8, 0.05, 20, start=2.0, through=through)
        found = worst(course, [("v", 19, 1)])
        truth = 2.0 * 0.85**19 * (1.0 + 0.7 * 0.05)
        assert found.value[0] == pytest.approx(truth, rel=1e-12)
        assert truth <= dual(course, found).bound <= truth * (1.0 + 1e-4)
        assert nominal(course).v[19, 0] + kernel(course).half[19, 0] == pytest.approx(truth, rel=1e-8)


def test_a_set_point_that_stands_meets_the_slowest_and_the_fastest_pole():
    """x+ = (a + delta lam) x + 1 from rest: between (1 - (a -+ lam)^k) / (1 - a +- lam)."""
    course, k = scalar(0.9, 0.04, 200, q=1.0), 199
    found = worst(course, both_sides(course, k))
    truth = [(1.0 - a**k) / (1.0 - a) for a in (0.94, 0.86)]
    np.testing.assert_allclose(found.value, truth, rtol=1e-12)
    outer = kernel(course)
    assert outer.gain == pytest.approx(0.4, rel=1e-6)
    above, below = dual(course, found, 0, outer), dual(course, found, 1, outer)
    assert above.first > 0  # a window: what happened before is the kernel's box
    assert truth[0] <= above.bound <= truth[0] * (1.0 + 1e-3)
    assert truth[1] * (1.0 - 1e-3) <= -below.bound <= truth[1]


# ---- the open-loop module as a peer ---------------------------------------------------------------------------------


@pytest.mark.parametrize("through", [1.0, 0.0, -0.7])
@pytest.mark.parametrize("seed", range(3))
def test_two_states_have_the_exact_hull_of_the_open_loop_module(seed, through):
    r, course = recursion(seed, through=through)
    hull, old = propagation.hull(r), propagation.kernel(r)
    outer, run = kernel(course), nominal(course)
    np.testing.assert_allclose(run.v[:, 0], open_loop.nominal(r).y, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(run.v[:, 0] + outer.half[:, 0], old.high, rtol=1e-8, atol=1e-8)  # widened by 1e-9 of itself
    assert outer.gain == pytest.approx(old.gain, rel=1e-9)
    for k in (3, 59):
        found = worst(course, both_sides(course, k), starts=32)
        np.testing.assert_allclose(found.value, [hull.high[k], hull.low[k]], atol=1e-7)
        same = open_loop.worst_sequences(r, [k])
        np.testing.assert_allclose(np.sort(found.value), np.sort(same.y[:, k]), rtol=1e-9)
        np.testing.assert_allclose(found.v[..., 0], open_loop.simulate(r, found.delta), rtol=1e-9, atol=1e-12)
        bounds = np.array([dual(course, found, i, outer).bound for i in range(2)])
        exact = np.array([hull.high[k], -hull.low[k]])
        reach = deviation(course, found, exact)
        assert np.all(bounds >= exact - 1e-7)
        assert np.all(bounds - exact <= 0.02 * reach)


# ---- every run ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@settings(max_examples=25)
@given(SEEDS, st.integers(1, 4), st.integers(1, 5), st.integers(1, 3), st.sampled_from([1, 2, 15]))
def test_every_run_stays_within_kernel_and_proof(seed, n, p, c, M):
    course = within(some(seed, n, p, c, N=15, M=M), 0.5)
    found, run, outer = worst(course, both_sides(course, 14), starts=4), nominal(course), kernel(course)
    v = np.concatenate([replay(course, drawn(course, 60, seed)), found.v])
    assert np.all(np.abs(v - run.v) <= outer.half)
    np.testing.assert_array_equal(found.v, replay(course, found.delta))
    for i, (name, k, side) in enumerate(both_sides(course, 14)):
        s = course.number(name)
        proof = dual(course, found, i)
        assert proof is not None
        assert np.all(side * v[:, k, s] <= proof.bound)
        assert found.value[i] == found.v[i, k, s]


@pytest.mark.slow
@pytest.mark.parametrize("M", [1, 200])
def test_many_parameters_of_two_channels(M):
    """Nine parameters each: bounded term by term, and by multipliers that need no corners."""
    course = within(some(5, n=5, p=18, c=2, N=200, M=M, radius=0.9), 0.3)
    outer, found = kernel(course), worst(course, both_sides(course, 199))
    v = np.concatenate([replay(course, drawn(course, 20)), found.v])
    assert np.all(np.abs(v - nominal(course).v) <= outer.half)
    for i in range(4):
        proof = dual(course, found, i, outer)
        reached = deviation(course, found, found.side * found.value)[i]
        assert 1.0 <= deviation(course, found, proof.bound)[i] / reached < 1.1
        s = int(found.signal[i])
        assert proof.bound - found.side[i] * nominal(course).v[199, s] < outer.half[199, s]


@pytest.mark.slow
def test_channels_without_parameters_and_parameters_without_width():
    course = some(4, n=3, p=4, c=3, N=30, radius=0.7)
    course = replace(course, lam=np.array([[0.04, 0.0, 0.02, 0.0]]), channel=[0, 0, 0, 1])  # 1 has no width, 2 no parameter
    plain = replace(
        course, B=course.B[..., :1], F=course.F[..., :1], lam=course.lam[:, ::2], channel=[0, 0], C=course.C[:, ::2],
        f=course.f[:, ::2],
    )  # fmt: skip
    np.testing.assert_allclose(kernel(course).half, kernel(plain).half, rtol=1e-9)
    found, same = (worst(one, both_sides(one, 29), starts=32) for one in (course, plain))  # other random signs
    np.testing.assert_allclose(found.value, same.value, rtol=1e-2)
    for i in range(4):  # one problem, but for rounding: the search ends where R is about to break down, each time a bit elsewhere
        bounds = np.array([dual(course, found, i).bound, dual(plain, same, i).bound])
        own = bounds - found.side[i] * nominal(course).v[29, int(found.signal[i])]
        assert own[0] == pytest.approx(own[1], rel=5e-2)
