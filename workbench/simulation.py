"""Plant + controller + scenario -> record: one run, or a batch side by side.

Inputs are held between samples, those that move on their own too; measurement noise is added at the sampling instants, and
each input carries an unlogged white disturbance. Both come from the scenario's seed and from nothing else: the same seed gives
the same numbers in a single run and anywhere in a batch.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from workbench.data import SAME_DT, Channel, Experiment, bad_stamps
from workbench.errors import InputError, check_known
from workbench.physics import stepper
from workbench.physics.controller import Controller, Loop, Playback, Stepped, schedules_of
from workbench.physics.parameters import EffectSizes
from workbench.physics.plant import Plant
from workbench.records import field, record
from workbench.units import check_law_units


class LeftRangeError(InputError):
    """A run has left the range in which its plant's equation means something."""


@record
class Scenario:
    """What happens during a run: set-points by name (N,), start values, disturbances by input (N,), and the seed.

    seed None: no noise and no disturbance but the given ones. start: values that replace those of the plant's equilibrium.

        >>> step = Scenario("step", {"U": np.repeat([0.0, 5.0], 100)}, seed=None)  # 2 s at 10 ms, without noise
        >>> len(step)
        200
    """

    name: str
    references: Mapping[str, np.ndarray]
    seed: int | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    disturbance: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self):
        lengths = {name: len(values) for name, values in ({**self.references, **self.disturbance}).items()}
        if len(set(lengths.values())) != 1:
            raise InputError(f"sequences of different lengths: {lengths}", file=self.name)

    def __len__(self) -> int:
        return len(next(iter(self.references.values())))


@record
class Run:
    """A simulated record: what a logger would have seen, and the states behind it.

    memories: of a controller that is asked step by step, after each of its samples.
    """

    experiment: Experiment
    states: Experiment
    substeps: int
    memories: tuple = ()


