"""`workbench design`: from an identified model to a controller file, its margins, and what to do with it."""

from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from controllers.compensation import ALONG, Compensated, compensated, moved_by
from controllers.decided import Decided, decided
from controllers.designs import MPCDesign, ScheduledPIDDesign, command_limits, setpoint_of
from controllers.files import load_controller, save_controller
from controllers.mpc import MPC, design_mpc
from controllers.nmpc import SOLVERS, design_nmpc
from controllers.pictures import POINTS, design_pictures
from controllers.pid_design import PIDDesign
from controllers.scheduled_pid import ScheduledPID
from controllers.tables import with_csv
from controllers.tube import taken
from studies.arguments import Chosen, choose_plant, is_plant, names, numbers, parse_numbers, run_folder
from studies.cli import DONE
from studies.referee import handed_out
from workbench.answers.answer import PLANT_FILE
from workbench.answers.check import run_badge
from workbench.answers.comparison import curve_picture
from workbench.answers.verdict import ended
from workbench.errors import InputError, check_known
from workbench.files import nullable, read_json, write_json, write_text
from workbench.hammerstein import Model, core_of, curves_of, load_either
from workbench.intervals.errors import ErrorRegression
from workbench.intervals.model import IntervalModel
from workbench.lpv import LPVModel, load_model
from workbench.physics.linearised import linearised
from workbench.provenance import provenance
from workbench.report.blocks import Badge, Brief, Picture, Report, Section, Standing, Table
from workbench.report.page import write_report
from workbench.robustness.frozen import Margins, worst_margins
from workbench.robustness.limits import load_limits
from workbench.sources import read
from workbench.steady import rests
from workbench.verification.trial import OVERSHOOT, Trial, tried

Say = Callable[[str], None]
GAINED = 0.02  # of the deviations that gains must take off by moving, not to be called the same as fixed ones
KINDS = ("scheduled-pid", "pid", "mpc", "nmpc")


def design(options: Namespace, say: Say, progress: Say) -> int:
    """Design the law that was asked for and write its files."""
    kind = check_known("controller", options.kind, KINDS)
    model, files = _model(options)
    if not (options.tube or options.until) and options.records:
        raise InputError("--records is for --tube and --until", mend="give one of them too, or leave --records out")
    if kind != "mpc" and options.tube:
        raise InputError("--tube is for mpc", mend="leave it out: only a linear prediction has a tube")
    if kind in ("mpc", "nmpc") and options.diagnosis:
        raise InputError("--diagnosis is for PIDs", mend=f"design {kind} without it, or scheduled-pid with it")
    if options.early and not options.diagnosis:
        raise InputError("--early is for what a --diagnosis has named", mend="leave it out, or give --diagnosis")
    if kind in ("mpc", "nmpc"):
        return _design_planning(options, kind, model if isinstance(model, LPVModel) else load_model(options.model), say, progress)
    return _design_pid(options, kind, model, files, say, progress)


def _model(options: Namespace) -> tuple[Model, Sequence[str]]:
    """The model in a file, or that of a plant about its start, and the files that were read."""
    if is_plant(options.model):
        if options.dt is not None and not 0.0 < options.dt < np.inf:
            raise InputError(f"--dt {options.dt:g}", mend="the sample time of the law in s, above 0")
        if options.kind in ("mpc", "nmpc"):
            mend = "identify one from records, which say how its errors go on"
            raise InputError(f"{options.kind} on a plant's linear model", file=options.model, mend=mend)
        chosen = choose_plant(options.model)
        return linearised(chosen.plant, options.dt), chosen.files
    if options.dt:
        raise InputError("--dt is for a plant as --model", mend="leave it out: a model has its sample time")
    return load_either(options.model), (options.model,)


