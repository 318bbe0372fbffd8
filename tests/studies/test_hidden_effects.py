"""The study hidden-effects: its rates against rows made by hand, its table against runs that are cut off, its page."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import beta

from plants import POSITIONING_AXIS
from studies import STUDIES, hidden_effects
from studies.cases import SEEDS
from studies.cli import main as command
from studies.hidden_effects import TARGETS, configured, run, run_case, said, verdict
from studies.hidden_scores import (
    Outcome,
    Resolution,
    Share,
    by_machine,
    found,
    misled,
    must_be_found,
    outcome,
    resolution,
    strangers,
    summary,
    tied,
)
from studies.targets import to_json
from tests.hidden.catalogue import Hidden
from workbench.data import Dataset, Experiment
from workbench.diagnosis.answer import Limit
from workbench.diagnosis.fit import gauss_newton, term
from workbench.diagnosis.predictor import predictor
from workbench.diagnosis.recalibrate import recalibrated, unknowns
from workbench.errors import InputError

COULOMB, OFFSET, DELAY, LAG = "coulomb@rail", "offset@u", "input-delay@u", "sensor-lag@v"


def hid(key, multiple=6.0, *, size=None, catalogued=True, **parameters):
    return {
        "key": key, "multiple": multiple, "size": multiple if size is None else size, "catalogued": catalogued,
        "parameters": parameters,
    }  # fmt: skip


def named(key, *, ties=None, posterior=None, improved=0.5, sure=True, **parameters):
    ties = ties or {}
    posterior = 1.0 - sum(ties.values()) if posterior is None else posterior
    return {
        "key": key, "ties": ties, "posterior": posterior, "delta_bic": 50.0, "stability": 0.5, "parameters": parameters,
        "improved": improved, "sure": sure,
    }  # fmt: skip


def row(*truth, causes=(), verdict=None, kind=None, machine="welding-robot", seed=0, untestable=(), limits=1.0, seconds=1.0):
    verdict = verdict or ("named" if causes else "nothing")
    kinds = {0: "nothing", 1: "single" if truth and truth[0]["catalogued"] else "outside", 2: "pair"}
    return {
        "seed": seed, "configuration": "c", "machine": machine, "kind": kind or kinds[len(truth)], "truth": list(truth),
        "verdict": verdict, "causes": list(causes), "remainder": [], "untestable": list(untestable),
        "own_limits": {t["key"]: limits for t in truth}, "seconds": seconds,
    }  # fmt: skip


# ---- one row ----------------------------------------------------------------------------------------------------------------


def test_the_rounding_that_a_sensor_has_in_every_record_is_no_wrong_name_and_no_false_alarm_but_another_one_is():
    own, other = (named("quantisation@v", step=(step, step, step)) for step in (0.1, 0.2))
    for cause, wrong in ((own, 0), (other, 1)):
        nothing = row(causes=[cause]) | {"resolutions": {"v": 0.1}}
        beside = row(hid(LAG), causes=[named(LAG), cause]) | {"resolutions": {"v": 0.1}}
        assert summary([nothing]).false_alarms.hits == wrong
        assert outcome(beside) is (Outcome.BESIDE if wrong else Outcome.RIGHT)
    truth = row(hid("quantisation@v"), causes=[own]) | {"resolutions": {"v": 0.1}}
    assert outcome(truth) is Outcome.RIGHT


@pytest.mark.parametrize(
    ("causes", "verdict", "expected"),
    [
        ([named(COULOMB)], "named", Outcome.RIGHT),
        ([named(COULOMB)], "incomplete", Outcome.RIGHT),
        ([named(COULOMB, ties={OFFSET: 0.1, DELAY: 0.1, LAG: 0.1})], "named", Outcome.RIGHT),
        ([named(OFFSET, ties={COULOMB: 0.1, DELAY: 0.1})], "named", Outcome.TIE),
        ([named(OFFSET, ties={COULOMB: 0.1, DELAY: 0.1, LAG: 0.1})], "named", Outcome.FLAGGED),
        ([named(COULOMB), named(DELAY)], "named", Outcome.BESIDE),
        ([named(OFFSET)], "named", Outcome.WRONG),
        ([named(OFFSET, ties={DELAY: 0.4})], "named", Outcome.WRONG),
        ([named(OFFSET)], "incomplete", Outcome.WRONG),
        ([named(OFFSET, sure=False)], "incomplete", Outcome.FLAGGED),
        ([named("coulomb@arm")], "named", Outcome.WRONG),
        ([], "unknown", Outcome.UNKNOWN),
        ([], "nothing", Outcome.MISSED),
    ],
)
def test_what_was_said_about_one_effect_is_judged_by_name_place_tie_and_verdict(causes, verdict, expected):
    assert outcome(row(hid(COULOMB), causes=causes, verdict=verdict)) is expected


def test_a_friction_that_holds_another_one_is_right_only_as_a_declared_tie():
    one = hid("asymmetric-friction@rail")
    assert outcome(row(one, causes=[named(COULOMB)])) is Outcome.WRONG
    assert outcome(row(one, causes=[named(COULOMB, ties={"asymmetric-friction@rail": 0.2})])) is Outcome.TIE


def test_of_two_effects_each_needs_a_cause_of_its_own():
    pair = hid(COULOMB), hid(OFFSET)
    assert found(row(*pair, causes=[named(COULOMB), named(OFFSET)])) == 2
    assert found(row(*pair, causes=[named(COULOMB, ties={OFFSET: 0.3})])) == 1
    crossed = [named(DELAY, ties={COULOMB: 0.3, OFFSET: 0.2}), named(COULOMB)]
    assert found(row(*pair, causes=crossed)) == 2  # the tie stands for the offset, though the friction comes first in it
    assert strangers(row(*pair, causes=[named(COULOMB), named(LAG)])) == [LAG]


def test_two_effects_that_are_a_rival_together_count_only_where_both_are_hidden():
    said = named("asymmetric-friction@rail", ties={f"{COULOMB} + {OFFSET}": 0.4})
    assert found(row(hid(COULOMB), hid(OFFSET), causes=[said])) == 2
    assert misled(row(hid(COULOMB), hid(OFFSET), causes=[said])) == []
    assert strangers(row(hid(COULOMB), hid(OFFSET), causes=[said])) == []
    assert outcome(row(hid(COULOMB), causes=[said])) is Outcome.WRONG
    assert found(row(hid(COULOMB), hid(DELAY), causes=[said])) == 0
    wide = named(LAG, ties={f"{COULOMB} + {OFFSET}": 0.4, DELAY: 0.1, "x@y": 0.1})
    assert found(row(hid(COULOMB), hid(OFFSET), causes=[wide])) == 0
    (stated,) = summary([row(hid(COULOMB), hid(OFFSET), causes=[said | {"posterior": 0.45}])]).calibration
    assert (stated.share.hits, stated.share.of) == (1, 2)  # the name and the pair: the pair was hidden


def test_an_effect_must_be_found_from_twice_both_limits_on_unless_it_could_not_be_tested():
    assert must_be_found(row(hid(COULOMB, 2.0)))
    assert not must_be_found(row(hid(COULOMB, 1.9, size=100.0)))
    assert not must_be_found(row(hid(COULOMB, 9.0, size=1.9)))
    assert not must_be_found(row(hid(COULOMB), untestable=[COULOMB]))
    assert not must_be_found(row(hid(COULOMB), limits=4.0))
    assert not must_be_found(row(hid(COULOMB), hid(OFFSET, 1.0)))
    assert not must_be_found({**row(hid(COULOMB)), "own_limits": {}})


def test_the_limit_that_a_rounded_channel_states_for_itself_excuses_nothing():
    """R^2 = r^2 + q^2/12 makes the stated limit sqrt(3) R grow with the step q: no step would be twice it."""
    assert must_be_found(row(hid("quantisation@v", 9.0, size=9.0), limits=6.0))
    assert not must_be_found(row(hid("quantisation@v", 1.0, size=9.0)))


TIED = [named(COULOMB, ties={OFFSET: 0.3})]


def after(*causes, runs=2, **more):
    """The row's part that a recommended experiment adds."""
    return {"experiment": {"expected": {"steps": 14.0}, "runs": runs, "after": {"verdict": "named", "causes": [*causes]}} | more}


