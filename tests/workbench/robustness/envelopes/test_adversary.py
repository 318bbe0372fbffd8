"""The adversary: every sign sequence of a short run, and the run after the instant."""

import numpy as np
import pytest

from tests.workbench.robustness.envelopes.courses import both_sides, signs, some
from workbench.robustness.envelopes.adversary import worst
from workbench.robustness.envelopes.course import replay


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


def test_the_run_after_the_instant_goes_on_pushing():
    course = some(3, N=40)
    found = worst(course, [("v0", 10, 1), ("v0", 30, -1)])
    assert set(np.unique(found.delta)) == {-1.0, 1.0}
    np.testing.assert_array_equal(found.delta[0, 31:], 1.0)
    np.testing.assert_array_equal(found.delta[1, 31:], -1.0)
