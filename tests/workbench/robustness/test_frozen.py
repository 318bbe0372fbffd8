"""Opened loops from the blocks of the loop gain; one law for several models: what they must share, and whose margins count."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete

from controllers.pid import pid
from controllers.pid_design import design_pid
from tests.controllers.test_pid_design import DT, TURNED, machine
from workbench.basis import CONSTANT
from workbench.data import Channel
from workbench.errors import InputError
from workbench.lpv import OperatingPoint, constant_model
from workbench.robustness.frozen import PEAKS, Bounds, closed_loop, loops_of, margins_of

BOUNDS = Bounds(1.5, 1.4, 4.0)


def test_a_loop_is_opened_while_the_others_stay_closed():
    """L_i = L_ii - L_io (1 + L_oo)^-1 L_oi with L = K P, o all others: three inputs, two outputs."""
    random = np.random.default_rng(7)
    A, B, C = np.diag([0.8, 0.5, -0.3]) + 0.1 * random.normal(size=(3, 3)), random.normal(size=(3, 3)), random.normal(size=(2, 3))
    D = 0.1 * random.normal(size=(2, 3))
    channels = [Channel(n, "V", "input") for n in "abc"], [Channel(n, "m", "output") for n in "de"]
    model = constant_model("m", DT, channels, (A, B, C, D), OperatingPoint(CONSTANT, u=np.zeros((1, 3)), y=np.zeros((1, 2))))
    Kp, Ki, Kd = (random.normal(size=(3, 2)) * size for size in (0.3, 0.5, 0.05))
    law = pid("abc", "de", ("d_set", "e_set"), DT, Kp, Ki, Kd, Tf=0.3)
    omega = np.array([0.05, 0.7, 6.0, 25.0])
    found = loops_of(law, model, None, omega)
    for w, own in zip(omega, found, strict=True):
        z = np.exp(1j * w * DT)
        K = Kp + Ki * DT / (z - 1.0) + Kd * (z - 1.0) / ((0.3 + DT) * z - 0.3)
        L = K @ (C @ np.linalg.solve(z * np.eye(3) - A, B) + D)
        for i in range(3):
            o = [j for j in range(3) if j != i]
            expected = L[i, i] - L[i, o] @ np.linalg.solve(np.eye(2) + L[np.ix_(o, o)], L[o, i])
            np.testing.assert_allclose(own[i], expected, rtol=1e-9)


@pytest.mark.parametrize("side", ["inputs", "outputs"])
def test_models_in_other_units_are_not_designed_for_together(side):
    first, *rest = getattr(machine(), side)
    other = replace(machine(), **{side: (replace(first, unit=f"m{first.unit}"), *rest)}, name="other")
    with pytest.raises(InputError, match="other: other inputs, outputs"):
        design_pid(machine(), knots=1, robust_to=(other,))


@pytest.mark.slow
def test_the_margins_of_one_law_are_the_worst_of_all_its_models():
    """One is worse in one respect, the other in another; each peak is told with its frequency."""
    other = machine(slow=0.9, turned=tuple(1.6 * G for G in TURNED))
    weak = machine(slow=0.97, turned=tuple(0.5 * G for G in TURNED))  # its poles are the slowest, its peaks are not
    design = design_pid(machine(), knots=1, bounds=BOUNDS, robust_to=(other, weak))
    each = [margins_of(design.law, model, design.margins.rho, BOUNDS, design.scale) for model in (machine(), other, weak)]
    worst = set()
    for key in PEAKS:
        values = np.stack([getattr(m, key) for m in each])
        np.testing.assert_allclose(getattr(design.margins, key), values.max(axis=0), rtol=1e-9)
        worst |= set(values.argmax(axis=0).ravel().tolist())
    assert len(worst) > 1  # they really differ in whose it is
    np.testing.assert_allclose(design.margins.bandwidth, np.min([m.bandwidth for m in each], axis=0))
    for j, key in enumerate(PEAKS[:3]):
        whose = np.argmax([getattr(m, key) for m in each], axis=0)
        expected = [each[w].frequencies[i, j] for i, w in enumerate(whose)]
        np.testing.assert_array_equal(design.margins.frequencies[:, j], expected)


@pytest.mark.parametrize("zeta", [0.3, 0.03, 0.003])
def test_peaks_between_the_frequencies_of_a_grid_are_seen(zeta):
    """1 / (s^2 + 2 zeta s + 1) under laws that only just keep it stable, against grids across every pole, to 1e-4."""
    A, B, C, D, _ = cont2discrete((*_companion(zeta), np.array([[1.0, 0.0]]), np.zeros((1, 1))), DT)
    point = OperatingPoint(CONSTANT, u=np.zeros((1, 1)), y=np.zeros((1, 1)))
    model = constant_model("m", DT, ([Channel("u", "V", "input")], [Channel("y", "m", "output")]), (A, B, C, D), point)
    for P, integral in ((0.5 * zeta, 0.01 * zeta), (0.1 * zeta, 0.9 * zeta), (2.0 * zeta, 0.3 * zeta)):
        law = pid(("u",), ("y",), ("r",), DT, [[P]], [[integral]], [[0.0]], Tf=0.3)
        found = margins_of(law, model, [None])
        assert found.radius[0] < 1.0
        poles = closed_loop(law, model, None).system.poles.astype(complex)
        poles = np.log(poles[np.abs(poles) > 1e-6, None]) / DT
        across = np.abs(poles.imag) + np.abs(poles.real) * np.tan(np.linspace(-1.57, 1.57, 4001))
        omega = np.sort(np.append(np.geomspace(1e-8, np.pi / DT, 4000), across[(across > 1e-8) & (across < np.pi / DT)]))
        z = np.exp(1j * omega * DT)
        L = (P + integral * DT / (z - 1.0)) * (C @ np.linalg.solve(z[:, None, None] * np.eye(2) - A, B))[:, 0, 0]
        expected = np.abs(1.0 / (1.0 + L)).max(), np.abs(L / (1.0 + L)).max()
        assert [found.sensitivity[0], found.complementary[0]] == pytest.approx(expected, rel=1e-4)
        assert found.loops[0, 0] == pytest.approx(expected[0], rel=1e-4)


def _companion(zeta):
    return np.array([[0.0, 1.0], [-1.0, -2.0 * zeta]]), np.array([[0.0], [1.0]])


def test_a_law_has_its_channels_in_its_own_order():
    """Commands and measurements of a law in another order than those of the model: the margins are the same."""
    random = np.random.default_rng(3)
    A = np.diag([0.6, 0.4, -0.3]) + 0.1 * random.normal(size=(3, 3))
    B, C = np.eye(3, 2) + 0.2 * random.normal(size=(3, 2)), np.eye(2, 3) + 0.2 * random.normal(size=(2, 3))
    channels = [Channel(n, "V", "input") for n in "ab"], [Channel(n, "m", "output") for n in "de"]
    point = OperatingPoint(CONSTANT, u=np.zeros((1, 2)), y=np.zeros((1, 2)))
    model = constant_model("m", DT, channels, (A, B, C, np.zeros((2, 2))), point)
    Kp, Ki = 0.01 * random.normal(size=(2, 2)), 0.1 * np.linalg.inv(C @ np.linalg.solve(np.eye(3) - A, B))
    one = pid("ab", "de", ("d_set", "e_set"), DT, Kp, Ki, 0.0 * Kp, Tf=0.3)
    turned = pid("ba", "ed", ("e_set", "d_set"), DT, *(M[::-1, ::-1] for M in (Kp, Ki, 0.0 * Kp)), Tf=0.3)
    scale = np.array([0.5, 2.0])
    first, second = (margins_of(law, model, [None], BOUNDS, scale) for law in (one, turned))
    assert first.radius[0] < 1.0
    for key in ("sensitivity", "complementary", "effort", "radius", "bandwidth"):
        np.testing.assert_allclose(getattr(second, key), getattr(first, key), rtol=1e-6)
    np.testing.assert_allclose(second.delay[:, ::-1], first.delay, rtol=1e-6)
