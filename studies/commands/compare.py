"""`workbench compare`: score saved models on records that they never saw, and test their residuals."""

from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

from studies.arguments import run_folder
from studies.commands.models import say_models
from studies.terminal import say
from workbench.answers.comparison import comparison
from workbench.answers.identify import SCORES_FILE, scores_of
from workbench.answers.objections import refereed
from workbench.answers.scored import ScoredModel, scores_file
from workbench.errors import InputError
from workbench.files import read_json, write_json
from workbench.hammerstein import load_either
from workbench.intervals.coverage import cover
from workbench.intervals.model import SCHEMA as INTERVAL
from workbench.intervals.model import IntervalModel, load_interval_model
from workbench.provenance import provenance
from workbench.report.page import write_report
from workbench.residuals import residual_test
from workbench.sources import read
from workbench.units import check_units, in_units


def run(options: Namespace) -> int:
    """Score saved models on records that they never saw and test what is left in their residuals."""
    if not options.holdout:
        raise InputError("on which records?", mend="give --holdout R.csv, records that no model was made from")
    models = _load_models(options.models)
    if len({model.name for model in models}) < len(models):  # two of one name are told apart by their files
        models = [replace(model, name=path) for path, model in zip(options.models, models, strict=True)]
    results: list[ScoredModel] = []
    shown: Any = None  # the records with the roles of the first model
    for path, model in zip(options.models, models, strict=True):
        outputs = (model.output,) if isinstance(model, IntervalModel) else model.outputs
        schedules = ((model.schedule,) if model.schedule else ()) if isinstance(model, IntervalModel) else model.schedules
        dataset = read(
            *options.holdout,
            inputs=[c.name for c in model.inputs],
            outputs=[c.name for c in outputs],
            schedule=[c.name for c in schedules],
        )
        known = {c.name: c.unit for c in (*model.inputs, *outputs, *schedules)}
        dataset = in_units(dataset, known)
        for note in () if shown else dataset.notes:
            say(f"note: {note}")
        shown = shown or dataset
        for experiment in dataset:
            check_units(experiment, known)
        if isinstance(model, IntervalModel):
            envelopes = cover(model, dataset, "held-out")
            results.append(ScoredModel(model, path, tuple(c.nominal for c in envelopes), envelopes))
            continue
        own, warnings = scores_of(model, None, dataset, options.horizon)
        results.append(ScoredModel(model, path, own))
        for warning in warnings:
            say(warning)
        for experiment in dataset:
            try:
                say(str(residual_test(model, experiment)))
            except InputError as reason:  # too short a record, or an unstable model: its scores say more
                say(f"note: no residual test: {reason}")
    results = refereed(results, None, shown)
    code = say_models(results, options.accept)
    folder = run_folder(options.out, "compare")
    kept = [result if options.accept or not result.against else replace(result, file="") for result in results]
    source = provenance({"models": options.models}, options.holdout)
    content = scores_file(kept, source)
    for file in filter(None, (folder / SCORES_FILE, options.json)):
        write_json(file, content)
    title = f"compare: {', '.join(model.name for model in models)}"
    say(f"report: {write_report(comparison(title, kept, tuple(shown), source), folder)}")
    return code


def _load_models(paths: list[str]) -> list:
    """The models of these files, of any kind; a scores file that lies beside them is passed over."""
    for path in paths:
        if paths.count(path) > 1:
            raise InputError("is named twice", file=path, mend="name each model once")
    paths[:] = [path for path in paths if Path(path).name != "scores.json" or len(paths) == 1]
    content = [read_json(path) for path in paths]
    kinds = [c.get("schema") if isinstance(c, dict) else "" for c in content]
    return [(load_interval_model if kind == INTERVAL else load_either)(path) for path, kind in zip(paths, kinds, strict=True)]
