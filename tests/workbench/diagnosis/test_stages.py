"""From the data sheet to the extended plant: each stage is the plant that it says, on the records that are shown."""

from dataclasses import replace

import numpy as np
import pytest

from tests.workbench.diagnosis.cases import ROBOT, robot_records
from workbench.diagnosis.answer import Diagnosis, Estimate, Finding
from workbench.diagnosis.calibrate import calibrate
from workbench.diagnosis.stages import stages

pytestmark = pytest.mark.slow

TRUE = {"m1": 1.1}
HIDDEN = {"coulomb@rail": {"level": 0.3, "width": 0.02}}


def found(parameters, effects):
    return Diagnosis(
        ROBOT.name, Finding.NAMED if effects else Finding.NOTHING, (), {"m1": Estimate(1.1, 1.0, 1.2, "kg", 1.0)}, (), (), (),
        None, effects, parameters, (), np.empty((0, 0)),
    )  # fmt: skip


def full_runs(at):
    return [(e.data_sheet, e.recalibrated, e.extended) for e in at.errors]


@pytest.fixture(scope="module")
def records():
    return robot_records(5, HIDDEN, samples=400, parameters=TRUE)


def test_every_stage_takes_its_part_off_the_error(records):
    held = robot_records(6, HIDDEN, samples=400, records=1, parameters=TRUE)
    at = stages(ROBOT, found(TRUE, HIDDEN), records, held)
    ((sheet, bare, extended),) = full_runs(at)
    assert extended < 0.3 * bare < bare < sheet
    assert extended == pytest.approx(ROBOT.noise["v"], rel=0.3)  # nothing is left but the noise of the reading
    assert [t.record for t in at.extended] == list(held.names)


def test_recalibrated_is_the_plant_whose_parameters_were_fitted_without_effects(records):
    """Not the plant with the parameters of the extension: these fit beside the effects only."""
    at = stages(ROBOT, found(TRUE, HIDDEN), records, records)
    plant = calibrate(ROBOT, records).plant
    again = stages(plant, replace(found({}, {}), parameters={}), records, records)
    np.testing.assert_allclose([e[1] for e in full_runs(at)], [e[0] for e in full_runs(again)], rtol=1e-9)


def test_without_an_effect_the_last_two_stages_are_one(records):
    at = stages(ROBOT, found(TRUE, {}), records, records)
    assert at.extended is at.recalibrated
    for sheet, bare, extended in full_runs(at):
        assert bare == extended != sheet


def test_a_plant_without_open_parameters_has_nothing_to_recalibrate(records):
    rigid = replace(ROBOT, parameters=tuple(replace(q, tolerance=0.0) for q in ROBOT.parameters))
    for sheet, bare, extended in full_runs(stages(rigid, found({}, HIDDEN), records, records)):
        assert sheet == bare > extended
