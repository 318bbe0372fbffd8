"""Verdicts: exact where the answer is known, never proved and refuted, and what refutes is run again from its file."""

import math
from dataclasses import replace

import numpy as np
import pytest

from controllers.pid import pid
from tests.workbench.robustness.loops import model
from workbench.errors import InputError
from workbench.files import read_json, write_json
from workbench.intervals.regressors import ARX
from workbench.robustness.envelopes.course import Course, nominal, replay
from workbench.robustness.envelopes.kernel import kernel
from workbench.robustness.falsify.counterexample import same
from workbench.robustness.loop import course as along
from workbench.robustness.loop import driven
from workbench.robustness.machine import machine_of
from workbench.robustness.margins import corners, margin
from workbench.robustness.rests import Rest
from workbench.robustness.sequences import Growth, load_sequence
from workbench.robustness.uncertain import UncertainLoop
from workbench.robustness.verdict import Bound, Kept, Status, Verdict, bounds_kept, overall, refuting, stability

N = 60


def scalar(lam=0.1, noise=0.0) -> Course:
    """x+ = (0.5 + lam delta) x + 1 + noise eta, v = (x, -2 x): at rest at 2; with constant delta at 1 / (0.5 - lam delta)."""
    return Course(
        A=[[[0.5]]], B=[[[1.0]]], C=[[[1.0], [0.0]]], E=[[[1.0], [-2.0]]], F=np.zeros((1, 2, 1)), lam=[[lam, noise]],
        channel=[0, 0], mode=np.zeros(N), q=np.ones((N, 1)), g=np.zeros((N, 2)), f=np.tile([0.0, 1.0], (N, 1)), start=[2.0],
        signals=("y", "u"), before=Rest([1.0], np.zeros((1, 0)), [0.0, 1.0], np.zeros((2, 0)), [0.0, 0.0], np.zeros((2, 0))),
    )  # fmt: skip


def bound(signal="y", low=-np.inf, high=np.inf) -> Bound:
    return Bound(f"{signal} in bounds", signal, "m", np.full(N, low), np.full(N, high))


def every_corner(course) -> np.ndarray:
    """Constant parameters: all corners, but for what does not move with the loop."""
    own = corners(course.lam.shape[1])
    return np.where(np.abs(course.C).max(axis=(0, 2)) > 0.0, own, 0.0)


def kept_of(course, limit, stops=(), moving=False) -> Kept:
    (kept,) = bounds_kept(course, [limit], stops, of="model", dt=0.1, possible=every_corner(course), moving=moving)
    return kept


def verdict(course, limit, stops=(), moving=False) -> Verdict:
    return kept_of(course, limit, stops, moving).verdict


def test_a_scalar_loop_is_proved_and_refuted_at_its_exact_limits():
    """Positive loop: the largest x is that of delta = 1 for ever, 1 / 0.4 = 2.5; moving parameters reach no more."""
    for moving in (True, False):
        failed = verdict(scalar(), bound(high=2.49), moving=moving)
        assert failed.status is Status.FAILED
        assert failed.margin == pytest.approx(-0.01, abs=1e-6)
        proved = verdict(scalar(), bound(high=2.52), moving=moving)
        assert proved.status is Status.PROVED
        assert 0.0 <= proved.margin < 0.02
    low = verdict(scalar(), bound("u", low=-5.0 + 0.01))  # u = -2 x
    assert low.status is Status.FAILED
    assert low.margin == pytest.approx(-0.01, abs=1e-6)


def turning() -> Course:
    """A damped turn, pushed out of its rest: parameters that change sign with the state bring it further than constant ones."""
    A = 0.9 * np.array([[np.cos(0.5), np.sin(0.5)], [-np.sin(0.5), np.cos(0.5)]])
    return Course(
        A=A[None], B=[[[1.0], [0.0]]], C=[[[1.0, 0.0]]], E=[[[0.0, 1.0]]], F=np.zeros((1, 1, 1)), lam=[[0.1]], channel=[0],
        mode=np.zeros(N), q=np.eye(N, 2, k=-1) * [1.0, 0.0], g=np.zeros((N, 1)), f=np.zeros((N, 1)), start=[0.0, 0.0],
        signals=("y",),
    )  # fmt: skip


