"""From an identified LPV model to a scheduled PID whose frozen loops keep their bounds over the whole schedule.

First every knot alone, which says what can be reached there; then one program for all, with the surface's coefficients as
variables. The goal is the least variance of the outputs (`controllers.variance`), or the most integral action, at every point as
near as it can be to what is reached there alone (`controllers.tuning`). Then the margins are computed anew, between all
frequencies and four times finer in the schedule; where they fail, the point and the frequency join the program. A law that does
not keep its bounds there is refused.

Frozen margins say nothing about a schedule that moves fast; that is a matter of robustness, not of this design.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from controllers.scheduled_pid import ScheduledPID, parts
from controllers.tuning import Task, Tuning, tune
from controllers.variance import Disturbed, Variance, quietest
from workbench import steady
from workbench.basis import CONSTANT, Basis, PiecewiseLinear, Products
from workbench.data import Channel
from workbench.errors import InputError, check_known
from workbench.lpv import LPVModel, check_schedule_from_outside, mesh, one_or_all
from workbench.records import field, record
from workbench.robustness.frozen import DEFAULT, PEAKS, Bounds, Margins, around, frequencies, resonant, worst_margins

KNOTS, FEWER = 5, 3  # over one schedule variable, over each of several
BETWEEN = 4  # schedule values checked per value in the program
ROOM = 5e-3  # by which the programs keep the bounds more than asked, for what lies between
ENOUGH, REFINED = 2e-3, 1e-2  # gain of a step below which a design is done; a refined one
REFINEMENTS = 6
OBJECTIVES = ("variance", "integral")  # least variance under noise and load steps; most integral action
# a usual load step moves the outputs by so many times what the one-step error is, in units of their scales, or is this share of
# what the input's limits leave, whichever is larger; one comes every so many times as long as the machine takes to settle
VISIBLE, SHARE, RARE = 4.0, 0.01, 10.0
SHARES = 1.0, 0.5, 0.2, 0.05  # of the law with most integral action, from where the least variance is sought
LEFT, POINTS = 0.05, 1000  # of a step response when it has settled; samples of it that are looked at

Say = Callable[[str], None]


@record
class Loads:
    """Steps of the inputs (nu,) that a design reckons with, each one on average every so many seconds."""

    size: np.ndarray = field("nu", low=0.0)
    every: float = field("", unit="s", low=1e-12)


@record
class FrozenPoint:
    """x+ = A x + B u + K e, y = C x + D u + e, e of covariance `noise`: the model at one schedule value, its frequency response
    with outputs in units of `scale`. free: whether the model integrates or is unstable anywhere.
    """

    rho: Any
    dt: float = field("", unit="s")
    A: np.ndarray = field("nx nx")
    B: np.ndarray = field("nx nu")
    C: np.ndarray = field("ny nx")
    D: np.ndarray = field("ny nu")
    scale: np.ndarray = field("ny")
    K: np.ndarray = field("nx ny")
    noise: np.ndarray = field("ny ny")
    free: bool = False

    @property
    def scaled(self) -> tuple[np.ndarray, np.ndarray]:
        """C and D with outputs in units of `scale`."""
        return self.C / self.scale[:, None], self.D / self.scale[:, None]

    def disturbed(self, loads: Loads) -> Disturbed:
        """With noise and load steps, outputs in units of `scale`."""
        noise = self.noise / np.outer(self.scale, self.scale)
        return Disturbed(self.A, self.B, *self.scaled, self.K * self.scale, noise, loads.size**2 * self.dt / loads.every)

    def response(self, omega: np.ndarray) -> np.ndarray:
        """C (exp(j omega dt) - A)^-1 B + D, (N, ny, nu)."""
        z = np.exp(1j * np.asarray(omega) * self.dt)
        x = np.linalg.solve(z[:, None, None] * np.eye(len(self.A)) - self.A, self.B)
        return (self.C @ x + self.D) / self.scale[:, None]

    @property
    def gain(self) -> np.ndarray:
        """P(0), or what tells as much where that does not exist; see `workbench.steady`."""
        return steady.gain(self.A, self.B, *self.scaled, self.free)

    def held(self, entries: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Kr, Ka [s] and Kaa [s^2] (nu, ny): u = Kr r + Ka r' + Kaa r'' makes outputs follow a slow r(t) at the samples, but for
        what changes of r'' do; set-point j moves the inputs at which entries[:, j] is true, and outputs follow as near as these
        let them.

        At the samples r rises by dt r' + dt^2 r'' / 2 and r' by dt r'': states X0 r + X1 r' + X2 r'' rise by dt X0 r' and so on.
        """
        (C, D), dt = self.scaled, self.dt
        Kr, Ka, Kaa = (np.zeros(entries.shape) for _ in range(3))
        for j, own in enumerate(entries.T):
            plant = self.A, self.B[:, own], C, D[:, own]
            X, U = steady.rests(*plant)
            X1, U1 = steady.follows(*plant, dt * X[:, j : j + 1])
            U2 = steady.follows(*plant, dt * X1 + 0.5 * dt**2 * X[:, j : j + 1])[1]
            Kr[own, j], Ka[own, j], Kaa[own, j] = U[:, j], U1[:, 0], U2[:, 0]
        return Kr / self.scale, Ka / self.scale, Kaa / self.scale

    @property
    def settling(self) -> float:
        """Seconds after which every step response stays within LEFT of where it ends, of a slow one at every so many samples; of
        a plant that integrates what a loop about it may take.
        """
        if self.free:
            return self.dt * np.log(1.0 / LEFT) / steady.BEYOND
        samples = np.log(1e-3) / np.log(np.clip(np.abs(np.linalg.eigvals(self.A)).max(initial=0.0), 1e-3, 1.0 - 1e-9))
        every, x = steady.dying(self.A, np.linalg.solve(np.eye(len(self.A)) - self.A, self.B), samples, POINTS)
        late = np.any(np.abs(self.scaled[0] @ x) > LEFT * np.abs(self.gain), axis=(1, 2))
        return self.dt * every * (POINTS - int(np.argmax(late[::-1])) if late.any() else 1)


