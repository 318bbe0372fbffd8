"""The verb `check` in Python: what the command says, nothing proved of a linear form that is not the law, all of it on disk."""

import json
from dataclasses import replace
from types import SimpleNamespace

import control
import numpy as np
import pytest

import workbench as wb
from controllers.files import save_controller
from controllers.pid import pid
from plants import WELDING_ROBOT
from studies.cli import main
from studies.experiments import measured
from tests.controllers.test_scheduled_pid import scheduled
from workbench.robustness.linear_law import without_linear_form
from workbench.robustness.verdict import Status

LIMITS = {
    "run": {"duration": 6.0, "setpoints": {"v": ((0.0, 0.0), (2.0, 0.2))}},
    "limits": {"v": {"low": -0.5, "high": 0.6}, "u": {"low": -50.0, "high": 50.0}},
}
LAW = pid(("u",), ("v",), ("v_set",), 0.02, [2.0], [3.0], low=[-60.0], high=[60.0])


@pytest.fixture(scope="module")
def records():
    own = (measured(WELDING_ROBOT, name, 3 + i) for i, name in enumerate(("prbs", "rbs")))
    return wb.Dataset(tuple(e.with_roles(inputs=("u",), outputs=("v",)) for e in own))


@pytest.fixture(scope="module")
def model(records):
    return wb.LTI(order=2, feedthrough=False).fit(records)


@pytest.mark.slow
def test_it_says_what_the_command_says(records, model, tmp_path, capsys):
    found = wb.check(LAW, LIMITS, model=model, records=records, plant=WELDING_ROBOT, runs=60)
    for e in records:
        wb.write_csv(e, tmp_path / f"{e.name}.csv")
    model.save(tmp_path / "lti.json")
    save_controller(LAW, tmp_path / "pid.json")
    toml = "[run]\nduration = 6.0\nsetpoints.v = [[0.0, 0.0], [2.0, 0.2]]\n"
    (tmp_path / "limits.toml").write_text(toml + "[limits]\nv = {low = -0.5, high = 0.6}\nu = {low = -50.0, high = 50.0}\n")
    files = [str(tmp_path / f"{e.name}.csv") for e in records]
    own = ["--controller", "pid.json", "--limits", "limits.toml", "--model", "lti.json", "--plant", "welding-robot"]
    own = [str(tmp_path / word) if word.endswith((".json", ".toml")) else word for word in own]
    code = main(["check", *own, "--records", *files, "--runs", "60", "--out", str(tmp_path / "command")])
    command = json.loads((tmp_path / "command" / "check.json").read_text())
    mine = found.save(tmp_path / "verb")
    again = json.loads((mine / "check.json").read_text())
    assert code == (found.status is Status.FAILED)
    for key in ("status", "verdicts", "trial"):
        assert again[key] == command[key] == found.to_dict()[key]
    assert sorted(p.name for p in mine.iterdir()) == sorted(p.name for p in (tmp_path / "command").iterdir())
    said = capsys.readouterr().out
    assert all(str(v) in said for v in found.verdicts)
    assert repr(found).startswith(f"{found.status.value}: ")
    assert list(found.to_frame()["verdict"]) == [v.status.value for v in found.verdicts]
    assert found.plot().title
    assert "tried on" in found.sentences[1]


@pytest.mark.slow
def test_what_failed_is_written_and_runs_again(records, model, tmp_path):
    tight = {**LIMITS, "limits": {"v": {"high": 0.1}}}
    found = wb.check(LAW, tight, model=model, records=records, plant=WELDING_ROBOT, runs=60)
    assert found.status is Status.FAILED
    folder = found.save(tmp_path, base="welding-robot")
    shown = [v.witness for v in found.verdicts if v.status is Status.FAILED]
    assert shown
    for name in shown:
        assert main(["simulate", "--replay", str(folder / name), "--out", str(tmp_path / "again")]) == 0


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({}, "check on what"), ({"model": 1}, "model and records go together"), ({"records": 1, "plant": 1}, "go together"),
        ({"fitted": ["x.json"], "model": 1, "records": 1}, "fitted"), ({"plant": "welding-robot"}, "expected a plant"),
        ({"model": "m.json", "records": 1}, "expected an LPV"), ({"plant": WELDING_ROBOT, "limits": 5}, "limits: int 5"),
        ({"plant": WELDING_ROBOT, "runs": 0}, "runs = 0"), ({"plant": WELDING_ROBOT, "nodes": 2.5}, "nodes = 2.5"),
    ],
)  # fmt: skip
def test_what_does_not_fit_together_is_refused(given, problem):
    with pytest.raises(wb.InputError, match=problem):
        wb.check(LAW, **({"limits": LIMITS} | given))


@pytest.mark.parametrize(
    ("limits", "problem"),
    [({}, "nothing to keep"), ({"limits": {"v": {"high": np.nan}}}, "plain finite numbers"), ({"limit": {}}, "unknown table")],
)
def test_limits_that_make_no_sense_are_refused(limits, problem):
    with pytest.raises(wb.InputError, match=problem):
        wb.check(LAW, limits, plant=WELDING_ROBOT)


