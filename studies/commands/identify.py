"""`workbench identify`: fit the models asked for, save them, score them on estimation and held-out records."""

from argparse import Namespace
from typing import Any

from studies.arguments import names, run_folder
from studies.commands.interval_options import check_interval_options, interval_method
from studies.commands.models import say_models
from studies.commands.records import joined
from studies.terminal import progress, say
from workbench.advice import advise
from workbench.answers.identify import SCORES_FILE, identify, prepared
from workbench.data import Dataset
from workbench.decimation import thinned
from workbench.errors import check_known
from workbench.files import write_bytes
from workbench.identification import CURVED, METHODS
from workbench.provenance import provenance
from workbench.sources import read_files

INTERVAL = "interval"  # the model kind beside the methods of `workbench.identification`


def run(options: Namespace) -> int:
    """Identify, say what is to be known of the records and the models, and write models, scores and the page."""
    known = METHODS | CURVED
    wanted = tuple(METHODS) if options.model in ("all", "best") else names(options.model)
    for method in wanted:
        check_known("model", method, (*known, INTERVAL, "all", "best"))
    interval = interval_method(options) if INTERVAL in wanted else check_interval_options(options)
    methods = {name: known[name](**_method_options(options, name)) for name in wanted if name != INTERVAL}
    roles = {"inputs": names(options.inputs), "outputs": names(options.outputs), "schedule": names(options.schedule)}
    own, held_out = (_read(paths, roles, options) for paths in (options.records, options.holdout))
    given = prepared(joined(own), joined(held_out) if held_out else None, options.dt)
    for note in given.notes:
        say(f"note: {note}")
    say(_described(given.own))
    _say_advice(given.own, options.order)
    if given.held_out:
        _say_advice(given.held_out, options.order, warnings_only=True)
    found = identify(
        given.own, given.held_out, methods=methods, best=options.model == "best", interval=interval, dt=given.own.dt,
        horizon=options.horizon, criterion=options.criterion, accept=options.accept, progress=progress,
    )  # fmt: skip
    for remark in found.remarks:
        say(remark)
    code = say_models(found.results, options.accept)
    if not options.holdout:
        say("no held-out records: these scores are of the records the models were made from. Add --holdout RECORD.")
    asked = {
        "model": options.model,
        "order": options.order,
        "feedthrough": options.feedthrough,
        "criterion": options.criterion,
        "dt": given.own.dt,
    } | roles
    asked |= {"interval": str(interval)} if interval else {}
    folder = run_folder(options.out, "identify")
    found.save(folder, source=provenance(asked, [*options.records, *options.holdout]))
    if options.json:
        write_bytes(options.json, (folder / SCORES_FILE).read_bytes())
    say(f"report: {folder / 'report.html'}")
    return code


def _method_options(options: Namespace, method: str) -> dict[str, Any]:
    """What the options ask of a method."""
    own: dict[str, Any] = {} if options.order is None else {"order": options.order}
    if method == "oe" and own.get("order", 0) > 2:  # a floor stays one
        del own["order"]
    if options.feedthrough is not None and method in ("lti", "ssm", "lpv-oe", *CURVED):
        own["feedthrough"] = options.feedthrough
    return own


def _say_advice(dataset: Dataset, order: int | None = None, *, warnings_only: bool = False) -> None:
    for note in advise(dataset, order=order):
        if note.severity == "warning" or not warnings_only:
            say(f"{note.severity}: {note.record}{', ' + note.channel if note.channel else ''}: {note.sentence}")


def _read(paths: list[str], roles: dict[str, tuple[str, ...]], options: Namespace) -> list[Dataset]:
    """The records with their roles; `--schedule none` leaves out the channel that its name makes a schedule.

    Records of different sample times are each brought to --dt, where it is given.
    """
    unscheduled = roles["schedule"] == ("none",)
    each = read_files(paths, options.file_dt, **roles | ({"schedule": ()} if unscheduled else {}))
    if options.dt and len({round(own.dt / options.dt, 6) for own in each}) > 1:
        brought = [thinned(own, options.dt) for own in each]
        for own, (_, said) in zip(each, brought, strict=True):
            if said:
                say(f"note: {own.names[0]}: {said}")
        each = [done for done, _ in brought]
    if not unscheduled:
        return each
    return [Dataset(tuple(e.select([c.name for c in e.channels if c.role != "schedule"]) for e in own)) for own in each]


def _described(dataset: Dataset) -> str:
    first = dataset.experiments[0]
    found = {"input": first.names_of("input"), "output": first.names_of("output"), "schedule": first.names_of("schedule")}
    roles = ", ".join(f"{role} {' '.join(channels)}" for role, channels in found.items() if channels)
    sizes = ", ".join(f"{e.name} ({len(e)} samples)" for e in dataset)
    idle = [name for name in first.names if name not in sum(found.values(), ()) and not first.channel(name).has_role("reference")]
    unused = f"; not used: {', '.join(idle)} (name it with --output, --inputs or --schedule)" if idle else ""
    return f"records: {sizes}, sampled every {dataset.dt:g} s; {roles}{unused}"
