"""Effects of a spring that is not linear: what they add to its push by its stretch.

law(e, spring) -> push [N], positive in the direction of positive stretch: what pulls back is negative. `spring` has .stretch [m].

Parameters are written in N and m. Of a spring that is twisted, or in other units, the port says so: see `Spring`.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from workbench.physics.effects.effect import Domain, Effect, EffectParameter, Named, Port
from workbench.records import record


def _cubic_spring(e, spring):
    return -e.cubic * spring.stretch**3


def _bent_spring(e, spring):
    return -e.square * spring.stretch**2


CUBIC_SPRING = Effect(
    "cubic-spring",
    "spring",
    (EffectParameter("cubic", "N/m^3"),),
    "The spring at {place} gets stiffer the further it is stretched, or softer where the number is negative, both ways alike.",
    "Small and large motion near the resonance: it moves with the amplitude; a bent sensor leaves the resonance where it is.",
    "push = -cubic * s^3",
    _cubic_spring,
    Domain.STRETCH,
)
BENT_SPRING = Effect(
    "bent-spring",
    "spring",
    (EffectParameter("square", "N/m^2"),),
    "The spring at {place} is stiffer one way than the other: its stiffness changes as it is stretched.",
    "Motion about two places: the resonance is higher at one of them; an offset or a bias moves the place alone.",
    "push = -square * s^2",
    _bent_spring,
    Domain.STRETCH,
)

EFFECTS = (CUBIC_SPRING, BENT_SPRING)


@record
class Spring(Port):
    """m v' = .. - k s + at.<place>.push(s): port for a spring of stretch s.

    force, stretch: their units where they are no N and m, as "N m" and "rad" of a spring that is twisted.

        >>> port = Spring("belt", force="N m", stretch="rad")
        >>> [name for name, effect in EFFECTS.items() if effect.family == port.family]
        ['cubic-spring', 'bent-spring']
    """

    force: str = "N"
    stretch: str = "m"
    family = "spring"
    symbols = "push: force or torque, positive in the direction of positive stretch; s: stretch or twist"
    law = "law(e, spring) -> push; spring has .stretch"

    def fitted(self, parameter: EffectParameter) -> EffectParameter:
        """The parameter in the units of the spring."""
        own = {f"N/m^{n}": f"{self.force}/{self.stretch}^{n}" for n in (2, 3)}
        return replace(parameter, unit=own.get(parameter.unit, parameter.unit))

    def verbs(self, effects, context) -> dict:
        """push(stretch): the sum of all effects' forces or torques."""
        del context

        def push(stretch):
            return sum((effect.law(e, Named({"stretch": stretch})) for effect, e in effects), start=0.0)

        return {"push": push}

    def beyond(self, effect: Effect, e: Named, some: Callable[[], Any]) -> list:
        """The push."""
        return [effect.law(e, Named({"stretch": some()}))]
