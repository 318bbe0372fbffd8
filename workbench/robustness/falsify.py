"""The worst machine within a box: the parameters and effects with which a simulated loop breaks its limits most.

    maximise  max over limits and scenarios of excess / what the bound allows,   low <= parameters, effects <= high

on the nonlinear plant itself. The excess over a bound is often monotone in most parameters, so that the box's corners come first:
the nominal machine, every number at either end by itself, for every bound the corner that these ends point to, and from the best
of them on one number at a time. What is left of the budget goes to CMA-ES, from the best point and from random ones in turn:
worst cases inside the box (a resonance that meets a disturbance) have no corner. A search proves nothing where it finds nothing.

The worst run is run once more before it is reported, and saved as a `Counterexample` it can be replayed: the same numbers on the
same machine.

Source: Hansen, "The CMA evolution strategy: a tutorial", arXiv:1604.00772.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from workbench.errors import InputError, check_known
from workbench.files import read_json, write_json
from workbench.physics import stepper
from workbench.physics.controller import Controller, Stepped
from workbench.physics.plant import EffectSizes, Plant
from workbench.records import RecordError, field, record
from workbench.robustness.limits import BOUNDS, RANGE, Excess, Limit, resolved, setpoint_of
from workbench.simulation import LeftRangeError, Run, Scenario, simulate, simulate_batch

Say = Callable[[str], None]

SCHEMA, VERSION = "gain-scheduling-workbench/counterexample", 1
SAME = 1e-9  # relative difference up to which a replay has found the same
LOST = 1e6  # share of a run that left the range at its end, twice that at its start: the earlier the worse
TOGETHER = 400_000  # samples of runs that are kept in memory at a time
PROBED = 32  # random corners at which the integrator's steps are counted beforehand
POPULATION = 16  # as many as run side by side in the compiled step
NEAR, WIDE = 0.15, 0.3  # first step of a search from the best point and from a random one, in widths of the box
ENOUGH = 1e-5  # of what a bound allows, below which a search no longer improves and the next one begins
AMPLITUDE, PHASE = "amplitude", "phase"  # of an effect that has the sizes cosine and sine
CORNERS = 0.4  # of the budget, at most, for single numbers going from end to end


# ---- the box ------------------------------------------------------------------------------------------------------


@record
class Dimension:
    """A number that is only known to lie in [low, high]: a physical parameter or, where `effect` names one, a number of it.

    An effect with a phase has the numbers `amplitude` and `phase` [rad] besides its own: cosine = amplitude cos(phase), ...
    """

    name: str
    low: float = field("")
    high: float = field("")
    effect: str | None = None

    def __post_init__(self):
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low <= self.high):
            raise InputError(f"interval from {self.low:g} to {self.high:g}", file=str(self), mend="give low <= high, both finite")

    def __str__(self) -> str:
        return f"{self.effect}:{self.name}" if self.effect else self.name


def tolerance_box(plant: Plant, names: Sequence[str] | None = None) -> tuple[Dimension, ...]:
    """value (1 -+ tolerance) of the plant's parameters: of those named, else of all that have a tolerance."""
    known = {q.name: q for q in plant.parameters}
    chosen = [q.name for q in plant.parameters if q.tolerance > 0.0] if names is None else list(names)
    box = []
    for name in chosen:
        q = known[check_known("parameter", name, known, file=plant.name)]
        if q.tolerance == 0.0:
            raise InputError(f"parameter {name} has no tolerance", file=plant.name, mend="give its interval as a Dimension")
        if q.tolerance >= 1.0 and not q.signed:
            mend = "give its interval as a Dimension"
            raise InputError(f"a tolerance of {q.tolerance:.0%} reaches to 0", file=f"{plant.name}, {name}", mend=mend)
        low, high = sorted((q.value * (1.0 - q.tolerance), q.value * (1.0 + q.tolerance)))
        box.append(Dimension(name, low, high))
    return tuple(box)


def fitted_box(plant: Plant, path: str | Path) -> tuple[Dimension, ...]:
    """The 95 % intervals of a diagnosis.json or calibration.json: of recalibrated parameters, and of the numbers of causes.

    Within the bounds that the plant has for an effect's number. Raises InputError for other files, and names the plant lacks.
    """
    return fitted_box_of(plant, read_json(path), path)


