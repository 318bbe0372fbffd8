"""Records of the EMPS benchmark, laws of friction that are fitted to them, and what is read off records beside a law."""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.signal import butter, sosfiltfilt

from plants import POSITIONING_AXIS
from workbench.data import Dataset, Experiment
from workbench.diagnosis.answer import ROUNDED, Diagnosis
from workbench.diagnosis.fit import gauss_newton
from workbench.diagnosis.gains import HORIZONS, errors, on
from workbench.diagnosis.predictor import Noise, predictor
from workbench.diagnosis.recalibrate import recalibrated, unknowns
from workbench.diagnosis.refit import Model, refit, settled
from workbench.diagnosis.screen import scores, signatures, small_sizes, variants
from workbench.errors import InputError
from workbench.physics.extension import extension
from workbench.physics.parameters import EffectSizes
from workbench.physics.plant import Plant
from workbench.readers import read_file
from workbench.records import field, record

FreeRuns = Mapping[str, Mapping[str, float]]  # errors by law and record
ESTIMATION, HELD_OUT = "DATA_EMPS.mat", "DATA_EMPS_PULSES.mat"
SOURCE = "Janot, Gautier, Brunot 2019"
SHORT = 12.42  # s: two of the four periods of the motion
PUBLISHED = {"M": 95.1089, "Fv": 203.5034, "Fc": 20.3935, "offset": -3.1648}  # kg, N s/m, N, N; force = ... + offset
BAND = 30.0  # Hz, of the force from which the picture over speed is drawn
SPEEDS = 24  # bins of speed
FREE = 2e-3  # m, standard deviation of the position where a free run is fitted
COULOMB, BY_SIDE, OFFSET, DELAY = "coulomb@slide", "asymmetric-friction@slide", "offset@F", "input-delay@F"


def _two_viscosities(x, u, p, at):
    forward, backward = 0.5 * (x.v + abs(x.v)), 0.5 * (x.v - abs(x.v))
    return {"q": x.v, "v": (u.F - p.Fv_forward * forward - p.Fv_backward * backward + at.slide.torque()) / p.M}


VISCOUS = POSITIONING_AXIS.parameters[1]
TWO_VISCOSITIES = replace(
    POSITIONING_AXIS,
    name="positioning-axis-by-direction",
    equation=_two_viscosities,
    parameters=(
        POSITIONING_AXIS.parameters[0],
        *(replace(VISCOUS, name=f"Fv_{way}", meaning=f"viscous friction {way}") for way in ("forward", "backward")),
    ),
)  # fmt: skip


@record
class Law:
    """A law of friction to be compared: a plant with effects that are fitted, or with numbers that are taken as they are.

    drift: whether a slow force may be noise beside it.
    """

    name: str
    plant: Plant = POSITIONING_AXIS
    effects: tuple[str, ...] = ()
    given: EffectSizes | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    drift: bool = False


VISCOUS_ALONE = Law("viscous")
TWO_SIDED = Law("viscous by direction, dry", TWO_VISCOSITIES, (COULOMB,))
TWO_SIDED_OFFSET = Law("viscous by direction, dry, offset", TWO_VISCOSITIES, (COULOMB, OFFSET))
DRY_BY_SIDE = Law("viscous, dry by direction", effects=(BY_SIDE,))
DRY_OFFSET = Law("viscous, dry, offset", effects=(COULOMB, OFFSET))
DRIFTING = Law("the same beside slow noise", effects=(BY_SIDE,), drift=True)
DELAYED = Law("viscous, dry by direction, delay", effects=(BY_SIDE, DELAY))
AS_PUBLISHED = Law(
    "viscous, dry, offset as published",
    given={COULOMB: {"level": PUBLISHED["Fc"], "width": 1e-3}, OFFSET: {"level": -PUBLISHED["offset"]}},
    parameters={name: PUBLISHED[name] for name in ("M", "Fv")},
)
LAWS = (
    VISCOUS_ALONE, Law("viscous, dry", effects=(COULOMB,)), DRY_BY_SIDE, DRIFTING, DELAYED, DRY_OFFSET, AS_PUBLISHED,
    TWO_SIDED, TWO_SIDED_OFFSET,
)  # fmt: skip
FREE_RUNS = (DRY_BY_SIDE, DRY_OFFSET, TWO_SIDED)
QUICK = (VISCOUS_ALONE, DRY_BY_SIDE, DRY_OFFSET, AS_PUBLISHED, TWO_SIDED)


@record
class Records:
    """The record that is diagnosed, the one that is only predicted, the pulses on it (N, where its file tells), and the files."""

    estimation: Experiment
    held_out: Experiment
    pulses: np.ndarray | None
    files: tuple[Path, ...]

    @property
    def both(self) -> tuple[Experiment, Experiment]:
        return self.estimation, self.held_out


