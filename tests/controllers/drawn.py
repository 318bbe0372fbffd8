"""Loops to be designed, drawn at random, and a judge of what a design says, which shares no code with it.

Sampled plants of five kinds: a resonance (zeta 0.05 to 1), a lag with dead time, an integrator with a leak, a zero on the
wrong side, a resonance with dead time; of FREE ones an integrator behind a lag, a free mass, a pole that grows. Law, from
e = -y, with z = exp(j omega dt):

    K(z) = Kp + Ki dt / (z - 1) + Kd (z - 1) / ((Tf + dt) z - Tf),    Tf = 2 dt
"""

from dataclasses import dataclass
from fractions import Fraction

import control
import numpy as np
from scipy import signal

from workbench.basis import CONSTANT
from workbench.data import Channel
from workbench.lpv import LPVModel, OperatingPoint, constant_model
from workbench.robustness.frozen import Bounds

KINDS = ("resonance", "dead-time", "leaky-integrator", "wrong-zero", "late-resonance")
SENSITIVITY, COMPLEMENTARY, EFFORT = (1.3, 1.5, 1.7, 2.0), (1.2, 1.4, 1.6, 2.0), (1.3, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0)
FREE = ("integrator", "double-integrator", "unstable")  # that a law has to hold at all
LAWS, TRIES = 2000, 60  # stable laws that are looked at; batches of as many that are drawn for them
GRID, CLOSE = 400, 9  # frequencies along the axis; around every pole


@dataclass(frozen=True)
class Asked:
    """Largest |S|, |T|, and |Q| in units of 1 / |P(0)|."""

    sensitivity: float
    complementary: float
    effort: float

    @property
    def bounds(self) -> Bounds:
        return Bounds(self.sensitivity, self.complementary, self.effort)


@dataclass(frozen=True)
class Drawn:
    """num / den in z, sampled every dt seconds."""

    kind: str
    num: np.ndarray
    den: np.ndarray
    dt: float
    said: str

    @property
    def steady(self) -> float:
        """The gain at rest; of one that integrates or is unstable that of its slow modes at a real z a tenth beyond its poles."""
        radius = np.abs(np.roots(self.den)).max()
        if radius < 1.0 - 1e-4:
            return float(self.num.sum() / self.den.sum())
        residues, poles, _ = signal.residue(self.num, self.den, tol=1e-6)
        z, power, total = max(radius, 1.0) + 0.1, 1, 0.0
        for i, (residue, pole) in enumerate(zip(residues, poles, strict=True)):
            power = power + 1 if i and abs(pole - poles[i - 1]) < 1e-6 else 1
            total += (residue / (z - pole) ** power).real if abs(pole) > 0.9 else 0.0
        return float(total)

    def model(self) -> LPVModel:
        """The plant as `identify` would hand it over, in a realisation of its own scale."""
        plant = control.ss(control.tf(self.num, self.den, self.dt))
        channels = (Channel("u", "V", "input"),), (Channel("y", "m", "output"),)
        point = OperatingPoint(CONSTANT, u=[[0.0]], y=[[0.0]])
        return constant_model(self.kind, self.dt, channels, (plant.A, plant.B, plant.C, plant.D), point)


