"""Gauss-Newton against scipy, and its intervals against what chance does to many records."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.stats import chi2

from tests.strangers.two_mass import PLANT as PLAY
from tests.workbench.diagnosis.cases import (
    AXIS,
    axis_predictor,
    axis_records,
    fitted,
    keys_of,
    noise,
    refitted,
    robot_records,
    steps,
    with_effect,
)
from workbench.data import Channel, Dataset
from workbench.diagnosis.fit import Term, gauss_newton, jacobian, sharpened, small_steps, term
from workbench.diagnosis.normal import inverse
from workbench.diagnosis.predictor import Noise, predictor
from workbench.diagnosis.recalibrate import recalibrated, unknowns
from workbench.diagnosis.screen import small_sizes, variants
from workbench.physics.controller import Playback
from workbench.physics.effects import Slide
from workbench.physics.effects.effect import GridUnit
from workbench.physics.parameters import Parameter
from workbench.physics.plant import Plant
from workbench.simulation import Scenario, simulate

NONE = np.zeros(len(AXIS.slots))


def slot(name: str) -> int:
    return [str(s) for s in AXIS.slots].index(name)


def residuals(made, own):
    """z -> whitened errors and prior, as one vector: what the fit says it minimises, from the predictor alone."""

    def vector(z):
        q = own.point(z)
        e = [made.errors(i, q.p[None], q.eta[i][None], q.start[i][None])[0].ravel() for i in range(len(made.records))]
        return np.concatenate([*e, z[own.believed]])

    return vector


@pytest.mark.parametrize(("key", "guess"), [("offset@F", [5.0]), ("coulomb@slide", [20.0]), ("imbalance@slide", [3.0, -4.0])])
def test_gauss_newton_ends_where_scipy_does(key, guess):
    effects = {"coulomb@slide": {"level": 30.0, "width": 0.02}, "imbalance@slide": {"cosine": 6.0}}
    data = axis_records(1, effects, samples=150, parameters={"M": 105.0, "Fv": 150.0})
    base = fitted(data)
    own, z, sizes = with_effect(base, key, guess)
    own = replace(own, terms=(replace(own.terms[0], free=tuple(i for i in own.terms[0].shapes)),))
    z = np.concatenate([z, np.zeros(own.size - len(z))])
    z[own.size - own.split[2] :][: len(guess)] = guess
    fit = gauss_newton(base.predictor, own, z, sizes, rounds=12, enough=1e-8)
    vector = residuals(base.predictor, own)
    assert fit.cost == pytest.approx(np.sum(vector(fit.z) ** 2), rel=1e-12)
    step = np.maximum(1e-6, 1e-6 * np.abs(z))
    theirs = least_squares(vector, z, x_scale="jac", diff_step=1e-5, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert fit.cost < 2 * theirs.cost + 1e-3
    sd = np.sqrt(np.diag(fit.covariance))
    assert np.all(np.abs(fit.z - theirs.x) < 0.03 * sd + step)


@pytest.mark.slow
def test_the_covariance_is_the_spread_of_the_estimate_over_truths_drawn_from_the_prior():
    n, distances, shifts = 50, [], []
    random = np.random.default_rng(5)
    for seed in range(n):
        truth = random.standard_normal(2)
        sigma = np.array([q.tolerance for q in AXIS.parameters]) / np.sqrt(3.0)
        M, Fv = AXIS.nominal * np.exp(sigma * truth)
        v0 = random.standard_normal()
        data = axis_records(seed, samples=120, records=1, parameters={"M": M, "Fv": Fv}, start={"v": v0})
        made = axis_predictor(data)
        own = unknowns(made)
        fit = gauss_newton(made, own, own.zero(), NONE, rounds=4, enough=1e-3)
        made = made.regained(fit.point, noise())
        fit = gauss_newton(made, own, fit.z, NONE, rounds=4, enough=1e-3)
        keep = [0, 1, 3]  # masses, friction and starting speed; the position of the start has no prior worth the name
        d = fit.z[keep] - [*truth, (v0 - made.records[0].start[1]) / made.records[0].scale[1]]
        distances.append(d @ np.linalg.solve(fit.covariance[np.ix_(keep, keep)], d))
        shifts.append(d / np.sqrt(np.diag(fit.covariance)[keep]))
    low, high = chi2.ppf([5e-4, 1 - 5e-4], 3 * n)
    assert low < np.sum(distances) < high  # too wide an interval fails as too narrow a one does
    assert np.all(np.abs(np.mean(shifts, axis=0)) < 3.5 / np.sqrt(n))
    assert fit.covariance[0, 0] < 0.05  # and it is not the prior that was tested


def test_records_share_an_amplitude_and_each_has_its_own_rotation():
    turned, amplitude = np.array([0.4, 2.1, -1.3]), 8.0
    each = [{"imbalance@slide": {"cosine": amplitude * np.cos(a), "sine": amplitude * np.sin(a)}} for a in turned]
    model = refitted(fitted(axis_records(2, each, records=3)), "imbalance@slide", [5.0, 5.0], rounds=12)
    cosine, sine, *rotations = model.fit.unknowns.of_terms(model.fit.z)[0]
    assert len(rotations) == 2
    assert np.hypot(cosine, sine) == pytest.approx(amplitude, rel=0.15)
    found = np.arctan2(sine, cosine) + np.concatenate([[0.0], rotations])
    np.testing.assert_allclose(np.angle(np.exp(1j * (found - turned))), 0.0, atol=0.25)
    eta = model.fit.point.eta[:, list(model.terms[0].sizes)]
    np.testing.assert_allclose(np.hypot(*eta.T), np.hypot(cosine, sine), rtol=1e-12)


@pytest.mark.slow
def test_a_friction_that_would_have_to_drive_the_slide_stays_at_its_bound_with_the_gradient_outwards():
    at_bound = 0
    for seed in range(8):
        model = refitted(fitted(axis_records(seed)), "coulomb@slide", [5.0])
        size = model.fit.z[-1]
        assert size >= 0.0
        at_bound += size < 1e-6
        if size < 1e-6:
            assert model.fit.gradient[-1] >= -1e-6
    assert 1 <= at_bound <= 7  # else the bound was never met, or never left


@pytest.fixture(scope="module")
def two_terms():
    made = predictor(AXIS, axis_records(1, samples=60))
    free = (slot("stribeck@slide:speed"), slot("stribeck@slide:width"))
    return unknowns(made, (term(AXIS, "stribeck@slide", free), term(AXIS, "imbalance@slide")))


numbers = st.lists(st.floats(-40.0, 40.0), min_size=12, max_size=12)


@given(numbers)
@settings(max_examples=60)
def test_no_vector_of_unknowns_leaves_the_bounds_of_effects_and_what_is_inside_is_left_alone(two_terms, values):
    z = np.array(values)
    assert two_terms.size == len(z)
    AXIS.check_effects(two_terms.point(np.clip(z, -5, 5)).eta)
    clipped = two_terms.clip(z)
    np.testing.assert_array_equal(two_terms.clip(clipped), clipped)
    inside = z.copy()
    inside[6] = abs(z[6])  # the level of a friction
    inside[7:9] = np.clip(z[7:9], -3.0, 3.0)  # logarithms of shapes
    np.testing.assert_array_equal(two_terms.clip(inside), inside)


@given(numbers)
@settings(max_examples=40)
def test_the_vector_of_a_point_is_the_vector_that_gave_it(two_terms, values):
    z = two_terms.clip(np.clip(np.array(values), -3.0, 3.0))
    again = two_terms.vector(two_terms.point(z), two_terms.of_terms(z))
    np.testing.assert_allclose(again, z, rtol=1e-9, atol=1e-9)


def test_only_what_a_data_sheet_or_a_shape_says_has_a_prior(two_terms):
    # 2 parameters, 2 records of 2 states | level, 2 shapes | cosine, sine, 1 rotation
    assert two_terms.believed.tolist() == [True] * 6 + [False, True, True] + [False] * 3


def test_a_record_sees_its_own_start_and_none_of_the_others(two_terms):
    assert two_terms.columns(0).tolist() == [0, 1, 2, 3, 6, 7, 8, 9, 10, 11]
    assert two_terms.columns(1).tolist() == [0, 1, 4, 5, 6, 7, 8, 9, 10, 11]


def test_the_jacobian_is_the_slope_of_the_errors_also_at_a_bound():
    base = fitted(axis_records(3, samples=100))
    own, z, sizes = with_effect(base, "coulomb@slide", [0.0])
    e, J = jacobian(base.predictor, own, z, sizes)
    np.testing.assert_allclose(e[1], base.predictor.at(own.point(z))[1])
    for i in range(2):
        for c, j in enumerate(own.columns(i)):
            step = 1e-4 if j < own.size - 1 else 1e-3
            ahead = base.predictor.at(own.point(z + step * (np.arange(own.size) == j)))[i]
            slope = ((ahead - e[i]) / step).ravel()
            np.testing.assert_allclose(J[i][:, c], slope, rtol=0.02, atol=0.02 * np.abs(slope).max() + 1e-9)
    # errors that are known already need no run, and what is taken over stays
    fixed = own.split[0] + own.split[1]
    at, again = jacobian(base.predictor, own, z, sizes, (), e)
    held, kept = jacobian(base.predictor, own, z, sizes, [2.0 * j for j in J], e)
    for i in range(2):
        np.testing.assert_array_equal(at[i], e[i])
        np.testing.assert_array_equal(held[i], e[i])
        np.testing.assert_array_equal(again[i], J[i])
        np.testing.assert_array_equal(kept[i][:, :fixed], 2.0 * J[i][:, :fixed])
        np.testing.assert_array_equal(kept[i][:, fixed:], J[i][:, fixed:])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_the_jacobian_of_a_start_is_the_slope_of_the_errors_where_a_machine_with_play_begins_at_rest(seed):
    """The filter's linearization along what it corrected has other slopes: a fit by it ends where nothing is stationary."""
    random, records = np.random.default_rng(seed), []
    for i in range(2):
        voltage = np.repeat(random.uniform(-5.0, 5.0, 20), 30)
        voltage[:200] = 0.0
        run = simulate(PLAY, Playback(("V",), PLAY.dt), Scenario(f"run {i}", {"V": voltage}, seed=i), substeps=8)
        records.append(run.experiment)
    base = recalibrated(predictor(PLAY, Dataset(tuple(records))))
    own, z = base.fit.unknowns, base.fit.z
    _, J = jacobian(base.predictor, own, z, np.zeros(len(PLAY.slots)))
    n, nx, _ = own.split
    for i in range(2):
        for c in range(n, n + nx):
            move = 1e-3 * (np.arange(own.size) == own.columns(i)[c])
            ahead, behind = (base.predictor.at(own.point(z + s * move))[i].ravel() for s in (1.0, -1.0))
            slope = (ahead - behind) / 2e-3
            assert np.linalg.norm(J[i][:, c] - slope) < 0.3 * np.linalg.norm(slope)  # to one side, across kinks


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_what_only_counts_as_ratios_is_known_no_better_than_the_data_sheet_knows_their_common_scale(seed):
    """m v' = K i - b v - friction: times any number it is the same machine, and free runs, however exact, cannot know it."""
    random = np.random.default_rng(seed)
    tolerances = random.uniform(0.02, 0.3, 3)
    true = np.array([420.0, 95.0, 58.0]) * np.exp(random.uniform(-1.0, 1.0, 3) * tolerances)
    plant = Plant(
        "hoist",
        (Channel("x", "m"), Channel("v", "m/s")),
        (Channel("i", "A", "input"),),
        (Channel("position", "m", "output"), Channel("speed", "m/s", "output")),
        tuple(Parameter(name, value, "", t) for name, value, t in zip("mbK", (420.0, 95.0, 58.0), tolerances, strict=True)),
        lambda x, u, p, at: {"x": x.v, "v": (p.K * u.i - p.b * x.v + at.car.torque()) / p.m},
        lambda x, p: {"position": x.x, "speed": x.v},
        0.01,
        ports=(Slide("car", "v"),),
        noise={"position": 1e-4, "speed": 1e-3},
    )
    run = simulate(
        plant,
        Playback(("i",), plant.dt),
        Scenario("trip", {"i": steps(2500, 6.0, seed, hold=100)}, seed=seed),
        parameters=dict(zip("mbK", true, strict=True)),
        effects={"coulomb@car": {"level": 70.0, "width": 0.01}},
    )
    at = replace(predictor(plant, Dataset((run.experiment,))), simulated=True)
    at = at.with_noise(Noise(np.array([1e-4, 1e-3]), np.zeros(1), np.empty(0)))
    own = unknowns(at, [term(plant, "coulomb@car")])
    level = own.places[0].start
    z = np.zeros(own.size)
    z[level] = 60.0
    fit = sharpened(at, gauss_newton(at, own, z, small_steps(own, z), rounds=8))
    sd = np.sqrt(np.diag(fit.covariance))
    scale = np.sum(1.0 / own.sigma**2) ** -0.5  # of the logarithm
    np.testing.assert_allclose([*(own.sigma * sd[:3]), sd[level] / fit.z[level]], scale, rtol=0.01)


