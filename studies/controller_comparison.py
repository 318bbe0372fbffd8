"""Which controller should one use? Fixed PID, scheduled PID, MPC and nonlinear MPC through the same runs of the true machine.

Every law is designed from records as a user would, then runs through every scenario with the same seeds of noise and of unlogged
disturbances. Errors are those of the machine, not of its noisy sensors. A run is a row of runs.jsonl, written as soon as it is
done; a study that was cut off goes on where it stopped, with the controllers that its folder holds.
"""

import hashlib
import json as plain_json
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from controllers.files import load_controller, save_controller
from controllers.pictures import POINTS, design_pictures
from controllers.receding import count_statuses
from controllers.scheduled_pid import ScheduledPID
from plants import PLANTS
from studies.loops import Bench, Case, Designed, benches
from workbench.errors import InputError
from workbench.files import read_json, write_json
from workbench.lpv import load_model
from workbench.metrics import tracking
from workbench.progress import Steps
from workbench.provenance import provenance, versions
from workbench.records import record
from workbench.rehearsal import NO_WORSE
from workbench.report import figures
from workbench.report.blocks import Block, Picture, Provenance, Report, Section, Table, Text
from workbench.report.page import write_report
from workbench.robustness.frozen import worst_margins
from workbench.simulation import LeftRangeError, simulate
from workbench.table import made, whole_rows

Say = Callable[[str], None]
Row = dict[str, Any]

SEEDS, QUICK = 20, 2
SAME = 1.02  # ratio of errors up to which one is no larger than another
TIMED = 300  # samples on which a law that runs compiled is timed step by step


def main(
    quick: bool = False,
    *,
    folder: Path,
    data: str | None = None,
    seed: int = 1,
    json: str | None = None,
    say: Say = print,
    progress: Say = lambda _: None,
    cases: int | None = None,
    jobs: int = 1,
) -> Path:
    """Design the laws, run each through every scenario with `cases` seeds (20, 2 with `quick`), write the report.

    Raises InputError for `data`, and for a folder that another version or another seed has begun.
    """
    if data is not None:
        raise InputError("this study makes its own records: the true machine must be at hand", mend="leave --data out")
    count = cases or (QUICK if quick else SEEDS)
    every = benches()
    _prepared(folder, every, quick, seed, progress)
    rows = _run(folder, every, [seed + k for k in range(count)], jobs, progress)
    found = {name: _summed(bench, [row for row in rows if row["machine"] == name]) for name, bench in every.items()}
    source = provenance({"study": "controller-comparison", "seeds": count, "quick": quick}, [folder / "runs.jsonl"], seed)
    said = {name: verdict(every[name], own, _design_note(folder, name)["sensitivity"]) for name, own in found.items()}
    content = {"summary": found, "verdicts": said, "provenance": source}
    for path in (folder / "summary.json", json):
        if path:
            write_json(path, content)
    progress("report")
    path = write_report(_report(folder, every, found, "\n\n".join(said.values()), seed, source), folder)
    say("\n\n".join(said.values()))
    say(f"\ncontrollers: {folder / 'controllers'}\nreport: {path}")
    return path


# ---- the laws ---------------------------------------------------------------------------------------------------------------


def _prepared(folder: Path, every: Mapping[str, Bench], quick: bool, seed: int, progress: Say) -> None:
    """Design the laws that the folder does not hold yet. Raises InputError where another configuration made it."""
    content = {"seed": seed, "quick": quick, "versions": versions()}
    wanted = hashlib.sha256(plain_json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]
    note = folder / "configuration.json"
    if (folder / "runs.jsonl").exists() and not note.exists():
        raise InputError("holds runs, and no configuration.json that says of what", file=folder, mend="give a new --out folder")
    if note.exists() and read_json(note).get("configuration") != wanted:
        raise InputError("begun by another version, another --seed or --quick", file=folder, mend="give a new --out folder")
    write_json(note, {"configuration": wanted} | content)
    for name, bench in every.items():
        done = folder / "controllers" / name / "design.json"
        if done.exists():
            continue
        begin = time.perf_counter()
        designed = bench.design(quick, seed, progress)
        for law, controller in designed.laws.items():
            save_controller(controller, _file(folder, name, law))
        for model, own in designed.models.items():
            own.save(done.parent / f"model-{_stem(model)}.json")
        laws = {"laws": list(designed.laws), "models": list(designed.models), "sensitivity": _sensitivities(designed)}
        laws |= {"rehearsed": designed.rehearsed, "taken": designed.taken}
        write_json(done, laws | {"seconds": time.perf_counter() - begin})  # last: a design that was cut off is made again