def test_moving_parameters_refute_only_where_they_are_said_to_move():
    course = turning()
    corners = replay(course, np.array([1.0, -1.0])[:, None, None] * np.ones((2, N, 1)))[:, :, 0]
    moving = kept_of(course, bound(high=-2.0), moving=True)
    reached = float(moving.run.v[0, :, 0].max())
    assert reached > corners.max() + 0.005
    between = bound(high=0.5 * (reached + corners.max()))
    assert verdict(course, between, moving=True).status is Status.FAILED
    still = kept_of(course, between)
    assert still.verdict.status is Status.PROVED
    assert still.constant
    assert "constant parameters" in still.verdict.sentence
    assert "moving ones go beyond it by" in still.verdict.sentence
    assert still.outer.high[:, 0].max() < reached
    undecided = verdict(course, bound(high=corners.max() + 1e-6))
    assert undecided.status is Status.UNDECIDED
    assert "moving ones go beyond it by" in undecided.sentence
    assert verdict(course, bound(high=corners.max() - 1e-6)).status is Status.FAILED


def test_errors_come_on_top_of_constant_parameters():
    """Positive loop with errors of 0.01: the largest x is (1 + 0.01) / 0.4."""
    course = scalar(noise=0.01)
    top = 1.01 / 0.4
    failed = verdict(course, bound(high=top - 1e-3))
    assert failed.status is Status.FAILED
    assert failed.margin == pytest.approx(-1e-3, rel=1e-3)
    assert verdict(course, bound(high=top + 1e-3)).status is not Status.FAILED


def test_the_run_of_a_verdict_is_the_one_that_its_parameters_make():
    for course in (scalar(noise=0.02), turning()):
        for moving in (True, False):
            kept = kept_of(course, bound(high=0.1), moving=moving)
            run = kept.run
            np.testing.assert_allclose(replay(course, run.delta, run.start), run.v, atol=1e-12)
            np.testing.assert_allclose(course.begun(run.before, run.share), run.start, atol=1e-12)
            assert kept.verdict.margin == pytest.approx(0.1 - run.v[0, kept.sample, 0], rel=1e-9)


def test_a_course_with_constant_parameters_is_the_replay_of_them():
    course, delta = scalar(noise=0.3), np.array([0.7, -0.4])
    own = course.at(delta)
    expected = replay(course, np.tile(delta, (1, N, 1)), course.begun(delta[None]))[0]
    np.testing.assert_allclose(nominal(own).v, expected, atol=1e-12)
    assert not own.lam.any()
    half = course.at(np.array([0.7, 0.0]))
    np.testing.assert_array_equal(half.lam, [[0.0, 0.3]])


def test_nothing_is_proved_beyond_what_a_command_may_be_at():
    stops = [bound("u", low=-5.0, high=0.0)]
    open_end = verdict(scalar(), bound(high=100.0), stops=[replace(stops[0], low=np.full(N, -4.5))])
    assert open_end.status is Status.UNDECIDED
    assert "a command may be at its stop" in open_end.sentence
    assert verdict(scalar(), bound(high=100.0), stops=[replace(stops[0], low=np.full(N, -5.2))]).status is Status.PROVED
    # what happens after a command is at its stop refutes nothing: -2 x falls below -4.5 before x is above 2.4
    after = verdict(scalar(), bound(high=2.4), stops=[replace(stops[0], low=np.full(N, -4.5))])
    assert after.status is Status.UNDECIDED
    # asked from sample 40 on, and the command is at its stop from sample 20 on
    asked, late = np.where(np.arange(N) < 40, np.inf, 2.4), np.where(np.arange(N) < 20, -100.0, -1.0)
    none = verdict(scalar(), replace(bound(high=2.4), high=asked), stops=[replace(stops[0], low=late)])
    assert "; nothing was tried before" in none.sentence