@record
class PIDDesign:
    """A scheduled PID, its margins on the refined grid, and what each knot alone would reach.

    knots (n), of several schedule variables (n, ns). low_frequency (n): sigma_min(P(0) Ki) [1/s] at the knots; alone (n): the
    same of the law for that knot only. scale (ny): what the outputs were counted in. Ka [s], Kaa [s^2]: feedforward of the rates
    and accelerations of set-points, for when the law is given reference models or paths. deviation, least (n, ny): standard
    deviations of the outputs at the knots under noise and `loads`, and under the linear law, of whatever order and margins, that
    makes the sum of their squares least, outputs in units of `scale`; None where outputs see the command of their own sample.
    unmoved (n, ny): the first of these under the best law within the bounds whose gains do not move with the schedule; None where
    there is none, or none was sought.

        >>> found = ScheduledPIDDesign(sensitivity=1.4, knots=3).design(model)
        >>> f"largest |S| {found.margins.sensitivity.max():.1f} at {len(found.margins.rho)} schedule values"
        'largest |S| 1.2 at 17 schedule values'
    """

    law: ScheduledPID
    objective: str
    bounds: Bounds
    margins: Margins
    knots: np.ndarray = field("n ...")
    low_frequency: np.ndarray = field("n")
    alone: np.ndarray = field("n")
    scale: np.ndarray = field("ny")
    Ka: np.ndarray = field("m nu ny", unit="s")
    Kaa: np.ndarray = field("m nu ny", unit="s^2")
    loads: Loads = field()
    deviation: np.ndarray = field("n ny")
    least: np.ndarray | None = None
    unmoved: np.ndarray | None = None

    @property
    def gained(self) -> float:
        """What moving gains take off the outputs' standard deviations, as a share, root mean square over knots and outputs; NaN
        where no law whose gains stand still is known.
        """
        if self.unmoved is None:
            return np.nan
        ratio = np.sum((self.deviation / self.scale) ** 2) / np.sum((self.unmoved / self.scale) ** 2)
        return 1.0 - float(np.sqrt(ratio))

    def following(
        self, bandwidth: np.ndarray | float, slew: np.ndarray | float = np.inf, paths: np.ndarray | bool = False
    ) -> ScheduledPID:
        """The law with reference models of this bandwidth (ny,) [rad/s], infinite for none, and slew limits (ny,) [1/s]; paths
        (ny,): set-points without a reference model whose rates and accelerations are fed forward.

        What is fed forward makes the outputs follow m, and the PID acts on m - y, its derivative too: it does not brake them. The
        difference of a path is its rate half a sample ago. Margins are the same: all of this is before the loop.
        """
        modelled = np.isfinite(bandwidth)
        paths = np.logical_and(paths, ~modelled)
        followed = np.broadcast_to(modelled | paths, self.law.c.shape)
        Ka, Kaa = self.Ka * followed, (self.Kaa + 0.5 * self.law.dt * self.Ka * paths) * followed
        return replace(self.law, bandwidth=bandwidth, slew=slew, Ka=Ka, Kaa=Kaa, c=1.0 * followed)


