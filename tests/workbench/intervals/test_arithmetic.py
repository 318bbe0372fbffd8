"""Interval arithmetic against exact fractions and against flint's ball arithmetic, on tame and on nasty numbers."""

import itertools
import time
from fractions import Fraction

import flint
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workbench.errors import InputError
from workbench.intervals import arithmetic
from workbench.intervals.arithmetic import (
    Interval,
    around,
    dot,
    exact,
    matmul,
    positive_definite,
    product_exact,
    product_inner,
    product_outer,
)

U = 2.0**-53
TINY, NORMAL, MAX, INF = 5e-324, 2.0**-1022, float(np.finfo(float).max), float("inf")
POSITIVE = [TINY, 3 * TINY, 1e-310, NORMAL, 1e-200, 1e-162, 1 / 3, 1 - U, 1.0, 1 + 2 * U, np.pi, 1e16 + 2, 1e200, MAX / 2, MAX]
NASTY = np.array([0.0, *POSITIVE, *(-x for x in POSITIVE)])
PAIRS = np.array(list(itertools.product(NASTY, NASTY)))
SUM, DIFFERENCE, PRODUCT, QUOTIENT = (
    lambda x, y: x + y,
    lambda x, y: x - y,
    lambda x, y: x * y,
    lambda x, y: x / y,
)
OPERATIONS = pytest.mark.parametrize(
    "operation", [SUM, DIFFERENCE, PRODUCT, QUOTIENT], ids=["sum", "difference", "product", "quotient"]
)


def fractions(x) -> list:
    """Nested lists of the same numbers, exactly."""
    return np.vectorize(Fraction, otypes=[object])(x)


def holds(interval: Interval, truths) -> np.ndarray:
    """Whether each entry holds its exact truth; a float and a Fraction compare exactly in Python, also an infinite one."""
    low, high, truths = (np.asarray(a, dtype=object).ravel() for a in (interval.low, interval.high, truths))
    return np.array([float(a) <= t <= float(b) for a, b, t in zip(low, high, truths, strict=True)])


def steps(x, way: float, count: int = 2) -> np.ndarray:
    """The float `count` steps from x towards `way`."""
    with np.errstate(all="ignore"):
        for _ in range(count):
            x = np.nextafter(x, way)
    return x


def random_intervals(seed: int, *shape: int, centre: float = 1.0, radius: float = 1.0) -> Interval:
    rng = np.random.default_rng(seed)
    return around(centre * rng.standard_normal(shape), radius * rng.random(shape))


# ---- the four operations --------------------------------------------------------------------------------------------


@OPERATIONS
def test_an_operation_on_points_holds_the_exact_result_and_little_else(operation):
    x, y = PAIRS[PAIRS[:, 1] != 0].T if operation is QUOTIENT else PAIRS.T
    result = operation(exact(x), exact(y))
    truths = [operation(Fraction(a), Fraction(b)) for a, b in zip(x, y, strict=True)]
    assert holds(result, truths).all()
    with np.errstate(all="ignore"):
        nearest = operation(x, y)
    # one step to each side, two for the smallest normal numbers; an overflow leaves [largest float, inf]
    assert np.all(result.low >= steps(nearest, -INF))
    assert np.all(result.high <= steps(nearest, INF))
    ends = np.sort(np.abs([result.low, result.high]), axis=0)[:, np.isinf(nearest)]
    assert np.all(ends == [[MAX], [INF]])


@OPERATIONS
def test_an_operation_on_intervals_holds_the_result_of_every_pair_of_ends_and_has_no_end_beyond(operation):
    ends = np.array([-MAX, -3.0, -1e-200, -TINY, 0.0, TINY, 1e-200, 0.7, MAX])
    intervals = [(a, b) for a, b in itertools.product(ends, ends) if a <= b]
    pairs = [(x, y) for x, y in itertools.product(intervals, intervals) if operation is not QUOTIENT or not y[0] <= 0 <= y[1]]
    (xl, xh), (yl, yh) = np.moveaxis(np.array(pairs), 0, -1)
    result = operation(Interval(xl, xh), Interval(yl, yh))
    corners = [[operation(Fraction(a), Fraction(b)) for a in x for b in y] for x, y in pairs]
    least, largest = [min(c) for c in corners], [max(c) for c in corners]
    assert holds(result, least).all()
    assert holds(result, largest).all()
    # two steps inward lead past the truth, and no end lies across a 0 that the truth does not cross
    assert all(float(a) >= t for a, t in zip(steps(result.low, INF), least, strict=True))
    assert all(float(b) <= t for b, t in zip(steps(result.high, -INF), largest, strict=True))
    assert np.all((result.low >= 0) == [t >= 0 for t in least])
    assert np.all((result.high <= 0) == [t <= 0 for t in largest])


def test_exact_zeros_stay_zeros():
    x = random_intervals(0, 50)
    for zero in (exact(0.0), exact(-0.0), x * 0.0, 0.0 * x, 0.0 / (abs(x) + 1.0), exact(NASTY) - exact(NASTY)):
        assert np.all(zero.low == 0)
        assert np.all(zero.high == 0)
    same = x + 0.0
    np.testing.assert_array_equal([same.low, same.high], [x.low, x.high])


