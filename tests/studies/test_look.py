"""`workbench look` on the command line: what it says, writes, and refuses."""

import json

import numpy as np
import pytest

from studies.cli import main


@pytest.fixture
def log(tmp_path):
    """A laboratory's log: German, in ms, with units below the names, a remark, and a logger that stood still for a while."""
    lines = ["sep=;", "Prüfstand 3", "Zeit;U;n;Bemerkung", "ms;V;1/min;"]
    for k in [*range(400), *range(600, 1000)]:
        u, n = 3 * np.sign(np.sin(k / 30)), 900 * np.sin(k / 40)
        lines.append(f"{5 * k};{u:.1f};{n:.1f};{'start' * (k == 0)}".replace(".", ","))
    path = tmp_path / "log.csv"
    path.write_bytes("\r\n".join(lines).encode("cp1252"))
    return path


def test_a_laboratorys_log_is_told_on_one_screen(log, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["look", str(log), "--inputs", "U", "--output", "n", "--out", str(out), "--json", str(tmp_path / "l.json")]) == 0
    said = capsys.readouterr().out
    assert "2 records, 800 samples of 2 channels every 0.005 s" in said
    assert "gap of 1.005 s after t = 1.995 s (line 405)" in said
    assert "Zeit is in ms, taken as t in s" in said
    assert f"go on: workbench identify {log} --inputs U --output n" in said
    assert len(said.splitlines()) < 24
    content = json.loads((tmp_path / "l.json").read_text())
    assert [r["samples"] for r in content["sets"][0]["records"]] == [400, 400]
    assert (out / "report.html").exists()


def test_files_that_cannot_be_read_are_told_and_end_with_two(log, tmp_path, capsys):
    bad = tmp_path / "bad.csv"
    bad.write_text("t,u\n0,1\n1,\n2,3\n")
    assert main(["look", str(bad), str(log), "--out", str(tmp_path / "out")]) == 2
    assert "not read: " in (said := capsys.readouterr().out)
    assert "line 3, channel u: empty cell" in said
    assert main(["look", str(log), "--inputs", "Spannung", "--out", str(tmp_path / "none")]) == 2
    assert "unknown channel 'Spannung'" in capsys.readouterr().err


def test_the_sample_time_of_a_file_is_not_the_one_that_records_are_brought_to(tmp_path, capsys):
    k = np.arange(1200)
    u = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, 60), 20)
    y = np.zeros(1200)
    for i in range(1, 1200):
        y[i] = 0.97 * y[i - 1] + 0.03 * u[i - 1]
    (tmp_path / "fast.csv").write_text("count,u,y\n" + "".join(f"{a},{b},{c}\n" for a, b, c in zip(k, u, y, strict=True)))
    rows = [f"{0.01 * a},{b},{c}\n" for a, b, c in zip(k, u, 1.0 - y, strict=True) if a % 2 == 0]
    (tmp_path / "slow.csv").write_text("t,u,y\n" + "".join(rows))
    words = ["identify", str(tmp_path / "slow.csv"), "--holdout", str(tmp_path / "fast.csv"), "--inputs", "u"]
    words += ["--output", "y", "--model", "lti"]
    assert main([*words, "--dt", "0.02", "--out", str(tmp_path / "a")]) == 2
    assert "--file-dt" in capsys.readouterr().err
    assert main([*words, "--dt", "0.02", "--file-dt", "0.01", "--out", str(tmp_path / "b")]) in (0, 3)
    assert "sampled every 0.02 s" in capsys.readouterr().out
    scores = json.loads((tmp_path / "b" / "scores.json").read_text())
    assert scores
