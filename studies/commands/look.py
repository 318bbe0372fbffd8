"""`workbench look`: one screen of what records hold and what they cannot show, and a page with every channel."""

from argparse import Namespace

from studies.arguments import names, run_folder
from studies.cli import BAD_INPUT, DONE
from studies.terminal import say
from workbench.answers.look import LOOK_FILE, RecordSet, look, table
from workbench.files import write_bytes
from workbench.provenance import provenance

SHOWN = 12  # sentences on the screen; the page has all


def run(options: Namespace) -> int:
    """Look, say, and write the page; 2 where a file could not be read, though others could."""
    roles = {"inputs": names(options.inputs), "outputs": names(options.outputs), "schedule": names(options.schedule)}
    found = look(*options.records, **roles, dt=options.file_dt)
    for own in found.sets:
        say(own.headline)
        _say_channels(own)
    told = [sentence for sentence in found.sentences if sentence not in {own.headline for own in found.sets}]
    for sentence in told[:SHOWN]:
        say(sentence)
    if len(told) > SHOWN:
        say(f"... and {len(told) - SHOWN} more on the page")
    for own in found.sets:
        say(f"go on: {own.command}")
    if found.refused:
        say(f"{len(found.refused)} of {len(options.records)} files could not be read")
    folder = run_folder(options.out, "look")
    files = [e.file for own in found.sets for e in own.records]
    found.save(folder, source=provenance(roles | {"file_dt": options.file_dt}, list(dict.fromkeys(files))))
    if options.json:
        write_bytes(options.json, (folder / LOOK_FILE).read_bytes())
    say(f"report: {folder / 'report.html'}")
    return BAD_INPUT if found.refused else DONE


def _say_channels(own: RecordSet) -> None:
    """The table of channels in columns as wide as they need."""
    rows = [[_shown(cell) for cell in row] for row in (table(own).header, *table(own).rows)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    for row in rows:
        say("  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def _shown(cell: object) -> str:
    return "" if cell is None else f"{cell:.4g}" if isinstance(cell, float) else str(cell)
