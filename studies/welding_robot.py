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
from studies.arguments import record_files, split_estimation
from studies.bounded import Bounded, bounded, cover_bounded
from studies.experiments import CURVES, measured
from workbench.answers.envelopes import (
    described_modes,
    domain_picture,
    envelope_pictures,
    envelope_table,
    mode_tables,
    width_picture,
)
from workbench.answers.scored import ScoredModel, scores_file
from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.files import write_json
from workbench.identification.lti import LTI
from workbench.intervals.coverage import SAYS_NOTHING, Coverage, cover, pooled
from workbench.intervals.model import IntervalModel
from workbench.intervals.output_error import OutputErrorRegression
from workbench.intervals.regression import IntervalRegression, InTime
from workbench.intervals.regressors import ARX
from workbench.intervals.semantics import InclusionExact
from workbench.metrics import Horizon, Score, Split, score
from workbench.physics.parameters import EffectSizes
from workbench.provenance import provenance
from workbench.readers import check_units, write_csv
from workbench.records import field, record
from workbench.report import figures
from workbench.report.blocks import Block, Provenance, Report, Section, Table, Text
from workbench.report.page import write_report
from workbench.sources import read

Say = Callable[[str], None]

INPUT, OUTPUT = "u", "v"
ESTIMATION = ("rbs", "multisine")
RANDOM = (*ESTIMATION, "prbs")  # names by which estimation records are known in a user's folder
ORDER = 2
HORIZONS: tuple[Horizon, ...] = ("one-step", "free-run")
# Friction and gravity of [2] Fig. 4's curves 1 and 3, and a mass between the nominal one and 1.8 times it. Curve 4 is heavier
# than anything the models have seen: they are to be judged there as well.
PERTURBED: EffectSizes = {**CURVES["curve1"], **CURVES["curve3"], "platform-mass@rail": {"change": 0.4, "swing": 0.4}}
MASS = "platform-mass@rail"
QUICK_CURVES = ("curve2", "curve4")
MULTIPLES = (1, 2, 3, 4, 5)  # of the records' sample time, at which boxes are tried
SHORTEST = 300  # samples that a record must keep
TIGHTER = (0.95, 0.9, 0.85, 0.8, 0.75, 0.7, 0.6, 0.5)  # mean radius asked of modes, in that of one box
TOLERANCE = 1e-3  # of the precision, to which it is raised without more modes


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

    def held(self, model: str, horizon: Horizon) -> list[Coverage]:
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
    logged = _read(Path(data)) if data else _simulate(seed, quick, folder, progress)
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
    results = [ScoredModel(identified.lti.model, "lti.json", judged.scores, judged.of(identified.lti.name))]
    for name, model in identified.models.items():
        results.append(ScoredModel(model, f"{name}.json", tuple(c.nominal for c in judged.of(name)), judged.of(name)))
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


def _simulate(seed: int, quick: bool, folder: Path, progress: Say) -> Records:
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


def _read(folder: Path) -> Records:
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


# ---- identification ---------------------------------------------------------------------------------------------------


def _samplings(estimation: Dataset, quick: bool, progress: Say) -> tuple[Sampling, ...]:
    """Widths at multiples of the sample time: a box at fast sampling reaches systems that hardly forget."""
    multiples = MULTIPLES[-1:] if quick else MULTIPLES
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
    method: IntervalRegression, one: IntervalModel, dataset: Dataset, quick: bool, *, merge: float | None = 0.1
) -> tuple[tuple[Step, ...], IntervalModel]:
    """Modes along time for tighter and tighter precisions, up to the first that cannot be met; the last one raised further."""
    radius = one.modes[0].mean_radius  # the steps count stretches of time; only the model taken has like ones merged
    steps, last, asked = [Step(one.precision, 1, radius)], one, one.precision
    for share in TIGHTER[1::3] if quick else TIGHTER:
        precision = math.exp(-share * radius / one.unit_range)
        try:
            found = replace(method, partition=InTime(precision, merge=None)).fit(dataset)
        except InputError:  # no modes of this length are as narrow: the limit of this structure
            break
        steps.append(Step(precision, len(found.modes), _over_modes(found)))
        last, asked = found, precision
    if last is one:
        return tuple(steps), replace(one, name=method.name)
    raised = replace(method, partition=InTime(asked, tolerance=None if quick else TOLERANCE, merge=merge)).fit(dataset)
    if not quick:
        steps[-1] = replace(steps[-1], reached=raised.precision)
    return tuple(steps), raised


