"""Pictures of operating modes: when each holds, where it holds, what its parameters are, and how many it takes."""

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

import workbench.report.figures.canvas as canvas
from workbench.data import GAP, Channel
from workbench.errors import InputError
from workbench.records import field, record
from workbench.report.blocks import Column, Data, Picture
from workbench.report.figures.canvas import Trace
from workbench.report.palette import INK, MUTED, SERIES

#: More stretches than this are stripes: the line alone carries the colours.
_SHADED = 120
#: As many modes have their names on the axis or in a legend; more have their numbers.
_NAMED = 8
#: Samples in the plane are drawn once in each cell of a grid of this many cells across and up.
_CELLS = (72, 48)


@record
class ParameterInterval:
    """centre +- radius of one parameter in each of M modes."""

    centre: np.ndarray = field("M")
    radius: np.ndarray = field("M", low=0.0)


@record
class Stretches:
    """Stretches of time in which one mode holds: samples first .. last (inclusive), from t = start until stop [s]."""

    mode: np.ndarray = field("S")
    first: np.ndarray = field("S")
    last: np.ndarray = field("S")
    start: np.ndarray = field("S", unit="s")
    stop: np.ndarray = field("S", unit="s")


def modes_along_time(
    title: str, t: np.ndarray, measured: Trace, mode: np.ndarray, names: Sequence[str] = (), short: Collection[int] = ()
) -> Picture:
    """The measured signal in the colours of its operating modes above, the number of the mode as a step line below.

    t (N) [s]; mode (N): whole numbers, NaN or negative where there is no mode; names[i] of mode i, none for numbers; short:
    modes made from fewer samples than a mode should have. Six colours return in order; the step line tells modes apart.
    """
    t, mode = np.asarray(t, float), canvas.of_length(mode, len(t), "mode")
    channel, y = measured.channel, canvas.of_length(measured.values, len(t), str(measured.channel))
    mode = _numbers(mode, title)
    stretches = _stretches(t, mode)
    present = np.unique(stretches.mode).astype(int)
    called = _called(present, names, title)
    tails = [m for m in present if m in short]
    with canvas.style():
        figure = canvas.sheet(3.7)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.7, 1])
        _coloured(above, t, y, mode, stretches)
        above.set_ylabel(canvas.label(channel))
        handles = [_steps(below, stretches, INK, "mode", 1.3)]
        if tails:
            keep = np.isin(stretches.mode, tails)
            handles.append(_steps(below, _of_stretches(stretches, keep), SERIES[1], "short", 3.2))
        _mode_axis(below, called)
        below.set_xlabel("t [s]")
        figure.align_ylabels()
        if tails:
            canvas.legend(figure, handles, ["mode", "short tail"])
        svg = canvas.render(figure)
    said = f"{len(present)} operating mode{'s' * (len(present) != 1)}, {_changes(mode)} changes of mode"
    lasting = {m: float(np.mean(mode == m)) for m in present}
    most = max(lasting, key=lambda m: lasting[m])
    columns = [Column("t", t, "s"), Column(channel.name, y, channel.unit), Column("mode", mode)]
    columns += [Column("mode name", [called.get(int(m), "") if m >= 0 else "" for m in mode])] if names else []
    return Picture(
        title,
        svg,
        f"{channel.name} in the colours of its modes; below, the mode that holds. {said}; most of the time "
        f"in {called[int(most)]}: {100 * lasting[most]:.3g} % of the samples."
        + (f" Made from a short tail: {', '.join(called[int(m)] for m in tails)}." if tails else ""),
        Data(title, tuple(columns)),
        f"Line chart over {t[-1] - t[0]:g} s: {channel.name} coloured by mode, the mode as a step line below. {said}",
    )


