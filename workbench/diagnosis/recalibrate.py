"""Recalibration: the plant's own parameters fitted to measured records, with the data sheet's tolerances as prior.

What the parameters of the nominal model can explain is no missing physics. Noise levels come from the likelihood: fit, tune,
fit again.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.diagnosis.fit import Fit, Term, Unknowns, gauss_newton
from workbench.diagnosis.predictor import Predictor, kept
from workbench.diagnosis.tuning import tuned
from workbench.errors import check_known
from workbench.records import record


@record
class Calibrated:
    """A predictor with gains and noise levels at the fitted point, and the fit."""

    predictor: Predictor
    fit: Fit


def unknowns(predictor: Predictor, terms: Sequence[Term] = (), *, names: Sequence[str] | None = None) -> Unknowns:
    """All parameters with a tolerance (or those named), the starts of all records, and the terms of a hypothesis."""
    plant = predictor.plant
    known = [q.name for q in plant.parameters]
    for name in names or ():
        check_known("parameter", name, known, file=plant.name)
    free = tuple(
        i for i, q in enumerate(plant.parameters) if q.tolerance > 0.0 and q.value > 0.0 and (names is None or q.name in names)
    )
    return Unknowns(
        plant,
        len(predictor.records),
        free,
        np.array([plant.parameters[i].tolerance for i in free]) / np.sqrt(3.0),
        np.array([r.start for r in predictor.records]),
        np.array([r.scale for r in predictor.records]),
        tuple(terms),
        plant.nominal,
        plant.effect_vector(),
    )


def recalibrated(
    predictor: Predictor,
    z: np.ndarray | None = None,
    own: Unknowns | None = None,
    *,
    sizes: np.ndarray | None = None,
    rounds: int = 2,
) -> Calibrated:
    """Fit and tune `rounds` times, then fit to convergence; sizes (ne): a small size of each effect that is fitted."""
    own = own or unknowns(predictor)
    sizes = np.zeros(len(predictor.plant.slots)) if sizes is None else sizes
    fit = None
    z = own.zero() if z is None else z
    for _ in range(rounds):
        fit = gauss_newton(predictor, own, z, sizes, rounds=2, enough=2.0)
        z = fit.z
        predictor = predictor.regained(fit.point)
        predictor = kept(predictor.with_noise(tuned(predictor)), otherwise=predictor).coarser()
    fit = gauss_newton(predictor, own, z, sizes, rounds=4)
    return Calibrated(replace(predictor, point=fit.point), fit)
