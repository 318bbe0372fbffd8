"""A first guess of an output-error model: poles and dead times from a grid, all else by least squares.

    y(k) = y0 + sum_i sum_p b_pi x_pi(k - d_i) + sum_p c_p a_p^k,    x_pi(k+1) = a_p x_pi(k) + u_i(k)

For given poles a_p and delays d_i the free run is linear in b, c (a start for each record) and y0, so the error over the poles
has few minima and is looked at all over [1]. One pole, then two: real ones, or a pair.

[1] G. Golub, V. Pereyra, "Separable nonlinear least squares: the variable projection method and its applications", Inverse
Problems 19 (2003).
"""

import itertools
from collections.abc import Iterable, Sequence

import numpy as np
from scipy.optimize import minimize
from scipy.signal import lfilter

from workbench.records import record

TIMES = 14  # time constants of the grid, from a sample to a record
DAMPINGS = (0.1, 0.3, 0.7)
DELAYS = (0, 1, 2, 3, 5, 8, 12, 18, 27, 40)  # samples
LONGEST = 20  # of a record: the longest delay is one by this number
FAR = 1.5  # of the least squares that were found
POLISHED = 40  # poles that are tried near those of the grid
SHORTEST, LARGEST = -7.0, 7.0  # of these logarithms
HIGHEST = 3.0  # rad a sample, of a pair
ENOUGH = 6000  # samples that are looked at
KNOWN = 1e-9  # of the best known direction


@record
class Guess:
    """Poles (one, two, or one of a pair with a positive angle), delays by input, and the sum of squares that they leave."""

    poles: tuple[complex, ...]
    delays: tuple[int, ...]
    squares: float
    gains: np.ndarray  # (np, nu) of each pole's state from each input; complex for a pair
    offset: float = 0.0


