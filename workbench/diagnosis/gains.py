"""What an extension gains on records: errors one step ahead, one second ahead, and over the whole record.

On held-out records parameters and effects stay as they were found; where a record starts, and at which angle its periodic
effects, is found on it. On the records of the fit each part is predicted with what the fit finds without it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from workbench.data import Dataset
from workbench.diagnosis.answer import Gain
from workbench.diagnosis.confirm import left_out_points
from workbench.diagnosis.fit import Unknowns, gauss_newton
from workbench.diagnosis.free_run import filtered
from workbench.diagnosis.growth import FAR, GONE, SECOND, reach, spread, unstable
from workbench.diagnosis.predictor import Point, Predictor, predictor
from workbench.diagnosis.refit import Model
from workbench.physics import stepper
from workbench.records import record

HORIZONS = ONE_STEP, ONE_SECOND, FULL_RUN = "one-step", "one-second", "full-run"
BEHIND = "-second"  # a horizon that is not a second, for the plant is unstable, is named by its seconds: "0.14-second"
SETTLING = 10  # samples at the start of a record that are not counted
PHASES = 16  # at which a periodic effect is tried on a record
LANES = 32  # starts a second ahead that run side by side
LOST = 1e100  # error of a run that was lost: its square is still a number


@record
class Score:
    """A channel's root mean square error on a record, for one horizon."""

    record: str
    horizon: str
    channel: str
    unit: str
    error: float


def on(model: Model, dataset: Dataset) -> tuple[Predictor, Point]:
    """A predictor of other records with the parameters, effects and noise levels of a model, and their own starts and phases."""
    made = predictor(model.predictor.plant, dataset, threads=model.predictor.threads)
    old = model.fit.unknowns
    point = model.fit.point
    n = len(made.records)
    lent = model.predictor
    made = replace(made, plant=lent.plant, substeps=lent.substeps, entries=lent.entries, simulated=lent.simulated)
    terms = tuple(replace(t, free=()) for t in old.terms if t.phase)
    plant = model.predictor.plant
    unknowns = Unknowns(
        plant,
        n,
        (),
        np.empty(0),
        np.array([r.start for r in made.records]),
        np.array([r.scale for r in made.records]),
        terms,
        point.p,
        point.eta[0],
    )
    sizes = np.zeros(len(plant.slots))
    for t in terms:
        sizes[list(t.sizes)] = 1e-3 * np.linalg.norm(point.eta[0][list(t.sizes)])
    still = _without_periodic(unknowns)
    made = made.regained(still.point(still.zero()), model.predictor.noise)
    z = gauss_newton(made, still, still.zero(), sizes, rounds=2, enough=0.5).z
    made = made.regained(still.point(z))
    if terms:
        z = _turned(made, unknowns, np.concatenate([z, unknowns.zero()[len(z) :]]))
        made = made.regained(unknowns.point(z))
        z = _of_same_amplitude(unknowns, gauss_newton(made, unknowns, z, sizes, rounds=2, enough=0.5).z)
        made = made.regained(unknowns.point(z))
    return made, unknowns.point(z)


def _without_periodic(unknowns: Unknowns) -> Unknowns:
    """The starts alone, all periodic effects off: what is off at the start hides any phase."""
    base = unknowns.base.copy()
    for t in unknowns.terms:
        base[list(t.sizes)] = 0.0
    return replace(unknowns, terms=(), base=base)


def _turned(made: Predictor, unknowns: Unknowns, z: np.ndarray) -> np.ndarray:
    """The unknowns with every periodic effect at the phase that suits each record best.

    From a wrong phase a fit makes the amplitude small first, and then any phase will do.
    """
    z, angles = z.copy(), 2.0 * np.pi * np.arange(PHASES) / PHASES
    for t, own in zip(unknowns.terms, unknowns.places, strict=True):
        at = own.start
        point, amplitude, best = unknowns.point(z), np.linalg.norm(z[at : at + 2]), []
        for i in range(unknowns.records):
            eta = np.repeat(point.eta[i][None], PHASES, axis=0)
            eta[:, list(t.sizes)] = amplitude * np.column_stack([np.cos(angles), np.sin(angles)])
            cost = (made.errors(i, point.p[None], eta, point.start[i][None]) ** 2).sum(axis=(1, 2))
            best.append(_lowest(cost, angles))
        z[at : at + 2] = amplitude * np.array([np.cos(best[0]), np.sin(best[0])])
        z[at + 2 : own.stop] = np.array(best[1:]) - best[0]
    return z


