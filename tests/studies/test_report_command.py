"""`workbench report`: a page from its files, and one page of several runs."""

import pytest

from studies.cli import main
from workbench.report.archive import read_report
from workbench.report.blocks import Report, Section, Table, Text
from workbench.report.page import write_report


@pytest.fixture
def runs(tmp_path):
    for name in ("one", "two"):
        table = Table(f"Numbers of {name}", ("a", "b"), (("x", 1.5),))
        write_report(
            Report(f"Run {name}", f"{name} is fine.\n\nMore of {name}.", (Section("S", (Text("t"), table)),)), tmp_path / name
        )
    return tmp_path


def test_a_lost_page_is_drawn_again(runs, capsys):
    page = runs / "one" / "report.html"
    before = page.read_text()
    page.unlink()
    assert main(["report", str(runs / "one")]) == 0
    assert page.read_text() == before
    assert f"report: {page}" in capsys.readouterr().out


def test_several_runs_make_one_page(runs):
    folders = [str(runs / "one"), str(runs / "two")]
    assert main(["report", *folders, "--out", str(runs / "both"), "--title", "Line 3", "--json", str(runs / "j.json")]) == 0
    page = read_report(runs / "both")
    assert page.title == "Line 3"
    assert page.verdict == "one: one is fine.\n\ntwo: two is fine."
    assert [s.title for s in page.sections] == ["one: Run one", "one: S", "two: Run two", "two: S"]
    assert (runs / "both" / "data" / "02-numbers-of-two.csv").read_text() == "a,b\nx,1.5\n"


def test_wrong_folders_are_refused(runs, capsys):
    assert main(["report", str(runs)]) == 2
    assert "holds no report.json" in capsys.readouterr().err
    assert main(["report", str(runs / "one"), str(runs / "one")]) == 2
    assert "named twice" in capsys.readouterr().err
    before = (runs / "one" / "report.json").read_bytes()
    assert main(["report", str(runs / "one"), str(runs / "two"), "--out", str(runs / "one")]) == 2
    assert "it would replace" in capsys.readouterr().err
    assert (runs / "one" / "report.json").read_bytes() == before
