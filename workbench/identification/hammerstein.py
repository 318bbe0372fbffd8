"""Hammerstein-Wiener models from records: static curves of the inputs, lost signs of outputs, and an LPV core between them.

    v_i = f_i(u_i) = c_i0 + c_i1 u_i + sum_j c_ij max(u_i - n_j, 0),   z = G(rho) v,   y = z or |z|

For a given core the free run is linear in all c, for given curves the core is an identification problem like any other: the two
take turns, each begun where the other one ended. The first curves are those of a linear model that has a gain of its own for
each function of each input: the leading singular vector of its impulse responses [1]. The number of nodes is chosen as methods
are: by free runs on parts of the records that were left out.

[1] E.-W. Bai, "An optimal two-stage identification algorithm for Hammerstein-Wiener nonlinear systems", Automatica 34 (1998).
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from workbench.curves import Curve
from workbench.data import Dataset, Experiment
from workbench.errors import InputError, check_known
from workbench.hammerstein import HammersteinWienerModel, with_curves, with_signs
from workbench.identification.lti import LTI
from workbench.identification.output_error.refine import affordable, noise_of, refined
from workbench.identification.schedules import schedules_of
from workbench.identification.selection import Judged, parts
from workbench.identification.signs import with_lost_signs
from workbench.identification.ssm import SSM
from workbench.identification.subspace import channels_of
from workbench.lpv import LPVModel
from workbench.metrics import score
from workbench.records import record

LEVELS = 3  # values of an input, from which on it may have a curve
SPARSE = 0.01  # of the samples: what must lie between two nodes
ROUNDS, ENOUGH = 12, 0.005  # turns of core and curves at most; share of the error that one must gain
RESPONSES = 60  # samples of the impulse responses that begin the curves
WORTH = 0.9  # of the error on what was left out: what curves, and more nodes, must do, surely
SPARED = 1.03  # of that error: what an input may cost that goes without its curve
STRAIGHT = 0.05  # of the spread of an input: a curve that is no farther from it is none


@record
class Seen:
    """What a look at records found: these with the signs they lack, the outputs that lack them, the nodes of curves (0: none).

    FIT [%]: mean of its free runs on parts that were left out; plain: that of the same without curves and signs. tried: how
    everything ran there. curves: of the parts that were not left out; other inputs have none.
    """

    records: Dataset
    unsigned: tuple[str, ...]
    nodes: int
    FIT: float
    tried: str
    curves: tuple[Curve, ...] = ()
    plain: float = -np.inf


@record
class HammersteinWiener:
    """y = G(rho) f(u): a curve for each input, its nodes and those of all others chosen by left-out parts, and signs of outputs.

    nodes: numbers of nodes to choose from. core: the method of G; None takes LTI, or SSM where there is a schedule, of this order
    and feedthrough, which they choose by default. unsigned: outputs of which the sensor shows |z|; None finds them out.

        >>> curved = HammersteinWiener().fit(fan)
        >>> round(score(curved, fan_held_out, "held-out", ["free-run"])[0].FIT)  # LTI: 76
        99
        >>> low, middle, high = curved.curves[0](np.array([0.0, 0.7, 1.0]))
        >>> f"{(middle - low) / (high - low):.1f}"  # 0.7^2
        '0.5'
    """

    nodes: Sequence[int] = (3, 5, 9)
    core: Any = None
    unsigned: Sequence[str] | None = None
    order: int | None = None
    feedthrough: bool | None = None
    name: str = "HW"

    def __post_init__(self):
        for n in self.nodes:
            if n != int(n) or n < 3:
                raise InputError(f"{n} nodes", mend="a curve has at least three; lti and ssm have none")

    def fit(self, dataset: Dataset) -> HammersteinWienerModel:
        """The model of all records together.

        Raises InputError for records without input or output, and where neither curves nor lost signs make free runs better on
        what was left out: then one of the other methods has the same model without them.
        """
        first = dataset.experiments[0]
        channels_of(first)  # refuses records without inputs or outputs
        if any(c.has_role("output") for c in schedules_of(first)):
            mend = "take another schedule, or none"
            raise InputError("a static curve before a model whose schedule is its own output", file=first.name, mend=mend)
        return self.of(self.look(dataset), dataset)

    def of(self, seen: "Seen", dataset: Dataset) -> HammersteinWienerModel:
        """The model of all records with the signs and curves that a look at them found. Raises InputError where it found none."""
        if seen.nodes == 0 and not seen.unsigned:
            said = f"no static curve of an input makes free runs better on parts of the records that were left out ({seen.tried})"
            raise InputError(said, file=dataset.names[0], mend="take lti, ssm or another method")
        model = self._alternated(seen.records, seen.unsigned, seen.nodes, seen.curves, [c.input for c in seen.curves])
        notes = (f"free-run FIT on parts that were left out, by nodes of a curve: {seen.tried}", *_said(model))
        noise = noise_of(model, dataset)
        return replace(model, noise=noise if np.isfinite(noise).all() else None, trained_on=dataset.fingerprints, notes=notes)

    # ---- what there is to be found -----------------------------------------------------------------------------------

    def look(self, dataset: Dataset) -> "Seen":
        """Which signs, how many nodes and for which inputs: the simplest ones that nothing else surely runs better than by much.

        Raises InputError where nothing runs better than the mean of what was left out.
        """
        for name in self.unsigned or ():
            check_known("output", name, dataset.experiments[0].names_of("output"), file=dataset.experiments[0].name)
        unsigned, signs = with_lost_signs(dataset, self.unsigned)
        if self.unsigned is not None and unsigned != tuple(self.unsigned):
            lost = ", ".join(name for name in self.unsigned if name not in unsigned)
            mend = "give longer records, of few inputs"
            raise InputError("its signs cannot be found", file=dataset.experiments[0].name, channel=lost, mend=mend)
        given = Dataset(tuple(with_signs(e, unsigned, own) for e, own in zip(dataset, signs, strict=True)))
        kinds = {unsigned: given} | ({(): dataset} if self.unsigned is None else {})
        best, judged, said = Seen(dataset, (), 0, -np.inf, ""), None, []
        for own, records in sorted(kinds.items()):  # an even curve may have looked like lost signs: both are tried
            seen, unseen, curves = parts(records)[0], parts(dataset)[1], ()
            for count in (0, *self.nodes):
                what = " with signs of ".join([str(count or "none"), *filter(None, [", ".join(own)])])
                try:
                    model, now = self._judged(seen, unseen, own, count, curves)
                except InputError as reason:  # too short for that
                    said.append(f"{what}: {reason.problem}")
                    continue
                said.append(f"{what}: {now.mean:.1f} %" if now.mean > -100.0 else f"{what}: runs away")
                curves = model.curves
                if not own and not count:
                    best = replace(best, plain=now.mean)
                if curves and all(map(_straight, curves)):
                    continue
                sure = judged is None or best.nodes > 0 or now.surely_better(judged)
                if sure and (judged is None or 100.0 - now.mean < WORTH * (100.0 - judged.mean)):
                    best, judged = replace(best, records=records, unsigned=own, nodes=count, FIT=now.mean, curves=curves), now
        if not best.FIT > 0.0:
            mend = "give longer records, or others: these inputs do not tell these outputs"
            raise InputError(f"no model runs better than the mean of what was left out ({'; '.join(said)})", mend=mend)
        return replace(self._spared(best, parts(best.records)[0], parts(dataset)[1]), tried="; ".join(said))

    def _judged(
        self, seen: Dataset, unseen: Dataset, unsigned: tuple[str, ...], count: int, before: Sequence[Curve],
        bent: Sequence[str] | None = None,
    ) -> tuple[HammersteinWienerModel, Judged]:  # fmt: skip
        """The model of some parts, and how it runs on the others."""
        model = self._alternated(seen, unsigned, count, before, bent)
        return model, Judged(tuple(s.FIT for s in score(model, unseen, "held-out", ["free-run"])), True)

    def _spared(self, best: Seen, seen: Dataset, unseen: Dataset) -> Seen:
        """Without the curves of inputs that run as well without."""
        for name in [curve.input for curve in best.curves]:
            rest = [curve.input for curve in best.curves if curve.input != name]
            if not rest:
                break
            model, now = self._judged(seen, unseen, best.unsigned, best.nodes, best.curves, rest)
            if 100.0 - now.mean <= SPARED * (100.0 - best.FIT):
                best = replace(best, curves=model.curves, FIT=now.mean)
        return best

    def _usual(self, scheduled: bool) -> Any:
        own = {"order": self.order, "feedthrough": self.feedthrough}
        return SSM(**own) if scheduled else LTI(**own, resamples=0)

    # ---- core and curves in turn ---------------------------------------------------------------------------------------

    def _alternated(
        self, dataset: Dataset, unsigned: tuple[str, ...], count: int, before: Sequence[Curve] = (),
        bent: Sequence[str] | None = None,
    ) -> HammersteinWienerModel:  # fmt: skip
        """The model with curves of so many nodes; dataset: with the signs of `unsigned` as far as they are known.

        before: curves of fewer nodes, or of fewer records. Where signs are lost there are several minima: it is begun there too.
        bent: inputs that may have one; None is all.
        """
        bends = {name: nodes for name, nodes in _bends(dataset, count).items() if bent is None or name in bent} if count else {}
        starts = [_begun(dataset, bends), *([_through(before, bends)] if unsigned and bends and before else [])]
        tried = [self._in_turn(dataset, unsigned, bends, starts[0])]
        for own in starts[1:]:
            with suppress(InputError):  # too short behind these curves
                tried.append(self._in_turn(dataset, unsigned, bends, own))
        return min(tried, key=_left).model

    def _in_turn(
        self, dataset: Dataset, unsigned: tuple[str, ...], bends: dict[str, np.ndarray], weights: dict[str, np.ndarray]
    ) -> "_Tried":
        """Core and curves in turn, the curves first of these weights."""
        best = self._with_core(dataset, unsigned, bends, weights)
        for _ in range(ROUNDS):
            signs = [best.model.signs_of(own) for own in best.z]
            dataset = Dataset(tuple(with_signs(e, unsigned, own) for e, own in zip(dataset, signs, strict=True)))
            try:
                now = self._with_core(dataset, unsigned, bends, _bent(best.model, dataset, bends, best.z))
            except InputError:  # too short behind these curves
                break
            gained, best = now.missed < (1.0 - ENOUGH) * best.missed, min(now, best, key=_left)
            if not gained:
                break
        return best

    def _with_core(
        self, dataset: Dataset, unsigned: tuple[str, ...], bends: dict[str, np.ndarray], weights: dict[str, np.ndarray]
    ) -> "_Tried":
        """A core identified behind the curves, by its free runs where that takes seconds."""
        curves = tuple(_curve(name, nodes, weights[name], dataset) for name, nodes in bends.items())
        method = self.core or self._usual(bool(dataset.experiments[0].names_of("schedule")))
        inner = Dataset(tuple(with_curves(e, curves) for e in dataset))
        core: LPVModel = method.fit(inner)
        if affordable(core, inner):
            core = refined(core, inner)
        model = HammersteinWienerModel(self.name, core, curves, unsigned)
        z = [model.run(e) for e in dataset]
        return _Tried(model, z, _missed(model, dataset, z))


def _straight(curve: Curve) -> bool:
    """Whether v is u, as far as it matters."""
    return bool(np.abs(curve.v - curve.u).max() <= STRAIGHT * np.ptp(curve.u))


class _Tried(NamedTuple):
    """A model, its free runs with their signs by record, and what these miss."""

    model: HammersteinWienerModel
    z: list[np.ndarray]
    missed: float


def _left(tried: _Tried) -> float:
    return tried.missed


def _names(model: HammersteinWienerModel) -> list[str]:
    return [c.name for c in model.outputs]


def _missed(model: HammersteinWienerModel, dataset: Dataset, z: Sequence[np.ndarray]) -> float:
    """Root mean square over records and outputs of what runs z (N, ny) miss, in standard deviations of what was measured.

    As the sensors show both: where signs are lost, which of them are right is not known.
    """
    names, squares = _names(model), []
    with np.errstate(over="ignore", invalid="ignore"):
        for e, own in zip(dataset, z, strict=True):
            y = with_signs(e, model.unsigned, 1.0)[names]
            squares.append(np.mean((y - model.shown(own)) ** 2 / np.var(y, axis=0)))
        missed = float(np.sqrt(np.mean(squares)))
    return missed if np.isfinite(missed) else np.inf


# ---- curves -----------------------------------------------------------------------------------------------------------


def _bends(dataset: Dataset, count: int) -> dict[str, np.ndarray]:
    """Nodes of every input that may have a curve, spread evenly over its values; of few values at these."""
    found = {}
    for name in dataset.experiments[0].names_of("input"):
        u = np.concatenate([e[name] for e in dataset])
        levels = np.unique(u)
        if len(levels) < LEVELS:
            continue
        nodes = np.linspace(levels[0], levels[-1], count)
        if len(levels) <= 2 * count:
            nodes = levels[np.unique(np.abs(levels - nodes[:, None]).argmin(axis=1))] if len(levels) > count else levels
        kept = [nodes[0]]
        for node in nodes[1:-1]:
            if np.count_nonzero((u >= kept[-1]) & (u < node)) >= SPARSE * len(u) <= np.count_nonzero(u > node):
                kept.append(node)
        found[name] = np.array([*kept, nodes[-1]])
    return found


def _functions(u: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """u, and what lies beyond each inner node, (N, n - 1): with a constant, every curve through these nodes is a sum of them."""
    return np.column_stack([u, *(np.maximum(u - node, 0.0) for node in nodes[1:-1])])


def _curve(name: str, nodes: np.ndarray, weights: np.ndarray, dataset: Dataset) -> Curve:
    """The curve of these weights, with the mean and the standard deviation of u, and rising with u on the whole."""
    u = np.concatenate([e[name] for e in dataset])
    v, at = _functions(u, nodes) @ weights, _functions(nodes, nodes) @ weights
    spread, along = v.std(), float(np.sum((v - v.mean()) * (u - u.mean())))
    gain = (-1.0 if along < 0.0 else 1.0) * u.std() / spread if spread > 0.0 else 0.0
    return Curve(name, nodes, u.mean() + gain * (at - v.mean()))


def _begun(dataset: Dataset, bends: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Weights of the functions of each input, by the leading singular vector of their impulse responses in one linear model."""
    straight = {name: np.eye(len(nodes) - 1)[0] for name, nodes in bends.items()}
    if not bends:
        return straight
    inputs, outputs = channels_of(dataset.experiments[0])
    records, place, at = [], {}, 0
    for c in inputs:
        n = len(bends[c.name]) - 1 if c.name in bends else 1
        place[c.name], at = slice(at, at + n), at + n
    for e in dataset:
        columns = [_functions(e[c.name], bends[c.name]) if c.name in bends else e[c.name][:, None] for c in inputs]
        values = {f"{i}": column for i, column in enumerate(np.column_stack(columns).T)}
        records.append(Experiment.from_arrays(e.name, e.dt, inputs=values, outputs={f"y{c.name}": e[c.name] for c in outputs}))
    try:
        A, B, C, D = LTI(resamples=0).fit(Dataset(tuple(records))).freeze()
    except InputError:  # too short for so many inputs
        return straight
    spread = np.array([np.std(np.concatenate([e[c.name] for e in dataset])) for c in outputs])
    responses, state = [D], B
    for _ in range(RESPONSES):
        responses.append(C @ state)
        state = A @ state
    H = np.concatenate([own / spread[:, None] for own in responses])
    return {
        name: np.linalg.svd(H[:, place[name]], full_matrices=False)[2][0] if np.isfinite(H).all() else straight[name]
        for name in bends
    }