# ---- a linear form is not believed ---------------------------------------------------------------------------------------


def drawn(seed):
    """A PID of any size, with limits, a rate, an offset that may lie beyond them, weights and a filter."""
    random = np.random.default_rng(seed)
    nu, ny = random.integers(1, 3, 2)
    size = 10.0 ** random.uniform(-3, 3)
    gains = [size * random.normal(size=(1, nu, ny)) for _ in range(4)]
    low, high = np.sort(random.normal(size=(2, nu)) * 10.0 ** random.uniform(-2, 3), axis=0)
    none = np.zeros((nu, ny))
    return replace(
        pid(("u1", "u2")[:nu], ("y1", "y2")[:ny], ("r1", "r2")[:ny], 10.0 ** random.uniform(-3, 0), none, none),
        Kp=gains[0], Ki=gains[1] * random.choice([0.0, 1.0], p=[0.2, 0.8]), Kd=gains[2] * random.choice([0.0, 1e-2]),
        Kr=gains[3] * random.choice([0.0, 1.0]), u0=random.normal(size=(1, nu)) * random.choice([0.0, 1.0, 10.0]),
        b=random.uniform(size=ny), c=random.choice([0.0, 1.0], size=ny), Tf=float(random.choice([0.0, 0.1])),
        low=low - 1e-6, high=high + 1e-6, rate=10.0 ** random.uniform(-1, 3, nu),
    )  # fmt: skip


@pytest.mark.slow
def test_laws_of_the_house_are_their_linear_forms():
    assert [said for said in map(without_linear_form, (LAW, scheduled())) if said] == []
    assert not [said for said in (without_linear_form(drawn(seed)) for seed in range(150)) if said]


class Claims(SimpleNamespace):
    """The law of a PID beside a linear form that may be another's."""

    __hash__ = object.__hash__

    def init(self, u=None):
        return LAW.init(u)

    def law(self, gains, state, r, y, rho):
        return LAW.law(gains, state, r, y, rho)

    def at(self, rho):
        own = LAW.at(rho)
        return self.change(np.array(own.A), np.array(own.B), np.array(own.C), np.array(own.D), own.dt)

    def offset(self, rho):
        return LAW.offset(rho) + self.beside


def claims(change, beside=0.0):
    own = ("name", "dt", "references", "measured", "schedule", "actuated", "gains", "low", "high", "rate", "span")
    return Claims(**{key: getattr(LAW, key) for key in own}, change=change, beside=beside)


def same(A, B, C, D, dt):
    return control.StateSpace(A, B, C, D, dt)


@pytest.mark.parametrize(
    ("change", "beside", "said"),
    [
        (lambda A, B, C, D, dt: same(A, B, C, 1.01 * D, dt), 0.0, "answers otherwise"),
        (lambda A, B, C, D, dt: same(A, 0.99 * B, C, D, dt), 0.0, "answers otherwise"),
        (lambda A, B, C, D, dt: same(0.999 * A, B, C, D, dt), 0.0, "answers otherwise"),
        (lambda A, B, C, D, dt: same(A, B, -C, D, dt), 0.0, "answers otherwise"),
        (lambda A, B, C, D, dt: same(A, B[:, ::-1], C, D, dt), 0.0, "answers otherwise"),
        (lambda A, B, C, D, dt: same([], [], [], D, dt), 0.0, "answers otherwise"),
        (lambda A, B, C, D, dt: same(A, B[:, :1], C, D[:, :1], dt), 0.0, "ValueError"),
        (same, 0.1, "its offset"),
    ],
)  # fmt: skip
def test_a_linear_form_that_is_not_the_law_proves_nothing(records, model, change, beside, said):
    found = wb.check(claims(change, beside), {"loop": {"stable": True}}, model=model, records=records)
    assert found.status is Status.UNDECIDED
    assert said in found.verdicts[0].sentence
    assert "nothing is proved of it" in found.verdicts[0].sentence


class Bent(Claims):
    """A law that gives 1.5 times what it should where its error is not between the two numbers `bent`."""

    def law(self, gains, state, r, y, rho):
        u, state = LAW.law(gains, state, r, y, rho)
        small, large = self.bent
        size = abs(float(r[0] - y[0]))
        return (u if small < size < large else [1.5 * own for own in u]), state


@pytest.mark.parametrize("bent", [(-1.0, 2.0), (1e-3, np.inf)])
def test_a_law_that_is_its_linear_form_for_some_sizes_only_has_none(bent):
    law = claims(same)
    whole, bent = Bent(**law.__dict__, bent=(-1.0, np.inf)), Bent(**law.__dict__, bent=bent)
    assert not without_linear_form(whole)
    assert "answers otherwise" in without_linear_form(bent)


