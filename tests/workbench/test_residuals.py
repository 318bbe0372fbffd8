"""Residual tests: uniform p-values under the true model, rejection of wrong ones, and no false alarm from feedback."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, kstest, norm

from workbench.basis import CONSTANT
from workbench.data import Channel, Experiment
from workbench.errors import InputError
from workbench.lpv import OperatingPoint, Predictor, constant_model
from workbench.residuals import ResidualTest, residual_test

POLE, GAIN, KALMAN = 0.9, 0.5, 0.4


def truth(pole=POLE, gain=GAIN, kalman=KALMAN, u0=0.0, y0=0.0):
    """x+ = pole x + gain (u - u0) + kalman e, y = x + y0 + e, as a model with its own predictor."""
    point = OperatingPoint(CONSTANT, np.array([[u0]]), np.array([[y0]]))
    predictor = Predictor(np.array([[[pole - kalman]]]), np.array([[[gain]]]), np.array([[[kalman]]]), 30)
    channels = ((Channel("u", "V", "input"),), (Channel("y", "m", "output"),))
    matrices = [np.array([[v]]) for v in (pole, gain, 1.0, 0.0)]
    return constant_model("truth", 0.1, channels, matrices, point, predictor=predictor)


def machine(seed, N=800, feedback=0.0, smooth=0.9):
    random = np.random.default_rng(seed)
    e, r = random.standard_normal((2, N))
    x = held = 0.0
    u, y = np.zeros(N), np.zeros(N)
    for k in range(N):
        y[k] = x + e[k]
        held = smooth * held + r[k]
        u[k] = held - feedback * y[k]
        x = POLE * x + GAIN * u[k] + KALMAN * e[k]
    return Experiment.from_arrays("r", 0.1, inputs={"u": u}, outputs={"y": y})


@pytest.mark.slow
@pytest.mark.parametrize(("feedback", "closed"), [(0.0, False), (0.0, True), (0.8, True)], ids=["open", "past", "closed"])
@pytest.mark.parametrize("smooth", [0.0, 0.97])
def test_p_values_are_uniform_under_the_true_model(feedback, closed, smooth):
    runs = [residual_test(truth(), machine(s, 800, feedback, smooth), closed_loop=closed, lags=15) for s in range(150)]
    for kind in (0, 1):
        p = np.array([run.checks[kind].p_value for run in runs])
        # the level of this test is 1 in 1000; a p-value off by a factor of two at the lower end is caught
        assert kstest(p, "uniform").pvalue > 1e-3
        assert np.mean(p < 0.05) < 0.12
    assert np.mean([run.passed for run in runs]) > 0.88


def test_without_the_correction_for_smooth_inputs_the_test_would_be_wrong():
    """The same statistic with P = 1 rejects far too often: the correction is what calibrates it."""
    naive = [
        800 * np.sum(residual_test(truth(), machine(s, 800, 0.0, 0.97), closed_loop=False, lags=15).checks[1].correlation ** 2)
        for s in range(60)
    ]
    assert np.std(naive) > 2.0 * np.sqrt(2 * 31)


def test_coloured_residuals_alone_do_not_blame_the_input():
    """A model without noise model has the true gain and coloured residuals: its statistic has the mean of its chi-squared."""
    runs = [residual_test(truth(kalman=0.0), machine(s, 800, 0.0, 0.9), closed_loop=False, lags=10) for s in range(60)]
    white, free = ([run.checks[kind] for run in runs] for kind in (0, 1))
    assert np.mean([check.p_value for check in white]) < 1e-6
    assert np.mean([check.statistic / check.dof for check in free]) == pytest.approx(1.0, abs=0.2)


def test_whiteness_is_the_portmanteau_statistic():
    """Ljung and Box, with correlations by Fourier transform."""
    e = machine(6, 700)
    found = residual_test(truth(), e, lags=12, closed_loop=False).checks[0]
    left = (e[["y"]] - truth().predict(e))[30:, 0]
    N = len(left)
    power = np.abs(np.fft.rfft(left - left.mean(), 2 * N)) ** 2
    r = np.fft.irfft(power)[:13] / np.fft.irfft(power)[0]
    assert found.statistic == pytest.approx(N * (N + 2) * sum(r[k] ** 2 / (N - k) for k in range(1, 13)), rel=1e-9)
    assert found.dof == 12
    assert found.p_value == pytest.approx(chi2.sf(found.statistic, 12))
    np.testing.assert_allclose(found.correlation, r[1:], atol=1e-12)
    assert found.bound == pytest.approx(norm.ppf(0.995) / np.sqrt(N), rel=1e-3)


def test_units_and_zeros_of_the_channels_do_not_matter():
    e = machine(7, 700)
    moved = replace(e, values=e.values * [0.01, 0.01] + [5.0, -3.0])
    for closed in (False, True):
        one, other = (
            residual_test(model, record, closed_loop=closed).checks
            for model, record in ((truth(), e), (truth(u0=5.0, y0=-3.0), moved))
        )
        for a, b in zip(one, other, strict=True):
            np.testing.assert_allclose(b.correlation, a.correlation, atol=1e-9)
            assert (b.dof, b.bound, b.p_value) == pytest.approx((a.dof, a.bound, a.p_value), rel=1e-6)


@pytest.mark.parametrize("at", [30, 400, 799])
def test_an_input_is_judged_where_it_moves_at_all(at):
    """And one that stands still is not."""
    e = machine(8)
    still = replace(e, values=e.values * [0.0, 1.0])
    assert [c.kind for c in residual_test(truth(), still, closed_loop=False).checks] == ["whiteness"]
    still = replace(still, values=still.values + np.outer(np.arange(800) == at, [1.0, 0.0]))
    assert [c.kind for c in residual_test(truth(), still, closed_loop=False).checks] == ["whiteness", "input"]


def test_what_is_rejected_is_said():
    found = residual_test(truth(), machine(9), closed_loop=False)
    assert str(found) == "truth on r: residuals are white and free of the inputs, as far as this record shows"
    white, free = found.checks
    at = ResidualTest("m", "r", False, (replace(white, p_family=0.05), replace(free, p_family=0.0499)))
    assert not at.passed
    assert at.rejected == at.checks[1:]  # below the level, not at it
    assert str(at) == "m on r: residual of y still contains u"


def test_feedback_alone_does_not_reject_a_true_model():
    # both signs of the lag on a closed-loop record blame the model for what the controller does
    record = machine(3, 2000, feedback=0.8)
    assert residual_test(truth(), record).closed_loop
    assert residual_test(truth(), record).passed
    assert not residual_test(truth(), record, closed_loop=False).passed


@pytest.mark.parametrize(
    ("wrong", "kind"),
    [(truth(gain=0.4), "input"), (truth(kalman=0.1), "whiteness"), (truth(pole=0.85), "input")],
    ids=["gain", "noise model", "pole"],
)
def test_a_wrong_model_is_rejected_for_the_right_reason(wrong, kind):
    found = residual_test(wrong, machine(4, 2000), closed_loop=False)
    assert kind in {check.kind for check in found.rejected}
    assert "residual of y" in str(found)


def test_family_wise_values_are_holms():
    found = residual_test(truth(gain=0.4), machine(5, 500), closed_loop=False)
    p = sorted(c.p_value for c in found.checks)
    expected = [min(1.0, 2 * p[0]), max(min(1.0, 2 * p[0]), p[1])]
    assert sorted(c.p_family for c in found.checks) == pytest.approx(expected)


def test_too_short_records_are_refused():
    with pytest.raises(InputError, match="lags"):
        residual_test(truth(), machine(0, 100))


def test_an_unstable_predictor_is_told_as_such_and_huge_records_have_a_test():
    with pytest.raises(InputError, match="leave the numbers"), np.errstate(all="ignore"):
        residual_test(truth(pole=40.0), machine(0, 2000), closed_loop=False)
    e = machine(4, 2000)
    small, huge = (residual_test(truth(), replace(e, values=size * e.values), closed_loop=False) for size in (1.0, 1e160))
    assert [c.p_value for c in huge.checks] == pytest.approx([c.p_value for c in small.checks])
