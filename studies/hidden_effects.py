"""How often is the diagnosis right on records in which something was hidden?

Cases come from the generator in tests/hidden, which has its own equations. A case is a row of cases.jsonl, written whole as soon
as it is done, and a run that was cut off goes on where it stopped. Sizes are drawn in multiples of the limits that the diagnosis
states for records without any effect. Where the diagnosis declares a tie and recommends an experiment, the generator's machine
runs it, and the diagnosis is made again. All rates are of the rows alone: see hidden_scores.
"""

import math
import time
import traceback
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from plants import PLANTS
from studies.cases import TABLE, Cases, Say, from_tests, study
from studies.experiments import templates_of
from studies.hidden_scores import (
    TESTABLE,
    Bin,
    Outcome,
    Resolution,
    Row,
    Summary,
    by_machine,
    outcome,
    resolution,
    tied,
)
from studies.targets import Target, reached, target_table, to_json
from workbench.data import Dataset, Experiment
from workbench.diagnosis.diagnosis import diagnose
from workbench.diagnosis.experiments import proposable
from workbench.diagnosis.predictor import predictor
from workbench.diagnosis.recalibrate import recalibrated
from workbench.diagnosis.refit import Model
from workbench.errors import InputError
from workbench.files import read_json, write_json
from workbench.report import figures
from workbench.report.blocks import Block, Picture, Provenance, Report, Section, Table, Text
from workbench.report.figures import Rates
from workbench.table import fingerprint, resumed

Limits = Mapping[str, Mapping[str, float]]  # by machine and "effect@place"

LIMIT_SEED = (
    999_999  # records without effect from which the limits of a machine are taken; on all of them every channel is logged
)
FIVE_SIGMA = 25.0
CLEAR, TRIALS = (100.0, 1600.0), 5  # losses from which a limit is read, how often a size is tried
CASES, QUICK = 600, 30
CONFUSIONS = 20
LAYOUT = 4  # of a row: rows of another layout are not counted with these


TARGETS = (
    Target("right name or a declared tie of three at most that holds it", "right_or_tie", low=0.95),
    Target("right name alone", "right", low=0.90),
    Target("confident wrong name", "wrong", high=0.01),
    Target("nothing hidden, yet a cause named", "false_alarms", high=0.01),
    Target("two effects, both found", "both", low=0.80),
    Target("two effects, a confident wrong name among the causes", "wrong_in_pairs", high=0.02),
    Target("outside the catalogue, said to be unknown or incomplete", "outside", low=0.85),
    Target("true size inside its stated 95 % interval", "inside", low=0.90, high=0.97),
    Target("one-step error on held-out records lower after extension", "gained", low=1.0),
    Target("a tie that holds it, resolved by the recommended experiment", "resolved", low=0.90),
)


# ---- cases ------------------------------------------------------------------------------------------------------------------


def generator() -> Any:
    """The module tests.hidden.case of the checkout that this file belongs to."""
    return from_tests("tests.hidden.case", "the generator of hidden effects")


def limits_of(machine: str, seed: int = LIMIT_SEED, records: int | None = None) -> dict[str, float]:
    """Detection limit of every effect of a machine, in the generator's reading, from records with nothing hidden.

    records: how many of them, all by default; fewer state higher limits in less time. Physics outside the catalogue has the
    size as its limit at which the recalibrated plant loses FIVE_SIGMA of twice the log-likelihood, noise levels tuned.
    """
    case = generator()
    dataset = Dataset(case.records(seed, machine).experiments[:records])
    limits = _read_as_sizes(diagnose(PLANTS[machine], dataset).limits, dataset)
    module, quiet = case.MACHINES[machine], _deviance(machine, dataset)
    for name in module.FOREIGN:
        size = module.TRIAL[name]
        for _ in range(TRIALS):
            try:
                runs = case.records(seed, machine, (case.foreign(name, size),))
            except InputError:  # the machine does not run with so much of it
                size *= 0.3
                continue
            loss = _deviance(machine, Dataset(runs.experiments[:records])) - quiet
            if loss > CLEAR[0] / 4.0:  # from far off it is nearer now
                limits[f"{name}@{case.OUTSIDE}"] = size * float(np.sqrt(FIVE_SIGMA / loss))
            if CLEAR[0] < loss < CLEAR[1]:
                break
            size *= float(np.clip(np.sqrt(np.sqrt(CLEAR[0] * CLEAR[1]) / max(loss, 1.0)), 0.05, 20.0))
    return limits


def _deviance(machine: str, dataset: Dataset) -> float:
    """Of the recalibrated plant without any effect."""
    made = recalibrated(predictor(PLANTS[machine], dataset))
    return Model(made.predictor, made.fit).deviance


