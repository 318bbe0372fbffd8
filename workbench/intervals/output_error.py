"""Simulation-accurate boxes: the free run of the model holds the measured output, sample by sample.

    centre   min sum_k (y(k) - y_nom(k))^2,  y_nom the free run from measured inputs                      (output error)
    radius   min mean_k B_k'radius + band   subject to   B_k'radius + band >= |y(k) - y_nom(k)| + e_y,   radius, band >= 0
             B_ki = sum_j |h(k - j)| |z_nom,i(j)|,  h the response of y to an equation error                (first order)
             sum_i radius_i ||g_i||_1 <= g,         g_i the response of z_i to an equation error            (loop gain)

The band is what no parameter explains cheaper: a bounded term of the output that is not fed back. With radii of 0 it is the
plain model plus bound on its error, so the box is never wider than that. B_k'radius is the first-order half-width of the free
run; the true one is up to 1/(1 - g) times as wide. The program is solved for several g, from 0 (no uncertainty in the
feedback) on, and the answer with the narrowest kernel bound is taken; its radii and band grow by a common factor until the free
run itself holds every sample.

Such a box says what the outputs of a record can be. It does not say that the record is a trajectory of the model: its
one-step envelope is narrower than the equation error. It is a hundred times narrower in simulation where sampling is fast.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from workbench.data import Dataset
from workbench.errors import InputError
from workbench.intervals.domains.shapes import Hull
from workbench.intervals.model import IntervalModel, Mode, Simulation, domain_coordinates
from workbench.intervals.propagation import kernel
from workbench.intervals.regression import error_bounds, named_output, spans_of
from workbench.intervals.regressors import ARX, Samples, Structure, samples
from workbench.intervals.semantics import ParameterBox
from workbench.lp import RowProgram
from workbench.records import field, record

GAINS = (0.0, 0.1, 0.3, 0.6)  # of the loop, that are tried
GROWTH = 20  # enlargements at most
ITERATIONS = 50  # of the output-error fit


@record
class OutputErrorRegression:
    """low(k) <= y(k) <= high(k) in free run: the smallest box, and band, whose simulation holds every sample of every record.

    It promises nothing about one step. Raises InputError where no stable model describes the records.
    output_error: bound on |measured - true| of y; None: three standard deviations of its noise.

        >>> boxes = OutputErrorRegression(ARX(order=1)).fit(data)
        >>> cover(boxes, data, "estimation")[-1].coverage
        1.0
    """

    structure: Structure = field(default_factory=ARX)
    output_error: float | None = None
    name: str = "interval-simulation"

    def fit(self, dataset: Dataset, output: str | None = None) -> IntervalModel:
        """A model of one box whose free run holds every record.

        Raises InputError as `IntervalRegression.fit`, for records with gaps, and where no stable nominal model is found.
        """
        first = dataset.experiments[0]
        y, u = named_output(dataset, output), first.names_of("input")
        e_y, e_u, notes = error_bounds(dataset, y, u, self.output_error, 0.0)
        S = samples(self.structure, dataset, y, u, output_error=e_y, input_error=e_u)
        runs = [S.rows(S.piece == p) for p in np.unique(S.piece)]
        centre = _nominal(S, runs)
        program = _Program(runs, centre)
        candidates = [program.radii(gain) for gain in GAINS]
        at_once = _model(self, dataset, (y, u), S, tuple(notes))
        return _grown(min((at_once(centre, radii) for radii in candidates), key=lambda m: _kernel_radius(m, dataset)), dataset)


# ---- centre -----------------------------------------------------------------------------------------------------------


def _nominal(S: Samples, runs: list[Samples]) -> np.ndarray:
    """Output-error least squares: Gauss-Newton with step halving, from the best of the prefiltered equation-error fits."""
    scale = np.abs(S.z).max(axis=0)
    scale[scale == 0] = 1.0
    theta = np.linalg.lstsq(S.z / scale, S.y - S.psi @ S.form.d, rcond=None)[0] / scale
    theta = min(_prefiltered(S, runs, theta, scale), key=lambda candidate: _cost(runs, candidate))
    cost = _cost(runs, theta)
    if not np.isfinite(cost):
        raise InputError("no stable model describes these records in simulation", mend="another order, or equation-error boxes")
    for _ in range(ITERATIONS):
        parts = [_simulated(R, theta) for R in runs]
        error = np.concatenate([R.y - y for R, (y, _) in zip(runs, parts, strict=True)])
        J = np.concatenate([_filtered(R, theta, z) for R, (_, z) in zip(runs, parts, strict=True)])
        step = np.linalg.lstsq(J / scale, error, rcond=1e-10)[0] / scale
        length = 1.0
        while length > 1e-6 and not (trial := _cost(runs, theta + length * step)) < cost:
            length /= 2
        if length <= 1e-6:
            break
        done = cost - trial < 1e-12 * cost
        theta, cost = theta + length * step, trial
        if done:
            break
    return theta


def _prefiltered(S: Samples, runs: list[Samples], theta: np.ndarray, scale: np.ndarray) -> list[np.ndarray]:
    """The first guess and five iterations of least squares on signals filtered by the last denominator (Steiglitz-McBride)."""
    found = [theta]
    for _ in range(5):
        if _radius_of_poles(S, theta) >= 1.0:
            break
        z = np.concatenate([_filtered(R, theta, R.z) for R in runs])
        target = np.concatenate([_filtered(R, theta, (R.y - R.psi @ R.form.d)[:, None])[:, 0] for R in runs])
        theta = np.linalg.lstsq(z / scale, target, rcond=None)[0] / scale
        found.append(theta)
    return found


def _denominator(S: Samples, theta: np.ndarray) -> np.ndarray:
    """1, a_1 .. a_n of the recursion y(k) + a_1 y(k-1) + .. = ..."""
    row = S.form.d + S.form.T.T @ theta
    return np.concatenate([[1.0], -row[S.form.source == 0]])


def _radius_of_poles(S: Samples, theta: np.ndarray) -> float:
    return float(np.abs(np.roots(_denominator(S, theta))).max(initial=0.0))


def _filtered(R: Samples, theta: np.ndarray, x: np.ndarray) -> np.ndarray:
    """x (K p) through the response to an equation error, from rest."""
    from scipy.signal import lfilter

    return np.asarray(lfilter([1.0], _denominator(R, theta), x, axis=0))


def _simulated(R: Samples, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Free run y (K) of one stretch and its regressors z (K p), from the first regressor and the measured inputs."""
    from scipy.signal import lfilter, lfiltic

    past = R.form.source == 0
    a = _denominator(R, theta)
    v = R.psi[:, ~past] @ (R.form.d + R.form.T.T @ theta)[~past]
    if not past.any():
        return v, R.z
    before = R.psi[0, past]
    y = np.asarray(lfilter([1.0], a, v, zi=lfiltic([1.0], a, before))[0])
    whole = np.concatenate([before[::-1], y])
    psi = R.psi.copy()
    lags = R.form.lags[past].astype(int)
    psi[:, past] = whole[len(before) + np.arange(len(y))[:, None] - lags[None]]
    return y, psi @ R.form.T.T


