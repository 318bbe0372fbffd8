"""Outputs that a sensor shows without their sign, y = |z|: is one of that kind, and which signs has it lost?

    z = sum_i g_i x_i(k),   y^2 = x' (g g') x

x are the responses of a real pole and of a pair of poles to the inputs. y^2 is linear in the matrix g g', which is found by least
squares whatever the signs are; its largest eigenvector begins an alternation of signs and gains. Poles and dead time: a grid.

E. J. Candes, T. Strohmer, V. Voroninski, "PhaseLift", Communications on Pure and Applied Mathematics 66 (2013): the lifting.
"""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.signal import lfilter

from workbench.data import Dataset
from workbench.metrics import rmse

FEWEST, ENOUGH = 100, 3000  # samples without which nothing is told, and that are looked at
INPUTS = 3  # at most: the lifted numbers grow with their square
ANGLES, MODULI, REAL = 14, (0.7, 0.85, 0.92, 0.96, 0.98), (0.0, 0.5, 0.8, 0.9, 0.95, 0.98)
DELAYS = (0, 1, 2, 3, 5)  # samples
FORGOTTEN = 0.1  # of each record: its start is not known
NEVER = 0.08  # of the largest reading: how far below 0 noise may take one
NEAR = 0.1  # of the largest reading: where the smallest ones must be
BOTH = 0.2  # of its largest value, that an input must have on either side
BETTER = 0.6  # of the error of linear models: what one with lost signs may leave
ROUNDS = 30


def may_lack_signs(dataset: Dataset, output: str) -> bool:
    """Whether an output is never negative though it comes near 0, while an input is both."""
    y = np.concatenate([e[output] for e in dataset])
    u = np.concatenate([e[e.names_of("input")] for e in dataset])
    largest = np.abs(u).max(axis=0, initial=0.0)
    both = np.any((u.max(axis=0) > BOTH * largest) & (u.min(axis=0) < -BOTH * largest))
    return bool(both and y.max() > 0.0 and -NEVER * y.max() <= y.min() <= NEAR * y.max())


def lost_signs(dataset: Dataset, output: str, *, sure: bool = False) -> list[np.ndarray] | None:
    """The signs (N,) of an output on each record; None where they are not missing, or cannot be told.

    They are missing where the size of a linear model's output leaves at most BETTER of the error of the best linear model. sure:
    it is known that they are.
    """
    y = [e[output] for e in dataset]
    u = [e[e.names_of("input")] for e in dataset]
    share = min(1.0, ENOUGH / sum(map(len, y)))
    short = [max(int(share * len(a)), 2) for a in y]
    counted = np.concatenate([np.arange(n) >= FORGOTTEN * n for n in short])
    if not (sure or may_lack_signs(dataset, output)) or u[0].shape[1] > INPUTS or np.count_nonzero(counted) < FEWEST:
        return None
    seen = [a[:n] for a, n in zip(u, short, strict=True)]
    target = np.concatenate([a[:n] for a, n in zip(y, short, strict=True)])[counted]
    if not target.max() > 0.0:
        return None  # nothing happens in what is looked at
    lines, found = np.inf, (np.inf, (0.0, 0.0 + 0.0j, 0), np.zeros(0))
    for poles in _grid():
        x = np.concatenate([_responses(a, *poles) for a in seen])[counted]
        linear = np.column_stack([x, np.ones(len(x))])
        lines = min(lines, rmse(target, linear @ np.linalg.lstsq(linear, target, rcond=None)[0]))
        missed, g = _sized(x, target)
        if missed < found[0]:
            found = (missed, poles, g)
    missed, poles, g = found
    if not (missed < np.inf if sure else missed <= BETTER * lines):
        return None
    return [np.where(_responses(a, *poles) @ g < 0.0, -1.0, 1.0) for a in u]


def _grid() -> Iterator[tuple[float, complex, int]]:
    """Real poles, pairs by one of them, dead times."""
    angles = np.geomspace(0.02, 2.0, ANGLES)
    for a, r, w, d in itertools.product(REAL, MODULI, angles, DELAYS):
        yield a, complex(r * np.exp(1j * w)), d


def _responses(u: np.ndarray, a: float, p: complex, d: int) -> np.ndarray:
    """States of the poles under each input u (N, nu), and a constant, (N, 3 nu + 1)."""
    late = np.zeros_like(u)
    late[d + 1 :] = u[: len(u) - d - 1]
    real = lfilter([1.0], [1.0, -a], late, axis=0)
    pair = lfilter([1.0], [1.0, -p], late.astype(complex), axis=0)
    return np.column_stack([real, np.real(pair), np.imag(pair), np.ones(len(u))])


def _sized(x: np.ndarray, y: np.ndarray) -> tuple[float, np.ndarray]:
    """Gains g (n,) with |x g| near y (N,), x (N, n), and the root mean square of what is left."""
    scale = np.maximum(np.sqrt(np.mean(x**2, axis=0)), np.finfo(float).tiny)
    x = x / scale
    n = x.shape[1]
    i, j = np.triu_indices(n)
    weight = 1.0 / np.maximum(y, NEAR * y.max())  # errors of y^2 count as those of y
    lifted = x[:, i] * x[:, j] * np.where(i == j, 1.0, 2.0) * weight[:, None]
    G = np.zeros((n, n))
    G[i, j] = G[j, i] = np.linalg.lstsq(lifted, y**2 * weight, rcond=None)[0]
    values, vectors = np.linalg.eigh(G)
    g, missed = vectors[:, -1] * np.sqrt(max(values[-1], 0.0)), np.inf
    for _ in range(ROUNDS):
        moved = np.linalg.lstsq(x, np.where(x @ g < 0.0, -y, y), rcond=None)[0]
        left = rmse(y, np.abs(x @ moved))
        if not left < missed:
            break
        g, missed = moved, left
    return missed, g / scale


def with_lost_signs(dataset: Dataset, outputs: Sequence[str] | None = None) -> tuple[tuple[str, ...], list[np.ndarray]]:
    """Which outputs lack their signs, and these on each record, (N, outputs); outputs: those that do, None where nobody knows."""
    asked = dataset.experiments[0].names_of("output") if outputs is None else tuple(outputs)
    known = {name: lost_signs(dataset, name, sure=outputs is not None) for name in asked}
    found = {name: signs for name, signs in known.items() if signs is not None}
    columns = [
        np.column_stack([signs[i] for signs in found.values()]) if found else np.ones((len(e), 0)) for i, e in enumerate(dataset)
    ]
    return tuple(found), columns
