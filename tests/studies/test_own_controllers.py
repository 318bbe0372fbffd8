"""Controllers of a user's own, named on the command line: run, checked and swept like designed ones, and refused by name."""

import json
import re
import sys

import numpy as np
import pytest

from controllers.pid import pid
from plants import WELDING_ROBOT
from studies.arguments import choose_controller
from studies.cli import main
from workbench.errors import InputError
from workbench.physics.controller import Controller
from workbench.readers import read_file
from workbench.simulation import Scenario, simulate

LAWS = '''
import numpy as np

class Loop:
    name, dt = "mine", 0.02
    references, measured, schedule, actuated = ("v_set",), ("v",), None, ("u",)

    def init(self, u=None):
        return np.array([0.0 if u is None else u[0]])


class Equation(Loop):
    """u = 8 e + z, z+ = z + dt 12 e"""
    gains = np.array([8.0, 0.24])

    def law(self, gains, state, r, y, rho):
        e = r[0] - y[0]
        return [gains[0] * e + state[0]], [state[0] + gains[1] * e]


class Stepped(Loop):
    def step(self, state, r, y, rho):
        e = r - y
        return 8.0 * e + state, state + 0.24 * e


LAW, STEPS = Equation(), Stepped()
'''
LIMITS = "[run]\nduration = 2.0\nsetpoints.v = [[0.0, 0.5]]\n[limits.v]\nhigh = {high}\n[loop]\nstable = false\n"
SWEEP = """
run = "closed-loop"
[parameters.m1]
values = [0.9, 1.1]
[fixed]
plant = "welding-robot"
run = {{ duration = 2.0, setpoints.v = [[0.0, 0.5]] }}
{more}
"""
HELD = ["--setpoint", "v=0.5", "--duration", "2", "--noise-free"]


@pytest.fixture
def laws(tmp_path):
    path = tmp_path / "laws.py"
    path.write_text(LAWS)
    return path


def runs(law, folder):
    assert main(["simulate", "welding-robot", "--controller", law, *HELD, "--out", str(folder)]) == 0
    return read_file(folder / "setpoint.csv")


@pytest.mark.slow
def test_both_kinds_close_the_loop_as_the_designed_law_of_the_same_gains_does(laws, tmp_path):
    designed = pid(("u",), ("v",), ("v_set",), 0.02, [[8.0]], [[12.0]])
    scenario = Scenario("s", {"v_set": np.full(100, 0.5)})
    expected = simulate(WELDING_ROBOT, designed, scenario).experiment
    equation, steps = (runs(f"{laws}:{name}", tmp_path / name) for name in ("LAW", "STEPS"))
    for name in ("u", "v"):
        np.testing.assert_allclose(equation[name], expected[name], atol=1e-12)
        np.testing.assert_allclose(steps[name], expected[name], atol=1e-12)
    content = json.loads((tmp_path / "LAW/simulate.json").read_text())
    assert "laws.py" in content["provenance"]["data"]
    assert content["runs"][0]["tracking"][0]["output"] == "v"
    assert isinstance(choose_controller(f"{laws}:LAW").law, Controller)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["LAW", "STEPS"])
def test_a_check_searches_the_plant_and_its_counterexample_names_the_law_which_is_named_again(laws, tmp_path, capsys, name):
    (tmp_path / "limits.toml").write_text(LIMITS.format(high=0.3))
    law, folder = f"{laws}:{name}", tmp_path / "checked"
    wanted = ["check", "--controller", law, "--limits", str(tmp_path / "limits.toml"), "--plant", "welding-robot"]
    assert main([*wanted, "--runs", "12", "--out", str(folder)]) == 1
    said = next(line for line in capsys.readouterr().out.splitlines() if "counterexample-1.json" in line)
    assert main([*said.split("again: workbench ")[1].split(), "--out", str(tmp_path / "said")]) == 0
    lost = str(folder / "counterexample-1.json")
    assert json.loads((folder / "counterexample-1.json").read_text())["controller"] == {"own": law}
    again = ["simulate", "--replay", lost, "--out", str(tmp_path / "again")]
    capsys.readouterr()
    assert main(again) == 2
    assert f"--replay {lost} --controller {law}" in capsys.readouterr().err
    assert main([*again, "--controller", law]) == 0
    assert "the same: the counterexample stands" in capsys.readouterr().out


