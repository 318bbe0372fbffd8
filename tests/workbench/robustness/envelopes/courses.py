"""Courses for the tests of envelopes: drawn, with one state, and their parameter sequences and questions."""

from dataclasses import replace
from itertools import product

import numpy as np

from workbench.robustness.envelopes.course import Course, nominal
from workbench.robustness.envelopes.kernel import kernel


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
