"""A ball under a magnet, whose free runs leave the world within tenths of a second: what they give stops nothing and counts for
nothing.
"""

from dataclasses import replace

import numpy as np
import pytest

from tests.workbench.diagnosis.maglev import MAGLEV, record
from workbench import Channel, Parameter, Plant
from workbench.data import Dataset, Experiment
from workbench.diagnosis.check.records import check
from workbench.diagnosis.normal import inverse, solve
from workbench.diagnosis.predictor import predictor
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
