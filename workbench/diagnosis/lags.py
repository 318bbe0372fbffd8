"""Times of slow sensors, resonances and dead times, told from the machine's own time constants by a profile.

    D(time) = min over all else of -2 log likelihood + |theta|^2,    noise levels tuned at each time

A slow sensor behind a slow machine is the same chain in another order: only the parameters' data sheet and where the noise enters
tell which is which. Noise levels of a model without the lag, and a start at parameters that had to make up for it, both lead to
the wrong order, and a fit that has arrived there does not cross the ridge between them.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from workbench.diagnosis.fit import Unknowns, gauss_newton
from workbench.diagnosis.predictor import Predictor
from workbench.diagnosis.refit import CONVERGED, Model, settled
from workbench.diagnosis.tuning import tuned
from workbench.physics.effects.effect import Domain
from workbench.physics.plant import Plant
from workbench.records import record

FAR = 3.0  # standard deviations of its prior at which a parameter has left its data sheet
TOGETHER = 0.9  # correlation of a time with a parameter from which on they may have changed places
SHORTEST, LONGEST, RATIO = 0.5, 32.0, np.sqrt(2.0)  # times in samples that are held, and their ratio
BEST, MINIMA = 3, 2  # of the times that are held, fitted further; minima whose times are released
FURTHER = 6  # fits at most
STEP = 1e-3  # standard deviations of a parameter, for differences
SAME = 10.0  # deviance within which two times are told apart by nothing
INTERVAL = 1.96  # standard deviations of a time, or of its difference to a time constant, within which two are not told apart
ALIKE = 0.05  # of a time, within which another minimum is the same one
SHARE = 0.9  # of its gain that a solution far from the data sheet must not lose to one that keeps it


class Other(NamedTuple):
    """A time that suits the records as well, and the interval about it."""

    time: float
    low: float
    high: float

    @classmethod
    def about(cls, time: float, deviation: float) -> "Other":
        """The interval of a time with this standard deviation."""
        return cls(time, time - INTERVAL * deviation, time + INTERVAL * deviation)


@record
class Timed:
    """A model with the time that suits records and data sheet best, and other times that suit them as well."""

    model: Model
    others: tuple[Other, ...] = ()


def timed(before: Model, model: Model, key: str, sizes: np.ndarray) -> Timed:
    """The model with the time of effect `key` where its profile is lowest; before: the model without the effect.

    Where the fit is close to the data sheet, and its time is no other name of a parameter, it stands as it is. A solution far
    outside the tolerances that gains hardly more than one inside loses to it.
    """
    if not shifts(model.predictor.plant, key) or not _exchangeable(model, key):
        return Timed(model)
    minima = [model, *_minima(model, key, sizes)]
    best = min(minima, key=lambda m: m.posterior)
    inside = [m for m in minima if m.farthest <= FAR and before.deviance - m.deviance > SHARE * (before.deviance - best.deviance)]
    if best.farthest > FAR and inside:
        best = min(inside, key=lambda m: m.posterior)
    told = [best]
    for m in minima:
        if _time(m, key) > 0.0 and m.posterior - best.posterior < SAME and all(_apart(m, other, key) for other in told):
            told.append(m)
    return Timed(best, (*(Other.about(_time(m, key), _deviation(m, key)) for m in told[1:]), *_met(best, key)))


def _met(model: Model, key: str) -> list[Other]:
    """Time constants of the machine from which the records do not tell the time: there the two minima have become one.

    The two give way to each other: what is known is their difference, with T = T(theta) linearised.
    """
    if not _remembers(model.predictor.plant, key):
        return []
    time, at, n = _time(model, key), _place(model.fit.unknowns, key).start, model.fit.unknowns.split[0]
    found = []
    for T, own in _slopes(model):
        slope = np.zeros(model.fit.unknowns.size)
        slope[:n] = T * own
        slope[at] = -1.0
        if abs(T - time) < INTERVAL * float(np.sqrt(slope @ model.fit.covariance @ slope)):
            found.append(Other.about(T, 0.0))
    return found


def _apart(one: Model, other: Model, key: str) -> bool:
    """Whether the time of neither is within the interval that the other states, nor all but the same."""
    first, second = _time(one, key), _time(other, key)
    spread = INTERVAL * max(_deviation(one, key), _deviation(other, key))
    return abs(first - second) > max(spread, ALIKE * max(first, second))


def shifts(plant: Plant, key: str) -> bool:
    """Whether an effect is a shift in time by a fitted time."""
    effect = next(slot.effect for slot in plant.slots if slot.key == key)
    return effect.domain is Domain.SHIFT and effect.sizes[0].unit == "s"


def _remembers(plant: Plant, key: str) -> bool:
    """Whether an effect is a lag or a resonance; a dead time is no time constant."""
    return any(slot.effect.memories > 0 for slot in plant.slots if slot.key == key)


def _exchangeable(model: Model, key: str) -> bool:
    """Whether the time may be that of something else: a parameter has left its data sheet, or goes with the time, or the machine
    with its time and the sensor with the machine's would keep the data sheet as well.
    """
    time, n = _time(model, key), model.fit.unknowns.split[0]
    if not time > 0.0 or n == 0:
        return False
    C, at = model.fit.covariance, _place(model.fit.unknowns, key).start
    scale = np.sqrt(np.diag(C))
    if model.farthest > FAR or np.any(np.abs(C[at, :n]) > TOGETHER * scale[at] * scale[:n]):
        return True
    if not _remembers(model.predictor.plant, key):
        return False
    slopes = _slopes(model)
    if not slopes and _time_constants(model):
        return True  # poles that meet: nothing can be said
    # of all parameters at which a time constant is `time` the nearest to the data sheet
    far = [abs(np.log(time / T) + model.fit.z[:n] @ own) / max(float(np.linalg.norm(own)), 1e-300) for T, own in slopes]
    return min(far, default=np.inf) < FAR


def _slopes(model: Model) -> list[tuple[float, np.ndarray]]:
    """Each time constant T of the machine with d log T / d theta (n,); none where poles meet."""
    own = _time_constants(model)
    moved = [_time_constants(model, by) for by in STEP * np.eye(model.fit.unknowns.split[0])]
    if any(len(m) != len(own) for m in moved):
        return []
    return [(T, np.log(np.array([m[j] for m in moved]) / T) / STEP) for j, T in enumerate(own)]


def _minima(model: Model, key: str, sizes: np.ndarray) -> list[Model]:
    """Models at the lowest minima of the profile, and with the time and the machine's exchanged, their times released."""
    held = _profiled(model, key, sizes)
    for time in sorted(held, key=lambda time: held[time].posterior)[:BEST]:
        held[time] = _converged(held[time], sizes)
    lowest = min(held, key=lambda time: held[time].posterior)
    for time in (lowest * RATIO**-0.5, lowest * RATIO**0.5):
        near = held[lowest]
        held[time] = _fitted(near.predictor, _holding(model.fit.unknowns, key, time), near.fit.z, sizes, regains=2)
    times = sorted(time for time in held if held[time].deviance < np.inf)
    cost = [np.inf, *(held[time].posterior for time in times), np.inf]
    lows = sorted(
        (c, time) for before, c, after, time in zip(cost, cost[1:], cost[2:], times, strict=False) if c < min(before, after)
    )
    found = [_released(model, held[time], key, time, sizes) for _, time in lows[:MINIMA]]
    return found + [_released(model, own, key, time, sizes) for time, own in _exchanged(model, key, sizes)]


