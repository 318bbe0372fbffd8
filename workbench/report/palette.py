"""The colours of the report: one ink, one accent, and the colour-blind safe series of Okabe and Ito, each light and dark.

Pictures are drawn in the light colours and stay ordinary SVG; a page replaces every one by a variable of its style sheet,
so that the same picture is readable on white, on black and on paper.
"""

from workbench.records import record


@record
class Colour:
    """A colour by its name in the style sheet, as drawn on a light page and as shown on a dark one."""

    name: str
    light: str
    dark: str


INK = Colour("ink", "#1b1e23", "#e6e8eb")
MUTED = Colour("muted", "#5b626c", "#a3abb6")
GRID = Colour("grid", "#dde0e5", "#343a43")
MEASURED = Colour("measured", "#b3b9c2", "#6a7380")
PAPER = Colour("paper", "#fefefe", "#16191e")
CARD = Colour("card", "#f4f6f8", "#1f242b")
ACCENT = Colour("accent", "#0b5c8f", "#6cb8ec")

#: Okabe and Ito without black (the ink takes its place) and yellow (too pale). The two blues trade places in the dark.
SERIES = (
    Colour("series-1", "#0072b2", "#56b4ea"),
    Colour("series-2", "#d55e00", "#ef7f2d"),
    Colour("series-3", "#009e73", "#1fbf92"),
    Colour("series-4", "#cc79a7", "#dd95bb"),
    Colour("series-5", "#e69f00", "#e8ac2a"),
    Colour("series-6", "#56b4e9", "#2f8fcc"),
)

COLOURS = (INK, MUTED, GRID, MEASURED, PAPER, CARD, ACCENT, *SERIES)
