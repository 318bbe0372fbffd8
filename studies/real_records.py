"""What does the diagnosis say of nine measured machines whose missing physics the literature names?

Every machine is given as the plain model that a user would write first (real_plants) and goes through the command `workbench
diagnose`, with records held out. A row of machines.jsonl is whole as soon as a machine is done; a run that was cut off goes on
where it stopped. What counts as right stands in MACHINES, whatever comes out: see real_scores.

The records are those of other people, converted: the folder --data holds a folder for each machine, and a README with origin,
licence and label of each.
"""

import traceback
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from studies import answers, real_plants
from studies.arguments import check_files
from studies.real_scores import Ending, Machine, Reference, Summary, against, agreeing, ending, sized, summary
from studies.stranger_scores import HORIZONS, Row, ratios
from studies.targets import Target, reached, target_table, to_json
from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis.runs import Runner
from workbench.files import nullable, write_json
from workbench.metrics import fit, rmse
from workbench.physics.plant import Plant
from workbench.provenance import provenance
from workbench.readers import read_file, write_csv
from workbench.report import figures
from workbench.report.blocks import Block, Provenance, Report, Section, Table, Text
from workbench.report.figures import Trace
from workbench.report.page import write_report
from workbench.sources import read
from workbench.table import fingerprint, resumed

Say = Callable[[str], None]

LAYOUT = 2  # of a row: rows of another layout are not counted with these
TABLE = "machines.jsonl"
GIVEN, FOUND = "as given", "as found"
QUICK = ("kuka_kr300", "cascaded_tanks")

FRICTION = ("coulomb", "stribeck", "asymmetric-friction")


def _at(place: str, *effects: str) -> tuple[str, ...]:
    return tuple(f"{effect}@{place}" for effect in effects)


