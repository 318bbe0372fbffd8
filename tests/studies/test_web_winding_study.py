"""The whole chain on the winding machine: what is hidden is found, every stage is a command, the page and its numbers agree."""

import json
import re
import shutil
import subprocess

import numpy as np
import pytest

from plants import WEB_WINDING
from studies import web_winding
from studies.cli import main
from studies.stages import MARK
from studies.web_winding import HIDDEN, Hidden, chosen, drawn, judged
from tests.checker import checker
from tests.workbench.report.browser import CHROMIUM, FLAGS
from workbench.errors import InputError
from workbench.readers import read_file
from workbench.report.archive import read_report

pytestmark = pytest.mark.slow

SEED = 11


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """folder, path of the page, and what was said."""
    folder, said = tmp_path_factory.mktemp("chain"), []
    path = web_winding.main(quick=True, folder=folder, seed=SEED, say=said.append, progress=lambda _: None)
    return folder, path, "\n".join(said)


def test_what_is_hidden_is_found_and_the_gain_is_measured_on_unseen_records(chain):
    folder = chain[0]
    hidden, found = drawn(SEED), json.loads((folder / "diagnosis" / "diagnosis.json").read_text())
    assert found["verdict"] == "named"
    named = {f"{c['effect']}@{c['at']}" for c in found["causes"]}
    named |= {key for c in found["causes"] for key in c["ties"]}
    assert hidden.effect in named
    assert {e["record"] for e in found["stages"]} == {"sine"}  # which nothing was fitted to
    shown = min(found["stages"], key=lambda e: e["extended"] / e["recalibrated"])
    assert shown["extended"] < 0.97 * shown["recalibrated"]
    assert hidden.effect in chain[2]
    assert "no stage was told" in chain[1].read_text()


def test_no_stage_after_the_records_is_told_what_is_hidden(chain):
    folder = chain[0]
    stages = json.loads((folder / "web-winding.json").read_text())["stages"]
    assert list(stages) == ["records", "diagnosis", "models", "pid", "mpc", "loop-pid", "loop-mpc", "check-pid", "check-mpc"]
    own = drawn(SEED)
    assert own.effect in stages["records"]["command"]
    assert all(own.effect not in stage["command"] for name, stage in stages.items() if name != "records")
    assert all(own.effect not in read_file(path).names for path in (folder / "records").glob("*.csv"))


def test_errors_of_the_loops_are_those_of_the_records_of_the_loops(chain):
    folder = chain[0]
    for law, name in web_winding.LAWS.items():
        run = read_file(folder / f"loop-{law}" / "limits.csv")
        for y, unit in (("w3", "rad/s"), ("theta", "deg")):
            rms = float(np.sqrt(np.mean((run[f"{y}_set"] - run[y]) ** 2)))
            assert f"{y} {rms:.3g} {unit}" in re.search(rf"extended machine:.*?{name} ([^;.]*(?:\.[^;. ]+[^;.]*)*)", chain[2])[0]


def test_verdicts_on_the_page_are_those_of_the_checks(chain):
    folder = chain[0]
    for law, name in web_winding.LAWS.items():
        found = json.loads((folder / f"check-{law}" / "check.json").read_text())
        assert f"{name}: {found['status']} (" in chain[2]
        for v in found["verdicts"]:
            if v["status"] in ("FAILED", "UNDECIDED"):
                assert v["claim"] in chain[2]


@pytest.mark.parametrize("law", ["pid", "mpc"])
def test_someone_else_accepts_every_proof_of_the_study(chain, law, monkeypatch, tmp_path):
    """The command of the stage once more, on the model alone, with its proof file."""
    folder, proof = chain[0], tmp_path / "proof.json"
    words = json.loads((folder / f"check-{law}" / "stage.json").read_text())["command"].split()[1:]
    monkeypatch.chdir(folder)
    main([*words[: words.index("--plant")], "--nodes", "2", "--out", str(tmp_path / "again"), "--proof", str(proof)])
    found = checker.check(json.loads(proof.read_text()))
    assert [said for _, accepted, said in found if not accepted] == []
    verdicts = json.loads((tmp_path / "again" / "check.json").read_text())["verdicts"]
    assert len(found) == sum(v["status"] in ("PROVED", "FAILED") for v in verdicts) >= 5


def test_the_page_holds_every_stage_and_reads_again(chain):
    page = read_report(chain[0])
    assert [s.title for s in page.sections] == [
        "What the simulation gets wrong", "Models", "Scheduled PID", "Closed loop on the extended plant",
        "Is the scheduled PID safe", "Is the MPC safe", "What was hidden", "Stages", "Provenance",
    ]  # fmt: skip
    assert all(len(s.blocks) >= 2 for s in page.sections[:6])
    text = chain[1].read_text()
    assert not re.search(r'(?:src|href)="(?!#|data:|data/)', text)  # nothing is fetched


def test_the_first_screen_says_law_cause_and_safety(chain):
    brief = read_report(chain[0]).brief
    assert brief is not None
    assert [badge.about for badge in brief.badges] == ["Model", "Cause", "Safety"]
    law = next(law for law, name in web_winding.LAWS.items() if f"Take the {name}" in brief.todo)
    assert brief.badges[2].word == json.loads((chain[0] / f"check-{law}" / "check.json").read_text())["status"]
    assert drawn(SEED).effect in brief.badges[1].sentence
    assert brief.picture is not None


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_the_page_is_printed_on_eight_pages_at_most(chain, tmp_path):
    path = tmp_path / "page.pdf"
    subprocess.run([CHROMIUM, *FLAGS, f"--print-to-pdf={path}", chain[1].as_uri()], check=True, capture_output=True, timeout=120)
    assert 2 <= len(re.findall(rb"/Type\s*/Page[^s]", path.read_bytes())) <= 8


