"""Are the loops of the web winding machine safe on every machine that the records leave open?

The controllers of the comparison under check: margins over the radius, proved and refuted; limits along a run, with the runs that
come nearest; the worst machines within the tolerances of the data sheet; what one more record would buy; and what it costs to
tighten a design until its limits are proved. Random trials stand beside every search, with the same number of runs.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from controllers.files import save_controller
from controllers.mpc import MPC, design_mpc
from controllers.pid_design import design_pid
from controllers.receding import Weights
from controllers.scheduled_pid import ScheduledPID
from plants import PLANTS
from studies.experiments import measured
from studies.loops import WINDING_LIMITS, benches
from workbench.answers.check import badge, counted, verdict_table
from workbench.data import Channel, Dataset
from workbench.errors import InputError
from workbench.files import write_json
from workbench.intervals.errors import ErrorRegression
from workbench.intervals.model import IntervalModel
from workbench.lpv import LPVModel
from workbench.metrics import tracking
from workbench.physics.controller import Controller
from workbench.provenance import provenance
from workbench.records import record
from workbench.report import figures
from workbench.report.blocks import Block, Brief, Provenance, Report, Section, Table
from workbench.report.page import write_report
from workbench.robustness.envelopes.adversary import worst
from workbench.robustness.envelopes.course import Course, nominal, replay
from workbench.robustness.falsify.box import tolerance_box
from workbench.robustness.falsify.search import at_random, worst_plant
from workbench.robustness.falsify.trials import Search
from workbench.robustness.frozen import Bounds
from workbench.robustness.limits import Limit, LoopLimits, Manoeuvre
from workbench.robustness.loop import course_of, driven
from workbench.robustness.machine import machine_with_errors
from workbench.robustness.margins import Margin, margin
from workbench.robustness.verdict import Status, Verdict, overall
from workbench.simulation import Scenario, simulate
from workbench.verification.model import Open, on_model, opened
from workbench.verification.part import Part
from workbench.verification.plant import on_plant

Say = Callable[[str], None]

WINDING = PLANTS["web-winding"]
ROLES = {"inputs": ("V1", "V2"), "outputs": ("w3", "theta"), "schedule": ("r2",)}
RECORDED = ("prbs1", "rbs", "prbs2", "sine", "rgs", "prbs1", "rbs", "prbs2")  # one after the other, each with its own seed
DURATION = 30.0  # s
SETPOINTS = {"w3": ((0.0, 100.0), (8.0, 105.0)), "theta": ((0.0, 0.0), (16.0, 5.0))}
LIMITS = (
    Limit("theta", low=-40.0, high=40.0, begin=2.0, unit="deg"),
    Limit("w3", band=3.0, settling=5.0, unit="rad/s"),
    Limit("V1", low=-2.0, high=3.0, rate=50.0, unit="V"),
    Limit("V2", low=0.0, high=3.0, rate=50.0, unit="V"),
)
TIGHTER = (1.45, 1.3)  # bounds on |S| and |T| of a re-design
BACKED_OFF = (10.0,)  # deg, what the MPC of a re-design keeps; that of the comparison keeps 20
NODES = 5  # of the radius
FULL = 90.0  # s, in which the whole reel runs off at 100 rad/s
TRIALS = (400, 60, 25)  # runs of the plant for each limit: of a compiled law, of an MPC, and of an NMPC, whose run takes seconds


@record
class Law:
    """A controller under check: its verdicts on the model (none for a law without a linear form) and on the plant."""

    name: str
    controller: Any
    on_model: Part
    on_plant: Part
    rms: Mapping[str, float]

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        return (*self.on_model.verdicts, *self.on_plant.verdicts)


def main(
    quick: bool = False,
    *,
    folder: Path,
    data: str | None = None,
    seed: int = 1,
    json: str | None = None,
    say: Say = print,
    progress: Say = lambda _: None,
) -> Path:
    """Design, check, compare and tighten; returns the report's path. Raises InputError for `data`."""
    if data is not None:
        raise InputError("this study needs the machine itself", mend="leave --data out; workbench check takes your own records")
    folder.mkdir(parents=True, exist_ok=True)
    bench = benches()[WINDING.name]
    designed = bench.design(quick, seed, progress)
    model = next(iter(designed.models.values()))
    records = recorded(seed, len(RECORDED) if not quick else 3, progress)
    left = opened(ErrorRegression(), model, Dataset(records[:2]))
    errors = left.errors
    laws = {name: law for name, law in designed.laws.items() if name != "NMPC" or not quick}
    nodes, runs = (2, (60, 10, 10)) if quick else (NODES, TRIALS)
    rate = None if quick else float(np.ptp(model.span)) / FULL  # as fast as the reel runs off
    checked = [
        _checked(name, law, left, folder, nodes, runs, seed, progress, rate if name == bench.scheduled else None)
        for name, law in laws.items()
    ]
    sections = [
        Section("Verdicts", tuple(_verdicts(law) for law in checked)),
        *(Section(f"{law.name} on the identified model", (), law.on_model.blocks) for law in checked if law.on_model.blocks),
        *(Section(f"{law.name} on the worst machine", (), law.on_plant.blocks) for law in checked),
    ]
    scheduled: Any = designed.laws[bench.scheduled]
    sections.append(Section("Searched and tried at random", _against_random(model, errors, scheduled, quick, seed, progress)))
    sections.append(Section("One more record", _more_records(model, records, scheduled, progress)))
    tightened = _tightened(left, designed.laws, folder, runs, quick, seed, progress)
    sections.append(Section("Tightened until proved", (_cost(checked, tightened), *map(_verdicts, tightened))))
    source = provenance({"study": "robust-winding", "quick": quick}, [], seed)
    said = verdict([*checked, *tightened])
    content = {
        "verdicts": {law.name: [v.to_dict() for v in law.verdicts] for law in (*checked, *tightened)},
        "provenance": source,
    }
    for path in (folder / "robust-winding.json", json):
        if path:
            write_json(path, content)
    sections.append(Section("Provenance", (), (Provenance(source),)))
    page = Report("Robustness of the winding machine's loops", said, tuple(sections), _brief(checked))
    path = write_report(page, folder)
    say(f"{said}\n\nreport: {path}")
    return path


