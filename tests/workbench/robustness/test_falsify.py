"""Worst machines known in closed form, and on the machines of the workbench; what is stored is found again."""

import json
from dataclasses import replace

import numpy as np
import pytest

from controllers.files import controller_of
from controllers.pid import pid
from plants import WELDING_ROBOT
from workbench.data import Channel
from workbench.errors import InputError
from workbench.physics.controller import Playback, content_of
from workbench.physics.extension import extension
from workbench.physics.parameters import Parameter
from workbench.physics.plant import Plant
from workbench.physics.rest import Start
from workbench.robustness.falsify import trials
from workbench.robustness.falsify.box import Dimension, fitted_box, tolerance_box
from workbench.robustness.falsify.counterexample import load_counterexample
from workbench.robustness.falsify.search import at_random, worst_plant
from workbench.robustness.falsify.trials import Search
from workbench.robustness.limits import Limit, Manoeuvre
from workbench.simulation import Scenario, simulate

# ---- worst cases in closed form -------------------------------------------------------------------------
#
#     y' = a u - b - (c - 0.3)^2 - (d + 0.2)^2 + hill exp(-20 ((e - 0.7)^2 + (f + 0.6)^2)) + slope (e + f),   y(0) = 0
#
# y moves evenly, so that with u = 1 its end at 1 s is its derivative: over `high` it is worst at a corner in a and b, and inside
# in c and d; below `low` it is worst at a corner in all four.


def equation(x, u, p, at):
    hill = p.hill * np.exp(-20.0 * ((p.e - 0.7) ** 2 + (p.f + 0.6) ** 2)) + p.slope * (p.e + p.f)
    return {"x": p.a * u.u - p.b - (p.c - 0.3) ** 2 - (p.d + 0.2) ** 2 + hill}


NAMES = {"a": 1.0, "b": 0.5, "c": 0.0, "d": 0.0, "e": 0.0, "f": 0.0, "hill": 0.0, "slope": 0.0}
TOY = Plant(
    "toy", (Channel("x", "m"),), (Channel("u", "V", "input"),), (Channel("y", "m", "output"),),
    tuple(Parameter(name, value, tolerance=0.2 * (name in "ab"), signed=True) for name, value in NAMES.items()),
    equation, lambda x, p: {"y": x.x}, dt=0.1, substeps=1, start=Start({"x": 0.0}), noise={"y": 0.1},
)  # fmt: skip
LAW = Playback(("u",), 0.1)
SCENARIO = Scenario("ones", {"u": np.ones(11)})
BOX = (*tolerance_box(TOY), *(Dimension(name, -1.0, 1.0) for name in "cd"))


def worst(*limits, box=BOX, runs=200, **options):
    return worst_plant(Search(TOY, LAW, SCENARIO, limits, box, runs=runs, **options))


def test_the_box_of_tolerances():
    assert [(str(d), d.low, d.high) for d in tolerance_box(TOY)] == [("a", 0.8, 1.2), ("b", 0.4, 0.6)]
    turned = replace(TOY, parameters=(Parameter("a", -2.0, tolerance=0.5, signed=True), *TOY.parameters[1:]))
    assert [(d.low, d.high) for d in tolerance_box(turned, ["a"])] == [(-3.0, -1.0)]
    for names, message in ((["c"], "has no tolerance"), (["A"], "did you mean 'a'")):
        with pytest.raises(InputError, match=message):
            tolerance_box(TOY, names)


def test_a_worst_case_at_a_corner_is_found_exactly():
    found = worst(Limit("y", low=-1.0), runs=60)
    assert found.point == {"a": 0.8, "b": 0.6, "c": -1.0, "d": 1.0}
    assert found.excess == pytest.approx(-1.0 - (0.8 - 0.6 - 1.3**2 - 1.2**2), rel=1e-12)
    assert found.share == pytest.approx(found.excess / 1.0)
    assert (found.limit.signal, found.bound, found.sample, found.limit.unit) == ("y", "low", 10, "m")
    assert found.value == pytest.approx(-2.93)
    assert found.nominal == pytest.approx(-1.0)  # it starts at 0 and rises


