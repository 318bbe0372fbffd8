"""Records that are sampled much faster than their machine moves are thinned out, with a word; others stay as they are."""

from dataclasses import replace

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


def test_a_plant_is_the_measure_where_there_is_one():
    fast = Dataset((slow(ROBOT.dt / 20, 3.0),))
    after, said = thinned(fast, plant=ROBOT)
    assert after.dt == pytest.approx(ROBOT.dt)
    assert "welding-robot is sampled every" in said
    twice = Dataset((slow(ROBOT.dt / 2, 3.0),))
    assert thinned(twice, plant=ROBOT) == (twice, "")
    minutes = Dataset((slow(ROBOT.dt / 60, 1.0),))  # may be minutes for seconds: that is asked
    assert thinned(minutes, plant=ROBOT) == (minutes, "")


def moving(y, *, dt=0.001, name="moving"):
    """A record of outputs y (N,) or (ny, N) that no input moves."""
    return Experiment.from_arrays(name, dt, outputs={f"y{i}": own for i, own in enumerate(np.atleast_2d(y))})


def tones(count, fastest, *others):
    """Sines of these frequencies in periods a sample, of one size, (count,)."""
    return sum(np.sin(2.0 * np.pi * f * np.arange(count) + f) for f in (fastest, *others))


@pytest.mark.parametrize("fastest", [1e-3, 2e-3, 4e-3])
def test_of_the_fastest_tone_twenty_samples_a_period_are_kept(fastest):
    """Whatever the unit of the record, a drift of its zero, slower outputs beside it, and noise of a sixteenth of its size."""
    N = 60_000
    y, t = tones(N, fastest, 0.3 * fastest), np.linspace(-1.0, 3.0, N)
    noise = np.sqrt(0.004) * np.random.default_rng(2).standard_normal(N)  # of the mean square of y
    found = []
    for record in (y, 1e9 * y, 1e-9 * y, y + 100.0 * t, [y, tones(N, 0.1 * fastest)], [tones(N, 0.1 * fastest), y], y + noise):
        after, said = thinned(Dataset((moving(record),)))
        found.append(round(after.dt / 0.001))
        assert f"one sample in {found[-1]} " in said
        assert "nothing moves faster" in said
    expected = 1.0 / (20.0 * fastest)
    assert 0.85 * expected <= min(found) <= max(found) <= expected  # the window makes a tone a little wider
    assert found[1:3] == [found[0], found[0]]


def test_what_is_not_sampled_too_fast_or_does_not_move_stays_as_it_is():
    noise = np.random.default_rng(1).standard_normal(20_000)
    for y in (tones(20_000, 1.0 / 190.0), noise, np.zeros(20_000), np.linspace(0.0, 1.0, 20_000), tones(1900, 1e-3)):
        records = Dataset((moving(y),))
        assert thinned(records) == (records, "")


def test_every_record_keeps_a_thousand_samples():
    long, short = moving(tones(60_000, 1e-3), name="long"), moving(-tones(8_500, 1e-3), name="short")
    after, _ = thinned(Dataset((long, short)))
    assert after.dt == pytest.approx(0.008)  # the motion alone would do with one sample in 50
    assert min(len(e) for e in after) >= 1000


def test_records_with_a_gap_stay_as_they_are_until_they_are_asked_for():
    whole = moving(tones(20_000, 1e-3), name="whole")
    gap = replace(moving(-tones(20_000, 1e-3), name="gap"), t=whole.t + 0.5 * (np.arange(20_000) > 9000))
    assert thinned(Dataset((whole,)))[1]
    for records in (Dataset((whole, gap)), Dataset((gap, whole))):
        assert thinned(records) == (records, "")
        with pytest.raises(InputError, match="gap"):
            thinned(records, 0.01)


def test_the_user_chooses():
    records = Dataset((slow(0.001, 3.0),))
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


def loop(dt: float, seconds: float = 20.0, *, seed: int = 3) -> tuple[Experiment, np.ndarray]:
    """A first-order machine under u = 20 (r - y), y read with noise at every sample, r not logged; and that noise."""
    g = np.random.default_rng(seed)
    count = int(seconds / dt)
    r = np.repeat(g.choice([-1.0, 1.0], count), round(2.0 / dt))[:count]
    noise, x = 0.05 * g.standard_normal(count), 0.0
    u, y = np.empty(count), np.empty(count)
    for k in range(count):
        y[k] = x + noise[k]
        u[k] = 20.0 * (r[k] - y[k])
        x += dt * (-x + 0.3 * u[k])
    return Experiment.from_arrays("loop", dt, inputs={"u": u}, outputs={"y": y}), noise


def test_what_is_thinned_in_a_loop_holds_no_noise_that_its_commands_have_answered():
    """Of a sample's noise no earlier command may know anything; behind a filter those of the last samples do."""
    e, noise = loop(0.002)
    after, said = thinned(Dataset((e,)), 0.02)
    own = after.experiments[0]
    assert "closed loop" in said
    np.testing.assert_array_equal(own["y"], e["y"][::10])
    before = noise.reshape(-1, 10)[:-1].mean(axis=1)  # what the last command has answered
    for y, knows in ((own["y"], False), (e.resample(0.02)["y"], True)):  # the filter would have let it know
        left = (y - (e["y"] - noise)[::10])[1:]
        assert bool(abs(np.corrcoef(left, before)[0, 1]) > 0.2) is knows


def test_commands_are_told_by_the_plant_where_a_file_has_no_roles():
    plant = PLANTS["positioning-axis"]
    q, N = 10, 4000
    g = np.random.default_rng(2)
    names = [*plant.commanded, *plant.output_names]
    columns = {name: np.repeat(g.standard_normal(N // 5), 5) for name in names}
    e = Experiment.from_arrays("file", plant.dt / q, other=columns)
    after, _ = thinned(Dataset((e,)), plant=plant)
    own = after.experiments[0]
    assert own.channels == e.channels
    for name in plant.commanded:
        np.testing.assert_allclose(own[name], columns[name][: len(own) * q].reshape(-1, q).mean(axis=1))
