"""The traps in which a diagnosis of this kind has been caught before, one test (or two) for each."""

from dataclasses import replace

import numpy as np
import pytest

from tests.hidden import case
from tests.hidden.catalogue import Hidden
from tests.workbench.diagnosis.cases import AXIS, READING, ROBOT, axis_by_hand, axis_records, fitted, robot_records, screened
from tests.workbench.diagnosis.drive import DRIVE
from workbench.data import Dataset
from workbench.diagnosis import search
from workbench.diagnosis.answer import Finding
from workbench.diagnosis.diagnosis import diagnose
from workbench.diagnosis.fit import gauss_newton, term
from workbench.diagnosis.lags import timed
from workbench.diagnosis.policy import ALPHA, SWAP, WORTH
from workbench.diagnosis.predictor import Predictor, predictor
from workbench.diagnosis.recalibrate import recalibrated, unknowns
from workbench.diagnosis.refit import Model, from_special, refit, settled
from workbench.diagnosis.remainder import BUMPS, _scores, remainder, trajectory
from workbench.diagnosis.screen import Signature, Variant, scores, small_sizes
from workbench.diagnosis.search import _Race
from workbench.physics.controller import Playback
from workbench.simulation import Scenario, simulate

pytestmark = pytest.mark.slow


def refitted(model: Model, key: str) -> Model:
    """The model with one more effect as the diagnosis finds it: from its score, without a guess."""
    (score,) = screened(model, [key])
    return refit(model, score, small_sizes(model.predictor, model.fit))


LIGHT = replace(
    AXIS, parameters=tuple(replace(q, value=v, tolerance=0.0) for q, v in zip(AXIS.parameters, (2.0, 200.0), strict=True))
)  # twice as fast as a sample is long, and no parameter could mimic an error


def test_trap_1_an_integrator_that_is_too_coarse_is_not_discovered_as_physics(monkeypatch):
    data = axis_records(1, plant=LIGHT, samples=200)
    evidence = {}
    for name in ("chosen", "coarse"):
        made = predictor(LIGHT, data)
        if name == "coarse":
            monkeypatch.setattr(Predictor, "coarser", lambda own: own)
            made = replace(made, substeps=1).regained(made.point)
        done = recalibrated(made)
        model = Model(done.predictor, done.fit)
        found = [(s.p_family, s.statistic) for s in screened(model)] + [(x.p_family, x.statistic) for x in remainder(model)]
        evidence[name] = (min(p for p, _ in found), max(s for _, s in found))
    assert evidence["chosen"][0] > ALPHA
    assert evidence["coarse"][1] > 100.0 > evidence["chosen"][1]  # with one step a sample the trap is open


def test_trap_1_rivals_are_integrated_like_the_model_they_are_compared_with():
    model = fitted(axis_records(2, {"sensor-lag@q": {"time": 0.03}}))
    rival = settled(refitted(model, "sensor-lag@q"), small_sizes(model.predictor, model.fit))
    assert rival.predictor.substeps == model.predictor.substeps


def one_way(seed) -> Model:
    """A drive that never reverses, so that its dry friction is an offset of its voltage."""
    made = []
    for i in range(2):
        U = np.repeat(np.random.default_rng([seed, i]).uniform(2.0, 12.0, 31), 20)[:600]
        scenario = Scenario(f"drive {i}", {"U": U}, seed=10 * seed + i, start={"w": 40.0})
        effects = {"coulomb@shaft": {"level": 0.05, "width": 0.1}}
        made.append(simulate(DRIVE, Playback(("U",), DRIVE.dt), scenario, effects=effects, substeps=40).experiment)
    done = recalibrated(predictor(DRIVE, Dataset(tuple(made))))
    return Model(done.predictor, done.fit)


def test_trap_1_all_that_may_be_a_cause_is_integrated_as_the_finest_of_them_asks_for():
    """A friction asks for more steps than its look-alikes: what these made of too long ones told them apart."""
    for seed in range(3):
        model = one_way(seed)
        sizes = small_sizes(model.predictor, model.fit)
        finals = _Race(model, screened(model, ["coulomb@shaft", "offset@U", "dead-zone@U", "sensor-lag@n"]), sizes).finals()
        near = {s.key: m for m, s in finals if m.bic < finals[0][0].bic + SWAP}
        assert {"coulomb@shaft", "offset@U"} <= set(near)
        assert len({m.predictor.substeps for m in near.values()}) == 1
        assert near["offset@U"].predictor.substeps > model.predictor.substeps  # as few as the model were enough for it alone
        assert near["coulomb@shaft"].deviance == pytest.approx(near["offset@U"].deviance, abs=1.0)


