"""What records hold before anything is made of them: channels, ranges, resolution, how they move, and what they cannot show.

found = wb.look("a.csv", "b.csv", inputs="U", outputs="n", schedule="way")
print(found)                # one screen
found.save("runs/looked")   # look.json, report.html
"""

import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from workbench.advice import Advice, advise, quantum
from workbench.answers.answer import Answer, Records
from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.files import write_json
from workbench.records import field, record
from workbench.report import figures
from workbench.report.blocks import Badge, Block, Brief, Picture, Provenance, Report, Section, Standing, Table, Text
from workbench.report.figures import Trace
from workbench.report.page import write_report
from workbench.sources import Names, read, read_files

LOOK_FILE = "look.json"
LEVELS = 12  # a channel of so many values at most is told by them
HELD = 3.0  # samples that a channel keeps its value on the average, from which on that is told
TRIED = 200_000  # samples from which it is told how a channel moves
DRAWN = 8  # records that have pictures
WINDOW = 16_384  # samples of a spectrum at most


@record
class ChannelFacts:
    """Of a channel over all records: range, mean, standard deviation, resolution (0: none seen), and how it moves, in words."""

    channel: Channel
    low: float = field("")
    high: float = field("")
    mean: float = field("")
    deviation: float = field("", low=0.0)
    resolution: float = field("", low=0.0)
    moves: str = ""


def look(*sources: Any, inputs: Names = (), outputs: Names = (), schedule: Names = (), dt: float | None = None) -> "Look":
    """What the sources hold, each for itself where they do not fit together; see `read` for sources and options.

    dt [s]: of files that have no time of their own. A file that cannot be read is told among the others.
    Raises InputError where none can be read.

        >>> look(data)
        2 records, 1200 samples of 3 channels every 0.01 s, 12 s in all.
        note: a, b, way: runs from -0.001365 to 11.98 mm; a model holds on that range only
    """
    roles = {"inputs": inputs, "outputs": outputs, "schedule": schedule}
    every: list[Experiment] = []
    refused: list[InputError] = []
    for source in sources:
        try:
            every += _read(source, dt, roles)
        except InputError as reason:
            refused.append(reason)
    if not every:
        raise refused[0] if refused else InputError("no records", mend="name at least one file")
    groups: list[list[Experiment]] = []
    faults: list[str] = []
    for e in every:
        for own in groups:
            try:
                Dataset((*own, e))
            except InputError as reason:
                if not faults:  # one is enough to tell why
                    faults.append(f"these are not one set of records: {reason}")
            else:
                own.append(e)
                break
        else:
            groups.append([e])
    return Look(tuple(RecordSet.of(Dataset(tuple(own))) for own in groups), tuple(map(str, refused)), tuple(faults))


def _read(source: Any, dt: float | None, roles: Mapping[str, Names]) -> Sequence[Experiment]:
    if isinstance(source, Dataset):
        return [e.with_roles(**roles) for e in source]
    if isinstance(source, str | Path):
        return read_files([str(source)], dt, **roles)[0].experiments
    return read(source, dt=dt, **roles).experiments


@record
class RecordSet:
    """Records that fit together, what is seen of their channels, and what they cannot show."""

    records: Dataset
    channels: tuple[ChannelFacts, ...]
    advice: tuple[Advice, ...]

    @classmethod
    def of(cls, records: Dataset) -> "RecordSet":
        return cls(records, tuple(_facts(records, channel) for channel in records.experiments[0].channels), advise(records))

    @property
    def headline(self) -> str:
        own = self.records
        count, samples = len(own), sum(map(len, own))
        names = len(own.experiments[0].names)
        said = f"{count} record{'s' * (count > 1)}, {samples} samples of {names} channel{'s' * (names > 1)}"
        return f"{said} every {own.dt:g} s, {samples * own.dt:.4g} s in all."

    @property
    def command(self) -> str:
        """How to go on: with the roles that are known, and a word in capitals where one is not."""
        first = self.records.experiments[0]
        words = ["workbench", "identify", *dict.fromkeys(e.file or e.name for e in self.records)]
        words += ["--inputs", ",".join(first.names_of("input")) or "INPUTS"]
        words += ["--output", ",".join(first.names_of("output")) or "OUTPUTS"]
        words += ["--schedule", ",".join(first.names_of("schedule"))] if first.names_of("schedule") else []
        return shlex.join(words)