def verdict(laws: Sequence[Law]) -> str:
    """A line for each law."""
    return "\n\n".join(_said(law) for law in laws)


def _brief(laws: Sequence[Law]) -> Brief:
    """How each law stands."""
    broken = [law.name for law in laws if overall(law.verdicts) is Status.FAILED]
    whole = [law.name for law in laws if law.name not in broken]
    todo = [f"Nothing breaks {', '.join(whole)}."] * bool(whole) + [f"Do not switch on: {', '.join(broken)}."] * bool(broken)
    badges = tuple(badge(law.name, law.verdicts) for law in laws)
    return Brief("Which loops keep what is asked on every machine that the records leave open?", " ".join(todo), badges)


def _said(law: Law) -> str:
    """Counts, and what is open or lost."""
    claims = {status: [v.claim for v in law.verdicts if v.status is status] for status in (Status.FAILED, Status.UNDECIDED)}
    rest = "".join(f" {status.value}: {'; '.join(own)}." for status, own in claims.items() if own)
    return f"{law.name}: {counted(law.verdicts)}.{rest}"


def recorded(seed: int, count: int, progress: Say) -> tuple:
    """The first records of RECORDED."""
    found = []
    for number, name in enumerate(RECORDED[:count]):
        progress(f"record {number + 1}: {name}")
        found.append(measured(WINDING, name, seed + number).with_roles(**ROLES))
    return tuple(found)


def asked() -> LoopLimits:
    """What every law is asked to keep."""
    return LoopLimits(LIMITS, Manoeuvre(DURATION, SETPOINTS), stable=True, margin=1.0, sensitivity=None)


def _checked(
    name: str, law: Any, left: Open, folder: Path, nodes: int, runs: tuple[int, int, int], seed: int, progress: Say,
    rate: float | None = None,
) -> Law:  # fmt: skip
    """A law under check, on model and plant."""
    own = folder / name.replace(" ", "-")
    own.mkdir(exist_ok=True)
    save_controller(law, own / "controller.json")
    progress(f"{name}: on the identified model")
    proved = on_model(left, law, asked(), WINDING, nodes=nodes, rate=rate, progress=progress)
    progress(f"{name}: on the machine")
    own_runs = runs[0 if isinstance(law, Controller) else 1 if isinstance(law, MPC) else 2]
    tried = on_plant(WINDING, law, asked(), runs=own_runs, seed=seed, progress=progress)
    for part in (proved, tried):
        part.save(own)
    return Law(name, law, proved, tried, _rms(law, seed))


