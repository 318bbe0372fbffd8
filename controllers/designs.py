"""Designs as records of their options with one verb: `on(model)` gives the controller.

law = ScheduledPIDDesign(sensitivity=1.6, setpoint={"w3": 100.0, "theta": 0.0}).on(model)
law = MPCDesign(low={"V1": 0.0}, high={"V1": 5.0}, keep={"theta": (-20.0, 20.0)}).on(model)

Before it is handed out the controller runs its loop once, on the plant where one is given, else on the model
(`workbench.verification.trial`): frozen margins do not say that a loop holds its machine.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from controllers.mpc import MPC, default_weights, design_mpc
from controllers.pid_design import OBJECTIVES, PIDDesign, Structure, design_pid
from controllers.receding import Weights
from controllers.scheduled_pid import ScheduledPID, check_limits, let_through
from workbench.curves import Curve
from workbench.data import Channel
from workbench.errors import InputError, NotHandedOutError, check_known
from workbench.hammerstein import HammersteinWienerModel, Model, core_of, inverted
from workbench.lpv import LPVModel
from workbench.physics.plant import Plant
from workbench.records import field, record
from workbench.robustness.frozen import DEFAULT, Bounds, largest_sensitivity
from workbench.steady import dying
from workbench.verification.trial import BAND, LONGEST, OVERSHOOT, SETTLED, Trial, tried

Numbers = Mapping[str, float]
Say = Callable[[str], None]

MODELS, FINER = 24, 0.5**0.5  # bandwidths that reference models are tried with, each so much of the one before
SLOWEST = 10.0 / LONGEST  # of 1 / dt: what has settled well before a run ends
FROZEN, POINTS = 5, 1000  # schedule values at which they are; samples of a step that are looked at
FINE = 9  # schedule values at which |S| of an MPC is looked at, where there is one variable
SLOWER = 4  # runs at most, each with reference models half as fast where the one before overshoots
MOVED = 1.0 + 1e-6  # times what the set-point itself would move a command by, that a reference model may
SUSTAINED = 0.8  # of the limits of commands, that an output of a model that integrates is moved with
PRICES = tuple(3e-3 * 10 ** np.linspace(0.0, 4.0, 33))  # of moves of an MPC, that are tried
COARSER = 4  # of them, one in so many first
NOTHING = 1e-3  # of what the proportional part makes of an error of a sample's move: a smaller feedforward of a rate is none
LATER = 1.5  # times as late as the best, from where on slower ones are not tried
ALIKE = 0.02, 1.1  # of a step, overshoots that differ by less; times to settle that differ by a factor of less


@record
class ScheduledPIDDesign:
    """The least variance of outputs under noise and load steps, with |S|, |T| and the effort of all frozen loops within bounds.

    sensitivity, complementary: largest |S|, |T|; effort: largest |Q| as a multiple of the least that is needed. knots: schedule
    values with gains of their own, their number or the values, of several schedule variables for all or for each (see
    `design_pid`); 1 is a fixed PID. low, high, rate [1/s]: limits of commands by input. setpoint: the usual one by output, which
    is held without the integral. filter [s]: of the derivative, default two samples. setpoint_weight: share of the set-point in
    the proportional part. feedforward: whether a new set-point commands at once what holds it. reference_model [rad/s]: bandwidth
    of what a set-point goes through by output, infinite for nothing; where none is given `on` chooses, see `calmed`. slew [1/s]:
    largest rate of a set-point by output, infinite for none; where none is given, what the limits keep up on a model that
    integrates. paths: outputs whose set-points come as a smooth path, of which rate and acceleration are fed forward, in place of
    reference models. steps: by output, that the law is tried with. Margins are the same with all of these. objective: "variance",
    or "integral" for the most integral action. moving: whether the gains move with the schedule, or only what is commanded at
    rest and the feedforward. load: size of load steps by input, each one on average every load_every s; size: deviations that
    count as equally large by output; see `design_pid` for what is left out. robust_to: models that must be kept too.

        >>> ScheduledPIDDesign(sensitivity=1.4, knots=3).on(model).gains_at(0.0).Kp.round(2)
        array([[0.41]])
    """

    sensitivity: float = field("", low=1.0 + 1e-9, default=1.6)
    complementary: float = field("", low=1.0 + 1e-9, default=1.6)
    effort: float = field("", low=1.0 + 1e-9, default=3.0)
    knots: int | Sequence[Any] | None = None
    low: Numbers = field(default_factory=dict)
    high: Numbers = field(default_factory=dict)
    rate: Numbers = field(default_factory=dict)
    setpoint: Numbers = field(default_factory=dict)
    derivative: bool = True
    filter: float | None = None
    setpoint_weight: float = 1.0
    feedforward: bool = True
    reference_model: Numbers = field(default_factory=dict)
    slew: Numbers = field(default_factory=dict)
    paths: tuple[str, ...] = ()
    steps: Numbers = field(default_factory=dict)
    objective: str = "variance"
    load: Numbers = field(default_factory=dict)
    load_every: float | None = None
    size: Numbers = field(default_factory=dict)
    moving: bool = True
    robust_to: tuple[LPVModel, ...] = ()

    def __post_init__(self):
        if self.filter is not None and not 0.0 <= self.filter < np.inf:
            raise InputError(f"filter {self.filter:g}", mend="the time constant of the derivative's filter in s, 0 for none")
        if not 0.0 <= self.setpoint_weight <= 1.0:
            mend = "the share of the set-point in the proportional part, 0 to 1"
            raise InputError(f"setpoint_weight {self.setpoint_weight:g}", mend=mend)
        check_known("objective", self.objective, OBJECTIVES)
        if self.load_every is not None and not 0.0 < self.load_every < np.inf:
            raise InputError(f"load_every {self.load_every:g}", mend="seconds from one load step to the next, on average")
        for name, size in self.load.items():
            if not 0.0 <= size < np.inf:
                raise InputError(f"load {size:g}", channel=name, mend="the size of a step, 0 for none")
        for name, size in self.size.items():
            if not 0.0 < size < np.inf:
                raise InputError(f"size {size:g}", channel=name, mend="a deviation that counts as one: a number above 0")
        if not self.feedforward and self.paths:
            raise InputError(f"{self.paths[0]} comes as a path, and nothing is fed forward", mend="leave one of both out")
        for name in self.paths:
            if self.reference_model.get(name, np.inf) < np.inf:
                mend = "leave one of both out"
                raise InputError("a path goes through no reference model", channel=name, mend=mend)
        limits = ("reference_model", "a bandwidth in rad/s"), ("slew", "a largest rate per second")
        for name, step in self.steps.items():
            if not (np.isfinite(step) and step):
                raise InputError(f"steps {step:g}", channel=name, mend="the size of a step, with its sign")
        for key, unit in limits:
            for name, value in getattr(self, key).items():
                if not value > 0.0:
                    raise InputError(f"{key} {value:g}", channel=name, mend=f"{unit} above 0, inf for none")

    def design(self, model: Model, progress: Say = lambda _: None) -> PIDDesign:
        """The controller with its margins at every schedule value, before any reference model; see `calmed`.

        Of a Hammerstein-Wiener model it inverts the curves, within what the records have shown of them where no limit says
        otherwise; everything else is of v, sizes of loads too. Raises InputError where none keeps the bounds.
        """
        _check_model(model)
        curves, model = inverted(model), core_of(model)
        if curves and self.robust_to:
            mend = "leave it out, or design on the LPV models behind the curves: .core"
            raise InputError("robust_to beside a model with curves: which would the law invert?", file=model.name, mend=mend)
        commands = self._limits(model, curves)
        check_limits(model.name, [c.name for c in model.inputs], commands["low"], commands["high"])
        limits = dict(zip(commands, let_through(curves, [c.name for c in model.inputs], **commands), strict=True))
        self._shaping(model)  # refuses outputs that the model does not have before any work
        by_channel("output", self.steps, model.outputs, model.name, np.nan)
        structure = Structure(
            derivative=self.derivative, Tf=self.filter, b=self.setpoint_weight, feedforward=self.feedforward,
            moving=self.moving, **limits
        )  # fmt: skip
        bounds = Bounds(self.sensitivity, self.complementary, self.effort)
        found = design_pid(
            model, knots=self.knots, bounds=bounds, structure=structure, setpoint=setpoint_of(self.setpoint, model),
            robust_to=self.robust_to, objective=self.objective, load_every=self.load_every, say=progress,
            load=by_channel("input", self.load, model.inputs, model.name, np.nan),
            scale=by_channel("output", self.size, model.outputs, model.name, np.nan),
        )  # fmt: skip
        return replace(found, law=replace(found.law, curves=curves, **commands)) if curves else found

    def _limits(self, model: LPVModel, curves: Sequence[Curve]) -> dict[str, np.ndarray]:
        """low, high and rate (nu,) of the commands as given; else none, but the ends of a curve."""
        own, none = {c.input: c.u for c in curves}, np.array([-np.inf, np.inf])
        low, high = np.transpose([own.get(c.name, none)[[0, -1]] for c in model.inputs])
        usual = {"low": low, "high": high, "rate": np.full(len(low), np.inf)}
        given = command_limits({"low": self.low, "high": self.high, "rate": self.rate}, model, SimpleNamespace(**usual))
        return {key: usual[key] if value is None else value for key, value in given.items()}

    def on(self, model: Model, plant: Plant | None = None, *, accept: bool = False) -> ScheduledPID:
        """The controller, after one run of its loop on `plant`, or on the model. Raises NotHandedOutError where it is lost there
        and nobody accepts it all the same.
        """
        found, trial = self.calmed(self.design(model), model, plant)
        return _handed_out(found.law, trial, accept)

    def calmed(self, found: PIDDesign, model: Model, plant: Plant | None = None) -> tuple[PIDDesign, Trial]:
        """The design with reference models, and one run of it: of those with which no step of a set-point overshoots by more than
        OVERSHOOT the ones after which all outputs settle soonest, of like ones the calmest. What is said of them stays.

        Chosen on the frozen loops, for each set-point on its own, of those that command no more than the set-point itself would.
        Where the run overshoots nevertheless, with limits and a moving schedule, slower ones are tried; none is so slow that a
        run could not wait for it.
        """
        core = core_of(model)
        usual, (given, slew) = setpoint_of(self.setpoint, core), self._shaping(core)
        free, slew = np.isnan(given), np.where(np.isnan(slew), _sustained(found, core, usual), slew)

        def run(bandwidth: np.ndarray) -> tuple[PIDDesign, Trial]:
            own = replace(found, law=found.following(bandwidth, slew, self._paths(core)))
            return own, tried(own.law, model, plant, usual, self.steps)

        bandwidth = np.where(free, self._settling_soonest(found, core, given) if free.any() else given, given)
        runs = [run(bandwidth)]
        while len(runs) < SLOWER and free.any() and _overshoots(runs[-1][1]).any():
            late = free & (_overshoots(runs[-1][1]) | bool(runs[-1][1].lost))
            slower = np.where(late, np.maximum(0.5 * np.minimum(bandwidth * core.dt, 1.0), SLOWEST) / core.dt, bandwidth)
            if np.any(core.D) or np.array_equal(slower, bandwidth):
                break
            bandwidth = slower
            runs.append(run(bandwidth))
        kept = [own for own in runs if not own[1].lost] or runs[:1]
        least = min(own[1].overshoot for own in kept)
        return next(own for own in kept if own[1].overshoot <= max(OVERSHOOT, least + ALIKE[0]))

    def _settling_soonest(self, found: PIDDesign, model: LPVModel, given: np.ndarray) -> np.ndarray:
        """Bandwidths (ny,) of the reference models, chosen on the frozen loops."""
        bandwidths, answers = [np.inf, *(FINER**k / model.dt for k in range(MODELS) if FINER**k >= SLOWEST)], []
        for w in bandwidths:
            answers.append(_answered(found.following(np.where(np.isnan(given), w, given)), model, found.scale))
            beyond, settled, moved = (np.array(own) for own in zip(*answers, strict=True))
            calm = np.all(moved <= MOVED * moved[0], axis=2)  # by set-point, of every command
            good = np.where((beyond <= OVERSHOOT) & calm, settled, np.inf)
            if np.all(settled[-1] > LATER * good.min(axis=0)):  # slower ones only settle later
                break
        return np.array([bandwidths[_soonest(*own)] for own in zip(beyond.T, good.T, strict=True)])

    def _shaping(self, model: LPVModel) -> tuple[np.ndarray, np.ndarray]:
        """Bandwidths of the reference models and slews (ny,), NaN where none is given."""
        given = self.reference_model, self.slew
        bandwidth, slew = (by_channel("output", own, model.outputs, model.name, np.nan) for own in given)
        return np.where(self._paths(model), np.inf, bandwidth), slew

    def _paths(self, model: LPVModel) -> np.ndarray:
        """Whether the set-point of an output (ny,) comes as a path."""
        known = [c.name for c in model.outputs]
        for name in self.paths:
            check_known("output", name, known, file=model.name)
        return np.isin(known, self.paths)


def _sustained(found: PIDDesign, model: LPVModel, usual: Sequence[float] | None) -> np.ndarray:
    """Slews (ny,): on a model that integrates, of an output that goes on as long as a command does, what SUSTAINED of the limits
    keeps up from the usual set-point; infinite on others.
    """
    law, slews = found.law.inside, []
    if not model.free:
        return np.full(len(model.outputs), np.inf)
    for rho, Ka in zip(found.knots, found.Ka, strict=True):
        gains, phi = law.gains_at(rho), model.operating_point.basis(np.asarray(rho))
        u = gains.u0 + gains.Kr @ (phi @ model.operating_point.y if usual is None else np.asarray(usual))
        room = SUSTAINED * np.maximum(np.minimum(law.high - u, u - law.low), 0.0)
        needed = np.abs(Ka) > NOTHING * law.dt * np.abs(gains.Kp).max()
        slews.append(
            np.min(np.where(needed & (room > 0.0)[:, None], room[:, None] / np.where(needed, np.abs(Ka), 1.0), np.inf), axis=0)
        )
    return np.min(slews, axis=0)


def _answered(law: ScheduledPID, model: LPVModel, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The worst of the frozen loops after steps of each set-point, outputs in units of `scale` (ny,): how far its output goes
    beyond it (ny,), seconds until all outputs stay within BAND of where they are wanted (ny,), infinite where they do not within
    the time that the loop takes to settle, and the largest move of each command (ny, nu).
    """
    ny, worst = len(scale), []
    for rho in model.frozen_values(FROZEN):
        A, B, C, _ = model.freeze(rho)
        C, system = C / scale[:, None], law.at(rho)
        Ac, Bc, Cc, Dc = (np.asarray(M, dtype=float) for M in (system.A, system.B, system.C, system.D))
        (Br, By), (Dr, Dy) = (np.split(M * np.tile(scale, 2), [ny], axis=1) for M in (Bc, Dc))
        X = np.block([[A + B @ Dy @ C, B @ Cc], [By @ C, Ac]])
        rest = np.linalg.solve(np.eye(len(X)) - X, np.vstack([B @ Dr, Br]))  # x(k) = rest - X^k rest
        samples = SETTLED / -np.log(np.clip(np.abs(np.linalg.eigvals(X)).max(), 1e-6, 1.0 - 1e-9))
        every, left = dying(X, rest, samples, POINTS)
        y = C @ (x := rest - left)[:, : len(A)]
        off, u = y - np.eye(ny), Dr + Dy @ y + Cc @ x[:, len(A) :]
        away = np.any(np.abs(off) > BAND, axis=1)
        time = every * law.dt * np.where(away.any(axis=0), POINTS - np.argmax(away[::-1], axis=0), 0)
        worst.append((np.einsum("kjj->kj", off).max(axis=0), np.where(away[-1], np.inf, time), np.abs(u).max(axis=0).T))
    beyond, settled, moved = (np.max(own, axis=0) for own in zip(*worst, strict=True))
    return np.maximum(beyond, 0.0), settled, moved


