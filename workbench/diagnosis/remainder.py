"""What is left when everything named is in the model: a test without a catalogue.

    entry channel x explaining variable

A channel is the rate of change of a state, or a sensor; a variable is a state, an input or time, as bumps, or an angle, as cosine
and sine. A rate may also hold what goes with an input or with its own state, by a coefficient that changes with another
variable (a drive that pulls less with the arm out, a rail that binds at its ends): "u times arm".

Each pair is a score test like those of the catalogue, with the response of the predictor linearized along its trajectory and
the fitted unknowns projected out. A sensor may only be explained by what was known a sample earlier: the controller has computed
the input of the same sample from it.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.stats import gamma, gumbel_r

from workbench.diagnosis.kalman import response
from workbench.diagnosis.refit import Model
from workbench.diagnosis.scan import turned
from workbench.diagnosis.screen import DRAWS, _blocks, gamma_of
from workbench.records import field, record

BUMPS = 6


@record
class Left:
    """One pair: statistic, p-values, share of the squared errors, and what the channel lacks over the variable."""

    channel: str
    variable: str
    statistic: float
    p_value: float
    p_family: float
    share: float
    grid: np.ndarray = field("n")
    curve: np.ndarray = field("n")


def remainder(model: Model, seed: int = 0) -> list[Left]:
    """Every pair of channel and variable with its p-values, largest evidence first."""
    predictor, fit = model.predictor, model.fit
    trajectories = [trajectory(model, i) for i in range(len(predictor.records))]
    common = variables(trajectories)
    signs: np.ndarray | None = None
    logs, draws, found = [], [], []
    total = sum(float(np.sum(e**2)) for e in fit.errors)
    for channel in _channels(model):
        pairs = common | coefficients(model, channel, trajectories, common)
        b, S, blocks, widths = _scores(model, channel, [basis for _, basis in pairs.values()])
        at = 0
        for name, width in zip(pairs, widths, strict=True):
            part = slice(at, at + width)
            at += width
            inverse = _pinv(S[part, part])
            value = float(b[part] @ inverse @ b[part])
            if signs is None:
                signs = np.random.default_rng(seed).choice([-1.0, 1.0], (DRAWS, len(blocks)))
            null = np.einsum("ri,ij,rj->r", signs @ blocks[:, part], inverse, signs @ blocks[:, part])
            shape, scale = gamma_of(null)
            logs.append(-gamma.logsf(value, shape, scale=scale))
            draws.append(-gamma.logsf(null, shape, scale=scale))
            grid, curve = pairs[name][0], -inverse @ b[part]
            found.append((channel, name, value, grid, curve))
    largest = np.max(draws, axis=0)
    spread = max(float(largest.std()) * np.sqrt(6.0) / np.pi, 1.0)
    centre = float(largest.mean()) - 0.5772 * spread
    left = [
        Left(
            label(channel), name, value, float(np.exp(-log)), float(gumbel_r.sf(log, centre, spread)), value / total, grid, curve
        )
        for (channel, name, value, grid, curve), log in zip(found, logs, strict=True)
    ]
    return [left[j] for j in np.argsort(-np.array(logs))]


def label(channel: tuple[str, str]) -> str:
    """How a channel is called: "rate of w1" or "sensor of theta"."""
    kind, name = channel
    return f"{'rate' if kind == 'rate' else 'sensor'} of {name}"


def _channels(model: Model) -> list[tuple[str, str]]:
    predictor = model.predictor
    return [("rate", name) for name in predictor.entries if name in predictor.plant.state_names] + [
        ("sensor", name) for name, seen in zip(predictor.plant.output_names, predictor.measured, strict=True) if seen
    ]


def trajectory(model: Model, i: int) -> dict[str, np.ndarray]:
    """Corrected states, angles and inputs of record i by name, (N,)."""
    predictor, plant = model.predictor, model.predictor.plant
    full = predictor.corrected(i, model.fit.point)
    named = dict(zip(plant.state_names, full.T, strict=False))
    integrals = full[:, len(plant.states) :].T
    angles = {f"angle of {place}": turned(plant, place, own) for place, own in zip(plant.turning, integrals, strict=False)}
    inputs = dict(zip(plant.input_names, predictor.records[i].u.T, strict=True))
    return named | inputs | angles | {"time": plant.dt * np.arange(len(full))}


def variables(trajectories) -> dict[str, tuple[np.ndarray, list[np.ndarray]]]:
    """Name -> (grid or orders, basis (N, c) of each record)."""
    made: dict[str, tuple[np.ndarray, list[np.ndarray]]] = {}
    for name in trajectories[0]:
        values = [t[name] for t in trajectories]
        if name.startswith("angle of "):
            made[name] = (np.arange(2.0 * len(values)), _by_record([np.column_stack([np.cos(v), np.sin(v)]) for v in values]))
            continue
        joined = np.concatenate(values)
        low, high = np.quantile(joined, [0.01, 0.99])
        if not high - low > 1e-9 * max(abs(low), abs(high)):
            continue
        centres = np.linspace(low, high, BUMPS)
        width = (high - low) / (BUMPS - 1)
        made[name] = (centres, [np.exp(-0.5 * ((v[:, None] - centres) / width) ** 2) for v in values])
    return made


def coefficients(model: Model, channel: tuple[str, str], trajectories, common) -> dict[str, tuple[np.ndarray, list[np.ndarray]]]:
    """What an input or the channel's own state does by a coefficient that grows or bends with another variable."""
    kind, name = channel
    if kind != "rate":
        return {}
    made = {}
    for factor in (*model.predictor.plant.input_names, name):
        for other in common:
            if other in (factor, name) or other.startswith("angle of "):
                continue
            joined = np.concatenate([t[other] for t in trajectories])
            z = [(t[other] - joined.mean()) / joined.std() for t in trajectories]
            bases = [t[factor][:, None] * np.column_stack([v, v**2]) for t, v in zip(trajectories, z, strict=True)]
            made[f"{factor} times {other}"] = (np.arange(2.0), bases)
    return made