def test_which_law_is_taken():
    """What breaks a limit is never taken; what is proved stable goes before smaller errors."""

    def claims(stable, theta):
        return [{"claim": "stable", "status": stable}, {"claim": "theta: high", "status": theta}]

    errors = {"pid": {"w3": (2.0, "rad/s"), "theta": (1.0, "deg")}, "mpc": {"w3": (1.0, "rad/s"), "theta": (1.0, "deg")}}
    law, said = chosen({"pid": claims("PROVED", "UNDECIDED"), "mpc": claims("UNDECIDED", "PASSED")}, errors)
    assert (law, "its stability is proved; its errors are 33 % larger" in said) == ("pid", True)
    law, said = chosen({"pid": claims("UNDECIDED", "PASSED"), "mpc": claims("UNDECIDED", "PASSED")}, errors)
    assert (law, "25 % smaller" in said) == ("mpc", True)
    law, said = chosen({"pid": claims("PROVED", "FAILED"), "mpc": claims("UNDECIDED", "PASSED")}, errors)
    assert (law, "the scheduled PID breaks theta: high" in said) == ("mpc", True)
    law, said = chosen({"pid": claims("FAILED", "PASSED"), "mpc": claims("UNDECIDED", "FAILED")}, errors)
    assert law is None
    assert "none of the laws" in said


def test_a_second_run_computes_nothing_and_says_the_same(chain):
    folder, said = chain[0], []
    marks = {path: path.stat().st_mtime_ns for path in folder.glob(f"*/{MARK}")}
    assert len(marks) == 9
    web_winding.main(quick=True, folder=folder, seed=SEED, say=said.append, progress=lambda _: None)
    assert "\n".join(said) == chain[2]
    assert {path: path.stat().st_mtime_ns for path in folder.glob(f"*/{MARK}")} == marks


def test_what_is_said_of_what_was_hidden():
    """Named alone, beside a false one, tied, missed; and whether its size is right."""
    hidden = Hidden("input-delay@V1", "time", 0.03)

    def cause(key, low, high, ties=()):
        effect, at = key.split("@")
        return {"effect": effect, "at": at, "ties": list(ties), "parameters": {"time": {"low": low, "high": high}}}

    own = cause("input-delay@V1", 0.02, 0.04)
    assert judged({"causes": [own]}, hidden) == "the diagnosis names it, its size inside the 95 % interval"
    assert "NOT inside" in judged({"causes": [cause("input-delay@V1", 2.0, 4.0)]}, hidden)
    both = judged({"causes": [own, cause("sensor-lag@w3", 0.0, 1.0)]}, hidden)
    assert "and names sensor-lag@w3 beside it, which was not there" in both
    assert "cannot tell" in judged({"causes": [cause("input-delay@V1", 0.0, 1.0, ["sensor-lag@w3"])]}, hidden)
    assert "names another effect" in judged({"causes": [cause("sensor-lag@w3", 0.0, 1.0, ["input-delay@V1"])]}, hidden)
    assert judged({"causes": [cause("sensor-lag@w3", 0.0, 1.0)]}, hidden) == "the diagnosis does not find it"


def test_every_effect_that_may_be_hidden_is_one_of_the_machine():
    for key, (parameter, low, high) in HIDDEN.items():
        for size in (low, high):
            assert WEB_WINDING.effect_vector({key: {parameter: size}}).any()
    assert {drawn(seed).effect for seed in range(60)} == set(HIDDEN)


def test_a_users_records_are_taken_as_they_are_and_refused_in_words(chain, tmp_path):
    """Copied into the run, roles by name; a record without theta, and one without a partner, are refused before any work."""
    own = tmp_path / "own"
    shutil.copytree(chain[0] / "records", own, ignore=shutil.ignore_patterns("*.json", "states"))
    split = web_winding._taken(own, tmp_path / "run")
    assert split.estimation == ("records/prbs1.csv", "records/rbs.csv")
    assert split.held_out == ("records/sine.csv",)
    assert (tmp_path / "run" / "records" / "sine.csv").read_bytes() == (own / "sine.csv").read_bytes()
    setpoint = web_winding._limits(tmp_path / "run", str(own), split)
    assert setpoint["w3"] == pytest.approx(100.0, abs=3.0)
    (own / "limits.toml").write_text("[run]\nduration = 20.0\n[run.setpoints]\nw3 = 90.0\n[limits.w3]\nhigh = 120.0\n")
    with pytest.raises(InputError, match="no set-point for theta"):
        web_winding._limits(tmp_path / "run", str(own), split)
    (own / "limits.toml").write_text(
        "[run]\nduration = 20.0\n[run.setpoints]\nw3 = 90.0\ntheta = 2.0\n[limits.w3]\nhigh = 120.0\n"
    )
    assert web_winding._limits(tmp_path / "run", str(own), split) == {"w3": 90.0, "theta": 2.0}
    for path in own.glob("*.csv"):
        path.write_text(path.read_text().replace("theta [deg]", "thata [deg]"))
    with pytest.raises(InputError, match=r"(?s)no channel theta.*winding-models"):
        web_winding.main(folder=tmp_path / "run2", data=str(own))
    (own / "sine.csv").unlink()
    (own / "rbs.csv").unlink()
    with pytest.raises(InputError, match="at least two records"):
        web_winding.main(folder=tmp_path / "run3", data=str(own))
