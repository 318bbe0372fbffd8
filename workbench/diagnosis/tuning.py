"""Noise levels of the largest likelihood, given what is expected of them.

    minimise over q   -2 log p(y | q) + sum_j ((z_j - z0_j) / width_j)^2,    z_j = log(q_j / expected_j + FLOOR),   q: variances

by L-BFGS-B with exact slopes. The likelihood is that of the linearized plant about the predictor's own trajectory. Where it does
not care about a level, the level stays as expected; one that is none can grow again, which its logarithm would not.

An unstable plant keeps some push of its states. Without any its filter corrects nothing: predictions are a free run in which a
millionth of a parameter, a start or an effect grows to all that a record shows, and would count as known to that millionth.
"""

import numpy as np
from scipy.optimize import minimize

from workbench.diagnosis.growth import unstable
from workbench.diagnosis.kalman import Linearization, likelihood
from workbench.diagnosis.predictor import Noise, Predictor, with_decays

READING = 2.0 * np.log(3.0)  # width for the variance of a measurement, which the data sheet or the records state
PUSHING = 2.0 * np.log(30.0)  # the same of what pushes the states
LASTING = np.log(5.0)  # the same of a coloured part's time constant
FLOOR = 0.03
LEAST = 1e-4  # of the variance of a measurement, and of what pushes an unstable plant: without any the filter has no gain
LARGEST = np.log(1e16)  # of a variance over what is expected
SHORTEST = 5.0  # samples: a push that fades faster is as good as white
MEMORY = 3.0  # s, the slowest coloured torque; what is slower shall be explained
QUICKEST, FADED = 0.5, 0.5  # samples, s: the same of the noise of a sensor, whose white part is told from the coloured one
REACH, REACHES = np.log(100.0), 9  # how far a variance may move in one go, and how often
ENOUGH, AGAIN = 0.05, 1.0  # of the deviance: a search ends, and is not begun again from where it ended


def tuned(predictor: Predictor, *, share: float = 1.0, again: bool = False) -> Noise:
    """The noise levels under which the predictor's own trajectory is most likely; share: of the records that are looked at.

    again: the predictor's levels were found so, about a trajectory like this one, and the search begins at them. Free runs
    have no noise but what their errors are weighed by.
    """
    if predictor.simulated:
        return predictor.noise
    tuning = _Tuning(predictor, share)
    return tuning.noise(min(map(tuning.searched, tuning.starts(again)), key=lambda found: found[0])[1])


