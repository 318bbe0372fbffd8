"""How tight modes along time can be: their number and mean radius for one precision after the other."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.data import Dataset
from workbench.errors import InputError
from workbench.intervals.model import IntervalModel
from workbench.intervals.regression import IntervalRegression, InTime
from workbench.records import field, record

TIGHTER, TOLERANCE = (0.95, 0.9, 0.85, 0.8, 0.75, 0.7, 0.6, 0.5), 1e-3


@record
class Step:
    """Modes along time for one precision; `reached` after raising it without more modes (None: not tried)."""

    precision: float = field("")
    modes: int
    mean_radius: float = field("")
    reached: float | None = None


def tightened(
    method: IntervalRegression, one: IntervalModel, dataset: Dataset, *,
    shares: Sequence[float] = TIGHTER, tolerance: float | None = TOLERANCE, merge: float | None = 0.1,
) -> tuple[tuple[Step, ...], IntervalModel]:  # fmt: skip
    """Modes along time for tighter and tighter precisions, up to the first that cannot be met; the last one raised further.

    one: the model of one box. shares: mean radii asked of the modes, in that of one box. tolerance: of the precision, to which
    the last one is raised; None: not at all.
    """
    radius = one.modes[0].mean_radius  # the steps count stretches of time; only the model taken has like ones merged
    steps, last, asked = [Step(one.precision, 1, radius)], one, one.precision
    for share in shares:
        precision = math.exp(-share * radius / one.unit_range)
        try:
            found = replace(method, partition=InTime(precision, merge=None)).fit(dataset)
        except InputError:  # no modes of this length are as narrow: the limit of this structure
            break
        steps.append(Step(precision, len(found.modes), _mean_radius(found)))
        last, asked = found, precision
    if last is one:
        return tuple(steps), replace(one, name=method.name)
    raised = replace(method, partition=InTime(asked, tolerance=tolerance, merge=merge)).fit(dataset)
    if tolerance is not None:
        steps[-1] = replace(steps[-1], reached=raised.precision)
    return tuple(steps), raised


def _mean_radius(model: IntervalModel) -> float:
    """Mean radius over the samples of all modes [unit of y]."""
    return float(np.average([m.mean_radius for m in model.modes], weights=[m.samples for m in model.modes]))
