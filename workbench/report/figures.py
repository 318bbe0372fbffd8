"""The pictures of a report: data in, `Picture` out. The only matplotlib in the library, and of it only the object interface.

Pictures are drawn in the light colours of the palette on a transparent ground. The settings of whoever calls stay out, so
the same data give the same bytes everywhere.
"""

import io
import math
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from workbench.data import GAP, Channel
from workbench.metrics import Horizon, Score, horizon_name
from workbench.records import RecordError, field, record
from workbench.report.decimate import extremes
from workbench.report.page import SUPERSCRIPT, Column, Data, Picture
from workbench.report.palette import GRID, INK, MEASURED, MUTED, PAPER, SERIES, Colour
from workbench.report.svg import printable

#: Width of a picture in inches of 72 points; the page scales it.
WIDTH = 7.2
#: Pixel columns a trace is drawn for.
PIXELS = 600
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

_DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)))


@record
class Trace:
    """A channel and its samples."""

    channel: Channel
    values: np.ndarray = field("N")


@record
class Coefficient:
    """One scheduled coefficient f_i over the schedule: as identified, the band the data allow, and the truth where known."""

    identified: np.ndarray
    low: np.ndarray | None = None
    high: np.ndarray | None = None
    truth: np.ndarray | None = None


def measured_and_simulated(
    name: str, t: np.ndarray, measured: Trace, simulated: Mapping[str, np.ndarray], schedule: Trace | None = None
) -> Picture:
    """Measured and simulated output of a record above, the error (measured - simulated) below, the schedule at the bottom.

    t (N) [s]; simulated: samples (N) by model. Lines break at gaps of t and at samples that are not finite.
    """
    t = np.asarray(t, float)
    traces = {model: _of_length(values, len(t), model) for model, values in simulated.items()}
    _of_length(measured.values, len(t), str(measured.channel))
    channel, y = measured.channel, measured.values
    heights = [2.3, 1.25] + [0.8] * (schedule is not None)
    with _style():
        figure = Figure((WIDTH, 0.55 + sum(heights)), layout="constrained")
        above, below, *bottom = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
        handles = [_trace(above, t, y, MEASURED, "measured", width=2.6)]  # broad and pale: models are drawn over it
        for i, values in enumerate(traces.values()):
            handles.append(_trace(above, t, _near(values, y), _colour(i), f"simulated-{i}", dash=_dash(i)))
            _trace(below, t, y - _near(values, y), _colour(i), f"error-{i}", dash=_dash(i))
        away = _limit(above, y, list(traces.values())) | _limit_errors(below, y, [y - v for v in traces.values()])
        below.axhline(0, color=INK.light, linewidth=0.6)
        above.set_ylabel(_label(channel))
        below.set_ylabel(_label(Channel("error", channel.unit)))
        if schedule:
            _trace(bottom[0], t, schedule.values, MUTED, "schedule", width=1.1)
            bottom[0].set_ylabel(_label(schedule.channel))
        figure.axes[-1].set_xlabel("t [s]")
        _legend(figure, handles, ["measured", *traces])
        svg = _render(figure)
    cut = [model for i, model in enumerate(traces) if i in away]
    columns = [Column("t", t, "s"), Column(f"{channel.name} measured", y, channel.unit)]
    columns += [Column(f"{channel.name} {model}", values, channel.unit) for model, values in traces.items()]
    columns += [Column(schedule.channel.name, schedule.values, schedule.channel.unit)] if schedule else []
    return Picture(
        f"{channel.name}, record {name}",
        svg,
        f"Record {name}: {channel.name} measured and simulated; below it the error, measured minus simulated"
        + (f"; at the bottom the schedule {schedule.channel.name}." if schedule else ".")
        + (f" Off the picture in part: {', '.join(cut)}." if cut else ""),
        Data(f"{channel.name} {name}", tuple(columns)),
        f"Line chart over {t[-1] - t[0]:g} s: measured {channel.name} and {', '.join(traces) or 'no model'}, errors below",
    )


