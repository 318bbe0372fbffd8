"""What noise and load steps make of the frozen loops of a PID: the variance of its outputs, and the gains that make it least.

    x+ = A x + B (u + d) + K e,   y = C x + D (u + d) + e        e white, of the covariance of the model's one-step error
    z+ = z - dt Ki y,   q+ = a q + (1 - a) g y,   u = -(Kp + g Kd) y + z + Kd q,    g = 1 / (Tf + dt), a = g Tf
    J = E y' y,  outputs in units of `scale`

With xi = (x, z, q) this is xi+ = F xi + G e, y = H xi + M e. A step d of an input moves y as d in z does, so that steps every T
seconds on average add d^2 dt / T to the noise that enters z:

    X = F X F' + G N G' + W,   Y = F' Y F + H' H,   J = tr(H X H' + M N M'),   dJ = 2 tr(Y (dF X F' + dG N G')) + ...

Only what a law can change is in y: by how much the true output differs from what is predicted of it no law changes.

The least variance within bounds on |S|, |T| and |Q| is sought from several starts by a quasi-Newton method, with the square of
what breaks a bound as its price, which rises.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are
from scipy.optimize import minimize

from controllers.tuning import Task
from workbench.records import field, record
from workbench.steady import gain

DOUBLED = 40  # times a Lyapunov sum is doubled: enough up to a pole of 1 - 1e-11
GONE, OVER = 1e-10, 1e30  # powers of a matrix that end its sum: it has come to its end, it has none
PRICES = 10.0, 300.0, 1e4, 3e5  # of the square of what breaks a bound
ITERATIONS, ACCURATE = 150, 1e-7  # of the quasi-Newton method at each price; relative gain below which it ends
TIGHTER = 4  # how often bounds are drawn in where the answer breaks them
LOST = 1e3  # log of the variance of a loop that is unstable
SMALL = 1e-9  # beside one: the price of commands, the noise of a measurement that has none, in the bound on linear laws
CALM = 0.99  # largest pole of what states are scaled by
SEEN = 1e-10  # of the outputs' variance in a sample: a load that adds less is none in that bound


@record
class Disturbed:
    """A frozen plant and what disturbs it: x+ = A x + B (u + d) + K e, y = C x + D (u + d) + e, y in units of the outputs' scale.

    noise (ny, ny): covariance of e. load (nu,): d^2 dt / T of steps d of each input, one every T seconds.
    """

    A: np.ndarray = field("nx nx")
    B: np.ndarray = field("nx nu")
    C: np.ndarray = field("ny nx")
    D: np.ndarray = field("ny nu")
    K: np.ndarray = field("nx ny")
    noise: np.ndarray = field("ny ny")
    load: np.ndarray = field("nu")

    def least(self) -> np.ndarray | None:
        """Covariance (ny, ny) of y under the linear law that makes E y'y least, of whatever order, with nothing else to keep.

        u = -L E[x+ | y, u = -E d] - E[d | y]: a Kalman filter of the plant and its loads, and the cheapest of regulators. None
        where outputs see the command of their own sample, or where no such law is found.
        """
        if np.any(self.D):
            return None
        plant, unit = self._scaled()
        found = plant._least() if unit > 0.0 else None
        return None if found is None else unit**2 * found

    def _scaled(self) -> "tuple[Disturbed, float]":
        """The same with states and outputs that count in what they vary by without a law and without load, and this unit of the
        outputs: Riccati's equation is not solved in states of any size.
        """
        step = np.sqrt(self.load.max(initial=0.0)) or 1.0
        A = self.A / max(1.0, np.abs(np.linalg.eigvals(self.A)).max() / CALM)  # it may integrate
        X = lyapunov(A, step**2 * self.B @ self.B.T + self.K @ self.noise @ self.K.T)
        unit = float(np.sqrt(np.trace(self.C @ X @ self.C.T + self.noise)))
        x = np.sqrt(np.maximum(np.diagonal(X), SMALL * np.trace(X)))
        A, B, C, K = self.A / x[:, None] * x, step * self.B / x[:, None], self.C * x / unit, self.K / x[:, None] * unit
        return Disturbed(A, B, C, self.D, K, self.noise / unit**2, self.load / step**2), unit

    def _least(self) -> np.ndarray | None:
        P0 = gain(self.A, self.B, self.C, self.D)
        load = self.load * np.sum(P0**2, axis=0) > SEEN  # what is less moves the outputs by its root at most
        driven = self.B[:, load]
        nx, nd = driven.shape
        A = np.block([[self.A, driven], [np.zeros((nd, nx)), np.eye(nd)]])
        C, K = np.pad(self.C, ((0, 0), (0, nd))), np.pad(self.K, ((0, nd), (0, 0)))
        Q, R = K @ self.noise @ K.T, self.noise + SMALL * np.eye(len(C))
        Q[nx:, nx:] += np.diag(self.load[load])
        goal, price = self.C.T @ self.C / np.sum(P0**2), SMALL * np.eye(self.B.shape[1])
        try:
            P = solve_discrete_are(A.T, C.T, Q, R, s=K @ self.noise)
            S = solve_discrete_are(self.A, self.B, goal, price)
        except (np.linalg.LinAlgError, ValueError):
            return None
        seen = np.linalg.solve(C @ P @ C.T + R, (A @ P @ C.T + K @ self.noise).T).T  # gain of the one-step predictor
        L = np.linalg.solve(price + self.B.T @ S @ self.B, self.B.T @ S)
        # states x and the predictor's errors of (x, d); the innovation is C times these, plus e
        moved = driven @ seen[nx:] + self.B @ L @ (seen[:nx] - driven @ seen[nx:])
        F = np.zeros((2 * nx + nd, 2 * nx + nd))
        F[:nx, :nx] = self.A - self.B @ L @ self.A
        F[:nx, nx:] = np.hstack([self.B @ L @ self.A, driven]) - moved @ C
        F[nx:, nx:] = A - seen @ C
        G = np.vstack([self.K - moved, K - seen])
        W = G @ self.noise @ G.T
        W[2 * nx :, 2 * nx :] += np.diag(self.load[load])
        X = lyapunov(F, W)
        return None if X is None else self.C @ X[:nx, :nx] @ self.C.T + self.noise


def lyapunov(F: np.ndarray, W: np.ndarray, *others: np.ndarray) -> Any:
    """X = F X F' + W of matrices (..., n, n) by doubling, and Y = F' Y F + Q for each of `others`; None where a pole is not
    within the unit circle.
    """
    sums, F = [W, *others], F
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(DOUBLED):
            T = np.swapaxes(F, -1, -2)
            sums = [sums[0] + F @ sums[0] @ T, *(own + T @ own @ F for own in sums[1:])]
            F = F @ F
            size = np.abs(F).max()
            if not size < OVER:  # nor is what is no number
                return None
            if size < GONE:
                return sums if others else sums[0]
    return None


class Variance:
    """J of laws on disturbed plants, whose gains at plant i are sum_j weights[i, j] X[:, j]; X (2 or 3, m, nu, ny): Kp, Ki, Kd.

    Plants may be of different orders: shorter ones are filled up with zeros.
    """

    def __init__(self, plants: Sequence[Disturbed], weights: np.ndarray, dt: float, Tf: float):
        nx = max(len(own.A) for own in plants)

        def stacked(key: str, *axes: int) -> np.ndarray:
            filled = [[(0, (nx - len(own.A)) * (i in axes)) for i in (0, 1)] for own in plants]
            return np.stack([np.pad(getattr(own, key), by) for own, by in zip(plants, filled, strict=True)])

        self.A, self.B, self.C, self.K = stacked("A", 0, 1), stacked("B", 0), stacked("C", 1), stacked("K", 0)
        self.D, self.noise = stacked("D"), stacked("noise")
        self.load, self.weights, self.dt = np.stack([own.load for own in plants]), np.asarray(weights, dtype=float), dt
        self.g = 1.0 / (Tf + dt)
        self.a = Tf * self.g

    def poles(self, X: np.ndarray) -> np.ndarray:
        """Poles of the loops (n, nx + nu + ny); those of what a plant is filled up with are 0."""
        return np.linalg.eigvals(self._loop(X).F)

    def covariance(self, X: np.ndarray) -> np.ndarray | None:
        """E y y' (n, ny, ny), or None where a loop is unstable."""
        loop = self._loop(X)
        P = lyapunov(loop.F, loop.W)
        return None if P is None else loop.H @ P @ _t(loop.H) + loop.M @ self.noise @ _t(loop.M)

    def log(self, X: np.ndarray) -> tuple[float, np.ndarray]:
        """Mean of log J over the plants, and its gradient in X; LOST and no gradient where a loop is unstable."""
        loop = self._loop(X)
        solved = lyapunov(loop.F, loop.W, _t(loop.H) @ loop.H)
        if solved is None:
            return LOST, np.zeros_like(X)
        P, Y = solved
        GN, MN = loop.G @ self.noise, loop.M @ self.noise
        yy = loop.H @ P @ _t(loop.H) + MN @ _t(loop.M)
        J = np.einsum("nii->n", yy)
        after_y = loop.F @ P @ _t(loop.H) + GN @ _t(loop.M)  # E xi+ y'
        nz, nq = self.B.shape[2], self.C.shape[1]
        after_q = (loop.F @ P)[..., -nq:]  # E xi+ q'
        y_q = (loop.H @ P)[..., -nq:]
        # with y and q as they are, u moves by N (-(dKp + g dKd) y + dKd q), and z by -dt dKi y
        into = _t(loop.N)
        of_y = into @ (_t(loop.J) @ Y @ after_y + _t(self.D) @ yy)
        of_q = into @ (_t(loop.J) @ Y @ after_q + _t(self.D) @ y_q)
        nx = self.A.shape[1]
        each = [-of_y, -self.dt * (Y @ after_y)[:, nx : nx + nz]]
        if len(X) == 3:
            each.append(of_q - self.g * of_y)
        gradient = np.einsum("qnab,n,nj->qjab", 2.0 * np.array(each), 1.0 / J, self.weights) / len(J)
        return float(np.log(J).mean()), gradient

    def _loop(self, X: np.ndarray) -> "_Loop":
        gains = np.einsum("nj,qjab->qnab", self.weights, X)
        Kp, Ki, Kd = gains if len(gains) == 3 else (*gains, np.zeros_like(gains[0]))
        n, nu, ny = Kp.shape
        direct = Kp + self.g * Kd
        N = np.linalg.inv(np.eye(nu) + direct @ self.D)
        wide = [np.broadcast_to(np.eye(nu), (n, nu, nu)), Kd]
        U = N @ np.concatenate([-direct @ self.C, *wide], axis=2)
        H, M = self.D @ U, np.eye(ny) - self.D @ N @ direct
        nx = self.A.shape[1]
        H[:, :, :nx] += self.C
        F = np.concatenate([self.B @ U, -self.dt * Ki @ H, (1.0 - self.a) * self.g * H], axis=1)
        F[:, :nx, :nx] += self.A
        F[:, nx : nx + nu, nx : nx + nu] += np.eye(nu)
        F[:, nx + nu :, nx + nu :] += self.a * np.eye(ny)
        G = np.concatenate([self.K - self.B @ N @ direct, -self.dt * Ki @ M, (1.0 - self.a) * self.g * M], axis=1)
        W = G @ self.noise @ _t(G)
        at = np.arange(nx, nx + nu)
        W[:, at, at] += self.load
        J = np.concatenate([self.B, -self.dt * Ki @ self.D, (1.0 - self.a) * self.g * self.D], axis=1)
        return _Loop(F, G, H, M, N, J, W)


