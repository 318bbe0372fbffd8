"""A loop over actuators with curves as it is behind them: law, model, records and limits, with f(u) in place of u.

There it is the loop of an LPV model, and all proofs hold that do; what is asked of u itself and cannot be said of f(u) is not
proved.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from workbench.data import Channel, Dataset
from workbench.hammerstein import Model, behind, curves_of, inverted, with_curves
from workbench.lpv import LPVModel
from workbench.robustness.limits import Limit, LoopLimits
from workbench.robustness.verdict import Status, Verdict
from workbench.verification.model import claimed


class Behind(NamedTuple):
    """The loop behind its curves; limits: None where nothing can be proved there. unsaid: verdicts on what cannot."""

    law: Any
    model: LPVModel
    records: Dataset
    limits: LoopLimits | None
    unsaid: tuple[Verdict, ...] = ()


def as_arriving(law: Any, model: Model, records: Dataset, limits: LoopLimits) -> Behind:
    """The loop behind the curves of a model; of one without curves the loop itself.

    Raises InputError where the law does not invert the curves of the model, and no others.
    """
    (law, core), curves = behind(law, model), curves_of(model)
    if not curves:
        return Behind(law, core, records, limits)
    names = {curve.input: f"f({curve.input})" for curve in curves}
    law = replace(
        law, actuated=tuple(names.get(a, a) for a in law.actuated), units={names.get(key, key): u for key, u in law.units.items()}
    )
    core = replace(core, inputs=_named(core.inputs, names))
    arriving = (with_curves(e, curves) for e in records)
    records = Dataset(tuple(replace(e, channels=_named(e.channels, names)) for e in arriving))
    if not all(np.array_equal(a.v, b.v) for a, b in zip(curves, inverted(model), strict=True)):
        said = "a curve of the model stands still somewhere, so that its inverse is not exact: simulate runs the law on the model"
        return Behind(law, core, records, None, tuple(_undecided(name, core, said) for name in claimed(limits)))
    kept, unsaid, by_input = [], [], {curve.input: curve for curve in curves}
    for own in limits.limits:
        curve = by_input.get(own.signal)
        if curve is None:
            kept.append(own)
            continue
        said = "not proved of a command before a curve: simulate runs the law on the model"
        unsaid += [_undecided(f"{own.signal}: {name}", core, said) for name in own.kept if name not in ("low", "high")]
        if {"low", "high"} & {*own.kept}:
            low, high = (float(curve(np.array(end))) for end in (own.low, own.high))
            kept.append(Limit(names[own.signal], low, high, begin=own.begin, unit=own.unit))
    return Behind(law, core, records, replace(limits, limits=tuple(kept)), tuple(unsaid))


def _undecided(claim: str, model: LPVModel, said: str) -> Verdict:
    return Verdict(claim, f"model {model.name}", Status.UNDECIDED, math.nan, "", said)


def _named(channels: tuple[Channel, ...], names: Mapping[str, str]) -> tuple[Channel, ...]:
    return tuple(replace(c, name=names.get(c.name, c.name)) for c in channels)
