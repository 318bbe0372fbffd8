"""What a loop must keep: by how much a run breaks it, positive where it does, and the file in which a person writes it down.

    low, high    max(low - y(k), y(k) - high)               in the unit of the signal
    rate         max |y(k) - y(k-1)| / (t(k) - t(k-1)) - rate      in the unit per second
    settling     max |y(k) - r(k)| - band                   from `settling` seconds after each change of the set-point r on

Each from `begin` on. Bounds of different units are compared by their share, the excess over what the bound allows: the width
between low and high where both are given, else the size of the bound; `rate`; `band`. A run that left the range in which its
plant means something is NaN from there on and breaks every limit, by infinitely much.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from workbench.errors import InputError, check_known
from workbench.files import as_read
from workbench.physics.controller import Loop
from workbench.physics.plant import Plant
from workbench.records import field, record
from workbench.simulation import Scenario
from workbench.toml import Table, kind, read_toml

BOUNDS = ("low", "high", "rate", "settling")
RANGE = "range"  # the bound that a run breaks which has left the range of its plant
MOST = 1e7  # samples of a run
SAME_TIME = 1e-6  # of a sample, within which two times are one


@record
class Excess:
    """By how much R runs break a limit. value (R): in the unit of the bound; share (R): in what the bound allows.

    Positive: broken. sample (R): where; bound (R): which, an index of `BOUNDS`, -1 for a run that left the range. Of several
    bounds that of the largest share.
    """

    value: np.ndarray
    share: np.ndarray
    sample: np.ndarray
    bound: np.ndarray

    def bound_of(self, run: int = 0) -> str:
        """Name of the bound."""
        return RANGE if self.bound[run] < 0 else BOUNDS[int(self.bound[run])]


@record
class Limit:
    """What a signal, a measured output or a command by name, must keep from `begin` [s] on; see the module.

    rate [unit/s] counts between samples of which both are from `begin` on, so that the step of a command at the first sample
    does not. band and settling [s] belong together and need a set-point.
    """

    signal: str
    low: float = field("", default=-np.inf)
    high: float = field("", default=np.inf)
    rate: float = field("", unit="unit/s", low=0.0, default=np.inf)
    band: float = field("", low=0.0, default=np.inf)
    settling: float = field("", unit="s", low=0.0, default=0.0)
    begin: float = field("", unit="s", low=0.0, default=0.0)
    unit: str = ""

    def __post_init__(self):
        if self.low > self.high:
            raise InputError(f"low {self.low:g} is above high {self.high:g}", file=self.signal, mend="exchange them")
        if not self.kept:
            raise InputError("nothing to keep", file=self.signal, mend="give low, high, rate, or band and settling")
        if not all(np.isfinite([self.begin, self.settling])):
            raise InputError("a time that is not finite", file=self.signal, mend="give seconds")

    @property
    def kept(self) -> tuple[str, ...]:
        """The bounds that are there."""
        there = (self.low > -np.inf, self.high < np.inf, self.rate < np.inf, self.band < np.inf)
        return tuple(name for name, given in zip(BOUNDS, there, strict=True) if given)

    @property
    def apart(self) -> "tuple[Limit, ...]":
        """The same as limits of which each asks one thing: between low and high, the rate, the band. Their shares are no measure
        of each other: what is left to a band is not what is left to a bound far off.
        """
        none = {"low": -np.inf, "high": np.inf, "rate": np.inf, "band": np.inf, "settling": 0.0}
        found = []
        for asked in ({"low", "high"}, {"rate"}, {"band", "settling"}):
            if asked & {*self.kept}:
                found.append(replace(self, **{name: value for name, value in none.items() if name not in asked}))
        return tuple(found)

    @property
    def scales(self) -> np.ndarray:
        """What each of `BOUNDS` allows (4), in its own unit; 1 where that is 0, or there is no such bound."""
        width = self.high - self.low
        both = np.isfinite(width) and width > 0.0
        allowed = np.abs([width if both else self.low, width if both else self.high, self.rate, self.band])
        return np.where(np.isfinite(allowed) & (allowed > 0.0), allowed, 1.0)

    def unit_of(self, bound: str) -> str:
        """Unit of an excess."""
        return f"{self.unit}/s" if bound == "rate" else self.unit

    def excess(self, t: np.ndarray, values: np.ndarray, reference: np.ndarray | None = None) -> Excess:
        """Of one run (N) or of R runs (R, N) side by side, at the times t (N) [s]; reference (N): the set-point of the signal."""
        by_bound = self.by_bound(t, values, reference)
        kept = [BOUNDS.index(name) for name in self.kept]
        worst = np.argmax(np.stack([by_bound[i].share for i in kept]), axis=0)

        def taken(name: str) -> np.ndarray:
            return np.take_along_axis(np.stack([getattr(by_bound[i], name) for i in kept]), worst[None], axis=0)[0]

        return Excess(taken("value"), taken("share"), taken("sample"), taken("bound"))

    def by_bound(self, t: np.ndarray, values: np.ndarray, reference: np.ndarray | None = None) -> tuple[Excess, ...]:
        """The excess over each of `BOUNDS` by itself; -inf where there is no such bound."""
        t, y = np.asarray(t, dtype=float), np.atleast_2d(np.asarray(values, dtype=float))
        if y.shape[1] != len(t):
            raise InputError(f"{y.shape[1]} values at {len(t)} times", file=self.signal)
        slack = SAME_TIME * (t[1] - t[0]) if len(t) > 1 else 0.0
        since = t >= self.begin - slack
        scales, lost = self.scales, np.isnan(y)
        over = {"low": (self.low - y, since), "high": (y - self.high, since)}
        if np.isfinite(self.rate):
            steps = np.pad(np.abs(np.diff(y, axis=1)) / np.diff(t), ((0, 0), (1, 0)))
            over["rate"] = steps - self.rate, since & np.concatenate([[False], since[:-1]])
        if np.isfinite(self.band):
            if reference is None:
                raise InputError("no set-point to settle at", file=self.signal, mend="leave band and settling out")
            over["settling"] = np.abs(y - reference) - self.band, since & settled(t, reference, self.settling)
        found = []
        for i, name in enumerate(BOUNDS):
            given = name in self.kept
            excess, counted = over.get(name, (np.full_like(y, -np.inf), since))
            excess = np.where(counted & given & ~lost, excess, -np.inf)
            sample = np.argmax(excess, axis=1)
            value = np.take_along_axis(excess, sample[:, None], axis=1)[:, 0]
            bound = np.full(len(y), i)
            if given:
                out = lost.any(axis=1)
                sample = np.where(out, np.argmax(lost, axis=1), sample)
                value, bound = np.where(out, np.inf, value), np.where(out, -1, bound)
            found.append(Excess(value, value / scales[i], sample, bound))
        return tuple(found)


def settled(t: np.ndarray, reference: np.ndarray, settling: float) -> np.ndarray:
    """Whether the set-point (N) has stood for `settling` seconds at the times t (N), since its last change or the start.

    >>> settled(np.arange(6.0), np.array([0.0, 0.0, 1.0, 1.0, 1.0, 2.0]), 2.0)
    array([False, False, False, False,  True, False])
    """
    moved = np.append(True, np.diff(reference) != 0.0)
    last = np.maximum.accumulate(np.where(moved, np.arange(len(t)), 0))
    return t - t[last] >= settling - (SAME_TIME * (t[1] - t[0]) if len(t) > 1 else 0.0)


@record
class Manoeuvre:
    """A run that limits are kept through: duration [s], set-points by output, each (time [s], value) from time 0 on.

    start: values that replace those of the plant's equilibrium; seed: of noise and disturbance as in the plant, None for none.
    initial: by output the set-points (low, high) at which a model may rest before the run, where not at its first one.
    """

    duration: float = field("", unit="s", low=1e-9, high=1e9)
    setpoints: Mapping[str, tuple[tuple[float, float], ...]]
    start: Mapping[str, float] = field(default_factory=dict)
    seed: int | None = None
    initial: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def rested(self, controller: Loop, first: np.ndarray, name: str = "limits") -> np.ndarray:
        """Set-points (nr, 2) before the run, low and high, of a controller whose first ones are `first` (nr)."""
        source = dict(zip(controller.references, controller.measured, strict=False))
        for output in self.initial:
            check_known("output of the controller", output, source.values(), file=name)
        return np.array([self.initial.get(output, (r, r)) for output, r in zip(source.values(), first, strict=True)])

    def references(self, controller: Loop, dt: float, name: str = "limits") -> dict[str, np.ndarray]:
        """Set-points (N,) of a controller by name, every dt seconds; its outputs must all have one, and no others."""
        source = dict(zip(controller.references, controller.measured, strict=False))
        for output in self.setpoints:
            check_known("output of the controller", output, source.values(), file=name)
        if missing := [output for output in source.values() if output not in self.setpoints]:
            raise InputError(f"no set-point for {', '.join(missing)}", file=name, mend="give one in [run.setpoints]")
        if self.duration / dt > MOST:
            problem = f"duration {self.duration:g} s is {self.duration / dt:.2g} samples of {dt:g} s"
            raise InputError(problem, file=name, mend=f"at most {MOST * dt:g} s")
        t = dt * np.arange(round(self.duration / dt))
        if len(t) < 2:
            raise InputError(f"duration {self.duration:g} s", file=name, mend=f"at least two samples of {dt:g} s")
        found = {}
        for reference, output in source.items():
            if (last := self.setpoints[output][-1][0]) > t[-1] + SAME_TIME * dt:
                problem = f"the set-point of {output} changes at {last:g} s, the run ends at {t[-1]:g} s"
                raise InputError(problem, file=name, mend="a longer duration, or leave the change out")
            times, values = np.array(self.setpoints[output], dtype=float).T
            found[reference] = values[np.searchsorted(times, t + SAME_TIME * dt, side="right") - 1]
        return found

    def scenario(self, plant: Plant, controller: Loop, name: str = "limits") -> Scenario:
        """The run of a plant under a controller."""
        for start in self.start:
            check_known("state or input", start, (*plant.state_names, *plant.input_names), file=name)
        return Scenario(name, self.references(controller, plant.dt, name), self.seed, dict(self.start))


@record
class LoopLimits:
    """Limits of signals over `run`, and what is asked of the loop itself.

    stable: it must be stable; margin: factor by which the boxes of what is uncertain may be widened; sensitivity: largest peak
    |S|; disk: least disk margin at the plant input; None: not asked. moving: parameters may be others at every sample, and not
    only unknown; then such a run refutes too.
    """

    limits: tuple[Limit, ...] = ()
    run: Manoeuvre | None = None
    stable: bool = True
    margin: float | None = None
    sensitivity: float | None = None
    moving: bool = False
    disk: float | None = None
    file: str = ""  # that they are read from


def resolved(limits: Iterable[Limit], plant: Plant, controller: Loop) -> tuple[Limit, ...]:
    """The limits with the units of the plant's signals. Raises InputError for signals that the loop does not have."""
    units = {c.name: c.unit for c in plant.outputs} | {c.name: c.unit for c in plant.inputs if c.name in controller.actuated}
    found = []
    for limit in limits:
        check_known("channel", limit.signal, units, file=f"limit of {limit.signal}")
        unit = units[limit.signal]
        if limit.unit and limit.unit != unit:
            mend = f"give the bounds in {unit or 'its own unit'}"
            raise InputError(f"in {limit.unit}, the plant has it in {unit}", file=f"limit of {limit.signal}", mend=mend)
        if "settling" in limit.kept and setpoint_of(limit, controller) is None:
            known = f"the controller has set-points for {', '.join(controller.measured[: len(controller.references)])}"
            raise InputError("settling needs a set-point", file=f"limit of {limit.signal}", mend=known)
        found.append(replace(limit, unit=unit))
    if not found:
        raise InputError("no limit to keep", file=controller.name, mend="give at least one")
    return tuple(found)


