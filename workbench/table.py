"""Work whose rows stand in a file as soon as they are done, so that a run that was cut off goes on where it stopped."""

import hashlib
import json
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from workbench.errors import InputError
from workbench.files import write_text
from workbench.progress import Progress, Steps, silent
from workbench.provenance import versions


def whole_rows(table: Path) -> list[dict[str, Any]]:
    """The rows of a file, one JSON object a line; a last line that was cut off is taken away before another row joins it."""
    if not table.exists():
        return []
    text = table.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        write_text(table, whole)
    rows = []
    for number, line in enumerate(whole.splitlines(), 1):
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError as reason:
            raise InputError(
                f"not a row: {reason.msg}", file=table, line=number, mend="delete this line: it is run again"
            ) from None
    return rows


def made(table: Path, work: Callable[[Any], dict[str, Any]], items: Sequence[Any], jobs: int = 1) -> Iterator[dict[str, Any]]:
    """A row for every item, `jobs` at a time, in the file before it is given; only this process writes."""
    table.parent.mkdir(parents=True, exist_ok=True)
    for row in _rows(work, items, jobs):
        with table.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        yield row


def _rows(work: Callable[[Any], dict[str, Any]], items: Sequence[Any], jobs: int) -> Iterator[dict[str, Any]]:
    if jobs == 1 or len(items) < 2:
        yield from map(work, items)
        return
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        yield from pool.imap_unordered(work, items)


def resumed(
    table: Path,
    work: Callable[[Any], dict[str, Any]],
    items: Sequence[Any],
    *,
    key: str,
    configuration: str,
    of: str = "of another version",
    jobs: int = 1,
    said: Callable[[dict[str, Any]], str] = lambda _: "",
    progress: Progress = silent,
) -> list[dict[str, Any]]:
    """All rows of the table after every item has one; an item whose row is there already (row[key]) is not done again.

    progress: is told of each new row, what `said` makes of it, and the time left. Raises InputError where a row of the table was
    made with another `configuration`; of: what that means.
    """
    rows = whole_rows(table)
    others = {row.get("configuration", "none") for row in rows} - {configuration}
    if others:
        raise InputError(
            f"holds cases {of} ({', '.join(sorted(others))}, now {configuration})",
            file=table,
            mend="give a new --out folder, or the workbench that wrote this one",
        )
    done = {row[key] for row in rows}
    todo = [item for item in items if item not in done]
    steps = Steps(progress, len(items), "cases", before=len(items) - len(todo))
    for row in made(table, work, todo, jobs):
        rows.append(row)
        steps.done(1, said(row))
    return rows


def fingerprint(*parts: Any) -> str:
    """What rows must share to be counted together: a hash of `parts`, and of the versions of all that computes."""
    content = json.dumps([*parts, versions()], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:12]
