"""What the referee has against identified models: leaks, runs that are no better than a record's mean, predictors that lose."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.answers.scored import ScoredModel
from workbench.data import Dataset
from workbench.hammerstein import HammersteinWienerModel
from workbench.identification.leaks import leaks, too_good
from workbench.identification.lti import held_by_a_loop
from workbench.lpv import LPVModel
from workbench.metrics import Score, score

FLOOR = "oe.json"  # the file of the model that every other one must beat
TIE = 0.5  # points of FIT
BEHIND = 2.0  # times the error of an unstable model one step ahead, from which on a stable one is no model of an unstable machine
WORSE = 1.2  # times the free run's error from which on a one-step prediction says that the predictor is wrong


def refereed(results: Sequence[ScoredModel], estimation: Dataset | None, judged: Dataset) -> list[ScoredModel]:
    """The models with what speaks against each; judged: the records that give the headline."""
    shared, loop = leaks(estimation or judged), held_by_a_loop(estimation or judged)
    found = []
    for result in results:
        own = [s for s in result.scores if s.record in judged.names]
        # what inputs explain only by a curve, or without its sign, would count as noise
        curved = isinstance(result.model, HammersteinWienerModel)
        good = () if curved else too_good(tuple(own), judged)
        against = (*shared, *good, *_useless(own), *_held(own, judged, loop))
        found.append(replace(result, against=against))
    return found


def _held(scores: Sequence[Score], judged: Dataset, loop: LPVModel | None) -> list[str]:
    """A sentence for an output of a machine that only its loop holds, whose next sample an unstable model tells far better.

    In such records the input tells the output by the inverse of the controller, and no free run shows that this is no machine.
    """
    said = []
    by_place = {} if loop is None else {(s.record, s.output): s.RMSE for s in score(loop, judged, "held-out", ["one-step"])}
    for output in dict.fromkeys(s.output for s in scores if by_place):
        pairs = [(s, by_place[s.record, output]) for s in scores if (s.horizon, s.output) == ("one-step", output)]
        if pairs and all(BEHIND * other < own.RMSE for own, other in pairs):
            own, other = max(pairs, key=lambda pair: pair[0].RMSE)
            unit = f" {own.unit}".rstrip()
            said.append(
                f"{own.model} tells the next {output} by {own.RMSE:.3g}{unit}, an unstable model by {other:.3g}{unit}: these"
                " records are of a loop around a machine that is unstable by itself, and this model is more of its controller"
            )
    return said


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


def above_floor(results: Sequence[ScoredModel]) -> tuple[list[ScoredModel], list[str]]:
    """The models, and a remark on each that runs worse than one or two poles with a dead time.

    Such a floor is left out itself, with a remark, where it is no use and other models are.
    """
    floor = next((result for result in results if result.file == FLOOR), None)
    others = [result for result in results if result is not floor]
    if floor is None or not others:
        return list(results), []
    if floor.against and not all(result.against for result in others):
        return others, [
            f"note: {floor.model.name}: one or two poles with a dead time cannot follow these records: {floor.against[0]}"
        ]
    return list(results), [
        f"warning: {result.model.name} runs worse than {floor.model.name}, one or two poles with a dead time"
        f" (free-run FIT {_free_fit(result):.1f} and {_free_fit(floor):.1f}): take that, or give more records"
        for result in others
        if not result.against and not result.envelopes and _free_fit(result) < _free_fit(floor) - TIE
    ]


def _free_fit(result: ScoredModel) -> float:
    """Mean free-run FIT on held-out records, of the estimation records where there are none; -inf without."""
    free = [s for s in result.scores if s.horizon == "free-run"]
    counted = [s.FIT for s in free if s.split == "held-out"] or [s.FIT for s in free]
    return float(np.mean(counted)) if counted else -np.inf
