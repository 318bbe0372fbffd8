"""Margins: bounds on both sides, exact where they claim to be, certificates that are proved and sequences that are replayed."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import brentq

from tests.workbench.robustness.loops import lagged_machine, machine_run, two_regressions
from workbench.errors import InputError
from workbench.robustness.loop import close
from workbench.robustness.margins import (
    CLOSE,
    Certificate,
    _by_multipliers,
    corners,
    falsified,
    frozen_margin,
    lost_on_an_edge,
    margin,
)
from workbench.robustness.uncertain import UncertainLoop


def drawn(seed, n=4, p=3, q=1) -> UncertainLoop:
    """A stable loop with random numbers."""
    random = np.random.default_rng(seed)
    A = random.normal(size=(n, n))
    A *= random.uniform(0.5, 0.95) / np.abs(np.linalg.eigvals(A)).max()
    return UncertainLoop(
        A,
        random.normal(size=(n, q)),
        random.normal(size=(p, n)),
        random.uniform(0.02, 0.2, p),
        random.permutation(np.arange(p) % q),
    )


def size(A):
    return np.abs(np.linalg.eigvals(A)).max(axis=-1)


# ---- exact answers --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("pole", [0.7, -0.4])
def test_one_state_has_one_margin(pole):
    """|pole| + kappa lam = 1 for parameters that stand still and for those that move."""
    loop = UncertainLoop([[pole]], [[2.0]], [[0.5]], [0.1], [0])
    found = margin(loop)
    exact = (1.0 - abs(pole)) / 0.1
    assert found.frozen.kappa == pytest.approx(exact, rel=1e-9)
    assert found.falsified.kappa == pytest.approx(exact, rel=1e-5)
    assert exact / (CLOSE * (1.0 + 1e-5)) <= found.certified.kappa <= exact


@pytest.mark.parametrize(("a1", "a2", "l1", "l2"), [(-1.2, 0.5, 0.1, 0.02), (0.3, 0.8, 0.05, 0.05), (-0.2, -0.3, 0.3, 0.01)])
def test_the_frozen_margin_of_two_poles_is_the_stability_triangle(a1, a2, l1, l2):
    """z^2 + a1 z + a2 is stable where |a2| < 1 and |a1| < 1 + a2."""
    loop = UncertainLoop([[-a1, -a2], [1.0, 0.0]], [[1.0], [0.0]], -np.eye(2), [l1, l2], [0, 0])
    exact = min((1.0 - a2) / l2, (1.0 + a2 - abs(a1)) / (l1 + l2))
    assert frozen_margin(loop).kappa == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize("seed", range(12))
def test_the_frozen_margin_is_exact(seed):
    """A pole on the unit circle with the parameters that it names; below, none on a dense grid, nor on any edge of the box."""
    loop = drawn(seed)
    found = frozen_margin(loop)
    assert found.exact
    assert np.abs(found.delta).max() <= 1.0 + 1e-9
    poles = np.linalg.eigvals(loop.at(found.kappa * found.delta))
    assert np.abs(poles - np.exp(1j * found.omega)).min() < 1e-6
    axis = np.linspace(-1.0, 1.0, 21)
    grid = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    assert size(loop.at(0.999 * found.kappa * grid)).max() < 1.0
    assert lost_on_an_edge(loop, 0.9999 * found.kappa) is None
    assert lost_on_an_edge(loop, 1.0001 * found.kappa) is not None


def test_one_parameter_is_lost_at_single_frequencies():
    """Its zonogon is a line, which a grid of frequencies sees at both ends only. z^2 - 0.3 z + 0.8 + 0.1 kappa delta."""
    for lam in ([0.1], [1e-9, 0.1]):
        C = np.array([[1.0, 0.0], [0.0, -1.0]])[-len(lam) :]
        loop = UncertainLoop([[0.3, -0.8], [1.0, 0.0]], [[1.0], [0.0]], C, lam, [0] * len(lam))
        found = frozen_margin(loop)
        assert found.kappa == pytest.approx(2.0, rel=1e-5)
        assert size(loop.at(found.kappa * found.delta)) == pytest.approx(1.0, abs=1e-6)
    many = UncertainLoop([[0.3, -0.8], [1.0, 0.0]], [[1.0], [0.0]], np.tile([[0.0, -1.0]], (9, 1)), [0.1 / 9] * 9, [0] * 9)
    assert not frozen_margin(many).exact  # too many edges to look at


@pytest.mark.parametrize("seed", range(20))
def test_valleys_beside_a_pole_near_the_circle(seed):
    """No smaller constant parameters lose the loop: tried at random, below what is called exact."""
    random = np.random.default_rng(seed)
    angle, near = random.uniform(0.1, 3.0), 1.0 - 10.0 ** random.uniform(-7, -3)
    turn = near * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    A = np.block([[turn, np.zeros((2, 1))], [np.zeros((1, 2)), np.array([[0.5]])]])
    loop = UncertainLoop(A, random.normal(size=(3, 1)), random.normal(size=(2, 3)), random.uniform(0.01, 0.1, 2), [0, 0])
    found = frozen_margin(loop)
    assert found.exact
    assert size(loop.at(found.kappa * found.delta)) == pytest.approx(1.0, abs=1e-6)
    edge = np.concatenate([np.stack([np.linspace(-1, 1, 400), np.full(400, s)], -1) for s in (-1.0, 1.0)])
    assert size(loop.at(0.999 * found.kappa * np.concatenate([edge, edge[:, ::-1]]))).max() < 1.0


@pytest.mark.slow
def test_many_poles_close_to_one_are_not_taken_for_poles_on_the_circle():
    """A model of many slow local models: its characteristic polynomial at 1 is far below the rounding of its coefficients."""
    A = np.diag(np.linspace(0.94, 0.985, 12)) + 0.01 * np.eye(12, k=-1)
    C = np.zeros((2, 12))
    C[0, 0], C[1, -1] = 1.0, -1.0
    loop = UncertainLoop(A, np.eye(12, 1), C, [0.001, 0.0005], [0, 0])
    found = margin(loop).frozen
    assert found.exact
    assert size(loop.at(found.kappa * found.delta)) == pytest.approx(1.0, abs=1e-6)
    edge = np.concatenate([np.stack([np.linspace(-1, 1, 400), np.full(400, s)], -1) for s in (-1.0, 1.0)])
    assert size(loop.at(0.999 * found.kappa * np.concatenate([edge, edge[:, ::-1]]))).max() < 1.0


def test_a_narrow_resonance_is_not_missed():
    """A pair of poles 1e-5 from the circle: a grid of some thousand frequencies does not see it."""
    angle, near = 1.2345678, 1.0 - 1e-5
    A = near * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    A = np.block([[A, np.zeros((2, 1))], [np.zeros((1, 2)), np.array([[0.5]])]])
    loop = UncertainLoop(A, np.ones((3, 1)), np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), [0.01, 0.01], [0, 0])
    found = frozen_margin(loop)
    assert found.kappa < 0.01
    assert size(loop.at(found.kappa * found.delta)) == pytest.approx(1.0, abs=1e-8)


# ---- both sides -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "q"), [(seed, q) for seed in range(6) for q in (1, 2)])
def test_both_bounds_are_what_they_claim(seed, q):
    loop = drawn(seed, n=5, p=4, q=q)
    found = margin(loop, seed)
    own = loop.balanced()
    assert found.certified.holds(own)
    assert found.certified.kappa <= found.falsified.kappa <= found.frozen.kappa * (1.0 + 1e-5)
    assert found.falsified.replay(loop) == pytest.approx(found.falsified.growth, rel=1e-6)
    assert found.falsified.growth >= 1.0
    assert np.abs(found.falsified.delta).max() <= 1.0
    random = np.random.default_rng(seed)
    x = np.ones(len(loop.A))
    for delta in random.choice([-1.0, 1.0], size=(400, 4)):  # what is certified no sequence breaks
        x = own.at(found.certified.kappa * delta) @ x
    assert np.linalg.norm(x) < 1.0
    assert found.gap < 1.25


@pytest.mark.slow
def test_a_sequence_that_grows_grows_in_the_machine():
    """The regressions and the law, stepped one by one under the falsified parameters: growth by growth^periods."""
    models, one = two_regressions()
    loop = close(models, one)
    found = margin(loop).falsified
    L, periods = len(found.delta), 100
    wide = [widened(m, found.kappa) for m in models]
    delta = {m.output.name: np.zeros((L * periods, len(m.form.names))) for m in models}
    for i, name in enumerate(loop.parameters):
        output, own = name.split(": ")
        at = next(m for m in models if m.output.name == output).form.names.index(own)
        delta[output][:, at] = np.tile(found.delta[:, i], periods)
    y, _ = machine_run(wide, one, delta, {"y1": [1.0, -0.7], "y2": [0.2, 0.4, -1.0]})
    middle, late = (max(np.abs(v[part]).max() for v in y.values()) for part in (slice(25 * L, 50 * L), slice(75 * L, None)))
    assert late > 0.99 * middle > 0.1  # it does not die out
    calm, _ = machine_run(wide, one, {k: 0.9 * d for k, d in delta.items()}, {"y1": [1.0, -0.7], "y2": [0.2, 0.4, -1.0]})
    assert max(np.abs(v[75 * L :]).max() for v in calm.values()) < 0.01 * late


def widened(model, kappa):
    """The model with its box kappa times as wide."""
    (mode,) = model.modes
    return replace(model, modes=(replace(mode, box=replace(mode.box, radius=kappa * mode.box.radius)),))


@pytest.mark.slow
def test_random_parameters_find_nothing_where_the_sequence_grows():
    """2 % above the falsified margin random corners still let every state die out: sampling proves nothing."""
    loop = drawn(3, n=6, p=5)
    found = margin(loop).falsified
    kappa = 1.02 * found.kappa
    assert replace(found, kappa=kappa).replay(loop) > 1.0
    random = np.random.default_rng(0)
    for _ in range(20):
        x = np.ones(6)
        for delta in random.choice([-1.0, 1.0], size=(1500, 5)):
            x = loop.at(kappa * delta) @ x
        assert np.linalg.norm(x) < 1e-3


def test_the_program_is_that_of_an_independent_statement():
    """The multiplier LMI in CVXPY: feasible at the kappa that is found, infeasible a little above the largest."""
    loop = drawn(7, n=4, p=3).balanced()

    def feasible(kappa):
        P, D, t = cp.Variable((4, 4), symmetric=True), cp.Variable(3, nonneg=True), cp.Variable()
        B = kappa * loop.columns
        block = cp.bmat([
            [P - loop.A.T @ P @ loop.A - loop.C.T @ cp.diag(D) @ loop.C - t * np.eye(4), -loop.A.T @ P @ B],
            [-B.T @ P @ loop.A, cp.diag(D) - B.T @ P @ B],
        ])  # fmt: skip
        problem = cp.Problem(cp.Maximize(t), [0.5 * (block + block.T) >> 0, cp.trace(P) == 4.0])
        problem.solve(solver=cp.CLARABEL)
        return t.value > 1e-7

    low, high = 1e-3, 1e3
    while high / low > 1.001:
        middle = np.sqrt(low * high)
        low, high = (middle, high) if feasible(middle) else (low, middle)
    assert _by_multipliers(loop, 0.995 * low).holds(loop)
    above = _by_multipliers(loop, 1.01 * high)
    assert above is None or not above.holds(loop)


# ---- a published example ---------------------------------------------------------------------------------------------------


def spring(k, h) -> UncertainLoop:
    """x'' + x' + (2 + k delta) x = 0, delta from 0 to 1 as it likes, by Euler steps of h."""
    return UncertainLoop([[1.0, h], [-h * (2.0 + 0.5 * k), 1.0 - h]], [[0.0], [h]], [[-1.0, 0.0]], [0.5 * k], [0]).balanced()


