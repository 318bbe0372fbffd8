"""Pictures of what is proved and what was reached."""

from collections.abc import Mapping

import numpy as np

import workbench.report.figures.canvas as canvas
from workbench.data import Channel
from workbench.report.blocks import Column, Data, Picture
from workbench.report.palette import INK, MUTED


def guaranteed(
    title: str,
    t: np.ndarray,
    channel: Channel,
    nominal: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    runs: Mapping[str, np.ndarray],
    limits: Mapping[str, np.ndarray],
    caption: str = "",
) -> Picture:
    """A signal over time: the run in the middle of the boxes, the band that holds every run, runs that come far, and limits.

    t (N) [s]; every curve (N) in the unit of the channel; infinite limits are not drawn.
    """
    with canvas.style():
        figure = canvas.sheet(3.0)
        axes = figure.subplots()
        handles: list = []
        names: list[str] = []

        def add(handle, name: str) -> None:
            handles.append(handle)
            names.append(name)

        near = np.concatenate([nominal, *runs.values(), *(v[np.isfinite(v)] for v in limits.values())])
        reach = 2.0 * np.ptp(near) + 1e-12
        inside = [np.clip(v, near.min() - reach, near.max() + reach) for v in (low, high)]
        add(canvas.band_along(axes, t, inside[0], inside[1], canvas.colour(0), "band"), "every run")
        for i, (name, values) in enumerate(runs.items(), 1):
            add(canvas.trace(axes, t, values, canvas.colour(i), f"run-{i}", dash=canvas.dash(i)), name)
        add(canvas.trace(axes, t, nominal, INK, "nominal"), "middle of the boxes")
        for i, (name, values) in enumerate(limits.items()):
            drawn = np.where(np.isfinite(values), values, np.nan)
            if np.isfinite(drawn).any():
                add(canvas.trace(axes, t, drawn, MUTED, f"limit-{i}", dash=canvas.DASHES[1]), name)
        axes.set_ylabel(canvas.label(channel))
        axes.set_xlabel("t [s]")
        canvas.legend(figure, handles, names)
        svg = canvas.render(figure)
    unit = channel.unit
    columns = {"middle of the boxes": nominal, "lowest": low, "highest": high, **runs, **limits}
    data = Data(title, (Column("t", t, "s"), *(Column(name, values, unit) for name, values in columns.items())))
    alt = f"{channel} over time within the band that holds every run, with {', '.join(runs) or 'no further run'}."
    return Picture(title, svg, caption, data, alt)


def beside_limits(
    title: str, t: np.ndarray, channel: Channel, runs: Mapping[str, np.ndarray], limits: Mapping[str, np.ndarray], caption: str
) -> Picture:
    """Runs of a signal over time and its limits; a limit that is far from every run is named below instead of drawn.

    t (N) [s]; every curve (N) in the unit of the channel, NaN where there is none.
    """
    with canvas.style():
        figure = canvas.sheet(3.0)
        axes = figure.subplots()
        own = np.concatenate(list(runs.values()))
        far = canvas.limit(axes, own[np.isfinite(own)], list(limits.values()))
        drawn = {name: values for i, (name, values) in enumerate(limits.items()) if i not in far}
        handles = [
            canvas.trace(axes, t, v, canvas.colour(i), f"run-{i}", dash=canvas.dash(i)) for i, v in enumerate(runs.values())
        ]
        handles += [canvas.trace(axes, t, v, MUTED, f"limit-{i}", dash=canvas.DASHES[1]) for i, v in enumerate(drawn.values())]
        axes.set_ylabel(canvas.label(channel))
        axes.set_xlabel("t [s]")
        canvas.legend(figure, handles, [*runs, *drawn])
        svg = canvas.render(figure)
    unit = channel.unit
    off = [f"{name} {np.nanmin(v):.4g} {unit}".rstrip() for name, v in limits.items() if name not in drawn]
    said = caption + (f" Far from every run: {', '.join(off)}." if off else "")
    data = Data(title, (Column("t", t, "s"), *(Column(name, values, unit) for name, values in {**runs, **limits}.items())))
    return Picture(title, svg, said, data, f"{channel} over time: {', '.join(runs)}; limits: {', '.join(limits) or 'none'}.")
