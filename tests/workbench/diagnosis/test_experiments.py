"""The next experiment: its expected evidence against dense algebra and against runs that were made, and what is chosen by it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.workbench.diagnosis.cases import AXIS, ROBOT, axis_predictor, axis_records, fitted, refitted, robot_records, steps
from workbench.data import Dataset, Experiment
from workbench.diagnosis.experiments import (
    ENOUGH,
    MOST,
    RARE,
    SURE,
    Foreseen,
    Mimicry,
    Prospect,
    Template,
    deciding,
    foreseen,
    mimicry,
    once_more,
    otherwise,
    prospect,
    resolved,
)
from workbench.diagnosis.fit import gauss_newton
from workbench.diagnosis.recalibrate import unknowns
from workbench.diagnosis.refit import Model
from workbench.physics.controller import Playback
from workbench.simulation import Scenario, simulate

OFFSET, GAIN = "offset@F", "sensor-gain@q"
PLAYER = Playback(("F",), AXIS.dt)
PUSHES = Template("pushes", PLAYER, {"F": steps(250, 200.0, 77)})


def linear(data: Dataset, key: str) -> Model:
    """Only starts and the size of an effect are fitted: with held gains the errors are linear in both."""
    made = axis_predictor(data)
    own = unknowns(made, names=())
    base = Model(made, gauss_newton(made, own, own.zero(), np.zeros(len(AXIS.slots)), rounds=4, enough=1e-9))
    return refitted(base, key, [0.1], names=())


@cache
def rivals(level: float = 2.5) -> tuple[Dataset, Model, Model]:
    """Two records of an axis with an offset [N], and the models that name the offset and a gain of the sensor."""
    data = axis_records(1, {OFFSET: {"level": level}}, samples=200)
    return data, linear(data, OFFSET), linear(data, GAIN)


def errors_and_slopes(model: Model, made, i: int, start: np.ndarray):
    """(e, J): errors of record i of a predictor at a start and the model's size, and what a unit of start (2) and size adds."""
    at, (term,) = model.fit.point, model.terms
    scale = made.records[i].scale

    def errors(moved, size):
        eta = at.eta[0].copy()
        eta[list(term.sizes)] = size
        return made.errors(i, at.p[None], eta[None], (start + scale * moved)[None])[0].ravel()

    size = float(at.eta[0, term.sizes[0]])
    e = errors(np.zeros(2), size)
    unit = 1e-2 * size
    columns = [errors(unit_vector, size) - e for unit_vector in np.eye(2)] + [(errors(np.zeros(2), size + unit) - e) / unit]
    return e, np.column_stack(columns)


@pytest.mark.parametrize("runs", [1, 3])
def test_the_expected_gain_is_what_the_rival_loses_at_least_on_old_and_new_records_together(runs):
    """Dense least squares over the starts of all records and one size: nothing of the module's algebra."""
    _, true, rival = rivals()
    run = PUSHES.run(true)
    made = axis_predictor(Dataset((run,)))
    start = made.records[0].start
    e, _ = errors_and_slopes(true, made, 0, start)
    e_rival, J = errors_and_slopes(rival, made, 0, start)
    old = len(true.predictor.records)
    n = 2 * (old + runs) + 1
    rows, wanted = [np.eye(n)[:-1]], [np.zeros(n - 1)]  # starts are known to within their scale, the size is not
    for i in range(old):
        _, J_old = errors_and_slopes(rival, rival.predictor, i, rival.fit.point.start[i])
        rows.append(np.zeros((len(J_old), n)))
        rows[-1][:, [2 * i, 2 * i + 1, n - 1]] = J_old
        wanted.append(np.zeros(len(J_old)))
    for k in range(old, old + runs):
        rows.append(np.zeros((len(J), n)))
        rows[-1][:, [2 * k, 2 * k + 1, n - 1]] = J
        wanted.append(e_rival - e)
    A, b = np.concatenate(rows), np.concatenate(wanted)
    left = b - A @ np.linalg.lstsq(A, b, rcond=None)[0]
    assert foreseen(true, rival, run).gain(runs) == pytest.approx(float(left @ left), rel=1e-3)
    assert left @ left > 5.0


@pytest.mark.slow
def test_the_expected_gain_is_reached_by_runs_that_are_made():
    data, true, rival = rivals()
    level = float(true.fit.point.eta[0, true.terms[0].sizes[0]])
    expected = mimicry(true, [rival], PUSHES).gain(1)
    before, reached = rival.deviance - true.deviance, []
    for seed in range(12):
        scenario = Scenario("made", PUSHES.references, seed=900 + seed)
        run = simulate(AXIS, PLAYER, scenario, effects={OFFSET: {"level": level}}, substeps=8).experiment
        both = Dataset((*data, run))
        reached.append(linear(both, GAIN).deviance - linear(both, OFFSET).deviance - before)
    assert np.std(reached) == pytest.approx(2.0 * np.sqrt(expected), rel=0.5)
    assert abs(np.mean(reached) - expected) < 3.0 * 2.0 * np.sqrt(expected / len(reached))


