"""Laws over two schedule variables: a table written out, margins between its nodes on the true machine, and the same as over one
variable where nothing depends on the second.

The machine: p y'' + 3 y' + (4 + 2 q) 3 y = (2 + q) 3 u, of which the models here are fits over a lattice.
"""

import dataclasses
import json

import numpy as np
import pytest
from scipy.interpolate import interpn
from scipy.linalg import expm

from controllers import ScheduledPIDDesign
from controllers.files import load_controller, save_controller
from controllers.mpc import design_mpc
from controllers.observer import design_observer, interpolated
from controllers.pid_design import design_pid
from studies.cli import main
from tests.controllers.test_mpc import lpv
from workbench.basis import PiecewiseLinear, Powers, Products, constant, polynomials, unity
from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.intervals.errors import ErrorRegression
from workbench.lpv import LPVModel, OperatingPoint, Predictor, Term, lattice
from workbench.physics.controller import check_controller
from workbench.physics.identified import identified
from workbench.physics.plant import Plant
from workbench.physics.rest import Start
from workbench.readers import write_csv
from workbench.rehearsal import rehearsal
from workbench.robustness.frozen import margins_of
from workbench.robustness.limits import Limit, LoopLimits, Manoeuvre
from workbench.robustness.verdict import Status
from workbench.simulation import Scenario, simulate
from workbench.verification.model import on_model, opened
from workbench.verification.trial import on_model as tried_on_model

DT = 0.02
SPANS = np.array([[0.5, 2.0], [-1.0, 1.0]])
SCHEDULES = (Channel("p", "kg", "schedule"), Channel("q", "N", "schedule"))


def exact(p, q):
    """A, B of the sampled machine."""
    A, B = np.array([[0.0, 1.0], [-(4.0 + 2.0 * q) * 3.0 / p, -3.0 / p]]), np.array([[0.0], [(2.0 + q) * 3.0 / p]])
    both = expm(np.block([[A, B], [np.zeros((1, 3))]]) * DT)
    return both[:2, :2], both[:2, 2:]


@pytest.fixture(scope="module")
def model() -> LPVModel:
    basis, points = polynomials(4, np.ones(2)), lattice(SPANS, 11)
    A, B = (np.array(own) for own in zip(*(exact(*at) for at in points), strict=True))
    phi = basis(points)
    A, B = (np.linalg.lstsq(phi, M.reshape(len(M), -1), rcond=None)[0].reshape(-1, *M.shape[1:]) for M in (A, B))
    one = unity(basis)[:, None, None]
    C, K = one * [[1.0, 0.0]], one * [[0.1], [0.1]]
    return LPVModel(
        "two", DT, (Channel("u", "V", "input"),), (Channel("y", "rad", "output"),), SCHEDULES, SPANS, basis,
        tuple(Term(j) for j in range(len(basis.names))), A, B, C, 0.0 * one,
        OperatingPoint(constant(2), [[0.0]], [[0.0]]), Predictor(A - K @ C[:1], B, K), np.array([[1e-6]]),
    )  # fmt: skip


@pytest.fixture(scope="module")
def design(model):
    return design_pid(model, knots=3)


def table(law, rho):
    """Kp, Ki, Kd of the first channel by linear interpolation in each variable."""
    knots = [np.linspace(low, high, 3) for low, high in SPANS]
    return [interpn(knots, M[:, 0, 0].reshape(3, 3), np.clip(rho, *SPANS.T))[0] for M in (law.Kp, law.Ki, law.Kd)]


def largest_sensitivity(law, rho):
    """On the machine itself, over 4000 frequencies; and the largest pole of the loop."""
    (A, B), (Kp, Ki, Kd) = exact(*rho), table(law, rho)
    z = np.exp(1j * np.geomspace(1e-2, np.pi / DT, 4000) * DT)
    P = np.linalg.solve(z[:, None, None] * np.eye(2) - A, B)[:, 0, 0]
    L = P * (Kp + Ki * DT / (z - 1.0) + Kd * (z - 1.0) / ((law.Tf + DT) * z - law.Tf))
    return np.abs(1.0 / (1.0 + L)).max()


def test_the_margins_hold_on_the_machine_between_the_nodes(design):
    random = np.random.default_rng(5)
    peaks = [largest_sensitivity(design.law, rho) for rho in random.uniform(*SPANS.T, (300, 2))]
    assert max(peaks) <= 1.6 + 2e-3
    assert max(peaks) > 1.5  # the bound is made use of
    np.testing.assert_allclose(design.margins.sensitivity[0], largest_sensitivity(design.law, design.margins.rho[0]), rtol=3e-3)


