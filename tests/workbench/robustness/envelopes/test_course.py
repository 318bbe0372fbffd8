"""The course of a loop: the machine sample by sample, the replay of parameter sequences, courses that are refused."""

from dataclasses import replace

import numpy as np
import pytest

from tests.workbench.robustness.envelopes.courses import drawn, some
from tests.workbench.robustness.loops import lagged_course, lagged_machine, steps
from workbench.errors import InputError
from workbench.records import RecordError
from workbench.robustness.envelopes.course import nominal, replay
from workbench.robustness.envelopes.kernel import kernel


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
