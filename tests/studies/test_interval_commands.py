"""Interval models on the command line: identify, compare, and what wrong options are answered."""

import json

import numpy as np
import pytest

from studies.cli import main
from workbench.data import Experiment
from workbench.intervals.model import load_interval_model
from workbench.readers import write_csv
from workbench.sources import read

ROLES = ("--output", "y", "--inputs", "u", "--schedule", "rho")


def machine(name, seed, N=400):
    random = np.random.default_rng(seed)
    u = np.repeat(random.choice([-1.0, 1.0], N // 5), 5)
    rho = np.linspace(0.0, 1.0, N)
    y = np.zeros(N)
    for k in range(2, N):
        y[k] = 1.3 * y[k - 1] - 0.5 * y[k - 2] + (0.2 + 0.1 * rho[k]) * u[k - 1]
    y += 0.005 * random.uniform(-1, 1, N)
    return Experiment.from_arrays(name, 0.1, inputs={"u": u}, outputs={"y": y}, schedule={"rho": rho}, units={"y": "m/s"})


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("interval")
    paths = [folder / f"{name}.csv" for name in ("a", "b", "c")]
    for seed, path in enumerate(paths):
        write_csv(machine(path.stem, seed), path)
    return [str(path) for path in paths]


@pytest.fixture(scope="module")
def identified(files, tmp_path_factory):
    out = tmp_path_factory.mktemp("models")
    words = ["identify", *files[:2], *ROLES, "--model", "lti,interval", "--intervals", "2", "--e-y", "0.005", "--e-u", "0"]
    assert main([*words, "--holdout", files[2], "--out", str(out), "--json", str(out / "copy.json")]) == 0
    return out


@pytest.mark.slow
def test_identify_writes_the_model_its_scores_and_its_envelopes(identified, files):
    model = load_interval_model(identified / "interval.json")
    assert len(model.modes) == 2
    assert model.schedule is not None
    content = json.loads((identified / "scores.json").read_text())
    assert content == json.loads((identified / "copy.json").read_text())
    lti, interval = content["models"]
    assert "envelopes" not in lti
    assert interval["file"].endswith("interval.json")
    assert {(e["record"], e["split"], e["horizon"]) for e in interval["envelopes"]} == {
        (name, "held-out" if name == "c" else "estimation", horizon) for name in "abc" for horizon in ("one-step", "free-run")
    }
    assert all(e["coverage"] == 1.0 for e in interval["envelopes"] if e["split"] == "estimation")
    held = read(files[2], inputs=["u"], outputs=["y"], schedule=["rho"]).experiments[0]
    line = next(e for e in interval["envelopes"] if e["split"] == "held-out" and e["horizon"] == "one-step")
    assert line["coverage"] == model.one_step(held).coverage
    assert line["mean_radius"] == model.one_step(held).mean_radius
    assert (line["unit"], line["output"]) == ("m/s", "y")
    assert "BySchedule" in content["provenance"]["configuration"]["interval"]


def test_the_page_shows_envelopes_and_modes(identified):
    page = (identified / "report.html").read_text()
    pictures = ("one step ahead", "free run", "modes along time")
    for title in (*(f"interval on c: {picture}" for picture in pictures), "Parameters of interval"):
        assert title in page
    assert any((identified / "data").glob("*one-step*.csv"))


def test_the_verdict_counts_held_out_records_only(identified):
    entry = json.loads((identified / "scores.json").read_text())["models"][1]
    own = next(e for e in entry["envelopes"] if e["split"] == "held-out" and e["horizon"] == "one-step")
    page = (identified / "report.html").read_text()
    said = f"one-step {100 * own['coverage']:.1f} % of the measured values within ±{100 * own['relative']:.2g} % of the range"
    assert f"Envelopes of interval on held-out records: {said}" in page


@pytest.mark.slow
def test_coverage_of_held_out_records_is_said_first(files, tmp_path, capsys):
    main(["identify", files[0], *ROLES, "--model", "interval", "--e-y", "0.005", "--holdout", files[1], "--out", str(tmp_path)])
    said = [line for line in capsys.readouterr().out.splitlines() if " envelope: " in line]
    assert "held-out" in said[0]
    assert "estimation" in said[-1]
    assert len(said) == 4


@pytest.mark.slow
def test_compare_takes_interval_and_lpv_models_together(identified, files, tmp_path, capsys):
    models = [str(identified / name) for name in ("interval.json", "lti.json")]
    assert main(["compare", *models, "--holdout", files[2], "--out", str(tmp_path)]) == 0
    content = json.loads((tmp_path / "scores.json").read_text())
    assert ["envelopes" in entry for entry in content["models"]] == [True, False]
    assert "interval on c (held-out), y, one-step envelope: holds" in capsys.readouterr().out
    assert main(["compare", models[0], "--holdout", files[2], "--out", str(tmp_path / "alone")]) == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "kind"),
    [
        (["--precision", "0.9", "--shortest", "20", "--tolerance", "0.01", "--e-y", "0"], "inclusion-all"),
        (["--semantics", "simulation", "--e-y", "0.005"], "simulation"),
        (["--semantics", "inclusion-paper", "--form", "shift", "--e-y", "0.005"], "inclusion-paper"),
        (["--fir", "8", "--semantics", "overlap"], "overlap"),
        (["--precision", "0.9", "--maximum-radius", "--semantics", "inclusion-exact", "--order", "1"], "inclusion-exact"),
    ],
)
def test_every_kind_of_interval_model_can_be_asked_for(files, tmp_path, options, kind):
    assert main(["identify", files[0], *ROLES, "--model", "interval", *options, "--out", str(tmp_path)]) == 0
    name = "interval-simulation" if kind == "simulation" else "interval"
    assert load_interval_model(tmp_path / f"{name}.json").semantics.name == kind


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--precision", "1.2"], "expected 0 < precision <= 1"),
        (["--precision", "0"], "expected 0 < precision <= 1"),
        (["--precision", "0.999999", "--shortest", "20"], "can be reached"),
        (["--precision", "0.9", "--shortest", "5000"], "the longest record has 398"),
        (["--precision", "0.9", "--intervals", "3"], "exclude each other"),
        (["--shortest", "10"], "give --precision P as well"),
        (["--e-y", "-0.1"], "error bound -0.1"),
        (["--e-u", "-1"], "error bound -1"),
        (["--e-u", "a"], "'a' is not a number"),
        (["--e-u", "0.1,0.2"], "2 input errors for 1 inputs"),
        (["--semantics", "inclusion-al"], "did you mean 'inclusion-all'"),
        (["--semantics", "inclusion-paper", "--e-y", "0.1"], "shift form"),
        (["--semantics", "simulation", "--precision", "0.9"], "one mode"),
        (["--order", "600"], "reaches back 600"),
        (["--fir", "5", "--order", "2"], "exclude each other"),
        (["--fir", "5", "--form", "shift"], "--form belongs to models with feedback"),
        (["--intervals", "3", "--shortest", "9"], "--shortest belongs to modes along time"),
        (["--semantics", "simulation", "--maximum-radius"], "--maximum-radius belongs to modes along time"),
        (["--precision", "98"], "did you mean 0.98?"),
    ],
)
def test_wrong_options_are_refused_and_nothing_is_written(files, tmp_path, capsys, options, said):
    out = tmp_path / "out"
    code = main(["identify", *files[:2], *ROLES, "--model", "interval", *options, "--out", str(out)])
    error = capsys.readouterr().err
    assert code == 2
    assert said in error
    assert "mend:" in error
    assert not out.exists()


