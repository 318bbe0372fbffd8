"""Advice on records, in plain words: what the data cannot show, and what to do about it.

Nothing here is an error: a record that can be read can be used, at the user's risk.
"""

import math
from collections.abc import Callable, Iterator
from typing import Literal, get_args

import numpy as np

from workbench.data import JITTER, Channel, Dataset, Experiment, Role, bad_stamps
from workbench.errors import InputError, check_known
from workbench.records import field, record

Kind = Literal[
    "stamps",
    "jitter",
    "constant",
    "clipped",
    "quantum",
    "outliers",
    "magnitude",
    "excitation",
    "feedback",
    "schedule-span",
    "too-short",
]
Severity = Literal["note", "warning"]

#: Chance at which an open-loop record is taken for a closed-loop one.
LEVEL = 0.005
#: Moves of an input, far before a sample or after it, that tell how much a linear model misses; samples that far after is.
BEFORE, FAR = 40, 40
#: Correlation that biases no model by as much as its noise does, and that any large record's misfit may show.
SLIGHT = 0.025
#: Parts of a record of which any may be left out: a law answers in all of them, a sweep passes a resonance once.
PARTS = 4
#: Regressions of an input are up to so many times as long; white is what has autocorrelations below so many standard errors.
DEEPEST, COLOUR = 10, 1.6
#: Share of its variance by which an input that repeats may differ from one period to the next.
REPEATS = 1e-5
#: Samples from which the levels of a channel are told.
ENOUGH = 200_000
#: Largest magnitude that is still plausible in a unit; above it, the unit is probably another one.
PLAUSIBLE = {"m": (20.0, "mm"), "rad": (300.0, "deg"), "rad/s": (1000.0, "rpm"), "deg": (36000.0, "counts")}


@record
class Advice:
    """One sentence on one record (and channel, where it is about one): what was seen, and what to do."""

    kind: Kind
    record: str
    channel: str
    sentence: str
    severity: Severity

    def __post_init__(self):
        check_known("kind of advice", self.kind, get_args(Kind))
        check_known("severity", self.severity, get_args(Severity))

    def __str__(self) -> str:
        place = f"{self.record}, {self.channel}" if self.channel else self.record
        return f"{self.severity}: {place}: {self.sentence}"


@record
class Feedback:
    """Does the input answer the output? statistic is the largest |z| of corr(e(t), w(t + k)), k > 0, over all pairs.

    e: innovations of the outputs, w: of the inputs; p_value is family-wise (Bonferroni over pairs and lags); lag in
    samples. `law` is the share of the input's innovations that a fixed linear law in a logged reference and the outputs
    leaves unexplained (1 where no reference is logged). `detected` is a yes of either.
    """

    input: str
    output: str
    lag: int
    statistic: float = field("", low=0.0)
    p_value: float = field("", low=0.0, high=1.0)
    law: float = field("", low=0.0)

    @property
    def detected(self) -> bool:
        return self.p_value < LEVEL or self.law < 1e-4


def advise(dataset: Dataset, *, order: int | None = None) -> tuple[Advice, ...]:
    """What to know before these records are used: one sentence for each thing that they cannot show, and what to do about it.

    order: the model order asked for, where it is known. Nothing here is an error; a record that can be read can be used.

        >>> for advice in advise(data):
        ...     print(advice)
        note: a, b, way: runs from -0.001365 to 11.98 mm; a model holds on that range only
    """
    found: list[Advice] = []
    for experiment in dataset:
        for check in CHECKS:
            found += check(experiment)
        found += _excitation(experiment, order or 5)
        found += _too_short(experiment, order)
    return (*found, *_schedule_span(dataset))


# ---- feedback --------------------------------------------------------------------------------------------------------


