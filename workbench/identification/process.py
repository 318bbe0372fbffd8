"""One input and one output as a plant engineer writes them down: gain, time constants and dead time.

    lag            K exp(-L s) / (T s + 1)
    second-order   K exp(-L s) / (T^2 s^2 + 2 zeta T s + 1)          two lags, or a resonance
    ramp           K exp(-L s) / s                                   what integrates: levels, positions
    lagged-ramp    K exp(-L s) / (s (T s + 1))

y = K g(T, zeta, L; u) + what the record began with: an offset, and where it shows the free motion of the process, and of one that
integrates the drift under the input that it began with. K and these are linear; T, zeta and L are searched (variable projection:
G. H. Golub and V. Pereyra, SIAM J. Numer. Anal. 10, 1973). The input is held between samples and the dead time is any number of
them. All is counted in the innovations of what is left (`noise_model`): slow disturbances do not pass for accuracy.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from workbench.basis import CONSTANT
from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.identification.noise_model import NoiseModel, fit_noise
from workbench.lpv import LPVModel, OperatingPoint, constant_model
from workbench.records import field, record

FORMS = ("lag", "second-order", "ramp", "lagged-ramp")
NUMBERS = {"lag": ("T", "L"), "second-order": ("T", "zeta", "L"), "ramp": ("L",), "lagged-ramp": ("T", "L")}
INTEGRATES = ("ramp", "lagged-ramp")
SHORTEST = 30  # samples
LONGEST = 20_000  # samples, beyond which a record is brought to fewer
NOISE = 2  # order of what is left: a process and what wanders, behind the noise of a sensor
ROUNDS = 3  # how often it is found anew
WANDERS = 0.0, 0.95  # poles of what is left that a search begins with
MOVING = 10.0  # BIC that what a record began with must be worth
TIE, NEAR = 10.0, 20.0  # BIC and percent of the free run within which another form may be the true one
TIMES, DELAYS, DAMPINGS = 10, 12, (0.3, 1.0, 2.5)  # of the grid that a search begins on
BEGUN = 2  # of its points for each of these, from which it descends
SLOWEST, LATEST = 10.0, 0.5  # of the record's length: the largest time constant and dead time
FASTEST = 0.2  # samples: the smallest time constant
NEGLIGIBLE = 1e-3  # samples of dead time that are none
WANDERING = 0.03  # standard deviation of log K that one record does not show: what wanders more slowly than it lasts
HELD = 0.29  # samples, standard deviation of when within its sample a command is written down
SHOWN = 30.0  # BIC that a response to the input must be worth, for the record to show one
OPEN = 1.0  # relative standard deviation above which a form has more numbers than the record shows
FURTHEST = 3.0  # factor by which a drawn gain or time is off at most, and times the lag and the dead time of this
KNOWN = 0.3  # relative standard deviation up to which a gain or a time is known


@record
class Process:
    """A process; K [y/u], or [y/u/s] of one that integrates, T [s], zeta, dead time L [s]; u0, y0: an equilibrium.

    covariance: of (log K, the logarithms of T and zeta, L), in the order of `names`. fit [percent]: share of the output's motion
    that a free run explains. moving: the records begin with a motion of its own, or with a drift.
    """

    form: str
    K: float
    L: float = field("", unit="s", low=0.0)
    T: float = field("", unit="s", low=0.0, default=0.0)
    zeta: float = field("", low=0.0, default=1.0)
    u0: float = 0.0
    y0: float = 0.0
    dt: float = field("", unit="s", low=1e-12, default=1.0)
    covariance: np.ndarray = field("p p", default_factory=lambda: np.zeros((0, 0)))
    fit: float = 0.0
    bic: float = 0.0
    moving: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        return ("K", *NUMBERS[self.form])

    @property
    def integrates(self) -> bool:
        return self.form in INTEGRATES

    @property
    def slowest(self) -> float:
        """What a step takes to be over but for a few percent, or where it integrates to go on at a steady rate [s]."""
        lag = self.T * (max(self.zeta, 0.5 / max(self.zeta, 0.05)) * 2.0 if self.form == "second-order" else 1.0)
        return self.L + 4.0 * lag

    @property
    def deviation(self) -> dict[str, float]:
        """Standard deviations of K, T and zeta relative to them, and of L [s]."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=False))

    def drawn(self, random: np.random.Generator, count: int) -> list["Process"]:
        """Processes that may be the true one: normal draws around this one, off by no more than a factor of `FURTHEST`."""
        at = np.array(
            [np.log(abs(self.K)), *(getattr(self, n) if n == "L" else np.log(getattr(self, n)) for n in self.names[1:])]
        )
        found = []
        off = np.array([FURTHEST * (self.L + self.T + self.dt) if n == "L" else np.log(FURTHEST) for n in self.names])
        for values in np.clip(random.multivariate_normal(at, self.covariance, count, check_valid="ignore"), at - off, at + off):
            own = {n: max(v, 0.0) if n == "L" else float(np.exp(v)) for n, v in zip(self.names, values, strict=True)}
            found.append(replace(self, **{**own, "K": float(np.sign(self.K)) * own["K"]}))
        return found

    def model(self, dt: float, u: Channel, y: Channel, name: str = "process") -> LPVModel:
        """The same, sampled, with its dead time in states that hold former inputs; y = C x + y0."""
        a, b, late = sampled(self.form, dt, self.T, self.zeta, self.L)
        n, count = len(a) - 1, late + len(b)
        A, B, C = np.zeros((n + count, n + count)), np.zeros((n + count, 1)), np.zeros((1, n + count))
        A[0, :n], C[0, 0] = -a[1:], 1.0  # y, then former y, then former inputs
        A[np.arange(1, n), np.arange(n - 1)] = 1.0
        for j, value in enumerate(self.K * b, late):  # y(k + 1) sees u(k - j)
            if j:
                A[0, n + j - 1] += value
            else:
                B[0, 0] += value
        B[n, 0] = 1.0
        A[np.arange(n + 1, n + count), np.arange(n, n + count - 1)] = 1.0
        kept = n + count - 1
        at = OperatingPoint(CONSTANT, np.array([[self.u0]]), np.array([[self.y0]]))
        matrices = A[:kept, :kept], B[:kept], C[:, :kept], np.zeros((1, 1))
        return constant_model(name, dt, ((u,), (y,)), matrices, at)


