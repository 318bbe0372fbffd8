"""One representation for every identified model: linear parameter-varying state space, expanded in a basis.

    x(k+1) = A(k) x(k) + B(k) (u(k) - u0(rho(k)))
    y(k)   = C(k) x(k) + D(k) (u(k) - u0(rho(k))) + y0(rho(k))
    M(k)   = sum_j M_j phi_j(rho(k - d_j))        for M in A, B, C, D, and the predictor's F, G, K

LTI is one constant term. ILM has block-diagonal A and C weighted by activation functions. SSM uses delayed values of
the schedule, so a term is a basis function together with a delay d_j >= 0 in samples. A schedule that is one of the outputs
is known after the output equation only: `workbench.quasi_lpv` says which value each equation reads then.
"""

import itertools
from collections.abc import Sequence
from functools import reduce
from typing import TYPE_CHECKING, Any

import numpy as np

from workbench.data import SAME_DT, SCHEDULED_OUTPUT, Channel, Experiment
from workbench.errors import InputError, check_known
from workbench.files import read_json, write_json
from workbench.quasi_lpv import linearised, predicted, simulated
from workbench.records import field, record

if TYPE_CHECKING:
    import control

SCHEMA = "gain-scheduling-workbench/lpv-model"
VERSION = 1
MUCH = 0.02  # widths of a schedule range, by which a record may leave it unsaid
FORGOTTEN = 0.01  # of a start: what is left of it counts as nothing
TOLD = 2  # values for each state that is to be told from them
KNOWN = 1e-6  # of the best known direction of a start: what is known less is taken to be 0
CHUNK = 4096  # samples whose scheduled matrices are held at once


@record
class Powers:
    """phi_j(rho) = (rho / scale)^exponent_j; exponents may be negative, then the schedule must not cross zero.

    >>> Powers(np.array([0.0, 1.0, 2.0]), scale=10.0)(np.array([5.0]))
    array([[1.  , 0.5 , 0.25]])
    """

    exponents: np.ndarray = field("m", default=(0.0,))
    scale: float = field("", low=1e-300, default=1.0)

    def __call__(self, rho: np.ndarray) -> np.ndarray:
        return stacked(self, rho)

    def functions(self, rho) -> list:
        """phi_j at a number, an array or a CasADi symbol."""
        return [(rho / self.scale) ** float(e) for e in self.exponents]

    def slopes(self, rho: float) -> list:
        """d phi_j / d rho."""
        return [e / self.scale * (rho / self.scale) ** (e - 1.0) if e else 0.0 for e in self.exponents.tolist()]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple("1" if e == 0 else "rho" if e == 1 else f"rho^{e:g}" for e in self.exponents)


@record
class Gaussian:
    """phi_j(rho) = exp(-beta_j (rho - centre_j)^2); `normalised` divides by their sum, so that they add up to one.

    `with_constant` appends phi = 1, for the matrices of a model that do not move with the schedule.

        >>> np.array(Gaussian(np.array([0.0, 10.0]), beta=np.array([0.1, 0.1]), normalised=True).functions(4.0)).round(2)
        array([0.88, 0.12])
    """

    centres: np.ndarray = field("m")
    beta: np.ndarray = field("m", low=0.0)
    normalised: bool = False
    with_constant: bool = False

    def __call__(self, rho: np.ndarray) -> np.ndarray:
        return stacked(self, rho)

    def functions(self, rho) -> list:
        """phi_j at a number, an array or a CasADi symbol."""
        exponents = [-b * (rho - c) ** 2 for c, b in zip(self.centres, self.beta, strict=True)]
        if self.normalised:
            # far from every centre all of them underflow: the quotient does not when the largest is taken out first
            top = reduce(np.maximum, exponents)
            weights = [np.exp(e - top) for e in exponents]
            total = sum(weights)
            weights = [w / total for w in weights]
        else:
            weights = [np.exp(e) for e in exponents]
        return [*weights, *([0.0 * rho + 1.0] if self.with_constant else [])]

    def slopes(self, rho: float) -> list:
        """d phi_j / d rho."""
        weights = self.functions(rho)[: len(self.centres)]
        rates = [-2.0 * b * (rho - c) for c, b in zip(self.centres, self.beta, strict=True)]
        common = sum(w * r for w, r in zip(weights, rates, strict=True)) if self.normalised else 0.0
        return [*(w * (r - common) for w, r in zip(weights, rates, strict=True)), *([0.0] if self.with_constant else [])]

    @property
    def names(self) -> tuple[str, ...]:
        return (*(f"g({c:.4g})" for c in self.centres), *(("1",) if self.with_constant else ()))


