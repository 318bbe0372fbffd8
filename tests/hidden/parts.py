"""What machines are made of here: dry friction, amplifiers, sensors, coloured noise.

Dry friction is that of [1], a bristle of deflection a (in units of its break-away deflection) instead of a smoothed sign:

    torque = -(g(0) a + d(w) a'),   a' = w/b (1 - a sgn(w) g(0)/g(w)),   g(w) = level + stribeck exp(-(w/speed)^2) + load friction

At steady speed a = sgn(w) g(w)/g(0), so the torque is -g(w) sgn(w). [1] C. Canudas de Wit et al., "A new model for control of
systems with friction", IEEE Transactions on Automatic Control 40(3), 1995.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

GRAVITY = 9.81  # m/s^2
ARM = 0.010  # m, where the mass of an imbalance sits: it adds a little inertia as well


class Shaft(NamedTuple):
    """Missing physics of one shaft (N m, rad) or slide (N, m): sizes 0 are neutral."""

    coulomb: float = 0.0
    stribeck: float = 0.0
    stribeck_speed: float = 1.0
    asymmetric_friction: float = 0.0  # forward
    asymmetric_friction_backward: float = 0.0
    quadratic_friction: float = 0.0
    load_friction: float = 0.0
    imbalance: float = 0.0
    imbalance_phase: float = 0.0
    torque_ripple: float = 0.0
    torque_ripple_order: float = 6.0
    torque_ripple_phase: float = 0.0
    friction_jump: float = 0.0
    friction_jump_time: float = 1e9
    breakaway: float = 0.02  # deflection at which a bristle lets go [rad or m]


class Drive(NamedTuple):
    """Missing physics between a logged command and the machine; times in s, the rest in the command's unit."""

    offset: float = 0.0
    dead_zone: float = 0.0
    saturation: float = 0.0  # 0 is no limit
    input_delay: float = 0.0
    heating: float = 0.0
    heating_time: float = 30.0
    gear_backlash: float = 0.0  # impulse lost from flank to flank [unit of the command x s]


class Sensor(NamedTuple):
    """Missing physics of one sensor; deviation of its noise and its resolution, which every sensor has."""

    noise: float = 0.0
    resolution: float = 0.0
    backlash: float = 0.0
    sensor_lag: float = 0.0
    sensor_resonance: float = 0.0  # 1/natural frequency [s]
    sensor_resonance_damping: float = 0.3
    sensor_nonlinearity: float = 0.0
    sensor_gain: float = 0.0
    sensor_bias: float = 0.0
    quantisation: float = 0.0


SENSOR_MEMORY = 6  # play, lag: input and output, resonance: input, output and its rate
LONGEST_DELAY = 0.25  # s, what the buffers hold


@njit(cache=True)
def ahead(x, rate, h, out):
    """out = x + h rate, without a new array: the runs are long."""
    for i in range(len(x)):
        out[i] = x[i] + h * rate[i]
    return out


@njit(cache=True)
def advance(x, k1, k2, k3, k4, h):
    """x += h (k1 + 2 k2 + 2 k3 + k4)/6 in place: the end of a Runge-Kutta step."""
    for i in range(len(x)):
        x[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])


@njit(cache=True)
def dry_level(shaft, w, load, t):
    """g(w): the dry friction of steady motion at speed w [N m], not below 0."""
    level = shaft.coulomb + shaft.load_friction * abs(load)
    if shaft.stribeck != 0.0:
        level += shaft.stribeck * np.exp(-((w / shaft.stribeck_speed) ** 2))
    level += shaft.asymmetric_friction if w >= 0.0 else shaft.asymmetric_friction_backward
    if t >= shaft.friction_jump_time:
        level += shaft.friction_jump
    return max(level, 0.0)


@njit(cache=True)
def level_at_rest(shaft, load, t):
    """g(0): the larger one of the two directions, so that a shaft that rubs in one of them only has bristles too."""
    return max(dry_level(shaft, 0.0, load, t), dry_level(shaft, -1e-12, load, t))


@njit(cache=True)
def bristle_step(shaft, a, w, load, t, h):
    """The bristle's deflection a step h later at constant speed: exact, however fast the shaft turns."""
    rest = level_at_rest(shaft, load, t)
    if rest <= 0.0 or w == 0.0:
        return a
    share = max(dry_level(shaft, w, load, t) / rest, 1e-6)
    steady = np.sign(w) * share
    return steady + (a - steady) * np.exp(-abs(w) * h / (shaft.breakaway * share))


