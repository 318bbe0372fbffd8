"""ILM: y(k) = y0(rho) + sum_i alpha_i sigma_i(rho(k)) y_i(k), local LTI models in parallel, blended by the schedule [1].

The schedule's range is cut into equal intervals; each gets its own LTI model of the samples in it, on deviations from the
operating points u0(rho), y0(rho); every local model runs over the whole record, and 0 <= alpha_i <= 1 is a bounded
least-squares fit of the free-run outputs.

Where the schedule is an output, y0(rho) = rho would leave nothing to the local models. Then each runs about the mean of its own
samples, and the blend reads the schedule that is known before its sample:

    y(k) = sum_i alpha_i sigma_i(rho(k-1)) (y_i(k) + c_i),    c_i = y0_i - G_i(1) u0_i

[1] "Experimental Modelling of a Web Winding Machine: LPV Approaches", sections 1.3 and 1.4.4.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from workbench.basis import Gaussian, Powers
from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.identification.lti import TIE, mean_fit
from workbench.identification.subspace import N4SID, PBSID, Subspace, channels_of
from workbench.lpv import Estimate, LPVModel, OperatingPoint, Predictor, Term
from workbench.metrics import fit
from workbench.quasi_lpv import coupling_notes
from workbench.records import field, record

NOTHING = 1e-9  # a share of a local model that rounding leaves


@record
class Plain:
    """sigma_i(p) = exp(-beta (p - p_i)^2), as in [1]: they do not add up to one, so a blend of equal models ripples."""

    normalised = False


@record
class Normalised:
    """sigma_i(p) = g_i(p) / sum_j g_j(p), g_i Gaussian: they add up to one, so a blend of equal models is that model."""

    normalised = True


Activation = Plain | Normalised


@record
class Candidate:
    """One blend that was tried, and its mean free-run FIT [percent] on the estimation records.

    drift: degree of the operating point u0(rho), y0(rho).
    overlap: distance at which an activation has fallen to one half, in interval widths from the centre, times two.
    """

    models: int
    drift: int
    activation: Activation
    overlap: float
    FIT: float


@record
class ILM:
    """y = y0(rho) + sum_i alpha_i sigma_i(rho) y_i: local models of samples with p_i <= rho < p_(i+1), blended.

    models: how many, default each of `sweep`, the smallest number within 0.5 points of the best mean free-run FIT on the
    estimation records. order: of each local model, None for its own singular values. activation: Plain, Normalised, or None
    for what the estimation records prefer; overlaps: widths of the activations to try. drift: degrees of the polynomials
    u0(rho), y0(rho) to try, the lowest within 0.5 points of the best is taken; not used where the schedule is an output.
    method: identifies the local models. resamples: block-bootstrap draws behind the standard deviations of alpha, 0 for none.

        >>> ILM(models=2, order=1).fit(data).order
        2
    """

    models: int | None = None
    order: int | None = 4
    activation: Activation | None = None
    overlaps: Sequence[float] = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
    sweep: Sequence[int] = tuple(range(2, 16))
    drift: Sequence[int] = (2, 4, 6)
    method: PBSID | N4SID = field(default=PBSID())
    resamples: int = 100
    name: str = "ILM"

    def fit(self, dataset: Dataset) -> LPVModel:
        """The blended model of all records together; raises InputError where no number of local models can be had."""
        blends, refused = self._tried(dataset)
        best = _choose(blends)
        model = _finished(_assemble(self, best), best, self, _notes(best, blends, refused))
        return dataclasses.replace(model, trained_on=dataset.fingerprints)

    def candidates(self, dataset: Dataset) -> tuple[Candidate, ...]:
        """Every blend that is tried, with its mean free-run FIT on the estimation records.

        Where the schedule is an output the best blend of each number of models, with the FIT of the model that it makes.
        """
        return tuple(blend.candidate for blend in self._tried(dataset)[0])

    def _tried(self, dataset: Dataset) -> "tuple[list[_Blend], list[str]]":
        """All blends, and what could not be had."""
        blends, refused = [], []
        own = _schedule_of(dataset.experiments[0]).has_role("output")
        for degree in (0,) if own else self.drift:
            task = _Task.of(degree, dataset)
            families, refused = _families(self, task)
            blends += [blend for family in families for blend in _blends(self, task, family)]
        return _confirmed(self, blends) if own else blends, refused


# ---- records in deviations ------------------------------------------------------------------------------------------


@record
class _Task:
    """The estimation records in deviations from the operating point, and where on the schedule they are.

    scheduled_output: which output the schedule is; blended: the schedule as the output equation reads it.
    """

    dataset: Dataset
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    schedule: Channel
    span: np.ndarray = field("2")
    point: OperatingPoint
    u: tuple[np.ndarray, ...]
    y: tuple[np.ndarray, ...]
    rho: tuple[np.ndarray, ...]
    scheduled_output: int | None

    @property
    def blended(self) -> tuple[np.ndarray, ...]:
        return self.rho if self.scheduled_output is None else tuple(np.concatenate([r[:1], r[:-1]]) for r in self.rho)

    @classmethod
    def of(cls, drift: int, dataset: Dataset) -> "_Task":
        first = dataset.experiments[0]
        inputs, outputs = channels_of(first)
        schedule = _schedule_of(first)
        rho = tuple(experiment[schedule.name] for experiment in dataset)
        span = np.array([min(r.min() for r in rho), max(r.max() for r in rho)])
        if span[0] == span[1]:
            raise InputError("does not move", channel=schedule.name, mend="use LTI for records at one schedule value")
        u = [experiment[[c.name for c in inputs]] for experiment in dataset]
        y = [experiment[[c.name for c in outputs]] for experiment in dataset]
        point = _operating_point(drift, np.concatenate(rho), np.concatenate(u), np.concatenate(y))
        phi = [point.basis(r) for r in rho]
        return cls(
            dataset, inputs, outputs, schedule, span, point,
            tuple(a - p @ point.u for a, p in zip(u, phi, strict=True)),
            tuple(a - p @ point.y for a, p in zip(y, phi, strict=True)),
            rho,
            [c.name for c in outputs].index(schedule.name) if schedule.has_role("output") else None,
        )  # fmt: skip

    def stacked(self, rows: Sequence[np.ndarray], warmup: int) -> np.ndarray:
        """Rows of all records after the warm-up of each."""
        return np.concatenate([r[warmup:] for r in rows])


def _schedule_of(experiment: Experiment) -> Channel:
    names = experiment.names_of("schedule")
    if len(names) != 1:
        raise InputError(
            f"{len(names)} schedule channels, expected one", file=experiment.name, mend="with_roles(schedule=[name])"
        )
    return experiment.channel(names[0])


def _operating_point(degree: int, rho: np.ndarray, u: np.ndarray, y: np.ndarray) -> OperatingPoint:
    """u0(rho), y0(rho): polynomials through the records by least squares.

    The equilibrium drifts smoothly with the schedule; a few coefficients follow the drift without following the excitation.
    What is left of the drift looks like dynamics to the local models, so too low a degree costs more than it saves.
    """
    basis = Powers(np.arange(degree + 1.0), scale=float(np.max(np.abs(rho))))
    phi = basis(rho)
    return OperatingPoint(basis, np.linalg.lstsq(phi, u)[0], np.linalg.lstsq(phi, y)[0])


# ---- local models ---------------------------------------------------------------------------------------------------


@record
class _Family:
    """The local models of one subdivision, and their free-run outputs (N, l, ny) record by record."""

    centres: np.ndarray = field("l")
    width: float
    local: tuple[Subspace, ...]
    offsets: np.ndarray = field("l ny")  # c_i
    left_out: int  # samples in pieces too short for the method
    simulated: tuple[np.ndarray, ...]


def _families(options: ILM, task: _Task) -> tuple[list[_Family], list[str]]:
    """One family for each number of models; numbers with an interval that is too poor are named with the reason."""
    counts = [options.models] if options.models is not None else list(options.sweep)
    found, refused = [], []
    for count in counts:
        edges = np.linspace(task.span[0], task.span[1], count + 1)
        try:
            local = tuple(_local(options, task, *pair) for pair in itertools.pairwise(edges))
        except InputError as reason:
            refused.append(f"{count} local models could not be had: {reason.problem}")
            continue
        models, left_out = zip(*local, strict=True)
        found.append((0.5 * (edges[:-1] + edges[1:]), float(edges[1] - edges[0]), models, sum(left_out)))
    if not found:
        raise InputError("; ".join(refused), mend="fewer models, longer records, or a method with smaller past")
    # all models of all families run side by side: the loop over time is paid once
    together = [model for _, _, local, _ in found for model in local]
    offsets = np.array(
        [_offset(model) if task.scheduled_output is not None else np.zeros(len(task.outputs)) for model in together]
    )
    runs = [_free_run(together, u, y, offsets) for u, y in zip(task.u, task.y, strict=True)]
    ends = np.cumsum([len(local) for _, _, local, _ in found])
    own = [slice(e - len(f[2]), e) for e, f in zip(ends, found, strict=True)]
    families = [
        _Family(f[0], f[1], f[2], offsets[part], f[3], tuple(run[:, part] for run in runs))
        for f, part in zip(found, own, strict=True)
    ]
    return families, refused


def _offset(local: Subspace) -> np.ndarray:
    """c = y0 - G(1) u0 of a local model about the mean of its samples."""
    rest = (1.0 + 1e-12) * np.eye(local.order) - local.A  # an exact integrator gets a huge gain instead of an error
    return local.y0 - (local.C @ np.linalg.solve(rest, local.B) + local.D) @ local.u0


def _local(options: ILM, task: _Task, low: float, high: float) -> tuple[Subspace, int]:
    """[1] step 1: the model of the samples with low <= rho < high; contiguous pieces, never joined across a gap.

    Beside it the number of samples that were left out, because their piece is too short for the method.
    """
    pieces = list(_pieces(task, low, high))
    everything = sum(map(len, pieces))
    pieces = [piece for piece in pieces if len(piece) >= options.method.past + options.method.future]
    if not pieces:
        raise InputError(f"no long piece of a record lies in [{low:.4g}, {high:.4g}] {task.schedule.unit}".rstrip())
    method = dataclasses.replace(options.method, order=options.order)
    return method.fit(Dataset(tuple(pieces))), everything - sum(map(len, pieces))


def _pieces(task: _Task, low: float, high: float) -> Iterator[Experiment]:
    for experiment, u, y, rho in zip(task.dataset, task.u, task.y, task.rho, strict=True):
        inside = (rho >= low) & ((rho < high) | (high == task.span[1]))
        edges = np.flatnonzero(np.diff(np.r_[0, inside, 0]))
        for start, stop in edges.reshape(-1, 2):
            own = slice(start, stop)
            yield Experiment(
                experiment.name, experiment.t[own], (*task.inputs, *task.outputs), np.hstack([u[own], y[own]]), experiment.dt
            )


def _free_run(models: Sequence[Subspace], u: np.ndarray, y: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """[1] step 1: y_i(k) + c_i of every model side by side, (N, models, ny); the predictor follows y during the warm-up."""
    n, warmup = max(m.order for m in models), models[0].past
    A, B, C, K = (np.zeros((len(models), *shape)) for shape in ((n, n), (n, u.shape[1]), (y.shape[1], n), (n, y.shape[1])))
    for i, m in enumerate(models):
        A[i, : m.order, : m.order], B[i, : m.order], C[i, :, : m.order], K[i, : m.order] = m.A, m.B, m.C, m.K
    D = np.array([m.D for m in models])
    F, G = A - K @ C, B - K @ D
    x = np.zeros((len(u) + 1, len(models), n, 1))
    with np.errstate(over="ignore", invalid="ignore"):  # an unstable local model may leave the numbers
        driven = np.einsum("inu,ku->kin", B, u)[..., None]
        followed = (
            np.einsum("inu,ku->kin", G, u[:warmup])[..., None]
            + np.einsum("iny,kiy->kin", K, y[:warmup, None] - offsets)[..., None]
        )
        for k in range(len(u)):
            x[k + 1] = F @ x[k] + followed[k] if k < warmup else A @ x[k] + driven[k]
        return np.einsum("iyn,kin->kiy", C, x[:-1, ..., 0]) + np.einsum("iyu,ku->kiy", D, u) + offsets


# ---- blending -------------------------------------------------------------------------------------------------------


@record
class _Blend:
    candidate: Candidate
    task: _Task
    family: _Family
    basis: Gaussian
    alpha: np.ndarray = field("l ny", low=0.0, high=1.0)


def _blends(options: ILM, task: _Task, family: _Family) -> Iterator[_Blend]:
    """Every activation and width on one family of local models."""
    kinds = (options.activation,) if options.activation is not None else (Plain(), Normalised())
    warmup = options.method.past
    finite = np.all([np.isfinite(s).all(axis=(0, 2)) for s in family.simulated], axis=0)
    # what left the numbers gets no weight
    outputs = [np.where(finite[:, None], s, 0.0) for s in family.simulated]
    for kind in kinds:
        for overlap in options.overlaps:
            half = 0.5 * overlap * family.width
            beta = np.full(len(family.centres), np.log(2.0) / half**2)
            basis = Gaussian(family.centres, beta, kind.normalised)
            weighted = [basis(rho)[..., None] * s for rho, s in zip(task.blended, outputs, strict=True)]
            alpha = _interpolation(task.stacked(weighted, warmup), task.stacked(task.y, warmup))
            runs = (
                [np.einsum("kiy,iy->ky", w, alpha) for w in weighted]
                if task.scheduled_output is None
                else [_own_run(task, basis, alpha * s, rho[warmup - 1], warmup) for s, rho in zip(outputs, task.rho, strict=True)]
            )
            scores = [
                fit(y[warmup:, j] + offset[warmup:, j], run[warmup:, j] + offset[warmup:, j])
                for y, run, offset in zip(task.y, runs, _offsets(task), strict=True)
                for j in range(len(task.outputs))
            ]
            degree = len(task.point.u) - 1
            candidate = Candidate(len(family.local), degree, kind, overlap, float(np.mean(scores)))
            yield _Blend(candidate, task, family, basis, alpha)


def _own_run(task: _Task, basis: Gaussian, parts: np.ndarray, rho: float, warmup: int) -> np.ndarray:
    """sum_i sigma_i(rho(k-1)) parts_i(k), (N, ny), for parts (N, l, ny): from the warm-up on along the run's own output."""
    assert task.scheduled_output is not None
    y, (low, high), level = (
        np.zeros((len(parts), parts.shape[2])),
        task.span.tolist(),
        float(task.point.y[0, task.scheduled_output]),
    )
    for k in range(warmup, len(parts)):
        y[k] = np.array(basis.functions(rho)) @ parts[k]
        rho = min(max(float(y[k, task.scheduled_output]) + level, low), high)
    return y


