"""Curves of actuators: values, inverses, and the nearest curve that has one."""

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize

from workbench.curves import FLATTEST, Curve, bent
from workbench.errors import InputError
from workbench.physics.symbolic import symbolic_numpy

DEAD = Curve("valve", [-2.0, -1.0, 1.0, 2.0], [-1.0, 0.0, 0.0, 1.0])


def drawn(seed: int) -> Curve:
    random = np.random.default_rng(seed)
    n = random.integers(2, 12)
    return Curve("u", np.cumsum(random.uniform(0.1, 2.0, n)) - 4.0, np.cumsum(random.uniform(0.01, 3.0, n)) - 5.0)


@pytest.mark.parametrize("seed", range(8))
def test_a_curve_is_linear_between_its_nodes_and_goes_on_at_its_ends(seed):
    curve = drawn(seed)
    inside = np.linspace(curve.u[0], curve.u[-1], 57)
    np.testing.assert_allclose(curve(inside), np.interp(inside, curve.u, curve.v), rtol=0, atol=1e-12)
    for end, slope in ((0, curve.slopes[0]), (-1, curve.slopes[-1])):
        beyond = curve.u[end] + (3.0 if end else -3.0)
        assert curve(np.array(beyond)) == pytest.approx(curve.v[end] + slope * (beyond - curve.u[end]), rel=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_bends_are_the_curve_on_numbers_arrays_and_symbols(seed):
    curve = drawn(seed)
    u = np.linspace(curve.u[0] - 2.0, curve.u[-1] + 2.0, 83)
    np.testing.assert_allclose(bent(u, curve.bends), curve(u), rtol=0, atol=1e-11)
    assert bent(float(u[7]), curve.bends) == pytest.approx(float(curve(u[7])))
    with symbolic_numpy():
        symbol = ca.SX.sym("u")
        symbolic = ca.Function("f", [symbol], [bent(symbol, curve.bends)])
    np.testing.assert_allclose([float(symbolic(value)) for value in u], curve(u), rtol=0, atol=1e-11)


@pytest.mark.parametrize("seed", range(8))
def test_back_and_forth(seed):
    curve = drawn(seed)
    u = np.linspace(curve.u[0] - 2.0, curve.u[-1] + 2.0, 83)
    np.testing.assert_allclose(curve.inverse(curve(u)), u, rtol=0, atol=1e-10)


@pytest.mark.parametrize("v", [[-1.0, 0.0, 0.0, 1.0], [1.0, -1.0, 2.0, 0.5], [0.0, 0.0, 0.0, 0.0], [3.0, 2.0, 1.0, 0.0]])
def test_the_nearest_command_reaches_what_any_does(v):
    curve, u = Curve("u", [-2.0, -1.0, 1.0, 2.0], v), np.linspace(-2.0, 2.0, 4001)
    for wanted in np.linspace(-2.0, 4.0, 31):
        own = curve.nearest(float(wanted))
        assert -2.0 <= own <= 2.0
        assert abs(curve(np.array(own)) - wanted) <= np.abs(curve(u) - wanted).min() + 1e-9


def test_what_stands_in_for_a_dead_zone_is_the_nearest_curve_that_is_steep_enough():
    near = DEAD.invertible
    rise = FLATTEST * 2.0 / 4.0
    assert near.slopes.min() == pytest.approx(rise)

    def off(v: np.ndarray) -> float:
        return float(np.sum((v - DEAD.v) ** 2))

    bounds = {"type": "ineq", "fun": lambda v: np.diff(v) - rise * np.diff(DEAD.u)}
    other = minimize(off, np.linspace(-1.0, 1.0, 4), constraints=[bounds], tol=1e-12)
    assert off(near.v) <= other.fun + 1e-9
    np.testing.assert_allclose(near.v, other.x, atol=1e-5)
    assert drawn(3).invertible.v.tolist() == pytest.approx(drawn(3).v.tolist(), abs=0.02 * np.ptp(drawn(3).v))


@pytest.mark.parametrize(
    "v", [[1.0, 0.0, 0.0, -1.0], [0.0, 1.0, 0.5, 1.2], [0.0, 0.0, 0.0, 0.0], [2.0, 0.0, 0.1, 2.1], [0.0, 1.0, 1.0, 0.9]]
)
def test_what_turns_back_has_no_inverse_near_it(v):
    with pytest.raises(InputError, match=r"(?s)channel u: f\(u\) turns back or stands still.*mend: keep the commands"):
        Curve("u", [0.0, 1.0, 2.0, 3.0], v).invertible  # noqa: B018
    with pytest.raises(InputError, match="several u"):
        Curve("u", [0.0, 1.0, 2.0, 3.0], v).back  # noqa: B018
