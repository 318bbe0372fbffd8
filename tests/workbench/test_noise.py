"""The estimate of measurement noise: from above, and not far above where the record can tell."""

import numpy as np
import pytest
from scipy.signal import lfilter

from workbench.data import Dataset, Experiment
from workbench.noise import measurement_noise


def record(noise, *, disturbance=0.0, N=4000, seed=0):
    random = np.random.default_rng(seed)
    u = np.repeat(random.choice([-1.0, 1.0], N // 5), 5)
    x = lfilter([0.0, 0.1, 0.05], [1.0, -1.6, 0.68], u + disturbance * random.standard_normal(N))
    return Experiment.from_arrays("a", 0.1, inputs={"u": u}, outputs={"y": x + noise * random.standard_normal(N)})


@pytest.mark.parametrize("noise", [0.002, 0.02, 0.1])
def test_white_noise_on_a_driven_machine_is_found(noise):
    found = [measurement_noise(Dataset((record(noise, seed=s),)), "y", ["u"]) for s in range(5)]
    assert np.all(np.array(found) > 0.8 * noise)
    assert np.all(np.array(found) < 1.25 * noise)


def test_a_disturbance_that_nobody_logged_counts_at_most_with_what_it_moves_at_the_quietest_frequency():
    """The one-step error would say 0.1; the spectrum of this machine falls off and leaves the noise to be seen."""
    found = measurement_noise(Dataset((record(0.005, disturbance=1.0),)), "y", ["u"])
    assert 0.8 * 0.005 < found < 4 * 0.005


def test_no_noise_gives_almost_none():
    assert measurement_noise(Dataset((record(0.0),)), "y", ["u"]) < 1e-6


def test_gaps_are_not_crossed_and_short_records_say_nothing():
    e = record(0.02)
    t = e.t.copy()
    t[2000:] += 5.0
    broken = Experiment(e.name, t, e.channels, np.where(np.arange(4000)[:, None] < 2000, e.values, e.values + 50.0), e.dt)
    assert measurement_noise(Dataset((broken,)), "y", ["u"]) < 0.03
    short = Experiment(e.name, e.t[:30], e.channels, e.values[:30], e.dt)
    assert measurement_noise(Dataset((short,)), "y", ["u"]) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("N", [300, 1000, 3000])
def test_the_estimate_is_from_above_on_short_records_too(N):
    """A bound that is too small would break every promise that rests on it."""
    found = np.array([measurement_noise(Dataset((record(0.1, N=N, seed=s),)), "y", ["u"]) for s in range(30)]) / 0.1
    assert np.mean(found >= 0.97) >= 0.9
    assert np.median(found) < 1.5