def _design_pid(options: Namespace, kind: str, whole: Model, files: Sequence[str], say: Say, progress: Say) -> int:
    """Writes <kind>.json, gains.csv, margins.csv and design.json."""
    chosen, model = _tried_on(options), core_of(whole)
    wanted = _wanted(options, kind, model)
    until = _until(options, wanted, whole, say, progress)
    wanted = replace(wanted, sensitivity=until.taken.sensitivity) if until else wanted
    found = wanted.design(whole, progress)
    progress("one run of the loop")
    found, trial = wanted.calmed(found, whole, chosen.plant if chosen else None)
    became: tuple[Compensated, ...] = ()
    if options.diagnosis and chosen and not trial.lost:
        content, early = read_json(options.diagnosis), options.early
        law, became = compensated(found.law, chosen.plant, content, options.diagnosis, progress, early=early)
        found, trial = replace(found, law=law), tried(law, whole, chosen.plant, steps=wanted.steps)
    code = _told(options, trial, model, say)
    bounds, models = found.bounds, [model, *(load_model(path) for path in options.robust_to)]
    folder = run_folder(options.out, "design")
    path = save_controller(found.law, folder / f"{kind}.json") if code == DONE else None
    if path:
        for name, text in with_csv(found.law).items():
            write_text(folder / name, text)
    over, inner = found.margins, found.law.inside
    if kind == "pid" and model.schedules:
        over = worst_margins(inner, models, model.frozen_values(POINTS), bounds, found.scale)
    _write_margins(over, model, folder / "margins.csv")
    _say_margins(found, over, model, say)
    moved = [*(own.sentence for own in became), *_deviations_said(found, model, options.fixed_gains)]
    for sentence in moved:
        say(sentence)
    if said := _setpoints_said(found.law, model, wanted, trial):
        say(said)
    for sentence in _curves_said(found.law, whole):
        say(sentence)
    _say_limits(found.law, model, say)
    _say_held(found.law, model, _setpoint(options.setpoint, model), say)
    if path:
        say(f"controller -> {path}")
        others = "".join(f", {Path(name).stem} -> {name}" for name in list(with_csv(found.law))[1:])
        say(f"gain table -> {folder / 'gains.csv'}{others}")
    say(f"margins -> {folder / 'margins.csv'}")
    pictures = design_pictures({kind: inner}, models, bounds, found.scale)
    first = next((block for block in pictures if isinstance(block, Picture)), None)
    rest, curves = tuple(block for block in pictures if block is not first), _curve_pictures(whole)
    sections = [Section("Design", (), rest)]
    sections += [Section("Curves of actuators, which the law inverts", curves)] * bool(curves)
    sections += [Section("What the diagnosis named", (_became(became),))] * bool(became)
    worst = ended(_worst_said(found, over, model))
    said = " ".join([ended(trial.sentence), worst, *map(ended, moved)])
    kept = Badge(
        "Margins",
        f"|S| at most {over.sensitivity.max():.3f}",
        worst,
        Standing.OPEN if over.broken(bounds).any() else Standing.GOOD,
    )
    brief = _brief(f"Which {kind} for {model.name}?", trial, kept, moved, path, first)
    page = Report(f"{kind} on {model.name}", said, tuple(sections), brief)
    say(f"pictures -> {write_report(page, folder)}")
    result = {
        "kind": kind, "objective": found.objective, "bounds": vars(bounds), "knots": found.knots, "margins": vars(over),
        "integral_action": {"reached": found.low_frequency, "alone": found.alone},
        "deviation": {"loads": vars(found.loads), "reached": found.deviation, "best_linear_law": found.least,
                      "fixed_gains": found.unmoved},
        "trial": vars(trial), "compensations": [vars(own) for own in became],
    } | _until_told(until)  # fmt: skip
    read = [
        *files,
        *options.robust_to,
        *([options.diagnosis] if options.diagnosis else []),
        *(chosen.files if chosen else ()),
    ]
    return _finished(options, folder, path, result, read, say) or code


def _brief(asked: str, trial: Trial, margins: Badge, moved: Sequence[str], path: Path | None, picture: Picture | None) -> Brief:
    """Whether to go on with the law, one run of its loop, its margins, and how far loads move the outputs."""
    badges = [run_badge(trial), margins, *([Badge("Under load", "measured", ended(moved[0]), Standing.GOOD)] if moved else [])]
    todo = f"Check it: workbench check --controller {path} .." if path else "Do not use it: one run of the loop is lost."
    return Brief(asked, todo, tuple(badges), picture)


