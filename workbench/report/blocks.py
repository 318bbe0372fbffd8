"""What a report consists of: pictures and tables with their numbers, texts and where they come from, in sections.

Report("Web winding machine", "SSM names ...", (Section("Models", (picture, table)),))
"""

import html
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from enum import Enum
from typing import Any

import numpy as np

from workbench.records import RecordError, record

Cell = str | float | int | None


@record
class Column:
    """A named column with its unit: numbers or texts."""

    name: str
    values: Sequence[Cell] | np.ndarray
    unit: str = ""

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@record
class Data:
    """The numbers behind a picture: named columns of one length."""

    name: str
    columns: tuple[Column, ...]

    def __post_init__(self):
        lengths = {str(column): len(column.values) for column in self.columns}
        if len(set(lengths.values())) > 1:
            raise RecordError(f"Data {self.name!r}: columns of different lengths {lengths}")


@record
class Picture:
    """A picture (SVG) under its title, with a caption, the numbers behind it, and what it shows in words."""

    title: str
    figure_svg: str
    caption: str
    data: Data
    alt: str = ""

    @property
    def figure(self) -> Any:
        """The matplotlib figure behind it, to be changed or saved in another format; None where it was read from a file."""
        return getattr(self.figure_svg, "figure", None)

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return f"<figure>{self.figure_svg}<figcaption>{html.escape(self.caption)}</figcaption></figure>"


@record
class Table:
    """Rows of numbers and texts; the first column names the row. Units belong into the header.

    best: `max` or `min` sets the best number of every row in bold. digits: of the median number of a column.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    caption: str = ""
    best: Callable[[Iterable[float]], float] | None = None
    digits: int = 4

    def __post_init__(self):
        for row in self.rows:
            if len(row) != len(self.header):
                raise RecordError(f"Table {self.title!r}: {len(row)} cells in {row}, {len(self.header)} in the header")

    @property
    def data(self) -> Data:
        """The numbers of the table, unrounded."""
        return Data(self.title, tuple(Column(h, [row[i] for row in self.rows]) for i, h in enumerate(self.header)))


@record
class Text:
    """Plain text; an empty line starts a new paragraph."""

    text: str


@record
class Provenance:
    """Where the numbers come from: data hash, configuration, versions, seed. Nested mappings are indented."""

    content: Mapping[str, object]
    title: str = "Provenance"


Block = Picture | Table | Text | Provenance


@record
class Section:
    """A part of a report under its own heading; more: what is folded until a reader opens it, and printed only if open."""

    title: str
    blocks: tuple[Block, ...]
    more: tuple[Block, ...] = ()


class Standing(Enum):
    """How a thing stands that a reader decides by."""

    GOOD = "good"
    OPEN = "open"
    BAD = "bad"


@record
class Badge:
    """One thing that a reader decides by: what it is about, how it stands, in a word or a number, and in one plain sentence."""

    about: str
    word: str
    sentence: str
    standing: Standing


@record
class Brief:
    """What a reader must know on the first screen: the question, what to do, the badges, and the one picture that shows most."""

    asked: str
    todo: str
    badges: tuple[Badge, ...] = ()
    picture: Picture | None = None


@record
class Report:
    """A title, the verdict in a paragraph or a few, an empty line between them, and what it rests on.

    With a brief the page begins with that, and the verdict in full is one click away.
    """

    title: str
    verdict: str
    sections: tuple[Section, ...] = ()
    brief: Brief | None = None

    @property
    def first(self) -> tuple[Picture, ...]:
        """The picture of the brief, where there is one."""
        return (self.brief.picture,) if self.brief and self.brief.picture else ()

    @property
    def blocks(self) -> Iterator[Block]:
        """All of them, in the order of the page."""
        yield from self.first
        for section in self.sections:
            yield from (*section.blocks, *section.more)
