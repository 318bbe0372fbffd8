"""How much wider the boxes may be until the loop is lost: kappa multiplies every radius, so that 1 is what the records allow.

    frozen       parameters that stand still, but nobody knows where          exact for one regression
    arbitrary    parameters that move as they like at every sample            certified <= margin <= falsified

Frozen, one regression. 1 = kappa sum_i delta_i g_i(omega), g = C (zI - A)^-1 b lam at z = exp(j omega), is a pole on the unit
circle. {sum_i delta_i g_i} is a zonogon, and 1 / kappa leaves it through one of its sides:

    kappa(omega) = max over d of |d . 1| / sum_i |d . g_i|,   d orthogonal to one of the g_i

The smallest over omega is found on a grid and refined. A grid may miss it: where the zonogon is flat, as for one parameter, only
single frequencies count, and beside a pole near the circle a valley is narrow. So the edges of the box decide (`lost_on_an_edge`)
wherever they are few enough, and where they are not the margin is not called exact. The frozen margin says nothing of
parameters that move: it is an upper bound of the arbitrary one, on examples by a factor from 1.07 to 5.

Arbitrary, certified. x'P x decreases for every A(delta): P - A(delta)'P A(delta) is concave in A, so the corners of the box
suffice. Without corners, for any number of parameters, with a multiplier D_i >= 0 for each:

    [P - A'P A - C'D C, -A'P B; -B'P A, D - B'P B] > 0,   B = kappa b_j lam_i in column i

Arbitrary, falsified. A periodic sequence of corners whose product has a pole outside the unit circle, improved by

    d|lambda| / d delta_i(k) ~ Re(conj(lambda) (l(k+1)'b_i)(C_i x(k)) lam_i / (l'x)),    x, l the eigenvectors carried along

All of a certificate is checked in outward-rounded arithmetic; a solver's status counts for nothing.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from workbench.errors import InputError
from workbench.intervals.arithmetic import Interval, exact, positive_definite
from workbench.records import field, record
from workbench.robustness.semidefinite import Block, maximise, symmetric
from workbench.robustness.uncertain import UncertainLoop

FREQUENCIES = 4000
MOST_CORNERS = 12  # parameters up to which all corners of the box are looked at
MOST_EDGES = 8
EDGE = 1.0 - 1e-6  # of a frozen margin, at which no edge may be lost
LENGTHS = (*range(1, 26), 30, 36, 43, 52, 62, 74, 89, 107, 128, 154, 184)  # samples of a periodic sequence, at first
LONGEST, NEAR = 200, 0.1  # by how much lengths differ that are tried beside the best one
LOWER = 0.995  # ratio of two margins from which it is tried again
MOST = 1e6  # times what small gains tell: a margin beyond is none
STARTS, PARTS = 3, 8  # random sequences of each length; pieces of those that move slowly
SWEEPS, PART, LEAST = 12, 0.3, 0.02  # steps of one, see `_improved`
CLOSE, ROUGH = 1.03, 1.1  # ratios of bounds at which a search ends, and one that another goes on from
ADDED = 2  # corners that enter the program in a round
ROUNDS = 30


@record
class FrozenMargin:
    """kappa, and the constant parameters (p, within 1) with which kappa A(delta) has a pole at exp(j omega) [rad / sample].

    exact: confirmed on every edge of the box (in floating point); otherwise kappa is only an upper bound.
    """

    kappa: float
    delta: np.ndarray = field("p")
    omega: float
    exact: bool


@record
class Certificate:
    """P (n n) with x'P x falling over `steps` samples for every parameter sequence in kappa times the box.

    D (p): multipliers of the parameters, for one step; or none: proved at every corner, of several steps at all their products.
    """

    kappa: float
    P: np.ndarray = field("n n")
    D: np.ndarray | None = None
    steps: int = 1

    def holds(self, loop: UncertainLoop) -> bool:
        """Whether that is proved of `loop`, in outward-rounded arithmetic; parameters that change nothing need no multiplier."""
        alive = loop.alive
        loop, D = loop.only(alive), self.D
        if self.P.shape != loop.A.shape or not np.array_equal(self.P, self.P.T) or not positive_definite(self.P):
            return False
        P, B = exact(self.P), exact(loop.B[:, loop.channel.astype(int)]) * (exact(loop.lam) * self.kappa)
        if D is None:
            if self.steps * len(loop.lam) > MOST_CORNERS:
                return False
            A = whole = exact(loop.A) + (B * corners(len(loop.lam))[:, None, :]) @ loop.C
            for _ in range(self.steps - 1):  # affine in the parameters of each step by itself, so that corners suffice
                whole = A[:, None] @ whole
                whole = Interval(whole.low.reshape(-1, *P.shape), whole.high.reshape(-1, *P.shape))
            return bool(positive_definite(P - _transposed(whole) @ (P @ whole)).all())
        if D.shape != alive.shape or not (D >= 0.0).all():
            return False
        return falls(P, P, loop.A, B, loop.C, D[alive])


@record
class Falsified:
    """kappa, and a sequence delta (L p) within the box which, repeated, multiplies a state by `growth` >= 1 each time."""

    kappa: float
    delta: np.ndarray = field("L p", low=-1.0, high=1.0)
    growth: float

    def replay(self, loop: UncertainLoop) -> float:
        """Largest modulus of a pole of the product over one period."""
        return _growth(loop, self.kappa, self.delta)


@record
class Margin:
    """certified.kappa <= the margin under parameters that move as they like <= falsified.kappa; and the frozen margin.

    loop: the balanced loop of whose numbers the certificate is proved, the loop that was asked about but for rounding.
    """

    loop: UncertainLoop
    certified: Certificate
    falsified: Falsified
    frozen: FrozenMargin

    @property
    def gap(self) -> float:
        """falsified / certified, 1 where nothing is left open."""
        return self.falsified.kappa / self.certified.kappa


def margin(loop: UncertainLoop, seed: int = 0) -> Margin:
    """Both bounds of the margin of a loop, and its frozen margin. Raises InputError for a loop that is unstable as it is."""
    alive = loop.alive
    if not alive.any():
        raise InputError("no parameter is uncertain", file="UncertainLoop", mend="every margin is infinite: nothing to check")
    balanced = loop.balanced()
    own = balanced.only(alive)
    unit = _small_gain(own)
    own = replace(own, lam=own.lam * unit)
    frozen = frozen_margin(own)
    worst = falsified(own, frozen, seed)
    best = certified(own, worst)

    def whole(values: np.ndarray) -> np.ndarray:
        """Values (.., of the parameters that change something), and 0 for the others."""
        return values @ np.eye(len(alive))[alive]

    return Margin(
        balanced,
        replace(best, kappa=best.kappa * unit, D=None if best.D is None else whole(best.D)),
        replace(worst, kappa=worst.kappa * unit, delta=whole(worst.delta)),
        replace(frozen, kappa=frozen.kappa * unit, delta=whole(frozen.delta)),
    )


def _small_gain(loop: UncertainLoop) -> float:
    """The power of 2 next to the kappa at which the largest gains between parameters have a loop gain of 1: a margin's order.

    1 where no parameter acts on itself by way of others.
    """
    omega = np.concatenate([[0.0, np.pi], np.abs(np.angle(np.linalg.eigvals(loop.A)))])
    x = np.linalg.solve(np.exp(1j * omega)[:, None, None] * np.eye(len(loop.A)) - loop.A, loop.columns.astype(complex))
    gain = np.abs(np.linalg.eigvals(np.abs(loop.C @ x).max(axis=0))).max()
    return float(2.0 ** -np.round(np.log2(gain))) if gain > 0.0 else 1.0


def corners(p: int) -> np.ndarray:
    """All corners of the box [-1, 1]^p, (2^p, p)."""
    return 1.0 - 2.0 * ((np.arange(2**p)[:, None] >> np.arange(p)) & 1)


# ---- parameters that stand still ------------------------------------------------------------------------------------------


def frozen_margin(loop: UncertainLoop) -> FrozenMargin:
    """The smallest kappa at which constant parameters lose the loop; exact for one regression, else an upper bound."""
    if loop.B.shape[1] > 1:
        return _constant(loop)
    poles = np.abs(np.angle(np.linalg.eigvals(loop.A)))
    omega = np.unique(np.concatenate([[0.0, np.pi], np.linspace(0.0, np.pi, FREQUENCIES), poles, np.geomspace(1e-5, np.pi, 400)]))
    kappa = _sides(loop, omega)[0]
    low = np.flatnonzero(kappa <= np.minimum(np.append(kappa[1:], np.inf), np.insert(kappa[:-1], 0, np.inf)))
    best = omega[low[np.argsort(kappa[low])[:5]]]
    step = np.diff(omega).max()
    for _ in range(6):  # a valley may be as narrow as a pole is near the circle
        near = np.unique(np.clip((best[:, None] + step * np.linspace(-1.0, 1.0, 201)).ravel(), 0.0, np.pi))
        near = np.concatenate([near, best])
        kappa = _sides(loop, near)[0]
        best, step = near[np.argsort(kappa)[:3]], step / 50.0
    (kappa,), (normal,) = _sides(loop, best[:1])
    found = FrozenMargin(float(kappa), _on_side(loop, float(best[0]), float(kappa), normal), float(best[0]), False)
    return _by_edges(loop, found) if len(loop.lam) <= MOST_EDGES else found


def _by_edges(loop: UncertainLoop, found: FrozenMargin) -> FrozenMargin:
    """The frozen margin, lowered to where no edge of the box is lost any more."""
    high = min(found.kappa, MOST)
    if lost_on_an_edge(loop, EDGE * high) is None:
        return replace(found, exact=True)
    low, delta = 0.0, found.delta
    while high - low > 1e-7 * high:
        middle = 0.5 * (low + high) if low > 0.0 else 0.5 * high
        lost = lost_on_an_edge(loop, middle)
        low, high, delta = (middle, high, delta) if lost is None else (low, middle, lost)
        if high < 1.0 / MOST:
            break
    poles = np.linalg.eigvals(loop.at(high * delta))
    nearest = poles[np.abs(np.abs(poles) - 1.0).argmin()]
    return FrozenMargin(high, delta, float(abs(np.angle(nearest))), True)


def _gains(loop: UncertainLoop, omega: np.ndarray) -> np.ndarray:
    """g (len(omega), p): from w to every z, times lam."""
    z = np.where(omega == np.pi, -1.0, np.exp(1j * omega))  # real there: what rounding leaves of an imaginary part is no side
    x = np.linalg.solve(z[:, None, None] * np.eye(len(loop.A)) - loop.A, loop.B.astype(complex))
    return (loop.C @ x)[..., 0] * loop.lam


def _sides(loop: UncertainLoop, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """kappa (len(omega)) and the direction d, a complex number of size 1, that gives it."""
    g = _gains(loop, omega)
    turned = np.concatenate([1j * g, np.ones((len(omega), 1))], axis=1)  # where all g are real the zonogon is flat: then d = 1
    size = np.abs(turned)
    d = np.where(size > 0.0, turned / np.where(size > 0.0, size, 1.0), 1.0 + 0.0j)
    reach = np.abs(np.real(d.conj()[:, :, None] * g[:, None, :])).sum(axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.nan_to_num(np.abs(np.real(d)) / reach, nan=0.0, posinf=np.inf)
    at = ratio.argmax(axis=1)
    row = np.arange(len(omega))
    return ratio[row, at], d[row, at]


def _on_side(loop: UncertainLoop, omega: float, kappa: float, d: complex) -> np.ndarray:
    """delta with kappa sum_i delta_i g_i = 1: corners, but for the generators that lie along the side."""
    g = _gains(loop, np.array([omega]))[0]
    across = (np.conj(d) * g).real * (1.0 if d.real >= 0.0 else -1.0)
    along = (np.conj(d) * g).imag
    level = np.abs(across) <= 1e-9 * np.abs(g).max()
    delta = np.where(level, 0.0, np.sign(across))
    rest, room = -d.imag / kappa - delta @ along, np.abs(along[level]).sum()
    if room > 0.0:
        delta[level] = np.sign(along[level]) * np.clip(rest / room, -1.0, 1.0)
    return delta


def _constant(loop: UncertainLoop) -> FrozenMargin:
    """Constant corners, improved like sequences of one sample."""
    found = _lost(loop, np.random.default_rng(0).choice([-1.0, 1.0], size=(8 * STARTS, 1, len(loop.lam))), MOST)
    if found is None:
        return FrozenMargin(np.inf, np.zeros(len(loop.lam)), 0.0, False)
    poles = np.linalg.eigvals(loop.at(found.kappa * found.delta[0]))
    return FrozenMargin(found.kappa, found.delta[0], float(abs(np.angle(poles[np.abs(poles).argmax()]))), False)


def lost_on_an_edge(loop: UncertainLoop, kappa: float) -> np.ndarray | None:
    """delta (p) on an edge of kappa times the box with a pole on the unit circle, or None: then none is lost.

    The characteristic polynomial is affine in delta for one regression, D(z) - kappa sum_i delta_i N_i(z), so the edge theorem
    (Bartlett, Hollot, Huang 1988) holds. On an edge a + t b has a root of modulus 1 where a(z) b*(z) = b(z) a*(z) has one. In
    floating point; what cannot be told counts as lost.
    """
    p = len(loop.lam)
    if loop.B.shape[1] > 1 or p > MOST_EDGES:
        raise InputError(f"{p} parameters of {loop.B.shape[1]} regressions", mend=f"one regression, at most {MOST_EDGES} of them")
    D = np.poly(loop.A)
    N = np.array([np.poly(loop.A + np.outer(column, row)) - D for column, row in zip(loop.columns.T, loop.C, strict=True)])
    for i in range(p):
        for delta in np.insert(corners(p - 1), i, 0.0, axis=1):
            a, b = D + kappa * delta @ N, kappa * N[i]
            if not np.abs(b).max() > 0.0:
                if np.abs(np.roots(a)).max(initial=0.0) >= 1.0:
                    return delta
                continue
            crossing = np.polysub(np.polymul(a, b[::-1]), np.polymul(b, a[::-1]))
            z = np.roots(np.trim_zeros(np.where(np.abs(crossing) > 1e-14 * np.abs(crossing).max(), crossing, 0.0)))
            z = np.append(z[np.abs(np.abs(z) - 1.0) < 1e-4], [1.0, -1.0])
            z = z / np.abs(z)
            # at the circle by gains: where many poles lie close to it, rounding is larger than the polynomials themselves
            g = kappa * _gains(loop, np.angle(z))
            above, below = 1.0 - g @ delta, g[:, i]
            with np.errstate(divide="ignore", invalid="ignore"):
                t = np.where((np.abs(above) <= 1e-12) & (np.abs(below) <= 1e-12), 0.0, above / below)  # 0: any number does
            lost = (np.abs(np.real(t)) <= 1.0) & (np.abs(np.imag(t)) <= 1e-6)
            if lost.any():
                return delta + float(np.real(t[lost.argmax()])) * np.eye(p)[i]
    return None


# ---- parameters that move: certified --------------------------------------------------------------------------------------


def certified(loop: UncertainLoop, worst: Falsified) -> Certificate:
    """The largest kappa below that of `worst`, within the ratio CLOSE, for which a certificate was found and holds."""
    beyond = worst.kappa
    high, low = beyond, beyond / 2.0
    while (best := _held(_by_multipliers(loop, low), loop)) is None:
        high, low = low, low / 2.0
        if low < 1e-6 * beyond:
            raise InputError("no certificate, not even of the middle of the boxes", file="UncertainLoop")
    # two samples at a time gain some 5 %; the corners of a single one gain a hundredth or two and cost most of the time
    products = 2 * len(loop.lam) <= MOST_CORNERS
    best = _search(loop, high, best, lambda kappa, _: _by_multipliers(loop, kappa), ROUGH if products else CLOSE)
    return _search(loop, beyond, best, _Corners(loop, 2, worst.delta)) if products else best


def _held(found: Certificate | None, loop: UncertainLoop) -> Certificate | None:
    """A certificate that is proved, or none."""
    return found if found is not None and found.holds(loop) else None


def _search(
    loop: UncertainLoop,
    high: float,
    best: Certificate,
    attempt: Callable[[float, Certificate], Certificate | None],
    close: float = CLOSE,
) -> Certificate:
    """Bisection in the logarithm of kappa, from `best` up: what is not proved does not count."""
    while high / best.kappa > close:
        kappa = float(np.sqrt(high * best.kappa))
        found = _held(attempt(kappa, best), loop)
        if found is None:
            high = kappa
        else:
            best = found
    return best


def _by_multipliers(loop: UncertainLoop, kappa: float) -> Certificate | None:
    """P, D and t with the block of the module >= t diag(1, 0), t as large as can be; trace P = n.

    In the program every z has a row of size 1, so that its multipliers are of the size of P in whatever unit z is.
    """
    n, p = len(loop.A), len(loop.lam)
    unit = np.linalg.norm(loop.C, axis=1)
    A, B, C = loop.A, kappa * loop.columns * unit, loop.C / unit[:, None]
    E, G = symmetric(n), np.zeros((p, p, p))
    G[np.arange(p), np.arange(p), np.arange(p)] = 1.0
    size = len(E) + p + 1
    F = np.zeros((size, n + p, n + p))
    EA, EB = E @ A, E @ B
    F[: len(E), :n, :n] = E - A.T @ EA
    F[: len(E), :n, n:] = -A.T @ EB
    F[: len(E), n:, :n] = F[: len(E), :n, n:].swapaxes(1, 2)
    F[: len(E), n:, n:] = -B.T @ EB
    F[len(E) : -1, :n, :n] = -np.einsum("ia,ib->iab", C, C)
    F[len(E) : -1, n:, n:] = G
    F[-1, :n, :n] = -np.eye(n)
    trace = np.concatenate([np.trace(E, axis1=1, axis2=2), np.zeros(p + 1)])[None]
    x = maximise(np.eye(size)[-1], [Block(np.zeros((n + p, n + p)), F, np.arange(size))], (trace, np.array([float(n)])))
    if x is None:
        return None
    return Certificate(kappa, np.tensordot(x[: len(E)], E, 1), np.maximum(x[len(E) : -1], 0.0) / unit**2)


class _Corners:
    """P with P - A'P A >= t at every corner, t as large as can be; A is the product over `steps` samples.

    The corners that a worst sequence delta (L p) passes enter the program first, others where the last P fails; those that
    entered for one kappa stay for the next.
    """

    def __init__(self, loop: UncertainLoop, steps: int, delta: np.ndarray):
        self.loop, self.steps = loop, steps
        p = delta.shape[1]
        passed = (delta < 0.0) @ (1 << np.arange(p))  # places in `corners`
        later = sum(np.roll(passed, -k) << (p * k) for k in range(steps))
        self.active = [int(v) for v in np.unique(later)]

    def __call__(self, kappa: float, last: Certificate) -> Certificate | None:
        loop, n = self.loop, len(self.loop.A)
        into = np.linalg.cholesky(last.P).T  # where the last P is 1 the solver is at home
        one = every = into @ loop.at(kappa * corners(len(loop.lam))) @ np.linalg.inv(into)
        for _ in range(self.steps - 1):
            every = (one[:, None] @ every).reshape(-1, n, n)
        E, P = symmetric(n), np.eye(n)
        trace = np.append(np.trace(E, axis1=1, axis2=2), 0.0)[None]
        for _ in range(ROUNDS):
            falls = np.linalg.eigvalsh(P - every.swapaxes(1, 2) @ P @ every)[:, 0]
            if falls.min() > 0.0:
                P = into.T @ P @ into
                return Certificate(kappa, 0.5 * (P + P.T), steps=self.steps)
            new = [int(v) for v in np.argsort(falls)[: 2 * ADDED] if v not in self.active][:ADDED]
            if not new:
                return None
            self.active += new
            F = [np.concatenate([E - A.T @ E @ A, -np.eye(n)[None]]) for A in every[self.active]]
            x = maximise(
                np.append(np.zeros(len(E)), 1.0),
                [Block(np.zeros((n, n)), f, np.arange(len(f))) for f in F],
                (trace, np.array([float(n)])),
            )
            if x is None or x[-1] <= 0.0:
                return None
            P = np.tensordot(x[:-1], E, 1)
        return None


def falls(P: Interval, then: Interval, A: np.ndarray, B: Interval, C: np.ndarray, D: np.ndarray) -> bool:
    """Whether [P - A'then A - C'D C, -A'then B; ., D - B'then B] > 0 is proved: the block of the module with P after the step."""
    PA, PB = then @ A, then @ B
    first = P - A.T @ PA - C.T @ (exact(D)[:, None] * C)
    return bool(positive_definite(_bordered(first, -(A.T @ PB), np.diag(D) - _transposed(B) @ PB)))


def _transposed(x: Interval) -> Interval:
    return Interval(x.low.swapaxes(-1, -2), x.high.swapaxes(-1, -2))


def _bordered(first: Interval, beside: Interval, last: Interval) -> Interval:
    """[first, beside; beside', last]."""

    def whole(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
        return np.block([[a, b], [b.T, c]])

    return Interval(whole(first.low, beside.low, last.low), whole(first.high, beside.high, last.high))


# ---- parameters that move: falsified --------------------------------------------------------------------------------------


def falsified(loop: UncertainLoop, frozen: FrozenMargin, seed: int = 0) -> Falsified:
    """The smallest kappa at which a periodic sequence was found that the loop does not survive."""
    random = np.random.default_rng(seed)
    lengths = set(LENGTHS)
    if frozen.omega > 0.0:
        lengths |= {min(LONGEST, max(1, round(turns * np.pi / frozen.omega))) for turns in (1, 2)}
    best = None
    if np.isfinite(frozen.kappa):
        best = _lost(loop, np.stack([frozen.delta, np.sign(frozen.delta)])[:, None, :], frozen.kappa * (1.0 + 1e-6))
    for length in sorted(lengths):
        found = _lost(loop, _starts(random, length, len(loop.lam)), MOST if best is None else best.kappa)
        best = found or best
    former = np.inf
    while best is not None and best.kappa < former * LOWER:  # a slow turn of the state has a length of its own
        former = best.kappa
        for length in _near(len(best.delta)):
            stretched = best.delta[None, np.arange(length) * len(best.delta) // length]
            starts = np.concatenate([stretched, _starts(random, length, len(loop.lam))])
            best = _lost(loop, starts, best.kappa, LEAST) or best
    if best is None:
        raise InputError(
            "no parameters were found that move a pole to the unit circle",
            file="UncertainLoop",
            mend="do the uncertain regressors see what they drive?",
        )
    return best


def _starts(random: np.random.Generator, length: int, p: int) -> np.ndarray:
    """Random signs (S length p): new ones at every sample, and for a slow loop ones that stay for a while."""
    new = random.choice([-1.0, 1.0], size=(STARTS, length, p))
    parts = np.arange(length) * PARTS // length
    return np.concatenate([new, random.choice([-1.0, 1.0], size=(STARTS, PARTS, p))[:, parts]]) if length > PARTS else new


def _near(length: int) -> set[int]:
    """Lengths around one, and around its parts."""
    around = {round(length / turns * (1.0 + share)) for turns in (1, 2, 3, 4) for share in np.linspace(-NEAR, NEAR, 11)}
    return {each for each in around if 1 <= each <= LONGEST}


def _lost(loop: UncertainLoop, delta: np.ndarray, below: float, least: float = 1.0) -> Falsified | None:
    """The smallest kappa < below at which one of the sequences delta (S L p), improved, grows; or None. least: of `_improved`."""
    kappa, best = below, None
    if below >= MOST:  # nobody knows where the margin lies: from below, for far beyond it every sequence grows
        kappa = 1.0 / MOST
        while kappa < MOST and _improved(loop, kappa, delta, least)[1].max() < 1.0:
            kappa *= 1.5
    delta, size = _improved(loop, kappa, delta, least)
    while size.max() >= 1.0:
        own = delta[size.argmax()]
        low, high = 0.0, kappa
        while high - low > 1e-7 * high:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if _growth(loop, middle, own) >= 1.0 else (middle, high)
        best = Falsified(high, own, _growth(loop, high, own))
        if high >= kappa * (1.0 - 1e-4):
            break
        kappa = high
        delta, size = _improved(loop, kappa * (1.0 - 1e-6), delta, least)
    return best


def _improved(loop: UncertainLoop, kappa: float, delta: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Sequences (S L p) after steps to the signs of their own slopes while that helps, and their growth (S).

    least: the share of the signs, the steepest, down to which fewer of them change where more do not help.
    """
    at, share = _carried(loop, kappa, delta), 1.0
    for _ in range(SWEEPS):
        gain = np.abs(at.slope) * (np.sign(at.slope) != np.sign(delta))
        steep = np.quantile(gain.reshape(len(delta), -1), 1.0 - share, axis=1)[:, None, None]
        other = np.where((gain > 0.0) & (gain >= steep), np.sign(at.slope), delta)
        new = _carried(loop, kappa, other)
        better = new.size > at.size * (1.0 + 1e-9)
        if not better.any():
            share *= PART
            if share < least:
                break
            continue
        delta = np.where(better[:, None, None], other, delta)
        at = _Carried(np.where(better, new.size, at.size), np.where(better[:, None, None], new.slope, at.slope))
    return delta, at.size


def _growth(loop: UncertainLoop, kappa: float, delta: np.ndarray) -> float:
    """Largest modulus of a pole over one period of delta (L p)."""
    whole = np.eye(len(loop.A))
    for A in loop.at(kappa * delta):
        whole = A @ whole
    return float(np.abs(np.linalg.eigvals(whole)).max())


class _Carried(NamedTuple):
    """Of S periodic sequences: largest modulus of a pole over one period (S), and its slope along every delta (S L p)."""

    size: np.ndarray
    slope: np.ndarray


def _carried(loop: UncertainLoop, kappa: float, delta: np.ndarray) -> _Carried:
    at = orbits(loop.at(kappa * delta))
    return _Carried(at.size, np.real((at.left @ loop.columns) * (at.right @ loop.C.T)))


class Orbits(NamedTuple):
    """Of S periodic sequences of matrices A (S L n n): the largest modulus of a pole over one period (S) and its eigenvectors.

    left, right (S L n): Re(left' dA right) is the slope of log |pole| along a change dA of the matrix at that sample, times
    |pole|^2 > 0; left is that of the sample after, and 0 where the pole is double and has one direction only.
    """

    size: np.ndarray
    left: np.ndarray
    right: np.ndarray


def orbits(A: np.ndarray) -> Orbits:
    S, L, n, _ = A.shape
    whole = A[:, 0]
    for k in range(1, L):
        whole = A[:, k] @ whole
    values, right = np.linalg.eig(whole)
    row, at = np.arange(S), np.abs(values).argmax(axis=1)
    largest = values[row, at]
    others, left = np.linalg.eig(whole.swapaxes(1, 2))
    x = start = right[row, :, at]
    back = left[row, :, np.abs(others - largest[:, None]).argmin(axis=1)]
    across = np.einsum("sn,sn->s", back, start)
    back = back * np.where(across == 0.0, 0.0, np.conj(largest) / np.where(across == 0.0, 1.0, across))[:, None]
    seen, pushed = np.empty((S, L, n), dtype=complex), np.empty((S, L, n), dtype=complex)
    for k in range(L):
        seen[:, k] = x
        x = (A[:, k] @ x[..., None])[..., 0]
    for k in reversed(range(L)):
        pushed[:, k] = back
        back = (back[:, None, :] @ A[:, k])[:, 0]
    return Orbits(np.abs(largest), pushed, seen)
