import json

import numpy as np
import pytest

from plants import POSITIONING_AXIS, WEB_WINDING, WELDING_ROBOT
from studies.cli import main
from studies.experiments import CURVES, EXPERIMENTS, plan
from workbench.errors import InputError
from workbench.excitation import prbs
from workbench.physics.controller import Playback
from workbench.readers import read_file
from workbench.simulation import Scenario, simulate, simulate_batch


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


# ---- the welding robot ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EXPERIMENTS["welding-robot"])
def test_robot_experiments_move_force_and_arm_apart(name):
    for seed in (1, 2, 3):
        signals = plan("welding-robot", name).scenario(seed).references
        u, arm = signals["u"], signals["arm"]
        assert 1.0 <= np.abs(u).max() <= 4.0
        assert 0.5 <= np.abs(arm).max() <= np.pi / 2
        assert arm.std() > 0.2
        assert np.abs(np.diff(arm)).max() / WELDING_ROBOT.dt < 4.0  # rad/s: an arm swings, it does not jump
        assert abs(np.corrcoef(u, arm)[0, 1]) < 0.5


def test_robot_held_out_records_come_from_other_seeds():
    plans = EXPERIMENTS["welding-robot"]
    for name, seeded in (("prbs", ("arm",)), ("rbs", ("u", "arm")), ("multisine", ("u", "arm"))):
        one, again, other = (plans[name].scenario(seed).references for seed in (1, 1, 2))
        for channel in seeded:
            assert np.array_equal(one[channel], again[channel])
            assert np.corrcoef(one[channel], other[channel])[0, 1] < 0.6
    arms = [plans[name].scenario(1).references["arm"] for name in ("prbs", "rbs", "multisine")]
    assert np.abs(np.corrcoef(arms) - np.eye(3)).max() < 0.6
    assert len({plan.scenario(s).seed for plan in plans.values() for s in (1, 2)}) == 2 * len(plans)


def test_the_four_curves_share_their_input_and_differ_by_one_perturbation_each():
    """[2] Fig. 4: curve 2 without perturbations, curves 1, 3 and 4 with; each of ours moves the response by 10 to 40 %."""
    plans = {name: plan("welding-robot", name) for name in ("curve1", "curve2", "curve3", "curve4")}
    inputs = [np.column_stack(list(p.scenario(seed).references.values())) for p in plans.values() for seed in (0, 5)]
    assert all(np.array_equal(i, inputs[0]) for i in inputs)
    assert [sorted(p.effects) for p in plans.values()] == [["coulomb@rail"], [], ["arm-gravity@rail"], ["platform-mass@rail"]]
    v = {
        name: simulate(WELDING_ROBOT, p.controller, p.scenario(0), effects=p.effects).experiment["v"] for name, p in plans.items()
    }
    size = np.sqrt(np.mean(v["curve2"] ** 2))
    apart = {name: np.sqrt(np.mean((y - v["curve2"]) ** 2)) / size for name, y in v.items()}
    assert apart["curve1"] == pytest.approx(0.21, abs=0.02)
    assert apart["curve3"] == pytest.approx(0.26, abs=0.03)
    assert apart["curve4"] == pytest.approx(0.23, abs=0.02)


def test_effects_of_a_plan_come_first_and_the_users_own_count():
    curve = plan("welding-robot", "curve4")
    assert curve.effects_with({}) == CURVES["curve4"]
    own = {"platform-mass@rail": {"change": 0.2}, "coulomb@rail": {"level": 0.1}}
    assert curve.effects_with(own) == {"platform-mass@rail": {"change": 0.2, "swing": 0.4}, "coulomb@rail": {"level": 0.1}}
    assert CURVES["curve4"] == {"platform-mass@rail": {"change": 1.0, "swing": 0.4}}  # untouched


def test_the_command_line_applies_and_records_the_effects_of_an_experiment(tmp_path):
    words = ["simulate", "welding-robot", "--noise-free", "--experiment", "curve2", "curve3"]
    assert main([*words, "--out", str(tmp_path / "a")]) == 0
    assert main([*words, "--effect", "arm-gravity@rail:sine=0,cosine=0", "--out", str(tmp_path / "b")]) == 0
    plain, pulled, off = (read_file(tmp_path / path)["v"] for path in ("a/curve2.csv", "a/curve3.csv", "b/curve3.csv"))
    assert np.abs(plain - pulled).max() > 0.2
    assert np.array_equal(off, plain)  # the user switched it off
    written = json.loads((tmp_path / "a" / "simulate.json").read_text())
    assert [run["effects"] for run in written["runs"]] == [{}, CURVES["curve3"]]
    assert written["provenance"]["configuration"]["effects_of_experiments"] == {"curve2": {}, "curve3": CURVES["curve3"]}
    assert written["provenance"]["configuration"]["effects"] == {}
    written = json.loads((tmp_path / "b" / "simulate.json").read_text())
    assert written["runs"][1]["effects"] == {"arm-gravity@rail": {"sine": 0.0, "cosine": 0.0}}


def test_a_robot_record_reads_back_with_its_roles_and_replays_to_itself(tmp_path):
    assert main(["simulate", "welding-robot", "--experiment", "curve3", "--noise-free", "--out", str(tmp_path / "a")]) == 0
    record = read_file(tmp_path / "a" / "curve3.csv")
    assert (record.names_of("input"), record.names_of("output"), record.names_of("schedule")) == (("u",), ("v",), ("arm",))
    effect = "arm-gravity@rail:sine=0.4,cosine=0.1"
    words = ["simulate", "welding-robot", "--inputs-from", str(tmp_path / "a" / "curve3.csv"), "--effect", effect]
    assert main([*words, "--out", str(tmp_path / "b")]) == 0
    np.testing.assert_array_equal(read_file(tmp_path / "b" / "curve3.csv").values, record.values)
