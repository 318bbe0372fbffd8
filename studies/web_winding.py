"""The main job: from records of the web winding machine to controllers that are checked on what the records leave open.

records -> LPV models -> diagnosis of the simulation -> scheduled PID and MPC -> verdicts -> one page

Every stage is a command of the workbench that a user could type in the run's folder; the page names it. The records are
simulated, with one effect hidden in them that no later stage is told of, or they are the user's own.
"""

import math
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from plants import WEB_WINDING
from studies.arguments import record_files, split_estimation
from studies.stages import Done, Stage, run_stages
from workbench.answers.check import STANDING
from workbench.data import Experiment
from workbench.errors import InputError
from workbench.files import read_json, read_text, write_json, write_text
from workbench.metrics import tracking
from workbench.provenance import provenance
from workbench.readers import read_file
from workbench.records import record
from workbench.report import figures
from workbench.report.archive import read_report
from workbench.report.blocks import Badge, Block, Brief, Provenance, Report, Section, Table, Text
from workbench.report.page import write_report
from workbench.robustness.limits import load_limits
from workbench.robustness.verdict import Status
from workbench.sources import read
from workbench.units import check_units

Say = Callable[[str], None]

EXPERIMENTS, QUICK = ("prbs1", "rbs", "prbs2", "sine", "rgs"), ("prbs1", "rbs", "sine")
ESTIMATION = ("prbs1", "rbs")
OUTPUTS, SCHEDULE = ("w3", "theta"), "r2"
#: What may be hidden in simulated records: effects that a winding machine comes to have, with the sizes that are drawn from.
HIDDEN: dict[str, tuple[str, float, float]] = {
    "input-delay@V1": ("time", 0.02, 0.05),
    "sensor-lag@theta": ("time", 0.01, 0.03),
    "sensor-lag@w3": ("time", 0.01, 0.03),
    "eccentricity@unwind": ("cosine", 4e-5, 1.5e-4),
    "imbalance@rewind": ("cosine", 6e-5, 2e-4),
    "heating@V1": ("fall", 0.05, 0.15),
}
LIMITS = """\
# what the loop shall keep; a file of this name beside your records replaces it
[run]
duration = 30.0

[run.setpoints]
w3 = [[0.0, {w3:g}], [8.0, {faster:g}]]
theta = [[0.0, {theta:g}], [16.0, {tighter:g}]]

[limits.theta]
low = {slack:g}
high = {tight:g}
begin = 2.0

[limits.w3]
band = 3.0
settling = 5.0

[limits.V1]
low = -2.0
high = 3.0

[limits.V2]
low = 0.0
high = 3.0

[loop]
stable = true
margin = 1.0
"""
COMMANDS = ("--low", "V1=-2,V2=0", "--high", "V1=3,V2=3", "--rate", "V1=50,V2=50")
KEEP = 20.0  # deg on either side of the set-point, within which the MPC keeps the angle where it can
LAWS = {"pid": "scheduled PID", "mpc": "LPV-MPC"}
SHOWN = {  # sections of the pages of stages that the page of the chain shows; the rest is one click away
    "models": ("Measured and simulated",),
    "diagnosis": ("What is missing", "Held-out records", "What is left", "Parameters", "What to measure next"),
    "pid": ("Margins", "Design"),
    "check-pid": ("Verdicts",),
    "check-mpc": ("Verdicts",),
}


@record
class Hidden:
    """What was hidden in simulated records: an effect, its parameter and size."""

    effect: str
    parameter: str
    size: float

    @property
    def words(self) -> tuple[str, str]:
        return "--effect", f"{self.effect}:{self.parameter}={self.size:.6g}"


@record
class Split:
    """Record files by what they are for, as named in the run's folder."""

    estimation: tuple[str, ...]
    held_out: tuple[str, ...]


