"""The comparison of controllers: what a row holds, what rows amount to, what is said of it, and a study that was cut off."""

import json
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from controllers.files import load_controller
from controllers.pid import pid
from controllers.receding import Status
from plants import PLANTS, WEB_WINDING, WELDING_ROBOT
from studies import controller_comparison as study
from studies.experiments import web_winding_loops
from studies.loops import HEAVY, Bench, Case, benches
from workbench.errors import InputError
from workbench.simulation import LeftRangeError, simulate
from workbench.table import made, whole_rows

pytestmark = pytest.mark.slow

N = 250
LAWS_OF_ROBOT = ("PID", "robust PID", "MPC", "NMPC")


def robot() -> Bench:
    """The welding robot, two short scenarios."""
    bench = benches()["welding-robot"]
    v = np.interp(0.02 * np.arange(N), [0.5, 1.0, 3.0, 3.5], [0.0, 0.4, 0.4, -0.2])
    short = [
        replace(case, references={"v_set": v}, shown=(0.0, 5.0)) for case in bench.cases if case.name in ("nominal", "heavy")
    ]
    return replace(bench, cases=tuple(short))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A study of two seeds that was run to its end."""
    place, patch = tmp_path_factory.mktemp("comparison"), pytest.MonkeyPatch()
    patch.setattr(study, "benches", lambda: {"welding-robot": robot()})
    said: list[str] = []
    study.main(quick=True, folder=place, seed=5, say=said.append, json=str(place / "out.json"))
    (place / "said.txt").write_text("\n".join(said))
    yield place
    patch.undo()


def rows_of(folder) -> dict[tuple, dict]:
    return {(r["case"], r["law"], r["seed"]): r for r in whole_rows(folder / "runs.jsonl")}


def test_every_law_runs_through_every_scenario_with_every_seed(folder):
    every = {(case, law, seed) for case in ("nominal", "heavy") for law in LAWS_OF_ROBOT for seed in (5, 6)}
    assert set(rows_of(folder)) == every


@pytest.mark.parametrize("law", ["PID", "NMPC"])
def test_a_row_is_what_the_machine_did(folder, law):
    """Errors of the state, not of the noisy sensor; with the effects of the case and the seed of the row."""
    controller = load_controller(folder / "controllers" / "welding-robot" / f"{law.lower()}.json", PLANTS.__getitem__)
    case = robot().cases[1]
    run = simulate(WELDING_ROBOT, controller, case.scenario(6), effects=HEAVY, bumpless=True)
    row, off = rows_of(folder)["heavy", law, 6], case.references["v_set"] - run.states["v1"]
    assert row["errors"]["v"] == pytest.approx(
        {"RMS": np.sqrt(np.mean(off**2)), "max": np.abs(off).max(), "IAE": 0.02 * np.abs(off).sum()}, rel=1e-12
    )
    noisy = case.references["v_set"] - run.experiment["v"]
    assert row["errors"]["v"]["RMS"] != pytest.approx(np.sqrt(np.mean(noisy**2)), rel=1e-6)
    moves = np.diff(run.experiment["u"])
    moves = np.append(run.experiment["u"][0], moves)  # it takes over from no force
    assert row["effort"]["u"] == pytest.approx(np.sqrt(np.mean(moves**2)))
    assert row["violation"] == 0.0
    assert sum(row["statuses"].values()) == (0 if law == "PID" else N)
    assert 0.0 < row["ms"]["median"] <= row["ms"]["p99"]


def test_all_laws_meet_the_same_noise_and_pushes(folder):
    noise, pushes = [], []
    for law in ("pid", "mpc"):
        controller = load_controller(folder / "controllers" / "welding-robot" / f"{law}.json", PLANTS.__getitem__)
        run = simulate(WELDING_ROBOT, controller, robot().cases[0].scenario(5), bumpless=True)
        noise.append(run.experiment["v"] - run.states["v1"])
        pushes.append(run)
    np.testing.assert_allclose(noise[0], noise[1], atol=1e-12)
    assert np.std(noise[0]) > 1e-3


def test_a_command_beyond_its_limits_is_seen():
    """A law that keeps its limits, and one that claims narrower ones than it keeps."""
    bench, law = robot(), pid(("u",), ("v",), ("v_set",), 0.02, [5.0], [10.0], low=-0.05, high=0.05)
    row = study.judged(bench, bench.cases[0], law, 1)
    assert row["violation"] == pytest.approx(0.0)
    assert row["at_limit"] > 0.5
    for claimed, beyond in (({"high": np.array([0.02])}, 0.03), ({"low": np.array([-0.01])}, 0.04)):
        assert study.judged(bench, bench.cases[0], _Claims(law, claimed), 1)["violation"] == pytest.approx(beyond)
    assert study.judged(bench, bench.cases[0], _Claims(law, {"rate": np.array([0.1])}), 1)["violation"] > 0.01


class _Claims:
    """A law asked step by step that claims limits of its own."""

    def __init__(self, law, claimed):
        self.own, self.claimed = law, claimed

    def __getattr__(self, name):
        if name in ("gains", "law"):
            raise AttributeError(name)
        return self.claimed[name] if name in self.claimed else getattr(self.own, name)

    def init(self, u=None):
        return _Memory(self.own.init(u), Status.OPTIMAL)

    def step(self, state, r, y, rho):
        u, after = self.own.step(state.own, r, y, rho)
        return u, _Memory(after, Status.OPTIMAL)


class _Memory(NamedTuple):
    own: np.ndarray
    status: Status


def test_a_machine_that_is_not_held_is_a_fault_and_no_number():
    winding = benches()["web-winding"]
    loose = replace(web_winding_loops(), Kp=50.0 * web_winding_loops().Kp)
    with pytest.raises(LeftRangeError, match="outside"):
        study.judged(winding, winding.cases[1], loose, 1)


def fabricated(law: str, case: str, seed: int, speed: float, tension: float) -> dict:
    error = lambda rms: {"RMS": rms, "max": 3 * rms, "IAE": 90 * rms}  # noqa: E731
    return {
        "machine": "web-winding", "case": case, "law": law, "seed": seed, "errors": {"w3": error(speed), "theta": error(tension)},
        "violation": 0.0, "away": {"theta": 0.0}, "effort": {"V1": 0.1, "V2": 0.1}, "at_limit": 0.0,
        "ms": {"median": 1.0 + seed, "p99": 2.0}, "statuses": {"optimal": 10},
    }  # fmt: skip


LAWS = {"fixed PID": (2.0, 1.0), "scheduled PID": (1.0, 1.0), "LPV-MPC": (0.9, 0.5), "NMPC": (0.8, 0.4)}


def summed(laws=None, lost=(), odd=()) -> tuple[Bench, dict]:
    """Two scenarios, the second with errors three times as large; seeds 0 and 2 lie one tenth below and above.

    odd: a law and a scenario in which its runs were slow, fell back and broke a limit.
    """
    bench = benches()["web-winding"]
    bench = replace(bench, cases=bench.cases[:2])
    rows = []
    for law, (speed, tension) in (laws or LAWS).items():
        for k, case in enumerate(bench.cases):
            for seed, share in ((0, 0.9), (1, 1.0), (2, 1.1)):
                size = share * (1, 3)[k]
                row = fabricated(law, case.name, seed, size * speed, size * tension)
                if (law, case.name) == odd:
                    row |= {"violation": 0.7, "statuses": {"fallback law": 100}, "ms": {"median": 500.0, "p99": 500.0}}
                if (law, case.name, seed) in lost:
                    row = {key: row[key] for key in ("machine", "case", "law", "seed")} | {"fault": "r1: outside"}
                rows.append(row)
    return bench, study._summed(bench, rows)


def test_rows_are_summed_over_seeds_and_scenarios():
    _, found = summed()
    own = found["cases"]["speed steps"]["fixed PID"]
    assert own["errors"]["w3"]["RMS"] == pytest.approx({"mean": 6.0, "sd": 6.0 * np.std([0.9, 1.0, 1.1])})
    assert own["ms"] == {"median": 2.0, "p99": 2.0}
    assert found["whole"]["LPV-MPC"]["errors"]["theta"]["RMS"] == pytest.approx(0.5 * np.sqrt((1 + 9) / 2))
    assert (found["seeds"], found["whole"]["NMPC"]["statuses"]) == (3, {"optimal": 60})


def test_a_scenario_that_a_law_has_not_held_counts_for_none():
    bench, found = summed(lost={("fixed PID", "speed steps", k) for k in range(3)})
    assert found["held"] == ["production"]
    assert found["whole"]["NMPC"]["errors"]["theta"]["RMS"] == pytest.approx(0.4)
    assert (found["whole"]["fixed PID"]["faults"], found["cases"]["speed steps"]["fixed PID"]["faults"]) == (3, 3)
    said = study.verdict(bench, found, {"fixed PID": 2.85, "scheduled PID": 1.59})
    assert "Did not hold the machine: fixed PID in 3 runs" in said
    assert study.better(bench, found, "fixed PID", "NMPC")[0] == "speed in production (+150 %)"
    assert "speed steps (does not hold)" in study.better(bench, found, "fixed PID", "NMPC")
    assert "Over the 1 of 2 scenarios that every law has held" in said
    lost = {(law, "speed steps", 0) for law in ("fixed PID", "LPV-MPC")}
    assert study.better(*summed(lost=lost), "LPV-MPC", "fixed PID") == ["speed steps (neither holds)"]
    with pytest.raises(InputError, match="no scenario was held by every law"):
        summed(lost={(law, case, 0) for law in ("fixed PID",) for case in ("production", "speed steps")})


def test_what_the_other_runs_of_a_scenario_did_is_not_lost():
    """Violations, statuses and times count from every run that has them, whatever another law did there."""
    bench, found = summed(lost={("fixed PID", "speed steps", 1)}, odd=("LPV-MPC", "speed steps"))
    own = found["whole"]["LPV-MPC"]
    assert (own["violation"], own["statuses"], own["ms"]["p99"]) == (0.7, {"optimal": 30, "fallback law": 300}, 251.0)
    assert "A command left its limits by 0.7." in study.verdict(bench, found, {})


def test_what_is_said():
    bench, found = summed()
    said = study.verdict(bench, found, {"fixed PID": 2.85, "scheduled PID": 1.59})
    assert (
        "web-winding: use the LPV-MPC. Over the 2 scenarios its tension error (RMS) is 50 % smaller than under the fixed PID"
        in said
    )
    assert "What scheduling the PID changes against the fixed PID: speed 50 % smaller, tension 0 % larger." in said
    assert "The LPV-MPC is no worse than the scheduled PID in any scenario." in said
    assert "The NMPC, which knows the machine, bounds them all; in tension it is 20 % smaller." in said
    assert "over all that was modelled: fixed PID 2.85, scheduled PID 1.59." in said
    # a simpler law within a tenth of the best is enough; one that does not hold the machine is not
    bench, found = summed({**LAWS, "scheduled PID": (1.0, 0.54)})
    assert "use the scheduled PID" in study.verdict(bench, found, {"fixed PID": 2.85, "scheduled PID": 1.59})
    bench, found = summed({**LAWS, "scheduled PID": (1.0, 0.54)}, lost={("scheduled PID", "production", 1)})
    assert "use the LPV-MPC" in study.verdict(bench, found, {"fixed PID": 2.85, "scheduled PID": 1.59})
    bench, found = summed({**LAWS, "LPV-MPC": (1.1, 0.5), "NMPC": (0.8, 0.6)})
    said = study.verdict(bench, found, {"fixed PID": 2.85, "scheduled PID": 1.59})
    assert "The LPV-MPC is worse than the scheduled PID in: speed in production (+10 %), speed in speed steps (+10 %)." in said
    assert "not what a scenario adds to it, is worse than the LPV-MPC in tension in production (+20 %)" in said
    assert "is worse than the fixed PID" not in said


def test_the_page_and_the_files(folder):
    page, content = (folder / "report.html").read_text(), json.loads((folder / "out.json").read_text())
    assert content == json.loads((folder / "summary.json").read_text())
    said = (folder / "said.txt").read_text()
    assert said.startswith("welding-robot: use the ")
    assert content["verdicts"]["welding-robot"] in said
    for title in ("RMS errors", "Run, heavy", "Errors, heavy", "Effort, nominal", "Margins", "Nyquist curves, robust PID"):
        assert title in page
    assert {path.name for path in (folder / "controllers" / "welding-robot").iterdir()} >= {"pid.json", "mpc.json", "nmpc.json"}


def test_a_study_that_was_cut_off_goes_on_where_it_stopped(folder, tmp_path, monkeypatch):
    place = tmp_path / "again"
    place.mkdir()
    for path in folder.rglob("*.json*"):
        target = place / path.relative_to(folder)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(path.read_bytes())
    lines = (folder / "runs.jsonl").read_text().splitlines()
    (place / "runs.jsonl").write_text("\n".join(lines[:-2]) + "\n" + lines[-2][:40])  # killed while it wrote
    again, work = [], study.run_job
    monkeypatch.setattr(study, "run_job", lambda job, folder: again.append(job.row) or work(job, folder=folder))
    study.main(quick=True, folder=place, seed=5, say=lambda _: None)
    last = [json.loads(line) for line in lines[-2:]]
    assert again == [{key: row[key] for key in ("machine", "case", "law", "seed", "mark")} for row in last]
    quiet = lambda rows: {key: {k: v for k, v in row.items() if k != "ms"} for key, row in rows.items()}  # noqa: E731
    assert quiet(rows_of(place)) == quiet(rows_of(folder))
    assert (place / "runs.jsonl").read_text().count("\n") == len(lines)
    # another law in the folder, another scenario: their rows are made anew, and no others
    slow = json.loads((place / "controllers" / "welding-robot" / "pid.json").read_text())
    (place / "controllers" / "welding-robot" / "pid.json").write_text(json.dumps(slow | {"Kp": [[[1.0]]]}))
    study._law.cache_clear()
    first, second = robot().cases
    second = replace(second, references={"v_set": 0.5 * second.references["v_set"]})
    bench = replace(robot(), cases=(first, second))
    monkeypatch.setattr(study, "benches", lambda: {"welding-robot": bench})
    again.clear()
    study.main(quick=True, folder=place, seed=5, say=lambda _: None)
    assert {(row["case"], row["law"]) for row in again} == {("nominal", "PID"), *(("heavy", law) for law in LAWS_OF_ROBOT)}
    for changed in ({"seed": 6}, {"quick": False}):
        with pytest.raises(InputError, match="give a new --out folder"):
            study.main(**{"quick": True, "folder": place, "seed": 5, "say": lambda _: None, **changed})
    (place / "configuration.json").unlink()
    with pytest.raises(InputError, match="no configuration"):
        study.main(quick=True, folder=place, seed=5, say=lambda _: None)
    with pytest.raises(InputError, match="leave --data out"):
        study.main(folder=place, data="records")


def test_scenarios_of_the_winding_machine_are_whole_runs_within_the_tape():
    """Each uses most of the tape and none more than there is; set-points and pushes have the length of the run."""
    bench = benches()["web-winding"]
    p = {q.name: q.value for q in WEB_WINDING.parameters}
    tape = np.pi * (p["r_full"] ** 2 - p["r_core"] ** 2) / p["s"]
    for case in bench.cases:
        wound = WEB_WINDING.dt * p["r3"] * case.references["w3_set"].sum()
        assert 0.85 * tape < wound < 1.001 * tape, case.name
        scenario = case.scenario(1)
        assert len(scenario) == 2250
        assert 0.0 <= case.shown[0] < case.shown[1] <= 90.0
    by_name = {case.name: case for case in bench.cases}
    assert by_name["eccentric reel"].effects == {"eccentricity@unwind": {"cosine": 1e-4}}
    assert np.count_nonzero(by_name["splice"].disturbance["V1"]) == 8
    assert by_name["emergency stop"].references["w3_set"].min() == 0.0


def _square(x: int) -> dict:
    return {"x": x, "y": x * x}


def test_rows_stand_in_the_file_before_they_are_given(tmp_path):
    table = tmp_path / "new" / "t.jsonl"
    for k, row in enumerate(made(table, _square, [1, 2, 3])):
        assert whole_rows(table)[-1] == row
        assert len(whole_rows(table)) == k + 1
    assert sorted(row["y"] for row in made(table, _square, [4, 5, 6], jobs=2)) == [16, 25, 36]
    assert len(whole_rows(table)) == 6
    table.write_text(table.read_text() + '{"x": 7, "y"')
    assert len(whole_rows(table)) == 6
    assert table.read_text().endswith("}\n")
    assert whole_rows(tmp_path / "none.jsonl") == []
    table.write_text('{"x": 1}\n{"x": \n{"x": 3}\n')
    with pytest.raises(InputError, match="line 2: not a row"):
        whole_rows(table)


def test_a_case_says_what_happens():
    for bench in benches().values():
        for case in bench.cases:
            assert isinstance(case, Case)
            assert case.sentence
            assert set(case.references) == {f"{name}_set" for name in bench.words}