def _rms(law: Any, seed: int) -> dict[str, float]:
    """Errors of the run of the check, with noise: what tightening costs."""
    run = asked().run
    assert run is not None
    noisy = Manoeuvre(run.duration, run.setpoints, run.start, seed).scenario(WINDING, law)
    done = simulate(WINDING, law, noisy, bumpless=True)
    source = dict(zip(law.measured, law.references, strict=False))  # outputs with a set-point come first
    seen = done.experiment
    return {y: tracking(seen[y] - seen[source[y]], seen.dt)["RMS"] for y in ("w3", "theta")}


def _verdicts(law: Law) -> Table:
    return verdict_table(law.verdicts, f"{law.name}: verdicts")


# ---- margins ------------------------------------------------------------------------------------------------------------


def _margin(model: LPVModel, errors: Sequence[IntervalModel], law: ScheduledPID, rho: float) -> Margin:
    return margin(driven(machine_with_errors(model, errors, rho), law, rho).undriven())


# ---- search against chance ----------------------------------------------------------------------------------------------


def _against_random(
    model: LPVModel, errors: Sequence[IntervalModel], law: ScheduledPID, quick: bool, seed: int, progress: Say
) -> tuple[Block, ...]:
    """The largest deviation of the tension found by the adversary and by as many random sequences; the same on the machine."""
    progress("adversary and random sequences")
    samples = 500
    references = np.tile([SETPOINTS[y][0][1] for y in law.measured], (samples, 1))
    middle = np.full(samples, float(np.mean(model.span)))
    own = course_of(model, errors, law, middle, references, noise=False)
    found = worst(own, [("theta", samples - 1, 1)], seed=seed)
    i, run = own.number("theta"), nominal(own).v
    adversary = float(found.value[0] - run[-1, i])
    tried = 60 if quick else 500
    moving = _running(own, i, run, np.random.default_rng(seed), tried, samples)
    constant = _running(own, i, run, np.random.default_rng(seed), tried, 1)
    runs = np.arange(1, tried + 1)
    model_picture = _curves(
        "Deviation of the tension that parameters within their boxes reach on the model", runs, "deg",
        {"adversary, 8 starts": np.full(tried, adversary), "random at every sample": moving, "random, constant": constant},
    )  # fmt: skip
    progress("worst machine and random machines")
    limit, box = LIMITS[0], tolerance_box(WINDING)
    run_ = asked().run
    assert run_ is not None
    scenario: Scenario = run_.scenario(WINDING, law)
    budget = 200 if quick else 1000
    search = Search(WINDING, law, scenario, [limit], box, runs=budget, seed=seed, progress=progress)
    searched = worst_plant(search)
    chance = at_random(search if quick else replace(search, runs=10 * budget))
    n = max(len(searched.history), len(chance.history))

    def padded(history: np.ndarray) -> np.ndarray:
        return np.append(history, np.full(n - len(history), history[-1]))

    plant_picture = _curves(
        "How near the worst machine comes to the limit of the tension (0: at the limit, share of what it allows)",
        np.arange(1, n + 1), "", {"searched": padded(searched.history), "random": padded(chance.history)},
    )  # fmt: skip
    return model_picture, plant_picture


def _running(own: Course, i: int, run: np.ndarray, random: np.random.Generator, tried: int, changes: int) -> np.ndarray:
    """The largest deviation so far of random corner sequences, from the rest with the first of them.

    changes: 1 for constant ones, else as many as samples.
    """
    best = []
    for _ in range(0, tried, 20):
        delta = random.choice([-1.0, 1.0], size=(20, changes, own.lam.shape[1]))
        delta = np.broadcast_to(delta, (20, len(own), own.lam.shape[1]))
        best += list(replay(own, delta, own.begun(delta[:, 0]))[:, -1, i] - run[-1, i])
    return np.maximum.accumulate(best)[:tried]


def _curves(title: str, runs: np.ndarray, unit: str, curves: Mapping[str, np.ndarray]) -> Block:
    over = figures.Trace(Channel("runs", "", "other"), runs.astype(float))
    return figures.over_schedule(title, over, {f"largest so far {unit and f'[{unit}]'}".rstrip(): dict(curves)}, title)


# ---- records and re-design ----------------------------------------------------------------------------------------------