def fitted_box_of(plant: Plant, content: Any, path: str | Path = "fitted intervals") -> tuple[Dimension, ...]:
    """The box of what such a file holds; path: the file, for messages."""
    if not isinstance(content, dict) or not ("causes" in content or "starts" in content):
        mend = "give the diagnosis.json or calibration.json beside it: a plant file holds values without intervals"
        raise InputError("holds no intervals", file=path, mend=mend)
    try:
        fitted = content["recalibrated"] if "causes" in content else content["parameters"]
        box = [_fitted(path, name, own, -np.inf, np.inf, None) for name, own in fitted.items()]
        bounds = {(slot.key, slot.parameter.name): slot.parameter for slot in plant.slots}
        for cause in content.get("causes", []):
            key = f"{cause['effect']}@{cause['at']}"
            check_known("effect", key, dict.fromkeys(slot.key for slot in plant.slots), file=path)
            phased = any(slot.key == key and slot.effect.phase for slot in plant.slots)
            for name, own in cause["parameters"].items():
                if phased and name == AMPLITUDE:  # where a run meets it nobody knows
                    box.append(_fitted(path, name, own, 0.0, bounds[key, "cosine"].high, key))
                    box.append(Dimension(PHASE, -math.pi, math.pi, key))
                    continue
                check_known(f"parameter of {key}", name, [n for k, n in bounds if k == key], file=path)
                box.append(_fitted(path, name, own, bounds[key, name].low, bounds[key, name].high, key))
    except (KeyError, TypeError, AttributeError) as reason:
        raise InputError(f"malformed: {reason!r}", file=path, mend="write the file again") from None
    for dimension in box:
        if dimension.effect is None:
            check_known("parameter", dimension.name, [q.name for q in plant.parameters], file=path)
    return tuple(box)


def _fitted(path: str | Path, name: str, own: Mapping[str, Any], low: float, high: float, effect: str | None) -> Dimension:
    bounds = [_number(path, f"{side} of {name}", own[side]) for side in ("low", "high")]
    return Dimension(name, *np.clip(bounds, low, high).tolist(), effect=effect)


def _polar(own: Mapping[str, float]) -> dict[str, float]:
    """Numbers of an effect, amplitude and phase among them where it has them."""
    if "cosine" not in own:
        return dict(own)
    c, s = own["cosine"], own["sine"]
    return {**own, AMPLITUDE: math.hypot(c, s), PHASE: math.atan2(s, c)}


