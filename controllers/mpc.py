"""LPV-MPC: a quadratic program on the identified model along the schedule that it will run through.

    minimise    sum |y_i - r_i|_Q^2 + |u_i - u_{i-1}|_S^2 + |u_i - ut|_R^2 + |(x_N - xt, u_{N-1} - ut)|_P^2 + w1' s + w2' s^2
    such that   low <= u_i <= high,   |u_i - u_{i-1}| <= rate dt,   y_low - s <= y_i <= y_high + s,   s >= 0

over x_{i+1} = A(rho_i) x_i + B(rho_i) (u_i - u0 + d) and y_i = C(rho_i) x_i + y0 with the state and disturbance of the observer.
A limit that an output is beyond now asks no more of it than the command of the steady state does, up to twice as far out.
(xt, ut) is the steady state in which the outputs come as near to the set-point as the limits allow; it replaces a set-point that
cannot be reached. P is the cost of the linear-quadratic regulator from there on: without active limits the first move is that
regulator's, whatever the horizon. Limits of the commands are hard, those of the outputs give way at a price.

With a tube (`tube`) limits are for y_i and u_i of x and errors of 0 from now on, and tighter the later i is. The observer is then
the model's own predictor, and d what stays of its errors e: cost and target see them go on as K d and d, the limits do not.

What is done when no solver has an answer stands in `receding`.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, solve_discrete_are

from controllers.along import Along
from controllers.observer import Observer, design_observer, interpolated
from controllers.receding import (
    TINY,
    UNPLANNED,
    Plan,
    Program,
    Receding,
    Status,
    Weights,
    common_fields,
    limits_with,
    solved_by_daqp,
    weights_by,
)
from controllers.scheduled_pid import ScheduledPID
from controllers.tube import Tube, design_tube, predictor_observer
from workbench.errors import InputError
from workbench.intervals.model import IntervalModel
from workbench.lpv import LPVModel, check_schedule_from_outside, ends, lattice, model_from_dict, one_or_all
from workbench.physics.controller import schedules_of
from workbench.records import field, record
from workbench.robustness.linear_law import Affine
from workbench.steady import gain

if TYPE_CHECKING:
    import control

KIND = "mpc"
KEPT = 2e-6  # relative slack, of which half are the solvers', up to which a plan is in the tube
FURTHER = 2.0  # times as far beyond a limit as it is now, that an output may go on its way back
POINTS = 11  # schedule values at which terminal costs are found


@record
class Held:
    """The schedule stays where it was measured."""


@record
class Extrapolated:
    """The schedule goes on as it went: its slope, averaged over `memory` samples, is kept over the horizon."""

    memory: float = field("", low=1.0, default=25.0)


Prediction = Held | Extrapolated


class MPCState(NamedTuple):
    """Memory of the law: observer's state z, last command, last schedule and slope, and the plans."""

    z: np.ndarray
    u: np.ndarray
    rho: Any
    slope: Any
    plan: Plan

    @property
    def status(self) -> Status | None:
        """Where the last command came from; None before the first sample."""
        return self.plan.status


