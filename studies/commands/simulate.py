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
from workbench.data import Experiment
from workbench.errors import InputError
from workbench.files import write_json
from workbench.lpv import MUCH
from workbench.physics.controller import Loop
from workbench.physics.parameters import EffectSizes
from workbench.provenance import provenance
from workbench.readers import check_units, read_file, write_csv

DURATION = 60.0  # s, of a loop that holds its set-points


def run(options: Namespace) -> int:
    """Run experiments of a plan, or replay the inputs of records; writes <record>.csv and states/<record>.csv."""
    from studies.experiments import EXPERIMENTS, plan
    from workbench.simulation import replay
    from workbench.simulation import simulate as run_plant

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
    plant, machine = found.plant, found.machine
    effects, parameters = parse_effects(options.effect), parse_numbers(options.parameter)
    start = parse_numbers(options.start)
    chosen = options.experiment
    if chosen and options.inputs_from:
        raise InputError("--experiment and --inputs-from exclude each other", mend="give one of the two")
    for name in chosen:
        if chosen.count(name) > 1:
            raise InputError(f"experiment {name} is named twice", mend="name it once, or run again with another --seed")
    _check_setpoint(options)
    other = "--setpoint Y=V,.. for the controller to hold" if options.controller else "--inputs-from RECORD"
    closed = options.setpoint or options.limits
    if not chosen and not options.inputs_from and not closed:
        own = EXPERIMENTS.get(machine, {})
        known = f"--experiment {' | '.join(own)}, or " if own else ""
        raise InputError("which experiment?", mend=f"give {known}{other}")
    controller = choose_controller(options.controller, found.base) if options.controller else None
    own_law = controller.law if controller else None
    if own_law and options.inputs_from:
        mend = "a replay has no loop to close; --setpoint Y=V,.. runs the loop"
        raise InputError("--controller and --inputs-from exclude each other", mend=mend)
    if chosen and machine not in EXPERIMENTS:
        raise InputError(f"plant {plant.name!r} has no experiment plan", mend=f"give {other}")
    held: Any = _held(options, found, own_law, effects, parameters, start) if closed else None
    folder = run_folder(options.out, "simulate")

    summary: list[dict[str, Any]] = []
    jobs = [("plan", name) for name in chosen] + [("record", path) for path in options.inputs_from]
    jobs += [("closed loop", held.experiment.name)] if closed else []
    for kind, name in jobs:
        if kind == "plan":
            todo = plan(machine, name)
            scenario = todo.scenario(options.seed)
            scenario = replace(scenario, seed=None if options.noise_free else scenario.seed, start=start)
            applied = todo.effects_with(effects)
            law = own_law or todo.controller
            done = run_plant(plant, law, scenario, parameters=parameters, effects=applied, bumpless=own_law is not None)
        elif kind == "closed loop":
            applied = effects
            done = held
        else:
            record = check_units(read_file(name), {c.name: c.unit for c in (*plant.inputs, *plant.outputs)})
            applied = effects
            done = replay(plant, record, start=start, parameters=parameters, effects=applied)
        path = folder / f"{done.experiment.name}.csv"
        if kind == "record" and path.resolve() == Path(name).resolve():
            raise InputError("the simulated record would overwrite the measured one", file=path, mend="choose another --out")
        write_csv(done.experiment, path)
        if done.states is not None:
            write_csv(done.states, folder / "states" / f"{done.experiment.name}.csv")  # apart: the folder is a set of records
        say(f"{done.experiment.name}: {len(done.experiment)} samples at {plant.dt:g} s -> {path}")
        entry: dict[str, Any] = {"record": done.experiment.name, "file": str(path), "substeps": done.substeps, "effects": applied}
        if kind == "record":
            entry["scores"] = _replay_scores(plant, record, done.experiment)
        elif own_law:
            entry["tracking"] = _loop_scores(own_law, done.experiment)
            entry["at_limit"] = _at_limits(own_law, done.experiment)
            schedule = own_law.schedule
            known = schedule and hasattr(own_law, "outside")
            if known and (beyond := own_law.outside(done.experiment[schedule])) > MUCH:
                say(f"  {schedule} left the range that the law was made for by {beyond:.0%} of its width; it held the edge value")
            if done.memories and hasattr(done.memories[0], "status"):
                entry["statuses"] = _statuses(done.memories)
        summary.append(entry)
    configuration = {
        "plant": options.plant, "effects": effects, "parameters": parameters, "start": start, "noise_free": options.noise_free,
        "controller": options.controller, "setpoint": options.setpoint, "duration": options.duration, "limits": options.limits,
        "effects_of_plant": plant.effects,
        "effects_of_experiments": {name: plan(machine, name).effects for name in chosen},
    }  # fmt: skip
    read_files = [*options.inputs_from, *found.files, *(controller.files if controller else ()), *filter(None, [options.limits])]
    result = {"runs": summary, "provenance": provenance(configuration, read_files, options.seed)}
    write_json(folder / "simulate.json", result)
    if options.json:
        write_json(options.json, result)
    return 0


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


def _held(options: Namespace, found: Chosen, law: Any, effects: EffectSizes, parameters, start) -> Any:
    """The controller holding its set-points, on a plant or on an identified model once along its whole schedule; or following
    those of a file of limits, on a plant.
    """
    from workbench.lpv import load_model
    from workbench.rehearsal import check_setpoint, hold
    from workbench.robustness.limits import load_limits
    from workbench.simulation import Scenario
    from workbench.simulation import simulate as run_plant

    seed = None if options.noise_free else options.seed
    if options.limits:
        run = load_limits(options.limits).run
        if run is None:
            raise InputError("[run] is missing", file=options.limits, mend="give its duration and set-points")
        if found.model is not None:
            raise InputError("--limits runs on a plant", mend="on a model: --setpoint Y=V,..")
        if run.initial:
            mend = "it is of the proofs of check on a model; a plant begins as [run.start] says"
            raise InputError("[run.initial]", file=options.limits, mend=mend)
        scenario = run.scenario(found.plant, law)
        scenario = replace(scenario, seed=seed, start={**scenario.start, **start})
    else:
        setpoint = parse_numbers(part for text in options.setpoint for part in names(text))
        samples = max(2, round((options.duration or DURATION) / found.plant.dt))
        if found.model is not None:
            if effects or parameters or start:
                raise InputError("a loop on an identified model has no --effect, --parameter and --start", mend="leave them out")
            record = hold(load_model(found.model), law, setpoint, samples, seed)
            return SimpleNamespace(experiment=record, states=None, substeps=1, memories=())
        check_setpoint(law, setpoint)
        references = {r: np.full(samples, setpoint[y]) for r, y in zip(law.references, law.measured, strict=False)}
        scenario = Scenario("setpoint", references, seed, start)
    return run_plant(found.plant, law, scenario, parameters=parameters, effects=effects, bumpless=True)


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
        scores.append({"output": measured, "reference": reference, "unit": unit} | values)
    return scores


def _replay_scores(plant, record, simulated) -> list[dict[str, Any]]:
    """How well the plant, driven by a record's inputs, reproduces the record's outputs (free run)."""
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
                f"  {channel.name}: simulated from the measured inputs, free-run FIT {values['FIT']:.1f}, "
                f"RMSE {values['RMSE']:.4g} {channel.unit}"
            )
            scores.append({"output": channel.name, "horizon": "free-run", "unit": channel.unit} | values)
    return scores
