"""The study of compensations: its counts on rows written by hand, its axes, and a case of each kind from records to runs."""

import json

import numpy as np
import pytest

from studies import compensation
from studies.compensation import by_kind, gain, said, summary, verdict
from tests.axes import case as axes


def row(kind, before, after, *, named=(), done=(), fed=None):
    errors = {"designed": before, "fed": fed or before, "cancelled": after}
    causes = [{"key": key, "sure": True, "ties": list(ties)} for key, *ties in named]
    told = {"named": causes, "done": list(done), "said": [], "errors": errors, "floor": [1e-5, 1e-5], "seconds": 1.0}
    return {"seed": 1, "kind": kind, "size": 1.0} | told


ROWS = [
    row("friction", [8e-4, 8e-4], [1e-4, 5e-5], named=[("coulomb@slide",)], done=["feedforward", "coulomb@slide"]),
    row("friction", [8e-4, 8e-4], [8.3e-4, 2e-4], named=[("imbalance@slide", "stribeck@slide")]),
    row("delay", [4e-4, 4e-4], [1e-4, 1e-4], named=[("input-delay@F",)], done=["input-delay@F"], fed=[2e-4, 2e-4]),
    {"seed": 4, "kind": "play", "size": 1e-3, "refused": "x.csv: no\n  mend: y"},
]


def test_what_is_counted_of_rows():
    every = summary(ROWS)
    assert (every.cases, every.failed.hits, every.named.hits, every.cancelled.hits) == (4, 1, 3, 2)
    assert (every.worse.hits, every.worse.of) == (1, 6)
    gains = [gain(own) for own in ROWS[:3]]
    np.testing.assert_allclose(gains, [np.sqrt(8.0 * 16.0), np.sqrt(8.0 / 8.3 * 4.0), 4.0])
    assert every.gains[0] == pytest.approx(4.0)
    assert every.gains[2] == pytest.approx(min(gains))
    delay = by_kind(ROWS)["delay"]
    assert (delay.enough.hits, delay.enough.of) == (2, 2)
    assert delay.beside_feedforward[0] == pytest.approx(2.0)
    friction = by_kind(ROWS)["friction"]  # 8 in the middle is not reached: 6.6 is; nor 4 in nine of ten
    assert (friction.enough.hits, friction.enough.of) == (0, 2)
    assert "not answered: 1 of 4" in verdict(every)
    assert said(ROWS[3]) == "4 play of 0.001 -> refused: x.csv: no"
    assert said(ROWS[2]).endswith("as designed 400, fed forward 200, cancelled 100, nothing hidden 10 um; 4 times less")


@pytest.mark.parametrize("kind", axes.KINDS)
def test_an_axis_does_what_is_hidden_in_it(kind):
    """Against what is known without running it: where it rests, when it first moves, how far a reading is off."""
    sizes = {"friction": 20.0, "delay": 0.02, "play": 5e-4, "dead-zone": 20.0}
    machine = axes.Axis(95.0, 200.0, {kind: sizes[kind]})
    weak = machine.run(lambda k, r, y: 15.0, np.zeros(500), 0)[2]
    strong_F, read, strong = machine.run(lambda k, r, y: 60.0, np.zeros(3000), 0)
    rate = np.diff(strong)[-200:].mean() / axes.DT
    assert np.ptp(strong_F) == 0.0
    if kind in ("friction", "dead-zone"):
        assert np.abs(weak).max() < 5e-3  # creeps below the width of the law
        assert rate == pytest.approx((60.0 - 20.0) / 200.0, rel=0.02)
    else:
        assert rate == pytest.approx(60.0 / 200.0, rel=0.02)
    first = int(np.argmax(strong > 1e-7))
    assert first == (6 if kind == "delay" else 1)
    assert np.mean(strong[-500:] - read[-500:]) == pytest.approx(sizes["play"] if kind == "play" else 0.0, abs=1e-6)


@pytest.mark.slow
def test_each_kind_goes_from_records_to_a_run(tmp_path):
    said_lines = []
    compensation.main(folder=tmp_path, seed=7, cases=4, say=said_lines.append)
    rows = [json.loads(line) for line in (tmp_path / "cases.jsonl").read_text().splitlines()]
    assert {own["kind"] for own in rows} == set(axes.KINDS)
    for own in rows:
        assert set(own["done"]) & set(axes.EFFECTS[own["kind"]]), own["said"]
        assert gain(own) > 3.0
    assert "worse than as designed by more than 2 %: 0 of 12" in said_lines[0]
    assert (tmp_path / "report.html").exists()
