"""Where a run begins: the rests of all machines of the boxes are held, rounding and all; where there is none it is said."""

import itertools
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workbench.errors import InputError
from workbench.intervals.arithmetic import exact
from workbench.robustness import rests
from workbench.robustness.envelopes import dual as dual_module
from workbench.robustness.envelopes import kernel as kernel_module
from workbench.robustness.envelopes.adversary import worst
from workbench.robustness.envelopes.course import Course, nominal, replay
from workbench.robustness.envelopes.dual import dual
from workbench.robustness.envelopes.kernel import at_rest, kernel, starts
from workbench.robustness.envelopes.problem import Problem
from workbench.robustness.rests import Rest


def rational(M):
    return np.vectorize(Fraction, otypes=[object])(np.asarray(M, dtype=float))


def solved(M, b) -> np.ndarray:
    """M x = b by elimination, without rounding."""
    M, b, n = M.copy(), b.copy(), len(b)
    for i in range(n):
        k = next(k for k in range(i, n) if M[k, i] != 0)
        M[[i, k]], b[[i, k]] = M[[k, i]], b[[k, i]]
        for k in range(i + 1, n):
            factor = M[k, i] / M[i, i]
            M[k], b[k] = M[k] - factor * M[i], b[k] - factor * b[i]
    for i in range(n - 1, -1, -1):
        b[i] = (b[i] - sum(M[i, k] * b[k] for k in range(i + 1, n))) / M[i, i]
    return b


def resting(seed, n=3, p=4, c=2, g=1, N=20, lam=0.05, scale=1.0, M=1) -> Course:
    """A loop that rests before the run and then is driven by something else, in units of each state by `scale` to a power."""
    random = np.random.default_rng(seed)
    A = random.standard_normal((1, n, n))
    A *= 0.8 / np.abs(np.linalg.eigvals(A[0])).max()
    A = np.concatenate([A, *(A + 0.02 * random.standard_normal((1, n, n)) for _ in range(M - 1))])
    T = np.diag(scale ** random.integers(-1, 2, n))
    A, back = T @ A @ np.linalg.inv(T), np.linalg.inv(T)
    B, C, E = (
        T @ random.standard_normal((M, n, c)),
        random.standard_normal((M, p, n)) @ back,
        random.standard_normal((M, 1, n)) @ back,
    )
    seen = np.random.default_rng([seed, 1])
    before = Rest(
        T @ random.standard_normal(n),
        T @ random.standard_normal((n, g)),
        random.standard_normal(p),
        random.standard_normal((p, g)),
        seen.standard_normal(1),
        seen.standard_normal((1, g)),
    )
    return Course(
        A, B, C, E, random.standard_normal((M, 1, c)), lam * random.uniform(0.2, 1.0, (M, p)),
        random.permutation(np.arange(p) % c), np.arange(N) % M, random.standard_normal((N, n)) @ T,
        random.standard_normal((N, 1)), random.standard_normal((N, p)),
        np.linalg.solve(np.eye(n) - A[0], before.q), ("v",), before,
    )  # fmt: skip


def exact_rest(course, delta, e) -> tuple[np.ndarray, np.ndarray]:
    """x and w of x = A x + q + Q e + B w, w = S delta lam (C x + f + J e), without rounding."""
    i, one = course.modes[0], rational(delta)
    A, B, C, lam, S = (rational(M) for M in (course.A[i], course.B[i], course.C[i], course.lam[i], course.members))
    rest = course.before
    q, f = (rational(a) + rational(b) @ rational(e) for a, b in ((rest.q, rest.Q), (rest.f, rest.J)))
    gain = B @ (S.T * (one * lam))
    x = solved(rational(np.eye(len(A))) - A - gain @ C, q + gain @ f)
    return x, (one * lam * (C @ x + f)) @ S


def points(course, count, seed):
    """Corners and numbers inside of (delta, e)."""
    random, p, g = np.random.default_rng(seed), course.f.shape[1], course.before.Q.shape[1]
    shares = np.concatenate([random.choice([-1.0, 1.0], (count, p + g)), random.uniform(-1, 1, (count, p + g))])
    return shares[:, :p], shares[:, p:]


