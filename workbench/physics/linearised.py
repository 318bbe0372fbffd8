"""A linear model of a plant about its start: what a law is designed on where records give no model.

    dx' = A dx + B du(t - L),    dy = C dx,    T dz' = dy - dz      A, B, C: Jacobians of the plant's equation at its equilibrium

sampled exactly under held inputs. L: input delays; T: lags of sensors; both as effects of the plant have them, and C holds the
slopes of what bends or scales a reading. What has no slope of use at one point is left out: friction of what stands still, dead
zones, play and rounding.
"""

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from workbench.basis import CONSTANT
from workbench.errors import InputError
from workbench.lpv import LPVModel, OperatingPoint, constant_model
from workbench.physics.effects.shaft import Shaft
from workbench.physics.held import held
from workbench.physics.plant import Plant

STILL = 1e-9  # of the largest state: a speed at rest
RESONANT = "sensor-resonance"  # an effect with dynamics that this model does not have
STEEP = ("dead-zone", "saturation", "gear-backlash", "backlash", "quantisation")
READ = 1e-3  # of a reading, or of its unit near 0: differences on both sides, exact for the parabolas that readings are


def linearised(plant: Plant, dt: float | None = None) -> LPVModel:
    """The plant about its start as an LPV model without schedule, sampled every dt seconds (default: the plant's own).

    Its outputs are the plant's, but for those that have the role "other": they are logged, and nobody controls them. The model's
    noise is that of the plant's channels. Raises InputError for plants that are known at their samples alone, or
    whose inputs move on their own: there a model is identified.

        >>> linearised(MOTOR.sampled(0.02)).dt
        0.02
    """
    _check(plant)
    dt = plant.dt if dt is None else dt
    x, u = plant.equilibrium()
    still = STILL * max(1.0, np.abs(x).max())
    resting = {place for place, name in plant.turning.items() if abs(x[plant.state_names.index(name)]) <= still}
    rubbing = {slot.key for slot in plant.slots if slot.effect.family == Shaft.family and slot.place in resting}
    moving = replace(plant, effects={key: own for key, own in plant.effects.items() if key not in rubbing})
    A, B, C, _ = moving.linearize(x, u)
    time = lambda effect, names: [plant.effects.get(f"{effect}@{name}", {}).get("time", 0.0) for name in names]  # noqa: E731
    delays, lags = time("input-delay", plant.input_names), time("sensor-lag", plant.output_names)
    commands, y, slopes = _as_logged(plant, x, u)
    matrices = _sampled(*_lagged(A, B, slopes[:, None] * C, lags), dt, delays)
    own = [j for j, c in enumerate(plant.outputs) if c.role != "other"] or list(range(len(plant.outputs)))
    noise = np.diag([plant.noise.get(plant.outputs[j].name, 0.0) ** 2 for j in own])
    outputs = tuple(replace(plant.outputs[j], role="output") for j in own)
    at = OperatingPoint(CONSTANT, commands[None], y[None, own])
    (A, B, C, D), inputs = matrices, tuple(replace(c, role="input") for c in plant.inputs)
    return constant_model(plant.name, dt, (inputs, outputs), (A, B, C[own], D[own]), at, noise=noise)


def _check(plant: Plant) -> None:
    """Refuse plants that have no such model."""
    if plant.discrete:
        raise InputError("it is a model already", file=plant.name, mend="give its file as --model")
    if len(plant.commanded) < len(plant.inputs):
        name = next(c.name for c in plant.inputs if c.role == "schedule")
        mend = "identify a model over it: workbench identify --schedule"
        raise InputError("it moves on its own: one linear model does not do", file=plant.name, channel=name, mend=mend)
    if key := next((key for key in plant.effects if key.startswith(f"{RESONANT}@")), ""):
        mend = "identify a model from records: workbench identify"
        raise InputError(f"{key} is not in the linear model of a plant", file=plant.name, mend=mend)


def _as_logged(plant: Plant, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Commands (nu) that let u act, what the sensors read (ny) at x, and the slopes of these readings (ny)."""
    eta = np.where([slot.effect.id in STEEP for slot in plant.slots], 0.0, plant.effect_vector())

    def read(z: np.ndarray) -> np.ndarray:
        return np.array(plant.read(plant.settle(list(z), eta), np.zeros(len(z)), eta), dtype=float)

    z = np.array(plant.output(x), dtype=float)
    step = READ * np.maximum(np.abs(z), 1.0)
    offset = np.array(plant.drive(list(u), eta, 0.0), dtype=float) - u
    return u - offset, read(z), (read(z + step) - read(z - step)) / (2.0 * step)


def _lagged(A: np.ndarray, B: np.ndarray, C: np.ndarray, lags: list[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The system whose outputs are read through first-order lags [s], 0 for none."""
    slow, n = [j for j, T in enumerate(lags) if T > 0.0], len(A)
    A = np.array(block_diag(A, *([[-1.0 / lags[j]]] for j in slow)))
    B, read = np.vstack([B, np.zeros((len(slow), B.shape[1]))]), np.hstack([C, np.zeros((len(C), len(slow)))])
    for k, j in enumerate(slow, n):
        A[k, :n], read[j] = C[j] / lags[j], np.eye(len(A))[k]
    return A, B, read


def _sampled(A: np.ndarray, B: np.ndarray, C: np.ndarray, dt: float, delays: list[float]) -> tuple[np.ndarray, ...]:
    """The system under inputs that are held for dt and act L later: whole samples are states, a rest mixes two of them."""
    (F, G), n = held(A, B, dt), len(A)
    if not any(delays):
        return F, G, C, np.zeros((len(C), B.shape[1]))
    whole = [int(np.floor(L / dt * (1.0 + 1e-12))) for L in delays]
    memory = [w + 1 for w in whole]  # commands of before that still act
    starts = n + np.concatenate([[0], np.cumsum(memory)[:-1]])
    size = n + sum(memory)
    big, act = np.zeros((size, size)), np.zeros((size, B.shape[1]))
    big[:n, :n] = F
    for i, (L, w, m, s) in enumerate(zip(delays, whole, memory, starts, strict=True)):
        fresh = held(A, B[:, [i]], (w + 1) * dt - L)[1][:, 0]  # the older command acts first
        big[:n, s + w] += G[:, i] - fresh
        if w:
            big[:n, s + w - 1] += fresh
        else:
            act[:n, i] += fresh
        act[s, i] = 1.0
        for k in range(1, m):
            big[s + k, s + k - 1] = 1.0
    return big, act, np.hstack([C, np.zeros((len(C), size - n))]), np.zeros((len(C), B.shape[1]))