def _over_modes(model: IntervalModel) -> float:
    """Mean radius over the samples of all modes [unit of y]."""
    return float(np.average([m.mean_radius for m in model.modes], weights=[m.samples for m in model.modes]))


def _mass_modes(record: Experiment, quick: bool) -> IntervalModel:
    """Modes of the record on which only the mass changes. Nothing acts besides the force, so the constant is left out."""
    method = IntervalRegression(ARX(ORDER, bias=False), name="mass")
    dataset = Dataset((record,))
    return _modes(method, method.fit(dataset), dataset, quick, merge=None)[1]


def _judge(identified: Identified, records: Records) -> Judged:
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


def _mean_radius(lines: list[Coverage]) -> float:
    return pooled(lines, lambda line: line.mean_radius)


def _inside(lines: list[Coverage]) -> float:
    """Percent of the measured values of all lines."""
    return 100.0 * pooled(lines, lambda line: line.coverage)


def _valid(lines: list[Coverage]) -> float:
    return 100.0 * pooled(lines, lambda line: line.valid)


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
    values = zip(WELDING_ROBOT.slots, WELDING_ROBOT.effect_vector(effects), strict=True)
    size = {slot.parameter.name: value for slot, value in values if slot.key == MASS}
    nominal = next(q.value for q in WELDING_ROBOT.parameters if q.name == "m1")
    mass = nominal * (1.0 + size["change"] + size["swing"] * np.sin(2 * np.pi * t / size["period"]))
    return np.array([frozen_parameters(m, dt) for m in mass])


# ---- the answer -----------------------------------------------------------------------------------------------------


def verdict(identified: Identified, judged: Judged, records: Records, quick: bool = False) -> str:
    """What to use and what not: one step of the box, and free runs. The numbers behind it are the findings."""
    one, lti, unit = identified.models["one-box"], identified.lti, records.held_out.experiments[0].channel(OUTPUT).unit
    step, free = judged.held("one-box", "one-step"), judged.held("one-box", "free-run")
    broken = sum(judged.violations.values())
    text = f"{broken} estimation samples lie outside an envelope that promised to hold them: trust nothing below. " * bool(broken)
    text += (
        f"One box leaves {judged.violations['one-box']} of {one.modes[0].samples} estimation samples outside. "
        f"One step ahead it holds {_inside(step):.1f} % of {sum(c.samples for c in step)} values of {len(records.held_out)} "
        f"records that no model has seen within {_width(step, one, unit)}; {lti.name} holds "
        f"{_inside(judged.held(lti.name, 'one-step')):.1f} % within {_width(judged.held(lti.name, 'one-step'), one, unit)}. "
    )
    text += f"In a free run that box reaches {_width(free, one, unit)}"
    text += (
        ", as wide as the speed moves: it says nothing there. " if _mean_radius(free) >= SAYS_NOTHING * one.unit_range else ". "
    )
    box = judged.held("simulation-box", "free-run")
    text += (
        f"The simulation box holds {_inside(box):.1f} % within {_width(box, one, unit)}: no bound for inputs of another kind. "
    )
    text += "Use the one-step envelope to test measured values and to design a loop with; it says nothing about a free run."
    return text + " This was a quick look: few precisions and records, one sample time." * quick


def findings(identified: Identified, judged: Judged, records: Records) -> tuple[str, ...]:
    """Paragraphs: the box beside LTI plus bound, what modes buy, free runs, and what the numbers do not say."""
    lti, one = identified.lti, identified.models["one-box"]
    held = {name: {h: judged.held(name, h) for h in HORIZONS} for name in (lti.name, *identified.models)}
    ratio = _mean_radius(held["one-box"]["one-step"]) / _mean_radius(held[lti.name]["one-step"])
    own = _mean_radius(held["one-box-as-measured"]["one-step"]) / _mean_radius(held[lti.name]["one-step"])
    beside = (
        f"One box of order {ORDER} at {one.dt:g} s is {ratio:.2g} times as wide as the bound around LTI, and {own:.2g} times if "
        "it promises, as that bound does, nothing but the measured values of the estimation records. "
        f"{_sampling_said(identified.samplings)}"
    )
    modes = _modes_said(identified, held["one-box"]["one-step"], held["modes"]["one-step"])
    kept = [c for c in judged.lines if c.split == "held-out" and c.coverage < 1.0]
    free = _curves_said(identified, judged) if records.mass else ""
    if kept:
        worst = min(kept, key=lambda c: c.coverage)
        free += (
            f"The lowest coverage of all is {100 * worst.coverage:.1f} %: {worst.model}, {worst.horizon}, record {worst.record}. "
        )
    domain = (
        f"{_valid(held['one-box']['one-step']):.0f} % of the held-out regressors lie in the hull of what the box has seen: the "
        "hull is not the true domain, outside it the envelope is no promise."
    )
    return tuple(paragraph.strip() for paragraph in (beside, modes, free, domain) if paragraph)