def parameters_along_time(
    title: str,
    edges: np.ndarray,
    parameters: Mapping[str, ParameterInterval],
    t: np.ndarray | None = None,
    truth: Mapping[str, np.ndarray] | None = None,
) -> Picture:
    """centre +- radius of every parameter, constant in each mode, along time; a small panel each, with the truth where known.

    edges (M + 1) [s], increasing: mode i holds from edges[i] to edges[i + 1]. truth: values (N) by parameter at t (N) [s].
    The numbers behind the picture are those at t, without truth those of each mode.
    """
    edges = np.asarray(edges, float)
    M, truth = len(edges) - 1, truth or {}
    if not parameters or M < 1 or not np.all(np.diff(edges) > 0):
        raise InputError(f"{title}: no parameters along increasing edges", mend="give a parameter, and M + 1 edges of M modes")
    if truth and t is None:
        raise InputError(f"{title}: a truth without its time", mend="give t")
    t = edges[:0] if t is None else np.asarray(t, float)
    true = {name: canvas.of_length(values, len(t), f"{name} truth") for name, values in truth.items() if name in parameters}
    for name, p in parameters.items():
        canvas.of_length(p.centre, M, f"{name} centre")
    with canvas.style():
        figure, panels = canvas.panels(len(parameters), "t [s]", sharey=False)
        handles: dict[str, object] = {}
        x = np.repeat(edges, 2)[1:-1]
        for i, (axes, (name, p)) in enumerate(zip(panels, parameters.items(), strict=True)):
            low, high = np.repeat(p.centre - p.radius, 2), np.repeat(p.centre + p.radius, 2)
            handles["interval"] = canvas.band(axes, x, low, high, SERIES[0], f"interval-{i}")
            if name in true:
                handles["truth"] = canvas.line(axes, t, true[name], INK, f"truth-{i}", dash=canvas.DASHES[1])
            axes.set_title(canvas.short(name))
            axes.yaxis.set_major_locator(MaxNLocator(4))
            axes.xaxis.set_major_locator(MaxNLocator(4))
        canvas.legend(figure, list(handles.values()), list(handles))
        svg = canvas.render(figure)
    said = [_held_by(name, parameters[name], edges, t, values) for name, values in true.items()]
    return Picture(
        title,
        svg,
        f"Interval of every parameter along time, constant in each of {M} modes." + (" " + " ".join(said) if said else ""),
        Data(title, _parameter_columns(edges, parameters, t, true)),
        f"Small charts of {len(parameters)} parameter intervals over {edges[-1] - edges[0]:g} s: {', '.join(parameters)}",
    )


def domains(
    title: str, first: Channel, second: Channel, regions: Mapping[str, np.ndarray], points: np.ndarray, mode: np.ndarray
) -> Picture:
    """Validity domains and samples, both projected onto two regressors; a sample has the colour of its mode's domain.

    regions: corners (v, 2) of convex polygons in their order, mode i is the i-th; points (K, 2); mode (K): NaN or negative
    for a sample without a mode. Two corners are a line, one is a point. Samples in one place are drawn once.
    """
    points = np.asarray(points, float)
    if not regions or points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"{title}: no regions or points of shape {points.shape}", mend="give regions and points (K, 2)")
    mode = _numbers(canvas.of_length(mode, len(points), "mode"), title, empty=True)
    corners = {name: _polygon(polygon, name) for name, polygon in regions.items()}
    if len(points) and mode.max() >= len(corners):
        raise InputError(f"{title}: a sample of mode {mode.max():g}", mend=f"there are {len(corners)} regions")
    with canvas.style():
        figure = canvas.sheet(4.0)
        axes = figure.subplots()
        handles = [_region(axes, polygon, i) for i, polygon in enumerate(corners.values())]
        for i in range(-1, len(corners)):
            own = points[mode == i]
            own = own[_one_of_each_place(own, points)]
            colour = MUTED if i < 0 else canvas.colour(i)
            axes.plot(own[:, 0], own[:, 1], "o", color=colour.light, markersize=2.2, markeredgewidth=0, gid=f"samples-{i}")
        axes.margins(0.06)
        axes.set_xlabel(canvas.label(first))
        axes.set_ylabel(canvas.label(second))
        if len(corners) <= _NAMED:
            canvas.legend(figure, handles, list(corners))
        else:
            _number_regions(axes, corners)
        svg = canvas.render(figure)
    lost = int(np.sum(mode < 0))
    names = list(corners)
    columns = (
        Column("what", ["sample"] * len(points) + [f"corner of {n}" for n, v in corners.items() for _ in v]),
        Column(first.name, np.concatenate([points[:, 0], *(v[:, 0] for v in corners.values())]), first.unit),
        Column(second.name, np.concatenate([points[:, 1], *(v[:, 1] for v in corners.values())]), second.unit),
        Column("mode", [names[int(m)] if m >= 0 else "" for m in mode] + [n for n, v in corners.items() for _ in v]),
    )
    return Picture(
        title,
        svg,
        f"Domains of {len(corners)} modes seen along {first.name} and {second.name}, with {len(points)} samples in the colours "
        "of their modes (one drawn in each place). Domains that overlap here may be apart in other directions."
        + (f" Grey: samples without a mode ({lost})." if lost else ""),
        Data(title, columns),
        f"Chart of {len(corners)} polygons and {len(points)} samples over {first.name} and {second.name}",
    )


