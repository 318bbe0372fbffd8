"""What every answer can do: say itself in a few lines, draw its page, and be written into a folder."""

import hashlib
import html
import textwrap
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from workbench.answers.verdict import ended
from workbench.data import Dataset, Experiment, check_held_out
from workbench.decimation import thinned
from workbench.diagnosis.check.records import check
from workbench.errors import InputError, NotHandedOutError
from workbench.physics.extension import Extension
from workbench.physics.plant import Plant
from workbench.provenance import provenance
from workbench.records import record
from workbench.report.blocks import Badge, Picture, Report, Standing, Text
from workbench.units import in_units

PLANT_FILE = "extended.json"
WIDTH = 110  # characters of a line
SHOWN = 12  # lines


@record
class Records:
    """The records of an answer: what is fitted, what is held out, and what is odd about them, in sentences."""

    own: Dataset
    held_out: Dataset | None = None
    notes: tuple[str, ...] = ()

    @property
    def shown(self) -> Dataset:
        """The records that errors are told of: held-out ones where there are any."""
        return self.held_out or self.own

    @property
    def files(self) -> list[str]:
        """The files that they came from."""
        return [e.file for e in (*self.own, *(self.held_out or ())) if e.file]

    def source(self, configuration: Mapping[str, Any]) -> dict[str, Any]:
        """Hashes of these files, or of the samples where there is no file (any more), what was asked, and versions."""
        there = [path for path in self.files if Path(path).is_file()]
        source = provenance({**configuration, "records": list(self.own.names)}, there)
        for e in (*self.own, *(self.held_out or ())):
            if e.file not in there:
                source["data"][e.name] = hashlib.sha256(np.ascontiguousarray(e.values).tobytes()).hexdigest()
        return source


class Answer(ABC):
    """The answer of a verb. In a notebook it shows its sentences and its first picture."""

    @property
    @abstractmethod
    def sentences(self) -> list[str]:
        """The answer in words, what matters most first."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Every number of the answer in plain types: the JSON that `save` writes, provenance apart."""

    @abstractmethod
    def report(self, source: Mapping[str, Any] | None = None) -> Report:
        """The page; source: where the numbers come from, by default the records and the versions."""

    @abstractmethod
    def save(self, folder: str | Path) -> Path:
        """Write the JSON, the page and whatever else goes on from here into a folder; returns the folder."""

    def said(self) -> str:
        """The first sentences in lines of readable width."""
        lines = [line for sentence in self.sentences for line in textwrap.wrap(sentence, WIDTH, subsequent_indent="  ")]
        return "\n".join([*lines[:SHOWN], *(["..."] if len(lines) > SHOWN else [])])

    def plot(self, title: str = "") -> Picture:
        """The first picture of the page whose title begins with `title`; a notebook draws it.

        Its `figure` is the matplotlib figure: `answer.plot().figure.savefig("picture.pdf")`.

        Raises InputError where there is none.
        """
        drawn = self._pictures()
        for picture in drawn:
            if picture.title.startswith(title):
                return picture
        known = "; ".join(picture.title for picture in drawn) or "none"
        raise InputError(f"no picture {title!r}", mend=f"there is: {known}")

    def _pictures(self) -> list[Picture]:
        return [block for block in self.report().blocks if isinstance(block, Picture)]

    def _repr_html_(self) -> str:
        said = "".join(f"<p>{html.escape(sentence)}</p>" for sentence in self.sentences)
        return "".join([said, *(picture._repr_html_() for picture in self._pictures()[:1])])


class PlantAnswer(Answer):
    """An answer that is a plant: with fitted parameters, or extended by what was found.

    nominal: the plant before. accepted: whether it is handed out although the referee objects.
    """

    nominal: Plant
    records: Records
    accepted: bool

    @property
    @abstractmethod
    def objections(self) -> tuple[str, ...]:
        """Where it is worse on held-out records than the plant that it replaces."""

    @abstractmethod
    def extension(self, base: str = "", source: Mapping[str, Any] | None = None) -> Extension:
        """What was found, apart from the plant's equation; base: where the plant is found, by default its name."""

    @property
    def handed_out(self) -> bool:
        return self.accepted or not self.objections

    def stands(self, about: str, signs: Sequence[str]) -> Badge:
        """Whether the plant is handed out, and what speaks against it; signs: what is odd, though it is no objection."""
        told = [*self.objections, *signs]
        return Badge(
            about,
            "handed out" if self.handed_out else "NOT handed out",
            ended(told[0]) if told else "Nothing speaks against it.",
            Standing.BAD if self.objections else Standing.OPEN if told else Standing.GOOD,
        )

    @cached_property
    def plant(self) -> Plant:  # one object, so that it is traced and compiled once
        """The plant of the answer. Raises NotHandedOutError where the referee objects and nobody has accepted it."""
        if not self.handed_out:
            raise refused(f"the plant {self.nominal.name}", self.objections)
        return self.extension().of(self.nominal)

    def source(self) -> dict[str, Any]:
        """Where the numbers come from, unless a command says more of it."""
        return self.records.source({"plant": self.nominal.name})

    def save_plant(self, folder: Path, base: str, source: Mapping[str, Any]) -> str | None:
        """The path of the plant file, which is written where it is handed out; one of a former answer is removed elsewhere."""
        path = folder / PLANT_FILE
        if self.handed_out:
            return str(self.extension(base, source).save(path))
        path.unlink(missing_ok=True)
        return None


def as_dataset(records: Any) -> Dataset:
    """The records of a verb. Raises InputError for what holds none."""
    if isinstance(records, Experiment):
        return Dataset((records,))
    if not isinstance(records, Dataset):
        told = f"{type(records).__name__} {records!r}"[:60]
        raise InputError(f"records: {told}, expected a Dataset", mend="read it first: wb.read('a.csv', inputs=.., outputs=..)")
    return records


def prepared(plant: Plant, own: Dataset, held_out: Dataset | None, dt: float | None, anyway: bool) -> Records:
    """Records brought to the plant's sample time where they are much faster, and checked against the plant.

    dt [s]: the sample time to bring them to. Raises InputError for records that cannot be of this plant, unless the user takes
    them `anyway`, and for held-out records that are among the others.
    """
    if not isinstance(plant, Plant):
        told = f"{type(plant).__name__} {plant!r}"[:60]
        raise InputError(f"plant: {told}, expected a Plant", mend="from plants import PLANTS, or a plant of your own")
    units = {c.name: c.unit for c in (*plant.inputs, *plant.outputs)}
    own, told = thinned(as_dataset(own), dt, plant)
    held_out = None if held_out is None else thinned(as_dataset(held_out), own.dt if told else dt, plant)[0]
    sets = [(read, in_units(read, units)) for read in (own, held_out) if read]
    if held_out:
        check_held_out(sets[0][1], sets[1][1])
    notes = [note for _, one in sets for note in one.notes] + [f"{', '.join(own.names)}: {told}"] * bool(told)
    notes += [str(note) for read, one in sets for note in check(plant, one, read=read, anyway=anyway)]
    return Records(sets[0][1], sets[1][1] if held_out else None, tuple(notes))


def texts(sentences: Iterable[str]) -> tuple[Text, ...]:
    """Sentences as a block, or nothing."""
    text = "\n\n".join(sentences)
    return (Text(text),) if text else ()


def refused(what: str, objections: Sequence[str]) -> NotHandedOutError:
    """Why an answer is not handed out, and how to take it all the same."""
    return NotHandedOutError(f"{what} is not handed out: {objections[0]}", mend="accept=True takes it all the same")
