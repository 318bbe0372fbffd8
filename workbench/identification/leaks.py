"""Too good to be true: an output that comes back in a channel which the model is given.

A schedule that is the output itself, late, filtered or scaled, hands a model the record that it is to explain. What tells it is
the sensor's noise: no cause of an output knows it.

    r = y - sum_j h(j) s(t + j), |j| <= LAGS        (least squares, s taken to be known to KNOWN of its spread)

A channel is a leak where r is smaller than half of the white noise of y: the noise of y is in s. An integrator of the output (a
reel's radius) is none: to tell y from it, differences must be taken, and KNOWN drowns them. Nor is a schedule that is named as an
output: free runs then follow the model's own. Without noise only a copy is told,
y = a s(t + j) + b to rounding. Of an input only a copy counts: feedback answers the output's noise, too, but has something of its
own besides wherever a set-point or a dither moves.
"""

import numpy as np

from workbench.advice import quantum
from workbench.data import Dataset, Experiment
from workbench.metrics import Score
from workbench.noise import measurement_noise

LAGS = 25  # samples by which a copy may be late or early
KNOWN = 0.01  # share of its spread to which a channel is taken to be known
BELOW = 0.5  # of the noise's standard deviation: what is smaller knows it
ROUNDING = 1e-7  # of its spread: what is smaller is the same number
MOST = 20_000  # samples of a record that are looked at


def leaks(dataset: Dataset) -> tuple[str, ...]:
    """A sentence for every input or schedule of the records that is an output; records of any roles."""
    first, found = dataset.experiments[0], []
    outputs = first.names_of("output")
    outside = [name for name in first.names_of("schedule") if name not in outputs]
    for output in outputs:
        noise = sensor_noise(dataset, output)
        for channel in (*outside, *first.names_of("input")):
            if sentence := _leak(dataset, output, channel, noise):
                found.append(sentence)
    return tuple(found)


def too_good(scores: tuple[Score, ...], dataset: Dataset) -> tuple[str, ...]:
    """A sentence for every free run that misses an output by less than its sensor's noise: no model knows that noise."""
    found = []
    for s in scores:
        if s.horizon == "free-run" and s.record in dataset.names:
            noise = sensor_noise(dataset, s.output)
            if BELOW * noise > s.RMSE:
                found.append(
                    f"{s.model} on {s.record}: the free run misses {s.output} by {s.RMSE:.3g} {s.unit}".rstrip()
                    + f", its sensor's noise is {noise:.3g}: something that the model is given holds the output"
                )
    return tuple(found)


def sensor_noise(dataset: Dataset, output: str) -> float:
    """Standard deviation of the white noise of an output, that of its rounding included; 0 where none is seen."""
    inputs = dataset.experiments[0].names_of("input")
    rounding = min(quantum(e[output]) for e in dataset) / np.sqrt(12.0)
    return max(measurement_noise(dataset, output, inputs), float(rounding))


def _leak(dataset: Dataset, output: str, channel: str, noise: float) -> str:
    first, role = dataset.experiments[0], dataset.experiments[0].channel(channel).role
    pieces = [(e[channel][:MOST], e[output][:MOST]) for e in dataset if len(e) > 8 * LAGS and _moves(e, channel, output)]
    if not pieces:
        return ""
    enough = max(BELOW * noise, ROUNDING * min(float(np.std(y)) for _, y in pieces))
    lag, scale, missed = _copy(pieces)
    unit = first.channel(output).unit
    what = f"{role} {channel} is output {output}"
    if missed < enough:
        late = f", {abs(lag)} samples {'early' if lag < 0 else 'late'}" if lag else ""
        said = f"{what} times {1.0 / scale:.4g}{late}: the rest is {missed:.3g} {unit}".rstrip()
        mine = (
            f"leave it out, or name {output} itself as schedule"
            if role == "schedule"
            else "a copy, or a loop that nothing else moves"
        )
        return f"{said}; every score would be of the output itself ({mine})"
    if role == "schedule" and (missed := _filtered(pieces)) < BELOW * noise:
        said = f"{what}, filtered: what it leaves of {output} is {missed:.3g}, and the sensor's noise {noise:.3g} {unit}".rstrip()
        return f"{said}; every score would be of the output itself"
    return ""


def _moves(e: Experiment, *names: str) -> bool:
    return all(np.ptp(e[name]) > 0.0 for name in names)


def _copy(pieces: list[tuple[np.ndarray, np.ndarray]]) -> tuple[int, float, float]:
    """Lag j, factor a and what y = a s(t + j) + b leaves, of the lag that leaves least."""
    best = (0, 1.0, np.inf)
    for lag in range(-LAGS, LAGS + 1):
        own = [(s[LAGS + lag : len(s) - LAGS + lag], y[LAGS : len(y) - LAGS]) for s, y in pieces]
        a, b = (np.concatenate([v - v.mean() for v in side]) for side in zip(*own, strict=True))
        size, other = float(np.abs(a).max()), float(np.abs(b).max())
        if not (size > 0.0 and other > 0.0):
            continue
        a, b = a / size, b / other  # what is huge has no square
        factor = float(a @ b) / float(a @ a)
        missed = other * float(np.sqrt(np.mean((b - factor * a) ** 2)))
        if missed < best[2] and factor:
            best = (lag, factor * other / size, missed)
    return best


def _filtered(pieces: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """What a filter of s of both sides leaves of y."""
    rows, targets = [], []
    for s, y in pieces:
        spread = float(np.std(s))
        columns = [(s[LAGS + j : len(s) - LAGS + j] - s.mean()) / spread for j in range(-LAGS, LAGS + 1)]
        rows.append(np.column_stack(columns))
        own = y[LAGS : len(y) - LAGS]
        targets.append(own - own.mean())
    Psi, y = np.concatenate(rows), np.concatenate(targets)
    ridge = KNOWN * np.sqrt(len(y)) * np.eye(Psi.shape[1])
    h = np.linalg.lstsq(np.vstack([Psi, ridge]), np.concatenate([y, np.zeros(Psi.shape[1])]), rcond=None)[0]
    return float(np.sqrt(np.mean((y - Psi @ h) ** 2)))
