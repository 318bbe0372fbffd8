"""The verbs of the front door: they answer what the commands answer, hand out nothing that loses, and write whole folders."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import workbench as wb
from plants import WELDING_ROBOT
from studies.cli import main
from studies.experiments import measured
from workbench.answers.answer import Answer
from workbench.diagnosis.answer import Finding
from workbench.diagnosis.calibrate import trajectories
from workbench.errors import NotHandedOutError
from workbench.files import sha256

pytestmark = pytest.mark.slow

ROLES = {"inputs": "u", "outputs": "v"}
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


def test_records_without_a_file_are_told_by_the_hash_of_their_samples(files, tmp_path):
    data = wb.read(files[0], **ROLES)
    (one,) = data
    gone = replace(one, file=str(tmp_path / "gone.csv"))
    other = replace(one, file="", values=one.values + 1e-9)
    methods = {"lti": wb.LTI(order=2)}
    hashes = {}
    for name, own in (("file", one), ("gone", gone), ("arrays", replace(one, file="")), ("other", other)):
        folder = wb.identify(own, methods=methods).save(tmp_path / name)
        source = json.loads((folder / "scores.json").read_text(encoding="utf-8"))["provenance"]["data"]
        ((_, hashes[name]),) = source.items()
    assert hashes["file"] == sha256(files[0])
    assert hashes["gone"] == hashes["arrays"]
    assert len({*hashes.values()}) == 3


def test_an_answer_says_itself_in_a_few_lines_and_draws_its_page(found, done):
    for answer in (found, done):
        assert isinstance(answer, Answer)
        lines = repr(answer).splitlines()
        assert 1 <= len(lines) <= 13
        assert max(map(len, lines)) <= 110
        assert "<svg" in answer.plot().figure_svg
        assert answer.plot().figure.axes
        assert "<svg" in answer._repr_html_()
        json.dumps(answer.to_dict(), allow_nan=False, default=list)
    assert repr(found).startswith("NAMED")
    assert "prbs" in found.plot("v, ").title
    with pytest.raises(wb.InputError, match="there is: "):
        found.plot("nothing of the kind")


def test_an_answer_says_itself_without_drawing_and_its_plant_is_one_object(found, done, files, monkeypatch):
    data = wb.read(files[0], **ROLES)
    models = wb.identify(data, methods={"lti": wb.LTI(order=2)})
    said = models.report().verdict
    monkeypatch.setattr(Answer, "report", lambda *_: 1 / 0)
    for answer in (found, done, models):
        monkeypatch.setattr(type(answer), "report", lambda *_: 1 / 0)
        assert repr(answer)
    assert models.sentences[0] == said
    assert found.plant is found.plant
    assert done.plant is done.plant


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


# ---- identify ------------------------------------------------------------------------------------------------------------


def test_identify_writes_what_the_command_writes(files, tmp_path):
    data, held_out = wb.read(files[0], **ROLES), wb.read(files[1], **ROLES)
    answer = wb.identify(data, held_out, methods={"lti": wb.LTI(order=2), "ssm": wb.SSM(order=2)})
    answer.save(tmp_path / "verb")
    words = ["identify", files[0], "--output", "v", "--inputs", "u", "--holdout", files[1], "--model", "lti,ssm", "--order", "2"]
    assert main([*words, "--out", str(tmp_path / "command")]) == 0
    for name in ("lti.json", "ssm.json"):
        assert numbers(tmp_path / "verb" / name) == numbers(tmp_path / "command" / name)
    verb, command = (numbers(tmp_path / side / "scores.json")["models"] for side in ("verb", "command"))
    assert [own["scores"] for own in verb] == [own["scores"] for own in command]
    assert [Path(own["file"]).name for own in verb] == ["lti.json", "ssm.json"]
    with pytest.raises(wb.InputError, match="several models: lti, ssm"):
        _ = answer.model
    assert set(answer.models) == {"lti", "ssm"}


def test_identify_takes_the_method_that_runs_best_on_what_it_was_not_fitted_to_and_says_so(files):
    answer = wb.identify(
        wb.read(files[0], **ROLES), wb.read(files[1], **ROLES), methods={"lti": wb.LTI(2), "ssm": wb.SSM(2)}, best=True
    )
    assert answer.choice.method == max(answer.choice.fit, key=answer.choice.fit.get)
    assert list(answer.models) == [answer.choice.method]
    assert answer.choice.method in repr(answer)
    (fit,) = (s.FIT for s in answer.scores if (s.split, s.horizon) == ("held-out", "free-run"))
    assert fit == pytest.approx(wb.score(answer.model, wb.read(files[1], **ROLES), "held-out", ["free-run"])[0].FIT)


def test_a_leaking_model_is_not_handed_out(tmp_path):
    random = np.random.default_rng(1)
    u = random.normal(size=600)
    y = np.append(np.zeros(1), u[:-1]) + 0.1 * random.normal(size=600)
    data = wb.read({"u": u, "y": y, "copy": y}, inputs=["u", "copy"], outputs="y", dt=0.1)
    answer = wb.identify(data, methods={"lti": wb.LTI(order=2)})
    assert not answer.kept
    with pytest.raises(NotHandedOutError, match="copy"):
        _ = answer.model
    answer.save(tmp_path)
    assert not (tmp_path / "lti.json").exists()
    taken = replace(answer, accepted=True)
    assert taken.model.order == 2
    taken.save(tmp_path)
    assert (tmp_path / "lti.json").exists()
    answer.save(tmp_path)
    assert not (tmp_path / "lti.json").exists()  # that of the former answer


def test_roles_that_are_missing_are_asked_for_in_both_languages(files):
    with pytest.raises(wb.InputError, match=r"--output, in Python read\(.., outputs=..\)"):
        wb.identify(wb.read({"u": np.ones(30), "z": np.ones(30)}, inputs="u", dt=0.1))
    with pytest.raises(wb.InputError, match="lti"):
        wb.identify(wb.read(files[0], **ROLES), methods=["lty"])


@pytest.mark.parametrize(
    ("verb", "said"),
    [
        (lambda data: wb.diagnose("welding-robot", data), "plant: str 'welding-robot', expected a Plant"),
        (lambda data: wb.diagnose(WELDING_ROBOT, "a.csv"), "records: str 'a.csv', expected a Dataset"),
        (lambda data: wb.calibrate(WELDING_ROBOT, data, held_out={"u": [1.0]}), "records: dict .*, expected a Dataset"),
        (lambda data: wb.calibrate(WELDING_ROBOT, data, parameters=["zz"]), "unknown parameter 'zz'"),
        (lambda data: wb.identify("a.csv"), "records: str 'a.csv', expected a Dataset"),
        (lambda data: wb.identify(data, data), "the same samples"),
    ],
)
def test_what_a_verb_cannot_take_is_named_with_its_mend(files, verb, said):
    with pytest.raises(wb.InputError, match=said):
        verb(wb.read(files[0], **ROLES))


def test_one_record_is_a_set_of_one(files):
    (one,) = wb.read(files[0], **ROLES)
    methods = {"lti": wb.LTI(order=2)}
    assert (
        wb.identify(one, methods=methods).scores[0].FIT == wb.identify(wb.read(files[0], **ROLES), methods=methods).scores[0].FIT
    )


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