def drawn_loop(seed, n=3, p=2) -> UncertainLoop:
    random = np.random.default_rng(seed)
    A = random.normal(size=(n, n))
    A *= random.uniform(0.5, 0.97) / np.abs(np.linalg.eigvals(A)).max()
    lam = random.uniform(0.01, 0.3, p)
    return UncertainLoop(A, random.normal(size=(n, 1)), random.normal(size=(p, n)), lam, np.zeros(p))


def drawn_course(seed) -> tuple[Course, Bound]:
    random = np.random.default_rng(seed)
    n, p, c, samples = int(random.integers(1, 4)), int(random.integers(1, 4)), int(random.integers(1, 3)), 30
    A = random.normal(size=(n, n))
    A *= random.uniform(0.3, 0.95) / np.abs(np.linalg.eigvals(A)).max()
    course = Course(
        A=A[None], B=random.normal(size=(1, n, c)), C=random.normal(size=(1, p, n)), E=random.normal(size=(1, 1, n)),
        F=random.normal(size=(1, 1, c)), lam=random.uniform(0.0, 0.1, (1, p)), channel=random.integers(0, c, p),
        mode=np.zeros(samples), q=random.normal(size=(samples, n)), g=random.normal(size=(samples, 1)),
        f=random.normal(size=(samples, p)), start=random.normal(size=n), signals=("y",),
    )  # fmt: skip
    run, outer = nominal(course).v[:, 0], kernel(course).half[:, 0]
    limit = run.max() + random.uniform(0.1, 1.2) * (outer.max() if np.isfinite(outer).all() else 1.0)
    return course, Bound("y", "y", "", np.full(samples, -np.inf), np.full(samples, limit))


@pytest.mark.slow
@pytest.mark.parametrize("block", range(10))
def test_no_claim_of_200_random_runs_is_proved_and_refuted(block):
    """PROVED of parameters that move, and not one of many random sequences breaks the bound; FAILED breaks it when replayed."""
    random, seen = np.random.default_rng(block), set()
    for seed in range(20 * block, 20 * block + 20):
        course, limit = drawn_course(seed)
        kept = kept_of(course, limit, moving=True)
        seen.add(kept.verdict.status)
        delta = random.choice([-1.0, 1.0], size=(40, len(course), course.lam.shape[1]))
        tried = max(float((replay(course, delta)[:, :, 0] - limit.high).max()), float((kept.run.v[0, :, 0] - limit.high).max()))
        if kept.verdict.status is Status.PROVED:
            assert tried <= 0.0, seed
        elif kept.verdict.status is Status.FAILED:
            again = replay(course, kept.run.delta)[0, :, 0] - limit.high
            assert float(again.max()) == pytest.approx(-kept.verdict.margin, rel=1e-9), seed
        else:
            assert tried <= 0.0, seed
    assert {Status.PROVED, Status.FAILED} <= seen


@pytest.mark.slow
@pytest.mark.parametrize("block", range(10))
def test_no_stability_of_200_random_loops_is_proved_and_refuted(block):
    for seed in range(20 * block, 20 * block + 20):
        loop = drawn_loop(seed, n=2 + seed % 2)
        found = margin(loop)
        low, high = found.certified.kappa, found.falsified.kappa
        assert low <= high
        for needed in (0.98 * low, 1.02 * high):
            status = stability(found, needed, "stable", "").status
            assert status is not (Status.FAILED if needed < low else Status.PROVED), seed
        own = stability(found, 1.0, "stable", "", possible=corners(2)).status  # parameters that stand still, of the box itself
        lost = max(np.abs(np.linalg.eigvals(loop.at(delta))).max() for delta in corners(2)) >= 1.0
        assert own is Status.FAILED if lost else own is not Status.FAILED, seed
        refuted = stability(found, 1.001 * high, "stable", "")
        assert refuted.status is Status.FAILED
        # the product of the matrices of the loop itself, not of the one that was searched
        product = np.eye(len(loop.A))
        for delta in found.falsified.delta:
            product = loop.at(found.falsified.kappa * delta) @ product
        assert np.abs(np.linalg.eigvals(product)).max() >= 1.0 - 1e-6


