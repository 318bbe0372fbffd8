"""How right is the diagnosis on machines that the workbench has never seen, with plants as their users would write them?

Cases come from the zoo in tests/strangers, which has its own equations, laboratories, and detection limits. Each goes through the
command `workbench diagnose` as a user would run it: records as CSV files, the plant as package.module:NAME, two records held out.
An answer, a refusal with its message, or a crash with its traceback is a row of cases.jsonl, whole as soon as it is done; a
run that was cut off goes on where it stopped. All rates are of the rows alone: see stranger_scores.
"""

import hashlib
import io
import json as plain_json
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import fields
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from studies.hidden_scores import Share
from studies.stranger_scores import HORIZONS, Outcome, Row, Summary, by_machine, outcome, ratios, strangers, worse
from studies.table import made, whole_rows
from workbench.data import Dataset
from workbench.diagnose.calibrate import along
from workbench.diagnose.gains import SETTLING, errors
from workbench.errors import InputError
from workbench.files import nullable, read_json, write_json
from workbench.physics.extension import extension
from workbench.physics.plant import Plant
from workbench.provenance import provenance, versions
from workbench.readers import write_csv
from workbench.records import record
from workbench.report.blocks import Block, Provenance, Report, Section, Table, Text
from workbench.report.page import write_report

Say = Callable[[str], None]

SEEDS = 10**6  # case k of seed N has the seed N SEEDS + k
CASES, QUICK = 400, 28
LAYOUT = 2  # of a row: rows of another layout are not counted with these


@record
class Target:
    """The range that a rate must lie in; rate: a field of Summary."""

    what: str
    rate: str
    low: float = 0.0
    high: float = 1.0

    def reached(self, share: Share) -> bool:
        return self.low <= share.rate <= self.high

    def __str__(self) -> str:
        if self.low == 0.0:
            return "none" if self.high == 0.0 else f"{100 * self.high:g} % or less"
        return f"{100 * self.low:g} % or more" if self.high == 1.0 else f"{100 * self.low:g} to {100 * self.high:g} %"


TARGETS = (
    Target("crashed", "crashed", high=0.0),
    Target("sound records refused", "refused", high=0.0),
    Target("confident wrong name", "wrong", high=0.01),
    Target("nothing hidden, yet a cause named", "false_alarms", high=0.01),
    Target("one effect: right name or a declared tie of three at most that holds it", "right_or_tie", low=0.85),
    Target("two effects, both found, nothing wrong beside them", "both", low=0.80),
    Target("outside the catalogue, said to be unknown or incomplete", "outside", low=0.85),
    Target("true size inside its stated 95 % interval", "inside", low=0.90, high=0.97),
    Target("worse one second ahead or over the full run, and not said", "worse", high=0.0),
)


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
    """Run `cases` cases (400, 28 with `quick`) of `seed` that `folder` does not hold yet, write the report; returns its path.

    Raises InputError for `data`, for a folder of another version, and outside a checkout of the workbench.
    """
    if data is not None:
        raise InputError("this study makes its own records", mend="leave --data out")
    count = cases or (QUICK if quick else CASES)
    if count >= SEEDS:
        raise InputError(f"{count} cases", mend=f"fewer than {SEEDS} a seed")
    zoo()
    seeds = range(SEEDS * seed, SEEDS * seed + count)
    rows = [row for row in run(folder, seeds, jobs, progress) if row["seed"] in seeds]
    found = by_machine(rows)
    source = provenance({"study": "strangers", "cases": count, "quick": quick}, [folder / "cases.jsonl"], seed)
    content = {"summary": {name: to_json(s) for name, s in found.items()}, "provenance": source}
    for path in (folder / "summary.json", json):
        if path:
            write_json(path, content)
    path = write_report(_report(rows, found, source), folder)
    say(f"{verdict(found['all'])}\n\nreport: {path}")
    return path


# ---- cases ------------------------------------------------------------------------------------------------------------------


def zoo() -> Any:
    """The modules `case` and `registry` of tests/strangers, of the checkout that this file belongs to."""
    root = Path(__file__).resolve().parents[1]
    if not (root / "tests" / "strangers" / "case.py").exists():
        raise InputError("the zoo of strangers is not here", mend="run this study from a checkout of the workbench")
    if str(root) not in sys.path:
        sys.path.insert(0, str(root))
    from tests.strangers import case, registry

    return SimpleNamespace(case=case, registry=registry)