@pytest.mark.slow
def test_a_sweep_runs_it_and_does_not_go_on_where_its_file_has_changed(laws, tmp_path, capsys):
    file, folder = tmp_path / "sweep.toml", tmp_path / "swept"
    file.write_text(SWEEP.format(more=""))
    for name in ("LAW", "STEPS"):
        wanted = ["sweep", str(file), "--controller", f"{laws}:{name}", "--out", str(folder / name)]
        assert main(wanted) == 0
    rows = [(folder / name / "sweep.csv").read_text().splitlines() for name in ("LAW", "STEPS")]
    values = [np.array([[float(v) for v in row.split(",")[2:6]] for row in own[-2:]]) for own in rows]
    np.testing.assert_allclose(values[0], values[1], rtol=1e-9)
    assert main([*wanted, "--resume"]) == 0
    laws.write_text(LAWS.replace("8.0", "9.0"))
    capsys.readouterr()
    assert main([*wanted, "--resume"]) == 2
    assert "holds rows" in capsys.readouterr().err


def test_only_the_command_line_names_code(laws, tmp_path, capsys):
    spy = tmp_path / "spy.py"
    spy.write_text("from pathlib import Path\nPath(__file__).with_suffix('.ran').write_text('ran')\n" + LAWS)
    file, inner = tmp_path / "sweep.toml", tmp_path / "law.json"
    file.write_text(SWEEP.format(more=f'controller = "{spy}:LAW"'))
    assert main(["sweep", str(file), "--out", str(tmp_path / "swept")]) == 2
    assert f"a law of your own is named with --controller {spy}:LAW" in capsys.readouterr().err
    for content in ({"own": f"{spy}:LAW"}, f"{spy}:LAW"):
        inner.write_text(json.dumps(content))
        assert main(["simulate", "welding-robot", "--controller", str(inner), *HELD]) == 2
        assert main(["sweep", str(file), "--controller", str(inner), "--out", str(tmp_path / "swept")]) == 2
    assert main(["export", f"{spy}:LAW", "--to", "c"]) == 2
    assert "is code, not numbers" in capsys.readouterr().err
    assert not spy.with_suffix(".ran").exists()


@pytest.mark.parametrize(
    ("change", "name", "said"),
    [
        (("", ""), "LOW", "unknown controller 'LOW'.*known: LAW, STEPS"),
        (("", ""), "Equation", "is a class.*make one: NAME = Equation"),
        (("", ""), "np", "no controller: it has no name, .*no law and gains"),
        (("    def law", "    def lav"), "LAW", "no law and gains .*or step"),
        (("gains = np", "gain = np"), "LAW", "it has no gains"),
        (("def init", "def start"), "LAW", "it has no init"),
        (('("v",), None', '"v", None'), "LAW", r"measured = 'v'.*expected a tuple of names"),
        (('("v_set",)', '("v_set", "w_set")'), "LAW", "2 set-points, 1 measured"),
        (("0.02", "0.0"), "LAW", "dt = 0.0"),
        (("e = r[0] - y[0]", "e = r[0] if r[0] > y[0] else y[0]"), "LAW", "its law: ValueError.*without an `if`"),
        (("], [state[0] + gains[1] * e]", "], []"), "LAW", "1 commands and a memory of 0.*expected 1 .* and 1"),
        (("LAW, STEPS", "__all__ = ["), "LAW", "is it Python"),
        (("LAW, STEPS = Equation(), Stepped()", ""), "LAW", "no controller in this file"),
    ],
)  # fmt: skip
def test_what_is_no_controller_is_refused_with_what_it_lacks(tmp_path, change, name, said):
    path = tmp_path / "laws.py"
    path.write_text(LAWS.replace(*change) if change[0] else LAWS)
    with pytest.raises(InputError, match=f"(?s){said}"):
        choose_controller(f"{path}:{name}")
    with pytest.raises(InputError, match=r"(?s)which controller in .*laws\.py:NAME"):
        choose_controller(str(path))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("0.02", "0.03"), "runs every 0.03 s, plant 'welding-robot' is sampled every 0.02 s"),
        (('("v",)', '("w",)'), "unknown output of the controller 'v'"),
        (('("v",), None', '("v", "w"), None'), "unknown measured channel 'w'"),
        (('("u",)', '("V1",)'), "unknown input 'V1'"),
        (("8.0 * e + state, state", "np.nan * e, state"), r"commands array\(\[nan\]\) at 0 s"),
        (("8.0 * e + state, state", "8.0 * e[0], state"), "expected 1 finite numbers, in an array"),
    ],
)
def test_what_does_not_fit_the_plant_is_refused(tmp_path, capsys, change, said):
    path = tmp_path / "laws.py"
    path.write_text(LAWS.replace(*change))
    assert main(["simulate", "welding-robot", "--controller", f"{path}:STEPS", *HELD, "--out", str(tmp_path / "run")]) == 2
    assert re.search(said, capsys.readouterr().err)


