"""The study of measured winding records: what it reads, what it may claim, and its page on the records where they are at hand."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from studies import STUDIES
from studies import winding_records as study
from studies.cli import main
from workbench.data import Experiment
from workbench.diagnosis.answer import Cause, Diagnosis, Estimate, Evidence, Finding, Limit
from workbench.errors import InputError
from workbench.physics.identified import identified
from workbench.simulation import replay

pytestmark = pytest.mark.slow

DATA = Path(__file__).parents[3] / "shared" / "data" / "winding_daisy"
measured = pytest.mark.skipif(not DATA.is_dir(), reason="measured data not here: expected ../shared/data/winding_daisy")


def test_the_study_is_registered():
    assert STUDIES["winding-records"]() is study


# ---- records ----------------------------------------------------------------------------------------------------------------


def test_without_records_the_study_says_which_are_needed_and_whose(capsys, tmp_path):
    for arguments in ((), ("--data", str(tmp_path))):
        assert main(["study", "winding-records", "--out", str(tmp_path / "out"), *arguments]) == 2
        said = capsys.readouterr().err
        assert "winding.dat" in said
        assert "DaISy" in said
    assert not (tmp_path / "out" / "report.html").exists()


@pytest.mark.parametrize("content", ["1 2 3\n4 5 6\n", "no numbers\n"])
def test_a_file_of_that_name_that_holds_something_else_is_refused(tmp_path, content):
    (tmp_path / "winding.dat").write_text(content)
    with pytest.raises(InputError, match=r"winding\.dat"):
        study.read_runs(str(tmp_path))


def test_two_runs_are_read_apart_at_the_joint(tmp_path):
    """The file counts its rows in every column: no sample is lost, none is in both runs."""
    values = np.arange(2500.0)[:, None] + 1e-3 * np.arange(7)
    np.savetxt(tmp_path / "winding.dat", values)
    first, second = study.read_runs(str(tmp_path))
    assert (len(first), len(second)) == (1500, 1000)
    assert first["S1"][-1] == 1499.0
    assert second["S1"][0] == 1500.0
    assert second["T3"][0] == pytest.approx(1500.006)
    assert [c.name for c in first.channels if c.role == "output"] == ["T1", "T3"]
    assert first.dt == second.dt == 0.1
    assert second.t[0] == 0.0


# ---- claims -----------------------------------------------------------------------------------------------------------------

NOISE = np.random.default_rng(0).standard_normal((40, 7))
RUNS = [Experiment(name, 0.1 * np.arange(40), study.CHANNELS, NOISE, 0.1) for name in ("run 1", "run 2")]


def cause(key, value=0.5, ties=()):
    effect, place = key.split("@")
    sizes = {"limit" if effect == "saturation" else "level": Estimate(value, value, value, "")}
    return Cause(effect, place, "", sizes, (), Evidence(50.0, 0.0, 1.0), dict.fromkeys(ties, 0.3))


def side(own, causes=(), *, change=-0.1, limits=(), acts=None, finding=None):
    finding = finding or (Finding.NAMED if causes else Finding.NOTHING)
    found = Diagnosis("LTI", finding, tuple(causes), {}, (), tuple(limits), (), None, {}, {}, (), np.empty((0, 0)))
    keys = [(name, h) for name in study.OUTPUTS for h in study.HORIZONS]
    before = {e.name: dict.fromkeys(keys, 0.2) for e in RUNS}
    after = {e.name: dict.fromkeys(keys, 0.2 * (1.0 + change)) for e in RUNS}
    ways = RUNS if own == 0 else RUNS[::-1]
    return study.Side(*ways, MODEL, PLANT, found, before, after, None, acts or {})


def small_model():
    from workbench.basis import CONSTANT
    from workbench.lpv import OperatingPoint, constant_model

    random = np.random.default_rng(1)
    matrices = [0.3 * random.standard_normal(shape) for shape in ((2, 2), (2, 5), (2, 2), (2, 5))]
    point = OperatingPoint(CONSTANT, np.zeros((1, 5)), np.zeros((1, 2)))
    return constant_model("LTI", 0.1, (study.CHANNELS[:5], study.CHANNELS[5:]), matrices, point)


MODEL = small_model()
PLANT = identified(MODEL)


def test_a_cause_that_one_run_names_is_no_finding_about_the_process():
    sides = [side(0, [cause("offset@S1")]), side(1)]
    assert study.held(sides) == []
    assert "no finding about the process" in study.verdict(sides)


def test_a_cause_holds_where_both_runs_name_it_or_tie_it_and_nothing_gets_worse():
    both = [side(0, [cause("offset@S1", ties=["offset@S2"])]), side(1, [cause("offset@S2")])]
    assert study.held(both) == ["offset@S2"]
    assert "Named from both runs" in study.verdict(both)
    worse = [both[0], side(1, [cause("offset@S2")], change=0.01)]
    assert study.held(worse) == []


@pytest.mark.parametrize(
    ("effect", "size", "limit", "able"),
    [("saturation", 2.0, 3.0, True), ("saturation", 3.5, 3.0, False), ("offset", 3.5, 3.0, True), ("offset", -2.0, 3.0, False)],
)
def test_a_run_that_could_not_show_a_cause_is_not_held_against_it(effect, size, limit, able):
    sides = [side(0, [cause(f"{effect}@S1", size)]), side(1, limits=[Limit(effect, "S1", limit, "")])]
    said = study.verdict(sides)
    assert ("would have shown" in said) is able
    assert ("could not have shown" in said) is not able


def test_what_acts_in_few_samples_is_said_to_rest_on_them():
    said = study.verdict([side(0, [cause("saturation@S1")], acts={"saturation@S1": 1}), side(1)])
    assert "acts in 1 of 40 samples" in said
    assert "single wrong readings" in said
    assert "wrong readings" not in study.verdict([side(0, [cause("saturation@S1")], acts={"saturation@S1": 30}), side(1)])


def test_what_acts_is_the_command_through_its_effects():
    found = replace(side(0, [cause("saturation@S1")]).found, effects={"saturation@S1": {"limit": 0.5}})
    moved = study.acting(PLANT, found, RUNS[0])
    assert np.array_equal(moved["S1"], np.clip(RUNS[0]["S1"], -0.5, 0.5))
    assert np.array_equal(moved[["S2", "T1", "T3"]], RUNS[0][["S2", "T1", "T3"]])


# ---- on the records ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    folder, said = tmp_path_factory.mktemp("winding-records"), []
    path = study.main(quick=True, folder=folder, data=str(DATA), say=said.append)
    return json.loads((folder / "diagnosis.json").read_text()), path.read_text(), "\n".join(said), folder


@measured
def test_both_runs_of_the_measured_file_are_scaled_each_by_itself():
    for e in study.read_runs(str(DATA)):
        assert e.values.mean(axis=0) == pytest.approx(0.0, abs=1e-8)
        assert e.values.std(axis=0) == pytest.approx(1.0, abs=1e-6)
        assert np.corrcoef(e.values[:, :5].T) == pytest.approx(np.eye(5), abs=1e-6)
        assert np.corrcoef(e.values[:, 5:].T) == pytest.approx(np.eye(2), abs=1e-6)


@measured
def test_the_errors_are_those_of_the_models_own_free_run(result):
    """The page's full-run error against the model file, run from its own predictor; only where a run starts differs."""
    from workbench.lpv import load_model

    _, second = study.read_runs(str(DATA))
    model = load_model(result[3] / "run_1.json")
    missed = (second[["T1", "T3"]] - model.simulate(second))[model.warmup :]
    stated = {
        e["output"]: e["before"] for e in result[0]["sides"][0]["errors"] if (e["record"], e["horizon"]) == ("run 2", "full-run")
    }
    assert [stated["T1"], stated["T3"]] == pytest.approx(np.sqrt(np.mean(missed**2, axis=0)), rel=0.03)


@measured
def test_the_extended_model_is_saved_and_runs_as_the_page_says(result):
    from studies.arguments import find_plant

    plant = find_plant(str(result[3] / "extended.json"))
    assert plant.effects == result[0]["effects"]
    _, second = study.read_runs(str(DATA))
    run = replay(plant, second).experiment
    missed = (second[["T1", "T3"]] - run[["T1", "T3"]])[50:]
    stated = {
        e["output"]: e["after"] for e in result[0]["sides"][0]["errors"] if (e["record"], e["horizon"]) == ("run 2", "full-run")
    }
    assert [stated["T1"], stated["T3"]] == pytest.approx(np.sqrt(np.mean(missed**2, axis=0)), rel=0.05)


@measured
def test_the_page_says_what_cannot_be_known(result):
    page, said = result[1], result[2]
    for words in ("No units", "scaled and mixed each by itself", "no radius, no friction", "Not testable"):
        assert words in page
    for heading in ("What these records can tell", "Errors", "run 1: What these records can show", "Provenance"):
        assert f">{heading}</h2>" in page
    assert "Quick: one way round only" in said
