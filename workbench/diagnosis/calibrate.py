"""Calibration: named physical parameters from records, within bounds, with what a data sheet leaves open as prior.

    p = nominal exp(sigma theta),  theta ~ N(0, 1) before,  N(theta^, P) after;  sigma = tolerance / sqrt 3

The 95 % interval of p is nominal exp(sigma (theta^ -+ 1.96 sqrt P_ii)); 1 - sqrt P_ii is how much the records say against
the data sheet. Starts of records and noise levels are found on the way. The values are those of the likelihood one step ahead or
those of the free run, whichever err less a second and the full run ahead.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from workbench.data import Dataset
from workbench.diagnosis.answer import Gain
from workbench.diagnosis.fit import sharpened, term
from workbench.diagnosis.free_run import filtered
from workbench.diagnosis.gains import errors
from workbench.diagnosis.growth import GONE, spread, unstable
from workbench.diagnosis.predictor import predictor
from workbench.diagnosis.recalibrate import Calibrated, recalibrated, unknowns
from workbench.diagnosis.referee import Judge, as_given
from workbench.diagnosis.refit import Model, lasting
from workbench.errors import InputError, check_known
from workbench.physics.parameters import Parameter
from workbench.physics.plant import Plant
from workbench.records import field, record

TWO_SIDED = 1.959964  # standard deviations on either side of 95 %
TOGETHER = 0.99  # correlation above which two parameters only count together
RUNAWAY = 1e6  # times what is measured: a run that is this far away has left its range
SILENT = 0.05  # a parameter of which the records say less than this is known from the data sheet alone

Bounds = Mapping[str, tuple[float, float]]


@record
class Fitted:
    """A fitted parameter with its 95 % interval; told: how much the records say against the prior, 0 nothing, 1 all.

    held: it would go beyond the bound that it stands at, so its interval is that one value.
    """

    nominal: Parameter
    value: float
    low: float
    high: float
    told: float
    held: bool = False

    @property
    def name(self) -> str:
        return self.nominal.name

    @property
    def shift(self) -> float:
        """Relative distance from nominal."""
        return self.value / self.nominal.value - 1.0

    @property
    def warning(self) -> str:
        """What is odd about the value, in a sentence; empty where nothing is."""
        q = self.nominal
        if self.held:
            return f"{q.name} stands at its bound {self.value:.4g} {q.unit}: the records ask for more".strip()
        if abs(self.shift) > q.tolerance:
            moved, open_ = 100 * self.shift, 100 * q.tolerance
            return f"{q.name} is {moved:+.3g} % from nominal, beyond its tolerance of {open_:.3g} %: look for a cause"
        if self.told < SILENT:
            return f"{q.name}: these records say nothing about it, the value is the data sheet's"
        return ""


@record
class Pair:
    """Two parameters of which the records show one combination only."""

    first: str
    second: str
    correlation: float
    sentence: str


@record
class Trajectory:
    """Outputs of a plant along a record, (N, ny): measured (NaN where not), predicted one step ahead, and simulated.

    simulated: from the estimated `start` on, driven by the logged inputs alone. NaN once one has left the plant's range; of an
    unstable plant, once it has left the record.
    """

    record: str
    t: np.ndarray = field("N", unit="s")
    measured: np.ndarray = field(None)
    predicted: np.ndarray = field(None)
    simulated: np.ndarray = field(None)
    start: Mapping[str, float] = field(default_factory=dict)


@record
class Calibration:
    """The plant with its fitted parameters, what is known of each, pairs that only count together, starts and noise levels.

    objections: where it is worse than the plant that it replaces, so that it is not handed out. compared: how far free runs were,
    a sentence, where the plant is unstable.
    """

    plant: Plant
    parameters: tuple[Fitted, ...]
    pairs: tuple[Pair, ...]
    starts: Mapping[str, Mapping[str, float]]
    noise: Mapping[str, float]
    objections: tuple[str, ...] = ()
    compared: str = ""

    @property
    def values(self) -> dict[str, float]:
        return {p.name: p.value for p in self.parameters}

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is odd, in sentences."""
        kept = " and ".join(self.plant.effects)
        said = f"the size of {kept} is not fitted: the intervals hold for the size that the plant states" if kept else ""
        return tuple(sentence for sentence in (*(p.warning for p in self.parameters), said) if sentence)


