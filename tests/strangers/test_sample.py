"""Six cases of the zoo, drawn by their seeds: no crash, no refusal, no confident wrong name. The study strangers counts all."""

import numpy as np
import pytest

from studies.hidden_scores import disordered, misled
from studies.strangers import configured, run_case, said
from tests.strangers.case import Kind, draw, machine_of
from tests.strangers.registry import MACHINES
from workbench.diagnosis.check.records import check
from workbench.diagnosis.predictor import predictor

FIRST = 5_000_000  # chosen once, before anything was run
QUICK = ("conical-tank", "heater", "propeller-arm", "ball-in-tube", "fan", "quadruple-tanks")


def chosen() -> list[int]:
    """The first seed from FIRST on of each machine whose records are short."""
    return [next(seed for seed in range(FIRST, FIRST + 100) if machine_of(seed) == name) for name in QUICK]


@pytest.fixture(scope="module")
def rows():
    return [run_case(seed, configured()) for seed in chosen()]


def listed(rows) -> str:
    return "\n" + "\n".join(map(said, rows))


@pytest.mark.slow
def test_every_case_comes_to_an_answer(rows):
    assert not (lost := [row for row in rows if "verdict" not in row]), listed(lost)


@pytest.mark.slow
def test_every_interval_holds_its_number(rows):
    assert not (strange := disordered(rows)), strange


@pytest.mark.slow
def test_no_wrong_name_is_given_with_confidence(rows):
    wrong = [row for row in rows if "verdict" in row and misled(row)]
    assert not wrong, listed(wrong)


UNSTABLE, SYMMETRIC = "cart-pendulum", "belt"


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(FIRST + 200, FIRST + 202))
@pytest.mark.parametrize(("machine", "kind"), [(UNSTABLE, Kind.SINGLE), (UNSTABLE, Kind.NOTHING), (SYMMETRIC, Kind.OUTSIDE)])
def test_sound_records_are_taken_and_followed(seed, machine, kind):
    """Of an unstable machine with a sensor less, and of one whose inputs could change places."""
    drawn = draw(seed, machine=machine, kind=kind)
    plant = MACHINES[machine].plant.sampled(drawn.records.dt)
    check(plant, drawn.records)
    made = predictor(plant, drawn.records)
    assert all(np.isfinite(e).all() for e in made.at(made.point))
