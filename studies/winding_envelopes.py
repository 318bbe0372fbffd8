"""Interval models of the web winding machine by radius, beside the LPV models on the same records.

Accuracy of the middle, width and coverage of the envelope, time to identify.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace

from workbench.answers.envelopes import (
    described_modes,
    envelope_pictures,
    envelope_table,
    mode_pictures,
    mode_tables,
    width_picture,
)
from workbench.data import Dataset, Experiment
from workbench.intervals.bounded import bounded, cover_bounded
from workbench.intervals.coverage import Coverage, cover, pooled
from workbench.intervals.model import IntervalModel
from workbench.intervals.output_error import OutputErrorRegression
from workbench.intervals.regression import BySchedule, IntervalRegression, OneMode
from workbench.intervals.regressors import ARX
from workbench.intervals.semantics import InclusionExact
from workbench.lpv import LPVModel
from workbench.records import record
from workbench.report.blocks import Block, Section, Table, Text

INTERVALS = 5  # of the radius
ORDER = 2


@record
class Envelopes:
    """Interval models by name, every line of coverage (theirs and of the LPV models plus bound), and seconds to identify."""

    models: dict[str, IntervalModel]
    lines: tuple[Coverage, ...]
    seconds: dict[str, float]

    def of(self, model: str) -> tuple[Coverage, ...]:
        return tuple(line for line in self.lines if line.model == model)


def methods(quick: bool) -> dict[str, IntervalRegression | OutputErrorRegression]:
    """The record as it was measured, with one box and with one for each interval of the radius; the true machine; simulation."""
    by_radius = IntervalRegression(ARX(ORDER), InclusionExact(), BySchedule(INTERVALS), 0.0, 0.0)
    simulation = OutputErrorRegression(ARX(ORDER), output_error=0.0)
    if quick:
        return {"interval by r2": by_radius, "interval, simulation": simulation}
    return {
        "interval": replace(by_radius, partition=OneMode()),
        "interval by r2": by_radius,
        "interval by r2, true values": IntervalRegression(ARX(ORDER), partition=BySchedule(INTERVALS)),
        "interval, simulation": simulation,
    }


def identify_envelopes(
    estimation: Dataset,
    held_out: Dataset,
    lpv: Mapping[str, LPVModel],
    output: str,
    progress: Callable[[str], None],
    *,
    quick: bool = False,
) -> Envelopes:
    """Every interval model, and what its envelopes and the bands around the LPV models hold of all records."""
    models, seconds, lines = {}, {}, []
    for name, method in methods(quick).items():
        progress(f"{name}: identifying")
        begin = time.perf_counter()
        models[name] = replace(method, name=name).fit(estimation, output)
        seconds[name] = time.perf_counter() - begin
        lines += [*cover(models[name], estimation, "estimation", free_run=False), *cover(models[name], held_out, "held-out")]
    for model in lpv.values():
        known = bounded(model, estimation, output)
        lines += [*cover_bounded(known, estimation, "estimation"), *cover_bounded(known, held_out, "held-out")]
    return Envelopes(models, tuple(lines), seconds)


def envelope_section(envelopes: Envelopes, shown: Experiment, seconds: Mapping[str, float]) -> Section:
    """Widths against coverage, the envelopes of one held-out record, the modes, and the lines behind them."""
    by_radius = envelopes.models["interval by r2"]
    held = [line for line in envelopes.lines if line.split == "held-out"]
    pictures: list[Block] = [width_picture("One step ahead: what the envelopes hold and how wide they are", held, "one-step")]
    pictures += envelope_pictures(by_radius, shown)[:1] + envelope_pictures(envelopes.models["interval, simulation"], shown)
    pictures += mode_pictures(by_radius, (shown,))
    said = "\n\n".join(line for model in envelopes.models.values() for line in described_modes(model)[:2])
    return Section(
        "Guaranteed envelopes",
        (Text(said), *pictures, _table(envelopes, seconds), *mode_tables(by_radius), envelope_table(envelopes.lines)),
    )


def _table(envelopes: Envelopes, seconds: Mapping[str, float]) -> Table:
    """A row for each model: accuracy of its middle, width and coverage of its envelope on held-out records, cost."""
    rows = []
    cost = {f"{name} + bound": value for name, value in seconds.items()} | envelopes.seconds
    for name in dict.fromkeys(line.model for line in envelopes.lines):
        held = [line for line in envelopes.of(name) if line.split == "held-out"]
        cells: list[float] = []
        for horizon in ("one-step", "free-run"):
            own = [line for line in held if line.horizon == horizon]
            cells += [
                min((line.nominal.FIT for line in own), default=float("nan")),
                pooled(own, lambda line: line.mean_radius),
                100.0 * pooled(own, lambda line: line.coverage),
            ]
        rows.append((name, *cells, cost[name]))
    said = ("lowest FIT [%]", "mean radius", "inside [%]")
    header = ("model", *(f"{horizon}: {what}" for horizon in ("one step", "free run") for what in said))
    return Table(
        "Envelopes on held-out records",
        (*header, "time to identify [s]"),
        tuple(rows),
        caption="An LPV model plus bound is a band of constant width around it, as wide as its largest error on the estimation "
        "records; it promises nothing. An interval model holds every estimation sample by construction; 'true values' also for "
        "every regressor that the noise allows, which is what a guarantee about the machine needs. The simulation box promises "
        "free runs only.",
        digits=3,
    )
