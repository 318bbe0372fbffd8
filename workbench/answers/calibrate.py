"""Physical parameters from records: the verb, its sentences, the plant file and the page.

done = wb.calibrate(WEB_WINDING, data, held_out)
done.plant                      # the plant with fitted parameters
done.save("runs/monday")        # calibration.json, extended.json, report.html
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from workbench.answers.answer import Answer, PlantAnswer, Records, prepared
from workbench.answers.verdict import ended
from workbench.data import Dataset
from workbench.diagnosis.answer import Gain
from workbench.diagnosis.calibrate import Bounds, Calibration, Fitted, Trajectory, gains, trajectories
from workbench.diagnosis.calibrate import calibrate as fitted
from workbench.files import write_json
from workbench.physics.extension import Extension, extension
from workbench.physics.plant import Plant
from workbench.progress import Progress, silent
from workbench.records import record
from workbench.report import figures
from workbench.report.blocks import Badge, Brief, Picture, Provenance, Report, Section, Standing, Table
from workbench.report.figures import ParameterEstimate, Trace
from workbench.report.page import write_report

CALIBRATION_FILE = "calibration.json"


def calibrate(
    plant: Plant, records: Dataset, held_out: Dataset | None = None, *, parameters: Sequence[str] | None = None,
    bounds: Bounds | None = None, dt: float | None = None, anyway: bool = False, accept: bool = False,
    progress: Progress = silent,
) -> "CalibrationResult":  # fmt: skip
    """Parameters of `plant` that make its one-step predictions of `records` most likely, their data sheet taken as prior.

    parameters: names of those to fit (default: all with a tolerance); bounds: {name: (low, high)}. dt [s]: sample time to bring
    the records to. anyway: take records that do not look like this plant's. accept: hand the plant out although it is worse on
    `held_out` records than the one it replaces. Raises InputError for records, names and bounds that do not fit the plant.

    p = nominal exp(sigma theta), theta ~ N(0, 1) before the records, sigma = tolerance / sqrt 3; docs/methods.md has the rest.

        >>> print(calibrate(MOTOR, data, held_out).sentences[0])
        4 parameters fitted; the records decide J, b.
    """
    given = prepared(plant, records, held_out, dt, anyway)
    progress("fitting parameters, starts and noise levels")
    done = fitted(plant, given.own, given.held_out, names=parameters or None, bounds=bounds or {})
    progress("simulating before and after")
    before, after = trajectories(plant, given.shown), trajectories(done.plant, given.shown)
    return CalibrationResult(plant, done, given, before, after, gains(plant, before, after), accept)


@record
class CalibrationResult(PlantAnswer):
    """Fitted parameters with 95 % intervals, and the errors of the plant before and after.

    `plant` is the fitted plant, `sentences` the answer in words; `save` writes it to a folder.
    nominal: the plant before; before, after: both along the records that errors are told of.

        >>> found = calibrate(MOTOR, data, parameters=["J", "b"])
        >>> [f"{p.name} {p.value:.4f} {p.unit}" for p in found.plant.parameters[:2]]
        ['J 0.0020 kg m^2', 'b 0.0139 N m s/rad']
    """

    nominal: Plant
    calibration: Calibration
    records: Records
    before: tuple[Trajectory, ...]
    after: tuple[Trajectory, ...]
    gains: tuple[Gain, ...]
    accepted: bool = False

    @property
    def objections(self) -> tuple[str, ...]:
        return self.calibration.objections

    @property
    def sentences(self) -> list[str]:
        """What was fitted, what it gains, and what is odd."""
        return sentences(self.calibration, self.gains, self.records.held_out is not None)

    def to_dict(self) -> dict[str, Any]:
        """Every number of a calibration; an error that is NaN, for the run left the plant's range, is None."""
        done, split = self.calibration, "held-out" if self.records.held_out else "estimation"
        return {
            "plant": done.plant.name,
            "parameters": {p.name: _parameter(p) for p in done.parameters},
            "pairs": [vars(pair) for pair in done.pairs],
            "starts": done.starts,
            "noise": done.noise,
            "errors": [
                {
                    "record": g.record, "split": split, "channel": g.channel, "horizon": g.horizon,
                    "before": finite(g.before), "after": finite(g.after), "unit": g.unit,
                }
                for g in self.gains
            ],
            "objections": list(self.objections),
        }  # fmt: skip

    def report(self, source: Mapping[str, Any] | None = None) -> Report:
        """Parameters, errors before and after, measured against simulated runs, starts and noise."""
        done, held_out = self.calibration, self.records.held_out is not None
        runs = {"before": self.before, "calibrated": self.after}
        first = figures.parameters([estimate(p) for p in done.parameters])
        drawn = tuple(traces(done.plant, runs))
        sections = (
            Section("Measured and simulated", drawn[:1], drawn[1:]),
            Section("Parameters", (_parameter_table(done),)),
            Section("Errors before and after", (gain_table(self.gains, held_out),)),
            Section("Starts and noise", (), (_start_table(done), _noise_table(done))),
            Section("Provenance", (), (Provenance(source or self.source()),)),
        )
        return Report(f"Calibration of {done.plant.name}", " ".join(self.sentences), sections, self._brief(first))

    def _brief(self, picture: Picture) -> Brief:
        """Whether to go on with the fitted plant, what the records decide, and what it gains."""
        done = self.calibration
        told, odd = [p.name for p in done.parameters if p.told >= 0.5], [p for p in done.parameters if p.warning]
        decided = Badge(
            "Parameters", f"{len(told)} of {len(done.parameters)} decided",
            f"{odd[0].name}: {ended(odd[0].warning)}" if odd else f"By these records: {', '.join(told) or 'none'}.",
            Standing.OPEN if odd or not told else Standing.GOOD,
        )  # fmt: skip
        badges = [decided]
        free = [g for g in self.gains if g.horizon == "full-run" and g.before > 0.0 and np.isfinite(g.after)]
        if best := min(free, key=lambda g: g.after / g.before, default=None):
            where = "a held-out record" if self.records.held_out is not None else "a fitted record: none was held out"
            word = f"{error_said(best.before)} to {error_said(best.after)} {best.unit}".rstrip()
            less = Standing.GOOD if best.after < best.before else Standing.OPEN
            badges.append(Badge("Full-run error", word, f"{best.channel} of {best.record}, {where}.", less))
        badges.append(self.stands("Fitted plant", [w for w in done.warnings if "say nothing" not in w]))
        todo = "Go on with the fitted plant." if self.handed_out else "Keep the plant as it was: the fitted one is worse."
        return Brief(f"Which parameters of {done.plant.name} do these records ask for?", todo, tuple(badges), picture)

    def extension(self, base: str = "", source: Mapping[str, Any] | None = None) -> Extension:
        return extension(self.nominal, base or self.nominal.name, self.calibration.values, {}, source)

    def save(self, folder: str | Path, *, base: str = "", source: Mapping[str, Any] | None = None) -> Path:
        """Write calibration.json, report.html and, where it is handed out, extended.json; returns the folder."""
        folder, source = Path(folder), source or self.source()
        file = self.save_plant(folder, base, source)
        write_json(folder / CALIBRATION_FILE, self.to_dict() | {"file": file, "provenance": dict(source)})
        write_report(self.report(source), folder)
        return folder

    __repr__ = Answer.said


