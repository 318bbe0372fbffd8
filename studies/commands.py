"""The commands behind the command line: each reads files, calls the workbench, writes files and says what it found."""

import os
import sys
from argparse import Namespace
from collections.abc import Iterable, Sequence
from dataclasses import replace
from inspect import signature
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TextIO

import numpy as np

from plants import PLANTS
from studies.arguments import Chosen, check_file, choose_controller, choose_plant, names, parse_effects, parse_numbers, run_folder
from studies.results import Result, scores_file
from workbench.data import Dataset, Experiment, check_held_out
from workbench.errors import InputError, check_known
from workbench.files import read_json, write_json
from workbench.physics.controller import Loop
from workbench.physics.plant import EffectSizes
from workbench.provenance import provenance
from workbench.readers import check_units, read_file, write_csv
from workbench.sources import read

DURATION = 60.0  # s, of a loop that holds its set-points
MUCH = 0.02  # of the width of a schedule range, by which a record may leave it unsaid
INTERVAL = "interval"  # the model kind beside the methods of `workbench.identify`


def run(options: Namespace) -> int:
    """Run the command that was asked for; returns the exit code."""
    check_file(options.json, "--json")
    commands = {
        "simulate": simulate, "identify": identify, "compare": compare, "calibrate": calibrate, "diagnose": diagnose,
        "design": design, "export": export, "check": check, "effects": effects, "doctor": doctor, "sweep": sweep,
        "report": report, "study": study,
    }  # fmt: skip
    return commands[options.command](options)


def say(text: str = "") -> None:
    """A result, on standard output."""
    _print(text, sys.stdout)


def progress(text: str) -> None:
    """What is being done, on standard error."""
    _print(f"  {text}", sys.stderr)


def _print(text: str, stream: TextIO) -> None:
    try:
        print(text, file=stream, flush=True)
    except BrokenPipeError:  # `| head` has read enough: the files are wanted all the same
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


# ---- simulate -------------------------------------------------------------------------------------------------------


def simulate(options: Namespace) -> int:
    """Run experiments of a plan, or replay the inputs of records; writes <record>.csv and states/<record>.csv."""
    from studies.experiments import EXPERIMENTS, plan
    from workbench.simulate import replay
    from workbench.simulate import simulate as run_plant

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
            scenario = replace(scenario, seed=None if options.quiet else scenario.seed, start=start)
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
        "plant": options.plant, "effects": effects, "parameters": parameters, "start": start, "quiet": options.quiet,
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
    from studies.rehearsal import check_setpoint, hold
    from workbench.lpv import load_model
    from workbench.robustness.limits import load_limits
    from workbench.simulate import Scenario
    from workbench.simulate import simulate as run_plant

    seed = None if options.quiet else options.seed
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


def design(options: Namespace) -> int:
    """Design a controller on an identified model."""
    from studies.design import design as run_design

    return run_design(options, say, progress)


def check(options: Namespace) -> int:
    """Prove or refute limits of a loop."""
    from studies.check import check as run_check

    return run_check(options, say, progress)


def export(options: Namespace) -> int:
    """Write a controller for another program."""
    from studies.exports import export as run_export

    return run_export(options, say)


# ---- identify and compare -----------------------------------------------------------------------------------------------


