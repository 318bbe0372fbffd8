"""The LPV model against its own equations written out, python-control, and limits that are known."""

import dataclasses
import json

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from workbench.basis import CONSTANT, Gaussian, PiecewiseLinear, Powers
from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.lpv import LPVModel, OperatingPoint, Predictor, Term, constant_model, load_model

# ---- basis functions ----------------------------------------------------------------------------------------------


def test_basis_functions_are_their_equations():
    rho = np.array([0.5, 2.0])
    np.testing.assert_allclose(Powers([0, 1, 3, -2], scale=2.0)(rho)[0], [1, 0.25, 0.25**3, 16])
    plain = Gaussian([0.0, 1.0], [1.0, 4.0])(rho)
    np.testing.assert_allclose(plain, [[np.exp(-0.25), np.exp(-1)], [np.exp(-4), np.exp(-4)]])
    hat = PiecewiseLinear([0.0, 1.0, 3.0])
    np.testing.assert_allclose(hat(np.array([0.25, 2.0, -9, 9])), [[0.75, 0.25, 0], [0, 0.5, 0.5], [1, 0, 0], [0, 0, 1]])


@given(rho=st.floats(-1e3, 1e3), beta=st.floats(1e-3, 1e6))
def test_normalised_activations_add_up_to_one_however_far_away(rho, beta):
    basis = Gaussian([0.0, 0.3, 1.0], np.full(3, beta), normalised=True)
    weight = basis(np.array([rho]))
    assert weight.sum() == pytest.approx(1.0)
    assert np.all(weight >= 0)


def test_the_constant_of_a_gaussian_basis_is_one_everywhere_and_leaves_the_others_alone():
    for normalised in (False, True):
        centres, beta, rho = [0.0, 1.0], [3.0, 3.0], np.linspace(-5, 5, 7)
        extended = Gaussian(centres, beta, normalised, with_constant=True)
        np.testing.assert_array_equal(extended(rho)[:, 2], 1.0)
        np.testing.assert_array_equal(extended(rho)[:, :2], Gaussian(centres, beta, normalised)(rho))
        assert extended.names[2] == "1"
        assert len(extended.names) == 3


def test_knots_must_increase():
    with pytest.raises(InputError):
        PiecewiseLinear([0.0, 0.0])


# ---- a model with everything in it ------------------------------------------------------------------------------------

INPUTS = (Channel("u1", "V", "input"), Channel("u2", "V", "input"))
OUTPUTS = (Channel("y1", "m", "output"), Channel("y2", "rad", "output"))
SCHEDULE = Channel("p", "m", "schedule")


def scheduled(seed=0, delays=(0, 0, 3), predictor=True):
    """Order 3, two inputs, two outputs, three terms with delays, a moving operating point, all drawn at random."""
    random = np.random.default_rng(seed)
    nt, nx, nu, ny = 3, 3, 2, 2

    def draw(*shape, size=0.15):
        return size * random.standard_normal((nt, *shape))

    A, B, C, D = draw(nx, nx), draw(nx, nu, size=1), draw(ny, nx, size=1), draw(ny, nu, size=1)
    K = draw(nx, ny, size=0.05)
    # F, G, K of their own: nothing in the code may assume F = A - K C term by term
    F, G = draw(nx, nx), draw(nx, nu)
    point = OperatingPoint(Powers([0, 1]), random.standard_normal((2, nu)), random.standard_normal((2, ny)))
    return LPVModel(
        "all", 0.1, INPUTS, OUTPUTS, (SCHEDULE,), [[0.5, 2.0]], Powers([0, 1, -1]),
        tuple(Term(j, d) for j, d in enumerate(delays)), A, B, C, D, point,
        predictor=Predictor(F, G, K, warmup=5) if predictor else None, noise=np.eye(2), notes=("a note",),
    )  # fmt: skip