def _tried_on(options: Namespace) -> Chosen | None:
    """The plant that the law is tried on: as given, or the one that the diagnosis has extended, beside it or as --model."""
    if options.plant or not options.diagnosis:
        return choose_plant(options.plant) if options.plant else None
    if is_plant(options.model) and options.model.endswith(PLANT_FILE):
        return choose_plant(options.model)
    extended = Path(options.diagnosis).with_name(PLANT_FILE)
    if not extended.is_file():
        mend = f"give --plant my_plant.py:NAME+{PLANT_FILE}, or diagnose again"
        raise InputError(f"no {PLANT_FILE} beside it: the diagnosis handed no plant out", file=options.diagnosis, mend=mend)
    return choose_plant(str(extended))


def _became(became: Sequence[Compensated]) -> Table:
    """What became of every cause, and errors of the machines drawn within its intervals."""
    rows = []
    for own in became:
        done = "yes" if own.done else "no"
        if not own.after.size:
            rows.append((own.effect, done, "", None, None, None))
        for before, after, ratio, along in zip(own.before.T, own.after.T, own.ratio.T, ALONG, strict=False):
            rows.append((own.effect, done, along, *(100.0 * float(np.median(e)) for e in (before, after)), float(ratio.max())))
    header = ("cause", "cancelled", "along", "error without [%]", "error with [%]", "largest ratio of a machine")
    caption = "Root mean square error of set-points that are followed, of the outputs' ranges, in the middle of the machines."
    return Table("Cancelled by feedforward", header, tuple(rows), caption, digits=3)


def _told(options: Namespace, trial: Trial, model: LPVModel, say: Say) -> int:
    """Says what a run of the loop said, before anything else is; whether the law is handed out after it."""
    code = handed_out([trial.sentence] if trial.lost else [], options.accept, say)
    say(_described(model))
    if np.any(model.D):
        say("note: its outputs see the command of their own sample, which held commands cannot do: identify --no-feedthrough")
    if not trial.lost:
        say(trial.sentence)
    return code


def _design_planning(options: Namespace, kind: str, model: LPVModel, say: Say, progress: Say) -> int:
    """Writes mpc.json or nmpc.json, with the model or the plant and the fallback law inside, and design.json."""
    chosen = _plant_of(options, kind)
    errors = _errors_of(options, model, progress)
    keep = _ranges(options.keep, model)
    if options.fallback:
        for option, given in (("--robust-to", options.robust_to), ("--setpoint", options.setpoint)):
            if given:
                raise InputError(
                    f"{option} is for a fallback law that is designed here", mend=f"leave {option} or --fallback out"
                )
        fallback = load_controller(options.fallback)
        if not isinstance(fallback, ScheduledPID):
            raise InputError("not a PID", file=options.fallback, mend="workbench design scheduled-pid, or leave --fallback out")
    else:
        progress("fallback law: scheduled PID")
        fallback = _wanted(options, "scheduled-pid" if model.schedules else "pid", model).design(model, progress).law
    limits = _limits(options, model, fallback) | {"y_low": keep[0], "y_high": keep[1]}
    progress("the price of moves" if options.move is None else "weights")
    wanted = MPCDesign(
        horizon=options.horizon, move=options.move, sensitivity=_above_one(options, "sensitivity"), **_limited(options),
        keep={c.name: (a, b) for c, a, b in zip(model.outputs, *keep, strict=True)}, fallback=fallback,
        setpoint=_given(options.setpoint),
    )  # fmt: skip
    until = _until(options, wanted, model, say, progress)
    wanted = replace(wanted, sensitivity=until.taken.sensitivity) if until else wanted
    weights = wanted.weights(model, fallback)
    common = {"horizon": options.horizon, "weights": weights, **limits}
    if chosen and kind == "nmpc":
        solver = SOLVERS[check_known("solver", options.solver, SOLVERS)]()
        law = design_nmpc(chosen.plant, fallback, base=chosen.base, solver=solver, **common)
        said = f"NMPC on the equation of {chosen.plant.name}, {options.solver}"
    else:
        law = design_mpc(model, fallback, errors=errors, **common)
        said = f"MPC, disturbances at the {'inputs' if law.observer.at_inputs else 'outputs'}"
    progress("one run of the loop")
    trial = tried(law, model, chosen.plant if chosen else None, _setpoint(options.setpoint, model))
    code = _told(options, trial, model, say)
    folder = run_folder(options.out, "design")
    path = save_controller(law, folder / f"{kind}.json") if code == DONE else None
    say(f"{said}, over {law.horizon} samples ({law.horizon * law.dt:g} s)")
    for channel, a, b in zip(model.outputs, law.y_low, law.y_high, strict=True):
        if np.isfinite(a) or np.isfinite(b):
            say(f"  {channel.name} is kept from {a:g} to {b:g} {channel.unit} where that can be done")
    _say_limits(law, model, say)
    tube = _say_tube(law, model, say) if isinstance(law, MPC) and law.tube is not None else {}
    if isinstance(law, MPC):
        progress("margins while no limit acts")
        margins = worst_margins(law, [model], model.frozen_values(POINTS), scale=law.weights.outputs**-0.5)
        _say_frozen(margins, model, say)
        peaks = f"|S| at most {margins.sensitivity.max():.3f}, |T| at most {margins.complementary.max():.3f}"
        over = f" over {len(margins.rho)} schedule values" * bool(model.schedules)
        say(f"while no limit acts: {peaks}{over}")
        _say_delay(margins, model, say)
        _write_margins(margins, model, folder / "margins.csv")
        say(f"margins -> {folder / 'margins.csv'}")
    else:
        say("no margins are computed of a law that predicts with the plant: try it with simulate --setpoint, and with --effect")
    if path:
        say(f"controller -> {path}")
    files = [*([options.fallback] if options.fallback else []), *(chosen.files if chosen else ()), *options.records]
    read = [options.model, *options.robust_to, *files]
    result = {"kind": kind, "weights": vars(law.weights), "trial": vars(trial)} | tube
    result |= {"margins": vars(margins)} if isinstance(law, MPC) else {}
    result |= _until_told(until)
    return _finished(options, folder, path, result, read, say) or code