@record
class Structure:
    """What the law may look like: derivative part or not, filter time constant, entries of the gain matrices, weights, limits.

    Tf None: two samples. allowed (nu, ny): entries that may differ from 0. b: set-point weight of the proportional part.
    feedforward: Kr = P(0)^-1 commands what holds the set-point before there is an error; where entries must be 0, what comes
    nearest to it. moving: whether Kp, Ki and Kd move with the schedule, or feedforward alone.
    """

    derivative: bool = True
    Tf: float | None = None
    allowed: np.ndarray | None = None
    b: float = field("", low=0.0, high=1.0, default=1.0)
    feedforward: bool = True
    moving: bool = True
    low: np.ndarray | None = None
    high: np.ndarray | None = None
    rate: np.ndarray | None = None


def design_pid(
    model: LPVModel,
    *,
    knots: int | Sequence[Any] | None = None,
    bounds: Bounds = DEFAULT,
    structure: Structure | None = None,
    setpoint: Sequence[float] | np.ndarray | None = None,
    robust_to: Sequence[LPVModel] = (),
    scale: np.ndarray | None = None,
    objective: str = "variance",
    load: np.ndarray | None = None,
    load_every: float | None = None,
    say: Say = lambda _: None,
) -> PIDDesign:
    """A scheduled PID for `model` whose frozen loops keep `bounds` over the schedule range, for every model in `robust_to` too.

    knots: how many over the range, or their values; of several schedule variables one number for all or an entry for each, and
    the gains are linear in each between the points of their lattice. One knot, or a model without schedule, gives a fixed PID,
    tuned there and checked there. Default: KNOTS over one variable, FEWER over each of several. setpoint (ny,): the usual
    set-point, which the law holds without its integral; default: the operating point's. scale (ny,): outputs that
    count as equally large; default, also where it is NaN: what unit inputs move in the middle of the range.

    objective: "variance", the least sum of the squares of the outputs, in units of `scale`, under the model's noise and steps of
    its inputs of sizes `load` (nu,), one of each every `load_every` s on average; or "integral", the most integral action. Where
    no load or time is given (None, NaN) they are usual ones, see VISIBLE.

    Models that integrate, or are unstable, are designed for too; their P(0) is what `workbench.steady` says.
    Raises InputError where an output cannot be moved, or where no law keeps the bounds.
    """
    for own in (model, *robust_to):
        check_schedule_from_outside(own, "the design of a PID")
    if len(model.inputs) > len(model.outputs):
        names = ", ".join(c.name for c in model.inputs)
        mend = "identify it with as many inputs as outputs, or workbench design mpc"
        said = f"{len(model.inputs)} inputs ({names}) for {len(model.outputs)} outputs: integrals would drift against each other"
        raise InputError(said, file=model.name, mend=mend)
    axes = _knots(model, knots)
    check_known("objective", objective, OBJECTIVES)
    plan = _Plan(model, (model, *robust_to), axes, structure or Structure(), bounds, scale, load, load_every)
    grid, quiet = plan.grid, objective == "variance"
    held = plan.held(setpoint)
    if quiet and not (plan.loads.size.any() or np.any(plan.points[0].noise)):
        mend = "give a --load, or --objective integral"
        raise InputError("neither noise nor a load step moves it: no variance is the least", file=model.name, mend=mend)
    plan.law(np.zeros((2, len(grid), len(model.inputs), len(model.outputs))), held)  # refuses limits that cross, before any work
    omega = plan.frequencies()
    alone, knots = [], []
    for rho in grid:
        tuning, variance = plan.program([rho], np.ones((1, 1)), omega)
        first = tune(tuning, enough=ENOUGH)
        alone.append(first.low_frequency.min())
        starts = [*(share * first.X for share in SHARES), *knots[-1:]]
        found = quietest(variance, Task(tuning), starts) if quiet else None
        knots.append(first.X if found is None else found)
        say(f"{plan.place(rho)}: up to {alone[-1]:.3g} 1/s of integral action")
    still, also = None, []
    if quiet and len(grid) > 1 and plan.structure.moving:
        unmoving = copy(plan)
        unmoving.structure = replace(plan.structure, moving=False)
        with suppress(InputError):  # no gains keep the bounds everywhere
            still = _kept(unmoving, held, knots, np.array(alone), omega, quiet)
            also = [np.repeat(still.X, len(grid), axis=1)]  # a special case, than which nothing ends worse
    starts = [*also, np.concatenate(knots, axis=1)] if plan.structure.moving else knots
    found = _kept(plan, held, starts, np.array(alone), omega, quiet, say)
    unmoved = None if still is None else plan.deviations(still.X)[0]
    return PIDDesign(
        found.law, objective, bounds, found.margins, grid, plan.low_frequency(found.law), np.array(alone), plan.scale,
        *plan.followed[2:], plan.loads, *plan.deviations(found.X), unmoved,
    )  # fmt: skip