def _read_as_sizes(limits: Iterable[Any], dataset: Dataset) -> dict[str, float]:
    """Limits by "effect@place"; that of a saturation is how far the clip lies below the largest command."""
    found = {f"{x.effect}@{x.place}": x.value for x in limits}
    for key in [k for k in found if k.startswith("saturation@")]:
        largest = max(float(np.abs(e[key.split("@")[1]]).max()) for e in dataset)
        found[key] = largest - found[key]
    return {key: value for key, value in found.items() if value > 0.0}


def run_case(seed: int, limits: Limits, configuration: str) -> dict[str, Any]:
    """Draw a case, diagnose it, and write down what was hidden and what was said.

    A case that cannot be drawn or diagnosed is a row that says so ("undrawn", "error"), not the end of the study.
    """
    case = generator()
    lot = case.lot_of(seed)
    row = {"seed": seed, "configuration": configuration, "machine": lot.machine, "kind": lot.kind.value}
    own = limits[lot.machine]
    try:
        drawn = case.draw(seed, limits=own)
    except InputError as reason:
        return row | {"truth": [], "undrawn": str(reason)}
    row["truth"] = [
        {
            "key": h.key, "multiple": h.multiple, "size": h.multiple * own.get(h.key, 0.0), "catalogued": h.catalogued,
            "parameters": dict(h.parameters),
        }
        for h in drawn.truth
    ]  # fmt: skip
    row["resolutions"] = drawn.resolutions
    began = time.process_time()
    try:
        found = _diagnosed(drawn)
    except Exception as reason:
        return row | {"error": "".join(traceback.format_exception(reason))[-2000:]}
    row["seconds"] = time.process_time() - began
    row |= _answer(found) | {"own_limits": _own_limits(found, drawn)}
    if tied(row) and found.next_experiment:
        row["experiment"] = _next(drawn, found.next_experiment)
    return row


def _diagnosed(drawn: Any) -> Any:
    """The diagnosis of a case; what to measure next is an experiment of the machine's plan, or one of the records once more."""
    plant = PLANTS[drawn.machine]
    tests = proposable(plant, templates_of(drawn.machine), drawn.records)
    return diagnose(plant, drawn.records, drawn.held_out, templates=tests)


def _with(records: Dataset, more: Sequence[Experiment]) -> Dataset:
    """All of them, with the channels that all have: an open loop has no set-points."""
    every = [*records, *more]
    common = [name for name in every[0].names if all(name in e.names for e in every)]
    return Dataset(tuple(e.select(common) for e in every))


def _next(drawn: Any, todo: Any) -> dict[str, Any]:
    """What was recommended, and what is said of the records together with those that the generator's machine makes of it.

    runs: 0 where no experiment of the plan decides. fault: why there is no answer.
    """
    said: dict[str, Any] = {"expected": dict(todo.expected), "runs": todo.runs if todo.signals else 0}
    if not said["runs"]:
        return said
    try:
        more = [generator().further(drawn, f"next {k + 1}", todo.signals, k) for k in range(said["runs"])]
        return said | {"after": _answer(diagnose(PLANTS[drawn.machine], _with(drawn.records, more), drawn.held_out))}
    except Exception as reason:
        return said | {"fault": "".join(traceback.format_exception_only(reason))[-2000:]}


def _answer(found: Any) -> dict[str, Any]:
    """What a diagnosis said, as a row says it."""
    causes = [
        {
            "key": c.key,
            "ties": dict(c.ties),
            "posterior": c.evidence.posterior,
            "delta_bic": c.evidence.delta_bic,
            "stability": c.stability,
            "sure": not c.doubt,
            "parameters": {name: [e.value, e.low, e.high] for name, e in c.parameters.items()},
            "improved": _improved(c.gains),
        }
        for c in found.causes
    ]
    return {
        "verdict": found.finding.value,
        "causes": causes,
        "remainder": [[r.channel, r.variable, r.p_value, r.share] for r in found.remainder],
        "untestable": [f"{u.effect}@{u.place}" for u in found.untestable],
    }


def _own_limits(found: Any, drawn: Any) -> dict[str, float]:
    """The limits that the diagnosis of these very records states for what is hidden in them."""
    stated = _read_as_sizes(found.limits, drawn.records)
    return {h.key: stated[h.key] for h in drawn.truth if h.key in stated}


def _improved(gains: Iterable[Any]) -> float | None:
    """Held-out one-step errors, after over before: geometric mean over records and channels; None where nothing is predicted."""
    ratios = [g.after / g.before for g in gains if g.horizon == "one-step" and g.before > 0.0 and np.isfinite(g.after)]
    return float(np.exp(np.mean(np.log(np.maximum(ratios, 1e-12))))) if ratios else None


# ---- a run that can be cut off and goes on ------------------------------------------------------------------------------------


