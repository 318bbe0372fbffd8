"""LPV state-space models by the error of their free runs, from an LTI start.

    x(k+1) = A(rho) x + B(rho) (u - u0) + share K e,   y = C(rho) x + D(rho) (u - u0) + y0 + e,   A .. D = sum_j M_j phi_j(rho)

All entries of all M_j are free; of the start only those of the constant function are not 0. The run is held by the measured
outputs at first, share = 1, and less and less until it is free: from so poor a start a free run would be lost. Order and degree
are those whose model of three fifths of every record runs best on the other two. Where the schedule is an output, C and D stay.

V. Verdult, "Nonlinear System Identification: A State-Space Approach", PhD thesis, Twente (2002), chapter 6.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.basis import Basis, Powers, Products, constant, polynomials, unity
from workbench.data import Dataset
from workbench.errors import InputError
from workbench.identification.feedthrough import acts_at_once
from workbench.identification.output_error.fence import Fence
from workbench.identification.output_error.free_numbers import FreeNumbers, constant_weights
from workbench.identification.output_error.method import OutputError
from workbench.identification.output_error.refine import SHARES, Runs, finished, minimised, stable
from workbench.identification.schedules import check_variables, polynomials_over, schedules_of, spans_of
from workbench.identification.selection import parts
from workbench.identification.subspace import PBSID, PredictorEstimate, channels_of
from workbench.lpv import LPVModel, OperatingPoint, Predictor, Term
from workbench.quasi_lpv import coupling_notes
from workbench.records import field, record

WORTH = 0.98  # of the error on what was left out: what one more order, or degree, must do
HELD, FREE = 1e-3, 1e-6  # share of the cost that a step must gain, of runs that are held and of free ones
# of a span: how far beyond the records a model of several variables is followed if it is stable there
REACHES = (0.25, 0.15, 0.1, 0.05)
HIGHEST = 5  # degree of polynomials whose special cases are begun from
AWAY = 1e-3  # modulus of a pole
CHARGES = (1.0, 100.0, 1e4)  # of what poles beyond the limit cost at first
STEPS = 100
ENOUGH, PIECE = 10_000, 2500  # samples from which order and degree are chosen; of a piece of a long record
LESS = (0.0, 0.001, 0.01, 0.03)  # shares of what moves A over the schedule
PATIENCE = 2  # orders in a row that do not


@record
class LPVOutputError:
    """x+ = A(rho) x + B(rho) u, y = C(rho) x + D(rho) u, matrices linear in functions of the schedule, fitted to free runs.

    order: states; None takes one of `orders` by parts of the records that the model was not fitted to. degree: of the polynomials
    in the schedule variables, 1 is affine; None takes 1 or 2 in the same way. basis: other functions in their place, among which
    the constant. feedthrough: estimate D; None where the records show that inputs act within the sample.

        >>> LPVOutputError(order=1, degree=1).fit(data).to_control(10.0).poles().round(2)
        array([0.88+0.j])
    """

    order: int | None = None
    degree: int | None = None
    basis: Basis | None = None
    orders: Sequence[int] = tuple(range(1, 7))
    method: PBSID = field(default=PBSID())
    feedthrough: bool | None = None
    name: str = "LPV-OE"

    def __post_init__(self):
        for n in (*self.orders, *(() if self.order is None else (self.order,))):
            if n != int(n) or n < 1:
                raise InputError(f"order {n}", mend="an order is a whole number of states, at least 1")
        if self.degree is not None and (self.degree != int(self.degree) or self.degree < 1):
            raise InputError(f"degree {self.degree}", mend="1 is affine in the schedule, 2 quadratic")

    def fit(self, dataset: Dataset) -> LPVModel:
        """The model of all records together.

        Raises InputError for records without input, output or schedule, and where no stable model is found.
        """
        task, short = _Task(self, dataset), _shortened(dataset)
        chosen, notes = self._chosen(self._bases(task), short)
        own = task.freed(chosen)
        if short is dataset or own is None:  # from another start there may be another minimum
            own = min(own, task.fitted(chosen.model.order, chosen.model.basis), key=task.cost)
        model = own and finished(own, task.runs(own.model), dataset)
        if model is None:
            mend = "ask for a lower order or degree, or take another method"
            raise InputError("no stable model was found", file=", ".join(dataset.names), mend=mend)
        if model.scheduled_output is not None:
            notes += coupling_notes(model)
        return replace(model, notes=notes, trained_on=dataset.fingerprints)

    @property
    def _orders(self) -> tuple[int, ...]:
        return tuple(self.orders) if self.order is None else (self.order,)

    def _bases(self, task: "_Task") -> list[Basis]:
        if self.basis is not None:
            check_variables(self.basis, task.schedules)
            own = unity(self.basis)
            if any(c.has_role("output") for c in task.schedules) and (own is None or np.count_nonzero(own) != 1):
                mend = "give one in which it is a function of its own, such as Powers([0, 1, 2]): the output equation stays still"
                raise InputError("a basis without the constant 1, for a schedule that is an output", mend=mend)
            return [self.basis]
        return [polynomials_over(task.spans, d) for d in ((1, 2) if self.degree is None else (self.degree,))]

    def _chosen(self, bases: Sequence[Basis], dataset: Dataset) -> tuple[FreeNumbers, tuple[str, ...]]:
        """The model of three fifths of the records that runs best on the other two; and what each that was tried came to.

        What lies beyond the range of those does not count: there every model guesses, and that of all records need not.
        """
        seen, unseen = parts(dataset)
        task = _Task(self, seen, unseen)
        best, least, said = None, np.inf, []
        for basis in bases:
            failed = 0
            for n in self._orders:
                own = task.fitted(n, basis)
                missed = task.judged(own)
                told = f"{100.0 * missed:.3g} %" if missed < 10.0 else "runs away"
                said.append(f"order {n}, {len(basis.names)} functions: {told}")
                if missed < WORTH * least:
                    best, least, failed = own, missed, 0
                elif (failed := failed + 1) >= PATIENCE:
                    break
        if best is None:
            mend = "ask for lower orders, or take another method"
            raise InputError("no stable model was found", file=", ".join(dataset.names), mend=mend)
        return best, (f"error of free runs on two fifths of the records, by what was tried: {'; '.join(said)}",)


class _Task:
    """Records with the long predictor that all starts come from.

    unseen: records by which the models from several starts are judged; None judges them by those that they are fitted to.
    """

    def __init__(self, options: LPVOutputError, dataset: Dataset, unseen: Dataset | None = None):
        first = dataset.experiments[0]
        self.options, self.dataset, self.unseen, self.channels = options, dataset, unseen, channels_of(first)
        self.schedules = schedules_of(first)
        if not self.schedules:
            raise InputError("no schedule channel", file=first.name, mend="name one, or take LTI")
        self.spans = spans_of(dataset, self.schedules)
        direct = acts_at_once(dataset) if options.feedthrough is None else options.feedthrough
        self.made: dict[tuple[int, tuple[str, ...]], FreeNumbers | None] = {}
        self.start: PredictorEstimate = replace(options.method, feedthrough=direct).estimate(dataset)

    def runs(self, model: LPVModel) -> Runs:
        return Runs(model, self.dataset)

    def fitted(self, order: int, basis: Basis) -> FreeNumbers | None:
        """The model of an order, with its free numbers; None where the records show fewer states, or where it is not stable.

        Begun at the linear model, and at its special cases where the first one runs worse than these: a model with a state less,
        and one of the next lower degree, down to the linear one by its free runs.
        """
        if order > self.start.largest:
            return None
        key = (order, basis.names)
        if key not in self.made:
            starts = [
                self._held(self._begun(order, basis)),
                *(self._first_guesses(order, basis) if len(basis.names) == 1 else ()),
            ]
            own = min(map(self.freed, starts), key=self.judged)
            smaller = self.fitted(order - 1, basis) if order > 1 else None
            flatter = self.fitted(order, low) if (low := lower(basis)) else None
            for less, widen in ((smaller, widened), (flatter, lambda model: bent(model, basis))):
                if less is not None and not self.judged(own) < self.judged(less):
                    larger = FreeNumbers.all_of(widen(less.model), direct=bool(self.start.options.feedthrough))
                    own = min(own, self.freed(larger), key=self.judged)
            self.made[key] = own
        return self.made[key]

    def _first_guesses(self, order: int, basis: Basis) -> list[FreeNumbers]:
        """Linear models of one or two poles for each output whose grid of poles has few minima."""
        poles, rest = divmod(order, len(self.channels[1]))
        if rest or poles not in (1, 2):
            return []
        try:
            found = OutputError(order=poles, delays=False).fit(self.dataset)
        except InputError:
            return []
        matrices = found.A[0], found.B[0], found.C[0], found.D[0], np.zeros((order, len(found.outputs)))
        model = self._over(basis, matrices, found.operating_point.u, found.operating_point.y, order + 1)
        return [FreeNumbers.all_of(model, direct=bool(self.start.options.feedthrough))]

    def judged(self, own: FreeNumbers | None) -> float:
        """Errors of free runs, of what was fitted or of what was not; inf without a model."""
        if own is None or self.unseen is None:
            return self.cost(own)
        return Runs(own.model, self.unseen, inside=True).missed(own.model)

    def cost(self, own: FreeNumbers | None) -> float:
        """Squared errors of the free runs; inf without a model."""
        if own is None:
            return np.inf
        runs = self.runs(own.model)
        return runs.cost(own.model, runs.begun(own, 0.0), 0.0)

    def _held(self, model: LPVModel) -> FreeNumbers:
        """The model with all its numbers fitted to runs that the measured outputs hold less and less."""
        own, runs = FreeNumbers.all_of(model, direct=bool(self.start.options.feedthrough)), self.runs(model)
        for share in SHARES:
            own = minimised(own, runs, share, HELD, STEPS)
        return own

    def freed(self, own: FreeNumbers) -> FreeNumbers | None:
        """The model at the minimum of its free runs along these records, at worst as it is; None where it is not stable there.

        Poles that are `AWAY` beyond the limit cost as much as all errors of the runs do at first, and more while that holds none.
        """
        begun = own = replace(own, model=replace(own.model, spans=self.spans, reach=0.0))
        runs = self.runs(own.model)
        charge = runs.cost(own.model, runs.begun(own, 0.0), 0.0) / AWAY**2
        for dearer in CHARGES:
            own = minimised(own, runs, 0.0, FREE, STEPS, Fence(own.model, runs.slowest, dearer * charge))
            if stable(own.model):
                break
        best = min((one for one in (tamed(own), begun) if stable(one.model)), key=self.cost, default=None)
        return best and replace(best, model=reaching(best.model))

    def _begun(self, order: int, basis: Basis) -> LPVModel:
        """The LTI model over the basis."""
        found = self.start.realise(order)
        matrices = found.A, found.B, found.C, found.D, found.K
        return self._over(basis, matrices, found.u0[None], found.y0[None], max(found.past, order + 1))

    def _over(self, basis: Basis, matrices: Sequence[np.ndarray], u0: np.ndarray, y0: np.ndarray, warmup: int) -> LPVModel:
        """A model over the basis whose matrices A, B, C, D, K do not move, about u0 (1, nu), y0 (1, ny)."""
        weight = unity(basis)
        if weight is None:
            raise InputError("a basis without the constant 1", mend="give one that holds it, such as Powers([0, 1])")
        gain = matrices[-1]
        A, B, C, D, K = (weight[:, None, None] * M for M in matrices)
        return LPVModel(
            self.options.name, self.dataset.dt, *self.channels, self.schedules, self.spans, basis,
            tuple(Term(j) for j in range(len(weight))), A, B, C, D, OperatingPoint(constant(len(self.schedules)), u0, y0),
            Predictor(A - gain @ C, B - gain @ D, K, warmup=warmup),
        )  # fmt: skip


def widened(model: LPVModel) -> LPVModel:
    """The model with one state more, which the inputs move and no output shows: a fit finds what it is good for."""
    weight, predictor = constant_weights(model)[:, None, None], model.predictor
    assert predictor is not None
    A, F = (np.pad(M, ((0, 0), (0, 1), (0, 1))) for M in (model.A, predictor.F))
    B, G, K = (np.pad(M, ((0, 0), (0, 1), (0, 0))) for M in (model.B, predictor.G, predictor.K))
    # as slow as the others are, and moved as much
    A[:, -1:, -1:] = F[:, -1:, -1:] = weight * np.median(np.abs(np.linalg.eigvals(model.freeze(model.middle)[0])))
    B[:, -1:] = G[:, -1:] = weight * np.abs(model.B).max(axis=(0, 1))
    C = np.pad(model.C, ((0, 0), (0, 0), (0, 1)))
    return replace(model, A=A, B=B, C=C, predictor=replace(predictor, F=F, G=G, K=K))


def lower(basis: Basis) -> Basis | None:
    """The polynomials of the next lower degree in the same units; None of another basis, and of the constant."""
    if isinstance(basis, Powers):
        whole = np.array_equal(basis.exponents, np.arange(len(basis.exponents)))
        return Powers(basis.exponents[:-1], basis.scale) if whole and len(basis.exponents) > 1 else None
    if not isinstance(basis, Products):
        return None
    factors = [own for own in basis.factors if isinstance(own, Powers)]
    scales = np.array([own.scale for own in factors])
    alike = (d for d in range(1, HIGHEST + 1) if polynomials(d, scales).names == basis.names)
    degree = next(alike, None) if len(factors) == len(basis.factors) else None
    return polynomials(degree - 1, scales) if degree else None


def bent(model: LPVModel, basis: Basis) -> LPVModel:
    """The model over more functions of the schedule, the further ones 0."""
    own = [basis.names.index(name) for name in model.basis.names]

    def spread(M: np.ndarray) -> np.ndarray:
        wide = np.zeros((len(basis.names), *M.shape[1:]))
        wide[own] = M
        return wide

    predictor = model.predictor
    assert predictor is not None
    F, G, K = map(spread, (predictor.F, predictor.G, predictor.K))
    A, B, C, D = map(spread, (model.A, model.B, model.C, model.D))
    terms = tuple(Term(j) for j in range(len(basis.names)))
    return replace(
        model, basis=basis, terms=terms, A=A, B=B, C=C, D=D, predictor=replace(predictor, F=F, G=G, K=K)
    )  # fmt: skip


def tamed(own: FreeNumbers) -> FreeNumbers:
    """The model with the least share LESS of what moves A over the schedule taken away for it to be stable."""
    model = own.model
    still, predictor = constant_weights(model)[:, None, None] * model.freeze(model.middle)[0], model.predictor
    assert predictor is not None
    for less in LESS:
        A = still + (1.0 - less) * (model.A - still)
        if stable(tried := replace(model, A=A, predictor=replace(predictor, F=A + predictor.F - model.A))):
            return replace(own, model=tried)
    return own


def reaching(model: LPVModel) -> LPVModel:
    """The model, followed beyond the spans as far as it is stable there; of one schedule variable it holds its edge values.

    Several variables seldom leave a box together: where one of them is clipped, what the others say is lost with it.
    """
    if len(model.schedules) < 2:
        return model
    return next((own for share in REACHES if stable(own := replace(model, reach=share))), model)


def _shortened(dataset: Dataset) -> Dataset:
    """ENOUGH samples of all records together, which an order and a degree need no more of: some of the short ones, whole, and
    pieces that are spread over each long one, for a schedule may drift through it.
    """
    share = ENOUGH / sum(map(len, dataset))
    if share >= 1.0:
        return dataset
    found = [e for e in dataset if len(e) <= PIECE][:: int(np.ceil(1.0 / share))]
    for e in (e for e in dataset if len(e) > PIECE):
        count = max(1, round(share * len(e) / PIECE))
        for begin in np.linspace(0, len(e) - PIECE, count).astype(int) if count > 1 else [(len(e) - PIECE) // 2]:
            piece = e.trim(e.t[begin], e.t[begin + PIECE] if begin + PIECE < len(e) else np.inf)
            found.append(replace(piece, name=f"{e.name} from sample {begin}"))
    return Dataset(tuple(found))