class _Kept(NamedTuple):
    X: np.ndarray
    law: ScheduledPID
    margins: Margins


def _kept(
    plan: "_Plan", held: np.ndarray, starts: Sequence[np.ndarray], alone: np.ndarray, omega: np.ndarray, quiet: bool,
    say: Say = lambda _: None,
) -> _Kept:  # fmt: skip
    """Gains for all of the schedule, from the best of `starts`, refined until margins are kept between the knots too.

    Raises InputError where they are not.
    """
    lines = _finer(plan.axes, 2)
    rhos, path = mesh(lines), starts
    for attempt in range(REFINEMENTS):
        if len(plan.grid) > 1 or attempt:
            goals = np.exp(plan.hats(rhos) @ np.log(alone))
            tuning, variance = plan.program(rhos, plan.basis(rhos), omega, goals)
            path = _improved(
                tuning, variance if quiet else None, path, path[-1:] if attempt else starts, REFINED if attempt else ENOUGH
            )
        law, checked = plan.law(X := path[-1], held), mesh(_finer(lines, BETWEEN))
        margins = plan.margins(law, checked)
        bad = margins.broken(plan.bounds)
        if not bad.any():
            say(f"{len(checked)} schedule values checked: |S| at most {margins.sensitivity.max():.3f}")
            return _Kept(X, law, margins)
        say(f"bounds broken at {bad.sum()} of {len(checked)} schedule values between: refined")
        worst = plan.worst(margins, lines)
        rhos = np.unique(np.concatenate([rhos, checked[worst]]), axis=0)
        if len(lines) == 1:  # a lattice through what is between several lines would grow with its number squared
            lines = (rhos,)
        omega = np.unique(np.concatenate([omega, margins.frequencies[worst].ravel()]))
    raise InputError(
        f"after {REFINEMENTS} refinements the loop still breaks its bounds at {plan.place(checked[bad][0])}: "
        f"|S| {margins.sensitivity[bad][0]:.3f}, |T| {margins.complementary[bad][0]:.3f}, effort {margins.effort[bad][0]:.3f}, "
        f"largest pole {margins.radius[bad][0]:.4f}",
        file=plan.model.name,
        mend="loosen the bounds, or give more knots" if plan.structure.moving else "loosen the bounds, or let the gains move",
    )


def _improved(
    tuning: Tuning, variance: Variance | None, path: Sequence[np.ndarray], starts: Sequence[np.ndarray], enough: float
) -> Sequence[np.ndarray]:
    """Gains within the bounds: of least variance from these starts, else of most integral action from the last of `path` on."""
    task = Task(tuning)
    if variance and (found := quietest(variance, task, starts)) is not None:
        return [found]
    path = list(tune(tuning, starts=path[::-1], enough=enough).path)
    return [found] if variance and (found := quietest(variance, task, path[-1:])) is not None else path


