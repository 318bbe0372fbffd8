"""`workbench simulate`: run experiments of a plan, close a loop, or replay the inputs of records."""

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from plants import PLANTS
from studies.arguments import Chosen, choose_controller, choose_plant, names, parse_effects, parse_numbers, run_folder
from studies.terminal import note, say
from workbench.data import Dataset, Experiment
from workbench.errors import InputError
from workbench.files import write_json
from workbench.lpv import MUCH, scheduled
from workbench.physics.controller import Loop, schedules_of
from workbench.physics.parameters import EffectSizes
from workbench.provenance import provenance
from workbench.readers import read_file, write_csv
from workbench.records import record
from workbench.units import check_units, in_units

DURATION = 60.0  # s, of a loop that holds its set-points
FAR = 100.0  # times the largest set-point, beyond which a loop is lost


@record
class Ran:
    """One run, with the effects that acted; measured: the record whose inputs drove it, where it was one."""

    done: Any
    effects: EffectSizes
    measured: Experiment | None = None


@record
class Setup:
    """What runs: the plant that was chosen, its changed numbers and effects, and the law of the user's own, if any."""

    chosen: Chosen
    effects: EffectSizes
    parameters: dict[str, float]
    start: dict[str, float]
    law: Any = None


def run(options: Namespace) -> int:
    """Run experiments of a plan, or replay the inputs of records; writes <record>.csv and states/<record>.csv."""
    if options.old_quiet:
        options.noise_free = True
        note("--quiet is --noise-free now; from the next version on it silences progress, as in the other commands")
    if options.replay:
        from studies.replays import run as run_replay

        return run_replay(options, say)
    if options.plant is None:
        raise InputError("which plant?", mend=f"name one: {', '.join(PLANTS)}, or a file of your own")
    if options.seed is None:
        options.seed = 0
    found = choose_plant(options.plant)
    setup = Setup(found, parse_effects(options.effect), parse_numbers(options.parameter), parse_numbers(options.start))
    _check_runs(options, found)
    controller = choose_controller(options.controller, found.base) if options.controller else None
    setup = replace(setup, law=controller.law if controller else None)
    _check_law(options, setup)
    held = _held(options, setup) if options.setpoint or options.limits else None
    folder = run_folder(options.out, "simulate")

    summary = [_written(setup, _planned(options, setup, name), folder) for name in options.experiment]
    summary += [_written(setup, _replayed(setup, path), folder, Path(path)) for path in options.inputs_from]
    summary += [_written(setup, Ran(held, setup.effects), folder)] if held is not None else []
    read_files = [*options.inputs_from, *found.files, *(controller.files if controller else ()), *filter(None, [options.limits])]
    result = {"runs": summary, "provenance": provenance(_configuration(options, setup), read_files, options.seed)}
    write_json(folder / "simulate.json", result)
    if options.json:
        write_json(options.json, result)
    return 0


def _check_runs(options: Namespace, found: Chosen) -> None:
    """Refuse options of runs that do not go together, and none at all."""
    from studies.experiments import EXPERIMENTS

    chosen = options.experiment
    if chosen and options.inputs_from:
        raise InputError("--experiment and --inputs-from exclude each other", mend="give one of the two")
    for name in chosen:
        if chosen.count(name) > 1:
            raise InputError(f"experiment {name} is named twice", mend="name it once, or run again with another --seed")
    _check_setpoint(options)
    if not (chosen or options.inputs_from or options.setpoint or options.limits):
        own = EXPERIMENTS.get(found.machine, {})
        known = f"--experiment {' | '.join(own)}, or " if own else ""
        raise InputError("which experiment?", mend=f"give {known}{_other(options)}")


def _check_law(options: Namespace, setup: Setup) -> None:
    """Refuse a law where no loop is closed, and experiments of a plant that has none."""
    from studies.experiments import EXPERIMENTS

    if setup.law and options.inputs_from:
        mend = "a replay has no loop to close; --setpoint Y=V,.. runs the loop"
        raise InputError("--controller and --inputs-from exclude each other", mend=mend)
    if options.experiment and setup.chosen.machine not in EXPERIMENTS:
        problem = f"plant {setup.chosen.plant.name!r} has no experiment plan"
        raise InputError(problem, mend=f"give {_other(options)}")


def _other(options: Namespace) -> str:
    """What may be run besides experiments of a plan."""
    return "--setpoint Y=V,.. for the controller to hold" if options.controller else "--inputs-from RECORD"


