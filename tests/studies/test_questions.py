"""Studies that are sweeps: what is said is what the rows say, and rows that are there are not made again."""

from collections.abc import Mapping

import numpy as np
import pytest

from studies import STUDIES, detection_rate, noise_level, pid_bandwidth, record_count, sampling_time
from studies.cli import main
from studies.question import NOWHERE, Answer, Question, Runs, _lost, study
from workbench.errors import InputError
from workbench.files import read_json
from workbench.report.blocks import Table
from workbench.sweeps.design import Factor, Sweep
from workbench.sweeps.rows import Rows, read_rows

QUESTIONS = {
    "pid-bandwidth": pid_bandwidth,
    "sampling-time": sampling_time,
    "noise-level": noise_level,
    "record-count": record_count,
    "detection-rate": detection_rate,
}


def runs(parameters, **columns) -> Runs:
    """Rows of these columns, names with _ for a space."""
    named = {name.replace("_", " "): list(values) for name, values in columns.items()}
    names = ("run", "seed", *named, "error")
    rows = tuple((i, 0, *values, "") for i, values in enumerate(zip(*named.values(), strict=True)))
    return Runs(Rows(names, dict.fromkeys(named, ""), parameters, rows))


def test_medians_and_groups_are_those_of_the_rows():
    seen = runs(("x",), x=[1.0, 2.0, 1.0, 2.0, 1.0], y=[5.0, 1.0, 7.0, None, 90.0])
    np.testing.assert_array_equal(seen.levels("x"), [1.0, 2.0])
    np.testing.assert_array_equal(seen.medians("x", "y"), [7.0, 1.0])
    np.testing.assert_array_equal(seen.medians("x", "y", seen["y"] < 50.0), [6.0, 1.0])
    first, second = seen.groups("x", "x", "y")
    np.testing.assert_array_equal(first[1], [5.0, 7.0, 90.0])
    np.testing.assert_array_equal(second[1], [1.0, np.nan])
    table = seen.table("t", "x", ("y",), "")
    assert table.rows == ((1.0, 7.0), (2.0, 1.0))


def loops(parameter, values, theta):
    n = len(values)
    return runs(
        (parameter,), **{parameter: values}, bandwidth=np.linspace(2.0, 9.0, n), sensitivity=np.full(n, 1.2),
        delay_margin=np.linspace(0.12, 0.02, n), integral_action=np.ones(n), theta_RMS=theta, w3_RMS=np.ones(n),
        V1_travel=np.ones(n), V2_travel=np.ones(n),
    )  # fmt: skip


@pytest.mark.slow
def test_the_calmest_law_that_costs_little_is_the_one_to_take():
    said = pid_bandwidth.read(loops("peak", [1.2, 1.4, 1.6, 2.0], [3.0, 1.04, 1.0, 1.5])).verdict
    assert "least, 1, at 6.67 rad/s (|S| and |T| at most 1.6)" in said
    assert "with 4.33 rad/s (at most 1.4) it is no more than 5 % larger" in said
    assert "86.7 ms of delay are left instead of 53.3 ms" in said
    assert "more bandwidth makes it worse." in pid_bandwidth.read(loops("peak", [1.2, 1.4, 1.6], [3.0, 1.0, 1.5])).verdict
    assert "worse, and less was not tried." in pid_bandwidth.read(loops("peak", [1.2, 1.4, 1.6], [0.9, 1.0, 1.5])).verdict
    assert "beyond it was not looked" in pid_bandwidth.read(loops("peak", [1.2, 1.4, 1.6], [3.0, 2.0, 1.0])).verdict


@pytest.mark.slow
def test_the_slowest_sampling_that_costs_little_and_what_no_law_keeps():
    said = sampling_time.read(loops("dt", [0.01, 0.02, 0.04, 0.08], [1.05, 1.0, 1.09, 2.0])).verdict
    assert "least, 1, at a sample time of 20 ms" in said
    assert "within 10 % of that up to 40 ms (1.09)" in said
    assert "at 80 ms it is 2" in said
    lost = sampling_time.read(loops("dt", [0.01, 0.02, 0.04], [1.0, 1.05, None])).verdict
    assert "up to 20 ms (1.05); no slower sampling came to an end" in lost
    assert "nan" not in lost
    # what comes after a bad one is not within reach
    assert "up to 20 ms" in sampling_time.read(loops("dt", [0.01, 0.02, 0.04, 0.08, 0.12], [1.0, 1.05, 1.5, 1.08, 2.0])).verdict
    assert sampling_time.read(loops("dt", [0.01, 0.02], [None, None])).verdict == NOWHERE


