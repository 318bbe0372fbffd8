"""Outer bounds of a recursion whose parameters vary in a box, sample by sample and without memory.

    x(k+1) = A_m x(k) + q(k) + b w(k),        y(k) = c_m'x(k) + g(k) + h w(k)
    w(k) = sum_i delta_i(k) lam_mi z_i(k),    z(k) = C x(k) + f(k),    |delta_i(k)| <= 1,    m = mode[k]

All interval parameters enter through one scalar, the equation error w. That makes two things cheap:

- hull. conv R(k+1) = conv {A x + q +- b lam'|z(x)| : x a vertex of conv R(k)}, because lam'|z| is convex in x: two points
  per vertex, never 2^p. The output is linear in x, so the hull gives the exact range of y at every sample.
- kernel. |w(k)| <= W(k), and W(k) follows from the W(j) before it through impulse responses.

Everything is propagated as the deviation d = x - x_nominal, whose rounding is relative to the width of the envelope and not
to the size of the signal. "Guaranteed" means: for the numbers in the `Recursion`, up to the rounding that each function
names and adds to its bounds.
"""

from collections.abc import Callable

import numpy as np

from workbench.errors import InputError
from workbench.records import field, record

ROUNDING = 64 * np.finfo(float).eps  # of one step of a recursion, relative to the sum of the sizes of its terms
WIDENED = 1e-9  # by which kernel and zonotope are widened: far above their rounding, far below what they overestimate
COLLINEAR = 1e-12  # vertices this close to the chord of their neighbours, relative to the polygon, are dropped and paid for
MOST_SIGNS = 7  # parameters up to which all sign patterns are tried; above it their sum is bounded term by term
THIN = 1e5  # an extent in space below this many roundings counts as flat
QHULL = 1e-12  # by how much Qhull's hull may miss a point, where all extents are of size one; the usual is 1e-15


@record
class Recursion:
    """x(k+1) = A_m x(k) + q(k) + b w(k), y(k) = c_m'x(k) + g(k) + through w(k), x(0) = start + spread e, |e_j| <= 1.

    w(k) = sum_i delta_i(k) lam_mi z_i(k) with z(k) = C x(k) + f(k) and |delta_i(k)| <= 1 arbitrary in time; m = mode[k].
    Shapes: M modes, n states, p parameters, N samples, s directions of the initial state. The state keeps its meaning over the
    modes. n = 0 is a model without feedback (FIR): y(k) = g(k) + through w(k). An initial state that is known has s = 0.
    """

    A: np.ndarray = field("M n n")
    b: np.ndarray = field("n")
    c: np.ndarray = field("M n")
    C: np.ndarray = field("p n")
    lam: np.ndarray = field("M p", low=0.0)
    q: np.ndarray = field("N n")
    g: np.ndarray = field("N")
    f: np.ndarray = field("N p")
    mode: np.ndarray = field("N")
    start: np.ndarray = field("n")
    spread: np.ndarray = field("n s")
    through: float = field("", default=1.0)

    def __post_init__(self):
        for name, value in vars(self).items():
            if not np.all(np.isfinite(value)):
                raise InputError(f"{name} holds a value that is not finite", file="Recursion")
        if len(self.mode) == 0:
            raise InputError("no samples", file="Recursion", mend="give q, g, f and mode for at least one sample")
        if np.any((self.mode % 1 != 0) | (self.mode < 0) | (self.mode >= len(self.A))):
            raise InputError(f"mode must be an integer from 0 to {len(self.A) - 1}", file="Recursion")

    def __len__(self) -> int:
        return len(self.mode)

    @property
    def modes(self) -> np.ndarray:
        """mode[k] as integers, (N,)."""
        return self.mode.astype(int)


@record
class Nominal:
    """The run with every parameter at its centre: x (N, n), z (N, p), y (N)."""

    x: np.ndarray = field("N n")
    z: np.ndarray = field("N p")
    y: np.ndarray = field("N")


@record
class Bounds:
    """low <= y <= high for every parameter sequence; (N) each, infinite where the method has nothing to say.

    `gain` of the kernel: the largest sum that multiplies former W. Below 1 the bounds stay finite for all time; at 1 and above
    they grow without limit, whether or not the recursion does.
    """

    low: np.ndarray = field("N")
    high: np.ndarray = field("N")
    gain: float | None = None

    @property
    def width(self) -> np.ndarray:
        with np.errstate(over="ignore"):
            return self.high - self.low