def _sensitivities(designed: Designed) -> dict[str, float]:
    """The largest sensitivity of each PID's frozen loops, over the schedule and all models."""
    models = list(designed.models.values())
    span = models[0].span
    rho = [None] if models[0].schedule is None else list(np.linspace(span[0], span[1], POINTS))
    found = {}
    for law, own in designed.pids.items():
        found[law] = float(worst_margins(own.law, models, rho, own.bounds, own.scale).sensitivity.max())
    return found


def _stem(name: str) -> str:
    return name.lower().replace(" ", "-")


def _file(folder: Path, machine: str, law: str) -> Path:
    return folder / "controllers" / machine / f"{_stem(law)}.json"


@cache
def _law(folder: Path, machine: str, law: str) -> Any:
    return load_controller(_file(folder, machine, law), PLANTS.__getitem__)


def _design_note(folder: Path, machine: str) -> dict[str, Any]:
    return read_json(folder / "controllers" / machine / "design.json")


def _laws(folder: Path, machine: str) -> list[str]:
    return _design_note(folder, machine)["laws"]


# ---- runs -------------------------------------------------------------------------------------------------------------------


@record
class Job:
    """One run; mark: a hash of the law's file and of what happens in the scenario."""

    machine: str
    case: str
    law: str
    seed: int
    mark: str

    @property
    def row(self) -> Row:
        """What names the run in its row."""
        return dict(vars(self))


def _run(folder: Path, every: Mapping[str, Bench], seeds: Sequence[int], jobs: int, progress: Say) -> list[Row]:
    """A row for every machine, scenario, law and seed; those that the folder holds are not run again."""
    table = folder / "runs.jsonl"
    marks = {
        (name, case.name, law): _mark(bench, case, _file(folder, name, law))
        for name, bench in every.items()
        for case in bench.cases
        for law in _laws(folder, name)
    }
    wanted = [
        Job(name, case.name, law, seed, marks[name, case.name, law])
        for seed in seeds
        for name, bench in every.items()
        for case in bench.cases
        for law in _laws(folder, name)
    ]
    rows = {_key(row): row for row in whole_rows(table)}  # of other laws and scenarios too; those are not asked for
    todo = [job for job in wanted if _key(job.row) not in rows]
    steps = Steps(progress, len(wanted), "runs", before=len(wanted) - len(todo))
    for row in made(table, partial(run_job, folder=folder), todo, jobs):
        rows[_key(row)] = row
        steps.done(1, _said(row))
    return [rows[_key(job.row)] for job in wanted]


def _key(row: Row) -> tuple:
    return tuple(row.get(name) for name in ("machine", "case", "law", "seed", "mark"))


def _mark(bench: Bench, case: Case, law: Path) -> str:
    found = hashlib.sha256(law.read_bytes())
    for name, values in sorted({**case.references, **case.disturbance}.items()):
        found.update(name.encode() + np.asarray(values, dtype=float).tobytes())
    plant = [(q.name, q.value) for q in bench.plant.parameters]
    found.update(plain_json.dumps([plant, case.effects, bench.keep], sort_keys=True).encode())
    return found.hexdigest()[:12]


def run_job(job: Job, folder: Path) -> Row:
    """One run and what came of it."""
    bench = benches()[job.machine]
    case = next(case for case in bench.cases if case.name == job.case)
    law = _law(folder, job.machine, job.law)
    try:
        return job.row | judged(bench, case, law, job.seed)
    except LeftRangeError as reason:
        return job.row | {"fault": str(reason)}


