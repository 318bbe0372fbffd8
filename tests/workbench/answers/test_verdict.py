"""How an answer says its numbers."""

from types import SimpleNamespace

import numpy as np
import pytest

from workbench.answers.check import _todo, verdict_table
from workbench.answers.verdict import sizes
from workbench.diagnosis.answer import Estimate
from workbench.robustness.verdict import Status, Verdict, overall
from workbench.verification import model, plant
from workbench.verification.part import Part
from workbench.verification.trial import Trial


def test_an_interval_is_told_in_the_digits_that_it_takes():
    """A delay that is known to a microsecond is not from 0.012 to 0.012 s."""
    cause = SimpleNamespace(
        parameters={
            "time": Estimate(0.012, 0.0119985, 0.0120016, "s"),
            "level": Estimate(3.0, 2.4, 3.6, "N"),
            "exact": Estimate(1.5, 1.5, 1.5, "V"),
        }
    )
    assert sizes(cause) == (
        "time 0.012 s (95 %: 0.0119985 to 0.0120016), level 3 N (95 %: 2.4 to 3.6), exact 1.5 V (held, not estimated)"
    )


@pytest.mark.parametrize(
    ("verdicts", "said"),
    [
        (
            "model PROVED, plant PASSED",
            "is proved on the identified model, while no command is at its limit; on the simulated plant",
        ),
        ("model PROVED, model PROVED, plant PASSED, plant PASSED", "is proved on the identified model"),
        ("plant PASSED", "it was tried, not proved"),
        ("model PASSED, model PROVED, plant PASSED", "it was tried, not proved"),  # |S| is looked at on a grid
        ("model PROVED", "is proved, while no command is at its limit."),
        ("model UNDECIDED, plant PASSED", "not all is decided"),
    ],
)
def test_the_first_line_of_a_check_says_what_is_proved_and_where(verdicts, said):
    own = [Verdict("c", f"{of} m", Status[status], 0.0, "", "s") for of, status in map(str.split, verdicts.split(", "))]
    titles = {"model m": model.TITLE, "plant m": plant.TITLE}
    parts = [Part(title, tuple(v for v in own if v.of == of)) for of, title in titles.items()]
    assert said in _todo("law", overall(own), parts, Trial("m", "", "kept", np.zeros(1), np.zeros(1)))
    assert verdict_table(own).header[-1] == "what it rests on"
    assert verdict_table([own[0].shown_by("x.json")]).header[-1] == "file"
