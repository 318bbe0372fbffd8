"""A model with what was found out about it, and the scores file that holds many of them."""

from collections.abc import Sequence
from typing import Any

from workbench.hammerstein import Model
from workbench.intervals.coverage import Coverage
from workbench.intervals.model import IntervalModel
from workbench.metrics import Score, to_json
from workbench.records import record


@record
class ScoredModel:
    """A model, its file, its scores, and for an interval model its envelopes; against: why it is not handed out, if it is not."""

    model: Model | IntervalModel
    file: str
    scores: tuple[Score, ...]
    envelopes: tuple[Coverage, ...] = ()
    against: tuple[str, ...] = ()


def scores_file(results: Sequence[ScoredModel], source: dict[str, Any]) -> dict[str, Any]:
    """The scores file; an interval model's entry holds its "envelopes" besides, and one that was objected to the "against"."""
    content = to_json([(result.model, result.file, result.scores) for result in results], source)
    for entry, result in zip(content["models"], results, strict=True):
        if result.envelopes:
            entry["envelopes"] = [c.to_dict() for c in result.envelopes]
        if result.against:
            entry["against"] = list(result.against)
    return content
