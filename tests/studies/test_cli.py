"""Every command as a person would call it: right, and wrong."""

import json
import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

import workbench
from studies import cli
from studies.cli import main
from workbench.readers import read_file


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    """Three short records of the machine as CSV files."""
    folder = tmp_path_factory.mktemp("records")
    assert main(["simulate", "web-winding", "--experiment", "prbs1", "rbs", "rgs", "--seed", "7", "--out", str(folder)]) == 0
    return folder


def refused(capsys, *words):
    """Exit code 2 and the message."""
    try:
        code = main(list(words))
    except SystemExit as stop:
        code = stop.code
    assert code == 2
    return capsys.readouterr().err


@pytest.mark.slow
def test_a_reader_of_the_output_who_stops_reading_does_not_stop_the_command(tmp_path):
    """As in `workbench simulate ... | head -1`."""
    words = ("simulate", "welding-robot", "--experiment", "rbs", "steps", "--out", str(tmp_path))
    command = [sys.executable, "-m", "studies.cli", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        assert run.stdout
        assert run.stderr
        run.stdout.close()
        said = run.stderr.read()
    assert run.returncode == 0
    assert "Traceback" not in said
    assert {path.name for path in tmp_path.glob("*.csv")} == {"rbs.csv", "steps.csv"}


def test_help_needs_no_numerical_package():
    """Help must come at once: nothing heavy is imported for it."""
    code = (
        "import sys\nfrom studies.cli import parser\nparser().format_help()\n"
        "heavy = {'numpy', 'scipy', 'numba', 'casadi', 'matplotlib', 'control', 'cvxpy'} & set(sys.modules)\n"
        "raise SystemExit(str(heavy) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_simulated_records_hold_what_the_loop_did(records):
    e = read_file(records / "prbs1.csv")
    assert e.names_of("input") == ("V1", "V2")
    assert e.names_of("reference") == ("w3_set", "theta_set")
    assert set(np.unique(e["w3_set"])) == {79.0, 121.0}
    assert len(e) == 2250
    assert e.dt == pytest.approx(0.04)
    # what the sensors do not see lies apart, so that the folder can be given to a study as it is
    assert {path.name for path in records.glob("*.csv")} == {"prbs1.csv", "rbs.csv", "rgs.csv"}
    assert read_file(records / "states" / "prbs1.csv").names == ("w1", "w2", "w3", "T1", "T2", "r1", "r2")
    summary = json.loads((records / "simulate.json").read_text())
    assert summary["provenance"]["seed"] == 7
    assert summary["provenance"]["versions"]["numpy"] == np.__version__


def test_same_seed_same_bytes(records, tmp_path):
    main(["simulate", "web-winding", "--experiment", "rgs", "--seed", "7", "--out", str(tmp_path)])
    assert (tmp_path / "rgs.csv").read_bytes() == (records / "rgs.csv").read_bytes()
    main(["simulate", "web-winding", "--experiment", "rgs", "--seed", "8", "--out", str(tmp_path)])
    assert (tmp_path / "rgs.csv").read_bytes() != (records / "rgs.csv").read_bytes()


def test_effects_parameters_and_start_reach_the_plant(tmp_path):
    common = ["simulate", "web-winding", "--experiment", "ramp", "--noise-free"]
    main([*common, "--out", str(tmp_path / "a")])
    main([*common, "--effect", "coulomb@rewind:level=0.002,width=2", "--out", str(tmp_path / "b")])
    main([*common, "--parameter", "J0=3e-5", "--start", "w3=90", "--out", str(tmp_path / "c")])
    a, b, c = (read_file(tmp_path / x / "ramp.csv") for x in "abc")
    # the loop holds the speed: friction shows in the voltage, V = Ra/kT level = 0.2 V
    assert np.mean(b["V2"] - a["V2"]) == pytest.approx(0.2, abs=0.02)
    assert c["w3"][0] == pytest.approx(90.0)


@pytest.mark.slow
def test_identify_and_compare(records, tmp_path, capsys):
    paths = [str(records / f"{name}.csv") for name in ("prbs1", "rbs", "rgs")]
    words = ["identify", paths[0], paths[1], "--output", "w3", "--inputs", "V1,V2", "--schedule", "r2", "--order", "3"]
    assert main([*words, "--holdout", paths[2], "--out", str(tmp_path), "--json", str(tmp_path / "s.json")]) == 0
    said = capsys.readouterr().out
    first = next(line for line in said.splitlines() if line.startswith(("LTI", "ILM", "SSM")))
    assert "held-out" in first  # the headline
    assert "free-run" in first
    content = json.loads((tmp_path / "s.json").read_text())
    assert [m["model"] for m in content["models"]] == ["LTI", "ILM", "SSM", "OE"]
    one = content["models"][2]["scores"][0]
    assert set(one) == {"record", "split", "output", "horizon", "FIT", "RM", "RMSE", "unit"}
    assert set(content["provenance"]["data"]) == {"prbs1.csv", "rbs.csv", "rgs.csv"}
    free = {
        m["model"]: next(s["FIT"] for s in m["scores"] if s["split"] == "held-out" and s["horizon"] == "free-run")
        for m in content["models"]
    }
    assert free["SSM"] > free["ILM"] > free["LTI"]

    models = [str(tmp_path / f"{m}.json") for m in ("lti", "ssm")]
    assert main(["compare", *models, "--holdout", paths[2], "--out", str(tmp_path), "--json", str(tmp_path / "c.json")]) == 0
    again = json.loads((tmp_path / "c.json").read_text())
    for model in again["models"]:  # a saved model scores as it did before it was saved
        same = next(s["FIT"] for s in model["scores"] if s["horizon"] == "free-run")
        assert same == pytest.approx(free[model["model"]], abs=1e-9)
    assert "residual" in capsys.readouterr().out


@pytest.mark.slow
def test_numbers_on_standard_output_stand_alone_there(records, tmp_path, capsys):
    paths = [str(records / f"{name}.csv") for name in ("prbs1", "rbs")]
    fit = ["--output", "w3", "--inputs", "V1,V2", "--schedule", "r2", "--model", "lti", "--order", "2", "--out", str(tmp_path)]
    assert main(["identify", paths[0], *fit, "--holdout", paths[1], "--json", "-"]) == 0
    written = capsys.readouterr()
    assert json.loads(written.out) == json.loads((tmp_path / "scores.json").read_text())
    assert "held-out" in written.err
    assert refused(capsys, "identify", str(tmp_path / "none.csv"), *fit, "--json", "-")


@pytest.mark.slow
def test_old_spellings_of_held_out_records_work_and_are_not_shown(records, tmp_path, capsys):
    paths = [str(records / f"{name}.csv") for name in ("prbs1", "rbs")]
    fit = ["--output", "w3", "--inputs", "V1,V2", "--schedule", "r2", "--model", "lti", "--order", "2"]
    for folder, held in (("new", "--holdout"), ("old", "--validate")):
        assert main(["identify", paths[0], *fit, held, paths[1], "--out", str(tmp_path / folder)]) == 0
        compared = "--records" if folder == "old" else held
        assert main(["compare", str(tmp_path / folder / "lti.json"), compared, paths[1], "--out", str(tmp_path / folder)]) == 0
    old, new = (json.loads((tmp_path / folder / "scores.json").read_text())["models"] for folder in ("old", "new"))
    assert [m["scores"] for m in old] == [m["scores"] for m in new]
    assert "give --holdout" in refused(capsys, "compare", str(tmp_path / "new" / "lti.json"))
    with pytest.raises(SystemExit):
        main(["identify", "--help"])
    shown = capsys.readouterr().out
    assert "--holdout" in shown
    assert "--validate" not in shown


def test_wrong_words_get_the_nearest_one(capsys, tmp_path, records):
    a = str(records / "prbs1.csv")
    assert "did you mean simulate?" in refused(capsys, "simulte", "web-winding")
    assert "did you mean --experiment?" in refused(capsys, "simulate", "web-winding", "--experimnt", "prbs1")
    assert "did you mean 'web-winding'" in refused(capsys, "simulate", "web-winder", "--experiment", "prbs1")
    assert "did you mean 'prbs2'" in refused(capsys, "simulate", "web-winding", "--experiment", "prbs")
    assert "did you mean 'coulomb@unwind'" in refused(
        capsys, "simulate", "web-winding", "--experiment", "rbs", "--effect", "columb@unwind:level=1", "--out", str(tmp_path)
    )
    assert "name=number" in refused(
        capsys, "simulate", "web-winding", "--experiment", "rbs", "--effect", "coulomb@unwind:level", "--out", str(tmp_path)
    )
    assert "give --experiment prbs1 | prbs2" in refused(capsys, "simulate", "web-winding")
    assert "did you mean 'w3'" in refused(capsys, "identify", a, "--output", "w33", "--inputs", "V1,V2")
    assert "did you mean 'ssm'" in refused(capsys, "identify", a, "--model", "smm")
    assert "known: web-winding" in refused(capsys, "study", "unknown")


def test_wrong_files_are_named(capsys, tmp_path, records):
    a = str(records / "prbs1.csv")
    assert "nothing.csv" in refused(capsys, "identify", str(tmp_path / "nothing.csv"))
    assert "same samples as estimation record" in refused(capsys, "identify", a, "--holdout", a)
    broken = tmp_path / "model.json"
    broken.write_text('{"schema": ')
    assert "line 1" in refused(capsys, "compare", str(broken), "--holdout", a)
    broken.write_text('{"schema": "other"}')
    assert "not an LPV model" in refused(capsys, "compare", str(broken), "--holdout", a)
    wrong = tmp_path / "rpm.csv"
    text = (records / "rgs.csv").read_text().replace("w3 [rad/s]", "w3 [rpm]", 1)
    wrong.write_text(text)
    message = refused(capsys, "study", "web-winding", "--data", str(_folder_with(tmp_path / "d", wrong, records / "rbs.csv")))
    assert "rpm" in message
    assert "w3" in message
    plant = tmp_path / "mine.py"
    plant.write_text("x = = 1\n")
    assert "line 1" in refused(capsys, "simulate", f"{plant}:PLANT", "--inputs-from", a)
    plant.write_text("x = 1\n")
    assert "no plant in this file" in refused(capsys, "simulate", f"{plant}:PLANT", "--inputs-from", a)
    assert f"write {plant}:NAME" in refused(capsys, "simulate", str(plant), "--inputs-from", a)


def _folder_with(folder, *files):
    folder.mkdir()
    for file in files:
        (folder / file.name).write_bytes(file.read_bytes())
    return folder


def test_an_unwritable_folder_is_refused(capsys, tmp_path):
    (tmp_path / "file").write_text("")
    message = refused(capsys, "simulate", "web-winding", "--experiment", "rbs", "--out", str(tmp_path / "file" / "sub"))
    assert "choose another --out" in message


def test_doctor_finds_this_machine_fit(capsys, tmp_path):
    assert main(["doctor", "--json", str(tmp_path / "doctor.json")]) == 0
    assert "simulation" in capsys.readouterr().out
    assert all(finding["fine"] for finding in json.loads((tmp_path / "doctor.json").read_text())["findings"])


def test_numbers_out_of_range_are_refused_by_name(capsys, records, tmp_path):
    a = str(records / "prbs1.csv")
    for order in ("0", "-3", "2.5", "abc"):
        assert f"'{order}' is not a whole number from 1 on" in refused(capsys, "identify", a, f"--order={order}")
    assert "'-5' is not a whole number from 0 on" in refused(capsys, "study", "web-winding", "--seed=-5")
    simulate = ("simulate", "web-winding", "--experiment", "rbs", "--out", str(tmp_path))
    for value, meaning in (("J0=-1", "inertia"), ("Ra=0", "resistance"), ("dancer=-0.01", "dancer")):
        message = refused(capsys, *simulate, "--parameter", value)
        assert meaning in message
        assert "greater than 0" in message
    assert "'J0=inf' is not finite" in refused(capsys, *simulate, "--parameter", "J0=inf")
    assert "'w3=nan' is not finite" in refused(capsys, *simulate, "--start", "w3=nan")
    assert "given twice" in refused(capsys, *simulate, "--parameter", "J0=3e-5", "--parameter", "J0=4e-5")
    assert "named twice" in refused(capsys, "identify", a, "--inputs", "V1,V1")
    assert "named twice" in refused(capsys, "simulate", "web-winding", "--experiment", "rbs", "rbs")


def test_a_measured_record_is_never_overwritten(capsys, records, tmp_path):
    mine = tmp_path / "rbs.csv"
    mine.write_bytes((records / "rbs.csv").read_bytes())
    words = ("simulate", "web-winding", "--inputs-from", str(mine), "--out", str(tmp_path))
    assert "would overwrite the measured one" in refused(capsys, *words)
    assert mine.read_bytes() == (records / "rbs.csv").read_bytes()


@pytest.mark.slow
def test_held_out_is_checked_not_believed(capsys, records, tmp_path):
    a, c = str(records / "prbs1.csv"), str(records / "rgs.csv")
    copy = tmp_path / "copy.csv"
    copy.write_bytes((records / "prbs1.csv").read_bytes())
    fit = ("--output", "w3", "--inputs", "V1,V2", "--schedule", "r2", "--model", "lti", "--order", "2", "--out", str(tmp_path))
    assert "same samples as estimation record 'prbs1'" in refused(capsys, "identify", a, *fit, "--holdout", str(copy))
    rpm = tmp_path / "rpm.csv"
    rpm.write_text((records / "rgs.csv").read_text().replace("w3 [rad/s]", "w3 [rpm]", 1))
    assert "units rad/s and rpm" in refused(capsys, "identify", a, *fit, "--holdout", str(rpm))
    assert main(["identify", a, *fit, "--holdout", c]) == 0
    capsys.readouterr()
    model = str(tmp_path / "lti.json")
    assert "was made from this record" in refused(capsys, "compare", model, "--holdout", a)
    assert "named twice" in refused(capsys, "compare", model, model, "--holdout", c)


@pytest.mark.slow
def test_best_says_what_was_judged_on_what(capsys, records, tmp_path):
    fit = ("--output", "w3", "--inputs", "V1,V2", "--schedule", "r2", "--order", "2", "--out", str(tmp_path))
    assert main(["identify", str(records / "prbs1.csv"), *fit, "--model", "best"]) == 0
    assert "on two fifths of the estimation records that it was not fitted to: lti" in capsys.readouterr().out


@pytest.mark.slow
def test_a_schedule_beyond_the_models_range_is_said(capsys, records, tmp_path):
    short = tmp_path / "short.csv"
    lines = (records / "prbs1.csv").read_text().splitlines(keepends=True)
    short.write_text("".join(lines[:1200]))
    fit = ("--output", "w3", "--inputs", "V1,V2", "--schedule", "r2", "--model", "ssm", "--order", "2", "--out", str(tmp_path))
    assert main(["identify", str(short), *fit, "--holdout", str(records / "rgs.csv"), "--accept"]) == 0
    assert "r2 leaves the range the model knows" in capsys.readouterr().out


def test_json_is_checked_before_the_work(capsys, records, tmp_path):
    words = ("identify", str(records / "prbs1.csv"), "--json", str(tmp_path / "no" / "x.json"), "--out", str(tmp_path / "out"))
    assert "its folder does not exist" in refused(capsys, *words)
    assert not (tmp_path / "out").exists()


def test_mistakes_in_an_own_plant_are_named(capsys, records, tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "add-a-plant.md").read_text()
    good = page.split("```python\n")[1].split("```")[0]
    record = tmp_path / "v.csv"
    record.write_text("t [s],V [V]\n" + "".join(f"{0.005 * k:.3f},{k % 7}\n" for k in range(50)))
    plant = tmp_path / "motor.py"
    for wrong, right, said in (
        ("p.b * x.w_load", "p.bb * x.w_load", "asks for 'bb'"),
        ("p.b * x.w_load", "p.b * (x.w_load if x.w_load > 0 else 0)", "np.maximum"),
        ('"twist": x.w_motor - x.w_load,', "", "no derivative of state twist"),
        ('Shaft("load", "w_load")', 'Shaft("load", "w_loud")', "'w_loud'"),
    ):
        assert wrong in good
        plant.write_text(good.replace(wrong, right))
        assert said in refused(capsys, "simulate", f"{plant}:MOTOR", "--inputs-from", str(record), "--out", str(tmp_path / "o"))


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("workbench stu", {"study"}),
        ("workbench simulate web-winding --exp", {"--experiment"}),
        ("workbench study web", {"web-winding"}),
    ],
)
def test_the_shell_is_told_what_could_stand_there(tmp_path, typed, offered):
    told = tmp_path / "told"
    asked = {"_ARGCOMPLETE": "1", "_ARGCOMPLETE_STDOUT_FILENAME": str(told), "COMP_LINE": typed, "COMP_POINT": str(len(typed))}
    root = Path(__file__).resolve().parents[2]
    environment = os.environ | asked | {"PYTHONPATH": str(root), "_ARGCOMPLETE_SUPPRESS_SPACE": "1", "_ARGCOMPLETE_IFS": "\n"}
    subprocess.run([sys.executable, "-m", "studies.cli"], env=environment, check=False, capture_output=True)
    assert {line.strip() for line in told.read_text().splitlines()} == offered


