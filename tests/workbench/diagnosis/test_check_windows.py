"""Records of unstable and drifting machines, and records that begin in motion, are not refused; what is truly wrong still is.

The machine has equations and a controller of its own: the plant's parameters are off by as much as their tolerance.
"""

from dataclasses import replace

import numpy as np
import pytest

from workbench import Channel, Parameter, Plant
from workbench.data import Dataset, Experiment
from workbench.diagnosis.check.records import check
from workbench.diagnosis.runs import Runner
from workbench.errors import InputError

DT = 0.01

ROD = Plant(
    name="rod",
    states=(Channel("th", "rad"), Channel("w", "rad/s")),
    inputs=(Channel("u", "N m", "input"),),
    outputs=(Channel("th", "rad", "output"),),
    parameters=(Parameter("g", 12.0, "1/s^2", tolerance=0.3), Parameter("b", 20.0, tolerance=0.3)),
    equation=lambda x, u, p, at: {"th": x.w, "w": p.g * np.sin(x.th) + p.b * u.u},
    measure=lambda x, p: {"th": x.th},
    dt=DT,
)

WHEEL = Plant(
    name="wheel",
    states=(Channel("w", "rad/s"),),
    inputs=(Channel("u", "N m", "input"),),
    outputs=(Channel("w", "rad/s", "output"),),
    parameters=(Parameter("J", 1.0, "kg m^2", tolerance=0.3), Parameter("c", 0.02, "N m s", tolerance=0.9)),
    equation=lambda x, u, p, at: {"w": (u.u - p.c * x.w) / p.J},
    measure=lambda x, p: {"w": x.w},
    dt=DT,
)


def rod(seed, count=1500, sign=1.0, g=10.0, b=24.0):
    """An inverted rod that a PD law with dither holds: g and b are not the plant's."""
    random = np.random.default_rng(seed)
    th, w, u, y = 0.1, 0.0, np.zeros(count), np.zeros(count)
    dither = np.repeat(random.choice([-0.6, 0.6], count), 25)[:count]
    for k in range(count):
        y[k] = th + 1e-3 * random.standard_normal()
        u[k] = dither[k] - 1.5 * th - 0.3 * w
        for _ in range(10):
            w += 0.1 * DT * (g * np.sin(th) + b * u[k])
            th += 0.1 * DT * w
    return Experiment.from_arrays(f"rod {seed}", DT, inputs={"u": sign * u}, outputs={"th": y}, units={"u": "N m", "th": "rad"})


def wheel(seed, sign=1.0, start=80.0, load=1.5, count=2000):
    """A flywheel that runs down while a load that nobody logs pulls at it."""
    random = np.random.default_rng(seed)
    u, w, y = np.repeat(random.choice([-4.0, 4.0], count), 40)[:count], start, np.zeros(count)
    for k in range(count):
        y[k] = w + 0.02 * random.standard_normal()
        w += DT * (u[k] - load * (1.0 + np.sin(k / 300.0)) - 0.03 * w) / 0.9
    return Experiment.from_arrays(f"wheel {seed}", DT, inputs={"u": sign * u}, outputs={"w": y}, units={"u": "N m", "w": "rad/s"})


@pytest.mark.parametrize("seed", range(5))
def test_an_unstable_machine_in_its_loop_is_not_refused_and_a_reversed_sign_is(seed):
    check(ROD, Dataset((rod(seed),)))
    with pytest.raises(InputError, match="u looks reversed in sign, or"):
        check(ROD, Dataset((rod(seed, sign=-1.0),)))


@pytest.mark.parametrize("seed", range(5))
def test_a_machine_that_drifts_under_an_unlogged_load_is_not_refused_and_a_reversed_sign_is(seed):
    check(WHEEL, Dataset((wheel(seed),)))
    with pytest.raises(InputError, match="u looks reversed in sign, or"):
        check(WHEEL, Dataset((wheel(seed, -1.0, load=0.0, start=0.0),)))


def test_windows_of_what_is_unstable_are_short():
    assert 20 <= Runner.of(ROD, rod(1)).window <= 80  # 2 / sqrt(12) s
    assert Runner.of(WHEEL, wheel(1)).window == 500


def test_a_run_of_the_whole_record_begins_where_the_record_does():
    """80 rad/s, and the plant's own start is 0."""
    runner = Runner.of(WHEEL, wheel(2, load=0.0))
    usual, fitted = (runner.whole([runner.u], fitted=fitted)[0, 0, 0] for fitted in (False, True))
    assert usual == 0.0
    assert fitted == pytest.approx(80.0, abs=2.0)


def test_a_record_of_something_else_is_refused_with_the_time_at_which_the_run_leaves_it():
    e = wheel(3)
    walk = np.convolve(np.random.default_rng(4).standard_normal(len(e) + 60), np.ones(61), "valid")
    other = replace(e, values=np.column_stack([e["u"], walk]))
    with pytest.raises(InputError) as reason:
        check(WHEEL, Dataset((other,)))
    assert "follows none of w" in reason.value.problem
    assert "leaves the record by more than 2 of its spreads at t = " in reason.value.problem
    (note,) = [n for n in check(WHEEL, Dataset((other,)), anyway=True) if "taken all the same" in n.sentence]
    assert "follows none of w" in note.sentence
    assert note.record == e.name


def test_what_would_hold_a_run_is_named():
    """The friction of the data sheet stops the wheel too soon; within its tolerance it does not."""
    e = wheel(5, load=0.0, count=4000)
    heavy = replace(WHEEL, parameters=(WHEEL.parameters[0], replace(WHEEL.parameters[1], value=0.3, tolerance=0.95)))
    said = Runner.of(heavy, e).told_until(e.t)
    assert "c = 0.03 N m s would hold it to the end" in said


def test_anyway_does_not_take_what_has_no_channels():
    with pytest.raises(InputError, match="needs the inputs u"):
        check(WHEEL, Dataset((wheel(1).select(["w"]),)), anyway=True)


def test_a_plant_that_nothing_commands_is_checked_by_its_logged_inputs():
    moved = replace(WHEEL, inputs=(Channel("u", "N m", "schedule"),), limits={})
    assert not [n for n in check(moved, Dataset((wheel(6, start=0.0, load=0.0),))) if "refused" in n.sentence]
    still = wheel(6)
    with pytest.raises(InputError, match="no input moves"):
        check(moved, Dataset((replace(still, values=still.values * [0.0, 1.0]),)))


def test_a_sensor_without_a_sign_is_no_other_machine():
    """The wheel turns both ways and its pulses are counted: even in the torque, so no simulation follows it."""
    e = wheel(7, start=0.0, load=0.0, count=4000)
    counted = replace(e, values=np.column_stack([e["u"], np.abs(e["w"])]))
    check(WHEEL, Dataset((counted,)))


def test_a_record_that_is_too_short_to_tell_is_not_refused_for_it():
    """Held-out runs of a counter without a sign are short: nothing is known for them, and nothing against them."""
    e = wheel(9, start=0.0, load=0.0, count=100)
    counted = replace(e, values=np.column_stack([e["u"], np.abs(e["w"])]))
    (note,) = [n for n in check(WHEEL, Dataset((counted,))) if "follows none of w" in n.sentence]
    assert "too short to tell whether it moves with u" in note.sentence