def judged(bench: Bench, case: Case, law: Any, seed: int) -> Row:
    """Errors by output, what was violated, effort and time of one run; errors in the outputs' units, times in ms."""
    plant, timed = bench.plant, _Timed(law)
    driven: Any = law if isinstance(law, ScheduledPID) else timed
    run = simulate(plant, driven, case.scenario(seed), effects=case.effects, bumpless=True)
    y, e = _truth(bench, run.states.values), run.experiment
    if isinstance(law, ScheduledPID):
        _replayed(timed, e)
    errors = {name: tracking(case.references[f"{name}_set"] - y[name], plant.dt) for name in bench.words}
    held = [plant.equilibrium()[1][plant.input_names.index(name)] for name in law.actuated]
    u = np.vstack([held, np.column_stack([e[name] for name in law.actuated])])  # the first move is one too
    moves = np.diff(u, axis=0)
    over = np.maximum(u - law.high, law.low - u).max()
    fast = (np.abs(moves) - law.rate * plant.dt).max()
    away = {
        name: float(np.mean((y[name] < low) | (y[name] > high))) for name, (low, high) in bench.keep.items()
    }  # share of the time
    return {
        "errors": errors,
        "violation": max(0.0, float(over), float(fast)),
        "away": away,
        "effort": {name: float(np.sqrt(np.mean(moves[:, i] ** 2))) for i, name in enumerate(law.actuated)},
        "at_limit": float(np.mean(((u >= law.high - 1e-9) | (u <= law.low + 1e-9)).any(axis=1))),
        "ms": {"median": 1e3 * float(np.median(timed.seconds)), "p99": 1e3 * float(np.quantile(timed.seconds, 0.99))},
        "statuses": count_statuses(run.memories),
    }


def _truth(bench: Bench, states: np.ndarray) -> dict[str, np.ndarray]:
    """Outputs (N,) of states (N, nx) before any sensor, by name."""
    plant = bench.plant
    values = plant.output(states.T)
    return {name: np.broadcast_to(y, len(states)) for name, y in zip(plant.output_names, values, strict=True)}


class _Timed:
    """A law with a clock around each of its steps."""

    def __init__(self, law: Any):
        self.law, self.seconds = law, []

    def __getattr__(self, name: str) -> Any:
        return getattr(self.law, name)

    def step(self, state: Any, r: np.ndarray, y: np.ndarray, rho: float | None) -> tuple[np.ndarray, Any]:
        begin = time.perf_counter()
        found = self.law.step(state, r, y, rho)
        self.seconds.append(time.perf_counter() - begin)
        return found


def _replayed(timed: _Timed, e: Any) -> None:
    """Steps of a law on the beginning of a record: within the run it was compiled."""
    law = timed.law
    state = law.init(np.array([e[name][0] for name in law.actuated]))
    for k in range(min(TIMED, len(e))):
        r, y = (np.array([e[name][k] for name in names]) for names in (law.references, law.measured))
        _, state = timed.step(state, r, y, e[law.schedule][k] if law.schedule else None)


def _said(row: Row) -> str:
    start = f"{row['machine']}, {row['case']}, {row['law']}, seed {row['seed']}"
    if "fault" in row:
        return f"{start}: {row['fault'].splitlines()[0]}"
    errors = ", ".join(f"{name} RMS {own['RMS']:.3g}" for name, own in row["errors"].items())
    return f"{start}: {errors}, {row['ms']['median']:.2g} ms a step"


# ---- what it amounts to -------------------------------------------------------------------------------------------------------


def _summed(bench: Bench, rows: Sequence[Row]) -> dict[str, Any]:
    """By scenario and law: mean and standard deviation over the seeds of every number; and by law over all scenarios.

    Over all scenarios a law's error is the root of the mean square of those of the scenarios that every law has held.
    """
    laws = list(dict.fromkeys(row["law"] for row in rows))
    by_case = {case.name: {law: _over_seeds(bench, _of(rows, case.name, law)) for law in laws} for case in bench.cases}
    held = [name for name, own in by_case.items() if not any(own[law]["faults"] for law in laws)]
    if not held:
        raise InputError(f"{bench.plant.name}: no scenario was held by every law", mend="see the faults in runs.jsonl")

    def pooled(law: str, output: str) -> dict[str, float]:
        return {"RMS": float(np.sqrt(np.mean([by_case[case][law]["errors"][output]["RMS"]["mean"] ** 2 for case in held])))}

    whole = {}
    for law in laws:
        own = [row for row in rows if row["law"] == law]
        good = [row for row in own if "fault" not in row]
        whole[law] = {
            "errors": {name: pooled(law, name) for name in bench.words},
            "violation": max(row["violation"] for row in good),
            "faults": len(own) - len(good),
            "ms": {key: float(np.median([row["ms"][key] for row in good])) for key in ("median", "p99")},
            "statuses": _added(row["statuses"] for row in good),
        }
    return {"seeds": len({row["seed"] for row in rows}), "cases": by_case, "held": held, "whole": whole}