def _exchanged(model: Model, key: str, sizes: np.ndarray) -> Iterator[tuple[float, Model]]:
    """Models in which the time is a time constant of the machine, and that one the time, by the least move of the parameters.

    On the grid of the profile such a minimum may be a hole between two points: it is as narrow as the records are good.
    """
    n, at = model.fit.unknowns.split[0], _place(model.fit.unknowns, key).start
    if not _remembers(model.predictor.plant, key):
        return
    for T, slope in _slopes(model):
        z = model.fit.z.copy()
        z[:n] += slope * np.log(_time(model, key) / T) / max(slope @ slope, 1e-300)
        if np.abs(z[:n]).max(initial=0.0) <= 2.0 * FAR:
            unknowns = _holding(model.fit.unknowns, key, T)
            own = _fitted(model.predictor, unknowns, np.delete(z, at), sizes, regains=2, near=False)
            yield T, _converged(own, sizes)


def _converged(model: Model, sizes: np.ndarray) -> Model:
    """The model fitted further: released before, a time runs to the next minimum from wherever it is."""
    for _ in range(FURTHER):
        again = _fitted(model.predictor, model.fit.unknowns, model.fit.z, sizes)
        gained = model.posterior - again.posterior
        model = again if gained > 0.0 else model
        if gained < CONVERGED:
            break
    return model


