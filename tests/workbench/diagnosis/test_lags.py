"""Lags and time constants that can change places: the drive by its own Euler steps, and the robot."""

import numpy as np
import pytest

from tests.workbench.diagnosis.cases import ROBOT, robot_records
from tests.workbench.diagnosis.drive import DRIVE, DT, KT, RA, RPM, C, J, records
from workbench.diagnosis.answer import Diagnosis, Finding
from workbench.diagnosis.diagnosis import diagnose

pytestmark = pytest.mark.slow


def lag_of(found: Diagnosis):
    """The one cause, which is the tacho's or the sensor's lag."""
    (cause,) = found.causes
    assert cause.effect == "sensor-lag"
    return cause.parameters["time"]


def within_tolerance(found: Diagnosis, plant) -> bool:
    open_ = {q.name: q.tolerance for q in plant.parameters}
    return all(abs(e.value / e.nominal - 1.0) < open_[name] for name, e in found.recalibrated.items())


def test_the_drive_of_these_tests_is_the_plant_that_its_owner_writes():
    """Two writings of one machine: steps of the voltage end where the equation rests, with its time constant."""
    T = J * RA / (KT**2 + RA * C)
    e = records(3, count=1, inertia=1.0).experiments[0]
    rest = RPM * KT * e["U"][0] / (KT**2 + RA * C)
    predicted = rest + (20.0 * RPM - rest) * np.exp(-np.arange(60) * DT / T)
    assert np.std(e["n"][:60] - predicted) < 1.5


@pytest.mark.parametrize(("lag", "inertia"), [(0.05, 0.9), (0.03, 1.1)])
def test_the_lag_of_a_tacho_does_not_change_places_with_the_drive(lag, inertia):
    """At 50 ms the exchanged order, 123 ms at 45 % of the inertia, explains the records as well: the data sheet decides."""
    found = diagnose(DRIVE, records(1, lag=lag, inertia=inertia, samples=1500), records(2, lag=lag, inertia=inertia, count=1))
    assert found.finding is Finding.NAMED
    time = lag_of(found)
    assert time.value == pytest.approx(lag, rel=0.02)
    assert within_tolerance(found, DRIVE)
    at = found.parameters
    assert at["J0"] * at["Ra"] / at["kT"] ** 2 == pytest.approx(inertia * J * RA / KT**2, rel=0.02)  # all that these records know
    (ran,) = (g for g in found.causes[0].gains if g.horizon == "full-run")
    assert ran.after < 1.1 < 10.0 < ran.before  # the reading's noise is 1


def test_two_orders_that_the_data_sheet_does_not_tell_apart_are_both_told():
    """100 ms behind 153 ms is nearly 150 ms behind 102 ms: both within the tolerances."""
    found = diagnose(DRIVE, records(1, lag=0.1, samples=1500), records(2, lag=0.1, count=1, samples=1500))
    time = lag_of(found)
    assert time.low < 0.102
    assert time.high > 0.14
    assert any("change places" in note for note in found.notes)


def test_a_lag_that_meets_a_time_constant_of_the_machine_is_told_to_be_exchangeable():
    """137 ms behind a cart of nearly the same time constant: two orders have become one minimum, which lies between them."""
    random = np.random.default_rng([77, 6])
    lag = 0.025 * 6.0 ** random.random()
    u = random.uniform(-0.8, 0.8, len(ROBOT.parameters))
    parameters = {q.name: q.value * (1.0 + q.tolerance * x) for q, x in zip(ROBOT.parameters, u, strict=True)}
    made = (robot_records(s, {"sensor-lag@v": {"time": lag}}, samples=1500, records=1, parameters=parameters) for s in (12, 13))
    found = diagnose(ROBOT, *made)
    time = lag_of(found)
    assert time.low < lag < time.high
    assert any("change places" in note for note in found.notes)


@pytest.mark.parametrize(("lag", "seed"), [(0.15, 12), (0.15, 16), (0.165, 14)])
def test_two_orders_whose_times_are_near_to_each_other_are_both_told(lag, seed):
    """150 ms behind 130 ms or the other way round: one of the two was named with an interval that left the other out."""
    parameters = {"m1": 0.894, "m2": 2.052, "c": 4.54, "b1": 0.326, "b2": 0.353}
    made = (
        robot_records(s, {"sensor-lag@v": {"time": lag}}, samples=1500, records=1, parameters=parameters)
        for s in (seed, seed + 1)
    )
    found = diagnose(ROBOT, *made)
    time = lag_of(found)
    assert time.low < 0.135
    assert 0.98 * lag < time.high < 1.15 * lag
    assert any("change places" in note for note in found.notes)


def test_the_lag_of_the_robot_is_found_where_recalibration_has_bent_a_mass():
    def drawn(seed):
        u = np.random.default_rng(seed).uniform(-0.8, 0.8, len(ROBOT.parameters))
        return {q.name: q.value * (1.0 + q.tolerance * x) for q, x in zip(ROBOT.parameters, u, strict=True)}

    lag, parameters = {"sensor-lag@v": {"time": 0.05}}, drawn(1001)
    own, held = (robot_records(seed, lag, samples=1500, records=1, parameters=parameters) for seed in (5, 6))
    found = diagnose(ROBOT, own, held)
    assert lag_of(found).value == pytest.approx(0.05, rel=0.02)
    assert within_tolerance(found, ROBOT)