def main(
    quick: bool = False,
    *,
    folder: Path,
    data: str | None = None,
    seed: int = 1,
    json: str | None = None,
    say: Say = print,
    progress: Say = lambda _: None,
    jobs: int | None = None,
    fresh: bool = False,
) -> Path:
    """Run the chain into `folder`, and write its page; returns the page's path. fresh: compute everything anew."""
    jobs = jobs or min(2, os.cpu_count() or 1)
    hidden = None if data else drawn(seed)
    if hidden:
        names = QUICK if quick else EXPERIMENTS
        words = ("simulate", WEB_WINDING.name, "--experiment", *names, "--seed", str(seed), *hidden.words)
        made = run_stages([Stage("records", words)], folder, cached=not fresh, progress=progress)
        split = Split(
            tuple(f"records/{n}.csv" for n in names if n in ESTIMATION),
            tuple(f"records/{n}.csv" for n in names if n not in ESTIMATION),
        )
    else:
        assert data is not None
        made, split = {}, _taken(Path(data), folder)
    setpoint = _limits(folder, data, split)
    stages = chain(split, setpoint, quick)
    done = made | run_stages(stages, folder, jobs=jobs, cached=not fresh, progress=progress)
    progress("report")
    configuration = {"study": "web-winding", "quick": quick, "data": data, "stages": [d.stage.command for d in done.values()]}
    files = [folder / name for name in (*split.estimation, *split.held_out, "limits.toml")]
    source = provenance(configuration, files, None if data else seed)
    said = verdict(folder, done, hidden)
    content = {
        "verdict": said,
        "hidden": hidden and {"effect": hidden.effect, hidden.parameter: hidden.size},
        "stages": {name: {"command": d.stage.command, "code": d.code, "seconds": d.seconds} for name, d in done.items()},
        "provenance": source,
    }
    for path in (folder / "web-winding.json", json):
        if path:
            write_json(path, content)
    page = write_report(_report(folder, done, said, hidden, source, quick), folder)
    say(f"{said}\n\nreport: {page}")
    return page


def drawn(seed: int) -> Hidden:
    """What is hidden in the records of a seed."""
    random = np.random.default_rng([seed, 7])
    effect = list(HIDDEN)[random.integers(len(HIDDEN))]
    parameter, low, high = HIDDEN[effect]
    return Hidden(effect, parameter, float(np.exp(random.uniform(np.log(low), np.log(high)))))


def _taken(data: Path, folder: Path) -> Split:
    """Copies of a user's records in the run's folder, checked. PRBS1 and RBS estimate if they are there, else the first half."""
    files = record_files(data)
    dataset = read(*files)
    units = {c.name: c.unit for c in (*WEB_WINDING.inputs, *WEB_WINDING.outputs)}
    for e in dataset:
        check_units(e, units)
        if missing := [name for name in ("V1", "V2", *OUTPUTS, SCHEDULE) if name not in e.names]:
            raise InputError(
                f"no channel {', '.join(missing)}", file=e.name,
                mend="the chain needs V1, V2, w3, theta and r2; workbench study winding-models does without theta",
            )  # fmt: skip
    estimation, rest = split_estimation(dataset, ESTIMATION)
    room = folder / "records"
    if room.exists() and any(path.name not in {f.name for f in files} for path in room.iterdir()):
        raise InputError("holds other records", file=room, mend="choose another --out folder")
    room.mkdir(parents=True, exist_ok=True)
    for path in files:
        if path.resolve() != (room / path.name).resolve():
            shutil.copyfile(path, room / path.name)
    named = dict(zip(dataset.names, (f"records/{path.name}" for path in files), strict=True))
    return Split(tuple(named[e.name] for e in estimation), tuple(named[e.name] for e in rest))


