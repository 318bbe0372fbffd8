"""Sparse regression with bounded error: convex programs on a matrix Psi (N, n) and a vector Y (N).

    smallest bound   mu_min = min over theta of ||Y - Psi theta||_h
    step 1           min ||theta||_1   subject to   ||Y - Psi theta||_h <= mu            # [1] eq. (1.8)
    step 2           min ||Y - Psi theta||_h   on the support of step 1                  # [1] eq. (1.9)
    intervals        low_j, high_j = min, max of theta_j subject to ||Y - Psi theta||_h <= mu

for h = 2 (`L2`) and h = infinity (`LInf`). No solver is believed: every answer carries its violation and a lower bound
that is recomputed here from a dual vector, which weak duality makes a bound whatever the solver did. With
||Psi' v||_inf <= 1 and h' the dual norm of h, ||theta||_1 >= v'Y - mu ||v||_h'.

Psi of a scheduled regression is nearly rank deficient (condition 1e12: powers of the schedule are almost collinear), so
everything that can be done in an orthonormal basis of its range is done there.

[1] Sparse set membership identification, section 1.2.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from workbench.lp import NotSolvedError, RowProgram
from workbench.records import field, record

RANK = 1e-13  # columns that add less than this to the range (relative, unit columns) are left out of it
FEASIBLE = 1e-7  # largest accepted violation of the bound, relative to it
OPTIMAL = 1e-6  # largest accepted relative duality gap; the usual one is 1e-9 and less


@record
class Solution:
    """A checked answer: theta (n), its objective, a certified lower bound on the optimum, and the bound it keeps."""

    theta: np.ndarray = field("n")
    value: float = field("")
    lower: float = field("")
    mu: float = field("", low=0.0)  # ||Y - Psi theta||_h, recomputed

    @property
    def gap(self) -> float:
        """Duality gap relative to the value: the optimum lies within it."""
        return (self.value - self.lower) / max(abs(self.value), 1e-300)

    @property
    def support(self) -> np.ndarray:
        """Indices of the coefficients that are not zero."""
        return np.flatnonzero(self.theta)


@record
class Intervals:
    """Outer bounds of each coefficient over {theta : ||Y - Psi theta||_h <= mu}; low, high (n)."""

    low: np.ndarray = field("n")
    high: np.ndarray = field("n")


# ---- l2 -------------------------------------------------------------------------------------------------------------


@record
class L2:
    """||e||_2 <= mu: the energy of the error is bounded."""

    def norm(self, e: np.ndarray) -> float:
        return float(np.linalg.norm(e))

    def noise_bound(self, e: np.ndarray, fitted: int) -> float:
        """A bound that the noise behind least-squares residuals e (N) of `fitted` coefficients keeps with some certainty.

        s sqrt(N + 3 sqrt(2 N)) with s^2 = e'e/(N - fitted): three standard deviations of ||d||^2 for white Gaussian d.
        """
        N = len(e)
        return float(np.linalg.norm(e) * np.sqrt((N + 3.0 * np.sqrt(2.0 * N)) / max(N - fitted, 1)))

    def compress(self, Psi: np.ndarray, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A problem of at most n + 1 rows with the same ||Y - Psi theta||_2 for every theta."""
        if len(Y) <= Psi.shape[1] + 1:
            return Psi, Y
        R = _triangle(np.column_stack([Psi, Y]))
        return R[:, :-1], R[:, -1]

    def smallest(self, Psi: np.ndarray, Y: np.ndarray) -> Solution:
        """min ||Y - Psi theta||_2: least squares in an orthonormal basis of the range."""
        Psi, Y = self.compress(Psi, Y)
        Q, back = orthonormal_range(Psi)
        z = Q.T @ Y
        z += Q.T @ (Y - Q @ z)  # one refinement
        theta = _coefficients(Psi, Q, back, z)
        # ||r|| >= r'Y / ||r|| for every r orthogonal to the range
        r = Y - Q @ z
        value = self.norm(Y - Psi @ theta)
        return Solution(theta, value, float(r @ Y) / max(self.norm(r), 1e-300), value)

    def sparsest(self, Psi: np.ndarray, Y: np.ndarray, mu: float) -> Solution:
        """min ||theta||_1 subject to ||Y - Psi theta||_2 <= mu."""
        answer = self.path(Psi, Y, [mu])[0]
        if answer is None:
            raise NotSolvedError(f"no theta keeps the bound {mu:g}, or none is proved optimal")
        return answer

    def path(self, Psi: np.ndarray, Y: np.ndarray, mus: Sequence[float]) -> list[Solution | None]:
        """`sparsest` for several bounds: one homotopy visits them all; the conic solver where its answer fails."""
        Psi, Y = self.compress(Psi, Y)
        return [self._proved(Psi, Y, mu, pair) for mu, pair in zip(mus, _homotopy(Psi, Y, mus), strict=True)]

    def _proved(self, Psi: np.ndarray, Y: np.ndarray, mu: float, pair: "_Pair | None") -> Solution | None:
        if pair is not None:
            try:
                return _accepted([_checked_l1(self, Psi, Y, mu, pair)], mu)
            except NotSolvedError:
                pass
        try:
            conic = _clarabel_l2(Psi, Y, mu)
            supports = [np.flatnonzero(np.abs(conic.theta) > t * np.abs(conic.theta).max()) for t in (1e-5, 1e-7)]
            polished = [_exact_l2(Psi, Y, mu, S, np.sign(conic.theta[S])) for S in supports]
            pairs = [conic, *(p for p in polished if p is not None)]
            return _accepted([_checked_l1(self, Psi, Y, mu, p) for p in pairs], mu)
        except NotSolvedError:
            return None

    def intervals(self, Psi: np.ndarray, Y: np.ndarray, mu: float) -> Intervals:
        """The ellipsoid's extent: theta_LS +- sqrt((mu^2 - mu_min^2) diag (Psi'Psi)^-1)."""
        best = self.smallest(Psi, Y)
        _, back = orthonormal_range(self.compress(Psi, Y)[0])
        if back.shape[1] < Psi.shape[1]:
            return Intervals(np.full(Psi.shape[1], -np.inf), np.full(Psi.shape[1], np.inf))
        half = np.sqrt(max(mu**2 - best.mu**2, 0.0)) * np.linalg.norm(back, axis=1)
        return Intervals(best.theta - half, best.theta + half)

    def dual_norm(self, v: np.ndarray) -> float:
        return float(np.linalg.norm(v))


