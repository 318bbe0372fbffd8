"""What a sweep can run, by the name that its file gives.

    closed-loop     a plant under a controller through a run: how well it tracks, and what that takes of the commands

Parameters of a closed loop are those of the plant, and numbers of its effects: J1, coulomb@unwind:level.
"""

import importlib
import json
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from controllers.files import controller_of
from studies.arguments import choose_plant, find_plant, run_folder, trusted_plant
from studies.sweep_page import page
from workbench.errors import InputError, check_known
from workbench.files import nullable, read_json, sha256, write_json
from workbench.metrics import tracking
from workbench.physics.controller import Controller
from workbench.physics.plant import Plant
from workbench.provenance import provenance
from workbench.records import field, record
from workbench.report.page import write_report
from workbench.robustness.limits import RUN, Manoeuvre, manoeuvre
from workbench.sensitivity import sensitivity
from workbench.simulate import LeftRangeError, Scenario, simulate, simulate_batch
from workbench.sweep import (
    Factor,
    Job,
    Point,
    StoppedError,
    Sweep,
    export_csv,
    export_parquet,
    load_sweep,
    read_rows,
    require_parquet,
    run_sweep,
)
from workbench.toml import Table

Say = Callable[[str], None]

FIXED = ("plant", "controller", "run", "noise")
MEASURES = ("RMS", "max", "IAE")


@record
class ClosedLoop:
    """A plant (as `choose_plant` knows it) under a controller (the text of its file) through a run, with the noise of a seed.

    For each output with a set-point RMS, max and IAE of its error, for each command its travel: sum of |u(k) - u(k-1)|.
    sources: SHA-256 of the files that make the plant; where they have changed no run is made. threads: of a compiled law's runs.
    """

    plant: str
    controller: str
    run: Manoeuvre
    parameters: tuple[str, ...]
    noise: bool = True
    sources: Mapping[str, str] = field(default_factory=dict)
    threads: int = 1

    def __post_init__(self):
        for name in self.parameters:
            self._place(name)
        self.run.references(self._law, self._machine.dt)

    @property
    def _machine(self) -> Plant:
        return _machine(self.plant, tuple(self.sources.items()))

    @property
    def _law(self) -> Any:
        return _law(self.controller, self.plant)

    @property
    def configuration(self) -> Mapping[str, Any]:
        return {**{name: value for name, value in vars(self).items() if name != "threads"}, "run": vars(self.run)}

    def on_threads(self, count: int) -> "ClosedLoop | None":
        """A compiled law runs on threads of one process, which need not be started; another one holds Python's lock."""
        return replace(self, threads=count) if isinstance(self._law, Controller) else None

    @property
    def units(self) -> Mapping[str, str]:
        return {name: self._place(name)[2] for name in self.parameters}

    @property
    def outputs(self) -> Mapping[str, str]:
        plant, law = self._machine, self._law
        known = {c.name: c.unit for c in (*plant.inputs, *plant.outputs)}
        errors = {f"{y} {m}": f"{known[y]} s" if m == "IAE" else known[y] for y in self._followed for m in MEASURES}
        return errors | {f"{u} travel": known[u] for u in law.actuated}

    @property
    def _followed(self) -> tuple[str, ...]:
        law = self._law
        return law.measured[: len(law.references)]

    def _place(self, name: str) -> tuple[str, int, str]:
        """Whether a parameter is the plant's or an effect's, where it stands in the vector of these, and its unit."""
        plant, (key, colon, number) = self._machine, name.partition(":")
        if not colon:
            known = [q.name for q in plant.parameters]
            i = known.index(check_known("parameter", name, known, file=plant.name))
            return "parameters", i, plant.parameters[i].unit
        check_known("effect", key, dict.fromkeys(slot.key for slot in plant.slots), file=plant.name)
        known = [slot.parameter.name for slot in plant.slots if slot.key == key]
        check_known(f"parameter of {key}", number, known, file=plant.name)
        i = next(i for i, slot in enumerate(plant.slots) if (slot.key, slot.parameter.name) == (key, number))
        return "effects", i, plant.slots[i].parameter.unit

    def __call__(self, points: Sequence[Point]) -> list[Mapping[str, float] | Exception]:
        plant, law = self._machine, self._law
        vectors = {
            "parameters": np.tile(plant.nominal, (len(points), 1)),
            "effects": np.tile(plant.effect_vector(), (len(points), 1)),
        }
        for name in self.parameters:
            kind, i, _ = self._place(name)
            vectors[kind][:, i] = [_number(name, point.values[name]) for point in points]
        made = {seed: self._scenario(plant, law, seed) for seed in {point.seed for point in points}}
        scenarios = [made[point.seed] for point in points]
        if isinstance(law, Controller):
            done = simulate_batch(
                plant, law, scenarios, parameters=vectors["parameters"], effects=vectors["effects"], threads=self.threads,
                bumpless=True, alone=True,
            )  # fmt: skip
            runs = zip(done.measured, done.commands, strict=True)
        else:
            runs = [_stepped(plant, law, scenarios[i], vectors, i) for i in range(len(points))]
        return [self._scores(plant, law, scenario, *run) for scenario, run in zip(scenarios, runs, strict=True)]

    def _scenario(self, plant: Plant, law: Any, seed: int) -> Scenario:
        run = self.run
        return Manoeuvre(run.duration, run.setpoints, run.start, seed if self.noise else None).scenario(plant, law, "sweep")

    def _scores(
        self, plant: Plant, law: Any, scenario: Scenario, y: np.ndarray, u: np.ndarray
    ) -> Mapping[str, float] | Exception:
        if not np.isfinite(y).all():
            k = int(np.isnan(y).any(axis=1).argmax())
            return LeftRangeError(f"left the range of {plant.name} after {k * plant.dt:g} s")
        found = {}
        for name, reference in zip(self._followed, law.references, strict=True):
            error = y[:, plant.output_names.index(name)] - scenario.references[reference]
            found |= {f"{name} {m}": value for m, value in tracking(error, plant.dt).items()}
        for name in law.actuated:
            found[f"{name} travel"] = float(np.abs(np.diff(u[:, plant.input_names.index(name)])).sum())
        return found


