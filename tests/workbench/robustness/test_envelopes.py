"""Envelopes of a closed loop: closed forms, every sign sequence, the exact hull of the open-loop module, broken proofs."""

from dataclasses import replace
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.workbench.robustness.loops import lagged_course, lagged_machine, steps
from workbench.errors import InputError
from workbench.intervals import envelopes as open_loop
from workbench.intervals import propagation
from workbench.intervals.propagation import Recursion
from workbench.records import RecordError
from workbench.robustness import envelopes
from workbench.robustness.envelopes import Course, dual, envelope, kernel, nominal, replay, worst

SEEDS = st.integers(0, 10**6)


def some(seed, n=3, p=4, c=2, s=2, N=12, *, M=1, lam=0.1, radius=0.8, start=1.0) -> Course:
    """A course drawn from `seed`; M modes, or with M = N one for every sample."""
    random = np.random.default_rng(seed)
    A = random.standard_normal((M, n, n))
    A *= radius / np.abs(np.linalg.eigvals(A)).max(axis=1)[:, None, None]
    if M > 1:  # near each other: the products of stable matrices that differ may grow
        A = A[:1] + 0.1 * (A - A[:1])
    return Course(
        A=A,
        B=random.standard_normal((M, n, c)),
        C=random.standard_normal((M, p, n)),
        E=random.standard_normal((M, s, n)),
        F=random.standard_normal((M, s, c)),
        lam=lam * random.uniform(0.2, 1.0, (M, p)),
        channel=random.permutation(np.arange(p) % c),
        mode=np.arange(N) if M == N else random.integers(0, M, N),
        q=random.standard_normal((N, n)),
        g=random.standard_normal((N, s)),
        f=random.standard_normal((N, p)),
        start=start * random.standard_normal(n),
        signals=tuple(f"v{i}" for i in range(s)),
    )


def within(course, gain) -> Course:
    """The same with boxes that give the kernel this gain: below 1 everything stays bounded."""
    return replace(course, lam=course.lam * gain / kernel(course).gain)


def scalar(a, lam, N, *, q=0.0, start=0.0, through=0.0) -> Course:
    """x(k+1) = a(k) x + q + w, w = delta lam(k) x, v = x + through w."""
    a, lam = np.broadcast_to(a, N), np.broadcast_to(lam, N)
    one = np.ones((N, 1, 1))
    return Course(
        a[:, None, None], one, one, one, through * one, lam[:, None], [0], np.arange(N), q * np.ones((N, 1)), np.zeros((N, 1)),
        np.zeros((N, 1)), [start], ("v",),
    )  # fmt: skip


def recursion(seed, n=2, p=3, N=60, through=1.0) -> tuple[Recursion, Course]:
    """The same open-loop recursion to both modules."""
    random = np.random.default_rng(seed)
    A = random.standard_normal((2, n, n))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max(axis=1)[:, None, None]
    A[1] = A[0] + 0.1 * (A[1] - A[0])
    r = Recursion(
        A, random.standard_normal(n), random.standard_normal((2, n)), random.standard_normal((p, n)),
        0.05 * random.uniform(0, 1, (2, p)), random.standard_normal((N, n)), random.standard_normal(N),
        random.standard_normal((N, p)), random.integers(0, 2, N), random.standard_normal(n), np.zeros((n, 0)), through,
    )  # fmt: skip
    both = (2, 1, 1)
    course = Course(
        r.A, np.tile(r.b[:, None], both), np.tile(r.C, both), r.c[:, None], np.full(both, through), r.lam, np.zeros(p), r.mode,
        r.q, r.g[:, None], r.f, r.start, ("y",),
    )  # fmt: skip
    return r, course


def signs(count):
    return np.array(list(product([-1.0, 1.0], repeat=count)))


def drawn(course, count, seed=0):
    """Random sequences: within the box, at its corners, and corners that stay."""
    random = np.random.default_rng(seed)
    shape = (count, *course.f.shape)
    held = np.repeat(random.choice([-1.0, 1.0], (count, 1, shape[2])), shape[1], axis=1)
    return np.concatenate([random.uniform(-1, 1, shape), random.choice([-1.0, 1.0], shape), held])


def both_sides(course, k):
    return [(name, k, side) for name in course.signals for side in (1, -1)]


def deviation(course, found, values):
    """side (value - nominal) of every question."""
    at = nominal(course).v[found.instant.astype(int), found.signal.astype(int)]
    return values - found.side * at


# ---- the equation ---------------------------------------------------------------------------------------------------