def test_what_the_shell_runs_says_a_crash_with_a_code_that_is_no_answer(monkeypatch, capsys, tmp_path):
    """1 would mean that a check has failed."""
    monkeypatch.setattr(sys, "argv", ["workbench", "doctor", "--out", str(tmp_path)])
    monkeypatch.setattr("studies.commands.run", lambda options: 1 / 0)
    assert cli.console() == 70
    said = capsys.readouterr().err
    (kept,) = tmp_path.glob("workbench-error-*.txt")
    assert said.startswith("workbench doctor: an error of the workbench itself, nothing is decided: ZeroDivisionError")
    assert str(kept) in said
    assert "Traceback" not in said
    assert "Traceback" in kept.read_text()
    assert kept.read_text().startswith(f"workbench doctor --out {tmp_path}\n")
    monkeypatch.setattr("studies.commands.run", lambda options: 1)
    assert cli.console() == 1
    assert '"studies.cli:console"' in (Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_kilohertz_record_is_thinned_with_a_word_and_the_user_may_choose(tmp_path, capsys):
    from tests.workbench.test_decimation import slow
    from workbench.readers import write_csv

    write_csv(slow(0.001), tmp_path / "fast.csv")
    words = ("identify", str(tmp_path / "fast.csv"), "--output", "y", "--inputs", "u", "--model", "lti", "--order", "1")
    assert main([*words, "--out", str(tmp_path / "m")]) == 0
    assert "note: fast: sampled every 0.001 s, used every 0.0" in capsys.readouterr().out
    used = json.loads((tmp_path / "m" / "scores.json").read_text())["provenance"]["configuration"]["dt"]
    assert 0.01 <= used <= 0.06
    assert main([*words, "--dt", "0.02", "--out", str(tmp_path / "n")]) == 0
    assert "used every 0.02 s (as asked)" in capsys.readouterr().out


@pytest.mark.slow
def test_records_that_are_refused_may_be_taken_anyway_and_the_provenance_says_so(tmp_path, capsys):
    assert main(["simulate", "welding-robot", "--experiment", "rbs", "--seed", "3", "--out", str(tmp_path)]) == 0
    e = read_file(tmp_path / "rbs.csv")
    rows = (tmp_path / "rbs.csv").read_text().splitlines()
    at = rows[0].split(",").index("u [N]")
    lines = [rows[0], *(",".join(f"-{c}" if i == at else c for i, c in enumerate(row.split(","))) for row in rows[1:])]
    (tmp_path / "reversed.csv").write_text("\n".join(line.replace("--", "") for line in lines) + "\n")
    assert read_file(tmp_path / "reversed.csv")["u"] == pytest.approx(-e["u"])
    words = ("calibrate", str(tmp_path / "reversed.csv"), "--plant", "welding-robot", "--parameters", "m1")
    assert "looks reversed in sign" in refused(capsys, *words, "--out", str(tmp_path / "k"))
    main([*words, "--anyway", "--out", str(tmp_path / "k")])
    assert "taken all the same: u looks reversed in sign" in capsys.readouterr().out
    stored = json.loads((tmp_path / "k" / "calibration.json").read_text())
    assert stored["provenance"]["configuration"]["anyway"] is True


def test_the_version_is_that_of_the_package(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"workbench {metadata.version('gain-scheduling-workbench')}\n"
    assert metadata.version("gain-scheduling-workbench") == workbench.__version__