@record
class MPC(Receding):
    """minimise sum |y_i - r_i|_Q^2 + |u_i - u_(i-1)|_S^2 + .. over the horizon, on the model along its schedule, within limits.

    horizon in samples; low, high (nu), rate [1/s]; y_low, y_high (ny), infinite where there is none.

    fallback: a PID on the same channels for when nothing else is left. tube: tightened limits, proved when the law is made.

        >>> u, memory = mpc.step(mpc.init(), r=np.array([20.0]), y=np.array([0.0]), rho=5.0)
        >>> u.round(1), memory.status.value
        (array([12.]), 'optimal')
    """

    model: LPVModel
    observer: Observer
    weights: Weights
    horizon: int
    low: np.ndarray = field("nu")
    high: np.ndarray = field("nu")
    rate: np.ndarray = field("nu", unit="1/s", low=1e-300)
    y_low: np.ndarray = field("ny")
    y_high: np.ndarray = field("ny")
    fallback: ScheduledPID
    prediction: Prediction = field(default_factory=Extrapolated)
    name: str = "mpc"
    tube: Tube | None = None

    def __post_init__(self):
        check_schedule_from_outside(self.model, "an MPC")
        if self.fallback.curves:
            mend = "design one on the model that the MPC predicts with"
            raise InputError(
                f"{self.fallback.name}, its fallback, inverts curves and commands u, the MPC f(u)", file=self.name, mend=mend
            )
        self.check(self.actuated, self.measured)
        own, known = schedules_of(self.fallback), schedules_of(self)
        if own not in ((), known):
            problem = f"the fallback law is scheduled on {', '.join(own)}, the model on {', '.join(known) or 'nothing'}"
            raise InputError(problem, file=self.name, mend="design it on the same model")
        _ = self.terminal  # an uncontrollable model is refused here, not at the first sample
        if self.tube is not None:
            self.tube.check(self)

    # ---- what a loop needs to know ----------------------------------------------------------------------------------------

    @property
    def dt(self) -> float:
        return self.model.dt

    @property
    def actuated(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.model.inputs)

    @property
    def measured(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.model.outputs)

    @property
    def references(self) -> tuple[str, ...]:
        return tuple(f"{name}_set" for name in self.measured)

    @property
    def schedule(self) -> str | tuple[str, ...] | None:
        return one_or_all(tuple(c.name for c in self.model.schedules))

    @property
    def units(self) -> dict[str, str]:
        """Units of the channels by name."""
        return self.model.units

    def outside(self, rho: np.ndarray) -> float:
        """How far a schedule leaves what the model knows, in widths of that; 0 inside."""
        return self.model.outside(rho)

    def init(self, u: np.ndarray | None = None) -> MPCState:
        """Before the first sample; u: the command that it takes over from, else that of the model's operating point."""
        held = self.operating(np.array([self.model.middle]))[0][0] if u is None else np.asarray(u, dtype=float)
        unknown = np.full(self.observer.L.shape[1], np.nan)  # found from the first measurement
        return MPCState(unknown, held, np.nan, 0.0, UNPLANNED)

    # ---- while no limit acts ----------------------------------------------------------------------------------------------

    @property
    def span(self) -> np.ndarray:
        """Between which the schedule changes the law, (2,), (ns, 2) of several variables; infinite without one."""
        spans = self.model.spans
        return np.array([-np.inf, np.inf]) if not len(spans) else spans[0] if len(spans) == 1 else spans

    def at(self, rho: Any = None) -> "control.StateSpace":
        """The law at a schedule value that stands still, from (r, y) to u; its state is (z, last command). See `affine`."""
        import control

        own = self.affine(rho)
        return control.StateSpace(own.A, own.B, own.C, own.D, self.dt)

    def offset(self, rho: Any = None) -> np.ndarray:
        """What `at` leaves out of the command, (nu,); what it leaves out of the state is in `affine`."""
        return self.affine(rho).o

    def affine(self, rho: Any = None, slope: Any = 0.0) -> Affine:
        """The law as long as none of its limits acts, at a schedule value that moves by `slope` a sample.

        Its state is (z, u-), with the last command; set-points to come are those of now. Without limits observer, target, plan
        and the step to the next sample are affine in (z, u-, r, y): their values at 0 and at the unit vectors are all there is to
        know. Its rows are what the plan holds: commands, their moves, outputs that have limits, and the target.
        """
        rho = self.model.middle if rho is None else rho
        model = Along(self, self._path(rho, np.broadcast_to(slope, np.shape(rho))))
        nz, nu, ny, N, soft = self.observer.L.shape[1], model.nu, model.ny, self.horizon, self._soft[2]

        def answered(point: np.ndarray) -> np.ndarray:
            z, last, r, y = np.split(point, np.cumsum([nz, nu, ny]))
            z, push = self._corrected(MPCState(z, last, rho, slope, UNPLANNED), model, rho, y)
            xt, ut, yt = self._target(last, model, z, r, limited=False)
            H, f, Y, free = self._condensed(last, model, z, np.tile(yt, (N + 1, 1)), push, (xt, ut))
            U = np.linalg.solve(H + TINY * np.trace(H) / len(H) * np.eye(len(H)), -f).reshape(N, nu)
            ahead, settled, now = (Y @ U.ravel() + free).reshape(N, ny), r, (model.outputs(z)[soft],)
            if self.tube is not None:  # its limits do not see what d moves, and nothing gives way
                d = model.disturbances(z)[1]
                ahead, settled, now = ahead - model.by_errors(d), r - model.settled_by(d)[1], ()
            rows = U, np.diff(U, axis=0, prepend=last[None]), ahead[:, soft], ut, settled[soft], *now
            return np.concatenate([model.moved(z, U[0], push), *(own.ravel() for own in rows)])

        n, at_0 = nz + nu, answered(np.zeros(nz + nu + 2 * ny))
        slopes = np.column_stack([answered(own) - at_0 for own in np.eye(n + 2 * ny)])
        u = slice(nz, n)  # the first command of the plan is what the law remembers, too
        (A, B), (W, V) = (np.split(own, [n], axis=1) for own in (slopes[:n], slopes[nz:]))
        return Affine(A, B, at_0[:n], A[u], B[u], at_0[u], W, V, at_0[nz:], *self._plan_limits)

    @cached_property
    def _plan_limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest values of the rows of `affine`."""
        N, nu, soft, tube = self.horizon, len(self.low), self._soft[2], self.tube
        lows, highs = (self.low, -self._way, self.y_low[soft]), (self.high, self._way, self.y_high[soft])
        room = [np.zeros((N, n)) for n in (nu, nu, len(soft))] if tube is None else [tube.u, tube.moves, tube.y[:, soft]]
        which = (0, 1, 2, 0, 2, *((2,) if tube is None else ()))  # of the rows: commands, moves or outputs
        room = [room[i] if at < 3 else room[i][-1] for at, i in enumerate(which)]
        low, high = ([own[i] for i in which] for own in (lows, highs))
        return (
            np.concatenate([np.ravel(own + by) for own, by in zip(low, room, strict=True)]),
            np.concatenate([np.ravel(own - by) for own, by in zip(high, room, strict=True)]),
        )

    def memory(self, state: MPCState) -> np.ndarray:
        """The state of `affine` that a memory of the law is."""
        return np.concatenate([state.z, state.u])

    def slopes(self, rho: np.ndarray) -> np.ndarray:
        """By how much the law takes a schedule (N), or (N, ns), to move at each of its samples."""
        state, found = self.init(), []
        for own in rho:
            state = state._replace(**dict(zip(("rho", "slope"), self._followed(state, own), strict=True)))
            found.append(state.slope)
        return np.array(found)

    # ---- files ------------------------------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, readable without the package, the model and the fallback law included."""
        return {"kind": KIND} | self.common_dict() | {
            "prediction_memory": self.prediction.memory if isinstance(self.prediction, Extrapolated) else None,
            "observer": {key: getattr(self.observer, key) for key in ("at_inputs", "rho", "L", "J")},
            "model": self.model.to_dict(),
        } | ({} if self.tube is None else {"tube": vars(self.tube)})  # fmt: skip

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> "MPC":
        """The law that `to_dict` wrote."""
        model, memory = model_from_dict(content["model"]), content["prediction_memory"]
        prediction = Held() if memory is None else Extrapolated(memory)
        observer = Observer(model, **content["observer"])
        tube = Tube(**content["tube"] | {"parameters": tuple(content["tube"]["parameters"])}) if "tube" in content else None
        return cls(model=model, observer=observer, prediction=prediction, tube=tube, **common_fields(content))

    # ---- one sample -------------------------------------------------------------------------------------------------------

    def step(self, state: MPCState, r: np.ndarray, y: np.ndarray, rho: Any = None) -> tuple[np.ndarray, MPCState]:
        """One sample: (u, next memory). r (ny,), or (N, ny) where the set-points of the samples to come are known.

        A measurement that is not a number corrects nothing: the model goes on alone.
        """
        rho, slope = self._followed(state, rho)
        path = self._path(rho, slope)
        model = Along(self, path)
        z, push = self._corrected(state, model, rho, np.asarray(y, dtype=float))
        wanted = np.broadcast_to(np.asarray(r, dtype=float), (self.horizon, len(self.measured)))
        wanted = np.where(np.isfinite(wanted), wanted, model.outputs(z))  # no set-point: stay where it is
        program = self._program(state.u, model, z, np.vstack([wanted, wanted[-1:]]), push)
        found, status = self._solved(program)
        if self.tube is not None and found is not None and self._slack(program, found) > KEPT:
            status = Status.OUTSIDE_TUBE
        u, plan = self._acted(state.u, state.plan, found, status, wanted[0], np.asarray(y, dtype=float), rho)
        return u, MPCState(model.moved(z, u, push), u, rho, slope, plan)

    def _followed(self, state: MPCState, rho: Any) -> tuple[Any, Any]:
        """The schedule value, and its slope a sample; the last ones where it was not measured."""
        if not self.model.schedules:
            return 0.0, 0.0
        unknown, still = bool(np.isnan(state.rho).any()), np.zeros_like(self.model.middle)
        if rho is None or not np.isfinite(rho).all():
            return (self.model.middle, still) if unknown else (state.rho, state.slope)
        now = np.asarray(rho, dtype=float)
        if unknown or isinstance(self.prediction, Held):
            return now, still
        return now, state.slope + (now - state.rho - state.slope) / self.prediction.memory

    def _path(self, rho: Any, slope: Any) -> np.ndarray:
        """The schedule over the horizon, (N + 1,) or (N + 1, ns), within what the model knows."""
        return np.clip(rho + np.multiply.outer(np.arange(self.horizon + 1), slope), *ends(self.model.spans))

    def _corrected(self, state: MPCState, model: Along, rho: Any, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The observer's state after this sample's measurement, and what that moves it by on its way to the next."""
        seen = bool(np.isfinite(y).all())
        if np.isnan(state.z).any():  # first sample: as if the machine had stood at this measurement under the last command
            y = y if seen else model.y0[0]
            if self.tube is None:
                return model.at_rest(state.u, y), np.zeros(len(state.z))
            z = model.predictor_at_rest(state.u, y)
            return z, model.moved_by(z[model.nx :])
        e = y - model.outputs(state.z) if seen else np.zeros(len(y))
        if self.tube is not None:  # outputs(z) holds d, which the predictor knows nothing of
            d = state.z[model.nx :]
            return state.z + self.observer.gains(rho)[0] @ e, model.moved_by(e + d if seen else np.zeros(len(y)))
        L, J = self.observer.gains(rho)
        return state.z + L @ e, J @ e

    def _program(self, last: np.ndarray, model: Along, z: np.ndarray, r: np.ndarray, push: np.ndarray | None = None) -> Program:
        """The quadratic program in the commands and the slacks of the outputs; push: what this sample's error moves."""
        from controllers.condensing import with_limits  # compiled when first needed

        xt, ut, yt = self._target(last, model, z, r[-1])
        condensed = self._condensed(last, model, z, r + (yt - r[-1]), push, (xt, ut))
        program = Program(*with_limits(condensed, self._reach(last), self._way, self._soft, TINY))
        if self.tube is not None:
            self._tighten(program, model.by_errors(model.disturbances(z)[1]))
        else:
            self._give_way(program, model, z, ut)
        return program

    def _condensed(
        self, last: np.ndarray, model: Along, z: np.ndarray, r: np.ndarray, push: np.ndarray | None,
        target: tuple[np.ndarray, np.ndarray],
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """The program before its limits: H, f of the commands U, and the outputs Y U + free that they lead to."""
        from controllers.condensing import condense

        nx, N = model.nx, self.horizon
        d_in, d_out = model.disturbances(z)
        pushed, bias, x = model.pushed(d_in - model.u0[:N]), model.y0 + d_out, z[:nx].copy()
        if self.tube is not None:
            pushed[1:] += model.K[1:N] @ d_out
            pushed[0] += 0.0 if push is None else push[:nx]
        weights = self._Q, self._S, self._R, self.terminal_cost(model.path[-1])
        return condense(model.M, pushed, bias, x, r, np.array(last), target, weights)

    def _give_way(self, program: Program, model: Along, z: np.ndarray, ut: np.ndarray) -> None:
        """Ask no more of an output beyond a limit than the command of the steady state does: FURTHER times its excess at most.

        On its way back a machine may first go further out, for longer than the horizon: a price on that would hold it there.
        """
        soft, y = self._soft[2], model.outputs(z)
        low, high, y = self.y_low[soft], self.y_high[soft], y[soft]
        if not np.any(np.maximum(y - high, low - y) > KEPT * (1.0 + np.abs(y))):
            return
        way = model.under(z, ut)[:, soft]
        over = np.clip(way - high, 0.0, FURTHER * np.maximum(y - high, 0.0))
        under = np.clip(way - low, -FURTHER * np.maximum(low - y, 0.0), 0.0)
        _move_limits(program, over, under)

    def _slack(self, program: Program, found: np.ndarray) -> float:
        """How far a plan leaves the limits of outputs without slack, relative to what stands in them."""
        n, rows = found.size, slice(found.size - len(self.low), None)
        values, first = program.A[rows, :n] @ found.ravel(), len(program.lower) - len(program.A) + rows.start
        over = np.maximum(values - program.upper[first:], program.lower[first:] - values)
        return float((over / (1.0 + np.abs(values))).max(initial=0.0))

    def _tighten(self, program: Program, moved: np.ndarray) -> None:
        """Leave room for the tube in a program's limits; moved (N, ny): what d moves outputs in it, which limits do not see."""
        assert self.tube is not None
        soft = self._soft[2]
        first = len(program.lower) - len(program.A)
        moves = self.tube.moves[1:].ravel()
        rows = slice(first, first + len(moves))
        program.lower[rows] += moves
        program.upper[rows] -= moves
        _move_limits(program, moved[:, soft] - self.tube.y[:, soft], moved[:, soft] + self.tube.y[:, soft])

    def _reach(self, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest commands (N, nu), with the room of the tube."""
        if self.tube is None:
            return super()._reach(last)
        way = self._tight_ways
        low, high = np.minimum(self.low + self.tube.u, last + way), np.maximum(self.high - self.tube.u, last - way)
        low[0], high[0] = np.maximum(low[0], last - way[0]), np.minimum(high[0], last + way[0])
        return low, high

    def _target(
        self, last: np.ndarray, model: Along, z: np.ndarray, r: np.ndarray, *, limited: bool = True
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Steady state, command and outputs nearest to the set-point that the limits allow; all of them where not `limited`."""
        from controllers.condensing import steady

        d_in, d_out = model.disturbances(z)
        x0, X, y0, G = steady(model.M[-1], model.nx, model.nu, model.ny, d_in - model.u0[-1], model.y0[-1] + d_out)
        y_low, y_high, low, high = self.y_low, self.y_high, self.low, self.high
        if self.tube is not None:
            own, moved = model.settled_by(d_out)
            x0, y0 = x0 + own, y0 + moved - d_out
            y_low, y_high = y_low + self.tube.y[-1] + moved, y_high - self.tube.y[-1] + moved
            low, high = low + self.tube.u[-1], high - self.tube.u[-1]
        r = np.minimum(np.maximum(r, y_low), y_high) if limited else r
        GQ = G.T @ self._Q
        H, f = GQ @ G + self._R, GQ @ (y0 - r) - self._R @ last
        H.flat[:: len(H) + 1] += TINY * np.trace(H) / len(H)
        u = np.linalg.solve(H, -f)
        if limited and (np.any(u < low) or np.any(u > high)):
            bounded = solved_by_daqp(Program(H, f, np.empty((0, len(u))), np.array(low), np.array(high)))
            u = np.minimum(np.maximum(u if bounded is None else bounded, low), high)
        return X @ u + x0, u, G @ u + y0

    # ---- found once -------------------------------------------------------------------------------------------------------

    @cached_property
    def _tight_ways(self) -> np.ndarray:
        """Largest moves by the samples of the horizon that the tube leaves, (N, nu)."""
        assert self.tube is not None
        return np.cumsum(self._way - self.tube.moves, axis=0)

    @cached_property
    def _R(self) -> np.ndarray:
        return np.diag(self.weights.inputs)

    @cached_property
    def _flat(self) -> np.ndarray:
        """A, B, C of every term, flat side by side."""
        model = self.model
        return np.hstack([M.reshape(len(model.terms), -1) for M in (model.A, model.B, model.C)])

    @cached_property
    def _flat_K(self) -> np.ndarray:
        """K of every term, flat."""
        return self.model.predictor.K.reshape(len(self.model.terms), -1)  # type: ignore[union-attr]

    @cached_property
    def _functions(self) -> np.ndarray:
        return np.array([term.function for term in self.model.terms])

    @cached_property
    def _delays(self) -> np.ndarray:
        return np.array([term.delay for term in self.model.terms])

    @cached_property
    def _latest(self) -> int:
        return int(self._delays.max())

    @cached_property
    def terminal(self) -> tuple[np.ndarray, np.ndarray]:
        """Schedule values, and there the cost of the regulator on (x, last command)."""
        grid = lattice(self.model.spans, POINTS)
        return grid, np.array([self._regulator(rho) for rho in grid])

    def _regulator(self, rho: Any) -> np.ndarray:
        A, B, C, _ = self.model.freeze(rho if self.model.schedules else None)
        nx, nu = B.shape
        Az, Bz = np.block([[A, B], [np.zeros((nu, nx)), np.eye(nu)]]), np.vstack([B, np.eye(nu)])
        Q = np.zeros((nx + nu, nx + nu))
        with np.errstate(over="ignore", invalid="ignore"):  # what leaves the numbers is refused below
            Q[:nx, :nx], Q[nx:, nx:] = C.T @ self._Q @ C, self._R
        cross = np.vstack([np.zeros((nx, nu)), self._R])
        S = self._S + self._R
        try:
            return solve_discrete_are(Az, Bz, Q, S + TINY * np.eye(nu) * max(np.trace(S), 1e-300), s=cross)
        except (LinAlgError, ValueError):
            at = f" at {self.model.named(rho)}" if self.model.schedules else ""
            raise InputError(
                f"no regulator{at}: a mode cannot be moved, or counts for nothing", file=self.model.name,
                mend="give every output a weight above 0, and a model whose inputs move all of it",
            ) from None  # fmt: skip

    def terminal_cost(self, rho: Any) -> np.ndarray:
        return interpolated(*self.terminal, rho)

    def operating(self, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """u0 and y0 along a schedule."""
        phi = self.model.operating_point.basis(path)
        return phi @ self.model.operating_point.u, phi @ self.model.operating_point.y


def _move_limits(program: Program, upper: np.ndarray, lower: np.ndarray) -> None:
    """Add (N, soft) each to the upper and lower limits of those outputs in a program that have any: its last rows."""
    both = np.stack([upper, lower]).transpose(2, 0, 1).ravel()  # of each output the upper limits, then the lower ones
    rows = slice(len(program.lower) - len(both), None)
    program.upper[rows] += both  # infinite for the lower ones, and the other way round
    program.lower[rows] += both


def default_weights(model: LPVModel, move: float = 0.003) -> Weights:
    """An output counts in units of what unit inputs move it in the middle of the schedule; move: price of a unit move."""
    A, B, C, D = model.freeze(model.middle if model.schedules else None)
    scale = np.linalg.norm(gain(A, B, C, D, model.free), axis=1)
    outputs, file = [c.name for c in model.outputs], model.name
    return weights_by(
        scale, outputs, len(model.inputs), move, when="in the steady state", file=file, mend="leave this output out"
    )


def design_mpc(
    model: LPVModel,
    fallback: ScheduledPID,
    *,
    horizon: int = 20,
    weights: Weights | None = None,
    observer: Observer | None = None,
    low: np.ndarray | None = None,
    high: np.ndarray | None = None,
    rate: np.ndarray | None = None,
    y_low: np.ndarray | None = None,
    y_high: np.ndarray | None = None,
    prediction: Prediction | None = None,
    errors: Sequence[IntervalModel] | None = None,
) -> MPC:
    """An LPV-MPC on `model`. Limits default to those of the fallback law, outputs to none.

    weights default: `default_weights`. errors: of the model's outputs, as `ErrorRegression` finds them; the limits are tightened
    by a tube that holds whatever they do. Its observer is the model's predictor.
    """
    if errors is not None:
        if observer is not None:
            raise InputError("a tube needs the model's own predictor as observer", file=model.name, mend="give no observer")
        observer = predictor_observer(model)
    law = MPC(
        model=model, observer=observer or design_observer(model), weights=weights or default_weights(model), horizon=horizon,
        fallback=fallback, prediction=prediction or Extrapolated(),
        **limits_with(fallback, low=low, high=high, rate=rate, y_low=y_low, y_high=y_high),
    )  # fmt: skip
    return law if errors is None else replace(law, tube=design_tube(law, errors))