def test_a_course_of_the_lagged_machine_is_the_machine():
    """Model and law sample by sample, as they are written, under parameters that move."""
    own, law = lagged_machine(0.1)
    course = lagged_course(0.1, N=200)
    delta = np.random.default_rng(3).uniform(-1.0, 1.0, (200, 6))
    r, form, box = steps(200), own.form, own.modes[0].box
    past = {0: np.zeros(3), 1: np.zeros(3)}
    state, seen = law.init(np.zeros(1)), []
    state[-2:] = 0.0
    for k in range(200):
        psi = np.array([past[int(s)][int(lag) - 1] for s, lag in zip(form.source, form.lags, strict=True)])
        y = form.d @ psi + (box.centre + delta[k] * box.radius) @ (form.T @ psi)
        command, state = law.step(state, r[k : k + 1], np.array([y]))
        past = {0: np.append(y, past[0][:2]), 1: np.append(command[0], past[1][:2])}
        seen.append([y, command[0]])
    np.testing.assert_allclose(replay(course, delta[None])[0], seen, rtol=0, atol=1e-10)
    assert np.ptp(np.array(seen)[:, 0]) > 1.0


@pytest.mark.parametrize("M", [1, 3, 12])
def test_a_replay_is_the_defining_equation(M):
    course = some(1, M=M)
    delta = drawn(course, 2)
    m = course.modes
    for one, found in zip(delta, replay(course, delta), strict=True):
        x = course.start
        for k in range(12):
            z = course.C[m[k]] @ x + course.f[k]
            w = np.zeros(2)
            for i, j in enumerate(course.channel.astype(int)):
                w[j] += one[k, i] * course.lam[m[k], i] * z[i]
            np.testing.assert_allclose(found[k], course.E[m[k]] @ x + course.g[k] + course.F[m[k]] @ w, rtol=1e-12, atol=1e-12)
            x = course.A[m[k]] @ x + course.q[k] + course.B[m[k]] @ w
    np.testing.assert_allclose(nominal(course).v, replay(course, np.zeros((1, 12, 4)))[0], rtol=1e-12, atol=1e-12)


# ---- closed forms ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_one_state_lies_between_two_products():
    """v(k) in 2 prod (a(l) -+ lam(l)) for slopes a > lam: upward the kernel is exact as well, and all three know it."""
    random = np.random.default_rng(0)
    a, lam = random.uniform(0.6, 1.0, 40), random.uniform(0.0, 0.1, 40)
    course = scalar(a, lam, 40, start=2.0)
    run, outer = nominal(course), kernel(course)
    high, low = 2.0 * np.cumprod(np.append(1.0, a + lam))[:40], 2.0 * np.cumprod(np.append(1.0, a - lam))[:40]
    np.testing.assert_allclose(run.v[:, 0] + outer.half[:, 0], high, rtol=1e-8)
    np.testing.assert_allclose(outer.state[:, 0], high - run.v[:, 0], rtol=1e-8, atol=1e-12)
    for k in (1, 7, 39):
        found = worst(course, both_sides(course, k))
        np.testing.assert_allclose(found.value, [high[k], low[k]], rtol=1e-12)
        above, below = (dual(course, found, i) for i in range(2))
        assert high[k] <= above.bound <= high[k] + 1e-4 * (high[k] - run.v[k, 0])
        assert -below.bound <= low[k]
        if k < 39:  # where the slowest run is left far behind by the others the relaxation is wider than it
            assert -below.bound >= low[k] - 1e-3 * (run.v[k, 0] - low[k])


def test_the_signal_itself_sees_the_equation_error():
    """v = x + F w at the instant: (a + lam)^k 2 (1 + F lam) for F > 0, and the other sign of delta for F < 0."""
    for through in (0.7, -0.7):
        course = scalar(0.8, 0.05, 20, start=2.0, through=through)
        found = worst(course, [("v", 19, 1)])
        truth = 2.0 * 0.85**19 * (1.0 + 0.7 * 0.05)
        assert found.value[0] == pytest.approx(truth, rel=1e-12)
        assert truth <= dual(course, found).bound <= truth * (1.0 + 1e-4)
        assert nominal(course).v[19, 0] + kernel(course).half[19, 0] == pytest.approx(truth, rel=1e-8)


def test_a_set_point_that_stands_meets_the_slowest_and_the_fastest_pole():
    """x+ = (a + delta lam) x + 1 from rest: between (1 - (a -+ lam)^k) / (1 - a +- lam)."""
    course, k = scalar(0.9, 0.04, 200, q=1.0), 199
    found = worst(course, both_sides(course, k))
    truth = [(1.0 - a**k) / (1.0 - a) for a in (0.94, 0.86)]
    np.testing.assert_allclose(found.value, truth, rtol=1e-12)
    outer = kernel(course)
    assert outer.gain == pytest.approx(0.4, rel=1e-6)
    above, below = dual(course, found, 0, outer), dual(course, found, 1, outer)
    assert above.first > 0  # a window: what happened before is the kernel's box
    assert truth[0] <= above.bound <= truth[0] * (1.0 + 1e-3)
    assert truth[1] * (1.0 - 1e-3) <= -below.bound <= truth[1]


