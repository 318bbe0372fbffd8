"""Pictures of what a schedule does to a model: its coefficients and its frozen responses."""

from collections.abc import Mapping

import numpy as np
from matplotlib.ticker import MaxNLocator

import workbench.report.figures.canvas as canvas
from workbench.data import Channel
from workbench.records import RecordError, record
from workbench.report.blocks import Column, Data, Picture
from workbench.report.figures.canvas import Trace
from workbench.report.palette import INK, MUTED, SERIES
from workbench.report.svg import printable


@record
class Coefficient:
    """One scheduled coefficient f_i over the schedule: as identified, the band the data allow, and the truth where known."""

    identified: np.ndarray
    low: np.ndarray | None = None
    high: np.ndarray | None = None
    truth: np.ndarray | None = None


def coefficient_functions(rho: Trace, coefficients: Mapping[str, Coefficient]) -> Picture:
    """Every scheduled coefficient over the schedule in its own small panel: identified, feasible band and truth."""
    curves = {name: _curves(c, len(rho.values), name) for name, c in coefficients.items()}
    with canvas.style():
        figure, panels = canvas.panels(len(curves), canvas.label(rho.channel), sharey=False)
        handles: dict[str, object] = {}
        for i, (axes, (name, curve)) in enumerate(zip(panels, curves.items(), strict=True)):
            if "low" in curve and "high" in curve:
                handles["feasible band"] = axes.fill_between(
                    rho.values, curve["low"], curve["high"], color=SERIES[0].light, alpha=0.2, linewidth=0
                )
            if "truth" in curve:
                handles["truth"] = canvas.line(axes, rho.values, curve["truth"], INK, f"truth-{i}", dash=canvas.DASHES[1])
            handles["identified"] = canvas.line(axes, rho.values, curve["identified"], SERIES[0], f"identified-{i}", width=1.4)
            axes.set_title(canvas.short(name))
            axes.yaxis.set_major_locator(MaxNLocator(4))
            axes.xaxis.set_major_locator(MaxNLocator(4))
        names = [name for name in ("identified", "feasible band", "truth") if name in handles]
        canvas.legend(figure, [handles[name] for name in names], names)
        svg = canvas.render(figure)
    columns = [Column(f"{name} {kind}", values) for name, curve in curves.items() for kind, values in curve.items()]
    return Picture(
        f"Coefficients over {rho.channel.name}",
        svg,
        f"{' and '.join(_sentence(names))} of every coefficient over {rho.channel.name}.",
        Data("coefficient functions", (Column(rho.channel.name, rho.values, rho.channel.unit), *columns)),
        f"Small line charts of {len(curves)} coefficients over {rho.channel.name}: {', '.join(names)}",
    )


def frozen_responses(
    omega: np.ndarray, rho: Trace, magnitude: Mapping[str, np.ndarray], title: str, *, drawn: int = 9
) -> Picture:  # fmt: skip
    """Frozen magnitude responses [dB] over frequency [rad/s], a panel for each value of the schedule, `drawn` of them at most.

    magnitude: (number of schedule values, number of frequencies) by name; the first is drawn in ink, as the reference.
    """
    x = Trace(Channel("omega", "rad/s"), np.asarray(omega, float))
    return _family(x, "\N{GREEK SMALL LETTER OMEGA} [rad/s]", rho, magnitude, ("magnitude", "dB"), title, drawn)


def frozen_steps(t: np.ndarray, rho: Trace, responses: Mapping[str, np.ndarray], title: str, *, drawn: int = 3) -> Picture:
    """Responses (number of schedule values, N) over time t (N) [s] with the schedule frozen, at most `drawn` panels of them."""
    return _family(Trace(Channel("t", "s"), np.asarray(t, float)), "t [s]", rho, responses, ("response", ""), title, drawn)


def _family(
    x: Trace, xlabel: str, rho: Trace, curves: Mapping[str, np.ndarray], of: tuple[str, str], title: str, drawn: int
) -> Picture:  # fmt: skip
    """Curves (R, K) over x (K) at R schedule values; the numbers behind it are of all, of what is drawn there may be fewer."""
    shape, (what, unit) = (len(rho.values), len(x.values)), of
    for name, values in curves.items():
        if np.shape(values) != shape:
            raise RecordError(f"{title}, {name}: shape {np.shape(values)}, expected {shape}")
    colours = [INK, *(canvas.colour(j) for j in range(len(curves) - 1))]
    chosen = np.unique(np.linspace(0, shape[0] - 1, min(drawn, shape[0])).round().astype(int))
    with canvas.style():
        figure, panels = canvas.panels(len(chosen), xlabel, sharey=True)
        handles = []
        for axes, i in zip(panels, chosen.tolist(), strict=True):
            handles = [
                canvas.line(
                    axes, x.values, np.asarray(values)[i], colour, f"frozen-{i}-{j}", dash=canvas.DASHES[min(j, 1)], width=1.3
                )
                for j, (values, colour) in enumerate(zip(curves.values(), colours, strict=True))
            ]
            axes.set_title(f"{canvas.short(rho.channel.name)} = {rho.values[i]:.4g} {printable(rho.channel.unit)}".rstrip())
            if x.channel.unit == "rad/s":
                axes.set_xscale("log")
                canvas.log_ticks(axes, axis="x")
        figure.supylabel(f"{what} [{unit}]" if unit else what, color=MUTED.light, fontsize=8.5)
        canvas.legend(figure, handles, list(curves))
        svg = canvas.render(figure)
    R, K = shape
    columns = [Column(x.channel.name, np.tile(x.values, R), x.channel.unit)]
    columns += [Column(rho.channel.name, np.repeat(rho.values, K), rho.channel.unit)]
    columns += [Column(name, np.ravel(values), unit) for name, values in curves.items()]
    names, some = ", ".join(curves), f", {len(chosen)} of them drawn" * (len(chosen) < R)
    return Picture(
        title,
        svg,
        f"{what.capitalize()} with {rho.channel.name} frozen at {R} values{some}: {names}. Explore turns {rho.channel.name}.",
        Data(title, tuple(columns)),
        f"Charts of the {what} at {len(chosen)} frozen values of {rho.channel.name}: {names}",
    )


def _curves(coefficient: Coefficient, N: int, name: str) -> dict[str, np.ndarray]:
    given = {kind: getattr(coefficient, kind) for kind in ("identified", "low", "high", "truth")}
    return {kind: canvas.of_length(values, N, f"{name} {kind}") for kind, values in given.items() if values is not None}


def _sentence(names: list[str]) -> list[str]:
    return [", ".join(names[:-1]).capitalize(), names[-1]] if len(names) > 1 else [names[0].capitalize()]