def test_the_loop_of_the_machine_goes_to_its_set_point_while_both_variables_move(design):
    law, x, state, errors = design.law, np.zeros(2), design.law.init(), []
    for k in range(3000):
        rho = np.array([1.25 + 0.75 * np.sin(0.004 * k), np.cos(0.0031 * k)])
        A, B = exact(*rho)
        u, state = law.step(state, np.array([0.5]), x[:1], rho)
        x = A @ x + B @ u
        errors.append(x[0] - 0.5)
    assert np.abs(errors[500:]).max() < 0.02


@pytest.mark.parametrize("outside", [False, True])
def test_the_law_is_its_table(design, outside):
    law, random = design.law, np.random.default_rng(1)
    ends = SPANS + np.array([[-0.5, 0.5]]) * outside
    for rho in random.uniform(*ends.T, (50, 2)):
        np.testing.assert_allclose([K[0, 0] for K in law.gains_at(rho)[:3]], table(law, rho), atol=1e-12)
        u, _ = law.step(law.init(), np.array([0.3]), np.array([0.1]), rho)
        Kp, _, _ = table(law, rho)
        gains = law.gains_at(rho)
        assert u[0] == pytest.approx(gains.u0[0] + gains.Kr[0, 0] * 0.3 + Kp * 0.2, abs=1e-12)
    assert law.outside(np.array([[1.0, 0.0], [2.3, 0.0]])) == pytest.approx(0.2)
    assert law.outside(np.array([[1.0, 1.4]])) == pytest.approx(0.2)


def test_the_file_is_the_law(design, tmp_path):
    law = design.law
    again = load_controller(save_controller(law, tmp_path / "law.json"))
    check_controller(again, "law.json")
    assert again.schedule == ("p", "q")
    np.testing.assert_array_equal(again.span, SPANS)
    rho = np.array([0.71, 0.3])
    np.testing.assert_array_equal(again.gains_at(rho).Ki, law.gains_at(rho).Ki)


# ---- a plant that logs both -------------------------------------------------------------------------------------------------


def moving(x, u, p, at):
    """The machine, whose p and q swing on their own."""
    return {
        "y": x.v, "v": ((2.0 + x.q) * 3.0 * u.u - (4.0 + 2.0 * x.q) * 3.0 * x.y - 3.0 * x.v) / x.p,
        "p": 0.7 * x.turned, "turned": 0.7 * (1.25 - x.p), "q": -0.4 * x.q,
    }  # fmt: skip


PLANT = Plant(
    name="two",
    states=(Channel("y", "rad"), Channel("v", "rad/s"), Channel("p", "kg"), Channel("turned", "kg"), Channel("q", "N")),
    inputs=(Channel("u", "V", "input"),),
    outputs=(Channel("y", "rad", "output"), Channel("q", "N", "schedule"), Channel("p", "kg", "schedule")),
    parameters=(), equation=moving, measure=lambda x, p: {"y": x.y, "q": x.q, "p": x.p}, dt=DT,
    start=Start(fixed={"u": 0.0, "y": 0.0, "v": 0.0, "p": 1.25, "turned": 0.6, "q": 0.9}),
    noise={"y": 1e-3, "p": 1e-3, "q": 1e-3},
)  # fmt: skip


def test_the_compiled_law_commands_what_the_law_commands(design):
    law = design.law
    references = np.repeat([0.0, 0.5, 0.2], 200)
    run = simulate(PLANT, law, Scenario("run", {"y_set": references}, seed=4)).experiment
    state, commands = law.init(), []
    for k in range(len(run)):
        u, state = law.step(state, references[k : k + 1], run["y"][k : k + 1], np.array([run["p"][k], run["q"][k]]))
        commands.append(u[0])
    assert np.ptp(run["p"]) > 1.0
    assert np.ptp(run["q"]) > 0.8
    np.testing.assert_allclose(run["u"], commands, atol=1e-9)


