"""Long records: their beginnings are searched if they show what the records show, and the whole where they do not tell all."""

from dataclasses import replace

import numpy as np
import pytest

from tests.workbench.diagnosis.test_courses import AXIS, UNITS
from workbench.data import Dataset, Experiment
from workbench.diagnosis import beginnings, diagnosis
from workbench.diagnosis.answer import Finding
from workbench.diagnosis.predictor import predictor
from workbench.diagnosis.recalibrate import recalibrated
from workbench.diagnosis.refit import Model

FINE = 50  # steps of the machine to a sample


def axis(seed, samples=3000, friction=(0.0, 0.0), name="axis"):
    """M v' = F - Fv v - friction sign(v), by Euler steps; F: sines, held; friction changes half way."""
    random, M, Fv, h = np.random.default_rng(seed), 100.0, 180.0, AXIS.dt / FINE
    waves = zip(random.uniform(0.4, 4.0, 8), random.uniform(0.0, 6.0, 8), strict=True)
    F = np.sum([40.0 * np.sin(2.0 * np.pi * f * AXIS.dt * np.arange(samples) + turn) for f, turn in waves], axis=0)
    q, v, way = 0.0, 0.0, []
    for k in range(samples):
        way.append(q)
        level = friction[2 * k // samples]
        for _ in range(FINE):
            before = v
            v += h * (F[k] - Fv * v - level * np.tanh(v / 1e-3)) / M
            q += h * (before + v) / 2.0
    y = np.array(way) + 2e-5 * random.standard_normal(samples)
    return Experiment.from_arrays(name, AXIS.dt, inputs={"F": F}, outputs={"q": y}, units=UNITS)


def shaped(u, y=None):
    return Experiment.from_arrays("r", AXIS.dt, inputs={"F": u}, outputs={"q": u if y is None else y}, units=UNITS)


@pytest.fixture
def short(monkeypatch):
    monkeypatch.setattr(beginnings, "LONG", 2000)
    monkeypatch.setattr(diagnosis, "SEARCHED", 1000)


def searched(*records):
    return [len(e) for e in beginnings.beginnings(AXIS, Dataset(records), 1000)]


def test_records_that_are_not_long_are_taken_as_they_are():
    data = Dataset((axis(1, samples=500),))
    assert beginnings.beginnings(AXIS, data, 1000) is data


def test_records_share_what_is_searched(short):
    random = np.random.default_rng(0)
    own = searched(*(replace(shaped(random.uniform(-1.0, 1.0, n)), name=str(n)) for n in (6000, 2000, 2000)))
    assert own == [600, 500, 500]


@pytest.mark.parametrize(
    ("what", "last"),
    [
        ("a step late in a record at rest", 3500),
        ("a sweep that begins slowly", 2500),
        ("a spike, and motion that comes later", 2500),
        ("a slow ramp", 3900),
    ],
)
def test_a_beginning_shows_what_the_record_shows(short, what, last):
    k, random = np.arange(5000), np.random.default_rng(0)
    quiet = 0.01 * random.standard_normal(5000)
    signals = {
        "a step late in a record at rest": quiet + (k > 3500),
        "a sweep that begins slowly": np.sin(1e-4 * k**2),
        "a spike, and motion that comes later": quiet + 3.0 * (k == 5) + np.where(k > 2500, random.standard_normal(5000), 0.0),
        "a slow ramp": 10.0 * k / 5000 + quiet,
    }
    assert searched(shaped(signals[what]))[0] > last


def test_a_friction_is_found_in_the_beginning_and_the_rest_is_only_looked_at(short):
    said, data = [], Dataset((axis(4, friction=(20.0, 20.0)),))
    part = beginnings.beginnings(AXIS, data, 1000)
    assert len(part.experiments[0]) < 1500
    other = Dataset((axis(5, friction=(20.0, 20.0), name="other"),))
    found = diagnosis.diagnose(AXIS, data, other, progress=said.append)
    assert [c.key for c in found.causes] == ["coulomb@slide"]
    assert found.causes[0].parameters["level"].value == pytest.approx(20.0, rel=0.05)
    assert "again, in more of the records" not in said
    (note,) = [n for n in found.notes if n.startswith("searched in")]
    assert note.startswith(f"searched in {len(part.experiments[0])} of 3000 samples")
    assert f"axis to {part.experiments[0].t[-1]:.4g} s" in note
    assert any(n.startswith("gains are those of 1000 of 3000 samples") for n in found.notes)


def test_a_friction_that_sets_in_later_is_not_missed(short):
    """The machine is as its plant in all that is searched at first: "nothing is missing" is tried on what follows."""
    said, data = [], Dataset((axis(5, friction=(0.0, 20.0)),))
    assert len(beginnings.beginnings(AXIS, data, 1000).experiments[0]) < 1500
    found = diagnosis.diagnose(AXIS, data, progress=said.append)
    assert "again, in more of the records" in said
    assert found.finding is Finding.NAMED
    assert [c.key for c in found.causes] == ["friction-jump@slide"]
    assert found.causes[0].parameters["time"].value == pytest.approx(30.0, abs=0.5)
    assert not any("searched in" in n for n in found.notes)  # it was all


def test_what_no_one_looked_at_is_said(short, monkeypatch):
    monkeypatch.setattr(diagnosis, "LOOKED_AT", 2100)
    found = diagnosis.diagnose(AXIS, Dataset((axis(5),)))
    assert found.finding is Finding.NOTHING
    assert any(
        n.startswith("looked at 2100 of 3000 samples") and n.endswith("nothing is said of what follows") for n in found.notes
    )


def test_a_run_that_is_lost_in_what_follows_is_more(monkeypatch):
    data = Dataset((axis(5, samples=800),))
    done = recalibrated(predictor(AXIS, data))
    model, sizes = Model(done.predictor, done.fit), np.zeros(len(AXIS.slots))
    assert not beginnings.tells_more(model, sizes, data)
    lost = replace(model.fit, errors=[np.full_like(e, np.nan) for e in model.fit.errors])
    monkeypatch.setattr(beginnings, "gauss_newton", lambda *_, **__: lost)
    assert beginnings.tells_more(model, sizes, data)


def test_short_records_are_whole_and_records_that_begin_alike_are_too(short):
    random = np.random.default_rng(0)
    many = [replace(shaped(random.uniform(-1.0, 1.0, 400)), name=str(k)) for k in range(30)]
    assert beginnings.beginnings(AXIS, (data := Dataset(tuple(many))), 1000) is data
    u = random.uniform(-1.0, 1.0, 3000)
    late = u.copy()
    late[2500:] *= 1.1
    twins = Dataset((replace(shaped(u), name="good"), replace(shaped(late), name="fault")))
    assert beginnings.beginnings(AXIS, twins, 1000) is twins
