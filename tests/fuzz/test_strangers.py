"""No command ends in anything but an answer or a refusal in words, whatever finite plants, records and options it is given.

The quick sample draws what needs no compiler; the slow lane goes through all commands.
"""

import tempfile
from pathlib import Path

import pytest

from tests.fuzz.strangers import PLANTS, faults

pytestmark = pytest.mark.slow

QUICK = ("identify", "compare", "effects")


@pytest.mark.parametrize("seed", range(12))
def test_models_of_strange_records_are_answers_or_refusals(seed, tmp_path):
    assert faults(seed, tmp_path, QUICK) == []


def test_a_reactor_whose_runs_are_lost_without_unlogged_torques_is_an_answer_or_a_refusal(tmp_path):
    """The second search began at a model without slopes, and the eigenvalues of its information did not converge."""
    assert faults(1000, tmp_path, ("diagnose",), kind="reactor") == []


@pytest.mark.parametrize("kind", PLANTS)
def test_every_command_answers_or_refuses(kind):
    for seed in range(3):
        with tempfile.TemporaryDirectory() as folder:
            assert faults(1000 + seed, Path(folder), kind=kind) == []
