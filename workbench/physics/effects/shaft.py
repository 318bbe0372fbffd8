"""Effects on a turning or sliding shaft: an additional torque [N m] (or force [N]) from speed, angle, load and time.

law(e, shaft) -> torque, positive in the direction of positive speed.
`shaft` has .speed [rad/s], .angle [rad], .load (the equation's own, N m or N) and .t [s].

Parameters are written for a shaft that turns. On one that slides the same laws hold with N, m and m/s: see `Slide`. The sign
of a speed is tanh(speed/width), so that no law has a branch; every law of friction gives torque * speed <= 0 at any speed.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from workbench.errors import InputError
from workbench.physics.effects.effect import Domain, Effect, EffectParameter, GridUnit, Named, Port, jump_time, smooth_step
from workbench.records import field, record


def _coulomb(e, shaft):
    return -e.level * np.tanh(shaft.speed / e.width)


def _stribeck(e, shaft):
    return -e.level * np.exp(-((shaft.speed / e.speed) ** 2)) * np.tanh(shaft.speed / e.width)


def _asymmetric_friction(e, shaft):
    # sign * (1 +- sign)/2 is one in its own direction, 0 in the other, and against the motion in between
    sign = np.tanh(shaft.speed / e.width)
    return -0.5 * sign * (e.forward * (1.0 + sign) + e.backward * (1.0 - sign))


def _quadratic_friction(e, shaft):
    return -e.coefficient * shaft.speed * abs(shaft.speed)


def _load_friction(e, shaft):
    # |load|: a web that is pushed for an instant must not drive the shaft
    return -e.coefficient * abs(shaft.load) * np.tanh(shaft.speed / e.width)


def _imbalance(e, shaft):
    return e.cosine * np.cos(shaft.angle) + e.sine * np.sin(shaft.angle)


def _torque_ripple(e, shaft):
    return e.cosine * np.cos(e.order * shaft.angle) + e.sine * np.sin(e.order * shaft.angle)


def _friction_jump(e, shaft):
    return -e.level * np.tanh(shaft.speed / e.width) * smooth_step(shaft.t, e.time)


def _width() -> EffectParameter:
    """Each law of friction has a width of its own: a shared one would tie rival explanations together."""
    return EffectParameter(
        "width", "rad/s", low=1e-6, high=1e6, default=1.0, shape=True, grid=(0.001, 0.003, 0.01, 0.03), grid_unit=GridUnit.SPEED
    )


COULOMB = Effect(
    "coulomb",
    "shaft",
    (EffectParameter("level", "N m", low=0.0), _width()),
    "Dry friction at {place}: a constant torque against the direction of motion.",
    "A stop or a reversal: as long as it moves one way it looks like an amplifier offset or a dead zone.",
    "torque = -level * tanh(v / width)",
    _coulomb,
    Domain.SPEED,
)
STRIBECK = Effect(
    "stribeck",
    "shaft",
    (
        EffectParameter("level", "N m", low=0.0),
        EffectParameter(
            "speed",
            "rad/s",
            low=1e-6,
            high=1e6,
            default=10.0,
            shape=True,
            grid=(0.01, 0.03, 0.1, 0.3, 1.0),
            grid_unit=GridUnit.SPEED,
        ),
        _width(),
    ),
    "The bearing at {place} sticks at low speed: dry friction that is largest near standstill and fades at speed.",
    "A slow staircase of speeds from rest: dry friction is the same at every speed, this one is gone at the faster steps.",
    "torque = -level * exp(-(v / speed)^2) * tanh(v / width)",
    _stribeck,
    Domain.SPEED,
    includes=("coulomb",),
)
ASYMMETRIC_FRICTION = Effect(
    "asymmetric-friction",
    "shaft",
    # two levels, not a mean and a difference: each has the bound 0 on its own, and neither can drive the shaft
    (EffectParameter("forward", "N m", low=0.0), EffectParameter("backward", "N m", low=0.0), _width()),
    "Dry friction at {place} that differs between the two directions of motion: one level forward, another backward.",
    "Motion both ways and stops: an offset also pushes at rest, a tilt too; one way only, it looks like plain dry friction.",
    "torque = -(forward * (1 + s) + backward * (1 - s)) * s / 2, s = tanh(v / width)",
    _asymmetric_friction,
    Domain.SPEED,
    includes=("coulomb",),
)
QUADRATIC_FRICTION = Effect(
    "quadratic-friction",
    "shaft",
    (EffectParameter("coefficient", "N m s^2/rad^2", low=0.0),),
    "Air drag at {place}: friction that grows with the square of the speed.",
    "Three speeds or more, far apart: viscous friction alone gives a straight line of torque over speed.",
    "torque = -coefficient * v * abs(v)",
    _quadratic_friction,
    Domain.SPEED,
)
LOAD_FRICTION = Effect(
    "load-friction",
    "shaft",
    (EffectParameter("coefficient", "1", low=0.0, high=10.0), _width()),
    "The bearing at {place} rubs more under load: dry friction in proportion to the load.",
    "Steps of the tension at constant speed: plain dry friction stays the same, a wrong motor constant nearly does the same.",
    "torque = -coefficient * abs(load) * tanh(v / width)",
    _load_friction,
    Domain.LOAD,
)
IMBALANCE = Effect(
    "imbalance",
    "shaft",
    (EffectParameter("cosine", "N m"), EffectParameter("sine", "N m")),
    "What turns at {place} is out of balance: its weight pulls once per turn.",
    "Two speeds: the torque of an imbalance is the same at both, the disturbance of an eccentric reel grows with speed.",
    "torque = cosine * cos(phi) + sine * sin(phi)",
    _imbalance,
    Domain.ANGLE,
    phase=True,
)
TORQUE_RIPPLE = Effect(
    "torque-ripple",
    "shaft",
    (
        EffectParameter("cosine", "N m"),
        EffectParameter("sine", "N m"),
        EffectParameter(
            "order", "1/turn", low=1.5, high=24.5, default=6.0, shape=True, grid=tuple(float(k) for k in range(2, 25))
        ),
    ),
    "The torque at {place} ripples a whole number of times per turn: poles or slots of the motor, teeth, rollers.",
    "A ramp of the speed: a ripple keeps its number per turn, a disturbance of fixed frequency does not; a false order folds.",
    "torque = cosine * cos(order * phi) + sine * sin(order * phi)",
    _torque_ripple,
    Domain.ANGLE,
    phase=True,
)
FRICTION_JUMP = Effect(
    "friction-jump",
    "shaft",
    (EffectParameter("level", "N m", low=0.0), _width(), jump_time()),
    "Dry friction at {place} sets in during the record: from one moment on a constant torque acts against the motion.",
    "The same run again: a jump has a date, warming up or a winding radius changes gradually.",
    "torque = -level * tanh(v / width) * step(t - time)",
    _friction_jump,
    Domain.TIME,
    includes=("coulomb",),
)

EFFECTS = (
    COULOMB, STRIBECK, ASYMMETRIC_FRICTION, QUADRATIC_FRICTION, LOAD_FRICTION, IMBALANCE, TORQUE_RIPPLE, FRICTION_JUMP,
)  # fmt: skip


@record
class Shaft(Port):
    """J w' = .. + at.<place>.torque(): port for torques on a shaft whose speed is the state `speed`.

    loaded: the equation gives the load, `torque(load=...)`; only then load-friction is among the effects.

        >>> port = Shaft("unwind", speed="w1")
        >>> [name for name, effect in EFFECTS.items() if effect.family == port.family][:3]
        ['coulomb', 'stribeck', 'asymmetric-friction']
    """

    speed: str
    loaded: bool = False
    family = "shaft"
    symbols = (
        "torque: positive in the direction of positive speed; v: speed; phi: angle turned since the start of the record; "
        "load: as the plant's equation gives it; step: 0 before, 1 after, half way at 0"
    )
    law = "law(e, shaft) -> torque; shaft has .speed, .angle, .t, and .load where the domain is LOAD"

    def fits(self, effect: Effect) -> bool:
        """All, but for friction in proportion to a load that the equation does not give."""
        return self.loaded or effect.domain is not Domain.LOAD

    def verbs(self, effects, context) -> dict:
        """torque(load=None): the sum of all effects' torques on this shaft."""
        view = {"speed": context.x[self.speed], "angle": self.turned(context.angle[self.place]), "t": context.t}

        def torque(load=None):
            if self.loaded != (load is not None):
                given = "gives no load" if self.loaded else "gives a load"
                mend = "torque(load=...) in the equation and loaded=True in the port belong together"
                raise InputError(f"the equation {given} at {self.place!r}", mend=mend)
            shaft = Named(view | {"load": load})
            return sum((effect.law(e, shaft) for effect, e in effects), start=0.0)

        return {"torque": torque}

    def turned(self, angle):
        """The angle of what turns [rad], from the integral of the speed."""
        return angle

    def beyond(self, effect: Effect, e: Named, some: Callable[[], Any]) -> list:
        """The torque."""
        load = some() if effect.domain is Domain.LOAD else None
        return [effect.law(e, Named({"speed": some(), "angle": some(), "t": some(), "load": load}))]


