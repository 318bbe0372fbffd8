"""Pictures of envelopes: what was measured between guaranteed bounds, and what the guarantee costs in width."""

import math
from collections.abc import Iterable, Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

import workbench.report.figures.canvas as canvas
from workbench.data import Channel
from workbench.errors import InputError
from workbench.records import field, record
from workbench.report.blocks import Column, Data, Picture
from workbench.report.figures.canvas import Trace
from workbench.report.palette import INK, MUTED, SERIES, Colour

#: What lies outside is always of this colour, so no band is.
OUTSIDE = SERIES[1]
_BANDS = (SERIES[0], *SERIES[2:])
#: Half the height of the lower panel in half-widths of the band: samples farther out are held at its edge.
_FAR = 5.0
#: A band of less than this share of the height of its panel is too thin to be judged there.
_THIN = 0.01


@record
class Band:
    """Bounds low <= y <= high (N) of an envelope, and the part of it that is reached for certain, where that is known.

    NaN where the envelope says nothing; an infinite bound is one that has run away.
    """

    low: np.ndarray
    high: np.ndarray
    reached_low: np.ndarray | None = None
    reached_high: np.ndarray | None = None


@record
class Width:
    """What an envelope costs and holds: its mean radius [unit of y] and the measured values inside it [%], on one record."""

    model: str
    record: str
    mean_radius: float
    coverage: float = field("", unit="%", low=0.0, high=100.0)


def envelope(title: str, t: np.ndarray, measured: Trace, bands: Mapping[str, Band], nominal: np.ndarray | None = None) -> Picture:
    """Measured output within its envelopes above; below, for each envelope, y - middle between plus and minus half its width.

    t (N) [s]; bands: bounds (N) by name, in the unit of y; nominal (N): the model without its bounds. The lower panels show
    an envelope that is too thin beside the signal to be seen above. Measured values outside are marked.
    Raises InputError without a band or with low > high, RecordError for lengths that differ.
    """
    t = np.asarray(t, float)
    channel, y = measured.channel, canvas.of_length(measured.values, len(t), str(measured.channel))
    if not bands or not len(t):
        raise InputError(f"{title}: no envelope to draw", mend="give at least one band over at least one sample")
    bounds = {name: _bounds(band, len(t), name) for name, band in bands.items()}
    middle = None if nominal is None else canvas.of_length(nominal, len(t), "nominal")
    outside = [_outside(y, bound) for bound in bounds.values()]
    with canvas.style():
        figure = canvas.sheet(2.75 + 1.2 * len(bounds))
        above, *below = figure.subplots(1 + len(bounds), 1, sharex=True, height_ratios=[2.2] + [1.2] * len(bounds))
        handles: dict[str, object] = {}
        for i, (name, bound) in enumerate(bounds.items()):
            handles[name] = _draw(above, t, {kind: _held(v, y) for kind, v in bound.items()}, _BANDS[i % 5], f"band-{i}")
        if middle is not None:
            handles["nominal"] = canvas.trace(above, t, canvas.near(middle, y), MUTED, "nominal", dash=canvas.DASHES[1])
        handles["measured"] = canvas.trace(above, t, y, INK, "measured")
        marked = np.any(outside, axis=0)
        if marked.any():
            handles["outside"] = canvas.dots(above, t[marked], y[marked], OUTSIDE, "outside")
        away = canvas.limit(above, y, [v for bound in bounds.values() for v in bound.values()])
        above.set_ylabel(canvas.label(channel))
        for i, (axes, name) in enumerate(zip(below, bounds, strict=True)):
            away |= _around_zero(axes, t, y, bounds[name], outside[i], middle, _BANDS[i % 5], f"around-{i}")
            axes.set_ylabel(_over_unit("y \N{MINUS SIGN} middle", channel.unit))
            if len(bounds) > 1:
                axes.set_title(canvas.short(name))
        height = float(np.ptp(above.get_ylim()))
        figure.axes[-1].set_xlabel("t [s]")
        figure.align_ylabels()
        canvas.legend(figure, list(handles.values()), list(handles))
        svg = canvas.render(figure)
    thin = [name for name, bound in bounds.items() if _mean_width(bound) < _THIN * height]
    columns = [Column("t", t, "s"), Column(f"{channel.name} measured", y, channel.unit)]
    columns += [Column(f"{n} {kind}", v, channel.unit) for n, bound in bounds.items() for kind, v in bound.items()]
    columns += [] if middle is None else [Column(f"{channel.name} nominal", middle, channel.unit)]
    said = " ".join(_said(n, y, bound, channel.unit) for n, bound in bounds.items())
    return Picture(
        title,
        svg,
        f"{channel.name} measured and its envelope{'s' * (len(bounds) > 1)}; below, each around its own middle. {said}"
        + (f" Too thin to be seen in the upper panel: {', '.join(thin)}." if thin else "")
        + (" Darker lines: what is reached for certain." if any("reached low" in b for b in bounds.values()) else "")
        + (" Dots: measured values outside." if marked.any() else "")
        + (" What leaves a panel is cut off, dots are held at its edge." if away else ""),
        Data(title, tuple(columns)),
        f"Line chart over {t[-1] - t[0]:g} s: measured {channel.name} within {', '.join(bounds)}. {said}",
    )