def record(N=60, seed=1, rho=None):
    random = np.random.default_rng(seed)
    u, y = random.standard_normal((2, 2, N))
    return Experiment.from_arrays(
        "r",
        0.1,
        inputs={"u1": u[0], "u2": u[1]},
        outputs={"y1": y[0], "y2": y[1]},
        schedule={"p": random.uniform(0.0, 2.5, N) if rho is None else rho},
    )


def at(model, M, rho, k):
    """M(k) = sum_j M_j phi_j(rho(k - d_j)), rho clipped to the span and held before the record; written out."""
    rho = np.clip(rho, 0.5, 2.0)
    phi = [lambda r: 1.0, lambda r: r, lambda r: 1 / r]
    return sum(M[j] * phi[t.function](rho[max(k - t.delay, 0)]) for j, t in enumerate(model.terms))


def written_out(model, e, followed, steps=None):
    """Output row by row: the predictor until `followed`, then the model alone; the module's equations in a loop."""
    u, y, rho = e[["u1", "u2"]], e[["y1", "y2"]], e["p"]
    x, out = np.zeros(3), []
    for k in range(len(e)):
        r = np.clip(rho[k], 0.5, 2.0)
        u0 = model.operating_point.u[0] + r * model.operating_point.u[1]
        y0 = model.operating_point.y[0] + r * model.operating_point.y[1]
        du, dy = u[k] - u0, y[k] - y0
        out.append(at(model, model.C, rho, k) @ x + at(model, model.D, rho, k) @ du + y0)
        p = model.predictor
        if k < followed:
            x = at(model, p.F, rho, k) @ x + at(model, p.G, rho, k) @ du + at(model, p.K, rho, k) @ dy
        else:
            x = at(model, model.A, rho, k) @ x + at(model, model.B, rho, k) @ du
    return np.array(out)


@pytest.mark.parametrize("warmup", [0, 5, 60])  # of 1 the start is fitted: see the last test here
def test_the_free_run_is_the_equation(warmup):
    model, e = scheduled(), record()
    np.testing.assert_allclose(model.simulate(e, warmup=warmup), written_out(model, e, warmup), atol=1e-10)
    if warmup == 5:
        np.testing.assert_allclose(model.simulate(e), written_out(model, e, 5), atol=1e-10)


def test_the_free_run_uses_no_output_after_the_warm_up():
    model, e = scheduled(), record()
    changed = e.values.copy()
    changed[5:, 2:4] += 100.0
    np.testing.assert_array_equal(model.simulate(dataclasses.replace(e, values=changed)), model.simulate(e))


@pytest.mark.parametrize("steps", [1, 2, 7])
def test_a_prediction_knows_outputs_up_to_k_minus_steps_and_no_further(steps):
    model, e = scheduled(), record()
    predicted = model.predict(e, steps)
    for k in range(len(e)):
        # outputs of samples 0 .. k - steps, then the model alone; the warm-up of 5 is always followed
        followed = k if k < 5 else max(k - steps + 1, 5)
        np.testing.assert_allclose(predicted[k], written_out(model, e, followed)[k], atol=1e-10)


@pytest.mark.slow
def test_long_records_are_cut_into_chunks_without_a_seam():
    model, e = scheduled(), record(N=9000)
    np.testing.assert_allclose(model.simulate(e)[4090:4110], written_out(model, e, 5)[4090:4110], atol=1e-10)
    np.testing.assert_allclose(model.predict(e)[-1], written_out(model, e, 9000)[-1], atol=1e-10)


# ---- frozen models --------------------------------------------------------------------------------------------------