def identify(options: Namespace) -> int:
    """Fit the models asked for, save them, score them on estimation and held-out records."""
    from studies.envelopes import check_interval_options, described_modes, fit_outputs, interval_configuration, interval_method
    from workbench.decimation import thinned
    from workbench.identify import METHODS
    from workbench.intervals.coverage import cover

    wanted = tuple(METHODS) if options.model in ("all", "best") else names(options.model)
    for method in wanted:
        check_known("model", method, (*METHODS, INTERVAL, "all", "best"))
    interval = interval_method(options) if INTERVAL in wanted else check_interval_options(options)
    wanted = tuple(method for method in wanted if method != INTERVAL)
    roles = {"inputs": names(options.inputs), "outputs": names(options.outputs), "schedule": names(options.schedule)}
    dataset, thinner = thinned(_read(options.records, roles), options.dt)
    held_out = _read(options.validate, roles) if options.validate else None
    _check_roles(dataset, wanted)
    if held_out:
        held_out = thinned(held_out, dataset.dt)[0] if thinner else held_out
        check_held_out(dataset, held_out)
    if thinner:
        say(f"note: {', '.join(dataset.names)}: {thinner}")
    say(_described(dataset))
    _say_advice(dataset, options.order)
    if held_out:
        _say_advice(held_out, options.order, warnings_only=True)
    if not dataset.experiments[0].names_of("schedule") and "ilm" in wanted:
        progress("ilm: skipped, it needs a schedule (--schedule)")
        wanted = tuple(method for method in wanted if method != "ilm")
    methods = {name: METHODS[name](**_method_options(options, name)) for name in wanted}
    bounded = {}
    if interval is not None:  # first, for it refuses most: then nothing is written
        progress(f"{INTERVAL}: identifying")
        bounded = fit_outputs(interval, dataset)
    folder = run_folder(options.out, "identify")
    results: list[Result] = []
    for method, model in _fitted(options.model, methods, dataset) if wanted else ():
        if np.any(model.D):
            say(f"note: {method}: outputs see the inputs of their own sample, which held commands cannot do (--no-feedthrough)")
        for note in model.notes:
            say(f"note: {method}: {note}")
        results.append(Result(model, str(folder / f"{method}.json"), _scores(model, dataset, held_out, options.horizon)))
    for name, model in bounded.items():
        for line in described_modes(model):
            say(line)
        envelopes = cover(model, dataset, "estimation") + (cover(model, held_out, "held-out") if held_out else ())
        results.append(Result(model, str(folder / f"{name}.json"), tuple(c.nominal for c in envelopes), envelopes))
    code = _refereed(options, results, dataset, held_out or dataset)
    if not options.validate:
        say("no held-out records: these scores are of the records the models were made from. Add --validate RECORD.")
    configuration = (
        {"model": options.model, "order": options.order, "feedthrough": options.feedthrough, "dt": dataset.dt}
        | roles
        | (interval_configuration(interval) if interval else {})
    )
    _write(options, folder, results, configuration, held_out or dataset, [*options.records, *options.validate])
    return code


def _refereed(options: Namespace, results: list[Result], estimation: Dataset | None, judged: Dataset) -> int:
    """Say what speaks against each model, then the scores of the others, and save these; 3 where none is left.

    The results of models that are not handed out keep their scores for the file, and have no file of their own.
    """
    from studies.objections import objections
    from studies.referee import handed_out

    found = objections(results, estimation, judged)
    against = list(dict.fromkeys(sentence for own in found for sentence in own))
    kept = [result for result, own in zip(results, found, strict=True) if options.accept or not own]
    code = handed_out(against, options.accept, say)
    for i, result in enumerate(results):
        results[i] = replace(result, against=found[i], file=result.file if result in kept else "")
        if options.command == "identify" and result in kept:
            result.model.save(result.file)
    if kept:
        _say_scores(kept)
        _say_envelopes(kept)
    return 0 if kept else code


def _method_options(options: Namespace, method: str) -> dict[str, Any]:
    """What the options ask of a method."""
    own: dict[str, Any] = {} if options.order is None else {"order": options.order}
    if options.feedthrough is not None and method != "ilm":  # which has none
        own["feedthrough"] = options.feedthrough
    return own


def _say_advice(dataset: Dataset, order: int | None = None, *, warnings_only: bool = False) -> None:
    from workbench.advice import advice

    for note in advice(dataset, order=order):
        if note.severity == "warning" or not warnings_only:
            say(f"{note.severity}: {note.record}{', ' + note.channel if note.channel else ''}: {note.sentence}")


