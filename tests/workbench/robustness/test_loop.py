"""The loop of a law and interval models: the machine that they write down, in any coordinates, and what is refused."""

from dataclasses import replace

import control
import numpy as np
import pytest

from tests.workbench.robustness.loops import DT, law, machine_run, model, two_regressions
from workbench.errors import InputError
from workbench.intervals.model import Simulation
from workbench.intervals.regressors import ARX, FIR
from workbench.robustness.loop import close
from workbench.robustness.uncertain import UncertainLoop


def drawn(models, N, seed=1):
    random = np.random.default_rng(seed)
    return {m.output.name: random.uniform(-1.0, 1.0, (N, len(m.form.names))) for m in models}


def by_parameter(loop, models, one_law, values):
    """Values (.., p of the model) by output name, put in the order of the loop's parameters."""
    return np.stack(
        [values[name][..., models[name].form.names.index(own)] for name, own in (n.split(": ") for n in loop.parameters)], -1
    )


def test_the_loop_is_the_machine_under_parameters_that_move():
    """Every regressor z of every sample, under random parameters, from the equations written out sample by sample."""
    models, one = two_regressions()
    known = {m.output.name: m for m in models}
    N, start = 40, {"y1": [0.3, -0.2], "y2": [0.1, 0.4, -0.5]}
    delta = drawn(models, N)
    _, seen = machine_run(models, one, delta, start)
    loop = close(models, one)
    z = by_parameter(loop, known, one, seen)
    d = by_parameter(loop, known, one, delta)
    x = started(loop, models, one, start)
    for k in range(N):
        np.testing.assert_allclose(loop.C @ x, z[k], atol=1e-12)
        x = loop.at(d[k]) @ x


def started(loop, models, one, start):
    """The state with these past outputs and all else at rest: past outputs come first, in the order of the law, as changes."""
    x = np.zeros(len(loop.A))
    at = 0
    for name in one.measured:
        values = start[name]
        x[at] = values[0]
        x[at + 1 : at + len(values)] = -np.diff(values)
        at += len(values)
    return x


def test_poles_are_those_of_python_control():
    """One output: the transfer function of the regression at a corner of its box, closed with the law."""
    theta, radius = np.array([-1.2, 0.4, 0.1, 0.05, 0.7]), np.array([0.02, 0.01, 0.01, 0.005, 0.1])
    own = model("y", ("u",), ARX(order=2, delta=False), theta, radius)
    one = replace(law(), actuated=("u",), measured=("y",), references=("r",), Kp=[[[0.6]]], Ki=[[[0.5]]], Kd=[[[0.05]]],
                  Kr=[[[0.0]]],
                  u0=[[0.0]], b=[1.0], c=[1.0], low=[-np.inf], high=[np.inf], rate=[np.inf])  # fmt: skip
    loop = close([own], one)
    assert loop.parameters == ("y: -y(k-1)", "y: -y(k-2)", "y: u(k-1)", "y: u(k-2)")  # the bias turns no pole
    for delta in ([0, 0, 0, 0], [1, -1, 1, 1], [-1, 0.5, 0, -1]):
        a1, a2, b1, b2 = theta[:4] + radius[:4] * delta
        plant = control.ss(control.tf([b1, b2], [1.0, a1, a2], DT))
        answer = one.at()
        K = control.ss(answer.A, -answer.B[:, 1:], answer.C, -answer.D[:, 1:], DT)
        expected = control.feedback(plant * K, 1).poles()
        found = np.linalg.eigvals(loop.at(np.array(delta, dtype=float)))
        for pole in expected[np.abs(expected) > 1e-6]:
            assert np.abs(found - pole).min() < 1e-7
        assert np.abs(found).max() == pytest.approx(np.abs(expected).max(), abs=1e-9)