def draw(random: np.random.Generator, kind: str) -> Drawn:
    """A plant of this kind with its time in other units, gain of any sign, and a sample time that suits it."""
    unit, gain = 10.0 ** random.uniform(-1.5, 1.0), random.choice([-1.0, 1.0]) * 10.0 ** random.uniform(-2.0, 2.0)
    zeta, delay = float(np.exp(random.uniform(np.log(0.05), 0.0))), 0.0
    if kind == "resonance":
        num, den, dt = [1.0], [1.0, 2.0 * zeta, 1.0], random.uniform(0.05, 0.4)
        said = f"zeta {zeta:.3f}"
    elif kind == "dead-time":
        second, delay, dt = random.uniform(0.0, 0.8), random.uniform(0.1, 2.0), random.uniform(0.05, 0.2)
        num, den = [1.0], np.polymul([1.0, 1.0], [second, 1.0])
        said = f"second lag {second:.2f}, delay {delay:.2f}"
    elif kind == "leaky-integrator":
        leak, lag, dt = 10.0 ** random.uniform(-2.5, -1.0), random.uniform(0.05, 0.5), random.uniform(0.05, 0.2)
        num, den = [leak], np.polymul([1.0, leak], [lag, 1.0])
        delay = random.choice([0.0, dt])
        said = f"leak {leak:.4f}, lag {lag:.2f}, delay {delay:.2f}"
    elif kind == "integrator":
        lag, dt = random.uniform(0.2, 2.0), random.uniform(0.05, 0.2)
        num, den = [1.0], np.polymul([1.0, 0.0], [lag, 1.0])
        delay = random.choice([0.0, dt])
        said = f"lag {lag:.2f}, delay {delay:.2f}"
    elif kind == "double-integrator":
        friction, dt = random.choice([0.0, 0.05]), random.uniform(0.05, 0.2)
        num, den, said = [1.0], [1.0, friction, 0.0], f"friction {friction:.2f}"
    elif kind == "unstable":
        grows, lag, dt = random.uniform(0.1, 0.6), random.uniform(0.05, 0.3), random.uniform(0.03, 0.08)
        num, den, said = [1.0], np.polymul([1.0, -grows], [lag, 1.0]), f"grows by {grows:.2f}, lag {lag:.2f}"
    elif kind == "wrong-zero":
        zero, second, dt = random.uniform(0.1, 2.0), random.uniform(0.1, 1.0), random.uniform(0.05, 0.2)
        num, den = [-zero, 1.0], np.polymul([1.0, 1.0], [second, 1.0])
        said = f"zero {zero:.2f}, second lag {second:.2f}"
    else:
        num, den, dt, delay = [1.0], [1.0, 2.0 * zeta, 1.0], random.uniform(0.1, 0.4), random.uniform(0.2, 1.5)
        said = f"zeta {zeta:.3f}, delay {delay:.2f}"
    plant = signal.cont2discrete((gain * np.atleast_1d(num), np.atleast_1d(den)), dt, "zoh")
    late = round(Fraction(delay / dt))
    return Drawn(kind, plant[0][0], np.append(plant[1], np.zeros(late)), dt * unit, f"{said}, {dt:.2f} a sample, gain {gain:.3g}")


def ask(random: np.random.Generator) -> Asked:
    return Asked(*(float(random.choice(choices)) for choices in (SENSITIVITY, COMPLEMENTARY, EFFORT)))


@dataclass(frozen=True)
class Judged:
    """Of L laws: largest |S|, |T|, |Q| (L 3), the largest pole (L), and the integral action Ki P(0) (L) in 1/s."""

    peaks: np.ndarray
    radius: np.ndarray
    action: np.ndarray

    def kept(self, asked: Asked, room: float = 0.0) -> np.ndarray:
        limits = np.array([asked.sensitivity, asked.complementary, asked.effort]) * (1.0 - room)
        return (self.radius < 1.0) & (self.peaks <= limits).all(axis=1) & (self.action > 0.0)