@record
class Look(Answer):
    """Sets of records that fit together, what could not be read, and why they are more than one set.

    >>> found = look(data)
    >>> [(own.channel.name, own.moves) for own in found.sets[0].channels]
    [('U', 'changes every 15 samples on the average'), ('n', 'moves on'), ('way', 'moves on')]
    """

    sets: tuple[RecordSet, ...]
    refused: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()

    @property
    def sentences(self) -> list[str]:
        """What there is, what could not be read, what the records cannot show: warnings first."""
        return [
            *(own.headline for own in self.sets),
            *self.faults,
            *(f"not read: {reason}" for reason in self.refused),
            *(f"note: {note}" for own in self.sets for note in own.records.notes),
            *self._advice,
        ]

    @property
    def _advice(self) -> list[str]:
        """What the records cannot show, warnings first, once for what is alike in several."""
        alike: dict[tuple[str, ...], list[Advice]] = {}
        for a in sorted((a for own in self.sets for a in own.advice), key=lambda a: a.severity != "warning"):
            alike.setdefault((a.kind, a.channel, a.severity), []).append(a)
        return [f"{own[0]}{f' (and alike in {len(own) - 1} more)' if len(own) > 1 else ''}" for own in alike.values()]

    @property
    def _verdict(self) -> str:
        """What there is, what is not, and how to go on."""
        warnings = [sentence for sentence in self._advice if sentence.startswith("warning")]
        count = len(self.refused)
        told = [own.headline for own in self.sets]
        if count:
            told.append(f"{count} file{'s' * (count > 1)} could not be read: see below.")
        if len(self.sets) > 1:
            told.append("They do not fit together as one set of records: see below.")
        first = f"{len(warnings)} warning{'s' * (len(warnings) > 1)}, the first: {warnings[0]}" if warnings else ""
        told.append(first or "No warnings.")
        return "\n\n".join([*told, *(f"To go on: {own.command}" for own in self.sets)])

    def to_dict(self) -> dict[str, Any]:
        """Records, channels, notes and advice, by set."""
        return {
            "sets": [
                {
                    "records": [
                        {
                            "name": e.name, "file": e.file, "samples": len(e), "dt": e.dt, "start": float(e.t[0]),
                            "notes": list(e.notes),
                        }
                        for e in own.records
                    ],
                    "channels": [
                        {
                            "name": c.channel.name, "unit": c.channel.unit, "role": c.channel.role, "low": c.low, "high": c.high,
                            "mean": c.mean, "deviation": c.deviation, "resolution": c.resolution, "moves": c.moves,
                        }
                        for c in own.channels
                    ],
                    "advice": [
                        {"kind": a.kind, "record": a.record, "channel": a.channel, "severity": a.severity, "sentence": a.sentence}
                        for a in own.advice
                    ],
                    "next": own.command,
                }
                for own in self.sets
            ],
            "refused": list(self.refused),
        }  # fmt: skip

    def to_frame(self) -> Any:
        """Channels as a pandas table. Raises ImportError without pandas."""
        import pandas

        return pandas.concat([pandas.DataFrame(_rows(own), columns=list(HEADER)) for own in self.sets], ignore_index=True)

    def report(self, source: Mapping[str, Any] | None = None) -> Report:
        """Channels, every record over time, spectra, where the inputs were over the schedule, and what to do next."""
        names = [name for own in self.sets for name in own.records.names]
        title = f"look: {', '.join(names[:4])}{f' and {len(names) - 4} more' if len(names) > 4 else ''}"
        faults = [*(f"Not read: {reason}" for reason in self.refused), *self.faults]
        texts = tuple(Text(fault.replace("\n  mend: ", "\n\nMend: ")) for fault in faults)
        first = [Section("What could not be read or joined", texts)] if texts else []
        sections = [section for own in self.sets for section in _sections(own, len(self.sets) > 1)]
        source = source or _source(self)
        picture, sections = _first(sections)
        provenance = Section("Provenance", (), (Provenance(source),))
        return Report(title, self._verdict, (*first, *sections, provenance), self._brief(picture))

    def _brief(self, picture: Picture | None) -> Brief:
        """The command to go on with, what there is, what was not read, and the first warning."""
        warnings = [sentence for sentence in self._advice if sentence.startswith("warning")]
        count = sum(len(own.records) for own in self.sets)
        badges = [Badge("Records", str(count), own.headline, Standing.GOOD) for own in self.sets[:1]]
        unread = [*self.refused, *self.faults]
        told = unread[0].split("\n")[0] if unread else "Every file was read, as one set of records."
        badges.append(Badge("Not read", str(len(self.refused)), told, Standing.BAD if unread else Standing.GOOD))
        said = warnings[0].removeprefix("warning: ") if warnings else "Nothing speaks against these records."
        badges.append(Badge("Warnings", str(len(warnings)), said, Standing.OPEN if warnings else Standing.GOOD))
        todo = "\n\n".join(f"Go on: {own.command}" for own in self.sets[:2])
        return Brief("What do these records hold, and what can they not show?", todo, tuple(badges), picture)

    def save(self, folder: str | Path, *, source: Mapping[str, Any] | None = None) -> Path:
        """Write look.json and report.html; returns the folder."""
        folder, source = Path(folder), dict(source or _source(self))
        write_json(folder / LOOK_FILE, self.to_dict() | {"provenance": source})
        write_report(self.report(source), folder)
        return folder

    __repr__ = Answer.said


HEADER = ("channel", "unit", "role", "low", "high", "mean", "standard deviation", "resolution", "moves")


def table(own: RecordSet) -> Table:
    """The channels of a set of records, a row each."""
    caption = "Resolution: the step that a sensor or a logger rounds to, empty where none is seen."
    return Table("Channels", HEADER, tuple(_rows(own)), caption=caption, digits=4)


