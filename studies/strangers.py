"""How right is the diagnosis on machines that the workbench has never seen, with plants as their users would write them?

Cases come from the zoo in tests/strangers, which has its own equations, laboratories, and detection limits. Each goes through the
command `workbench diagnose` as a user would run it: records as CSV files, the plant as package.module:NAME, two records held out.
An answer, a refusal with its message, or a crash with its traceback is a row of cases.jsonl, whole as soon as it is done; a
run that was cut off goes on where it stopped. All rates are of the rows alone: see stranger_scores.
"""

import tempfile
import traceback
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from studies import answers
from studies.cases import SEEDS, TABLE, Cases, Say, from_tests, study
from studies.hidden_scores import misled, strangers
from studies.stranger_scores import HORIZONS, Outcome, Row, Summary, by_machine, outcome, ratios, worse
from studies.targets import Target, reached, target_table, to_json
from workbench.errors import InputError
from workbench.files import nullable
from workbench.readers import write_csv
from workbench.report.blocks import Block, Provenance, Report, Section, Table, Text
from workbench.table import fingerprint, resumed

CASES, QUICK = 400, 28
LAYOUT = 4  # of a row: rows of another layout are not counted with these


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


# ---- cases ------------------------------------------------------------------------------------------------------------------


def zoo() -> Any:
    """The modules `case` and `registry` of tests/strangers, of the checkout that this file belongs to."""
    case, registry = (from_tests(f"tests.strangers.{name}", "the zoo of strangers") for name in ("case", "registry"))
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
    paths = [folder / f"{k}.csv" for k in range(len(drawn.records) + len(drawn.held_out))]
    for path, e in zip(paths, [*drawn.records, *drawn.held_out], strict=True):
        write_csv(e, path)
    plant, name = zoo().registry.MACHINES[drawn.machine].plant, zoo().registry.PLANT_OF[drawn.machine]
    row = answers.answer(paths[: len(drawn.records)], paths[len(drawn.records) :], name, folder / "found")
    if "verdict" not in row:
        return row
    try:
        return row | {"errors": answers.compared([plant, answers.plant_of(row, plant)], drawn.held_out)}
    except Exception as reason:
        return row | {"unjudged": "".join(traceback.format_exception(reason))[-2000:]}


# ---- a run that can be cut off and goes on ------------------------------------------------------------------------------------


def run(folder: Path, seeds: Iterable[int], jobs: int = 1, progress: Say = lambda _: None) -> list[dict[str, Any]]:
    """Every seed once, `jobs` at a time: rows that cases.jsonl holds already are not run again. Returns all rows of the folder.

    Raises InputError where the folder's rows were made by another version.
    """
    configuration = configured()
    work = partial(run_case, configuration=configuration)
    return resumed(
        folder / TABLE,
        work,
        list(seeds),
        key="seed",
        configuration=configuration,
        jobs=jobs,
        said=said,
        progress=progress,
    )


def configured() -> str:
    """What rows must share to be counted together: layout, machines, and the versions of all that computes."""
    return fingerprint(LAYOUT, list(zoo().registry.MACHINES))


def said(row: Row) -> str:
    """A row on a line."""
    truth = ", ".join(f"{t['key']} x{t['multiple']:.2g}" for t in row["truth"]) or "nothing"
    start = f"{row['seed']} {row['machine']}, {row['kind']}: {truth}"
    if "undrawn" in row:
        return f"{start} -> not drawn: {row['undrawn']}"
    for fault in ("refused", "crashed"):
        if fault in row:
            return f"{start} -> {fault}: {row[fault].strip().splitlines()[-1 if fault == 'crashed' else 0]}"
    causes = ", ".join(
        c["key"] + ("" if c["sure"] else " (not sure)") + (f" ~ {', '.join(c['ties'])}" if c["ties"] else "")
        for c in row["causes"]
    )
    gained = "; ".join(f"{h} x{r:.3g}" for h, r in ratios(row).items())
    return (
        f"{start} -> {outcome(row).value}: {row['verdict']}, {causes or 'no cause'} ({row['seconds']:.0f} s; held-out {gained})"
    )


# ---- the page ---------------------------------------------------------------------------------------------------------------


def verdict(s: Summary) -> str:
    """The targets, what was reached, and where it falls short, in one paragraph."""
    return " ".join([f"{s.cases} cases of machines that the workbench has not seen.", *reached(TARGETS, s)])


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
    caption = (
        "Every hidden effect is at least twice the detection limit of the zoo's own yardstick. A wrong name beside the right one "
        "makes a case wrong."
    )
    return target_table(TARGETS, found, caption=caption)


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
        ("Wrong names that are said not to be sure, and wide ties", [r for r in answered if len(strangers(r)) > len(misled(r))]),
        ("Worse than what was given, and not said", [row for row in answered if worse(row) and not row["says_worse"]]),
        ("Not judged on held-out records", [row for row in answered if "unjudged" in row]),
        ("Refused", [row for row in rows if "refused" in row]),
        ("Crashed", [row for row in rows if "crashed" in row]),
        ("Not drawn", [row for row in rows if "undrawn" in row]),
    )
    return tuple(Text(f"{title}: {len(own)}.\n\n" + "\n\n".join(map(_told, own))) for title, own in parts)


def _told(row: Row) -> str:
    return said(row) + "".join(f"\n\n{row[fault]}" for fault in ("crashed", "unjudged") if fault in row)


main = study(
    Cases(
        "strangers", CASES, QUICK, SEEDS - 1, f"fewer than {SEEDS} a seed",
        run=run, counted=by_machine, to_json=lambda s: nullable(to_json(s)), verdict=verdict, report=_report,
    )
)  # fmt: skip
