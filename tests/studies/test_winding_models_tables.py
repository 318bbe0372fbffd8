"""What the study says is what its scores file says, and the file's splits are the ones that were used."""

import json
import re

import numpy as np
import pytest

from workbench.intervals.model import load_interval_model
from workbench.lpv import load_model
from workbench.metrics import fit, rm
from workbench.readers import read_file

pytestmark = pytest.mark.slow

PRINTED = {  # [1] Tables 1.1 and 1.2, as typed from ../shared/seeds
    "FIT": {"SSM": (95, 93, 92, 90, 90), "ILM": (86, 85, 89, 83, 90), "LTI": (86, 85, 89, 83, 90)},
    "RM": {"SSM": (5, 5, 6, 8, 6), "ILM": (15, 15, 18, 17, 8), "LTI": (86, 85, 89, 83, 90)},
}
RECORDS = ("prbs1", "prbs2", "rbs", "sine", "rgs")


@pytest.fixture
def result(winding_study):
    folder, _, said, _ = winding_study
    return folder, said, json.loads((folder / "scores.json").read_text())["models"]


def test_only_prbs1_and_rbs_count_as_estimation(result):
    for model in result[2]:
        for s in model["scores"]:
            assert s["split"] == ("estimation" if s["record"] in ("prbs1", "rbs") else "held-out"), s


def test_scores_are_those_of_the_saved_models_on_the_saved_records(result):
    for entry in (entry for entry in result[2] if "envelopes" not in entry):
        model = load_model(result[0] / entry["file"])
        for s in entry["scores"]:
            if s["horizon"] == "free-run" and s["record"] in RECORDS:
                e, n = read_file(result[0] / "records" / f"{s['record']}.csv"), model.predictor.warmup
                y, ys = e["w3"][n:], model.simulate(e)[n:, 0]
                assert (s["FIT"], s["RM"]) == pytest.approx((fit(y, ys), rm(y, ys)), abs=1e-6)


def test_printed_tables_hold_our_scores_and_the_papers_numbers(result):
    for table, measure in (("Table 1.1", "FIT"), ("Table 1.2", "RM")):
        block = result[1].split(table)[1].split("\n\n")[0]
        for name in ("SSM", "ILM", "LTI"):
            line = next(row for row in block.splitlines() if row.startswith(name))
            cells = re.findall(r"(-?[\d.]+) \(\s*(\d+)\)", line)
            scores = next(m["scores"] for m in result[2] if m["model"] == name)
            ours = {s["record"]: s[measure] for s in scores if s["horizon"] == "free-run"}
            assert [float(a) for a, _ in cells] == pytest.approx([ours[r] for r in RECORDS], abs=0.051)
            assert tuple(int(b) for _, b in cells) == PRINTED[measure][name]
        assert block.splitlines()[-1].split() == ["estimation", "held-out", "estimation", "held-out", "held-out"]


def test_the_verdict_quotes_held_out_records_only(result):
    for entry in (entry for entry in result[2] if "envelopes" not in entry):
        held = [s["FIT"] for s in entry["scores"] if s["split"] == "held-out" and s["horizon"] == "free-run"]
        assert f"{entry['model']} {min(held):.1f} to {max(held):.1f} %" in result[1]


def test_fresh_records_are_other_records(result):
    for name in RECORDS:
        a, b = (read_file(result[0] / sub / f"{name}.csv")["w3"] for sub in ("records", "records_fresh"))
        assert not np.array_equal(a, b)


def test_coverage_is_that_of_the_saved_models_on_the_saved_records(result):
    entries = [entry for entry in result[2] if "envelopes" in entry]
    assert len(entries) == 2
    for entry in entries:
        model = load_interval_model(result[0] / entry["file"])
        for line in entry["envelopes"]:
            e = read_file(result[0] / "records" / f"{line['record']}.csv").with_roles(outputs=("w3",))
            assert line["split"] == ("estimation" if line["record"] in ("prbs1", "rbs") else "held-out")
            found = model.one_step(e) if line["horizon"] == "one-step" else model.free_run(e, (5,))
            assert (line["coverage"], line["mean_radius"]) == pytest.approx((found.coverage, found.mean_radius), rel=1e-9)
            assert line["split"] == "held-out" or line["coverage"] == 1.0