def test_a_law_that_is_asked_sample_by_sample_gets_the_same_schedule(model, design):
    law = design_mpc(model, design.law, horizon=10)
    references = np.repeat([0.0, 0.5], 100)
    run = simulate(PLANT, law, Scenario("run", {"y_set": references}, seed=4)).experiment
    state = law.init()
    for k in range(len(run)):
        u, state = law.step(state, references[k : k + 1], run["y"][k : k + 1], np.array([run["p"][k], run["q"][k]]))
        assert run["u"][k] == pytest.approx(u[0], abs=1e-12)
    assert abs(run["y"][-1] - 0.5) < 0.05


# ---- a second variable that nothing depends on ------------------------------------------------------------------------------


def with_idle(model: LPVModel) -> LPVModel:
    """The model with one schedule more, of which it is independent."""
    flat = Powers((0.0,))
    point = model.operating_point
    return dataclasses.replace(
        model, schedules=(*model.schedules, Channel("idle", "K", "schedule")), spans=np.vstack([model.spans, [[5.0, 7.0]]]),
        basis=Products((model.basis, flat)), operating_point=OperatingPoint(Products((point.basis, flat)), point.u, point.y),
    )  # fmt: skip


@pytest.fixture(scope="module")
def pair():
    one = lpv()
    return one, with_idle(one)


def test_the_model_and_its_plant_run_the_same(pair):
    one, two = pair
    random, N = np.random.default_rng(2), 120
    inputs = {c.name: random.normal(size=N) for c in one.inputs}
    rho = one.span[0] + np.ptp(one.span) * random.uniform(-0.1, 1.1, N)
    e = Experiment.from_arrays(
        "r", one.dt, inputs=inputs, outputs={c.name: np.zeros(N) for c in one.outputs},
        schedule={one.schedule.name: rho, "idle": random.uniform(4.0, 8.0, N)},
    )  # fmt: skip
    np.testing.assert_allclose(two.simulate(e, warmup=0), one.simulate(e, warmup=0), atol=1e-12)
    for own in pair:
        plant, y = identified(own), []
        first = dict(zip((c.name for c in own.schedules), np.atleast_1d(own.schedule_of(e)[0]), strict=True))
        stood = {name: first[name.split()[0]] for name in plant.state_names if "before" in name}
        x = np.array([stood.get(name, 0.0) for name in plant.state_names])
        for now in e[list(plant.input_names)]:
            y.append(plant.output(x, None, now))
            x = x + plant.dt * np.array(plant.derivative(x, now), dtype=float)
        np.testing.assert_allclose(np.array(y, dtype=float), one.simulate(e, warmup=0), atol=1e-12)
    assert [c.name for c in plant.inputs][-1] == "idle"


def test_margins_and_proofs_are_the_same(pair):
    one, two = pair
    law = design_pid(one, knots=3).law
    wide = dataclasses.replace(
        law,
        schedule=(law.schedule, "idle"),
        span=np.vstack([law.span, [[5.0, 7.0]]]),
        basis=Products((law.basis, Powers((0.0,)))),
    )
    rho = one.frozen_values(3)
    first, second = margins_of(law, one, rho), margins_of(wide, two, [np.array([value, 6.3]) for value in rho])
    for key in ("sensitivity", "complementary", "effort", "radius", "bandwidth", "delay"):
        np.testing.assert_allclose(getattr(second, key), getattr(first, key), rtol=1e-6)
    trials = [tried_on_model(own, of) for own, of in ((law, one), (wide, two))]
    assert not trials[0].lost
    assert not trials[1].lost
    assert "going through their box" in trials[1].where


def test_an_mpc_commands_the_same(pair):
    one, two = pair
    fallback = design_pid(one, knots=3).law
    wide = dataclasses.replace(
        fallback, schedule=(fallback.schedule, "idle"), span=np.vstack([fallback.span, [[5.0, 7.0]]]),
        basis=Products((fallback.basis, Powers((0.0,)))),
    )  # fmt: skip
    laws = design_mpc(one, fallback, horizon=8), design_mpc(two, wide, horizon=8)
    random, states = np.random.default_rng(3), [law.init() for law in laws]
    for k in range(40):
        r, y = random.normal(size=len(one.outputs)), random.normal(size=len(one.outputs))
        value = np.nan if k == 20 else one.span[0] + np.ptp(one.span) * (0.5 + 0.4 * np.sin(0.3 * k))
        given = value, np.array([value, random.uniform(4.0, 8.0)])
        (u, states[0]), (v, states[1]) = (law.step(own, r, y, rho) for law, own, rho in zip(laws, states, given, strict=True))
        np.testing.assert_allclose(v, u, atol=1e-9)


