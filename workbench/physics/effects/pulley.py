"""Effects between web and guide pulley.

law(e) -> creep [m/s per N]: the web runs faster than the pulley surface by creep times the tension difference.
"""

from collections.abc import Callable
from typing import Any

from workbench.physics.effects.effect import Domain, Effect, EffectParameter, Named, Port
from workbench.records import record


def _slip(e):
    return e.creep


SLIP = Effect(
    "slip",
    "pulley",
    (EffectParameter("creep", "m/s/N", low=0.0),),
    "The web slips on {place}: it runs ahead of the surface in proportion to the difference of the tensions.",
    "Steps of the tension difference at constant speed: a sensor lag scales with the rate, slip with the difference.",
    "slip = creep * (T2 - T1)",
    _slip,
    Domain.LOAD,
)

EFFECTS = (SLIP,)


@record
class Pulley(Port):
    """at.<place>.creep() (T2 - T1): port for the contact between a web and a pulley.

    >>> port = Pulley("guide")
    >>> [name for name, effect in EFFECTS.items() if effect.family == port.family]
    ['slip']
    """

    family = "pulley"
    symbols = "slip: by how much the web runs faster than the surface; T1, T2: tensions before and behind the pulley"
    law = "law(e) -> creep"

    def verbs(self, effects, context) -> dict:
        """creep(): web speed relative to the surface per newton of tension difference [m/s/N]."""
        del context

        def creep():
            return sum((effect.law(e) for effect, e in effects), start=0.0)

        return {"creep": creep}

    def beyond(self, effect: Effect, e: Named, some: Callable[[], Any]) -> list:
        """The creep."""
        del some
        return [effect.law(e)]
