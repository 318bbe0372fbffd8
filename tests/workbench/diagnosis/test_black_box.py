"""The diagnosis on an identified model: what is hidden in records of a black box is named, or declared as a tie."""

from dataclasses import replace

import numpy as np
import pytest

from tests.workbench.diagnosis.black_box import DT, PLANT, records
from workbench.data import Dataset
from workbench.diagnosis.answer import Finding
from workbench.diagnosis.check.records import check
from workbench.diagnosis.diagnosis import diagnose
from workbench.diagnosis.domains import shown
from workbench.diagnosis.predictor import predictor
from workbench.errors import InputError

LIMIT, LEVEL, ZONE, LAG = 0.6, 0.15, 0.15, 0.15


def late(u):
    """V1 two samples later."""
    u[2:, 0] = u[:-2, 0].copy()
    return u


def limited(u):
    u[:, 0] = np.clip(u[:, 0], -LIMIT, LIMIT)
    return u


def shifted(u):
    u[:, 1] += LEVEL
    return u


def deadened(u):
    u[:, 0] = np.sign(u[:, 0]) * np.maximum(np.abs(u[:, 0]) - ZONE, 0.0)
    return u


def slowed(y):
    """A lag in many small steps between samples that are joined by lines."""
    fine, read = 50, y.copy()
    for k in range(1, len(y)):
        reading = read[k - 1]
        for part in (np.arange(fine) + 0.5) / fine:
            reading = reading + DT / fine / LAG * (y[k - 1] + part * (y[k] - y[k - 1]) - reading)
        read[k] = reading
    return read


HIDDEN = {
    "input-delay@V1": ({"acting": late}, "time", 2 * DT),
    "saturation@V1": ({"acting": limited}, "limit", LIMIT),
    "dead-zone@V1": ({"acting": deadened}, "half_width", ZONE),
    "sensor-lag@w": ({"reading": slowed}, "time", LAG),
}


@pytest.mark.slow
@pytest.mark.parametrize("key", HIDDEN)
def test_what_is_hidden_in_a_black_box_is_named_with_its_size(key):
    hidden, name, truth = HIDDEN[key]
    found = diagnose(PLANT, records(21, **hidden), records(22, **hidden, count=1))
    assert found.finding is Finding.NAMED
    assert [cause.key for cause in found.causes] == [key]
    size = found.causes[0].parameters[name]
    assert size.value == pytest.approx(truth, rel=0.06)
    gains = {g.horizon: g.after / g.before for g in found.causes[0].gains}
    assert max(gains["one-step"], gains["full-run"]) < 0.8


@pytest.mark.slow
def test_an_offset_of_a_linear_box_ties_with_what_shifts_its_output_as_well():
    found = diagnose(PLANT, records(23, acting=shifted))
    assert len(found.causes) == 1
    cause = found.causes[0]
    assert "offset@V2" in (cause.key, *cause.ties)
    assert {cause.key, *cause.ties} <= {"offset@V1", "offset@V2", "sensor-bias@w"}


def rippled(y):
    """Once per turn of what turns with w itself, as logged."""
    angle = DT * np.cumsum(y[:, 0])
    return y + 0.04 * np.cos(angle + 0.4)[:, None]


@pytest.mark.slow
def test_what_goes_with_the_angle_of_a_logged_speed_is_left_over_that_angle():
    found = diagnose(PLANT, records(26, reading=rippled))
    assert found.finding in (Finding.UNKNOWN, Finding.INCOMPLETE)
    assert found.remainder[0].variable == "angle of w"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(31, 34))
def test_nothing_is_named_where_nothing_is_hidden(seed):
    found = diagnose(PLANT, records(seed))
    assert (found.finding, found.causes) == (Finding.NOTHING, ())
    assert found.limits  # and how much these records would have shown


def test_noise_enters_where_the_models_own_predictor_lets_it_in():
    assert predictor(PLANT, records(1, count=1, samples=100)).entries == ("innovation of w",)


@pytest.mark.parametrize(("key", "name"), [("saturation@V1", "limit"), ("sensor-lag@w", "time"), ("heating@V1", "fall")])
def test_a_named_effect_of_a_black_box_can_be_drawn(key, name):
    sizes = {key: {name: 0.5}}
    picture = shown(PLANT, sizes, key, records(24, acting=limited, count=1))
    assert picture is None if key.startswith("sensor-lag") else np.ptp(picture.after) > 0.0


def test_points_of_a_saturation_follow_its_line():
    picture = shown(
        PLANT, {"saturation@V1": {"limit": LIMIT}}, "saturation@V1", records(25, acting=limited, samples=2000, count=1)
    )
    assert picture is not None
    assert picture.measured == pytest.approx(picture.after, abs=0.05)
    assert np.abs(picture.after).max() > 0.3


# ---- what is refused --------------------------------------------------------------------------------------------------------


def test_records_without_the_schedule_are_refused_by_name():
    e = records(1, count=1).experiments[0]
    bare = replace(e, channels=e.channels[:3], values=e.values[:, :3])
    with pytest.raises(InputError, match="r2") as caught:
        check(PLANT, Dataset((bare,)))
    assert caught.value.channel == "r2"


def test_records_of_another_sample_time_are_refused():
    e = records(1, count=1).experiments[0]
    with pytest.raises(InputError, match="resample"):
        check(PLANT, Dataset((replace(e, t=2 * e.t, dt=2 * DT),)))