def widths(title: str, rows: Iterable[Width], unit: str = "") -> Picture:
    """Measured values inside [%] against mean radius, a symbol for each model, a panel for each record.

    unit: of the radii. A model whose radius is not finite is named in the caption instead. Raises InputError without rows.
    """
    rows = list(rows)
    if not rows:
        raise InputError(f"{title}: no envelopes to compare", mend="give at least one row")
    models, records = list(dict.fromkeys(r.model for r in rows)), list(dict.fromkeys(r.record for r in rows))
    finite = [r for r in rows if math.isfinite(r.mean_radius)]
    radii = [r.mean_radius for r in finite if r.mean_radius > 0]
    spread = bool(radii) and len(radii) == len(finite) and max(radii) > 20 * min(radii)
    label = canvas.label(Channel("mean radius", unit))
    floor = min([99.0, *(r.coverage for r in finite)])
    margin = 0.2 * max(100.0 - floor, 1.0)
    with canvas.style():
        figure, panels = canvas.panels(len(records), label, sharey=True)
        handles = {}
        for axes, name in zip(panels, records, strict=True):
            axes.axhline(100.0, color=MUTED.light, linewidth=0.6)
            for r in (r for r in finite if r.record == name):
                i = models.index(r.model)
                (handles[r.model],) = axes.plot(
                    r.mean_radius, r.coverage, "osD^vP"[i % 6], color=canvas.colour(i).light, markersize=6, gid=f"width-{i}"
                )
            axes.set_title(canvas.short(name))
        panels[0].set_yticks([v for v in MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]).tick_values(floor, 100.0) if 0 <= v <= 100.0])
        panels[0].set_ylim(floor - 0.5 * margin, 100.0 + 1.2 * margin)  # the aim has its name above the line, clear of dots
        _radius_axis(panels, radii, spread)
        panels[0].text(0.02, 1.0, "\N{NORTH WEST ARROW} best", transform=panels[0].transAxes, va="top", color=MUTED.light)
        figure.supylabel("inside [%]", color=MUTED.light, fontsize=8.5)
        shown = [model for model in models if model in handles]
        if shown:
            canvas.legend(figure, [handles[model] for model in shown], shown)
        svg = canvas.render(figure)
    lost = [f"{r.model} on {r.record}" for r in rows if r not in finite]
    columns = (
        Column("model", [r.model for r in rows]),
        Column("record", [r.record for r in rows]),
        Column("mean radius", np.array([r.mean_radius for r in rows]), unit),
        Column("inside", np.array([r.coverage for r in rows]), "%"),
    )
    return Picture(
        title,
        svg,
        "Measured values inside the envelope against its mean radius, by record and model. The aim is the upper left: "
        "all values inside an envelope that is narrow." + (f" Without a finite radius: {', '.join(lost)}." if lost else ""),
        Data(title, columns),
        f"Dot charts of coverage against mean radius on {len(records)} records for {len(models)} models: {', '.join(models)}",
    )


def _over_unit(name: str, unit: str) -> str:
    """Name above unit: on one line they are longer than the panel is high."""
    return "\n".join([name, *([f"[{canvas.short(unit, 16)}]"] if unit else [])])


def _bounds(band: Band, N: int, name: str) -> dict[str, np.ndarray]:
    given = {"low": band.low, "high": band.high, "reached low": band.reached_low, "reached high": band.reached_high}
    if (band.reached_low is None) != (band.reached_high is None):
        raise InputError(f"{name}: one of reached_low and reached_high is missing", mend="give both or none")
    bound = {kind: canvas.of_length(values, N, f"{name} {kind}") for kind, values in given.items() if values is not None}
    if wrong := int(np.sum(bound["low"] > bound["high"])):
        raise InputError(f"{name}: low lies above high at {wrong} of {N} samples", mend="exchange the two bounds")
    return bound


def _outside(y: np.ndarray, bound: dict[str, np.ndarray]) -> np.ndarray:
    return (y < bound["low"]) | (y > bound["high"])


