"""How near do models come to published results on the benchmarks of nonlinear identification, chosen without a look at the test?

Every set is fitted on its estimation records by methods that choose order and degree on these alone, and run freely on its test
records by the rule of the benchmark: the start is found on so many first samples, which are not counted. Beside the black boxes
stands the plant that the diagnosis extends, and what others published. What loses stands there too.

The records are those of other people: the folder --data holds `real` with a folder for each machine, `emps` and
`winding_daisy`. A row of models.jsonl is whole as soon as a model is judged; a run that was cut off goes on where it stopped.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import welch

from plants import POSITIONING_AXIS
from studies import emps_laws, real_plants
from studies.arguments import check_files
from studies.real_records import run_by_rule
from workbench.data import Dataset, Experiment
from workbench.diagnosis.diagnosis import diagnose
from workbench.errors import InputError
from workbench.files import nullable, write_json
from workbench.hammerstein import Model
from workbench.identification.criterion import ByCriterion
from workbench.identification.hammerstein import HammersteinWiener
from workbench.identification.lti import LTI
from workbench.identification.output_error.method import OutputError
from workbench.identification.output_error.state_space import LPVOutputError
from workbench.identification.selection import Method
from workbench.identification.ssm import SSM
from workbench.metrics import fit, rmse
from workbench.physics.extension import extension
from workbench.physics.plant import Plant
from workbench.provenance import provenance
from workbench.readers import read_file, write_csv
from workbench.records import field, record
from workbench.report import figures
from workbench.report.blocks import Block, Provenance, Report, Section, Table, Text
from workbench.report.figures import Trace
from workbench.report.page import write_report
from workbench.sources import read
from workbench.table import fingerprint, resumed

Say = Callable[[str], None]
Row = dict[str, Any]

LAYOUT = 1  # of a row: rows of another layout are not shown with these
TABLE = "models.jsonl"
NAMED, REPLAYED = "named physics", "the estimation output again"
ABOVE = 0.7  # of the Nyquist frequency: what a gyroscope's output holds there is noise
JOINT = 1500  # sample at which the winding file begins its second run
BEGINNING = 32_000  # samples of the silverbox's arrow that do not extrapolate


@record
class Rule:
    """A record that is run: its name among the test records, samples for the start, where it stops, and what is published.

    published: results by method, in the measure of the set.
    """

    record: str
    begin: int
    published: Mapping[str, float] = field(default_factory=dict)
    stop: int | None = None

    @property
    def name(self) -> str:
        return self.record if self.stop is None else f"{self.record}, first {self.stop}"


@record
class Benchmark:
    """A set: its folder, estimation and test files, roles, methods, tests.

    measure: RMSE [unit], FIT [%], or BFR0 [%], which is FIT without the noise of the measured output. scale: of `unit` in the
    record's own. plant: what the diagnosis begins at; drift: whether forces that nobody logged may be noise. replay: whether the
    estimation output, played again, stands beside. schedule: none where the methods take none.
    """

    name: str
    folder: str
    estimation: tuple[str, ...]
    held_out: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    methods: Mapping[str, Method]
    tests: tuple[Rule, ...]
    schedule: tuple[str, ...] = ()
    measure: str = "RMSE"
    unit: str = ""
    scale: float = 1.0
    plant: Plant | None = None
    drift: bool = True
    replay: bool = False
    note: str = ""


LINEAR = {"lti": ByCriterion(LTI(resamples=0)), "oe": OutputError()}
OVER = {"ssm": ByCriterion(SSM()), "lpv-oe": LPVOutputError()}
WITHOUT = {"ssm": ByCriterion(SSM()), "hammerstein": HammersteinWiener()}
GYROSCOPE = "published values are presumably of an output without noise; the noise is read off the output's spectrum"

BENCHMARKS = {
    own.name: own
    for own in (
        Benchmark(
            "gyroscope, 2 schedules", "real/gyroscope", ("old_ML_estim.mat",), ("old_ML_valid.mat",), ("exp_u",), ("exp_y",),
            {"lti": LINEAR["lti"], "lpv-oe": OVER["lpv-oe"]},
            (Rule("old_ML_valid", 50, {"linear ARX": 30.0, "affine LPV-ARX": 76.0, "LPV-SUBNET": 98.0}),),
            schedule=("exp_p1", "exp_p2"), measure="BFR0", unit="%", note=GYROSCOPE,
        ),
        Benchmark(
            "gyroscope, 3 schedules", "real/gyroscope", ("ML_estim.mat",), ("ML_valid.mat",), ("exp_u",), ("exp_y",),
            {"lti": LINEAR["lti"], "lpv-oe": OVER["lpv-oe"]},
            (Rule("ML_valid", 50, {"linear ARX": 30.0, "affine LPV-ARX": 76.0, "LPV-SUBNET": 98.0}),),
            schedule=("exp_p1", "exp_p2", "exp_p3"), measure="BFR0", unit="%", plant=real_plants.GYROSCOPE, note=GYROSCOPE,
        ),
        Benchmark(
            "silverbox", "real/silverbox", ("multisine_train.csv",), ("multisine_test.csv", "arrow.csv"), ("V1",), ("V2",),
            {"lti": LINEAR["lti"], "lpv-oe": OVER["lpv-oe"]},
            (
                Rule("multisine_test", 50, {"linear": 6.96, "best": 0.30}),
                Rule("arrow", 50, {"linear": 14.4, "best": 0.26}),
                Rule("arrow", 50, {"linear": 6.58, "best": 0.26}, stop=BEGINNING),
            ),
            schedule=("V2",), unit="mV", scale=1e3, plant=real_plants.SILVERBOX,
        ),
        Benchmark(
            "cascaded tanks", "real/cascaded_tanks", ("est.csv",), ("val.csv",), ("u",), ("y",), LINEAR | OVER,
            (Rule("val", 4, {"linear": 0.588, "CT-SUBNET": 0.306, "grey box": 0.191}),),
            schedule=("y",), unit="V", plant=real_plants.CASCADED_TANKS,
        ),
        Benchmark(
            "coupled drives", "real/coupled_drives", ("run2_train.csv", "run3_train.csv"), ("run2_test.csv", "run3_test.csv"),
            ("u",), ("y",), LINEAR | {"hammerstein": WITHOUT["hammerstein"]}, (Rule("run2_test", 4), Rule("run3_test", 4)),
            measure="FIT", unit="%", plant=real_plants.COUPLED_DRIVES,
            note="the split is ours; on the official test records 0.224 and 0.384 (linear) to 0.096 and 0.074 are published",
        ),
        Benchmark(
            "EMPS", "emps", ("DATA_EMPS.mat",), ("DATA_EMPS_PULSES.mat",), ("F",), ("q",), LINEAR,
            (Rule("DATA_EMPS_PULSES", 20, {"linear": 5.53, "CT-SUBNET": 4.61, "dynoNet": 2.64}),),
            unit="mm", scale=1e3, plant=POSITIONING_AXIS, drift=False, replay=True,  # all forces but friction were logged
            note="both records follow one reference: the estimation output, played again, errs least: it tells little",
        ),
        Benchmark(
            "winding, DaISy", "winding_daisy", ("winding.dat",), ("winding.dat",), ("S1", "S2", "S3", "I1", "I3"), ("T1", "T3"),
            LINEAR | WITHOUT, (Rule("run 2", 50),), measure="FIT", unit="%",
            note="run 1 of the file is fitted, run 2 is run; each was whitened by itself, which no model can know",
        ),
    )
}  # fmt: skip
QUICK = ("cascaded tanks", "coupled drives", "winding, DaISy")


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
    """Fit and judge every model that `folder` does not hold yet, write the report; returns its path.

    quick: three of the sets. Raises InputError where records are missing, and for a folder of another version.
    """
    del seed  # measured records
    wanted = QUICK if quick else tuple(BENCHMARKS)
    files = _files(data, wanted)
    configuration = fingerprint(LAYOUT, *(Path(file).read_text(encoding="utf-8") for file in (__file__, real_plants.__file__)))
    keys = [f"{name}: {method}" for name in wanted for method in _methods(BENCHMARKS[name])]
    work = partial(judged, data=str(data), folder=folder, configuration=configuration)
    rows = resumed(
        folder / TABLE, work, keys, key="model", configuration=configuration, jobs=jobs, said=said, progress=progress
    )  # fmt: skip
    rows = [row for key in keys for row in rows if row["model"] == key]
    source = provenance({"study": "benchmarks", "quick": quick, "data": data}, files)
    for path in (folder / "summary.json", json):
        if path:
            write_json(path, nullable({"models": rows, "provenance": source}))
    progress("report")
    path = write_report(_report(rows, wanted, folder, source), folder)
    say("\n".join([verdict(rows), "", *map(said, rows), "", f"report: {path}"]))
    return path


# ---- a row ------------------------------------------------------------------------------------------------------------


def _files(data: str | None, wanted: Sequence[str]) -> list[Path]:
    """Every file of the sets. Raises InputError that says which is missing."""
    mend = "put the records (docs/benchmarks.md) into a folder with real, emps and winding_daisy in it, and give --data FOLDER"
    own = [BENCHMARKS[name] for name in wanted]
    return check_files(data, [Path(b.folder) / file for b in own for file in dict.fromkeys((*b.estimation, *b.held_out))], mend)


def _methods(b: Benchmark) -> Iterator[str]:
    yield from b.methods
    if b.plant:
        yield NAMED
    if b.replay:
        yield REPLAYED


def judged(key: str, data: str, folder: Path, configuration: str) -> Row:
    """A model of a set and how it runs on the test records; the runs go to `folder`."""
    name, method = key.split(": ")
    b, started = BENCHMARKS[name], time.process_time()
    row: Row = {"model": key, "set": name, "method": method, "configuration": configuration}
    try:
        estimation, held_out = records_of(b, Path(data))
        run, about = _runner(b, method, estimation)
        results = {}
        for test in b.tests:
            e = next(e for e in held_out if e.name == test.record)
            z = run(e, test.begin)
            results[test.name] = [_measured(b, e[c][test.begin : test.stop], z[test.begin : test.stop, j], e.dt)
                                  for j, c in enumerate(b.outputs)]  # fmt: skip
            if test.stop is None:
                _write_run(b, e, z, folder / "free_runs" / f"{_slug(key)}_{_slug(e.name)}.csv")
    except InputError as reason:
        return row | {"refused": str(reason), "seconds": time.process_time() - started}
    return row | {"results": results, "about": about, "seconds": time.process_time() - started}


def _runner(b: Benchmark, method: str, estimation: Dataset) -> tuple[Callable[[Experiment, int], np.ndarray], str]:
    """What runs freely on a record from its first samples, (N, ny), and what it is, in words."""
    if method == REPLAYED:
        again = estimation.experiments[0][list(b.outputs)]
        return lambda e, begin: again[: len(e)], "no model: what was measured on the estimation record"
    if method == NAMED and b.plant:
        plant, about = _extended(b.plant, estimation, b.drift)
        return lambda e, begin: run_by_rule(plant, e, begin), about
    model: Model = b.methods[method].fit(estimation)
    return lambda e, begin: model.simulate(e, warmup=begin), f"order {model.order}"


def _extended(plant: Plant, estimation: Dataset, drift: bool) -> tuple[Plant, str]:
    """The plant as the diagnosis of the estimation records alone extends it, and the causes that it names."""
    found = diagnose(plant, estimation, drift=drift)
    plant = plant.with_courses(found.between)
    whole = extension(plant, plant.name, found.parameters, found.effects).of(plant)
    return whole, "; ".join(c.key for c in found.causes) or "no cause named"


def _measured(b: Benchmark, y: np.ndarray, z: np.ndarray, dt: float) -> float | None:
    """RMSE, FIT or BFR0 of a run z on a record y, both (N,); None of a run that is lost."""
    if not np.isfinite(z).all():
        return None
    if b.measure == "RMSE":
        return b.scale * rmse(y, z)
    if b.measure == "FIT":
        return fit(y, z)
    noise = noise_variance(y, dt)
    missed = max(float(np.mean((y - z) ** 2)) - noise, 0.0) / (float(np.var(y)) - noise)
    return 100.0 * (1.0 - float(np.sqrt(missed)))


def noise_variance(y: np.ndarray, dt: float) -> float:
    """Variance of white noise on y (N,), by the spectrum above ABOVE of the Nyquist frequency, where nothing else is."""
    nyquist = 0.5 / dt
    frequency, power = welch(y, 1.0 / dt, nperseg=1024)
    return float(nyquist * np.mean(power[frequency > ABOVE * nyquist]))


def _write_run(b: Benchmark, e: Experiment, z: np.ndarray, path: Path) -> None:
    if np.isfinite(z).all():
        outputs = {f"{c} {what}": own for j, c in enumerate(b.outputs) for what, own in (("measured", e[c]), ("run", z[:, j]))}
        write_csv(Experiment.from_arrays(e.name, e.dt, outputs=outputs), path)


def _slug(text: str) -> str:
    return "".join(c if c.isalnum() else "-" for c in text)


# ---- records -----------------------------------------------------------------------------------------------------------


def records_of(b: Benchmark, data: Path) -> tuple[Dataset, Dataset]:
    """Estimation and test records of a set, with its roles."""
    folder = data / b.folder
    if b.name == "EMPS":
        own = emps_laws.emps_records(str(folder), False)
        both = [[own.estimation], [replace(own.held_out, name="DATA_EMPS_PULSES")]]
    elif b.name.startswith("winding"):
        both = [[run] for run in _winding(b, folder / b.estimation[0])]
    else:
        both = [list(read(*(folder / file for file in own))) for own in (b.estimation, b.held_out)]
    estimation, held_out = (
        Dataset(tuple(e.with_roles(inputs=b.inputs, outputs=b.outputs, schedule=b.schedule) for e in own)) for own in both
    )
    return estimation, held_out


def _winding(b: Benchmark, path: Path) -> Iterator[Experiment]:
    """The two runs that the file glues together."""
    values = np.loadtxt(path)
    for number, own in enumerate((values[:JOINT], values[JOINT:]), 1):
        yield Experiment.from_arrays(f"run {number}", 0.1, other=dict(zip((*b.inputs, *b.outputs), own.T, strict=True)))


# ---- what is said -------------------------------------------------------------------------------------------------------


def better(b: Benchmark, a: float, other: float) -> bool:
    return a < other if b.measure == "RMSE" else a > other


def best_of(rows: Sequence[Row], b: Benchmark, test: Rule) -> tuple[float, str] | None:
    """The best of our models on a test, with its method; what is no model does not count."""
    found = [
        (float(np.mean(own)), row["method"])
        for row in rows
        if row["set"] == b.name
        and row["method"] != REPLAYED
        and None not in (own := row.get("results", {}).get(test.name, [None]))
    ]
    return (min if b.measure == "RMSE" else max)(found, default=None)


def verdict(rows: Sequence[Row]) -> str:
    """On which tests we are as good as the best that is published, on which better than linear models, on which not."""
    first, between, last = "at least as good as the best published", "better than linear", "not better than linear"
    ends: dict[str, list[str]] = {first: [], between: [], last: []}
    for b in BENCHMARKS.values():
        for test in b.tests:
            own, others = best_of(rows, b, test), list(test.published.values())
            if own is None or not others:
                continue
            top, linear = (min, max) if b.measure == "RMSE" else (max, min)
            end = first if not better(b, top(others), own[0]) else between if better(b, own[0], linear(others)) else last
            ends[end].append(f"{b.name}, {test.name} ({own[0]:.3g} {b.unit} by {own[1]}, published {top(others):g})")
    return " ".join(f"{end.capitalize()}: {'; '.join(own) or 'none'}." for end, own in ends.items())


def said(row: Row) -> str:
    """A row on a line."""
    return f"{row['set']}, {_line(row)}"


def _line(row: Row) -> str:
    b = BENCHMARKS[row["set"]]
    if "refused" in row:
        return f"{row['method']}: refused: {row['refused'].splitlines()[0]} ({row['seconds']:.0f} s)"
    found = "; ".join(f"{', '.join(_number(v) for v in own)} {b.unit} on {test}" for test, own in row["results"].items())
    return f"{row['method']}: {b.measure} {found} ({row['about']}, {row['seconds']:.0f} s)"


def _number(value: float | None) -> str:
    return "lost" if value is None else f"{value:.3g}"


# ---- the page -----------------------------------------------------------------------------------------------------------


def _report(rows: Sequence[Row], wanted: Sequence[str], folder: Path, source: dict[str, Any]) -> Report:
    sections = (
        Section("Results", (_table(rows, wanted),)),
        *(Section(name, _set(rows, BENCHMARKS[name], folder)) for name in wanted),
        Section("Provenance", (Provenance(source),)),
    )
    return Report("Benchmarks: free runs beside published ones", verdict(rows), sections)


def _table(rows: Sequence[Row], wanted: Sequence[str]) -> Table:
    table = []
    for name in wanted:
        b = BENCHMARKS[name]
        for test in b.tests:
            black = best_of([row for row in rows if row["method"] != NAMED], b, test)
            named = best_of([row for row in rows if row["method"] == NAMED], b, test)
            linear, *_, top = test.published.values() or (None, None)
            table.append((
                name, test.name, f"{b.measure} [{b.unit}]", black and black[0], black[1] if black else "-", named and named[0],
                linear, top, test.begin,
            ))  # fmt: skip
    header = ("set", "test record", "measure", "black box", "by", NAMED, "published: linear", "published: best", "start")
    caption = (
        "Free runs. Start: so many first samples, on which alone the start is found; they are not counted. Orders, degrees and "
        "causes come from the estimation records. The best black box is picked here, with a look at the test: each method has "
        "its own line below. Mean over outputs where there are several."
    )
    return Table("Ours and published", header, tuple(table), caption=caption, digits=3)


def _set(rows: Sequence[Row], b: Benchmark, folder: Path) -> tuple[Block, ...]:
    own = [row for row in rows if row["set"] == b.name]
    lines = [_line(row) for row in own]
    for test in b.tests:
        if others := ", ".join(f"{method} {value:g}" for method, value in test.published.items()):
            lines.append(f"Published: {b.measure} {others} {b.unit} on {test.name}")
    blocks: list[Block] = [Text("\n\n".join([*([f"Note: {b.note}."] if b.note else []), *lines]))]
    for name in dict.fromkeys(test.record for test in b.tests):
        paths = {row["method"]: folder / "free_runs" / f"{_slug(row['model'])}_{_slug(name)}.csv" for row in own}
        runs = {method: read_file(path) for method, path in paths.items() if path.exists()}
        for c in b.outputs if runs else ():
            e = next(iter(runs.values()))
            measured = Trace(replace(e.channel(f"{c} measured"), name=c), e[f"{c} measured"])
            simulated = {method: run[f"{c} run"] for method, run in runs.items()}
            blocks.append(figures.measured_and_simulated(f"{b.name}: {name}", e.t, measured, simulated))
    return tuple(blocks)