def _limits(folder: Path, data: str | None, split: Split) -> dict[str, float]:
    """Write limits.toml, the user's own where there is one; returns the set-points that its run begins with."""
    own = Path(data) / "limits.toml" if data else None
    if own and own.is_file():
        write_text(folder / "limits.toml", read_text(own))
    elif not (folder / "limits.toml").exists():  # one that is there may be the user's by now
        w3, theta = 100.0, 0.0
        if data:
            first = [read_file(folder / path) for path in split.estimation]
            w3, theta = (float(f"{np.mean(np.concatenate([e[name] for e in first])):.2g}") for name in OUTPUTS)
        numbers = {"w3": w3, "faster": 1.05 * w3, "theta": theta, "tighter": theta + 5.0}
        write_text(folder / "limits.toml", LIMITS.format(**numbers, slack=theta - 40.0, tight=theta + 40.0))
    run = load_limits(folder / "limits.toml").run
    if run is None or (missing := [name for name in OUTPUTS if name not in run.setpoints]):
        named = ", ".join(OUTPUTS if run is None else missing)
        raise InputError(f"no set-point for {named}", file=folder / "limits.toml", mend="give [run.setpoints]")
    return {name: run.setpoints[name][0][1] for name in OUTPUTS}


def chain(split: Split, setpoint: Mapping[str, float], quick: bool) -> tuple[Stage, ...]:
    """The commands from records to verdicts; setpoint: of each output, where the controllers are designed to stand."""
    own, held = split.estimation, split.held_out
    wanted = ",".join(f"{name}={value:g}" for name, value in setpoint.items())
    kept = ",".join(f"theta={setpoint['theta'] + side * KEEP:g}" for side in (-1.0, 1.0)).replace(",theta=", ":")
    model, pid, mpc, limits = "models/ssm.json", "pid/scheduled-pid.json", "mpc/mpc.json", "limits.toml"
    machine = ("--plant", "diagnosis/extended.json", "--fitted", "diagnosis/diagnosis.json")
    kinds = ("--model", "ssm", "--order", "5") if quick else ("--model", "all")

    def loop(law: str) -> tuple[str, ...]:
        return ("simulate", "diagnosis/extended.json", "--controller", law, "--limits", limits, "--seed", "1")

    def checked(law: str, runs: str) -> tuple[str, ...]:
        fewer = ("--nodes", "2", "--runs", runs) if quick else ()
        return ("check", "--controller", law, "--limits", limits, "--model", model, "--records", *own, *machine, *fewer)

    return (
        Stage("diagnosis", ("diagnose", *own, "--plant", WEB_WINDING.name, "--holdout", *held)),
        Stage(
            "models",
            ("identify", *own, "--outputs", "w3,theta", "--inputs", "V1,V2", "--schedule", SCHEDULE, *kinds,
             "--no-feedthrough", "--holdout", *held),
        ),
        Stage(
            "pid",
            ("design", "scheduled-pid", "--model", model, "--setpoint", wanted, *COMMANDS, *(("--knots", "2") if quick else ())),
        ),
        Stage("mpc", ("design", "mpc", "--model", model, *COMMANDS, "--keep", kept, "--fallback", pid)),
        Stage("loop-pid", loop(pid)),
        Stage("loop-mpc", loop(mpc)),
        Stage("check-pid", checked(pid, "20")),
        Stage("check-mpc", checked(mpc, "6")),
    )  # fmt: skip


# ---- the answer -----------------------------------------------------------------------------------------------------------


def verdict(folder: Path, done: Mapping[str, Done], hidden: Hidden | None) -> str:
    """What a reader needs first: what the simulation lacks, which model, which controller, and whether it is safe."""
    found = read_json(folder / "diagnosis" / "diagnosis.json")
    errors = {LAWS[law]: own for law, own in _loop_errors(folder).items()}
    said = [_lacks_said(found), _models_said(read_json(folder / "models" / "scores.json")), _loops_said(errors)]
    said += [
        f"Check of the {name}: {_checked_said(read_json(folder / f'check-{law}' / 'check.json'))}" for law, name in LAWS.items()
    ]
    if not hidden:
        return " ".join(said)
    revealed = f"The records are simulated. Hidden in them was {hidden.effect}, {hidden.parameter} {hidden.size:.3g}: "
    return f"{' '.join(said)}\n\n{revealed}{judged(found, hidden)}."


