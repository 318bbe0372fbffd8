"""A report as a file that is read again: `report.json` beside the page, with the numbers of pictures in `data/*.csv`.

write_report(report, "runs/1")        # writes it
read_report("runs/1")                 # the same report, from its files
joined("Chain", "..", {"models": read_report("runs/1"), "checks": read_report("runs/2")})
"""

import csv
import io
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from workbench.errors import InputError
from workbench.files import read_json, read_text
from workbench.report.blocks import (
    Badge,
    Block,
    Brief,
    Cell,
    Column,
    Data,
    Picture,
    Provenance,
    Report,
    Section,
    Standing,
    Table,
    Text,
)

SCHEMA = "workbench/report/2"
FORMER = "workbench/report/1"  # without briefs and folded blocks
BEST = {"max": max, "min": min}


def content_of(report: Report, files: Mapping[int, str]) -> dict[str, Any]:
    """A report as plain numbers and texts; files: names of the CSV files of the pictures, by identity."""
    return {
        "schema": SCHEMA,
        "title": report.title,
        "verdict": report.verdict,
        "brief": report.brief and _brief_content(report.brief, files),
        "sections": [
            {
                "title": s.title,
                "blocks": [_content(block, files) for block in s.blocks],
                "more": [_content(block, files) for block in s.more],
            }
            for s in report.sections
        ],
    }


def _brief_content(brief: Brief, files: Mapping[int, str]) -> dict[str, Any]:
    return {
        "asked": brief.asked,
        "todo": brief.todo,
        "badges": [vars(own) | {"standing": own.standing.value} for own in brief.badges],
        "picture": brief.picture and _content(brief.picture, files),
    }


def _content(block: Block, files: Mapping[int, str]) -> dict[str, Any]:
    match block:
        case Picture():
            own = {"title": block.title, "caption": block.caption, "alt": block.alt, "svg": block.figure_svg}
            rows = len(block.data.columns[0].values) if block.data.columns else 0
            return {"picture": own | {"data": block.data.name, "file": files[id(block)], "rows": rows}}
        case Table():
            own = {"title": block.title, "caption": block.caption, "digits": block.digits, "header": list(block.header)}
            own["best"] = block.best.__name__ if block.best else None
            return {"table": own | {"rows": [[_cell(cell) for cell in row] for row in block.rows]}}
        case Text():
            return {"text": block.text}
        case Provenance():
            return {"provenance": {"title": block.title, "content": block.content}}


def _cell(cell: Cell) -> Any:
    """JSON has no number that is none, and none that is infinite."""
    plain = cell.item() if isinstance(cell, np.generic) else cell
    if isinstance(plain, float) and not math.isfinite(plain):
        return None if math.isnan(plain) else {"infinite": math.copysign(1.0, plain)}
    return plain


def read_report(folder: str | Path) -> Report:
    """The report that `write_report` has written into a folder. Raises InputError where a file is missing or is none of ours."""
    path = Path(folder) / "report.json"
    if not path.is_file():
        raise InputError("holds no report.json", file=folder, mend="name the folder of a run")
    content = read_json(path)
    if not isinstance(content, dict) or content.get("schema") not in (SCHEMA, FORMER):
        raise InputError("is no report of this version", file=path, mend="run the command again that wrote it")
    try:
        sections = [
            Section(s["title"], *(tuple(_block(b, path.parent) for b in s.get(own, [])) for own in ("blocks", "more")))
            for s in content["sections"]
        ]
        if not (isinstance(content["title"], str) and isinstance(content["verdict"], str)):
            raise TypeError("title and verdict are texts")
        brief = _brief(content["brief"], path.parent) if content.get("brief") else None
        return Report(content["title"], content["verdict"], tuple(sections), brief)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as reason:
        raise InputError(f"is damaged: {reason!r}", file=path, mend="run the command again that wrote it") from None


def _brief(content: Mapping[str, Any], folder: Path) -> Brief:
    texts = [
        content["asked"],
        content["todo"],
        *(own[name] for own in content["badges"] for name in ("about", "word", "sentence")),
    ]
    if not all(isinstance(text, str) for text in texts):
        raise TypeError("a brief consists of texts")
    badges = tuple(Badge(**own | {"standing": Standing(own["standing"])}) for own in content["badges"])
    picture = _block(content["picture"], folder) if content["picture"] else None
    if not isinstance(picture, Picture | None):
        raise TypeError("the first picture is none")
    return Brief(content["asked"], content["todo"], badges, picture)


def _block(content: Mapping[str, Any], folder: Path) -> Block:
    ((kind, own),) = content.items()
    match kind:
        case "picture":
            data = Data(own["data"], _columns(folder / "data" / Path(own["file"]).name, own["rows"]))
            return Picture(own["title"], own["svg"], own["caption"], data, own["alt"])
        case "table":
            rows = tuple(tuple(_number(cell) for cell in row) for row in own["rows"])
            best = BEST[own["best"]] if own["best"] else None
            return Table(own["title"], tuple(own["header"]), rows, own["caption"], best, own["digits"])
        case "text":
            return Text(own)
        case "provenance":
            return Provenance(own["content"], own["title"])
    raise ValueError(f"no block is called {kind!r}")


def _number(cell: Any) -> Cell:
    return math.copysign(math.inf, cell["infinite"]) if isinstance(cell, dict) else cell


def _columns(path: Path, count: int) -> tuple[Column, ...]:
    """The columns of a CSV file of `count` rows, their cells as they were written."""
    text = read_text(path)
    header, *rows = csv.reader(io.StringIO(text))
    if len(rows) != count or any(len(row) != len(header) for row in rows) or not text.endswith("\n"):
        raise InputError(
            f"is not whole: {count} rows of {len(header)} cells were written", file=path, mend="run the command again"
        )
    names = [re.fullmatch(r"(.*?)(?: \[(.*)\])?", text, re.DOTALL) for text in header]
    return tuple(Column(m[1], [row[i] for row in rows], m[2] or "") for i, m in enumerate(names) if m)


def joined(title: str, verdict: str, parts: Mapping[str, Report]) -> Report:
    """One page of several: every part's verdict and sections under its name, where they come from at the end."""
    sections, sources = [], []
    for name, part in parts.items():
        sections.append(Section(f"{name}: {part.title}", (Text(part.verdict), *part.first)))
        for own in part.sections:
            said, more = (tuple(b for b in blocks if not isinstance(b, Provenance)) for blocks in (own.blocks, own.more))
            from_ = [b for b in (*own.blocks, *own.more) if isinstance(b, Provenance)]
            sources += [Provenance(b.content, f"{name}: {b.title}") for b in from_]
            sections += [Section(f"{name}: {own.title}", said, more)] if said or more else []
    return Report(title, verdict, (*sections, *([Section("Provenance", (), tuple(sources))] if sources else [])))
