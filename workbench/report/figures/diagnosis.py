"""Pictures of a diagnosis: fitted parameters against the data sheet, what was missing, what looks alike, what is left."""

from collections.abc import Sequence

import numpy as np

import workbench.report.figures.canvas as canvas
from workbench.data import Channel
from workbench.records import RecordError, field, record
from workbench.report.blocks import Column, Data, Picture
from workbench.report.figures.canvas import Trace
from workbench.report.palette import INK, MEASURED, MUTED, SERIES

#: Effects whose signatures are shared by less than this are no rivals.
ALIKE = 0.5


@record
class ParameterEstimate:
    """A parameter's value and 95 % interval beside its nominal value and relative tolerance."""

    name: str
    unit: str
    nominal: float = field("")
    value: float = field("")
    low: float = field("")
    high: float = field("")
    tolerance: float = field("", low=0.0)

    @property
    def relative(self) -> np.ndarray:
        """Value, low and high, in per cent from nominal (3)."""
        size = abs(self.nominal) or 1.0
        return 100.0 * (np.array([self.value, self.low, self.high]) - self.nominal) / size


def parameters(estimates: Sequence[ParameterEstimate]) -> Picture:
    """A dot with its 95 % interval for each parameter, in per cent from nominal, on a bar of the tolerance."""
    if not estimates:
        raise RecordError("parameters: nothing was fitted")
    value, low, high = np.array([e.relative for e in estimates]).T
    tolerance = np.array([100.0 * e.tolerance for e in estimates])
    rows = np.arange(len(estimates))
    with canvas.style():
        figure = canvas.sheet(0.9 + 0.26 * len(estimates))
        axes = figure.subplots()
        open_ = axes.barh(rows, 2 * tolerance, left=-tolerance, height=0.62, color=MEASURED.light, alpha=0.45, gid="tolerance")
        bars = axes.hlines(rows, low, high, color=SERIES[0].light, linewidth=1.6, gid="interval")
        axes.plot(value, rows, "o", color=SERIES[0].light, markersize=4.5, gid="value")
        axes.axvline(0.0, color=INK.light, linewidth=0.6)
        axes.set_yticks(rows, [canvas.short(e.name) for e in estimates])
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.set_xlabel("from nominal [%]")
        canvas.legend(figure, [bars, open_], ["fitted, 95 % interval", "tolerance of the data sheet"])
        svg = canvas.render(figure)
    beyond = [e.name for e, v, t in zip(estimates, value, tolerance, strict=True) if abs(v) > t]
    columns = (
        Column("parameter", [e.name for e in estimates]),
        Column("unit", [e.unit for e in estimates]),
        *(Column(name, [getattr(e, name) for e in estimates]) for name in ("nominal", "value", "low", "high", "tolerance")),
    )
    return Picture(
        "Fitted parameters",
        svg,
        "Fitted parameters with 95 % intervals, in per cent from nominal, on what the data sheet leaves open."
        + (f" Beyond their tolerance: {', '.join(beyond)}." if beyond else " All within their tolerance."),
        Data("fitted parameters", columns),
        f"Dot chart of {len(estimates)} parameters with intervals, in per cent from nominal",
    )


def missing(title: str, over: Channel, what: Trace, x: np.ndarray, deviation: np.ndarray, after: np.ndarray) -> Picture:
    """What was missing over what it depends on: points (n) with two standard deviations, and simulations without (0) and with it.

    what: the channel and the measured means; x, deviation, after (n), in the order of x or not.
    """
    order = np.argsort(x, kind="stable")
    x, y, deviation, after = (canvas.of_length(v, len(what.values), title)[order] for v in (x, what.values, deviation, after))
    with canvas.style():
        figure = canvas.sheet(2.9)
        axes = figure.subplots()
        axes.vlines(x, y - 2 * deviation, y + 2 * deviation, color=MUTED.light, linewidth=1.0, gid="deviation")
        (points,) = axes.plot(x, y, "o", color=MUTED.light, markersize=4, gid="measured")
        before = canvas.line(axes, x, np.zeros(len(x)), SERIES[0], "before", dash=canvas.DASHES[1])
        line = canvas.line(axes, x, after, SERIES[1], "after", width=1.6)
        axes.set_xlabel(canvas.label(over))
        axes.set_ylabel(canvas.label(what.channel))
        canvas.legend(figure, [points, before, line], ["measured", "without the effect", "with the effect"])
        svg = canvas.render(figure)
    columns = (
        Column(over.name, x, over.unit),
        Column(f"{what.channel.name} measured", y, what.channel.unit),
        Column("standard deviation", deviation, what.channel.unit),
        Column("without the effect", np.zeros(len(x)), what.channel.unit),
        Column("with the effect", after, what.channel.unit),
    )
    return Picture(
        title,
        svg,
        f"Over {over.name}: {what.channel.name}. Points: what the records ask for, means with two standard "
        "deviations (partial residuals); lines: the simulation without the effect, and with it.",
        Data(title, columns),
        f"Chart of {what.channel.name} over {over.name}: {len(x)} measured points, simulated without the effect and with it",
    )


