"""Laws on Hammerstein-Wiener models: designed and checked behind the curves, run before them, and on machines of others."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import workbench as wb
from controllers import MPCDesign, ScheduledPIDDesign
from controllers.cancelled import Compensation
from controllers.files import load_controller, save_controller
from controllers.pid import pid
from controllers.scheduled_pid import ScheduledPID
from studies.cli import main
from workbench.curves import Curve, bent
from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.hammerstein import HammersteinWienerModel, behind
from workbench.lpv import OperatingPoint
from workbench.physics.parameters import Parameter
from workbench.physics.plant import Plant
from workbench.physics.rest import Start
from workbench.rehearsal import hold
from workbench.robustness.limits import limits_of
from workbench.robustness.verdict import Status
from workbench.verification.curved import as_arriving
from workbench.verification.trial import on_model

DT = 0.05
SQUARE = Curve("u", [-3.0, -1.5, 0.0, 1.5, 3.0], [-4.0, -1.0, 0.1, 1.2, 3.9])
DEAD = Curve("u", [-3.0, -0.5, 0.5, 3.0], [-3.0, 0.0, 0.0, 3.0])
TURNS = Curve("u", [-3.0, 0.0, 3.0], [3.0, 0.0, 3.1])


def record(name: str, arrives: Callable, seed: int, samples: int = 2000) -> Experiment:
    """x' = (1.4 f(u) - x) / 0.8 s, sampled, under steps of any height."""
    random = np.random.default_rng(seed)
    u, y, x, a = np.repeat(random.uniform(-3.0, 3.0, samples // 20), 20), np.empty(samples), 0.0, np.exp(-DT / 0.8)
    for k in range(samples):
        y[k] = x + 0.01 * random.standard_normal()
        x = a * x + (1.0 - a) * 1.4 * float(arrives(u[k]))
    return Experiment.from_arrays(name, DT, inputs={"u": u}, outputs={"y": y}, units={"u": "V", "y": "m"})


@pytest.fixture(scope="module")
def records() -> Dataset:
    return Dataset(tuple(record(name, SQUARE, seed) for seed, name in enumerate("ab")))


@pytest.fixture(scope="module")
def model(records) -> HammersteinWienerModel:
    """The curve as it is, and what is identified behind it."""
    behind_it = Dataset(tuple(HammersteinWienerModel("h", wb.LTI(order=1).fit(records), (SQUARE,)).curved(e) for e in records))
    core = wb.LTI(order=1, feedthrough=False).fit(behind_it)
    return HammersteinWienerModel("HW", core, (SQUARE,))


@pytest.fixture(scope="module")
def law(model) -> ScheduledPID:
    return ScheduledPIDDesign(sensitivity=1.5).on(model)


def test_it_is_the_design_behind_the_curve(model, law):
    low, high = SQUARE(np.array([-3.0, 3.0]))
    straight = ScheduledPIDDesign(sensitivity=1.5, low={"u": low}, high={"u": high}).on(model.core)
    for key in ("Kp", "Ki", "Kd", "Kr", "u0", "low", "high", "bandwidth"):
        np.testing.assert_allclose(getattr(law.inside, key), getattr(straight, key), rtol=1e-9, err_msg=key)
    assert law.curves[0].v.tolist() == SQUARE.v.tolist()
    assert (law.low.tolist(), law.high.tolist()) == ([-3.0], [3.0])  # what the records have shown of the curve
    given = ScheduledPIDDesign(low={"u": -1.0}, rate={"u": 8.0}).design(model).law
    assert (given.low.tolist(), given.high.tolist(), given.rate.tolist()) == ([-1.0], [3.0], [8.0])


def test_a_run_before_the_curve_is_the_run_behind_it(model, law):
    own, behind_it = on_model(law, model), on_model(law.inside, model.core)
    assert not own.lost
    np.testing.assert_allclose(own.settled, behind_it.settled)
    np.testing.assert_allclose(own.beyond, behind_it.beyond, atol=1e-9)
    held, straight = hold(model, law, {"y": 2.0}, 300, 4), hold(model.core, law.inside, {"y": 2.0}, 300, 4)
    np.testing.assert_allclose(held["y"], straight["y"], atol=1e-9)
    np.testing.assert_allclose(SQUARE(held["u"]), straight["u"], atol=1e-9)
    assert np.abs(held["u"] - straight["u"]).max() > 0.1
    calm = replace(law, rate=[0.5])
    assert np.abs(np.diff(hold(model, calm, {"y": 2.0}, 300, None)["u"])).max() < 0.5 * DT + 1e-12


def test_where_an_inverse_is_not_exact_the_run_goes_through_the_curve_that_was_found(model):
    dead = replace(model, curves=(DEAD,))
    law = ScheduledPIDDesign().on(dead)
    assert law.curves[0].rising
    near, exact = hold(dead, law, {"y": 0.0}, 400, 5), hold(model.core, law.inside, {"y": 0.0}, 400, 5)
    assert np.abs(near["y"] - exact["y"]).max() > 1e-3
    assert near["y"][200:].mean() == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(
    ("change", "design", "said"),
    [
        ({"unsigned": ("y",)}, ScheduledPIDDesign(), "y shows no sign: no loop is closed over it"),
        ({"curves": (TURNS,)}, ScheduledPIDDesign(), "turns back or stands still"),
        ({}, MPCDesign(), "an MPC does not invert the curves"),
        ({}, ScheduledPIDDesign(low={"v": 1.0}), "unknown input 'v'"),
    ],
)
def test_what_has_no_law_is_refused(model, change, design, said):
    with pytest.raises(InputError, match=said):
        design.on(replace(model, **change))
    with pytest.raises(InputError, match="which would the law invert"):
        ScheduledPIDDesign(robust_to=(model.core,)).on(model)


def test_a_law_and_a_model_of_different_curves_do_not_meet(model, law, records):
    limits = {"run": {"duration": 6.0, "setpoints": {"y": ((0.0, 0.0), (1.0, 1.0))}}, "limits": {"y": {"high": 2.0}}}
    for other, given, said in (
        (law.inside, model, "knows nothing of the curve of u"),
        (law, model.core, "inverts a curve of u, the model has none"),
        (law, replace(model, curves=(DEAD,)), "inverts another curve of u than the model has"),
    ):
        for meet in (behind, on_model, lambda a, b: wb.check(a, limits, model=b, records=records)):
            with pytest.raises(InputError, match=said):
                meet(other, given)


def test_what_is_proved_of_it_is_what_is_proved_behind_the_curve(model, law, records):
    run = {"duration": 10.0, "setpoints": {"y": ((0.0, 0.0), (1.0, 1.5))}}
    limits = {"y": {"high": 2.2}, "u": {"low": -2.0, "high": 2.5, "rate": 30.0}}
    asked = {"run": run, "limits": limits, "loop": {"stable": True, "sensitivity": 1.6}}
    found = wb.check(law, asked, model=model, records=records)
    inside = {"y": limits["y"], "u": {end: float(SQUARE(np.array(limits["u"][end]))) for end in ("low", "high")}}
    arriving = Dataset(tuple(model.curved(e) for e in records))
    straight = wb.check(law.inside, asked | {"limits": inside}, model=model.core, records=arriving)
    assert any(v.claim.startswith("u: high 2.5 (f(u): high ") for v in found.verdicts)
    straightened = r"u: \w+ \S+ \(f\(u\)(.*)\)"
    by_claim = {re.sub(straightened, r"u\1", v.claim): v for v in found.verdicts}
    for v in straight.verdicts:
        assert by_claim[v.claim].status is v.status
        assert by_claim[v.claim].margin == pytest.approx(v.margin, rel=1e-6)
    assert by_claim["u: rate"].status is Status.UNDECIDED
    assert sum(v.status is Status.PROVED for v in found.verdicts) >= 3
    # no noise of the records' size and no curve that they hold breaks what is proved on the machine itself
    high = next(v for v in found.verdicts if v.claim.startswith("y: high"))
    assert high.status is Status.PROVED
    for seed in range(20):
        y, _ = driven(law, SQUARE, np.where(np.arange(200) < 20, 0.0, 1.5), seed)
        assert y.max() < 2.2


def driven(law: ScheduledPID, arrives: Callable, r: np.ndarray, seed: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Output and commands of the machine of `record` under a law."""
    random, x, a, state = np.random.default_rng(seed), 0.0, np.exp(-DT / 0.8), law.init(np.zeros(1))
    y, u = np.empty(len(r)), np.empty(len(r))
    for k in range(len(r)):
        y[k] = x + (0.0 if seed is None else 0.01 * random.standard_normal())
        (u[k],), state = law.step(state, r[[k]], y[[k]])
        x = a * x + (1.0 - a) * 1.4 * float(arrives(u[k]))
    return y, u


def test_where_the_inverse_is_not_exact_nothing_is_proved(model, records):
    dead = replace(model, curves=(DEAD,))
    law = ScheduledPIDDesign().on(dead)
    asked = {"run": {"duration": 5.0, "setpoints": {"y": ((0.0, 0.0),)}}, "limits": {"y": {"high": 1.0}}}
    found = wb.check(law, asked, model=dead, records=records)
    assert {v.status for v in found.verdicts} == {Status.UNDECIDED}
    assert all("not exact" in v.sentence for v in found.verdicts)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e6])
def test_curves_are_told_apart_in_every_unit(model, law, scale):
    """In nA all curves are within 1e-8 of each other."""

    def scaled(curve: Curve) -> Curve:
        return Curve("u", scale * curve.u, scale * curve.v)

    other = Curve("u", SQUARE.u, SQUARE.v + np.array([0.0, 0.0, 0.0, 0.02, 0.0]))
    own, whole = replace(law, curves=(scaled(SQUARE),)), replace(model, curves=(scaled(SQUARE),))
    assert behind(own, whole)[0].curves == ()
    with pytest.raises(InputError, match="another curve"):
        behind(replace(law, curves=(scaled(other),)), whole)


def test_beyond_what_the_records_have_shown_of_a_curve_nothing_is_proved(model, law, records):
    """A machine that is the same there may do anything beyond, and its curve goes on as a line by convention alone."""
    asked = {"run": {"duration": 5.0, "setpoints": {"y": ((0.0, 0.0), (1.0, 1.0))}}, "limits": {"y": {"high": 2.0}}}
    found = wb.check(replace(law, high=[12.0]), asked, model=model, records=records)
    assert {v.status for v in found.verdicts} == {Status.UNDECIDED}
    assert all("u may go where the records have not shown its curve, known from -3 to 3" in v.sentence for v in found.verdicts)


@pytest.mark.parametrize(
    ("limits", "said"),
    [({"u": {"high": 2.0, "unit": "mV"}}, "limits.u.*in mV, the model has it in V"), ({"w": {"high": 2.0}}, "it has u, y")],
)
def test_limits_are_refused_in_the_words_of_their_file(model, law, records, limits, said):
    asked = {"run": {"duration": 5.0, "setpoints": {"y": ((0.0, 0.0),)}}, "limits": limits}
    with pytest.raises(InputError, match=f"(?s){said}"):
        wb.check(law, asked, model=model, records=records)
    with pytest.raises(InputError, match=r"lower limit 3\.5 is not below the upper 3"):
        ScheduledPIDDesign(low={"u": 3.5}).on(model)


def test_with_a_plant_the_law_of_the_commands_runs_on_it(model, law, records):
    """What its schedule does, and the search, are of u; what is proved is of f(u)."""
    plant = Plant(
        name="curved", description="", states=(Channel("x", "m"),), inputs=(Channel("u", "V", "input"),),
        outputs=(Channel("y", "m", "output"),), parameters=(Parameter("T", 0.8, "s", tolerance=0.02),),
        equation=lambda x, u, p, at: {"x": (1.4 * bent(u.u, SQUARE.bends) - x.x) / p.T}, measure=lambda x, p: {"y": x.x},
        dt=DT, ports=(), start=Start(fixed={"x": 0.0}, solve_for=("u",), zero=("x",)),
    )  # fmt: skip
    asked = {"run": {"duration": 5.0, "setpoints": {"y": ((0.0, 0.0), (1.0, 1.5))}}, "limits": {"y": {"high": 2.2}}}
    found = wb.check(law, asked, model=model, records=records, plant=plant, runs=20)
    by_of = {v.of: v.status for v in found.verdicts if v.claim.startswith("y")}
    assert set(by_of.values()) == {Status.PROVED, Status.PASSED}
    assert not found.trial.lost
    assert ScheduledPIDDesign().on(model, plant).curves


def test_inputs_that_the_law_does_not_command_keep_their_curves(model):
    """Of two inputs, each with a curve; the law commands the second, in the order of its own."""
    rest = {
        "C": [[[1.0]]],
        "D": np.zeros((1, 1, 2)),
        "A": model.core.A,
        "B": np.concatenate([0.3 * model.core.B, model.core.B], 2),
    }
    inputs, point = (Channel("d", "V", "input"), *model.core.inputs), model.core.operating_point
    core = replace(
        model.core, inputs=inputs, **rest, predictor=None, noise=None,
        operating_point=OperatingPoint(point.basis, np.zeros((1, 2)), np.zeros((1, 1))),
    )  # fmt: skip
    two = HammersteinWienerModel("two", core, (Curve("d", [-1.0, 0.0, 1.0], [3.0, 0.0, 3.0]), SQUARE))
    law = pid(("u",), ("y",), ("y_set",), DT, Kp=[[0.5]], Ki=[[0.9]], low=(-3.0,), high=(3.0,))
    law = replace(law, curves=(SQUARE,))
    inner, _ = behind(law, two)
    assert [*inner.low, *inner.high] == pytest.approx([-4.0, 3.9])
    run = hold(two, law, {"y": 1.0}, 400, None)
    assert run["y"][-1] == pytest.approx(1.0, abs=1e-3)
    assert np.ptp(run["d"]) == 0.0
    records = Dataset((Experiment.from_arrays("r", DT, inputs={"d": run["u"], "u": run["u"]}, outputs={"y": run["y"]}),))
    alone = replace(two, curves=two.curves[:1])  # a law that commands no curve may be of any kind
    loop = as_arriving(SimpleNamespace(name="mine", actuated=("u",)), alone, records, limits_of({"loop": {"stable": True}}))
    np.testing.assert_array_equal(loop.records.experiments[0]["d"], two.curves[0](run["u"]))
    np.testing.assert_array_equal(loop.records.experiments[0]["u"], run["u"])
    both = replace(
        pid(("u", "d"), ("y", "y2"), ("a", "b"), DT, Kp=np.eye(2), Ki=np.eye(2), low=(-3.0, -1.0), high=(3.0, 0.5)),
        curves=(Curve("d", [-1.0, 0.5], [-2.0, 7.0]), SQUARE),
    )
    assert [*both.inside.low, *both.inside.high] == pytest.approx([-4.0, -2.0, 3.9, 7.0])


def test_what_makes_no_sense_of_curves_is_refused(model, law, tmp_path):
    twice = (SQUARE, SQUARE)
    for make in (lambda: replace(law, curves=twice), lambda: replace(model, curves=twice)):
        with pytest.raises(InputError, match="two curves of one input"):
            make()
    scheduled = replace(model.core, schedules=(Channel("u", "V", "schedule"),), spans=[[-3.0, 3.0]])
    with pytest.raises(InputError, match="a static curve of an input that is the schedule"):
        HammersteinWienerModel("h", scheduled, (SQUARE,))
    with pytest.raises(InputError, match="its fallback, inverts curves"):
        MPCDesign(fallback=law).on(model.core)
    own = SimpleNamespace(name="mine", curves={"u": 1}, actuated=("u",))
    assert behind(own, model.core)[0] is own
    content = json.loads(save_controller(law, tmp_path / "pid.json").read_text())
    del content["curves"]
    (tmp_path / "pid.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="field 'curves' is missing"):
        load_controller(tmp_path / "pid.json")


def test_channels_say_what_they_are_behind_the_curve(model, law, records):
    limits = wb.check(law, {"loop": {"stable": True}}, model=model, records=records)
    assert any("f(u)" in box for box in limits.boxes)
    loop = as_arriving(law, model, records, limits_of({"loop": {"stable": True}}))
    assert (loop.law.actuated, [c.name for c in loop.model.inputs]) == (("f(u)",), ["f(u)"])
    assert loop.law.unit("f(u)") == "V"
    np.testing.assert_array_equal(loop.records.experiments[0]["f(u)"], SQUARE(records.experiments[0]["u"]))


# ---- machines of others --------------------------------------------------------------------------------------------------


def _oscillator(
    seed: int, arrives: Callable, law: ScheduledPID | None, given: np.ndarray, noise: float
) -> tuple[np.ndarray, ...]:
    """x'' = w^2 (g f(u) - x) - 2 z w x' by small Euler steps, under given inputs or a law that follows given set-points."""
    random = np.random.default_rng(seed)
    w, z, g = random.uniform(1.0, 3.0), random.uniform(0.3, 1.2), random.uniform(0.5, 2.0)
    x, v, state, steps = 0.0, 0.0, law.init() if law else None, 10
    y, u = np.empty(len(given)), np.array(given, dtype=float)
    for k in range(len(given)):
        y[k] = x + noise * random.standard_normal()
        if law is not None:
            (u[k],), state = law.step(state, given[[k]], y[[k]])
        for _ in range(steps):
            x, v = x + DT / steps * v, v + DT / steps * (w * w * (g * arrives(u[k]) - x) - 2.0 * z * w * v)
    return y, u


@pytest.mark.slow
def test_on_machines_with_curves_steps_settle_sooner_and_overshoot_less_than_under_a_linear_design():
    curves: list[Callable] = [lambda u: u * abs(u), lambda u: np.exp(u / 1.5) - 1.0, lambda u: 2.0 * np.tanh(u)]
    over, settled = [], []
    for seed, arrives in enumerate(curves):
        random, made = np.random.default_rng(seed), []
        for name in "ab":
            u = np.repeat(random.uniform(-3.0, 3.0, 120), 25)
            y, _ = _oscillator(seed, arrives, None, u, 0.02)
            made.append(Experiment.from_arrays(name, DT, inputs={"u": u}, outputs={"y": y}))
        far = [_oscillator(seed, arrives, None, np.full(600, end), 0.0)[0][-1] for end in (-2.6, 2.6)]
        r = np.repeat(random.uniform(*far, 8), 300)
        for method in (wb.HammersteinWiener(), wb.LTI()):
            law = ScheduledPIDDesign(low={"u": -3.0}, high={"u": 3.0}).on(method.fit(Dataset(tuple(made))))
            y, _ = _oscillator(seed, arrives, law, r, 0.0)
            assert np.abs(y).max() < 2.0 * np.abs(r).max()
            shares = [(y[k : k + 300] - r[k]) / (r[k] - r[k - 1]) for k in range(300, len(r), 300)]
            over.append(max(float(e.max()) for e in shares))
            settled.append(max(DT * (np.flatnonzero(np.abs(e) > 0.05)[-1] + 1) for e in shares))
    for k in range(0, len(over), 2):
        assert over[k] < max(0.2, over[k + 1])
        assert settled[k] < 0.7 * settled[k + 1]


@pytest.mark.parametrize(
    ("curve", "said"),
    [
        (DEAD, "the curve of u stands still from -0.5 to 0.5 V: its inverse is steep there"),
        (Curve("u", [-3.0, 1.0, 2.0, 3.0], [-4.0, 0.1, 0.1, 1.3]), "the curve of u stands still from 1 to 2 V"),
        (Curve("u", [-3.0, -2.8, 0.0, 0.2, 3.0], [-3.0, -3.0, 0.0, 0.0, 3.0]), "u stands still in parts from -3 to 0.2 V"),
    ],
)
def test_a_design_says_where_a_curve_stands_still(model, curve, said, tmp_path, capsys):
    replace(model, curves=(curve,)).save(tmp_path / "h.json")
    assert main(["design", "pid", "--model", str(tmp_path / "h.json"), "--out", str(tmp_path / "d")]) == 0
    assert said in capsys.readouterr().out


def test_the_command_line_from_records_to_firmware(model, law, records, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model.save("hammerstein.json")
    for e in records:
        wb.write_csv(e, tmp_path / f"{e.name}.csv")
    assert main(["design", "pid", "--model", "hammerstein.json", "--setpoint", "y=1", "--out", "d"]) == 0
    said = capsys.readouterr().out
    assert "u through the inverse of its curve, known from -3 to 3 V: gains and margins are of what arrives" in said
    assert "u from -3 to 3 V: always" in said
    own = load_controller("d/pid.json")
    held = float(own.curves[0].inverse(np.array(1.0 / 1.4)))
    assert f"takes u from {held:.2f}"[:-1] in said
    assert (tmp_path / "d" / "curves.csv").read_text().startswith("command,u,v\nu,-3.0,-4.0")
    assert main(["design", "pid", "--model", "hammerstein.json", "--high", "u=4", "--out", "wide"]) == 0
    assert "where the records have not shown its curve" in capsys.readouterr().out
    assert main(["simulate", "hammerstein.json", "--controller", "d/pid.json", "--setpoint", "y=1", "--out", "s"]) == 0
    (tmp_path / "l.toml").write_text("[loop]\nstable = true\n")
    words = ["--controller", "d/pid.json", "--limits", "l.toml", "--model", "hammerstein.json", "--records", "a.csv", "b.csv"]
    assert main(["check", *words, "--out", "k"]) == 0
    assert json.loads((tmp_path / "k" / "check.json").read_text())["status"] == "PROVED"
    assert main(["export", "d/pid.json", "--to", "c", "--out", "e"]) == 0
    assert "static const real CURVE_1_V" in (tmp_path / "e" / "pid.c").read_text()
    save_controller(law.inside, "plain.json")
    capsys.readouterr()
    assert main(["check", "--controller", "plain.json", *words[2:]]) == 2
    assert "knows nothing of the curve of u\n  mend: design a PID on this model" in capsys.readouterr().err
    assert main(["design", "mpc", "--model", "hammerstein.json"]) == 2
    assert "Hammerstein-Wiener" in capsys.readouterr().err


def test_a_loop_behind_curves_keeps_what_its_law_compensates(records, model, law):
    """What arrives is called f(u) there; the compensation went on to command u, and every check was refused."""
    added = Compensation("u", "coulomb@shaft", [0.0], [1.0], Curve("u", [-1.0, 1.0], [-0.1, 0.1]))
    loop = as_arriving(replace(law, compensations=(added,)), model, records, limits_of({"loop": {"stable": True}}))
    assert [own.input for own in loop.law.compensations] == ["f(u)"]
    assert loop.limits is not None
