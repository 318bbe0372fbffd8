"""The study of measured machines: its plants against their equations, its scores by rows made by hand, one machine shortened."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from studies import STUDIES, real_plants, real_records
from studies.cli import main
from studies.real_records import MACHINES, TARGETS, resolutions, run, said, verdict
from studies.real_scores import Ending, Machine, against, agreeing, ending, lower, sized, summary
from workbench.data import Dataset, Experiment
from workbench.physics.plant import Plant
from workbench.readers import read_file, write_csv

DATA = Path(__file__).parents[3] / "shared" / "data" / "real"
measured = pytest.mark.skipif(not DATA.is_dir(), reason="measured data not here: expected ../shared/data/real")


def plant_of(machine: str) -> Plant:
    return getattr(real_plants, MACHINES[machine].plant)


def rates(machine: str, x: dict, u: dict) -> list[float]:
    """Derivatives of a plant's states, nominal and without effects, under inputs taken as they are."""
    plant = plant_of(machine)
    states, inputs = (
        [np.array(values[name]) for name in names] for values, names in ((x, plant.state_names), (u, plant.input_names))
    )
    eta = plant.effect_vector()
    return [float(v) for v in plant.derivative(states, plant.drive(inputs, eta, 0.0), plant.nominal, eta)]


def test_the_study_is_registered():
    assert STUDIES["real-records"]() is real_records


# ---- plants -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("machine", "x", "u", "expected"),
    [
        ("ball_and_hoop", {"w": 5.0}, {"u": 1.0}, [(0.04 - 0.02) / 2e-3]),
        ("quarter_drone", {"a": np.pi / 6, "da": 2.0}, {"u": 40.0}, [2.0, (0.16 - 0.1 - 0.06) / 0.01]),
        ("pneumatic_friction", {"piston": 0.01, "F": 50.0}, {"v": 0.02, "p": 1e5}, [0.2, (49.0 + 1.0 - 50.0) / 0.05]),
        ("kuka_kr300", {"w": 10.0}, {"tau": 1.0}, [0.7 / 0.035]),
        ("bam_xl330", {"q": np.pi / 2, "w": 0.0}, {"U": 3.4}, [0.0, (0.35 - 0.49 * 9.81 * 0.1) / (0.0049 + 0.002)]),
        ("cascaded_tanks", {"x1": 4.0, "x2": 2.0}, {"u": 3.0}, [2.0 / 80.0, 2.0 / 80.0]),
        ("coupled_drives", {"w1": 2.0, "w2": 1.0, "T": 0.1}, {"u": 1.0}, [4.0, 7.0, 3.0]),
        ("silverbox", {"q": 0.1, "v": 100.0}, {"V1": 0.22}, [100.0, (0.22 - 0.1 - 0.02) / 5e-6]),
        ("gyroscope", {"w2": 1.0, "w4": 0.5}, {"exp_u": 2.0, "exp_p2": 0.0}, [(1.0 + 0.54 - 0.02) / 0.03, (-1.08 - 0.01) / 0.2]),
    ],
)
def test_a_plant_has_the_rates_of_its_written_equation(machine, x, u, expected):
    assert rates(machine, x, u) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_every_plant_is_a_machine_of_the_study_and_every_name_that_is_right_is_one_of_its_effects():
    plants = {name for name, value in vars(real_plants).items() if isinstance(value, Plant)}
    assert plants == {m.plant for m in MACHINES.values()}
    for name, m in MACHINES.items():
        known = {slot.key for slot in plant_of(name).slots}
        assert set(m.right) <= known, name
        assert {key.partition(":")[0] for key in m.sizes} <= set(m.right)
        assert not set(m.records) & set(m.held_out)


def test_the_plain_models_are_linear_in_states_and_inputs():
    """But for the weight of an arm: no plant holds the squares, roots, signs and frictions that the labels speak of."""
    for name in set(MACHINES) - {"quarter_drone", "bam_xl330"}:
        plant = plant_of(name)
        x, u = (
            {n: v for n, v in zip(names, np.linspace(0.3, 0.7, len(names)), strict=True)}
            for names in (plant.state_names, plant.input_names)
        )
        once, twice = rates(name, x, u), rates(name, {n: 2 * v for n, v in x.items()}, {n: 2 * v for n, v in u.items()})
        assert twice == pytest.approx([2 * v for v in once], rel=1e-9)


# ---- scores -----------------------------------------------------------------------------------------------------------------

ARM = Machine("arm", "ARM", ("a.csv",), ("b.csv",), "friction", ("coulomb@arm", "stribeck@arm"), sizes={"coulomb@arm:level": 2.0})
SPRING = Machine("spring", "SPRING", ("a.csv",), ("b.csv",), "a cube")
BOTH = {"arm": ARM, "spring": SPRING}


def cause(key, *ties, sure=True, **parameters):
    units = dict.fromkeys(parameters, "N m")
    return {"key": key, "ties": list(ties), "parameters": parameters, "units": units, "sure": sure}


