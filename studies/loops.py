"""What loops are compared on: for each machine the laws that are designed, and the scenarios of a whole run.

Laws are designed as a user would: records of the machine's plan, a model, then `design`. Nothing that a law does not measure is
told to it but what its file holds; the nonlinear MPC's file holds the plant. All PIDs of a machine keep the same bounds; what
those leave open, the reference model of a PID and the price that an MPC pays for moves, is chosen by `rehearsal` on the
identified model, by one rule for all; MPCs keep the PIDs' bound of |S|, too. Outputs count there in units of their set-point
steps, and so they do in the MPCs' weights; the nonlinear MPC pays the MPC's price.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from controllers.designs import FINE
from controllers.mpc import MPC, design_mpc
from controllers.nmpc import design_nmpc
from controllers.pid_design import PIDDesign, Structure, design_pid
from controllers.receding import Weights
from controllers.scheduled_pid import ScheduledPID
from plants import PLANTS
from studies.experiments import measured
from workbench.data import Dataset
from workbench.identification.lti import LTI
from workbench.identification.ssm import SSM
from workbench.lpv import LPVModel
from workbench.physics.parameters import EffectSizes
from workbench.physics.plant import Plant
from workbench.records import record
from workbench.rehearsal import Rehearsal, calmest, rehearsal
from workbench.robustness.frozen import DEFAULT, Bounds, largest_sensitivity
from workbench.simulation import Scenario

Say = Callable[[str], None]

REHEARSED = 1500  # samples
SHARES = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0, np.inf)  # of 1 / dt: reference models of a PID, from calm to brisk, and none
PRICES = (10.0, 3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4)  # of an MPC's moves


@record
class Case:
    """A run: set-points by name (N,), what happens to the inputs unlogged, and missing physics; in words what it is."""

    name: str
    sentence: str
    references: Mapping[str, np.ndarray]
    disturbance: Mapping[str, np.ndarray]
    effects: EffectSizes
    shown: tuple[float, float]  # s, what a picture shows of it

    def scenario(self, seed: int) -> Scenario:
        return Scenario(self.name, self.references, seed=seed, disturbance=self.disturbance)


@record
class Designed:
    """Laws by name, the models they were designed on by name, and the designs of the PIDs among them by name.

    rehearsed: by law the candidates and what each has cost on the model; taken: by law the candidate that it is.
    """

    laws: Mapping[str, object]
    models: Mapping[str, LPVModel]
    pids: Mapping[str, PIDDesign]
    rehearsed: Mapping[str, Mapping[str, float]]
    taken: Mapping[str, str]


class _Chosen:
    """Laws as they are chosen, one after the other."""

    def __init__(self, rehearsals: Mapping[str, Rehearsal], progress: Say):
        self.rehearsals, self.progress = rehearsals, progress
        self.laws: dict[str, object] = {}
        self.pids: dict[str, PIDDesign] = {}
        self.rehearsed: dict[str, dict[str, float]] = {}
        self.taken: dict[str, str] = {}

    def pid(self, name: str, found: PIDDesign, models: Sequence[str]) -> ScheduledPID:
        """The law with each of the reference models."""
        speeds = [share / found.law.dt for share in SHARES]
        candidates = {f"reference model {w:g} rad/s" if w < np.inf else "no reference model": found.following(w) for w in speeds}
        law = self._take(name, candidates, models)
        self.pids[name] = replace(found, law=law)
        return law

    def mpc(self, name: str, make: Callable[[float], MPC], models: Sequence[str], bounds: Bounds) -> float:
        """The price of moves of the law that was taken, of those that keep the bound of |S|, or that of the least |S|."""
        made = {price: make(price) for price in PRICES}
        peaks = {price: largest_sensitivity(law, law.model, law.model.frozen_values(FINE)) for price, law in made.items()}
        kept = [price for price in PRICES if peaks[price] <= bounds.sensitivity] or [min(PRICES, key=lambda price: peaks[price])]
        candidates = {f"move price {price:g}": made[price] for price in kept}
        self._take(name, candidates, models)
        return kept[list(candidates).index(self.taken[name])]

    def _take(self, name: str, candidates: Mapping[str, Any], models: Sequence[str]) -> Any:
        self.progress(f"{name}: {len(candidates)} candidates on the identified model")
        self.taken[name], self.rehearsed[name] = calmest(candidates, [self.rehearsals[model] for model in models])
        self.laws[name] = candidates[self.taken[name]]
        return self.laws[name]

    def designed(self, models: Mapping[str, LPVModel]) -> Designed:
        return Designed(self.laws, models, self.pids, self.rehearsed, self.taken)


@record
class Bench:
    """A machine: what its outputs are called, the limits of the comparison, how laws are designed, and what they run through.

    keep: (low, high) of outputs that the MPCs keep where they can. base, scheduled: names of the laws that are set against each
    other; quality: the output that matters most.
    """

    plant: Plant
    words: Mapping[str, str]
    keep: Mapping[str, tuple[float, float]]
    base: str
    scheduled: str
    quality: str
    design: Callable[[bool, int, Say], Designed]
    cases: tuple[Case, ...]


def _records(plant: Plant, experiments: tuple[str, ...], seed: int, roles: dict, effects: EffectSizes | None = None) -> Dataset:
    """Records of the machine's plan, as they would be measured."""
    return Dataset(tuple(measured(plant, name, seed, effects).with_roles(**roles) for name in experiments))


