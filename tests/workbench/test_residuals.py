"""Residual tests: uniform p-values under the true model, rejection of wrong ones, and no false alarm from feedback."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from workbench.data import Channel, Experiment
from workbench.errors import InputError
from workbench.lpv import CONSTANT, OperatingPoint, Predictor, constant_model
from workbench.residuals import residual_test

POLE, GAIN, KALMAN = 0.9, 0.5, 0.4


def truth(pole=POLE, gain=GAIN, kalman=KALMAN):
    """x+ = pole x + gain u + kalman e, y = x + e, as a model with its own predictor."""
    point = OperatingPoint(CONSTANT, np.zeros((1, 1)), np.zeros((1, 1)))
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
