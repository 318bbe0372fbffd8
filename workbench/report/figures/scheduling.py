"""Pictures of what a schedule does to a model: its coefficients and its frozen responses."""

from collections.abc import Mapping

import numpy as np
from matplotlib.ticker import MaxNLocator

import workbench.report.figures.canvas as canvas
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


def frozen_responses(omega: np.ndarray, rho: Trace, magnitude: Mapping[str, np.ndarray], title: str) -> Picture:
    """Frozen magnitude responses [dB] over frequency [rad/s], one panel for each value of the schedule.

    magnitude: (number of schedule values, number of frequencies) by name; the first is drawn in ink, as the reference.
    """
    omega = np.asarray(omega, float)
    shape = (len(rho.values), len(omega))
    for name, values in magnitude.items():
        if np.shape(values) != shape:
            raise RecordError(f"frozen_responses, {name}: shape {np.shape(values)}, expected {shape}")
    colours = [INK, *(canvas.colour(j) for j in range(len(magnitude) - 1))]
    with canvas.style():
        figure, panels = canvas.panels(shape[0], "\N{GREEK SMALL LETTER OMEGA} [rad/s]", sharey=True)
        handles = []
        for i, (axes, at) in enumerate(zip(panels, rho.values, strict=True)):
            handles = [
                canvas.line(
                    axes, omega, np.asarray(values)[i], colour, f"frozen-{i}-{j}", dash=canvas.DASHES[min(j, 1)], width=1.3
                )
                for j, (values, colour) in enumerate(zip(magnitude.values(), colours, strict=True))
            ]
            axes.set_xscale("log")
            axes.set_title(f"{canvas.short(rho.channel.name)} = {at:.4g} {printable(rho.channel.unit)}".rstrip())
            canvas.log_ticks(axes, axis="x")
        figure.supylabel("magnitude [dB]", color=MUTED.light, fontsize=8.5)
        canvas.legend(figure, handles, list(magnitude))
        svg = canvas.render(figure)
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


def _curves(coefficient: Coefficient, N: int, name: str) -> dict[str, np.ndarray]:
    given = {kind: getattr(coefficient, kind) for kind in ("identified", "low", "high", "truth")}
    return {kind: canvas.of_length(values, N, f"{name} {kind}") for kind, values in given.items() if values is not None}


def _sentence(names: list[str]) -> list[str]:
    return [", ".join(names[:-1]).capitalize(), names[-1]] if len(names) > 1 else [names[0].capitalize()]
