"""A ball under a magnet, whose free runs leave the world within tenths of a second: what they give stops nothing and counts for
nothing.
"""

from dataclasses import replace

import numpy as np
import pytest

from tests.workbench.diagnosis.maglev import GUARDED, MAGLEV, record
from workbench import Channel, Parameter, Plant
from workbench.data import Dataset, Experiment
from workbench.diagnosis.answer import Finding
from workbench.diagnosis.calibrate import calibrate, trajectories
from workbench.diagnosis.check.records import check
from workbench.diagnosis.diagnosis import _recalibrated, diagnose
from workbench.diagnosis.free_run import simulated
from workbench.diagnosis.gains import Held, Score, errors, gained, horizons
from workbench.diagnosis.growth import fold, left, reach, unstable
from workbench.diagnosis.normal import inverse, solve
from workbench.diagnosis.predictor import predictor
from workbench.diagnosis.referee import Judge, changes, helps, worse
from workbench.diagnosis.refit import Model
from workbench.errors import InputError

SQUARE = Plant(
    name="square",
    states=(Channel("x", "m"),),
    inputs=(Channel("u", "V", "input"),),
    outputs=(Channel("y", "m", "output"),),
    parameters=(Parameter("a", 1.0, tolerance=0.2),),
    equation=lambda x, u, p, at: {"x": p.a * u.u - x.x},
    measure=lambda x, p: {"y": x.x**2},
    dt=0.01,
)


@pytest.mark.parametrize(("seed", "samples"), [(4, 400), (32, 300), (41, 300)])
def test_a_fit_of_starts_whose_runs_fall_through_the_magnet_is_none(seed, samples):
    """Slopes of 1e150 leave normal equations that are singular to the last bit."""
    check(MAGLEV, Dataset((record(seed, samples),)))


@pytest.mark.parametrize(("seed", "samples"), [(0, 500), (16, 600), (26, 500)])
def test_a_run_that_has_fallen_a_kilometre_does_not_make_its_record_one_in_kilometres(seed, samples):
    check(MAGLEV, Dataset((record(seed, samples),)))


def test_a_reversed_voltage_is_refused_all_the_same():
    e = record(1, 600)
    with pytest.raises(InputError, match="U: looks reversed in sign"):
        check(MAGLEV, Dataset((replace(e, values=e.values * [-1.0, 1.0, 1.0]),)))


def test_an_output_that_does_not_move_where_the_plant_rests_and_whose_noise_is_not_stated_has_a_start():
    u = np.repeat(np.random.default_rng(0).standard_normal(8), 25)
    y = np.convolve(u, np.exp(-0.01 * np.arange(200)), "full")[:200] * 0.01
    e = Experiment.from_arrays("square", 0.01, inputs={"u": u}, outputs={"y": y**2}, units={"u": "V", "y": "m"})
    made = predictor(SQUARE, Dataset((e,)))
    assert np.isfinite(made.at(made.point)[0]).all()


def test_normal_equations_are_solved_as_far_as_they_can_be():
    J = np.random.default_rng(1).standard_normal((3, 9))
    A, b = J @ J.T, np.arange(3.0)
    np.testing.assert_allclose(solve(A, b), np.linalg.solve(A, b), rtol=1e-9)
    alike = np.ones((2, 2)) * 1e300  # two unknowns that do the same, far beyond any prior
    lost = np.array([[np.inf, 0.0], [0.0, 1.0]])
    found = solve(np.stack([np.eye(2), alike, lost]), np.ones((3, 2)))
    np.testing.assert_allclose(found[0], 1.0)
    assert np.isfinite(found[:2]).all()
    assert np.isnan(found[2]).all()
    assert np.isfinite(inverse(alike)).all()
    assert np.isnan(inverse(lost)).all()


def held(before: float, far: tuple[float, ...] = (3.0,)) -> Held:
    """A model with an error of this size, a full run of one channel whose spread is 1 mm."""
    e = before * np.random.default_rng(0).choice([-1.0, 1.0], 4000)
    return Held((Score("r", "full-run", "gap", "mm", before),), 0.0, (e**2,), 0.001, far)


def test_of_two_runs_that_are_far_from_their_record_neither_is_better():
    """4 m and 62 m, in a machine that moves by millimetres."""
    for pair in ((4.32e3, 6.18e4), (2.24e7, 8.43e5)):
        (change,) = changes(*map(held, pair))
        assert not change.known
        assert change.share == 0.0
        assert not worse((change,))
        assert not helps((change,), 0.01)
        assert not np.isfinite([gained(*map(held, pair))[0].before, gained(*map(held, pair))[0].after]).any()
        assert changes(*(held(size, (np.inf,)) for size in pair))[0].known  # of a stable plant the larger one is worse


def test_a_run_that_follows_is_better_than_one_that_does_not():
    (fell,), (rose,) = changes(held(0.5), held(6.18e4)), changes(held(4.32e3), held(0.5))
    assert worse((fell,))
    assert rose.share > 0.99
    (told,) = gained(held(4.32e3), held(0.5))  # what is gone from its record has no number in a table
    assert np.isnan(told.before)
    assert told.after == pytest.approx(0.5)
    (near,) = gained(held(6.0), held(0.5))
    assert near.before == pytest.approx(6.0)
    assert helps((rose,), 0.01)
    (both_follow,) = changes(held(0.5), held(0.7))
    assert worse((both_follow,))


