"""The verbs of the front door: they answer what the commands answer, hand out nothing that loses, and write whole folders."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import workbench as wb
from plants import WELDING_ROBOT
from studies.cli import main
from studies.experiments import measured
from workbench.answers.answer import Answer, NotHandedOutError
from workbench.diagnosis.answer import Finding
from workbench.diagnosis.calibrate import trajectories

HIDDEN = {"coulomb@rail": {"level": 0.3}}
OBJECTION = "the extended plant is worse on held-out records"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("records")
    return [str(wb.write_csv(measured(WELDING_ROBOT, name, 3, HIDDEN), folder / f"{name}.csv")) for name in ("rbs", "prbs")]


@pytest.fixture(scope="module")
def found(files):
    return wb.diagnose(WELDING_ROBOT, wb.read(files[0]), wb.read(files[1]))


@pytest.fixture(scope="module")
def done(files):
    return wb.calibrate(WELDING_ROBOT, wb.read(files[0]), wb.read(files[1]), parameters=["m1"])


def numbers(path):
    """A JSON file without what must differ: where it came from, where it lies, how long it took."""
    content = json.loads(Path(path).read_text(encoding="utf-8"))
    for key in ("provenance", "seconds", "file", "extended", "next_experiment"):
        content.pop(key, None)
    return content


def test_diagnose_names_what_is_hidden_and_its_plant_runs_closer_to_the_held_out_record(found, files):
    assert found.finding is Finding.NAMED
    (cause,) = found.causes
    assert cause.key == "coulomb@rail"
    level = cause.parameters["level"]
    assert level.low < HIDDEN["coulomb@rail"]["level"] < level.high
    held = wb.read(files[1])
    before, after = (trajectories(plant, held)[0] for plant in (WELDING_ROBOT, found.plant))
    errors = [float(((run.measured - run.simulated) ** 2)[:, 0].mean()) for run in (before, after)]
    assert errors[1] < 0.25 * errors[0]


def test_diagnose_writes_what_the_command_writes(found, files, tmp_path):
    assert found.save(tmp_path / "verb") == tmp_path / "verb"
    command = tmp_path / "command"
    assert main(["diagnose", files[0], "--plant", "welding-robot", "--holdout", files[1], "--out", str(command)]) == 0
    assert numbers(tmp_path / "verb" / "diagnosis.json") == numbers(command / "diagnosis.json")
    assert numbers(tmp_path / "verb" / "extended.json") == numbers(command / "extended.json") | {"base": "welding-robot"}
    assert (tmp_path / "verb" / "report.html").exists()


def test_calibrate_writes_what_the_command_writes(done, files, tmp_path):
    done.save(tmp_path / "verb")
    command = tmp_path / "command"
    words = ["calibrate", files[0], "--plant", "welding-robot", "--holdout", files[1], "--parameters", "m1"]
    assert main([*words, "--out", str(command)]) == 0
    assert numbers(tmp_path / "verb" / "calibration.json") == numbers(command / "calibration.json")
    assert numbers(tmp_path / "verb" / "extended.json") == numbers(command / "extended.json")


def test_a_saved_answer_says_which_files_it_rests_on(found, done, tmp_path):
    for answer, name in ((found, "diagnosis.json"), (done, "calibration.json")):
        folder = answer.save(tmp_path / name.removesuffix(".json"))
        source = json.loads((folder / name).read_text(encoding="utf-8"))["provenance"]
        assert set(source["data"]) == {"rbs.csv", "prbs.csv"}


def test_an_answer_says_itself_in_a_few_lines_and_draws_its_page(found, done):
    for answer in (found, done):
        assert isinstance(answer, Answer)
        lines = repr(answer).splitlines()
        assert 1 <= len(lines) <= 13
        assert max(map(len, lines)) <= 110
        assert "<svg" in answer.plot().figure_svg
        assert "<svg" in answer._repr_html_()
        json.dumps(answer.to_dict(), allow_nan=False, default=list)
    assert repr(found).startswith("NAMED")
    assert "prbs" in found.plot("v, ").title
    with pytest.raises(wb.InputError, match="there is: "):
        found.plot("nothing of the kind")


def test_what_the_referee_objects_to_is_not_handed_out_unless_it_is_accepted(found, done, tmp_path):
    worse = (
        replace(found, diagnosis=replace(found.diagnosis, objections=(OBJECTION,))),
        replace(done, calibration=replace(done.calibration, objections=(OBJECTION,))),
    )
    for number, (good, answer) in enumerate(zip((found, done), worse, strict=True)):
        folder = good.save(tmp_path / str(number))
        assert (folder / "extended.json").exists()
        with pytest.raises(NotHandedOutError, match=OBJECTION):
            _ = answer.plant
        answer.save(folder)
        assert not (folder / "extended.json").exists()  # that of the former answer
        taken = replace(answer, accepted=True)
        assert [q.value for q in taken.plant.parameters] == [q.value for q in good.plant.parameters]
        taken.save(folder)
        assert (folder / "extended.json").exists()


def test_causes_are_a_table(found):
    pytest.importorskip("pandas")
    frame = found.to_frame()
    assert set(frame["effect"]) == {"coulomb"}
    assert bool(frame["sure"].iloc[0])


# ---- the public list -----------------------------------------------------------------------------------------------------


def test_every_public_name_loads_and_none_hides_a_module():
    modules = {path.stem for path in Path(wb.__file__).parent.iterdir() if path.suffix in ("", ".py")}
    for name in wb.__all__:
        assert getattr(wb, name) is not None
        assert name not in modules, f"workbench.{name} is a module and a public name"


def test_importing_the_workbench_loads_nothing_that_it_does_not_need():
    code = "import sys, workbench; print(sorted({'numpy', 'scipy', 'numba', 'casadi', 'matplotlib'} & set(sys.modules)))"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "[]"