class _Box:
    """Points z (R, n) of the unit cube as parameter vectors (R, np) and effect vectors (R, ne) of a plant."""

    def __init__(self, plant: Plant, dimensions: Sequence[Dimension]):
        given = [str(dimension) for dimension in dimensions]
        for name in given:
            if given.count(name) > 1:
                raise InputError(f"{name} is given twice", file=plant.name, mend="give each interval once")
        self.plant, self.dimensions = plant, [d for d in dimensions if d.high > d.low]
        self.fixed = [d for d in dimensions if d.high == d.low]
        self.low = np.array([d.low for d in self.dimensions])
        self.width = np.array([d.high - d.low for d in self.dimensions])
        p, eta = self.vectors(np.vstack([np.zeros(self.n), np.ones(self.n)]))  # both ends are refused here, if at all
        plant.check_parameters(p)
        plant.check_effects(eta)

    @property
    def n(self) -> int:
        return len(self.dimensions)

    @cached_property
    def nominal(self) -> np.ndarray:
        """The plant's own numbers (n), or what in the box is nearest to them."""
        p, eta = self.plant.nominal, self.plant.effect_vector()
        effects: dict[str, dict[str, float]] = {}
        for slot, value in zip(self.plant.slots, eta.tolist(), strict=True):
            effects.setdefault(slot.key, {})[slot.parameter.name] = value
        own = np.array([_polar(effects[d.effect])[d.name] if d.effect else p[self._at(d)] for d in self.dimensions])
        return np.clip((own - self.low) / self.width, 0.0, 1.0) if self.n else own

    def vectors(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p = np.repeat(self.plant.nominal[None], len(z), axis=0)
        eta = np.repeat(self.plant.effect_vector()[None], len(z), axis=0)
        polar: dict[str, dict[str, np.ndarray]] = {}
        # the ends are met exactly, and never missed by a rounding error
        values = [np.clip(self.low[i] + z[:, i] * self.width[i], d.low, d.high) for i, d in enumerate(self.dimensions)]
        for d, value in zip(
            (*self.dimensions, *self.fixed), (*values, *(np.full(len(z), d.low) for d in self.fixed)), strict=True
        ):
            if d.effect and d.name in (AMPLITUDE, PHASE):
                polar.setdefault(d.effect, {})[d.name] = value
            else:
                (eta if d.effect else p)[:, self._at(d)] = value
        for effect, own in polar.items():
            c, s = (self._at(Dimension(name, 0.0, 0.0, effect)) for name in ("cosine", "sine"))
            amplitude = own.get(AMPLITUDE, np.hypot(eta[:, c], eta[:, s]))
            phase = own.get(PHASE, np.arctan2(eta[:, s], eta[:, c]))
            eta[:, c], eta[:, s] = amplitude * np.cos(phase), amplitude * np.sin(phase)
        return p, eta

    def _at(self, d: Dimension) -> int:
        if d.effect is None:
            names = [q.name for q in self.plant.parameters]
            return names.index(check_known("parameter", d.name, names, file=self.plant.name))
        check_known("effect", d.effect, dict.fromkeys(slot.key for slot in self.plant.slots), file=self.plant.name)
        own = {slot.parameter.name: i for i, slot in enumerate(self.plant.slots) if slot.key == d.effect}
        return own[check_known(f"parameter of {d.effect}", d.name, own, file=self.plant.name)]


# ---- what is found ------------------------------------------------------------------------------------------------


@record
class Counterexample:
    """A run that stands alone: plant, controller, scenario, parameters and effects, and by how much it breaks which limit.

    base: what the plant was called (a machine's name, or the user's file.py:NAME, which is never run from here). controller: the
    content of its file. parameters, effects: all of them. excess: in the unit of the bound, infinite for a run that left the
    range of the plant; it is found at `sample`, where the signal is `value`.
    """

    plant: str
    base: str
    dt: float = field("", unit="s", low=1e-12)
    controller: Mapping[str, Any]
    scenario: Scenario
    bumpless: bool
    substeps: int
    parameters: Mapping[str, float]
    effects: EffectSizes
    limit: Limit
    bound: str
    excess: float
    sample: int
    value: float

    @property
    def time(self) -> float:
        """Where the limit is broken most [s]."""
        return self.sample * self.dt

    @property
    def sentence(self) -> str:
        """What is broken, where and by how much."""
        return _sentence(self.limit, self.bound, self.excess, self.time, self.value)

    def to_dict(self) -> dict[str, Any]:
        """What its file holds, schema and version inside, readable without this package."""
        limit = {name: getattr(self.limit, name) for name in LIMIT_NUMBERS}
        return {
            "schema": SCHEMA, "version": VERSION, "plant": self.plant, "base": self.base, "dt": self.dt,
            "limit": {"signal": self.limit.signal, "unit": self.limit.unit}
            | {name: value for name, value in limit.items() if math.isfinite(value)},
            "bound": self.bound, "excess": _finite(self.excess), "sample": self.sample, "time": self.time,
            "value": _finite(self.value), "parameters": dict(self.parameters),
            "effects": {key: dict(numbers) for key, numbers in self.effects.items()},
            "substeps": self.substeps, "bumpless": self.bumpless,
            "scenario": {
                "name": self.scenario.name, "seed": self.scenario.seed, "start": dict(self.scenario.start),
                "references": dict(self.scenario.references), "disturbance": dict(self.scenario.disturbance),
            },
            "controller": dict(self.controller),
        }  # fmt: skip

    def save(self, path: str | Path) -> Path:
        """Write the file."""
        return write_json(path, self.to_dict())

    def replay(self, plant: Plant, controller: Controller | Stepped) -> "Replayed":
        """Run it again. Raises InputError where the plant is another one."""
        if plant.name != self.plant:
            raise InputError(f"is of plant {self.plant!r}, not {plant.name!r}", file="counterexample", mend=f"give {self.base}")
        if missing := [q.name for q in plant.parameters if q.name not in self.parameters]:
            raise InputError(f"holds no parameter {', '.join(missing)}", file="counterexample", mend="search again")
        plant = replace(plant.sampled(self.dt), effects={})  # the file holds all that acts
        limit, *_ = resolved([self.limit], plant, controller)
        run = simulate(
            plant, controller, self.scenario, parameters=self.parameters, effects=self.effects, substeps=self.substeps,
            bumpless=self.bumpless, cut=True,
        )  # fmt: skip
        values, found = _judged(run, self.scenario, limit, controller)
        sample, bound = int(found.sample[0]), found.bound_of()
        at_place = bound == self.bound and sample == self.sample
        excess, value = float(found.value[0]), float(values[sample])
        return Replayed(run, excess, sample, value, at_place and same(excess, self.excess) and same(value, self.value))


@record
class Replayed:
    """A counterexample run again; same: it has found what the file says."""

    run: Run
    excess: float
    sample: int
    value: float
    same: bool


@record
class Worst:
    """The worst run that a search found, and with which machine.

    excess, value: as in a counterexample; share: the excess in what the bound allows, positive where the limit is broken;
    nominal: that of the nominal machine. history (runs): the largest share up to each run. refused: machines that cannot be run.
    """

    plant: Plant
    dimensions: tuple[Dimension, ...]
    scenario: Scenario
    bumpless: bool
    substeps: int
    parameters: Mapping[str, float]
    effects: EffectSizes
    limit: Limit
    bound: str
    excess: float
    share: float
    sample: int
    value: float
    nominal: float
    history: np.ndarray = field("runs")
    refused: int = 0

    @property
    def broken(self) -> bool:
        """Whether a limit is broken."""
        return self.share > 0.0

    @property
    def runs(self) -> int:
        return len(self.history)

    @property
    def point(self) -> dict[str, float]:
        """The numbers of the worst machine by dimension."""
        return {str(d): _polar(self.effects[d.effect])[d.name] if d.effect else self.parameters[d.name] for d in self.dimensions}

    @property
    def sentence(self) -> str:
        return _sentence(self.limit, self.bound, self.excess, self.sample * self.plant.dt, self.value)

    def counterexample(self, base: str, controller: Mapping[str, Any]) -> Counterexample:
        """base: what the plant was called; controller: the content of its file."""
        return Counterexample(
            self.plant.name, base, self.plant.dt, controller, self.scenario, self.bumpless, self.substeps, self.parameters,
            self.effects, self.limit, self.bound, self.excess, self.sample, self.value,
        )  # fmt: skip


def _sentence(limit: Limit, bound: str, excess: float, time: float, value: float) -> str:
    unit = limit.unit_of(bound)
    if bound == RANGE:
        return f"{limit.signal}: the run leaves the range of the plant at {time:g} s"
    said = f"band of {limit.band:g}" if bound == "settling" else f"{bound} of {getattr(limit, bound):g}"
    told = "broken by" if excess > 0.0 else "kept with"
    return f"{limit.signal}: {said} {unit} {told} {abs(excess):.6g} {unit} at {time:g} s, where it is {value:.6g} {limit.unit}"


def same(found: float, stored: float) -> bool:
    """Whether a replay has found the number of the file, within SAME of it; numbers that are not finite must agree."""
    if math.isfinite(found) and math.isfinite(stored):
        return abs(found - stored) <= SAME * max(abs(found), abs(stored))
    return found == stored or (math.isnan(found) and math.isnan(stored))


def _finite(value: float) -> float | None:
    """The number, None where it is none: JSON has no infinity."""
    return value if math.isfinite(value) else None


def _judged(run: Run, scenario: Scenario, limit: Limit, controller: Any) -> tuple[np.ndarray, Excess]:
    """The signal (N), NaN from where the run has left the range, and by how much it breaks the limit."""
    values = np.full(len(scenario), np.nan)
    values[: len(run.experiment)] = run.experiment[limit.signal]
    reference = setpoint_of(limit, controller)
    t = run.experiment.dt * np.arange(len(scenario))
    return values, limit.excess(t, values, scenario.references[reference] if reference else None)


# ---- the search ---------------------------------------------------------------------------------------------------


def worst_plant(
    plant: Plant,
    controller: Controller | Stepped,
    scenarios: Scenario | Sequence[Scenario],
    limits: Sequence[Limit],
    dimensions: Sequence[Dimension],
    *,
    runs: int = 1000,
    seed: int = 0,
    bumpless: bool = True,
    progress: Say = lambda _: None,
) -> Worst:
    """The worst machine found with at most `runs` runs, the last of which confirms it; see the module.

    Every machine goes through all scenarios. The same seed gives the same answer.
    """
    trials = _Trials(plant, controller, scenarios, limits, dimensions, runs, bumpless, progress)
    best = _search_corners(trials)
    _search_inside(trials, best, seed)
    return trials.confirmed()


def at_random(
    plant: Plant,
    controller: Controller | Stepped,
    scenarios: Scenario | Sequence[Scenario],
    limits: Sequence[Limit],
    dimensions: Sequence[Dimension],
    *,
    runs: int = 1000,
    seed: int = 0,
    bumpless: bool = True,
    progress: Say = lambda _: None,
) -> Worst:
    """The same budget on machines drawn evenly from the box, the nominal one first: what a search is to be compared with."""
    trials = _Trials(plant, controller, scenarios, limits, dimensions, runs, bumpless, progress)
    random = np.random.default_rng(seed)
    trials.of(trials.box.nominal[None])
    while trials.room and not trials.lost:
        trials.of(random.uniform(size=(min(trials.room, trials.together), trials.box.n)))
        if not trials.box.n:
            break
    return trials.confirmed()


@record
class _Scored:
    """Of R machines: the largest share (R), -inf where one could not be run, and the share by bound of each limit (R, K)."""

    score: np.ndarray
    shares: np.ndarray


class _Trials:
    """Machines that are run, within a budget, and the worst of them."""

    def __init__(
        self,
        plant: Plant,
        controller: Controller | Stepped,
        scenarios: Scenario | Sequence[Scenario],
        limits: Sequence[Limit],
        dimensions: Sequence[Dimension],
        runs: int,
        bumpless: bool,
        progress: Say,
    ):
        self.plant, self.controller, self.bumpless, self.progress = plant, controller, bumpless, progress
        self.scenarios = [scenarios] if isinstance(scenarios, Scenario) else list(scenarios)
        self.limits, self.box, self.dimensions = resolved(limits, plant, controller), _Box(plant, dimensions), tuple(dimensions)
        self.budget = (runs - 1) // max(len(self.scenarios), 1)  # machines; the last run confirms
        if not self.scenarios or self.budget < 1:
            mend = f"at least {len(self.scenarios) + 1}: each scenario, and one more"
            raise InputError(f"{runs} runs", file=plant.name, mend=mend)
        self.bare = replace(plant, effects={}) if plant.effects else plant  # runs by themselves name all that acts
        for scenario in self.scenarios:
            self._check(scenario)
        self.together = max(POPULATION, TOGETHER // max(len(s) for s in self.scenarios))
        self.seen: dict[bytes, tuple[float, np.ndarray]] = {}
        self.history: list[float] = []
        self.refused, self.substeps, self.best = 0, 0, -np.inf
        self.worst: tuple[np.ndarray, int, int] | None = None  # machine, scenario, limit
        self.worst_substeps = 0
        corners = np.random.default_rng(0).integers(0, 2, (PROBED, self.box.n)).astype(float)
        self._count_steps(np.vstack([self.box.nominal[None], corners]))

    def _check(self, scenario: Scenario) -> None:
        """Refuse a limit that no sample of a scenario is held to: every loop would keep it."""
        t = self.plant.dt * np.arange(len(scenario))
        for limit in self.limits:
            reference = setpoint_of(limit, self.controller)
            if reference is not None:
                check_known("set-point", reference, scenario.references, file=scenario.name)
            found = limit.by_bound(t, np.zeros(len(t)), scenario.references[reference] if reference else None)
            for name, own in zip(BOUNDS, found, strict=True):
                if name in limit.kept and own.value[0] == -np.inf:
                    said = f"{name} of {limit.signal} holds after the end of the run only"
                    raise InputError(said, file=scenario.name, mend="begin earlier, or run longer")

    @property
    def room(self) -> int:
        """Machines that may still be run."""
        return self.budget - len(self.history)

    @property
    def lost(self) -> bool:
        """Whether a run has left the range of the plant: nothing is worse."""
        return self.best >= LOST

    def of(self, z: np.ndarray) -> _Scored:
        """What becomes of the machines z (R, n). One that was run before costs nothing; those beyond the budget are left out."""
        keys = [own.tobytes() for own in z]
        new = [i for i, key in enumerate(keys) if key not in self.seen and key not in keys[:i]][: self.room]
        for first in range(0, len(new), self.together):
            self._run(z[new[first : first + self.together]])
        shares = len(self.limits) * len(BOUNDS)
        rows = [self.seen.get(key, (-np.inf, np.full(shares, -np.inf))) for key in keys]
        return _Scored(np.array([score for score, _ in rows]), np.reshape([own for _, own in rows], (len(z), shares)))

    def _run(self, z: np.ndarray) -> None:
        before = self.best
        shares = np.full((len(self.scenarios), len(z), len(self.limits), len(BOUNDS)), -np.inf)
        used = self._count_steps(z)
        for s, scenario in enumerate(self.scenarios):
            self._run_scenario(shares[s], z, scenario, used)
        shares = np.where(np.isnan(shares), -np.inf, shares)
        score = shares.max(axis=(0, 2, 3))
        for i, own in enumerate(z):
            self.seen[own.tobytes()] = float(score[i]), shares[:, i].max(axis=0).ravel()
            if score[i] > self.best:
                s, which, _ = np.unravel_index(int(np.argmax(shares[:, i])), shares[:, i].shape)
                self.best, self.worst, self.worst_substeps = float(score[i]), (own.copy(), int(s), int(which)), used
            self.history.append(self.best)
        self.refused += int(np.sum(score == -np.inf))
        if self.best > before:
            self.progress(f"{len(self.history) * len(self.scenarios)} runs: largest excess {_share(self.best)}")

    def _run_scenario(self, shares: np.ndarray, z: np.ndarray, scenario: Scenario, substeps: int) -> None:
        """Fills shares (R, limits, bounds). Machines that cannot be run are left at -inf."""
        p, eta = self.box.vectors(z)
        signals = [limit.signal for limit in self.limits]
        try:
            values = self._signals(p, eta, scenario, substeps, signals)
        except InputError:
            if len(self.history) == 0 and len(z) == 1:
                raise  # the nominal machine must run
            if len(z) > 1:
                half = len(z) // 2
                self._run_scenario(shares[:half], z[:half], scenario, substeps)
                self._run_scenario(shares[half:], z[half:], scenario, substeps)
            return
        t, N = self.plant.dt * np.arange(len(scenario)), len(scenario)
        for i, limit in enumerate(self.limits):
            reference = setpoint_of(limit, self.controller)
            found = limit.by_bound(t, values[i], scenario.references[reference] if reference else None)
            for b, own in enumerate(found):
                early = LOST * (2.0 - own.sample / N)
                shares[:, i, b] = np.where(own.bound < 0, early, np.minimum(own.share, LOST / 2))

    def _signals(self, p, eta, scenario: Scenario, substeps: int, signals: Sequence[str]) -> list[np.ndarray]:
        """Of each signal the values (R, N)."""
        if isinstance(self.controller, Controller):
            run = simulate_batch(
                self.plant, self.controller, scenario, parameters=p, effects=eta, substeps=substeps, bumpless=self.bumpless
            )
            columns = {name: run.measured[:, :, i] for i, name in enumerate(self.plant.output_names)}
            columns |= {name: run.commands[:, :, i] for i, name in enumerate(self.plant.input_names)}
            return [columns[name] for name in signals]
        values = np.full((len(signals), len(p), len(scenario)), np.nan)
        for k in range(len(p)):
            try:
                run = self._single(p[k], eta[k], scenario, substeps)
            except LeftRangeError:
                continue  # at its first samples
            for i, name in enumerate(signals):
                values[i, k, : len(run.experiment)] = run.experiment[name]
        return list(values)

    def _single(self, p: np.ndarray, eta: np.ndarray, scenario: Scenario, substeps: int) -> Run:
        parameters, effects = self._named(p, eta)
        return simulate(
            self.bare, self.controller, scenario, parameters=parameters, effects=effects, substeps=substeps,
            bumpless=self.bumpless, cut=True,
        )  # fmt: skip

    def _named(self, p: np.ndarray, eta: np.ndarray) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
        """All parameters by name, and all numbers of those effects that are not what the bare equation has."""
        parameters = dict(zip((q.name for q in self.plant.parameters), p.tolist(), strict=True))
        own = [slot.key for slot, value, bare in zip(self.plant.slots, eta, self.plant.neutral, strict=True) if value != bare]
        own += [d.effect for d in self.dimensions if d.effect]
        effects: dict[str, dict[str, float]] = {}
        for slot, value in zip(self.plant.slots, eta.tolist(), strict=True):
            if slot.key in own:
                effects.setdefault(slot.key, {})[slot.parameter.name] = value
        return parameters, effects

    def _count_steps(self, z: np.ndarray) -> int:
        """Integrator steps a sample for these machines: never fewer than for those before, so that all are run alike."""
        p, eta = self.box.vectors(z)
        for scenario in self.scenarios:
            try:
                start, hold = self.plant.equilibria(p, **scenario.start)
                self.substeps = max(self.substeps, int(stepper.substeps_for(self.plant, p, eta, start, hold).max()))
            except InputError:
                if len(z) == 1:
                    continue  # said where it is run
                half = len(z) // 2
                self._count_steps(z[:half])
                self._count_steps(z[half:])
        return self.substeps

    def confirmed(self) -> Worst:
        """The worst machine, run by itself once more."""
        if self.worst is None:
            raise InputError("no machine of the box can be run", file=self.plant.name, mend="is the box too wide?")
        z, s, which = self.worst
        p, eta = (own[0] for own in self.box.vectors(z[None]))
        scenario, limit = self.scenarios[s], self.limits[which]
        run = self._single(p, eta, scenario, self.worst_substeps)
        values, found = _judged(run, scenario, limit, self.controller)
        parameters, effects = self._named(p, eta)
        sample, per = int(found.sample[0]), len(self.scenarios)
        best = np.array([*np.repeat(self.history, per), self.history[-1]])
        return Worst(
            self.plant, self.dimensions, scenario, self.bumpless, self.worst_substeps, parameters, effects, limit,
            found.bound_of(), float(found.value[0]), float(found.share[0]), sample, float(values[sample]),
            _infinite(self.history[0]), np.where(best >= LOST, np.inf, best), self.refused,
        )  # fmt: skip


def _infinite(share: float) -> float:
    return np.inf if share >= LOST else share


def _share(best: float) -> str:
    return "infinite: a run left the range of the plant" if best >= LOST else f"{best:+.4g} of what the bound allows"


def _search_corners(trials: _Trials) -> np.ndarray:
    """The nominal machine, single numbers at their ends, the corners that these point to, then single numbers from there on."""
    c, n = trials.box.nominal, trials.box.n
    first = trials.of(c[None])
    ends = np.repeat(c[None], 2 * n, axis=0)
    ends[np.arange(n), np.arange(n)], ends[n + np.arange(n), np.arange(n)] = 0.0, 1.0
    found = trials.of(ends)
    machines, scores = [c, *ends], [first.score[0], *found.score]
    low, high = found.shares[:n], found.shares[n:]  # (n, K)
    towards = np.where(high >= low, 1.0, 0.0).T
    # a number that is worst where it is nominal stays there, in one more candidate of each bound
    staying = np.where(np.maximum(low, high) > first.shares, towards.T, c[:, None]).T
    there = np.isfinite(first.shares[0])
    candidates = np.vstack([towards[there], staying[there]]) if n else np.empty((0, 0))
    machines += list(candidates)
    scores += list(trials.of(candidates).score)
    best = machines[int(np.argmax(scores))]
    until = trials.budget * (1.0 - CORNERS)
    while n and trials.room > until and not trials.lost:
        others = np.repeat(best[None], 2 * n, axis=0)
        others[np.arange(n), np.arange(n)], others[n + np.arange(n), np.arange(n)] = 0.0, 1.0
        here, tried = trials.of(best[None]).score[0], trials.of(others).score
        better = np.flatnonzero(tried > here)
        if not len(better):
            break
        together = best.copy()
        for j in better[np.argsort(tried[better])]:  # of both ends of a number the better one counts
            together[j % n] = others[j, j % n]
        single = others[int(np.argmax(tried))]
        best = together if trials.of(together[None]).score[0] > np.max(tried) else single
    return best


def _search_inside(trials: _Trials, best: np.ndarray, seed: int) -> None:
    """CMA-ES from the best point and from random ones, in turn, until the budget is used up."""
    n, random = trials.box.n, np.random.default_rng(seed)
    if not n:
        return
    idle = 0
    for near in cycle((True, False)):
        if trials.room < 1 or trials.lost or idle > 4:
            return
        before = trials.room
        best = trials.worst[0] if trials.worst is not None else best
        start = best if near else random.uniform(size=n)
        _evolve(trials, start, NEAR if near else WIDE, random)
        idle = idle + 1 if trials.room == before else 0


def _evolve(trials: _Trials, start: np.ndarray, sigma: float, random: np.random.Generator) -> None:
    """One run of CMA-ES in the unit cube; what steps out of it is taken back to its faces, where many worst machines are.

    The step out costs its squared length times the spread of the generation: enough to come back, whatever the unit.
    """
    from cma.evolution_strategy import CMAEvolutionStrategy  # a second to import, and only a search needs it

    n = len(start)
    options = {
        "popsize": POPULATION, "tolx": 1e-4, "tolfun": ENOUGH, "tolfunhist": ENOUGH, "seed": np.nan,
        "randn": lambda *size: random.standard_normal(size),
        # it neither prints nor writes, and takes no options from a file that lies about
        "verbose": -10, "verb_disp": 0, "verb_log": 0, "signals_filename": "",
    }  # fmt: skip
    # it knows no search in one dimension: a second one is added that changes nothing
    strategy = CMAEvolutionStrategy(np.append(start, [0.5] * (n == 1)), sigma, options)
    while trials.room and not trials.lost and not strategy.stop():
        before, points = trials.room, strategy.ask()
        inside = np.clip(points, 0.0, 1.0)
        scores = trials.of(np.ascontiguousarray(inside[:, :n])).score
        if trials.room == before or not trials.room:
            return  # all known: it stands in a corner
        run = np.isfinite(scores)
        out = np.sum((np.array(points) - inside) ** 2, axis=1) * (np.ptp(scores[run]) if run.any() else 0.0)
        # a machine that cannot be run is as good as none: below all others, but finite
        strategy.tell(points, np.where(run, out - scores, LOST).tolist())


# ---- the file -----------------------------------------------------------------------------------------------------

LIMIT_NUMBERS = ("low", "high", "rate", "band", "settling", "begin")
AGAIN = "search again"


def load_counterexample(path: str | Path) -> Counterexample:
    """Read a file written by `Counterexample.save`. Raises InputError naming what is missing, foreign or not a number."""
    return counterexample_of(read_json(path), path)


def counterexample_of(content: Any, path: str | Path = "a counterexample") -> Counterexample:
    """The counterexample that the content of a file makes; path: the file that holds it, for messages."""
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise InputError("not a counterexample", file=path, mend=f"expected a JSON object with schema {SCHEMA!r}")
    if content.get("version") != VERSION:
        raise InputError(f"counterexample version {content.get('version')}, this program reads {VERSION}", file=path, mend=AGAIN)
    kinds = {
        "plant": str, "base": str, "controller": dict, "scenario": dict, "bumpless": bool, "substeps": int, "parameters": dict,
        "effects": dict, "limit": dict, "bound": str, "sample": int,
    }  # fmt: skip
    for name, kind in kinds.items():
        _expect(path, name, content.get(name), kind)
    limit, own = content["limit"], content["scenario"]
    for place, value, kind in (
        ("signal", limit.get("signal"), str), ("unit", limit.get("unit"), str), ("name", own.get("name"), str),
        ("references", own.get("references"), dict), ("start", own.get("start"), dict),
        ("disturbance", own.get("disturbance"), dict),
    ):  # fmt: skip
        _expect(path, place, value, kind)
    seed = own.get("seed")
    if seed is not None:
        _expect(path, "seed", seed, int)
    if not own["name"] or Path(own["name"]).name != own["name"]:  # records are named by it, and stay in their folder
        raise InputError(f"scenario {own['name']!r} is no name for a record", file=path, mend=AGAIN)
    check_known("bound", content["bound"], (*BOUNDS, RANGE), file=path)
    scenario = Scenario(
        own["name"], _series(path, own["references"]), seed, _numbers(path, "start", own["start"]),
        _series(path, own["disturbance"]),
    )  # fmt: skip
    if not 0 <= content["sample"] < len(scenario) or content["substeps"] < 1 or (seed is not None and seed < 0):
        raise InputError("sample, substeps or seed out of range", file=path, mend=AGAIN)
    bounds = {name: _number(path, f"limit, {name}", limit[name]) for name in LIMIT_NUMBERS if name in limit}
    lost = content["bound"] == RANGE
    try:
        return Counterexample(
            content["plant"], content["base"], _number(path, "dt", content.get("dt")), content["controller"], scenario,
            content["bumpless"], content["substeps"], _numbers(path, "parameters", content["parameters"]),
            {key: _numbers(path, key, numbers) for key, numbers in content["effects"].items()},
            Limit(limit["signal"], unit=limit["unit"], **bounds), content["bound"],
            np.inf if lost else _number(path, "excess", content.get("excess")), content["sample"],
            np.nan if lost else _number(path, "value", content.get("value")),
        )  # fmt: skip
    except RecordError as reason:
        raise InputError(str(reason), file=path, mend=AGAIN) from None


def _expect(path: str | Path, name: str, value: Any, kind: type) -> None:
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise InputError(f"field {name!r} is missing or no {kind.__name__}", file=path, mend=AGAIN)


def _number(path: str | Path, place: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{place}: {value!r} is not a finite number", file=path, mend=AGAIN)
    return float(value)


def _numbers(path: str | Path, place: str, content: Any) -> dict[str, float]:
    _expect(path, place, content, dict)
    return {name: _number(path, f"{place}, {name}", value) for name, value in content.items()}


def _series(path: str | Path, content: Mapping[str, Any]) -> dict[str, np.ndarray]:
    for name, values in content.items():
        _expect(path, name, values, list)
    return {name: np.array([_number(path, name, value) for value in values]) for name, values in content.items()}
