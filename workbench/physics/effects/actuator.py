"""Effects between the logged command of an input and what acts on the machine, in the order in which they act.

law(e, u, t) -> u: a static map of the held command [unit of the input]. An effect with memory keeps a number m from sample to
sample:  law(e, m, u, dt) -> (m, u).  The input delay is no map: it shifts the hold in time, and the stepper splits its steps
where a shifted hold changes, so that any delay, whole samples or not, is exact.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from workbench.physics.effects.effect import Domain, Effect, EffectParameter, GridUnit, Named, Port
from workbench.records import record


def _offset(e, u, t):
    del t
    return u + e.level


def _dead_zone(e, u, t):
    del t
    return u - np.minimum(np.maximum(u, -e.half_width), e.half_width)


def _saturation(e, u, t):
    del t
    limit = e.limit + 1e30 * (e.limit <= 0.0)  # 0 is no limit
    return np.minimum(np.maximum(u, -limit), limit)


def _heating(e, u, t):
    return u * (1.0 - e.fall * (1.0 - np.exp(-t / e.time)))


def _gear_backlash(e, m, u, dt):
    # m is where the teeth stand in the gap, as the impulse that brought them there: what moves them is not passed on
    after = np.minimum(np.maximum(m + u * dt, -0.5 * e.play), 0.5 * e.play)
    return after, u - (after - m) / dt


def _input_delay(e, u, t):
    del e, t
    return u  # the stepper shifts the hold


OFFSET = Effect(
    "offset",
    "actuator",
    (EffectParameter("level", "unit of the input"),),
    "The amplifier of {place} has an offset: it gives a little even when nothing is commanded.",
    "A stop or a reversal: dry friction changes its sign with the motion, an offset does not; a dead zone with the command's.",
    "acting = u + level",
    _offset,
    Domain.COMMAND,
)
DEAD_ZONE = Effect(
    "dead-zone",
    "actuator",
    (EffectParameter("half_width", "unit of the input", low=0.0),),
    "The amplifier of {place} has a dead zone: small commands do nothing, and larger ones arrive smaller by as much.",
    "A command that changes its sign: while it keeps one sign a dead zone is an offset.",
    "acting = u - min(max(u, -half_width), half_width)",
    _dead_zone,
    Domain.COMMAND,
    regular=False,
    grid=(0.02, 0.05, 0.1, 0.2, 0.4),
    grid_unit=GridUnit.COMMAND,
)
SATURATION = Effect(
    "saturation",
    "actuator",
    (EffectParameter("limit", "unit of the input", low=0.0),),
    "The amplifier of {place} saturates: it gives no more than its limit, whatever is commanded. A limit of 0 is none.",
    "Larger steps of the command: a drift of the resistance acts at every level.",
    "acting = min(max(u, -limit), limit)",
    _saturation,
    Domain.COMMAND,
    regular=False,
    grid=(0.7, 0.8, 0.9, 0.95, 0.99),
    grid_unit=GridUnit.COMMAND,
)
HEATING = Effect(
    "heating",
    "actuator",
    (
        EffectParameter("fall", "1", low=0.0, high=0.9),
        EffectParameter(
            "time", "s", low=1e-3, high=1e5, default=30.0, shape=True, grid=(0.1, 0.3, 1.0, 3.0), grid_unit=GridUnit.RECORD
        ),
    ),
    "The drive of {place} weakens as it warms up: the same command gives less and less, down to a lasting share.",
    "The same run cold and warm: what comes from a radius that changes is the same in both.",
    "acting = u * (1 - fall * (1 - exp(-t / time)))",
    _heating,
    Domain.TIME,
)
GEAR_BACKLASH = Effect(
    "gear-backlash",
    "actuator",
    # play: the impulse of the command that is lost from one flank of the teeth to the other
    (EffectParameter("play", "unit of the input s", low=0.0),),
    "The gear behind {place} has play: after each change of sign the command does nothing until the teeth meet again.",
    "Changes of the command's sign, slow and fast: a dead zone loses the same at every small command, play only after a change.",
    "acting = u - (m - before) / dt, m = min(max(before + u * dt, -play / 2), play / 2)",
    _gear_backlash,
    Domain.COMMAND,
    regular=False,
    grid=(0.1, 0.3, 1.0, 3.0),
    grid_unit=GridUnit.IMPULSE,
    memories=1,
)
INPUT_DELAY = Effect(
    "input-delay",
    "actuator",
    (EffectParameter("time", "s", low=0.0),),
    "The command of {place} arrives late: a dead time between the logged value and the machine.",
    "A fast binary command and a measured speed: a lag of one sensor shows in that sensor only.",
    "acting(t) = u(t - time)",
    _input_delay,
    Domain.SHIFT,
    regular=False,
    grid=(0.25, 0.5, 1.0, 2.0),
    grid_unit=GridUnit.SAMPLE,
)

EFFECTS = (OFFSET, DEAD_ZONE, SATURATION, HEATING, GEAR_BACKLASH, INPUT_DELAY)


@record
class Driven:
    """What an actuator makes of a command: the acting input, before any delay, and its memories after the sample."""

    acting: Any
    memory: list


@record
class Actuator(Port):
    """Port for an input; every commanded input of a plant has one, its place is the channel's name."""

    unit: str
    family = "actuator"
    symbols = "acting: what arrives at the machine; u: the logged command; before: m a sample earlier, dt: the sample time"
    law = "law(e, u, t) -> acting, or with memories=1 law(e, m, u, dt) -> (m, acting)"
    memories = 1

    def fitted(self, parameter: EffectParameter) -> EffectParameter:
        """The parameter in the input's own unit."""
        return replace(parameter, unit=parameter.unit.replace("unit of the input", self.unit))

    def drive(self, effects, memory, u, t, dt) -> Driven:
        """A sample of length dt under the held command u; memory: as many numbers as the effects keep together."""
        after = []
        for effect, e in effects:
            if effect.memories:
                m, u = effect.law(e, memory[len(after)], u, dt)
                after.append(m)
            else:
                u = effect.law(e, u, t)
        return Driven(u, after)

    def beyond(self, effect: Effect, e: Named, some: Callable[[], Any]) -> list:
        """By how much what acts differs from the command; what it keeps has not moved yet."""
        u = some()
        if not effect.memories:
            return [effect.law(e, u, some()) - u]
        _, acting = effect.law(e, 0.0, u, 0.01)
        return [acting - u]