def fit_processes(dataset: Dataset, forms: Sequence[str] = FORMS) -> list[Process]:
    """Processes of one input and one output, of each of `forms`, begun at rest and not, the likeliest by BIC first.

    Raises InputError for records of several inputs or outputs, too short ones, and those that do not show the process: an input
    that does not move, an output that does not follow, a gain or times that remain open; each with the experiment that would.
    """
    data = list(_records(dataset))
    found = sorted((one for form in forms for one in _fitted(form, data)), key=lambda one: one.bic)
    longest = SLOWEST * max(d.dt * len(d.y) for d in data)  # what is slower integrates, as far as it shows
    found = [one for one in found if one.integrates or one.slowest < longest] or found
    _check_shown(found, data)
    return found


class _Data(NamedTuple):
    """A record: u (N) less its first value, which is `begun`, y (N), dt, and its name."""

    u: np.ndarray
    y: np.ndarray
    dt: float
    name: str
    begun: float

    @classmethod
    def of(cls, e: Experiment) -> "_Data":
        u, y = e[e.names_of("input")[0]], e[e.names_of("output")[0]]
        return cls(u - u[0], y, e.dt, e.name, float(u[0]))


def _records(dataset: Dataset) -> Iterator[_Data]:
    first = dataset.experiments[0]
    inputs, outputs = first.names_of("input"), first.names_of("output")
    if len(inputs) != 1 or len(outputs) != 1:
        told = f"{len(inputs)} inputs and {len(outputs)} outputs"
        raise InputError(told, file=dataset.names[0], mend="name one of each: --inputs U --output y")
    for e in dataset:
        if len(e) < SHORTEST:
            raise InputError(f"{len(e)} samples", file=e.name, mend=f"at least {SHORTEST}")
        own = _Data.of(e.resample(e.dt * np.ceil(len(e) / LONGEST)) if len(e) > LONGEST else e)
        if not np.ptp(own.u) > 0.0:
            mend = "a record of a step, of a relay or of a loop in which it moves"
            raise InputError("does not move", file=e.name, channel=inputs[0], mend=mend)
        yield own


# ---- the response to an input that is held -----------------------------------------------------------------------------


