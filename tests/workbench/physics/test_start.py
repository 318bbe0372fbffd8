"""Where a run starts: tanks, squares and roots are solved, and what cannot be says how many unknowns and equations there are."""

import numpy as np
import pytest

from workbench import Channel, Parameter, Plant, Start
from workbench.errors import InputError
from workbench.physics.controller import Playback
from workbench.physics.extension import extension
from workbench.simulation import Scenario, simulate


def plant(equation, states, start, *, inputs=("u",), **options):
    return Plant(
        name="drawn",
        states=tuple(Channel(name) for name in states),
        inputs=tuple(Channel(name, "", "input") for name in inputs),
        outputs=(Channel("y", "", "output"),),
        parameters=(Parameter("k", 0.2), Parameter("a", 0.1), Parameter("b", 0.05)),
        equation=equation,
        measure=lambda x, p: {"y": getattr(x, states[0])},
        dt=0.1,
        start=start,
        **options,
    )


def tanks(x, u, p, at):
    """Two tanks in a row: what leaves one goes with the root of its level."""
    return {"h1": p.k * u.u - p.a * np.sqrt(x.h1), "h2": p.a * np.sqrt(x.h1) - p.b * np.sqrt(x.h2)}


def arm(x, u, p, at):
    """An arm under a propeller: the thrust goes with the square of the command."""
    return {"th": x.w, "w": p.k * u.u**2 - p.a * np.sin(x.th) - p.b * x.w}


TANKS, ARM = ("h1", "h2"), ("th", "w")


@pytest.mark.parametrize("u", [1e-4, 0.5, 30.0])
def test_levels_of_tanks_follow_from_the_inflow_without_a_guess(u):
    x, _ = plant(tanks, TANKS, Start({"u": u}, TANKS, TANKS)).equilibrium()
    np.testing.assert_allclose(x, [(0.2 * u / 0.1) ** 2, (0.2 * u / 0.05) ** 2], rtol=1e-9)


def guarded(x, u, p, at):
    """Two tanks as a careful owner writes them: below 0 no level has a slope."""
    q1, q2 = (a * np.sqrt(np.maximum(h, 1e-5)) for a, h in ((p.a, x.h1), (p.b, x.h2)))
    return {"h1": (0.3 - p.k) * u.u - q1, "h2": q1 - q2}


@pytest.mark.slow
@pytest.mark.parametrize("guess", [1e-3, 0.03, 1.0, 30.0])
@pytest.mark.parametrize("level", [1e-4, 2e-3, 0.1, 2.0])
def test_a_level_is_found_from_a_guess_far_above_or_below_it_without_limits(level, guess):
    inflow = 0.1 * np.sqrt(level) / 0.1
    x, _ = plant(guarded, TANKS, Start({"u": inflow}, TANKS, TANKS, {"h1": guess, "h2": guess})).equilibrium()
    np.testing.assert_allclose(x, [level, 4.0 * level], rtol=1e-9)


def shared(x, u, p, at):
    """Two tanks in a row, of which the first gets what a share k leaves it of the inflow."""
    return {"h1": (0.3 - p.k) * u.u - p.a * np.sqrt(x.h1), "h2": p.a * np.sqrt(x.h1) - p.b * np.sqrt(x.h2)}


@pytest.mark.slow
def test_numbers_that_leave_no_rest_start_where_the_plant_did_before():
    limits = {"h1": (0.0, 10.0), "h2": (0.0, 30.0)}
    nominal = plant(shared, TANKS, Start({"u": 1.0}, TANKS, TANKS), limits=limits)
    x, u = nominal.equilibrium()
    np.testing.assert_allclose(x, [1.0, 4.0], rtol=1e-9)
    filled = nominal.with_parameters({"k": 0.1})  # has a rest of its own
    np.testing.assert_allclose(filled.equilibrium()[0], [4.0, 16.0], rtol=1e-9)
    for dry in (nominal.with_parameters({"k": 0.35}), extension(nominal, "drawn", {"k": 0.35}).of(nominal)):
        np.testing.assert_allclose(np.concatenate(dry.equilibrium()), np.concatenate([x, u]), rtol=1e-12)
        assert dry.nominal[0] == 0.35
    with pytest.raises(InputError, match="no start"):  # the owner's own numbers are refused all the same
        plant(shared, TANKS, Start({"u": -1.0}, TANKS, TANKS), limits=limits).with_parameters({"k": 0.2})


