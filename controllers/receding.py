"""What laws that plan ahead share: weights, limits, the quadratic program and its solvers, and what is done when none answers.

Every answer carries a status. Where the first solver has none, a second is asked; then the last plan goes on as long as it
lasts; then a PID takes over. A command is never NaN and never outside its limits. Limits of the commands are hard, those of the
outputs give way at a price.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from enum import Enum
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from controllers.scheduled_pid import SHAPED_VERSION, ScheduledPID, check_limits, finite, unlimited
from workbench.data import SAME_DT
from workbench.errors import InputError
from workbench.records import field, record

LIMITS = {"low": -np.inf, "high": np.inf, "rate": np.inf, "y_low": -np.inf, "y_high": np.inf}  # and what none given means
TINY = 1e-9  # relative weight that keeps a program strictly convex


class Status(Enum):
    """Where a command came from."""

    OPTIMAL = "optimal"
    OUTSIDE_TUBE = "optimal, outside the tube"  # no plan keeps the tightened limits of outputs
    SECOND_SOLVER = "second solver"
    LAST_PLAN = "last plan"
    FALLBACK = "fallback law"


HEAVIEST = 1e100  # weight, far above any that is meant: products of heavier ones are no numbers


@record
class Weights:
    """What counts how much; each (ny,) or (nu,): errors of the outputs, moves of the commands, distance from the target.

    violation: price of a unit of an output beyond its limit, as a multiple of what the same error costs, linear and squared.
    """

    outputs: np.ndarray = field("ny", low=0.0, high=HEAVIEST)
    moves: np.ndarray = field("nu", low=0.0, high=HEAVIEST)
    inputs: np.ndarray = field("nu", low=0.0, high=HEAVIEST)
    violation: float = field("", low=0.0, high=HEAVIEST, default=1e3)


class Program(NamedTuple):
    """min 1/2 z'Hz + f'z, low <= z[:k] <= high, A z within lower and upper; bounds first in `lower` and `upper`."""

    H: np.ndarray
    f: np.ndarray
    A: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


class Plan(NamedTuple):
    """What a law keeps of its plans: commands (N, nu), how many samples ago they were found, status, the fallback law's memory.

    status None before the first sample; law None while the fallback does not command.
    """

    commands: np.ndarray
    age: int
    status: Status | None
    law: np.ndarray | None


UNPLANNED = Plan(np.empty((0, 0)), 0, None, None)


class Receding:
    """A law with these fields; rate [1/s], limits infinite where there is none."""

    weights: Weights
    horizon: int
    low: np.ndarray
    high: np.ndarray
    rate: np.ndarray
    y_low: np.ndarray
    y_high: np.ndarray
    fallback: ScheduledPID
    name: str

    @property
    def dt(self) -> float:
        raise NotImplementedError

    def check(self, actuated: Sequence[str], controlled: Sequence[str]) -> None:
        """Refuse a horizon, limits or a fallback law that do not fit channels of these names."""
        if not isinstance(self.horizon, int) or isinstance(self.horizon, bool) or self.horizon < 1:
            raise InputError(f"horizon {self.horizon}", file=self.name, mend="a whole number of samples; 10 to 40 are usual")
        if abs(self.fallback.dt - self.dt) > SAME_DT * self.dt:
            raise InputError(
                f"the fallback law runs every {self.fallback.dt:g} s, this one every {self.dt:g} s",
                file=self.name, mend="design it on a model of records sampled so",
            )  # fmt: skip
        for channels, low, high in ((actuated, self.low, self.high), (controlled, self.y_low, self.y_high)):
            check_limits(self.name, channels, low, high)
        if (self.fallback.actuated, self.fallback.measured) != (tuple(actuated), tuple(controlled)):
            raise InputError(
                f"the fallback law goes from {', '.join(self.fallback.measured)} to {', '.join(self.fallback.actuated)}",
                file=self.name, mend=f"design one that goes from {', '.join(controlled)} to {', '.join(actuated)}",
            )  # fmt: skip

    def common_dict(self) -> dict[str, Any]:
        """What the files of all such laws hold."""
        limits = {key: finite(getattr(self, key)) for key in LIMITS}
        fallback = self.fallback.to_dict()
        rest: dict[str, Any] = {"weights": vars(self.weights), "fallback": fallback}
        version = fallback.get("version", SHAPED_VERSION)
        rest |= {"version": version} if version > SHAPED_VERSION else {}
        return {"name": self.name, "horizon": self.horizon, **limits, **rest}

    def _solved(self, program: Program) -> tuple[np.ndarray | None, Status]:
        """Commands (N, nu) of a program, or None where no solver has an answer that its limits confirm."""
        for solver, status in ((solved_by_daqp, Status.OPTIMAL), (solved_by_clarabel, Status.SECOND_SOLVER)):
            answer = solver(program)
            if answer is not None:
                nu = len(self.low)
                return answer[: self.horizon * nu].reshape(-1, nu), status
        return None, Status.FALLBACK

    def _acted(
        self,
        last: np.ndarray,
        before: Plan,
        found: np.ndarray | None,
        status: Status,
        r: np.ndarray,
        y: np.ndarray,
        rho: float | None,
    ) -> tuple[np.ndarray, Plan]:
        """The command of this sample from what was found, if anything, and what to remember; last: the command before."""
        (low, *_), (high, *_) = self._reach(last)
        if found is not None:
            return np.clip(found[0], low, high), Plan(found, 0, status, None)
        if before.age + 1 < len(before.commands):
            age = before.age + 1
            return np.clip(before.commands[age], low, high), Plan(before.commands, age, Status.LAST_PLAN, None)
        law = self._backup.init(last) if before.law is None else before.law
        wanted, after = self._backup.step(law, r, np.where(np.isfinite(y), y, r), rho)
        return np.clip(wanted, low, high), Plan(UNPLANNED.commands, 0, Status.FALLBACK, after)

    @cached_property
    def _backup(self) -> ScheduledPID:
        """The fallback law within the limits of this one too, so that its integral does not run away behind them."""
        low, high = np.maximum(self.fallback.low, self.low), np.minimum(self.fallback.high, self.high)
        own = low < high
        rate = np.minimum(self.fallback.rate, self.rate)
        return replace(self.fallback, low=np.where(own, low, self.low), high=np.where(own, high, self.high), rate=rate)

    def _reach(self, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest commands (N, nu): the limits, or where the rate lets one come from outside of them."""
        way = self._ways
        low, high = np.minimum(self.low, last + way), np.maximum(self.high, last - way)
        low[0], high[0] = np.maximum(low[0], last - way[0]), np.minimum(high[0], last + way[0])
        return low, high

    @cached_property
    def _Q(self) -> np.ndarray:
        return np.diag(self.weights.outputs)

    @cached_property
    def _S(self) -> np.ndarray:
        return np.diag(self.weights.moves)

    @cached_property
    def _way(self) -> np.ndarray:
        """Largest move in a sample, (nu,)."""
        return self.rate * self.dt

    @cached_property
    def _ways(self) -> np.ndarray:
        """Largest moves by the samples of the horizon, (N, nu)."""
        return self._way * np.arange(1, self.horizon + 1)[:, None]

    @cached_property
    def _soft(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Limits of the outputs, which of them have any, and their prices (linear, squared)."""
        soft = np.nonzero(np.isfinite(self.y_low) | np.isfinite(self.y_high))[0]
        cost = np.where(self.weights.outputs > 0.0, self.weights.outputs, 1.0)[soft]
        prices = self.weights.violation * np.stack([np.sqrt(cost), cost])
        return self.y_low.copy(), self.y_high.copy(), soft, prices


def common_fields(content: dict[str, Any]) -> dict[str, Any]:
    """The fields that `common_dict` wrote."""
    limits = {key: unlimited(content[key], none) for key, none in LIMITS.items()}
    rest = {"weights": Weights(**content["weights"]), "fallback": ScheduledPID.from_dict(content["fallback"])}
    return {"name": content["name"], "horizon": content["horizon"], **limits, **rest}


def limits_with(fallback: ScheduledPID, **given: np.ndarray | None) -> dict[str, Any]:
    """All limits by name: those given, else for commands those of the fallback law and for outputs none."""
    found = {}
    for key, none in LIMITS.items():
        own = given[key]
        if key in ("y_low", "y_high"):
            found[key] = np.broadcast_to(none if own is None else own, len(fallback.measured))
        else:
            found[key] = getattr(fallback, key) if own is None else own
    return found


def weights_by(scale: np.ndarray, names: Sequence[str], nu: int, move: float, *, when: str, file: str, mend: str) -> Weights:
    """Outputs count in units of `scale` (ny,), what unit inputs move them; move: price of a unit move. Refuses a scale of 0."""
    if not 0.0 < move < np.inf:
        raise InputError(f"move {move:g}", mend="the price of moving a command: a number above 0, 0.003 is usual")
    if not np.all(scale > 0.0):
        raise InputError(f"no input moves it {when}", file=file, channel=names[int(scale.argmin())], mend=mend)
    return Weights(1.0 / scale**2, np.full(nu, move), np.zeros(nu))


def count_statuses(memories: Iterable[Any]) -> dict[str, int]:
    """How often each status stood behind a command."""
    return dict(Counter(memory.status.value for memory in memories))


def solved_by_daqp(program: Program) -> np.ndarray | None:
    """The answer of DAQP where it says optimal and the limits confirm it, else None."""
    import daqp

    upper, lower = np.minimum(program.upper, 1e30), np.maximum(program.lower, -1e30)
    x, _, flag, _ = daqp.solve(program.H, program.f, program.A, upper, lower)
    return _believed(program, np.asarray(x)) if flag == 1 else None


def solved_by_clarabel(program: Program) -> np.ndarray | None:
    """The answer of Clarabel where it says solved and the limits confirm it, else None."""
    import clarabel as compiled  # its names are not visible to the type checker
    from scipy import sparse

    clarabel: Any = compiled
    n = len(program.f)
    bounds = len(program.lower) - len(program.A)
    rows = np.vstack([np.eye(n)[:bounds], program.A])
    above, below = np.isfinite(program.upper), np.isfinite(program.lower)
    A = sparse.csc_matrix(np.vstack([rows[above], -rows[below]]))
    b = np.concatenate([program.upper[above], -program.lower[below]])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    try:
        P = sparse.csc_matrix(np.triu(program.H))
        answer = clarabel.DefaultSolver(P, program.f, A, b, [clarabel.NonnegativeConeT(len(b))], settings).solve()
    except Exception:  # numbers that are none: the solver panics, the loop must not
        return None
    return _believed(program, np.array(answer.x)) if answer.status == clarabel.SolverStatus.Solved else None


def _believed(program: Program, x: np.ndarray) -> np.ndarray | None:
    """x where it is finite and keeps the limits, to a millionth of their size."""
    from controllers.condensing import kept

    return x if kept(program.A, x, program.lower, program.upper, 1e-6) else None
