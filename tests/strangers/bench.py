"""What every stranger is run with: integration, friction that sticks, amplifiers, sensors, loops; no equation of the workbench.

    x' = rates(x, u, p, f)        y = outputs(x, p)

x (nx), u (nu) and the forces f by place are rows of numbers, one for each of L lanes that run side by side, by Runge-Kutta of
fourth order. Dry friction is a force that is constant over a step: the level, against the motion, or whatever smaller one lets
the step end at rest. So what rubs stands still exactly as long as the rest pulls with less than the level.
"""

from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from workbench.physics.plant import Plant

Numbers = Mapping[str, Any]  # by name: one for all lanes or (L,)
Acting = Mapping[str, Numbers]  # missing physics by "effect@place"


class Place(NamedTuple):
    """Where torques or forces act: the row of x that is its speed, and the sizes that are usual there.

    radian: length that stands for the radian of what turns, in m.
    """

    speed: int
    force: float  # N m, or N
    fast: float  # rad/s, or m/s
    radian: float = 1.0


class Course(NamedTuple):
    """What a signal may do: its range, and how long it holds a level [s]."""

    low: float
    high: float
    hold: tuple[float, float]


class Loop(NamedTuple):
    """u += kp (r - y) + ki integral (r - y) - kd y' of a filter of 4 samples, for input and output by their numbers."""

    input: int
    output: int
    kp: float
    ki: float = 0.0
    kd: float = 0.0


class Lab(NamedTuple):
    """How the machine is run and logged: sample times [s], lengths [s], deviations of noise and of unlogged pushes, signals.

    open: a course for each input, where the machine can be run so. closed: a course for each set-point, of `tracked` outputs.
    base (nu): inputs about which the loops act; inputs that no loop moves follow `free`. range: of each input. settle [s]: time
    before the log. window [s]: how long a run follows its inputs before it drifts or runs away; 0 where it never does.
    """

    dts: tuple[float, ...]
    seconds: tuple[float, float]
    noise: tuple[float, ...]
    push: tuple[float, ...]
    base: tuple[float, ...]
    range: tuple[tuple[float, float], ...]
    open: tuple[Course, ...] = ()
    closed: tuple[Course, ...] = ()
    tracked: tuple[int, ...] = ()
    loops: tuple[Loop, ...] = ()
    free: Mapping[int, Course] = {}
    settle: float = 2.0
    window: float = 0.0


class Machine(NamedTuple):
    """A stranger: its equations, its laboratory, and the plant that its user has written.

    Of `plant` nothing is taken but names, units, and the numbers and tolerances of the data sheet. fine [s]: longest step.
    foreign: physics that no catalogue holds, and a size of each that is much. inside: effects that are numbers of `rates`,
    "effect@place" -> number. sound(x) (L): whether the machine still runs.
    """

    plant: Plant
    rates: Callable[..., Sequence[Any]]
    outputs: Callable[..., Sequence[Any]]
    start: tuple[float, ...]
    places: Mapping[str, Place]
    foreign: Mapping[str, float]
    lab: Lab
    fine: float
    slowest: float  # s, the longest lag that its sensors may have
    sound: Callable[[np.ndarray], np.ndarray] = lambda x: np.all(np.isfinite(x), axis=0)
    inside: Mapping[str, str] = {}
    caps: Mapping[str, float] = {}  # largest sizes where the usual ones do not fit

    @property
    def name(self) -> str:
        return self.plant.name


class Log(NamedTuple):
    """Commands (N, nu, L), readings (N, ny, L) and states (N, nx, L) at the samples."""

    commands: np.ndarray
    measured: np.ndarray
    states: np.ndarray


