"""What is left: found in its channel and over its variable without a catalogue, and nothing where nothing is."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from tests.workbench.diagnosis.cases import AXIS, axis_by_hand, axis_records, fitted, robot_records, steps
from workbench.data import Dataset
from workbench.diagnosis.policy import ALPHA
from workbench.diagnosis.refit import Model
from workbench.diagnosis.remainder import BUMPS, Left, label, remainder

pytestmark = pytest.mark.slow


def driven(seed):
    """Random steps of the force, with a spring that holds the slide near 0: one more loop around the machine."""
    F = steps(600, 300.0, 300 + seed)
    return lambda k, y: F[k] - 300.0 * y


def by_hand(seed, extra=None) -> Model:
    return fitted(Dataset(tuple(axis_by_hand(driven(10 * seed + j), 10 * seed + j, extra=extra) for j in range(2))))


def curve(left: Left, at: np.ndarray) -> np.ndarray:
    """What the channel lacks at values of the variable: the sum of the bumps."""
    width = (left.grid[-1] - left.grid[0]) / (BUMPS - 1)
    return np.exp(-0.5 * ((at[:, None] - left.grid) / width) ** 2) @ left.curve


@pytest.mark.parametrize(
    ("extra", "variable", "shape"),
    [
        (lambda q, v: -60.0 * v**3, "v", lambda v: -60.0 * v**3),
        (lambda q, v: -25.0 * np.tanh(v / 0.05), "v", lambda v: -25.0 * np.tanh(v / 0.05)),
        (lambda q, v: 60.0 * np.sin(6.0 * q), "q", lambda q: 60.0 * np.sin(6.0 * q)),
    ],
    ids=["cubic friction", "dry friction", "cogging"],
)
def test_a_force_outside_the_catalogue_is_found_in_its_channel_over_its_variable_with_its_curve(extra, variable, shape):
    left = remainder(by_hand(1, extra))
    assert (left[0].channel, left[0].variable) == ("rate of v", variable)
    assert left[0].p_family < ALPHA
    inner = np.linspace(left[0].grid[0], left[0].grid[-1], 50)
    missing, true = curve(left[0], inner) * AXIS.nominal[0], shape(inner)
    # what a mass and a viscous friction can mimic is theirs: a straight line
    basis = np.column_stack([np.ones(50), inner, true])
    fit = np.linalg.lstsq(basis, missing, rcond=None)[0]
    assert fit[2] == pytest.approx(1.0, abs=0.4)


@pytest.mark.parametrize(
    ("extra", "variable"),
    [(lambda q, v: -120.0 * np.tanh(q / 0.1) * v, "v times q"), (lambda q, v: -900.0 * q**2 * v, "v times q")],
    ids=["a guide that binds at one end", "a guide that binds at both ends"],
)
def test_a_coefficient_that_changes_with_another_variable_is_found_with_both(extra, variable):
    left = remainder(by_hand(1, extra))
    assert (left[0].channel, left[0].variable) == ("rate of v", variable)
    assert left[0].p_family < 1e-4


def test_a_bent_sensor_is_found_in_the_sensor():
    model = fitted(axis_records(2, {"sensor-nonlinearity@q": {"curvature": 0.05}}, samples=600))
    assert remainder(model)[0].channel == "sensor of q"
    assert remainder(model)[0].p_family < 1e-4


@pytest.fixture(scope="module")
def nulls():
    models = [fitted(axis_records(300 + seed)) for seed in range(25)] + [fitted(robot_records(300 + seed)) for seed in range(10)]
    return [remainder(model) for model in models] + [remainder(by_hand(100 + seed)) for seed in range(10)]


@pytest.mark.parametrize("level", [0.01, 0.05, 0.2])
def test_family_wise_p_values_are_below_their_level_no_more_often_than_stated(nulls, level):
    assert sum(min(x.p_family for x in left) < level for left in nulls) <= binom.ppf(0.999, len(nulls), level)


def test_every_channel_meets_every_variable_its_own_among_them(nulls):
    pairs = {(x.channel, x.variable) for x in nulls[0]}
    variables = ("q", "v", "F", "angle of slide", "time")
    coefficients = ("F times q", "F times time", "v times q", "v times F", "v times time")
    common = {(label(c), v) for c in (("rate", "v"), ("sensor", "q")) for v in variables}
    assert pairs == common | {("rate of v", v) for v in coefficients}


def test_shares_and_p_values_are_shares_and_p_values(nulls):
    for left in nulls:
        assert all(0.0 <= x.share < 0.1 and 0.0 <= x.p_family <= 1.0 for x in left)
        assert [x.p_value for x in left] == sorted(x.p_value for x in left)


def test_what_was_not_measured_is_not_a_channel():
    model = fitted(axis_records(1))
    records = tuple(replace(r, y=np.full_like(r.y, np.nan)) for r in model.predictor.records)
    blind = Model(replace(model.predictor, records=records), model.fit)
    from workbench.diagnosis.remainder import _channels

    assert _channels(blind) == [("rate", "v")]