def test_two_files_of_ones_own_have_helpers_of_one_name_each_beside_itself(laws, tmp_path):
    """A law whose gain stands in params.py, and a plant with another params.py beside it."""
    texts = {"law": LAWS.replace("8.0 * e", "params.KP * e").replace("import numpy", "import params\nimport numpy")}
    texts["plant"] = "import params\nfrom plants import WELDING_ROBOT\nMINE = WELDING_ROBOT\nGAIN = params.KP\n"
    for name, gain in (("law", 8.0), ("plant", 2.0)):
        (tmp_path / name).mkdir()
        (tmp_path / name / f"{name}.py").write_text(texts[name])
        (tmp_path / name / "params.py").write_text(f"KP = {gain}\n")
    plant, law = f"{tmp_path / 'plant' / 'plant.py'}:MINE", f"{tmp_path / 'law' / 'law.py'}:STEPS"
    words = ["simulate", plant, "--controller", law, *HELD, "--out", str(tmp_path / "o")]
    assert main(words) == 0
    np.testing.assert_array_equal(read_file(tmp_path / "o" / "setpoint.csv")["v"], runs(f"{laws}:STEPS", tmp_path / "alone")["v"])
    named = json.dumps(json.loads((tmp_path / "o" / "simulate.json").read_text())["provenance"])
    assert named.count("params.py") == 2  # both are part of what was run
    assert choose_controller(law).files == (law.rpartition(":")[0], str(tmp_path / "law" / "params.py"))


def test_helpers_are_what_lies_beside_a_file_not_what_is_installed_below_it(tmp_path, monkeypatch):
    """A law with a package beside it and a virtual environment in the same folder: that one's modules stay as they are."""
    for name, text in (("own/__init__", ""), ("own/tuned", "KP = 8.0\n"), ("venv/site-packages/installed_thing", "KI = 0.24\n")):
        path = tmp_path / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path / "venv" / "site-packages"))
    (tmp_path / "law.py").write_text(f"import installed_thing\nimport own.tuned\n{LAWS}")
    try:
        files = choose_controller(f"{tmp_path / 'law.py'}:STEPS").files
        assert files == tuple(str(tmp_path / name) for name in ("law.py", "own/__init__.py", "own/tuned.py"))
        assert "installed_thing" in sys.modules
        assert not {"own", "own.tuned"} & {*sys.modules}
    finally:
        sys.modules.pop("installed_thing", None)


def test_a_sweep_does_not_go_on_where_a_helper_of_the_law_has_changed(tmp_path, capsys):
    (tmp_path / "law.py").write_text(
        LAWS.replace("8.0 * e", "params.KP * e").replace("import numpy", "import params\nimport numpy")
    )
    (tmp_path / "params.py").write_text("KP = 8.0\n")
    (tmp_path / "s.toml").write_text(SWEEP.format(more=""))
    words = ["sweep", str(tmp_path / "s.toml"), "--controller", f"{tmp_path / 'law.py'}:STEPS", "--out", str(tmp_path / "o")]
    assert main(words) == 0
    (tmp_path / "params.py").write_text("KP = 2.0\n")
    assert main([*words, "--resume"]) == 2
    assert "another sweep, job or version" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("law", "said"),
    [
        ("self.z = getattr(self, 'z', 0.0) + e\n        return 8.0 * e + self.z, state", "keeps something in itself"),
        ("state += e\n        return 8.0 * e + state, state", ""),
        ("self.last = np.array(e)\n        return 8.0 * e, state", ""),
    ],
)
def test_a_step_that_keeps_something_beside_its_memory_is_refused(tmp_path, law, said):
    text = LAWS.replace("return 8.0 * e + state, state + 0.24 * e", law)
    assert text != LAWS
    (tmp_path / "law.py").write_text(text)
    if said:
        with pytest.raises(InputError, match=said):
            choose_controller(f"{tmp_path / 'law.py'}:STEPS")
    else:  # its own memory, made anew by init, and what never comes back, do no harm
        assert choose_controller(f"{tmp_path / 'law.py'}:STEPS")


