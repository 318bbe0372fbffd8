"""Measured records: channels with units and roles, experiments, and datasets of several records.

Samples first, channels last. Several records are a list and are never concatenated: no method differences or simulates
across the joint of two records.
"""

from collections.abc import Iterator, Sequence
from typing import Literal, get_args

import numpy as np

from workbench.errors import InputError, check_known
from workbench.records import field, record

Role = Literal["time", "input", "output", "schedule", "reference", "other"]


@record
class Channel:
    """A named column with its unit (SI unless it says otherwise) and its role."""

    name: str
    unit: str = ""
    role: Role = "other"

    def __post_init__(self):
        check_known("role", self.role, get_args(Role))

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@record
class Experiment:
    """One record: values[k, c] is channel c at time t[k] [s]; dt [s] is the sample time, the median step of t."""

    name: str
    t: np.ndarray = field("N", unit="s")
    channels: tuple[Channel, ...]
    values: np.ndarray = field("N nc")
    dt: float = field("", unit="s", low=1e-12)

    def __post_init__(self):
        names = [channel.name for channel in self.channels]
        if len(names) != self.values.shape[1]:
            raise InputError(f"{len(names)} channels for {self.values.shape[1]} columns", file=self.name)
        for name in names:
            if names.count(name) > 1:
                raise InputError("appears twice", file=self.name, channel=name, mend="give each column its own name")

    def __len__(self) -> int:
        return len(self.t)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(channel.name for channel in self.channels)

    def names_of(self, role: Role) -> tuple[str, ...]:
        """Names of the channels with a role, in column order."""
        return tuple(channel.name for channel in self.channels if channel.role == role)

    def __getitem__(self, names: str | Sequence[str]) -> np.ndarray:
        """Column(s) by name: a string gives (N,), a sequence of k names (N, k)."""
        if isinstance(names, str):
            check_known("channel", names, self.names, file=self.name)
            return self.values[:, self.names.index(names)]
        return np.column_stack([self[name] for name in names]) if len(names) else np.empty((len(self), 0))


@record
class Dataset:
    """Several records with the same sample time; never concatenated."""

    experiments: tuple[Experiment, ...]

    def __post_init__(self):
        if not self.experiments:
            raise InputError("no records", mend="name at least one file")

    def __iter__(self) -> Iterator[Experiment]:
        return iter(self.experiments)

    def __len__(self) -> int:
        return len(self.experiments)

    @property
    def dt(self) -> float:
        return self.experiments[0].dt
