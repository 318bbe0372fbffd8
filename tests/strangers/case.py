"""`draw(seed)`: one case, records of a stranger in which something is hidden, or nothing, and the truth about it.

Everything comes from the seed: the machine (in turn), its parameters within the tolerances of the data sheet, the habits of its
laboratory, the loop or none, what is hidden, and how large: from LOW to HIGH times the limit of the yardstick, cut where the
machine would no longer run. A machine that does not run soundly is drawn again with smaller sizes, and `notes` says so.
"""

from collections.abc import Mapping
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from tests.hidden.catalogue import ACTUATOR, SENSOR, SHAFT, SIGNED, SIZE, Hidden, Ranges, shapes
from tests.hidden.drawn import within_tolerance
from tests.hidden.parts import coloured
from tests.strangers.bench import Course, Log, Machine, Run, run
from tests.strangers.registry import MACHINES
from tests.strangers.yardstick import SIZES, Tried, limits
from workbench.data import Dataset, Experiment
from workbench.errors import InputError
from workbench.records import record

LOW, HIGH = 2.0, 20.0  # multiples of the detection limit
RECORDS, HELD_OUT = 3, 2
AT_ONCE = 4  # effects whose limits are found together
RIVAL = 0.1  # of its largest size, at which an effect is taken to be linear
TRIES, SHRINK = 8, 0.6
WAVES = 2.0  # that a ripple has in the records at least
FADING = (0.1, 1.0)  # of the fastest speed in the records: where friction of low speed is gone
OUTSIDE = "outside"  # the place of physics that the catalogue does not have
PHASED = {"imbalance", "torque-ripple", "periodic-tension"}


class Kind(Enum):
    """What a case holds."""

    NOTHING = "nothing"
    SINGLE = "single"
    PAIR = "pair"
    OUTSIDE = "outside"


SHARES = {Kind.NOTHING: 0.20, Kind.SINGLE: 0.45, Kind.PAIR: 0.20, Kind.OUTSIDE: 0.15}


class Setting(NamedTuple):
    """A machine as it was drawn, and the habits of its laboratory; see Lab. pole, colour: of the noise of the sensors."""

    machine: Machine
    numbers: Mapping[str, float]
    dt: float
    samples: int
    closed: bool
    firm: float  # by which the gains of the loops are multiplied
    noise: np.ndarray
    pole: float
    colour: float
    resolution: tuple[float, ...]
    push: np.ndarray
    push_pole: float
    one_way: bool
    seen: tuple[int, ...]


@record
class Case:
    """`records` are for estimation, `held_out` further ones of other programmes; `truth` is empty where nothing is hidden."""

    seed: int
    machine: str
    kind: Kind
    records: Dataset
    held_out: Dataset
    truth: tuple[Hidden, ...]
    setting: Any
    notes: tuple[str, ...] = ()

    @property
    def habits(self) -> dict[str, Any]:
        """What a reader of a wrong answer asks first."""
        s = self.setting
        return {
            "dt": s.dt, "samples": s.samples, "closed": s.closed, "one_way": s.one_way, "colour": round(s.colour, 3),
            "logged": [s.machine.plant.output_names[i] for i in s.seen],
            "resolution": dict(zip(s.machine.plant.output_names, s.resolution, strict=True)),
        }  # fmt: skip


def machine_of(seed: int) -> str:
    """Machines take turns: any len(MACHINES) seeds in a row hold each once."""
    return list(MACHINES)[seed % len(MACHINES)]


def kind_of(seed: int) -> Kind:
    """In the proportions of SHARES."""
    return list(SHARES)[np.random.default_rng([seed, 1]).choice(len(SHARES), p=list(SHARES.values()))]


def draw(seed: int, *, machine: str | None = None, kind: Kind | None = None) -> Case:
    """The case of a seed; `machine` and `kind` fix what is drawn otherwise."""
    own, kind = MACHINES[machine or machine_of(seed)], kind or kind_of(seed)
    drawn = setting(own, np.random.default_rng([seed, 2]))
    bench = _Bench(drawn, seed)
    truth = _truth(bench, kind, np.random.default_rng([seed, 3]))
    notes = []
    for _ in range(TRIES):
        log = bench.run(truth)
        if bench.sound(log):
            break
        if not truth:
            raise InputError(f"seed {seed}: the {own.name} does not run even with nothing hidden", mend="see its laboratory")
        truth = tuple(_smaller(h) for h in truth)
        notes.append(f"did not run: sizes times {SHRINK:g}")
    else:
        raise InputError(f"seed {seed}: no sound runs in {TRIES} tries, {', '.join(h.key for h in truth)}", mend="other caps")
    every = bench.logged(log)
    return Case(seed, own.name, kind, Dataset(every[:RECORDS]), Dataset(every[RECORDS:]), truth, drawn, tuple(notes))