def _fitted(model: str, methods: dict[str, Any], dataset: Dataset) -> Iterable[tuple[str, Any]]:
    """Every method fitted, or with `best` the one that runs best on parts of the estimation records that it was not fitted to."""
    if model == "best":
        from workbench.identify.selection import choose

        choice = choose(methods, dataset, progress=progress)
        result = ", ".join(f"{name} {fit:.1f}" for name, fit in choice.fit.items())
        say(f"chosen: {choice.method}; free-run FIT on two fifths of the estimation records that it was not fitted to: {result}")
        for name, reason in choice.failed.items():
            say(f"warning: no {name} model: {reason}")
        yield choice.method, choice.model
        return
    refused: list[InputError] = []
    for name, method in methods.items():
        progress(f"{name}: identifying")
        try:
            yield name, method.fit(dataset)
        except InputError as reason:
            say(f"warning: no {name} model: {reason.problem}" + (f"; {reason.mend}" if reason.mend else ""))
            refused.append(reason)
    if len(refused) == len(methods):
        raise refused[0]


def compare(options: Namespace) -> int:
    """Score saved models on records that they never saw and test what is left in their residuals."""
    from workbench.intervals.coverage import cover
    from workbench.intervals.model import IntervalModel
    from workbench.residuals import residual_test

    models = _load_models(options.models)
    if len({model.name for model in models}) < len(models):  # two of one name are told apart by their files
        models = [replace(model, name=path) for path, model in zip(options.models, models, strict=True)]
    results: list[Result] = []
    shown: Any = None  # the records with the roles of the first model
    for path, model in zip(options.models, models, strict=True):
        outputs = (model.output,) if isinstance(model, IntervalModel) else model.outputs
        dataset = read(
            *options.records,
            inputs=[c.name for c in model.inputs],
            outputs=[c.name for c in outputs],
            schedule=model.schedule.name if model.schedule else (),
        )
        shown = shown or dataset
        known = (*model.inputs, *outputs, *([model.schedule] if model.schedule else []))
        for experiment in dataset:
            check_units(experiment, {c.name: c.unit for c in known})
        if isinstance(model, IntervalModel):
            envelopes = cover(model, dataset, "held-out")
            results.append(Result(model, path, tuple(c.nominal for c in envelopes), envelopes))
            continue
        results.append(Result(model, path, _scores(model, None, dataset, options.horizon)))
        for experiment in dataset:
            try:
                say(str(residual_test(model, experiment)))
            except InputError as reason:  # too short a record, or an unstable model: its scores say more
                say(f"note: no residual test: {reason}")
    code = _refereed(options, results, None, shown)
    folder = run_folder(options.out, "compare")
    _write(options, folder, results, {"models": options.models}, shown, options.records)
    return code


def _load_models(paths: list[str]) -> list:
    """The models of these files, LPV or interval; a scores file that lies beside them is passed over."""
    from workbench.intervals.model import SCHEMA, load_interval_model
    from workbench.lpv import load_model

    for path in paths:
        if paths.count(path) > 1:
            raise InputError("is named twice", file=path, mend="name each model once")
    paths[:] = [path for path in paths if Path(path).name != "scores.json" or len(paths) == 1]
    content = [read_json(path) for path in paths]
    interval = [isinstance(c, dict) and c.get("schema") == SCHEMA for c in content]
    return [
        load_interval_model(path) if is_interval else load_model(path) for path, is_interval in zip(paths, interval, strict=True)
    ]


def _read(paths: list[str], roles: dict[str, tuple[str, ...]]) -> Dataset:
    """The records with their roles; `--schedule none` leaves out the channel that its name makes a schedule."""
    if roles["schedule"] != ("none",):
        return read(*paths, inputs=roles["inputs"], outputs=roles["outputs"], schedule=roles["schedule"])
    records = read(*paths, inputs=roles["inputs"], outputs=roles["outputs"])
    return Dataset(tuple(e.select([c.name for c in e.channels if c.role != "schedule"]) for e in records))


