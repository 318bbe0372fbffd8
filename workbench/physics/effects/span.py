"""Effects in a span of web between two rollers: what they add to the rate of change of its tension [N/s].

law(e, span) -> (tension rate, rate of change of the effect's own state, if it has one). `span` has .stretch [m/s], at which its
ends draw apart, .stiffness [N/m], .tension [N], .rest [N], the tension at which the stiffness is right, .t [s] and .state.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from workbench.physics.effects.effect import Domain, Effect, EffectParameter, Named, Port, jump_time, smooth_step
from workbench.records import record


def _nonlinear_elasticity(e, span):
    return e.change * (span.tension - span.rest) / span.rest * (span.stiffness * span.stretch), 0.0


def _viscoelastic(e, span):
    # a Maxwell branch beside the elastic web: a spring of share * stiffness, whose tension (the state) a damper lets go
    rate = e.share * span.stiffness * span.stretch - span.state / e.time
    return rate, rate


def _periodic_tension(e, span):
    phase = 2 * np.pi * e.frequency * span.t
    return e.cosine * np.cos(phase) + e.sine * np.sin(phase), 0.0


def _stiffness_jump(e, span):
    return e.change * smooth_step(span.t, e.time) * (span.stiffness * span.stretch), 0.0


NONLINEAR_ELASTICITY = Effect(
    "nonlinear-elasticity",
    "span",
    # at -1 the web would be limp at twice the rest tension, at +1 when it hangs loose
    (EffectParameter("change", "1", low=-0.9, high=0.9),),
    "The web in {place} is stiffer or softer at higher tension: its stiffness changes with the tension in it.",
    "Small steps at two levels of the tension: a bent characteristic of the sensor changes the reading, not the oscillation.",
    "T' = k * e + change * (T - rest) / rest * k * e",
    _nonlinear_elasticity,
    Domain.TENSION,
)
VISCOELASTIC = Effect(
    "viscoelastic",
    "span",
    (
        EffectParameter("share", "1", low=0.0, high=10.0),
        EffectParameter("time", "s", low=0.01, high=1e4, default=1.0, shape=True, grid=(0.05, 0.2, 1.0, 5.0, 20.0)),
    ),
    "The web in {place} creeps: after a step of the stretch part of the tension dies away with a time constant.",
    "Steps that are then held: damping acts only while the web is stretched, slip as long as the tensions differ.",
    "T' = k * e + x', x' = share * k * e - x / time",
    _viscoelastic,
    Domain.TIME,
    state=True,
)
PERIODIC_TENSION = Effect(
    "periodic-tension",
    "span",
    (
        EffectParameter("cosine", "N/s"),
        EffectParameter("sine", "N/s"),
        EffectParameter("frequency", "Hz", low=1e-3, high=1e4, default=1.0, shape=True, grid=(0.1, 0.3, 1.0, 3.0, 10.0)),
    ),
    "Something shakes the web in {place} at a fixed frequency, whatever the speed of the machine.",
    "Two speeds: an eccentric reel or an imbalance shakes once per turn and changes its frequency with the speed.",
    "T' = k * e + cosine * cos(2 * pi * frequency * t) + sine * sin(2 * pi * frequency * t)",
    _periodic_tension,
    Domain.TIME,
    phase=True,
)
STIFFNESS_JUMP = Effect(
    "stiffness-jump",
    "span",
    (EffectParameter("change", "1", low=-0.9, high=10.0), jump_time()),
    "The web in {place} changes its stiffness during the record: another material, a splice, a change of temperature.",
    "The same run again: a jump has a date, a stiffness that depends on tension or speed comes back with them.",
    "T' = k * e + change * step(t - time) * k * e",
    _stiffness_jump,
    Domain.TIME,
)

EFFECTS = (NONLINEAR_ELASTICITY, VISCOELASTIC, PERIODIC_TENSION, STIFFNESS_JUMP)


@record
class Span(Port):
    """T' = k e + at.<place>.rate(e, k, rest): port for a span of web whose tension is the state `tension`.

    >>> port = Span("first", tension="T1")
    >>> [name for name, effect in EFFECTS.items() if effect.family == port.family]
    ['nonlinear-elasticity', 'viscoelastic', 'periodic-tension', 'stiffness-jump']
    """

    tension: str
    family = "span"
    symbols = (
        "T: tension; k: stiffness; e: speed at which the ends draw apart; rest: tension at which k is right; "
        "step: 0 before, 1 after, half way at 0"
    )
    law = "law(e, span) -> (tension rate, rate of its own state or 0); span has .stretch, .stiffness, .tension, .rest, .t, .state"
    states = True

    def verbs(self, effects, context) -> dict:
        """rate(stretch, stiffness, rest): what all effects add to T' = stiffness * stretch [N/s]; see the module."""
        view = {"tension": context.x[self.tension], "t": context.t}

        def rate(stretch, stiffness, rest):
            view.update(stretch=stretch, stiffness=stiffness, rest=rest)
            total = 0.0
            for effect, e in effects:
                key = (self.place, effect.id)
                added, moving = effect.law(e, Named(view | {"state": context.inner.get(key, 0.0)}))
                total = total + added
                if effect.state:
                    context.inner_rate[key] = moving
            return total

        return {"rate": rate}

    def beyond(self, effect: Effect, e: Named, some: Callable[[], Any]) -> list:
        """The tension rate and the rate of its own state, which is 0 as long as it does not move."""
        seen = {name: some() for name in ("stretch", "stiffness", "tension", "rest", "t")}
        rate, moving = effect.law(e, Named(seen | {"state": 0.0}))
        return [rate, moving]
