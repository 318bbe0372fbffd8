"""Effects that a plant brings along: what the rest of the workbench counts on, checked when the plant is made.

    law(numbers with all sizes 0, anything) = what there is without the effect, exactly

That is tried on arrays of arguments of both signs, on which a law also fails that has an `if` or calls the math module.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import count
from typing import Any

import casadi as ca
import numpy as np

from workbench.errors import InputError, check_known
from workbench.physics.effects import EFFECTS
from workbench.physics.effects.effect import PER_TURN, Domain, Effect, GridUnit, Named, Port
from workbench.physics.symbolic import symbolic_numpy

TRIED = np.array([-30.0, -1.0, -0.02, 0.0, 0.02, 1.0, 30.0])
# domains that are drawn over what only one family has
OF_FAMILY = {Domain.COMMAND: "actuator", Domain.LEVEL: "sensor", Domain.STRETCH: "spring", Domain.HEAD: "tank"}
OF_SIZES = {
    GridUnit.ONE: None, GridUnit.SAMPLE: None, GridUnit.COMMAND: "actuator", GridUnit.IMPULSE: "actuator",
    GridUnit.NOISE: "sensor",
}  # fmt: skip
OF_SHAPES = (GridUnit.ONE, GridUnit.SAMPLE, GridUnit.RECORD, GridUnit.CYCLES)
OF_TURNING = (*OF_SHAPES, GridUnit.SPEED)
OF_TANK = (*OF_SHAPES, GridUnit.LEVEL)


def check_own(own: Sequence[Effect], ports: Sequence[Port], plant: str) -> None:
    """Refuse effects that a plant with these ports cannot have beside the catalogue, each with its mend (InputError)."""
    ids = [effect.id for effect in own]
    for effect in own:
        place = f"{plant}, effect {effect.id!r}"
        if effect.id in EFFECTS or ids.count(effect.id) > 1:
            who = "the catalogue has one of this id" if effect.id in EFFECTS else "two have this id"
            raise InputError(who, file=place, mend="give it an id of its own")
        families = dict.fromkeys(port.family for port in ports if port.family)
        if effect.family not in families:
            mend = f"give the equation such a port, or the effect one of: {', '.join(families)}"
            raise InputError(f"no port of the plant is of the family {effect.family!r}", file=place, mend=mend)
        fitting = [port for port in ports if port.family == effect.family and port.fits(effect)]
        if not fitting:
            mend = "give the port loaded=True and the equation torque(load=...), or the effect another domain"
            raise InputError("its domain is LOAD, and no port gives a load", file=place, mend=mend)
        for name in effect.includes:
            check_known("effect in includes", name, [*EFFECTS, *ids], file=place)
        for port in fitting:
            for problem, mend in _misfits(effect, port):
                raise InputError(problem, file=place, mend=mend)
        _check_law(effect, fitting[0], place)


def _misfits(effect: Effect, port: Port) -> Iterator[tuple[str, str]]:
    """What of an effect means nothing at a port, with its mend."""
    family, turns, domain = effect.family, hasattr(port, "speed"), effect.domain
    if domain in OF_FAMILY and family != OF_FAMILY[domain]:
        yield f"the domain {domain.name} is of {OF_FAMILY[domain]} effects", "SPEED, TIME, ... say what it is drawn over"
    if domain is Domain.ANGLE and not (turns or hasattr(port, "arm")):
        yield f"nothing turns at {port.place}: no domain ANGLE", "SPEED, TIME, ... say what it is drawn over"
    if effect.grid_unit not in OF_SIZES or OF_SIZES[effect.grid_unit] not in (None, family):
        own = [unit.name for unit, of in OF_SIZES.items() if of in (None, family)]
        yield f"its sizes cannot be tried in {effect.grid_unit.name}", f"grid_unit is one of {', '.join(own)}"
    for p in effect.parameters:
        if p.grid_unit not in (own := OF_TURNING if turns else OF_TANK if family == "tank" else OF_SHAPES):
            yield f"{p.name} cannot be tried in {p.grid_unit.name}", f"one of {', '.join(unit.name for unit in own)}"
        if p.shape and effect.phase and not (turns or (p.unit != PER_TURN and hasattr(port, "tension"))):
            yield f"nothing has an order or a frequency at {port.place}", "a phase with a shape is of a shaft, a reel or a span"
    if effect.state and not port.states:
        yield f"a {family} effect has no state of its own", "leave state out: only a span integrates one"
    if effect.memories > port.memories:
        yield f"memories = {effect.memories}", f"a {family} effect keeps {'one number at most' if port.memories else 'none'}"


def _check_law(effect: Effect, port: Port, place: str) -> None:
    """Call the law with sizes of 0."""
    e = Named({p.name: p.default for p in effect.parameters})
    try:
        effect.sentence.format(place=port.place)
    except (KeyError, IndexError, ValueError):
        raise InputError("its sentence has braces that are not {place}", file=place, mend="write {place} alone") from None
    asked = f"expected {port.law}, in arithmetic and numpy functions without an `if`"
    try:
        with np.errstate(all="ignore"):
            found = [np.broadcast_to(_number(value), TRIED.shape) for value in port.beyond(effect, e, _arguments())]
        with symbolic_numpy():  # what is compiled is the law of symbols
            for value in port.beyond(effect, e, lambda: ca.SX.sym("argument")):
                ca.SX(value)
    except InputError as reason:
        raise InputError(f"its law: {reason.problem}", file=place, mend=f"{reason.mend}; {asked}") from None
    except Exception as reason:
        raise InputError(f"its law: {type(reason).__name__}: {reason}", file=place, mend=asked) from reason
    for values in found:
        wrong = values[np.isfinite(values) & (values != 0.0)]
        if len(wrong):
            said = f"is not neutral: with sizes of 0 its law adds {wrong[0]:.3g}"
            raise InputError(said, file=place, mend="every term needs a size as a factor, so that 0 is no effect, exactly")


def _number(value: Any) -> np.ndarray:
    if value is None:
        raise TypeError("it returns nothing")
    return np.asarray(value, dtype=float)


def _arguments() -> Callable[[], np.ndarray]:
    """Arguments, no two of them alike."""
    number = count()
    return lambda: np.roll(TRIED, next(number)) * 1.7
