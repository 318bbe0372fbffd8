"""`workbench sweep`: run what a file asks for, keep every row, and write the page."""

from argparse import Namespace
from collections.abc import Callable, Sequence
from pathlib import Path

from studies.arguments import run_folder
from studies.jobs import JOBS
from workbench.errors import InputError, check_known
from workbench.files import nullable, write_json
from workbench.provenance import provenance
from workbench.report.page import write_report
from workbench.report.sweep import page
from workbench.sensitivity import sensitivity
from workbench.sweeps.design import Factor, load_sweep
from workbench.sweeps.rows import Rows, export_csv, export_parquet, read_rows, require_parquet
from workbench.sweeps.run import run_sweep

Say = Callable[[str], None]


def run(options: Namespace, say: Say, progress: Say) -> int:
    """Run a sweep, or finish it; writes sweep.sqlite, sweep.csv, and the page."""
    file = Path(options.sweep)
    sweep = load_sweep(file)
    make = JOBS[check_known("run", sweep.run, JOBS, file=file)]
    if options.resume and not options.out:
        raise InputError("which folder holds the sweep that is to go on?", mend="name it: --out DIR --resume")
    job = make(sweep, file, options)
    if options.parquet:
        require_parquet()
    folder = run_folder(options.out, "sweep")
    done = run_sweep(
        sweep, job, folder / "sweep.sqlite", resume=options.resume, jobs=options.jobs, scheduler=options.scheduler,
        progress=progress,
    )  # fmt: skip
    export_csv(folder / "sweep.sqlite", folder / "sweep.csv")
    found = read_rows(folder / "sweep.sqlite")
    say(f"{done.runs} runs, {done.failed} failed; {done.made} of them now, in {done.seconds:.1f} s")
    if done.failed:
        say(f"  the first: {next(row[-1] for row in found.rows if row[-1])}")
    for text in _extremes(found, sweep.factors):
        say(text)
    try:
        indices, note = sensitivity(sweep, found), ""
    except InputError as reason:
        indices, note = (), str(reason)
        say(f"note: {note}")
    if options.parquet:
        say(f"rows: {export_parquet(folder / 'sweep.sqlite', folder / 'sweep.parquet')}")
    source = provenance({"sweep": options.sweep} | dict(job.configuration), [file], sweep.seed)
    report = write_report(page(f"Sweep {file.stem}", sweep, found, indices, source, note), folder)
    say(f"rows: {folder / 'sweep.sqlite'}, {folder / 'sweep.csv'}\nreport: {report}")
    if options.json:
        content = {"names": found.names, "units": dict(found.units), "rows": [list(row) for row in found.rows]}
        write_json(options.json, content | {"sensitivity": nullable([vars(i) for i in indices])})
    return 0


def _extremes(found: Rows, factors: Sequence[Factor]) -> list[str]:
    """For every output its range, and the parameters of its lowest and highest value."""
    said = []
    names = list(found.names)
    for name in names[2 + len(factors) : -1]:
        i = names.index(name)
        rows = sorted((row for row in found.rows if row[i] is not None), key=lambda row: row[i])
        if not rows:
            continue
        ends = [", ".join(f"{p.name} {_told(row[names.index(p.name)])}" for p in factors) for row in (rows[0], rows[-1])]
        said.append(f"  {name}: {rows[0][i]:.4g} ({ends[0]}) to {rows[-1][i]:.4g} ({ends[1]}) {found.units[name]}".rstrip())
    return said


def _told(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"