def _offsets(task: _Task) -> list[np.ndarray]:
    return [task.point.basis(rho) @ task.point.y for rho in task.rho]


def _interpolation(weighted: np.ndarray, y: np.ndarray) -> np.ndarray:
    """[1] step 2: min ||Y - sum_i alpha_i sigma_i y_i||_2 subject to 0 <= alpha_i <= 1, output by output; (l, ny)."""
    alphas = []
    for j in range(y.shape[1]):
        triangle = np.asarray(np.linalg.qr(np.column_stack([weighted[:, :, j], y[:, j]]), mode="r"))
        alphas.append(_bounded(triangle[:, :-1], triangle[:, -1]))
    return np.array(alphas).T


def _bounded(X: np.ndarray, target: np.ndarray) -> np.ndarray:
    from scipy.optimize import lsq_linear

    # scipy's bounded-variable method divides 0 by 0 when a free variable stands on its bound already; the slower
    # trust-region method does not
    with np.errstate(divide="ignore", invalid="ignore"):
        alpha = lsq_linear(X, target, bounds=(0.0, 1.0), method="bvls").x
    if not np.all(np.isfinite(alpha)):
        alpha = lsq_linear(X, target, bounds=(0.0, 1.0), method="trf", tol=1e-12).x
    return np.clip(alpha, 0.0, 1.0)