def test_a_shape_belongs_to_one_effect_only():
    terms = [term(AXIS, key) for key in dict.fromkeys(s.key for s in AXIS.slots)]
    taken = [i for t in terms for i in (*t.sizes, *t.shapes)]
    assert sorted(taken) == list(range(len(AXIS.slots)))


def test_an_effect_with_a_phase_costs_two_numbers_and_one_for_every_further_record():
    assert Term("imbalance@slide", (0, 1), (), phase=True).count(4) == 5
    assert Term("stribeck@slide", (0,), (1, 2), (1, 2)).count(4) == 3


def test_directions_without_information_stay_finite_and_leave_the_others_alone():
    found = inverse(np.diag([4.0, 0.0, 1e-30]))
    assert np.all(np.isfinite(found))
    assert found[0, 0] == pytest.approx(0.25)
    units = np.array([1e-6, 1.0, 1e8])  # of any size
    J = np.random.default_rng(0).standard_normal((5, 3))
    np.testing.assert_allclose(inverse((J * units).T @ (J * units)) * np.outer(units, units), np.linalg.inv(J.T @ J), rtol=1e-9)


@pytest.mark.parametrize("records", [axis_records, robot_records])
def test_every_effect_at_a_size_has_the_slopes_that_the_errors_show(records):
    """The step to the limit of an amplifier was 1e-24 of its unit, its slopes 0, and no limit was ever fitted."""
    model = fitted(records(3))
    made, plant = model.predictor, model.predictor.plant
    sizes = small_sizes(made, model.fit)
    # a rounded reading is told by its values, not by a fit
    every = variants(made, model.fit, keys_of(model), sizes)[::-1]  # of each the first: no gain follows what rings for long
    tried = {v.key: v for v in every if not v.key.startswith("quantisation")}
    assert len(tried) > 15
    for key, v in tried.items():
        own, z, _ = with_effect(model, key, [5.0 * sizes[s] if np.isnan(v.finite) else v.finite for s in v.sizes])
        base = own.base.copy()
        for i, shape in v.shapes:
            if plant.slots[i].parameter.grid_unit is GridUnit.RECORD:  # what sets in does so within the record
                base[i] = shape
        own = replace(own, base=base)
        fitted_by, other = (jacobian(made, own, z, step)[1] for step in (sizes, 10.0 * small_steps(own, z)))
        for j in range(own.places[0].start - own.size, 0):
            found, expected = (np.concatenate([J[:, j] for J in Js]) for Js in (fitted_by, other))
            assert np.linalg.norm(expected) > 0.0
            assert np.linalg.norm(found - expected) < 0.15 * np.linalg.norm(expected), (key, j, plant.name)
