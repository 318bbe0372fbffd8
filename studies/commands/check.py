"""`workbench check`: prove or refute limits of a loop."""

from argparse import Namespace

from studies.arguments import choose_controller, choose_plant, numbers, run_folder
from studies.replays import replay_command
from studies.terminal import progress, say
from workbench.answers.check import CHECK_FILE, check
from workbench.errors import InputError
from workbench.files import write_bytes
from workbench.hammerstein import load_either
from workbench.provenance import provenance
from workbench.robustness.limits import load_limits
from workbench.robustness.verdict import Status
from workbench.sources import read

ASKED = ("controller", "limits", "model", "records", "plant", "fitted", "lags", "bound", "nodes", "rate", "runs")


def run(options: Namespace) -> int:
    """Verdicts on the model, on the plant, or on both; 1 where anything failed."""
    limits = load_limits(options.limits)
    if not (options.model or options.plant):
        mend = "give --model M.json --records R.csv for proofs, --plant PLANT for a search on the simulated machine, or both"
        raise InputError("check on what?", mend=mend)
    if bool(options.model) != bool(options.records):
        raise InputError("--model and --records go together", mend="the records say what the model leaves open")
    if options.fitted and not options.plant:
        raise InputError("--fitted is for a search on the plant", mend="give --plant as well")
    chosen = choose_plant(options.plant) if options.plant else None
    controller = choose_controller(options.controller, chosen.base if chosen else "")
    records = read(*options.records) if options.records else None
    for note in records.notes if records else ():
        say(f"note: {note}")
    found = check(
        controller.law, limits, model=load_either(options.model) if options.model else None,
        records=records,
        plant=chosen.plant if chosen else None, fitted=options.fitted, lags=options.lags,
        bound=numbers(options.bound, "--bound"), nodes=options.nodes, rate=options.rate, runs=options.runs, seed=options.seed,
        progress=progress,
    )  # fmt: skip
    if found.records and records:
        for note in (own for own in found.records.own.notes if own not in records.notes):
            say(f"note: {note}")
    files = [*controller.files, options.limits, *options.records, *([options.model] if options.model else []), *options.fitted]
    source = provenance({key: getattr(options, key) for key in ASKED}, [*files, *(chosen.files if chosen else ())], options.seed)
    folder = run_folder(options.out, "check")
    found.save(folder, base=chosen.base if chosen else "", own=controller.own, source=source)
    if options.proof:
        found.write_proof(options.proof)
    if options.json:
        write_bytes(options.json, (folder / CHECK_FILE).read_bytes())
    for line in (found.tried, *found.boxes):
        say(str(line))
    base = chosen.base if chosen else ""
    for verdict in found.verdicts:
        again = f"; again: {replay_command(folder / verdict.witness, base, controller.own)}" if verdict.witness else ""
        say(f"{verdict}{again}")
    say(f"{found.sentences[0].removesuffix('.')}\nreport: {folder / 'report.html'}")
    return 1 if found.status is Status.FAILED else 0
