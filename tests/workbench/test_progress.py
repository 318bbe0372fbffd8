"""Steps of a known number, told with the time that is left."""

import pytest

from workbench import progress
from workbench.progress import Steps, silent, time_said


@pytest.fixture
def clock(monkeypatch):
    """A clock that the test sets."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def test_the_time_left_is_that_of_the_steps_so_far(clock):
    said: list[str] = []
    steps = Steps(said.append, 40, "runs")
    clock[0] += 10.0
    steps.done(10)
    clock[0] += 10.0
    steps.done(10, "the loop at 0.3 m/s")
    steps.done(20)
    assert said == ["10 of 40 runs, 30 s left", "the loop at 0.3 m/s (20 of 40 runs, 20 s left)", "40 of 40 runs"]


def test_what_was_done_before_took_no_time(clock):
    said: list[str] = []
    steps = Steps(said.append, 100, "cases", before=90)
    assert steps.left == 0.0
    clock[0] += 5.0
    steps.done(5)
    assert said == ["95 of 100 cases, 5 s left"]


def test_lines_keep_their_distance_and_the_last_one_is_told(clock):
    said: list[str] = []
    steps = Steps(said.append, 4, "runs", pause=2.0)
    for _ in range(4):
        clock[0] += 1.0
        steps.done()
    assert said == ["2 of 4 runs, 2 s left", "4 of 4 runs"]


@pytest.mark.parametrize(("seconds", "said"), [(0.4, "0 s"), (99.0, "99 s"), (600.0, "10 min"), (9000.0, "2.5 h")])
def test_an_estimate_is_as_exact_as_it_can_be(seconds, said):
    assert time_said(seconds) == said


def test_nobody_is_told_by_default(capsys):
    silent("nothing")
    assert capsys.readouterr() == ("", "")