def feedback(experiment: Experiment, *, order: int = 10, lags: int = 10) -> Feedback:
    """z = sum_t e(t) w(t+k) / sqrt(c sum_t e(t)^2 w(t+k)^2), k = 1 .. lags: zero mean unless the loop is closed.

    e: residuals of a VARX of `order`, in long records of four times as much, of outputs on inputs; w: residuals of an
    autoregression of each input on all inputs and references, as long as makes w white. Both are least squares by QR with
    constant and trend. c >= 1 corrects for what colour is left in e and w (Bartlett). The smallest z counts that is left without
    any quarter of the record, divided by what e and w have in common far from these lags where w is not white: no loop explains
    that. A z of less than SLIGHT of a correlation counts as none. An input that is held for several samples is judged at the
    instants it can move. At most the first 50 000 samples are used. An input that repeats itself is no answer to noise; one that
    its own past predicts (a ramp, a few sines) cannot be judged: both are left out.
    Raises InputError without inputs or outputs, or with fewer samples than twice the regressors.
    """
    inputs = [n for n in experiment.names_of("input") if np.ptp(experiment[n]) > 0]
    outputs = [n for n in experiment.names_of("output") if np.ptp(experiment[n]) > 0]
    if not inputs or not outputs:
        raise InputError("no input or no output that moves", file=experiment.name, mend="name them: with_roles(inputs, outputs)")
    references = [n for n in experiment.names_of("reference") if np.ptp(experiment[n]) > 0]
    u, y, r = (_standard(experiment[names][:50_000]) for names in (inputs, outputs, references))
    order = min(order, len(u) // (4 * (u.shape[1] + y.shape[1] + r.shape[1])))
    if order < 1 or len(u) < 10 * lags:
        raise InputError(f"{len(u)} samples are too few", file=experiment.name, mend="use a longer record")
    deep = max(order, min(4 * order, len(u) // (20 * (u.shape[1] + y.shape[1]))))
    e = _residual(y, np.hstack([y, u]), deep)
    worst = (0.0, inputs[0], outputs[0], 1)
    tests = 0
    for i, name in enumerate(inputs):
        if _repeats(u[:, i]):
            continue
        hold, phase = _clock(u[:, i])
        moved = slice(phase, None, hold)
        w = np.full(len(u), np.nan)
        news, white = _news(u[moved], r[moved], i, order)
        told = news[np.isfinite(news)]
        if len(told) < 2 or not told.var() > 1e-6:
            continue
        w[moved] = news
        for j, output in enumerate(outputs):
            if np.nanvar(e[:, j]) < 1e-20:
                continue
            tests += lags
            usual = 1.0 if white else _misfit(e[:, j], w, deep, hold)
            for k in range(1, lags + 1):
                z = _z(e[: len(e) - k, j], w[k:]) / usual
                worst = max(worst, (z, name, output, k))
    p = min(1.0, tests * math.erfc(worst[0] / math.sqrt(2)))
    return Feedback(
        worst[1], worst[2], worst[3], statistic=worst[0], p_value=p if tests else 1.0, law=_law(u, y, r) if len(r.T) else 1.0
    )


def in_a_loop(experiment: Experiment) -> bool:
    """Whether set-points are logged, or inputs answer outputs; no where the record cannot tell."""
    try:
        return bool(experiment.names_of("reference")) or feedback(experiment).detected
    except InputError:  # too short, or nothing moves
        return False


def _standard(values: np.ndarray) -> np.ndarray:
    return (values - values.mean(axis=0)) / values.std(axis=0)


def _residual(target: np.ndarray, past: np.ndarray, order: int, now: np.ndarray | None = None) -> np.ndarray:
    """target(t) less its least-squares fit on past(t-1) .. past(t-order), now(t), 1 and t; NaN before `order`."""
    count = len(target)
    trend = np.column_stack([np.ones(count - order), np.linspace(-1, 1, count - order)])
    columns = [past[order - k : count - k] for k in range(1, order + 1)] + [trend]
    regressors = np.hstack(columns if now is None else [*columns, now[order:]])
    # a little ridge: held and noise-free channels make columns that depend on one another
    ridge = 1e-5 * math.sqrt(count) * np.eye(regressors.shape[1])
    q, _ = np.linalg.qr(np.vstack([regressors, ridge]))
    q = q[: count - order]
    residual = np.full(target.shape, np.nan)
    residual[order:] = target[order:] - q @ (q.T @ target[order:])
    return residual


def _clock(u: np.ndarray) -> tuple[int, int]:
    """How many samples an input is held, and the first sample at which it can move."""
    moves = np.flatnonzero(np.diff(u)) + 1
    hold = int(np.gcd.reduce(np.diff(moves))) if len(moves) > 1 else 1
    return max(hold, 1), int(moves[0]) % max(hold, 1)


def _z(e: np.ndarray, w: np.ndarray) -> float:
    kept = np.isfinite(e) & np.isfinite(w)
    e, w = e[kept], w[kept]
    colour = 1.0 + 2.0 * sum(_correlation(e, j) * _correlation(w, j) for j in range(1, min(20, len(e) // 4)))
    if not len(e):
        return 0.0
    product, edges = e * w, np.linspace(0, len(e), PARTS + 1).astype(int)[:-1]
    total, spread = np.add.reduceat(product, edges), max(colour, 1.0) * np.add.reduceat(product**2, edges)
    left = np.append(total.sum() - total, total.sum())  # without each part, and with all of them
    scale = np.sqrt(np.append(spread.sum() - spread, spread.sum()))
    z = float(np.min(np.abs(left) / np.where(scale > 0.0, scale, np.inf)))
    return z if z > SLIGHT * math.sqrt(len(e)) else 0.0


def _news(u: np.ndarray, r: np.ndarray, i: int, order: int) -> tuple[np.ndarray, bool]:
    """What input i (N,) brings that the past of inputs u and set-points r does not hold, and whether that is white.

    By a regression of this order, or one as long as it takes: what is left of a slow, band-limited or swept input after a short
    one is told by older inputs still, and goes with whatever a model of the machine misses of them.
    """
    own, news, white = np.hstack([u, r]), np.full(len(u), np.nan), False
    for depth in (order, 3 * order, DEEPEST * order):
        if not 1 <= depth <= len(own) // (4 * own.shape[1]):
            break
        news = _residual(u[:, i : i + 1], own, depth, now=r)[:, 0]
        x = news[np.isfinite(news)]
        seen = [_correlation(x, lag) for lag in range(1, min(30, len(x) // 4))]
        white = bool(np.mean(np.square(seen)) * len(x) < COLOUR**2) if np.any(x) and seen else False
        if white:
            break
    return news, white


def _misfit(e: np.ndarray, w: np.ndarray, order: int, hold: int) -> float:
    """Root mean square of z between e(t) and w far before it, beyond the regressors, or far after it; 1 at least.

    What a linear model of this order misses of a nonlinear or slow machine is a function of older inputs, and where an input can
    be told from its past in any way (a sweep, a sum of sines) it is one of later inputs as well: such e and w go together without
    any feedback, long before and long after as much as at the lags at which a loop answers.
    """
    lags = [k for k in range(order + 1, order + 1 + BEFORE * hold, hold) if k < len(e) // 4]
    before = [_z(e[k:], w[: len(w) - k]) for k in lags]
    after = [_z(e[: len(e) - k - FAR], w[k + FAR :]) for k in lags if k + FAR < len(e) // 2]
    return max([1.0, *(float(np.sqrt(np.mean(np.square(side)))) for side in (before, after) if side)])


def _repeats(u: np.ndarray) -> bool:
    """Whether an input (N,) is one and the same course again and again: noise does not repeat, and no feedback of it does."""
    moves = u - u.mean()
    power = np.abs(np.fft.rfft(moves, 2 * len(u))) ** 2
    own = np.fft.irfft(power)[: len(u) // 2 + 1] / (len(u) - np.arange(len(u) // 2 + 1))
    apart = np.flatnonzero(own < 0.5 * own[0])
    if not len(apart):
        return False
    period = int(apart[0] + np.argmax(own[apart[0] :]))
    return float(np.var(u[period:] - u[:-period])) < REPEATS * float(np.var(u))


def _correlation(x: np.ndarray, lag: int) -> float:
    return float(x[lag:] @ x[:-lag] / (x @ x)) if np.any(x) else 0.0


def _law(u: np.ndarray, y: np.ndarray, r: np.ndarray) -> float:
    """Share of u's innovations that u(t) = f(u(t-1..3), y(t..t-3), r(t..t-3)), f linear, leaves unexplained."""
    own = _residual(u, u, 3)[3:]
    law = _residual(u, np.hstack([u, y, r]), 3, now=np.hstack([y, r]))[3:]
    without = _residual(u, np.hstack([u, y]), 3, now=y)[3:]
    if np.var(own) < 1e-10 or np.var(without) < 1e-10:  # predictable without the reference: says nothing about it
        return 1.0
    return float(np.min(np.var(law, axis=0) / np.maximum(np.var(own, axis=0), 1e-300)))


def _feedback(experiment: Experiment) -> Iterator[Advice]:
    try:
        found = feedback(experiment)
    except InputError:
        return
    if found.detected:
        why = (
            f"{found.input} follows a fixed law in a logged set-point and the outputs"
            if found.law < 1e-4
            else f"{found.input} answers {found.output} after {found.lag} samples (p = {found.p_value:.1g})"
        )
        yield Advice(
            "feedback",
            experiment.name,
            found.input,
            f"closed loop: {why}; N4SID is biased there, the default methods (PBSID, SSM) are made for it",
            "warning",
        )


# ---- single channels -------------------------------------------------------------------------------------------------


def quantum(values: np.ndarray) -> float:
    """Largest step q with values = offset + integer q to 5 % of q: the resolution of a channel (N,); 0 if there is none."""
    levels = np.unique(_thinned(values))
    if len(levels) < 8:
        return 0.0
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * (levels[-1] - levels[0])]
    smallest = float(steps.min())
    near = steps[steps < 10.5 * smallest]
    q = float(near.sum() / np.round(near / smallest).sum())
    off = np.abs(steps / q - np.round(steps / q))
    return q if np.mean(off < 0.05) > 0.99 else 0.0


def _thinned(values: np.ndarray) -> np.ndarray:
    """At most ENOUGH of the values (N,), evenly."""
    return values[:: max(-(-len(values) // ENOUGH), 1)]


def _noise(values: np.ndarray) -> float:
    """Standard deviation of the white part: median |second difference| / (0.6745 sqrt 6)."""
    return float(np.median(np.abs(np.diff(values, 2))) / (0.6745 * math.sqrt(6))) if len(values) > 4 else 0.0


def _of(experiment: Experiment, *roles: Role) -> Iterator[tuple[Channel, np.ndarray]]:
    for channel in experiment.channels:
        if channel.has_role(*roles):
            yield channel, experiment[channel.name]


def _stamps(experiment: Experiment) -> Iterator[Advice]:
    for bad in bad_stamps(experiment.t, experiment.dt):
        seen = f"time stamps: {bad.fault} between {bad.before:g} s and {bad.after:g} s"
        yield Advice("stamps", experiment.name, "t", f"{seen}; cut the record there (segments)", "warning")


def _jitter(experiment: Experiment) -> Iterator[Advice]:
    steps = np.diff(experiment.t)
    worst = float(np.abs(steps - experiment.dt).max() / experiment.dt) if len(steps) else 0.0
    if worst > JITTER and not any(bad_stamps(experiment.t, experiment.dt)):
        sentence = f"steps of time differ by up to {100 * worst:.0f} % from {experiment.dt:g} s; resample to uniform stamps"
        yield Advice("jitter", experiment.name, "t", sentence, "warning" if worst > 0.1 else "note")


def _constant(experiment: Experiment) -> Iterator[Advice]:
    for channel, x in _of(experiment, "input", "output", "schedule", "reference", "other"):
        if len(x) and np.ptp(x) == 0:
            severity = "warning" if channel.has_role("input", "output", "schedule") else "note"
            sentence = f"is constant at {x[0]:g}: nothing can be learned from it; was it connected?"
            yield Advice("constant", experiment.name, channel.name, sentence, severity)


def _clipped(experiment: Experiment) -> Iterator[Advice]:
    for channel, x in _of(experiment, "input", "output", "schedule", "other"):
        if len(np.unique(_thinned(x))) < 20 and len(np.unique(x)) < 20:
            continue  # a few levels: a switched signal, not a clipped one
        for at, sign in (("upper", 1.0), ("lower", -1.0)):
            level = sign * float(np.max(sign * x))
            count = int(np.count_nonzero(x == level))
            following = float(np.max(sign * x, where=x != level, initial=-np.inf))
            next_count = int(np.count_nonzero(sign * x == following))
            longest = _longest_run(x == level)
            elsewhere = _longest_run((np.diff(x) == 0) & (x[1:] != level)) + 1  # a held command rests at every level
            if count > max(0.01 * len(x), 5 * next_count, 5) and longest >= 4 and longest > 1.5 * elsewhere:
                commanded = channel.has_role("input")
                what = "if something else acted on the machine, log that" if commanded else "beyond it the sensor says nothing"
                sentence = f"is clipped: {count} of {len(x)} samples sit exactly at its {at} end {level:g}; {what}"
                yield Advice("clipped", experiment.name, channel.name, sentence, "note" if commanded else "warning")


def _longest_run(mask: np.ndarray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return int((edges[1::2] - edges[::2]).max()) if len(edges) else 0


def _quantum(experiment: Experiment) -> Iterator[Advice]:
    for channel, x in _of(experiment, "output", "schedule", "other"):
        q = quantum(x)
        if q > 1.5 * _noise(x):  # the typical second difference is at most one step
            share = q / float(np.std(x))
            sentence = f"moves in steps of {q:.4g} {channel.unit}".rstrip() + f", {100 * share:.2g} % of its spread"
            mend = "; treat the steps as a bound on the error" if share > 0.05 else ""
            severity = "warning" if share > 0.05 else "note"
            yield Advice("quantum", experiment.name, channel.name, sentence + mend, severity)


def _outliers(experiment: Experiment) -> Iterator[Advice]:
    for channel, x in _of(experiment, "output", "schedule"):
        if len(x) < 10:
            continue
        spike = x[1:-1] - (x[2:] + x[:-2]) / 2
        usual = max(_noise(x), quantum(x), 1e-3 * float(np.std(x)))
        alone = np.abs(x[2:] - x[:-2]) < 0.3 * np.abs(spike)
        at = np.flatnonzero((np.abs(spike) > 20 * usual) & alone) + 1
        if len(at):
            sentence = f"{len(at)} single samples stand out, the first at t = {experiment.t[at[0]]:g} s; repair or cut there"
            yield Advice("outliers", experiment.name, channel.name, sentence, "warning")


def _magnitude(experiment: Experiment) -> Iterator[Advice]:
    for channel in experiment.channels:
        limit, rather = PLAUSIBLE.get(channel.unit, (math.inf, ""))
        largest = float(np.abs(experiment[channel.name]).max(initial=0.0))
        if largest > limit:
            sentence = f"reaches {largest:.4g} {channel.unit}; is it in {rather}?"
            yield Advice("magnitude", experiment.name, channel.name, sentence, "note")


# ---- the record as a whole -------------------------------------------------------------------------------------------


def _excitation(experiment: Experiment, order: int) -> Iterator[Advice]:
    """The inputs' lag matrix [u(t) .. u(t-2 order)] has to have full rank, and each input has to move often enough."""
    moving = [(c, x) for c, x in _of(experiment, "input") if np.ptp(x) > 0]
    for channel, x in moving:
        moves = np.count_nonzero(np.diff(x))
        if moves < 2 * order:
            sentence = f"moves {moves} times only; order {order} asks for at least {2 * order}: use a richer input"
            yield Advice("excitation", experiment.name, channel.name, sentence, "warning")
    if not moving or len(experiment) < 8 * order * len(moving):
        return
    u = _standard(np.column_stack([x for _, x in moving])[:20_000])
    depth = 2 * order
    lagged = np.hstack([u[k : len(u) - depth + k] for k in range(depth)])
    size = np.linalg.svd(lagged.T @ lagged, compute_uv=False)
    rank = int(np.count_nonzero(size > 1e-8 * size[0]))
    if rank < size.size:
        names = ", ".join(c.name for c, _ in moving)
        sentence = f"excites {rank} of the {size.size} directions that order {order} asks for: use a richer input"
        yield Advice("excitation", experiment.name, names, sentence, "warning")


def _too_short(experiment: Experiment, order: int | None) -> Iterator[Advice]:
    """A VARX of the order asked has order (nu + ny) + 1 unknowns for each output; ten samples for each are few."""
    if order is None:
        return
    channels = len(experiment.names_of("input")) + len(experiment.names_of("output"))
    unknown = order * max(channels, 1) + 1
    if len(experiment) < 10 * unknown:
        sentence = (
            f"{len(experiment)} samples are too short for order {order}: {unknown} unknowns for each output"
            f" ask for {10 * unknown}; take a longer record or a lower order"
        )
        yield Advice("too-short", experiment.name, "", sentence, "warning")


def _schedule_span(dataset: Dataset) -> Iterator[Advice]:
    """The range that a scheduling variable covers over all records: a model says nothing outside it."""
    first = dataset.experiments[0]
    for channel in first.channels:
        if not channel.has_role("schedule"):
            continue
        low = min(float(e[channel.name].min()) for e in dataset)
        high = max(float(e[channel.name].max()) for e in dataset)
        unit = f" {channel.unit}" * bool(channel.unit)
        sentence = f"runs from {low:.4g} to {high:.4g}{unit}"
        narrow = high - low < 0.02 * max(abs(low), abs(high))
        more = "hardly moves: the records show one operating point" if narrow else "a model holds on that range only"
        names = ", ".join(dataset.names)
        severity = "warning" if narrow else "note"
        yield Advice("schedule-span", names, channel.name, f"{sentence}; {more}", severity)


CHECKS: tuple[Callable[[Experiment], Iterator[Advice]], ...] = (
    _stamps,
    _jitter,
    _constant,
    _clipped,
    _quantum,
    _outliers,
    _magnitude,
    _feedback,
)