@pytest.mark.parametrize(
    ("causes", "expected"),
    [
        ([named(COULOMB)], Resolution.RESOLVED),
        ([named(COULOMB, ties={OFFSET: 0.01})], Resolution.TIED),
        ([named(OFFSET, ties={COULOMB: 0.4})], Resolution.TIED),
        ([named(COULOMB, ties={LAG: 0.01})], Resolution.TIED),  # another rival than before is one
        ([named(OFFSET)], Resolution.LOST),
        ([named(COULOMB), named(DELAY)], Resolution.LOST),
        ([named(COULOMB, ties={OFFSET: 0.1}), named(DELAY)], Resolution.LOST),
        ([], Resolution.LOST),
    ],
)
@pytest.mark.parametrize("before", [TIED, [named(OFFSET, ties={COULOMB: 0.3})]])
def test_a_tie_is_resolved_where_the_true_name_stands_alone_after_the_experiment(before, causes, expected):
    assert resolution(row(hid(COULOMB), causes=before) | after(*causes)) is expected


def test_an_experiment_counts_only_where_a_tie_held_what_was_hidden():
    alone = after(named(COULOMB))
    assert resolution(row(hid(COULOMB), causes=[named(COULOMB)]) | alone) is None
    assert resolution(row(hid(COULOMB), causes=[named(OFFSET, ties={DELAY: 0.3})]) | alone) is None
    wide = [named(OFFSET, ties={COULOMB: 0.1, DELAY: 0.1, LAG: 0.1})]
    assert resolution(row(hid(COULOMB), causes=wide) | alone) is None
    assert resolution(row(hid(COULOMB), causes=TIED)) is None  # nothing was to choose from
    assert resolution(row(causes=TIED) | alone) is None
    failed = {k: v for k, v in row(hid(COULOMB)).items() if k in ("seed", "machine", "kind", "truth")} | {"error": "boom"}
    assert resolution(failed) is None