class Summed(SimpleNamespace):
    """u = u0 + e + I, I+ = I + ki e: beyond `kink` twice as much; its parts may cancel to next to nothing."""

    __hash__ = object.__hash__
    name, dt, references, measured, actuated, schedule = "summed", 0.1, ("r",), ("y",), ("u",), None
    gains, span = (), (0.0, 0.0)
    kink = np.inf

    def init(self, u=None):
        return [self.I0]

    def law(self, gains, state, r, y, rho):
        e = r[0] - y[0]
        u = self.u0 + e + state[0] - self.middle
        u = self.middle + u + np.sign(u) * max(abs(u) - self.kink, 0.0)
        return [min(max(u, self.low[0]), self.high[0])], [state[0] + 0.1 * e]

    def at(self, rho):
        return control.StateSpace([[1.0]], [[0.1, -0.1]], [[1.0]], [[1.0, -1.0]], self.dt)

    def offset(self, rho):
        return np.array([self.u0 + self.I0])


def summed(u0, first, low, high, **more):
    none = np.full(1, np.inf)
    return Summed(u0=u0, I0=first, low=np.array([low]), high=np.array([high]), rate=none, middle=u0 + first, **more)


@pytest.mark.parametrize(("u0", "first"), [(2.0, 0.0), (50.0, -48.0), (500.0, -498.0), (5e4, -49998.0)])
def test_parts_that_cancel_are_rounded_and_refute_nothing(u0, first):
    assert without_linear_form(summed(u0, first, 0.0, 5.0)) == ""


@pytest.mark.parametrize("kink", [0.1, 1.0, 2.0, 3.5, 4.5])
def test_a_law_that_is_bent_anywhere_within_its_limits_has_no_linear_form(kink):
    assert without_linear_form(summed(0.0, 0.0, -5.0, 5.0)) == ""
    assert "answers otherwise" in without_linear_form(summed(0.0, 0.0, -5.0, 5.0, kink=kink))


def test_a_linear_form_is_asked_for_at_the_schedule_values_that_are_proved():
    """Gains that are off within a tenth of the span, between its ends and its middle."""
    house = scheduled()
    low, high = house.span
    hole = low + 0.3 * (high - low)

    def at(rho):
        own = house.at(rho)
        gain = 1.1 if abs(rho - hole) < 0.05 * (high - low) else 1.0
        return control.StateSpace(own.A, own.B, own.C, gain * np.array(own.D), own.dt)

    own = ("name", "dt", "references", "measured", "schedule", "actuated", "gains", "low", "high", "rate", "span")
    holed = SimpleNamespace(**{key: getattr(house, key) for key in (*own, "init", "law", "offset")}, at=at)
    assert not without_linear_form(holed)
    assert "answers otherwise" in without_linear_form(holed, np.linspace(low, high, 11).tolist())


@pytest.mark.slow
def test_a_law_of_ones_own_with_a_true_linear_form_is_proved_and_refuted_like_one_of_the_house(records, model, tmp_path):
    asked = {**LIMITS, "limits": {"v": {"low": -0.5, "high": 0.6}}}
    own, house = (wb.check(law, asked, model=model, records=records) for law in (claims(same), LAW))
    assert [v.status for v in own.verdicts] == [v.status for v in house.verdicts]
    assert Status.PROVED in {v.status for v in own.verdicts}
    tight = {**LIMITS, "limits": {"v": {"high": 0.1}}}
    lost = wb.check(claims(same), tight, model=model, records=records)
    assert lost.status is Status.FAILED
    (name,) = [v.witness for v in lost.verdicts if v.witness]
    assert json.loads((lost.save(tmp_path) / name).read_text())["controller"] == {"own": f"{__name__}:Claims"}


OWN = """
import numpy as np
from controllers.pid import pid

_LAW = pid(("u",), ("v",), ("v_set",), 0.02, [2.0], [3.0], low=[-60.0], high=[60.0])


class Own:
    name, dt, references, measured, actuated, schedule = "own", 0.02, ("v_set",), ("v",), ("u",), None
    gains, low, high, rate, span = _LAW.gains, _LAW.low, _LAW.high, _LAW.rate, _LAW.span
    init, law, at, offset = _LAW.init, _LAW.law, _LAW.at, _LAW.offset


LAW = Own()
"""


@pytest.mark.slow
def test_a_run_of_ones_own_law_is_run_again_with_the_law_named_on_the_command_line(records, model, tmp_path, capsys):
    (tmp_path / "own.py").write_text(OWN)
    (tmp_path / "limits.toml").write_text(
        "[run]\nduration = 6.0\nsetpoints.v = [[0.0, 0.0], [2.0, 0.2]]\n[limits.v]\nhigh = 0.1\n"
    )
    for e in records:
        wb.write_csv(e, tmp_path / f"{e.name}.csv")
    model.save(tmp_path / "lti.json")
    law, out = f"{tmp_path / 'own.py'}:LAW", tmp_path / "out"
    files = ["--model", str(tmp_path / "lti.json"), "--records", *(str(tmp_path / f"{e.name}.csv") for e in records)]
    assert main(["check", "--controller", law, "--limits", str(tmp_path / "limits.toml"), *files, "--out", str(out)]) == 1
    (path,) = out.glob("passage-*.json")
    assert json.loads(path.read_text())["controller"] == {"own": law}
    assert main(["simulate", "--replay", str(path)]) == 2
    assert "which is code of one's own" in capsys.readouterr().err
    assert main(["simulate", "--replay", str(path), "--controller", law]) == 0
