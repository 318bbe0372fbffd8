"""What a sweep can run beside closed loops: every row is what the same steps give when made by hand."""

from argparse import Namespace
from dataclasses import replace

import numpy as np
import pytest

from controllers.pid_design import Structure, design_pid
from plants import PLANTS
from studies.cli import main
from studies.experiments import measured, plan
from studies.jobs import JOBS, detection
from studies.jobs.detection import Detection
from studies.jobs.identification import Identification
from studies.jobs.pid_design import DesignedLoop
from studies.jobs.recorded import Recorded
from workbench.data import Dataset
from workbench.diagnosis.answer import Cause, Diagnosis, Estimate, Evidence, Finding, Limit
from workbench.errors import InputError
from workbench.identification.lti import LTI
from workbench.intervals.regression import IntervalRegression
from workbench.intervals.regressors import ARX
from workbench.intervals.semantics import InclusionExact
from workbench.metrics import fit
from workbench.robustness.frozen import Bounds
from workbench.robustness.limits import Manoeuvre
from workbench.simulation import replay, simulate
from workbench.sweeps.design import Point, load_sweep
from workbench.sweeps.rows import read_rows

WINDING, ROBOT = PLANTS["web-winding"], PLANTS["welding-robot"]
ROBOT_LOGGED = Recorded("welding-robot", ("prbs", "rbs"), ("u",), ("v",))
USUAL = {"dt": 0.0, "noise": 1.0, "records": 0.0}
LOGGED = """
[fixed]
plant = "welding-robot"
inputs = ["u"]
outputs = ["v"]
experiments = ["prbs", "rbs"]
"""
ASKED = {
    "identification": f"""
run = "identification"
[parameters.noise]
values = [0.5, 2.0]
{LOGGED}
held_out = ["multisine"]
model = "lti"
order = 2
""",
    "pid-design": f"""
run = "pid-design"
[parameters.peak]
values = [1.3, 1.8]
{LOGGED}
order = 2
[fixed.run]
duration = 5.0
[fixed.run.setpoints]
v = 0.2
""",
    "detection": """
run = "detection"
[parameters.size]
values = [0.0, 0.01]
[fixed]
plant = "welding-robot"
experiments = ["prbs"]
effect = "coulomb@rail:level"
""",
}


def seed_of(seed, held_out, again):
    """The seed of a record, as the job says it draws them: apart by round and by what they are for."""
    return int(np.random.SeedSequence([seed, held_out, again]).generate_state(1)[0])


@pytest.mark.slow
def test_a_record_at_its_own_sample_time_is_the_plans_and_at_another_one_follows_it_in_time():
    own = measured(WINDING, "rbs", 5)
    todo = plan("web-winding", "rbs")
    np.testing.assert_array_equal(own["w3"], simulate(WINDING, todo.controller, todo.scenario(5)).experiment["w3"])
    fine = measured(replace(WINDING.sampled(0.02), noise={}, disturbance={}), "rbs", 5)
    coarse = measured(replace(WINDING, noise={}, disturbance={}), "rbs", 5)
    assert (fine.dt, len(fine)) == (0.02, 2 * len(coarse))
    assert np.corrcoef(fine["w3"][::2], coarse["w3"])[0, 1] > 0.98  # the loop is another one, what it follows is not
    slow = measured(ROBOT.sampled(0.05), "prbs", 1)  # in open loop the inputs themselves are held
    u = plan("welding-robot", "prbs").scenario(1).references["u"]
    np.testing.assert_array_equal(slow["u"][:6], u[[0, 2, 5, 7, 10, 12]])
    assert slow.t[-1] <= 0.02 * len(u)