def _confirmed(options: ILM, blends: Sequence[_Blend]) -> list[_Blend]:
    """The best blend of each number of models, with the FIT of its model: one that schedules itself may go where it begins."""
    best: dict[int, _Blend] = {}
    for blend in sorted(_with_share(blends), key=lambda b: b.candidate.FIT):
        best[blend.candidate.models] = blend
    found = []
    for blend in best.values():
        FIT = mean_fit(_observed(_assemble(options, blend), blend, options), blend.task.dataset)
        found.append(dataclasses.replace(blend, candidate=dataclasses.replace(blend.candidate, FIT=FIT)))
    return found


def _with_share(blends: Sequence[_Blend]) -> list[_Blend]:
    """Those in which a local model has a share."""
    return [blend for blend in blends if blend.alpha.max() > NOTHING]


def _choose(blends: Sequence[_Blend]) -> _Blend:
    """Of the blends within half a point of the best: the lowest drift, of those the fewest models, of those the best."""
    blends = _with_share(blends)
    if not blends:
        raise InputError(
            "no local model has a share in any blend: their free runs say nothing", mend="use SSM, or longer records"
        )
    best = max(b.candidate.FIT for b in blends)
    near = [b for b in blends if best - TIE <= b.candidate.FIT]
    return min(near, key=lambda b: (b.candidate.drift, b.candidate.models, -b.candidate.FIT))


