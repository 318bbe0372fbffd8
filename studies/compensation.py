"""What does cancelling a named effect gain, from the record to the run? Friction, dead time, play and dead zones of axes.

Axes come from tests/axes, which has its own equations. Of each four records are made with one effect hidden in it; `diagnose`
names what it finds, a PID is designed on the extended plant, and what was named is cancelled. Then the machine follows paths that
nobody has seen, on three other days, under the law as it was designed, with its feedforward alone fitted, and with all of it:
errors are those of where the slide is, not of what its encoder says. A path is given as much early as the design says.
"""

import time
import traceback
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from controllers import ScheduledPID, ScheduledPIDDesign, compensated
from controllers.compensation import DIFFERENCED
from plants import POSITIONING_AXIS
from studies.cases import SEEDS, TABLE, Cases, Rows, Say, from_tests, study
from studies.hidden_scores import Share, share
from studies.targets import Target, reached, target_table, to_json
from workbench.answers.diagnose import diagnose
from workbench.data import Dataset, Experiment
from workbench.errors import InputError
from workbench.files import nullable
from workbench.physics.linearised import linearised
from workbench.records import record
from workbench.report.blocks import Provenance, Report, Section, Table, Text
from workbench.table import fingerprint, resumed

CASES, QUICK = 400, 8
LAYOUT = 1  # of a row
DAYS = 3  # later runs of a machine
WORSE = 1.02  # times the error as designed
GAINS = {"friction": (8.0, 4.0), "delay": (3.0, 1.5), "play": (3.0, 1.5), "dead-zone": (3.0, 1.5)}  # middle, nine in ten


def axes() -> Any:
    """The module tests.axes.case."""
    return from_tests("tests.axes.case", "the axes")


# ---- cases ------------------------------------------------------------------------------------------------------------------


def run_case(seed: int, configuration: str) -> dict[str, Any]:
    """Draw a machine, go from its records to a law that cancels what was named, and run it."""
    case, begun = axes().draw(seed), time.process_time()
    row = {"seed": seed, "configuration": configuration, "kind": case.kind, "size": case.axis.hidden[case.kind]}
    try:
        designed, better, said, named = _cancelled(case)
    except InputError as reason:
        return row | {"refused": str(reason)}
    except Exception as reason:
        return row | {"crashed": "".join(traceback.format_exception(reason))[-2000:]}
    late = next((float(own.late[0]) for own in said if own.effect == "lateness"), 0.0)
    differenced = min(late, DIFFERENCED * designed.dt)
    fed = replace(better, compensations=(), late=differenced, play=0.0, inverses=())
    laws = {"designed": (designed, 0.0), "fed": (fed, differenced), "cancelled": (better, late)}
    done = [own.effect for own in said if own.done]
    errors = {key: _errors(case.axis, seed, *law) for key, law in laws.items()}
    floor = _errors(case.axis.without(), seed, designed, 0.0)
    said_all = [own.sentence for own in said]
    seconds = time.process_time() - begun
    return row | {"named": named, "done": done, "said": said_all, "errors": errors, "floor": floor, "seconds": seconds}


def _cancelled(case: Any) -> tuple[ScheduledPID, ScheduledPID, tuple, list[dict[str, Any]]]:
    """The law as designed, the law that cancels, what became of every cause, and the causes."""
    own = [
        Experiment.from_arrays(f"{k}", axes().DT, inputs={"F": F}, outputs={"q": q}, references={"q_set": r})
        for k, (F, q, r) in enumerate(each.T for each in case.records)
    ]
    found = diagnose(POSITIONING_AXIS.sampled(axes().DT), Dataset(tuple(own[:-1])), Dataset(tuple(own[-1:])))
    law = ScheduledPIDDesign(paths=("q",)).on(linearised(found.plant))
    content = found.to_dict()
    better, said = compensated(law, found.plant, content, early=True)
    named = [
        {"key": f"{c['effect']}@{c['at']}", "sure": not c.get("doubt"), "ties": c.get("ties", [])} for c in content["causes"]
    ]
    return law, better, said, named


def _errors(axis: Any, seed: int, law: ScheduledPID, due: float) -> list[float]:
    """Root mean square errors of where the slide is, in m, of each later day."""
    found, dt = [], axes().DT
    for day in range(DAYS):
        random = np.random.default_rng([32, seed, day])
        r, own = axes().path([33, seed, day], 3000), axis.warm(random)
        memory = {"state": law.init(np.zeros(1))}

        def step(_: int, wanted: float, reading: float, memory: dict[str, Any] = memory) -> float:
            u, memory["state"] = law.step(memory["state"], np.array([wanted]), np.array([reading]))
            return float(u[0])

        _, _, q = own.run(step, r, day)
        k = np.arange(len(r))
        found.append(float(np.sqrt(np.mean((np.interp(k - due / dt, k, r) - q) ** 2))))
    return found


def gain(row: Mapping[str, Any]) -> float:
    """By how much errors are less than as designed: geometric mean over the days."""
    return float(np.exp(np.mean(np.log(row["errors"]["designed"]) - np.log(row["errors"]["cancelled"]))))


# ---- counts -----------------------------------------------------------------------------------------------------------------


@record
class Summary:
    """All rates of a set of rows, and gains: middle, the one that nine in ten reach, least."""

    cases: int
    failed: Share
    named: Share  # the family of what was hidden, sure or not
    cancelled: Share
    worse: Share  # of all runs: more than WORSE of the error as designed
    enough: Share  # of the targets of its kind, middle and nine in ten, those that are reached
    gains: tuple[float, float, float]
    beside_feedforward: tuple[float, float, float]  # the same against a law whose feedforward alone is fitted
    floor: float  # the error in the middle, in those of the same machine with nothing hidden