def sampled(form: str, dt: float, T: float, zeta: float, L: float) -> tuple[np.ndarray, np.ndarray, int]:
    """a, b and samples `late`: y(k) + a1 y(k-1) + .. = b0 u(k-1-late) + b1 u(k-2-late) + .., for a gain of 1."""
    from scipy.linalg import expm

    if form == "lag":
        A, B, C = np.array([[-1.0 / T]]), np.array([1.0 / T]), np.array([1.0])
    elif form == "ramp":
        A, B, C = np.zeros((1, 1)), np.ones(1), np.ones(1)
    elif form == "second-order":
        A, B, C = np.array([[0.0, 1.0], [-1.0 / T**2, -2.0 * zeta / T]]), np.array([0.0, 1.0 / T**2]), np.array([1.0, 0.0])
    else:
        A, B, C = np.array([[0.0, 1.0], [0.0, -1.0 / T]]), np.array([0.0, 1.0 / T]), np.array([1.0, 0.0])
    late = int(L / dt)
    part, n = L - late * dt, len(A)

    def over(time: float) -> tuple[np.ndarray, np.ndarray]:
        whole = expm(np.block([[A, B[:, None]], [np.zeros((1, n + 1))]]) * time)
        return whole[:n, :n], whole[:n, n]

    (first, new), (_, old), (step, _) = over(dt - part), over(part), over(dt)
    gains = new, first @ old  # of u(k - late) and of u(k - late - 1)
    if n == 1:
        a, b = np.array([1.0, -step[0, 0]]), np.array([C @ gains[0], C @ gains[1]])
    else:
        a = np.array([1.0, -np.trace(step), np.linalg.det(step)])
        (b0, b1), (c0, c1) = ((C @ g, C @ (step @ g - np.trace(step) * g)) for g in gains)
        b = np.array([b0, b1 + c0, c1])
    return a, b, late


def _columns(form: str, d: _Data, values: Sequence[float], moving: bool) -> np.ndarray:
    """(N, m): the response to the input for a gain of 1, then what the record began with: at rest, or `moving`."""
    from scipy.signal import lfilter

    own = dict(zip(NUMBERS[form], values, strict=True))
    T, zeta = own.get("T", 1.0), own.get("zeta", 1.0)
    a, b, late = sampled(form, d.dt, T, zeta, own["L"])
    N = len(d.y)
    delayed = np.concatenate([np.zeros(min(1 + late, N)), d.u[: max(N - 1 - late, 0)]])
    response = np.asarray(lfilter(b, a, delayed))
    free: list[np.ndarray] = [np.ones(N)]
    if not moving:
        return np.column_stack([response, *free])
    if form in INTEGRATES:
        free.append(d.dt * np.arange(N))
    for start in np.eye(len(a) - 1)[: len(a) - 1 - (form in INTEGRATES)]:  # the free motion that is not among these
        free.append(np.asarray(lfilter([1.0], a, np.zeros(N), zi=_state(a, start))[0]))
    return np.column_stack([response, *free])


def _state(a: np.ndarray, start: np.ndarray) -> np.ndarray:
    """State of `lfilter` in which y begins with start[0] and, of two, the next one with start[1]."""
    if len(a) == 2:
        return np.array([start[0]])
    return np.array([start[0], start[1] + a[1] * start[0]])


# ---- the fit -------------------------------------------------------------------------------------------------------------


