"""The smallest box: the optimum of [2] (8) for each semantics, and a promise that is kept in exact arithmetic."""

from fractions import Fraction
from itertools import combinations, product

import control
import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import linprog

from workbench.data import Experiment
from workbench.errors import InputError
from workbench.intervals.boxes import BoxProgram, smallest_box, verified
from workbench.intervals.paper import signed_optimum
from workbench.intervals.regressors import ARX, FIR, Samples, samples
from workbench.intervals.semantics import InclusionAll, InclusionExact, InclusionPaper, Overlap, ParameterBox

ERROR = 0.02
STRUCTURES = [ARX(2), ARX(2, delta=False), ARX(1, delay=0), FIR(3)]


def plant(N, seed, *, error=ERROR, spread=0.1, ts=None):
    """y(k) = a(k) y(k-1) - 0.3 y(k-2) + b(k) u(k-1) + 0.05, a in 0.9 -+ spread, b in 0.5 -+ spread; errors within `error`."""
    random = np.random.default_rng(seed)
    u, y = np.repeat(random.uniform(-1, 1, N // 4 + 1), 4)[:N], np.zeros(N)
    for k in range(2, N):
        a, b = 0.9 + spread * random.uniform(-1, 1), 0.5 + spread * random.uniform(-1, 1)
        y[k] = a * y[k - 1] - 0.3 * y[k - 2] + b * u[k - 1] + 0.05
    return y, u, y + error * random.uniform(-1, 1, N), u + error * random.uniform(-1, 1, N)


def measured(structure, N=80, seed=0, *, error=ERROR, scale=1.0, of_u=1.0):
    _, _, y, u = plant(N, seed, error=error)
    e = Experiment.from_arrays("a", 0.1, inputs={"u": of_u * u}, outputs={"y": scale * y})
    return samples(structure, e, "y", ["u"], output_error=scale * error, input_error=of_u * error)


def by_hand(z, y, r, e):
    """Samples of y = theta z, without a bias."""
    form = FIR(1, bias=False).form("y", ["u"])
    K = np.arange(len(z))
    return Samples(FIR(1, bias=False), form, np.array(z)[:, None], np.array(y), np.array([r]), e, 0.0 * K, K, ("a",))


def all_vertices(form, r, psi):
    """Every vertex of the arrangement psi_j -+ r_j, (T psi)_i = 0 in one box, over all coordinates at once; slow and plain."""
    moving = np.flatnonzero(r > 0)
    kinks = [i for i in range(len(form.T)) if np.any(form.T[i, moving] != 0)]
    found = []
    for count in range(len(moving) + 1):
        for free in combinations(moving, count):
            fixed = [j for j in moving if j not in free]
            for rows in combinations(kinks, count):
                square = form.T[np.ix_(rows, free)]
                if count and abs(np.linalg.det(square)) < 0.5:
                    continue
                for sides in product((-1, 1), repeat=len(fixed)):
                    at = psi.copy()
                    at[fixed] += np.array(sides) * r[fixed]
                    if count:
                        at[list(free)] = 0.0
                        at[list(free)] = np.linalg.solve(square, -form.T[list(rows)] @ at)
                    if (np.abs(at - psi) <= r + 1e-12).all():
                        found.append(at)
    return np.array(found)


def all_rows(S, semantics):
    """M, rhs of M (centre, radius) >= rhs and the cost: every row of the statement, none left out."""
    r = S.error if isinstance(semantics, InclusionAll) else 0.0 * S.error
    e = -S.output_error if isinstance(semantics, Overlap) else S.output_error
    M, rhs = [], []
    for psi, y in zip(S.psi, S.y, strict=True):
        at = all_vertices(S.form, r, psi)
        z, known = at @ S.form.T.T, at @ S.form.d
        M += [np.hstack([z, np.abs(z)]), np.hstack([-z, np.abs(z)])]
        rhs += [y + e - known, known - (y - e)]
    cost = np.abs(S.z).mean(axis=0) + np.abs(S.form.T) @ r
    return np.vstack(M), np.concatenate(rhs), cost


def literal_optimum(S, semantics):
    M, rhs, cost = all_rows(S, semantics)
    p = len(cost)
    answer = linprog(np.concatenate([np.zeros(p), cost]), -M, -rhs, bounds=[(None, None)] * p + [(0, None)] * p)
    assert answer.status == 0
    return answer.fun


def exactly_kept(S, semantics, box, chosen):
    """The least slack over the chosen samples in rational arithmetic, at every vertex of the regressor's box."""
    exact = lambda a: [Fraction(float(x)) for x in a]  # noqa: E731
    T, d = [exact(row) for row in S.form.T], exact(S.form.d)
    centre, radius = exact(box.centre), exact(box.radius)
    r = exact(S.error if isinstance(semantics, InclusionAll) else 0.0 * S.error)
    e = Fraction(S.output_error) * (-1 if isinstance(semantics, Overlap) else 1)
    least = None
    for k in chosen:
        psi, y = exact(S.psi[k]), Fraction(float(S.y[k]))
        corners = [[]]
        for j, (x, half) in enumerate(zip(psi, r, strict=True)):
            ends = {x - half, x + half}
            if sum(1 for row in T if row[j]) == 1 and all(sum(1 for t in row if t) == 1 for row in T if row[j]):
                ends |= {Fraction(0)} if abs(x) < half else set()  # shift form: the kink is one value of one entry
            corners = [[*corner, end] for corner in corners for end in ends]
        if any(r) and len(S.form.blocks) < len(psi):  # delta form: kinks join entries; take them from the plain enumeration
            for at in all_vertices(S.form, S.error, S.psi[k]):
                inside = [min(max(x, c - h), c + h) for x, c, h in zip(exact(at), psi, r, strict=True)]
                corners.append(inside)
        for at in corners:
            z = [sum(t * x for t, x in zip(row, at, strict=True)) for row in T]
            middle = sum(a * b for a, b in zip(d, at, strict=True)) + sum(a * b for a, b in zip(centre, z, strict=True))
            half = sum(a * abs(b) for a, b in zip(radius, z, strict=True))
            slack = min(middle + half - (y + e), half - middle + (y - e))
            least = slack if least is None else min(least, slack)
    return least


# ---- the optimum --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("structure", STRUCTURES, ids=str)
@pytest.mark.parametrize("semantics", [Overlap(), InclusionExact(), InclusionAll()], ids=lambda s: s.name)
def test_the_box_is_the_optimum_of_the_whole_linear_program(structure, semantics):
    S = measured(structure)
    assert smallest_box(S, semantics).mean_radius == pytest.approx(literal_optimum(S, semantics), rel=1e-7)


def test_errors_larger_than_the_signal_put_kinks_inside_the_boxes():
    for structure in (ARX(2), ARX(2, delta=False)):
        S = measured(structure, N=40, error=0.3)
        fitted = smallest_box(S, InclusionAll())
        assert fitted.mean_radius == pytest.approx(literal_optimum(S, InclusionAll()), rel=1e-7)


def test_cvxpy_and_clarabel_find_the_same_optimum():
    S = measured(ARX(2))
    M, rhs, cost = all_rows(S, InclusionAll())
    x = cp.Variable(2 * len(cost))
    problem = cp.Problem(cp.Minimize(cost @ x[len(cost) :]), [M @ x >= rhs, x[len(cost) :] >= 0])
    problem.solve(solver=cp.CLARABEL)
    assert smallest_box(S, InclusionAll()).mean_radius == pytest.approx(problem.value, rel=1e-6)


@pytest.mark.parametrize("structure", STRUCTURES, ids=str)
def test_the_optimum_follows_the_units(structure):
    metres, millimetres = measured(structure), measured(structure, scale=1000.0)
    for semantics in (InclusionExact(), InclusionAll()):
        a, b = smallest_box(metres, semantics), smallest_box(millimetres, semantics)
        assert b.mean_radius == pytest.approx(1000.0 * a.mean_radius, rel=1e-7)


@pytest.mark.parametrize("structure", STRUCTURES, ids=str)
def test_a_stronger_promise_needs_a_wider_envelope(structure):
    S = measured(structure)
    overlap, exact, every = (smallest_box(S, s).mean_radius for s in (Overlap(), InclusionExact(), InclusionAll()))
    assert overlap < exact < every


def test_with_nothing_in_error_the_promises_are_one():
    S = measured(ARX(2), error=0.0)
    radii = [smallest_box(S, s).mean_radius for s in (Overlap(), InclusionExact(), InclusionAll())]
    np.testing.assert_allclose(radii, radii[0], rtol=1e-9)


# ---- the promise --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("structure", STRUCTURES, ids=str)
@pytest.mark.parametrize("semantics", [Overlap(), InclusionExact(), InclusionAll()], ids=lambda s: s.name)
def test_every_sample_is_kept_in_exact_arithmetic(structure, semantics):
    S = measured(structure, N=300, seed=1)
    box = smallest_box(S, semantics).box
    few = range(0, len(S), 12) if isinstance(semantics, InclusionAll) else range(len(S))
    tight = np.argsort(BoxProgram(S, semantics).slack(box, 0, len(S)).min(axis=1))[:12]  # the rows on which the box rests
    assert exactly_kept(S, semantics, box, [*few, *tight.tolist()]) >= 0


@pytest.mark.parametrize("structure", [ARX(2), ARX(2, delta=False)], ids=str)
def test_the_true_system_keeps_its_place_in_the_envelope(structure):
    y, u, my, mu = plant(400, 3)
    make = lambda y, u, e: samples(  # noqa: E731
        structure, Experiment.from_arrays("a", 0.1, inputs={"u": u}, outputs={"y": y}), "y", ["u"], output_error=e, input_error=e
    )
    box = smallest_box(make(my, mu, ERROR), InclusionAll()).box
    true = make(y, u, 0.0)  # the output and the regressors that nobody measured
    assert BoxProgram(true, InclusionExact()).slack(box, 0, len(true)).min() >= 0


@pytest.mark.parametrize("semantics", [InclusionExact(), InclusionAll()], ids=lambda s: s.name)
@pytest.mark.parametrize("structure", STRUCTURES, ids=str)
def test_the_radii_grow_by_the_smallest_factor_that_keeps_every_sample(structure, semantics):
    S = measured(structure)
    program = BoxProgram(S, semantics)
    program.start(0, len(S))
    box = program.solve(0, len(S))
    shrunk = ParameterBox(box.centre, box.radius / 1.25)
    grown = verified(program, shrunk, 0, len(S))
    assert grown.inflation == pytest.approx(1.25, rel=1e-6)
    smaller = ParameterBox(box.centre, grown.box.radius * 0.999999)
    assert program.proven_slack(smaller, np.arange(len(S))).min() < 0
    # those and only those samples asked for it that the shrunken box breaks
    assert grown.inflated == np.count_nonzero(program.slack(shrunk, 0, len(S)).min(axis=1) < 0)


def test_a_box_that_needs_nothing_is_left_alone():
    S = measured(ARX(2))
    program = BoxProgram(S, InclusionAll())
    found = smallest_box(S, InclusionAll())
    wide = ParameterBox(found.box.centre, 2 * found.box.radius + 0.1)
    left = verified(program, wide, 0, len(S))
    assert (left.inflation, left.inflated) == (1.0, 0)
    np.testing.assert_array_equal(left.box.radius, wide.radius)


def test_radii_of_zero_and_parameters_of_millions_are_inflated_too():
    S = measured(ARX(2, delta=False))
    program = BoxProgram(S, InclusionAll())
    zero = verified(program, ParameterBox(np.zeros(5), np.zeros(5)), 0, len(S))
    assert program.proven_slack(zero.box, np.arange(len(S))).min() >= 0
    # u + bias of opposite millions: steps below the rounding of the sum once led nowhere
    constant = Experiment.from_arrays("a", 0.1, inputs={"u": np.full(30, -2.0)}, outputs={"y": np.sin(np.arange(30.0))})
    S = samples(ARX(2, delta=False), constant, "y", ["u"], output_error=0.002)
    program = BoxProgram(S, InclusionAll())
    program.start(0, len(S))
    box = program.solve(0, len(S))
    far = ParameterBox(box.centre + np.array([0, 0, 1.5e6, 1.5e6, 6e6]), box.radius)
    assert program.proven_slack(verified(program, far, 0, len(S)).box, np.arange(len(S))).min() >= 0


# ---- data as they come --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("delta", [True, False])
def test_perfect_records_give_a_point_that_still_verifies(delta):
    G = control.c2d(control.tf([1, 2.3], [1, 6.6, 1.67]), 0.1)
    u = np.sign(np.sin(np.arange(300) ** 1.3))
    y = control.forced_response(G, np.arange(300) * 0.1, u).outputs
    S = samples(ARX(2, delta=delta), Experiment.from_arrays("a", 0.1, inputs={"u": u}, outputs={"y": y}), "y", ["u"])
    fitted = smallest_box(S, InclusionAll())
    assert fitted.mean_radius <= 1e-9 * np.ptp(y)
    assert exactly_kept(S, InclusionExact(), fitted.box, range(len(S))) >= 0


def test_undetermined_parameters_stay_small():
    # a constant input is the bias once more: any share of the two explains the data equally well
    random = np.random.default_rng(0)
    y = np.cumsum(random.uniform(-1, 1, 60)) * 0.1
    e = Experiment.from_arrays("a", 0.1, inputs={"u": np.full(60, 2.0)}, outputs={"y": y})
    S = samples(ARX(2, delta=False), e, "y", ["u"], output_error=0.01)
    fitted = smallest_box(S, InclusionAll())
    assert np.abs(fitted.box.centre).max() < 10
    assert exactly_kept(S, InclusionAll(), fitted.box, range(0, len(S), 6)) >= 0


def resting(error=0.01):
    _, _, y, u = plant(120, 5, error=0.0)
    y[:40], u[:40] = 0.0, 0.0
    return Experiment.from_arrays("rest", 0.1, inputs={"u": u}, outputs={"y": y}), error


@pytest.mark.slow
@pytest.mark.parametrize("semantics", [InclusionExact(), InclusionAll()], ids=lambda s: s.name)
@pytest.mark.parametrize("delta", [True, False])
def test_a_rest_needs_a_bias(semantics, delta):
    e, error = resting()
    S = samples(ARX(2, delta=delta), e, "y", ["u"], output_error=error, input_error=error)
    fitted = smallest_box(S, semantics)
    assert fitted.mean_radius == pytest.approx(literal_optimum(S, semantics), rel=1e-7)
    S = samples(ARX(2, delta=delta, bias=False), e, "y", ["u"], output_error=error, input_error=error)
    with pytest.raises(InputError, match=r"rest: sample 3: all regressors may be 0") as refused:
        smallest_box(S, semantics)
    assert "bias" in refused.value.mend


def test_a_rest_without_errors_asks_for_nothing():
    e, _ = resting()
    y, u = e["y"].copy(), e["u"]
    y[40:42] = 0.0  # the first sample that moves has an input behind it
    u = np.where(np.arange(120) < 39, 0.0, np.maximum(np.abs(u), 0.1))
    e = Experiment.from_arrays("rest", 0.1, inputs={"u": u}, outputs={"y": y})
    S = samples(ARX(2, bias=False), e, "y", ["u"])
    assert smallest_box(S, InclusionExact()).mean_radius == pytest.approx(literal_optimum(S, InclusionExact()), rel=1e-7)


def test_a_record_of_zeros_is_refused():
    e = Experiment.from_arrays("a", 0.1, inputs={"u": np.zeros(30)}, outputs={"y": np.zeros(30)})
    with pytest.raises(InputError, match="all regressors are 0"):
        smallest_box(samples(ARX(2, bias=False), e, "y", ["u"]), InclusionExact())
    assert smallest_box(samples(ARX(2), e, "y", ["u"]), InclusionExact()).mean_radius == 0.0


@pytest.mark.parametrize("size", [1e3, 1e6, 1e9])
def test_an_outlier_of_many_orders_of_magnitude_is_kept_like_any_sample(size):
    _, _, y, u = plant(100, 6)
    y[50] = size
    S = samples(ARX(1), Experiment.from_arrays("a", 0.1, inputs={"u": u}, outputs={"y": y}), "y", ["u"], output_error=ERROR)
    fitted = smallest_box(S, InclusionExact())
    assert exactly_kept(S, InclusionExact(), fitted.box, range(len(S))) >= 0
    assert fitted.mean_radius == pytest.approx(literal_optimum(S, InclusionExact()), rel=1e-6)


# ---- the paper's inclusion ----------------------------------------------------------------------------------------------


def orthant_optimum(S, patterns=None):
    """min over all sign patterns of the centre: 2^p linear programs with every row."""
    z, r, best = S.z, S.error, np.inf
    for signs in patterns or product((1.0, -1.0), repeat=z.shape[1]):
        sign = np.array(signs)
        half = np.abs(z) + r
        rows = np.vstack([np.hstack([-side * z - sign * r, -half]) for side in (1.0, -1.0)])
        bound = -np.concatenate([S.y + S.output_error, -(S.y - S.output_error)])
        limits = [(0, None) if s > 0 else (None, 0) for s in sign] + [(0, None)] * len(sign)
        answer = linprog(np.concatenate([sign * r, half.mean(axis=0)]), rows, bound, bounds=limits)
        best = min(best, answer.fun) if answer.status == 0 else best
    return best


@pytest.mark.parametrize(
    ("z", "y", "positive", "negative"),
    [
        ([-2.0, 2.0, 2.0], [-2.0, 2.0, -3.0], 4.0, 3.5),
        ([-1.0, 0.0, -3.0], [-2.0, 1.0, 1.0], 10 / 3, 4.0),
        ([3.0, -1.0, -2.0], [1.0, 2.0, -2.0], None, None),
    ],
)
def test_the_papers_program_has_an_optimum_for_either_sign_and_the_better_one_is_found(z, y, positive, negative):
    # r = e = 1; in the first two sets least squares points to the wrong sign
    S = by_hand(z, y, 1.0, 1.0)
    each = [orthant_optimum(S, [(sign,)]) for sign in (1.0, -1.0)]
    if positive is not None:
        assert each == pytest.approx([positive, negative])
    assert smallest_box(S, InclusionPaper()).mean_radius == pytest.approx(min(each), rel=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_the_papers_inclusion_is_the_best_of_all_orthants(seed):
    S = measured(ARX(1, delta=False), N=40, seed=seed, error=0.3)
    assert smallest_box(S, InclusionPaper()).mean_radius == pytest.approx(orthant_optimum(S), rel=1e-6)


def violation(S, box, draws=300):
    """The largest distance of y in [y] from the true envelope at regressors drawn from [psi]."""
    random = np.random.default_rng(0)
    psi = S.psi + S.error * random.choice([-1.0, 1.0, 0.3], (draws, *S.psi.shape))
    z = psi @ S.form.T.T
    middle, half = psi @ S.form.d + z @ box.centre, np.abs(z) @ box.radius
    return float(max((S.y + S.output_error - middle - half).max(), (middle - half - S.y + S.output_error).max()))


@pytest.mark.slow
def test_the_papers_inclusion_is_broken_by_most_fits_and_inclusion_of_all_by_none():
    broken = {InclusionPaper: 0, InclusionAll: 0}
    for seed in range(12):
        S = measured(ARX(1, delta=False), N=40, seed=seed, error=0.1)
        for semantics in broken:
            broken[semantics] += violation(S, smallest_box(S, semantics()).box) > 1e-9
    assert broken[InclusionPaper] >= 8
    assert broken[InclusionAll] == 0


def test_the_papers_inclusion_is_refused_in_delta_form():
    with pytest.raises(InputError, match="shift form"):
        smallest_box(measured(ARX(2)), InclusionPaper())
    # without errors it is the exact inclusion
    S = measured(ARX(2, delta=False), error=0.0)
    assert smallest_box(S, InclusionPaper()).mean_radius == smallest_box(S, InclusionExact()).mean_radius


# ---- delta against shift form -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_at_fast_sampling_the_delta_form_is_far_narrower(seed):
    # G(s) = (s + 2.3)/(s^2 + 6.6 s + 1.67) of [2] (9) with a gain that varies by 15 %, sampled every 0.05 s
    random, t = np.random.default_rng(seed), np.arange(1500) * 0.05
    u = np.repeat(random.choice([-2.0, 2.0], 150), 10)
    y = control.forced_response(control.c2d(control.tf([1, 2.3], [1, 6.6, 1.67]), 0.05), t, u).outputs
    y = y * (1 + 0.15 * np.sin(0.3 * t)) + 0.002 * random.uniform(-1, 1, 1500)
    e = Experiment.from_arrays("a", 0.05, inputs={"u": u}, outputs={"y": y})
    for semantics in (InclusionExact(), InclusionAll()):
        delta, shift = (
            smallest_box(samples(ARX(2, delta=d), e, "y", ["u"], output_error=0.002), semantics).mean_radius
            for d in (True, False)
        )
        assert delta < 0.7 * shift


def test_a_box_that_leaves_the_unit_circle_in_shift_form_stays_inside_in_delta_form():
    a = control.c2d(control.tf([1, 2.3], [1, 6.6, 1.67]), 0.05).den[0][0]
    in_delta = np.array([2 + a[1], 1 + a[1] + a[2]])
    worst = {"shift": 0.0, "delta": 0.0}
    for signs in product((-1, 1), repeat=2):
        relative = 1 + 0.003 * np.array(signs)  # both coefficients -+ 0.3 %
        worst["shift"] = max(worst["shift"], np.abs(np.roots([1, *(a[1:] * relative)])).max())
        alpha = in_delta * relative
        # the same polynomial by the forms' own T and d
        forms = [ARX(2, delta=d, bias=False).form("y", ["u"]) for d in (True, False)]
        mapped = np.linalg.solve(forms[1].T.T, forms[0].d + forms[0].T.T @ np.array([*alpha, 0, 0]))
        worst["delta"] = max(worst["delta"], np.abs(np.roots([1, *mapped[:2]])).max())
    assert worst["shift"] > 1.0
    assert worst["delta"] < 0.99


def test_three_samples_for_which_one_linear_program_is_not_enough():
    """Errors differ from sample to sample: the optimum with centre >= 0 is 2.3667, the best with centre <= 0 2.4850 (by hand)."""
    z, reach = np.array([0.0, 10.0, 0.2])[:, None], np.array([1.0, 0.0, 1.0])[:, None]
    y, rad = np.array([0.0, 0.0, 0.05]), np.array([1.0, 0.0, 1.0])
    cost = (np.mean(np.abs(z) + reach, axis=0), np.mean(reach, axis=0))
    rows = (np.vstack([z, z]), np.vstack([reach, reach]), np.repeat([1.0, -1.0], 3), np.concatenate([y + rad, rad - y]))

    def value(box):
        return float(cost[0] @ box.radius + cost[1] @ np.abs(box.centre))

    best = signed_optimum(*rows, cost)
    assert value(best) == pytest.approx(2.36667, abs=1e-5)
    np.testing.assert_allclose([best.centre[0], best.radius[0]], [0.5, 0.5], atol=1e-9)

    def orthant(sign):
        """The linear program in (|centre|, radius) with the sign fixed, solved by itself."""
        A = np.hstack([rows[2][:, None] * sign * rows[0] + rows[1], np.abs(rows[0]) + rows[1]])
        return linprog(np.concatenate([cost[1], cost[0]]), A_ub=-A, b_ub=-rows[3]).fun

    assert orthant(+1.0) == pytest.approx(2.36667, abs=1e-5)
    assert orthant(-1.0) == pytest.approx(2.48500, abs=1e-5)
    # |centre| relaxed to any t >= |centre|: far below both
    A = np.hstack([rows[2][:, None] * rows[0], rows[1], np.abs(rows[0]) + rows[1]])
    keep = np.array([[1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
    relaxed = linprog(
        np.concatenate([[0.0], cost[1], cost[0]]), A_ub=np.vstack([-A, keep]), b_ub=np.concatenate([-rows[3], [0.0, 0.0]]),
        bounds=[(None, None), (0, None), (0, None)],
    )  # fmt: skip
    assert relaxed.fun == pytest.approx(0.70, abs=0.01)