def test_what_the_records_already_tell_of_the_rival_adds_to_the_evidence():
    """Ten times the records leave the rival less to make up with; infinitely vague ones leave it everything."""
    _, true, rival = rivals()
    run = PUSHES.run(true)
    vague = Model(rival.predictor, replace(rival.fit, jacobian=tuple(1e-3 * J for J in rival.fit.jacobian)))
    sharp = Model(rival.predictor, replace(rival.fit, jacobian=tuple(np.sqrt(10.0) * J for J in rival.fit.jacobian)))
    gains = [foreseen(true, m, run).gain(1) for m in (vague, rival, sharp)]
    assert gains == sorted(gains)
    assert gains[2] > 1.01 * gains[1] > 1.01**2 * gains[0]


def test_more_runs_gain_more_and_at_most_in_proportion():
    _, true, rival = rivals()
    gains = [foreseen(true, rival, PUSHES.run(true)).gain(n) for n in (1, 2, 4)]
    assert gains[0] < gains[1] < gains[2]
    assert gains[1] < 2.0 * gains[0]
    assert gains[2] < 2.0 * gains[1]


@pytest.mark.parametrize(
    ("gap", "forth", "back"), [(0.0, 10.0, 10.0), (3.0, 30.0, 14.0), (6.0, 2.0, 60.0), (14.0, 5.0, 9.0), (-30.0, 9.0, 4.0)]
)
def test_the_probability_that_a_tie_is_resolved_is_that_of_gaps_that_are_drawn(gap, forth, back):
    random = np.random.default_rng(5)
    first = random.random(200_000) < 1.0 / (1.0 + np.exp(-gap / 2.0))
    mean = np.where(first, forth, back)
    start = np.clip(np.where(first, gap, -gap), -ENOUGH, ENOUGH)  # beyond that it was declared a tie as it is
    after = start + mean + 2.0 * np.sqrt(mean) * random.standard_normal(len(mean))
    assert resolved(gap, forth, back) == pytest.approx(np.mean(after > ENOUGH), abs=0.005)


def test_an_experiment_that_shows_nothing_resolves_nothing():
    assert resolved(9.0, 0.0, 0.0) == pytest.approx(0.0, abs=1e-9)
    assert resolved(0.0, ENOUGH, ENOUGH) == pytest.approx(0.5)


@pytest.mark.parametrize("gap", [-60.0, -20.0, -12.0, -9.0, 0.0, 9.0, 12.0, 20.0, 60.0])
def test_a_tie_of_any_gap_is_not_decided_by_a_run_that_shows_nothing(gap):
    nothing = told(0.0)
    assert Prospect(gap, nothing, nothing).runs is None
    assert Prospect(gap, told(0.5), told(0.5)).runs is None  # MOST runs, 4 in all
    assert Prospect(gap, told(60.0), told(60.0)).runs == 1


def told(*gains: float, excess=None) -> Mimicry:
    """What a run tells apart by each way, with nothing to make up with."""
    ways = tuple(Foreseen(gain, np.zeros(1), np.zeros((1, 1))) for gain in gains)
    return Mimicry(ways, np.zeros(len(gains)) if excess is None else np.array(excess))


def test_a_way_to_mimic_a_cause_is_as_good_as_what_it_shows_and_what_it_costs_in_the_old_records():
    assert told(5.0, 1.0, excess=[0.0, 2.5]).gain(1) == 3.5
    assert told(5.0, 1.0, excess=[0.0, 2.5]).gain(2) == 4.5
    assert told(5.0, 1.0, excess=[0.0, 30.0]).gain(4) == 20.0
    _, true, rival = rivals()
    worse = Model(rival.predictor, replace(rival.fit, errors=tuple(e + 0.1 for e in rival.fit.errors)))
    assert worse.deviance > rival.deviance + 1.0
    np.testing.assert_allclose(mimicry(true, [rival, worse], PUSHES).excess, [0.0, worse.deviance - rival.deviance])


