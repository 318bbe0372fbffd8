"""Records that are sampled much faster than their machine moves are thinned out, with a word; others stay as they are."""

import numpy as np
import pytest
from scipy.signal import lfilter

from plants import PLANTS
from workbench.data import Dataset, Experiment
from workbench.decimation import thinned
from workbench.errors import InputError

ROBOT = PLANTS["welding-robot"]


def slow(dt, seconds=60.0, *, time=1.0, hold=2.0, seed=1, noise=0.01):
    """A first-order machine under held random inputs, sampled every dt."""
    g = np.random.default_rng(seed)
    count = int(seconds / dt)
    u = np.repeat(g.choice([-1.0, 1.0], count), max(round(hold / dt), 1))[:count]
    a = np.exp(-dt / time)
    y = lfilter([0, 1 - a], [1, -a], u) + noise * g.standard_normal(count)
    return Experiment.from_arrays("slow", dt, inputs={"u": u}, outputs={"y": y})


@pytest.mark.slow
def test_a_kilohertz_record_of_a_slow_machine_is_thinned_and_that_is_said():
    before = Dataset((slow(0.001),))
    after, said = thinned(before)
    assert 0.01 <= after.dt <= 0.06
    assert len(after.experiments[0]) >= 1000
    assert "sampled every 0.001 s, used every" in said
    assert "anti-aliasing filter" in said
    assert "--dt 0.001 keeps all" in said


@pytest.mark.parametrize(("dt", "hold"), [(0.1, 0.7), (0.05, 2.0), (0.02, 0.4)])
def test_records_of_a_usual_rate_stay_as_they_are(dt, hold):
    records = Dataset((slow(dt, 200.0, hold=hold),))
    assert thinned(records) == (records, "")


@pytest.mark.slow
def test_the_machines_of_the_workbench_stay_as_they_are():
    from studies.experiments import EXPERIMENTS, plan
    from workbench.simulation import simulate

    for name in ("welding-robot", "web-winding"):
        for experiment in EXPERIMENTS[name]:
            todo = plan(name, experiment)
            e = simulate(PLANTS[name], todo.controller, todo.scenario(1)).experiment
            assert thinned(Dataset((e,)))[1] == "", (name, experiment)


@pytest.mark.slow
def test_a_plant_is_the_measure_where_there_is_one():
    fast = Dataset((slow(ROBOT.dt / 20),))
    after, said = thinned(fast, plant=ROBOT)
    assert after.dt == pytest.approx(ROBOT.dt)
    assert "welding-robot is sampled every" in said
    twice = Dataset((slow(ROBOT.dt / 2),))
    assert thinned(twice, plant=ROBOT) == (twice, "")
    minutes = Dataset((slow(ROBOT.dt / 60),))  # may be minutes for seconds: that is asked
    assert thinned(minutes, plant=ROBOT) == (minutes, "")


@pytest.mark.slow
def test_the_user_chooses():
    records = Dataset((slow(0.001),))
    assert thinned(records, 0.001) == (records, "")
    assert thinned(records, 0.004)[0].dt == pytest.approx(0.004)
    with pytest.raises(InputError, match="expected a whole number"):
        thinned(records, 0.0017)


@pytest.mark.slow
def test_a_thinned_record_gives_the_same_machine():
    """The pole of the discrete model is that of the slow machine, which at 1 kHz would drown in noise."""
    from workbench.identification import METHODS

    after, _ = thinned(Dataset((slow(0.001, 120.0),)))
    model = METHODS["lti"](order=1).fit(after)
    assert -after.dt / np.log(model.A[0, 0, 0]) == pytest.approx(1.0, rel=0.05)