def _stepped(
    plant: Plant, law: Any, scenario: Scenario, vectors: Mapping[str, np.ndarray], i: int
) -> tuple[np.ndarray, np.ndarray]:
    """A law that is computed step by step, one run by itself."""
    effects: dict[str, dict[str, float]] = {}
    for slot, value in zip(plant.slots, vectors["effects"][i].tolist(), strict=True):
        effects.setdefault(slot.key, {})[slot.parameter.name] = value
    parameters = {q.name: v for q, v in zip(plant.parameters, vectors["parameters"][i].tolist(), strict=True)}
    seen = simulate(plant, law, scenario, parameters=parameters, effects=effects, bumpless=True, cut=True).experiment
    whole = [np.full((len(scenario), len(names)), np.nan) for names in (plant.output_names, plant.input_names)]
    for values, names in zip(whole, (plant.output_names, plant.input_names), strict=True):
        for j, name in enumerate(names):
            if name in seen.names:
                values[: len(seen), j] = seen[name]
    return whole[0], whole[1]


def _number(name: str, value: float | str) -> float:
    if isinstance(value, str):
        raise InputError(f"{name} = {value!r}", file="sweep", mend="expected a number")
    return value


@lru_cache(maxsize=8)
def _machine(plant: str, sources: tuple[tuple[str, str], ...]) -> Plant:
    """Made once in every process, from the files that the sweep began with."""
    for path, digest in sources:
        if sha256(path) != digest:
            raise StoppedError(
                "has changed since the sweep began", file=path, mend="begin the sweep anew in another --out folder"
            )
    return find_plant(plant)


def _sources(plant: str) -> dict[str, str]:
    """The files of one's own plant: of its module, and those that extend it."""
    chosen = choose_plant(plant)
    module, colon, _ = chosen.base.rpartition(":")
    if colon:
        found = module if module.endswith(".py") else importlib.import_module(module).__file__
        return {str(Path(path).resolve()): sha256(path) for path in (found, *chosen.files) if path}
    return {str(Path(path).resolve()): sha256(path) for path in chosen.files}


@lru_cache(maxsize=8)
def _law(text: str, plant: str) -> Any:
    return controller_of(json.loads(text), "controller", lambda base: trusted_plant(base, plant))