def _planned(options: Namespace, setup: Setup, name: str) -> Ran:
    """An experiment of the plan, under the law of the user's own or that of the plan."""
    from studies.experiments import plan
    from workbench.simulation import simulate

    todo = plan(setup.chosen.machine, name)
    scenario = todo.scenario(options.seed)
    scenario = replace(scenario, seed=None if options.noise_free else scenario.seed, start=setup.start)
    applied, own = todo.effects_with(setup.effects), setup.law
    done = simulate(
        setup.chosen.plant, own or todo.controller, scenario, parameters=setup.parameters, effects=applied,
        bumpless=own is not None,
    )  # fmt: skip
    return Ran(done, applied)


def _replayed(setup: Setup, path: str) -> Ran:
    """The plant driven by the inputs of a record."""
    from workbench.simulation import replay

    plant = setup.chosen.plant
    units = {c.name: c.unit for c in (*plant.inputs, *plant.outputs)}
    records = in_units(Dataset((read_file(path),)), units)
    for told in records.notes:
        say(f"note: {told}")
    measured = check_units(records.experiments[0], units)
    done = replay(plant, measured, start=setup.start, parameters=setup.parameters, effects=setup.effects)
    return Ran(done, setup.effects, measured)


def _written(setup: Setup, ran: Ran, folder: Path, source: Path | None = None) -> dict[str, Any]:
    """The record and states of a run as files, and what simulate.json says of it; source: the file of the measured record."""
    done, plant = ran.done, setup.chosen.plant
    path = folder / f"{done.experiment.name}.csv"
    if source is not None and path.resolve() == source.resolve():
        raise InputError("the simulated record would overwrite the measured one", file=path, mend="choose another --out")
    write_csv(done.experiment, path)
    if done.states is not None:
        write_csv(done.states, folder / "states" / f"{done.experiment.name}.csv")  # apart: the folder is a set of records
    say(f"{done.experiment.name}: {len(done.experiment)} samples at {plant.dt:g} s -> {path}")
    entry = {"record": done.experiment.name, "file": str(path), "substeps": done.substeps, "effects": ran.effects}
    if ran.measured is not None:
        return entry | {"scores": _replay_scores(plant, ran.measured, done.experiment)}
    return entry | _followed(setup.law, done) if setup.law else entry


def _followed(law: Any, done: Any) -> dict[str, Any]:
    """How the law of the user's own did in a run: tracking, time at limits, and what its solver said."""
    found: dict[str, Any] = {"tracking": _loop_scores(law, done.experiment), "at_limit": _at_limits(law, done.experiment)}
    schedules = schedules_of(law)
    if schedules and hasattr(law, "outside"):
        rho = scheduled(done.experiment, [done.experiment.channel(name) for name in schedules])
        if (beyond := law.outside(rho)) > MUCH:
            own = ", ".join(schedules)
            say(f"  {own} left the range that the law was made for by {beyond:.0%} of its width; it held the edge value")
    if done.memories and hasattr(done.memories[0], "status"):
        found["statuses"] = _statuses(done.memories)
    return found


def _configuration(options: Namespace, setup: Setup) -> dict[str, Any]:
    from studies.experiments import plan

    return {
        "plant": options.plant, "effects": setup.effects, "parameters": setup.parameters, "start": setup.start,
        "noise_free": options.noise_free, "controller": options.controller, "setpoint": options.setpoint,
        "duration": options.duration, "limits": options.limits, "effects_of_plant": setup.chosen.plant.effects,
        "effects_of_experiments": {name: plan(setup.chosen.machine, name).effects for name in options.experiment},
    }  # fmt: skip


def _check_setpoint(options: Namespace) -> None:
    """Refuse what does not go with --setpoint and --limits."""
    if options.duration is not None and not options.setpoint:
        raise InputError("--duration is for --setpoint", mend="an experiment has its own length, a record too")
    if not (options.setpoint or options.limits):
        return
    own = "--setpoint" if options.setpoint else "--limits"
    if not options.controller:
        raise InputError(f"{own} is for a controller to follow", mend="give --controller FILE")
    if options.experiment or options.inputs_from or (options.setpoint and options.limits):
        raise InputError(f"{own} goes with no other run", mend="give one of --experiment, --inputs-from, --setpoint and --limits")


def _held(options: Namespace, setup: Setup) -> Any:
    """The controller holding its set-points, on a plant or on an identified model once along its whole schedule; or following
    those of a file of limits, on a plant.
    """
    from workbench.simulation import simulate

    if not options.limits and setup.chosen.model is not None:
        return _on_model(options, setup)
    scenario = _of_limits(options, setup) if options.limits else _at_setpoint(options, setup)
    plant, law = setup.chosen.plant, setup.law
    return simulate(plant, law, scenario, parameters=setup.parameters, effects=setup.effects, bumpless=True)