def setpoint_of(limit: Limit, controller: Loop) -> str | None:
    """Name of the set-point of the limit's signal, None where it has none."""
    return dict(zip(controller.measured, controller.references, strict=False)).get(limit.signal)


# ---- the file ------------------------------------------------------------------------------------------------------------------

TABLES = ("run", "limits", "loop")
RUN = ("duration", "seed", "start", "setpoints", "initial")
LIMIT = ("low", "high", "rate", "band", "settling", "begin", "unit")
LOOP = ("stable", "margin", "sensitivity", "moving", "disk")


def load_limits(path: str | Path) -> LoopLimits:
    """Read limits.toml; what is unknown, missing or makes no sense is refused with table, key, what is expected and the mend."""
    return _limits(read_toml(path, TABLES))


def limits_of(content: Mapping[str, Any]) -> LoopLimits:
    """The limits of such a file's content: {"run": {"duration": 20.0, ..}, "limits": {"theta": {"high": 20.0}}, "loop": {..}}."""
    try:
        plain = as_read(dict(content))
    except (TypeError, ValueError) as reason:
        raise InputError(f"limits: {reason}", mend="give plain finite numbers and texts, as in limits.toml") from None
    return _limits(Table(Path("limits"), "", plain, TABLES))


def _limits(top: Table) -> LoopLimits:
    run = manoeuvre(top.table("run", RUN)) if "run" in top.content else None
    named = top.table("limits", None)
    limits = tuple(_limit(named.table(name, LIMIT), name, run) for name in named.content)
    loop = top.table("loop", LOOP)
    if limits and run is None:
        raise InputError(
            "[run] is missing", file=top.file, mend="limits are kept through a run: give its duration and set-points"
        )
    if not limits and not loop.content:
        raise InputError(
            "nothing to keep", file=top.file, mend="give [limits.SIGNAL] with low, high, rate or settling, or [loop]"
        )
    margin, sensitivity = loop.number("margin"), loop.number("sensitivity")
    if margin is not None and margin <= 0.0:
        raise loop.refused("margin", f"{margin:g}", "a factor above 0; 1 is the box as it was found")
    if sensitivity is not None and sensitivity <= 1.0:
        raise loop.refused("sensitivity", f"{sensitivity:g}", "no loop has a peak |S| below 1; usual are 1.4 to 2")
    disk = loop.number("disk")
    if disk is not None and not 0.0 < disk < 2.0:
        raise loop.refused("disk", f"{disk:g}", "a disk margin lies between 0 and 2; usual are 0.5 to 1")
    return LoopLimits(
        limits, run, loop.flag("stable", True), margin, sensitivity, loop.flag("moving", False), disk, str(top.file)
    )