def test_a_further_run_does_not_know_a_phase_and_tells_no_models_apart_that_differ_in_it():
    """Each record of an imbalance begins at another angle: a quarter of a turn more is nothing to a new run."""
    each = [{"imbalance@slide": {"cosine": 8.0 * np.cos(turn), "sine": 8.0 * np.sin(turn)}} for turn in (0.4, 2.0)]
    true = refitted(fitted(axis_records(4, each)), "imbalance@slide", [6.0, 2.0], rounds=12)
    at = true.fit.unknowns.size - true.fit.unknowns.split[2]
    z = true.fit.z.copy()
    z[[at, at + 1]] = -z[at + 1], z[at]
    turned = Model(true.predictor, replace(true.fit, z=z))
    run = PUSHES.run(true)
    made = axis_predictor(Dataset((run,)))
    p, eta = (np.array([getattr(m.fit.point, name) for m in (true, turned)]) for name in ("p", "eta"))
    e = made.errors(0, p, eta[:, 0], made.records[0].start[None])
    assert np.sum((e[1] - e[0]) ** 2) > 100.0  # and yet, at one phase they differ much
    assert foreseen(true, turned, run).gain(1) < 0.1


@pytest.mark.slow
def test_the_shortest_time_that_is_sure_to_decide_is_chosen():
    """Of one long record, several short ones at rest or in slow motion."""
    _, true, rival = rivals(0.7)
    t = AXIS.dt * np.arange(110)
    templates = (
        Template("long", PLAYER, {"F": 150.0 * np.sin(3.0 * AXIS.dt * np.arange(1500))}),
        Template("still", PLAYER, {"F": np.zeros(90)}),
        Template("weak", PLAYER, {"F": 100.0 * np.sin(3.0 * t)}),
    )
    found = deciding(true, rival, (OFFSET, GAIN), templates, "Look.")
    assert found is not None
    gap, times = rival.bic - true.bic, {}
    odds = 1.0 / (1.0 + np.exp(-gap / 2.0))
    for template in templates:
        forth, back = mimicry(true, [rival], template), mimicry(rival, [true], template)
        back = Mimicry((), np.empty(0)) if 1.0 - odds < RARE else back
        gains = [(forth.gain(n), back.gain(n) if back.ways else 0.0) for n in range(1, MOST + 1)]
        assert found.expected[template.name] == pytest.approx(odds * gains[0][0] + (1.0 - odds) * gains[0][1])
        sure = [n for n in range(1, MOST + 1) if resolved(gap, *gains[n - 1]) >= SURE]
        if sure:
            times[len(template) * sure[0]] = template.name, sure[0]
    assert len(times) == 3
    name, runs = times[min(times)]
    assert runs > 1
    assert found.runs == runs
    assert f"{runs} runs of {name!r}" in found.sentence
    np.testing.assert_array_equal(found.signals["F"], next(x for x in templates if x.name == name).references["F"])


def test_no_experiment_is_recommended_between_forces_that_are_one_and_the_same():
    base = fitted(robot_records(3, {"offset@u": {"level": 0.3}}))
    models = [refitted(base, key, [0.2]) for key in ("offset@u", "rail-tilt@rail")]
    moves = Template("moves", Playback(("u", "arm"), ROBOT.dt), {"u": steps(400, 3.0, 1), "arm": np.sin(0.02 * np.arange(400))})
    found = deciding(*models, ("offset@u", "rail-tilt@rail"), (moves,), "A stop shows it.")
    assert found is not None
    assert found.signals == {}
    assert found.expected["moves"] < 0.1
    assert "A stop shows it." in found.sentence


DRY, FADING = "coulomb@slide", "stribeck@slide"


@cache
def frictions() -> tuple[Model, Model]:
    """Models of a dry friction, and of one that fades at a speed which is fitted."""
    base = fitted(axis_records(9, {DRY: {"level": 6.0}}))
    true, rival = (refitted(base, key, [5.0]) for key in (DRY, FADING))
    i = next(i for i, slot in enumerate(AXIS.slots) if (slot.key, slot.parameter.name) == (FADING, "speed"))
    (t,) = rival.fit.unknowns.terms
    shaped = replace(rival.fit.unknowns, terms=(replace(t, free=(i,)),))
    return true, Model(
        rival.predictor, gauss_newton(rival.predictor, shaped, np.append(rival.fit.z, 0.0), otherwise_steps(rival))
    )


def test_a_friction_that_fades_at_a_speed_that_no_run_reaches_is_plain_friction():
    """Where the rival was fitted it fades; a run would refute that, and then it would no longer fade: nothing is decided."""
    true, rival = frictions()
    ways = otherwise(rival, FADING)
    assert len(ways) > 1
    near, far = mimicry(true, [rival], PUSHES), mimicry(true, ways, PUSHES)
    assert far.gain(MOST) <= near.gain(MOST)
    assert far.gain(MOST) < ENOUGH
    assert [w.fit.unknowns.terms[0].free for w in ways[1:]] == [()] * (len(ways) - 1)


