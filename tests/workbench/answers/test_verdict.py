"""How an answer says its numbers."""

from types import SimpleNamespace

from workbench.answers.verdict import sizes
from workbench.diagnosis.answer import Estimate


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
        "time 0.012 s (95 %: 0.0119985 to 0.0120016), level 3 N (95 %: 2.4 to 3.6), exact 1.5 V (95 %: 1.5 to 1.5)"
    )
