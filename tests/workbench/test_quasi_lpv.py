"""Models that are scheduled on their own output, against their equations written out and against what may not leak into them."""

import dataclasses
import json

import numpy as np
import pytest

from controllers.designs import MPCDesign, ScheduledPIDDesign
from controllers.observer import design_observer
from controllers.pid import pid
from controllers.rules import fotd
from workbench.answers.check import check
from workbench.basis import CONSTANT, Gaussian, PiecewiseLinear, Powers
from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.lpv import LPVModel, OperatingPoint, Predictor, Term, constant_model, load_model
from workbench.physics.identified import identified
from workbench.quasi_lpv import OwnRuns, equilibrium
from workbench.rehearsal import rehearsal
from workbench.robustness.frozen import closed_loop
from workbench.robustness.machine import machine_with_errors

U = (Channel("u1", "V", "input"), Channel("u2", "", "input"))
LEVEL, OTHER = Channel("level", "m", "scheduled output"), Channel("w", "", "output")
BASES = {
    "powers": Powers([0.0, 1.0, 2.0], scale=2.0),
    "gaussian": Gaussian([0.0, 1.5, 3.0], [1.0, 1.0, 1.0], normalised=True),
    "piecewise": PiecewiseLinear([0.0, 1.4, 3.0]),
}
WARM = 6


def drawn(basis, seed=0) -> LPVModel:
    """A stable model of order 3 with delays, a scheduled C, and an operating point that moves."""
    random = np.random.default_rng(seed)
    terms = tuple(Term(j, d) for j in range(3) for d in range(3))
    A, B, C = (0.03 * random.normal(size=(9, *shape)) for shape in ((3, 3), (3, 2), (2, 3)))
    powers = isinstance(basis, Powers)
    A[[0] if powers else [0, 3, 6]] += 0.5 * np.diag([1.0, 0.6, -0.4])  # the constant 1 is one function, or the sum of all
    B, C = 10.0 * B, C + np.eye(2, 3) * 0.3
    K = 0.1 * random.normal(size=(9, 3, 2))
    y0 = [[1.2, 0.0], [0.1, 0.2], [-0.1, 0.1]] if powers else [[1.2, 0.0], [1.3, 0.2], [1.1, 0.1]]
    point = OperatingPoint(basis, 0.1 * random.normal(size=(3, 2)), np.array(y0))
    return LPVModel(
        "own", 0.1, U, (dataclasses.replace(LEVEL, role="output"), OTHER), (LEVEL,), [[0.0, 3.0]], basis, terms,
        A, B, C, 0.01 * random.normal(size=(9, 2, 2)), point, Predictor(A, B, K, warmup=WARM),
    )  # fmt: skip


def record(N=80, seed=1) -> Experiment:
    random = np.random.default_rng(seed)
    u, level, w = random.normal(size=(N, 2)), 1.5 + 0.8 * random.normal(size=N), random.normal(size=N)
    return Experiment.from_arrays(
        "r", 0.1, inputs={"u1": u[:, 0], "u2": u[:, 1]}, outputs={"level": level, "w": w}, schedule={"level": level},
        units={"level": "m", "u1": "V"},
    )  # fmt: skip


def matrices(model, line, terms_from):
    """M(k) of the schedule values `line`, newest first; a term of delay d reads line[max(d, terms_from) - terms_from]."""
    weight = [model.basis(np.array(line[max(t.delay, terms_from) - terms_from]))[t.function] for t in model.terms]
    return [sum(w * M for w, M in zip(weight, own, strict=True)) for own in (model.A, model.B, model.C, model.D)]


def written_out(model, u, x, past):
    """The free run from state x, where the schedule was `past` (newest first) before it."""
    (low, high), point, out, past = model.span, model.operating_point, [], list(past)
    for v in u:
        phi = point.basis(np.array(past[0]))
        _, _, C, D = matrices(model, past, 1)
        y = C @ x + D @ (v - phi @ point.u) + phi @ point.y
        past = [min(max(y[0], low), high), *past]
        A, B, _, _ = matrices(model, past, 0)
        x = A @ x + B @ (v - point.basis(np.array(past[0])) @ point.u)
        out.append(y)
    return np.array(out)


def without_leak(model, run, e, changes):
    """`run` of the record, and of records whose outputs are other ones from the samples `changes` on; bit by bit."""
    first = run(model, e)
    columns = [e.names.index(name) for name in ("level", "w")]
    for k in changes:
        values = e.values.copy()
        values[k:, columns] = np.random.default_rng(9).normal(size=(len(e) - k, 2)) * 40.0
        yield k, first, run(model, dataclasses.replace(e, values=values))


# ---- free runs and predictions --------------------------------------------------------------------------------------


@pytest.mark.parametrize("basis", BASES.values(), ids=BASES)
def test_a_free_run_is_its_equations_along_its_own_output(basis):
    model, e = drawn(basis), record()
    x = model._states(*[a[:WARM] for a in model.deviations(e)])[-1]
    past = np.clip(e["level"][WARM - 1 :: -1], *model.span)
    expected = written_out(model, e[["u1", "u2"]][WARM:], x, past)
    np.testing.assert_allclose(model.simulate(e)[WARM:], expected, rtol=1e-10, atol=1e-10)
    assert np.ptp(expected[:, 0]) > 0.1


