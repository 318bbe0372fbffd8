"""Left out means refitted without: exactly, where one step of Gauss-Newton is exact."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from tests.workbench.diagnosis.cases import AXIS, axis_predictor, axis_records, fitted, refitted
from workbench.data import Dataset
from workbench.diagnosis.confirm import ORDER, PIECES, LeftOut, folds, left_out, left_out_points, stability
from workbench.diagnosis.fit import Fit, gauss_newton, term
from workbench.diagnosis.gains import HORIZONS, errors_left_out, errors_on
from workbench.diagnosis.kalman import Pass
from workbench.diagnosis.predictor import predictor
from workbench.diagnosis.recalibrate import unknowns
from workbench.diagnosis.refit import Model

OFFSET = "offset@F"


def linear(data: Dataset, key: str | None = None, guess=None) -> Model:
    """Only starts and an offset are fitted: with held gains the errors are linear in both."""
    made = axis_predictor(data)
    own = unknowns(made, names=())
    base = Model(made, gauss_newton(made, own, own.zero(), np.zeros(len(AXIS.slots)), rounds=4, enough=1e-9))
    return base if key is None else refitted(base, key, guess or [1.0], names=())


def maps(model: Model, i: int):
    """(e, J): errors of record i at all unknowns 0, and what one of each adds: its start (2), then the effect's sizes."""
    own, made = model.fit.unknowns, model.predictor

    def errors(z):
        q = own.point(z)
        return made.errors(i, q.p[None], q.eta[i][None], q.start[i][None])[0].ravel()

    z = np.zeros(own.size)
    e = errors(z)
    units = np.eye(own.size)[own.columns(i)]
    return e, np.column_stack([errors(unit) - e for unit in units])


def surprise_of(model: Model, i: int) -> float:
    """-2 log p(y_i | the others) but for constants: all that the others leave open widens the prediction; dense matrices."""
    records, own = len(model.predictor.records), model.fit.unknowns
    z = model.fit.z
    prior = np.concatenate([np.ones(2 * records), 1.0 / (ORDER * z[2 * records :]) ** 2])
    A, b = np.diag(prior), np.zeros(own.size)
    for j in range(records):
        if j != i:
            e, J = maps(model, j)
            wide = np.zeros((len(e), own.size))
            wide[:, own.columns(j)] = J
            A, b = A + wide.T @ wide, b - wide.T @ e
    e, J = maps(model, i)
    wide = np.zeros((len(e), own.size))
    wide[:, own.columns(i)] = J
    expected = e + wide @ np.linalg.solve(A, b)
    spread = np.eye(len(e)) + wide @ np.linalg.solve(A, wide.T)
    return float(expected @ np.linalg.solve(spread, expected) + np.linalg.slogdet(spread)[1])


def test_what_is_left_out_is_predicted_from_the_others_with_all_that_they_leave_open():
    data = axis_records(1, {OFFSET: {"level": 1.5}}, records=3, samples=150, start={"v": 0.2})
    base, extended = linear(data), linear(data, OFFSET)
    found = left_out(base, extended)
    exact = [surprise_of(base, i) - surprise_of(extended, i) for i in range(3)]
    np.testing.assert_allclose(found.by_fold, exact, rtol=1e-4, atol=1e-4)
    assert found.total == pytest.approx(sum(exact), rel=1e-4)
    # it is not what the fit of all records gains
    inside = [np.sum(b**2) - np.sum(e**2) for b, e in zip(base.fit.errors, extended.fit.errors, strict=True)]
    assert sum(inside) > found.total + 0.1


def test_parameters_that_only_the_record_left_out_would_tell_do_not_hide_an_effect():
    """A still record tells neither mass nor friction: what it foresees of the other is vague, with the effect and without."""
    moving = axis_records(31, {"sensor-lag@q": {"time": 0.01}}, records=1)
    still = axis_records(32, {"sensor-lag@q": {"time": 0.01}}, records=1, force=20.0)
    base = fitted(Dataset((*moving, *(replace(e, name="still") for e in still))))
    assert left_out(base, refitted(base, "sensor-lag@q", [0.01])).holds


@pytest.mark.slow
def test_a_true_effect_holds_on_what_was_left_out_and_one_that_is_not_there_does_not():
    data = axis_records(2, {OFFSET: {"level": 5.0}}, records=3)
    assert left_out(linear(data), linear(data, OFFSET)).holds
    absent = [axis_records(20 + seed, records=3) for seed in range(8)]
    totals = [left_out(linear(d), linear(d, OFFSET)) for d in absent]
    assert sum(t.holds for t in totals) <= 1
    assert np.mean([t.total for t in totals]) < 1.0  # on the average one number too many loses