def _soonest(beyond: np.ndarray, settled: np.ndarray) -> int:
    """Which of several reference models (k,), from brisk to calm, a set-point is best answered by; settled: infinite where they
    do not, or are no choice.
    """
    if not np.isfinite(settled).any():
        return int(np.flatnonzero(beyond <= max(OVERSHOOT, beyond.min() + ALIKE[0]))[0])
    return int(np.flatnonzero(settled <= ALIKE[1] * settled.min())[-1])


def _overshoots(trial: Trial) -> np.ndarray:
    """Whether steps of each set-point (nr,) overshoot by more than they should; all of them in a run that is lost."""
    return np.greater(trial.beyond, OVERSHOOT) if len(trial.beyond) else np.array([bool(trial.lost)])


@record
class MPCDesign:
    """An MPC on the model that keeps limits of commands always and of outputs where it can.

    horizon: samples that it looks ahead; move: price of a unit move of a command, default the lowest with which |S| of the law
    without active limits stays within `sensitivity` over the schedule; low, high, rate [1/s]: limits of commands by input,
    default those of the fallback; keep: (lowest, highest) by output. fallback: the PID for when all else fails, designed with
    default bounds and these limits where none is given. setpoint: the usual one by output.

        >>> MPCDesign(horizon=10, keep={"n": (-30.0, 30.0)}, fallback=law).on(model).measured
        ('n',)
    """

    horizon: int = 20
    move: float | None = None
    sensitivity: float = field("", low=1.0 + 1e-9, default=DEFAULT.sensitivity)
    low: Numbers = field(default_factory=dict)
    high: Numbers = field(default_factory=dict)
    rate: Numbers = field(default_factory=dict)
    keep: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    fallback: ScheduledPID | None = None
    setpoint: Numbers = field(default_factory=dict)

    def __post_init__(self):
        if self.move is not None and not 0.0 < self.move < np.inf:
            raise InputError(
                f"move {self.move:g}", mend="the price of moving a command: a number above 0, or None to have it chosen"
            )
        for name, ends in self.keep.items():
            if not isinstance(ends, tuple | list) or len(ends) != 2:
                raise InputError(f"keep {name}: {ends!r}", mend="give the lowest and the highest value: (-20.0, 20.0)")

    def on(self, model: LPVModel, plant: Plant | None = None, *, accept: bool = False) -> MPC:
        """The controller, after one run of its loop on `plant`, or on the model. Raises NotHandedOutError where it is lost there
        and nobody accepts it all the same.
        """
        if isinstance(model, HammersteinWienerModel):
            mend = "design a PID on it, or identify with --model lti or ssm"
            raise InputError("an MPC does not invert the curves of a Hammerstein-Wiener model", file=model.name, mend=mend)
        _check_model(model)
        fallback = self.fallback
        if fallback is None:
            fallback = ScheduledPIDDesign(low=self.low, high=self.high, rate=self.rate, setpoint=self.setpoint).design(model).law
        lowest, highest = ({y: ends[i] for y, ends in self.keep.items()} for i in (0, 1))
        law = design_mpc(
            model, fallback, horizon=self.horizon, weights=self.weights(model, fallback),
            y_low=by_channel("output", lowest, model.outputs, model.name, -np.inf),
            y_high=by_channel("output", highest, model.outputs, model.name, np.inf),
            **command_limits({"low": self.low, "high": self.high, "rate": self.rate}, model, fallback),
        )  # fmt: skip
        return _handed_out(law, tried(law, model, plant, setpoint_of(self.setpoint, model)), accept)

    def weights(self, model: LPVModel, fallback: ScheduledPID) -> Weights:
        """What outputs and moves count: at the price of moves that was asked for, or the lowest that keeps |S| within bounds.

        Where no price keeps it, that of the least |S|; the lowest of all for a model that does not say how its errors go on.
        """
        if self.move is not None:
            return default_weights(model, self.move)
        if model.predictor is None or model.noise is None:  # an MPC has no observer on it, a nonlinear one needs none
            return default_weights(model, PRICES[0])
        grid = model.frozen_values(FINE if len(model.schedules) < 2 else FROZEN)

        @cache
        def largest(price: float) -> float:
            law = design_mpc(model, fallback, horizon=self.horizon, weights=default_weights(model, price))
            return largest_sensitivity(law, model, grid)

        high = next((i for i in range(0, len(PRICES), COARSER) if largest(PRICES[i]) <= self.sensitivity), None)
        if high is None:
            return default_weights(model, min(PRICES[::COARSER], key=largest))
        between = PRICES[max(0, high - COARSER + 1) : high + 1]
        return default_weights(model, next(price for price in between if largest(price) <= self.sensitivity))


