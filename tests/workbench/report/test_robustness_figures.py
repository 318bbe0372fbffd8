"""Pictures of runs and their limits: what is drawn, what is named instead, and the numbers behind it."""

import numpy as np

from workbench.data import Channel
from workbench.report.figures import beside_limits

T = np.linspace(0.0, 10.0, 101)
W3 = Channel("w3", "rad/s", "output")


def drawn(limits):
    runs = {"nominal machine": 100.0 + np.sin(T), "worst machine": 100.0 + 2.0 * np.sin(T)}
    return beside_limits("w3", T, W3, runs, limits, "Kept.")


def test_a_limit_that_is_near_is_drawn_and_one_that_is_far_is_named():
    near, far = np.where(T > 5.0, 103.0, np.nan), np.full(101, 140.0)
    picture = drawn({"high end of the band": near, "high limit": far})
    assert picture.figure_svg.count('id="limit-') == 1
    assert picture.caption == "Kept. Far from every run: high limit 140 rad/s."
    assert [column.name for column in picture.data.columns] == [
        "t", "nominal machine", "worst machine", "high end of the band", "high limit",
    ]  # fmt: skip
    np.testing.assert_array_equal(picture.data.columns[-2].values, near)


def test_without_limits_there_is_no_word_of_them():
    picture = drawn({})
    assert picture.caption == "Kept."
    assert 'id="limit-' not in picture.figure_svg
    assert picture.figure_svg.count('id="run-') == 2