def run_case(seed: int, configuration: str) -> dict[str, Any]:
    """Draw a case, run the command on it, and write down what was hidden and what was said."""
    case = zoo().case
    row = {"seed": seed, "configuration": configuration, "machine": case.machine_of(seed), "kind": case.kind_of(seed).value}
    try:
        drawn = case.draw(seed)
    except InputError as reason:
        return row | {"truth": [], "undrawn": str(reason)}
    row["truth"] = [
        {"key": h.key, "multiple": h.multiple, "catalogued": h.catalogued, "parameters": dict(h.parameters)} for h in drawn.truth
    ]
    resolution = drawn.habits["resolution"]
    row |= {"habits": drawn.habits, "resolutions": resolution, "drawing": list(drawn.notes)}
    with tempfile.TemporaryDirectory() as folder:
        return row | answer(drawn, Path(folder))


def answer(drawn: Any, folder: Path) -> dict[str, Any]:
    """What `workbench diagnose` makes of a case, and the held-out errors of what it hands out."""
    paths = [(folder / f"{k}.csv", e) for k, e in enumerate([*drawn.records, *drawn.held_out])]
    for path, e in paths:
        write_csv(e, path)
    records, held = [str(p) for p, _ in paths[: len(drawn.records)]], [str(p) for p, _ in paths[len(drawn.records) :]]
    plant, name = zoo().registry.MACHINES[drawn.machine].plant, zoo().registry.PLANT_OF[drawn.machine]
    words = ["diagnose", *records, "--plant", name, "--holdout", *held, "--out", str(folder / "found")]
    spoken, began = io.StringIO(), time.process_time()
    try:
        code = _command(words, spoken)
    except InputError as reason:
        return {"refused": str(reason)}
    except Exception as reason:
        return {"crashed": "".join(traceback.format_exception(reason))[-4000:]}
    seconds = time.process_time() - began
    said = read_json(folder / "found" / "diagnosis.json")
    first = spoken.getvalue().strip().splitlines()[:1]
    row = {
        "code": code, "verdict": said["verdict"], "causes": [_cause(c) for c in said["causes"]], "notes": said["notes"],
        "untestable": [f"{u['effect']}@{u['at']}" for u in said["untestable"]],
        "limits": {f"{d['effect']}@{d['at']}": d["value"] for d in said["detection_limits"]},
        "remainder": [[r["channel"], r["over"], r["p_value"], r["share"]] for r in said["remainder"]],
        "recalibrated": {name: [e["nominal"], e["value"]] for name, e in said["recalibrated"].items()},
        "first": first, "says_worse": code == 3 or any("worse" in line.lower() for line in first), "seconds": seconds,
    }  # fmt: skip
    try:
        handed_out = extension(plant, "", said["parameters"], said["effects"]).of(plant)
        return row | {"errors": _compared(plant, handed_out, drawn.held_out)}
    except Exception as reason:
        return row | {"unjudged": "".join(traceback.format_exception(reason))[-2000:]}


def _command(words: Sequence[str], spoken: io.StringIO) -> int:
    """Exit code of a command; what it says goes to `spoken`. Lets its errors through."""
    from studies.cli import parser
    from studies.commands import run as run_command

    with redirect_stdout(spoken), redirect_stderr(io.StringIO()):
        return run_command(parser().parse_args(list(words)))


def _cause(c: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "key": f"{c['effect']}@{c['at']}", "ties": c["ties"], "stability": c["stability"],
        "delta_bic": c["evidence"]["delta_bic"],
        "parameters": {name: [e["value"], e["low"], e["high"]] for name, e in c["parameters"].items()},
    }  # fmt: skip


