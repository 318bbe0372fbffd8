"""An offset and a parameter far from its data sheet explain the same: no record tells them apart, the data sheet does."""

import numpy as np
import pytest

from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis.answer import Finding
from workbench.diagnosis.diagnosis import diagnose
from workbench.physics.parameters import Parameter
from workbench.physics.plant import Plant

DT = 0.5
OVEN = Plant(
    name="oven",
    states=(Channel("T", "degC"),),
    inputs=(Channel("duty", "%", "input"),),
    outputs=(Channel("T", "degC", "output"),),
    parameters=(
        Parameter("C", 30.0, "J/K", tolerance=0.2, meaning="heat of the oven"),
        Parameter("P", 2.0, "W/%", tolerance=0.03, meaning="power of its heater"),
        Parameter("G", 1.2, "W/K", tolerance=0.1, meaning="heat that is lost"),
        Parameter("Ta", 21.0, "degC", tolerance=0.05, meaning="temperature of the room"),
    ),
    equation=lambda x, u, p, at: {"T": (p.P * u.duty - p.G * (x.T - p.Ta)) / p.C},
    measure=lambda x, p: {"T": x.T},
    dt=DT,
    noise={"T": 0.1},
)


def records(seed, *, offset=0.0, room=21.0, count=3) -> Dataset:
    """Steps of the heater; the oven itself by the exact solution of its equation from sample to sample."""
    random, made = np.random.default_rng(seed), []
    C, P, G = 30.0 * random.uniform(0.9, 1.1), 2.0 * random.uniform(0.98, 1.02), 1.2 * random.uniform(0.95, 1.05)
    kept = np.exp(-G * DT / C)
    for i in range(count):
        duty = np.repeat(random.uniform(25.0, 80.0, 12), 60)
        T, rows = room + P * (duty[0] + offset) / G, []
        for u in duty:
            rows.append((u, T + 0.1 * random.standard_normal()))
            T = kept * T + (1.0 - kept) * (room + P * (u + offset) / G)
        channels = (Channel("duty", "%", "input"), Channel("T", "degC", "output"))
        made.append(Experiment(f"oven {i}", DT * np.arange(len(duty)), channels, np.array(rows), DT))
    return Dataset(tuple(made))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("offset", [-5.0, 5.0])
def test_an_offset_is_named_though_a_room_of_another_temperature_explains_the_same(seed, offset):
    data = records(seed, offset=offset)
    found = diagnose(OVEN, Dataset(data.experiments[:2]), Dataset(data.experiments[2:]))
    assert found.finding is Finding.NAMED
    (cause,) = found.causes
    assert "offset@duty" in (cause.key, *cause.ties)
    assert any("takes the place of a parameter" in note and "Ta (temperature of the room)" in note for note in found.notes)
    assert found.parameters["Ta"] == pytest.approx(21.0, rel=0.06)


@pytest.mark.parametrize("seed", range(3))
def test_who_reads_of_a_cause_reads_that_it_may_be_the_room(seed):
    data = records(seed, room=11.0)
    found = diagnose(OVEN, Dataset(data.experiments[:2]), Dataset(data.experiments[2:]))
    assert any("Ta (temperature of the room) is 1" in said for said in (*found.notes, *found.signs))


@pytest.mark.parametrize("room", [20.3, 21.0, 21.8])
def test_a_room_within_its_tolerance_is_no_offset(room):
    data = records(5, room=room)
    found = diagnose(OVEN, Dataset(data.experiments[:2]), Dataset(data.experiments[2:]))
    assert found.finding is Finding.NOTHING
    assert not found.causes
