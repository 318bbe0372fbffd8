"""The page: well-formed, self-contained, escaped; its numbers are the numbers in memory; all of it or nothing."""

import csv
import dataclasses
import io
import math
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from workbench.errors import InputError
from workbench.records import RecordError
from workbench.report import (
    Badge,
    Brief,
    Column,
    Data,
    Picture,
    Provenance,
    Report,
    Section,
    Standing,
    Table,
    Text,
    page,
    write_report,
)
from workbench.report.page import csv_text, html_text

VOID = {"meta", "link", "br", "img", "hr", "input"}
NASTY = "<b>x</b>&\"'<script>alert(1)</script>"
SVG = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 9 9"><g id="axes_1"><path d="M 0 0"/></g></svg>'


class Page(HTMLParser):
    """Every element with its attributes and text; refuses tags that do not close in order."""

    def __init__(self, text: str):
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.texts: dict[str, list[str]] = {}
        self.open: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        assert len(dict(attrs)) == len(attrs), f"an attribute of {tag} appears twice"
        self.elements.append((tag, {key: value or "" for key, value in attrs}))
        self.texts.setdefault(tag, [])
        if tag not in VOID:
            self.open.append(tag)
            self.texts[tag].append("")

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, {key: value or "" for key, value in attrs}))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        for tag in set(self.open):
            self.texts[tag][-1] += data

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.elements if name == tag]


def picture(name: str = "speed", values=(1.5, -2.25)) -> Picture:
    return Picture(name, SVG, f"Caption of {name}", Data(name, (Column("t", np.arange(len(values)), "s"), Column(name, values))))


def full_report(name: str = "speed") -> Report:
    table = Table(
        f"Scores of {name}", ("record", f"{name} [%]", "B [%]"), ((name, 91.25, 80.5), ("b", None, 7.0)), name, best=max
    )
    blocks = (picture(name), picture(name), table, Text(f"{name}\n\nsecond"), Provenance({name: {"seed": 3, name: [name]}}))
    brief = Brief(f"Asked {name}", f"{name}\n\nmore", (Badge(name, f"word {name}", f"So {name}.", Standing.OPEN),), picture(name))
    folded = (Text(f"folded {name}"), picture(name), table)
    sections = (Section(f"Models {name}", blocks, folded), Section("Empty", ()))
    return Report(f"Title {name}", f"Verdict {name}", sections, brief)