def _until(options: Namespace, wanted: Any, model: Model, say: Say, progress: Say) -> Decided | None:
    """The design made calmer until every limit of --until is decided, and what was tried; None without one."""
    if not options.until:
        return None
    others = {"--tube": options.tube, "--diagnosis": options.diagnosis, "nmpc": options.kind == "nmpc"}
    if clash := [name for name, given in others.items() if given]:
        raise InputError(f"--until with {clash[0]}", mend="leave one of both out: check says what is decided of such a law")
    if not options.records:
        raise InputError("--until without records", mend="give --records R.csv ..: they bound the model's errors")
    bound = numbers(options.bound, "--bound")
    found = decided(
        wanted, model, load_limits(options.until), read(*options.records), lags=options.lags, bound=bound, progress=progress
    )
    for sentence in found.sentences:
        say(sentence)
    return found


def _until_told(until: Decided | None) -> dict[str, Any]:
    """What design.json says of the laws that were tried."""
    return {"until": {"taken": until.taken.sensitivity, "attempts": list(until.sentences[:-1])}} if until else {}


def _errors_of(options: Namespace, model: LPVModel, progress: Say) -> tuple[IntervalModel, ...] | None:
    """What the records leave open of the model's errors, for a tube; None without one."""
    if not options.tube:
        return None
    if not options.records:
        raise InputError("--tube without records", mend="give --records R.csv ..: they bound the model's errors")
    progress("errors that the records leave open")
    bound = numbers(options.bound, "--bound")
    return ErrorRegression(options.lags, bound).fit(model, read(*options.records))


def _say_tube(law: MPC, model: LPVModel, say: Say) -> dict[str, Any]:
    """What the tube takes of the limits."""
    tube = law.tube
    assert tube is not None
    parts = np.split(100.0 * taken(law, tube), [len(model.outputs), len(model.outputs) + len(model.inputs)])
    say("tube: whatever errors the records leave open, a plan without slack keeps the outputs within their limits")
    for c, W, room, part in zip(model.outputs, tube.error, tube.y.T, parts[0], strict=True):
        inside = f"{room[0]:.3g} to {room[-1]:.3g} {c.unit}".rstrip()
        say(f"  {c.name}: errors up to {W:.3g}, plans stay {inside} inside the limits, {part:.1f} % of half their width")
    for c, part, rate in zip(model.inputs, *parts[1:], strict=True):
        say(f"  {c.name}: {part:.1f} % of half the width of its limits, {rate:.1f} % of its rate")
    say(f"  proved at {len(tube.rho)} value{'s' * (len(tube.rho) > 1)} of the schedule, checked whenever the file is read")
    limit = tube.limit(law)
    return {"tube": {"error": tube.error, "outputs": tube.y[-1], "commands": tube.u[-1], "moves": tube.moves[-1], "limit": limit}}


