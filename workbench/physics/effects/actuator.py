"""Effects between the logged command of an input and what acts on the machine.

law(e, u, t) -> u: a static map of the held command. The input delay is no map: it shifts the hold in time, and the
stepper splits its steps where a shifted hold changes, so that any delay, whole samples or not, is exact.
"""

import numpy as np

from workbench.physics.effects.effect import Effect, EffectParameter
from workbench.records import record


def _saturation(e, u, t):
    del t
    limit = e.limit + 1e30 * (e.limit <= 0.0)  # 0 is no limit
    return np.minimum(np.maximum(u, -limit), limit)


def _input_delay(e, u, t):
    del e, t
    return u  # the stepper shifts the hold


SATURATION = Effect(
    "saturation",
    "actuator",
    (EffectParameter("limit", "unit of the input", low=0.0),),
    "The amplifier of {place} saturates: it gives no more than its limit, whatever is commanded. A limit of 0 is none.",
    "Larger steps of the command: a drift of the resistance acts at every level.",
    _saturation,
    regular=False,
    grid=(0.7, 0.8, 0.9, 0.95, 0.99),  # fractions of the largest logged command
)
INPUT_DELAY = Effect(
    "input-delay",
    "actuator",
    (EffectParameter("time", "s", low=0.0),),
    "The command of {place} arrives late: a dead time between the logged value and the machine.",
    "A fast binary command and a measured speed: a lag of one sensor shows in that sensor only.",
    _input_delay,
    regular=False,
    grid=(0.25, 0.5, 1.0, 2.0),  # sample times
)

EFFECTS = (SATURATION, INPUT_DELAY)


@record
class Actuator:
    """Port for an input; every input of a plant has one, its place is the channel's name."""

    place: str
    family = "actuator"

    def drive(self, effects, u, t):
        """The input that acts on the machine, before any delay."""
        for effect, e in effects:
            u = effect.law(e, u, t)
        return u