@record
class PiecewiseLinear:
    """phi_j(rho) is 1 at knot_j, 0 at every other knot, linear between, constant outside the first and last knot.

    >>> PiecewiseLinear(np.array([0.0, 5.0, 10.0]))(np.array([2.5]))
    array([[0.5, 0.5, 0. ]])
    """

    knots: np.ndarray = field("m")

    def __post_init__(self):
        if np.any(np.diff(self.knots) <= 0):
            raise InputError("knots must increase")

    def __call__(self, rho: np.ndarray) -> np.ndarray:
        return stacked(self, rho)

    def functions(self, rho) -> list:
        """phi_j at a number, an array or a CasADi symbol."""
        return hats(rho, self.knots)

    def slopes(self, rho: float) -> list:
        """d phi_j / d rho; at a knot towards larger values, at the last one from smaller ones."""
        j = int(np.clip(np.searchsorted(self.knots, rho, side="right"), 1, len(self.knots) - 1))
        rise = 1.0 / (self.knots[j] - self.knots[j - 1]) if self.knots[0] <= rho <= self.knots[-1] else 0.0
        return [-rise if i == j - 1 else rise if i == j else 0.0 for i in range(len(self.knots))]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"hat({k:.4g})" for k in self.knots)


Basis = Powers | Gaussian | PiecewiseLinear


def hats(rho, knots: Any) -> list:
    """The functions of `PiecewiseLinear`, where the knots may be symbols too."""
    inside = np.minimum(np.maximum(rho, knots[0]), knots[-1])
    rise = [(inside - a) / (b - a) for a, b in itertools.pairwise(knots)]
    # each is the lower of the side that leads up to its knot and the side that leads down from it
    up, down = [0.0 * rho + 1.0, *rise], [*(1.0 - r for r in rise), 0.0 * rho + 1.0]
    return [np.maximum(np.minimum(a, b), 0.0) for a, b in zip(up, down, strict=True)]


def stacked(basis: Basis, rho: np.ndarray) -> np.ndarray:
    """phi(rho), (..., m)."""
    return np.stack(basis.functions(np.asarray(rho, dtype=float)), axis=-1)


BASES: dict[str, type] = {"powers": Powers, "gaussian": Gaussian, "piecewise-linear": PiecewiseLinear}
CONSTANT = Powers()


@record
class Term:
    """phi_j(rho(k - delay)): one basis function at one delay in samples."""

    function: int
    delay: int = 0


@record
class OperatingPoint:
    """u0(rho) = sum_j u_j phi_j(rho), y0 likewise: the signals around which the model's deviations are taken."""

    basis: Basis = field()
    u: np.ndarray = field("m nu")
    y: np.ndarray = field("m ny")


@record
class Predictor:
    """x(k+1) = F x(k) + G (u - u0) + K (y - y0): the one-step predictor that belongs to a model; F, G, K by term."""

    F: np.ndarray = field("nt nx nx")
    G: np.ndarray = field("nt nx nu")
    K: np.ndarray = field("nt nx ny")
    warmup: int = 20  # samples after which the predictor has forgotten its initial state
    free_start: bool = False  # a free run begins where it errs least itself in the warm-up, not where the predictor has led


@record
class Estimate:
    """One estimated quantity with its standard deviation and, where a bound on the noise is known, its interval."""

    name: str
    value: float = field("")
    std: float = field("", low=0.0)
    low: float | None = None
    high: float | None = None
    unit: str = ""