def test_what_no_experiment_decides_and_what_could_not_be_run_are_told_apart():
    start = row(hid(COULOMB), causes=TIED)
    assert resolution(start | {"experiment": {"expected": {"steps": 0.1}, "runs": 0}}) is Resolution.UNDECIDABLE
    fault = {"experiment": {"expected": {"steps": 30.0}, "runs": 1, "fault": "the axis ran away"}}
    assert resolution(start | fault) is Resolution.FAILED
    assert "could not be run" in said(start | fault)


def test_of_two_effects_that_were_tied_both_must_stand_alone():
    pair = row(hid(COULOMB), hid(LAG), causes=[*TIED, named(LAG, ties={DELAY: 0.5})])
    assert tied(pair) == {COULOMB, LAG}
    assert resolution(pair | after(named(COULOMB), named(LAG))) is Resolution.RESOLVED
    assert resolution(pair | after(named(COULOMB), named(LAG, ties={DELAY: 0.5}))) is Resolution.TIED
    assert resolution(pair | after(named(COULOMB))) is Resolution.LOST
    one = row(hid(COULOMB), hid(LAG), causes=[*TIED, named(LAG)])  # what was never tied need not be found again
    assert tied(one) == {COULOMB}
    assert resolution(one | after(named(COULOMB))) is Resolution.RESOLVED


def test_the_share_of_resolved_ties_is_of_those_for_which_an_experiment_was_recommended():
    start = row(hid(COULOMB), causes=TIED)
    none = {"experiment": {"expected": {}, "runs": 0}}
    failed = {"experiment": {"expected": {}, "runs": 1, "fault": "slack"}}
    rows = [start | after(named(COULOMB)), start | after(named(COULOMB)), start | after(*TIED), start | none, start | failed]
    s = summary([*rows, start, row(hid(COULOMB)), {**start, "undrawn": "no"} | after()])
    assert (s.resolved.hits, s.resolved.of) == (2, 4)
    assert (s.undecidable.hits, s.undecidable.of) == (1, 5)
    assert s.ties == {
        "the true name alone": 2, "still tied": 1, "the experiment could not be run": 1, "no experiment can": 1,
    }  # fmt: skip
    np.testing.assert_allclose(s.resolved.interval, [beta.ppf(0.025, 2, 3), beta.ppf(0.975, 3, 2)], rtol=1e-9)
    assert summary(MIXED).resolved.of == 0