def test_one_lucky_record_is_not_enough():
    assert LeftOut(np.array([9.0, 1.0, 2.0]), 2.0).holds
    assert not LeftOut(np.array([30.0, -1.0, -2.0]), 2.0).holds
    assert not LeftOut(np.array([1.0, 1.0, 1.0]), 2.0).holds


def test_a_single_record_is_left_out_in_pieces():
    data = axis_records(3, {OFFSET: {"level": 6.0}}, records=1, samples=600)
    base, extended = linear(data), linear(data, OFFSET)
    cut = folds(base)
    assert [f.first for f in cut] == [0, 150, 300, 450]
    assert [f.last for f in cut] == [150, 300, 450, 600]
    assert len(cut) == PIECES
    assert left_out(base, extended).holds


def wobbling(amplitudes) -> list:
    """An imbalance of these amplitudes, in every record at another angle."""
    return [
        {"imbalance@slide": {"cosine": a * np.cos(turn), "sine": a * np.sin(turn)}}
        for a, turn in zip(amplitudes, (0.3, 2.0, -2.0), strict=True)
    ]


def wobble(seed, amplitudes):
    base = fitted(axis_records(seed, wobbling(amplitudes), records=3, force=25.0, samples=400))
    return base, refitted(base, "imbalance@slide", [6.0, 2.0], rounds=12)


@pytest.mark.slow
def test_a_phase_is_found_on_the_record_that_was_left_out_whichever_it_is():
    for seed in (4, 5, 6):
        found = left_out(*wobble(seed, (8.0, 8.0, 8.0)))
        assert found.holds
        assert np.all(found.by_fold > 0.0)  # the first record's zero is that of all rotations


@pytest.mark.slow
def test_the_amplitude_of_a_periodic_effect_is_tested_for_stability_and_its_phase_is_not():
    assert min(stability(wobble(seed, (8.0, 8.0, 8.0))[1], "imbalance@slide") for seed in (4, 5, 6)) > 1e-3
    assert stability(wobble(4, (16.0, 3.0, 3.0))[1], "imbalance@slide") < 1e-3


def sizes_differ(seed, levels) -> float:
    data = axis_records(seed, [{OFFSET: {"level": level}} for level in levels], records=len(levels))
    return stability(linear(data, OFFSET), OFFSET)


@pytest.mark.slow
def test_a_size_that_differs_between_records_is_unstable_and_one_that_does_not_is_stable():
    assert sizes_differ(5, (10.0, -10.0)) < 1e-4
    assert sizes_differ(5, (14.0, 6.0, 2.0)) < 1e-4
    same = [sizes_differ(500 + seed, (6.0, 6.0)) for seed in range(25)]
    assert kstest(same, "uniform").pvalue > 1e-3


def test_stability_is_the_chi_squared_of_a_size_for_every_record():
    data = axis_records(6, [{OFFSET: {"level": 5.0}}, {OFFSET: {"level": 2.0}}])
    model = linear(data, OFFSET)
    alone = []  # (size, information) of each record, its start projected out
    for i in range(2):
        e, J = maps(model, i)
        A, c = J.T @ J + np.diag([1.0, 1.0, 0.0]), J.T @ e
        S = A[2, 2] - A[2, :2] @ np.linalg.solve(A[:2, :2], A[:2, 2])
        alone.append((-(c[2] - A[2, :2] @ np.linalg.solve(A[:2, :2], c[:2])) / S, S))
    (a, Sa), (b, Sb) = alone
    chi = (a - b) ** 2 / (1 / Sa + 1 / Sb)
    from scipy.stats import chi2

    # blocks that vary more than white errors would weaken the evidence, nothing strengthens it
    assert stability(model, OFFSET) >= chi2.sf(chi, 1) * (1 - 1e-6)
    assert stability(model, OFFSET) < chi2.sf(chi / 2, 1)


def test_an_effect_of_one_record_only_has_no_stability_to_test():
    data = axis_records(7, [{OFFSET: {"level": 5.0}}, None])
    model = linear(data, OFFSET)
    silent = replace(model.fit, jacobian=(model.fit.jacobian[0], np.zeros_like(model.fit.jacobian[1])))
    assert stability(Model(model.predictor, silent), OFFSET) == 1.0


def test_a_size_at_its_bound_of_0_can_be_left_out_too():
    data = axis_records(8)
    base = fitted(data)
    extended = refitted(base, "coulomb@slide", [0.0])
    at = extended.fit.unknowns.size - extended.fit.unknowns.split[2]
    z = extended.fit.z.copy()
    z[at] = 0.0
    none = Model(extended.predictor, replace(extended.fit, z=z))
    assert not left_out(base, none).holds


