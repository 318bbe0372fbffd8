"""The pictures show the data: their lines are read back from the SVG and compared, up to the axis, with what went in."""

import math
import re
import xml.etree.ElementTree as ElementTree

import matplotlib
import numpy as np
import pytest

from workbench.data import Channel
from workbench.metrics import Score
from workbench.records import RecordError
from workbench.report import figures
from workbench.report.blocks import Picture
from workbench.report.figures import Coefficient, Trace
from workbench.report.palette import PAPER, SERIES
from workbench.report.svg import embed

SVG = "{http://www.w3.org/2000/svg}"
T = np.arange(200) * 0.04
Y = 100 + 20 * np.sin(T) + np.cos(17 * T)
W3 = Channel("w3", "rad/s")


def paths(picture: Picture, gid: str) -> list[np.ndarray]:
    """The pieces of the line called `gid`, in points from the upper left corner."""
    root = ElementTree.fromstring(picture.figure_svg)
    (group,) = [g for g in root.iter(f"{SVG}g") if g.get("id") == gid]
    pieces = group.find(f"{SVG}path").get("d").split("M")[1:]
    return [np.array(re.findall(r"-?[\d.]+", piece), float).reshape(-1, 2) for piece in pieces]


def line(picture: Picture, gid: str) -> np.ndarray:
    (path,) = paths(picture, gid)
    return path


def texts(picture: Picture) -> list[str]:
    return [t.text for t in ElementTree.fromstring(picture.figure_svg).iter(f"{SVG}text")]


def assert_shows(drawn: np.ndarray, values: np.ndarray) -> np.ndarray:
    """`drawn` is an affine image of `values` within a hundredth of a point; returns slope and offset."""
    design = np.column_stack([values, np.ones(len(values))])
    axis = np.linalg.lstsq(design, drawn, rcond=None)[0]
    np.testing.assert_allclose(design @ axis, drawn, atol=0.01)
    return axis


def record_picture(**simulated: np.ndarray) -> Picture:
    return figures.measured_and_simulated("prbs1", T, Trace(W3, Y), simulated, [Trace(Channel("r2", "m"), 0.01 + T / 100)])


def test_measured_simulated_and_error_are_on_the_page_with_one_scale_each():
    simulated = {"LTI": Y + np.sin(3 * T), "SSM": Y - 0.3 * np.cos(5 * T)}
    picture = record_picture(**simulated)
    level = assert_shows(line(picture, "measured")[:, 1], Y)
    assert level[0] < 0  # up is more
    errors = []
    for i, values in enumerate(simulated.values()):
        np.testing.assert_allclose(assert_shows(line(picture, f"simulated-{i}")[:, 1], values), level, rtol=1e-3)
        errors.append(assert_shows(line(picture, f"error-{i}")[:, 1], Y - values))
    # the sign of the error: measured - simulated, upwards
    assert errors[0][0] < 0
    np.testing.assert_allclose(errors[0], errors[1], rtol=1e-3)
    for gid in ("measured", "simulated-0", "error-1", "schedule"):
        np.testing.assert_array_equal(line(picture, gid)[:, 0], line(picture, "measured")[:, 0])
    assert_shows(line(picture, "measured")[:, 0], T)


def test_the_numbers_behind_a_record_are_those_that_went_in():
    simulated = {"LTI": Y + 1, "SSM": Y - 2}
    data = {str(column): column.values for column in record_picture(**simulated).data.columns}
    assert list(data) == ["t [s]", "w3 measured [rad/s]", "w3 LTI [rad/s]", "w3 SSM [rad/s]", "r2 [m]"]
    np.testing.assert_array_equal(data["w3 SSM [rad/s]"], Y - 2)
    np.testing.assert_array_equal(data["r2 [m]"], 0.01 + T / 100)


def test_no_line_joins_across_a_gap_of_time_or_a_lost_sample():
    t = np.where(np.arange(200) < 120, T, T + 1.0)
    y = Y + 0.5
    y[:20] = y[50] = np.nan
    picture = figures.measured_and_simulated("r", t, Trace(W3, Y), {"m": y})
    assert [len(piece) for piece in paths(picture, "measured")] == [120, 80]
    assert [len(piece) for piece in paths(picture, "error-0")] == [30, 69, 80]
    # one time axis: the error begins below the sample where the simulation does
    assert paths(picture, "error-0")[0][0, 0] == paths(picture, "measured")[0][20, 0]


