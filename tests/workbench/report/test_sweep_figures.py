"""Pictures of sweeps: what is drawn is what was given, and the numbers behind it are all there."""

import numpy as np
import pytest

from tests.workbench.report.test_control_figures import paths
from workbench.data import Channel
from workbench.records import RecordError
from workbench.report import figures

NOISE = Channel("noise", "", "other")


def test_medians_go_through_the_groups_and_every_run_is_in_the_numbers():
    groups = [
        (np.full(3, 1.0), np.array([1.0, 2.0, 9.0])),
        (np.full(2, 4.0), np.array([5.0, np.nan])),
        (np.full(1, 8.0), np.ones(1)),
    ]
    other = [(np.array([1.0, 4.0]), np.array([3.0, 3.0]))]
    picture = figures.courses("fits", NOISE, {"FIT": {"one": groups, "two": other}}, "A caption.", log=True)
    line = paths(picture)["medians-0-0"]
    assert len(line) == 3
    across = np.diff(line[:, 0])
    assert across[0] == pytest.approx(2.0 * across[1], rel=1e-3)  # log 4 is twice log 2
    rise = line[:, 1]  # down the page y grows: medians 2, 5, 1
    assert (rise[0] - rise[1]) / (rise[2] - rise[1]) == pytest.approx(3.0 / 4.0, rel=1e-3)
    columns = {c.name: list(c.values) for c in picture.data.columns}
    assert columns["curve"] == ["one"] * 6 + ["two"] * 2
    assert set(columns["panel"]) == {"FIT"}
    np.testing.assert_array_equal(columns["value"], [1.0, 2.0, 9.0, 5.0, np.nan, 1.0, 3.0, 3.0])
    np.testing.assert_array_equal(columns["noise"], [1.0, 1.0, 1.0, 4.0, 4.0, 8.0, 1.0, 4.0])
    assert picture.caption == "A caption. Dots: runs; lines: medians."


def test_groups_without_a_number_are_left_out_and_nothing_at_all_is_refused():
    none = [(np.full(2, 1.0), np.full(2, np.nan)), (np.full(2, 2.0), np.ones(2))]
    picture = figures.courses("t", NOISE, {"y": {"runs": none}}, "")
    assert "medians-0-0" in paths(picture)
    with pytest.raises(RecordError, match="nothing"):
        figures.courses("t", NOISE, {}, "")