def _plant_of(options: Namespace, kind: str) -> Chosen | None:
    """The plant that the law is tried on, and that a nonlinear MPC predicts with."""
    if kind == "nmpc" and not options.plant:
        raise InputError("which plant does it predict with?", mend="give --plant web-winding, or a plant of your own")
    return choose_plant(options.plant) if options.plant else None


def _finished(options: Namespace, folder: Path, path: Path | None, result: dict, files: list[str], say: Say) -> int:
    if path:
        if options.path:
            say(f"next: in Python, wb.simulate(plant, load_controller({str(path)!r}), wb.Scenario(..)) along your path")
        else:
            say(f"next: workbench simulate {options.model} --controller {path} --setpoint Y=V,..")
        on = f"--plant {options.model}" if is_plant(options.model) else f"--model {options.model} --records .."
        say(f"      workbench check --controller {path} --limits limits.toml {on}")
    configuration = {key: value for key, value in vars(options).items() if key != "json"}
    whole = {"controller": str(path) if path else None} | result | {"provenance": provenance(configuration, files)}
    write_json(folder / "design.json", nullable(whole))
    if options.json:
        write_json(options.json, nullable(whole))
    return 0


def _above_one(options: Namespace, name: str) -> float:
    """A bound of margins as it was asked for."""
    if not (given := getattr(options, name)) > 1.0:
        usual = "3 and more are" if name == "effort" else "1.2 to 2 is"
        raise InputError(f"--{name} {given:g}", mend=f"no loop does with 1 or less; {usual} usual")
    return given


def _wanted(options: Namespace, kind: str, model: LPVModel) -> ScheduledPIDDesign:
    """The design of the PID that the options ask for."""
    bounds = [_above_one(options, name) for name in ("sensitivity", "complementary", "effort")]
    return ScheduledPIDDesign(
        *bounds, knots=_knots(options, kind, model),
        **_limited(options), setpoint=_given(options.setpoint), derivative=not options.no_derivative,
        filter=options.filter, setpoint_weight=options.setpoint_weight, feedforward=not options.no_feedforward,
        moving=not options.fixed_gains,
        reference_model=_given(options.reference_model), slew=_given(options.slew),
        paths=tuple(name for text in options.path for name in names(text)), steps=_steps(options, model),
        objective=options.objective, load=_given(options.load), load_every=options.load_every, size=_given(options.size),
        robust_to=tuple(load_model(path) for path in options.robust_to),
    )  # fmt: skip


def _steps(options: Namespace, model: LPVModel) -> dict[str, float]:
    """Steps by output that the law is tried with: as given, else over half of what the records of the diagnosis went through."""
    known = [c.name for c in model.outputs]
    at = dict(zip(known, model.operating_point.basis(model.middle) @ model.operating_point.y, strict=True))
    told = moved_by(read_json(options.diagnosis), at, options.diagnosis) if options.diagnosis else {}
    return {name: step for name, step in told.items() if name in known} | _given(options.step)


def _given(texts: list[str]) -> dict[str, float]:
    """Numbers by channel from V1=0,V2=0."""
    return parse_numbers(part for text in texts for part in names(text))


def _limited(options: Namespace) -> dict[str, dict[str, float]]:
    """The limits of commands by input, as they were typed."""
    return {key: _given(getattr(options, key)) for key in ("low", "high", "rate")}


def _limits(options: Namespace, model: LPVModel, fallback: ScheduledPID) -> dict[str, Any]:
    """low, high and rate (nu,) as given, the rest those of the fallback law; None where nothing is given."""
    return command_limits(_limited(options), model, fallback)


