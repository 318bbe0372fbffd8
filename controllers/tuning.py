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
no Z is singular then. Between the frequencies that says nothing, so every step is looked at by the poles of its closed loops and
where they turn, and shortened until they are stable and the bounds are kept. So only a start can be refused; there are several:
integral action alone, as much as is kept; and of laws c P(0)^-1 drawn over all crossovers the one with most low-frequency action,
and calmer ones with at most half of its effort, as laws for tighter bounds have.

[1] Hast, Astrom, Bernhardsson, Boyd, "PID design by convex-concave optimization", European Control Conference 2013.
[2] Boyd, Hast, Astrom, "MIMO PID tuning via iterated LMI restriction", Int. J. Robust Nonlinear Control 26 (2016) 1718-1731.
"""

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from workbench.errors import InputError
from workbench.records import field, record
from workbench.robustness.frozen import DEFAULT, Bounds
from workbench.robustness.semidefinite import Cone, conic, vector

ROUNDS = 40  # steps after which a design that still improves is left as it is
FIRST, FEW = 4, 3  # steps that each start has before the best of them goes on; gains up to which all of them go on to the end
SOLVES = 12  # of a solver in one step; then its last answer is shortened until it is one
STARTS, CALMER, WORTH = (
    3,
    0.5,
    0.1,
)  # designs begun anew; shares of the effort that the next may need, of the action that it must have
DRAWN, AGAIN = 400, 5  # laws drawn for a start, and how often where none of them keeps the bounds
SHORTEST = 1e-2  # of a step
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
class Tuned:
    """Gains X (nq, m, nu, ny) of the parts of the law, and per plant t_i = sigma_min(P(0) Ki) and the peaks reached.

    peaks (n, 3) of |S|, |T|, |Q| over the frequencies of the programs; steps (rounds): t after each step; path (rounds + 1 ...):
    the laws from the start to X, each of which keeps the bounds.
    """

    X: np.ndarray = field("nq m nu ny")
    low_frequency: np.ndarray = field("n")
    peaks: np.ndarray = field("n 3")
    steps: np.ndarray = field("rounds")
    path: np.ndarray = field("k nq m nu ny")


@record
class Tuning:
    """What is tuned: a law on plants, within bounds.

    weights (n, m): basis functions at the plants' schedule values. parts(omega) (N, nq): what the gains are multiplied with,
    in the order proportional, integral, rest. omega (N,): frequencies in rad/s at which the bounds are kept. goals (n,): t_i,
    what each plant alone reaches; default 1. allowed (nu, ny): entries of the gains that may differ from 0. closed: of gains X
    the frequencies that the poles of all closed loops turn at, where the bounds are looked at too, or None where a pole is
    unstable; without it a design begins with integral action alone, and nothing but `omega` says that the loops stay stable.
    room: the programs keep the bounds by this share more, for what lies between their frequencies.
    """

    plants: Sequence[Frozen]
    weights: np.ndarray
    parts: Callable[[np.ndarray], np.ndarray]
    omega: np.ndarray
    bounds: Bounds = DEFAULT
    goals: np.ndarray | None = None
    allowed: np.ndarray | None = None
    closed: Callable[[np.ndarray], np.ndarray | None] | None = None
    room: float = 0.0


def tune(tuning: Tuning, *, starts: Sequence[np.ndarray] = (), enough: float = 1e-4) -> Tuned:
    """Gains that maximise low-frequency action for every plant at once, within the bounds; see the module.

    starts: gains to begin from, the first of them that keeps the bounds, or gains near the first of all that do; without one it
    begins anew, several times, and the best is taken. enough: relative gain of t in a step below which the design is done.
    Raises InputError where P(0) leaves no integral action, or where no start keeps the bounds.
    """
    task = Task(tuning)
    begun = task.from_given(starts) or task.starts()
    first = ROUNDS if len(begun) == 1 or len(task.free[0]) <= FEW else FIRST
    tried = [task.climbed([X], enough, first) for X in begun]
    path = task.climbed(max(tried, key=lambda path: task.worst(path[-1])), enough, ROUNDS)
    steps = np.array([task.worst(X) for X in path[1:]])
    return Tuned(path[-1], task.low_frequency(path[-1]), task.peaks(path[-1]), steps, np.array(path))


class Task:
    """The programs of one design: plants and parts at all frequencies, and the bounds with room to spare."""

    def __init__(self, tuning: Tuning):
        plants, bounds, goals, allowed = tuning.plants, tuning.bounds, tuning.goals, tuning.allowed
        self.plants, self.parts_at, self.closed = plants, tuning.parts, tuning.closed
        self.P0 = np.stack([plant.gain for plant in plants])
        self.weights = np.asarray(tuning.weights, dtype=float)
        self.omega = np.empty(0)
        self.sparse = self.skeleton = np.empty(0, dtype=bool)
        self._look_at(np.asarray(tuning.omega, dtype=float))
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
        self.limits *= 1.0 - tuning.room
        self.at_input = bounds.broken == "input"
        self.shape = (self.parts.shape[1], self.weights.shape[1], nu, ny)
        allowed = np.ones((nu, ny), dtype=bool) if allowed is None else np.asarray(allowed, dtype=bool)
        self.mask = np.broadcast_to(allowed, self.shape)
        self.free = np.nonzero(self.mask)  # (q, j, a, b) of every variable
        self.skeleton, self.sparse = np.arange(N) % max(1, N // 12) == 0, np.arange(N) % 3 == 0

    def _look_at(self, omega: np.ndarray) -> np.ndarray:
        """Have the bounds kept at these frequencies too; where the old ones stand now."""
        known = self.omega
        self.omega = np.union1d(known, omega)
        at = np.searchsorted(self.omega, known)
        self.P = np.stack([plant.response(self.omega) for plant in self.plants])  # (n, N, ny, nu)
        self.parts = self.parts_at(self.omega)
        for name in ("skeleton", "sparse"):
            wider = np.zeros(len(self.omega), dtype=bool)
            wider[at] = getattr(self, name)
            setattr(self, name, wider)
        return at

    # ---- what gains do -------------------------------------------------------------------------------------------------

    def _laws(self, X: np.ndarray, parts: np.ndarray | None = None) -> np.ndarray:
        """K (n, N, nu, ny)."""
        return np.einsum("wq,ij,qjab->iwab", self.parts if parts is None else parts, self.weights, X)

    def low_frequency(self, X: np.ndarray) -> np.ndarray:
        """sigma_min(P(0) Ki), (n,)."""
        return np.linalg.svd(self._low(X), compute_uv=False)[:, -1]

    def _low(self, X: np.ndarray) -> np.ndarray:
        return self.P0 @ np.einsum("ij,jab->iab", self.weights, X[1])

    def _norms(self, X: np.ndarray, P: np.ndarray | None = None, parts: np.ndarray | None = None) -> np.ndarray:
        """|S|, |T|, |Q| by plant and frequency, (n, N, 3)."""
        S, T, Q, _ = self._sensitivities(self.P if P is None else P, self._laws(X, parts))
        return np.stack([_size(M) for M in (S, T, Q)], axis=-1)

    def _sensitivities(self, P: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """S, T, Q and (I + P K)^-1."""
        L = K @ P if self.at_input else P @ K
        S, outer = np.linalg.inv(np.eye(L.shape[-1]) + L), np.linalg.inv(np.eye(P.shape[2]) + P @ K)
        return S, L @ S, K @ outer, outer

    def excess(self, X: np.ndarray) -> np.ndarray:
        """The norms as parts of what is allowed."""
        return self._norms(X) / self.limits[:, None]

    def peaks(self, X: np.ndarray) -> np.ndarray:
        return self._norms(X).max(axis=1)

    def sizes(self, X: np.ndarray) -> np.ndarray:
        """What each variable is counted in: what every part does at the crossover sets the scale of its gains."""
        gain = np.linalg.norm(self._laws(X) @ self.P, axis=(-2, -1)).mean(axis=0)
        own = np.abs(self.parts[np.abs(np.log(gain)).argmin()])[:, None, None, None]
        return np.maximum(np.abs(X), 0.1 * (np.abs(X) * own).max() / own)[self.free]

    def penalty(self, X: np.ndarray, room: float = 0.0) -> tuple[float, np.ndarray]:
        """Sum over frequencies of max(0, |M| / ((1 - room) limit) - 1)^2 for M = S, T, Q, mean over the plants, and its gradient.

        With singular vectors u, v of M: d|M| = Re(u* dM v), dS = -S dL S, dT = -dS, dQ = S dK (I + P K)^-1.
        """
        P, K = self.P, self._laws(X)
        *norms, outer = self._sensitivities(P, K)
        inner = np.eye(K.shape[2]) - norms[2] @ P  # (I + K P)^-1
        limits = self.limits * (1.0 - room)
        value, gradient = 0.0, np.zeros(self.shape)
        for kind, M in enumerate(norms):
            limit = limits[:, kind, None]
            i, w = np.nonzero(np.linalg.norm(M, axis=(-2, -1)) > limit)  # the spectral norm is no larger than this one
            left, sigma, right = np.linalg.svd(M[i, w], full_matrices=False)
            over = np.maximum(sigma[:, 0] / limits[i, kind] - 1.0, 0.0)
            # d|M| = Re(a* dK b)
            a, b = left[:, :, :1], _adjoint(right[:, :1])
            if kind == 2:
                a, b = _adjoint(inner[i, w]) @ a, outer[i, w] @ b
            elif self.at_input:  # dL = dK P
                a, b = _adjoint(inner[i, w]) @ a, P[i, w] @ inner[i, w] @ b
            else:  # dL = P dK
                a, b = _adjoint(outer[i, w] @ P[i, w]) @ a, outer[i, w] @ b
            sign = -1.0 if kind == 0 else 1.0
            value += float(over @ over)
            slope = 2.0 * sign * over / limits[i, kind]
            gradient += np.einsum(
                "m,mq,mj,mab->qjab", slope, self.parts[w], self.weights[i], np.conj(a) @ np.swapaxes(b, 1, 2)
            ).real
        return value / len(P), gradient / len(P)

    def stable(self, X: np.ndarray) -> bool:
        return self.closed is None or self.closed(X) is not None

    def fits(self, X: np.ndarray) -> bool:
        """Whether gains keep the bounds at every frequency, and every loop stable; also where its own poles turn."""
        if self.excess(X).max() > 1.0 + SLACK:
            return False
        if self.closed is None:
            return True
        turning = self.closed(X)
        return turning is not None and (len(turning) == 0 or bool(self._elsewhere(X, turning).max() <= 1.0 + SLACK))

    def look_closer(self, X: np.ndarray) -> None:
        """Have the bounds kept where the poles of the loops turn too, if gains break them there."""
        turning = self.closed(X) if self.closed else None
        if turning is not None and len(turning):
            self._look_at(turning[np.any(self._elsewhere(X, turning) > 1.0 + SLACK, axis=(0, 2))])

    def _elsewhere(self, X: np.ndarray, omega: np.ndarray) -> np.ndarray:
        """`excess` at other frequencies."""
        P = np.stack([plant.response(omega) for plant in self.plants])
        return self._norms(X, P, self.parts_at(omega)) / self.limits[:, None]

    # ---- where to begin ------------------------------------------------------------------------------------------------

    def near(self, X: np.ndarray) -> np.ndarray | None:
        """X where it fits, else the answer of the program at X, which may fit all the same; or None."""
        if self.fits(X):
            return X
        found = self._solved_at(X)
        return found if found is not None and self.fits(found) else None

    def from_given(self, starts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """One that fits of these or near the first, which is the most wanted; or none."""
        for number, X in enumerate(starts):
            found = self.near(X) if number == 0 else X if self.fits(X) else None
            if found is not None:
                return [found]
        return []

    def starts(self) -> list[np.ndarray]:
        """Laws that fit: integral action alone, and the best of those drawn, each calmer than the last."""
        inverse, reason = self._inverse()
        found = [] if reason else self._integral_alone(inverse)
        random = np.random.default_rng(0)
        for _ in range(AGAIN if self.closed else 0):
            found += self._best_of_drawn(inverse, random, STARTS - len(found))
            if found:
                break
        if found:
            return found
        raise InputError(
            reason or "no law was found that keeps the bounds",
            mend="more knots, or allow more entries" if reason else "loosen the bounds",
        )

    def _inverse(self) -> tuple[np.ndarray, str]:
        """W (m, nu, ny), as near to P_i(0)^-1 at every plant as the structure lets it be; and what forbids integral action by it.

        For small epsilon the law Ki = epsilon W is stable with S near 1 on every stable plant with P(0) W > 0; from there on |S|
        stays bounded, so no pole crosses.
        """
        wanted = np.linalg.pinv(self.P0).reshape(len(self.P0), -1)
        W = np.linalg.lstsq(self.weights, wanted, rcond=None)[0].reshape(self.shape[1:]) * self.mask[1]
        low = self.P0 @ np.einsum("ij,jab->iab", self.weights, W)
        suits = np.linalg.eigvalsh(low + np.swapaxes(low, -1, -2)).min() > 0.0
        return W, "" if suits else "no integral action of this structure suits every plant"

    def _integral_alone(self, W: np.ndarray) -> list[np.ndarray]:
        """Ki = epsilon W, the most that fits, found from below in steps of two; none where even the smallest does not."""
        X = np.zeros(self.shape)
        X[1] = 1e-6 / np.abs(self.parts[:, 1]).min() * W
        if not self.fits(X):
            return []
        while self.fits(2.0 * X):
            X = 2.0 * X
        return [X]

    def _best_of_drawn(self, W: np.ndarray, random: np.random.Generator, count: int) -> list[np.ndarray]:
        """Of laws sum_q c_q part_q W the one that fits with most low-frequency action, and calmer ones; of none the nearest.

        c: what each part does to the loop at a crossover that is drawn too, of either sign.
        """
        law = np.einsum("ij,jab->iab", self.weights, W)
        loop = np.linalg.norm(law[:, None] @ self.P, axis=(-2, -1)).mean(axis=0)
        nq = self.shape[0]
        at = random.integers(len(loop), size=DRAWN)
        size = 10.0 ** random.uniform(-2.5, 1.0, (DRAWN, nq)) * random.choice([-1.0, 1.0], (DRAWN, nq), p=[0.25, 0.75])
        drawn = [np.einsum("q,jab->qjab", c, W) * self.mask for c in size / (np.abs(self.parts[at]) * loop[at, None])]
        excess = [self.excess(X).max(axis=(0, 1)) for X in drawn]
        kept = sorted((i for i in range(DRAWN) if excess[i].max() <= 1.0), key=lambda i: -self.worst(drawn[i]))
        found, effort = [], np.inf
        for i in kept:
            if found and self.worst(drawn[i]) < WORTH * self.worst(found[0]):
                break
            if len(found) < count and excess[i][2] <= effort and self.stable(drawn[i]):
                found, effort = [*found, drawn[i]], CALMER * excess[i][2]
        if found:
            return found
        nearest = (X for X in sorted(drawn, key=lambda X: self.excess(X).max())[: DRAWN // 10] if self.stable(X))
        tried = (self.near(X) for X, _ in zip(nearest, range(count), strict=False))
        return [X for X in tried if X is not None]

    # ---- one step ------------------------------------------------------------------------------------------------------

    def worst(self, X: np.ndarray) -> float:
        """t."""
        return float((self.low_frequency(X) / self.goals).min())

    def climbed(self, path: list[np.ndarray], enough: float, rounds: int) -> list[np.ndarray]:
        """Step after step on from a path, each with more low-frequency action, until there is no more to gain."""
        path, gains = list(path), [self.worst(X) for X in path]
        while len(path) <= rounds and not (len(path) > 2 and gains[-1] <= gains[-2] * (1.0 + enough)):
            path.append(self._improved(path[-1]))
            gains.append(self.worst(path[-1]))
        return path

    def _improved(self, X: np.ndarray) -> np.ndarray:
        """The gains of the program that is tight at X, or as far on the way there as they fit; X where that gains nothing."""
        found, share = self._solved_at(X), 1.0
        while found is not None and share > SHORTEST:
            between = X + share * (found - X)
            if self.worst(between) > self.worst(X) and self.fits(between):
                return between
            share *= 0.5
        return X

    def _solved_at(self, X: np.ndarray) -> np.ndarray | None:
        """The answer of the program at X: bounds enter where they are near, and where an answer broke them, until none does."""
        norms = self._norms(X)
        size = norms / self.limits[:, None]
        # where the loop gain is high the bounds are out of reach, and their numbers too large for a solver
        chosen = (size > NEAR) & (self.sparse[:, None] | _peaks(size)) | (self.skeleton[:, None] & (norms[..., :1] > 0.1))
        found = None
        for _ in range(SOLVES):
            found = self._solved(X, chosen)
            if found is None:
                return None
            size = self.excess(found)
            broken = size > 1.0 + SLACK
            broken[..., 0] |= self._turned(X, found)
            new = broken & ~chosen
            if not new.any():  # kept where it was looked at, or the solver's answer is not good enough
                turning = self.closed(found) if self.closed else None
                if turning is None or len(turning) == 0:
                    return found
                over = self._elsewhere(found, turning) > 1.0 + SLACK
                if not over.any():
                    return found
                before = chosen
                at = self._look_at(turning[over.any(axis=(0, 2))])
                chosen = np.zeros((len(over), len(self.omega), 3), dtype=bool)
                chosen[:, at] = before
                new = (self.excess(found) > 1.0 + SLACK) & ~chosen
                size = self.excess(found)
            some = new & (_peaks(size) | self.sparse[:, None])
            chosen |= some if some.any() else new
        return found

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
        scale = self.sizes(X)
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


def _size(M: np.ndarray) -> np.ndarray:
    """Spectral norms of matrices (..., k, l)."""
    return np.abs(M[..., 0, 0]) if M.shape[-2:] == (1, 1) else np.linalg.norm(M, 2, axis=(-2, -1))


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