def test_a_worst_case_inside_the_box_is_found_closely():
    found = worst(Limit("y", high=2.0), runs=400)
    assert found.point["a"] == 1.2
    assert found.point["b"] == 0.4
    assert found.point["c"] == pytest.approx(0.3, abs=0.01)
    assert found.point["d"] == pytest.approx(-0.2, abs=0.01)
    assert found.excess == pytest.approx(0.8 - 2.0, abs=1e-4)
    assert not found.broken


def test_a_single_number_is_searched_too():
    found = worst(Limit("y", high=2.0), box=(Dimension("c", -1.0, 1.0),), runs=100)
    assert found.point["c"] == pytest.approx(0.3, abs=0.01)


@pytest.mark.slow
def test_a_hill_beside_a_slope_to_another_corner_is_found():
    """Ends, corners and the surroundings of the best corner all point away from it."""
    plant = TOY_WITH_A_HILL
    box = tuple(Dimension(name, -1.0, 1.0) for name in "ef")
    for seed in range(3):
        found = worst_plant(Search(plant, LAW, SCENARIO, [Limit("y", high=1.0)], box, runs=800, seed=seed))
        assert found.point["e"] == pytest.approx(0.7, abs=0.05)
        assert found.point["f"] == pytest.approx(-0.6, abs=0.05)


TOY_WITH_A_HILL = extension(TOY, "", {"hill": 2.0, "slope": 0.2}).of(TOY)


def test_an_effect_is_a_dimension_like_a_parameter():
    box = (Dimension("a", 0.8, 1.2), Dimension("level", -0.3, 0.5, effect="offset@u"))
    found = worst(Limit("y", high=1.0), box=box, runs=30)
    assert found.point == {"a": 1.2, "offset@u:level": 0.5}
    assert found.effects == {"offset@u": {"level": 0.5}}
    assert found.parameters["a"] == 1.2
    assert found.excess == pytest.approx(1.2 * 1.5 - 0.5 - 0.13 - 1.0)


def test_numbers_that_are_known_exactly_are_set_and_not_searched():
    found = worst(Limit("y", low=-1.0), box=(Dimension("b", 0.7, 0.7), Dimension("a", 0.8, 1.2)), runs=20)
    assert found.point == {"b": 0.7, "a": 0.8}
    alone = worst(Limit("y", low=-1.0), box=(Dimension("b", 0.7, 0.7),), runs=20)
    assert (alone.parameters["b"], alone.runs) == (0.7, 2)


def test_of_several_limits_the_one_that_is_broken_by_the_larger_share_is_reported():
    found = worst(Limit("y", high=10.0), Limit("u", high=0.5, begin=0.5), Limit("y", low=-0.1), runs=100)
    assert (found.limit.signal, found.bound) == ("y", "low")
    assert found.share == pytest.approx((2.93 - 0.1) / 0.1)
    found = worst(Limit("y", high=10.0), Limit("u", high=0.01), runs=30)
    assert (found.limit.signal, found.share) == ("u", pytest.approx(99.0))


def test_of_several_scenarios_the_worst_is_reported():
    twice = Scenario("twice", {"u": np.full(21, 2.0)})
    found = worst_plant(Search(TOY, LAW, [SCENARIO, twice], [Limit("y", high=1.0)], BOX, runs=201))
    assert found.scenario.name == "twice"
    assert found.excess == pytest.approx(2.0 * (2.4 - 0.4) - 1.0, abs=0.01)
    assert found.runs <= 201


# ---- the budget, and what is kept -----------------------------------------------------------------------


