"""How large must it be to show? A detection limit of the zoo's own, in which nothing of the diagnosis has a part.

A run without the effect is repeated under its own logged inputs, without noise: as it is, with every parameter moved, from moved
starts, and with the effect in several sizes. What the effect moves, d(s), is whitened with the autoregressive model of what the
repetition leaves of the record (noise, colour, unlogged pushes), and freed of all that parameters (their tolerance as prior) and
starts can mimic:

    D(s) = d'd - d'S (S'S + I)^-1 S'd

is twice the log-likelihood by which the best informed would know. The limit is where D = 25: five standard deviations. What
drifts or runs away under its own inputs is put back to its true states every so often, each time with a start that is not known.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.signal import lfilter

from tests.strangers.bench import Acting, Log, Machine, Numbers, Run, run

FIVE_SIGMA = 25.0
ORDERS = (0, 1, 2, 3, 4, 6, 8, 12)  # of the autoregressive model
MOVED = 0.02  # standard deviations of the prior by which a parameter is moved
START = 1e-3  # spreads of a state by which a start is moved
SIZES = 0.5 ** np.arange(11.0)  # of the largest


class Tried:
    """An effect or foreign physics at one size: what acts, and numbers that differ."""

    def __init__(self, acting: Acting | None = None, numbers: Numbers | None = None):
        self.acting, self.numbers = acting or {}, numbers or {}


def limits(
    machine: Machine,
    numbers: Numbers,
    log: Log,
    dt: float,
    tried: Mapping[str, Sequence[Tried]],
    seen: Sequence[int],
    rivals: Sequence[Tried] = (),
) -> dict[str, float]:
    """The share of its largest size from which each of `tried` shows, by name; inf where the largest does not.

    log: R runs without any effect, as lanes. tried: what is tried at each of SIZES. seen: the outputs that are logged. rivals:
    what any one of these can mimic, at whatever size, does not count either.
    """
    sigma = {q.name: q.tolerance / np.sqrt(3.0) for q in machine.plant.parameters if q.tolerance > 0.0}
    nx, runs = log.states.shape[1:]
    spread = log.states.std(axis=(0, 2)) + 1e-9 * np.abs(log.states).max(axis=(0, 2)) + 1e-12
    variants = [(Tried(), np.zeros(nx))]
    variants += [(Tried(), START * spread * unit) for unit in np.eye(nx)]
    variants += [(Tried(numbers={name: numbers[name] * (1.0 + MOVED * s)}), np.zeros(nx)) for name, s in sigma.items()]
    variants += [(one, np.zeros(nx)) for some in (*tried.values(), rivals) for one in some]
    window = round(machine.lab.window / dt) or len(log.states)
    y = _repeated(machine, numbers, log, dt, variants, window)[:, list(seen)]  # (N, ny, R, V)
    moved = _whitened(y[..., 1:] - y[..., :1], log.measured[:, list(seen)] - y[..., 0])
    G = 0.0
    for r in range(runs):
        for first in range(0, len(moved), window):
            block = moved[first : first + window, :, r].reshape(-1, moved.shape[-1])
            starts, rest = block[:, :nx], block[:, nx:]
            U, s, _ = np.linalg.svd(starts / (np.linalg.norm(starts, axis=0) + 1e-300), full_matrices=False)
            Q = U[:, s > 1e-6]
            rest = rest - Q @ (Q.T @ rest)
            G = G + rest.T @ rest
    n, m = len(sigma), len(tried) * len(SIZES)
    S = G[:n, :n] + MOVED**2 * np.eye(n)  # parameters have a prior
    G = G[n:, n:] - G[n:, :n] @ np.linalg.solve(S, G[:n, n:])  # what is left of effects and rivals beside them
    mimicked = G[:m, m:] ** 2 / np.maximum(np.diag(G)[m:], 1e-9)
    shown = np.diag(G)[:m] - np.nan_to_num(mimicked, posinf=0.0).max(axis=1, initial=0.0)
    return {name: _crossing(own) for name, own in zip(tried, np.maximum(shown, 1e-300).reshape(len(tried), -1), strict=True)}


def _crossing(shown: np.ndarray) -> float:
    """The share at which D, given at SIZES from the largest down, reaches FIVE_SIGMA."""
    shown = np.where(np.isfinite(shown), shown, 1e300)  # with so much of it the machine does not run
    if shown[0] < FIVE_SIGMA:
        return np.inf
    below = np.flatnonzero(shown < FIVE_SIGMA)
    if not len(below):  # far below the smallest that was tried: D goes with the square of the size
        return float(SIZES[-1] * np.sqrt(FIVE_SIGMA / shown[-1]))
    j = below[0]
    at = np.interp(np.log(FIVE_SIGMA), np.log([shown[j], shown[j - 1]]), np.log([SIZES[j], SIZES[j - 1]]))
    return float(np.exp(at))


def _repeated(
    machine: Machine, numbers: Numbers, log: Log, dt: float, variants: Sequence[tuple[Tried, np.ndarray]], window: int
) -> np.ndarray:
    """Outputs (N, ny, R, V) of every variant under the inputs of every run."""
    V, runs = len(variants), log.states.shape[2]
    shift = np.tile(np.column_stack([own for _, own in variants]), (1, runs))
    changed = sorted({name for one, _ in variants for name in one.numbers})
    own = dict(numbers) | {
        name: np.tile([one.numbers.get(name, numbers.get(name, 0.0)) for one, _ in variants], runs) for name in changed
    }
    acting: dict[str, dict[str, np.ndarray]] = {}
    for v, (one, _) in enumerate(variants):
        for key, values in one.acting.items():
            for name, value in values.items():
                # lanes in which it does not act have its shape, and size 0: that of a limit is none at all
                column = acting.setdefault(key, {}).setdefault(name, np.full(V, np.nan))
                column[v] = value
    acting = {key: {name: np.tile(_neutral(key, name, c), runs) for name, c in by.items()} for key, by in acting.items()}
    commands, truth = (np.repeat(signal, V, axis=2) for signal in (log.commands, log.states))
    what = Run(dt, len(truth), commands=commands, again=window, truth=truth, shift=shift)
    found = run(machine, own, acting, what.truth[0] + shift, what)
    return found.measured.reshape(*found.measured.shape[:2], runs, V)


#: Numbers of effects that are not sizes, and those that do nothing when they are infinite.
SHAPES = {"speed", "time", "phase", "order", "frequency", "damping"}
LATE = {"sensor-lag", "sensor-resonance", "input-delay"}  # their time is their size


def _neutral(key: str, name: str, column: np.ndarray) -> np.ndarray:
    """Numbers by variant (V), without an effect where none is given."""
    effect, given = key.partition("@")[0], column[np.isfinite(column)]
    shape = name in SHAPES and not (name == "time" and effect in LATE)
    nothing = np.inf if effect == "saturation" else given[0] if shape else 0.0
    return np.where(np.isfinite(column), column, nothing)


def _whitened(moved: np.ndarray, left: np.ndarray) -> np.ndarray:
    """`moved` (N, ny, R, V) through the filter that makes `left` (N, ny, R) white, each output by itself, in deviations."""
    found = np.empty_like(moved)
    for i in range(left.shape[1]):
        whitening, deviation = _model(left[:, i] - left[:, i].mean(axis=0))
        found[:, i] = lfilter(whitening, [1.0], moved[:, i], axis=0) / deviation
    return found


def _model(e: np.ndarray) -> tuple[np.ndarray, float]:
    """The filter 1, -a_1, .. that makes e (N, R) white, of the order that BIC prefers, and the deviation of what is left."""
    best = (np.inf, np.ones(1), 1.0)
    now = e[ORDERS[-1] :].T.ravel()
    for order in ORDERS:
        past = np.column_stack([e[ORDERS[-1] - j : len(e) - j].T.ravel() for j in range(1, order + 1)] or [0.0 * now])
        ridge = 1e-6 * float(np.sum(now**2)) + 1e-300
        a = np.linalg.solve(past.T @ past + ridge * np.eye(past.shape[1]), past.T @ now)
        deviation = float(np.std(now - past @ a)) + 1e-300
        bic = 2.0 * len(now) * np.log(deviation) + order * np.log(len(now))
        best = min(best, (bic, np.concatenate([[1.0], -a]), deviation), key=lambda one: one[0])
    return best[1], best[2]