def judged(found: Mapping[str, Any], hidden: Hidden) -> str:
    """What a diagnosis says of what was hidden: named alone or beside others, with its size or not, tied, or missed."""
    named = {f"{c['effect']}@{c['at']}": c for c in found["causes"]}
    tied = {key for c in found["causes"] for key in c["ties"]}
    if hidden.effect in named:
        own = named[hidden.effect]
        sizes = [p for name, p in own["parameters"].items() if name in (hidden.parameter, "amplitude")]
        inside = any(p["low"] <= hidden.size <= p["high"] for p in sizes)
        said = f"the diagnosis names it, {'its size inside' if inside else 'its size NOT inside'} the 95 % interval"
        said += ", with rivals that it cannot tell from it" * bool(own["ties"])
        others = [key for key in named if key != hidden.effect]
        return said + (f", and names {', '.join(others)} beside it, which was not there" if others else "")
    if hidden.effect in tied:
        return "the diagnosis names another effect, and says that it cannot tell the two apart"
    return "the diagnosis does not find it"


def _lacks_said(found: Mapping[str, Any]) -> str:
    """Causes with their sizes, and what naming them gains on held-out records in the channel where they show most."""
    if found["verdict"] == "nothing":
        return "The simulation lacks nothing that these records show."
    if not found["causes"]:
        return "The simulation lacks something that no known cause explains."
    causes = []
    for c in found["causes"]:
        sizes = ", ".join(f"{name} {p['value']:.3g} {p['unit']}".rstrip() for name, p in c["parameters"].items())
        ties = f", or {' or '.join(c['ties'])}" if c["ties"] else ""
        causes.append(f"{c['effect']}@{c['at']} ({sizes}){ties}")
    best = min(found["stages"], key=lambda e: e["extended"] / e["recalibrated"] if e["recalibrated"] else 1.0)
    gain = (
        f"with it the full-run error of {best['channel']} on {best['record']} falls from {best['recalibrated']:.3g} to "
        f"{best['extended']:.3g} {best['unit']}"
    )
    more = " Something more is missing." if found["verdict"] == "incomplete" else ""
    return f"The simulation lacks {' and '.join(causes)}: {gain}.{more}"


def _loops_said(errors: Mapping[str, Mapping[str, tuple[float, str]]]) -> str:
    """The errors of the closed loops."""
    each = "; ".join(f"{law} {', '.join(f'{y} {e:.3g} {unit}' for y, (e, unit) in own.items())}" for law, own in errors.items())
    return f"RMS errors in closed loop on the extended machine: {each}."


def _models_said(scores: Mapping[str, Any]) -> str:
    """The model with the best worst FIT of a held-out free run, and its range for every output."""
    spans, worst = {}, {}
    for model in scores["models"]:
        own = [s for s in model["scores"] if s["split"] == "held-out" and s["horizon"] == "free-run"]
        fits = {y: [_fit(s) for s in own if s["output"] == y] for y in dict.fromkeys(s["output"] for s in own)}
        ranges = [f"{y} {min(fit):.0f}" + f" to {max(fit):.0f}" * (len(fit) > 1) + " %" for y, fit in fits.items()]
        spans[model["model"]], worst[model["model"]] = ", ".join(ranges), min(min(fit) for fit in fits.values())
    best = max(worst, key=lambda name: worst[name])
    others = f", best of {', '.join(spans)}" if len(spans) > 1 else ""
    return f"{best} follows held-out records with a free-run FIT of {spans[best]}{others}."


def _fit(score: Mapping[str, Any]) -> float:
    """A free run that ran away has none in the file."""
    return -np.inf if score["FIT"] is None else score["FIT"]


def _loop_errors(folder: Path) -> dict[str, dict[str, tuple[float, str]]]:
    """The errors of each law's loop."""
    return {law: _tracked(read_file(folder / f"loop-{law}" / "limits.csv")) for law in LAWS}