def test_a_certificate_that_does_not_hold_proves_nothing():
    found = margin(drawn_loop(5))
    broken = replace(found, certified=replace(found.certified, P=-found.certified.P))
    assert stability(found, 0.5 * found.certified.kappa, "", "").status is Status.PROVED
    assert stability(broken, 0.5 * found.certified.kappa, "", "").status is Status.UNDECIDED
    lying = replace(found, falsified=replace(found.falsified, delta=0.0 * found.falsified.delta))
    assert stability(lying, 2.0 * found.falsified.kappa, "", "").status is Status.UNDECIDED


@pytest.mark.slow
def test_only_parameters_that_may_be_the_machines_refute():
    """A loop whose corner 1 is lost and corner -1 is not."""
    loop = UncertainLoop([[0.9]], [[1.0]], [[1.0]], [0.2], [0])
    found = margin(loop)
    assert found.certified.kappa < 1.0
    failed = stability(found, 1.0, "", "", possible=np.array([[1.0], [-1.0]]))
    assert failed.status is Status.FAILED
    assert failed.margin == pytest.approx(-0.1, abs=1e-9)
    open_end = stability(found, 1.0, "", "", possible=np.array([[0.4], [-1.0]]))
    assert open_end.status is Status.UNDECIDED
    lost = refuting(found, 1.0, np.array([[1.0]]))
    assert lost is not None
    assert lost.growth == pytest.approx(1.1)
    # moving parameters are never weaker: constant ones still refute where no sequence was found, and sequences besides
    blind = replace(found, falsified=replace(found.falsified, kappa=2.0))
    assert stability(blind, 1.0, "", "", moving=True, possible=np.array([[1.0]])).status is Status.FAILED
    assert stability(found, 1.0, "", "", moving=True, possible=np.array([[0.4]])).status is Status.FAILED
    assert refuting(found, 1.0, np.empty((0, 1))) is None


def test_a_constant_run_begins_at_its_own_rest():
    """At rest at 1 / (0.5 - lam delta), and it stays there: nothing but the level differs from the middle."""
    kept = kept_of(scalar(), bound(high=2.4))
    np.testing.assert_allclose(kept.run.v[0, :, 0], 2.5, rtol=1e-12)
    np.testing.assert_allclose(scalar().begun(np.array([[-1.0, 0.0]])), [[1.0 / 0.6]])
    wild = replace(scalar(), A=[[[1.5]]])
    np.testing.assert_array_equal(wild.begun(np.array([[0.0, 0.0]])), [wild.start])  # no rest


def in_pi_loop(initial=None) -> tuple[Course, Bound]:
    """y+ = a y + b u, a 0.9 +- 0.005, b 0.1 +- 0.01, PI 0.3, 0.3 at 0.1 s, from a set-point of 1 to 0.2; u below 1.0133."""
    own = model("y", ("u",), ARX(order=1, delta=False, bias=False), [-0.9, 0.1], [0.005, 0.01])
    law = pid(("u",), ("y",), ("r",), 0.1, [0.3], [0.3])
    r = np.append(1.0, np.full(N - 1, 0.2))[:, None]
    return along([driven(machine_of([own], law), law)], r, initial), bound("u", high=1.0133)


def test_a_machine_of_the_box_begins_at_its_own_rest():
    """a = 0.895, b = 0.09 needs a command of (1 - 0.895) / 0.09 = 1.1667 to rest at 1."""
    loop, limit = in_pi_loop()
    needed = (1.0 - 0.895) / 0.09
    for moving in (False, True):
        failed = kept_of(loop, limit, moving=moving)
        assert failed.verdict.status is Status.FAILED
        assert failed.run.v[0, failed.sample, 1] == pytest.approx(needed, rel=1e-9)
        assert verdict(loop, bound("u", high=1.01 * needed), moving=moving).status is Status.PROVED
        assert verdict(loop, bound("u", high=0.999 * needed), moving=moving).status is Status.FAILED
    stops = [bound("u", low=-2.0, high=1.1)]  # some machines rest beyond their stop
    assert verdict(loop, bound("u", high=2.0), stops=stops).status is Status.UNDECIDED
    below, one = [bound("u", low=-2.0, high=1.1 * needed)], bound("u", high=1.09 * needed)
    assert verdict(loop, one, stops=below).status is Status.PROVED