def _profiled(model: Model, key: str, sizes: np.ndarray) -> dict[float, Model]:
    """Models with the time held, from nominal parameters, each with the gains of its neighbour to begin with."""
    own, unknowns, dt = _time(model, key), model.fit.unknowns, model.predictor.plant.dt
    longest = max(LONGEST * dt, 2.0 * own, *(2.0 * T for T in _time_constants(model)))
    times = SHORTEST * dt * RATIO ** np.arange(int(np.ceil(np.log(longest / (SHORTEST * dt)) / np.log(RATIO))) + 1)
    nominal = model.fit.z.copy()
    nominal[: unknowns.split[0]] = 0.0
    nominal = np.delete(nominal, _place(unknowns, key).start)
    middle = int(np.argmin(np.abs(np.log(times / own))))
    made: dict[float, Model] = {}
    for outward in (times[middle:], times[:middle][::-1]):
        near = made.get(float(times[middle]), model)
        for time in outward.tolist():
            holding = _holding(unknowns, key, time)
            near = made[time] = _fitted(near.predictor, holding, nominal, sizes, regains=2, near=near is not model)
    return made


def _fitted(
    predictor: Predictor, unknowns: Unknowns, z: np.ndarray, sizes: np.ndarray, *, regains: int = 1, near: bool = True
) -> Model:
    """Gains and noise levels at z, then a fit of two Jacobians; near: the predictor's levels are those of a time close by."""
    predictor = predictor.regained(unknowns.point(z), rounds=regains)
    predictor = predictor.with_noise(tuned(predictor, again=near))
    return Model(predictor, gauss_newton(predictor, unknowns, z, sizes, rounds=2, enough=0.5))


def _released(model: Model, held: Model, key: str, time: float, sizes: np.ndarray) -> Model:
    """The model with its time fitted too, from where it was held."""
    unknowns = model.fit.unknowns
    z = np.insert(held.fit.z, _place(unknowns, key).start, time)
    return settled(Model(held.predictor, gauss_newton(held.predictor, unknowns, z, sizes, rounds=3, enough=0.2)), sizes)


def _holding(unknowns: Unknowns, key: str, time: float) -> Unknowns:
    """The unknowns without the time of an effect, which is held."""
    own = next(t for t in unknowns.terms if t.key == key)
    base = unknowns.base.copy()
    base[own.sizes[0]] = time
    return replace(unknowns, terms=tuple(replace(t, sizes=()) if t is own else t for t in unknowns.terms), base=base)


def _place(unknowns: Unknowns, key: str) -> slice:
    return next(own for t, own in zip(unknowns.terms, unknowns.places, strict=True) if t.key == key)


def _time(model: Model, key: str) -> float:
    return float(model.fit.z[_place(model.fit.unknowns, key).start])


def _deviation(model: Model, key: str) -> float:
    """Standard deviation of the time."""
    at = _place(model.fit.unknowns, key).start
    return float(np.sqrt(model.fit.covariance[at, at]))


def _time_constants(model: Model, by: np.ndarray | float = 0.0) -> list[float]:
    """Time constants of the fitted machine where it starts, slowest first, as far as a record is long enough to show them.

    by (n): a move of its parameters.
    """
    predictor, unknowns = model.predictor, model.fit.unknowns
    plant, record, z = predictor.plant, predictor.records[0], model.fit.z.copy()
    z[: unknowns.split[0]] += by
    point = unknowns.point(z)
    A = np.zeros((0, 0)) if plant.discrete else plant.linearize(point.start[0], record.u[0], point.p)[0]
    if not np.isfinite(A).all():
        return []
    least = 4.0 / (plant.dt * max(len(r) for r in predictor.records))
    return [1.0 / rate for rate in sorted((-np.linalg.eigvals(A).real).tolist()) if rate > least]