def test_what_may_be_rounding_is_not_named_but_its_look_alikes_are_not_sure_for_that(monkeypatch):
    """The play of a sensor explains more than what else is late there: left out for its size, it stays their rival."""
    monkeypatch.setattr(search, "_is_rounding", lambda model, key: key == "backlash@v")
    for seed in (60, 61):
        model = fitted(robot_records(seed, {"backlash@v": {"half_width": 0.02}}))
        keys = ["backlash@v", "gear-backlash@u", "sensor-lag@v", "sensor-resonance@v", "input-delay@u"]
        base, steps = search.Search(keys, np.array([]), np.inf, str).path(model)
        assert steps
        assert "backlash@v" not in {s.key for s in steps}
        assert all(s.rivals["backlash@v"] < 0.0 for s in steps)
        swapped = search.kept(base, steps, search.Lesser(small_sizes(model.predictor, model.fit)), np.inf)
        assert "backlash@v" not in {s.key for s in swapped}
        assert all(s.rival and s.rival.key == "backlash@v" for s in swapped)


def test_a_cause_whose_fit_stands_off_its_optimum_does_not_lose_to_a_look_alike_that_is_fitted_anew():
    """A lag of less than a sample stood 500 of deviance off, and a resonance that is nearly a lag was sure: it began anew."""
    for seed in (71, 72):
        model = fitted(robot_records(seed, {"sensor-lag@v": {"time": 0.03}}))
        sizes = small_sizes(model.predictor, model.fit)
        keys = ["sensor-lag@v", "sensor-resonance@v", "input-delay@u"]
        base, steps = search.Search(keys, np.array([]), np.inf, str).path(model)
        assert [s.key for s in steps] == keys[:1]
        right = steps[0].after
        for share in (0.7, 0.8, 0.9, 0.95, 0.98):
            z = right.fit.z.copy()
            z[right.fit.unknowns.places[-1].start] *= share
            off = Model(right.predictor, gauss_newton(right.predictor, right.fit.unknowns, z, sizes, rounds=1, chords=0))
            if off.bic < 0.5 * (base.bic + right.bic):
                break
        assert right.bic + 50.0 < off.bic < base.bic - 50.0
        stuck = [replace(steps[0], after=off, rivals={"sensor-resonance@v": 5.0, "input-delay@u": 9.0})]
        (found,) = search.kept(base, stuck, search.Lesser(sizes), np.inf)
        assert found.key == "sensor-lag@v"
        assert found.after.bic < right.bic + 1.0
        assert found.after.fit.z[right.fit.unknowns.places[-1].start] == pytest.approx(0.03, rel=0.05)


def closed_loop(seed) -> Model:
    """A loop that differences its reading: every command repeats the noise of the sample it was computed from."""
    last = [0.0]

    def force(k, y):
        F = -4e3 * y - 1500.0 * (y - last[0]) / AXIS.dt
        last[0] = y
        return F

    return fitted(Dataset((axis_by_hand(force, seed),)))


def test_trap_2_what_the_controller_made_of_a_reading_does_not_explain_that_reading():
    """The command is computed from the reading: explained by it, a sensor errs in every closed loop."""
    for seed in range(4):
        model = closed_loop(400 + seed)
        assert min(x.p_family for x in remainder(model)) > 1e-3
        F = trajectory(model, 0)["F"]
        centres = np.linspace(*np.quantile(F, [0.01, 0.99]), BUMPS)
        basis = np.exp(-0.5 * ((F[:, None] - centres) / (centres[1] - centres[0])) ** 2)
        early = np.concatenate([basis[1:], basis[-1:]])  # the rule shifts it back: the same sample after all
        statistic = {}
        for name, own in (("past", basis), ("same", early)):
            b, S, _, _ = _scores(model, ("sensor", "q"), [[own]])
            statistic[name] = float(b @ np.linalg.pinv(S, rcond=1e-9) @ b)
        assert statistic["past"] < 25.0  # six degrees of freedom
        assert statistic["same"] > 100.0


