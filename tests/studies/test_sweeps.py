"""The sweep command on closed loops: every row is the run that simulate makes of it, on one process or several."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from controllers.files import save_controller
from plants import PLANTS
from studies.cli import main
from studies.jobs.closed_loop import ClosedLoop
from tests.controllers.test_nmpc import winding
from tests.studies.test_robust_winding import law
from workbench.errors import InputError
from workbench.robustness.limits import Manoeuvre
from workbench.simulation import simulate, simulate_batch
from workbench.sweeps.design import Factor, Point, Sweep
from workbench.sweeps.job import StoppedError
from workbench.sweeps.rows import read_rows
from workbench.sweeps.run import run_sweep

WINDING = PLANTS["web-winding"]
FRICTION = "coulomb@unwind:level"
SWEEP = f"""
run = "closed-loop"
design = "random"
count = 12
seeds = [4, 5]
[parameters.kE]
low = 150
high = 250
[parameters."{FRICTION}"]
values = [0.0, 0.002]
[fixed]
plant = "web-winding"
controller = "pid.json"
[fixed.run]
duration = 3.0
[fixed.run.setpoints]
w3 = [[0, 100], [1, 102]]
theta = 0
"""


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """A folder with a sweep and its controller, in which commands run."""
    monkeypatch.chdir(tmp_path)
    save_controller(law("scheduled", 1.2), tmp_path / "pid.json")
    (tmp_path / "sweep.toml").write_text(SWEEP, encoding="utf-8")
    return tmp_path


def run_of(values, seed, controller):
    """The same run by simulate, one by itself."""
    t = WINDING.dt * np.arange(round(3.0 / WINDING.dt))
    whole = Manoeuvre(3.0, {"w3": ((0.0, 100.0), (1.0, 102.0)), "theta": ((0.0, 0.0),)}, {}, seed).scenario(WINDING, controller)
    effects = {"coulomb@unwind": {"level": values[FRICTION]}}
    seen = simulate(WINDING, controller, whole, parameters={"kE": values["kE"]}, effects=effects, bumpless=True).experiment
    return seen["w3"] - np.where(t >= 1.0, 102.0, 100.0), seen["theta"], seen["V2"]


@pytest.mark.slow
def test_every_row_is_the_run_that_simulate_makes(asked, capsys):
    assert main(["sweep", "sweep.toml", "--out", "o"]) == 0
    said = capsys.readouterr()
    assert "24 runs, 0 failed; 24 of them now" in said.out
    assert "w3 RMS: " in said.out
    assert "24 of 24 runs" in said.err
    found = read_rows(asked / "o/sweep.sqlite")
    assert found.units["kE"] == next(q.unit for q in WINDING.parameters if q.name == "kE")
    assert (found.units["w3 RMS"], found.units["theta IAE"], found.units["V2 travel"]) == ("rad/s", "deg s", "V")
    for row in found.rows[::5]:
        own = dict(zip(found.names, row, strict=True))
        w3, theta, V2 = run_of(own, own["seed"], law("scheduled", 1.2))
        assert own["w3 RMS"] == pytest.approx(np.sqrt(np.mean(w3**2)), rel=1e-12)
        assert own["w3 max"] == pytest.approx(np.abs(w3).max(), rel=1e-12)
        assert own["theta IAE"] == pytest.approx(WINDING.dt * np.abs(theta).sum(), rel=1e-12)
        assert own["V2 travel"] == pytest.approx(np.abs(np.diff(V2)).sum(), rel=1e-12)
    assert len({row[4] for row in found.rows}) == 24
    with (asked / "o/sweep.csv").open(newline="") as file:
        header, first, *_ = csv.reader(file)
    assert header[:4] == ["run", "seed", f"kE [{found.units['kE']}]", f"{FRICTION} [N m]"]
    assert float(first[2]) == found.rows[0][2]


class OnProcesses(ClosedLoop):
    """The same runs, not on threads."""

    def on_threads(self, count):
        return None


@pytest.mark.slow
def test_threads_and_processes_give_the_same_rows_to_the_last_bit(asked, tmp_path, monkeypatch):
    assert main(["sweep", "sweep.toml", "--out", "one", "--json", "one.json"]) == 0
    with monkeypatch.context() as patch:
        patch.setattr("studies.jobs.closed_loop.ClosedLoop", OnProcesses)
        assert main(["sweep", "sweep.toml", "--out", "processes", "--jobs", "2"]) == 0
    assert read_rows("one/sweep.sqlite").rows == read_rows("processes/sweep.sqlite").rows
    assert main(["sweep", "sweep.toml", "--out", "two", "--jobs", "2"]) == 0
    assert read_rows("one/sweep.sqlite").rows == read_rows("two/sweep.sqlite").rows
    assert [tuple(row) for row in json.loads((asked / "one.json").read_text())["rows"]] == list(
        read_rows("two/sweep.sqlite").rows
    )


@pytest.mark.slow
def test_a_design_that_tells_what_matters_makes_a_page_that_says_it(asked, capsys):
    """Dry friction moves the tension, and the web's stiffness hardly: Morris says so, in words, in JSON and in the page."""
    text = SWEEP.replace('"random"', '"morris"').replace("count = 12", "count = 6")
    (asked / "morris.toml").write_text(text.replace("values = [0.0, 0.002]", "low = 0\nhigh = 0.003"))
    assert main(["sweep", "morris.toml", "--out", "m", "--json", "m.json", "--parquet"]) == 0
    found = json.loads((asked / "m.json").read_text())
    effects = {(i["output"], i["factor"]): i["value"] for i in found["sensitivity"]}
    assert effects["theta RMS", FRICTION] > 5.0 * effects["theta RMS", "kE"]
    rows = [row[4:6] for row in found["rows"]]
    assert effects["theta RMS", FRICTION] <= np.ptp([row[found["names"].index("theta RMS")] for row in found["rows"]]) * 1.5
    assert len(rows) == 6 * 3 * 2
    page = (asked / "m" / "report.html").read_text()
    assert f"theta RMS depends most on {FRICTION}" in page
    for title in ("Every run", "What theta RMS depends on", "theta RMS of every run", f"theta RMS over {FRICTION} and kE"):
        assert title in page
    import pyarrow.parquet as parquet

    table = parquet.read_table(asked / "m" / "sweep.parquet")
    assert table.column_names == found["names"]
    assert table.to_pydict()["theta RMS"] == [row[found["names"].index("theta RMS")] for row in found["rows"]]
    assert table.schema.field("kE").metadata[b"unit"] == found["units"]["kE"].encode()


