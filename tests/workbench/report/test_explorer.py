"""The page as it is used: pictures are panned, zoomed and read with keys, records and series switched, the schedule turned."""

import base64
import json
import re

import numpy as np
import pytest

from tests.workbench.report.browser import CHROMIUM, asked
from workbench.data import Channel
from workbench.report import figures
from workbench.report.blocks import Column, Data, Picture, Report, Section, Table
from workbench.report.explorer import kind_of, packed
from workbench.report.page import html_text, write_report

needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium; .ci/run installs it")
RHO = np.linspace(0.01, 0.03, 5)


def record(name: str, N: int = 500, seed: int = 0) -> Picture:
    t = 0.04 * np.arange(N)
    y = np.random.default_rng(seed).normal(size=N).cumsum()
    trace = figures.Trace(Channel("w3", "rad/s", "output"), y)
    return figures.measured_and_simulated(name, t, trace, {"SSM, order 3": y + 0.25, 'odd "name"': y - 1.0})


def pages(folder):
    omega = np.geomspace(0.1, 50.0, 30)
    family = figures.frozen_responses(
        omega, figures.Trace(Channel("r2", "m"), RHO), {"|S|": np.outer(RHO, omega)}, "Frozen", drawn=3
    )
    turn = np.exp(1j * np.linspace(0.0, 3.0, 40))
    plane = figures.nyquist("Nyquist", {"loop of u": {"a": turn, "b": 0.5 * turn}}, 1.6)
    bars = figures.tornado("Bars", "x", [figures.Bar("a", 1.0, 0.5, 1.5)], "said")
    blocks = (record("one"), record("two", 400, 1), family, plane, bars, Table("T", ("a", "b"), (("x", 1.0),)))
    return write_report(Report("Page", "Verdict.", (Section("S", blocks),)), folder)


@pytest.mark.slow
def test_what_can_be_explored_is_told_by_the_numbers(tmp_path):
    text = pages(tmp_path).read_text()
    assert re.findall(r'data-view="(\w+)"', text) == ["line", "line", "family", "plane"]

    def kind(**columns):
        return kind_of(Data("d", tuple(Column(n.replace("_", " "), v) for n, v in columns.items())))

    t = np.arange(10.0)
    assert kind(t=t, y=t) == "line"
    assert kind(t=[str(v) for v in t], y=["", *map(str, t[1:])]) == "line"  # as it is read from a file
    assert kind(t=t[:5], y=t[:5]) == ""  # too short to move about in
    assert kind(t=["a"] * 10, y=t) == ""
    assert kind(t=np.append(t[:9], 3.5), y=t) == ""
    assert kind(t=np.tile(t[:5], 2), rho=np.repeat([1.0, 2.0], 5), y=t) == "family"
    assert kind(t=np.tile(t[:5], 2), rho=t, y=t) == ""
    assert kind(t=np.where(t == 3.0, np.nan, t), y=t) == ""
    assert kind(L_real=t, L_imaginary=t) == "plane"