def judge(plant: Drawn, gains: np.ndarray) -> Judged:
    """What laws with these Kp, Ki, Kd (L 3) do with the plant."""
    gains = np.atleast_2d(gains)
    dt, Tf = plant.dt, 2.0 * plant.dt
    poles = _closed(plant, gains)
    around = np.concatenate([np.angle(np.roots(plant.den)), np.linspace(0.0, np.pi, 2)])
    omega = np.abs(np.concatenate([np.geomspace(1e-5, 1.0, GRID // 2) * np.pi, np.linspace(1e-3, 1.0, GRID) * np.pi, around]))
    own = np.abs(np.angle(poles))[:, :, None] + np.abs(1.0 - np.abs(poles))[:, :, None] * np.linspace(-2.0, 2.0, CLOSE)
    omega = np.concatenate([np.broadcast_to(omega, (len(gains), len(omega))), own.reshape(len(gains), -1)], axis=1)
    z = np.exp(1j * np.clip(np.abs(omega), 1e-6, np.pi))
    P = np.polyval(plant.num, z) / np.polyval(plant.den, z)
    Kp, Ki, Kd = gains.T[:, :, None]
    K = Kp + Ki * dt / (z - 1.0) + Kd * (z - 1.0) / ((Tf + dt) * z - Tf)
    S = 1.0 / (1.0 + P * K)
    peaks = [np.abs(M).max(axis=1) for M in (S, P * K * S, K * S * plant.steady)]
    return Judged(np.stack(peaks, axis=1), np.abs(poles).max(axis=1), gains[:, 1] * plant.steady)


def _closed(plant: Drawn, gains: np.ndarray) -> np.ndarray:
    """Poles of the loops with these laws, (L n)."""
    return _roots(_denominators(plant, gains))


def _parts(plant: Drawn) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What Kp, Ki and Kd are multiplied with, over (z - 1) ((Tf + dt) z - Tf)."""
    dt, Tf = plant.dt, 2.0 * plant.dt
    filtered, integral = np.array([Tf + dt, -Tf]), np.array([1.0, -1.0])
    return np.polymul(integral, filtered), dt * filtered, np.polymul(integral, integral)


def _denominators(plant: Drawn, gains: np.ndarray) -> np.ndarray:
    parts, whole = _parts(plant), len(plant.den) + 2
    numerators = np.stack([np.pad(np.polymul(plant.num, p), (whole, 0))[-whole:] for p in parts])
    return np.polymul(plant.den, parts[0]) + gains @ numerators


def _roots(polynomials: np.ndarray) -> np.ndarray:
    """Of many polynomials (L n + 1) at once: eigenvalues of companion matrices (L n)."""
    monic = polynomials / polynomials[:, :1]
    n = monic.shape[1] - 1
    companion = np.zeros((len(monic), n, n))
    companion[:, 0] = -monic[:, 1:]
    companion[:, np.arange(1, n), np.arange(n - 1)] = 1.0
    return np.linalg.eigvals(companion)


def variances(plant: Drawn, gains: np.ndarray, load: float) -> np.ndarray:
    """Variance (L) of y of stable laws, under white noise of variance 1 on it and load steps that add `load` = d^2 dt / T.

    Sums of squares of the responses S to a pulse and P S z / (z - 1) to a step, until they have died away.
    """
    parts, found = _parts(plant), []
    gains = np.atleast_2d(gains)
    for closed, radius in zip(_denominators(plant, gains), np.abs(_closed(plant, gains)).max(axis=1), strict=True):
        samples = min(int(np.log(1e-7) / np.log(min(radius, 1.0 - 1e-9))) + len(closed), 10**6)
        pulse = np.zeros(samples)
        pulse[0] = 1.0
        S = signal.lfilter(np.polymul(plant.den, parts[0]), closed, pulse)
        step = np.polymul(np.polymul(plant.num, [plant.dt * 3.0, -plant.dt * 2.0]), [1.0, 0.0])
        PS = signal.lfilter(np.pad(step, (len(closed) - len(step), 0)), closed, pulse)
        found.append(S @ S + load * PS @ PS)
    return np.array(found)


def best_at_random(
    plant: Drawn, bounds: list[Asked], random: np.random.Generator, laws: int = LAWS, worth=lambda found, _gains: found.action
) -> list[float]:
    """For each of the bounds the largest worth, Ki P(0), among so many stable laws drawn at random; -inf where none fits."""
    slowest = np.log(np.abs(np.roots(plant.den)).max() + 1e-12)
    fast, slow = 1.0 / plant.dt, max(-slowest, 1e-4) / plant.dt  # rad/s
    best, seen = np.full(len(bounds), -np.inf), 0
    for _ in range(TRIES):
        size = 10.0 ** random.uniform([-2.5, 0.0, -2.5], [2.0, 1.0, 2.0], (laws, 3))
        crossing = np.exp(random.uniform(np.log(0.02 * slow), np.log(fast), laws))
        sign = random.choice([-1.0, 1.0], (laws, 3), p=[0.25, 0.75])
        sign[:, 1] = 1.0
        scale = np.stack([np.ones(laws), crossing * 10.0 ** random.uniform(-2.0, 0.0, laws), 1.0 / crossing], axis=1)
        gains = size * sign * scale / plant.steady
        stable = np.flatnonzero(np.abs(_closed(plant, gains)).max(axis=1) < 1.0)[: laws - seen]
        seen += len(stable)
        found = judge(plant, gains[stable])
        for i, asked in enumerate(bounds):
            kept = found.kept(asked)
            best[i] = max(best[i], worth(found, gains[stable])[kept].max(initial=-np.inf))
        if seen >= laws:
            break
    return best.tolist()
