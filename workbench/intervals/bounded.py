"""An LPV model plus a bound on its error: the plain alternative to an interval model, judged by the same lines.

|y(k) - y_model(k)| <= max over the estimation records of |y - y_model|,  one step ahead and in a free run
"""

from collections.abc import Iterable

import numpy as np

from workbench.data import Dataset, Experiment
from workbench.intervals.coverage import Coverage
from workbench.lpv import LPVModel
from workbench.metrics import Horizon, Score, Split, fit, rm, rmse
from workbench.records import field, record

HORIZONS: tuple[Horizon, ...] = ("one-step", "free-run")


@record
class Bounded:
    """A model with the largest error of one output that it made on the estimation records; unit_range: of that output."""

    model: LPVModel
    output: str
    one_step: float = field("", low=0.0)
    free_run: float = field("", low=0.0)
    unit_range: float = field("", low=0.0)

    @property
    def name(self) -> str:
        return f"{self.model.name} + bound"


def bounded(model: LPVModel, estimation: Dataset, output: str) -> Bounded:
    """The bounds of the module, on the rows after the predictor's warm-up."""
    largest = {h: max(float(np.abs(np.subtract(*_run(model, e, output, h))).max()) for e in estimation) for h in HORIZONS}
    values = np.concatenate([e[output] for e in estimation])
    return Bounded(model, output, largest["one-step"], largest["free-run"], float(np.ptp(values)))


def cover_bounded(known: Bounded, records: Iterable[Experiment], split: Split) -> tuple[Coverage, ...]:
    """What the constant band around the model holds of every record, one step ahead and in a free run."""
    lines = []
    for e in records:
        unit = e.channel(known.output).unit
        for horizon in HORIZONS:
            y, ys = _run(known.model, e, known.output, horizon)
            radius = known.one_step if horizon == "one-step" else known.free_run
            nominal = Score(known.name, e.name, split, known.output, horizon, fit(y, ys), rm(y, ys), rmse(y, ys), unit)
            inside = float(np.mean(np.abs(y - ys) <= radius))
            lines.append(
                Coverage(
                    known.name, e.name, split, known.output, horizon, len(y), inside, radius, radius / known.unit_range, 1.0,
                    None, nominal, unit,
                )
            )  # fmt: skip
    return tuple(lines)


def _run(model: LPVModel, e: Experiment, output: str, horizon: Horizon) -> tuple[np.ndarray, np.ndarray]:
    """Measured and modelled output after the warm-up."""
    column = [c.name for c in model.outputs].index(output)
    ys = (model.predict(e) if horizon == "one-step" else model.simulate(e))[model.warmup :, column]
    return e[output][model.warmup :], ys
