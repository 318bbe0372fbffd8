"""A plant under a controller through a run: how well it tracks, and what that takes of the commands.

Parameters are those of the plant, and numbers of its effects: J1, coulomb@unwind:level.
"""

import json
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from controllers.files import controller_of
from studies.arguments import choose_controller, choose_plant, find_plant, is_own, trusted_plant
from workbench.errors import InputError, check_known
from workbench.files import read_json, sha256
from workbench.metrics import tracking
from workbench.physics.controller import Controller
from workbench.physics.parameters import EffectSizes
from workbench.physics.plant import Plant
from workbench.records import field, record
from workbench.robustness.limits import RUN, Manoeuvre, manoeuvre
from workbench.simulation import LeftRangeError, Scenario, lost_command, simulate, simulate_batch
from workbench.sweeps.design import Point, Sweep
from workbench.sweeps.job import StoppedError
from workbench.toml import Table

FIXED = ("plant", "controller", "run", "noise")
MEASURES = ("RMS", "max", "IAE")


@record
class ClosedLoop:
    """A plant (as `choose_plant` knows it) under a controller (the text of its file) through a run, with the noise of a seed.

    For each output with a set-point RMS, max and IAE of its error, for each command its travel: sum of |u(k) - u(k-1)|.
    own: file.py:NAME of a law of the user's own, in place of a text. sources: SHA-256 of the files that make the plant and that
    law; where they have changed no run is made. threads: of a compiled law's runs.
    """

    plant: str
    controller: str
    run: Manoeuvre
    parameters: tuple[str, ...]
    noise: bool = True
    sources: Mapping[str, str] = field(default_factory=dict)
    threads: int = 1
    own: str = ""

    def __post_init__(self):
        for name in self.parameters:
            self._place(name)
        self.run.references(self._law, self._machine.dt)

    @property
    def _machine(self) -> Plant:
        return _machine(self.plant, tuple(self.sources.items()))

    @property
    def _law(self) -> Any:
        return _law(self.controller, self.plant, self.own, tuple(self.sources.items()))

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
        law = self._law
        return score_units(self._machine, law.measured[: len(law.references)], law.actuated)

    def _place(self, name: str) -> tuple[str, int, str]:
        """Whether a parameter is the plant's or an effect's, where it stands in the vector of these, and its unit."""
        plant, (key, colon, number) = self._machine, name.partition(":")
        if not colon:
            known = [q.name for q in plant.parameters]
            i = known.index(check_known("parameter", name, known, file=plant.name))
            return "parameters", i, plant.parameters[i].unit
        check_known("effect", key, plant.effect_keys, file=plant.name)
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
            values = [vectors[kind].tolist() for kind in ("parameters", "effects")]
            runs = [
                single_run(plant, law, scenario, *_by_name(plant, *own))
                for scenario, *own in zip(scenarios, *values, strict=True)
            ]
        return [scores(plant, law, scenario, *run) for scenario, run in zip(scenarios, runs, strict=True)]

    def _scenario(self, plant: Plant, law: Any, seed: int) -> Scenario:
        run = self.run
        return Manoeuvre(run.duration, run.setpoints, run.start, seed if self.noise else None).scenario(plant, law, "sweep")


def score_units(plant: Plant, followed: Sequence[str], actuated: Sequence[str]) -> dict[str, str]:
    """Units of the scores of a loop, by name: of outputs that follow a set-point, and of its commands."""
    known = {c.name: c.unit for c in (*plant.inputs, *plant.outputs)}
    errors = {f"{y} {m}": f"{known[y]} s" if m == "IAE" else known[y] for y in followed for m in MEASURES}
    return errors | {f"{u} travel": known[u] for u in actuated}