# ---- many rows --------------------------------------------------------------------------------------------------------------


def test_intervals_are_those_of_the_beta_distribution():
    low, high = Share(3, 40).interval
    np.testing.assert_allclose([low, high], [beta.ppf(0.025, 3, 38), beta.ppf(0.975, 4, 37)], rtol=1e-9)
    np.testing.assert_allclose(Share(0, 300).interval, [0.0, 1.0 - 0.025 ** (1 / 300)], rtol=1e-9)
    assert Share(0, 0).interval == (0.0, 1.0)
    assert math.isnan(Share(0, 0).rate)


MIXED = [
    row(hid(COULOMB, level=1.0), causes=[named(COULOMB, level=[1.1, 0.9, 1.3])]),
    row(hid(COULOMB, level=1.0), causes=[named(COULOMB, level=[1.4, 1.2, 1.6], improved=1.2)]),
    row(hid(COULOMB), causes=[named(OFFSET, ties={COULOMB: 0.3})]),
    row(hid(COULOMB), causes=[named(OFFSET)]),
    row(hid(COULOMB)),
    row(hid(COULOMB, 0.7), causes=[named(LAG)]),
    row(hid(COULOMB, 3.0), limits=5.0),
    *[row(seconds=s) for s in (1.0, 2.0, 30.0)],
    row(causes=[named(DELAY)], machine="positioning-axis"),
    row(verdict="unknown"),
    row(hid(COULOMB), hid(OFFSET), causes=[named(COULOMB), named(OFFSET)]),
    row(hid(COULOMB), hid(OFFSET), causes=[named(COULOMB), named(LAG)]),
    row(hid(COULOMB), hid(OFFSET, 1.0), causes=[]),
    row(hid(COULOMB), hid(OFFSET), limits=5.0),
    row(hid("cable@outside", 6.0, catalogued=False), verdict="unknown"),
    row(hid("cable@outside", 6.0, catalogued=False), causes=[named(LAG)]),
    row(hid("cable@outside", 6.0, catalogued=False), causes=[named(LAG)], verdict="incomplete"),
    row(hid("cable@outside", 4.9, catalogued=False)),
]


@pytest.mark.parametrize(
    ("rate", "hits", "of"),
    [
        ("right", 2, 5), ("right_or_tie", 3, 5), ("wrong", 1, 5), ("missed", 1, 5), ("right_or_tie_by_multiple", 3, 6),
        ("wrong_at_any_size", 2, 7), ("false_alarms", 1, 5), ("unknown_of_nothing", 1, 5), ("both", 1, 2), ("one", 1, 2),
        ("both_by_multiple", 1, 3),
        ("wrong_in_pairs", 1, 2), ("outside", 2, 3), ("inside", 1, 2), ("gained", 11, 12),
    ],
)  # fmt: skip
def test_a_rate_is_of_the_cases_it_is_meant_for(rate, hits, of):
    share = getattr(summary(MIXED), rate)
    assert (share.hits, share.of) == (hits, of)


def test_a_diagnosis_that_ends_with_an_error_is_a_miss_and_a_case_that_was_not_drawn_is_none():
    failed = {k: v for k, v in row(hid(COULOMB)).items() if k in ("seed", "machine", "kind", "truth")} | {"error": "E\nboom"}
    undrawn = {"seed": 1, "machine": "welding-robot", "kind": "pair", "truth": [], "undrawn": "no sound runs"}
    s = summary([failed, undrawn])
    assert (s.cases, s.errors, s.missed.hits, s.right.of) == (1, 1, 1, 1)
    assert "boom" in said(failed)
    assert "no sound runs" in said(undrawn)
    assert "error" in verdict(s)


def test_every_machine_has_its_own_rates_and_all_rows_are_counted_once():
    every = by_machine(MIXED)
    assert list(every) == ["all", "positioning-axis", "welding-robot"]
    assert every["positioning-axis"].false_alarms.hits == 1
    assert every["welding-robot"].false_alarms.hits == 0
    assert sum(s.cases for name, s in every.items() if name != "all") == every["all"].cases == len(MIXED)