# ---- the open-loop module as a peer ---------------------------------------------------------------------------------


@pytest.mark.parametrize("through", [1.0, 0.0, -0.7])
@pytest.mark.parametrize("seed", range(3))
def test_two_states_have_the_exact_hull_of_the_open_loop_module(seed, through):
    r, course = recursion(seed, through=through)
    hull, old = propagation.hull(r), propagation.kernel(r)
    outer, run = kernel(course), nominal(course)
    np.testing.assert_allclose(run.v[:, 0], open_loop.nominal(r).y, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(run.v[:, 0] + outer.half[:, 0], old.high, rtol=1e-8, atol=1e-8)  # widened by 1e-9 of itself
    assert outer.gain == pytest.approx(old.gain, rel=1e-9)
    for k in (3, 59):
        found = worst(course, both_sides(course, k), starts=32)
        np.testing.assert_allclose(found.value, [hull.high[k], hull.low[k]], atol=1e-7)
        same = open_loop.worst_sequences(r, [k])
        np.testing.assert_allclose(np.sort(found.value), np.sort(same.y[:, k]), rtol=1e-9)
        np.testing.assert_allclose(found.v[..., 0], open_loop.simulate(r, found.delta), rtol=1e-9, atol=1e-12)
        bounds = np.array([dual(course, found, i, outer).bound for i in range(2)])
        exact = np.array([hull.high[k], -hull.low[k]])
        reach = deviation(course, found, exact)
        assert np.all(bounds >= exact - 1e-7)
        assert np.all(bounds - exact <= 0.02 * reach)


# ---- every run ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@settings(max_examples=25)
@given(SEEDS, st.integers(1, 4), st.integers(1, 5), st.integers(1, 3), st.sampled_from([1, 2, 15]))
def test_every_run_stays_within_kernel_and_proof(seed, n, p, c, M):
    course = within(some(seed, n, p, c, N=15, M=M), 0.5)
    found, run, outer = worst(course, both_sides(course, 14), starts=4), nominal(course), kernel(course)
    v = np.concatenate([replay(course, drawn(course, 60, seed)), found.v])
    assert np.all(np.abs(v - run.v) <= outer.half)
    np.testing.assert_array_equal(found.v, replay(course, found.delta))
    for i, (name, k, side) in enumerate(both_sides(course, 14)):
        s = course.number(name)
        proof = dual(course, found, i)
        assert proof is not None
        assert np.all(side * v[:, k, s] <= proof.bound)
        assert found.value[i] == found.v[i, k, s]


@pytest.mark.slow
@pytest.mark.parametrize("M", [1, 200])
def test_many_parameters_of_two_channels(M):
    """Nine parameters each: bounded term by term, and by multipliers that need no corners."""
    course = within(some(5, n=5, p=18, c=2, N=200, M=M, radius=0.9), 0.3)
    outer, found = kernel(course), worst(course, both_sides(course, 199))
    v = np.concatenate([replay(course, drawn(course, 20)), found.v])
    assert np.all(np.abs(v - nominal(course).v) <= outer.half)
    for i in range(4):
        proof = dual(course, found, i, outer)
        reached = deviation(course, found, found.side * found.value)[i]
        assert 1.0 <= deviation(course, found, proof.bound)[i] / reached < 1.1
        s = int(found.signal[i])
        assert proof.bound - found.side[i] * nominal(course).v[199, s] < outer.half[199, s]


@pytest.mark.parametrize("M", [1, 4])
@pytest.mark.parametrize("seed", range(3))
def test_no_sign_sequence_beats_the_adversary(seed, M):
    course = some(seed, n=3, p=3, c=2, N=4, M=M, lam=0.4)
    v = replay(course, signs(12).reshape(-1, 4, 3))
    for k in range(4):
        found = worst(course, both_sides(course, k))
        for i, (name, _, side) in enumerate(both_sides(course, k)):
            extreme = (side * v[:, k, course.number(name)]).max()
            assert side * found.value[i] == pytest.approx(extreme, rel=1e-9, abs=1e-12)


@pytest.mark.slow
def test_channels_without_parameters_and_parameters_without_width():
    course = some(4, n=3, p=4, c=3, N=30, radius=0.7)
    course = replace(course, lam=np.array([[0.04, 0.0, 0.02, 0.0]]), channel=[0, 0, 0, 1])  # 1 has no width, 2 no parameter
    plain = replace(
        course, B=course.B[..., :1], F=course.F[..., :1], lam=course.lam[:, ::2], channel=[0, 0], C=course.C[:, ::2],
        f=course.f[:, ::2],
    )  # fmt: skip
    np.testing.assert_allclose(kernel(course).half, kernel(plain).half, rtol=1e-9)
    found, same = (worst(one, both_sides(one, 29), starts=32) for one in (course, plain))  # other random signs
    np.testing.assert_allclose(found.value, same.value, rtol=1e-2)
    for i in range(4):  # one problem, but for rounding: the search ends where R is about to break down, each time a bit elsewhere
        bounds = np.array([dual(course, found, i).bound, dual(plain, same, i).bound])
        own = bounds - found.side[i] * nominal(course).v[29, int(found.signal[i])]
        assert own[0] == pytest.approx(own[1], rel=5e-2)


@pytest.mark.slow
def test_without_width_the_envelope_is_the_nominal_run():
    course = replace(some(2, N=40), lam=np.zeros((1, 4)))
    found = envelope(course)
    np.testing.assert_allclose(found.high, found.nominal, atol=1e-11)
    np.testing.assert_allclose(found.low, found.nominal, atol=1e-11)
    np.testing.assert_array_equal(found.ratio, 1.0)


# ---- the tail of the kernel -----------------------------------------------------------------------------------------


def slow(M, N=700):
    """Four states with poles 0.995, 0.95 and a pair of 0.8, in skew coordinates; for M = N they wander."""
    random = np.random.default_rng(7)
    D = np.zeros((4, 4))
    D[0, 0], D[1, 1], D[2:, 2:] = 0.995, 0.95, [[0.7, 0.39], [-0.39, 0.7]]
    T = random.standard_normal((4, 4))
    A = T @ D @ np.linalg.inv(T)
    A = A + 0.002 * np.sin(0.02 * np.arange(M))[:, None, None] * random.standard_normal((4, 4))
    base = some(8, n=4, p=4, c=2, N=N, lam=2e-4)
    return replace(
        base, A=A, B=np.repeat(base.B, M, 0), C=np.repeat(base.C, M, 0), E=np.repeat(base.E, M, 0), F=np.repeat(base.F, M, 0),
        lam=np.repeat(base.lam, M, 0), mode=np.arange(N) if M == N else np.zeros(N),
    )  # fmt: skip


TAILS = {
    "fast": lambda: some(3, n=4, p=4, N=700, lam=0.02),
    "slow": lambda: slow(1),
    "wandering": lambda: slow(700),
    "growing": lambda: some(6, n=3, p=3, N=700, lam=1e-4, radius=1.003),
}


@pytest.mark.parametrize("name", TAILS)
@pytest.mark.parametrize(("age", "wider"), [(envelopes.AGE, envelopes.WIDER), (8, np.inf), (32, 0.03)])
def test_columns_that_are_exchanged_are_paid_for(monkeypatch, name, age, wider):
    """Whatever is exchanged, and however early, the bound is never below that of all columns; and hardly above as it is set."""
    course = TAILS[name]()
    monkeypatch.setattr(envelopes, "AGE", 10**4)
    whole = kernel(course)
    monkeypatch.setattr(envelopes, "AGE", age)
    monkeypatch.setattr(envelopes, "WIDER", wider)
    counts, true = [], envelopes._exchanged

    def counted(Z, weight, born, used, k, look):
        counts.append((used, true(Z, weight, born, used, k, look)))
        return counts[-1][1]

    monkeypatch.setattr(envelopes, "_exchanged", counted)
    cut = kernel(course)
    assert np.all(cut.half >= whole.half * (1.0 - 1e-8))  # more columns, more rounding
    assert np.all(cut.state >= whole.state * (1.0 - 1e-8))
    assert cut.gain >= whole.gain * (1.0 - 1e-12)
    if wider == envelopes.WIDER and age == 64:
        assert np.all(cut.half <= whole.half * 1.01)
    if wider == np.inf or name == "fast":
        assert any(after < before for before, (after, _) in counts)
        assert np.any(cut.half > whole.half)


def test_a_box_that_contracts_bounds_the_whole_run():
    """Columns of a fast loop do not pile up: that is what the exchange is for."""
    course, counts, true = some(3, n=4, p=4, N=700, lam=0.02), [], envelopes._exchanged
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(envelopes, "_exchanged", lambda *args: counts.append(true(*args)) or counts[-1])
        kernel(course)
    assert max(count for count, _ in counts) <= 2 * (envelopes.AGE + 1) + 4 * (1 + envelopes.AGE // envelopes.YOUNG)


def exactly(course, delta) -> list[list[Fraction]]:
    """v (N s) of constant parameters `delta` (p), without any rounding."""

    def rational(M):
        return np.vectorize(Fraction, otypes=[object])(np.asarray(M, dtype=float))

    x, v, one = rational(course.start), [], rational(delta)
    A, B, C, E, F, lam = (rational(M) for M in (course.A, course.B, course.C, course.E, course.F, course.lam))
    for k, i in enumerate(course.modes):
        w = (one * lam[i] * (C[i] @ x + rational(course.f[k]))) @ rational(course.members)
        v.append(E[i] @ x + rational(course.g[k]) + F[i] @ w)
        x = A[i] @ x + rational(course.q[k]) + B[i] @ w
    return v


def exact_states(course, delta) -> list[list[Fraction]]:
    """x (N n), as `exactly`, of which the watched signals are the states themselves."""
    n = len(course.start)
    seen = replace(
        course, E=np.tile(np.eye(n), (len(course.E), 1, 1)), F=np.zeros((len(course.F), n, course.F.shape[2])),
        g=np.zeros((len(course), n)), signals=tuple(f"x{i}" for i in range(n)),
    )  # fmt: skip
    return exactly(seen, delta)


def left_by(course, delta) -> np.ndarray:
    """What the kernel leaves above the exact run, relative to its half width: (N s)."""
    outer = kernel(course)
    return np.array([
        [float((Fraction(h) - abs(v - Fraction(m))) / max(Fraction(h), Fraction(1e-300))) for v, m, h in zip(*row, strict=True)]
        for row in zip(exactly(course, delta), outer.nominal.v, outer.half, strict=True)
    ])  # fmt: skip


ROUNDED = {
    "grows as fast as the kernel": lambda: scalar(np.random.default_rng(2).uniform(0.6, 1.0, 60), 0.07, 60, start=2.0),
    "driven": lambda: scalar(0.9, 0.04, 120, q=1.0),
    "nothing but the rounding of the nominal run, all to one side": lambda: scalar(1.0, 0.0, 400, q=0.1, start=1e6 / 3.0),
}


@pytest.mark.parametrize("name", ROUNDED)
def test_the_kernel_covers_what_rounding_takes(name, monkeypatch):
    """Where the kernel is attained, rational arithmetic decides: above every exact run, and by no more than rounding."""
    course = ROUNDED[name]()
    left = left_by(course, [1.0])
    assert np.all(left >= 0.0)
    if course.lam.any():
        assert np.all(left[2:] < 1e-9)
    monkeypatch.setattr(envelopes, "_unit", lambda _: 0.0)
    assert np.any(left_by(course, [1.0]) < 0.0)


def test_what_an_exchange_leaves_over_is_carried_on(monkeypatch):
    """Axes that are a thousandth too short: the box along them does not hold the columns, but with what is left over."""
    course, true = ROUNDED["grows as fast as the kernel"](), np.linalg.svd
    monkeypatch.setattr(envelopes, "AGE", 8)
    monkeypatch.setattr(envelopes, "WIDER", np.inf)
    monkeypatch.setattr(np.linalg, "svd", lambda *args, **options: (0.999 * true(*args, **options)[0], None, None))
    left = left_by(course, [1.0])
    assert np.all(left >= 0.0)
    assert np.any(left > 1e-6)  # it was made


@pytest.mark.parametrize("width", [0.0, 1.0])
@pytest.mark.parametrize("seed", range(4))
def test_exact_runs_stay_within_all_that_is_said(seed, width, monkeypatch):
    """Several states, modes, channels: signals within low and high, states within theirs, from the first sample on.

    Without a width all that is left of the bounds is rounding, and exchanged columns stand along axes that are rounded too.
    """
    course = some(seed, n=4, p=5, c=2, s=3, N=40, M=3, lam=0.1 * width, radius=0.7, start=1e3)
    course = within(course, 0.5) if width else course
    monkeypatch.setattr(envelopes, "AGE", 8)
    monkeypatch.setattr(envelopes, "WIDER", np.inf)
    true = np.linalg.svd

    def askew(*args, **options):
        found = true(*args, **options)
        return (found[0] + 1e-3 * np.random.default_rng(seed).standard_normal(found[0].shape), *found[1:])

    monkeypatch.setattr(np.linalg, "svd", askew)
    outer = kernel(course)
    for delta in (np.ones(5), -np.ones(5)):
        v, x = exactly(course, delta), exact_states(course, delta)
        for k in range(len(course)):
            for i in range(3):
                assert Fraction(outer.low[k, i]) <= v[k][i] <= Fraction(outer.high[k, i])
            for i in range(4):
                assert abs(x[k][i] - Fraction(outer.nominal.x[k, i])) <= Fraction(outer.state[k, i])


@pytest.mark.parametrize(
    "numbers",
    [
        {"lam": 1e-200, "f": 1e-200, "B": 1e200, "F": 1e200},
        {"B": 5e-324, "A": 0.4, "f": 1e300, "E": 1e200, "lam": 1.0},
        {"E": 1e-162, "start": 2.4e-162, "lam": 0.0},
        {"lam": 1e-160, "f": 1e-160, "E": 1e-100},
    ],
)
def test_what_underflows_is_not_forgotten(numbers):
    """Products below the smallest float vanish: then nothing is said, or more than they are."""
    given = {"A": 0.5, "B": 1.0, "C": 1.0, "E": 1.0, "F": 0.0, "lam": 0.1, "q": 0.0, "g": 0.0, "f": 0.0, "start": 0.0} | numbers
    cubes, rows = ("A", "B", "C", "E", "F"), ("q", "g", "f")
    shaped = {
        k: np.full((1, 1, 1) if k in cubes else (5, 1) if k in rows else (1, 1), v) for k, v in given.items() if k != "start"
    }
    course = Course(**shaped, channel=[0], mode=np.zeros(5), start=[given["start"]], signals=("v",))
    outer = kernel(course)
    for k, row in enumerate(exactly(course, [1.0])):
        if np.isfinite(outer.high[k, 0]):
            assert Fraction(outer.low[k, 0]) <= row[0] <= Fraction(outer.high[k, 0])


def test_what_rounds_is_carried_on(monkeypatch):
    """In coordinates of all sizes |A| grows where A decays: the box becomes columns before it is felt."""
    course = some(2, n=6, p=3, N=300, lam=0.02, radius=0.95)
    assert np.abs(np.linalg.eigvals(np.abs(course.A[0]))).max() > 1.5
    half = kernel(course).half
    monkeypatch.setattr(envelopes, "_unit", lambda _: 0.0)
    np.testing.assert_allclose(half, kernel(course).half, rtol=1e-6)
    monkeypatch.undo()
    monkeypatch.setattr(envelopes, "YOUNG", 10**6)
    assert np.any(kernel(course).half > 2.0 * half)


def test_the_kernel_is_its_defining_sum():
    course = some(9, n=3, p=5, c=2, N=9, M=9)
    m, run, W = course.modes, nominal(course), []

    def Phi(k, j):
        out = np.eye(3)
        for i in range(j, k):
            out = course.A[m[i]] @ out
        return out

    for k in range(9):
        own = []
        for j in range(2):
            i = np.flatnonzero(course.channel == j)
            total = 0.0
            for delta in signs(len(i)):
                row = delta * course.lam[m[k], i]
                value = abs(row @ run.z[k, i])
                for l in range(k):  # noqa: E741
                    for other in range(2):
                        value += abs(row @ course.C[m[k]][i] @ Phi(k, l + 1) @ course.B[m[l]][:, other]) * W[l][other]
                total = max(total, value)
            own.append(total)
        W.append(own)
        half = np.abs(course.F[m[k]]) @ own
        state = np.zeros(3)
        for l in range(k):  # noqa: E741
            half += np.abs(course.E[m[k]] @ Phi(k, l + 1) @ course.B[m[l]]) @ W[l]
            state += np.abs(Phi(k, l + 1) @ course.B[m[l]]) @ W[l]
        np.testing.assert_allclose(kernel(course).half[k], half, rtol=1e-8)
        np.testing.assert_allclose(kernel(course).state[k], state, rtol=1e-8, atol=1e-12)


def test_the_gain_of_two_channels_does_not_depend_on_their_units():
    course = some(10, n=3, p=4, c=2, N=60)
    scale = np.array([1.0, 1e3])
    own = scale[course.channel.astype(int)]
    other = replace(course, B=course.B / scale, F=course.F / scale, lam=course.lam * own)
    assert kernel(other).gain == pytest.approx(kernel(course).gain, rel=1e-9)


# ---- proofs ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def proven():
    """A proof from the start of the run and one of a window, and their course."""
    course = lagged_course(0.05, N=300)
    outer = kernel(course)
    k = int(outer.half[:, 0].argmax())
    found = worst(course, [("y", k, 1)])
    return course, found, dual(course, found), dual(course, found, 0, outer)


@pytest.mark.slow
def test_a_proof_that_was_tampered_with_is_rejected(proven):
    course, found, *proofs = proven
    reach = float(deviation(course, found, found.value)[0])
    for proof in proofs:
        K = len(proof.M)
        assert proof.holds(course)
        assert not replace(proof, bound=proof.bound - 0.01 * reach).holds(course)
        assert not replace(proof, bound=-np.inf).holds(course)
        assert not replace(proof, bound=np.nan).holds(course)
        for factor in (0.5, 2.0):
            M = proof.M.copy()
            M[K - 20] *= factor  # R may still be positive definite, but V is another one
            assert not replace(proof, M=M).holds(course)
        assert not replace(proof, M=0.0 * proof.M).holds(course)
        for name in ("P", "q", "c"):
            value = getattr(proof, name).copy()
            value[K - 20] *= 0.99
            assert not replace(proof, **{name: value}).holds(course)
        P = proof.P.copy()
        P[K - 20, 0, 1] += 1e-6  # not symmetric
        assert not replace(proof, P=P).holds(course)
        x = proof.x.copy()
        x[K - 20] += 0.05 * np.abs(x).max()  # no run of the loop
        assert not replace(proof, x=x).holds(course)
        assert not replace(proof, side=-1).holds(course)
        assert not replace(proof, side=2).holds(course)
        assert not replace(proof, signal="u").holds(course)
        assert not replace(proof, instant=proof.instant - 1).holds(course)
        assert not replace(proof, first=proof.first - 1, instant=proof.instant - 1).holds(course)
        assert not replace(proof, M=proof.M[1:], P=proof.P[1:], q=proof.q[1:], c=proof.c[1:], x=proof.x[1:]).holds(course)
        assert not replace(proof, M=proof.M[:, :5]).holds(course)
        # another loop: wider boxes, another start, another set-point
        assert not proof.holds(replace(course, lam=1.05 * course.lam))
        assert not proof.holds(replace(course, q=1.05 * course.q))
        assert not proof.holds(replace(course, g=course.g + 0.1))
        assert not proof.holds(replace(course, B=1.05 * course.B))
        assert not proof.holds(replace(course, C=1.05 * course.C))
    whole, window = proofs
    assert whole.first == 0
    assert not whole.holds(replace(course, start=course.start + 1e3))  # long ago
    assert window.first > 0
    assert not replace(window, box=0.5 * window.box).holds(course)
    assert not replace(window, nu=0.0 * window.nu).holds(course)
    assert not replace(window, nu=2.0 * window.nu).holds(course) or window.nu @ window.box**2 < 1e-6 * reach


def test_something_after_the_last_sample_would_prove_anything(proven):
    """V after the instant is not free: minus something there makes every bound smaller."""
    course, _, proof, _ = proven
    for name, shift in (("P", -np.eye(9)), ("q", -np.ones(9)), ("c", -1.0)):
        value = getattr(proof, name).copy()
        value[-1] += shift
        assert not replace(proof, **{name: value}).holds(course)
    c = proof.c - 0.1  # every V by as much, the one after the instant included
    assert not replace(proof, c=c, bound=proof.bound - 0.1).holds(course)


def test_multipliers_with_which_r_breaks_down_have_no_bound(proven):
    course, found, proof, _ = proven
    problem = envelopes._Problem(course, 0, proof.instant, 1.0, 0, None)
    M = proof.M.copy()
    x = np.log(M.ravel())
    assert problem.at(x).value == pytest.approx(deviation(course, found, proof.bound)[0], rel=1e-4)
    M[-3] *= 1e-4
    x[: M.size] = np.log(M.ravel())
    assert problem.at(x) is None


def test_the_slope_of_the_bound_is_its_slope():
    course = within(some(12, n=3, p=4, c=2, N=40, M=40), 0.4)
    found, outer = worst(course, [("v1", 39, -1)]), kernel(course)
    problem = envelopes._Problem(course, 1, 39, -1.0, 15, outer)
    path = envelopes._along(course, 1, 39, -1.0, found.delta[0], found.start[0])
    at = next(a for a in map(problem.started, envelopes._first_multipliers(course, path, problem.k)) if a is not None)
    for i in (0, 7, 55, 99, 100, 102):  # multipliers of the box last
        step = 1e-5 * np.eye(len(at.x))[i]
        slope = (problem.at(at.x + step).value - problem.at(at.x - step).value) / 2e-5
        assert slope == pytest.approx(at.slope[i], rel=1e-4, abs=1e-7 * at.value)
    assert np.abs(at.slope[100:]).max() > 0.0


@pytest.mark.slow
def test_a_window_pays_for_what_happened_before(monkeypatch):
    """A window that forgets a third of what counts is still an upper bound, and wider: its box is not decoration."""
    course = lagged_course(0.05, N=300)
    outer = kernel(course)
    k = int(outer.half[:, 0].argmax())
    found = worst(course, both_sides(course, k))
    whole = [dual(course, found, i).bound for i in range(4)]
    usual = [dual(course, found, i, outer).bound for i in range(4)]
    monkeypatch.setattr(envelopes, "FORGOTTEN", 0.3)
    short = [dual(course, found, i, outer) for i in range(4)]
    reach = deviation(course, found, found.side * found.value)
    assert all(proof.first > k - 40 for proof in short)
    assert np.all([proof.bound for proof in short] >= found.side * found.value)
    assert np.all(deviation(course, found, np.array([proof.bound for proof in short])) > 1.02 * reach)
    assert np.all(np.abs(np.array(whole) - usual) <= 5e-3 * reach)


def test_boxes_in_which_the_kernel_grows_without_limit_may_still_be_bounded():
    """Gain above 1: the kernel of a late sample says next to nothing, the dual does."""
    course = lagged_course(0.13, N=300)
    outer = kernel(course)
    assert outer.gain > 1.0
    found = worst(course, [("y", 160, -1)])
    proof = dual(course, found, 0, outer)
    reached = deviation(course, found, found.side * found.value)[0]
    assert reached <= deviation(course, found, proof.bound)[0] < 0.5 * outer.half[160, 0]


# ---- all of it ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("share", "most"), [(0.02, 1.05), (0.05, 1.2), (0.08, 1.5)])
def test_little_is_left_open_at_the_critical_instants(share, most):
    course = lagged_course(share, N=900)
    found = envelope(course)
    assert len(found.questions) == 4
    assert np.all((found.ratio >= 1.0) & (found.ratio <= most))
    assert all(proof.holds(course) for proof in found.certificates)
    assert np.all(found.low <= found.reached_low)
    assert np.all(found.reached_high <= found.high)
    v = replay(course, drawn(course, 20))
    assert np.all((found.low <= v) & (v <= found.high))
    outer = kernel(course)
    for name, k, side in found.questions:
        s = course.number(name)
        assert outer.half[k, s] == outer.half[:, s].max()
        tightened = found.high[k, s] - found.nominal[k, s] if side == 1 else found.nominal[k, s] - found.low[k, s]
        assert tightened < outer.half[k, s]
        other = (k + 40) % 900  # elsewhere the kernel stays
        assert found.high[other, s] - found.nominal[other, s] == pytest.approx(outer.half[other, s], rel=1e-9)


@pytest.mark.slow
def test_limits_say_where_to_look():
    course = lagged_course(0.05, N=500)
    limits = np.array([[-np.inf, 1.4], [-2.0, np.inf]])
    found, outer = envelope(course, limits=limits), kernel(course)
    asked = {(name, side): k for name, k, side in found.questions}
    assert asked["y", 1] == (found.nominal[:, 0] + outer.half[:, 0]).argmax()
    assert asked["y", -1] == outer.half[:, 0].argmax()
    assert asked["u", -1] == (found.nominal[:, 1] - outer.half[:, 1]).argmin()
    assert asked["u", 1] == outer.half[:, 1].argmax()
    assert asked["y", 1] != asked["y", -1]
    chosen = envelope(course, instants=[20, 170])
    assert {k for _, k, _ in chosen.questions} == {20, 170}
    assert len(chosen.questions) == 8


def test_the_run_after_the_instant_goes_on_pushing():
    course = some(3, N=40)
    found = worst(course, [("v0", 10, 1), ("v0", 30, -1)])
    assert set(np.unique(found.delta)) == {-1.0, 1.0}
    np.testing.assert_array_equal(found.delta[0, 31:], 1.0)
    np.testing.assert_array_equal(found.delta[1, 31:], -1.0)


# ---- what is refused ------------------------------------------------------------------------------------------------


def test_odd_courses_are_refused():
    course = some(0)
    with pytest.raises(RecordError, match="expected n = 3"):
        replace(course, C=np.zeros((1, 4, 2)))
    with pytest.raises(RecordError, match="expected c = 2"):
        replace(course, F=np.zeros((1, 2, 1)))
    with pytest.raises(RecordError):
        replace(course, lam=-course.lam)
    with pytest.raises(InputError, match="mode must be an integer from 0 to 0"):
        replace(course, mode=np.ones(12))
    with pytest.raises(InputError, match="channel must be an integer from 0 to 1"):
        replace(course, channel=[0, 1, 2, 0])
    with pytest.raises(InputError, match="2 watched signals"):
        replace(course, signals=("v",))
    with pytest.raises(InputError, match="2 watched signals"):
        replace(course, signals=("v", "v"))
    with pytest.raises(InputError, match="q holds a value that is not finite"):
        replace(course, q=np.full((12, 3), np.inf))
    with pytest.raises(InputError, match="unstable in the middle"):
        kernel(replace(some(0, N=3000), A=[[[2.0, 0, 0], [0, 2.0, 0], [0, 0, 2.0]]]))


def test_odd_questions_are_refused():
    course = some(0)
    with pytest.raises(InputError, match="no watched signal v7"):
        worst(course, [("v7", 3, 1)])
    for questions in ([("v0", 12, 1)], [("v0", -1, 1)], []):
        with pytest.raises(InputError, match="give at least one, each from 0 to 11"):
            worst(course, questions)
    with pytest.raises(InputError, match="a side is 1 or -1"):
        worst(course, [("v0", 3, 0)])
    with pytest.raises(InputError, match="two starts"):
        worst(course, [("v0", 3, 1)], starts=1)
    with pytest.raises(InputError, match="expected"):
        replay(course, np.zeros((1, 11, 4)))
    for beyond in (1.01, np.nan):
        with pytest.raises(InputError, match="leaves the box"):
            replay(course, np.full((1, 12, 4), beyond))
    with pytest.raises(InputError, match="low < high of v0, v1"):
        envelope(course, limits=np.zeros((2, 2)))
    with pytest.raises(InputError, match="low < high"):
        envelope(course, limits=np.ones(2))
