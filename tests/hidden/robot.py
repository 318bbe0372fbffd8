"""The welding robot, written a second time, with the arm swinging smoothly between the samples of its log.

    m1 v1' = F - b1 v1 - c (v1 - v2) + what rubs, pulls and tilts,   m2 v2' = c (v1 - v2) - b2 v2

The platform is driven open loop or by a PI loop on its speed. Runge-Kutta of fourth order at 1 ms.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit

from plants import WELDING_ROBOT
from tests.hidden.catalogue import ACTUATOR, ROBOT, SENSOR, SLIDE, Hidden, Ranges, fields_of, foreign_fields
from tests.hidden.drawn import Outcome, Programme, asked, logged, staircase, within_tolerance
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

DT = 0.020
FINE = 20  # steps a sample
TRAVEL = 0.010  # m/rad, radius of the wheels


class Machine(NamedTuple):
    """Numbers of one machine, as in its data sheet."""

    m1: float
    m2: float
    c: float
    b1: float
    b2: float


class Loop(NamedTuple):
    """u = feed r + kp (b r - v) + z,  z+ = z + ki dt (r - v); an open loop has feed 1 and no gains."""

    feed: float = 1.0
    kp: float = 0.0
    ki: float = 0.0
    b: float = 1.0


class Arm(NamedTuple):
    """Missing physics between arm and platform."""

    arm_gravity_sine: float = 0.0
    arm_gravity_cosine: float = 0.0
    rail_tilt: float = 0.0
    platform_mass: float = 0.0
    platform_mass_period: float = 10.0
    arm_reaction: float = 0.0


class Foreign(NamedTuple):
    """Physics that no catalogue of ours holds; 0 is neutral."""

    cubic_drag: float = 0.0  # force -= c v1^3 [N s^3/m^3]
    arm_friction: float = 0.0  # force -= c arm^2 v1: the rail binds with the arm out [N s/m]
    stiff_coupling: float = 0.0  # the damper between the bodies: c (v1 - v2) |v1 - v2| more [N s^2/m^2]
    drive_angle: float = 0.0  # the drive's grip changes with the arm: F (1 + c sin arm) [1]


@njit(cache=True)
def _rates(x, rate, m, shaft, arm, foreign, bristle, force, angle, swing, t):
    v1, v2 = x[0], x[1]
    slip = v1 - v2
    coupling = m.c * slip + foreign.stiff_coupling * slip * abs(slip)
    mass = m.m1 * (1.0 + arm.platform_mass * np.sin(2.0 * np.pi * t / arm.platform_mass_period))
    mass += imbalance_inertia(shaft)
    pull = arm.arm_gravity_sine * np.sin(angle) + arm.arm_gravity_cosine * np.cos(angle) + arm.rail_tilt
    pull += arm.arm_reaction * swing + foreign.cubic_drag * v1**3 + foreign.arm_friction * angle * angle * v1
    driven = force * (1.0 + foreign.drive_angle * np.sin(angle))
    rubbing = shaft_torque(shaft, bristle, v1, x[2] / TRAVEL, 0.0, mass, t)
    rate[0] = (driven - m.b1 * v1 - coupling - pull + rubbing) / mass
    rate[1] = (coupling - m.b2 * v2) / m.m2
    rate[2] = v1


@njit(cache=True)
def run(m, shaft, drive, sensor, arm, foreign, loop, course, angles, forces, draws):
    """(commands (N), measured speed (N)) from rest: course (N) set-points, angles (N) of the arm, forces (N) disturbance."""
    N, h = len(course), DT / FINE
    commands, measured = np.empty(N), np.empty(N)
    x, k1, k2, k3, k4 = np.zeros(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    mid = np.empty(len(x))
    fifo, count, bristle, gap, z, seen = np.zeros(int(LONGEST_DELAY / h) + 2), 0, 0.0, 0.0, 0.0, 0.0
    memory = np.empty(SENSOR_MEMORY)
    sense_start(memory, 0.0)
    for k in range(N):
        y = measured[k] = read(sensor, seen, draws[k])
        u = commands[k] = loop.feed * course[k] + loop.kp * (loop.b * course[k] - y) + z
        z += loop.ki * DT * (course[k] - y)
        swing = (angles[min(k + 1, N - 1)] - angles[k]) / DT
        for j in range(FINE):
            t = k * DT + j * h
            fifo[count % len(fifo)] = u
            force, gap = amplified(drive, gap, delayed(fifo, count, drive.input_delay, h), t, h)
            count += 1
            force += forces[k]
            a = angles[k] + swing * j * h
            _rates(x, k1, m, shaft, arm, foreign, bristle, force, a, swing, t)
            _rates(
                ahead(x, k1, 0.5 * h, mid), k2, m, shaft, arm, foreign, bristle, force, a + 0.5 * h * swing, swing, t + 0.5 * h
            )
            _rates(
                ahead(x, k2, 0.5 * h, mid), k3, m, shaft, arm, foreign, bristle, force, a + 0.5 * h * swing, swing, t + 0.5 * h
            )
            _rates(ahead(x, k3, h, mid), k4, m, shaft, arm, foreign, bristle, force, a + h * swing, swing, t + h)
            advance(x, k1, k2, k3, k4, h)
            bristle = bristle_step(shaft, bristle, x[0], 0.0, t + h, h)
            seen = sense_step(sensor, memory, x[0], h)
        if not np.isfinite(x[0]) or abs(x[0]) > 1e3:
            commands[k:], measured[k:] = np.inf, np.inf
            break
    return commands, measured


# ---- what a case draws -----------------------------------------------------------------------------------------------

NAME = "welding-robot"
PLANT = WELDING_ROBOT
SAMPLES = 2000
RANGES = Ranges(duration=SAMPLES * DT, radian=TRAVEL, orders=3)
INPUTS, OUTPUTS = ("u",), ("v",)
FORCE_NOISE = 0.02  # N
FASTEST = 15.0  # m/s, beyond it the robot has run away
RESOLUTION = 1e-4  # rad, of the logged angle of the arm
FOREIGN = tuple(name.replace("_", "-") for name in Foreign._fields)
TRIAL = dict(zip(FOREIGN, (0.01, 0.05, 0.3, 0.05), strict=True))
PLACES = {"rail": SLIDE + ROBOT, "u": ACTUATOR, "v": SENSOR}
CAPS = {
    "coulomb": 0.6, "stribeck": 0.6, "asymmetric-friction": 0.6, "quadratic-friction": 0.3, "friction-jump": 0.6,
    "imbalance": 0.5, "torque-ripple": 0.5, "arm-gravity": 0.8, "rail-tilt": 0.6, "platform-mass": 0.44, "arm-reaction": 0.5,
    "offset": 0.6, "dead-zone": 0.6, "input-delay": 0.1, "heating": 0.4, "gear-backlash": 0.3,
    "sensor-lag": 0.2, "sensor-resonance": 0.05, "sensor-bias": 0.2, "sensor-gain": 0.2, "sensor-nonlinearity": 0.1,
    "quantisation": 0.05, "backlash": 0.1,
}  # fmt: skip


@record
class Setting:
    """One robot, its loop, its sensor's resolution and its unlogged force, as drawn."""

    machine: Machine
    loop: Loop
    pole: float
    share: float
    resolution: float
    names: tuple[str, ...] = OUTPUTS


