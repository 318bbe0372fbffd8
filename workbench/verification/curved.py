"""A loop over actuators with curves as it is behind them: law, model, records and limits, with f(u) in place of u.

There it is the loop of an LPV model, and all proofs hold that do; what is asked of u itself and cannot be said of f(u) is not
proved.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from workbench.curves import Curve
from workbench.data import Channel, Dataset
from workbench.hammerstein import Model, behind, curves_of, with_curves
from workbench.lpv import LPVModel
from workbench.robustness.limits import Limit, LoopLimits
from workbench.robustness.verdict import Status, Verdict
from workbench.verification.model import claimed, unit_of


class Behind(NamedTuple):
    """The loop behind its curves; limits: None where nothing can be proved there. unsaid: verdicts on what cannot. asked: what
    limits of f(u) were asked of u, by claim.
    """

    law: Any
    model: LPVModel
    records: Dataset
    limits: LoopLimits | None
    unsaid: tuple[Verdict, ...] = ()
    asked: Mapping[str, str] = {}
    curves: tuple[str, ...] = ()

    def told(self, verdict: Verdict) -> Verdict:
        """The verdict with the limits that were asked for before those of f(u), and with what it takes for granted."""
        if not self.curves:
            return verdict
        claims = [f"{asked} ({own})" if (asked := self._asked(own)) else own for own in verdict.claim.split(", ")]
        numbers = f"; numbers are of {', '.join(f'f({name})' for name in self.curves)}" if any(map(self._asked, claims)) else ""
        granted = f"; the curve of {' and '.join(self.curves)} is taken to be as it was found"
        return replace(verdict, claim=", ".join(claims), sentence=f"{verdict.sentence}{numbers}{granted}")

    def _asked(self, claim: str) -> str:
        """What was asked of u by a claim of f(u); empty for every other one."""
        return next((asked for inside, asked in self.asked.items() if f"{inside} " in f"{claim} "), "")


def as_arriving(law: Any, model: Model, records: Dataset, limits: LoopLimits) -> Behind:
    """The loop behind the curves of a model; of one without curves the loop itself.

    Raises InputError where the law does not invert the curves of the model, and no others, and for limits of no signal.
    """
    (inner, core), curves = behind(law, model), curves_of(model)
    if not curves:
        return Behind(inner, core, records, limits)
    taken = tuple(curve.input for curve in curves)
    records = Dataset(tuple(with_curves(e, curves) for e in records))
    commanded = {curve.input: curve for curve in curves if curve.input in law.actuated}
    if not commanded:
        return Behind(inner, core, records, limits, curves=taken)
    units = {c.name: c.unit for c in (*core.inputs, *core.outputs) if c.name in (*law.actuated, *law.measured)}
    for own in limits.limits:
        unit_of(own, units)  # refused in the words of the file that asks
    names = {name: f"f({name})" for name in commanded}
    units = {names.get(key, key): unit for key, unit in inner.units.items()}
    kinds = ("compensations", "inverses")
    added = {kind: tuple(replace(own, input=names.get(own.input, own.input)) for own in getattr(inner, kind)) for kind in kinds}
    inner = replace(inner, actuated=tuple(names.get(a, a) for a in inner.actuated), units=units, **added)
    core = replace(core, inputs=_named(core.inputs, names))
    records = Dataset(tuple(replace(e, channels=_named(e.channels, names)) for e in records))
    if said := next((why for own in law.curves if (why := _unproved(own, commanded[own.input], law))), ""):
        return Behind(inner, core, records, None, tuple(_undecided(name, core, said) for name in claimed(limits)))
    kept, unsaid, asked = [], [], {}
    for own in limits.limits:
        curve = commanded.get(own.signal)
        if curve is None:
            kept.append(own)
            continue
        said = "not proved of a command before a curve: simulate runs the law on the model"
        unsaid += [_undecided(f"{own.signal}: {name}", core, said) for name in own.kept if name not in ("low", "high")]
        if {"low", "high"} & {*own.kept}:
            inside = Limit(names[own.signal], *(float(curve(np.array(end))) for end in (own.low, own.high)), begin=own.begin)
            kept.append(inside)
            for end in inside.kept:
                asked[f"{inside.signal}: {end} {getattr(inside, end):g}"] = f"{own.signal}: {end} {getattr(own, end):g}"
    return Behind(inner, core, records, replace(limits, limits=tuple(kept)), tuple(unsaid), asked, taken)


def _unproved(inverted: Curve, found: Curve, law: Any) -> str:
    """Why nothing is proved of a loop through the inverse of a curve; empty where nothing speaks against it."""
    if not np.array_equal(inverted.v, found.v):
        return "a curve of the model stands still somewhere, so that its inverse is not exact: simulate runs the law on the model"
    i, beyond = law.actuated.index(found.input), 1e-9 * np.ptp(found.u)
    if law.low[i] < found.u[0] - beyond or law.high[i] > found.u[-1] + beyond:
        known = f"from {found.u[0]:.4g} to {found.u[-1]:.4g}"
        return (
            f"{found.input} may go where the records have not shown its curve, known {known}: design within with --low and --high"
        )
    return ""


def _undecided(claim: str, model: LPVModel, said: str) -> Verdict:
    return Verdict(claim, f"model {model.name}", Status.UNDECIDED, math.nan, "", said)


def _named(channels: tuple[Channel, ...], names: Mapping[str, str]) -> tuple[Channel, ...]:
    return tuple(replace(c, name=names.get(c.name, c.name)) for c in channels)
