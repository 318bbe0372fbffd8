"""Refinement of a model by the error of its free runs.

    minimise over theta, x0   sum_k |W (y(k) - ys(k; theta, x0))|^2,    ys the free run of the whole record

Gauss-Newton with the exact sensitivities of `passes`, a start x0 free for each record, damped where the records say little. A
model that runs away, or nearly, is led there: first its one-step predictor is fitted, then a run that is corrected less and less.
No step is taken to a model that is unstable anywhere in its span: records that do not go there would not tell.

L. Ljung, "System Identification: Theory for the User", 2nd ed., 1999, sections 10.2 and 10.3.
"""

import warnings
from dataclasses import replace

import numpy as np

from workbench.data import Dataset, Experiment
from workbench.hammerstein import Model
from workbench.identification.output_error.fence import Fence
from workbench.identification.output_error.free_numbers import FreeNumbers, constant_gain, constant_weights
from workbench.identification.output_error.passes import along
from workbench.identification.output_error.spread import estimates
from workbench.lpv import LPVModel
from workbench.quasi_lpv import coupling_notes
from workbench.quasi_lpv import slopes as slopes_of
from workbench.records import field, record

SHARES = (1.0, 0.3, 0.05)  # of the predictor's gain, before the free run
STEPS = 40
ENOUGH = 1e-7  # share of the cost: a step that gains less is the last
DAMPED = (1e-9, 1e-6, 1e-4, 1e-2, 1.0, 100.0)  # of the diagonal of the information
UNKNOWN = (1e-8, 1e-6, 1e-4, 1e-2, 1.0, 100.0)  # shares of the states' variance that a predictor may follow
BLOCKS = 20  # of a record, whose errors count as independent of each other
GRID = 41  # schedule values at which a model must be stable
BEGUN = 5  # steps to a start
NODES = 513  # schedule values between which the functions of a schedule that is an output are read
FORGOTTEN = 0.01  # share of a start that is left after the predictor's warm-up
LONGEST = 10  # of a record: the longest warm-up is one by this number
MOST = 1e9  # multiplications of one pass along the records, some seconds


@record
class Piece:
    """One record as the model reads it: u (N, nu) and y (N, ny) as measured, weights w (N, nt), phi (N, m).

    y is NaN where it does not count.
    """

    y: np.ndarray
    u: np.ndarray = field("N nu")
    w: np.ndarray = field("N nt")
    phi: np.ndarray = field("N m")


