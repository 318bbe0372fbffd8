"""Pictures of interval models: what they count, draw and mark is read back from caption, data and SVG."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from workbench.data import Channel
from workbench.errors import InputError
from workbench.records import RecordError
from workbench.report import figures
from workbench.report.blocks import Picture
from workbench.report.figures import Band, ParameterInterval, Trace, Width
from workbench.report.palette import SERIES
from workbench.report.svg import embed

SVG = "{http://www.w3.org/2000/svg}"
T = np.arange(400) * 0.04
Y = 100 + 20 * np.sin(T)
W3 = Trace(Channel("w3", "rad/s"), Y)


def paths(picture: Picture, gid: str) -> list[np.ndarray]:
    """The pieces of what is called `gid`, in points from the upper left corner."""
    root = ElementTree.fromstring(picture.figure_svg)
    (group,) = [g for g in root.iter(f"{SVG}g") if g.get("id") == gid]
    pieces = next(group.iter(f"{SVG}path")).get("d").split("M")[1:]
    return [np.array(re.findall(r"-?[\d.]+", piece), float).reshape(-1, 2) for piece in pieces]


def places(picture: Picture, gid: str) -> np.ndarray:
    """Where the dots called `gid` are."""
    root = ElementTree.fromstring(picture.figure_svg)
    (group,) = [g for g in root.iter(f"{SVG}g") if g.get("id") == gid]
    return np.array([(u.get("x"), u.get("y")) for u in group.iter(f"{SVG}use")], float)


def gids(picture: Picture) -> set[str | None]:
    return {g.get("id") for g in ElementTree.fromstring(picture.figure_svg).iter(f"{SVG}g")}


def texts(picture: Picture) -> list[str]:
    return [t.text or "" for t in ElementTree.fromstring(picture.figure_svg).iter(f"{SVG}text")]


def columns(picture: Picture) -> dict[str, list]:
    return {str(column): list(column.values) for column in picture.data.columns}


def assert_shows(drawn: np.ndarray, values: np.ndarray) -> np.ndarray:
    """`drawn` is an affine image of `values` within a hundredth of a point; returns slope and offset."""
    design = np.column_stack([values, np.ones(len(values))])
    axis = np.linalg.lstsq(design, drawn, rcond=None)[0]
    np.testing.assert_allclose(design @ axis, drawn, atol=0.01)
    return axis


def drawn(**bands: Band) -> Picture:
    return figures.envelope("one step", T, W3, bands)


def test_the_lower_panel_shows_band_and_distance_on_one_scale_around_the_middle():
    half, middle = 0.3 + 0.1 * np.cos(T), Y + 0.2 * np.sin(3 * T)
    picture = drawn(SSM=Band(middle - half, middle + half))
    level = assert_shows(paths(picture, "around-0-high")[0][:, 1], half)
    np.testing.assert_allclose(assert_shows(paths(picture, "around-0-low")[0][:, 1], -half), level, rtol=1e-3)
    np.testing.assert_allclose(assert_shows(paths(picture, "around-0-measured")[0][:, 1], Y - middle), level, rtol=1e-3)
    assert level[0] < 0  # up is more
    above = assert_shows(paths(picture, "measured")[0][:, 1], Y)
    np.testing.assert_allclose(assert_shows(paths(picture, "band-0-low")[0][:, 1], middle - half), above, rtol=1e-3)


def test_values_outside_are_counted_and_marked_where_they_are_and_the_bounds_themselves_are_inside():
    low, high = Y - 1, Y + 1
    low[10], high[20] = Y[10], Y[20]
    low[30], high[40] = Y[30] + 1e-9, Y[40] - 0.5
    picture = drawn(SSM=Band(low, high))
    assert "SSM: 398 of 400 measured values inside (99.5 %)" in picture.caption
    for gid, line in (("outside", "measured"), ("around-0-outside", "around-0-measured")):
        np.testing.assert_allclose(places(picture, gid), paths(picture, line)[0][[30, 40]], atol=0.01)
    assert "outside" not in gids(drawn(SSM=Band(Y - 1, Y + 1)))


def test_only_all_values_inside_are_a_hundred_percent():
    t, y = np.arange(5000.0), np.zeros(5000)
    high = np.ones(5000)
    high[7] = -0.5
    picture = figures.envelope("e", t, Trace(W3.channel, y), {"m": Band(y - 1, high)})
    assert "4999 of 5000 measured values inside (99.9 %)" in picture.caption


def test_width_is_the_mean_of_high_minus_low_and_a_thin_band_is_said_to_be_one():
    wide = drawn(SSM=Band(Y - 1, Y + 3))
    assert "on average 4 rad/s wide" in wide.caption
    assert "Too thin" not in wide.caption
    assert "Too thin to be seen in the upper panel: thin." in drawn(wide=Band(Y - 1, Y + 3), thin=Band(Y - 0.1, Y + 0.1)).caption


def test_samples_without_a_band_are_not_counted_and_break_it():
    low, high = Y - 1, Y + 1
    low[:5] = high[100] = np.nan
    picture = drawn(SSM=Band(low, high))
    assert "394 of 394 measured values inside (100 %)" in picture.caption
    assert [len(piece) for piece in paths(picture, "band-0-low")] == [95, 299]
    assert "says nothing" in drawn(none=Band(low * np.nan, high)).caption


def test_a_gap_of_time_breaks_the_band():
    t = np.where(np.arange(400) < 150, T, T + 1.0)
    picture = figures.envelope("e", t, W3, {"SSM": Band(Y - 1, Y + 1)})
    assert [len(piece) for piece in paths(picture, "band-0-high")] == [150, 250]
    (tint,) = [g for g in ElementTree.fromstring(picture.figure_svg).iter(f"{SVG}g") if g.get("id") == "band-0"]
    assert len(list(tint.iter(f"{SVG}path"))) == 2


@pytest.mark.parametrize("last", [np.inf, 1e300, 1e9])
def test_a_band_that_ran_away_leaves_the_measurement_its_scale(last):
    half = np.r_[np.full(380, 1.0), np.geomspace(2, 1e9, 19), last]
    picture = drawn(runaway=Band(Y - half, Y + half))
    assert np.ptp(paths(picture, "measured")[0][:, 1]) > 30
    assert max(np.abs(p).max() for p in paths(picture, "around-0-high") + paths(picture, "band-0-high")) < 1e5
    assert "cut off" in picture.caption
    assert "cut off" not in drawn(good=Band(Y - 1, Y + 1)).caption


def test_the_numbers_of_an_envelope_are_those_that_went_in_with_their_units():
    picture = figures.envelope("e", T, W3, {"free": Band(Y - 3, Y + 3, Y - 2, Y + 1)}, nominal=Y + 0.5)
    assert list(columns(picture)) == [
        "t [s]",
        "w3 measured [rad/s]",
        "free low [rad/s]",
        "free high [rad/s]",
        "free reached low [rad/s]",
        "free reached high [rad/s]",
        "w3 nominal [rad/s]",
    ]
    assert columns(picture)["free reached high [rad/s]"] == list(Y + 1)
    level = assert_shows(paths(picture, "band-0-low")[0][:, 1], Y - 3)
    np.testing.assert_allclose(assert_shows(paths(picture, "band-0-reached-high")[0][:, 1], Y + 1), level, rtol=1e-3)


@pytest.mark.slow
def test_bands_differ_in_colour_and_none_is_that_of_what_lies_outside():
    picture = drawn(**{f"m{i}": Band(Y - 1 - i, Y + 1 + i) for i in range(5)})
    found = [re.search(rf'id="band-{i}-low".*?stroke: (#\w+)', picture.figure_svg, re.S) for i in range(5)]
    colours = {match.group(1) for match in found if match}
    assert len(colours) == 5
    assert SERIES[1].light not in colours


def test_bad_envelopes_are_refused_with_their_name():
    with pytest.raises(InputError, match="no envelope"):
        drawn()
    with pytest.raises(InputError, match=r"SSM: low lies above high at 400 of 400"):
        drawn(SSM=Band(Y + 1, Y - 1))
    with pytest.raises(RecordError, match=r"SSM low: shape \(3,\), expected \(400,\)"):
        drawn(SSM=Band(Y[:3], Y))
    with pytest.raises(InputError, match="reached_high is missing"):
        drawn(SSM=Band(Y - 1, Y + 1, Y))


@pytest.mark.slow
def test_a_long_record_costs_little_and_keeps_the_extremes_of_band_and_signal():
    N = 100_000
    rng = np.random.default_rng(0)
    t, y = np.arange(N) * 0.04, rng.normal(size=N)
    high = np.full(N, 2.0)
    high[70_001], y[30_003] = 20.0, 15.0
    picture = figures.envelope("long", t, Trace(W3.channel, y), {"m": Band(y * 0 - 2, high)})
    line = paths(picture, "band-0-high")[0]
    assert np.ptp(line[:, 1]) > 50
    assert len(embed(picture.figure_svg, "p", "label", "caption")) < 250_000
    spike = places(picture, "outside")
    np.testing.assert_allclose(spike[spike[:, 1].argmin(), 1], paths(picture, "measured")[0][:, 1].min(), atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("M", [1, 2, 60])
def test_modes_are_a_step_line_and_every_sample_is_drawn_in_one_colour(M):
    mode = np.arange(400) * M // 400
    picture = figures.modes_along_time("modes", T, W3, mode)
    x, level = paths(picture, "mode")[0].T
    starts = np.flatnonzero(np.r_[True, np.diff(mode) > 0])
    assert len(x) == 2 * M
    if M > 1:
        assert_shows(level, np.repeat(np.arange(M), 2).astype(float))
        assert_shows(x[::2], T[starts])
        np.testing.assert_array_equal(x[1:-1:2], x[2::2])  # a mode lasts until the next begins
    joined = np.concatenate([p for c in range(min(M, 6)) for p in paths(picture, f"colour-{c}")])
    assert len(joined) == 400 + M - 1  # the first sample of a mode ends the line of the one before
    assert f"{M} operating mode{'s' * (M > 1)}, {M - 1} changes" in picture.caption
    assert columns(picture)["mode"] == list(mode)


def test_short_tails_are_marked_and_named():
    mode = np.repeat([0, 1, 2], [200, 180, 20])
    picture = figures.modes_along_time("modes", T, W3, mode, ["slow", "fast", "end"], short=[2])
    (tail,) = paths(picture, "short")
    np.testing.assert_allclose(tail, paths(picture, "mode")[0][-2:])
    assert "Made from a short tail: end." in picture.caption
    assert {"slow", "fast", "end", "short tail"} <= set(texts(picture))
    assert "short" not in gids(figures.modes_along_time("modes", T, W3, mode))
    assert columns(picture)["mode name"][-1] == "end"


def test_no_mode_bridges_lost_time_or_samples_without_a_mode():
    mode = np.zeros(400)
    mode[100:120] = np.nan
    t = np.where(np.arange(400) < 300, T, T + 5.0)
    picture = figures.modes_along_time("modes", t, W3, mode)
    pieces = paths(picture, "mode")
    assert len(pieces) == 3
    x = assert_shows(paths(picture, "colour-0")[0][:, 0], t[:101])
    np.testing.assert_allclose([p[:, 0] for p in pieces], x[0] * t[[[0, 99], [120, 299], [300, 399]]] + x[1], atol=0.02)


def test_many_changes_of_mode_cost_little():
    N = 100_000
    mode = np.random.default_rng(0).integers(0, 60, N)
    picture = figures.modes_along_time("modes", np.arange(N) * 0.04, Trace(W3.channel, np.sin(np.arange(N) / 900)), mode)
    assert len(embed(picture.figure_svg, "p", "label", "caption")) < 400_000


def test_modes_that_are_no_numbers_or_have_no_names_are_refused():
    with pytest.raises(InputError, match=r"0\.5 is no number of a mode"):
        figures.modes_along_time("m", T, W3, np.full(400, 0.5))
    with pytest.raises(InputError, match="mode 3, but 2 names"):
        figures.modes_along_time("m", T, W3, np.full(400, 3), ["a", "b"])
    with pytest.raises(InputError, match="no sample has a mode"):
        figures.modes_along_time("m", T, W3, np.full(400, -1))


def test_parameter_intervals_are_constant_in_each_mode_and_the_truth_is_counted():
    edges, p = np.array([0.0, 4.0, 16.0]), ParameterInterval(np.array([1.0, 3.0]), np.array([0.5, 1.0]))
    truth = np.where(T < 4, 1.4, 2.0)
    truth[0], truth[-1] = 1.6, 4.1
    picture = figures.parameters_along_time("p", edges, {"a1": p, "b1": p}, T, {"a1": truth})
    level = assert_shows(paths(picture, "truth-0")[0][:, 1], truth)
    for side, values in (("low", [0.5, 0.5, 2, 2]), ("high", [1.5, 1.5, 4, 4])):
        (line,) = paths(picture, f"interval-0-{side}")
        np.testing.assert_allclose(line[:, 1], level[0] * np.array(values) + level[1], atol=0.05)
        assert_shows(line[:, 0], np.array([0.0, 4, 4, 16]))
    assert "a1: the truth lies in its interval at 398 of 400 samples." in picture.caption
    assert "truth-1" not in gids(picture)
    assert columns(picture)["a1 centre"][99:101] == [1.0, 3.0]
    alone = columns(figures.parameters_along_time("p", edges, {"a1": p}))
    assert alone == {"from [s]": [0, 4], "to [s]": [4, 16], "a1 centre": [1, 3], "a1 radius": [0.5, 1]}


def test_parameters_that_do_not_fit_their_edges_are_refused():
    p = ParameterInterval(np.ones(2), np.ones(2))
    with pytest.raises(InputError, match="no parameters"):
        figures.parameters_along_time("p", np.arange(3.0), {})
    with pytest.raises(RecordError, match=r"a1 centre: shape \(2,\), expected \(5,\)"):
        figures.parameters_along_time("p", np.arange(6.0), {"a1": p})
    with pytest.raises(InputError, match="without its time"):
        figures.parameters_along_time("p", np.arange(3.0), {"a1": p}, truth={"a1": Y})


@pytest.mark.parametrize("M", [1, 60])
def test_domains_and_their_samples_share_a_colour_and_the_axes(M):
    corners = np.array([[0, 0], [2, 0], [2, 1], [0, 1.0]])
    regions = {f"d{i}": corners + 3 * i for i in range(M)}
    points = np.array([[3 * i + 1, 3 * i + 0.5] for i in range(M)])
    picture = figures.domains("d", Channel("y", "N"), Channel("u", "V"), regions, points, np.arange(M))
    (outline,) = paths(picture, "region-0")
    (x,), (y,) = places(picture, "samples-0").T
    np.testing.assert_allclose([x, y], outline[:4].mean(axis=0), atol=0.01)
    for gid in ("region", "samples"):
        assert re.search(rf'id="{gid}-{M - 1}".*?{SERIES[(M - 1) % 6].light}', picture.figure_svg, re.S)
    assert columns(picture)["y [N]"] == [*points[:, 0], *np.concatenate(list(regions.values()))[:, 0]]
    assert {"y [N]", "u [V]"} <= set(texts(picture))


def test_flat_domains_and_samples_without_a_mode_are_drawn():
    regions = {"line": np.array([[0, 0], [1, 1.0]]), "point": np.array([[2, 2.0]])}
    args = ("d", Channel("y"), Channel("u"))
    picture = figures.domains(*args, regions, np.array([[0.5, 0.5], [3, 3]]), np.array([0, np.nan]))
    assert "Grey: samples without a mode (1)." in picture.caption
    assert len(places(picture, "samples--1")) == 1
    with pytest.raises(InputError, match="no regions"):
        figures.domains(*args, {}, np.zeros((1, 2)), np.zeros(1))
    with pytest.raises(InputError, match="sample of mode 2"):
        figures.domains(*args, regions, np.zeros((1, 2)), np.array([2]))


def test_many_samples_of_a_domain_are_thinned_and_the_farthest_stay():
    points = np.random.default_rng(0).normal(size=(100_000, 2))
    box = {"d": np.array([[-5, -5], [5, -5], [5, 5], [-5, 5.0]])}
    picture = figures.domains("d", Channel("y"), Channel("u"), box, points, np.zeros(100_000))
    found = places(picture, "samples-0")
    (outline,) = paths(picture, "region-0")
    assert len(found) < 3000
    scale = np.ptp(outline[:, 0]) / 10
    np.testing.assert_allclose(np.ptp(found[:, 0]), scale * np.ptp(points[:, 0]), atol=0.01)


def test_modes_against_precision_mark_the_chosen_one():
    precision, modes, radius = np.array([0.9, 0.5, 0.7]), np.array([12, 1, 3]), np.array([0.2, 1.5, 0.9])
    picture = figures.modes_against_precision(precision, modes, radius, 0.7, "N")
    order = [1, 2, 0]
    assert_shows(paths(picture, "modes")[0][:, 1], modes[order].astype(float))
    assert_shows(paths(picture, "radius")[0][:, 1], radius[order])
    assert "chosen: 0.7 with 3 modes and a mean radius of 0.9 N." in picture.caption
    assert columns(picture)["mean radius [N]"] == [0.2, 1.5, 0.9]


def test_widths_have_their_place_by_record_and_model():
    rows = [
        Width("a", "r1", 1.0, 100.0),
        Width("b", "r1", 3.0, 90.0),
        Width("a", "r2", 2.0, 95.0),
        Width("b", "r2", np.inf, 100.0),
    ]
    picture = figures.widths("w", rows, "N")
    pieces = re.findall(r'id="width-(\d)".*?<use [^>]*x="([\d.]+)" y="([\d.]+)"', picture.figure_svg, re.S)
    assert [p[0] for p in pieces] == ["0", "1", "0"]
    (xa, ya), (xb, yb), (_, yc) = [(float(x), float(y)) for _, x, y in pieces]
    assert xa < xb
    assert_shows(np.array([ya, yb, yc]), np.array([100.0, 90.0, 95.0]))
    assert ya < yb
    assert "Without a finite radius: b on r2." in picture.caption
    assert columns(picture)["inside [%]"] == [100, 90, 95, 100]
    with pytest.raises(InputError, match="no envelopes"):
        figures.widths("w", [])


def test_responses_are_named_at_their_ends_unless_the_names_collide():
    apart = figures.responses("r", T, {"nominal": T, "payload": 2 * T}, "N")
    assert "legend_1" not in gids(apart)
    level = assert_shows(paths(apart, "curve-0")[0][:, 1], T)
    np.testing.assert_allclose(assert_shows(paths(apart, "curve-1")[0][:, 1], 2 * T), level, rtol=1e-3)
    close = figures.responses("r", T, {"nominal": T, "payload": 1.01 * T}, "N")
    assert "legend_1" in gids(close)
    for picture in (apart, close):
        assert [text for text in texts(picture) if text in ("nominal", "payload")] == ["nominal", "payload"]
    assert list(columns(apart)) == ["t [s]", "nominal [N]", "payload [N]"]
    with pytest.raises(InputError, match="no responses"):
        figures.responses("r", T, {})


def test_a_response_that_runs_away_is_named_and_leaves_the_others_their_scale():
    picture = figures.responses("r", T, {"a": np.sin(T), "b": np.cos(T), "away": np.exp(40 * T)})
    assert "Off the picture in part: away." in picture.caption
    assert np.ptp(paths(picture, "curve-0")[0][:, 1]) > 20
    assert max(np.abs(p).max() for p in paths(picture, "curve-2")) < 1e5


@pytest.mark.slow
def test_no_label_leaves_the_picture():
    long = "a name that goes on for longer than any picture is wide, and then some"
    modes = np.arange(400) // 100
    band = Band(Y - 1, Y + 1)
    channel = Channel(long, long)
    pictures = [
        figures.envelope("e", T, Trace(channel, Y), {long: band, "b": band}),
        figures.modes_along_time("m", T, Trace(channel, Y), modes, [long] * 4, [3]),
        figures.responses("r", T, {long: T, "b": 3 * T}, long),
    ]
    for picture in pictures:
        root = ElementTree.fromstring(picture.figure_svg)
        width, height = (float(v) for v in root.get("viewBox", "").split()[2:])
        for text in root.iter(f"{SVG}text"):
            place = re.findall(r"translate\(([-\d.]+) ([-\d.]+)\)", text.get("transform", "")) or [(text.get("x"), text.get("y"))]
            x, y = (float(v) for v in place[0])
            assert 0 <= x <= width
            assert 0 <= y <= height
        assert picture.alt
        assert picture.caption
        embed(picture.figure_svg, "p", picture.alt, "c")
