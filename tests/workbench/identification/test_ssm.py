"""SSM against recursions written here: exact delays, recovery, the set membership guarantee, notes and refusals."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from workbench.basis import Gaussian, PiecewiseLinear, Powers
from workbench.data import Dataset, Experiment
from workbench.errors import InputError
from workbench.identification.sparse import L2, LInf
from workbench.identification.ssm import SSM, FittedZero, Plain, RawSignals, ScheduledMean, UnitColumns
from workbench.lpv import load_model
from workbench.metrics import score

BOTH = pytest.mark.parametrize("bound", [L2(), LInf()], ids=["l2", "linf"])
BASIS = Powers((0, 1, -1))
RAW = RawSignals()


def record_of(name, u, y, p):
    return Experiment.from_arrays(
        name,
        0.1,
        inputs={f"u{i}": c for i, c in enumerate(u.T)},
        outputs={f"y{i}": c for i, c in enumerate(y.T)},
        schedule={"p": p},
    )


def fit_of(truth, run):
    return 100 * (1 - np.linalg.norm(truth - run) / np.linalg.norm(truth - truth.mean(axis=0)))


def simulated(step, seed, N=200, ny=1, nu=1, n=3, noise=0.0, zero=0.0, margin=0.0):
    """A record of y(k) = step(k, y, u, p) + d(k), |d| <= noise; the schedule jumps about in [0.6, 1.6] less a margin."""
    rng = np.random.default_rng(seed)
    p = rng.uniform(0.6 + margin, 1.6 - margin, N)
    u = rng.uniform(-1, 1, (N, nu))
    y = rng.uniform(-1, 1, (N, ny))
    d = rng.uniform(-noise, noise, (N, ny))
    for k in range(n, N):
        y[k] = step(k, y, u, p) + d[k]
    return record_of(f"r{seed}", u, y + zero, p), d[n:]


def third_order(k, y, u, p):
    # every lag has its own functions of its own delayed schedule: p(k-3) for outputs, p(k-i) for inputs
    q = p[k - 3]
    return (
        (0.4 * q) * y[k - 1]
        - (0.3 / q) * y[k - 2]
        + 0.15 * y[k - 3]
        + (1.0 - 0.5 * p[k - 1]) * u[k - 1]
        + (0.7 / p[k - 2]) * u[k - 2]
        + (0.2 * p[k - 3]) * u[k - 3]
    )


THIRD_ORDER = {
    "y0: y0(k-1) rho": 0.4,
    "y0: y0(k-2) rho^-1": -0.3,
    "y0: y0(k-3)": 0.15,
    "y0: u0(k-1)": 1.0,
    "y0: u0(k-1) rho": -0.5,
    "y0: u0(k-2) rho^-1": 0.7,
    "y0: u0(k-3) rho": 0.2,
}


def two_by_two(k, y, u, p):
    q = p[k - 2]
    return np.array([
        0.5 * q * y[k - 1, 0] - 0.2 * y[k - 2, 1] + u[k - 1, 0] / p[k - 1] + 0.4 * u[k - 2, 1],
        0.3 / q * y[k - 1, 1] + 0.25 * q * y[k - 2, 0] - 0.6 * p[k - 2] * u[k - 2, 0] + u[k - 1, 1],
    ])  # fmt: skip


def coefficients(model):
    return {e.name: e.value for e in model.estimates}


# ---- defining equations ---------------------------------------------------------------------------------------------


@BOTH
@pytest.mark.parametrize(
    ("step", "size", "n", "basis"),
    [
        (third_order, 1, 3, BASIS),
        (two_by_two, 2, 2, BASIS),
        # without a constant function the shift needs one of its own; hats add up to it
        (lambda k, y, u, p: 0.5 * p[k - 2] * y[k - 1] + u[k - 2] / p[k - 2], 1, 2, Powers((1, -1))),
        (lambda k, y, u, p: 0.4 * p[k - 2] * y[k - 2] + p[k - 1] * u[k - 1], 1, 2, PiecewiseLinear((0.0, 2.0))),
    ],
    ids=["siso", "mimo", "powers without constant", "hats"],
)
def test_free_run_of_the_model_is_the_recursion_however_fast_the_schedule_moves(bound, step, size, n, basis):
    # no noise, two records, and a fresh one: a wrong delay, a row across the joint, a lost cross term or a wrong shift
    # would each leave an error of order one
    first, second = (simulated(step, seed, ny=size, nu=size, n=n)[0] for seed in (1, 2))
    fresh, _ = simulated(step, 3, ny=size, nu=size, n=n, margin=0.1)  # inside the span, which the model clips to
    ssm = SSM(order=n, bound=bound, basis=basis, mu=1e-5, operating_point=RAW)
    model = ssm.fit(Dataset((first, second)))
    truth = fresh[[c.name for c in model.outputs]]
    np.testing.assert_allclose(model.simulate(fresh)[n:], truth[n:], atol=1e-9)
    np.testing.assert_allclose(model.predict(fresh)[n:], truth[n:], atol=1e-9)
    assert model.order == n * size
    assert model.notes == ()


@BOTH
def test_the_predictor_leaves_the_residual_of_the_regression(bound):
    data = Dataset(tuple(simulated(third_order, seed, noise=0.1)[0] for seed in (1, 2)))
    ssm = SSM(order=4, bound=bound, basis=BASIS, mu_factor=1.1, operating_point=RAW)
    model, best = ssm.fit(data), ssm.sweep(data).best
    error = np.concatenate([e["y0"][4:] - model.predict(e)[4:, 0] for e in data])
    assert bound.norm(error) == pytest.approx(best.error[0], rel=1e-9)
    assert model.noise is not None
    assert model.noise[0, 0] == pytest.approx(np.mean(error**2), rel=1e-9)
    runs = [fit_of(e["y0"][4:], model.simulate(e)[4:, 0]) for e in data]
    assert best.fit == pytest.approx(np.mean(runs), abs=1e-8)
    assert best.radius == pytest.approx(model.stability(21).radius, rel=1e-9)


# ---- recovery and guarantee -----------------------------------------------------------------------------------------


@BOTH
def test_a_sparse_system_is_recovered_from_bounded_noise(bound):
    noise = 0.02
    runs = [simulated(third_order, seed, N=400, noise=noise) for seed in (1, 2)]
    d = np.concatenate([d for _, d in runs])
    data = Dataset(tuple(e for e, _ in runs))
    model = SSM(order=3, bound=bound, basis=BASIS, mu=bound.norm(d), operating_point=RAW).fit(data)
    found = coefficients(model)
    for name, value in THIRD_ORDER.items():
        assert found[name] == pytest.approx(value, abs=0.04), name
    # 18 columns, 7 of them true; what else was chosen must be as small as the noise allows
    assert len(found) <= 14
    assert all(abs(value) < 0.04 for name, value in found.items() if name not in THIRD_ORDER)
    fresh = simulated(third_order, 9)[0]
    assert fit_of(fresh["y0"][3:], model.simulate(fresh)[3:, 0]) > 97


@pytest.mark.slow
@BOTH
@settings(max_examples=10)
@given(seed=st.integers(0, 10**6), slack=st.floats(1.0, 1.5))
def test_the_truth_is_inside_every_interval_when_the_noise_keeps_its_bound(bound, seed, slack):
    experiment, d = simulated(third_order, seed, N=120, noise=0.05)
    mu = slack * bound.norm(d)
    model = SSM(order=3, bound=bound, basis=BASIS, mu=mu, operating_point=RAW).fit(Dataset((experiment,)))
    found = {e.name: e for e in model.estimates}
    assume(set(THIRD_ORDER) <= set(found))  # the guarantee is about coefficients on the support
    for name, estimate in found.items():
        assert estimate.low <= THIRD_ORDER.get(name, 0.0) <= estimate.high


@pytest.mark.slow
def test_standard_deviations_are_the_spread_over_repetitions():
    def step(k, y, u, p):
        return (0.9 - 0.6 * p[k - 1]) * y[k - 1] + (2.0 - p[k - 1]) * u[k - 1]

    values, stds = [], []
    for seed in range(60):
        e, _ = simulated(step, seed, n=1, noise=0.3)
        ssm = SSM(order=1, basis=Powers((0, 1)), mu_factor=1.0001, operating_point=RAW)
        estimates = ssm.fit(Dataset((e,))).estimates
        assert len(estimates) == 4  # all of them true: no selection between the spread and its estimate
        values.append([q.value for q in estimates])
        stds.append([q.std for q in estimates])
    np.testing.assert_allclose(np.std(values, axis=0), np.mean(stds, axis=0), rtol=0.3)


# ---- scaling, operating point ---------------------------------------------------------------------------------------


def in_other_units(e, factor):
    values = np.array(e.values)
    values[:, e.names.index("u0")] *= factor
    return replace(e, values=values)


def test_units_of_a_channel_do_not_change_the_selection_with_unit_columns():
    e, _ = simulated(third_order, 4, noise=0.2)
    other = in_other_units(e, 1000.0)
    for penalty, same in ((UnitColumns(), True), (Plain(), False)):
        ssm = SSM(order=4, basis=BASIS, mu_factor=1.1, penalty=penalty, operating_point=RAW)
        a, b = ssm.fit(Dataset((e,))), ssm.fit(Dataset((other,)))
        assert (set(coefficients(a)) == set(coefficients(b))) is same
        if same:
            np.testing.assert_allclose(a.simulate(e), b.simulate(other), atol=1e-8)


@pytest.mark.parametrize("zero", [0.0, -30.0, 4.0])
def test_the_physical_zero_of_an_output_is_found_and_not_invented(zero):
    data = Dataset(tuple(simulated(third_order, seed, N=400, noise=0.05, zero=zero)[0] for seed in (1, 2)))
    model = SSM(order=3, basis=BASIS, mu_factor=1.1, operating_point=FittedZero()).fit(data)
    found = model.operating_point.y[0, 0]
    assert found == (0.0 if zero == 0 else pytest.approx(zero, abs=0.05))
    fresh = simulated(third_order, 9, zero=zero)[0]
    assert fit_of(fresh["y0"][3:], model.simulate(fresh)[3:, 0]) > 95


def test_deviations_from_a_scheduled_mean_are_simulated_back_to_the_signals():
    def add_level(e):
        values = np.array(e.values)
        values[:, e.names.index("y0")] += 5 + 3 * e["p"]
        values[:, e.names.index("u0")] += 2 - e["p"]
        return replace(e, values=values)

    raw = [simulated(third_order, seed, N=2000, noise=0.01)[0] for seed in (1, 2)]
    model = SSM(order=3, basis=BASIS, mu_factor=1.05, operating_point=ScheduledMean(1)).fit(
        Dataset(tuple(add_level(e) for e in raw))
    )
    fresh = add_level(simulated(third_order, 9)[0])
    assert fit_of(fresh["y0"][3:], model.simulate(fresh)[3:, 0]) > 90


# ---- sweep ----------------------------------------------------------------------------------------------------------


def test_sweep_tells_the_path_and_chooses_a_sparse_model_that_simulates():
    data = Dataset(tuple(simulated(third_order, seed, N=300, noise=0.05)[0] for seed in (1, 2)))
    held_out = Dataset((simulated(third_order, 3, N=300, noise=0.05)[0],))
    sweep = SSM(orders=(1, 2, 3, 4), factors=(1.05, 1.2, 1.5), basis=BASIS, operating_point=RAW).sweep(data, held_out)
    assert [c.order for c in sweep.path] == sorted(c.order for c in sweep.path)
    assert sweep.best.order == 3  # the true one: the schedule of the outputs is p(k - order)
    assert sweep.best.held_out is not None
    assert sweep.best.held_out > 90
    for c in sweep.path:
        assert np.all(c.smallest <= c.error * (1 + 1e-9))
        assert np.all(c.error <= c.mu * (1 + 1e-7))
        same = [x for x in sweep.path if x.order == c.order and x.mu[0] > c.mu[0]]
        assert all(x.error[0] >= c.error[0] * (1 - 1e-9) or x.support >= c.support for x in same)


@BOTH
def test_an_infeasible_bound_is_named(bound):
    data = Dataset((simulated(third_order, 1, noise=0.1)[0],))
    with pytest.raises(InputError, match="smallest feasible mu"):
        SSM(order=3, bound=bound, basis=BASIS, mu=1e-6, operating_point=RAW).fit(data)


def test_an_unstable_model_says_so_before_it_is_returned():
    rng = np.random.default_rng(0)
    N = 300
    p, y, u = rng.uniform(0.9, 1.1, N), np.zeros((N, 1)), np.zeros((N, 1))
    for k in range(1, N):  # held by feedback, so that the record is bounded
        u[k - 1] = -0.6 * y[k - 1] + rng.uniform(-1, 1)
        y[k] = 1.1 * p[k - 1] * y[k - 1] + u[k - 1]
    model = SSM(order=1, basis=BASIS, mu=1e-6, operating_point=RAW).fit(Dataset((record_of("cl", u, y, p),)))
    assert any("unstable" in note and "1.2" in note for note in model.notes)


def test_a_model_survives_its_file(tmp_path):
    e = simulated(third_order, 1, noise=0.1)[0]
    model = SSM(order=3, mu_factor=1.1).fit(Dataset((e,)))  # the default basis of the paper
    model.save(tmp_path / "m.json")
    np.testing.assert_array_equal(load_model(tmp_path / "m.json").simulate(e), model.simulate(e))


def test_a_record_without_schedule_gives_a_sparse_lti_model():
    rng = np.random.default_rng(3)
    u, y = rng.uniform(-1, 1, 200), np.zeros(200)
    for k in range(2, 200):
        y[k] = 0.5 * y[k - 1] - 0.3 * y[k - 2] + u[k - 2]
    e = Experiment.from_arrays("lti", 0.1, inputs={"u": u}, outputs={"y": y})
    model = SSM(order=2, mu=1e-8, operating_point=RAW).fit(Dataset((e,)))
    poles = np.sort_complex(np.linalg.eigvals(model.freeze(0.0)[0]))
    np.testing.assert_allclose(poles, np.sort_complex(np.roots([1, -0.5, 0.3])), atol=1e-8)


@pytest.mark.parametrize("moved", [lambda p: p - 1.0, lambda p: 1000.0 * (p - p.min())], ids=["through zero", "from zero"])
def test_a_schedule_that_reaches_zero_has_a_basis_too(moved):
    """Without 1/rho, and in numbers of order one whatever the unit."""
    e = simulated(third_order, 1, noise=0.05)[0]
    data = Dataset((record_of("zero", e[["u0"]], e[["y0"]], moved(e["p"])),))
    model = SSM(order=3, mu_factor=1.1).fit(data)
    assert score(model, data, "estimation", ["free-run"])[0].FIT > 85.0


def test_bad_input_is_refused_with_its_place_and_mend():
    e = simulated(third_order, 1)[0]
    data = Dataset((e,))
    for options, records, problem in (
        ({"orders": (0,)}, data, "order 0"),
        ({"mu_factor": 1.0}, data, "mu_factor"),
        ({"mu": -1.0}, data, "mu -1"),
        ({"order": 150}, data, "samples for order"),
        ({}, Dataset((e.select(["u0", "p"]),)), "no output"),
        ({"order": 1, "basis": Gaussian((0.6, 1.6), (1.0, 1.0))}, data, "Gaussian"),
    ):
        with pytest.raises(InputError, match=problem):
            SSM(**options).fit(records)


@pytest.mark.slow
@BOTH
def test_intervals_hold_the_truth_when_nobody_knows_the_noise(bound):
    """mu from the residuals alone: over 40 records 95 % of the intervals hold the true coefficient, right basis and order."""
    inside = []
    for seed in range(40):
        e, _ = simulated(third_order, seed, N=200, noise=0.05)
        options = SSM(order=3, bound=bound, mu_factor=1.05, basis=BASIS, operating_point=RAW)
        model = options.fit(Dataset((e,)))
        if set(THIRD_ORDER) <= {c.name for c in model.estimates}:  # otherwise zeros off the support are not the truth
            inside += [c.low <= THIRD_ORDER.get(c.name, 0.0) <= c.high for c in model.estimates]
    assert len(inside) > 70
    assert np.mean(inside) >= 0.95
