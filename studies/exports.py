"""`workbench export`: a controller for another program, as source text or as tables."""

from argparse import Namespace
from collections.abc import Callable
from typing import Any

from controllers.code import c_code, identifier, st_code
from controllers.export import gain_csv, gain_table, mpc_matrices
from controllers.files import load_controller
from controllers.mpc import MPC
from controllers.receding import Receding
from controllers.scheduled_pid import ScheduledPID
from studies.arguments import is_own, run_folder, trusted_plant
from workbench.errors import InputError, check_known
from workbench.files import write_json, write_text
from workbench.provenance import provenance

Say = Callable[[str], None]
FORMS = ("c", "st", "csv", "json")
OPTIONS = (("float", ("c",)), ("name", ("c", "st")))  # the forms that an option is for


def export(options: Namespace, say: Say) -> int:
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
        contents = _contents(controller, form, options, say)
    except InputError as reason:
        raise InputError(reason.problem, file=options.controller, mend=reason.mend) from None
    folder = run_folder(options.out, "export")
    for name, content in contents.items():
        path = (write_text if isinstance(content, str) else write_json)(folder / name, content)
        say(f"{form} -> {path}")
    configuration = {key: value for key, value in vars(options).items() if key != "json"}
    result = {"files": list(contents), "provenance": provenance(configuration, [options.controller])}
    write_json(folder / "export.json", result)
    if options.json:
        write_json(options.json, result)
    return 0


def _contents(controller: ScheduledPID | Receding, form: str, options: Namespace, say: Say) -> dict[str, Any]:
    """Texts and numbers by file name; of an MPC its matrices as JSON, or the law that it falls back on if that is asked for."""
    if isinstance(controller, ScheduledPID):
        if options.fallback:
            raise InputError("a PID falls back on nothing", mend="leave --fallback out")
        law = controller
    elif options.fallback:
        law = controller.fallback
        say(f"this is {law.name}, the law that {controller.name} falls back on")
    elif isinstance(controller, MPC) and form == "json":
        return {"matrices.json": _with_differences(mpc_matrices(controller), say)}
    else:
        matrices = ", or --to json for its matrices" if isinstance(controller, MPC) else ""
        mend = f"give --fallback for the PID that it falls back on{matrices}"
        raise InputError(f"an {type(controller).__name__} needs a solver, and is no {form} text by itself", mend=mend)
    if form == "csv":
        _with_differences(gain_table(law), say)
        return {"gains.csv": gain_csv(law)}
    if form == "json":
        return {"gains.json": _with_differences(gain_table(law), say)}
    name = identifier(law, options.name)
    if form == "st":
        return {f"{name}.st": st_code(law, name)}
    header, source = c_code(law, name, single=options.float)
    return {f"{name}.h": header, f"{name}.c": source}


def _with_differences(content: dict[str, Any], say: Say) -> dict[str, Any]:
    """The table, and how far a program that interpolates between its rows is from the law is said."""
    found = ", ".join(f"{key} {value:.2g}" for key, value in content["largest_difference"].items())
    say(f"rows: {len(content['rows'])}; linear between them, which differs from the law by at most: {found}")
    return content