def modes_against_precision(
    precision: np.ndarray, modes: np.ndarray, radius: np.ndarray, chosen: float, unit: str = ""
) -> Picture:
    """The number of modes above and the mean radius of their envelopes [unit] below, against the precision asked for.

    precision (P), between 0 and 1; modes (P), radius (P); chosen: the precision that was taken.
    """
    precision = np.asarray(precision, float)
    order = np.argsort(precision, kind="stable")
    count, mean = (canvas.of_length(v, len(precision), n) for v, n in ((modes, "modes"), (radius, "mean radius")))
    if not len(precision):
        raise InputError("modes against precision: no precision was tried", mend="give at least one")
    with canvas.style():
        figure = canvas.sheet(3.6)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.4, 1])
        canvas.line(above, precision[order], count[order], SERIES[0], "modes", marker="o")
        canvas.line(below, precision[order], mean[order], SERIES[0], "radius", marker="o")
        _mark(above, precision, chosen, f"precision {chosen:.4g}")
        _mark(below, precision, chosen, "")
        above.set_ylim(0, 1.1 * float(np.nanmax(count)) or 1.0)
        below.set_ylim(0, 1.1 * float(np.nanmax(mean)) or 1.0)
        above.yaxis.set_major_locator(MaxNLocator(5, integer=True))
        below.yaxis.set_major_locator(MaxNLocator(4))
        above.set_ylabel("number of modes")
        below.set_ylabel(canvas.label(Channel("mean radius", unit)))
        below.set_xlabel("precision")
        figure.align_ylabels()
        svg = canvas.render(figure)
    at = int(np.argmin(np.abs(precision - chosen)))
    taken = ""
    if math.isclose(precision[at], chosen):
        taken = f" with {count[at]:g} mode{'s' * int(count[at] != 1)} and a mean radius of {mean[at]:.3g} {unit}".rstrip()
    return Picture(
        "Modes against precision",
        svg,
        f"Number of modes and mean radius of the envelope against the precision asked for; chosen: {chosen:.4g}{taken}.",
        Data(
            "modes against precision",
            (Column("precision", precision), Column("modes", count), Column("mean radius", mean, unit)),
        ),
        f"Line charts against precision from {precision.min():.4g} to {precision.max():.4g}: number of modes, mean radius",
    )


def _mark(axes: Axes, precision: np.ndarray, chosen: float, text: str) -> None:
    """The chosen precision; its name stands on the side where there is room."""
    canvas.mark(axes, chosen, "")
    right = chosen > (precision.min() + precision.max()) / 2
    axes.annotate(
        text,
        (chosen, 1),
        xytext=(-4 if right else 4, -1),
        xycoords=axes.get_xaxis_transform(),
        textcoords="offset points",
        va="top",
        ha="right" if right else "left",
    )


