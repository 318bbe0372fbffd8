"""LPV models by their free runs where the schedule is an output: exact slopes, a spring that hardens, a published benchmark."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import workbench as wb
from workbench.basis import CONSTANT, PiecewiseLinear, Powers, polynomials
from workbench.data import SCHEDULED_OUTPUT, Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.identification.criterion import ByCriterion
from workbench.identification.output_error.free_numbers import FreeNumbers
from workbench.identification.output_error.passes import read
from workbench.identification.output_error.refine import Runs, refinable, refined
from workbench.identification.output_error.state_space import _shortened, bent, lower
from workbench.lpv import LPVModel, OperatingPoint, Predictor, Term, constant_model
from workbench.quasi_lpv import coupling_notes

SILVERBOX = Path(__file__).parents[3].parent / "shared" / "data" / "real" / "silverbox"
INPUTS = (Channel("u", "V", "input"), Channel("w", "V", "input"))
STILL = OperatingPoint(CONSTANT, [[0.0, 0.0]], [[0.0, 0.0]])
OUTPUTS = (Channel("a", "m", "output"), Channel("b", "m", "output"))


def drawn(delays=(0, 0), seed=0) -> LPVModel:
    """Three states, two inputs, and two outputs of which the second one schedules A and B quadratically, late where asked."""
    random = np.random.default_rng(seed)
    A = np.stack([0.6 * np.eye(3) + 0.1 * random.normal(size=(3, 3)), *(s * random.normal(size=(3, 3)) for s in (0.15, 0.05))])
    B = random.normal(size=(3, 3, 2)) * np.array([1.0, 0.3, 0.1])[:, None, None]
    C, D, K = np.zeros((3, 2, 3)), np.zeros((3, 2, 2)), np.zeros((3, 3, 2))
    C[0], D[0], K[0] = random.normal(size=(2, 3)), 0.1 * random.normal(size=(2, 2)), 0.1 * random.normal(size=(3, 2))
    return LPVModel(
        "own", 0.1, INPUTS, OUTPUTS, (Channel("b", "m", SCHEDULED_OUTPUT),), [[-2.0, 1.5]], Powers(np.arange(3.0), 2.0),
        (Term(0), Term(1, delays[0]), Term(2, delays[1])), A, B, C, D, OperatingPoint(CONSTANT, [[0.1, -0.2]], [[0.3, -0.1]]),
        Predictor(A - K[0] @ C, B - K[0] @ D, K), np.eye(2),
    )  # fmt: skip


def along(seed=1, samples=60, missing=()) -> Experiment:
    """Any numbers: what a run makes of them is to be right, not good."""
    random = np.random.default_rng(seed)
    values = np.column_stack([random.normal(size=(samples, 2)), 0.5 * random.normal(size=(samples, 2))])
    values[list(missing), 2:] = np.nan
    channels = (*INPUTS, OUTPUTS[0], Channel("b", "m", SCHEDULED_OUTPUT))
    return Experiment("any", 0.1 * np.arange(samples), channels, values, 0.1)


@pytest.mark.parametrize("delays", [(0, 0), (1, 2), (0, 3)])
def test_a_run_is_the_models_own_free_run_and_its_slopes_are_those_of_differences(delays):
    model, e = drawn(delays), along()
    runs, none = Runs(model, Dataset((e,))), FreeNumbers.nothing(model)
    missed = runs._run(none, 0, np.zeros(3), 0.0, slopes=False)[0] * runs.scale
    np.testing.assert_allclose(e[["a", "b"]] - missed, model.simulate(e, warmup=0), atol=1e-10)
    own, x = FreeNumbers.all_of(model, direct=True), 0.3 * np.random.default_rng(2).normal(size=3)
    P = len(own.places)
    for share in (0.0, 0.3, 1.0):
        _, H, b = runs._run(own, 0, x, share, slopes=True)

        def errors(z, share=share):
            return runs._run(own.moved(z[:P]), 0, z[P:], share, slopes=False)[0].ravel()

        z = np.concatenate([own.values, x])
        J = np.stack([(errors(z - d) - errors(z + d)) / 2e-6 for d in 1e-6 * np.eye(len(z))], axis=1)
        np.testing.assert_allclose(H, J.T @ J, atol=1e-5 * np.abs(H).max())
        np.testing.assert_allclose(b.sum(axis=0), J.T @ errors(z), atol=1e-5 * np.abs(b).max())


def test_a_predictor_reads_the_measured_schedule_and_a_free_run_none():
    """share 1 is the one-step predictor: what it reads of a schedule is measured; of a free run nothing is."""
    model, e = drawn(), along()
    other = replace(e, values=np.where(np.arange(4) == 3, e.values + 0.3, e.values))
    for share, same in ((0.0, True), (1.0, False)):
        first, second = (
            Runs(model, Dataset((own,)))._run(FreeNumbers.nothing(model), 0, np.zeros(3), share, slopes=False)[0]
            for own in (e, other)
        )
        scales = [Runs(model, Dataset((own,))).scale for own in (e, other)]
        moved = (own[["a", "b"]] - miss * scale for own, miss, scale in zip((e, other), (first, second), scales, strict=True))
        assert np.allclose(*moved, atol=1e-12) is same


def test_between_its_nodes_a_basis_is_read_exactly_up_to_cubics():
    basis, low, high = Powers(np.arange(4.0), 2.0), -1.5, 2.5
    nodes = np.linspace(low, high, 9)
    table = np.stack([basis(nodes), [basis.slopes(rho) for rho in nodes.tolist()]], axis=2)
    for rho in (-1.5, -0.77, 0.0, 1.9, 2.5):
        value, slope = np.zeros(4), np.zeros(4)
        read(np.ascontiguousarray(table), low, high, rho, value, slope)
        np.testing.assert_allclose(value, basis(np.array([rho]))[0], atol=1e-14)
        np.testing.assert_allclose(slope, basis.slopes(rho), atol=1e-13)


# ---- a spring that hardens -------------------------------------------------------------------------------------------------


def hardening(seeds, noise, *, size=1.0, cubic=1.0, samples=500):
    """q'' = u - 0.4 q' - q - cubic q^3 under held random inputs, every 0.2 s; and q without noise."""
    made, true = [], []
    for seed in seeds:
        random = np.random.default_rng(seed)
        u, x, rows = size * np.repeat(random.normal(size=samples // 5 + 1), 5)[:samples], np.zeros(2), []
        for own in u:
            rows.append(x[0])
            flow = solve_ivp(lambda _, x, own=own: [x[1], own - 0.4 * x[1] - x[0] - cubic * x[0] ** 3], (0, 0.2), x, rtol=1e-8)
            x = flow.y[:, -1]
        q = np.array(rows)
        channels = (Channel("u", "N", "input"), Channel("q", "m", SCHEDULED_OUTPUT))
        values = np.column_stack([u, q + noise * random.standard_normal(samples)])
        made.append(Experiment(f"spring {seed}", 0.2 * np.arange(samples), channels, values, 0.2))
        true.append(q)
    return Dataset(tuple(made)), true


def off(model, data, true):
    """Free-run errors over the deviations of the output without noise [%]."""
    runs = [model.simulate(e)[model.warmup :, 0] for e in data]
    seen = [q[model.warmup :] for q in true]
    return 100.0 * max(np.linalg.norm(q - run) / np.linalg.norm(q - q.mean()) for q, run in zip(seen, runs, strict=True))


@pytest.mark.slow
def test_a_spring_that_hardens_runs_free_by_the_method_that_follows_it():
    data, _ = hardening((1, 2, 3), 0.01)
    fresh, true = hardening((11, 12), 0.0)
    model = wb.LPVOutputError(order=2, degree=2).fit(data)
    assert off(model, fresh, true) < 3.0
    assert off(wb.LTI(order=2).fit(data), fresh, true) > 10.0
    assert any("free runs schedule themselves" in note for note in model.notes)
    # of the true linearisation: 1 + 3 q^2 is the stiffness about q, not 1 + q^2
    for rho in (0.0, 0.6):
        pole = np.exp(0.2 * np.roots([1.0, 0.4, 1.0 + 3.0 * rho**2]))
        found = np.linalg.eigvals(model.linearise(rho)[0])
        found = found[np.argsort(-np.abs(found))][:2]
        assert np.abs(np.angle(found)).max() == pytest.approx(np.abs(np.angle(pole)).max(), rel=0.06)


@pytest.mark.slow
def test_a_linear_machine_with_a_schedule_that_is_its_output_is_linear():
    data, _ = hardening((1, 2), 0.01, cubic=0.0)
    fresh, true = hardening((11,), 0.0, cubic=0.0)
    model = wb.LPVOutputError(order=2, degree=1).fit(data)
    assert off(model, fresh, true) < 1.5


@pytest.mark.slow
def test_a_model_that_may_be_refined_is_and_runs_better():
    data, _ = hardening((1, 2, 3), 0.02)
    fresh, true = hardening((11, 12), 0.0)
    rough = wb.LPVOutputError(order=2, degree=2).fit(Dataset(data.experiments[:1]))
    rough = replace(rough, A=rough.A * 0.995, predictor=replace(rough.predictor, F=rough.predictor.F - 0.005 * rough.A))
    assert refinable(rough)
    better = refined(rough, data)
    assert off(better, fresh, true) < 0.6 * off(rough, fresh, true)


def test_what_moves_the_output_equation_of_its_own_schedule_is_not_refined():
    model = drawn()
    assert refinable(model)
    moving = model.C.copy()
    moving[1] = 0.1
    bent = replace(model, C=moving)
    assert not refinable(bent)
    assert refined(bent, Dataset((along(),))) is bent
    hats = replace(model, basis=PiecewiseLinear((-2.0, 0.0, 1.5)))
    assert not refinable(hats)

    class Given:
        def fit(self, _):
            return bent

    assert ByCriterion(Given(), "simulation").fit(Dataset((along(),))).notes[-1].startswith("not refined")


def test_a_basis_whose_output_equation_would_move_is_refused():
    data, _ = hardening((1,), 0.01, samples=200)
    with pytest.raises(InputError, match="a basis without the constant 1, for a schedule that is an output"):
        wb.LPVOutputError(order=2, basis=PiecewiseLinear((-1.0, 0.0, 1.0))).fit(data)


@pytest.mark.slow
def test_what_a_refined_model_says_of_its_coupling_is_its_own():
    data, _ = hardening((1, 2), 0.02)
    model = wb.LPVOutputError(order=2, degree=2).fit(data)
    worse = replace(model, A=0.98 * model.A, predictor=replace(model.predictor, F=model.predictor.F - 0.02 * model.A))
    worse = replace(worse, notes=("first", *coupling_notes(worse)))
    better = refined(worse, data)
    assert better.notes == ("first", *coupling_notes(better))
    assert better.notes != worse.notes


# ---- what an order is chosen from -----------------------------------------------------------------------------------------


def test_an_order_is_chosen_from_pieces_of_every_part_of_long_records_and_from_whole_short_ones():
    def records(*lengths):
        made = []
        for i, N in enumerate(lengths):
            t = 0.1 * np.arange(N)
            made.append(Experiment(f"r{i}", t, (INPUTS[0], OUTPUTS[0]), np.column_stack([t, t * (1.0 + i)]), 0.1))
        return Dataset(tuple(made))

    few = records(4000, 6000)
    assert _shortened(few) is few
    (long,) = records(40_000)
    pieces = _shortened(Dataset((long,)))
    assert sum(map(len, pieces)) == pytest.approx(10_000, rel=0.01)
    assert (pieces.experiments[0].t[0], pieces.experiments[-1].t[-1]) == (long.t[0], long.t[-1])
    assert np.diff([e["u"][0] for e in pieces]).max() < 1300.0  # s: none of 4000 is far from a piece
    many = _shortened(records(*[300] * 100))
    assert {len(e) for e in many} == {300}
    assert 9000 <= sum(map(len, many)) <= 10_500
    mixed = _shortened(records(*[500] * 20, 20_000))
    assert sum(map(len, mixed)) < 13_000


def test_the_special_cases_of_polynomials_are_theirs_in_their_own_units():
    basis = Powers(np.arange(3.0), 7.0)
    low = lower(basis)
    assert (low.exponents.tolist(), low.scale) == ([0.0, 1.0], 7.0)
    assert lower(lower(low)) is None
    assert lower(PiecewiseLinear((0.0, 1.0))) is None
    assert lower(Powers(np.array([0.0, 2.0]))) is None
    both = polynomials(2, np.array([3.0, 5.0]))
    assert lower(both).names == polynomials(1, np.array([3.0, 5.0])).names
    assert [own.scale for own in lower(both).factors] == [3.0, 5.0]
    model = replace(drawn(), basis=low, terms=(Term(0), Term(1)), **{k: getattr(drawn(), k)[:2] for k in "ABCD"})
    model = replace(model, predictor=Predictor(model.A, model.B, np.zeros((2, 3, 2))))
    rho = np.array([-1.3])
    for wide, narrow in zip(bent(model, basis).freeze(rho[0]), model.freeze(rho[0]), strict=True):
        np.testing.assert_allclose(wide, narrow, atol=1e-14)


def test_a_start_that_is_fitted_to_what_judges_it_counts_against_the_order():
    """Of white noise any number of states explains as many values: what is left must not fall with them."""
    random, missed = np.random.default_rng(0), {1: [], 3: []}
    for _ in range(40):
        values = np.column_stack([np.zeros((26, 2)), random.normal(size=(26, 2))])
        e = Experiment("noise", 0.1 * np.arange(26), (*INPUTS, *OUTPUTS), values, 0.1)
        for n, found in missed.items():
            A, C = np.diag([0.98, 0.6, -0.7][:n]), np.eye(2, n) + 0.3
            model = constant_model("any", 0.1, (INPUTS, OUTPUTS), (A, np.zeros((n, 2)), C, np.zeros((2, 2))), STILL)
            model = replace(model, predictor=Predictor(model.A, model.B, np.zeros((1, n, 2))))
            found.append(Runs(model, Dataset((e,))).missed(model))
    assert np.mean(missed[3]) == pytest.approx(np.mean(missed[1]), rel=0.01)


# ---- a published benchmark -------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.skipif(not SILVERBOX.is_dir(), reason="the shared records are not here")
def test_the_silverbox_without_physics():
    """Order 2, as the machine has; by rule, which takes minutes, it is better. Published: 0.30, 0.26, 0.26, linear 7.0 mV."""
    given = {"inputs": "V1", "outputs": "V2", "schedule": "V2"}
    model = wb.LPVOutputError(orders=(2,)).fit(wb.read(SILVERBOX / "multisine_train.csv", **given))
    for name, stop, most in (("multisine_test", None, 1.0), ("arrow", 32_000, 1.0), ("arrow", None, 3.0)):
        (e,) = wb.read(SILVERBOX / f"{name}.csv", **given)
        missed = (e["V2"] - model.simulate(e, warmup=50)[:, 0])[50:stop]
        assert 1e3 * np.sqrt(np.mean(missed**2)) < most
