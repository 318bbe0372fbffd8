"""Envelopes: the defining equation, brute force over every vertex sequence, closed forms, and how far random runs stay behind."""

from dataclasses import replace
from itertools import product
from math import comb

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from workbench.errors import InputError
from workbench.excitation import prbs
from workbench.intervals import propagation
from workbench.intervals.envelopes import (
    Recursion,
    free_run,
    hull,
    intervals,
    kernel,
    nominal,
    simulate,
    worst_sequences,
    zonotope,
)

SEEDS = st.integers(0, 10**6)
SECOND_ORDER = ([1.0, 2.3], [1.0, 6.6, 1.67])
LIGHTLY_DAMPED = ([4.0], [1.0, 0.6, 4.0])


def some(seed, n=2, p=2, N=7, *, modes=1, spread=0, lam=0.2, radius=0.8, through=1.0):
    """A recursion drawn from `seed`; every mode has spectral radius `radius`."""
    random = np.random.default_rng(seed)
    A = random.standard_normal((modes, n, n))
    if n:
        A *= radius / np.abs(np.linalg.eigvals(A)).max(axis=1)[:, None, None]
    return Recursion(
        A=A,
        b=random.standard_normal(n),
        c=random.standard_normal((modes, n)),
        C=random.standard_normal((p, n)),
        lam=lam * random.uniform(0, 1, (modes, p)),
        q=random.standard_normal((N, n)),
        g=random.standard_normal(N),
        f=random.standard_normal((N, p)),
        mode=random.integers(0, modes, N),
        start=random.standard_normal(n),
        spread=0.3 * random.standard_normal((n, spread)),
        through=through,
    )


def scalar(a, lam, N, *, f=0.0, q=0.0, start=0.0, spread=()):
    """x(k+1) = a x + q + w, w = delta lam (x + f), y = x."""
    ones = np.ones(N)
    return Recursion(
        A=[[[a]]], b=[1.0], c=[[1.0]], C=[[1.0]], lam=[[lam]], q=q * ones[:, None], g=0 * ones, f=f * ones[:, None],
        mode=0 * ones, start=[start], spread=[list(spread)], through=0.0,
    )  # fmt: skip


def difference_equation(system, dt, relative, N):
    """Zero-order hold of `system` in delta form: regressors -(q-1)^j y, (q-1)^j u, j = n-1 .. 0, boxes `relative` wide, and 1.

    Also returns what a plain loop needs: centre theta (2n + 1), D (n, n) of the powers of q - 1 in past samples, and u.
    """
    from scipy.signal import cont2discrete

    numerator, denominator, _ = cont2discrete(system, dt)
    a, b = denominator, numerator.ravel()[1:]
    n = len(b)
    # row i holds (q-1)^(n-1-i) of the oldest of the n past samples; the first column is the newest
    D = np.array([[comb(n - 1 - i, j - i) * (-1.0) ** (j - i) if j >= i else 0.0 for j in range(n)] for i in range(n)])
    alpha = np.linalg.solve(D.T, a[1:] - np.array([comb(n, j) * (-1.0) ** j for j in range(1, n + 1)]))
    theta = np.concatenate([alpha, np.linalg.solve(D.T, b), [0.0]])
    u = prbs(N + n, bits=11, hold=round(0.6 / dt))
    past = np.column_stack([u[n - 1 - j : n - 1 - j + N] for j in range(n)])  # newest first
    A = np.vstack([-a[1:], np.eye(n)[:-1]])
    C = np.vstack([-D, np.zeros((n + 1, n))])
    f = np.column_stack([np.zeros((N, n)), past @ D.T, np.ones(N)])
    q = np.column_stack([past @ b, np.zeros((N, n - 1))])
    recursion = Recursion(
        A=A[None], b=np.eye(n)[0], c=A[:1], C=C, lam=relative * np.abs(theta)[None], q=q, g=q[:, 0], f=f,
        mode=np.zeros(N), start=np.zeros(n), spread=np.zeros((n, 0)),
    )  # fmt: skip
    return recursion, theta, D, past


