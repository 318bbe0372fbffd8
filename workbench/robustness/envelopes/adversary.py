"""The adversary: for one (signal, instant, side), the parameter sequence that drives the signal as far to that side as is found.

v is affine in every w_j(k) while the others stay, so that with p the gradient of the signal in x(k+1) the best sign of w_j(k) is
that of p'b_j: coordinate ascent, backward and forward; the result is replayed. The parameters at whose rest it begins have their
signs from the slope in the same way. The equations are those of `course`.
"""

from collections.abc import Sequence

import numpy as np

from workbench.errors import InputError
from workbench.records import field, record
from workbench.robustness.envelopes.course import Course, replay
from workbench.robustness.rests import Rest

STARTS = 8  # of the adversary for each question
SWEEPS = 30


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