def row(machine="arm", verdict="named", causes=(), **more):
    said = {"verdict": verdict, "causes": list(causes), "notes": [], "first": ["x"], "code": 0, "says_worse": False}
    return {"machine": machine, "seconds": 3.0, "resolutions": {}} | said | more


RIGHT, OTHER = cause("coulomb@arm", level=[1.9, 1.7, 2.1]), cause("offset@u", level=[1.0, 0.9, 1.1])
UNSURE = OTHER | {"sure": False}


@pytest.mark.parametrize(
    ("machine", "given", "expected"),
    [
        (ARM, row(causes=[RIGHT]), Ending.RIGHT),
        (ARM, row(causes=[RIGHT, cause("stribeck@arm")]), Ending.RIGHT),
        (ARM, row(causes=[cause("offset@u", "coulomb@arm")]), Ending.RIGHT),
        (ARM, row(causes=[cause("offset@u", "coulomb@arm", "a@b", "c@d")]), Ending.BESIDE),  # four names are no answer
        (ARM, row(causes=[RIGHT, OTHER]), Ending.WRONG),
        (ARM, row(causes=[OTHER]), Ending.WRONG),
        (ARM, row(verdict="incomplete", causes=[RIGHT]), Ending.RIGHT),
        (ARM, row(verdict="incomplete", causes=[RIGHT, OTHER]), Ending.WRONG),
        (ARM, row(verdict="incomplete", causes=[RIGHT, UNSURE]), Ending.BESIDE),
        (ARM, row(verdict="unknown"), Ending.OPEN),
        (ARM, row(verdict="nothing"), Ending.MISSED),
        (ARM, row(crashed="Traceback"), Ending.CRASHED),
        (ARM, row(refused="no"), Ending.REFUSED),
        (SPRING, row("spring", "unknown"), Ending.OUTSIDE),
        (SPRING, row("spring", causes=[OTHER]), Ending.WRONG),
        (SPRING, row("spring", "nothing"), Ending.MISSED),
    ],
)
def test_what_is_said_of_a_machine_has_one_ending(machine, given, expected):
    assert ending(given, machine) is expected


def test_rounding_by_the_step_of_the_readings_is_no_name_at_all():
    rounded = row(causes=[RIGHT, cause("quantisation@w", step=[0.01, 0.01, 0.01])], resolutions={"w": 0.01})
    assert ending(rounded, ARM) is Ending.RIGHT
    assert not against(rounded, ARM)
    assert against(rounded | {"resolutions": {"w": 0.02}}, ARM) == ["quantisation@w"]


def test_rates_count_what_they_say():
    rows = [
        row(causes=[RIGHT], errors={"full-run": {"b, w": [2.0, 1.0]}, "one-second": {"b, w": [2.0, 1.0]}}),
        row("spring", causes=[OTHER], errors={"full-run": {"b, w": [1.0, 1.5]}}),
        row("spring", "incomplete", [UNSURE], errors={"full-run": {"b, w": [1.0, 1.5]}}, says_worse=True, code=3),
        row("spring", "unknown", errors={"full-run": {"b, w": [1.0, 1.0]}}, notes=["the plant keeps its own parameters: worse"]),
        {"machine": "arm", "crashed": "Traceback\nKeyError: 1", "seconds": 1.0},
    ]
    s = summary(rows, BOTH)
    expected = {
        "crashed": (1, 5), "wrong": (1, 4), "beside": (1, 4), "right": (1, 2), "outside": (1, 3), "lower": (3, 4),
        "worse": (1, 4),
    }  # fmt: skip
    assert {name: (getattr(s, name).hits, getattr(s, name).of) for name in expected} == expected
    ends = [ending(r, BOTH[r["machine"]]) for r in rows]
    assert ends == [Ending.RIGHT, Ending.WRONG, Ending.BESIDE, Ending.OUTSIDE, Ending.CRASHED]
    assert ending(row(verdict="unknown"), ARM) is Ending.OPEN
    assert {t.rate for t in TARGETS} <= set(vars(s))
    assert not lower(rows[1])
    assert agreeing(rows[0], ARM) == ["coulomb@arm"]
    assert sized(rows[0], ARM) == {"coulomb@arm:level": (2.0, 1.9, 1.7, 2.1)}


def test_the_first_lines_say_which_machine_ends_how():
    names = ("kuka_kr300", "coupled_drives", "gyroscope")
    rows = [row(names[0], causes=[cause("coulomb@axis")]), row(names[1], "unknown"), {"machine": names[2], "crashed": "E"}]
    said = verdict(rows, summary(rows, MACHINES))
    for sentence in (
        "Named as the label says: kuka_kr300.",
        "outside the catalogue: coupled_drives.",
        "Crashed: gyroscope.",
        "Falls short: crashed: 1 of 3",
    ):
        assert sentence in said


