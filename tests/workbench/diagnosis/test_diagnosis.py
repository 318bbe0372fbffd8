"""Whole diagnoses: effects that the simulation itself switched on are named with their size, nothing where nothing is missing."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from plants import WEB_WINDING
from studies.experiments import EXPERIMENTS
from studies.jobs.recorded import Recorded
from tests.workbench.diagnosis.cases import AXIS, ROBOT, axis_records, fitted, refitted, robot_records
from workbench.data import Channel, Dataset
from workbench.diagnosis import causes, findings, policy, rivals, search, sizes
from workbench.diagnosis.answer import Finding
from workbench.diagnosis.diagnosis import diagnose
from workbench.diagnosis.equations import Law
from workbench.diagnosis.referee import Change
from workbench.diagnosis.screen import Score
from workbench.physics.controller import Playback
from workbench.simulation import Scenario, simulate

AXIS_CASES = [
    ("coulomb@slide", "level", 30.0),
    ("offset@F", "level", 15.0),
    ("input-delay@F", "time", 0.008),
    ("sensor-lag@q", "time", 0.03),
    ("sensor-lag@q", "time", 0.1),  # next to nothing of it is left in the errors of a filter
    ("sensor-lag@q", "time", 0.2),
    ("dead-zone@F", "half_width", 30.0),
    ("saturation@F", "limit", 350.0),
]
ROBOT_CASES = {
    "coulomb@rail": ("level", 0.3),
    "stribeck@rail": ("level", 0.5),
    "quadratic-friction@rail": ("coefficient", 0.2),
    "saturation@u": ("limit", 2.5),
}


def check(found, key: str, name: str, size: float):
    assert found.finding is Finding.NAMED
    (cause,) = found.causes
    assert cause.key == key
    assert all(e.low <= e.value <= e.high for e in cause.parameters.values())
    estimate = cause.parameters[name]
    assert estimate.value == pytest.approx(size, rel=0.1)
    # four standard deviations: a 95 % interval misses one truth in twenty, and here are many
    assert abs(estimate.value - size) < 2.0 * (estimate.high - estimate.low) / 2.0
    assert cause.evidence.delta_bic > 50.0
    assert found.effects[key][name] == pytest.approx(estimate.value)
    one_step = [g for g in cause.gains if g.horizon == "one-step"]
    assert all(g.after < g.before for g in one_step)


@pytest.mark.slow
@pytest.mark.parametrize(("key", "name", "size"), AXIS_CASES)
def test_what_the_axis_lacks_is_named_with_its_size_and_its_gain_on_other_records(key, name, size):
    made = [axis_records(seed, {key: {name: size}}, parameters={"M": 100.0, "Fv": 180.0}) for seed in (3, 4)]
    check(diagnose(AXIS, *made), key, name, size)


@pytest.mark.slow
def test_a_small_dry_friction_is_not_taken_for_a_law_that_includes_it():
    """The screen lets in the friction that differs by direction, and not quite the plain one; a fit tries both."""
    records = Recorded("welding-robot", ("prbs", "rbs")).records(
        2330041505, {"dt": 0.0, "noise": 1.0, "records": 0.0}, effects={"coulomb@rail": {"level": 0.0022}}
    )
    (cause,) = diagnose(ROBOT, records).causes
    assert cause.key == "coulomb@rail"
    assert cause.parameters["level"].low < 0.0022 < cause.parameters["level"].high
    assert cause.evidence.p_value < policy.ALPHA


def test_a_shortlist_is_joined_by_special_cases_with_the_significance_that_brings_them_in_and_by_general_laws_with_their_own():
    def score(key, p):
        return Score(key, None, (), 10.0, p, p)

    found = [score("asymmetric-friction@rail", 0.002), score("stribeck@rail", 0.004), score("coulomb@rail", 0.02)]
    found += [score("offset@u", 0.03), score("friction-jump@rail", 0.5)]
    short = search._with_family(ROBOT, found[:2], found)
    assert [(s.key, s.p_family) for s in short[2:]] == [("coulomb@rail", 0.002), ("friction-jump@rail", 0.5)]
    assert search._with_family(ROBOT, found[:3], found) == [*found[:3], found[4]]
    assert search._with_family(ROBOT, found[3:4], found) == found[3:4]
    here, there = [score("asymmetric-friction@unwind", 0.001)], [score("coulomb@rewind", 0.02)]
    assert search._with_family(WEB_WINDING, here, there) == here


@pytest.mark.slow
@pytest.mark.parametrize(("backward", "named"), [(30.0, "coulomb"), (34.0, "asymmetric-friction")])
def test_a_law_with_one_number_more_is_no_rival_unless_the_records_ask_for_that_number(backward, named):
    """The same in both directions is dry friction; a friction that differs a little includes it and is another cause."""
    effects = {"asymmetric-friction@slide": {"forward": 30.0, "backward": backward}}
    found = diagnose(AXIS, axis_records(3, effects, parameters={"M": 100.0, "Fv": 180.0}))
    (cause,) = found.causes
    assert cause.effect == named
    assert {"coulomb@slide", "asymmetric-friction@slide"}.isdisjoint(cause.ties)


def forward(seed, effects, *, stops: float) -> Dataset:
    """Records of the robot that never moves back; stops: share of the time at which it stands."""
    made = []
    for i in range(2):
        t, random = ROBOT.dt * np.arange(500), np.random.default_rng(77 * seed + i)
        levels = np.where(random.random(21) < stops, 0.2, random.uniform(0.5 if stops else 2.0, 4.0, 21))
        course = {"u": np.repeat(levels, 25)[:500], "arm": 1.2 * np.sin(0.7 * t + i)}
        scenario = Scenario(f"robot {i}", course, seed=2000 * seed + i)
        made.append(simulate(ROBOT, Playback(("u", "arm"), ROBOT.dt), scenario, effects=effects).experiment)
    return Dataset(tuple(made))


@pytest.mark.slow
def test_a_direction_in_which_nothing_moved_keeps_the_law_that_tells_it_apart_as_a_rival():
    (cause,) = diagnose(ROBOT, forward(4, {"asymmetric-friction@rail": {"forward": 0.6, "backward": 0.2}}, stops=0.4)).causes
    assert {"coulomb@rail", "asymmetric-friction@rail"} <= {cause.key, *cause.ties}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_numbers_that_nothing_excited_are_no_evidence_against_the_law_that_has_them(seed):
    """Always forward a friction, whatever it is at rest or backwards, is a force less: not a hair tells the three apart."""
    (cause,) = diagnose(ROBOT, forward(seed, {"asymmetric-friction@rail": {"forward": 0.6}}, stops=0.0)).causes
    assert {cause.key, *cause.ties} >= {"offset@u", "coulomb@rail", "asymmetric-friction@rail"}


@pytest.mark.slow
def test_a_cause_that_holds_everywhere_is_named_beside_one_that_holds_in_a_single_record():
    everywhere = {"offset@F": {"level": 20.0}}
    each = [everywhere, everywhere, everywhere | {"coulomb@slide": {"level": 40.0}}]
    found = diagnose(AXIS, axis_records(3, each))
    assert found.finding is Finding.INCOMPLETE
    (cause,) = found.causes
    assert cause.key == "offset@F"
    assert cause.parameters["level"].value == pytest.approx(20.0, rel=0.05)
    assert any("axis 2 only" in note for note in found.notes)


@pytest.mark.slow
def test_a_rounded_channel_does_not_hide_that_one_record_is_odd():
    made = axis_records(3, [{}, {}, {"coulomb@slide": {"level": 120.0}}], parameters={"M": 100.0, "Fv": 180.0})
    rounded = [replace(e, values=np.column_stack([e["F"], 1e-3 * np.round(e["q"] / 1e-3)])) for e in made]
    found = diagnose(AXIS, Dataset(tuple(rounded)))
    assert found.finding is Finding.UNKNOWN
    assert [c.effect for c in found.causes] == ["quantisation"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4])
def test_of_friction_and_a_tilt_each_is_found_and_the_tilt_ties_with_the_offset_that_it_cannot_be_told_from(seed, monkeypatch):
    """Friction that differs by direction comes first, for it is both in one, and must give way."""
    greedy, path = [], search.Search.path
    monkeypatch.setattr(search.Search, "path", lambda search, base: greedy.append(path(search, base)) or greedy[-1])
    found = diagnose(ROBOT, robot_records(seed, {"coulomb@rail": {"level": 0.3}, "rail-tilt@rail": {"level": 0.3}}))
    assert greedy[0][1][0].key == "asymmetric-friction@rail"
    named = {c.key: c for c in found.causes}
    assert named["coulomb@rail"].parameters["level"].value == pytest.approx(0.3, rel=0.05)
    (other,) = (c for c in found.causes if c.effect != "coulomb")
    assert {"rail-tilt@rail", "offset@u"} <= {other.key, *other.ties}


@pytest.mark.slow
@pytest.mark.parametrize(("key", "size"), [("coulomb@slide", {"level": 30.0}), ("sensor-lag@q", {"time": 0.03})])
def test_what_one_record_shows_and_another_does_not_is_no_cause_but_it_is_said(key, size):
    made = [axis_records(seed, effects, parameters={"M": 100.0, "Fv": 180.0}) for seed, effects in ((3, {}), (9, {key: size}))]
    days = zip(("monday", "monday again", "tuesday"), (*made[0], made[1].experiments[0]), strict=True)
    found = diagnose(AXIS, Dataset(tuple(replace(e, name=name) for name, e in days)))
    assert found.finding is Finding.UNKNOWN
    assert not found.causes
    assert any("tuesday" in note and "monday" not in note for note in found.notes)


@pytest.mark.slow
@pytest.mark.parametrize("key", ROBOT_CASES)
def test_what_the_robot_lacks_is_named_with_its_size_and_its_gain_on_other_records(key):
    name, size = ROBOT_CASES[key]
    effects = {key: {name: size}}
    check(diagnose(ROBOT, robot_records(3, effects), robot_records(4, effects)), key, name, size)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 5, 7])
def test_a_dead_time_of_one_sample_is_named_alone(seed):
    """What was commanded before the record began is still under way at its first sample and must not be explained."""
    effects = {"input-delay@u": {"time": 0.02}}
    check(diagnose(ROBOT, robot_records(seed, effects), robot_records(seed + 1, effects)), "input-delay@u", "time", 0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "period"), [(3, 4.0), (5, 4.0), (5, 9.0)])
def test_a_mass_that_swings_is_named_whatever_its_period(seed, period):
    effects = {"platform-mass@rail": {"swing": 0.3, "period": period}}
    check(diagnose(ROBOT, robot_records(seed, effects), robot_records(seed + 1, effects)), "platform-mass@rail", "period", period)


@pytest.mark.slow
@pytest.mark.parametrize("period", [5.7, 7.34, 14.3])
def test_a_small_swing_is_named_though_its_period_is_no_round_number(period):
    """Half a minute tells periods apart that are nearer to each other than those of a coarse list."""
    effects = {"platform-mass@rail": {"swing": 0.03, "period": period}}
    records = robot_records(3, effects, samples=1800), robot_records(4, effects, samples=1800)
    (cause,) = diagnose(ROBOT, *records).causes
    assert cause.key == "platform-mass@rail"
    assert cause.parameters["period"].value == pytest.approx(period, rel=0.03)


@pytest.mark.slow
def test_a_cause_that_held_out_records_do_not_confirm_is_not_named():
    """The machine was mended before the held-out records: whatever the others show, it is not there."""
    friction = {"coulomb@slide": {"level": 60.0}}
    found = diagnose(AXIS, axis_records(3, friction), axis_records(4))
    assert found.finding is Finding.UNKNOWN
    assert not found.causes
    assert any(note.startswith("coulomb@slide would explain these records") for note in found.notes)
    assert not found.effects
    lag = {"sensor-lag@q": {"time": 0.03}}
    half = diagnose(AXIS, axis_records(3, friction | lag), axis_records(4, lag))
    assert half.finding is Finding.INCOMPLETE
    (cause,) = half.causes
    assert "sensor-lag@q" in {cause.key, *cause.ties}
    assert (
        diagnose(AXIS, axis_records(3, friction)).finding is Finding.NAMED
    )  # without held-out records nothing speaks against it


@pytest.mark.slow
@pytest.mark.parametrize(("tolerance", "finding"), [(0.05, Finding.INCOMPLETE), (0.5, Finding.NAMED)])
def test_a_cause_is_not_sure_where_parameters_have_left_their_data_sheet(tolerance, finding):
    """A mass 40 % above a data sheet that leaves 5 % open: either that is wrong or something else is missing."""
    known = replace(AXIS, parameters=tuple(replace(q, tolerance=tolerance) for q in AXIS.parameters))
    made = [axis_records(seed, {"coulomb@slide": {"level": 60.0}}, parameters={"M": 133.0}) for seed in (3, 4)]
    found = diagnose(known, *made)
    assert found.finding is finding
    (cause,) = found.causes
    assert cause.key == "coulomb@slide"
    assert bool(found.signs) is bool(cause.doubt) is (finding is Finding.INCOMPLETE)


@pytest.mark.parametrize(
    ("stable", "beyond", "worse", "harm", "left", "without_size", "said"),
    [
        (0.5, False, False, "", {}, {}, ""),
        (1e-5, False, False, "", {}, {}, "size"),
        (0.5, True, False, "", {}, {}, "data sheet"),
        (0.5, False, True, "", {}, {}, "plant that came"),
        (0.5, False, False, "h one-second: 1 before, 2 after [m]", {}, {}, "raises an error"),
        (0.5, False, False, "", {"F": 39.0}, {}, ""),
        (0.5, False, False, "", {"F": 56.0}, {}, "14 % of what it explains"),
        (0.5, False, False, "", {"F": 39.0, "v": 19.0}, {}, ""),
        (0.5, False, False, "", {"F": 39.0, "v": 24.0}, {}, "another form: what is left over v is 6 % of what it explains"),
        (0.5, False, False, "", {}, {"backlash@q": 39.0}, ""),
        (
            0.5,
            False,
            False,
            "",
            {},
            {"offset@F": 5.0, "backlash@q": 56.0},
            "backlash@q shows beside it, though not with one size: 14 %",
        ),
    ],
)
def test_what_speaks_against_a_cause_of_an_incomplete_answer_is_said(stable, beyond, worse, harm, left, without_size, said):
    left = [SimpleNamespace(variable=name, statistic=value, p_family=1e-6) for name, value in left.items()]
    doubt = causes.doubt_about(SimpleNamespace(stable=stable, gain=400.0), beyond, worse, harm, left, without_size, "v")
    assert said in doubt
    assert bool(doubt) is bool(said)


def test_what_was_found_beside_a_cause_that_is_not_sure_is_none_the_more_sure():
    """A tank whose bottom is blunt: a sensor's curvature that may as well be the equation's, and an offset of the pump on top."""
    names = ("first@x", "small@x", "doubted@x", "later@x")
    steps = [SimpleNamespace(key=key, gain=gain) for key, gain in zip(names, (900.0, 40.0, 700.0, 800.0), strict=True)]
    doubts = causes.doubts_of(steps, dict.fromkeys(names, "") | {"doubted@x": "it raises an error"})
    beside = "it was found beside doubted@x, which is not sure"
    assert doubts == {"first@x": "", "small@x": beside, "doubted@x": "it raises an error", "later@x": beside}


@pytest.mark.parametrize(("gap", "said"), [(-11.0, "explains these records better"), (-9.0, "do not tell the two apart")])
def test_a_law_that_explains_more_or_as_much_speaks_against_a_cause(gap, said):
    assert causes.said_against(Law("h", "u", gap)).endswith(said)


@pytest.mark.parametrize(
    ("tolerance", "off", "open_"),
    [(0.5, -0.54, True), (0.9, -0.85, True), (0.5, -0.65, False), (0.9, -0.95, False), (0.05, -0.04, True),
     (0.05, -0.1, False), (0.1, 0.14, True), (0.1, 0.2, False), (1.0, -0.98, True), (2.0, -0.999, False)],
)  # fmt: skip
def test_a_parameter_is_beyond_where_its_share_of_nominal_is_far_outside_its_tolerance(tolerance, off, open_):
    assert sizes._left_open(tolerance, float(np.log1p(off))) is open_


@pytest.mark.parametrize(("gains", "only"), [((180.0, 190.0), True), ((180.0, 120.0), False), ((190.0,), False)])
def test_causes_that_explain_next_to_nothing_one_by_one_are_not_sure(gains, only):
    """Of 200 that two explain, what is left without either says what the other explains alone."""
    steps = [
        SimpleNamespace(key=f"{i}@x", gain=gain, stable=0.5, after=SimpleNamespace(bic=800.0)) for i, gain in enumerate(gains)
    ]
    assert causes.only_together(SimpleNamespace(bic=1000.0), steps) is only


@pytest.mark.parametrize(
    ("after", "sure", "harms"), [(1.09, True, False), (1.12, True, True), (1.5, False, False), (0.5, True, False)]
)
def test_a_cause_that_raises_an_error_for_sure_is_told(after, sure, harms):
    found = (Change("v", "one-second", "m/s", 1.0, after, sure), Change("v", "one-step", "m/s", 1.0, 0.9, True))
    said = causes.harm_of(SimpleNamespace(between=lambda before, after: found), SimpleNamespace(before=None, after=None))
    assert bool(said) is harms
    assert not harms or said.startswith("v one-second: 1 before")


@pytest.mark.parametrize(
    ("statistic", "p", "stable", "finding"),
    [
        (49.0, 1e-9, 0.5, Finding.NAMED),  # a law is an ideal, and 5 % of what it explains may be its form
        (51.0, 1e-9, 0.5, Finding.INCOMPLETE),
        (51.0, 1e-3, 0.5, Finding.NAMED),  # not sure beside a cause
        (51.0, 1e-9, 1e-5, Finding.INCOMPLETE),
        (10.0, 1e-9, 1e-5, Finding.INCOMPLETE),
        (600.0, 1e-9, 1e-5, Finding.UNKNOWN),
    ],
)
def test_what_is_left_beside_a_cause_counts_by_its_share_of_what_the_cause_explains(statistic, p, stable, finding):
    left = [SimpleNamespace(p_family=p, statistic=statistic)]
    model = SimpleNamespace(predictor=SimpleNamespace(samples=1000))
    assert findings._finding([SimpleNamespace(gain=1000.0, stable=stable)], left, model) is finding


@pytest.mark.parametrize(("gain", "finding"), [(30.0, Finding.NAMED), (60.0, Finding.INCOMPLETE)])
def test_an_odd_record_counts_by_its_share_of_what_the_causes_explain(gain, finding):
    model = SimpleNamespace(predictor=SimpleNamespace(samples=1000))
    step = SimpleNamespace(gain=1000.0, stable=0.5, after=model)
    local = search.Local("sensor-gain@y", gain, ("binary 2",))
    found = findings.Found(model, (step,), (SimpleNamespace(p_family=1.0, statistic=0.1),), (), None, np.inf, local)
    assert found.finding is finding


@pytest.mark.parametrize(
    ("gain", "why", "named", "finding"),
    [
        (30.0, findings.NONE, True, Finding.NAMED),
        (60.0, findings.NONE, True, Finding.INCOMPLETE),
        (60.0, findings.TRIFLE, True, Finding.NAMED),
        (60.0, findings.NONE, False, Finding.UNKNOWN),
        (60.0, findings.TRIFLE, False, Finding.UNKNOWN),  # what is the only one is never asked for a share
    ],
)
def test_what_the_referee_refuses_takes_nothing_from_a_name_where_it_does_not_matter(gain, why, named, finding):
    model = SimpleNamespace(predictor=SimpleNamespace(samples=1000))
    steps = (SimpleNamespace(gain=1000.0, stable=0.5, after=model),) if named else ()
    left = (SimpleNamespace(p_family=1.0, statistic=0.1),)
    refused = (findings.Refused("sensor-resonance@y", why, gain),)
    assert findings.Found(model, steps, left, (), None, np.inf, refused=refused).finding is finding


@pytest.mark.parametrize(("statistic", "p", "told"), [(40.0, 1e-6, True), (40.0, 1e-3, False), (0.3, 1e-6, False)])
def test_what_shows_clearly_but_has_no_size_stands_beside_what_is_named(statistic, p, told):
    shown = [Score("backlash@y", None, (), statistic, p, p), Score("offset@u", None, (), 5.0, 0.5, 0.5)]
    found = search._unresolved(shown, SimpleNamespace(predictor=SimpleNamespace(samples=1000)))
    assert (found is not None) is told
    assert not told or (found.key, found.statistic) == ("backlash@y", statistic)


def test_what_ties_with_a_cause_is_looked_at_again_where_what_stood_beside_it_was_dropped(monkeypatch):
    """And what was dropped is the first that the others are compared with."""
    looked = []
    steps = [search.Step(key, None, None, None, {"d": np.inf}, 0.0, 1.0) for key in "abc"]
    monkeypatch.setattr(search, "_swapped", lambda found, *_: looked.append({s.key: s.rivals for s in found}) or found)
    monkeypatch.setattr(search, "pruned", lambda base, found, _: found[: max(len(found) - 1, 1)])
    (kept,) = search.kept(None, steps, None, np.inf)
    assert kept.key == "a"
    assert [list(found) for found in looked] == [["a", "b", "c"], ["a", "b"], ["a"]]
    assert looked[-1]["a"] == {"d": np.inf, "c": 0.0, "b": 0.0}


@pytest.mark.parametrize(("freed", "again"), [(300.0, True), (1000.0, False)])
def test_a_cause_chosen_by_a_fit_that_was_stuck_is_compared_with_its_rivals_again(monkeypatch, freed, again):
    """freed: BIC of the model with the first cause alone, once a second one has led it out of where it was."""

    def model(bic, *keys):
        return SimpleNamespace(predictor=SimpleNamespace(plant=AXIS), bic=bic, deviance=bic, keys=keys, sound=True)

    less, led = {"first": model(2000.0), "second": model(freed, "first")}, model(297.0 if again else 999.0, "first", "second")
    steps = {(): search.Step("first", None, model(500.0, "first"), None, {}, 0.0, 1.0)}
    steps[("first",)] = replace(steps[()], key="second", after=led)
    monkeypatch.setattr(search.Search, "screened", lambda self, m: [Score("any", None, (), 9.0, 0.0, 0.0)])
    monkeypatch.setattr(search, "_step", lambda m, *_: steps.pop(m.keys, None))
    monkeypatch.setattr(search, "_unresolved", lambda *_: None)
    monkeypatch.setattr(search.Lesser, "of", lambda self, m, key: less[key])
    monkeypatch.setattr(findings, "remainder", lambda m: [])
    compared = []
    monkeypatch.setattr(findings, "kept", lambda base, found, *_: compared.append(found[-1].after.bic) or found)
    found = findings.searched(model(2000.0), np.inf, lambda _: None)
    assert [s.key for s in found.steps] == ["first"]
    assert compared == ([freed] if again else [])


def test_a_model_freed_of_an_effect_is_no_worse_than_one_without_it_that_was_met_before():
    """Freed of the effect it may be lost, and whatever it is compared with would look like a gain."""
    model = fitted(robot_records(3, {"coulomb@rail": {"level": 0.3}}))
    after = refitted(model, "coulomb@rail", [0.3])
    lesser = search.Lesser(np.zeros(len(ROBOT.slots)))
    lesser.met.append(model)
    assert lesser.of(after, "coulomb@rail").deviance <= model.deviance
    assert lesser.of(after, "coulomb@rail") is lesser.of(after, "coulomb@rail")
    worse = search.Lesser(np.zeros(len(ROBOT.slots)))
    worse.met.append(after)  # holds the effect itself
    assert worse.of(after, "coulomb@rail").deviance > after.deviance + 100.0


def test_a_share_of_the_gain_is_a_tie_between_forms_of_one_friction_only():
    """Laws of friction are idealised; a lag is a lag, and more data must be able to tell it from another."""
    tie = rivals.reach
    assert tie(ROBOT, "stribeck@rail", "quadratic-friction@rail", 1000.0) == 100.0
    assert tie(ROBOT, "stribeck@rail", "quadratic-friction@rail", 50.0) == policy.TIE
    assert tie(ROBOT, "sensor-lag@v", "sensor-resonance@v", 1000.0) == policy.TIE
    assert tie(ROBOT, "coulomb@rail", "saturation@u", 1000.0) == policy.TIE
    assert tie(ROBOT, "coulomb@rail", "asymmetric-friction@rail", 1000.0) == policy.TIE  # the one is a case of the other


@pytest.mark.slow
def test_a_periodic_effect_is_named_with_its_amplitude_and_order():
    each = [{"torque-ripple@slide": {"cosine": 10.0 * np.cos(a), "sine": 10.0 * np.sin(a), "order": 5.0}} for a in (0.0, 2.0)]
    (cause,) = diagnose(AXIS, axis_records(3, each, force=25.0)).causes
    assert cause.key == "torque-ripple@slide"
    assert cause.parameters["amplitude"].value == pytest.approx(10.0, rel=0.15)
    assert cause.parameters["order"].value == 5.0


@pytest.mark.slow
def test_what_cannot_be_told_apart_is_said_to_tie():
    (cause,) = diagnose(ROBOT, robot_records(3, {"rail-tilt@rail": {"level": 0.3}})).causes
    assert {cause.key, *cause.ties} >= {"rail-tilt@rail", "offset@u"}
    assert cause.evidence.posterior < 0.7
    assert cause.evidence.posterior + sum(cause.ties.values()) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("measured", "computed"),
    [
        (lambda x, p: x.v, False),
        (lambda x, p: 30.0 / np.pi * x.v - 2.0, False),  # in another unit
        (lambda x, p: p.M * x.v, True),
        (lambda x, p: x.v + x.q, True),
        (lambda x, p: x.v**2, True),
    ],
)
def test_a_static_error_of_a_sensor_is_said_to_be_that_of_its_equation_where_the_output_is_computed(measured, computed):
    plant = replace(AXIS, outputs=(Channel("y", "", "output"),), measure=lambda x, p: {"y": measured(x, p)}, noise={})
    assert plant.computed == ({"y"} if computed else set())
    said = {slot.effect.id: causes.sentence(plant, slot) for slot in plant.slots if slot.place == "y"}
    for effect in ("sensor-gain", "sensor-bias", "sensor-nonlinearity"):
        assert ("equation of y" in said[effect]) is computed
    assert "equation" not in said["sensor-lag"] + said["backlash"]


@pytest.mark.slow
def test_of_two_effects_both_have_their_size():
    """Beside a command that is clipped and not yet named, a late sensor looks like a late command and some play."""
    effects = {"saturation@F": {"limit": 350.0}, "sensor-lag@q": {"time": 0.03}}
    found = diagnose(AXIS, axis_records(3, effects))
    assert found.finding is Finding.NAMED
    assert {cause.key for cause in found.causes} == set(effects)
    for cause in found.causes:
        ((name, size),) = effects[cause.key].items()
        estimate = cause.parameters[name]
        assert estimate.value == pytest.approx(size, rel=0.05)
        assert abs(estimate.value - size) < estimate.high - estimate.low  # four standard deviations
        assert found.effects[cause.key][name] == pytest.approx(estimate.value)
        assert cause.ties == {}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_nothing_is_named_where_nothing_is_missing_but_parameters_are_off(seed):
    spread = np.random.default_rng(seed).uniform(0.85, 1.15, 2)
    plant, data = (
        (AXIS, axis_records(600 + seed, parameters={"M": 95.0 * spread[0], "Fv": 200.0 * spread[1]}))
        if seed % 2
        else (ROBOT, robot_records(600 + seed, parameters={"m1": spread[0], "c": 4.0 * spread[1]}))
    )
    found = diagnose(plant, data)
    assert found.finding is Finding.NOTHING
    assert found.causes == ()
    assert found.effects == {}
    limits = {d.effect: d.value for d in found.limits}
    assert 0.0 < limits["coulomb"] < (30.0 if plant is AXIS else 0.3)  # and it says what would have been seen


@pytest.mark.slow
def test_an_effect_that_nothing_excites_is_said_to_be_untestable():
    moved, still = (diagnose(ROBOT, robot_records(1, samples=300, swing=swing)) for swing in (1.2, 0.0))
    assert "arm-reaction" in {u.effect for u in still.untestable} - {u.effect for u in moved.untestable}
    assert "arm-reaction" in {d.effect for d in moved.limits} - {d.effect for d in still.limits}


@pytest.mark.slow
def test_the_winder_names_a_dry_friction_on_its_unwinder():
    effects = {"coulomb@unwind": {"level": 0.004}}
    plan = EXPERIMENTS["web-winding"]["staircase"]
    run = simulate(WEB_WINDING, plan.controller, plan.scenario(3), effects=effects)
    found = diagnose(WEB_WINDING, Dataset((run.experiment,)))
    assert found.causes[0].key == "coulomb@unwind"
    level = found.causes[0].parameters["level"]
    assert level.low <= 0.004 <= level.high or level.value == pytest.approx(0.004, rel=0.1)


def with_numbers(plant, key, **numbers):
    """A model of which only the numbers of one effect are asked for."""
    eta = plant.effect_vector()
    for i, slot in enumerate(plant.slots):
        if slot.key == key:
            eta[i] = numbers.get(slot.parameter.name, eta[i])
    records = (None, None)
    return SimpleNamespace(
        predictor=SimpleNamespace(plant=plant, records=records), fit=SimpleNamespace(point=SimpleNamespace(eta=eta[None]))
    )


@pytest.mark.parametrize(
    ("samples", "damping", "alias"),
    [(0.057, 0.028, True), (0.057, 0.3, False), (0.17, 0.028, False), (1.0, 0.02, False)],
)
def test_a_sensor_that_rings_faster_than_the_records_are_sampled_is_no_cause(samples, damping, alias):
    resonance = with_numbers(AXIS, "sensor-resonance@q", time=samples * AXIS.dt, damping=damping)
    assert search._is_alias(resonance, "sensor-resonance@q") is alias
    assert not search._is_alias(resonance, "sensor-lag@q")


@pytest.mark.parametrize(
    ("key", "turns", "sure"),
    [
        ("imbalance@unwind", (0.2, 0.4), False),
        ("imbalance@unwind", (0.2, 1.1), True),
        ("torque-ripple@unwind", (0.1, 0.2), True),  # of order 6
        ("torque-ripple@unwind", (0.1, 0.15), False),
        ("coulomb@unwind", (0.1, 0.1), True),
        ("periodic-tension@T1", (0.1, 0.1), True),  # comes back with time, not with an angle
    ],
)
def test_what_comes_back_with_every_turn_is_not_sure_where_nothing_turned_once(monkeypatch, key, turns, sure):
    ends = iter(turns)
    monkeypatch.setattr(
        causes, "trajectory", lambda model, i: {"angle of unwind": np.linspace(3.0, 3.0 + 2.0 * np.pi * next(ends), 50)}
    )
    step = SimpleNamespace(key=key, after=with_numbers(WEB_WINDING, key))
    assert bool(causes._not_round(step)) is not sure


@pytest.mark.parametrize(("gap", "finding"), [(-30.0, Finding.INCOMPLETE), (-3.0, Finding.NAMED), (8.0, Finding.NAMED)])
def test_a_pair_that_explains_much_more_than_the_one_law_speaks_against_it(gap, finding):
    step = SimpleNamespace(
        key="asymmetric-friction@slide",
        gain=400.0,
        stable=0.5,
        pairs={"coulomb@slide + offset@F": gap},
        after=with_numbers(AXIS, ""),
    )
    found = SimpleNamespace(steps=(step,), left=(), without_size={}, base=with_numbers(AXIS, ""))
    answer, doubts = causes.doubted(found, Finding.NAMED, {}, {step.key: ""}, (), (), False, {})
    assert answer is finding
    assert (doubts[step.key] == "coulomb@slide + offset@F explain these records better") is (finding is Finding.INCOMPLETE)


def test_what_is_left_is_compared_with_the_variable_of_a_cause_s_own_law():
    step = SimpleNamespace(key="coulomb@slide", gain=400.0, stable=0.5, pairs={}, after=with_numbers(AXIS, ""))
    for variable, sure in (("v", False), ("q", True)):  # the slide rubs over its speed v
        left = (SimpleNamespace(variable=variable, statistic=30.0, p_family=1e-6),)
        found = SimpleNamespace(steps=(step,), left=left, without_size={}, base=with_numbers(AXIS, ""))
        _, doubts = causes.doubted(found, Finding.INCOMPLETE, {}, {step.key: ""}, (), (), False, {})
        assert (doubts[step.key] == "") is sure