class Runs:
    """The records of a data set as a model reads them; its schedule stays.

    inside: whether what was measured where a schedule from outside leaves the model's spans is left out.
    """

    def __init__(self, model: LPVModel, dataset: Dataset, *, inside: bool = False):
        inputs, outputs = ([c.name for c in own] for own in (model.inputs, model.outputs))
        self.pieces, self.own = [], _own_schedule(model)
        for e in dataset:
            *_, w, _ = model.deviations(e)
            phi = model.operating_point.basis(model.schedule_of(e))
            y = e[outputs]
            if inside and model.scheduled_output is None:
                y = np.where(_within(model, e)[:, None], y, np.nan)
            self.pieces.append(Piece(*(np.ascontiguousarray(a) for a in (y, e[inputs], w, phi))))
        spread = np.sqrt(np.mean([np.var(e[outputs], axis=0) for e in dataset], axis=0))
        # what is slower than a record is long is an offset that drifts: it is not known, and its gain is any
        self.slowest = float(np.exp(-1.0 / max(len(piece.y) for piece in self.pieces)))
        self.block = max(min(len(piece.y) for piece in self.pieces) // BLOCKS, 1)
        self.scale = np.where(spread > 0.0, spread, 1.0)

    def begun(self, own: FreeNumbers, share: float) -> np.ndarray:
        """Starts (R, nx) from which the runs of the model err least; 0 where a run is lost.

        What a start does is linear under a schedule from outside; under one that is an output, Gauss-Newton steps that help.
        """
        starts, none = np.zeros((len(self.pieces), own.model.order)), FreeNumbers.nothing(own.model)
        for _ in range(1 if self.own[0] < 0 else BEGUN):
            cost, H, b = self.normal(none, starts, share)
            if not (np.isfinite(cost) and np.isfinite(H).all()):
                break
            moved = starts + np.stack([_solved(h, g.sum(axis=0), DAMPED[0]) for h, g in zip(H, b, strict=True)])
            if self.own[0] >= 0 and not self.cost(own.model, moved, share) < cost:
                break
            starts = moved
        return starts

    def missed(self, model: LPVModel) -> float:
        """Root mean square over records and outputs of the errors of free runs, in deviations of what was measured.

        The start of each record, which is fitted to it, counts as so many values less.
        """
        own = FreeNumbers.nothing(model)
        counted = sum(int(np.isfinite(piece.y).sum()) - model.order for piece in self.pieces)
        return float(np.sqrt(self.cost(model, self.begun(own, 0.0), 0.0) / counted)) if counted > 0 else np.inf

    def cost(self, model: LPVModel, starts: np.ndarray, share: float) -> float:
        """Sum of squares of all runs; inf where one is lost."""
        none = FreeNumbers.nothing(model)
        return sum(float(np.sum(self._run(none, i, x, share, slopes=False)[0] ** 2)) for i, x in enumerate(starts))

    def normal(self, own: FreeNumbers, starts: np.ndarray, share: float) -> tuple[float, np.ndarray, list[np.ndarray]]:
        """Sum of squares, and of every record J'J (R, n, n) and J'e (blocks, n); columns: free numbers, start."""
        found = [self._run(own, i, x, share, slopes=True) for i, x in enumerate(starts)]
        return sum(float(np.sum(e**2)) for e, _, _ in found), np.stack([H for _, H, _ in found]), [b for *_, b in found]

    def _run(self, own: FreeNumbers, i: int, x: np.ndarray, share: float, *, slopes: bool):
        piece, model, n = self.pieces[i], own.model, len(own.places) + own.model.order
        e, H, b = np.zeros_like(piece.y), np.zeros((n, n)), np.zeros((-(-len(piece.y) // self.block), n))
        assert model.predictor is not None
        A, B, C, D, K, u0, y0, w, phi, u, y = (
            np.array(M, order="C")  # records are read-only
            for M in (
                model.A, model.B, model.C, model.D, model.predictor.K, model.operating_point.u, model.operating_point.y,
                piece.w, piece.phi, piece.u, piece.y,
            )
        )  # fmt: skip
        places, block = own.places, self.block
        along(A, B, C, D, K, u0, y0, w, phi, u, y, share, self.scale, x.copy(), places, e, H, b, block, slopes, *self.own)
        return e, H, b


def _within(model: LPVModel, e: Experiment) -> np.ndarray:
    """Whether each sample of a record (N) is within the model's spans."""
    rho = model.measured_schedule(e).reshape(len(e), -1)
    low, high = model.spans.T
    return np.all((rho >= low) & (rho <= high), axis=1) if len(model.schedules) else np.ones(len(e), dtype=bool)


def _own_schedule(model: LPVModel) -> tuple[int, np.ndarray, np.ndarray, float, float]:
    """What `along` needs to know of a schedule that is an output; -1 and nothing of one from outside."""
    terms = np.array([(term.delay, term.function) for term in model.terms], dtype=np.int64)
    if model.scheduled_output is None:
        return -1, terms, np.zeros((2, 1, 2)), 0.0, 1.0
    low, high = model.span.tolist()
    nodes = np.linspace(low, high, NODES)
    table = np.stack([model.basis(nodes), [slopes_of(model.basis, rho) for rho in nodes.tolist()]], axis=2)
    return model.scheduled_output, terms, table, low, high


def minimised(
    own: FreeNumbers, runs: Runs, share: float, enough: float = ENOUGH, most: int = STEPS, fence: Fence | None = None
) -> FreeNumbers:
    """The free numbers at which runs with this share of the predictor's gain err least, by way of where they stand.

    enough: share of the cost that a step must gain for another one to follow. most: steps. No step leads to a model whose poles
    are unstable anywhere in its spans; with a fence these are charged for instead, for the model to come back by itself.
    """
    starts, damping = runs.begun(own, share), 0
    for _ in range(most):
        cost, H, b = runs.normal(own, starts, share)
        if not np.isfinite(cost) or not np.isfinite(H).all():
            break
        if fence is not None:
            P = len(own.places)
            more, inner, outer = fence.normal(own)
            cost += more
            H[0, :P, :P] += inner
            b[0][0, :P] += outer
        better = _better(own, runs, share, starts, (cost, H, b), max(damping - 1, 0), fence)
        if better is None:
            break
        own, starts, now, damping = better
        if now > (1.0 - enough) * cost:
            break
    return own


def _better(
    own: FreeNumbers, runs: Runs, share: float, starts: np.ndarray, at, first: int, fence: Fence | None
) -> tuple[FreeNumbers, np.ndarray, float, int] | None:
    """After the least damped of the steps, from the `first` damping on, that lower the cost and may be taken.

    With its starts, its cost and its damping, by number; None where there is no such step.
    """
    cost, H, b = at
    P = len(own.places)
    for i, damping in enumerate(DAMPED[first:], first):
        theta, x0 = _step(H, b, P, damping)
        moved = own.moved(own.values + theta)
        if not (np.isfinite(theta).all() and np.isfinite(x0).all()):
            continue
        if fence is None and not allowed(moved.model, share, runs.slowest):
            continue
        now = runs.cost(moved.model, starts + x0, share) + (fence.cost(moved.model) if fence is not None else 0.0)
        if now < cost:
            return moved, starts + x0, now, i
    return None


def _step(H: np.ndarray, blocks: list[np.ndarray], P: int, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """The step of the free numbers (P) and of the starts (R, nx): each record has its own start, which is eliminated."""
    b = [own.sum(axis=0) for own in blocks]
    starts = [h[P:, P:] + 1e-9 * np.diag(np.diag(h[P:, P:])) + 1e-300 * np.eye(len(h) - P) for h in H]
    inner = [
        np.linalg.lstsq(s, np.column_stack([h[P:, :P], g[P:]]), rcond=1e-12)[0] for s, h, g in zip(starts, H, b, strict=True)
    ]
    A, r = np.zeros((P, P)), np.zeros(P)
    for h, g, x in zip(H, b, inner, strict=True):
        A += h[:P, :P] - h[:P, P:] @ x[:, :P]
        r += g[:P] - h[:P, P:] @ x[:, P]
    theta = _solved(A, r, damping) if P else np.zeros(0)
    return theta, np.stack([x[:, P] - x[:, :P] @ theta for x in inner])


def _solved(A: np.ndarray, b: np.ndarray, damping: float) -> np.ndarray:
    """The damped solution of A z = b, 0 for what does nothing: scaled by its own size, rounding would be a step without end."""
    acts = np.diag(A) > 0.0
    z, d = np.zeros(len(b)), np.sqrt(np.diag(A)[acts])
    if acts.any():
        value, vector = np.linalg.eigh(A[np.ix_(acts, acts)] / np.outer(d, d))
        z[acts] = vector @ ((vector.T @ (b[acts] / d)) / (np.maximum(value, 0.0) + damping * value.max())) / d
    return z


def allowed(model: LPVModel, share: float, slowest: float = 1.0) -> bool:
    """Whether the poles of a run with this share of the predictor's gain are below `slowest` at every frozen schedule value."""
    return bool(np.abs(np.linalg.eigvals(frozen(model, share))).max(initial=0.0) < slowest)


def stable(model: LPVModel) -> bool:
    """Whether its poles are inside the unit circle at every frozen schedule value."""
    return allowed(model, 0.0)


def frozen(model: LPVModel, share: float) -> np.ndarray:
    """A - share K C (n, nx, nx) at schedule values over the spans that stand still."""
    assert model.predictor is not None
    return np.tensordot(model.still(model.grid(GRID)), (1.0 - share) * model.A + share * model.predictor.F, 1)


def refined(model: LPVModel, dataset: Dataset) -> LPVModel:
    """The model whose free runs along the records err least, with a predictor, noise and uncertainty of its own.

    The model as it is where it is not `refinable`, or where no stable model is found.
    """
    if not refinable(model):
        return model
    runs, own = Runs(model, dataset), FreeNumbers.of(model)
    own = own.moved(own.values)
    for share in (0.0,) if allowed(model, 0.0) else (*SHARES, 0.0):
        own = minimised(own, runs, share)
    better = finished(own, runs, dataset) if stable(own.model) else None
    if better is None or model.scheduled_output is None:
        return better or model
    said = coupling_notes(model)  # what they say is another now
    return replace(better, notes=(*(note for note in better.notes if note not in said), *coupling_notes(better)))


def refinable(model: LPVModel) -> bool:
    """Whether its free runs can be fitted: its basis holds the constant; and where the schedule is an output, as a function of
    its own, so that neither the output equation nor the operating point need move with it, and they do not.
    """
    weights = constant_weights(model)
    if model.scheduled_output is None or not np.isfinite(weights).all():
        return bool(np.isfinite(weights).all())
    moving = weights == 0.0
    moves = model.C[moving].any() or model.D[moving].any() or len(model.operating_point.basis.names) > 1
    return bool(moving.sum() == len(weights) - 1 and not moves)


def finished(own: FreeNumbers, runs: Runs, dataset: Dataset) -> LPVModel | None:
    """The model at a minimum of its free runs, with a predictor, noise and uncertainty; None where a run is lost."""
    cost, H, blocks = runs.normal(own, runs.begun(own, 0.0), 0.0)
    if not (np.isfinite(cost) and np.isfinite(H).all()):
        return None
    predicting = _with_predictor(own.model, runs)
    return replace(predicting, noise=noise_of(predicting, dataset), estimates=estimates(own, H, blocks))


def affordable(model: LPVModel, dataset: Dataset) -> bool:
    """Whether its free runs can be fitted, and in some seconds."""
    return refinable(model) and work(model, dataset) <= MOST


def work(model: LPVModel, dataset: Dataset) -> float:
    """Multiplications of one pass with slopes along the records."""
    n, P = model.order, len(FreeNumbers.of(model).places) + model.order
    return float(sum(map(len, dataset))) * P * (n * n + len(model.outputs) * (n + P))


def noise_of(model: Model, dataset: Dataset) -> np.ndarray:
    """Covariance (ny, ny) of the one-step errors after the warm-up."""
    names = [c.name for c in model.outputs]
    e = np.concatenate([(own[names] - model.predict(own))[model.warmup :] for own in dataset])
    return np.atleast_2d(e.T @ e) / max(len(e), 1)


def _with_predictor(model: LPVModel, runs: Runs) -> LPVModel:
    """The model with the constant gain K that predicts one step best, and a warm-up as long as it needs."""
    tried = []
    gain = FreeNumbers.of_gain(model)
    for K in (constant_gain(model), *_kalman_gains(gain)):
        start = gain.moved(K[gain.places[:, 2], gain.places[:, 3]])
        if allowed(start.model, 1.0):
            tried.append((runs.cost(start.model, runs.begun(start, 1.0), 1.0), start))
    model = minimised(min(tried, key=lambda pair: pair[0])[1], runs, 1.0).model
    assert model.predictor is not None
    return replace(model, predictor=replace(model.predictor, warmup=_warmup(model, runs), free_start=True))


def _kalman_gains(gain: FreeNumbers) -> list[np.ndarray]:
    """K (nx, ny) of Kalman filters in the middle of the span, by shares of what the states do that come from nowhere; and 0."""
    from scipy.linalg import LinAlgWarning, solve_discrete_are, solve_discrete_lyapunov

    model = gain.model
    A, B, C, _ = model.freeze(model.middle)
    found = [np.zeros((len(A), len(C)))]
    with warnings.catch_warnings():  # what is inaccurate is a poor start: all of them are judged by their errors
        for kind in (LinAlgWarning, RuntimeWarning):
            warnings.simplefilter("ignore", kind)
        try:
            P = solve_discrete_lyapunov(A, B @ B.T)
        except np.linalg.LinAlgError:
            return found
        size = np.where(np.isin(np.arange(len(A)), gain.places[:, 2]), np.maximum(np.diag(P), 0.0), 0.0)
        R = np.diag(np.diag(C @ P @ C.T))
        for share in UNKNOWN:
            try:
                S = solve_discrete_are(A.T, C.T, np.diag(share * size), R)
                found.append(np.linalg.solve(C @ S @ C.T + R, C @ S @ A.T).T)
            except (np.linalg.LinAlgError, ValueError):  # too ill-conditioned for its solver
                continue
    return [K for K in found if np.isfinite(K).all()]


def _warmup(model: LPVModel, runs: Runs) -> int:
    """Samples after which the predictor has forgotten its start and what is slow has shown, if a record has them to spare."""
    predictor, free = (float(np.abs(np.linalg.eigvals(frozen(model, share))).max(initial=0.0)) for share in (1.0, 0.0))
    needed = max(np.log(FORGOTTEN) / np.log(predictor) if predictor > 0.0 else 0.0, -1.0 / np.log(free) if free > 0.0 else 0.0)
    longest = min(len(piece.y) for piece in runs.pieces) // LONGEST
    return int(np.clip(needed, model.order + 1, max(longest, model.order + 1)))
