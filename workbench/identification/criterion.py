"""What a model is fitted for: the next sample, or its free run.

Most methods minimise one-step errors, which is quick and has one minimum. Where the sensors are noisy, or the model is simpler
than the machine, another model of the same form runs better by itself. It is found by the error of its free runs, begun at the
first one, and taken where it also runs better on parts of the records that the refinement did not see.
"""

from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np

from workbench.data import Dataset
from workbench.errors import check_known
from workbench.identification.hammerstein import HammersteinWiener
from workbench.identification.output_error.method import OutputError
from workbench.identification.output_error.refine import affordable, refinable, refined
from workbench.identification.output_error.state_space import LPVOutputError
from workbench.identification.selection import Method, parts
from workbench.lpv import LPVModel
from workbench.metrics import score
from workbench.records import record

Criterion = Literal["best", "prediction", "simulation"]
CRITERIA: tuple[str, ...] = get_args(Criterion)
BY_FREE_RUNS = (OutputError, LPVOutputError, HammersteinWiener)  # methods whose criterion is that already
BETTER = 0.5  # points of FIT on the parts: what a refinement must gain


@record
class ByCriterion:
    """A method, and whether its model is refined by the error of its free runs: never, always, or where that is "best".

    best: where the refined model of three fifths of every record runs better on the other two than the model does.

        >>> ByCriterion(SSM(order=1), "simulation").fit(data).notes[-1]
        'refined by the error of its free runs'
    """

    method: Any
    criterion: str = "best"

    def __post_init__(self):
        check_known("criterion", self.criterion, CRITERIA)

    def fit(self, dataset: Dataset) -> LPVModel:
        """The model of the method, refined or not; its notes say so."""
        own: Method = self.method
        model = own.fit(dataset)
        if isinstance(own, BY_FREE_RUNS):
            return model
        if self.criterion == "prediction" or (self.criterion == "best" and not _pays(model, dataset)):
            return model
        better = refined(model, dataset)
        if better is model:
            why = "no stable model with free runs was found"
            if model.scheduled_output is not None and not refinable(model):
                why = "its schedule is an output, and its basis, its output equation or its operating point does not let it"
            return model if self.criterion == "best" else _noted(model, f"not refined: {why}")
        return _noted(better, "refined by the error of its free runs")


def _pays(model: LPVModel, dataset: Dataset) -> bool:
    """Whether a refinement on parts of the records makes free runs better on those between them."""
    if not affordable(model, dataset):  # a refinement that takes longer must be asked for
        return False
    seen, unseen = parts(dataset)
    if min(map(len, unseen)) < 2 * model.warmup + 2:
        return False
    tried = refined(model, seen)
    return tried is not model and _mean_fit(tried, unseen) > _mean_fit(model, unseen) + BETTER


def _mean_fit(model: LPVModel, dataset: Dataset) -> float:
    runs = [s.FIT for s in score(replace(model, trained_on=()), dataset, "held-out", ["free-run"])]
    return float(np.mean(runs))


def _noted(model: LPVModel, note: str) -> LPVModel:
    return replace(model, notes=(*model.notes, note))
