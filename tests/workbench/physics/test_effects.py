"""The catalogue of effects: one registry, every file in it, and what a user reads is there."""

from pathlib import Path

import pytest

from workbench.physics import effects
from workbench.physics.effects import EFFECTS, effects_of


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
