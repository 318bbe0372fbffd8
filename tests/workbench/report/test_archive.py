"""A report that is written and read again is the same page; several make one."""

import json

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.report import figures
from workbench.report.archive import joined, read_report
from workbench.report.blocks import Badge, Brief, Column, Data, Picture, Provenance, Report, Section, Standing, Table, Text
from workbench.report.page import html_text, write_report

ROWS = (
    ("a", 1.0, 3, "x", None, np.float64(2.5)),
    ("b", float("nan"), 4, "", np.inf, -np.inf),
    ("1.5", 1e-12, True, "<&>", 1e300, np.float64("nan")),
)


SVG = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 9 9"></svg>'


def made() -> Report:
    t = np.linspace(0.0, 1.0, 50)
    first = Picture("First", SVG, "seen first", Data("first", (Column("x", [1.0, 2.0]),)))
    drawn = figures.responses("Step response", t, {"one": np.sin(t), "two": np.where(t > 0.5, np.nan, t)}, "rad/s")
    odd = Picture(
        "Odd",
        drawn.figure_svg,
        "said",
        Data(
            "odd [x]",
            (
                Column("n, a", ["1", 'q"', ""], "m [2]"),
                Column("e", []),
            )[:1],
        ),
    )
    return Report(
        "Title <b>",
        "First.\n\nSecond.",
        (
            Section("One", (drawn, Table("Numbers", ("name", "u", "v", "w", "x", "y"), ROWS, "why", max, 3), Text("a\n\nb"))),
            Section("Two", (odd,), (Provenance({"seed": 1, "deep": {"list": [1, 2], "none": None}}, "From"),)),
        ),
        Brief("Which?", "Take <it>.", (Badge("Model", "85 %", "It follows.", Standing.GOOD),), first),
    )


def test_the_page_is_the_same_to_the_last_character(tmp_path):
    report = made()
    write_report(report, tmp_path)
    again = read_report(tmp_path)
    assert html_text(again) == html_text(report)
    write_report(again, tmp_path / "again")
    for path in (tmp_path / "data").iterdir():
        assert (tmp_path / "again" / "data" / path.name).read_bytes() == path.read_bytes()
    assert (tmp_path / "again" / "report.json").read_bytes() == (tmp_path / "report.json").read_bytes()


def test_several_pages_make_one(tmp_path):
    one, two = made(), Report("Other", "Said.", (Section("Own", (Text("x"),)),))
    whole = joined("Both", "In short.", {"first": one, "second": two})
    assert [s.title for s in whole.sections] == [
        "first: Title <b>", "first: One", "first: Two", "second: Other", "second: Own", "Provenance",
    ]  # fmt: skip
    assert whole.sections[-1].more[0].title == "first: From"
    assert whole.sections[0].blocks[-1].title == "First"
    page = html_text(whole)
    for text in ("In short.", "First.", "Said.", "Step response"):
        assert text in page


def test_what_is_no_report_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"no report\.json"):
        read_report(tmp_path)
    write_report(made(), tmp_path)
    path = tmp_path / "report.json"
    whole = path.read_text()
    for spoilt, said in (
        (whole[:100], "not JSON"),
        ("[]", "no report of this version"),
        (whole.replace("report/2", "report/9"), "no report of this version"),
        (whole.replace('"good"', '"grand"'), "damaged"),
        (whole.replace('"todo": "', '"todo": 3, "was": "'), "damaged"),
        (whole.replace('"caption"', '"caption_"'), "damaged"),
        (whole.replace('"blocks": [', '"blocks": [3, '), "damaged"),
        (whole.replace('"text":', '"tixt":'), "damaged"),
    ):
        path.write_text(spoilt)
        with pytest.raises(InputError, match=said):
            read_report(tmp_path)
    data = tmp_path / "data" / "02-step-response.csv"
    csv = data.read_text()
    for cut in (csv[: len(csv) // 2], csv[: csv.index("\n", 200) + 1], csv[:-2]):
        data.write_text(cut)
        path.write_text(whole)
        with pytest.raises(InputError, match="is not whole"):
            read_report(tmp_path)
    data.write_text(csv)
    path.write_text(whole.replace('"file": "02', '"file": "../../02'))  # a name stays in the report's own folder
    assert read_report(tmp_path).title == "Title <b>"


def test_the_file_of_a_former_version_is_read(tmp_path):
    write_report(made(), tmp_path)
    path = tmp_path / "report.json"
    content = json.loads(path.read_text())
    del content["brief"]
    for section in content["sections"]:
        del section["more"]
    path.write_text(json.dumps(content | {"schema": "workbench/report/1"}))
    again = read_report(tmp_path)
    assert again.brief is None
    assert [(s.title, len(s.blocks), s.more) for s in again.sections] == [("One", 3, ()), ("Two", 1, ())]
