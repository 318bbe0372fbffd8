"""Fits by the errors of the free run: nothing corrects the states, so what a model gets wrong adds up as it does in use.

    minimise  sum_k |(y_k - h(x_k)) / s|^2 + prior,    s_j = rms_j sqrt(1 + 2 sum_l r_j(l)),  r_j: autocorrelation of the errors

A filter forgives: a torque that comes and goes as noise takes in what changes at reversals only, and one step ahead a wrong
parameter costs next to nothing. Errors of a free run last; s counts them as the independent ones that they are worth.
"""

from dataclasses import replace

import numpy as np

from workbench.diagnosis.fit import gauss_newton, small_steps
from workbench.diagnosis.growth import left, unstable
from workbench.diagnosis.predictor import RAN_AWAY, Noise, Predictor
from workbench.diagnosis.refit import Model
from workbench.diagnosis.tuning import tuned

ROUNDS = 3
FADED = 0.1  # autocorrelation from which on the rest is noise


def simulated(model: Model) -> Model | None:
    """The model fitted by its free runs, from where it is; None where a run is lost: an unstable machine has none."""
    unknowns, z, sizes = model.fit.unknowns, model.fit.z, small_steps(model.fit.unknowns, model.fit.z)
    runs_away = unstable(model.predictor)
    noise = Noise(model.predictor.noise.measurement, np.zeros(len(model.predictor.noise.process)), np.empty(0))
    predictor = replace(model.predictor, simulated=True).regained(model.fit.point, noise, rounds=2)
    best: Model | None = None
    for _ in range(ROUNDS):
        if not _lasts(predictor, follows=runs_away):
            break
        predictor = weighed(predictor)
        fit = gauss_newton(predictor, unknowns, z, sizes, rounds=3)
        predictor, z = predictor.regained(fit.point), fit.z
        best = Model(predictor, gauss_newton(predictor, unknowns, z, sizes, rounds=1))
    return best


def weighed(predictor: Predictor) -> Predictor:
    """The predictor with its errors at its point weighed by what they are worth."""
    errors = _raw(predictor)
    scale, longest = [], 0.0
    for j, expected in enumerate(predictor.expected.measurement):
        own = [e[np.isfinite(r.seen[:, j]), j] for e, r in zip(errors, predictor.records, strict=True)]
        own = [e for e in own if len(e)]
        worth = max((_correlated(e) for e in own), default=1.0)
        rms = float(np.sqrt(np.mean(np.concatenate(own) ** 2))) if own else expected
        scale.append(max(rms, 1e-3 * expected) * np.sqrt(worth))
        longest = max(longest, worth)
    noise = replace(predictor.noise, measurement=np.array(scale), memory=longest * predictor.plant.dt)
    return predictor.with_noise(noise)


def filtered(model: Model) -> Model:
    """A model of free runs with a filter of its own again: noise levels of the largest likelihood at its point."""
    if not model.predictor.simulated:
        return model
    predictor = replace(model.predictor, simulated=False).regained(model.fit.point, model.predictor.expected, rounds=2)
    predictor = predictor.with_noise(tuned(predictor))
    return Model(predictor, replace(model.fit, errors=tuple(predictor.at(model.fit.point))))


def _raw(predictor: Predictor) -> list[np.ndarray]:
    at = predictor.point
    return [
        predictor.errors(i, at.p[None], at.eta[i][None], at.start[i][None], white=False)[0] for i in range(len(predictor.records))
    ]


def _lasts(predictor: Predictor, follows: bool) -> bool:
    """Whether no run is lost; follows: it is where a run does not follow its record, though it stays in the numbers."""
    if not all(np.isfinite(line.F).all() and np.isfinite(line.H).all() for line in predictor.lines):
        return False
    runs = list(zip(_raw(predictor), predictor.records, strict=True))
    if follows and any(left(e, r.y).any() for e, r in runs):
        return False
    return all(float(np.abs(e).max(initial=0.0)) < RAN_AWAY for e, _ in runs)


def _correlated(e: np.ndarray) -> float:
    """1 + 2 sum of the autocorrelations up to where they have faded: how many samples are worth one."""
    spectrum = np.abs(np.fft.rfft(e, 2 * len(e))) ** 2
    auto = np.fft.irfft(spectrum)[: len(e)]
    auto = auto / max(auto[0], 1e-300)
    faded = np.flatnonzero(auto < FADED)
    return float(1.0 + 2.0 * auto[1 : faded[0] if len(faded) else len(e)].sum())