def _numbers(mode: np.ndarray, title: str, *, empty: bool = False) -> np.ndarray:
    """Whole numbers; -1 where there is no mode."""
    mode = np.where(mode >= 0, mode, -1.0)
    if np.any(mode != np.round(mode)):
        raise InputError(f"{title}: {mode[mode != np.round(mode)][0]:g} is no number of a mode", mend="count modes from 0")
    if not empty and not np.any(mode >= 0):
        raise InputError(f"{title}: no sample has a mode", mend="give the mode of at least one sample")
    return mode


def _called(present: np.ndarray, names: Sequence[str], title: str) -> dict[int, str]:
    if names and present[-1] >= len(names):
        raise InputError(f"{title}: mode {present[-1]}, but {len(names)} names", mend="give a name for every mode, or none")
    return {int(m): str(names[m]) if names else str(m) for m in present}


def _stretches(t: np.ndarray, mode: np.ndarray) -> Stretches:
    """A stretch lasts until the next begins; before a gap of t, or before samples without a mode, until its last sample."""
    step = np.diff(t)
    gap = step > GAP * np.median(step) if len(t) > 2 else np.zeros(len(step), bool)
    cut = np.flatnonzero(gap | (np.diff(mode) != 0))
    first, last = np.r_[0, cut + 1], np.r_[cut, len(t) - 1]
    joined = np.r_[~gap[cut] & (mode[cut + 1] >= 0), False]
    stop = np.where(joined, t[np.minimum(last + 1, len(t) - 1)], t[last])
    return _of_stretches(Stretches(mode[first], first, last, t[first], stop), mode[first] >= 0)


def _of_stretches(s: Stretches, keep: np.ndarray) -> Stretches:
    return Stretches(s.mode[keep], s.first[keep], s.last[keep], s.start[keep], s.stop[keep])


def _changes(mode: np.ndarray) -> int:
    own = mode[mode >= 0]
    return int(np.sum(np.diff(own) != 0))


def _coloured(axes: Axes, t: np.ndarray, y: np.ndarray, mode: np.ndarray, stretches: Stretches) -> None:
    """One line for each colour; each sample is joined to the next, so that a mode of one sample is still a line."""
    if np.any(mode < 0):
        canvas.trace(axes, t, np.where(_and_next(mode < 0), y, np.nan), MUTED, "no-mode")
    shaded = len(stretches.mode) <= _SHADED
    for c in np.unique(stretches.mode[:] % len(SERIES)).astype(int):
        own = (mode >= 0) & (mode % len(SERIES) == c)
        canvas.trace(axes, t, np.where(_and_next(own), y, np.nan), SERIES[c], f"colour-{c}", width=1.2)
        for k in np.flatnonzero(stretches.mode % len(SERIES) == c) if shaded else ():
            axes.axvspan(stretches.start[k], stretches.stop[k], color=SERIES[c].light, alpha=0.13, linewidth=0, gid=f"span-{k}")


def _and_next(own: np.ndarray) -> np.ndarray:
    return own | np.r_[False, own[:-1]]


def _steps(axes: Axes, s: Stretches, colour, gid: str, width: float):
    """The mode of each stretch as a level line, joined where one stretch follows the other, broken where time is lost."""
    x, y = np.column_stack([s.start, s.stop]), np.column_stack([s.mode, s.mode])
    lost = np.flatnonzero(s.start[1:] > s.stop[:-1]) + 1
    x, y = np.insert(x.ravel(), 2 * lost, s.start[lost]), np.insert(y.ravel(), 2 * lost, np.nan)
    return canvas.line(axes, x, y, colour, gid, width=width)


def _mode_axis(axes: Axes, called: dict[int, str]) -> None:
    low, high = min(called), max(called)
    margin = max(0.06 * (high - low), 0.5)
    axes.set_ylim(low - margin, high + margin)
    if len(called) <= _NAMED and high - low < 2 * _NAMED:
        axes.set_yticks(list(called), [canvas.short(name, 14) for name in called.values()])
    else:
        axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    axes.set_ylabel("mode")