@pytest.fixture(scope="module", params=[(0.05, 0.05), (0.05, 0.10), (0.2, 0.10)], ids=["50 ms 5 %", "50 ms 10 %", "200 ms 10 %"])
def long_run(request):
    """2250 samples of the second-order machine with its free run."""
    recursion, *_ = difference_equation(SECOND_ORDER, *request.param, 2250)
    return recursion, free_run(recursion)


def signs(count, p):
    return np.array(list(product([-1, 1], repeat=count * p)), dtype=np.int8).reshape(2 ** (count * p), count, p)


def every_vertex(r):
    """y (S, N) of all sequences of box vertices and all corners of the initial state."""
    delta, corners = signs(len(r), r.lam.shape[1]), signs(1, r.spread.shape[1])[:, 0]
    return simulate(r, np.repeat(delta, len(corners), axis=0), np.tile(corners, (len(delta), 1)))


# ---- the equation ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("system", [SECOND_ORDER, ([1.0, 2.3], [0.08, 1.528, 6.7336, 1.67])], ids=["order 2", "order 3"])
def test_a_recursion_simulates_the_difference_equation_it_was_made_of(system):
    r, theta, D, past_u = difference_equation(system, 0.1, 0.1, 60)
    n = len(D)
    delta = np.random.default_rng(0).uniform(-1, 1, (3, 60, len(theta)))
    for one, found in zip(delta, simulate(r, delta), strict=True):
        y = [0.0] * n
        for k in range(60):
            newest_first = np.array(y[-1 : -n - 1 : -1])
            phi = np.concatenate([-D @ newest_first, D @ past_u[k], [1.0]])
            # (q-1)^n y = theta'phi
            integrators = sum(comb(n, j) * (-1.0) ** (j + 1) * newest_first[j - 1] for j in range(1, n + 1))
            y.append(integrators + (theta * (1 + 0.1 * np.sign(theta) * one[k])) @ phi)
        np.testing.assert_allclose(found, y[n:], rtol=0, atol=1e-11)


def test_the_nominal_run_has_every_delta_at_zero():
    r = some(3, n=3, p=4, modes=2, spread=2)
    np.testing.assert_allclose(nominal(r).y, simulate(r, np.zeros((1, 7, 4)))[0], rtol=1e-12)


@settings(max_examples=40)
@given(SEEDS, st.integers(0, 3), st.integers(1, 4), st.integers(1, 3), st.integers(0, 2), st.sampled_from([1.0, 0.0, -0.7]))
def test_every_sequence_stays_inside_every_outer_method(seed, n, p, modes, spread, through):
    r = some(seed, n, p, 12, modes=modes, spread=spread, through=through)
    random = np.random.default_rng(seed)
    delta = np.concatenate([random.uniform(-1, 1, (100, 12, p)), random.choice([-1.0, 1.0], (100, 12, p))])
    start = np.concatenate([random.uniform(-1, 1, (100, spread)), random.choice([-1.0, 1.0], (100, spread))])
    worst = worst_sequences(r, [4, 11]).y
    y = np.concatenate([simulate(r, delta, start), worst])
    for bounds in (hull(r), kernel(r), zonotope(r), zonotope(r, order=1), intervals(r)):
        assert np.all(bounds.low <= y.min(axis=0))
        assert np.all(y.max(axis=0) <= bounds.high)


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_the_hull_and_the_adversary_are_the_range_of_all_vertex_sequences(n, seed):
    r = some(seed, n, 2, 6, modes=1 + seed % 2, spread=seed % 3, through=(1.0, 0.0, -0.7)[seed])
    y = every_vertex(r)
    outer, found = hull(r), worst_sequences(r, range(6))
    assert np.all(outer.low <= y.min(axis=0))
    assert np.all(outer.high >= y.max(axis=0))
    np.testing.assert_allclose(outer.low, y.min(axis=0), atol=1e-8)
    np.testing.assert_allclose(outer.high, y.max(axis=0), atol=1e-8)
    np.testing.assert_allclose(found.y.min(axis=0), y.min(axis=0), atol=1e-9)
    np.testing.assert_allclose(found.y.max(axis=0), y.max(axis=0), atol=1e-9)


