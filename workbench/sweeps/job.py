"""What a sweep runs its points through, and the error that ends it."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from workbench.errors import InputError
from workbench.sweeps.design import Point


class StoppedError(InputError):
    """What a job raises where no run makes sense any more: it ends the sweep and is nobody's row."""


PASSING = (MemoryError, ImportError, StoppedError)  # what ends the sweep: the same run may come to an end another time


class Job(Protocol):
    """What a sweep runs. It is sent to other processes as it is, and must give the same answers there."""

    @property
    def configuration(self) -> Mapping[str, Any]:
        """What its answers depend on beside the points, in plain values: the content of files rather than their names."""
        ...

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of every parameter, by name."""
        ...

    @property
    def outputs(self) -> Mapping[str, str]:
        """Unit of every output, by name."""
        ...

    def on_threads(self, count: int) -> "Job | None":
        """The same job on threads of this process, where it is as fast on them as on as many processes; else None."""
        ...

    def __call__(self, points: Sequence[Point]) -> list[Mapping[str, float] | Exception]:
        """The outputs of each, or why there are none. A run's answer must not depend on which others are beside it."""
        ...