def manoeuvre(run: Table) -> Manoeuvre:
    """Of a table [run] with the keys RUN."""
    duration, seed = run.positive("duration"), run.content.get("seed")
    if duration is None:
        raise InputError("[run] duration is missing", file=run.file, mend="give the seconds of the run: duration = 20.0")
    if duration > 1e9:
        raise run.refused("duration", f"{duration:g}", "expected seconds")
    if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int) or seed < 0):
        raise run.refused("seed", kind(seed), "expected a whole number from 0 on; leave it out for no noise")
    start = run.table("start", None)
    setpoints = run.table("setpoints", None)
    values = {name: start.number(name) or 0.0 for name in start.content}
    steps, initial = {name: _steps(setpoints, name, duration) for name in setpoints.content}, run.table("initial", None)
    return Manoeuvre(duration, steps, values, seed, {name: _interval(initial, name) for name in initial.content})


def _interval(table: Table, name: str) -> tuple[float, float]:
    """(value, value) of a number, else the (low, high) that is given."""
    given = table.content[name]
    if not isinstance(given, list):
        value = table.number(name) or 0.0
        return value, value
    if len(given) != 2 or any(isinstance(v, bool) or not isinstance(v, int | float) or not math.isfinite(v) for v in given):
        raise table.refused(name, f"{given}", "expected a number, or the lowest and the highest one: [0.0, 1.0]")
    if given[0] > given[1]:
        raise table.refused(name, f"{given}", "the lowest set-point comes first")
    return float(given[0]), float(given[1])