def _interface(model: LPVModel) -> tuple:
    """What two models must share for one law: channels with their units, the schedule among them, and the sample time."""
    channels = (model.inputs, model.outputs, model.schedules)
    return *([str(c) for c in own] for own in channels), model.dt


def _knots(model: LPVModel, knots: int | Sequence[Any] | None) -> tuple[np.ndarray, ...]:
    """Values of each schedule variable at which the surface has its coefficients, and one value without schedule."""
    ns = len(model.schedules)
    if ns == 0:
        return (np.zeros(1),)
    if knots is None:
        knots = KNOTS if ns == 1 else FEWER
    each = [knots] * ns if isinstance(knots, int) else [knots] if ns == 1 else list(knots)
    if len(each) != ns:
        names = ", ".join(c.name for c in model.schedules)
        raise InputError(f"{len(each)} numbers of knots", file=model.name, mend=f"one for all, or one for each of {names}")
    return tuple(_along(c, span, own, model.name) for c, span, own in zip(model.schedules, model.spans, each, strict=True))


def _along(schedule: Channel, span: np.ndarray, knots: int | Sequence[float], file: str) -> np.ndarray:
    """The knots over one schedule variable."""
    low, high = span
    if isinstance(knots, int):
        if knots < 1:
            raise InputError(f"{knots} knots", mend="one knot is a fixed PID, two a straight line")
        return np.linspace(low, high, knots) if knots > 1 else np.array([0.5 * (low + high)])
    given = np.unique(np.asarray(knots, dtype=float))
    if len(given) == 0 or given[0] < low or given[-1] > high:
        known = f"the model knows {schedule.name} from {low:g} to {high:g} {schedule.unit}".rstrip()
        raise InputError(f"knots {given.tolist()}", file=file, mend=known)
    return given


def _finer(axes: Sequence[np.ndarray], parts: int) -> tuple[np.ndarray, ...]:
    """Every gap between two values of a variable in so many parts."""
    share = np.arange(parts) / parts
    return tuple(np.append((own[:-1, None] + np.diff(own)[:, None] * share).ravel(), own[-1]) for own in axes)


