"""LPV-OE: the fence's slopes, and models of two schedules against the machine that made the records, which is written here."""

import numpy as np
import pytest

import workbench as wb
from workbench.basis import constant, polynomials
from workbench.data import Dataset, Experiment
from workbench.errors import InputError
from workbench.identification.output_error.fence import Fence
from workbench.identification.output_error.free_numbers import FreeNumbers
from workbench.identification.output_error.state_space import widened
from workbench.lpv import LPVModel, OperatingPoint, Predictor, Term

DT = 0.05


def machine(u, p, q):
    """x1+ = x1 + dt x2, x2+ = x2 - dt ((4 + 3 p) x1 + (1 + 0.5 q) x2 - (2 + p + q) u): stiffness, damping and gain surface."""
    x, y = np.zeros(2), np.empty(len(u))
    for k in range(len(u)):
        y[k] = 3.0 + x[0]
        x = np.array([
            x[0] + DT * x[1],
            x[1] + DT * (-(4.0 + 3.0 * p[k]) * x[0] - (1.0 + 0.5 * q[k]) * x[1] + (2.0 + p[k] + q[k]) * u[k]),
        ])  # fmt: skip
    return y


def records(seed, count=3, N=700, noise=0.05, names="abcdef"):
    """(records, what their outputs are without noise)."""
    found, true = [], []
    for i in range(count):
        random = np.random.default_rng([seed, i])
        u = np.repeat(random.normal(size=N // 7), 7)
        t = DT * np.arange(N)
        p, q = np.sin(0.3 * t + random.uniform(0, 6)), np.cos(0.45 * t + random.uniform(0, 6))
        y = machine(u, p, q)
        true.append(y)
        y = y + noise * np.std(y) * random.normal(size=N)
        found.append(
            Experiment.from_arrays(f"{names[i]}{seed}", DT, inputs={"u": u}, outputs={"y": y}, schedule={"p": p, "q": q})
        )
    return Dataset(tuple(found)), true


def test_the_slope_of_the_fence_is_that_of_its_cost():
    random = np.random.default_rng(5)
    basis, one = polynomials(1, np.ones(2)), np.zeros((3, 1, 1))
    A = np.stack([np.diag([0.9, 0.7, 0.8]), *(0.15 * random.normal(size=(2, 3, 3)))])
    A[0, 0, 1], A[0, 1, 0] = 0.5, -0.5  # an oscillation among them
    B, C = random.normal(size=(3, 3, 1)), random.normal(size=(3, 1, 3))
    K = np.zeros((3, 3, 1))
    channels = (wb.Channel("p", "", "schedule"), wb.Channel("q", "", "schedule"))
    model = LPVModel(
        "f", 0.1, (wb.Channel("u"),), (wb.Channel("y"),), channels, [[-1.0, 1.0]] * 2, basis, (Term(0), Term(1), Term(2)),
        A, B, C, one,
        OperatingPoint(constant(2), [[0.0]], [[0.0]]), Predictor(A, B, K, 5),
    )  # fmt: skip
    own = FreeNumbers.all_of(model, direct=False)
    fence = Fence(model, 0.98, 40.0)
    cost, H, b = fence.normal(own)
    assert cost > 1.0  # many points are beyond it
    assert cost == pytest.approx(fence.cost(own.moved(own.values).model))
    step = 1e-6
    for i in range(len(own.places)):
        up, down = (fence.cost(own.moved(own.values + sign * step * np.eye(len(own.values))[i]).model) for sign in (1.0, -1.0))
        assert -2.0 * b[i] == pytest.approx((up - down) / (2.0 * step), rel=1e-4, abs=1e-5 * cost)
    np.testing.assert_allclose(H, H.T)
    assert np.linalg.eigvalsh(H).min() > -1e-9 * np.abs(H).max()


def test_a_machine_of_two_schedules_is_found():
    """Its free run misses the noise-free output of fresh records by a point of FIT at most; its poles are the machine's."""
    data, _ = records(1)
    fresh, true = records(2, count=2, names="xy")
    model = wb.LPVOutputError(order=2, degree=1).fit(data)
    assert model.stability(21).stable
    for e, y in zip(fresh, true, strict=True):
        run = model.simulate(e)[model.warmup :, 0]
        assert 100.0 * np.linalg.norm(y[model.warmup :] - run) / np.linalg.norm(y - y.mean()) < 1.0
    for p, q in ((-0.8, 0.8), (0.0, 0.0), (0.8, -0.8)):
        exact = np.linalg.eigvals(np.array([[1.0, DT], [-DT * (4.0 + 3.0 * p), 1.0 - DT * (1.0 + 0.5 * q)]]))
        np.testing.assert_allclose(np.sort_complex(model.to_control((p, q)).poles()), np.sort_complex(exact), atol=0.01)


def test_a_state_more_changes_no_run_until_it_is_fitted():
    """What begins at a model with a state less is that model: the same free runs, one pole more that the inputs move."""
    data, _ = records(8, count=1, N=210)
    model = wb.LPVOutputError(order=2, degree=1).fit(data)
    wider = widened(model)
    assert wider.order == 3
    for e in data:
        np.testing.assert_allclose(wider.simulate(e, warmup=0), model.simulate(e, warmup=0), atol=1e-12)
    assert np.abs(wider.B[:, -1]).max() > 0.0
    own = FreeNumbers.all_of(wider, direct=False)
    np.testing.assert_allclose(own.moved(own.values).model.stability(21).radius, model.stability(21).radius, rtol=1e-9)


def test_sparse_set_membership_takes_several_schedules():
    data, _ = records(3, noise=0.002)
    fresh, true = records(4, count=1)
    model = wb.SSM(orders=(2, 3), basis=polynomials(1, np.ones(2))).fit(data)
    run = model.simulate(fresh.experiments[0])[:, 0]
    assert 100.0 * np.linalg.norm(true[0] - run)[()] / np.linalg.norm(true[0] - true[0].mean()) < 5.0


@pytest.mark.slow
def test_order_and_degree_are_found_on_what_was_not_fitted_to():
    data, _ = records(5, count=6)
    fresh, true = records(6, count=2, names="xy")
    found = wb.identify(data, fresh, methods=["lti", "ssm", "lpv-oe"])
    model = found.models["lpv-oe"]
    assert len(model.basis.names) == 3  # affine
    for e, y in zip(fresh, true, strict=True):
        run = model.simulate(e)[model.warmup :, 0]
        assert 100.0 * np.linalg.norm(y[model.warmup :] - run) / np.linalg.norm(y - y.mean()) < 1.0
    by_model = {s.model: s.FIT for s in found.scores if s.split == "held-out" and s.horizon == "free-run"}
    assert by_model["LPV-OE"] == max(by_model.values())


def test_what_it_cannot_take_is_refused():
    data, _ = records(7, count=1)
    bare = Dataset(tuple(e.with_roles(outputs=["y"]).select(["u", "y"]) for e in data))
    with pytest.raises(InputError, match="no schedule channel"):
        wb.LPVOutputError().fit(bare)
    with pytest.raises(InputError, match="a basis of 1 variables for 2 schedules"):
        wb.LPVOutputError(order=1, basis=wb.Powers([0.0, 1.0])).fit(data)
    with pytest.raises(InputError, match="order 0"):
        wb.LPVOutputError(order=0)
    with pytest.raises(InputError, match="degree 0"):
        wb.LPVOutputError(degree=0)
