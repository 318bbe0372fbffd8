"""Classic rules: printed numbers, the model behind them, and what they promise in closed loop."""

import control
import numpy as np
import pytest

from controllers.pid import pid, standard_form
from controllers.rules import FOTD, RULES, amigo_pi, amigo_pid, fotd, lambda_pi, relative_gains, simc_pi
from workbench.basis import CONSTANT
from workbench.data import Channel
from workbench.errors import InputError
from workbench.lpv import OperatingPoint, constant_model


def model_of(system, dt):
    sampled = control.sample_system(control.ss(system), dt)
    point = OperatingPoint(CONSTANT, u=[[0.0]], y=[[0.0]])
    channels = ((Channel("u", "", "input"),), (Channel("y", "", "output"),))
    return constant_model("m", dt, channels, (sampled.A, sampled.B, sampled.C, sampled.D), point)


def test_the_printed_example_of_amigo():
    """[3] Example 7.2: 1 / (s + 1)^4 has T = 2.90, L = 1.42; AMIGO gives a PI with K = 0.414, Ti = 2.66."""
    rule = amigo_pi(FOTD(1.0, 2.90, 1.42))
    assert rule.Kp == pytest.approx(0.414, abs=5e-4)
    assert rule.Ti == pytest.approx(2.66, abs=5e-3)


def test_simc_of_a_pure_lag_and_dead_time():
    """[2] eq. (18), (19) with tc = L: Kp = T / (2 K L), Ti = min(T, 8 L)."""
    assert simc_pi(FOTD(2.0, 4.0, 1.0)).Kp == pytest.approx(1.0)
    assert simc_pi(FOTD(2.0, 4.0, 1.0)).Ti == 4.0
    assert simc_pi(FOTD(2.0, 40.0, 1.0)).Ti == 8.0


@pytest.mark.parametrize(("K", "T", "delay"), [(2.0, 1.5, 6), (-3.0, 0.5, 10), (1.0, 4.0, 0)])
def test_a_sampled_lag_with_dead_time_is_found_again(K, T, delay):
    dt = 0.02
    lag = control.ss(control.sample_system(control.tf([K], [T, 1.0]), dt) * control.tf([1.0], [1.0] + [0.0] * delay, dt))
    point = OperatingPoint(CONSTANT, u=[[0.0]], y=[[0.0]])
    channels = ((Channel("u", "", "input"),), (Channel("y", "", "output"),))
    found = fotd(constant_model("m", dt, channels, (lag.A, lag.B, lag.C, lag.D), point), "y", "u")
    assert pytest.approx(K, rel=1e-6) == found.K
    assert pytest.approx(T, rel=0.02) == found.T
    assert pytest.approx(delay * dt + 0.5 * dt, abs=0.02 * T + 0.5 * dt) == found.L


def test_lambda_tuning_gives_the_closed_loop_it_names():
    """With Ti = T the loop is exp(-L s) / ((lambda + L) s): without dead time a lag of lambda."""
    rule = lambda_pi(FOTD(2.0, 3.0, 0.0), closed=0.7)
    loop = control.tf([2.0], [3.0, 1.0]) * control.tf([rule.Kp * rule.Ti, rule.Kp], [rule.Ti, 0.0])
    closed = control.minreal(control.feedback(loop, 1), verbose=False)
    np.testing.assert_allclose(closed.poles(), [-1 / 0.7], rtol=1e-9)


@pytest.mark.parametrize("name", RULES)
@pytest.mark.parametrize("T", [0.4, 1.0, 5.0])
def test_every_rule_keeps_the_sensitivity_it_is_known_for(name, T):
    dt, delay = 0.02, 25
    lag = control.ss(control.sample_system(control.tf([2.0], [T, 1.0]), dt) * control.tf([1.0], [1.0] + [0.0] * delay, dt))
    rule = RULES[name](FOTD(2.0, T, (delay + 0.5) * dt))
    Kp, Ki, Kd = standard_form(rule.Kp, rule.Ti, rule.Td)
    law = pid(("u",), ("y",), ("r",), dt, [[Kp]], [[Ki]], [[Kd]], Tf=rule.Td / 10)
    omega = np.linspace(1e-3, 0.9999, 4000) * np.pi / dt
    S = 1.0 / np.abs(1.0 + lag(np.exp(1j * omega * dt)) * law.response(omega)[:, 0, 0])
    assert S.max() < 1.75
    loop = control.feedback(lag, control.ss(law.at().A, -law.at().B[:, 1:], law.at().C, -law.at().D[:, 1:], dt))
    assert np.abs(loop.poles()).max() < 1.0


def test_validity_is_said():
    assert "lag-dominated" in amigo_pid(FOTD(1.0, 10.0, 0.1)).warnings[0]
    assert amigo_pid(FOTD(1.0, 1.0, 1.0)).warnings == ()
    assert "advises against" in simc_pi(FOTD(1.0, 1.0, 1.0), closed=0.5).warnings[0]
    assert "dead time dominates" in lambda_pi(FOTD(1.0, 0.2, 1.0)).warnings[-1]


def test_relative_gains_of_the_column():
    """Wood and Berry: lambda_11 = 2.01, as printed wherever the column is."""
    np.testing.assert_allclose(relative_gains([[12.8, -18.9], [6.6, -19.4]]), [[2.01, -1.01], [-1.01, 2.01]], atol=5e-3)


def test_a_channel_without_a_steady_gain_is_refused():
    washout = model_of(control.tf([1.0, 0.0], [1.0, 1.0]), 0.1)
    with pytest.raises(InputError, match="channel y: u does not move it in the steady state"):
        fotd(washout, "y", "u")
    with pytest.raises(InputError, match="unknown output 'z'"):
        fotd(washout, "z", "u")