class _Tuning:
    """The cost of noise levels z along a predictor's trajectory, and searches for its minimum; see the module."""

    def __init__(self, predictor: Predictor, share: float):
        self.predictor, self.dt = predictor, predictor.plant.dt
        self.pieces = [_piece(predictor, i) for i in range(int(np.ceil(share * len(predictor.records))))]
        self.counts = nw, nd, nc = tuple(
            len(own) for own in (predictor.noise.process, predictor.noise.drift, predictor.noise.coloured)
        )
        self.expected = _levels(predictor.expected)
        self.is_push = np.append(np.arange(len(self.expected)) < nw + nd + nc, [True, True])  # or the time constant of one
        levels = self.is_push[:-2]
        self.width = np.append(np.where(levels, PUSHING, READING), [LASTING, LASTING])
        self.middle = np.append(np.full(len(levels), np.log(1.0 + FLOOR)), _times(predictor.expected))
        pushed = np.arange(len(levels)) < nw
        lowest = np.log(FLOOR + np.where(levels & ~(pushed & unstable(predictor)), 0.0, LEAST))
        spans = ((SHORTEST * self.dt, MEMORY), (QUICKEST * self.dt, FADED))
        times = [(shortest, max(longest, shortest)) for shortest, longest in spans]
        self.bounds = np.array([*((low, LARGEST) for low in lowest), *np.log(times)])
        # a well determined level has this deviation
        self.unit = 1.0 / np.sqrt(1.0 / self.width**2 + sum(len(e) for _, _, e in self.pieces))
        self.known: dict[bytes, tuple[float, np.ndarray]] = {}  # a search begins where the last one ended

    def noise(self, z: np.ndarray) -> Noise:
        """The levels themselves."""
        s = self.expected * np.sqrt(np.maximum(np.exp(z[:-2]) - FLOOR, 0.0))
        process, drift, coloured, measurement = np.split(s, np.cumsum(self.counts))
        return Noise(measurement, process, drift, float(np.exp(z[-2])), coloured, float(np.exp(z[-1])))

    def starts(self, again: bool) -> list[np.ndarray]:
        """Levels z from which searches begin."""
        noise, (nw, nd, nc) = self.predictor.noise, self.counts
        at = np.append(np.log((_levels(noise) / self.expected) ** 2 + FLOOR), _times(noise))
        if again:
            return [at]
        # from small pushes that fade fast nothing leads to larger ones that last; and levels that a wrong trajectory has driven
        # up may not come down again on their own
        starts = [np.where(self.is_push, np.maximum(at, self.middle), at), self.middle]
        if nc:  # pushes that have stood for what lasts in the readings do not give way to it: as loud as the white part
            white, readings = slice(nw + nd + nc, len(self.expected)), slice(nw + nd, nw + nd + nc)
            loud = self.middle.copy()
            loud[readings] = at[white] + 2.0 * np.log(self.expected[white] / self.expected[readings])
            starts.append(loud)
        return starts

    def searched(self, start: np.ndarray) -> tuple[float, np.ndarray]:
        """Lowest cost, and the levels z where it is, by way of a start."""
        x = np.clip(start, *self.bounds.T) / self.unit
        for _ in range(REACHES):
            # a step to where nothing is defined would end a line search
            reach = REACH / self.unit
            near = np.clip(self.bounds / self.unit[:, None], (x - reach)[:, None], (x + reach)[:, None])
            began = self._cost(x)[0]
            options = {"ftol": ENOUGH / max(abs(began), 1.0), "maxiter": 60}
            found = minimize(self._cost, x, jac=True, method="L-BFGS-B", bounds=near, options=options)
            x = found.x
            if began - found.fun < AGAIN:
                break
        return self._cost(x)[0], x * self.unit

    def _cost(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Cost and slopes at levels in units of their deviation."""
        if x.tobytes() not in self.known:
            value, slope = self._computed(x * self.unit)
            self.known[x.tobytes()] = value, slope * self.unit
        value, slope = self.known[x.tobytes()]
        return value, slope.copy()

    def _computed(self, z: np.ndarray) -> tuple[float, np.ndarray]:
        levels, total, slope = self.noise(z), 0.0, np.zeros(len(z))
        a, (_, nd, nc) = levels.decays(self.dt), self.counts
        for line, gain, e in self.pieces:
            found = likelihood(with_decays(line, a), levels.pushes, levels.measurement, gain, e, nd + nc)
            by_time = found.decay * a
            total += found.deviance
            slope += np.concatenate([found.process, found.measurement, [by_time[:nd].sum(), by_time[nd:].sum()]])
        if not np.isfinite(total) or not np.isfinite(slope).all():
            return 1e300, np.zeros(len(z))
        off = (z - self.middle) / self.width
        slope *= np.append(self.expected**2 * np.exp(z[:-2]), [self.dt / levels.memory, self.dt / levels.correlation_time])
        return float(total + off @ off), slope + 2.0 * off / self.width


def _levels(noise: Noise) -> np.ndarray:
    return np.concatenate([noise.pushes, noise.measurement])


def _times(noise: Noise) -> np.ndarray:
    return np.log([noise.memory, noise.correlation_time])


def _piece(predictor: Predictor, i: int) -> tuple[Linearization, np.ndarray, np.ndarray]:
    """Linearization, gain and innovations of record i, without the states that no reading depends on (angles, mostly)."""
    at, line, coloured = predictor.point, predictor.lines[i], len(predictor.noise.drift) + len(predictor.noise.coloured)
    e = predictor.errors(i, at.p[None], at.eta[i][None], at.start[i][None], white=False, drift=False)[0]
    gain = predictor.passes[i].gain.copy()
    gain[:, gain.shape[1] - coloured :] = 0.0
    n = line.F.shape[1]
    moves = (line.F != 0.0).any(axis=0)
    felt = (line.H != 0.0).any(axis=(0, 1))
    while (more := felt | (moves & felt[:, None]).any(axis=0)).sum() > felt.sum():
        felt = more
    kept = np.flatnonzero(felt | (np.arange(n) >= n - coloured))
    F, G, H, gain = (
        np.ascontiguousarray(a) for a in (line.F[:, kept][:, :, kept], line.G[:, kept], line.H[:, :, kept], gain[:, kept])
    )
    return Linearization(F, G, H, line.present, line.added[:, kept] if line.added.size else line.added), gain, e