def setting(random: np.random.Generator, minimal: bool) -> Setting:
    """A robot within the tolerances of its data sheet, in half of the cases under a PI loop of its speed."""
    del minimal  # it measures one thing only
    machine = Machine(**within_tolerance(PLANT, random))
    loop = _loop(random) if random.random() < 0.5 else Loop()
    pole, share = float(np.exp(-DT / random.uniform(0.1, 1.0))), random.uniform(0.0, 0.5)
    return Setting(machine, loop, pole, share, random.uniform(0.1, 0.5) * PLANT.noise["v"])


def with_loop(setting: Setting, random: np.random.Generator) -> Setting:
    """The same robot with another loop; an open one stays open."""
    return setting if setting.loop == Loop() else replace(setting, loop=_loop(random))


def _loop(random: np.random.Generator) -> Loop:
    kp, ki = np.exp(random.uniform(np.log(0.5), np.log(2.0), 2)) * [4.0, 5.0]
    return Loop(random.uniform(0.0, 0.8), kp, ki, random.uniform(0.3, 0.9))


def programmes(setting: Setting, random: np.random.Generator) -> tuple[Programme, ...]:
    """Three records to learn from and one or two held out: courses of force [N] or of speed [m/s], and of the arm [rad]."""
    scale = 2.0 if setting.loop == Loop() else 1.2

    def steps(count: int, rise: int) -> np.ndarray:
        return staircase(SAMPLES, list(random.uniform(-1.0, 1.0, count) * (random.random(count) > 0.15)), rise)

    def arm(count: int) -> np.ndarray:
        return 1.2 * staircase(SAMPLES, list(random.uniform(-1.0, 1.0, count)), int(random.integers(50, 100)))

    signs = random.choice([-1.0, 1.0], SAMPLES // 10)
    stops = staircase(SAMPLES, [0.0, 1.0, 0.0, -1.0, 0.5, 1.0, -0.5, -1.0, 0.0, 0.5], 1)
    t = DT * np.arange(SAMPLES)
    waves = np.sum([np.sin(2 * np.pi * f * t + random.uniform(0.0, 6.0)) for f in random.uniform(0.03, 1.5, 5)], axis=0) / 3.0
    made = [
        ("binary", np.repeat(signs, 10)[:SAMPLES], arm(7), False),
        ("stops", stops, arm(11), False),
        ("steps", steps(40, 5), arm(9), False),
        ("waves (held out)", waves, arm(8), True),
        ("levels (held out)", steps(16, 40), arm(6), True),
    ]
    kept = made[: 4 + int(random.integers(2))]
    return tuple(Programme(name, np.column_stack([scale * course, angle]), held_out=held) for name, course, angle, held in kept)


def follow(setting: Setting, name: str, references: Mapping[str, np.ndarray]) -> Programme:
    """The programme that asks for these set-points of speed, where there is a loop, or for these forces; and moves the arm."""
    return asked(name, references, () if setting.loop == Loop() else ("v_set", "arm"), ("u", "arm"))


def resolutions(setting: Setting) -> dict[str, float]:
    """The step to which every sensor rounds, whatever is hidden."""
    return {"v": setting.resolution}


def outcome(setting: Setting, programme: Programme, hidden: tuple[Hidden, ...], seed: np.random.SeedSequence) -> Outcome:
    """One record; its noise and its phases come from the seed alone, whatever is hidden."""
    draws, phases = (np.random.default_rng(s) for s in seed.spawn(2))
    course, angle = programme.signals.T
    loop = Loop() if programme.open_loop else setting.loop
    forces = FORCE_NOISE * coloured(draws, (len(course), 1), setting.pole, setting.share)[:, 0]
    sensor = Sensor(PLANT.noise["v"], resolutions(setting)["v"])._replace(**fields_of(Sensor, hidden, "v", phases))
    shaft = Shaft(breakaway=2e-4)._replace(**fields_of(Shaft, hidden, "rail", phases))
    commands, measured = run(
        setting.machine, shaft, Drive(**fields_of(Drive, hidden, "u", phases)), sensor,
        Arm(**fields_of(Arm, hidden, "rail", phases)), Foreign(**foreign_fields(Foreign, hidden)), loop,
        np.ascontiguousarray(course), np.ascontiguousarray(angle), forces, draws.standard_normal(len(course)),
    )  # fmt: skip
    fault = "the robot ran away" * (not np.abs(measured).max() < FASTEST)
    values = {"u": commands, "v": measured, "arm": RESOLUTION * np.round(angle / RESOLUTION), "v_set": course}
    values = {name: np.nan_to_num(v, posinf=0.0) for name, v in values.items()} if fault else values
    references = {} if loop == Loop() else {"v_set": "v"}
    return Outcome(logged(PLANT, programme.name, values, ("u", "arm", "v"), references), fault)
