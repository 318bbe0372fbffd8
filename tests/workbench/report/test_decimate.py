"""Decimation keeps what an eye would miss: extremes, order, ends and gaps; and it does decimate."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from workbench.report.decimate import extremes

VALUES = st.floats(-1e9, 1e9) | st.sampled_from([np.nan, np.inf, -np.inf])
TRACES = st.integers(1, 300).flatmap(
    lambda N: st.tuples(
        arrays(float, N, elements=st.floats(0, 1e3)).map(np.cumsum),  # steps of zero: repeated time stamps
        arrays(float, N, elements=VALUES),
    )
)


@pytest.mark.slow
@given(TRACES, st.integers(1, 50))
def test_kept_samples_are_in_order_and_once_and_hold_both_ends(trace, columns):
    kept = extremes(*trace, columns)
    assert np.all(np.diff(kept) > 0)
    assert kept[0] == 0
    assert kept[-1] == len(trace[0]) - 1


@given(TRACES, st.integers(1, 50))
def test_every_pixel_column_keeps_its_lowest_and_highest_value(trace, columns):
    x, y = trace
    kept = extremes(x, y, columns)
    width = x[-1] - x[0]
    column = np.floor(np.minimum((x - x[0]) / width * columns, columns - 1)) if width else np.zeros(len(x))
    for c in np.unique(column):
        values, seen = y[column == c], y[kept][column[kept] == c]
        if np.isfinite(values).any():
            assert np.isfinite(seen).any()
            assert seen[np.isfinite(seen)].min() == values[np.isfinite(values)].min()
            assert seen[np.isfinite(seen)].max() == values[np.isfinite(values)].max()
        # a value that is not finite breaks the line: a column that had one still has one
        assert np.isfinite(seen).all() == np.isfinite(values).all()


@given(TRACES, st.integers(1, 50))
def test_no_more_than_three_samples_a_column_and_the_ends_are_kept(trace, columns):
    assert len(extremes(*trace, columns)) <= 3 * columns + 2


def test_a_short_trace_is_kept_whole():
    np.testing.assert_array_equal(extremes(np.arange(20.0), np.zeros(20), 10), np.arange(20))


def test_one_spike_in_a_hundred_thousand_samples_survives():
    y = np.zeros(100_000)
    y[77_777] = -5.0
    kept = extremes(np.arange(100_000) * 0.04, y, 600)
    assert 77_777 in kept
    assert len(kept) <= 1202
