"""Guaranteed envelopes of a closed loop along a known run, and the parameter sequences that come near them.

    x(k+1) = A_m x(k) + q(k) + B_m w(k),        v(k) = E_m x(k) + g(k) + F_m w(k),        m = mode[k]
    w_j(k) = sum over the parameters i of channel j of delta_i(k) lam_mi z_i(k),   z(k) = C_m x(k) + f(k),   |delta_i(k)| <= 1

v are the watched signals, outputs and commands. Set-points and schedule are known and are in q, g, f and mode; delta moves as it
likes at every sample. The run begins at a start that is known, or at the rest of any machine of the boxes, which is not that of
the middle: x(0) in x_nominal(0) + T u + r, |u| <= size, |r| <= slack (`rests`). d = x - x_nominal obeys the same equations,
without q and g and with z_nominal for f. Three answers:

Kernel, of every instant. |w_j(k)| <= W_j(k), and with Phi(k, l) = A(k-1) .. A(l)

    W_j(k) = max over signs s of channel j of |s'(lam z_nom)| + sum_l,c |s'(lam C Phi(k, l+1) B_c)| W_c(l)
    |v - v_nom| <= sum_l,c |E Phi(k, l+1) B_c| W_c(l) + |F| W(k)

and Phi(k, 0) T u beside the sums in both. Each former w_c(l) is a column Phi(k, l+1) B_c that is carried along. Columns that have
nearly died out are exchanged for a box: every |e| <= 1 sum of col_l W(l) e_l lies in sum_i [-1, 1] T_i (|T^-1 col| W)_i, whatever
T, and the n columns T_i with these weights are carried along like any other. No decay is assumed: the exchange is an outer bound
for every loop and only costs width, so it is made where it costs nearly none.

Adversary, of one (signal, instant, side). v is affine in every w_j(k) while the others stay, so that with p the gradient of the
signal in x(k+1) the best sign of w_j(k) is that of p'b_j: coordinate ascent, backward and forward; the result is replayed. The
parameters at whose rest it begins have their signs from the slope in the same way.

Dual, of one (signal, instant, side). By Cauchy w_j^2 sum_i lam_i^2 / M_i <= sum_i M_i z_i^2 for every M_i > 0. With mu_j =
1 / (sum_i lam_i^2 / M_i), for any M(k) and functions V_k(d) = d'P d + 2 q'd + c for which

    V_k(d) >= sum_i M_i z_i^2 - sum_j mu_j w_j^2 + V_k+1(A d + B w)     for all d and w       (and + E d + F w at the instant T)

side (v(T) - v_nom(T)) <= V_0(0). The smallest V is a Riccati recursion with R = diag(mu) - B'P B, as long as R > 0. It is convex
in M, with slope z_i^2 - (mu_j w_j lam_i / M_i)^2 along the run that attains it. Each inequality is one block of size
n + channels + 1 that has to be positive definite, and every block is proved for itself in outward-rounded arithmetic: nothing
accumulates, and neither the optimiser nor the recursion is trusted. d(0) is T u, which costs one block more; what happened before
a window is the box |d_i| <= e_i that the kernel knows.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit

from workbench.errors import InputError
from workbench.intervals.arithmetic import Interval, exact, positive_definite
from workbench.intervals.propagation import MOST_SIGNS, ROUNDING
from workbench.records import field, record
from workbench.robustness import rests
from workbench.robustness.rests import TINY, Rest, Start

AGE = 64  # samples after which columns of the kernel may be exchanged for a box
WIDER = 1e-4  # by which one exchange may widen what is seen, relative
YOUNG, RISEN = 8, 1e-10  # samples that a box of rounding is carried, and its share of what is seen from which it is no longer
HUGE = 1e100  # TINY is above what underflow takes from a product with two factors up to it; beyond it nothing is said
STARTS = 8  # of the adversary for each question
SWEEPS = 30
GUARD = 0.01  # R >= GUARD diag(mu): beyond, rounding decides
SOFTENED = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)  # of the size of z, added to |z| in the first multipliers
SMOOTHED = (2, 5, 10, 20, 50, 10**6)  # samples on both sides over which the slopes in the first multipliers are averaged
SPARED = 20  # samples at least that a window spares
FORGOTTEN = 1e-4  # share of what the adversary reached that a window may leave to the kernel's box
PAID = 1e-6  # of the bound, spent on the corners of blocks and on the last one
SLACK = (1e-8, 1e-6, 1e-4, 1e-10)  # of the bound, spent on P, which may cost more: a later P is carried into the earlier ones
RAISED = (1e-8, 1e-7, 1e-10)  # by how much more P is raised in every block, relative
BLENDED = (0.0, 1e-3, 1e-2, 0.1)  # share of the first multipliers, which are far from where R breaks down, in the proved ones
WORK, EVALUATIONS = 500_000, 3000  # samples that the recursion may pass in search of multipliers, and how often it may
RESTARTED = 0.1  # share of the first multipliers from which the search goes on where it got stuck near the end of what is allowed
TRIED = 2  # first multipliers that are searched from, until one leads to a proof
GAINED = 1e-3  # relative decrease of the bound below which it does not
MEMORY = 30  # pairs of the quasi-Newton method
SETTLED = 1e-5  # relative decrease of the bound over TAIL steps at which it ends
TAIL = 10
NOTHING = 1e-9  # deviation relative to the signal up to which bounds are rounding, and their ratio says nothing


@record
class Course:
    """A loop along a run, see the module. M is 1 (one loop for all samples), or as many loops as mode tells apart.

    Shapes: n states, c channels, p parameters, s watched signals, N samples. channel (p): the column of B through which parameter
    i acts. Coordinates in which the states have one size serve best: `UncertainLoop.balance`. before: what drives the loop before
    the run, in the mode of the first sample: it begins at the rest of any machine of the boxes, `start` being that of the middle.
    None: x(0) = start.
    """

    A: np.ndarray = field("M n n")
    B: np.ndarray = field("M n c")
    C: np.ndarray = field("M p n")
    E: np.ndarray = field("M s n")
    F: np.ndarray = field("M s c")
    lam: np.ndarray = field("M p", low=0.0)
    channel: np.ndarray = field("p", low=0.0)
    mode: np.ndarray = field("N", low=0.0)
    q: np.ndarray = field("N n")
    g: np.ndarray = field("N s")
    f: np.ndarray = field("N p")
    start: np.ndarray = field("n")
    signals: tuple[str, ...]
    before: Rest | None = None

    def __post_init__(self):
        for name, value in (*vars(self).items(), *(vars(self.before).items() if self.before else ())):
            if name not in ("signals", "before") and not np.all(np.isfinite(value)):
                raise InputError(f"{name} holds a value that is not finite", file="Course")
        M, _, c = self.B.shape
        if len(self.mode) == 0 or len(self.start) == 0:
            raise InputError("no samples or no states", file="Course", mend="give at least one of each")
        if np.any((self.mode % 1 != 0) | (self.mode >= M)):
            raise InputError(f"mode must be an integer from 0 to {M - 1}", file="Course")
        if np.any((self.channel % 1 != 0) | (self.channel >= c)):
            raise InputError(f"channel must be an integer from 0 to {c - 1}", file="Course")
        if self.before and (len(self.before.q) != len(self.start) or len(self.before.f) != self.f.shape[1]):
            raise InputError("the rest before the run is of another loop", file="Course")
        if len(self.signals) != self.E.shape[1] or len(set(self.signals)) < len(self.signals):
            raise InputError(f"{self.E.shape[1]} watched signals, named {', '.join(self.signals)}", file="Course")

    def __len__(self) -> int:
        return len(self.mode)

    @property
    def modes(self) -> np.ndarray:
        """mode[k] as integers, (N,)."""
        return self.mode.astype(int)

    @property
    def members(self) -> np.ndarray:
        """(p c): 1 where parameter i belongs to channel j."""
        return np.eye(self.B.shape[2])[self.channel.astype(int)]

    def at(self, delta: np.ndarray) -> "Course":
        """The course with these parameters (p) at all samples, from their rest; those that are not 0 are no longer uncertain.

        Where they have no rest it begins at `start`.
        """
        delta = np.asarray(delta, dtype=float)
        gain = self.members.T * (self.lam * delta)[:, None, :]  # w = gain z of these
        BD, FD = self.B @ gain, self.F @ gain
        f, before, first = self.f[..., None], self.before, int(self.modes[0])
        if before is not None:
            q, Q = before.q + BD[first] @ before.f, before.Q + BD[first] @ before.J
            before = replace(before, q=q, Q=Q) if self.rests(delta[None])[0] else None
        return replace(
            self,
            A=self.A + BD @ self.C,
            E=self.E + FD @ self.C,
            q=self.q + (BD[self.modes] @ f)[..., 0],
            g=self.g + (FD[self.modes] @ f)[..., 0],
            lam=np.where(delta != 0.0, 0.0, self.lam),
            start=self.begun(delta[None])[0],
            before=before,
        )

    def rests(self, delta: np.ndarray) -> np.ndarray:
        """Whether the machines with parameters delta (R p) come to rest before the run, (R,); none where `start` is known."""
        if self.before is None:
            return np.zeros(len(delta), dtype=bool)
        i = int(self.modes[0])
        A = self.A[i] + (self.B[i][:, self.channel.astype(int)] * self.lam[i] * delta[:, None, :]) @ self.C[i]
        return np.abs(np.linalg.eigvals(A)).max(axis=1) < 1.0

    def begun(self, delta: np.ndarray, share: np.ndarray | None = None) -> np.ndarray:
        """Where runs begin, (R n): at rest with parameters delta (R p), at shares (R g) of what is open of the set-points before.

        Those that do not come to rest begin at `start`.
        """
        before, i = self.before, int(self.modes[0])
        start = np.tile(self.start, (len(delta), 1))
        at = np.flatnonzero(self.rests(delta))
        if before is None or not len(at):
            return start
        e = np.zeros((len(delta), before.Q.shape[1])) if share is None else np.asarray(share, dtype=float)
        BD = self.B[i][:, self.channel.astype(int)] * (self.lam[i] * delta[at])[:, None, :]
        q, f = before.q + e[at] @ before.Q.T, before.f + e[at] @ before.J.T
        left = np.eye(len(self.start)) - self.A[i] - BD @ self.C[i]
        start[at] = np.linalg.solve(left, (q + (BD @ f[..., None])[..., 0])[..., None])[..., 0]
        return start

    def number(self, signal: str) -> int:
        """Which of the watched signals it is."""
        if signal not in self.signals:
            raise InputError(f"no watched signal {signal}", file="Course", mend=f"one of {', '.join(self.signals)}")
        return self.signals.index(signal)


@record
class Nominal:
    """The run with every delta at zero: x (N n), z (N p), v (N s)."""

    x: np.ndarray = field("N n")
    z: np.ndarray = field("N p")
    v: np.ndarray = field("N s")


def nominal(course: Course) -> Nominal:
    """x(k+1) = A_m x(k) + q(k), z = C_m x + f, v = E_m x + g."""
    m, x = course.modes, np.empty(course.q.shape)
    x[0] = course.start
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(len(course) - 1):
            x[k + 1] = course.A[m[k]] @ x[k] + course.q[k]
        z = np.einsum("kpn,kn->kp", course.C[m], x) + course.f
        v = np.einsum("ksn,kn->ks", course.E[m], x) + course.g
    if not (np.all(np.isfinite(z)) and np.all(np.isfinite(v))):
        raise InputError("the nominal run overflows", file="Course", mend="the loop is unstable in the middle of the boxes")
    return Nominal(x, z, v)


def replay(course: Course, delta: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
    """v (S N s) for S parameter sequences delta (S N p) in [-1, 1]; runs that overflow continue as inf or NaN.

    start (S n): of each run; None: that of the course.
    """
    delta, m, members = np.asarray(delta, dtype=float), course.modes, course.members
    if delta.ndim != 3 or delta.shape[1:] != course.f.shape:
        raise InputError(f"delta has shape {delta.shape}, expected (S, {course.f.shape[0]}, {course.f.shape[1]})")
    if not np.all(np.abs(delta) <= 1.0):
        raise InputError("a sequence leaves the box", mend="delta lies between -1 and 1")
    v = np.empty((*delta.shape[:2], len(course.signals)))
    x = np.tile(course.start, (len(delta), 1)) if start is None else np.array(start, dtype=float)
    with np.errstate(over="ignore", invalid="ignore"):
        for k, i in enumerate(m):
            w = (delta[:, k] * course.lam[i] * (x @ course.C[i].T + course.f[k])) @ members
            v[:, k] = x @ course.E[i].T + course.g[k] + w @ course.F[i].T
            x = x @ course.A[i].T + course.q[k] + w @ course.B[i].T
    return v


@record
class Envelope:
    """Of every watched signal (N s): where it is without deltas, the guaranteed bounds low, high, and what was reached.

    questions: the (signal, instant, side) at which adversary and dual were asked, in the order of `reached`, `certificates` (None
    where no proof was found: the kernel's bound stays) and `ratio` (S), the guaranteed deviation from the nominal run over the
    reached one: 1 leaves nothing open. Elsewhere the bounds are the kernel's, of gain `gain`.
    """

    signals: tuple[str, ...]
    nominal: np.ndarray = field("N s")
    low: np.ndarray = field("N s", low=-np.inf)
    high: np.ndarray = field("N s")
    reached_low: np.ndarray = field("N s")
    reached_high: np.ndarray = field("N s")
    questions: tuple[tuple[str, int, int], ...]
    ratio: np.ndarray = field("S")
    reached: "Reached"
    certificates: tuple["Certificate | None", ...]
    gain: float


def envelope(
    course: Course,
    instants: Sequence[int] | None = None,
    limits: np.ndarray | None = None,
    seed: int = 0,
) -> Envelope:
    """Guaranteed and reached bounds of every watched signal.

    The kernel bounds every sample. At the instants, by default for each signal and side the one where the kernel comes nearest to
    its limit in limits (s 2; infinite or none: where it is widest), the dual tightens it and the adversary says what is real.
    """
    outer, s = kernel(course), len(course.signals)
    run = outer.nominal
    low, high = outer.low, outer.high
    if instants is None:
        bounds = np.tile([-np.inf, np.inf], (s, 1)) if limits is None else np.asarray(limits, dtype=float)
        if bounds.shape != (s, 2) or not np.all(bounds[:, 0] < bounds[:, 1]):
            raise InputError(f"limits of shape {bounds.shape}", mend=f"({s}, 2): low < high of {', '.join(course.signals)}")
        questions = []
        for i, name in enumerate(course.signals):
            for side, beyond, limit in ((1, high[:, i], bounds[i, 1]), (-1, -low[:, i], -bounds[i, 0])):
                questions.append((name, int((beyond if np.isfinite(limit) else outer.half[:, i]).argmax()), side))
    else:
        questions = [(name, int(k), side) for name in course.signals for k in instants for side in (1, -1)]
    found = worst(course, questions, seed=seed)
    certificates, ratio = [], np.ones(len(questions))
    for number, (name, k, side) in enumerate(questions):
        i = course.number(name)
        proof = dual(course, found, number, outer)
        certificates.append(proof)
        if proof is not None and side == 1:
            high[k, i] = min(high[k, i], proof.bound)
        elif proof is not None:
            low[k, i] = max(low[k, i], -proof.bound)
        guaranteed = high[k, i] - run.v[k, i] if side == 1 else run.v[k, i] - low[k, i]
        deviation = side * (float(found.value[number]) - run.v[k, i])
        if guaranteed > NOTHING * np.abs(run.v[:, i]).max():
            ratio[number] = guaranteed / deviation if deviation > 0.0 else np.inf
    reached_low, reached_high = (reduce(run.v, reduce.reduce(found.v, axis=0)) for reduce in (np.fmin, np.fmax))
    return Envelope(
        course.signals, run.v, low, high, reached_low, reached_high, tuple(questions), ratio, found, tuple(certificates),
        outer.gain,
    )  # fmt: skip


# ---- kernel ---------------------------------------------------------------------------------------------------------


@record
class Kernel:
    """|v - nominal.v| <= half (N s) and |x - nominal.x| <= state (N n), infinite where there is nothing to say.

    nominal: the run as it was computed; that it is off by its rounding is in the bounds. gain: the spectral radius of the largest
    sums that multiply former W, channel by channel; below 1 the bounds stay finite. start: the set in which runs begin; None
    where none is proved to hold the rests of all machines, and then nothing is said.
    """

    half: np.ndarray = field("N s")
    state: np.ndarray = field("N n")
    gain: float
    nominal: Nominal
    start: Start | None

    @property
    def low(self) -> np.ndarray:
        """What no run falls below (N s)."""
        return np.nextafter(self.nominal.v - self.half, -np.inf)

    @property
    def high(self) -> np.ndarray:
        """What no run exceeds (N s)."""
        return np.nextafter(self.nominal.v + self.half, np.inf)


def kernel(course: Course) -> Kernel:
    """W_j(k) = max over signs s of |s'(lam z_nom)| + sum |s'(lam C Phi B_c)| W_c(l); see the module.

    Channels of more than MOST_SIGNS parameters are bounded term by term. Proved in floating point: columns Z are carried as they
    round, and what rounding takes from them, from the nominal run and from every sum is in a box |e| <= lost that goes along,

        d in {Z e} + [-1, 1] lost,    |fl(A Z) - A Z| <= unit |A| |Z|,    sums of positive terms times 1 + unit

    unit being above the rounding of the longest sum, and TINY above what underflow takes. Before the box grows much, for |A| may
    have no decay, it becomes n columns.
    """
    run, m = nominal(course), course.modes
    (N, n), c, s = course.q.shape, course.B.shape[2], len(course.signals)
    channels = _channels(course)
    rows = np.concatenate([signs for signs, _ in channels])  # (J p)
    ends = np.cumsum([0, *(len(signs) for signs, _ in channels)])
    look = np.concatenate([(rows * course.lam[:, None]) @ course.C, course.E], axis=1)  # (M J+s n)
    unit = _unit(n + course.f.shape[1])
    A, F, one = np.abs(course.A), np.abs(course.F), np.eye(c)
    sizes = np.concatenate([(np.abs(rows) * course.lam[:, None]) @ np.abs(course.C), np.abs(course.E)], axis=1)
    x = np.abs(run.x)
    missed = unit * (np.einsum("kin,kn->ki", A[m], x) + np.abs(course.q))  # by one step of the nominal run
    unseen = unit * (np.einsum("ksn,kn->ks", np.abs(course.E[m]), x) + np.abs(course.g))
    felt = course.lam[m] * (np.einsum("kpn,kn->kp", np.abs(course.C[m]), x) + np.abs(course.f))
    own = np.abs((course.lam[m] * run.z) @ rows.T) + unit * felt @ np.abs(rows).T  # (N J)
    half, state, gains = np.full((N, s), np.inf), np.full((N, n), np.inf), np.zeros((c, c))
    start = _start(course, channels)
    begun = start or rests.known(n)
    lost, used = begun.slack, len(begun.size)
    room = used + 4 * AGE * c
    Z, weight = np.zeros((n, room)), np.zeros((room, 1 + c))  # the bound of each column's w; 1 in its channel
    Z[:, :used], weight[:used, 0] = begun.spread, begun.size
    if used:
        weight[used - c : used, 1:] = one  # the w of a rest
    whole = (course.A, course.B, course.C, course.E, course.F, course.lam, course.q, course.g, course.f, run.x, run.z, sizes)
    sound = start is not None and all(np.abs(values).max(initial=0.0) <= HUGE for values in whole)
    born, W, kept, grown = np.zeros(room, dtype=int), np.zeros(c), 0, False
    with np.errstate(over="ignore", invalid="ignore"):
        for k, i in enumerate(m):
            if len(born) < used + n + c:
                Z, weight, born = np.hstack([Z, 0 * Z]), np.vstack([weight, 0 * weight]), np.concatenate([born, born])
            if grown:
                Z[:, used : used + n], weight[used : used + n], born[used : used + n] = np.eye(n), 0.0, k
                weight[used : used + n, 0], lost, kept = lost, np.zeros(n), k
                used += n
            if k % AGE == 0 and k > 0:
                used, left = _exchanged(Z, weight, born, used, k, look[i])
                lost = lost + left
            now, up = Z[:, :used], 1.0 + _unit(used + n + len(look[i]))
            size = (np.abs(now) @ weight[:used, 0]) * up + lost
            risen = sizes[i] @ lost
            reach = np.abs(look[i] @ now) @ weight[:used]
            seen = (reach[:, 0] + risen + unit * (sizes[i] @ size)) * up
            for j, (_, summed) in enumerate(channels):
                at = slice(ends[j], ends[j + 1])
                total, each = own[k, at] + seen[at], reach[at, 1:]
                W[j] = up * (total.sum() if summed else total.max(initial=0.0)) + TINY
                np.maximum(gains[j], each.sum(axis=0) if summed else each.max(axis=0, initial=0.0), out=gains[j])
            half[k], state[k] = (seen[ends[-1] :] + F[i] @ W + unseen[k]) * up + TINY, size * up + TINY
            largest = np.concatenate([half[k], state[k], W, weight[:used, 0], np.abs(now).max(axis=1, initial=0.0)]).max()
            if not (sound and largest <= HUGE):  # NaN too
                half[k:], state[k:] = np.inf, np.inf
                break
            grown = k - kept >= YOUNG and bool(np.any(risen > RISEN * seen))
            lost = (A[i] @ (lost + unit * size) + missed[k]) * up + TINY
            now[:] = course.A[i] @ now
            Z[:, used : used + c], born[used : used + c] = course.B[i], k
            weight[used : used + c, 0], weight[used : used + c, 1:] = W, one
            used += c
    finite = np.isfinite(gains).all()
    return Kernel(half, state, float(np.abs(np.linalg.eigvals(gains)).max(initial=0.0)) if finite else np.inf, run, start)


def starts(course: Course) -> Start | None:
    """A set that holds every start of the course, or None where none is proved to."""
    return _start(course, _channels(course))


def _start(course: Course, channels: Sequence[tuple[np.ndarray, bool]]) -> Start | None:
    if course.before is None:
        return rests.known(len(course.start))
    i = int(course.modes[0])
    return rests.holding(course.before, course.A[i], course.B[i], course.C[i], course.lam[i], course.start, channels)


def _channels(course: Course) -> list[tuple[np.ndarray, bool]]:
    return [_signs(np.flatnonzero(course.channel == j), course) for j in range(course.B.shape[2])]


def _unit(terms: int) -> float:
    """Above the relative rounding of a sum of so many products of rounded factors, and of the few operations on it."""
    return 8.0 * (terms + 4) * float(np.finfo(float).eps)


def _signs(own: np.ndarray, course: Course) -> tuple[np.ndarray, bool]:
    """Rows s (J p) of a channel's parameters `own`, and whether the bound is their sum instead of their maximum."""
    own = own[course.lam[:, own].any(axis=0)]
    if len(own) > MOST_SIGNS:
        return np.eye(course.f.shape[1])[own], True
    rows = np.zeros((2 ** max(len(own) - 1, 0), course.f.shape[1]))
    for bit, i in enumerate(own):
        rows[:, i] = 1.0 - 2.0 * ((np.arange(len(rows)) >> bit) & 1)  # the last one is always 1: signs up to a common one
    return rows, False


def _exchanged(
    Z: np.ndarray, weight: np.ndarray, born: np.ndarray, used: int, k: int, look: np.ndarray
) -> tuple[int, np.ndarray]:
    """Exchange the oldest columns for a box if that widens what is seen by less than WIDER; how many columns there are then.

    The box stands along the principal axes of the columns, where they are thinnest, and is the older one of two that are tried.
    The second answer (n) bounds what is left: a column is T y and col - T y, for any T and y, so that neither needs to be exact.
    """
    n, unit = len(Z), _unit(used + len(Z))
    seen = np.abs(look @ Z[:, :used]) * weight[:used, 0]
    whole = seen.sum(axis=1)
    age = AGE
    while age <= k:
        old = np.flatnonzero(born[:used] <= k - age)
        columns = Z[:, old]
        if len(old) <= 2 * n or not np.isfinite(columns).all():
            break
        size = np.abs(columns) @ weight[old, 0]
        size[size == 0.0] = 1.0
        axes = np.linalg.svd(columns / size[:, None] * weight[old, 0], full_matrices=False)[0]
        T, y = size[:, None] * axes, axes.T @ (columns / size[:, None])
        box = (np.abs(y) @ weight[old]) * (1.0 + unit)
        if np.all(np.abs(look @ T) @ box[:, 0] <= seen[:, old].sum(axis=1) + WIDER * whole):
            left = np.abs(columns - T @ y) + unit * (np.abs(columns) + np.abs(T) @ np.abs(y))
            rest = (left @ weight[old, 0]) * (1.0 + unit) + TINY
            young = np.flatnonzero(born[:used] > k - age)
            count = n + len(young)
            Z[:, n:count], weight[n:count], born[n:count] = Z[:, young], weight[young], born[young]
            Z[:, :n], weight[:n], born[:n] = T, box, k - age
            return count, rest
        age *= 2
    return used, np.zeros(n)


# ---- the adversary --------------------------------------------------------------------------------------------------


@record
class Reached:
    """Sequences delta (S N p) with which watched signal `signal` reaches `value` at sample `instant`, sought as far up (side 1)
    or down (side -1) as possible; (S) each. v (S N s) is their replay from the rest with parameters before (S p) at the shares
    (S g) of what is open of the set-points before the run, the states start (S n)."""

    signal: np.ndarray = field("S")
    instant: np.ndarray = field("S")
    side: np.ndarray = field("S")
    value: np.ndarray = field("S")
    delta: np.ndarray = field("S N p", low=-1.0, high=1.0)
    v: np.ndarray = field("S N s")
    before: np.ndarray = field("S p", low=-1.0, high=1.0)
    share: np.ndarray = field("S g", low=-1.0, high=1.0)
    start: np.ndarray = field("S n")


def worst(course: Course, questions: Sequence[tuple[str, int, int]], *, starts: int = STARTS, seed: int = 0) -> Reached:
    """For each question (signal, instant, side): delta_i(k) = sign((p'b_j) z_i) until nothing gets better; see the module.

    Starts of each: the gradient along the nominal run, a constant sign, random signs; the best one is kept and replayed.
    """
    signal = np.array([course.number(name) for name, _, _ in questions], dtype=int)
    instant = np.array([k for _, k, _ in questions], dtype=int)
    side = np.array([one for *_, one in questions], dtype=float)
    if len(questions) == 0 or instant.min() < 0 or instant.max() >= len(course):
        raise InputError(f"instants {instant.tolist()}", mend=f"give at least one, each from 0 to {len(course) - 1}")
    if not np.all(np.abs(side) == 1.0) or starts < 2:
        raise InputError(f"sides {side.tolist()}, {starts} starts", mend="a side is 1 or -1; two starts are fixed")
    S, last, c = len(questions), int(instant.max()) + 1, course.B.shape[2]
    random = np.random.default_rng(seed).choice([-1.0, 1.0], (last, S * (starts - 2), c))
    sigma = np.concatenate([np.zeros((last, S, c)), np.ones((last, S, c)), random], axis=1)
    ascent = _Ascent(course, np.tile(signal, starts), np.tile(instant, starts), np.tile(side, starts), sigma)
    with np.errstate(over="ignore", invalid="ignore"):
        best = ascent.run().reshape(starts, S).argmax(axis=0) * S + np.arange(S)
    delta = np.ones((S, *course.f.shape)) * side[:, None, None]  # after the instant the run goes on pushing
    own = course.channel.astype(int)
    delta[:, :last] = (ascent.sigma[:, best][..., own] * ascent.sign[:, best]).transpose(1, 0, 2)
    before, share, start = (values[best] for values in (ascent.before, ascent.share, ascent.start))
    v = replay(course, delta, start)
    return Reached(signal, instant, side, v[np.arange(S), instant, signal], delta, v, before, share, start)


class _Ascent:
    """Coordinate ascent of side v(T) in lanes (L): w_j(k) = sigma_j(k) lam'|z(k)| over the parameters of channel j.

    before (L p), share (L g): at whose rest each of them begins.
    """

    def __init__(self, course: Course, signal: np.ndarray, instant: np.ndarray, side: np.ndarray, sigma: np.ndarray):
        self.course, self.m, self.members = course, course.modes, course.members
        self.signal, self.side, self.sigma = signal, side, sigma
        self.ends = {int(k): np.flatnonzero(instant == k) for k in np.unique(instant)}
        self.sign = np.ones((*sigma.shape[:2], course.f.shape[1]), dtype=np.int8)
        before = sigma[0][:, course.channel.astype(int)] * (course.lam[self.m[0]] > 0.0)
        self.before = np.where(course.rests(before)[:, None], before, 0.0)
        self.share = np.zeros((len(side), course.before.Q.shape[1] if course.before else 0))
        self.start = course.begun(self.before, self.share)

    def run(self) -> np.ndarray:
        """side v(T) of every lane (L,), after the last sweep that improved one of them."""
        value = self.forward()
        for _ in range(SWEEPS):
            self.backward()
            former, value = value, self.forward()
            if not np.any(value > former + 1e-9 * np.abs(former)):
                break
        return np.where(np.isnan(value), -np.inf, value)

    def forward(self) -> np.ndarray:
        """Run with the signs sigma of the gradient, whatever the signs of z become; side v(T) of each lane."""
        course, x = self.course, self.start
        value = np.empty(len(self.side))
        for k in range(len(self.sigma)):
            i = self.m[k]
            z = x @ course.C[i].T + course.f[k]
            self.sign[k] = np.where(z < 0, -1, 1)
            w = self.sigma[k] * ((np.abs(z) * course.lam[i]) @ self.members)
            if k in self.ends:
                at = self.ends[k]
                own = self.signal[at]
                signal = np.einsum("ln,ln->l", x[at], course.E[i, own]) + np.einsum("lc,lc->l", w[at], course.F[i, own])
                value[at] = self.side[at] * (signal + course.g[k, own])
            x = x @ course.A[i].T + course.q[k] + w @ course.B[i].T
        return value

    def backward(self) -> None:
        """p(k) = A'p(k+1) + C'(lam delta(k)) p(k+1)'B along the run: new signs sigma."""
        course, p = self.course, np.zeros((len(self.side), len(self.course.start)))
        own = course.channel.astype(int)
        for k in range(len(self.sigma) - 1, -1, -1):
            i = self.m[k]
            influence = p @ course.B[i]
            p = p @ course.A[i]
            if k in self.ends:
                at = self.ends[k]
                influence[at] += self.side[at, None] * course.F[i, self.signal[at]]
                p[at] += self.side[at, None] * course.E[i, self.signal[at]]
            self.sigma[k] = np.where(influence == 0.0, self.side[:, None], np.sign(influence))
            p += (np.abs(influence)[:, own] * course.lam[i] * self.sign[k]) @ course.C[i]
        if course.before is not None:
            self.begin(course.before, p)

    def begin(self, rest: Rest, p: np.ndarray) -> None:
        """With p (L n) the slope of side v(T) in x(0): new parameters at whose rest to begin, of those that come to rest.

        x = A(delta) x + q + .., so that (I - A(delta))' a = p and the slope in delta_i is a'b_j lam_i z_i.
        """
        course, i, own = self.course, self.m[0], self.course.channel.astype(int)
        columns = course.B[i][:, own] * course.lam[i]
        left = np.eye(len(course.start)) - course.A[i] - (columns * self.before[:, None, :]) @ course.C[i]
        a = np.linalg.solve(left.swapaxes(1, 2), p[..., None])[..., 0]
        slope = (a @ columns) * (self.start @ course.C[i].T + rest.f + self.share @ rest.J.T)
        before = np.where(slope == 0.0, self.before, np.sign(slope))
        self.before = np.where(course.rests(before)[:, None], before, self.before)
        through = a @ rest.Q + np.einsum("lp,lp,pg->lg", a @ columns, self.before, rest.J)
        self.share = np.where(through == 0.0, self.share, np.sign(through))
        self.start = course.begun(self.before, self.share)


# ---- the dual -------------------------------------------------------------------------------------------------------


@record
class Certificate:
    """side v(instant) <= bound, proved by M (K p) and V_k(d) = d'P d + 2 q'd + c, K + 1 each, from sample `first` to `instant`.

    x (K n): the run that d counts from, of which nothing is assumed. box (h): the set in which it begins is T u, |u| <= box, and
    nu (h) >= 0 are its multipliers: the starts of the course, or where `first` is not 0 what the kernel knows of x(first), T = I.
    """

    signal: str
    instant: int
    side: int
    first: int
    bound: float
    M: np.ndarray = field("K p", low=0.0)
    P: np.ndarray = field("K+1 n n")
    q: np.ndarray = field("K+1 n")
    c: np.ndarray = field("K+1")
    x: np.ndarray = field("K n")
    box: np.ndarray = field("h", low=0.0)
    nu: np.ndarray = field("h", low=0.0)

    def holds(self, course: Course, outer: Kernel | None = None) -> bool:
        """Whether every block is positive definite and the bound is no less than V says, in outward-rounded arithmetic.

        outer: the kernel of the course, which knows where it begins, and what a window rests on; computed where it is not given.
        """
        K, s = len(self.M), course.number(self.signal)
        n, p = len(course.start), course.f.shape[1]
        k = np.arange(self.first, self.instant + 1)
        if not 0 <= self.first <= self.instant < len(course) or len(k) != K or self.side not in (1, -1):
            return False
        if self.M.shape != (K, p) or self.P.shape != (K + 1, n, n) or not np.array_equal(self.P, self.P.swapaxes(1, 2)):
            return False
        if self.x.shape != (K, n) or self.P[-1].any() or self.q[-1].any() or self.c[-1] < 0.0:
            return False
        if not all(np.isfinite(each).all() for each in (self.M, self.P, self.q, self.c, self.x, self.box, self.nu, self.bound)):
            return False
        mu, live = _weights(course, k, self.M)
        if not (mu.low > 0.0).all():
            return False
        m = course.modes[k]
        A, C, lost = course.A[m], course.C[m], np.zeros((K, 1, course.B.shape[2]))
        B, F = course.B[m] * live[:, None, :], course.F[m, s] * live
        # the step from the run that d counts from: zero but for rounding
        step = (exact(A[:-1]) @ self.x[:-1, :, None])[..., 0] + course.q[k[:-1]] - self.x[1:]
        last = np.zeros((1, n))  # V of the sample after the last one is c alone
        away = Interval(np.concatenate([step.low, last]), np.concatenate([step.high, last]))
        z = (exact(C) @ self.x[:, :, None])[..., 0] + course.f[k]
        one = np.ones((K, 1, 1))
        H = _columns(
            [exact(np.concatenate([A, np.zeros((K, 1, n))], axis=1)), exact(np.concatenate([B, lost], axis=1))],
            _rows([away[..., None], exact(one)]),
        )
        Z = _columns([exact(C), exact(np.zeros((K, p, B.shape[2])))], z[..., None])
        blocks = _padded(_bordered(self.P, self.q, self.c)[:-1], B.shape[2]) - _transposed(H) @ (
            exact(_bordered(self.P, self.q, self.c)[1:]) @ H
        )
        blocks = blocks - _transposed(Z) @ (exact(self.M)[..., None] * Z) + _diagonal(mu, n)
        linear = np.zeros((1, *blocks.shape[1:]))
        linear[0, :n, -1] = linear[0, -1, :n] = 0.5 * self.side * course.E[m[-1], s]
        linear[0, n:-1, -1] = linear[0, -1, n:-1] = 0.5 * self.side * F[-1]
        blocks = _rows([blocks[:-1], blocks[-1:] - linear], axis=0)
        if not positive_definite(_symmetric(blocks)).all():
            return False
        base = (exact(course.E[m[-1], s][None]) @ self.x[-1][:, None])[0, 0] + float(course.g[self.instant, s])
        room = exact(self.bound) - base * float(self.side)
        outer = kernel(course) if outer is None and self.first > 0 else outer
        start = _begun(course, self.first, outer)
        away = abs(exact(course.start if self.first == 0 or outer is None else outer.nominal.x[self.first]) - self.x[0])
        if start is None or self.box.shape != start.size.shape or not np.all(self.box >= start.size):
            return False
        # V(T u + r) <= u'T'P T u + 2 q'T u + c + what |r| <= off adds, and that is no more than nu'box^2 - u'diag(nu) u leaves
        P, q, T, off = exact(self.P[0]), exact(self.q[0]), exact(start.spread), away + start.slack
        turned = _transposed(T) @ P
        felt = abs(P) @ ((abs(T) @ self.box[:, None])[:, 0] * 2.0 + off)[:, None]
        added = ((felt[:, 0] + abs(q) * 2.0) * off).sum()
        corner = room - float(self.c[0]) - (exact(self.nu) * (exact(self.box) * self.box)).sum() - added
        side = -(_transposed(T) @ q[:, None])
        top = exact(np.diag(self.nu)) - turned @ T
        block = _rows([_columns([top], side), _columns([_transposed(side)], corner[None, None])], axis=0)
        return bool(positive_definite(_symmetric(block)))


def _begun(course: Course, first: int, outer: Kernel | None) -> Start | None:
    """The set in which a window begins around the nominal run: as the kernel knows it, or the starts of the course themselves."""
    if first == 0 or outer is None:
        return starts(course) if outer is None else outer.start
    box = outer.state[first]
    return Start(np.eye(len(box)), box, np.zeros(len(box))) if np.isfinite(box).all() else None


def _weights(course: Course, k: np.ndarray, M: np.ndarray) -> tuple[Interval, np.ndarray]:
    """mu (K c), no more than 1 / (sum_i lam_i^2 / M_i) where its low end is taken; live (K c): channels with a parameter."""
    lam = course.lam[course.modes[k]]
    used = lam > 0.0
    lost = (used & (M == 0.0)) @ course.members > 0.0
    ratio = (exact(lam) * lam) / np.where(M > 0.0, M, 1.0)
    total = (ratio[..., None] * course.members).sum(axis=1)
    live = used @ course.members > 0.0
    filled = Interval(np.where(live, total.low, 1.0), np.where(live, total.high, 1.0))
    low = np.where(lost | (filled.low <= 0.0), 0.0, (1.0 / Interval(np.maximum(filled.low, 1e-300), filled.high)).low)
    return exact(low), live.astype(float)


def _bordered(P: np.ndarray, q: np.ndarray, c: np.ndarray) -> np.ndarray:
    """[P q; q' c]."""
    top = np.concatenate([P, q[..., None]], axis=-1)
    return np.concatenate([top, np.concatenate([q, c[..., None]], axis=-1)[..., None, :]], axis=-2)


def _padded(V: np.ndarray, channels: int) -> Interval:
    """V with rows and columns of zeros for w before its last ones."""
    K, n = len(V), V.shape[1] - 1
    whole = np.zeros((K, n + channels + 1, n + channels + 1))
    at = np.append(np.arange(n), n + channels)
    whole[:, at[:, None], at] = V
    return exact(whole)


def _diagonal(mu: Interval, n: int) -> np.ndarray:
    K, c = mu.shape
    whole = np.zeros((K, n + c + 1, n + c + 1))
    whole[:, n + np.arange(c), n + np.arange(c)] = mu.low
    return whole


def _transposed(x: Interval) -> Interval:
    return Interval(x.low.swapaxes(-1, -2), x.high.swapaxes(-1, -2))


def _symmetric(x: Interval) -> Interval:
    """The symmetric matrices in x, which are those in the intersection with its transpose."""
    return x.intersection(_transposed(x)).interval()


def _rows(parts: list[Interval], axis: int = -2) -> Interval:
    return Interval(np.concatenate([x.low for x in parts], axis=axis), np.concatenate([x.high for x in parts], axis=axis))


def _columns(parts: list[Interval], last: Interval) -> Interval:
    return _rows([*parts, last], axis=-1)


def dual(course: Course, found: Reached, question: int = 0, outer: Kernel | None = None) -> Certificate | None:
    """A proved bound of the question that `found` answers from the other side, or None where none was found; see the module.

    outer: the kernel of the course, if it is at hand. Far-off samples are then left to its box.
    """
    signal, instant = int(found.signal[question]), int(found.instant[question])
    side, delta = float(found.side[question]), found.delta[question]
    path = _along(course, signal, instant, side, delta, found.start[question])
    first = _first(path, instant, outer)
    for begin in (first, 0) if first > 0 else (0,):  # a window may forget what the first multipliers need
        problem = _Problem(course, signal, instant, side, begin, outer)
        tried = [problem.started(M) for M in _first_multipliers(course, path, problem.k)]
        tried = sorted((attempt for attempt in tried if attempt is not None), key=lambda attempt: attempt.value)
        for start in tried[:TRIED]:
            proof = problem.certified(start, _searched(problem, start))
            if proof is not None:
                return proof
    return None


def _searched(problem: "_Problem", first: "_Attempt") -> "_Attempt":
    """Descended from the first multipliers, and again from between them and the end, where R is about to break down."""
    best, left = _descended(problem, first, min(EVALUATIONS, max(1, WORK // len(problem.k))))
    while left > 0:
        inside = problem.at(problem.blended(best, first, RESTARTED))
        if inside is None:
            break
        former = best
        best, left = _descended(problem, inside, left - 1)
        if best.value >= former.value * (1.0 - GAINED):
            return min(best, former, key=lambda attempt: attempt.value)
    return best


class _Path(NamedTuple):
    """Along one sequence: z (N p), w (N c), and the slope of side v(T) in w, influence (N c)."""

    z: np.ndarray
    w: np.ndarray
    influence: np.ndarray


def _along(course: Course, signal: int, instant: int, side: float, delta: np.ndarray, x: np.ndarray) -> _Path:
    m, members, own = course.modes, course.members, course.channel.astype(int)
    z = np.zeros((instant + 1, course.f.shape[1]))
    w, influence = np.zeros((instant + 1, course.B.shape[2])), np.zeros((instant + 1, course.B.shape[2]))
    for k in range(instant + 1):
        i = m[k]
        z[k] = course.C[i] @ x + course.f[k]
        w[k] = (delta[k] * course.lam[i] * z[k]) @ members
        x = course.A[i] @ x + course.q[k] + course.B[i] @ w[k]
    p = np.zeros(len(course.start))
    for k in range(instant, -1, -1):
        i = m[k]
        influence[k] = p @ course.B[i] + (side * course.F[i, signal] if k == instant else 0.0)
        p = p @ course.A[i] + (influence[k][own] * course.lam[i] * delta[k]) @ course.C[i]
        if k == instant:
            p = p + side * course.E[i, signal]
    return _Path(z, w, influence)


def _first_multipliers(course: Course, path: _Path, k: np.ndarray) -> Iterator[np.ndarray]:
    """M_i = |p'b_j| lam_i / (2 |z_i|), for which the adversary's run is stationary.

    Where z_i or p'b_j pass zero these are extreme and R breaks down around them: |z_i| is lifted, |p'b_j| averaged.
    """
    z, own, lam = np.abs(path.z[k]), course.channel.astype(int), course.lam[course.modes[k]]
    size = np.sqrt((z**2).mean(axis=0))
    size = np.maximum(size, max(1e-9 * float(size.max(initial=0.0)), 1e-150))
    squares = np.concatenate([np.zeros((1, len(course.B[0, 0]))), np.cumsum(path.influence[k] ** 2, axis=0)])
    at = np.arange(len(k))
    for width in SMOOTHED:
        low, high = np.maximum(at - width, 0), np.minimum(at + width + 1, len(k))
        slope = np.sqrt(np.maximum((squares[high] - squares[low]) / (high - low)[:, None], 0.0))
        slope = np.maximum(slope, max(1e-9 * float(slope.max(initial=0.0)), 1e-150))
        for softened in SOFTENED:
            yield 0.5 * slope[:, own] * lam / (z + softened * size)


def _first(path: _Path, instant: int, outer: Kernel | None) -> int:
    """Where a window may begin: what happened before adds less than FORGOTTEN of what was reached."""
    if outer is None:
        return 0
    share = np.cumsum(np.abs(path.w * path.influence).sum(axis=1))
    first = int(np.searchsorted(share, FORGOTTEN * share[-1]))
    return first if first >= SPARED and np.isfinite(outer.state[first]).all() else 0


class _Attempt(NamedTuple):
    """Multipliers log M (K p) and log nu (h), the bound with them, its slope and a guess of its curvature."""

    x: np.ndarray
    value: float
    slope: np.ndarray
    curvature: np.ndarray


class _Problem:
    """The bound of one question as a function of its multipliers, and the proof of it."""

    def __init__(self, course: Course, signal: int, instant: int, side: float, first: int, outer: Kernel | None):
        self.course, self.outer = course, outer
        self.signal, self.instant, self.side, self.first = signal, instant, side, first
        self.k = np.arange(first, instant + 1)
        run, m = nominal(course) if outer is None else outer.nominal, course.modes[self.k]
        self.x, self.z, self.base = run.x[self.k], run.z[self.k].copy(), side * float(run.v[instant, signal])
        self.lam, self.own = course.lam[m], course.channel.astype(int)
        live = (self.lam > 0.0) @ course.members > 0.0
        self.used, self.live = self.lam > 0.0, live
        self.mode = m.astype(np.int64)
        self.A, self.B, self.C = (np.array(M, order="C") for M in (course.A, course.B, course.C))
        dead = (course.lam > 0.0) @ course.members == 0.0  # (M c)
        self.B[np.broadcast_to(dead[:, None, :], self.B.shape)] = 0.0
        self.c = 0.5 * side * course.E[m[-1], signal]
        self.f = np.where(live[-1], 0.5 * side * course.F[m[-1], signal], 0.0)
        begun = _begun(course, first, outer)
        self.begins, start = begun is not None, begun or rests.known(len(self.c))
        self.T, length = start.spread, np.linalg.norm(start.spread, axis=0)
        least = 1e-12 * float((length * start.size).max(initial=0.0))
        self.box = np.maximum(start.size, least / np.where(length > 0.0, length, 1.0))
        K, n, c = len(self.k), len(self.c), self.B.shape[2]
        self.P, self.q, self.v = np.zeros((K + 1, n, n)), np.zeros((K + 1, n)), np.zeros(K + 1)
        self.G, self.r = np.zeros((K, c, n)), np.zeros((K, c))
        self.d, self.w = np.zeros((K, n)), np.zeros((K, c))

    def mu(self, M: np.ndarray) -> np.ndarray:
        """1 / (sum_i lam_i^2 / M_i) of every channel (K c), 1 where there is nothing."""
        ratio = np.where(self.used, self.lam**2 / np.where(self.used, M, 1.0), 0.0) @ self.course.members
        return np.where(self.live, 1.0 / np.where(self.live, ratio, 1.0), 1.0)

    def backward(self, M: np.ndarray, mu: np.ndarray, floor: bool = False, slack: np.ndarray | None = None) -> bool:
        """V of every sample into P, q, v; False where R < GUARD diag(mu). floor: M and mu are raised until it is not."""
        extra = np.zeros(len(self.c) + 2) if slack is None else slack
        return bool(
            _riccati(
                self.A, self.B, self.C, self.mode, M, mu, self.z, self.c, self.f, extra, GUARD, floor,
                self.P, self.q, self.v, self.G, self.r,
            )
        )  # fmt: skip

    def started(self, M: np.ndarray) -> _Attempt | None:
        """The first multipliers, raised where R would not be positive definite."""
        M = np.where(self.used, M, 0.0)
        mu = self.mu(M)
        if not self.backward(M, mu, floor=True) or not np.isfinite(self.P).all():
            return None
        # the smallest of nu u^2 + q'T (diag(nu) - T'P T)^-1 T'q, one direction at a time, and above T'P T
        nu = np.abs(self.q[0] @ self.T) / self.box + 2.0 * np.abs(self.T.T @ self.P[0] @ self.T).sum(axis=1)
        return self.at(np.log(np.maximum(np.concatenate([M.ravel(), nu]), 1e-300)))

    def at(self, x: np.ndarray) -> _Attempt | None:
        """The bound of multipliers exp(x); None where there is none."""
        with np.errstate(over="ignore", under="ignore", invalid="ignore", divide="ignore"):
            M, nu = self.multipliers(x)
            mu = self.mu(M)
            found = self.bound(nu) if self.backward(M, mu) else None
            if found is None:
                return None
            value, u = found
            _run(self.A, self.B, self.mode, self.G, self.r, self.T @ u, self.d, self.w)
            z = self.z + np.einsum("kpn,kn->kp", self.C[self.mode], self.d)
            share = np.where(self.used, (mu * self.w)[:, self.own] * self.lam / np.where(self.used, M, 1.0), 0.0)
            z2, s2, b2, u2 = M * z**2, M * share**2, nu * self.box**2, nu * u**2
            slope, curvature = np.append((z2 - s2).ravel(), b2 - u2), np.append((z2 + s2).ravel(), b2 + u2)
            return _Attempt(x, value, slope, curvature) if np.isfinite(curvature).all() else None

    def multipliers(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """M (K p) and nu (h) of their logarithms."""
        K, p = self.z.shape
        M = np.where(self.used, np.exp(x[: K * p]).reshape(K, p), 0.0)
        return M, np.exp(x[K * p :])

    def blended(self, one: _Attempt, other: _Attempt, share: float) -> np.ndarray:
        """Logarithms of the multipliers between two, in which the bound is convex."""
        M, nu = ((1.0 - share) * a + share * b for a, b in zip(self.multipliers(one.x), self.multipliers(other.x), strict=True))
        return np.log(np.maximum(np.append(M.ravel(), nu), 1e-300))

    def bound(self, nu: np.ndarray) -> tuple[float, np.ndarray] | None:
        """The largest V of the starts T u, and u; None where it has no bound."""
        value, P, q = float(self.v[0]), self.T.T @ self.P[0] @ self.T, self.q[0] @ self.T
        if not (self.begins and np.isfinite(self.P[0]).all() and np.isfinite(self.q[0]).all() and np.isfinite(value)):
            return None
        if not len(nu):
            return value, q
        S, scale = np.diag(nu) - P, 1.0 / np.sqrt(nu)
        if not (np.isfinite(scale).all() and np.linalg.eigvalsh(S * np.outer(scale, scale))[0] > GUARD):
            return None
        u = np.linalg.solve(S, q)
        return value + float(nu @ self.box**2 + q @ u), u

    def certified(self, first: _Attempt, best: _Attempt) -> Certificate | None:
        """The proof: V with some slack in every block; where that fails, further inside, for V is convex in M."""
        if self.at(best.x) is None:
            return None
        K, n = len(self.k), len(self.c)
        # a share of P, and where P is small of what it would weigh along the run that attains the bound
        size = np.abs(self.d).max(axis=0)
        size = np.maximum(size, max(1e-6 * float(size.max()), 1e-150))
        for blend, raised, share in itertools.product(BLENDED, RAISED, SLACK):
            M, nu = self.multipliers(self.blended(best, first, blend))
            own, paid = (part * max(best.value, 1e-300) / K for part in (share, PAID))
            with np.errstate(over="ignore", under="ignore", invalid="ignore", divide="ignore"):
                found = (
                    self.bound(nu)
                    if self.backward(M, self.mu(M), slack=np.concatenate([own / (n * size**2), [paid, raised]]))
                    else None
                )
            if found is None:
                continue
            rounding = ROUNDING * n * (abs(self.base) + float(np.abs(self.x[-1]) @ np.abs(self.c)))
            bound = self.base + found[0] + PAID * abs(found[0]) + rounding
            proof = Certificate(
                self.course.signals[self.signal], self.instant, int(self.side), self.first, bound, M,
                0.5 * (self.P + self.P.swapaxes(1, 2)), self.q.copy(), self.v.copy(), self.x, self.box, nu,
            )  # fmt: skip
            if proof.holds(self.course, self.outer):
                return proof
        return None


def _descended(problem: _Problem, best: _Attempt, most: int) -> tuple[_Attempt, int]:
    """Quasi-Newton (L-BFGS) with the curvature of each multiplier as the first metric; where R breaks down counts as infinite.

    most: evaluations, of which the second answer is what is left.
    """
    pairs: list[tuple[np.ndarray, np.ndarray, float]] = []
    values, count = [best.value], 0
    while count < most:
        curvature = best.curvature + 1e-6 * best.curvature.max()
        step, shares = best.slope.copy(), []
        if not curvature.max() > 0.0:
            break  # nothing depends on anything
        for s, y, rho in reversed(pairs):
            shares.append(rho * (s @ step))
            step -= shares[-1] * y
        step /= curvature
        for (s, y, rho), share in zip(pairs, reversed(shares), strict=True):
            step += (share - rho * (y @ step)) * s
        falls = float(step @ best.slope)
        if not falls > 0.0:
            if not pairs:
                break
            pairs = []
            continue
        step *= min(1.0, 2.0 / max(float(np.abs(step).max()), 1e-300))
        length, new = 1.0, None
        while length > 1e-6 and count < most:
            new, count = problem.at(best.x - length * step), count + 1
            if new is not None and new.value <= best.value - 1e-4 * length * float(step @ best.slope):
                break
            new, length = None, 0.4 * length
        if new is None:
            if not pairs:
                break
            pairs = []
            continue
        s, y = new.x - best.x, new.slope - best.slope
        if s @ y > 1e-12 * np.linalg.norm(s) * np.linalg.norm(y):
            pairs = [*pairs[-MEMORY + 1 :], (s, y, 1.0 / float(s @ y))]
        best = new
        values.append(best.value)
        if len(values) > TAIL and values[-TAIL - 1] - best.value < SETTLED * best.value:
            break
    return best, most - count


@njit(cache=True, nogil=True, error_model="numpy")
def _riccati(A, B, C, mode, M, mu, z, c_end, f_end, slack, guard, floor, P, q, v, G, r):
    """P, q, v (K + 1) and w = G d + r (K) backward; False where R - guard diag(mu) is not positive definite."""
    K, p = M.shape
    n, c = B.shape[1], B.shape[2]
    PA, PB, cross = np.empty((n, n)), np.empty((n, c)), np.empty((c, n))
    R, L, base, seen = np.empty((c, c)), np.empty((c, c)), np.empty(c), np.empty(n)
    for i in range(n):
        q[K, i] = 0.0
        for j in range(n):
            P[K, i, j] = 0.0
    v[K] = 0.0
    for k in range(K - 1, -1, -1):
        a, b, own = A[mode[k]], B[mode[k]], C[mode[k]]
        for i in range(n):
            for j in range(n):
                total = 0.0
                for h in range(n):
                    total += P[k + 1, i, h] * a[h, j]
                PA[i, j] = total
            for j in range(c):
                total = 0.0
                for h in range(n):
                    total += P[k + 1, i, h] * b[h, j]
                PB[i, j] = total
        for i in range(c):
            for j in range(c):
                total = 0.0
                for h in range(n):
                    total += b[h, i] * PB[h, j]
                R[i, j] = -total
            for j in range(n):
                total = 0.0
                for h in range(n):
                    total += b[h, i] * PA[h, j]
                cross[i, j] = total
            total = f_end[i] if k == K - 1 else 0.0
            for h in range(n):
                total += b[h, i] * q[k + 1, h]
            base[i] = total
        if floor:
            needed = 0.0  # the trace: no less than the largest eigenvalue
            for i in range(c):
                needed -= 1.1 * R[i, i] / mu[k, i]
            if needed > 1.0:
                for h in range(p):
                    M[k, h] *= needed
                for h in range(c):
                    mu[k, h] *= needed
        for i in range(c):
            R[i, i] += (1.0 - guard) * mu[k, i]
        if not _factor(R, L):
            return False
        for i in range(c):
            R[i, i] += guard * mu[k, i]
        if not _factor(R, L):
            return False
        for j in range(n + 1):  # R^-1 [cross base]
            for i in range(c):
                total = base[i] if j == n else cross[i, j]
                for h in range(i):
                    total -= L[i, h] * (r[k, h] if j == n else G[k, h, j])
                if j == n:
                    r[k, i] = total / L[i, i]
                else:
                    G[k, i, j] = total / L[i, i]
            for i in range(c - 1, -1, -1):
                total = r[k, i] if j == n else G[k, i, j]
                for h in range(i + 1, c):
                    total -= L[h, i] * (r[k, h] if j == n else G[k, h, j])
                if j == n:
                    r[k, i] = total / L[i, i]
                else:
                    G[k, i, j] = total / L[i, i]
        value = v[k + 1] + slack[n]
        for i in range(n):
            seen[i] = c_end[i] if k == K - 1 else 0.0
            for h in range(n):
                seen[i] += a[h, i] * q[k + 1, h]
            for h in range(c):
                seen[i] += cross[h, i] * r[k, h]
        for i in range(c):
            value += base[i] * r[k, i]
        for i in range(n):
            for j in range(i, n):
                total = slack[i] if i == j else 0.0
                for h in range(n):
                    total += a[h, i] * PA[h, j]
                for h in range(c):
                    total += cross[h, i] * G[k, h, j]
                P[k, i, j] = total
        for h in range(p):
            if M[k, h] == 0.0:
                continue
            value += M[k, h] * z[k, h] * z[k, h]
            for i in range(n):
                weighted = M[k, h] * own[h, i]
                seen[i] += weighted * z[k, h]
                for j in range(i, n):
                    P[k, i, j] += weighted * own[h, j]
        for i in range(n):
            q[k, i] = seen[i]
            P[k, i, i] *= 1.0 + slack[n + 1]
            for j in range(i):
                P[k, i, j] = P[k, j, i]
        v[k] = value
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _factor(R, L):
    """Cholesky R = L L'; False where R is not positive definite."""
    for i in range(len(R)):
        for j in range(i + 1):
            total = R[i, j]
            for h in range(j):
                total -= L[i, h] * L[j, h]
            if i == j:
                if not total > 0.0:
                    return False
                L[i, i] = np.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _run(A, B, mode, G, r, start, d, w):
    """d(k+1) = A d + B w with w = G d + r: the run that attains the bound."""
    K, n, c = len(mode), B.shape[1], B.shape[2]
    for i in range(n):
        d[0, i] = start[i]
    for k in range(K):
        a, b = A[mode[k]], B[mode[k]]
        for i in range(c):
            total = r[k, i]
            for h in range(n):
                total += G[k, i, h] * d[k, h]
            w[k, i] = total
        if k + 1 < K:
            for i in range(n):
                total = 0.0
                for h in range(n):
                    total += a[i, h] * d[k, h]
                for h in range(c):
                    total += b[i, h] * w[k, h]
                d[k + 1, i] = total