def _say_limits(law: Any, model: LPVModel, say: Say) -> None:
    for c, a, b, rate in zip(model.inputs, law.low, law.high, law.rate, strict=True):
        if np.isfinite([a, b, rate]).any():
            ends = f"from {a:g} to {b:g} {c.unit}".rstrip() if np.isfinite([a, b]).any() else "without limits"
            say(f"  {c.name} {ends}{f', at most {rate:g} {c.unit}/s' if np.isfinite(rate) else ''}: always")
        else:
            say(f"  {c.name} has no limits: give --low, --high, --rate {c.name}=...")


def _setpoints_said(law: ScheduledPID, model: LPVModel, wanted: ScheduledPIDDesign, trial: Trial) -> str:
    """What set-points go through, and what is left to do; empty where that is nothing."""
    told, chosen = [], []
    for c, w, slew, path in zip(model.outputs, law.bandwidth.tolist(), law.slew.tolist(), law.paths.tolist(), strict=True):
        ways = [f"a slew of {slew:.4g} {c.unit}/s"] * (slew < np.inf) + [f"a reference model of {w:.3g} rad/s"] * (w < np.inf)
        ways += ["the feedforward of its rate and acceleration: give it a smooth path, no steps"] * path
        told += [f"{c.name} through {' and '.join(ways)}"] * bool(ways)
        chosen += [f"{c.name}=inf"] * (w < np.inf and c.name not in wanted.reference_model)
    said = [f"set-points: {', '.join(told)}"] * bool(told)
    said += [f"--reference-model {','.join(chosen)} is as brisk as the margins allow"] * bool(chosen)
    if trial.overshoot > OVERSHOOT:
        given = any(w < np.inf for w in wanted.reference_model.values())
        said.append("steps still overshoot: " + ("a smaller --reference-model" if given else "limit their rate with --slew"))
    return "; ".join(said)


def _curve_pictures(model: Model) -> tuple[Picture, ...]:
    return () if isinstance(model, LPVModel) else tuple(curve_picture(model, curve) for curve in model.curves)


def _curves_said(law: ScheduledPID, model: Model) -> list[str]:
    """Which curves the law inverts, and where an inverse is steep."""
    found, said = {c.input: c for c in curves_of(model)}, []
    for curve in law.curves:
        unit, own = law.unit(curve.input), found[curve.input]
        known = f"known from {curve.u[0]:.4g} to {curve.u[-1]:.4g} {unit}".rstrip()
        said.append(f"{curve.input} through the inverse of its curve, {known}: gains and margins are of what arrives")
        at = law.actuated.index(curve.input)
        if law.low[at] < curve.u[0] or law.high[at] > curve.u[-1]:
            said.append(f"note: {curve.input} may go where the records have not shown its curve: there check proves nothing")
        if not np.array_equal(curve.v, own.v):
            flat = np.flatnonzero(own.slopes < own.flattest)
            where = f"from {own.u[flat[0]]:.3g} to {own.u[flat[-1] + 1]:.3g} {unit}".rstrip()
            parts = "" if np.all(np.diff(flat) == 1) else "in parts "
            still = f"note: the curve of {curve.input} stands still {parts}{where}"
            said.append(f"{still}: its inverse is steep there, and the loop weaker than its margins say")
    return said


def _say_held(law: ScheduledPID, model: LPVModel, setpoint: Sequence[float] | None, say: Say) -> None:
    """What holds the set-point over the schedule by the model, and whether the limits let it."""
    if setpoint is None:
        return
    u = []
    for rho in model.frozen_values(POINTS):
        A, B, C, D = model.freeze(rho)
        phi = model.operating_point.basis(np.array(0.0 if rho is None else rho))
        u.append(phi @ model.operating_point.u + rests(A, B, C, D)[1] @ (setpoint - phi @ model.operating_point.y))
    over = f" over {', '.join(c.name for c in model.schedules)}" if model.schedules else ""
    curves = {curve.input: curve for curve in law.curves}
    for c, each, low, high in zip(model.inputs, np.transpose(u), law.low, law.high, strict=True):
        each = curves[c.name].inverse(each) if c.name in curves else each
        say(f"  the set-point takes {c.name} from {each.min():.4g} to {each.max():.4g} {c.unit}{over}")
        if each.min() < low or each.max() > high:
            say(f"warning: {c.name}: its limits, {low:g} to {high:g} {c.unit}, do not let it hold this set-point everywhere")


