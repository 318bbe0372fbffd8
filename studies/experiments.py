"""The experiment plans of the machines that ship with the workbench: which loop runs and which set-points it follows.

For the web winding machine these are the five experiments of [1] section 1.4.2 under its two decoupled loops, 2250 samples
each, a staircase with standstills and a speed ramp. For the welding robot they are open-loop runs with a moving arm, among them
the four curves of [2] Fig. 4. [1] "Experimental Modelling of a Web Winding Machine: LPV Approaches". [2] see
plants/welding_robot.py.
"""

import zlib
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from controllers.pid import pid
from controllers.scheduled_pid import ScheduledPID
from plants import PLANTS, WEB_WINDING
from workbench import excitation
from workbench.data import Experiment
from workbench.diagnosis.experiments import Template
from workbench.errors import check_known
from workbench.physics.controller import Playback
from workbench.physics.parameters import EffectSizes
from workbench.physics.plant import Plant
from workbench.records import field, record
from workbench.simulation import Scenario, simulate


@record
class Plan:
    """An experiment: the loop it runs in, for a seed what happens in it, and the missing physics that belongs to it."""

    controller: ScheduledPID | Playback
    scenario: Callable[[int], Scenario]
    effects: EffectSizes = field(default_factory=dict)

    def effects_with(self, own: EffectSizes) -> EffectSizes:
        """The experiment's effects and a user's own ones together; where both name a number, the user's counts."""
        return {key: {**self.effects.get(key, {}), **own.get(key, {})} for key in {**self.effects, **own}}


def web_winding_loops(plant: Plant = WEB_WINDING) -> ScheduledPID:
    """The two decoupled loops of the identification experiments: w3 by V2, dancer angle by V1."""
    _, u0 = plant.equilibrium()
    return pid(
        actuated=("V2", "V1"),
        measured=("w3", "theta"),
        references=("w3_set", "theta_set"),
        dt=plant.dt,
        Kp=np.array([0.010, -0.0050]),
        Ki=np.array([0.050, -0.020]),
        u0=np.array([u0[1], u0[0]]),
        name="pi-loops",
        units={c.name: c.unit for c in (*plant.inputs, *plant.outputs)},
    )


SAMPLES = 2250
SPEED = 100.0  # rad/s, the operating point of the guide pulley


def _winding(name: str, signals: Callable[[int], tuple[np.ndarray, np.ndarray]]) -> Plan:
    """`signals(seed)` gives the set-points' deviations of speed [rad/s] and dancer angle [deg]."""

    def scenario(seed: int) -> Scenario:
        speed, angle = signals(seed)
        return Scenario(name, {"w3_set": SPEED + speed, "theta_set": angle}, seed=_noise_seed(name, seed))

    return Plan(web_winding_loops(), scenario)


def _prbs(seed: int) -> tuple[np.ndarray, np.ndarray]:
    del seed  # PRBS1 and PRBS2 differ in noise and disturbance only
    return 21.0 * excitation.prbs(SAMPLES, hold=PRBS_HOLD), 3.5 * excitation.prbs(SAMPLES, hold=PRBS_HOLD, shift=2048)


def _rbs(seed: int) -> tuple[np.ndarray, np.ndarray]:
    draw = [excitation.random_binary(SAMPLES, s, hold=10, probability=0.2) for s in _seeds(seed)]
    return 20.0 * draw[0], 5.0 * draw[1]


def _sine(seed: int) -> tuple[np.ndarray, np.ndarray]:
    draw = [excitation.multisine(SAMPLES, s, WEB_WINDING.dt, lines=20, low=0.02, high=2.0) for s in _seeds(seed)]
    return 48.0 * draw[0], 8.0 * draw[1]


def _rgs(seed: int) -> tuple[np.ndarray, np.ndarray]:
    draw = [excitation.filtered_gaussian(SAMPLES, s, WEB_WINDING.dt, cutoff=1.0) for s in _seeds(seed)]
    return 40.0 * draw[0], 10.0 * draw[1]