@settings(max_examples=15)
@given(SEEDS)
def test_parameters_inside_the_box_never_beat_its_vertices(seed):
    # not so for a bound that is only convex: y is affine in each delta(k)
    r = some(seed, n=2, p=2, N=4, spread=1)
    y = every_vertex(r)
    random = np.random.default_rng(seed)
    inner = simulate(r, random.uniform(-1, 1, (500, 4, 2)), random.uniform(-1, 1, (500, 1)))
    assert np.all(inner.max(axis=0) <= y.max(axis=0) + 1e-12)
    assert np.all(inner.min(axis=0) >= y.min(axis=0) - 1e-12)


# ---- closed forms ---------------------------------------------------------------------------------------------------


def test_one_state_without_input_lies_between_two_powers():
    k = np.arange(30)
    bounds = hull(scalar(0.7, 0.1, 30, start=2.0))
    np.testing.assert_allclose(bounds.high, 2 * 0.8**k, rtol=1e-9)
    np.testing.assert_allclose(bounds.low, 2 * 0.6**k, rtol=1e-9)
    # a centre of zero: the sign is the adversary's to choose
    np.testing.assert_allclose(hull(scalar(0.0, 0.9, 30, start=2.0)).low[1:], -2 * 0.9 ** k[1:], rtol=1e-9)


def test_an_unknown_start_widens_by_the_largest_slope():
    k = np.arange(20)
    r = scalar(0.7, 0.1, 20, start=0.0, spread=(0.3, 0.2))
    for bounds in (hull(r), kernel(r), zonotope(r)):
        np.testing.assert_allclose(bounds.high, 0.5 * 0.8**k, rtol=1e-8)
        np.testing.assert_allclose(bounds.low, -0.5 * 0.8**k, rtol=1e-8)
    found = worst_sequences(r, [19])
    np.testing.assert_allclose(found.y[:, 19], [0.5 * 0.8**19, -0.5 * 0.8**19], rtol=1e-12)


