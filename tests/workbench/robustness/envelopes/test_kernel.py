"""The kernel: its defining sum, the exchange of columns, and its rounding against exact runs in rational arithmetic."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from tests.workbench.robustness.envelopes.courses import scalar, signs, some, within
from workbench.robustness.envelopes import kernel as kernel_module
from workbench.robustness.envelopes.course import Course, nominal
from workbench.robustness.envelopes.kernel import kernel


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
@pytest.mark.parametrize(("age", "wider"), [(kernel_module.AGE, kernel_module.WIDER), (8, np.inf), (32, 0.03)])
def test_columns_that_are_exchanged_are_paid_for(monkeypatch, name, age, wider):
    """Whatever is exchanged, and however early, the bound is never below that of all columns; and hardly above as it is set."""
    course = TAILS[name]()
    monkeypatch.setattr(kernel_module, "AGE", 10**4)
    whole = kernel(course)
    monkeypatch.setattr(kernel_module, "AGE", age)
    monkeypatch.setattr(kernel_module, "WIDER", wider)
    counts, true = [], kernel_module._exchanged

    def counted(Z, weight, born, used, k, look):
        counts.append((used, true(Z, weight, born, used, k, look)))
        return counts[-1][1]

    monkeypatch.setattr(kernel_module, "_exchanged", counted)
    cut = kernel(course)
    assert np.all(cut.half >= whole.half * (1.0 - 1e-8))  # more columns, more rounding
    assert np.all(cut.state >= whole.state * (1.0 - 1e-8))
    assert cut.gain >= whole.gain * (1.0 - 1e-12)
    if wider == kernel_module.WIDER and age == 64:
        assert np.all(cut.half <= whole.half * 1.01)
    if wider == np.inf or name == "fast":
        assert any(after < before for before, (after, _) in counts)
        assert np.any(cut.half > whole.half)


def test_a_box_that_contracts_bounds_the_whole_run():
    """Columns of a fast loop do not pile up: that is what the exchange is for."""
    course, counts, true = some(3, n=4, p=4, N=700, lam=0.02), [], kernel_module._exchanged
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kernel_module, "_exchanged", lambda *args: counts.append(true(*args)) or counts[-1])
        kernel(course)
    assert max(count for count, _ in counts) <= 2 * (kernel_module.AGE + 1) + 4 * (1 + kernel_module.AGE // kernel_module.YOUNG)


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
    monkeypatch.setattr(kernel_module, "rounding", lambda _: 0.0)
    assert np.any(left_by(course, [1.0]) < 0.0)


def test_what_an_exchange_leaves_over_is_carried_on(monkeypatch):
    """Axes that are a thousandth too short: the box along them does not hold the columns, but with what is left over."""
    course, true = ROUNDED["grows as fast as the kernel"](), np.linalg.svd
    monkeypatch.setattr(kernel_module, "AGE", 8)
    monkeypatch.setattr(kernel_module, "WIDER", np.inf)
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
    monkeypatch.setattr(kernel_module, "AGE", 8)
    monkeypatch.setattr(kernel_module, "WIDER", np.inf)
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
    monkeypatch.setattr(kernel_module, "rounding", lambda _: 0.0)
    np.testing.assert_allclose(half, kernel(course).half, rtol=1e-6)
    monkeypatch.undo()
    monkeypatch.setattr(kernel_module, "YOUNG", 10**6)
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