@record
class Stability:
    """Largest spectral radius of A over the schedule range, and the schedule value where it occurs.

    Of the frozen A; where the schedule is an output, of the linearisations about the equilibria. unknown: schedule values of
    the grid without an equilibrium; where there is none at all the radius is NaN, and nothing is known to be stable.
    """

    radius: float
    at: float
    unknown: tuple[float, ...] = ()

    @property
    def stable(self) -> bool:
        return self.radius < 1.0


@record
class LPVModel:
    """x+ = A(rho) x + B(rho) u, y = C(rho) x + D(rho) u in deviations from the operating point.

    Shapes: A (nt, nx, nx), B (nt, nx, nu), C (nt, ny, nx), D (nt, ny, nu), one slice per term. `span` is the schedule
    range [low, high] of the estimation records; outside it the model holds the edge value of its basis functions.
    A schedule with the role "scheduled output" is the output of its name: free runs and predictions schedule themselves from
    where measurements end, and `to_control` and `stability` are of the true linearisation; see `workbench.quasi_lpv`.

        >>> model.to_control(0.0).poles().round(3), model.to_control(10.0).poles().round(3)
        (array([0.94+0.j]), array([0.885+0.j]))
        >>> model.simulate(held_out.experiments[0]).shape  # free run, the samples before its warm-up NaN
        (600, 1)
    """

    name: str
    dt: float = field("", unit="s", low=0.0)
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    schedule: Channel | None
    span: np.ndarray = field("2")
    basis: Basis = field()
    terms: tuple[Term, ...]
    A: np.ndarray = field("nt nx nx")
    B: np.ndarray = field("nt nx nu")
    C: np.ndarray = field("nt ny nx")
    D: np.ndarray = field("nt ny nu")
    operating_point: OperatingPoint = field()
    predictor: Predictor | None = None
    noise: np.ndarray | None = None  # (ny, ny) covariance of the one-step prediction error
    estimates: tuple[Estimate, ...] = ()
    trained_on: tuple[str, ...] = ()  # fingerprints of the estimation records
    notes: tuple[str, ...] = ()  # what a user must know before using the model, in plain words

    def __post_init__(self):
        for term in self.terms:
            if not 0 <= term.function < len(self.basis.names) or term.delay < 0:
                raise InputError(f"no function {term.function} or delay {term.delay} in this basis", file=self.name)
        if len(self.terms) != self.A.shape[0]:
            raise InputError(f"{len(self.terms)} terms for {self.A.shape[0]} matrices", file=self.name)
        if len(self.inputs) != self.B.shape[2] or len(self.outputs) != self.C.shape[1]:
            raise InputError("channel lists do not match B and C", file=self.name)
        if self.schedule and self.schedule.role == SCHEDULED_OUTPUT and self.schedule.name not in [c.name for c in self.outputs]:
            mend = "name it among the outputs, or give it the role schedule"
            raise InputError("is a scheduled output and no output", file=self.name, channel=self.schedule.name, mend=mend)

    @property
    def warmup(self) -> int:
        """Samples after which the predictor has forgotten its initial state: rows before that are never scored."""
        return self.predictor.warmup if self.predictor else 0

    @property
    def order(self) -> int:
        return self.A.shape[1]

    # ---- the schedule -------------------------------------------------------------------------------------------

    @property
    def scheduled_output(self) -> int | None:
        """Which output the schedule is by its role; None for a schedule from outside."""
        if self.schedule is None or self.schedule.role != SCHEDULED_OUTPUT:
            return None
        return [c.name for c in self.outputs].index(self.schedule.name)

    def schedule_of(self, experiment: Experiment) -> np.ndarray:
        """rho(k), (N,), clipped to the model's span; zeros for a model without schedule."""
        if self.schedule is None:
            return np.zeros(len(experiment))
        return np.clip(experiment[self.schedule.name], *self.span)

    def outside(self, rho: np.ndarray) -> float:
        """How far the schedule leaves the model's span, in widths of the span: 0 inside, NaN where rho is not a number."""
        width = (self.span[1] - self.span[0]) or 1.0
        return float(np.max(np.maximum(self.span[0] - rho, rho - self.span[1]), initial=0.0) / width)

    def weights(self, rho: np.ndarray, newest: int = 0) -> np.ndarray:
        """phi_j(rho(k - d_j)), (N, nt), no delay below `newest`; before the first sample the schedule holds its first value."""
        phi = self.basis(rho)
        late = np.arange(len(rho))[:, None] - np.maximum([term.delay for term in self.terms], newest)
        return phi[np.maximum(late, 0), [term.function for term in self.terms]]

    def freeze(self, rho: float | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A, B, C, D at a constant schedule value; a model without schedule needs none.

        Where the schedule is an output these leave out what it answers to the state: `linearise` has that.
        Raises InputError outside the span of the estimation records: nobody knows the machine there.
        """
        if self.schedule is None:
            rho = 0.0
        elif rho is None or not self.outside(np.array([rho])) <= 0.01:
            unit = f" {self.schedule.unit}".rstrip()
            raise InputError(
                f"{self.schedule.name} = {'(none given)' if rho is None else f'{rho:g}{unit}'}",
                file=self.name,
                mend=f"the model knows {self.schedule.name} from {self.span[0]:g} to {self.span[1]:g}{unit}",
            )
        weight = self.weights(np.array([np.clip(rho, *self.span)]))[0]
        return tuple(np.tensordot(weight, M, 1) for M in (self.A, self.B, self.C, self.D))  # type: ignore[return-value]

    def linearise(self, rho: float | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A, B, C, D of small motions at a schedule value: those of `freeze`, or where the schedule is an output those about the
        equilibrium at which that output is rho.

        Raises InputError outside the span of the estimation records, and where there is no equilibrium.
        """
        frozen = self.freeze(rho)
        return frozen if self.scheduled_output is None or rho is None else linearised(self, rho)

    def to_control(self, rho: float | None = None, *, frozen: bool = False) -> "control.StateSpace":
        """Small motions at a schedule value as a discrete python-control system with our channel names; see `linearise`.

        frozen: with a schedule that stands still even where it is an output.
        """
        import control  # takes a second to import, and only this needs it

        return control.StateSpace(
            *(self.freeze(rho) if frozen else self.linearise(rho)),
            self.dt,
            name=(self.name if self.schedule is None else f"{self.name} at {rho:g}").replace(".", "_"),  # it refuses dots
            inputs=[c.name for c in self.inputs],
            outputs=[c.name for c in self.outputs],
        )

    def stability(self, points: int = 101) -> Stability:
        """Spectral radius of A on a grid over the span; see `Stability`."""
        found, unknown = {}, []
        for rho in np.linspace(self.span[0], self.span[1], points).tolist():
            try:
                found[rho] = float(np.abs(np.linalg.eigvals(self.linearise(rho)[0])).max(initial=0.0))
            except InputError:  # no equilibrium
                unknown.append(rho)
        worst = max(found, key=lambda rho: found[rho], default=np.nan)
        return Stability(found.get(worst, np.nan), worst, tuple(unknown))

    # ---- simulation and prediction -----------------------------------------------------------------------------------

    def simulate(self, experiment: Experiment, *, warmup: int | None = None) -> np.ndarray:
        """Free run: the outputs (N, ny) from the measured inputs and schedule alone.

        A schedule that is an output is the model's own from where the measured ones end, so that none of them leaks in.
        The initial state comes from the first `warmup` samples: the predictor follows the measured outputs for so long
        and is then cut off. Rows before that are predictions, not simulation; score only rows from `warmup` on.
        Default: the predictor's own memory; 0 starts from the operating point.
        """
        u, y, weight, seen = self.deviations(experiment)
        n = self.warmup if warmup is None else warmup
        free = self.predictor is not None and self.predictor.free_start
        x = self._states(u[:n], y[:n], weight[:n], seen[:n], free=free)
        if self.scheduled_output is not None:
            return simulated(self, experiment, x)
        out = np.empty((len(u), len(self.outputs)))
        state = x[-1]
        for k0, A, B, C, D in self._slices(weight, self.A, self.B, self.C, self.D):
            for i in range(len(A)):
                k = k0 + i
                if k < n:
                    out[k] = C[i] @ x[k] + D[i] @ u[k]
                    continue
                out[k] = C[i] @ state + D[i] @ u[k]
                state = A[i] @ state + B[i] @ u[k]
        return out + self._output_offset(experiment)

    def predict(self, experiment: Experiment, steps: int = 1) -> np.ndarray:
        """y(k | k - steps): from the predictor's state at k - steps + 1 and the inputs since; (N, ny).

        steps = 1 uses the measured outputs up to k - 1. So does a schedule that is an output, and after them it is the model's
        own. No prediction starts before the predictor's warm-up is over: the steps - 1 rows after it look ahead less far, and
        the rows within it are one-step predictions of a cold predictor.
        """
        u, y, weight, seen = self.deviations(experiment)
        states = self._states(u, y, weight, seen[: self.warmup])[:-1]
        if self.scheduled_output is not None:
            return predicted(self, experiment, states, steps)
        N, first = len(u), self.warmup
        out = np.empty((N, len(self.outputs)))
        for begin in range(0, N, CHUNK):
            x = states[begin : begin + CHUNK]
            stop = min(begin + len(x) + steps - 1, N)
            A, B, C, D = (np.tensordot(weight[begin:stop], M, 1) for M in (self.A, self.B, self.C, self.D))
            for ahead in range(steps):
                x = x[: stop - begin - ahead]
                start = begin + np.arange(len(x))  # row i holds the state at start[i] + ahead, predicted from start[i]
                at = np.arange(len(x)) + ahead
                # a start before the warm-up's end looks one step ahead, the one at its end fills up to the full horizon
                wanted = (start == first) | ((start > first) & (ahead == steps - 1)) | ((start < first) & (ahead == 0))
                k = at[wanted]
                out[begin + k] = np.einsum("kyx,kx->ky", C[k], x[wanted]) + np.einsum("kyu,ku->ky", D[k], u[begin + k])
                x = np.einsum("kzx,kx->kz", A[at], x) + np.einsum("kzu,ku->kz", B[at], u[begin + at])
        return out + self._output_offset(experiment)

    def deviations(self, experiment: Experiment) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """u (N, nu) and y (N, ny) of a record without their operating point, and the weights (N, nt) of the terms.

        Twice: in the state and in the output equation, which reads a schedule that is an output one sample later.
        """
        if abs(experiment.dt - self.dt) > SAME_DT * self.dt:
            raise InputError(
                f"sample time {experiment.dt:g} s, the model has {self.dt:g} s",
                file=experiment.name,
                mend="resample the record",
            )
        rho, late = self.schedule_of(experiment), 0 if self.scheduled_output is None else 1
        phi = self.operating_point.basis(rho)
        u = experiment[[c.name for c in self.inputs]] - phi @ self.operating_point.u
        y = experiment[[c.name for c in self.outputs]] - phi[np.maximum(np.arange(len(rho)) - late, 0)] @ self.operating_point.y
        weight = self.weights(rho)
        return u, y, weight, self.weights(rho, newest=1) if late else weight

    def _output_offset(self, experiment: Experiment) -> np.ndarray:
        return self.operating_point.basis(self.schedule_of(experiment)) @ self.operating_point.y

    def _slices(self, weight: np.ndarray, *matrices: np.ndarray):
        """Scheduled matrices M(k) for chunks of samples, so that long records do not fill the memory."""
        for k0 in range(0, len(weight), CHUNK):
            w = weight[k0 : k0 + CHUNK]
            yield k0, *(np.tensordot(w, M, 1) for M in matrices)

    def _states(self, u: np.ndarray, y: np.ndarray, weight: np.ndarray, seen: np.ndarray, *, free: bool = False) -> np.ndarray:
        """States (N + 1, nx) of the one-step predictor, row k has seen y(0..k-1); free: of a free run.

        From the start under which it errs least on the first samples, whose weights in the output equation are `seen` (n, nt);
        from zero where these suffice to forget it.
        """
        own = self.predictor
        if own is None:
            if len(u):
                raise InputError("this model has no predictor, so it cannot follow measured outputs", file=self.name)
            return np.zeros((1, self.order))
        F, G, K = (self.A, self.B, np.zeros_like(own.K)) if free else (own.F, own.G, own.K)
        x = self._led(F, G, K, u, y, weight, np.zeros(self.order))
        first = len(seen)
        start = self._start(F, u[:first], y[:first], weight[:first], seen, x[:first])
        return x if start is None else self._led(F, G, K, u, y, weight, start)

    def _led(self, F, G, K, u: np.ndarray, y: np.ndarray, weight: np.ndarray, start: np.ndarray) -> np.ndarray:
        """x(k+1) = F x + G u + K y from `start`, (N + 1, nx); F, G, K by term."""
        x = np.zeros((len(u) + 1, self.order))
        x[0] = start
        for k0, A, B, L in self._slices(weight, F, G, K):
            for i in range(len(A)):
                k = k0 + i
                x[k + 1] = A[i] @ x[k] + B[i] @ u[k] + L[i] @ y[k]
        return x

    def _start(self, F, u: np.ndarray, y: np.ndarray, weight: np.ndarray, seen: np.ndarray, x: np.ndarray) -> np.ndarray | None:
        """The start that lowers the errors most of a run x (n, nx) that began at zero.

        None where the run has forgotten it, or where so few samples tell more of the noise than of a start.
        """
        left = [np.eye(self.order)]  # of a start after k samples: F(k-1) .. F(0)
        for _, own in self._slices(weight, F):
            for step in own:
                left.append(step @ left[-1])
        if y.size < TOLD * self.order or np.abs(left[-1]).max(initial=0.0) <= FORGOTTEN:
            return None
        C, D = np.tensordot(seen, self.C, 1), np.tensordot(seen, self.D, 1)
        e = y - np.einsum("kyx,kx->ky", C, x) - np.einsum("kyu,ku->ky", D, u)
        return np.linalg.lstsq(np.concatenate(C @ np.stack(left[:-1])), e.ravel(), rcond=KNOWN)[0]

    # ---- files ------------------------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, readable without the package; one entry per term."""
        return {
            "schema": SCHEMA,
            "version": VERSION,
            "name": self.name,
            "dt": self.dt,
            "inputs": [vars(c) for c in self.inputs],
            "outputs": [vars(c) for c in self.outputs],
            "schedule": vars(self.schedule) if self.schedule else None,
            "span": self.span,
            "basis": basis_to_dict(self.basis),
            "operating_point": {
                "basis": basis_to_dict(self.operating_point.basis),
                "u": self.operating_point.u,
                "y": self.operating_point.y,
            },
            "predictor_warmup": self.predictor.warmup if self.predictor else None,
            "predictor_free_start": bool(self.predictor and self.predictor.free_start),
            "terms": [
                {"function": term.function, "name": self.basis.names[term.function], "delay": term.delay}
                | {key: M[j] for key, M in self._matrices().items()}
                for j, term in enumerate(self.terms)
            ],
            "noise": self.noise,
            "estimates": [vars(e) for e in self.estimates],
            "trained_on": list(self.trained_on),
            "notes": list(self.notes),
        }

    def _matrices(self) -> dict[str, np.ndarray]:
        own = {"A": self.A, "B": self.B, "C": self.C, "D": self.D}
        return own | ({"F": self.predictor.F, "G": self.predictor.G, "K": self.predictor.K} if self.predictor else {})

    def save(self, path) -> None:
        """Write the model as JSON (schema and version inside)."""
        write_json(path, self.to_dict())


def check_no_feedthrough(model: LPVModel) -> None:
    """Refuse a model whose outputs see the command of their own sample: a law commands after it has measured, and holds."""
    if np.any(model.D):
        mend = "workbench identify --no-feedthrough: a held command cannot do that"
        raise InputError("its outputs see the command of their own sample", file=model.name, mend=mend)


def check_schedule_from_outside(model: LPVModel, task: str) -> None:
    """Refuse a model whose schedule is an output for a task that would take its frozen matrices, or a signal from outside."""
    if model.scheduled_output is not None and model.schedule is not None:
        raise InputError(
            f"{model.schedule.name} is schedule and output of this model, and {task} takes a schedule for a signal from outside",
            file=model.name,
            mend="identify with --schedule none, or with another schedule; to_control(rho) has the linearisation about a point",
        )


def load_model(path) -> LPVModel:
    """Read a model file written by `LPVModel.save`; what is missing or foreign is named.

    Raises InputError for a file that is none.

        >>> model.save("ssm.json")
        >>> load_model("ssm.json").schedule
        Channel(name='way', unit='mm', role='schedule')
    """
    content = read_json(path)
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        interval = isinstance(content, dict) and content.get("schema") == "interval-model"
        mend = "read it with load_interval_model" if interval else f"expected a JSON object with schema {SCHEMA!r}"
        raise InputError("not an LPV model", file=path, mend=mend)
    if content.get("version") != VERSION:
        raise InputError(f"model version {content.get('version')}, this program reads {VERSION}", file=path)
    try:
        return model_from_dict(content)
    except KeyError as reason:
        raise InputError(f"field {reason.args[0]!r} is missing", file=path, mend="write the model again") from None
    except (TypeError, ValueError, OverflowError) as reason:
        raise InputError(f"malformed model: {reason}", file=path, mend="write the model again") from None


def model_from_dict(content: dict[str, Any]) -> LPVModel:
    """The model that `LPVModel.to_dict` wrote."""
    basis = basis_from_dict(content["basis"])
    terms = content["terms"]
    stacked = {key: np.array([term[key] for term in terms], dtype=float) for key in "ABCD"}
    warmup = content["predictor_warmup"]
    predictor = None
    if warmup is not None:
        F, G, K = (np.array([term[key] for term in terms]) for key in "FGK")
        predictor = Predictor(F, G, K, warmup, content.get("predictor_free_start", False))
    point = content["operating_point"]
    return LPVModel(
        name=content["name"],
        dt=content["dt"],
        inputs=tuple(Channel(**c) for c in content["inputs"]),
        outputs=tuple(Channel(**c) for c in content["outputs"]),
        schedule=Channel(**content["schedule"]) if content["schedule"] else None,
        span=content["span"],
        basis=basis,
        terms=tuple(Term(int(term["function"]), int(term["delay"])) for term in terms),
        operating_point=OperatingPoint(basis_from_dict(point["basis"]), point["u"], point["y"]),
        predictor=predictor,
        noise=None if content["noise"] is None else np.array(content["noise"]),
        estimates=tuple(Estimate(**e) for e in content["estimates"]),
        trained_on=tuple(content.get("trained_on", ())),
        notes=tuple(content["notes"]),
        **stacked,
    )


def basis_to_dict(basis: Basis) -> dict[str, Any]:
    """Plain numbers, with the basis' kind."""
    kind = next(kind for kind, cls in BASES.items() if isinstance(basis, cls))
    return {"kind": kind} | vars(basis)


def basis_from_dict(content: dict[str, Any]) -> Basis:
    """The basis that `basis_to_dict` wrote."""
    options = dict(content)
    return BASES[check_known("basis", options.pop("kind"), BASES)](**options)


def constant_model(
    name: str,
    dt: float,
    channels: tuple[Sequence[Channel], Sequence[Channel]],
    matrices: Sequence[np.ndarray],
    operating_point: OperatingPoint,
    **rest,
) -> LPVModel:
    """An LTI model (A, B, C, D) as an LPV model with one constant term."""
    A, B, C, D = (np.asarray(M)[None] for M in matrices)
    return LPVModel(
        name, dt, tuple(channels[0]), tuple(channels[1]), None, np.zeros(2), CONSTANT, (Term(0),), A, B, C, D,
        operating_point, **rest,
    )  # fmt: skip