def _mean_width(bound: dict[str, np.ndarray]) -> float:
    """Mean of high - low over the samples where the envelope says something; NaN where it never does."""
    told = _told(bound)
    return float(np.mean(bound["high"][told] - bound["low"][told])) if told.any() else math.nan


def _told(bound: dict[str, np.ndarray]) -> np.ndarray:
    return ~(np.isnan(bound["low"]) | np.isnan(bound["high"]))


def _said(name: str, y: np.ndarray, bound: dict[str, np.ndarray], unit: str) -> str:
    told = _told(bound)
    if not told.any():
        return f"{name} says nothing about this record."
    N, inside = int(told.sum()), int(np.sum(told & ~_outside(y, bound)))
    width = _mean_width(bound)
    wide = f"on average {width:.3g} {unit}".rstrip() + " wide" if math.isfinite(width) else "without bound in part"
    # rounded down: only all of them are 100 %
    return f"{name}: {inside} of {N} measured values inside ({math.floor(1000 * inside / N) / 10:g} %), {wide}."


def _held(values: np.ndarray, own: np.ndarray) -> np.ndarray:
    """A bound that ran away, to infinity perhaps, held well outside the picture."""
    far = 50 * (float(np.ptp(own)) or 1.0)
    return np.clip(values, own.min() - far, own.max() + far)


def _draw(axes: Axes, t: np.ndarray, bound: dict[str, np.ndarray], colour: Colour, gid: str) -> object:
    drawn = canvas.band_along(axes, t, bound["low"], bound["high"], colour, gid, outline=0.7)
    for kind in ("reached low", "reached high"):
        if kind in bound:
            canvas.trace(axes, t, bound[kind], colour, f"{gid}-{kind.replace(' ', '-')}", width=1.5)
    return drawn


def _around_zero(
    axes: Axes,
    t: np.ndarray,
    y: np.ndarray,
    bound: dict[str, np.ndarray],
    outside: np.ndarray,
    nominal: np.ndarray | None,
    colour: Colour,
    gid: str,
) -> set[int]:
    """The band, the measured values and the nominal ones, all minus the middle of the band; {-1} if any is cut off."""
    middle, half = _middle(bound), (bound["high"] - bound["low"]) / 2
    e = y - middle
    top = _top(e, half)
    around = {kind: np.clip(values - middle, -50 * top, 50 * top) for kind, values in bound.items()}
    _draw(axes, t, around, colour, gid)
    if nominal is not None:
        canvas.trace(axes, t, np.clip(nominal - middle, -50 * top, 50 * top), MUTED, f"{gid}-nominal", dash=canvas.DASHES[1])
    canvas.trace(axes, t, np.clip(e, -50 * top, 50 * top), INK, f"{gid}-measured")
    if outside.any():
        canvas.dots(axes, t[outside], np.clip(e[outside], -top, top), OUTSIDE, f"{gid}-outside")
    axes.axhline(0, color=INK.light, linewidth=0.5)
    axes.set_ylim(-1.08 * top, 1.08 * top)
    axes.yaxis.set_major_locator(MaxNLocator(4, symmetric=True))
    return {-1} if np.nanmax(np.maximum(np.abs(e), half), initial=0.0) > 1.08 * top else set()


def _middle(bound: dict[str, np.ndarray]) -> np.ndarray:
    """(low + high) / 2; NaN, a break in the lines, where the envelope is without bound."""
    bounded = np.isfinite(bound["low"]) & np.isfinite(bound["high"])
    return (np.where(bounded, bound["low"], np.nan) + np.where(bounded, bound["high"], np.nan)) / 2


def _top(e: np.ndarray, half: np.ndarray) -> float:
    """What the axis must reach: all of the band and of the distances, unless they are many half-widths away."""
    finite = np.isfinite(half) & np.isfinite(e)
    if not finite.any():
        return 1.0
    farthest = float(np.maximum(np.abs(e[finite]), half[finite]).max())
    usual = float(np.quantile(half[finite], 0.95))
    return min(farthest, _FAR * usual) if usual > 0 else farthest or 1.0


def _radius_axis(panels: list[Axes], radii: list[float], spread: bool) -> None:
    """From zero, so that a width is seen as one; on a logarithmic axis where one is many times another."""
    if spread:
        panels[0].set_xscale("log")
        panels[0].set_xlim(min(radii) / 1.6, max(radii) * 1.6)
        for axes in panels:
            canvas.log_ticks(axes, axis="x")
    else:
        panels[0].set_xlim(0.0, 1.15 * max(radii, default=1.0))
        for axes in panels:
            axes.xaxis.set_major_locator(MaxNLocator(4))