# ---- the laboratory ----------------------------------------------------------------------------------------------------


def setting(machine: Machine, random: np.random.Generator) -> Setting:
    """A machine within its tolerances, in a laboratory with habits."""
    lab, ny = machine.lab, len(machine.plant.outputs)

    def between(low: float, high: float) -> float:
        return float(low * (high / low) ** random.random())

    dt = float(random.choice(lab.dts))
    noise = np.array(lab.noise) * between(0.3, 2.0)
    coarse = random.random() < 0.2  # the quantum of a logger that nobody has looked at
    steps = noise * (random.uniform(1.0, 2.5, ny) if coarse else random.uniform(0.1, 0.5, ny))
    seen = tuple(range(ny))
    if ny > 1 and random.random() < 0.25:
        seen = tuple(sorted(random.choice(ny, ny - 1, replace=False).tolist()))
        if lab.closed and not lab.open and not {*lab.tracked, *(q.output for q in lab.loops)} <= set(seen):
            seen = tuple(range(ny))  # what is logged is at least what the loop reads
    closed = bool(lab.loops) and (not lab.open or random.random() < 0.5)
    return Setting(
        machine=machine,
        numbers=within_tolerance(machine.plant, random),
        dt=dt,
        samples=round(random.uniform(*lab.seconds) / dt),
        closed=closed,
        firm=between(0.8, 1.25),
        noise=noise,
        pole=float(np.exp(-dt / between(0.02, 0.3))),
        colour=float(random.uniform(0.0, 0.5)) if random.random() < 0.5 else 0.0,
        resolution=tuple(steps.tolist()),
        push=np.array(lab.push) * between(0.1, 1.0),
        push_pole=float(np.exp(-dt / between(0.05, 1.0))),
        one_way=bool(random.random() < 0.25),
        seen=seen,
    )


def course(random: np.random.Generator, samples: int, dt: float, what: Course, kind: str) -> np.ndarray:
    """A signal (samples,) within the range of `what`, which holds its levels as long as that says."""
    t, middle, half = dt * np.arange(samples), 0.5 * (what.low + what.high), 0.5 * (what.high - what.low)
    if kind == "waves":
        slow, fast = 1.0 / (4.0 * what.hold[1]), 1.0 / (2.0 * what.hold[0])
        waves = [np.sin(2.0 * np.pi * (slow * (fast / slow) ** random.random() * t + random.random())) for _ in range(5)]
        return middle + half * np.clip(np.sum(waves, axis=0) / 4.0, -1.0, 1.0)
    holds = random.uniform(*what.hold, 2 + int(samples * dt / what.hold[0]))
    which = np.searchsorted(np.cumsum(holds), t, side="right")
    if kind == "binary":
        levels = what.low + (what.high - what.low) * (0.1 + 0.8 * ((np.arange(len(holds) + 1) + random.integers(2)) % 2))
    else:
        levels = random.uniform(what.low, what.high, len(holds) + 1)
    if kind == "ramps":
        ends = np.concatenate([[0.0], np.cumsum(holds)])
        return np.interp(t, ends, levels)
    return levels[which]


PROGRAMMES = ("levels", "binary", "ramps", "waves", "levels")  # the last two are held out


def _fine(fine: float, truth: tuple[Hidden, ...]) -> float:
    """Longest step [s] in which a slow sensor is simulated as it is: the trapezoidal rule adds h^2 / 12 to time^2."""
    times = [h.size for h in truth if h.effect in ("sensor-lag", "sensor-resonance")]
    return min([fine, *(max(time / 5.0, fine / 16.0) for time in times)])


