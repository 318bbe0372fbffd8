"""What `calibrate` and `diagnose` share: their records, what was asked of them, and how an extended plant is named again."""

from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from plants import PLANTS
from studies.arguments import Chosen
from workbench.answers.answer import Records
from workbench.data import Dataset
from workbench.sources import read_files


def read_both(options: Namespace) -> tuple[Dataset, Dataset | None]:
    """The records of a command, and those of --holdout."""
    own, held_out = (read_files(paths, options.file_dt) for paths in (options.records, options.holdout))
    return joined(own), joined(held_out) if held_out else None


def joined(each: Sequence[Dataset]) -> Dataset:
    return Dataset(tuple(e for own in each for e in own))


def configuration(options: Namespace, records: Records, *keys: str) -> dict[str, Any]:
    """The options that made the answer, and the sample time that the records were brought to."""
    return {key: getattr(options, key) for key in keys} | {"records": list(records.own.names), "dt": records.own.dt}


def plant_again(chosen: Chosen, path: Path) -> str:
    """How the plant of a plant file is written on the command line."""
    return str(path) if chosen.base in PLANTS else f"{chosen.base}+{path}"
