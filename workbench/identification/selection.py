"""Which method? Each is fitted on parts of every estimation record and judged by its free run on the parts between them.

A model that is judged on the samples it was fitted to always asks for more parameters. A schedule such as a reel's radius moves
one way through a record, so holding back the last part would ask every model about a range it never saw: the blocks that are
held back lie between blocks that are not, and the winner is then fitted again to everything.
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


@record
class Choice:
    """The chosen method, its model of all estimation samples, and the mean free-run FIT [%] of every method tried."""

    method: str
    model: LPVModel
    fit: Mapping[str, float]
    failed: Mapping[str, str]


BLOCKS = 5  # consecutive parts of a record; the second and the fourth are held back


def choose(methods: Mapping[str, Method], dataset: Dataset, *, progress: Callable[[str], None] = lambda _: None) -> Choice:
    """The method whose model of the first, third and fifth part of each record runs free best on the second and fourth.

    A method that cannot be fitted is passed over with its reason. Raises InputError where none can, or where none runs better
    than the mean of what is held back: then the records cannot decide.
    """
    kept, held_back = parts(dataset)
    fit: dict[str, float] = {}
    failed: dict[str, str] = {}
    for name, method in methods.items():
        progress(f"{name}: judged on two fifths of each record that it was not fitted to")
        try:
            model = method.fit(kept)
            fit[name] = float(np.mean([s.FIT for s in score(model, held_back, "held-out", ["free-run"])]))
        except InputError as reason:
            failed[name] = reason.problem
    if not fit:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in failed.items())
        raise InputError(f"no method can be fitted to these records: {reasons}", mend="give longer records")
    best = max(fit, key=lambda name: fit[name])
    if fit[best] <= 0:
        raise InputError(
            f"no method simulates held-back parts better than their mean (best: {best}, FIT {fit[best]:.1f})",
            mend="name the method with --model, and doubt it: the records hold too little for a choice",
        )
    progress(f"{best}: identifying")
    return Choice(best, methods[best].fit(dataset), fit, failed)


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
