"""From the data sheet over recalibration to the extension: what each step takes off the error of a simulation.

    data sheet:    nominal parameters, no effects        y - h(x(t; p0, 0))
    recalibrated:  parameters fitted without any effect  y - h(x(t; p^, 0))
    extended:      parameters and effects as found       y - h(x(t; p, eta))

Starts are estimated on each record. Recalibration alone bends parameters to make up for missing physics, and its error is what
the extension must beat.
"""

from workbench.data import Dataset
from workbench.diagnosis.answer import Diagnosis
from workbench.diagnosis.calibrate import Trajectory, calibrate, gains, trajectories
from workbench.physics.extension import extension
from workbench.physics.plant import Plant
from workbench.records import record


@record
class StageError:
    """Root mean square error of a channel's full run on a record at each stage; NaN where it left its range."""

    record: str
    channel: str
    unit: str
    data_sheet: float
    recalibrated: float
    extended: float


@record
class Stages:
    """A plant along records at each stage."""

    data_sheet: tuple[Trajectory, ...]
    recalibrated: tuple[Trajectory, ...]
    extended: tuple[Trajectory, ...]
    errors: tuple[StageError, ...]


def stages(plant: Plant, found: Diagnosis, own: Dataset, shown: Dataset) -> Stages:
    """`plant` along the records `shown`, with what a diagnosis of the records `own` found, and without."""
    sheet = trajectories(plant, shown)
    bare = recalibrated(plant, found, own)
    before = trajectories(bare, shown) if any(p.value != q.value for p, q in _pairs(bare, plant)) else sheet
    after = trajectories(extension(plant, "", found.parameters, found.effects).of(plant), shown) if found.effects else before
    errors = tuple(
        StageError(one.record, one.channel, one.unit, one.before, two.before, two.after)
        for one, two in zip(gains(plant, sheet, before), gains(plant, before, after), strict=True)
        if one.horizon == "full-run"
    )
    return Stages(sheet, before, after, errors)


def recalibrated(plant: Plant, found: Diagnosis, own: Dataset) -> Plant:
    """The plant with parameters fitted without effects; where none was found that is what the diagnosis itself has done."""
    if found.effects and any(q.tolerance > 0.0 for q in plant.parameters):
        return calibrate(plant, own).plant
    return plant if found.effects else extension(plant, "", found.parameters).of(plant)


def _pairs(one: Plant, other: Plant):
    return zip(one.parameters, other.parameters, strict=True)
