"""A record against free runs of the plant: units, signs, places, and whether the plant explains it.

No missing physics turns a channel into another, upside down, or makes it 9.55 times as large while it follows the same course.

A reversed sign and a known unit are refused. A factor of no known unit is a note: an amplifier that saturates, a dead zone or
much friction make an input look too large. So is an input without which the plant follows a record as well as with any mend.
What is refused is wrong within windows, too.
"""

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from workbench.data import Channel, Experiment
from workbench.diagnosis.check.channels import driving_inputs
from workbench.diagnosis.check.free_runs import Compared, forced_runs, free_runs, holds_in_windows, mended_runs
from workbench.diagnosis.check.guesses import best_guesses, doubt_about, odd_note, unsure_note
from workbench.diagnosis.check.likeness import likeness
from workbench.diagnosis.check.note import Note
from workbench.diagnosis.check.slips import Guess, Slip, in_other_unit, of_other_size, other_units, reversed_sign, slip_error
from workbench.diagnosis.check.trials import input_trials
from workbench.diagnosis.check.unexplained import unexplained_notes
from workbench.diagnosis.runs import Runner
from workbench.errors import InputError
from workbench.physics.plant import Plant

APART, NEAR, CLOSER = 1.0, 0.8, 0.3  # distances of two outputs in the wrong places, in the right ones, and their ratio
TURNS = 4 * np.pi  # rad: an angle that moves on its own and goes further is in degrees


def comparison_notes(plant: Plant, e: Experiment) -> Iterator[Note]:
    _check_turns(plant, e)
    runner = Runner.of(plant, e)
    trials = list(input_trials(plant, e))
    (own, *others), whole = free_runs(plant, e, runner, [t.u for t in trials])
    if whole and len(own.y) < len(e):
        yield Note(e.name, "", f"a free run of {plant.name} leaves its range after {len(own.y) * e.dt:g} s")
    guesses = best_guesses(plant, own, [Guess((t.slip,), run.away) for t, run in zip(trials[1:], others, strict=True) if t.slip])
    if any(slip.sure for guess in guesses for slip in guess.slips):
        doubts = [doubt_about(plant, e, runner, own, guess) for guess in guesses]
        sure = [guess for guess, doubt in zip(guesses, doubts, strict=True) if not doubt]
        if sure:
            raise slip_error(e.name, guesses if len(sure) == len(guesses) else sure)
        yield unsure_note(e.name, guesses, doubts[0])
    elif guesses:
        yield odd_note(e.name, guesses)
    _check_limits(plant, e, own.channels)
    if not len(own.y):
        if not guesses:
            yield _lost(plant, e, runner)
        return
    _check_places(plant, e, own, runner)
    slips = [t.slip for t in trials if t.slip and t.slip.sure and (t.slip.exchanged or t.slip.factor == -1.0)]
    yield from unexplained_notes(plant, e, own, runner, slips)


def _lost(plant: Plant, e: Experiment, runner: Runner) -> Note:
    """A plant that its own limits stop at once, from every start, is not driven like this; one without limits may be unstable."""
    if plant.limits:
        raise InputError(
            f"driven by the logged inputs, {plant.name} leaves its range at once, wherever in the record it starts;"
            f" {runner.told_until(e.t)}",
            file=e.name,
            mend=f"is it a record of this machine, and are {' and '.join(driving_inputs(plant, e))} in their places and units?",
        )
    return Note(e.name, "", f"a free run of {plant.name} does not last: units and places of channels were not checked by it")


def _check_turns(plant: Plant, e: Experiment) -> None:
    """An angle that moves on its own need not move any output: only its size tells degrees from radians."""
    for channel in plant.inputs:
        turns = channel.unit == "rad" and channel.role == "schedule" and channel.name in e.names
        furthest = float(np.abs(e[channel.name]).max()) if turns else 0.0
        if furthest > TURNS:
            units = sorted(other_units("rad"), key=lambda other: -other[1])
            near = [other for other in units if furthest * other[1] <= TURNS]
            slip = in_other_unit((channel,), *near[0]) if near else of_other_size((channel,), TURNS / furthest)
            raise slip_error(e.name, [Guess((slip,), 0.0)])


def _check_limits(plant: Plant, e: Experiment, channels: tuple[Channel, ...]) -> None:
    """A measured state that is outside what the plant's equation is for at half of the samples or more."""
    for channel in channels:
        low, high = plant.read_limits.get(channel.name, (-np.inf, np.inf))
        middle = float(np.median(e[channel.name]))
        if low <= middle <= high:
            continue
        for other, factor in other_units(channel.unit):
            if low <= middle * factor <= high:
                raise slip_error(e.name, [Guess((in_other_unit((channel,), other, factor),), 0.0)])
        if low <= -middle <= high:
            raise slip_error(e.name, [Guess((reversed_sign((channel,)),), 0.0)])
        raise InputError(
            f"is {middle:.4g} {channel.unit} half of the time, {plant.name} stays within [{low:g}, {high:g}] {channel.unit}",
            file=e.name,
            channel=channel.name,
            mend="is it a record of this machine?",
        )


def _check_places(plant: Plant, e: Experiment, own: Compared, runner: Runner) -> None:
    """Two outputs that follow each other's simulation, over the whole record or within windows: a ramp runs away from both."""
    if len(own.channels) < 2:
        return
    d = np.array([[likeness(y, z).distance + _level(y, z) for z in own.z.T] for y in own.y.T])
    windows = forced_runs(plant, e, runner, runner.u)
    for i, j in combinations(range(len(d)), 2):
        names = own.channels[i].name, own.channels[j].name
        said = f"{' and '.join(names)} look exchanged: each follows the other's simulation"
        guess = Guess((Slip(names, said, f"swap {' and '.join(names)}", exchanged=True),), 0.0)
        crossed = _exchanged((d[i, i], d[j, j]), (d[i, j], d[j, i])) and holds_in_windows(plant, e, guess)
        far = sum(map(windows.distance, names)) > APART
        if crossed or (far and _exchanged(_distances(windows, names), _distances(mended_runs(plant, e, guess.slips), names))):
            raise InputError(said, file=own.file, mend=guess.slips[0].mend)


def _distances(runs: Compared, names: tuple[str, str]) -> tuple[float, float]:
    return runs.distance(names[0]), runs.distance(names[1])


def _exchanged(as_is: tuple[float, float], exchanged: tuple[float, float]) -> bool:
    """Distances of two outputs from their simulations as they are, far, and the other way round, both near."""
    return sum(as_is) > APART and max(exchanged) < NEAR and sum(exchanged) < CLOSER * sum(as_is)


def _level(y: np.ndarray, z: np.ndarray) -> float:
    """Distance of the means in spreads, 1 at most."""
    return min(abs(float(np.mean(y) - np.mean(z))) / float(np.std(y) + np.std(z)), 1.0)