@pytest.fixture
def counted(monkeypatch):
    """The last y of every run that is made."""
    seen, original, single = [], trials.simulate_batch, trials.simulate

    def batch(plant, *rest, parameters, **options):
        run = original(plant, *rest, parameters=parameters, **options)
        seen.extend(run.measured[:, -1, 0])
        return run

    def one(*rest, **options):
        run = single(*rest, **options)
        seen.append(run.experiment["y"][-1])
        return run

    monkeypatch.setattr(trials, "simulate_batch", batch)
    monkeypatch.setattr(trials, "simulate", one)
    return seen


@pytest.mark.parametrize("search", [worst_plant, at_random])
@pytest.mark.parametrize("runs", [2, 9, 40, 203])
def test_the_budget_is_kept_and_nothing_worse_than_the_answer_was_run(counted, search, runs):
    found = search(Search(TOY, LAW, SCENARIO, [Limit("y", high=0.3)], BOX, runs=runs, seed=1))
    assert len(counted) == found.runs <= runs
    assert found.runs == runs  # an interior optimum uses all of it
    assert found.excess == max(counted) - 0.3
    assert found.share == found.history[-1] == found.history.max()
    np.testing.assert_array_equal(found.history, np.maximum.accumulate(found.history))
    assert found.history[0] == found.nominal


