"""Interval boxes and modes at 20 000 samples, side by side with the plain linear program; segments against the literal ones.

Run with OPENBLAS_NUM_THREADS=1 pytest -m bench -s; the literal algorithm alone takes some minutes.
"""

import time
from math import exp
from statistics import median

import control
import numpy as np
import pytest
from scipy.optimize import linprog

from workbench.data import Experiment
from workbench.intervals.boxes import BoxProgram, smallest_box
from workbench.intervals.regressors import ARX, samples
from workbench.intervals.semantics import InclusionAll, InclusionExact
from workbench.intervals.splitting import MaximumRadius, MeanRadius, improve, split

pytestmark = pytest.mark.bench

ERROR = 0.002


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        yield


def regression(N, ts, *, delta=True):
    """G(s) = (s + 2.3)/(s^2 + 6.6 s + 1.67) of [2] (9) with a gain that varies by 15 %: 4 parameters, N samples."""
    random, t = np.random.default_rng(0), np.arange(N) * ts
    u = 2 * np.repeat(random.choice([-1.0, 1.0], N // 10 + 1), 10)[:N]
    y = control.forced_response(control.c2d(control.tf([1, 2.3], [1, 6.6, 1.67]), ts), t, u).outputs
    y = y * (1 + 0.15 * np.sin(0.3 * t)) + ERROR * random.uniform(-1, 1, N)
    e = Experiment.from_arrays("a", ts, inputs={"u": u}, outputs={"y": y})
    return samples(ARX(2, delta=delta, bias=False), e, "y", ["u"], output_error=ERROR)


def clocked(function, repetitions):
    """Median processor time [s] and the last answer: the machine is shared, wall time is other people's too."""
    times = []
    for _ in range(repetitions):
        start = time.process_time()
        answer = function()
        times.append(time.process_time() - start)
    return median(times), answer


def whole_program(S):
    """[2] (8), exact regressors, every row at once."""
    z, target = S.z, S.y - S.psi @ S.form.d
    A = np.vstack([np.hstack([-z, -np.abs(z)]), np.hstack([z, -np.abs(z)])])
    b = np.concatenate([-target - S.output_error, target - S.output_error])
    cost = np.concatenate([np.zeros(z.shape[1]), np.abs(z).mean(axis=0)])
    return linprog(cost, A, b, bounds=[(None, None)] * z.shape[1] + [(0, None)] * z.shape[1], method="highs").fun


@pytest.mark.parametrize("delta", [True, False])
def test_a_box_of_20_000_samples_is_faster_than_the_whole_program(delta, record_property):
    S = regression(20_000, 0.05, delta=delta)
    ours, fitted = clocked(lambda: smallest_box(S, InclusionExact()), 7)
    theirs, optimum = clocked(lambda: whole_program(S), 3)
    assert fitted.mean_radius == pytest.approx(optimum, rel=1e-6)
    record_property("seconds", ours)
    record_property("ratio", theirs / ours)
    print(f"box: {1e3 * ours:.0f} ms, linprog {1e3 * theirs:.0f} ms, {theirs / ours:.1f} times faster")
    assert ours <= 0.05
    assert theirs / ours >= 5


def limit_of(program, share, criterion):
    """A precision that asks for a share of the radius of the box over all samples."""
    program.start(0, len(program.S))
    box = program.solve(0, len(program.S))
    return exp(-share * criterion.radius(program, box, 0, len(program.S)) / program.unit)


@pytest.mark.parametrize(
    ("semantics", "target"), [(InclusionExact(), 20), (InclusionAll(), 40)], ids=["inclusion-exact", "inclusion-all"]
)
def test_20_000_samples_are_split_in_two_seconds_and_improved_in_ten_times_that(semantics, target, record_property):
    program = BoxProgram(regression(20_000, 0.2, delta=False), semantics)
    precision = limit_of(program, 0.95, MeanRadius())
    ours, found = clocked(lambda: split(program, precision, 20), 3)
    assert 15 <= len(found) <= 60
    better, improved = clocked(lambda: improve(program, found, 20, 1e-4), 1)
    record_property("seconds", ours)
    print(f"{len(found)} modes: {ours:.2f} s; appendix B: {better:.1f} s to {len(improved)} modes")
    assert ours <= 2
    assert better <= target


@pytest.mark.parametrize("criterion", [MeanRadius(), MaximumRadius()], ids=["mean", "maximum"])
@pytest.mark.parametrize("delta", [True, False])
def test_2000_samples_are_cut_where_the_literal_algorithm_cuts(delta, criterion):
    S = regression(2000, 0.2, delta=delta)
    program = BoxProgram(S, InclusionExact())
    limit = -np.log(limit_of(program, 0.8, criterion)) * program.unit
    ours, found = clocked(lambda: split(program, exp(-limit / program.unit), 20, criterion), 3)
    theirs, expected = clocked(lambda: literal(S, limit, 20, criterion), 1)
    print(f"{len(found)} modes: {ours:.2f} s, literal {theirs:.1f} s, {theirs / ours:.0f} times faster")
    assert [(s.first, s.last) for s in found.segments] == expected


def literal(S, limit, shortest, criterion):
    """[2] appendix A, repaired: a linear program at every sample of one record."""
    begin, found = 0, []
    while begin < len(S):
        end = min(begin + shortest + 1, len(S))
        while end < len(S) and narrowest(S.rows(slice(begin, end + 1)), criterion) <= limit * (1 + 1e-9):
            end += 1
        found.append((begin, end))
        begin = end
    return found


def narrowest(S, criterion):
    """The least mean or maximum radius of one box over S, with every row."""
    if isinstance(criterion, MeanRadius):
        return whole_program(S)
    z, target = S.z, S.y - S.psi @ S.form.d
    size, none, one = np.abs(z), np.zeros_like(z), np.ones((len(z), 1))
    A = np.vstack([np.hstack([-z, -size, 0 * one]), np.hstack([z, -size, 0 * one]), np.hstack([none, size, -one])])
    b = np.concatenate([-target - S.output_error, target - S.output_error, np.zeros(len(z))])
    p = z.shape[1]
    return linprog([0.0] * 2 * p + [1.0], A, b, bounds=[(None, None)] * p + [(0, None)] * (p + 1)).fun