@pytest.mark.slow
@needs_browser
def test_keys_move_zoom_and_read_what_the_numbers_are(tmp_path):
    page = pages(tmp_path)
    csv = (tmp_path / "data" / "01-w3-one.csv").read_text().splitlines()
    got = asked(
        page,
        """
        const f = document.querySelectorAll("figure")[0], key = (k, shift) => f.querySelector("canvas").dispatchEvent(
          new KeyboardEvent("keydown", {key: k, shiftKey: !!shift, bubbles: true}));
        f.querySelector(".explore").click();
        const said = () => f.querySelector("output").textContent, found = {};
        key("ArrowRight"); found.middle = said();
        for (let i = 0; i < 8; i++) key("+");
        key("ArrowRight"); found.next = said();
        key("0"); for (let i = 0; i < 400; i++) key("ArrowLeft"); found.first = said();
        f.querySelectorAll(".series button")[1].click(); found.without = said();
        found.pressed = [...f.querySelectorAll(".series button")].map(b => b.getAttribute("aria-pressed"));
        const select = f.querySelector("select");
        found.records = [...select.options].map(o => o.textContent);
        select.value = "1"; select.onchange();
        for (let i = 0; i < 400; i++) key("ArrowRight"); found.other = said();
        found.focus = document.activeElement === f.querySelector("canvas");
        key("Escape");
        found.back = !!f.querySelector(".picture > svg") && !f.querySelector("canvas");
        found.opener = document.activeElement.className;
        return found;
        """,
    )
    assert got["errors"] == []
    found = got["found"]
    columns = [re.sub(r"^\"|\"$", "", c) for c in re.split(r",(?! order)", csv[0])]
    rows = np.genfromtxt([line for line in csv[1:]], delimiter=",")
    t = rows[:, 0]

    def read(text):
        return float(re.match(r"t ([-\d.e]+) s", text)[1]), [
            float(v) for v in re.findall(r" (-?[\d.]+(?:e[-+]\d+)?) rad/s", text)
        ]

    for text in (found["middle"], found["next"], found["first"]):
        time, values = read(text)
        i = int(np.argmin(np.abs(t - time)))
        errors = rows[i, 1] - rows[i, 2:]  # of each model, below the runs
        np.testing.assert_allclose(values, [*rows[i, 1:], *errors], rtol=1e-4, atol=1e-5)
    assert len(columns) == rows.shape[1]
    assert read(found["next"])[0] - read(found["middle"])[0] == pytest.approx(0.04, abs=1e-6)  # one sample where it is zoomed in
    assert read(found["first"])[0] == 0.0
    assert len(read(found["without"])[1]) == len(read(found["first"])[1]) - 1
    assert found["pressed"].count("false") == 1
    assert found["records"] == ["w3, record one", "w3, record two"]
    assert read(found["other"])[0] == pytest.approx(0.04 * 399)
    assert found["focus"]
    assert found["back"]
    assert found["opener"] == "explore"


@pytest.mark.slow
@needs_browser
def test_the_schedule_is_turned_and_the_plane_is_drawn(tmp_path):
    got = asked(
        pages(tmp_path),
        """
        const [f, p] = [...document.querySelectorAll("figure")].slice(2, 4), found = {};
        f.querySelector(".explore").click();
        const slide = f.querySelector("input[type=range]");
        found.steps = +slide.max + 1;
        const said = () => f.querySelector("output").textContent;
        for (const at of [0, 4]) {
          slide.value = at; slide.oninput();
          found["text" + at] = slide.getAttribute("aria-valuetext");
          f.querySelector("canvas").dispatchEvent(new KeyboardEvent("keydown", {key: "ArrowRight", bubbles: true}));
          found["said" + at] = said();
        }
        p.querySelector(".explore").click();
        const c = p.querySelector("canvas"), pixels = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
        let inked = 0; for (let i = 3; i < pixels.length; i += 4) if (pixels[i]) inked++;
        found.inked = inked;
        return found;
        """,
    )
    assert got["errors"] == []
    found = got["found"]
    assert found["steps"] == len(RHO)
    assert (found["text0"], found["text4"]) == ("0.01 m", "0.03 m")
    first, last = (float(re.search(r"\|S\| ([-\d.e]+) dB", found[f"said{i}"])[1]) for i in (0, 4))
    assert last / first == pytest.approx(3.0, rel=1e-3)
    assert found["inked"] > 1000


@pytest.mark.slow
@needs_browser
@pytest.mark.parametrize(("width", "dark"), [(1200, False), (400, False), (400, True)])
def test_the_page_fits_names_every_button_and_asks_nothing_of_the_network(tmp_path, width, dark):
    got = asked(
        pages(tmp_path),
        """
        for (const b of document.querySelectorAll(".explore")) b.click();
        const named = e => (e.getAttribute("aria-label") || e.textContent || "").trim() !== "";
        return {wide: document.documentElement.scrollWidth - window.innerWidth,
                unnamed: [...document.querySelectorAll("button, a, select, input")]
                  .filter(e => !named(e) && !e.closest("label")).length,
                pictures: [...document.querySelectorAll("svg[role=img]")].every(e => e.getAttribute("aria-label")),
                fetched: performance.getEntriesByType("resource").length,
                paper: getComputedStyle(document.body).backgroundColor};
        """,
        width=width,
        dark=dark,
    )
    assert got["errors"] == []
    found = got["found"]
    assert found["wide"] <= 0
    assert found["unnamed"] == 0
    assert found["pictures"]
    assert found["fetched"] == 0


