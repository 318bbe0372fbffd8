"""How much of long records a search goes through: its time grows with the samples, and what they tell soon does not.

A search has the beginnings of records, not pieces of them: what has a date, a phase or a start keeps it. A beginning shows what
its record shows, see `beginnings`; that nothing more is missing is tried on what follows, see `tells_more`.
"""

from dataclasses import replace

import numpy as np

from workbench.data import Dataset, Experiment
from workbench.diagnosis.fit import gauss_newton
from workbench.diagnosis.policy import ALPHA
from workbench.diagnosis.predictor import predictor
from workbench.diagnosis.refit import Model
from workbench.diagnosis.remainder import remainder
from workbench.errors import InputError
from workbench.physics.plant import Plant

LONG = 50_000  # samples of all records above which beginnings are searched
SEARCHED = 20_000  # samples of all beginnings
LOOKED_AT = 200_000  # samples in which something more is looked for
SHORTEST = 500  # samples of a beginning: shorter records are whole
SHOWN = 0.8  # share of the range of each channel, and of its root mean square change, that a beginning shows


def beginnings(plant: Plant, dataset: Dataset, samples: int) -> Dataset:
    """The shortest beginnings that have so many samples together and show 80 % of what each channel of the plant does.

    What it does is its range, and how fast it moves: a log may begin at rest, and a sweep with its slow end. Records that have
    fewer than LONG samples together are taken whole.

        >>> beginnings(MOTOR, data, SEARCHED) is data
        True
    """
    total = sum(map(len, dataset))
    if total <= max(LONG, samples):
        return dataset
    try:
        part = Dataset(tuple(_beginning(e, plant, samples / total) for e in dataset))
    except InputError:  # two that begin alike, of a simulation without noise, are no two records
        return dataset
    return part if sum(map(len, part)) < total else dataset


def _beginning(e: Experiment, plant: Plant, share: float) -> Experiment:
    samples = np.arange(1, len(e) + 1)
    shows = samples >= min(max(share * len(e), SHORTEST), len(e))
    for y in (e[name] for name in (*plant.input_names, *plant.output_names) if name in e.names):
        width = np.maximum.accumulate(y) - np.minimum.accumulate(y)
        speed = np.cumsum(np.diff(y, prepend=y[:1]) ** 2) / samples
        shows &= (width >= SHOWN * width[-1]) & (speed >= SHOWN**2 * speed[-1])
    first = int(np.argmax(shows)) + 1
    return e if first >= SHOWN * len(e) else e.trim(stop=e.t[first])


def tells_more(model: Model, sizes: np.ndarray, dataset: Dataset) -> bool:
    """Whether something is left of the records in the light of a model that was found on their beginnings, or its run is lost.

    sizes (ne): small sizes of its effects.
    """
    lent = model.predictor
    made = predictor(lent.plant, dataset, threads=lent.threads)
    made = replace(made, substeps=lent.substeps, entries=lent.entries, expected=lent.expected)
    made = made.regained(model.fit.point, lent.noise)
    fit = gauss_newton(made, model.fit.unknowns, model.fit.z, sizes, rounds=3, enough=0.2)
    longer = Model(made, fit)
    return not longer.sound or any(x.p_family < ALPHA for x in remainder(longer))


def taken(what: str, part: Dataset, dataset: Dataset) -> list[str]:
    """A sentence that says how much of the records was taken; none where it was all."""
    shorter = [e for e, whole in zip(part, dataset, strict=True) if len(e) < len(whole)]
    if not shorter:
        return []
    spans = ", ".join(f"{e.name} to {e.t[-1]:.4g} s" for e in shorter)
    return [f"{what} {sum(map(len, part))} of {sum(map(len, dataset))} samples ({spans})"]