def _counted(size: np.ndarray, nu: int, move: float) -> Weights:
    """Outputs in units of `size`, moves of nu inputs at this price."""
    return Weights(1.0 / size**2, np.full(nu, move), np.zeros(nu))


# ---- web winding machine ----------------------------------------------------------------------------------------------------

WINDING = PLANTS["web-winding"]
SAMPLES = 2250  # at 100 rad/s the whole tape
SPEED = 100.0  # rad/s
WINDING_LIMITS = Structure(low=np.array([-2.0, 0.0]), high=np.array([3.0, 3.0]), rate=np.array([50.0, 50.0]))  # V1, V2 in V


def _design_winding(quick: bool, seed: int, progress: Say) -> Designed:
    roles = {"inputs": ("V1", "V2"), "outputs": ("w3", "theta"), "schedule": ("r2",)}
    progress("web-winding: identifying on prbs1 and rbs")
    model = SSM(order=6 if quick else None).fit(_records(WINDING, ("prbs1", "rbs"), seed, roles))
    usual, size = np.array([SPEED, 0.0]), np.array([5.0, 5.0])  # rad/s, deg
    seen = rehearsal(model, usual, size, REHEARSED, seed)
    chosen = _Chosen({model.name: seen}, progress)
    fallback: Any = None
    for name, knots in (("fixed PID", 1), ("scheduled PID", 3 if quick else 5)):
        progress(f"web-winding: designing the {name}")
        found = design_pid(model, knots=knots, structure=WINDING_LIMITS, setpoint=usual)
        fallback = chosen.pid(name, found, [model.name])
    low, high = np.array([-np.inf, -20.0]), np.array([np.inf, 20.0])
    price = chosen.mpc(
        "LPV-MPC",
        lambda move: design_mpc(model, fallback, weights=_counted(size, 2, move), y_low=low, y_high=high),
        [model.name],
        DEFAULT,
    )
    chosen.laws["NMPC"] = design_nmpc(WINDING, fallback, weights=_counted(size, 2, price), y_low=low, y_high=high)
    return chosen.designed({model.name: model})


def _winding_cases() -> tuple[Case, ...]:
    t, still = WINDING.dt * np.arange(SAMPLES), np.zeros(SAMPLES)

    def case(name, sentence, shown, *, speed=still, angle=still, push=still, effects=None) -> Case:
        references = {"w3_set": SPEED + speed, "theta_set": angle}
        return Case(name, sentence, references, {"V1": push}, effects or {}, shown)

    def square(size: float, period: float) -> np.ndarray:
        return size * np.sign(np.sin(2.0 * np.pi * (t + 1e-6) / period))

    stops = [(15.0, 0.0), (16.0, -SPEED), (18.0, -SPEED), (20.0, 0.0)]
    course = [(begin + 30.0 * k, value) for k in range(3) for begin, value in stops]
    bumps = still.copy()
    for k, at in enumerate(np.arange(10.0, 90.0, 10.0)):
        bumps[round(at / WINDING.dt)] = 0.5 * (-1) ** k
    fast = [
        (5.0, 0.0),
        (6.5, 60.0),
        (12.0, 60.0),
        (14.0, -10.0),
    ]  # out of reach of V2 at this radius; then to the end of the tape

    def along(points: list[tuple[float, float]]) -> np.ndarray:
        return np.interp(t, [at for at, _ in points], [value for _, value in points])

    return (
        case("production", "the whole reel at constant set-points", (0.0, 90.0)),
        case("speed steps", "the speed set-point jumps by 10 rad/s every 6 s", (58.0, 74.0), speed=square(5.0, 12.0)),
        case("tension steps", "the angle set-point jumps by 10 deg every 6 s", (58.0, 74.0), angle=square(5.0, 12.0)),
        case("emergency stop", "from full speed to standstill within a second, three times", (74.0, 84.0), speed=along(course)),
        case("splice", "a splice every 10 s: an impulse of the tension, as of 0.5 V for a sample", (28.0, 44.0), push=bumps),
        case(
            "eccentric reel", "the unwind reel runs out of true by 0.1 mm", (20.0, 30.0),
            effects={"eccentricity@unwind": {"cosine": 1e-4}},
        ),
        case("saturation", "a speed set-point of 160 rad/s that the voltage does not reach", (3.0, 19.0), speed=along(fast)),
    )  # fmt: skip


