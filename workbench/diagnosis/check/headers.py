"""Units that a header says: whether the plant follows a channel better as the header has it, or as its numbers stand."""

from dataclasses import replace

from workbench.data import Experiment
from workbench.diagnosis.check.free_runs import TOLD, forced_runs, free_runs
from workbench.diagnosis.runs import Runner
from workbench.errors import InputError
from workbench.physics.plant import Plant


def check_headers(plant: Plant, read: Experiment, converted: Experiment) -> None:
    """Refuse a channel that was converted by its header where the plant follows its numbers as they stand better, over the whole
    record and within windows: the header is wrong, or it is the machine. `read` and `converted`: before and after.
    """
    if converted is read:
        return
    as_is = _aways(plant, converted)
    for i, (before, after) in enumerate(zip(read.channels, converted.channels, strict=True)):
        if before.unit == after.unit or after.name not in (*plant.input_names, *plant.output_names):
            continue
        values = converted.values.copy()
        values[:, i] = read.values[:, i]
        other = _aways(plant, replace(converted, values=values))
        if all(theirs + TOLD < own for theirs, own in zip(other, as_is, strict=True)):
            problem = f"is {before.unit} by its header, but {plant.name} follows it better as it stands, in {after.unit}"
            mend = f"write {after.name} [{after.unit}] in the header if that is its unit; --anyway takes the header's"
            raise InputError(problem, file=read.name, channel=after.name, mend=mend)


def _aways(plant: Plant, e: Experiment) -> tuple[float, float]:
    """How far free runs of the plant are from a record: over the whole of it, and within windows."""
    runner = Runner.of(plant, e)
    (whole, *_), _ = free_runs(plant, e, runner, [runner.u])
    return whole.away, forced_runs(plant, e, runner, runner.u).away