def test_unbounded_intervals_follow_the_limits():
    half, line = Interval(1.0, INF), Interval(-INF, INF)
    for result, low, high in [
        (half * exact(0.0), 0.0, 0.0),  # every real times 0 is 0
        (half * Interval(0.0, 1.0), 0.0, INF),
        (line + half, -INF, INF),
        (half - half, -INF, INF),
        (-half, -INF, -1.0),
        (half / half, 0.0, INF),
        (1.0 / half, 0.0, np.nextafter(1, 2)),
        (Interval(-INF, -1.0) / half, -INF, 0.0),
        (abs(line), 0.0, INF),
        (half.sqrt(), 1 - U, INF),
    ]:
        assert (result.low, result.high) == (pytest.approx(low, rel=4 * U), pytest.approx(high, rel=4 * U))


def test_division_by_an_interval_that_holds_zero_is_refused_with_its_place():
    for low, high in ((-1.0, 0.0), (0.0, 0.0), (-0.0, 1.0), (-1.0, 2.0), (-INF, INF)):
        with pytest.raises(InputError, match=r"holds 0 at entry \(1,\)"):
            1.0 / Interval([1.0, low], [2.0, high])


def test_arrays_and_numbers_on_the_left_are_exact_operands():
    x = random_intervals(1, 3)
    for left in (2.0, 2, np.float64(2.0), np.full(3, 2.0), [2.0, 2.0, 2.0]):
        for result in (left + x, left * x, left - x, left / (x * x + 1.0)):
            assert isinstance(result, Interval)
            assert result.shape == (3,)
    np.testing.assert_array_equal((1.0 - x).low, (-(x - 1.0)).low)
    assert (np.ones((4, 1)) * x).shape == (4, 3)


# ---- functions of one interval --------------------------------------------------------------------------------------


def test_square_root_holds_the_root_within_a_step():
    x = np.array([0.0, *POSITIVE, 4.0, 2.0])
    root = exact(x).sqrt()
    assert all(Fraction(a) ** 2 <= Fraction(t) for a, t in zip(root.low, x, strict=True))
    assert all(Fraction(b) ** 2 >= Fraction(t) for b, t in zip(root.high, x, strict=True))
    assert np.all(root.low >= steps(np.sqrt(x), 0.0))
    assert np.all(root.high <= steps(np.sqrt(x), INF))
    assert (root.low[0], root.high[0]) == (0.0, 0.0)
    wide = Interval(0.25, 9.0).sqrt()
    assert wide.contains(0.5) & wide.contains(3.0)
    with pytest.raises(InputError, match=r"square root of \[-4.94066e-324, 1\] at entry"):
        Interval([0.0, -TINY], [1.0, 1.0]).sqrt()


def test_exponential_holds_that_of_flint_down_to_underflow_and_up_to_overflow():
    rng = np.random.default_rng(2)
    x = np.concatenate(
        [rng.uniform(-760, 712, 3000), rng.uniform(-1, 1, 1000), [0.0, TINY, 709.782712893384, -708.3964185322641]]
    )
    result = exact(x).exp()
    with flint.ctx.workprec(200):
        for low, high, t in zip(result.low, result.high, x, strict=True):
            truth = flint.arb(float(t)).exp()
            assert flint.arb(float(low)) < truth
            assert truth < flint.arb(float(high))
    normal = (x > -708) & (x < 709.7)
    assert np.all(result.width[normal] <= 24 * U * np.exp(x[normal]))
    both = Interval(-1.0, 2.0).exp()
    assert both.contains(1 / np.e) & both.contains(np.exp(2.0)) & ~both.contains(0.36) & ~both.contains(7.4)


def test_magnitude_is_exact():
    x = Interval([-3.0, -3.0, 1.0, -1.0], [-2.0, 2.0, 4.0, 5.0])
    np.testing.assert_array_equal(abs(x).low, [2.0, 0.0, 1.0, 0.0])
    np.testing.assert_array_equal(abs(x).high, [3.0, 3.0, 4.0, 5.0])


@pytest.mark.parametrize("exponent", [0, 1, 2, 3, 4, 5, 7, 10])
def test_a_power_is_the_range_of_the_power_not_of_the_product(exponent):
    rng = np.random.default_rng(exponent)
    ends = np.sort(
        np.concatenate([rng.standard_normal((100, 2)), [[-1.0, 2.0], [-2.0, 1.0], [0.0, 1e-100], [-1e-300, TINY]]]), axis=1
    )
    result = Interval(ends[:, 0], ends[:, 1]) ** exponent
    for n, (a, b) in enumerate(ends):
        truths = [Fraction(t) ** exponent for t in (a, b, *([0.0] if a <= 0 <= b else []))]
        assert result.low[n] <= min(truths)
        assert result.high[n] >= max(truths)
        for end, t in ((result.low[n], min(truths)), (result.high[n], max(truths))):
            assert abs(Fraction(end) - t) <= 4 * exponent * U * abs(t) + Fraction(4 * exponent) * Fraction(TINY)
        assert exponent % 2 or result.low[n] >= 0


