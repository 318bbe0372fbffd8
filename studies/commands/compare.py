"""`workbench compare`: score saved models on records that they never saw, and test their residuals."""

from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

from studies.arguments import run_folder
from studies.commands.models import refereed, scores_of, write
from studies.results import Result
from studies.terminal import say
from workbench.errors import InputError
from workbench.files import read_json
from workbench.readers import check_units
from workbench.sources import read


def run(options: Namespace) -> int:
    """Score saved models on records that they never saw and test what is left in their residuals."""
    from workbench.intervals.coverage import cover
    from workbench.intervals.model import IntervalModel
    from workbench.residuals import residual_test

    models = _load_models(options.models)
    if len({model.name for model in models}) < len(models):  # two of one name are told apart by their files
        models = [replace(model, name=path) for path, model in zip(options.models, models, strict=True)]
    results: list[Result] = []
    shown: Any = None  # the records with the roles of the first model
    for path, model in zip(options.models, models, strict=True):
        outputs = (model.output,) if isinstance(model, IntervalModel) else model.outputs
        dataset = read(
            *options.records,
            inputs=[c.name for c in model.inputs],
            outputs=[c.name for c in outputs],
            schedule=model.schedule.name if model.schedule else (),
        )
        shown = shown or dataset
        known = (*model.inputs, *outputs, *([model.schedule] if model.schedule else []))
        for experiment in dataset:
            check_units(experiment, {c.name: c.unit for c in known})
        if isinstance(model, IntervalModel):
            envelopes = cover(model, dataset, "held-out")
            results.append(Result(model, path, tuple(c.nominal for c in envelopes), envelopes))
            continue
        results.append(Result(model, path, scores_of(model, None, dataset, options.horizon)))
        for experiment in dataset:
            try:
                say(str(residual_test(model, experiment)))
            except InputError as reason:  # too short a record, or an unstable model: its scores say more
                say(f"note: no residual test: {reason}")
    code = refereed(options, results, None, shown)
    folder = run_folder(options.out, "compare")
    write(options, folder, results, {"models": options.models}, shown, options.records)
    return code


def _load_models(paths: list[str]) -> list:
    """The models of these files, LPV or interval; a scores file that lies beside them is passed over."""
    from workbench.intervals.model import SCHEMA, load_interval_model
    from workbench.lpv import load_model

    for path in paths:
        if paths.count(path) > 1:
            raise InputError("is named twice", file=path, mend="name each model once")
    paths[:] = [path for path in paths if Path(path).name != "scores.json" or len(paths) == 1]
    content = [read_json(path) for path in paths]
    interval = [isinstance(c, dict) and c.get("schema") == SCHEMA for c in content]
    return [
        load_interval_model(path) if is_interval else load_model(path) for path, is_interval in zip(paths, interval, strict=True)
    ]
