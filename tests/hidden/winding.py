"""The web winding machine, written a second time: the web as springs of elongation x, the reels as wound angles.

    T_i = E(x_i) + D x_i' + xi_i,   x_1' = v3 - a_1 w_1,  x_2' = a_2 w_2 - v3
    J_i w_i' = -B_i w_i + kT/Ra (V_i - kV w_i) +- a_i T_i,   J3 w3' = r3 (T_2 - T_1),   r_1' = -s w_1/2 pi, r_2' = s w_2/2 pi

a_i is the distance of the web's line from the axis: the radius of a round reel, and for an eccentric one what the tangent from
the guide gives, which holds both the changed arm and the changed length of the span (virtual work). Runge-Kutta of fourth
order at 2 ms; bristles, gears, delays and sensors move between the steps.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit

from plants import WEB_WINDING
from tests.hidden.catalogue import ACTUATOR, SENSOR, SHAFT, SPAN, Hidden, Ranges, fields_of, foreign_fields
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

DT = 0.040
FINE = 20  # steps a sample
TORQUES = 4  # values of the torque noise a sample
REACH = 0.20  # m, from a reel's axis to the guide pulley
STATES = 12  # w1 w2 w3 x1 x2 xi1 xi2 angle1 angle2 angle3 r1 r2


class Machine(NamedTuple):
    """Numbers of one machine, as in its data sheet."""

    B1: float
    B2: float
    kT: float
    kV: float
    Ra: float
    s: float
    r3: float
    J3: float
    kE: float
    D: float
    r_core: float
    r_full: float
    J0: float
    density: float
    width: float
    dancer: float
    T_set: float


class Loop(NamedTuple):
    """u = bias + feed (w3_set - 100) + kp (b r - y) + z,  z+ = z + ki dt (r - y); index 1: dancer by V1, 2: speed by V2."""

    kp1: float
    ki1: float
    b1: float
    feed1: float
    bias1: float
    kp2: float
    ki2: float
    b2: float
    feed2: float
    bias2: float


class Span(NamedTuple):
    """Missing physics of one span of web."""

    nonlinear_elasticity: float = 0.0
    viscoelastic: float = 0.0
    viscoelastic_time: float = 1.0
    periodic_tension: float = 0.0
    periodic_tension_frequency: float = 1.0
    periodic_tension_phase: float = 0.0
    stiffness_jump: float = 0.0
    stiffness_jump_time: float = 1e9


class Web(NamedTuple):
    """Missing physics where web and rolls meet."""

    slip: float = 0.0
    air_entrainment: float = 0.0
    eccentricity1: float = 0.0
    eccentricity1_phase: float = 0.0
    eccentricity2: float = 0.0
    eccentricity2_phase: float = 0.0


class Foreign(NamedTuple):
    """Physics that no catalogue of ours holds; 0 is neutral."""

    tension_drag: float = 0.0  # torque 1 -= c w1 T1 [m s/rad]
    squared_load: float = 0.0  # torque 3 -= c (T1 + T2)^2 tanh(w3) [m/N]
    dancer_damping: float = 0.0  # dancer of 5 Hz with damping growing with its rate [s^2/deg]: z'' = .. - c omega |z'| z'
    cross_coupling: float = 0.0  # V1 drives motor 2 as well [1]
    radius_creep: float = 0.0  # the web lags on reel 2 the more the fuller it is: v2 (1 - c (r2/r_core - 1)) [1]
    dancer_stick: float = 0.0  # the dancer stands still until it is this far off, then jumps to its place [deg]
    cold_bearing: float = 0.0  # viscous friction 1 is higher by this share until the bearing has warmed up [1]
    field_weakening: float = 0.0  # torque of motor 2 falls with the current: kT i (1 - c i^2) [1/A^2]


@njit(cache=True)
def _spring(span, x, K, T0, t):
    """E(x) = T0 + K d + c (K d)^2/(2 T0) with d = x - T0/K: slope K sqrt(1 + 2 c (T - T0)/T0). And a guide that swings."""
    d = K * x - T0
    T = T0 + d + 0.5 * span.nonlinear_elasticity * d * d / T0
    if span.periodic_tension != 0.0:
        omega = 2.0 * np.pi * span.periodic_tension_frequency
        T += span.periodic_tension / omega * np.sin(omega * t + span.periodic_tension_phase)
    return T


@njit(cache=True)
def web_arm(r, offset, angle):
    """Distance from the axis to the tangent from the guide at (REACH, r) to a circle r whose centre is `offset` off [m]."""
    if offset == 0.0:
        return r
    cx, cy = offset * np.sin(angle), offset * np.cos(angle)
    dx, dy = REACH - cx, r - cy
    square = dx * dx + dy * dy
    free = np.sqrt(square - r * r)
    return r + (cx * (r * dx - free * dy) + cy * (r * dy + free * dx)) / square


@njit(cache=True)
def tensions(x, m, web, spans, foreign, K, t):
    """(T1, T2, v3, a1, a2) at stiffnesses K (2): tensions [N], speed of the web on the guide [m/s], arms of the reels [m]."""
    a1 = web_arm(x[10], web.eccentricity1, x[7] + web.eccentricity1_phase)
    a2 = web_arm(x[11], web.eccentricity2, x[8] + web.eccentricity2_phase)
    E1 = _spring(spans[0], x[3], K[0], m.T_set, t) + x[5]
    E2 = _spring(spans[1], x[4], K[1], m.T_set, t) + x[6]
    v1 = a1 * x[0]
    v2 = a2 * x[1] * (1.0 - foreign.radius_creep * (x[11] / m.r_core - 1.0))
    # v3 = r3 w3 + creep (T2 - T1), and the tensions hold v3 through the damping: one linear equation
    v3 = (m.r3 * x[2] + web.slip * (E2 - E1 + m.D * (v1 + v2))) / (1.0 + 2.0 * web.slip * m.D)
    return E1 + m.D * (v3 - v1), E2 + m.D * (v2 - v3), v3, a1, a2


@njit(cache=True)
def _inertia(r, m):
    return m.J0 + 0.5 * np.pi * m.density * m.width * (r**4 - m.r_core**4)


@njit(cache=True)
def _rates(x, rate, m, web, shafts, spans, foreign, K, bristles, warmth, u1, u2, noise, t):
    T1, T2, v3, a1, a2 = tensions(x, m, web, spans, foreign, K, t)
    w1, w2, w3 = x[0], x[1], x[2]
    J1 = _inertia(x[10], m) + imbalance_inertia(shafts[0])
    J2 = _inertia(x[11], m) + imbalance_inertia(shafts[1])
    J3 = m.J3 + imbalance_inertia(shafts[2])
    current = (u2 - m.kV * w2) / m.Ra
    motor1 = m.kT * (u1 - m.kV * w1) / m.Ra
    motor2 = m.kT * current * (1.0 - foreign.field_weakening * current * current)
    torque1 = motor1 + a1 * T1 - m.B1 * w1 * (1.0 + foreign.cold_bearing * np.exp(-warmth)) - foreign.tension_drag * w1 * T1
    torque2 = motor2 - a2 * T2 - m.B2 * w2 + foreign.cross_coupling * m.kT / m.Ra * u1
    torque3 = m.r3 * (T2 - T1)
    if foreign.squared_load != 0.0:
        torque3 -= foreign.squared_load * (T1 + T2) ** 2 * np.tanh(w3)
    rate[0] = (torque1 + noise[0] + shaft_torque(shafts[0], bristles[0], w1, x[7], a1 * T1, J1, t)) / J1
    rate[1] = (torque2 + noise[1] + shaft_torque(shafts[1], bristles[1], w2, x[8], a2 * T2, J2, t)) / J2
    rate[2] = (torque3 + noise[2] + shaft_torque(shafts[2], bristles[2], w3, x[9], m.r3 * (T1 + T2), J3, t)) / J3
    rate[3] = v3 - a1 * w1
    rate[4] = a2 * w2 * (1.0 - foreign.radius_creep * (x[11] / m.r_core - 1.0)) - v3
    for i in range(2):
        rate[5 + i] = spans[i].viscoelastic * m.kE * rate[3 + i] - x[5 + i] / spans[i].viscoelastic_time
    rate[7], rate[8], rate[9] = w1, w2, w3
    rate[10] = -m.s * w1 / (2.0 * np.pi)
    rate[11] = m.s * (1.0 + web.air_entrainment * x[11] * w2) * w2 / (2.0 * np.pi)


@njit(cache=True)
def run(m, web, shafts, drives, sensors, spans, foreign, loop, set_points, volts, torques, draws, start, hold, warm_up):
    """(commands (N, 2), measured (N, 5), lowest T1, T2 [N] and r1 [m]) of one run; the first warm_up samples have t < 0.

    set_points (N, 2): w3_set, theta_set; volts (N, 2) and torques (4 N, 3): disturbances; draws (N, 5): standard normal;
    start (12) states; hold (2): voltages that hold the start.
    """
    N, h = len(set_points), DT / FINE
    commands, measured = np.empty((N, 2)), np.empty((N, 5))
    x, k1, k2, k3, k4 = start.copy(), np.empty(STATES), np.empty(STATES), np.empty(STATES), np.empty(STATES)
    mid, K = np.empty(len(x)), np.full(2, m.kE)
    bristles, gap, lowest = np.zeros(3), np.ones(2), np.full(3, np.inf)
    fifo, count = np.empty((2, int(LONGEST_DELAY / h) + 2)), 0
    fifo[0], fifo[1] = hold[0], hold[1]
    z1 = hold[0] - loop.bias1 - loop.feed1 * (set_points[0, 0] - 100.0) - loop.kp1 * (loop.b1 - 1.0) * set_points[0, 1]
    z2 = hold[1] - loop.bias2 - loop.feed2 * (set_points[0, 0] - 100.0) - loop.kp2 * (loop.b2 - 1.0) * set_points[0, 0]
    memory, seen, warmth = np.empty((5, SENSOR_MEMORY)), np.empty(5), 0.0
    t = -warm_up * DT
    T1, T2, _, _, _ = tensions(x, m, web, spans, foreign, K, t)
    seen[:3], seen[3], seen[4] = x[:3], (T1 - m.T_set) / m.dancer, x[11]
    for i in range(5):
        sense_start(memory[i], seen[i])
    dancer, dancer_rate = seen[3], 0.0
    for k in range(N):
        for i in range(5):
            measured[k, i] = read(sensors[i], seen[i], draws[k, i])
        w_set, theta_set, w3, theta = set_points[k, 0], set_points[k, 1], measured[k, 2], measured[k, 3]
        u1 = loop.bias1 + loop.feed1 * (w_set - 100.0) + loop.kp1 * (loop.b1 * theta_set - theta) + z1
        u2 = loop.bias2 + loop.feed2 * (w_set - 100.0) + loop.kp2 * (loop.b2 * w_set - w3) + z2
        z1 += loop.ki1 * DT * (theta_set - theta)
        z2 += loop.ki2 * DT * (w_set - w3)
        commands[k, 0], commands[k, 1] = u1, u2
        for j in range(FINE):
            t = (k - warm_up) * DT + j * h
            for i in range(2):  # the elastic force is continuous when the stiffness jumps
                if t - h < spans[i].stiffness_jump_time <= t:
                    K[i] *= 1.0 + spans[i].stiffness_jump
                    x[3 + i] /= 1.0 + spans[i].stiffness_jump
            fifo[0, count % fifo.shape[1]], fifo[1, count % fifo.shape[1]] = u1, u2
            V1, gap[0] = amplified(drives[0], gap[0], delayed(fifo[0], count, drives[0].input_delay, h), t, h)
            V2, gap[1] = amplified(drives[1], gap[1], delayed(fifo[1], count, drives[1].input_delay, h), t, h)
            count += 1
            V1 += volts[k, 0]
            V2 += volts[k, 1]
            noise = torques[TORQUES * k + j * TORQUES // FINE]
            _rates(x, k1, m, web, shafts, spans, foreign, K, bristles, warmth, V1, V2, noise, t)
            _rates(
                ahead(x, k1, 0.5 * h, mid), k2, m, web, shafts, spans, foreign, K, bristles, warmth, V1, V2, noise, t + 0.5 * h
            )
            _rates(
                ahead(x, k2, 0.5 * h, mid), k3, m, web, shafts, spans, foreign, K, bristles, warmth, V1, V2, noise, t + 0.5 * h
            )
            _rates(ahead(x, k3, h, mid), k4, m, web, shafts, spans, foreign, K, bristles, warmth, V1, V2, noise, t + h)
            advance(x, k1, k2, k3, k4, h)
            T1, T2, _, a1, a2 = tensions(x, m, web, spans, foreign, K, t + h)
            loads = (a1 * T1, a2 * T2, m.r3 * (T1 + T2))
            for i in range(3):
                bristles[i] = bristle_step(shafts[i], bristles[i], x[i], loads[i], t + h, h)
            warmth += h * ((x[0] / 30.0) ** 2 - warmth) / 20.0
            lowest[0], lowest[1], lowest[2] = min(lowest[0], T1), min(lowest[1], T2), min(lowest[2], x[10])
            theta = (T1 - m.T_set) / m.dancer
            if foreign.dancer_damping > 0.0:
                omega = 2.0 * np.pi * 5.0
                pull = omega**2 * (theta - dancer) - 1.4 * omega * dancer_rate
                dancer_rate = (dancer_rate + h * pull) / (1.0 + h * foreign.dancer_damping * omega * abs(dancer_rate))
                dancer += h * dancer_rate
                theta = dancer
            elif foreign.dancer_stick > 0.0:
                dancer = theta if abs(theta - dancer) > foreign.dancer_stick else dancer
                theta = dancer
            for i in range(3):
                seen[i] = sense_step(sensors[i], memory[i], x[i], h)
            seen[3] = sense_step(sensors[3], memory[3], theta, h)
            seen[4] = sense_step(sensors[4], memory[4], x[11], h)
        if not (np.isfinite(T1) and np.isfinite(x[2])) or abs(x[2]) > 1e3:
            lowest[0] = -np.inf
            commands[k:], measured[k:] = 0.0, 0.0
            break
    return commands, measured, lowest


# ---- what a case draws -----------------------------------------------------------------------------------------------

NAME = "web-winding"
PLANT = WEB_WINDING
RANGES = Ranges(duration=90.0, radian=1.0, orders=6)
SAMPLES, WARM_UP = 2250, 100
INPUTS, OUTPUTS = ("V1", "V2"), ("w1", "w2", "w3", "theta", "r2")
SHAFTS, SPANS = ("unwind", "rewind", "pulley"), ("T1", "T2")
VOLTS = tuple(PLANT.disturbance[name] for name in INPUTS)  # V, deviation of the unlogged voltage
TORQUE_NOISE = (3.0e-5, 3.0e-5, 3.0e-6)  # N m
TIGHT = 0.02  # N, tape below this tension is slack
FOREIGN = tuple(name.replace("_", "-") for name in Foreign._fields)
#: Trial sizes of the foreign physics: well seen, far from breaking the tape.
TRIAL = dict(zip(FOREIGN, (1e-5, 1e-3, 2e-2, 0.03, 0.01, 1.0, 0.5, 0.05), strict=True))

PLACES = (
    {place: SHAFT for place in SHAFTS}
    | {place: ACTUATOR for place in INPUTS}
    | {place: SENSOR for place in OUTPUTS}
    | {place: SPAN for place in SPANS}
)
PLACES["unwind"] += ("eccentricity",)
PLACES["rewind"] += ("eccentricity", "air-entrainment")
PLACES["pulley"] += ("slip",)

#: Largest sizes that leave a machine that somebody would still run; by effect, or by effect and place.
CAPS = {
    "coulomb": 4e-3, "coulomb@pulley": 1e-3, "stribeck": 4e-3, "stribeck@pulley": 1e-3,
    "asymmetric-friction": 4e-3, "asymmetric-friction@pulley": 1e-3, "friction-jump": 4e-3, "friction-jump@pulley": 1e-3,
    "quadratic-friction": 1e-6, "quadratic-friction@pulley": 6e-8, "load-friction": 0.3, "load-friction@pulley": 0.15,
    "imbalance": 1e-3, "imbalance@pulley": 1e-4, "torque-ripple": 2e-3, "torque-ripple@pulley": 2e-4,
    "eccentricity": 5e-4, "slip": 0.5, "air-entrainment": 0.3,
    "offset": 0.5, "dead-zone": 0.5, "input-delay": 0.06, "heating": 0.3, "gear-backlash": 0.05,
    "sensor-lag": 0.15, "sensor-resonance": 0.03, "sensor-gain": 0.1, "sensor-nonlinearity": 1e-3,
    "sensor-nonlinearity@theta": 0.03, "sensor-nonlinearity@r2": 5.0, "sensor-bias": 5.0, "sensor-bias@r2": 2e-3,
    "quantisation": 3.0, "quantisation@r2": 2e-4, "backlash": 3.0, "backlash@r2": 5e-4,
    "nonlinear-elasticity": 0.8, "viscoelastic": 3.0, "periodic-tension": 5.0, "stiffness-jump": 2.0,
}  # fmt: skip


@record
class Setting:
    """One machine of its kind with its loop, its sensors and its unlogged noise, as drawn."""

    machine: Machine
    loop: Loop
    radii: tuple[float, float]
    pole: float
    share: float
    resolution: float
    names: tuple[str, ...]


def setting(random: np.random.Generator, minimal: bool) -> Setting:
    """A machine within the tolerances of its data sheet, part-used reels, and a loop that nobody tuned with care."""
    machine = Machine(**within_tolerance(PLANT, random))
    return Setting(
        machine,
        _loop(machine, random),
        (machine.r_full - random.uniform(0.0, 2.5e-3), machine.r_core + random.uniform(2e-4, 3.5e-3)),
        pole=float(np.exp(-DT / random.uniform(0.1, 1.0))),
        share=random.uniform(0.0, 0.5),
        resolution=random.uniform(0.1, 0.5),
        names=OUTPUTS[2:] if minimal else OUTPUTS,
    )


def with_loop(setting: Setting, random: np.random.Generator) -> Setting:
    """The same machine with another loop."""
    return replace(setting, loop=_loop(setting.machine, random))


def _loop(machine: Machine, random: np.random.Generator) -> Loop:
    """Two PI loops with weighted set-points and a feed-forward of speed."""
    kp1, ki1, kp2, ki2 = np.exp(random.uniform(np.log(0.6), np.log(1.5), 4)) * [-0.004, -0.015, 0.012, 0.04]
    b1, b2, feed = random.uniform(0.3, 0.9), random.uniform(0.3, 0.9), random.uniform(0.5, 0.9)
    hold = 100.0 * machine.kV * machine.r3 / 0.018  # V, of a reel half full
    slope = feed * hold / 100.0
    return Loop(kp1, ki1, b1, slope, hold - 0.5, kp2, ki2, b2, slope, hold + 0.3)


def programmes(setting: Setting, random: np.random.Generator) -> tuple[Programme, ...]:
    """Four records to learn from and one or two held out; about 55 rad/s in the mean, so that the tape lasts."""
    del setting
    N = SAMPLES

    def levels(count: int, low: float, high: float, rise: int) -> np.ndarray:
        return staircase(N, list(random.uniform(low, high, count)), rise)

    speeds = random.permutation([20.0, 45.0, 70.0, 100.0, 130.0]) * random.uniform(0.9, 1.0)
    stop = staircase(N, [0.0, *speeds[:3], 0.0, *speeds[3:], 8.0, 0.0, 35.0], 50)
    period = random.uniform(15.0, 40.0)
    t = DT * np.arange(N)
    made = [
        Programme("staircase", np.column_stack([stop, levels(6, -4.0, 4.0, 25)])),
        Programme("tension", np.column_stack([levels(2, 50.0, 75.0, 75), levels(15, -8.0, 8.0, int(random.integers(5, 25)))])),
        Programme("low-speed", np.column_stack([levels(60, 3.0, 60.0, 20), levels(40, -4.0, 4.0, 10)])),
        Programme(
            "ramps",
            np.column_stack(
                [
                    staircase(N, [60.0, 110.0, 0.0, 0.0, 90.0, 20.0, random.uniform(60.0, 100.0)], N // 8),
                    random.uniform(4.0, 7.0) * np.sin(2 * np.pi * t / period + random.uniform(0.0, 6.0)),
                ]
            ),
        ),
        Programme("mixed (held out)", np.column_stack([levels(18, 5.0, 105.0, 40), levels(25, -6.0, 6.0, 15)]), held_out=True),
        Programme(
            "triangle (held out)",
            np.column_stack(
                [
                    55.0 + 40.0 * np.sin(2 * np.pi * t / random.uniform(20.0, 45.0)),
                    levels(9, -6.0, 6.0, 200),
                ]
            ),
            held_out=True,
        ),
    ]
    return tuple(made[: 5 + int(random.integers(2))])


def follow(setting: Setting, name: str, references: Mapping[str, np.ndarray]) -> Programme:
    """The programme that asks for these set-points of speed and dancer; voltages alone would not hold the tape tight."""
    del setting
    return asked(name, references, ("w3_set", "theta_set"))


def resolutions(setting: Setting) -> dict[str, float]:
    """The step to which every sensor rounds, whatever is hidden."""
    return {name: setting.resolution * PLANT.noise[name] for name in OUTPUTS}


def outcome(setting: Setting, programme: Programme, hidden: tuple[Hidden, ...], seed: np.random.SeedSequence) -> Outcome:
    """One record; its noise and its phases come from the seed alone, whatever is hidden."""
    draws, phases = (np.random.default_rng(s) for s in seed.spawn(2))
    total, m = len(programme.signals) + WARM_UP, setting.machine
    set_points = np.vstack([np.repeat(programme.signals[:1], WARM_UP, axis=0), programme.signals])
    volts = coloured(draws, (total, 2), setting.pole, setting.share) * VOLTS
    torques = coloured(draws, (TORQUES * total, 3), setting.pole ** (1 / TORQUES), setting.share) * TORQUE_NOISE
    sensors = tuple(
        Sensor(PLANT.noise[name], step)._replace(**fields_of(Sensor, hidden, name, phases))
        for name, step in resolutions(setting).items()
    )
    start, hold = _at_work(m, setting.radii, programme.signals[0, 0])
    commands, measured, lowest = run(
        m, web_of(hidden, phases), tuple(Shaft(**fields_of(Shaft, hidden, place, phases)) for place in SHAFTS),
        tuple(Drive(**fields_of(Drive, hidden, place, phases)) for place in INPUTS), sensors,
        tuple(Span(**fields_of(Span, hidden, place, phases)) for place in SPANS), Foreign(**foreign_fields(Foreign, hidden)),
        setting.loop, set_points, volts, torques, draws.standard_normal((total, 5)), start, hold, WARM_UP,
    )  # fmt: skip
    kept = slice(WARM_UP, None)
    values = dict(zip((*INPUTS, *OUTPUTS), np.column_stack([commands, measured])[kept].T, strict=True))
    values |= {"w3_set": programme.signals[:, 0], "theta_set": programme.signals[:, 1]}
    experiment = logged(PLANT, programme.name, values, (*INPUTS, *setting.names), {"w3_set": "w3", "theta_set": "theta"})
    fault = "the tape went slack" * bool(lowest[:2].min() < TIGHT) or "the reel ran empty" * bool(lowest[2] < 0.0105)
    return Outcome(experiment, fault)


def web_of(hidden: tuple[Hidden, ...], phases: np.random.Generator) -> Web:
    """What is hidden where web and rolls meet: the one part that lies at several places."""
    own = {"eccentricity@unwind": "eccentricity1", "eccentricity@rewind": "eccentricity2"}
    values = fields_of(Web, (), "", phases)
    for h in hidden:
        name = own.get(h.key, h.effect.replace("-", "_"))
        if h.catalogued and name in Web._fields:
            values[name] = h.size
    return Web(**values)


def _at_work(m: Machine, radii: tuple[float, float], w3: float) -> tuple[np.ndarray, np.ndarray]:
    """States and voltages at speed w3 with the rest tension in both spans."""
    r1, r2 = radii
    w1, w2 = w3 * m.r3 / r1, w3 * m.r3 / r2
    x = m.T_set / m.kE
    ohm = m.Ra / m.kT
    hold = np.array([ohm * (m.B1 * w1 - r1 * m.T_set) + m.kV * w1, ohm * (m.B2 * w2 + r2 * m.T_set) + m.kV * w2])
    return np.array([w1, w2, w3, x, x, 0.0, 0.0, 0.0, 0.0, 0.0, r1, r2]), hold