@pytest.mark.slow
@pytest.mark.parametrize("last", [1e300, np.inf, -1e12])
def test_a_model_that_diverges_leaves_the_others_their_scale_and_is_named(last):
    runaway = Y.copy()
    runaway[100:] = np.geomspace(200, 1e9, 100) if last > 0 else -np.geomspace(200, 1e9, 100)
    runaway[-1] = last
    picture = record_picture(good=Y + 0.1, runaway=runaway)
    drawn = line(picture, "measured")[:, 1]
    assert np.ptp(drawn) > 40  # points: the measurement still fills a good part of its panel
    assert "Off the picture in part: runaway." in picture.caption
    assert max(float(np.abs(piece).max()) for piece in paths(picture, "simulated-1")) < 1e5
    assert "Off the picture" not in record_picture(good=Y + 0.1).caption


def test_a_long_record_costs_little_and_keeps_its_spike():
    N = 100_000
    t, y = np.arange(N) * 0.04, np.random.default_rng(0).normal(size=N)
    y[70_001] = 40.0
    picture = figures.measured_and_simulated("long", t, Trace(W3, y), {"m": np.zeros(N)})
    drawn = line(picture, "measured")
    assert len(drawn) < 2000
    peak = drawn[np.argmin(drawn[:, 1])]
    x = assert_shows(drawn[[0, -1], 0], t[[0, -1]])
    np.testing.assert_allclose(peak[0], x[0] * t[70_001] + x[1], atol=0.01)
    assert len(embed(picture.figure_svg, "p", "label", "caption")) < 80_000
    assert len(picture.data.columns[0].values) == N


def test_units_are_on_the_axes():
    said = texts(record_picture(SSM=Y))
    for label in ("w3 [rad/s]", "error [rad/s]", "r2 [m]", "t [s]"):
        assert label in said


@pytest.mark.parametrize("name", ["_hidden", "x^$_2$", "<b>x</b>&\"'", "漢字", "zero\x00", "\ud800"])
def test_any_name_is_drawn_as_it_is(name):
    picture = figures.measured_and_simulated(name, T, Trace(Channel(name, "m"), Y), {name: Y})
    shown = name.replace("\x00", "\ufffd").replace("\ud800", "\ufffd")
    assert shown in texts(picture)
    embed(picture.figure_svg, "p", picture.alt, "c").encode("utf-8")


def test_arrays_that_do_not_fit_name_the_model():
    with pytest.raises(RecordError, match=r"SSM: shape \(3,\), expected \(200,\)"):
        record_picture(SSM=np.zeros(3))


def test_settings_of_the_caller_neither_change_nor_are_changed():
    with matplotlib.rc_context({"font.size": 30.0, "lines.linewidth": 9.0, "axes.grid": False}):
        loud = record_picture(SSM=Y)
        assert matplotlib.rcParams["font.size"] == 30.0
    assert loud.figure_svg == record_picture(SSM=Y).figure_svg


def marks(picture: Picture, face: str) -> int:
    """How many dots have this face colour."""
    return len(re.findall(rf'<use [^>]*style="fill: {face}', picture.figure_svg))


def test_singular_values_keep_as_many_as_the_order():
    values = np.array([100.0, 50.0, 10.0, 0.1, 0.05])
    picture = figures.singular_values(values, 3)
    assert marks(picture, SERIES[0].light) == 3
    assert marks(picture, PAPER.light) == 2
    assert "factor 100" in picture.caption
    np.testing.assert_array_equal(picture.data.columns[1].values, values)


def test_a_singular_value_of_zero_is_no_reason_to_fail():
    assert "factor" not in figures.singular_values(np.array([1.0, 0.0, 0.0]), 1).caption


def test_order_sweep_marks_the_chosen_order_where_it_is():
    orders = [1, 2, 4, 8]
    picture = figures.order_sweep(orders, {"held-out": np.array([10.0, 60.0, 80.0, 70.0])}, chosen=4)
    assert_shows(line(picture, "fit-0")[:, 1], np.array([10.0, 60.0, 80.0, 70.0]))
    axis = assert_shows(line(picture, "fit-0")[:, 0], np.array(orders))
    np.testing.assert_allclose(line(picture, "chosen")[:, 0], axis[0] * 4 + axis[1], atol=0.01)


