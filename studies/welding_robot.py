"""What does one interval model of the welding robot hold in which three perturbations act, and how wide is it?

The question of [2]: static friction, arm gravity and a changing platform mass act at once; the model knows force and speed
only. One box, modes along time and a simulation box are identified on two records, and judged on records of another seed and
on the four curves of [2] Fig. 4, beside an LTI model plus a bound on its error. Or on a user's own records.

[2] Linear time-varying models with interval parameters.
"""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm

from plants import WELDING_ROBOT
from studies.bounded import Bounded, bounded, cover_bounded
from studies.experiments import CURVES, plan
from studies.results import Result, scores_file
from workbench.data import Dataset, Experiment, check_held_out
from workbench.errors import InputError
from workbench.files import write_json
from workbench.identify.lti import LTI
from workbench.intervals.coverage import Coverage, cover
from workbench.intervals.model import IntervalModel, Simulation
from workbench.intervals.output_error import OutputErrorRegression
from workbench.intervals.regression import IntervalRegression, InTime
from workbench.intervals.regressors import ARX
from workbench.intervals.semantics import InclusionExact
from workbench.metrics import Score, score
from workbench.physics.plant import EffectSizes
from workbench.provenance import provenance
from workbench.readers import check_units, read_all, write_csv
from workbench.records import field, record
from workbench.report.page import write_report
from workbench.simulate import simulate

Say = Callable[[str], None]

INPUT, OUTPUT = "u", "v"
ESTIMATION = ("rbs", "multisine")
RANDOM = (*ESTIMATION, "prbs")  # names by which estimation records are known in a user's folder
ORDER = 2
HORIZONS = ("one-step", "free-run")
# Friction and gravity of [2] Fig. 4's curves 1 and 3, and a mass between the nominal one and 1.8 times it. Curve 4 is heavier
# than anything the models have seen: they are to be judged there as well.
PERTURBED: EffectSizes = CURVES["curve1"] | CURVES["curve3"] | {"platform-mass@rail": {"change": 0.4, "swing": 0.4}}
MASS = "platform-mass@rail"
MULTIPLES = (1, 2, 3, 4, 5)  # of the records' sample time, at which boxes are tried
SHORTEST = 300  # samples that a record must keep
TIGHTER = (0.95, 0.9, 0.85, 0.8, 0.75, 0.7, 0.6, 0.5)  # mean radius asked of modes, in that of one box
TOLERANCE = 1e-3  # of the precision, to which it is raised without more modes
USELESS = 0.5  # mean radius of an envelope in ranges of the output, from which on it is wider than the output moves


@record
class Records:
    """The records as logged. mass: one in which only the mass changes, with `effects`; None where nobody knows that."""

    estimation: Dataset
    held_out: Dataset
    mass: Experiment | None = None
    files: tuple[Path, ...] = ()

    def at(self, dt: float) -> "Records":
        """All records at sample time dt [s]."""
        mass = self.mass.resample(dt) if self.mass else None
        return Records(_at(self.estimation, dt), _at(self.held_out, dt), mass, self.files)

    @property
    def shown(self) -> tuple[Experiment, ...]:
        """Held-out records that are drawn: one with all perturbations, one with none, one with another mass; or the first two."""
        drawn = [e for e in self.held_out if e.name in (f"{ESTIMATION[0]}-2", "curve2", "curve4")] if self.mass else []
        return tuple(drawn) or self.held_out.experiments[:2]


@record
class Sampling:
    """Widths at one sample time on the estimation records: mean radii of three envelopes and the bounds around LTI [unit of y]."""

    dt: float = field("", unit="s")
    one_step: float = field("")
    free_run: float = field("")
    simulation: float = field("")
    lti_one_step: float = field("")
    lti_free_run: float = field("")


@record
class Step:
    """Modes along time for one precision; `reached` after raising it without more modes (None: not tried)."""

    precision: float = field("")
    modes: int
    mean_radius: float = field("")
    reached: float | None = None


@record
class Identified:
    """The models, how long they took [s], and how sample time and number of modes were chosen."""

    lti: Bounded
    models: dict[str, IntervalModel]
    seconds: dict[str, float]
    samplings: tuple[Sampling, ...]
    steps: tuple[Step, ...]
    mass: IntervalModel | None


