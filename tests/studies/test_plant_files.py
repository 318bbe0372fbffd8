"""Plant files on the command line: taken wherever a plant is, and never a way to run code."""

import json
import sys

import numpy as np
import pytest

from plants import PLANTS
from studies.arguments import choose_plant, find_plant
from studies.cli import main
from workbench.errors import InputError
from workbench.physics.controller import Playback
from workbench.physics.extension import extension
from workbench.readers import read_file, write_csv
from workbench.simulation import Scenario, simulate

AXIS = PLANTS["positioning-axis"]
FOUND = extension(AXIS, "positioning-axis", {"M": 97.0}, {"coulomb@slide": {"level": 20.0, "width": 0.02}})
SPY = """
from pathlib import Path
Path(__file__).with_suffix(".ran").write_text("ran")
from dataclasses import replace
from plants import PLANTS
PLANT = replace(PLANTS["positioning-axis"], name="mine")
"""


def test_the_command_line_takes_a_plant_file_wherever_it_takes_a_plant(tmp_path):
    path = str(FOUND.save(tmp_path / "p.json"))
    for text in (path, f"positioning-axis+{path}"):
        assert find_plant(text).effects == FOUND.effects
    common = ["--experiment", "steps", "--noise-free"]
    assert main(["simulate", path, *common, "--out", str(tmp_path / "a")]) == 0
    by_hand = ["--parameter", "M=97", "--effect", "coulomb@slide:level=20,width=0.02"]
    assert main(["simulate", "positioning-axis", *common, *by_hand, "--out", str(tmp_path / "b")]) == 0
    np.testing.assert_array_equal(read_file(tmp_path / "a/steps.csv").values, read_file(tmp_path / "b/steps.csv").values)
    source = json.loads((tmp_path / "a/simulate.json").read_text())["provenance"]
    assert "p.json" in source["data"]
    assert source["configuration"]["effects_of_plant"] == FOUND.effects


def test_a_plant_file_does_not_run_the_code_that_it_names(tmp_path):
    code = tmp_path / "mine.py"
    code.write_text(SPY)
    path = tmp_path / "p.json"
    for base in (f"{code}:PLANT", "this:d"):  # a file, and a module that prints when it is imported
        path.write_text(json.dumps({**json.loads(FOUND.save(path).read_text()), "plant": "mine", "base": base}))
        with pytest.raises(InputError, match="no machine of the workbench") as refused:
            find_plant(str(path))
        assert f"{base}+{path}" in refused.value.mend
    assert not code.with_suffix(".ran").exists()
    chosen = choose_plant(f"{code}:PLANT+{path}")
    assert code.with_suffix(".ran").exists()
    assert chosen.plant.effects == FOUND.effects
    assert chosen.base == f"{code}:PLANT"


LAW = """
from workbench.physics.effects import Domain, Effect, EffectParameter

def law(e, shaft):
    share = shaft.speed / e.speed
    return -2.0 * e.peak * share / (1.0 + share**2)

PEAK = EffectParameter("peak", "N m", low=0.0)
SPEED = EffectParameter("speed", "rad/s", low=0.1, high=1e3, default=10.0, shape=True, grid=(3.0, 10.0, 30.0))
BRAKE = Effect(
    "eddy-brake", "shaft", (PEAK, SPEED), "Eddy currents brake {place}.", "Speeds far apart.",
    "torque = -2 * peak * (v / speed) / (1 + (v / speed)^2)", law, Domain.SPEED,
)
"""
WHEEL = """
from workbench import Channel, Parameter, Plant
from workbench.physics.effects import Shaft
from {law} import BRAKE

PLANT = Plant(
    name="flywheel", states=(Channel("w", "rad/s"),), inputs=(Channel("M", "N m", "input"),),
    outputs=(Channel("w", "rad/s", "output"),),
    parameters=(Parameter("J", 0.02, "kg m^2", tolerance=0.1), Parameter("b", 0.01, "N m s/rad", tolerance=0.3)),
    equation=lambda x, u, p, at: {{"w": (u.M - p.b * x.w + at.wheel.torque()) / p.J}}, measure=lambda x, p: {{"w": x.w}},
    dt=0.05, ports=(Shaft("wheel", "w"),), noise={{"w": 0.005}}, own_effects=(BRAKE,),
)
"""
MINE = """
from dataclasses import replace
from plants import WELDING_ROBOT
from {law} import BRAKE

MINE = replace(WELDING_ROBOT, own_effects=(BRAKE,))
"""


