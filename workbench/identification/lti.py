"""One LTI model for all records: x+ = A x + B (u - u0), y = C x + y0, by subspace identification.

The order is chosen on the estimation records alone, by free-run FIT among the orders that the singular values show.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.advice import feedback, in_a_loop
from workbench.basis import CONSTANT
from workbench.data import Channel, Dataset
from workbench.errors import InputError
from workbench.identification.feedthrough import acts_at_once
from workbench.identification.subspace import N4SID, PBSID, PredictorEstimate, Subspace, predictor_estimate, resampled
from workbench.lpv import Estimate, LPVModel, OperatingPoint, Predictor, constant_model
from workbench.metrics import score
from workbench.records import field, record

#: A smaller model is preferred while its free-run FIT is within this many points of the best.
RUNS_AWAY = -1e3  # FIT [%]: a number below says no more than that
TIE = 0.5
LOOKED_AT, FOLDS = 4, 20.0  # order in which an unstable pole is looked for; e-folds along a record, beyond which it is one


@record
class Candidate:
    """One order that was tried, and its mean free-run FIT [percent] on the estimation records."""

    order: int
    FIT: float


@record
class LTI:
    """x+ = A x + B (u - u0), y = C x + D (u - u0) + y0: one model with constant matrices for all records.

    order: default the smallest of `orders` whose mean free-run FIT on the estimation records is within 0.5 points of the
    best. method: PBSID (consistent in closed loop) or N4SID, whose windows are used and whose own order is not.
    feedthrough: estimate D; None where the records show that inputs act within the sample.
    resamples: block-bootstrap draws behind the standard deviations of the estimates (PBSID only), 0 for none.

        >>> LTI(order=1).fit(data).to_control().poles().round(2)
        array([0.91+0.j])
    """

    order: int | None = None
    method: PBSID | N4SID = field(default=PBSID())
    orders: Sequence[int] = tuple(range(1, 11))
    resamples: int = 40
    feedthrough: bool | None = None
    name: str = "LTI"

    def fit(self, dataset: Dataset) -> LPVModel:
        """The model of all records together, with its one-step predictor.

        The operating point is the model's own equilibrium nearest to the mean of the records. It is not the mean itself: an
        offset between the two would act as a constant disturbance on the dynamics; nor the first samples, which carry noise.
        """
        estimate = self._method(dataset).estimate(dataset)
        tried = self._candidates(estimate, dataset)
        order = self.order or _smallest_near_best(tried)
        chosen = estimate.realise(order)
        notes = (*_order_note(chosen, tried), *model_notes(chosen, self.method, dataset))
        spread = _estimates(chosen, estimate, self.resamples) if isinstance(estimate, PredictorEstimate) else ()
        return replace(to_model(self.name, chosen, estimates=spread, notes=notes), trained_on=dataset.fingerprints)

    def sweep(self, dataset: Dataset) -> tuple[Candidate, ...]:
        """Mean free-run FIT on the estimation records for every order that can be had from them."""
        return self._candidates(self._method(dataset).estimate(dataset), dataset)

    def _method(self, dataset: Dataset) -> PBSID | N4SID:
        direct = acts_at_once(dataset) if self.feedthrough is None else self.feedthrough
        return replace(self.method, feedthrough=direct)

    def _candidates(self, estimate, dataset: Dataset) -> tuple[Candidate, ...]:
        if self.order is not None:
            return ()
        orders = [n for n in self.orders if n <= estimate.largest]
        if not orders:
            raise InputError(f"none of the orders {tuple(self.orders)} can be had", mend=f"at most {estimate.largest}")
        return tuple(Candidate(n, mean_fit(to_model(self.name, estimate.realise(n)), dataset)) for n in orders)


def to_model(name: str, found: Subspace, *, estimates: tuple[Estimate, ...] = (), notes: tuple[str, ...] = ()) -> LPVModel:
    """A subspace estimate as an LPV model with one constant term and its predictor F = A - K C, G = B - K D."""
    F, G = found.A - found.K @ found.C, found.B - found.K @ found.D
    return constant_model(
        name,
        found.dt,
        (found.inputs, found.outputs),
        (found.A, found.B, found.C, found.D),
        OperatingPoint(CONSTANT, found.u0[None], found.y0[None]),
        predictor=Predictor(F[None], G[None], found.K[None], warmup=found.past),
        noise=found.covariance,
        estimates=estimates,
        notes=notes,
    )


def held_by_a_loop(dataset: Dataset) -> LPVModel | None:
    """A linear model of records that are all of a loop around a machine that is unstable by itself; None for other records.

    What is off in such a model grows by more than FOLDS e-folds along a record. Of a machine that integrates it does not, however
    its pole is estimated; a low-order regression on the past would not do, which noise in a loop makes unstable by itself.
    """
    if not all(map(in_a_loop, dataset)):
        return None
    try:
        estimate = PBSID().estimate(dataset)
    except InputError:  # too short
        return None
    found = estimate.realise(min(LOOKED_AT, estimate.largest))
    grows = np.log(np.abs(found.poles).max()) * max(map(len, dataset))
    return to_model("PBSID", found) if grows > FOLDS else None


def mean_fit(model: LPVModel, dataset: Dataset) -> float:
    """Mean over records and outputs of the free-run FIT [percent]."""
    return float(np.mean([s.FIT for s in score(model, dataset, "estimation", ["free-run"])]))


def model_notes(found: Subspace, method: PBSID | N4SID, dataset: Dataset) -> tuple[str, ...]:
    """What a user must know: instability of the model, and bias of a method that closed-loop records deceive."""
    notes = []
    radius = float(np.abs(found.poles).max())
    if radius >= 1.0:
        notes.append(
            f"unstable: its largest pole has modulus {radius:.4g}; long simulations grow without bound, predictions do not"
        )
    if isinstance(method, N4SID):
        closed = [e.name for e in dataset if feedback(e).detected]
        if closed:
            notes.append(f"N4SID is biased in closed loop, and {', '.join(closed)} was recorded in one: use PBSID")
    return tuple(notes)


def _smallest_near_best(tried: Sequence[Candidate]) -> int:
    best = max(c.FIT for c in tried)
    if not np.isfinite(best):
        raise InputError("every order simulates to infinity", mend="name the order, or use an LPV model")
    return min(c.order for c in tried if best - TIE <= c.FIT)


def _order_note(chosen: Subspace, tried: Sequence[Candidate]) -> tuple[str, ...]:
    above = int(np.sum(chosen.singular_values > chosen.noise_level))
    text = f"order {chosen.order}; {above} singular values stand above the noise"
    if tried:
        text += "; free-run FIT on the estimation records by order: " + ", ".join(
            f"{c.order}: {c.FIT:.1f}" if c.FIT > RUNS_AWAY else f"{c.order}: runs away" for c in tried
        )
    return (text,)


# ---- uncertainty ----------------------------------------------------------------------------------------------------


def _estimates(chosen: Subspace, estimate: PredictorEstimate, draws: int) -> tuple[Estimate, ...]:
    """DC gains and the three slowest poles with standard deviations by a fixed-design bootstrap.

    The long predictor's residuals are redrawn on the same past samples; everything after them is repeated at this order.
    """
    value = _features(chosen)
    spread = np.zeros(len(value))
    if draws > 1:
        repeats = []
        for draw in resampled(estimate, draws):
            again = predictor_estimate(estimate.options, draw)
            if again.largest >= chosen.order:
                repeats.append(_features(again.realise(chosen.order)))
        # a pole near 1 makes heavy tails of the gain: quantiles, not moments
        low, high = np.quantile(repeats, [0.1587, 0.8413], axis=0)
        spread = 0.5 * (high - low)
    names = _feature_names(chosen.inputs, chosen.outputs, min(3, chosen.order))
    return tuple(Estimate(name, float(v), float(s), unit=unit) for (name, unit), v, s in zip(names, value, spread, strict=True))


def _feature_names(inputs: Sequence[Channel], outputs: Sequence[Channel], poles: int) -> list[tuple[str, str]]:
    gains = [(f"DC gain {u.name} to {y.name}", _quotient(y.unit, u.unit)) for y in outputs for u in inputs]
    rank = ("slowest", "second slowest", "third slowest")[:poles]
    return gains + [(f"modulus of the {r} pole", "") for r in rank] + [(f"frequency of the {r} pole", "rad/s") for r in rank]


def _quotient(upper: str, lower: str) -> str:
    upper, lower = (f"({unit})" if set(unit) & set("/ ") else unit for unit in (upper, lower))
    return f"{upper or 1}/{lower}" if lower else upper


def _features(found: Subspace) -> np.ndarray:
    rest = np.eye(found.order) - found.A
    rest = rest + 1e-12 * np.eye(found.order)  # an exact integrator gets a huge gain instead of an error
    gain = found.C @ np.linalg.solve(rest, found.B) + found.D
    poles = found.poles[np.argsort(-np.abs(found.poles), kind="stable")][:3]
    return np.concatenate([gain.ravel(), np.abs(poles), np.abs(np.angle(poles)) / found.dt])