def _tracked(run: Experiment) -> dict[str, tuple[float, str]]:
    """RMS error of every output in a loop, with its unit."""
    return {y: (tracking(run[f"{y}_set"] - run[y], run.dt)["RMS"], run.channel(y).unit) for y in OUTPUTS}


def _checked_said(found: Mapping[str, Any]) -> str:
    """The overall status, counts, and the claims that are broken or open."""
    claims: dict[str, list[str]] = {}
    for v in found["verdicts"]:
        claims.setdefault(v["status"], []).append(v["claim"])
    counts = _counted_said(found)
    rest = "".join(f" {status}: {'; '.join(claims[status])}." for status in ("FAILED", "UNDECIDED") if status in claims)
    return f"{found['status']} ({counts}).{rest}"


def _counted_said(found: Mapping[str, Any]) -> str:
    """How many verdicts of each kind."""
    every = [v["status"] for v in found["verdicts"]]
    return ", ".join(f"{every.count(status)} {status}" for status in dict.fromkeys(every))


# ---- the page -------------------------------------------------------------------------------------------------------------


def _report(
    folder: Path, done: Mapping[str, Done], said: str, hidden: Hidden | None, source: Mapping[str, Any], quick: bool
) -> Report:
    titles = {
        "diagnosis": "What the simulation gets wrong", "models": "Models", "pid": "Scheduled PID",
        "check-pid": "Is the scheduled PID safe", "check-mpc": "Is the MPC safe",
    }  # fmt: skip
    pages = {name: read_report(done[name].folder) for name in titles}
    parts = {name: _section(titles[name], name, pages[name]) for name in titles}
    loops = Section("Closed loop on the extended plant", _loops(folder))
    sections = [parts["diagnosis"], parts["models"], parts["pid"], loops, parts["check-pid"], parts["check-mpc"]]
    if hidden:
        sections.append(Section("What was hidden", (Text(_revealed(folder, hidden)),)))
    sections.append(Section("Stages", (), (_stage_table(done),)))
    title = "Web winding machine: from records to verdicts" + " (quick look)" * quick
    return Report(title, said, (*sections, Section("Provenance", (), (Provenance(source),))), _brief(folder, pages))


def _brief(folder: Path, pages: Mapping[str, Report]) -> Brief:
    """Which law, what to mend, and the badges of the model, the cause and the law's safety."""
    checks = {law: read_json(folder / f"check-{law}" / "check.json") for law in LAWS}
    law, why = chosen({law: own["verdicts"] for law, own in checks.items()}, _loop_errors(folder))
    law = law or next(iter(LAWS))
    model, cause = (_briefed(pages[name]).badges[0] for name in ("models", "diagnosis"))
    diagnosed = _briefed(pages["diagnosis"])
    status = Status(checks[law]["status"])
    held = f"{LAWS[law]}: {_counted_said(checks[law])}."
    held = f"{held[:1].upper()}{held[1:]}"
    if status in (Status.UNDECIDED, Status.FAILED):
        worst = next(v for v in checks[law]["verdicts"] if v["status"] == status.value)
        held += (
            f" {'Not decided' if status is Status.UNDECIDED else 'Broken'}: {worst['claim']}; {worst['sentence'].split(';')[0]}."
        )
    safety = Badge("Safety", status.value, held, STANDING[status])
    return Brief(
        "Which law, what does the simulation lack, and is the loop safe?",
        f"{why}\n\n{diagnosed.todo}",
        (replace(model, about="Model"), replace(cause, about="Cause"), safety),
        diagnosed.picture,
    )


def _briefed(page: Report) -> Brief:
    assert page.brief is not None  # every stage's page that is shown has one
    return page.brief


