"""`workbench export`: write a controller for another program, as source text or as tables."""

from argparse import Namespace

from controllers.export import FORMS, export
from controllers.files import load_controller
from studies.arguments import is_own, run_folder, trusted_plant
from studies.terminal import say
from workbench.errors import InputError, check_known
from workbench.files import write_json
from workbench.provenance import provenance

OPTIONS = (("float", ("c",)), ("name", ("c", "st")))  # the forms that an option is for


def run(options: Namespace) -> int:
    """Write the controller in the form that was asked for, and export.json."""
    form = check_known("form", options.to, FORMS)
    for option, forms in OPTIONS:
        if getattr(options, option) and form not in forms:
            raise InputError(f"--{option} with --to {form}", mend=f"leave it out: it is for --to {' and '.join(forms)}")
    if is_own(options.controller):
        mend = "C and Structured Text are made of what design wrote; write your own law there by hand, or design a scheduled PID"
        raise InputError("is code, not numbers that a text could be made of", file=options.controller, mend=mend)
    controller = load_controller(options.controller, lambda base: trusted_plant(base, ""))
    try:
        made = export(controller, form, name=options.name, single=options.float, fallback=options.fallback)
    except InputError as reason:
        raise InputError(reason.problem, file=options.controller, mend=reason.mend) from None
    for note in made.notes:
        say(note)
    folder = run_folder(options.out, "export")
    for path in made.save(folder):
        say(f"{form} -> {path}")
    configuration = {key: value for key, value in vars(options).items() if key != "json"}
    result = {"files": list(made.contents), "provenance": provenance(configuration, [options.controller])}
    write_json(folder / "export.json", result)
    if options.json:
        write_json(options.json, result)
    return 0
