"""`workbench report`: the page of one run again, or one page of several."""

from argparse import Namespace
from dataclasses import replace
from pathlib import Path

from studies.arguments import run_folder
from studies.terminal import say
from workbench.errors import InputError
from workbench.files import write_json


def run(options: Namespace) -> int:
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