class _Search:
    """One form of process on the records, which begin at rest or `moving`; searched are the logarithms of T and zeta, and L."""

    def __init__(self, form: str, data: Sequence[_Data], moving: bool = False):
        self.form, self.data, self.moving = form, data, moving
        self.dt, self.length = data[0].dt, max(d.dt * len(d.y) for d in data)
        self.names = NUMBERS[form]
        ends = {
            "T": (np.log(FASTEST * self.dt), np.log(SLOWEST * self.length)), "zeta": (np.log(0.02), np.log(20.0)),
            "L": (0.0, LATEST * self.length),
        }  # fmt: skip
        self.low, self.high = (np.array(end) for end in zip(*(ends[name] for name in self.names), strict=True))
        self.steps = np.array([0.05 * self.dt if name == "L" else 1e-4 for name in self.names])

    def values(self, z: np.ndarray) -> list[float]:
        return [float(v if name == "L" else np.exp(v)) for name, v in zip(self.names, z, strict=True)]

    def regression(self, z: np.ndarray, noise: NoiseModel) -> tuple[np.ndarray, np.ndarray]:
        """Columns and output in innovations of `noise`: of one gain, and of every record what it began with."""
        from scipy.linalg import block_diag

        skip = len(noise.A) - 1
        columns = [_columns(self.form, d, self.values(z), self.moving) for d in self.data]
        whitened = [noise.innovations(c)[skip:] for c in columns]
        X = np.column_stack([np.concatenate([c[:, 0] for c in whitened]), np.asarray(block_diag(*(c[:, 1:] for c in whitened)))])
        return X, np.concatenate([noise.innovations(d.y)[skip:] for d in self.data])

    def solved(self, z: np.ndarray, noise: NoiseModel) -> tuple[np.ndarray, np.ndarray]:
        """What the best linear numbers leave, and these."""
        X, y = self.regression(z, noise)
        numbers = np.linalg.lstsq(X, y, rcond=None)[0]
        return y - X @ numbers, numbers

    def begun(self) -> list[tuple[np.ndarray, NoiseModel]]:
        """The best points of a grid, to descend from: where all is noise of the sensor, and where disturbances wander.

        With that noise: what a coarse point leaves of a relay's cycle would pass for noise that swings, and hold it there.
        """
        axes = {
            "T": np.log(np.geomspace(0.5 * self.dt, self.length, TIMES)),
            "zeta": np.log(DAMPINGS),
            "L": np.append(0.0, np.geomspace(0.5 * self.dt, 0.9 * LATEST * self.length, DELAYS)),
        }
        grid = np.stack(np.meshgrid(*(axes[name] for name in self.names), indexing="ij"), axis=-1).reshape(-1, len(self.low))
        grid = np.clip(grid, self.low, self.high)
        found: list[tuple[np.ndarray, NoiseModel]] = []
        for pole in WANDERS:
            noise = NoiseModel(np.array([1.0, -pole]), np.ones(1))
            costs = [float(np.sum(self.solved(z, noise)[0] ** 2)) for z in grid]
            found += [(grid[k], noise) for k in np.argsort(costs)[:BEGUN]]
        return found

    def descended(self, z: np.ndarray, noise: NoiseModel) -> tuple[float, np.ndarray, NoiseModel]:
        """BIC, what is searched, and the noise, from a point and a noise on."""
        from scipy.optimize import least_squares

        for _ in range(ROUNDS):
            scale = float(np.std(self.solved(z, noise)[0])) or 1.0

            def error(z: np.ndarray, noise: NoiseModel = noise, scale: float = scale) -> np.ndarray:
                return self.solved(z, noise)[0] / scale

            found = least_squares(
                error, np.clip(z, self.low, self.high), bounds=(self.low, self.high), x_scale="jac", max_nfev=40,
                jac=lambda z, f=error: self.slopes(f, z),  # type: ignore[arg-type]
            )  # fmt: skip
            z, noise = found.x, self.noise(found.x, noise)
        left, numbers = self.solved(z, noise)
        variance = float(left @ left) / max(len(left) - len(numbers) - len(z), 1)
        count = len(z) + len(numbers) + noise.numbers
        bic = len(left) * np.log(max(variance, 1e-300)) + count * np.log(len(left)) + MOVING * self.moving
        return (float(bic), z, noise) if np.isfinite(bic) else (np.inf, z, noise)

    def slopes(self, of: Callable[[np.ndarray], np.ndarray], z: np.ndarray) -> np.ndarray:
        """Differences, over steps that a fraction of a sample of dead time needs, from within the bounds."""
        columns = []
        for i, h in enumerate(self.steps):
            after, before = z.copy(), z.copy()
            after[i], before[i] = min(z[i] + h, self.high[i]), max(z[i] - h, self.low[i])
            columns.append((of(after) - of(before)) / (after[i] - before[i]))
        return np.column_stack(columns)

    def noise(self, z: np.ndarray, before: NoiseModel) -> NoiseModel:
        """Of what the process leaves of the output, with its linear numbers as a former noise gives them.

        Least squares of the output itself would give what wanders to the gain and to the drift.
        """
        numbers = self.solved(z, before)[1]
        left = []
        for d, own in zip(self.data, np.split(numbers[1:], len(self.data)), strict=True):
            left.append(d.y - _columns(self.form, d, self.values(z), self.moving) @ np.append(numbers[0], own))
        return fit_noise(left, NOISE)

    def process(self, bic: float, z: np.ndarray, noise: NoiseModel) -> Process:
        """The process with its covariance and the share of the output that a free run explains."""
        X, _ = self.regression(z, noise)
        left, numbers = self.solved(z, noise)
        K, variance = float(numbers[0]), float(left @ left) / max(len(left) - len(numbers) - len(z), 1)
        moved = self.slopes(lambda z: self.regression(z, noise)[0] @ numbers, z)
        J = np.column_stack([X[:, 0] * K, moved, X[:, 1:]])  # of log K, T, zeta and L, and of the rest
        size = np.linalg.norm(J, axis=0)
        size[size == 0.0] = 1.0
        covariance = variance * np.linalg.pinv((J / size).T @ (J / size)) / np.outer(size, size)
        covariance = covariance[: 1 + len(z), : 1 + len(z)]
        covariance[0, 0] += WANDERING**2
        covariance[-1, -1] += (HELD * self.dt) ** 2  # the last one is L
        rests = []
        for d, free in zip(self.data, np.split(numbers[1:], len(self.data)), strict=True):
            drift = free[1] / K if self.moving and self.form in INTEGRATES else 0.0
            rests.append((d.begun - drift, d.y[0] if self.form in INTEGRATES else free[0]))
        u0, y0 = np.mean(rests, axis=0)
        own = dict(zip(self.names, self.values(z), strict=True))
        own["L"] = own["L"] if own["L"] > NEGLIGIBLE * self.dt else 0.0
        found = Process(
            self.form, K, own["L"], own.get("T", 0.0), own.get("zeta", 1.0), float(u0), float(y0), self.dt, covariance, bic=bic,
            moving=self.moving,
        )  # fmt: skip
        away = sum(float(np.sum((d.y - _run(found, d)) ** 2)) for d in self.data)
        moves = sum(float(np.sum((d.y - d.y.mean()) ** 2)) for d in self.data)
        return replace(found, fit=100.0 * (1.0 - math.sqrt(away / moves)) if moves > 0.0 else 0.0)