def _steps(table: Table, name: str, duration: float) -> tuple[tuple[float, float], ...]:
    """((0, value),) of a constant, else the (time, value) pairs as they are given."""
    given = table.content[name]
    if not isinstance(given, list):
        return ((0.0, table.number(name) or 0.0),)
    pairs = []
    for pair in given:
        numbers = pair if isinstance(pair, list) else []
        if len(numbers) != 2 or any(isinstance(v, bool) or not isinstance(v, int | float) for v in numbers):
            raise table.refused(name, kind(given), "expected a number, or pairs [time, value]: [[0.0, 0.0], [5.0, 5.0]]")
        if not all(math.isfinite(v) for v in numbers):
            raise table.refused(name, f"{pair}", "expected finite numbers")
        pairs.append((float(numbers[0]), float(numbers[1])))
    times = [at for at, _ in pairs]
    if not times or times[0] != 0.0:
        raise table.refused(name, f"{given}", "the first pair is the value at the start: [0.0, value]")
    if any(after <= before for before, after in pairwise(times)):
        raise table.refused(name, f"{given}", "times must rise from pair to pair")
    if times[-1] >= duration:
        raise table.refused(name, f"{given}", f"the last step comes after the run's end at {duration:g} s")
    return tuple(pairs)


def _limit(own: Table, name: str, run: Manoeuvre | None) -> Limit:
    low, high, rate, band = own.number("low"), own.number("high"), own.positive("rate"), own.positive("band")
    settling, begin, unit = own.time("settling"), own.time("begin"), own.content.get("unit", "")
    if low is not None and high is not None and low > high:
        raise own.refused("low", f"{low:g}", f"is above high = {high:g}; exchange them")
    if (band is None) != (settling is None):
        there, missing = ("band", "settling") if settling is None else ("settling", "band")
        raise InputError(
            f"[{own.name}] {there} without {missing}",
            file=own.file,
            mend=f"give {missing} too: the output is within band of its set-point from settling seconds after every step on",
        )
    if low is None and high is None and rate is None and band is None:
        raise InputError(f"[{own.name}] keeps nothing", file=own.file, mend="give low, high, rate, or band and settling")
    if not isinstance(unit, str):
        raise own.refused("unit", kind(unit), "expected a text")
    if run is not None:
        steps = run.setpoints.get(name, ((0.0, 0.0),))
        # a limit that holds from the end of the run on is kept by every loop
        if (begin or 0.0) >= run.duration:
            raise own.refused("begin", f"{begin:g}", f"the run ends at {run.duration:g} s: begin earlier, or run longer")
        if settling is not None and steps[-1][0] + settling >= run.duration:
            mend = f"the set-point last moves at {steps[-1][0]:g} s and the run ends at {run.duration:g} s: run longer"
            raise own.refused("settling", f"{settling:g}", mend)
    unlimited = np.inf
    return Limit(
        name,
        low=-unlimited if low is None else low,
        high=unlimited if high is None else high,
        rate=unlimited if rate is None else rate,
        band=unlimited if band is None else band,
        settling=settling or 0.0,
        begin=begin or 0.0,
        unit=unit,
    )
