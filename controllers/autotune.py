"""A PID from one record of a step, a relay or a closed loop: which process it shows, which gains suit it, and how surely.

tuned = autotune(wb.read("step.csv", inputs="valve", outputs="level"))
tuned.gains["standard"]        # {"Kc": .., "Ti": .., "Td": ..}
tuned.save("runs/level")       # autotune.json, pid.json, process.json, report.html

The record leaves the process open within a covariance (`workbench.identification.process`), and often its form. Processes are
drawn from every form that may be the true one, and the PID keeps |S| within its bound on them: it is designed with the worst ones
among its models until it does, made calmer where that does not end, and refused where neither helps.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from controllers.designs import ScheduledPIDDesign
from controllers.files import save_controller
from controllers.pid import pid, standard_form
from controllers.scheduled_pid import ScheduledPID
from workbench.answers.answer import Answer, Records, as_dataset
from workbench.data import Channel, Dataset
from workbench.errors import InputError
from workbench.files import nullable, write_json
from workbench.identification.process import FORMS, Process, fit_processes, free_run, rivals
from workbench.lpv import LPVModel
from workbench.progress import Progress, silent
from workbench.records import field, record
from workbench.report import figures
from workbench.report.blocks import Badge, Brief, Picture, Provenance, Report, Section, Standing, Table
from workbench.report.figures import Followed, Trace
from workbench.report.page import write_report
from workbench.robustness.frozen import largest_sensitivity

AUTOTUNE_FILE, PROCESS_FILE, PID_FILE = "autotune.json", "process.json", "pid.json"
DRAWS, RIVAL_DRAWS = 60, 30  # processes drawn of the likeliest form, and of every other that may be the true one
SPARED, ROUNDS, ADDED = 1 / 60, 5, 2  # share of them that may be beyond; designs, and models that each adds
RESERVE = 0.95  # of |S| - 1, that the design keeps on drawn processes: no process is quite of one of these forms
KEPT = 1.005  # times the bound that |S| of a drawn process may have
WEAK = 0.5  # times the integral gain of the calmer law, below which a law found for several processes is a failed search
CYCLES = 40.0  # of the law in the dead time and the time constant, where none is asked for
MOST_CYCLES = 200.0  # in the dead time
WEIGHTS, OVERSHOOT = (1.0, 0.8, 0.6, 0.4, 0.2, 0.0), 0.1  # of the set-point: the largest that overshoots by no more
COMPLEMENTARY = 1.3, 1.15, 1.05  # largest |T|: more of it overshoots after a step of the set-point
CALMER, CALMED = 0.85, 10  # times the gains where no law is found for all processes at once, and how often at most
STEP, LOAD = 0.5, 0.25  # of the span of the record, that the loop is tried with
SHORTEST, LONGEST = 200, 4000  # samples of a trial
TIME_UNITS = "s", "min"
NAMES = {
    "lag": "a lag", "second-order": "a process of second order", "ramp": "a process that integrates",
    "lagged-ramp": "a process that integrates, with a lag",
}  # fmt: skip


def autotune(
    records: Dataset, *, sensitivity: float = 1.6, derivative: bool = True, effort: float = 3.0, cycle: float | None = None,
    present: Sequence[float] | None = None, forms: Sequence[str] = FORMS, seed: int = 0, progress: Progress = silent,
) -> "Autotuned":  # fmt: skip
    """A PI or PID for the process that records of one input and one output show, |S| within `sensitivity` on all that they leave.

    effort: how hard it may act, see `ScheduledPIDDesign`; cycle [s]: of the controller, by default a whole number of samples;
    present (Kc, Ti [s], Td [s]): what is set now, in standard form, to be looked at beside it. Raises InputError for records that
    show too little, and where no PID keeps the bounds.

        >>> tuned = autotune(data)
        >>> f"{tuned.process.form} of {tuned.process.T:.2f} s"
        'lag of 0.10 s'
    """
    data = as_dataset(records)
    if cycle is not None and not 0.0 < cycle < np.inf:
        raise InputError(f"cycle {cycle:g}", mend="the cycle of the controller in s, above 0")
    if present is not None and not (len(present) == 3 and np.isfinite(present).all() and present[1] > 0.0):
        raise InputError(f"present {present}", mend="gain, integral time and derivative time: 2.0, 30, 5")
    progress("fitting processes")
    found = fit_processes(data, forms)
    best = found[0]
    u, y = _channels(data)
    usual = best.dt * max(1.0, np.floor((best.L + best.slowest / 4.0) / (CYCLES * best.dt)))
    cycle = cycle or usual
    if MOST_CYCLES * cycle < best.L:
        mend = f"leave the cycle out: gains for {usual:.3g} s suit a faster controller, too"
        raise InputError(f"cycle {cycle:g} s of a controller behind a dead time of {best.L:.3g} s", mend=mend)
    random = np.random.default_rng(seed)
    processes = best.drawn(random, DRAWS)
    for rival in rivals(best, found[1:]):
        processes += [rival, *rival.drawn(random, RIVAL_DRAWS)]
    nominal, drawn = best.model(cycle, u, y), [p.model(cycle, u, y, f"drawn {i}") for i, p in enumerate(processes)]
    spans = [max(float(np.ptp(e[c.name])) for e in data) for c in (y, u)]
    size = STEP * spans[0], LOAD * spans[1]
    options = {"sensitivity": 1.0 + RESERVE * (sensitivity - 1.0), "derivative": derivative, "effort": effort}
    law, peaks = _designed(nominal, drawn, options, best, size, progress)
    now = None
    if present is not None:
        Kp, Ki, Kd = standard_form(*(np.array([value]) for value in present))
        now = pid((u.name,), (y.name,), law.references, cycle, Kp, Ki, Kd, Tf=law.Tf, name="present")
    progress("trying it on what the record leaves open")
    far = drawn[int(np.argmax(peaks[1:]))]
    N = _length(best, law)
    runs = {"new": _run(law, nominal, size, N)}
    if now is not None:
        runs["present"] = _run(now, nominal, size, N)
    runs["new, on the worst process"] = _run(law, far, size, N)
    margin = largest_sensitivity(now, nominal, [None]) if now is not None else None
    return Autotuned(best, tuple(found[1:]), law, peaks, sensitivity, size, runs, margin, Records(data, None, tuple(data.notes)))


def _designed(
    nominal: LPVModel, drawn: Sequence[LPVModel], options: dict[str, Any], process: Process, size: tuple[float, float],
    progress: Progress,
) -> tuple[ScheduledPID, np.ndarray]:  # fmt: skip
    """The law, and its largest |S| on the nominal process and on the drawn ones.

    |T| is bounded as little as a step of the set-point on the nominal process allows. Raises InputError where no law keeps |S|
    on the drawn ones.
    """
    law = None
    for most in COMPLEMENTARY:
        progress(f"designing, |T| up to {most:g}")
        try:
            law, overshoot = _law(nominal, (), {**options, "complementary": most}, process, size)
        except InputError:
            if law is None:
                raise
            break  # of a process that integrates |T| is above 1
        options["complementary"] = most
        if overshoot <= OVERSHOOT:
            break
    assert law is not None
    kept: list[LPVModel] = []
    for attempt in range(ROUNDS + CALMED + 1):
        peaks = _peaks(law, nominal, drawn)
        beyond = np.flatnonzero(peaks[1:] > KEPT * options["sensitivity"])
        if len(beyond) <= SPARED * len(drawn):
            return law, peaks
        if attempt >= ROUNDS:
            law = _calmer(law, process)
            continue
        kept += [drawn[k] for k in beyond[np.argsort(-peaks[1:][beyond])][:ADDED] if drawn[k] not in kept]
        progress(f"designing, {1 + len(kept)} processes")
        calmer = _calmer(law, process)
        try:
            law, _ = _law(nominal, tuple(kept), options, process, size)
        except InputError:
            law = calmer
        if abs(law.Ki.sum()) < WEAK * abs(calmer.Ki.sum()):
            law = calmer
    told = "no gains keep |S| within its bound on the processes that the record leaves open"
    raise InputError(told, mend="a longer record, or a larger step: it shows the process more exactly")


def _calmer(law: ScheduledPID, process: Process) -> ScheduledPID:
    """Slower by `CALMER`: all gains of a stable process; of one that integrates the crossover, at the same phase."""
    powers = {"Kp": 1, "Ki": 2, "Kd": 0} if process.integrates else {"Kp": 1, "Ki": 1, "Kd": 1}
    return replace(law, **{name: CALMER**power * getattr(law, name) for name, power in powers.items()})


def _law(
    nominal: LPVModel, kept: tuple[LPVModel, ...], options: Mapping[str, Any], process: Process, size: tuple[float, float]
) -> tuple[ScheduledPID, float]:
    """The least variance under load steps, with the largest weight of the set-point with which a step of it overshoots little;
    and by how much it does.
    """
    free = {nominal.outputs[0].name: np.inf}
    design = ScheduledPIDDesign(knots=1, feedforward=False, reference_model=free, robust_to=kept, **options)
    law = design.design(nominal).law
    N, overshoot = _length(process, law), np.inf
    for b in WEIGHTS:
        law = replace(law, b=np.array([b]))
        overshoot = _overshoot(_run(law, nominal, size, N), size)
        if overshoot <= OVERSHOOT:
            break
    return law, overshoot


def _peaks(law: ScheduledPID, nominal: LPVModel, drawn: Sequence[LPVModel]) -> np.ndarray:
    """The largest |S| of the nominal process, then of the drawn ones."""
    return np.array([largest_sensitivity(law, m, [None]) for m in (nominal, *drawn)])


# ---- the loop ------------------------------------------------------------------------------------------------------------


class Run(NamedTuple):
    """Set-point, output and command (N) of a step of the set-point and, halfway, of the load."""

    r: np.ndarray
    y: np.ndarray
    u: np.ndarray


def _length(process: Process, law: ScheduledPID) -> int:
    Kp, Ki = float(law.Kp.ravel()[0]), float(law.Ki.ravel()[0])
    time = 4.0 * (process.slowest + abs(Kp / Ki if Ki else 0.0))
    return int(np.clip(2.0 * time / law.dt, SHORTEST, LONGEST))


def _run(law: ScheduledPID, model: LPVModel, size: tuple[float, float], N: int) -> Run:
    """From the equilibrium of the model: a step of the set-point, then one of a load at the input."""
    A, B, C = model.A[0], model.B[0], model.C[0]
    u0, y0 = (float(v.ravel()[0]) for v in (model.operating_point.u, model.operating_point.y))
    x, state = np.zeros(len(A)), law.init(np.array([u0]))
    r = np.where(np.arange(N) >= N // 20, y0 + size[0], y0)
    load = np.where(np.arange(N) >= N // 2, size[1], 0.0)
    y, u = np.empty(N), np.empty(N)
    state = law.follow(state, np.array([u0]), r[:1], np.array([y0])) if N else state
    for k in range(N):
        y[k] = float((C @ x)[0]) + y0
        command, state = law.step(state, r[k : k + 1], y[k : k + 1])
        u[k] = float(command[0])
        x = A @ x + B[:, 0] * (u[k] + load[k] - u0)
    return Run(r, y, u)


def _overshoot(run: Run, size: tuple[float, float]) -> float:
    """Share of the step of the set-point."""
    return max(float(np.max(run.y[: len(run.y) // 2] - run.r[-1])) / size[0], 0.0)


# ---- the answer ----------------------------------------------------------------------------------------------------------


@record
class Autotuned(Answer):
    """A process, a PID for it, and what the record leaves open. `law` runs, exports and is checked like any other.

    others: further forms, the likeliest first. peaks: largest |S| of the process, then of the drawn ones. size: steps of
    set-point and load of `runs`. present: largest |S| of what is set now, where that was given.

        >>> sorted(autotune(data).gains)
        ['parallel', 'series', 'standard']
    """

    process: Process
    others: tuple[Process, ...]
    law: ScheduledPID
    peaks: np.ndarray = field("d")
    sensitivity: float
    size: tuple[float, float]
    runs: Mapping[str, Run]
    present: float | None
    records: Records

    @property
    def gains(self) -> dict[str, dict[str, float]]:
        """Parallel, standard and, where there is one, series form; times in s."""
        Kp, Ki, Kd = (float(K.ravel()[0]) for K in (self.law.Kp, self.law.Ki, self.law.Kd))
        Ti, Td = (Kp / Ki if Ki else np.inf), (Kd / Kp if Kp else 0.0)
        found = {"parallel": {"Kp": Kp, "Ki": Ki, "Kd": Kd}, "standard": {"Kc": Kp, "Ti": Ti, "Td": Td}}
        if np.isfinite(Ti) and 4.0 * Td <= Ti:
            share = 0.5 * (1.0 + math.sqrt(1.0 - 4.0 * Td / Ti))
            found["series"] = {"Kc": Kp * share, "Ti": Ti * share, "Td": Td / share}
        return found

    @property
    def units(self) -> tuple[str, str]:
        """Of the output and the input."""
        u, y = _channels(self.records.own)
        return y.unit, u.unit

    @property
    def kept(self) -> float:
        """Share of the drawn processes on which |S| is within its bound."""
        return float(np.mean(self.peaks[1:] <= KEPT * self.sensitivity))

    @property
    def overshoot(self) -> float:
        """Share of a step of the set-point, on the process itself."""
        return _overshoot(self.runs["new"], self.size)

    @property
    def sentences(self) -> list[str]:
        """The gains, the process, and how surely."""
        own = self.gains["standard"]
        b = float(self.law.b.ravel()[0])
        drawn = self.peaks[1:]
        per = _per((self.units[1], self.units[0]))
        said = [
            f"Kc = {own['Kc']:.4g} {per}".rstrip()
            + f", Ti = {own['Ti']:.4g} s, Td = {own['Td']:.4g} s (standard form), filter of the derivative {self.law.Tf:.3g} s, "
            f"weight of the set-point {b:g}, cycle {self.law.dt:.4g} s.",
        ]
        said.append(f"The record shows {told(self.process, self.units)}; a free run explains {self.process.fit:.0f} % of it.")
        forms = dict.fromkeys(p.form for p in rivals(self.process, self.others) if p.form != self.process.form)
        said += [f"It may as well be {NAMES[form]}: the gains suit both." for form in forms]
        said.append(
            f"|S| is at most {self.peaks[0]:.3g} on it, and within {self.sensitivity:g} on {100 * self.kept:.0f} % of "
            f"{len(drawn)} processes that the record leaves open (largest {drawn.max():.3g})."
        )
        said.append(f"A step of the set-point overshoots by {100 * self.overshoot:.0f} %.")
        if self.present is not None:
            now = "is not stable on this process" if not np.isfinite(self.present) else f"has |S| {self.present:.3g} on it"
            said.append(f"What is set now {now}.")
        if self.process.K < 0.0:
            said.append("The output falls where the input rises: gains are negative (direct action in many controllers).")
        return said

    def to_dict(self) -> dict[str, Any]:
        """Every number."""
        p = self.process
        return nullable({
            "process": _plain(p), "others": [_plain(own) for own in self.others], "gains": self.gains, "filter": self.law.Tf,
            "setpoint_weight": float(self.law.b.ravel()[0]), "cycle": self.law.dt, "overshoot": self.overshoot,
            "sensitivity": {
                "asked": self.sensitivity, "process": self.peaks[0], "drawn": self.peaks[1:], "present": self.present
            },
        })  # fmt: skip

    def report(self, source: Mapping[str, Any] | None = None) -> Report:
        """Gains, the record beside the process, the loop, and what else the record may be."""
        data = self.records.own
        u, y = _channels(data)
        N = len(self.runs["new"].r)
        loop = figures.closed_loop(
            "A step of the set-point, then of the load",
            self.law.dt * np.arange(N),
            (
                Followed(y, self.runs["new"].r, {name: run.y for name, run in self.runs.items()}),
                Followed(u, None, {name: run.u for name, run in self.runs.items()}),
            ),
        )
        fits: list[Picture] = [
            figures.measured_and_simulated(e.name, e.t, Trace(y, e[y.name]), {self.process.form: free_run(self.process, e)})
            for e in data
        ]
        rows = [(form, *(f"{name} = {value:.5g}" for name, value in own.items())) for form, own in self.gains.items()]
        gains = Table(
            "Gains", ("form", "gain", "integral", "derivative"), tuple(rows), caption="Times in s; see the units of the channels."
        )
        forms = tuple(
            (
                p.form,
                "moving" if p.moving else "at rest",
                p.K,
                p.T or None,
                p.zeta if "zeta" in p.names else None,
                p.L,
                p.fit,
                p.bic - self.process.bic,
            )
            for p in (self.process, *self.others)
        )
        header = ("form", "record begins", "K", "T [s]", "zeta", "dead time [s]", "free run [%]", "BIC, worse by")
        badges = (
            Badge(
                "Process", self.process.form, f"A free run explains {self.process.fit:.0f} %.", _standing(self.process.fit > 70.0)
            ),
            Badge(
                "Margins", f"|S| {self.sensitivity:g}", f"Kept on {100 * self.kept:.0f} % of what is left open.", Standing.GOOD
            ),
        )
        brief = Brief(f"Which PID suits {y.name} of this record?", self.sentences[0], badges, loop)
        sections = (
            Section("Gains", (gains,)),
            Section("The record and the process", tuple(fits)),
            Section("Forms of process", (Table("Forms", header, forms, digits=4),)),
            Section("Provenance", (), (Provenance(dict(source or self.records.source({}))),)),
        )
        return Report(f"A PID for {y.name}", "\n\n".join(self.sentences), sections, brief)

    def save(self, folder: str | Path, source: Mapping[str, Any] | None = None) -> Path:
        """Write autotune.json, pid.json, process.json and the page; returns the folder."""
        folder, source = Path(folder), dict(source or self.records.source({}))
        u, y = _channels(self.records.own)
        save_controller(self.law, folder / PID_FILE)
        self.process.model(self.law.dt, u, y).save(folder / PROCESS_FILE)
        write_json(folder / AUTOTUNE_FILE, self.to_dict() | {"provenance": nullable(source)})
        write_report(self.report(source), folder)
        return folder

    __repr__ = Answer.said


def _channels(data: Dataset) -> tuple[Channel, Channel]:
    """The input and the output."""
    first = data.experiments[0]
    u, y = (first.channel(first.names_of(role)[0]) for role in ("input", "output"))
    return u, y


def told(p: Process, units: tuple[str, str]) -> str:
    """A process in words, with 95 % intervals."""
    off = {name: 1.96 * value for name, value in p.deviation.items()}
    unit = _per(units) + "/s" * p.integrates
    said = [f"gain {p.K:.4g} {unit}".rstrip() + f" (+-{100 * off.get('K', 0.0):.2g} %)"]
    if p.T:
        said.append(f"time constant {p.T:.4g} s (+-{100 * off.get('T', 0.0):.2g} %)")
    if p.form == "second-order":
        said.append(f"damping {p.zeta:.3g}")
    said.append(f"dead time {p.L:.4g} s (+-{off.get('L', 0.0):.2g} s)")
    return f"{NAMES[p.form]}: {', '.join(said)}"


def _per(units: tuple[str, str]) -> str:
    """One unit over another, nothing where there is none."""
    over = f"({units[1]})" if "/" in units[1] else units[1] or "1"
    return f"{units[0] or '1'}/{over}" if any(units) else ""


def _plain(p: Process) -> dict[str, Any]:
    return {
        "form": p.form, "K": p.K, "T": p.T, "zeta": p.zeta, "L": p.L, "deviation": p.deviation, "fit": p.fit, "bic": p.bic,
        "u0": p.u0, "y0": p.y0, "moving": p.moving,
    }  # fmt: skip


def _standing(good: bool) -> Standing:
    return Standing.GOOD if good else Standing.OPEN
