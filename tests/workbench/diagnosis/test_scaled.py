"""A machine that moves a thousand times slower, with forces and noise as much smaller, is the same machine to a diagnosis.

x+ = A x + B (F + d) is linear: with F, d, the noise and the speeds of its friction times a factor, so are all records.
"""

from dataclasses import replace

import numpy as np
import pytest

from tests.workbench.diagnosis.cases import AXIS, PUSH, READING, axis_by_hand, axis_predictor, axis_records, steps
from workbench.data import Dataset
from workbench.diagnosis.diagnosis import diagnose
from workbench.diagnosis.fit import gauss_newton
from workbench.diagnosis.recalibrate import unknowns
from workbench.diagnosis.screen import small_sizes

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


def stepped(effects, **options):
    """Sizes of steps by the key of the effect, of the axis' records under these effects."""
    predictor = axis_predictor(axis_records(3, effects, **options))
    own = unknowns(predictor)
    fit = gauss_newton(predictor, own, own.zero(), np.zeros(len(AXIS.slots)))
    return {f"{s.key}:{s.parameter.name}": size for s, size in zip(AXIS.slots, small_sizes(predictor, fit), strict=True)}


@pytest.mark.parametrize("first", [0.0, 0.02, 1.0])
def test_a_record_in_which_nothing_shows_makes_no_step_larger(first):
    """Two records under forces of 300 N, and a gentle one before them: whatever shows in any of them sets the step."""
    lively = axis_records(3)
    gentle = replace(lively, experiments=(*axis_records(7, records=1, force=first), *lively))
    sizes = {}
    for name, data in (("lively", lively), ("gentle", gentle)):
        predictor = axis_predictor(data)
        own = unknowns(predictor)
        sizes[name] = small_sizes(predictor, gauss_newton(predictor, own, own.zero(), np.zeros(len(AXIS.slots))))
    regular = [not s.parameter.shape and s.effect.regular for s in AXIS.slots]
    ratio = sizes["gentle"][regular] / sizes["lively"][regular]
    assert np.all((ratio > 1e-2) & (ratio < 1e2))


def test_steps_stay_within_the_bounds_and_dates_within_the_record():
    for key, size in stepped(None).items():
        q = next(s.parameter for s in AXIS.slots if f"{s.key}:{s.parameter.name}" == key)
        assert 0.0 <= size <= 0.5 * q.high
    assert stepped(None)["friction-jump@slide:level"] < 1e3  # of records of 6 s, though a jump is at 10 s by default


@pytest.mark.slow
def test_a_jump_in_records_that_are_shorter_than_its_usual_date_is_found():
    true = {"level": 60.0, "width": 0.002, "time": 3.0}
    (cause,) = diagnose(AXIS, axis_records(3, {"friction-jump@slide": true}, samples=300)).causes
    assert cause.key == "friction-jump@slide"
    assert cause.parameters["level"].low < 60.0 < cause.parameters["level"].high


@pytest.mark.slow
@pytest.mark.parametrize("place", ["first", "last"])
def test_a_gentle_record_hides_nothing_wherever_it_stands(place):
    effects = {"quadratic-friction@slide": {"coefficient": 300.0}}
    lively = [*axis_records(1, effects)]
    (gentle,) = axis_records(7, effects, records=1, force=0.02)
    gentle = replace(gentle, name="gentle")
    found = diagnose(AXIS, Dataset((gentle, *lively) if place == "first" else (*lively, gentle)))
    assert [cause.key for cause in found.causes] == ["quadratic-friction@slide"]
