"""Operating modes along time: the longest stretches of samples that one box describes with the precision asked for.

[2] appendix A, repaired: from `begin` a mode takes in one sample after the other until the radius of its envelope exceeds the
limit; the next mode begins at the sample that did not fit. The last sample is tested, the last mode is emitted, every window
starts with N + 1 samples, and a tail that is shorter is emitted and marked. No mode reaches across two records or a gap.

    radius of a mode   mean of radius'(|z_k| + |T| r) over its samples, or their maximum
    precision          exp(-radius / range of y)

The segments are those of the literal algorithm, which solves a linear program at every sample. Most of those need no
program: a box that keeps the new sample and is not too wide certifies it, and a relaxed program (some of the rows) whose
optimum is too wide refuses it.

[2] Linear time-varying models with interval parameters, section 5 and appendices A, B.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from workbench.errors import InputError
from workbench.intervals.boxes import BoxProgram, Verified, verified
from workbench.intervals.semantics import ParameterBox
from workbench.lp import InfeasibleError
from workbench.records import field, record

BLOCK = 512  # samples that are tested at once
SAME = 1e-9  # relative tolerance of the comparison with the limit
ROOM = 1e-7  # relative, above it: the last solve over a segment starts from other rows than the one that accepted it
RUNS = 60  # of the bisection
NEAR = 1e-5  # relative, of the least radius of a mode
DIGITS = 6  # of the precision that a refusal proposes
PATIENCE = 8  # runs


@record
class MeanRadius:
    """The mean radius of the envelope over a mode, [2] definition 4. An easy sample lowers it: greedy is not minimal."""

    def radius(self, program: BoxProgram, box: ParameterBox, first: int, last: int) -> float:
        """Of the envelope over samples [first, last), for one box."""
        return program.mean_radius(box, first, last)

    def too_wide(self, program: BoxProgram, box: ParameterBox, first: int, last: int, limit: float) -> bool:
        return self.radius(program, box, first, last) > limit * (1 + SAME)


@record
class MaximumRadius:
    """The largest radius of the envelope over a mode. It only grows as samples join: greedy gives the fewest modes."""

    def radius(self, program: BoxProgram, box: ParameterBox, first: int, last: int) -> float:
        """Of the envelope over samples [first, last), for one box."""
        return float((program.weight[first:last] @ box.radius).max()) + program.constant_radius(box)

    def too_wide(self, program: BoxProgram, box: ParameterBox, first: int, last: int, limit: float) -> bool:
        return self.radius(program, box, first, last) > limit * (1 + SAME)


Criterion = MeanRadius | MaximumRadius


@record
class Segment:
    """Rows [first, last) of the samples with their verified box; short: a tail of fewer samples than a mode asks for."""

    first: int
    last: int
    fitted: Verified
    short: bool = False


@record
class Partition:
    """Segments in order of time and the precision that each of them keeps (a short tail apart)."""

    segments: tuple[Segment, ...]
    precision: float = field("", low=0.0, high=1.0)
    programs: int = 0  # linear programs that were solved

    def __len__(self) -> int:
        return len(self.segments)


def split(program: BoxProgram, precision: float, shortest: int, criterion: Criterion | None = None) -> Partition:
    """[2] appendix A: the modes for a precision in (0, 1], each of at least `shortest` + 1 samples (N + 1).

    Raises InputError for a precision outside (0, 1], a shortest mode that no record holds, and for a precision that cannot be
    met, with one that can.
    """
    criterion = criterion or MeanRadius()
    _check_precision(precision)
    pieces = _pieces(program, shortest)
    found = _attempt(program, pieces, precision, shortest, criterion)
    if found.unmet is not None:
        reached = _reachable(program, pieces, found, shortest, criterion)
        raise InputError(
            f"precision {precision:g} cannot be met by modes of {shortest + 1} samples",
            file=program.S.records[int(program.S.piece[found.unmet])],
            mend=f"{reached:.{DIGITS}g} can be reached; or allow shorter modes, or use another structure"
            if reached
            else "allow shorter modes or another structure",
        )
    return _emitted(program, found, precision, criterion)


def improve(
    program: BoxProgram, partition: Partition, shortest: int, tolerance: float, criterion: Criterion | None = None
) -> Partition:
    """[2] appendix B: the largest precision, within `tolerance`, that needs no more modes than the partition has.

    Returns the partition stored for it. Raises InputError for a tolerance that is not positive.
    """  # fmt: skip
    criterion = criterion or MeanRadius()
    if not tolerance > 0.0:
        raise InputError(f"tolerance {tolerance:g} of the precision", mend="give a number greater than 0, e.g. 0.001")
    pieces = _pieces(program, shortest)
    lower, upper = partition.precision, _ceiling(program)
    kept: _Cuts | None = None
    solved = partition.programs
    for _ in range(RUNS):
        if upper - lower <= tolerance:
            break
        middle = (lower + upper) / 2
        found = _attempt(program, pieces, middle, shortest, criterion)
        solved += found.programs
        if found.unmet is not None or len(found.segments) > len(partition):
            upper = middle
        else:
            lower, kept = middle, found
    return partition if kept is None else _emitted(program, kept, lower, criterion, solved)


# ---- one run ----------------------------------------------------------------------------------------------------------


@record
class _Cut:
    first: int
    last: int
    short: bool


@record
class _Cuts:
    """Where the segments begin and end, how many programs that took, and where a mode began whose first samples are too many."""

    segments: tuple[_Cut, ...]
    programs: int
    unmet: int | None = None


def _attempt(program: BoxProgram, pieces: Sequence[tuple[int, int]], precision: float, shortest: int, criterion) -> _Cuts:
    """The segments for a precision, up to the first one of which even the shortest mode does not keep it."""
    limit = -math.log(precision) * program.unit
    segments: list[_Cut] = []
    window = _Window(program, limit, criterion)
    for first, last in pieces:
        begin = first
        while begin < last:
            if begin + shortest >= last:
                segments.append(_Cut(begin, last, short=True))
                break
            if not window.open(begin, begin + shortest + 1):
                return _Cuts(tuple(segments), window.programs, unmet=begin)
            end = window.advance(last)
            segments.append(_Cut(begin, end, short=False))
            begin = end
    return _Cuts(tuple(segments), window.programs)


class _Window:
    """Samples [begin, end) that one box describes within the limit, and the box that proves it."""

    def __init__(self, program: BoxProgram, limit: float, criterion: Criterion):
        self.program, self.limit, self.criterion = program, limit, criterion
        self.total = np.vstack([np.zeros(program.weight.shape[1]), np.cumsum(program.weight, axis=0)])
        self.programs = 0

    def open(self, begin: int, end: int) -> bool:
        """Start a mode; False where its first samples do not fit together."""
        self.begin = begin
        self.program.start(begin, end)
        return self._fits(end)

    def advance(self, last: int) -> int:
        """Take in sample after sample up to `last`; returns where the mode ends."""
        while self.end < last:
            self.end = self._certified(last)
            if self.end < last and not self._fits(self.end + 1):
                break
        return self.end

    def _certified(self, last: int) -> int:
        """How far the present box reaches without a new program."""
        box, k, limit = self.box, self.end, self._room(self.box)
        while k < last:
            stop = min(k + BLOCK, last)
            kept = self.program.slack(box, k, stop).min(axis=1) >= -self.program.tolerance
            if isinstance(self.criterion, MeanRadius):
                samples = np.arange(k + 1, stop + 1)
                mean = (self.total[samples] - self.total[self.begin]) @ box.radius / (samples - self.begin)
                kept &= mean <= limit
            else:
                kept &= self.program.weight[k:stop] @ box.radius <= limit
            if not kept.all():
                return k + int(np.argmin(kept))
            k = stop
        return k

    def _fits(self, end: int) -> bool:
        """Whether some box keeps [begin, end) within the limit; if so it becomes the present one."""
        program, begin = self.program, self.begin
        cost = (self.total[end] - self.total[begin]) / (end - begin)
        while True:
            self.programs += 1
            try:
                box = program.relaxed(cost)
            except InfeasibleError:  # only with limits on each radius
                return False
            if isinstance(self.criterion, MeanRadius) and float(cost @ box.radius) > self._room(box):
                return False
            rows = program.violated(box, begin, end, 4)
            for some in rows:
                program.add(some)
            wide = self._too_wide(box, end)
            if len(wide):
                program.add_limit(wide, self.limit)
            if not rows and not len(wide):
                self.box, self.end = box, end
                return True

    def _room(self, box: ParameterBox) -> float:
        """What the limit leaves for the radii."""
        return self.limit * (1 + SAME) - self.program.constant_radius(box)

    def _too_wide(self, box: ParameterBox, end: int) -> np.ndarray:
        if isinstance(self.criterion, MeanRadius):
            return np.empty(0, dtype=int)
        radius = self.program.weight[self.begin : end] @ box.radius
        over = np.flatnonzero(radius > self._room(box))
        return self.begin + over[np.argsort(-radius[over])[:4]]


# ---- around it ---------------------------------------------------------------------------------------------------------


def _emitted(program: BoxProgram, cuts: _Cuts, precision: float, criterion: Criterion, solved: int | None = None) -> Partition:
    """Of every segment the verified box of least mean radius that keeps the precision."""
    window = _Window(program, -math.log(precision) * program.unit * (1 + ROOM), criterion)
    segments = []
    for cut in cuts.segments:
        kept = window.open(cut.first, cut.last)  # a short tail may need more than the limit: then its narrowest box
        if not kept:
            program.start(cut.first, cut.last)
        box = window.box if kept else program.solve(cut.first, cut.last)
        segments.append(Segment(cut.first, cut.last, verified(program, box, cut.first, cut.last), cut.short))
    return Partition(tuple(segments), precision, cuts.programs if solved is None else solved)


def _pieces(program: BoxProgram, shortest: int) -> list[tuple[int, int]]:
    """[first, last) of the rows that follow each other in time."""
    if shortest < 1:
        raise InputError(f"shortest mode N = {shortest}", mend="give at least 1: with 0 no mode ever grows")
    piece = program.S.piece
    edges = [0, *(np.flatnonzero(np.diff(piece)) + 1).tolist(), len(piece)]
    pieces = list(itertools.pairwise(edges))
    longest = max(b - a for a, b in pieces)
    if shortest + 1 > longest:
        raise InputError(
            f"shortest mode of {shortest + 1} samples, the longest record has {longest} with whole regressors",
            mend=f"use N up to {longest - 1}",
        )
    return pieces


def _check_precision(precision: float) -> None:
    if not 0.0 < precision <= 1.0:
        raise InputError(f"precision {precision:g}, expected 0 < precision <= 1", mend="precision is exp(-radius / range of y)")


def _ceiling(program: BoxProgram) -> float:
    """No box is narrower than the measured interval: exp(-mean rad [y] / range)."""
    narrowest = np.maximum(program.top - program.bottom, 0.0).mean() / 2
    return math.exp(-float(narrowest) / program.unit)


def _reachable(
    program: BoxProgram, pieces: Sequence[tuple[int, int]], failed: _Cuts, shortest: int, criterion: Criterion
) -> float:
    """The first precision that is reached, on the way down from one mode that failed to the next; 0 if none is.

    A mode that failed says how wide its envelope has to be. Other precisions cut elsewhere, so a better one may exist; none worse
    than what the most difficult window of all needs is named. Precisions are tried with the digits they are reported with.
    """
    tried: float = 1.0
    for n in range(RUNS):
        if failed.unmet is None:
            return tried
        needed = _narrowest(program, failed.unmet, failed.unmet + shortest + 1, criterion)
        unit = 10.0 ** (DIGITS - 1 - math.floor(math.log10(max(math.exp(-needed / program.unit), 1e-300))))
        # from one failure to the next nearly the same width is needed: after some of them take longer steps
        tried = min(math.floor(math.exp(-needed / program.unit) * unit), round(tried * unit) - 2 ** max(n - PATIENCE, 0)) / unit
        if tried <= 0.0:
            break
        failed = _attempt(program, pieces, tried, shortest, criterion)
    return 0.0


def _narrowest(program: BoxProgram, first: int, last: int, criterion: Criterion) -> float:
    """The least radius, by the criterion, of one box over [first, last); from above, within NEAR of it."""
    program.start(first, last)
    box = program.solve(first, last)
    low, high = MeanRadius().radius(program, box, first, last), criterion.radius(program, box, first, last)
    while high - low > NEAR * high:
        middle = (low + high) / 2
        window = _Window(program, middle, criterion)
        if window.open(first, last):
            high = criterion.radius(program, window.box, first, last)
        else:
            low = middle
    return high
