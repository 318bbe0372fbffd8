"""Interval models of the welding robot beside an LTI model plus a bound: records, models, judgement."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from plants import WELDING_ROBOT
from studies.arguments import record_files, split_estimation
from studies.experiments import CURVES, measured
from workbench.data import Dataset, Experiment
from workbench.identification.lti import LTI
from workbench.intervals.bounded import Bounded, bounded, cover_bounded
from workbench.intervals.coverage import Coverage, cover, pooled
from workbench.intervals.model import IntervalModel
from workbench.intervals.output_error import OutputErrorRegression
from workbench.intervals.precision import TIGHTER, Step, tightened
from workbench.intervals.regression import IntervalRegression
from workbench.intervals.regressors import ARX
from workbench.intervals.semantics import InclusionExact
from workbench.metrics import Horizon, Score, Split, score
from workbench.physics.parameters import EffectSizes
from workbench.readers import write_csv
from workbench.records import field, record
from workbench.sources import read
from workbench.units import check_units

Say = Callable[[str], None]
INPUT, OUTPUT = "u", "v"
ESTIMATION = ("rbs", "multisine")
RANDOM = (*ESTIMATION, "prbs")  # names by which estimation records are known in a user's folder
ORDER = 2
HORIZONS: tuple[Horizon, ...] = ("one-step", "free-run")
# Friction and gravity of [2] Fig. 4's curves 1 and 3, and a mass between the nominal one and 1.8 times it. Curve 4 is heavier
# than anything the models have seen: they are to be judged there as well.
PERTURBED: EffectSizes = {**CURVES["curve1"], **CURVES["curve3"], "platform-mass@rail": {"change": 0.4, "swing": 0.4}}
QUICK_CURVES = ("curve2", "curve4")
MULTIPLES = (1, 2, 3, 4, 5)  # of the records' sample time, at which boxes are tried
SHORTEST = 300  # samples that a record must keep


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
    """Mean radii of three envelopes at one sample time on the estimation records, and the bounds around LTI [unit of y]."""

    dt: float = field("", unit="s")
    one_step: float = field("")
    free_run: float = field("")
    simulation: float = field("")
    lti_one_step: float = field("")
    lti_free_run: float = field("")


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

    def held(self, model: str, horizon: Horizon) -> list[Coverage]:
        return [line for line in self.of(model) if line.split == "held-out" and line.horizon == horizon]


def simulated_records(seed: int, quick: bool, folder: Path, progress: Say) -> Records:
    """Estimation records, the same experiments with the next seed, and the four curves; all written as CSV."""
    wanted = [(name, name, seed, PERTURBED) for name in ESTIMATION]
    wanted += [(name, f"{name}-2", seed + 1, PERTURBED) for name in (ESTIMATION[:1] if quick else ESTIMATION)]
    wanted += [(name, name, seed + 1, CURVES[name]) for name in (QUICK_CURVES if quick else CURVES)]
    drawn = []
    for experiment, name, number, effects in wanted:
        progress(f"simulating {name}, seed {number}")
        drawn.append(_measured(experiment, name, number, effects))
        write_csv(drawn[-1], folder / "records" / f"{name}.csv")
    mass = _measured(ESTIMATION[0], "mass", seed, CURVES["curve4"])
    write_csv(mass, folder / "records_mass" / "mass.csv")
    estimation, held_out = Dataset(tuple(_known(e) for e in drawn)).split_records(ESTIMATION)
    return Records(estimation, held_out, _known(mass), tuple(folder / "records" / f"{e.name}.csv" for e in drawn))


def _measured(experiment: str, name: str, seed: int, effects: EffectSizes) -> Experiment:
    return replace(measured(WELDING_ROBOT, experiment, seed, effects), name=name)


def _known(e: Experiment) -> Experiment:
    """Force and speed: the arm's angle is hidden from every model, as it is on the real robot's rail."""
    return e.select((INPUT, OUTPUT)).with_roles(inputs=(INPUT,), outputs=(OUTPUT,))


def known_records(folder: Path) -> Records:
    """A user's records: random excitation estimates where it is there by name, otherwise the first half by name."""
    files = record_files(folder)
    experiments = tuple(read(*files, inputs=(INPUT,), outputs=(OUTPUT,)))
    for experiment in experiments:
        check_units(experiment, {c.name: c.unit for c in (*WELDING_ROBOT.inputs, *WELDING_ROBOT.outputs)})
    dataset = Dataset(tuple(_known(e) for e in experiments))
    chosen, rest = split_estimation(dataset, RANDOM)
    return Records(chosen, rest, files=tuple(files))


