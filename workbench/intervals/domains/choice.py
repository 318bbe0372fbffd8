"""The nearest of several domains for every sample."""

from collections.abc import Sequence

import numpy as np

from workbench.errors import InputError
from workbench.intervals.domains.region import check_same_dimension, checked_queries
from workbench.intervals.domains.shapes import Domain
from workbench.records import field, record


@record
class Choice:
    """For every sample the domain that was chosen, `index` (Q), the gauge (Q) in it, and the domains that hold it, (Q, M)."""

    index: np.ndarray
    gauge: np.ndarray = field("Q", low=0.0)
    holds: np.ndarray = field(None)


def nearest(domains: Sequence[Domain], x: np.ndarray, *, hold: bool = False) -> Choice:
    """The domain with the smallest gauge for every sample; x (Q, d), samples in the order of time.

    Ties go to the first domain. With `hold` a sample inside the domain chosen for the sample before stays there, so that
    overlapping domains do not make a model switch to and fro.
    """
    if not domains:
        raise InputError("no domains to choose from")
    for other in domains[1:]:
        check_same_dimension(domains[0], other)
    x, _ = checked_queries(x, None, len(domains[0].low))
    holds = np.column_stack([domain.holds(x) for domain in domains])
    index, gauge = np.argmax(holds, axis=1), np.zeros(len(x))
    outside = np.flatnonzero(~holds.any(axis=1))
    index[outside], gauge[outside] = _closest(domains, x[outside])
    if hold:
        for k in range(1, len(index)):
            if holds[k, index[k - 1]]:
                index[k] = index[k - 1]
    return Choice(index, gauge, holds)


def _closest(domains: Sequence[Domain], x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Domain of smallest gauge and that gauge for every sample outside all of them; outer boxes spare what cannot win."""
    bound = np.column_stack([domain.outer_gauge_of_boxes(x, x) for domain in domains])
    gauge, best = np.full(bound.shape, np.inf), np.full(len(x), np.inf)
    order = np.argsort(bound, axis=1, kind="stable")
    for rank in range(len(domains)):
        for j, domain in enumerate(domains):
            ask = np.flatnonzero((order[:, rank] == j) & (bound[:, j] <= best))
            if len(ask):
                gauge[ask, j] = domain.gauge_of_boxes(x[ask], x[ask])
                best[ask] = np.minimum(best[ask], gauge[ask, j])
    index = np.argmin(gauge, axis=1)
    return index, gauge[np.arange(len(x)), index]
