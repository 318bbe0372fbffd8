"""What all pictures are drawn with: style, panels, lines that keep their extremes, labels, and the way to SVG.

A matter of `workbench.report.figures` alone, which hands on what others need.
"""

import io
import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from workbench.data import GAP, Channel
from workbench.records import RecordError, field, record
from workbench.report.decimate import extremes
from workbench.report.page import SUPERSCRIPT
from workbench.report.palette import GRID, INK, MUTED, SERIES, Colour
from workbench.report.svg import printable

#: Width of a picture in inches of 72 points; the page scales it.
WIDTH = 7.2
#: Pixel columns a trace is drawn for.
PIXELS = 600
#: Places along an axis that dots are drawn for.
PLACES = 150
#: A simulation may leave the range of the measurement by this many of its spans before the picture cuts it off.
BEYOND = 0.75

_STYLE: dict[Any, Any] = {
    "font.size": 8.5,
    "axes.titlesize": 8.5,
    "axes.titlelocation": "left",
    "axes.labelsize": 8.5,
    "axes.labelcolor": MUTED.light,
    "axes.edgecolor": MUTED.light,
    "axes.facecolor": "none",
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.xmargin": 0.01,
    "figure.facecolor": "none",
    "grid.color": GRID.light,
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.borderpad": 0.0,
    "legend.handlelength": 1.6,
    "lines.linewidth": 1.1,
    "path.simplify": False,  # traces are decimated before they are drawn, extremes kept
    "savefig.transparent": True,
    "svg.fonttype": "none",
    "svg.hashsalt": "workbench",
    "text.color": INK.light,
    "text.parse_math": False,  # a record may be called x^$
    "xtick.color": MUTED.light,
    "ytick.color": MUTED.light,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.size": 0,
    "ytick.minor.size": 0,
}

DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)))


@record
class Trace:
    """A channel and its samples."""

    channel: Channel
    values: np.ndarray = field("N")