def _lowest(cost: np.ndarray, angles: np.ndarray) -> float:
    """Where a cost over a full turn is lowest, by its first two harmonics: a squared error has no more."""
    fine = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    waves = [np.mean(cost * np.exp(-1j * k * angles)) * np.exp(1j * k * fine) for k in (1, 2)]
    return float(fine[np.argmin(np.real(sum(waves)))])


def _of_same_amplitude(unknowns: Unknowns, z: np.ndarray) -> np.ndarray:
    """Phases are found on the record, amplitudes are not."""
    z = z.copy()
    for t, own in zip(unknowns.terms, unknowns.places, strict=True):
        pair = slice(own.start, own.start + 2)
        stated, found = np.linalg.norm(unknowns.base[list(t.sizes)]), np.linalg.norm(z[pair])
        z[pair] *= stated / found if found > 0.0 else 0.0
    return z


def horizons(seconds: float) -> tuple[str, str, str]:
    """One step, so many seconds ahead, and the full run."""
    return ONE_STEP, ONE_SECOND if seconds == SECOND else f"{seconds:g}{BEHIND}", FULL_RUN


def errors(made: Predictor, point: Point, i: int, horizon: str) -> np.ndarray:
    """Errors (N, ny) of record i at one of `horizons`, NaN where there is none."""
    r = made.records[i]
    p, eta, start = point.p[None], point.eta[i][None], point.start[i][None]
    if horizon == ONE_STEP:
        e = made.errors(i, p, eta, start, white=False)[0]
    elif horizon == FULL_RUN:
        e = r.y - made._run(r, p, eta, start, stepper.Steering()).measured[0]
    else:
        seconds = SECOND if horizon == ONE_SECOND else float(horizon.removesuffix(BEHIND))
        e = _ahead(made, point, i, max(1, round(seconds / made.plant.dt)))
    return np.where(np.isfinite(r.y), e, np.nan)


def _ahead(made: Predictor, point: Point, i: int, steps: int) -> np.ndarray:
    """Prediction errors `steps` samples ahead: runs that start anew from the corrected state every so many samples."""
    r = made.records[i]
    N = len(r)
    if steps >= N:
        return np.full_like(r.y, np.nan)
    corrected = made.corrected(i, point)
    lanes = min(steps, LANES)
    offsets = np.linspace(0, steps, lanes, endpoint=False).astype(int)
    restart = np.full((N, corrected.shape[1], lanes), np.nan)
    for c, first in enumerate(offsets):
        restart[first::steps, :, c] = corrected[first::steps]
    ran = made._run(
        r, point.p[None], np.repeat(point.eta[i][None], lanes, axis=0), point.start[i][None], stepper.Steering(restart=restart)
    )
    e = np.full_like(r.y, np.nan)
    for c, first in enumerate(offsets):
        at = np.arange(first + steps, N, steps)
        e[at] = r.y[at] - ran.measured[c][at]
    return e


@record
class Held:
    """A model on records of others: root mean square errors by record, horizon and channel, and -2 log likelihood.

    squares: the squared errors behind each score, sample by sample, NaN where there is none and inf where a run was lost.
    far: of each score, the error beyond which a run does not follow its record and two of them say nothing; infinite where the
    plant is stable.
    """

    scores: tuple[Score, ...]
    deviance: float
    squares: tuple[np.ndarray, ...] = ()
    dt: float = 0.0
    far: tuple[float, ...] = ()


def errors_on(model: Model, dataset: Dataset, seconds: float = SECOND) -> Held:
    """The model's errors on the records of `dataset`, one of them so many seconds ahead, and how likely they are in its light;
    starts do not count.

    A model of free runs has errors with a filter of its own, and is likely by its free runs.
    """
    made, point = on(filtered(model), dataset)
    weighing, at = on(model, dataset) if model.predictor.simulated else (made, point)
    squares = [{horizon: _squares(made, point, i, horizon) for horizon in horizons(seconds)} for i in range(len(made.records))]
    return _held(made, squares, float(np.sum([_deviances(weighing, at, i)[SETTLING:].sum() for i in range(len(made.records))])))