MACHINES = {
    machine.name: machine
    for machine in (
        Machine(
            "ball_and_hoop",
            "BALL_AND_HOOP",
            ("random_a.csv", "random_b.csv"),
            ("fixedStepSequence.csv", "closedLoop.csv"),
            "static friction, about 0.04 V of dead zone, and friction that grows faster than speed",
            (*_at("hoop", *FRICTION, "quadratic-friction"), "dead-zone@u"),
        ),
        Machine(
            "quarter_drone",
            "QUARTER_DRONE",
            ("steps.csv", "multisine.csv"),
            ("swept.csv", "semistatic.csv"),
            "thrust as the square of the command and one-sided, lag of the motor",
            ("input-delay@u", "sensor-lag@angle", "dead-zone@u"),  # a lag before or behind the arm is one chain to its angle
        ),
        Machine(
            "pneumatic_friction",
            "PNEUMATIC_FRICTION",
            ("NAPN_1.csv", "NAPN_5.csv"),
            ("NAPN_3.csv", "NAPN_7.csv"),
            "friction of the seal that grows with pressure and differs by direction",
            _at("seal", *FRICTION, "load-friction"),
        ),
        Machine(
            "kuka_kr300",
            "KUKA_KR300",
            ("A1.csv",),
            ("B1.csv", "C1.csv"),
            "friction that differs by direction, about 2.0 and 1.5 N m, and grows with speed; play and elasticity of the joint",
            (*_at("axis", *FRICTION, "quadratic-friction"), "gear-backlash@tau", "sensor-resonance@v"),
            sizes={"asymmetric-friction@axis:forward": 2.0, "asymmetric-friction@axis:backward": 1.5},
        ),
        Machine(
            "bam_xl330",
            "BAM_XL330",
            (
                "sin_sin_m0.49_kp100_0.csv",
                "sin_time_square_m0.49_kp400_11.csv",
                "up_and_down_m0.49_kp100_2.csv",
                "lift_and_drop_m0.49_kp400_9.csv",
            ),
            (
                "sin_sin_m0.49_kp400_8.csv",
                "sin_time_square_m0.49_kp100_3.csv",
                "up_and_down_m0.49_kp400_10.csv",
                "lift_and_drop_m0.49_kp100_1.csv",
            ),
            "friction: dry and viscous friction do not suffice, Stribeck and dependence on the load; limit of the PWM",
            (*_at("joint", *FRICTION, "load-friction"), "saturation@U"),
            # against the difference of q, v is some 23 ms late in all eight records, and 1.3 % larger
            ("sensor-lag@v", "sensor-gain@v", "sensor-gain@q"),
        ),
        Machine(
            "cascaded_tanks",
            "CASCADED_TANKS",
            ("est.csv",),
            ("val.csv",),
            "outflow as the square root of the level, overflow, a reading that ends at 10 V",
            (*_at("upper", "outflow-law", "overflow"), *_at("lower", "outflow-law", "overflow")),
            references=(Reference("val", "V", {"linear": 0.588, "CT-SUBNET": 0.306, "grey box": 0.191}, begin=4),),
        ),
        Machine(
            "coupled_drives",
            "COUPLED_DRIVES",
            ("run2_train.csv", "run3_train.csv"),
            ("run2_test.csv", "run3_test.csv"),
            "a counter of pulses that senses the speed without its sign",
            references=tuple(
                Reference(record, "V", {"linear": linear, "best": best}, begin=4, note="on another test record of this machine")
                for record, linear, best in (("run2_test", 0.224, 0.096), ("run3_test", 0.384, 0.074))
            ),
        ),
        Machine(
            "silverbox",
            "SILVERBOX",
            ("multisine_train.csv",),
            ("multisine_test.csv", "arrow.csv"),
            "a spring that stiffens with the cube of its stretch",
            _at("spring", "cubic-spring"),
            references=(
                Reference("multisine_test", "mV", {"linear": 6.96, "best": 0.30}, begin=50, scale=1e3),
                Reference("arrow", "mV", {"linear": 14.4, "best": 0.26}, begin=50, scale=1e3),
            ),
        ),
        Machine(
            "gyroscope",
            "GYROSCOPE",
            ("ML_estim.mat",),
            ("ML_valid.mat",),
            "gains that change with the speed of the disc and the angle of the gimbal",
            references=(
                Reference(
                    "ML_valid",
                    "%",
                    {"linear ARX": 30.0, "affine LPV-ARX": 76.0, "LPV-SUBNET": 98.0},
                    begin=50,
                    measure="FIT",
                    note="the highest of those published",
                ),
            ),
        ),
    )
}

TARGETS = (
    Target("crashed", "crashed", high=0.0),
    Target("sound records refused", "refused", high=0.0),
    Target("confident name against the label", "wrong", high=0.0),
    Target("full-run error on held-out records lower, or said why not", "lower", low=1.0),
    Target("worse one second ahead or over the full run, and not said", "worse", high=0.0),
)


def main(
    quick: bool = False,
    *,
    folder: Path,
    data: str | None = None,
    seed: int = 1,
    json: str | None = None,
    say: Say = print,
    progress: Say = lambda _: None,
    jobs: int = 1,
) -> Path:
    """Diagnose every machine in the folder `data` that `folder` does not hold yet, write the report; returns its path.

    quick: two of the machines. Raises InputError where records are missing, and for a folder of another version.
    """
    del seed  # measured records
    wanted = list(QUICK) if quick else list(MACHINES)
    files = _files(data, wanted)
    rows = run(folder, str(data), wanted, jobs, progress)
    found = summary(rows, MACHINES)
    source = provenance({"study": "real-records", "quick": quick, "data": data}, files)
    content = {"summary": to_json(found), "machines": rows, "provenance": source}
    for path in (folder / "summary.json", json):
        if path:
            write_json(path, nullable(content))
    progress("report")
    path = write_report(_report(rows, found, folder, source), folder)
    say("\n".join([verdict(rows, found), "", *map(said, rows), "", f"report: {path}"]))
    return path


# ---- rows -------------------------------------------------------------------------------------------------------------------