def calibrate(
    plant: Plant,
    dataset: Dataset,
    held_out: Dataset | None = None,
    *,
    names: Sequence[str] | None = None,
    bounds: Bounds | None = None,
) -> Calibration:
    """Fit the parameters called `names` (default: all with a tolerance, and those with a bound) to the records.

    held_out: records on which the fits are compared with each other and with the plant as it came (default: parts of the same
    records, each left out of the fit in turn).

    A parameter that would leave its bounds is held there and the others are fitted again. A bound is also the tolerance of a
    parameter that has none. Raises InputError for unknown names, bounds upside down or without the nominal value, and
    parameters that are neither open by their tolerance nor bounded.
    """
    bounds = dict(bounds or {})
    opened = _opened(plant, names, bounds)
    free = [q.name for q in opened.parameters if q.tolerance > 0.0 and (names is None or q.name in (*names, *bounds))]
    if not free:
        raise InputError(
            "no parameter is open: none has a tolerance or a bound",
            file=plant.name,
            mend="give a --bound; the numbers of an identified model are fitted by identify, and diagnose says what it lacks",
        )
    done, held = _inside(opened, dataset, free, bounds)
    judge = Judge(held_out or dataset, held_out is not None)
    given = as_given(plant, dataset)
    model = judge.better_ahead(given, Model(done.predictor, done.fit))
    freely = Calibrated(model.predictor, model.fit)
    if all(_beyond(f, bounds[f.name]) <= 0.0 for f in _fitted(opened, freely, held) if f.name in bounds and f.name not in held):
        done = freely
    done = replace(done, fit=sharpened(done.predictor, done.fit))
    fitted = _fitted(opened, done, held)
    objections = judge.objections("calibrated", given, Model(done.predictor, done.fit))
    found = done.predictor
    starts = {
        r.name: dict(zip(plant.state_names, x.tolist(), strict=True))
        for r, x in zip(found.records, done.fit.point.start, strict=True)
    }
    levels = filtered(Model(done.predictor, done.fit)).predictor.noise.measurement
    noise = {
        name: float(levels[i])
        for i, name in enumerate(plant.output_names)
        if any(np.isfinite(r.y[:, i]).any() for r in found.records)
    }
    values = {f.name: f.value for f in fitted}
    return Calibration(
        plant.with_parameters(values), fitted, _pairs(fitted, done), starts, noise, objections, judge.compared(model)
    )


def _inside(plant: Plant, dataset: Dataset, free: Sequence[str], bounds: Bounds) -> tuple[Calibrated, dict[str, float]]:
    """A fit of the parameters `free`, and those of them that are held at one of their bounds."""
    held: dict[str, float] = {}
    while True:
        at = predictor(plant.with_parameters(held), dataset)
        done = recalibrated(at, own=unknowns(at, names=[name for name in free if name not in held]))
        lasting(Model(done.predictor, done.fit), plant.name)
        fitted = _fitted(plant, done, held)
        beyond = {f.name: _beyond(f, bounds[f.name]) for f in fitted if f.name in bounds and f.name not in held}
        worst = max(beyond, key=lambda name: beyond[name], default="")
        if not worst or beyond[worst] <= 0.0:
            return done, held
        value = next(f.value for f in fitted if f.name == worst)
        held[worst] = float(np.clip(value, *bounds[worst]))


def _opened(plant: Plant, names: Sequence[str] | None, bounds: Bounds) -> Plant:
    known = [q.name for q in plant.parameters]
    for name in (*(names or ()), *bounds):
        check_known("parameter", name, known, file=plant.name)
    opened = []
    for q in plant.parameters:
        if q.name in bounds:
            low, high = bounds[q.name]
            if not low < high:
                raise InputError(
                    f"bound {low:g}:{high:g} of {q.name}: its low end is not below its high end",
                    file=plant.name,
                    mend=f"write --bound {q.name}={high:g}:{low:g}" if low > high else f"give --bound {q.name}=LOW:HIGH",
                )
            if not low <= q.value <= high:
                raise InputError(
                    f"bound {low:g}:{high:g} does not hold the nominal {q.name} = {q.value:g} {q.unit}",
                    file=plant.name,
                    mend=f"give --bound {q.name}=LOW:HIGH around it",
                )
            if not q.tolerance:
                q = replace(q, tolerance=max(high - q.value, q.value - low) / q.value if q.value else 0.0)
        if q.name in (*(names or ()), *bounds) and not (q.tolerance > 0.0 and q.value > 0.0):
            fault = "has no tolerance" if q.value > 0.0 else f"is {q.value:g}, and only positive parameters are fitted"
            raise InputError(
                f"parameter {q.name} {fault}", file=plant.name, mend=f"give --bound {q.name}=LOW:HIGH, or leave it out"
            )
        opened.append(q)
    return replace(plant, parameters=tuple(opened))


def _fitted(opened: Plant, done: Calibrated, held: Mapping[str, float]) -> tuple[Fitted, ...]:
    own, free = done.fit.unknowns, {}
    for j, i in enumerate(own.parameters):
        q, sigma, theta = opened.parameters[i], own.sigma[j], done.fit.z[j]
        deviation = float(np.sqrt(done.fit.covariance[j, j]))
        value, low, high = (float(q.value * np.exp(sigma * (theta + side * TWO_SIDED * deviation))) for side in (0.0, -1.0, 1.0))
        free[q.name] = Fitted(q, value, low, high, max(1.0 - deviation, 0.0))
    for q in opened.parameters:
        if q.name in held:
            free[q.name] = Fitted(q, held[q.name], held[q.name], held[q.name], 1.0, held=True)
    return tuple(free[q.name] for q in opened.parameters if q.name in free)


