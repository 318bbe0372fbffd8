"""hidden-effects: how often the diagnosis is right on records in which something was hidden.

Cases come from the generator in tests/hidden, which has its own equations; a case is a row of cases.jsonl, written as it is done,
and a run that was cut off goes on where it stopped. Limits, from which sizes are drawn, are those that the diagnosis states for
records without any effect.
"""

import json
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from plants import PLANTS
from workbench.diagnose.diagnosis import diagnose
from workbench.errors import InputError
from workbench.files import read_json, write_json

LIMIT_SEED = 10**6  # records without effect from which the limits of a machine are taken


def generator() -> Any:
    """The module tests.hidden.case of the checkout that this file belongs to."""
    root = Path(__file__).resolve().parents[1]
    if not (root / "tests" / "hidden" / "case.py").exists():
        raise InputError("the generator of hidden effects is not here", mend="run this study from a checkout of the workbench")
    if str(root) not in sys.path:
        sys.path.insert(0, str(root))
    from tests.hidden import case

    return case


def limits_of(machine: str, seed: int = LIMIT_SEED) -> dict[str, float]:
    """Detection limit of every effect of a machine, in the generator's reading, from records with nothing hidden."""
    case = generator()
    kinds = case.Kind
    drawn = case.draw(seed, machine=machine, kind=kinds.NOTHING, limits={})
    found = diagnose(PLANTS[machine], drawn.records)
    limits = {f"{x.effect}@{x.place}": x.value for x in found.limits}
    for key in [k for k in limits if k.startswith("saturation@")]:
        largest = max(float(np.abs(e[key.split("@")[1]]).max()) for e in drawn.records)
        limits[key] = largest - limits[key]
    return {key: value for key, value in limits.items() if value > 0.0}


def run_case(seed: int, limits: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    """Draw a case, diagnose it, and write down what was hidden and what was said."""
    case = generator()
    machine = case.lot_of(seed).machine
    drawn = case.draw(seed, limits=limits[machine])
    row: dict[str, Any] = {
        "seed": seed,
        "machine": machine,
        "kind": drawn.kind.value,
        "truth": [
            {"key": h.key, "multiple": h.multiple, "catalogued": h.catalogued, "parameters": dict(h.parameters)}
            for h in drawn.truth
        ],
    }
    began = time.process_time()
    try:
        found = diagnose(PLANTS[machine], drawn.records, drawn.held_out)
    except Exception as reason:  # a case that fails is a row, not the end of the study
        return row | {"error": "".join(traceback.format_exception(reason))[-2000:]}
    row["seconds"] = time.process_time() - began
    row["verdict"] = found.finding.value
    row["causes"] = [
        {
            "key": c.key,
            "ties": dict(c.ties),
            "posterior": c.evidence.posterior,
            "delta_bic": c.evidence.delta_bic,
            "stability": c.stability,
            "parameters": {name: [e.value, e.low, e.high] for name, e in c.parameters.items()},
            "improved": _improved(c.gains),
        }
        for c in found.causes
    ]
    row["remainder"] = [[r.channel, r.variable, r.p_value, r.share] for r in found.remainder]
    row["untestable"] = [f"{u.effect}@{u.place}" for u in found.untestable]
    return row


def _improved(gains: Iterable[Any]) -> float:
    """Held-out one-step errors, after over before: geometric mean over records and channels."""
    ratios = [g.after / g.before for g in gains if g.horizon == "one-step" and g.before > 0.0]
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else 1.0


def run(folder: Path, seeds: Iterable[int], progress: Callable[[str], None] = print) -> list[dict[str, Any]]:
    """Every seed once: rows that cases.jsonl holds already are not run again."""
    folder.mkdir(parents=True, exist_ok=True)
    limits = {}
    for machine in PLANTS:
        path = folder / f"limits-{machine}.json"
        if not path.exists():
            write_json(path, limits_of(machine))
        limits[machine] = read_json(path)
    table = folder / "cases.jsonl"
    lines = table.read_text(encoding="utf-8").splitlines() if table.exists() else []
    rows = [json.loads(line) for line in lines if line.endswith("}")]
    done = {row["seed"] for row in rows}
    for seed in seeds:
        if seed in done:
            continue
        row = run_case(seed, limits)
        with table.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        rows.append(row)
        progress(said(row))
    return rows


def said(row: Mapping[str, Any]) -> str:
    """A row on a line."""
    truth = ", ".join(f"{t['key']} x{t['multiple']:.2g}" for t in row["truth"]) or "nothing"
    if "error" in row:
        return f"{row['seed']} {row['machine']}: {truth} -> ERROR {row['error'].splitlines()[-1]}"
    found = ", ".join(c["key"] + (f" ~ {', '.join(c['ties'])}" if c["ties"] else "") for c in row["causes"]) or "-"
    return f"{row['seed']} {row['machine']}, {row['kind']}: {truth} -> {row['verdict']}: {found} ({row['seconds']:.1f} s)"


if __name__ == "__main__":
    first, count = int(sys.argv[2]), int(sys.argv[3])
    run(Path(sys.argv[1]), range(first, first + count), lambda text: print(text, flush=True))