def test_a_frozen_model_is_python_controls():
    model = scheduled(delays=(0, 0, 0))
    rho = 1.3
    e = record(40, rho=np.full(40, rho))
    frozen = model.to_control(rho)
    u = e[["u1", "u2"]] - [1, rho] @ model.operating_point.u
    response = control.forced_response(frozen, T=0.1 * np.arange(40), U=u.T)
    expected = response.outputs.T + [1, rho] @ model.operating_point.y
    np.testing.assert_allclose(model.simulate(e, warmup=0), expected, atol=1e-9)
    assert frozen.input_labels == ["u1", "u2"]
    assert frozen.output_labels == ["y1", "y2"]
    assert frozen.dt == 0.1


@pytest.mark.parametrize("rho", [0.1, 9.0, -1.0, np.nan, np.inf, None])
def test_freezing_outside_the_span_is_refused(rho):
    """A radius in mm instead of m must not give a plausible system."""
    with pytest.raises(InputError, match=r"knows p from 0.5 to 2"):
        scheduled().freeze(rho)


def test_simulation_holds_the_edge_value_outside_the_span():
    model, inside, beyond = scheduled(), record(60, rho=np.full(60, 2.0)), record(60, rho=np.full(60, 2.5))
    np.testing.assert_array_equal(model.simulate(beyond), model.simulate(inside))


def test_stability_finds_the_worst_schedule_value():
    # A(rho) = rho^-1: radius 2 at the lower end of the span
    model = scheduled()
    A = np.zeros_like(model.A)
    A[2] = np.diag([1.0, 0.1, 0.0])
    found = dataclasses.replace(model, A=A).stability()
    assert found.radius == pytest.approx(2.0)
    assert found.at == pytest.approx(0.5)
    assert not found.stable


def test_a_constant_model_needs_no_schedule():
    point = OperatingPoint(CONSTANT, np.array([[1.0]]), np.array([[10.0]]))
    model = constant_model("lag", 0.5, ((Channel("u"),), (Channel("y"),)), [np.array([[v]]) for v in (0.5, 1.0, 2.0, 0.0)], point)
    e = Experiment.from_arrays("r", 0.5, inputs={"u": np.full(80, 2.0)}, outputs={"y": np.zeros(80)})
    # y(k) = 10 + 2 (1 - 0.5^k) / 0.5
    np.testing.assert_allclose(model.simulate(e)[:, 0], 10 + 4 * (1 - 0.5 ** np.arange(80)))
    with pytest.raises(InputError, match="no predictor"):
        model.predict(e)


# ---- files and refusals ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "basis",
    [Powers([0, 1, -1]), Gaussian([0.6, 1.5], [3.0, 5.0], with_constant=True), PiecewiseLinear([0.5, 1.0, 2.0])],
    ids=["powers", "gaussian", "piecewise"],
)
def test_a_file_brings_the_same_model_back(basis, tmp_path):
    model = dataclasses.replace(scheduled(), basis=basis)
    model.save(tmp_path / "m.json")
    again = load_model(tmp_path / "m.json")
    e = record()
    np.testing.assert_array_equal(again.simulate(e), model.simulate(e))
    np.testing.assert_array_equal(again.predict(e, 4), model.predict(e, 4))
    assert again.notes == model.notes
    assert again.inputs[0].unit == "V"
    np.testing.assert_array_equal(again.noise, model.noise)


def test_broken_files_name_what_is_wrong(tmp_path):
    path = tmp_path / "m.json"
    scheduled().save(path)
    content = json.loads(path.read_text())
    for change, message in (
        ({"schema": "other"}, "not an LPV model"),
        ({"version": 99}, "version 99"),
        ({"terms": None}, "malformed|terms"),
        ({"basis": {"kind": "power", "exponents": [0]}}, "did you mean 'powers'"),
    ):
        path.write_text(json.dumps(content | change))
        with pytest.raises(InputError, match=message):
            load_model(path)
    del content["span"]
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="'span' is missing"):
        load_model(path)


def test_another_sample_time_and_unknown_channels_are_refused():
    model, e = scheduled(), record()
    with pytest.raises(InputError, match="sample time"):
        model.simulate(dataclasses.replace(e, dt=0.2))
    with pytest.raises(InputError, match="p2"):
        dataclasses.replace(model, schedules=(Channel("p2"),)).simulate(e)
    with pytest.raises(InputError, match="terms"):
        dataclasses.replace(model, terms=(Term(0),))