def _cost(runs: list[Samples], theta: np.ndarray) -> float:
    if _radius_of_poles(runs[0], theta) >= 1.0:
        return np.inf
    return float(sum(np.sum((R.y - _simulated(R, theta)[0]) ** 2) for R in runs))


# ---- radius -----------------------------------------------------------------------------------------------------------


class _Program:
    """The linear program of the module, on the rows that matter."""

    def __init__(self, runs: list[Samples], centre: np.ndarray):
        from scipy.signal import fftconvolve

        sides, needed = [], []
        self.loop = np.zeros(len(centre))
        for R in runs:
            y, z = _simulated(R, centre)
            h = _impulse(R, centre, len(R))
            sides.append(np.maximum(fftconvolve(np.abs(z), np.abs(h)[:, None], axes=0)[: len(R)], 0.0))
            needed.append(np.abs(R.y - y) + R.output_error)
            self.loop = np.maximum(self.loop, _loop_gains(R, h))
        self.B, self.bound = np.concatenate(sides), np.concatenate(needed)

    def radii(self, gain: float) -> np.ndarray:
        """Radii (p) and the band, of least mean width with a loop gain of at most `gain`; (p + 1)."""
        B = np.column_stack([self.B, np.ones(len(self.B))])
        scale, unit = B.max(axis=0), float(self.bound.max())
        if unit == 0.0:
            return np.zeros(len(scale))
        scale[scale == 0] = 1.0
        B, bound = B / scale, self.bound / unit
        program = RowProgram(B.mean(axis=0), 0.0, np.inf)
        program.add(np.append(self.loop, 0.0)[None] / scale * unit, -np.inf, gain)
        new = np.argsort(-bound)[: 8 * B.shape[1]]
        x = np.zeros(len(scale))
        while len(new):
            program.add(B[new], bound[new])
            x, _ = program.solve()
            short = bound - B @ x
            new = np.argsort(-short)[: 4 * B.shape[1]]
            new = new[short[new] > 1e-9]
        return np.maximum(x, 0.0) * unit / scale