def test_a_level_at_which_a_run_failed_is_not_the_best_and_is_told():
    """At 120 ms three of four runs ran away, and the one that did not is the best of all."""
    columns = ("dt", "theta RMS", "bandwidth", "delay margin", "integral action", "w3 RMS", "V1 travel")
    rows = [(i, 0, dt, 1.0, 5.0, 0.1, 1.0, 1.0, 1.0, "") for i, dt in enumerate([0.04, 0.04, 0.08, 0.08])]
    rows += [(4, 0, 0.12, 0.9, 5.0, 0.1, 1.0, 1.0, 1.0, ""), (5, 0, 0.12, *[None] * 6, "left the range")]
    found = Rows(("run", "seed", *columns, "error"), dict.fromkeys(columns, ""), ("dt",), tuple(rows))
    said = sampling_time.read(Runs(found)).verdict
    assert "least, 1, at a sample time of 40 ms" in said
    assert list(_lost(found)) == ["At dt 0.12 1 of 2 runs failed."]


def test_the_best_model_by_noise_is_said_where_there_is_one_and_where_it_changes():
    def seen(ssm):
        models = [name for name in noise_level.MODELS for _ in range(2)]
        fits = [50.0, 40.0, 90.0, 70.0, *ssm]
        return runs(("model", "noise"), model=models, noise=[1.0, 8.0] * 3, w3_FIT=fits, w3_machine_FIT=[97.0, 80.0] * 3)

    said = noise_level.read(seen([95.0, 72.0])).verdict
    assert "At 8 times the noise of the sensors: LTI 40.0 %, ILM 70.0 %, SSM 72.0 % (the true machine 80.0 %)." in said
    assert "SSM is best at every level, by 2.0 points of FIT or more." in said
    assert "The best one by noise: 1: SSM; 8: ILM." in noise_level.read(seen([95.0, 69.0])).verdict
    lost = noise_level.read(seen([95.0, None])).verdict
    assert "8: a method failed" in lost
    assert "SSM failed (the true machine" in lost


def test_how_many_records_an_envelope_needs():
    def seen(inside):
        return runs(("records",), records=[1.0, 2.0, 4.0], w3_width=[1.0, 1.5, 2.0], w3_inside=inside)

    said = record_count.read(seen([96.0, 99.0, 99.95])).verdict
    assert "From 1 record the envelope of w3 holds 96.00 %" in said
    assert "From 4 records on 99.9 % or more are inside." in said
    assert "None of these reaches 99.9 %" in record_count.read(seen([96.0, 99.95, 99.5])).verdict  # once is not from there on
    assert "From 2 records the envelope" in record_count.read(seen([None, 99.0, 99.5])).verdict
    assert "None of these reaches 99.9 %" in record_count.read(seen([96.0, 99.0, 99.5])).verdict


def test_from_which_size_on_an_effect_is_found_and_what_is_wrongly_named():
    size = np.repeat([0.0, 1.0, 2.0, 4.0], 4)
    found = np.repeat([0.0, 1.0, 0.0, 1.0], 4)  # a size that is found below one that is not does not count
    wrong = (np.arange(16) == 5).astype(float)
    inside = [None] * 4 + [1.0, 0.0, 1.0, 1.0] + [None] * 4 + [1.0] * 4
    seen = runs(
        ("size",), size=size, found=found, named=found, wrong=wrong, inside=inside, estimate=size, limit=np.full(16, 0.5)
    )  # fmt: skip
    answer = detection_rate.read(seen)
    assert "sees dry friction from 0.5 on. It finds 95 % or more from 4 on, 8 times that." in answer.verdict
    assert "in 0 of 4 (0.0 %, " in answer.verdict
    assert "and in 1 of 12 (8.3 %, " in answer.verdict
    assert "inside its 95 % interval in 7 of 8 " in answer.verdict
    assert next(b for b in answer.blocks if isinstance(b, Table)).rows[2][1].startswith("0 of 4")
    nowhere = runs(
        ("size",), size=size, found=0 * size, named=0 * size, wrong=wrong, inside=inside, estimate=size, limit=np.full(16, 0.5)
    )  # fmt: skip
    assert "None of these sizes is found in 95 %" in detection_rate.read(nowhere).verdict
    # runs that failed are misses, and no reason to end without a page
    lost = np.where(size == 2.0, None, found)
    holes = runs(
        ("size",), size=size, found=lost, named=lost, wrong=wrong, inside=inside, estimate=size, limit=np.full(16, np.nan)
    )  # fmt: skip
    answer = detection_rate.read(holes)
    assert "nan" not in answer.verdict
    assert next(b for b in answer.blocks if isinstance(b, Table)).rows[2][1].startswith("no case")


