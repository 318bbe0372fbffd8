"""The report: a page that opens from disk, verdict first, then pictures and tables, each with its numbers as CSV.

report = Report("Web winding machine", "SSM names ...", (Section("Models", (picture, table)),))
write_report(report, "runs/1")      # runs/1/report.html, runs/1/data/*.csv, and runs/1/report.json, which is read again
"""

import csv
import html
import io
import math
import re
import statistics
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeGuard
from urllib.parse import quote

import numpy as np

from workbench.files import write_json, write_text
from workbench.records import record
from workbench.report.archive import content_of
from workbench.report.blocks import Block, Cell, Column, Data, Picture, Provenance, Report, Section, Table, Text
from workbench.report.explorer import SCRIPT as EXPLORER
from workbench.report.explorer import kind_of, packed
from workbench.report.sheet import SCRIPT, STYLE
from workbench.report.svg import embed, printable

SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

#: Makes the promise of one file checkable: a browser refuses whatever is not inside.
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'"

#: Data of more characters than this are not repeated inside the page, which then links to the file beside it.
INLINE = 1_000_000


def write_report(report: Report, folder: str | Path) -> Path:
    """Write `report.html`, one file that needs nothing else, the numbers as `data/*.csv`, and `report.json` for `read_report`;
    returns the page's path.

    Everything is put together before the first file is written, and what a failed attempt has newly written is removed again.
    """
    folder = Path(folder)
    numbers = _numbers(report)
    tables = {folder / "data" / own.file: own.text for own in numbers.values()}
    page = _html(report, numbers)
    archive = folder / "report.json"
    new = [path for path in tables if not path.exists()]
    try:
        for path, text in tables.items():
            write_text(path, text)
        written = write_text(folder / "report.html", page)
        archive.unlink(missing_ok=True)  # that of a former page
        write_json(archive, content_of(report, {block: own.file for block, own in numbers.items()}))
        return written
    except BaseException:
        for path in new:
            path.unlink(missing_ok=True)
        raise


def csv_text(data: Data) -> str:
    """The columns as CSV, names with units in the first row, every number exactly as in memory, NaN as an empty cell."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([printable(str(column)) for column in data.columns])
    writer.writerows(zip(*([_csv_cell(cell) for cell in _cells(column)] for column in data.columns), strict=True))
    return stream.getvalue()


def html_text(report: Report) -> str:
    """The report as one HTML page with style, script, pictures and data inside."""
    return _html(report, _numbers(report))


def _html(report: Report, numbers: Mapping[int, "_Numbers"]) -> str:
    sections = [_section(section, f"s{i}", numbers) for i, section in enumerate(report.sections, 1)]
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
<title>{_escape(report.title)}</title>
<style>{STYLE}</style>
</head>
<body>
<a class="skip" href="#main">To the verdict</a>
{_contents(report)}
<main id="main">
<header><h1>{_escape(report.title)}</h1>
{_head(report, numbers)}</header>
{chr(10).join(sections)}
</main>
<script>{SCRIPT}{EXPLORER}</script>
</body>
</html>
"""


def _head(report: Report, numbers: Mapping[int, "_Numbers"]) -> str:
    """The verdict; with a brief that first, and the verdict folded."""
    brief, verdict = report.brief, _paragraphs(report.verdict)
    if brief is None:
        return f'<div class="verdict">{verdict}</div>'
    badges = "".join(
        f'<li class="{own.standing.value}"><span>{_escape(own.about)}</span><strong>{_escape(own.word)}</strong>'
        f"<p>{_escape(own.sentence)}</p></li>"
        for own in brief.badges
    )
    shown = _block(brief.picture, "first", numbers.get(id(brief.picture))) if brief.picture else ""
    return (
        f'<p class="asked">{_escape(brief.asked)}</p>\n<div class="todo">{_paragraphs(brief.todo)}</div>\n'
        f'{f"""<ul class="badges">{badges}</ul>""" if badges else ""}\n{shown}\n{_folded("The answer in full", verdict)}'
    )


def _section(section: Section, anchor: str, numbers: Mapping[int, "_Numbers"]) -> str:
    blocks = [
        _block(block, f"{anchor}-{j}", numbers.get(id(block))) for j, block in enumerate((*section.blocks, *section.more), 1)
    ]
    shown, more = ("\n".join(own) for own in (blocks[: len(section.blocks)], blocks[len(section.blocks) :]))
    folded = _folded(f"More: {_counted(section.more)}", more) if section.more else ""
    own = "" if section.blocks else ' class="folded"'
    return f'<section aria-labelledby="{anchor}"{own}><h2 id="{anchor}">{_escape(section.title)}</h2>\n{shown}{folded}</section>'


