"""One-step prediction of a plant along measured records, with the gain of an extended Kalman filter.

    e_k = y_k - h(x_k; p, eta),   x_{k+1} = flow(x_k + K_k e_k, u_k; p, eta)      (innovations form)

The gain comes from one pass along the records and is then held while parameters p and effects eta move: predictions for many
hypotheses run side by side on the compiled step. Process noise enters where `entries` say, constant over each sample: at inputs
that move several states at once, and as a rate of change of states: torques on shafts, what drives a state besides its input,
rates of tension. But for tensions it has a white and a coloured part, and the filter estimates the coloured one, d+ = a d + w: a
torque that comes and goes is no missing physics. So it does with the noise of the sensors where that is coloured. Errors are
whitened, W_k e_k with W S W' = I.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from workbench.data import Dataset, Experiment, bad_stamps
from workbench.diagnosis.kalman import Linearization, Pass, drifted, gains
from workbench.diagnosis.starts import entry_states, pushes_of, spread_of, start_of
from workbench.errors import InputError, check_known
from workbench.noise import measurement_noise
from workbench.physics import stepper
from workbench.physics.controller import Playback
from workbench.physics.effects.effect import FOREVER
from workbench.physics.plant import Plant
from workbench.records import field, record

FEWEST = 3  # integrator steps a sample: a sensor that lags sees the output as a parabola over each
UNTOLD = 5  # samples at the start of a record that do not count: what was commanded before them may still be under way
FINE, FINEST = 4, 16  # times the plant's own integrator steps: what counts as exact, and where dry friction acts
VISIBLE = 2.0  # sum of squares, in variances, that the integrator may be off in all records: of a deviance nothing that counts
LOOK = 600  # samples of a record on which that is looked at
RAISED, RAISES = 4.0, 6  # factor of pushes where a filter loses a record, and how often
RAN_AWAY = 1e9  # error of a run that left every range
PLAY = "backlash"
STEP = 1e-6  # of a state's scale, for differences of the flow


@record
class Record:
    """A measured record as the predictor reads it: inputs u (N, nu), outputs y (N, ny), NaN where nothing was measured.

    start (nx): where the states are before anything is known, in the light of the first measured sample; scale (nx): how far
    off that may be.
    """

    name: str
    u: np.ndarray = field("N nu")
    y: np.ndarray = field(None)
    start: np.ndarray = field("nx")
    scale: np.ndarray = field("nx")

    @cached_property
    def seen(self) -> np.ndarray:
        """Outputs (N, ny) as a filter may use them: those of the first samples of a record are NaN, see UNTOLD."""
        y = self.y.copy()
        y[: UNTOLD if len(y) > 10 * UNTOLD else 0] = np.nan
        return y

    def __len__(self) -> int:
        return len(self.u)


@record
class Noise:
    """Standard deviations: measurement (ny) of each output; process (nw) of each entry, a rate or an input, white per sample.

    drift (nd): steps of the coloured part, of time constant `memory`, on the first nd entries. coloured (nc: ny or none): the
    same of the outputs, of time constant `correlation_time`.
    """

    measurement: np.ndarray = field("ny", low=0.0)
    process: np.ndarray = field("nw", low=0.0)
    drift: np.ndarray = field("nd", low=0.0)
    memory: float = field("", unit="s", low=0.0, default=0.3)
    coloured: np.ndarray = field("nc", low=0.0, default_factory=lambda: np.empty(0))
    correlation_time: float = field("", unit="s", low=0.0, default=0.1)

    def decays(self, dt: float) -> np.ndarray:
        """By how much the coloured parts (nd + nc) fade in a sample."""
        times = [self.memory] * len(self.drift) + [self.correlation_time] * len(self.coloured)
        return np.exp(-dt / np.array(times)) if times else np.empty(0)

    @property
    def pushes(self) -> np.ndarray:
        """All levels that enter a state of the filter: process, drift, coloured (nw + nd + nc)."""
        return np.concatenate([self.process, self.drift, self.coloured])


@record
class Point:
    """What a prediction depends on: parameters p (np), effects eta (nr, ne) and start states (nr, nx), by record."""

    p: np.ndarray = field("np")
    eta: np.ndarray = field("nr ne")
    start: np.ndarray = field("nr nx")


@record
class Course:
    """What a predictor does along a record, by sample.

    x (N, nx), angle (N, na), inner (N, ni): states, angles and the effects' own states as predicted; outputs predicted (N, ny);
    missing (N, nx): the rates of change by which the measurements correct the states, K_k e_k / dt.
    """

    x: np.ndarray = field("N nx")
    angle: np.ndarray = field("N na")
    inner: np.ndarray = field("N ni")
    predicted: np.ndarray = field("N ny")
    missing: np.ndarray = field("N nx")


@record
class Predictor:
    """Predictions of `plant` along `records` with gains that were computed at `point`; see the module.

    simulated: without process noise, so that nothing corrects the states; the noise's memory is then how long errors last.
    """

    plant: Plant
    records: tuple[Record, ...]
    entries: tuple[str, ...]
    noise: Noise
    expected: Noise  # before the records were looked at
    substeps: int
    point: Point
    passes: tuple[Pass, ...] = ()
    lines: tuple[Linearization, ...] = ()
    carried: np.ndarray = field("n", default_factory=lambda: np.empty(0))  # indices of the filter's states in the full state
    threads: int = 1
    simulated: bool = False

    @property
    def block(self) -> int:
        """Samples after which errors count as independent: a second, or longer where those of a free run last."""
        return max(5, round(max(1.0, 2.0 * self.noise.memory * self.simulated) / self.plant.dt))

    @property
    def samples(self) -> int:
        """Number of measured values in all records."""
        return int(sum(np.isfinite(r.seen).sum() for r in self.records))

    @cached_property
    def measured(self) -> np.ndarray:
        """Which outputs (ny) any record holds."""
        return np.any([np.isfinite(r.y).any(axis=0) for r in self.records], axis=0)

    def deviances(self, i: int, white: np.ndarray) -> np.ndarray:
        """-2 log likelihood (N,) of every sample of record i from its whitened errors (N, ny)."""
        return (white**2).sum(axis=1) - 2.0 * np.log(np.einsum("kii->ki", self.passes[i].whitening)).sum(axis=1)

    def errors(
        self,
        i: int,
        p: np.ndarray,
        eta: np.ndarray,
        start: np.ndarray,
        *,
        white: bool = True,
        drift: bool = True,
        push: np.ndarray | None = None,
    ) -> np.ndarray:
        """Prediction errors (R, N, ny) of record i for R hypotheses p (R, np), eta (R, ne), start (R, nx); 0 where unmeasured.

        push (N, nx, R): known rates of change, each constant over a sample.
        """
        r = self.records[i]
        run = self._run(r, p, eta, start, replace(self._steered(i, drift=drift), push=push))
        e = r.seen[:, :, None] - np.moveaxis(run.measured, 0, 2)  # as they lie in memory
        e[np.isnan(r.seen)] = 0.0
        e[~(np.abs(e) <= RAN_AWAY)] = RAN_AWAY
        return np.ascontiguousarray(np.moveaxis(self.passes[i].whitening @ e if white else e, 2, 0))

    def at(self, point: Point, pushes: Sequence[np.ndarray] | None = None) -> list[np.ndarray]:
        """Whitened errors (N, ny) of every record at one point; pushes: see `errors`, one for each record."""
        found = []
        for i in range(len(self.records)):
            push = None if pushes is None else pushes[i]
            found.append(self.errors(i, point.p[None], point.eta[i][None], point.start[i][None], push=push)[0])
        return found

    def corrected(self, i: int, point: Point) -> np.ndarray:
        """Full states (N, n) of record i after each sample's correction: states, angles, effects' own states, sensor memories."""
        r, gain = self.records[i], self._gain_of_all(i)[:, : self._width]
        run = self._run(r, point.p[None], point.eta[i][None], point.start[i][None], self._steered(i, full=True))
        assert run.full is not None
        return run.full[0] + np.einsum("kij,kj->ki", gain, np.nan_to_num(r.seen - run.measured[0]))

    def course(self, i: int) -> Course | None:
        """States and predictions along record i at the predictor's point; None where the run is lost."""
        r, gain, at, nx = self.records[i], self._gain_of_all(i), self.point, len(self.plant.states)
        run = self._run(r, at.p[None], at.eta[i][None], at.start[i][None], self._steered(i, drift=False, full=True))
        assert run.full is not None
        if not (np.isfinite(run.full).all() and np.isfinite(gain).all()):
            return None
        e = np.where(np.isfinite(r.seen), r.seen - run.measured[0], 0.0)
        missing = np.einsum("kij,kj->ki", gain[:, :nx], e) / self.plant.dt
        x, angle, inner, _ = np.split(run.full[0], [nx, self._inner, self._memories], axis=1)
        if self.plant.discrete:  # a correction moves the states of the next sample through the equation alone
            u, dt = list(r.u.T), self.plant.dt
            after, before = (self.plant.derivative(list(z.T), u, at.p, at.eta[i]) for z in (x + dt * missing, x))
            missing = missing + np.column_stack([np.broadcast_to(b - a, len(x)) for a, b in zip(before, after, strict=True)])
        return Course(x, angle, inner, run.measured[0], missing)

    def regained(self, point: Point, noise: Noise | None = None, *, rounds: int = 1) -> "Predictor":
        """The same predictor with gains along its trajectories at `point`; where the old gains lose one, its gains are NaN."""
        new = replace(self, point=point, noise=noise or self.noise)
        for _ in range(rounds):
            with np.errstate(over="ignore", invalid="ignore"):
                lines = tuple(new._linearized(i) for i in range(len(new.records)))
            passes = tuple(gains(line, new.noise.pushes, new.noise.measurement) for line in lines)
            new = replace(new, lines=lines, passes=passes, carried=new._carried())
        return new

    def with_noise(self, noise: Noise) -> "Predictor":
        """The same predictor with other noise levels: gains about the trajectories that it has."""
        lines = tuple(with_decays(line, noise.decays(self.plant.dt)) for line in self.lines)
        return replace(self, noise=noise, lines=lines, passes=tuple(gains(x, noise.pushes, noise.measurement) for x in lines))

    def coarser(self) -> "Predictor":
        """The same with as few integrator steps a sample as move all errors together by less than VISIBLE.

        Beside dry friction these do not say enough: where it is steep a linearization that is not integrated finely is lost.
        """
        if self._rubs():
            return self.finer()
        off, substeps = self._off(FINE * self.plant.substeps), max(FEWEST, self.plant.substeps // 4)
        while substeps < FINE * self.plant.substeps and off(substeps) > VISIBLE:
            substeps += 1
        return replace(self, substeps=substeps)

    def finer(self) -> "Predictor":
        """The same with as many integrator steps a sample as dry friction asks for that acts at the point.

        It holds a place where it is, which a wider law does not: there the place creeps, and a fit makes up for that by other
        levels, or one for each direction.
        """
        if not self._rubs():
            return self
        most, substeps = FINEST * self.plant.substeps, max(self.substeps, self.plant.substeps)
        off = self._off(most)
        while substeps < most and off(substeps) > VISIBLE:
            substeps = min(2 * substeps, most)
        return replace(self, substeps=substeps)

    # ---- inside ------------------------------------------------------------------------------------------------------

    def _rubs(self) -> bool:
        """Whether dry friction acts at the point."""
        return any(np.any(self.point.eta[:, dry.sizes]) for dry in _dry_friction(self.plant))

    def _off(self, fine: int) -> Callable[[int], float]:
        """By how much the errors of all records move, as a sum of squares, from `fine` integrator steps a sample to fewer."""
        exact = self._beginnings(fine)
        share = [len(r) / len(e) for r, e in zip(self.records, exact, strict=True)]

        def off(substeps: int) -> float:
            pairs = zip(self._beginnings(substeps), exact, share, strict=True)
            return sum(s * float(np.sum((e - right) ** 2)) for e, right, s in pairs)

        return off

    def _beginnings(self, substeps: int) -> list[np.ndarray]:
        """Whitened errors of the first LOOK samples of every record at the point, with so many integrator steps a sample."""
        records = tuple(replace(r, u=r.u[:LOOK], y=r.y[:LOOK]) for r in self.records)
        passes = tuple(Pass(p.gain[:LOOK], p.whitening[:LOOK], 0.0) for p in self.passes)
        return replace(self, records=records, passes=passes, substeps=substeps).at(self.point)

    def _run(self, r: Record, p, eta, start, steering: stepper.Steering) -> stepper.Trajectories:
        R = max(len(p), len(eta), len(start))
        wide = [np.broadcast_to(a, (R, a.shape[1])) for a in (p, eta, start)]
        N, nothing = len(r), np.empty((R, 0))
        lanes = stepper.Lanes(
            parameters=wide[0],
            # a staircase has no slopes for a fit or a filter
            effects=self._softened(wide[0], np.where(_rounding(self.plant), 0.0, wide[1]), wide[2], r.u[0]),
            gains=nothing,
            memory=nothing,
            start=wide[2],
            hold=np.broadcast_to(r.u[0], (R, r.u.shape[1])),
            reference=np.broadcast_to(r.u, (R, *r.u.shape)),
            disturbance=np.broadcast_to(np.zeros(1), (R, *r.u.shape)),
            noise=np.broadcast_to(np.zeros(1), (R, N, len(self.plant.outputs))),
        )
        return stepper.run(self.plant, player(self.plant), lanes, self.substeps, self.threads, steering)

    def _softened(self, p: np.ndarray, eta: np.ndarray, start: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Effects (R, ne) with every law of dry friction as wide as an integrator step h can follow: width^2 + (h a)^2.

        a: the acceleration that the friction gives. A narrower law chatters at rest, and a likelihood with chatter in it has a
        minimum everywhere.
        """
        plant = self.plant
        acting = [dry for dry in _dry_friction(plant) if np.any(eta[:, dry.sizes])]
        if not acting:
            return eta
        soft, none = eta.copy(), np.repeat(plant.effect_vector()[None], len(eta), axis=0)
        rest, u = start.copy(), np.repeat(u[None], len(eta), axis=0)
        rest[:, [plant.state_names.index(speed) for speed in plant.turning.values()]] = 0.0

        def slopes(effects: np.ndarray) -> np.ndarray:
            """Of every state's rate over the state itself, (R, nx), when what sets in has set in."""
            return np.diagonal(plant.jacobians_of(rest, u, p, effects, t=FOREVER)[0], axis1=1, axis2=2)

        bare = slopes(none)
        for dry in acting:
            alone = none.copy()
            alone[:, dry.own] = eta[:, dry.own]
            steep = np.nan_to_num(np.abs(slopes(alone) - bare)).max(axis=1)  # a / width
            soft[:, dry.width] *= np.sqrt(1.0 + (plant.dt / self.substeps * steep) ** 2)
        return soft

    def _gain_of_all(self, i: int) -> np.ndarray:
        """The gain (N, n, ny) with a row for all that a filter may carry, 0 where this one does not."""
        ny = len(self.plant.outputs)
        full = np.zeros((len(self.records[i]), self._readings + ny, ny))
        if self.passes:
            full[:, self.carried.astype(int)] = self.passes[i].gain
        return full

    def _steered(self, i: int, *, drift: bool = True, full: bool = False) -> stepper.Steering:
        """Corrected by record i; without drift all that is coloured is held at 0."""
        noise, plant = self.noise, self.plant
        times = np.repeat([noise.memory, noise.correlation_time], [self._readings - self._width, len(plant.outputs)])
        decay = np.exp(-plant.dt / times)
        if not self.passes:
            return stepper.Steering(decay=decay, full=full)
        carried = self.carried[self.carried < (np.inf if drift else self._width)].astype(int)
        gain = self.passes[i].gain[:, : len(carried)]
        return stepper.Steering(self.records[i].seen, gain, carried, decay=decay, full=full)

    @property
    def _inner(self) -> int:
        """Where the effects' own states begin in the full state."""
        return len(self.plant.states) + len(self.plant.turning)

    @property
    def _memories(self) -> int:
        """Where the sensor memories begin in the full state."""
        return self._inner + len(self.plant.inner)

    @property
    def _width(self) -> int:
        return self._memories + len(self.plant.memories)

    @property
    def _readings(self) -> int:
        """Where the coloured parts of the readings begin, behind those of the rates of states and of the inputs."""
        return self._width + len(self.plant.states) + len(self.plant.inputs)

    def _active(self) -> np.ndarray:
        """Indices in the full state that a filter carries: states, angles, and of effects that are on states and memories."""
        plant, eta = self.plant, _smooth(self.plant, self.point.eta)
        on = {slot.key for slot, value in zip(plant.slots, eta.T, strict=True) if not slot.parameter.shape and value.any()}
        inner = [self._inner + j for j, (place, effect) in enumerate(plant.inner) if f"{effect}@{place}" in on]
        kept = [self._memories + j for j, (name, effect) in enumerate(plant.memories) if f"{effect.id}@{name}" in on]
        return np.array([*range(self._inner), *inner, *kept], dtype=int)

    def _carried(self) -> np.ndarray:
        """Indices of all that a filter carries, in the rows of the kernel's gain: the active ones and what is coloured."""
        places = [*self.plant.state_names, *self.plant.input_names]
        drifting = [self._width + places.index(name) for name in self.entries[: len(self.noise.drift)]]
        readings = self._readings + np.arange(len(self.noise.coloured))
        return np.concatenate([self._active(), np.array(drifting, dtype=int), readings])

    def _linearized(self, i: int) -> Linearization:
        """F, G, H along the corrected trajectory of record i at the point, by differences of the flow over one sample."""
        r, plant, active = self.records[i], self.plant, self._active()
        p, eta = self.point.p[None], _smooth(plant, self.point.eta[i])[None]
        start, N, nx = self.point.start[i][None], len(r), len(plant.states)
        corrected = self.corrected(i, self.point)
        size = np.abs(corrected).max(axis=0) + np.concatenate([r.scale, np.ones(self._width - nx)])
        lanes = 1 + len(active) + len(self.entries)
        restart = np.repeat(corrected[:, :, None], lanes, axis=2)
        push, pushed = np.zeros((N, nx, lanes)), np.zeros(len(self.entries))
        for c, j in enumerate(active):
            restart[:, j, 1 + c] += STEP * size[j]
        acting = self._acting(i, corrected[:, :nx], eta)
        for c, name in enumerate(self.entries):
            if name in plant.state_names:
                j = plant.state_names.index(name)
                pushed[c] = size[j] * STEP / plant.dt
                push[:, j, 1 + len(active) + c] = pushed[c]
            else:
                moves = acting[:, :, plant.input_names.index(name)]
                pushed[c] = STEP / plant.dt * float(np.min(size[:nx] / np.maximum(np.abs(moves).max(axis=0), 1e-300)))
                push[:, :, 1 + len(active) + c] = pushed[c] * moves
        flow = self._run(r, p, np.repeat(eta, lanes, axis=0), start, stepper.Steering(restart=restart, push=push, full=True)).full
        assert flow is not None
        change = flow[1:, 1:, active] - flow[:1, 1:, active]  # (lanes - 1, N - 1, n)
        F = change[: len(active)].transpose(1, 2, 0) / (STEP * size[active])
        G = change[len(active) :].transpose(1, 2, 0) / pushed
        H = self._sensed(r, corrected, eta[0], active, STEP * size)
        added = self._loosen(i, active, size, corrected, flow[0], F, G)
        F, G, added = (np.concatenate([M, M[-1:]]) for M in (F, G, added))
        line = Linearization(F, G, H, np.isfinite(r.seen), added if added.any() else np.empty((0, 0)))
        return _coloured(line, len(self.noise.drift), len(self.noise.coloured), self.noise.decays(plant.dt))

    def _loosen(self, i, active, size, corrected, flow, F, G) -> np.ndarray:
        """Where the play of a sensor stands, over a sample: dm+ = c dz+ + (1 - c) dm, with the chance c that it is taken up; and
        variances (N - 1, n) that this adds, c (1 - c) var(dz+ - dm): it is one or the other, and not in between. Noise of
        the readings counts up to half_width² in it: unlike pushes it does not move what the play follows.

        Slopes of 0 or 1 would be too sure: at a reversal the play would stand where noise had reached, and be fitted wider. A
        filter that took a slope of c for granted would correct by 1 / c, and run away where the slope is 1.
        """
        found = np.zeros((len(F), len(active)))
        plant, r, eta, memory = self.plant, self.records[i], self.point.eta[i], [(name, e.id) for name, e in self.plant.memories]
        for slot, half_width in zip(plant.slots, eta, strict=True):
            if slot.effect.id != PLAY or not half_width:
                continue
            j, own = plant.output_names.index(slot.place), self._memories + memory.index((slot.place, PLAY))
            z = np.broadcast_to(plant.output(list(flow[1:, : len(plant.states)].T), self.point.p, list(r.u[1:].T))[j], len(F))
            H = self._sensed(r, corrected, plant.effect_vector(), active, STEP * size)[1:, j]
            row = active.tolist().index(own)
            F[:, row], G[:, row] = 0.0, 0.0
            beyond = np.abs(z - corrected[:-1, own]) - half_width
            pushed, noise = drifted(F, G, H, self.noise.process, beyond >= 0.0), self.noise.measurement[j] ** 2
            taken_up = ndtr(beyond / np.sqrt(pushed + noise))[:, None]
            F[:, row], G[:, row] = taken_up * np.einsum("ki,kij->kj", H, F), taken_up * np.einsum("ki,kij->kj", H, G)
            F[:, row, row] = 1.0 - taken_up[:, 0]
            if not self.simulated:  # nothing is uncertain there, and nothing corrects
                found[:, row] = taken_up[:, 0] * (1.0 - taken_up[:, 0]) * (pushed + min(noise, half_width**2))
        return found

    def moved(self, i: int, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """What effects `after` (ne) in place of `before` do in every sample of record i to what the filter carries, (N, n)."""
        active = self._active()
        restart = np.repeat(self.corrected(i, self.point)[:, :, None], 2, axis=2)
        both = _smooth(self.plant, np.stack([before, after]))
        at = self.point.p[None], both, self.point.start[i][None]
        flow = self._run(self.records[i], *at, stepper.Steering(restart=restart, full=True)).full
        assert flow is not None
        change = flow[1, 1:, active].T - flow[0, 1:, active].T
        change = np.concatenate([change, change[-1:]])
        return np.pad(change, ((0, 0), (0, len(self.noise.drift) + len(self.noise.coloured))))

    def _acting(self, i: int, x: np.ndarray, eta: np.ndarray) -> np.ndarray:
        """What the inputs do to the rates of change at x (N, nx) along record i: (N, nx, nu); empty where none is an entry."""
        plant, r = self.plant, self.records[i]
        if set(self.entries) <= set(plant.state_names):
            return np.empty((len(x), len(plant.states), 0))
        p, eta = (np.repeat(row[None], len(x), axis=0) for row in (self.point.p, eta[0]))
        return np.nan_to_num(plant.jacobians_of(x, r.u, p, eta)[1], posinf=0.0, neginf=0.0)

    def _sensed(self, r: Record, full: np.ndarray, eta: np.ndarray, active: np.ndarray, step: np.ndarray) -> np.ndarray:
        """H (N, ny, n): what a change of the carried states does to the readings of the sensors."""
        plant, nx, first = self.plant, len(self.plant.states), self._memories
        # where a play stands is what is read: it follows the quantity over a sample, not within an instant
        eta = np.where([s.effect.id == PLAY and on for s, on in zip(plant.slots, eta, strict=True)], np.inf, eta)

        x = np.repeat(full.T[:, None], 1 + len(active), axis=1)  # (n, 1 + m, N), the first as it is
        for c, j in enumerate(active):
            x[j, 1 + c] += step[j]
        z = [np.broadcast_to(v, x.shape[1:]) for v in plant.output(list(x[:nx]), self.point.p, list(r.u.T))]
        m = plant.remember(list(x[first:]), z, z, z, 0.0, eta)
        y = np.array([np.broadcast_to(v, x.shape[1:]) for v in plant.read(m, [0.0] * len(z), eta)])
        return ((y[:, 1:] - y[:, :1]) / step[active, None]).transpose(2, 0, 1)


def _coloured(line: Linearization, nd: int, nc: int, decays: np.ndarray) -> Linearization:
    """The first nd pushes and the nc outputs with a coloured part of their own: states d+ = decay d + w that act like them."""
    (N, n, nw), ny, more = line.G.shape, line.H.shape[1], nd + nc
    F, G, H = np.zeros((N, n + more, n + more)), np.zeros((N, n + more, nw + more)), np.zeros((N, ny, n + more))
    F[:, :n, :n], F[:, :n, n : n + nd] = line.F, line.G[:, :, :nd]
    G[:, :n, :nw], G[:, n:, nw:] = line.G, np.eye(more)
    H[:, :, :n], H[:, :, n + nd :] = line.H, np.eye(ny)[:, :nc]
    added = np.pad(line.added, ((0, 0), (0, more))) if line.added.size else line.added
    return with_decays(Linearization(F, G, H, line.present, added), decays)


def with_decays(line: Linearization, decays: np.ndarray) -> Linearization:
    """The same with coloured parts, the last states, that decay otherwise."""
    F, n = line.F.copy(), line.F.shape[1] - len(decays)
    F[:, n:, n:] = np.diag(decays)
    return replace(line, F=F)


@lru_cache(maxsize=64)
def player(plant: Plant) -> Playback:
    """One and the same controller for a plant: kernels are looked up by it."""
    return Playback(plant.input_names, plant.dt)


class _Dry(NamedTuple):
    """A law of dry friction: where its numbers, its sizes and its width stand among those of the effects."""

    key: str
    own: list[int]
    sizes: list[int]
    width: int


@lru_cache(maxsize=64)
def _dry_friction(plant: Plant) -> tuple[_Dry, ...]:
    """All that the plant may have: each has a width of speed, within which it turns its sign."""
    found = []
    for width, slot in enumerate(plant.slots):
        if slot.parameter.name == "width":
            own = [i for i, q in enumerate(plant.slots) if q.key == slot.key]
            found.append(_Dry(slot.key, own, [i for i in own if not plant.slots[i].parameter.shape], width))
    return tuple(found)


def _rounding(plant: Plant) -> np.ndarray:
    """Which numbers of the effects (ne) are the steps of rounded readings."""
    return np.array([slot.effect.id == "quantisation" for slot in plant.slots], dtype=bool)


def _smooth(plant: Plant, eta: np.ndarray) -> np.ndarray:
    """The effects without rounding of sensors: a staircase has no slope that a filter could use."""
    return np.where(_rounding(plant), 0.0, eta)


def predictor(plant: Plant, dataset: Dataset, *, drift: bool = True, threads: int = 1) -> Predictor:
    """A predictor of `plant` along the records at its nominal parameters, with gains from its stated noise.

    drift: whether what nobody logged may have a coloured part; without, whatever comes and goes is to be explained.
    """
    plant = plant.sampled(dataset.dt, file=", ".join(dataset.names))
    records = tuple(_prepared(plant, e) for e in dataset)
    eta = np.repeat(plant.effect_vector()[None], len(records), axis=0)
    point = Point(plant.nominal, eta, np.array([r.start for r in records]))
    entries, coloured = entry_states(plant)
    noise = _first_noise(plant, dataset, entries, coloured if drift else 0)
    made = Predictor(plant, records, entries, noise, noise, plant.substeps, point, threads=threads)
    return _first_gains(made)


def _first_gains(made: Predictor) -> Predictor:
    """Gains from the linearization at the start, held; then along the trajectories that these give."""
    return kept(_begun(made)).coarser().regained(made.point)


def _begun(made: Predictor) -> Predictor:
    lines = []
    for i, r in enumerate(made.records):
        short = replace(
            made, records=(*made.records[:i], replace(r, u=np.repeat(r.u[:1], 2, 0), y=r.y[:2]), *made.records[i + 1 :])
        )
        line = short._linearized(i)
        F, G, H = (np.repeat(M[:1], len(r), axis=0) for M in (line.F, line.G, line.H))
        lines.append(Linearization(F, G, H, np.isfinite(r.seen)))
    passes = tuple(gains(line, made.noise.pushes, made.noise.measurement) for line in lines)
    return replace(made, lines=tuple(lines), passes=passes, carried=made._carried()).regained(made.point)


def kept(made: Predictor, otherwise: Predictor | None = None) -> Predictor:
    """The predictor with its pushes raised until its filter stays with the records; where none does `otherwise`, or as it is.

    An unstable plant that is off at the start, or that lacks something, is lost by a filter that trusts it.
    """
    tried = made
    for _ in range(RAISES):
        if not _lost(tried):
            return tried
        noise = replace(tried.noise, process=RAISED * tried.noise.process, drift=RAISED * tried.noise.drift)
        tried = _begun(replace(made, noise=noise, passes=(), lines=()))
    return (otherwise or made) if _lost(tried) else tried


def _lost(made: Predictor) -> bool:
    """Whether the errors one step ahead of some output are larger than all that it does."""
    at = made.point
    for i, r in enumerate(made.records):
        e = made.errors(i, at.p[None], at.eta[i][None], at.start[i][None], white=False)[0]
        if not np.all(np.sqrt(np.mean(e**2, axis=0)) <= spread_of(r.y) + made.expected.measurement):
            return True
    return False


def _prepared(plant: Plant, e: Experiment) -> Record:
    for name in plant.needed:
        check_known("channel", name, e.names, file=e.name)
    for bad in bad_stamps(e.t, e.dt):
        raise InputError(f"{bad.fault} stamp at {bad.before:g} s", file=e.name, mend="cut the record there with trim")
    measured = [name for name in plant.output_names if name in e.names]
    if not measured:
        raise InputError(
            f"none of the outputs {', '.join(plant.output_names)}", file=e.name, mend="name the channels as the plant does"
        )
    u = np.column_stack([e[name] if name in e.names else np.zeros(len(e)) for name in plant.input_names])
    y = np.column_stack([e[name] if name in e.names else np.full(len(e), np.nan) for name in plant.output_names])
    start, scale = start_of(plant, y, u)
    return Record(e.name, u, y, start, scale)


def _first_noise(plant: Plant, dataset: Dataset, entries: Sequence[str], coloured: int) -> Noise:
    """The plant's stated noise, or an estimate from the records; pushes as stated, or as a share of what the inputs do."""
    measured = []
    for channel in plant.outputs:
        own = [e for e in dataset if channel.name in e.names]
        stated = plant.noise.get(channel.name, 0.0)
        spread = max((float(np.std(e[channel.name])) for e in own), default=1.0)
        estimate = measurement_noise(Dataset(tuple(own)), channel.name, plant.commanded) if own and not stated else stated
        measured.append(max(estimate, 1e-6 * spread, 1e-12))
    spread = np.array([max(float(np.std(e[n])) if n in e.names else 0.0 for e in dataset) for n in plant.input_names])
    stated = np.array([plant.disturbance.get(n, 0.0) for n in plant.input_names])
    inputs = np.where(stated > 0.0, stated, 0.01 * spread + 1e-9)
    push = dict(zip(plant.input_names, inputs, strict=True)) | dict(zip(plant.state_names, pushes_of(plant, inputs), strict=True))
    process = [plant.process.get(name, max(push[name], 1e-12)) for name in entries]
    white = np.array(process)
    return Noise(np.array(measured), white, 0.1 * white[:coloured])