@record
class Slide(Shaft):
    """m v' = .. + at.<place>.torque(): port for forces on a body that slides at the speed of the state `speed`.

    It is a shaft in N, m and m/s.

    travel: length [m] that stands for the radian of a turning shaft, so that default widths given in rad/s fit the speeds met
    here: 0.01 m/s, a hundredth of a body that moves at 1 m/s, as 1 rad/s is of a shaft that turns at 100 rad/s. Where a wheel
    or a screw carries the body, it is the wheel's radius or the lead over 2 pi: imbalance is then a wheel that runs out of
    round, and a ripple counts its teeth.

        >>> port = Slide("rail", speed="v1")
        >>> [name for name, effect in EFFECTS.items() if effect.family == port.family][:3]
        ['coulomb', 'stribeck', 'asymmetric-friction']
    """

    symbols = (
        "force: positive in the direction of positive speed; v: speed; phi: angle of the wheel or screw since the start of "
        "the record; load: as the plant's equation gives it; step: 0 before, 1 after, half way at 0"
    )
    travel: float = field("", unit="m/rad", low=1e-9, default=0.01)

    def worded(self, effect: Effect) -> Effect:
        """The effect with a force for every torque."""
        texts = {name: getattr(effect, name).replace("torque", "force") for name in ("sentence", "separates", "equation")}
        return replace(effect, **{name: text.replace("Torque", "Force") for name, text in texts.items()})

    def fitted(self, parameter: EffectParameter) -> EffectParameter:
        """The parameter in N for N m and m for rad; bounds, default and grid are scaled where it is a speed."""
        unit = parameter.unit.replace("N m", "N").replace("rad", "m")
        scale = self.travel if parameter.unit == "rad/s" else 1.0
        return replace(
            parameter,
            unit=unit,
            low=scale * parameter.low,
            high=scale * parameter.high,
            default=scale * parameter.default,
            grid=tuple((scale if parameter.grid_unit is GridUnit.ONE else 1.0) * value for value in parameter.grid),
        )

    def turned(self, angle):
        """The angle of the wheel that rolls along [rad]."""
        return angle / self.travel
