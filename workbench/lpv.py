"""One representation for every identified model: linear parameter-varying state space, expanded in a basis.

    x(k+1) = A(k) x(k) + B(k) (u(k) - u0(rho(k)))
    y(k)   = C(k) x(k) + D(k) (u(k) - u0(rho(k))) + y0(rho(k))
    M(k)   = sum_j M_j phi_j(rho(k - d_j))        for M in A, B, C, D, and the predictor's F, G, K

LTI is one constant term. ILM has block-diagonal A and C weighted by activation functions. SSM uses delayed values of
the schedule, so a term is a basis function together with a delay d_j >= 0 in samples. The schedule rho is a number, or several:
then the last axis of every rho is the variables. A schedule that is one of the outputs is known after the output equation only:
`workbench.quasi_lpv` says which value each equation reads then.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from workbench.basis import CONSTANT, Basis, basis_from_dict, basis_to_dict
from workbench.data import SAME_DT, SCHEDULED_OUTPUT, Channel, Experiment
from workbench.errors import InputError
from workbench.files import read_json, write_json
from workbench.quasi_lpv import linearised, predicted, simulated
from workbench.records import field, record
from workbench.steady import integrates
from workbench.units import check_units

if TYPE_CHECKING:
    import control

SCHEMA = "gain-scheduling-workbench/lpv-model"
VERSION = 1
OTHERS: dict[str, str] = {  # models of other kinds, which this reader is given by mistake
    "interval-model": "read it with load_interval_model",
    "gain-scheduling-workbench/hammerstein-wiener-model": "it is a Hammerstein-Wiener model, which only a PID "
    "takes: identify with --model lti or ssm; in Python load_hammerstein(..).core is the LPV model behind its curves",
}
MUCH = 0.02  # widths of a schedule range, by which a record may leave it unsaid
FORGOTTEN = 0.01  # of a start: what is left of it counts as nothing
TOLD = 2  # values for each state that is to be told from them
KNOWN = 1e-6  # of the best known direction of a start: what is known less is taken to be 0
LOOKED_AT = 5  # schedule values along each span, for what holds anywhere in it
CHUNK = 4096  # samples whose scheduled matrices are held at once


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
    the grid without an equilibrium; where there is none at all the radius is NaN, and nothing is known to be stable. Of several
    schedule variables `at` is a tuple, and the range the whole box of theirs.
    """

    radius: float
    at: float | tuple[float, ...]
    unknown: tuple[float, ...] = ()

    @property
    def stable(self) -> bool:
        return self.radius < 1.0


