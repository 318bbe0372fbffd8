"""Score tests against a least-squares problem with all columns written out, and against records in which nothing is missing."""

import numpy as np
import pytest
from scipy.stats import binom, kstest

from tests.workbench.diagnosis.cases import (
    AXIS,
    ROBOT,
    axis_predictor,
    axis_records,
    fitted,
    keys_of,
    robot_records,
    screened,
)  # fmt: skip
from workbench.diagnosis.fit import gauss_newton
from workbench.diagnosis.recalibrate import unknowns
from workbench.diagnosis.refit import Model
from workbench.diagnosis.screen import WANTED, Signature, Variant, scores, signatures, similarity, small_sizes, variants

pytestmark = pytest.mark.slow


def slots(key: str) -> tuple[int, ...]:
    return tuple(i for i, s in enumerate(AXIS.slots) if s.key == key and not s.parameter.shape)


@pytest.fixture(scope="module")
def unfinished() -> Model:
    """A model whose fit was broken off: its gradient is far from 0."""
    made = axis_predictor(axis_records(3, {"offset@F": {"level": 4.0}}, samples=120, records=3, parameters={"M": 100.0}))
    own = unknowns(made)
    z = own.zero()
    z[1] += 0.02
    return Model(made, gauss_newton(made, own, z, np.zeros(len(AXIS.slots)), rounds=1, chords=1))


def columns_of(model: Model, variant: Variant, sizes: np.ndarray) -> np.ndarray:
    """What the variant adds to the errors of all records, one column for each size (and record, where it has a phase)."""
    fit, made = model.fit, model.predictor
    base = made.at(fit.point)
    heads = variant.sizes if np.isnan(variant.finite) else variant.sizes[:1]
    by_record = []
    for i in range(len(base)):
        own = []
        for s in heads:
            eta = fit.point.eta[i].copy()
            for j, value in variant.shapes:
                eta[j] = value
            eta[s] += sizes[s] if np.isnan(variant.finite) else variant.finite
            own.append((made.errors(i, fit.point.p[None], eta[None], fit.point.start[i][None])[0] - base[i]).ravel())
        by_record.append(np.array(own).T)
    if not variant.phase:
        return np.concatenate(by_record)
    rows, width = [len(g) for g in by_record], by_record[0].shape[1]
    G = np.zeros((sum(rows), width * len(rows)))
    for i, g in enumerate(by_record):
        G[sum(rows[:i]) : sum(rows[: i + 1]), i * width : (i + 1) * width] = g
    return G


def normal_system(model: Model):
    """All rows of errors and prior: (matrix, right-hand side) of the fitted unknowns."""
    fit = model.fit
    rows = [np.zeros((J.shape[0], fit.unknowns.size)) for J in fit.jacobian]
    for i, J in enumerate(fit.jacobian):
        rows[i][:, fit.unknowns.columns(i)] = J
    A = np.concatenate([*rows, np.diag(fit.unknowns.believed.astype(float))])
    return A, np.concatenate([*(e.ravel() for e in fit.errors), fit.prior])


def left_by(A, e):
    x = np.linalg.lstsq(A / np.linalg.norm(A, axis=0), -e, rcond=None)[0] / np.linalg.norm(A, axis=0)
    return x, float(np.sum((e + A @ x) ** 2))


@pytest.mark.parametrize("key", ["offset@F", "imbalance@slide", "sensor-gain@q", "asymmetric-friction@slide", "heating@F"])
def test_statistic_and_size_are_those_of_a_least_squares_fit_with_all_columns(unfinished, key):
    sizes = small_sizes(unfinished.predictor, unfinished.fit)
    for variant in variants(unfinished.predictor, unfinished.fit, [key], sizes)[:2]:
        (s,) = signatures(unfinished.predictor, unfinished.fit, [variant], sizes, columns=True)
        G = columns_of(unfinished, variant, sizes)
        A, e = normal_system(unfinished)
        full, with_it = left_by(np.hstack([A, np.vstack([G, np.zeros((A.shape[1], G.shape[1]))])]), e)
        _, without = left_by(A, e)
        sized = full[A.shape[1] :]
        if len(sized) > 1 or s.low[0] < 0.0 or sized[0] > 0.0:  # no bound stands in the way
            assert s.statistic == pytest.approx(without - with_it, rel=1e-5, abs=1e-6)
        else:
            assert s.statistic == 0.0
        np.testing.assert_allclose(s.size, sized * s.scale, rtol=1e-4, atol=1e-6 * np.abs(s.scale).max())
        pulled = s.weights[unfinished.fit.unknowns.believed]
        np.testing.assert_allclose(s.columns.T @ s.columns + pulled.T @ pulled, s.S, rtol=1e-6, atol=1e-9 * np.trace(s.S))
        if not variant.phase:  # what the bootstrap flips is all of b but the prior's part
            np.testing.assert_allclose(s.blocks.sum(axis=0) - s.weights.T @ unfinished.fit.prior, s.b, rtol=1e-6, atol=1e-6)


def test_a_finite_size_is_one_column_and_a_phase_has_its_own_in_every_record(unfinished):
    sizes = small_sizes(unfinished.predictor, unfinished.fit)
    delay = variants(unfinished.predictor, unfinished.fit, ["input-delay@F"], sizes)
    assert [v.finite for v in delay] == pytest.approx([0.25 * AXIS.dt, 0.5 * AXIS.dt, AXIS.dt, 2 * AXIS.dt])
    wobble = variants(unfinished.predictor, unfinished.fit, ["imbalance@slide"], sizes)
    assert [len(s.b) for s in signatures(unfinished.predictor, unfinished.fit, [*delay, *wobble], sizes)] == [1, 1, 1, 1, 6]


