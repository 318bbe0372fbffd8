"""The kernel: guaranteed bounds of the watched signals and the states of a course at every instant.

|w_j(k)| <= W_j(k), and with Phi(k, l) = A(k-1) .. A(l)

    W_j(k) = max over signs s of channel j of |s'(lam z_nom)| + sum_l,c |s'(lam C Phi(k, l+1) B_c)| W_c(l)
    |v - v_nom| <= sum_l,c |E Phi(k, l+1) B_c| W_c(l) + |F| W(k)

and Phi(k, 0) T u beside the sums in both. Each former w_c(l) is a column Phi(k, l+1) B_c that is carried along. Columns that have
nearly died out are exchanged for a box: every |e| <= 1 sum of col_l W(l) e_l lies in sum_i [-1, 1] T_i (|T^-1 col| W)_i, whatever
T, and the n columns T_i with these weights are carried along like any other. No decay is assumed: the exchange is an outer bound
for every loop and only costs width, so it is made where it costs nearly none. The equations are those of `course`.
"""

import numpy as np

from workbench.intervals.propagation import MOST_SIGNS
from workbench.records import field, record
from workbench.robustness import rests
from workbench.robustness.envelopes.course import Course, Nominal, nominal
from workbench.robustness.rests import TINY, Rest, Start

AGE = 64  # samples after which columns of the kernel may be exchanged for a box
WIDER = 1e-4  # by which one exchange may widen what is seen, relative
YOUNG, RISEN = 8, 1e-10  # samples that a box of rounding is carried, and its share of what is seen from which it is no longer
HUGE = 1e100  # TINY is above what underflow takes from a product with two factors up to it; beyond it nothing is said


@record
class Drive:
    """What moves the deviations from a run: |s'(lam z)| of every row of signs without them, own (N J), what a step (N n) and the
    signals (N s) may be off besides, missed and unseen, and the set in which the deviation begins.
    """

    own: np.ndarray = field("N J", low=0.0)
    missed: np.ndarray = field("N n", low=0.0)
    unseen: np.ndarray = field("N s", low=0.0)
    start: Start | None


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
    run, rows = nominal(course), rows_of(course)
    return carried(course, run, Drive(*rounded_run(course, run, rows, np.ones(rows.shape[1])), starts(course)))


def carried(course: Course, run: Nominal, drive: Drive) -> Kernel:
    """The bounds of what a drive moves around a run; see `kernel`."""
    m, channels = course.modes, channels_of(course)
    (N, n), c, s, rows = course.q.shape, course.B.shape[2], len(course.signals), rows_of(course)
    ends = np.cumsum([0, *(len(signs) for signs, _ in channels)])
    look = np.concatenate([(rows * course.lam[:, None]) @ course.C, course.E], axis=1)  # (M J+s n)
    unit = rounding(n + course.f.shape[1])
    A, F, one = np.abs(course.A), np.abs(course.F), np.eye(c)
    sizes = np.concatenate([(np.abs(rows) * course.lam[:, None]) @ np.abs(course.C), np.abs(course.E)], axis=1)
    half, state, gains = np.full((N, s), np.inf), np.full((N, n), np.inf), np.zeros((c, c))
    own, missed, unseen, start = drive.own, drive.missed, drive.unseen, drive.start
    begun = start or rests.known(n)
    lost, used = begun.slack, len(begun.size)
    Z, weight, born = _first_columns(begun, c)
    whole = (course.A, course.B, course.C, course.E, course.F, course.lam, course.q, course.g, course.f, run.x, run.z, sizes)
    sound = start is not None and all(np.abs(values).max(initial=0.0) <= HUGE for values in whole)
    W, kept, grown = np.zeros(c), 0, False
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
            now, up = Z[:, :used], 1.0 + rounding(used + n + len(look[i]))
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


def rounded_run(course: Course, run: Nominal, rows: np.ndarray, counted: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """|s'(lam z_nom)| with its rounding (N J), and what rounding takes from a step (N n) and from v (N s) of the nominal run.

    counted (p): 0 for parameters whose z_nom is left out of the first; its rounding is not.
    """
    m, x, unit = course.modes, np.abs(run.x), rounding(course.q.shape[1] + course.f.shape[1])
    missed = unit * (np.einsum("kin,kn->ki", np.abs(course.A)[m], x) + np.abs(course.q))
    unseen = unit * (np.einsum("ksn,kn->ks", np.abs(course.E[m]), x) + np.abs(course.g))
    felt = course.lam[m] * (np.einsum("kpn,kn->kp", np.abs(course.C[m]), x) + np.abs(course.f))
    own = np.abs((course.lam[m] * run.z * counted) @ rows.T) + unit * felt @ np.abs(rows).T
    return own, missed, unseen


def _first_columns(begun: Start, c: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns Z of the start with room for more, the bound of each column's w and 1 in its channel, and when it was born."""
    used = len(begun.size)
    room = used + 4 * AGE * c
    Z, weight = np.zeros((len(begun.slack), room)), np.zeros((room, 1 + c))
    Z[:, :used], weight[:used, 0] = begun.spread, begun.size
    if used:
        weight[used - c : used, 1:] = np.eye(c)  # the w of a rest
    return Z, weight, np.zeros(room, dtype=int)


def starts(course: Course) -> Start | None:
    """A set that holds every start of the course, or None where none is proved to."""
    if course.before is None:
        return rests.known(len(course.start))
    i = int(course.modes[0])
    return rests.holding(course.before, course.A[i], course.B[i], course.C[i], course.lam[i], course.start, channels_of(course))


def at_rest(course: Course, before: Rest, start: Start) -> tuple[np.ndarray, np.ndarray]:
    """Between which values (s) each the watched signals are before the run, at the rest of any machine of the boxes.

    E x + v + V e + F w with x in start + spread (e, w) + r, and the same w.
    """
    i = int(course.modes[0])
    E = course.E[i]
    g, unit = before.Q.shape[1], rounding(len(course.start) + course.f.shape[1])
    through = E @ start.spread
    through[:, :g] += before.V
    through[:, g:] += course.F[i]
    size = np.abs(start.spread) @ start.size + start.slack + np.abs(course.start)
    middle = E @ course.start + before.v
    half = np.abs(through) @ start.size + np.abs(E) @ start.slack
    own = np.abs(before.v) + np.abs(before.V).sum(axis=1) + np.abs(course.F[i]) @ start.size[g:]
    half = half + unit * (np.abs(E) @ size + own + half)
    half = half * (1.0 + unit) + TINY
    return np.nextafter(middle - half, -np.inf), np.nextafter(middle + half, np.inf)


def window_start(course: Course, first: int, outer: Kernel | None) -> Start | None:
    """The set in which a window begins around the nominal run: as the kernel knows it, or the starts of the course themselves."""
    if first == 0 or outer is None:
        return starts(course) if outer is None else outer.start
    box = outer.state[first]
    return Start(np.eye(len(box)), box, np.zeros(len(box))) if np.isfinite(box).all() else None


def channels_of(course: Course) -> list[tuple[np.ndarray, bool]]:
    """Of every channel its rows of signs (J p), and whether a bound is their sum instead of their maximum."""
    return [_signs(np.flatnonzero(course.channel == j), course) for j in range(course.B.shape[2])]


def rows_of(course: Course) -> np.ndarray:
    """The rows of signs (J p) of all channels, one after the other."""
    return np.concatenate([signs for signs, _ in channels_of(course)])


def rounding(terms: int) -> float:
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
    n, unit = len(Z), rounding(used + len(Z))
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