def summary(rows: Rows) -> Summary:
    """Every rate of these rows."""
    done = [row for row in rows if "errors" in row]
    known = axes().EFFECTS
    ratio = lambda a, b: [float(np.exp(np.mean(np.log(row["errors"][a]) - np.log(row["errors"][b])))) for row in done]  # noqa: E731
    gains = _spread(ratio("designed", "cancelled"))
    by = {kind: _spread([gain(row) for row in done if row["kind"] == kind]) for kind in {row["kind"] for row in rows}}
    asked = [pair for kind, own in by.items() for pair in zip(own[:2], GAINS[kind], strict=True)]
    runs = [(a, b) for row in done for a, b in zip(row["errors"]["designed"], row["errors"]["cancelled"], strict=True)]
    floors = [np.median(row["errors"]["cancelled"]) / np.median(row["floor"]) for row in done]
    return Summary(
        cases=len(rows),
        failed=share("errors" not in row for row in rows),
        named=share(any(_is(own, known[row["kind"]]) for own in row["named"]) for row in done),
        cancelled=share(bool(set(row["done"]) & set(known[row["kind"]])) for row in done),
        worse=share(after > WORSE * before for before, after in runs),
        enough=share(reached_ >= wanted for reached_, wanted in asked),
        gains=gains,
        beside_feedforward=_spread(ratio("fed", "cancelled")),
        floor=float(np.median(floors)) if floors else np.nan,
    )


def _spread(gains: Sequence[float]) -> tuple[float, float, float]:
    """The middle, what nine in ten reach, the least."""
    middle, nine, least = np.quantile(gains, (0.5, 0.1, 0.0)).tolist() if gains else (np.nan,) * 3
    return middle, nine, least


def _is(cause: Mapping[str, Any], effects: Sequence[str]) -> bool:
    return bool({cause["key"], *cause["ties"]} & set(effects))


def by_kind(rows: Rows) -> dict[str, Summary]:
    """The summary of all rows, and that of every kind."""
    return {"all": summary(rows)} | {kind: summary(own) for kind in GAINS if (own := [r for r in rows if r["kind"] == kind])}


# ---- a run that can be cut off and goes on ------------------------------------------------------------------------------------


def run(folder: Path, seeds: Iterable[int], jobs: int = 1, progress: Say = lambda _: None) -> list[dict[str, Any]]:
    """Every seed once, `jobs` at a time; rows that the folder holds already are not run again. Returns all of them."""
    configuration = fingerprint(LAYOUT, list(GAINS))
    work = partial(run_case, configuration=configuration)
    options = {"key": "seed", "configuration": configuration, "jobs": jobs, "said": said, "progress": progress}
    return resumed(folder / TABLE, work, list(seeds), **options)


def said(row: Mapping[str, Any]) -> str:
    """A row on a line."""
    start = f"{row['seed']} {row['kind']} of {row['size']:.3g}"
    for fault in ("refused", "crashed"):
        if fault in row:
            return f"{start} -> {fault}: {row[fault].strip().splitlines()[-1 if fault == 'crashed' else 0]}"
    each = (1e6 * float(np.median(own)) for own in (*row["errors"].values(), row["floor"]))
    told = "as designed {:.3g}, fed forward {:.3g}, cancelled {:.3g}, nothing hidden {:.3g} um".format(*each)
    named = ", ".join(own["key"] + " (not sure)" * (not own["sure"]) for own in row["named"]) or "nothing"
    return f"{start} -> {named}; cancelled: {', '.join(row['done']) or 'nothing'}; {told}; {gain(row):.3g} times less"


# ---- the page ---------------------------------------------------------------------------------------------------------------

TARGETS = (
    Target("not answered", "failed", high=0.0),
    Target("errors reduced by 8 in the middle and 4 in nine of ten for friction, by 3 and 1.5 for the others", "enough", low=1.0),
    Target("runs that are worse than as designed by more than 2 %", "worse", high=0.0),
)


def verdict(s: Summary) -> str:
    """The targets, what was reached, and where it falls short."""
    return " ".join([f"{s.cases} axes with one effect hidden in them.", *reached(TARGETS, s)])


def _report(rows: Rows, found: Mapping[str, Summary], source: dict[str, Any]) -> Report:
    header = ("hidden", "cases", "named", "cancelled", "worse", "middle", "nine of ten", "least", "beside feedforward", "floor")
    table = [
        (name, s.cases, str(s.named), str(s.cancelled), str(s.worse), *s.gains, s.beside_feedforward[0], s.floor)
        for name, s in found.items()
    ]
    caption = (
        "Errors of where the slide is, as designed over those with what was named cancelled; beside feedforward: over those of a "
        "law whose feedforward alone is fitted. Floor: what is left, in errors of the same machine with nothing hidden."
    )
    every = Text("\n\n".join(map(said, sorted(rows, key=lambda row: row["seed"]))))
    sections = (
        Section("Targets", (target_table(TARGETS, found),)),
        Section("What was gained", (Table("Gains", header, tuple(table), caption=caption, digits=3),)),
        Section("Every case", (every,)),
        Section("Provenance", (Provenance(source),)),
    )
    return Report("Compensation: what cancelling a named effect gains", verdict(found["all"]), sections)


main = study(
    Cases(
        "compensation", CASES, QUICK, SEEDS - 1, f"fewer than {SEEDS} a seed",
        run=run, counted=by_kind, to_json=lambda s: nullable(to_json(s)), verdict=verdict, report=_report,
    )
)  # fmt: skip
