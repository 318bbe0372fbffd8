"""Pictures of simulations: what was measured and what models make of the same inputs."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

import workbench.report.figures.canvas as canvas
from workbench.data import Channel
from workbench.errors import InputError
from workbench.report.blocks import Column, Data, Picture
from workbench.report.figures.canvas import Trace
from workbench.report.palette import INK, MEASURED, MUTED

#: A response this many times larger than the usual one is cut off.
_FAR = 5.0


def measured_and_simulated(
    name: str, t: np.ndarray, measured: Trace, simulated: Mapping[str, np.ndarray], schedules: Sequence[Trace] = ()
) -> Picture:
    """Measured and simulated output of a record above, the error (measured - simulated) below, the schedules at the bottom.

    t (N) [s]; simulated: samples (N) by model. Lines break at gaps of t and at samples that are not finite.
    """
    t = np.asarray(t, float)
    traces = {model: canvas.of_length(values, len(t), model) for model, values in simulated.items()}
    canvas.of_length(measured.values, len(t), str(measured.channel))
    channel, y = measured.channel, measured.values
    heights = [2.3, 1.25] + [0.8] * len(schedules)
    with canvas.style():
        figure = canvas.sheet(0.55 + sum(heights))
        above, below, *bottom = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
        handles = [canvas.trace(above, t, y, MEASURED, "measured", width=2.6)]  # broad and pale: models are drawn over it
        for i, values in enumerate(traces.values()):
            handles.append(
                canvas.trace(above, t, canvas.near(values, y), canvas.colour(i), f"simulated-{i}", dash=canvas.dash(i))
            )
            canvas.trace(below, t, y - canvas.near(values, y), canvas.colour(i), f"error-{i}", dash=canvas.dash(i))
        away = canvas.limit(above, y, list(traces.values())) | _limit_errors(below, y, [y - v for v in traces.values()])
        below.axhline(0, color=INK.light, linewidth=0.6)
        above.set_ylabel(canvas.label(channel))
        below.set_ylabel(canvas.label(Channel("error", channel.unit)))
        for i, (axes, schedule) in enumerate(zip(bottom, schedules, strict=True)):
            canvas.trace(axes, t, schedule.values, MUTED, f"schedule-{i}" if i else "schedule", width=1.1)
            axes.set_ylabel(canvas.label(schedule.channel))
        figure.axes[-1].set_xlabel("t [s]")
        canvas.legend(figure, handles, ["measured", *traces])
        svg = canvas.render(figure)
    cut = [model for i, model in enumerate(traces) if i in away]
    columns = [Column("t", t, "s"), Column(f"{channel.name} measured", y, channel.unit)]
    columns += [Column(f"{channel.name} {model}", values, channel.unit) for model, values in traces.items()]
    columns += [Column(own.channel.name, own.values, own.channel.unit) for own in schedules]
    scheduled = ", ".join(own.channel.name for own in schedules)
    return Picture(
        f"{channel.name}, record {name}",
        svg,
        f"Record {name}: {channel.name} measured and simulated; below it the error, measured minus simulated"
        + (f"; at the bottom the schedule {scheduled}." if schedules else ".")
        + (f" Off the picture in part: {', '.join(cut)}." if cut else ""),
        Data(f"{channel.name} {name}", tuple(columns)),
        f"Line chart over {t[-1] - t[0]:g} s: measured {channel.name} and {', '.join(traces) or 'no model'}, errors below",
    )


def responses(title: str, t: np.ndarray, curves: Mapping[str, np.ndarray], unit: str = "") -> Picture:
    """Several responses to the same input in one panel, each named at its end; in a legend where the names would collide.

    t (N) [s]; curves: samples (N) [unit] by name. A response many times larger than the others is cut off, and named.
    """
    t = np.asarray(t, float)
    traces = {name: canvas.of_length(values, len(t), name) for name, values in curves.items()}
    if not traces or not len(t):
        raise InputError(f"{title}: no responses to draw", mend="give at least one curve over at least one sample")
    top, cut = _reach(traces)
    with canvas.style():
        figure = canvas.sheet(3.0)
        axes = figure.subplots()
        handles = [
            canvas.trace(axes, t, np.clip(v, -9 * top, 9 * top), canvas.colour(i), f"curve-{i}", dash=canvas.dash(i), width=1.3)
            for i, v in enumerate(traces.values())
        ]
        drawn = np.concatenate([v[np.isfinite(v) & (np.abs(v) <= top)] for v in traces.values()])
        low, high = float(drawn.min(initial=0.0)), float(drawn.max(initial=0.0))
        axes.set_ylim(low - 0.05 * (high - low or 1.0), high + 0.05 * (high - low or 1.0))
        axes.set_ylabel(canvas.label(Channel("response", unit)))
        axes.set_xlabel("t [s]")
        if not _named_at_ends(axes, t, traces):
            canvas.legend(figure, handles, list(traces))
        svg = canvas.render(figure)
    return Picture(
        title,
        svg,
        f"Responses to the same input: {', '.join(traces)}." + (f" Off the picture in part: {', '.join(cut)}." if cut else ""),
        Data(title, (Column("t", t, "s"), *(Column(name, values, unit) for name, values in traces.items()))),
        f"Line chart of {len(traces)} responses over {t[-1] - t[0]:g} s: {', '.join(traces)}",
    )


def _reach(traces: Mapping[str, np.ndarray]) -> tuple[float, list[str]]:
    """The size of a response that still has its place in the picture, and the names of those that go beyond."""
    peaks = {name: float(np.max(np.abs(v[np.isfinite(v)]), initial=0.0)) for name, v in traces.items()}
    usual = float(np.median([peak for peak in peaks.values() if peak > 0] or [1.0]))
    top = _FAR * usual
    return top, [name for name, v in traces.items() if peaks[name] > top or np.any(np.isinf(v))]


def _named_at_ends(axes: Axes, t: np.ndarray, traces: Mapping[str, np.ndarray]) -> bool:
    """Write the names to the right of the last samples if each has a line of text for itself; whether that was done."""
    ends = np.array([values[-1] for values in traces.values()])
    (low, high), lines = axes.get_ylim(), 15  # lines of text that fit one above the other
    apart = np.diff(np.sort(ends)) >= (high - low) / lines
    if not (np.all((ends >= low) & (ends <= high)) and np.all(apart)):
        return False
    for name, end in zip(traces, ends, strict=True):
        axes.annotate(canvas.short(name, 20), (t[-1], end), xytext=(5, 0), textcoords="offset points", va="center", fontsize=8)
    return True


def _limit_errors(axes: Axes, own: np.ndarray, errors: list[np.ndarray]) -> set[int]:
    """Set the range of the errors, at most half the span of what is measured; returns which are cut off."""
    bound = 0.5 * (float(own.max() - own.min()) or 2.0)
    finite = np.abs(np.concatenate([[0.0], *errors]))
    top = min(float(finite[np.isfinite(finite)].max()) or bound, bound)
    axes.set_ylim(-1.05 * top, 1.05 * top)
    return {i for i, e in enumerate(errors) if not np.all(np.isnan(e) | (np.abs(e) <= bound))}