def test_a_schedule_that_its_name_suggests_can_be_left_out(tmp_path, capsys):
    e = machine("a", 0)
    e = Experiment.from_arrays("a", 0.1, inputs={"u": e["u"]}, outputs={"v": e["y"]}, other={"arm": e["rho"] - 0.5})
    write_csv(e, tmp_path / "a.csv")
    words = [
        "identify",
        str(tmp_path / "a.csv"),
        "--model",
        "all",
        "--order",
        "2",
        "--schedule",
        "none",
        "--out",
        str(tmp_path / "out"),
    ]
    assert main(words) == 0
    assert "schedule arm" not in capsys.readouterr().out
    assert (tmp_path / "out" / "ssm.json").exists()
    assert not (tmp_path / "out" / "ilm.json").exists()


def test_options_of_interval_models_belong_to_interval_models(files, tmp_path, capsys):
    assert main(["identify", files[0], *ROLES, "--model", "lti", "--precision", "0.9", "--out", str(tmp_path / "out")]) == 2
    assert "--model interval" in capsys.readouterr().err


def test_a_torn_or_foreign_model_file_is_refused(identified, files, tmp_path, capsys):
    torn = tmp_path / "torn.json"
    torn.write_text((identified / "interval.json").read_text()[:500])
    assert main(["compare", str(torn), "--holdout", files[2], "--out", str(tmp_path / "out")]) == 2
    assert "torn.json" in capsys.readouterr().err
    assert main(["compare", str(identified / "interval.json"), "--holdout", files[0], "--out", str(tmp_path / "out")]) == 2
    assert "was made from this record" in capsys.readouterr().err