def held_without_rounding(course, held, delta, e) -> np.ndarray:
    """The rest of one machine, which is held."""
    x, w = exact_rest(course, delta, e)
    u = np.concatenate([rational(e), w])
    assert np.all(np.abs(u) <= rational(held.size))
    assert np.all(np.abs(x - rational(course.start) - rational(held.spread) @ u) <= rational(held.slack))
    return x


@pytest.mark.slow
@settings(max_examples=25)
@given(
    st.integers(0, 10**6), st.integers(1, 4), st.integers(1, 4), st.integers(1, 2), st.integers(0, 2), st.sampled_from([1.0, 1e6])
)
def test_every_rest_is_held_without_rounding(seed, n, p, c, g, scale):
    course = resting(seed, n, p, c, g, scale=scale)
    held = starts(course)
    if held is None:
        return
    for delta, e in zip(*points(course, 6, seed), strict=True):
        x = held_without_rounding(course, held, delta, e)
        found = course.begun(delta[None], e[None])[0]
        if course.rests(delta[None])[0]:
            np.testing.assert_allclose(found, x.astype(float), rtol=1e-9, atol=1e-9 * np.abs(found).max())


@pytest.mark.parametrize("g", [0, 2])
@pytest.mark.parametrize("seed", range(4))
def test_what_is_watched_at_every_rest_is_between_its_bounds(seed, g):
    """E x + v + V e + F w without rounding, and the bounds are nearly reached where little is open."""
    for lam in (0.05, 1e-3):
        course = resting(seed, g=g, lam=lam)
        low, high = at_rest(course, course.before, starts(course))
        rest, i, reached = course.before, course.modes[0], []
        for delta, e in zip(*points(course, 20, seed), strict=True):
            x, w = exact_rest(course, delta, e)
            v = rational(course.E[i]) @ x + rational(rest.v) + rational(rest.V) @ rational(e) + rational(course.F[i]) @ w
            assert rational(low)[0] <= v[0] <= rational(high)[0]
            reached.append(float(v[0]))
            assert course.rested(course.before, delta[None], e[None])[0, 0] == pytest.approx(float(v[0]), rel=1e-9, abs=1e-9)
        assert high[0] - low[0] <= 4.0 * np.ptp(reached)


@pytest.mark.parametrize("size", [1.0, 1e-30, 1e-105, 1e-112, 0.0])
@pytest.mark.parametrize("lam", [0.1, 0.3, 0.49])
def test_what_rests_near_nought_has_a_start_too(size, lam):
    """x+ = (0.5 + lam delta) x + size rests within size / (0.5 - lam); nought is the rest of every machine."""
    course = scalar(0.5, lam)
    course = replace(course, start=size * course.start, before=replace(course.before, q=[size]))
    held = starts(course)
    assert held is not None
    reach = held.spread[0, 0] * held.size[0] + held.slack[0]
    rest, middle = size / (0.5 - lam), size / 0.5
    assert rest - middle <= reach <= (rest - middle) * (1.0 + 1e-6) + 1e-107


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("off", [-1.0, 0.0, 0.5])
def test_rests_are_held_where_the_start_misses_that_of_the_middle(seed, off, monkeypatch):
    """By the maximum over the signs of many parameters, and by their sum, which is no smaller."""
    course = resting(seed, p=5, c=1 + seed % 2, g=seed % 2)
    course = replace(course, start=course.start * (1.0 + off))
    held = starts(course)
    monkeypatch.setattr(kernel_module, "MOST_SIGNS", 0)
    summed = starts(course)
    assert np.all(summed.size >= held.size * (1.0 - 1e-12))
    for delta, e in zip(*points(course, 10, seed), strict=True):
        for one in (held, summed):
            held_without_rounding(course, one, delta, e)
    if not off:
        assert held.slack.max() < 1e-12 * np.abs(course.start).max()


def test_a_channel_without_parameters_is_still():
    course = resting(1)
    held = starts(replace(course, lam=course.lam * (course.channel != 1)))
    assert held.size[-1] < 1e-100
    assert held.size[-2] > 0.01