def test_the_kernel_of_one_state_is_a_geometric_series():
    # x+ = a x + w, |w| <= lam |x + 1|: sum_j (a + lam)^j lam; the gain tends to lam / (1 - a)
    a, lam, k = 0.6, 0.3, np.arange(80)
    bounds = kernel(scalar(a, lam, 80, f=1.0))
    np.testing.assert_allclose(bounds.high, lam * (1 - (a + lam) ** k) / (1 - a - lam), rtol=1e-8)
    assert bounds.gain == pytest.approx(lam * (1 - a**79) / (1 - a), rel=1e-12)
    np.testing.assert_allclose(bounds.high, hull(scalar(a, lam, 80, f=1.0)).high, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_the_kernel_is_its_defining_recursion(seed):
    r = some(seed, n=3, p=3, N=9, modes=2, spread=2, through=-0.5)
    m, run, W, half = r.modes, nominal(r), [], []
    patterns = np.array(list(product([-1, 1], repeat=3)))

    def Phi(k, j):
        return np.linalg.multi_dot([np.eye(3), *(r.A[m[i]] for i in range(k - 1, j - 1, -1)), np.eye(3)])

    for k in range(9):
        columns = [*(Phi(k, 0) @ r.spread).T, *(Phi(k, j + 1) @ r.b for j in range(k))]
        weight = [1.0, 1.0, *W]
        W.append(
            max(
                abs(delta @ (r.lam[m[k]] * run.z[k]))
                + sum(abs(delta @ (r.lam[m[k]] * (r.C @ v))) * Wj for v, Wj in zip(columns, weight, strict=True))
                for delta in patterns
            )
        )
        half.append(sum(abs(r.c[m[k]] @ v) * Wj for v, Wj in zip(columns, weight, strict=True)) + 0.5 * W[-1])
    np.testing.assert_allclose(kernel(r).high - run.y, half, rtol=1e-8)


def test_a_model_without_feedback_is_the_interval_product():
    r = some(1, n=0, p=3, N=40, modes=2)
    run = free_run(r)
    half = np.array([r.lam[m] @ np.abs(f) for m, f in zip(r.modes, r.f, strict=True)])
    np.testing.assert_allclose(run.high, r.g + half, atol=1e-12)
    np.testing.assert_allclose(run.low, r.g - half, atol=1e-12)
    np.testing.assert_allclose(run.reached_high, r.g + half, atol=1e-12)
    np.testing.assert_allclose(run.reached_low, r.g - half, atol=1e-12)
    assert run.ratio == pytest.approx(1.0, abs=1e-11)


def test_switching_modes_multiply_their_own_slopes():
    mode = np.random.default_rng(2).integers(0, 2, 40)
    a, lam = np.array([0.5, 1.2]), np.array([0.1, 0.05])
    r = replace(scalar(0, 0, 40, start=1.0), A=a[:, None, None], lam=lam[:, None], c=np.ones((2, 1)), mode=mode)
    truth = np.cumprod(np.append(1.0, (a + lam)[mode[:-1]]))
    np.testing.assert_allclose(hull(r).high, truth, rtol=1e-9)


def test_without_intervals_the_envelope_is_the_nominal_run():
    for n in (1, 2, 3):
        run = free_run(some(5, n=n, p=2, N=50, lam=0.0))
        np.testing.assert_allclose(run.high, run.nominal, atol=1e-10 if n < 3 else 1e-6)
        np.testing.assert_allclose(run.low, run.nominal, atol=1e-10 if n < 3 else 1e-6)
        assert run.ratio == 1.0


# ---- tightness ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_two_states_have_their_exact_envelope_over_2250_samples(long_run):
    recursion, run = long_run
    assert run.method == "exact polygon"
    assert run.ratio <= 1 + 1e-6
    assert np.all(run.low <= run.reached_low)
    assert np.all(run.reached_high <= run.high)
    # the widest instant is among them, and a replay gives what was found
    assert int((run.high - run.low).argmax()) in run.instants
    found = run.sequences
    np.testing.assert_array_equal(simulate(recursion, found.delta, found.start), found.y)
    assert set(np.unique(found.delta)) == {-1.0, 1.0}


def test_the_hull_is_tighter_than_the_kernel_and_the_modal_zonotope_and_naive_intervals_explode(long_run):
    recursion, run = long_run
    width = run.high - run.low
    bounds, modal = kernel(recursion), zonotope(recursion)
    assert bounds.gain < 1
    for other in (bounds, modal):
        assert np.all(other.low <= run.low + 1e-8)
        assert np.all(other.high >= run.high - 1e-8)
        assert 1.02 < (other.width / width).max() < 1 / (1 - bounds.gain)
    assert intervals(recursion).width[-1] == np.inf
    assert width.max() < 3


def test_boxes_in_shift_states_wrap_and_in_modal_coordinates_do_not():
    recursion, *_ = difference_equation(SECOND_ORDER, 0.05, 0.05, 600)
    exact = hull(recursion).width.max()
    assert zonotope(recursion).width.max() < 1.2 * exact
    assert zonotope(recursion, order=20, coordinates=np.eye(2)).width.max() > 1000 * exact


@pytest.mark.parametrize("n", [2, 4])
def test_a_zonotope_that_is_never_reduced_is_the_kernel(n):
    r = some(7, n=n, p=3, N=40, modes=2, spread=1)
    np.testing.assert_allclose(zonotope(r, order=60).high, kernel(r).high, rtol=1e-9)


def test_sign_patterns_are_tighter_than_their_sum(monkeypatch):
    r = some(4, n=3, p=4, N=60)
    patterns = kernel(r)
    monkeypatch.setattr(propagation, "MOST_SIGNS", 0)
    summed = kernel(r)
    assert patterns.gain < summed.gain
    assert np.all(patterns.high <= summed.high)
    assert patterns.width[-1] < 0.999 * summed.width[-1]


def test_many_parameters_are_bounded_term_by_term():
    r = some(4, n=2, p=propagation.MOST_SIGNS + 2, N=30, lam=0.05)
    bounds, exact = kernel(r), hull(r)
    assert np.all(bounds.low <= exact.low + 1e-12)
    assert np.all(bounds.high >= exact.high - 1e-12)


def test_three_states_have_their_envelope_within_a_thousandth():
    # the machine behind a lag of 0.08 s
    recursion, *_ = difference_equation(([1.0, 2.3], [0.08, 1.528, 6.7336, 1.67]), 0.1, 0.05, 150)
    run = free_run(recursion)
    assert run.method == "exact polytope"
    assert run.ratio <= 1.001
    assert np.all(run.low <= run.reached_low)
    assert np.all(run.reached_high <= run.high)
    assert np.all(kernel(recursion).high >= run.high - 1e-9)


def test_four_states_get_the_kernel_and_what_was_reached():
    run = free_run(some(8, n=4, p=3, N=200, lam=0.02, spread=1))
    assert run.method == "kernel"
    assert run.gain < 1
    assert np.all(run.low <= run.reached_low)
    assert np.all(run.reached_high <= run.high)
    assert 1 <= run.ratio <= 1 / (1 - run.gain)


def test_two_states_agree_with_all_box_vertices_and_qhull():
    # the peer knows nothing of the rank-one structure: 2^p vertex matrices, absolute states, Qhull
    from scipy.spatial import ConvexHull

    r, *_ = difference_equation(LIGHTLY_DAMPED, 0.3, 0.1, 60)
    points, low, high = np.zeros((1, 2)), [], []
    for k in range(60):
        images, outputs = [], []
        for delta in product([-1, 1], repeat=4):
            row = np.append(delta, 0) * r.lam[0]
            images.append(points @ (r.A[0] + np.outer(r.b, row @ r.C)).T + r.q[k] + r.b * (row @ r.f[k]))
            outputs.append(points @ (r.c[0] + row @ r.C) + r.g[k] + row @ r.f[k])
        low.append(np.min(outputs))
        high.append(np.max(outputs))
        points = np.concatenate(images)
        if k > 1:
            points = points[ConvexHull(points).vertices]
    bounds = hull(r)
    np.testing.assert_allclose(bounds.low, low, atol=1e-7)
    np.testing.assert_allclose(bounds.high, high, atol=1e-7)
    assert bounds.width.max() > 1


def test_vertices_that_are_dropped_are_paid_for(monkeypatch):
    # a thinner polygon without the lift would pass every test at a tolerance of 1e-12
    r = some(11, n=2, p=2, N=6, spread=2)
    y = every_vertex(r)
    monkeypatch.setattr(propagation, "COLLINEAR", 0.05)
    bounds = hull(r)
    assert np.all(bounds.low <= y.min(axis=0))
    assert np.all(bounds.high >= y.max(axis=0))
    assert np.max((bounds.high - y.max(axis=0)) / bounds.width) > 1e-4


@pytest.mark.parametrize("n", [2, 3])
def test_sets_that_stay_flat_stay_exact(n):
    # b and one direction of the start lie in an invariant line: the reachable states never fill the space
    r = some(12, n=n, p=2, N=40, lam=0.1)
    values = np.linspace(0.8, 0.3, n)
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((n, n)))[0]
    r = replace(r, A=(turn @ np.diag(values) @ turn.T)[None], b=turn[:, 0], spread=turn[:, :1])
    line = Recursion(
        A=[[[0.8]]], b=[1.0], c=r.c @ turn[:, :1], C=r.C @ turn[:, :1], lam=r.lam, q=np.zeros((40, 1)), g=nominal(r).y,
        f=nominal(r).z, mode=r.mode, start=[0.0], spread=[[1.0]],
    )  # fmt: skip
    np.testing.assert_allclose(hull(r).high, hull(line).high, atol=1e-8)
    np.testing.assert_allclose(hull(r).low, hull(line).low, atol=1e-8)