def test_records_are_taken_in_turn_each_round_drawn_anew_and_held_out_apart():
    found = ROBOT_LOGGED.records(7, USUAL | {"records": 3.0})
    assert found.names == ("prbs", "rbs", "prbs 2")
    again = measured(ROBOT, "prbs", seed_of(7, 0, 1))
    np.testing.assert_array_equal(found.experiments[2]["v"], again["v"])
    np.testing.assert_array_equal(found.experiments[0]["v"], measured(ROBOT, "prbs", seed_of(7, 0, 0))["v"])
    apart = ROBOT_LOGGED.records(7, USUAL, held_out=True)
    assert len({e["v"].tobytes() for e in (*found, *apart)}) == 5
    assert len(ROBOT_LOGGED.records(7, USUAL)) == 2
    assert found.experiments[0].names_of("output") == ("v",)


def test_noise_is_the_sensors_and_disturbances_keep_their_power_over_frequency():
    loud = Recorded("web-winding", ("rbs",)).sampled(USUAL | {"noise": 3.0, "dt": 0.01})
    assert loud.noise == {name: pytest.approx(3.0 * value) for name, value in WINDING.noise.items()}
    assert loud.disturbance == {name: pytest.approx(2.0 * value) for name, value in WINDING.disturbance.items()}  # 0.04 / 0.01
    assert loud.dt == 0.01
    assert WINDING.disturbance


@pytest.mark.slow
def test_an_identification_is_the_model_and_its_free_run_on_records_it_never_saw():
    job = Identification(ROBOT_LOGGED, ("multisine", "steps"), {"order": 2.0}, ("lti",), ("noise",))
    (found,) = job([Point(0, 3, {"noise": 2.0})])
    loud = replace(ROBOT, noise={name: 2.0 * value for name, value in ROBOT.noise.items()})

    def logged(name, held_out):
        return measured(loud, name, seed_of(3, held_out, 0)).with_roles(inputs=("u",), outputs=("v",))

    model = LTI(order=2).fit(Dataset(tuple(logged(name, 0) for name in ("prbs", "rbs"))))
    held = [logged(name, 1) for name in ("multisine", "steps")]
    fits = [fit(e["v"][model.warmup :], model.simulate(e)[model.warmup :, 0]) for e in held]
    assert found["v FIT"] == pytest.approx(np.mean(fits), abs=1e-9)
    assert found["v machine FIT"] == pytest.approx(
        np.mean([fit(e["v"], replay(ROBOT, e).experiment["v"]) for e in held]), abs=1e-9
    )
    assert found["v FIT"] < found["v machine FIT"] + 1.0


@pytest.mark.slow
def test_an_interval_model_gives_what_its_envelope_holds_and_its_half_width():
    job = Identification(replace(ROBOT_LOGGED, experiments=("prbs",)), ("multisine",), {}, ("interval",), ("records",))
    assert job.outputs == {"v inside": "%", "v width": "m/s"}
    one, four = job([Point(0, 3, {"records": 1.0}), Point(1, 3, {"records": 4.0})])
    assert four["v width"] >= one["v width"]  # the box of four records holds the first one too
    assert one["v inside"] <= four["v inside"] <= 100.0
    e = measured(ROBOT, "multisine", seed_of(3, 1, 0)).with_roles(inputs=("u",), outputs=("v",))
    estimation = Dataset((measured(ROBOT, "prbs", seed_of(3, 0, 0)).with_roles(inputs=("u",), outputs=("v",)),))
    seen = IntervalRegression(ARX(2), InclusionExact(), output_error=0.0, input_error=0.0).fit(estimation, "v").one_step(e)
    inside = (seen.low <= seen.y) & (seen.y <= seen.high)
    assert one["v inside"] == pytest.approx(100.0 * np.mean(inside))
    assert one["v width"] == pytest.approx(np.mean(seen.high - seen.low) / 2.0)


