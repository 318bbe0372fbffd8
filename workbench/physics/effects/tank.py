"""Effects of a tank: what they add to what flows out of it, through its outlet and over its brim [m^3/s].

law(e, tank) -> (through the outlet, over the brim). `tank` has .level [m], .outflow, what flows out by the plant's own equation,
in proportion to the level, and .rest, the level at which that is right.

Parameters are written in m and m^3/s. A tank in other units says so: see `Tank`.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from workbench.data import Channel
from workbench.errors import InputError
from workbench.physics.effects.effect import Domain, Effect, EffectParameter, GridUnit, Named, Port
from workbench.records import field, record

SHALLOW = 1e-4  # of the level at rest, added to it: the slope of a root at 0 is infinite


def _outflow_law(e, tank):
    shallow = SHALLOW * tank.rest
    share = (np.maximum(tank.level, 0.0) + shallow) / (tank.rest + shallow)
    return tank.outflow * (share**e.exponent - 1.0), 0.0


def _overflow(e, tank):
    return 0.0, e.rate * np.maximum(tank.level - e.brim, 0.0)


OUTFLOW_LAW = Effect(
    "outflow-law",
    "tank",
    (EffectParameter("exponent", "1", low=-0.9, high=2.0),),
    "What flows out of {place} is not in proportion to its level: by the root of it at -0.5 (a hole), steeper above 0 (a weir).",
    "Steps at three levels: gain and time constant change with the level, and with a bent sensor the gain alone.",
    "outlet = outflow * ((level + rest / 10000) / (rest * 1.0001))^exponent",
    _outflow_law,
    Domain.HEAD,
)
OVERFLOW = Effect(
    "overflow",
    "tank",
    (
        EffectParameter("rate", "m^2/s", low=0.0),
        EffectParameter("brim", "m", low=0.0, default=1.0, shape=True, grid=(0.6, 0.7, 0.8, 0.9, 0.95), grid_unit=GridUnit.LEVEL),
    ),
    "{place} overflows: above its brim the level hardly rises any more.",
    "A slow way up and down: a sensor at its stop reads the same at once on the way down, a tank takes its time.",
    "spill = rate * max(level - brim, 0)",
    _overflow,
    Domain.HEAD,
)

EFFECTS = (OUTFLOW_LAW, OVERFLOW)


@record
class Tank(Port):
    """A h' = inflow - outflow - f.outlet - f.spill, f = at.<place>.flows(outflow): port for a tank, its state `level` is h.

    rest: the level at which an outflow in proportion to it is right. unit, flow: units of level and flows where they are no m and
    m^3/s: volts of a sensor, litres per minute.

        >>> port = Tank("upper", level="h1", rest=0.2)
        >>> [name for name, effect in EFFECTS.items() if effect.family == port.family]
        ['outflow-law', 'overflow']
    """

    level: str
    rest: float = field("", default=1.0, low=1e-9)
    unit: str = "m"
    flow: str = "m^3/s"
    family = "tank"
    symbols = (
        "outlet: flow through the outlet; spill: flow over the brim; outflow: by the plant's own equation; level: of the tank; "
        "rest: level at which outflow is right"
    )
    law = "law(e, tank) -> (through the outlet, over the brim); tank has .level, .outflow, .rest"

    def fitted(self, parameter: EffectParameter) -> EffectParameter:
        """The parameter in the units of the tank."""
        own = {"m": self.unit, "m^2/s": "m^2/s" if (self.unit, self.flow) == ("m", "m^3/s") else f"{self.flow}/{self.unit}"}
        return replace(parameter, unit=own.get(parameter.unit, parameter.unit))

    def verbs(self, effects, context) -> dict:
        """flows(outflow) -> what all effects add, with .outlet and .spill, to an outflow in proportion to the level."""
        level = context.x[self.level]

        def flows(outflow):
            tank = Named({"level": level, "outflow": outflow, "rest": self.rest})
            parts = [effect.law(e, tank) for effect, e in effects]
            return Named({"outlet": sum(a for a, _ in parts), "spill": sum(b for _, b in parts)})

        return {"flows": flows}

    def beyond(self, effect: Effect, e: Named, some: Callable[[], Any]) -> list:
        """What flows through the outlet and over the brim."""
        outlet, spill = effect.law(e, Named({"level": some(), "outflow": some(), "rest": self.rest}))
        return [outlet, spill]


def check_unit(port: Tank, level: Channel, plant: str) -> None:
    """Refuse a tank whose unit is not that of its level (InputError): its brim would be named in the wrong one."""
    if level.unit != port.unit:
        mend = f"Tank({port.place!r}, {port.level!r}, unit={level.unit!r}, flow=...), with the unit of outflow"
        raise InputError(
            f"the level {level.name} is in {level.unit or '1'}, the tank in {port.unit or '1'}", file=plant, mend=mend
        )