def singular_values(values: np.ndarray, order: int) -> Picture:
    """Singular values on a logarithmic axis, the chosen order marked: what lies right of the line is left out."""
    values = np.asarray(values, float)
    index = np.arange(1, len(values) + 1)
    shown = values > 0
    with _style():
        figure = Figure((WIDTH, 2.6), layout="constrained")
        axes = figure.subplots()
        axes.set_yscale("log")
        for keep, face in ((index <= order, SERIES[0]), (index > order, PAPER)):
            k = keep & shown
            axes.plot(index[k], values[k], "o", color=SERIES[0].light, markerfacecolor=face.light, markersize=5)
        _mark(axes, order + 0.5, f"order {order}")
        _log_ticks(axes)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("index")
        axes.set_ylabel("singular value")
        svg = _render(figure)
    drop = ""
    if 0 < order < len(values) and values[order] > 0:
        drop = f" The step across the line is a factor {values[order - 1] / values[order]:.3g}."
    return Picture(
        "Singular values and chosen order",
        svg,
        f"Singular values; filled: the {order} that the model keeps.{drop}",
        Data("singular values", (Column("index", index), Column("singular value", values))),
        f"Dot chart of {len(values)} singular values on a logarithmic axis, order {order} marked",
    )


def order_sweep(orders: Sequence[int], fit: Mapping[str, np.ndarray], chosen: int) -> Picture:
    """FIT [%] against the model order, a line for each entry of `fit` (estimation, held-out); the chosen order marked."""
    index = np.asarray(orders)
    curves = {name: _of_length(values, len(orders), name) for name, values in fit.items()}
    with _style():
        figure = Figure((WIDTH, 2.6), layout="constrained")
        axes = figure.subplots()
        handles = [
            _line(axes, index, values, _colour(i), f"fit-{i}", dash=_dash(i), marker="o")
            for i, values in enumerate(curves.values())
        ]
        _mark(axes, chosen, f"order {chosen}")
        _fit_axis(axes, list(curves.values()))
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("model order")
        _legend(figure, handles, list(curves))
        svg = _render(figure)
    return Picture(
        "FIT against model order",
        svg,
        f"FIT of each model order; chosen: {chosen}.",
        Data("order sweep", (Column("order", index), *(Column(f"FIT {name}", v, "%") for name, v in curves.items()))),
        f"Line chart of FIT against model order from {orders[0]} to {orders[-1]}, order {chosen} marked",
    )


def sparsity_path(
    mu: np.ndarray, support: np.ndarray, fit_estimation: np.ndarray, fit_held_out: np.ndarray, chosen: float
) -> Picture:
    """FIT [%] on estimation and held-out records above, the number of coefficients kept below, against the bound mu."""
    mu = np.asarray(mu, float)
    support, estimation, held_out = (
        _of_length(v, len(mu), name)
        for v, name in ((support, "support"), (fit_estimation, "estimation"), (fit_held_out, "held-out"))
    )
    with _style():
        figure = Figure((WIDTH, 3.6), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.6, 1])
        handles = [
            _line(above, mu, held_out, SERIES[0], "held-out", marker="o"),
            _line(above, mu, estimation, MUTED, "estimation", dash=_DASHES[1]),
        ]
        _line(below, mu, support, INK, "support", marker="o")
        if mu.min() > 0 and mu.max() > 20 * mu.min():
            above.set_xscale("log")
            _log_ticks(below, axis="x")
        _mark(above, chosen, f"\N{GREEK SMALL LETTER MU} = {chosen:.4g}")
        _mark(below, chosen, "")
        _fit_axis(above, [held_out, estimation])
        below.set_ylim(bottom=0)
        below.yaxis.set_major_locator(MaxNLocator(4, integer=True))
        below.set_ylabel("coefficients kept")
        below.set_xlabel("bound \N{GREEK SMALL LETTER MU}")
        _legend(figure, handles, ["held-out", "estimation"])
        svg = _render(figure)
    return Picture(
        "Sparsity path",
        svg,
        f"FIT and number of coefficients kept against the bound \N{GREEK SMALL LETTER MU}; "
        f"chosen: \N{GREEK SMALL LETTER MU} = {chosen:.4g}.",
        Data(
            "sparsity path",
            (
                Column("mu", mu),
                Column("coefficients kept", support),
                Column("FIT estimation", estimation, "%"),
                Column("FIT held-out", held_out, "%"),
            ),
        ),
        "Line charts against mu: FIT of held-out and estimation records, and the number of coefficients kept",
    )


