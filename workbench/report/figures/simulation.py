"""Pictures of simulations: what was measured and what models make of the same inputs."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

import workbench.report.figures.canvas as canvas
from workbench.data import Channel
from workbench.report.figures.canvas import Trace
from workbench.report.page import Column, Data, Picture
from workbench.report.palette import INK, MEASURED, MUTED


def measured_and_simulated(
    name: str, t: np.ndarray, measured: Trace, simulated: Mapping[str, np.ndarray], schedule: Trace | None = None
) -> Picture:
    """Measured and simulated output of a record above, the error (measured - simulated) below, the schedule at the bottom.

    t (N) [s]; simulated: samples (N) by model. Lines break at gaps of t and at samples that are not finite.
    """
    t = np.asarray(t, float)
    traces = {model: canvas.of_length(values, len(t), model) for model, values in simulated.items()}
    canvas.of_length(measured.values, len(t), str(measured.channel))
    channel, y = measured.channel, measured.values
    heights = [2.3, 1.25] + [0.8] * (schedule is not None)
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
        if schedule:
            canvas.trace(bottom[0], t, schedule.values, MUTED, "schedule", width=1.1)
            bottom[0].set_ylabel(canvas.label(schedule.channel))
        figure.axes[-1].set_xlabel("t [s]")
        canvas.legend(figure, handles, ["measured", *traces])
        svg = canvas.render(figure)
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


def _limit_errors(axes: Axes, own: np.ndarray, errors: list[np.ndarray]) -> set[int]:
    """Set the range of the errors, at most half the span of what is measured; returns which are cut off."""
    bound = 0.5 * (float(own.max() - own.min()) or 2.0)
    finite = np.abs(np.concatenate([[0.0], *errors]))
    top = min(float(finite[np.isfinite(finite)].max()) or bound, bound)
    axes.set_ylim(-1.05 * top, 1.05 * top)
    return {i for i, e in enumerate(errors) if not np.all(np.isnan(e) | (np.abs(e) <= bound))}