def _bent(
    model: HammersteinWienerModel, dataset: Dataset, bends: dict[str, np.ndarray], z: Sequence[np.ndarray]
) -> dict[str, np.ndarray]:
    """Weights of the functions of each input under which the runs of the model's core err least, z being those of its curves."""
    if not bends:
        return {}
    core, names = model.core, _names(model)
    spread = np.std(np.concatenate([e[names] for e in dataset]), axis=0)
    columns, left = [], []
    now = {curve.input: _weights(curve) for curve in model.curves}
    for e, own in zip(dataset, z, strict=True):
        columns.append(_linear(core, e, bends)[core.warmup :] / spread[:, None])
        left.append(((e[names] - own) / spread)[core.warmup :])
    x = np.concatenate(columns)  # (N, ny, nw)
    step = np.linalg.lstsq(x.reshape(-1, x.shape[2]), np.concatenate(left).ravel(), rcond=1e-9)[0]
    found, at = {}, 0
    for name, nodes in bends.items():
        n = len(nodes)  # the constant first: a shift of v, which the curve's mean takes up
        found[name] = now[name] + step[at + 1 : at + n]
        at += n
    return found


def _through(curves: Sequence[Curve], bends: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Weights of the functions of each input that read its curve at the nodes."""
    by_input = {curve.input: curve for curve in curves}
    return {
        name: _weights(Curve(name, nodes, by_input[name](nodes) if name in by_input else nodes)) for name, nodes in bends.items()
    }


def _weights(curve: Curve) -> np.ndarray:
    """Weights of the functions through its nodes: the first slope, and how much each slope is more than the one before."""
    return np.concatenate([curve.slopes[:1], np.diff(curve.slopes)])


def _linear(core: LPVModel, e: Experiment, bends: dict[str, np.ndarray]) -> np.ndarray:
    """Free runs from rest under a constant and each function of each curved input, (N, ny, nw)."""
    *_, weight, _ = core.deviations(e)
    forced, which = [], []
    for i, c in enumerate(core.inputs):
        if c.name in bends:
            own = np.column_stack([np.ones(len(e)), _functions(e[c.name], bends[c.name])])
            forced.append(own)
            which += [i] * own.shape[1]
    f = np.concatenate(forced, axis=1)
    x, out = np.zeros((core.order, f.shape[1])), np.empty((len(e), len(core.outputs), f.shape[1]))
    A, B, C, D = (np.tensordot(weight, M, 1) for M in (core.A, core.B[:, :, which], core.C, core.D[:, :, which]))
    for k in range(len(e)):
        out[k] = C[k] @ x + D[k] * f[k]
        x = A[k] @ x + B[k] * f[k]
    return out


def _said(model: HammersteinWienerModel) -> list[str]:
    """What is to be known of the curves and the signs."""
    said = [f"{name} is shown without its sign: what the model runs by has one" for name in model.unsigned]
    for curve in model.curves:
        low, high = curve.slopes.min(), curve.slopes.max()
        kind = (
            f"its slope is {low:.2g} to {high:.2g} of the mean"
            if curve.rising
            else "it does not rise everywhere, so it has no inverse"
        )
        said.append(f"a static curve of {curve.input} with {len(curve.u)} nodes: {kind}")
    return said
