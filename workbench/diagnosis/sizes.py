"""Sizes and parameters of a fitted model with their 95 % intervals."""

import numpy as np

from workbench.diagnosis.answer import Estimate
from workbench.diagnosis.policy import LEAST
from workbench.diagnosis.profile import profile, rough
from workbench.diagnosis.refit import Model
from workbench.physics.parameters import EffectSizes


def beyond_tolerance(base: Model, model: Model) -> tuple[str, ...]:
    """A sentence for every parameter that left its tolerance; what a named cause has pulled out is a sign of something else."""
    unknowns, plant = model.fit.unknowns, model.predictor.plant
    said = []
    for j, i in enumerate(unknowns.parameters):
        q, now = plant.parameters[i], float(model.fit.point.p[i])
        if not _left_open(q.tolerance, float(model.fit.z[j] * unknowns.sigma[j])):
            pulled = bool(model.keys) and abs(base.fit.z[j]) < np.sqrt(3.0)
            sign = ": a sign of another missing piece" if pulled else ""
            said.append(
                f"{q.name} ({q.meaning or 'parameter'}) is {now:.4g} {q.unit}, {100 * (now / q.value - 1):+.0f} % off the data "
                f"sheet, which leaves {100 * q.tolerance:.0f} % open{sign}"
            )
    return tuple(said)


def _left_open(tolerance: float, off: float) -> bool:
    """Whether the logarithm of a parameter over nominal leaves what its tolerance allows by half of that at most.

    A tolerance of 90 % leaves open a tenth of nominal: downwards it is wider in the logarithm.
    """
    lowest = -np.log(max(1.0 - tolerance, LEAST)) + 0.5 * tolerance
    return bool(-lowest <= off <= 1.5 * tolerance)


def _spread(model: Model) -> np.ndarray:
    """Standard deviations of the unknowns: the larger of the likelihood's and of the scores of blocks of a second (sandwich)."""
    fit, unknowns = model.fit, model.fit.unknowns
    meat = np.diag(unknowns.believed.astype(float))
    length = model.predictor.block
    for i, (J, e) in enumerate(zip(fit.jacobian, fit.errors, strict=True)):
        own, ny = unknowns.columns(i), e.shape[1]
        first = ny * np.arange(0, max(1, len(e) - length // 2), length)
        g = np.add.reduceat(J * e.ravel()[:, None], first, axis=0)
        meat[np.ix_(own, own)] += g.T @ g
    C = fit.covariance
    return np.sqrt(np.maximum(np.diag(C), np.diag(C @ meat @ C)))


def sizes_of(model: Model, key: str) -> dict[str, Estimate]:
    """Sizes and fitted shapes of an effect with 95 % intervals; of one with a phase, its amplitude."""
    unknowns, plant = model.fit.unknowns, model.predictor.plant
    sd, z = _spread(model), model.fit.z
    found = {}
    ends = {j: (v - 1.96 * s, v + 1.96 * s) for j, (v, s) in enumerate(zip(z, sd, strict=True))}
    for t, own in zip(unknowns.terms, unknowns.places, strict=True):
        if t.key == key:
            at = own.start
            for j, width in rough(model.fit, sd).items():
                if at <= j < own.stop:
                    inflation = sd[j] ** 2 / max(model.fit.covariance[j, j], 1e-300)
                    low, high = profile(model.predictor, model.fit, j, width).interval(inflation)
                    ends[j] = (min(low, ends[j][0]), max(high, ends[j][1]))
            if t.phase:
                pair = z[at : at + 2]
                size = float(np.linalg.norm(pair))
                C = model.fit.covariance[at : at + 2, at : at + 2]
                ratio = max(1.0, float(np.max(sd[at : at + 2] ** 2 / np.diag(C))))
                width = 1.96 * float(np.sqrt(ratio * pair @ C @ pair)) / max(size, 1e-300)
                found["amplitude"] = Estimate(size, max(0.0, size - width), size + width, plant.slots[t.sizes[0]].parameter.unit)
            else:
                for j, slot in enumerate(t.sizes):
                    q, value, (low, high) = plant.slots[slot].parameter, float(z[at + j]), ends[at + j]
                    found[q.name] = Estimate(value, max(q.low, float(low)), min(q.high, float(high)), q.unit)
            for j, slot in enumerate(t.free, start=at + len(t.sizes)):
                q, value = plant.slots[slot].parameter, float(unknowns.base[slot])
                now, low, high = (float(value * np.exp(x)) for x in (z[j], *ends[j]))
                found[q.name] = Estimate(now, low, high, q.unit)
            for slot in t.shapes:
                if slot not in t.free:
                    q, value = plant.slots[slot].parameter, float(unknowns.base[slot])
                    found[q.name] = Estimate(value, value, value, q.unit)
    return found


def parameters_of(model: Model) -> dict[str, Estimate]:
    unknowns, plant, sd = model.fit.unknowns, model.predictor.plant, _spread(model)
    found = {}
    for j, i in enumerate(unknowns.parameters):
        q, now, wide = plant.parameters[i], float(model.fit.point.p[i]), 1.96 * float(unknowns.sigma[j] * sd[j])
        found[q.name] = Estimate(now, now * float(np.exp(-wide)), now * float(np.exp(wide)), q.unit, q.value)
    return found


def effects_of(model: Model) -> EffectSizes:
    """The effects of the extended plant; an effect with a phase has that of the first record."""
    plant, eta = model.predictor.plant, model.fit.point.eta[0]
    return {
        key: {slot.parameter.name: float(eta[i]) for i, slot in enumerate(plant.slots) if slot.key == key} for key in model.keys
    }