def _of(rows: Iterable[Row], case: str, law: str) -> list[Row]:
    return [row for row in rows if (row["case"], row["law"]) == (case, law)]


def _over_seeds(bench: Bench, rows: Sequence[Row]) -> dict[str, Any]:
    good = [row for row in rows if "fault" not in row]
    found: dict[str, Any] = {"runs": len(rows), "faults": len(rows) - len(good)}
    if not good:
        return found | {"fault": rows[0]["fault"]}

    def spread(values: Sequence[float]) -> dict[str, float]:
        return {"mean": float(np.mean(values)), "sd": float(np.std(values))}

    def errors(name: str) -> dict[str, dict[str, float]]:
        return {key: spread([row["errors"][name][key] for row in good]) for key in ("RMS", "max", "IAE")}

    return found | {
        "errors": {name: errors(name) for name in bench.words},
        "away": {name: spread([row["away"][name] for row in good]) for name in bench.keep},
        "effort": {name: spread([row["effort"][name] for row in good]) for name in good[0]["effort"]},
        "violation": max(row["violation"] for row in good),
        "at_limit": spread([row["at_limit"] for row in good]),
        "ms": {key: float(np.median([row["ms"][key] for row in good])) for key in ("median", "p99")},
        "statuses": _added(row["statuses"] for row in good),
    }  # fmt: skip


def _added(counts: Iterable[Mapping[str, int]]) -> dict[str, int]:
    return dict(sum(map(Counter, counts), Counter()))


def _rms(found: Mapping[str, Any], law: str, output: str, case: str | None = None) -> float:
    own = found["whole"][law] if case is None else found["cases"][case][law]
    value = own["errors"][output]["RMS"]
    return value if case is None else value["mean"]


def better(bench: Bench, found: Mapping[str, Any], law: str, than: str) -> list[str]:
    """Where a law is worse than another: scenarios that it did not hold, outputs with a larger RMS error; empty: nowhere."""
    worse = []
    for case, own in found["cases"].items():
        if own[law]["faults"]:
            worse.append(f"{case} ({'neither holds' if own[than]['faults'] else 'does not hold'})")
        elif not own[than]["faults"]:
            for name, word in bench.words.items():
                ratio = _rms(found, law, name, case) / _rms(found, than, name, case)
                if ratio > SAME:
                    worse.append(f"{word} in {case} ({100 * (ratio - 1):+.0f} %)")
    return worse


def verdict(bench: Bench, found: Mapping[str, Any], sensitivity: Mapping[str, float]) -> str:
    """Which controller one should use and why, and what was asked of the comparison and not reached, in plain sentences."""
    laws = list(found["whole"])
    mpc, bound = laws[-2], laws[-1]
    names = {c.name: c.unit for c in bench.plant.outputs}

    def cut(law: str, than: str, output: str) -> str:
        share = 1.0 - _rms(found, law, output) / _rms(found, than, output)
        return f"{abs(100 * share):.0f} % {'smaller' if share > 0 else 'larger'}"

    def numbers(law: str) -> str:
        return ", ".join(f"{word} {_rms(found, law, name):.3g} {names[name]}" for name, word in bench.words.items())

    faults = {law: found["whole"][law]["faults"] for law in laws}
    broken = [law for law in laws if faults[law]]
    chosen = _chosen(bench, found, laws[:-1])
    word = bench.words[bench.quality]
    others = [law for law in laws[:-1] if law != chosen]
    against = " and ".join(f"{cut(chosen, law, bench.quality)} than under the {law}" for law in others)
    scenarios = f"the {len(found['cases'])} scenarios"
    if len(found["held"]) < len(found["cases"]):
        scenarios = f"the {len(found['held'])} of {len(found['cases'])} scenarios that every law has held"
    said = [f"{bench.plant.name}: use the {chosen}. Over {scenarios} its {word} error (RMS) is {against}."]
    said.append("RMS errors: " + "; ".join(f"{law}: {numbers(law)}" for law in laws) + ".")
    if broken:
        said.append("Did not hold the machine: " + ", ".join(f"{law} in {faults[law]} runs" for law in broken) + ".")
    if bench.scheduled.startswith("scheduled"):
        rest = ", ".join(f"{bench.words[name]} {cut(bench.scheduled, bench.base, name)}" for name in bench.words)
        said.append(f"What scheduling the PID changes against the {bench.base}: {rest}.")
    peaks = ", ".join(f"{law} {peak:.2f}" for law, peak in sensitivity.items())
    said.append(f"Largest sensitivity of the frozen loops, over all that was modelled: {peaks}.")
    for law in laws[:-2]:
        worse = better(bench, found, mpc, law)
        where = f"worse than the {law} in: {', '.join(worse)}" if worse else f"no worse than the {law} in any scenario"
        said.append(f"The {mpc} is {where}.")
    ahead = {law: better(bench, found, bound, law) for law in laws[:-1]}
    if any(ahead.values()):
        where = "; ".join(f"than the {law} in {', '.join(worse)}" for law, worse in ahead.items() if worse)
        said.append(f"The {bound}, which knows the machine but not what a scenario adds to it, is worse {where}.")
    else:
        said.append(f"The {bound}, which knows the machine, bounds them all; in {word} it is {cut(bound, mpc, bench.quality)}.")
    worst = max(found["whole"][law]["violation"] for law in laws)
    said.append("No law ever left a limit of its commands." if worst <= 1e-9 else f"A command left its limits by {worst:.2g}.")
    times = ", ".join(f"{law} {own['ms']['median']:.2g} (99 %: {own['ms']['p99']:.2g})" for law, own in found["whole"].items())
    said.append(f"Milliseconds a step in Python: {times}.")
    return " ".join(said)