# ---- the model ------------------------------------------------------------------------------------------------------


def _assemble(options: ILM, blend: _Blend) -> LPVModel:
    """Block-diagonal A and stacked B in a constant term; C_i alpha_i in the term of activation i.

    A local model whose alpha is zero for every output has no states here.
    """
    from scipy.linalg import block_diag

    used = [i for i in range(len(blend.alpha)) if _weight(blend, i) > 0.0]
    local = [blend.family.local[i] for i in used]
    task = blend.task
    last, nx, nu, ny = len(blend.alpha), sum(m.order for m in local), len(task.inputs), len(task.outputs)
    A, B = np.zeros((last + 1, nx, nx)), np.zeros((last + 1, nx, nu))
    C, D = np.zeros((last + 1, ny, nx)), np.zeros((last + 1, ny, nu))
    A[last], B[last] = block_diag(*(m.A for m in local)), np.vstack([m.B for m in local])
    first = np.cumsum([0, *(m.order for m in local)])
    for block, (i, m) in enumerate(zip(used, local, strict=True)):
        C[i, :, first[block] : first[block + 1]] = blend.alpha[i][:, None] * m.C  # [1] (1.11)
        D[i] = blend.alpha[i][:, None] * m.D
    late = 0 if task.scheduled_output is None else 1  # what the output equation reads is known before its sample
    return LPVModel(
        options.name, task.dataset.dt, task.inputs, task.outputs, (task.schedule,), task.span[None],
        dataclasses.replace(blend.basis, with_constant=True), (*(Term(i, late) for i in range(last)), Term(last)), A, B, C, D,
        task.point if task.scheduled_output is None else _blended_point(blend),
    )  # fmt: skip