def _compared(given: Plant, handed_out: Plant, held_out: Dataset) -> dict[str, dict[str, list[float | None]]]:
    """Errors {horizon: {"record, channel": [given, handed out]}}, root mean square; None where a run did not last."""
    result: dict[str, dict[str, list[float | None]]] = {h: {} for h in HORIZONS}
    for e in held_out:
        for plant in (given, handed_out):
            done = along(plant.sampled(e.dt), Dataset((e,)))
            for horizon in HORIZONS:
                wrong = errors(done.predictor, done.fit.point, 0, horizon)[SETTLING:]
                for j, c in enumerate(plant.outputs):
                    if c.name in e.names:
                        seen = wrong[:, j][np.isfinite(wrong[:, j])]
                        with np.errstate(over="ignore"):
                            rms = float(np.sqrt(np.mean(seen**2))) if len(seen) else np.nan
                        result[horizon].setdefault(f"{e.name}, {c.name}", []).append(rms if np.isfinite(rms) else None)
    return result


# ---- a run that can be cut off and goes on ------------------------------------------------------------------------------------


def run(folder: Path, seeds: Iterable[int], jobs: int = 1, progress: Say = lambda _: None) -> list[dict[str, Any]]:
    """Every seed once, `jobs` at a time: rows that cases.jsonl holds already are not run again. Returns all rows of the folder.

    Raises InputError where the folder's rows were made by another version.
    """
    table = folder / "cases.jsonl"
    rows, configuration = whole_rows(table), configured()
    others = {row.get("configuration", "none") for row in rows} - {configuration}
    if others:
        raise InputError(
            f"holds cases of another version ({', '.join(sorted(others))}, now {configuration})",
            file=table,
            mend="give a new --out folder, or the workbench that wrote this one",
        )
    done = {row["seed"] for row in rows}
    work = partial(run_case, configuration=configuration)
    for row in made(table, work, [seed for seed in seeds if seed not in done], jobs):
        rows.append(row)
        progress(said(row))
    return rows


def configured() -> str:
    """What rows must share to be counted together: a hash of layout, and the versions of all that computes."""
    content = plain_json.dumps([LAYOUT, list(zoo().registry.MACHINES), versions()], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:12]


def said(row: Row) -> str:
    """A row on a line."""
    truth = ", ".join(f"{t['key']} x{t['multiple']:.2g}" for t in row["truth"]) or "nothing"
    start = f"{row['seed']} {row['machine']}, {row['kind']}: {truth}"
    if "undrawn" in row:
        return f"{start} -> not drawn: {row['undrawn']}"
    for fault in ("refused", "crashed"):
        if fault in row:
            return f"{start} -> {fault}: {row[fault].strip().splitlines()[-1 if fault == 'crashed' else 0]}"
    causes = ", ".join(c["key"] + (f" ~ {', '.join(c['ties'])}" if c["ties"] else "") for c in row["causes"]) or "no cause"
    gained = "; ".join(f"{h} x{r:.3g}" for h, r in ratios(row).items())
    return f"{start} -> {outcome(row).value}: {row['verdict']}, {causes} ({row['seconds']:.0f} s; held-out {gained})"


# ---- the page ---------------------------------------------------------------------------------------------------------------


def verdict(s: Summary) -> str:
    """The targets, what was reached, and where it falls short, in one paragraph."""
    judged = [(t, getattr(s, t.rate)) for t in TARGETS]
    words = [f"{s.cases} cases of machines that the workbench has not seen."]
    for title, own in (
        ("Falls short", [(t, share) for t, share in judged if share.of and not t.reached(share)]),
        ("Reached", [(t, share) for t, share in judged if share.of and t.reached(share)]),
    ):
        if own:
            words.append(f"{title}: " + "; ".join(f"{t.what}: {share}, target {t}" for t, share in own) + ".")
    if open_ := [t.what for t, share in judged if not share.of]:
        words.append(f"Without a case: {'; '.join(open_)}.")
    return " ".join(words)


def to_json(s: Summary) -> dict[str, Any]:
    """A summary as plain numbers."""
    values = {f.name: getattr(s, f.name) for f in fields(s)}
    return nullable({name: v.to_dict() if isinstance(v, Share) else v for name, v in values.items()})


def _report(rows: Sequence[Row], found: Mapping[str, Summary], source: dict[str, Any]) -> Report:
    sections = (
        Section("Targets", (_targets(found),)),
        Section("What was said", (_outcomes(rows, found),)),
        Section("Held-out errors", (_errors(rows),)),
        Section("Run time", (_times(found),)),
        Section("Cases that went wrong", _wrong(rows)),
        Section("Every case", (Text("\n\n".join(map(said, sorted(rows, key=lambda row: row["seed"])))),)),
        Section("Provenance", (Provenance(source),)),
    )
    return Report("Strangers: how right the diagnosis is on machines that it has not seen", verdict(found["all"]), sections)