@record
class Judged:
    """What the answer rests on: envelopes of every model on every record, LTI plus bound among them, LTI's scores, violations.

    violations: estimation samples outside the envelope that promised to hold them, by model.
    """

    lines: tuple[Coverage, ...]
    scores: tuple[Score, ...]
    violations: dict[str, int]

    def of(self, model: str) -> tuple[Coverage, ...]:
        return tuple(line for line in self.lines if line.model == model)

    def held(self, model: str, horizon: str) -> list[Coverage]:
        return [line for line in self.of(model) if line.split == "held-out" and line.horizon == horizon]


def main(
    quick: bool = False,
    *,
    folder: Path,
    data: str | None = None,
    seed: int = 1,
    json: str | None = None,
    say: Say = print,
    progress: Say = lambda _: None,
) -> Path:
    """Run the study and write records, models, scores and the report into `folder`; returns the report's path."""
    logged = _read(Path(data)) if data else _simulate(seed, folder, progress)
    samplings = _samplings(logged.estimation, quick, progress)
    records = logged.at(min(samplings, key=lambda s: s.simulation).dt)
    identified = _identify(records, samplings, quick, progress)
    progress("envelopes of every record")
    judged = _judge(identified, records)
    identified.lti.model.save(folder / "lti.json")
    for name, model in identified.models.items():
        model.save(folder / f"{name}.json")
    configuration = {
        "study": "welding-robot",
        "quick": quick,
        "data": data,
        "estimation": list(records.estimation.names),
        "held-out": list(records.held_out.names),
        "sample time": records.estimation.dt,
        "order": ORDER,
    }
    if not data:
        configuration["perturbations"] = {key: dict(sizes) for key, sizes in PERTURBED.items()}
    source = provenance(configuration, records.files, None if data else seed)
    results = [Result(identified.lti.model, "lti.json", judged.scores, judged.of(identified.lti.name))]
    for name, model in identified.models.items():
        results.append(Result(model, f"{name}.json", tuple(c.nominal for c in judged.of(name)), judged.of(name)))
    content = scores_file(results, source)
    write_json(folder / "scores.json", content)
    if json:
        write_json(json, content)
    progress("report")
    path = write_report(_report(logged, records, identified, judged, source, quick), folder)
    _say_table(identified, judged, say)
    say(f"\n{verdict(identified, judged, records, quick)}\n\nreport: {path}")
    return path


# ---- records --------------------------------------------------------------------------------------------------------


def _simulate(seed: int, folder: Path, progress: Say) -> Records:
    """Estimation records, the same experiments with the next seed, and the four curves; all written as CSV."""
    wanted = [(name, name, seed, PERTURBED) for name in ESTIMATION]
    wanted += [(name, f"{name}-2", seed + 1, PERTURBED) for name in ESTIMATION]
    wanted += [(name, name, seed + 1, effects) for name, effects in CURVES.items()]
    drawn = []
    for experiment, name, number, effects in wanted:
        progress(f"simulating {name}, seed {number}")
        drawn.append(_run(experiment, name, number, effects))
        write_csv(drawn[-1], folder / "records" / f"{name}.csv")
    mass = _run(ESTIMATION[0], "mass", seed, CURVES["curve4"])
    write_csv(mass, folder / "records_mass" / "mass.csv")
    estimation, held_out = Dataset(tuple(_known(e) for e in drawn)).split_records(ESTIMATION)
    return Records(estimation, held_out, _known(mass), tuple(folder / "records" / f"{e.name}.csv" for e in drawn))


def _run(experiment: str, name: str, seed: int, effects: EffectSizes) -> Experiment:
    todo = plan(WELDING_ROBOT.name, experiment)
    return replace(simulate(WELDING_ROBOT, todo.controller, todo.scenario(seed), effects=effects).experiment, name=name)


def _known(e: Experiment) -> Experiment:
    """Force and speed: the arm's angle is hidden from every model, as it is on the real robot's rail."""
    return e.select((INPUT, OUTPUT)).with_roles(inputs=(INPUT,), outputs=(OUTPUT,))