def _rows(own: RecordSet) -> list[tuple[Any, ...]]:
    return [
        (
            c.channel.name, c.channel.unit, c.channel.role if c.channel.role != "other" else "", c.low, c.high, c.mean,
            c.deviation, c.resolution or None, c.moves,
        )
        for c in own.channels
    ]  # fmt: skip


def _facts(records: Dataset, channel: Channel) -> ChannelFacts:
    parts = [e[channel.name] for e in records]
    count = sum(map(len, parts))
    mean = math.fsum(float(x.sum()) for x in parts) / count
    deviation = math.sqrt(math.fsum(float(np.sum((x - mean) ** 2)) for x in parts) / count)
    low, high = min(float(x.min()) for x in parts), max(float(x.max()) for x in parts)
    longest = max(parts, key=len)
    resolution = next((q for x in sorted(parts, key=len, reverse=True) if (q := quantum(x)) > 0.0), 0.0)
    return ChannelFacts(channel, low, high, mean, deviation, resolution, _moves(longest[:TRIED], low, high))


def _moves(x: np.ndarray, low: float, high: float) -> str:
    if low == high:
        return "constant"
    changes = int(np.count_nonzero(np.diff(x)))
    levels = len(np.unique(x))
    held = len(x) / (changes + 1)
    told = f"{levels} levels, " if levels <= LEVELS else ""
    if held >= HELD:
        return f"{told}changes every {held:.0f} samples on the average"
    return f"{told}moves on"


def _sections(own: RecordSet, several: bool) -> Iterator[Section]:
    first = own.records.experiments[0]
    rows = tuple((e.name, len(e), float(e.t[0]), float(e.t[-1]), e.dt, "; ".join(e.notes)) for e in own.records)
    records = Table("Records", ("record", "samples", "from [s]", "to [s]", "sample time [s]", "read as"), rows, digits=5)
    where = f": {', '.join(own.records.names[:3])}" if several else ""
    yield Section(f"Channels{where}", (table(own), records))
    if own.advice:
        yield Section(f"What these records cannot show{where}", tuple(Text(str(a)) for a in dict.fromkeys(map(str, own.advice))))
    drawn = sorted(own.records, key=len, reverse=True)[:DRAWN]
    left = len(own.records) - len(drawn)
    more = (Text(f"The {left} shorter ones are not drawn: look at them alone."),) if left else ()
    yield Section(f"Over time{where}", (*(_over_time(e) for e in own.records if e in drawn), *more))
    yield Section(f"Spectra{where}", (_spectra(max(own.records, key=len)),))
    schedules, inputs = first.names_of("schedule"), [*first.names_of("input"), *first.names_of("output")]
    pictures: list[Block] = [_visited(own.records, name, inputs) for name in schedules if inputs]
    if pictures:
        yield Section(f"Over the schedule{where}", tuple(pictures))


def _first(sections: Sequence[Section]) -> tuple[Picture | None, list[Section]]:
    """The first picture, and the sections without it."""
    picture = next((block for own in sections for block in own.blocks if isinstance(block, Picture)), None)
    rest = [replace(own, blocks=tuple(block for block in own.blocks if block is not picture)) for own in sections]
    return picture, [own for own in rest if own.blocks or own.more]


def _trace(e: Experiment, channel: Channel) -> Trace:
    return Trace(channel, e[channel.name])


def _over_time(e: Experiment) -> Block:
    return figures.signals(f"Record {e.name}", e.t, [_trace(e, c) for c in e.channels], f"All channels of {e.name}.")


def _spectra(e: Experiment) -> Block:
    """Square roots of Welch's power densities, of windows of at most WINDOW samples."""
    from scipy.signal import welch

    window = min(len(e), WINDOW, max(256, len(e) // 4))
    densities, frequency = [], np.zeros(0)
    for c in e.channels:  # one after the other: windows are copies
        frequency, power = welch(e[c.name], 1.0 / e.dt, nperseg=window)
        densities.append(Trace(Channel(c.name, f"{c.unit or '1'}/sqrt(Hz)"), np.sqrt(power[1:])))
    caption = f"Amplitude densities of {e.name}, the longest record (Welch, windows of {window} samples)."
    return figures.spectra("Spectra", frequency[1:], densities, caption)


def _visited(records: Dataset, schedule: str, names: Sequence[str]) -> Block:
    first = records.experiments[0]

    def joined(name: str) -> Trace:
        return Trace(first.channel(name), np.concatenate([e[name] for e in records]))

    others = [joined(name) for name in names if name != schedule]
    caption = f"Where inputs and outputs were over {schedule}, all records: a model knows nothing of what was not visited."
    return figures.visited(f"Over {schedule}", joined(schedule), others, caption)


def _source(found: Look) -> dict[str, Any]:
    """Hashes of all records and versions."""
    every = [Records(own.records).source({}) for own in found.sets]
    return every[0] | {"data": {name: digest for own in every for name, digest in own["data"].items()}}
