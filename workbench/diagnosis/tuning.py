"""Noise levels of the largest likelihood, given what is expected of them.

    minimise over q   -2 log p(y | q) + sum_j ((z_j - z0_j) / width_j)^2,    z_j = log(q_j / expected_j + FLOOR),   q: variances

by L-BFGS-B with exact slopes. The likelihood is that of the linearized plant about the predictor's own trajectory. Where it does
not care about a level, the level stays as expected; one that is none can grow again, which its logarithm would not.
"""

import numpy as np
from scipy.optimize import minimize

from workbench.diagnosis.kalman import Linearization, likelihood
from workbench.diagnosis.predictor import Noise, Predictor, with_decays

READING = 2.0 * np.log(3.0)  # width for the variance of a measurement, which the data sheet or the records state
PUSHING = 2.0 * np.log(30.0)  # the same of what pushes the states
LASTING = np.log(5.0)  # the same of a coloured part's time constant
FLOOR = 0.03
LEAST = 1e-4  # of the variance of a measurement: without any the filter has no gain
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
    pieces = [_piece(predictor, i) for i in range(int(np.ceil(share * len(predictor.records))))]
    nw, nd, nc = (len(own) for own in (predictor.noise.process, predictor.noise.drift, predictor.noise.coloured))
    dt, expected = predictor.plant.dt, _levels(predictor.expected)
    is_push = np.append(np.arange(len(expected)) < nw + nd + nc, [True, True])  # or the time constant of one
    width = np.append(np.where(is_push[:-2], PUSHING, READING), [LASTING, LASTING])
    middle = np.append(np.full(len(expected), np.log(1.0 + FLOOR)), _times(predictor.expected))
    lowest = np.log(FLOOR + np.where(is_push[:-2], 0.0, LEAST))
    times = [(shortest, max(longest, shortest)) for shortest, longest in ((SHORTEST * dt, MEMORY), (QUICKEST * dt, FADED))]
    bounds = np.array([*((low, LARGEST) for low in lowest), *np.log(times)])
    unit = 1.0 / np.sqrt(1.0 / width**2 + sum(len(e) for _, _, e in pieces))  # a well determined level has this deviation

    def noise(z: np.ndarray) -> Noise:
        s = expected * np.sqrt(np.maximum(np.exp(z[:-2]) - FLOOR, 0.0))
        process, drift, coloured, measurement = np.split(s, np.cumsum([nw, nd, nc]))
        return Noise(measurement, process, drift, float(np.exp(z[-2])), coloured, float(np.exp(z[-1])))

    known: dict[bytes, tuple[float, np.ndarray]] = {}  # a search begins where the last one ended

    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        if x.tobytes() not in known:
            known[x.tobytes()] = computed(x * unit)
        value, slope = known[x.tobytes()]
        return value, slope.copy()

    def computed(z: np.ndarray) -> tuple[float, np.ndarray]:
        levels, total, slope = noise(z), 0.0, np.zeros(len(z))
        a = levels.decays(dt)
        for line, gain, e in pieces:
            found = likelihood(with_decays(line, a), levels.pushes, levels.measurement, gain, e, nd + nc)
            by_time = found.decay * a
            total += found.deviance
            slope += np.concatenate([found.process, found.measurement, [by_time[:nd].sum(), by_time[nd:].sum()]])
        if not np.isfinite(total) or not np.isfinite(slope).all():
            return 1e300, np.zeros(len(z))
        off = (z - middle) / width
        slope *= np.append(expected**2 * np.exp(z[:-2]), [dt / levels.memory, dt / levels.correlation_time])
        return float(total + off @ off), (slope + 2.0 * off / width) * unit

    def searched(start: np.ndarray) -> tuple[float, np.ndarray]:
        """Lowest cost, and where, by way of a start."""
        x = np.clip(start, *bounds.T) / unit
        for _ in range(REACHES):
            # a step to where nothing is defined would end a line search
            near = np.clip(bounds / unit[:, None], (x - REACH / unit)[:, None], (x + REACH / unit)[:, None])
            began = cost(x)[0]
            options = {"ftol": ENOUGH / max(abs(began), 1.0), "maxiter": 60}
            found = minimize(cost, x, jac=True, method="L-BFGS-B", bounds=near, options=options)
            x = found.x
            if began - found.fun < AGAIN:
                break
        return cost(x)[0], x

    at = np.append(np.log((_levels(predictor.noise) / expected) ** 2 + FLOOR), _times(predictor.noise))
    # from small pushes that fade fast nothing leads to larger ones that last; and levels that a wrong trajectory has driven up
    # may not come down again on their own
    starts = [at] if again else [np.where(is_push, np.maximum(at, middle), at), middle]
    if nc and not again:  # pushes that have stood for what lasts in the readings do not give way to it: as loud as the white part
        white, readings = slice(nw + nd + nc, len(expected)), slice(nw + nd, nw + nd + nc)
        loud = middle.copy()
        loud[readings] = at[white] + 2.0 * np.log(expected[white] / expected[readings])
        starts.append(loud)
    return noise(min(map(searched, starts), key=lambda found: found[0])[1] * unit)


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
    return Linearization(F, G, H, line.present), gain, e
