"""A machine that moves a thousand times slower, with forces and noise as much smaller, is the same machine to a diagnosis.

x+ = A x + B (F + d) is linear: with F, d, the noise and the speeds of its friction times a factor, so are all records.
"""

from dataclasses import replace

import numpy as np
import pytest

from tests.workbench.diagnosis.cases import AXIS, PUSH, READING, axis_by_hand, steps
from workbench.data import Dataset
from workbench.diagnosis.diagnosis import diagnose

FADING = {"level": 60.0, "speed": 0.1}  # N, m/s
WIDTH = 0.002  # m/s


def fading(v):
    return -FADING["level"] * np.exp(-((v / FADING["speed"]) ** 2)) * np.tanh(v / WIDTH)


def records(seeds, factor, force):
    """Records of the axis with a force of its speed, all lengths and forces times `factor`."""
    made = []
    for seed in seeds:
        commands = steps(600, 300.0, seed, hold=15)
        e = axis_by_hand(lambda k, y, F=commands: F[k], seed, extra=lambda q, v: force(v))
        made.append(replace(e, values=factor * e.values))
    return Dataset(tuple(made))


def diagnosed(seed, factor, force):
    plant = replace(AXIS, noise={"q": factor * READING}, disturbance={"F": factor * PUSH})
    return diagnose(plant, records((seed, seed + 1), factor, force), records((seed + 2,), factor, force))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("force", "key", "true"),
    [(fading, "stribeck@slide", FADING), (lambda v: 25.0, "offset@F", {"level": 25.0})],
    ids=["friction", "offset"],
)
@pytest.mark.parametrize("seed", [11, 21])
def test_an_effect_is_found_in_any_unit(seed, force, key, true):
    gains = []
    for factor in (1e-3, 1.0, 1e4):
        (cause,) = diagnosed(seed, factor, force).causes
        assert cause.key == key
        gains.append(cause.evidence.delta_bic)
        for name, value in true.items():
            size = cause.parameters[name]
            assert abs(size.value - factor * value) < 3.0 * (size.high - size.low) / (2 * 1.96)
    assert np.ptp(gains) < 0.02 * max(gains)
