"""A reader finds what to do, and how model, cause and safety stand, on the first screen of a desk and of a phone."""

import numpy as np
import pytest

from tests.workbench.report.browser import CHROMIUM, asked
from workbench.report import figures
from workbench.report.blocks import Badge, Brief, Report, Section, Standing, Table, Text
from workbench.report.page import html_text, write_report

SENTENCES = (  # as long as real ones are
    "Free run of SSM where it follows least: theta of sine, a held-out record.",
    "imbalance@rewind: amplitude 0.0001234 N m (95 %: 0.0001184 to 0.0001284), angle 0.9824 rad (95 %: 0.97 to 0.99).",
    "scheduled PID: 5 PROVED, 1 UNDECIDED, 4 PASSED. Not decided: w3: within the band 5 s after every step 3 rad/s.",
)
RECTANGLES = "const r = s => [...document.querySelectorAll(s)].map(e => e.getBoundingClientRect());"


def report() -> Report:
    t = np.linspace(0.0, 9.0, 200)
    picture = figures.responses("Cause", t, {"without": np.sin(t), "with": np.cos(t)}, "deg")
    badges = tuple(
        Badge(about, word, said, standing)
        for about, word, said, standing in zip(
            ("Model", "Cause", "Safety"), ("FIT 85 % or more", "named", "UNDECIDED"), SENTENCES,
            (Standing.GOOD, Standing.GOOD, Standing.OPEN), strict=True,
        )
    )  # fmt: skip
    todo = (
        "Take the scheduled PID: its stability is proved, errors 6 % larger than LPV-MPC's.\n\nWhat turns at rewind is out of "
        "balance: its weight pulls once per turn. Mend that, or go on with the extended plant."
    )
    table = Table("Numbers", ("row", "x"), tuple((f"r{k}", float(k)) for k in range(80)))
    sections = (Section("Shown", (Text("seen"),), (table, picture)), Section("Folded", (), (table,)))
    brief = Brief("Which law, what does the simulation lack, and is the loop safe?", todo, badges, picture)
    return Report("Web winding machine: from records to verdicts", "In full.", sections, brief)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
@pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844)])
def test_the_answer_is_on_the_first_screen(tmp_path, width, height):
    path = write_report(report(), tmp_path)
    # a window is never as narrow as a phone: the body is, under the same rules
    narrow = f"Object.assign(document.body.style, {{width: '{width}px', margin: '0'}});" if width < 500 else ""
    found = asked(path, f"{narrow} {RECTANGLES} return {{badges: r('.badges li').map(b => [b.bottom, b.right, b.width])}};",
                  width=max(width, 500))  # fmt: skip
    assert not found["errors"]
    badges = found["found"]["badges"]
    assert len(badges) == 3
    assert all(bottom <= height and right <= width and wide > 150 for bottom, right, wide in badges)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_what_is_folded_opens_and_its_pictures_can_be_explored(tmp_path):
    path = write_report(report(), tmp_path)
    found = asked(
        path,
        """
        const all = [...document.querySelectorAll("section details")];
        const before = all.map(d => d.scrollHeight);
        for (const d of all) d.open = true;
        const explore = all[0].querySelector("figure .explore");
        explore.click();
        return {summaries: all.map(d => d.querySelector("summary").textContent), before,
          after: all.map(d => d.scrollHeight), canvas: !!all[0].querySelector("canvas")};
        """,
    )
    assert not found["errors"]
    assert found["found"]["summaries"] == ["More: 1 picture, 1 table", "More: 1 table"]
    assert all(after > 5 * before for before, after in zip(found["found"]["before"], found["found"]["after"], strict=True))
    assert found["found"]["canvas"]


def test_the_page_says_a_brief_before_the_verdict_in_full():
    text = html_text(report())
    first = text.index('<ul class="badges">')
    assert text.index("Take the scheduled PID") < first < text.index("In full.") < text.index("Shown</h2>")
    assert text.count("In full.") == 1
    assert '<li class="open"><span>Safety</span><strong>UNDECIDED</strong>' in text
