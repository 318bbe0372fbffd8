"""Models of several schedule variables: their equations written out, files, refusals; bases of several variables."""

import dataclasses

import numpy as np
import pytest

import workbench as wb
from workbench.basis import (
    CONSTANT,
    Gaussian,
    PiecewiseLinear,
    Powers,
    Products,
    basis_from_dict,
    basis_to_dict,
    constant,
    polynomials,
    unity,
)
from workbench.data import Channel, Experiment
from workbench.errors import InputError
from workbench.lpv import LPVModel, OperatingPoint, Predictor, Term, lattice, load_model

SPANS = np.array([[0.5, 2.0], [-1.0, 1.0]])
BASIS = Products((Powers([0.0, 1.0], scale=2.0), Powers([0.0, 1.0, 2.0])), [[0, 0], [1, 0], [0, 2], [1, 1]])
WRITTEN = [lambda p, q: 1.0, lambda p, q: p / 2.0, lambda p, q: q**2, lambda p, q: p / 2.0 * q]


def drawn(reach=0.0) -> LPVModel:
    """Order 2, all matrices and delays drawn; F, G, K of their own."""
    random = np.random.default_rng(7)
    own = {
        key: 0.15 * random.normal(size=(4, *shape)) for key, shape in (("A", (2, 2)), ("B", (2, 1)), ("C", (1, 2)), ("D", (1, 1)))
    }
    predictor = Predictor(*(0.15 * random.normal(size=(4, 2, n)) for n in (2, 1, 1)), warmup=4)
    point = OperatingPoint(constant(2), [[0.3]], [[1.5]])
    return LPVModel(
        "two", 0.1, (Channel("u"),), (Channel("y"),), (Channel("p", "m", "schedule"), Channel("q", "rad", "schedule")), SPANS,
        BASIS,
        tuple(Term(j, d) for j, d in enumerate((0, 2, 0, 1))), **own, operating_point=point, predictor=predictor, reach=reach,
    )  # fmt: skip


def record(N=50, seed=3, far=1.3) -> Experiment:
    random = np.random.default_rng(seed)
    schedule = {"p": 1.25 + far * 0.75 * random.uniform(-1, 1, N), "q": far * random.uniform(-1, 1, N)}
    return Experiment.from_arrays(
        "r", 0.1, inputs={"u": random.normal(size=N)}, outputs={"y": random.normal(size=N)}, schedule=schedule
    )


def written_out(model, e, followed, beyond):
    """Row by row, the schedule clipped `beyond` widths outside the spans."""
    low, high = SPANS[:, 0] - beyond * np.ptp(SPANS, axis=1), SPANS[:, 1] + beyond * np.ptp(SPANS, axis=1)
    p, q = np.clip(e["p"], low[0], high[0]), np.clip(e["q"], low[1], high[1])
    x, out = np.zeros(2), []

    def at(M, k):
        late = [max(k - term.delay, 0) for term in model.terms]
        return sum(M[j] * WRITTEN[j](p[late[j]], q[late[j]]) for j in range(4))

    for k in range(len(e)):
        u, y = e["u"][k] - 0.3, e["y"][k] - 1.5
        out.append((at(model.C, k) @ x)[0] + (at(model.D, k) * u)[0, 0] + 1.5)
        own = model.predictor
        if k < followed:
            x = at(own.F, k) @ x + at(own.G, k)[:, 0] * u + at(own.K, k)[:, 0] * y
        else:
            x = at(model.A, k) @ x + at(model.B, k)[:, 0] * u
    return np.array(out)


@pytest.mark.parametrize("reach", [0.0, 0.1])
def test_free_runs_and_predictions_are_the_equations(reach):
    model, e = drawn(reach), record()
    np.testing.assert_allclose(model.simulate(e)[:, 0], written_out(model, e, 4, reach), atol=1e-12)
    for steps in (1, 3):
        predicted = model.predict(e, steps)[:, 0]
        for k in range(6, len(e)):
            assert predicted[k] == pytest.approx(written_out(model, e, max(k - steps + 1, 4), reach)[k], abs=1e-12)


def test_frozen_matrices_are_those_of_the_point_and_foreign_points_are_refused():
    model = drawn()
    A, *_ = model.freeze((1.0, -0.5))
    np.testing.assert_allclose(A, sum(model.A[j] * WRITTEN[j](1.0, -0.5) for j in range(4)))
    assert model.to_control((1.0, -0.5)).name == "two at p = 1 m, q = -0_5 rad"
    for wrong in (None, 1.0, (1.0, 3.0), (np.nan, 0.0), (1.0, 0.0, 0.0)):
        with pytest.raises(InputError, match=r"p, q.*") as caught:
            model.freeze(wrong)
        assert "p from 0.5 to 2 m; q from -1 to 1 rad" in str(caught.value)


def test_stability_is_that_of_the_worst_corner_of_the_box():
    """A = 0.7 + 0.2 p + 0.2 q, p and q from 0 to 1: unstable only where both are large, and `reach` makes the box larger."""
    basis = polynomials(1, np.ones(2))
    A = np.array([[[0.7]], [[0.2]], [[0.2]]])
    one, zero = np.array([[[1.0]], [[0.0]], [[0.0]]]), np.zeros((3, 1, 1))
    point = OperatingPoint(constant(2), [[0.0]], [[0.0]])
    model = LPVModel(
        "corner", 0.1, (Channel("u"),), (Channel("y"),), (Channel("p"), Channel("q")), [[0.0, 1.0]] * 2, basis,
        (Term(0), Term(1), Term(2)), A, one, one, zero, point,
    )  # fmt: skip
    assert model.stability().at == (1.0, 1.0)
    assert model.stability().radius == pytest.approx(1.1)
    calmer = dataclasses.replace(model, A=A * [[[1.0]], [[0.7]], [[0.7]]])
    assert calmer.stability().stable
    assert not dataclasses.replace(calmer, reach=0.25).stability().stable