def _files(data: str | None, machines: Sequence[str]) -> list[Path]:
    """Every file of the machines. Raises InputError that says which is missing."""
    mend = "put the records of the nine machines (docs/diagnosis.md) into a folder with a folder for each, and give --data FOLDER"
    own = [(Path(name), MACHINES[name]) for name in machines]
    return check_files(data, [folder / file for folder, m in own for file in (*m.records, *m.held_out)], mend)


def run(folder: Path, data: str, machines: Sequence[str], jobs: int = 1, progress: Say = lambda _: None) -> list[dict[str, Any]]:
    """The row of every machine, in this order; rows that the folder holds already are not made again."""
    configuration = configured()
    work = partial(run_machine, folder=folder, data=data, configuration=configuration)
    rows = resumed(
        folder / TABLE,
        work,
        machines,
        key="machine",
        configuration=configuration,
        jobs=jobs,
        said=said,
        progress=progress,
    )
    return [row for name in machines for row in rows if row["machine"] == name]


def configured() -> str:
    """What rows must share to be counted together: layout, plants, splits, and the versions of all that computes."""
    splits = {name: [m.plant, m.records, m.held_out] for name, m in MACHINES.items()}
    return fingerprint(LAYOUT, splits, Path(real_plants.__file__).read_text(encoding="utf-8"))


def run_machine(name: str, folder: Path, data: str, configuration: str) -> dict[str, Any]:
    """Diagnose a machine as its user would, and judge what is found on the held-out records; free runs go to `folder`."""
    machine = MACHINES[name]
    records, held = ([Path(data) / name / file for file in own] for own in (machine.records, machine.held_out))
    steps = resolutions(read(*records), getattr(real_plants, machine.plant))
    row = {"machine": name, "configuration": configuration, "resolutions": steps}
    row |= answers.answer(records, held, f"{real_plants.__name__}:{machine.plant}", folder / name)
    if "verdict" not in row:
        return row
    try:
        return row | judged(machine, row, read(*held), folder / name)
    except Exception as reason:
        return row | {"unjudged": "".join(traceback.format_exception(reason))[-2000:]}


def resolutions(records: Dataset, plant: Plant) -> dict[str, float]:
    """The step of every output whose readings are whole numbers of one, by the readings alone."""
    found = {c.name: _step(np.concatenate([e[c.name] for e in records])) for c in plant.outputs}
    return {name: step for name, step in found.items() if step > 0.0}


def _step(y: np.ndarray) -> float:
    """The greatest step of which differences of y (N,) are whole numbers, 0 where there is none that repeats."""
    levels = np.unique(y)
    if not 1 < len(levels) < 0.9 * len(y):
        return 0.0
    span, gaps = levels[-1] - levels[0], np.diff(levels)
    step = span / round(span / gaps[gaps > 1e-6 * span].min(initial=span))
    return float(step) if np.allclose(gaps / step, np.round(gaps / step), atol=0.02) else 0.0


def judged(machine: Machine, row: Row, held_out: Dataset, folder: Path) -> dict[str, Any]:
    """Held-out errors of the plant as given and as found, by horizon and by the rules of others; the free runs as CSV files."""
    given: Plant = getattr(real_plants, machine.plant)
    plants = {GIVEN: given, FOUND: answers.plant_of(row, given)}
    errors: answers.Errors = {h: {} for h in HORIZONS}
    for e in held_out:
        runs = {}
        for which, plant in plants.items():
            missed = answers.misses(plant, e)
            answers.add(errors, plant, e, missed)
            runs[which] = missed["full-run"]
        _write_runs(folder, given, e, runs)
    others = {ref.record: _by_their_rule(ref, list(plants.values()), held_out) for ref in machine.references}
    return {"errors": errors, "others": others}


