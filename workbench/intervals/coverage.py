"""How an interval model does on a record: how many measured values its envelopes hold, how wide they are, and how good the
nominal model in their middle is.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from workbench.data import Dataset, Experiment, bad_stamps
from workbench.errors import InputError
from workbench.files import nullable
from workbench.intervals.model import Envelope, IntervalModel, Simulated, Simulation
from workbench.metrics import Horizon, Score, Split, fit, rm, rmse
from workbench.records import record


@record
class Coverage:
    """One envelope of one record: coverage (share of measured values inside), mean radius [unit] and its share of y's range.

    valid: share of samples in the domain of a mode. ratio: outer over reached width of a free run, None for one step.
    nominal: FIT, RM, RMSE of the middle of the envelope (one step) or of the nominal run (free run).
    """

    model: str
    record: str
    split: Split
    output: str
    horizon: Horizon
    samples: int
    coverage: float
    mean_radius: float
    relative: float
    valid: float
    ratio: float | None
    nominal: Score
    unit: str

    def __str__(self) -> str:
        width = f"+-{self.mean_radius:.4g} {self.unit}".rstrip() + f" ({100 * self.relative:.2g} % of the range)"
        if self.horizon == "free-run" and self.relative > SAYS_NOTHING:
            return (
                f"{self.model} on {self.record} ({self.split}), {self.output}, free-run envelope: {width}, as wide as the output "
                "moves: it says nothing (simulation boxes are made for free runs)"
            )
        reached = f", outer/reached {self.ratio:.3g}" if self.ratio is not None else ""
        known = f", {100 * self.valid:.1f} % of them where the estimation records have been" if self.valid < 1.0 else ""
        return (
            f"{self.model} on {self.record} ({self.split}), {self.output}, {self.horizon} envelope: "
            f"holds {100 * self.coverage:.2f} % of {self.samples} values{known}, {width}{reached}"
        )

    def to_dict(self) -> dict[str, Any]:
        """One entry of the scores file; what is not finite is null there."""
        return nullable({key: value for key, value in vars(self).items() if key not in ("model", "nominal")})


def pooled(lines: Sequence[Coverage], measure: Callable[[Coverage], float]) -> float:
    """Mean of a measure over lines, each weighted with its samples; NaN of none."""
    total = sum(line.samples for line in lines)
    return sum(measure(line) * line.samples for line in lines) / total if total else float("nan")


SAYS_NOTHING = 0.5  # mean radius of a free run in ranges of the output
INSTANTS = 5  # of a free run at which the reached bound is sought


def cover(
    model: IntervalModel, dataset: Dataset | Iterable[Experiment], split: Split, *, free_run: bool = True
) -> tuple[Coverage, ...]:
    """One-step (equation-error boxes only) and free-run envelopes of every record; free runs of 2000 samples take a second.

    Raises InputError for a record called held-out that the model was made from, and as `one_step` and `free_run` do.

        >>> boxes = IntervalRegression(ARX(order=1)).fit(data)
        >>> for line in cover(boxes, held_out, "held-out", free_run=False):
        ...     print(line)
        interval on c (held-out), n, one-step envelope: holds 100.00 % of 599 values, +-1.802 rad/s (1.6 % of the range)
    """
    found = []
    for e in dataset:
        if split == "held-out" and e.fingerprint in model.trained_on:
            raise InputError(
                f"model {model.name!r} was made from this record",
                file=e.name,
                mend="coverage counts on records that the model never saw: leave it out",
            )
        if not isinstance(model.semantics, Simulation):
            found.append(one_step_coverage(model, e, split, model.one_step(e)))
        whole = next(iter(bad_stamps(e.t, e.dt)), None) is None  # a free run crosses no gap
        if whole and (free_run or isinstance(model.semantics, Simulation)):
            last = len(e) - model.order - 1
            instants = tuple(int(k) for k in np.linspace(0, last, INSTANTS + 1)[1:]) if last > INSTANTS else None
            found.append(free_run_coverage(model, e, split, model.free_run(e, instants)))
    return tuple(found)


def one_step_coverage(model: IntervalModel, e: Experiment, split: Split, envelope: Envelope) -> Coverage:
    """The line for an envelope that is already there."""
    middle = (envelope.low + envelope.high) / 2
    return _line(model, e, split, "one-step", envelope, middle, envelope.valid, None)


def free_run_coverage(model: IntervalModel, e: Experiment, split: Split, simulated: Simulated) -> Coverage:
    """The line for a free run that is already there."""
    return _line(model, e, split, "free-run", simulated, simulated.run.nominal, simulated.valid, simulated.run.ratio)


def _line(
    model: IntervalModel, e: Experiment, split: Split, horizon: Horizon, found: Envelope | Simulated, middle: np.ndarray,
    valid: float, ratio: float | None,
) -> Coverage:  # fmt: skip
    y, output = found.y, model.output
    nominal = Score(model.name, e.name, split, output.name, horizon, fit(y, middle), rm(y, middle), rmse(y, middle), output.unit)
    return Coverage(
        model.name, e.name, split, output.name, horizon, len(y), found.coverage, found.mean_radius,
        found.mean_radius / model.unit_range, valid, ratio, nominal, output.unit,
    )  # fmt: skip