class _Bench:
    """One machine with its programmes; all records of a case run side by side."""

    def __init__(self, s: Setting, seed: int):
        self.s, self.seed = s, seed
        lab, random = s.machine.lab, np.random.default_rng([seed, 4])
        self.before = round(lab.settle / s.dt)
        names = [f"{kind} {k + 1}" for k, kind in enumerate(PROGRAMMES)]
        self.names = [n if k < RECORDS else f"{n} (held out)" for k, n in enumerate(names)]
        signals = lab.closed if s.closed else lab.open
        self.signals, frees = [], []
        for k, kind in enumerate(PROGRAMMES):
            own = [_one_way(c, k) if s.one_way else c for c in signals]
            self.signals.append(np.column_stack([course(random, s.samples, s.dt, c, kind) for c in own]))
            free = np.full((s.samples, len(lab.base)), np.nan)
            for i, c in lab.free.items():
                free[:, i] = course(random, s.samples, s.dt, c, PROGRAMMES[(k + 1) % len(PROGRAMMES)])
            frees.append(free)
        self.signals, self.free = np.stack(self.signals, axis=2), np.stack(frees, axis=2)

    def run(self, truth: tuple[Hidden, ...], records: int = RECORDS + HELD_OUT) -> Log:
        """The first `records` records as lanes; noise, pushes and phases are the same whatever is hidden."""
        s, lab = self.s, self.s.machine.lab
        noise, pushes, acting = [], [], {}
        for r in range(records):
            random = np.random.default_rng([self.seed, 5, r])
            shape = (self.before + s.samples, len(s.noise))
            noise.append(s.noise * coloured(random, shape, s.pole, s.colour))
            pushes.append(s.push * coloured(random, (len(noise[-1]), len(s.push)), s.push_pole, 0.8))
        for h in truth:
            if h.catalogued:
                acting[h.key] = dict(h.parameters)
                if h.effect in PHASED:
                    acting[h.key]["phase"] = np.random.default_rng([self.seed, 6]).uniform(0.0, 2.0 * np.pi, records)
        numbers = dict(s.numbers) | {h.effect.replace("-", "_"): h.size for h in truth if not h.catalogued}
        loops = tuple(q._replace(kp=s.firm * q.kp, ki=s.firm * q.ki, kd=s.firm * q.kd) for q in lab.loops)
        what = Run(
            s.dt, s.samples, self.before, pushes=np.stack(pushes, axis=2), noise=np.stack(noise, axis=2), resolution=s.resolution
        )
        signals, free = self.signals[:, :, :records], self.free[:, :, :records]
        if s.closed:
            what = what._replace(loops=loops, tracked=lab.tracked, references=signals, free=free, base=lab.base, range=lab.range)
        else:
            commands = free.copy()
            commands[:, [i for i in range(len(lab.base)) if i not in lab.free]] = signals
            what = what._replace(commands=commands)
        start = np.repeat(np.array(s.machine.start, float)[:, None], records, axis=1)
        with np.errstate(all="ignore"):  # what runs away is said by `sound`
            return run(s.machine._replace(fine=_fine(s.machine.fine, truth)), numbers, acting, start, what)

    def sound(self, log: Log) -> bool:
        """Whether somebody would have kept these records."""
        with np.errstate(invalid="ignore"):
            return bool(np.isfinite(log.measured).all() and all(self.s.machine.sound(x).all() for x in log.states))

    def logged(self, log: Log) -> tuple[Experiment, ...]:
        """The records as a logger writes them: inputs, what is measured, and the set-points of the loops."""
        plant, made = self.s.machine.plant, []
        for r in range(log.measured.shape[2]):
            by: dict[str, dict[str, np.ndarray]] = {"input": {}, "output": {}, "schedule": {}, "other": {}}
            for i, c in enumerate(plant.inputs):
                by[c.role][c.name] = log.commands[:, i, r]
            for i in self.s.seen:
                by[plant.outputs[i].role][plant.outputs[i].name] = log.measured[:, i, r]
            tracked = self.s.machine.lab.tracked if self.s.closed else ()
            set_points = {f"{plant.outputs[i].name}_set": self.signals[:, j, r] for j, i in enumerate(tracked)}
            units = {c.name: c.unit for c in (*plant.inputs, *plant.outputs) if any(c.name in own for own in by.values())}
            units |= {f"{plant.outputs[i].name}_set": plant.outputs[i].unit for i in tracked}
            made.append(
                Experiment.from_arrays(
                    self.names[r],
                    self.s.dt,
                    inputs=by["input"],
                    outputs=by["output"],
                    schedule=by["schedule"],
                    other=by["other"],
                    references=set_points,
                    units=units,
                )
            )
        return tuple(made)


def _one_way(c: Course, k: int) -> Course:
    """One half of a range, the upper one first."""
    middle = 0.5 * (c.low + c.high)
    return c._replace(low=middle) if k % 2 == 0 else c._replace(high=middle)


# ---- what is hidden ------------------------------------------------------------------------------------------------------