def _targets(found: Mapping[str, Summary]) -> Table:
    rows = []
    for t in TARGETS:
        share = getattr(found["all"], t.rate)
        low, high = (100 * end for end in share.interval)
        reached = "no case" if not share.of else "yes" if t.reached(share) else "no"
        rows.append((t.what, str(t), reached, 100 * share.rate if share.of else None, low, high, f"{share.hits} of {share.of}"))
    caption = (
        "Every hidden effect is at least twice the detection limit of the zoo's own yardstick. A wrong name beside the right one "
        "makes a case wrong. Intervals: Clopper and Pearson, 95 %."
    )
    header = ("what", "target", "reached", "share [%]", "low [%]", "high [%]", "cases")
    return Table("Targets and what was reached", header, tuple(rows), caption=caption, digits=3)


def _outcomes(rows: Sequence[Row], found: Mapping[str, Summary]) -> Table:
    table = [(name, s.cases, *s.outcomes.values()) for name, s in found.items()]
    for kind in ("nothing", "single", "pair", "outside"):
        own = [outcome(row) for row in rows if row["kind"] == kind and "undrawn" not in row]
        table.append((f"of these: {kind}", len(own), *(own.count(o) for o in Outcome)))
    caption = (
        "Right: the right names alone; with nothing hidden, nothing said; outside the catalogue, said to be unknown. Incomplete: "
        "causes are named, and something is said to be left. One of two: nothing wrong beside it. Missed: nothing said. Wrong: a "
        "name that was not hidden, with confidence."
    )
    return Table("Machines and answers", ("machine", "cases", *(o.value for o in Outcome)), tuple(table), caption=caption)


def _errors(rows: Sequence[Row]) -> Table:
    """After over before, by what was said."""
    table = []
    for o in Outcome:
        for horizon in HORIZONS:
            own = [r[horizon] for row in rows if "verdict" in row and outcome(row) is o and horizon in (r := ratios(row))]
            if own:
                counts = (len(own), sum(r > 1.02 for r in own))
                table.append((o.value, horizon, *counts, float(np.median(own)), float(min(own)), float(max(own))))
    header = ("said", "horizon", "cases", "worse by 2 %", "median", "lowest", "highest")
    caption = "Root mean square error on held-out records of the plant handed out, over that of the plant given; geometric means."
    return Table("Held-out errors, after over before", header, tuple(table), caption=caption, digits=3)


def _times(found: Mapping[str, Summary]) -> Table:
    header = ("machine", "median [s]", "90 % [s]", "longest [s]")
    caption = "CPU time of the command; the first case of a machine compiles its plant."
    return Table("CPU time of a diagnosis", header, tuple((n, *s.seconds) for n, s in found.items()), caption=caption, digits=3)


def _wrong(rows: Sequence[Row]) -> tuple[Block, ...]:
    """Wrong names, refusals, crashes, and answers that are worse than what was given: none is left out."""
    answered = [row for row in rows if "verdict" in row]
    parts = (
        ("Confident wrong names", [row for row in answered if outcome(row) is Outcome.WRONG]),
        (
            "Wrong names among those of an incomplete answer",
            [r for r in answered if r["verdict"] == "incomplete" and strangers(r)],
        ),
        ("Worse than what was given, and not said", [row for row in answered if worse(row) and not row["says_worse"]]),
        ("Not judged on held-out records", [row for row in answered if "unjudged" in row]),
        ("Refused", [row for row in rows if "refused" in row]),
        ("Crashed", [row for row in rows if "crashed" in row]),
        ("Not drawn", [row for row in rows if "undrawn" in row]),
    )
    return tuple(Text(f"{title}: {len(own)}.\n\n" + "\n\n".join(map(_told, own))) for title, own in parts)


def _told(row: Row) -> str:
    return said(row) + "".join(f"\n\n{row[fault]}" for fault in ("crashed", "unjudged") if fault in row)
