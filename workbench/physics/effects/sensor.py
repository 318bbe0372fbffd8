"""Effects between a physical quantity and its logged value.

An effect with memory keeps one number m per sensor:  m+ = law(e, m, z0, z1, h)  and its output is m, where z0, z1 are its
input at the two ends of an integrator step of length h [s]. Both are exact for an input that is linear within the step.
"""

import numpy as np

from workbench.physics.effects.effect import Effect, EffectParameter
from workbench.records import record


def _lag(e, m, z0, z1, h):
    # time z' = input - z, solved exactly for a linear input; at time 0 the exponential is 0 and the output is z1
    ratio = h / np.maximum(e.time, 1e-12)
    fade = np.exp(-np.minimum(ratio, 700.0)) * (e.time > 0.0)
    slope = (z1 - z0) * (e.time / np.maximum(h, 1e-12)) * (1.0 - fade) * (e.time > 0.0)
    return z1 + (m - z0) * fade - slope


def _backlash(e, m, z0, z1, h):
    del z0, h
    return np.maximum(z1 - e.half_width, np.minimum(z1 + e.half_width, m))


SENSOR_LAG = Effect(
    "sensor-lag",
    "sensor",
    (EffectParameter("time", "s", low=0.0),),
    "The sensor of {place} is slow: it follows the quantity with a first-order lag.",
    "Only this channel is late, and in proportion to its rate of change; backlash does not scale with the rate.",
    _lag,
    regular=False,
    grid=(0.25, 0.5, 1.0, 2.0),  # sample times
)
BACKLASH = Effect(
    "backlash",
    "sensor",
    (EffectParameter("half_width", "unit of the output", low=0.0),),
    "Play in the linkage of the sensor of {place}: after a reversal it stands still until the play is taken up.",
    "A triangle at two rates: a lag grows with the rate, play does not.",
    _backlash,
    regular=False,
    grid=(1.0, 3.0, 10.0),  # standard deviations of the channel's noise
)

EFFECTS = (SENSOR_LAG, BACKLASH)


@record
class Sensor:
    """Port for an output; every output of a plant has one, its place is the channel's name. One memory per effect."""

    place: str
    family = "sensor"

    def remember(self, effects, memory, z0, z1, h) -> list:
        """The memories after a step: each effect's input is the output of the one before it."""
        after = []
        for (effect, e), m in zip(effects, memory, strict=True):
            new = effect.law(e, m, z0, z1, h)
            after.append(new)
            z0, z1 = m, new
        return after