def scores(plant: Plant, law: Any, scenario: Scenario, y: np.ndarray, u: np.ndarray) -> Mapping[str, float] | Exception:
    """Of a run's outputs y (N, ny) and commands u (N, nu): RMS, max and IAE of every error, travel of every command."""
    if not np.isfinite(y).all():
        k = int(np.isnan(y).any(axis=1).argmax())
        if (at := lost_command(u, k)) is not None:
            return LeftRangeError(f"the law commands no number after {at * plant.dt:g} s")
        return LeftRangeError(f"left the range of {plant.name} after {k * plant.dt:g} s")
    found = {}
    for name, reference in zip(law.measured, law.references, strict=False):
        error = y[:, plant.output_names.index(name)] - scenario.references[reference]
        found |= {f"{name} {m}": value for m, value in tracking(error, plant.dt).items()}
    for name in law.actuated:
        found[f"{name} travel"] = float(np.abs(np.diff(u[:, plant.input_names.index(name)])).sum())
    return found


def _by_name(plant: Plant, p: Sequence[float], eta: Sequence[float]) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Parameters and effects of these vectors."""
    effects: dict[str, dict[str, float]] = {}
    for slot, value in zip(plant.slots, eta, strict=True):
        effects.setdefault(slot.key, {})[slot.parameter.name] = value
    return {q.name: v for q, v in zip(plant.parameters, p, strict=True)}, effects


def single_run(
    plant: Plant, law: Any, scenario: Scenario, parameters: Mapping[str, float] | None = None, effects: EffectSizes | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs (N, ny) and commands (N, nu) of one run of any law; NaN from where it left the plant's range."""
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
    _check_unchanged(sources)
    return find_plant(plant)


def _check_unchanged(sources: tuple[tuple[str, str], ...]) -> None:
    for path, digest in sources:
        if sha256(path) != digest:
            raise StoppedError(
                "has changed since the sweep began", file=path, mend="begin the sweep anew in another --out folder"
            )


def _sources(plant: str, law: str) -> dict[str, str]:
    """The files of one's own plant and law: of their modules, and those that extend a plant."""
    files = (*choose_plant(plant).files, *(choose_controller(law, plant).files if law else ()))
    return {str(Path(path).resolve()): sha256(path) for path in files}


@lru_cache(maxsize=8)
def _law(text: str, plant: str, own: str, sources: tuple[tuple[str, str], ...]) -> Any:
    if own:
        _check_unchanged(sources)
        return choose_controller(own, plant).law
    return controller_of(json.loads(text), "controller", lambda base: trusted_plant(base, plant))


def from_file(sweep: Sweep, file: Path, options: Namespace) -> ClosedLoop:
    """[fixed] plant, controller (a file beside the sweep's), run (duration, setpoints, start), noise = false for none."""
    own = Table(file, "fixed", dict(sweep.fixed), FIXED)
    plant = options.plant or own.text("plant", None)
    if not options.plant and ("/" in plant or ":" in plant or plant.endswith((".json", ".py"))):
        raise own.refused("plant", repr(plant), f"a machine of the workbench; a plant of your own is named with --plant {plant}")
    code = options.controller if is_own(options.controller or "") else ""
    named = options.controller or own.text("controller", None)
    if not options.controller and is_own(named):
        raise own.refused(
            "controller", repr(named), f"a file that design wrote; a law of your own is named with --controller {named}"
        )
    law = Path(named) if options.controller else _beside(file, named)
    text = "" if code else json.dumps(read_json(law), sort_keys=True)
    names = tuple(p.name for p in sweep.factors)
    return ClosedLoop(plant, text, run_of(own), names, own.flag("noise", True), _sources(plant, code), own=code)


def run_of(fixed: Table) -> Manoeuvre:
    """The table `run` of [fixed]; seeds are the sweep's."""
    if "run" not in fixed.content:
        mend = "give its duration and set-points: [fixed.run.setpoints]"
        raise InputError("[fixed.run] is missing", file=fixed.file, mend=mend)
    return manoeuvre(fixed.table("run", [key for key in RUN if key not in ("seed", "initial")]))


def _beside(file: Path, name: str) -> Path:
    """A file that a sweep names: in its own folder or below."""
    folder = file.resolve().parent
    if "\0" in name:
        raise InputError(f"controller = {name!r}", file=file, mend="expected the name of a file")
    path = (folder / name).resolve()
    if not path.is_relative_to(folder):
        raise InputError(f"controller = {name!r} leaves the sweep's folder", file=file, mend=f"give --controller {name}")
    return path
