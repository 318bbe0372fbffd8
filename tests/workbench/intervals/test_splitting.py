"""Operating modes along time: the segments of [2] appendix A, repaired and written out, and what appendix B may claim."""

import re
from math import exp, log

import numpy as np
import pytest
from scipy.optimize import linprog

from workbench.data import Dataset, Experiment
from workbench.errors import InputError
from workbench.intervals.boxes import BoxProgram
from workbench.intervals.paper import PaperProgram
from workbench.intervals.regressors import ARX, samples
from workbench.intervals.semantics import InclusionAll, InclusionExact, InclusionPaper
from workbench.intervals.splitting import MaximumRadius, MeanRadius, improve, split

ERROR = 0.01


def switching(N, seed, name="a", gap=None):
    """A first-order plant whose gain jumps every 60 samples and drifts in between; errors within ERROR."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.uniform(-1, 1, N // 5 + 1), 5)[:N]
    gain = np.repeat(random.uniform(0.3, 0.6, N // 60 + 1), 60)[:N] + 0.03 * np.sin(np.arange(N) / 9)
    y = np.zeros(N)
    for k in range(1, N):
        y[k] = 0.8 * y[k - 1] + gain[k] * u[k - 1]
    t = np.arange(N) * 0.1
    if gap is not None:
        t[gap:] += 1.0
    e = Experiment.from_arrays(name, 0.1, inputs={"u": u}, outputs={"y": y + ERROR * random.uniform(-1, 1, N)})
    return Experiment(name, t, e.channels, e.values, 0.1)


def regression(data, delta=True):
    return samples(ARX(1, delta=delta), data, "y", ["u"], output_error=ERROR, input_error=ERROR / 2)


def literal_rows(S, semantics):
    """For every sample the rows M (centre, radius) >= rhs: corners of each regressor's box and, inside it, its kinks."""
    r = S.error if isinstance(semantics, InclusionAll) else 0.0 * S.error
    found = []
    for psi, y in zip(S.psi, S.y, strict=True):
        ends = [{x - h, x + h} | ({0.0} if abs(x) < h else set()) for x, h in zip(psi, r, strict=True)]  # n = 1: T is diagonal
        at = np.stack(np.meshgrid(*map(sorted, ends)), axis=-1).reshape(-1, len(psi))
        z, known = at @ S.form.T.T, at @ S.form.d
        M = np.vstack([np.hstack([z, np.abs(z)]), np.hstack([-z, np.abs(z)])])
        found.append((M, np.concatenate([y + S.output_error - known, known - y + S.output_error])))
    return found, np.abs(S.z) + np.abs(S.form.T) @ r


def literal_radius(rows, weight, window, criterion):
    """The least mean or maximum radius of one box over a window: one linear program with every row."""
    p = weight.shape[1]
    M, rhs = np.vstack([rows[k][0] for k in window]), np.concatenate([rows[k][1] for k in window])
    if isinstance(criterion, MeanRadius):
        cost = np.concatenate([np.zeros(p), weight[window].mean(axis=0), [0.0]])
        A, b = np.hstack([-M, np.zeros((len(M), 1))]), -rhs
    else:
        cost = np.array([0.0] * 2 * p + [1.0])
        widest = np.hstack([np.zeros((len(window), p)), weight[window], -np.ones((len(window), 1))])
        A, b = np.vstack([np.hstack([-M, np.zeros((len(M), 1))]), widest]), np.concatenate([-rhs, np.zeros(len(window))])
    answer = linprog(cost, A, b, bounds=[(None, None)] * p + [(0, None)] * (p + 1))
    assert answer.status == 0
    return answer.fun


def literal_appendix_a(S, semantics, limit, N, criterion):
    """[2] appendix A, repaired, one linear program at every sample; None where a first window is too wide."""
    rows, weight = literal_rows(S, semantics)
    segments = []
    for piece in np.unique(S.piece):
        begin, last = int(np.argmax(S.piece == piece)), len(S) - int(np.argmax(S.piece[::-1] == piece))
        while begin < last:
            if begin + N >= last:
                segments.append((begin, last, True))
                break
            end = begin + N + 1
            if literal_radius(rows, weight, range(begin, end), criterion) > limit * (1 + 1e-9):
                return None
            while end < last and literal_radius(rows, weight, range(begin, end + 1), criterion) <= limit * (1 + 1e-9):
                end += 1
            segments.append((begin, end, False))
            begin = end
    return segments


