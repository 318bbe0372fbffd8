"""ILM on a blend whose truth is known, against its equation, CVXPY and scipy; and what it must not do with records."""

import dataclasses

import cvxpy as cp
import numpy as np
import pytest
from scipy.signal import dlsim

from workbench.data import Dataset, Experiment
from workbench.errors import InputError
from workbench.identification import ilm
from workbench.identification.ilm import ILM, Normalised, Plain
from workbench.identification.lti import LTI
from workbench.identification.subspace import PBSID
from workbench.lpv import load_model
from workbench.metrics import score

pytestmark = pytest.mark.slow

#: Two local systems, (A, B, C): a slow one at rho = 1 and a quick, stronger one at rho = 3.
SLOW = (np.array([[0.95, 0.1], [0.0, 0.7]]), np.array([[0.0, 0.1], [0.2, 0.0]]), np.array([[1.0, 0.0]]))
QUICK = (np.array([[0.6, 0.2], [-0.2, 0.6]]), np.array([[0.5, -0.5], [1.0, 0.0]]), np.array([[2.0, 0.5]]))


def plant(seed, N=2000, noise=0.05, systems=(SLOW, QUICK), sweep=None, drift=1.0):
    """y = y0(rho) + sum_i w_i(rho) y_i(u - u0(rho)), w linear in rho: the truth, in its own equations."""
    random = np.random.default_rng(seed)
    rho = np.linspace(1.0, 3.0, N) if sweep is None else sweep
    v = np.repeat(random.choice([-1.0, 1.0], (N // 4 + 1, 2)), 4, axis=0)[:N]
    parts = [dlsim((A, B, C, np.zeros((1, 2)), 1), v)[1][:, 0] for A, B, C in systems]
    share = (rho - 1.0) / 2.0
    y = (1 - share) * parts[0] + share * parts[1] + drift * rho**2 + noise * random.standard_normal(N)
    u = v + drift * np.column_stack([rho, 5.0 - 0.5 * rho])
    return Experiment.from_arrays(
        f"run {seed}", 0.04, inputs={"u1": u[:, 0], "u2": u[:, 1]}, outputs={"y": y}, schedule={"p": rho}, units={"p": "m"}
    )


@pytest.fixture(scope="module")
def records():
    return Dataset((plant(1), plant(2)))


@pytest.fixture(scope="module")
def model(records):
    return ILM().fit(records)


def free_run(model, *experiments):
    return np.mean([s.FIT for s in score(model, Dataset(experiments), "estimation", ["free-run"])])


def test_a_blend_is_found_where_one_lti_model_fails(records, model):
    held_out = (plant(11), plant(12))
    blend = free_run(model, *held_out)
    assert blend >= 80
    assert blend >= free_run(LTI(resamples=0).fit(records), *held_out) + 10
    assert model.stability().stable


def test_frozen_models_are_the_truth_at_the_ends_and_between(model):
    def impulse(matrices):
        A, B, C = matrices[:3]
        return np.array([C @ np.linalg.matrix_power(A, k) @ B for k in range(30)])

    for rho in (1.2, 2.0, 2.8):
        share = (rho - 1.0) / 2.0
        truth = (1 - share) * impulse(SLOW) + share * impulse(QUICK)
        assert np.linalg.norm(impulse(model.freeze(rho)) - truth) < 0.25 * np.linalg.norm(truth)


@pytest.mark.parametrize("activation", [Plain(), Normalised()])
def test_the_free_run_is_equation_1_11(records, activation):
    """y = y0(rho) + sum_i alpha_i sigma_i(rho) y_i: local runs by scipy, activations written out, from zero states."""
    model = ILM(models=3, order=2, activation=activation, resamples=0).fit(records)
    record = plant(5, N=300)
    rho, point = record["p"], model.operating_point
    u = record[["u1", "u2"]] - point.basis(rho) @ point.u
    g = np.exp(-model.basis.beta * (rho[:, None] - model.basis.centres) ** 2)
    g = g / g.sum(axis=1, keepdims=True) if activation.normalised else g
    expected = point.basis(rho) @ point.y[:, 0]
    used = [i for i in range(3) if model.estimates[i].value > 0]  # a local model without weight has no states
    assert model.order == 2 * len(used) >= 4
    for block, i in enumerate(used):
        own = slice(2 * block, 2 * block + 2)
        local = dlsim((model.A[3][own, own], model.B[3][own], model.C[i][:, own], np.zeros((1, 2)), 1), u)[1][:, 0]
        expected += g[:, i] * local
    np.testing.assert_allclose(model.simulate(record, warmup=0)[:, 0], expected, atol=1e-9)


def test_equal_local_models_blend_to_themselves_when_normalised():
    records = Dataset(
        (plant(1, systems=(QUICK, QUICK), noise=0.0, drift=0.0), plant(2, systems=(QUICK, QUICK), noise=0.0, drift=0.0))
    )
    model = ILM(models=3, order=None, activation=Normalised(), overlaps=(1.0,), resamples=0).fit(records)
    A, B, C = QUICK
    for rho in np.linspace(1, 3, 9):
        a, b, c, _ = model.freeze(rho)
        for k in range(10):
            truth = C @ np.linalg.matrix_power(A, k) @ B
            np.testing.assert_allclose(c @ np.linalg.matrix_power(a, k) @ b, truth, atol=1e-2 * np.linalg.norm(C @ B))


def test_the_weights_solve_the_bounded_problem_of_the_paper():
    random = np.random.default_rng(0)
    X = random.standard_normal((400, 6, 1))
    y = X[:, :, 0] @ np.array([[1.6], [0.4], [-0.3], [0.0], [0.9], [1.0]]) + 0.1 * random.standard_normal((400, 1))
    alpha = ilm._interpolation(X, y)[:, 0]
    x = cp.Variable(6)
    cp.Problem(cp.Minimize(cp.sum_squares(X[:, :, 0] @ x - y[:, 0])), [x >= 0, x <= 1]).solve(solver="CLARABEL")
    np.testing.assert_allclose(alpha, x.value, atol=1e-5)
    assert alpha[0] == 1.0
    assert alpha[2] == 0.0


SEEN: list[Dataset] = []


@dataclasses.dataclass(frozen=True)
class Spy:
    """A method that keeps what it was given, and does PBSID's work."""

    order: int | None = None
    past: int = 20
    future: int = 10

    def fit(self, dataset):
        SEEN.append(dataset)
        return PBSID(self.order).fit(dataset)


def test_local_records_hold_one_interval_each_and_are_never_joined_across_a_gap():
    SEEN.clear()
    up_and_down = 2.0 - np.cos(np.linspace(0, 6 * np.pi, 2000))
    record = plant(3, sweep=up_and_down)
    ILM(models=2, order=2, drift=(2,), method=Spy(), resamples=0).fit(Dataset((record,)))
    assert len(SEEN) == 2
    for dataset, (low, high) in zip(SEEN, ((1.0, 2.0), (2.0, 3.001)), strict=True):
        assert len(dataset) >= 3  # it comes back to each half three times
        for piece in dataset:
            np.testing.assert_allclose(np.diff(piece.t), 0.04)
            rho = up_and_down[np.round(piece.t / 0.04).astype(int)]
            assert np.all((rho >= low) & (rho < high))
    assert sum(len(piece) for dataset in SEEN for piece in dataset) == 2000


def test_what_the_estimation_records_prefer_is_chosen(records, model):
    tried = ILM(resamples=0).candidates(records)
    assert {c.models for c in tried} == set(range(2, 16))
    near = [c for c in tried if max(t.FIT for t in tried) - 0.5 <= c.FIT]
    drift = len(model.operating_point.u) - 1
    assert drift == min(c.drift for c in near)
    assert len(model.basis.centres) == min(c.models for c in near if c.drift == drift)
    # the winner's own score is what its model scores, up to the observer that starts the run
    winner = max((c for c in near if (c.drift, c.models) == (drift, len(model.basis.centres))), key=lambda c: c.FIT)
    assert free_run(model, *records) == pytest.approx(winner.FIT, abs=1.0)


def test_its_observer_predicts_better_than_its_free_run(records, model):
    scores = {s.horizon: s.RMSE for s in score(model, Dataset((plant(11),)), "held-out")}
    assert scores["one-step"] <= 1.1 * scores["free-run"]
    rows = [(e[["y"]] - model.predict(e))[20:] for e in records]
    np.testing.assert_allclose(model.noise, np.mean(np.concatenate(rows) ** 2), rtol=1e-9)
    grid = np.linspace(*model.span, 25)
    radii = [np.abs(np.linalg.eigvals(np.tensordot(model.weights(np.array([p]))[0], model.predictor.F, 1))).max() for p in grid]
    assert max(radii) < 1


def test_weights_carry_names_and_spreads(model):
    assert len(model.estimates) == len(model.basis.centres)
    for e in model.estimates:
        assert e.name.startswith("alpha of y at p = ")
        assert 0 <= e.value <= 1
        assert e.std < 0.5
    assert any(e.std > 0 for e in model.estimates)


def test_a_file_brings_the_same_model_back(model, tmp_path):
    model.save(tmp_path / "ilm.json")
    again = load_model(tmp_path / "ilm.json")
    record = plant(7, N=200)
    np.testing.assert_array_equal(again.simulate(record), model.simulate(record))
    np.testing.assert_array_equal(again.predict(record, 3), model.predict(record, 3))


def test_an_unstable_local_model_says_so():
    unstable = (np.array([[1.004, 0.0], [0.0, 0.5]]), np.array([[0.02, 0.0], [1.0, 1.0]]), np.array([[1.0, 1.0]]))
    records = Dataset(tuple(plant(s, N=600, systems=(unstable, unstable), noise=0.01, drift=0.0) for s in (1, 2)))
    model = ILM(models=2, order=2, resamples=0).fit(records)
    assert any("unstable" in note for note in model.notes) == (not model.stability().stable)
    assert not model.stability().stable


def test_bad_input_names_the_mend(records):
    first = records.experiments[0]
    with pytest.raises(InputError, match="schedule"):
        ILM().fit(Dataset((first.select(["u1", "u2", "y"]),)))
    still = dataclasses.replace(first, values=first.values * np.array([1, 1, 1, 0.0]))
    with pytest.raises(InputError, match="LTI"):
        ILM().fit(Dataset((still,)))
    with pytest.raises(InputError, match="fewer models"):
        ILM(models=15).fit(Dataset((plant(1, N=400),)))
    # numbers that cannot be had are left out of the sweep, and named
    assert any("could not be had" in note for note in ILM(resamples=0).fit(Dataset((plant(1, N=700),))).notes)


@pytest.mark.parametrize("seed", range(20))
def test_the_bounded_problem_is_solved_on_its_corners_too(seed):
    """Weights that stand on their bounds: there scipy's solver divides 0 by 0, and the answer is exact all the same."""
    random = np.random.default_rng(seed)
    X = random.normal(size=(6, 5)).round(1)
    truth = random.choice([0.0, 1.0, 0.5], size=5)
    np.testing.assert_allclose(ilm._bounded(X, X @ truth), truth, atol=1e-8)