def _staircase(seed: int) -> tuple[np.ndarray, np.ndarray]:
    del seed
    levels = [0.0, -60.0, -100.0, -80.0, 40.0, 0.0, -100.0, 20.0, -40.0, 60.0]  # -100 rad/s is a standstill
    # a jump of the speed would slacken the tape: 2 s from level to level keep the tension positive
    return excitation.staircase(SAMPLES, levels, rise=50), excitation.staircase(SAMPLES, [0.0, 5.0, -5.0, 0.0], rise=25)


def _ramp(seed: int) -> tuple[np.ndarray, np.ndarray]:
    del seed
    return excitation.ramp(SAMPLES, [0.0, -80.0, 60.0, -80.0, 60.0, 0.0]), excitation.ramp(SAMPLES, [0.0, 5.0, -5.0, 0.0])


def _seeds(seed: int) -> tuple[int, int]:
    """Two independent seeds for the two loops, apart from the one that draws the noise."""
    first, second = np.random.SeedSequence([seed, 20]).generate_state(2)
    return int(first), int(second)


def _noise_seed(name: str, seed: int) -> int:
    """Seed of noise and disturbance: two experiments with the same number must not share them."""
    return int(np.random.SeedSequence([seed, zlib.crc32(name.encode())]).generate_state(1)[0])


def _open_loop(
    plant: Plant, name: str, signals: Callable[[int], Mapping[str, np.ndarray]], effects: EffectSizes | None = None
) -> Plan:
    """`signals(seed)` gives the course of every input by name."""
    return Plan(
        Playback(plant.input_names, plant.dt),
        lambda seed: Scenario(name, signals(seed), seed=_noise_seed(name, seed)),
        effects or {},
    )


ROBOT = PLANTS["welding-robot"]
ROBOT_SAMPLES = 2000  # 40 s, ten times the robot's slow time constant
FORCE = 2.0  # N, drives the robot at some 2 m/s
REACH = 1.2  # rad, how far the arm swings to either side


def _robot_prbs(seed: int) -> dict[str, np.ndarray]:
    return {"u": FORCE * excitation.prbs(ROBOT_SAMPLES, hold=10), "arm": _wandering_arm("prbs", seed)}


def _robot_rbs(seed: int) -> dict[str, np.ndarray]:
    u = excitation.random_binary(ROBOT_SAMPLES, _seeds(seed)[0], hold=10, probability=0.5)
    return {"u": FORCE * u, "arm": _wandering_arm("rbs", seed)}


def _robot_multisine(seed: int) -> dict[str, np.ndarray]:
    u = excitation.multisine(ROBOT_SAMPLES, _seeds(seed)[0], ROBOT.dt, lines=20, low=0.05, high=10.0)
    return {"u": 2 * FORCE * u, "arm": _wandering_arm("multisine", seed)}


def _wandering_arm(name: str, seed: int) -> np.ndarray:
    """Slow sines with phases of the experiment's own: two records share no motion, and each sees both sides of the reach."""
    phases = _noise_seed(f"{name}, arm", seed)
    return REACH * excitation.multisine(ROBOT_SAMPLES, phases, ROBOT.dt, lines=5, low=0.03, high=0.3)


def _robot_steps(seed: int) -> dict[str, np.ndarray]:
    del seed
    return {
        "u": excitation.staircase(ROBOT_SAMPLES, [0.0, 1.0, 2.0, 0.0, -1.0, -2.0, 0.0]),
        "arm": excitation.staircase(ROBOT_SAMPLES, [0.0, REACH, -REACH, -REACH, 0.0, REACH, -REACH, -REACH, 0.0], rise=75),
    }


