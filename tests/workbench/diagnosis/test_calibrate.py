"""Calibration: the true parameters are found within their intervals, priors and bounds hold, and what cannot be known is said."""

from dataclasses import replace

import numpy as np
import pytest

from plants import PLANTS
from studies.experiments import plan
from tests.workbench.diagnosis.cases import AXIS, axis_records
from workbench.data import Dataset
from workbench.diagnosis.calibrate import along, calibrate, gains, trajectories
from workbench.diagnosis.gains import HORIZONS, SETTLING, errors
from workbench.errors import InputError
from workbench.simulation import simulate

pytestmark = pytest.mark.slow

ROBOT = PLANTS["welding-robot"]
TRUE = {"m1": 1.1, "b1": 0.35, "c": 3.6, "m2": 2.0, "b2": 0.45}


def drawn(experiment, seed, plant=ROBOT, parameters=TRUE, **options):
    todo = plan("welding-robot", experiment)
    return simulate(plant, todo.controller, todo.scenario(seed), parameters=parameters, **options).experiment.trim(stop=12.0)


@pytest.fixture(scope="module")
def records():
    return Dataset((drawn("prbs", 1), drawn("rbs", 1)))


def test_the_truth_lies_in_the_intervals_of_all_parameters_at_once(records):
    done = calibrate(ROBOT, records)
    assert list(done.values) == ["m1", "m2", "c", "b1", "b2"]
    for p in done.parameters:
        assert p.low < p.value < p.high
        assert p.low <= TRUE[p.name] * 1.0 + 0.5 * (p.high - p.low)  # 95 % each: a miss by half an interval would be a fault
        assert p.high >= TRUE[p.name] * 1.0 - 0.5 * (p.high - p.low)
    m1 = done.parameters[0]
    assert m1.value == pytest.approx(1.1, rel=0.01)
    assert m1.told > 0.9
    assert [q.value for q in done.plant.parameters] == [done.values[q.name] for q in done.plant.parameters]


def test_intervals_hold_the_truth_as_often_as_they_say():
    """12 records with parameters drawn anew: 36 intervals of 95 %; three binomial standard deviations below that is 84 %."""
    random = np.random.default_rng(11)
    inside = []
    for seed in range(12):
        true = {name: q * (1 + 0.1 * random.uniform(-1, 1)) for name, q in (("m1", 1.0), ("b1", 0.3), ("c", 4.0))}
        done = calibrate(ROBOT, Dataset((drawn("rbs", seed, parameters=true).trim(stop=6.0),)), names=tuple(true))
        inside += [p.low <= true[p.name] <= p.high for p in done.parameters]
    assert np.mean(inside) > 0.86


def test_only_named_parameters_move(records):
    done = calibrate(ROBOT, records, names=["b1"])
    assert list(done.values) == ["b1"]
    others = [(q.name, q.value) for q in ROBOT.parameters if q.name != "b1"]
    assert [(q.name, q.value) for q in done.plant.parameters if q.name != "b1"] == others


def test_a_value_beyond_its_tolerance_is_a_warning():
    far = Dataset((drawn("prbs", 2, parameters={"b1": 0.9}),))
    (b1,) = calibrate(ROBOT, far, names=["b1"]).parameters
    assert b1.value == pytest.approx(0.9, rel=0.03)  # a tolerance is a prior, not a wall
    assert "beyond its tolerance of 30 %" in b1.warning


def test_an_effect_of_the_plant_keeps_its_size_and_that_is_said():
    """Masses, damping and friction count as ratios: with the friction held they look better known than they are."""
    rubbing = replace(ROBOT, effects={"coulomb@rail": {"level": 0.5, "width": 0.01}})
    done = calibrate(rubbing, Dataset((drawn("rbs", 3, rubbing),)))
    assert any("coulomb@rail" in sentence and "size" in sentence for sentence in done.warnings)
    assert not any("size" in sentence for sentence in replace(done, plant=ROBOT).warnings)


def test_a_bound_is_a_wall_and_the_others_are_fitted_again(records):
    done = calibrate(ROBOT, records, names=["m1", "b1"], bounds={"m1": (0.9, 1.05)})
    m1, b1 = done.parameters
    assert (m1.value, m1.low, m1.high, m1.held) == (1.05, 1.05, 1.05, True)
    assert "stands at its bound 1.05 kg" in m1.warning
    fixed = replace(ROBOT, parameters=tuple(replace(q, value=1.05) if q.name == "m1" else q for q in ROBOT.parameters))
    (alone,) = calibrate(fixed, records, names=["b1"]).parameters
    assert b1.value == pytest.approx(alone.value, rel=1e-3)
    inactive = calibrate(ROBOT, records, names=["m1", "b1"], bounds={"m1": (0.5, 2.0)})
    assert not inactive.parameters[0].held


def test_a_bound_opens_a_parameter_without_tolerance(records):
    rigid = replace(ROBOT, parameters=tuple(replace(q, tolerance=0.0) for q in ROBOT.parameters))
    done = calibrate(rigid, records, bounds={"m1": (0.5, 1.5)})
    assert list(done.values) == ["m1"]
    assert done.values["m1"] > 1.02