def _by_their_rule(ref: Reference, plants: Sequence[Plant], held_out: Dataset) -> list[float | None]:
    """Free runs whose start is fitted to the first samples alone, which are not counted: RMSE or FIT of each plant."""
    e = next(e for e in held_out if e.name == ref.record)
    found = []
    for plant in plants:
        y, z = e[plant.output_names[0]][ref.begin :], run_by_rule(plant, e, ref.begin)[ref.begin :, 0]
        value = (ref.scale * rmse(y, z) if ref.measure == "RMSE" else fit(y, z)) if np.isfinite(z).all() else None
        found.append(value)
    return found


def run_by_rule(plant: Plant, e: Experiment, begin: int) -> np.ndarray:
    """The free run (N, ny) of a plant on a record, its start fitted to the first `begin` samples alone."""
    runner = Runner.of(plant, e)
    return runner.whole([runner.u], beginning=begin)[0]


def _write_runs(folder: Path, plant: Plant, e: Experiment, runs: Mapping[str, np.ndarray]) -> None:
    """What was measured and the free runs of each output, beside the files of the diagnosis."""
    for j, c in enumerate(plant.outputs):
        values = {"measured": e[c.name]} | {which: e[c.name] - missed[:, j] for which, missed in runs.items()}
        lasting = {which: y for which, y in values.items() if np.isfinite(y).all()}
        made = Experiment.from_arrays(e.name, e.dt, outputs=lasting, units=dict.fromkeys(lasting, c.unit))
        write_csv(made, _runs_file(folder, e.name, c.name))


def _runs_file(folder: Path, record: str, channel: str) -> Path:
    return folder / "free_runs" / f"{record}_{channel}.csv"


# ---- what is said -----------------------------------------------------------------------------------------------------------


def verdict(rows: Sequence[Row], s: Summary) -> str:
    """Which machine was named as its label says, which not, and what falls short of the targets, in one paragraph."""
    by = {end: [row["machine"] for row in rows if ending(row, MACHINES[row["machine"]]) is end] for end in Ending}
    machines = [f"{end.value}: {', '.join(own) or 'none'}." for end, own in by.items()]
    short = [sentence for sentence in reached(TARGETS, s) if not sentence.startswith("Reached")]
    return " ".join(
        [f"{s.machines} measured machines.", *machines, *(short or [f"Reached: {'; '.join(f'{t.what}: {t}' for t in TARGETS)}."])]
    )


def said(row: Row) -> str:
    """A row on a line."""
    machine = MACHINES[row["machine"]]
    for fault in ("refused", "crashed"):
        if fault in row:
            return f"{machine.name} -> {fault}: {row[fault].strip().splitlines()[-1 if fault == 'crashed' else 0]}"
    gained = ", ".join(f"{h} x{r:.3g}" for h, r in ratios(row).items()) or "not judged"
    wrong = f"; against the label: {', '.join(against(row, machine))}" if against(row, machine) else ""
    kept = "; not handed out" if row["code"] else ""
    return (
        f"{machine.name} -> {row['verdict']}, {_causes(row) or 'no cause'}{wrong}{kept} "
        f"({row['seconds']:.0f} s; held-out {gained})"
    )


def _causes(row: Row) -> str:
    return "; ".join(map(_cause, row.get("causes", ())))


def _cause(c: Mapping[str, Any]) -> str:
    """A name, whether it is sure, its sizes with their 95 % intervals, and what it ties with."""
    numbers = ", ".join(
        f"{name} {value:.3g} [{low:.3g}, {high:.3g}] {c['units'][name]}".strip()
        for name, (value, low, high) in c["parameters"].items()
    )
    sure, ties = "" if c["sure"] else ", not sure", f" ~ {', '.join(c['ties'])}" if c["ties"] else ""
    return f"{c['key']} ({numbers}){sure}{ties}"


# ---- the page ---------------------------------------------------------------------------------------------------------------


def _report(rows: Sequence[Row], found: Summary, folder: Path, source: dict[str, Any]) -> Report:
    sections = (
        Section("Answers", (_answers(rows), target_table(TARGETS, {"all": found}))),
        Section("Held-out errors", (_errors(rows), *_references(rows), *_sizes(rows))),
        *(Section(row["machine"], _machine(row, folder / row["machine"])) for row in rows),
        Section("Provenance", (Provenance(source),)),
    )
    return Report("Real records: what the diagnosis says of nine measured machines", verdict(rows, found), sections)