def test_a_negative_power_divides():
    x = Interval(2.0, 4.0) ** -2
    assert x.contains(1 / 16) & x.contains(1 / 4)
    assert x.width < 0.1875 * (1 + 1e-14)
    with pytest.raises(InputError, match="holds 0"):
        Interval(-1.0, 2.0) ** -1
    with pytest.raises(InputError, match=r"power 0\.5"):
        Interval(1.0, 2.0) ** 0.5  # type: ignore[operator]


@pytest.mark.parametrize("n", [0, 1, 2, 3, 7, 64, 1001])
def test_a_sum_holds_the_exact_sum_also_when_it_cancels(n):
    rng = np.random.default_rng(n)
    x = rng.standard_normal((2, n)) * 10.0 ** rng.integers(-300, 300, (2, n))
    x[:, n // 2 :] = -x[:, : n - n // 2] * (1 + 2 * U)
    total = Interval(x, np.nextafter(x, INF)).sum()
    assert total.shape == (2,)
    for row in range(2):
        assert total.low[row] <= sum(map(Fraction, x[row]), Fraction(0))
        assert total.high[row] >= sum(map(Fraction, np.nextafter(x[row], INF)), Fraction(0))
        assert total.width[row] <= (2 * np.log2(n + 1) + 4) * 4 * U * np.abs(x[row]).sum()


def test_a_sum_runs_along_the_axis_asked_for():
    x = exact(np.arange(24.0).reshape(2, 3, 4))
    for axis in (0, 1, 2, -1):
        total = x.sum(axis)
        assert total.shape == x.low.sum(axis).shape
        assert np.all(total.contains(x.low.sum(axis)))
        assert total.width.max() < 1e-12


# ---- inclusion: theorem 2 -------------------------------------------------------------------------------------------

numbers = st.sampled_from([0.0, TINY, -TINY, 1.0, -1.0, 1e200, 1e-200, -1e-170, MAX]) | st.floats(-5, 5)
expressions = st.recursive(
    st.sampled_from([0, 1, 2]),
    lambda e: st.tuples(st.sampled_from("+-*/"), e, e) | st.tuples(st.sampled_from("a234"), e),
    max_leaves=8,
)


def evaluate(expression, variables, divide):
    """The value of an expression tree over floats, fractions or intervals alike."""
    if isinstance(expression, int):
        return variables[expression]
    symbol, *arguments = expression
    x, *rest = (evaluate(a, variables, divide) for a in arguments)
    if symbol == "a":
        return abs(x)
    if not rest:
        return x ** int(symbol)
    (y,) = rest
    return x + y if symbol == "+" else x - y if symbol == "-" else x * y if symbol == "*" else divide(x, y)


def over_square(x, y):
    """x / (y^2 + 1): a division that is always allowed."""
    return x / (y**2 + 1)


@pytest.mark.slow
@settings(max_examples=250)
@given(expressions, st.lists(st.lists(numbers, min_size=5, max_size=5), min_size=3, max_size=3))
def test_an_expression_of_intervals_holds_that_of_their_members_and_of_smaller_intervals(expression, drawn):
    sorted_numbers = [sorted(row) for row in drawn]
    outer = [Interval(row[0], row[4]) for row in sorted_numbers]
    inner = [Interval(row[1], row[3]) for row in sorted_numbers]
    member = [Fraction(row[2]) for row in sorted_numbers]
    small, large = evaluate(expression, inner, over_square), evaluate(expression, outer, over_square)
    assert small.subset(large)
    assert holds(small, evaluate(expression, member, over_square)).all()


@pytest.mark.slow
@settings(max_examples=300)
@given(st.sampled_from([SUM, DIFFERENCE, PRODUCT]), *[st.lists(numbers, min_size=4, max_size=4)] * 2)
def test_one_operation_is_isotonic_to_the_last_bit(operation, a, b):
    (a0, a1, a2, a3), (b0, b1, b2, b3) = sorted(a), sorted(b)
    assert operation(Interval(a1, a2), Interval(b1, b2)).subset(operation(Interval(a0, a3), Interval(b0, b3)))


# ---- centre, radius, sets -------------------------------------------------------------------------------------------


def test_centre_and_radius_hold_the_interval_and_a_point_has_radius_zero():
    low, high = (np.array(end) for end in zip(*[(a, b) for a, b in itertools.product(NASTY, NASTY) if a <= b], strict=True))
    x = Interval(low, high)
    assert np.all(x.contains(x.mid))
    for a, b, m, r, w in zip(low, high, x.mid, x.rad, x.width, strict=True):
        assert Fraction(m) - Fraction(r) <= Fraction(a)
        assert Fraction(m) + Fraction(r) >= Fraction(b)
        assert w == INF or Fraction(w) >= Fraction(b) - Fraction(a)
        assert Fraction(r) <= (Fraction(b) - Fraction(a)) * Fraction(1 + 4 * U) / 2 + Fraction(U) * abs(Fraction(m)) + Fraction(
            2 * TINY
        )
    for a, b, m, r in zip(low, high, x.mid, arithmetic._inner_radius(x, x.mid), strict=True):
        assert Fraction(a) <= Fraction(m) - Fraction(r)
        assert Fraction(m) + Fraction(r) <= Fraction(b)
    np.testing.assert_array_equal(exact(NASTY).rad, 0.0)
    np.testing.assert_array_equal(Interval(NASTY, NASTY).mid, NASTY)
    np.testing.assert_array_equal(Interval(NASTY, NASTY).width, 0.0)
    unbounded = Interval([-INF, -INF, 3.0], [INF, 2.0, INF])
    assert np.all(np.isfinite(unbounded.mid) & unbounded.contains(unbounded.mid))
    np.testing.assert_array_equal(unbounded.rad, INF)


def test_an_interval_around_a_centre_is_rounded_outward():
    centre, radius = PAIRS[PAIRS[:, 1] >= 0].T
    x = around(centre, radius)
    assert all(a <= Fraction(c) - Fraction(r) for a, c, r in zip(x.low, centre, radius, strict=True))
    assert all(b >= Fraction(c) + Fraction(r) for b, c, r in zip(x.high, centre, radius, strict=True))
    assert np.all((x.low == centre) == (radius == 0))
    assert (around(1.0, INF).low, around(1.0, INF).high) == (-INF, INF)
    for radius in (-1.0, np.nan):
        with pytest.raises(InputError, match="radius"):
            around(0.0, radius)


def test_membership_subset_hull_and_intersection():
    x, y = Interval([0.0, 0.0, 0.0], [2.0, 2.0, 2.0]), Interval([1.0, 2.0, 3.0], [3.0, 3.0, 4.0])
    np.testing.assert_array_equal(x.contains(np.array([0.0, 2.0, 2.1])), [True, True, False])
    assert not x.contains(np.nan).any()
    np.testing.assert_array_equal(x.hull(y).low, [0, 0, 0])
    np.testing.assert_array_equal(x.hull(y).high, [3, 3, 4])
    common = x.intersection(y)
    np.testing.assert_array_equal(common.empty, [False, False, True])
    np.testing.assert_array_equal(common.contains(np.array([1.5, 2.0, 2.5])), [True, True, False])
    assert not common.contains(np.inf).any()
    assert common.subset(x).all()
    assert common.subset(y).all()
    np.testing.assert_array_equal(x.subset(x.hull(y)), True)
    np.testing.assert_array_equal(x.subset(y), False)
    np.testing.assert_array_equal(Interval(0.0, 1.0).subset(Interval([0.0, 0.1, 0.0], [1.0, 1.0, 0.9])), [True, False, False])
    with pytest.raises(InputError, match=r"empty interval at entry \(2,\)"):
        common.interval()
    assert x[:2].intersection(y[:2]).interval().high.tolist() == [2.0, 2.0]


@pytest.mark.parametrize(
    ("low", "high", "problem"),
    [
        (1.0, 0.0, "no interval: low = 1, high = 0"),
        ([0.0, np.nan], [1.0, 1.0], r"low = nan.*\(1,\)"),
        (0.0, np.nan, "high = nan"),
        (INF, INF, "low = inf"),
        (-INF, -INF, "high = -inf"),
        ([0.0], 1.0, "shapes"),
        ("a", 1.0, "not real numbers"),
        (1j, 2j, "not real numbers"),
    ],
)
def test_what_is_no_interval_is_refused(low, high, problem):
    with pytest.raises(InputError, match=problem):
        Interval(low, high)


@pytest.mark.parametrize(
    "value", [2**53 + 1, 2**70 + 1, Fraction(1, 3), np.longdouble(1) / 3, INF, np.nan, "1", np.array([1, 2**60 + 1])]
)
def test_an_operand_that_is_not_a_float_exactly_is_refused(value):
    for make in (exact, lambda v: exact(1.0) + v):
        with pytest.raises(InputError):
            make(value)


def test_operands_that_are_floats_exactly_are_taken():
    for value in (2**53, -(2**53), 2**70, True, Fraction(1, 4), np.float32(0.1), np.uint64(7)):
        assert exact(value).low == value


def test_an_interval_keeps_its_numbers():
    low = np.zeros(3)
    x, y = Interval(low, np.ones(3)), exact(low)
    low[:] = 9.0
    assert x.low.max() == y.low.max() == 0.0
    with pytest.raises(ValueError, match="read-only"):
        (x + 1.0).low[0] = 5.0
    assert low.flags.writeable
    np.testing.assert_array_equal(x[1:].high, [1.0, 1.0])
    assert len(x[1:]) == 2


# ---- products of vectors --------------------------------------------------------------------------------------------


def exact_range(x: Interval, y: Interval):
    """The range of x'y by fractions: each variable occurs once, so the ends are sums of products of ends."""
    least, largest = [], []
    for xl, xh, yl, yh in zip(x.low, x.high, y.low, y.high, strict=True):
        corners = [[Fraction(a) * Fraction(b) for a in (p, q) for b in (r, s)] for p, q, r, s in zip(xl, xh, yl, yh, strict=True)]
        least.append(sum(map(min, corners), Fraction(0)))
        largest.append(sum(map(max, corners), Fraction(0)))
    return least, largest


@pytest.mark.parametrize("scale", [1.0, 1e-160, 1e154], ids=["ordinary", "underflow", "overflow"])
@pytest.mark.parametrize("radius", [0.0, 1e-16, 1.0])
def test_inner_lies_in_the_true_range_and_the_true_range_in_exact_and_outer(scale, radius):
    x, y = (random_intervals(seed, 150, 3, centre=scale, radius=radius * scale) for seed in (3, 4))
    least, largest = exact_range(x, y)
    for product in (product_exact(x, y), product_outer(x, y)):
        assert holds(product, least).all()
        assert holds(product, largest).all()
    inner = product_inner(x, y)
    for low, high, a, b in zip(inner.low, inner.high, least, largest, strict=True):
        assert low > high or a <= float(low) <= float(high) <= b


def test_a_hundred_thousand_products_keep_the_chain_and_the_ratio():
    x, y = random_intervals(5, 100_000, 2), random_intervals(6, 100_000, 2)
    inner, true, outer = product_inner(x, y), product_exact(x, y), product_outer(x, y)
    assert inner.subset(true).all()
    slack = 1e-14 * (np.abs(true.low) + np.abs(true.high))  # both are rounded outward, each by its own
    assert np.all((outer.low <= true.low + slack) & (outer.high >= true.high - slack))
    ratio = outer.width / true.width
    assert 1.10 < ratio.mean() < 1.20
    assert ratio.max() <= 1.5 * (1 + 1e-12)
    assert 0.01 < inner.empty.mean() < 0.1
    # the inner product is worth having: on average it holds more than half of the range
    assert np.mean(np.maximum(inner.high - inner.low, 0.0)[~inner.empty] / true.width[~inner.empty]) > 0.5


def test_the_outer_radius_is_one_and_a_half_times_the_true_one_at_worst():
    # [0, 2] [0, 2] = [0, 4]; by midpoint and radius 1 +- 3
    square = Interval([0.0], [2.0])
    outer, inner = product_outer(square, square), product_inner(square, square)
    assert (outer.low, outer.high) == (pytest.approx(-2.0), pytest.approx(4.0))
    assert (inner.low, inner.high) == (pytest.approx(0.0, abs=1e-15), pytest.approx(2.0))
    empty = product_inner(Interval([-1.0], [1.0]), Interval([-1.0], [1.0]))
    assert empty.empty


def test_equation_seven_as_printed_with_plus_is_a_bound_for_one_product_in_five():
    # Shahriari, Tarasiewicz, Adrot 2008, equation (7), last sign of the lower bound: plus holds for about 19 % of products
    x, y = random_intervals(7, 100_000, 1), random_intervals(8, 100_000, 1)
    truth = product_exact(x, y).low
    plus, minus = product_inner(x, y), product_outer(x, y)
    as_printed = np.sum(x.mid * y.mid - np.abs(x.mid) * y.rad - x.rad * np.abs(y.mid) + x.rad * y.rad, axis=-1)
    assert 0.15 < np.mean(as_printed <= truth) < 0.25
    assert np.all(plus.empty | (plus.low >= truth))
    assert np.all(minus.low <= truth + 1e-14 * (1 + np.abs(truth)))


def test_products_of_exact_vectors_have_three_nearly_equal_answers():
    x, y = np.random.default_rng(9).standard_normal((2, 20, 5))
    size = np.sum(np.abs(x * y), axis=-1)
    for product in (product_exact(x, y), product_outer(x, y)):
        assert np.all(product.width <= 16 * U * size)
    assert np.all(product_inner(x, y).empty)  # rounded inward there is nothing between two floats


def test_products_with_an_unbounded_entry_hold_every_member():
    x, y = Interval([[1.0, 0.0]], [[INF, 0.0]]), Interval([[-1.0, -INF]], [[2.0, INF]])
    for product in (product_exact(x, y), product_outer(x, y)):
        assert (product.low[0], product.high[0]) == (-INF, INF)
    positive = product_exact(Interval([1.0], [INF]), Interval([1.0], [2.0]))
    assert (positive.low, positive.high) == (pytest.approx(1.0), INF)
    inner = product_inner(Interval([1.0], [INF]), Interval([1.0], [2.0]))
    assert inner.empty | ((inner.low >= 1.0) & (inner.high <= INF))


# ---- products of matrices -------------------------------------------------------------------------------------------


def assert_matmul_holds(A: Interval, B: Interval) -> None:
    """Entry by entry against the range in fractions."""
    product = matmul(A, B)
    for i in range(A.shape[0]):
        rows = A[np.full(B.shape[1], i)]
        columns = Interval(B.low.T, B.high.T)
        least, largest = exact_range(rows, columns)
        assert holds(product[i], least).all()
        assert holds(product[i], largest).all()


@pytest.mark.parametrize("radius", [0.0, 1e-16, 1e-3, 1.0])
@pytest.mark.parametrize("scale", [1.0, 1e-155, 1e-162, 1e153])
def test_a_matrix_product_holds_every_product_of_members(scale, radius):
    A, B = (random_intervals(s, 4, 6, centre=scale, radius=radius * scale) for s in (10, 11))
    B = Interval(B.low.T, B.high.T)
    assert_matmul_holds(A, B)
    assert_matmul_holds(exact(A.mid), B)
    assert_matmul_holds(A, exact(B.mid))


def test_a_matrix_product_survives_the_worst_scales_within_one_sum():
    rng = np.random.default_rng(12)
    A = rng.choice(NASTY[np.abs(NASTY) < 1e250], (5, 7))
    B = rng.choice(NASTY[np.abs(NASTY) < 1e50], (7, 4))
    assert_matmul_holds(exact(A), exact(B))
    assert_matmul_holds(around(A, np.abs(A) * 1e-10 + TINY), around(B, np.abs(B) * 1e-10 + TINY))
    # every one of the three products underflows to 0, and together they are worth one and a half smallest numbers per term
    a, b = 1e-162, 0.49 * (TINY * 1e162)
    assert a * b == 0.0 < b
    assert_matmul_holds(around(np.full((1, 60), a), a / 2), around(np.full((60, 1), b), b))
    # a huge entry against the smallest number: an underflow in the bound itself would cost a visible amount
    assert_matmul_holds(exact(np.array([[1e308, 1.0]])), around(np.array([[TINY], [0.0]]), np.array([[TINY], [0.0]])))


@pytest.mark.parametrize("n", [1, 2, 7, 40])
def test_the_bound_of_an_exact_product_is_gamma_n_and_hardly_more(n):
    # |fl(AB) - AB| <= gamma_n |A||B|: no observed error shows that the constant is right, so it is asked for itself
    A, B = np.random.default_rng(n).standard_normal((2, 3, n, n))[..., :3, :, :] if n > 1 else np.full((2, 3, 1, 1), 1 / 3)
    product, size = matmul(A, B), np.abs(A) @ np.abs(B)
    radius = product.width / 2
    assert np.all(radius >= n * U / (1 - n * U) * size * (1 - 4 * n * U))
    assert np.all(radius <= (n + 8) * U * size)


def test_rounding_errors_that_all_fall_to_one_side_stay_within():
    # 1 + u + u + ...: each sum is rounded back to 1 wherever the library adds it to the 1
    n = 4096
    x = np.full((1, n), U)
    x[0, 0] = 1.0
    for product in (matmul(x, np.ones((n, 1)))[0], dot(x, np.ones(n)), matmul(exact(x), around(np.ones((n, 1)), U))[0]):
        assert holds(product, [1 + Fraction(U) * (n - 1)]).all()
    # the same in the radius: A Br = 1 + (n - 1) u exactly, next to a centre of 0
    B = Interval(np.full((n, 1), -1.0), np.ones((n, 1)))
    for product in (matmul(x, B), matmul(Interval(-x, x), np.ones((n, 1)))):
        assert product.high[0, 0] >= 1 + Fraction(U) * (n - 1)
        assert product.low[0, 0] <= -(1 + Fraction(U) * (n - 1))


@pytest.mark.slow
@pytest.mark.parametrize("n", [3, 10, 30])
def test_radii_are_those_of_flint(n):
    A, B = (random_intervals(s, n, n, radius=1e-3) for s in (13, 14))
    with flint.ctx.workprec(53):
        balls = [
            flint.arb_mat(
                [[flint.arb(float(m), float(r)) for m, r in zip(*row, strict=True)] for row in zip(x.mid, x.rad, strict=True)]
            )
            for x in (A, B)
        ]
        product = balls[0] * balls[1]
        radii = np.array([[float(product[i, j].rad()) for j in range(n)] for i in range(n)])
    ours = matmul(A, B)
    np.testing.assert_allclose(ours.rad, radii, rtol=1e-3)
    assert_matmul_holds(A, B)


def test_overflow_and_unbounded_entries_give_the_whole_line_and_only_where_they_meet():
    huge = matmul(np.array([[1e200, 1e200]]), np.array([[1e200, 1.0], [-1e200, 1.0]]))
    assert (huge.low[0, 0], huge.high[0, 0]) == (-INF, INF)  # the truth is 0
    assert huge.contains(2e200)[0, 1]
    assert np.isfinite(huge.low[0, 1])
    A = Interval([[0.0, 1.0], [0.0, 1.0]], [[INF, 1.0], [0.0, 1.0]])
    product = matmul(A, np.array([[0.0], [2.0]]))
    assert (product.low[0, 0], product.high[0, 0]) == (-INF, INF)
    assert product[1, 0].contains(2.0)
    assert product[1, 0].width < 1e-14
    wide = matmul(np.array([[1.0]]), Interval([[-MAX]], [[MAX]]))
    assert wide.low[0, 0] <= -MAX
    assert wide.high[0, 0] >= MAX


def test_matrix_products_stack_and_refuse_shapes_that_do_not_fit():
    A, B = random_intervals(15, 5, 1, 2, 3), random_intervals(16, 4, 3, 2)
    product = A @ B
    assert product.shape == (5, 4, 2, 2)
    one = matmul(A[2, 0], B[3])
    np.testing.assert_allclose(product[2, 3].low, one.low, rtol=1e-13)
    assert isinstance(np.ones((2, 2)) @ A, Interval)
    for left, right in ((np.ones((2, 3)), np.ones((2, 3))), (np.ones(3), np.ones((3, 1)))):
        with pytest.raises(InputError, match="matrix product of"):
            matmul(left, right)


@pytest.mark.parametrize("scale", [1.0, 1e-162, 1e150])
def test_dot_bounds_the_exact_product_of_each_row(scale):
    rng = np.random.default_rng(17)
    X, c = rng.standard_normal((60, 9)) * scale, rng.standard_normal(9) * scale
    X[::2, -1] = -(X[::2, :-1] @ c[:-1]) / c[-1] if scale != 1e-162 else 0.0  # heavy cancellation
    truths = [sum((Fraction(a) * Fraction(b) for a, b in zip(row, c, strict=True)), Fraction(0)) for row in X]
    product = dot(X, c)
    assert product.shape == (60,)
    assert holds(product, truths).all()
    assert np.all(product.width <= 2.2 * 13 * U * (np.abs(X) @ np.abs(c)) + 30 * TINY)
    x, wide = around(X, np.abs(X) / 8), around(c, np.abs(c) / 8)
    for rows, vector in ((x, wide), (exact(X), wide), (x, exact(c))):
        least, largest = exact_range(rows, vector[None][np.zeros(60, int)])
        assert holds(dot(rows, vector), least).all()
        assert holds(dot(rows, vector), largest).all()


# ---- positive definite ----------------------------------------------------------------------------------------------


def leading_minors_are_positive(A) -> bool:
    """Sylvester's criterion in exact fractions."""
    n = len(A)
    matrix = flint.fmpq_mat(n, n, [flint.fmpq(f.numerator, f.denominator) for f in fractions(A).ravel()])
    return all(flint.fmpq_mat(k, k, [matrix[i, j] for i in range(k) for j in range(k)]).det() > 0 for k in range(1, n + 1))


def pascal(n: int) -> np.ndarray:
    """Binomial coefficients as a symmetric matrix; its determinant is 1, and 0 with 1 taken off the last entry."""
    A = np.ones((n, n))
    for i, j in itertools.product(range(1, n), range(1, n)):
        A[i, j] = A[i - 1, j] + A[i, j - 1]
    return A


@pytest.mark.parametrize("n", range(2, 16))
def test_pascals_matrix_is_definite_until_one_is_taken_off_its_last_entry(n):
    A = pascal(n)
    assert positive_definite(A) or n > 8  # the proof needs a condition number below about 1/(n^2 u)
    A[-1, -1] -= 1.0
    assert not positive_definite(A)


def test_singular_integer_matrices_are_never_proved():
    # V V' with fewer columns than rows is singular exactly; Cholesky without a shift passes many of them
    rng = np.random.default_rng(18)
    for n in (2, 3, 5, 9):
        V = rng.integers(-30, 31, (400, n, n - 1)).astype(float)
        singular = V @ V.swapaxes(1, 2)
        assert np.array_equal(singular, singular.swapaxes(1, 2))
        assert not positive_definite(singular).any()
        bare = arithmetic._cholesky_ends(np.moveaxis(singular.copy(), 0, -1))
        assert bare.any() or n == 2  # the shift is what refuses them
        assert positive_definite(singular + np.eye(n)).all()


@pytest.mark.parametrize("relative", [-1e-3, -1e-10, -1e-14, -1e-16, 1e-16, 1e-14, 1e-12, 1e-3])
def test_a_proof_agrees_with_exact_minors_near_the_edge(relative):
    rng = np.random.default_rng(19)
    Q = np.linalg.qr(rng.standard_normal((60, 4, 4)))[0]
    A = (Q * np.array([relative, 0.3, 0.7, 1.0])) @ Q.swapaxes(1, 2)
    A = (A + A.swapaxes(1, 2)) / 2
    proved = positive_definite(A)
    assert all(leading_minors_are_positive(a) for a in A[proved])
    assert not proved[[not leading_minors_are_positive(a) for a in A]].any()
    if abs(relative) >= 1e-12:
        np.testing.assert_array_equal(proved, relative > 0)


def test_the_shift_is_at_least_the_error_of_cholesky():
    # no matrix at hand shows the worst rounding, so the constant is asked for itself: (n + 1) u trace; here the trace is n - 1
    for n in (2, 5, 20):
        for t, expected in ((1 - (n + 1) * (n - 1) * U, False), (1 - 3 * (n + 8) * n * U, True)):
            A = np.full((n, n), -t / n) + np.eye(n)  # smallest eigenvalue 1 - t
            assert positive_definite(A) == expected


def test_scaling_by_any_diagonal_changes_nothing():
    rng = np.random.default_rng(20)
    V = rng.standard_normal((100, 5, 5))
    A = V @ V.swapaxes(1, 2) + 0.1 * np.eye(5)
    A = (A + A.swapaxes(1, 2)) / 2
    D = 2.0 ** rng.integers(-480, 480, (100, 5))
    assert positive_definite(D[:, :, None] * A * D[:, None, :]).all()
    np.testing.assert_array_equal(positive_definite(np.diag([1e300, TINY])), True)
    np.testing.assert_array_equal(positive_definite(np.diag([1e300, -TINY])), False)
    V[:, :, -1] = 0.0
    V = np.round(8 * V)
    singular = D[:, :, None] * (V @ V.swapaxes(1, 2)) * D[:, None, :]
    assert not positive_definite(singular).any()
    # a radius that is small by its size but not beside its own row
    assert not positive_definite(around(np.diag([1.0, 1e-20]), np.diag([0.0, 2e-20])))
    assert positive_definite(around(np.diag([1.0, 1e-20]), np.diag([0.0, 0.9e-20])))


def test_matrices_that_are_plainly_not_definite_are_not_proved():
    for A in (
        np.zeros((2, 2)),
        -np.eye(3),
        [[1.0, 2.0], [2.0, 1.0]],
        [[0.0, 1.0], [1.0, 0.0]],
        [[1.0, MAX], [MAX, 1.0]],
        [[-TINY]],
    ):
        assert not positive_definite(A)
    assert not positive_definite(Interval([[1.0, -INF], [-INF, 1.0]], [[1.0, INF], [INF, 1.0]]))
    assert not positive_definite(Interval([[1.0]], [[INF]]) - 1.0)
    assert positive_definite([[TINY]])
    assert positive_definite(np.zeros((0, 0)))
    for A, problem in (
        ([[1.0, 0.1], [0.0, 1.0]], r"not symmetric at entry \(0, 1\)"),
        (np.ones((2, 3)), "shape"),
        (np.ones(2), "shape"),
    ):
        with pytest.raises(InputError, match=problem):
            positive_definite(A)


@pytest.mark.slow
def test_an_interval_matrix_is_proved_only_if_its_worst_members_are_definite():
    # n 1 +- r J: the worst member n 1 - r J has the eigenvalue n (1 - r)
    for n in (2, 4, 9):
        assert positive_definite(around(n * np.eye(n), np.full((n, n), 1 - 1e-12)))
        assert not positive_definite(around(n * np.eye(n), np.full((n, n), 1.0)))
    # all worst members Am - diag(z) Ar diag(z), z = +-1, of 3x3 matrices, in fractions
    rng = np.random.default_rng(21)
    proved = 0
    for _ in range(60):
        V, R = rng.standard_normal((3, 3)), rng.random((3, 3)) * 0.3
        mid, rad = np.round(64 * (V @ V.T + V.T @ V)) / 128, np.round(64 * (R + R.T)) / 128
        mid = (mid + mid.T) / 2
        worst = [mid - np.outer(z, z) * rad for z in itertools.product([-1.0, 1.0], repeat=3)]
        if positive_definite(around(mid, rad)):
            proved += 1
            assert all(leading_minors_are_positive(member) for member in worst)
    assert 10 < proved < 58


def test_only_symmetric_members_count():
    lopsided = Interval([[1.0, -5.0], [-0.1, 1.0]], [[1.0, 0.1], [5.0, 1.0]])  # symmetric members: off-diagonal within 0.1
    assert positive_definite(lopsided)


def test_a_batch_is_its_matrices_one_by_one():
    rng = np.random.default_rng(22)
    V = rng.standard_normal((6, 50, 4, 4))
    A = V @ V.swapaxes(-1, -2) - 0.05 * np.eye(4)
    A = (A + A.swapaxes(-1, -2)) / 2
    proved = positive_definite(A)
    assert proved.shape == (6, 50)
    assert 0.2 < proved.mean() < 0.98
    for i, j in np.ndindex(6, 50):
        assert positive_definite(A[i, j]) == proved[i, j]
    np.testing.assert_array_equal(proved, np.linalg.eigvalsh(A)[..., 0] > 1e-12)


# ---- speed ----------------------------------------------------------------------------------------------------------


def fastest(action, repeats: int = 7) -> float:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return min(times)


@pytest.mark.bench
def test_a_million_sums_take_about_ten_times_the_bare_ones():
    x, y = random_intervals(23, 1_000_000), random_intervals(24, 1_000_000)
    assert fastest(lambda: x + y) < 15 * fastest(lambda: (x.low + y.low, x.high + y.high))


@pytest.mark.bench
def test_a_batch_of_proofs_takes_a_few_times_its_eigenvalues():
    V = np.random.default_rng(25).standard_normal((24_192, 9, 9))
    A = V @ V.swapaxes(1, 2)
    A = (A + A.swapaxes(1, 2)) / 2
    assert fastest(lambda: positive_definite(A), 3) < 3 * fastest(lambda: np.linalg.eigvalsh(A), 3)