def test_what_these_records_do_not_show_rests_on_the_data_sheet():
    at_rest = drawn("prbs", 1, effects={"saturation@u": {"limit": 1e-3}})
    done = calibrate(ROBOT, Dataset((at_rest,)), names=["b2"])
    (b2,) = done.parameters
    # a record in which nothing moves as commanded tells next to nothing about bearing friction
    assert b2.told < 0.9


def only_together(x, u, p, at):
    return {"v1": p.c * p.b2 * u.u - p.b1 / p.m2 * x.v1, "v2": -x.v2}


def test_parameters_that_only_count_together_are_told():
    parameters = tuple(replace(q, tolerance=0.2) for q in ROBOT.parameters)
    plant = replace(ROBOT, name="only-together", equation=only_together, ports=(), parameters=parameters)
    done = calibrate(plant, Dataset((drawn("rbs", 1, plant, {"c": 4.2}),)), names=["c", "b1", "b2", "m2"])
    assert {pair.sentence.split(":")[0] for pair in done.pairs} == {
        "c and b2 only count as c times b2",
        "m2 and b1 only count as m2/b1",
    }
    assert all(abs(pair.correlation) > 0.99 for pair in done.pairs)


def test_held_out_errors_fall_and_those_of_the_true_plant_are_its_noise(records):
    held = Dataset((drawn("multisine", 5),))
    done = calibrate(ROBOT, records)
    found = {g.horizon: g for g in gains(ROBOT, trajectories(ROBOT, held), trajectories(done.plant, held))}
    assert found["full-run"].after < 0.1 * found["full-run"].before
    for g in found.values():
        assert g.after == pytest.approx(0.002, rel=0.15)  # the sensor's noise
        assert (g.channel, g.unit, g.record) == ("v", "m/s", "multisine")


def test_starts_are_estimated_for_each_record():
    moving = drawn("rbs", 1).trim(start=5.0)
    truth = simulate(ROBOT, plan("welding-robot", "rbs").controller, plan("welding-robot", "rbs").scenario(1), parameters=TRUE)
    done = calibrate(ROBOT, Dataset((moving, drawn("prbs", 1))))
    k = round(5.0 / ROBOT.dt)
    assert done.starts["rbs"]["v1"] == pytest.approx(truth.states["v1"][k], abs=0.01)
    assert done.starts["prbs"]["v1"] == pytest.approx(0.0, abs=0.01)


def test_a_periodic_effect_finds_its_angle_on_each_record():
    winding = PLANTS["web-winding"]
    todo = plan("web-winding", "rgs")
    runs = [
        simulate(winding, todo.controller, todo.scenario(1), effects={"eccentricity@unwind": {"cosine": c, "sine": s}}).experiment
        for c, s in ((2e-4, 0.0), (0.0, -2e-4))
    ]
    extended = replace(winding, effects={"eccentricity@unwind": {"cosine": 2e-4, "sine": 0.0}})
    errors = []
    for plant, e in ((extended, runs[0]), (extended, runs[1]), (winding, runs[1])):
        (t,) = trajectories(plant, Dataset((e.trim(stop=20.0),)))
        errors.append(np.sqrt(np.mean((t.measured - t.predicted)[:, 3] ** 2)))  # the dancer's angle
    assert errors[1] == pytest.approx(errors[0], rel=0.1)
    assert errors[2] > 1.2 * errors[1]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"names": ["m3"]}, "unknown parameter 'm3'"),
        ({"bounds": {"m1": (1.2, 1.4)}}, "does not hold the nominal m1 = 1 kg"),
        ({"bounds": {"m1": (1.4, 0.8)}}, "write --bound m1=0.8:1.4"),
        ({"bounds": {"m1": (1.0, 1.0)}}, "its low end is not below its high end"),
    ],
)
def test_bad_options_are_refused_by_name(records, options, said):
    with pytest.raises(InputError, match=said):
        calibrate(ROBOT, records, **options)


def test_a_parameter_that_nothing_opens_is_refused(records):
    rigid = replace(ROBOT, parameters=tuple(replace(q, tolerance=0.0) for q in ROBOT.parameters))
    with pytest.raises(InputError, match="m1 has no tolerance") as reason:
        calibrate(rigid, records, names=["m1"])
    assert "--bound m1=LOW:HIGH" in reason.value.mend


@pytest.mark.parametrize("step", [0.005, 0.05])
def test_a_plant_that_rounds_its_readings_follows_a_record_as_well_as_one_that_does_not(step):
    """A staircase has no slope: the start of a run was found at the wrong place, and its filter believed the steps."""
    (e,) = axis_records(5, {"quantisation@q": {"step": step}}, samples=600, records=1)
    rounds = replace(AXIS, effects={"quantisation@q": {"step": step}})
    found = {}
    for plant in (AXIS, rounds):
        done = along(plant, Dataset((e,)))
        for horizon in HORIZONS:
            wrong = errors(done.predictor, done.fit.point, 0, horizon)[SETTLING:]
            found.setdefault(horizon, []).append(np.sqrt(np.nanmean(wrong**2)))
    for plain, rounded in found.values():
        assert rounded == pytest.approx(plain, rel=0.01)
