"""Designs as records of their options with one verb: `on(model)` gives the controller.

law = ScheduledPIDDesign(sensitivity=1.6, setpoint={"w3": 100.0, "theta": 0.0}).on(model)
law = MPCDesign(low={"V1": 0.0}, high={"V1": 5.0}, keep={"theta": (-20.0, 20.0)}).on(model)

Before it is handed out the controller runs its loop once, on the plant where one is given, else on the model
(`workbench.verification.trial`): frozen margins do not say that a loop holds its machine.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from controllers.mpc import MPC, default_weights, design_mpc
from controllers.pid_design import PIDDesign, Structure, design_pid
from controllers.scheduled_pid import ScheduledPID
from workbench.data import Channel
from workbench.errors import InputError, NotHandedOutError, check_known
from workbench.lpv import LPVModel
from workbench.physics.plant import Plant
from workbench.records import field, record
from workbench.robustness.frozen import Bounds
from workbench.verification.trial import OVERSHOOT, Trial, tried

Numbers = Mapping[str, float]
Say = Callable[[str], None]

MODELS = 12  # bandwidths that reference models are tried with, each half as large as the one before
LATER = 1.5  # times as late as the best, from where on slower ones are not tried
ALIKE = 0.02, 1.1  # of a step, overshoots that differ by less; times to settle that differ by a factor of less


@record
class ScheduledPIDDesign:
    """The most integral action whose frozen loops keep |S|, |T| and the effort within bounds over the whole schedule.

    sensitivity, complementary: largest |S|, |T|; effort: largest |Q| as a multiple of the least that is needed. knots: schedule
    values with gains of their own, their number or the values, of several schedule variables for all or for each (see
    `design_pid`); 1 is a fixed PID. low, high, rate [1/s]: limits of commands by input. setpoint: the usual one by output, which
    is held without the integral. filter [s]: of the derivative, default two samples. setpoint_weight: share of the set-point in
    the proportional part. feedforward: whether a new set-point commands at once what holds it. reference_model [rad/s]: bandwidth
    of what a set-point goes through by output, infinite for nothing; where none is given `on` chooses, see `calmed`. slew [1/s]:
    largest rate of a set-point by output. Margins are the same with all of these. robust_to: models that must be kept too.

        >>> ScheduledPIDDesign(sensitivity=1.4, knots=3).on(model).gains_at(5.0).Kp.round(2)
        array([[0.32]])
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
    robust_to: tuple[LPVModel, ...] = ()

    def __post_init__(self):
        if self.filter is not None and not 0.0 <= self.filter < np.inf:
            raise InputError(f"filter {self.filter:g}", mend="the time constant of the derivative's filter in s, 0 for none")
        if not 0.0 <= self.setpoint_weight <= 1.0:
            mend = "the share of the set-point in the proportional part, 0 to 1"
            raise InputError(f"setpoint_weight {self.setpoint_weight:g}", mend=mend)
        for key, unit in (("reference_model", "a bandwidth in rad/s"), ("slew", "a largest rate per second")):
            for name, value in getattr(self, key).items():
                if not value > 0.0:
                    raise InputError(f"{key} {value:g}", channel=name, mend=f"{unit} above 0, inf for none")

    def design(self, model: LPVModel, progress: Say = lambda _: None) -> PIDDesign:
        """The controller with its margins at every schedule value, before any reference model; see `calmed`.

        Raises InputError where none keeps the bounds.
        """
        _check_model(model)
        limits = command_limits({"low": self.low, "high": self.high, "rate": self.rate}, model)
        self._shaping(model)  # refuses outputs that the model does not have before any work
        structure = Structure(
            derivative=self.derivative, Tf=self.filter, b=self.setpoint_weight, feedforward=self.feedforward, **limits
        )  # fmt: skip
        bounds = Bounds(self.sensitivity, self.complementary, self.effort)
        return design_pid(
            model, knots=self.knots, bounds=bounds, structure=structure, setpoint=setpoint_of(self.setpoint, model),
            robust_to=self.robust_to, say=progress,
        )  # fmt: skip

    def on(self, model: LPVModel, plant: Plant | None = None, *, accept: bool = False) -> ScheduledPID:
        """The controller, after one run of its loop on `plant`, or on the model. Raises NotHandedOutError where it is lost there
        and nobody accepts it all the same.
        """
        found, trial = self.calmed(self.design(model), model, plant)
        return _handed_out(found.law, trial, accept)

    def calmed(self, found: PIDDesign, model: LPVModel, plant: Plant | None = None) -> tuple[PIDDesign, Trial]:
        """The design with reference models that let no set-point's step overshoot by more than OVERSHOOT and all outputs settle
        soonest after it, of like ones the calmest; and the run of that. What is said of reference models stays.

        Each set-point has its own, for each is stepped alone.
        """
        usual, (given, slew) = setpoint_of(self.setpoint, model), self._shaping(model)
        free, runs = np.isnan(given), []

        def run(bandwidth: np.ndarray) -> tuple[PIDDesign, Trial]:
            own = replace(found, law=found.following(bandwidth, slew))
            return own, tried(own.law, model, plant, usual)

        for w in (np.inf, *(0.5**k / model.dt for k in range(MODELS))):
            runs.append(run(np.where(free, w, given)))
            if not free.any() or _slower(runs, free):
                break
        if not (kept := [own for own in runs if not own[1].lost]):
            return runs[0]
        at = np.array([_soonest([trial for _, trial in kept], j) if free[j] else 0 for j in range(len(free))])
        if len(set(at[free])) <= 1:
            return kept[int(at[free].max(initial=0))]
        best = run(np.array([kept[i][0].law.bandwidth[j] for j, i in enumerate(at)]))
        return best if not best[1].lost else kept[int(at[free].max())]

    def _shaping(self, model: LPVModel) -> tuple[np.ndarray, np.ndarray]:
        """Bandwidths of the reference models (ny,), NaN where none is given, and slews (ny,)."""
        given = (self.reference_model, np.nan), (self.slew, np.inf)
        bandwidth, slew = (by_channel("output", own, model.outputs, model.name, none) for own, none in given)
        return bandwidth, slew