@pytest.fixture
def own(tmp_path):
    """A plant and a machine with an effect of their own, which a file beside theirs holds."""
    law = f"law_{tmp_path.name}"  # a module is loaded once in a process
    for name, text in ((law, LAW), ("wheel", WHEEL.format(law=law)), ("mine", MINE.format(law=law))):
        (tmp_path / f"{name}.py").write_text(text)
    yield tmp_path
    sys.modules.pop(law, None)


@pytest.mark.slow
def test_an_own_effect_is_simulated_found_and_kept_in_a_plant_file(own, capsys):
    """Simulated by the library, diagnosed and simulated again by the command line."""
    wheel = f"{own / 'wheel.py'}:PLANT"
    plant, numbers = find_plant(wheel), {"peak": 0.3, "speed": 6.0}
    for seed in (1, 2, 3):
        levels = np.random.default_rng(seed).uniform(-1.0, 1.0, 25)
        scenario = Scenario(f"run{seed}", {"M": np.repeat(levels, 20)}, seed=seed)
        run = simulate(plant, Playback(("M",), plant.dt), scenario, effects={"eddy-brake@wheel": numbers})
        write_csv(run.experiment, own / f"run{seed}.csv")
    records = [str(own / f"run{seed}.csv") for seed in (1, 2, 3)]
    assert main(["diagnose", *records[:2], "--plant", wheel, "--holdout", records[2], "--out", str(own / "found")]) == 0
    said = capsys.readouterr().out
    assert "Eddy currents brake wheel." in said
    extended = f"{wheel}+{own / 'found' / 'extended.json'}"
    assert extended in said
    content = json.loads((own / "found/extended.json").read_text())
    assert content["base"] == wheel
    assert "wheel.py" in json.loads((own / "found/diagnosis.json").read_text())["provenance"]["data"]
    found = content["effects"]["eddy-brake@wheel"]
    assert found == pytest.approx(numbers, rel=0.05)

    by_hand = [f"--parameter={name}={value!r}" for name, value in content["parameters"].items()]
    by_hand += ["--effect", f"eddy-brake@wheel:peak={found['peak']!r},speed={found['speed']!r}"]
    assert main(["simulate", extended, "--inputs-from", records[2], "--out", str(own / "a")]) == 0
    assert main(["simulate", wheel, *by_hand, "--inputs-from", records[2], "--out", str(own / "b")]) == 0
    np.testing.assert_array_equal(read_file(own / "a/run3.csv").values, read_file(own / "b/run3.csv").values)
    with pytest.raises(InputError, match="no machine of the workbench"):
        find_plant(str(own / "found/extended.json"))


def test_a_machine_of_the_workbench_with_own_effects_keeps_its_experiments(own, capsys):
    mine = f"{own / 'mine.py'}:MINE"
    assert main(["effects", mine]) == 0
    assert "eddy-brake@rail: peak [N], speed [m/s] (usually 0.1)" in capsys.readouterr().out
    assert (choose_plant(mine).base, choose_plant(mine).machine) == (mine, "welding-robot")
    (own / "twice.py").write_text((own / "mine.py").read_text().replace("(BRAKE,)", "(BRAKE, BRAKE)"))
    with pytest.raises(InputError, match="two have this id"):
        find_plant(f"{own / 'twice.py'}:MINE")
    path = extension(find_plant(mine), mine, {}, {"eddy-brake@rail": {"peak": 0.3}}).save(own / "p.json")
    assert choose_plant(f"{mine}+{path}").machine == "welding-robot"
    assert main(["simulate", f"{mine}+{path}", "--experiment", "rbs", "--out", str(own / "run")]) == 0
    assert main(["simulate", f"welding-robot+{path}", "--experiment", "rbs", "--out", str(own / "run")]) == 2
    assert "unknown effect 'eddy-brake@rail'" in capsys.readouterr().err