def _check_roles(dataset: Dataset, wanted: Sequence[str]) -> None:
    first = dataset.experiments[0]
    for found, role, option in (
        (first.names_of("input"), "input", "--inputs"),
        (first.names_of("output"), "output", "--output"),
    ):
        if not found:
            raise InputError(f"no {role} channel among {', '.join(first.names)}", file=first.name, mend=f"give {option}")
    if len(first.names_of("schedule")) > 1:
        several = ", ".join(first.names_of("schedule"))
        raise InputError("several scheduling channels", file=first.name, channel=several, mend="give --schedule one of them")
    if tuple(wanted) == ("ilm",) and not first.names_of("schedule"):
        raise InputError("ilm needs a scheduling channel", file=first.name, mend="give --schedule")


def _described(dataset: Dataset) -> str:
    first = dataset.experiments[0]
    found = {"input": first.names_of("input"), "output": first.names_of("output"), "schedule": first.names_of("schedule")}
    roles = ", ".join(f"{role} {' '.join(channels)}" for role, channels in found.items() if channels)
    sizes = ", ".join(f"{e.name} ({len(e)} samples)" for e in dataset)
    return f"records: {sizes}, sampled every {dataset.dt:g} s; {roles}"


def _scores(model, estimation: Dataset | None, held_out: Dataset | None, steps: int):
    from workbench.metrics import score

    horizons = ("free-run", "one-step", steps)
    scores = ()
    if estimation is not None:
        scores += score(model, estimation, "estimation", horizons)
    if held_out is not None:
        scores += score(model, held_out, "held-out", horizons)
        for e in held_out:
            if model.schedule and (beyond := model.outside(e[model.schedule.name])) > MUCH:
                say(
                    f"warning: {model.name} on {e.name}: {model.schedule.name} leaves the range the model knows, "
                    f"{model.span[0]:g} to {model.span[1]:g} {model.schedule.unit}, by {100 * beyond:.0f} % of it; "
                    "there the model holds its edge value"
                )
    return scores


def _say_scores(results: Sequence[Result]) -> None:
    """Held-out free runs first, the headline; of the estimation records the free run alone, the rest is in the files."""
    say(f"{'model':8} {'order':>5}  {'record':16} {'split':10} {'output':8} {'horizon':9} {'FIT':>7} {'RM':>7} {'RMSE':>10}")
    from workbench.metrics import horizon_name

    rank: dict[Any, int] = {"free-run": 0, "one-step": 1}
    scores = [(result.model, s) for result in results for s in result.scores]
    scores = [(model, s) for model, s in scores if s.split == "held-out" or s.horizon == "free-run"]
    scores.sort(key=lambda pair: (pair[1].split != "held-out", rank.get(pair[1].horizon, 2), pair[1].output))
    for model, s in scores:
        say(
            f"{s.model:8} {model.order:5d}  {s.record:16} {s.split:10} {s.output:8} {horizon_name(s.horizon):9} "
            f"{s.FIT:7.1f} {s.RM:7.1f} {s.RMSE:10.4g} {s.unit}"
        )


def _say_envelopes(results: Sequence[Result]) -> None:
    """Coverage of held-out records first: an envelope is worth what it holds of records it never saw."""
    lines = sorted((c for result in results for c in result.envelopes), key=lambda c: c.split != "held-out")
    for line in lines:
        say(str(line))


def _write(options: Namespace, folder: Path, results: Sequence[Result], configuration, shown: Dataset, files) -> None:
    """Scores as JSON and the comparison as a page, with the records of `shown` in its pictures."""
    from studies.comparison import comparison
    from workbench.report.page import write_report

    source = provenance(configuration, files)
    content = scores_file(results, source)
    write_json(folder / "scores.json", content)
    if options.json:
        write_json(options.json, content)
    title = f"{options.command}: {', '.join(result.model.name for result in results)}"
    page = write_report(comparison(title, results, tuple(shown), source), folder)
    say(f"report: {page}")