def _of_limits(options: Namespace, setup: Setup) -> Any:
    """The run that a file of limits describes."""
    from workbench.robustness.limits import load_limits

    run = load_limits(options.limits).run
    if run is None:
        raise InputError("[run] is missing", file=options.limits, mend="give its duration and set-points")
    if setup.chosen.model is not None:
        raise InputError("--limits runs on a plant", mend="on a model: --setpoint Y=V,..")
    if run.initial:
        mend = "it is of the proofs of check on a model; a plant begins as [run.start] says"
        raise InputError("[run.initial]", file=options.limits, mend=mend)
    scenario = run.scenario(setup.chosen.plant, setup.law)
    seed = None if options.noise_free else options.seed
    return replace(scenario, seed=seed, start={**scenario.start, **setup.start})


def _setpoint(options: Namespace, setup: Setup) -> tuple[dict[str, float], int]:
    """The set-points of --setpoint by output, and the samples for which they are held."""
    setpoint = parse_numbers(part for text in options.setpoint for part in names(text))
    return setpoint, max(2, round((options.duration or DURATION) / setup.chosen.plant.dt))


def _at_setpoint(options: Namespace, setup: Setup) -> Any:
    """Constant set-points for the plant."""
    from workbench.rehearsal import check_setpoint
    from workbench.simulation import Scenario

    law, (setpoint, samples) = setup.law, _setpoint(options, setup)
    check_setpoint(law, setpoint)
    references = {r: np.full(samples, setpoint[y]) for r, y in zip(law.references, law.measured, strict=False)}
    return Scenario("setpoint", references, None if options.noise_free else options.seed, setup.start)


def _on_model(options: Namespace, setup: Setup) -> Any:
    """Constant set-points for an identified model, whose schedule runs once along its whole range."""
    from workbench.hammerstein import load_either
    from workbench.rehearsal import hold

    setpoint, samples = _setpoint(options, setup)
    if setup.effects or setup.parameters or setup.start:
        raise InputError("a loop on an identified model has no --effect, --parameter and --start", mend="leave them out")
    seed = None if options.noise_free else options.seed
    record = hold(load_either(str(setup.chosen.model)), setup.law, setpoint, samples, seed)
    return SimpleNamespace(experiment=record, states=None, substeps=1, memories=())


def _at_limits(law: Any, run: Experiment) -> dict[str, float]:
    """The share of samples at which each command stood at one of its limits; of a law that tells none, 0."""
    found = {}
    none = np.full(len(law.actuated), np.inf)
    for name, low, high in zip(law.actuated, getattr(law, "low", -none), getattr(law, "high", none), strict=True):
        u = run[name]
        found[name] = float(np.mean((u <= low) | (u >= high)))
        limits = f", at a limit for {found[name]:.1%} of the time" if found[name] else ""
        say(f"  {name}: from {u.min():.4g} to {u.max():.4g}{limits}")
    return found


def _statuses(memories: Sequence[Any]) -> dict[str, int]:
    """How often each status stood behind a command."""
    from controllers.receding import count_statuses

    found = count_statuses(memories)
    say("  commands: " + ", ".join(f"{status} {times}" for status, times in found.items()))
    return found


def _loop_scores(law: Loop, run: Experiment) -> list[dict[str, Any]]:
    """How well each measured output followed its set-point."""
    from workbench.metrics import tracking

    scores = []
    for measured, reference in zip(law.measured, law.references, strict=False):
        values = tracking(run[reference] - run[measured], run.dt)
        unit = next(c.unit for c in run.channels if c.name == measured)
        numbers = ", ".join(f"{key} {value:.4g} {unit}" for key, value in values.items())
        say(f"  {measured}: error {numbers} s")
        gone = np.abs(run[reference] - run[measured]) > FAR * np.abs(run[reference]).max()
        if gone.any() and np.any(run[reference]):
            at = run.t[int(gone.argmax())] - run.t[0]
            say(f"  the loop is lost: {at:.4g} s after the start {measured} is {FAR:g} times its set-point away from it")
        scores.append({"output": measured, "reference": reference, "unit": unit} | values)
    return scores


def _replay_scores(plant, record, simulated) -> list[dict[str, Any]]:
    """How well the plant, driven by a record's inputs, reproduces the record's outputs: a free run from the plant's own rest."""
    from workbench import metrics

    scores = []
    for channel in plant.outputs:
        if channel.name in record.names:
            y, ys = record[channel.name], simulated[channel.name]
            try:
                values = {"FIT": metrics.fit(y, ys), "RM": metrics.rm(y, ys), "RMSE": metrics.rmse(y, ys)}
            except InputError:
                continue  # a channel that does not move has no FIT
            say(
                f"  {channel.name}: simulated from the measured inputs and its own rest, FIT {values['FIT']:.1f}, "
                f"RMSE {values['RMSE']:.4g} {channel.unit}"
            )
            scores.append({"output": channel.name, "horizon": "free-run", "unit": channel.unit} | values)
    return scores
