"""`workbench check`: is a loop safe on every machine that the records leave open? Proved, or refuted with a run that shows it.

On the identified model: errors that the records leave open move as they like within their boxes; certificates and parameter
sequences stand side by side. On the simulated plant: the worst machine within tolerances and fitted intervals is searched for.
"""

import math
from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from controllers.files import controller_content, controller_of
from controllers.pid_design import feedback_of, worst_margins
from controllers.scheduled_pid import ScheduledPID
from controllers.trial import Trial, along
from controllers.trial import on_model as on_the_model
from controllers.tuning import DEFAULT
from studies.arguments import Chosen, choose_controller, choose_plant, numbers, run_folder
from workbench.data import Channel, Dataset
from workbench.errors import InputError
from workbench.files import nullable, write_json
from workbench.intervals.errors import ErrorRegression
from workbench.intervals.model import IntervalModel
from workbench.lpv import LPVModel, PiecewiseLinear, Powers, load_model
from workbench.physics.controller import Controller
from workbench.provenance import provenance
from workbench.readers import read_file
from workbench.records import field, record
from workbench.report import figures
from workbench.report.blocks import Block, Provenance, Report, Section, Table
from workbench.report.page import write_report
from workbench.robustness.envelopes import Course, kernel
from workbench.robustness.falsify import Worst, at_random, fitted_box, load_counterexample, same, tolerance_box, worst_plant
from workbench.robustness.frequency import Closed, disk_margin
from workbench.robustness.limits import Limit, LoopLimits, Manoeuvre, load_limits, resolved
from workbench.robustness.loop import RATE_OF, UncertainLoop, check_law, driven, interpolated, machine_with_errors
from workbench.robustness.margins import Falsified, Margin, margin
from workbench.robustness.schedules import scheduled_margin
from workbench.robustness.sequences import Broken, Growth, Passage, load_sequence
from workbench.robustness.verdict import GROWS, Bound, Kept, Status, Verdict, bounds_kept, overall, refuting, stability
from workbench.simulation import Scenario, simulate

Say = Callable[[str], None]

GRID = 25  # of the schedule at which |S| is looked at
RUNS, STEPPED = 400, 40  # of the plant for each limit; of a law that is computed step by step
MOTION = 1.1  # ratio of bounds at which the search of a certificate in motion ends
FROZEN = ", frozen"  # what a claim says of a loop whose schedule stands still
KNOWN = 0.01  # widths of the model's span by which a schedule may leave it
SURE = 1e-3  # probability that a statement about sampling is wrong


@record
class Checked:
    """Verdicts, the blocks of the page that show them, and the files that show what failed."""

    verdicts: tuple[Verdict, ...]
    blocks: tuple[Block, ...]


@record
class Open:
    """A model, the boxes of its errors, and parameters (R p) within them, as shares, that may be the machine's."""

    model: LPVModel
    errors: tuple[IntervalModel, ...]
    possible: np.ndarray = field("R p", low=-1.0, high=1.0)


def check(options: Namespace, say: Say, progress: Say) -> int:
    """Verdicts on the model, on the plant, or on both; 1 where anything failed."""
    limits = load_limits(options.limits)
    if not (options.model or options.plant):
        mend = "give --model M.json --records R.csv for proofs, --plant PLANT for a search on the simulated machine, or both"
        raise InputError("check on what?", mend=mend)
    if bool(options.model) != bool(options.records):
        raise InputError("--model and --records go together", mend="the records say what the model leaves open")
    if options.fitted and not options.plant:
        raise InputError("--fitted is for a search on the plant", mend="give --plant as well")
    chosen = choose_plant(options.plant) if options.plant else None
    base = chosen.base if chosen else ""
    controller = choose_controller(options.controller, base)
    law = controller.law
    model = load_model(options.model) if options.model else None
    records = [read_file(path) for path in options.records]
    folder = run_folder(options.out, "check")
    parts: list[tuple[str, Checked]] = []
    left = open_errors(model, records, options) if model is not None else None
    if model is not None and isinstance(law, ScheduledPID):
        check_law(model, law)
    progress("one run of the loop")
    trial = _tried(law, limits, model, chosen, options.limits)
    say(f"LOST: {trial.sentence}" if trial.lost else trial.sentence)
    if model is not None and left is not None:
        for line in _described(left.errors):
            say(line)
        own = on_model(left, law, limits, chosen, folder, options.nodes, options.rate, progress)
        parts.append(("On the identified model", own))
    if chosen is not None and model is None and any((limits.stable, limits.margin, limits.sensitivity, limits.disk)):
        said = "asked of the loop itself: give --model and --records"
        loop = [Verdict(name, "no model", Status.UNDECIDED, math.nan, "", said) for name in claimed(replace(limits, limits=()))]
        parts.append(("Not checked", Checked(tuple(loop), ())))
    if chosen is not None:
        parts.append(("On the simulated plant", on_plant(chosen, law, limits, options, folder, progress, controller.own)))
    verdicts = after_trial([v for _, part in parts for v in part.verdicts], trial)
    for verdict in verdicts:
        say(str(verdict))
    status = overall(verdicts)
    say(f"{status.value}: {counted(verdicts)}")
    files = [*controller.files, options.limits, *options.records, *([options.model] if options.model else []), *options.fitted]
    source = provenance(_configuration(options), [*files, *(chosen.files if chosen else ())], options.seed)
    content = {"status": status.value, "verdicts": [v.to_dict() for v in verdicts], "trial": vars(trial), "provenance": source}
    for path in (folder / "check.json", options.json):
        if path:
            write_json(path, nullable(content))
    sections = [Section("Verdicts", (verdict_table(verdicts),))]
    sections += [Section(title, part.blocks) for title, part in parts if part.blocks]
    sections.append(Section("Provenance", (Provenance(source),)))
    page = write_report(Report(f"Check of {law.name}", headline(law.name, status, verdicts, trial), tuple(sections)), folder)
    say(f"report: {page}")
    return 1 if status is Status.FAILED else 0