# ---- calibrate and diagnose -----------------------------------------------------------------------------------------------


def calibrate(options: Namespace) -> int:
    """Fit physical parameters of a plant to records and save the plant with them."""
    from studies import calibration

    return calibration.run(options, say, progress)


def diagnose(options: Namespace) -> int:
    """Say what the simulation of a plant gets wrong on records, and save the plant extended by what was found."""
    from studies import diagnosis

    return diagnosis.run(options, say, progress)


# ---- effects, doctor and study --------------------------------------------------------------------------------------------


def effects(options: Namespace) -> int:
    """Say what can be missing, and how it acts."""
    from studies.catalogue import run as said

    return said(options, say)


def doctor(options: Namespace) -> int:
    """Versions, threads, compiler cache, and a two-second self-check against a known answer."""
    from studies.doctor import examine

    findings = examine()
    for finding in findings:
        say(f"{'ok  ' if finding.fine else 'FAIL'}  {finding.what}: {finding.found}")
        if not finding.fine:
            say(f"      mend: {finding.mend}")
    if options.json:
        write_json(options.json, {"findings": [vars(finding) for finding in findings]})
    return 0 if all(finding.fine for finding in findings) else 1


def sweep(options: Namespace) -> int:
    """Run a sweep, or finish one."""
    from studies.sweeps import run as run_sweep

    return run_sweep(options, say, progress)


def report(options: Namespace) -> int:
    """The page of one run again, or one page of several."""
    from workbench.report.archive import joined, read_report
    from workbench.report.page import write_report

    folders = [Path(name) for name in options.folders]
    titles = [folder.resolve().name for folder in folders]
    keys = [title if titles.count(title) == 1 else str(folder) for title, folder in zip(titles, folders, strict=True)]
    parts = {key: read_report(folder) for key, folder in zip(keys, folders, strict=True)}
    if len(parts) < len(folders):
        raise InputError("a folder is named twice", mend="name each once")
    first = next(iter(parts.values()))
    if len(parts) == 1:
        page = replace(first, title=options.title or first.title)
    else:
        said = "\n\n".join(f"{key}: {own.verdict.split(chr(10) * 2)[0]}" for key, own in parts.items())
        page = joined(options.title or ", ".join(parts), said, parts)
    if len(parts) > 1 and options.out and Path(options.out).resolve() in {own.resolve() for own in folders}:
        raise InputError(
            "is the folder of one of these runs, whose page it would replace", file=options.out, mend="another --out"
        )
    folder = folders[0] if len(parts) == 1 and not options.out else run_folder(options.out, "report")
    say(f"report: {write_report(page, folder)}")
    if options.json:
        write_json(options.json, {"title": page.title, "verdict": page.verdict, "folders": [str(f) for f in folders]})
    return 0


def study(options: Namespace) -> int:
    """Run a study and say where its report is."""
    from studies import STUDIES

    module = STUDIES[check_known("study", options.study, STUDIES)]()
    own = {name: value for name in ("cases", "jobs", "fresh") if (value := getattr(options, name)) is not None}
    if foreign := [name for name in own if name not in signature(module.main).parameters]:
        takers = [name for name, load in STUDIES.items() if foreign[0] in signature(load().main).parameters]
        raise InputError(f"--{foreign[0]} does not belong to {options.study}", mend=f"leave it out, or study {', '.join(takers)}")
    folder = run_folder(options.out, options.study)
    module.main(
        quick=options.quick,
        folder=folder,
        data=options.data,
        seed=options.seed,
        json=options.json,
        say=say,
        progress=progress,
        **own,
    )
    return 0
