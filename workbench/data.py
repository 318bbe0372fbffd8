"""Measured records: channels with units and roles, experiments, and datasets of several records.

Samples first, channels last. Several records are a list and are never concatenated: no method differences or simulates
across the joint of two records.
"""

import dataclasses
import hashlib
import itertools
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Literal, get_args

import numpy as np

from workbench.errors import InputError, check_known
from workbench.records import field, record

#: Relative difference below which two sample times are the same: logger clocks differ.
SAME_DT = 1e-3
#: Samples on either side of an extreme value that tell one measurement from another.
FINGER = 64

Role = Literal["time", "input", "output", "schedule", "scheduled output", "reference", "other"]
#: Of an output that is the schedule as well: it counts as either.
SCHEDULED_OUTPUT: Role = "scheduled output"

#: A step of time longer than this many sample times is a gap.
GAP = 1.5
#: Steps of time that differ from the sample time by less than this share of it are as good as uniform.
JITTER = 0.01


@record
class Channel:
    """A named column with its unit (SI unless it says otherwise) and its role.

    role: time, input, output, schedule, scheduled output (an output that is the schedule as well), reference or other.

        >>> Channel("n", "rad/s", "output")
        Channel(name='n', unit='rad/s', role='output')
    """

    name: str
    unit: str = ""
    role: Role = "other"

    def __post_init__(self):
        check_known("role", self.role, get_args(Role))
        if not (isinstance(self.name, str) and isinstance(self.unit, str)):  # what a file holds may be anything
            raise InputError(f"a channel's name {self.name!r} and unit {self.unit!r} must be text")

    def has_role(self, *roles: Role) -> bool:
        """Whether its role is one of these; a scheduled output is an output and a schedule.

        >>> Channel("level", "m", "scheduled output").has_role("output")
        True
        """
        return any(role in (("output", "schedule") if self.role == SCHEDULED_OUTPUT else (self.role,)) for role in roles)

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@record
class Experiment:
    """One record: values[k, c] is channel c at time t[k] [s]; dt [s] is the sample time, by default the typical step.

    file: the path that it was read from, "" where it comes from no file. notes: how the file was understood where it could not be
    read as it is, in sentences.

        >>> a = data.experiments[0]
        >>> a.names, a["n"].shape
        (('U', 'n', 'way'), (600,))
    """

    name: str
    t: np.ndarray = field("N", unit="s")
    channels: tuple[Channel, ...]
    values: np.ndarray = field("N nc")
    dt: float = field("", unit="s", low=1e-12, default=math.inf)
    file: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self):
        if math.isinf(self.dt):
            object.__setattr__(self, "dt", _typical_step(self.name, self.t))
        names = [channel.name for channel in self.channels]
        if len(names) != self.values.shape[1]:
            raise InputError(
                f"{len(names)} channels for {self.values.shape[1]} columns",
                file=self.name,
                mend="name every column once",
            )
        for name in names:
            if names.count(name) > 1:
                raise InputError("appears twice", file=self.name, channel=name, mend="give each column its own name")
        _check_finite(self.name, names, self.values)

    @classmethod
    def from_arrays(
        cls,
        name: str,
        dt: float | None = None,
        *,
        t: np.ndarray | None = None,
        inputs: Mapping[str, np.ndarray] | None = None,
        outputs: Mapping[str, np.ndarray] | None = None,
        schedule: Mapping[str, np.ndarray] | None = None,
        references: Mapping[str, np.ndarray] | None = None,
        other: Mapping[str, np.ndarray] | None = None,
        units: Mapping[str, str] | None = None,
    ) -> "Experiment":
        """A record from arrays (N,) by channel name, roles by keyword, units by channel name.

        An output that is the schedule as well is given under both keywords, with the same numbers.
        dt [s]: t[k] = k dt; or t (N,) [s]: the time stamps. One of the two. Raises InputError for both or neither, arrays of
        different lengths, numbers that are not finite, units of unknown channels.
        """
        if (dt is None) is (t is None):
            raise InputError("both dt and t" if t is not None else "neither dt nor t", file=name, mend="give one of the two")
        units, outputs, schedule = units or {}, outputs or {}, schedule or {}
        both = _given_twice(name, outputs, schedule)
        columns = [
            *_columns("input", inputs, units),
            *_columns("output", outputs, units, both),
            *_columns("schedule", {key: x for key, x in schedule.items() if key not in both}, units),
            *_columns("reference", references, units),
            *_columns("other", other, units),
        ]
        if not columns:
            raise InputError("no channels", file=name, mend="give at least one array")
        names = [channel.name for channel, _ in columns]
        for key in units:
            check_known("channel", key, names, file=name)
        reference = columns[0][1]
        for channel, array in columns:
            if array.ndim != 1 or len(array) != len(reference):
                raise InputError(
                    f"shape {array.shape}, expected ({len(reference)},) as in {names[0]}",
                    file=name,
                    channel=channel.name,
                    mend="give one number per sample",
                )
        values = np.column_stack([array for _, array in columns])
        _check_finite(name, names, values)
        channels = tuple(channel for channel, _ in columns)
        if t is None:
            assert dt is not None
            return cls(name, np.arange(len(reference)) * float(dt), channels, values, dt)
        if not np.issubdtype(np.asarray(t).dtype, np.number):
            raise InputError(f"t holds {np.asarray(t).dtype}", file=name, mend="give seconds as numbers")
        stamps = np.asarray(t, dtype=float)
        if stamps.shape != reference.shape:
            shapes = f"t has shape {stamps.shape}, expected {reference.shape} as in {names[0]}"
            raise InputError(shapes, file=name, mend="give one time stamp per sample")
        return cls(name, stamps, channels, values)

    def __len__(self) -> int:
        return len(self.t)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(channel.name for channel in self.channels)

    def names_of(self, role: Role) -> tuple[str, ...]:
        """Names of the channels with a role, in column order; a scheduled output is among the outputs and the schedules."""
        return tuple(channel.name for channel in self.channels if channel.has_role(role))

    def __getitem__(self, names: str | Sequence[str]) -> np.ndarray:
        """Column(s) by name: a string gives (N,), a sequence of k names (N, k)."""
        if isinstance(names, str):
            check_known("channel", names, self.names, file=self.name)
            return self.values[:, self.names.index(names)]
        return np.column_stack([self[name] for name in names]) if len(names) else np.empty((len(self), 0))

    @property
    def fingerprint(self) -> str:
        """Hash of the outputs around their largest and smallest values: the same for a copy of the measurement under another
        name, with other stamps, cut shorter, or with columns left out. Without outputs all values are hashed.
        """
        content = hashlib.sha256()
        outputs = sorted(self.names_of("output"))
        for name in outputs or self.names:
            y = self[name]
            content.update(name.encode())
            for k in (int(np.argmax(y)), int(np.argmin(y))) if outputs else ():
                content.update(np.ascontiguousarray(y[max(k - FINGER, 0) : k + FINGER]).tobytes())
            if not outputs:
                content.update(np.ascontiguousarray(y).tobytes())
        return content.hexdigest()

    def channel(self, name: str) -> Channel:
        """The channel called `name`; an unknown name is refused with the nearest match."""
        check_known("channel", name, self.names, file=self.name)
        return self.channels[self.names.index(name)]

    def with_roles(self, inputs: Sequence[str] = (), outputs: Sequence[str] = (), schedule: Sequence[str] = ()) -> "Experiment":
        """The same record with roles as named.

        A role that is named here belongs to these channels only: who held it before becomes "other". A role that is
        not named stays as it was. A channel may be output and schedule, as a level or an angle is that the machine's own
        gains depend on. Raises InputError for unknown names (with the nearest match) and other pairs of roles.
        """
        asked: tuple[tuple[Role, Sequence[str]], ...] = (
            ("input", inputs),
            ("output", outputs),
            ("schedule", schedule),
        )
        new: dict[str, Role] = {}
        for role, names in asked:
            for name in [names] if isinstance(names, str) else names:
                check_known("channel", name, self.names, file=self.name)
                new[name] = self._joined(name, new.get(name, role), role)
        taken: list[Role] = [role for role, names in asked if names]
        channels = tuple(dataclasses.replace(c, role=new.get(c.name) or _left(c, taken)) for c in self.channels)
        return dataclasses.replace(self, channels=channels)

    def _joined(self, name: str, before: Role, role: Role) -> Role:
        """The role of a channel that is named for two."""
        if before != role and (before, role) != ("output", "schedule"):
            mend = "name it once: only an output may be the schedule as well"
            raise InputError(f"is named as {before} and as {role}", file=self.name, channel=name, mend=mend)
        return role if before == role else SCHEDULED_OUTPUT

    def select(self, names: Sequence[str]) -> "Experiment":
        """The same record with these channels only, in this order."""
        channels = tuple(self.channel(name) for name in names)
        return dataclasses.replace(self, channels=channels, values=self[list(names)])

    def trim(self, start: float = -math.inf, stop: float = math.inf) -> "Experiment":
        """The samples with start <= t < stop [s]; their time stamps stay as they were.

        Half open, so that neighbouring pieces share no sample and lose none. A stamp within a millionth of a sample
        time of a bound counts as on it. Raises InputError when nothing is left.
        """
        slack = 1e-6 * self.dt
        return self._samples((self.t >= start - slack) & (self.t < stop - slack), f"{start:g} s <= t < {stop:g} s")

    def split(self, time: float) -> tuple["Experiment", "Experiment"]:
        """The samples with t < time [s], and those with t >= time, as two records."""
        before, after = self.trim(stop=time), self.trim(start=time)
        return (
            dataclasses.replace(before, name=f"{self.name} (before {time:g} s)"),
            dataclasses.replace(after, name=f"{self.name} (from {time:g} s)"),
        )

    def resample(self, dt: float, *, interpolate: bool = False, filtered: bool = True) -> "Experiment":
        """The record at sample time dt [s].

        An integer multiple q of the sample time: new sample k stands for the old samples k q .. k q + q - 1.
        Measured channels pass a zero-phase anti-aliasing filter (Hamming FIR of 20 q + 1 taps, cut-off at the new
        Nyquist frequency, odd continuation at the ends: straight lines pass unchanged) and keep the value at k q.
        Inputs and references are held by the actuator between samples, so they become their mean over the q samples:
        the integral is kept, and an input that was held over the new sample time passes unchanged. Filtering them
        as well would smear each step to both sides of the instant at which it acted. filtered False keeps measured channels as
        they are at k q: in a closed loop the filter would mix later noise into a sample, and commands have answered that noise.

        Any other dt, and uniform stamps for a jittered record, only with `interpolate`: linear between samples for
        measured channels, last value held for inputs and references; without an anti-aliasing filter.
        Raises InputError for a gap, for finer sampling or a broken ratio without `interpolate`, for too few samples.
        """
        if not (math.isfinite(dt) and dt > 0):
            raise InputError(f"sample time {dt:g} s, expected a positive number", file=self.name)
        _check_whole(self)
        if interpolate:
            return _interpolated(self, dt)
        ratio = dt / self.dt
        q = max(round(ratio), 1)
        if abs(ratio - q) > 1e-4 * q:
            raise InputError(
                f"sample time {dt:g} s is {ratio:.6g} times the record's {self.dt:g} s, expected a whole number",
                file=self.name,
                mend=f"use {q * self.dt:g} or {(q + 1) * self.dt:g}, or ask to interpolate (interpolate=True)",
            )
        return self if q == 1 else _decimated(self, q, filtered)

    def _samples(self, kept: np.ndarray, condition: str) -> "Experiment":
        if not kept.any():
            span = f"{self.t[0]:g} s to {self.t[-1]:g} s" if len(self) else "nothing"
            raise InputError(f"no sample with {condition}", file=self.name, mend=f"the record runs from {span}")
        return dataclasses.replace(self, t=self.t[kept], values=self.values[kept])


