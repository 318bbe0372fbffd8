"""Records: one check for shapes, bounds and numbers; values that cannot change."""

import dataclasses
import math

import numpy as np
import pytest

from workbench.records import RecordError, field, record


@record
class Line:
    gain: np.ndarray = field("N nu", unit="V/rad", low=0.0, high=2.0)
    offset: np.ndarray = field("nu")
    pair: np.ndarray = field("2", default=(0.0, 1.0))
    scale: float = field("", low=0.0, default=1)
    label: str = "none"


def test_fields_become_read_only_copies():
    gain = np.ones((3, 2))
    line = Line(gain, [1, 2])
    gain[0, 0] = 2.0
    assert line.gain[0, 0] == 1.0
    assert line.offset.dtype == np.float64
    assert type(line.scale) is float
    with pytest.raises(ValueError, match="read-only"):
        line.gain[0, 0] = 2.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        line.label = "other"


def test_a_size_name_stands_for_one_number_throughout():
    with pytest.raises(RecordError, match=r"Line.offset: shape \(3,\), expected nu = 2 as in Line.gain"):
        Line(np.ones((3, 2)), np.ones(3))
    with pytest.raises(RecordError, match=r"Line.pair: shape \(3,\), expected 2"):
        Line(np.ones((3, 2)), np.ones(2), np.ones(3))
    with pytest.raises(RecordError, match=r"Line.offset: shape \(1, 2\), expected \(nu\)"):
        Line(np.ones((3, 2)), np.ones((1, 2)))


@pytest.mark.parametrize("bad", [-1e-9, 2.0001, math.inf])
def test_bounds_are_inclusive(bad):
    Line([[0.0, 2.0]], np.zeros(2))
    with pytest.raises(RecordError, match=r"Line.gain: .* V/rad is outside \[0, 2\]"):
        Line([[0.0, bad]], np.zeros(2))


def test_a_hole_is_named_with_its_place_whatever_the_bounds():
    with pytest.raises(RecordError, match=r"Line.gain: a hole \(not a number\) at \[0, 1\]"):
        Line([[0.0, math.nan]], np.zeros(2))
    with pytest.raises(RecordError, match=r"Line.offset: a hole \(not a number\) at \[1\]"):
        Line([[0.0, 1.0]], [0.0, math.nan])


def test_what_is_not_numbers_is_refused_with_the_place():
    with pytest.raises(RecordError, match=r"Line.offset: not numbers"):
        Line(np.ones((1, 1)), ["a"])
    with pytest.raises(RecordError, match=r"Line.gain: not numbers"):
        Line([[1, 2], [3]], [1.0])


def test_a_check_of_its_own_runs_after_the_fields_were_checked():
    @record
    class Sum:
        parts: np.ndarray = field("n")

        def __post_init__(self):
            if self.parts.sum() != 1.0:  # a list would have no sum
                raise RecordError("parts do not sum to one")

    Sum([0.5, 0.5])
    with pytest.raises(RecordError, match="do not sum"):
        Sum([0.5])


def test_an_array_that_nobody_can_change_is_handed_on_and_any_other_copied():
    @record
    class Row:
        x: np.ndarray = field("N")

    own = np.arange(3.0)
    first = Row(own)
    own[0] = 9.0
    assert first.x[0] == 0.0
    assert Row(first.x).x is first.x
    assert Row(first.x[1:]).x.base is first.x
    view = own[:]
    view.setflags(write=False)  # the array behind it may still change
    second = Row(view)
    own[1] = 9.0
    assert second.x[1] == 1.0
