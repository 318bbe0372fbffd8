"""`workbench simulate --replay`: a stored counterexample, run again on its plant and compared with what was found."""

from argparse import Namespace
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from controllers.files import controller_of
from plants import PLANTS
from studies.arguments import Chosen, ChosenController, choose_controller, choose_plant, is_own, run_folder, trusted_plant
from workbench.errors import InputError
from workbench.files import nullable, write_json
from workbench.provenance import provenance
from workbench.readers import write_csv
from workbench.robustness.falsify.counterexample import SAME, Counterexample, load_counterexample, same
from workbench.robustness.sequences import Broken, is_sequence, load_sequence

Say = Callable[[str], None]

OTHERS = ("experiment", "inputs_from", "seed", "noise_free", "effect", "parameter", "start", "controller", "setpoint", "duration")


def run(options: Namespace, say: Say) -> int:
    """Replay, write the record and what was found; 0 where that is what the file says, else 1."""
    for name in OTHERS:
        if name == "controller" and is_own(options.controller or ""):
            continue
        if (given := getattr(options, name)) is not None and given is not False and given != []:
            option = f"--{name.replace('_', '-')}"
            raise InputError(f"{option} goes not with --replay", mend="leave it out: the file holds the whole run")
    if Path(options.replay).suffix.lower() in (".csv", ".txt", ".mat"):
        mend = f"to run the inputs of a record: --inputs-from {options.replay}"
        raise InputError("a record, and no stored counterexample", file=options.replay, mend=mend)
    if is_sequence(options.replay):
        return _run_sequence(options, say)
    stored = load_counterexample(options.replay)
    chosen = _plant(options, stored)
    controller = _controller(options, stored.controller, chosen.base)
    try:
        found = stored.replay(chosen.plant, controller.law)
    except InputError as reason:
        raise InputError(reason.problem, file=options.replay, channel=reason.channel, mend=reason.mend) from None
    folder = run_folder(options.out, "simulate")
    done = found.run
    path = folder / f"{done.experiment.name}.csv"
    write_csv(done.experiment, path)
    write_csv(done.states, folder / "states" / path.name)
    say(f"{done.experiment.name}: {len(done.experiment)} samples at {done.experiment.dt:g} s -> {path}")
    say(f"  {stored.sentence}")
    unit = stored.limit.unit_of(stored.bound)
    say(f"  excess: stored {stored.excess:.12g} {unit}, found now {found.excess:.12g} {unit}")
    content = {
        "record": done.experiment.name, "file": str(path), "substeps": done.substeps, "effects": stored.effects,
        "same": found.same, "limit": stored.limit.signal, "bound": stored.bound, "unit": unit, "sample": found.sample,
        "stored": nullable(stored.excess), "found": nullable(found.excess),
    }  # fmt: skip
    configuration = {"plant": options.plant or stored.base, "replay": options.replay, "controller": options.controller}
    source = provenance(configuration, [options.replay, *chosen.files, *controller.files], stored.scenario.seed)
    for target in (folder / "simulate.json", options.json):
        if target:
            write_json(target, {"runs": [content], "provenance": source})
    if not found.same:
        where = f" at sample {found.sample} instead of {stored.sample}" * (found.sample != stored.sample)
        say(f"  not the same{where}: they differ by more than {SAME:g}; was the file, the plant or the program changed?")
        return 1
    say("  the same: the counterexample stands")
    return 0


def replay_command(file: Path, plant: str, law: str) -> str:
    """What a user types to run a stored counterexample again; a plant and a law of one's own are named, which no file may do."""
    kind = file.name.split("-")[0]
    named = f" {plant}" if kind == "counterexample" and plant not in PLANTS else ""
    return f"workbench simulate{named} --replay {file}" + f" --controller {law}" * bool(law and kind != "sequence")


def _run_sequence(options: Namespace, say: Say) -> int:
    """Parameters of an identified loop, run again; 0 where they give what the file says, else 1."""
    if options.plant is not None:
        raise InputError("is of an identified model, which it holds", file=options.replay, mend=f"leave {options.plant} out")
    stored = load_sequence(options.replay)
    law: Any = None
    if isinstance(stored, Broken):
        law = _controller(options, stored.passage.controller, "").law
    elif options.controller is not None:
        raise InputError("holds its loop", file=options.replay, mend=f"leave --controller {options.controller} out")
    found = stored.again(lambda _: law)
    agrees = same(found, stored.value) and stored.breaks
    say(f"{stored.claim}\n  {stored.sentence} {stored.value:.12g}, found now {found:.12g}")
    if options.json:
        source = provenance({"replay": options.replay}, [options.replay], None)
        write_json(options.json, {"same": agrees, "stored": stored.value, "found": found, "provenance": source})
    say("  the same: the counterexample stands" if agrees else "  it does not stand: was the file or the program changed?")
    return 0 if agrees else 1


def _plant(options: Namespace, stored: Counterexample) -> Chosen:
    """The plant of the command line, else a machine of the workbench that the file names: a file never makes a program run."""
    if options.plant is None and stored.base not in PLANTS:
        mend = f"if you trust that plant, name it yourself: workbench simulate {stored.base} --replay {options.replay}"
        raise InputError(f"is of {stored.base}, which is no machine of the workbench", file=options.replay, mend=mend)
    chosen = choose_plant(options.plant or stored.base)
    if chosen.plant.name != stored.plant:
        mend = f"give {stored.base}" + " or leave it out" * (stored.base in PLANTS)
        raise InputError(f"is of plant {stored.plant!r}, not {chosen.plant.name!r}", file=Path(options.replay), mend=mend)
    return chosen


def _controller(options: Namespace, content: Mapping[str, Any], plant: str) -> ChosenController:
    """The controller that the file holds; a law of the user's own is named again: a file never makes a program run."""
    own = content.get("own")
    if own is None and options.controller:
        raise InputError("holds its controller", file=options.replay, mend=f"leave --controller {options.controller} out")
    if own is not None and not options.controller:
        mend = f"if you trust that law, name it yourself: workbench simulate --replay {options.replay} --controller {own}"
        raise InputError(f"is of the law {own}, which is code of one's own", file=options.replay, mend=mend)
    if own is not None:
        return choose_controller(options.controller, plant)
    return ChosenController(controller_of(content, options.replay, lambda base: trusted_plant(base, plant)), ())