@pytest.mark.slow
@needs_browser
def test_what_is_too_long_for_text_lies_in_the_page_all_the_same(tmp_path):
    """Packed in 16 bits: what is read is within a step of the numbers, holes stay holes, and the page is small."""
    N = 30_000
    one = record("long", N)
    values = np.asarray(one.data.columns[1].values)
    holed = np.where(np.arange(N) % 1000 == 7, np.nan, np.asarray(one.data.columns[2].values))
    long = Picture(one.title, one.figure_svg, one.caption, Data("d", (*one.data.columns[:2], Column("h", holed, "rad/s"))))
    page = write_report(Report("Page", "Verdict.", (Section("S", (long,)),)), tmp_path)
    assert page.stat().st_size < 6 * N + 200_000
    got = asked(
        page,
        """
        const f = document.querySelector("figure"); f.querySelector(".explore").click();
        const found = [], c = f.querySelector("canvas");
        const key = k => c.dispatchEvent(new KeyboardEvent("keydown", {key: k, bubbles: true}));
        key("ArrowRight");
        for (let i = 0; i < 14; i++) key("+");
        for (let i = 0; i < 20; i++) { found.push(f.querySelector("output").textContent); key("ArrowRight"); }
        return found;
        """,
    )
    assert got["errors"] == []
    step = np.ptp(values) / 65534
    for text in got["found"]:
        time = float(re.match(r"t ([\d.]+) s", text)[1])
        i = round(time / 0.04)
        assert time == pytest.approx(0.04 * i, rel=1e-4)
        (y,) = re.findall(r"w3 measured (-?[\d.]+) rad/s", text) or re.findall(r"(-?[\d.]+) rad/s", text)[:1]
        near = values[max(i - 3, 0) : i + 4]  # the time is said to five digits
        assert np.abs(near - float(y)).min() <= step + 1e-4 * abs(float(y))


@pytest.mark.slow
@needs_browser
def test_a_long_family_over_a_logarithmic_axis_keeps_its_members(tmp_path, monkeypatch):
    monkeypatch.setattr("workbench.report.page.INLINE", 1000)
    omega = np.geomspace(0.008, 78.0, 300)
    curves = {f"|S| {i}": np.outer(RHO, omega) + i for i in range(3)}
    picture = figures.frozen_responses(omega, figures.Trace(Channel("r2", "m"), RHO), curves, "Frozen", drawn=2)
    page = write_report(Report("Page", "v", (Section("S", (picture,)),)), tmp_path)
    got = asked(
        page,
        """
        const f = document.querySelector("figure"); f.querySelector(".explore").click();
        const slide = f.querySelector("input[type=range]"), key = k => f.querySelector("canvas").dispatchEvent(
          new KeyboardEvent("keydown", {key: k, bubbles: true}));
        slide.value = 4; slide.oninput();
        key("ArrowRight"); for (let i = 0; i < 400; i++) key("ArrowLeft");
        return [+slide.max + 1, slide.getAttribute("aria-valuetext"), f.querySelector("output").textContent];
        """,
    )
    assert got["errors"] == []
    members, label, said = got["found"]
    assert (members, label) == (len(RHO), "0.03 m")
    assert said.startswith("omega 0.008 rad/s")


