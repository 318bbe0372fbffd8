"""The worst regressor over a box of errors: exact, attained, and proved by its multipliers, also where data are degenerate."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from workbench.errors import InputError
from workbench.intervals.regressors import ARX, FIR
from workbench.intervals.worst import WorstRegressor

CASES = [(n, delta) for n in (1, 2, 3) for delta in (True, False)]


def form_of(n, delta):
    return ARX(n, delta=delta).form("y", ["u"])


def by_linear_program(T, r, c, lam, psi):
    """min c'x + lam't, t >= +-T x, |x - psi| <= r."""
    m, p = len(psi), len(T)
    A = np.block([[T, -np.eye(p)], [-T, -np.eye(p)]])
    bounds = [*zip(psi - r, psi + r, strict=True), *[(0, None)] * p]
    return linprog(np.concatenate([c, lam]), A, np.zeros(2 * p), bounds=bounds).fun if m else 0.0


def drawn(form, seed, K=12):
    """Regressors about as large as their errors, so that kinks lie inside many boxes."""
    random = np.random.default_rng(seed)
    m = len(form.d)
    r = np.where(form.source >= 0, random.uniform(0.1, 1.0, m), 0.0)
    psi = np.where(form.source >= 0, random.standard_normal((K, m)), 1.0)
    return r, random.standard_normal(m), np.abs(random.standard_normal(m)), psi


def proved(worst, c, lam, psi):
    s = worst.multipliers(c, lam, psi)
    assert (np.abs(s) <= lam).all()
    C = c + s @ worst.T
    return (C * psi).sum(axis=1) - np.abs(C) @ worst.r


@pytest.mark.parametrize(("n", "delta"), CASES)
def test_the_minimum_is_that_of_a_linear_program_for_every_sample(n, delta):
    form = form_of(n, delta)
    r, c, lam, psi = drawn(form, n)
    worst = WorstRegressor(form, r)
    expected = [by_linear_program(form.T, r, c, lam, row) for row in psi]
    np.testing.assert_allclose(worst.value(c, lam, psi), expected, atol=1e-9)
    np.testing.assert_allclose(worst.minimum(c, lam, psi).value, expected, atol=1e-9)


@pytest.mark.parametrize(("n", "delta"), CASES)
def test_the_minimum_is_attained_in_the_box_and_no_drawn_regressor_is_worse(n, delta):
    form = form_of(n, delta)
    r, c, lam, psi = drawn(form, 10 + n)
    found = WorstRegressor(form, r).minimum(c, lam, psi)
    f = lambda x: x @ c + np.abs(x @ form.T.T) @ lam  # noqa: E731
    assert (np.abs(found.psi - psi) <= r * (1 + 1e-12) + 1e-15).all()
    np.testing.assert_allclose(f(found.psi), found.value, atol=1e-12)
    others = psi + r * np.random.default_rng(0).uniform(-1, 1, (4000, *psi.shape))
    assert (f(others) >= found.value - 1e-9).all()


@pytest.mark.parametrize(("n", "delta"), CASES)
def test_the_multipliers_prove_the_minimum(n, delta):
    form = form_of(n, delta)
    r, c, lam, psi = drawn(form, 20 + n, K=200)
    worst = WorstRegressor(form, r)
    np.testing.assert_allclose(proved(worst, c, lam, psi), worst.minimum(c, lam, psi).value, atol=1e-9)


@pytest.mark.slow
@settings(max_examples=60)
@given(st.integers(1, 3), st.booleans(), st.integers(0, 10**6))
def test_the_proof_stays_tight_on_quantised_and_resting_data(n, delta, seed):
    # quantised values lie on kinks and their boxes have corners on kinks; some errors, radii and parameters are 0
    form = form_of(n, delta)
    random = np.random.default_rng(seed)
    m = len(form.d)
    r = np.where(form.source >= 0, random.integers(0, 3, m) * 0.5, 0.0)
    psi = np.where(form.source >= 0, random.integers(-2, 3, (20, m)) * 0.5, 1.0)
    psi[:3, :-1] = 0.0
    psi[3:6, :-1] = r[:-1]
    c, lam = random.integers(-2, 3, m) * 1.0, random.integers(0, 3, m) * 1.0
    worst = WorstRegressor(form, r)
    value = worst.minimum(c, lam, psi).value
    np.testing.assert_allclose(proved(worst, c, lam, psi), value, atol=1e-9)
    np.testing.assert_allclose(value[::5], [by_linear_program(form.T, r, c, lam, row) for row in psi[::5]], atol=1e-9)


def test_order_four_is_exact_too():
    form = form_of(4, True)
    r, c, lam, psi = drawn(form, 4, K=6)
    worst = WorstRegressor(form, r)
    expected = [by_linear_program(form.T, r, c, lam, row) for row in psi]
    np.testing.assert_allclose(worst.value(c, lam, psi), expected, atol=1e-9)
    np.testing.assert_allclose(worst.minimum(c, lam, psi).value, expected, atol=1e-9)


def test_many_samples_are_treated_like_few():
    form = form_of(4, True)
    r, c, lam, psi = drawn(form, 5, K=2000)
    worst = WorstRegressor(form, r)
    few = np.concatenate([worst.minimum(c, lam, psi[k : k + 50]).psi for k in range(0, 2000, 50)])
    np.testing.assert_array_equal(worst.minimum(c, lam, psi).psi, few)


def test_one_entry_may_rest_at_its_kink():
    # f(c) = min over |x - 0.2| <= 1 of c x + 2|x|: 0 at x = 0 for |c| <= 2, beyond that at an end
    form = FIR(1, bias=False).form("y", ["u"])
    worst = WorstRegressor(form, np.array([1.0]))
    for c, expected in ((1.0, 0.0), (-2.0, 0.0), (3.0, -0.8), (-3.0, -1.2)):
        found = worst.minimum(np.array([c]), np.array([2.0]), np.array([[0.2]]))
        assert found.value[0] == pytest.approx(expected, abs=1e-15)


def test_without_errors_the_regressor_is_the_measured_one():
    form = form_of(2, True)
    _, c, lam, psi = drawn(form, 3)
    worst = WorstRegressor(form, np.zeros(len(form.d)))
    np.testing.assert_array_equal(worst.minimum(c, lam, psi).psi, psi)
    np.testing.assert_allclose(worst.value(c, lam, psi), psi @ c + np.abs(psi @ form.T.T) @ lam, rtol=1e-13)


def test_an_order_with_too_many_vertices_is_refused_with_its_mend():
    form = ARX(5).form("y", ["u"])
    with pytest.raises(InputError, match="5 values of one channel") as refused:
        WorstRegressor(form, np.ones(len(form.d)))
    assert "shift form" in refused.value.mend
    WorstRegressor(form, np.zeros(len(form.d)))  # exact regressors have no worst one
    shift = ARX(5, delta=False).form("y", ["u"])
    WorstRegressor(shift, np.ones(len(shift.d)))
