"""What `identify` and `compare` say of their models: what speaks against them, scores, envelopes."""

from collections.abc import Sequence
from typing import Any

from studies.cli import DONE
from studies.referee import handed_out
from studies.terminal import say
from workbench.answers.scored import ScoredModel
from workbench.metrics import horizon_name


def say_models(results: Sequence[ScoredModel], accept: bool) -> int:
    """Say what speaks against each model, then the scores of those that are handed out; 3 where none is."""
    code = handed_out(list(dict.fromkeys(sentence for result in results for sentence in result.against)), accept, say)
    kept = [result for result in results if accept or not result.against]
    if kept:
        _say_scores(kept)
        _say_envelopes(kept)
    return DONE if kept else code


def _say_scores(results: Sequence[ScoredModel]) -> None:
    """Held-out free runs first, the headline; of the estimation records the free run alone, the rest is in the files."""
    rank: dict[Any, int] = {"free-run": 0, "one-step": 1}
    scores = [(result.model, s) for result in results for s in result.scores]
    scores = [(model, s) for model, s in scores if s.split == "held-out" or s.horizon == "free-run"]
    scores.sort(key=lambda pair: (pair[1].split != "held-out", rank.get(pair[1].horizon, 2), pair[1].output))
    wide = max(16, *(len(s.record) for _, s in scores))
    say(f"{'model':8} {'order':>5}  {'record':{wide}} {'split':10} {'output':8} {'horizon':9} {'FIT':>7} {'RM':>7} {'RMSE':>10}")
    for model, s in scores:
        say(
            f"{s.model:8} {model.order:5d}  {s.record:{wide}} {s.split:10} {s.output:8} {horizon_name(s.horizon):9} "
            f"{s.FIT:7.1f} {s.RM:7.1f} {s.RMSE:10.4g} {s.unit}"
        )


def _say_envelopes(results: Sequence[ScoredModel]) -> None:
    """Coverage of held-out records first: an envelope is worth what it holds of records it never saw."""
    lines = sorted((c for result in results for c in result.envelopes), key=lambda c: c.split != "held-out")
    for line in lines:
        say(str(line))