def errors_left_out(model: Model, seconds: float = SECOND) -> Held:
    """The same on the model's own records, each part of them with the parameters that the fit finds without it."""
    made = filtered(model).predictor
    squares = [{horizon: np.full_like(r.y[SETTLING:], np.nan) for horizon in horizons(seconds)} for r in made.records]
    deviance = 0.0
    for fold, point in left_out_points(model):
        i, part = fold.record, slice(max(fold.first - SETTLING, 0), max(fold.last - SETTLING, 0))
        for horizon in horizons(seconds):
            squares[i][horizon][part] = _squares(made, point, i, horizon)[part]
        deviance += float(_deviances(model.predictor, point, i)[SETTLING:][part].sum())
    return _held(made, squares, deviance)


def _squares(made: Predictor, point: Point, i: int, horizon: str) -> np.ndarray:
    """Squared errors (N - SETTLING, ny) of record i; NaN where there is none, inf where the run was lost."""
    y = made.records[i].y[SETTLING:]
    with np.errstate(over="ignore", invalid="ignore"):
        e = errors(made, point, i, horizon)[SETTLING:]
        square = np.where(np.abs(e) < LOST, e**2, np.where(np.isnan(y), np.nan, np.inf))
    if horizon not in (ONE_STEP, FULL_RUN):  # its first seconds have no error
        square[np.isnan(e)] = np.nan
    return square


def _deviances(made: Predictor, at: Point, i: int) -> np.ndarray:
    return made.deviances(i, made.errors(i, at.p[None], at.eta[i][None], at.start[i][None])[0])


def _held(made: Predictor, squares: Sequence[Mapping[str, np.ndarray]], deviance: float) -> Held:
    """Scores of squared errors by record and horizon."""
    found, kept, far = [], [], []
    runs_away = unstable(made)
    for r, by_horizon in zip(made.records, squares, strict=True):
        for horizon, square in by_horizon.items():
            for channel in np.flatnonzero(np.isfinite(r.y).any(axis=0)):
                c, own = made.plant.outputs[channel], square[:, channel]
                told = own[~np.isnan(own)]
                rms = float(np.sqrt(told.mean())) if len(told) else np.nan
                found.append(Score(r.name, horizon, c.name, c.unit, rms if rms < np.inf else np.nan))
                kept.append(own)
                far.append(FAR * float(spread(r.y)[channel]) if runs_away else np.inf)
    return Held(tuple(found), deviance, tuple(kept), made.plant.dt, tuple(far))


def gained(before: Held, after: Held) -> tuple[Gain, ...]:
    """Errors of two models beside each other; NaN where neither follows the record, and where one is GONE from it."""
    found, lost = [], followed_by_neither(before, after)
    for k, (b, a, far) in enumerate(zip(before.scores, after.scores, before.far, strict=True)):
        old, new = (s.error if s.error <= GONE / FAR * far and k not in lost else np.nan for s in (b, a))
        found.append(Gain(b.channel, b.horizon, old, new, b.unit, b.record))
    return tuple(found)


def followed_by_neither(before: Held, after: Held) -> set[int]:
    """The scores of runs in which neither of two models follows its record: one output tells it for all of them.

    A cart may stay near its record while its pendulum has long fallen down.
    """
    lost = set()
    for s, b, a, far in zip(before.scores, before.squares, after.squares, before.far, strict=False):
        told = ~np.isnan(b) & ~np.isnan(a)
        if told.any() and min(float(np.mean(b[told])), float(np.mean(a[told]))) > far**2:
            lost.add((s.record, s.horizon))
    return {k for k, s in enumerate(before.scores) if (s.record, s.horizon) in lost}


def ahead(before: Model, after: Model) -> float:
    """Errors a second ahead on the models' own records, after over before: geometric mean over channels and records.

    Of an unstable plant as far ahead as `growth` says.
    """
    logs = []
    _, horizon, _ = horizons(reach(before.predictor))
    for i in range(len(before.predictor.records)):
        e = [errors(m.predictor, m.fit.point, i, horizon) for m in (before, after)]
        for j in np.flatnonzero(np.isfinite(e[0]).any(axis=0)):
            old, new = (np.nanmean(x[:, j] ** 2) for x in e)
            logs.append(0.5 * np.log(max(new, 1e-300) / max(old, 1e-300)))
    return float(np.exp(np.mean(logs))) if logs else 1.0