def test_sizes_fall_into_the_bins_of_their_multiple_the_lower_bound_inside():
    s = summary([row(hid(COULOMB, m), causes=[named(COULOMB)] if m >= 2.0 else ()) for m in (0.5, 0.99, 1.0, 2.0, 7.9, 20.0)])
    assert [(b.low, b.share.hits, b.share.of) for b in s.detection] == [(0.5, 0, 2), (1, 0, 1), (2, 1, 1), (4, 1, 1), (8, 1, 1)]


def test_honest_odds_are_on_the_line():
    """Of 10 ties stated as 0.7 to 0.3 seven hold the first and three the second: both bins hold what they state."""
    rows = [row(hid(COULOMB if k < 7 else OFFSET), causes=[named(COULOMB, ties={OFFSET: 0.3})]) for k in range(10)]
    bins = summary(rows).calibration
    np.testing.assert_allclose([(b.mean, b.share.rate) for b in bins], [(0.3, 0.3), (0.7, 0.7)])


def test_confusions_are_listed_most_frequent_first_with_those_that_were_declared():
    rows = [row(hid(COULOMB), causes=[named(OFFSET, ties=t)]) for t in ({}, {COULOMB: 0.4}, {})]
    first, second = summary([row(hid(LAG), causes=[named(DELAY)]), row(hid(LAG), causes=[named(LAG)]), *rows]).confusions
    assert (first.hidden, first.named, first.count, first.tied) == (COULOMB, OFFSET, 3, 1)
    assert (second.hidden, second.named, second.count) == (LAG, DELAY, 1)


def test_seconds_are_told_by_machine_and_kind():
    (nothing,) = summary([row(seconds=s) for s in (1.0, 2.0, 12.0)]).seconds
    assert (nothing.kind, nothing.cases, nothing.median, nothing.longest) == ("welding-robot, nothing", 3, 2.0, 12.0)
    assert nothing.p90 == pytest.approx(10.0)


# ---- detection limits ---------------------------------------------------------------------------------------------------------

ROBOT_MACHINE = "welding-robot"


@pytest.fixture
def losses(monkeypatch):
    """Records that hold the size that is hidden in them, and a plant that loses 25 (size/limit)^2; beyond `breaks` it breaks."""
    case = hidden_effects.generator()
    state = {"limit": 0.02, "breaks": np.inf, "tried": [], "stated": ()}

    def made(seed, machine, truth=()):
        size = truth[0].size if truth else 0.0
        state["tried"] += [size] if truth else []
        if size > state["breaks"]:
            raise InputError("the robot ran away")
        inputs = {"u": np.full(60, 2.0) * np.where(np.arange(60) % 2, 1.0, -1.0)}
        return Dataset((Experiment.from_arrays("made", 0.02, inputs=inputs, outputs={"v": np.full(60, size)}, units={}),))

    class Diagnosed:
        limits = property(lambda self: state["stated"])

    monkeypatch.setattr(case, "records", made)
    monkeypatch.setattr(case.MACHINES[ROBOT_MACHINE], "FOREIGN", ("cubic-drag",))
    monkeypatch.setattr(hidden_effects, "diagnose", lambda plant, data: Diagnosed())
    monkeypatch.setattr(
        hidden_effects, "_deviance", lambda machine, data: 7.0 + 25.0 * (data.experiments[0]["v"][0] / state["limit"]) ** 2
    )
    state["trial"] = case.MACHINES[ROBOT_MACHINE].TRIAL
    return state


@pytest.mark.parametrize("far", [1e-3, 0.3, 1.0, 4.0, 30.0, 1e4])
def test_the_limit_of_foreign_physics_is_the_size_that_loses_25_however_far_off_the_first_trial_is(losses, far, monkeypatch):
    monkeypatch.setitem(losses["trial"], "cubic-drag", far * losses["limit"])
    found = hidden_effects.limits_of(ROBOT_MACHINE)
    assert found == {"cubic-drag@outside": pytest.approx(losses["limit"])}
    assert len(losses["tried"]) <= hidden_effects.TRIALS
    # read where the loss is clear and not yet far beyond: neither noise nor what bends decides
    assert 4.0 <= (losses["tried"][-1] / losses["limit"]) ** 2 <= 64.0