@record
class Dataset:
    """Several records with the same sample time, channels and roles; never concatenated.

    Raises InputError for records that do not fit together. `read` makes one of files, frames and arrays.

        >>> [f"{e.name}: {len(e)} samples" for e in data.experiments], data.dt
        (['a: 600 samples', 'b: 600 samples'], 0.01)
    """

    experiments: tuple[Experiment, ...]

    def __post_init__(self):
        object.__setattr__(self, "experiments", tuple(self.experiments))
        if not self.experiments:
            raise InputError("no records", mend="name at least one file")
        seen = {self.experiments[0].fingerprint: self.experiments[0].name}
        for experiment in self.experiments[1:]:
            _check_alike(self.experiments[0], experiment)
            if experiment.fingerprint in seen:
                raise InputError(
                    f"holds the same samples as {seen[experiment.fingerprint]!r}",
                    file=experiment.name,
                    mend="name each measurement once",
                )
            seen[experiment.fingerprint] = experiment.name

    def __iter__(self) -> Iterator[Experiment]:
        return iter(self.experiments)

    @property
    def notes(self) -> list[str]:
        """How files were understood that could not be read as they are."""
        alike: dict[tuple[str, ...], list[str]] = {}
        for e in self:
            alike.setdefault(e.notes, []).append(e.name)
        return [f"{', '.join(names)}: {'; '.join(notes)}" for notes, names in alike.items() if notes]

    def __len__(self) -> int:
        return len(self.experiments)

    @property
    def dt(self) -> float:
        return self.experiments[0].dt

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the records, in order."""
        return tuple(experiment.name for experiment in self.experiments)

    @property
    def fingerprints(self) -> tuple[str, ...]:
        """Fingerprint of each record, in order."""
        return tuple(experiment.fingerprint for experiment in self.experiments)

    def with_roles(self, inputs: Sequence[str] = (), outputs: Sequence[str] = (), schedule: Sequence[str] = ()) -> "Dataset":
        """Every record with roles as named; see `Experiment.with_roles`."""
        return Dataset(tuple(e.with_roles(inputs, outputs, schedule) for e in self.experiments))

    def split_records(self, names: Iterable[str]) -> tuple["Dataset", "Dataset"]:
        """The records named, and the rest: say, the held-out records and the estimation records.

        Raises InputError for an unknown name and where either side would be empty.
        """
        wanted = {check_known("record", name, self.names) for name in ([names] if isinstance(names, str) else names)}
        chosen = tuple(e for e in self.experiments if e.name in wanted)
        rest = tuple(e for e in self.experiments if e.name not in wanted)
        if not (chosen and rest):
            raise InputError(
                "all records were named" if chosen else "no record was named",
                mend=f"name some of, but not all of: {', '.join(self.names)}",
            )
        return Dataset(chosen), Dataset(rest)


def check_held_out(estimation: Dataset, held_out: Dataset) -> None:
    """Refuse held-out records that are estimation records under another name or role, or whose units do not fit them."""
    first = estimation.experiments[0]
    used = [c.name for c in first.channels if c.has_role("input", "output", "schedule")]
    known = {e.fingerprint: e.name for e in estimation}
    for e in held_out:
        if e.fingerprint in known:
            raise InputError(
                f"holds the same samples as estimation record {known[e.fingerprint]!r}",
                file=e.name,
                mend="a score counts on records that the model never saw: leave it out of one of the two",
            )
        _check_alike(first.select(used), e.select(used))


def segments(experiment: Experiment, mask: np.ndarray, *, shortest: int = 2) -> list[Experiment]:
    """Every contiguous run of samples where mask (N,) is true, each as its own record; the stamps stay.

    A run ends where the mask turns false and at every gap of the time stamps, so no piece joins samples that were not
    neighbours. Pieces of fewer than `shortest` samples are dropped. Raises InputError for a mask of another length.
    """
    mask = np.asarray(mask, bool)
    if mask.shape != experiment.t.shape:
        raise InputError(f"mask of shape {mask.shape}, expected ({len(experiment)},)", file=experiment.name)
    steps = np.diff(experiment.t)
    broken = (steps > GAP * experiment.dt) | (steps <= 0) | (mask[1:] != mask[:-1])
    edges = np.concatenate([[0], np.flatnonzero(broken) + 1, [len(mask)]])
    pieces = []
    for first, last in itertools.pairwise(edges):
        if last - first >= max(shortest, 1) and mask[first]:
            run = slice(first, last)
            t = experiment.t[run]
            pieces.append(dataclasses.replace(experiment, name=span_name(experiment.name, t), t=t, values=experiment.values[run]))
    return pieces


def span_name(name: str, t: np.ndarray) -> str:
    """Of a piece of a record: the record's name, and from when to when the stamps t (N,) [s] are."""
    return f"{name} ({t[0]:.6g} to {t[-1]:.6g} s)"