def test_gains_on_a_lattice_are_interpolated_in_each_variable(model):
    observer = design_observer(model, points=5)
    axes = [np.linspace(low, high, 5) for low, high in SPANS]
    random = np.random.default_rng(0)
    for rho in random.uniform(*(SPANS + np.array([-0.2, 0.2])).T, (40, 2)):
        expected = interpn(axes, observer.L.reshape(5, 5, -1), np.clip(rho, *SPANS.T))[0]
        np.testing.assert_allclose(observer.gains(rho)[0].ravel(), expected, atol=1e-12)
    assert interpolated(observer.rho, observer.L, observer.rho[7]).shape == observer.L.shape[1:]


# ---- what is proved of it ---------------------------------------------------------------------------------------------------


def records(model, count=2, N=500) -> Dataset:
    found = []
    for k in range(count):
        random = np.random.default_rng(k)
        schedule = {"p": 1.25 + 0.75 * np.sin(0.013 * np.arange(N) * (1 + k)), "q": np.cos(0.021 * np.arange(N) + k)}
        u = np.repeat(random.uniform(-2.0, 2.0, N // 20), 20)
        e = Experiment.from_arrays(f"r{k}", DT, inputs={"u": u}, outputs={"y": np.zeros(N)}, schedule=schedule)
        y = model.simulate(e, warmup=0)[:, 0] + 1e-3 * random.normal(size=N)
        units = {"u": "V", "y": "rad", "p": "kg", "q": "N"}
        found.append(Experiment.from_arrays(f"r{k}", DT, inputs={"u": u}, outputs={"y": y}, schedule=schedule, units=units))
    return Dataset(tuple(found))


@pytest.mark.slow
def test_a_loop_that_one_corner_loses_fails_there_and_is_proved_elsewhere(model, design):
    """The integral gain of one knot, ten times as large: unstable at p = 2, q = 1 by its own poles."""
    law, Ki = design.law, design.law.Ki.copy()
    Ki[-1] *= 10.0
    wrong = dataclasses.replace(law, Ki=Ki)
    left = opened(ErrorRegression(), model, records(model))
    part = on_model(left, wrong, LoopLimits(stable=True), nodes=2)
    said = {verdict.claim: verdict.status for verdict in part.verdicts}
    radius = {}
    for rho in lattice(SPANS, 2):
        (A, B), (Kp, Ki_, Kd) = exact(*rho), table(wrong, rho)
        a, direct = law.Tf / (law.Tf + DT), Kp + Kd / (law.Tf + DT)
        C = np.array([[1.0, 0.0]])
        loop = np.block([
            [A - B * direct @ C, B, B * Kd], [-DT * Ki_ * C, np.eye(1), np.zeros((1, 1))],
            [(1.0 - a) / (law.Tf + DT) * C, np.zeros((1, 1)), np.array([[a]])],
        ])  # fmt: skip
        radius[tuple(rho)] = np.abs(np.linalg.eigvals(loop)).max()
    assert [at for at, value in radius.items() if value > 1.0] == [(2.0, 1.0)]
    for (p, q), value in radius.items():
        status = said[f"stable at p = {p:.4g} kg, q = {q:.4g} N, frozen"]
        assert status is (Status.FAILED if value > 1.0 else Status.PROVED)


@pytest.mark.slow
def test_a_limit_along_the_run_is_a_run_of_the_worst_machine(model, design):
    left = opened(ErrorRegression(), model, records(model))
    run = Manoeuvre(duration=4.0, setpoints={"y": [[0.0, 0.0], [1.0, 0.5]]})
    part = on_model(left, design.law, LoopLimits(stable=False, run=run, limits=(Limit("y", low=-0.5, high=1.5, unit="rad"),)))
    assert [v.status for v in part.verdicts] == [Status.PROVED] * len(part.verdicts)
    assert "along p from 0.5 to 2 kg, q from -1 to 1 N" in part.verdicts[-1].of
    with pytest.raises(InputError, match="several schedule variables: stability in motion is proved for one"):
        on_model(left, design.law, LoopLimits(stable=True), rate=0.1)


def test_a_path_goes_through_the_box(model):
    path = model.path(2000)
    np.testing.assert_array_equal([path.min(axis=0), path.max(axis=0)], SPANS.T)
    corners = lattice(SPANS, 2)
    width = np.ptp(SPANS, axis=1)
    near = [np.min(np.max(np.abs(path - corner) / width, axis=1)) for corner in corners]
    assert max(near) < 0.35  # it comes near every corner
    assert np.abs(np.diff(path, axis=0) / width).max() < 3.0 / 1998
    run = rehearsal(model, [0.0], [0.1], 400, 1)
    np.testing.assert_array_equal(run.rho, model.path(400))


# ---- wrong input ------------------------------------------------------------------------------------------------------------


def test_laws_and_models_of_other_schedules_do_not_go_together(model, design, pair):
    with pytest.raises(InputError, match="scheduled on r2, the model on r2, idle"):
        margins_of(design_pid(pair[0], knots=2).law, pair[1], [pair[1].middle])
    turned = dataclasses.replace(design.law, schedule=("q", "p"), span=SPANS[::-1])
    with pytest.raises(InputError, match="scheduled on q, p, the model on p, q"):
        margins_of(turned, model, [np.array([1.0, 0.0])])
    unlogged = dataclasses.replace(PLANT, outputs=PLANT.outputs[:2], measure=lambda x, p: {"y": x.y, "q": x.q}, noise={})
    with pytest.raises(InputError, match="unknown measured channel 'p'"):
        simulate(unlogged, design.law, Scenario("x", {"y_set": np.zeros(3)}))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"span": (0.0, 1.0)}, r"\(2, 2\): lowest and highest of each of p, q"),
        ({"schedule": "p"}, r"span of shape"),
        ({"span": ((0.0, 1.0), (2.0, 2.0))}, "schedule range"),
        ({"schedule": ("p",), "span": ((0.0, 1.0),)}, "one variable by its name: 'p'"),
        ({"basis": PiecewiseLinear(np.arange(9.0))}, "no functions of p, q together"),
    ],
)
def test_a_law_of_a_wrong_span_is_refused(design, change, said):
    with pytest.raises(InputError, match=said):
        dataclasses.replace(design.law, **change)