def test_a_resolution_is_read_off_readings_that_repeat_a_step():
    plant = plant_of("bam_xl330")
    t = np.linspace(0.0, 9.0, 500)
    coarse, fine = 0.25 * np.round(np.sin(t) / 0.25), np.cos(3.1 * t)
    e = Experiment.from_arrays("r", 0.005, inputs={"U": t}, outputs={"q": coarse, "v": fine})
    assert resolutions(Dataset((e,)), plant) == pytest.approx({"q": 0.25})


@measured
def test_the_servo_s_own_readings_show_that_its_speed_is_late_and_larger():
    """v against the difference of q, behind a first-order lag, without any model: what MACHINES holds as shown."""
    own = MACHINES["bam_xl330"]
    assert "sensor-lag@v" in own.shown
    assert not set(own.shown) & set(own.right)
    found = []
    for file in (*own.records, *own.held_out):
        e = read_file(DATA / own.name / file)
        rate, v = np.gradient(e["q"], e.dt), e["v"]

        def left(time, rate=rate, v=v, dt=e.dt):
            decay = np.exp(-dt / time) if time else 0.0
            late = lfilter([1.0 - decay], [1.0, -decay], rate)
            regressors = np.column_stack([late, np.ones_like(v)])
            numbers = np.linalg.lstsq(regressors, v)[0]
            return np.std(v - regressors @ numbers), numbers[0]

        times = np.arange(0.0, 0.06, 0.002)
        best = min(times, key=lambda time: left(time)[0])
        assert left(best)[0] < 0.4 * left(0.0)[0]
        found.append((best, left(best)[1]))
    late, gain = np.median(found, axis=0)
    assert 0.018 < late < 0.028
    assert 1.005 < gain < 1.02


def test_what_the_readings_show_is_allowed_beside_and_never_asked_for():
    seen, late = replace(ARM, shown=("sensor-lag@v",)), cause("sensor-lag@v")
    alone = row(causes=[late])
    both = row(causes=[late, cause("coulomb@arm")])
    assert ending(alone, ARM) is Ending.WRONG
    assert ending(alone, seen) is not Ending.RIGHT
    assert not against(alone, seen)
    assert ending(both, seen) is Ending.RIGHT
    assert agreeing(both, seen) == ["coulomb@arm"]


# ---- the study --------------------------------------------------------------------------------------------------------------


def test_without_records_the_study_says_which_are_needed(capsys, tmp_path):
    for arguments in ((), ("--data", str(tmp_path))):
        assert main(["study", "real-records", "--out", str(tmp_path / "out"), *arguments]) == 2
        assert "a folder for each" in capsys.readouterr().err


def test_a_run_goes_on_where_it_stopped_and_a_crash_is_a_row(tmp_path, monkeypatch):
    made = []

    def one(name, folder, data, configuration):
        made.append(name)
        return row(name) | {"configuration": configuration} | ({"crashed": "KeyError"} if name == "silverbox" else {})

    monkeypatch.setattr(real_records, "run_machine", one)
    run(tmp_path, "data", ["gyroscope"])
    rows = run(tmp_path, "data", ["silverbox", "gyroscope"])
    assert made == ["gyroscope", "silverbox"]
    assert [r["machine"] for r in rows] == ["silverbox", "gyroscope"]
    assert "crashed: KeyError" in said(rows[0])


@pytest.mark.slow
@measured
def test_a_shortened_machine_goes_through_the_command_to_a_page_with_its_free_runs(tmp_path, monkeypatch):
    """The first 1200 s of the tanks: what comes out is not judged here, that it comes out is."""
    own = MACHINES["cascaded_tanks"]
    for file in (*own.records, *own.held_out):
        e = read_file(DATA / own.name / file)
        (tmp_path / "data" / own.name).mkdir(parents=True, exist_ok=True)
        write_csv(e.trim(stop=1200.0), tmp_path / "data" / own.name / file)
    monkeypatch.setattr(real_records, "QUICK", (own.name,))
    heard: list[str] = []
    page = real_records.main(True, folder=tmp_path / "out", data=str(tmp_path / "data"), say=heard.append)
    (found,) = json.loads((tmp_path / "out" / "summary.json").read_text())["machines"]
    assert found["verdict"] in ("named", "nothing", "unknown", "incomplete")
    assert found["errors"]["full-run"].keys() == {"val, y"}
    assert len(found["others"]["val"]) == 2
    text = page.read_text(encoding="utf-8")
    for word in ("cascaded_tanks", "grey box 0.191", "record val", own.lacks):
        assert word in text
    assert "cascaded_tanks -> " in heard[0]


@measured
@pytest.mark.slow
def test_no_machine_crashes_is_refused_or_named_wrongly_with_confidence(tmp_path):
    real_records.main(folder=tmp_path, data=str(DATA))
    rows = json.loads((tmp_path / "summary.json").read_text())["machines"]
    ends = {r["machine"]: ending(r, MACHINES[r["machine"]]) for r in rows}
    assert len(ends) == 9
    assert not {name for name, end in ends.items() if end in (Ending.CRASHED, Ending.REFUSED, Ending.WRONG)}
    assert all(lower(r) for r in rows)