def test_the_same_seed_gives_the_same_answer_and_another_one_another(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cma_signals.in").write_text("{'timeout': 0}")
    np.random.seed(7)  # noqa: NPY002 - the global state, which a search must leave alone
    state = np.random.get_state()[1].copy()  # noqa: NPY002
    first, again, other = (worst(Limit("y", high=2.0), runs=150, seed=seed) for seed in (4, 4, 5))
    assert first.point == again.point != other.point
    np.testing.assert_array_equal(first.history, again.history)
    assert first.runs == 150  # a file that lies about stops nothing
    np.testing.assert_array_equal(np.random.get_state()[1], state)  # noqa: NPY002
    assert [path.name for path in tmp_path.iterdir()] == ["cma_signals.in"]
    assert capfd.readouterr() == ("", "")


def test_random_machines_differ_by_seed_and_fill_the_box(counted):
    found = at_random(Search(TOY, LAW, SCENARIO, [Limit("y", low=-1.0)], BOX, runs=400, seed=0))
    assert found.share < worst(Limit("y", low=-1.0), runs=60).share
    assert len(set(counted)) > 390
    assert at_random(Search(TOY, LAW, SCENARIO, [Limit("y", low=-1.0)], BOX, runs=40, seed=1)).point != found.point


def test_what_cannot_be_searched_is_refused():
    for options, message in (
        ({"box": (*BOX, Dimension("a", 0.0, 1.0))}, "a is given twice"),
        ({"box": (Dimension("A", 0.0, 1.0),)}, "did you mean 'a'"),
        ({"box": (Dimension("level", 0.0, 1.0, effect="ofset@u"),)}, "did you mean 'offset@u'"),
        ({"box": (Dimension("size", 0.0, 1.0, effect="offset@u"),)}, "unknown parameter of offset@u"),
        ({"box": (Dimension("time", -1.0, 1.0, effect="input-delay@u"),)}, "lies in"),
        ({"runs": 1}, "at least 2"),
    ):
        with pytest.raises(InputError, match=message):
            worst(Limit("y", high=1.0), **options)
    with pytest.raises(InputError, match="after the end of the run"):
        worst(Limit("y", high=1.0, begin=2.0))
    with pytest.raises(InputError, match="no limit"):
        worst()
    with pytest.raises(InputError, match="low <= high"):
        Dimension("a", 2.0, 1.0)


# ---- runs that leave the range --------------------------------------------------------------------------


def test_a_run_that_leaves_the_range_is_the_worst_and_can_be_stored(tmp_path):
    plant = replace(TOY, limits={"x": (-2.8, 10.0)})
    found = worst_plant(Search(plant, LAW, SCENARIO, [Limit("y", low=-3.0), Limit("u", high=2.0)], BOX, runs=200))
    assert found.excess == found.share == found.history[-1] == np.inf
    assert (found.bound, found.broken) == ("range", True)
    assert found.nominal < 0.0
    assert found.runs < 200  # nothing is worse: the search ends
    stored = found.counterexample("mine", {})
    stored.save(tmp_path / "c.json")
    loaded = load_counterexample(tmp_path / "c.json")
    again = loaded.replay(plant, LAW)
    assert again.same
    assert (again.excess, again.sample) == (np.inf, found.sample)
    assert len(again.run.experiment) == found.sample < 11
    assert "leaves the range" in loaded.sentence
    assert not loaded.replay(TOY, LAW).same  # a plant without that range


# ---- machines of the workbench --------------------------------------------------------------------------

ROBOT_LAW = pid(("u",), ("v",), ("v_set",), 0.02, Kp=[[6.0]], Ki=[[8.0]], low=(-4.0,), high=(4.0,))
COURSE = Manoeuvre(4.0, {"v": ((0.0, 0.0), (0.5, 0.4), (2.5, -0.3))}, seed=3)
ROBOT_SCENARIO = COURSE.scenario(WELDING_ROBOT, ROBOT_LAW)
ROBOT_LIMITS = (Limit("v", low=-0.5, high=0.42), Limit("v", band=0.02, settling=1.0), Limit("u", rate=200.0))
ROBOT_BOX = (
    *tolerance_box(WELDING_ROBOT),
    Dimension("level", 0.0, 0.3, effect="coulomb@rail"),
    Dimension("width", 1e-3, 0.05, effect="coulomb@rail"),  # needs more steps of the integrator where it is small
    Dimension("change", 0.0, 1.0, effect="platform-mass@rail"),
)


@pytest.fixture(scope="module")
def robot():
    return worst_plant(Search(WELDING_ROBOT, ROBOT_LAW, ROBOT_SCENARIO, ROBOT_LIMITS, ROBOT_BOX, runs=200, seed=2))


def test_a_search_finds_more_than_ten_times_as_many_random_machines(robot):
    random = at_random(Search(WELDING_ROBOT, ROBOT_LAW, ROBOT_SCENARIO, ROBOT_LIMITS, ROBOT_BOX, runs=2000, seed=2))
    assert robot.share > random.share > robot.nominal
    assert robot.share == robot.history[-1]  # confirmed by a run by itself, in the last bit


@pytest.mark.slow
def test_a_law_that_is_asked_step_by_step_gives_the_same_worst_machine():
    class Asked:
        def __init__(self):
            for name in ("name", "dt", "references", "measured", "schedule", "actuated", "init", "step"):
                setattr(self, name, getattr(ROBOT_LAW, name))

    asked = Search(WELDING_ROBOT, ROBOT_LAW, ROBOT_SCENARIO, ROBOT_LIMITS, ROBOT_BOX, runs=20)
    both = [worst_plant(replace(asked, controller=law)) for law in (ROBOT_LAW, Asked())]
    assert both[0].point == both[1].point
    np.testing.assert_allclose(both[0].history, both[1].history, rtol=1e-9)


def test_a_stored_counterexample_stands_alone_and_is_found_again(robot, tmp_path):
    path = robot.counterexample("welding-robot", content_of(ROBOT_LAW)).save(tmp_path / "c.json")
    stored = load_counterexample(path)
    law = controller_of(stored.controller, path)
    again = stored.replay(WELDING_ROBOT, law)
    assert again.same
    assert again.excess == stored.excess == robot.excess
    # what it says is what a person would find with the numbers in it
    by_hand = simulate(
        WELDING_ROBOT, law, ROBOT_SCENARIO, parameters=stored.parameters, effects=stored.effects, bumpless=True,
        substeps=stored.substeps,
    )  # fmt: skip
    assert by_hand.experiment[stored.limit.signal][stored.sample] == stored.value
    assert stored.time == pytest.approx(by_hand.experiment.t[stored.sample])
    assert stored.parameters.keys() == {q.name for q in WELDING_ROBOT.parameters}
    assert (stored.plant, stored.bumpless, stored.scenario.seed) == ("welding-robot", True, 3)


def test_what_a_plant_was_extended_by_is_in_the_file(tmp_path):
    extended = extension(WELDING_ROBOT, "welding-robot", {"b1": 0.5}, {"coulomb@rail": {"level": 0.2}}).of(WELDING_ROBOT)
    found = worst_plant(Search(extended, ROBOT_LAW, ROBOT_SCENARIO, ROBOT_LIMITS, tolerance_box(extended, ["m1"]), runs=5))
    assert found.effects["coulomb@rail"]["level"] == 0.2
    stored = found.counterexample("welding-robot", {})
    for plant in (WELDING_ROBOT, extended, replace(extended, effects={"arm-gravity@rail": {"sine": 1.0}})):
        assert stored.replay(plant, ROBOT_LAW).same
    with pytest.raises(InputError, match="is of plant 'welding-robot', not 'toy'"):
        stored.replay(TOY, ROBOT_LAW)
    with pytest.raises(InputError, match="no parameter b2"):
        replace(stored, parameters={k: v for k, v in stored.parameters.items() if k != "b2"}).replay(WELDING_ROBOT, ROBOT_LAW)


def test_an_effect_with_a_phase_is_tried_at_every_phase(tmp_path):
    """A diagnosis says its amplitude; the worst run of the box is that of the worst phase, found here by trying all of them."""
    estimate = {"value": 0.3, "low": 0.25, "high": 0.35, "unit": "N"}
    rest = {"order": {"value": 2.0, "low": 2.0, "high": 2.0, "unit": "1/turn"}}
    cause = {"effect": "torque-ripple", "at": "rail", "parameters": {"amplitude": estimate} | rest}
    path = tmp_path / "diagnosis.json"
    path.write_text(json.dumps({"causes": [cause], "recalibrated": {}}))
    box = fitted_box(WELDING_ROBOT, path)
    key = "torque-ripple@rail"
    assert [str(d) for d in box] == [f"{key}:amplitude", f"{key}:phase", f"{key}:order"]
    limit, scenario = Limit("v", high=0.3, unit="m/s"), Scenario("steps", {"v_set": np.repeat([0.0, 0.2], [50, 150])})
    found = worst_plant(Search(WELDING_ROBOT, ROBOT_LAW, scenario, [limit], box, runs=150, seed=1))
    size = found.effects[key]
    assert np.hypot(size["cosine"], size["sine"]) <= 0.35 * (1 + 1e-12)
    assert found.point[f"{key}:amplitude"] == pytest.approx(np.hypot(size["cosine"], size["sine"]))
    peaks = []
    for phase in np.linspace(-np.pi, np.pi, 60):
        sizes = {key: {"cosine": 0.35 * np.cos(phase), "sine": 0.35 * np.sin(phase), "order": 2.0}}
        peaks.append(simulate(WELDING_ROBOT, ROBOT_LAW, scenario, effects=sizes, bumpless=True).experiment["v"].max())
    assert found.excess + 0.3 >= max(peaks) - 0.02 * np.ptp(peaks)
    assert np.ptp(peaks) > 1e-3  # the phase matters


def test_intervals_of_a_diagnosis_or_a_calibration_are_a_box(tmp_path):
    estimate = {"value": 0.2, "low": -0.1, "high": 0.3, "unit": "N"}
    cause = {"effect": "coulomb", "at": "rail", "parameters": {"level": estimate}}
    path = tmp_path / "diagnosis.json"
    path.write_text(
        json.dumps({"causes": [cause], "recalibrated": {"b1": {"nominal": 0.3, "value": 0.4, "low": 0.35, "high": 0.45}}})
    )
    box = fitted_box(WELDING_ROBOT, path)
    assert [(str(d), d.low, d.high) for d in box] == [("b1", 0.35, 0.45), ("coulomb@rail:level", 0.0, 0.3)]  # within its bounds
    path.write_text(json.dumps({"parameters": {"m1": {"value": 1.0, "low": 0.9, "high": 1.1}}, "starts": {}}))
    assert [(str(d), d.low, d.high) for d in fitted_box(WELDING_ROBOT, path)] == [("m1", 0.9, 1.1)]
    path.write_text(json.dumps({"parameters": {"m9": {"value": 1.0, "low": 0.9, "high": 1.1}}, "starts": {}}))
    with pytest.raises(InputError, match="unknown parameter 'm9'"):
        fitted_box(WELDING_ROBOT, path)
    path.write_text(json.dumps({"parameters": {"m1": {"value": 1.0, "low": None, "high": 1.1}}, "starts": {}}))
    with pytest.raises(InputError, match="low of m1: None is not a finite number"):
        fitted_box(WELDING_ROBOT, path)
    extension(WELDING_ROBOT, "welding-robot", {}).save(path)
    with pytest.raises(InputError, match=r"diagnosis\.json or calibration\.json beside it"):
        fitted_box(WELDING_ROBOT, path)


# ---- files that were changed ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change",
    [
        lambda c: c["parameters"].update(m1=c["parameters"]["m1"] * (1 + 1e-6)),
        lambda c: c["effects"]["coulomb@rail"].update(level=0.1),
        lambda c: c.update(excess=c["excess"] * (1 + 1e-8)),
        lambda c: c.update(value=c["value"] * (1 - 1e-8)),
        lambda c: c.update(sample=c["sample"] - 1),
        lambda c: c.update(substeps=3),
        lambda c: c["scenario"].update(seed=4),
        lambda c: c["scenario"]["references"]["v_set"].__setitem__(30, 0.41),
        lambda c: c["limit"].update({"band": 0.03, "low": -0.52, "high": 0.45, "rate": 250.0}),
        lambda c: c["controller"].update(Kp=[[[6.1]]]),
    ],
)
def test_a_changed_number_is_noticed(robot, change):
    content = json.loads(json.dumps(_content(robot)))
    change(content)
    stored = _load(content)
    assert not stored.replay(WELDING_ROBOT, controller_of(stored.controller, "c.json")).same


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(schema="other"), "not a counterexample"),
        (lambda c: c.update(version=2), "version 2, this program reads 1"),
        (lambda c: c.pop("controller"), "field 'controller' is missing"),
        (lambda c: c.update(substeps=True), "field 'substeps'"),
        (lambda c: c.update(substeps=0), "out of range"),
        (lambda c: c.update(sample=10**6), "out of range"),
        (lambda c: c.update(excess=None), "excess: None is not a finite number"),
        (lambda c: c.update(bound="hihg"), "did you mean 'high'"),
        (lambda c: c["parameters"].update(m1="1"), "parameters, m1: '1' is not a finite number"),
        (lambda c: c["effects"].update({"coulomb@rail": 3.0}), "field 'coulomb@rail'"),
        (lambda c: c["scenario"].update(name="../c"), "is no name for a record"),
        (lambda c: c["scenario"]["references"].update(v_set=[0.0, None]), "v_set: None is not a finite number"),
        (lambda c: c["scenario"].update(disturbance={"u": [0.0]}), "different lengths"),
        (lambda c: c["scenario"].update(seed=-1), "out of range"),
        (lambda c: c["limit"].pop("signal"), "field 'signal'"),
    ],
)
def test_a_malformed_file_is_refused(robot, change, message):
    content = json.loads(json.dumps(_content(robot)))
    change(content)
    with pytest.raises(InputError, match=message):
        _load(content)


_FOLDER = {}


@pytest.fixture(autouse=True)
def _folder(tmp_path):
    _FOLDER["now"] = tmp_path


def _content(found):
    path = found.counterexample("welding-robot", content_of(ROBOT_LAW)).save(_FOLDER["now"] / "whole.json")
    return json.loads(path.read_text())


def _load(content):
    path = _FOLDER["now"] / "changed.json"
    path.write_text(json.dumps(content))
    return load_counterexample(path)