def test_set_points_before_the_run_may_be_anywhere_in_an_interval():
    """From a rest at a set-point of 0 to 2 the command begins as high as 2 (1 - 0.895) / 0.09, less what the step to 1 takes."""
    wide, needed = in_pi_loop(np.array([[0.0, 2.0]]))[0], 2.0 * (1.0 - 0.895) / 0.09 - 0.3 * (2.0 - 1.0)
    failed = kept_of(wide, bound("u", high=0.999 * needed))
    assert failed.verdict.status is Status.FAILED
    assert failed.run.v[0, :, 1].max() == pytest.approx(needed, rel=1e-9)
    np.testing.assert_array_equal(failed.run.share, [[1.0]])
    assert verdict(wide, bound("u", high=1.02 * needed)).status is Status.PROVED
    at_two = in_pi_loop(np.array([[2.0, 2.0]]))[0]
    assert verdict(at_two, bound("u", high=1.02 * needed)).status is Status.PROVED
    assert verdict(at_two, bound("u", high=0.999 * needed)).status is Status.FAILED
    with pytest.raises(InputError, match="low <= high"):
        in_pi_loop(np.array([[1.0, 0.0]]))


def test_where_a_machine_has_no_rest_nothing_is_proved():
    """1 - a - lam delta reaches 0 in the box: a run may begin anywhere."""
    lost = replace(scalar(lam=0.5), start=[2.0])
    for moving in (True, False):
        found = verdict(lost, bound(high=1e6), moving=moving)
        assert found.status is not Status.PROVED
        assert found.status is Status.FAILED or "rests of all machines" in found.sentence


def test_rounding_breaks_no_bound_and_a_bound_of_nothing_is_refused():
    still = replace(scalar(lam=0.0), q=np.full((N, 1), 0.15), start=[0.3], before=None)
    assert verdict(still, bound(high=0.3)).status is not Status.FAILED
    with pytest.raises(InputError, match="asks nothing"):
        verdict(scalar(), bound())


def test_the_worst_of_many_verdicts_counts():
    def of(*statuses):
        return overall([Verdict("", "", s, 0.0, "", "") for s in statuses])

    assert of(Status.PROVED, Status.PASSED) is Status.PASSED
    assert of(Status.UNDECIDED, Status.PROVED) is Status.UNDECIDED
    assert of(Status.FAILED, Status.UNDECIDED) is Status.FAILED
    with pytest.raises(InputError, match="no claim"):
        overall([])
    assert Verdict("", "", Status.PASSED, math.nan, "", "").to_dict()["margin"] is None


def test_a_stored_sequence_gives_its_number_again_and_a_changed_one_does_not(tmp_path):
    found = margin(drawn_loop(3))
    Growth("stable", found.loop, found.falsified).save(tmp_path / "g.json")
    stored = load_sequence(tmp_path / "g.json")
    assert same(stored.again(lambda content: None), stored.value)
    content = read_json(tmp_path / "g.json")
    content["kappa"] *= 1.0 + 1e-6
    write_json(tmp_path / "g.json", content)
    changed = load_sequence(tmp_path / "g.json")
    assert not same(changed.again(lambda content: None), changed.value)
    del content["delta"]
    write_json(tmp_path / "g.json", content)
    with pytest.raises(InputError, match="field 'delta' is missing"):
        load_sequence(tmp_path / "g.json")
    write_json(tmp_path / "g.json", {"schema": "other"})
    with pytest.raises(InputError, match="not a parameter sequence"):
        load_sequence(tmp_path / "g.json")
