"""How much of a measured channel is measurement noise: an estimate from above."""

from collections.abc import Sequence

import numpy as np

from workbench.data import Dataset, segments

ORDER = 20  # of the autoregression: its one-step error is the noise and whatever disturbances add
BAND = 5  # neighbouring frequencies that are averaged before the smallest is taken
WINDOW = 64  # samples of a periodogram: white noise is in all of its frequencies, a machine's motion is not


def measurement_noise(dataset: Dataset, output: str, inputs: Sequence[str]) -> float:
    """Standard deviation of white noise on `output`, in its unit: the smaller of two estimates, each at its upper limit.

    One-step error of a long autoregression with inputs (noise and disturbances that nobody logged), and the floor of the
    spectrum (noise and what moves in the quietest band). Both hold more than the noise. Records too short for either give 0.
    """
    pieces = [piece for e in dataset for piece in segments(e, np.ones(len(e), dtype=bool), shortest=2)]
    estimates = [_autoregression(pieces, output, inputs), _floor(pieces, output)]
    return min((value for value in estimates if value is not None), default=0.0)


def _autoregression(pieces, output: str, inputs: Sequence[str]) -> float | None:
    rows, targets = [], []
    for e in pieces:
        if len(e) <= 2 * ORDER:
            continue
        columns = e[[output, *inputs]]
        past = [columns[ORDER - i : len(e) - i] for i in range(1, ORDER + 1)]
        rows.append(np.hstack([*past, columns[ORDER:, 1:], np.ones((len(e) - ORDER, 1))]))
        targets.append(columns[ORDER:, 0])
    if not rows:
        return None
    Psi, y = np.concatenate(rows), np.concatenate(targets)
    if len(y) <= 2 * Psi.shape[1]:
        return None
    size = np.linalg.norm(Psi, axis=0)
    Psi = Psi / np.where(size > 0, size, 1.0)
    error = y - Psi @ np.linalg.lstsq(Psi, y, rcond=None)[0]
    freedom = len(y) - Psi.shape[1]
    return float(np.sqrt(error @ error / freedom * (1.0 + 2.0 * np.sqrt(2.0 / freedom))))


def _floor(pieces, output: str) -> float | None:
    """sqrt of the smallest power density of a band, as if it were white, and two and a half standard deviations more."""
    from scipy.signal import welch

    densities = []
    for e in pieces:
        if len(e) >= 4 * WINDOW:
            _, density = welch(e[output], fs=1.0, nperseg=WINDOW, detrend="linear")
            densities.append((len(e), density[2 : 2 + BAND * ((len(density) - 3) // BAND)]))
    if not densities:
        return None
    total = sum(N for N, _ in densities)
    mean = np.sum([N * density for N, density in densities], axis=0) / total
    bands = mean.reshape(-1, BAND).mean(axis=1)
    # half-overlapping Hann windows: each band averages about 0.6 BAND independent values of 2 N / WINDOW windows
    spread = 1.0 / np.sqrt(0.6 * BAND * 2 * total / WINDOW)
    return float(np.sqrt(bands.min() * (1.0 + 2.5 * spread) / 2.0))  # one-sided: a variance of 1 has the density 2