@pytest.mark.parametrize("name", QUESTIONS)
def test_every_question_is_a_study_with_a_sweep_that_its_job_can_run(name):
    module = QUESTIONS[name]
    assert STUDIES[name]() is module
    for quick in (True, False):
        asked = module.asked(quick, 3)
        assert asked.name == name
        points = asked.sweep.points()
        assert {n for p in points for n in p.values} == {*asked.job.units}
        assert len(points) > (1 if quick else 10)
    assert {p.seed for p in module.asked(False, 3).sweep.points()}.isdisjoint(
        p.seed for p in module.asked(False, 4).sweep.points()
    )


class Doubles:
    """2 x, and nothing for x = 3; counts its calls."""

    configuration: Mapping = {"double": 2}
    units: Mapping = {"x": "m"}
    outputs: Mapping = {"y": "m"}
    made = 0

    def on_threads(self, count):
        return self

    def __call__(self, points):
        Doubles.made += len(points)
        return [InputError("three") if p.values["x"] == 3.0 else {"y": 2.0 * p.values["x"]} for p in points]


def doubled(quick, seed):
    values = (3.0,) if seed == 9 else (1.0, 2.0, 3.0)
    read = lambda runs: Answer(f"y is {runs.medians('x', 'y')[0]:g}.", ())  # noqa: E731
    return Question("doubled", "Twice", Sweep("doubles", (Factor("x", values),)), Doubles(), read)


def test_a_study_goes_on_where_it_stopped_and_says_what_failed(tmp_path):
    said = []
    page = study(doubled)(quick=True, folder=tmp_path, seed=1, say=said.append)
    assert "3 runs, 1 failed" in said[0]
    assert "y is 2. At x 3 1 of 1 runs failed. This was a quick look with few runs." in said[0]
    assert "three" in page.read_text(encoding="utf-8")
    content = read_json(tmp_path / "doubled.json")
    assert content["rows"][2][2:] == [3.0, None, "InputError: three" if "InputError" in content["rows"][2][-1] else "three"]
    assert Doubles.made == 3
    study(doubled)(quick=True, folder=tmp_path, seed=1, say=said.append)
    assert Doubles.made == 3
    assert len(read_rows(tmp_path / "sweep.sqlite").rows) == 3
    with pytest.raises(InputError, match="every run failed, the first with: three"):
        study(doubled)(folder=tmp_path / "other", seed=9)
    with pytest.raises(InputError, match="another sweep, job or version") as refused:
        study(doubled)(folder=tmp_path, seed=9)
    assert "--seed, --quick and program that began it" in refused.value.mend
    with pytest.raises(InputError, match="makes its own records"):
        study(doubled)(folder=tmp_path, data="records")


@pytest.mark.slow
def test_the_number_of_records_from_the_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(record_count, "QUICK", (1.0, 3.0))
    monkeypatch.setattr(record_count, "QUICK_SEEDS", 2)
    out = tmp_path / "out"
    assert main(["study", "record-count", "--quick", "--out", str(out), "--jobs", "1", "--seed", "2"]) == 0
    said = capsys.readouterr().out
    assert "4 runs, 0 failed" in said
    assert {p.name for p in out.iterdir()} >= {"report.html", "report.json", "sweep.sqlite", "sweep.csv", "record-count.json"}
    rows = read_rows(out / "sweep.sqlite").rows
    assert all(
        rows[i + 2][4] >= rows[i][4] for i in (0, 1)
    )  # the same first record in both: the wider box of three holds its box
