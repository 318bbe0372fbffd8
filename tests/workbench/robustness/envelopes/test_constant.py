"""Bounds of runs whose parameters stand still: exact runs in rational arithmetic, the true extremes, and what falls back."""

from dataclasses import replace
from fractions import Fraction
from itertools import pairwise, product

import numpy as np
import pytest

from tests.workbench.robustness.envelopes.courses import scalar, signs, some, within
from tests.workbench.robustness.envelopes.test_kernel import exactly
from workbench.robustness.envelopes import constant as module
from workbench.robustness.envelopes.adversary import worst
from workbench.robustness.envelopes.constant import constant_kernel
from workbench.robustness.envelopes.course import Course, explained, replay
from workbench.robustness.envelopes.kernel import kernel
from workbench.robustness.rests import Rest


def inner_of(course):
    return constant_kernel(course, kernel(course))


def resting(seed, *, open_=0, noise=0.0, gain=0.5, N=30, M=1) -> Course:
    """A drawn course that begins at the rest of any machine, with `open_` shares of what drives it before the run."""
    course, random = some(seed, n=4, p=5, c=2, s=3, N=N, M=M, radius=0.7), np.random.default_rng([seed, 1])
    C = course.C.copy()
    C[:, 4] = 0.0  # an error that no parameter explains
    lam = np.repeat(course.lam[:1], M, axis=0)
    lam[:, 4] = noise
    q, Q, J = random.normal(size=4), random.normal(size=(4, open_)), random.normal(size=(5, open_))
    f, quiet, own = course.f.copy(), lam.copy(), random.normal(size=5)
    f[:, 4] = own[4] = 1.0
    J[4] = quiet[:, 4] = 0.0
    rest = Rest(q, Q, own, J, random.normal(size=3), random.normal(size=(3, open_)))
    start = np.linalg.solve(np.eye(4) - course.A[int(course.mode[0])], rest.q)
    course = replace(course, C=C, lam=lam, f=f, start=start, before=rest)
    scale = gain / kernel(replace(course, lam=quiet)).gain
    return replace(course, lam=np.where(np.arange(5) < 4, lam * scale, lam))


def exact_rest(course, delta, share) -> list[Fraction]:
    """Where the machine rests with parameters `delta` (p), by elimination in rational numbers."""

    def rational(M):
        return np.vectorize(Fraction, otypes=[object])(np.asarray(M, dtype=float))

    i, n, rest = int(course.modes[0]), len(course.start), course.before
    A, B, C, lam = (rational(M[i]) for M in (course.A, course.B, course.C, course.lam))
    own, e = rational(delta) * lam, rational(share)
    through = B @ (rational(course.members).T * own)
    left = rational(np.eye(n)) - A - through @ C
    right = rational(rest.q) + rational(rest.Q) @ e + through @ (rational(rest.f) + rational(rest.J) @ e)
    whole = np.column_stack([left, right])
    for col in range(n):
        pivot = col + int(np.argmax(np.abs(whole[col:, col].astype(float))))
        whole[[col, pivot]] = whole[[pivot, col]]
        whole[col] = whole[col] / whole[col, col]
        for row in range(n):
            if row != col:
                whole[row] = whole[row] - whole[row, col] * whole[col]
    return list(whole[:, -1])


def exact_run(course, delta, share) -> list:
    """v (N s) from the own rest; the start is not rounded."""

    def rational(M):
        return np.vectorize(Fraction, otypes=[object])(np.asarray(M, dtype=float))

    x, v, one = np.array(exact_rest(course, delta, share)), [], rational(delta)
    for k, i in enumerate(course.modes):
        w = (one * rational(course.lam[i]) * (rational(course.C[i]) @ x + rational(course.f[k]))) @ rational(course.members)
        v.append(rational(course.E[i]) @ x + rational(course.g[k]) + rational(course.F[i]) @ w)
        x = rational(course.A[i]) @ x + rational(course.q[k]) + rational(course.B[i]) @ w
    return v


