"""The dual: proofs that are broken, the slope of the bound, windows, loops where the kernel grows without limit."""

from dataclasses import replace

import numpy as np
import pytest

from tests.workbench.robustness.envelopes.courses import both_sides, deviation, some, within
from tests.workbench.robustness.loops import lagged_course
from workbench.robustness.envelopes import dual as dual_module
from workbench.robustness.envelopes.adversary import worst
from workbench.robustness.envelopes.dual import dual
from workbench.robustness.envelopes.kernel import kernel
from workbench.robustness.envelopes.problem import Problem


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
    problem = Problem(course, 0, proof.instant, 1.0, 0, None)
    M = proof.M.copy()
    x = np.log(M.ravel())
    assert problem.at(x).value == pytest.approx(deviation(course, found, proof.bound)[0], rel=1e-4)
    M[-3] *= 1e-4
    x[: M.size] = np.log(M.ravel())
    assert problem.at(x) is None


def test_the_slope_of_the_bound_is_its_slope():
    course = within(some(12, n=3, p=4, c=2, N=40, M=40), 0.4)
    found, outer = worst(course, [("v1", 39, -1)]), kernel(course)
    problem = Problem(course, 1, 39, -1.0, 15, outer)
    path = dual_module._along(course, 1, 39, -1.0, found.delta[0], found.start[0])
    at = next(a for a in map(problem.started, dual_module._first_multipliers(course, path, problem.k)) if a is not None)
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
    monkeypatch.setattr(dual_module, "FORGOTTEN", 0.3)
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
