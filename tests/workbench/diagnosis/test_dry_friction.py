"""Dry friction that holds a place where it is: records of an exact set-valued law, fitted by a law that only nearly holds it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.strangers import case, registry
from tests.workbench.diagnosis.cases import AXIS, PUSH, READING
from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis.calibrate import along
from workbench.diagnosis.diagnosis import diagnose
from workbench.diagnosis.domains import shown
from workbench.diagnosis.predictor import FINEST, VISIBLE, Point, _dry_friction, predictor

M, FV = AXIS.nominal
LEVEL = 60.0  # N
SLIDING = replace(AXIS, substeps=4)


def stuck(seed, level, samples=1500, every=100):
    """The axis under slow forces that often do not move it: v of a step is that at which the friction is within its bounds.

    Implicit Euler in steps of dt / every: friction ends the motion wherever it can.
    """
    random = np.random.default_rng(seed)
    t = AXIS.dt * np.arange(samples)
    waves = random.uniform(0.3, 0.7, 4), random.uniform(0.5, 4.0, 4), random.uniform(0.0, 6.0, 4)
    F = sum(2.0 * level * a * np.sin(omega * t + phase) for a, omega, phase in zip(*waves, strict=True))
    acting = F + PUSH * random.normal(size=samples)  # what nobody logged
    h, q, v, seen = AXIS.dt / every, 0.0, 0.0, []
    for k in range(samples):
        seen.append(q)
        for _ in range(every):
            free = v + h / M * (acting[k] - FV * v)
            held = level * h / M
            v = free - held if free > held else free + held if free < -held else 0.0
            q += h * v
    y = np.array(seen) + READING * random.normal(size=samples)
    channels = (Channel("F", "N", "input"), Channel("q", "m", "output"))
    return Experiment(f"stuck {seed}", t, channels, np.column_stack([F, y]), AXIS.dt)


def rubbing(made, key, **numbers):
    """The predictor at a point where the axis rubs."""
    plant, eta = made.plant, made.point.eta.copy()
    for i, slot in enumerate(plant.slots):
        if slot.key == key and slot.parameter.name in numbers:
            eta[:, i] = numbers[slot.parameter.name]
    return replace(made, point=Point(made.point.p, eta, made.point.start))


def test_a_law_is_as_wide_as_a_step_can_follow_and_no_other_number_moves():
    made = predictor(SLIDING, Dataset((stuck(1, LEVEL, samples=50),)))
    place = next(dry.key for dry in _dry_friction(made.plant) if dry.key.startswith("coulomb@"))
    at = rubbing(made, place, level=LEVEL, width=1e-4).point
    soft = made._softened(at.p[None], at.eta[:1], at.start[:1], np.zeros(1))[0]
    (width,) = (dry.width for dry in _dry_friction(made.plant) if dry.key == place)
    assert soft[width] == pytest.approx(np.hypot(1e-4, AXIS.dt / made.substeps * LEVEL / M), rel=1e-9)
    assert np.array_equal(np.delete(soft, width), np.delete(at.eta[0], width))
    calm = made._softened(at.p[None], made.point.eta[:1], at.start[:1], np.zeros(1))
    assert np.array_equal(calm, made.point.eta[:1])


def test_as_many_steps_as_what_stands_still_asks_for():
    made = predictor(SLIDING, Dataset((stuck(2, LEVEL),)))
    assert made.finer().substeps == made.substeps  # nothing rubs there
    place = next(dry.key for dry in _dry_friction(made.plant) if dry.key.startswith("coulomb@"))
    at = rubbing(made, place, level=LEVEL, width=1e-4)
    chosen, most = at.finer(), FINEST * SLIDING.substeps
    assert made.substeps < chosen.substeps <= most
    errors = {s: replace(at, substeps=s).at(at.point)[0] for s in (made.substeps, chosen.substeps, most)}
    assert np.sum((errors[chosen.substeps] - errors[most]) ** 2) < 3.0 * VISIBLE or chosen.substeps == most
    assert np.sum((errors[made.substeps] - errors[most]) ** 2) > VISIBLE


def test_the_likelihood_has_no_chatter_in_it():
    """Along the level its second differences are those of a parabola: what chatters jumps from one value to the next."""
    made = predictor(SLIDING, Dataset((stuck(3, LEVEL),)))
    place = next(dry.key for dry in _dry_friction(made.plant) if dry.key.startswith("coulomb@"))
    made = rubbing(made, place, level=LEVEL, width=1e-5).finer()
    made = made.regained(made.point)
    levels = LEVEL + 0.02 * np.arange(-6, 7)
    squares = np.array([np.sum(made.at(rubbing(made, place, level=own).point)[0] ** 2) for own in levels])
    fitted = np.polynomial.Polynomial.fit(levels, squares, 3)(levels)
    assert np.abs(squares - fitted).max() < 0.05 * np.ptp(squares)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [18, 19, 20])
def test_what_sticks_is_coulomb_friction_of_its_level(seed):
    """Not friction of each direction with a level of its own, which makes up for a place that creeps."""
    found = diagnose(SLIDING, Dataset((stuck(seed, LEVEL), stuck(seed + 100, LEVEL))), Dataset((stuck(seed + 200, LEVEL),)))
    (cause,) = (c for c in found.causes if c.effect != "quantisation")
    assert cause.effect == "coulomb" or any(key.startswith("coulomb@") for key in cause.ties)
    if cause.effect == "coulomb":
        level = cause.parameters["level"]
        assert abs(level.value - LEVEL) < 3.0 * (level.high - level.low) / (2 * 1.96)  # three standard deviations


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "record", "friction"),
    [
        (727, 0, {"coulomb@trolley": {"level": 1.5, "width": 5e-4}}),
        (727, 0, {"coulomb@trolley": {"level": 1.5, "width": 1e-4}}),
        # as it was named on a case whose page then could not be drawn
        (
            123000009, 2,
            {"coulomb@trolley": {"level": 1.15768, "width": 4.501e-4},
             "friction-jump@trolley": {"level": 0.66954, "width": 8.986e-4, "time": 19.0321}},
        ),
    ],
)  # fmt: skip
def test_a_plant_whose_friction_is_steep_is_not_lost_along_its_records(seed, record, friction):
    """At 50 ms friction is stiff: gains from a linearization that is integrated too coarsely lose the record."""
    e = case.draw(seed).records.experiments[record]
    crane = registry.MACHINES["crane"].plant
    found = along(replace(crane, effects=friction), Dataset((e,)))
    assert np.isfinite(found.fit.cost)
    course = found.predictor.course(0)
    assert course is not None
    x = list(crane.output_names).index("x")
    assert np.sqrt(np.mean((course.predicted[:, x] - e["x"]) ** 2)) < 0.05 * np.ptp(e["x"])
    drawn = shown(crane, friction, "coulomb@trolley", Dataset((e,)))
    assert drawn is not None
    assert np.isfinite(drawn.measured).all()
