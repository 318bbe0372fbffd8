"""Noise of a known filter: its coefficients, its innovations, and no better ones by an independent search."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.signal import lfilter

from workbench.identification.noise_model import fit_noise


def coloured(A, C, N, seed):
    e = np.random.default_rng(seed).standard_normal(N)
    return e, np.asarray(lfilter(C, A, e))


@pytest.mark.parametrize(("A", "C"), [
    ([1.0, -1.5, 0.7], [1.0, -0.6, 0.2]),
    ([1.0, -1.0, 0.0], [1.0, -0.85, 0.0]),  # what wanders, behind the noise of a sensor
    ([1.0, -1.9, 0.95], [1.0, 0.3, 0.1]),
])  # fmt: skip
def test_innovations_are_those_of_the_filter(A, C):
    e, v = coloured(A, C, 4000, 1)
    found = fit_noise([v], 2)
    own = found.innovations(v)
    assert np.corrcoef(e[50:], own[50:])[0, 1] > 0.995
    assert np.sum(own[50:] ** 2) <= 1.001 * np.sum(e[50:] ** 2)


def test_no_other_coefficients_leave_less():
    """Against a search without derivatives, from the truth and from where it ends."""
    A, C = [1.0, -1.2, 0.5], [1.0, 0.4, 0.2]
    series = [coloured(A, C, 600, seed)[1] for seed in (2, 3)]

    def cost(numbers):
        a, c = np.append(1.0, numbers[:2]), np.append(1.0, numbers[2:])
        if np.abs(np.roots(c)).max() > 0.995:
            return np.inf
        return sum(float(np.sum(np.asarray(lfilter(a, c, v))[2:] ** 2)) for v in series)

    found = fit_noise(series, 2)
    own = cost([*found.A[1:], *found.C[1:]])
    best = min(minimize(cost, start, method="Nelder-Mead").fun for start in ([*A[1:], *C[1:]], [*found.A[1:], *found.C[1:]]))
    assert own <= 1.0005 * best


def test_the_filter_can_always_be_inverted():
    for seed in range(20):
        v = np.random.default_rng(seed).standard_normal(60)
        found = fit_noise([np.diff(v, n=seed % 3)], 2)  # differences have a root on the circle
        assert np.abs(np.roots(found.C)).max() < 1.0
        assert np.isfinite(found.innovations(v)).all()