# ---- the adversary --------------------------------------------------------------------------------------------------


def test_random_sequences_and_constant_vertices_reach_only_a_fraction(long_run):
    recursion, run = long_run
    at = int((run.high - run.low).argmax())
    adversary = run.reached_high[at] - run.reached_low[at]
    delta = np.random.default_rng(11).choice(np.array([-1, 1], dtype=np.int8), (60, len(recursion), 5))
    random = np.ptp(simulate(recursion, delta)[:, at])
    constant = np.ptp(simulate(recursion, np.repeat(signs(1, 5), len(recursion), axis=1))[:, at])
    assert random < 0.5 * adversary
    assert constant < 0.2 * adversary
    assert constant < random


def test_a_light_damping_makes_the_worst_signs_alternate():
    # a constant sign of w is optimal for an overdamped plant: an adversary that knows nothing else would pass above
    recursion, *_ = difference_equation(LIGHTLY_DAMPED, 0.2, 0.02, 400)
    run = free_run(recursion)
    assert run.ratio <= 1 + 1e-6
    ones = worst_sequences(recursion, [399]).delta
    z = nominal(recursion).z
    w = np.sign(np.einsum("kp,kp->k", ones[0] * recursion.lam[0], z)[-40:-1])
    assert 3 <= np.count_nonzero(np.diff(w)) <= 30