def _chosen(bench: Bench, found: Mapping[str, Any], laws: Sequence[str]) -> str:
    """The simplest law that is within a tenth of the best in the output that matters, and holds the machine in every run."""
    holding = [law for law in laws if not found["whole"][law]["faults"]] or list(laws)
    best = min(_rms(found, law, bench.quality) for law in holding)
    return next(law for law in holding if _rms(found, law, bench.quality) <= 1.1 * best)


# ---- the page -----------------------------------------------------------------------------------------------------------------


def _report(folder: Path, every: Mapping[str, Bench], found: Mapping[str, Any], said: str, seed: int, source: dict) -> Report:
    sections = []
    for name, bench in every.items():
        own = found[name]
        sections.append(Section(f"{name}: all scenarios", (_overview(bench, own), _times(own))))
        for case in bench.cases:
            about = Text(case.sentence[0].upper() + case.sentence[1:] + ".")
            blocks = (about, *_pictures(folder, bench, case, seed), *_tables(bench, own, case))
            sections.append(Section(f"{name}: {case.name}", blocks))
        sections.append(Section(f"{name}: designs", _designs(folder, name)))
    sections.append(Section("Provenance", (Provenance(source),)))
    return Report("Which controller?", said, tuple(sections))


def _overview(bench: Bench, found: Mapping[str, Any]) -> Table:
    """RMS error of the outputs by scenario and law."""
    units = {c.name: c.unit for c in bench.plant.outputs}
    laws = list(found["whole"])
    rows = []
    for name, word in bench.words.items():
        for case, own in found["cases"].items():
            cells = [own[law]["errors"][name]["RMS"]["mean"] if "errors" in own[law] else "does not hold" for law in laws]
            rows.append((f"{word} [{units[name]}], {case}", *cells))
        rows.append((f"{word} [{units[name]}], all", *(_rms(found, law, name) for law in laws)))
    return Table(
        "RMS errors", ("output, scenario", *laws), tuple(rows), digits=3, best=min,
        caption=f"Mean over {found['seeds']} seeds. All: root mean square over the scenarios that every law has held.",
    )  # fmt: skip


def _times(found: Mapping[str, Any]) -> Table:
    return Table(
        "Time and answers", ("law", "median [ms]", "99 % [ms]", "answers"),
        tuple(
            (law, own["ms"]["median"], own["ms"]["p99"], ", ".join(f"{k} {n}" for k, n in own["statuses"].items()) or "-")
            for law, own in found["whole"].items()
        ),
        caption="Milliseconds of one step in Python, median of all runs.", digits=2,
    )  # fmt: skip


