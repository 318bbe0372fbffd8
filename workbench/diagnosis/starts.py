"""Where a filter begins before it has looked at the records: states, where what nobody logged enters, and how hard it pushes."""

from collections.abc import Iterable

import numpy as np

from workbench.diagnosis.normal import inverse
from workbench.physics.plant import Plant

NEAR = 0.05  # of the size that a state goes through: with less of it, it rests near 0


def start_of(plant: Plant, y: np.ndarray, u: np.ndarray, k: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """States at sample k of outputs y (N, ny) and inputs u (N, nu), and how far off they may be.

    The plant's own start, corrected by what was measured then. A state that rests near 0 may be off by what moves an output as
    far as the record goes.
    """
    x, _ = plant.equilibrium()
    seen = np.flatnonzero(np.isfinite(y[k]))
    scale, natural = 0.3 * np.abs(x), _natural(plant, x, u[k], spread_of(y)[seen], spread_of(u), seen)
    scale = np.where(scale > NEAR * natural, scale, natural)
    noise = np.array([plant.noise.get(name, 0.0) for name in plant.output_names])
    for _ in range(3):
        C = plant.linearize(x, u[k])[2][seen]
        z = np.array(plant.output(x, plant.nominal, u[k]), dtype=float)[seen]
        R = np.diag((1e-3 * np.abs(C) @ scale) ** 2 + noise[seen] ** 2)
        P = np.diag(scale**2)
        e = y[k, seen] - z
        told = np.isfinite(C).all(axis=1) & np.isfinite(e)  # a root at 0 has no slope
        C, R, e = C[told], R[np.ix_(told, told)], e[told]
        x = x + P @ C.T @ inverse(C @ P @ C.T + R) @ e
    return x, scale


def spread_of(signals: np.ndarray) -> np.ndarray:
    """From the lowest to the highest value of each signal, (n) of (N, n); of one that stands still its size."""
    own = [c[np.isfinite(c)] for c in signals.T]
    return np.array([(np.ptp(c) or np.abs(c[0])) if len(c) else 0.0 for c in own])


def _natural(plant: Plant, x: np.ndarray, u: np.ndarray, outputs: np.ndarray, inputs: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """The change (nx) of each state that moves a measured output by its spread within the fastest time constant.

    Of a state that no output shows, a gap that is open, what the spreads of the inputs make of it within that time.
    """
    A, B, C = plant.linearize(x, u)[:3]
    within, C = _fastest(A), C[seen]
    shown = np.abs(np.array([C @ M for M in _powers(within * A)])).max(axis=0)
    with np.errstate(divide="ignore"):
        found = (np.maximum(outputs, 1e-300)[:, None] / shown).min(axis=0, initial=np.inf)
    moved = within * _first(np.abs(M @ B) @ inputs for M in _powers(within * A))
    return np.where(np.isfinite(found), found, np.where(moved > 0.0, moved, 1.0))


def _powers(A: np.ndarray) -> list[np.ndarray]:
    """I, A, .. A^(n - 1)."""
    return [np.linalg.matrix_power(A, k) for k in range(len(A))]


def _first(values: Iterable[np.ndarray]) -> np.ndarray:
    """Of each entry the first that is not 0."""
    found = 0.0
    for v in values:
        found = np.where(found > 0.0, found, v)
    return np.asarray(found)


def _fastest(A: np.ndarray) -> float:
    """The fastest time constant [s] of x' = A x; 1 s where all is integrals, or a root at 0 has no slope."""
    rate = float(np.abs(np.linalg.eigvals(A)).max()) if np.isfinite(A).all() else 0.0
    return 1.0 / rate if rate > 0.0 else 1.0


def entry_states(plant: Plant) -> tuple[tuple[str, ...], int]:
    """Where what nobody logged enters: inputs and states, those first that carry a coloured part, and how many these are.

    What nobody logged enters where inputs do: a valve that leaks, a fan that the mains disturb. Inputs that move several states
    at once, for the force on a cart that swings a pendulum is one, not two; states that turn or slide, and all others that an
    input moves directly; then, white only, the tensions of spans. What the plant itself states goes before all that. An equation
    that takes states from sample to sample has no rates, and nothing coloured.
    """
    turning = [port.speed for port in plant.ports if hasattr(port, "speed")]
    spans = [port.tension for port in plant.ports if hasattr(port, "tension")]
    moved = _slopes(plant)[1] != 0.0
    driven = [name for name, own in zip(plant.state_names, moved, strict=True) if own.any() and name not in spans]
    apart = np.array([name not in spans for name in plant.state_names])
    shared = [name for name, own in zip(plant.input_names, moved.T, strict=True) if own[apart].sum() > 1 and not plant.discrete]
    coloured = [] if plant.discrete else [*shared, *turning, *driven]
    named = dict.fromkeys(plant.process or [*shared, *turning, *driven, *spans])
    first = [name for name in named if name in coloured]
    return (*first, *(name for name in named if name not in first)), len(first)


def pushes_of(plant: Plant, inputs: np.ndarray) -> np.ndarray:
    """Rates of change (nx) that `inputs` give the states: directly, or through others within the fastest time constant."""
    A, B = _slopes(plant)
    return _first(np.abs(M @ B) @ inputs for M in _powers(_fastest(A) * A))


def _slopes(plant: Plant) -> tuple[np.ndarray, np.ndarray]:
    """A (nx, nx) and B (nx, nu) where the plant rests; 0 where a root has no slope there."""
    A, B = (np.nan_to_num(M, nan=0.0, posinf=0.0, neginf=0.0) for M in plant.linearize(*plant.equilibrium())[:2])
    return A, B
