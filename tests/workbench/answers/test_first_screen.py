"""The first screen of an answer says nothing that the answer itself takes back."""

from types import SimpleNamespace

import pytest

from workbench.answers.diagnose import _most_gained
from workbench.answers.verdict import advice
from workbench.diagnosis.answer import Finding
from workbench.diagnosis.stages import StageError

CAUSE = SimpleNamespace(sentence="the shaft rubs", doubt="", ties={}, key="coulomb@shaft")


@pytest.mark.parametrize("finding", list(Finding))
def test_nobody_is_told_to_go_on_with_a_plant_that_is_not_handed_out(finding):
    causes = (CAUSE,) if finding in (Finding.NAMED, Finding.INCOMPLETE) else ()
    found = SimpleNamespace(finding=finding, causes=causes)
    refused = advice(found, False)
    assert "go on with" not in refused.lower()
    assert refused.startswith("Keep the plant as it was")
    assert ("The shaft rubs." in refused) == bool(causes)
    assert ("go on with the extended plant" in advice(found, True)) == bool(causes)


def test_a_run_that_did_not_last_is_no_gain():
    nan = float("nan")
    errors = [
        StageError("a", "w", "rad/s", data_sheet, data_sheet, extended)
        for data_sheet, extended in ((1.0, nan), (2.0, 1.0), (nan, 0.1), (4.0, 0.4), (0.0, 0.0))
    ]
    assert [e.data_sheet for e in _most_gained(errors)] == [4.0, 2.0]
