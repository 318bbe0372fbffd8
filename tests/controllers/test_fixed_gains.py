"""What gains that move with the schedule are worth, and laws of which the feedforward alone moves."""

import numpy as np
import pytest

from controllers import ScheduledPIDDesign
from controllers.pid_design import PIDDesign
from studies.cli import main
from workbench.basis import PiecewiseLinear
from workbench.data import Channel
from workbench.errors import InputError
from workbench.lpv import LPVModel, OperatingPoint, Predictor, Term

DT = 0.1


def model(gain: float, pole: float = 0.9, seed: int = 0) -> LPVModel:
    """Two states behind one input whose gain grows `gain` times over r, about an operating point that moves."""
    random, two = np.random.default_rng(seed), PiecewiseLinear((1.0, 2.0))
    A = np.array([[pole, 0.1], [0.0, 0.6]]) + 0.02 * random.normal(size=(2, 2))
    B, C, K = np.array([[0.1], [0.3]]), np.array([[1.0, 0.2]]), np.array([[0.4], [0.1]])
    each = lambda M, other: np.stack([M, other])  # noqa: E731
    return LPVModel(
        "m", DT, (Channel("u", "V", "input"),), (Channel("y", "m", "output"),), (Channel("r", "m", "schedule"),), [[1.0, 2.0]],
        two, (Term(0), Term(1)), each(A, A), each(B, gain * B), each(C, C), np.zeros((2, 1, 1)),
        OperatingPoint(two, u=[[0.5], [1.5]], y=[[5.0], [3.0]]),
        Predictor(each(A - K @ C, A - K @ C), each(B, gain * B), each(K, K)), np.diag([0.01]),
    )  # fmt: skip


def designed(own: LPVModel, **options) -> PIDDesign:
    return ScheduledPIDDesign(knots=3, **options).design(own)


def spread(deviation: np.ndarray) -> float:
    return float(np.sqrt(np.sum(deviation**2)))


def test_on_a_machine_that_does_not_change_the_gains_need_not_move():
    found = designed(model(1.0))
    assert found.gained == pytest.approx(0.0, abs=0.01)
    still = designed(model(1.0), moving=False)
    assert np.ptp(still.law.Kp, axis=0).max() == 0.0
    assert np.ptp(still.law.Ki, axis=0).max() == 0.0
    assert np.ptp(still.law.u0, axis=0).max() > 0.3  # what is commanded at rest moves
    assert still.law.schedule == "r"


def test_the_more_a_machine_changes_the_more_moving_gains_take_off():
    gained = [designed(model(gain)).gained for gain in (1.0, 2.0, 4.0)]
    assert gained == sorted(gained)
    assert gained[-1] > 0.05


@pytest.mark.parametrize("seed", range(3))
def test_a_law_whose_gains_move_is_never_worse_than_the_one_whose_do_not(seed):
    own = model(np.random.default_rng(seed).uniform(1.0, 4.0), pole=0.85 + 0.04 * seed, seed=seed)
    moving, still = designed(own), designed(own, moving=False)
    assert moving.unmoved is not None
    assert spread(moving.deviation) <= 1.005 * spread(still.deviation)
    np.testing.assert_allclose(moving.unmoved, still.deviation, rtol=5e-3)
    for found in (moving, still):
        assert found.margins.sensitivity.max() <= 1.6 + 1e-6
        assert found.margins.radius.max() < 1.0
    assert still.unmoved is None
    assert np.isnan(still.gained)


@pytest.mark.slow
def test_the_deviation_of_fixed_gains_is_that_of_their_loops():
    """By a covariance equation of the closed loop of another make: noise and load steps through long random runs."""
    own, random = model(3.0), np.random.default_rng(1)
    found = designed(own)
    still = designed(own, moving=False)
    assert found.unmoved is not None
    for n, rho in enumerate(found.knots):
        A, B, C, _ = own.freeze(rho)
        K, e = own.disturbance(rho)[0], 0.1 * random.standard_normal(400_000)
        gains = still.law.gains_at(rho)
        jumps = random.normal(size=len(e)) * found.loads.size[0] * np.sqrt(own.dt / found.loads.every)
        load, x, z, f, d = 0.0, np.zeros(2), 0.0, 0.0, 0.0
        a, total = still.law.Tf / (still.law.Tf + DT), 0.0
        for k in range(len(e)):
            y = float(C[0] @ x) + e[k]
            f = a * f + (1.0 - a) / DT * (-y - d)
            d = -y
            u = -gains.Kp[0, 0] * y + z + gains.Kd[0, 0] * f
            z -= DT * gains.Ki[0, 0] * y
            load += jumps[k]
            x = A @ x + B[:, 0] * (u + load) + K[:, 0] * e[k]
            total += y * y
        assert np.sqrt(total / len(e)) == pytest.approx(found.unmoved[n, 0], rel=0.05)


@pytest.mark.slow
def test_where_no_fixed_gains_keep_the_bounds_it_is_said(tmp_path, capsys):
    """An unstable machine is held by no less than a certain gain, and loses its margins under much more."""
    own = model(8.0, pole=1.05)
    own.save(tmp_path / "m.json")
    words = ["design", "scheduled-pid", "--model", str(tmp_path / "m.json"), "--knots", "3", "--effort", "10"]
    assert main([*words, "--out", str(tmp_path / "d")]) == 0
    assert "no gains that do not move keep these bounds over the schedule" in capsys.readouterr().out
    with pytest.raises(InputError):
        designed(own, moving=False, effort=10.0)


@pytest.mark.slow
def test_the_command_says_what_moving_gains_are_worth(tmp_path, capsys):
    for gain, said in ((1.0, "the gains need not move: with --fixed-gains"), (4.0, "moving gains take ")):
        model(gain).save(tmp_path / "m.json")
        words = ["design", "scheduled-pid", "--model", str(tmp_path / "m.json"), "--knots", "3", "--out", str(tmp_path / "d")]
        assert main(words) == 0
        assert said in capsys.readouterr().out
    assert main([*words[:-1], str(tmp_path / "still"), "--fixed-gains"]) == 0
    assert "gains that do not move" not in capsys.readouterr().out
