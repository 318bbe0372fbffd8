"""Excess of sequences written by hand, and the file that says what a loop must keep."""

import numpy as np
import pytest

from plants import WEB_WINDING, WELDING_ROBOT
from studies.experiments import web_winding_loops
from workbench.errors import InputError
from workbench.physics.controller import Playback
from workbench.robustness.limits import BOUNDS, Limit, Manoeuvre, load_limits, resolved

T = 0.5 * np.arange(8)  # 0 to 3.5 s


def test_excess_over_low_and_high_is_signed_and_says_where():
    y = np.array([0.0, 1.0, 2.5, 1.0, -1.0, -3.0, 0.0, 0.0])
    found = Limit("y", low=-2.0, high=3.0).excess(T, y)
    assert (found.value[0], found.share[0], found.sample[0], found.bound_of()) == (1.0, 0.2, 5, "low")
    found = Limit("y", low=-4.0, high=3.0).excess(T, y)
    assert (found.value[0], found.sample[0], found.bound_of()) == (-0.5, 2, "high")  # kept, and nearest there


def test_begin_counts_from_its_own_sample_on():
    y = np.array([9.0, 9.0, 5.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    assert Limit("y", high=0.0, begin=1.0).excess(T, y).value[0] == 5.0
    assert Limit("y", high=0.0, begin=1.2).excess(T, y).value[0] == 1.0
    tenths = 0.1 * np.arange(8)  # 0.1 * 3 is a little more than 0.3, 0.1 * 6 a little less than 0.6...
    for k in range(8):
        y = np.where(np.arange(8) == k, 7.0, 0.0)
        assert Limit("y", high=0.0, begin=k / 10).excess(tenths, y).value[0] == 7.0


def test_rate_is_per_second_of_either_sign_and_the_step_into_begin_does_not_count():
    y = np.array([9.0, 0.0, 1.0, 1.0, -2.0, -2.0, -2.0, -2.0])
    found = Limit("y", rate=4.0).excess(T, y)
    assert (found.value[0], found.share[0], found.sample[0]) == (14.0, 3.5, 1)
    found = Limit("y", rate=4.0, begin=0.5).excess(T, y)
    assert (found.value[0], found.share[0], found.sample[0], found.bound_of()) == (2.0, 0.5, 4, "rate")
    assert Limit("y", rate=4.0, unit="V").unit_of("rate") == "V/s"


def test_settling_counts_from_the_last_change_before_each_sample():
    r = np.array([0.0, 5.0, 5.0, 9.0, 9.0, 9.0, 9.0, 9.0])  # last at 1.5 s
    y = np.array([0.0, 0.0, 0.0, 0.0, 4.0, 12.0, 8.0, 9.5])
    limit = Limit("y", band=0.25, settling=1.0)
    found = limit.excess(T, y, r)
    assert (found.value[0], found.share[0], found.sample[0], found.bound_of()) == (2.75, 11.0, 5, "settling")
    assert Limit("y", band=0.25, settling=1.3).excess(T, y, r).value[0] == 0.75
    assert Limit("y", band=0.25, settling=1.3, begin=3.2).excess(T, y, r).value[0] == 0.25
    assert limit.excess(T, y + 9.0, np.full(8, 9.0)).sample[0] == 5  # a set-point that never moves: from the start on
    with pytest.raises(InputError, match="no set-point"):
        limit.excess(T, y)


def test_every_step_has_to_settle_not_the_last_alone():
    t = np.arange(0.0, 30.0, 0.1)
    r = np.select([t < 5.0, t < 25.0], [180.0, 200.0], 200.5)
    y = np.where((t > 5.0) & (t < 12.0), 230.0, r)  # after the large step far off, after the small one near
    found = Limit("y", band=14.0, settling=1.0).excess(t, y, r)
    assert (found.value[0], found.bound_of()) == (16.0, "settling")
    assert t[found.sample[0]] == pytest.approx(6.0)
    assert Limit("y", band=14.0, settling=8.0).excess(t, y, r).value[0] < 0.0


def test_of_several_bounds_the_one_that_is_broken_by_the_larger_share_counts():
    y = np.array([0.0, 0.0, 12.0, 12.0, 12.0, 12.0, 12.0, 12.0])
    by_rate = Limit("y", high=10.0, rate=2.0).excess(T, y)  # 2 of 10, but 22 of 2
    assert (by_rate.bound_of(), by_rate.value[0], by_rate.share[0]) == ("rate", 22.0, 11.0)
    by_level = Limit("y", high=10.0, rate=23.5).excess(T, y)  # 2 of 10, 0.5 of 23.5
    assert (by_level.bound_of(), by_level.value[0], by_level.share[0]) == ("high", 2.0, 0.2)
    every = Limit("y", high=10.0, rate=2.0).by_bound(T, y)
    assert [own.value[0] for own in every] == [-np.inf, 2.0, 22.0, -np.inf]
    np.testing.assert_array_equal(Limit("y", low=-1.0, high=4.0, rate=3.0, band=2.0).scales, [5.0, 5.0, 3.0, 2.0])
    np.testing.assert_array_equal(Limit("y", low=-8.0, rate=0.0).scales, [8.0, 1.0, 1.0, 1.0])
    assert Limit("y", low=3.0, high=3.0).scales.tolist() == [3.0, 3.0, 1.0, 1.0]


def test_limits_apart_ask_together_what_the_limit_asks():
    """A band of 0.2 about a set-point is no share of a bound of 2.5: each is asked by itself."""
    whole = Limit("p", low=2.5, rate=3.0, band=0.2, settling=1.0, begin=0.5, unit="bar")
    each = whole.apart
    assert [one.kept for one in each] == [("low",), ("rate",), ("settling",)]
    t, r = np.arange(0.0, 4.0, 0.1), np.where(np.arange(40) < 5, 3.0, 3.2)
    y = np.array([r + 0.15 * np.sin(3.0 * t), r - 0.6])
    for bound, one in zip((0, 2, 3), each, strict=True):
        np.testing.assert_array_equal(one.excess(t, y, r).value, whole.by_bound(t, y, r)[bound].value)
    both = Limit("p", low=1.0, high=2.0)
    assert [vars(one) for one in both.apart] == [vars(both)]


def test_a_run_that_was_lost_breaks_every_limit_and_none_of_its_neighbours():
    y = np.zeros((3, 8))
    y[1, 3:] = np.nan
    for limit in (
        Limit("y", high=1.0),
        Limit("y", low=-1.0, begin=3.0),
        Limit("y", rate=1.0),
        Limit("y", band=1.0, settling=3.0),
    ):
        found = limit.excess(T, y, np.zeros(8))
        assert found.value[1] == found.share[1] == np.inf
        assert (found.sample[1], found.bound_of(1)) == (3, "range")
        np.testing.assert_array_equal(found.share[[0, 2]], -1.0)
        assert found.bound_of(2) in BOUNDS


def test_a_batch_is_its_runs_one_by_one():
    random = np.random.default_rng(0)
    y, r = random.normal(size=(20, 8)), np.repeat([0.0, 1.0], 4)
    limit = Limit("y", low=-1.0, high=1.5, rate=3.0, band=2.0, settling=0.5, begin=0.5)
    together = limit.excess(T, y, r)
    for i, own in enumerate(y):
        alone = limit.excess(T, own, r)
        for name in ("value", "share", "sample", "bound"):
            assert getattr(alone, name)[0] == getattr(together, name)[i]
    assert len(set(together.bound)) == 4


def test_a_limit_that_keeps_nothing_is_refused():
    for options in ({}, {"settling": 3.0}, {"low": 2.0, "high": 1.0, "rate": 1.0}):
        with pytest.raises(InputError):
            Limit("y", **options)


def test_the_run_of_a_file_steps_at_its_own_samples():
    law = web_winding_loops()
    course = Manoeuvre(20.0, {"w3": ((0.0, 100.0),), "theta": ((0.0, 0.0), (4.84, 5.0), (10.01, 2.0))}, {"r2": 0.02}, 3)
    found = course.scenario(WEB_WINDING, law)
    assert (len(found), found.seed, found.start) == (500, 3, {"r2": 0.02})
    np.testing.assert_array_equal(found.references["w3_set"], 100.0)
    np.testing.assert_array_equal(np.flatnonzero(np.diff(found.references["theta_set"])) + 1, [121, 251])  # 121 * 0.04 is 4.84
    for other, message in (
        (Manoeuvre(20.0, {"w3": ((0.0, 1.0),)}), "no set-point for theta"),
        (Manoeuvre(20.0, {**course.setpoints, "w33": ((0.0, 1.0),)}), "unknown output of the controller"),
        (Manoeuvre(20.0, course.setpoints, {"r3": 1.0}), "unknown state or input"),
        (Manoeuvre(0.05, course.setpoints), "at least two samples"),
    ):
        with pytest.raises(InputError, match=message):
            other.scenario(WEB_WINDING, law)


def test_limits_get_the_units_of_the_plant_and_must_fit_the_loop():
    law = web_winding_loops()
    found = resolved([Limit("V1", high=3.0), Limit("theta", band=1.0), Limit("w1", high=1.0)], WEB_WINDING, law)
    assert [limit.unit for limit in found] == ["V", "deg", "rad/s"]
    for limit, message in (
        (Limit("W3", high=1.0), "did you mean 'w3'"),
        (Limit("theta", high=1.0, unit="rad"), "give the bounds in deg"),
        (Limit("w1", band=1.0), "settling needs a set-point"),
    ):
        with pytest.raises(InputError, match=message):
            resolved([limit], WEB_WINDING, law)
    with pytest.raises(InputError, match="unknown channel 'arm'"):  # nobody commands it
        resolved([Limit("arm", high=1.0)], WELDING_ROBOT, Playback(("u",), 0.02))


# ---- the file ------------------------------------------------------------------------------------------------------------------

RUN = "[run]\nduration = 20\n[run.setpoints]\nw3 = 100.0\ntheta = [[0.0, 0.0], [5.0, 5.0]]\n"
WHOLE = (
    RUN.replace("duration = 20\n", "duration = 20.0\nseed = 3\nstart = {r2 = 0.02}\ninitial = {w3 = [90, 110.0]}\n")
    + "[limits.theta]\nlow = -20.0\nhigh = 20\nbegin = 1.0\n[limits.w3]\nband = 5.0\nsettling = 3.0\n"
    "[limits.V1]\nlow = -2.0\nhigh = 3.0\nrate = 50.0\nunit = 'V'\n[loop]\nstable = true\nmargin = 1\nsensitivity = 1.8\n"
)


def written(folder, text):
    path = folder / "limits.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_every_key_of_the_file_arrives(tmp_path):
    found = load_limits(written(tmp_path, WHOLE))
    theta, w3, v1 = found.limits
    assert (theta.signal, theta.low, theta.high, theta.begin, theta.rate, theta.band) == ("theta", -20, 20, 1, np.inf, np.inf)
    assert (w3.signal, w3.low, w3.band, w3.settling, w3.kept) == ("w3", -np.inf, 5.0, 3.0, ("settling",))
    assert (v1.signal, v1.low, v1.high, v1.rate, v1.unit) == ("V1", -2.0, 3.0, 50.0, "V")
    assert (found.stable, found.margin, found.sensitivity) == (True, 1.0, 1.8)
    assert found.run
    assert (found.run.duration, found.run.seed, found.run.start) == (20.0, 3, {"r2": 0.02})
    assert found.run.setpoints == {"w3": ((0.0, 100.0),), "theta": ((0.0, 0.0), (5.0, 5.0))}
    assert found.run.initial == {"w3": (90.0, 110.0)}
    loop = Playback(("a", "b"), 0.02, measured=("theta", "w3"))
    np.testing.assert_array_equal(found.run.rested(loop, np.array([0.5, 100.0])), [[0.5, 0.5], [90.0, 110.0]])
    with pytest.raises(InputError, match="unknown output of the controller 'w3'"):
        found.run.rested(Playback(("a",), 0.02, measured=("theta",)), np.array([0.5]))


def test_what_is_left_out_is_not_asked(tmp_path):
    found = load_limits(written(tmp_path, "[loop]\nstable = false\n"))
    assert (found.stable, found.margin, found.sensitivity, found.limits, found.run) == (False, None, None, (), None)
    found = load_limits(written(tmp_path, RUN + "[limits.theta]\nhigh = 20.0\n"))
    assert found.run
    assert (found.stable, found.run.seed, found.run.start, found.run.initial) == (True, None, {}, {})


LIMIT = RUN + "[limits.theta]\n"


@pytest.mark.parametrize(
    ("text", "place", "mend"),
    [
        ("", "nothing to keep", "give [limits.SIGNAL]"),
        (RUN, "nothing to keep", "give [limits.SIGNAL]"),
        ("[run\n", "not TOML", "line 1"),
        ("[limit.theta]\nhigh = 2\n", "unknown table 'limit'", "did you mean 'limits'"),
        ("limits = 3\n", "limits is 3", "expected a table: [limits]"),
        ("[limits.theta]\nhigh = 2\n", "[run] is missing", "give its duration"),
        (LIMIT + "hihg = 2\n", "unknown key in [limits.theta] 'hihg'", "did you mean 'high'"),
        (LIMIT + "high = '2'\n", "[limits.theta] high = '2'", "expected a number"),
        (LIMIT + "high = true\n", "[limits.theta] high = True", "expected a number"),
        (LIMIT + "high = nan\n", "[limits.theta] high = nan", "finite"),
        (LIMIT + "high = inf\n", "[limits.theta] high = inf", "leave out what has no bound"),
        (LIMIT + "low = 3.0\nhigh = 2.0\n", "[limits.theta] low = 3", "exchange them"),
        (LIMIT + "begin = 1.0\n", "[limits.theta] keeps nothing", "give low, high, rate"),
        (LIMIT + "high = 2.0\nbegin = -1.0\n", "[limits.theta] begin = -1", "0 or later"),
        (LIMIT + "high = 2.0\nbegin = 20.0\n", "[limits.theta] begin = 20", "begin earlier"),
        (LIMIT + "band = 2.0\n", "[limits.theta] band without settling", "give settling too"),
        (LIMIT + "settling = 2.0\nhigh = 1.0\n", "[limits.theta] settling without band", "give band too"),
        (LIMIT + "band = 2.0\nsettling = -1\n", "[limits.theta] settling = -1", "0 or later"),
        (LIMIT + "band = 2.0\nsettling = 15.0\n", "[limits.theta] settling = 15", "last moves at 5 s"),
        (LIMIT + "band = 0\nsettling = 1\n", "[limits.theta] band = 0", "above 0"),
        (LIMIT + "rate = -5.0\n", "[limits.theta] rate = -5", "above 0"),
        (LIMIT + "high = 1.0\nunit = 3\n", "[limits.theta] unit = 3", "expected a text"),
        (RUN + "[limits]\ntheta = 3.0\n", "limits.theta is 3.0", "expected a table"),
        (LIMIT + "high = 1\n[loop]\nmargins = 1\n", "unknown key in [loop] 'margins'", "did you mean 'margin'"),
        (LIMIT + "high = 1\n[loop]\nmargin = 0\n", "[loop] margin = 0", "above 0"),
        (LIMIT + "high = 1\n[loop]\nsensitivity = 0.9\n", "[loop] sensitivity = 0.9", "peak |S|"),
        (LIMIT + "high = 1\n[loop]\nstable = 1\n", "[loop] stable = 1", "true or false"),
        (LIMIT.replace("duration = 20\n", ""), "[run] duration is missing", "duration = 20.0"),
        (LIMIT.replace("= 20", "= -20"), "[run] duration = -20", "above 0"),
        (LIMIT.replace("= 20", "= 20\nseed = 1.5"), "[run] seed = 1.5", "whole number"),
        (LIMIT.replace("= 20", "= 20\nsede = 1"), "unknown key in [run] 'sede'", "did you mean 'seed'"),
        (LIMIT.replace("= 20", "= 20\nstart = {r2 = 'a'}"), "[run.start] r2 = 'a'", "expected a number"),
        (LIMIT.replace("= 20", "= 20\ninitial = {w3 = 'a'}"), "[run.initial] w3 = 'a'", "expected a number"),
        (LIMIT.replace("= 20", "= 20\ninitial = {w3 = [1.0]}"), "[run.initial] w3 = [1.0]", "the lowest and the highest"),
        (LIMIT.replace("= 20", "= 20\ninitial = {w3 = [1, inf]}"), "[run.initial] w3 = [1, inf]", "the lowest and the highest"),
        (LIMIT.replace("= 20", "= 20\ninitial = {w3 = [2, 1]}"), "[run.initial] w3 = [2, 1]", "comes first"),
        (LIMIT.replace("100.0", "'fast'"), "[run.setpoints] w3 = 'fast'", "expected a number"),
        (LIMIT.replace("[5.0, 5.0]", "[5.0]"), "[run.setpoints] theta = a list", "pairs [time, value]"),
        (LIMIT.replace("[5.0, 5.0]", "[5.0, nan]"), "[run.setpoints] theta = [5.0, nan]", "finite"),
        (LIMIT.replace("[[0.0,", "[[1.0,"), "[run.setpoints] theta", "value at the start"),
        (LIMIT.replace("[5.0, 5.0]", "[0.0, 5.0]"), "[run.setpoints] theta", "must rise"),
        (LIMIT.replace("[5.0, 5.0]", "[25.0, 5.0]"), "[run.setpoints] theta", "after the run's end at 20 s"),
    ],
)
def test_what_makes_no_sense_is_refused_with_place_and_mend(tmp_path, text, place, mend):
    path = written(tmp_path, text)
    with pytest.raises(InputError) as refused:
        load_limits(path)
    said = str(refused.value)
    assert place in said
    assert mend in said
    assert str(path) in said


def test_a_file_that_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(InputError, match="check the path"):
        load_limits(tmp_path / "none.toml")
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="UTF-8"):
        load_limits(tmp_path / "b.toml")