def test_a_memory_that_is_one_array_for_all_runs_is_refused(tmp_path):
    text = LAWS.replace("return 8.0 * e + state, state + 0.24 * e", "state += e\n        return 8.0 * e + state, state")
    text = text.replace("        return np.array([0.0 if u is None else u[0]])", "        return KEPT").replace(
        "class Loop:", "KEPT = np.zeros(1)\n\nclass Loop:"
    )
    (tmp_path / "law.py").write_text(text)
    with pytest.raises(InputError, match="changes its memory in place"):
        choose_controller(f"{tmp_path / 'law.py'}:STEPS")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("e = r[0] - y[0]\n", "e = (np.array(r) - np.array(y))[0]\n        e = e if np.isnan(e).any() else e\n", "its law"),
        ("gains[0] * e + state[0]]", "gains[0] * np.polyval([1.0, 0.0], e) * (e > 0) & (e < 1)]", "its law"),
        ('None, ("u",)', 'None, ("u", "u")', "name each channel once"),
        (
            "    gains =",
            "    def step(self, state, r, y, rho):\n        return r, state\n\n    gains =",
            "has law and step",
        ),
        ("def step(self, state, r, y, rho)", "def step(self, r, y)", "its step: TypeError"),
    ],
)
def test_what_could_not_be_compiled_or_told_apart_is_refused_before_a_run(tmp_path, old, new, said):
    assert old in LAWS
    (tmp_path / "law.py").write_text(LAWS.replace(old, new, 1))
    name = "STEPS" if "def step(self, r, y)" in new else "LAW"
    with pytest.raises(InputError, match=said):
        choose_controller(f"{tmp_path / 'law.py'}:{name}")


@pytest.mark.slow
def test_an_equation_that_commands_no_number_is_told_as_such(tmp_path, capsys):
    (tmp_path / "law.py").write_text(LAWS.replace("gains[0] * e + state[0]]", "gains[0] * np.sqrt(0.01 - y[0])]"))
    law = f"{tmp_path / 'law.py'}:LAW"
    assert main(["simulate", "welding-robot", "--controller", law, *HELD, "--out", str(tmp_path / "o")]) == 2
    assert "the law commands no number at t = " in capsys.readouterr().err
    (tmp_path / "s.toml").write_text(SWEEP.format(more=""))
    assert main(["sweep", str(tmp_path / "s.toml"), "--controller", law, "--out", str(tmp_path / "swept")]) == 0
    assert "the first: the law commands no number after " in capsys.readouterr().out


RUNAWAY = """
from workbench import Channel, Plant, Start
from controllers.pid import pid

WEAK = pid(("u",), ("y",), ("y_set",), 0.01, [[0.1]], [[0.1]])
PLANT = Plant(
    name="runaway", states=(Channel("x", "m"),), inputs=(Channel("u", "N", "input"),), outputs=(Channel("y", "m", "output"),),
    parameters=(), equation=lambda x, u, p, at: {"x": 4.0 * x.x + u.u}, measure=lambda x, p: {"y": x.x}, dt=0.01,
    start=Start({"x": 0.0}, ("u",), ("x",)),
)
"""


@pytest.mark.slow
def test_a_loop_that_runs_away_is_said_to_be_lost(tmp_path, capsys):
    path = tmp_path / "runaway.py"
    path.write_text(RUNAWAY)
    words = ["simulate", f"{path}:PLANT", "--controller", f"{path}:WEAK", "--setpoint", "y=1", "--duration", "3"]
    assert main([*words, "--out", str(tmp_path / "run")]) == 0
    assert "the loop is lost: " in capsys.readouterr().out
