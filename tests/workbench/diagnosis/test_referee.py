"""What is handed out is compared with what it replaces: the arithmetic, and calibrations that would be worse."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.workbench.diagnosis.drive import DRIVE, J, records
from workbench.diagnosis import findings, referee
from workbench.diagnosis.calibrate import calibrate, gains, trajectories
from workbench.diagnosis.diagnosis import diagnose
from workbench.diagnosis.findings import _objection
from workbench.diagnosis.gains import Held, Score
from workbench.diagnosis.referee import Change, Judge, changes, harms, helps, worse

DT, N = 0.01, 4000


def held(*series: tuple[str, np.ndarray]) -> Held:
    """A model with these errors by horizon, in one channel of one record."""
    scores = tuple(Score("r", horizon, "y", "m", float(np.sqrt(np.nanmean(e**2)))) for horizon, e in series)
    return Held(scores, 0.0, tuple(e**2 for _, e in series), DT)


def coloured(seed: int, memory: float) -> np.ndarray:
    """Noise of unit size that fades with `memory` samples."""
    random, a = np.random.default_rng(seed), np.exp(-1.0 / memory)
    e = np.zeros(N)
    for k in range(1, N):
        e[k] = a * e[k - 1] + np.sqrt(1.0 - a * a) * random.standard_normal()
    return e


def test_a_share_is_that_of_the_pooled_root_mean_square():
    e = coloured(0, 1.0)
    (change,) = changes(held(("one-step", e)), held(("one-step", 0.8 * e)))
    assert change.share == pytest.approx(0.2)
    assert change.before == pytest.approx(np.sqrt(np.mean(e**2)))
    assert change.sure


@pytest.mark.slow
def test_errors_that_differ_by_chance_are_not_told_apart_however_long_they_last():
    """Of pairs of independent noise of the same size one in twenty may look different; white blocks would find most."""
    for memory in (1.0, 100.0):
        told = [
            changes(held(("full-run", coloured(2 * k, memory))), held(("full-run", coloured(2 * k + 1, memory))))[0].sure
            for k in range(60)
        ]
        assert np.mean(told) < 0.15


def test_a_difference_that_lasts_is_told():
    e = coloured(1, 100.0)
    (change,) = changes(held(("full-run", e)), held(("full-run", e + 1.0)))
    assert change.sure
    assert change.share < -0.2
    assert worse((change,))
    assert not harms((change,))  # full runs of phases and integrals harm no cause


def test_a_run_that_leaves_its_record_near_the_end_is_worse_however_well_it_went_before():
    """An arm that goes over the top once: nine tenths of the run are better than before, the rest is elsewhere."""
    e = coloured(2, 20.0)
    over = 0.3 * e + np.where(np.arange(N) < 0.97 * N, 0.0, 60.0 * np.arange(N) / N)
    (change,) = changes(held(("full-run", e)), held(("full-run", over)))
    assert worse((change,))


def test_a_lost_run_is_worse_than_any_other_and_a_found_one_better():
    e = coloured(1, 1.0)
    lost = np.where(np.arange(N) > 3000, np.inf, e)
    (fell,) = changes(held(("full-run", e)), held(("full-run", lost)))
    assert fell.share == -np.inf
    assert worse((fell,)) == (fell,)
    assert "a lost run" in str(fell)
    (rose,) = changes(held(("full-run", lost)), held(("full-run", e)))
    assert rose.share == np.inf
    assert helps((rose,), 0.01)
    assert not worse((rose,))
    (neither,) = changes(held(("full-run", lost)), held(("full-run", lost)))
    assert neither.share == 0.0


def test_what_was_not_measured_does_not_count():
    e = coloured(1, 1.0)
    gap = np.where(np.arange(N) < 500, np.nan, e)
    (change,) = changes(held(("one-step", gap)), held(("one-step", 0.5 * gap)))
    assert change.share == pytest.approx(0.5)


class Told:
    """A judge that has looked already."""

    held_out = True

    def __init__(self, *found: Change, surprise: float = -50.0):
        self._found, self._surprise = found, surprise

    def between(self, before, after):
        return self._found

    def surprise(self, before, after):
        return self._surprise


@pytest.fixture
def size_known(monkeypatch):
    monkeypatch.setattr(findings, "_none", lambda step: step.none)
    monkeypatch.setattr(findings, "_helps_free_runs", lambda step, judge: step.lasts)


def step(gain: float, none: bool = False, lasts: bool = False, far: float = 0.5) -> SimpleNamespace:
    """A step as far as an objection looks at it; none: the intervals of its sizes hold 0; lasts: free runs ask for it; far: how
    many standard deviations from its data sheet it takes a parameter.
    """
    before, after = (SimpleNamespace(farthest=f, beyond=0.0) for f in (0.5, far))
    return SimpleNamespace(gain=gain, before=before, after=after, none=none, lasts=lasts)


@pytest.mark.usefixtures("size_known")
@pytest.mark.parametrize(
    ("gain", "left", "first", "change", "named"),
    [
        (60.0, 0.0, True, ("one-step", 1.0, 0.9999), True),  # nothing is ever asked of a first cause but its likelihood
        (60.0, 61.0, True, ("one-step", 1.0, 0.5), False),  # but that no more is left than it explains
        (60.0, 0.0, False, ("one-step", 1.0, 0.9960), False),  # 0.4 % of an error is no reason for a second name
        (60.0, 0.0, False, ("one-step", 1.0, 0.9945), True),  # 0.55 % is, where nothing is left
        (60.0, 50.0, False, ("one-step", 1.0, 0.9945), False),  # and is not beside a remainder,
        (60.0, 50.0, False, ("one-second", 1.0, 0.9890), True),  # where 1 % is
    ],
)
def test_what_a_cause_must_gain(gain, left, first, change, named):
    horizon, before, after = change
    objection = _objection(step(gain), first, left, Told(Change("y", horizon, "m", before, after, True)), False)
    assert (objection == "") is named


@pytest.mark.usefixtures("size_known")
@pytest.mark.parametrize("first", [True, False])
def test_a_size_that_is_not_told_from_none_is_no_cause(first):
    better = Told(Change("y", "one-second", "m", 1.0, 0.5, True))
    assert _objection(step(60.0), first, 0.0, better, False) == ""
    assert "a size that they do not tell from none" in _objection(step(60.0, none=True), first, 0.0, better, False)


@pytest.mark.usefixtures("size_known")
def test_a_further_cause_must_not_take_a_parameter_far_from_its_data_sheet():
    better = Told(Change("y", "one-second", "m", 1.0, 0.5, True))
    assert "data sheet" in _objection(step(60.0, far=3.1), False, 0.0, better, False)
    assert _objection(step(60.0, far=2.9), False, 0.0, better, False) == ""
    assert _objection(step(60.0, far=3.1), True, 0.0, better, False) == ""  # a first one is told with its doubt


@pytest.mark.usefixtures("size_known")
def test_a_further_cause_must_not_make_another_error_worse():
    better, rose = Change("y", "one-second", "m", 1.0, 0.9, True), Change("z", "one-step", "m", 1.0, 1.01, True)
    assert "makes an error worse (z one-step" in _objection(step(60.0), False, 0.0, Told(better, rose), False)
    assert _objection(step(60.0), False, 0.0, Told(better, replace(rose, sure=False)), False) == ""
    assert _objection(step(60.0), True, 0.0, Told(better, rose), False) == ""
    assert "held-out" in _objection(step(60.0), True, 0.0, Told(better, surprise=1.0), False)
    assert _objection(step(60.0, lasts=True), True, 0.0, Told(better, surprise=1.0), False) == ""


@pytest.mark.usefixtures("size_known")
def test_what_is_found_without_coloured_torques_is_judged_a_second_ahead():
    ahead = Change("y", "one-second", "m", 1.0, 0.8, True)
    assert _objection(step(60.0), True, 0.0, Told(ahead, surprise=1.0), True) == ""
    assert "held-out" in _objection(step(60.0), True, 0.0, Told(replace(ahead, sure=False), surprise=-50.0), True)


@pytest.mark.parametrize(
    ("one_step", "one_second", "full_run", "from_given", "taken"),
    [
        (1.00, 0.95, 0.95, 0.5, True),
        (1.00, 0.99, 0.99, 0.5, False),  # no better that a fit of its own is worth
        (1.05, 0.25, 0.25, 0.5, True),  # a twentieth one step ahead for three quarters further ahead
        (1.09, 0.25, 0.25, 0.5, False),
        (1.05, 0.70, 0.70, 0.5, False),
        (1.00, 1.05, 0.25, 0.5, False),  # further ahead nothing is exchanged
        (1.05, 0.25, 0.25, 1.04, False),  # it must stay below the plant as it came
        (np.nan, 0.25, 0.25, 0.5, False),
    ],
)
def test_free_runs_that_err_less_may_cost_a_little_one_step_ahead(monkeypatch, one_step, one_second, full_run, from_given, taken):
    given, model, runs = (SimpleNamespace(name=name) for name in ("given", "model", "runs"))
    monkeypatch.setattr(referee, "simulated", lambda own: runs if own is model else None)

    class Known(Judge):
        def between(self, before, after):
            if before is given:
                return (Change("y", "one-step", "m", 1.0, from_given if after is runs else 0.98, True),)
            after = zip(("one-step", "one-second", "full-run"), (one_step, one_second, full_run), strict=True)
            return tuple(Change("y", horizon, "m", 1.0, value, True) for horizon, value in after)

    # what the likelihood's fit already errs more by than the plant that came may not grow for a gain further ahead
    class Worse(Known):
        def between(self, before, after):
            if before is given:
                return (Change("y", "one-step", "m", 1.0, 1.12 if after is runs else 1.05, True),)
            return super().between(before, after)

    assert Worse(records(1), held_out=True).better_ahead(given, model) is (runs if one_step <= 1.0 and taken else model)
    judge = Known(records(1), held_out=True)
    assert judge.better_ahead(given, model) is (runs if taken else model)
    assert judge.better_ahead(given, runs) is runs  # where no free run can be fitted


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_calibration_is_better_than_the_plant_that_it_replaces_or_says_that_it_is_not(seed):
    """A tacho that lags, which the plant does not know: one step ahead a wrong inertia makes up for it, over the full run not.
    From the true parameters every move is for the worse.
    """
    own, other = (
        records(seed, lag=0.1, inertia=1.0, samples=1500),
        records(seed + 10, lag=0.1, inertia=1.0, count=1, samples=1500),
    )
    for plant in (DRIVE, _moved(DRIVE, 1.15)):
        done = calibrate(plant, own, other)
        found = gains(plant, trajectories(plant, other), trajectories(done.plant, other))
        (run,) = (g for g in found if g.horizon == "full-run")
        assert run.after < 1.03 * run.before or done.objections


def _moved(plant, factor):
    return replace(
        plant, parameters=tuple(replace(q, value=q.value * (factor if q.name == "J0" else 1.0)) for q in plant.parameters)
    )


@pytest.mark.parametrize(("inertia", "bent"), [(1.0, False), (1.15, True)])
def test_parameters_stay_as_they_came_where_others_help_nowhere(inertia, bent):
    found = diagnose(DRIVE, records(3, inertia=inertia, samples=1500), records(13, inertia=inertia, count=1, samples=1500))
    assert not found.causes
    assert (found.parameters["J0"] != J) is bent
    assert any("the plant keeps its own parameters" in note for note in found.notes) is not bent