def run(folder: Path, seeds: Iterable[int], jobs: int = 1, progress: Say = lambda _: None) -> list[dict[str, Any]]:
    """Every seed once, `jobs` at a time: rows that cases.jsonl holds already are not run again. Returns all rows of the folder.

    Raises InputError where the folder's rows were made by another version or with other limits.
    """
    limits = _limits(folder, progress)
    configuration = configured(limits)
    return resumed(
        folder / TABLE,
        partial(run_case, limits=limits, configuration=configuration),
        list(seeds),
        key="seed",
        configuration=configuration,
        of="of another version or with other limits",
        jobs=jobs,
        said=said,
        progress=progress,
    )


def _limits(folder: Path, progress: Say) -> Limits:
    """The limits of all machines: those of the folder, or new ones that are put there."""
    limits = {}
    for machine in PLANTS:
        path = folder / f"limits-{machine}.json"
        if not path.exists():
            progress(f"{machine}: detection limits")
            write_json(path, limits_of(machine))
        limits[machine] = read_json(path)
    return limits


def configured(limits: Limits) -> str:
    """What rows must share to be counted together: layout, limits, and the versions of all that computes."""
    return fingerprint(LAYOUT, limits)


def said(row: Row) -> str:
    """A row on a line."""
    truth = ", ".join(f"{t['key']} x{t['multiple']:.2g}" for t in row["truth"]) or "nothing"
    start = f"{row['seed']} {row['machine']}, {row['kind']}: {truth}"
    for fault in ("undrawn", "error"):
        if fault in row:
            return f"{start} -> {fault}: {row[fault].splitlines()[-1]}"
    found = resolution(row)
    then = f"; the next experiment: {found.value}" if found else ""
    return f"{start} -> {_causes_said(row)} ({row['seconds']:.1f} s){then}"


def _causes_said(answer: Mapping[str, Any]) -> str:
    found = ", ".join(c["key"] + (f" ~ {', '.join(c['ties'])}" if c["ties"] else "") for c in answer["causes"]) or "no cause"
    return f"{answer['verdict']}: {found}"


# ---- the page ---------------------------------------------------------------------------------------------------------------


def verdict(s: Summary) -> str:
    """The targets, what was reached, and where it falls short, in one paragraph."""
    said = [f"{s.cases} cases.", *reached(TARGETS, s)]
    if s.errors:
        said.append(f"{s.errors} diagnoses ended with an error; they count as if nothing had been said.")
    return " ".join(said)


def _report(rows: Sequence[Row], found: Mapping[str, Summary], source: dict[str, Any]) -> Report:
    whole = found["all"]
    sections = (
        Section("Targets", (_targets(found), _outcomes(found))),
        Section("Size", _sizes(whole)),
        Section("Stated odds", _calibration(whole)),
        Section("Ties", _ties(rows, found)),
        Section("What was taken for what", _confusion(rows, whole)),
        Section("Run time", _seconds(whole)),
        Section("Cases that went wrong", _wrong(rows)),
        Section("Provenance", (Provenance(source),)),
    )
    title = "Hidden effects: how often the diagnosis is right"
    return Report(title, verdict(whole), tuple(s for s in sections if s.blocks))


def _targets(found: Mapping[str, Summary]) -> Table:
    caption = (
        f"An effect counts from {TESTABLE:g} times its detection limit on, both the limit of records without it and that "
        "which the diagnosis of the very records states (that of rounding apart, which holds the step itself), unless it could "
        "not be tested. A wrong name beside the right one makes a case wrong. Outside the catalogue: from 5 times on."
    )
    return target_table(TARGETS, found, [name for name in found if name != "all"], caption)


def _outcomes(found: Mapping[str, Summary]) -> Table:
    extra = {
        "right or tie, whatever limit the records state": "right_or_tie_by_multiple",
        "confident wrong name at any size": "wrong_at_any_size",
        "nothing hidden, said to be unknown": "unknown_of_nothing",
        "two effects, one found": "one",
        "two effects, both found, whatever limits the records state": "both_by_multiple",
    }
    rows = [(o.value, *(s.outcomes.get(o.value, 0) for s in found.values())) for o in Outcome]
    rows += [
        (what, *(f"{getattr(s, rate).hits} of {getattr(s, rate).of}" for s in found.values())) for what, rate in extra.items()
    ]
    return Table("What was said", ("single effects that must be found", *found), tuple(rows), caption="Numbers of cases.")


def _curve(bins: Sequence[Bin], x: Sequence[float]) -> Rates:
    ends = np.array([b.share.interval for b in bins]).reshape(-1, 2)
    return Rates(
        np.array(x), np.array([b.share.rate for b in bins]), ends[:, 0], ends[:, 1], np.array([float(b.share.of) for b in bins])
    )


