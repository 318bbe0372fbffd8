"""Pictures of sweeps: what an output depends on, all runs at once, and an output over two factors."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.ticker import MaxNLocator

import workbench.report.figures.canvas as canvas
from workbench.data import Channel
from workbench.records import RecordError, record
from workbench.report.blocks import Column, Data, Picture
from workbench.report.figures.canvas import Trace
from workbench.report.palette import MEASURED, MUTED, SERIES

LINES = 400  # runs of a picture in which each is a line


@record
class Bar:
    """A number with the ends of its interval, and another one beside it (NaN: none)."""

    name: str
    value: float
    low: float
    high: float
    beside: float = float("nan")


def tornado(title: str, of: str, bars: Sequence[Bar], caption: str, beside: str = "") -> Picture:
    """A bar for each number, the largest on top, with its interval; beside: what the open dots say."""
    if not bars:
        raise RecordError(f"{title}: nothing to draw")
    order = sorted(bars, key=lambda bar: abs(bar.value))
    y = np.arange(len(order))
    with canvas.style():
        figure = canvas.sheet(0.75 + 0.26 * len(order))
        axes = figure.subplots()
        values = np.array([bar.value for bar in order])
        axes.barh(y, values, height=0.62, color=SERIES[0].light, alpha=0.75, gid="bars")
        axes.hlines(
            y, [bar.low for bar in order], [bar.high for bar in order], color=MEASURED.light, linewidth=1.4, gid="interval"
        )
        if beside:
            axes.plot(
                [bar.beside for bar in order], y, "o", markerfacecolor="none", markersize=5, color=SERIES[1].light, gid="beside"
            )
        axes.axvline(0.0, color=MUTED.light, linewidth=0.8)
        axes.set_yticks(y, [canvas.short(bar.name) for bar in order])
        axes.set_xlabel(of)
        svg = canvas.render(figure)
    rows = order[::-1]
    columns = [Column("factor", [bar.name for bar in rows])]
    columns += [Column(name, np.array([getattr(bar, name) for bar in rows])) for name in ("value", "low", "high")]
    columns += [Column(beside, np.array([bar.beside for bar in rows]))] if beside else []
    said = ", ".join(f"{bar.name} {bar.value:.3g}" for bar in rows[:5])
    return Picture(title, svg, caption, Data(title, tuple(columns)), f"Bar chart of {of}: {said}")


def parallel(title: str, axes_of: Mapping[str, np.ndarray], by: str, caption: str) -> Picture:
    """Every run a line through all of its numbers (N,), each on an axis from its lowest to its highest; coloured along `by`."""
    names, N = list(axes_of), len(axes_of[by])
    values = np.column_stack([canvas.of_length(axes_of[name], N, name) for name in names])
    whole = np.isfinite(values).all(axis=1)
    if not whole.any() or len(names) < 2:
        raise RecordError(f"{title}: no runs to draw")
    low, high = values[whole].min(axis=0), values[whole].max(axis=0)
    shares = (values - low) / np.where(high > low, high - low, 1.0)
    j = names.index(by)
    order = np.flatnonzero(whole)
    order = order[np.linspace(0, len(order) - 1, min(LINES, len(order))).astype(int)] if len(order) > LINES else order
    order = order[np.argsort(values[order, j])]  # the highest on top
    with canvas.style():
        figure = canvas.sheet(3.1)
        axes = figure.subplots()
        for i in order:
            third = min(int(3 * shares[i, j]), 2)
            colour = (SERIES[0], MUTED, SERIES[1])[third].light
            axes.plot(range(len(names)), shares[i], color=colour, linewidth=0.7, alpha=0.55, gid=f"run-{i}")
        for k in range(len(names)):
            axes.axvline(k, color=MUTED.light, linewidth=0.8)
            axes.annotate(f"{high[k]:.3g}", (k, 1.0), xytext=(0, 3), textcoords="offset points", ha="center", fontsize=7.5)
            axes.annotate(f"{low[k]:.3g}", (k, 0.0), xytext=(0, -10), textcoords="offset points", ha="center", fontsize=7.5)
        axes.set_xticks(range(len(names)), [canvas.short(name, 18) for name in names])
        axes.tick_params(axis="x", pad=12)
        axes.set_yticks([])
        axes.set_ylim(-0.04, 1.06)
        axes.grid(visible=False)
        svg = canvas.render(figure)
    columns = tuple(Column(name, values[:, k]) for k, name in enumerate(names))
    return Picture(title, svg, caption, Data(title, columns), f"Parallel coordinates of {', '.join(names)}, {len(order)} runs")


def surface(
    title: str, x: Trace, y: Trace, z: Trace, fitted: Callable[[np.ndarray, np.ndarray], np.ndarray], caption: str
) -> Picture:  # fmt: skip
    """Lines of equal height of z = fitted(x, y) over the range of the runs x, y, z (N,); a dot for every run."""
    keep = np.isfinite(z.values)
    a, b = (np.asarray(trace.values, float)[keep] for trace in (x, y))
    if keep.sum() < 2 or np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        raise RecordError(f"{title}: too few places to draw")
    grid = np.meshgrid(np.linspace(a.min(), a.max(), 60), np.linspace(b.min(), b.max(), 60))
    height = fitted(*grid)
    with canvas.style():
        figure = canvas.sheet(3.4)
        axes = figure.subplots()
        if np.ptp(height) > 0.0:
            lines = axes.contour(*grid, height, levels=8, colors=SERIES[0].light, linewidths=1.1)
            axes.clabel(lines, fontsize=7.5, fmt="%.3g")
        canvas.dots(axes, a, b, MUTED, "runs", size=2.0)
        axes.set_xlabel(canvas.label(x.channel))
        axes.set_ylabel(canvas.label(y.channel))
        axes.xaxis.set_major_locator(MaxNLocator(6))
        svg = canvas.render(figure)
    columns = tuple(Column(t.channel.name, t.values, t.channel.unit) for t in (x, y, z))
    said = f"Contour chart of {z.channel.name} over {x.channel.name} and {y.channel.name}"
    return Picture(title, svg, caption, Data(title, columns), said)


def scatter(title: str, factors: Sequence[Trace], output: Trace, caption: str) -> Picture:
    """An output (N,) over each factor (N,), a panel each, a dot for every run."""
    if not factors:
        raise RecordError(f"{title}: no factor to draw")
    across = min(3, len(factors))
    down = -(-len(factors) // across)
    with canvas.style():
        figure = canvas.sheet(0.5 + 1.6 * down)
        every = list(figure.subplots(down, across, sharey=True, squeeze=False).flat)
        for axes in every[len(factors) :]:
            axes.set_axis_off()
        for i, (axes, x) in enumerate(zip(every, factors, strict=False)):
            keep = np.isfinite(x.values) & np.isfinite(output.values)
            canvas.dots(axes, x.values[keep], output.values[keep], canvas.colour(0), f"runs-{i}", size=2.5)
            axes.set_xlabel(canvas.label(x.channel))
            axes.xaxis.set_major_locator(MaxNLocator(4))
        figure.supylabel(canvas.label(output.channel), color=MUTED.light, fontsize=8.5)
        svg = canvas.render(figure)
    columns = tuple(Column(t.channel.name, t.values, t.channel.unit) for t in (*factors, output))
    said = f"Scatter charts of {output.channel.name} over {', '.join(x.channel.name for x in factors)}"
    return Picture(title, svg, caption, Data(title, columns), said)


def courses(
    title: str, over: Channel, panels: Mapping[str, Mapping[str, Sequence[tuple[np.ndarray, np.ndarray]]]], caption: str, *,
    log: bool = False,
) -> Picture:  # fmt: skip
    """Groups of runs (x, y), each (n,): a dot for every run, a line through the medians of the groups; by name, a panel each.

    log: x is drawn logarithmically.
    """
    names = list(dict.fromkeys(name for own in panels.values() for name in own))
    parts: list[tuple[str, str, np.ndarray, np.ndarray]] = []
    with canvas.style():
        figure, every = canvas.panels(len(panels), canvas.label(over), sharey=False)
        handles: dict[str, object] = {}
        for i, (axes, (panel, own)) in enumerate(zip(every, panels.items(), strict=True)):
            for name, groups in own.items():
                j = names.index(name)
                x, y = (np.concatenate([np.asarray(g[k], float) for g in groups]) for k in (0, 1))
                keep = np.isfinite(x) & np.isfinite(y)
                whole = [g for g in groups if np.isfinite(g[0]).any() and np.isfinite(g[1]).any()]
                middle = np.array([[np.nanmedian(g[0]), np.nanmedian(g[1])] for g in whole]).reshape(-1, 2)
                canvas.dots(axes, x[keep], y[keep], canvas.colour(j), f"runs-{i}-{j}", size=2.2)
                handles[name] = canvas.line(
                    axes, middle[:, 0], middle[:, 1], canvas.colour(j), f"medians-{i}-{j}", dash=canvas.dash(j), width=1.3
                )
                parts.append((panel, name, x, y))
            axes.set_title(canvas.short(panel))
            axes.yaxis.set_major_locator(MaxNLocator(4))
            if log:
                axes.set_xscale("log")
                places = np.unique([np.nanmedian(g[0]) for groups in own.values() for g in groups])
                places = places[np.linspace(0, len(places) - 1, min(len(places), 6)).round().astype(int)]
                axes.set_xticks(places, [f"{place:.2g}" for place in places])
                axes.set_xticks([], minor=True)
            else:
                axes.xaxis.set_major_locator(MaxNLocator(4))
        if len(names) > 1:
            canvas.legend(figure, list(handles.values()), list(handles))
        svg = canvas.render(figure)
    said = f"Medians and runs over {over.name}: {', '.join(panels)}" + f"; {', '.join(names)}" * (len(names) > 1)
    columns = (
        Column("panel", [panel for panel, _, x, _ in parts for _ in x]),
        Column("curve", [name for _, name, x, _ in parts for _ in x]),
        Column(over.name, np.concatenate([x for _, _, x, _ in parts]), over.unit),
        Column("value", np.concatenate([y for *_, y in parts])),
    )
    return Picture(title, svg, f"{caption} Dots: runs; lines: medians.", Data(title, columns), said)