@pytest.mark.parametrize("basis", BASES.values(), ids=BASES)
@pytest.mark.parametrize("warmup", [None, 0, 11])
def test_no_measured_output_leaks_into_a_free_run(basis, warmup):
    begin = WARM if warmup is None else warmup
    for _, run, again in without_leak(drawn(basis), lambda m, e: m.simulate(e, warmup=warmup), record(), [begin]):
        np.testing.assert_array_equal(again, run)


@pytest.mark.parametrize("steps", [1, 2, 7])
def test_no_measured_output_leaks_into_a_prediction(steps):
    changes = [WARM, WARM + 1, 30, 60]
    for k, run, again in without_leak(drawn(BASES["gaussian"]), lambda m, e: m.predict(e, steps), record(), changes):
        np.testing.assert_array_equal(again[: k + steps], run[: k + steps])
        if k + steps < len(run):
            assert not np.array_equal(again[k + steps], run[k + steps])  # and this one has seen it


def test_a_prediction_is_a_free_run_from_where_it_begins():
    model, e = drawn(BASES["piecewise"]), record()
    far = model.predict(e, 9)
    for begin in (WARM + 3, 40):
        np.testing.assert_allclose(model.simulate(e, warmup=begin)[begin + 8], far[begin + 8], rtol=1e-9)


def test_the_schedule_of_a_free_run_stays_in_the_span():
    model = dataclasses.replace(drawn(BASES["powers"]), spans=[[1.4, 1.5]])
    e = record()
    x = model._states(*[a[:WARM] for a in model.deviations(e)])[-1]
    expected = written_out(model, e[["u1", "u2"]][WARM:], x, np.clip(e["level"][WARM - 1 :: -1], 1.4, 1.5))
    np.testing.assert_allclose(model.simulate(e)[WARM:], expected, rtol=1e-10)


# ---- linearisation ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("basis", BASES.values(), ids=BASES)
@pytest.mark.parametrize("rho", [1.25, 1.6])
def test_the_linearisation_is_what_small_inputs_do_to_a_run_at_rest(basis, rho):
    model = drawn(basis)
    at = equilibrium(model, rho)
    u = np.tile(at.u, (40, 1))
    small = 1e-5 * np.random.default_rng(2).normal(size=u.shape)
    rest, up, down = (written_out(model, v, at.x, [rho] * 3) for v in (u, u + small, u - small))
    np.testing.assert_allclose(rest, np.tile(at.y, (40, 1)), atol=1e-9)
    assert at.y[0] == pytest.approx(rho)
    A, B, C, D = model.linearise(rho)
    x, expected = np.zeros(len(A)), []
    for v in small:
        expected.append(C @ x + D @ v)
        x = A @ x + B @ v
    np.testing.assert_allclose((up - down) / 2e-5, np.array(expected) / 1e-5, atol=1e-5)


@pytest.mark.parametrize("basis", BASES.values(), ids=BASES)
def test_slopes_are_differences(basis):
    for rho in (0.3, 1.0, 2.2):
        expected = (basis(np.array(rho + 1e-6)) - basis(np.array(rho - 1e-6))) / 2e-6
        np.testing.assert_allclose(basis.slopes(rho), expected, atol=1e-7)


def square_root_tank(dt=0.2) -> LPVModel:
    """h+ = h + dt (u - sqrt(h)) as a quasi-LPV model: h+ = (1 - dt h^-1/2) h + dt u."""
    return LPVModel(
        "tank", dt, (Channel("u", "", "input"),), (Channel("h", "m", "output"),), (Channel("h", "m", "scheduled output"),),
        [[0.1, 2.0]], Powers([0.0, -0.5], scale=1.0), (Term(0), Term(1)), np.array([[[1.0]], [[-dt]]]),
        np.array([[[dt]], [[0.0]]]), np.array([[[1.0]], [[0.0]]]), np.zeros((2, 1, 1)),
        OperatingPoint(CONSTANT, np.zeros((1, 1)), np.zeros((1, 1))),
        Predictor(np.zeros((2, 1, 1)), np.array([[[dt]], [[0.0]]]), np.array([[[1.0]], [[-dt]]]), warmup=1), np.eye(1),
    )  # fmt: skip


def test_hidden_coupling_halves_the_leak_of_a_tank():
    """d/dh of sqrt(h) is half of sqrt(h) / h: the frozen pole is 1 - dt / sqrt(h), the true one 1 - dt / (2 sqrt(h))."""
    model = square_root_tank()
    for h in (0.2, 0.9, 1.9):
        assert model.to_control(h).poles() == pytest.approx(1 - 0.2 / (2 * np.sqrt(h)))
        assert model.to_control(h, frozen=True).poles() == pytest.approx(1 - 0.2 / np.sqrt(h))
        assert model.freeze(h)[0] == pytest.approx(1 - 0.2 / np.sqrt(h))
        assert equilibrium(model, h).u == pytest.approx(np.sqrt(h))
    worst = model.stability()
    assert worst.stable
    assert (worst.radius, worst.at) == (pytest.approx(1 - 0.2 / (2 * np.sqrt(2.0))), 2.0)
    assert model.to_control(0.9).dcgain() == pytest.approx(2 * np.sqrt(0.9))  # h = u^2


