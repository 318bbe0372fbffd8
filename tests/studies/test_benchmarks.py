"""The study of published benchmarks: its measures and rules on records made here, and on the measured ones where they are."""

import json
from pathlib import Path

import numpy as np
import pytest

from studies import benchmarks
from studies.benchmarks import BENCHMARKS, NAMED, REPLAYED, Rule, best_of, noise_variance, records_of, verdict
from studies.cli import main
from workbench.report.page import html_text

DATA = Path(__file__).parents[3] / "shared" / "data"
HERE = pytest.mark.skipif(not DATA.is_dir(), reason="the shared records are not here")


def row(name: str, method: str, **results: float) -> dict:
    return {"set": name, "method": method, "results": {test: [value] for test, value in results.items()}}


def test_noise_is_told_from_a_slow_signal():
    random = np.random.default_rng(3)
    t = 0.01 * np.arange(20_000)
    y = 5.0 * np.sin(3.0 * t) + 0.2 * random.normal(size=len(t))
    assert noise_variance(y, 0.01) == pytest.approx(0.04, rel=0.05)


def test_noise_costs_nothing_in_the_corrected_measure():
    """A run that is the truth scores 100, one that misses a tenth of it 90, whatever noise is measured."""
    random = np.random.default_rng(4)
    t = 0.01 * np.arange(20_000)
    truth = np.sin(3.0 * t)
    y = truth + 0.1 * random.normal(size=len(t))
    gyroscope = BENCHMARKS["gyroscope, 2 schedules"]
    assert benchmarks._measured(gyroscope, y, truth, 0.01) == pytest.approx(100.0, abs=2.0)
    assert benchmarks._measured(gyroscope, y, 0.9 * truth, 0.01) == pytest.approx(90.0, abs=0.5)
    assert benchmarks._measured(gyroscope, y, np.full(len(t), np.nan), 0.01) is None


def test_the_verdict_sorts_by_what_is_published():
    rows = [
        row("cascaded tanks", "lti", val=0.7), row("cascaded tanks", "lpv-oe", val=0.15),
        row("silverbox", "lti", multisine_test=6.0, arrow=20.0),
        row("gyroscope, 2 schedules", "lpv-oe", old_ML_valid=97.0),
        row("EMPS", REPLAYED, DATA_EMPS_PULSES=0.09),
    ]  # fmt: skip
    first, between, last = verdict(rows).split(". ")
    assert "cascaded tanks, val (0.15 V by lpv-oe, published 0.191)" in first
    assert "multisine_test" in between
    assert "gyroscope" in between  # below the best, above linear
    assert "silverbox, arrow (20" in last
    assert "EMPS" not in verdict(rows)  # a record played again is no model


def test_a_lost_run_and_a_refused_model_are_no_result():
    tanks, test = BENCHMARKS["cascaded tanks"], Rule("val", 4)
    lost = {"set": tanks.name, "method": "lti", "results": {"val": [None]}}
    refused = {"set": tanks.name, "method": "oe", "refused": "too short"}
    assert best_of([lost, refused], tanks, test) is None
    assert best_of([lost, refused, row(tanks.name, "ssm", val=0.5)], tanks, test) == (0.5, "ssm")


def test_records_must_be_named_and_be_there(tmp_path, capsys):
    assert main(["study", "benchmarks", "--out", str(tmp_path / "o")]) == 2
    assert "--data FOLDER" in capsys.readouterr().err
    assert main(["study", "benchmarks", "--data", str(tmp_path), "--out", str(tmp_path / "o")]) == 2
    assert "no such file" in capsys.readouterr().err


@HERE
@pytest.mark.parametrize("name", BENCHMARKS)
def test_every_set_has_its_records_and_their_tests(name):
    b = BENCHMARKS[name]
    estimation, held_out = records_of(b, DATA)
    assert {test.record for test in b.tests} <= set(held_out.names)
    assert not set(estimation.fingerprints) & set(held_out.fingerprints)
    first = estimation.experiments[0]
    assert (first.names_of("input"), first.names_of("output")) == (b.inputs, b.outputs)
    if b.plant:  # an input that the record does not hold would be 0 in its runs
        assert {*b.plant.input_names, *b.plant.output_names} <= {*held_out.experiments[0].names}


@pytest.mark.slow
@HERE
def test_nothing_but_the_first_samples_of_a_test_is_read():
    """By the rules of the benchmarks: outputs after them, replaced by noise, change no run."""
    for name, methods in (("coupled drives", ("hammerstein", "lti")), ("cascaded tanks", ("lpv-oe", NAMED))):
        b = BENCHMARKS[name]
        estimation, held_out = records_of(b, DATA)
        for method in methods:
            run, _ = benchmarks._runner(b, method, estimation)
            for test, e in zip(b.tests, held_out, strict=True):
                values = e.values.copy()
                place = e.names.index(b.outputs[0])
                values[test.begin :, place] = np.random.default_rng(1).permutation(values[test.begin :, place])
                changed = benchmarks.replace(e, values=values)
                np.testing.assert_array_equal(run(changed, test.begin), run(e, test.begin))


@pytest.mark.slow
@HERE
def test_the_study_on_three_sets(tmp_path):
    assert main(["study", "benchmarks", "--quick", "--data", str(DATA), "--out", str(tmp_path), "--quiet"]) == 0
    content = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    found = {own["model"]: own["results"] for own in content["models"] if "results" in own}
    assert found["cascaded tanks: lpv-oe"]["val"][0] < 0.5  # published: linear 0.59
    assert found["coupled drives: hammerstein"]["run2_test"][0] > 50.0  # every linear model is below 0
    assert min(found["winding, DaISy: lti"]["run 2"]) > 60.0
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "published 0.191" in page
    assert "free_runs" not in page
    again = (tmp_path / "models.jsonl").read_text(encoding="utf-8")
    assert main(["study", "benchmarks", "--quick", "--data", str(DATA), "--out", str(tmp_path), "--quiet"]) == 0
    assert (tmp_path / "models.jsonl").read_text(encoding="utf-8") == again  # nothing is made twice


def test_the_page_shows_sets_without_published_results_too(tmp_path):
    rows = [
        row("cascaded tanks", "lti", val=0.6) | {"model": "cascaded tanks: lti", "about": "order 3", "seconds": 1.0},
        {"model": "coupled drives: lti", "set": "coupled drives", "method": "lti", "refused": "too short", "seconds": 1.0},
    ]
    page = html_text(benchmarks._report(rows, ("cascaded tanks", "coupled drives"), tmp_path, {}))
    for text in ("CT-SUBNET 0.306", "refused: too short", "0.588"):
        assert text in page