def _check_model(model: Any) -> None:
    if not isinstance(model, Model):
        raise InputError(f"a {type(model).__name__}, expected an LPV model", mend="wb.identify(data).model, wb.load_model(FILE)")


def command_limits(given: Mapping[str, Numbers], model: LPVModel, fallback: Any = None) -> dict[str, Any]:
    """low, high and rate (nu,) as given, the rest those of the fallback law, else none; None where nothing is given.

    Raises InputError for inputs that the model does not have, and for a rate that is not above 0.
    """
    found: dict[str, Any] = {}
    for key, none in (("low", -np.inf), ("high", np.inf), ("rate", np.inf)):
        own = given[key]
        default = none if fallback is None else getattr(fallback, key)
        found[key] = by_channel("input", own, model.inputs, model.name, default) if own else None
    for c, rate in zip(model.inputs, [] if found["rate"] is None else found["rate"], strict=False):
        if not rate > 0.0:
            mend = f"the largest change of {c.name} per second, in {c.unit or 'its unit'}: a number above 0"
            raise InputError(f"--rate {c.name}={rate:g}", channel=c.name, mend=mend)
    return found


def by_channel(kind: str, given: Numbers, channels: Sequence[Channel], file: str, default: Any) -> np.ndarray:
    """Numbers (n,) in the order of the channels; `default` where none is given. Raises InputError for an unknown channel."""
    known = [c.name for c in channels]
    for name in given:
        check_known(kind, name, known, file=file)
    usual = np.broadcast_to(np.asarray(default, dtype=float), len(known))
    return np.array([float(given.get(name, own)) for name, own in zip(known, usual, strict=True)])


def setpoint_of(given: Numbers, model: LPVModel) -> list[float] | None:
    """The usual set-point in the order of the outputs, None where none is given."""
    if not given:
        return None
    values = by_channel("output", given, model.outputs, model.name, np.nan)
    if missing := [c.name for c, value in zip(model.outputs, values, strict=True) if np.isnan(value)]:
        every = ",".join(f"{c.name}=..." for c in model.outputs)
        raise InputError(f"no set-point for {', '.join(missing)}", mend=f"give one for every output, {every}, or none")
    return values.tolist()


def _handed_out(law: Any, trial: Trial, accept: bool) -> Any:
    """The controller, unless the run of its loop is lost."""
    if trial.lost and not accept:
        raise NotHandedOutError(f"{law.name} is not handed out: {trial.sentence}", mend="accept=True takes it all the same")
    return law