def test_where_nothing_holds_the_output_there_is_no_equilibrium():
    deaf = dataclasses.replace(square_root_tank(), B=np.zeros((2, 1, 1)))
    with pytest.raises(InputError, match=r"no equilibrium at h = 0.5 m"):
        deaf.to_control(0.5)
    assert deaf.to_control(0.5, frozen=True).poles() == pytest.approx(1 - 0.2 / np.sqrt(0.5))
    found = deaf.stability(11)
    assert np.isnan(found.radius)
    assert len(found.unknown) == 11
    assert not found.stable


def test_outside_the_span_nothing_is_linearised():
    with pytest.raises(InputError, match=r"the model knows h from 0\.1 to 2 m"):
        square_root_tank().to_control(3.0)


def test_a_run_side_by_side_goes_on_with_those_that_are_kept():
    model = square_root_tank()
    runs = OwnRuns(model, np.array([[0.3], [0.7]]), np.array([[0.3], [0.7]]))
    runs.step(np.zeros((2, 1)))
    runs.keep(1)
    alone = OwnRuns(model, np.array([[0.3]]), np.array([[0.3]]))
    alone.step(np.zeros((1, 1)))
    np.testing.assert_allclose(runs.step(np.ones((1, 1))), alone.step(np.ones((1, 1))), rtol=1e-14)


# ---- files --------------------------------------------------------------------------------------------------------------


def test_the_file_says_in_the_schedule_channel_that_it_is_an_output(tmp_path):
    model, e = drawn(BASES["gaussian"]), record()
    model.save(tmp_path / "m.json")
    content = json.loads((tmp_path / "m.json").read_text())
    assert content["schedule"] == {"name": "level", "unit": "m", "role": "scheduled output"}
    assert content["outputs"][0] == {"name": "level", "unit": "m", "role": "output"}
    again = load_model(tmp_path / "m.json")
    assert again.scheduled_output == 0
    np.testing.assert_array_equal(again.simulate(e), model.simulate(e))
    np.testing.assert_array_equal(again.predict(e, 4), model.predict(e, 4))
    for a, b in zip(again.linearise(1.3), model.linearise(1.3), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_schedule_with_the_old_role_is_a_signal_from_outside_as_before():
    model = dataclasses.replace(drawn(BASES["gaussian"]), schedules=(dataclasses.replace(LEVEL, role="schedule"),))
    assert model.scheduled_output is None
    np.testing.assert_array_equal(model.linearise(1.3)[0], model.freeze(1.3)[0])


def test_a_scheduled_output_is_an_output():
    with pytest.raises(InputError, match="channel h2: is a scheduled output and no output"):
        dataclasses.replace(square_root_tank(), schedules=(Channel("h2", "m", "scheduled output"),))


# ---- what takes a schedule for a signal from outside refuses it ---------------------------------------------------------


def tank_record() -> Dataset:
    h = np.linspace(0.2, 1.8, 50)
    return Dataset((Experiment.from_arrays("r", 0.2, inputs={"u": np.sqrt(h)}, outputs={"h": h}, schedule={"h": h}),))


def law():
    return pid(("u",), ("h",), ("h_set",), 0.2, [[0.1]], [[0.1]])


REFUSED = {
    "scheduled PID": lambda model: ScheduledPIDDesign(knots=2).on(model),
    "robust to": lambda model: ScheduledPIDDesign(knots=2, robust_to=(model,)).on(
        constant_model("lti", 0.2, (model.inputs, model.outputs), [[[0.9]], [[0.1]], [[1.0]], [[0.0]]], model.operating_point)
    ),
    "MPC": lambda model: MPCDesign().on(model),
    "MPC with a fallback": lambda model: MPCDesign(fallback=law()).on(model),
    "observer": design_observer,
    "tuning rule": lambda model: fotd(model, "h", "u", 0.5),
    "frozen loop": lambda model: closed_loop(law(), model, 0.5),
    "machine with errors": lambda model: machine_with_errors(model, (), 0.5),
    "rehearsal": lambda model: rehearsal(model, [1.0], [0.1], 20, 0).run(law()),
    "check": lambda model: check(law(), {"loop": {"stable": True}}, model=model, records=tank_record()),
    "plant": identified,
}


@pytest.mark.parametrize("task", REFUSED.values(), ids=REFUSED)
def test_what_takes_a_schedule_for_a_signal_from_outside_refuses_it(task):
    with pytest.raises(InputError, match=r"h is schedule and output of this model, and .* from outside") as reason:
        task(square_root_tank())
    assert "--schedule none" in (reason.value.mend or "")