def keys_of(machine: Machine) -> list[str]:
    """Every "effect@place" of the catalogue that fits the machine's ports and that this zoo has equations for."""
    shaft = [*(effect for effect in SHAFT if effect != "load-friction"), "periodic-tension"]
    found = [f"{effect}@{place}" for place in machine.places for effect in shaft]
    found += [f"{effect}@{name}" for name in machine.plant.commanded for effect in ACTUATOR]
    found += [f"{effect}@{c.name}" for c in machine.plant.outputs for effect in SENSOR]
    fitting = {slot.key for slot in machine.plant.slots}
    return [key for key in [*found, *machine.inside] if key in fitting]


def largest(s: Setting, log: Log, key: str) -> float:
    """The largest sensible size of an effect on this machine; of a saturation, what it clips at most."""
    effect, _, place = key.partition("@")
    machine, names = s.machine, s.machine.plant.input_names
    if key in machine.caps:
        return machine.caps[key]
    if place in machine.places:
        own = machine.places[place]
        return own.force * {"quadratic-friction": 0.5 / own.fast**2, "imbalance": 0.3, "torque-ripple": 0.3}.get(effect, 0.5)
    if place in names:
        u = log.commands[:, names.index(place)]
        share = {"offset": 0.25, "dead-zone": 0.2, "gear-backlash": 0.2 * machine.slowest}
        if effect in share:
            return share[effect] * float(np.ptp(u))
        return {"saturation": 0.5 * float(np.abs(u).max()), "input-delay": machine.slowest, "heating": 0.4}[effect]
    y = log.measured[:, machine.plant.output_names.index(place)]
    spread, highest = float(np.std(y)), float(np.abs(y).max())
    return {
        "sensor-lag": machine.slowest, "sensor-resonance": 0.5 * machine.slowest, "sensor-bias": 0.5 * spread, "sensor-gain": 0.2,
        "sensor-nonlinearity": 0.2 / highest, "quantisation": spread, "backlash": 0.3 * spread,
    }[effect]  # fmt: skip


def _ranges(s: Setting, log: Log, place: str) -> Ranges:
    """Shapes that these records can tell from others.

    What fades at speeds that they do not reach is plain dry friction in them; a ripple that does not come back is none.
    """
    ranges = Ranges(s.samples * s.dt, 1.0, 12)
    own = s.machine.places.get(place)
    if own is None:
        return ranges
    speed = log.states[:, own.speed] / own.radian
    fast, turns = float(np.quantile(np.abs(speed), 0.95)), np.ptp(np.cumsum(speed, axis=0), axis=0).max() * s.dt / (2.0 * np.pi)
    least = max(2, int(np.ceil(WAVES / turns)))
    return ranges._replace(radian=own.radian, fading=(FADING[0] * fast, FADING[1] * fast), least=min(least, ranges.orders))


def _hidden(bench: _Bench, log: Log, key: str, size: float, multiple: float, random: np.random.Generator) -> Hidden:
    """An effect of a size, with its shapes drawn; the size of a saturation is what it clips."""
    effect, _, place = key.partition("@")
    s, size_now = bench.s, size
    if effect == "saturation":
        size_now = float(np.abs(log.commands[:, s.machine.plant.input_names.index(place)]).max()) - size
    ranges = _ranges(s, log, place)
    return Hidden(effect, place, {SIZE[effect][0]: size_now} | shapes(effect, ranges, size, random), multiple)


def _truth(bench: _Bench, kind: Kind, random: np.random.Generator) -> tuple[Hidden, ...]:
    if kind is Kind.NOTHING:
        return ()
    log = bench.run((), RECORDS)
    if not bench.sound(log):
        raise InputError(
            f"seed {bench.seed}: the {bench.s.machine.name} does not run even with nothing hidden", mend="see its lab"
        )
    machine = bench.s.machine
    if kind is Kind.OUTSIDE:
        order = [f"{name}@{OUTSIDE}" for name in random.permutation(sorted(machine.foreign))]
    else:
        unseen = {c.name for i, c in enumerate(machine.plant.outputs) if i not in bench.s.seen}
        order = _order([key for key in keys_of(machine) if key.partition("@")[2] not in unseen], random)
    chosen: list[Hidden] = []
    while order and len(chosen) < (2 if kind is Kind.PAIR else 1):
        some, order = order[:AT_ONCE], order[AT_ONCE:]
        found = _limits(bench, log, some, int(random.integers(2**31)))
        for key in some:
            top, (limit, make) = 1.0 / found[key][0], found[key]
            if (
                top >= LOW
                and key.partition("@")[0] not in {h.effect for h in chosen}
                and not _one_law([key, *(h.key for h in chosen)])
            ):
                multiple = float(LOW * (min(HIGH, top) / LOW) ** random.random())
                chosen.append(make(multiple * limit, multiple))
            if len(chosen) == (2 if kind is Kind.PAIR else 1):
                break
    if not chosen:
        raise InputError(f"seed {bench.seed}: nothing shows in these records of the {machine.name}", mend="see its laboratory")
    return tuple(chosen)