def _width(lines: list[Coverage], model: IntervalModel, unit: str) -> str:
    width = _mean_radius(lines)
    return f"\N{PLUS-MINUS SIGN}{width:.3g} {unit} ({_percent(100 * width / model.unit_range)} % of the range)"


def _sampling_said(samplings: tuple[Sampling, ...]) -> str:
    """The comparison with LTI at every sample time that was tried: the one chosen may favour either side."""
    if len(samplings) == 1:
        return f"That is at {samplings[0].dt:g} s, the one sample time tried; it may be otherwise at another. "
    ratios = [f"{s.one_step / s.lti_one_step:.2g} at {s.dt:g} s" for s in samplings]
    spread = max(s.simulation for s in samplings) / min(s.simulation for s in samplings) - 1.0
    return (
        f"That ratio depends on the sample time; on the estimation records it is {', '.join(ratios)}. The choice among them, by "
        f"the width of the simulation box, rests on differences of {100 * spread:.2g} % at most. "
    )


def _modes_said(identified: Identified, one: list[Coverage], modes: list[Coverage]) -> str:
    count = len(identified.models["modes"].modes)
    if count == 1:
        return "No precision tighter than that of one box can be met by modes along time. "
    narrower = 100.0 * (1.0 - _mean_radius(modes) / _mean_radius(one))
    inside = f"{_inside(modes):.1f} % inside instead of {_inside(one):.1f} %"
    return f"{count} modes along time make it {narrower:.0f} % narrower, {inside}. "


def _percent(value: float) -> str:
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}"


def _curves_said(identified: Identified, judged: Judged) -> str:
    """Free runs on records drawn like the estimation records, and on the four curves, whose arm rests and whose mass differs."""
    parts = []
    for name in ("simulation-box", identified.lti.name):
        lines = judged.held(name, "free-run")
        like, curves = [c for c in lines if c.record not in CURVES], [c for c in lines if c.record in CURVES]
        parts.append(f"{name} {_inside(like):.1f} and {_inside(curves):.1f} %")
    return f"Inside on records drawn like those of estimation, and on the curves of [2] Fig. 4: {'; '.join(parts)}. "


@record
class Line:
    """One model on all held-out records together: cells by name; NaN where there is nothing to say."""

    model: str
    widths: tuple[float, ...]  # inside [%], mean radius [unit], share of range [%]; one step, then free run
    ratio: float
    known: float
    modes: int | None
    violations: int | None
    inflated: int | None
    seconds: float


def _lines(identified: Identified, judged: Judged) -> list[Line]:
    found = []
    for name in (*identified.models, identified.lti.name):
        model, widths = identified.models.get(name), []
        one, free = (judged.held(name, horizon) for horizon in HORIZONS)
        for lines in (one, free):
            radius = _mean_radius(lines)
            widths += [_inside(lines), radius, 100 * radius / identified.lti.unit_range]
        found.append(
            Line(
                name,
                tuple(widths),
                max((c.ratio for c in free if c.ratio is not None), default=math.nan),
                _valid(one) if model else math.nan,
                len(model.modes) if model else None,
                judged.violations.get(name),
                sum(mode.inflated for mode in model.modes) if model else None,
                identified.seconds[name],
            )
        )
    return found


def _say_table(identified: Identified, judged: Judged, say: Say) -> None:
    say(f"\n{'held-out records':20}{'one step':>27}{'free run':>27}")
    say(f"{'model':20}" + f"{'inside':>11}{'radius':>8}{'range':>8}" * 2 + f"{'known':>9}{'violations':>12}{'time':>9}")
    for line in _lines(identified, judged):
        widths = (f"{inside:10.1f}%{r:8.3f}{share:7.1f}%" for inside, r, share in (line.widths[:3], line.widths[3:]))
        violations = "-" if line.violations is None else line.violations
        row = f"{line.model:20}{''.join(widths)}{line.known:8.0f}%{violations:>12}{line.seconds:8.2f}s"
        say(row.replace("nan%", "  - ").replace("nan", "  -"))


