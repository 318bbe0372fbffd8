"""The chain from files to an exported controller, as a user types it, on a machine with an effect in its records."""

import json

import pytest

from studies.cli import main

CHAIN = """
import workbench as wb
from controllers import ScheduledPIDDesign, MPCDesign
from plants import WEB_WINDING

data  = wb.read("a.csv", "b.csv", outputs=["w3", "theta"], inputs=["V1", "V2"], schedule="r2")
held  = wb.read("c.csv", outputs=["w3", "theta"], inputs=["V1", "V2"], schedule="r2")
model = wb.SSM().fit(data)
found = wb.diagnose(WEB_WINDING, data, held)
law   = ScheduledPIDDesign(sensitivity=1.6).on(model)
answer = wb.check(law, limits, model=model, records=data, plant=found.plant)
answer.save("runs/monday"); law.export("c", "firmware")
"""
LIMITS = {
    "run": {"duration": 2.0, "setpoints": {"w3": [[0.0, 100.0], [1.0, 105.0]], "theta": 0.0}},
    "limits": {"w3": {"low": 50.0, "high": 150.0}},
}


@pytest.mark.slow
def test_the_whole_chain_is_a_dozen_lines(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    effect = ["--effect", "sensor-lag@theta:time=0.03"]
    assert main(["simulate", "web-winding", "--experiment", "prbs1", "rbs", "sine", "--seed", "3", *effect, "--out", "."]) == 0
    for old, new in (("prbs1", "a"), ("rbs", "b"), ("sine", "c")):
        (tmp_path / f"{old}.csv").rename(f"{new}.csv")
    names = {"limits": LIMITS}
    exec(compile(CHAIN, "chain", "exec"), names)  # what a user types, not input
    (cause,) = names["found"].causes
    assert "sensor-lag@theta" in (cause.key, *cause.ties)
    assert names["found"].plant.name == "web-winding"
    saved = json.loads((tmp_path / "runs" / "monday" / "check.json").read_text())
    assert saved == names["answer"].to_dict() | {"provenance": saved["provenance"]}
    assert {"a.csv", "b.csv"} <= saved["provenance"]["data"].keys()
    assert all(v["status"] in ("PROVED", "PASSED", "UNDECIDED") for v in saved["verdicts"])
    assert list((tmp_path / "firmware").glob("*.c"))
    assert (tmp_path / "runs" / "monday" / "report.html").stat().st_size > 10_000
