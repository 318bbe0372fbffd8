"""What the loop awaits and what inverts an actuator: against the effects themselves, and against signals written out here."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers import load_controller, save_controller
from controllers.cancelled import Inverse
from controllers.scheduled_pid import Clamping
from tests.controllers.test_export import ADDED, FED, KNOTS, drawn, signals
from workbench.errors import InputError
from workbench.physics.effects.actuator import DEAD_ZONE, GEAR_BACKLASH
from workbench.physics.effects.effect import Named
from workbench.physics.effects.sensor import BACKLASH
from workbench.robustness.linear_law import without_linear_form

LATE, PLAY = (0.1, 0.0, 0.213), (0.0, 0.3, 0.2)
FREE: dict[str, Any] = {"low": (-np.inf,) * 2, "high": (np.inf,) * 2, "rate": (np.inf,) * 2}
MODELS: dict[str, Any] = {"bandwidth": (9.0, 40.0, 3.0), "slew": (0.7, np.inf, 2.0)}


def steps(law, r, y, state=None):
    """Commands (N, nu) of a fixed law, and its memory after each sample."""
    state, said, after = law.init() if state is None else state, [], []
    for own in zip(r, y, strict=True):
        u, state = law.step(state, *own)
        said.append(u)
        after.append(state)
    return np.array(said), np.array(after)


@pytest.mark.parametrize("options", [MODELS, FED | {"bandwidth": (9.0, 40.0, np.inf)}, {}])
def test_the_loop_awaits_what_a_sensor_shows_a_dead_time_later(options):
    """l is m between its samples, through the effect that a sensor with play is; the law is the one of r, y - (l - m)."""
    law = drawn(1, 2, 3, KNOTS, 3, **options, late=LATE, play=PLAY)
    r, y, _ = signals(law, 5)
    m, rate, awaited = law.aimed(r, y[0])
    plain = replace(law, late=0.0, play=0.0)
    np.testing.assert_array_equal(plain.aimed(r, y[0])[:2], (m, rate))
    t = law.dt * np.arange(len(r))
    begun = np.where(law.paths, r[0], y[0])
    for j, (late, half) in enumerate(zip(LATE, PLAY, strict=True)):
        before = np.concatenate([[begun[j]] * 20, m[:, j]])
        then = np.interp(t - late, law.dt * np.arange(-20, len(r)), before)
        shown, found = then[0], []
        for z in then:
            (shown,) = BACKLASH.law(Named({"half_width": half}), [shown], z, z, 1.0)
            found.append(shown)
        np.testing.assert_allclose(awaited[:, j], found, atol=1e-12)
    if not options:
        # where only what is awaited differs from the set-points, the loop is one with other measurements
        fixed = drawn(2, 2, 3, late=LATE, play=PLAY, **FREE)
        l = fixed.aimed(r, y[0])[2]  # noqa: E741
        other = replace(fixed, late=0.0, play=0.0, Kr=0.0 * fixed.Kr)
        fed = np.einsum("ij,nj->ni", fixed.Kr[0], r)
        np.testing.assert_allclose(steps(fixed, r, y)[0], steps(other, l, y)[0] + fed, atol=1e-9)


@pytest.mark.parametrize("late", [(0.04, 0.0, 0.0), (0.1, 0.013, 0.213), (0.0, 0.0, 0.01)])
def test_a_dead_time_is_in_the_linear_form(late):
    for options in ({}, MODELS, FED | {"bandwidth": (9.0, 40.0, np.inf)}):
        assert without_linear_form(drawn(3, 2, 3, KNOTS, 3, **options, late=late)) == ""
    assert "is not its law" in without_linear_form(drawn(3, 2, 3, KNOTS, 3, play=0.1))
    awaiting = drawn(3, 2, 3, KNOTS, 3, **MODELS, late=late, play=0.1, compensations=ADDED)
    assert without_linear_form(awaiting.uncompensated) == ""
    assert not awaiting.unshaped.late.any()


@pytest.mark.parametrize("anti_windup", [{}, {"anti_windup": Clamping()}])
@pytest.mark.parametrize("seed", range(3))
def test_behind_the_effect_an_inverse_leaves_what_was_commanded(seed, anti_windup):
    """Dead zone and gear by the laws of the effects: outside `keep` nothing is left of one, an impulse in all of the other."""
    half, play, keep = 0.7, 0.3, 0.05
    plain = drawn(10 + seed, 2, 2, **FREE, **anti_windup)
    r, y, _ = signals(plain, seed)
    v, _ = steps(plain, r, y)
    u, _ = steps(replace(plain, inverses=(Inverse("V2", "dead-zone@V2", half, 0.0, keep),)), r, y)
    acting = DEAD_ZONE.law(Named({"half_width": half}), u[:, 1], 0.0)
    np.testing.assert_array_equal(u[:, 0], v[:, 0])
    sure = np.abs(v[:, 1]) > keep
    assert sure.mean() > 0.8
    np.testing.assert_allclose(acting[sure], v[sure, 1], atol=1e-12)
    assert np.abs(acting - v[:, 1]).max() <= 2.0 * keep
    u, _ = steps(replace(plain, inverses=(Inverse("V1", "gear-backlash@V1", 0.0, play, keep),)), r, y)
    teeth, acting = 0.0, []
    for own in u[:, 0]:
        teeth, arrives = GEAR_BACKLASH.law(Named({"play": play}), teeth, own, plain.dt)
        acting.append(arrives)
    sure = np.abs(v[:, 0]) > keep
    np.testing.assert_allclose(np.array(acting)[sure], v[sure, 0], atol=1e-9)


def test_who_takes_over_pushes_nothing():
    """The first command is the one that stood; of a gear the teeth touch already where it pushes."""
    for inverse in (Inverse("V1", "gear-backlash@V1", 0.0, 0.3, 0.05), Inverse("V1", "dead-zone@V1", 0.4, 0.0, 0.05)):
        law = drawn(5, 1, 1, inverses=(inverse,), low=(-9.0,), high=(9.0,))
        for held in (2.0, -1.5):
            u, state = law.step(law.init(np.array([held])), np.zeros(1), np.zeros(1))
            np.testing.assert_allclose(u, held, atol=1e-12)
            again = law.follow(law.init(), np.array([held]), np.zeros(1), np.zeros(1))
            alike = law.step(state, np.zeros(1), np.zeros(1))[0]
            np.testing.assert_allclose(law.step(again, np.zeros(1), np.zeros(1))[0], alike, atol=1e-9)


def test_gains_change_without_a_bump_where_only_one_law_awaits():
    old = drawn(6, 2, 3, **MODELS, **FREE)
    new = replace(drawn(7, 2, 3, **MODELS, **FREE, late=LATE, play=PLAY), c=old.c)
    y = np.repeat(np.random.default_rng(3).normal(size=(1, 3)), 50, axis=0)
    u, states = steps(old, y, y)
    for state in (states[-1], new.init()):
        state = new.follow(state, u[-1], y[0], y[0])
        np.testing.assert_allclose(new.step(state, y[0], y[0])[0], u[-1], atol=1e-9)
        assert len(state) == len(new.init())
    with pytest.raises(InputError, match="memory of 7 numbers"):
        new.follow(np.zeros(7), u[-1], y[0], y[0])


def test_a_path_that_is_awaited_goes_on_over_samples_that_are_left_out():
    law = drawn(8, 2, 2, Ka=[[[0.3, -0.1], [-0.2, 0.4]]], late=(0.1, 0.06), play=(0.0, 0.1))
    r, y, _ = signals(law, 2)
    whole = steps(law, r, y)[1]
    y[60:63, 0] = np.nan
    kept = steps(law, r, y)[1]
    line = slice(-2 * 3 - 2, None)  # three samples of m of each, and l
    np.testing.assert_allclose(kept[64:, line], whole[64:, line], atol=1e-12)


def test_its_file_holds_it(tmp_path):
    law = drawn(9, 2, 3, **MODELS, late=LATE, play=PLAY, inverses=(Inverse("V2", "dead-zone@V2", 0.4, 0.1, 0.05),))
    again = load_controller(save_controller(law, tmp_path / "pid.json"))
    r, y, _ = signals(law, 1)
    np.testing.assert_array_equal(steps(again, r, y)[0], steps(law, r, y)[0])
    assert "half_width s" in law.sentence
    assert {path.name for path in law.export("csv", tmp_path)} == {"gains.csv", "awaited.csv", "inverses.csv"}
    for wrong, match in (
        ({"late": 9.0}, "dead time of 225 samples"),
        ({"inverses": (Inverse("V9", "dead-zone@V9", 0.4),)}, "V9"),
        ({"inverses": law.inverses * 2}, "two inverses of one input"),
        ({"late": (1.0, 2.0)}, "late of shape"),
    ):
        with pytest.raises(InputError, match=match):
            replace(law, **wrong)
