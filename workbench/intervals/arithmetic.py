"""Interval arithmetic with outward rounding: what is computed encloses what is true, whatever the rounding did.

    [x] o [y] = {x o y : x in [x], y in [y]}      for o in +, -, *, /                     (in exact arithmetic)
    the result's ends are rounded outward, so that it holds this set

It is inclusion isotonic: of [x] within [x'], [y] within [y'], [x] o [y] lies within [x'] o [y'], rounding included.

IEEE 754 rounds +, -, *, / and sqrt to the nearest number, so the neighbour on the far side of a rounded end is a bound [1].
The matrix library sums in any order and fuses multiply and add: its products are enclosed by midpoint and radius with
an error bound that holds for every order of summation [2, 3], never by the neighbour of what it returns. (A fast matrix
product after Strassen would break this bound; the usual libraries have none.) Floats and arrays mixed with intervals
count as exact.

Relied on: round to nearest and gradual underflow (the state in which every process starts).

[1] Rump, Zimmermann, Boldo, Melquiond: Computing predecessor and successor in rounding to nearest, BIT 49 (2009).
[2] Rump: Fast and parallel interval arithmetic, BIT 39 (1999).
[3] Higham: Accuracy and stability of numerical algorithms, 2nd ed., section 3.1 and theorem 10.3.
[4] Rump: Verification of positive definiteness, BIT 46 (2006).
[5] Shahriari, Tarasiewicz, Adrot 2008: linear time-varying models with interval parameters.
"""

import numpy as np

from workbench.errors import InputError
from workbench.records import record

U = 2.0**-53  # largest relative error of one rounding
PHI = U * (1.0 + 2.0 * U)
ETA = 2.0**-1074  # smallest positive number; an underflow errs by half of it
NORMAL = 2.0**-1022  # smallest number with all its digits
MAX = np.finfo(float).max
LONGEST = 2**26  # longest sum for which the error bounds below hold: they need 2 n^2 u <= 1

_quiet = np.errstate(all="ignore")  # overflow and 0 * inf are expected here, and dealt with where they occur


# ---- rounding -------------------------------------------------------------------------------------------------------


def _below(x: np.ndarray) -> np.ndarray:
    """At most the float before x: x - (phi |x| + eta); +inf, the overflow of a finite number, falls to the largest float."""
    step = _step(x)
    np.subtract(x, step, out=step)
    return np.fmin(step, MAX, out=step)  # [1] algorithm 2.1; fmin also takes the NaN of inf - inf to MAX


def _above(x: np.ndarray) -> np.ndarray:
    """At least the float after x; -inf rises to the least finite float."""
    step = _step(x)
    np.add(x, step, out=step)
    return np.fmax(step, -MAX, out=step)


def _step(x: np.ndarray) -> np.ndarray:
    """phi |x| + eta, in one array: a million entries are bound by memory, not by arithmetic."""
    step = np.asarray(np.abs(x))
    step *= PHI
    step += ETA
    return step


