"""Pictures of control designs: gains and margins over the schedule, Nyquist curves, closed-loop runs."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.ticker import MaxNLocator

import workbench.report.figures.canvas as canvas
from workbench.data import Channel
from workbench.records import RecordError, record
from workbench.report.blocks import Column, Data, Picture
from workbench.report.figures.canvas import Trace
from workbench.report.palette import INK, MEASURED, MUTED, SERIES

FAR = 3.0  # from the origin; Nyquist curves are cut off beyond


@record
class Followed:
    """A channel in one run of several laws: its samples (N,) by law, and its set-point (N,) where it has one."""

    channel: Channel
    setpoint: np.ndarray | None
    values: Mapping[str, np.ndarray]


def closed_loop(title: str, t: np.ndarray, channels: Sequence[Followed]) -> Picture:
    """The same run under several laws, a panel for each channel: set-point broad and pale, laws over it. t (N) [s]."""
    t = np.asarray(t, float)
    laws = list(dict.fromkeys(law for c in channels for law in c.values))
    if not laws or not len(t):
        raise RecordError(f"{title}: no runs to draw")
    columns = [Column("t", t, "s")]
    with canvas.style():
        heights = [1.6 if c.setpoint is not None else 0.95 for c in channels]
        figure = canvas.sheet(0.55 + sum(heights))
        panels = np.atleast_1d(figure.subplots(len(channels), 1, sharex=True, height_ratios=heights))
        drawn: dict[str, object] = {}
        for i, (axes, c) in enumerate(zip(panels, channels, strict=True)):
            if c.setpoint is not None:
                drawn["set-point"] = canvas.trace(axes, t, c.setpoint, MEASURED, f"set-point-{i}", width=2.6)
                columns.append(Column(f"{c.channel.name} set-point", c.setpoint, c.channel.unit))
            for law, values in c.values.items():
                j = laws.index(law)
                y = canvas.of_length(values, len(t), law)
                drawn[law] = canvas.trace(axes, t, y, canvas.colour(j), f"run-{i}-{j}", dash=canvas.dash(j))
                columns.append(Column(f"{c.channel.name} {law}", y, c.channel.unit))
            axes.set_ylabel(canvas.label(c.channel))
            axes.yaxis.set_major_locator(MaxNLocator(4))
        panels[-1].set_xlabel("t [s]")
        names = [name for name in ("set-point", *laws) if name in drawn]
        canvas.legend(figure, [drawn[name] for name in names], names)
        svg = canvas.render(figure)
    shown = ", ".join(c.channel.name for c in channels)
    return Picture(
        title, svg, f"{shown} from {t[0]:g} to {t[-1]:g} s under {', '.join(laws)}, without the noise of the sensors.",
        Data(title, tuple(columns)), f"Line charts of {shown} over time under {', '.join(laws)}",
    )  # fmt: skip


def over_schedule(title: str, rho: Trace, curves: Mapping[str, Mapping[str, np.ndarray]], caption: str = "") -> Picture:
    """Numbers over the schedule, a panel each: values (n,) by law by panel. A single value is a line from end to end."""
    laws = list(dict.fromkeys(law for own in curves.values() for law in own))
    x, columns = rho.values, [Column(rho.channel.name, rho.values, rho.channel.unit)]
    with canvas.style():
        figure, panels = canvas.panels(len(curves), canvas.label(rho.channel), sharey=False)
        handles: dict[str, object] = {}
        for i, (axes, (panel, own)) in enumerate(zip(panels, curves.items(), strict=True)):
            for law, values in own.items():
                y, j = np.broadcast_to(np.asarray(values, float), x.shape), laws.index(law)
                colour, dash = (MUTED, canvas.DASHES[1]) if law == "asked" else (canvas.colour(j), canvas.dash(j))
                handles[law] = canvas.line(axes, x, y, colour, f"curve-{i}-{j}", dash=dash, width=1.3)
                columns.append(Column(f"{panel} {law}", y))
            axes.set_title(canvas.short(panel))
            axes.yaxis.set_major_locator(MaxNLocator(4))
            axes.xaxis.set_major_locator(MaxNLocator(4))
        canvas.legend(figure, list(handles.values()), list(handles))
        svg = canvas.render(figure)
    return Picture(
        title, svg, caption or f"{', '.join(curves)} over {rho.channel.name}.", Data(title, tuple(columns)),
        f"Line charts over {rho.channel.name}: {', '.join(curves)}; {', '.join(laws)}",
    )  # fmt: skip


def nyquist(title: str, loops: Mapping[str, Mapping[str, np.ndarray]], sensitivity: float) -> Picture:
    """Nyquist curves L (N,) by name, a panel for each loop.

    The circle about -1 of radius 1 / sensitivity holds what a sensitivity below this bound leaves out.
    """
    columns, turn = [], np.linspace(0.0, 2.0 * np.pi, 100)
    bound, circle = f"sensitivity {sensitivity:g}", np.exp(1j * turn) / sensitivity - 1.0
    with canvas.style():
        figure, panels = canvas.panels(len(loops), "real part", sharey=True)
        handles: dict[str, object] = {}
        for i, (axes, (loop, curves)) in enumerate(zip(panels, loops.items(), strict=True)):
            handles[bound] = axes.plot(
                np.real(circle), np.imag(circle), color=MUTED.light, linestyle=canvas.DASHES[1], gid=f"bound-{i}"
            )[0]
            axes.plot([-1.0], [0.0], "+", color=INK.light, gid=f"critical-{i}")
            for j, (name, L) in enumerate(curves.items()):
                near = np.where(np.abs(L) <= FAR, L, np.nan)
                colour = SERIES[j % len(SERIES)].light
                handles[name] = axes.plot(np.real(near), np.imag(near), color=colour, linewidth=1.1, gid=f"nyquist-{i}-{j}")[0]
                columns += [Column(f"{loop} {name} real", np.real(L)), Column(f"{loop} {name} imaginary", np.imag(L))]
            axes.set_title(canvas.short(loop))
            axes.set_xlim(-2.0, 1.0)
            axes.set_ylim(-2.0, 1.0)
            axes.set_aspect("equal")
        figure.supylabel("imaginary part", color=MUTED.light, fontsize=8.5)
        canvas.legend(figure, list(handles.values()), list(handles))
        svg = canvas.render(figure)
    edge = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, len(columns[0].values))) / sensitivity - 1.0
    columns += [Column(f"{bound} real", np.real(edge)), Column(f"{bound} imaginary", np.imag(edge))]
    return Picture(
        title, svg,
        "One loop opened at the plant input, the others closed. No curve enters the circle about -1 while the sensitivity of "
        f"that loop is below {sensitivity:g}.",
        Data(title, tuple(columns)), f"Nyquist charts of {', '.join(loops)}",
    )  # fmt: skip
