"""Trials: the logged inputs as they would be without a slip, behind a dead zone, or behind another actuator; slips of outputs.

Every slip is a guess that is tried: an input that is mended gives another run, an output that is mended another record.
"""

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from workbench.data import Experiment
from workbench.diagnosis.check.channels import driving_inputs
from workbench.diagnosis.check.free_runs import Compared
from workbench.diagnosis.check.likeness import nearest
from workbench.diagnosis.check.slips import (
    APART,
    Slip,
    in_other_unit,
    left_out,
    of_other_size,
    off_by,
    other_units,
    reversed_sign,
    same_size,
)
from workbench.physics.plant import Plant
from workbench.records import field, record

EATEN = (0.5, 0.7, 0.8, 0.9, 0.95)  # quantiles of an input that a dead zone may be as wide as
LEFT = (0.1, 0.3)  # further quantiles that its limit may be at
GAINS = (0.5, 0.7, 1.4, 2.0)  # that an actuator may have
TENS = (0.001, 0.01, 0.1, 10.0, 100.0, 1000.0)  # factors of a size for which no unit is known
ALIKE = 0.9  # correlation above which two channels follow one course
UNLIKE = 0.3  # and below which one does not explain the other


@record
class Trial:
    """The logged inputs as they would be if a slip were mended."""

    slip: Slip | None
    u: np.ndarray = field("N nu")


def input_trials(plant: Plant, e: Experiment) -> Iterator[Trial]:
    u = _inputs(plant, e)
    yield Trial(None, u)
    for a, b in combinations([plant.input_names.index(name) for name in plant.commanded], 2):
        swapped = u.copy()
        swapped[:, [a, b]] = u[:, [b, a]]
        names = plant.input_names[a], plant.input_names[b]
        looks = "exchanged: the other way round the plant follows the record"
        yield Trial(Slip(names, looks, f"swap {' and '.join(names)}", exchanged=True), swapped)
    for slip in _input_slips(plant):
        scaled = u.copy()
        scaled[:, [plant.input_names.index(name) for name in slip.channels]] *= slip.factor
        yield Trial(slip, scaled)


def _inputs(plant: Plant, e: Experiment) -> np.ndarray:
    """The logged inputs (N, nu), 0 where there is none."""
    return np.column_stack([e[name] if name in e.names else np.zeros(len(e)) for name in plant.input_names])


def _input_slips(plant: Plant) -> Iterator[Slip]:
    """Each input alone, and all of a unit together, upside down, left out, in another unit, or of another size."""
    for unit in dict.fromkeys(c.unit for c in plant.inputs):
        own = [c for c in plant.inputs if c.unit == unit and c.name in plant.commanded]
        for channels in [[c] for c in own] + ([own] if len(own) > 1 else []):
            yield reversed_sign(channels)
            yield left_out(channels)
            units = list(other_units(unit))
            yield from (in_other_unit(channels, other, factor) for other, factor in units)
            yield from (of_other_size(channels, ten) for ten in TENS if not any(same_size(ten, factor) for _, factor in units))


def output_slips(own: Compared) -> Iterator[Slip]:
    """Of outputs that follow the run upside down, or at another size than missing physics gives them."""
    for channel, y, z in zip(own.channels, own.y.T, own.z.T, strict=True) if len(own.y) else ():
        like = nearest(y, z)
        if like.correlation < UNLIKE and nearest(-y, z).correlation > ALIKE:
            yield reversed_sign((channel,))
        if like.correlation < ALIKE:
            continue
        if abs(np.log(like.ratio)) > np.log(APART):
            yield off_by(channel, 1.0 / like.ratio)


def peaks_of_inputs(plant: Plant, e: Experiment) -> Iterator[Trial]:
    """What dead zones of several widths leave of the inputs."""
    u = _inputs(plant, e)
    own = [plant.input_names.index(name) for name in driving_inputs(plant, e)]
    for share in EATEN:
        width = np.quantile(np.abs(u[:, own]), share, axis=0)
        left = u.copy()
        left[:, own] -= np.clip(u[:, own], -width, width)
        yield Trial(None, left)


def acting_inputs(plant: Plant, e: Experiment) -> Iterator[np.ndarray]:
    """The inputs (N, nu) as they are, and what limits and dead zones of several widths, and other gains, leave of each."""
    u = _inputs(plant, e)
    yield u
    for i in (plant.input_names.index(name) for name in driving_inputs(plant, e)):
        widths = np.quantile(np.abs(u[:, i]), (*LEFT, *EATEN))
        limited = [np.clip(u[:, i], -width, width) for width in widths]
        for own in (*limited, *(u[:, i] - part for part in limited), *(gain * u[:, i] for gain in GAINS)):
            acting = u.copy()
            acting[:, i] = own
            yield acting