def finite(value: float) -> float | None:
    """The number, None where it is none: JSON has no NaN."""
    return value if np.isfinite(value) else None


def _parameter(p: Fitted) -> dict[str, Any]:
    q = p.nominal
    return {
        "nominal": q.value, "tolerance": q.tolerance, "value": p.value, "low": p.low, "high": p.high, "unit": q.unit,
        "meaning": q.meaning, "told": p.told, "at_bound": p.held, "warning": p.warning,
    }  # fmt: skip


# ---- sentences and page ----------------------------------------------------------------------------------------------------


def sentences(done: Calibration, found: Sequence[Gain], held_out: bool) -> list[str]:
    """What was fitted, what it gains, and what is odd, in a few sentences."""
    told = [p.name for p in done.parameters if p.told >= 0.5]
    said = [f"{objection[:1].upper()}{objection[1:]}." for objection in done.objections]
    said += [f"{len(done.parameters)} parameters fitted; the records decide {', '.join(told) if told else 'none of them'}."]
    said += [gained(found, held_out)] if found else []
    said += [ended(done.compared)] if done.compared else []
    said += [f"{sentence}." for sentence in done.warnings if "say nothing" not in sentence]
    said += [f"{pair.sentence}." for pair in done.pairs]
    return said


def gained(found: Sequence[Gain], held_out: bool) -> str:
    """The full-run errors of each channel, the mean over records, before and after."""
    free = [g for g in found if g.horizon == "full-run"]
    parts = []
    for name in dict.fromkeys(g.channel for g in free):
        own = [g for g in free if g.channel == name]
        old, new = (float(np.mean([getattr(g, side) for g in own])) for side in ("before", "after"))
        parts.append(f"{name} {error_said(old)} before, {error_said(new)} after [{own[0].unit}]")
    where = "held-out records" if held_out else "the fitted records (none was held out)"
    return f"Full-run error on {where}: {'; '.join(parts)}." if parts else ""