@pytest.mark.parametrize("turned", [1e-9, 0.3, 0.5 - 1e-13, 0.5, 0.5 + 1e-13, 0.8])
def test_what_a_poor_inverse_misses_is_bounded(turned):
    """R = (1 - turned) / 3 in place of 1 / 3, and 0 in place of the solution 1 / 3: it misses all of it, at any size."""
    for size in (1.0, 2.0**40, 2.0**-40):
        left, R = exact(np.array([[3.0]])), np.array([[(1.0 - turned) / 3.0]])
        found = rests._missed(left, R, exact(np.array([[size]])))[0, 0]
        assert Fraction(size) / 3 <= Fraction(found) <= Fraction(size) / 3 * 5
    assert rests._missed(left, -R, exact(np.array([[size]]))) is None  # no inverse at all


@pytest.mark.parametrize("seed", range(40))
def test_a_fixed_point_that_is_told_is_one_without_rounding(seed):
    """W >= a + M W of every row, however near to 1 the largest eigenvalue is; from 1 on there is none."""
    random = np.random.default_rng(seed)
    c, near = int(random.integers(1, 4)), 10.0 ** -random.uniform(0.0, 15.5)
    through = [random.uniform(0.0, 1.0, (3, c)) for _ in range(c)]
    radius = max(
        np.abs(np.linalg.eigvals(np.array([M[i] for M, i in zip(through, rows, strict=True)]))).max()
        for rows in itertools.product(range(3), repeat=c)
    )
    own, edge = [random.uniform(0.0, 1.0, 3) for _ in range(c)], (1.0 - near) / radius
    W = rests._fixed(own, [edge * M for M in through])
    if near > 0.01:
        assert W is not None
    if W is not None:
        for j, (a, M) in enumerate(zip(own, through, strict=True)):
            assert np.all(rational(a) + rational(edge * M) @ rational(W) <= Fraction(W[j]))
    assert rests._fixed(own, [1.01 / radius * M for M in through]) is None
    through[0] = np.where(np.arange(c) == 0, np.inf, through[0] * edge)
    with np.errstate(invalid="ignore"):
        assert rests._fixed(own, through) is None


@pytest.mark.parametrize("seed", range(6))
def test_of_one_channel_the_set_is_no_larger_than_it_must_be(seed):
    """The largest w is that of a corner; and the rounding of all of it is none."""
    course = resting(seed, c=1, g=0)
    held = starts(course)
    reached = max(
        abs(float(exact_rest(course, np.array(d), np.zeros(0))[1][0])) for d in itertools.product([-1.0, 1.0], repeat=4)
    )
    assert reached <= held.size[0] <= reached * (1.0 + 1e-6)
    assert held.slack.max() < 1e-12 * np.abs(course.start).max()


def scalar(a, lam) -> Course:
    """x+ = (a + lam delta) x + 1 from rest at 1 / (1 - a - lam delta)."""
    one, N = np.ones((1, 1, 1)), 10
    start = [1.0 / (1.0 - a)] if a != 1.0 else [0.0]
    return Course(
        a * one, one, one, one, 0.0 * one, [[lam]], [0], np.zeros(N), np.ones((N, 1)), np.zeros((N, 1)), np.zeros((N, 1)), start,
        ("v",), Rest([1.0], np.zeros((1, 0)), [0.0], np.zeros((1, 0)), [0.0], np.zeros((1, 0))),
    )  # fmt: skip


def test_boxes_with_a_machine_that_has_no_rest_prove_nothing():
    """1 - a - lam delta passes 0: from there on nothing is said, just before the rest is as far off as it is."""
    for lam in (0.5, 0.6):
        outer = kernel(scalar(0.5, lam))
        assert outer.start is None
        assert not np.isfinite(outer.half).any()
        assert dual(scalar(0.5, lam), worst(scalar(0.5, lam), [("v", 0, 1)])) is None
    near = kernel(scalar(0.5, 0.49))
    assert near.high[0, 0] == pytest.approx(1.0 / 0.01, rel=1e-6)
    assert starts(scalar(1.0, 0.1)) is None  # the middle itself