def nominal(recursion: Recursion) -> Nominal:
    """x(k+1) = A_m x(k) + q(k), z = C x + f, y = c_m'x + g: every delta is zero, the initial state is `start`."""
    A, m, x = recursion.A, recursion.modes, np.empty((len(recursion), len(recursion.b)))
    x[0] = recursion.start
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(len(recursion) - 1):
            x[k + 1] = A[m[k]] @ x[k] + recursion.q[k]
        y = np.einsum("kn,kn->k", recursion.c[m], x) + recursion.g
        z = x @ recursion.C.T + recursion.f
    if not (np.all(np.isfinite(y)) and np.all(np.isfinite(z))):
        raise InputError(
            "the nominal run overflows", file="Recursion", mend="the centre of the box is unstable: shorten the run or fit again"
        )
    return Nominal(x, z, y)


def simulate(recursion: Recursion, delta: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
    """y (S, N) for S parameter sequences delta (S, N, p) in [-1, 1] and initial states e (S, s); None is e = 0.

    Runs that overflow continue as inf or NaN. Raises InputError on other shapes and on deltas outside the box.
    """
    delta = np.asarray(delta)
    r = recursion
    if delta.ndim != 3 or delta.shape[1:] != r.f.shape:
        raise InputError(f"delta has shape {delta.shape}, expected (S, {r.f.shape[0]}, {r.f.shape[1]})")
    e = np.zeros((len(delta), r.spread.shape[1])) if start is None else np.asarray(start, dtype=float)
    if e.shape != (len(delta), r.spread.shape[1]):
        raise InputError(f"start has shape {e.shape}, expected ({len(delta)}, {r.spread.shape[1]})")
    if not (np.all(np.abs(delta) <= 1) and np.all(np.abs(e) <= 1)):
        raise InputError("a sequence leaves the box", mend="delta and start lie between -1 and 1")
    y, x, m = np.empty(delta.shape[:2]), r.start + e @ r.spread.T, r.modes
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(len(r)):
            w = (delta[:, k] * (x @ r.C.T + r.f[k])) @ r.lam[m[k]]
            y[:, k] = x @ r.c[m[k]] + r.g[k] + r.through * w
            x = x @ r.A[m[k]].T + r.q[k] + np.multiply.outer(w, r.b)
    return y


# ---- boxes and generators -------------------------------------------------------------------------------------------


def intervals(recursion: Recursion) -> Bounds:
    """Natural interval evaluation: the state in a box, radius(k+1) = |A| radius + |b| lam'(|z_nom| + |C| radius).

    Every step forgets how the states hang together, so that the radius grows wherever |A| is unstable, however stable A is
    (the wrapping effect). Kept as the peer that shows why the others exist.
    """
    r, run, m = recursion, nominal(recursion), recursion.modes
    half, radius = np.empty(len(r)), np.abs(r.spread).sum(axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(len(r)):
            W = r.lam[m[k]] @ (np.abs(run.z[k]) + np.abs(r.C) @ radius)
            half[k] = np.abs(r.c[m[k]]) @ radius + abs(r.through) * W
            radius = np.abs(r.A[m[k]]) @ radius + np.abs(r.b) * W
    return _around(recursion, run, half)


def modal(A: np.ndarray) -> np.ndarray:
    """T (n, n) with T^-1 A T block diagonal: real eigenvectors, real and imaginary parts of complex pairs, unit columns.

    A defective A has no such basis; its real Schur vectors take the place.
    """
    from scipy.linalg import schur

    values, vectors = np.linalg.eig(A)
    T = np.where(np.imag(values) < 0, np.imag(vectors), np.real(vectors))
    if len(A) and np.linalg.cond(T) > 1e8:
        T = schur(A, output="real")[1]
    return T / np.maximum(np.linalg.norm(T, axis=0), 1e-300)


def zonotope(recursion: Recursion, order: int = 10, coordinates: np.ndarray | None = None) -> Bounds:
    """d(k) in {G e : |e_i| <= 1}, G(k+1) = [A G, b W(k)] reduced to `order` n generators (Girard).

    W(k) is the largest |w| over the zonotope. The smallest generators become a box in `coordinates` T (n, n), d = T v; by
    default the modal ones of the most frequent mode. In coordinates in which A is not nearly diagonal (the shift states of a
    difference equation) the boxes wrap and the bounds explode. With order >= N this is the kernel.
    """
    r, run, m = recursion, nominal(recursion), recursion.modes
    n = len(r.b)
    if order < 1:
        raise InputError(f"order {order}", mend="a zonotope keeps at least one generator per state")
    T = modal(r.A[np.bincount(m).argmax()]) if coordinates is None else np.asarray(coordinates, dtype=float)
    A, b, c = np.linalg.solve(T, r.A @ T), np.linalg.solve(T, r.b), r.c @ T
    patterns = [_Patterns(lam, r.C @ T) for lam in r.lam]
    G, half = np.linalg.solve(T, r.spread), np.full(len(r), np.inf)
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(len(r)):
            W = patterns[m[k]].largest(run.z[k], G, np.ones(G.shape[1]))
            half[k] = np.abs(c[m[k]] @ G).sum() + abs(r.through) * W
            G = _girard(np.column_stack([A[m[k]] @ G, b * W]), order * n)
            if not np.isfinite(half[k]):
                break
    return _around(recursion, run, half)


def _girard(G: np.ndarray, most: int) -> np.ndarray:
    """At most `most` generators that contain those of G (n, m): the most box-like ones become one box."""
    n, m = G.shape
    if m <= most:
        return G
    size = np.abs(G)
    rank = np.argsort(size.sum(axis=0) - size.max(axis=0, initial=0.0))
    boxed, kept = rank[: m - most + n], rank[m - most + n :]
    return np.column_stack([G[:, kept], np.diag(size[:, boxed].sum(axis=1))])


# ---- the kernel -----------------------------------------------------------------------------------------------------


def kernel(recursion: Recursion) -> Bounds:
    """W(k) = max over signs delta of |delta'(lam z_nom)| + sum_j |delta'(lam C Phi(k, j+1) b)| W(j) + initial spread.

    |y - y_nom| <= sum_j |c'Phi(k, j+1) b| W(j) + |through| W(k) + initial spread; lam z is the product entry by entry. The
    maximum runs over the 2^(p-1) patterns modulo a global sign; for more than MOST_SIGNS parameters with lam > 0 each term is
    bounded by lam'|.| instead, which is never smaller. First-order exact: the bound is at most 1/(1 - gain) times too wide.
    """
    r, run, m = recursion, nominal(recursion), recursion.modes
    N, s = len(r), r.spread.shape[1]
    patterns = [_Patterns(lam, r.C) for lam in r.lam]
    Z = np.zeros((len(r.b), s + N))  # columns Phi(k, 0) spread_i, then Phi(k, j+1) b
    Z[:, :s] = r.spread
    weight, half, gain = np.ones(s + N), np.full(N, np.inf), 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(N):
            now = Z[:, : s + k]
            W = patterns[m[k]].largest(run.z[k], now, weight[: s + k])
            gain = max(gain, patterns[m[k]].largest(0 * run.z[k], now[:, s:], np.ones(k)))
            half[k] = np.abs(r.c[m[k]] @ now) @ weight[: s + k] + abs(r.through) * W
            if not np.isfinite(half[k]) or not np.isfinite(W):
                half[k] = np.inf
                break
            now[:] = r.A[m[k]] @ now
            Z[:, s + k], weight[s + k] = r.b, W
    bounds = _around(recursion, run, half)
    return Bounds(bounds.low, bounds.high, gain)


class _Patterns:
    """Rows delta'diag(lam) of every sign pattern delta modulo a global sign, ready to meet z and C Z."""

    def __init__(self, lam: np.ndarray, C: np.ndarray):
        live = np.flatnonzero(lam)
        self.many = len(live) > MOST_SIGNS
        self.rows = np.zeros((0 if self.many else 2 ** max(len(live) - 1, 0), len(lam)))
        for i, j in enumerate(live if not self.many else ()):
            bit = (np.arange(len(self.rows)) >> i) & 1
            self.rows[:, j] = np.where(bit == 1, -lam[j], lam[j])
        self.lam, self.C, self.seen = lam, C, self.rows @ C

    def largest(self, z: np.ndarray, Z: np.ndarray, weight: np.ndarray) -> float:
        """max over delta of |delta'(lam z)| + sum_j |delta'(lam C Z_j)| weight_j."""
        if self.many:
            return float(self.lam @ (np.abs(z) + np.abs(self.C @ Z) @ weight))
        return float(np.max(np.abs(self.rows @ z) + np.abs(self.seen @ Z) @ weight))


def _around(recursion: Recursion, run: Nominal, half: np.ndarray) -> Bounds:
    """y_nom +- half, widened by WIDENED of the half width and by the rounding of the nominal run."""
    r, m = recursion, recursion.modes
    half = np.where(np.isnan(half), np.inf, half)
    size = np.abs(run.y) + np.abs(r.g) + np.einsum("kn,kn->k", np.abs(r.c[m]), np.abs(run.x))
    half = half * (1 + WIDENED) + ROUNDING * size
    return Bounds(run.y - half, run.y + half)


# ---- exact hulls ----------------------------------------------------------------------------------------------------


def hull(recursion: Recursion) -> Bounds:
    """The exact range of y(k): the convex hull of the reachable states, vertex by vertex; at most three states.

    A vertex d of the hull of deviations becomes A d +- b lam'|z_nom + C d|. One state: a segment; two: a polygon; three: a
    polytope by Qhull. Each step is widened by its rounding (ROUNDING times the sizes of its terms), by the vertices dropped
    as nearly collinear, and, in space, by Qhull's own tolerance, so that the bounds contain the truth; on stable boxes this
    adds about 1e-9 to the width, and in space up to some 1e-6 of the signal where the set stays flat. An unstable box runs
    into infinity.
    Raises InputError for more than three states: `kernel` has no such limit.
    """
    r, run, m = recursion, nominal(recursion), recursion.modes
    n, p = len(r.b), r.C.shape[0]
    if n > 3:
        raise InputError(f"{n} states, an exact hull is propagated up to three", mend="use kernel")
    if n == 0:
        half = abs(r.through) * np.einsum("kp,kp->k", r.lam[m], np.abs(run.z))
        slack = ROUNDING * (1 + p) * (half + np.abs(run.y))
        return Bounds(run.y - half - slack, run.y + half + slack)
    frame = _frame(r.b)
    A, c, C = frame.T @ r.A @ frame, r.c @ frame, r.C @ frame
    beta, h = float(np.linalg.norm(r.b)), abs(r.through)
    error, grow = _Rounding(recursion, run), (_segment, _polygon, _polytope)[n - 1]
    V = _corners(r.spread.T @ frame, grow)
    low, high = np.full(len(r), -np.inf), np.full(len(r), np.inf)
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(len(r)):
            i = m[k]
            reach = np.abs(run.z[k] + V @ C.T) @ r.lam[i]
            y, size = V @ c[i], float(np.abs(V).max())
            slack = error.output(k, size)
            bottom, top = float((y - h * reach).min()) - slack, float((y + h * reach).max()) + slack
            if not (top - bottom < 1e150):
                break  # unstable: the products of the next steps overflow
            low[k], high[k] = run.y[k] + bottom, run.y[k] + top
            V = grow(V @ A[i].T, beta * reach, error.state(k, size))
    return Bounds(np.nextafter(low, -np.inf), np.nextafter(high, np.inf))


class _Rounding:
    """Bounds on the rounding of one step: ROUNDING times (terms of the nominal run + terms of the deviation)."""

    def __init__(self, recursion: Recursion, run: Nominal):
        r, m = recursion, recursion.modes
        n, p = len(r.b), len(r.C)
        size = np.abs(run.x).sum(axis=1)
        b, h = np.abs(r.b).sum(), abs(r.through)
        W = np.einsum("kp,kp->k", r.lam[m], np.abs(r.f) + size[:, None] * np.abs(r.C).max(axis=1, initial=0.0))
        growth = n * np.abs(r.A).sum(axis=1).max(axis=1, initial=0.0)
        seen = n * (r.lam @ np.abs(r.C).max(axis=1, initial=0.0))
        unit = ROUNDING * (n + p)
        self._m = m
        self._state = unit * (growth[m] * size + np.abs(r.q).sum(axis=1) + b * W)
        self._state_per = unit * (growth + b * seen)
        self._output = unit * (np.abs(r.c[m]).max(axis=1, initial=0.0) * size + np.abs(r.g) + h * W)
        self._output_per = unit * (n * np.abs(r.c).max(axis=1, initial=0.0) + h * seen)

    def state(self, k: int, size: float) -> float:
        return self._state[k] + self._state_per[self._m[k]] * size

    def output(self, k: int, size: float) -> float:
        return self._output[k] + self._output_per[self._m[k]] * size


# image (m, n), reach (m), rounding -> vertices (m', n) whose hull contains image_i +- reach_i along the last axis
Grow = Callable[[np.ndarray, np.ndarray, float], np.ndarray]


def _frame(b: np.ndarray) -> np.ndarray:
    """Orthonormal columns, the last one along b (up to sign, which +- makes irrelevant)."""
    Q, _ = np.linalg.qr(b[:, None], mode="complete")
    return Q[:, ::-1]


def _corners(directions: np.ndarray, grow: Grow) -> np.ndarray:
    """Vertices of {sum_j e_j directions_j : |e_j| <= 1}, directions (s, n), thinned as they are summed."""
    V = np.zeros((1, directions.shape[1]))
    for d in directions:
        both = np.concatenate([V + d, V - d])
        V = grow(both, np.zeros(len(both)), ROUNDING * float(np.abs(both).max()))
    return V


def _segment(image: np.ndarray, reach: np.ndarray, rounding: float) -> np.ndarray:
    x = image[:, 0]
    return np.array([[(x - reach).min() - rounding], [(x + reach).max() + rounding]])


def _polygon(image: np.ndarray, reach: np.ndarray, rounding: float) -> np.ndarray:
    """Upper chain of (s, t + reach), lower chain of (s, t - reach): every vertex moves along t only, so one sort serves both."""
    order = np.argsort(image[:, 0])
    s, t, reach = image[order, 0], image[order, 1], reach[order]
    upper = _chain(s, t + reach, rounding)
    lower = _chain(s, reach - t, rounding)
    lower[:, 1] *= -1
    return np.concatenate([upper, lower])


def _chain(s: np.ndarray, t: np.ndarray, rounding: float) -> np.ndarray:
    """Concave chain (m, 2) above the points (s, t), s ascending, with every point at least `rounding` below and beside it."""
    if not np.all(s[1:] > s[:-1]):  # of points one above the other the highest counts
        order = np.lexsort((t, s))
        s, t = s[order], t[order]
        last = np.append(s[1:] > s[:-1], True)
        s, t = s[last], t[last]
    points_s, points_t = s, t
    # a point on or below the chord of its neighbours is no vertex, whatever becomes of the neighbours
    while len(s) > 2:
        keep = _above_chord(s, t) > 0
        if keep.all():
            break
        keep = np.concatenate([[True], keep, [True]])
        s, t = s[keep], t[keep]
    # of neighbours that are nearly collinear only every other one may go: its chord stays
    if len(s) > 2:
        flat = np.zeros(len(s), dtype=bool)
        flat[1:-1] = _above_chord(s, t) <= COLLINEAR * (s[2:] - s[:-2]) * (t.max() - t.min())
        flat[::2] = False
        s, t = s[~flat], t[~flat]
    # what was dropped, and what rounding did above, is paid for: the chain rises until no point is above it
    lift = rounding + max(0.0, float((points_t - np.interp(points_s, s, t)).max()))
    top = int(t.argmax())
    s = np.concatenate([s[: top + 1] - rounding, s[top:] + rounding])
    return np.column_stack([s, np.concatenate([t[: top + 1], t[top:]]) + lift])


def _above_chord(s: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Height of each inner point over the chord of its neighbours, times the length of the chord along s; (m - 2,)."""
    return (t[1:-1] - t[:-2]) * (s[2:] - s[:-2]) - (t[2:] - t[:-2]) * (s[1:-1] - s[:-2])


def _polytope(image: np.ndarray, reach: np.ndarray, rounding: float) -> np.ndarray:
    """Qhull in the principal axes of the points, scaled to unit extents; along thin axes their largest half width instead."""
    step = reach[:, None] * np.eye(3)[-1]
    points = np.concatenate([image + step, image - step])
    rounding = 2 * (rounding + ROUNDING * float(np.abs(points).max()))
    centre = points.mean(axis=0)
    d = points - centre
    # not the eigenvectors of the covariance, which lose half the digits; zeros give two points three axes as well
    _, extent, axes = np.linalg.svd(np.concatenate([d, np.zeros((3, 3))]), full_matrices=False)
    extent = extent / np.sqrt(len(d))
    u = d @ axes.T
    # scaling a thin body until its thickness covers the rounding would lengthen it as well
    thick = extent > THIN * rounding
    V = _extreme(u[:, thick] / extent[thick], 2 * rounding / extent[thick].min(initial=np.inf)) * extent[thick]
    for axis in np.flatnonzero(~thick):
        half = np.abs(u[:, axis]).max() + rounding
        V = np.insert(np.concatenate([V, V]), axis, np.repeat([-half, half], len(V)), axis=1)
    return centre + V @ axes


def _extreme(points: np.ndarray, outward: float) -> np.ndarray:
    """Vertices of a hull that has every point at least `outward` inside; points (m, 0..3) of unit extents, mean zero."""
    from scipy.spatial import ConvexHull, QhullError

    if points.shape[1] == 0:
        return np.zeros((1, 0))
    if points.shape[1] == 1:
        return np.array([points.min(axis=0) - outward, points.max(axis=0) + outward])
    try:
        found = ConvexHull(points)
    except QhullError:  # flat to its own rounding: the box around all points holds as much
        ends = np.stack([points.min(axis=0) - outward, points.max(axis=0) + outward], axis=1)
        return np.stack(np.meshgrid(*ends), axis=-1).reshape(-1, points.shape[1])
    inside = -float(found.equations[:, -1].max())  # distance from the mean to the nearest facet
    return points[found.vertices] * (1 + (outward + QHULL) / inside)