def _held_by(name: str, p: ParameterInterval, edges: np.ndarray, t: np.ndarray, truth: np.ndarray) -> str:
    i = _mode_at(edges, t)
    known = np.isfinite(truth) & (t >= edges[0]) & (t <= edges[-1])
    inside = int(np.sum(np.abs(truth - p.centre[i])[known] <= p.radius[i][known]))
    return f"{name}: the truth lies in its interval at {inside} of {int(known.sum())} samples."


def _mode_at(edges: np.ndarray, t: np.ndarray) -> np.ndarray:
    return np.clip(np.searchsorted(edges, t, side="right") - 1, 0, len(edges) - 2)


def _parameter_columns(
    edges: np.ndarray, parameters: Mapping[str, ParameterInterval], t: np.ndarray, true: Mapping[str, np.ndarray]
) -> tuple[Column, ...]:
    if true:
        rows, columns = _mode_at(edges, t), [Column("t", t, "s")]
    else:
        rows, columns = np.arange(len(edges) - 1), [Column("from", edges[:-1], "s"), Column("to", edges[1:], "s")]
    for name, p in parameters.items():
        columns += [Column(f"{name} centre", p.centre[rows]), Column(f"{name} radius", p.radius[rows])]
        columns += [Column(f"{name} truth", true[name])] if name in true else []
    return tuple(columns)


def _polygon(corners: np.ndarray, name: str) -> np.ndarray:
    polygon = np.asarray(corners, float)
    if polygon.ndim != 2 or polygon.shape[1] != 2 or not len(polygon):
        raise InputError(f"{name}: corners of shape {polygon.shape}", mend="give corners (v, 2), v at least 1")
    return polygon


def _region(axes: Axes, polygon: np.ndarray, i: int):
    """Outline and tint; the outline alone of a region that is flat."""
    colour, closed = canvas.colour(i).light, np.vstack([polygon, polygon[:1]])
    if len(polygon) > 2:
        axes.fill(polygon[:, 0], polygon[:, 1], color=colour, alpha=0.13, linewidth=0, gid=f"tint-{i}")
    (outline,) = axes.plot(
        closed[:, 0],
        closed[:, 1],
        marker="x" if len(polygon) == 1 else "",
        linestyle=canvas.dash(i),
        color=colour,
        linewidth=1.3,
        gid=f"region-{i}",
    )
    return outline


def _one_of_each_place(own: np.ndarray, every: np.ndarray) -> np.ndarray:
    """Indices of the first sample in each cell of the picture, and of those farthest out in each direction."""
    if not len(own):
        return np.arange(0)
    low, span = every.min(axis=0), np.ptp(every, axis=0)
    cell = ((own - low) / np.where(span > 0, span, 1.0) * (np.array(_CELLS) - 1)).astype(int)
    first = np.unique(cell[:, 0] * _CELLS[1] + cell[:, 1], return_index=True)[1]
    return np.unique(np.concatenate([first, own.argmin(axis=0), own.argmax(axis=0)]))


def _number_regions(axes: Axes, corners: Mapping[str, np.ndarray]) -> None:
    """Names in the middle of their regions, the largest first; one that would cover another is left out."""
    middles = {name: polygon.mean(axis=0) for name, polygon in corners.items()}
    size = {name: float(np.prod(np.ptp(polygon, axis=0))) for name, polygon in corners.items()}
    reach = np.array([np.ptp(axes.get_xlim()) / 28, np.ptp(axes.get_ylim()) / 20])
    placed: list[np.ndarray] = []
    for name in sorted(corners, key=lambda n: -size[n]):
        if all(np.any(np.abs(middles[name] - other) > reach) for other in placed):
            axes.text(middles[name][0], middles[name][1], canvas.short(name, 8), ha="center", va="center", fontsize=8)
            placed.append(middles[name])