def _one_law(keys: list[str]) -> bool:
    """Whether two of them add up to one of them: friction of each direction holds any dry friction at its place."""
    places = [{key.partition("@")[2] for key in keys if key.startswith(f"{e}@")} for e in ("coulomb", "asymmetric-friction")]
    return bool(set.intersection(*places))


def _order(keys: list[str], random: np.random.Generator) -> list[str]:
    """First the effect, then its place: many sensors must not outnumber one shaft."""
    effects = random.permutation(sorted({key.partition("@")[0] for key in keys})).tolist()
    places = {e: random.permutation(sorted(k for k in keys if k.partition("@")[0] == e)).tolist() for e in effects}
    return [places[e][0] for e in effects] + [key for e in effects for key in places[e][1:]]


def _limits(bench: _Bench, log: Log, keys: list[str], seed: int) -> dict[str, tuple[float, Any]]:
    """(share of the largest size from which it shows, what makes it at a share and a multiple) by key.

    Physics outside the catalogue shows where no effect of the catalogue can stand for it.
    """
    s = bench.s
    makers = {key: _maker(bench, log, key, [seed, k]) for k, key in enumerate(keys)}
    tried = {key: [_tried(make(share, 0.0)) for share in SIZES] for key, make in makers.items()}
    others = keys_of(s.machine) if any(key.endswith(f"@{OUTSIDE}") for key in keys) else []
    rivals = [_tried(_maker(bench, log, key, [seed, 100 + k])(RIVAL, 0.0)) for k, key in enumerate(others)]
    with np.errstate(all="ignore"):
        found = limits(s.machine, s.numbers, log, s.dt, tried, s.seen, rivals)
    found |= {key: _rounding(s, key) / largest(s, log, key) for key in keys if key.startswith("quantisation@")}
    found |= {key: np.inf for key in keys if key.startswith("torque-ripple@") and _is_bent(s, log, key.partition("@")[2])}
    return {key: (found[key], makers[key]) for key in keys}


def _is_bent(s: Setting, log: Log, place: str) -> bool:
    """Whether not even the highest order comes back in the records: what is bent over an angle is no ripple."""
    ranges = _ranges(s, log, place)
    return ranges.least == ranges.orders


def _rounding(s: Setting, key: str) -> float:
    """The step whose variance, step^2 / 12, is a quarter of that of the other noise: rounding is noise, it moves nothing."""
    i = s.machine.plant.output_names.index(key.partition("@")[2])
    return float(np.sqrt(3.0 * (s.noise[i] ** 2 + s.resolution[i] ** 2 / 12.0)))


def _maker(bench: _Bench, log: Log, key: str, seed: list[int]) -> Any:
    """(share, multiple) -> the effect at that share of its largest size, always with the same sign and shapes."""
    name, _, place = key.partition("@")
    if place == OUTSIDE:
        top = bench.s.machine.foreign[name]
        return lambda share, multiple: Hidden(name, OUTSIDE, {"size": share * top}, multiple, False)
    top = largest(bench.s, log, key)
    sign = -1.0 if name in SIGNED and np.random.default_rng([*seed, 1]).random() < 0.5 else 1.0
    return lambda share, multiple: _hidden(bench, log, key, sign * share * top, multiple, np.random.default_rng(seed))


def _tried(h: Hidden) -> Tried:
    if not h.catalogued:
        return Tried(numbers={h.effect: h.size})
    return Tried({h.key: dict(h.parameters) | ({"phase": 1.0} if h.effect in PHASED else {})})


def _smaller(h: Hidden) -> Hidden:
    """The same with all sizes SHRINK times as large; a saturation is moved away."""
    if h.effect == "saturation":
        return Hidden(h.effect, h.place, {"limit": h.size / SHRINK**0.5}, h.multiple * SHRINK)
    sizes = {SIZE[h.effect][0], "backward"} if h.catalogued else {"size"}
    parameters = {name: value * (SHRINK if name in sizes else 1.0) for name, value in h.parameters.items()}
    return Hidden(h.effect, h.place, parameters, h.multiple * SHRINK, h.catalogued)