@record
class Judged:
    """A law with its numbers: the fitted model, errors (N) by record and horizon [m]."""

    law: Law
    model: Model
    errors: Mapping[tuple[str, str], np.ndarray]

    def rms(self, name: str, horizon: str) -> float:
        """Root mean square of what there is an error for, the first samples apart: there the start is found."""
        return float(np.sqrt(np.nanmean(self.errors[name, horizon][10:] ** 2)))

    @cached_property
    def effects(self) -> dict[str, dict[str, float]]:
        """Numbers of its effects, fitted and given."""
        plant, eta = self.model.predictor.plant, self.model.fit.point.eta[0]
        keys = (*self.law.effects, *(self.law.given or {}))
        return {key: {s.parameter.name: float(v) for s, v in zip(plant.slots, eta, strict=True) if s.key == key} for key in keys}

    @cached_property
    def parameters(self) -> dict[str, float]:
        plant = self.model.predictor.plant
        return {q.name: float(v) for q, v in zip(plant.parameters, self.model.fit.point.p, strict=True)}

    def force(self, v: np.ndarray) -> np.ndarray:
        """Force [N] that drives the slide at constant speeds v [m/s]: friction, and what makes up for an offset."""
        plant, eta, p = self.model.predictor.plant, self.model.fit.point.eta[0], self.model.fit.point.p
        acting = plant.drive([np.zeros(len(v))], eta, 0.0)
        rate = plant.derivative([np.zeros(len(v)), v], acting, p, eta)[1]
        return -self.parameters["M"] * np.broadcast_to(rate, len(v))


@record
class OverSpeed:
    """Force less M q'' by bin of speed: means with their standard deviations, counted by passages through the bin."""

    v: np.ndarray = field("n", unit="m/s")
    force: np.ndarray = field("n", unit="N")
    deviation: np.ndarray = field("n", unit="N", low=0.0)


@record
class PulseForce:
    """Force [N] beside the logged one while pulses are on, its standard deviation, and the pulses' value in the file."""

    force: float
    deviation: float
    value: float


def emps_records(data: str | None, quick: bool) -> Records:
    """Both records; with `quick` half of each."""
    wanted = f"put {ESTIMATION} and {HELD_OUT} of the EMPS benchmark (nonlinearbenchmark.org; {SOURCE}) into a folder"
    if data is None:
        raise InputError("this study needs measured records", mend=f"{wanted} and give --data FOLDER")
    paths = [Path(data) / name for name in (ESTIMATION, HELD_OUT)]
    for path in paths:
        if not path.is_file():
            raise InputError("no such file", file=path, mend=f"{wanted}, here {data}")
    records = [read_file(path) for path in paths]
    for e, path in zip(records, paths, strict=True):
        if not {"F", "q"} <= set(e.names):
            raise InputError("not a record of the EMPS benchmark", file=path, mend="expected t, qm, qg, vir and gtau in it")
    content = loadmat(paths[1])
    pulses = np.ravel(content["pulses_N"]).astype(float) if "pulses_N" in content else None
    if quick:
        records = [e.trim(stop=float(e.t[0]) + SHORT) for e in records]
        pulses = pulses[: len(records[1])] if pulses is not None else None
    return Records(records[0], records[1], pulses, tuple(paths))


def compared(found: Diagnosis, quick: bool) -> tuple[Law, ...]:
    """The laws to be compared, and what the diagnosis names where it is none of them."""
    laws = QUICK if quick else LAWS
    named = _named(found)
    if not named or any(is_named(law, found) for law in laws):
        return laws
    return (*laws, Law(f"named: {', '.join(named)}", effects=named))


def is_named(law: Law, found: Diagnosis) -> bool:
    return law.plant is POSITIONING_AXIS and law.given is None and not law.drift and set(law.effects) == set(_named(found))


def _named(found: Diagnosis) -> tuple[str, ...]:
    """Effects that are fitted; a rounding is told by the readings."""
    return tuple(key for key in found.effects if not key.startswith(f"{ROUNDED}@"))


def judged(law: Law, records: Records) -> Judged:
    """The law fitted to the estimation record, or taken as it is, and its errors on both."""
    model = _fitted(law, Dataset((records.estimation,))) if law.given is None else _taken(law, Dataset((records.estimation,)))
    found = {}
    for e in records.both:
        made, point = on(model, Dataset((e,)))
        found |= {(e.name, horizon): errors(made, point, 0, horizon)[:, 0] for horizon in HORIZONS}
    return Judged(law, model, found)