def test_knots_are_of_every_variable(model):
    for knots, said in (
        ([3, 3, 3], "one for all, or one for each of p, q"),
        ([3, [0.0, 9.0]], "the model knows q from -1 to 1 N"),
    ):
        with pytest.raises(InputError, match=said):
            ScheduledPIDDesign(knots=knots).design(model)
    uneven = ScheduledPIDDesign(knots=[[0.5, 0.8, 2.0], 2]).design(model)
    assert uneven.knots.shape == (6, 2)
    assert uneven.margins.sensitivity.max() <= 1.6


@pytest.mark.slow
def test_the_whole_way_on_the_command_line(model, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model.save("two.json")
    for e in records(model):
        write_csv(e, tmp_path / f"{e.name}.csv")
    design = ["design", "scheduled-pid", "--model", "two.json", "--setpoint", "y=0.5", "--low", "u=-5", "--high", "u=5"]
    assert main([*design, "--knots", "3,2", "--out", "pid"]) == 0
    said = capsys.readouterr().out
    assert "at p = " in said
    head = (tmp_path / "pid" / "gains.csv").read_text().splitlines()
    assert head[0].startswith("p [kg],q [N],Kp_u_y")
    assert len(head) == 7
    assert main(["simulate", "two.json", "--controller", "pid/scheduled-pid.json", "--setpoint", "y=0.5", "--out", "run"]) == 0
    (tmp_path / "limits.toml").write_text("[loop]\nstable = true\nsensitivity = 1.7\n")
    checked = ["check", "--controller", "pid/scheduled-pid.json", "--limits", "limits.toml", "--model", "two.json"]
    assert main([*checked, "--records", "r0.csv", "r1.csv", "--nodes", "2", "--json", "c.json"]) == 0
    verdicts = json.loads((tmp_path / "c.json").read_text())["verdicts"]
    assert [v["status"] for v in verdicts] == ["PROVED"] * 4 + ["PASSED"]
    capsys.readouterr()
    for words, said in (
        (["--knots", "0"], "--knots 0"), (["--knots", "3,a"], "one for each schedule variable"), (["--knots", "1"], "1 knot"),
    ):  # fmt: skip
        assert main([*design, *words]) == 2
        assert said in capsys.readouterr().err
    assert main(["design", "pid", "--model", "two.json", "--at", "1.0"]) == 2
    assert "--at P,Q" in capsys.readouterr().err