def test_a_mode_is_taken_by_the_schedule():
    structure = ARX(order=1, delta=False, bias=False)
    own = model("y2", ("u1",), structure, [[-0.5, 0.1], [-0.6, 0.2], [-0.7, 0.3]], np.full((3, 2), 0.01), schedule="r")
    other = model("y1", ("u2",), FIR(order=3), [0.1, 0.2, 0.1, 0.5], np.full(4, 0.01))
    for i, rho in enumerate((0.5, 1.5, 2.99)):
        loop = close([own, other], law(), rho)
        one = close([model("y2", ("u1",), structure, own.modes[i].box.centre, np.full(2, 0.01)), other], law(), rho)
        np.testing.assert_array_equal(loop.A, one.A)
    with pytest.raises(InputError, match=r"no mode was identified at r = 3\.5 m"):
        close([own, other], law(), 3.5)
    with pytest.raises(InputError, match="no value of r"):
        close([own, other], law())


def test_balanced_coordinates_change_numbers_and_nothing_else():
    loop = close(*two_regressions())
    own = loop.balanced()
    value = np.linalg.eigvalsh(np.eye(len(own.A)) - own.A.T @ own.A)
    assert value.min() > 0.0  # x'x falls in the middle of the boxes
    z = np.exp(0.7j)
    for one in (loop, own):
        gain = one.C @ np.linalg.solve(z * np.eye(len(one.A)) - one.A, one.B)
        np.testing.assert_allclose(gain, loop.C @ np.linalg.solve(z * np.eye(len(loop.A)) - loop.A, loop.B), rtol=1e-6)


def test_what_does_not_fit_is_refused():
    models, one = two_regressions()
    with pytest.raises(InputError, match="no interval model of y2"):
        close(models[:1], one)
    with pytest.raises(InputError, match="sample time"):
        close(models, replace(one, dt=0.05))
    direct = model("y1", ("u1",), ARX(order=1, delay=0), [0.5, 0.1, 0.1, 0.0], np.full(4, 0.01))
    with pytest.raises(InputError, match="within the sample"):
        close([direct, models[1]], one)
    with pytest.raises(InputError, match="not stable in the middle"):
        close(models, replace(one, Ki=100.0 * one.Ki)).balanced()
    with pytest.raises(InputError, match="channel must be"):
        UncertainLoop(np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.ones(1), np.ones(1))


def test_where_modes_overlap_the_box_holds_them_all():
    """Each of the modes may be the machine there: every corner of both lies in the box that counts."""
    structure = ARX(order=1, delta=False, bias=False)
    wide = model("y2", ("u1",), structure, [[-0.5, 0.1], [-0.6, 0.2]], [[0.01, 0.02], [0.3, 0.01]], schedule="r")
    other = model("y1", ("u2",), FIR(order=1), [0.1, 0.5], np.full(2, 0.01))
    loop = close([wide, other], law(), 1.0)
    at = [loop.parameters.index(name) for name in ("y2: -y2(k-1)", "y2: u1(k-1)")]
    np.testing.assert_allclose(loop.lam[at], [0.3, 0.065])
    (centre,) = close([model("y2", ("u1",), structure, [-0.6, 0.145], [0.3, 0.065]), other], law()).A[None]
    np.testing.assert_allclose(loop.A, centre, atol=1e-12)
    for rho, radius in ((0.5, [0.01, 0.02]), (1.5, [0.3, 0.01])):
        np.testing.assert_allclose(close([wide, other], law(), rho).lam[at], radius)


def test_what_would_leave_a_path_out_is_refused():
    models, one = two_regressions()
    fed = model("y1", ("u1", "y2"), ARX(order=1, delta=False, bias=False), [0.5, 0.1, 0.9], np.full(3, 0.01))
    with pytest.raises(InputError, match="y2 as input, which is the output of another model"):
        close([fed, models[1]], one)
    with pytest.raises(InputError, match="commands u9, which moves no output"):
        close(models, replace(one, actuated=("u1", "u9")))
    with pytest.raises(InputError, match="two interval models of one output"):
        close([*models, models[0]], one)
    with pytest.raises(InputError, match="promises free runs"):
        close([replace(models[0], semantics=Simulation()), models[1]], one)
    moving = replace(one, schedule="r", span=(0.0, 1.0))
    with pytest.raises(InputError, match="no value of r"):
        close(models, moving)
    scheduled = model("y1", ("u1",), ARX(order=1, delta=False, bias=False), [[0.5, 0.1]], np.full((1, 2), 0.01), schedule="speed")
    with pytest.raises(InputError, match="scheduled on r, speed"):
        close([scheduled, models[1]], moving, 0.5)