@pytest.mark.parametrize("name", ["speed", NASTY, "", "zero\x00byte", "\ud800 lone", "漢字 µ", "x" * 3000])
def test_the_page_is_well_formed_with_unique_ids_and_links_that_lead_somewhere(name):
    text = html_text(full_report(name))
    text.encode("utf-8")
    found = Page(text)
    ids = [attributes["id"] for _, attributes in found.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    references = [a["href"][1:] for a in found.all("a") if a["href"].startswith("#")]
    references += [a[key] for _, a in found.elements for key in ("aria-labelledby", "aria-describedby") if key in a]
    assert references
    assert set(references) <= set(ids)
    assert len(found.all("h1")) == 1
    assert all(svg.get("aria-label") is not None for svg in found.all("svg"))
    assert all(th.get("scope") in {"col", "row"} for th in found.all("th"))


def test_names_from_files_appear_as_text_and_never_as_markup():
    found = Page(html_text(full_report(NASTY)))
    assert found.all("b") == []
    assert len(found.all("script")) == 1
    assert f"Title {NASTY}" in found.texts["h1"]
    assert NASTY in found.texts["th"]
    assert any(NASTY in text for text in found.texts["nav"])
    assert f"Verdict {NASTY}" in found.texts["p"]


def test_nothing_is_loaded_from_anywhere():
    text = html_text(full_report())
    assert not re.search(r"(?i)https?://|@import|url\(", text)
    found = Page(text)
    for _, attributes in found.elements:
        assert "src" not in attributes
        assert attributes.get("href", "#").startswith(("#", "data:text/csv"))
    (policy,) = [a["content"] for a in found.all("meta") if a.get("http-equiv") == "Content-Security-Policy"]
    assert "default-src 'none'" in policy


def test_the_verdict_is_the_first_thing_on_the_page_after_its_title_with_its_paragraphs():
    report = Report("Title", "It is so.\n\nBecause of that.")
    found = Page(html_text(report))
    tags = [tag for tag, _ in found.elements]
    first = next(i for i, tag in enumerate(tags) if tag == "h1")
    assert tags[first + 1 : first + 4] == ["div", "p", "p"]
    assert found.elements[first + 1][1] == {"class": "verdict"}
    assert "<p>It is so.</p>\n<p>Because of that.</p>" in html_text(report)


@given(
    st.lists(st.floats() | st.integers(-(2**63), 2**63), min_size=1, max_size=20),
    st.lists(st.text(st.characters(exclude_categories=["Cs", "Cc"])), min_size=1, max_size=20),
)
def test_csv_gives_back_every_number_and_every_text(numbers, texts):
    N = min(len(numbers), len(texts))
    data = Data("d", (Column('x, "y"', numbers[:N], "rad/s"), Column("name", texts[:N])))
    header, *rows = list(csv.reader(io.StringIO(csv_text(data), newline="")))
    assert header == ['x, "y" [rad/s]', "name"]
    assert [row[1] for row in rows] == texts[:N]
    for row, number in zip(rows, numbers, strict=False):
        if isinstance(number, float) and math.isnan(number):
            assert row[0] == ""
        else:
            assert type(number)(row[0]) == number


def test_numbers_of_numpy_are_written_like_plain_ones():
    columns = (
        Column("a", np.array([0.1, 1e-300])),
        Column("b", [np.float64(0.1), np.int64(3)]),
        Column("c", np.array([1, 2])),
    )
    assert csv_text(Data("d", columns)) == "a,b,c\n0.1,0.1,1\n1e-300,3,2\n"


def test_the_link_in_the_page_and_the_file_beside_it_hold_the_same_numbers(tmp_path):
    values = np.random.default_rng(0).normal(size=50)
    report = Report("r", "v", (Section("s", (picture("w3, measured", values),)),))
    path = write_report(report, tmp_path / "new" / "run")
    assert path == tmp_path / "new" / "run" / "report.html"
    (file,) = (path.parent / "data").iterdir()
    (link,) = [a for a in Page(path.read_text("utf-8")).all("a") if "download" in a]
    assert link["download"] == file.name
    assert unquote(link["href"].partition(",")[2]) == file.read_text("utf-8")
    np.testing.assert_array_equal(np.genfromtxt(file, delimiter=",", skip_header=1)[:, 1], values)


def test_long_data_stay_beside_the_page(tmp_path, monkeypatch):
    monkeypatch.setattr(page, "INLINE", 100)
    path = write_report(Report("r", "v", (Section("s", (picture("w3", np.zeros(100)),)),)), tmp_path)
    (link,) = [a for a in Page(path.read_text("utf-8")).all("a") if "download" in a]
    assert (tmp_path / link["href"]).is_file()


def test_file_names_stay_in_the_folder_and_apart(tmp_path):
    names = ["../../etc/passwd", "a/b", "a b", "A:B*?", "漢字", "..", "CON"]
    write_report(Report("r", "v", (Section("s", tuple(picture(name) for name in names)),)), tmp_path)
    files = sorted(path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file())
    assert len(files) == len(names) + 2
    assert all(re.fullmatch(r"report\.html|report\.json|data/\d\d-[a-z0-9-]+\.csv", file) for file in files)


def test_a_report_that_cannot_be_drawn_leaves_nothing_behind(tmp_path):
    broken = dataclasses.replace(picture(), figure_svg="<svg")
    with pytest.raises(SyntaxError):
        write_report(Report("r", "v", (Section("s", (picture(), broken)),)), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_disk_that_fails_half_way_keeps_the_former_report_and_no_new_file(tmp_path, monkeypatch):
    former = write_report(Report("former", "v", (Section("s", (picture("a"),)),)), tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}

    def fail_on_page(path: Path, text: str) -> Path:
        if Path(path).name == "report.html":
            raise InputError("cannot write: No space left on device", file=path)
        return write_text(path, text)

    write_text = page.write_text
    monkeypatch.setattr(page, "write_text", fail_on_page)
    with pytest.raises(InputError):
        write_report(Report("new", "v", (Section("s", (picture("a"), picture("b"))),)), tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    assert "former" in former.read_text("utf-8")


def cells(table: Table) -> list[list[str]]:
    found = Page(html_text(Report("r", "v", (Section("s", (table,)),))))
    flat = found.texts["td"]
    width = len(table.header) - 1
    return [flat[i : i + width] for i in range(0, len(flat), width)]


def test_numbers_of_a_column_share_their_decimals_even_when_one_ran_away():
    rows = (("a", 79.744, 3), ("b", -349720.5, 12), ("c", 88.3249, 7), ("d", 92.0, 1))
    assert cells(Table("t", ("record", "FIT [%]", "order"), rows)) == [
        ["79.74", "3"], ["−349720.50", "12"], ["88.32", "7"], ["92.00", "1"],
    ]  # fmt: skip


def test_a_column_over_many_decades_loses_no_small_number():
    shown = cells(Table("t", ("p", "value"), (("J", 1.234e-5), ("K", 0.045), ("m", -12.5), ("B", 0.0))))
    assert [row[0] for row in shown] == ["1.234 × 10⁻⁵", "0.04500", "−12.50", "0"]


def test_what_is_no_number_is_a_dash_and_infinity_is_said():
    shown = cells(Table("t", ("p", "value"), (("a", None), ("b", math.nan), ("c", -math.inf), ("d", 1.0), ("e", "text"))))
    assert [row[0] for row in shown] == ["—", "—", "−∞", "1.000", "text"]


@pytest.mark.parametrize(("best", "expected"), [(max, ["9.000", "7.000", "7.000"]), (min, ["5.000", "7.000", "7.000"])])
def test_the_best_of_a_row_is_bold_with_its_equals_and_without_its_gaps(best, expected):
    rows = (("a", 5.0, 9.0), ("b", math.nan, 3.0), ("c", 7.0, 7.0), ("9", "x", "y"))
    found = Page(html_text(Report("r", "v", (Section("s", (Table("t", ("r", "A", "B"), rows, best=best),)),))))
    assert found.texts["strong"] == expected


def test_shapes_that_do_not_fit_are_refused_where_they_are_made():
    with pytest.raises(RecordError, match="2 cells"):
        Table("t", ("a", "b", "c"), (("x", 1.0),))
    with pytest.raises(RecordError, match="different lengths"):
        Data("d", (Column("a", [1, 2]), Column("b", [1])))


def test_provenance_names_every_leaf_by_its_path():
    found = Page(html_text(Report("r", "v", (Section("s", (Provenance({"a": {"b": 1, "c": {"d": "e"}}, "f": (1, 2)}),)),))))
    names = found.texts["th"][2:]
    assert dict(zip(names, found.texts["td"], strict=True)) == {"a › b": "1", "a › c › d": "e", "f": "1, 2"}


def test_a_page_needs_no_matplotlib():
    import subprocess
    import sys

    code = "import sys, workbench.report; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
