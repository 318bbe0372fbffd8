"""What `identify` and `compare` share: scores, the referee over models, the scores file and the page."""

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from studies.results import Result, scores_file
from studies.terminal import say
from workbench.data import Dataset
from workbench.files import write_json
from workbench.provenance import provenance

MUCH = 0.02  # of the width of a schedule range, by which a record may leave it unsaid


def refereed(options: Namespace, results: list[Result], estimation: Dataset | None, judged: Dataset) -> int:
    """Say what speaks against each model, then the scores of the others, and save these; 3 where none is left.

    The results of models that are not handed out keep their scores for the file, and have no file of their own.
    """
    from studies.objections import objections
    from studies.referee import handed_out

    found = objections(results, estimation, judged)
    against = list(dict.fromkeys(sentence for own in found for sentence in own))
    kept = [result for result, own in zip(results, found, strict=True) if options.accept or not own]
    code = handed_out(against, options.accept, say)
    for i, result in enumerate(results):
        results[i] = replace(result, against=found[i], file=result.file if result in kept else "")
        if options.command == "identify" and result in kept:
            result.model.save(result.file)
    if kept:
        _say_scores(kept)
        _say_envelopes(kept)
    return 0 if kept else code


def scores_of(model, estimation: Dataset | None, held_out: Dataset | None, steps: int):
    from workbench.metrics import score

    horizons = ("free-run", "one-step", steps)
    scores = ()
    if estimation is not None:
        scores += score(model, estimation, "estimation", horizons)
    if held_out is not None:
        scores += score(model, held_out, "held-out", horizons)
        for e in held_out:
            if model.schedule and (beyond := model.outside(e[model.schedule.name])) > MUCH:
                say(
                    f"warning: {model.name} on {e.name}: {model.schedule.name} leaves the range the model knows, "
                    f"{model.span[0]:g} to {model.span[1]:g} {model.schedule.unit}, by {100 * beyond:.0f} % of it; "
                    "there the model holds its edge value"
                )
    return scores


def _say_scores(results: Sequence[Result]) -> None:
    """Held-out free runs first, the headline; of the estimation records the free run alone, the rest is in the files."""
    say(f"{'model':8} {'order':>5}  {'record':16} {'split':10} {'output':8} {'horizon':9} {'FIT':>7} {'RM':>7} {'RMSE':>10}")
    from workbench.metrics import horizon_name

    rank: dict[Any, int] = {"free-run": 0, "one-step": 1}
    scores = [(result.model, s) for result in results for s in result.scores]
    scores = [(model, s) for model, s in scores if s.split == "held-out" or s.horizon == "free-run"]
    scores.sort(key=lambda pair: (pair[1].split != "held-out", rank.get(pair[1].horizon, 2), pair[1].output))
    for model, s in scores:
        say(
            f"{s.model:8} {model.order:5d}  {s.record:16} {s.split:10} {s.output:8} {horizon_name(s.horizon):9} "
            f"{s.FIT:7.1f} {s.RM:7.1f} {s.RMSE:10.4g} {s.unit}"
        )


def _say_envelopes(results: Sequence[Result]) -> None:
    """Coverage of held-out records first: an envelope is worth what it holds of records it never saw."""
    lines = sorted((c for result in results for c in result.envelopes), key=lambda c: c.split != "held-out")
    for line in lines:
        say(str(line))


def write(options: Namespace, folder: Path, results: Sequence[Result], configuration, shown: Dataset, files) -> None:
    """Scores as JSON and the comparison as a page, with the records of `shown` in its pictures."""
    from studies.comparison import comparison
    from workbench.report.page import write_report

    source = provenance(configuration, files)
    content = scores_file(results, source)
    write_json(folder / "scores.json", content)
    if options.json:
        write_json(options.json, content)
    title = f"{options.command}: {', '.join(result.model.name for result in results)}"
    page = write_report(comparison(title, results, tuple(shown), source), folder)
    say(f"report: {page}")