@pytest.mark.slow
def test_a_record_of_a_second_has_a_standard_error_too():
    held = []
    for seed in range(12):
        data = axis_records(300 + seed, records=1, samples=60)
        held.append(left_out(linear(data), linear(data, OFFSET)))
    assert all(found.error > 0.0 for found in held)
    assert sum(found.holds for found in held) <= 2


# ---- two outputs -----------------------------------------------------------------------------------------------------

SAMPLES = 160
PULL = np.array([0.3, 2.0])  # what a unit of the size does to either output, at most


def two_outputs(seed, records, key=None, *, level=1.0, silent=False) -> Model:
    """A model whose errors of two outputs are linear in starts and one size, from random numbers; no plant is run.

    silent: the second output measures nothing, and what is left is a model of one output written as one of two.
    """
    random, levels = np.random.default_rng(seed), np.random.default_rng([seed, key is None])  # models have noise of their own
    made = axis_predictor(axis_records(1, records=records, samples=SAMPLES))
    own = unknowns(made, () if key is None else (term(AXIS, key),), names=())
    slopes, errors, passes = [], [], []
    for _ in range(records):
        start, size = random.standard_normal((SAMPLES, 2, 2)) * 0.3, PULL * random.uniform(0.2, 1.0, (SAMPLES, 2))
        spread = levels.uniform(0.5, 2.0, (SAMPLES, 2))
        e = random.standard_normal((SAMPLES, 2)) - level * size
        if silent:
            start[:, 1], size[:, 1], e[:, 1], spread[:, 1] = 0.0, 0.0, 0.0, 1.0
        slopes.append(np.concatenate([start, size[:, :, None]], axis=2)[:, :, : 2 + (key is not None)].reshape(2 * SAMPLES, -1))
        errors.append(e)
        passes.append(Pass(np.empty((SAMPLES, 0, 2)), np.einsum("ki,ij->kij", spread, np.eye(2)), 0.0))
    return _at_its_minimum(Model(replace(made, passes=tuple(passes)), Fit(own, np.zeros(own.size), tuple(errors), tuple(slopes))))


def _at_its_minimum(model: Model) -> Model:
    fit, own = model.fit, model.fit.unknowns
    z = -np.linalg.solve(fit.information, fit.gradient)
    errors = [e + (J @ z[own.columns(i)]).reshape(e.shape) for i, (e, J) in enumerate(zip(fit.errors, fit.jacobian, strict=True))]
    return Model(model.predictor, replace(fit, z=z, errors=tuple(errors)))


def one_output(model: Model) -> Model:
    """The same without the second output."""
    fit = model.fit
    passes = tuple(replace(p, gain=p.gain[:, :, :1], whitening=p.whitening[:, :1, :1]) for p in model.predictor.passes)
    errors, J = tuple(e[:, :1] for e in fit.errors), tuple(J[::2] for J in fit.jacobian)
    return Model(replace(model.predictor, passes=passes), replace(fit, errors=errors, jacobian=J))


def foreseen(model: Model, left: np.ndarray) -> float:
    """-2 log p of the rows that are left out (of all rows of all records) in the light of the others, by dense Gaussians."""
    fit, own = model.fit, model.fit.unknowns
    J, e = np.zeros((2 * SAMPLES * own.records, own.size)), np.concatenate([e.ravel() for e in fit.errors])
    for i, slopes in enumerate(fit.jacobian):
        J[np.ix_(np.arange(2 * SAMPLES) + 2 * SAMPLES * i, own.columns(i))] = slopes
    at_zero = e - J @ fit.z  # of all unknowns
    size = fit.z[2 * own.records :]
    prior = np.diag(np.concatenate([np.ones(2 * own.records), (ORDER * np.linalg.norm(size)) ** 2 * np.ones(len(size))]))
    S = np.eye(len(e)) + J @ prior @ J.T
    W = np.concatenate([np.einsum("kii->ki", p.whitening).ravel() for p in model.predictor.passes])

    def deviance(rows):
        return (
            float(at_zero[rows] @ np.linalg.solve(S[np.ix_(rows, rows)], at_zero[rows]))
            + np.linalg.slogdet(S[np.ix_(rows, rows)])[1]
        )

    every = np.ones(len(e), dtype=bool)
    return deviance(every) - deviance(~left) - 2.0 * float(np.log(W[left]).sum())


