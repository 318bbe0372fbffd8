"""The schedule variables of a record as a method reads them: one or several, from outside or one that is an output."""

from collections.abc import Sequence

import numpy as np

from workbench.basis import Basis, Powers, Products, polynomials
from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.lpv import check_one_if_output

MOST = 6  # variables of a schedule: a lattice over more holds too few values of each


def schedules_of(first: Experiment) -> tuple[Channel, ...]:
    """The schedule variables of a record, none or several.

    Raises InputError for more than MOST, and for a schedule that is an output beside others.
    """
    schedules = tuple(first.channel(name) for name in first.names_of("schedule"))
    if len(schedules) > MOST:
        names = ", ".join(c.name for c in schedules)
        problem = f"{len(schedules)} schedule variables, at most {MOST} are possible"
        raise InputError(problem, file=first.name, channel=names, mend="keep those that change the machine most")
    check_one_if_output(schedules, first.name)
    return schedules


def spans_of(dataset: Dataset, schedules: Sequence[Channel]) -> np.ndarray:
    """The lowest and highest value of each schedule variable over all records, (ns, 2)."""
    rho = np.concatenate([e[[c.name for c in schedules]] for e in dataset])
    return np.stack([rho.min(axis=0), rho.max(axis=0)], axis=1)


def polynomials_over(spans: np.ndarray, degree: int) -> Basis:
    """Every product of the schedule variables, each over its largest value in spans (ns, 2), up to a total degree."""
    largest = np.abs(spans).max(axis=1)
    scales = np.where(largest > 0.0, largest, 1.0)
    return polynomials(degree, scales) if len(scales) > 1 else Powers(np.arange(degree + 1.0), float(scales[0]))


def check_variables(basis: Basis, schedules: Sequence[Channel]) -> None:
    """Refuse a basis of another number of variables."""
    known = len(basis.factors) if isinstance(basis, Products) else 1
    if known != len(schedules):
        names = ", ".join(c.name for c in schedules)
        problem = f"a basis of {known} variables for {len(schedules)} schedules"
        raise InputError(problem, channel=names, mend="give Products of one factor for each, or no basis")
