import numpy as np
import pytest
from numba import njit

from workbench.physics import elementary


def on_array(function):
    @njit
    def loop(x):
        out = np.empty_like(x)
        for i in range(len(x)):
            out[i] = function(x[i])
        return out

    return loop


@pytest.mark.parametrize("name", ["sin", "cos", "tanh"])
def test_bounded_functions_agree_with_numpy(name):
    x = np.concatenate([np.linspace(-1e5, 1e5, 200_001), np.linspace(-4, 4, 80_001), [0.0, -0.0, 1e-300, -1e-9]])
    assert np.abs(on_array(getattr(elementary, name))(x) - getattr(np, name)(x)).max() < 4e-16


def test_exponential_has_relative_error_of_two_ulp():
    x = np.concatenate([np.linspace(-700, 700, 140_001), np.linspace(-1, 1, 20_001)])
    assert np.abs(on_array(elementary.exp)(x) / np.exp(x) - 1).max() < 2.5 * np.finfo(float).eps


def test_exponential_is_clamped_not_wrong_far_outside():
    low, high = on_array(elementary.exp)(np.array([-1e6, 1e6]))
    assert 0.0 <= low < 1e-300
    assert high > 1e300


def test_large_angles_keep_their_accuracy():
    x = np.linspace(1e6, 1e6 + 10, 10_001)  # a shaft at 1000 rad/s for a quarter of an hour
    assert np.abs(on_array(elementary.sin)(x) - np.sin(x)).max() < 1e-11


@pytest.mark.slow
def test_tanh_is_odd_and_sine_of_zero_is_zero():
    x = np.linspace(0.01, 30, 1001)
    assert np.array_equal(on_array(elementary.tanh)(-x), -on_array(elementary.tanh)(x))
    assert on_array(elementary.sin)(np.zeros(1))[0] == 0.0


@pytest.mark.parametrize("lanes", [1, 16])
def test_rows_are_copied_and_added_where_they_shall_be_and_nowhere_else(lanes):
    @njit
    def moved(W, other):
        elementary.copy_row(W, 3, other, 2, lanes)
        elementary.copy_row(W, 0, W, 4, lanes)
        elementary.add_row(W, 1, -0.1, W, 4, lanes)

    random = np.random.default_rng(0)
    W, other = random.standard_normal((5, lanes)), random.standard_normal((2, 2, lanes))
    expected = W.copy()
    expected[3], expected[0], expected[1] = other[1, 0], W[4], W[1] + -0.1 * W[4]
    moved(W.ravel(), other)
    np.testing.assert_array_equal(W, expected)