def _at(dataset: Dataset, dt: float) -> Dataset:
    return Dataset(tuple(e.resample(dt) for e in dataset))


def sampled_boxes(estimation: Dataset, quick: bool, progress: Say) -> tuple[Sampling, ...]:
    """Widths at multiples of the sample time: a box at fast sampling reaches systems that hardly forget."""
    multiples = MULTIPLES[-1:] if quick else MULTIPLES
    kept = [q for q in multiples if min(len(e) for e in estimation) >= q * SHORTEST] or [1]
    found = []
    for q in kept:
        progress(f"boxes at {q * estimation.dt:g} s")
        dataset = _at(estimation, q * estimation.dt)
        lti = bounded(LTI(resamples=0).fit(dataset), dataset, OUTPUT)
        lines = cover(IntervalRegression(ARX(ORDER)).fit(dataset), dataset, "estimation")
        one, free = (mean_radius([c for c in lines if c.horizon == horizon]) for horizon in HORIZONS)
        simulation = OutputErrorRegression(ARX(ORDER)).fit(dataset).modes[0].mean_radius
        found.append(Sampling(dataset.dt, one, free, simulation, lti.one_step, lti.free_run))
    return tuple(found)


def identify(records: Records, samplings: tuple[Sampling, ...], quick: bool, progress: Say) -> Identified:
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
    steps, models["modes"] = timed("modes", lambda: tightened(one, models["one-box"], dataset, **_effort(quick)))
    order = ("one-box", "modes", "one-box-as-measured", "simulation-box")
    mass = _mass_modes(records.mass, quick) if records.mass else None
    return Identified(lti, {name: models[name] for name in order}, seconds, samplings, steps, mass)


def _effort(quick: bool) -> dict[str, Any]:
    """How many precisions are tried, and whether the last one is raised."""
    return {"shares": TIGHTER[1::3], "tolerance": None} if quick else {}


def _mass_modes(record: Experiment, quick: bool) -> IntervalModel:
    """Modes of the record on which only the mass changes. Nothing acts besides the force, so the constant is left out."""
    method = IntervalRegression(ARX(ORDER, bias=False), name="mass")
    dataset = Dataset((record,))
    return tightened(method, method.fit(dataset), dataset, merge=None, **_effort(quick))[1]


def judge(identified: Identified, records: Records) -> Judged:
    lines: list[Coverage] = []
    splits: tuple[tuple[Split, Dataset], ...] = (("estimation", records.estimation), ("held-out", records.held_out))
    for split, dataset in splits:
        lines += cover_bounded(identified.lti, dataset, split)
        for model in identified.models.values():
            lines += cover(model, dataset, split)
    model = identified.lti.model
    scores = score(model, records.estimation, "estimation", HORIZONS) + score(model, records.held_out, "held-out", HORIZONS)
    violations = dict.fromkeys(identified.models, 0)
    for line in lines:
        promised = "free-run" if line.model == "simulation-box" else "one-step"
        if line.split == "estimation" and line.model in violations and line.horizon == promised:
            violations[line.model] += round((1.0 - line.coverage) * line.samples)
    return Judged(tuple(lines), scores, violations)


def mean_radius(lines: list[Coverage]) -> float:
    return pooled(lines, lambda line: line.mean_radius)