def coefficient_functions(rho: Trace, coefficients: Mapping[str, Coefficient]) -> Picture:
    """Every scheduled coefficient over the schedule in its own small panel: identified, feasible band and truth."""
    curves = {name: _curves(c, len(rho.values), name) for name, c in coefficients.items()}
    with _style():
        figure, panels = _panels(len(curves), _label(rho.channel), sharey=False)
        handles: dict[str, object] = {}
        for i, (axes, (name, curve)) in enumerate(zip(panels, curves.items(), strict=True)):
            if "low" in curve and "high" in curve:
                handles["feasible band"] = axes.fill_between(
                    rho.values, curve["low"], curve["high"], color=SERIES[0].light, alpha=0.2, linewidth=0
                )
            if "truth" in curve:
                handles["truth"] = _line(axes, rho.values, curve["truth"], INK, f"truth-{i}", dash=_DASHES[1])
            handles["identified"] = _line(axes, rho.values, curve["identified"], SERIES[0], f"identified-{i}", width=1.4)
            axes.set_title(_short(name))
            axes.yaxis.set_major_locator(MaxNLocator(4))
            axes.xaxis.set_major_locator(MaxNLocator(4))
        names = [name for name in ("identified", "feasible band", "truth") if name in handles]
        _legend(figure, [handles[name] for name in names], names)
        svg = _render(figure)
    columns = [Column(f"{name} {kind}", values) for name, curve in curves.items() for kind, values in curve.items()]
    return Picture(
        f"Coefficients over {rho.channel.name}",
        svg,
        f"{' and '.join(_sentence(names))} of every coefficient over {rho.channel.name}.",
        Data("coefficient functions", (Column(rho.channel.name, rho.values, rho.channel.unit), *columns)),
        f"Small line charts of {len(curves)} coefficients over {rho.channel.name}: {', '.join(names)}",
    )


def frozen_responses(omega: np.ndarray, rho: Trace, magnitude: Mapping[str, np.ndarray], title: str) -> Picture:
    """Frozen magnitude responses [dB] over frequency [rad/s], one panel for each value of the schedule.

    magnitude: (number of schedule values, number of frequencies) by name; the first is drawn in ink, as the reference.
    """
    omega = np.asarray(omega, float)
    shape = (len(rho.values), len(omega))
    for name, values in magnitude.items():
        if np.shape(values) != shape:
            raise RecordError(f"frozen_responses, {name}: shape {np.shape(values)}, expected {shape}")
    colours = [INK, *(_colour(j) for j in range(len(magnitude) - 1))]
    with _style():
        figure, panels = _panels(shape[0], "\N{GREEK SMALL LETTER OMEGA} [rad/s]", sharey=True)
        handles = []
        for i, (axes, at) in enumerate(zip(panels, rho.values, strict=True)):
            handles = [
                _line(axes, omega, np.asarray(values)[i], colour, f"frozen-{i}-{j}", dash=_DASHES[min(j, 1)], width=1.3)
                for j, (values, colour) in enumerate(zip(magnitude.values(), colours, strict=True))
            ]
            axes.set_xscale("log")
            axes.set_title(f"{_short(rho.channel.name)} = {at:.4g} {printable(rho.channel.unit)}".rstrip())
            _log_ticks(axes, axis="x")
        figure.supylabel("magnitude [dB]", color=MUTED.light, fontsize=8.5)
        _legend(figure, handles, list(magnitude))
        svg = _render(figure)
    R, K = shape
    columns = [Column("omega", np.tile(omega, R), "rad/s")]
    columns += [Column(rho.channel.name, np.repeat(rho.values, K), rho.channel.unit)]
    columns += [Column(name, np.ravel(values), "dB") for name, values in magnitude.items()]
    return Picture(
        title,
        svg,
        f"Magnitude of the response with {rho.channel.name} frozen at {R} values: {', '.join(magnitude)}.",
        Data(title, tuple(columns)),
        f"Bode magnitude charts at {R} frozen values of {rho.channel.name}: {', '.join(magnitude)}",
    )