def _sizes(s: Summary) -> tuple[Block, ...]:
    if not s.detection:
        return ()
    curves = {
        "right name or tie": _curve(s.detection, [math.sqrt(b.low * b.high) for b in s.detection]),
        "anything said": _curve(s.noticed, [math.sqrt(b.low * b.high) for b in s.noticed]),
    }
    caption = "Single effects of the catalogue, all machines, testable or not, by their size."
    return (figures.rates("Found, by size", "size in detection limits", curves, caption),)


def _calibration(s: Summary) -> tuple[Block, ...]:
    if not s.calibration:
        return ()
    curve = {"names and rivals": _curve(s.calibration, [b.mean for b in s.calibration])}
    caption = "How often a name was the hidden one, over the odds that were stated for it; on the line the odds are honest."
    return (figures.rates("Stated odds and truth", "stated odds", curve, caption, stated=True),)


def _confusion(rows: Sequence[Row], s: Summary) -> tuple[Block, ...]:
    blocks: list[Block] = []
    if pictured := _squares(rows):
        blocks.append(pictured)
    if s.confusions:
        table = tuple((c.hidden, c.named, c.machine, c.count, c.tied) for c in s.confusions[:CONFUSIONS])
        blocks.append(
            Table(
                "Most frequent confusions",
                ("hidden", "named", "machine", "cases", "of them declared as a tie"),
                table,
                caption="Singles and pairs of any size in which the hidden effect was not named and another was.",
            )
        )
    return tuple(blocks)


def _ties(rows: Sequence[Row], found: Mapping[str, Summary]) -> tuple[Block, ...]:
    """What became of every tie that held what was hidden, and each that its experiment did not resolve."""
    if not found["all"].ties:
        return ()
    counts = tuple((r.value, *(s.ties.get(r.value, 0) for s in found.values())) for r in Resolution)
    caption = (
        "Ties that hold what was hidden. The generator's machine runs what is recommended, with the same parameters, the same "
        "effect and fresh noise; the diagnosis is then made again with all records."
    )
    table = Table("After the recommended experiment", ("said then", *found), counts, caption=caption)
    open_ = [row for row in rows if resolution(row) in (Resolution.TIED, Resolution.LOST, Resolution.FAILED)]
    return (table, *([Text("Not resolved:\n\n" + "\n\n".join(map(_not_resolved, open_)))] if open_ else []))


def _not_resolved(row: Row) -> str:
    then = row["experiment"]
    return f"{said(row)}: {_causes_said(then['after']) if 'after' in then else then['fault'].strip()}"


def _squares(rows: Sequence[Row]) -> Picture | None:
    """Effect hidden against effect named, places apart, for single effects that something was said about."""
    said = [(row["truth"][0]["key"].partition("@")[0], row) for row in rows if row["kind"] == "single" and row.get("causes")]
    if not said:
        return None
    hidden = sorted({key for key, _ in said})
    named = sorted({c["key"].partition("@")[0] for _, row in said for c in row["causes"]} | set(hidden))
    counts = np.zeros((len(hidden), len(named)))
    for key, row in said:
        for c in row["causes"]:
            counts[hidden.index(key), named.index(c["key"].partition("@")[0])] += 1
    caption = "Rows: hidden; columns: named. The area of a square is the share of the names in its row; places are one."
    return figures.taken_for("Hidden and named", hidden, named, counts, caption)


def _seconds(s: Summary) -> tuple[Block, ...]:
    rows = tuple((x.kind, x.cases, x.median, x.p90, x.longest) for x in s.seconds)
    header = ("machine, kind", "cases", "median [s]", "90 % [s]", "longest [s]")
    return (Table("CPU time of a diagnosis", header, rows, digits=3),) if rows else ()


def _wrong(rows: Sequence[Row]) -> tuple[Block, ...]:
    """Confident wrong names, false alarms, and cases that came to no answer: none is left out."""
    wrong = [row for row in rows if row["kind"] == "single" and "undrawn" not in row and outcome(row) is Outcome.WRONG]
    alarms = [row for row in rows if row["kind"] == "nothing" and row.get("causes")]
    faults = [row for row in rows if "error" in row or "undrawn" in row]
    parts = (("Confident wrong names", wrong), ("Named though nothing was hidden", alarms), ("Without an answer", faults))
    return tuple(Text(f"{title}: {len(own)}.\n\n" + "\n\n".join(map(said, own))) for title, own in parts)


main = study(
    Cases(
        "hidden-effects", CASES, QUICK, LIMIT_SEED, f"at most {LIMIT_SEED} a seed",
        run=run, counted=by_machine, to_json=to_json, verdict=verdict, report=_report,
    )
)  # fmt: skip
