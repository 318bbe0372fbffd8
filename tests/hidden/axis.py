"""The positioning axis, written a second time, under a loop of its position with a filtered rate.

    M q'' = F - Fv q' + what rubs and pulls

Runge-Kutta of fourth order at 0.25 ms; the force is drawn once a sample of 1 ms.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit

from plants import POSITIONING_AXIS
from tests.hidden.catalogue import ACTUATOR, SENSOR, SLIDE, Hidden, Ranges, fields_of, foreign_fields
from tests.hidden.drawn import Outcome, Programme, asked, logged, within_tolerance
from tests.hidden.parts import (
    LONGEST_DELAY,
    SENSOR_MEMORY,
    Drive,
    Sensor,
    Shaft,
    advance,
    ahead,
    amplified,
    bristle_step,
    coloured,
    delayed,
    imbalance_inertia,
    read,
    sense_start,
    sense_step,
    shaft_torque,
)
from workbench.records import record

DT = 0.001
FINE = 4  # steps a sample
TRAVEL = 0.010  # m/rad, lead of the screw over 2 pi


class Machine(NamedTuple):
    """Numbers of one machine, as in its data sheet."""

    M: float
    Fv: float


class Loop(NamedTuple):
    """F = kp (r - q) + kd (r' - d) + feed r'' + z,  d the difference of q, filtered;  z+ = z + ki dt (r - q).

    An open loop is F = direct r, from the middle of the way.
    """

    kp: float = 0.0
    ki: float = 0.0
    kd: float = 0.0
    feed: float = 0.0
    fade: float = 0.0
    direct: float = 0.0


class Foreign(NamedTuple):
    """Physics that no catalogue of ours holds; 0 is neutral."""

    bent_guide: float = 0.0  # viscous friction grows away from the middle: force -= c q^2 v [N s/m^3]
    cable_spring: float = 0.0  # force -= c q [N/m]
    cubic_drag: float = 0.0  # force -= c v^3 [N s^3/m^3]


@njit(cache=True)
def _rates(x, rate, m, shaft, foreign, bristle, force, t):
    q, v = x[0], x[1]
    mass = m.M + imbalance_inertia(shaft)
    pull = foreign.bent_guide * q * q * v + foreign.cable_spring * q + foreign.cubic_drag * v**3
    rate[0] = v
    rate[1] = (force - m.Fv * v - pull + shaft_torque(shaft, bristle, v, q / TRAVEL, 0.0, mass, t)) / mass


@njit(cache=True)
def run(m, shaft, drive, sensor, foreign, loop, course, forces, draws):
    """(forces commanded (N), positions measured (N)) from rest: course (N) set-points or forces, forces (N) disturbance."""
    N, h = len(course), DT / FINE
    commands, measured = np.empty(N), np.empty(N)
    x, k1, k2, k3, k4 = np.zeros(2), np.empty(2), np.empty(2), np.empty(2), np.empty(2)
    mid = np.empty(len(x))
    x[0] = seen = before = course[0] if loop.direct == 0.0 else 0.0
    fifo, count, bristle, gap, z, speed = np.zeros(int(LONGEST_DELAY / h) + 2), 0, 0.0, 0.0, 0.0, 0.0
    memory = np.empty(SENSOR_MEMORY)
    sense_start(memory, seen)
    for k in range(N):
        y = measured[k] = read(sensor, seen, draws[k])
        if k == 0:
            before = y
        speed = loop.fade * speed + (1.0 - loop.fade) * (y - before) / DT
        before = y
        inner = min(max(k, 1), N - 2)  # a course that ends on the move is not braked in its last sample
        last, now, after = course[inner - 1], course[inner], course[inner + 1]
        wanted, push = (after - last) / (2.0 * DT), (after - 2.0 * now + last) / DT**2
        u = commands[k] = loop.kp * (course[k] - y) + loop.kd * (wanted - speed) + loop.feed * push + z + loop.direct * course[k]
        z += loop.ki * DT * (course[k] - y)
        for j in range(FINE):
            t = k * DT + j * h
            fifo[count % len(fifo)] = u
            force, gap = amplified(drive, gap, delayed(fifo, count, drive.input_delay, h), t, h)
            count += 1
            force += forces[k]
            _rates(x, k1, m, shaft, foreign, bristle, force, t)
            _rates(ahead(x, k1, 0.5 * h, mid), k2, m, shaft, foreign, bristle, force, t + 0.5 * h)
            _rates(ahead(x, k2, 0.5 * h, mid), k3, m, shaft, foreign, bristle, force, t + 0.5 * h)
            _rates(ahead(x, k3, h, mid), k4, m, shaft, foreign, bristle, force, t + h)
            advance(x, k1, k2, k3, k4, h)
            bristle = bristle_step(shaft, bristle, x[1], 0.0, t + h, h)
            seen = sense_step(sensor, memory, x[0], h)
        if not np.isfinite(x[0]) or abs(x[0]) > 1e3:
            commands[k:], measured[k:] = np.inf, np.inf
            break
    return commands, measured


# ---- what a case draws -----------------------------------------------------------------------------------------------

NAME = "positioning-axis"
PLANT = POSITIONING_AXIS
SAMPLES = 4500
RANGES = Ranges(duration=SAMPLES * DT, radian=TRAVEL, orders=3)
INPUTS, OUTPUTS = ("F",), ("q",)
FORCE_NOISE = 0.5  # N
READING = PLANT.noise.get("q", 2.0e-6)  # m, noise of the scale
HALF = 0.25  # m, half of the way
FOREIGN = tuple(name.replace("_", "-") for name in Foreign._fields)
TRIAL = dict(zip(FOREIGN, (500.0, 20.0, 200.0), strict=True))
PLACES = {"slide": SLIDE, "F": ACTUATOR, "q": SENSOR}
CAPS = {
    "coulomb": 60.0, "stribeck": 60.0, "asymmetric-friction": 60.0, "quadratic-friction": 500.0, "friction-jump": 60.0,
    "imbalance": 20.0, "torque-ripple": 20.0,
    "offset": 30.0, "dead-zone": 30.0, "input-delay": 0.004, "heating": 0.4, "gear-backlash": 0.5,
    "sensor-lag": 0.004, "sensor-resonance": 0.001, "sensor-bias": 0.01, "sensor-gain": 0.1, "sensor-nonlinearity": 0.2,
    "quantisation": 1e-4, "backlash": 1e-4,
}  # fmt: skip


@record
class Setting:
    """One axis, its loop, its scale's resolution and its unlogged force, as drawn."""

    machine: Machine
    loop: Loop
    pole: float
    share: float
    resolution: float
    names: tuple[str, ...] = OUTPUTS


def setting(random: np.random.Generator, minimal: bool) -> Setting:
    """An axis within the tolerances of its data sheet under a position loop of 2.5 to 5 Hz."""
    del minimal  # it measures one thing only
    machine = Machine(**within_tolerance(PLANT, random))
    pole, share = float(np.exp(-DT / random.uniform(0.01, 0.2))), random.uniform(0.0, 0.5)
    return Setting(machine, _loop(random), pole, share, random.uniform(0.1, 0.5) * READING)


def with_loop(setting: Setting, random: np.random.Generator) -> Setting:
    """The same axis with another loop."""
    return replace(setting, loop=_loop(random))


def _loop(random: np.random.Generator) -> Loop:
    mass = {p.name: p.value for p in PLANT.parameters}["M"]
    omega = 2 * np.pi * random.uniform(2.5, 5.0)
    fade = float(np.exp(-DT / random.uniform(0.002, 0.005)))
    kp, kd = mass * omega**2, 2.0 * random.uniform(0.7, 1.0) * omega * mass
    return Loop(kp, 0.2 * omega * kp, kd, random.uniform(0.6, 1.1) * mass, fade)


def programmes(setting: Setting, random: np.random.Generator) -> tuple[Programme, ...]:
    """Two or three records to learn from and one held out: moves to and fro with stops between, and a slow wave."""
    del setting
    t = DT * np.arange(SAMPLES)

    def moves() -> np.ndarray:
        course, at = [], 0.0
        while sum(map(len, course)) < SAMPLES:
            target = random.uniform(0.3, 1.0) * HALF * (-1.0 if at > 0 else 1.0)
            course.append(at + (target - at) * _move(abs(target - at), random.uniform(0.15, 0.6), random.uniform(2.0, 6.0)))
            course.append(np.full(int(random.integers(50, 300)), target))
            at = target
        return np.concatenate(course)[:SAMPLES]

    wave = HALF * np.sin(2 * np.pi * random.uniform(0.15, 0.3) * t) * np.sin(2 * np.pi * random.uniform(0.3, 0.6) * t)
    made = [("moves", moves()), ("slow wave", wave), ("moves again", moves())][: 2 + int(random.integers(2))]
    learned = [Programme(name, course[:, None]) for name, course in made]
    return (*learned, Programme("other moves (held out)", moves()[:, None], held_out=True))


def follow(setting: Setting, name: str, references: Mapping[str, np.ndarray]) -> Programme:
    """The programme that asks for these set-points of position, or for these forces."""
    del setting
    return asked(name, references, ("q_set",), ("F",))


def _move(way: float, fastest: float, acceleration: float) -> np.ndarray:
    """0 to 1 with a trapezoid of speed [m/s, m/s^2]."""
    fastest = min(fastest, np.sqrt(way * acceleration))
    rise, length = fastest / acceleration, way / fastest
    t = np.arange(0.0, rise + length, DT)
    speed = np.minimum(np.minimum(t / rise, 1.0), (rise + length - t) / rise)
    return np.cumsum(speed) / np.sum(speed)


def resolutions(setting: Setting) -> dict[str, float]:
    """The step to which every sensor rounds, whatever is hidden."""
    return {"q": setting.resolution}


def outcome(setting: Setting, programme: Programme, hidden: tuple[Hidden, ...], seed: np.random.SeedSequence) -> Outcome:
    """One record; its noise and its phases come from the seed alone, whatever is hidden."""
    draws, phases = (np.random.default_rng(s) for s in seed.spawn(2))
    course = np.ascontiguousarray(programme.signals[:, 0])
    loop = Loop(direct=1.0) if programme.open_loop else setting.loop
    forces = FORCE_NOISE * coloured(draws, (len(course), 1), setting.pole, setting.share)[:, 0]
    sensor = Sensor(READING, resolutions(setting)["q"])._replace(**fields_of(Sensor, hidden, "q", phases))
    shaft = Shaft(breakaway=2e-5)._replace(**fields_of(Shaft, hidden, "slide", phases))
    commands, measured = run(
        setting.machine, shaft, Drive(**fields_of(Drive, hidden, "F", phases)), sensor,
        Foreign(**foreign_fields(Foreign, hidden)), loop, course, forces, draws.standard_normal(len(course)),
    )  # fmt: skip
    fault = "the axis ran away" * (not np.abs(measured).max() < 2.0 * HALF)
    values = {"F": commands, "q": measured, "q_set": course}
    values = {name: np.nan_to_num(v, posinf=0.0) for name, v in values.items()} if fault else values
    references = {} if programme.open_loop else {"q_set": "q"}
    return Outcome(logged(PLANT, programme.name, values, ("F", "q"), references), fault)
