"""Profiles against the chi squared of a linear model, and where a curvature says nothing: the date of a jump, play."""

import numpy as np
import pytest

from tests.workbench.diagnosis.cases import ROBOT, axis_records, fitted, refitted, robot_records, screened
from workbench.diagnosis.diagnosis import diagnose
from workbench.diagnosis.profile import LIKELY, Profile, profile
from workbench.diagnosis.refit import refit, settled
from workbench.diagnosis.screen import small_sizes
from workbench.diagnosis.sizes import sizes_of


def test_the_interval_of_a_parabola_is_the_normal_one_and_grows_with_the_root_of_the_inflation():
    values = np.linspace(-10.0, 10.0, 2001)
    curve = Profile(values, ((values - 1.0) / 2.0) ** 2)
    assert curve.interval() == pytest.approx((1.0 - 1.96 * 2.0, 1.0 + 1.96 * 2.0), abs=1e-3)
    assert curve.interval(4.0) == pytest.approx((1.0 - 1.96 * 4.0, 1.0 + 1.96 * 4.0), abs=1e-3)
    assert Profile(values, np.zeros(2001)).interval() == (-10.0, 10.0)


def test_where_the_errors_are_linear_a_profile_is_the_parabola_of_the_covariance():
    model = refitted(fitted(axis_records(1, {"offset@F": {"level": 6.0}})), "offset@F", [5.0])
    at = model.fit.unknowns.size - 1
    sd = np.sqrt(model.fit.covariance[at, at])
    found = profile(model.predictor, model.fit, at, 5.0 * sd)
    expected = ((found.values - model.fit.z[at]) / sd) ** 2
    np.testing.assert_allclose(found.deviance - found.deviance.min(), expected, atol=0.02)
    low, high = found.interval()
    assert high - low == pytest.approx(2.0 * np.sqrt(LIKELY) * sd, rel=0.01)


@pytest.mark.slow
def test_the_date_of_a_jump_is_found_between_the_dates_that_are_screened():
    hits = 0
    for seed, time in ((3, 4.3), (5, 6.1), (7, 3.7), (9, 5.4)):
        records = robot_records(seed, {"friction-jump@rail": {"level": 0.3, "time": time}})
        model = fitted(records)
        sizes = small_sizes(model.predictor, model.fit)
        (score,) = screened(model, ["friction-jump@rail"])
        found = sizes_of(settled(refit(model, score, sizes), sizes), "friction-jump@rail")["time"]
        assert found.value == pytest.approx(time, abs=0.25)
        assert found.high - found.low < 1.5
        hits += found.low <= time <= found.high
    assert hits >= 3


@pytest.mark.slow
def test_rounding_is_named_and_not_the_play_that_it_looks_like():
    records = robot_records(11, {"quantisation@v": {"step": 0.02}})
    found = diagnose(ROBOT, records)
    assert [c.key for c in found.causes] == ["quantisation@v"]
    step = found.causes[0].parameters["step"]
    assert step.low <= 0.02 <= step.high
