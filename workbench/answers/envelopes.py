"""Interval models of every output, what is said of them, and what their envelopes show."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from workbench.data import Channel, Dataset, Experiment, bad_stamps
from workbench.intervals.coverage import SAYS_NOTHING, Coverage, pooled
from workbench.intervals.domains.shadow import shadow
from workbench.intervals.model import IntervalModel, Mode, Simulation, domain_coordinates
from workbench.intervals.output_error import OutputErrorRegression
from workbench.intervals.regression import IntervalRegression
from workbench.metrics import Horizon, horizon_name
from workbench.report import figures
from workbench.report.blocks import Picture, Section, Table, Text
from workbench.report.figures import Trace

Method = IntervalRegression | OutputErrorRegression
RUNAWAY = 10.0  # ranges of the output beyond which an envelope says nothing


def fit_outputs(method: Method, dataset: Dataset) -> dict[str, IntervalModel]:
    """A model for each output, by its name: `interval`, or `interval-w3` where there are several."""
    outputs = dataset.experiments[0].names_of("output")
    if len(outputs) == 1:
        return {method.name: method.fit(dataset, outputs[0])}
    return {f"{method.name}-{y}": replace(method, name=f"{method.name}-{y}").fit(dataset, y) for y in outputs}


# ---- what is said ------------------------------------------------------------------------------------------------------


def described_modes(model: IntervalModel) -> list[str]:
    """The model in a few lines: structure, promise, errors, modes and their widths, what the verification did."""
    count = len(model.modes)
    radius = max(mode.mean_radius for mode in model.modes)
    inflated = sum(mode.inflated for mode in model.modes)
    widened = f"{max(mode.inflation for mode in model.modes) - 1:.1e}"
    if isinstance(model.semantics, Simulation):
        checked = f"every free run checked; radii widened by {widened} of themselves for that"
    else:
        checked = f"every sample verified; {inflated} of them asked for wider radii, by {widened} of themselves at most"
    union = "; where several hold a sample, their union counts" * (count > 1)
    lines = [
        f"{model.name}: {type(model.structure).__name__} of order {model.order} for {model.output}, "
        f"promise {model.semantics.name}: {model.semantics.promise}",
        f"  {count} mode{'s' * (count > 1)}, precision {model.precision:.6g}, mean radius over its own samples at most "
        f"{radius:.4g} {model.output.unit} ({100 * radius / model.unit_range:.2g} % of the range){union}",
        f"  {checked}",
    ]
    lines += [f"  note: {note}" for note in (*model.notes, *_warnings(model))]
    return lines


def _warnings(model: IntervalModel) -> list[str]:
    """What a user of these boxes must know and would not see in their widths."""
    said = []
    growth = model.pole_radius()
    if growth >= 1.0 and not isinstance(model.semantics, Simulation):
        said.append(f"the middle of a box is unstable (pole radius {growth:.4f}): no free run of it means anything")
    moving = model.form.source >= 0
    if all(not np.any(mode.box.radius[moving]) for mode in model.modes):
        said.append("only the constant is uncertain: the one-step envelope has constant width")
    return said


def covered_verdict(envelopes: Sequence[Coverage]) -> str:
    """What the envelopes of one model hold of held-out records, with their widths; or of the estimation records."""
    held = [c for c in envelopes if c.split == "held-out"] or list(envelopes)
    said = []
    for horizon in dict.fromkeys(c.horizon for c in held):
        own = [c for c in held if c.horizon == horizon]
        if horizon == "free-run" and any(c.relative > SAYS_NOTHING for c in own):
            said.append("free-run as wide as the output moves, it says nothing")
            continue
        inside, width = pooled(own, lambda line: line.coverage), pooled(own, lambda line: line.relative)
        said.append(f"{horizon} {100 * inside:.1f} % of the measured values within ±{100 * width:.2g} % of the range")
    where = "held-out records" if held[0].split == "held-out" else "the records it was made from"
    return f"Envelopes of {held[0].model} on {where}: {', '.join(said)}."


# ---- sections of a report ----------------------------------------------------------------------------------------------


def envelope_sections(
    models: Sequence[IntervalModel], envelopes: Sequence[Coverage], records: Sequence[Experiment]
) -> list[Section]:
    """Envelopes with measured data, modes along time, domains, and the tables behind them."""
    shown = [picture for model in models for e in records for picture in envelope_pictures(model, e)]
    modes = [picture for model in models if len(model.modes) > 1 for picture in mode_pictures(model, records)]
    title = "what the envelopes hold and how wide they are"
    horizons: dict[Horizon, None] = {c.horizon: None for c in envelopes}
    several = len({c.model for c in envelopes}) > 1
    widths = [width_picture(f"{horizon_name(horizon)}: {title}", envelopes, horizon) for horizon in horizons if several]
    promises = [f"{model.name} promises: {model.semantics.promise}." for model in models]
    return [
        Section("Envelopes", (Text("\n\n".join(promises)), *widths, *shown, envelope_table(envelopes))),
        Section("Modes", (*modes, *(table for model in models for table in mode_tables(model)))),
    ]


def width_picture(title: str, envelopes: Iterable[Coverage], horizon: Horizon) -> Picture:
    """Coverage against mean radius for one horizon."""
    own = [c for c in envelopes if c.horizon == horizon]
    return figures.widths(title, [figures.Width(c.model, c.record, c.mean_radius, 100 * c.coverage) for c in own], own[0].unit)


def envelope_pictures(model: IntervalModel, e: Experiment) -> list[Picture]:
    """One-step envelope (equation-error boxes) and free run of a record, each with the measured values."""
    measured = Trace(e.channel(model.output.name), e[model.output.name])
    pictures = []
    if not isinstance(model.semantics, Simulation):
        step = model.one_step(e)
        own = Trace(measured.channel, step.y)
        title = f"{model.name} on {e.name}: one step ahead"
        pictures.append(figures.envelope(title, step.t, own, {"one step": figures.Band(step.low, step.high)}))
    if any(True for _ in bad_stamps(e.t, e.dt)):
        return pictures  # a free run crosses no gap
    free = model.free_run(e)
    run = free.run
    if float(np.ptp(free.y)) * RUNAWAY < free.mean_radius:
        return pictures  # it grows without limit: the table says so, a picture would show nothing
    error = free.output_error
    band = figures.Band(free.low, free.high, run.reached_low - error, run.reached_high + error)
    title = f"{model.name} on {e.name}: free run"
    pictures.append(figures.envelope(title, free.t, Trace(measured.channel, free.y), {"free run": band}, run.nominal))
    return pictures


def mode_pictures(model: IntervalModel, records: Sequence[Experiment]) -> list[Picture]:
    """The mode that is nearest along each record, and where the modes lie in regressor space."""
    names = [f"mode {i}" for i in range(len(model.modes))]
    pictures = []
    for e in records:
        step = model.one_step(e)
        measured = Trace(e.channel(model.output.name), step.y)
        title = f"{model.name} on {e.name}: modes along time"
        short = [i for i, mode in enumerate(model.modes) if mode.short]
        pictures.append(figures.modes_along_time(title, step.t, measured, step.mode.astype(int), names, short))
    if model.schedule is None and len(model.modes[0].domain.low) > 1:
        pictures.append(domain_picture(model, records[0]))
    return pictures


def along_time(model: IntervalModel, e: Experiment, what: str, truth: np.ndarray | None = None) -> list[Picture]:
    """Modes of a record that the model was made from and their parameter intervals; what: how the titles end.

    truth (len(e), parameters): drawn beside the intervals.
    """
    stretches = _stretches(model, e)
    k, index = np.arange(stretches[0][0], stretches[-1][1] + 1), np.array([i for *_, i in stretches])
    mode = np.concatenate([np.full(last - first + 1, i) for first, last, i in stretches])
    measured = Trace(e.channel(model.output.name), e[model.output.name][k])
    short = [i for i, m in enumerate(model.modes) if m.short]
    names = [f"mode {i}" for i in range(len(model.modes))]
    along = figures.modes_along_time(f"Modes along time {what}", e.t[k], measured, mode, names, short)
    edges = np.array([*(e.t[first] for first, *_ in stretches), e.t[k[-1]]])
    boxes, names = [model.modes[i].box for i in index], model.form.names
    parameters = {
        name: figures.ParameterInterval(np.array([box.centre[j] for box in boxes]), np.array([box.radius[j] for box in boxes]))
        for j, name in enumerate(names)
    }
    title = f"Parameter intervals along time {what}"
    if truth is None:
        return [along, figures.parameters_along_time(title, edges, parameters)]
    picture = figures.parameters_along_time(title, edges, parameters, e.t[k], {n: truth[k, j] for j, n in enumerate(names)})
    return [along, replace(picture, caption=f"{picture.caption} A parameter is named by its regressor.")]


def truth_held(model: IntervalModel, e: Experiment, truth: np.ndarray) -> float:
    """The share of the samples that modes were made from, and of the parameters (len(e), parameters), inside of the intervals."""
    held = [
        np.abs(truth[first : last + 1] - model.modes[i].box.centre) <= model.modes[i].box.radius
        for first, last, i in _stretches(model, e)
    ]
    return float(np.mean(np.concatenate(held)))


def _stretches(model: IntervalModel, e: Experiment) -> list[tuple[int, int, int]]:
    """First and last sample of every stretch of a record, one after the other, and the mode that was made from it."""
    return sorted(
        (span.first, span.last, i) for i, mode in enumerate(model.modes) for span in mode.spans if span.record == e.name
    )


def domain_picture(model: IntervalModel, e: Experiment) -> Picture:
    """The two regressors of the most recent output, or inputs, of every mode, with the samples of a record."""
    regions = {f"mode {i}": shadow(mode.domain, 0, 1) for i, mode in enumerate(model.modes)}
    step, at = model.one_step(e), domain_coordinates(model.samples_of(e))
    units = [model.output.unit, *(c.unit for c in model.inputs)]
    first, second = (
        Channel(name, units[int(source)]) for name, source in zip(model.form.names[:2], model.form.source[:2], strict=True)
    )
    return figures.domains(f"{model.name}: where its modes are known", first, second, regions, at[:, :2], step.mode.astype(int))


def envelope_table(envelopes: Sequence[Coverage]) -> Table:
    """Every envelope, a row each."""
    named = len({c.output for c in envelopes}) > 1  # one output goes into the header, several into the rows
    radius = "mean radius" if named else f"mean radius [{envelopes[0].unit}]"
    return Table(
        "Envelopes",
        ("model", "record", "split", *(["output"] if named else []), "envelope", "inside [%]", radius, "of range [%]",
         "known [%]", "outer/reached"),
        tuple(
            (c.model, c.record, c.split, *([f"{c.output} [{c.unit}]"] if named else []), str(c.horizon), 100 * c.coverage,
             c.mean_radius, 100 * c.relative, 100 * c.valid, c.ratio) for c in envelopes
        ),
        caption="inside: measured values within the envelope; of a free run, whose envelope is of the true output, give or take "
        "the error of the output (mean radius with it). Without a schedule the bounds of a free run hold for the sequence of "
        "modes that the nominal run goes through. known: regressors within the domain of a mode. outer/reached: the "
        "guaranteed bound of a free run against what a found parameter sequence reaches; 1 means the bound is exact.",
    )  # fmt: skip


def mode_tables(model: IntervalModel) -> tuple[Table, Table]:
    """Every mode with its samples and precision, and the parameter intervals, a column for each mode."""
    modes = Table(
        f"Modes of {model.name}",
        ("mode", "samples", "precision", f"mean radius [{model.output.unit}]", "made from samples"),
        tuple(
            (f"{i}{' (short)' * mode.short}", mode.samples, mode.precision, mode.mean_radius, _spans(mode))
            for i, mode in enumerate(model.modes)
        ),
    )
    boxes = [mode.box for mode in model.modes]
    parameters = Table(
        f"Parameters of {model.name}",
        ("parameter of", *(f"mode {i}" for i in range(len(boxes)))),
        tuple(
            (name, *(f"{box.centre[j]:.5g} ± {box.radius[j]:.2g}" for box in boxes)) for j, name in enumerate(model.form.names)
        ),
        caption="Centre ± radius of each regressor's parameter; D is the difference q - 1.",
    )
    return modes, parameters


def _spans(mode: Mode) -> str:
    """The first stretches that a mode was made from."""
    return ", ".join(str(span) for span in mode.spans[:3]) + f" and {len(mode.spans) - 3} more" * (len(mode.spans) > 3)