@record
class _Pair:
    """What a solver claims: theta (n) and a dual vector v (N), up to a positive factor."""

    theta: np.ndarray = field("n")
    v: np.ndarray = field("N")


def _homotopy(Psi: np.ndarray, Y: np.ndarray, mus: Sequence[float]) -> list[_Pair | None]:
    """The optimum for each bound: follow min 1/2 ||Y - Psi theta||^2 + tau ||theta||_1 from theta = 0 down in tau.

    Between two events (a coefficient joins or leaves) theta is linear in tau and ||Y - Psi theta|| falls. At an optimum
    Psi_S'r = tau sign with Psi_S = Q T, so theta_S = T^-1 (Q'Y - tau w), r = Y - Q Q'Y + tau Q w, w = T^-T sign; both
    are computed anew at every event, so nothing drifts.
    """
    from scipy.linalg import solve_triangular

    found: list[_Pair | None] = [None] * len(mus)
    wanted = sorted(range(len(mus)), key=lambda i: -mus[i])
    while wanted and np.linalg.norm(Y) <= mus[wanted[0]]:
        found[wanted.pop(0)] = _Pair(np.zeros(Psi.shape[1]), np.zeros(len(Y)))
    c = Psi.T @ Y
    tau = float(np.abs(c).max(initial=0.0))
    frame = _Frame(Psi)
    frame.join(int(np.argmax(np.abs(c))), np.sign(c[np.argmax(np.abs(c))]))
    for _ in range(20 * Psi.shape[1]):
        if not wanted:
            break
        Q, T, S = frame.Q, frame.T, frame.S
        q = Q.T @ Y
        w = solve_triangular(T, frame.sign, trans=1, check_finite=False)
        Qw = Q @ w
        outside = Y - Q @ q
        outside = outside - Q @ (Q.T @ outside)  # near the smallest bound tau is far below the rounding of Y
        a = Psi.T @ Qw
        c = Psi.T @ (outside + tau * Qw)
        d = solve_triangular(T, w, check_finite=False)
        theta = solve_triangular(T, q - tau * w, check_finite=False)
        # how far tau falls until something happens
        free = np.ones(len(c), dtype=bool)
        free[S] = False
        with np.errstate(divide="ignore", invalid="ignore"):
            # a correlation joins where it reaches tau from below, a coefficient leaves where it runs towards zero
            join = np.minimum(
                np.where(1 - a > 0, np.maximum(tau - c, 0.0) / (1 - a), np.inf),
                np.where(1 + a > 0, np.maximum(tau + c, 0.0) / (1 + a), np.inf),
            )
            leave = np.where(d * frame.sign < 0, np.maximum(theta * frame.sign, 0.0) / np.abs(d), np.inf)
        join[~free] = np.inf
        fall = min(float(join.min(initial=np.inf)), float(leave.min(initial=np.inf)), tau)
        rest, speed = float(outside @ outside), float(w @ w)
        while wanted and mus[wanted[0]] ** 2 >= rest + (tau - fall) ** 2 * speed:
            i = wanted.pop(0)
            found[i] = _exact_l2(Psi, Y, mus[i], np.array(S), frame.sign)
        if fall >= tau or not wanted:
            break
        tau -= fall
        if leave.min(initial=np.inf) <= join.min(initial=np.inf):
            frame.leave(int(np.argmin(leave)))
        elif not frame.join(j := int(np.argmin(join)), np.sign(c[j] - fall * a[j])):
            break
    return found