def _impulse(R: Samples, centre: np.ndarray, length: int) -> np.ndarray:
    """h (length): the output after an equation error of 1 at sample 0."""
    one = np.zeros((length, 1))
    one[0] = 1.0
    return _filtered(R, centre, one)[:, 0]


def _loop_gains(R: Samples, h: np.ndarray) -> np.ndarray:
    """||g_i||_1 (p): what an equation error of 1 adds to z_i in all later samples."""
    past = R.form.source == 0
    psi = np.zeros((len(h) + int(R.form.lags.max()), int(past.sum())))
    for column, lag in enumerate(R.form.lags[past].astype(int)):
        psi[lag : lag + len(h), column] = h
    return np.abs(psi @ R.form.T[:, past].T).sum(axis=0)


def _model(
    method: OutputErrorRegression, dataset: Dataset, channels: tuple[str, tuple[str, ...]], S: Samples, notes: tuple[str, ...]
) -> Callable[[np.ndarray, np.ndarray], IntervalModel]:
    """centre (p), radii and band (p + 1) -> the model with that box."""
    first, (y, u) = dataset.experiments[0], channels
    domain, spans = Hull(domain_coordinates(S)), spans_of(S)

    def of(centre: np.ndarray, radii: np.ndarray) -> IntervalModel:
        mode = Mode(ParameterBox(centre, radii[:-1]), domain, spans, len(S), 0.0, 1.0, band=float(radii[-1]))
        return IntervalModel(
            name=method.name, dt=dataset.dt, inputs=tuple(first.channel(name) for name in u), output=first.channel(y),
            schedule=None, structure=method.structure, semantics=Simulation(), output_error=S.output_error,
            input_error=np.zeros(len(u)), unit_range=float(np.ptp(S.y)) or 1.0, modes=(mode,), trained_on=dataset.fingerprints,
            notes=notes,
        )  # fmt: skip

    return of


def _kernel_radius(model: IntervalModel, dataset: Dataset) -> float:
    """Mean radius of the kernel bound over all records: quick, and at most 1/(1 - g) too wide."""
    widths = [kernel(model.recursion(model.samples_of(e), e)[0]).width for e in dataset]
    return model.modes[0].band + float(np.concatenate(widths).mean()) / 2


def _grown(model: IntervalModel, dataset: Dataset) -> IntervalModel:
    """The model, its radii and band enlarged by a common factor with which its free run holds every sample."""
    mode, factor = model.modes[0], 1.0
    for _ in range(GROWTH):
        box = ParameterBox(mode.box.centre, mode.box.radius * factor)
        grown = replace(model, modes=(replace(mode, box=box, band=mode.band * factor),))
        short, radius = _shortfall(grown, dataset)
        if short <= 1.0:
            precision = math.exp(-radius / model.unit_range)
            final = replace(grown.modes[0], mean_radius=radius, precision=precision, inflation=factor)
            return replace(grown, modes=(final,))
        # the half-width grows at least in proportion: a step or two suffice, and rounding asks for a little more
        factor *= short * (1 + 1e-9)
    raise InputError("the free run does not hold every sample", mend="report this: the check outside the solver failed")


def _shortfall(model: IntervalModel, dataset: Dataset) -> tuple[float, float]:
    """Largest |y - nominal| + e_y over the half-width of the free run on that side, and the mean radius."""
    short, radius, count = 1.0, 0.0, 0
    for e in dataset:
        found = model.free_run(e, instants=(0,))
        run = found.run
        room = np.where(found.y >= run.nominal, run.high - run.nominal, run.nominal - run.low)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = (np.abs(found.y - run.nominal) + found.output_error) / room
        short = max(short, float(np.nanmax(ratio)))
        radius, count = radius + float(np.sum(run.high - run.low)) / 2, count + len(found.y)
    return short, radius / count