@pytest.mark.parametrize("seed", range(8))
def test_runs_from_every_rest_stay_within_kernel_and_proof(seed):
    course, random = resting(seed, M=1 + 2 * (seed % 2)), np.random.default_rng(seed)
    outer, k = kernel(course), 5 + seed
    questions = [("v", k, 1), ("v", k, -1), ("v", 0, 1)]
    found = worst(course, questions)
    before, share = points(course, 60, seed)
    delta = random.choice([-1.0, 1.0], (len(before), *course.f.shape))
    delta[::2] = before[::2, None]  # constant ones, and ones that move from the first sample on
    v = np.concatenate([replay(course, delta, course.begun(before, share)), found.v])[:, :, 0]
    assert np.all((outer.low[:, 0] <= v) & (v <= outer.high[:, 0]))
    np.testing.assert_array_equal(found.start, course.begun(found.before, found.share))
    for i, (_, at, side) in enumerate(questions):
        proof = dual(course, found, i, outer)
        assert proof is not None
        assert proof.holds(course)
        assert np.all(side * v[:, at] <= proof.bound)
        assert side * found.value[i] >= (side * v[:, at]).max() - 1e-9  # nothing random beats the adversary
        assert proof.bound <= side * (outer.high if side == 1 else outer.low)[at, 0] * (1.0 + 1e-3) + 1e-2


def test_a_proof_for_one_start_is_none_for_a_wider_one():
    course = resting(3, g=1)
    found = worst(course, [("v", 8, 1)])
    proof = dual(course, found)
    assert proof.first == 0
    rest = course.before
    assert proof.holds(course)
    assert not proof.holds(replace(course, before=replace(rest, Q=2.0 * rest.Q)))
    assert not proof.holds(replace(course, before=replace(rest, f=3.0 * rest.f)))
    assert not proof.holds(replace(course, start=course.start + 1.0))  # not the rest of the middle: then it is in the slack
    assert not replace(proof, box=0.5 * proof.box).holds(course)
    assert not replace(proof, nu=0.0 * proof.nu).holds(course)
    assert not proof.holds(replace(course, lam=1.5 * course.lam))
    known = replace(course, before=None)
    assert dual(known, worst(known, [("v", 8, 1)])).bound < proof.bound


def test_the_slope_of_the_bound_is_its_slope_for_starts_too():
    course = resting(5, g=2)
    found, outer = worst(course, [("v", 9, -1)]), kernel(course)
    problem = Problem(course, 0, 9, -1.0, 0, outer)
    path = dual_module._along(course, 0, 9, -1.0, found.delta[0], found.start[0])
    at = next(a for a in map(problem.started, dual_module._first_multipliers(course, path, problem.k)) if a is not None)
    for i in (0, 7, *range(len(at.x) - 4, len(at.x))):  # multipliers of the start last
        step = 1e-5 * np.eye(len(at.x))[i]
        slope = (problem.at(at.x + step).value - problem.at(at.x - step).value) / 2e-5
        assert slope == pytest.approx(at.slope[i], rel=1e-4, abs=1e-7 * at.value)


def test_a_start_that_is_known_is_the_only_one():
    course = replace(resting(2), before=None)
    assert not course.rests(np.zeros((1, 4))).any()
    np.testing.assert_array_equal(course.begun(np.ones((2, 4))), [course.start, course.start])
    assert len(starts(course).size) == 0
    assert float(kernel(course).state[0].max()) < 1e-100


def test_a_course_with_constant_parameters_begins_at_their_rest():
    course, delta = resting(7, g=1, lam=0.1), np.array([0.7, -0.4, 0.0, 1.0])
    own = course.at(delta)
    share = np.array([[0.3]])
    np.testing.assert_allclose(own.begun(np.zeros((1, 4)), share), course.begun(delta[None], share), rtol=1e-12)
    expected = replay(course, np.tile(delta, (1, len(course), 1)), course.begun(delta[None]))[0]
    np.testing.assert_allclose(nominal(own).v, expected, atol=1e-11)


def test_the_rest_of_another_loop_is_refused():
    with pytest.raises(InputError, match="of another loop"):
        replace(resting(0), before=resting(0, n=2).before)
    with pytest.raises(InputError, match="q holds a value that is not finite"):
        replace(resting(0), before=replace(resting(0).before, q=[np.inf, 0.0, 0.0]))