StampFault = Literal["gap", "repeated", "backwards"]


@record
class BadStamp:
    """A fault of the time stamps: what is wrong between sample index - 1 and sample index."""

    fault: StampFault
    index: int
    before: float = field("", unit="s")
    after: float = field("", unit="s")


def bad_stamps(t: np.ndarray, dt: float) -> Iterator[BadStamp]:
    """t[k] - t[k-1] <= 0 (repeated, backwards) or > 1.5 dt (gap): the faults of the stamps t (N,), in order."""
    steps = np.diff(t)
    for k in np.flatnonzero(~((steps > 0) & (steps <= GAP * dt))):
        fault: StampFault = "repeated" if steps[k] == 0 else "backwards" if steps[k] < 0 else "gap"
        yield BadStamp(fault, int(k) + 1, t[k], t[k + 1])


def _columns(
    role: Role, group: Mapping[str, np.ndarray] | None, units: Mapping[str, str], scheduled: Collection[str] = ()
) -> list[tuple[Channel, np.ndarray]]:
    return [
        (Channel(name, units.get(name, ""), SCHEDULED_OUTPUT if name in scheduled else role), np.asarray(x, float))
        for name, x in (group or {}).items()
    ]


def _given_twice(name: str, outputs: Mapping[str, np.ndarray], schedule: Mapping[str, np.ndarray]) -> set[str]:
    """The channels that are output and schedule. Raises InputError where the two columns of one name differ."""
    both = set(outputs) & set(schedule)
    for key in sorted(both):
        if not np.array_equal(outputs[key], schedule[key]):
            mend = "give the same numbers twice, or another name"
            raise InputError("is output and schedule with other numbers", file=name, channel=key, mend=mend)
    return both