def test_the_file_is_the_model(tmp_path):
    model, e = drawn(reach=0.1), record()
    model.save(tmp_path / "two.json")
    again = load_model(tmp_path / "two.json")
    assert [c.name for c in again.schedules] == ["p", "q"]
    np.testing.assert_array_equal(again.simulate(e), model.simulate(e))
    np.testing.assert_array_equal(again.spans, SPANS)


def test_what_takes_one_schedule_says_so():
    with pytest.raises(InputError, match="several schedule variables, this takes one") as caught:
        _ = drawn().span
    assert "p, q" in str(caught.value)
    assert "--schedule" in str(caught.value)


def test_a_schedule_that_is_an_output_stands_alone():
    model = drawn()
    own = (dataclasses.replace(model.schedules[0], name="y", role="scheduled output"), model.schedules[1])
    with pytest.raises(InputError, match="cannot have others beside it"):
        dataclasses.replace(model, schedules=own)


# ---- bases --------------------------------------------------------------------------------------------------------------------


def test_piecewise_linear_products_interpolate_on_a_grid():
    from scipy.interpolate import RegularGridInterpolator

    random = np.random.default_rng(0)
    knots = (np.array([0.0, 1.0, 4.0]), np.array([-1.0, 2.0]))
    values, points = random.normal(size=(3, 2)), random.uniform([0.0, -1.0], [4.0, 2.0], (200, 2))
    basis = Products(tuple(PiecewiseLinear(k) for k in knots))
    np.testing.assert_allclose(basis(points) @ values.ravel(), RegularGridInterpolator(knots, values)(points), atol=1e-12)


@pytest.mark.parametrize(("variables", "degree", "count"), [(2, 1, 3), (2, 4, 15), (3, 2, 10), (4, 2, 15)])
def test_polynomials_are_all_monomials_up_to_a_degree(variables, degree, count):
    random = np.random.default_rng(1)
    scales, points = random.uniform(1.0, 3.0, variables), random.normal(size=(100, variables))
    phi = polynomials(degree, scales)(points)
    assert phi.shape[1] == count
    assert np.linalg.matrix_rank(phi) == count
    target = ((points @ random.normal(size=variables)) + 0.7) ** degree  # any polynomial of the degree is a sum of them
    np.testing.assert_allclose(phi @ np.linalg.lstsq(phi, target, rcond=None)[0], target, atol=1e-9)


@pytest.mark.parametrize(
    "basis",
    [
        Powers([1.0, 0.0]),
        PiecewiseLinear([0.0, 0.4, 1.0]),
        Gaussian([0.0, 1.0], beta=[1.0, 2.0], normalised=True),
        Gaussian([0.0, 1.0], beta=[1.0, 2.0], normalised=True, with_constant=True),
        polynomials(2, np.ones(2)),
        Products((PiecewiseLinear([0.0, 1.0]), Gaussian([0.0, 1.0], beta=[1.0, 2.0], normalised=True))),
        Products((Powers([1.0, 0.0]), PiecewiseLinear([0.0, 1.0]))),
    ],
)
def test_unity_adds_up_to_one(basis):
    points = np.random.default_rng(2).uniform(0.0, 1.0, (50, 2) if isinstance(basis, Products) else 50)
    np.testing.assert_allclose(basis(points) @ unity(basis), 1.0, atol=1e-12)
    again = basis_from_dict(basis_to_dict(basis))
    np.testing.assert_array_equal(again(points), basis(points))
    assert again.names == basis.names


def test_what_cannot_write_the_constant_has_no_unity():
    hats = PiecewiseLinear([0.0, 1.0])
    for basis in (Powers([1.0]), Gaussian([0.0], beta=[1.0]), Products((hats, hats), [[0, 0], [1, 1]])):
        assert unity(basis) is None


def test_functions_that_do_not_exist_are_refused():
    for chosen in ([[0, 2]], [[0]], [[-1, 0]]):
        with pytest.raises(InputError, match="functions"):
            Products((CONSTANT, Powers([0.0, 1.0])), chosen)


def test_a_lattice_holds_the_corners():
    points = lattice(np.array([[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]), 41)
    corners = {tuple(p) for p in points if all(v in (0.0, 1.0, 2.0, 3.0, 4.0, 5.0) for v in p)}
    assert len(corners) == 8
    assert len(np.unique(points, axis=0)) == len(points)


# ---- records ------------------------------------------------------------------------------------------------------------------


def test_identify_says_which_methods_take_several_and_refuses_too_many(tmp_path):
    random = np.random.default_rng(0)
    N = 300
    schedule = {f"p{i}": random.normal(size=N) for i in range(7)}
    e = Experiment.from_arrays(
        "r", 0.1, inputs={"u": random.normal(size=N)}, outputs={"y": random.normal(size=N)}, schedule=schedule
    )
    with pytest.raises(InputError, match="7 schedule variables, at most 6 are possible"):
        wb.identify(wb.Dataset((e,)))
    two = wb.Dataset((e.with_roles(schedule=["p0", "p1"]),))
    with pytest.raises(InputError, match="ilm takes one scheduling channel, these are 2"):
        wb.identify(two, methods=["ilm"])