def score_dots(scores: Iterable[Score], output: str, horizon: Horizon = "free-run") -> Picture:
    """FIT [%] of one output at one horizon by model and record, a row for each record and split, held-out ones first.

    Scores below zero are worse than the mean of the record; they and those that are no number are named at the left edge.
    """
    table: dict[tuple[str, str], dict[str, float]] = {}
    for s in scores:
        if (s.output, s.horizon) == (output, horizon):
            table.setdefault((s.record, s.split), {})[s.model] = s.FIT
    if not table:
        raise RecordError(f"score_dots: no scores of {output} at horizon {horizon}")
    rows = dict(sorted(table.items(), key=lambda item: item[0][1] != "held-out"))
    models = list(dict.fromkeys(model for fits in rows.values() for model in fits))
    curves = {model: np.array([fits.get(model, math.nan) for fits in rows.values()]) for model in models}
    said = horizon_name(horizon)
    with _style():
        figure = Figure((WIDTH, 0.9 + 0.42 * len(rows)), layout="constrained")
        axes = figure.subplots()
        left = _left_edge(np.concatenate(list(curves.values())), any(_lost(fits) for fits in rows.values()))
        step = min(0.2, 0.7 / len(models))
        handles = [
            axes.plot(
                np.where(fits >= 0, fits, np.nan),
                np.arange(len(rows)) + step * (i - (len(models) - 1) / 2),
                "osD^vP"[i % 6],
                color=_colour(i).light,
                markersize=6,
                gid=f"fit-{i}",
            )[0]
            for i, fits in enumerate(curves.values())
        ]
        for row, fits in enumerate(rows.values()):
            if lost := _lost(fits):
                text = f" \N{BLACK LEFT-POINTING SMALL TRIANGLE} {', '.join(lost)}"
                axes.text(left, row, text, va="center", fontsize=8)
        axes.set_xlim(left, 100.0)
        axes.set_yticks(range(len(rows)), [f"{_short(name)} ({split})" for name, split in rows])
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.set_xlabel(f"FIT, {said} [%]")
        boundary = sum(split == "held-out" for _, split in rows)
        if 0 < boundary < len(rows):
            axes.axhline(boundary - 0.5, color=MUTED.light, linewidth=0.6)
        _legend(figure, handles, models)
        svg = _render(figure)
    columns = [Column("record", [name for name, _ in rows]), Column("split", [split for _, split in rows])]
    columns += [Column(f"FIT {model}", values, "%") for model, values in curves.items()]
    return Picture(
        f"FIT of {output}, {said}",
        svg,
        f"FIT ({said}) of {output} by record and model, held-out records first; right is better, 100 % is perfect.",
        Data(f"FIT {output} {said}", tuple(columns)),
        f"Dot chart of FIT, {said}, for {len(rows)} records and {len(models)} models: {', '.join(models)}",
    )


def _lost(fits: Mapping[str, float]) -> list[str]:
    """The models whose FIT has no place on an axis from 0 to 100, each with what it scored."""
    return [f"{_short(model)} {_lost_score(fit)}" for model, fit in fits.items() if not (math.isfinite(fit) and fit >= 0)]


def _lost_score(fit: float) -> str:
    if math.isnan(fit):
        return "no FIT"
    return f"{fit:.0f}".replace("-", "\N{MINUS SIGN}") if fit > -1000 else "below \N{MINUS SIGN}1000"


def _left_edge(fits: np.ndarray, lost: bool) -> float:
    """Where the axis of FIT begins: at a round number below the lowest, at zero where some are below zero."""
    return 0.0 if lost else max(0.0, 10 * math.floor(np.nanmin(fits) / 10 - 0.5))