def _blended_point(blend: _Blend) -> OperatingPoint:
    """u0, and y0(rho) = y0 + sum_i alpha_i sigma_i(rho) c_i."""
    point, offsets = blend.task.point, blend.alpha * blend.family.offsets
    u = np.vstack([np.zeros((len(offsets), point.u.shape[1])), point.u])
    return OperatingPoint(dataclasses.replace(blend.basis, with_constant=True), u, np.vstack([offsets, point.y]))


def _weight(blend: _Blend, i: int) -> float:
    """Largest alpha of a local model over the outputs; what is left of a zero by rounding counts as zero."""
    largest = float(blend.alpha[i].max())
    return largest if largest > NOTHING else 0.0


def _predictors(model: LPVModel, blend: _Blend, warmup: int) -> tuple[Predictor, ...]:
    """Two observers for the blend; [1] gives none.

    Shared: every local model is corrected by the blend's own innovation, K_i (y - y_blend), as in an innovation model.
    Separate: every local model follows the output alone, K_i (y - y_i); always stable, and less accurate where several
    models are active. The shared one is left out where it does not forget its initial state. Where the schedule is an output
    each local model has an operating point of its own, and without the shared one none is corrected.
    """
    from scipy.linalg import block_diag

    local = [m for i, m in enumerate(blend.family.local) if _weight(blend, i) > 0.0]
    K = np.zeros((len(model.A), model.order, len(model.outputs)))
    K[-1] = np.vstack([m.K for m in local])
    F, G = np.zeros_like(model.A), np.zeros_like(model.B)
    F[-1] = block_diag(*(m.A - m.K @ m.C for m in local))
    G[-1] = np.vstack([m.B - m.K @ m.D for m in local])
    separate = (
        Predictor(F, G, K, warmup)
        if blend.task.scheduled_output is None
        else Predictor(model.A, model.B, np.zeros_like(K), warmup)
    )
    shared = Predictor(model.A - K[-1] @ model.C, model.B - K[-1] @ model.D, K, warmup)
    grid = model.weights(np.linspace(model.span[0], model.span[1], 51))
    radius = np.abs(np.linalg.eigvals(np.tensordot(grid, shared.F, 1))).max()
    return (shared, separate) if radius < 1.0 else (separate,)