def _robot_curve(seed: int) -> dict[str, np.ndarray]:
    """The input that the four curves share, whatever the seed: starts, stops and reversals while the arm takes its places."""
    del seed
    return {
        "u": FORCE * excitation.staircase(ROBOT_SAMPLES, [0.0, 1.0, 0.0, -1.0, 0.5, 1.0, -0.5, -1.0, 0.0, 0.5]),
        # eleven places against ten forces: the two do not change together
        "arm": REACH * excitation.staircase(ROBOT_SAMPLES, [0.0, 0.8, 0.8, 0.2, 0.2, -0.8, -0.8, 0.0, 0.0, 1.0, 1.0], rise=75),
    }


# [2] Fig. 4 shows the response without perturbation (curve 2) and with (1, 3, 4) and prints neither numbers nor which
# perturbation belongs to which curve. Which is which is ours, and so are the sizes: each moves the response by a fifth to a
# quarter (root mean square).
CURVES: dict[str, EffectSizes] = {
    "curve1": {"coulomb@rail": {"level": 0.3}},
    "curve2": {},
    "curve3": {"arm-gravity@rail": {"sine": 0.4, "cosine": 0.1}},
    "curve4": {"platform-mass@rail": {"change": 1.0, "swing": 0.4}},
}


PRBS_HOLD = 5  # samples a step: 0.2 s, within the bandwidth of the loops

EXPERIMENTS: dict[str, dict[str, Plan]] = {
    "web-winding": {
        "prbs1": _winding("prbs1", _prbs),
        "prbs2": _winding("prbs2", _prbs),
        "rbs": _winding("rbs", _rbs),
        "sine": _winding("sine", _sine),
        "rgs": _winding("rgs", _rgs),
        "staircase": _winding("staircase", _staircase),
        "ramp": _winding("ramp", _ramp),
    },
    "welding-robot": {
        "prbs": _open_loop(ROBOT, "prbs", _robot_prbs),
        "rbs": _open_loop(ROBOT, "rbs", _robot_rbs),
        "multisine": _open_loop(ROBOT, "multisine", _robot_multisine),
        "steps": _open_loop(ROBOT, "steps", _robot_steps),
        **{name: _open_loop(ROBOT, name, _robot_curve, effects) for name, effects in CURVES.items()},
    },
    "positioning-axis": {
        "prbs": _open_loop(PLANTS["positioning-axis"], "prbs", lambda seed: {"F": 60.0 * excitation.prbs(10000, hold=200)}),
        "steps": _open_loop(
            PLANTS["positioning-axis"], "steps", lambda seed: {"F": excitation.staircase(10000, [0.0, 50.0, 0.0, -50.0, 0.0])}
        ),
    },
}


def plan(plant: str, experiment: str) -> Plan:
    """The plan of a machine's experiment by name; unknown names are refused with the nearest match."""
    plans = EXPERIMENTS[check_known("plant", plant, EXPERIMENTS)]
    return plans[check_known(f"experiment of {plant}", experiment, plans)]


def measured(plant: Plant, experiment: str, seed: int, effects: EffectSizes | None = None) -> Experiment:
    """The record of a machine's experiment, with the missing physics that belongs to it and `effects`.

    A plant that is sampled otherwise than its plan follows the plan's set-points in time, each held until the next one.
    """
    todo = plan(plant.name, experiment)
    law, scenario = todo.controller, todo.scenario(seed)
    if plant.dt != law.dt:
        samples = round(len(scenario) * law.dt / plant.dt)
        held = np.floor(plant.dt / law.dt * np.arange(samples) + 1e-6).astype(int)  # 1e-6: the same time may round down
        held = np.minimum(held, len(scenario) - 1)
        law = replace(law, dt=plant.dt)
        scenario = replace(scenario, references={name: r[held] for name, r in scenario.references.items()})
    return simulate(plant, law, scenario, effects=todo.effects_with(effects or {})).experiment


def templates_of(machine: str) -> tuple[Template, ...]:
    """The experiments of a machine's plan as tests that a diagnosis may propose: those that hide no effect of their own."""
    plans = EXPERIMENTS.get(machine, {}).items()
    return tuple(Template(name, own.controller, own.scenario(0).references) for name, own in plans if not own.effects)