def _more_records(model: LPVModel, records: Sequence[Any], law: ScheduledPID, progress: Say) -> tuple[Block, ...]:
    """Widths of the boxes and the proved margin against the number of records, with the error bound of all of them."""
    full = ErrorRegression().fit(model, Dataset(tuple(records)))
    bound = [float(own.modes[0].box.radius[-1]) for own in full]
    counts = range(1, len(records) + 1)
    widths: dict[str, list[float]] = {}
    proved, refuted = [], []
    for count in counts:
        progress(f"{count} records")
        errors = ErrorRegression(bound=bound).fit(model, Dataset(tuple(records[:count])))
        for own in errors:
            for name, radius in zip(own.form.names[:-1], own.modes[0].box.radius[:-1], strict=True):
                widths.setdefault(f"{own.output.name.removeprefix('error of ')} from {name}", []).append(float(radius))
        found = _margin(model, errors, law, float(model.span[0]))
        proved.append(found.certified.kappa)
        refuted.append(found.falsified.kappa)
    over = figures.Trace(Channel("records", "", "other"), np.array(counts, dtype=float))
    relative = {name: np.array(values) / values[0] for name, values in widths.items()}
    margins = {"proved": np.array(proved), "refuted": np.array(refuted)}
    w3 = {name: v for name, v in relative.items() if name.startswith("w3")}
    theta = {name.replace("theta from", "from"): v for name, v in relative.items() if name.startswith("theta")}
    return (
        figures.over_schedule(
            "Width of the boxes, of that with one record", over,
            {"error of w3": {n.replace("w3 from", "from"): v for n, v in w3.items()}, "error of theta": theta},
            "Every record takes away what it refutes. The bound on what no parameter explains is that of all records.",
        ),
        figures.over_schedule(
            f"Margin of the scheduled PID at r2 = {model.span[0]:.3g} m", over, {"boxes, times as wide": margins},
            "How many times as wide the boxes may be.",
        ),
    )  # fmt: skip


def _tightened(
    left: Open, laws: Mapping[str, Any], folder: Path, runs: tuple[int, int, int], quick: bool, seed: int, progress: Say
) -> list[Law]:  # fmt: skip
    """PIDs with lower peaks, and MPCs that keep a distance from the limit."""
    found, model = [], left.model
    usual = np.array([SETPOINTS[y][0][1] for y in ("w3", "theta")])
    for peak in TIGHTER if not quick else TIGHTER[-1:]:
        name = f"scheduled PID, peaks {peak:g}"
        progress(f"designing the {name}")
        own = design_pid(
            model, knots=3 if quick else 5, bounds=Bounds(peak, peak), structure=WINDING_LIMITS, setpoint=usual
        ).law  # fmt: skip
        found.append(_checked(name, own, left, folder, 2, runs, seed, progress))
    mpc = next((law for law in laws.values() if isinstance(law, MPC)), None)
    for kept in BACKED_OFF if mpc is not None and not quick else ():
        assert mpc is not None
        name = f"LPV-MPC that keeps {kept:g} deg"
        progress(f"designing the {name}")
        weights: Weights = mpc.weights
        own = design_mpc(model, mpc.fallback, weights=weights, y_low=np.array([-np.inf, -kept]), y_high=np.array([np.inf, kept]))
        found.append(_checked(name, own, left, folder, 2, runs, seed, progress))
    return found


def _cost(checked: Sequence[Law], tightened: Sequence[Law]) -> Block:
    """Verdicts against errors of the machine."""
    rows = tuple(
        (
            law.name,
            *(sum(v.status is status for v in law.verdicts) for status in Status),
            *_every(law, "theta"), _left(law, "theta"), law.rms["w3"], law.rms["theta"],
        )
        for law in (*checked, *tightened)
    )  # fmt: skip
    header = (
        "law", *(status.value for status in Status), "theta proved from [deg]", "to [deg]", "left on the worst machine [deg]",
        "RMS error of w3 [rad/s]", "RMS error of theta [deg]",
    )  # fmt: skip
    return Table(
        "What tightening buys and costs", header, rows, "RMS errors of the same run on the machine, with noise.", digits=3
    )


def _every(law: Law, signal: str) -> tuple[float, float]:
    """What every run on the model is proved to stay between."""
    known = [v.every for v in law.on_model.verdicts if v.claim.startswith(f"{signal}:") and v.every]
    return known[0] if known else (float("nan"), float("nan"))


def _left(law: Law, signal: str) -> float:
    """What the worst machine leaves of a limit."""
    return next(v.margin for v in law.on_plant.verdicts if v.claim.startswith(f"{signal}:"))