def simulate(
    plant: Plant,
    controller: Controller | Stepped,
    scenario: Scenario,
    *,
    parameters: Mapping[str, float] | None = None,
    effects: EffectSizes | None = None,
    substeps: int | None = None,
    bumpless: bool = False,
    cut: bool = False,
) -> Run:
    """One closed-loop run of `plant` under `controller`: what a logger would have seen, and the states behind it.

    Inputs are held between samples; noise and disturbances come from the scenario's seed and from nothing else.

    parameters: values that differ from the nominal ones. effects: missing physics that is switched on, e.g.
    {"coulomb@unwind": {"level": 0.002}}. substeps: integrator steps a sample; default: as many as the run needs.
    bumpless: the controller takes over from the inputs of the start, else it begins as its `init` says. cut: a run that leaves
    the range of the plant ends there; else it is refused with LeftRangeError, and so it is in any case with less than 2 samples.

        >>> run = simulate(MOTOR, law, Scenario("hold", {"n_set": np.full(300, 20.0)}, seed=1))
        >>> f"{run.experiment['n'][-1]:.1f} rad/s", run.experiment.names
        ('20.1 rad/s', ('U', 'n', 'way', 'n_set'))
    """
    lanes = _lanes(plant, controller, [scenario], plant.parameter_vector(parameters), plant.effect_vector(effects), bumpless)
    used = _substeps(plant, lanes, substeps)
    memories: list = []
    if isinstance(controller, Controller):
        run = stepper.run(plant, controller, lanes, used)
    else:
        held = lanes.hold[0, [plant.input_names.index(name) for name in controller.actuated]]
        run, memories = stepper.run_stepwise(plant, controller, lanes, used, controller.init(held if bumpless else None))
    k = int(outside(plant, run.states)[0])
    if not cut or k < 2:
        _check_range(plant, scenario, run.states[0], run.commands[0], k)
    t = plant.dt * np.arange(k)
    units = {c.name: c.unit for c in plant.outputs} | {c.name: c.unit for c in plant.inputs}
    sources = dict(zip(controller.references, controller.measured, strict=False))
    logged = [] if isinstance(controller, Playback) else list(controller.references)
    # what moves on its own is in the log where it was given: a column that merely stands at 0 was never measured
    shown = [i for i, c in enumerate(plant.inputs) if c.name in (*plant.commanded, *controller.actuated)]
    channels = (
        *(plant.inputs[i] for i in shown),
        *plant.outputs,
        *(Channel(name, units.get(sources.get(name, ""), ""), "reference") for name in logged),
    )
    columns = [run.commands[0][:, shown], run.measured[0], *(scenario.references[name] for name in logged)]
    values = np.column_stack([column[:k] for column in columns])
    return Run(
        Experiment(scenario.name, t, channels, values, plant.dt),
        Experiment(f"{scenario.name} states", t, plant.states, run.states[0][:k], plant.dt),
        used,
        tuple(memories[: -(-k // round(controller.dt / plant.dt))]),
    )


def simulate_batch(
    plant: Plant,
    controller: Controller,
    scenarios: Scenario | Sequence[Scenario],
    *,
    parameters: np.ndarray | None = None,
    effects: np.ndarray | None = None,
    substeps: int | None = None,
    threads: int | None = None,
    bumpless: bool = False,
    alone: bool = False,
) -> stepper.Trajectories:
    """R runs side by side: `parameters` (R, np) and `effects` (R, ne) in the plant's order, one scenario or one a run.

    The answer holds states (R, N, nx), measured outputs (R, N, ny) and commands (R, N, nu). Raises InputError for other shapes.
    alone: every run takes as many integrator steps as it needs by itself, so that it is the same to the last bit whatever runs
    beside it; else all take those of the one that needs most. From the sample on at which a run leaves the plant's limits or the
    finite range it is NaN: in a sweep that is a result, not a failure.

        >>> heavier = MOTOR.nominal * np.array([[1.0, 1, 1, 1], [1.5, 1, 1, 1]])  # J, b, c, kT of two motors
        >>> simulate_batch(MOTOR, law, Scenario("hold", {"n_set": np.full(300, 20.0)}), parameters=heavier).measured.shape
        (2, 300, 2)
    """
    each = [scenarios] if isinstance(scenarios, Scenario) else list(scenarios)
    p = plant.nominal[None] if parameters is None else np.atleast_2d(parameters)
    eta = plant.effect_vector()[None] if effects is None else np.atleast_2d(effects)
    R = max(len(each), len(p), len(eta))
    for kind, size in (("scenarios", len(each)), ("parameters", len(p)), ("effects", len(eta))):
        if size not in (1, R):
            raise InputError(f"{size} {kind} for {R} runs", file=plant.name, mend=f"give 1 or {R}")
    lanes = _lanes(plant, controller, each, p, eta, bumpless)
    threads = threads or stepper.cores()
    if alone and substeps is None:
        run = _each_alone(plant, controller, lanes, threads)
    else:
        run = stepper.run(plant, controller, lanes, _substeps(plant, lanes, substeps), threads)
    for i, k in enumerate(outside(plant, run.states)):
        for values in (run.states, run.measured, run.commands):
            values[i, k:] = np.nan
    return run


def replay(plant: Plant, experiment: Experiment, *, start: Mapping[str, float] | None = None, **options) -> Run:
    """The plant driven by the inputs of a measured record, from a given start: the simulation a record is compared with.

    The record must hold every commanded input; one that moves on its own is taken from it where it was logged.

        >>> replay(MOTOR, held_out.experiments[0]).experiment["n"].shape
        (600,)
    """
    for name in plant.needed:
        check_known("channel", name, experiment.names, file=experiment.name)
    if abs(experiment.dt - plant.dt) > SAME_DT * plant.dt:
        raise InputError(
            f"sampled every {experiment.dt:g} s, the plant every {plant.dt:g} s",
            file=experiment.name,
            mend="resample the record",
        )
    for bad in bad_stamps(experiment.t, experiment.dt):
        raise InputError(f"{bad.fault} stamp at {bad.before:g} s", file=experiment.name, mend="cut the record there with trim")
    played = tuple(name for name in plant.input_names if name in plant.commanded or name in experiment.names)
    scenario = Scenario(experiment.name, {name: experiment[name] for name in played}, start=start or {})
    run = simulate(plant, Playback(played, plant.dt), scenario, **options)
    return replace(run, experiment=replace(run.experiment, t=experiment.t), states=replace(run.states, t=experiment.t))


def _each_alone(plant: Plant, controller: Controller, lanes: stepper.Lanes, threads: int) -> stepper.Trajectories:
    """The runs that take the same number of steps together, one such group after the other."""
    needed = stepper.substeps_for(plant, lanes.parameters, lanes.effects, lanes.start, lanes.hold)
    parts: dict[str, np.ndarray] = {}
    for used in np.unique(needed):
        own = np.flatnonzero(needed == used)
        group = stepper.run(plant, controller, replace(lanes, **{k: v[own] for k, v in vars(lanes).items()}), int(used), threads)
        for name in ("states", "measured", "commands"):
            values = getattr(group, name)
            parts.setdefault(name, np.empty((len(needed), *values.shape[1:])))[own] = values
    return stepper.Trajectories(**parts)


def _substeps(plant: Plant, lanes: stepper.Lanes, wanted: int | None) -> int:
    if wanted is not None and wanted < 1:
        raise InputError(f"substeps {wanted}", mend="at least one integrator step a sample")
    return wanted or int(stepper.substeps_for(plant, lanes.parameters, lanes.effects, lanes.start, lanes.hold).max())


def _lanes(
    plant: Plant, controller: Controller | Stepped, scenarios: list[Scenario], p: np.ndarray, eta: np.ndarray, bumpless: bool
) -> stepper.Lanes:
    p, eta = np.atleast_2d(p), np.atleast_2d(eta)
    plant.check_parameters(p)
    plant.check_effects(eta)
    R, N = max(len(scenarios), len(p), len(eta)), len(scenarios[0])
    distinct = list({id(scenario): scenario for scenario in scenarios}.values())  # in a sweep few differ
    for scenario in distinct:
        _check_scenario(plant, controller, scenario, N)
    p, eta = np.broadcast_to(p, (R, p.shape[1])), np.broadcast_to(eta, (R, eta.shape[1]))
    start, hold = np.empty((R, len(plant.states))), np.empty((R, len(plant.inputs)))
    starts = {id(scenario): tuple(sorted(scenario.start.items())) for scenario in distinct}
    for values in set(starts.values()):
        own = [i for i in range(R) if starts[id(scenarios[i % len(scenarios)])] == values]
        start[own], hold[own] = plant.equilibria(p[own], **dict(values))
    gains, memory = np.empty((R, 0)), np.empty((R, 0))
    if isinstance(controller, Controller):
        commanded = hold[:, [plant.input_names.index(name) for name in controller.actuated]]
        gains = np.broadcast_to(controller.gains, (R, len(controller.gains)))
        memory = np.reshape([controller.init(u if bumpless else None) for u in commanded], (R, -1))
    number = {id(scenario): i for i, scenario in enumerate(distinct)}
    which = [number[id(scenario)] for scenario in scenarios]
    signals = zip(*(_signals(plant, controller, scenario) for scenario in distinct), strict=True)
    reference, disturbance, noise = (np.broadcast_to(np.stack(s)[which], (R, *s[0].shape)) for s in signals)
    return stepper.Lanes(
        parameters=p,
        effects=eta,
        gains=gains,
        memory=memory,
        start=start,
        hold=hold,
        reference=reference,
        disturbance=disturbance,
        noise=noise,
    )


def _check_scenario(plant: Plant, controller: Loop, scenario: Scenario, N: int) -> None:
    for name in (*controller.measured, *schedules_of(controller)):
        if name in plant.input_names and name not in plant.output_names:
            raise InputError(
                f"the law measures {name!r}, which is an input of {plant.name}",
                file=controller.name,
                channel=name,
                mend=f"a loop needs a plant in which {name!r} is a state and an output",
            )
        check_known("measured channel", name, plant.output_names, file=controller.name)
    for name in controller.actuated:
        check_known("input", name, plant.input_names, file=controller.name)
    check_law_units(controller, (*plant.inputs, *plant.outputs), plant.name)
    for name in scenario.references:
        check_known("set-point", name, controller.references, file=scenario.name)
    for name in controller.references:
        if name not in scenario.references:
            raise InputError(f"no set-point {name!r} for controller {controller.name!r}", file=scenario.name)
    for name in scenario.disturbance:
        check_known("input", name, plant.input_names, file=scenario.name)
    if len(scenario) != N:
        raise InputError(f"{len(scenario)} samples, the first scenario of the batch has {N}", file=scenario.name)


def _signals(plant: Plant, controller: Loop, scenario: Scenario) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """References (N, nr), input disturbances (N, nu) and measurement noise (N, ny) of one scenario."""
    N = len(scenario)
    reference = np.empty((N, len(controller.references)))
    for i, name in enumerate(controller.references):
        reference[:, i] = scenario.references[name]
    disturbance, noise = np.zeros((N, len(plant.inputs))), np.zeros((N, len(plant.outputs)))
    if scenario.seed is not None:
        random = np.random.default_rng(scenario.seed)
        disturbance = random.standard_normal((N, len(plant.inputs)))
        disturbance *= [plant.disturbance.get(name, 0.0) for name in plant.input_names]
        noise = random.standard_normal((N, len(plant.outputs))) * [plant.noise.get(name, 0.0) for name in plant.output_names]
    for name, values in scenario.disturbance.items():
        disturbance[:, plant.input_names.index(name)] += values
    return reference, disturbance, noise


def lost_command(commands: np.ndarray, k: int) -> int | None:
    """First sample before k at which commands (N, nu) are no numbers: what the state is lost by; None where there is none."""
    lost = np.isnan(commands[:k]).any(axis=1)
    return int(lost.argmax()) if lost.any() else None


def outside(plant: Plant, states: np.ndarray) -> np.ndarray:
    """First sample at which each run (R, N, nx) has left the plant's limits or the finite range; N where none has."""
    low, high = np.array([plant.limits.get(name, (-np.inf, np.inf)) for name in plant.state_names]).T
    bad = ~(np.isfinite(states) & (states >= low) & (states <= high)).all(axis=2)
    return np.where(bad.any(axis=1), bad.argmax(axis=1), states.shape[1])


def _check_range(plant: Plant, scenario: Scenario, states: np.ndarray, commands: np.ndarray, k: int) -> None:
    """Refuse a run (N, nx) that left the range in which the plant's equation means something at sample k < N."""
    if k == len(states):
        return
    if (at := lost_command(commands, k)) is not None:
        raise LeftRangeError(
            f"the law commands no number at t = {at * plant.dt:g} s",
            file=f"{plant.name}, {scenario.name}",
            mend="is something divided by 0, or a root taken of what is negative?",
        )
    for channel, value in zip(plant.states, states[k], strict=True):
        low, high = plant.limits.get(channel.name, (-np.inf, np.inf))
        if not (np.isfinite(value) and low <= value <= high):
            raise LeftRangeError(
                f"{value:.3g} {channel.unit} at t = {k * plant.dt:g} s, outside [{low:g}, {high:g}] {channel.unit}",
                file=f"{plant.name}, {scenario.name}",
                channel=channel.name,
                mend="an unstable loop, or a run that is too long? check gains, effects, start values and duration",
            )
