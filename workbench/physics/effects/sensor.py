"""Effects between a physical quantity and its logged value, in the order in which they act.

Those with memory come first. They keep their output m and what else they need from step to step:
m+ = law(e, m, z0, z1, h), where z0, z1 are the input at the two ends of an integrator step of length h [s]. Lag and resonance
also see the middle of the step, and are exact for an input that is a parabola within it: on a straight line a resonance faster
than the step is seen too slow, for what the line leaves out, of the order of damping * time * h, is as large as time^2.
Then follow static maps of the reading, law(e, z) -> reading; the noise of the record is added before the last of them, the
converter, so that a quantised record holds whole steps.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from workbench.physics.effects.effect import FOREVER, Domain, Effect, EffectParameter, GridUnit, Named, Port
from workbench.records import record


def _backlash(e, m, z0, z1, h):
    del z0, h
    return [np.maximum(z1 - e.half_width, np.minimum(z1 + e.half_width, m[0]))]


def _parabola(time, z0, zm, z1, h):
    """End, mean slope, bend (half the change of slope) and second derivative of the parabola through a step.

    A jump in no time has not yet been felt, unless the effect is off (time 0). In a step far shorter than the effect's own time
    a bend does nothing but lose digits: the step is straight.
    """
    per_second = h / (h * h + 1e-24)
    slope = (z1 - z0) * per_second
    long = h**4 / (h**4 + (1e-4 * time) ** 4 + 1e-48)
    bend = long * (2.0 * (z0 + z1) - 4.0 * zm) * per_second
    return z1 - (time > 0.0) * (z1 - z0 - slope * h), slope, bend, 2.0 * bend * per_second


def _fade(exponent, on):
    return np.exp(-np.minimum(exponent, 700.0)) * on


def _lag(e, m, z0, zm, z1, h):
    # time y' = z - y: the parabola z - time z' + time^2 z'' it will follow, and the distance from it that fades; at time 0 z1
    end, slope, bend, curve = _parabola(e.time, z0, zm, z1, h)
    fade = _fade(h / np.maximum(e.time, 1e-12), e.time > 0.0)
    bowed = e.time**2 * curve
    first, last = z0 - e.time * (slope - bend) + bowed, end - e.time * (slope + bend) + bowed
    return [last + (m[0] - first) * fade]


def _resonance(e, m, z0, zm, z1, h):
    # time^2 y'' + 2 damping time y' + y = z, with the memories y and time y'; at time 0 the output is z1. It will follow the
    # parabola z - 2 damping time z' + (4 damping^2 - 1) time^2 z''
    on = e.time > 0.0
    end, slope, bend, curve = _parabola(e.time, z0, zm, z1, h)
    turned = np.minimum(h / np.maximum(e.time, 1e-12), 1e4)  # later it has faded, and the angle would lose its digits
    fade = _fade(e.damping * turned, on)
    root = np.sqrt(1.0 - e.damping**2)
    cos, sin = np.cos(root * turned), np.sin(root * turned)
    twice, bowed = 2.0 * e.damping, e.time**2 * curve
    speeds = [e.time * (slope - bend) - twice * bowed, e.time * (slope + bend) - twice * bowed]
    first = z0 - twice * e.time * (slope - bend) + (twice**2 - 1.0) * bowed
    last = end - twice * e.time * (slope + bend) + (twice**2 - 1.0) * bowed
    off, speed = m[0] - first, m[1] - speeds[0]
    return [
        last + fade * (off * cos + (speed + e.damping * off) / root * sin),
        speeds[1] + fade * (speed * cos - (off + e.damping * speed) / root * sin),
    ]


def _nonlinearity(e, z):
    return z + e.curvature * (z - e.centre) ** 2


def _gain(e, z):
    return z * (1.0 + e.error)


def _bias(e, z):
    return z + e.level


def _quantisation(e, z):
    on = e.step > 0.0
    step = e.step + 1.0 - on  # any step will do where there is none
    return on * (step * np.floor(z / step + 0.5)) + (1.0 - on) * z


BACKLASH = Effect(
    "backlash",
    "sensor",
    (EffectParameter("half_width", "unit of the output", low=0.0),),
    "Play in the linkage of the sensor of {place}: after a reversal it stands still until the play is taken up.",
    "A triangle at two rates: a lag grows with the rate, play does not.",
    "reading = max(z - half_width, min(z + half_width, before))",
    _backlash,
    Domain.LEVEL,
    regular=False,
    grid=(1.0, 3.0, 10.0),
    grid_unit=GridUnit.NOISE,
    memories=1,
)
SENSOR_LAG = Effect(
    "sensor-lag",
    "sensor",
    (EffectParameter("time", "s", low=0.0),),
    "The sensor of {place} is slow: it follows the quantity with a first-order lag.",
    "Only this channel is late, and in proportion to its rate of change; backlash does not scale with the rate.",
    "time * reading' = z - reading",
    _lag,
    Domain.SHIFT,
    regular=False,
    grid=(0.25, 0.5, 1.0, 2.0),
    grid_unit=GridUnit.SAMPLE,
    memories=1,
    middle=True,
)
SENSOR_RESONANCE = Effect(
    "sensor-resonance",
    "sensor",
    (
        EffectParameter("time", "s", low=0.0),
        EffectParameter("damping", "1", low=0.02, high=0.95, default=0.3, shape=True, grid=(0.05, 0.1, 0.3, 0.7)),
    ),
    "The sensor of {place} swings: it overshoots and rings at a frequency of its own, 1/time in rad/s.",
    "Excitation near that frequency: a lag only falls off there, a resonance rises first.",
    "time^2 * reading'' + 2 * damping * time * reading' + reading = z",
    _resonance,
    Domain.SHIFT,
    regular=False,
    grid=(0.25, 0.5, 1.0, 2.0),
    grid_unit=GridUnit.SAMPLE,
    memories=2,
    middle=True,
)
SENSOR_NONLINEARITY = Effect(
    "sensor-nonlinearity",
    "sensor",
    (
        EffectParameter("curvature", "1/(unit of the output)"),
        # only moves gain and bias, which have effects of their own: a search leaves it alone
        EffectParameter("centre", "unit of the output", shape=True),
    ),
    "The characteristic of the sensor of {place} is bent: its gain is not the same at every level.",
    "A series of known loads at rest: a web that stiffens with tension changes the oscillation, not the reading at rest.",
    "reading = z + curvature * (z - centre)^2",
    _nonlinearity,
    Domain.LEVEL,
)
SENSOR_GAIN = Effect(
    "sensor-gain",
    "sensor",
    (EffectParameter("error", "1", low=-0.9, high=10.0),),
    "The sensor of {place} is wrongly scaled: its reading is off by the same share at every level.",
    "A known quantity from outside (a weight, a tape measure, a hand tachometer): parameters of the machine can absorb a gain.",
    "reading = z * (1 + error)",
    _gain,
    Domain.LEVEL,
)
SENSOR_BIAS = Effect(
    "sensor-bias",
    "sensor",
    (EffectParameter("level", "unit of the output"),),
    "The sensor of {place} has a wrong zero: its reading is off by the same amount at every level.",
    "The reading with no load or at a stop: an offset of an amplifier moves the machine, a bias only the reading.",
    "reading = z + level",
    _bias,
    Domain.LEVEL,
)
QUANTISATION = Effect(
    "quantisation",
    "sensor",
    (EffectParameter("step", "unit of the output", low=0.0),),
    "The converter or encoder of {place} is coarse: its reading moves in steps.",
    "The list of values that occur: noise takes any value, a converter only whole steps.",
    "reading = step * floor(z / step + 1 / 2)",
    _quantisation,
    Domain.LEVEL,
    regular=False,
    grid=(1.0, 3.0, 10.0),
    grid_unit=GridUnit.NOISE,
)

EFFECTS = (BACKLASH, SENSOR_LAG, SENSOR_RESONANCE, SENSOR_NONLINEARITY, SENSOR_GAIN, SENSOR_BIAS, QUANTISATION)


def _stepped(effect: Effect, e: Named, m, z0, zm, z1, h) -> list:
    return effect.law(e, m, z0, zm, z1, h) if effect.middle else effect.law(e, m, z0, z1, h)


@record
class Sensor(Port):
    """Port for an output; every output of a plant has one, its place is the channel's name."""

    unit: str
    family = "sensor"
    symbols = "z: what there is; reading: what is logged; before: the reading just before"
    law = (
        "law(e, z) -> reading, or with memories=n law(e, m, z0, z1, h) -> n numbers, its output first; "
        "with middle=True law(e, m, z0, zm, z1, h)"
    )
    memories = np.inf

    def fitted(self, parameter: EffectParameter) -> EffectParameter:
        """The parameter in the output's own unit."""
        return replace(parameter, unit=parameter.unit.replace("unit of the output", self.unit))

    def remember(self, effects, memory, z0, zm, z1, h) -> list:
        """The memories after a step in which the quantity went from z0 over zm to z1; each effect follows the one before it."""
        after = []
        moving = [(effect, e) for effect, e in effects if effect.memories]
        for i, (effect, e) in enumerate(moving):
            m = memory[len(after) : len(after) + effect.memories]
            new = _stepped(effect, e, m, z0, zm, z1, h)
            after += new
            if i + 1 < len(moving):
                quarter = 0.375 * z0 + 0.75 * zm - 0.125 * z1  # of the parabola: the middle of the first half
                z0, zm, z1 = m[0], _stepped(effect, e, m, z0, quarter, zm, 0.5 * h)[0], new[0]
        return after

    def settle(self, effects, z) -> list:
        """The memories after the quantity has stood at z for ever."""
        kept = sum(effect.memories for effect, _ in effects)
        return self.remember(effects, [z] * kept, z, z, z, FOREVER)

    def read(self, effects, memory, noise):
        """The logged value: what the last effect with memory shows, through the static maps and with its noise."""
        moving = [effect for effect, _ in effects if effect.memories]
        z = memory[len(memory) - moving[-1].memories]
        *maps, (converter, e) = [(effect, e) for effect, e in effects if not effect.memories]
        for effect, sizes in maps:
            z = effect.law(sizes, z)
        return converter.law(e, z + noise)

    def beyond(self, effect: Effect, e: Named, some: Callable[[], Any]) -> list:
        """By how much its output differs from its input."""
        z = some()
        if not effect.memories:
            return [effect.law(e, z) - z]
        kept = _stepped(effect, e, [some() for _ in range(effect.memories)], some(), some(), z, 0.01)
        if len(kept) != effect.memories:
            raise ValueError(f"it keeps {len(kept)} numbers, memories={effect.memories}")
        return [kept[0] - z]
