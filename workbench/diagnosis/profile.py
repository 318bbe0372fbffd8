"""Which values of one number are likely, where the curvature at the best one says little: dates, limits, play.

    D(v) = min over all other unknowns of |W e(v)|^2 + prior,    interval of 95 %: all v with D(v) - min D < 3.84

The other unknowns answer linearly, by the Jacobian of the fit.
"""

from functools import cached_property

import numpy as np
from scipy.stats import chi2

from workbench.diagnosis.fit import Fit, _evaluate
from workbench.diagnosis.normal import inverse
from workbench.diagnosis.predictor import Predictor
from workbench.physics.effects.effect import GridUnit
from workbench.records import field, record

POINTS = 20  # on either side, denser near the middle
DATE = 0.25  # of the logarithm of a date: on either side
LIKELY = float(chi2.ppf(0.95, 1))


@record
class Profile:
    """Values (m), ascending, of an unknown and the deviance at each."""

    values: np.ndarray = field("m")
    deviance: np.ndarray = field("m")

    @cached_property
    def best(self) -> int:
        return int(np.argmin(self.deviance))

    def interval(self, inflation: float = 1.0) -> tuple[float, float]:
        """Where the deviance is within LIKELY inflation of its smallest, at most from the first value to the last."""
        over = self.deviance - self.deviance[self.best] - LIKELY * inflation
        ends = []
        for side in (-1, 1):
            k = self.best
            while 0 <= k + side < len(over) and over[k + side] < 0.0:
                k += side
            if 0 <= k + side < len(over):
                share = over[k] / (over[k] - over[k + side])
                ends.append(self.values[k] + share * (self.values[k + side] - self.values[k]))
            else:
                ends.append(self.values[k])
        return float(ends[0]), float(ends[1])


def profile(predictor: Predictor, fit: Fit, index: int, width: float) -> Profile:
    """The profile of unknown `index` within `width` of where it was fitted."""
    unknowns = fit.unknowns
    off = width * np.linspace(-1.0, 1.0, 2 * POINTS + 1)
    off = off * np.abs(off) / width
    vectors = []
    for step in off:
        z = fit.z.copy()
        z[index] += step
        vectors.append(unknowns.clip(z))
    others = np.delete(np.arange(unknowns.size), index)
    answer = inverse(fit.information[np.ix_(others, others)])
    deviance = []
    for tried in _evaluate(predictor, unknowns, vectors, fit.jacobian):
        b = tried.prior.copy()
        for i, (J, e) in enumerate(zip(tried.jacobian, tried.errors, strict=True)):
            b[unknowns.columns(i)] += J.T @ e.ravel()
        deviance.append(tried.cost - b[others] @ answer @ b[others])
    values = np.array([z[index] for z in vectors])
    kept = np.unique(values, return_index=True)[1]  # bounds cut some
    return Profile(values[kept], np.array(deviance)[kept])


def rough(fit: Fit, sd: np.ndarray) -> dict[int, float]:
    """Unknowns in which the errors are not smooth, with the width of the profile: irregular sizes, dates (in logarithms)."""
    unknowns, found = fit.unknowns, {}
    slots = unknowns.plant.slots
    for t, own in zip(unknowns.terms, unknowns.places, strict=True):
        at = own.start
        if not slots[t.sizes[0]].effect.regular:
            found[at] = max(0.5 * abs(fit.z[at]), 6.0 * sd[at])
        for j, slot in enumerate(t.free, start=at + len(t.sizes)):
            if slots[slot].parameter.grid_unit is GridUnit.RECORD:
                found[j] = DATE
    return found


def dated(predictor: Predictor, fit: Fit) -> np.ndarray:
    """The unknowns of a fit with every date where its profile is lowest."""
    z = fit.z.copy()
    for index in rough(fit, np.zeros(len(z))):
        if index >= fit.unknowns.size - fit.unknowns.split[2] and fit.unknowns.believed[index]:
            found = profile(predictor, fit, index, DATE)
            z[index] = found.values[found.best]
    return z