class _Loop(NamedTuple):
    """xi+ = F xi + G e + J du, y = H xi + M e + D du, for du added to u; W: covariance of what enters xi, and the inverse N of
    I + (Kp + g Kd) D.
    """

    F: np.ndarray
    G: np.ndarray
    H: np.ndarray
    M: np.ndarray
    N: np.ndarray
    J: np.ndarray
    W: np.ndarray


def quietest(variance: Variance, task: Task, starts: Sequence[np.ndarray]) -> np.ndarray | None:
    """The gains of least variance within the bounds, of what is reached from all starts; None where that keeps them nowhere."""
    answers = [own for start in starts if (own := _from(variance, task, start)) is not None]
    return min(answers, key=lambda X: variance.log(X)[0], default=None)


def _from(variance: Variance, task: Task, start: np.ndarray) -> np.ndarray | None:
    """The gains reached from here. Where they break the bounds, though every price was paid, these are drawn in, and kept at more
    frequencies.
    """
    if variance.log(start)[0] >= LOST:
        return None
    X, room = start, 0.0
    for price in PRICES:
        X = _descended(variance, task, X, price, room)
    for _ in range(TIGHTER):
        if task.fits(X):
            return X
        room += max(task.excess(X).max() - 1.0, 0.0)
        task.look_closer(X)
        X = _descended(variance, task, X, PRICES[-1], room)
    return X if task.fits(X) else None


def _descended(variance: Variance, task: Task, X: np.ndarray, price: float, room: float) -> np.ndarray:
    free, size = task.free, task.sizes(X)

    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        at = np.zeros_like(X)
        at[free] = x * size
        value, slope = variance.log(at)
        if value < LOST:
            over, steeper = task.penalty(at, room)
            value, slope = value + price * over, slope + price * steeper
        return value, slope[free] * size

    found = minimize(cost, X[free] / size, jac=True, method="L-BFGS-B", options={"maxiter": ITERATIONS, "ftol": ACCURATE})
    answer = np.zeros_like(X)
    answer[free] = found.x * size
    return answer


def _t(M: np.ndarray) -> np.ndarray:
    return np.swapaxes(M, -1, -2)
