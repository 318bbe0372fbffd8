"""One law or two: where an input is a force, friction that differs by direction is Coulomb friction and an offset of the input.

The records are simulated by hand: friction is a force written here, not the workbench's effect.
"""

import numpy as np
import pytest

from tests.workbench.diagnosis.cases import AXIS, axis_by_hand, steps
from workbench.data import Dataset
from workbench.diagnosis.diagnosis import diagnose

ONE, TWO = "asymmetric-friction@slide", "coulomb@slide + offset@F"
WIDTH = 0.001  # m/s: next to nothing, at rest the two differ by what the law is short of one that sticks


def records(seeds, force):
    """Records of the axis with a force of its speed [N]."""
    made = []
    for seed in seeds:
        commands = steps(600, 300.0, seed, hold=15)
        made.append(axis_by_hand(lambda k, y, F=commands: F[k], seed, extra=lambda q, v: force(v)))
    return Dataset(tuple(made))


def named(seed, force):
    found = diagnose(AXIS, records((seed, seed + 1), force), records((seed + 2,), force))
    return {cause.key: cause for cause in found.causes}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 21, 31, 61, 71])
@pytest.mark.parametrize(("forward", "backward"), [(60.0, 20.0), (15.0, 45.0)])
def test_friction_of_each_direction_ties_with_plain_friction_and_an_offset(seed, forward, backward):
    """Either of the two is written: forward and backward are 40 -+ 20 and an offset of that sign, and the answer is the same."""
    level, push = 0.5 * (forward + backward), 0.5 * (backward - forward)
    by_direction = named(seed, lambda v: -(forward if v > 0.0 else backward) * np.tanh(v / WIDTH))
    by_offset = named(seed, lambda v: push - level * np.tanh(v / WIDTH))
    for causes in (by_direction, by_offset):
        assert list(causes) == [ONE]
        assert 0.01 < causes[ONE].ties[TWO] < 0.99
        for name, true in (("forward", forward), ("backward", backward)):
            size = causes[ONE].parameters[name]
            assert abs(size.value - true) < 3.0 * (size.high - size.low) / (2 * 1.96)


@pytest.mark.slow
def test_friction_cannot_drive_so_that_an_offset_above_it_has_one_reading():
    causes = named(41, lambda v: 50.0 - 20.0 * np.tanh(v / WIDTH))
    assert set(causes) == {"coulomb@slide", "offset@F"}
    assert not any(" + " in key for cause in causes.values() for key in cause.ties)


@pytest.mark.slow
def test_plain_friction_is_no_sum():
    (cause,) = named(51, lambda v: -40.0 * np.tanh(v / WIDTH)).values()
    assert cause.effect == "coulomb"
    assert not any(" + " in key for key in cause.ties)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [81, 91])
def test_two_laws_that_add_up_to_a_third_one_are_not_sure(seed):
    """Drag by the cube of the speed: no law of the catalogue, and two of them come close together."""
    causes = named(seed, lambda v: -15.0 * v**3)
    assert all(cause.doubt for cause in causes.values())


@pytest.mark.slow
@pytest.mark.parametrize("seed", [101, 111])
def test_two_laws_at_one_place_are_told_where_both_are_there(seed):
    """Each by itself, or together as the rival of one that stands for both: no other name is sure."""
    causes = named(seed, lambda v: -40.0 * np.tanh(v / WIDTH) - 25.0 * v * abs(v))
    true = ("coulomb@slide", "quadratic-friction@slide")
    told = set(true) <= set(causes) or any(" + ".join(true) in cause.ties for cause in causes.values())
    assert told
    assert all(cause.doubt for key, cause in causes.items() if key not in true and not cause.ties)