class _Frame:
    """Psi[:, S] = Q T, kept while columns join and leave, with the sign each coefficient has."""

    def __init__(self, Psi: np.ndarray):
        self.Psi = Psi
        self.Q, self.T = np.empty((len(Psi), 0)), np.empty((0, 0))
        self.S: list[int] = []
        self.sign = np.empty(0)

    def join(self, j: int, sign: float) -> bool:
        """Add column j; False where it lies in the span of the others."""
        column = self.Psi[:, j]
        t = self.Q.T @ column
        rest = column - self.Q @ t
        again = self.Q.T @ rest
        rest = rest - self.Q @ again
        size = np.linalg.norm(rest)
        if size <= RANK * np.linalg.norm(column):
            return False
        n = len(self.S)
        T = np.zeros((n + 1, n + 1))
        T[:n, :n], T[:n, n], T[n, n] = self.T, t + again, size
        self.Q, self.T = np.column_stack([self.Q, rest / size]), T
        self.S.append(j)
        self.sign = np.append(self.sign, sign)
        return True

    def leave(self, place: int) -> None:
        """Remove the column at `place` of S."""
        # only what stands right of the column loses its triangle
        turn, corner = np.linalg.qr(self.T[place:, place + 1 :])
        T = np.delete(self.T, place, axis=1)[:-1]
        T[place:, place:] = corner
        self.T = T
        self.Q = np.hstack([self.Q[:, :place], self.Q[:, place:] @ turn])
        self.sign = np.delete(self.sign, place)
        self.S.pop(place)


def _clarabel_l2(Psi: np.ndarray, Y: np.ndarray, mu: float) -> _Pair:
    """theta and the dual vector of the cone; x = (theta, s) with |theta| <= s, ||Y - Psi theta|| <= mu."""
    import clarabel as compiled  # its names are not visible to the type checker
    from scipy import sparse

    clarabel: Any = compiled

    n = Psi.shape[1]
    # the part of Y outside the range is the same for all theta: taking it out leaves a ball that is not thin
    Q, _ = orthonormal_range(Psi)
    q = Q.T @ Y
    outside = float(np.linalg.norm(Y - Q @ q))
    if outside > mu:
        raise NotSolvedError(f"no theta keeps the bound {mu:g}: the smallest is {outside:g}")
    radius = np.sqrt((mu - outside) * (mu + outside))
    unit = max(radius, 1e-6 * mu)
    if not unit > 0.0:
        raise NotSolvedError("a bound of 0 leaves no cone")
    R = Q.T @ Psi / unit
    eye = sparse.identity(n)
    A = sparse.vstack(
        [sparse.hstack([eye, -eye]), sparse.hstack([-eye, -eye]), sparse.csc_matrix((1, 2 * n)),
         sparse.hstack([sparse.csc_matrix(R), sparse.csc_matrix((len(R), n))])],
        format="csc",
    )  # fmt: skip
    b = np.concatenate([np.zeros(2 * n), [radius / unit], q / unit])
    cost = np.concatenate([np.zeros(n), np.ones(n)])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    settings.max_threads = 1
    cones = [clarabel.NonnegativeConeT(2 * n), clarabel.SecondOrderConeT(1 + len(R))]
    answer = clarabel.DefaultSolver(sparse.csc_matrix((2 * n, 2 * n)), cost, A, b, cones, settings).solve()
    theta = np.array(answer.x)[:n]
    return _Pair(theta, -Q @ np.array(answer.z)[2 * n + 1 :])


