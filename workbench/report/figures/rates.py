"""Pictures of rates: shares of trials with intervals, over a size or what was stated, and what was taken for what."""

from collections.abc import Mapping, Sequence

import numpy as np

import workbench.report.figures.canvas as canvas
from workbench.records import RecordError, field, record
from workbench.report.blocks import Column, Data, Picture
from workbench.report.palette import MUTED, SERIES


@record
class Rates:
    """Shares (n) with the ends of their intervals, each of `trials`, at the places x."""

    x: np.ndarray = field("n")
    rate: np.ndarray = field("n", low=0.0, high=1.0)
    low: np.ndarray = field("n", low=0.0, high=1.0)
    high: np.ndarray = field("n", low=0.0, high=1.0)
    trials: np.ndarray = field("n", low=1.0)


def rates(title: str, over: str, curves: Mapping[str, Rates], caption: str, *, stated: bool = False) -> Picture:
    """Dots with intervals, a curve for each name. stated: x is what the rate ought to be, drawn as a line; else x is a size.

    Sizes have a logarithmic axis. Raises RecordError where there is nothing to draw.
    """
    if not any(len(curve.x) for curve in curves.values()):
        raise RecordError(f"{title}: no trials")
    with canvas.style():
        figure = canvas.sheet(2.9)
        axes = figure.subplots()
        handles = []
        for i, curve in enumerate(curves.values()):
            x = curve.x + 0.008 * i if stated else curve.x * 1.03**i  # intervals of two curves must not cover each other
            colour = canvas.colour(i).light
            axes.vlines(x, curve.low, curve.high, color=colour, linewidth=1.4, gid=f"interval-{i}")
            handles += axes.plot(x, curve.rate, "o-" if not stated else "o", color=colour, markersize=5, gid=f"rate-{i}")
        if stated:
            axes.plot([0.0, 1.0], [0.0, 1.0], color=MUTED.light, linewidth=0.8, gid="stated")
        else:
            axes.set_xscale("log")
            marks = np.unique(np.concatenate([curve.x for curve in curves.values()]))
            axes.set_xticks(marks, [f"{mark:.2g}" for mark in marks])
            axes.set_xticks([], minor=True)
        axes.set_ylim(-0.03, 1.03)
        axes.set_xlabel(over)
        axes.set_ylabel("share of the cases")
        if len(curves) > 1:
            canvas.legend(figure, handles, list(curves))
        svg = canvas.render(figure)
    columns = (
        Column("curve", [name for name, curve in curves.items() for _ in curve.x]),
        Column(over, np.concatenate([curve.x for curve in curves.values()])),
        *(
            Column(name, np.concatenate([getattr(curve, name) for curve in curves.values()]))
            for name in ("rate", "low", "high", "trials")
        ),
    )
    alt = f"Dots with intervals of {', '.join(curves)} over {over}"
    return Picture(title, svg, f"{caption} Bars: binomial 95 % intervals.", Data(title, columns), alt)


def taken_for(title: str, rows: Sequence[str], columns: Sequence[str], counts: np.ndarray, caption: str) -> Picture:
    """Squares whose area is how often what is in the row was taken for what is in the column: counts (r, c).

    Squares of a name with itself have a colour of their own.
    """
    counts = np.asarray(counts, float)
    if counts.shape != (len(rows), len(columns)):
        raise RecordError(f"{title}: shape {counts.shape}, expected ({len(rows)}, {len(columns)})")
    if not counts.size:
        raise RecordError(f"{title}: no trials")
    r, c = np.nonzero(counts)
    share = counts[r, c] / counts.sum(axis=1)[r]
    same = np.equal.outer(np.array(rows, object), np.array(columns, object))[r, c].astype(bool)
    with canvas.style():
        figure = canvas.sheet(1.9 + 0.17 * len(rows))
        axes = figure.subplots()
        side = 3.0 * 72 / max(len(rows), len(columns), 20)
        for own, colour in ((True, SERIES[0]), (False, SERIES[1])):
            at = same == own
            axes.scatter(c[at], r[at], s=share[at] * side**2, marker="s", color=colour.light, linewidth=0, gid=f"same-{own}")
        axes.set_xticks(range(len(columns)), [canvas.short(name, 26) for name in columns], rotation=90)
        axes.set_yticks(range(len(rows)), [canvas.short(name, 26) for name in rows])
        axes.set_xlim(-0.7, len(columns) - 0.3)
        axes.set_ylim(len(rows) - 0.3, -0.7)
        axes.tick_params(labelsize=7 if max(len(rows), len(columns)) < 25 else 5)
        svg = canvas.render(figure)
    table = (Column("hidden", list(rows)), *(Column(name, counts[:, j]) for j, name in enumerate(columns)))
    return Picture(title, svg, caption, Data(title, table), f"Matrix of {len(rows)} by {len(columns)} squares")
