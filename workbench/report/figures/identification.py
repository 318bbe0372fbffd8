"""Pictures of an identification: how order and sparsity were chosen."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

import workbench.report.figures.canvas as canvas
from workbench.report.blocks import Column, Data, Picture
from workbench.report.palette import INK, MUTED, PAPER, SERIES


def singular_values(values: np.ndarray, order: int) -> Picture:
    """Singular values on a logarithmic axis, the chosen order marked: what lies right of the line is left out."""
    values = np.asarray(values, float)
    index = np.arange(1, len(values) + 1)
    shown = values > 0
    with canvas.style():
        figure = canvas.sheet(2.6)
        axes = figure.subplots()
        axes.set_yscale("log")
        for keep, face in ((index <= order, SERIES[0]), (index > order, PAPER)):
            k = keep & shown
            axes.plot(index[k], values[k], "o", color=SERIES[0].light, markerfacecolor=face.light, markersize=5)
        canvas.mark(axes, order + 0.5, f"order {order}")
        canvas.log_ticks(axes)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("index")
        axes.set_ylabel("singular value")
        svg = canvas.render(figure)
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
    curves = {name: canvas.of_length(values, len(orders), name) for name, values in fit.items()}
    with canvas.style():
        figure = canvas.sheet(2.6)
        axes = figure.subplots()
        handles = [
            canvas.line(axes, index, values, canvas.colour(i), f"fit-{i}", dash=canvas.dash(i), marker="o")
            for i, values in enumerate(curves.values())
        ]
        canvas.mark(axes, chosen, f"order {chosen}")
        _fit_axis(axes, list(curves.values()))
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("model order")
        canvas.legend(figure, handles, list(curves))
        svg = canvas.render(figure)
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
        canvas.of_length(v, len(mu), name)
        for v, name in ((support, "support"), (fit_estimation, "estimation"), (fit_held_out, "held-out"))
    )
    with canvas.style():
        figure = canvas.sheet(3.6)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.6, 1])
        handles = [
            canvas.line(above, mu, held_out, SERIES[0], "held-out", marker="o"),
            canvas.line(above, mu, estimation, MUTED, "estimation", dash=canvas.DASHES[1]),
        ]
        canvas.line(below, mu, support, INK, "support", marker="o")
        if mu.min() > 0 and mu.max() > 20 * mu.min():
            above.set_xscale("log")
            canvas.log_ticks(below, axis="x")
        canvas.mark(above, chosen, f"\N{GREEK SMALL LETTER MU} = {chosen:.4g}")
        canvas.mark(below, chosen, "")
        _fit_axis(above, [held_out, estimation])
        below.set_ylim(bottom=0)
        below.yaxis.set_major_locator(MaxNLocator(4, integer=True))
        below.set_ylabel("coefficients kept")
        below.set_xlabel("bound \N{GREEK SMALL LETTER MU}")
        canvas.legend(figure, handles, ["held-out", "estimation"])
        svg = canvas.render(figure)
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


def _fit_axis(axes: Axes, curves: list[np.ndarray]) -> None:
    """FIT [%]: what is below zero is worse than a constant and is cut off."""
    values = np.concatenate(curves)
    values = values[np.isfinite(values)]
    low = max(0.0, float(values.min(initial=100.0)))
    margin = 0.08 * max(100.0 - low, 1.0)
    axes.set_ylim(max(low - margin, 0.0), 100.0)
    axes.set_ylabel("FIT [%]")
