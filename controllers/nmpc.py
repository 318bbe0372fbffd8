"""Nonlinear MPC: every sample, the optimal course of the plant's own equation over the horizon.

    minimise    1/2 sum_{i=1}^{N} |h(x_i) - r_i|_Q^2 + 1/2 sum_{i=0}^{N-1} |u_i - u_{i-1}|_S^2 + w1' s + 1/2 w2' s^2
    such that   x_{i+1} = F(x_i, u_i + d),   low <= u_i <= high,   |u_i - u_{i-1}| <= rate dt,
                y_low - s <= h(x_i) <= y_high + s,   s >= 0

from the state and disturbance of an extended Kalman filter on the same equation. It knows all that a simulation can know of its
plant: what it reaches is what a scheduled design is compared with, not what a machine is run with.

Two solvers. `RealTimeIteration`: Gauss-Newton steps, each the condensed quadratic program of the prediction linearised along the
last plan, one of them a sample; with enough of them it arrives where IPOPT does. `Ipopt`: the program itself, to convergence.

Sources: Diehl, Bock and Schloeder, "A real-time iteration scheme for nonlinear optimization in optimal feedback control", SIAM J.
Control Optim. 43 (2005) 1714-1736; Waechter and Biegler, Mathematical Programming 106 (2006) 25-57, on IPOPT.
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from controllers.plant_observer import Belief, PlantObserver, SampledPlant
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
    weights_by,
)
from controllers.scheduled_pid import ScheduledPID
from workbench.errors import InputError, check_known
from workbench.physics.controller import rho_of, schedules_of
from workbench.physics.extension import Extension, extension
from workbench.physics.plant import Plant
from workbench.records import field, record

KIND = "nmpc"


@record
class RealTimeIteration:
    """Gauss-Newton steps a sample, from the last plan on."""

    steps: int = 1


@record
class Ipopt:
    """Interior point to convergence: `tolerance` of the optimality conditions, at most `iterations`."""

    tolerance: float = field("", low=1e-14, default=1e-8)
    iterations: int = 200


Solver = RealTimeIteration | Ipopt
SOLVERS: dict[str, type] = {"real-time-iteration": RealTimeIteration, "ipopt": Ipopt}


class NMPCState(NamedTuple):
    """Memory of the law: what the filter expects of this sample (None before the first), the last command, and the plans."""

    belief: Belief | None
    u: np.ndarray
    plan: Plan

    @property
    def status(self) -> Status | None:
        """Where the last command came from; None before the first sample."""
        return self.plan.status


@record
class NMPC(Receding):
    """minimise sum |h(x_i) - r_i|_Q^2 + |u_i - u_(i-1)|_S^2 + .. such that x_(i+1) = F(x_i, u_i): nonlinear MPC on a plant.

    horizon in samples; low, high (nu), rate [1/s]; y_low, y_high (ny), infinite where there is none.

    plant, and where it is found: `base`, as in a plant file. actuated, controlled: inputs and outputs on which the fallback law
    works too. All outputs of the plant are measured.

        >>> from controllers.nmpc import design_nmpc
        >>> design_nmpc(MOTOR, fallback=law, horizon=10).actuated
        ('U',)
    """

    plant: Plant
    base: str
    actuated: tuple[str, ...]
    controlled: tuple[str, ...]
    weights: Weights
    horizon: int
    low: np.ndarray = field("nu")
    high: np.ndarray = field("nu")
    rate: np.ndarray = field("nu", unit="1/s", low=1e-300)
    y_low: np.ndarray = field("ny")
    y_high: np.ndarray = field("ny")
    fallback: ScheduledPID
    solver: Solver = field(default_factory=RealTimeIteration)
    drift: float = field("", low=1e-9, default=0.3)
    name: str = "nmpc"

    def __post_init__(self):
        for name in self.controlled:
            check_known("output", name, self.plant.output_names, file=self.plant.name)
        self.check(self.actuated, self.controlled)
        for name in schedules_of(self.fallback):
            check_known("schedule of the fallback law", name, self.plant.output_names, file=self.plant.name)
        if isinstance(self.solver, RealTimeIteration) and (not isinstance(self.solver.steps, int) or self.solver.steps < 1):
            raise InputError(f"{self.solver.steps} steps a sample", file=self.name, mend="a whole number, at least one")
        if np.any(self.weights.inputs):
            raise InputError("no steady input is known to stay near to", file=self.name, mend="leave the weights of inputs at 0")
        _ = self.observer.model.step  # a plant that cannot be predicted is refused here, not at the first sample

    # ---- what a loop needs to know ----------------------------------------------------------------------------------------

    @property
    def dt(self) -> float:
        return self.plant.dt

    @property
    def measured(self) -> tuple[str, ...]:
        """All outputs of the plant, those with set-points first."""
        return (*self.controlled, *(name for name in self.plant.output_names if name not in self.controlled))

    @property
    def references(self) -> tuple[str, ...]:
        return tuple(f"{name}_set" for name in self.controlled)

    @property
    def units(self) -> dict[str, str]:
        """Units of the channels by name."""
        return {c.name: c.unit for c in (*self.plant.inputs, *self.plant.outputs)}

    @property
    def schedule(self) -> str | None:
        """None: nothing is scheduled, the state says it all."""
        return None

    @cached_property
    def observer(self) -> PlantObserver:
        return PlantObserver(SampledPlant(self.plant, self.actuated), self.drift)

    def init(self, u: np.ndarray | None = None) -> NMPCState:
        """Before the first sample; u: the command that it takes over from, else that of the plant's start."""
        model = self.observer.model
        return NMPCState(None, model.start[1][model.at] if u is None else np.asarray(u, dtype=float), UNPLANNED)

    # ---- files ------------------------------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers; the plant as in a plant file: its name, where it is found, its parameters and effects."""
        kind = next(kind for kind, cls in SOLVERS.items() if isinstance(self.solver, cls))
        known = extension(self.plant, self.base, {})
        return {"kind": KIND} | self.common_dict() | {
            "actuated": list(self.actuated), "controlled": list(self.controlled), "solver": {"kind": kind} | vars(self.solver),
            "drift": self.drift,
            "plant": {"name": known.plant, "base": known.base, "parameters": known.parameters, "effects": known.effects},
        }  # fmt: skip

    @classmethod
    def from_dict(cls, content: dict[str, Any], find_plant: Callable[[str], Plant] | None) -> "NMPC":
        """The law that `to_dict` wrote; find_plant: what gives the plant that is found at `base`."""
        of, solver = content["plant"], dict(content["solver"])
        if find_plant is None:
            raise InputError(f"predicts with the plant {of['base']}, which is not at hand here", mend="give find_plant=")
        plant = Extension(of["name"], of["base"], of["parameters"], of["effects"]).of(find_plant(of["base"]))
        chosen = SOLVERS[check_known("solver", solver.pop("kind"), SOLVERS)](**solver)
        return cls(
            plant=plant, base=of["base"], actuated=tuple(content["actuated"]), controlled=tuple(content["controlled"]),
            solver=chosen, drift=content["drift"], **common_fields(content),
        )  # fmt: skip

    # ---- one sample -------------------------------------------------------------------------------------------------------

    def step(self, state: NMPCState, r: np.ndarray, y: np.ndarray, rho: float | None = None) -> tuple[np.ndarray, NMPCState]:
        """One sample: (u, next memory). r (ny,), or (N, ny) where the set-points of the samples to come are known.

        y: as `measured` says; a measurement that is not a number corrects nothing.
        """
        del rho
        y = np.asarray(y, dtype=float)
        by_name = dict(zip(self.measured, y, strict=True))
        seen = np.array([by_name[name] for name in self.plant.output_names])
        belief = state.belief
        if belief is None or not np.isfinite(belief.z).all():  # a reading far off the machine may have thrown it
            belief = self.observer.first(seen)
        belief = self.observer.corrected(belief, seen)
        nx, ny = len(self.plant.states), len(self.controlled)
        x, d = belief.z[:nx], belief.z[nx:]
        expected = dict(zip(self.plant.output_names, np.array(self.observer.model.seen(x)[0]).ravel().tolist(), strict=True))
        wanted = np.broadcast_to(np.asarray(r, dtype=float), (self.horizon, ny))
        wanted = np.where(np.isfinite(wanted), wanted, [expected[name] for name in self.controlled])  # else stay where it is
        found, status = self._planned(state, x, d, wanted)
        schedule = rho_of(self.fallback, np.array([expected[name] for name in schedules_of(self.fallback)]))
        u, plan = self._acted(state.u, state.plan, found, status, wanted[0], y[:ny], schedule)
        return u, NMPCState(self.observer.moved(belief, u), u, plan)

    def _planned(self, state: NMPCState, x: np.ndarray, d: np.ndarray, r: np.ndarray) -> tuple[np.ndarray | None, Status]:
        """Commands (N, nu) of the optimal course, or None."""
        held = state.plan.commands[state.plan.age + 1 :].reshape(-1, len(self.actuated))
        last = held[-1:] if len(held) else state.u[None]
        plan = np.vstack([held, np.repeat(last, self.horizon - len(held), axis=0)])
        if isinstance(self.solver, Ipopt):
            found = self._by_ipopt(state.u, x, d, r, plan)
            if found is not None:
                return found, Status.OPTIMAL
            return self._newton(state.u, x, d, r, plan)[0], Status.SECOND_SOLVER
        found, statuses = None, []
        for _ in range(self.solver.steps):
            better, status = self._newton(state.u, x, d, r, plan)
            if better is None:
                break  # what was found before is still a plan
            found = plan = better
            statuses.append(status)
        if found is None:
            return None, Status.FALLBACK
        whole = len(statuses) == self.solver.steps and all(status is Status.OPTIMAL for status in statuses)
        return found, Status.OPTIMAL if whole else Status.SECOND_SOLVER

    # ---- the real-time iteration ----------------------------------------------------------------------------------------

    def _newton(
        self, last: np.ndarray, x: np.ndarray, d: np.ndarray, r: np.ndarray, plan: np.ndarray
    ) -> tuple[np.ndarray | None, Status]:
        """The plan after one Gauss-Newton step from this one, or None."""
        program = self._program(last, x, d, r, plan)
        return (None, Status.FALLBACK) if program is None else self._solved(program)

    def _program(self, last: np.ndarray, x: np.ndarray, d: np.ndarray, r: np.ndarray, plan: np.ndarray) -> Program | None:
        """The quadratic program of the prediction linearised along a plan; None where that leaves the finite numbers."""
        from controllers.condensing import condense, with_limits  # compiled when first needed

        N, nx, nu, ny = self.horizon, len(x), len(self.actuated), len(self.controlled)
        after, A, B = (np.array(a) for a in self._along(x, (plan + d).T))
        if not np.isfinite(after).all():
            return None
        course = np.column_stack([x, after]).T  # (N + 1, nx)
        y, C = self._outputs(course.T)
        A, B = A.reshape(nx, N, nx).transpose(1, 0, 2), B.reshape(nx, N, nu).transpose(1, 0, 2)
        M = np.empty((N + 1, nx * (nx + nu + ny)))
        M[:N, : nx * nx], M[:N, nx * nx : nx * (nx + nu)] = A.reshape(N, -1), B.reshape(N, -1)
        M[N, : nx * (nx + nu)], M[:, nx * (nx + nu) :] = 0.0, C.reshape(N + 1, -1)
        pushed = course[1:] - np.einsum("nij,nj->ni", A, course[:-1]) - np.einsum("nij,nj->ni", B, plan)
        bias = y - np.einsum("nij,nj->ni", C, course)
        ahead = np.vstack([r, r[-1:]])  # of now, which nothing moves any more, and of the N samples to come
        end, P = C[N], np.zeros((nx + nu, nx + nu))
        P[:nx, :nx] = end.T @ self._Q @ end
        target = np.linalg.pinv(end) @ (ahead[N] - bias[N])
        condensed = condense(
            M, np.ascontiguousarray(pushed), np.ascontiguousarray(bias), np.array(x), ahead, np.array(last),
            (target, np.zeros(nu)), (self._Q, self._S, np.zeros((nu, nu)), P),
        )  # fmt: skip
        return Program(*with_limits(condensed, self._reach(last), self._way, self._soft, TINY))

    @cached_property
    def _along(self) -> ca.Function:
        """(x, inputs (nu, N)) -> the states that follow (nx, N), and the Jacobians of every step side by side."""
        model, N = self.observer.model, self.horizon
        x, u = ca.MX.sym("x", len(self.plant.states)), ca.MX.sym("u", len(self.actuated), N)
        after = model.step.mapaccum(N)(x, u)
        _, A, B = model.linear.map(N)(ca.horzcat(x, after[:, :-1]), u)
        return ca.Function("along", [x, u], [after, A, B])

    def _outputs(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Controlled outputs (n, ny) at states x (nx, n), and their Jacobians (n, ny, nx)."""
        n = x.shape[1]
        y, C = (np.array(a) for a in self.observer.model.seen.map(n)(x))
        return y.T[:, self._at], C.reshape(len(y), n, len(x)).transpose(1, 0, 2)[:, self._at]

    @cached_property
    def _at(self) -> list[int]:
        """Where the controlled outputs stand among all of the plant."""
        return [self.plant.output_names.index(name) for name in self.controlled]

    # ---- the program itself -----------------------------------------------------------------------------------------------

    def _by_ipopt(self, last: np.ndarray, x: np.ndarray, d: np.ndarray, r: np.ndarray, plan: np.ndarray) -> np.ndarray | None:
        """The optimal plan, started from this one; None where IPOPT does not say that it has converged."""
        solve, N, soft = self._nonlinear_program, self.horizon, self._soft[2]
        course = np.array(self._along(x, (plan + d).T)[0])
        if not np.isfinite(course).all():
            return None
        low, high = self._reach(last)
        states, slacks = np.full(course.size, np.inf), np.zeros(len(soft))
        way, far = np.tile(self._way, N - 1), np.full(N * len(soft), np.inf)
        y_low, y_high = (np.tile(limit[soft], N) for limit in (self.y_low, self.y_high))
        answer = solve(
            x0=np.concatenate([plan.ravel(), course.T.ravel(), slacks]),
            p=np.concatenate([x, d, last, np.vstack([r[1:], r[-1:]]).ravel()]),
            lbx=np.concatenate([low.ravel(), -states, slacks]), ubx=np.concatenate([high.ravel(), states, slacks + np.inf]),
            lbg=np.concatenate([np.zeros(course.size), -way, -far, y_low]),
            ubg=np.concatenate([np.zeros(course.size), way, y_high, far]),
        )  # fmt: skip
        return np.array(answer["x"])[: plan.size, 0].reshape(plan.shape) if solve.stats()["success"] else None

    @cached_property
    def _nonlinear_program(self) -> ca.Function:
        """Variables: commands, states after them, slacks. Rows: the equation, moves, upper and lower limits of outputs."""
        N, nx, nu, ny = self.horizon, len(self.plant.states), len(self.actuated), len(self.controlled)
        model, (_, _, soft, prices) = self.observer.model, self._soft
        u, x, s = ca.MX.sym("u", nu, N), ca.MX.sym("x", nx, N), ca.MX.sym("s", len(soft))
        x0, d, last, r = ca.MX.sym("x0", nx), ca.MX.sym("d", nu), ca.MX.sym("last", nu), ca.MX.sym("r", ny, N)
        y = model.seen.map(N)(x)[0][self._at, :]
        moves = ca.horzcat(u[:, 0] - last, u[:, 1:] - u[:, :-1])
        Q, S, linear, squared = (ca.DM(weight) for weight in (self.weights.outputs, self.weights.moves, *prices))
        cost = 0.5 * (ca.dot(Q, ca.sum2((y - r) ** 2)) + ca.dot(S, ca.sum2(moves**2)) + ca.dot(squared, s**2)) + ca.dot(linear, s)
        follows = x - model.step.map(N)(ca.horzcat(x0, x[:, :-1]), u + ca.repmat(d, 1, N))
        above, below = y[soft.tolist(), :] - ca.repmat(s, 1, N), y[soft.tolist(), :] + ca.repmat(s, 1, N)
        rows = (follows, moves[:, 1:], above, below)
        program = {
            "x": ca.vertcat(ca.vec(u), ca.vec(x), s), "p": ca.vertcat(x0, d, last, ca.vec(r)), "f": cost,
            "g": ca.vertcat(*(ca.vec(row) for row in rows)),
        }  # fmt: skip
        quiet = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False, "error_on_fail": False}
        assert isinstance(self.solver, Ipopt)
        limits = {"ipopt.tol": self.solver.tolerance, "ipopt.max_iter": self.solver.iterations}
        return ca.nlpsol("nmpc", "ipopt", program, quiet | limits)


def default_weights(model: SampledPlant, controlled: tuple[str, ...], horizon: int, move: float = 0.003) -> Weights:
    """An output counts in units of what unit inputs move it within the horizon at the start; move: price of a unit move."""
    x, u = model.start
    _, A, B = (np.array(a) for a in model.linear(x, u[model.at]))
    C, moved = np.array(model.seen(x)[1]), np.zeros_like(B)
    for _ in range(horizon):
        moved = A @ moved + B
    scale = np.linalg.norm((C @ moved)[[model.plant.output_names.index(name) for name in controlled]], axis=1)
    nu, file = len(model.actuated), model.plant.name
    return weights_by(scale, controlled, nu, move, when="within the horizon", file=file, mend="a longer horizon?")


def design_nmpc(
    plant: Plant,
    fallback: ScheduledPID,
    *,
    base: str | None = None,
    horizon: int = 20,
    weights: Weights | None = None,
    low: np.ndarray | None = None,
    high: np.ndarray | None = None,
    rate: np.ndarray | None = None,
    y_low: np.ndarray | None = None,
    y_high: np.ndarray | None = None,
    solver: Solver | None = None,
) -> NMPC:
    """A nonlinear MPC on `plant` for the channels of the fallback law. Limits default to those of that law, outputs to none.

    base: where a file is to find the plant, default its name. weights default: `default_weights`.
    """
    return NMPC(
        plant=plant, base=base or plant.name, actuated=fallback.actuated, controlled=fallback.measured, fallback=fallback,
        weights=weights or default_weights(SampledPlant(plant, fallback.actuated), fallback.measured, horizon), horizon=horizon,
        solver=solver or RealTimeIteration(), **limits_with(fallback, low=low, high=high, rate=rate, y_low=y_low, y_high=y_high),
    )  # fmt: skip
