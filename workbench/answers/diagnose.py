"""What a simulation gets wrong on records: the verb, the plant extended by what was found, the files and the page.

found = wb.diagnose(WEB_WINDING, data, held_out)
found.plant                     # the plant extended by the causes that are named
found.save("runs/monday")       # diagnosis.json, extended.json, next_experiment.csv, report.html
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from workbench.answers.answer import Answer, PlantAnswer, Records, prepared, texts
from workbench.answers.calibrate import traces
from workbench.answers.verdict import advice, ended, next_step, sentences, sizes, stated, where
from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis.answer import Cause, Diagnosis, Finding, NextExperiment
from workbench.diagnosis.calibrate import Trajectory, trajectories
from workbench.diagnosis.diagnosis import diagnose as searched
from workbench.diagnosis.domains import shown
from workbench.diagnosis.experiments import Template, proposable
from workbench.diagnosis.stages import StageError, Stages, stages
from workbench.files import nullable, write_json
from workbench.physics.extension import Extension, extension
from workbench.physics.plant import Plant
from workbench.progress import Progress, silent
from workbench.readers import write_csv
from workbench.records import record
from workbench.report import figures
from workbench.report.blocks import Badge, Block, Brief, Picture, Provenance, Report, Section, Standing, Table, Text
from workbench.report.figures import ParameterEstimate, Trace
from workbench.report.page import write_report

DIAGNOSIS_FILE = "diagnosis.json"
EXPERIMENT_FILE = "next_experiment.csv"
WINDOW = 60  # samples of a picture that shows a shift in time
FASTEST = 0.99  # share of an output's moves that are no faster than its rate


def diagnose(
    plant: Plant, records: Dataset, held_out: Dataset | None = None, *, templates: Sequence[Template] = (),
    dt: float | None = None, anyway: bool = False, accept: bool = False, progress: Progress = silent,
) -> "DiagnosisResult":  # fmt: skip
    """What `plant` lacks to explain `records`: its name, its size, how sure it is, and what it gains on `held_out` records.

    templates: experiments that the machine could run, sampled like the records. Among them and these records once more the one
    is sought that tells causes apart which tie. dt [s]: sample time to bring the records to. anyway: take records that do not
    look like this plant's. accept: hand the extended plant out although it is worse on held-out records than the one it
    replaces. Raises InputError for records that do not fit the plant. What is computed: `workbench.diagnosis`.

        >>> found = diagnose(MOTOR, data, held_out)
        >>> [f"{cause.effect}@{cause.place}" for cause in found.causes]
        ['coulomb@shaft']
    """
    given = prepared(plant, records, held_out, dt, anyway)
    tests = proposable(plant, templates, given.own)
    found = searched(plant, given.own, given.held_out, templates=tests, progress=progress, anyway=anyway)
    plant = plant.with_courses(found.between)
    progress("simulating data sheet, recalibrated and extended plant")
    return DiagnosisResult(plant, found, given, stages(plant, found, given.own, given.shown), accept)


@record
class DiagnosisResult(PlantAnswer):
    """What was found on records of a plant.

    `plant` is the extended plant, `causes` are named with their sizes, the strongest first, `finding` is the verdict in one word.
    nominal: the plant before; stages: it along the records that errors are told of.

        >>> found = diagnose(MOTOR, data, held_out)
        >>> f"{found.finding.value}: {found.causes[0].effect} of {found.plant.effects['coulomb@shaft']['level']:.2f} N m"
        'named: coulomb of 0.10 N m'
    """

    nominal: Plant
    diagnosis: Diagnosis
    records: Records
    stages: Stages
    accepted: bool = False

    @property
    def finding(self) -> Finding:
        """The verdict in one word."""
        return self.diagnosis.finding

    @property
    def causes(self) -> tuple[Cause, ...]:
        """What is named, the strongest first."""
        return self.diagnosis.causes

    @property
    def objections(self) -> tuple[str, ...]:
        return self.diagnosis.objections

    @property
    def sentences(self) -> list[str]:
        """The verdict and what it means, causes, what they gain, and what to do next."""
        return sentences(self.diagnosis, self.records.held_out is not None, self.stages.errors)

    @property
    def notes(self) -> list[str]:
        """What is odd about the records and the answer."""
        return list(dict.fromkeys([*self.records.notes, *self.diagnosis.notes]))

    def to_dict(self) -> dict[str, Any]:
        """The contract of a diagnosis, with what was tested, what looks alike, and the errors at each stage; a NaN is None."""
        errors = nullable([vars(e) for e in self.stages.errors])
        return {
            "plant": self.nominal.name,
            **to_dict(self.diagnosis),
            "stages": errors,
            "moved": moved(self.nominal.output_names, self.stages.extended),
        }

    def to_frame(self) -> Any:
        """Causes as a pandas table: effect, place, number, value, low, high, unit, sure. Raises ImportError without pandas."""
        import pandas

        rows = [
            (c.effect, c.place, name, e.value, e.low, e.high, e.unit, not c.doubt)
            for c in self.causes
            for name, e in c.parameters.items()
        ]
        return pandas.DataFrame(rows, columns=["effect", "at", "number", "value", "low", "high", "unit", "sure"])

    def report(self, source: Mapping[str, Any] | None = None) -> Report:
        """Verdict, causes in their domains, held-out runs, parameters, what is left, what to measure next, limits."""
        return page(self, source or self.source())

    def extension(self, base: str = "", source: Mapping[str, Any] | None = None) -> Extension:
        found = self.diagnosis
        return extension(self.nominal, base or self.nominal.name, found.parameters, found.effects, source)

    def save(self, folder: str | Path, *, base: str = "", source: Mapping[str, Any] | None = None) -> Path:
        """Write diagnosis.json, report.html, where there is one next_experiment.csv, and where it is handed out extended.json.

        Files of a former diagnosis that would say otherwise are removed. Returns the folder.
        """
        folder, source = Path(folder), source or self.source()
        todo, plant_file = self.diagnosis.next_experiment, self.save_plant(folder, base, source)
        if todo and todo.signals:
            write_csv(_experiment(self.nominal, todo), folder / EXPERIMENT_FILE)
        else:
            (folder / EXPERIMENT_FILE).unlink(missing_ok=True)
        content = self.to_dict()
        if todo and todo.signals:
            content["next_experiment"]["file"] = str(folder / EXPERIMENT_FILE)
        content["extended"] = plant_file
        write_json(folder / DIAGNOSIS_FILE, content | {"provenance": dict(source)})
        write_report(self.report(source), folder)
        return folder

    __repr__ = Answer.said


def moved(outputs: Sequence[str], runs: Sequence[Trajectory]) -> dict[str, dict[str, float]]:
    """Where each output was along records, low and high, and its rate per second, which 99 % of its moves do not exceed.

    Of the simulated output, which has no noise; where that left its range, of the predicted one.
    """
    found = {}
    for j, name in enumerate(outputs):
        own = [(run.t, run.simulated[:, j] if np.isfinite(run.simulated[:, j]).all() else run.predicted[:, j]) for run in runs]
        y = np.concatenate([values for _, values in own])
        rates = np.concatenate([np.abs(np.diff(values) / np.diff(t)) for t, values in own])
        if np.isfinite(y).any():
            rate = float(np.quantile(rates[np.isfinite(rates)], FASTEST))
            found[name] = {"low": float(np.nanmin(y)), "high": float(np.nanmax(y)), "rate": rate}
    return found


# ---- files -------------------------------------------------------------------------------------------------------------------


def to_dict(found: Diagnosis) -> dict[str, Any]:
    """The contract of a diagnosis, with what was tested and what looks alike; no number is null."""
    todo = found.next_experiment
    content = found.to_dict() | {
        "next_experiment": {"sentence": todo.sentence, "file": None, "expected": dict(todo.expected), "runs": todo.runs}
        if todo
        else None,
        "parameters": dict(found.parameters),
        "effects": {key: dict(numbers) for key, numbers in found.effects.items()},
        "similarity": {"effects": list(found.tested), "share": found.similarity},
        "seconds": found.seconds,
    }
    return nullable(content)


def _experiment(plant: Plant, todo: NextExperiment) -> Experiment:
    """The signals to be played as a record: set-points as references, inputs as inputs."""
    channels = tuple(
        Channel(trace.channel.name, trace.channel.unit, "reference" if name.endswith("_set") else "input")
        for name, trace in _signals(plant, todo).items()
    )
    values = np.column_stack([todo.signals[channel.name] for channel in channels])
    return Experiment("next_experiment", todo.dt * np.arange(len(values)), channels, values, todo.dt)


def _signals(plant: Plant, todo: NextExperiment) -> dict[str, Trace]:
    units = {c.name: c.unit for c in (*plant.inputs, *plant.outputs)}
    return {name: Trace(Channel(name, units.get(name.removesuffix("_set"), "")), values) for name, values in todo.signals.items()}


# ---- the page ----------------------------------------------------------------------------------------------------------------


def page(answer: DiagnosisResult, source: Mapping[str, Any]) -> Report:
    """Verdict; causes in their domains; held-out runs; rivals; parameters; limits; what is left; what to measure next."""
    plant, found, records, at = answer.nominal, answer.diagnosis, answer.records, answer.stages
    held_out = records.held_out is not None
    nominal = extension(plant, "", found.parameters).of(plant)
    named = {"recalibrated": at.recalibrated, "extended": at.extended}
    runs = traces(plant, named if found.effects else {"data sheet": at.data_sheet, "recalibrated": at.recalibrated})
    missing = _cause_blocks(nominal, found, records.own, records.shown) if found.causes else ()
    left = _left_blocks(plant, found) if found.remainder else ()
    drawn = [block for block in (*missing, *left) if isinstance(block, Picture)]
    by_title = {picture.title: picture for picture in runs}
    gained = [f"{e.channel}, record {e.record}" for e in _most_gained(at.errors)]
    told = next((by_title[title] for title in gained if title in by_title), next(iter(runs), None))
    first = next(iter(drawn), told)
    shown, rest = [told] if told and told is not first else [], [own for own in runs if own is not told]

    def without(blocks: Sequence[Block]) -> tuple[Block, ...]:
        return tuple(block for block in blocks if block is not first)

    sections = [
        *([Section("What is missing", without(missing))] if found.causes else []),
        Section(
            "Held-out records" if held_out else "Records",
            (*shown, _stage_table(at.errors, held_out)), (*_gain_tables(found, held_out), *rest),
        ),
        *([Section("What is left", without(left))] if found.remainder else []),
        Section("Parameters", *_split(_parameter_blocks(plant, found))),
        Section("What to measure next", _next_blocks(plant, found)),
        Section("What these records can show", (), _reach_blocks(found)),
        *([Section("Notes", (), texts(found.notes))] if found.notes else []),
        Section("Provenance", (), (Provenance(source),)),
    ]  # fmt: skip
    said = [*map(ended, found.objections), *answer.sentences]
    return Report(f"Diagnosis of {found.plant}", "\n\n".join(said), tuple(sections), _brief(answer, first))


def _split(blocks: tuple[Block, ...]) -> tuple[tuple[Block, ...], tuple[Block, ...]]:
    """The first block, and what is folded."""
    return blocks[:1], blocks[1:]


def _most_gained(errors: Sequence[StageError]) -> list[StageError]:
    """Errors of runs that last, those first in which the extended plant gains most over the data sheet."""
    last = [e for e in errors if e.data_sheet > 0.0 and np.isfinite(e.extended)]
    return sorted(last, key=lambda e: e.extended / e.data_sheet)


def _brief(answer: DiagnosisResult, picture: Picture | None) -> Brief:
    """What to mend, the cause with its size, what naming it gains, and whether the extended plant is handed out."""
    found = answer.diagnosis
    unsure = any(cause.doubt or cause.ties for cause in found.causes) or found.finding is Finding.INCOMPLETE
    standing = Standing.BAD if found.finding is Finding.UNKNOWN else Standing.OPEN if unsure else Standing.GOOD
    said = "; ".join(f"{cause.key}: {sizes(cause)}" for cause in found.causes[:2])
    left = ended(found.remainder[0].sentence) if found.remainder else "No effect of the catalogue explains these records."
    none = "These records show no effect of the catalogue." if found.finding is Finding.NOTHING else left
    badges = [Badge("Cause", found.finding.value, f"{said}." if said else none, standing)]
    on = "held-out records" if answer.records.held_out is not None else "these records: none was held out"
    if best := next(iter(_most_gained(answer.stages.errors)), None):
        word = f"{best.data_sheet:.3g} to {best.extended:.3g} {best.unit}".rstrip()
        less = Standing.GOOD if best.extended < best.data_sheet else Standing.OPEN
        badges.append(Badge("Full-run error", word, f"{best.channel} of {best.record}, data sheet to extended; {on}.", less))
    badges.append(answer.stands("Extended plant", found.signs))
    todo = advice(found, answer.handed_out)
    return Brief(f"What does the simulation of {found.plant} get wrong on these records?", todo, tuple(badges), picture)


def _cause_blocks(nominal: Plant, found: Diagnosis, own: Dataset, held: Dataset) -> tuple[Block, ...]:
    """A sentence and a picture for each cause, then the evidence; nominal: the plant with recalibrated parameters."""
    blocks: list[Block] = []
    for cause in found.causes:
        blocks.append(Text(f"{stated(cause)}\n\n{_equation(nominal, cause)}"))
        drawn = shown(nominal, found.effects, cause.key, own)
        if drawn is None:
            blocks.append(_shifted(nominal, found, cause, Dataset(held.experiments[:1])))
        else:
            what = Trace(drawn.what, drawn.measured)
            blocks.append(figures.missing(cause.key, drawn.over, what, drawn.x, drawn.deviation, drawn.after))
    return (*blocks, _evidence_table(found))


def _equation(plant: Plant, cause: Cause) -> str:
    """The equation in which the sizes stand, and what its symbols and signs mean."""
    effect = next(slot.effect for slot in plant.slots if slot.key == cause.key)
    port = next(q for q in plant.all_ports if (q.family, q.place) == (effect.family, cause.place))
    said = port.symbols_of(effect)
    return f"{effect.stated}{f'   ({said})' if said else ''}"


def _shifted(nominal: Plant, found: Diagnosis, cause: Cause, one: Dataset) -> Picture:
    """A few samples around the fastest change, as far as runs last, of the channel where the cause shows most; the other causes
    are in both runs.
    """
    others = {key: numbers for key, numbers in found.effects.items() if key != cause.key}
    old, new = (trajectories(extension(nominal, "", {}, effects).of(nominal), one)[0] for effects in (others, found.effects))
    seen = [i for i in range(len(nominal.outputs)) if np.isfinite(old.measured[:, i]).all()]
    change = np.nan_to_num(new.simulated - old.simulated)  # as far as both last
    away = [np.mean(change[:, i] ** 2) / np.var(old.measured[:, i]) for i in seen]
    i = next((i for i in seen if nominal.output_names[i] == cause.place), seen[int(np.argmax(away))])
    y = old.measured[:, i]
    lasts = np.isfinite(old.simulated[1:, i] + new.simulated[1:, i])
    middle = int(np.argmax(np.abs(np.convolve(np.diff(y), np.ones(3), "same")) * (lasts if lasts.any() else 1.0)))
    at = slice(max(middle - WINDOW // 3, 0), middle + WINDOW)
    runs = {"without the effect": old.simulated[at, i], "with the effect": new.simulated[at, i]}
    return figures.measured_and_simulated(f"{old.record}, {cause.key}", old.t[at], Trace(nominal.outputs[i], y[at]), runs)


def _evidence_table(found: Diagnosis) -> Table:
    """Every cause and its rivals; odds only where something ties."""
    rows: list[tuple] = []
    for c in found.causes:
        rows.append((c.key, "named", c.evidence.delta_bic, c.evidence.p_value, c.stability, 100 * c.evidence.posterior))
        rows += [(key, f"rival of {c.key}", None, None, None, 100 * weight) for key, weight in c.ties.items()]
    header = ("effect", "is", "gain in BIC", "p-value", "p of one size in all records", "odds [%]")
    caption = (
        "Gain in BIC: by how much the records prefer the model with the effect; 10 is much. P-value: the chance of such a gain "
        "where nothing is missing, over all effects tried. A small p of one size: records disagree on it."
    )
    if any(c.ties for c in found.causes):
        return Table("Causes and rivals", header, tuple(rows), caption=f"{caption} Odds: within a tie.", digits=3)
    return Table("Causes", header[:-1], tuple(row[:-1] for row in rows), caption=f"{caption} Nothing ties.", digits=3)


def _stage_table(errors: tuple[StageError, ...], held_out: bool) -> Table:
    """Data sheet, recalibrated, extended: full-run errors of every record and channel."""
    header = ("record", "channel", "data sheet", "recalibrated", "extended", "unit")
    rows = tuple((e.record, e.channel, e.data_sheet, e.recalibrated, e.extended, e.unit) for e in errors)
    caption = (
        f"Full-run error, root mean square, on {_on(held_out)}. Data sheet: nominal parameters, no effects. "
        "Recalibrated: parameters fitted without any effect. Extended: parameters and effects as found. A full run is driven by "
        "the logged inputs alone."
    )
    return Table("From the data sheet to the extended plant", header, rows, caption=caption)


def _gain_tables(found: Diagnosis, held_out: bool) -> tuple[Table, ...]:
    rows = tuple((c.key, g.record, g.channel, g.horizon, g.before, g.after, g.unit) for c in found.causes for g in c.gains)
    if not rows:
        return ()
    header = ("cause", "record", "channel", "horizon", "without", "with", "unit")
    caption = (
        f"Root mean square on {where(held_out)}, without each cause and with it; all other causes are in both, and the "
        "parameters are recalibrated in both."
    )
    return (Table("Gain of each cause", header, rows, caption=caption),)


def _on(held_out: bool) -> str:
    return "held-out records" if held_out else "the records themselves: none was held out"


def _left_blocks(plant: Plant, found: Diagnosis) -> tuple[Block, ...]:
    units = {c.name: c.unit for c in (*plant.states, *plant.inputs, *plant.outputs)} | {"t": "s", "time": "s"}
    blocks: list[Block] = []
    for r in found.remainder:
        if len(r.grid):
            what = Trace(Channel(r.channel, units.get(r.channel, "")), r.curve)
            over = Channel(r.variable, units.get(r.variable, ""))
            blocks.append(figures.left_over(f"{r.channel} over {r.variable}", over, what, r.grid))
    rows = tuple((r.channel, r.variable, r.p_value, 100 * r.share, r.sentence) for r in found.remainder)
    return (
        *blocks,
        Table("What is left", ("enters at", "varies with", "p-value", "share of the error [%]", "said"), rows, digits=3),
    )


def _parameter_blocks(plant: Plant, found: Diagnosis) -> tuple[Block, ...]:
    tolerance = {q.name: q.tolerance for q in plant.parameters}
    estimates = [
        ParameterEstimate(name, e.unit, e.nominal, e.value, e.low, e.high, tolerance.get(name, 0.0))
        for name, e in found.recalibrated.items()
    ]
    if not estimates:
        return (Text("No parameter is open: none has a tolerance."),)
    meaning = {q.name: q.meaning for q in plant.parameters}
    rows = tuple((e.name, e.unit, e.nominal, 100 * e.tolerance, e.value, e.low, e.high, meaning[e.name]) for e in estimates)
    header = ("parameter", "unit", "data sheet", "tolerance [%]", "value", "low", "high", "meaning")
    caption = "Fitted together with the effects that are named, with 95 % intervals."
    return (figures.parameters(estimates), Table("Parameters of the extended plant", header, rows, caption=caption))


def _next_blocks(plant: Plant, found: Diagnosis) -> tuple[Block, ...]:
    todo = found.next_experiment
    if todo is None:
        return (Text(next_step(found)),)
    rows = tuple(sorted(todo.expected.items(), key=lambda item: -item[1]))
    caption = "Twice the gain of log-likelihood by which an experiment should tell the rivals apart; below 10 it does not."
    table = (Table("Expected evidence", ("experiment", "expected evidence"), rows, caption=caption, digits=3),) if rows else ()
    if not todo.signals:
        return (Text(ended(todo.sentence)), *table)
    caption, played = f"{ended(todo.sentence)} Also beside this page as {EXPERIMENT_FILE}.", list(_signals(plant, todo).values())
    return (figures.signals("Next experiment", todo.dt * np.arange(len(played[0].values)), played, caption), *table)


def _reach_blocks(found: Diagnosis) -> tuple[Block, ...]:
    limits = Table(
        "Detection limits",
        ("at", "effect", "smallest size shown", "unit"),
        tuple((d.place, d.effect, d.value, d.unit) for d in sorted(found.limits, key=lambda d: (d.place, d.effect))),
        caption="The smallest size of each effect that these records would show (5 standard deviations).",
        digits=3,
    )
    rows = tuple((u.place, u.effect, u.why) for u in sorted(found.untestable, key=lambda u: (u.place, u.effect)))
    untestable = (Table("Could not be tested", ("at", "effect", "why"), rows),) if rows else ()
    alike = (figures.similarity(found.tested, found.similarity),) if len(found.tested) else ()
    return (limits, *untestable, *alike)