def _left(channel: Channel, taken: Sequence[Role]) -> Role:
    """The role of a channel after these roles have gone to others."""
    if channel.role == SCHEDULED_OUTPUT:
        rest: list[Role] = [role for role in ("output", "schedule") if role not in taken]
        return SCHEDULED_OUTPUT if len(rest) == 2 else rest[0] if rest else "other"
    return "other" if channel.role in taken else channel.role


def _check_finite(name: str, names: Sequence[str], values: np.ndarray) -> None:
    if np.isfinite(values).all():
        return
    row, column = (int(index) for index in np.argwhere(~np.isfinite(values))[0])
    raise InputError(
        f"sample {row + 1} is {values[row, column]}, expected a finite number",
        file=name,
        channel=names[column],
        mend="cut the record there into two, or repair the value",
    )


def _check_alike(first: Experiment, other: Experiment) -> None:
    pair = f"{first.name} and {other.name}"
    if abs(other.dt - first.dt) > SAME_DT * first.dt:
        raise InputError(
            f"sample times {first.dt:g} s and {other.dt:g} s, expected the same",
            file=pair,
            mend=f"resample both to {max(first.dt, other.dt):g} s: identify --dt, in Python each with .resample(dt)",
        )
    missing = set(first.names) ^ set(other.names)
    if missing:
        name = sorted(missing)[0]
        lacking = other.name if name in first.names else first.name
        raise InputError(
            f"not in {lacking}; all records of a set need the same channels",
            file=pair,
            channel=", ".join(sorted(missing)),
            mend="select the channels that all records have",
        )
    for channel in first.channels:
        twin = other.channel(channel.name)
        if channel.unit and twin.unit and channel.unit != twin.unit:
            problem = f"units {channel.unit} and {twin.unit}, expected the same"
            raise InputError(problem, file=pair, channel=channel.name, mend="convert one of them")
        if channel.role != twin.role:
            problem = f"is {channel.role} in one and {twin.role} in the other"
            raise InputError(problem, file=pair, channel=channel.name, mend="name the roles for all records")