def test_a_machine_that_breaks_is_tried_with_less_and_what_it_cannot_show_has_no_limit(losses, monkeypatch):
    monkeypatch.setitem(losses["trial"], "cubic-drag", 40.0 * losses["limit"])
    losses["breaks"] = 6.0 * losses["limit"]
    assert hidden_effects.limits_of(ROBOT_MACHINE)["cubic-drag@outside"] == pytest.approx(losses["limit"])
    losses["breaks"] = 0.0
    assert hidden_effects.limits_of(ROBOT_MACHINE) == {}


def test_the_limit_of_a_saturation_is_how_far_it_lies_below_the_largest_command(losses):
    losses["stated"] = (Limit("saturation", "u", 1.7, "N"), Limit("offset", "u", 0.1, "N"))
    found = hidden_effects.limits_of(ROBOT_MACHINE)
    assert (found["saturation@u"], found["offset@u"]) == (pytest.approx(0.3), 0.1)
    losses["stated"] = (Limit("saturation", "u", 2.1, "N"),)  # a clip above every command shows nothing
    assert "saturation@u" not in hidden_effects.limits_of(ROBOT_MACHINE)


@pytest.mark.slow
def test_an_effect_of_three_limits_is_worth_nine_times_25_to_a_fit(monkeypatch):
    """The limit is read from signatures where nothing is hidden; here it is, and fitted at the noise levels of those records."""
    case, plant = hidden_effects.generator(), POSITIONING_AXIS
    monkeypatch.setattr(case.MACHINES["positioning-axis"], "FOREIGN", ())
    limits = hidden_effects.limits_of("positioning-axis", seed=77, records=1)
    quiet = recalibrated(predictor(plant, Dataset(case.records(77, "positioning-axis").experiments[:1])))
    worth = {}
    for key in ("offset@F", "coulomb@slide"):
        truth = (Hidden(*key.split("@"), {"level": 3.0 * limits[key]}, 3.0),)
        made = predictor(plant, Dataset(case.records(77, "positioning-axis", truth).experiments[:1]))
        made = made.regained(replace(made.point, p=quiet.fit.point.p), quiet.predictor.noise)
        own, beside = unknowns(made), unknowns(made, (term(plant, key),))
        sizes = np.zeros(len(plant.slots))
        sizes[list(beside.terms[0].sizes)] = 0.01 * limits[key]
        base = gauss_newton(made, own, own.zero(), sizes, rounds=6)
        worth[key] = base.cost - gauss_newton(made, beside, np.append(base.z, 3.0 * limits[key]), sizes, rounds=6).cost
    # 2 log L of an effect of 15 standard deviations: 225 with a spread of 30
    assert all(225.0 - 90.0 < value < 225.0 + 90.0 for value in worth.values()), worth


# ---- the table of cases -------------------------------------------------------------------------------------------------------


@pytest.fixture
def quick_cases(monkeypatch):
    """Limits and cases without a diagnosis; the seeds that were run."""
    ran = []

    def made(seed, limits, configuration):
        ran.append(seed)
        return row(seed=seed) | {"configuration": configuration}

    monkeypatch.setattr(hidden_effects, "limits_of", lambda machine: {"offset@u": 0.1})
    monkeypatch.setattr(hidden_effects, "run_case", made)
    return ran


def test_a_run_that_was_cut_off_within_a_row_makes_that_row_again_and_no_other(tmp_path, quick_cases):
    run(tmp_path, range(5))
    table = tmp_path / "cases.jsonl"
    text = table.read_text()
    table.write_text(text[: text.rfind("}", 0, len(text) - 1) + 1])  # cut at a bracket inside the last row
    rows = run(tmp_path, range(6))
    assert quick_cases == [0, 1, 2, 3, 4, 4, 5]
    assert [r["seed"] for r in rows] == [json.loads(line)["seed"] for line in table.read_text().splitlines()] == [*range(6)]


