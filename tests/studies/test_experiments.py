import numpy as np
import pytest

from plants import POSITIONING_AXIS, WEB_WINDING
from studies.experiments import EXPERIMENTS
from workbench.errors import InputError
from workbench.excitation import prbs
from workbench.physics.controller import Playback
from workbench.simulate import Scenario, simulate, simulate_batch


def test_before_the_first_sample_the_equilibrium_input_was_held():
    _, u0 = WEB_WINDING.equilibrium()
    loop = Playback(("V1", "V2"), WEB_WINDING.dt)
    still = Scenario("still", {"V1": np.full(40, u0[0]), "V2": np.full(40, u0[1])})
    delayed = simulate(WEB_WINDING, loop, still, effects={"input-delay@V1": {"time": 0.1}, "input-delay@V2": {"time": 0.33}})
    np.testing.assert_allclose(delayed.states.values, simulate(WEB_WINDING, loop, still).states.values, rtol=1e-6)


def test_every_lane_starts_from_its_own_scenario():
    loop = Playback(("F",), 0.001)
    each = [Scenario("s", {"F": np.zeros(20)}, start={"v": v}) for v in (0.0, 0.5, -1.0)]
    batch = simulate_batch(POSITIONING_AXIS, loop, each)
    assert batch.states[:, 0, 1].tolist() == [0.0, 0.5, -1.0]


def test_steps_are_short_enough_for_dry_friction_that_is_only_met_at_rest():
    """A sliding axis comes to rest: the smoothed friction is stiff there and flat where the run starts."""
    args = (POSITIONING_AXIS, Playback(("F",), 0.001), Scenario("stop", {"F": np.zeros(300)}, start={"v": 0.05}))
    effects = {"coulomb@slide": {"level": 400.0, "width": 1e-4}}
    run, fine = simulate(*args, effects=effects), simulate(*args, effects=effects, substeps=1000)
    np.testing.assert_allclose(run.states["v"], fine.states["v"], atol=1e-4 * 0.05)


def test_the_upper_limit_of_a_state_is_kept():
    _, u0 = WEB_WINDING.equilibrium()
    loop = Playback(("V1", "V2"), WEB_WINDING.dt)
    with pytest.raises(InputError, match=r"r2.*outside"):
        simulate(WEB_WINDING, loop, Scenario("s", {"V1": np.full(20, u0[0]), "V2": np.full(20, u0[1])}, start={"r2": 0.031}))


PEAKS = {"prbs1": (21, 3.5), "prbs2": (21, 3.5), "rbs": (20, 5), "sine": (48, 8), "rgs": (40, 10)}  # [1] section 1.4.2


@pytest.mark.parametrize("name", PEAKS)
def test_set_points_are_those_of_the_paper(name):
    sets = EXPERIMENTS["web-winding"][name].scenario(3).references
    speed, angle = sets["w3_set"] - 100, sets["theta_set"]
    assert (np.abs(speed).max(), np.abs(angle).max()) == pytest.approx(PEAKS[name])
    if name == "rbs":  # switching time 10 samples, probability 0.2
        moves = np.flatnonzero(np.diff(speed)) + 1
        assert np.gcd.reduce(moves) == 10
        many = [EXPERIMENTS["web-winding"]["rbs"].scenario(s).references["w3_set"] for s in range(40)]
        assert np.mean([np.count_nonzero(np.diff(x)) for x in many]) / 225 == pytest.approx(0.2, abs=0.02)
    if name == "sine":
        assert np.count_nonzero(np.abs(np.fft.rfft(speed)) > 0.1 * np.abs(np.fft.rfft(speed)).max()) == 20
    if name == "rgs":  # half the power below the cut-off of 1 Hz, hardly any above 2 Hz
        many = [EXPERIMENTS["web-winding"]["rgs"].scenario(s).references["w3_set"] - 100 for s in range(20)]
        power, f = np.mean([np.abs(np.fft.rfft(x)) ** 2 for x in many], axis=0), np.fft.rfftfreq(2250, 0.04)
        assert power[(f > 0.97) & (f < 1.03)].mean() / power[(f > 0) & (f < 0.3)].mean() == pytest.approx(0.5, abs=0.12)


def test_another_seed_is_another_experiment_and_two_experiments_share_no_noise():
    plans = EXPERIMENTS["web-winding"]
    for name in ("rbs", "sine", "rgs"):
        assert not np.array_equal(plans[name].scenario(1).references["w3_set"], plans[name].scenario(2).references["w3_set"])
    assert len({plans[name].scenario(s).seed for name in PEAKS for s in (1, 2)}) == 10


def test_the_two_loops_follow_one_sequence_half_a_period_apart():
    """[1] uses one 4095-step sequence: the dancer's set-point is the speed's, 2048 steps later, and not mirrored."""
    sets = EXPERIMENTS["web-winding"]["prbs1"].scenario(1).references
    whole = prbs(4095)
    np.testing.assert_array_equal((sets["w3_set"] - 100) / 21, np.repeat(whole, 5)[:2250])
    np.testing.assert_array_equal(sets["theta_set"] / 3.5, np.repeat(np.roll(whole, -2048), 5)[:2250])
