"""The catalogue of effects: one registry, every file in it, and what a user reads is there."""

import itertools
from pathlib import Path

import pytest

from plants import WEB_WINDING, WELDING_ROBOT
from workbench.errors import InputError
from workbench.physics import effects
from workbench.physics.effects import EFFECTS, effects_of
from workbench.physics.effects.effect import GridUnit
from workbench.physics.effects.shaft import Shaft, Slide


def test_every_effect_file_is_in_the_registry():
    files = {path.stem for path in Path(effects.__file__).parent.glob("*.py")} - {"__init__", "effect"}
    assert files == {effect.family for effect in EFFECTS.values()}
    assert all(name == effect.id for name, effect in EFFECTS.items())


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
def test_every_effect_says_what_it_is(effect):
    assert "{place}" in effect.sentence
    assert effect.separates
    assert effect in effects_of(effect.family)
    assert any(not p.shape for p in effect.parameters)
    for p in effect.parameters:
        assert p.unit
        assert p.low <= p.default <= p.high


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
def test_on_a_slide_every_shaft_parameter_is_the_same_number_in_newton_and_metre(effect):
    for p in effect.parameters:
        turning, sliding = Shaft("rail", "v").fitted(p), Slide("rail", "v", travel=0.05).fitted(p)
        assert turning is p
        if effect.family == "shaft":
            assert "rad" not in sliding.unit
            assert "N m" not in sliding.unit
        assert sliding.default == (0.05 * p.default if p.unit == "rad/s" else p.default)
        assert sliding.low <= sliding.default <= sliding.high


def test_grids_of_shafts_leave_no_gap():
    """Half a decade from speed to speed, up to the largest one of the records, and every whole order that the bounds allow."""
    for effect in effects_of("shaft"):
        for p in effect.parameters:
            if p.unit == "rad/s":
                assert p.grid_unit is GridUnit.SPEED
                assert p.grid[-1] <= 1.0
                assert all(1.0 < after / before < 3.5 for before, after in itertools.pairwise(p.grid))
            if p.unit == "1/turn":
                assert p.grid == tuple(k for k in range(100) if p.low <= k <= p.high)


def test_dry_friction_of_a_slide_is_full_at_a_tenth_of_its_usual_speed():
    """Its width follows the speed state: 1 rad/s is narrow for a reel at 100 rad/s and would swallow a robot at 1 m/s."""
    eta = WELDING_ROBOT.effect_vector({"coulomb@rail": {"level": 2.0}})
    assert WELDING_ROBOT.derivative([0.1, 0.1], [0.0, 0.0], eta=eta)[0] == pytest.approx(-0.3 * 0.1 - 2.0, rel=1e-6)
    width = {s.key: s.parameter for p in (WELDING_ROBOT, WEB_WINDING) for s in p.slots if s.parameter.name == "width"}
    assert (width["coulomb@rail"].default, width["coulomb@rail"].unit) == (0.01, "m/s")
    assert (width["coulomb@unwind"].default, width["coulomb@unwind"].unit) == (1.0, "rad/s")
    with pytest.raises(InputError, match=r"-1 N$|-1 N\n"):
        WELDING_ROBOT.effect_vector({"coulomb@rail": {"level": -1.0}})
