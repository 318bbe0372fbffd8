"""Records that the plant explains in no channel: whether they move with its inputs at all."""

from collections.abc import Iterator, Sequence

import numpy as np

from workbench.data import Experiment
from workbench.diagnosis.check.channels import driving_inputs, moves_beyond_noise
from workbench.diagnosis.check.free_runs import Compared, forced_runs, mended_runs, whole_runs
from workbench.diagnosis.check.guesses import BETTER
from workbench.diagnosis.check.likeness import likeness
from workbench.diagnosis.check.note import Note
from workbench.diagnosis.check.slips import Guess, Slip, reversed_sign, slip_error
from workbench.diagnosis.check.trials import ALIKE, UNLIKE, peaks_of_inputs
from workbench.diagnosis.runs import Runner
from workbench.errors import InputError
from workbench.physics.plant import Plant

PER_WEIGHT = 5  # samples for each weight of what inputs explain somehow
IDLE = 0.05  # spread of an output, by that of its simulation, below which nothing of the inputs gets through
RELATED = 0.05  # share of an output that its inputs explain somehow, above which it is theirs
PUSHED, PAST, STRIDES = 0.05, 4, (1, 4, 16)  # the same of its errors from its own past; samples of that, blocks of samples


def unexplained_notes(plant: Plant, e: Experiment, own: Compared, runner: Runner, slips: Sequence[Slip]) -> Iterator[Note]:
    """Refuse what the plant explains in no channel, unless nothing gets through to the outputs, or only peaks of inputs do.

    slips: of inputs, one of which may explain within windows what no run of the whole record does.
    """
    if own.follows >= UNLIKE or not own.counted:
        return
    names, inputs = ", ".join(own.channels[i].name for i in own.counted), " and ".join(driving_inputs(plant, e))
    if not any(moves_beyond_noise(own.y[:, i]) for i in own.counted):
        yield Note(own.file, names, f"moves no more than its noise: a dead zone or dry friction may take all of {inputs}")
        return
    if max(run.follows for run in whole_runs(plant, e, runner, [trial.u for trial in peaks_of_inputs(plant, e)])) >= ALIKE:
        yield Note(own.file, names, f"follows the peaks of {inputs} only: a dead zone or dry friction may take the rest")
        return
    windows = forced_runs(plant, e, runner, runner.u)
    within = windows.follows
    if within >= UNLIKE:
        said = f"{names} follows {plant.name} within short windows (correlation {within:.2f}), not over the whole record"
        yield Note(own.file, names, f"{said}: {runner.told_until(e.t)}")
        return
    for slip in slips:
        if mended_runs(plant, e, (slip,)).away < BETTER * min(windows.away, 1.0):
            alone = len(plant.commanded) == len(own.channels) == 1  # whatever moves the only output does it alone
            either = [slip, reversed_sign(own.channels)] if alone else [slip]
            raise slip_error(e.name, [Guess((one,), 0.0) for one in either])
    said = (
        f"{plant.name}, driven by the logged inputs, follows none of {names} (correlation at most {max(own.follows, within):.2f},"
        f" over the whole record and within short windows); {runner.told_until(e.t)}"
    )
    u = e[[name for name in driving_inputs(plant, e) if np.ptp(e[name]) > 0.0]]
    related = [_related(u, e[own.channels[i].name]) for i in own.counted]
    if None in related:  # what says nothing about the record says nothing against it
        yield Note(own.file, names, f"{said}; and the record is too short to tell whether it moves with {inputs} at all")
        return
    pushed = max(_pushes(u, e[own.channels[i].name]) for i in own.counted)
    if max(share for share in related if share is not None) > RELATED or pushed > PUSHED:
        yield Note(own.file, names, f"{said}; but it moves with {inputs}: another machine, or one of which the plant lacks much")
        return
    if len(own.y) and all(np.std(own.y[:, i]) < IDLE * np.std(own.z[:, i]) for i in own.counted):
        idle = (
            f"moves less than a {1 / IDLE:g}th of what {plant.name} says: is an actuator cut off, or at its limit all the time?"
        )
        yield Note(own.file, names, idle)
        return
    raise InputError(
        said,
        file=own.file,
        mend="is it a record of this machine, and are the channels in their places?",
    )


def _related(u: np.ndarray, y: np.ndarray) -> float | None:
    """Share of y (N,) that moving averages of inputs u (N, nu), and their products, explain of the half they are not fitted to.

    A sensor without a sign, or a thrust of u^2, is even in what drives it. None where a half holds too few samples to fit them.
    """
    total = np.vstack([np.zeros(u.shape[1]), np.cumsum((u - u.mean(axis=0)) / u.std(axis=0), axis=0)])
    k = np.arange(1, len(u) + 1)
    lengths = [2**i for i in range(12) if 2**i <= len(u) // 8]
    means = np.hstack([(total[k] - total[np.maximum(k - n, 0)]) / np.sqrt(n) for n in lengths])
    pairs = [means[:, i] * means[:, j] for i in range(means.shape[1]) for j in range(i, means.shape[1])]
    Psi = np.column_stack([np.ones(len(u)), means, *pairs])
    half, shares = len(u) // 2, []
    if half < PER_WEIGHT * Psi.shape[1]:
        return None
    for own, other in ((slice(half), slice(half, None)), (slice(half, None), slice(half))):
        spread = np.std(y[own]) or 1.0
        ridge = np.sqrt(len(Psi)) * 0.1 * np.eye(Psi.shape[1])
        aim = np.concatenate([(y[own] - y[own].mean()) / spread, np.zeros(Psi.shape[1])])
        predicted = spread * Psi[other] @ np.linalg.lstsq(np.vstack([Psi[own], ridge]), aim, rcond=None)[0]
        shares.append(np.sign(c := likeness(y[other], predicted).correlation) * c**2)
    return float(min(shares))


def _pushes(u: np.ndarray, y: np.ndarray) -> float:
    """Share of the errors of y (N,), predicted from its own past, that inputs u (N, nu) take off in the half not fitted to.

    What balances a pendulum, or fills a tank, moves its rate: averages of it say nothing of where that is.
    """
    shares = [0.0]
    for stride in STRIDES:
        n = len(y) // stride
        own, by = y[: n * stride].reshape(n, stride).mean(axis=1), u[: n * stride].reshape(n, stride, -1).mean(axis=1)
        past = np.column_stack([own[PAST - j : n - j] for j in range(1, PAST + 1)] + [np.ones(n - PAST)])
        both = np.hstack([past, *(by[PAST - j : n - j] for j in range(PAST + 1))])
        half = (n - PAST) // 2
        if half < PER_WEIGHT * both.shape[1]:
            break
        for fitted, other in ((slice(half), slice(half, None)), (slice(half, None), slice(half))):
            aim = own[PAST:]
            left = [
                float(np.sum((aim[other] - Psi[other] @ np.linalg.lstsq(Psi[fitted], aim[fitted], rcond=None)[0]) ** 2))
                for Psi in (past, both)
            ]
            shares.append(1.0 - left[1] / left[0] if left[0] > 0.0 else 0.0)
    return max(shares)