class Output:
    """One output y and the inputs of all records, cut to ENOUGH samples; see the module."""

    def __init__(self, y: Sequence[np.ndarray], u: Sequence[np.ndarray], *, delays: bool):
        self.slowest = max(map(len, y))
        share = min(1.0, ENOUGH / sum(map(len, y)))
        self.y = [a[: max(int(share * len(a)), 2)] for a in y]
        self.u = [a[: max(int(share * len(a)), 2)] for a in u]
        self.delays = [d for d in DELAYS if d <= min(map(len, self.y)) // LONGEST] if delays else [0]
        self.target = np.concatenate(self.y)

    def guess(self, order: int, begin: Guess | None = None) -> Guess:
        """The best poles with the best delays; begin: a guess of fewer poles, whose delays are tried first."""
        best = self._over_poles(order, begin.delays if begin else (0,) * self.u[0].shape[1])
        for i, d in itertools.product(range(len(best.delays)), self.delays):  # one input after the other
            best = self._with_delay(best, i, d)
        if any(best.delays):  # a delay had looked like a pole
            best = min(best, self._over_poles(order, best.delays), key=_squares)
        for i in range(len(best.delays)):  # between the delays of the grid
            while best is not (better := self._with_delay(self._with_delay(best, i, best.delays[i] - 1), i, best.delays[i] + 1)):
                best = better
        return best

    def _over_poles(self, order: int, delays: tuple[int, ...]) -> Guess:
        """The best poles of the grid, and from there of all."""
        return self._polished(min((self.fitted(poles, delays) for poles in _grid(order, self.slowest)), key=_squares))

    def _with_delay(self, guess: Guess, i: int, d: int) -> Guess:
        """The guess, or the one with delay d of input i if that leaves less."""
        if d == guess.delays[i] or not 0 <= d <= max(self.delays):
            return guess
        tried = self.fitted(guess.poles, (*guess.delays[:i], d, *guess.delays[i + 1 :]))
        if tried.squares > FAR * guess.squares:  # other poles nearby do not make up for that
            return guess
        return min(guess, self._polished(tried), key=_squares)

    def _polished(self, guess: Guess) -> Guess:
        """The guess with the poles nearby that leave least, from its own; a real one stays real."""
        found = [guess]

        def left(x: np.ndarray) -> float:
            found.append(self.fitted(_poles(x, len(guess.poles), self.slowest), guess.delays))
            return found[-1].squares

        x = _numbers(guess.poles)
        simplex = np.vstack([x, x + 0.2 * np.eye(len(x))])
        minimize(left, x, method="Nelder-Mead", options={"initial_simplex": simplex, "maxfev": POLISHED, "xatol": 1e-4})
        return min(found, key=_squares)

    def fitted(self, poles: tuple[complex, ...], delays: tuple[int, ...]) -> Guess:
        """The gains for these poles and delays."""
        blocks = [_columns(u, poles, delays) for u in self.u]
        Z = np.concatenate([forced for forced, _ in blocks])
        free = np.zeros((len(Z), 1 + sum(own.shape[1] for _, own in blocks)))
        free[:, 0], row, column = 1.0, 0, 1
        for _, own in blocks:
            free[row : row + len(own), column : column + own.shape[1]] = own
            row, column = row + len(own), column + own.shape[1]
        X = np.hstack([Z, free])
        size = np.linalg.norm(X, axis=0)
        size = np.where(size > 0.0, size, 1.0)
        theta, _, _, _ = np.linalg.lstsq(X / size, self.target, rcond=KNOWN)
        e = self.target - X @ (theta := theta / size)
        b = theta[: Z.shape[1]].reshape(-1, self.u[0].shape[1])
        gains = b[0::2] + 1j * b[1::2] if poles[0].imag else b.astype(complex)
        return Guess(poles, delays, float(e @ e), gains, float(theta[Z.shape[1]]))


def _columns(u: np.ndarray, poles: Iterable[complex], delays: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """What inputs (N, nu) do through each pole (N, np nu, real and imaginary part of a pair), and what starts do (N, np)."""
    N, forced, free = len(u), [], []
    late = np.column_stack([np.concatenate([np.repeat(a[:1], min(d, N)), a[: N - d]]) for a, d in zip(u.T, delays, strict=True)])
    for a in poles:
        x = np.asarray(lfilter([0.0, 1.0], [1.0, -a], late, axis=0))
        decays = a ** np.arange(N)
        forced += [np.real(x), -np.imag(x)] if a.imag else [np.real(x)]
        free += [np.real(decays), np.imag(decays)] if a.imag else [np.real(decays)]
    return np.hstack(forced), np.column_stack(free)


def _grid(order: int, slowest: float) -> list[tuple[complex, ...]]:
    """Poles of time constants up to `slowest` samples."""
    times = np.geomspace(0.7, max(slowest, 2.0), TIMES)
    real = [complex(np.exp(-1.0 / T)) for T in times]
    if order == 1:
        return [(a,) for a in real]
    pairs = [
        (complex(np.exp((-zeta + 1j * np.sqrt(1.0 - zeta**2)) / T)),)
        for T, zeta in itertools.product(times, DAMPINGS)
        if np.sqrt(1.0 - zeta**2) / T < np.pi
    ]
    return [*itertools.combinations(real, 2), *pairs]


def _squares(guess: Guess) -> float:
    return guess.squares


def _numbers(poles: tuple[complex, ...]) -> np.ndarray:
    """log T of real poles exp(-1/T); of a pair the logarithms of T and of what its damping is to its frequency."""
    s = -np.log(poles[0])
    if poles[0].imag:
        return np.log([1.0 / abs(s), s.real / abs(s.imag)])
    return np.log([-1.0 / np.log(a.real) for a in poles])


def _poles(x: np.ndarray, count: int, slowest: float) -> tuple[complex, ...]:
    """The poles of numbers as `_numbers` gives them, of time constants below `slowest` samples."""
    x = np.clip(x, SHORTEST, [np.log(slowest), *[np.log(slowest) if count == len(x) else LARGEST] * (len(x) - 1)])
    if count == len(x):
        return tuple(complex(np.exp(-np.exp(-v))) for v in x)
    damping = np.exp(x[1])
    angle = min(np.exp(-x[0]) / np.hypot(1.0, damping), HIGHEST)
    return (complex(np.exp(angle * (-damping + 1j))),)