def _sum_below(s: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """A lower bound of a + b for s = fl(a + b); s itself where the sum is known to be exact or 0 (a + b = 0 only if a = -b)."""
    bound = _below(s)
    np.copyto(bound, s, where=np.asarray(exact | (s == 0)))
    return bound


def _sum_above(s: np.ndarray, exact: np.ndarray) -> np.ndarray:
    bound = _above(s)
    np.copyto(bound, s, where=np.asarray(exact | (s == 0)))
    return bound


@_quiet
def _add_down(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return _sum_below(np.asarray(a + b), (a == 0) | (b == 0))


@_quiet
def _add_up(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return _sum_above(np.asarray(a + b), (a == 0) | (b == 0))


# ---- intervals ------------------------------------------------------------------------------------------------------


@record
class Interval:
    """[low, high] = {x : low <= x <= high}, entry by entry: two float arrays of one shape (any), low <= high.

    An end may be infinite (the interval is unbounded); no interval is empty or holds NaN. Operators take intervals, arrays and
    numbers of shapes that broadcast; arrays and numbers are exact. Every result encloses the set of true results.
    Raises InputError for ends that are empty, NaN, of two shapes, or not floats exactly.
    """

    low: np.ndarray
    high: np.ndarray

    __array_ufunc__ = None  # array + interval is ours, not numpy's

    def __post_init__(self):
        low, high = _floats(self.low, "low"), _floats(self.high, "high")
        if low.shape != high.shape:
            raise InputError(f"interval of shapes {low.shape} and {high.shape}", mend="give low and high of one shape")
        # NaN compares false with everything, so the test is written to fail on it
        bad = ~((low <= high) & (low < np.inf) & (high > -np.inf))
        if bad.any():
            raise InputError(
                f"no interval: low = {low[bad][0]:g}, high = {high[bad][0]:g}{_at(bad)}",
                mend="low <= high, both numbers; -inf only as low, inf only as high",
            )
        object.__setattr__(self, "low", _frozen(low.copy()))
        object.__setattr__(self, "high", _frozen(high.copy()))

    # ---- arithmetic ---------------------------------------------------------------------------------------------

    @_quiet
    def __add__(self, other) -> "Interval":
        """{x + y}; adding [0, 0] changes nothing."""
        other = _interval(other)
        # one end that is 0 must not count as exact: a smaller interval's end, barely above it, would be rounded below it
        zero = self._is_zero | other._is_zero
        low, high = np.asarray(self.low + other.low), np.asarray(self.high + other.high)
        return _made(_sum_below(low, zero), _sum_above(high, zero))

    __radd__ = __add__

    def __neg__(self) -> "Interval":
        return _made(-self.high, -self.low)

    def __sub__(self, other) -> "Interval":
        return self + -_interval(other)

    def __rsub__(self, other) -> "Interval":
        return -self + other

    @_quiet
    def __mul__(self, other) -> "Interval":
        """{x y}: the least and the largest of the products of the ends; 0 times an infinite end is 0."""
        other = _interval(other)
        products = [np.asarray(p * q) for p in self._ends for q in other._ends]
        zero = self._is_zero | other._is_zero
        return _from_corners(products, _same_sign(self, other) | zero, _same_sign(-self, other) | zero)

    __rmul__ = __mul__

    @_quiet
    def __truediv__(self, other) -> "Interval":
        """{x / y}; raises InputError where [y] holds 0: an unbounded quotient would only hide the mistake."""
        other = _interval(other)
        if (bad := other.contains(0.0)).any():
            raise InputError(f"division by an interval that holds 0{_at(bad)}", mend="split the divisor at 0 or bound it away")
        quotients = [np.asarray(p / q) for p in self._ends for q in other._ends]
        return _from_corners(quotients, _same_sign(self, other), _same_sign(-self, other))

    def __rtruediv__(self, other) -> "Interval":
        return _interval(other) / self

    def __pow__(self, exponent: int) -> "Interval":
        """{x^n} for a whole number n, tight: x^2 of [-1, 2] is [0, 4]; a negative n divides, so [x] must not hold 0."""
        if not isinstance(exponent, int | np.integer):
            raise InputError(f"power {exponent!r} of an interval", mend="give a whole number")
        if exponent < 0:
            return 1.0 / self**-exponent
        if exponent % 2 == 0:
            return _power(abs(self), exponent)
        # x = p - q with p, q >= 0 and one of them 0 at each end, so that p^n - q^n loses nothing
        positive = _made(np.maximum(self.low, 0.0), np.maximum(self.high, 0.0))
        negative = _made(np.maximum(-self.high, 0.0), np.maximum(-self.low, 0.0))
        return _power(positive, exponent) - _power(negative, exponent)

    def __abs__(self) -> "Interval":
        """{|x|}, without rounding."""
        least = np.maximum(np.maximum(self.low, -self.high), 0.0)
        return _made(least, np.maximum(-self.low, self.high))

    @_quiet
    def sqrt(self) -> "Interval":
        """{sqrt x}; raises InputError where [x] reaches below 0."""
        if (bad := self.low < 0).any():
            raise InputError(f"square root of [{self.low[bad][0]:g}, {self.high[bad][0]:g}]{_at(bad)}", mend="low >= 0")
        low, high = np.sqrt(self.low), np.sqrt(self.high)
        return _made(np.maximum(_below(low), 0.0), np.where(high == 0, 0.0, _above(high)))

    @_quiet
    def exp(self) -> "Interval":
        """{e^x}. The one function here that trusts a library: numpy's exp is taken to err by at most 4 units in the last place.

        That is what numpy's own tests hold it to; IEEE 754 demands nothing. Below the normal range no relative error is
        assumed at all.
        """
        low, high = np.exp(self.low), np.exp(self.high)
        low = np.where(low < 2 * NORMAL, 0.0, np.fmin(low, MAX) * (1.0 - 10.0 * U))  # 4 units are at most 8 u, 10 u is rounded
        return _made(low, np.maximum(high * (1.0 + 10.0 * U), 2 * NORMAL))

    def sum(self, axis: int = -1) -> "Interval":
        """{sum of x along an axis}: pairs, pairs of pairs, and so on, each sum rounded outward."""
        x = _made(np.moveaxis(self.low, axis, 0), np.moveaxis(self.high, axis, 0))
        if len(x) == 0:
            return exact(np.zeros(x.shape[1:]))
        while len(x) > 1:
            half = len(x) // 2
            pairs, rest = x[:half] + x[half : 2 * half], x[2 * half :]
            x = _made(np.concatenate([pairs.low, rest.low]), np.concatenate([pairs.high, rest.high]))
        return x[0]

    def __matmul__(self, other) -> "Interval":
        return matmul(self, other)

    def __rmatmul__(self, other) -> "Interval":
        return matmul(other, self)

    # ---- numbers of an interval -------------------------------------------------------------------------------------

    @property
    @_quiet
    def mid(self) -> np.ndarray:
        """A finite float within the interval, its centre up to rounding; of an unbounded interval any."""
        if self.low is self.high:
            return self.low
        halves = self.low / 2 + self.high / 2  # the sum of the ends may overflow, that of their halves does not
        return np.clip(np.nan_to_num(halves, nan=0.0), self.low, self.high)  # the halves of tiny numbers round

    @property
    def rad(self) -> np.ndarray:
        """A radius with which mid +- rad encloses the interval; 0 only for a point, inf for an unbounded interval."""
        mid = self.mid
        return np.maximum(_add_up(self.high, -mid), _add_up(mid, -self.low))

    @property
    def width(self) -> np.ndarray:
        """high - low, rounded up."""
        return _add_up(self.high, -self.low)

    @property
    def shape(self) -> tuple[int, ...]:
        return self.low.shape

    def __len__(self) -> int:
        return len(self.low)

    def __getitem__(self, index) -> "Interval":
        low = self.low[index]
        return _made(low, low if self.low is self.high else self.high[index])

    # ---- sets -------------------------------------------------------------------------------------------------------

    def contains(self, x: np.ndarray | float) -> np.ndarray:
        """Whether low <= x <= high, entry by entry; false for NaN."""
        return np.asarray((self.low <= x) & (x <= self.high))

    def subset(self, other: "Interval") -> np.ndarray:
        """Whether the interval lies within `other`, entry by entry."""
        return np.asarray((other.low <= self.low) & (self.high <= other.high))

    def hull(self, other) -> "Interval":
        """The smallest interval that holds both."""
        other = _interval(other)
        return _made(np.minimum(self.low, other.low), np.maximum(self.high, other.high))

    def intersection(self, other) -> "PossiblyEmpty":
        """The numbers in both; there may be none."""
        other = _interval(other)
        return PossiblyEmpty(np.maximum(self.low, other.low), np.minimum(self.high, other.high))

    # ---- within -----------------------------------------------------------------------------------------------------

    @property
    def _ends(self) -> tuple[np.ndarray, ...]:
        return (self.low,) if self.low is self.high else (self.low, self.high)

    @property
    def _is_zero(self) -> np.ndarray:
        return (self.low == 0) & (self.high == 0)


@record
class PossiblyEmpty:
    """{x : low <= x <= high}, entry by entry, where an entry with low > high holds nothing (stored as low = inf, high = -inf)."""

    low: np.ndarray
    high: np.ndarray

    def __post_init__(self):
        low, high = _floats(self.low, "low"), _floats(self.high, "high")
        holds = low <= high
        object.__setattr__(self, "low", _frozen(np.where(holds, low, np.inf)))
        object.__setattr__(self, "high", _frozen(np.where(holds, high, -np.inf)))

    @property
    def empty(self) -> np.ndarray:
        return self.low > self.high

    def contains(self, x: np.ndarray | float) -> np.ndarray:
        return np.asarray((self.low <= x) & (x <= self.high))

    def subset(self, other: Interval) -> np.ndarray:
        """Whether it lies within `other`, entry by entry; nothing lies within everything."""
        return np.asarray((other.low <= self.low) & (self.high <= other.high))

    def interval(self) -> Interval:
        """The same as an interval; raises InputError where it is empty."""
        if self.empty.any():
            raise InputError(f"empty interval{_at(self.empty)}", mend="ask `empty` first")
        return Interval(self.low, self.high)


def exact(x) -> Interval:
    """[x, x]; raises InputError for what is no finite float: NaN, inf, a whole number or fraction that would be rounded."""
    return _interval(np.array(x))


def around(centre, radius) -> Interval:
    """[centre - radius, centre + radius], rounded outward; radius >= 0, inf for an interval that is not bounded."""
    centre, radius = np.asarray(_interval(centre).low), _floats(radius, "radius")
    if not np.all(radius >= 0):
        raise InputError(f"radius {radius[~(radius >= 0)].flat[0]:g}", mend="a radius is a number >= 0")
    return _made(_add_down(centre, -radius), _add_up(centre, radius))


def _made(low, high) -> Interval:
    """An interval whose ends are known to be right: neither checked nor copied."""
    interval = object.__new__(Interval)
    view = _frozen(np.asarray(low))
    object.__setattr__(interval, "low", view)
    object.__setattr__(interval, "high", view if high is low else _frozen(np.asarray(high)))
    return interval


def _frozen(array: np.ndarray) -> np.ndarray:
    view = array.view()
    view.setflags(write=False)
    return view


def _interval(x) -> Interval:
    """An operand as an interval; numbers and arrays are points."""
    if isinstance(x, Interval):
        return x
    point = _floats(x, "number")
    if not (finite := np.isfinite(point)).all():
        raise InputError(f"{point[~finite].flat[0]} is no number{_at(~finite)}", mend="an exact operand is finite")
    return _made(point, point)


def _floats(x, name: str) -> np.ndarray:
    """x as float64, refused where that would round it."""
    array = np.asarray(x)
    if array.dtype.kind not in "iufbO":
        raise InputError(f"{name}: not real numbers (type {array.dtype})", mend="give floats")
    try:
        floats = array.astype(float, copy=False)
    except (TypeError, ValueError, OverflowError) as reason:
        raise InputError(f"{name}: not real numbers ({reason})", mend="give floats") from None
    if array.dtype.kind in "iu":
        rounded = (array > 2**53) | (array < -(2**53))  # comparing an integer array with floats would itself round
    elif array.dtype.kind in "fb":
        rounded = np.asarray((floats != array) & (array == array))  # NaN is not rounded
    else:
        rounded = np.asarray(floats != array, dtype=bool)
    if rounded.any():
        raise InputError(f"{name}: {array[rounded].flat[0]} is not a float64{_at(rounded)}", mend="enclose it, or round it first")
    return floats


def _at(bad: np.ndarray) -> str:
    """The place of the first bad entry, for a message."""
    return f" at entry {tuple(int(i) for i in np.argwhere(bad)[0])}" if bad.ndim else ""


def _same_sign(x: Interval, y: Interval) -> np.ndarray:
    """Whether x y >= 0 for all of them."""
    return ((x.low >= 0) & (y.low >= 0)) | ((x.high <= 0) & (y.high <= 0))


def _from_corners(corners: list[np.ndarray], nonnegative: np.ndarray, nonpositive: np.ndarray) -> Interval:
    """The hull of rounded products or quotients of ends, rounded outward but never across a sign that is certain.

    0 * inf and inf / inf give NaN: there the products with the other ends hold the limits, and 0 is a product or a limit.
    """
    corners = [np.where(np.isnan(c), 0.0, c) if np.isnan(c).any() else c for c in corners]
    low, high = corners[0], corners[0]
    for corner in corners[1:]:
        low, high = np.minimum(low, corner), np.maximum(high, corner)
    low, high = _below(low), _above(high)
    np.maximum(low, 0.0, out=low, where=nonnegative)
    np.minimum(high, 0.0, out=high, where=nonpositive)
    return _made(low, high)


def _power(x: Interval, exponent: int) -> Interval:
    """{x^n} for x >= 0 by repeated squaring: products of the same ends, so nothing is lost to dependence."""
    if exponent == 0:
        return exact(np.ones(x.shape))
    if exponent == 1:
        return x
    half = _power(x, exponent // 2)
    return half * half * x if exponent % 2 else half * half


# ---- products of vectors --------------------------------------------------------------------------------------------


def product_exact(x, y) -> Interval:
    """{x'y : x in [x], y in [y]} = sum_i [min, max] of the four products of ends; x, y (..., n), the result (...).

    The range itself up to rounding, since every variable occurs once: outside it by no more than n roundings.
    """
    return (_interval(x) * _interval(y)).sum()


def product_outer(x, y) -> Interval:
    """xc'yc -+ (|xc|'ry + rx'|yc| + rx'ry) with centres xc, yc and radii rx, ry; x, y (..., n), the result (...).

    Holds the true range {x'y}; its radius is at most 1.5 times the range's. [5] equation (7), with minus before the last term
    of the lower bound, where the paper prints plus.
    """
    x, y = _interval(x), _interval(y)
    centre, mixed, square = _midpoint_radius(x.mid, _radius(x.rad), y.mid, _radius(y.rad))
    radius = mixed + square
    return _made((centre - radius).low, (centre + radius).high)


def product_inner(x, y) -> PossiblyEmpty:
    """xc'yc -+ (|xc|'ry + rx'|yc| - rx'ry), rounded inward; x, y (..., n), the result (...).

    Lies within the true range {x'y}: what it holds is reached by some x and y. Empty where the radius is negative.
    """
    x, y = _interval(x), _interval(y)
    xc, yc = x.mid, y.mid
    centre, mixed, square = _midpoint_radius(xc, _radius(_inner_radius(x, xc)), yc, _radius(_inner_radius(y, yc)))
    radius = mixed - square
    return PossiblyEmpty((centre - radius).high, (centre + radius).low)


def _midpoint_radius(xc: np.ndarray, rx: Interval, yc: np.ndarray, ry: Interval) -> tuple[Interval, Interval, Interval]:
    """xc'yc, |xc|'ry + rx'|yc| and rx'ry, enclosed."""
    return product_exact(xc, yc), (rx * np.abs(yc) + ry * np.abs(xc)).sum(), (rx * ry).sum()


def _radius(rad: np.ndarray) -> Interval:
    """A radius as an operand: a point, also where it is infinite (its products then are [largest float, inf])."""
    return _made(rad, rad)


def _inner_radius(x: Interval, mid: np.ndarray) -> np.ndarray:
    """A radius with which mid +- radius lies within x."""
    return np.minimum(_add_down(x.high, -mid), _add_down(mid, -x.low))


# ---- products of matrices -------------------------------------------------------------------------------------------


@_quiet
def matmul(A, B) -> Interval:
    """{A B}: Am Bm -+ (|Am| Br + Ar |B| + (n + 2) u |Am| |Bm| + (n + 2) eta), |B| the largest magnitude within [B].

    A (..., m, n), B (..., n, k) intervals or exact arrays; stacks broadcast. [2] with the error of the matrix library bounded
    for every order of summation. The radius is up to 1.5 times that of the true range (`product_exact` is free of this excess
    and slower). A row of A or a column of B with an infinite end gives [-inf, inf]. Raises InputError when the shapes do not fit.
    """
    A, B = _interval(A), _interval(B)
    if len(A.shape) < 2 or len(B.shape) < 2 or A.shape[-1] != B.shape[-2] or A.shape[-1] > LONGEST:
        raise InputError(f"matrix product of {A.shape} and {B.shape}", mend="(..., m, n) times (..., n, k), n up to 2^26")
    n = A.shape[-1]
    rows, columns = _finite(A).all(axis=-1, keepdims=True), _finite(B).all(axis=-2, keepdims=True)
    if not (rows.all() and columns.all()):  # the matrix library must not see them: it may skip 0 * inf
        A = _made(np.where(rows, A.low, 0.0), np.where(rows, A.high, 0.0))
        B = _made(np.where(columns, B.low, 0.0), np.where(columns, B.high, 0.0))
    Am, Bm = A.mid, B.mid
    centre = Am @ Bm
    # |fl(Am Bm) - Am Bm| <= gamma_n |Am| |Bm| + n eta, gamma_n = n u / (1 - n u), and |Am| |Bm| is itself rounded ...
    rounding = np.abs(Am) @ np.abs(Bm)
    radius = _above((n + 3) * U * rounding + (n + 2) * ETA)  # ... which (n + 3) u covers for n <= LONGEST
    if B.low is not B.high:
        radius = _add_up(radius, _product_above(np.abs(Am), B.rad))
    if A.low is not A.high:
        radius = _add_up(radius, _product_above(A.rad, abs(B).high))
    bounded = rows & columns & np.isfinite(centre) & np.isfinite(radius)
    low, high = _add_down(centre, -radius), _add_up(centre, radius)
    return _made(np.where(bounded, low, -np.inf), np.where(bounded, high, np.inf))


def dot(x, c) -> Interval:
    """{x c}: lower and upper bounds of the products of the rows x (K, p) with one vector c (p), the result (K).

    Both exact or intervals. One pass of the matrix library with the error bound of `matmul`, which says more.
    """
    c = _interval(c)
    return matmul(x, c[:, None])[..., 0]


def _finite(x: Interval) -> np.ndarray:
    return np.isfinite(x.low) & np.isfinite(x.high)


def _product_above(P: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """An upper bound of P Q for P, Q >= 0: fl(P Q) is at least (1 - gamma_n) P Q - n eta."""
    n = P.shape[-1]
    return _above((P @ Q) * (1.0 + (n + 4) * U) + (n + 2) * ETA)


# ---- positive definite ----------------------------------------------------------------------------------------------


@_quiet
def positive_definite(A) -> np.ndarray:
    """Whether x'A x > 0 for every x != 0 and every symmetric matrix in [A]: True is a proof, False means "not proved".

    A (..., n, n), an exact symmetric array or an interval; the result is bool (...). Cholesky of D Am D - diag(D Ar D 1 + c) runs
    to its end, where D (powers of two) makes the diagonal about 1, x'E x >= -sum_i x_i^2 (Ar 1)_i for every symmetric |E| <= Ar,
    and c = (n + 4) u tr(D Am D) exceeds the error of Cholesky [3, 4]. Raises InputError for a matrix that is not square or
    an interval that holds no symmetric matrix.
    """
    A = _interval(A)
    if len(A.shape) < 2 or A.shape[-1] != A.shape[-2] or A.shape[-1] > LONGEST // 2:
        raise InputError(f"matrix of shape {A.shape}", mend="a definite matrix is square")
    n = A.shape[-1]
    symmetric = A.intersection(_made(A.low.swapaxes(-1, -2), A.high.swapaxes(-1, -2)))
    if symmetric.empty.any():
        raise InputError(f"matrix is not symmetric{_at(symmetric.empty)}", mend="give (A + A') / 2")
    A = symmetric.interval()
    # the batch goes last, so that each step of the Cholesky loop is one long vector operation
    mid, rad = (np.ascontiguousarray(np.moveaxis(part, (-2, -1), (0, 1))) for part in (A.mid, A.rad))
    diagonal = np.arange(n)
    halved = np.frexp(mid[diagonal, diagonal])[1] // 2  # of the binary exponent
    scale = -(halved[:, None] + halved[None, :])
    mid, rad = np.ldexp(mid, scale), np.ldexp(rad, scale)  # exact but for underflow
    trace = mid[diagonal, diagonal].sum(axis=0)  # of entries in [1/2, 2), or the matrix is not definite
    shift = rad.sum(axis=1) * (1.0 + (n + 4) * U) + (n + 4) * U * trace
    # c needs (n + 2) u tr: of the two more, one covers the rounding of c, one every underflow, since tr >= n / 2
    mid[diagonal, diagonal] = _add_down(mid[diagonal, diagonal], -_above(_above(shift)))
    return _cholesky_ends(mid)


def _cholesky_ends(A: np.ndarray) -> np.ndarray:
    """Whether Cholesky of A (n, n, ...) meets only positive pivots; overwrites A."""
    ends = np.ones(A.shape[2:], dtype=bool)
    for j in range(len(A)):
        pivot = A[j, j]
        ends &= pivot > 0  # false on NaN
        column = A[j + 1 :, j] / np.sqrt(np.where(pivot > 0, pivot, 1.0))
        A[j + 1 :, j + 1 :] -= column[:, None] * column[None, :]
    return ends