def _by_record(bases: list[np.ndarray]) -> list[np.ndarray]:
    """The same bases with columns of their own in every record: an angle starts anywhere."""
    wide = []
    for i, basis in enumerate(bases):
        columns = np.zeros((len(basis), basis.shape[1] * len(bases)))
        columns[:, i * basis.shape[1] : (i + 1) * basis.shape[1]] = basis
        wide.append(columns)
    return wide


def answers(model: Model, channel: tuple[str, str], bases: Sequence[np.ndarray]) -> list[np.ndarray]:
    """What the whitened errors of every record (N ny, c) do where the channel holds what `bases` (N, c) hold, by record."""
    predictor, (kind, name), made = model.predictor, channel, []
    for line, own, basis in zip(predictor.lines, predictor.passes, bases, strict=True):
        N, ny, n = line.H.shape
        push, shift = np.zeros((N, n, basis.shape[1])), np.zeros((N, ny, basis.shape[1]))
        if kind == "sensor":
            shift[1:, predictor.plant.output_names.index(name)] = -basis[:-1]  # strictly past
            shift[~line.present] = 0.0
        elif name in predictor.entries:
            push[:] = line.G[:, :, predictor.entries.index(name), None] * basis[:, None, :]
        else:
            push[:, predictor.plant.state_names.index(name)] = predictor.plant.dt * basis
        white = np.einsum("kij,kjc->kic", own.whitening, response(line, own.gain, push, shift))
        made.append(white.reshape(N * ny, -1))
    return made


def _scores(model: Model, channel: tuple[str, str], bases: Iterable[list[np.ndarray]]):
    """b (c), S (c, c), blocks (nb, c) of all bases of one channel, and the width of each. Angles have columns in each record."""
    predictor, fit = model.predictor, model.fit
    bases = list(bases)
    records = len(predictor.records)
    joined = [np.concatenate([basis[i] for basis in bases], axis=1) for i in range(records)]
    responses = answers(model, channel, joined)
    JG = fit.seen(responses)
    weights = fit.covariance @ JG
    b = -weights.T @ fit.gradient + sum(g.T @ e.ravel() for g, e in zip(responses, fit.errors, strict=True))
    S = sum(g.T @ g for g in responses) - JG.T @ weights
    blocks = []
    for i, (g, e) in enumerate(zip(responses, fit.errors, strict=True)):
        projected = g - fit.projected(i, weights)
        blocks.append(np.add.reduceat(projected * e.ravel()[:, None], _blocks(predictor, i), axis=0))
    lost = ~(np.isfinite(S).all(axis=0) & np.isfinite(b))  # what leaves the numbers explains nothing
    b[lost], S[lost], S[:, lost] = 0.0, 0.0, 0.0
    by_block = np.concatenate(blocks)
    by_block[:, lost] = 0.0
    return b, S, by_block, [basis[0].shape[1] for basis in bases]


def _pinv(S: np.ndarray) -> np.ndarray:
    """Inverse of a Gram matrix without its directions of no size: a basis that is constant in a record has some."""
    value, vector = np.linalg.eigh(S)
    keep = value > 1e-9 * max(value[-1], 1e-300)
    return (vector[:, keep] / value[keep]) @ vector[:, keep].T
