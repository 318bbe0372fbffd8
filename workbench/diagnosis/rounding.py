"""Rounded channels: told by their values alone, which lie on a lattice; no model is needed.

A channel counts as rounded where its step makes up a quarter of the noise variance that the filter gives it: q^2/12 > R^2/4.
"""

import numpy as np

from workbench.advice import quantum
from workbench.diagnosis.predictor import Predictor
from workbench.records import record

SHARE = 0.25  # of a channel's noise variance


@record
class Rounded:
    """A channel whose values lie on a lattice of step `step`; samples: how many of them there are."""

    channel: str
    unit: str
    step: float
    samples: int


def rounded(predictor: Predictor) -> list[Rounded]:
    """Every measured channel that is rounded to a step of practical size, in all of its records."""
    found = []
    for j, channel in enumerate(predictor.plant.outputs):
        own = [y for r in predictor.records if np.isfinite(y := r.y[:, j]).any()]
        steps = [_step(y[np.isfinite(y)]) for y in own]
        if steps and min(steps) > limit(predictor, j):
            found.append(
                Rounded(channel.name, channel.unit, float(np.median(steps)), int(sum(np.isfinite(y).sum() for y in own)))
            )
    return found


def limit(predictor: Predictor, j: int) -> float:
    """The smallest step of output j that counts."""
    return float(np.sqrt(12.0 * SHARE) * predictor.noise.measurement[j])


def _step(y: np.ndarray) -> float:
    """The step of a channel, also where it takes few values."""
    levels = np.unique(y)
    if 2 <= len(levels) < 8:
        steps = np.diff(levels)
        whole = steps / steps.min()
        return float(steps.min()) if np.all(np.abs(whole - np.round(whole)) < 0.05) else 0.0
    return quantum(y)