def _knots(options: Namespace, kind: str, model: LPVModel) -> int | Sequence[Any] | None:
    own = names(options.knots) if options.knots is not None else []
    counts = [int(text) for text in own if text.isdigit()]
    if len(counts) < len(own) or 0 in counts:
        raise InputError(f"--knots {options.knots}", mend="a number, or one for each schedule variable: --knots 5,3")
    if kind == "pid":
        if options.knots is not None:
            raise InputError("--knots is for a scheduled law", mend="leave it out, or workbench design scheduled-pid")
        return 1 if options.at is None else _at(options.at, model)
    if options.at is not None:
        raise InputError("--at is for a fixed law", mend="workbench design pid --at VALUE")
    if not model.schedules:
        raise InputError("has no schedule", file=options.model, mend="workbench design pid, or identify with --schedule")
    if counts and max(counts) == 1:
        raise InputError("1 knot", mend="a scheduled law has two or more; for one: workbench design pid")
    return None if not counts else counts[0] if len(counts) == 1 else counts


def _at(text: str, model: LPVModel) -> list:
    """The schedule value of a fixed law, of several variables a value each, as knots."""
    try:
        values = [float(own) for own in names(text)]
    except ValueError:
        values = []
    if not values or len(values) != max(1, len(model.schedules)):
        every = ",".join(c.name.upper() for c in model.schedules) or "VALUE"
        raise InputError(f"--at {text}", mend=f"a value of every schedule variable: --at {every}")
    return values if len(values) == 1 else [[own] for own in values]


