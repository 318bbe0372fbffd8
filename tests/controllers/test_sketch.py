"""A sketch against what is computed exactly of the same law, and its steps against python-control."""

from dataclasses import replace
from types import SimpleNamespace

import control
import numpy as np
import pytest

from controllers import ScheduledPIDDesign
from controllers.sketch import Sketch
from tests.controllers.test_pid_design import machine
from workbench.errors import InputError
from workbench.robustness.frozen import Bounds, loops_of, margins_of

BOUNDS = [Bounds(sensitivity=1.2), Bounds(complementary=1.25, sensitivity=2.0), Bounds(effort=1.4), Bounds(2.2, 2.2, 15.0)]


@pytest.fixture(scope="module")
def sketch():
    model = machine()
    return Sketch(ScheduledPIDDesign(knots=3, objective="integral").on(model), model)


def scaled(law, share):
    return replace(law, Kp=share * law.Kp, Ki=share * law.Ki, Kd=share * law.Kd)


@pytest.mark.parametrize("bounds", BOUNDS)
def test_the_bounds_are_kept_and_one_of_them_is_reached(sketch, bounds):
    """By the exact margins of the law with those gains, at the sketch's own schedule values."""
    found = sketch.within(bounds)
    law = scaled(sketch.law, found.share)
    exact = margins_of(law, sketch.model, sketch.rhos, bounds)
    assert found.kept
    assert np.all(exact.radius < 1.0)
    np.testing.assert_allclose(found.sensitivity, exact.sensitivity, rtol=0.015)
    np.testing.assert_allclose(found.complementary, exact.complementary, rtol=0.015)
    used = [
        found.sensitivity.max() / bounds.sensitivity,
        found.complementary.max() / bounds.complementary,
        found.effort.max() / bounds.effort,
    ]
    assert 0.97 < max(used) <= 1.0


def test_a_looser_bound_never_asks_for_smaller_gains(sketch):
    shares = [
        sketch.within(Bounds(sensitivity=bound, complementary=bound, effort=100.0)).share for bound in np.linspace(1.15, 2.4, 9)
    ]
    assert np.all(np.diff(shares) >= 0.0)
    assert shares[-1] > 1.2 * shares[0]


def test_a_bound_that_no_factor_keeps_is_said(sketch):
    found = sketch.within(Bounds(sensitivity=1.0001, effort=1.00001))
    assert (found.share, found.kept) == (1.0, False)


def test_loops_and_steps_are_those_of_the_scaled_law(sketch):
    found = sketch.at(0.7)
    law, model = scaled(sketch.law, 0.7), sketch.model
    for i, rho in enumerate(sketch.rhos):
        np.testing.assert_allclose(found.loops[i] @ [1.0, 1j], loops_of(law, model, rho, sketch._omega), rtol=1e-8, atol=1e-10)
        A, B, C, D = model.freeze(rho)
        plant = control.ss(A, B, C, D, model.dt, inputs=list(law.actuated), outputs=list(law.measured))
        closed = control.interconnect(
            [plant, law.at(rho)],
            inplist=list(law.references),
            outlist=list(law.measured),
            inputs=list(law.references),
            outputs=list(law.measured),
        )
        for j in range(len(law.references)):
            t = np.arange(round(found.t[-1] / model.dt) + 1) * model.dt
            _, y = control.forced_response(closed, t, np.eye(len(law.references))[j][:, None] * np.ones(len(t)))
            every = round(found.t[1] / model.dt)
            np.testing.assert_allclose(found.steps[i, j], np.atleast_2d(y)[j, ::every], rtol=1e-6, atol=1e-8)


def test_what_is_no_pid_of_the_model_is_refused(sketch):
    with pytest.raises(InputError, match="is no PID"):
        Sketch(SimpleNamespace(name="mpc"), sketch.model)
    other = replace(sketch.model, inputs=tuple(replace(c, name=f"{c.name}x") for c in sketch.model.inputs))
    with pytest.raises(InputError, match="choose the model it was made for"):
        Sketch(sketch.law, other)