def _run(process: Process, d: _Data) -> np.ndarray:
    columns = _columns(process.form, d, [getattr(process, name) for name in NUMBERS[process.form]], moving=True)
    driven = process.K * columns[:, 0]
    return driven + columns[:, 1:] @ np.linalg.lstsq(columns[:, 1:], d.y - driven, rcond=None)[0]


def _fitted(form: str, data: Sequence[_Data]) -> list[Process]:
    """The likeliest process of a form that is at rest where the records begin, and the likeliest that is not."""
    still, moving = _Search(form, data), _Search(form, data, moving=True)
    rest = min((still.descended(*begun) for begun in still.begun()), key=lambda own: own[0])
    free = min((moving.descended(*begun) for begun in (rest[1:], *moving.begun())), key=lambda own: own[0])
    return [search.process(*best) for search, best in ((still, rest), (moving, free)) if np.isfinite(best[0])]


# ---- what a record shows -----------------------------------------------------------------------------------------------


def rivals(best: Process, others: Sequence[Process]) -> list[Process]:
    """Those of the other forms that may be the true one.

    A form whose numbers stay open is another one with too many of them. One of the other sign, with a drift where the best one
    begins at rest, takes the answer to the input for the end of that drift.
    """
    close = [p for p in others if p.bic < best.bic + TIE and p.fit > best.fit - NEAR]
    shown = [p for p in close if p.deviation["L"] < OPEN * p.slowest and all(p.deviation[n] < OPEN for n in p.names if n != "L")]
    return [p for p in shown if p.K * best.K > 0.0 or best.moving or not p.moving]


def _check_shown(found: Sequence[Process], data: Sequence[_Data]) -> None:
    name = data[0].name
    still = _without_input(data)
    if not found or still - found[0].bic < SHOWN:
        mend = "a larger step, or a longer record: the output must leave its noise and its drift behind it"
        raise InputError("the output does not follow the input", file=name, mend=mend)
    if any(p.K * found[0].K < 0.0 for p in rivals(found[0], found[1:])):
        mend = "a record that begins at rest, or a step back after the first one"
        raise InputError("the record does not tell whether the output rises or falls with the input", file=name, mend=mend)
    best, length = found[0], max(d.dt * len(d.y) for d in data)
    open_ = [n for n in best.names if n not in ("L", "zeta") and best.deviation[n] > KNOWN]
    if open_ or best.deviation["L"] > KNOWN * (best.L + best.T + best.dt):
        which = " and ".join({"K": "the gain", "T": "the time constant"}[n] for n in open_) or "the dead time"
        mend = f"a larger step, or a longer record than {length:.3g} s: some {2.0 * best.slowest:.2g} s after a step"
        raise InputError(f"{which} stays open: the record shows too little", file=name, mend=mend)


def _without_input(data: Sequence[_Data]) -> float:
    """BIC of an output that follows nothing: an offset and noise of the same kind for each record."""
    series = [d.y - d.y.mean() for d in data]
    noise = fit_noise(series, NOISE)
    left = np.concatenate([noise.innovations(v)[NOISE:] for v in series])
    variance = float(left @ left) / len(left)
    return len(left) * float(np.log(max(variance, 1e-300))) + (noise.numbers + len(data)) * float(np.log(len(left)))


def free_run(process: Process, e: Experiment) -> np.ndarray:
    """The output (N) along a record, begun as suits it best."""
    return _run(process, _Data.of(e))