def similarity(names: Sequence[str], shares: np.ndarray) -> Picture:
    """Squares whose area is the share (m, m) of the signature in a row that the effect in a column can mimic.

    Only effects that have a rival, one that mimics more than half of them or that they mimic so.
    """
    shares = np.asarray(shares, float)
    if shares.shape != (len(names), len(names)):
        raise RecordError(f"similarity: shape {shares.shape}, expected ({len(names)}, {len(names)})")
    apart = np.where(np.eye(len(names), dtype=bool), 0.0, shares)
    kept = np.flatnonzero((apart.max(axis=0, initial=0.0) > ALIKE) | (apart.max(axis=1, initial=0.0) > ALIKE)).tolist()
    m = len(kept)
    rows, columns = np.meshgrid(np.arange(m), np.arange(m), indexing="ij")
    size = np.clip(shares[np.ix_(kept, kept)], 0.0, 1.0)
    with canvas.style():
        figure = canvas.sheet(1.9 + 0.17 * m)
        axes = figure.subplots()
        points = 3.0 * 72 / max(m, 20)  # side of a full square
        shown = (size > 0.05) & (rows != columns)
        for alike, colour in ((False, MUTED), (True, SERIES[1])):
            at = shown & ((size > ALIKE) == alike)
            axes.scatter(
                columns[at], rows[at], s=size[at] * points**2, marker="s", color=colour.light, linewidth=0, gid=f"alike-{alike}"
            )
        axes.set_xticks(range(m), [canvas.short(names[k], 26) for k in kept], rotation=90)
        axes.set_yticks(range(m), [canvas.short(names[k], 26) for k in kept])
        axes.set_xlim(-0.7, m - 0.3)
        axes.set_ylim(m - 0.3, -0.7)
        axes.tick_params(labelsize=7 if m < 25 else 5)
        svg = canvas.render(figure)
    said = f"{m} of {len(names)} effects have a rival in these records." if m else "No two effects look alike in these records."
    caption = f"{said} The area of a square is the share of the signature in the row that the effect in the column can mimic."
    table = (Column("effect", [names[k] for k in kept]), *(Column(names[k], shares[kept, k]) for k in kept))
    return Picture(
        "What these records cannot tell apart",
        svg,
        caption + " Coloured: more than half.",
        Data("similarity of effects", table),
        f"Matrix of {m} by {m} squares",
    )


def left_over(title: str, variable: Channel, what: Trace, grid: np.ndarray) -> Picture:
    """The curve that is left over something: what.values (n) over grid (n)."""
    curve = canvas.of_length(what.values, len(grid), title)
    with canvas.style():
        figure = canvas.sheet(2.4)
        axes = figure.subplots()
        axes.axhline(0.0, color=INK.light, linewidth=0.6)
        canvas.line(axes, np.asarray(grid, float), curve, SERIES[0], "left", width=1.5)
        axes.set_xlabel(canvas.label(variable))
        axes.set_ylabel(canvas.label(what.channel))
        svg = canvas.render(figure)
    columns = (
        Column(variable.name, np.asarray(grid, float), variable.unit),
        Column(str(what.channel.name), curve, what.channel.unit),
    )
    return Picture(
        title,
        svg,
        f"What no effect of the catalogue explains, in {what.channel.name} over {variable.name}.",
        Data(title, columns),
        f"Line chart of {what.channel.name} over {variable.name}",
    )