def without_steps(of):
    """of(h) at h = 0, from three steps."""
    return (8.0 * of(0.01) - 6.0 * of(0.02) + of(0.04)) / 3.0


def test_the_quadratic_margin_is_that_of_the_circle_criterion():
    """1 + 2 sqrt 2: Zelentsovsky, IEEE Trans. Automatic Control 39 (1994)."""

    def quadratic(h):
        low, high = 2.0, 6.0
        while high - low > 1e-5:
            middle = 0.5 * (low + high)
            found = _by_multipliers(spring(middle, h), 1.0)
            low, high = (middle, high) if found is not None and found.holds(spring(middle, h)) else (low, middle)
        return low

    assert without_steps(quadratic) == pytest.approx(1.0 + 2.0 * np.sqrt(2.0), rel=1e-3)


@pytest.mark.slow
def test_the_worst_switching_is_the_published_one():
    """k = 6.98513: Margaliot and Langholz, IEEE Trans. Circuits and Systems I 50 (2003); and in the plane, as every spring turns
    the state the same way, that at which the largest growth over each angle adds up to nothing over half a turn."""
    c, s = np.cos(angle := np.linspace(0.0, np.pi, 20001)), np.sin(angle)

    def growth(k):
        along, around = (np.array([f(2.0), f(2.0 + k)]) for f in (
            lambda a: c * s - a * c * s - s**2, lambda a: a * c**2 + c * s + s**2))  # fmt: skip
        return np.trapezoid((along / around).max(axis=0), angle)

    assert brentq(growth, 1.0, 20.0) == pytest.approx(6.98513, abs=1e-4)

    def refuted(h):
        def beyond(k):
            loop = spring(k, h)
            return falsified(loop, frozen_margin(loop)).kappa - 1.0

        return brentq(beyond, 4.0, 9.0, rtol=3e-3)

    assert without_steps(refuted) == pytest.approx(6.98513, rel=0.005)