def _closed_loop(sweep: Sweep, file: Path, options: Namespace) -> Job:
    """[fixed] plant, controller (a file beside the sweep's), run (duration, setpoints, start), noise = false for none."""
    own = Table(file, "fixed", dict(sweep.fixed), FIXED)
    plant = options.plant or own.text("plant", None)
    if not options.plant and ("/" in plant or ":" in plant or plant.endswith((".json", ".py"))):
        raise own.refused("plant", repr(plant), f"a machine of the workbench; a plant of your own is named with --plant {plant}")
    law = Path(options.controller) if options.controller else _beside(file, own.text("controller", None))
    if "run" not in own.content:
        raise InputError("[fixed.run] is missing", file=file, mend="give its duration and set-points: [fixed.run.setpoints]")
    table = own.table("run", [key for key in RUN if key != "seed"])  # seeds are the sweep's
    text, names = json.dumps(read_json(law), sort_keys=True), tuple(p.name for p in sweep.factors)
    return ClosedLoop(plant, text, manoeuvre(table), names, own.flag("noise", True), _sources(plant))


def _beside(file: Path, name: str) -> Path:
    """A file that a sweep names: in its own folder or below."""
    folder = file.resolve().parent
    if "\0" in name:
        raise InputError(f"controller = {name!r}", file=file, mend="expected the name of a file")
    path = (folder / name).resolve()
    if not path.is_relative_to(folder):
        raise InputError(f"controller = {name!r} leaves the sweep's folder", file=file, mend=f"give --controller {name}")
    return path


#: What a sweep file may name as `run`.
RUNS: dict[str, Callable[[Sweep, Path, Namespace], Job]] = {"closed-loop": _closed_loop}


def run(options: Namespace, say: Say, progress: Say) -> int:
    """Run a sweep, or finish it; writes sweep.sqlite, sweep.csv, and the page."""
    file = Path(options.sweep)
    sweep = load_sweep(file)
    make = RUNS[check_known("run", sweep.run, RUNS, file=file)]
    if options.resume and not options.out:
        raise InputError("which folder holds the sweep that is to go on?", mend="name it: --out DIR --resume")
    job = make(sweep, file, options)
    if options.parquet:
        require_parquet()
    folder = run_folder(options.out, "sweep")
    done = run_sweep(
        sweep, job, folder / "sweep.sqlite", resume=options.resume, jobs=options.jobs, scheduler=options.scheduler,
        progress=progress,
    )  # fmt: skip
    export_csv(folder / "sweep.sqlite", folder / "sweep.csv")
    found = read_rows(folder / "sweep.sqlite")
    say(f"{done.runs} runs, {done.failed} failed; {done.made} of them now, in {done.seconds:.1f} s")
    for text in _extremes(found, sweep.factors):
        say(text)
    try:
        indices, note = sensitivity(sweep, found), ""
    except InputError as reason:
        indices, note = (), str(reason)
        say(f"note: {note}")
    if options.parquet:
        say(f"rows: {export_parquet(folder / 'sweep.sqlite', folder / 'sweep.parquet')}")
    source = provenance({"sweep": options.sweep} | dict(job.configuration), [file], sweep.seed)
    report = write_report(page(f"Sweep {file.stem}", sweep, found, indices, source, note), folder)
    say(f"rows: {folder / 'sweep.sqlite'}, {folder / 'sweep.csv'}\nreport: {report}")
    if options.json:
        content = {"names": found.names, "units": dict(found.units), "rows": [list(row) for row in found.rows]}
        write_json(options.json, content | {"sensitivity": nullable([vars(i) for i in indices])})
    return 0


def _extremes(found: Any, factors: Sequence[Factor]) -> list[str]:
    """For every output its range, and the parameters of its lowest and highest value."""
    said = []
    names = list(found.names)
    for name in names[2 + len(factors) : -1]:
        i = names.index(name)
        rows = sorted((row for row in found.rows if row[i] is not None), key=lambda row: row[i])
        if not rows:
            continue
        ends = [", ".join(f"{p.name} {_told(row[names.index(p.name)])}" for p in factors) for row in (rows[0], rows[-1])]
        said.append(f"  {name}: {rows[0][i]:.4g} ({ends[0]}) to {rows[-1][i]:.4g} ({ends[1]}) {found.units[name]}".rstrip())
    return said


def _told(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"