def test_parquet_without_pyarrow_is_refused_before_any_run(asked, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert main(["sweep", "sweep.toml", "--out", "o", "--parquet"]) == 2
    assert "pyarrow is not installed" in capsys.readouterr().err
    assert not (asked / "o").exists()


def test_who_is_beside_a_run_does_not_matter():
    """Also where another one needs more integrator steps: the stiffest web does."""
    setpoints = {"w3": ((0.0, 100.0),), "theta": ((0.0, 0.0),)}
    with_file = ClosedLoop("web-winding", text_of(law("scheduled", 1.2)), Manoeuvre(1.0, setpoints), ("kE",))
    points = [Point(i, i, {"kE": value}) for i, value in enumerate((200.0, 60000.0, 190.0))]
    together = with_file(points)
    assert together == [with_file([point])[0] for point in points]
    p = np.tile(WINDING.nominal, (2, 1))
    p[1, [q.name for q in WINDING.parameters].index("kE")] = 60000.0
    scenario = Manoeuvre(1.0, setpoints).scenario(WINDING, law("scheduled", 1.2))
    beside = simulate_batch(WINDING, law("scheduled", 1.2), scenario, parameters=p, bumpless=True)
    alone = simulate_batch(WINDING, law("scheduled", 1.2), scenario, parameters=p, bumpless=True, alone=True)
    assert not np.array_equal(beside.states[0], alone.states[0])  # the other asks for more steps
    np.testing.assert_array_equal(beside.states[1], alone.states[1])


def test_a_start_that_is_hard_to_find_does_not_move_its_neighbours():
    """Newton's method takes more steps for some radii than for others."""
    setpoints = {"w3": ((0.0, 100.0),), "theta": ((0.0, 0.0),)}
    job = ClosedLoop("web-winding", text_of(law("scheduled", 1.2)), Manoeuvre(0.4, setpoints), ("r3", "T_set"))
    random = np.random.default_rng(0)
    points = [Point(i, 0, {"r3": random.uniform(0.005, 0.02), "T_set": random.uniform(0.2, 0.4)}) for i in range(40)]
    assert job(points) == [job([point])[0] for point in points]


@pytest.mark.slow
def test_a_plant_that_has_changed_is_another_one(asked, capsys):
    mine = asked / "mine.py"
    mine.write_text("from plants import PLANTS\n\nPLANT = PLANTS['web-winding']\n", encoding="utf-8")
    assert main(["sweep", "sweep.toml", "--plant", "mine.py:PLANT", "--out", "o"]) == 0
    mine.write_text(mine.read_text() + "# another one\n", encoding="utf-8")
    assert main(["sweep", "sweep.toml", "--plant", "mine.py:PLANT", "--out", "o", "--resume"]) == 2
    assert "holds rows of another sweep, job or version" in capsys.readouterr().err
    setpoints = {"w3": ((0.0, 100.0),), "theta": ((0.0, 0.0),)}
    with pytest.raises(StoppedError, match="has changed since the sweep began"):
        ClosedLoop("mine.py:PLANT", text_of(law("x", 1.0)), Manoeuvre(1.0, setpoints), (), sources={str(mine): "0" * 64})


def text_of(controller):
    """What the file of a controller holds."""
    with TemporaryDirectory() as folder:
        save_controller(controller, Path(folder) / "law.json")
        return (Path(folder) / "law.json").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_run_that_leaves_the_range_is_a_row_with_its_error(asked, capsys):
    """Gains of the wrong sign: the roll runs away, sooner or later."""
    save_controller(law("wrong way round", -3.0), asked / "pid.json")
    (asked / "sweep.toml").write_text(SWEEP.replace("duration = 3.0", "duration = 20.0"), encoding="utf-8")
    assert main(["sweep", "sweep.toml", "--out", "o"]) == 0
    rows = read_rows("o/sweep.sqlite").rows
    lost = [row for row in rows if row[-1]]
    said = capsys.readouterr().out
    assert f"24 runs, {len(lost)} failed" in said
    assert f"  the first: {lost[0][-1]}" in said
    assert lost
    assert all(row[-1].startswith("left the range of web-winding after") and set(row[4:-1]) == {None} for row in lost)
    assert all(None not in row for row in rows if not row[-1])


@pytest.mark.slow
def test_a_law_that_is_computed_step_by_step(asked):
    """The NMPC by itself, as simulate runs it."""
    own, setpoints = winding(horizon=5), {"w3": ((0.0, 100.0), (0.2, 101.0)), "theta": ((0.0, 0.0),)}
    job = ClosedLoop("web-winding", text_of(own), Manoeuvre(0.6, setpoints), (FRICTION,), noise=False)
    found = job([Point(0, 0, {FRICTION: 0.001})])[0]
    scenario = Manoeuvre(0.6, setpoints).scenario(WINDING, own)
    seen = simulate(WINDING, own, scenario, effects={"coulomb@unwind": {"level": 0.001}}, bumpless=True).experiment
    assert found["V1 travel"] == pytest.approx(np.abs(np.diff(seen["V1"])).sum(), rel=1e-9)
    assert found["theta max"] == pytest.approx(np.abs(seen["theta"]).max(), rel=1e-9)


@pytest.mark.slow
def test_what_was_begun_is_finished(asked, capsys):
    assert main(["sweep", "sweep.toml", "--out", "o"]) == 0
    assert main(["sweep", "sweep.toml", "--out", "o"]) == 2
    assert "holds a sweep already" in capsys.readouterr().err
    assert main(["sweep", "sweep.toml", "--out", "o", "--resume"]) == 0
    assert "24 runs, 0 failed; 0 of them now" in capsys.readouterr().out
    assert main(["sweep", "sweep.toml", "--resume"]) == 2
    assert "--out DIR --resume" in capsys.readouterr().err
    content = json.loads((asked / "pid.json").read_text())
    content["Kp"][0][0][1] *= 1.01
    (asked / "pid.json").write_text(json.dumps(content))
    assert main(["sweep", "sweep.toml", "--out", "o", "--resume"]) == 2
    assert "holds rows of another sweep, job or version" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("closed-loop", "closed-lop", "did you mean 'closed-loop'"),
        ("parameters.kE", "parameters.kF", "unknown parameter 'kF'"),
        ("coulomb@unwind:level", "coulomb@unwind:levle", "unknown parameter of coulomb@unwind 'levle'"),
        ("coulomb@unwind:level", "columb@unwind:level", "did you mean 'coulomb@unwind'"),
        ("[0.0, 0.002]", '["none"]', "expected a number"),
        ('plant = "web-winding"', 'plant = "mine.py:PLANT"', "named with --plant mine.py:PLANT"),
        ('controller = "pid.json"', 'controller = "../pid.json"', "leaves the sweep's folder"),
        ('controller = "pid.json"', 'controller = "/etc/pid.json"', "leaves the sweep's folder"),
        ('controller = "pid.json"', 'controller = "absent.json"', "absent.json"),
        ('controller = "pid.json"\n', "", "controller is missing"),
        ("theta = 0", "", "no set-point for theta"),
        ("duration = 3.0", "duration = 0.0", r"\[fixed.run\] duration = 0"),
        ("duration = 3.0", "duration = 3.0\nseed = 7", "'seed'"),
        ('controller = "pid.json"', 'controller = "a\\u0000b"', "expected the name of a file"),
        ("[fixed.run]", "[fixed.runs]", "key in [fixed] 'runs'"),
    ],
)
def test_what_makes_no_sense_is_said(asked, capsys, old, new, said):
    assert old in SWEEP
    (asked / "sweep.toml").write_text(SWEEP.replace(old, new), encoding="utf-8")
    code = main(["sweep", "sweep.toml", "--out", "o"])
    told = capsys.readouterr()
    if "none" in new:  # every run says so by itself
        rows = read_rows("o/sweep.sqlite").rows
        assert code == 0
        assert all(said in row[-1] for row in rows)
        return
    assert code == 2
    assert said.replace("\\", "") in told.err
    assert "mend:" in told.err