@settings(max_examples=15)
@given(SEEDS, st.integers(1, 6), st.integers(0, 1))
@example(seed=199, n=6, spread=0)  # one sweep is not enough here
def test_the_sequence_for_an_instant_cannot_be_improved_at_a_single_sample(seed, n, spread):
    r = some(seed, n=n, p=2, N=10, modes=2, spread=spread, through=-1.0)
    found = worst_sequences(r, [6, 9])
    for instant, side, delta, start, y in zip(found.instant, found.side, found.delta, found.start, found.y, strict=True):
        T = int(instant)
        flipped = np.repeat(delta[None], (T + 1) * 2, axis=0)
        flipped[np.arange((T + 1) * 2), np.repeat(np.arange(T + 1), 2), np.tile([0, 1], T + 1)] *= -1
        others = simulate(r, flipped, np.repeat(start[None], len(flipped), axis=0))[:, T]
        assert np.all(side * others <= side * y[T] + 1e-9 * (1 + abs(y[T])))


def test_more_starts_never_reach_less():
    r = some(18, n=2, p=2, N=7, lam=0.5, spread=1)
    few, many = (np.ptp(worst_sequences(r, [6], starts=count).y[:, 6]) for count in (2, 64))
    assert many >= few


# ---- growth and bad input -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_an_unstable_box_gives_growing_bounds_and_infinity_without_warnings(n):
    run = free_run(some(2, n=n, p=2, N=2000, lam=4.0, radius=0.99))
    width = run.high - run.low
    assert width[-1] == np.inf
    assert np.isfinite(width[5])
    assert np.all(np.diff(np.isinf(width).astype(int)) >= 0)
    assert width[20] > 10 * width[3]
    assert not np.any(np.isnan(run.reached_low))
    assert run.ratio >= 1


def test_a_gain_above_one_says_that_the_kernel_grows_where_the_hull_does_not():
    r, *_ = difference_equation(LIGHTLY_DAMPED, 0.3, 0.15, 1500)
    bounds, width = kernel(r), hull(r).width
    assert bounds.gain > 1
    assert bounds.width[-1] > 20 * bounds.width[300]
    assert width[-1] < 1.5 * width[300]
    assert kernel(replace(r, lam=0.5 * r.lam)).gain == pytest.approx(0.5 * bounds.gain, rel=1e-9)


def test_bad_input_names_the_place():
    r = some(0)
    with pytest.raises(InputError, match="mode must be an integer from 0 to 0"):
        replace(r, mode=np.full(7, 1.0))
    with pytest.raises(InputError, match="not finite"):
        replace(r, g=np.full(7, np.inf))
    with pytest.raises(ValueError, match=r"Recursion\.lam"):
        replace(r, lam=[[-0.1, 0.1]])
    with pytest.raises(InputError, match=r"expected \(S, 7, 2\)"):
        simulate(r, np.zeros((7, 2)))
    with pytest.raises(InputError, match="leaves the box"):
        simulate(r, np.full((1, 7, 2), 1.5))
    with pytest.raises(InputError, match="from 0 to 6"):
        worst_sequences(r, [7])
    with pytest.raises(InputError, match="use kernel"):
        hull(some(0, n=4))
    with pytest.raises(InputError, match="nominal run overflows"):
        hull(some(0, N=4000, radius=1.5))


def test_points_that_are_flat_to_their_rounding_have_a_hull():
    """Qhull refuses them; the box around them holds them as well."""
    random = np.random.default_rng(3)
    flat = random.normal(size=(40, 2)) @ random.normal(size=(2, 3))
    corners = propagation._extreme(flat - flat.mean(axis=0), 1e-9)
    for direction in random.normal(size=(50, 3)):
        assert (corners @ direction).max() >= ((flat - flat.mean(axis=0)) @ direction).max()