@pytest.mark.slow
@pytest.mark.parametrize("records", [1, 3])
def test_of_two_outputs_every_sample_of_a_fold_is_left_out_and_no_other(records):
    base, extended = (two_outputs(5, records, key, level=0.2) for key in (None, OFFSET))
    exact = []
    for fold in folds(extended):
        left = np.zeros((records, SAMPLES, 2), dtype=bool)
        left[fold.record, fold.first : fold.last] = True
        exact.append(foreseen(base, left.ravel()) - foreseen(extended, left.ravel()))
    np.testing.assert_allclose(left_out(base, extended).by_fold, exact, rtol=1e-6, atol=1e-6)
    assert len(exact) == (PIECES if records == 1 else records)


@pytest.mark.parametrize("records", [1, 2])
def test_an_output_that_shows_nothing_changes_neither_what_is_left_out_nor_stability(records):
    models = [two_outputs(8, records, key, level=0.3, silent=True) for key in (None, OFFSET)]
    two, one = left_out(*models), left_out(*map(one_output, models))
    np.testing.assert_allclose(two.by_fold, one.by_fold, rtol=1e-9)
    assert two.error == pytest.approx(one.error, rel=1e-9)
    p = stability(models[1], OFFSET), stability(one_output(models[1]), OFFSET)
    assert p[0] == pytest.approx(p[1], rel=1e-9)
    assert 1e-6 < p[0] < 1.0


def test_a_size_that_only_the_second_output_shows_to_change_within_a_record_is_unstable():
    same, changed = (two_outputs(11, 1, OFFSET, level=0.0, silent=False) for _ in range(2))
    fit = changed.fit
    jump = np.where(np.arange(SAMPLES) < SAMPLES // 4, 0.0, 1.5)  # the first of four pieces differs
    e = fit.errors[0].copy()
    e[:, 1] -= jump * fit.jacobian[0].reshape(SAMPLES, 2, 3)[:, 1, 2]
    zero = replace(fit, z=np.zeros_like(fit.z), errors=(e - (fit.jacobian[0] @ fit.z).reshape(e.shape),))
    assert stability(same, OFFSET) > 0.01
    assert stability(_at_its_minimum(Model(changed.predictor, zero)), OFFSET) < 1e-3


# ---- parts that the fit leaves out ------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_what_a_fit_finds_without_a_part_is_what_it_finds_on_the_others():
    """By the step from the fit to all, and by a fit to records of which that part is cut off."""
    data = axis_records(12, parameters={"M": 100.0, "Fv": 180.0}, records=4, samples=400)
    model = fitted(data)
    found = left_out_points(model)
    assert [(f.record, f.first, f.last) for f, _ in found] == [(i, k, k + 200) for i in range(4) for k in (0, 200)]
    off, moved = [], []
    for fold, point in found:
        left = slice(fold.last, 400) if fold.first == 0 else slice(0, fold.first)
        cut = [replace(e, t=e.t[left], values=e.values[left]) if i == fold.record else e for i, e in enumerate(data)]
        other = predictor(AXIS, Dataset(tuple(cut)))
        other = other.regained(other.point, model.predictor.noise)
        own = unknowns(other)
        alone = gauss_newton(other, own, own.zero(), np.zeros(len(AXIS.slots)), rounds=6).point.p
        off.append(point.p / alone - 1.0)
        moved.append(model.fit.point.p / alone - 1.0)
    assert np.linalg.norm(off) < 0.2 * np.linalg.norm(moved)


@pytest.mark.slow
def test_parts_cover_every_record_once():
    for records in (1, 2, 3, 5):
        model = fitted(axis_records(13, records=records, samples=240))
        covered = [np.zeros(240, dtype=int) for _ in range(records)]
        for fold, _ in left_out_points(model):
            covered[fold.record][fold.first : fold.last] += 1
        assert all((c == 1).all() for c in covered)


@pytest.mark.slow
def test_errors_on_parts_that_were_left_out_are_those_of_other_parameters_and_larger():
    """On average: what a fit has seen it errs less on than what it has not."""
    seen, unseen = [], []
    for seed in range(8):
        data = axis_records(40 + seed, parameters={"M": 100.0, "Fv": 180.0}, records=1, samples=120)
        model = fitted(data)
        for of, held in ((seen, errors_on(model, data)), (unseen, errors_left_out(model))):
            of.append({s.horizon: s.error for s in held.scores})
    ratio = {h: np.mean([u[h] / s[h] for s, u in zip(seen, unseen, strict=True)]) for h in HORIZONS}
    assert 1.0 < ratio["one-step"] < 1.1  # the first part has its start
    assert 1.02 < ratio["full-run"] < 3.0