def cart(records: dict[str, tuple[float, float]]) -> Held:
    """Full-run errors of the angle (spread 1 deg) and the place (spread 1 m) of a cart with a pendulum, by record."""
    random, scores, squares = np.random.default_rng(0), [], []
    for name, sizes in records.items():
        for channel, unit, size in zip(("a", "x"), ("deg", "m"), sizes, strict=True):
            scores.append(Score(name, "full-run", channel, unit, size))
            squares.append((size * random.choice([-1.0, 1.0], 2000)) ** 2)
    return Held(tuple(scores), 0.0, tuple(squares), 0.005, (3.0,) * len(scores))


def test_where_the_pendulum_falls_in_both_runs_the_cart_says_nothing():
    fallen = {"r": (200.0, 0.5)}, {"r": (180.0, 0.9)}
    assert not any(change.known for change in changes(*map(cart, fallen)))
    assert not worse(changes(*map(cart, fallen)))
    assert all(np.isnan([told.before, told.after]).all() for told in gained(*map(cart, fallen)))
    upright = {"s": (0.5, 0.9)}, {"s": (0.4, 0.5)}  # in another record both stay up: it alone counts
    _, x = changes(*(cart(one | other) for one, other in zip(fallen, upright, strict=True)))
    assert x.share == pytest.approx(1.0 - 0.5 / 0.9)
    one_falls = {"r": (0.5, 0.5)}, {"r": (180.0, 0.9)}
    assert {change.channel for change in worse(changes(*map(cart, one_falls)))} == {"a", "x"}


@pytest.fixture(scope="module")
def ball() -> Model:
    return _recalibrated(GUARDED, Dataset((record(1, 3000),)), True, 1)


def test_runs_of_an_unstable_plant_are_compared_as_far_ahead_as_they_can_follow(ball):
    assert unstable(ball.predictor)
    assert 0.015 < fold(ball.predictor) < 0.035  # sqrt(2 g / s): 0.023 s
    seconds = reach(ball.predictor)
    assert seconds == pytest.approx(4.0 * fold(ball.predictor), rel=0.05)
    name = horizons(seconds)[1]
    assert name == f"{seconds:g}-second"
    y = ball.predictor.records[0].y
    ahead, second = (errors(ball.predictor, ball.fit.point, 0, horizon) for horizon in (name, "one-second"))
    told, later = (np.isfinite(e).all(axis=1) for e in (ahead, second))
    assert told[: round(seconds / 0.001)].sum() == 0
    assert told.sum() > 900  # runs begin at a third of all samples
    assert not left(ahead[told], y[told]).any()
    assert left(second[later], y[later])[0]


def test_a_ball_has_no_fit_to_free_runs(ball):
    """With a stop to its force a run that has fallen metres stays in the numbers."""
    assert simulated(ball) is None


def test_a_run_ahead_is_told_with_its_own_horizon_and_the_instability_in_a_sentence(ball):
    judge = Judge(Dataset((record(2, 1500),)), True)
    found = judge.between(ball, ball)
    assert {c.horizon for c in found if c.ahead} == {f"{reach(ball.predictor):g}-second"}
    assert not next(c for c in found if (c.horizon, c.channel) == ("full-run", "gap")).known
    assert "maglev is unstable" in judge.compared(ball)
    assert f"up to {reach(ball.predictor):g} s ahead" in judge.compared(ball)
    assert judge.longer(ball, ball) == 1.0


@pytest.mark.slow
@pytest.mark.parametrize("plant", [MAGLEV, GUARDED], ids=["falls", "guarded"])
def test_an_offset_of_an_unstable_machine_is_named_and_handed_out(plant):
    own, other = (Dataset(tuple(record(seed, 4000, offset=1.5) for seed in seeds)) for seeds in ((1, 2), (3,)))
    found = diagnose(plant, own, other)
    assert found.finding is Finding.NAMED
    (cause,) = found.causes
    assert cause.key == "offset@U"
    assert cause.parameters["level"].value == pytest.approx(1.5, abs=0.05)
    assert not cause.doubt
    assert not found.objections
    lost = [g for g in cause.gains if (g.channel, g.horizon) == ("gap", "full-run")]
    assert lost
    assert np.isnan([g.before for g in lost]).all()
    assert "is unstable" in found.compared


@pytest.mark.slow
def test_a_calibration_of_an_unstable_machine_is_handed_out_and_tells_no_error_of_metres():
    done = calibrate(GUARDED, Dataset((record(1, 4000),)), Dataset((record(3, 3000),)))
    assert not done.objections
    assert "is unstable" in done.compared
    (run,) = trajectories(done.plant, Dataset((record(3, 3000),)))
    assert np.isnan(run.simulated[-1, 0])
    assert np.nanmax(np.abs(run.simulated[:, 0] - run.measured[:, 0])) < 30.0