def _beyond(f: Fitted, bound: tuple[float, float]) -> float:
    """How far a value is outside its bound, relative to nominal; negative inside."""
    low, high = bound
    return max(low - f.value, f.value - high) / f.nominal.value


def _pairs(fitted: Sequence[Fitted], done: Calibrated) -> tuple[Pair, ...]:
    free = [f for f in fitted if not f.held]
    sigma = done.fit.unknowns.sigma
    P = done.fit.covariance[: len(sigma), : len(sigma)] * np.outer(sigma, sigma)  # of log p
    found = []
    for i in range(len(free)):
        for j in range(i + 1, len(free)):
            correlation = float(P[i, j] / np.sqrt(P[i, i] * P[j, j]))
            if abs(correlation) > TOGETHER:
                found.append(_pair(free[i].name, free[j].name, correlation, float(np.sqrt(P[i, i] / P[j, j]))))
    return tuple(found)


def _pair(first: str, second: str, correlation: float, power: float) -> Pair:
    """What two correlated parameters count as; power: by how many per cent the first moves where the second moves by one."""
    if 0.9 < power < 1.1:
        together = f"{first}/{second}" if correlation > 0 else f"{first} times {second}"
        said = f"only count as {together}: their single values rest on the data sheet"
    else:
        side = "larger" if correlation > 0 else "smaller"
        said = f"only count together: where {second} is 1 % larger, {first} is {power:.2g} % {side}"
    return Pair(first, second, correlation, f"{first} and {second} {said}")


# ---- what a plant does along records -------------------------------------------------------------------------------------


def trajectories(plant: Plant, dataset: Dataset) -> tuple[Trajectory, ...]:
    """A plant as it is along records: its parameters stay, starts and noise levels are estimated for each record alone."""
    return tuple(_trajectory(plant, Dataset((e,))) for e in dataset)


def along(plant: Plant, one: Dataset) -> Calibrated:
    """A predictor of a plant as it is along one record: gains, noise levels and start are fitted to that record.

    So are the numbers of an effect with a phase, which every record has of its own.
    """
    at = predictor(plant, one)
    phased = dict.fromkeys(slot.key for slot in plant.slots if slot.effect.phase and slot.key in plant.effects)
    terms, eta = [term(plant, key) for key in phased], plant.effect_vector()
    sizes = np.zeros(len(eta))
    for t in terms:
        sizes[list(t.sizes)] = 1e-3 * float(np.linalg.norm(eta[list(t.sizes)]))
    return recalibrated(at, own=unknowns(at, terms, names=()), sizes=sizes)


def _trajectory(plant: Plant, one: Dataset) -> Trajectory:
    e, done = one.experiments[0], along(plant, one)
    found, start = done.predictor, done.fit.point.start[0]
    y = found.records[0].y
    far = GONE * spread(y) if unstable(found) else np.full(y.shape[1], np.inf)
    predicted, simulated = (
        _until_lost(y, errors(found, done.fit.point, 0, horizon), far) for horizon in ("one-step", "full-run")
    )
    by_name = dict(zip(plant.state_names, start.tolist(), strict=True))
    return Trajectory(e.name, e.t, y, predicted, simulated, by_name)


def _until_lost(y: np.ndarray, error: np.ndarray, far: np.ndarray) -> np.ndarray:
    """What was predicted of y (N, ny), NaN from where one output has left its range, or is further from y than far (ny)."""
    run = y - error
    near = (np.abs(run) < RUNAWAY * (1.0 + np.abs(y))) & (np.abs(error) <= far)
    lasts = np.logical_and.accumulate((near | ~np.isfinite(y)).all(axis=1))
    return np.where(lasts[:, None], run, np.nan)


def gains(plant: Plant, before: Sequence[Trajectory], after: Sequence[Trajectory]) -> tuple[Gain, ...]:
    """Root mean square errors of each measured output, one step ahead and over the full run, before and after."""
    found = []
    for old, new in zip(before, after, strict=True):
        for i, channel in enumerate(plant.outputs):
            if not np.isfinite(old.measured[:, i]).any():
                continue
            for horizon, series in (("one-step", "predicted"), ("full-run", "simulated")):
                both = [_rms(run.measured[:, i] - getattr(run, series)[:, i], run.measured[:, i]) for run in (old, new)]
                found.append(Gain(channel.name, horizon, both[0], both[1], channel.unit, old.record))
    return tuple(found)


def _rms(error: np.ndarray, measured: np.ndarray) -> float:
    """Over what was measured; NaN where a run did not last."""
    return float(np.sqrt(np.mean(error[np.isfinite(measured)] ** 2)))
