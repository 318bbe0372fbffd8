"""Identification over a schedule that is the output: a tank and an arm that are integrated here, with noise.

Models must beat the best linear one in free run on a record that no fit has seen, and the poles of their linearisations must be
those of the machine; what is measured after the warm-up may not reach a free run, nor what a fit is chosen by.
"""

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from workbench.basis import PiecewiseLinear, Powers
from workbench.data import Dataset, Experiment
from workbench.errors import InputError
from workbench.identification import METHODS
from workbench.identification.criterion import ByCriterion
from workbench.identification.ilm import ILM
from workbench.identification.leaks import leaks
from workbench.identification.lti import LTI
from workbench.identification.selection import choose
from workbench.identification.ssm import SSM, ScheduledMean
from workbench.intervals.regression import BySchedule, IntervalRegression, OneMode
from workbench.lpv import load_model
from workbench.metrics import fit, score
from workbench.sources import read

DATA = Path(__file__).resolve().parents[4] / "shared" / "data" / "real"

TANK_DT, AREA = 0.5, 10.0
ARM_DT, WEIGHT, DAMPING, PUSH = 0.05, 20.0, 4.0, 20.0


def held(random, N, stay, low, high):
    """Levels that stay for so many samples."""
    return np.repeat(random.uniform(low, high, -(-N // stay)), stay)[:N]


@cache
def tank(seed: int, N: int = 1200) -> Experiment:
    """AREA h' = u - sqrt(h), the level read with 2 mm of noise."""
    random = np.random.default_rng(seed)
    u, h, level = held(random, N, 60, 0.25, 1.1), 0.3, np.empty(N)
    for k in range(N):
        level[k] = h
        for _ in range(20):
            h += TANK_DT / 20 / AREA * (u[k] - np.sqrt(h))
    level += 0.002 * random.normal(size=N)
    units = {"u": "m3/s", "level": "m"}
    own = {"level": level}
    return Experiment.from_arrays(f"tank {seed}", TANK_DT, inputs={"u": u}, outputs=own, schedule=own, units=units)


@cache
def arm(seed: int, N: int = 1500) -> Experiment:
    """theta'' = PUSH u - WEIGHT sin(theta) - DAMPING theta', the angle read with 2 mrad of noise."""
    random = np.random.default_rng(seed)
    u, theta, rate, angle = np.sin(held(random, N, 40, 0.1, 1.35)), 0.7, 0.0, np.empty(N)
    for k in range(N):
        angle[k] = theta
        for _ in range(20):
            rate += ARM_DT / 20 * (PUSH * u[k] - WEIGHT * np.sin(theta) - DAMPING * rate)
            theta += ARM_DT / 20 * rate
    own = {"theta": angle + 0.002 * random.normal(size=N)}
    return Experiment.from_arrays(f"arm {seed}", ARM_DT, inputs={"u": u}, outputs=own, schedule=own, units={"theta": "rad"})


def tank_poles(h: float) -> np.ndarray:
    return np.array([np.exp(-TANK_DT / (2.0 * AREA * np.sqrt(h)))])


def arm_poles(theta: float) -> np.ndarray:
    return np.linalg.eigvals(expm(ARM_DT * np.array([[0.0, 1.0], [-WEIGHT * np.cos(theta), -DAMPING]])))


@cache
def fitted(machine, method):
    return method.fit(Dataset((machine(1), machine(2))))


SMALL = SSM(orders=(1, 2, 3))


def largest(poles: np.ndarray, count: int) -> np.ndarray:
    """The slowest poles, by their real part and the size of their imaginary part."""
    slowest = poles[np.argsort(-np.abs(poles))][:count]
    return np.array([slowest.real.mean(), np.abs(slowest.imag).mean()])


def free_run(model, machine) -> float:
    return next(s.RMSE for s in score(model, Dataset((machine(3),)), "held-out", ["free-run"]))


# ---- machines -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("machine", [tank, arm])
def test_models_over_their_own_output_run_better_than_the_best_linear_one(machine):
    linear = free_run(fitted(machine, LTI()), machine)
    assert fitted(machine, LTI()).schedule is None
    assert free_run(fitted(machine, SMALL), machine) < 0.25 * linear
    assert free_run(fitted(machine, ILM(order=2, resamples=0)), machine) < 0.85 * linear


@pytest.mark.parametrize(
    ("machine", "truth", "places", "near"),
    [(tank, tank_poles, (0.2, 0.4, 0.6, 0.8), 0.008), (arm, arm_poles, (0.6, 0.9, 1.2), 0.02)],
)
def test_the_linearisation_has_the_machines_poles_and_the_frozen_model_has_not(machine, truth, places, near):
    model = fitted(machine, SMALL)
    for rho in places:
        expected = truth(rho)
        away, frozen_away = (
            np.abs(largest(model.to_control(rho, frozen=still).poles(), len(expected)) - largest(expected, len(expected))).max()
            for still in (False, True)
        )
        assert away < near
        assert frozen_away > 3.0 * away
    assert model.stability().stable


def test_the_notes_say_what_the_frozen_model_leaves_out():
    model = fitted(tank, SMALL)
    (coupling,) = [note for note in model.notes if note.startswith("hidden coupling")]
    low, high = model.span
    frozen, true = (np.abs(model.to_control(0.5 * (low + high), frozen=still).poles()).max() for still in (True, False))
    assert f"{frozen:.4g} and {true:.4g} at {0.5 * (low + high):.4g} m" in coupling
    assert "the schedule level is an output: free runs schedule themselves" in model.notes


# ---- nothing measured reaches a free run -----------------------------------------------------------------------------------


@pytest.mark.parametrize("machine", [tank, arm])
@pytest.mark.parametrize("method", [SMALL, ILM(order=2, resamples=0)])
def test_the_output_after_the_warm_up_moves_no_free_run_by_a_bit(machine, method):
    model, e = fitted(machine, method), machine(3)
    values = e.values.copy()
    values[model.warmup :, 1] = np.random.default_rng(0).normal(size=len(e) - model.warmup)
    other = dataclasses.replace(e, values=values)
    np.testing.assert_array_equal(model.simulate(other), model.simulate(e))
    far = model.warmup + 25
    np.testing.assert_array_equal(model.predict(other, 25)[:far], model.predict(e, 25)[:far])


def recursion(theta, n, problem_free, u, y, start):
    """y(k) = sum_i f_i(y(k-n)) y(k-i) + g_i(y(k-i)) u(k-i) along itself, written out for one input and output."""
    basis, span, y0 = problem_free
    f, g = theta[0, :n], theta[0, n : 2 * n]
    y = y.copy()
    phi = [basis(np.clip(v, *span)) for v in y[:start]]
    for k in range(start, len(y)):
        y[k] = y0 + sum(f[i - 1] @ phi[k - n] * (y[k - i] - y0) + g[i - 1] @ phi[k - i] * u[k - i] for i in range(1, n + 1))
        phi.append(basis(np.clip(y[k], *span)))
    return y


def test_ssm_chooses_by_the_free_run_along_its_own_output():
    data, method = Dataset((tank(1),)), SSM(orders=(1, 2), feedthrough=False)
    model, e, start = method.fit(data), tank(1), 2
    assert len(method.sweep(data, Dataset((tank(2),))).path) > 4
    for candidate in method.sweep(data, Dataset((tank(2),))).path:
        parts = model.basis, model.span, model.operating_point.y[0, 0]
        for e, expected in ((tank(1), candidate.fit), (tank(2), candidate.held_out)):
            run = recursion(candidate.theta, candidate.order, parts, e["u"], e["level"], start)
            assert fit(e["level"][start:], run[start:]) == pytest.approx(expected, abs=1e-6)


def test_ilm_chooses_by_the_free_run_along_its_own_output():
    method = ILM(models=3, order=1, resamples=0)
    model = fitted(tank, method)
    data = Dataset((tank(1), tank(2)))
    best = max(method.candidates(data), key=lambda c: c.FIT)
    outside = dataclasses.replace(model, schedules=(dataclasses.replace(model.schedule, role="schedule"),))
    own, given = (np.mean([s.FIT for s in score(m, data, "estimation", ["free-run"])]) for m in (model, outside))
    assert pytest.approx(own, abs=1e-6) == best.FIT
    assert abs(given - own) > 0.1  # that of a run along the measured level is another one


# ---- one model, many ways --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("basis", [PiecewiseLinear([0.0, 0.3, 0.6, 1.2]), Powers([0.0, 0.5, -0.5], scale=0.5)])
def test_other_bases_serve_too(basis):
    model = fitted(tank, SSM(order=1, basis=basis))
    assert model.linearise(0.5)[0][0, 0] == pytest.approx(tank_poles(0.5)[0], abs=0.006)
    assert free_run(model, tank) < 0.5 * free_run(fitted(tank, LTI()), tank)


@pytest.mark.parametrize("method", [SMALL, ILM(order=2, resamples=0)])
def test_the_file_gives_the_same_free_runs_and_poles(method, tmp_path):
    model = fitted(tank, method)
    model.save(tmp_path / "m.json")
    again = load_model(tmp_path / "m.json")
    np.testing.assert_array_equal(again.simulate(tank(3)), model.simulate(tank(3)))
    np.testing.assert_array_equal(again.linearise(0.5)[0], model.linearise(0.5)[0])
    assert again.schedule.role == "scheduled output"


def test_roles_are_named_in_python_in_every_way(tmp_path):
    e = tank(1)
    table = {"t": e.t, "u": e["u"], "level": e["level"]}
    np.savetxt(tmp_path / "r.csv", np.column_stack(list(table.values())), delimiter=",", header="t,u,level", comments="")
    bare = dataclasses.replace(e, channels=tuple(dataclasses.replace(c, role="other") for c in e.channels))
    made = [
        e,
        read(str(tmp_path / "r.csv"), inputs="u", outputs="level", schedule="level").experiments[0],
        bare.with_roles(["u"], ["level"], ["level"]),
        bare.with_roles("u", "level", "level"),
        Dataset((bare,)).with_roles(["u"], ["level"], ["level"]).experiments[0],
    ]
    for own in made:
        assert own.channel("level").role == "scheduled output"
        assert (own.names_of("input"), own.names_of("output"), own.names_of("schedule")) == (("u",), ("level",), ("level",))
    assert e.with_roles(outputs=["level"]).names_of("schedule") == ()
    assert e.with_roles(schedule=["u"]).channel("level").role == "output"


def test_two_outputs_one_of_which_is_the_schedule():
    """The arm's rate beside its angle, from a tachometer of its own: both run free along the angle."""
    e = arm(1)
    rate = np.gradient(e["theta"], ARM_DT) + 0.02 * np.random.default_rng(0).normal(size=len(e))
    both = Experiment.from_arrays(
        "both", ARM_DT, inputs={"u": e["u"]}, outputs={"rate": rate, "theta": e["theta"]}, schedule={"theta": e["theta"]}
    )
    model = SSM(order=2, feedthrough=False).fit(Dataset((both,)))
    assert [c.name for c in model.outputs] == ["rate", "theta"]
    assert model.scheduled_output == 1
    assert fit(e["theta"][2:], model.simulate(both)[2:, 1]) > 95.0


def test_the_choice_of_a_method_takes_it_up():
    methods = {"lti": METHODS["lti"](), "ssm": SMALL}
    assert choose(methods, Dataset((tank(1), tank(2)))).method == "ssm"


def test_a_refinement_follows_the_schedule_that_its_own_run_computes():
    data, fresh = Dataset((tank(1),)), tank(2)
    plain, asked = (ByCriterion(SSM(order=1), criterion).fit(data) for criterion in ("prediction", "simulation"))
    assert asked.notes[-1] == "refined by the error of its free runs"
    own, new = ([fit(e["level"][5:], model.simulate(e)[5:, 0]) for model in (plain, asked)] for e in (data.experiments[0], fresh))
    assert own[1] >= own[0]
    assert new[1] > new[0] - 0.5


# ---- leaks and what is refused ------------------------------------------------------------------------------------------------


def test_a_declared_output_is_no_leak_and_a_copy_of_it_is():
    e = tank(1)
    assert leaks(Dataset((e,))) == ()
    late = np.concatenate([e["level"][:1], e["level"][:-1]])
    for copy in (e["level"].copy(), late):
        other = Experiment.from_arrays(
            "copied", TANK_DT, inputs={"u": e["u"]}, outputs={"level": e["level"]}, schedule={"copy": copy}
        )
        (sentence,) = leaks(Dataset((other,)))
        assert sentence.startswith("schedule copy is output level")
        assert "name level itself as schedule" in sentence
    given = Experiment.from_arrays(
        "given", TANK_DT, inputs={"u": e["u"], "copy": late}, outputs={"level": e["level"]}, schedule={"level": e["level"]}
    )
    assert "input copy is output level" in leaks(Dataset((given,)))[0]


@pytest.mark.parametrize(
    ("roles", "said"),
    [
        ({"inputs": ["u"], "outputs": ["level"], "schedule": ["u"]}, "channel u: is named as input and as schedule"),
        ({"inputs": ["level"], "outputs": ["level"]}, "channel level: is named as input and as output"),
        ({"inputs": ["level"], "outputs": ["level"], "schedule": ["level"]}, "channel level: is named as input and as output"),
    ],
)
def test_other_pairs_of_roles_are_refused(roles, said):
    with pytest.raises(InputError, match=said) as reason:
        tank(1).with_roles(**roles)
    assert reason.value.mend == "name it once: only an output may be the schedule as well"


def test_an_output_and_a_schedule_of_one_name_and_other_numbers_are_refused():
    with pytest.raises(InputError, match="channel y: is output and schedule with other numbers"):
        Experiment.from_arrays("r", 0.1, inputs={"u": np.ones(3)}, outputs={"y": np.ones(3)}, schedule={"y": np.zeros(3)})


def test_what_would_leave_nothing_to_model_is_refused():
    with pytest.raises(InputError, match="channel level: the mean output at every value of an output is that value"):
        SSM(order=1, operating_point=ScheduledMean()).fit(Dataset((tank(1),)))


def test_an_interval_model_chooses_no_box_by_the_measured_output():
    data = Dataset((tank(1, 300),))
    with pytest.raises(InputError, match="channel level: is output and schedule"):
        IntervalRegression(partition=BySchedule(2)).fit(data)
    assert IntervalRegression(partition=OneMode()).fit(data).schedule is None


# ---- measured machines ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="no measured records beside the checkout (../shared/data)")
@pytest.mark.parametrize(
    ("estimation", "held_out", "output", "most"),
    [
        (("cascaded_tanks/est",), "cascaded_tanks/val", "y", 0.56),  # V; LTI 0.60
        (
            ("quarter_drone/steps", "quarter_drone/multisine", "quarter_drone/semistatic"),
            "quarter_drone/swept",
            "angle",
            5.0,
        ),  # deg
    ],
)
def test_measured_machines_over_their_own_output(estimation, held_out, output, most):
    roles = {"inputs": "u", "outputs": output, "schedule": output}
    own, other = read(*[DATA / f"{name}.csv" for name in estimation], **roles), read(DATA / f"{held_out}.csv", **roles)
    missed = {}
    for name, method in (("lti", LTI()), ("ssm", SSM())):
        (only,) = score(method.fit(own), other, "held-out", ["free-run"])
        missed[name] = only.RMSE
    assert missed["ssm"] < min(most, missed["lti"])
