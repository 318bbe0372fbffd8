"""Errors name the place and the mend."""

import pytest

from workbench.errors import InputError, check_known


def test_the_message_names_file_line_channel_problem_and_mend_in_that_order():
    error = InputError("is not a number", file="a.csv", line=7, channel="w3", mend="repair it")
    assert str(error) == "a.csv, line 7, channel w3: is not a number\n  mend: repair it"
    assert (error.file, error.line, error.channel, error.mend) == ("a.csv", 7, "w3", "repair it")


def test_places_that_are_not_known_leave_no_trace():
    assert str(InputError("is empty")) == "is empty"
    assert str(InputError("is empty", line=0)) == "line 0: is empty"


def test_a_known_name_passes_and_an_unknown_one_is_refused_with_its_neighbour():
    assert check_known("channel", "theta", iter(["w3", "theta"])) == "theta"
    with pytest.raises(InputError, match="unknown channel 'teta'\n  mend: did you mean 'theta'"):
        check_known("channel", "teta", ["w3", "theta"])
    with pytest.raises(InputError) as caught:
        check_known("channel", "qqqq", ["w3", "theta"])
    assert caught.value.mend == "known: w3, theta"
