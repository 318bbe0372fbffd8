"""Effects on the surface of a reel or wheel: a deviation of its radius [m] that turns with it.

law(e, reel) -> (deviation [m], its rate of change [m/s]); `reel` has .angle [rad] and .speed [rad/s].
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from workbench.physics.effects.effect import Domain, Effect, EffectParameter, Named, Port
from workbench.records import record


def _eccentricity(e, reel):
    cos, sin = np.cos(reel.angle), np.sin(reel.angle)
    return e.cosine * cos + e.sine * sin, reel.speed * (e.sine * cos - e.cosine * sin)


ECCENTRICITY = Effect(
    "eccentricity",
    "reel",
    (EffectParameter("cosine", "m"), EffectParameter("sine", "m")),
    "The reel at {place} runs out of round: its radius changes once per turn.",
    "Two speeds: the disturbance of an eccentric reel grows with speed, that of an imbalance does not.",
    "deviation = cosine * cos(phi) + sine * sin(phi)",
    _eccentricity,
    Domain.ANGLE,
    phase=True,
)

EFFECTS = (ECCENTRICITY,)


@record
class Reel(Port):
    """r = r0 + at.<place>.runout().radius: port for the radius of a reel that turns with the state `speed`.

    >>> port = Reel("unwind", speed="w1")
    >>> [name for name, effect in EFFECTS.items() if effect.family == port.family]
    ['eccentricity']
    """

    speed: str
    family = "reel"
    symbols = "deviation: of the radius, positive outwards; phi: angle turned since the start of the record"
    law = "law(e, reel) -> (deviation, its rate of change); reel has .angle, .speed"

    def verbs(self, effects, context) -> dict:
        """runout() -> deviation of the radius with .radius [m] and .rate [m/s]."""
        reel = Named({"speed": context.x[self.speed], "angle": context.angle[self.place]})

        def runout():
            parts = [effect.law(e, reel) for effect, e in effects]
            return Named({"radius": sum(a for a, _ in parts), "rate": sum(b for _, b in parts)})

        return {"runout": runout}

    def beyond(self, effect: Effect, e: Named, some: Callable[[], Any]) -> list:
        """The deviation and its rate of change."""
        deviation, rate = effect.law(e, Named({"angle": some(), "speed": some()}))
        return [deviation, rate]