class _Plan:
    """A design under way: the models, where the surface has its coefficients, and what the law may look like."""

    def __init__(
        self, model: LPVModel, models: Sequence[LPVModel], axes: Sequence[np.ndarray], structure: Structure, bounds: Bounds,
        scale: np.ndarray | None, load: np.ndarray | None, load_every: float | None,
    ):  # fmt: skip
        self.model, self.models, self.structure, self.bounds = model, models, structure, bounds
        self.axes, self.grid = axes, mesh(axes)
        grid = self.grid
        for other in models:
            if _interface(other) != _interface(model):
                raise InputError("other inputs, outputs, schedule or sample time than the first model", file=other.name)
        self.fixed = len(grid) == 1
        shape = len(model.inputs), len(model.outputs)
        self.entries = np.ones(shape, dtype=bool) if structure.allowed is None else np.asarray(structure.allowed, dtype=bool)
        middle = np.array([self.frozen(model, rho, np.ones(len(model.outputs))).gain for rho in grid]).mean(axis=0)
        usual = np.linalg.norm(middle, axis=1)
        self.scale = usual if scale is None else np.where(np.isnan(scale), usual, scale)
        if not np.all(self.scale > 0.0):
            dead = model.outputs[int(np.argmin(self.scale))].name
            raise InputError("no input moves it in the steady state", file=model.name, channel=dead, mend="leave this output out")
        self.Tf = 2.0 * model.dt if structure.Tf is None else structure.Tf
        self.loads = self._loads(load, load_every)

    @cached_property
    def points(self) -> list[FrozenPoint]:
        """The model alone at every knot."""
        return [self.frozen(self.model, rho, self.scale) for rho in self.grid]

    def frequencies(self) -> np.ndarray:
        """Where the programs look: evenly, and around what a plant resonates at."""
        poles = np.concatenate(
            [np.linalg.eigvals(m.freeze(rho if m.schedules else None)[0]) for m in self.models for rho in self.grid]
        )
        return np.union1d(frequencies(self.model.dt), around(resonant(poles), self.model.dt))

    def place(self, rho: Any) -> str:
        return self.model.named(rho) or self.model.name

    def frozen(self, model: LPVModel, rho: Any, scale: np.ndarray) -> FrozenPoint:
        at = rho if model.schedules else None
        return FrozenPoint(at, model.dt, *model.freeze(at), scale, *model.disturbance(at), model.free)

    def parts(self, omega: np.ndarray) -> np.ndarray:
        return parts(omega, self.model.dt, self.Tf)[:, : 3 if self.structure.derivative else 2]

    def surface(self) -> Basis:
        """The functions whose coefficients are the gains at the knots."""
        factors = tuple(PiecewiseLinear(own) for own in self.axes)
        return CONSTANT if self.fixed else factors[0] if len(factors) == 1 else Products(factors)

    def hats(self, rhos: np.ndarray) -> np.ndarray:
        """Weights (n, m) of what is known at the knots."""
        return np.ones((len(rhos), 1)) if self.fixed else self.surface()(rhos)

    def basis(self, rhos: np.ndarray) -> np.ndarray:
        """Weights of the gains' coefficients: those of the knots, or one for gains that do not move."""
        return self.hats(rhos) if self.structure.moving else np.ones((len(rhos), 1))

    def program(self, rhos, weights, omega, goals=None) -> tuple[Tuning, Variance]:
        """What one design tunes, every model at every one of these schedule values, and the variance there."""
        n = len(self.models)
        plants = [self.frozen(model, rho, self.scale) for rho in rhos for model in self.models]
        weights = np.repeat(weights, n, axis=0)
        variance = self.variance(plants, weights)

        def closed(X: np.ndarray) -> np.ndarray | None:
            poles = variance.poles(X).ravel()
            return around(resonant(poles), self.model.dt) if np.abs(poles).max() < 1.0 else None

        tuning = Tuning(
            plants, weights, self.parts, omega, self.bounds, goals=None if goals is None else np.repeat(goals, n),
            allowed=self.structure.allowed, closed=closed, room=ROOM,
        )  # fmt: skip
        return tuning, variance

    # ---- noise and load steps --------------------------------------------------------------------------------------------

    def _loads(self, size: np.ndarray | None, every: float | None) -> Loads:
        """Load steps as given, the rest usual ones."""
        points = self.points
        gains = np.linalg.norm(np.mean([np.abs(own.gain) for own in points], axis=0), axis=0)
        noise = float(np.linalg.norm(np.sqrt(np.diagonal(points[0].noise)) / self.scale))
        usual = np.where(gains > 0.0, VISIBLE * (noise or 1.0) / np.where(gains > 0.0, gains, 1.0), 0.0)
        low, high = self.structure.low, self.structure.high
        if low is not None and high is not None:
            width = np.subtract(high, low)
            usual = np.maximum(usual, np.where(np.isfinite(width), SHARE * width, 0.0))
        given = usual if size is None else np.where(np.isnan(size), usual, size)
        return Loads(given, RARE * max(own.settling for own in points) if every is None else every)

    def variance(self, plants: Sequence[FrozenPoint], weights: np.ndarray) -> Variance:
        return Variance([own.disturbed(self.loads) for own in plants], weights, self.model.dt, self.Tf)

    def deviations(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Standard deviations (n, ny) of the outputs at the knots, in their units, and under the best of all linear laws.

        X: of all knots, or of gains that do not move.
        """
        weights = self.hats(self.grid) if X.shape[1] == len(self.grid) else np.ones((len(self.grid), 1))
        reached = self.variance(self.points, weights).covariance(X)
        least = [own.disturbed(self.loads).least() for own in self.points]
        spread = lambda own: self.scale * np.sqrt(np.diagonal(np.array(own), axis1=1, axis2=2))  # noqa: E731
        return spread(reached), None if any(own is None for own in least) else spread(least)

    def law(self, X: np.ndarray, held: np.ndarray) -> ScheduledPID:
        """The law with these parts; at rest at `held` (m, ny) it needs no integral."""
        model, structure = self.model, self.structure
        nu, ny, schedule = len(model.inputs), len(model.outputs), tuple(c.name for c in model.schedules)
        span = np.array([[own[0], own[-1]] for own in self.axes])
        Kp, Ki, *rest = np.broadcast_to(X, (len(X), len(self.grid), *X.shape[2:])) / self.scale
        Kr, u0 = self.steady_inputs(held)
        u0 = u0 + (1.0 - structure.b) * np.einsum("iuy,iy->iu", Kp, held)  # what Kp (b r - y) leaves there
        each = lambda given, default: np.broadcast_to(np.asarray(default if given is None else given, dtype=float), nu)  # noqa: E731
        return ScheduledPID(
            actuated=tuple(c.name for c in model.inputs),
            measured=tuple(c.name for c in model.outputs),
            references=tuple(f"{c.name}_set" for c in model.outputs),
            dt=model.dt, Kp=Kp, Ki=Ki, Kd=rest[0] if rest else np.zeros_like(Kp), Kr=Kr, u0=u0,
            b=np.full(ny, structure.b), c=np.zeros(ny),
            low=each(structure.low, -np.inf), high=each(structure.high, np.inf), rate=each(structure.rate, np.inf), Tf=self.Tf,
            basis=self.surface(), schedule=None if self.fixed else one_or_all(schedule),
            span=np.array([-np.inf, np.inf]) if self.fixed else one_or_all(span),
            name="pid" if self.fixed else "scheduled-pid",
            units=model.units,
        )  # fmt: skip

    def held(self, setpoint: Sequence[float] | np.ndarray | None) -> np.ndarray:
        """The usual set-point at every knot (m, ny): as given, or the outputs of the operating point."""
        model = self.model
        y = model.operating_point.basis(self.grid) @ model.operating_point.y
        if setpoint is not None and len(setpoint) != len(model.outputs):
            raise InputError(f"{len(setpoint)} set-points", file=model.name, mend=f"one for each of {len(model.outputs)} outputs")
        return y if setpoint is None else np.broadcast_to(np.asarray(setpoint, dtype=float), y.shape)

    @cached_property
    def followed(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """At every knot (m, nu, ny) Kr with all entries allowed, and Kr, Ka and Kaa as the structure has them."""
        whole = [own.held(np.ones_like(self.entries))[0] for own in self.points]
        Kr, Ka, Kaa = zip(*(own.held(self.entries) for own in self.points), strict=True)
        fed = self.structure.feedforward
        return np.array(whole), np.array(Kr) * fed, np.array(Ka) * fed, np.array(Kaa) * fed

    def steady_inputs(self, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Kr (m, nu, ny) and u0 (m, nu) at every knot: u0 + Kr r holds r = held (m, ny), with all entries allowed every r."""
        point = self.model.operating_point
        phi = point.basis(self.grid)
        u, y = phi @ point.u, phi @ point.y
        whole, Kr, *_ = self.followed
        return Kr, u + np.einsum("iuy,iy->iu", whole, held - y) - np.einsum("iuy,iy->iu", Kr, held)

    def low_frequency(self, law: ScheduledPID) -> np.ndarray:
        """sigma_min(P(0) Ki) at the knots, outputs in units of `scale`."""
        lows = [own.gain @ (law.gains_at(rho)[1] * self.scale) for own, rho in zip(self.points, self.grid, strict=True)]
        return np.linalg.svd(np.array(lows), compute_uv=False)[:, -1]

    # ---- what was found, checked -----------------------------------------------------------------------------------------

    def worst(self, margins: Margins, lines: Sequence[np.ndarray]) -> np.ndarray:
        """Indices of the checked schedule values that break the bounds most, one in every cell between these lines."""
        over = np.max([getattr(margins, key) / getattr(self.bounds, key) for key in PEAKS[:3]], axis=0)
        over = np.where(margins.broken(self.bounds), over, 0.0)
        columns = np.reshape(margins.rho, (-1, len(lines))).T
        cells = np.stack([np.searchsorted(line, own) for line, own in zip(lines, columns, strict=True)], axis=1)
        gap = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
        return np.array([own[over[own].argmax()] for g in np.unique(gap) if over[own := np.nonzero(gap == g)[0]].max() > 0.0])

    def margins(self, law: ScheduledPID, rhos: np.ndarray) -> Margins:
        """The worst of all models at every schedule value."""
        return worst_margins(law, self.models, list(rhos) if self.model.schedules else [None], self.bounds, self.scale)
