"""Set-point sequences for identification experiments. All have mean near 0 and are scaled by a peak amplitude.

Every random one is drawn from a seed; the pseudo-random binary sequence is fixed by its register alone.
"""

import numpy as np

from workbench.errors import InputError

# Feedback taps of primitive polynomials over GF(2): x^n + x^a + ... + 1, so that a register of n bits runs through all
# 2^n - 1 states. P. Alfke, Xilinx application note XAPP 052, 1996.
_TAPS = {
    3: (3, 2), 4: (4, 3), 5: (5, 3), 6: (6, 5), 7: (7, 6), 8: (8, 6, 5, 4), 9: (9, 5), 10: (10, 7), 11: (11, 9),
    12: (12, 6, 4, 1), 13: (13, 4, 3, 1), 14: (14, 5, 3, 1), 15: (15, 14), 16: (16, 15, 13, 4),
}  # fmt: skip


def prbs(samples: int, *, bits: int = 12, hold: int = 1, shift: int = 0) -> np.ndarray:
    """Maximum-length pseudo-random binary sequence of +-1, (samples,): period 2^bits - 1 steps of `hold` samples.

    `shift` starts that many steps later; two inputs driven by one sequence shifted by half a period are uncorrelated over a
    period up to 1/(2^bits - 1).
    """
    if bits not in _TAPS:
        raise InputError(f"no register of {bits} bits", mend=f"choose one of {', '.join(map(str, _TAPS))}")
    if hold < 1:
        raise InputError(f"hold {hold}", mend="a step lasts at least one sample")
    period = 2**bits - 1
    state, sequence = (1 << bits) - 1, np.empty(period)
    for k in range(period):
        sequence[k] = 1.0 if state & 1 else -1.0
        new = 0
        for tap in _TAPS[bits]:
            new ^= (state >> (bits - tap)) & 1
        state = (state >> 1) | (new << (bits - 1))
    return sequence[(np.arange(samples) // hold + shift) % period]


def random_binary(samples: int, seed: int, *, hold: int, probability: float) -> np.ndarray:
    """+-1, (samples,): every `hold` samples the sign changes with the given probability."""
    random = np.random.default_rng(seed)
    changes = random.random(-(-samples // hold)) < probability
    level = np.where(np.cumsum(changes) % 2 == 0, 1.0, -1.0) * random.choice([-1.0, 1.0])
    return np.repeat(level, hold)[:samples]


def multisine(samples: int, seed: int, dt: float, *, lines: int, low: float, high: float) -> np.ndarray:
    """Sum of `lines` sinusoids of equal amplitude, frequencies spaced logarithmically in [low, high] Hz; peak 1.

    Random phases; of 20 draws the one with the lowest crest factor. Frequencies sit on the grid of the record's length, so
    that the record holds whole periods.
    """
    random = np.random.default_rng(seed)
    grid = 1.0 / (samples * dt)
    if not grid <= low < high <= 0.5 / dt:
        raise InputError(f"{low:g} to {high:g} Hz does not fit a record of {samples} samples at {dt:g} s")
    cycles = np.unique(np.round(np.geomspace(low, high, lines) / grid))
    while len(cycles) < lines:  # low lines fall together on the grid: take the free ones beside them
        free = np.setdiff1d(np.arange(1, cycles[-1] + lines), cycles)
        cycles = np.sort(np.append(cycles, free[0]))
    angle = 2 * np.pi * np.outer(np.arange(samples) / samples, cycles)
    draws = [np.cos(angle + random.uniform(0, 2 * np.pi, len(cycles))).sum(axis=1) for _ in range(20)]
    best = min(draws, key=lambda x: np.abs(x).max() / x.std())
    return best / np.abs(best).max()


def filtered_gaussian(samples: int, seed: int, dt: float, *, cutoff: float) -> np.ndarray:
    """White Gaussian noise through a second-order Butterworth low-pass of `cutoff` Hz, (samples,); peak 1."""
    from scipy.signal import butter, lfilter

    b, a = butter(2, cutoff, fs=1.0 / dt, output="ba")  # pyright: ignore[reportGeneralTypeIssues, reportAssignmentType]
    settle = int(10 / (cutoff * dt))
    x = lfilter(b, a, np.random.default_rng(seed).standard_normal(samples + settle))[settle:]
    return x / np.abs(x).max()


def staircase(samples: int, levels: np.ndarray | list[float], *, rise: int = 1) -> np.ndarray:
    """Levels of equal length one after the other, (samples,), each reached by a straight line of `rise` samples.

    A level of 0 is a standstill where the quantity is a speed.
    """
    levels = np.asarray(levels, dtype=float)
    begins = np.arange(len(levels)) * samples / len(levels)
    times = np.column_stack([begins, begins + rise]).ravel()[1:]
    return np.interp(np.arange(samples), times, np.repeat(levels, 2)[:-1])


def ramp(samples: int, points: np.ndarray | list[float]) -> np.ndarray:
    """Straight lines through equally spaced points, (samples,)."""
    points = np.asarray(points, dtype=float)
    return np.interp(np.linspace(0, len(points) - 1, samples), np.arange(len(points)), points)