@pytest.mark.slow
def test_a_designed_loop_is_the_design_on_the_model_and_the_machine_under_it():
    run = Manoeuvre(6.0, {"v": ((0.0, 0.0), (1.0, 0.3))})
    job = DesignedLoop(ROBOT_LOGGED, run, {"low": {"u": -4.0}, "high": {"u": 4.0}, "rate": {}}, {"order": 2.0}, ("peak",))
    (found,) = job([Point(0, 5, {"peak": 1.4})])
    records = Dataset(
        tuple(measured(ROBOT, n, seed_of(5, 0, 0)).with_roles(inputs=("u",), outputs=("v",)) for n in ("prbs", "rbs"))
    )
    model = LTI(order=2, feedthrough=False).fit(records)
    limits = Structure(low=np.array([-4.0]), high=np.array([4.0]))
    design = design_pid(model, knots=1, bounds=Bounds(1.4, 1.4, 3.0), structure=limits, setpoint=[0.0])
    assert found["bandwidth"] == pytest.approx(design.margins.bandwidth.min(), rel=1e-6)
    assert found["delay margin"] == pytest.approx(design.margins.delay.min(), rel=1e-6)
    assert found["sensitivity"] == pytest.approx(design.margins.sensitivity.max(), rel=1e-6)
    assert found["sensitivity"] <= 1.4
    seen = simulate(ROBOT, design.law, replace(run, seed=5).scenario(ROBOT, design.law), bumpless=True).experiment
    error = seen["v"] - np.where(seen.t >= 1.0 - 1e-9, 0.3, 0.0)
    assert found["v RMS"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-6)


def cause(key, ties=(), **parameters):
    effect, place = key.split("@")
    sizes = {name: Estimate(*numbers, "N") for name, numbers in parameters.items()}
    return Cause(effect, place, "", sizes, (), Evidence(20.0, 1e-6, 1.0), dict.fromkeys(ties, 0.4))


@pytest.mark.parametrize(
    ("causes", "said"),
    [
        ((), (0, 0, 0, None)),
        ((cause("coulomb@rail", level=(0.01, 0.008, 0.012)),), (1, 1, 0, 1)),
        ((cause("coulomb@rail", level=(0.02, 0.015, 0.025)),), (1, 1, 0, 0)),
        ((cause("coulomb@rail", ("stribeck@rail",), level=(0.01, 0.008, 0.012)),), (1, 0, 0, 1)),
        ((cause("stribeck@rail", ("coulomb@rail",)),), (1, 0, 0, None)),
        ((cause("stribeck@rail"),), (0, 0, 1, None)),
        ((cause("coulomb@rail", level=(0.01, 0.008, 0.012)), cause("offset@u")), (1, 1, 1, 1)),
    ],
)
def test_what_a_diagnosis_says_is_found_named_or_wrong(causes, said, monkeypatch):
    limits = (Limit("coulomb", "rail", 0.004, "N"),)
    answer = Diagnosis("welding-robot", Finding.NAMED, causes, {}, (), limits, (), None, {}, {}, (), np.empty((0, 0)))
    seen = {}
    monkeypatch.setattr(detection, "diagnose", lambda plant, dataset: seen.update(plant=plant, dataset=dataset) or answer)
    job = Detection(Recorded("welding-robot", ("prbs",)), "coulomb@rail:level", {}, ("size",))
    (found,) = job([Point(0, 3, {"size": 0.01})])
    assert tuple(found.get(name) for name in ("found", "named", "wrong", "inside")) == said
    assert found["limit"] == 0.004
    hidden = measured(ROBOT, "prbs", seed_of(3, 0, 0), {"coulomb@rail": {"level": 0.01}})
    np.testing.assert_array_equal(seen["dataset"].experiments[0]["v"], hidden["v"])
    assert not seen["plant"].effects  # it is not told


def test_an_effect_that_is_named_where_nothing_is_hidden_is_wrong(monkeypatch):
    named = (cause("coulomb@rail", level=(0.01, 0.008, 0.012)),)
    answer = Diagnosis("welding-robot", Finding.NAMED, named, {}, (), (), (), None, {}, {}, (), np.empty((0, 0)))
    monkeypatch.setattr(detection, "diagnose", lambda plant, dataset: answer)
    (found,) = Detection(Recorded("welding-robot", ("prbs",)), "coulomb@rail:level", {}, ("size",))([Point(0, 3, {"size": 0.0})])
    assert [found.get(name) for name in ("found", "named", "wrong", "inside")] == [0.0, 0.0, 1.0, None]


