"""Inputs that were measured while they moved, and inputs that were held, told apart."""

import json
from dataclasses import replace

import numpy as np
import pytest

from plants import POSITIONING_AXIS, WEB_WINDING
from studies.experiments import plan
from tests.workbench.diagnosis.cases import READING, axis_records
from workbench.data import Dataset, Experiment
from workbench.diagnosis import courses
from workbench.diagnosis.answer import Finding
from workbench.diagnosis.calibrate import calibrate
from workbench.diagnosis.diagnosis import diagnose
from workbench.diagnosis.predictor import predictor
from workbench.diagnosis.recalibrate import recalibrated
from workbench.diagnosis.refit import Model
from workbench.errors import InputError
from workbench.physics.extension import extension, load_extension
from workbench.simulation import simulate

AXIS = replace(POSITIONING_AXIS, dt=0.02, substeps=4, noise={"q": READING})
UNITS = {"F": "N", "q": "m"}
FINE = 50  # steps of the machine to a sample


def records(seed, *, held, samples=500, count=2, friction=0.0):
    """M v' = F - Fv v - friction tanh(v / 1 mm/s), by Euler steps; F: sines up to a fifth of the sampling rate, or what a
    digital to analogue converter makes of them.
    """
    random, made = np.random.default_rng(seed), []
    M, Fv, h = 100.0, 180.0, AXIS.dt / FINE
    for i in range(count):
        t = h * np.arange(samples * FINE)
        waves = zip(random.uniform(0.3, 10.0, 12), random.uniform(0.0, 6.0, 12), strict=True)
        F = np.sum([80.0 * np.sin(2.0 * np.pi * f * t + turn) for f, turn in waves], axis=0)
        F = np.repeat(F[::FINE], FINE) if held else F
        q, v, way = 0.0, 0.0, []
        for k in range(len(t)):
            way.append(q)
            v += h * (F[k] - Fv * v - friction * np.tanh(v / 1e-3)) / M
            q += h * v
        y = np.array(way)[::FINE] + READING * random.standard_normal(samples)
        made.append(Experiment.from_arrays(f"axis {i}", AXIS.dt, inputs={"F": F[::FINE]}, outputs={"q": y}, units=UNITS))
    return Dataset(tuple(made))


def fitted(data, plant=AXIS):
    done = recalibrated(predictor(plant, data))
    return Model(done.predictor, done.fit)


def followed(model):
    return courses.followed(model, np.zeros(len(model.predictor.plant.slots)))


@pytest.mark.parametrize("seed", range(4))
def test_a_force_that_was_measured_while_it_moved_is_told_from_one_that_was_held(seed, monkeypatch):
    moved = followed(fitted(records(seed, held=False)))
    assert moved is not None
    assert moved.predictor.plant.between == {"F": "spline"}
    p = dict(zip((q.name for q in AXIS.parameters), moved.fit.point.p, strict=True))
    assert p["M"] == pytest.approx(100.0, rel=0.01)
    monkeypatch.setattr(courses, "_with", None)  # nor need anything be compiled for that
    assert followed(fitted(records(seed, held=True))) is None


def test_what_the_plant_says_is_not_asked_again():
    plant = replace(AXIS, between={"F": "held"})
    assert followed(fitted(records(0, held=False), plant)) is None


def test_an_input_that_stands_in_many_samples_is_not_asked(monkeypatch):
    model = fitted(axis_records(1, samples=300))
    monkeypatch.setattr(courses, "_with", None)
    assert followed(model) is None


@pytest.mark.slow
def test_a_diagnosis_finds_what_is_there_and_hands_it_on(tmp_path):
    """Held, the same records are half a sample late, which is named as something else."""
    for friction, finding, keys in ((0.0, Finding.NOTHING, []), (15.0, Finding.NAMED, ["coulomb@slide"])):
        own, other = (records(s, held=False, samples=800, friction=friction) for s in (20, 21))
        found = diagnose(AXIS, own, other)
        assert (found.finding, [c.key for c in found.causes], found.between) == (finding, keys, {"F": "spline"})
        assert any(note.startswith("F goes on as a spline between samples") for note in found.notes)
    late = diagnose(replace(AXIS, between={"F": "held"}), own, other)
    assert [c.key for c in late.causes] != ["coulomb@slide"] or late.finding is not Finding.NAMED
    followed_axis = replace(AXIS, between=found.between)
    path = extension(followed_axis, "positioning-axis", found.parameters, found.effects).save(tmp_path / "extended.json")
    assert load_extension(path).of(AXIS).between == {"F": "spline"}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4])
def test_a_slow_sensor_is_not_made_up_for_by_inputs_that_go_on(seed):
    """Of two drives whose commands are held: beside the recalibrated plant an early voltage is likelier than a held one."""
    made = [
        simulate(WEB_WINDING, todo.controller, todo.scenario(seed), effects={"sensor-lag@theta": {"time": 0.03}}).experiment
        for todo in (plan("web-winding", name) for name in ("prbs1", "rbs"))
    ]
    found = diagnose(WEB_WINDING, Dataset(tuple(made)))
    assert found.between == {}
    assert [c.key for c in found.causes] == ["sensor-lag@theta"]


def test_a_calibration_takes_what_the_plant_says():
    done = calibrate(replace(AXIS, between={"F": "spline"}), records(3, held=False))
    assert done.plant.between == {"F": "spline"}
    assert done.values["M"] == pytest.approx(100.0, rel=0.01)
    assert calibrate(AXIS, records(3, held=False)).values["M"] != pytest.approx(100.0, rel=0.01)


def test_a_plant_file_with_a_course_that_is_none_is_refused(tmp_path):
    made = extension(AXIS, "positioning-axis", {})
    path = replace(made, between={"F": "cubic"}).save(tmp_path / "a.json")
    with pytest.raises(InputError, match="'cubic' between samples"):
        load_extension(path).of(AXIS)
    path.write_text(json.dumps({**json.loads(path.read_text()), "between": "cubic"}))
    with pytest.raises(InputError, match="between"):
        load_extension(path)
