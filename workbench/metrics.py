"""How well a model reproduces a record: FIT, relative maximum error and RMSE, each with its horizon and its split.

[1] "Experimental Modelling of a Web Winding Machine: LPV Approaches", section 1.4.5.
"""

from collections.abc import Iterable
from typing import Any, Literal

import numpy as np

from workbench.data import Dataset
from workbench.errors import InputError
from workbench.files import nullable
from workbench.hammerstein import Model
from workbench.records import record

Split = Literal["estimation", "held-out"]
Horizon = Literal["free-run", "one-step"] | int


def horizon_name(horizon: Horizon) -> str:
    """free-run, one-step, 25-step."""
    return f"{horizon}-step" if isinstance(horizon, int) else horizon


def fit(y: np.ndarray, simulated: np.ndarray) -> float:
    """FIT = 100 (1 - ||y - ys||_2 / ||y - mean(y)||_2) of one channel, (N,): 100 is perfect, 0 no better than the mean.

    A simulation that left the numbers gives -inf. Raises InputError for a constant y. [1] (1.17)
    """
    y, error, span = _compared(y, simulated)
    # scaled by the largest error, so that a diverging simulation has a finite norm
    size = np.max(np.abs(error), initial=0.0)
    if not np.isfinite(size):
        return -np.inf
    norm = size * np.linalg.norm(error / size) if size else 0.0
    return float(100.0 * (1.0 - norm / np.linalg.norm(span)))


def rm(y: np.ndarray, simulated: np.ndarray) -> float:
    """RM = 100 ||y - ys||_inf / ||y - mean(y)||_inf of one channel, (N,): largest error, in percent of the largest swing.

    [1] (1.18)
    """
    y, error, span = _compared(y, simulated)
    worst = np.max(np.abs(error))
    return float(100.0 * worst / np.max(np.abs(span))) if np.isfinite(worst) else np.inf


def rmse(y: np.ndarray, simulated: np.ndarray) -> float:
    """RMSE = sqrt(mean((y - ys)^2)) of one channel, (N,), in its own unit."""
    error = np.asarray(y, float) - simulated
    size = np.max(np.abs(error), initial=0.0)
    if not np.isfinite(size):
        return np.inf
    return float(size * np.sqrt(np.mean((error / size) ** 2))) if size else 0.0


def tracking(error: np.ndarray, dt: float) -> dict[str, float]:
    """RMS, max |e| and IAE = sum |e| dt of what a loop is off its set-point, (N,)."""
    size = np.abs(error)
    return {"RMS": float(np.sqrt(np.mean(error**2))), "max": float(size.max()), "IAE": float(np.sum(size) * dt)}


def noise_ceiling(y: np.ndarray, noise_std: float) -> float:
    """FIT = 100 (1 - sqrt(N) s / ||y - mean(y)||_2): what a perfect model would score on y (N,), noise s included.

    A free-run score above it has fitted noise. Disturbances that are not logged lower what can be reached further; where the
    true plant is known, drive it with the logged inputs instead. `noise_std` is the standard deviation of the measurement
    noise in y's unit.
    """
    y = np.asarray(y, float)
    return fit(y, y + noise_std)


@record
class Score:
    """FIT and RM [percent], RMSE [unit] of one output of one record, at one horizon, on one side of the split."""

    model: str
    record: str
    split: Split
    output: str
    horizon: Horizon
    FIT: float
    RM: float
    RMSE: float
    unit: str

    def __str__(self) -> str:
        horizon = horizon_name(self.horizon)
        return (
            f"{self.model} on {self.record} ({self.split}), {self.output}, {horizon}: "
            f"FIT {self.FIT:.1f} %, RM {self.RM:.1f} %, RMSE {self.RMSE:.4g} {self.unit}".rstrip()
        )

    def to_dict(self) -> dict[str, Any]:
        """One entry of the scores file; a score without a finite value is null there."""
        return nullable({key: value for key, value in vars(self).items() if key != "model"})


def score(
    model: Model,
    dataset: Dataset,
    split: Split,
    horizons: Iterable[Horizon] = ("free-run", "one-step", 25),
) -> tuple[Score, ...]:
    """FIT = 100 (1 - |y - ys| / |y - mean y|), RM and RMSE by record, horizon and output, on the rows after the warm-up.

    free-run: inputs and schedule alone; one-step: y(k | k-1); an integer h: y(k | k-h).
    Raises InputError for a record that is no longer than the warm-up, for any other horizon, for a constant output, and where
    a record called held-out is one that the model was made from.

        >>> for line in score(model, held_out, "held-out", horizons=["free-run", "one-step"]):
        ...     print(line)
        SSM on c (held-out), n, free-run: FIT 92.0 %, RM 8.1 %, RMSE 1.502 rad/s
        SSM on c (held-out), n, one-step: FIT 98.6 %, RM 1.3 %, RMSE 0.2647 rad/s
    """
    warmup = model.warmup
    scores = []
    for experiment in dataset:
        if split == "held-out" and experiment.fingerprint in model.trained_on:
            raise InputError(
                f"model {model.name!r} was made from this record",
                file=experiment.name,
                mend="a score counts on records that the model never saw: leave it out",
            )
        if len(experiment) < warmup + 2:
            raise InputError(
                f"{len(experiment)} samples, the model's warm-up takes {warmup}",
                file=experiment.name,
                mend="use a longer record",
            )
        for horizon in horizons:
            simulated = _run(model, experiment, horizon)
            for i, channel in enumerate(model.outputs):
                y, ys = experiment[channel.name][warmup:], simulated[warmup:, i]
                if _constant(y):
                    raise InputError(
                        "constant: FIT and RM compare with its variation",
                        file=experiment.name,
                        channel=channel.name,
                        mend="leave this record or this output out",
                    )
                values = (fit(y, ys), rm(y, ys), rmse(y, ys))
                scores.append(Score(model.name, experiment.name, split, channel.name, horizon, *values, channel.unit))
    return tuple(scores)


def to_json(models: Iterable[tuple[Any, str, Iterable[Score]]], provenance: dict[str, Any]) -> dict[str, Any]:
    """The scores file: {"models": [{"model", "file", "order", "scores": [...]}], "provenance"}.

    models: (model with a name and an order, the file it was written to, its scores).
    """
    return {
        "models": [
            {"model": model.name, "file": file, "order": model.order, "scores": [s.to_dict() for s in scores]}
            for model, file, scores in models
        ],
        "provenance": provenance,
    }


def _run(model: Model, experiment, horizon: Horizon) -> np.ndarray:
    if horizon == "free-run":
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable model may leave the numbers: FIT is then -inf
            return model.simulate(experiment)
    steps = 1 if horizon == "one-step" else horizon
    if not isinstance(steps, int) or steps < 1:
        raise InputError(f"horizon {horizon!r}", mend="use free-run, one-step or a number of steps")
    return model.predict(experiment, steps)


def _constant(y: np.ndarray) -> bool:
    return bool(np.max(np.abs(y - y.mean()), initial=0.0) <= 1e-12 * np.max(np.abs(y), initial=1e-300))


def _compared(y: np.ndarray, simulated: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    y, simulated = np.asarray(y, float), np.asarray(simulated, float)
    if y.shape != simulated.shape or y.ndim != 1:
        raise InputError(f"measured {y.shape} and simulated {simulated.shape}, expected two channels of one length")
    span = y - y.mean()
    if _constant(y):
        raise InputError("the measured output is constant: FIT and RM compare with its variation")
    with np.errstate(invalid="ignore", over="ignore"):
        return y, y - simulated, span
