"""Identify interval models: one box, modes along time, or one box for every interval of the schedule.

    IntervalRegression(ARX(2)).fit(dataset)                                     one box that holds every sample
    IntervalRegression(ARX(2), partition=InTime(precision=0.98)).fit(dataset)   modes along time, merged where they are the same
    IntervalRegression(ARX(2), partition=BySchedule(5)).fit(dataset)            a box for each fifth of the schedule

[2] Linear time-varying models with interval parameters.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from workbench.advice import quantum
from workbench.data import Dataset
from workbench.errors import InputError
from workbench.intervals.boxes import BoxProgram, Verified, box_program, smallest_of
from workbench.intervals.domains.aggregation import Aggregation, aggregate
from workbench.intervals.domains.shapes import Box, Domain, Hull
from workbench.intervals.model import IntervalModel, Mode, Span, domain_coordinates
from workbench.intervals.regressors import ARX, Samples, Structure, samples
from workbench.intervals.semantics import InclusionAll, Semantics
from workbench.intervals.splitting import Criterion, MeanRadius, improve, split
from workbench.noise import measurement_noise
from workbench.records import field, record

NOISE_WIDTH = 3.0  # standard deviations that a measurement error is taken to stay within
HULL_DIMENSIONS = 8  # of a regressor whose domain is a hull of samples; above it is their outer box
FEWEST = 10  # samples per parameter that a schedule interval needs for a box of its own


@record
class OneMode:
    """One box for all samples."""


@record
class InTime:
    """exp(-mean radius / range of y) >= precision: modes along time, split by precision, then merge modes of the same regime.

    precision in (0, 1] of the normalised output. shortest: N, a mode has at least N + 1 samples (default: five per parameter).
    tolerance: raise the precision by bisection, within this, as long as no more modes are needed ; None: keep it.
    merge: gauge within which a mode's domain counts as part of another's; None: no merging.

        >>> len(IntervalRegression(ARX(order=1), partition=InTime(precision=0.97)).fit(data).modes) >= 1
        True
    """

    precision: float = field("")
    shortest: int | None = None
    criterion: Criterion = field(default_factory=MeanRadius)
    tolerance: float | None = None
    merge: float | None = 0.1

    def __post_init__(self):
        if not 0.0 < self.precision <= 1.0:
            percent = f"did you mean {self.precision / 100:g}? " if 1.0 < self.precision <= 100.0 else ""
            raise InputError(
                f"precision {self.precision:g}, expected 0 < precision <= 1",
                mend=f"{percent}precision is exp(-radius / range of y)",
            )


@record
class BySchedule:
    """One box for each of `intervals` equal intervals of the schedule; those with few samples join their neighbour.

    >>> len(IntervalRegression(ARX(order=1), partition=BySchedule(3)).fit(data).modes)
    3
    """

    intervals: int = 5

    def __post_init__(self):
        if self.intervals < 1:
            raise InputError(f"{self.intervals} schedule intervals", mend="give 1 or more")


Modes = OneMode | InTime | BySchedule


@record
class IntervalRegression:
    """y(k) = d'psi + theta(k)'z(k), theta(k) in a box: the smallest box that keeps the promise of `semantics`.

    output_error, input_error (one number or one for each input): bounds on |measured - true|, in the unit of the channel. None
    takes them from the records: three standard deviations of the noise of y, half a quantum of a quantised input, 0 for others.

        >>> IntervalRegression(ARX(order=1), output_error=0.15).fit(data).modes[0].box.centre.round(3)
        array([ 0.085,  0.475, -0.008])
    """

    structure: Structure = field(default_factory=ARX)
    semantics: Semantics = field(default_factory=InclusionAll)
    partition: Modes = field(default_factory=OneMode)
    output_error: float | None = None
    input_error: Sequence[float] | float | None = None
    name: str = "interval"

    def fit(self, dataset: Dataset, output: str | None = None) -> IntervalModel:
        """The interval model of one output of the records.

        Raises InputError for records without inputs or with several outputs and none named, for negative errors, for a
        structure the records are too short for, and for a precision that cannot be met (with the best one that can).
        """
        first = dataset.experiments[0]
        y, u = named_output(dataset, output), first.names_of("input")
        if isinstance(self.partition, BySchedule) and not first.names_of("schedule"):
            raise InputError("no schedule channel", mend="name one with --schedule, or leave the schedule intervals out")
        if isinstance(self.partition, BySchedule) and y in first.names_of("schedule"):
            raise InputError(
                "is output and schedule: an envelope would choose its boxes by the measured output",
                channel=y,
                mend="leave the schedule intervals out, or give a schedule from outside",
            )
        e_y, e_u, notes = error_bounds(dataset, y, u, self.output_error, self.input_error)
        S = samples(self.structure, dataset, y, u, output_error=e_y, input_error=e_u)
        program = box_program(S, self.semantics)
        schedule = first.names_of("schedule")[:1] if isinstance(self.partition, BySchedule) else ()
        if isinstance(self.partition, InTime):
            modes, more = _in_time(program, self.partition)
        elif isinstance(self.partition, BySchedule):
            modes, more = _by_schedule(program, self.partition, dataset)
        else:
            modes, more = [_mode(program, np.arange(len(S)))], []
        return IntervalModel(
            name=self.name, dt=dataset.dt, inputs=tuple(first.channel(name) for name in u), output=first.channel(y),
            schedule=first.channel(schedule[0]) if schedule else None, structure=self.structure, semantics=self.semantics,
            output_error=e_y, input_error=np.array(e_u), unit_range=program.unit, modes=tuple(modes),
            trained_on=dataset.fingerprints, notes=(*notes, *more),
        )  # fmt: skip


# ---- channels and errors ------------------------------------------------------------------------------------------------


def named_output(dataset: Dataset, output: str | None) -> str:
    """The output asked for, or the only one."""
    outputs = dataset.experiments[0].names_of("output")
    if output is not None:
        channel = dataset.experiments[0].channel(output)
        if channel.role == "input":
            raise InputError("is an input", channel=output, mend=f"name an output: {', '.join(outputs) or 'with roles'}")
        return channel.name
    if len(outputs) != 1:
        raise InputError(
            f"{len(outputs)} outputs, an interval model has one", mend=f"name one: {', '.join(outputs) or '--output NAME'}"
        )
    return outputs[0]


def error_bounds(
    dataset: Dataset, y: str, inputs: Sequence[str], e_y: float | None, e_u: Sequence[float] | float | None
) -> tuple[float, list[float], list[str]]:
    """e_y, e_u (nu) as given, or from the records with a note that says so."""
    notes = []
    channel = dataset.experiments[0].channel
    if e_y is None:
        sigma = measurement_noise(dataset, y, inputs)
        e_y = NOISE_WIDTH * sigma
        notes.append(
            f"error of {channel(y)} taken as {e_y:.3g}: {NOISE_WIDTH:g} standard deviations of its noise as the records show it"
        )
    if e_u is None:
        e_u = [max(quantum(e[name]) for e in dataset) / 2 for name in inputs]
        said = ", ".join(f"{channel(name)} {e:.3g}" for name, e in zip(inputs, e_u, strict=True))
        notes.append(f"errors of the inputs taken as half their quantum (0: none found): {said}")
    e_u = [float(e_u)] * len(inputs) if isinstance(e_u, int | float) else [float(e) for e in e_u]
    if len(e_u) != len(inputs):
        raise InputError(
            f"{len(e_u)} input errors for {len(inputs)} inputs", mend=f"give one, or one for each of {', '.join(inputs)}"
        )
    return float(e_y), e_u, notes


# ---- modes ------------------------------------------------------------------------------------------------------------


def _in_time(program: BoxProgram, asked: InTime) -> tuple[list[Mode], list[str]]:
    shortest = asked.shortest if asked.shortest is not None else 5 * program.z.shape[1]
    found = split(program, asked.precision, shortest, asked.criterion)
    if asked.tolerance is not None:
        found = improve(program, found, shortest, asked.tolerance, asked.criterion)
    rows = [np.arange(s.first, s.last) for s in found.segments]
    whole = [(r, s) for r, s in zip(rows, found.segments, strict=True)]
    modes = [_mode(program, r, s.fitted, short=s.short) for r, s in whole]
    records = len(set(program.S.piece))
    crossing = f"; {records} records, and no mode reaches from one into the next" * (records > 1)
    notes = [f"{len(modes)} modes along time at precision {found.precision:.6g}{crossing}"]
    if asked.merge is not None and len(modes) > 1:
        merged = _merged(program, modes, rows, found.precision, asked)
        modes = [item.mode for item in merged.items]
        notes.append(
            f"{len(rows)} stretches merged into {len(modes)} modes" if len(modes) < len(rows) else "no two modes are the same"
        )
    return modes, notes


@record
class _Item:
    """A mode and the rows of the regression that it is made of."""

    mode: Mode
    rows: np.ndarray = field("K")


def _merged(
    program: BoxProgram, modes: list[Mode], rows: list[np.ndarray], precision: float, asked: InTime
) -> Aggregation[_Item]:
    """[2] section 5, step 5, with the check of the precision that it leaves out."""

    def join(a: _Item, b: _Item) -> _Item | None:
        both = np.sort(np.concatenate([a.rows, b.rows])).astype(int)
        mode = _mode(program, both)
        part = box_program(program.S.rows(both), program.semantics)
        limit = -math.log(precision) * program.unit
        return None if asked.criterion.too_wide(part, mode.box, 0, len(both), limit) else _Item(mode, both)

    items = [_Item(mode, r) for mode, r in zip(modes, rows, strict=True)]
    return aggregate(items, lambda item: item.mode.domain, join, asked.merge or 0.0)


def _by_schedule(program: BoxProgram, asked: BySchedule, dataset: Dataset) -> tuple[list[Mode], list[str]]:
    name = dataset.experiments[0].names_of("schedule")[0]
    rho = schedule_values(program.S, dataset, name)
    if np.ptp(rho) == 0.0:
        raise InputError("the schedule does not move", channel=name, mend="use one box, or records over more of the range")
    edges = _enough(rho, np.linspace(rho.min(), rho.max(), asked.intervals + 1), FEWEST * program.z.shape[1])
    modes = []
    for low, high in itertools.pairwise(edges):
        domain = _interval(low, high)
        rows = np.flatnonzero(domain.holds(rho[:, None]))  # a sample on an edge counts twice: there both modes are valid
        modes.append(_mode(program, rows, domain=domain))
    merged = [] if len(edges) == asked.intervals + 1 else [f"{len(modes)} schedule intervals: others held too few samples"]
    return modes, merged


def _enough(rho: np.ndarray, edges: np.ndarray, fewest: int) -> np.ndarray:
    """Edges between which at least `fewest` samples lie: an interval with fewer joins the one before it."""
    kept = [edges[0]]
    for edge in edges[1:-1]:
        if np.count_nonzero((rho >= kept[-1]) & (rho < edge)) >= fewest and np.count_nonzero(rho >= edge) >= fewest:
            kept.append(edge)
    return np.array([*kept, edges[-1]])


def schedule_values(S: Samples, dataset: Dataset, channel: str) -> np.ndarray:
    """rho (K) at the samples of a regression."""
    values = [e[channel] for e in dataset]
    return np.array([values[S.origin[int(p)]][int(k)] for p, k in zip(S.piece, S.index, strict=True)])


def _mode(
    program: BoxProgram, rows: np.ndarray, fitted: Verified | None = None, *, domain: Domain | None = None, short: bool = False
) -> Mode:
    part = box_program(program.S.rows(rows), program.semantics)
    fitted = fitted or smallest_of(part, 0, len(rows))
    return Mode(
        box=fitted.box,
        domain=domain or _domain(part),
        spans=spans_of(part.S),
        samples=len(rows),
        mean_radius=fitted.mean_radius,
        precision=math.exp(-fitted.mean_radius / program.unit),
        inflation=fitted.inflation,
        inflated=fitted.inflated,
        short=short,
    )


def _domain(part: BoxProgram) -> Domain:
    """Hull of the regressors, with their errors; in many dimensions their outer box."""
    at, reach = domain_coordinates(part.S), part.worst.reach[part.S.form.source >= 0]
    if at.shape[1] <= HULL_DIMENSIONS:
        return Hull(at, np.broadcast_to(reach, at.shape))
    return Box((at - reach).min(axis=0), (at + reach).max(axis=0))


def spans_of(S: Samples) -> tuple[Span, ...]:
    """Runs of samples that follow each other in one record."""
    breaks = np.flatnonzero((np.diff(S.piece) != 0) | (np.diff(S.index) != 1)) + 1
    edges = [0, *breaks.tolist(), len(S)]
    return tuple(Span(S.records[int(S.piece[a])], int(S.index[a]), int(S.index[b - 1])) for a, b in itertools.pairwise(edges))


def _interval(low: float, high: float) -> Box:
    return Box(np.array([low]), np.array([high]))
