"""Designs that are made calmer until every limit is decided."""

import json
from dataclasses import replace

import numpy as np
import pytest

import workbench as wb
from controllers import MPCDesign, ScheduledPIDDesign, decided
from controllers.decided import Attempt, Decided
from studies.cli import main
from workbench.data import Dataset, Experiment
from workbench.errors import InputError
from workbench.identification.lti import LTI
from workbench.readers import write_csv
from workbench.robustness.verdict import Status, Verdict

LOW, HIGH = {"u": -4.0}, {"u": 4.0}


@pytest.fixture(scope="module")
def records():
    """y+ = 0.9 y + 0.1 u, three samples late, twice, with errors."""
    found = []
    for seed in (1, 2):
        random = np.random.default_rng(seed)
        u, y = np.repeat(random.normal(size=80), 5), np.zeros(400)
        for k in range(3, 399):
            y[k + 1] = 0.9 * y[k] + 0.1 * u[k - 3]
        y = y + 0.01 * random.normal(size=400)
        found.append(Experiment.from_arrays(f"r{seed}", 0.1, inputs={"u": u}, outputs={"y": y}))
    return Dataset(tuple(found))


@pytest.fixture(scope="module")
def model(records):
    return LTI(order=4, feedthrough=False).fit(records)


def margin(design, model, records, asked=1e-3) -> float:
    """How many times as wide the boxes may be."""
    answer = wb.check(design.on(model), {"loop": {"stable": True, "margin": asked}}, model=model, records=records)
    return min(v.margin for v in answer.verdicts) + max(asked, 1.0)


@pytest.mark.slow
def test_a_calmer_law_is_taken_where_a_brisk_one_is_not_proved(model, records):
    """The margin that is asked for lies between those of |S| within 1.6 and within 1.26."""
    design = ScheduledPIDDesign(low=LOW, high=HIGH, effort=20.0)
    brisk, calm = (margin(replace(design, sensitivity=own), model, records) for own in (1.6, 1.256))
    assert calm > 1.05 * brisk
    asked = 0.5 * (brisk + calm)
    found = decided(design, model, {"loop": {"stable": True, "margin": asked}}, records)
    assert found.attempts[0].open
    assert not found.taken.open
    assert 1.2 < found.taken.sensitivity < 1.6
    assert found.taken is found.attempts[-1]
    assert "nothing is left open" in found.sentences[-1]
    assert len(found.sentences) == len(found.attempts) + 1
    for own in (design, MPCDesign(low=LOW, high=HIGH)):
        alone = decided(own, model, {"loop": {"stable": True}}, records)
        assert [attempt.sensitivity for attempt in alone.attempts] == [1.6]


@pytest.mark.slow
def test_what_no_law_keeps_ends_soon_and_says_so(model, records):
    found = decided(ScheduledPIDDesign(low=LOW, high=HIGH), model, {"loop": {"stable": True, "margin": 1e4}}, records)
    assert len(found.attempts) <= 8
    assert found.taken.open
    assert "none decides all" in found.sentences[-1]


def attempt(sensitivity, **statuses) -> Attempt:
    return Attempt(sensitivity, None, tuple(Verdict(k, "m", Status[v], -1.0, "V", "s") for k, v in statuses.items()))


def test_limits_in_conflict_are_named():
    first, last = attempt(1.6, theta="UNDECIDED", w3="PROVED"), attempt(1.2, theta="PROVED", w3="FAILED")
    said = Decided((first, last), first).sentences
    assert said[0] == "|S| within 1.6: 1 PROVED, 1 UNDECIDED (theta: UNDECIDED (-1 V))"
    assert said[-1] == "in conflict: theta asks for a calmer law, w3 for a brisker one"
    refused = Attempt(1.1, None, (), "no law keeps it")
    assert "no law, no law keeps it" in Decided((first, refused), first).sentences[1]


@pytest.mark.slow
def test_the_command_designs_until_the_limits_are_decided(model, records, tmp_path, capsys):
    model.save(tmp_path / "m.json")
    for e in records:
        write_csv(e, tmp_path / f"{e.name}.csv")
    (tmp_path / "limits.toml").write_text("[loop]\nstable = true\n")
    words = ["design", "pid", "--model", str(tmp_path / "m.json"), "--low", "u=-4", "--high", "u=4"]
    own = [*words, "--until", str(tmp_path / "limits.toml"), "--records", *(str(tmp_path / f"{e.name}.csv") for e in records)]
    assert main([*own, "--out", str(tmp_path / "pid")]) == 0
    assert "taken: |S| within 1.6, with which nothing is left open" in capsys.readouterr().out
    assert json.loads((tmp_path / "pid" / "design.json").read_text())["until"]["taken"] == 1.6
    assert main([*words, "--until", str(tmp_path / "limits.toml")]) == 2
    assert "--until without records" in capsys.readouterr().err
    assert main([*words, "--records", str(tmp_path / "r1.csv")]) == 2
    assert "--records is for --tube and --until" in capsys.readouterr().err


def test_a_price_of_moves_leaves_nothing_to_lower(model, records):
    with pytest.raises(InputError, match="a price of moves is given"):
        decided(MPCDesign(move=0.1), model, {"loop": {"stable": True}}, records)