# ---- the page -------------------------------------------------------------------------------------------------------


def _report(
    logged: Records, records: Records, identified: Identified, judged: Judged, source: dict[str, Any], quick: bool
) -> Report:
    unit = records.estimation.experiments[0].channel(OUTPUT).unit
    curves = [e for e in logged.held_out if e.name in CURVES]
    first = [Section("The robot and its perturbations", (_curves(curves),))] if logged.mass and curves else []
    sections = [
        *first,
        Section(
            "Width and coverage",
            (Text("\n\n".join(findings(identified, judged, records))), *_widths(identified, judged, unit)),
        ),
        Section("Responses and their envelopes", tuple(_envelopes(identified, records))),
        Section("Modes", tuple(_mode_blocks(identified, records, unit))),
        Section("Choice of the sample time", (_sampling_table(identified, unit),)),
        Section("Records", (_data_table(logged),)),
        Section("Numbers", (envelope_table(judged.lines), *(t for m in identified.models.values() for t in mode_tables(m)))),
        Section("Notes", (Text("\n\n".join(line for m in identified.models.values() for line in described_modes(m))),)),
        Section("Provenance", (Provenance(source),)),
    ]
    return Report(
        "Welding robot: what an interval model holds and costs", verdict(identified, judged, records, quick), tuple(sections)
    )


def _curves(curves: list[Experiment]) -> Block:
    """[2] Fig. 4."""
    meaning = {name: " + ".join(key.partition("@")[0] for key in CURVES[name]) or "no perturbation" for name in CURVES}
    named = {f"{e.name[-1]}: {meaning[e.name]}": e[OUTPUT] for e in curves}
    picture = figures.responses(
        "Response to one input with and without perturbation", curves[0].t, named, curves[0].channel(OUTPUT).unit
    )
    return replace(
        picture,
        caption=f"{picture.caption} The numbers are those of [2] Fig. 4, which prints neither sizes nor which perturbation is "
        "which: both are ours. The estimation records hold friction and gravity of this size and a changing mass at once.",
    )


def _widths(identified: Identified, judged: Judged, unit: str) -> list[Block]:
    held = [c for c in judged.lines if c.split == "held-out"]
    pictures = [
        width_picture(f"{name}: coverage against width on held-out records", held, horizon)
        for name, horizon in zip(("One step ahead", "Free run"), HORIZONS, strict=True)
    ]
    lines = _lines(identified, judged)
    said = ("inside [%]", f"mean radius [{unit}]", "of range [%]")
    table = Table(
        "Models on held-out records",
        ("model", *(f"{horizon}: {what}" for horizon in ("one step", "free run") for what in said)),
        tuple((line.model, *line.widths) for line in lines),
        caption="Over all values of all held-out records; range: of the speed in the estimation records. One box and modes hold "
        "the true speed for every regressor within the noise; as measured, and the bound around LTI (its largest error on the "
        "estimation records), count the measured values only. The simulation box promises free runs only.",
        digits=3,
    )
    checks = Table(
        "What the models promise and cost",
        ("model", "modes", "violations", "inflated", "known [%]", "outer/reached", "time [s]"),
        tuple((n.model, n.modes, n.violations, n.inflated, n.known, n.ratio, n.seconds) for n in lines),
        caption="violations: estimation samples outside the envelope that promised to hold them. inflated: samples for which the "
        "verification widened a box. known: held-out regressors within the domain of a mode; elsewhere the nearest mode speaks. "
        "outer/reached: guaranteed over reached width of a free run, the largest over the records; 1 is exact.",
        digits=3,
    )
    return [table, checks, *pictures]


def _envelopes(identified: Identified, records: Records) -> list[Block]:
    """[2] Fig. 8: one step ahead once, free runs on every shown record."""
    models, shown = identified.models, records.shown
    step, *free = envelope_pictures(models["one-box"], shown[0])
    blocks: list[Block] = [step]
    for e in shown:
        blocks += envelope_pictures(models["simulation-box"], e)
    return [*blocks, *envelope_pictures(models["modes"], shown[0])[1:], *free]