@pytest.mark.slow
def test_several_processes_make_the_same_rows_as_one(tmp_path, monkeypatch):
    """Without limits no effect can be drawn: the row says so, and the way of a case through the processes is all that is run."""
    monkeypatch.setattr(hidden_effects, "limits_of", lambda machine: {})
    case = hidden_effects.generator()
    seeds = [seed for seed in range(100) if case.lot_of(seed).machine != "web-winding"]
    seeds = [seed for seed in seeds if case.lot_of(seed).kind in (case.Kind.SINGLE, case.Kind.PAIR)][:6]
    one, two = (run(tmp_path / str(jobs), seeds, jobs) for jobs in (1, 2))
    assert one == sorted(two, key=lambda made: made["seed"])
    assert [made["seed"] for made in one] == seeds
    assert all("too few effects" in made["undrawn"] for made in one)


def test_cases_of_other_limits_are_not_mixed(tmp_path, quick_cases):
    run(tmp_path, range(2))
    path = tmp_path / "limits-welding-robot.json"
    path.write_text(path.read_text().replace("0.1", "0.2"))
    with pytest.raises(InputError, match="another version or with other limits") as refused:
        run(tmp_path, range(3))
    assert "cases.jsonl" in str(refused.value)
    assert "--out" in str(refused.value)
    assert quick_cases == [0, 1]


def test_the_configuration_tells_limits_and_versions_apart(monkeypatch):
    before = configured({"m": {"offset@u": 0.1}})
    assert configured({"m": {"offset@u": 0.1}}) == before != configured({"m": {"offset@u": 0.2}})
    with monkeypatch.context() as other:  # rows that know nothing of experiments are not counted with rows that do
        other.setattr(hidden_effects, "LAYOUT", hidden_effects.LAYOUT - 1)
        assert configured({"m": {"offset@u": 0.1}}) != before
    monkeypatch.setattr("workbench.table.versions", lambda: {"gain-scheduling-workbench": "another"})
    assert configured({"m": {"offset@u": 0.1}}) != before


@pytest.mark.slow
def test_a_case_holds_what_was_hidden_what_was_said_and_the_limits_of_its_own_records():
    """Offset of the axis' drive, its limit 1 N: drawn, diagnosed, and judged from the row that is written."""
    case = hidden_effects.generator()
    wanted = ("positioning-axis", case.Kind.SINGLE)
    seed = next(s for s in range(10**4) if (lot := case.lot_of(s)) and (lot.machine, lot.kind) == wanted)
    drawn = run_case(seed, {"positioning-axis": {"offset@F": 1.0}}, "c")
    (truth,) = json.loads(json.dumps(drawn))["truth"]
    assert truth["size"] == pytest.approx(abs(truth["parameters"]["level"]))
    assert truth["size"] == pytest.approx(truth["multiple"])
    assert 0.0 < drawn["own_limits"]["offset@F"] < 5.0
    assert isinstance(outcome(drawn), Outcome)
    assert drawn["seconds"] > 0.0


@pytest.mark.slow
def test_a_tie_of_two_frictions_of_the_robot_is_resolved_by_the_experiment_that_is_recommended():
    """Friction in one direction, twice its limit: three records cannot tell it from friction in both; more of the plan can."""
    case = hidden_effects.generator()
    seed, limits = 12_001_028, {"asymmetric-friction@rail": 0.005}
    assert case.lot_of(seed).machine == "welding-robot"
    drawn = run_case(seed, {"welding-robot": limits}, "c")
    assert tied(drawn) == {"asymmetric-friction@rail"}
    assert drawn["experiment"]["runs"] >= 1
    assert resolution(json.loads(json.dumps(drawn))) is Resolution.RESOLVED
    (before,), (after,) = drawn["causes"], drawn["experiment"]["after"]["causes"]
    assert after["delta_bic"] > before["delta_bic"]