@record
class LPVModel:
    """x+ = A(rho) x + B(rho) u, y = C(rho) x + D(rho) u in deviations from the operating point.

    Shapes: A (nt, nx, nx), B (nt, nx, nu), C (nt, ny, nx), D (nt, ny, nu), one slice per term. `spans` (ns, 2) are the ranges
    [low, high] of the schedule variables in the estimation records; farther outside than `reach` the model holds the values that
    its basis functions have there. rho is a number where there is one variable, (ns,) where there are several.
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
    schedules: tuple[Channel, ...]
    spans: np.ndarray = field("ns 2")
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
    reach: float = field("", low=0.0, default=0.0)  # share of each span by which the basis is followed beyond it

    def __post_init__(self):
        for term in self.terms:
            if not 0 <= term.function < len(self.basis.names) or term.delay < 0:
                raise InputError(f"no function {term.function} or delay {term.delay} in this basis", file=self.name)
        if len(self.terms) != self.A.shape[0]:
            raise InputError(f"{len(self.terms)} terms for {self.A.shape[0]} matrices", file=self.name)
        if len(self.inputs) != self.B.shape[2] or len(self.outputs) != self.C.shape[1]:
            raise InputError("channel lists do not match B and C", file=self.name)
        if len(self.schedules) != len(self.spans):
            raise InputError(f"{len(self.schedules)} schedules for {len(self.spans)} spans", file=self.name)
        for schedule in self.schedules:
            if schedule.role == SCHEDULED_OUTPUT and schedule.name not in [c.name for c in self.outputs]:
                mend = "name it among the outputs, or give it the role schedule"
                raise InputError("is a scheduled output and no output", file=self.name, channel=schedule.name, mend=mend)
        check_one_if_output(self.schedules, self.name)

    @property
    def warmup(self) -> int:
        """Samples after which the predictor has forgotten its initial state: rows before that are never scored."""
        return self.predictor.warmup if self.predictor else 0

    @property
    def order(self) -> int:
        return self.A.shape[1]

    @property
    def units(self) -> dict[str, str]:
        """Units of the channels by name."""
        return {c.name: c.unit for c in (*self.inputs, *self.outputs, *self.schedules)}

    # ---- the schedule -------------------------------------------------------------------------------------------

    @property
    def schedule(self) -> Channel | None:
        """The schedule of a model that has one variable at most; None where it has none.

        Raises InputError where it has several: who asks was made for one.
        """
        if len(self.schedules) > 1:
            names = ", ".join(c.name for c in self.schedules)
            mend = "identify with one of them (--schedule), or use the model in compare, simulate() and freeze()"
            raise InputError("several schedule variables, this takes one", file=self.name, channel=names, mend=mend)
        return self.schedules[0] if self.schedules else None

    @property
    def span(self) -> np.ndarray:
        """[low, high] of the schedule of a model that has one variable at most, see `schedule`; zeros where it has none."""
        return np.zeros(2) if self.schedule is None else self.spans[0]

    @property
    def scheduled_output(self) -> int | None:
        """Which output the schedule is by its role; None for a schedule from outside."""
        own = [c.name for c in self.schedules if c.role == SCHEDULED_OUTPUT]
        return [c.name for c in self.outputs].index(own[0]) if own else None

    def schedule_of(self, experiment: Experiment) -> np.ndarray:
        """rho(k), (N,) or (N, ns), as the model follows it, see `clipped`; zeros for a model without schedule."""
        return self.clipped(self.measured_schedule(experiment))

    def measured_schedule(self, experiment: Experiment) -> np.ndarray:
        """The schedule as it was measured; see `scheduled`."""
        return scheduled(experiment, self.schedules)

    def clipped(self, rho: np.ndarray) -> np.ndarray:
        """Schedule values, moved into the spans and what `reach` adds to them."""
        low, high = ends(self.spans)
        beyond = self.reach * (high - low)
        return np.clip(rho, low - beyond, high + beyond)

    def outside(self, rho: np.ndarray) -> float:
        """How far the schedule leaves the model's span, in widths of the span: 0 inside, NaN where rho is not a number."""
        low, high = ends(self.spans)
        width = np.where(high > low, high - low, 1.0)
        return float(np.max(np.maximum(low - rho, rho - high) / width, initial=0.0))

    @property
    def middle(self) -> np.ndarray:
        """The schedule value in the middle of the spans."""
        return np.mean(ends(self.spans), axis=0)

    def grid(self, points: int) -> np.ndarray:
        """Schedule values over the spans and what `reach` adds to them; see `lattice`."""
        beyond = self.reach * np.diff(self.spans) * [-1.0, 1.0]
        return lattice(self.spans + beyond, points)

    def frozen_values(self, points: int) -> list:
        """Schedule values over the spans at which the model is frozen, see `lattice`; [None] without schedule."""
        grid = lattice(self.spans, points)
        return [None] if not self.schedules else grid.tolist() if grid.ndim == 1 else list(grid)

    def path(self, samples: int) -> np.ndarray:
        """The schedule going once over its span, (N,), zeros without any; of several variables the i-th, counted from 0, goes
        from end to end 2 i + 1 times, (N, ns).
        """
        share = np.linspace(0.0, 1.0, samples)
        shares = [np.abs((way * share + 1.0) % 2.0 - 1.0) for way in range(1, 2 * len(self.spans), 2)]
        way = [low + own * (high - low) for own, (low, high) in zip(shares, self.spans, strict=True)]
        return np.zeros(samples) if not way else way[0] if len(way) == 1 else np.stack(way, axis=1)

    def named(self, rho: Any) -> str:
        """A schedule value with the names and units of its variables, "r2 = 0.1 m, q2 = 0.3 rad"; "" without schedule."""
        values = np.atleast_1d(rho) if self.schedules else ()
        parts = (f"{c.name} = {v:.4g} {c.unit}".rstrip() for c, v in zip(self.schedules, values, strict=True))
        return ", ".join(parts)

    def weights(self, rho: np.ndarray, newest: int = 0) -> np.ndarray:
        """phi_j(rho(k - d_j)), (N, nt), no delay below `newest`; before the first sample the schedule holds its first value."""
        phi = self.basis(rho)
        late = np.arange(len(rho))[:, None] - np.maximum([term.delay for term in self.terms], newest)
        return phi[np.maximum(late, 0), [term.function for term in self.terms]]

    def still(self, rho: np.ndarray) -> np.ndarray:
        """phi_j(rho), (n, nt): the weights of the terms at schedule values that stand still."""
        return self.basis(rho)[:, [term.function for term in self.terms]]

    def freeze(self, rho: Any = None) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A, B, C, D at a constant schedule value; a model without schedule needs none.

        Where the schedule is an output these leave out what it answers to the state: `linearise` has that.
        Raises InputError outside the spans of the estimation records: nobody knows the machine there.
        """
        value = np.zeros(()) if not self.schedules or rho is None else np.asarray(rho, dtype=float)
        if self.schedules and (rho is None or value.shape != np.shape(self.middle) or not self.outside(value) <= 0.01):
            names = ", ".join(c.name for c in self.schedules)
            given = names + " (none given)" if rho is None else f"{names} = {', '.join(f'{v:g}' for v in value.ravel())}"
            known = "; ".join(
                f"{c.name} from {low:g} to {high:g} {c.unit}".rstrip()
                for c, (low, high) in zip(self.schedules, self.spans, strict=True)
            )
            raise InputError(given, file=self.name, mend=f"the model knows {known}")
        weight = self.still(self.clipped(value)[None])[0]
        return tuple(np.tensordot(weight, M, 1) for M in (self.A, self.B, self.C, self.D))  # type: ignore[return-value]

    @cached_property
    def free(self) -> bool:
        """Whether it integrates or is unstable anywhere in its spans; see `workbench.steady`."""
        return any(integrates(self.freeze(rho)[0]) for rho in self.frozen_values(LOOKED_AT))

    def disturbance(self, rho: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """K (nx, ny) and the covariance (ny, ny) of e in x+ = A x + B u + K e, y = C x + D u + e; zeros where nobody knows."""
        ny = len(self.outputs)
        noise = np.zeros((ny, ny)) if self.noise is None else self.noise
        if self.predictor is None:
            return np.zeros((self.order, ny)), noise
        value = np.asarray(self.middle if rho is None else rho, dtype=float)
        return np.tensordot(self.still(self.clipped(value)[None])[0], self.predictor.K, 1), noise

    def linearise(self, rho: Any = None) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A, B, C, D of small motions at a schedule value: those of `freeze`, or where the schedule is an output those about the
        equilibrium at which that output is rho.

        Raises InputError outside the span of the estimation records, and where there is no equilibrium.
        """
        frozen = self.freeze(rho)
        return frozen if self.scheduled_output is None or rho is None else linearised(self, rho)

    def to_control(self, rho: Any = None, *, frozen: bool = False) -> "control.StateSpace":
        """Small motions at a schedule value as a discrete python-control system with our channel names; see `linearise`.

        frozen: with a schedule that stands still even where it is an output.
        """
        import control  # takes a second to import, and only this needs it

        return control.StateSpace(
            *(self.freeze(rho) if frozen else self.linearise(rho)),
            self.dt,
            name=" at ".join(filter(None, [self.name, self.named(rho)])).replace(".", "_"),  # it refuses dots
            inputs=[c.name for c in self.inputs],
            outputs=[c.name for c in self.outputs],
        )

    def stability(self, points: int = 101) -> Stability:
        """Spectral radius of A on a grid over the span; see `Stability`."""
        grid, unknown = self.grid(points), []
        if self.scheduled_output is None:
            found = np.abs(np.linalg.eigvals(np.tensordot(self.still(grid), self.A, 1))).max(axis=1, initial=0.0)
            worst = int(np.argmax(found))
            at = grid[worst]
            return Stability(float(found[worst]), tuple(at.tolist()) if at.ndim else float(at))
        radius, worst = np.nan, np.nan
        for rho in grid.tolist():
            try:
                own = float(np.abs(np.linalg.eigvals(self.linearise(rho)[0])).max(initial=0.0))
            except InputError:  # no equilibrium
                unknown.append(rho)
                continue
            if not own <= radius:
                radius, worst = own, rho
        return Stability(radius, worst, tuple(unknown))

    # ---- simulation and prediction -----------------------------------------------------------------------------------

    def simulate(self, experiment: Experiment, *, warmup: int | None = None) -> np.ndarray:
        """Free run: the outputs (N, ny) from the measured inputs and schedule alone.

        A schedule that is an output is the model's own from where the measured ones end, so that none of them leaks in.
        The initial state comes from the first `warmup` samples: the predictor follows the measured outputs for so long
        and is then cut off. Rows before that are predictions, not simulation; score only rows from `warmup` on.
        Default: the predictor's own memory; 0 starts from the operating point. Where so few samples cannot tell a start, it is
        the likeliest one under what inputs make of the states, and the noise.
        """
        u, y, weight, seen = self.deviations(experiment)
        n = self.warmup if warmup is None else warmup
        free = self.predictor is not None and self.predictor.free_start
        if self.noise is not None and n < self.warmup and 0 < y[:n].size < TOLD * self.order:
            known = np.minimum(np.arange(len(u)), n - 1)  # a schedule that is an output is not known after that
            x = self._likely(u, y[:n], weight if self.scheduled_output is None else weight[known], seen[:n])
        else:
            x = self._states(u[:n], y[:n], weight[:n], seen[:n], free=free)
        if self.scheduled_output is not None:
            return simulated(self, experiment, x)
        out = np.empty((len(u), len(self.outputs)))
        state = x[-1]
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable model may leave the numbers
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
        check_units(experiment, self.units)
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

    def _likely(self, u: np.ndarray, y: np.ndarray, weight: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """States (n + 1, nx) of a free run along y (n, ny) from its likeliest start x0.

        minimise |e|^2 / R + x0' S^-1 x0, S the covariance of the states along the inputs u (N, nu), R that of the noise.
        """
        assert self.predictor is not None
        assert self.noise is not None
        nothing, n = np.zeros_like(self.predictor.K), len(y)
        moved = self._led(self.A, self.B, nothing, u, np.zeros((len(u), y.shape[1])), weight, np.zeros(self.order))
        S = moved.T @ moved / len(moved)
        Phi, e, _ = self._begun(self.A, u[:n], y, weight[:n], seen, moved[:n])
        R = np.kron(np.eye(n), self.noise)
        x0 = S @ Phi.T @ np.linalg.lstsq(Phi @ S @ Phi.T + R, e.ravel(), rcond=1e-12)[0]
        return self._led(self.A, self.B, nothing, u[:n], y, weight[:n], x0)

    def _start(self, F, u: np.ndarray, y: np.ndarray, weight: np.ndarray, seen: np.ndarray, x: np.ndarray) -> np.ndarray | None:
        """The start that lowers the errors most of a run x (n, nx) that began at zero.

        None where the run has forgotten it, or where so few samples tell more of the noise than of a start.
        """
        if y.size < max(TOLD * self.order, 1):
            return None
        Phi, e, left = self._begun(F, u, y, weight, seen, x)
        return None if np.abs(left).max(initial=0.0) <= FORGOTTEN else np.linalg.lstsq(Phi, e.ravel(), rcond=KNOWN)[0]

    def _begun(self, F, u: np.ndarray, y: np.ndarray, weight: np.ndarray, seen: np.ndarray, x: np.ndarray):
        """What a start adds to the outputs (n ny, nx), what a run x (n, nx) that began at zero misses (n, ny), and what is left
        of a start after these samples (nx, nx).
        """
        left = [np.eye(self.order)]  # after k samples: F(k-1) .. F(0)
        for _, own in self._slices(weight, F):
            for step in own:
                left.append(step @ left[-1])
        C, D = np.tensordot(seen, self.C, 1), np.tensordot(seen, self.D, 1)
        e = y - np.einsum("kyx,kx->ky", C, x) - np.einsum("kyu,ku->ky", D, u)
        return np.concatenate(C @ np.stack(left[:-1])), e, left[-1]

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
            "schedule": one_or_all([vars(c) for c in self.schedules]),
            "span": one_or_all(self.spans.tolist(), [0.0, 0.0]),
            "reach": self.reach,
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


def one_or_all(values: Any, none: Any = None) -> Any:
    """What belongs to the schedules, as laws and files hold it: one by itself, several as they are, `none` without any."""
    return values if len(values) > 1 else values[0] if len(values) else none


def check_one_if_output(schedules: Sequence[Channel], file: str) -> None:
    """Refuse a schedule that is an output beside others."""
    if len(schedules) > 1 and any(c.role == SCHEDULED_OUTPUT for c in schedules):
        names = ", ".join(c.name for c in schedules)
        mend = "name one schedule, or schedules of which none is an output"
        raise InputError("a schedule that is an output cannot have others beside it", file=file, channel=names, mend=mend)


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


def scheduled(experiment: Experiment, schedules: Sequence[Channel]) -> np.ndarray:
    """The schedule of a record as it was measured, (N,), of several variables (N, ns); zeros without any."""
    if not schedules:
        return np.zeros(len(experiment))
    return experiment[schedules[0].name] if len(schedules) == 1 else experiment[[c.name for c in schedules]]


def ends(spans: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest schedule values of spans (ns, 2): numbers for one variable, 0 for none, (ns,) for several."""
    low, high = (spans if len(spans) else np.zeros((1, 2))).T
    return (low, high) if len(low) > 1 else (low[0], high[0])


def lattice(spans: np.ndarray, points: int) -> np.ndarray:
    """Schedule values over spans (ns, 2), ends included: (points,) over one, 0 over none, of several about points^2, (n, ns)."""
    if len(spans) < 2:
        return np.linspace(spans[0, 0], spans[0, 1], points) if len(spans) else np.zeros(1)
    each = max(2, round(points ** (2.0 / len(spans))))
    return mesh([np.linspace(low, high, each) for low, high in spans])


def mesh(axes: Sequence[np.ndarray]) -> np.ndarray:
    """Every combination of values of each schedule variable: (n,) of one variable, (n, ns) of several, the last one fastest.

    >>> mesh([np.array([0.0, 1.0]), np.array([5.0, 6.0])]).tolist()
    [[0.0, 5.0], [0.0, 6.0], [1.0, 5.0], [1.0, 6.0]]
    """
    if len(axes) == 1:
        return np.asarray(axes[0], dtype=float)
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)


def load_model(path) -> LPVModel:
    """Read a model file written by `LPVModel.save`; what is missing or foreign is named.

    Raises InputError for a file that is none.

        >>> model.save("ssm.json")
        >>> load_model("ssm.json").schedule
        Channel(name='way', unit='mm', role='schedule')
    """
    content = read_json(path)
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        schema = content.get("schema") if isinstance(content, dict) else None
        raise InputError(
            "not an LPV model", file=path, mend=OTHERS.get(str(schema), f"expected a JSON object with schema {SCHEMA!r}")
        )
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
    point, schedule = content["operating_point"], content["schedule"]
    schedules = tuple(Channel(**c) for c in (schedule if isinstance(schedule, list) else [schedule] if schedule else []))
    return LPVModel(
        name=content["name"],
        dt=content["dt"],
        inputs=tuple(Channel(**c) for c in content["inputs"]),
        outputs=tuple(Channel(**c) for c in content["outputs"]),
        schedules=schedules,
        spans=np.reshape(content["span"] if schedules else [], (-1, 2)),
        basis=basis,
        terms=tuple(Term(int(term["function"]), int(term["delay"])) for term in terms),
        operating_point=OperatingPoint(basis_from_dict(point["basis"]), point["u"], point["y"]),
        predictor=predictor,
        noise=None if content["noise"] is None else np.array(content["noise"]),
        estimates=tuple(Estimate(**e) for e in content["estimates"]),
        trained_on=tuple(content.get("trained_on", ())),
        notes=tuple(content["notes"]),
        reach=content.get("reach", 0.0),
        **stacked,
    )


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
        name, dt, tuple(channels[0]), tuple(channels[1]), (), np.zeros((0, 2)), CONSTANT, (Term(0),), A, B, C, D,
        operating_point, **rest,
    )  # fmt: skip