@pytest.mark.parametrize("steps", [1, 4, 30])
def test_predictions_do_not_depend_on_how_a_record_is_cut_into_chunks(monkeypatch, steps):
    """Long records go through in pieces: every row is the same as in one piece."""
    from workbench import lpv
    from workbench.identification.ssm import SSM

    random = np.random.default_rng(3)
    N = 150
    u, p, y = random.normal(size=N), 1 + 0.5 * np.sin(np.arange(N)), np.zeros(N)
    for k in range(1, N):
        y[k] = 0.9 * y[k - 1] + p[k - 1] * u[k - 1]
    e = Experiment.from_arrays("e", 0.1, inputs={"u": u}, outputs={"y": y + 0.01 * random.normal(size=N)}, schedule={"p": p})
    model = SSM(order=2).fit(Dataset((e,)))
    whole, run = model.predict(e, steps), model.simulate(e)
    monkeypatch.setattr(lpv, "CHUNK", 7)
    np.testing.assert_allclose(model.predict(e, steps), whole, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(model.simulate(e), run, rtol=1e-12, atol=1e-12)


def test_a_start_from_few_samples_is_the_likeliest():
    """Five states, four samples: a run begun at zero, or at the smallest start that fits them, errs twice as much at least."""
    random = np.random.default_rng(7)
    A = np.diag([0.98, 0.95, 0.9, 0.8, 0.5])
    A[0, 1:] = 0.02
    B, C = np.ones((5, 1)), np.array([[0.1, -0.4, 0.5, 0.3, 1.0]])
    N, missed = 400, {"likeliest": 0.0, "zero": 0.0, "least": 0.0}
    u_name, y_name = Channel("u", "", "input"), Channel("y", "", "output")
    still = OperatingPoint(CONSTANT, np.zeros((1, 1)), np.zeros((1, 1)))
    K = 0.2 * np.ones((5, 1)) / 5
    for _ in range(20):
        u = np.repeat(random.normal(size=N // 20 + 10), 20)
        x, states, y = np.zeros(5), [], []
        for value in u:
            states.append(x)
            y.append(C @ x + 0.05 * random.normal(size=1))
            x = A @ x + B[:, 0] * value
        u, y = u[200:], np.array(y)[200:]
        truth = np.array([C @ own for own in states])[200:, 0]
        e = Experiment.from_arrays("late", 0.1, inputs={"u": u}, outputs={"y": y[:, 0]})
        predictor = Predictor((A - K @ C)[None], B[None], K[None], warmup=100)
        noise, matrices = np.array([[0.0025]]), (A, B, C, np.zeros((1, 1)))
        model = constant_model("five", 0.1, ((u_name,), (y_name,)), matrices, still, predictor=predictor, noise=noise)
        missed["likeliest"] += np.sum((model.simulate(e, warmup=4)[4:, 0] - truth[4:]) ** 2)
        Phi, run = [np.eye(5)], np.zeros(5)
        forced = []
        for value in u:
            forced.append(float((C @ run)[0]))
            run = A @ run + B[:, 0] * value
            Phi.append(A @ Phi[-1])
        rows = np.array([(C @ own)[0] for own in Phi[:-1]])
        start = np.linalg.lstsq(rows[:4], y[:4, 0] - np.array(forced)[:4], rcond=None)[0]
        missed["zero"] += np.sum((np.array(forced)[4:] - truth[4:]) ** 2)
        missed["least"] += np.sum((np.array(forced)[4:] + rows[4:] @ start - truth[4:]) ** 2)
    assert missed["likeliest"] < 0.5 * missed["zero"]
    assert missed["likeliest"] < 0.5 * missed["least"]
