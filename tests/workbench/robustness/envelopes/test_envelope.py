"""The envelope: what is left open at the critical instants, where limits say to look, questions that are refused."""

from dataclasses import replace

import numpy as np
import pytest

from tests.workbench.robustness.envelopes.courses import drawn, some
from tests.workbench.robustness.loops import lagged_course
from workbench.errors import InputError
from workbench.robustness.envelopes.adversary import worst
from workbench.robustness.envelopes.course import replay
from workbench.robustness.envelopes.envelope import envelope
from workbench.robustness.envelopes.kernel import kernel


@pytest.mark.slow
def test_without_width_the_envelope_is_the_nominal_run():
    course = replace(some(2, N=40), lam=np.zeros((1, 4)))
    found = envelope(course)
    np.testing.assert_allclose(found.high, found.nominal, atol=1e-11)
    np.testing.assert_allclose(found.low, found.nominal, atol=1e-11)
    np.testing.assert_array_equal(found.ratio, 1.0)


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
