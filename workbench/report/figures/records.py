"""Pictures of signals as they were measured or are to be played: over time, their spectra, and one over another."""

from collections.abc import Sequence

import numpy as np
from matplotlib.ticker import MaxNLocator

import workbench.report.figures.canvas as canvas
from workbench.records import RecordError
from workbench.report.blocks import Column, Data, Picture
from workbench.report.decimate import extremes
from workbench.report.figures.canvas import Trace

MOST = 20_000  # samples of a channel from which on a picture holds the extremes of short stretches in their place
STRETCHES = 3_000
DECADES = 6.0  # of a spectrum, below its peak


def signals(title: str, t: np.ndarray, traces: Sequence[Trace], caption: str) -> Picture:
    """Signals over the stamps t (N,) [s], a panel each; of long ones the lowest and the highest sample of each stretch."""
    if not traces:
        raise RecordError(f"{title}: no signals")
    t = np.asarray(t, float)
    for own in traces:
        canvas.of_length(own.values, len(t), str(own.channel))
    kept = _telling(t, traces)
    if len(kept) < len(t):
        caption = f"{caption} Of {len(t)} samples the lowest and the highest of {STRETCHES} stretches."
    with canvas.style():
        figure = canvas.sheet(0.6 + 1.2 * len(traces))
        every = figure.subplots(len(traces), 1, sharex=True, squeeze=False)[:, 0]
        for i, (axes, own) in enumerate(zip(every, traces, strict=True)):
            canvas.trace(axes, t[kept], own.values[kept], canvas.colour(i), f"signal-{i}", width=1.1)
            axes.set_ylabel(canvas.label(own.channel))
            axes.yaxis.set_major_locator(MaxNLocator(4))
        every[-1].set_xlabel("t [s]")
        svg = canvas.render(figure)
    names = ", ".join(own.channel.name for own in traces)
    columns = (Column("t", t[kept], "s"), *(Column(own.channel.name, own.values[kept], own.channel.unit) for own in traces))
    return Picture(title, svg, caption, Data(title, columns), f"Line charts of {names} over {t[-1] - t[0]:g} s")


def spectra(title: str, frequency: np.ndarray, densities: Sequence[Trace], caption: str) -> Picture:
    """Amplitude densities over frequency (m,) [Hz], a small panel for each channel, both axes logarithmic."""
    with canvas.style():
        figure, every = canvas.panels(len(densities), "frequency [Hz]", sharey=False)
        for i, (axes, own) in enumerate(zip(every, densities, strict=True)):
            peak = float(np.max(own.values, initial=0.0)) or 1.0
            canvas.line(axes, frequency, np.maximum(own.values, peak * 10.0**-DECADES), canvas.colour(i), f"spectrum-{i}")
            axes.set_xscale("log")
            axes.set_yscale("log")
            canvas.log_ticks(axes)
            canvas.log_ticks(axes, "x")
            axes.set_title(canvas.label(own.channel), fontsize=8.5)
        svg = canvas.render(figure)
    columns = (Column("frequency", frequency, "Hz"), *(Column(d.channel.name, d.values, d.channel.unit) for d in densities))
    names = ", ".join(own.channel.name for own in densities)
    return Picture(title, svg, caption, Data(title, columns), f"Spectra of {names} up to {frequency[-1]:g} Hz")


def visited(title: str, over: Trace, traces: Sequence[Trace], caption: str) -> Picture:
    """Where the signals were over another one, a small panel of dots for each."""
    with canvas.style():
        figure, every = canvas.panels(len(traces), canvas.label(over.channel), sharey=False)
        for i, (axes, own) in enumerate(zip(every, traces, strict=True)):
            canvas.dots(axes, over.values, own.values, canvas.colour(i), f"dots-{i}", size=1.5)
            axes.set_title(canvas.label(own.channel), fontsize=8.5)
        svg = canvas.render(figure)
    step = -(-len(over.values) // MOST)
    columns = tuple(Column(own.channel.name, own.values[::step], own.channel.unit) for own in (over, *traces))
    names = ", ".join(own.channel.name for own in traces)
    return Picture(title, svg, caption, Data(title, columns), f"Dots of {names} over {over.channel.name}")


def _telling(t: np.ndarray, traces: Sequence[Trace]) -> np.ndarray:
    """Indices of the samples that a picture needs."""
    if len(t) <= MOST:
        return np.arange(len(t))
    return np.unique(np.concatenate([extremes(t, own.values, STRETCHES) for own in traces]))