def _folded(summary: str, content: str) -> str:
    return f"<details><summary>{_escape(summary)}</summary>\n{content}</details>"


def _counted(blocks: Sequence[Block]) -> str:
    """What is folded, in words."""
    kinds = {"picture": Picture, "table": Table | Provenance, "text": Text}
    count = {name: sum(isinstance(block, kind) for block in blocks) for name, kind in kinds.items()}
    return ", ".join(f"{n} {name}{'s' * (n > 1)}" for name, n in count.items() if n)


@record
class _Numbers:
    """The numbers of a block as CSV, and the name of their file."""

    file: str
    text: str


def _numbers(report: Report) -> dict[int, _Numbers]:
    """Of every block that has some, by the block's identity."""
    every = enumerate((block for block in report.blocks if isinstance(block, Picture | Table)), 1)
    return {id(block): _Numbers(f"{i:02d}-{_slug(block.data.name)}.csv", csv_text(block.data)) for i, block in every}


def _slug(text: str) -> str:
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode().lower()
    return re.sub("[^a-z0-9]+", "-", plain).strip("-")[:60].strip("-") or "data"


def _contents(report: Report) -> str:
    if not report.sections:
        return ""
    items = []
    for i, section in enumerate(report.sections, 1):
        titles = [(f"s{i}-{j}", block.title) for j, block in enumerate(section.blocks, 1) if not isinstance(block, Text)]
        inner = "".join(f'<li><a href="#{anchor}">{_escape(title)}</a></li>' for anchor, title in titles)
        items.append(f'<li><a href="#s{i}">{_escape(section.title)}</a>{f"<ol>{inner}</ol>" if inner else ""}</li>')
    return f'<nav aria-label="Contents"><p>Contents</p><ol>{"".join(items)}</ol></nav>'


def _block(block: Block, anchor: str, numbers: "_Numbers | None") -> str:
    match block:
        case Picture():
            assert numbers is not None
            return _picture(block, anchor, numbers)
        case Table():
            assert numbers is not None
            return _table(block, anchor, numbers)
        case Provenance():
            return _provenance(block, anchor)
        case Text():
            return _paragraphs(block.text)


def _picture(picture: Picture, anchor: str, numbers: "_Numbers") -> str:
    drawing = embed(picture.figure_svg, anchor, picture.alt or picture.title, f"{anchor}-caption")
    kind, text = kind_of(picture.data), numbers.text
    columns = _escape(text[: text.index("\n")])
    view = f' data-view="{kind}" data-columns="{columns}"' if kind else ""
    long = packed(picture.data) if kind and len(text) > INLINE else ""
    return (
        f'<figure id="{anchor}"{view}><h3>{_escape(picture.title)}</h3>\n'
        f'<div class="picture">{drawing}</div>\n'
        f'<figcaption><span id="{anchor}-caption">{_escape(picture.caption)}</span>&ensp;'
        f"{_download(picture.data, numbers)}</figcaption>{long}</figure>"
    )


def _table(table: Table, anchor: str, numbers: "_Numbers") -> str:
    shown = _shown(table)
    numeric = [any(_is_number(row[i]) for row in table.rows) for i in range(len(table.header))]
    mark = [' class="n"' if n else "" for n in numeric]
    head = "".join(f'<th scope="col"{m}>{_escape(h)}</th>' for h, m in zip(table.header, mark, strict=True))
    body = "\n".join(_row(row, texts, mark, _best(table, row)) for row, texts in zip(table.rows, shown, strict=True))
    return (
        f'<div class="table" id="{anchor}"><h3 id="{anchor}-title">{_escape(table.title)}</h3>\n'
        f'<div class="scroll" role="region" tabindex="0" aria-labelledby="{anchor}-title"><table>'
        f"<thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>\n"
        f'<p class="caption">{_escape(table.caption)}{"&ensp;" * bool(table.caption)}'
        f"{_download(table.data, numbers)}</p></div>"
    )


def _row(row: tuple[Cell, ...], texts: list[str], mark: list[str], best: float | None) -> str:
    first, *rest = (_escape(text) for text in texts)
    rest = [
        f"<td{m}><strong>{text}</strong></td>" if best is not None and cell == best else f"<td{m}>{text}</td>"
        for cell, text, m in zip(row[1:], rest, mark[1:], strict=True)
    ]
    return f'<tr><th scope="row"{mark[0]}>{first}</th>{"".join(rest)}</tr>'


