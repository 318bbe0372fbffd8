"""Which method? Each is fitted on parts of every estimation record and judged by its free run on the parts between them.

A model that is judged on the samples it was fitted to always asks for more parameters. A schedule such as a reel's radius moves
one way through a record, so holding back the last part would ask every model about a range it never saw: the blocks that are
held back lie between blocks that are not, and the winner is then fitted again to everything.

Between two blocks that it was fitted to, a model that moves with such a schedule only interpolates, and there is no second pass
of the schedule to tell it from time. So a new record is one more such part: a model that does not move gives way only to one that
loses on none of them, or gains by more than they differ.
"""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np

from workbench.data import Dataset
from workbench.errors import InputError
from workbench.lpv import LPVModel
from workbench.metrics import score
from workbench.records import record


class Method(Protocol):
    """Options of an identification method."""

    def fit(self, dataset: Dataset) -> LPVModel: ...


BLOCKS = 5  # consecutive parts of a record; the second and the fourth are held back
SURE = 2.0  # standard errors over parts and outputs
LOSS = 0.05  # of the error on one part and output, which counts as none


@record
class Judged:
    """How a method ran on what it was not fitted to: free-run FIT [%] by part and output, and whether its model is scheduled."""

    FIT: tuple[float, ...]
    scheduled: bool

    @property
    def mean(self) -> float:
        return float(np.mean(self.FIT))

    def surely_better(self, other: "Judged") -> bool:
        """Whether its errors are smaller in the geometric mean, and none is larger by `LOSS` or the gain is beyond chance."""
        with np.errstate(divide="ignore", invalid="ignore"):
            gain = np.log(100.0 - np.array(other.FIT)) - np.log(100.0 - np.array(self.FIT))
            scatter = gain.std(ddof=1) / np.sqrt(len(gain))
        return bool(gain.mean() > 0.0 and (gain.min() > -LOSS or gain.mean() > SURE * scatter))


@record
class Choice:
    """The chosen method, its model of all estimation samples, and how every method that was tried ran, or why it could not."""

    method: str
    model: LPVModel
    judged: Mapping[str, Judged]
    failed: Mapping[str, str]

    @property
    def fit(self) -> dict[str, float]:
        """Mean free-run FIT [%] of every method on what it was not fitted to."""
        return {name: own.mean for name, own in self.judged.items()}


def choose(
    methods: Mapping[str, Method],
    dataset: Dataset,
    *,
    beside: Choice | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Choice:
    """The method whose model of the first, third and fifth part of each record runs free best on the second and fourth.

    A scheduled model takes the place of one that is not only where it is `surely_better`. beside: an earlier choice from the same
    records, whose methods are judged with these. A method that cannot be fitted is passed over with its reason. Raises InputError
    where none can, or where none runs better than the mean of what is held back: then the records cannot decide.
    """
    kept, held_back = parts(dataset)
    judged = dict(beside.judged) if beside else {}
    failed = dict(beside.failed) if beside else {}
    for name, method in methods.items():
        progress(f"{name}: judged on two fifths of each record that it was not fitted to")
        try:
            model = method.fit(kept)
            FIT = tuple(s.FIT for s in score(model, held_back, "held-out", ["free-run"]))
            judged[name] = Judged(FIT, bool(model.schedules))
        except InputError as reason:
            failed[name] = reason.problem
    if not judged:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in failed.items())
        raise InputError(f"no method can be fitted to these records: {reasons}", mend="give longer records")
    best = _best(judged)
    if judged[best].mean <= 0:
        raise InputError(
            f"no method simulates held-back parts better than their mean (best: {best}, FIT {judged[best].mean:.1f})",
            mend="name the method with --model, and doubt it: the records hold too little for a choice",
        )
    if beside and best == beside.method:
        return replace(beside, judged=judged, failed=failed)
    progress(f"{best}: identifying")
    return Choice(best, methods[best].fit(dataset), judged, failed)


def _best(judged: Mapping[str, Judged]) -> str:
    """The method of the highest mean FIT; the best unscheduled one where a scheduled one is not surely better than that."""
    by_fit = sorted(judged, key=lambda name: judged[name].mean, reverse=True)
    still = next((name for name in by_fit if not judged[name].scheduled), by_fit[0])
    return next(name for name in by_fit if name == still or judged[name].surely_better(judged[still]))


def parts(dataset: Dataset) -> tuple[Dataset, Dataset]:
    """The first, third and fifth part of every record, and the second and fourth."""
    kept, held_back = [], []
    for e in dataset:
        edges = np.linspace(0, len(e), BLOCKS + 1).astype(int)
        for i, (a, b) in enumerate(itertools.pairwise(edges)):
            start, stop = e.t[a], e.t[b - 1] + 0.5 * e.dt
            part = replace(e.trim(float(start), float(stop)), name=f"{e.name} part {i + 1}")
            (held_back if i % 2 else kept).append(part)
    return Dataset(tuple(kept)), Dataset(tuple(held_back))
