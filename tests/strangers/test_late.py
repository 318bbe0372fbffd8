"""Sensors that are late behind a machine whose own time constant can make up for them: the search is not led astray."""

import numpy as np
import pytest

from tests.hidden.catalogue import Hidden
from tests.strangers.case import HELD_OUT, RECORDS, _Bench, setting
from tests.strangers.registry import MACHINES
from workbench.data import Dataset
from workbench.diagnosis.diagnosis import diagnose

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("seed", "key", "numbers"),
    [
        (53000016, "sensor-resonance@air", {"time": 1.3, "damping": 0.15}),
        (53000044, "sensor-lag@air", {"time": 2.1}),
        (21, "sensor-resonance@air", {"time": 1.0, "damping": 0.2}),
        (22, "sensor-lag@air", {"time": 1.8}),
    ],
)
def test_a_late_sensor_is_found_though_a_time_constant_has_made_up_for_it(seed, key, numbers):
    machine = MACHINES["heater"]
    bench = _Bench(setting(machine, np.random.default_rng([seed, 2])), seed)
    effect, place = key.split("@")
    records = bench.logged(bench.run((Hidden(effect, place, numbers, 5.0),)))
    assert len(records) == RECORDS + HELD_OUT
    found = diagnose(machine.plant, Dataset(records[:RECORDS]), Dataset(records[RECORDS:]))
    (cause,) = (c for c in found.causes if c.effect != "quantisation")
    assert key in (cause.key, *cause.ties)
    if cause.key == key:
        time = cause.parameters["time"]
        assert time.low < numbers["time"] < time.high
