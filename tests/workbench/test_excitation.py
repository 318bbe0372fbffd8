import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import max_len_seq

from workbench import excitation
from workbench.errors import InputError


@pytest.mark.parametrize("bits", range(3, 17))
def test_prbs_is_a_maximum_length_sequence(bits):
    """Its periodic autocorrelation is 1 at lag 0 and -1/(2^n - 1) at every other: only maximum-length sequences have it."""
    period = 2**bits - 1
    x = excitation.prbs(period, bits=bits)
    spectrum = np.abs(np.fft.fft(x)) ** 2
    correlation = np.fft.ifft(spectrum).real / period
    assert correlation[0] == pytest.approx(1.0)
    np.testing.assert_allclose(correlation[1:], -1.0 / period, atol=1e-9)
    assert abs(x.sum()) == 1.0


def test_prbs_repeats_after_4095_steps_and_not_before():
    x = excitation.prbs(2 * 4095)
    assert np.array_equal(x[:4095], x[4095:])
    assert all(not np.array_equal(x[:3000], x[lag : lag + 3000]) for lag in range(1, 4095))


def test_prbs_contains_the_same_words_as_scipys_sequence():
    """Every register state but zero occurs exactly once a period, as in scipy's generator."""

    def words(x):
        bits = np.concatenate([x, x[:11]]) > 0
        return {tuple(bits[i : i + 12]) for i in range(4095)}

    assert words(excitation.prbs(4095)) == words(max_len_seq(12)[0] * 2.0 - 1)


@pytest.mark.slow
@given(st.integers(1, 9), st.integers(0, 4094), st.integers(1, 500))
def test_prbs_hold_and_shift(hold, shift, samples):
    x = excitation.prbs(samples, hold=hold, shift=shift)
    assert np.array_equal(x, np.roll(excitation.prbs(4095), -shift)[np.arange(samples) // hold])


def test_random_binary_switches_with_the_stated_probability():
    x = excitation.random_binary(100_000, 3, hold=10, probability=0.2)
    at = np.flatnonzero(np.diff(x)) + 1
    assert set(np.unique(x)) == {-1.0, 1.0}
    assert np.all(at % 10 == 0)
    assert len(at) / 10_000 == pytest.approx(0.2, abs=0.02)
    assert not np.array_equal(x, excitation.random_binary(100_000, 4, hold=10, probability=0.2))


def test_multisine_has_its_lines_and_nothing_else():
    x = excitation.multisine(2250, 1, 0.04, lines=20, low=0.02, high=2.0)
    amplitude = np.abs(np.fft.rfft(x)) / 1125
    frequency = np.fft.rfftfreq(2250, 0.04)
    lines = amplitude > 0.01
    assert lines.sum() == 20
    assert frequency[lines].min() >= 1 / 90
    assert frequency[lines].max() == pytest.approx(2.0, abs=0.02)
    assert np.ptp(amplitude[lines]) < 1e-9
    assert amplitude[~lines].max() < 1e-9
    assert np.abs(x).max() == pytest.approx(1.0)


def test_filtered_gaussian_rolls_off_at_its_cutoff():
    from scipy.signal import welch

    f, power = welch(excitation.filtered_gaussian(200_000, 2, 0.04, cutoff=1.0), 25.0, nperseg=4096)
    low, at, above = (power[(f > a) & (f < b)].mean() for a, b in ((0.05, 0.3), (0.95, 1.05), (3.9, 4.1)))
    assert at / low == pytest.approx(0.5, abs=0.1)  # -3 dB
    assert above / low < 0.01  # second order: 4^-4 and less


def test_staircase_and_ramp():
    x = excitation.staircase(100, [0.0, 2.0, -1.0, 0.0], rise=5)
    assert list(x[[0, 24, 30, 49, 55, 74, 80, 99]]) == [0.0, 0.0, 2.0, 2.0, -1.0, -1.0, 0.0, 0.0]
    assert np.abs(np.diff(x)).max() == pytest.approx(0.6)
    np.testing.assert_allclose(excitation.ramp(5, [0.0, 1.0, 0.0]), [0.0, 0.5, 1.0, 0.5, 0.0])


def test_impossible_requests_are_refused():
    with pytest.raises(InputError, match="17 bits"):
        excitation.prbs(10, bits=17)
    with pytest.raises(InputError, match="does not fit"):
        excitation.multisine(100, 0, 0.04, lines=5, low=0.001, high=2.0)
