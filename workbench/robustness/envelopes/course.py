"""A closed loop along a known run, with parameters that move within boxes: the run without them and with a given sequence.

    x(k+1) = A_m x(k) + q(k) + B_m w(k),        v(k) = E_m x(k) + g(k) + F_m w(k),        m = mode[k]
    w_j(k) = sum over the parameters i of channel j of delta_i(k) lam_mi z_i(k),   z(k) = C_m x(k) + f(k),   |delta_i(k)| <= 1

v are the watched signals, outputs and commands. Set-points and schedule are known and are in q, g, f and mode; delta moves as it
likes at every sample. The run begins at a start that is known, or at the rest of any machine of the boxes, which is not that of
the middle: x(0) in x_nominal(0) + T u + r, |u| <= size, |r| <= slack (`rests`). d = x - x_nominal obeys the same equations,
without q and g and with z_nominal for f. Three answers: the bounds of every instant (`kernel`), a sequence that comes near them
at one (`adversary`), and a proved bound of what can be reached there (`dual`); `envelope` puts them together.
"""

from dataclasses import replace

import numpy as np

from workbench.errors import InputError
from workbench.records import field, record
from workbench.robustness.rests import Rest


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
        sizes = [len(self.start), self.f.shape[1], len(self.signals)]
        if self.before and [len(own) for own in (self.before.q, self.before.f, self.before.v)] != sizes:
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
            v, V = before.v + FD[first] @ before.f, before.V + FD[first] @ before.J
            before = replace(before, q=q, Q=Q, v=v, V=V) if self.rests(delta[None])[0] else None
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

    def rested(self, before: Rest, delta: np.ndarray, share: np.ndarray) -> np.ndarray:
        """The watched signals (R s) at the rests `before` the run, where it begins: see `begun`."""
        x, i = self.begun(delta, share), int(self.modes[0])
        w = (delta * self.lam[i] * (x @ self.C[i].T + before.f + share @ before.J.T)) @ self.members
        return x @ self.E[i].T + before.v + share @ before.V.T + w @ self.F[i].T

    def number(self, signal: str) -> int:
        """Which of the watched signals it is."""
        if signal not in self.signals:
            raise InputError(f"no watched signal {signal}", file="Course", mend=f"one of {', '.join(self.signals)}")
        return self.signals.index(signal)


def explained(course: Course) -> np.ndarray:
    """Which parameters (p) belong to regressors that move with the loop; the others are errors that come new at every sample."""
    return np.abs(course.C).max(axis=(0, 2), initial=0.0) > 0.0


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