def _configuration(options: Namespace) -> dict[str, Any]:
    keys = ("controller", "limits", "model", "records", "plant", "fitted", "lags", "bound", "nodes", "rate", "runs")
    return {key: getattr(options, key) for key in keys}


def counted(verdicts: Sequence[Verdict]) -> str:
    """How many of each."""
    number = {status: sum(v.status is status for v in verdicts) for status in Status}
    return ", ".join(f"{count} {status.value}" for status, count in number.items() if count)


def _tried(law: Any, limits: LoopLimits, model: LPVModel | None, chosen: Chosen | None, file: str) -> Trial:
    """One run on the most truthful simulation at hand: of the plant, through what is asked; without one of the model."""
    if chosen is None:
        assert model is not None
        return on_the_model(law, model)
    if limits.run is None:
        said = "no limits of signals are asked: nothing to try on the plant"
        raise InputError(said, file=file, mend="give [run] and [limits.SIGNAL], or leave --plant out")
    own = limits.run.scenario(chosen.plant, law)
    references = np.column_stack([own.references[name] for name in law.references])
    return along(law, chosen.plant, references, len(references) // 2, dict(own.start))


def after_trial(verdicts: Sequence[Verdict], trial: Trial) -> list[Verdict]:
    """The verdicts beside a run: one that was lost is a claim that failed, and a proof of frozen points says what it is."""
    if not trial.lost:
        return list(verdicts)
    lost = Verdict("the loop holds along one run", trial.where, Status.FAILED, math.nan, "", trial.sentence)
    told = [
        replace(v, claim=f"{v.claim}{'' if FROZEN in v.claim else FROZEN}", sentence=f"{v.sentence}; {trial.sentence}")
        if v.claim.startswith("stable") and v.status is not Status.FAILED
        else v
        for v in verdicts
    ]
    return [*told, lost]


def headline(name: str, status: Status, verdicts: Sequence[Verdict], trial: Trial | None = None) -> str:
    """The verdict in one paragraph."""
    said = {
        Status.PROVED: f"PROVED: {name} keeps everything that was asked, whatever the records leave open of the model, while "
        "no command is at its stop.",
        Status.PASSED: f"PASSED: nothing that was asked of {name} could be broken. What is marked PASSED was tried, not proved.",
        Status.UNDECIDED: f"UNDECIDED: something asked of {name} is neither proved nor refuted. More records narrow the boxes, "
        "a calmer law (design with a lower --sensitivity) narrows the band, and a limit outside of the band is proved.",
        Status.FAILED: f"FAILED: {name} does not keep what was asked; a stored run shows it.",
    }[status]
    worst = [v for v in verdicts if v.status is status]
    said = f"LOST: {trial.sentence}. {said}" if trial and trial.lost else said
    return f"{said} {counted(verdicts)}.\n\n" + "\n\n".join(f"{v.claim} ({v.of}): {v.sentence}." for v in worst[:4])


def verdict_table(verdicts: Sequence[Verdict], title: str = "Verdicts") -> Table:
    rows = tuple((v.claim, v.of, v.status.value, v.margin, v.unit, v.sentence, v.witness) for v in verdicts)
    return Table(
        title, ("claim", "of", "verdict", "margin", "unit", "what it rests on", "file"), rows, digits=3,
        caption="PROVED: a certificate, checked in outward-rounded arithmetic, or a bound that needs no solver and has its own "
        "rounding in it. PASSED: no counterexample was found, which proves nothing. FAILED: the file named runs again with "
        "workbench simulate --replay. UNDECIDED: neither; the margin is what is missing to a proof.",
    )  # fmt: skip


# ---- on the identified model --------------------------------------------------------------------------------------------


def open_errors(model: LPVModel, records: Sequence[Any], options: Namespace) -> Open:
    """What the records leave open of the model's errors."""
    return opened(ErrorRegression(options.lags, numbers(options.bound, "--bound")), model, Dataset(tuple(records)))


def opened(method: ErrorRegression, model: LPVModel, records: Dataset) -> Open:
    """The boxes, and constant parameters within them that no record refutes."""
    errors = method.fit(model, records)
    return Open(model, errors, method.possible(model, records, errors))


def _described(errors: Sequence[IntervalModel]) -> list[str]:
    """A line for each box."""
    said = []
    for own in errors:
        box = own.modes[0].box
        low, high = box.centre - box.radius, box.centre + box.radius
        ends = [f"{low[i]:+.3g} to {high[i]:+.3g} times {name}" for i, name in enumerate(own.form.names[:-1])]
        said.append(f"{own.output.name}: {', '.join(ends)}; beyond that up to {box.radius[-1]:.3g} {own.output.unit}".rstrip())
    return said


def on_model(
    left: Open, law: Any, limits: LoopLimits, chosen: Chosen | None, folder: Path, nodes: int, rate: float | None, progress: Say
) -> Checked:  # fmt: skip
    """Stability at nodes of the schedule and, with a rate [1/s], in motion; |S|; disk margin; and limits along the run."""
    model, of = left.model, f"model {left.model.name}"
    if not isinstance(law, ScheduledPID):
        how = "is an equation of its own" if isinstance(law, Controller) else "is computed step by step"
        said = f"{law.name} {how}: no linear law to prove anything of; it is checked on the plant alone"
        return Checked(tuple(Verdict(claim, of, Status.UNDECIDED, math.nan, "", said) for claim in claimed(limits)), ())
    check_law(model, law)
    run = _prepared(left, law, limits, chosen) if limits.limits and limits.run is not None else None
    verdicts, blocks = [], []
    if limits.stable or limits.margin is not None:
        own, picture = _stability(left, law, limits, folder, nodes, rate, of, progress)
        verdicts, blocks = [*verdicts, *own], [*blocks, *picture]
    if limits.sensitivity is not None:
        verdicts.append(_sensitivity(model, law, limits.sensitivity, of))
    if limits.disk is not None:
        verdicts.append(_disk(left, law, limits.disk, nodes, of))
    if run is not None:
        own, pictures = _bounds(left, law, limits, run, folder, of, progress)
        verdicts, blocks = [*verdicts, *own], [*blocks, *pictures]
    return Checked(tuple(verdicts), tuple(blocks))


def claimed(limits: LoopLimits) -> list[str]:
    """Every claim of a file of limits, in words."""
    of_loop = {"stable": limits.stable, "margin": limits.margin, "peak |S|": limits.sensitivity, "disk margin": limits.disk}
    return [name for name, asked in of_loop.items() if asked] + [f"{x.signal}: {' and '.join(x.kept)}" for x in limits.limits]


def _stability(
    left: Open, law: ScheduledPID, limits: LoopLimits, folder: Path, nodes: int, rate: float | None, of: str, progress: Say
) -> tuple[list[Verdict], list[Block]]:  # fmt: skip
    model, errors = left.model, left.errors
    at = [None] if model.schedule is None else np.linspace(model.span[0], model.span[1], nodes).tolist()
    needed = max(limits.margin or 1.0, 1.0 if limits.stable else 0.0)
    verdicts, found = [], []
    for rho in at:
        where = f" at {_told(model, rho)}" if rho is not None else ""
        progress(f"stability{where}")
        claim = f"stable{where}" + FROZEN * bool(where) + f" in boxes {needed:g} times as wide" * (needed != 1.0)
        whole = driven(machine_with_errors(model, errors, rho), law, rho)
        loop = whole.undriven()
        # beyond the boxes themselves nothing is known of what the records leave open: there sequences within them refute
        moving, constant = limits.moving or needed != 1.0, left.possible[:, whole.moving] if needed >= 1.0 else None
        try:
            own = margin(loop)
        except InputError as reason:
            path = folder / f"sequence-{len(verdicts) + 1}.json"
            verdicts.append(_without_margin(loop, constant, moving, claim, of, path, reason))
            continue
        found.append((rho, own))
        verdict = stability(own, needed, claim, of, possible=constant, moving=moving)
        if verdict.status is Status.FAILED and (lost := refuting(own, needed, constant, moving)) is not None:
            path = folder / f"sequence-{len(verdicts) + 1}.json"
            Growth(claim, own.loop, lost, needed).save(path)
            verdict = _replayed(verdict, path)
        verdicts.append(verdict)
    if rate is not None:
        verdicts.append(_in_motion(model, errors, law, rate, nodes, needed, of, progress))
    return verdicts, _margin_blocks(model, found, needed)


def _without_margin(
    loop: UncertainLoop, constant: np.ndarray | None, moving: bool, claim: str, of: str, path: Path, reason: InputError
) -> Verdict:  # fmt: skip
    """A loop that has no margin: lost in the middle of the boxes, or where the search came to nothing."""
    middle = np.zeros((1, len(loop.lam)))
    tried = middle if constant is None else np.vstack([constant, middle]) if moving else constant
    radii = np.abs(np.linalg.eigvals(loop.at(tried))).max(axis=1)
    worst = int(radii.argmax())
    if radii[worst] < GROWS:
        return Verdict(claim, of, Status.UNDECIDED, math.nan, "", f"no margin was found: {reason.problem}")
    lost = Falsified(1.0, tried[worst][None], 1.0)
    lost = replace(lost, growth=lost.replay(loop))
    Growth(claim, loop, lost).save(path)
    who = "constant parameters that no record refutes let" if tried[worst].any() else "the middle of the boxes lets"
    said = f"{who} a state grow, by {lost.growth:.4g} at every sample"
    return _replayed(Verdict(claim, of, Status.FAILED, 1.0 - lost.growth, "", said), path)


def _in_motion(
    model: LPVModel, errors: Sequence[IntervalModel], law: ScheduledPID, rate: float, nodes: int, needed: float, of: str,
    progress: Say,
) -> Verdict:  # fmt: skip
    """Stability while the schedule moves: of the machine that is linear between nodes, and proved where the model is that."""
    schedule = model.schedule
    if schedule is None:
        raise InputError(f"--rate {rate:g}, but the model has no schedule", mend="leave --rate out")
    claim = f"stable while {schedule.name} moves by up to {rate:g} {schedule.unit}/s"
    progress(claim)
    bases = [basis for basis in (law.basis if law.schedule else None, model.basis) if isinstance(basis, PiecewiseLinear)]
    kinks = np.concatenate([law.span if law.schedule else np.empty(0), *(basis.knots for basis in bases)])
    inside = np.unique(kinks[(kinks > model.span[0]) & (kinks < model.span[1])])
    rho = np.union1d(np.linspace(model.span[0], model.span[1], max(nodes, 3)), inside)
    rho = rho[np.append(True, np.diff(rho) > 1e-6 * np.ptp(rho))]
    at = interpolated([machine_with_errors(model, errors, float(value)) for value in rho], rho, law)
    off = 0.0
    for middle in 0.5 * (rho[1:] + rho[:-1]):
        own = driven(machine_with_errors(model, errors, float(middle)), law, float(middle)).A
        off = max(off, float(np.abs(at(float(middle)).A - own).max() / np.abs(own).max()))
    try:
        found = scheduled_margin(at, rho, rate * model.dt, inside, MOTION)
    except InputError as reason:
        return Verdict(claim, of, Status.UNDECIDED, math.nan, "", f"no margin was found: {reason.problem}")
    low, high, standing = found.certified.kappa, found.falsified.kappa, found.standing.kappa
    said = (
        f"P({schedule.name}) falls at every sample up to boxes {low:.3g} times as wide; moving parameters refute it from "
        f"{high:.3g} times on ({standing:.3g} while it stands still)"
    )
    linear = isinstance(model.basis, PiecewiseLinear) or (
        isinstance(model.basis, Powers) and set(model.basis.exponents) <= {0, 1}
    )
    delays = max(term.delay for term in model.terms)
    if linear and not delays:
        if low >= needed and found.certified.holds(found.loop):
            return Verdict(claim, of, Status.PROVED, low - needed, "boxes", said)
        return Verdict(claim, of, Status.UNDECIDED, low - needed, "boxes", said)
    said += f"; but of the machine that is linear between {len(rho)} values, {100 * off:.2g} % off halfway between two"
    said += f", and without the delays of the model's schedule of up to {delays} samples" * (delays > 0)
    return Verdict(claim, of, Status.UNDECIDED, low - needed, "boxes", said)


def _told(model: LPVModel, rho: float) -> str:
    """The schedule at a value."""
    assert model.schedule is not None
    return f"{model.schedule.name} = {rho:.4g} {model.schedule.unit}".rstrip()


def _replayed(verdict: Verdict, path: Path) -> Verdict:
    """The verdict with its file, where the file gives the same number again."""
    stored = load_sequence(path)
    if stored.breaks and same(stored.again(lambda content: controller_of(content, path)), stored.value):
        return verdict.shown_by(path.name)
    return replace(verdict, status=Status.UNDECIDED, sentence=f"{verdict.sentence}; the stored run did not give it again")


def _margin_blocks(model: LPVModel, found: Sequence[tuple[float | None, Margin]], needed: float) -> list[Block]:
    if not found:
        return []
    said = (
        "How many times as wide the boxes may be. Proved: parameters that move as they like at every sample. Refuted: a sequence "
        "of parameters that the loop does not survive. Standing still: constant parameters, which say nothing of moving ones. "
        "All for a schedule that stands still."
    )
    columns = {
        "proved": [m.certified.kappa for _, m in found],
        "refuted": [m.falsified.kappa for _, m in found],
        "standing still": [m.frozen.kappa for _, m in found],
    }
    if model.schedule is None or len(found) < 2:
        return [Table("Margins", ("margin", "boxes"), tuple((name, values[0]) for name, values in columns.items()), said)]
    curves = {name: np.array(values) for name, values in columns.items()} | {"asked": np.array(needed)}
    over = figures.Trace(model.schedule, np.array([rho for rho, _ in found], dtype=float))
    return [figures.over_schedule("Margins over the schedule", over, {"boxes, times as wide": curves}, said)]


def _sensitivity(model: LPVModel, law: ScheduledPID, asked: float, of: str) -> Verdict:
    grid = [None] if model.schedule is None else list(np.linspace(model.span[0], model.span[1], GRID))
    found = worst_margins(law, [model], grid, DEFAULT)
    peaks, claim = found.sensitivity, f"peak |S| at most {asked:g}"
    if found.radius.max() >= 1.0:
        return Verdict(claim, of, Status.FAILED, math.nan, "", "the loop of the model itself is not stable: it has no |S|")
    largest, worst = float(peaks.max()), grid[int(peaks.argmax())]
    where = "" if worst is None else f", at {_told(model, float(worst))}"
    status = Status.PASSED if largest <= asked else Status.FAILED
    said = f"the largest |S| of the model itself is {largest:.3g} at {len(grid)} schedule values{where}"
    return Verdict(claim, of, status, asked - largest, "", said)


def _disk(left: Open, law: ScheduledPID, asked: float, nodes: int, of: str) -> Verdict:
    """The least disk margin at the plant input, of constant parameters that no record refutes."""
    model, least, middle = left.model, (np.inf, None), np.inf
    tried = np.vstack([np.zeros((1, left.possible.shape[1])), left.possible])
    for rho in [None] if model.schedule is None else np.linspace(model.span[0], model.span[1], nodes).tolist():
        machine, answer = machine_with_errors(model, left.errors, rho), feedback_of(law, rho)
        for number, delta in enumerate(tried):
            S = Closed.of(machine.at(delta, law.actuated, law.measured), answer).input_sensitivity
            own = disk_margin(S, least[0] if number else np.inf) if S.stable else 0.0
            middle = min(middle, own) if number == 0 else middle
            least = min(least, (own, rho), key=lambda pair: pair[0]) if number else least
    where = f", at {_told(model, least[1])}" if least[1] is not None else ""
    status = Status.PASSED if least[0] >= asked else Status.FAILED
    tried_of = f"the worst of {len(left.possible)} constant parameters{where}"
    said = f"{least[0]:.3g} for {tried_of}, {middle:.3g} in the middle of the boxes"
    return Verdict(f"disk margin at least {asked:g}", of, status, least[0] - asked, "", said)


@record
class _Run:
    """Set-points (N nr) and the schedule (N) of a run, the bounds asked of it, and what it is called.

    initial (nr 2): between which the set-points lie before the run.
    """

    references: np.ndarray = field("N nr")
    initial: np.ndarray = field("nr 2")
    rho: np.ndarray = field("N")
    bounds: tuple[Bound, ...]
    along: str


def _prepared(left: Open, law: ScheduledPID, limits: LoopLimits, chosen: Chosen | None) -> _Run:
    """What the limits ask, checked before anything is computed. Raises InputError for what the loop does not have."""
    run, model = limits.run, left.model
    assert run is not None
    if run.start and chosen is None:
        raise InputError("start is of a plant", file="[run]", mend="leave it out, or give --plant: a model begins at rest")
    references = _references(run, law)
    rho = _schedule(model, law, run, chosen, len(references))
    channels, bounds = {c.name: c for c in (*model.outputs, *model.inputs)}, []
    for limit in limits.limits:
        place = f"[limits.{limit.signal}]"
        if limit.signal not in (*law.measured, *law.actuated):
            known = ", ".join((*law.measured, *law.actuated))
            raise InputError("not a signal of this loop", file=place, mend=f"it has {known}")
        unit = channels[limit.signal].unit
        if limit.unit and unit and limit.unit != unit:
            raise InputError(f"in {limit.unit}, the model has it in {unit}", file=place, mend=f"give the bounds in {unit}")
        if "settling" in limit.kept and limit.signal not in law.measured:
            raise InputError("settling needs a set-point", file=place, mend=f"only {', '.join(law.measured)} have one")
        own = _asked(limit, law, references, unit)
        if empty := [b.claim for b in own if not (np.isfinite(b.low) | np.isfinite(b.high)).any()]:
            raise InputError(f"{empty[0]}: asks nothing within the run", file=place, mend="a longer run, or an earlier begin")
        bounds += own
    schedule = model.schedule
    along = "" if schedule is None else f", along {schedule.name} from {rho[0]:.4g} to {rho[-1]:.4g} {schedule.unit}"
    initial = run.rested(law, references[0])
    return _Run(references, initial, rho, tuple(bounds), along)


def _bounds(
    left: Open, law: ScheduledPID, limits: LoopLimits, run: _Run, folder: Path, of: str, progress: Say
) -> tuple[list[Verdict], list[Block]]:  # fmt: skip
    assert limits.run is not None
    of = f"{of}{run.along}"
    clipped = [bound for bound in run.bounds if _by_the_law(law, bound)]
    wanted = [bound for bound in run.bounds if not _by_the_law(law, bound)]
    verdicts = []
    if clipped:
        said = "the law itself never commands beyond it"
        verdicts.append(Verdict(", ".join(bound.claim for bound in clipped), of, Status.PROVED, 0.0, "", said))
    stops = _stops(law, len(run.references))
    rates = tuple(dict.fromkeys(b.signal.removeprefix(RATE_OF) for b in (*wanted, *stops) if b.signal.startswith(RATE_OF)))
    noise, model = limits.run.seed is not None, left.model
    passage = Passage(model, left.errors, controller_content(law), run.rho, run.references, run.initial, noise, rates)
    progress("the loop along the run")
    try:
        own = passage.course(law)
        kept = bounds_kept(own, wanted, stops, of=of, dt=law.dt, possible=left.possible, moving=limits.moving, progress=progress)
    except InputError as reason:
        lost = [Verdict(bound.claim, of, Status.UNDECIDED, math.nan, bound.unit, reason.problem) for bound in wanted]
        return [*verdicts, *lost], []
    for number, k in enumerate(kept, 1):
        verdict = k.verdict
        if verdict.status is Status.FAILED:
            verdict = _replayed(verdict, _broken(own, k, passage, folder / f"passage-{number}.json"))
        verdicts.append(verdict)
    return verdicts, _envelope_pictures(own, kept, {c.name: c for c in (*model.outputs, *model.inputs)}, law.dt)


def _references(run: Manoeuvre, law: Any) -> np.ndarray:
    """Set-points (N, nr) in the law's order."""
    own = run.references(law, law.dt)
    return np.column_stack([own[name] for name in law.references])


def _schedule(model: LPVModel, law: Any, run: Manoeuvre, chosen: Chosen | None, N: int) -> np.ndarray:
    """What the schedule does: as on the nominal plant, and without one once over all that the model knows."""
    if model.schedule is None:
        return np.zeros(N)
    if chosen is None:
        return np.linspace(model.span[0], model.span[1], N)
    quiet = replace(run, seed=None).scenario(chosen.plant, law)
    every = max(1, round(law.dt / chosen.plant.dt))
    rho = simulate(chosen.plant, law, quiet, bumpless=True).experiment[model.schedule.name][::every][:N]
    if model.outside(rho) > KNOWN:
        problem = f"{model.schedule.name} goes from {rho.min():.4g} to {rho.max():.4g} in this run"
        known = f"the model knows {model.span[0]:.4g} to {model.span[1]:.4g}"
        raise InputError(problem, file="[run]", mend=f"a shorter run, or another start: {known}")
    return np.clip(rho, *model.span)


def _asked(limit: Limit, law: Any, references: np.ndarray, unit: str) -> list[Bound]:
    """A limit as bounds at every sample."""
    N, unit = len(references), limit.unit or unit
    t = law.dt * np.arange(N)
    since = t >= limit.begin - 1e-6 * law.dt
    none, found = np.full(N, np.inf), []
    for kind in limit.kept:
        value = getattr(limit, "band" if kind == "settling" else kind)
        told = f"{limit.signal}: {kind if kind != 'settling' else f'within the band {limit.settling:g} s after a step'}"
        claim = f"{told} {value:g} {unit}" + "/s" * (kind == "rate")
        if kind == "low":
            found.append(Bound(claim, limit.signal, unit, np.where(since, value, -np.inf), none))
        elif kind == "high":
            found.append(Bound(claim, limit.signal, unit, -none, np.where(since, value, np.inf)))
        elif kind == "rate":
            inner = np.where(since & np.append(False, since[:-1]), value, np.inf)
            found.append(Bound(claim, f"{RATE_OF}{limit.signal}", f"{unit}/s", -inner, inner))
        else:
            r = references[:, law.measured.index(limit.signal)]
            moved = np.flatnonzero(np.diff(r))
            arrived = (t[moved[-1] + 1] if len(moved) else 0.0) + limit.settling
            late = since & (t >= arrived - 1e-6 * law.dt)
            found.append(Bound(claim, limit.signal, unit, np.where(late, r - value, -np.inf), np.where(late, r + value, np.inf)))
    return found


def _by_the_law(law: ScheduledPID, bound: Bound) -> bool:
    """Whether a bound on a command is no tighter than the law's own limit."""
    name = bound.signal.removeprefix(RATE_OF)
    if name not in law.actuated:
        return False
    i = law.actuated.index(name)
    low, high = (-law.rate[i], law.rate[i]) if bound.signal.startswith(RATE_OF) else (law.low[i], law.high[i])
    return bool(np.all(bound.low <= low) and np.all(high <= bound.high))


def _stops(law: ScheduledPID, N: int) -> list[Bound]:
    """Where the law's own limits begin to act."""
    found = []
    for name, low, high, rate in zip(law.actuated, law.low, law.high, law.rate, strict=True):
        if np.isfinite(low) or np.isfinite(high):
            found.append(Bound(f"{name} between its stops", name, law.unit(name), np.full(N, low), np.full(N, high)))
        if np.isfinite(rate):
            found.append(Bound(f"{name} below its rate", f"{RATE_OF}{name}", law.unit(name), np.full(N, -rate), np.full(N, rate)))
    return found


def _broken(own: Course, kept: Kept, passage: Passage, path: Path) -> Path:
    """The file of the run that breaks a bound."""
    k, bound, run = kept.sample, kept.bound, kept.run
    value = float(run.v[0, k, own.number(bound.signal)])
    low, high = float(bound.low[k]), float(bound.high[k])
    return Broken(bound.claim, passage, bound.signal, k, value, run.delta[0], run.before[0], run.share[0], low, high).save(path)


def _envelope_pictures(own: Course, kept: Sequence[Kept], channels: dict[str, Channel], dt: float) -> list[Block]:
    """Every signal with a bound: band, worst runs, bounds."""
    outer = kernel(own)
    run = outer.nominal.v
    t, blocks = dt * np.arange(len(run)), []
    for signal in dict.fromkeys(k.bound.signal for k in kept):
        i = own.number(signal)
        mine = [k for k in kept if k.bound.signal == signal]
        runs = {f"worst for {k.bound.claim.split(': ')[-1]}": k.run.v[0][:, i] for k in mine}
        limits = {
            f"{side} limit": pick([getattr(k.bound, side) for k in mine], axis=0)
            for side, pick in (("low", np.max), ("high", np.min))
        }
        name = signal.removeprefix(RATE_OF)
        unit = channels[name].unit + "/s" * signal.startswith(RATE_OF)
        caption = (
            "The band holds every run from the rest of any machine of the boxes, whatever the parameters do within them at every "
            "sample, while no command is at its stop. Coloured: the runs that come nearest to a limit, with parameters that may "
            "refute it."
        )
        blocks.append(
            figures.guaranteed(
                f"{signal} along the run", t, Channel(signal, unit, "output"), run[:, i], outer.low[:, i],
                outer.high[:, i], runs, {n: v for n, v in limits.items() if np.isfinite(v).any()}, caption,
            )
        )  # fmt: skip
    return blocks


# ---- on the simulated plant ---------------------------------------------------------------------------------------------


def on_plant(
    chosen: Chosen, law: Any, limits: LoopLimits, options: Namespace, folder: Path, progress: Say, own: str = ""
) -> Checked:  # fmt: skip
    """For each limit the worst machine within tolerances and fitted intervals; own: file.py:NAME of the user's own law."""
    if not limits.limits or limits.run is None:
        said = "no limits of signals are asked: nothing to try on the plant"
        raise InputError(said, file=options.limits, mend="give [run] and [limits.SIGNAL], or leave --plant out")
    plant, of = chosen.plant, f"plant {chosen.plant.name}"
    box = {str(d): d for d in tolerance_box(plant)}
    for path in options.fitted:
        box |= {str(d): d for d in fitted_box(plant, path)}
    scenario = limits.run.scenario(plant, law)
    compiled = isinstance(law, Controller)
    runs = options.runs or (RUNS if compiled else STEPPED)
    content = {"own": own} if own else controller_content(law)
    verdicts, worst = [], []
    for number, limit in enumerate(resolved(limits.limits, plant, law), 1):
        name = f"{limit.signal}: {' and '.join(limit.kept)}"
        progress(f"worst machine for {name}")
        found = worst_plant(plant, law, scenario, [limit], tuple(box.values()), runs=runs, seed=options.seed)
        worst.append(found)
        said = f"{found.sentence}; the worst of {found.runs} machines within {len(box)} intervals"
        unit = limit.unit_of(found.bound)
        if not found.broken:
            verdicts.append(Verdict(name, of, Status.PASSED, -found.excess, unit, said))
            continue
        path = found.counterexample(chosen.base, content).save(folder / f"counterexample-{number}.json")
        again = load_counterexample(path).replay(plant, law)
        status = Status.FAILED if again.same else Status.UNDECIDED
        verdicts.append(Verdict(name, of, status, -found.excess, unit, said, path.name))
    blocks: list[Block] = [_machine_table(worst, box)]
    if not compiled:
        progress("machines at random")
        verdicts.append(_sampled(plant, law, scenario, limits, tuple(box.values()), runs, options.seed, of))
    return Checked(tuple(verdicts), (*blocks, *_worst_pictures(plant, law, scenario, worst)))


def _sampled(plant: Any, law: Any, scenario: Scenario, limits: LoopLimits, box: tuple, runs: int, seed: int, of: str) -> Verdict:
    """What random machines say: a statement about sampling, not about the worst case."""
    found = at_random(plant, law, scenario, limits.limits, box, runs=runs, seed=seed)
    share = -math.log(SURE) / found.runs
    if found.broken:
        said = f"{found.sentence}; among {found.runs} random machines"
        return Verdict("limits, machines drawn at random", of, Status.UNDECIDED, -found.excess, "", said)
    said = (
        f"none of {found.runs} random machines breaks a limit: with a confidence of {100 * (1 - SURE):g} % less than "
        f"{100 * share:.2g} % of machines drawn like these do; about sampling, not about the worst case"
    )
    return Verdict("limits, machines drawn at random", of, Status.PASSED, math.nan, "", said)


def _machine_table(worst: Sequence[Worst], box: dict) -> Table:
    """Where in its interval each number of the worst machines lies."""
    rows = tuple((name, d.low, d.high, *(found.point.get(name, d.low) for found in worst)) for name, d in box.items())
    header = ("number", "from", "to", *(f"worst for {found.limit.signal} {found.bound}" for found in worst))
    return Table("The worst machines", header, rows, "Found by search, within the tolerances and fitted intervals.")


def _worst_pictures(plant: Any, law: Any, scenario: Scenario, worst: Sequence[Worst]) -> list[Block]:
    """The signal of each limit on the nominal machine and on the worst one."""
    blocks: list[Block] = []
    before = simulate(plant, law, scenario, bumpless=True, cut=True).experiment
    for found in worst:
        after = simulate(
            plant, law, scenario, parameters=found.parameters, effects=found.effects, substeps=found.substeps,
            bumpless=found.bumpless, cut=True,
        ).experiment  # fmt: skip
        signal, N = found.limit.signal, min(len(before), len(after))
        t = before.t[:N]
        since = t >= found.limit.begin
        limits = {
            f"{side} limit": np.where(since, value, np.nan)
            for side in ("low", "high")
            if math.isfinite(value := getattr(found.limit, side))
        }
        if found.bound == "settling":
            reference = before[dict(zip(law.measured, law.references, strict=False))[signal]][:N]
            arrived = since & (t >= found.limit.settling + t[np.append(0, np.flatnonzero(np.diff(reference)) + 1)[-1]])
            for side, way in (("low", -1.0), ("high", 1.0)):
                limits[f"{side} end of the band"] = np.where(arrived, reference + way * found.limit.band, np.nan)
        blocks.append(
            figures.beside_limits(
                f"{signal} on the worst machine for its {found.bound}", t, next(c for c in before.channels if c.name == signal),
                {"nominal machine": before[signal][:N], "worst machine": after[signal][:N]}, limits,
                f"{found.sentence}.",
            )
        )  # fmt: skip
    return blocks