def _slower(runs: Sequence[tuple[PIDDesign, Trial]], free: np.ndarray) -> bool:
    """Whether the last reference models only settle later than the best did, all of them."""
    trials = [trial for _, trial in runs if not trial.lost]
    if not trials or runs[-1][1].lost:
        return False
    best = np.array([np.where(own.beyond <= OVERSHOOT, own.settled, np.inf) for own in trials]).min(axis=0, initial=np.inf)
    return bool(np.all(trials[-1].settled[free] > LATER * best[free]))


def _soonest(trials: Sequence[Trial], j: int) -> int:
    """Which of runs, from brisk to calm, set-point j is best answered by."""
    beyond, settled = (np.array([getattr(own, key)[j] for own in trials]) for key in ("beyond", "settled"))
    if not (good := beyond <= OVERSHOOT).any():
        return int(np.flatnonzero(beyond <= beyond.min() + ALIKE[0])[0])
    return int(np.flatnonzero(good & (settled <= ALIKE[1] * settled[good].min()))[-1])


@record
class MPCDesign:
    """An MPC on the model that keeps limits of commands always and of outputs where it can.

    horizon: samples that it looks ahead; move: price of a unit move of a command; low, high, rate [1/s]: limits of commands by
    input, default those of the fallback; keep: (lowest, highest) by output. fallback: the PID for when all else fails, designed
    with default bounds and these limits where none is given. setpoint: the usual one by output.

        >>> MPCDesign(horizon=10, keep={"n": (-30.0, 30.0)}, fallback=law).on(model).measured
        ('n',)
    """

    horizon: int = 20
    move: float = field("", low=1e-12, default=0.003)
    low: Numbers = field(default_factory=dict)
    high: Numbers = field(default_factory=dict)
    rate: Numbers = field(default_factory=dict)
    keep: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    fallback: ScheduledPID | None = None
    setpoint: Numbers = field(default_factory=dict)

    def __post_init__(self):
        for name, ends in self.keep.items():
            if not isinstance(ends, tuple | list) or len(ends) != 2:
                raise InputError(f"keep {name}: {ends!r}", mend="give the lowest and the highest value: (-20.0, 20.0)")

    def on(self, model: LPVModel, plant: Plant | None = None, *, accept: bool = False) -> MPC:
        """The controller, after one run of its loop on `plant`, or on the model. Raises NotHandedOutError where it is lost there
        and nobody accepts it all the same.
        """
        _check_model(model)
        fallback = self.fallback
        if fallback is None:
            fallback = ScheduledPIDDesign(low=self.low, high=self.high, rate=self.rate, setpoint=self.setpoint).design(model).law
        lowest, highest = ({y: ends[i] for y, ends in self.keep.items()} for i in (0, 1))
        law = design_mpc(
            model, fallback, horizon=self.horizon, weights=default_weights(model, self.move),
            y_low=by_channel("output", lowest, model.outputs, model.name, -np.inf),
            y_high=by_channel("output", highest, model.outputs, model.name, np.inf),
            **command_limits({"low": self.low, "high": self.high, "rate": self.rate}, model, fallback),
        )  # fmt: skip
        return _handed_out(law, tried(law, model, plant, setpoint_of(self.setpoint, model)), accept)


def _check_model(model: Any) -> None:
    if not isinstance(model, LPVModel):
        raise InputError(f"a {type(model).__name__}, expected an LPV model", mend="wb.identify(data).model, wb.load_model(FILE)")


def command_limits(given: Mapping[str, Numbers], model: LPVModel, fallback: ScheduledPID | None = None) -> dict[str, Any]:
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
