"""`workbench identify`: fit the models asked for, save them, score them on estimation and held-out records."""

from argparse import Namespace
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from studies.arguments import names, run_folder
from studies.commands.models import refereed, scores_of, write
from studies.results import Result
from studies.terminal import progress, say
from workbench.data import Dataset, check_held_out
from workbench.errors import InputError, check_known
from workbench.sources import read

INTERVAL = "interval"  # the model kind beside the methods of `workbench.identification`


def run(options: Namespace) -> int:
    """Fit the models asked for, save them, score them on estimation and held-out records."""
    from studies.envelopes import check_interval_options, described_modes, fit_outputs, interval_configuration, interval_method
    from workbench.decimation import thinned
    from workbench.identification import METHODS
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
        results.append(Result(model, str(folder / f"{method}.json"), scores_of(model, dataset, held_out, options.horizon)))
    for name, model in bounded.items():
        for line in described_modes(model):
            say(line)
        envelopes = cover(model, dataset, "estimation") + (cover(model, held_out, "held-out") if held_out else ())
        results.append(Result(model, str(folder / f"{name}.json"), tuple(c.nominal for c in envelopes), envelopes))
    code = refereed(options, results, dataset, held_out or dataset)
    if not options.validate:
        say("no held-out records: these scores are of the records the models were made from. Add --validate RECORD.")
    configuration = (
        {"model": options.model, "order": options.order, "feedthrough": options.feedthrough, "dt": dataset.dt}
        | roles
        | (interval_configuration(interval) if interval else {})
    )
    write(options, folder, results, configuration, held_out or dataset, [*options.records, *options.validate])
    return code


def _method_options(options: Namespace, method: str) -> dict[str, Any]:
    """What the options ask of a method."""
    own: dict[str, Any] = {} if options.order is None else {"order": options.order}
    if options.feedthrough is not None and method != "ilm":  # which has none
        own["feedthrough"] = options.feedthrough
    return own


def _say_advice(dataset: Dataset, order: int | None = None, *, warnings_only: bool = False) -> None:
    from workbench.advice import advise

    for note in advise(dataset, order=order):
        if note.severity == "warning" or not warnings_only:
            say(f"{note.severity}: {note.record}{', ' + note.channel if note.channel else ''}: {note.sentence}")


def _fitted(model: str, methods: dict[str, Any], dataset: Dataset) -> Iterable[tuple[str, Any]]:
    """Every method fitted, or with `best` the one that runs best on parts of the estimation records that it was not fitted to."""
    if model == "best":
        from workbench.identification.selection import choose

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