def _check_whole(experiment: Experiment) -> None:
    for bad in bad_stamps(experiment.t, experiment.dt):
        raise InputError(
            f"time stamps are {bad.fault} between {bad.before:g} s and {bad.after:g} s",
            file=experiment.name,
            mend="cut the record there (segments) and resample each piece",
        )


def _held(experiment: Experiment) -> np.ndarray:
    return np.array([channel.role in ("input", "reference") for channel in experiment.channels], bool)


def _decimated(experiment: Experiment, q: int, filtered: bool) -> Experiment:
    blocks = len(experiment) // q
    if blocks < 2:
        raise InputError(
            f"{len(experiment)} samples are too few to keep one in {q}",
            file=experiment.name,
            mend=f"use a sample time of at most {len(experiment) // 2 * experiment.dt:g} s",
        )
    held = _held(experiment)
    values = np.empty((blocks, len(held)))
    whole = experiment.values[: blocks * q]
    values[:, held] = whole[:, held].reshape(blocks, q, -1).mean(axis=1)
    measured = _low_passed(experiment.values[:, ~held], q) if filtered else experiment.values[:, ~held]
    values[:, ~held] = measured[: blocks * q : q]
    t = experiment.t[: blocks * q : q]
    return dataclasses.replace(experiment, t=t, values=values, dt=q * experiment.dt)