def _read(folder: Path) -> Records:
    """A user's records: random excitation estimates where it is there by name, otherwise the first half by name."""
    if not folder.is_dir():
        raise InputError("no such folder" if not folder.exists() else "is a file", file=folder, mend="give --data FOLDER")
    files = sorted(path for path in folder.glob("*") if path.suffix.lower() in (".csv", ".txt", ".tsv", ".mat"))
    if len(files) < 2:
        raise InputError(f"{len(files)} records", file=folder, mend="the study needs at least two records, one of them held out")
    experiments = tuple(read_all(files, inputs=(INPUT,), outputs=(OUTPUT,)))
    for experiment in experiments:
        check_units(experiment, {c.name: c.unit for c in (*WELDING_ROBOT.inputs, *WELDING_ROBOT.outputs)})
    dataset = Dataset(tuple(_known(e) for e in experiments))
    names = list(dataset.names)
    estimation = [name for name in names if name.lower() in RANDOM] or names[: (len(names) + 1) // 2]
    if len(estimation) == len(names):
        estimation = names[:-1]
    chosen, rest = dataset.split_records(estimation)
    check_held_out(chosen, rest)
    return Records(chosen, rest, files=tuple(files))


def _at(dataset: Dataset, dt: float) -> Dataset:
    return Dataset(tuple(e.resample(dt) for e in dataset))


# ---- identification ---------------------------------------------------------------------------------------------------


def _samplings(estimation: Dataset, quick: bool, progress: Say) -> tuple[Sampling, ...]:
    """Widths at multiples of the sample time: a box at fast sampling reaches systems that hardly forget."""
    multiples = MULTIPLES[1::3] if quick else MULTIPLES
    kept = [q for q in multiples if min(len(e) for e in estimation) >= q * SHORTEST] or [1]
    found = []
    for q in kept:
        progress(f"boxes at {q * estimation.dt:g} s")
        dataset = _at(estimation, q * estimation.dt)
        lti = bounded(LTI(resamples=0).fit(dataset), dataset, OUTPUT)
        lines = cover(IntervalRegression(ARX(ORDER)).fit(dataset), dataset, "estimation")
        one, free = (_mean_radius([c for c in lines if c.horizon == horizon]) for horizon in HORIZONS)
        simulation = OutputErrorRegression(ARX(ORDER)).fit(dataset).modes[0].mean_radius
        found.append(Sampling(dataset.dt, one, free, simulation, lti.one_step, lti.free_run))
    return tuple(found)


def _identify(records: Records, samplings: tuple[Sampling, ...], quick: bool, progress: Say) -> Identified:
    seconds: dict[str, float] = {}
    dataset = records.estimation

    def timed(name: str, work: Callable[[], Any]) -> Any:
        progress(f"{name}: identifying on {', '.join(dataset.names)} at {dataset.dt:g} s")
        begin = time.perf_counter()
        result = work()
        seconds[name] = time.perf_counter() - begin
        return result

    lti = timed("LTI", lambda: bounded(LTI().fit(dataset), dataset, OUTPUT))
    seconds[lti.name] = seconds.pop("LTI")
    models: dict[str, IntervalModel] = {}
    for name, method in (
        ("one-box", IntervalRegression(ARX(ORDER))),
        ("one-box-as-measured", IntervalRegression(ARX(ORDER), InclusionExact(), output_error=0.0, input_error=0.0)),
        ("simulation-box", OutputErrorRegression(ARX(ORDER))),
    ):
        models[name] = timed(name, lambda method=method, name=name: replace(method, name=name).fit(dataset))
    one = IntervalRegression(ARX(ORDER), name="modes")
    steps, models["modes"] = timed("modes", lambda: _modes(one, models["one-box"], dataset, quick))
    order = ("one-box", "modes", "one-box-as-measured", "simulation-box")
    mass = _mass_modes(records.mass, quick) if records.mass else None
    return Identified(lti, {name: models[name] for name in order}, seconds, samplings, steps, mass)


def _modes(
    method: IntervalRegression, one: IntervalModel, dataset: Dataset, quick: bool
) -> tuple[tuple[Step, ...], IntervalModel]:
    """Modes along time for tighter and tighter precisions, up to the first that cannot be met; the last one raised further."""
    radius = one.modes[0].mean_radius
    steps, last, asked = [Step(one.precision, 1, radius)], one, one.precision
    for share in TIGHTER[1::2] if quick else TIGHTER:
        precision = math.exp(-share * radius / one.unit_range)
        try:
            found = replace(method, partition=InTime(precision)).fit(dataset)
        except InputError:  # no modes of this length are as narrow: the limit of this structure
            break
        steps.append(Step(precision, len(found.modes), _over_modes(found)))
        last, asked = found, precision
    if len(last.modes) == 1:
        return tuple(steps), replace(one, name=method.name)
    raised = replace(method, partition=InTime(asked, tolerance=TOLERANCE)).fit(dataset)
    steps[-1] = replace(steps[-1], reached=raised.precision)
    return tuple(steps), raised


def _over_modes(model: IntervalModel) -> float:
    """Mean radius over the samples of all modes [unit of y]."""
    return float(np.average([m.mean_radius for m in model.modes], weights=[m.samples for m in model.modes]))


def _mass_modes(record: Experiment, quick: bool) -> IntervalModel:
    """Modes of the record on which only the mass changes. Nothing acts besides the force, so the constant is left out."""
    method = IntervalRegression(ARX(ORDER, bias=False), name="mass")
    dataset = Dataset((record,))
    return _modes(method, method.fit(dataset), dataset, quick)[1]


def _judge(identified: Identified, records: Records) -> Judged:
    lines: list[Coverage] = []
    for split, dataset in (("estimation", records.estimation), ("held-out", records.held_out)):
        lines += cover_bounded(identified.lti, dataset, split)
        for model in identified.models.values():
            lines += cover(model, dataset, split)
    model = identified.lti.model
    scores = score(model, records.estimation, "estimation", HORIZONS) + score(model, records.held_out, "held-out", HORIZONS)
    violations = {name: _violations(model, records.estimation) for name, model in identified.models.items()}
    return Judged(tuple(lines), scores, violations)


def _violations(model: IntervalModel, estimation: Dataset) -> int:
    """Estimation samples that the model's own promise leaves outside."""
    promised = model.free_run if isinstance(model.semantics, Simulation) else model.one_step
    return sum(int(np.sum(~promised(e).inside)) for e in estimation)


def _mean_radius(lines: list[Coverage]) -> float:
    return float(np.average([c.mean_radius for c in lines], weights=[c.samples for c in lines])) if lines else math.nan


def _inside(lines: list[Coverage]) -> float:
    """Percent of the measured values of all lines."""
    return 100.0 * float(np.average([c.coverage for c in lines], weights=[c.samples for c in lines])) if lines else math.nan


def _valid(lines: list[Coverage]) -> float:
    return 100.0 * float(np.average([c.valid for c in lines], weights=[c.samples for c in lines])) if lines else math.nan


# ---- truth: the frozen robot --------------------------------------------------------------------------------------------


def frozen_parameters(mass: float, dt: float) -> np.ndarray:
    """alpha_1, alpha_2, beta_1, beta_0 (4,) of the robot with its platform held at `mass` [kg], sampled with a held force.

    With the zero-order hold of [A B; 0 0] and D = q - 1:  D^2 v = -alpha_1 D v - alpha_2 v + beta_1 D u + beta_0 u.
    """
    p = WELDING_ROBOT.parameter_vector({"m1": mass})
    A, B, C, _ = WELDING_ROBOT.linearize(*WELDING_ROBOT.equilibrium(p), p)
    n = len(A)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = A * dt, B[:, WELDING_ROBOT.input_names.index(INPUT)] * dt
    held = expm(block)
    F, g, c = held[:n, :n] - np.eye(n), held[:n, n], C[0]  # in delta form D x = F x + g u
    alpha_1, alpha_2 = -np.trace(F), np.linalg.det(F)
    return np.array([alpha_1, alpha_2, c @ g, c @ (F + alpha_1 * np.eye(n)) @ g])


def frozen_course(t: np.ndarray, dt: float, effects: EffectSizes) -> np.ndarray:
    """The frozen parameters (len(t), 4) at the mass that the platform has at every instant t [s]."""
    slots = {str(slot).partition(":")[2]: value for slot, value in _numbers(effects) if slot.key == MASS}
    nominal = next(q.value for q in WELDING_ROBOT.parameters if q.name == "m1")
    mass = nominal * (1.0 + slots["change"] + slots["swing"] * np.sin(2 * np.pi * t / slots["period"]))
    return np.array([frozen_parameters(m, dt) for m in mass])


def _numbers(effects: EffectSizes):
    return zip(WELDING_ROBOT.slots, WELDING_ROBOT.effect_vector(effects), strict=True)