def _tables(bench: Bench, found: Mapping[str, Any], case: Case) -> tuple[Table, ...]:
    """Every number of a scenario, mean and standard deviation over the seeds: errors, and what they cost."""
    units = {c.name: c.unit for c in (*bench.plant.outputs, *bench.plant.inputs)}
    own = found["cases"][case.name]
    held = {law: numbers for law, numbers in own.items() if "errors" in numbers}
    lost = [(law, numbers["fault"].splitlines()[0]) for law, numbers in own.items() if law not in held]
    inputs = next(iter(held.values()))["effort"] if held else {}
    kinds = (("RMS", ""), ("max", ""), ("IAE", " s"))
    errors = Table(
        f"Errors, {case.name}",
        ("law", *(f"{word} {kind} [{units[name]}{per}]" for name, word in bench.words.items() for kind, per in kinds)),
        tuple(
            (_of_runs(law, numbers), *(_plus(numbers["errors"][name][kind]) for name in bench.words for kind, _ in kinds))
            for law, numbers in held.items()
        ),
        "Mean ± standard deviation over the seeds." + "".join(f" {law} did not hold the machine: {why}." for law, why in lost),
    )
    beyond = [f"{bench.words[name]} beyond {low:g} to {high:g} {units[name]} [%]" for name, (low, high) in bench.keep.items()]
    cost = Table(
        f"Effort, {case.name}",
        ("law", *(f"move of {name}, RMS [{units[name]}]" for name in inputs), "at a limit [%]", *beyond),
        tuple(
            (
                law,
                *(_plus(numbers["effort"][name]) for name in inputs),
                _plus(numbers["at_limit"], 100.0),
                *(_plus(numbers["away"][name], 100.0) for name in bench.keep),
            )
            for law, numbers in held.items()
        ),
        "Moves are those from sample to sample; shares are of the time.",
    )
    return errors, cost


def _of_runs(law: str, numbers: Mapping[str, Any]) -> str:
    """A law's name, and in how many runs it held the machine where that is not all of them."""
    return f"{law} ({numbers['runs'] - numbers['faults']} of {numbers['runs']} runs)" if numbers["faults"] else law


def _plus(value: Mapping[str, float], factor: float = 1.0) -> str:
    mean, sd = factor * value["mean"], factor * value["sd"]
    return f"{mean:.3g} ± {sd:.1g}"


def _pictures(folder: Path, bench: Bench, case: Case, seed: int) -> tuple[Picture, ...]:
    """One run of every law: outputs with their set-points, and commands, over the part that the case shows."""
    channels = {c.name: c for c in (*bench.plant.outputs, *bench.plant.inputs)}
    runs: dict[str, dict[str, np.ndarray]] = {}
    for law in _laws(folder, bench.plant.name):
        controller = _law(folder, bench.plant.name, law)
        try:
            run = simulate(bench.plant, controller, case.scenario(seed), effects=case.effects, bumpless=True)
        except InputError:
            continue
        runs[law] = _truth(bench, run.states.values) | {name: run.experiment[name] for name in controller.actuated}
    if not runs:
        return ()
    inputs = [name for name in bench.plant.input_names if name in next(iter(runs.values()))]
    t = bench.plant.dt * np.arange(len(next(iter(case.references.values()))))
    keep = (t >= case.shown[0]) & (t <= case.shown[1])
    shown = []
    for name in (*bench.words, *inputs):
        setpoint = case.references[f"{name}_set"][keep] if name in bench.words else None
        shown.append(figures.Followed(channels[name], setpoint, {law: y[name][keep] for law, y in runs.items()}))
    return (figures.closed_loop(f"Run, {case.name}", t[keep], shown),)


def _designs(folder: Path, machine: str) -> tuple[Block, ...]:
    """What was chosen on the model, gains and margins of the PIDs over the schedule."""
    content = _design_note(folder, machine)
    choices = Table(
        "Chosen on the identified model", ("law", "candidate", "cost", "taken"),
        tuple(
            (law, name, cost, "yes" if name == content["taken"][law] else "")
            for law, costs in content["rehearsed"].items()
            for name, cost in costs.items()
        ),
        caption=f"Mean square error in units of the largest step, following random set-points; taken: the calmest within "
        f"{100 * (NO_WORSE - 1):.0f} % of the cheapest. No candidate has seen the machine.", digits=4,
    )  # fmt: skip
    models = [load_model(folder / "controllers" / machine / f"model-{_stem(name)}.json") for name in content["models"]]
    return choices, *design_pictures({law: _law(folder, machine, law) for law in content["sensitivity"]}, models)