def _exact_l2(Psi: np.ndarray, Y: np.ndarray, mu: float, S: np.ndarray, sign: np.ndarray) -> _Pair | None:
    """The optimum with this support and these signs: Psi_S'r = tau sign, ||r|| = mu, r = Y - Psi_S theta_S."""
    Q, T = np.linalg.qr(Psi[:, S])
    if len(S) == 0 or np.abs(np.diag(T)).min() <= RANK * np.abs(np.diag(T)).max():
        return None
    q = Q.T @ Y
    outside = Y - Q @ q
    outside = outside - Q @ (Q.T @ outside)
    rest = float(np.linalg.norm(outside))
    if rest > mu:
        return None
    w = np.linalg.solve(T.T, sign)
    tau = np.sqrt((mu - rest) * (mu + rest)) / np.linalg.norm(w)
    theta = np.zeros(Psi.shape[1])
    theta[S] = np.linalg.solve(T, q - tau * w)
    return _Pair(theta, outside + tau * (Q @ w))


# ---- l infinity -----------------------------------------------------------------------------------------------------


@record
class LInf:
    """|e(k)| <= mu for every k: each error is bounded."""

    def norm(self, e: np.ndarray) -> float:
        return float(np.abs(e).max(initial=0.0))

    def noise_bound(self, e: np.ndarray, fitted: int) -> float:
        """The largest least-squares residual and a tenth more, corrected for `fitted` coefficients: no statistics, a caution."""
        return float(1.1 * np.abs(e).max(initial=0.0) * np.sqrt(len(e) / max(len(e) - fitted, 1)))

    def compress(self, Psi: np.ndarray, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same problem: in this norm every row counts."""
        return Psi, Y

    def smallest(self, Psi: np.ndarray, Y: np.ndarray) -> Solution:
        """min max_k |Y - Psi theta|: Chebyshev approximation, interior point in an orthonormal basis of the range."""
        Q, back = orthonormal_range(Psi)
        z, v = _chebyshev(Q, Y)
        theta = _coefficients(Psi, Q, back, z)
        # max |r| >= v'Y for every v orthogonal to the range with ||v||_1 = 1
        v = v - Q @ (Q.T @ v)
        value = self.norm(Y - Psi @ theta)
        return Solution(theta, value, max(0.0, float(v @ Y) / max(np.abs(v).sum(), 1e-300)), value)

    def sparsest(self, Psi: np.ndarray, Y: np.ndarray, mu: float) -> Solution:
        """min ||theta||_1 subject to max_k |Y - Psi theta| <= mu: dual simplex, rows added as they are violated."""
        n = Psi.shape[1]
        if self.norm(Y) <= mu:
            return Solution(np.zeros(n), 0.0, 0.0, self.norm(Y))
        program = _ErrorProgram(np.hstack([Psi, -Psi]) / mu, Y / mu, np.ones(2 * n), np.zeros(2 * n), np.inf)
        x, v = program.solve()
        theta = x[:n] - x[n:]
        return _accepted([_checked_l1(self, Psi, Y, mu, _Pair(theta, v / mu))], mu)

    def path(self, Psi: np.ndarray, Y: np.ndarray, mus: Sequence[float]) -> list[Solution | None]:
        """`sparsest` for several bounds; None where no answer is proved optimal."""
        answers: list[Solution | None] = []
        for mu in mus:
            try:
                answers.append(self.sparsest(Psi, Y, mu))
            except NotSolvedError:
                answers.append(None)
        return answers

    def intervals(self, Psi: np.ndarray, Y: np.ndarray, mu: float) -> Intervals:
        """Two linear programs per coefficient; the bounds are dual ones, so they hold whatever the solver did."""
        n = Psi.shape[1]
        Q, back = orthonormal_range(Psi)
        if back.shape[1] < n:
            return Intervals(np.full(n, -np.inf), np.full(n, np.inf))
        centre = Q.T @ Y
        # z in units of mu; ||Y - Q z||_2 <= sqrt(N) mu is a box that changes nothing and keeps every program bounded
        rest = (Y - Q @ centre) / mu
        reach = np.full(n, np.sqrt(len(Y)))
        program = _ErrorProgram(Q, rest, np.zeros(n), -reach, reach)
        low, high = np.empty(n), np.empty(n)
        for j, row in enumerate(back):
            size = float(np.linalg.norm(row))
            unit = row / size
            low[j] = row @ centre + size * mu * _lowest(program, Q, rest, unit)
            high[j] = row @ centre - size * mu * _lowest(program, Q, rest, -unit)
        return Intervals(low, high)

    def dual_norm(self, v: np.ndarray) -> float:
        return float(np.abs(v).sum())


def _lowest(program: "_ErrorProgram", Q: np.ndarray, y: np.ndarray, direction: np.ndarray) -> float:
    """A lower bound on direction'z subject to |y - Q z| <= 1, sharp where the solver did its work.

    direction'z = w'(Q z) >= w'y - ||w||_1 for every w with Q'w = direction.
    """
    try:
        program.change_cost(direction)
        _, v = program.solve()
    except NotSolvedError:
        v = np.zeros(len(y))
    w = v + Q @ (direction - Q.T @ v)
    return float(w @ y) - float(np.abs(w).sum())


Bound = L2 | LInf
BOUNDS: dict[str, type] = {"l2": L2, "linf": LInf}


class _ErrorProgram:
    """min cost'x, low <= x <= high, |y - M x| <= 1, on the few rows that matter: the others join when violated."""

    def __init__(self, M: np.ndarray, y: np.ndarray, cost: np.ndarray, low: np.ndarray, high: np.ndarray | float):
        self.M, self.y = M, y
        n = M.shape[1]
        self.rows = np.empty(0, dtype=int)
        self.program = RowProgram(cost, low, high)
        size = np.argsort(-np.abs(y))[: 2 * n]
        self._add(np.unique(np.concatenate([size[: n // 2], np.linspace(0, len(y) - 1, n // 2).astype(int)])))

    def change_cost(self, cost: np.ndarray) -> None:
        self.program.change_cost(cost)

    def solve(self, rounds: int = 100) -> tuple[np.ndarray, np.ndarray]:
        """x and a vector v (N) of row multipliers, zero on rows that never joined."""
        for _ in range(rounds):
            x, multipliers = self.program.solve()
            excess = np.abs(self.y - self.M @ x) - 1.0
            excess[self.rows] = 0.0
            worst = np.argsort(-excess)[: max(50, self.M.shape[1] // 4)]
            worst = worst[excess[worst] > 1e-9]
            if len(worst) == 0:
                v = np.zeros(len(self.y))
                v[self.rows] = multipliers
                return x, v
            self._add(worst)
        raise NotSolvedError(f"rows are still violated after {rounds} rounds")

    def _add(self, rows: np.ndarray) -> None:
        self.program.add(self.M[rows], self.y[rows] - 1.0, self.y[rows] + 1.0)
        self.rows = np.concatenate([self.rows, rows])


def _chebyshev(Q: np.ndarray, Y: np.ndarray, iterations: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """min t subject to -t <= Y - Q z <= t: z and the multipliers' difference; Mehrotra's predictor-corrector.

    The iterates are feasible on both sides from the start: z = Q'Y with t above its residual, equal multipliers. With
    r = Y - Q z the slacks are t - r and t + r, stacked (2, N) as their multipliers are.
    """
    N = len(Q)
    z = Q.T @ Y
    r = Y - Q @ z
    if np.abs(r).max() <= 1e-14 * np.abs(Y).max():
        return z, r
    t = 1.1 * float(np.abs(r).max())
    multiplier = np.full((2, N), 0.5 / N)
    for _ in range(iterations):
        slack = np.stack([t - r, t + r])
        gap = float(np.vdot(multiplier, slack))
        newton = _ChebyshevNewton(Q, slack, multiplier)
        if gap <= 1e-12 * t or not newton.regular:
            break
        _, dt, ds, dm = newton.step(-multiplier * slack)
        after = multiplier + _reach(multiplier, dm) * dm, slack + _reach(slack, ds) * ds
        target = (float(np.vdot(*after)) / gap) ** 3 * gap / (2 * N)
        dz, dt, ds, dm = newton.step(target - multiplier * slack - dm * ds)
        primal = min(0.995 * _reach(slack, ds), 1.0)
        z, t = z + primal * dz, t + primal * dt
        multiplier = multiplier + min(0.995 * _reach(multiplier, dm), 1.0) * dm
        r = Y - Q @ z
        t = max(t, float(np.abs(r).max()) * (1 + 1e-14))
    return z, multiplier[0] - multiplier[1]


class _ChebyshevNewton:
    """Newton's equations of the central path at one iterate, factorised once for predictor and corrector."""

    def __init__(self, Q: np.ndarray, slack: np.ndarray, multiplier: np.ndarray):
        from scipy.linalg import LinAlgError, cho_factor

        self.Q, self.slack = Q, slack
        self.weight = multiplier / slack
        self.dual = np.append(Q.T @ (multiplier[0] - multiplier[1]), multiplier.sum() - 1.0)
        both = self.weight.sum(axis=0)
        n = Q.shape[1]
        H = np.empty((n + 1, n + 1))
        H[:n, :n] = (Q * both[:, None]).T @ Q
        H[:n, n] = H[n, :n] = Q.T @ (self.weight[0] - self.weight[1])
        H[n, n] = both.sum()
        try:
            self.factor = cho_factor(H)
            self.regular = True
        except LinAlgError:
            self.regular = False

    def step(self, target: np.ndarray) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
        """dz, dt and the changes (2, N) of slacks and multipliers that move slack * multiplier by `target`."""
        from scipy.linalg import cho_solve

        h = target / self.slack
        d = cho_solve(self.factor, self.dual + np.append(self.Q.T @ (h[0] - h[1]), h.sum()))
        Qz = self.Q @ d[:-1]
        ds = np.stack([d[-1] + Qz, d[-1] - Qz])
        return d[:-1], float(d[-1]), ds, h - self.weight * ds


def _reach(x: np.ndarray, dx: np.ndarray) -> float:
    """Largest step that keeps x + step dx >= 0, at most 1 / 0.995."""
    falling = dx < 0
    return float(min(1 / 0.995, np.min(-x[falling] / dx[falling], initial=np.inf)))


# ---- checks and bases -----------------------------------------------------------------------------------------------


def _checked_l1(bound: "Bound", Psi: np.ndarray, Y: np.ndarray, mu: float, pair: _Pair) -> Solution:
    """theta with what it violates, and the lower bound v'Y - mu ||v||_h' on the l1 norm after ||Psi'v||_inf = 1."""
    v = pair.v / max(np.abs(Psi.T @ pair.v).max(initial=0.0), 1e-300)
    lower = max(0.0, float(v @ Y) - mu * bound.dual_norm(v))
    return Solution(pair.theta, float(np.abs(pair.theta).sum()), lower, bound.norm(Y - Psi @ pair.theta))


def _accepted(answers: Sequence[Solution], mu: float) -> Solution:
    """The feasible answer with the fewest coefficients among those proved optimal; refused if there is none."""
    lower = max(answer.lower for answer in answers)
    good = [
        answer
        for answer in answers
        if answer.mu <= mu * (1 + FEASIBLE) and answer.value - lower <= OPTIMAL * max(answer.value, 1e-300)
    ]
    if not good:
        worst = min(answers, key=lambda answer: answer.mu)
        raise NotSolvedError(f"not proved optimal: bound {worst.mu:g} where {mu:g} was asked, relative gap {worst.gap:.1e}")
    best = min(good, key=lambda answer: len(answer.support))
    return Solution(best.theta, best.value, lower, best.mu)


def _triangle(M: np.ndarray) -> np.ndarray:
    """R of M = Q R: the same column inner products in as many rows as columns."""
    R: Any = np.linalg.qr(M, mode="r")
    return R


def _coefficients(Psi: np.ndarray, Q: np.ndarray, back: np.ndarray, z: np.ndarray) -> np.ndarray:
    """theta with Psi theta = Q z: back z, refined, since nearly collinear columns make it large."""
    theta = back @ z
    for _ in range(2):
        theta = theta + back @ (Q.T @ (Q @ z - Psi @ theta))
    return theta


def orthonormal_range(Psi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal Q (N, r) of the range of Psi and `back` (n, r) with Psi back = Q."""
    from scipy.linalg import qr, solve_triangular

    if Psi.shape[1] == 0:
        return Psi, np.empty((0, 0))
    size = np.linalg.norm(Psi, axis=0)
    size[size == 0] = 1.0
    Q1, R1 = np.linalg.qr(Psi / size)
    pivoted: Any = qr(R1, pivoting=True)
    Q2, R2, order = pivoted
    rank = int(np.sum(np.abs(np.diag(R2)) > RANK * max(abs(R2[0, 0]), 1e-300)))
    back = np.zeros((Psi.shape[1], rank))
    back[order[:rank]] = solve_triangular(R2[:rank, :rank], np.eye(rank))
    return Q1 @ Q2[:, :rank], back / size[:, None]
