"""Is a loop safe on every machine that the records leave open? Proved, or refuted with a run that shows it.

answer = wb.check(law, "limits.toml", model=model, records=data)     # proofs on the identified model
answer = wb.check(law, "limits.toml", plant=found.plant)             # the worst machine within tolerances
answer.status, answer.verdicts
answer.save("runs/monday")                                           # check.json, report.html, and what shows each failure
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from workbench.answers.answer import Answer, Records, as_dataset
from workbench.answers.verdict import ended
from workbench.data import Dataset
from workbench.errors import InputError
from workbench.files import nullable, write_json, write_text
from workbench.hammerstein import Model, behind, core_of
from workbench.intervals.errors import ErrorRegression
from workbench.intervals.model import IntervalModel
from workbench.lpv import check_schedule_from_outside
from workbench.physics.controller import check_controller
from workbench.physics.plant import Plant
from workbench.progress import Progress, silent
from workbench.provenance import provenance
from workbench.records import record
from workbench.report.blocks import Badge, Brief, Picture, Provenance, Report, Section, Standing, Table
from workbench.report.page import write_report
from workbench.robustness.falsify.box import fitted_box, fitted_box_of
from workbench.robustness.limits import LoopLimits, limits_of, load_limits
from workbench.robustness.linear_law import check_law, without_linear_form
from workbench.robustness.proof import proof_file
from workbench.robustness.verdict import Status, Verdict, overall
from workbench.units import in_units
from workbench.verification.curved import as_arriving
from workbench.verification.model import TITLE, claimed, on_model, opened
from workbench.verification.part import FROZEN, Part
from workbench.verification.plant import check_asked, on_plant
from workbench.verification.trial import Trial, along
from workbench.verification.trial import on_model as tried_on_model

CHECK_FILE = "check.json"
DECIDED = (Status.PROVED, Status.FAILED)

Limits = LoopLimits | Mapping[str, Any] | str | Path
Fitted = Mapping[str, Any] | Answer | str | Path


def check(
    controller: Any, limits: Limits, *, model: Model | None = None, records: Dataset | None = None,
    plant: Plant | None = None, fitted: Sequence[Fitted] = (), lags: int = 1, bound: Sequence[float] | None = None,
    nodes: int | None = None, rate: float | None = None, runs: int | None = None, seed: int = 0,
    progress: Progress = silent,
) -> "CheckResult":  # fmt: skip
    """Verdicts on a controller's loop: on an identified `model` with the `records` that bound its errors, on a `plant`, or both.

    limits: what the loop must keep: a limits.toml, or what it holds, {"run": {"duration": 20.0, ..}, "limits": {"theta": {..}}}.
    fitted: answers of diagnose and calibrate, or their JSON files, whose intervals bound the plant beside its tolerances. lags:
    samples of outputs and inputs that the model's errors may depend on; bound (ny): the largest error of each output beyond that,
    default what the model is off. nodes: schedule values at which stability is proved, of several schedule variables of each
    (default 5 and 3); rate [1/s]: prove it for a schedule that moves by up to that, too. runs: of the plant for each limit.
    Raises InputError for what does not fit together.

        >>> check(law, limits, plant=MOTOR, runs=20).status.value
        'UNDECIDED'
    """
    check_controller(controller, getattr(controller, "name", "controller"))
    asked = _limits(limits)
    if model is None and plant is None:
        mend = "give model= and records= for proofs, plant= for a search on the simulated machine, or both"
        raise InputError("check on what?", mend=mend)
    if (model is None) != (records is None):
        raise InputError("model and records go together", mend="the records say what the model leaves open")
    if fitted and plant is None:
        raise InputError("fitted intervals are for a search on the plant", mend="give plant= as well")
    for name, given, kind in (("model", model, Model), ("plant", plant, Plant)):
        if given is not None and not isinstance(given, kind):
            told = f"{name}: {type(given).__name__} {given!r}"[:80]
            expected = f"expected {'a plant' if kind is Plant else 'an LPV or Hammerstein-Wiener model'}"
            raise InputError(f"{told}, {expected}", mend="wb.identify(..).model, wb.diagnose(..).plant")
    if model is not None:
        check_schedule_from_outside(behind(controller, model)[1], "check")
    for name, count in (("lags", lags), ("nodes", nodes), ("runs", runs)):
        if count is not None and not (isinstance(count, int) and count >= 1):
            raise InputError(f"{name} = {count!r}", mend="expected a whole number from 1 on")
    if rate is not None and not 0.0 < rate < math.inf:
        raise InputError(f"rate = {rate:g}", mend="how fast the schedule moves, in its units per second: a number above 0")
    dataset = None if records is None else as_dataset(records)
    left = loop = None
    if model is not None and dataset is not None:
        dataset = in_units(dataset, core_of(model).units)
        loop = as_arriving(controller, model, dataset, asked)
        left = opened(ErrorRegression(lags, None if bound is None else list(bound)), loop.model, loop.records)
        if not without_linear_form(loop.law):
            check_law(loop.model, loop.law)
    progress("one run of the loop")
    trial = _tried(controller, asked, model, plant)
    parts = []
    if left is not None and loop is not None:
        part = Part(TITLE, ())
        if loop.limits is not None:
            part = on_model(left, loop.law, loop.limits, plant, nodes=nodes, rate=rate, driver=controller, progress=progress)
        parts.append(replace(part, verdicts=(*map(loop.told, part.verdicts), *loop.unsaid)))
    elif plant is not None and any((asked.stable, asked.margin, asked.sensitivity, asked.disk)):
        linear = hasattr(controller, "at")
        said = "asked of the loop itself: give --model and --records" if linear else without_linear_form(controller)
        of_loop = claimed(replace(asked, limits=()))
        unsaid = tuple(Verdict(name, "no model", Status.UNDECIDED, math.nan, "", said) for name in of_loop)
        parts.append(Part("Not checked", unsaid))
    if plant is not None:
        box = [d for own in fitted for d in _fitted(plant, own)]
        parts.append(on_plant(plant, controller, asked, box, runs=runs, seed=seed, progress=progress))
    configuration = {
        "controller": controller.name, "limits": asked.file, "model": getattr(model, "name", None),
        "plant": getattr(plant, "name", None), "lags": lags, "bound": None if bound is None else list(bound), "nodes": nodes,
        "rate": rate, "runs": runs,
    }  # fmt: skip
    boxes = () if left is None else described(left.errors)
    return CheckResult(controller, tuple(parts), trial, boxes, None if dataset is None else Records(dataset), configuration, seed)


@record
class CheckResult(Answer):
    """Verdicts by part, on the model and on the plant.

    `status` is the worst of `verdicts`, `sentences` say all of them; `save` writes a folder with what runs again.
    trial: one run of the loop; boxes: what the records leave open of the model, in words.

        >>> answer = check(law, limits, plant=MOTOR, runs=20)
        >>> [f"{verdict.claim}: {verdict.status.value}" for verdict in answer.verdicts]
        ['stable: UNDECIDED', 'n: high: PASSED']
    """

    controller: Any
    parts: tuple[Part, ...]
    trial: Trial
    boxes: tuple[str, ...]
    records: Records | None
    configuration: Mapping[str, Any]
    seed: int

    @property
    def verdicts(self) -> list[Verdict]:
        """All verdicts, that of one run of the loop among them where it is lost."""
        return after_trial([v for part in self.parts for v in part.verdicts], self.trial)

    @property
    def status(self) -> Status:
        """The worst of them."""
        return overall(self.verdicts)

    @property
    def sentences(self) -> list[str]:
        """The verdict over all, the run of the loop, then what failed, what is open, what holds."""
        worst = sorted(self.verdicts, key=lambda v: -list(Status).index(v.status))
        return [f"{self.status.value}: {counted(self.verdicts)}.", f"{self.tried}.", *(f"{v}." for v in worst)]

    @property
    def tried(self) -> str:
        """What one run of the loop has shown."""
        return f"LOST: {self.trial.sentence}" if self.trial.lost else self.trial.sentence

    def to_dict(self) -> dict[str, Any]:
        """Status, verdicts and the run of the loop."""
        content = {
            "status": self.status.value, "verdicts": [v.to_dict() for v in self.verdicts], "trial": dict(vars(self.trial))
        }  # fmt: skip
        return nullable(content)

    def write_proof(self, path: str | Path) -> Path:
        """Write what every proof and every refutation on the model rests on, for someone else to check; see docs/proofs.md."""
        decided = [(v.claim, v.status.value, v.shown) for v in self.verdicts if v.status in DECIDED and v.shown is not None]
        return write_text(path, json.dumps(nullable(proof_file(self.controller.name, decided)), allow_nan=False))

    def to_frame(self) -> Any:
        """The verdicts as a pandas table. Raises ImportError without pandas."""
        import pandas

        table = verdict_table(self.verdicts)
        return pandas.DataFrame(list(table.rows), columns=list(table.header))

    def source(self) -> dict[str, Any]:
        """Where the verdicts come from, unless a command says more of it."""
        if self.records is None:
            return provenance(self.configuration, (), self.seed)
        return {**self.records.source(self.configuration), "seed": self.seed}

    def report(self, source: Mapping[str, Any] | None = None) -> Report:
        """Verdicts, margins over the schedule, envelopes along the run, worst machines."""
        brief = self.brief
        sections = [Section("Verdicts", (verdict_table(self.verdicts),))]
        for part in self.parts:
            blocks = [block for block in part.blocks if block is not brief.picture]
            blocks.sort(key=lambda block: not isinstance(block, Picture))
            sections += [Section(part.title, tuple(blocks[:1]), tuple(blocks[1:]))] if blocks else []
        sections.append(Section("Provenance", (), (Provenance(dict(source or self.source())),)))
        said = headline(self.controller.name, self.status, self.verdicts, self.trial)
        return Report(f"Check of {self.controller.name}", said, tuple(sections), brief)

    @property
    def brief(self) -> Brief:
        """Whether the loop is safe, on the model and on the plant, and the run that comes nearest to a limit."""
        pictures = [block for part in self.parts for block in part.blocks if isinstance(block, Picture)]
        return Brief(
            f"Is the loop with {self.controller.name} safe on every machine that is left open?",
            _todo(self.controller.name, self.status, self.parts, self.trial),
            (*(badge(part.title, part.verdicts) for part in self.parts if part.verdicts), run_badge(self.trial)),
            _nearest(self.verdicts, pictures),
        )

    def save(self, folder: str | Path, *, base: str = "", own: str = "", source: Mapping[str, Any] | None = None) -> Path:
        """Write check.json, report.html and a file for each failure, which `workbench simulate --replay` runs again.

        base: where the plant is found, own: where the controller is found if it is code of the user's, file.py:NAME. Returns
        the folder.
        """
        folder, source = Path(folder), dict(source or self.source())
        for part in self.parts:
            part.save(folder, base, own, self.controller)
        write_json(folder / CHECK_FILE, self.to_dict() | {"provenance": nullable(source)})
        write_report(self.report(source), folder)
        return folder

    __repr__ = Answer.said


def _limits(given: Limits) -> LoopLimits:
    if isinstance(given, LoopLimits):
        return given
    if isinstance(given, Mapping):
        return limits_of(given)
    if not isinstance(given, str | Path):
        raise InputError(f"limits: {type(given).__name__} {given!r}"[:80], mend="give a limits.toml, or a dict of what it holds")
    return load_limits(given)


def _fitted(plant: Plant, given: Fitted) -> Iterable:
    if isinstance(given, str | Path):
        return fitted_box(plant, given)
    return fitted_box_of(plant, given.to_dict() if isinstance(given, Answer) else given)


def _tried(law: Any, limits: LoopLimits, model: Model | None, plant: Plant | None) -> Trial:
    """One run on the most truthful simulation at hand: of the plant, through what is asked; without one of the model."""
    if plant is None:
        assert model is not None
        first = {name: steps[0][1] for name, steps in limits.run.setpoints.items()} if limits.run else {}
        names = [c.name for c in core_of(model).outputs]
        return tried_on_model(law, model, [first[name] for name in names] if all(name in first for name in names) else None)
    check_asked(limits)
    assert limits.run is not None
    own = limits.run.scenario(plant, law)
    references = np.column_stack([own.references[name] for name in law.references])
    return along(law, plant, references, len(references) // 2, dict(own.start))


def after_trial(verdicts: Sequence[Verdict], trial: Trial) -> list[Verdict]:
    """The verdicts beside a run: one that was lost is a claim that failed, and a proof of frozen points says what it is."""
    if not trial.lost:
        return list(verdicts)
    lost = Verdict("the loop holds along one run", trial.where, Status.FAILED, math.nan, "", trial.sentence)
    told = [
        replace(v, claim=f"{v.claim}{'' if FROZEN in v.claim else FROZEN}", sentence=f"{v.sentence}; {trial.sentence}")
        if v.claim.startswith("stable") and v.status is not Status.FAILED
        else v
        for v in verdicts
    ]
    return [*told, lost]


STANDING = {
    Status.PROVED: Standing.GOOD, Status.PASSED: Standing.GOOD, Status.UNDECIDED: Standing.OPEN, Status.FAILED: Standing.BAD
}  # fmt: skip
#: What would decide, in plain words.
DECIDES = "More records, a calmer law (design with a lower --sensitivity) or a wider limit decide it."


def _todo(name: str, status: Status, parts: Sequence[Part], trial: Trial) -> str:
    """What to do with the law."""
    if trial.lost:
        return f"Do not switch {name} on: one run of the loop is lost."
    worst = [v.claim for part in parts for v in part.verdicts if v.status is status]
    which = f"{'; '.join(worst[:2])}{f' and {len(worst) - 2} more' if len(worst) > 2 else ''}"
    of_model = {v.status for part in parts if part.title == TITLE for v in part.verdicts}
    if status is Status.PASSED and of_model == {Status.PROVED}:
        return (
            f"Everything that was asked of {name} is proved on the identified model, while no command is at its limit; on the "
            "simulated plant nothing broke it."
        )
    return {
        Status.PROVED: f"Everything that was asked of {name} is proved, while no command is at its limit.",
        Status.PASSED: f"Nothing that was asked of {name} could be broken; it was tried, not proved.",
        Status.UNDECIDED: f"Nothing breaks {name}, but not all is decided: {which}. {DECIDES}",
        Status.FAILED: f"Do not switch {name} on: it does not keep {which}.",
    }[status]


def badge(about: str, verdicts: Sequence[Verdict]) -> Badge:
    """How verdicts stand, and of the worst one what it rests on."""
    status = overall(verdicts)
    worst = next(v for v in verdicts if v.status is status)
    said = "" if status in (Status.PROVED, Status.PASSED) else f" {worst.claim}: {worst.sentence}."
    return Badge(about, status.value, f"{counted(verdicts)}.{said}", STANDING[status])


def run_badge(trial: Trial) -> Badge:
    """Whether one run of the loop was lost."""
    word, standing = ("LOST", Standing.BAD) if trial.lost else ("kept", Standing.GOOD)
    return Badge("One run", word, ended(trial.sentence), standing)


def _nearest(verdicts: Sequence[Verdict], pictures: Sequence[Picture]) -> Picture | None:
    """The picture of the signal whose verdict is worst, of the smallest margin among equals."""
    order = list(Status)
    for v in sorted(verdicts, key=lambda v: (-order.index(v.status), math.inf if math.isnan(v.margin) else v.margin)):
        for picture in pictures:
            if picture.title.startswith(f"{v.claim.split(':')[0]} "):
                return picture
    return next(iter(pictures), None)


def headline(name: str, status: Status, verdicts: Sequence[Verdict], trial: Trial | None = None) -> str:
    """The verdict in one paragraph."""
    said = {
        Status.PROVED: f"PROVED: {name} keeps everything that was asked, whatever the records leave open of the model, while "
        "no command is at its stop.",
        Status.PASSED: f"PASSED: nothing that was asked of {name} could be broken. What is marked PASSED was tried, not proved.",
        Status.UNDECIDED: f"UNDECIDED: something asked of {name} is neither proved nor refuted. More records narrow the boxes, "
        "a calmer law (design with a lower --sensitivity) narrows the band, and a limit outside of the band is proved.",
        Status.FAILED: f"FAILED: {name} does not keep what was asked; a stored run shows it.",
    }[status]
    worst = [v for v in verdicts if v.status is status]
    said = f"LOST: {trial.sentence}. {said}" if trial and trial.lost else said
    return f"{said} {counted(verdicts)}.\n\n" + "\n\n".join(f"{v.claim} ({v.of}): {v.sentence}." for v in worst[:4])


def counted(verdicts: Sequence[Verdict]) -> str:
    """How many of each."""
    number = {status: sum(v.status is status for v in verdicts) for status in Status}
    return ", ".join(f"{count} {status.value}" for status, count in number.items() if count)


def verdict_table(verdicts: Sequence[Verdict], title: str = "Verdicts") -> Table:
    rows = tuple((v.claim, v.of, v.status.value, v.margin, v.unit, v.sentence, v.witness) for v in verdicts)
    header: tuple[str, ...] = ("claim", "of", "verdict", "margin", "unit", "what it rests on", "file")
    if not any(v.witness for v in verdicts):
        rows, header = tuple(row[:-1] for row in rows), header[:-1]
    return Table(
        title, header, rows, digits=3,
        caption="PROVED: a certificate, checked in outward-rounded arithmetic, or a bound that needs no solver and has its own "
        "rounding in it. PASSED: no counterexample was found, which proves nothing. FAILED: the file named runs again with "
        "workbench simulate --replay. UNDECIDED: neither; the margin is what is missing to a proof.",
    )  # fmt: skip


def described(errors: Sequence[IntervalModel]) -> tuple[str, ...]:
    """A line for each output: the box of what its error may depend on, and what is left beyond."""
    said = []
    for own in errors:
        box = own.modes[0].box
        low, high = box.centre - box.radius, box.centre + box.radius
        ends = [f"{low[i]:+.3g} to {high[i]:+.3g} times {name}" for i, name in enumerate(own.form.names[:-1])]
        said.append(f"{own.output.name}: {', '.join(ends)}; beyond that up to {box.radius[-1]:.3g} {own.output.unit}".rstrip())
    return tuple(said)
