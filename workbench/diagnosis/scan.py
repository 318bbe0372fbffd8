"""Which order or frequency a periodic effect would have: a scan of the latent push behind the prediction errors.

    b(z) = sum_k phi_k lambda_k,   lambda_k = g_k' mu_{k+1},   mu_k = -H'W'e_k + (F (I - K H))' mu_{k+1}

One backward pass gives the push lambda that the errors ask for; its Fourier sums over an angle or over time are the scores of all
orders and frequencies at once. Their scale comes from the response at some of them. g is what the effect itself does in a sample,
of order 0: where masses are coupled a force on one moves them all.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numba import njit

from workbench.diagnosis.fit import Fit
from workbench.diagnosis.kalman import response
from workbench.diagnosis.predictor import Predictor
from workbench.physics.effects.shaft import Shaft
from workbench.physics.plant import Plant
from workbench.records import field, record

PROBES = 24
ONCE = 1.0  # wave that a record must go through for its order to be looked at
REPEATS = 1.5  # waves for it to be a ripple: what does not turn back twice is bent over the angle
PEAKS = 3  # what happens within a sample blurs the scan: the largest few are tried in earnest


@record
class Scan:
    """values (n): orders or frequencies that were looked at; sought (n): which may be it; tries: how many are independent."""

    tries: int
    values: np.ndarray = field("n")
    statistics: np.ndarray = field("n")
    sought: np.ndarray | None = None

    @property
    def peaks(self) -> list[float]:
        """The most likely ones of those sought, at most PEAKS, each larger than its neighbours, sought or not."""
        padded = np.concatenate([[-np.inf], self.statistics, [-np.inf]])
        local = (padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:])
        local &= True if self.sought is None else self.sought
        order = np.argsort(np.where(local, -self.statistics, np.inf))
        return [float(self.values[j]) for j in order[: min(PEAKS, int(local.sum()))]]


@njit("void(f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1], f8[::1])", cache=True, error_model="numpy")
def _backward(F, H, K, g, e, out):
    N, ny, n = H.shape
    mu, before, w = np.zeros(n), np.zeros(n), np.zeros(ny)
    for k in range(N - 1, -1, -1):
        total = 0.0
        for i in range(n):
            total += g[k, i] * mu[i]
        out[k] = total
        for j in range(n):  # F' mu
            total = 0.0
            for i in range(n):
                total += F[k, i, j] * mu[i]
            before[j] = total
        for a in range(ny):  # (K' F' mu + W' e)
            total = e[k, a]
            for i in range(n):
                total += K[k, i, a] * before[i]
            w[a] = total
        for j in range(n):
            total = before[j]
            for a in range(ny):
                total -= H[k, a, j] * w[a]
            mu[j] = total


def pushes(predictor: Predictor, fit: Fit, shape: int, sizes: np.ndarray) -> list[np.ndarray]:
    """g (N, n) by record: what a small periodic effect does in each sample to what the filter carries, where it does not swing.

    shape: the slot of its order or frequency. sizes (ne): a small size of each effect.
    """
    slots, found = predictor.plant.slots, []
    size = next(j for j, slot in enumerate(slots) if slot.key == slots[shape].key and not slot.parameter.shape)
    for i, eta in enumerate(fit.point.eta):
        still = eta.copy()
        still[shape], still[size] = 0.0, sizes[size]
        found.append(predictor.moved(i, eta, still))
    return found


def latent_push(predictor: Predictor, fit: Fit, g: np.ndarray, i: int) -> np.ndarray:
    """lambda (N,) in record i: the gradient of half the squared errors over a push g (N, n) at each sample."""
    line, gain = predictor.lines[i], predictor.passes[i].gain
    e = np.einsum("kij,ki->kj", predictor.passes[i].whitening, fit.errors[i])
    out = np.empty(len(e))
    F, H, gain, g, e = (np.ascontiguousarray(a) for a in (line.F, line.H, gain, g, e))
    _backward(F, H, gain, g, e, out)
    return out


def scan_orders(predictor: Predictor, fit: Fit, moves: Sequence[np.ndarray], place: str, orders: np.ndarray) -> Scan | None:
    """The order n of cos(n angle), sin(n angle) at a place that explains most, phases free in every record; moves: see `pushes`.

    Of the orders that some record repeats; None where it repeats none: an arm that swings by a part of a turn. Slower ones are
    looked at beside them, so that the flank of what is slower is no peak.
    """
    plant = predictor.plant
    column = len(plant.states) + list(plant.turning).index(place)
    angles = [turned(plant, place, predictor.corrected(i, fit.point)[:, column]) for i in range(len(predictor.records))]
    turns = max(np.ptp(a) for a in angles) / (2.0 * np.pi)
    orders = orders[orders * turns >= ONCE]
    sought = orders * turns >= REPEATS
    if not sought.any():
        return None
    waves = [_over_samples(a, orders) for a in angles]
    found = _scan(predictor, fit, moves, waves, orders, int(sought.sum()))
    return replace(found, sought=sought)


def turned(plant: Plant, place: str, integral: np.ndarray) -> np.ndarray:
    """The angle [rad] of what turns at a place, from the integral of its speed; of a slide, that of the wheel it rolls on."""
    shafts = [port for port in plant.ports if port.place == place and isinstance(port, Shaft)]
    return shafts[0].turned(integral) if shafts else integral


def _over_samples(angle: np.ndarray, orders: np.ndarray) -> np.ndarray:
    """Mean of exp(i n angle) over each sample (N, n): what turns by several radians between two samples averages out."""
    turn = np.diff(angle, append=2 * angle[-1] - angle[-2])
    return np.exp(1j * np.outer(angle + 0.5 * turn, orders)) * np.sinc(np.outer(turn, orders) / (2 * np.pi))


def scan_frequencies(predictor: Predictor, fit: Fit, moves: Sequence[np.ndarray]) -> Scan:
    """The frequency f [Hz] of cos(2 pi f t), sin(2 pi f t) that explains most; those of which a record holds four turns.

    moves: see `pushes`.
    """
    dt = predictor.plant.dt
    N = max(len(r) for r in predictor.records)
    size = 1 << int(np.ceil(np.log2(4 * N)))  # four times finer than the records resolve
    values = np.fft.rfftfreq(size, dt)
    keep = (values * N * dt > 4.0) & (values < 0.45 / dt)
    total = np.zeros(len(values))
    probes = np.geomspace(values[keep][0], values[keep][-1], PROBES)
    for i, (r, g) in enumerate(zip(predictor.records, moves, strict=True)):
        spectrum = np.abs(np.fft.rfft(latent_push(predictor, fit, g, i), size)) ** 2
        time = dt * np.arange(len(r))
        scale = _information(predictor, g, i, np.exp(2j * np.pi * np.outer(time, probes)))
        total += spectrum / np.exp(np.interp(np.log(np.maximum(values, 1e-9)), np.log(probes), np.log(scale)))
    return Scan(max(1, int(keep.sum()) // 4), values[keep], total[keep])


def _scan(predictor: Predictor, fit: Fit, moves: Sequence[np.ndarray], waves, values: np.ndarray, tries: int) -> Scan:
    total = np.zeros(len(values))
    for i, (g, wave) in enumerate(zip(moves, waves, strict=True)):
        total += np.abs(latent_push(predictor, fit, g, i) @ wave) ** 2 / _information(predictor, g, i, wave)
    return Scan(tries, values, np.nan_to_num(total, nan=0.0, posinf=0.0))  # where a filter loses a record, nothing shows


def _information(predictor: Predictor, g: np.ndarray, i: int, waves: np.ndarray) -> np.ndarray:
    """Half the squared response of the errors to the real and imaginary parts of waves (N, c): the scale of |score|^2."""
    line = predictor.lines[i]
    parts = np.concatenate([np.real(waves), np.imag(waves)], axis=1)
    push = g[:, :, None] * parts[:, None, :]
    white = np.einsum("kij,kjc->kic", predictor.passes[i].whitening, response(line, predictor.passes[i].gain, push))
    squares = (white**2).sum(axis=(0, 1))
    return np.maximum(0.5 * (squares[: waves.shape[1]] + squares[waves.shape[1] :]), 1e-300)