def chosen(
    verdicts: Mapping[str, Sequence[Mapping[str, Any]]], errors: Mapping[str, Mapping[str, tuple[float, str]]]
) -> tuple[str | None, str]:
    """The law to take, and why, in a sentence; None where each breaks a limit.

    What breaks nothing goes first, then what is proved stable, then the smaller errors, as a mean over outputs.
    """
    broken = {law: [v["claim"] for v in own if v["status"] == Status.FAILED.value] for law, own in verdicts.items()}
    safe = [law for law in verdicts if not broken[law]]
    if not safe:
        return None, f"Switch none of the laws on: {'; '.join(f'{LAWS[law]} breaks {own[0]}' for law, own in broken.items())}."

    def proved(law: str) -> bool:
        of_loop = [v["status"] for v in verdicts[law] if v["claim"].startswith("stable")]
        return bool(of_loop) and set(of_loop) == {Status.PROVED.value}

    def size(law: str) -> float:
        each = [errors[law][y][0] / max(errors[other][y][0] for other in errors) for y in errors[law]]
        return float(np.mean(each)) if each else math.inf

    best = min(safe, key=lambda law: (not proved(law), size(law)))
    told = ["its stability is proved"] if proved(best) else []
    for law in (law for law in verdicts if law != best):
        less = 1.0 - size(best) / size(law)
        beside = f"its errors are {100.0 * abs(less):.0f} % {'smaller' if less > 0.0 else 'larger'} than those of the {LAWS[law]}"
        told.append(f"the {LAWS[law]} breaks {broken[law][0]}" if broken[law] else beside)
    return best, f"Take the {LAWS[best]}: {'; '.join(told)}."


def _section(title: str, name: str, page: Report) -> Section:
    """The blocks of a stage's page that belong on the page of the chain; what it says in words is folded."""
    blocks: list[Block] = []
    more: list[Block] = [Text(page.verdict)]
    for own in page.sections:
        if own.title in SHOWN[name]:
            blocks += own.blocks
            more += own.more
    first = page.first if name != "diagnosis" else ()  # that picture begins the page
    return Section(title, (*first, *blocks, Text(f"All of it: {name}/report.html beside this page.")), tuple(more))


def _loops(folder: Path) -> tuple[Block, ...]:
    """Both laws through the run of the limits, with noise: outputs beside their set-points, and commands."""
    runs = {LAWS[law]: read_file(folder / f"loop-{law}" / "limits.csv") for law in LAWS}
    first = next(iter(runs.values()))
    shown = [
        figures.Followed(
            first.channel(name), first[f"{name}_set"] if name in OUTPUTS else None, {law: run[name] for law, run in runs.items()}
        )
        for name in (*OUTPUTS, "V1", "V2")
    ]
    errors = {law: _tracked(run) for law, run in runs.items()}
    table = Table(
        "Errors of the closed loop",
        ("law", *(f"{name} RMS [{unit}]" for name, (_, unit) in next(iter(errors.values())).items())),
        tuple((law, *(value for value, _ in own.values())) for law, own in errors.items()), digits=3,
        caption="Set-point minus measured value, noise in it, over the whole run.", best=min,
    )  # fmt: skip
    return figures.closed_loop("Run of limits.toml", first.t, shown), table


def _revealed(folder: Path, hidden: Hidden) -> str:
    found = read_json(folder / "diagnosis" / "diagnosis.json")
    named = "; ".join(
        f"{c['effect']}@{c['at']}: "
        + ", ".join(
            f"{n} {p['value']:.4g} {p['unit']} (95 %: {p['low']:.4g} to {p['high']:.4g})" for n, p in c["parameters"].items()
        )
        for c in found["causes"]
    )
    return (
        f"These records were simulated, with {hidden.effect} in the machine ({hidden.parameter} {hidden.size:.4g}), drawn from "
        f"the seed; no stage was told of it. The diagnosis says: {found['verdict']}{f', {named}' if named else ''}."
    )


def _stage_table(done: Mapping[str, Done]) -> Table:
    rows = tuple((name, d.stage.command, d.seconds, "no" if d.fresh else "yes") for name, d in done.items())
    caption = "Each of them is a command to type in this folder. Seconds are those of the time when it ran."
    return Table("Stages", ("folder", "command", "time [s]", "as before"), rows, caption, digits=3)
