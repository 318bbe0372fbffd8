"""Machines of a box that are run within a budget, and the worst of them.

The worst run is run once more before it is reported.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.errors import InputError, check_known
from workbench.physics import stepper
from workbench.physics.controller import Controller, Stepped
from workbench.physics.plant import Plant
from workbench.progress import Progress, Steps, silent
from workbench.records import record
from workbench.robustness.falsify.box import Dimension, ParameterBox
from workbench.robustness.falsify.counterexample import judged
from workbench.robustness.falsify.worst import Worst
from workbench.robustness.limits import BOUNDS, Limit, resolved, setpoint_of
from workbench.simulation import LeftRangeError, Run, Scenario, simulate, simulate_batch

LOST = 1e6  # share of a run that left the range at its end, twice that at its start: the earlier the worse
TOGETHER = 400_000  # samples of runs that are kept in memory at a time
PROBED = 32  # random corners at which the integrator's steps are counted beforehand
POPULATION = 16  # as many as run side by side in the compiled step
PAUSE = 2.0  # s between two lines of progress


@record
class Search:
    """What is asked: which machine of the box breaks a limit most, in a loop that runs the scenarios.

    dimensions: the box; runs: at most, over all machines and scenarios; bumpless: the law takes over from the inputs of the
    start.
    """

    plant: Plant
    controller: Controller | Stepped
    scenarios: Scenario | Sequence[Scenario]
    limits: Sequence[Limit]
    dimensions: Sequence[Dimension]
    runs: int = 1000
    seed: int = 0
    bumpless: bool = True
    progress: Progress = silent


@record
class _Scored:
    """Of R machines: the largest share (R), -inf where one could not be run, and the share by bound of each limit (R, K)."""

    score: np.ndarray
    shares: np.ndarray


class Trials:
    """Machines that are run, within a budget, and the worst of them."""

    def __init__(self, search: Search):
        plant, runs = search.plant, search.runs
        self.plant, self.controller, self.bumpless = plant, search.controller, search.bumpless
        self.scenarios = [search.scenarios] if isinstance(search.scenarios, Scenario) else list(search.scenarios)
        self.limits = resolved(search.limits, plant, search.controller)
        self.box, self.dimensions = ParameterBox(plant, search.dimensions), tuple(search.dimensions)
        self.budget = (runs - 1) // max(len(self.scenarios), 1)  # machines; the last run confirms
        if not self.scenarios or self.budget < 1:
            mend = f"at least {len(self.scenarios) + 1}: each scenario, and one more"
            raise InputError(f"{runs} runs", file=plant.name, mend=mend)
        self.bare = replace(plant, effects={}) if plant.effects else plant  # runs by themselves name all that acts
        for scenario in self.scenarios:
            self._check(scenario)
        self.steps = Steps(search.progress, self.budget * len(self.scenarios), "runs", pause=PAUSE)
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
        self.steps.done(len(z) * len(self.scenarios), f"largest excess {_share(self.best)}")

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
        values, found = judged(run, scenario, limit, self.controller)
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
