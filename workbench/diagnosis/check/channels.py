"""Checks of single channels and of lengths: what is missing, stands still, sits at a stop or is too short."""

from collections.abc import Iterable, Iterator

import numpy as np

from workbench.data import Dataset, Experiment
from workbench.diagnosis.check.note import Note
from workbench.errors import InputError
from workbench.physics.plant import Plant
from workbench.units import UNITS

PER_UNKNOWN = 10  # samples for each state and each parameter that is open
MOVES = 2.0  # a channel whose spread around a line is less than so many standard deviations of its noise stands still
STUCK = 0.5  # share of samples at one end of its range that makes a channel useless


def check_channels(plant: Plant, e: Experiment) -> None:
    missing = [name for name in plant.needed if name not in e.names]
    seen = [name for name in plant.output_names if name in e.names]
    if missing or not seen:
        renamed = ", ".join(_with_unit(e, (*plant.needed, *plant.output_names)))
        asked = "is it a record of this machine? name its channels as the plant does"
        wanted = f"inputs {', '.join(plant.needed)} and some of {', '.join(plant.output_names)}"
        raise InputError(
            f"has {', '.join(e.names)}; {plant.name} needs the {wanted}",
            file=e.name,
            channel=", ".join(missing),
            mend=f"write {renamed} in the header" if renamed else asked,
        )


def _with_unit(e: Experiment, names: Iterable[str]) -> list[str]:
    """What to write instead of channels that are called as `names` are, with a unit behind: current_A for current [A]."""
    found = []
    for name in names:
        for c in e.channels:
            own, _, unit = c.name.rpartition("_")
            if name not in e.names and own.lower() == name.lower() and unit in UNITS:
                found.append(f"{name} [{unit}] for {c.name}")
    return found


def unlogged_channels(plant: Plant, e: Experiment) -> Iterator[Note]:
    """Outputs, and inputs that move on their own, that are not in the record: what goes with them cannot be seen."""
    unseen = [name for name in plant.output_names if name not in e.names]
    if unseen:
        yield Note(e.name, ", ".join(unseen), "not in the record: what shows there alone cannot be found")
    known = {*plant.input_names, *plant.output_names}
    for channel in plant.inputs:
        if channel.name in plant.commanded or channel.name in e.names:
            continue
        same = [c.name for c in e.channels if c.unit == channel.unit and c.name not in known and c.role != "reference"]
        mend = f"; if it is what the record calls {same[0]}, rename that" if same else ""
        yield Note(e.name, channel.name, f"is not in the record and taken as 0: no effect that goes with it can be found{mend}")


def check_length(plant: Plant, dataset: Dataset) -> tuple[Note, ...]:
    states, open_parameters = len(plant.states), sum(q.tolerance > 0.0 for q in plant.parameters)
    samples, needed = sum(len(e) for e in dataset), PER_UNKNOWN * (states * len(dataset) + open_parameters)
    if samples < needed:
        raise InputError(
            f"{samples} samples are too short for {states} start values of each record and {open_parameters} parameters",
            file=", ".join(dataset.names),
            mend=f"give at least {needed} samples ({needed * dataset.dt:g} s)",
        )
    return ()


def still_outputs(plant: Plant, e: Experiment) -> Iterator[Note]:
    """A note for every output that says nothing; an error where none is left."""
    faults: dict[str, str] = {}
    for name in plant.output_names:
        if name not in e.names:
            continue
        y = e[name]
        ends = np.mean(y == y.max()), np.mean(y == y.min())
        if np.ptp(y) == 0.0:
            faults[name] = f"is constant at {y[0]:g}"
        elif max(ends) >= STUCK:
            at = y.max() if ends[0] >= ends[1] else y.min()
            faults[name] = f"sits at its stop {at:g} for {100 * max(ends):.0f} % of the record"
    if len(faults) == sum(name in e.names for name in plant.output_names):
        said = "; ".join(f"{name} {fault}" for name, fault in faults.items())
        raise InputError(
            f"no output says anything: {said}", file=e.name, mend="was the logger connected, and the range wide enough?"
        )
    for name, fault in faults.items():
        yield Note(e.name, name, f"{fault}: nothing can be learned from it")


def driving_inputs(plant: Plant, e: Experiment) -> tuple[str, ...]:
    """Inputs that drive a plant in a record: the commanded ones; of a plant that nothing commands, those that are logged."""
    return plant.commanded or tuple(name for name in plant.input_names if name in e.names)


def check_excitation(plant: Plant, e: Experiment) -> tuple[Note, ...]:
    """Something must move beyond noise: an input, and not only along a line."""
    driving = driving_inputs(plant, e)
    moving = [name for name in driving if np.ptp(e[name]) > 0.0]
    still = not any(moves_beyond_noise(e[name]) for name in (*moving, *(n for n in plant.output_names if n in e.names)))
    if moving and not still:
        return ()
    fault = "no input moves" if not moving else "inputs and outputs move no more than their noise"
    raise InputError(
        f"{fault} ({', '.join(driving or plant.input_names)})",
        file=e.name,
        channel=(driving or plant.input_names)[0],
        mend="nothing can be diagnosed at rest: excite the machine, with steps of the set-points or a binary sequence",
    )


def moves_beyond_noise(y: np.ndarray) -> bool:
    """Whether a channel (N,) leaves a straight line by more than its white part."""
    t = np.linspace(-1.0, 1.0, len(y))
    spread = float(np.std(y - np.polyval(np.polyfit(t, y, 1), t)))
    return spread > MOVES * white_deviation(y) and spread > 1e-9 * float(np.abs(y).max())


def white_deviation(y: np.ndarray) -> float:
    """Standard deviation of the white part of a channel (N,), which second differences show."""
    return float(np.median(np.abs(np.diff(y, 2)))) / (0.6745 * np.sqrt(6.0))
