"""Limits of detection are those of a step of their own size, of an unstable machine above all."""

from dataclasses import replace

import numpy as np
import pytest

from tests.workbench.diagnosis.drive import DRIVE, records
from tests.workbench.diagnosis.maglev import GUARDED, record
from workbench.data import Dataset
from workbench.diagnosis.causes import limits_of, untestable_effects
from workbench.diagnosis.detection import holding
from workbench.diagnosis.diagnosis import _recalibrated
from workbench.diagnosis.growth import log_growth, unstable
from workbench.diagnosis.refit import Model
from workbench.diagnosis.screen import Signature, signatures, small_sizes, variants
from workbench.diagnosis.search import Search


def recalibrated(plant, dataset: Dataset) -> Model:
    return _recalibrated(plant, dataset, True, 1)


def searched(model: Model) -> list[Signature]:
    """The signatures that limits are stated from."""
    keys = dict.fromkeys(slot.key for slot in model.predictor.plant.slots)
    search = Search([*keys], np.zeros(len(model.predictor.plant.slots)), np.inf, lambda _: None)
    search.screened(model)
    return search.tested


@pytest.fixture(scope="module")
def drive() -> Model:
    return recalibrated(DRIVE, records(1, count=1, samples=600))


@pytest.fixture(scope="module")
def balls() -> dict[int, Model]:
    """Of records in which the noise of the sensors is all there is; the offset of the amplifier is 0.01 V."""
    return {n: recalibrated(GUARDED, Dataset((record(seed, n, offset=0.01),))) for seed, n in ((2, 600), (3, 1000))}


def test_growth_is_that_of_the_product_of_all_steps_in_their_order():
    random = np.random.default_rng(0)
    for N in (1, 6, 7):
        F, whole = random.standard_normal((N, 3, 3)), np.eye(3)
        for step in F:
            whole = step @ whole
        assert log_growth(F) == pytest.approx(np.log(np.abs(np.linalg.eigvals(whole)).max()))
    assert log_growth(np.full((3000, 1, 1), 2.0)) == pytest.approx(3000 * np.log(2.0))
    double = np.array([[1.0, 0.01], [0.0, 1.0]])  # what integrates does not run away
    assert log_growth(np.repeat(double[None], 40000, axis=0)) < 0.1


def test_a_filter_of_an_unstable_plant_keeps_a_push_that_it_corrects_by(balls, drive):
    for model in balls.values():
        assert unstable(model.predictor)
        assert (model.predictor.noise.process > 0.009 * model.predictor.expected.process).all()
        assert np.abs(model.fit.jacobian[0]).max() < 1e5  # 1e8 and more where nothing corrects
    assert not unstable(drive.predictor)


def test_a_limit_of_an_unstable_machine_is_no_millionth_of_a_volt(balls):
    """An offset of 0.01 V is no news to these records: sisters of theirs state 0.02 to 0.05 V."""
    for model in balls.values():
        limits = {f"{one.effect}@{one.place}": one.value for one in limits_of(GUARDED, searched(model))}
        assert 0.01 < limits["offset@U"] < 0.1
        assert limits["coulomb@ball"] > 1e-3
        assert 0.1 < limits["sensor-gain@cur"] < 0.25  # the tolerance of C takes it in, by way of a long bend


def test_limits_of_a_stable_machine_stand(drive):
    for s in searched(drive):
        if not s.is_level and s.responds:
            assert s.limit == pytest.approx(replace(s, checked=np.nan).limit) or s.limit == s.variant.finite


def test_a_limit_that_an_effect_of_its_size_does_not_bear_out_is_not_stated(drive):
    made, fit = drive.predictor, drive.fit
    keys = ["offset@U", "sensor-lag@n"]
    sizes = small_sizes(made, fit)
    tried = signatures(made, fit, variants(made, fit, keys, sizes), sizes)
    (offset,) = (s for s in tried if s.variant.key == keys[0])
    (right,) = holding(made, fit, [offset])
    assert right.limit == offset.limit
    for wrong in (0.1, 10.0):  # information that is not there, and mimicry that is not
        (found,) = holding(made, fit, [replace(offset, S=offset.S / wrong**2)])
        assert found.limit == np.inf
        (why,) = (u.why for u in untestable_effects(drive, [found]) if f"{u.effect}@{u.place}" == keys[0])
        assert why == "from which size on these records would show it is not known"
    lag = next(s for s in tried if s.variant.key == keys[1] and not np.isnan(s.variant.finite))
    (tried_itself,) = holding(made, fit, [replace(lag, S=100.0 * max(lag.S[0, 0], 30.0) * np.ones((1, 1)))])
    assert tried_itself.limit == lag.variant.finite
