"""`workbench design`: from an identified model to a controller file, its margins, and what to do with it."""

from argparse import Namespace
from collections.abc import Callable
from pathlib import Path

import numpy as np

from controllers.export import write_gain_table
from controllers.files import save_controller
from controllers.pid_design import Margins, PIDDesign, Structure, design_pid, margins_of
from controllers.tuning import Bounds
from studies.arguments import names, parse_numbers, run_folder
from workbench.errors import InputError, check_known
from workbench.files import write_json, write_text
from workbench.lpv import LPVModel, load_model
from workbench.provenance import provenance

Say = Callable[[str], None]
KINDS = ("scheduled-pid", "pid")


def design(options: Namespace, say: Say, progress: Say) -> int:
    """Design the law that was asked for; writes <kind>.json, gains.csv and margins.csv."""
    kind = check_known("controller", options.kind, KINDS)
    model = load_model(options.model)
    bounds = _bounds(options)
    structure = Structure(
        derivative=not options.no_derivative, Tf=options.filter, b=options.setpoint_weight,
        low=_by_name(options.low, model, -np.inf), high=_by_name(options.high, model, np.inf),
        rate=_by_name(options.rate, model, np.inf),
    )  # fmt: skip
    say(_described(model))
    found = design_pid(
        model, knots=_knots(options, kind, model), bounds=bounds, structure=structure,
        setpoint=_setpoint(options.setpoint, model), robust_to=[load_model(path) for path in options.robust_to], say=progress,
    )  # fmt: skip
    folder = run_folder(options.out, "design")
    path = save_controller(found.law, folder / f"{kind}.json")
    write_gain_table(found.law, folder / "gains.csv", _channels(model))
    over = found.margins
    if kind == "pid" and model.schedule is not None:
        over = margins_of(found.law, model, list(np.linspace(model.span[0], model.span[1], 25)), bounds)
    _write_margins(over, model, folder / "margins.csv")
    _say_margins(found, over, model, say)
    say(f"controller -> {path}")
    say(f"gain table -> {folder / 'gains.csv'}, margins -> {folder / 'margins.csv'}")
    say(f"next: workbench simulate PLANT --experiment NAME --controller {path}")
    result = {
        "controller": str(path), "kind": kind, "bounds": vars(bounds), "knots": found.knots,
        "integral_action": {"reached": found.low_frequency, "alone": found.alone}, "margins": vars(over),
        "provenance": provenance({k: v for k, v in vars(options).items() if k != "json"}, [options.model, *options.robust_to]),
    }  # fmt: skip
    write_json(folder / "design.json", result)
    if options.json:
        write_json(options.json, result)
    return 0


def _channels(model: LPVModel) -> tuple:
    return (*model.inputs, *model.outputs, *([model.schedule] if model.schedule else []))


def _bounds(options: Namespace) -> Bounds:
    for name in ("sensitivity", "complementary", "effort"):
        if not getattr(options, name) > 1.0:
            raise InputError(f"--{name} {getattr(options, name):g}", mend="no loop does with 1 or less; 1.2 to 2 is usual")
    return Bounds(options.sensitivity, options.complementary, options.effort)


def _knots(options: Namespace, kind: str, model: LPVModel) -> int | list[float]:
    if kind == "pid":
        return 1 if options.at is None else [options.at]
    if options.at is not None:
        raise InputError("--at is for a fixed law", mend="workbench design pid --at VALUE")
    if model.schedule is None:
        raise InputError("has no schedule", file=options.model, mend="workbench design pid, or identify with --schedule")
    if options.knots < 2:
        raise InputError(f"{options.knots} knots", mend="a scheduled law has two or more; for one: workbench design pid")
    return options.knots


def _by_name(texts: list[str], model: LPVModel, default: float) -> np.ndarray | None:
    """Numbers by input from V1=0,V2=0; None where none is given."""
    given = parse_numbers(part for text in texts for part in names(text))
    known = [c.name for c in model.inputs]
    for name in given:
        check_known("input", name, known, file=model.name)
    return np.array([given.get(name, default) for name in known]) if given else None


def _setpoint(texts: list[str], model: LPVModel) -> list[float] | None:
    given = parse_numbers(part for text in texts for part in names(text))
    known = [c.name for c in model.outputs]
    for name in given:
        check_known("output", name, known, file=model.name)
    if given and len(given) < len(known):
        missing = [name for name in known if name not in given]
        raise InputError(f"no set-point for {', '.join(missing)}", mend=f"give --setpoint {','.join(f'{n}=...' for n in known)}")
    return [given[name] for name in known] if given else None


def _described(model: LPVModel) -> str:
    inputs, outputs = (", ".join(c.name for c in channels) for channels in (model.inputs, model.outputs))
    schedule = model.schedule
    over = f"; {schedule.name} from {model.span[0]:.4g} to {model.span[1]:.4g} {schedule.unit}" if schedule else ""
    return f"{model.name}: {outputs} from {inputs}, order {model.order}, sampled every {model.dt:g} s{over}"


def _say_margins(found: PIDDesign, over: Margins, model: LPVModel, say: Say) -> None:
    bounds, schedule = found.bounds, model.schedule
    if schedule is not None:
        say(f"{schedule.name} [{schedule.unit}]   max |S|   max |T|   effort   bandwidth [rad/s]   largest pole")
        for i in np.unique(np.linspace(0, len(over.rho) - 1, 7).round().astype(int)):
            say(
                f"{over.rho[i]:<10.5g} {over.sensitivity[i]:8.3f} {over.complementary[i]:9.3f} {over.effort[i]:8.2f} "
                f"{over.bandwidth[i]:12.2f} {over.radius[i]:18.4f}"
            )
    worst = int(over.sensitivity.argmax())
    at = f" at {schedule.name} = {over.rho[worst]:.4g} {schedule.unit}" if schedule else ""
    say(f"largest sensitivity {over.sensitivity[worst]:.3f}{at}, asked {bounds.sensitivity:g}; {len(over.rho)} frozen loops")
    if len(found.knots) > 1:
        share = (found.low_frequency / found.alone).min()
        say(f"integral action: at least {share:.0%} of what a law made for each knot alone reaches")
    elif over.broken(bounds).any():
        say(
            f"away from {found.knots[0]:.4g} {schedule.unit if schedule else ''} the fixed law breaks its bounds at "
            f"{over.broken(bounds).sum()} of {len(over.rho)} schedule values: workbench design scheduled-pid keeps them"
        )
    say("frozen margins hold while the schedule stands still or moves slowly against the bandwidth")


def _write_margins(margins: Margins, model: LPVModel, path: Path) -> None:
    loops = [f"S_{c.name}" for c in model.inputs]
    head = ["rho" if model.schedule is None else f"{model.schedule.name} [{model.schedule.unit}]", "S", "T", "effort", *loops]
    rows = [",".join([*head, "largest_pole", "bandwidth [rad/s]"])]
    for i in range(len(margins.rho)):
        numbers = [margins.rho[i], margins.sensitivity[i], margins.complementary[i], margins.effort[i], *margins.loops[i]]
        rows.append(",".join(f"{v:.9g}" for v in [*numbers, margins.radius[i], margins.bandwidth[i]]))
    write_text(path, "\n".join(rows) + "\n")