def test_the_one_step_size_of_a_linear_effect_is_the_true_size_and_has_its_sign():
    for level in (-6.0, 4.0):
        found = {s.key: s for s in screened(fitted(axis_records(5, {"offset@F": {"level": level}}, samples=600)))}
        signature = found["offset@F"].best
        sd = signature.scale[0] / np.sqrt(signature.S[0, 0])
        assert abs(signature.size[0] - level) < 3.5 * sd
        assert sd < 1.3


def test_the_limit_is_five_standard_deviations_of_the_size():
    signature = next(s for s in screened(fitted(axis_records(6))) if s.key == "offset@F").best
    spread = [next(s for s in screened(fitted(axis_records(100 + seed)), ["offset@F"])).best.size[0] for seed in range(12)]
    # twelve records: their spread is known to some 20 %
    assert signature.limit / 5.0 == pytest.approx(float(np.sqrt(np.mean(np.square(spread)))), rel=0.6)


def test_a_friction_that_would_have_to_be_negative_has_no_evidence():
    found = screened(fitted(axis_records(7, {"asymmetric-friction@slide": {"forward": 0.0}})), ["coulomb@slide"])
    variant = Variant("coulomb@slide", slots("coulomb@slide"), (), np.nan, False)
    b, S = np.array([3.0]), np.array([[2.0]])
    up, down = (Signature(variant, sign * b, S, np.ones(1), np.ones((4, 1)), np.zeros((1, 1)), np.zeros(1)) for sign in (-1, 1))
    assert up.statistic == pytest.approx(4.5)
    assert up.size[0] == pytest.approx(1.5)
    assert down.statistic == 0.0
    for s in found[0].all:
        assert (s.statistic > 0.0) == (s.size[0] > 0.0)


def test_steps_for_differences_change_the_errors_by_about_a_standard_deviation():
    model = fitted(axis_records(8))
    sizes = small_sizes(model.predictor, model.fit)
    for key in ("offset@F", "coulomb@slide", "sensor-lag@q", "imbalance@slide"):
        for s in slots(key):
            eta = np.repeat(model.fit.point.eta[:1], 2, axis=0)
            eta[1, s] += sizes[s]
            e = model.predictor.errors(0, model.fit.point.p[None], eta, model.fit.point.start[:1])
            assert 0.2 * WANTED < np.linalg.norm(e[1] - e[0]) < 5 * WANTED


@pytest.fixture(scope="module")
def nulls():
    """Scores of the whole catalogue on thirty axis and fifteen robot records in which nothing is missing."""
    return [screened(fitted(axis_records(200 + seed))) for seed in range(30)] + [
        screened(fitted(robot_records(200 + seed))) for seed in range(15)
    ]


@pytest.mark.parametrize("level", [0.01, 0.05, 0.2])
def test_family_wise_p_values_are_below_their_level_no_more_often_than_stated(nulls, level):
    alarms = sum(min(s.p_family for s in found) < level for found in nulls)
    assert alarms <= binom.ppf(0.999, len(nulls), level)


def test_family_wise_p_values_are_not_blind_either(nulls):
    """A test that never alarms would hold every level."""
    assert np.median([min(s.p_family for s in found) for found in nulls]) < 0.9
    coulomb = screened(fitted(axis_records(9, {"coulomb@slide": {"level": 6.0, "width": 0.02}})))
    assert coulomb[0].p_family < 1e-3
    assert coulomb[0].key in ("coulomb@slide", "asymmetric-friction@slide")


def test_the_p_value_of_one_effect_is_uniform_where_nothing_is_missing(nulls):
    own = [next(s.p_value for s in found if s.key.startswith("offset@")) for found in nulls]
    assert kstest(own, "uniform").pvalue > 1e-3


def test_the_family_wise_p_value_is_never_below_the_effects_own(nulls):
    """Trap 9: a tail fitted too steep makes the smallest of many p-values smaller than each."""
    for found in nulls:
        for s in found:
            assert s.p_family >= 0.999 * s.p_value


def test_what_acts_alike_is_alike_and_what_does_not_is_not():
    model = fitted(robot_records(1, samples=600))
    sizes = small_sizes(model.predictor, model.fit)
    keys = ["offset@u", "rail-tilt@rail", "imbalance@rail", "sensor-lag@v"]
    tried = [variants(model.predictor, model.fit, [key], sizes)[0] for key in keys]
    made = signatures(model.predictor, model.fit, tried, sizes, columns=True)
    shared = similarity(made)
    np.testing.assert_allclose(shared, shared.T)
    np.testing.assert_allclose(np.diag(shared), 1.0)
    assert shared[0, 1] == pytest.approx(1.0, abs=1e-6)  # on this machine they are one and the same force
    assert shared[0, 2] < 0.2
    assert shared[0, 3] < 0.1
    # one column: the square of the cosine of the angle between the two
    a, b = made[0].columns[:, 0], made[3].columns[:, 0]
    assert shared[0, 3] == pytest.approx((a @ b) ** 2 / (a @ a) / (b @ b), rel=1e-9)


def test_every_effect_of_the_catalogue_is_tried_and_scored():
    model = fitted(robot_records(2))
    tried = variants(model.predictor, model.fit, keys_of(model), small_sizes(model.predictor, model.fit))
    assert {v.key for v in tried} == {s.key for s in ROBOT.slots}


def test_scores_of_nothing_are_none():
    assert scores([]) == []
