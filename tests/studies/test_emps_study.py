"""The study of measured axis records: its laws against formulas, its claims on the records where they are at hand."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from plants import POSITIONING_AXIS
from studies import STUDIES, emps, emps_laws
from studies.cli import main
from workbench.data import Dataset, Experiment
from workbench.diagnosis.diagnosis import diagnose
from workbench.diagnosis.predictor import predictor
from workbench.diagnosis.recalibrate import recalibrated, unknowns
from workbench.diagnosis.refit import Model
from workbench.errors import InputError
from workbench.simulation import replay

pytestmark = pytest.mark.slow

DATA = Path(__file__).parents[3] / "shared" / "data" / "emps"
measured = pytest.mark.skipif(not DATA.is_dir(), reason="measured data not here: expected ../shared/data/emps")


def test_the_study_is_registered():
    assert STUDIES["emps"]() is emps


@pytest.fixture(scope="module")
def simulated():
    """8 s of a slow swing with friction 20 N, offset 3 N: 4 passages each way."""
    t = 0.001 * np.arange(8000)
    force = 60.0 * np.sin(2 * np.pi * t / 2.0) - 3.0
    record = Experiment.from_arrays("swing", 0.001, inputs={"F": force}, units={"F": "N"})
    effects = {emps_laws.COULOMB: {"level": 20.0, "width": 1e-3}, emps_laws.OFFSET: {"level": 3.0}}
    run = replay(POSITIONING_AXIS, record, parameters={"M": 90.0, "Fv": 210.0}, effects=effects)
    return run.experiment


def taken(law, e):
    model = emps_laws._taken(law, Dataset((e,)))
    return emps_laws.Judged(law, model, {})


def test_the_force_of_a_law_is_its_written_formula(simulated):
    """F = Fv v + Fc tanh(v/w) + offset with the published numbers and sign: an offset of the drive of +3 N pushes forward."""
    v = np.array([-0.1, -0.02, 0.02, 0.1])
    force = taken(emps_laws.AS_PUBLISHED, simulated).force(v)
    p = emps_laws.PUBLISHED
    assert force == pytest.approx(p["Fv"] * v + p["Fc"] * np.sign(v) + p["offset"], abs=1e-6)


def test_viscous_friction_by_direction_is_two_straight_lines(simulated):
    law = emps_laws.Law(
        "two", emps_laws.TWO_VISCOSITIES, given={}, parameters={"M": 95.0, "Fv_forward": 160.0, "Fv_backward": 240.0}
    )
    v = np.array([-0.1, -0.05, 0.05, 0.1])
    assert taken(law, simulated).force(v) == pytest.approx([-24.0, -12.0, 8.0, 16.0], abs=1e-9)


def test_equal_viscosities_are_the_nominal_axis(simulated):
    """The extended equation is neutral where both directions agree."""
    both = replay(emps_laws.TWO_VISCOSITIES, simulated, parameters={"M": 95.0, "Fv_forward": 180.0, "Fv_backward": 180.0})
    one = replay(POSITIONING_AXIS, simulated, parameters={"M": 95.0, "Fv": 180.0})
    assert both.experiment["q"] == pytest.approx(one.experiment["q"], abs=1e-12)


def test_force_over_speed_is_the_friction_that_was_simulated(simulated):
    """F - M q'' = Fv v + Fc sign v - offset away from the reversals, which the filter rounds."""
    seen = emps_laws.over_speed(simulated, 90.0)
    fast = np.abs(seen.v) > 0.3 * np.abs(seen.v).max()
    assert fast.sum() >= 10
    truth = 210.0 * seen.v + 20.0 * np.sign(seen.v) - 3.0
    assert seen.force[fast] == pytest.approx(truth[fast], abs=0.4)
    # with another mass the acceleration would be in it: the means hold only at the right one
    off = emps_laws.over_speed(simulated, 140.0)
    assert np.all(off.deviation > 0.0)


@pytest.mark.parametrize("hidden", [0.0, 4.0])
def test_pulses_that_the_logged_force_lacks_are_seen_with_their_size(simulated, hidden):
    """A second input of 4 N is found as such; pulses that are in the logged force already leave nothing."""
    t = simulated.t
    pulses = (np.floor(t / 0.5).astype(int) % 2).astype(float)
    given = simulated["F"] + 10.0 * pulses
    effects = {emps_laws.COULOMB: {"level": 20.3935, "width": 1e-3}, emps_laws.OFFSET: {"level": 3.1648}}
    drive = Experiment.from_arrays("p", 0.001, inputs={"F": given + hidden * pulses}, units={"F": "N"})
    run = replay(POSITIONING_AXIS, drive, parameters={"M": 95.1089, "Fv": 203.5034}, effects=effects).experiment
    e = Experiment.from_arrays("p", 0.001, inputs={"F": given}, outputs={"q": run["q"]})
    found = emps_laws.pulse_force(taken(emps_laws.AS_PUBLISHED, e), emps_laws.Records(e, e, pulses, ()))
    assert found is not None
    assert found.force == pytest.approx(hidden, abs=0.6)
    assert found.deviation < 0.6


def test_a_fit_of_the_free_run_has_its_own_smallest_error(simulated):
    """On records that the law itself made nothing is left; on the way there the numbers were not the true ones."""
    law = emps_laws.Law("viscous", parameters={})
    e = replay(POSITIONING_AXIS, simulated, parameters={"M": 88.0, "Fv": 230.0}).experiment
    at = predictor(POSITIONING_AXIS, Dataset((e,)), drift=False)
    done = recalibrated(at, own=unknowns(at, names=()))
    wrong = emps_laws.Judged(law, Model(done.predictor, done.fit), {})
    with_all = recalibrated(predictor(POSITIONING_AXIS, Dataset((e,)), drift=False))
    right = emps_laws.Judged(law, Model(with_all.predictor, with_all.fit), {})
    records = emps_laws.Records(e, e, None, ())
    assert emps_laws.in_free_run(right, records)["swing"] < 1e-5
    assert emps_laws.in_free_run(wrong, records)["swing"] > 1e-3


def test_one_record_that_begins_in_motion_is_enough_to_name_friction():
    """Its first piece alone tells where it starts: left out with that piece, the start is found anew and refuses no cause."""
    t = 0.001 * np.arange(6000)
    force = 60.0 * np.sin(2 * np.pi * t / 1.5)
    drive = Experiment.from_arrays("moving", 0.001, inputs={"F": force}, units={"F": "N"})
    effects = {emps_laws.BY_SIDE: {"forward": 12.0, "backward": 24.0, "width": 2e-3}}
    run = replay(POSITIONING_AXIS, drive, start={"v": 0.08}, effects=effects).experiment
    q = run["q"] + 2e-7 * np.random.default_rng(3).standard_normal(len(t))
    found = diagnose(
        POSITIONING_AXIS, Dataset((Experiment.from_arrays("moving", 0.001, inputs={"F": force}, outputs={"q": q}),)), drift=False
    )
    assert list(found.effects) == [emps_laws.BY_SIDE]
    assert found.effects[emps_laws.BY_SIDE]["forward"] == pytest.approx(12.0, abs=1.0)
    assert found.effects[emps_laws.BY_SIDE]["backward"] == pytest.approx(24.0, abs=1.0)


def test_without_records_the_study_says_which_are_needed_and_whose(capsys, tmp_path):
    for arguments in ((), ("--data", str(tmp_path))):
        assert main(["study", "emps", "--out", str(tmp_path / "out"), *arguments]) == 2
        said = capsys.readouterr().err
        assert "DATA_EMPS.mat" in said
        assert "DATA_EMPS_PULSES.mat" in said
        assert "nonlinearbenchmark.org" in said
    assert not (tmp_path / "out" / "report.html").exists()


def test_files_of_that_name_that_hold_something_else_are_refused(tmp_path):
    for name in (emps_laws.ESTIMATION, emps_laws.HELD_OUT):
        savemat(tmp_path / name, {"t": 0.1 * np.arange(50.0), "y": np.sin(np.arange(50.0))})
    with pytest.raises(InputError, match=r"DATA_EMPS\.mat"):
        emps.main(folder=tmp_path / "out", data=str(tmp_path))


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    folder, said = tmp_path_factory.mktemp("emps"), []
    path = emps.main(quick=True, folder=folder, data=str(DATA), say=said.append)
    return json.loads((folder / "diagnosis.json").read_text()), path.read_text(), "\n".join(said), folder


@measured
def test_the_diagnosis_names_what_the_literature_names(result):
    """Published: M 95.11 kg, Fc 20.39 N, offset -3.165 N; as one effect dry friction of 17.23 N forward and 23.56 N backward."""
    found = result[0]
    named = [f"{c['effect']}@{c['at']}" for c in found["causes"]]
    assert named[0] == emps_laws.BY_SIDE
    assert set(named[1:]) <= {"quantisation@q"}  # the file holds steps of 50 nm
    sizes = found["causes"][0]["parameters"]
    for side, published in (("forward", 17.23), ("backward", 23.56)):
        assert sizes[side]["low"] < published < sizes[side]["high"]
        assert sizes[side]["value"] == pytest.approx(published, rel=0.05)
    assert found["parameters"]["M"] == pytest.approx(95.11, rel=0.02)
    assert found["parameters"]["Fv"] == pytest.approx(203.5, rel=0.1)


@measured
def test_naming_it_gains_on_the_record_that_was_never_fitted(result):
    """One second ahead less than half of the error, the free run too; not the numbers of the first record."""
    laws = {law["law"]: law["rms"] for law in result[0]["laws"]}
    before, after = laws["viscous"]["DATA_EMPS_PULSES"], laws["viscous, dry by direction"]["DATA_EMPS_PULSES"]
    assert after["one-step"] < 0.6 * before["one-step"]
    assert after["one-second"] < 0.5 * before["one-second"]
    assert after["full-run"] < 0.6 * before["full-run"]
    assert laws["viscous, dry by direction"]["DATA_EMPS"]["one-second"] != after["one-second"]


@measured
def test_the_saved_plant_runs_as_the_page_says(result):
    """The extended axis from its file, replayed by the simulator, against the error that the study states."""
    from studies.arguments import find_plant
    from workbench.readers import read_file

    plant = find_plant(str(result[3] / "extended.json"))
    e = read_file(DATA / emps_laws.ESTIMATION).trim(stop=emps_laws.SHORT)
    steps = np.arange(40)
    speed = float(np.polyfit(e.t[steps], e["q"][steps], 2)[1])
    run = replay(plant, e, start={"q": float(e["q"][0]), "v": speed})
    stated = next(law for law in result[0]["laws"] if law["law"] == "viscous, dry by direction")["rms"]["DATA_EMPS"]["full-run"]
    assert np.sqrt(np.mean((run.experiment["q"] - e["q"]) ** 2)) == pytest.approx(stated, rel=0.25)


@measured
def test_the_page_says_what_is_left_and_what_cannot_be_told(result):
    page, said = result[1], result[2]
    assert result[0]["verdict"] in ("incomplete", "unknown")
    assert "The diagnosis says that something is left" in said
    assert "A law that the catalogue lacks" in said
    for heading in ("Friction over speed", "Free runs", "Laws of friction", "What these records cannot tell", "Provenance"):
        assert f">{heading}</h2>" in page
    for words in ("Offset or dry friction that differs by direction", "Pulses of the second record", "Quick: the first"):
        assert words in page