def _ranges(texts: list[str], model: LPVModel) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest outputs from theta=-20:20,w3=:120; infinite where none is given."""
    known = [c.name for c in model.outputs]
    low, high = np.full(len(known), -np.inf), np.full(len(known), np.inf)
    for part in (part for text in texts for part in names(text)):
        name, _, ends = part.partition("=")
        at = known.index(check_known("output", name.strip(), known, file=model.name))
        first, colon, last = ends.partition(":")
        try:
            low[at], high[at] = float(first or "-inf"), float(last or "inf")
        except ValueError:
            colon = ""
        if not colon:
            raise InputError(f"--keep {part}", mend=f"write {name or 'OUTPUT'}=LOW:HIGH, one of them may be left out")
        if not low[at] < high[at]:
            raise InputError(f"--keep {part}", mend=f"the lower limit first: {name.strip()}={last}:{first}")
    return low, high


def _setpoint(texts: list[str], model: LPVModel) -> list[float] | None:
    return setpoint_of(_given(texts), model)


def _described(model: LPVModel) -> str:
    inputs, outputs = (", ".join(c.name for c in channels) for channels in (model.inputs, model.outputs))
    free = ", taken as integrating or unstable" * model.free
    ranges = (
        f"{c.name} from {a:.4g} to {b:.4g} {c.unit}".rstrip() for c, (a, b) in zip(model.schedules, model.spans, strict=True)
    )
    over = "".join(f"; {own}" for own in ranges)
    return f"{model.name}: {outputs} from {inputs}, order {model.order}, sampled every {model.dt:g} s{free}{over}"


def _say_margins(found: PIDDesign, over: Margins, model: LPVModel, say: Say) -> None:
    bounds = found.bounds
    _say_frozen(over, model, say)
    say(_worst_said(found, over, model))
    if len(found.knots) > 1 or found.objective == "variance":
        share = (found.low_frequency / found.alone).min()
        say(f"integral action: at least {share:.0%} of the most that these margins allow at each knot alone")
    if len(found.knots) == 1 and over.broken(bounds).any():
        say(
            f"away from {model.named(found.knots[0])} the fixed law breaks its bounds at "
            f"{over.broken(bounds).sum()} of {len(over.rho)} schedule values: workbench design scheduled-pid keeps them"
        )
    _say_delay(over, model, say)


def _say_frozen(over: Margins, model: LPVModel, say: Say) -> None:
    """A line of margins for some of the schedule values."""
    if model.schedules:
        heads = "max |S|   max |T|   effort   bandwidth [rad/s]   delay margin [ms]   largest pole"
        say(f"{'   '.join(f'{c.name} [{c.unit}]' for c in model.schedules)}   {heads}")
        for i in _shown(over, model):
            say(
                f"{'   '.join(f'{v:<10.5g}' for v in np.atleast_1d(over.rho[i]))} {over.sensitivity[i]:8.3f} "
                f"{over.complementary[i]:9.3f} {over.effort[i]:8.2f} {over.bandwidth[i]:12.2f} {1e3 * over.delay[i].min():19.1f} "
                f"{over.radius[i]:18.4f}"
            )


def _say_delay(over: Margins, model: LPVModel, say: Say) -> None:
    say(f"largest further delay of one command: {1e3 * over.delay.min():.0f} ms, {over.delay.min() / model.dt:.1f} samples")
    say("frozen margins hold while the schedule stands still or moves slowly against the bandwidth")


def _deviations_said(found: PIDDesign, model: LPVModel, fixed: bool) -> list[str]:
    """How far noise and load steps move the outputs, what is left for any other linear law, and what moving gains take off.

    fixed: they were asked to stand still.
    """
    steps = ", ".join(f"{c.name} {size:.3g} {c.unit}".rstrip() for c, size in zip(model.inputs, found.loads.size, strict=True))
    noise = "the model's noise and " if model.noise is not None and np.any(model.noise) else ""
    over = " over the schedule" if len(found.knots) > 1 else ""

    def told(deviation: np.ndarray) -> str:
        ends = zip(model.outputs, deviation.min(axis=0), deviation.max(axis=0), strict=True)
        return ", ".join(f"{c.name} {' to '.join(dict.fromkeys((f'{a:.3g}', f'{b:.3g}')))} {c.unit}".rstrip() for c, a, b in ends)

    said = [f"RMS under {noise}load steps ({steps}; every {found.loads.every:.3g} s): {told(found.deviation)}{over}"]
    if found.least is not None:
        said.append(f"RMS of the best linear law of any order, margins aside: {told(found.least)}{over}")
    if found.unmoved is not None:
        less = f"moving gains take {max(found.gained, 0.0):.1%} off"
        said.append(f"RMS with gains that do not move, within the same bounds: {told(found.unmoved)}{over}; {less}")
        if found.gained < GAINED:
            said.append("the gains need not move: with --fixed-gains the feedforward alone does")
    elif len(found.knots) > 1 and found.objective == "variance" and not fixed:
        said.append("no gains that do not move keep these bounds over the schedule")
    return said


def _shown(over: Margins, model: LPVModel) -> np.ndarray:
    """Which frozen loops are printed: seven over one schedule variable, the corners of several, and the worst."""
    if len(model.schedules) < 2:
        own = np.linspace(0, len(over.rho) - 1, 7).round().astype(int)
    else:
        own = np.flatnonzero(np.all((over.rho == over.rho.min(axis=0)) | (over.rho == over.rho.max(axis=0)), axis=1))
    return np.unique(np.append(own, over.sensitivity.argmax()))


def _worst_said(found: PIDDesign, over: Margins, model: LPVModel) -> str:
    """The largest sensitivity, and where."""
    worst = int(over.sensitivity.argmax())
    at = f" at {model.named(over.rho[worst])}" if model.schedules else ""
    return (
        f"largest sensitivity {over.sensitivity[worst]:.3f}{at}, asked {found.bounds.sensitivity:g}; {len(over.rho)} frozen loops"
    )


def _write_margins(margins: Margins, model: LPVModel, path: Path) -> None:
    loops = [f"S_{c.name}" for c in model.inputs]
    head = [*([f"{c.name} [{c.unit}]" for c in model.schedules] or ["rho"]), "S", "T", "effort", *loops]
    delays = [f"delay_margin_{c.name} [s]" for c in model.inputs]
    rows = [",".join([*head, "largest_pole", "bandwidth [rad/s]", *delays])]
    for i in range(len(margins.rho)):
        at = np.atleast_1d(margins.rho[i])
        numbers = [*at, margins.sensitivity[i], margins.complementary[i], margins.effort[i], *margins.loops[i]]
        rows.append(",".join(f"{v:.9g}" for v in [*numbers, margins.radius[i], margins.bandwidth[i], *margins.delay[i]]))
    write_text(path, "\n".join(rows) + "\n")
