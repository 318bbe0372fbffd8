"""Axes with something hidden in them, drawn from a seed: records as a laboratory makes them, and runs under any law.

    M q'' = F - Fv q' - friction(q')

What arrives of a command comes late, less a dead zone; the encoder sits behind play, or reads what is there. Mass and viscous
friction are off what the data sheet says by up to their tolerance, and drawn again a little for every later run: a machine warms
up. Equations and integrator (midpoint rule, 20 steps a sample) are written here and share nothing with the workbench.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

DT, STEPS = 0.004, 20
KINDS = ("friction", "delay", "play", "dead-zone")
SIZES = {"friction": (12.0, 40.0), "delay": (0.004, 0.012), "play": (1e-4, 1e-3), "dead-zone": (5.0, 30.0)}
EFFECTS = {  # what the workbench may call it
    "friction": ("coulomb@slide", "asymmetric-friction@slide", "stribeck@slide"),
    "delay": ("input-delay@F",),
    "play": ("backlash@q",),
    "dead-zone": ("dead-zone@F",),
}
NOISE, DISTURBANCE = 4e-6, 0.4  # m of the encoder, N of the drive, white from sample to sample
STROKE, RATE = 0.14, 0.35  # m to either side, m/s


@dataclass(frozen=True)
class Axis:
    """A machine: its numbers, and how large each of KINDS is in it."""

    M: float
    Fv: float
    hidden: Mapping[str, float]

    def warm(self, random: np.random.Generator) -> "Axis":
        """The same machine on another day."""
        return replace(self, M=self.M * random.uniform(0.99, 1.01), Fv=self.Fv * random.uniform(0.97, 1.03))

    def without(self) -> "Axis":
        """The same machine with nothing hidden."""
        return replace(self, hidden={})

    def run(self, step, r: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """F, what is logged of q, and where the slide is, (N,) each, under step(k, r, reading) -> F from rest at 0."""
        random, h = np.random.default_rng(seed), DT / STEPS
        own = {kind: self.hidden.get(kind, 0.0) for kind in KINDS}
        q = v = shown = 0.0
        late = [0.0] * round(own["delay"] / h)
        found = np.empty((3, len(r)))
        for k, wanted in enumerate(r):
            shown = max(q - own["play"], min(q + own["play"], shown))
            reading = shown + NOISE * random.standard_normal()
            F = step(k, wanted, reading)
            found[:, k] = F, reading, q
            pushed = F + DISTURBANCE * random.standard_normal()
            for _ in range(STEPS):
                late.append(pushed)
                force = late.pop(0)
                force -= max(-own["dead-zone"], min(own["dead-zone"], force))
                middle = v + 0.5 * h * self._accelerated(force, v, own["friction"])
                q, v = q + h * middle, v + h * self._accelerated(force, middle, own["friction"])
        return found[0], found[1], found[2]

    def _accelerated(self, force: float, v: float, friction: float) -> float:
        return (force - self.Fv * v - friction * np.tanh(v / 2e-3)) / self.M


@dataclass(frozen=True)
class Case:
    """A drawn machine, what is hidden in it, and its records: (F, q, q_set) each, the last one to be held out."""

    kind: str
    axis: Axis
    records: list[np.ndarray]


def draw(seed: int) -> Case:
    """The case of a seed."""
    random = np.random.default_rng([31, seed])
    kind = KINDS[seed % len(KINDS)]
    low, high = SIZES[kind]
    M, Fv = 95.0 * random.uniform(0.9, 1.1), 200.0 * random.uniform(0.7, 1.3)
    axis, records = Axis(M, Fv, {kind: low * (high / low) ** random.uniform()}), []
    for k in range(4):
        r = path([*random.integers(0, 2**31, 1), k], 2500)
        F, q, _ = axis.run(_bench(), r, int(random.integers(0, 2**31)))
        records.append(np.column_stack([F, q, r]))
    return Case(kind, axis, records)


def path(seed, samples: int) -> np.ndarray:
    """Smooth moves (N,) from stop to stop, up to RATE fast, standing a little between."""
    random, found, at = np.random.default_rng(seed), [np.zeros(50)], 0.0
    while sum(map(len, found)) < samples:
        to = random.uniform(-STROKE, STROKE)
        n = max(150, int(1.875 * abs(to - at) / (RATE * random.uniform(0.3, 1.0)) / DT))
        share = np.linspace(0.0, 1.0, n)
        found += [at + (to - at) * share**3 * (10.0 - 15.0 * share + 6.0 * share**2), np.full(int(random.uniform(20, 80)), to)]
        at = to
    return np.concatenate(found)[:samples]


def _bench():
    """The controller of the laboratory: a PID that nobody tuned."""
    memory = {"z": 0.0, "d": 0.0, "y": 0.0}

    def step(k, wanted, reading):
        memory["d"] += 0.3 * ((reading - memory["y"]) / DT * (k > 0) - memory["d"])
        memory["y"], e = reading, wanted - reading
        memory["z"] += 3e4 * e * DT
        return 1.5e4 * e + memory["z"] - 1200.0 * memory["d"]

    return step
