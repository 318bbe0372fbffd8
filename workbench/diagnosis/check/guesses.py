"""The guesses that explain a record best, and the doubts about them.

The guess that brings record and run the closest is said. Where one input moves one output nothing tells which of them is wrong
but the noise: a reading in another unit brings its noise along.

A sign or a place is refused only where no actuator that is limited, has a dead zone or another gain explains the record nearly
as well; else it is a note.
"""

from collections.abc import Sequence

import numpy as np

from workbench.data import Experiment
from workbench.diagnosis.check.channels import white_deviation
from workbench.diagnosis.check.free_runs import TOLD, Compared, free_runs, holds_in_windows
from workbench.diagnosis.check.note import Note
from workbench.diagnosis.check.slips import NEAR, Guess, Slip, off_by, reversed_sign, slip_error
from workbench.diagnosis.check.trials import acting_inputs, output_slips
from workbench.diagnosis.runs import Runner
from workbench.physics.plant import Plant

BETTER = 0.5  # share of the distance that an input which is mended must take off, and of what an actuator leaves of it
FOLLOWED = 0.2  # distance up to which a plant follows a record as it is


def best_guesses(plant: Plant, own: Compared, tried: Sequence[Guess]) -> tuple[Guess, ...]:
    """The slips that explain the record best, of inputs, of outputs, or of either where nothing tells them apart."""
    slips = tuple(output_slips(own))
    outputs = Guess(slips, own.mended(slips).away) if slips else None
    close = [guess for guess in tried if guess.away < BETTER * min(own.away, 1.0)]
    inputs = min(close, key=lambda guess: guess.away, default=None)
    if inputs:  # what does as well without an input says nothing of its sign or unit
        inputs = next((guess for guess in close if guess.slips[0].factor == 0.0 and _equal(guess, inputs)), inputs)
    alone = len(plant.commanded) == 1 and len(own.channels) == 1
    if alone and outputs and not (inputs and _equal(inputs, outputs)):
        inputs = Guess((_counterpart(plant, slips[0]),), outputs.away)  # whatever moves the only output does it alone
    if not (inputs and outputs):
        return tuple(guess for guess in (inputs, outputs) if guess)
    if not _equal(inputs, outputs):
        return (min(inputs, outputs, key=lambda guess: guess.away),)
    match _noise_is_scaled(plant, own, slips[0]) if alone else None:
        case None:
            return (inputs, outputs)
        case True:
            return (outputs,)
        case False:
            return (inputs,)


def _equal(one: Guess, other: Guess) -> bool:
    return abs(one.away - other.away) <= TOLD


def _counterpart(plant: Plant, slip: Slip) -> Slip:
    """What would be wrong with the only input, if the only output were right."""
    channel = next(c for c in plant.inputs if c.name in plant.commanded)
    return reversed_sign((channel,)) if slip.factor == -1.0 else off_by(channel, 1.0 / slip.factor)


def _noise_is_scaled(plant: Plant, own: Compared, slip: Slip) -> bool | None:
    """Whether the noise of the only output is that of another unit, too; None where it is not known or near to neither."""
    level = plant.noise.get(own.channels[0].name, 0.0)
    white = white_deviation(own.y[:, 0])
    if slip.factor == -1.0 or not (level > 0.0 and white > 0.0):
        return None
    size = -float(np.log(slip.factor))
    at = float(np.log(white / level)) / size  # 0: as the plant states it, 1: as much larger as the channel is
    return at > 0.5 if min(abs(at), abs(at - 1.0)) < NEAR else None


def doubt_about(plant: Plant, e: Experiment, runner: Runner, own: Compared, guess: Guess) -> str:
    """Why a guess that explains the record better need not be right, the end of a sentence; empty where it is certain."""
    exchanged = any(slip.exchanged for slip in guess.slips)
    if exchanged and own.away <= FOLLOWED:
        return "it follows the record as it is, too: missing physics may favour the other way round"
    if not holds_in_windows(plant, e, guess):
        return "only over the whole record: within short windows it does not; a start or a parameter may do this, too"
    if exchanged or any(slip.factor < 0.0 for slip in guess.slips):  # the size of a unit is no actuator's
        rivals, _ = free_runs(plant, e, runner, [*acting_inputs(plant, e)])
        if guess.away >= BETTER * min(run.away for run in rivals):
            return "an actuator that saturates, has a dead zone or another gain explains it, too"
    return ""


def unsure_note(file: str, guesses: Sequence[Guess], doubt: str) -> Note:
    """What a free run of the whole record says, and why it need not be so."""
    said = slip_error(file, guesses)
    return Note(file, said.channel or "", f"{said.problem}, but {doubt}; or else {said.mend}")


def odd_note(file: str, guesses: Sequence[Guess]) -> Note:
    """What looks too large or too small by a factor of no known unit, as large missing physics makes it look, too."""
    said = slip_error(file, guesses)
    missing = "an amplifier that saturates or other missing physics as large"
    return Note(file, said.channel or "", f"{said.problem}: {missing}; or else {said.mend}")
