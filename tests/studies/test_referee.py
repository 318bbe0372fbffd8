"""Exit code 3: an answer that the referee does not hand out, unless the user takes it all the same."""

from studies.cli import DONE, NOT_HANDED_OUT, parser
from studies.referee import handed_out


def test_an_objection_is_said_first_and_ends_with_3():
    said = []
    assert handed_out([], False, said.append) == handed_out([], True, said.append) == DONE == 0
    assert said == []
    assert handed_out(["the loop is lost", "the record is left"], False, said.append) == NOT_HANDED_OUT == 3
    assert said == ["NOT HANDED OUT: the loop is lost", "NOT HANDED OUT: the record is left", "  --accept takes it all the same"]


def test_who_accepts_is_told_all_the_same():
    said = []
    assert handed_out(["the loop is lost"], True, said.append) == DONE
    assert said == ["ACCEPTED ALL THE SAME: the loop is lost"]


def test_the_option_has_one_spelling():
    assert parser().parse_args(["design", "pid", "--model", "m.json", "--accept"]).accept is True
    assert parser().parse_args(["design", "pid", "--model", "m.json"]).accept is False
