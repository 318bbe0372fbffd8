"""PID gains under bounds on robustness, as a sequence of convex programs.

    maximise t   such that   sigma_min(P_i(0) Ki(rho_i)) >= t t_i                                  low-frequency action
                             |S| <= Ms,  |S| at the loop broken where it is asked for: S = (I + L)^-1
                             |T| <= Mt,  T = L (I + L)^-1
                             |Q| <= Mq,  Q = K (I + P K)^-1                                        control effort
    for every frozen plant P_i, with K(rho_i) = sum_q sum_j phi_j(rho_i) part_q(omega) X_qj

Each bound |Y Z^-1| <= 1 with Z = I + L is Z* Z >= Y* Y, and for every matrix V

    Z* V + V* Z - V* V >= Y* Y   implies   Z* Z >= Y* Y

which is a linear matrix inequality in the gains, and tight for V = Z of the last gains [2]. Where Y = I / Ms is constant,
V = U / Ms with the unitary factor U of Z leaves more room: (Z* U + U* Z) / 2 >= I / Ms; for one loop this is the half plane of
[1]. Gains that keep the bounds stay allowed in the next program, so t never falls. The answer is a local optimum.

Z stays in the half space of its last value at every frequency, also where no bound is near: on the straight way between two gains
no Z is singular then, and the loop stays as stable as the first one, integral action alone, was.

[1] Hast, Astrom, Bernhardsson, Boyd, "PID design by convex-concave optimization", European Control Conference 2013.
[2] Boyd, Hast, Astrom, "MIMO PID tuning via iterated LMI restriction", Int. J. Robust Nonlinear Control 26 (2016) 1718-1731.
"""

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from workbench.errors import InputError
from workbench.records import field, record
from workbench.robustness.semidefinite import Cone, conic, vector

ROUNDS = 40  # programs after which a design that still improves is left as it is
NEAR = 0.9  # of a bound, from where on it enters the program
SLACK = 1e-4  # by which a solver's answer may break a bound
ACCURACY = 1e-8  # of the solver


class Frozen(Protocol):
    """A plant at one schedule value, as far as tuning looks at it."""

    @property
    def rho(self) -> float | None: ...
    @property
    def gain(self) -> np.ndarray:
        """P(0), (ny, nu)."""
        ...

    def response(self, omega: np.ndarray) -> np.ndarray:
        """P(j omega), (len(omega), ny, nu)."""
        ...


@record
class Bounds:
    """What a design must keep: peaks of S and T as spectral norms, and of the control effort Q.

    effort: largest |Q| as a multiple of 1 / sigma_min(P(0)), the least that any law with integral action needs. broken: where the
    loop is opened for S and T, "input" or "output" of the plant.
    """

    sensitivity: float = field("", low=1.0 + 1e-9, default=1.6)
    complementary: float = field("", low=1.0 + 1e-9, default=1.6)
    effort: float = field("", low=1.0 + 1e-9, default=3.0)
    broken: str = "input"

    def __post_init__(self):
        if self.broken not in ("input", "output"):
            raise InputError(f"a loop broken at the {self.broken!r}", mend="broken is 'input' or 'output'")


DEFAULT = Bounds()


@record
class Tuned:
    """Gains X (nq, m, nu, ny) of the parts of the law, and per plant t_i = sigma_min(P(0) Ki) and the peaks reached.

    peaks (n, 3) of |S|, |T|, |Q| over the frequencies of the programs; rounds: programs solved; steps (rounds): t after each.
    """

    X: np.ndarray = field("nq m nu ny")
    low_frequency: np.ndarray = field("n")
    peaks: np.ndarray = field("n 3")
    steps: np.ndarray = field("rounds")


def tune(
    plants: Sequence[Frozen],
    weights: np.ndarray,
    parts: Callable[[np.ndarray], np.ndarray],
    omega: np.ndarray,
    bounds: Bounds = DEFAULT,
    *,
    goals: np.ndarray | None = None,
    allowed: np.ndarray | None = None,
    start: np.ndarray | None = None,
    room: float = 0.0,
    enough: float = 1e-4,
) -> Tuned:
    """Gains that maximise low-frequency action for every plant at once, within the bounds; see the module.

    weights (n, m): basis functions at the plants' schedule values. parts(omega) (N, nq): what the gains are multiplied with,
    in the order proportional, integral, rest. omega (N,): frequencies in rad/s at which the bounds are kept. goals (n,): t_i,
    what each plant alone reaches; default 1. allowed (nu, ny): entries of the gains that may differ from 0. start: gains to
    begin from, where a program near them keeps the bounds; else integral action alone. room: the programs keep the bounds by this
    share more, for what lies between their frequencies. enough: relative gain of t in a round below which the design is done.
    Raises InputError where P(0) leaves no integral action, or where no start keeps the bounds.
    """
    task = _Task(plants, weights, parts, omega, bounds, goals, allowed, room)
    X = None if start is None else task.allowed(np.asarray(start, dtype=float))
    X = task.start() if X is None else X
    steps: list[float] = []
    while len(steps) < ROUNDS:
        X, t = task.improved(X)
        steps.append(t)
        if len(steps) > 1 and t <= steps[-2] * (1.0 + enough):
            break
    return Tuned(X, task.low_frequency(X), task.peaks(X), np.array(steps))