def cuts(partition):
    return [(s.first, s.last, s.short) for s in partition.segments]


RECORDS = {
    "one record": lambda: switching(300, 0),
    "gap and short tail": lambda: switching(160, 1, gap=90),
    "two records": lambda: Dataset((switching(90, 2, "a"), switching(75, 3, "b"))),
}


@pytest.mark.slow
@pytest.mark.parametrize("criterion", [MeanRadius(), MaximumRadius()], ids=["mean", "maximum"])
@pytest.mark.parametrize(
    ("records", "delta", "semantics"),
    [
        ("one record", True, InclusionExact()),
        ("one record", False, InclusionExact()),
        ("gap and short tail", False, InclusionAll()),
        ("two records", False, InclusionExact()),
        ("two records", True, InclusionAll()),
    ],
)
def test_segments_are_those_of_the_literal_algorithm(records, delta, semantics, criterion):
    S = regression(RECORDS[records](), delta)
    program = BoxProgram(S, semantics)
    program.start(0, len(S))
    whole = criterion.radius(program, program.solve(0, len(S)), 0, len(S))
    reached = 0
    for share in (0.7, 0.35):
        expected = literal_appendix_a(S, semantics, share * whole, 12, criterion)
        precision = exp(-share * whole / program.unit)
        if expected is None:
            with pytest.raises(InputError, match="cannot be met"):
                split(program, precision, 12, criterion)
        else:
            reached += 1
            assert cuts(split(program, precision, 12, criterion)) == expected
    assert reached


@pytest.mark.parametrize("criterion", [MeanRadius(), MaximumRadius()], ids=["mean", "maximum"])
@pytest.mark.parametrize("semantics", [InclusionExact(), InclusionAll()], ids=lambda s: s.name)
def test_every_mode_keeps_every_sample_within_the_precision_and_none_is_left_out(semantics, criterion):
    S = regression(Dataset((switching(260, 4, "a", gap=100), switching(150, 5, "b"))))
    program = BoxProgram(S, semantics)
    found = split(program, 0.95, 15, criterion)
    assert [s.first for s in found.segments] == [0, *[s.last for s in found.segments[:-1]]]
    assert found.segments[-1].last == len(S)
    for s in found.segments:
        assert len(set(S.piece[s.first : s.last])) == 1
        assert s.short == (s.last - s.first < 16)
        assert program.proven_slack(s.fitted.box, np.arange(s.first, s.last)).min() >= 0
        radius = criterion.radius(program, s.fitted.box, s.first, s.last)
        assert s.short or radius <= -log(0.95) * program.unit * (1 + 1e-6)


def test_the_last_sample_is_tested_and_its_mode_emitted():
    e = switching(100, 6)
    y = e["y"].copy()
    y[-1] += 5.0  # what only the last sample tells
    S = regression(Experiment.from_arrays("a", 0.1, inputs={"u": e["u"]}, outputs={"y": y}))
    program = BoxProgram(S, InclusionExact())
    found = split(program, 0.98, 12, MaximumRadius())
    assert cuts(found)[-1] == (len(S) - 1, len(S), True)


@pytest.mark.parametrize("shortest", [1, 2])
def test_modes_of_two_or_three_samples_end(shortest):
    S = regression(switching(60, 7))
    found = split(BoxProgram(S, InclusionExact()), 0.985, shortest)
    assert all(s.last - s.first >= shortest + 1 for s in found.segments if not s.short)
    assert found.segments[-1].last == len(S)


def fewest(S, semantics, limit, N):
    """The least number of modes over all splits of one record into windows of N + 1 samples or more (a tail may be short)."""
    rows, weight = literal_rows(S, semantics)
    K = len(S)
    best = [0.0] + [np.inf] * K
    for end in range(1, K + 1):
        for begin in range(end - 1, -1, -1):
            window = range(begin, end)
            if end - begin <= N and end < K:
                continue
            if best[begin] + 1 < best[end]:
                if end - begin > N and literal_radius(rows, weight, window, MaximumRadius()) > limit * (1 + 1e-9):
                    break  # a longer window is no narrower
                best[end] = best[begin] + 1
    return best[K]


