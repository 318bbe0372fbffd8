"""A study that is a sweep: one question, runs kept row by row, and an answer that is read off the rows.

    def asked(quick, seed) -> Question: ...
    main = study(asked)

Rows stand in sweep.sqlite of the run's folder as soon as they are there; the same study in the same folder goes on with them.
"""

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from workbench.data import Channel
from workbench.errors import InputError
from workbench.files import nullable, write_json
from workbench.provenance import provenance
from workbench.records import record
from workbench.report.blocks import Block, Provenance, Report, Section, Table
from workbench.report.page import write_report
from workbench.report.sweep import failures
from workbench.sweeps.design import Sweep
from workbench.sweeps.job import Job
from workbench.sweeps.rows import Rows, export_csv, read_rows
from workbench.sweeps.run import run_sweep

Say = Callable[[str], None]
NOWHERE = "Nowhere did every run come to an end: no answer."


@record
class Answer:
    """What the rows say: the verdict, and the pictures and tables that it rests on."""

    verdict: str
    blocks: tuple[Block, ...]


@record
class Question:
    """What is run, and how its rows are read."""

    name: str
    title: str
    sweep: Sweep
    job: Job
    read: Callable[["Runs"], Answer]


class Runs:
    """The rows of a sweep by column; NaN where a run has no number."""

    def __init__(self, found: Rows):
        self.found = found
        self.failed = np.array([bool(row[-1]) for row in found.rows])

    def __getitem__(self, name: str) -> np.ndarray:
        return self.found.column(name)

    def texts(self, name: str) -> np.ndarray:
        """A column of texts."""
        i = self.found.names.index(name)
        return np.array([row[i] for row in self.found.rows], dtype=object)

    def channel(self, name: str) -> Channel:
        return Channel(name, self.found.units[name], "other")

    def levels(self, name: str) -> np.ndarray:
        """The values that a parameter takes, in order."""
        return np.unique(self[name])

    def medians(self, over: str, name: str, where: np.ndarray | None = None) -> np.ndarray:
        """The median of `name` at every level of `over`, of the rows `where`; NaN where no run has a number, or any has failed.

        Runs that came to an end where others failed are no picture of that level.
        """
        keep = np.ones(len(self.found.rows), bool) if where is None else where
        x, y = self[over], self[name]
        levels = [keep & (x == level) for level in self.levels(over)]
        own = [y[at & np.isfinite(y)] if not self.failed[at].any() else [] for at in levels]
        return np.array([np.median(values) if len(values) else np.nan for values in own])

    def groups(self, by: str, x: str, y: str, where: np.ndarray | None = None) -> list[tuple[np.ndarray, np.ndarray]]:
        """(x, y) of the runs at every level of `by`."""
        keep = np.ones(len(self.found.rows), bool) if where is None else where
        return [(self[x][at], self[y][at]) for level in self.levels(by) if (at := keep & (self[by] == level)).any()]

    def table(self, title: str, over: str, columns: Sequence[str], caption: str, where: np.ndarray | None = None) -> Table:
        """Medians by level."""
        header = tuple(f"{n} [{u}]" if (u := self.found.units[n]) else n for n in (over, *columns))
        numbers = [self.levels(over), *(self.medians(over, name, where) for name in columns)]
        return Table(title, header, tuple(zip(*(n.tolist() for n in numbers), strict=True)), caption=caption, digits=3)


def study(asked: Callable[[bool, int], Question]) -> Callable[..., Path]:
    """main of a study whose question is `asked(quick, seed)`."""

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
    ) -> Path:
        """Run what `folder` does not hold yet, and write the page; returns its path."""
        if data is not None:
            raise InputError("this study makes its own records", mend="leave --data out")
        question, database = asked(quick, seed), folder / "sweep.sqlite"
        jobs = jobs or min(2, os.cpu_count() or 1)
        try:
            done = run_sweep(question.sweep, question.job, database, resume=database.exists(), jobs=jobs, progress=progress)
        except InputError as reason:
            if "another sweep" not in reason.problem:
                raise
            mend = "the --seed, --quick and program that began it, or another --out folder"
            raise InputError(reason.problem, file=database, mend=mend) from None
        export_csv(database, folder / "sweep.csv")
        found = read_rows(database)
        if done.failed == done.runs:
            raise InputError(f"every run failed, the first with: {found.rows[0][-1]}", file=database)
        answer = question.read(Runs(found))
        verdict = " ".join([answer.verdict, *_lost(found), *["This was a quick look with few runs."] * quick])
        source = provenance({"study": question.name, "quick": quick} | dict(question.job.configuration), [], seed)
        content = {"verdict": verdict, "names": found.names, "units": dict(found.units), "rows": nullable(found.rows)}
        for path in (folder / f"{question.name}.json", json):
            if path:
                write_json(path, content | {"provenance": source})
        sections = [Section("Answer", answer.blocks), *failures(found), Section("Provenance", (Provenance(source),))]
        page = write_report(Report(question.title, verdict, tuple(sections)), folder)
        say(f"{done.runs} runs, {done.failed} failed\n{verdict}\n\nreport: {page}")
        return page

    return main


def _lost(found: Rows) -> Iterable[str]:
    """A sentence for every set of values at which runs failed."""
    at = [found.names.index(name) for name in found.parameters]
    for values in dict.fromkeys(tuple(row[i] for i in at) for row in found.rows if row[-1]):
        own = [row for row in found.rows if tuple(row[i] for i in at) == values]
        named = ", ".join(
            f"{name} {v if isinstance(v, str) else f'{v:g}'}" for name, v in zip(found.parameters, values, strict=True)
        )
        yield f"At {named} {sum(bool(row[-1]) for row in own)} of {len(own)} runs failed."


def drawn(sweep: Sweep, seed: int, count: int) -> Sweep:
    """The sweep, each set of values `count` times, with seeds of this one."""
    return replace(sweep, seeds=tuple(int(s) for s in np.random.SeedSequence(seed).generate_state(count)))


def whole(*columns: np.ndarray) -> tuple[np.ndarray, ...]:
    """The columns (n,) without the places at which one of them has no number."""
    keep = np.all(np.isfinite(columns), axis=0)
    return tuple(column[keep] for column in columns)


def told(value: float, unit: Any = "") -> str:
    """A number with its unit."""
    return f"{value:.3g} {unit}".rstrip()
