"""Plant files on the command line: taken wherever a plant is, and never a way to run code."""

import json

import numpy as np
import pytest

from plants import PLANTS
from studies.arguments import choose_plant, find_plant
from studies.cli import main
from workbench.errors import InputError
from workbench.physics.extension import extension
from workbench.readers import read

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
    common = ["--experiment", "steps", "--quiet"]
    assert main(["simulate", path, *common, "--out", str(tmp_path / "a")]) == 0
    by_hand = ["--parameter", "M=97", "--effect", "coulomb@slide:level=20,width=0.02"]
    assert main(["simulate", "positioning-axis", *common, *by_hand, "--out", str(tmp_path / "b")]) == 0
    np.testing.assert_array_equal(read(tmp_path / "a/steps.csv").values, read(tmp_path / "b/steps.csv").values)
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
