"""Speed of validity domains: a gauge in eight dimensions against the whole program, and the aggregation of fifty modes.

Run with OPENBLAS_NUM_THREADS=1 pytest -m bench -s.
"""

import time

import numpy as np
import pytest
from scipy.optimize import linprog

from workbench.intervals.domains.aggregation import aggregate
from workbench.intervals.domains.shapes import Hull

pytestmark = pytest.mark.bench


def test_a_gauge_in_eight_dimensions_takes_less_than_two_milliseconds():
    rng = np.random.default_rng(0)
    V, x = rng.standard_normal((1000, 8)), rng.standard_normal((500, 8))
    hull = Hull(V)
    hull.gauge(x[:50])
    begin = time.perf_counter()
    gauge = hull.gauge(x)
    ours = (time.perf_counter() - begin) / len(x)
    A, ones = np.vstack([np.c_[V.T, -hull.scale], np.c_[-V.T, -hull.scale]]), np.r_[np.ones(1000), 0.0][None]
    begin = time.perf_counter()
    whole = [linprog(np.r_[np.zeros(1000), 1.0], A, np.r_[q, -q], ones, [1.0], bounds=(0, None)).fun for q in x[:30]]
    theirs = (time.perf_counter() - begin) / 30
    print(f"\n{ours * 1e3:.2f} ms a query, the whole program with linprog {theirs * 1e3:.1f} ms")
    np.testing.assert_allclose(gauge[:30], whole, atol=1e-8)
    assert ours < 2e-3


@pytest.mark.parametrize("d", [4, 6, 8])
def test_fifty_modes_of_ten_regimes_are_aggregated_within_thirty_seconds(d):
    rng = np.random.default_rng(d)
    regimes = [(rng.standard_normal(d) * 1.5, rng.standard_normal((d, d)) / np.sqrt(d)) for _ in range(10)]
    modes = []
    for k in range(50):
        centre, mix = regimes[k % 10]
        # returns to a regime differ in how far they excite it: some lie within others
        modes.append(rng.standard_normal((rng.integers(200, 1001), d)) @ mix * rng.choice([0.6, 0.8, 1.0]) + centre)
    begin = time.perf_counter()
    found = aggregate(modes, Hull, lambda a, b: np.vstack([a, b]))
    took = time.perf_counter() - begin
    print(f"\nd = {d}: {took:.1f} s, {len(found.items)} modes left, {len(found.decisions)} decisions")
    assert took < 30