@pytest.mark.slow
def test_where_no_experiment_decides_none_is_run(monkeypatch):
    """A constant force on the rail and one at the motor are the same: whatever moves the robot, it cannot tell them apart."""
    case = hidden_effects.generator()
    wanted = ("welding-robot", case.Kind.SINGLE)
    seed = next(s for s in range(10**4) if (lot := case.lot_of(s)) and (lot.machine, lot.kind) == wanted)
    monkeypatch.setattr(case, "further", None)
    drawn = run_case(seed, {"welding-robot": {"rail-tilt@rail": 0.02}}, "c")
    assert resolution(drawn) is Resolution.UNDECIDABLE
    assert max(drawn["experiment"]["expected"].values()) < 1.0


# ---- command and page ---------------------------------------------------------------------------------------------------------


def test_the_command_runs_the_seeds_asked_for_and_writes_page_and_numbers(tmp_path, quick_cases, capsys):
    assert STUDIES["hidden-effects"]() is hidden_effects
    asked = ["study", "hidden-effects", "--seed", "7", "--cases", "3", "--out", str(tmp_path), "--json", str(tmp_path / "n.json")]
    assert command(asked) == 0
    assert quick_cases == [7 * SEEDS, 7 * SEEDS + 1, 7 * SEEDS + 2]
    assert "3 cases" in capsys.readouterr().out
    numbers = json.loads((tmp_path / "n.json").read_text())
    assert numbers["summary"]["all"]["false_alarms"]["of"] == 3
    assert numbers["provenance"]["seed"] == 7
    assert "false" not in (tmp_path / "cases.jsonl").read_text()
    assert (tmp_path / "report.html").is_file()


def test_cases_are_an_option_of_this_study_alone(tmp_path, capsys):
    assert command(["study", "emps", "--cases", "3", "--out", str(tmp_path)]) == 2
    assert "--cases" in capsys.readouterr().err


def test_the_page_shows_what_became_of_ties_and_lists_those_that_were_not_resolved():
    start = row(hid(COULOMB), causes=TIED)
    rows = [start | after(named(COULOMB)), start | after(named(OFFSET)), start | {"experiment": {"expected": {}, "runs": 0}}]
    report = hidden_effects._report(rows, by_machine(rows), {})
    table, text = next(s for s in report.sections if s.title == "Ties").blocks
    assert [(r[0], r[1]) for r in table.rows] == [(r.value, n) for r, n in zip(Resolution, (1, 0, 1, 0, 1), strict=True)]
    assert f"named: {OFFSET}" in text.text
    assert f"named: {COULOMB} ~" in text.text


def test_data_are_refused(tmp_path):
    with pytest.raises(InputError, match="its own records"):
        hidden_effects.main(folder=tmp_path, data="folder")


def test_the_verdict_says_where_it_falls_short_before_what_it_reached():
    text = verdict(summary([row(hid(COULOMB), causes=[named(OFFSET)]), *[row() for _ in range(300)]]))
    short, reached, without = (text.index(word) for word in ("Falls short", "Reached", "Without a case"))
    assert short < text.index("confident wrong name: 1 of 1 (100.0 %") < reached
    assert reached < text.index("nothing hidden, yet a cause named: 0 of 300 (0.0 %, 95 % interval 0.0 to 1.2 %)") < without
    assert all(t.what in text for t in TARGETS)


def test_a_target_is_a_range_and_too_wide_intervals_are_no_success():
    inside = next(t for t in TARGETS if t.rate == "inside")
    assert [inside.reached(Share(n, 100)) for n in (89, 90, 97, 98)] == [False, True, True, False]
    alarms = next(t for t in TARGETS if t.rate == "false_alarms")
    assert [alarms.reached(Share(n, 300)) for n in (3, 4)] == [True, False]


def test_the_page_shows_every_picture_and_lists_every_wrong_case():
    every = by_machine(MIXED)
    report = hidden_effects._report(MIXED, every, {})
    assert [s.title for s in report.sections] == [
        "Targets", "Size", "Stated odds", "What was taken for what", "Run time", "Cases that went wrong", "Provenance",
    ]  # fmt: skip
    texts = " ".join(block.text for block in report.sections[5].blocks)
    assert "Confident wrong names: 2" in texts
    assert f"{COULOMB} x0.7 -> named: {LAG}" in texts
    assert "Named though nothing was hidden: 1" in texts
    assert json.loads(json.dumps(to_json(every["all"])))["wrong"]["hits"] == 1