# ---- certificates ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_broken_certificate_is_rejected():
    loop = drawn(2, n=5, p=4).balanced()
    found = margin(loop)
    good = found.certified
    assert good.D is None
    by_multipliers = _by_multipliers(loop, 0.8 * good.kappa)
    assert by_multipliers.holds(loop)
    for one in (good, by_multipliers):
        assert not replace(one, kappa=1.01 * found.falsified.kappa).holds(loop)
        assert not replace(one, P=-one.P).holds(loop)
        assert not replace(one, P=one.P[:4, :4]).holds(loop)
        skew = one.P.copy()
        skew[0, 1] += 1e-3
        assert not replace(one, P=skew).holds(loop)
        assert not replace(one, P=np.eye(5) - 2.0 * np.outer(*[np.eye(5)[0]] * 2)).holds(loop)
        assert not one.holds(replace(loop, lam=3.0 * loop.lam))
    assert not replace(by_multipliers, D=-by_multipliers.D).holds(loop)
    assert not replace(by_multipliers, D=0.0 * by_multipliers.D).holds(loop)
    assert not replace(by_multipliers, D=by_multipliers.D[:3]).holds(loop)


def test_one_step_and_two_steps_are_told_apart():
    """A P that falls over two samples only is no certificate of one."""
    loop = UncertainLoop([[0.0, 2.0], [0.1, 0.0]], [[1.0], [0.0]], [[0.0, 1.0]], [0.1], [0])
    assert Certificate(1.0, np.eye(2), steps=2).holds(loop)
    assert not Certificate(1.0, np.eye(2), steps=1).holds(loop)