def test_no_run_is_recommended_that_the_rival_would_survive_with_another_shape():
    true, rival = frictions()
    swings = Template("swings", PLAYER, {"F": 900.0 * np.sin(1.2 * np.pi * AXIS.dt * np.arange(1000))})
    first = prospect([true], [rival], swings)
    assert first.runs  # of the shape that was fitted, repeated runs would be enough
    found = deciding(true, rival, (DRY, FADING), (swings,), "Look.")
    assert found is not None
    assert found.signals == {}
    assert found.expected["swings"] < 0.1 * first.expected(1)


@pytest.fixture
def judged(monkeypatch):
    """judged(gains) lets a run of a template tell what `gains` says by name: (as fitted, with other shapes)."""

    def judge(gains):
        monkeypatch.setattr("workbench.diagnosis.experiments.otherwise", lambda model, key: [model, model])
        monkeypatch.setattr("workbench.diagnosis.experiments.mimicry", lambda _, ways, x: told(gains[x.name][len(ways) > 1]))
        _, true, rival = rivals(0.7)
        templates = [Template(name, PLAYER, {"F": steps(60 + i, 100.0, i)}) for i, name in enumerate(gains)]
        return deciding(true, rival, (OFFSET, GAIN), templates, "Look.")

    return judge


def test_templates_are_looked_at_until_one_decides_and_what_was_seen_of_them_is_said(judged):
    seeming = {f"seems {i}": (200.0, 0.1 * i) for i in range(6)}
    found = judged({**seeming, "decides": (200.0, 150.0), "later": (200.0, 120.0)})
    assert "one run of 'decides'" in found.sentence
    odds = found.expected["later"] / 200.0  # the rival is so unlikely that it is not asked what a run would show if it were true
    assert 0.9 < odds < 1.0
    after = {name: gain for name, (_, gain) in seeming.items()} | {"decides": 150.0, "later": 200.0}
    assert found.expected == pytest.approx({name: odds * gain for name, gain in after.items()})
    none = judged(seeming)
    assert none.signals == {}
    assert max(none.expected.values()) < 1.0
    assert none.sentence.endswith("Look.")


def test_the_time_that_counts_is_that_with_other_shapes(judged):
    """The first seems to decide in one run and needs several; the second needs one, a sample longer."""
    found = judged({"several": (200.0, 2.0), "one": (200.0, 200.0)})
    assert "one run of 'one'" in found.sentence
    assert "runs of 'several'" in judged({"several": (200.0, 2.0)}).sentence


def otherwise_steps(model: Model) -> np.ndarray:
    sizes = np.zeros(len(AXIS.slots))
    sizes[list(model.terms[0].sizes)] = 1e-2
    return sizes


def test_a_record_made_once_more_follows_its_set_points_and_is_judged_along_itself():
    (made,) = axis_records(4, records=1)
    assert list(once_more(AXIS, made).references) == ["F"]
    closed = Experiment.from_arrays(
        "closed", ROBOT.dt, inputs={"u": np.ones(50)}, outputs={"v": np.ones(50)}, schedule={"arm": np.zeros(50)},
        references={"v_set": np.full(50, 2.0)}, units={},
    )  # fmt: skip
    template = once_more(ROBOT, closed)
    assert list(template.references) == ["v_set", "arm"]
    assert template.run(rivals()[1]) is closed
    data, true, rival = rivals()
    once = once_more(AXIS, data.experiments[0])
    assert mimicry(true, [rival], once).gain(1) == foreseen(true, rival, data.experiments[0]).gain(1)


def test_a_template_that_the_machine_cannot_run_is_left_out():
    _, true, rival = rivals()
    unknown = Template("unknown loop", None, PUSHES.references)
    assert deciding(true, rival, (OFFSET, GAIN), (), "") is None
    none = deciding(true, rival, (OFFSET, GAIN), (unknown,), "A stop shows it.")
    assert none is not None
    assert (none.signals, none.expected) == ({}, {})
    assert none.sentence.endswith("none can be run and stays where the machine has been seen. A stop shows it.")
    found = deciding(true, rival, (OFFSET, GAIN), (unknown, PUSHES), "")
    assert found is not None
    assert set(found.expected) == {"pushes"}


def test_an_experiment_that_would_take_the_axis_where_it_has_never_been_is_not_recommended():
    """It would decide best of all, into the stop at the end of the way."""
    data, true, rival = rivals()
    away = Template("away", PLAYER, {"F": np.full(600, 300.0)})
    assert foreseen(true, rival, away.run(true)).gain(1) > 30.0
    assert np.abs(away.run(true)["q"]).max() > 2.0 * max(np.abs(e["q"]).max() for e in data)
    found = deciding(true, rival, (OFFSET, GAIN), (away, once_more(AXIS, data.experiments[0])), "")
    assert found is not None
    assert set(found.expected) == {"axis 0 once more"}
