"""What every kind of controller that a file can hold must keep: a kind without a sample here fails."""

import pickle

import numpy as np
import pytest

from controllers import load_controller, save_controller
from controllers.files import KINDS
from plants import WELDING_ROBOT
from tests.controllers.test_mpc import law as mpc
from tests.controllers.test_nmpc import robot as nmpc
from tests.controllers.test_scheduled_pid import scheduled
from workbench.physics.controller import check_controller, stepped
from workbench.robustness.linear_law import LINEAR, without_linear_form

LIMITS = {"low": (-3.0, -2.0), "high": (4.0, 3.0), "rate": (20.0, 30.0)}
SAMPLES = {"scheduled-pid": lambda: scheduled(**LIMITS), "mpc": mpc, "nmpc": nmpc}


@pytest.fixture(scope="module", params=sorted(KINDS))
def law(request):
    assert request.param in SAMPLES, f"no sample of {request.param}: add one"
    return SAMPLES[request.param]()


def signals(law, seed, count=12, size=1.0):
    random = np.random.default_rng(seed)
    between = getattr(law, "span", (1.0, 2.0))  # the samples without a span of their own are scheduled from 1 to 2
    rho = random.uniform(*between, count) if law.schedule else [None] * count
    return size * random.normal(size=(count, len(law.references))), size * random.normal(size=(count, len(law.measured))), rho


def commands(law, r, y, rho, u=None):
    """Commands (N, nu) in open loop, beginning at inputs u where they are given."""
    memory, said = law.init(u), []
    for k in range(len(r)):
        command, memory = stepped(law, memory, r[k], y[k], rho[k])
        said.append(command)
    return np.array(said)


def test_it_is_a_controller(law):
    check_controller(law, "sample")
    assert type(law) in KINDS.values()


def test_a_file_holds_all_of_it(law, tmp_path):
    again = load_controller(save_controller(law, tmp_path / "law.json"), lambda _: WELDING_ROBOT)
    assert type(again) is type(law)
    r, y, rho = signals(law, 1)
    np.testing.assert_array_equal(commands(again, r, y, rho), commands(law, r, y, rho))


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_commands_are_numbers_within_the_limits_and_the_rate(law, size):
    u = commands(law, *signals(law, 2, size=size), np.zeros(len(law.actuated)))
    assert np.isfinite(u).all()
    assert (u >= law.low - 1e-9).all()
    assert (u <= law.high + 1e-9).all()
    steps = np.abs(np.diff(u, axis=0, prepend=np.zeros((1, u.shape[1]))))
    assert (steps <= law.rate * law.dt * (1.0 + 1e-9)).all()


def test_a_reading_that_is_none_makes_no_command_that_is_none(law):
    """A sensor that fails for a sample, each output in turn, and sound readings again."""
    r, y, rho = signals(law, 5)
    for j in range(y.shape[1]):
        lost = y.copy()
        lost[4, j] = np.nan
        assert np.isfinite(commands(law, r, lost, rho)).all()


def test_a_memory_is_a_value(law):
    """Asked twice with one memory it says the same, and the memory that it was given is as it was."""
    r, y, rho = signals(law, 3)
    _, memory = stepped(law, law.init(), r[0], y[0], rho[0])
    before = pickle.dumps(memory)
    first, _ = stepped(law, memory, r[1], y[1], rho[1])
    stepped(law, law.init(), r[2], y[2], rho[2])
    again, _ = stepped(law, memory, r[1], y[1], rho[1])
    np.testing.assert_array_equal(first, again)
    assert pickle.dumps(memory) == before


def test_it_takes_over_without_a_bump(law):
    """From the inputs that it is given the first command is no farther than the rate lets it go."""
    u = 0.5 * (np.maximum(law.low, -2.0) + np.minimum(law.high, 2.0))
    r, y, rho = signals(law, 4, count=1, size=1e-3)
    assert (np.abs(commands(law, r, y, rho, u)[0] - u) <= law.rate * law.dt * (1.0 + 1e-9)).all()


def test_a_linear_form_is_what_it_commands(law):
    if all(hasattr(law, name) for name in LINEAR):
        assert without_linear_form(law) == ""
    else:
        assert "no linear law" in without_linear_form(law)