def test_the_inflow_follows_from_a_level():
    x, u = plant(tanks, TANKS, Start({"h2": 0.3}, ("h1", "u"), TANKS)).equilibrium()
    np.testing.assert_allclose([x[0], u[0]], [0.3 / 4, 0.05 * np.sqrt(0.3) / 0.2], rtol=1e-9)


def test_a_thrust_of_the_square_is_found_from_no_command_and_a_guess_asks_for_the_other_root():
    wanted = np.sqrt(0.1 * np.sin(0.3) / 0.2)
    for guess, sign in (({}, 1.0), ({"u": -0.1}, -1.0)):
        _, u = plant(arm, ARM, Start({"th": 0.3}, ("u",), ("w",), guess)).equilibrium()
        assert u[0] == pytest.approx(sign * wanted, rel=1e-9)


def test_a_square_at_rest_needs_no_slope():
    assert plant(arm, ARM, Start({"th": 0.0}, ("u",), ("w",))).equilibrium()[1] == [0.0]


def test_a_start_beyond_the_limits_gives_way_to_one_within():
    def cubic(x, u, p, at):
        return {"h": (x.h + 1.0) * (x.h - 2.0) * (x.h - 5.0) + u.u}

    free = plant(cubic, ("h",), Start({}, ("h",), ("h",), {"h": -0.9})).equilibrium()[0]
    kept = plant(cubic, ("h",), Start({}, ("h",), ("h",), {"h": -0.9}), limits={"h": (0.0, 4.0)}).equilibrium()[0]
    assert (free[0], kept[0]) == (pytest.approx(-1.0), pytest.approx(2.0))


def test_each_of_many_parameter_vectors_has_the_start_that_it_has_alone():
    own = plant(tanks, TANKS, Start({"u": 0.5}, TANKS, TANKS))
    p = own.nominal * np.random.default_rng(1).uniform(0.5, 2.0, (12, 3))
    x, _ = own.equilibria(p)
    for row, alone in zip(x, p, strict=True):
        np.testing.assert_array_equal(row, own.equilibria(alone[None])[0][0])


@pytest.mark.slow
def test_what_has_no_start_is_told_with_its_unknowns_equations_and_how_near_it_came():
    with pytest.raises(InputError) as reason:
        plant(arm, ARM, Start({"th": -0.3}, ("u",), ("w",))).equilibrium()
    assert "1 unknown (u) from 1 rate (w) that shall be 0" in reason.value.problem
    assert "0.0296 is left" in reason.value.problem  # 0.1 sin 0.3
    assert "Start(guess=" in reason.value.mend


@pytest.mark.slow
def test_an_unknown_that_acts_on_nothing_is_named():
    def idle(x, u, p, at):
        return {"q": x.v, "v": u.u - x.v}

    with pytest.raises(InputError, match=r"2 unknowns \(q, v\) from 2 rates \(q, v\).*q acts on none of these rates"):
        plant(idle, ("q", "v"), Start({"u": 1.0}, ("q", "v"), ("q", "v"))).equilibrium()


def test_unknowns_and_equations_are_counted_when_the_plant_is_made():
    with pytest.raises(InputError, match=r"2 unknowns \(u, th\), but 1 rate \(w\)"):
        plant(arm, ARM, Start({}, ("u", "th"), ("w",)))
    with pytest.raises(InputError, match="unknown state or input 'theta'"):
        plant(arm, ARM, Start({"theta": 0.0}))
    with pytest.raises(InputError, match="unknown state 'u'"):
        plant(arm, ARM, Start({}, ("u",), ("u",)))


def test_a_run_from_an_empty_tank_is_a_run():
    """The slope of the root at level 0 is endless and says nothing of the integrator's steps."""
    empty = plant(tanks, TANKS, Start())
    run = simulate(empty, Playback(("u",), 0.1), Scenario("filling", {"u": np.full(4000, 0.5)}))
    np.testing.assert_allclose(run.states.values[-1], [1.0, 4.0], rtol=1e-2)