def test_packed_numbers_are_those_of_the_data():
    t, y = 0.5 * np.arange(100.0), np.random.default_rng(0).normal(size=100)
    y[3] = np.nan
    text = packed(Data("d", (Column("t", t, "s"), Column("name", ["a"] * 100), Column("y", y, "m"), Column("c", np.ones(100)))))
    told = json.loads(re.search(r'data-columns="([^"]*)"', text)[1].replace("&quot;", '"'))
    assert [c["title"] for c in told] == ["t [s]", "y [m]", "c"]
    raw = np.frombuffer(base64.b64decode(re.search(r">([^<]*)</script>", text)[1]), "<i2").reshape(2, 100)
    assert told[0] == {"title": "t [s]", "even": True, "low": 0.0, "step": 0.5}
    back = np.where(raw[0] == -32768, np.nan, told[1]["low"] + told[1]["step"] * (raw[0].astype(float) + 32767))
    np.testing.assert_array_equal(np.isnan(back), np.isnan(y))
    np.testing.assert_allclose(back[~np.isnan(y)], y[~np.isnan(y)], atol=told[1]["step"] * 0.51)
    np.testing.assert_allclose(told[2]["low"] + told[2]["step"] * (raw[1].astype(float) + 32767), 1.0)


def test_nothing_in_the_numbers_ends_a_script():
    evil = Picture(
        "p", record("x").figure_svg, "c", Data("d", (Column("</script><b>", np.arange(9.0)), Column('"y', np.arange(9.0))))
    )
    text = html_text(Report("t", "v", (Section("s", (evil,)),)))
    assert "</script><b>" not in text
    assert text.count("<script") == text.count("</script>") == 1


@pytest.mark.slow
@needs_browser
def test_opened_pictures_keep_their_meaning(tmp_path):
    """The error panel of a run, the band of an envelope, bars of a mean, and -1 with its circle are there as in the picture."""
    t = np.linspace(0.0, 5.0, 60)
    speed = Channel("n", "1/min", "output")
    omega = np.exp(1j * np.linspace(0.0, 3.0, 40))
    run = figures.measured_and_simulated("one", t, figures.Trace(speed, np.sin(t)), {"LTI": 0.9 * np.sin(t), "SSM": np.sin(t)})
    envelope = figures.envelope(
        "two", t, figures.Trace(speed, np.sin(t)), {"one-step": figures.Band(np.sin(t) - 1, np.sin(t) + 1)}
    )
    missing = figures.missing("cause", speed, figures.Trace(Channel("torque", "N m"), t), t, np.full(60, 0.2), t)
    plane = figures.nyquist("Nyquist", {"loop of u": {"a": omega}}, 1.6)
    page = write_report(Report("Page", "Verdict.", (Section("S", (run, envelope, missing, plane)),)), tmp_path)
    got = asked(
        page,
        """
        const drawn = {texts: [], arcs: 0, fills: 0}, pen = CanvasRenderingContext2D.prototype;
        const spy = (name, note) => {
          const own = pen[name];
          pen[name] = function (...a) { note(a); return own.apply(this, a); };
        };
        spy("fillText", a => drawn.texts.push(a[0])); spy("arc", () => drawn.arcs++); spy("fill", () => drawn.fills++);
        return [...document.querySelectorAll("figure")].map(f => {
          Object.assign(drawn, {texts: [], arcs: 0, fills: 0});
          f.querySelector(".explore").click();
          const series = [...f.querySelectorAll(".series button")];
          return {names: series.map(b => b.textContent), colours: series.map(b => b.style.cssText),
                  texts: [...new Set(drawn.texts)], arcs: drawn.arcs, fills: drawn.fills};
        });
        """,
    )
    assert not got["errors"]
    run, envelope, missing, plane = got["found"]
    assert run["names"] == ["n measured", "n LTI", "n SSM", "error of LTI", "error of SSM"]
    assert "error [1/min]" in run["texts"]
    assert run["colours"][1:3] == run["colours"][3:5]  # a model has one colour in both panels
    assert envelope["fills"] == 1
    low, high = (envelope["colours"][envelope["names"].index(f"one-step {end}")] for end in ("low", "high"))
    assert low == high
    assert missing["arcs"] == missing["fills"] == 60
    assert "standard deviation" not in missing["names"]
    assert "sensitivity 1.6" in plane["names"]