def _answers(rows: Sequence[Row]) -> Table:
    table = []
    for row in rows:
        machine = MACHINES[row["machine"]]
        handed = "-" if "verdict" not in row else "no" if row["code"] else "yes"
        own = [ratios(row).get(horizon) for horizon in HORIZONS]
        answer = (row.get("verdict", "-"), _causes(row) or "-", handed)
        table.append((machine.name, ending(row, machine).value, *answer, *own, row["seconds"], machine.lacks))
    header = (
        "machine", "how it ends", "verdict", "causes", "handed out", *HORIZONS, "CPU time [s]", "label: a plain model lacks",
    )  # fmt: skip
    caption = (
        "One-step, one-second, full-run: held-out error of the plant as found over that of the plant as given, geometric mean of "
        "records and channels. Where the catalogue holds nothing of a label, no name is right, and unknown is."
    )
    return Table("What was said of each machine", header, tuple(table), caption=caption, digits=3)


def _errors(rows: Sequence[Row]) -> Table:
    table = []
    for row in rows:
        for horizon, own in row.get("errors", {}).items():
            table += [(row["machine"], horizon, where, before, after) for where, (before, after) in own.items()]
    caption = (
        "Root mean square; the start of a run is found on its record. Empty: the run did not last, or the record is too short."
    )
    return Table("Held-out errors", ("machine", "horizon", "record, channel", GIVEN, FOUND), tuple(table), caption=caption)


def _references(rows: Sequence[Row]) -> tuple[Table, ...]:
    table = []
    for row in rows:
        for ref in MACHINES[row["machine"]].references:
            if ref.record in row.get("others", {}):
                others = ", ".join(f"{method} {value:g}" for method, value in ref.others.items())
                what = f"{ref.measure} [{ref.unit}]"
                table.append((row["machine"], ref.record, what, *row["others"][ref.record], others, ref.begin, ref.note))
    header = ("machine", "record", "measure", GIVEN, FOUND, "published", "samples for the start", "note")
    caption = "Free runs on the test records, by the rules of their benchmarks: the start is fitted to the first samples alone."
    return (Table("Beside what others publish", header, tuple(table), caption=caption, digits=3),) if table else ()


def _sizes(rows: Sequence[Row]) -> tuple[Table, ...]:
    table = [(row["machine"], key, *numbers) for row in rows for key, numbers in sized(row, MACHINES[row["machine"]]).items()]
    return (Table("Sizes", ("machine", "number", "known", "found", "low", "high"), tuple(table), digits=3),) if table else ()


def _machine(row: Row, folder: Path) -> tuple[Block, ...]:
    """Label and answer in words, then measured and simulated free runs on every held-out record."""
    machine = MACHINES[row["machine"]]
    allowed = ", ".join(machine.right) or "no name of the catalogue"
    agrees = ", ".join(agreeing(row, machine)) or "none"
    parts = [f"A plain model lacks {machine.lacks}. Right: {allowed}. Named of these: {agrees}.", said(row)]
    parts += [row[fault] for fault in ("refused", "crashed", "unjudged") if fault in row]
    parts += [*row.get("first", ()), *(f"note: {note}" for note in row.get("notes", ()))]
    plant: Plant = getattr(real_plants, machine.plant)
    runs = [(Path(file).stem, c) for file in machine.held_out for c in plant.outputs]
    return (
        Text("\n\n".join(parts)),
        *(_picture(path, record, c) for record, c in runs if (path := _runs_file(folder, record, c.name)).exists()),
    )


def _picture(path: Path, record: str, channel: Channel) -> Block:
    e = read_file(path)
    simulated = {which: e[which] for which in (GIVEN, FOUND) if which in e.names}
    return figures.measured_and_simulated(record, e.t, Trace(channel, e["measured"]), simulated)