@pytest.mark.slow
def test_two_steps_where_there_are_few_enough_corners():
    """And more is proved than by multipliers alone, which need no corners."""
    many = margin(drawn(11, n=4, p=7))
    assert many.certified.D is not None
    model, law = lagged_machine(0.1, (2.0, 1.0, 0.0))
    found = margin(close([model], law))
    assert (found.certified.steps, found.certified.D is None) == (2, True)
    assert found.certified.holds(found.loop)
    alone = _by_multipliers(found.loop, found.certified.kappa)
    assert alone is None or not alone.holds(found.loop)


def test_every_corner_is_looked_at():
    assert len({tuple(c) for c in corners(4)}) == 16
    loop = UncertainLoop(np.zeros((1, 1)), [[1.0]], np.ones((4, 1)), [0.3] * 4, [0] * 4)
    assert not Certificate(1.0, np.eye(1)).holds(loop)  # only two of the corners break it
    assert Certificate(0.8, np.eye(1)).holds(loop)


# ---- odd loops ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_superfluous_states_do_no_harm():
    """States that nothing reaches, and states that copy others: where a balanced realisation breaks down the bounds stay."""
    loop = drawn(4, n=4, p=3)
    A = np.block([[loop.A, np.zeros((4, 3))], [np.eye(3, 4), np.zeros((3, 3))]])
    A[6, 6] = 0.3
    copied = UncertainLoop(
        A, np.vstack([loop.B, np.zeros((3, 1))]), np.hstack([loop.C, np.zeros((3, 3))]), loop.lam, loop.channel
    )
    one, other = margin(loop), margin(copied)
    assert other.frozen.kappa == pytest.approx(one.frozen.kappa, rel=1e-6)
    assert other.certified.kappa == pytest.approx(one.certified.kappa, rel=0.03)


@pytest.mark.slow
def test_odd_loops_are_refused():
    with pytest.raises(InputError, match="not stable in the middle"):
        margin(UncertainLoop([[1.1]], [[1.0]], [[1.0]], [0.1], [0]))
    with pytest.raises(InputError, match="no parameter is uncertain"):
        margin(UncertainLoop([[0.5]], [[1.0]], [[1.0]], [0.0], [0]))
    with pytest.raises(InputError, match="no parameters were found"):
        margin(UncertainLoop(0.5 * np.eye(2), [[1.0], [0.0]], [[0.0, 1.0]], [0.1], [0]))
