"""Pictures of a diagnosis: what they draw and count is read back from data, caption and SVG."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from workbench.data import Channel
from workbench.records import RecordError
from workbench.report import figures
from workbench.report.figures import ParameterEstimate, Trace

SVG = "{http://www.w3.org/2000/svg}"


def places(picture, gid):
    """Where the markers called `gid` are, in points from the upper left corner."""
    root = ElementTree.fromstring(picture.figure_svg)
    (group,) = [g for g in root.iter(f"{SVG}g") if g.get("id") == gid]
    return np.array([(u.get("x"), u.get("y")) for u in group.iter(f"{SVG}use")], float)


def line(picture, gid):
    """The corners of the line called `gid`."""
    root = ElementTree.fromstring(picture.figure_svg)
    (group,) = [g for g in root.iter(f"{SVG}g") if g.get("id") == gid]
    return np.array(re.findall(r"-?[\d.]+", next(group.iter(f"{SVG}path")).get("d")), float).reshape(-1, 2)


def columns(picture):
    return {str(column): list(column.values) for column in picture.data.columns}


def test_parameters_are_drawn_in_per_cent_from_nominal_and_named_where_beyond():
    estimates = [
        ParameterEstimate("kE", "N/m", 200.0, 220.0, 210.0, 230.0, 0.2),
        ParameterEstimate("B1", "N m s/rad", 2e-5, 1e-5, 0.9e-5, 1.1e-5, 0.3),
    ]
    np.testing.assert_allclose(estimates[0].relative, [10.0, 5.0, 15.0])
    picture = figures.parameters(estimates)
    assert "Beyond their tolerance: B1." in picture.caption
    x = places(picture, "value")[:, 0]
    root = ElementTree.fromstring(picture.figure_svg)
    (bars,) = [g for g in root.iter(f"{SVG}g") if g.get("id") == "interval"]
    ends = [np.array(re.findall(r"-?[\d.]+", path.get("d")), float).reshape(-1, 2)[:, 0] for path in bars.iter(f"{SVG}path")]
    scale = (x[0] - x[1]) / (10.0 + 50.0)  # points for a per cent
    np.testing.assert_allclose((ends[0] - x[0]) / scale, [-5.0, 5.0], atol=0.01)
    np.testing.assert_allclose((ends[1] - x[1]) / scale, [-5.0, 5.0], atol=0.01)
    assert columns(picture)["nominal"] == [200.0, 2e-5]
    with pytest.raises(RecordError, match="nothing was fitted"):
        figures.parameters([])


def test_missing_physics_is_drawn_in_the_order_of_what_it_depends_on():
    x = np.array([3.0, -2.0, 1.0, 0.0])
    measured, after = 2 * x + 0.1, 2 * x
    what = Trace(Channel("missing torque at rewind", "N m"), measured)
    picture = figures.missing("coulomb@rewind", Channel("w2", "rad/s"), what, x, np.full(4, 0.1), after)
    table = columns(picture)
    assert table["w2 [rad/s]"] == [-2.0, 0.0, 1.0, 3.0]
    np.testing.assert_allclose(table["missing torque at rewind measured [N m]"], [-3.9, 0.1, 2.1, 6.1])
    points, drawn, before = places(picture, "measured"), line(picture, "after"), line(picture, "before")
    np.testing.assert_allclose(points[:, 0], drawn[:, 0], atol=0.01)
    # the points lie 0.1 above the line, whose ends are 10 apart
    np.testing.assert_allclose(drawn[:, 1] - points[:, 1], 0.01 * (drawn[0, 1] - drawn[-1, 1]), atol=0.01)
    assert np.ptp(before[:, 1]) == 0.0


def test_only_effects_with_a_rival_are_in_the_matrix_and_the_larger_share_has_the_larger_square():
    shares = np.eye(4)
    shares[0, 2], shares[2, 0], shares[1, 3] = 0.9, 0.3, 0.4
    picture = figures.similarity(["a@x", "b@x", "c@x", "d@x"], shares)
    assert "2 of 4 effects have a rival" in picture.caption
    table = columns(picture)
    assert table["effect"] == ["a@x", "c@x"]
    assert table["c@x"] == [0.9, 1.0]
    strong, weak = places(picture, "alike-True"), places(picture, "alike-False")
    assert len(strong) == len(weak) == 1
    assert strong[0, 0] > weak[0, 0]  # column c, row a: upper right
    assert strong[0, 1] < weak[0, 1]
    assert "No two effects look alike" in figures.similarity(["a@x", "b@x"], np.eye(2)).caption
    with pytest.raises(RecordError, match="expected"):
        figures.similarity(["a"], np.eye(2))


def test_signals_have_a_panel_each_and_their_samples_in_the_file():
    traces = [Trace(Channel("w3_set", "rad/s"), np.arange(5.0)), Trace(Channel("theta_set", "deg"), np.zeros(5))]
    picture = figures.signals("Next experiment", 0.04 * np.arange(5), traces, "Play this.")
    table = columns(picture)
    np.testing.assert_allclose(table["t [s]"], 0.04 * np.arange(5))
    assert table["w3_set [rad/s]"] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert len(line(picture, "signal-0")) == len(line(picture, "signal-1")) == 5
    with pytest.raises(RecordError, match="expected \\(3,\\)"):
        figures.signals("x", np.arange(3.0), [Trace(Channel("a"), np.zeros(3)), Trace(Channel("b"), np.zeros(4))], "")


def test_what_is_left_is_the_curve_it_was_given():
    grid, curve = np.linspace(0.0, 1.0, 7), np.linspace(0.0, 1.0, 7) ** 2
    picture = figures.left_over("w2 over T2", Channel("T2", "N"), Trace(Channel("w2", "rad/s"), curve), grid)
    drawn = line(picture, "left")
    np.testing.assert_allclose((drawn[0, 1] - drawn[:, 1]) / (drawn[0, 1] - drawn[-1, 1]), curve, atol=1e-3)
    assert columns(picture)["T2 [N]"] == list(grid)