def _finished(model: LPVModel, blend: _Blend, options: ILM, notes: tuple[str, ...]) -> LPVModel:
    """With an observer, its noise, and the spread of alpha."""
    model = _observed(model, blend, options)
    own = () if model.scheduled_output is None else coupling_notes(model)
    estimates = _estimates(blend, options.method.past, options.resamples)
    return dataclasses.replace(model, estimates=estimates, notes=(*notes, *own))


def _observed(model: LPVModel, blend: _Blend, options: ILM) -> LPVModel:
    """With the observer that predicts the estimation records better one step ahead, and its noise."""
    task, warmup = blend.task, options.method.past
    names = [c.name for c in task.outputs]
    choices = []
    for predictor in _predictors(model, blend, warmup):
        candidate = dataclasses.replace(model, predictor=predictor)
        e = np.concatenate([(x[names] - candidate.predict(x))[warmup:] for x in task.dataset])
        choices.append(dataclasses.replace(candidate, noise=e.T @ e / len(e)))
    power = np.var(task.stacked(task.y, warmup), axis=0)
    return min(choices, key=lambda m: float(np.sum(np.diag(m.noise) / power)))


def _estimates(blend: _Blend, warmup: int, draws: int, *, block: int = 50) -> tuple[Estimate, ...]:
    """alpha with standard deviations: blocks of rows drawn anew, the local models as they are."""
    task = blend.task
    outputs = [np.nan_to_num(s, posinf=0.0, neginf=0.0) for s in blend.family.simulated]
    rows = task.stacked([blend.basis(r)[..., None] * s for r, s in zip(task.blended, outputs, strict=True)], warmup)
    y = task.stacked(task.y, warmup)
    random = np.random.default_rng(0)
    spread = np.zeros_like(blend.alpha)
    for j in range(y.shape[1] if draws > 1 else 0):
        table = np.column_stack([rows[:, :, j], y[:, j]])
        triangles = np.array(
            [np.asarray(np.linalg.qr(table[k : k + block], mode="r")) for k in range(0, len(table) - block, block)]
        )
        repeats = []
        for _ in range(draws):
            picked = triangles[random.integers(len(triangles), size=len(triangles))].reshape(-1, table.shape[1])
            R = np.asarray(np.linalg.qr(picked, mode="r"))
            repeats.append(_bounded(R[:, :-1], R[:, -1]))
        spread[:, j] = np.std(repeats, axis=0)
    unit = task.schedule.unit
    return tuple(
        Estimate(f"alpha of {y.name} at {task.schedule.name} = {c:.4g} {unit}".rstrip(), blend.alpha[i, j], spread[i, j])
        for i, c in enumerate(blend.family.centres)
        for j, y in enumerate(task.outputs)
    )


def _notes(best: _Blend, blends: Sequence[_Blend], refused: Sequence[str]) -> tuple[str, ...]:
    chosen = best.candidate
    kind = "normalised" if chosen.activation.normalised else "plain"
    tried = sorted({b.candidate.models for b in blends})
    best_of = {count: max(b.candidate.FIT for b in blends if b.candidate.models == count) for count in tried}
    orders = [m.order for m in best.family.local]
    orders = orders[:1] if len(set(orders)) == 1 else orders
    about = (
        f"operating point of degree {chosen.drift}"
        if best.task.scheduled_output is None
        else "each about the mean of its samples"
    )
    notes = [
        f"{chosen.models} local models of order {', '.join(map(str, orders))}, {kind} activations, "
        f"overlap {chosen.overlap:g}, {about}; "
        "free-run FIT on the estimation records by number of models: "
        + ", ".join(f"{count}: {value:.1f}" for count, value in best_of.items())
    ]
    share = best.family.left_out / sum(map(len, best.task.rho))
    if share > 0.01:
        notes.append(f"{100 * share:.0f} % of the samples were left out: their pieces of a record are too short for the method")
    for i, (centre, m) in enumerate(zip(best.family.centres, best.family.local, strict=True)):
        radius = float(np.abs(m.poles).max())
        if radius >= 1.0 and _weight(best, i) > 0.0:
            notes.append(f"unstable: the local model at {centre:.4g} has a pole of modulus {radius:.4g}; its free run grows")
    return (*notes, *refused)