@contextmanager
def style() -> Iterator[None]:
    """Matplotlib as this module wants it, whatever the user's own settings are, and those again afterwards."""
    with matplotlib.rc_context(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from")  # the page's fonts draw the text, not these
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        yield


def sheet(height: float) -> Figure:
    """An empty figure as wide as all others and `height` inches high."""
    return Figure((WIDTH, height), layout="constrained")


def panels(count: int, xlabel: str, *, sharey: bool) -> tuple[Figure, list[Axes]]:
    """A figure of `count` small panels, three in a row, over one common horizontal axis."""
    if not count:
        raise RecordError("a picture of nothing: give at least one panel")
    across = min(3, count)
    down = math.ceil(count / across)
    figure = sheet(0.7 + 1.4 * down)
    every = list(figure.subplots(down, across, sharex=True, sharey=sharey, squeeze=False).flat)
    for axes in every[count:]:
        axes.set_axis_off()
    for axes in every[count - across : count]:
        axes.tick_params(labelbottom=True)
    figure.supxlabel(xlabel, color=MUTED.light, fontsize=8.5)
    return figure, every[:count]


class Svg(str):
    """SVG text, and the figure that it was rendered from."""

    figure: Figure


def render(figure: Figure) -> Svg:
    stream = io.StringIO()
    FigureCanvasSVG(figure).print_svg(stream, metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    svg = Svg(stream.getvalue())
    svg.figure = figure
    return svg


def line(
    axes: Axes,
    x: np.ndarray,
    y: np.ndarray,
    colour: Colour,
    gid: str,
    *,
    dash: str | tuple = "-",
    width: float = 1.2,
    marker: str = "",
) -> Line2D:
    x, y = np.asarray(x, float), np.asarray(y, float)
    keep = extremes(x, y, PIXELS)
    (drawn,) = axes.plot(
        x[keep], y[keep], marker=marker, linestyle=dash, color=colour.light, linewidth=width, markersize=4, gid=gid
    )
    return drawn


def trace(
    axes: Axes, t: np.ndarray, y: np.ndarray, colour: Colour, gid: str, *, dash: str | tuple = "-", width: float = 0.9
) -> Line2D:
    """A line over time, which breaks where samples are missing."""
    return line(axes, *broken(t, y), colour, gid, dash=dash, width=width)


def band(
    axes: Axes, x: np.ndarray, low: np.ndarray, high: np.ndarray, colour: Colour, gid: str, *, outline: float = 0.8
) -> PolyCollection:
    """The area between low and high with a line on either side: as a mere tint, a band thinner than a pixel is lost."""
    keep = np.union1d(extremes(x, low, PIXELS), extremes(x, high, PIXELS))
    x, low, high = x[keep], low[keep], high[keep]
    for side, values in (("low", low), ("high", high)):
        axes.plot(x, values, color=colour.light, linewidth=outline, gid=f"{gid}-{side}")
    return axes.fill_between(x, low, high, color=colour.light, alpha=0.22, linewidth=0, gid=gid)


def band_along(
    axes: Axes, t: np.ndarray, low: np.ndarray, high: np.ndarray, colour: Colour, gid: str, *, outline: float = 0.8
) -> PolyCollection:
    """A band over time, which breaks where samples or one of their bounds are missing."""
    whole = np.where(np.isfinite(low) & np.isfinite(high), 0.0, np.nan)
    (x, below), (_, above) = broken(t, low + whole), broken(t, high + whole)
    return band(axes, x, below, above, colour, gid, outline=outline)


def dots(axes: Axes, x: np.ndarray, y: np.ndarray, colour: Colour, gid: str, *, size: float = 3.0) -> Line2D:
    """Dots that may be many: of those in one place along x the lowest and the highest stay."""
    order = np.argsort(x, kind="stable")
    x, y = np.asarray(x, float)[order], np.asarray(y, float)[order]
    keep = extremes(x, y, PLACES)
    (drawn,) = axes.plot(x[keep], y[keep], "o", color=colour.light, markersize=size, markeredgewidth=0, gid=gid, clip_on=False)
    return drawn


def broken(t: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The samples with a NaN in every gap of t and in place of numbers that are not finite: no line joins across either."""
    y = np.where(np.isfinite(y), y, np.nan)
    if len(t) < 3:
        return t, y
    step = np.diff(t)
    gaps = np.flatnonzero(step > GAP * np.median(step)) + 1
    return np.insert(t, gaps, t[gaps]), np.insert(y, gaps, np.nan)


def near(values: np.ndarray, own: np.ndarray) -> np.ndarray:
    """A simulation that ran away, held well outside the picture: coordinates of 1e300 are no use to a browser."""
    far = 50 * ((own.max() - own.min()) or 1.0)
    return np.clip(np.where(np.isfinite(values), values, np.nan), own.min() - far, own.max() + far)


def limit(axes: Axes, own: np.ndarray, others: list[np.ndarray]) -> set[int]:
    """Set the range of y to that of `own` and as much of `others` as is not far beyond; returns which are cut off."""
    low, high = float(own.min()), float(own.max())
    span = (high - low) or 1.0
    floor, ceiling = low - BEYOND * span, high + BEYOND * span
    finite = np.concatenate([own, *others])
    finite = finite[np.isfinite(finite)]
    bottom, top = max(finite.min(), floor), min(finite.max(), ceiling)
    axes.set_ylim(bottom - 0.04 * (top - bottom or 1.0), top + 0.04 * (top - bottom or 1.0))
    return {i for i, y in enumerate(others) if not np.all(np.isnan(y) | ((y >= floor) & (y <= ceiling)))}


def mark(axes: Axes, x: float, text: str) -> None:
    """A vertical line for the chosen value, its name beside it at the top."""
    axes.axvline(x, color=MUTED.light, linewidth=0.9, linestyle=(0, (4, 2)), gid="chosen")
    at = axes.get_xaxis_transform()
    axes.annotate(text, (x, 1), xytext=(4, -1), xycoords=at, textcoords="offset points", va="top")


def log_ticks(axes: Axes, axis: str = "y") -> None:
    """Powers of ten as plain text: fonts differ, mathematics would bring its own."""
    which = axes.yaxis if axis == "y" else axes.xaxis
    which.set_major_locator(LogLocator(numticks=6))
    which.set_major_formatter(FuncFormatter(lambda value, _: _power(value)))
    which.set_minor_formatter(NullFormatter())


def _power(value: float) -> str:
    exponent = round(math.log10(value)) if value > 0 else 0
    if -2 <= exponent <= 3:
        return f"{10.0**exponent:g}"
    return "10" + str(exponent).translate(SUPERSCRIPT)


def legend(figure: Figure, handles: Sequence, names: list[str]) -> None:
    """One row of names above the panels, more when they are long."""
    widest = max(len(short(name)) for name in names)
    columns = max(1, min(len(names), 110 // (widest + 8)))  # the handle and its gaps are as wide as eight letters
    legend = figure.legend(handles, [f"name {i}" for i in range(len(names))], loc="outside upper left", ncols=columns)
    # set afterwards: matplotlib leaves names out that start with an underscore
    for text, name in zip(legend.get_texts(), names, strict=True):
        text.set_text(short(name))


def short(text: str, length: int = 32) -> str:
    text = printable(text)
    return text if len(text) <= length else text[: length - 1] + "\N{HORIZONTAL ELLIPSIS}"


def label(channel: Channel) -> str:
    return short(str(channel))


def colour(i: int) -> Colour:
    return SERIES[i % len(SERIES)]


def dash(i: int) -> str | tuple:
    """Lines differ by colour first; beyond the palette also by their dashes."""
    return DASHES[i // len(SERIES) % len(DASHES)]


def of_length(values: np.ndarray, N: int, name: str) -> np.ndarray:
    array = np.asarray(values, float)
    if array.shape != (N,):
        raise RecordError(f"{name}: shape {array.shape}, expected ({N},)")
    return array
