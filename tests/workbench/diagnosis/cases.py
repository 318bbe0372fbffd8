"""Small machines and records for the tests of the diagnosis: an axis and a robot whose runs take milliseconds.

The axis is also written a second time, as matrices: x+ = A x + B (F + d), y = q + noise, with A, B from the matrix exponential.
"""

from dataclasses import replace

import numpy as np
from scipy.linalg import expm

from plants import POSITIONING_AXIS, WELDING_ROBOT
from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis.fit import Unknowns, gauss_newton, term
from workbench.diagnosis.predictor import Noise, Predictor, predictor
from workbench.diagnosis.recalibrate import recalibrated, unknowns
from workbench.diagnosis.refit import Model
from workbench.diagnosis.screen import Score, scores, signatures, small_sizes, variants
from workbench.physics.controller import Playback
from workbench.physics.plant import Plant
from workbench.simulation import Scenario, simulate

READING, PUSH = 1e-4, 5.0  # m, noise of the axis' encoder; N, force that nobody logged
AXIS = replace(POSITIONING_AXIS, dt=0.02, substeps=4, noise={"q": READING}, disturbance={"F": PUSH})
ROBOT = WELDING_ROBOT


def steps(samples: int, size: float, seed: int, hold: int = 10) -> np.ndarray:
    """Random levels that last `hold` samples each."""
    levels = np.random.default_rng(seed).standard_normal(samples // hold + 1)
    return size * np.repeat(levels, hold)[:samples]


def axis_records(
    seed, effects=None, *, samples=300, records=2, parameters=None, plant=AXIS, start=None, force=300.0, unlogged=None
) -> Dataset:
    """Records of the axis under random steps of the force; effects: for all records, or a list with those of each.

    unlogged (samples): a force that no log holds.
    """
    each = effects if isinstance(effects, list) else [effects] * records
    made = []
    for i, own in enumerate(each):
        scenario = Scenario(
            f"axis {i}",
            {"F": steps(samples, force, 1000 * seed + i)},
            seed=1000 * seed + 500 + i,
            start=start or {},
            disturbance={} if unlogged is None else {"F": unlogged},
        )
        player = Playback(("F",), plant.dt)
        made.append(simulate(plant, player, scenario, parameters=parameters, effects=own, substeps=8).experiment)
    return Dataset(tuple(made))


def robot_records(seed, effects=None, *, samples=500, records=2, parameters=None, swing=1.2) -> Dataset:
    """Records of the robot under random steps of the force with a moving arm, with stops and reversals."""
    made = []
    for i in range(records):
        t = ROBOT.dt * np.arange(samples)
        arm = swing * np.sin(0.7 * t + i) * np.cos(0.23 * t * (i + 1))
        signals = {"u": steps(samples, 2.0, 2000 * seed + i, hold=25), "arm": arm}
        scenario = Scenario(f"robot {i}", signals, seed=2000 * seed + 500 + i)
        player = Playback(("u", "arm"), ROBOT.dt)
        made.append(simulate(ROBOT, player, scenario, parameters=parameters, effects=effects, substeps=8).experiment)
    return Dataset(tuple(made))


def axis_matrices(dt=AXIS.dt, M=95.0, Fv=200.0):
    """A (2, 2) and B (2,) of [q, v] over a sample of held force."""
    rates = np.zeros((3, 3))
    rates[0, 1], rates[1, 1], rates[1, 2] = 1.0, -Fv / M, 1.0 / M
    flow = expm(dt * rates)
    return flow[:2, :2], flow[:2, 2]


def axis_by_hand(
    force, seed, *, extra=None, sensor=0.0, M=95.0, Fv=200.0, coloured=0.0, correlation_time=0.1, samples=600
) -> Experiment:
    """A record of the axis from its matrices. force(k, y) is the command at sample k, after y was read; extra(q, v) a force that
    no effect of the catalogue describes, held over a twentieth of a sample; sensor: what is added to the reading per newton;
    coloured: deviation [m] of noise of the reading with that correlation time [s].
    """
    pieces = 20 if extra else 1
    A, B = axis_matrices(AXIS.dt / pieces, M, Fv)
    random, lasting = np.random.default_rng(seed), np.random.default_rng(seed + 10**6)
    x, rows, c, a = np.zeros(2), [], coloured * lasting.standard_normal(), np.exp(-AXIS.dt / correlation_time)
    for k in range(samples):
        y = x[0] + READING * random.standard_normal() + c
        c = a * c + coloured * np.sqrt(1.0 - a**2) * lasting.standard_normal()
        F = force(k, y)
        d = PUSH * random.standard_normal()
        rows.append((F, y + sensor * F))
        for _ in range(pieces):
            x = A @ x + B * (F + d + (extra(*x) if extra else 0.0))
    channels = (Channel("F", "N", "input"), Channel("q", "m", "output"))
    return Experiment(f"by hand {seed}", AXIS.dt * np.arange(samples), channels, np.array(rows), AXIS.dt)


def noise(reading=1.0, push=1.0) -> Noise:
    """The noise levels of the simulated axis, times these factors: PUSH acts on the rate of the speed, nothing is coloured."""
    return Noise(np.array([reading * READING]), np.array([push * PUSH / AXIS.nominal[0]]), np.array([1e-9]))


def axis_predictor(data: Dataset, plant=AXIS) -> Predictor:
    """The axis' predictor with the noise levels that are true."""
    made = predictor(plant, data)
    return made.regained(made.point, noise())


def fitted(data: Dataset, plant: Plant | None = None) -> Model:
    """The recalibrated model of records of the axis or the robot, or of a plant of the test's own."""
    plant = plant or (AXIS if "q" in data.experiments[0].names else ROBOT)
    made = recalibrated(predictor(plant, data))
    return Model(made.predictor, made.fit)


def with_effect(model: Model, key: str, guess: list[float], names=None) -> tuple[Unknowns, np.ndarray, np.ndarray]:
    """Unknowns of a model and one effect, a first guess, and steps for its sizes."""
    plant = model.predictor.plant
    own = unknowns(model.predictor, (term(plant, key),), names=names)
    z = own.zero()
    z[own.size - own.split[2] :][: len(guess)] = guess
    sizes = np.zeros(len(plant.slots))
    sizes[list(own.terms[0].sizes)] = 1e-3 * np.linalg.norm(guess) + 1e-9
    return own, z, sizes


def refitted(model: Model, key: str, guess: list[float], names=None, *, rounds=6) -> Model:
    """The model with one effect more, fitted from a guess of its sizes."""
    own, z, sizes = with_effect(model, key, guess, names)
    return Model(model.predictor, gauss_newton(model.predictor, own, z, sizes, rounds=rounds, enough=1e-6))


def keys_of(model: Model) -> list[str]:
    """Every effect that fits the model's plant."""
    return list(model.predictor.plant.effect_keys)


def screened(model: Model, keys=None) -> list[Score]:
    """The scores of the catalogue (or of some effects) beside a model."""
    sizes = small_sizes(model.predictor, model.fit)
    tried = variants(model.predictor, model.fit, keys or keys_of(model), sizes)
    tried = [v for v in tried if not np.isnan(v.finite) or all(sizes[s] > 0.0 for s in v.sizes)]
    return scores(signatures(model.predictor, model.fit, tried, sizes))
