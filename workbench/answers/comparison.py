"""Models beside each other on the same records: scores, traces and residual tests as blocks of a report."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from workbench.answers.envelopes import covered_verdict, envelope_sections
from workbench.answers.scored import ScoredModel
from workbench.curves import Curve
from workbench.data import Experiment
from workbench.errors import InputError
from workbench.hammerstein import HammersteinWienerModel, Model
from workbench.intervals.model import IntervalModel
from workbench.metrics import Score
from workbench.report import figures
from workbench.report.blocks import Badge, Brief, Picture, Provenance, Report, Section, Standing, Table, Text
from workbench.residuals import residual_test


def traces(e: Experiment, models: Mapping[str, Model], output: str) -> Picture:
    """One output of a record, measured and simulated by each model (free run), with the error and the schedule."""
    simulated: dict[str, np.ndarray] = {}
    schedules: dict[str, figures.Trace] = {}
    for name, model in models.items():
        run = model.simulate(e)[:, [c.name for c in model.outputs].index(output)]
        run[: model.warmup] = np.nan  # the initial state is found there
        simulated[name] = run
        schedules |= {c.name: figures.Trace(e.channel(c.name), e[c.name]) for c in model.schedules}
    measured = figures.Trace(e.channel(output), e[output])
    return figures.measured_and_simulated(e.name, e.t, measured, simulated, tuple(schedules.values()))


def residual_table(models: Mapping[str, Model], records: Iterable[Experiment], *, closed_loop: bool | None = None) -> Table:
    """Family-wise p-values of the whiteness of one-step errors and of their correlation with the inputs."""
    rows: list[tuple] = []
    columns: dict[str, None] = {}
    for name, model in models.items():
        for e in records:
            try:
                checks = residual_test(model, e, closed_loop=closed_loop).checks
            except InputError:  # too short a record, or an unstable model: the row stays empty
                checks = ()
            p = {f"{c.output}{f', {c.input}' if c.kind == 'input' else ', white'}": c.p_family for c in checks}
            columns |= dict.fromkeys(p)
            rows.append((f"{name}, {e.name}", p))
    return Table(
        "Residual tests",
        ("model, record", *(f"p: {column}" for column in columns)),
        tuple((label, *(p.get(column, np.nan) for column in columns)) for label, p in rows),
        caption="Family-wise p-values of the one-step error: below 0.05 it still holds something that the model leaves out. "
        "In closed loop only inputs before the error are correlated with it.",
        digits=2,
    )


def curve_picture(model: HammersteinWienerModel, curve: Curve) -> Picture:
    """v = f(u) of an input over what was seen of it, with the straight line that a linear model has in its place."""
    u = np.union1d(np.linspace(curve.u[0], curve.u[-1], 101), curve.u)
    channel = next(c for c in model.inputs if c.name == curve.input)
    drawn = {"curve": curve(u), "straight": u}
    caption = f"What {model.name} acts on in place of {curve.input}; its scale is that of {curve.input}, the gain is the model's."
    title = f"{model.name}: static curve of {curve.input}"
    return figures.over_schedule(title, figures.Trace(channel, u), {f"f({curve.input})": drawn}, caption)


def score_table(scores: Sequence[Score]) -> Table:
    """Every score, a row each."""
    return Table(
        "All scores",
        ("model", "record", "split", "output", "horizon", "FIT [%]", "RM [%]", "RMSE", "unit"),
        tuple((s.model, s.record, s.split, s.output, str(s.horizon), s.FIT, s.RM, s.RMSE, s.unit) for s in scores),
        digits=3,
    )


def comparison(title: str, results: Sequence[ScoredModel], records: Sequence[Experiment], source: Mapping[str, Any]) -> Report:
    """A page: which model runs free best on held-out records, then scores, traces on `records`, envelopes, residuals, notes."""
    scores = [s for result in results for s in result.scores]
    named = {result.model.name: result.model for result in results if not isinstance(result.model, IntervalModel)}
    curved = [model for model in named.values() if isinstance(model, HammersteinWienerModel) and model.curves]
    interval = [result.model for result in results if isinstance(result.model, IntervalModel)]
    envelopes = [c for result in results for c in result.envelopes]
    outputs = list(dict.fromkeys(s.output for s in scores))
    shown = [traces(e, named, output) for e in records for output in outputs] if named else []
    brief = _brief(results, shown)
    sections = [Section("Scores", tuple(figures.score_dots(scores, output) for output in outputs))]
    if interval:
        sections += envelope_sections(interval, envelopes, records)
    if named:
        rest = tuple(picture for picture in shown if picture is not brief.picture)
        count = len(outputs) - 1  # of the first record, whose worst output is often above
        sections += [Section("Measured and simulated", rest[:count], rest[count:])] if rest else []
        sections.append(Section("Residuals", (residual_table(named, records),)))
    if curved:
        sections.append(
            Section("Static curves", tuple(curve_picture(model, curve) for model in curved for curve in model.curves))
        )
    notes = [f"{result.model.name}: {note}" for result in results for note in result.model.notes]
    if notes:
        sections.append(Section("Notes", (Text("\n\n".join(notes)),)))
    sections.append(Section("Numbers", (), (score_table(scores), Provenance(source))))
    return Report(title, headline(results), tuple(sections), brief)


FOLLOWS = 80.0  # free-run FIT in percent from which on a model is one to design on without a second thought


def _brief(results: Sequence[ScoredModel], shown: Sequence[Picture]) -> Brief:
    """The model to go on with, how it follows records that it has not seen, and what speaks against it.

    shown: runs over the measured ones, of which the one that is followed least is seen first.
    """
    against = [sentence for result in results for sentence in result.against]
    fits = {r.model.name: own for r in results if not r.against and (own := _free([*r.scores]))}
    badges, todo, first = [], "No model is handed out.", next(iter(shown), None)
    if fits:
        best = max(fits, key=lambda name: min(s.FIT for s in fits[name]))
        worst = min(fits[best], key=lambda s: s.FIT)
        first = next((own for own in shown if own.title == f"{worst.output}, record {worst.record}"), first)
        file = next(r.file for r in results if r.model.name == best)
        todo = f"Go on with {best}{f': {file}' if file else ''}."
        standing = Standing.GOOD if worst.FIT >= FOLLOWS else Standing.OPEN if worst.FIT > 0.0 else Standing.BAD
        where = "a held-out record" if worst.split == "held-out" else "a record that it was fitted to: none was held out"
        said = f"Free run of {best} where it follows least: {worst.output} of {worst.record}, {where}."
        badges.append(Badge("Model", f"FIT {worst.FIT:.0f} % or more", said, standing))
        others = [f"{name} {min(s.FIT for s in own):.0f} %" for name, own in fits.items() if name != best]
        badges += [Badge("Others", ", ".join(others), "Their FIT where they follow least.", Standing.GOOD)] if others else []
    for c in (c for r in results for c in r.envelopes[:1]):
        badges.append(Badge("Envelope", f"{100.0 * c.coverage:.1f} % inside", covered_verdict([c]), Standing.GOOD))
    objected = Badge("Objections", str(len(against)), f"{against[0]}.", Standing.BAD) if against else None
    badges.append(objected or Badge("Objections", "none", "No model is worse than the mean of a record.", Standing.GOOD))
    return Brief("Which model follows records that it has not seen?", todo, tuple(badges), first)


def _free(scores: Sequence[Score]) -> list[Score]:
    """Free runs on held-out records, or on all where there are none."""
    free = [s for s in scores if s.horizon == "free-run"]
    return [s for s in free if s.split == "held-out"] or free


def headline(results: Sequence[ScoredModel]) -> str:
    """What speaks against models, the free runs of the others, and what envelopes hold."""
    against = list(dict.fromkeys(sentence for result in results for sentence in result.against))
    kept = [s for result in results if not result.against for s in result.scores]
    said = [*(f"NOT HANDED OUT: {sentence}." for sentence in against), *([verdict(kept)] if kept else [])]
    return " ".join([*said, *(covered_verdict(result.envelopes) for result in results if result.envelopes)])


def verdict(scores: Sequence[Score]) -> str:
    """The headline: free-run FIT by model on held-out records, the best first, or that there are none."""
    free = [s for s in scores if s.horizon == "free-run"]
    held_out = [s for s in free if s.split == "held-out"]
    counted = held_out or free
    said = []
    models = dict.fromkeys(s.model for s in counted)
    for model in sorted(models, key=lambda name: -float(np.mean([s.FIT for s in counted if s.model == name]))):
        own = [s for s in counted if s.model == model]
        by_output = [
            f"{output} {min(fits):.1f}" + (f" to {max(fits):.1f} %" if len(fits) > 1 else " %")
            for output in dict.fromkeys(s.output for s in own)
            if (fits := [s.FIT for s in own if s.output == output])
        ]
        said.append(f"{model}: {', '.join(by_output)}")
    where = "held-out records" if held_out else "the records the models were made from (no held-out record was given)"
    return f"Free-run FIT on {where}. {'; '.join(said)}."