class Run(NamedTuple):
    """What happens in a run: N samples of dt [s], `before` of them ahead of the log.

    Every signal has lanes last, or one lane for all. Either `commands` (N, nu, L) or `loops` with set-points (N, n, L) of the
    outputs `tracked` and free inputs (N, nu, L), where NaN leaves an input to its loops. pushes (before + N, nu, L) act
    unlogged, noise (before + N, ny, L) is added to the readings. again: every so many samples the states are put back to those
    of `truth` (N, nx, L) plus `shift` (nx, L), 0 never.
    """

    dt: float
    samples: int
    before: int = 0
    commands: np.ndarray | None = None
    loops: tuple[Loop, ...] = ()
    tracked: tuple[int, ...] = ()
    references: np.ndarray | None = None
    free: np.ndarray | None = None
    base: tuple[float, ...] = ()
    range: tuple[tuple[float, float], ...] = ()
    pushes: np.ndarray | None = None
    noise: np.ndarray | None = None
    resolution: tuple[float, ...] = ()
    again: int = 0
    truth: np.ndarray | None = None
    shift: np.ndarray | None = None


def run(machine: Machine, numbers: Numbers, acting: Acting, start: np.ndarray, what: Run) -> Log:
    """The machine with `numbers` (parameters, foreign physics) and the effects `acting`, from `start` (nx, L)."""
    lanes = start.shape[1]
    p = SimpleNamespace(**{name: 0.0 for name in machine.foreign} | dict.fromkeys(machine.inside.values(), 0.0) | dict(numbers))
    for key, name in machine.inside.items():
        if key in acting:
            setattr(p, name, next(iter(acting[key].values())))
    body = _Body(machine, p, acting)
    drives = [_Drive(_at(acting, c.name)) for c in machine.plant.inputs]
    sensors = [_Sensor(_at(acting, c.name)) for c in machine.plant.outputs]
    total, dt = what.before + what.samples, what.dt
    steps = max(1, int(np.ceil(dt / machine.fine - 1e-9)))
    h, nu = dt / steps, len(drives)
    x = np.array(start, float)
    for s, z in zip(sensors, machine.outputs(x, p), strict=True):
        s.settle(z + np.zeros(lanes))
    moving = any(s.moving for s in sensors)
    law = _Law(what, lanes) if what.loops else None
    commands, measured = np.empty((total, nu, lanes)), np.empty((total, len(sensors), lanes))
    states = np.empty((total, len(x), lanes))
    for k in range(total):
        now = max(k - what.before, 0)
        if what.again and k % what.again == 0:
            x = what.truth[k] + (0.0 if what.shift is None else what.shift) + np.zeros((1, lanes))
            for s, z in zip(sensors, machine.outputs(x, p), strict=True):
                s.settle(z)
        states[k] = x
        for i, s in enumerate(sensors):
            noise = 0.0 if what.noise is None else what.noise[k, i]
            measured[k, i] = s.read(noise, what.resolution[i] if what.resolution else 0.0)
        if law:
            commands[k] = law.step(k, now, measured[k])
        else:
            commands[k] = what.commands[now]
        for d, u in zip(drives, commands[k], strict=True):
            d.hold(u, dt)
        for j in range(steps):
            t = (k - what.before) * dt + j * h
            u = [d.mean(j * h, h, t, dt) for d in drives]
            if what.pushes is not None:
                u = [a + b for a, b in zip(u, what.pushes[k], strict=True)]
            x = body.step(x, u, t, h)
            if moving or j == steps - 1:
                for s, z in zip(sensors, machine.outputs(x, p), strict=True):
                    s.step(z, h)
        if not np.isfinite(x).all(axis=0).any():
            commands[k:], measured[k:], states[k:] = np.nan, np.nan, np.nan
            break
    b = what.before
    return Log(commands[b:], measured[b:], states[b:])


def _at(acting: Acting, place: str) -> dict[str, Numbers]:
    """The effects at a place, by id."""
    return {key.partition("@")[0]: own for key, own in acting.items() if key.partition("@")[2] == place}


# ---- the body ----------------------------------------------------------------------------------------------------------


