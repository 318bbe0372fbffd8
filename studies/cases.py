"""A study of drawn cases: as many as asked for, kept row by row, with rates against targets on a page.

    main = study(Cases("strangers", 400, 28, ...))

A case is a row of cases.jsonl, whole as soon as it is done; a run that was cut off goes on where it stopped. What draws the cases
stands in tests/, and has its own equations.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from workbench.errors import InputError
from workbench.files import write_json
from workbench.provenance import provenance
from workbench.records import record
from workbench.report.blocks import Report
from workbench.report.page import write_report

Say = Callable[[str], None]
Rows = Sequence[Mapping[str, Any]]
TABLE = "cases.jsonl"
SEEDS = 10**6  # case k of seed N has the seed N SEEDS + k


@record
class Cases:
    """What a study of cases is made of: how many (with `quick`, and at most), what runs and counts them, what is said.

    run(folder, seeds, jobs, progress): all rows of the folder after every seed has one. counted: summaries by machine, all of
    them together as "all".
    """

    name: str
    count: int
    quick: int
    most: int
    mend: str
    run: Callable[[Path, Sequence[int], int, Say], Rows]
    counted: Callable[[Rows], Mapping[str, Any]]
    to_json: Callable[[Any], dict[str, Any]]
    verdict: Callable[[Any], str]
    report: Callable[[Rows, Mapping[str, Any], dict[str, Any]], Report]


def study(of: Cases) -> Callable[..., Path]:
    """The `main` of a study of cases."""

    def main(
        quick: bool = False,
        *,
        folder: Path,
        data: str | None = None,
        seed: int = 1,
        json: str | None = None,
        say: Say = print,
        progress: Say = lambda _: None,
        cases: int | None = None,
        jobs: int = 1,
    ) -> Path:
        """Run `cases` cases of `seed` that `folder` does not hold yet, write the report; returns its path.

        Raises InputError for `data`, for a folder of another version, and outside a checkout of the workbench.
        """
        if data is not None:
            raise InputError("this study makes its own records", mend="leave --data out")
        count = cases or (of.quick if quick else of.count)
        if count > of.most:
            raise InputError(f"{count} cases", mend=of.mend)
        seeds = range(SEEDS * seed, SEEDS * seed + count)
        rows = [row for row in of.run(folder, seeds, jobs, progress) if row["seed"] in seeds]
        found = of.counted(rows)
        source = provenance({"study": of.name, "cases": count, "quick": quick}, [folder / TABLE], seed)
        content = {"summary": {name: of.to_json(s) for name, s in found.items()}, "provenance": source}
        for path in (folder / "summary.json", json):
            if path:
                write_json(path, content)
        path = write_report(of.report(rows, found, source), folder)
        say(f"{of.verdict(found['all'])}\n\nreport: {path}")
        return path

    return main


def from_tests(module: str, what: str) -> ModuleType:
    """A module of tests/, of the checkout that this file belongs to; what: it is in words."""
    root = Path(__file__).resolve().parents[1]
    if not root.joinpath(*module.split(".")).with_suffix(".py").exists():
        raise InputError(f"{what} is not here", mend="run this study from a checkout of the workbench")
    if str(root) not in sys.path:
        sys.path.insert(0, str(root))
    return import_module(module)