def stays_within(inner, v) -> bool:
    return all(
        Fraction(low) <= value <= Fraction(high)
        for row, lows, highs in zip(v, inner.low, inner.high, strict=True)
        for value, low, high in zip(row, lows, highs, strict=True)
    )


@pytest.mark.parametrize("M", [1, 3])
@pytest.mark.parametrize("seed", range(6))
def test_exact_runs_of_constant_parameters_stay_within(seed, M):
    """From a start that is known: corners and parameters inside, in modes that change with the sample."""
    course = within(replace(some(seed, n=3, p=4, c=2, s=2, N=25, M=M, lam=0.1, radius=0.7), mode=np.arange(25) % M), 0.5)
    course = replace(course, lam=np.repeat(course.lam[:1], M, axis=0))
    inner, random = inner_of(course), np.random.default_rng(seed)
    for delta in (*signs(4)[::5], *random.uniform(-1, 1, (2, 4))):
        assert stays_within(inner, exactly(course, delta))


@pytest.mark.parametrize("open_", [0, 1, 2])
@pytest.mark.parametrize("seed", range(4))
def test_exact_runs_from_their_own_rests_stay_within(seed, open_):
    course = resting(seed, open_=open_)
    inner, random = inner_of(course), np.random.default_rng(seed)
    assert np.isfinite(inner.half).all()
    corners = np.array(list(product([-1.0, 1.0], repeat=4 + open_)))
    for both in (*corners[:: max(1, len(corners) // 8)], *random.uniform(-1, 1, (2, 4 + open_))):
        assert stays_within(inner, exact_run(course, np.append(both[:4], 0.0), both[4:]))


@pytest.mark.parametrize("open_", [0, 2])
@pytest.mark.parametrize("seed", range(4))
def test_the_bound_is_hardly_wider_than_the_worst_constant_parameters(seed, open_):
    """In narrower boxes the rest of the series shrinks faster than they do: the worst corner is nearly reached."""
    for gain, allowed in ((0.1, 1.3), (0.01, 1.06)):
        course = resting(seed, open_=open_, gain=gain)
        outer = kernel(course)
        inner = constant_kernel(course, outer)
        corners = np.array(list(product([-1.0, 1.0], repeat=4 + open_)))
        delta, share = np.column_stack([corners[:, :4], np.zeros(len(corners))]), corners[:, 4:]
        v = replay(course, np.repeat(delta[:, None], len(course), axis=1), course.begun(delta, share))
        reached = np.abs(v - outer.nominal.v).max(axis=0)
        assert np.all(inner.half >= reached * (1.0 - 1e-12))
        assert np.quantile(inner.half / reached, 0.9) <= allowed
    assert np.median(outer.half / inner.half) > 1.1  # moving ones reach further


def test_it_is_the_geometric_series_of_one_state():
    """x+ = (a + lam delta) x + 1 at delta = 1 for ever; moving parameters reach no more, the bound comes near it."""
    a, lam = 0.5, 0.1
    course = scalar(a, lam, 60, q=1.0, start=0.0)
    inner, top = inner_of(course), 1.0 / (1.0 - a - lam)
    assert top - 1e-9 <= inner.high[-1, 0] <= top + 0.01
    slow = scalar(-a, lam, 60, q=1.0, start=0.0)  # alternating: constant parameters reach less than moving ones
    outer = kernel(slow)
    inner = constant_kernel(slow, outer)
    ends = [1.0 / (1.0 + a - one * lam) for one in (-1.0, 1.0)]
    assert inner.low[-1, 0] <= ends[0] + 1e-9
    assert inner.high[-1, 0] >= ends[1] - 1e-9
    assert inner.half[-1, 0] < 1.03 * (ends[1] - 1.0 / (1.0 + a))
    assert outer.half[-1, 0] > 1.5 * inner.half[-1, 0]


@pytest.mark.parametrize("seed", range(4))
def test_errors_that_no_parameter_explains_move_at_every_sample(seed):
    """On top of constant parameters, and at the rest before the run: sought for by the adversary, from the worst corners."""
    course = resting(seed, noise=0.3, gain=0.3)
    assert not explained(course)[4]
    outer = kernel(course)
    inner = constant_kernel(course, outer)
    for delta in np.column_stack([signs(4), np.zeros(16)]):
        fixed = course.at(delta)
        found = worst(fixed, [(name, k, side) for name in course.signals for k in (1, 12, 29) for side in (-1, 1)])
        whole, before = (np.where(explained(course), delta, own) for own in (found.delta, found.before))
        start = course.begun(before, np.zeros((len(whole), 0)))
        v = replay(course, whole, start)
        assert np.all(v >= inner.low - 1e-9)
        assert np.all(v <= inner.high + 1e-9)
    reached = float(np.abs(found.v - outer.nominal.v).max())
    assert reached > 0.3


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_every_degree_is_proved_and_a_higher_one_is_tighter(degree, monkeypatch):
    course, halves = resting(3, open_=1, gain=0.6), []
    for own in range(1, degree + 1):
        monkeypatch.setattr(module, "DEGREE", own)
        inner = inner_of(course)
        halves.append(inner.half)
        for both in np.array(list(product([-1.0, 1.0], repeat=5)))[::6]:
            assert stays_within(inner, exact_run(course, np.append(both[:4], 0.0), both[4:]))
    assert all(np.median(after / before) < 0.97 for before, after in pairwise(halves))


@pytest.mark.parametrize("seed", range(4))
def test_set_points_before_the_run_may_reach_an_error_that_no_parameter_explains(seed):
    """Its regressor at the rest depends on them; runs were up to 14 times outside."""
    course = resting(seed, open_=2, noise=0.3)
    J = course.before.J.copy()
    J[4] = 3.0 * np.random.default_rng(seed).normal(size=2)
    course = replace(course, before=replace(course.before, J=J))
    inner = inner_of(course)
    for both in np.array(list(product([-1.0, 1.0], repeat=7)))[::5]:
        assert stays_within(inner, exact_run(course, both[:5], both[5:]))


def test_of_many_parameters_the_degree_is_lower_and_still_proved(monkeypatch):
    course = within(some(5, n=4, p=14, c=1, s=2, N=30, lam=0.1, radius=0.7), 0.3)  # more than MOST_SIGNS in one channel
    whole = inner_of(course)
    monkeypatch.setattr(module, "TERMS", 30)
    inner = inner_of(course)
    random = np.random.default_rng(0)
    assert np.median(inner.half / whole.half) > 1.001
    for delta in random.choice([-1.0, 1.0], (10, 14)):
        v = exactly(course, delta)
        assert stays_within(inner, v)
        assert stays_within(whole, v)


def test_what_rounding_takes_from_the_terms_is_in_the_bound(monkeypatch):
    """Boxes so narrow that all is rounding: exact runs stay within, and do not where rounding is left out."""
    course = scalar(1.0, 1e-17, 400, q=0.1, start=1e6 / 3.0)
    assert stays_within(inner_of(course), exactly(course, [1.0]))
    monkeypatch.setattr(module, "rounding", lambda _: 0.0)
    monkeypatch.setattr("workbench.robustness.envelopes.kernel.rounding", lambda _: 0.0)
    assert not stays_within(inner_of(course), exactly(course, [1.0]))


def test_nothing_is_said_where_nothing_is_known():
    """No proved set of rests; a series that overflows; and it is nowhere wider than the bound of moving parameters."""
    course = resting(0)
    wild = replace(course, lam=course.lam * 1e3)
    assert kernel(wild).start is None
    assert inner_of(wild).half is kernel(wild).half or np.array_equal(inner_of(wild).half, kernel(wild).half)
    growing = scalar(5.0, 0.1, 400, q=1.0, start=1.0)
    outer = kernel(growing)
    inner = constant_kernel(growing, outer)
    assert np.isinf(inner.half[-1]).all()
    assert np.all(inner.half <= outer.half)
    still = replace(course, lam=0.0 * course.lam)
    assert np.array_equal(inner_of(still).half, kernel(still).half)