def test_sparsity_path_shows_every_point_over_the_logarithm_of_mu():
    mu = np.geomspace(1, 1000, 12)
    support, estimation, held_out = np.arange(12.0)[::-1], 90 - np.arange(12.0), 60 + np.sin(np.arange(12.0))
    picture = figures.sparsity_path(mu, support, estimation, held_out, chosen=float(mu[4]))
    for gid, values in (("held-out", held_out), ("estimation", estimation), ("support", support)):
        drawn = line(picture, gid)
        assert_shows(drawn[:, 1], values)  # all twelve: uneven steps of mu are no gaps
        assert_shows(drawn[:, 0], np.log(mu))
    assert not any("$" in text for text in texts(picture))
    by_name = {str(column): column.values for column in picture.data.columns}
    np.testing.assert_array_equal(by_name["FIT held-out [%]"], held_out)
    np.testing.assert_array_equal(by_name["FIT estimation [%]"], estimation)


def test_coefficients_are_drawn_with_truth_and_band_where_they_have_them():
    r = np.linspace(0.02, 0.06, 30)
    rho = Trace(Channel("r2", "m"), r)
    picture = figures.coefficient_functions(
        rho, {"f1": Coefficient(r**2, r**2 - 1, r**2 + 1, np.sin(50 * r)), "f2": Coefficient(np.cos(90 * r))}
    )
    np.testing.assert_allclose(
        assert_shows(line(picture, "truth-0")[:, 1], np.sin(50 * r)),
        assert_shows(line(picture, "identified-0")[:, 1], r**2),
        rtol=0.05,
    )
    assert_shows(line(picture, "identified-1")[:, 1], np.cos(90 * r))
    assert "truth-1" not in picture.figure_svg
    assert [str(c) for c in picture.data.columns] == [
        "r2 [m]",
        "f1 identified",
        "f1 low",
        "f1 high",
        "f1 truth",
        "f2 identified",
    ]


def test_frozen_responses_have_a_panel_for_each_value_of_the_schedule():
    omega = np.geomspace(0.1, 50, 40)
    rho = Trace(Channel("r2", "m"), np.array([0.02, 0.03, 0.04, 0.05]))
    truth = -20 * np.log10(omega) * rho.values[:, None]
    picture = figures.frozen_responses(omega, rho, {"truth": truth, "SSM": truth + 1}, "V2 to w3")
    for i in range(4):
        assert_shows(line(picture, f"frozen-{i}-0")[:, 1], truth[i])
        assert_shows(line(picture, f"frozen-{i}-1")[:, 1], truth[i] + 1)
        assert f"r2 = {rho.values[i]:g} m" in texts(picture)
    columns = {c.name: np.asarray(c.values) for c in picture.data.columns}
    k = 2 * 40 + 7
    assert (columns["omega"][k], columns["r2"][k], columns["truth"][k]) == (omega[7], 0.04, truth[2, 7])


def score(model: str, record: str, split, fit: float, output: str = "w3", horizon="free-run") -> Score:
    return Score(model, record, split, output, horizon, fit, 0.0, 0.0, "rad/s")


def test_score_dots_put_held_out_first_and_name_what_has_no_place_on_the_axis():
    scores = [
        score("LTI", "a", "estimation", 70.0),
        score("LTI", "b", "held-out", 40.0),
        score("SSM", "a", "estimation", 90.0),
        score("SSM", "b", "held-out", -20.4),
        score("SSM", "c", "held-out", -math.inf),
        score("SSM", "b", "held-out", 99.0, output="theta"),
        score("SSM", "b", "held-out", 98.0, horizon="one-step"),
    ]
    picture = figures.score_dots(scores, "w3")
    said = texts(picture)
    rows = [text for text in said if text and text.endswith(("(held-out)", "(estimation)"))]
    assert rows == ["b (held-out)", "c (held-out)", "a (estimation)"]
    assert any("SSM −20" in text for text in said if text)
    assert any("SSM below −1000" in text for text in said if text)
    assert any("free-run" in text for text in said if text)
    columns = {str(c): list(c.values) for c in picture.data.columns}
    assert columns["FIT LTI [%]"][0::2] == [40.0, 70.0]
    assert columns["FIT SSM [%]"] == [-20.4, -math.inf, 90.0]
    uses = re.search(r'id="fit-0".*?</g>\s*</g>', picture.figure_svg, re.S)
    assert uses
    x = [float(v) for v in re.findall(r'<use [^>]*x="([\d.]+)"', uses.group())]
    assert len(x) == 2
    assert x[0] < x[1]


def test_scores_of_another_output_are_refused():
    with pytest.raises(RecordError, match="no scores of theta"):
        figures.score_dots([score("LTI", "a", "held-out", 70.0)], "theta")