def error_said(error: float) -> str:
    return f"{error:.4g}" if np.isfinite(error) else "a run that left the range"


def estimate(p: Fitted) -> ParameterEstimate:
    q = p.nominal
    return ParameterEstimate(q.name, q.unit, q.value, p.value, p.low, p.high, q.tolerance)


def _parameter_table(done: Calibration) -> Table:
    rows = [
        (p.name, p.nominal.unit, p.nominal.value, 100 * p.nominal.tolerance, p.value, p.low, p.high, 100 * p.told, p.warning)
        for p in done.parameters
    ]
    header = ("parameter", "unit", "nominal", "tolerance [%]", "value", "low", "high", "records say [%]", "note")
    caption = "Records say: by how much the interval is narrower than what the data sheet leaves open; 0 is nothing, 100 all."
    return Table("Parameters", header, tuple(rows), caption=caption)


def gain_table(found: Sequence[Gain], held_out: bool) -> Table:
    """Errors of every record, channel and horizon, before and after."""
    rows = tuple((g.record, g.channel, g.horizon, g.before, g.after, g.unit) for g in found)
    where = "held-out records" if held_out else "the records that were fitted"
    caption = f"Root mean square on {where}; the start of each record is estimated, full runs are driven by the inputs alone."
    return Table("Errors", ("record", "channel", "horizon", "before", "after", "unit"), rows, caption=caption)


def traces(plant: Plant, runs: Mapping[str, Sequence[Trajectory]]) -> list[Picture]:
    """Measured against full runs by name, a picture for each record and measured channel."""
    pictures = []
    for own in zip(*runs.values(), strict=True):
        for i, channel in enumerate(plant.outputs):
            if np.isfinite(own[0].measured[:, i]).all():
                measured = Trace(channel, own[0].measured[:, i])
                simulated = {name: run.simulated[:, i] for name, run in zip(runs, own, strict=True)}
                pictures.append(figures.measured_and_simulated(own[0].record, own[0].t, measured, simulated))
    return pictures


def _start_table(done: Calibration) -> Table:
    header = ("record", *(str(c) for c in done.plant.states))
    return Table("Estimated starts", header, tuple((name, *start.values()) for name, start in done.starts.items()))


def _noise_table(done: Calibration) -> Table:
    units = {c.name: c.unit for c in done.plant.outputs}
    rows = tuple((name, level, units[name]) for name, level in done.noise.items())
    return Table("Noise levels from the likelihood", ("channel", "standard deviation", "unit"), rows)