# ---- welding robot ------------------------------------------------------------------------------------------------------------

ROBOT = PLANTS["welding-robot"]
ROBOT_SAMPLES = 2000
HEAVY: EffectSizes = {"platform-mass@rail": {"change": 1.0}}
STICKING: EffectSizes = {"coulomb@rail": {"level": 0.3}}
BRISK = Bounds(1.6, 1.6, 20.0)  # the encoder is so good that noise may be amplified; all laws then move the force alike
FORCE = Structure(low=np.array([-4.0]), high=np.array([4.0]), rate=np.array([100.0]))  # N


def _design_robot(quick: bool, seed: int, progress: Say) -> Designed:
    del quick
    roles = {"inputs": ("u",), "outputs": ("v",)}
    progress("welding-robot: identifying on prbs, rbs, with and without a load")
    models = {}
    for name, effects in (("nominal", {}), ("heavy", HEAVY)):
        found = LTI(order=2).fit(_records(ROBOT, ("prbs", "rbs"), seed, roles, effects))
        models[name] = replace(found, name=name)
    progress("welding-robot: designing")
    nominal, heavy = models["nominal"], models["heavy"]
    size = np.array([0.6])  # m/s
    seen = {name: rehearsal(own, (0.0,), size, REHEARSED, seed) for name, own in models.items()}
    chosen = _Chosen(seen, progress)
    chosen.pid("PID", design_pid(nominal, structure=FORCE, bounds=BRISK, setpoint=(0.0,)), ["nominal"])
    robust = design_pid(nominal, structure=FORCE, bounds=BRISK, setpoint=(0.0,), robust_to=[heavy])
    fallback = chosen.pid("robust PID", robust, list(models))
    price = chosen.mpc("MPC", lambda move: design_mpc(nominal, fallback, weights=_counted(size, 1, move)), ["nominal"], BRISK)
    chosen.laws["NMPC"] = design_nmpc(ROBOT, fallback, weights=_counted(size, 1, price))
    return chosen.designed(models)


def _robot_cases() -> tuple[Case, ...]:
    t = ROBOT.dt * np.arange(ROBOT_SAMPLES)
    at, speed = [1, 2, 8, 9, 12, 13, 19, 20, 26, 27, 33, 34], [0, 0.4, 0.4, 0, 0, -0.4, -0.4, 0.1, 0.1, 0.6, 0.6, 0]
    v = np.interp(t, at, speed)
    each = (
        ("nominal", "starts, a reversal, a slow seam and a fast one", {}),
        ("heavy", "with 1 kg more on the platform, which nobody tells the controller", HEAVY),
        ("sticking", "with a static friction of 0.3 N between wheels and rail", STICKING),
        ("heavy and sticking", "with both", {**HEAVY, **STICKING}),
    )
    return tuple(Case(name, sentence, {"v_set": v}, {}, effects, (0.0, 40.0)) for name, sentence, effects in each)


def benches() -> dict[str, Bench]:
    """By name of the machine."""
    return {
        WINDING.name: Bench(
            WINDING, {"w3": "speed", "theta": "tension"}, {"theta": (-20.0, 20.0)}, "fixed PID", "scheduled PID", "theta",
            _design_winding, _winding_cases(),
        ),
        ROBOT.name: Bench(ROBOT, {"v": "speed"}, {}, "PID", "robust PID", "v", _design_robot, _robot_cases()),
    }  # fmt: skip