@contextmanager
def _style() -> Iterator[None]:
    """Matplotlib as this module wants it, whatever the user's own settings are, and those again afterwards."""
    with matplotlib.rc_context(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from")  # the page's fonts draw the text, not these
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        yield


def _panels(count: int, xlabel: str, *, sharey: bool) -> tuple[Figure, list[Axes]]:
    """A figure of `count` small panels, three in a row, over one common horizontal axis."""
    if not count:
        raise RecordError("a picture of nothing: give at least one panel")
    across = min(3, count)
    down = math.ceil(count / across)
    figure = Figure((WIDTH, 0.7 + 1.4 * down), layout="constrained")
    panels = list(figure.subplots(down, across, sharex=True, sharey=sharey, squeeze=False).flat)
    for axes in panels[count:]:
        axes.set_axis_off()
    for axes in panels[count - across : count]:
        axes.tick_params(labelbottom=True)
    figure.supxlabel(xlabel, color=MUTED.light, fontsize=8.5)
    return figure, panels[:count]


def _render(figure: Figure) -> str:
    stream = io.StringIO()
    FigureCanvasSVG(figure).print_svg(stream, metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    return stream.getvalue()


def _line(
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
    (line,) = axes.plot(
        x[keep], y[keep], marker=marker, linestyle=dash, color=colour.light, linewidth=width, markersize=4, gid=gid
    )
    return line


def _trace(
    axes: Axes, t: np.ndarray, y: np.ndarray, colour: Colour, gid: str, *, dash: str | tuple = "-", width: float = 0.9
) -> Line2D:
    """A line over time, which breaks where samples are missing."""
    return _line(axes, *_broken(t, y), colour, gid, dash=dash, width=width)


def _broken(t: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The samples with a NaN in every gap of t and in place of numbers that are not finite: no line joins across either."""
    y = np.where(np.isfinite(y), y, np.nan)
    if len(t) < 3:
        return t, y
    step = np.diff(t)
    gaps = np.flatnonzero(step > GAP * np.median(step)) + 1
    return np.insert(t, gaps, t[gaps]), np.insert(y, gaps, np.nan)


def _near(values: np.ndarray, own: np.ndarray) -> np.ndarray:
    """A simulation that ran away, held well outside the picture: coordinates of 1e300 are no use to a browser."""
    far = 50 * ((own.max() - own.min()) or 1.0)
    return np.clip(np.where(np.isfinite(values), values, np.nan), own.min() - far, own.max() + far)


def _limit(axes: Axes, own: np.ndarray, others: list[np.ndarray]) -> set[int]:
    """Set the range of y to that of `own` and as much of `others` as is not far beyond; returns which are cut off."""
    low, high = float(own.min()), float(own.max())
    span = (high - low) or 1.0
    floor, ceiling = low - BEYOND * span, high + BEYOND * span
    finite = np.concatenate([own, *others])
    finite = finite[np.isfinite(finite)]
    bottom, top = max(finite.min(), floor), min(finite.max(), ceiling)
    axes.set_ylim(bottom - 0.04 * (top - bottom or 1.0), top + 0.04 * (top - bottom or 1.0))
    return {i for i, y in enumerate(others) if not np.all(np.isnan(y) | ((y >= floor) & (y <= ceiling)))}


def _limit_errors(axes: Axes, own: np.ndarray, errors: list[np.ndarray]) -> set[int]:
    """Set the range of the errors, at most half the span of what is measured; returns which are cut off."""
    bound = 0.5 * (float(own.max() - own.min()) or 2.0)
    finite = np.abs(np.concatenate([[0.0], *errors]))
    top = min(float(finite[np.isfinite(finite)].max()) or bound, bound)
    axes.set_ylim(-1.05 * top, 1.05 * top)
    return {i for i, e in enumerate(errors) if not np.all(np.isnan(e) | (np.abs(e) <= bound))}


def _fit_axis(axes: Axes, curves: list[np.ndarray]) -> None:
    """FIT [%]: what is below zero is worse than a constant and is cut off."""
    values = np.concatenate(curves)
    values = values[np.isfinite(values)]
    low = max(0.0, float(values.min(initial=100.0)))
    margin = 0.08 * max(100.0 - low, 1.0)
    axes.set_ylim(max(low - margin, 0.0), 100.0)
    axes.set_ylabel("FIT [%]")


def _mark(axes: Axes, x: float, text: str) -> None:
    """A vertical line for the chosen value, its name beside it at the top."""
    axes.axvline(x, color=MUTED.light, linewidth=0.9, linestyle=(0, (4, 2)), gid="chosen")
    at = axes.get_xaxis_transform()
    axes.annotate(text, (x, 1), xytext=(4, -1), xycoords=at, textcoords="offset points", va="top")


def _log_ticks(axes: Axes, axis: str = "y") -> None:
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


def _legend(figure: Figure, handles: Sequence, names: list[str]) -> None:
    """One row of names above the panels, more when they are long."""
    widest = max(len(_short(name)) for name in names)
    columns = max(1, min(len(names), 100 // (widest + 6)))
    legend = figure.legend(handles, [f"name {i}" for i in range(len(names))], loc="outside upper left", ncols=columns)
    # set afterwards: matplotlib leaves names out that start with an underscore
    for text, name in zip(legend.get_texts(), names, strict=True):
        text.set_text(_short(name))


def _short(text: str, length: int = 32) -> str:
    text = printable(text)
    return text if len(text) <= length else text[: length - 1] + "\N{HORIZONTAL ELLIPSIS}"


def _label(channel: Channel) -> str:
    return _short(str(channel))


def _colour(i: int) -> Colour:
    return SERIES[i % len(SERIES)]


def _dash(i: int) -> str | tuple:
    """Lines differ by colour first; beyond the palette also by their dashes."""
    return _DASHES[i // len(SERIES) % len(_DASHES)]


def _curves(coefficient: Coefficient, N: int, name: str) -> dict[str, np.ndarray]:
    given = {kind: getattr(coefficient, kind) for kind in ("identified", "low", "high", "truth")}
    return {kind: _of_length(values, N, f"{name} {kind}") for kind, values in given.items() if values is not None}


def _sentence(names: list[str]) -> list[str]:
    return [", ".join(names[:-1]).capitalize(), names[-1]] if len(names) > 1 else [names[0].capitalize()]


def _of_length(values: np.ndarray, N: int, name: str) -> np.ndarray:
    array = np.asarray(values, float)
    if array.shape != (N,):
        raise RecordError(f"{name}: shape {array.shape}, expected ({N},)")
    return array
