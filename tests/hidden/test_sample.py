"""Thirty hidden cases, drawn by their seeds: whoever changes the diagnosis sees at once what it no longer finds.

Bounds are where the diagnosis is, not where it should be; how often it is right is told by the study hidden-effects.
"""

from collections import Counter

import pytest

from studies.hidden_effects import limits_of, run_case, said
from studies.hidden_scores import Outcome, disordered, must_be_found, outcome, share, strangers
from tests.hidden.case import Kind, lot_of

pytestmark = pytest.mark.slow

FIRST = 42_000_000  # chosen once, before anything was run
SHARES = {"welding-robot": 14, "positioning-axis": 14}
WINDING = (Kind.NOTHING, Kind.SINGLE)  # one of each: such a case takes as long as twenty others
SURE = 4.0  # multiple of the limit


def chosen() -> list[int]:
    """The first seeds from FIRST on that belong to each share."""
    left, kinds, seeds, seed = Counter(SHARES), set(WINDING), [], FIRST
    while left.total() or kinds:
        lot = lot_of(seed)
        if left[lot.machine] > 0:
            left[lot.machine] -= 1
            seeds.append(seed)
        elif lot.machine == "web-winding" and lot.kind in kinds:
            kinds.remove(lot.kind)
            seeds.append(seed)
        seed += 1
    return seeds


@pytest.fixture(scope="session")
def rows():
    """Cases with limits of the current diagnosis; those of the winding machine from one record: too high, not too low."""
    limits = {machine: limits_of(machine) for machine in SHARES} | {"web-winding": limits_of("web-winding", records=1)}
    return [run_case(seed, limits, "sample") for seed in chosen()]


def listed(rows) -> str:
    return "\n" + "\n".join(map(said, rows))


def test_the_sample_holds_thirty_cases_of_every_machine_and_kind():
    lots = [lot_of(seed) for seed in chosen()]
    assert len(lots) == len(set(chosen())) == 30
    assert Counter(lot.machine for lot in lots) == {**SHARES, "web-winding": 2}
    assert {lot.kind for lot in lots} == set(Kind)


def test_every_case_comes_to_an_answer(rows):
    assert not (lost := [row for row in rows if "error" in row or "undrawn" in row]), listed(lost)


def test_every_interval_holds_its_number(rows):
    assert not (strange := disordered(rows)), strange


@pytest.mark.parametrize("machine", [*SHARES, "web-winding"])
def test_nothing_is_named_where_nothing_is_hidden(machine, rows):
    nothing = [row for row in rows if (row["machine"], row["kind"]) == (machine, "nothing")]
    assert not (alarms := [row for row in nothing if strangers(row)]), listed(alarms)


def test_a_wrong_name_is_hardly_ever_given_with_confidence(rows):
    """One in thirty is the most that a method with the target of 1 % may come to (probability of two: 4 %)."""
    catalogued = [row for row in rows if row["kind"] in ("single", "pair")]
    wrong = [row for row in catalogued if row["verdict"] == "named" and strangers(row)]
    assert len(wrong) <= 1, listed(wrong)


def test_what_is_four_times_its_limit_is_named_or_held_by_a_tie(rows):
    sure = [row for row in rows if row["kind"] == "single" and must_be_found(row) and row["truth"][0]["multiple"] >= SURE]
    right = {row["seed"]: outcome(row) in (Outcome.RIGHT, Outcome.TIE) for row in sure}
    assert len(sure) >= 5
    assert share(right.values()).rate >= 0.8, listed(row for row in sure if not right[row["seed"]])


def test_most_effects_of_any_machine_that_must_be_found_are_noticed(rows):
    """That something is missing is less than its name: robot and axis see more than half of what is twice its limit."""
    seen = {machine: [] for machine in SHARES}
    for row in rows:
        if row["machine"] in seen and row["kind"] in ("single", "pair") and must_be_found(row):
            seen[row["machine"]].append(row["verdict"] != "nothing")
    assert all(share(hits).rate > 0.5 for hits in seen.values()), seen
