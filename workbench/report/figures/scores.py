"""Pictures of scores: models against records."""

import math
from collections.abc import Iterable, Mapping

import numpy as np

import workbench.report.figures.canvas as canvas
from workbench.metrics import Horizon, Score, horizon_name
from workbench.records import RecordError
from workbench.report.blocks import Column, Data, Picture
from workbench.report.palette import MUTED


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
    with canvas.style():
        figure = canvas.sheet(0.9 + 0.42 * len(rows))
        axes = figure.subplots()
        left = _left_edge(np.concatenate(list(curves.values())), any(_lost(fits) for fits in rows.values()))
        step = min(0.2, 0.7 / len(models))
        handles = [
            axes.plot(
                np.where(fits >= 0, fits, np.nan),
                np.arange(len(rows)) + step * (i - (len(models) - 1) / 2),
                "osD^vP"[i % 6],
                color=canvas.colour(i).light,
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
        axes.set_yticks(range(len(rows)), [f"{canvas.short(name)} ({split})" for name, split in rows])
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.set_xlabel(f"FIT, {said} [%]")
        boundary = sum(split == "held-out" for _, split in rows)
        if 0 < boundary < len(rows):
            axes.axhline(boundary - 0.5, color=MUTED.light, linewidth=0.6)
        canvas.legend(figure, handles, models)
        svg = canvas.render(figure)
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
    return [f"{canvas.short(model)} {_lost_score(fit)}" for model, fit in fits.items() if not (math.isfinite(fit) and fit >= 0)]


def _lost_score(fit: float) -> str:
    if math.isnan(fit):
        return "no FIT"
    return f"{fit:.0f}".replace("-", "\N{MINUS SIGN}") if fit > -1000 else "below \N{MINUS SIGN}1000"


def _left_edge(fits: np.ndarray, lost: bool) -> float:
    """Where the axis of FIT begins: at a round number below the lowest, at zero where some are below zero."""
    return 0.0 if lost else max(0.0, 10 * math.floor(np.nanmin(fits) / 10 - 0.5))
