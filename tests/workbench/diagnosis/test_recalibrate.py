"""Parameters found again inside their own intervals, at the rate that is stated."""

import numpy as np
import pytest
from scipy.stats import binom

from tests.workbench.diagnosis.cases import AXIS, READING, ROBOT, axis_records, fitted, robot_records
from workbench.diagnosis.predictor import predictor
from workbench.diagnosis.recalibrate import unknowns
from workbench.errors import InputError


def inside(plant, records, seeds) -> np.ndarray:
    """(seeds, parameters): whether the truth, drawn within the tolerances, lies in the 95 % interval."""
    found = []
    for seed in range(seeds):
        spread = np.array([q.tolerance for q in plant.parameters])
        truth = plant.nominal * (1 + spread * np.random.default_rng([7, seed]).uniform(-1, 1, len(spread)))
        fit = fitted(records(seed, parameters=dict(zip((q.name for q in plant.parameters), truth, strict=True)))).fit
        sd = fit.unknowns.sigma * np.sqrt(np.diag(fit.covariance)[: len(truth)])
        found.append(np.abs(np.log(fit.point.p / truth)) < 1.96 * sd)
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(("plant", "records", "seeds"), [(AXIS, axis_records, 25), (ROBOT, robot_records, 15)])
def test_true_parameters_lie_in_their_intervals_nineteen_times_out_of_twenty(plant, records, seeds):
    hits = inside(plant, records, seeds)
    # parameters of one record move together: every one has to pass alone
    assert np.all(hits.sum(axis=0) >= binom.ppf(1e-3, seeds, 0.95))


def test_the_intervals_are_no_wider_than_the_data_make_them():
    fit = fitted(axis_records(1, samples=1200)).fit
    short = fitted(axis_records(1, samples=300)).fit
    ratio = np.sqrt(np.diag(short.covariance)[:2] / np.diag(fit.covariance)[:2])
    assert np.all((ratio > 1.3) & (ratio < 3.2))  # four times the samples: half the width


def test_recalibration_finds_what_a_tolerance_hides_and_the_noise_with_it():
    data = axis_records(4, parameters={"M": 110.0, "Fv": 120.0}, samples=600)
    model = fitted(data)
    assert model.fit.point.p == pytest.approx([110.0, 120.0], rel=0.05)
    assert model.predictor.noise.measurement[0] == pytest.approx(READING, rel=0.25)
    white = np.concatenate([e.ravel() for e in model.fit.errors])
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.15)


def test_a_parameter_without_tolerance_is_not_touched_and_a_named_one_is_the_only_one():
    made = predictor(AXIS, axis_records(1))
    assert unknowns(made, names=["Fv"]).parameters == (1,)
    assert unknowns(made, names=()).parameters == ()
    assert unknowns(made).parameters == (0, 1)
    with pytest.raises(InputError, match="Fw"):
        unknowns(made, names=["Fw"])
