"""The zoo's own detection limits, against the same numbers from dense matrices where the noise is known to be white."""

import numpy as np
import pytest

from tests.strangers import conical_tank
from tests.strangers.bench import Run, run
from tests.strangers.case import _Bench, setting
from tests.strangers.yardstick import FIVE_SIGMA, SIZES, Tried, _crossing, limits

TANK = conical_tank.STRANGER


@pytest.fixture(scope="module")
def bench():
    s = setting(TANK, np.random.default_rng(4))
    quiet = {"colour": 0.0, "push": 0.0 * s.push, "resolution": (0.0,), "noise": np.array([0.1]), "one_way": False}
    return _Bench(s._replace(dt=0.1, samples=250, closed=False, **quiet), 4)


def shown(bench, log, acting):
    """D of an effect from dense matrices: white noise of 0.1, parameters as their tolerance allows, the start free."""
    s = bench.s

    def alone(r, numbers=None, acts=None, start=0.0):
        what = Run(s.dt, s.samples, commands=log.commands[:, :, r : r + 1])
        return run(
            TANK, dict(s.numbers) | (numbers or {}), acts or {}, log.states[0, :, r : r + 1] + start, what
        ).measured.ravel()

    A, b, c = np.eye(len(TANK.plant.parameters)), 0.0, 0.0
    for r in range(log.states.shape[2]):
        y = alone(r)
        moves = [q.tolerance / np.sqrt(3.0) * s.numbers[q.name] for q in TANK.plant.parameters]
        S = np.column_stack(
            [
                (alone(r, {q.name: s.numbers[q.name] + 0.01 * m}) - y) / 0.01
                for q, m in zip(TANK.plant.parameters, moves, strict=True)
            ]
        )
        start = alone(r, start=1e-4) - y
        free = np.eye(len(y)) - np.outer(start, start) / (start @ start)
        S, d = free @ S / 0.1, free @ (alone(r, acts=acting) - y) / 0.1
        A, b, c = A + S.T @ S, b + S.T @ d, c + d @ d
    return c - b @ np.linalg.solve(A, b)


@pytest.mark.slow
@pytest.mark.parametrize("key", ["offset@pump", "sensor-gain@level"])
def test_at_its_limit_an_effect_shows_by_five_deviations(bench, key):
    name, top = ("level", 1.0) if key.startswith("offset") else ("error", 0.2)
    log = bench.run((), 2)
    tried = {key: [Tried({key: {name: top * share}}) for share in SIZES]}
    share = limits(TANK, bench.s.numbers, log, bench.s.dt, tried, (0,))[key]
    assert 0.0 < share < 1.0
    assert shown(bench, log, {key: {name: top * share}}) == pytest.approx(FIVE_SIGMA, rel=0.15)


def test_the_limit_grows_with_the_noise_and_what_nothing_moves_has_none(bench):
    key, found = "offset@pump", []
    for noise in (0.05, 0.2):
        one = _Bench(bench.s._replace(noise=np.array([noise])), 4)
        tried = {key: [Tried({key: {"level": share}}) for share in SIZES], "nothing": [Tried()] * len(SIZES)}
        found.append(limits(TANK, one.s.numbers, one.run((), 2), one.s.dt, tried, (0,)))
    assert found[1][key] == pytest.approx(4.0 * found[0][key], rel=0.3)
    assert found[0]["nothing"] == np.inf


def test_what_a_rival_can_mimic_does_not_count(bench):
    key, log = "offset@pump", bench.run((), 2)
    tried = {key: [Tried({key: {"level": share}}) for share in SIZES]}

    def against(*rivals):
        return limits(TANK, bench.s.numbers, log, bench.s.dt, tried, (0,), rivals)[key]

    alone = against()
    assert against(Tried({key: {"level": 0.01}})) > 3.0 * alone  # itself, in another size: only its curvature is left
    assert alone < against(Tried({"sensor-lag@level": {"time": 0.5}})) < 3.0 * alone


def test_the_crossing_lies_between_the_sizes_that_were_tried():
    assert _crossing(FIVE_SIGMA * 9.0 * SIZES**2) == pytest.approx(1.0 / 3.0, rel=1e-6)
    assert _crossing(FIVE_SIGMA * 1e8 * SIZES**2) == pytest.approx(1e-4, rel=1e-6)
    assert _crossing(0.5 * FIVE_SIGMA * SIZES**2) == np.inf
