"""Effects on how fast a reel grows or shrinks: the thickness of a layer on it.

law(e, v) -> relative change of the layer's thickness, at surface speed v [m/s].
"""

from collections.abc import Callable
from typing import Any

from workbench.physics.effects.effect import Domain, Effect, EffectParameter, Named, Port
from workbench.records import record


def _air_entrainment(e, v):
    return e.share * v / e.speed


AIR_ENTRAINMENT = Effect(
    "air-entrainment",
    "winding",
    (
        EffectParameter("share", "1", low=0.0, high=10.0),
        # only share/speed acts: the speed says at which speed the share is meant, a search leaves it alone
        EffectParameter("speed", "m/s", low=1e-3, high=1e3, default=1.0, shape=True),
    ),
    "Air is wound in at {place}: the faster it runs, the thicker each layer, and the reel grows faster than the tape is thick.",
    "The same length wound at two speeds: a wrong tape thickness gives the same radius both times.",
    "thickness = s * (1 + share * v / speed)",
    _air_entrainment,
    Domain.SPEED,
)

EFFECTS = (AIR_ENTRAINMENT,)


@record
class Winding(Port):
    """at.<place>.thickness(s, v): port for the thickness of the layers that a reel winds up.

    >>> port = Winding("rewind")
    >>> [name for name, effect in EFFECTS.items() if effect.family == port.family]
    ['air-entrainment']
    """

    family = "winding"
    symbols = "thickness: of a layer on the reel; s: that of the tape; v: surface speed"
    law = "law(e, v) -> relative change of the thickness"

    def verbs(self, effects, context) -> dict:
        """thickness(s, v): thickness of a layer of tape s [m] wound at surface speed v [m/s], as the effects change it."""
        del context

        def thickness(s, v):
            return s * (1.0 + sum((effect.law(e, v) for effect, e in effects), start=0.0))

        return {"thickness": thickness}

    def beyond(self, effect: Effect, e: Named, some: Callable[[], Any]) -> list:
        """The relative change."""
        return [effect.law(e, some())]
