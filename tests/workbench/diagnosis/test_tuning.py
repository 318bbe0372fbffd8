"""Noise levels that are known, and the maximum of the likelihood found by a search without slopes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from tests.workbench.diagnosis.cases import AXIS, PUSH, READING, axis_by_hand, axis_predictor, axis_records, noise
from workbench.data import Dataset
from workbench.diagnosis.kalman import likelihood
from workbench.diagnosis.predictor import Noise, predictor
from workbench.diagnosis.tuning import tuned

M = AXIS.nominal[0]


def white(data, push=1.0, reading=1.0):
    """A predictor without coloured pushes, at these multiples of the true levels."""
    made = predictor(AXIS, data, drift=False)
    return made.regained(made.point, Noise(np.array([reading * READING]), np.array([push * PUSH / M]), np.empty(0)))


def coloured(made, level, memory):
    return made.regained(made.point, replace(made.noise, drift=np.array([level]), memory=memory))


def deviance_at(made, levels):
    made = made.regained(made.point, levels)
    return sum(np.sum(e**2) for e in made.at(made.point)) + sum(w.log_det for w in made.passes)


@pytest.mark.slow
def test_levels_are_found_within_their_statistical_error():
    found = []
    for seed in range(12):
        made = white(Dataset((axis_by_hand(lambda k, y: 0.0, 100 + seed),)), 3.0, 0.2)
        levels = tuned(made)
        found.append([levels.measurement[0] / READING, levels.process[0] / (PUSH / M)])
    logs = np.log(found)
    # 600 samples give a level to some 4 % (reading) and 8 % (push)
    assert np.abs(logs.mean(axis=0)) == pytest.approx(0.0, abs=0.05)
    assert np.abs(logs).max() < 0.3


@pytest.mark.parametrize(("push", "reading"), [(1.0, 1.0), (30.0, 1.0), (1 / 30, 1.0), (1.0, 10.0), (1.0, 0.1), (1e-6, 3.0)])
def test_from_wherever_it_starts_it_ends_where_the_likelihood_has_its_maximum(push, reading):
    made = white(axis_records(6), push, reading)
    raw = [
        made.errors(i, AXIS.nominal[None], made.point.eta[i : i + 1], made.point.start[i : i + 1], white=False)[0] for i in (0, 1)
    ]

    def cost(logs):
        s = np.exp(logs)
        return sum(likelihood(q, s[:1], s[1:], w.gain, e).deviance for q, w, e in zip(made.lines, made.passes, raw, strict=True))

    found = tuned(made)
    best = minimize(cost, np.log([PUSH / M, READING]), method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-4}).fun
    assert cost(np.log([found.process[0], found.measurement[0]])) < best + 0.5  # what is expected pulls a little


@pytest.mark.slow
@pytest.mark.parametrize(("level", "memory"), [(0.01, 0.3), (1e-6, 0.1), (0.2, 3.0)])
def test_a_push_that_lasts_is_told_from_a_white_one(level, memory):
    found = []
    for seed in range(4):
        random, slow = np.random.default_rng(seed), np.zeros(1500)
        for k in range(1, 1500):
            slow[k] = np.exp(-AXIS.dt / 0.5) * slow[k - 1] + 4.0 * random.standard_normal()
        made = axis_predictor(axis_records(40 + seed, samples=1500, unlogged=slow, records=1))
        levels = tuned(coloured(made, level, memory))
        found.append(levels.drift[0])
        truth = replace(noise(), drift=np.array([4.0 / M]), memory=0.5)
        assert deviance_at(made, levels) < deviance_at(made, truth) + 3.0
    assert np.mean(found) == pytest.approx(4.0 / M, rel=0.3)
    assert deviance_at(made, noise()) > deviance_at(made, levels) + 100.0  # a white push does not explain it


@pytest.mark.slow
@pytest.mark.parametrize("loud", [2.0, 6.0])
def test_noise_of_a_sensor_that_lasts_is_told_from_white_noise_and_from_a_push(loud):
    found, a = [], np.exp(-AXIS.dt / 0.15)
    for seed in range(4):
        record = axis_by_hand(lambda k, y: 0.0, 300 + seed, coloured=loud * READING, correlation_time=0.15, samples=1500)
        made = axis_predictor(Dataset((record,)))
        white = replace(tuned(made), coloured=np.zeros(1))
        begin = replace(made.noise, coloured=np.array([0.1 * READING]), correlation_time=0.05)
        made = replace(made, expected=begin).regained(made.point, begin)
        levels = tuned(made)
        truth = replace(noise(), coloured=np.array([loud * READING * np.sqrt(1.0 - a**2)]), correlation_time=0.15)
        assert deviance_at(made, levels) < deviance_at(made, truth) + 3.0
        assert deviance_at(made, levels) < deviance_at(made, white) - 40.0
        found.append([levels.measurement[0] / READING, levels.process[0] / (PUSH / M)])
    assert np.abs(np.mean(np.log(found), axis=0)) == pytest.approx(0.0, abs=0.15)


def test_begun_again_from_levels_that_were_found_it_ends_where_it_ended():
    slow = np.cumsum(np.random.default_rng(3).standard_normal(1500)) * 0.3
    made = axis_predictor(axis_records(50, samples=1500, unlogged=slow, records=1))
    found = tuned(made)
    nearly = replace(found, process=0.8 * found.process, drift=1.3 * found.drift)
    again = tuned(made.with_noise(nearly), again=True)
    assert deviance_at(made, again) == pytest.approx(deviance_at(made, found), abs=1.0)
    assert deviance_at(made, nearly) > deviance_at(made, found) + 1.0


def test_a_level_that_the_records_do_not_tell_stays_as_expected():
    """A push a thousand times smaller than what the readings could show."""
    quiet = replace(AXIS, disturbance={})
    made = white(axis_records(8, plant=quiet))
    made = made.regained(replace(made.point, start=np.zeros((2, 2))))
    expected = Noise(np.array([READING]), np.array([1e-4 * PUSH / M]), np.empty(0))
    levels = tuned(replace(made, expected=expected).regained(made.point, expected))
    assert 0.3 < levels.process[0] / expected.process[0] < 3.0
    assert levels.measurement[0] == pytest.approx(READING, rel=0.15)