def test_a_text_for_a_number_is_refused_by_the_job_itself():
    job = ClosedLoop(
        "web-winding", text_of(law("x", 1.0)), Manoeuvre(1.0, {"w3": ((0.0, 100.0),), "theta": ((0.0, 0.0),)}), ("kE",)
    )
    with pytest.raises(InputError, match="expected a number"):
        job([Point(0, 0, {"kE": "stiff"})])


# ---- on a cluster -------------------------------------------------------------------------------------------------------------


@pytest.fixture
def cluster(tmp_path):
    """Address of a Dask scheduler, and its two workers: processes of their own."""
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    where, log = tmp_path / "scheduler.json", (tmp_path / "cluster.log").open("w")
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2]), "OPENBLAS_NUM_THREADS": "1"}

    def started(name, *options):
        command = [sys.executable, "-m", f"distributed.cli.dask_{name}", *options]
        return subprocess.Popen(command, stdout=log, stderr=log, env=environment)

    scheduler = started("scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(where))
    processes = [scheduler]
    try:
        deadline = time.monotonic() + 60.0
        while not where.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        address = json.loads(where.read_text())["address"]
        workers = [started("worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard") for _ in range(2)]
        processes += workers
        waited = subprocess.run(
            [sys.executable, "-c", f"from distributed import Client; Client({address!r}).wait_for_workers(2, timeout=60)"],
            capture_output=True, text=True, env=environment,
        )  # fmt: skip
        assert waited.returncode == 0, waited.stderr
        yield address, workers
    finally:
        for process in reversed(processes):
            process.kill()
            process.wait()
        log.close()


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # Dask's own
def test_on_a_cluster_of_which_a_worker_dies_the_rows_are_the_same(cluster, tmp_path):
    address, workers = cluster
    setpoints = {"w3": ((0.0, 100.0),), "theta": ((0.0, 0.0), (5.0, 5.0))}
    job = ClosedLoop("web-winding", text_of(law("scheduled", 1.2)), Manoeuvre(20.0, setpoints), ("kE",))
    sweep = Sweep("closed-loop", (Factor("kE", (), 150.0, 250.0),), "sobol", 256)
    said = []

    def killing(text):
        said.append(text)
        workers[0].kill()

    done = run_sweep(sweep, job, tmp_path / "cluster.sqlite", scheduler=address, progress=killing)
    assert (done.runs, done.failed) == (256, 0)
    assert len(said) > 4
    assert workers[0].wait() == -signal.SIGKILL
    run_sweep(sweep, job, tmp_path / "here.sqlite")
    assert read_rows(tmp_path / "cluster.sqlite").rows == read_rows(tmp_path / "here.sqlite").rows


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_scheduler_that_is_none_is_said(asked, capsys, monkeypatch):
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    monkeypatch.setattr("workbench.sweeps.workers.WAITED", 0.5)
    for address, why in (("tcp://127.0.0.1:9", "no Dask scheduler"), ("nonsense", "no Dask scheduler")):
        assert main(["sweep", "sweep.toml", "--out", f"o{len(address)}", "--scheduler", address]) == 2
        assert why in capsys.readouterr().err