def _fitted(law: Law, dataset: Dataset) -> Model:
    """Parameters and effects as a diagnosis would fit them, one effect after the other."""
    made = recalibrated(predictor(law.plant, dataset, drift=law.drift))
    model = Model(made.predictor, made.fit)
    for key in law.effects:
        sizes = small_sizes(model.predictor, model.fit)
        score = scores(signatures(model.predictor, model.fit, variants(model.predictor, model.fit, [key], sizes), sizes))[0]
        model = settled(refit(model, score, sizes), sizes)
    return model


def _taken(law: Law, dataset: Dataset) -> Model:
    """The given numbers; only where the record starts, and the noise, are fitted."""
    plant = extension(law.plant, law.plant.name, law.parameters, law.given).of(law.plant)
    at = predictor(plant, dataset, drift=False)
    done = recalibrated(at, own=unknowns(at, names=()))
    return Model(done.predictor, done.fit)


def over_speed(e: Experiment, mass: float) -> OverSpeed:
    """F - M q'' over q', both below 30 Hz without shift in time; a mean for each of `SPEEDS` speeds."""
    v, force = _below_band(e, mass)
    keep = slice(round(3.0 / BAND / e.dt), -round(3.0 / BAND / e.dt))  # the filter has no neighbours at the ends
    v, force = v[keep], force[keep]
    edges = np.linspace(v.min(), v.max(), SPEEDS + 1)
    at = np.clip(np.searchsorted(edges, v, side="right") - 1, 0, SPEEDS - 1)
    rows = []
    for b in range(SPEEDS):
        own = np.flatnonzero(at == b)
        if len(own) > 2:
            passages = np.split(own, np.flatnonzero(np.diff(own) > 1) + 1)
            means = np.array([force[k].mean() for k in passages])
            # samples of one passage are not independent: passages are counted
            spread = means.std(ddof=1) / math.sqrt(len(means)) if len(means) > 1 else force[own].std()
            rows.append((v[own].mean(), force[own].mean(), spread))
    return OverSpeed(*np.array(rows).T)


def pulse_force(one: Judged, records: Records) -> PulseForce | None:
    """What acts beside the logged force while pulses are on, less that while they are off: means over each stretch of either."""
    if records.pulses is None:
        return None
    e = records.held_out
    v, force = _below_band(e, one.parameters["M"])
    missing = one.force(v) - force
    on_pulse = records.pulses != 0.0
    stretches = np.split(np.arange(len(e)), np.flatnonzero(np.diff(on_pulse)) + 1)[1:-1]
    by_kind = [np.array([missing[k].mean() for k in stretches if on_pulse[k[0]] == kind]) for kind in (True, False)]
    if min(map(len, by_kind)) < 2:
        return None
    high, low = by_kind
    spread = math.sqrt(high.var(ddof=1) / len(high) + low.var(ddof=1) / len(low))
    return PulseForce(float(high.mean() - low.mean()), spread, float(records.pulses.max()))


def _below_band(e: Experiment, mass: float) -> tuple[np.ndarray, np.ndarray]:
    """Speed [m/s] and drive force less `mass` times acceleration [N], both (N) and below `BAND` without shift in time."""
    low = butter(4, BAND, fs=1.0 / e.dt, output="sos")
    q, F = (sosfiltfilt(low, e[name]) for name in ("q", "F"))
    v = np.gradient(q, e.dt)
    return v, F - mass * np.gradient(v, e.dt)


def in_free_run(one: Judged, records: Records) -> dict[str, float]:
    """Free-run errors by record, root mean square [m], of a law fitted to the free run of the first record itself.

    Without noise of the force, and with so much of the position that its level decides nothing, the errors of one step are those
    of a free run. Of the second record only the start is fitted.
    """
    noise = Noise(np.array([FREE]), np.array([1e-9]), np.empty(0))
    own, point, found = one.model.fit.unknowns, one.model.fit.point, {}
    first = one.model.predictor.regained(point, noise)
    fit = gauss_newton(first, own, one.model.fit.z, small_sizes(first, one.model.fit), rounds=10, enough=1e-4)
    found[records.estimation.name] = FREE * float(np.sqrt(np.mean(fit.errors[0] ** 2)))
    second = predictor(one.law.plant, Dataset((records.held_out,)), drift=False)
    start = replace(unknowns(second, names=()), nominal=fit.point.p, base=fit.point.eta[0])
    second = second.regained(start.point(start.zero()), noise)
    rest = gauss_newton(second, start, start.zero(), np.zeros(len(one.law.plant.slots)), rounds=10, enough=1e-4)
    found[records.held_out.name] = FREE * float(np.sqrt(np.mean(rest.errors[0] ** 2)))
    return found