class _Body:
    """Motion over one step after the other; angles are integrated where something is periodic in them."""

    def __init__(self, machine: Machine, p: Any, acting: Acting):
        self.machine, self.p = machine, p
        self.own = {place: own for place in machine.places if (own := _at(acting, place))}
        self.dry = [place for place, own in self.own.items() if DRY & own.keys()]
        self.still = SimpleNamespace(**dict.fromkeys(machine.places, 0.0))
        self.angle = dict.fromkeys(self.own, 0.0)
        self.force = dict.fromkeys(self.dry, 0.0)

    def row(self, place: str) -> int:
        return self.machine.places[place].speed

    def step(self, x: np.ndarray, u: Sequence[Any], t: float, h: float) -> np.ndarray:
        after = self.rubbed(x, u, t, h) if self.dry else self.smooth(x, u, t, h, {})
        for place in self.own:
            own = self.machine.places[place]
            self.angle[place] = self.angle[place] + 0.5 * h * (x[own.speed] + after[own.speed]) / own.radian
        return after

    def rubbed(self, x: np.ndarray, u: Sequence[Any], t: float, h: float) -> np.ndarray:
        """A step with dry friction: the force that would end it at rest, within what friction can give.

        From the forces of the step before; of several places that rub each changes what the others must hold.
        """
        middle = {place: x[self.row(place)] for place in self.dry}
        f = {place: np.clip(self.force[place], *self.bounds(place, v, t + 0.5 * h)) for place, v in middle.items()}
        after = self.smooth(x, u, t, h, f)
        for _ in range(1 if len(self.dry) == 1 else TURNS):
            before = dict(f)
            for place in self.dry:
                row = self.row(place)
                low, high = self.bounds(place, 0.5 * (x[row] + after[row]), t + 0.5 * h)
                if np.all(((f[place] == low) & (after[row] > 0.0)) | ((f[place] == high) & (after[row] < 0.0))):
                    continue  # all of them slide
                more = np.where(high > low, high - low, 1.0)
                answer = (self.smooth(x, u, t, h, f | {place: f[place] + more})[row] - after[row]) / more
                f[place] = np.clip(f[place] - after[row] / answer, low, high)
                after = self.smooth(x, u, t, h, f)
            if all(np.array_equal(f[place], before[place]) for place in self.dry):
                break
        self.force = f
        return after

    def bounds(self, place: str, v: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Forces of friction: the lowest, of what moves forward, and the highest."""
        speed, own = np.abs(v), self.own[place]
        return -dry_level(own, speed, t), dry_level(own, -np.maximum(speed, 1e-300), t)

    def smooth(self, x: np.ndarray, u: Sequence[Any], t: float, h: float, rubbing: Mapping[str, Any]) -> np.ndarray:
        turned = {place: h * x[self.row(place)] / self.machine.places[place].radian for place in self.own}
        half, whole = ({place: self.angle[place] + share * d for place, d in turned.items()} for share in (0.5, 1.0))
        k1 = self.rates(x, u, t, self.angle, rubbing)
        k2 = self.rates(x + 0.5 * h * k1, u, t + 0.5 * h, half, rubbing)
        k3 = self.rates(x + 0.5 * h * k2, u, t + 0.5 * h, half, rubbing)
        k4 = self.rates(x + h * k3, u, t + h, whole, rubbing)
        return x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)

    def rates(
        self, x: np.ndarray, u: Sequence[Any], t: float, angle: Mapping[str, Any], rubbing: Mapping[str, Any]
    ) -> np.ndarray:
        f = self.still
        if self.own:
            forces = {at: _smooth(own, x[self.row(at)], angle[at], t) + rubbing.get(at, 0.0) for at, own in self.own.items()}
            f = SimpleNamespace(**vars(f) | forces)
        found = np.empty_like(x)
        for row, rate in zip(found, self.machine.rates(x, u, self.p, f), strict=True):
            row[:] = rate
        return found


TURNS = 4
DRY = {"coulomb", "stribeck", "asymmetric-friction", "friction-jump"}


def dry_level(own: Mapping[str, Numbers], v: Any, t: float) -> Any:
    """Dry friction [N m or N] of what moves, or begins to move, at speed v."""
    level = 0.0 * v
    if "coulomb" in own:
        level = level + own["coulomb"]["level"]
    if "stribeck" in own:
        level = level + own["stribeck"]["level"] * np.exp(-((v / own["stribeck"]["speed"]) ** 2))
    if "asymmetric-friction" in own:
        both = own["asymmetric-friction"]
        level = level + np.where(v >= 0.0, both["forward"], both["backward"])
    if "friction-jump" in own:
        level = level + own["friction-jump"]["level"] * (t >= own["friction-jump"]["time"])
    return level


def _smooth(own: Mapping[str, Numbers], v: Any, angle: Any, t: float) -> Any:
    """Torque, force or rate of what is smooth at a place."""
    total = 0.0 * v
    if "quadratic-friction" in own:
        total = total - own["quadratic-friction"]["coefficient"] * v * np.abs(v)
    if "imbalance" in own:
        total = total + own["imbalance"]["amplitude"] * np.cos(angle + own["imbalance"]["phase"])
    if "torque-ripple" in own:
        e = own["torque-ripple"]
        total = total + e["amplitude"] * np.cos(e["order"] * angle + e["phase"])
    if "periodic-tension" in own:
        e = own["periodic-tension"]
        total = total + e["amplitude"] * np.cos(2.0 * np.pi * e["frequency"] * t + e["phase"])
    return total


# ---- amplifiers, sensors and loops ---------------------------------------------------------------------------------------


class _Drive:
    """From a held command to what acts: the mean over each step, exact for a dead time of any length."""

    def __init__(self, own: Mapping[str, Numbers]):
        self.own, self.gap, self.count = own, 1.0, 0
        self.held = self.sums = np.empty((0, 0))

    def hold(self, u: np.ndarray, dt: float) -> None:
        """A sample begins: the integral of all that was held before it goes on."""
        k = self.count
        if k == len(self.held):
            more = np.zeros((max(k, 1024), len(u)))
            self.held, self.sums = (np.concatenate([old.reshape(k, len(u)), more]) for old in (self.held, self.sums))
        self.held[k] = u
        self.sums[k] = self.sums[k - 1] + dt * self.held[k - 1] if k else 0.0
        self.count = k + 1

    def mean(self, since: float, h: float, t: float, dt: float) -> np.ndarray:
        """Over h from `since` after the last sample."""
        u = self.held[self.count - 1]
        if not self.own:
            return u
        if "input-delay" in self.own:
            end = (self.count - 1) * dt + since - self.own["input-delay"]["time"] + np.zeros(u.shape)
            u = (self._integral(end + h, dt) - self._integral(end, dt)) / h
        if "offset" in self.own:
            u = u + self.own["offset"]["level"]
        if "dead-zone" in self.own:
            width = self.own["dead-zone"]["half_width"]
            u = np.sign(u) * np.maximum(np.abs(u) - width, 0.0)
        if "saturation" in self.own:
            limit = self.own["saturation"]["limit"]
            u = np.clip(u, -limit, limit)
        if "heating" in self.own:
            e = self.own["heating"]
            u = u * (1.0 - e["fall"] * (1.0 - np.exp(-max(t, 0.0) / e["time"])))
        if "gear-backlash" in self.own:  # where the teeth stand, in half gaps: what moves them is not passed on
            half = np.maximum(0.5 * self.own["gear-backlash"]["play"], 1e-12)
            after = np.clip(self.gap + u * h / half, -1.0, 1.0)
            u, self.gap = u - half * (after - self.gap) / h, after
        return u

    def _integral(self, t: np.ndarray, dt: float) -> np.ndarray:
        """Of the commands from the first sample to t (L,); before it the first one was held for ever."""
        k = np.clip(np.floor(t / dt + 1e-9).astype(int), 0, self.count - 1)
        lane = np.arange(len(t))
        return self.sums[k, lane] + (t - k * dt) * self.held[k, lane]


class _Sensor:
    """Play, lag and resonance follow the quantity step by step; the rest is a map of the reading."""

    def __init__(self, own: Mapping[str, Numbers]):
        self.own, self.moving = own, bool({"backlash", "sensor-lag", "sensor-resonance"} & own.keys())

    def settle(self, z: np.ndarray) -> None:
        self.seen = self.play = self.z = self.lagging = self.before = self.swinging = z
        self.rate = 0.0 * z

    def step(self, z: np.ndarray, h: float) -> None:
        if "backlash" in self.own:
            half = self.own["backlash"]["half_width"]
            z = self.play = np.clip(self.play, z - half, z + half)
        if "sensor-lag" in self.own:  # exact while the quantity goes straight
            time = np.maximum(self.own["sensor-lag"]["time"], 1e-9)
            late = time * (z - self.z) / h
            self.lagging = z - late + (self.lagging - self.z + late) * np.exp(-h / time)
            self.z, z = z, self.lagging
        if "sensor-resonance" in self.own:  # trapezoidal rule
            omega = 1.0 / np.maximum(self.own["sensor-resonance"]["time"], 1e-9)
            zeta, k = self.own["sensor-resonance"]["damping"], 0.5 * h
            pull = omega**2 * (self.before - self.swinging) - 2.0 * zeta * omega * self.rate
            known = self.rate + k * (pull + omega**2 * (z - self.swinging - k * self.rate))
            rate = known / (1.0 + 2.0 * zeta * omega * k + (omega * k) ** 2)
            self.swinging = self.swinging + k * (self.rate + rate)
            self.before, self.rate = z, rate
            z = np.where(omega * h < 100.0, self.swinging, z)  # one that fast is none
        self.seen = z

    def read(self, noise: Any, resolution: float) -> np.ndarray:
        y = self.seen
        if "sensor-nonlinearity" in self.own:
            e = self.own["sensor-nonlinearity"]
            y = y + e["curvature"] * y**2
        if "sensor-gain" in self.own:
            y = y * (1.0 + self.own["sensor-gain"]["error"])
        if "sensor-bias" in self.own:
            y = y + self.own["sensor-bias"]["level"]
        y = y + noise
        steps = [resolution] + ([self.own["quantisation"]["step"]] if "quantisation" in self.own else [])
        for step in steps:
            y = np.where(np.asarray(step) > 0.0, step * np.round(y / np.maximum(step, 1e-12)), y)
        return y


class _Law:
    """The loops of a run; an integral waits while its input is at a limit."""

    def __init__(self, what: Run, lanes: int):
        self.what, self.sums = what, np.zeros((len(what.loops), lanes))
        self.before = self.slopes = None

    def step(self, k: int, now: int, y: np.ndarray) -> np.ndarray:
        what = self.what
        if self.before is None:
            self.before, self.slopes = y.copy(), 0.0 * y
        self.slopes = 0.75 * self.slopes + 0.25 * (y - self.before) / what.dt
        self.before = y.copy()
        u = np.array(what.base, float)[:, None] + np.zeros((1, y.shape[1]))
        wrong = []
        for i, loop in enumerate(what.loops):
            r = what.references[now, what.tracked.index(loop.output)] if loop.output in what.tracked else 0.0
            wrong.append(r - y[loop.output])
            u[loop.input] += loop.kp * wrong[-1] + self.sums[i] - loop.kd * self.slopes[loop.output]
        if what.free is not None:
            u = np.where(np.isnan(what.free[now]), u, what.free[now])
        held = np.array([np.clip(row, *ends) for row, ends in zip(u, what.range, strict=True)])
        for i, loop in enumerate(what.loops):
            self.sums[i] += np.where(held[loop.input] == u[loop.input], loop.ki * what.dt * wrong[i], 0.0)
        return held
