"""What the referee has against identified models: leaks, runs that are no better than a record's mean, predictors that lose."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.answers.scored import ScoredModel
from workbench.data import Dataset
from workbench.identification.leaks import leaks, too_good
from workbench.metrics import Score

WORSE = 1.2  # times the free run's error from which on a one-step prediction says that the predictor is wrong


def refereed(results: Sequence[ScoredModel], estimation: Dataset | None, judged: Dataset) -> list[ScoredModel]:
    """The models with what speaks against each; judged: the records that give the headline."""
    shared = leaks(estimation or judged)
    found = []
    for result in results:
        own = [s for s in result.scores if s.record in judged.names]
        found.append(replace(result, against=(*shared, *too_good(tuple(own), judged), *_useless(own))))
    return found


def _useless(scores: Sequence[Score]) -> list[str]:
    said = []
    for free in (s for s in scores if s.horizon == "free-run"):
        where = f"{free.model} on {free.record} ({free.split})"
        one = next((s for s in scores if (s.record, s.output, s.horizon) == (free.record, free.output, "one-step")), None)
        if not np.isfinite(free.FIT):
            said.append(f"{where} is unstable: its free run of {free.output} leaves the numbers")
        elif free.FIT < 0.0:
            unit = f" {free.unit}" * bool(free.unit)
            said.append(
                f"{where} is worse than the mean of the record: its free run misses {free.output} by {free.RMSE:.3g}{unit},"
                f" the mean by {free.RMSE / (1.0 - free.FIT / 100.0):.3g}"
            )
        elif one is not None and not one.RMSE <= WORSE * free.RMSE:
            said.append(
                f"{where} predicts {one.output} worse one step ahead ({one.RMSE:.3g}) than its free run does ({free.RMSE:.3g}):"
                " its predictor is wrong"
            )
    return said