def follower(seed, coloured, *, extra=None):
    """A loop that follows steps of its set-point by a reading whose noise lasts."""
    levels = 0.1 * np.random.default_rng([seed, 1]).standard_normal(31)
    return axis_by_hand(lambda k, y: 4e3 * (levels[k // 50] - y), seed, extra=extra, coloured=coloured, samples=1500)


@pytest.mark.parametrize("loud", [3.0, 10.0])
def test_trap_2_noise_that_lasts_is_not_explained_by_what_the_controller_made_of_it(loud):
    """What a sensor's noise was a sample ago is in the command: a filter of white noise called all such records UNKNOWN."""
    for seed in (800, 810):
        data = [Dataset(tuple(follower(s, loud * READING) for s in own)) for own in ((seed, seed + 1), (seed + 2,))]
        assert diagnose(AXIS, *data).finding is Finding.NOTHING


def test_trap_2_a_cause_is_found_beside_noise_that_lasts():
    def friction(q, v):
        return -30.0 * np.tanh(v / 1e-3)

    data = [Dataset(tuple(follower(s, 6.0 * READING, extra=friction) for s in own)) for own in ((830, 831), (832,))]
    found = diagnose(AXIS, *data)
    (cause,) = found.causes
    assert (found.finding, cause.key, cause.doubt) == (Finding.NAMED, "coulomb@slide", "")
    assert cause.parameters["level"].value == pytest.approx(30.0, rel=0.1)


def test_trap_3_the_model_without_the_effect_is_as_converged_as_the_one_with_it():
    for seed in range(6):
        model = fitted(axis_records(700 + seed, parameters={"M": 108.0, "Fv": 140.0}) if seed % 2 else robot_records(700 + seed))
        sizes = small_sizes(model.predictor, model.fit)
        again = gauss_newton(model.predictor, model.fit.unknowns, model.fit.z, sizes, rounds=4, enough=1e-3)
        assert model.fit.cost - again.cost < 0.2
        best = next(s for s in screened(model) if np.isnan(s.best.variant.finite))
        # a refit may gain what the score promises and what its shapes add, not more
        assert model.deviance - refit(model, best, sizes).deviance < best.statistic + 6.0


def test_trap_3_noise_levels_tuned_once_more_are_worth_less_than_a_cause():
    for seed in range(6):
        model = fitted(axis_records(720 + seed) if seed % 2 else robot_records(720 + seed))
        assert model.bic - settled(model, np.zeros(len(model.predictor.plant.slots))).bic < WORTH


@pytest.mark.parametrize(
    ("key", "name", "size"), [("sensor-lag@v", "time", 0.05), ("saturation@u", "limit", 1.5), ("input-delay@u", "time", 0.033)]
)
def test_trap_4_limits_lags_and_delays_are_found_from_the_error_they_leave_and_not_from_a_linear_step(key, name, size):
    model = fitted(robot_records(3, {key: {name: size}}))
    sizes = small_sizes(model.predictor, model.fit)
    found = timed(model, settled(refitted(model, key), sizes), key, sizes).model
    slot = found.terms[0].sizes[0]
    assert found.fit.point.eta[0, slot] == pytest.approx(size, rel=0.1)
    assert model.deviance - found.deviance > 100.0


@pytest.mark.parametrize(("seed", "time"), [(51035, 0.0882), (51057, 0.0958), (7, 0.12), (8, 0.07)])
def test_trap_4_no_start_at_the_truth_ends_lower_than_the_lag_that_is_said(seed, time):
    """The machine's own time constant and the lag may change places, and the right minimum is a hole in the profile's grid."""
    model = fitted(case.records(seed, "welding-robot", (Hidden("sensor-lag", "v", {"time": time}, 1.0),)))
    sizes = small_sizes(model.predictor, model.fit)
    found = timed(model, settled(refitted(model, "sensor-lag@v"), sizes), "sensor-lag@v", sizes).model
    own, true = found.fit.unknowns, case.setting_of(seed, "welding-robot").machine._asdict()
    start, at = found.fit.z.copy(), own.places[0].start
    start[: own.split[0]] = [np.log(true[q.name] / q.value) * np.sqrt(3.0) / q.tolerance for q in ROBOT.parameters]
    start[at] = time
    begun = settled(Model(found.predictor, gauss_newton(found.predictor, own, start, sizes, rounds=6)), sizes)
    assert begun.fit.z[at] == pytest.approx(time, rel=0.1)
    assert found.posterior < begun.posterior + 3.0
    assert found.farthest < 3.0


def test_trap_5_a_shape_between_the_values_of_its_grid_leaves_no_second_effect():
    model = fitted(robot_records(5, {"stribeck@rail": {"level": 0.3, "speed": 0.07}}))
    found = settled(refitted(model, "stribeck@rail"), small_sizes(model.predictor, model.fit))
    eta = {str(s): v for s, v in zip(ROBOT.slots, found.fit.point.eta[0], strict=True)}
    assert eta["stribeck@rail:speed"] == pytest.approx(0.07, rel=0.2)
    beside = [s for s in screened(found) if s.key != "stribeck@rail"]
    assert min(s.p_family for s in beside) > ALPHA


def test_trap_5_a_shape_far_from_where_its_fit_begins_is_found_all_the_same():
    """Friction whose width begins sixty times too wide: a fit that stops at the end of its range takes another law for better."""
    model = fitted(robot_records(5, {"coulomb@rail": {"level": 0.3, "width": 0.02}}))
    sizes, slot = small_sizes(model.predictor, model.fit), [str(s) for s in ROBOT.slots].index("coulomb@rail:width")

    def begun(width: float) -> Model:
        own = unknowns(model.predictor, (term(ROBOT, "coulomb@rail", (slot,)),))
        own = replace(own, base=np.where(np.arange(len(own.base)) == slot, width, own.base))
        z = np.concatenate([own.zero()[: own.places[0].start], [0.3, 0.0]])
        return settled(Model(model.predictor, gauss_newton(model.predictor, own, z, sizes, rounds=6)), sizes)

    near, far = begun(0.02), begun(1.2)
    assert far.fit.point.eta[0, slot] == pytest.approx(near.fit.point.eta[0, slot], rel=0.2)
    assert far.deviance < near.deviance + 3.0


def test_trap_6_the_noise_of_a_channel_comes_from_the_likelihood_and_not_from_differences():
    made = predictor(replace(AXIS, noise={}), axis_records(6, samples=900))  # nobody says how noisy the encoder is
    first = made.noise
    assert READING < first.measurement[0] < 2.0 * READING  # an estimate from above
    wrong = made.regained(made.point, replace(first, measurement=3.0 * first.measurement))  # as differences would give it
    for start in (made, wrong):
        assert recalibrated(start).predictor.noise.measurement[0] == pytest.approx(READING, rel=0.15)


@pytest.mark.parametrize("level", [0.1, 0.3, 1.0])
def test_trap_7_a_constant_is_not_taken_for_coloured_noise(level):
    found = diagnose(ROBOT, robot_records(7, {"rail-tilt@rail": {"level": level}}))
    assert "rail-tilt@rail" in {found.causes[0].key, *found.causes[0].ties}


def test_trap_8_records_share_an_amplitude_so_that_a_small_periodic_effect_pays_for_itself():
    turns = (0.0, 1.5, 3.0, -1.5, 0.7, 2.2)
    each = [{"imbalance@slide": {"cosine": 4.0 * np.cos(a), "sine": 4.0 * np.sin(a)}} for a in turns]
    model = fitted(axis_records(8, each, records=6, force=25.0))
    found = refitted(model, "imbalance@slide")
    gain, price = model.deviance - found.deviance, np.log(sum(len(r) for r in found.predictor.records))
    assert found.numbers == 2 + 5
    assert model.bic - found.bic == pytest.approx(gain - 7 * price)
    assert model.bic - found.bic > WORTH


def test_trap_9_a_tail_is_not_fitted_steeper_than_it_can_be_known():
    """One block dominates: every flip of signs gives the same statistic, and the draws have no spread at all."""
    variant = Variant("offset@F", (0,), (), np.nan, False)
    blocks = np.array([[1.5], *[[1e-6]] * 30])
    one = Signature(variant, blocks.sum(axis=0), np.eye(1), np.ones(1), blocks, np.zeros((1, 1)), np.full(1, -np.inf))
    assert scores([one])[0].p_family > ALPHA
    assert scores([one])[0].p_value > ALPHA


@pytest.mark.parametrize("seed", [21, 22])
def test_trap_8_a_general_law_begins_where_its_special_case_ended(seed):
    """From there it ends no worse than that one, which it includes at these numbers, and than from its own linear start."""
    made = {"coulomb@rail": {"level": 0.2}, "stribeck@rail": {"level": 0.1, "speed": 0.05}}
    model = fitted(robot_records(seed, made))
    sizes, scores = small_sizes(model.predictor, model.fit), {s.key: s for s in screened(model)}
    plain = settled(refitted(model, "coulomb@rail"), sizes)
    assert from_special(plain, model, scores["asymmetric-friction@rail"], sizes).deviance < plain.deviance + 1.0
    fading = from_special(plain, model, scores["stribeck@rail"], sizes)
    assert fading.deviance < refitted(model, "stribeck@rail").deviance + 1.0