@pytest.mark.slow
def test_a_large_friction_is_found_and_named_and_nothing_where_there_is_none():
    job = Detection(Recorded("welding-robot", ("prbs", "rbs")), "coulomb@rail:level", {}, ("size",))
    none, large = job([Point(0, 3, {"size": 0.0}), Point(1, 3, {"size": 0.1})])
    assert [none[name] for name in ("found", "named", "wrong")] == [0.0, 0.0, 0.0]
    assert [large[name] for name in ("found", "named", "wrong", "inside")] == [1.0, 1.0, 0.0, 1.0]
    assert large["estimate"] == pytest.approx(0.1, rel=0.05)
    assert none["limit"] > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(ASKED))
def test_a_file_asks_for_every_job_and_its_rows_are_the_jobs(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.toml").write_text(ASKED[name])
    assert main(["sweep", "s.toml", "--out", "o"]) == 0, capsys.readouterr().err
    found = read_rows("o/sweep.sqlite")
    sweep = load_sweep("s.toml")
    job = JOBS[name](sweep, tmp_path / "s.toml", Namespace(plant=None, controller=None))
    (first,) = job(sweep.points()[:1])
    own = dict(zip(found.names, found.rows[0], strict=True))
    assert own["error"] == ""
    assert {n for n in own if n in found.units} == {*job.outputs, *job.units}
    for output in job.outputs:
        assert own[output] == (pytest.approx(first[output], rel=1e-12) if np.isfinite(first.get(output, np.nan)) else None)
    assert found.rows[0][3:] != found.rows[1][3:]


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("identification", "noise]", "loudness]", "unknown parameter 'loudness'"),
        ("identification", "[0.5, 2.0]", "[-1.0, 2.0]", "noise = -1.0"),
        ("identification", '"lti"', '"arx"', "unknown model 'arx'"),
        ("identification", 'held_out = ["multisine"]', "", "held_out is missing"),
        ("identification", '"multisine"', '"multisin"', "did you mean 'multisine'"),
        ("identification", "order = 2", "order = 2.5", "order = 2.5"),
        ("identification", "order = 2", "order = 2\nnoise = 1.0", "leave it out: it is varied"),
        ("identification", 'inputs = ["u"]', 'inputs = "u"', "expected a list of texts"),
        ("identification", '["v"]', '["w"]', "unknown output 'w'"),
        ("identification", '"welding-robot"', '"my_plant.py:MINE"', "unknown machine with experiments"),
        ("pid-design", "v = 0.2", "w = 0.2", "outputs and set-points differ: v, w"),
        ("pid-design", "[fixed.run]\nduration = 5.0\n", "", "duration"),
        ("pid-design", "order = 2\n", "order = 2\n[fixed.low]\nF = 1.0\n", "'F'"),
        ("pid-design", "1.3, 1.8", "0.9, 1.8", "peak = 0.9"),
        ("detection", ":level", ":width", "is a shape"),
        ("detection", "coulomb@rail", "coulomb@track", "coulomb@rail:level"),
        ("detection", 'effect = "coulomb@rail:level"', "", "effect is missing"),
    ],
)
def test_what_a_file_asks_wrongly_is_refused_with_its_place(name, old, new, message, tmp_path, capsys):
    text = ASKED[name]
    assert old in text
    (tmp_path / "s.toml").write_text(text.replace(old, new))
    assert main(["sweep", str(tmp_path / "s.toml"), "--out", str(tmp_path / "o")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def test_a_controller_on_the_command_line_belongs_to_closed_loops_alone(tmp_path, capsys):
    for name, text in ASKED.items():
        (tmp_path / "s.toml").write_text(text)
        assert main(["sweep", str(tmp_path / "s.toml"), "--out", str(tmp_path / name), "--controller", "pid.json"]) == 2
        assert "--controller belongs to closed loops" in capsys.readouterr().err


def test_experiments_that_are_not_there_are_refused():
    with pytest.raises(InputError, match="unknown experiment of welding-robot 'pbs'"):
        Recorded("welding-robot", ("pbs",))
    with pytest.raises(InputError, match="no experiments"):
        Recorded("welding-robot", ())