@pytest.mark.parametrize("seed", [0, 3])
def test_the_maximum_radius_gives_the_fewest_modes(seed):
    S = regression(switching(42, seed))
    program = BoxProgram(S, InclusionExact())
    for precision in (0.94, 0.98):
        found = split(program, precision, 1, MaximumRadius())
        assert len(found) == fewest(S, InclusionExact(), -log(precision) * program.unit, 1)


@pytest.mark.slow
def test_the_papers_inclusion_is_split_with_its_whole_radius():
    S = regression(switching(110, 8), delta=False)
    program = PaperProgram(S, InclusionPaper())
    for criterion in (MeanRadius(), MaximumRadius()):
        found = split(program, 0.98, 12, criterion)
        assert len(found) > 1
        for s in found.segments:
            if not s.short:
                assert criterion.radius(program, s.fitted.box, s.first, s.last) <= -log(0.98) * program.unit * (1 + 1e-6)


# ---- appendix B -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("criterion", [MeanRadius(), MaximumRadius()], ids=["mean", "maximum"])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_precision_is_improved_up_to_where_one_more_mode_is_needed(criterion, seed):
    program = BoxProgram(regression(switching(300, seed)), InclusionAll())
    start = split(program, 0.93, 12, criterion)
    better = improve(program, start, 12, 1e-4, criterion)
    assert better.precision >= start.precision
    assert len(better) <= len(start)
    assert cuts(split(program, better.precision, 12, criterion)) == cuts(better)
    try:
        beyond = len(split(program, better.precision + 1e-4, 12, criterion))
    except InputError:
        beyond = np.inf
    assert beyond > len(start)


def test_one_mode_comes_as_near_to_the_best_precision_as_asked():
    S = regression(switching(200, 3))
    program = BoxProgram(S, InclusionExact())
    program.start(0, len(S))
    best = exp(-program.mean_radius(program.solve(0, len(S)), 0, len(S)) / program.unit)
    better = improve(program, split(program, 0.5, 12), 12, 1e-5)
    assert len(better) == 1
    assert best - 1e-5 <= better.precision <= best + 1e-9


def test_a_tolerance_too_fine_for_floating_point_ends():
    program = BoxProgram(regression(switching(60, 3)), InclusionExact())
    assert len(improve(program, split(program, 0.9, 12), 12, 1e-300)) >= 1


@pytest.mark.parametrize("tolerance", [0.0, -1e-3, np.nan])
def test_a_tolerance_that_is_not_positive_is_refused(tolerance):
    program = BoxProgram(regression(switching(60, 3)), InclusionExact())
    with pytest.raises(InputError, match="greater than 0"):
        improve(program, split(program, 0.9, 12), 12, tolerance)


# ---- refusals -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("criterion", [MeanRadius(), MaximumRadius()], ids=["mean", "maximum"])
@pytest.mark.parametrize("semantics", [InclusionExact(), InclusionAll()], ids=lambda s: s.name)
def test_a_precision_that_cannot_be_met_is_refused_with_one_that_can(semantics, criterion):
    program = BoxProgram(regression(switching(150, 5)), semantics)
    with pytest.raises(InputError, match="cannot be met by modes of 13 samples") as refused:
        split(program, 1.0, 12, criterion)
    named = re.match(r"([\d.]+) can be reached", refused.value.mend)
    assert named
    assert len(split(program, float(named[1]), 12, criterion)) > 1
    # wherever modes begin, the most difficult window of all is met by what it needs itself: less is never named
    rows, weight = literal_rows(program.S, semantics)
    hardest = max(literal_radius(rows, weight, range(k, k + 13), criterion) for k in range(len(program.S) - 12))
    assert float(named[1]) >= exp(-hardest / program.unit) - 2e-5


@pytest.mark.parametrize("precision", [0.0, -0.1, 1.001, np.nan])
def test_a_precision_outside_its_range_is_refused(precision):
    with pytest.raises(InputError, match="0 < precision <= 1"):
        split(BoxProgram(regression(switching(60, 3)), InclusionExact()), precision, 12)


def test_shortest_modes_that_no_record_holds_are_refused():
    program = BoxProgram(regression(switching(60, 3)), InclusionExact())
    with pytest.raises(InputError, match="at least 1"):
        split(program, 0.9, 0)
    with pytest.raises(InputError, match="use N up to 58"):
        split(program, 0.9, 59)
    assert len(split(program, 0.5, 58)) == 1