class _Task:
    """The programs of one design: plants and parts at all frequencies, and the bounds with room to spare."""

    def __init__(self, plants, weights, parts, omega, bounds, goals, allowed, room):
        self.P = np.stack([plant.response(omega) for plant in plants])  # (n, N, ny, nu)
        self.P0 = np.stack([plant.gain for plant in plants])
        self.weights, self.parts = np.asarray(weights, dtype=float), parts(omega)
        self.goals = np.ones(len(plants)) if goals is None else np.asarray(goals, dtype=float)
        n, N, ny, nu = self.P.shape
        smallest = np.linalg.svd(self.P0, compute_uv=False)[:, ny - 1 :].min(axis=1) if ny <= nu else np.zeros(n)
        for plant, sigma, P0 in zip(plants, smallest, self.P0, strict=True):
            if not sigma > 1e-9 * np.linalg.norm(P0):
                at = "" if plant.rho is None else f" at {plant.rho:g}"
                raise InputError(
                    f"the steady gains{at} cannot move every output on its own: {np.round(P0, 6).tolist()}",
                    mend="leave out an output, or add an input",
                )
        self.limits = np.empty((n, 3))
        self.limits[:, :2] = bounds.sensitivity, bounds.complementary
        self.limits[:, 2] = bounds.effort / smallest
        self.limits *= 1.0 - room
        self.at_input = bounds.broken == "input"
        self.shape = (self.parts.shape[1], self.weights.shape[1], nu, ny)
        allowed = np.ones((nu, ny), dtype=bool) if allowed is None else np.asarray(allowed, dtype=bool)
        self.free = np.nonzero(np.broadcast_to(allowed, self.shape))  # (q, j, a, b) of every variable
        self.skeleton = np.zeros(N, dtype=bool)
        self.skeleton[:: max(1, N // 12)] = True
        self.sparse = np.arange(N) % 3 == 0

    # ---- what gains do -------------------------------------------------------------------------------------------------

    def _laws(self, X: np.ndarray) -> np.ndarray:
        """K (n, N, nu, ny)."""
        return np.einsum("wq,ij,qjab->iwab", self.parts, self.weights, X)

    def low_frequency(self, X: np.ndarray) -> np.ndarray:
        """sigma_min(P(0) Ki), (n,)."""
        return np.linalg.svd(self._low(X), compute_uv=False)[:, -1]

    def _low(self, X: np.ndarray) -> np.ndarray:
        return self.P0 @ np.einsum("ij,jab->iab", self.weights, X[1])

    def _norms(self, X: np.ndarray) -> np.ndarray:
        """|S|, |T|, |Q| by plant and frequency, (n, N, 3)."""
        K, L = self._laws(X), self._loops(X)
        S = np.linalg.inv(np.eye(L.shape[-1]) + L)
        Q = K @ np.linalg.inv(np.eye(self.P.shape[2]) + self.P @ K)
        return np.stack([np.linalg.norm(M, 2, axis=(-2, -1)) for M in (S, L @ S, Q)], axis=-1)

    def excess(self, X: np.ndarray) -> np.ndarray:
        """The norms as parts of what is allowed."""
        return self._norms(X) / self.limits[:, None]

    def peaks(self, X: np.ndarray) -> np.ndarray:
        return self._norms(X).max(axis=1)

    def start(self) -> np.ndarray:
        """Integral action alone, Ki = epsilon P(0)^-1: the most that keeps the bounds, found from below in steps of two.

        For small epsilon it is stable with S near 1 on every stable plant; from there on |S| stays bounded, so no pole crosses.
        """
        wanted = np.linalg.pinv(self.P0).reshape(len(self.P0), -1)
        X = np.zeros(self.shape)
        X[1] = np.linalg.lstsq(self.weights, wanted, rcond=None)[0].reshape(self.shape[1:])
        mask = np.zeros(self.shape, dtype=bool)
        mask[self.free] = True
        X *= mask
        symmetric = self._low(X) + np.swapaxes(self._low(X), -1, -2)
        if np.linalg.eigvalsh(symmetric).min() <= 0.0:
            raise InputError("no integral action of this structure suits every plant", mend="more knots, or allow more entries")
        epsilon = 1e-6 / np.abs(self.parts[:, 1]).min()
        if self.excess(epsilon * X).max() > 1.0:
            raise InputError("even the smallest integral action breaks the bounds", mend="loosen the bounds")
        while self.excess(2.0 * epsilon * X).max() <= 1.0:
            epsilon *= 2.0
        return epsilon * X

    # ---- one program ---------------------------------------------------------------------------------------------------

    def allowed(self, X: np.ndarray) -> np.ndarray | None:
        """X where it keeps the bounds, else the answer of the program at X, which may have one all the same; or none."""
        return X if self.excess(X).max() <= 1.0 else self._kept(X)

    def improved(self, X: np.ndarray) -> tuple[np.ndarray, float]:
        """The gains of the program that is tight at X, and their t; X itself where it gains nothing."""
        found = self._kept(X)
        best = max((X, found), key=self._worst) if found is not None else X
        return best, self._worst(best)

    def _worst(self, X: np.ndarray) -> float:
        return float((self.low_frequency(X) / self.goals).min())

    def _kept(self, X: np.ndarray) -> np.ndarray | None:
        """The answer of the program at X: bounds enter where they are near, and where an answer broke them, until none does."""
        norms = self._norms(X)
        size = norms / self.limits[:, None]
        # where the loop gain is high the bounds are out of reach, and their numbers too large for a solver
        chosen = (size > NEAR) & (self.sparse[:, None] | _peaks(size)) | (self.skeleton[:, None] & (norms[..., :1] > 0.1))
        while (found := self._solved(X, chosen)) is not None:
            size = self.excess(found)
            broken = size > 1.0 + SLACK
            broken[..., 0] |= self._turned(X, found)
            if not broken.any():
                return found
            if not (broken & ~chosen).any():  # the solver's answer is not good enough
                return None
            chosen |= broken & (_peaks(size) | self.sparse[:, None])
            if not (broken & chosen).any():
                chosen |= broken
        return None

    def _turned(self, X: np.ndarray, found: np.ndarray) -> np.ndarray:
        """Where I + L left the half space of its last value, (n, N): the way between the two may pass a singular matrix.

        A bound on |S| does not see it where the loop gain is high, and the closed loop may have lost its stability.
        """
        before, after = (np.eye(L.shape[-1]) + L for L in (self._loops(X), self._loops(found)))
        turned = _adjoint(_unitary(before)) @ after
        return np.linalg.eigvalsh(turned + _adjoint(turned))[..., 0] <= 0.0

    def _loops(self, X: np.ndarray) -> np.ndarray:
        """L (n, N, k, k) at the loop that is broken."""
        K = self._laws(X)
        return K @ self.P if self.at_input else self.P @ K

    def _solved(self, X: np.ndarray, chosen: np.ndarray) -> np.ndarray | None:
        # what every part does at the crossover sets the scale of its gains
        gain = np.linalg.norm(self._laws(X) @ self.P, axis=(-2, -1)).mean(axis=0)
        own = np.abs(self.parts[np.abs(np.log(gain)).argmin()])[:, None, None, None]
        size = np.maximum(np.abs(X), 0.1 * (np.abs(X) * own).max() / own)
        scale = size[self.free]
        limits = [cone for F, f in self._inequalities(X, chosen, scale) for cone in cones(F, f)]
        goal = np.append(np.zeros(len(scale)), 1.0)  # the gains in units of `scale`, and t
        x = conic(goal, limits, ACCURACY)  # an inaccurate answer is looked at, not believed
        if x is None:
            return None
        answer = np.zeros(self.shape)
        answer[self.free] = x[:-1] * scale
        return answer

    def _inequalities(self, X: np.ndarray, chosen: np.ndarray, scale: np.ndarray):
        """Affine Hermitian matrices f + sum_v x_v F_v >= 0: pairs of F (M, nv + 1, k, k) and f (M, k, k)."""
        q, j, a, b = self.free
        laws = self._laws(X)
        for kind in range(3):
            i, w = np.nonzero(chosen[:, :, kind])
            if len(i) == 0:
                continue
            P, K = self.P[i, w], laws[i, w]
            limit = self.limits[i, kind][:, None, None]
            dK = np.zeros((len(i), len(scale) + 1, *K.shape[1:]), dtype=complex)
            dK[:, np.arange(len(scale)), a, b] = self.parts[w][:, q] * self.weights[i][:, j] * scale
            if kind < 2 and self.at_input:
                L, dL = K @ P, dK @ P[:, None]
            else:
                L, dL = P @ K, P[:, None] @ dK
            Z = np.eye(L.shape[-1]) + L
            if kind == 0:
                U = _unitary(Z)
                F = 0.5 * (_adjoint(dL) @ U[:, None] + _adjoint(U)[:, None] @ dL)
                yield _scaled(F, 0.5 * (U + _adjoint(U)) - np.eye(U.shape[-1]) / limit)
                continue
            F, f = _adjoint(dL) @ Z[:, None] + _adjoint(Z)[:, None] @ dL, Z + _adjoint(Z) - _adjoint(Z) @ Z
            # [Z* V + V* Z - V* V, Y*; Y, I] >= 0
            dY = dL if kind == 1 else dK
            yield _scaled(*_bordered(F, f, dY / limit[:, None]))
        U = _unitary(self._low(X))
        integral = q == 1
        dKi = np.zeros((len(self.P0), len(scale) + 1, *self.shape[2:]))
        dKi[:, np.arange(len(scale))[integral], a[integral], b[integral]] = self.weights[:, j[integral]] * scale[integral]
        low = self.P0[:, None] @ dKi
        F = 0.5 * (_adjoint(low) @ U[:, None] + _adjoint(U)[:, None] @ low)
        F[:, -1] = -self.goals[:, None, None] * np.eye(U.shape[-1])
        yield _scaled(F, np.zeros_like(U))


def _peaks(size: np.ndarray) -> np.ndarray:
    """Where a quantity (n, N, ...) is largest among its neighbours in frequency."""
    edge = np.full_like(size[:, :1], -np.inf)
    wide = np.concatenate([edge, size, edge], axis=1)
    return (size >= wide[:, :-2]) & (size >= wide[:, 2:])


def _adjoint(M: np.ndarray) -> np.ndarray:
    return np.conj(np.swapaxes(M, -1, -2))


def _unitary(M: np.ndarray) -> np.ndarray:
    """The unitary factor of M = U H, H >= 0."""
    left, _, right = np.linalg.svd(M)
    return left @ right


def _bordered(F: np.ndarray, f: np.ndarray, dY: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[f, 0; 0, I] + sum_v x_v [F_v, dY_v*; dY_v, 0]."""
    k, r = f.shape[-1], dY.shape[-2]
    G, g = np.zeros((*F.shape[:2], k + r, k + r), dtype=complex), np.zeros((len(f), k + r, k + r), dtype=complex)
    G[..., :k, :k], G[..., k:, :k], G[..., :k, k:] = F, dY, _adjoint(dY)
    g[:, :k, :k], g[:, k:, k:] = f, np.eye(r)
    return G, g


def _scaled(F: np.ndarray, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same inequalities with entries of about one: at low frequencies they are larger by the square of the loop gain."""
    d = np.maximum(np.abs(F).max(axis=1), np.abs(f))
    d = 1.0 / np.sqrt(np.einsum("mkk->mk", d))  # congruence with a diagonal
    return F * d[:, None, :, None] * d[:, None, None, :], f * d[:, :, None] * d[:, None, :]


def cones(F: np.ndarray, f: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, Cone]]:
    """f + sum_v x_v F_v >= 0 for each of M Hermitian matrices of size k, F (M, nv, k, k), as cones of the smallest kind."""
    k = F.shape[-1]
    every: Any = np.concatenate([F, f[:, None]], axis=1)
    if k == 1:
        rows = every[..., 0, 0].real
        return [(-rows[:, :-1], rows[:, -1], Cone.NONNEGATIVE)]
    if k == 2:  # (p, c; c*, d) >= 0 is |(2 c, p - d)| <= p + d
        p, d, c = every[..., 0, 0].real, every[..., 1, 1].real, 2.0 * every[..., 0, 1]
        rows = np.stack([p + d, c.real, c.imag, p - d], axis=1)
        return [(-own[:, :-1], own[:, -1], Cone.SECOND_ORDER) for own in rows]
    if np.iscomplexobj(every):  # H >= 0 is (Re H, -Im H; Im H, Re H) >= 0
        R, J = every.real, every.imag
        every = np.block([[R, -J], [J, R]])
    return [(-own[:, :-1], own[:, -1], Cone.PSD) for own in np.swapaxes(vector(every), 1, 2)]
