"""A controller for another program: C99, IEC 61131-3 Structured Text, gains as CSV or JSON, matrices of an MPC as JSON."""

from pathlib import Path
from typing import Any

from controllers.code.c99 import c_code
from controllers.code.names import identifier
from controllers.code.structured_text import st_code
from controllers.mpc import MPC
from controllers.receding import Receding
from controllers.scheduled_pid import ScheduledPID
from controllers.tables import gain_table, mpc_matrices, with_csv
from workbench.errors import InputError, check_known
from workbench.files import write_json, write_text
from workbench.records import record

FORMS = ("c", "st", "csv", "json")


@record
class Export:
    """Files by name, texts or numbers, and what is to be known of them in sentences."""

    contents: dict[str, Any]
    notes: tuple[str, ...] = ()

    def save(self, folder: str | Path) -> list[Path]:
        """Write the files; returns their paths."""
        return [
            (write_text if isinstance(content, str) else write_json)(Path(folder) / name, content)
            for name, content in self.contents.items()
        ]


def export(
    controller: ScheduledPID | Receding, form: str, *, name: str | None = None, single: bool = False, fallback: bool = False
) -> Export:
    """The controller as files of a form: "c", "st", "csv" or "json".

    name: of the functions or the block (default: from the controller's). single: C in single precision. fallback: of an MPC the
    PID that it falls back on. Raises InputError for what a form cannot hold: an MPC needs a solver.

        >>> export(load_controller("pid.json"), "c").save("firmware")                                       # doctest: +SKIP
    """
    form, notes, law = check_known("form", form, FORMS), (), controller
    if isinstance(controller, ScheduledPID):
        if fallback:
            raise InputError("a PID falls back on nothing", mend="leave --fallback out")
    elif fallback:
        law = controller.fallback
        notes = (f"this is {law.name}, the law that {controller.name} falls back on",)
    elif isinstance(controller, MPC) and form == "json":
        return _with_differences("matrices.json", mpc_matrices(controller))
    else:
        matrices = ", or --to json for its matrices" if isinstance(controller, MPC) else ""
        mend = f"give --fallback for the PID that it falls back on{matrices}"
        raise InputError(f"an {type(controller).__name__} needs a solver, and is no {form} text by itself", mend=mend)
    assert isinstance(law, ScheduledPID)
    if form in ("csv", "json"):
        table = _with_differences("gains.json", gain_table(law))
        return Export(table.contents if form == "json" else with_csv(law), (*notes, *table.notes))
    name = identifier(law, name)
    if form == "st":
        return Export({f"{name}.st": st_code(law, name)}, notes)
    header, source = c_code(law, name, single=single)
    return Export({f"{name}.h": header, f"{name}.c": source}, notes)


def _with_differences(file: str, content: dict[str, Any]) -> Export:
    """A table, and how far a program that interpolates between its rows is from the law."""
    found = ", ".join(f"{key} {value:.2g}" for key, value in content["largest_difference"].items())
    said = f"rows: {len(content['rows'])}; linear between them, which differs from the law by at most: {found}"
    return Export({file: content}, (said,))
