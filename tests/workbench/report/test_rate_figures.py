"""Pictures of rates: dots and intervals where the numbers are, squares as large as their share."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from workbench.records import RecordError
from workbench.report import figures
from workbench.report.figures import Rates
from workbench.report.palette import SERIES

CURVE = Rates(
    np.array([1.0, 2.0, 4.0]), np.array([0.0, 0.5, 1.0]), np.array([0.0, 0.2, 0.7]), np.array([0.3, 0.8, 1.0]), np.full(3, 10.0)
)


def group(svg, gid):
    return next(e for e in ElementTree.fromstring(svg).iter() if e.get("id") == gid)


def heights(svg, gid):
    """Vertical places of the points of a line, upwards."""
    path = next(e for e in group(svg, gid).iter() if e.tag.endswith("path") and len(e.get("d", "").split()) > 8)
    return [-float(y) for _, y in re.findall(r"[ML] ([-\d.]+) ([-\d.]+)", path.get("d"))]


def bars(svg, gid):
    """Lengths of vertical bars."""
    found = []
    for path in group(svg, gid).iter():
        if path.tag.endswith("path"):
            ends = [float(y) for _, y in re.findall(r"[ML] ([-\d.]+) ([-\d.]+)", path.get("d"))]
            found.append(abs(ends[1] - ends[0]))
    return found


def areas(svg, gid):
    """Areas of the squares of a group, whether drawn one by one or once and used again."""
    used = {e.get("id"): e for e in ElementTree.fromstring(svg).iter() if e.get("id")}
    paths = [
        used[next(v for k, v in e.items() if k.endswith("href")).lstrip("#")] if e.tag.endswith("use") else e
        for e in group(svg, gid).iter()
        if e.tag.endswith("use") or (e.tag.endswith("path") and not e.get("id"))
    ]
    corners = [np.array(re.findall(r"[ML] ([-\d.]+) ([-\d.]+)", path.get("d")), float) for path in paths]
    return np.array([np.ptp(c[:, 0]) * np.ptp(c[:, 1]) for c in corners])


def test_dots_lie_at_their_rates_and_bars_span_their_intervals():
    svg = figures.rates("Found", "size", {"name": CURVE}, "Caption.").figure_svg
    first, middle, last = heights(svg, "rate-0")
    assert middle - first == pytest.approx(last - middle)
    lengths = np.array(bars(svg, "interval-0")) / (last - first)
    np.testing.assert_allclose(lengths, CURVE.high - CURVE.low, atol=1e-4)


def test_the_numbers_behind_a_picture_of_rates_are_those_of_every_curve():
    columns = {c.name: c.values for c in figures.rates("Found", "size", {"a": CURVE, "b": CURVE}, "Caption.").data.columns}
    assert list(columns["curve"]) == ["a"] * 3 + ["b"] * 3
    np.testing.assert_array_equal(columns["rate"], np.tile(CURVE.rate, 2))
    np.testing.assert_array_equal(columns["size"], np.tile(CURVE.x, 2))


def test_a_picture_of_what_was_stated_has_the_line_of_honest_odds():
    stated = figures.rates(
        "Odds", "stated", {"names": Rates(*(np.array([v]) for v in (0.7, 0.6, 0.4, 0.8, 9.0)))}, "", stated=True
    )
    assert group(stated.figure_svg, "stated") is not None
    assert 'id="stated"' not in figures.rates("Found", "size", {"name": CURVE}, "").figure_svg


def test_squares_are_as_large_as_their_share_of_the_row_and_a_name_taken_for_itself_has_its_colour():
    counts = np.array([[3.0, 1.0, 0.0], [0.0, 2.0, 0.0]])
    picture = figures.taken_for("Hidden and named", ["a", "b"], ["a", "b", "c"], counts, "Caption.")

    same, other = areas(picture.figure_svg, "same-True"), areas(picture.figure_svg, "same-False")
    assert len(other) == 1
    np.testing.assert_allclose(same / other, [3.0, 4.0], rtol=1e-3)  # 3/4 and the whole of the row b against 1/4
    assert SERIES[0].light in ElementTree.tostring(group(picture.figure_svg, "same-True"), encoding="unicode")
    assert list(picture.data.columns[1].values) == [3.0, 0.0]


def test_nothing_to_draw_is_refused():
    none = Rates(*(np.empty(0) for _ in range(5)))
    with pytest.raises(RecordError, match="no trials"):
        figures.rates("Found", "size", {"name": none}, "")
    with pytest.raises(RecordError, match=r"expected \(1, 2\)"):
        figures.taken_for("Title", ["a"], ["a", "b"], np.ones((2, 2)), "")