def _best(table: Table, row: tuple[Cell, ...]) -> float | None:
    numbers = [cell for cell in row[1:] if _is_number(cell)]
    return table.best(numbers) if table.best and len(numbers) > 1 else None


def _shown(table: Table) -> list[list[str]]:
    """The cells as texts: the numbers of a column have the same decimals, chosen by the median, unless one would vanish."""
    columns = [[row[i] for row in table.rows] for i in range(len(table.header))]
    texts = [_column_texts(column, table.digits) for column in columns]
    return [[column[k] for column in texts] for k in range(len(table.rows))]


def _column_texts(column: list[Cell], digits: int) -> list[str]:
    sizes = [abs(cell) for cell in column if _is_number(cell) and cell]
    if not sizes or all(isinstance(cell, int | np.integer) for cell in column if _is_number(cell)):
        return [_text(cell, "d") for cell in column]
    # the median sets the decimals: one number that ran away must not round off the others
    top = math.floor(math.log10(statistics.median_low(sizes)))
    decimals = max(0, digits - 1 - top)
    same = decimals <= 5 and max(sizes) < 1e7 and min(sizes) >= 10.0 ** (1 - decimals)
    return [_text(cell, f".{decimals}f" if same else f"#.{digits}g") for cell in column]


def _text(cell: Cell, form: str) -> str:
    if cell is None or (isinstance(cell, float | np.floating) and math.isnan(cell)):
        return "\N{EM DASH}"
    if isinstance(cell, str | bool | np.bool):
        return str(cell)
    if math.isinf(cell):
        return "\N{MINUS SIGN}\N{INFINITY}" if cell < 0 else "\N{INFINITY}"
    if not cell and form.startswith("#"):
        return "0"
    number, _, exponent = format(int(cell) if form == "d" else cell, form).removesuffix(".").partition("e")
    power = f" \N{MULTIPLICATION SIGN} 10{str(int(exponent)).translate(SUPERSCRIPT)}" if exponent else ""
    return number.replace("-", "\N{MINUS SIGN}") + power


def _is_number(cell: object) -> TypeGuard[float]:
    if isinstance(cell, bool | np.bool):
        return False
    return isinstance(cell, int | float | np.integer | np.floating) and math.isfinite(cell)


def _provenance(block: Provenance, anchor: str) -> str:
    rows = "\n".join(
        f'<tr><th scope="row">{_escape(key)}</th><td>{_escape(value)}</td></tr>' for key, value in _flat(block.content)
    )
    return (
        f'<div class="table provenance" id="{anchor}"><h3 id="{anchor}-title">{_escape(block.title)}</h3>\n'
        f'<div class="scroll" role="region" tabindex="0" aria-labelledby="{anchor}-title">'
        f'<table><thead><tr><th scope="col">item</th><th scope="col">value</th></tr></thead>\n'
        f"<tbody>{rows}</tbody></table></div></div>"
    )


def _flat(content: Mapping[str, object], path: str = "") -> Iterator[tuple[str, str]]:
    for key, value in content.items():
        name = f"{path} \N{SINGLE RIGHT-POINTING ANGLE QUOTATION MARK} {key}" if path else str(key)
        if isinstance(value, Mapping):
            yield from _flat(value, name)
        elif isinstance(value, list | tuple):
            yield name, ", ".join(str(item) for item in value)
        else:
            yield name, str(value)


def _download(data: Data, numbers: "_Numbers") -> str:
    text, file = numbers.text, numbers.file
    what = f"{len(data.columns)} columns \N{MULTIPLICATION SIGN} {len(data.columns[0].values) if data.columns else 0} rows"
    if len(text) > INLINE:
        link = f'<a href="data/{file}" download="{file}" title="{what}">CSV, beside this page</a>'
        return f'<span class="tools">{link}</span>'
    uri = "data:text/csv;charset=utf-8," + quote(text, safe=",")
    return f'<span class="tools"><a href="{uri}" download="{file}" title="{what}">CSV</a></span>'


def _paragraphs(text: str) -> str:
    return "\n".join(f"<p>{_escape(part.strip())}</p>" for part in re.split(r"\n\s*\n", text) if part.strip())


def _cells(column: Column) -> Sequence[Cell]:
    return column.values.tolist() if isinstance(column.values, np.ndarray) else column.values


def _csv_cell(cell: Cell) -> str:
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return ""
    return printable(cell) if isinstance(cell, str) else repr(cell.item() if isinstance(cell, np.generic) else cell)


def _escape(text: str) -> str:
    return html.escape(printable(str(text)), quote=True)
