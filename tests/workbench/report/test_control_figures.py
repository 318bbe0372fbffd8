"""Pictures of control designs: what is drawn is what was given, and the numbers behind it are all there."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from workbench.data import Channel
from workbench.records import RecordError
from workbench.report import figures

SVG = "{http://www.w3.org/2000/svg}"


def paths(picture) -> dict[str, np.ndarray]:
    """Points (n, 2) of every line by its gid, as drawn."""
    root, found = ElementTree.fromstring(picture.figure_svg), {}
    for group in root.iter(f"{SVG}g"):
        path = group.find(f"{SVG}path")
        if group.get("id") and path is not None:
            words = path.get("d", "").replace("M", " ").replace("L", " ").replace("z", " ").split()
            found[group.get("id")] = np.array(words, dtype=float).reshape(-1, 2) if len(words) % 2 == 0 else None
    return found


def test_a_closed_loop_shows_set_points_and_every_law():
    t = np.linspace(0.0, 1.0, 11)
    y = {"one": np.sin(t), "other": np.cos(t)}
    w3, V1 = Channel("w3", "rad/s"), Channel("V1", "V")
    channels = [figures.Followed(w3, np.ones(11), y), figures.Followed(V1, None, {"other": t})]
    picture = figures.closed_loop("run", t, channels)
    drawn = paths(picture)
    assert {"set-point-0", "run-0-0", "run-0-1", "run-1-1"} <= set(drawn)
    assert "set-point-1" not in drawn
    level = drawn["set-point-0"][:, 1]
    assert np.ptp(level) == 0.0
    heights = drawn["run-0-1"][:, 1]  # cos falls: down the page y grows
    assert (np.diff(heights) > 0.0).all()
    columns = {str(c): np.asarray(c.values) for c in picture.data.columns}
    assert set(columns) == {"t [s]", "w3 set-point [rad/s]", "w3 one [rad/s]", "w3 other [rad/s]", "V1 other [V]"}
    np.testing.assert_array_equal(columns["w3 one [rad/s]"], np.sin(t))
    with pytest.raises(RecordError, match="no runs"):
        figures.closed_loop("run", t, [])


def test_numbers_over_the_schedule_a_panel_each_and_a_bound_as_a_level():
    rho = figures.Trace(Channel("r2", "m"), np.linspace(1.0, 2.0, 5))
    curves = {"S": {"pid": np.arange(5.0), "asked": np.array(1.6)}, "T": {"pid": np.ones(5)}}
    picture = figures.over_schedule("margins", rho, curves)
    drawn = paths(picture)
    assert np.ptp(drawn["curve-0-1"][:, 1]) == 0.0
    assert np.ptp(drawn["curve-0-0"][:, 1]) > 10.0
    columns = {str(c): np.asarray(c.values) for c in picture.data.columns}
    np.testing.assert_array_equal(columns["S asked"], np.full(5, 1.6))
    np.testing.assert_array_equal(columns["S pid"], np.arange(5.0))
    np.testing.assert_array_equal(columns["r2 [m]"], rho.values)


def test_a_nyquist_curve_touches_the_circle_where_its_sensitivity_is_the_bound():
    """L = -1 + exp(j a) / Ms lies on the circle; the critical point is its middle."""
    angle = np.linspace(0.1, 1.4, 20)
    L = -1.0 + np.exp(1j * angle) / 1.6
    picture = figures.nyquist("n", {"loop of V1": {"at 1": L, "at 2": 10.0 * L}}, 1.6)
    drawn = paths(picture)
    circle, own = drawn["bound-0"], drawn["nyquist-0-0"]
    middle, radius = circle[:-1].mean(axis=0), np.ptp(circle[:, 0]) / 2.0
    np.testing.assert_allclose(np.hypot(*(own - middle).T), radius, rtol=0.02)
    columns = {str(c): np.asarray(c.values) for c in picture.data.columns}
    np.testing.assert_array_equal(columns["loop of V1 at 2 imaginary"], 10.0 * L.imag)
    round_ = columns["sensitivity 1.6 real"] + 1j * columns["sensitivity 1.6 imaginary"]
    np.testing.assert_allclose(np.abs(round_ + 1.0), 1.0 / 1.6, rtol=1e-12)
