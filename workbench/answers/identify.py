"""Models from records: the verb, which method it takes and why, scores, the referee, the files and the page.

found = wb.identify(data, held_out)     # the method that runs best on parts of `data` that it was not fitted to
found.model, found.scores
found.save("runs/monday")               # ssm.json, scores.json, report.html
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from workbench.answers.answer import Answer, Records, as_dataset, refused
from workbench.answers.comparison import comparison, headline, score_table
from workbench.answers.envelopes import Method as IntervalMethod
from workbench.answers.envelopes import described_modes, fit_outputs
from workbench.answers.objections import above_floor, refereed
from workbench.answers.scored import ScoredModel, scores_file
from workbench.data import Channel, Dataset, Experiment, check_held_out
from workbench.decimation import thinned
from workbench.errors import InputError, check_known
from workbench.files import write_json
from workbench.hammerstein import HammersteinWienerModel, Model
from workbench.identification import CURVED, METHODS
from workbench.identification.criterion import ByCriterion
from workbench.identification.hammerstein import HammersteinWiener
from workbench.identification.schedules import schedules_of
from workbench.identification.selection import Choice, Method, choose
from workbench.intervals.coverage import cover
from workbench.intervals.model import IntervalModel
from workbench.lpv import MUCH, LPVModel
from workbench.metrics import Horizon, Score, score
from workbench.progress import Progress, silent
from workbench.records import record
from workbench.report.blocks import Report
from workbench.report.page import write_report

SCORES_FILE = "scores.json"
LATE = "lpv-oe"  # takes minutes: over one schedule variable it is tried where the others leave much to do
CURVES = "hammerstein"  # its models are not LPV models: it is tried where none of those follows the records
GOOD, FEW = 90.0, 5000  # free-run FIT below which these are tried, and on how many samples at most without being asked for
MUCH_BETTER = 0.7  # of the error of free runs: what curves must do to be spoken of
FOLLOWS = 30.0  # free-run FIT on left-out parts of a model that is handed out where all others are worse than the mean


def identify(
    records: Dataset, held_out: Dataset | None = None, *, methods: Mapping[str, Method] | Sequence[str] | None = None,
    best: bool | None = None, criterion: str = "best", interval: IntervalMethod | None = None, dt: float | None = None,
    horizon: int = 25, accept: bool = False, progress: Progress = silent,
) -> "IdentificationResult":  # fmt: skip
    """LPV models of the outputs of `records` from their inputs over their schedule, scored on `held_out` records.

    methods: names ("lti", "ilm", "ssm", "oe", "lpv-oe"), or methods by name such as {"ssm": SSM(order=3)}; default all, for one
    schedule variable the last only where the others run at a FIT below GOOD. "hammerstein" puts static curves before the inputs:
    it is for who asks for it, and where all others fail. best: only the one of them that runs best on parts
    of `records` that it was not fitted to; default where no methods are named, otherwise each is fitted. criterion: "prediction"
    as the methods do, "simulation" with every model refined by the error of its free runs, "best" where that runs better on parts
    of `records` (see `ByCriterion`). interval: an interval method that is fitted beside them. dt [s]: sample time to bring the
    records to. horizon: steps of the k-step prediction that is scored. accept: hand out models that the referee objects to.
    Raises InputError for records without inputs or outputs, and where no method can be fitted.

        >>> identify(data, held_out, methods=["ssm"])
        Free-run FIT on held-out records. SSM: n 92.0 %.
    """
    given = prepared(records, held_out, dt)
    chosen = methods is None if best is None else best
    by_name = methods if isinstance(methods, Mapping) else {name: _method(name) for name in methods or METHODS}
    named = {name: ByCriterion(method, criterion) for name, method in _possible(by_name, given.own, progress).items()}
    bounded: dict[str, IntervalModel] = {}
    if interval is not None:  # first, for it refuses most
        progress("interval: identifying")
        bounded = fit_outputs(interval, given.own)
    every = set(by_name) == set(METHODS)
    choice, models, remarks = _fitted(named, given.own, chosen, every, progress) if named else (None, {}, [])
    put_off = {LATE: ByCriterion(by_name[LATE], criterion)} if _put_off(by_name, given.own) else {}
    if put_off and choice and choice.fit[choice.method] < GOOD and sum(map(len, given.own)) <= FEW:
        choice = choose(put_off, given.own, beside=choice, progress=progress)
        models, put_off = {choice.method: choice.model}, {}
        remarks = _chosen_of(choice)
    results: list[ScoredModel] = []
    for name, model in models.items():
        own, said = scores_of(model, given.own, given.held_out, horizon)
        remarks += [*_remarks(name, model), *said]
        results.append(ScoredModel(model, f"{name}.json", own))
    for name, model in bounded.items():
        remarks += described_modes(model)
        held = cover(model, given.held_out, "held-out") if given.held_out else ()
        envelopes = cover(model, given.own, "estimation") + held
        results.append(ScoredModel(model, f"{name}.json", tuple(c.nominal for c in envelopes), envelopes))
    split = "held-out" if given.held_out else "estimation"
    if every and _worst_of_best(results, split) < GOOD:
        remarks += _others(bool(put_off), models, given.own, progress)
    results = refereed(results, given.own, given.shown)
    results, below = above_floor(results)
    return IdentificationResult(tuple(results), given, choice, (*remarks, *below), accept)


@record
class IdentificationResult(Answer):
    """Models with their scores; `model` is the one, where there is one, `models` are all by name.

    choice: which method was taken and the free-run FIT of each, where one was to be chosen.

        >>> found = identify(data, held_out, methods={"lti": LTI(order=1), "ssm": SSM(order=1)})
        >>> [f"{s.model} {s.FIT:.0f} %" for s in found.scores if (s.split, s.horizon) == ("held-out", "free-run")]
        ['LTI 83 %', 'SSM 92 %']
    """

    results: tuple[ScoredModel, ...]
    records: Records
    choice: Choice | None
    remarks: tuple[str, ...]
    accepted: bool = False

    @property
    def kept(self) -> tuple[ScoredModel, ...]:
        """The models that are handed out."""
        return tuple(result for result in self.results if self.accepted or not result.against)

    @property
    def models(self) -> dict[str, Model | IntervalModel]:
        """The models that are handed out, by name."""
        return {Path(result.file).stem: result.model for result in self.kept}

    @property
    def model(self) -> Any:
        """The model, where there is one.

        Raises NotHandedOutError where the referee objects, InputError where there are several.
        """
        kept = self.kept
        if len(kept) == 0:
            raise refused("the model", [sentence for result in self.results for sentence in result.against])
        if len(kept) > 1:
            raise InputError(f"several models: {', '.join(self.models)}", mend="take one: .models[NAME]")
        return kept[0].model

    @property
    def scores(self) -> tuple[Score, ...]:
        """Scores of all models on all records."""
        return tuple(s for result in self.results for s in result.scores)

    @property
    def sentences(self) -> list[str]:
        """Free-run FIT on held-out records, what the choice rests on, what speaks against a model."""
        chosen = [f"{_chosen(self.choice)}."] if self.choice else []
        return [headline(self.results), *chosen]

    def to_dict(self) -> dict[str, Any]:
        """The scores file, provenance apart; a model that is not handed out has no file."""
        content = scores_file(self._placed(None), {})
        del content["provenance"]
        return content

    def to_frame(self) -> Any:
        """Scores as a pandas table. Raises ImportError without pandas."""
        import pandas

        table = score_table(self.scores)
        return pandas.DataFrame(list(table.rows), columns=list(table.header))

    def report(self, source: Mapping[str, Any] | None = None) -> Report:
        """Scores, measured against simulated outputs, envelopes, residual tests."""
        title = f"identify: {', '.join(result.model.name for result in self.results)}"
        return comparison(title, self.results, tuple(self.records.shown), source or self.records.source({}))

    def save(self, folder: str | Path, *, source: Mapping[str, Any] | None = None) -> Path:
        """Write every model that is handed out, scores.json and report.html; returns the folder."""
        folder, source = Path(folder), dict(source or self.records.source({}))
        for result in self.results:
            if result in self.kept:
                result.model.save(folder / result.file)
            else:
                (folder / result.file).unlink(missing_ok=True)  # that of a former identification
        write_json(folder / SCORES_FILE, scores_file(self._placed(folder), source))
        write_report(self.report(source), folder)
        return folder

    def _placed(self, folder: Path | None) -> list[ScoredModel]:
        """The results with the paths of their files."""
        path = (lambda name: name) if folder is None else (lambda name: str(folder / name))
        return [replace(own, file=path(own.file) if own in self.kept else "") for own in self.results]

    __repr__ = Answer.said


def scores_of(
    model: Model, estimation: Dataset | None, held_out: Dataset | None, steps: int
) -> tuple[tuple[Score, ...], list[str]]:
    """Free run, one step and `steps` steps ahead; and a warning for each held-out record whose schedule leaves its span."""
    horizons: tuple[Horizon, ...] = ("free-run", "one-step", steps)
    warnings: list[str] = []
    scores = score(model, estimation, "estimation", horizons) if estimation else ()
    if held_out:
        scores += score(model, held_out, "held-out", horizons)
        warnings += [line for e in held_out for line in _beyond(model, e)]
    return scores, warnings


def _beyond(model: Model, e: Experiment) -> Iterator[str]:
    """A warning for each input of a record that leaves the nodes of its curve, and each schedule that leaves its span."""
    for curve in model.curves if isinstance(model, HammersteinWienerModel) else ():
        low, high = curve.u[0], curve.u[-1]
        if (beyond := _left(e[curve.input], low, high)) > MUCH:
            yield (
                f"warning: {model.name} on {e.name}: {curve.input} leaves what its curve was found on, {low:g} to {high:g},"
                f" by {100 * beyond:.0f} % of it; there the curve goes straight on"
            )
    for schedule, (low, high) in zip(model.schedules, model.spans, strict=True):
        if (beyond := _left(e[schedule.name], low, high)) > MUCH:
            how = f"follows its polynomials up to {100 * model.reach:.0f} %" if model.reach else "holds its edge value"
            yield (
                f"warning: {model.name} on {e.name}: {schedule.name} leaves the range the model knows, "
                f"{low:g} to {high:g} {schedule.unit}, by {100 * beyond:.0f} % of it; there the model {how}"
            )


def _left(values: np.ndarray, low: float, high: float) -> float:
    """How far values leave a range, in widths of it."""
    return float(max(low - values.min(), values.max() - high) / ((high - low) or 1.0))


def _method(name: str) -> Method:
    known = METHODS | CURVED
    return known[check_known("method", name, known)]()


def prepared(own: Dataset, held_out: Dataset | None, dt: float | None) -> Records:
    """Records with roles, thinned out where nothing in them moves fast. Raises InputError for what cannot be identified."""
    own, held_out = as_dataset(own), None if held_out is None else as_dataset(held_out)
    read = [*own.notes, *(held_out.notes if held_out else [])]
    own, thinner = thinned(own, dt)
    check_roles(own)
    if held_out:
        held_out = thinned(held_out, own.dt)[0] if thinner or dt else held_out
        check_held_out(own, held_out)
    return Records(own, held_out, (*read, *([f"{', '.join(own.names)}: {thinner}"] if thinner else [])))


def check_roles(records: Dataset) -> None:
    """Raises InputError where the records lack an input or an output, or have schedules that no method takes."""
    first = records.experiments[0]
    for found, role, option in (
        (first.names_of("input"), "input", "--inputs"),
        (first.names_of("output"), "output", "--output"),
    ):
        if not found:
            mend = f"give {option}, in Python read(.., {role}s=..)"
            raise InputError(f"no {role} channel among {', '.join(first.names)}", file=first.name, mend=mend)
    schedules_of(first)


def _possible(methods: Mapping[str, Method], records: Dataset, progress: Progress) -> dict[str, Method]:
    """Those methods that these records have the schedules for; of all methods not those that take minutes for what others do."""
    first = records.experiments[0]
    skipped = dict(_unfit(schedules_of(first)))
    if len(methods) == 1 and (name := next(iter(methods))) in skipped:
        mend = "give --schedule, in Python read(.., schedule=..), or take another method"
        raise InputError(f"{name} {skipped[name]}", file=first.name, mend=mend)
    if _put_off(methods, records):
        skipped[LATE] = f"takes minutes, and for one schedule it is tried where the others run at a FIT below {GOOD:g}"
    for name in methods:
        if name in skipped:
            progress(f"{name}: skipped, it {skipped[name]}")
    return {name: method for name, method in methods.items() if name not in skipped}


def _put_off(methods: Mapping[str, Method], records: Dataset) -> bool:
    """Whether the slowest method waits for what the others can do."""
    schedules = schedules_of(records.experiments[0])
    return set(methods) == set(METHODS) and len(schedules) == 1


def _unfit(schedules: Sequence[Channel]) -> Iterator[tuple[str, str]]:
    """Methods that cannot take these schedules, and why."""
    if not schedules:
        yield from ((name, "needs a scheduling channel") for name in ("ilm", "lpv-oe"))
    elif len(schedules) > 1:
        yield "ilm", f"takes one scheduling channel, these are {len(schedules)}"


def _fitted(
    methods: Mapping[str, Method], records: Dataset, chosen: bool, every: bool, progress: Progress
) -> tuple[Choice | None, dict[str, Model], list[str]]:
    """Every method fitted, or the one that runs best on what it was not fitted to; and which could not be, and why.

    every: where none of all methods runs better than the mean, curves of the inputs and lost signs of outputs are tried.
    """
    if chosen:
        try:
            choice = choose(methods, records, progress=progress)
        except InputError as reason:
            curved = _curved(records, progress) if every else None
            if curved is None:
                raise
            return None, {CURVES: curved}, [f"note: {reason.problem}; with static curves or signs they can be"]
        return choice, {choice.method: choice.model}, _chosen_of(choice)
    models: dict[str, Model] = {}
    reasons: dict[str, InputError] = {}
    for name, method in methods.items():
        progress(f"{name}: identifying")
        try:
            models[name] = method.fit(records)
        except InputError as reason:
            reasons[name] = reason
    if not models:
        raise next(iter(reasons.values()))
    said = [
        f"warning: no {name} model: {reason.problem}" + (f"; {reason.mend}" if reason.mend else "")
        for name, reason in reasons.items()
    ]
    return None, models, said


def _curved(records: Dataset, progress: Progress) -> HammersteinWienerModel | None:
    """A Hammerstein-Wiener model, where there is one that follows what it was not fitted to."""
    progress(f"{CURVES}: looked for, no other method follows these records")
    try:
        seen = HammersteinWiener().look(records)
        return HammersteinWiener().of(seen, records) if seen.FIT > FOLLOWS else None
    except InputError:
        return None


def _worst_of_best(results: Sequence[ScoredModel], split: str) -> float:
    """Free-run FIT of the worst output on the worst record, of the model that does best there; inf without any."""
    runs = [[s.FIT for s in own.scores if (s.split, s.horizon) == (split, "free-run")] for own in results]
    return max((min(own) for own in runs if own), default=np.inf)


def _others(late: bool, models: Mapping[str, Model], records: Dataset, progress: Progress) -> list[str]:
    """Which methods that were not tried may run better."""
    said = []
    if late:
        said.append(f"note: no free run has a FIT of {GOOD:g}: --model {LATE} fits free runs over the schedule, in minutes")
    if CURVES in models:
        return said
    total = sum(map(len, records))
    part = records if total <= FEW else _beginnings(records, FEW / total)
    progress(f"{CURVES}: looked for, no free run has a FIT of {GOOD:g}")
    try:
        seen = HammersteinWiener().look(part)
    except InputError:
        return said
    if (seen.nodes or seen.unsigned) and MUCH_BETTER * (100.0 - seen.plain) > 100.0 - seen.FIT:
        signs = f" and signs of {', '.join(seen.unsigned)}" if seen.unsigned else ""
        what = f"static curves of the inputs{signs}" if seen.nodes else signs.removeprefix(" and ")
        fits = f"a FIT of {seen.FIT:.1f}, without of {seen.plain:.1f}"
        these = "these records" if part is records else f"the first {sum(map(len, part))} of {total} samples"
        said.append(f"note: with {what} free runs on parts of {these} have {fits}: --model {CURVES}")
    return said


def _beginnings(records: Dataset, share: float) -> Dataset:
    """The first share of every record."""
    return Dataset(tuple(e.trim(stop=float(e.t[round(share * len(e))])) for e in records))


def _chosen_of(choice: Choice) -> list[str]:
    """What was chosen, and what could not be."""
    return [_chosen(choice), *(f"warning: no {name} model: {reason}" for name, reason in choice.failed.items())]


def _chosen(choice: Choice) -> str:
    found = ", ".join(f"{name} {fit:.1f}" for name, fit in choice.fit.items())
    fits = f"chosen: {choice.method}; free-run FIT on two fifths of the estimation records that it was not fitted to: {found}"
    ahead = [name for name, fit in choice.fit.items() if fit > choice.fit[choice.method]]
    unsure = (
        f"; {' and '.join(ahead)} may be ahead by chance: worse than a model that is not scheduled on a part" if ahead else ""
    )
    return fits + unsure


def _remarks(name: str, model: Model) -> list[str]:
    """What is to be known of a model."""
    seen = "outputs see the inputs of their own sample, which held commands cannot do (--no-feedthrough)"
    direct = np.any((model if isinstance(model, LPVModel) else model.core).D)
    return [*([f"note: {name}: {seen}"] if direct else []), *(f"note: {name}: {note}" for note in model.notes)]
