"""The page of a sweep: what every output depends on, all runs at once, where they failed."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from workbench.data import Channel
from workbench.records import RecordError
from workbench.report import figures
from workbench.report.blocks import Block, Picture, Provenance, Report, Section, Table, Text
from workbench.sensitivity import Index, response_surface
from workbench.sweeps.design import Sweep
from workbench.sweeps.rows import Rows

SHOWN = 12  # outputs of a page; the others are in its tables
ERRORS = 20  # of a table
KINDS = {
    "mu*": (
        "mean size of the change",
        "Bars: mean size of the change of {} when a factor goes through all of its range (Morris), with 95 % intervals. Dots: "
        "its spread; a large one says curved, or together with other factors.",
    ),
    "S": (
        "share of the variance",
        "Bars: share of the variance of {} that a factor explains alone (Sobol, first order), with 95 % intervals. Dots: with "
        "all that it acts together with (total).",
    ),
    "rank": (
        "rank correlation",
        "Spearman's rank correlation of {} with each factor, with 95 % intervals: 1 or -1 is a monotone relation, near 0 may "
        "still be a curved one. The designs morris and sobol-indices tell more.",
    ),
}
BESIDE = {"mu*": "spread", "S": "total", "rank": ""}


def page(title: str, sweep: Sweep, found: Rows, indices: Sequence[Index], source: Mapping[str, Any], note: str = "") -> Report:
    """Verdict, a section for every output, the runs, and the failures; note: why there are no indices."""
    outputs = [n for n in found.names if n in found.units and n not in found.parameters]
    sections = [Section(name, tuple(_of_output(sweep, found, indices, name))) for name in outputs[:SHOWN]]
    whole = _parallel(found, outputs, indices)
    everything: tuple[Block, ...] = (
        *([whole] if whole else []),
        *([_index_table(indices)] if indices else []),
        _ranges(found, outputs),
    )
    said = [_headline(found), *_depends(indices, outputs), *([note] if note else [])]
    sections = [Section("All runs", everything), *sections]
    return Report(title, "\n\n".join(said), (*sections, *failures(found), Section("Provenance", (Provenance(source),))))


def failures(found: Rows) -> tuple[Section, ...]:
    """The errors of failed runs; nothing where none failed."""
    failed = tuple((row[0], row[1], row[-1]) for row in found.rows if row[-1])
    caption = f"The first {min(len(failed), ERRORS)} of {len(failed)}."
    return (Section("Failed runs", (Table("Errors", ("run", "seed", "error"), failed[:ERRORS], caption),)),) if failed else ()


def _headline(found: Rows) -> str:
    failed = sum(bool(row[-1]) for row in found.rows)
    return f"{len(found.rows)} runs over {', '.join(found.parameters)}; {failed or 'none'} failed."


def _depends(indices: Sequence[Index], outputs: Sequence[str]) -> list[str]:
    """What matters most for each output, in words."""
    said = []
    for name in outputs:
        own = sorted((i for i in indices if i.output == name), key=lambda i: -i.weight)
        if own:
            first = own[0]
            number = f"{KINDS[first.kind][0]} {first.value:.3g} {first.unit}".rstrip()
            sure = "" if first.low > 0.0 or first.high < 0.0 else "; not told from none"
            said.append(f"{name} depends most on {first.factor} ({number}{sure}).")
    return [" ".join(said)] if said else []


def _of_output(sweep: Sweep, found: Rows, indices: Sequence[Index], name: str) -> list[Block]:
    own = [i for i in indices if i.output == name]
    numbers = {n: found.column(n) for n in (*found.parameters, name)}
    factors = [n for n in found.parameters if np.isfinite(numbers[n]).all() and np.ptp(numbers[n]) > 0.0]
    blocks: list[Block] = []
    if own:
        kind = own[0].kind
        what, caption = KINDS[kind]
        bars = [figures.Bar(i.factor, i.value, i.low, i.high, i.beside) for i in own]
        of = f"{what} of {name}" + f" [{own[0].unit}]" * bool(own[0].unit)
        blocks.append(figures.tornado(f"What {name} depends on", of, bars, caption.format(name), BESIDE[kind]))
    whole = np.isfinite(numbers[name])
    if not whole.any():
        return [*blocks, Text("No run has a number.")]

    def trace(n: str) -> figures.Trace:
        return figures.Trace(Channel(n, found.units.get(n, ""), "other"), numbers[n][whole])

    output, traces = trace(name), {n: trace(n) for n in factors}
    if traces:
        blocks.append(
            figures.scatter(f"{name} of every run", list(traces.values()), output, f"{name} over each factor, a dot for a run.")
        )
    if own:
        factors.sort(key=lambda n: -max((i.weight for i in own if i.factor == n), default=0.0))
    if len(factors) > 1:
        x, y = factors[:2]
        fitted = response_surface({n: numbers[n] for n in factors}, numbers[name])
        if fitted is not None:
            rest = ", the other factors in the middle of their ranges" * (len(factors) > 2)
            caption = (
                f"Lines of equal {name} over {x} and {y}{rest}, of the quadratic polynomial that fits all runs best: it explains "
                f"{100 * fitted.explained:.0f} % of the variance between runs. Dots: runs."
            )
            blocks.append(figures.surface(f"{name} over {x} and {y}", traces[x], traces[y], output, fitted.over(x, y), caption))
    return blocks or [Text("Nothing varies that has numbers.")]


def _parallel(found: Rows, outputs: Sequence[str], indices: Sequence[Index]) -> Picture | None:
    """All runs through the factors and the output that depends on them most."""
    columns = {n: found.column(n) for n in (*found.parameters, *outputs)}
    drawn = {n: v for n, v in columns.items() if np.isfinite(v).any() and (n in found.parameters or n in outputs[:3])}
    drawn = {n: v for n, v in drawn.items() if n not in found.parameters or np.isfinite(v).all()}
    shown = [n for n in outputs if n in drawn]
    if not shown or len(drawn) < 2:
        return None
    caption = f"A line for a run, coloured by {shown[0]}: the lowest third blue, the middle grey, the highest third orange."
    try:
        return figures.parallel("Every run", drawn, shown[0], caption)
    except RecordError:
        return None


def _index_table(indices: Sequence[Index]) -> Table:
    beside = BESIDE[indices[0].kind]
    rows = tuple((i.output, i.factor, i.value, i.low, i.high, *([i.beside] if beside else []), i.unit) for i in indices)
    header = ("output", "factor", KINDS[indices[0].kind][0], "low", "high", *([beside] if beside else []), "unit")
    caption = KINDS[indices[0].kind][1].format("each output").replace("Bars: ", "").replace("Dots: ", f"{beside.capitalize()}: ")
    return Table("What each output depends on", header, rows, caption=caption[0].upper() + caption[1:], digits=3)


def _ranges(found: Rows, outputs: Sequence[str]) -> Table:
    rows = []
    for name in outputs:
        v = found.column(name)
        v = v[np.isfinite(v)]
        q = np.quantile(v, (0.0, 0.05, 0.5, 0.95, 1.0)) if len(v) else np.full(5, np.nan)
        rows.append((f"{name} [{found.units[name]}]", *q.tolist()))
    return Table("Outputs over all runs", ("output", "lowest", "5 %", "median", "95 %", "highest"), tuple(rows), digits=4)
