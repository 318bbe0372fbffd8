"""Which method? Each is fitted on the first part of every estimation record and judged by its free run on the rest.

A model that is judged on the samples it was fitted to always asks for more parameters; the last third of each record is
held back for the choice, and the winner is then fitted again to everything.
"""

from collections.abc import Callable, Mapping
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


def choose(
    methods: Mapping[str, Method],
    dataset: Dataset,
    *,
    share: float = 2 / 3,
    progress: Callable[[str], None] = lambda _: None,
) -> Choice:
    """The method whose model of the first `share` of each record runs free best on the rest (mean FIT over outputs).

    A method that cannot be fitted is passed over with its reason. Raises InputError where none can.
    """
    halves = [e.split(e.t[0] + share * (e.t[-1] - e.t[0])) for e in dataset]
    first, rest = Dataset(tuple(a for a, _ in halves)), Dataset(tuple(b for _, b in halves))
    fit: dict[str, float] = {}
    failed: dict[str, str] = {}
    for name, method in methods.items():
        progress(f"{name}: judged on the last {100 * (1 - share):.0f} % of each record")
        try:
            model = method.fit(first)
            fit[name] = float(np.mean([s.FIT for s in score(model, rest, "held-out", ["free-run"])]))
        except InputError as reason:
            failed[name] = reason.problem
    if not fit:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in failed.items())
        raise InputError(f"no method can be fitted to these records: {reasons}")
    best = max(fit, key=lambda name: fit[name])
    progress(f"{best}: identifying")
    return Choice(best, methods[best].fit(dataset), fit, failed)