def _mode_blocks(identified: Identified, records: Records, unit: str) -> list[Block]:
    """[2] Fig. 9, the number of modes against precision, and the validity domains."""
    steps, modes = identified.steps, identified.models["modes"]
    precision, count, radius = (np.array([getattr(s, a) for s in steps], float) for a in ("precision", "modes", "mean_radius"))
    picture = figures.modes_against_precision(precision, count, radius, steps[-1].precision, unit)
    raised = steps[-1].reached
    said = (
        "" if raised is None else f" With no more stretches its precision can be raised from {precision[-1]:.5g} to {raised:.5g}."
    )
    blocks: list[Block] = [
        replace(
            picture,
            caption=f"{picture.caption} The first is one box, the last the tightest of those tried that modes of at least "
            f"{5 * len(modes.form.names) + 1} samples can meet.{said}",
        )
    ]
    first = records.estimation.experiments[0]
    if identified.mass is not None and records.mass is not None:
        blocks += _along_time(identified.mass, records.mass, CURVES["curve4"])
    else:
        blocks += _along_time(modes, first, None)
    return [*blocks, domain_picture(modes, records.shown[0])]


def _along_time(model: IntervalModel, e: Experiment, effects: EffectSizes | None) -> list[Block]:
    """Modes of a record it was made from and their parameter intervals, with the frozen robot's where `effects` are known."""
    spans = sorted(
        (span.first, span.last, i) for i, mode in enumerate(model.modes) for span in mode.spans if span.record == e.name
    )
    k, index = np.arange(spans[0][0], spans[-1][1] + 1), np.array([i for *_, i in spans])
    mode = np.concatenate([np.full(last - first + 1, i) for first, last, i in spans])
    what = "while only the mass changes" if effects else f"on {e.name}"
    measured = figures.Trace(e.channel(OUTPUT), e[OUTPUT][k])
    short = [i for i, m in enumerate(model.modes) if m.short]
    names = [f"mode {i}" for i in range(len(model.modes))]
    along = figures.modes_along_time(f"Modes along time {what}", e.t[k], measured, mode, names, short)
    edges = np.array([*(e.t[first] for first, *_ in spans), e.t[k[-1]]])
    centre, radius = (np.array([getattr(m.box, a) for m in model.modes])[index] for a in ("centre", "radius"))
    parameters = {name: figures.ParameterInterval(centre[:, j], radius[:, j]) for j, name in enumerate(model.form.names)}
    title = f"Parameter intervals along time {what}"
    if effects is None:
        return [along, figures.parameters_along_time(title, edges, parameters)]
    truth = frozen_course(e.t[k], e.dt, effects)
    within = np.abs(truth - centre[_stretch(spans, k)]) <= radius[_stretch(spans, k)]
    picture = figures.parameters_along_time(
        title, edges, parameters, e.t[k], {name: truth[:, j] for j, name in enumerate(model.form.names)}
    )
    caption = (
        f"{picture.caption} A parameter is named by its regressor. Truth: the robot frozen at its present mass, sampled with a "
        f"held force. It lies within the intervals at {100 * np.mean(within):.0f} % of samples and parameters: a box is the "
        "narrowest that holds the outputs, not a confidence region of each parameter, and a parameter with no width is one that "
        "the outputs did not ask to move."
    )
    return [along, replace(picture, caption=caption)]


def _stretch(spans: list[tuple[int, int, int]], k: np.ndarray) -> np.ndarray:
    """The number of the stretch in which each sample lies."""
    return np.searchsorted([first for first, *_ in spans], k, side="right") - 1


def _sampling_table(identified: Identified, unit: str) -> Table:
    chosen = identified.models["one-box"].dt
    return Table(
        f"Mean radii [{unit}] by sample time on the estimation records",
        (
            "sample time [s]",
            "one box, one step",
            "one box, free run",
            "simulation box",
            "LTI bound, one step",
            "LTI bound, free run",
        ),
        tuple((s.dt, s.one_step, s.free_run, s.simulation, s.lti_one_step, s.lti_free_run) for s in identified.samplings),
        caption=f"Chosen: {chosen:g} s, where the simulation box is narrowest, be it by little: the comparison of one step with "
        "the LTI bound is to be read at every sample time, not at the chosen one alone.",
        digits=3,
    )


def _data_table(records: Records) -> Table:
    rows = []
    for split, dataset in (("estimation", records.estimation), ("held-out", records.held_out)):
        rows += [(e.name, split, len(e), e.dt * len(e), float(e[OUTPUT].min()), float(e[OUTPUT].max())) for e in dataset]
    unit = Channel(OUTPUT, records.estimation.experiments[0].channel(OUTPUT).unit)
    return Table(
        "Records as logged", ("record", "split", "samples", "duration [s]", f"from: {unit}", f"to: {unit}"), tuple(rows), digits=3
    )