def _low_passed(values: np.ndarray, q: int) -> np.ndarray:
    """Zero-phase FIR low-pass at the new Nyquist frequency, as scipy.signal.decimate, but with odd continuation."""
    from scipy.signal import fftconvolve, firwin

    half = min(10 * q, len(values) - 1)
    taps = np.reshape(firwin(2 * half + 1, 1.0 / q), (-1, 1))
    head = 2 * values[0] - values[half:0:-1]
    tail = 2 * values[-1] - values[-2 : -half - 2 : -1]
    centre = values[0]  # the level is taken off first: FFT rounding then scales with the motion, not with the level
    return fftconvolve(np.concatenate([head, values, tail]) - centre, taps, mode="valid", axes=0) + centre


def _interpolated(experiment: Experiment, dt: float) -> Experiment:
    old = experiment.t
    count = math.floor((old[-1] - old[0]) / dt * (1 + 1e-12) + 1e-9) + 1
    if count < 2:
        raise InputError(
            f"sample time {dt:g} s is longer than the record ({old[-1] - old[0]:g} s)",
            file=experiment.name,
            mend="choose a shorter one",
        )
    t = old[0] + dt * np.arange(count)
    held = _held(experiment)
    values = np.empty((count, len(held)))
    # a stamp that rounding put a hair after the grid point still counts as reached
    last = np.searchsorted(old, t + 1e-6 * experiment.dt, side="right") - 1
    for column, is_held in enumerate(held):
        source = experiment.values[:, column]
        values[:, column] = source[last] if is_held else np.interp(t, old, source)
    return dataclasses.replace(experiment, t=t, values=values, dt=dt)


def _typical_step(name: str, t: np.ndarray) -> float:
    """The mean step [s] of time stamps without gaps; raises InputError where there is none."""
    steps = np.diff(t)
    middle = float(np.median(steps)) if len(steps) and np.isfinite(t).all() else 0.0
    if not middle > 0.0:
        raise InputError("its time stamps have no step", file=name, mend="give dt, or two samples and more in the order of time")
    return float(np.mean(steps[(steps > 0.5 * middle) & (steps < 1.5 * middle)]))  # stamps are rounded, and gaps are no steps