@njit(cache=True)
def shaft_torque(shaft, a, w, angle, load, inertia, t):
    """Torque of all missing physics of a shaft [N m], positive in the direction of positive speed."""
    torque = -shaft.quadratic_friction * w * abs(w)
    rest = level_at_rest(shaft, load, t)
    if rest > 0.0:
        share = max(dry_level(shaft, w, load, t) / rest, 1e-6)
        # held within a step: a bristle that a sudden fall of g(w) leaves far out must not tear at the shaft. Its own damping
        # belongs to the creep before it lets go: at speed it would kick a shaft on which friction sets in
        sliding = w * min(max(1.0 - a * np.sign(w) / share, 0.0), 2.0) * np.exp(-((w / (50.0 * shaft.breakaway)) ** 2))
        # damped like a resonance of 0.3, so that a bristle at rest does not ring
        torque -= rest * a + 0.6 * np.sqrt(rest * inertia / shaft.breakaway) * sliding
    if shaft.imbalance != 0.0:
        torque += shaft.imbalance * np.cos(angle + shaft.imbalance_phase)
    if shaft.torque_ripple != 0.0:
        torque += shaft.torque_ripple * np.cos(shaft.torque_ripple_order * angle + shaft.torque_ripple_phase)
    return torque


@njit(cache=True)
def imbalance_inertia(shaft):
    """m e^2 of the mass m that pulls with m g e."""
    return abs(shaft.imbalance) / GRAVITY * ARM


@njit(cache=True)
def delayed(fifo, count, delay, h):
    """Mean of the command over the present step, `delay` late; a ring of steps, `count` the present one."""
    whole = int(delay / h)
    part = delay / h - whole
    length = len(fifo)
    return (1.0 - part) * fifo[(count - whole) % length] + part * fifo[(count - whole - 1) % length]


@njit(cache=True)
def amplified(drive, gap, u, t, h):
    """(what acts on the machine, the gear's place in its gap -1 .. 1 afterwards) for a delayed command u."""
    u += drive.offset
    if drive.dead_zone > 0.0:
        u = np.sign(u) * max(abs(u) - drive.dead_zone, 0.0)
    if drive.saturation > 0.0:
        u = min(max(u, -drive.saturation), drive.saturation)
    if drive.heating != 0.0 and t > 0.0:
        u *= 1.0 - drive.heating * (1.0 - np.exp(-t / drive.heating_time))
    if drive.gear_backlash > 0.0:
        before = gap
        gap = min(max(gap + 2.0 * u * h / drive.gear_backlash, -1.0), 1.0)
        u -= 0.5 * drive.gear_backlash * (gap - before) / h  # nothing is passed on until the flanks touch
    return u, gap


@njit(cache=True)
def sense_start(memory, z):
    """The sensor has long seen z."""
    memory[:] = z
    memory[5] = 0.0


@njit(cache=True)
def sense_step(sensor, memory, z, h):
    """Play, lag and resonance a step h later, by the trapezoidal rule: their delay of a ramp is exact."""
    if sensor.backlash > 0.0:
        z = memory[0] = min(max(memory[0], z - sensor.backlash), z + sensor.backlash)
    if sensor.sensor_lag > 0.0:
        k = 0.5 * h / sensor.sensor_lag
        before = memory[1]
        memory[1] = z
        z = memory[2] = ((1.0 - k) * memory[2] + k * (before + z)) / (1.0 + k)
    if sensor.sensor_resonance > 0.0:
        omega, zeta = 1.0 / sensor.sensor_resonance, sensor.sensor_resonance_damping
        k = 0.5 * h
        before, y, rate = memory[3], memory[4], memory[5]
        memory[3] = z
        # y+ = y + k (rate + rate+),  rate+ = rate + k (q + q+),  q = omega^2 (z - y) - 2 zeta omega rate
        q = omega**2 * (before - y) - 2.0 * zeta * omega * rate
        known = rate + k * (q + omega**2 * (z - y - k * rate))
        memory[5] = known / (1.0 + 2.0 * zeta * omega * k + (omega * k) ** 2)
        z = memory[4] = y + k * (rate + memory[5])
    return z


@njit(cache=True)
def read(sensor, z, draw):
    """The logged value of a sensor whose moving parts stand at z; draw is standard normal."""
    y = (1.0 + sensor.sensor_gain) * (z + sensor.sensor_nonlinearity * z * z) + sensor.sensor_bias + sensor.noise * draw
    for step in (sensor.resolution, sensor.quantisation):
        if step > 0.0:
            y = step * np.round(y / step)
    return y


def coloured(random: np.random.Generator, shape: tuple[int, int], pole: float, share: float) -> np.ndarray:
    """sqrt(1 - share) white + sqrt(share) AR(1), a+ = pole a + sqrt(1 - pole^2) white: (N, n) of deviation 1.

    Its spectrum is 1 - share + share (1 - pole^2)/|1 - pole exp(-i omega)|^2.
    """
    from scipy.signal import lfilter

    white, drive = random.standard_normal((2, *shape))
    first = random.standard_normal((1, shape[1]))
    moving, _ = lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], drive, axis=0, zi=pole * first)
    return np.sqrt(1.0 - share) * white + np.sqrt(share) * moving
