"""Records that are sampled much faster than their machine moves, brought to a sample time that suits it.

A machine that settles in seconds and is logged at 1 kHz has its poles at 1 - 1e-3: an identified model is lost in rounding and
noise there, and a diagnosis takes a hundred times as long for nothing. Every q-th sample is kept, behind a filter that nothing
folds back through (`Experiment.resample`); commands become their mean over q samples. In a closed loop there is no filter: it
would mix into a sample the noise of later ones, which the commands of the same time have answered already, and a fit takes that
for physics.

With a plant its own sample time is the measure. Without one it is the motion itself:

    f = the frequency below which all but a thousandth of an output's power lies, its noise floor taken off

of the output that moves fastest; 20 samples a period of f are kept.
"""

from dataclasses import replace

import numpy as np

from workbench.advice import in_a_loop
from workbench.data import SAME_DT, Dataset, Experiment, bad_stamps
from workbench.physics.plant import Plant
from workbench.physics.sample_time import SAME_TIMES, SIXTY

FASTER = 5.0  # a record is thinned out where it is sampled so many times faster than its plant
OVERSAMPLED = 200.0  # and without a plant where a period of its fastest motion has so many samples
KEPT = 20.0  # samples of such a period that are kept
REST = 1e-3  # share of the power that may lie above that frequency
FEWEST = 1000  # samples of every record that are left


def thinned(dataset: Dataset, dt: float | None = None, plant: Plant | None = None) -> tuple[Dataset, str]:
    """The records at sample time dt [s], or by default at one that suits the plant or the motion; and a sentence, if any changed.

    Raises InputError for a dt that is no whole number of samples, and for gaps in records that it is asked for.
    """
    q = round(dt / dataset.dt) if dt is not None else _by_plant(dataset, plant) if plant else _by_motion(dataset)
    if dt is None and (q < 2 or any(any(bad_stamps(e.t, e.dt)) for e in dataset)):
        return dataset, ""
    wanted = q * dataset.dt if dt is None or abs(q * dataset.dt - dt) <= SAME_DT * dt else dt
    if abs(wanted - dataset.dt) <= SAME_DT * dataset.dt:
        return dataset, ""
    named = [_named(e, plant) for e in dataset] if plant else list(dataset)
    closed = any(map(in_a_loop, named))
    thin = [e.resample(wanted * e.dt / dataset.dt, filtered=not closed) for e in named]
    done = Dataset(tuple(replace(own, channels=e.channels) for own, e in zip(thin, dataset, strict=True)))
    why = "as asked" if dt is not None else f"{plant.name} is sampled every {plant.dt:g} s" if plant else "nothing moves faster"
    return done, (
        f"sampled every {dataset.dt:g} s, used every {wanted:g} s ({why}): one sample in {q}"
        f"{', unfiltered for they are of a closed loop' if closed else ' behind an anti-aliasing filter'},"
        f" commands as their mean; --dt {dataset.dt:g} keeps all"
    )


def _named(e: Experiment, plant: Plant) -> Experiment:
    """The record with the roles that the channels of its plant have: which are commands, a file does not say."""
    inputs, outputs = ([c.name for c in own if c.name in e.names] for own in (plant.inputs, plant.outputs))
    return e.with_roles(inputs=[name for name in inputs if name in plant.commanded], outputs=outputs)


def _by_plant(dataset: Dataset, plant: Plant) -> int:
    ratio = plant.dt / dataset.dt
    if any(abs(ratio / factor - 1.0) <= SAME_TIMES for factor in SIXTY):
        return 1  # time in minutes or hours, more likely: `Plant.sampled` asks
    return int(ratio * (1.0 + SAME_DT)) if ratio >= FASTER and not plant.discrete else 1


def _by_motion(dataset: Dataset) -> int:
    """By how much all records can be thinned out, 1 where they are not sampled too fast."""
    fastest = max((_fastest(e[name]) for e in dataset for name in e.names_of("output")), default=0.0)
    if not 0.0 < fastest * OVERSAMPLED <= 1.0:
        return 1
    return max(min(int(1.0 / (KEPT * fastest)), min(len(e) for e in dataset) // FEWEST), 1)


def _fastest(y: np.ndarray) -> float:
    """Frequency, in periods a sample, below which all but REST of the power of y (N,) lies, its noise floor taken off."""
    t = np.linspace(-1.0, 1.0, len(y))
    scale = float(np.abs(y).max(initial=0.0))
    if len(y) < 2 * FEWEST or not scale > 0.0:
        return 0.0
    moves = y / scale - np.polyval(np.polyfit(t, y / scale, 1), t)
    power = np.abs(np.fft.rfft(moves * np.hanning(len(y)))) ** 2
    power = np.maximum(power - np.mean(power[len(power) // 2 :]), 0.0)[1:]
    smooth = np.convolve(power, np.ones(9) / 9.0, "same")
    above = np.cumsum(smooth[: len(smooth) // 2][::-1])[::-1]  # the floor was taken from the upper half
    if not above[0] > 0.0:
        return 0.0
    return float((1 + np.count_nonzero(above > REST * above[0])) / len(y))
