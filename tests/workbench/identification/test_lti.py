"""One LTI model for all records: the chosen order, the operating point, honest spreads, and warnings in plain words."""

import dataclasses

import numpy as np
import pytest

from workbench.data import Dataset, Experiment
from workbench.identification import METHODS
from workbench.identification.lti import LTI
from workbench.identification.subspace import N4SID
from workbench.lpv import LPVModel, load_model
from workbench.metrics import noise_ceiling, score
from workbench.residuals import residual_test

POLES = (0.9, 0.6)


def run(seed, N=1000, noise=0.3, poles=POLES, feedback=0.0, u0=2.0, y0=50.0):
    """y = y0 + G (u - u0) + e, G(1) = sum of 0.2/(1 - p): two first-order lags in parallel, white noise at the output."""
    random = np.random.default_rng(seed)
    x, u, y = np.zeros(2), np.zeros(N), np.zeros(N)
    for k in range(N):
        y[k] = x.sum() + noise * random.standard_normal()
        u[k] = random.choice([-1.0, 1.0]) - feedback * (y[k] + y[max(k - 1, 0)])
        x = np.array(poles) * x + 0.2 * u[k]
    arrays = {"inputs": {"u": u + u0}, "outputs": {"y": y + y0}}
    return Experiment.from_arrays(f"run {seed}", 0.5, **arrays, units={"u": "V", "y": "rad/s"})


@pytest.fixture(scope="module")
def model():
    return LTI().fit(Dataset((run(1), run(2))))


def test_the_order_is_the_systems_and_the_note_shows_why(model):
    assert model.order in (1, 2)
    assert isinstance(model, LPVModel)
    assert "singular values stand above the noise" in model.notes[0]
    assert "2: " in model.notes[0]


def test_the_smallest_order_near_the_best_is_taken():
    records = Dataset((run(1), run(2)))
    tried = LTI().sweep(records)
    best = max(c.FIT for c in tried)
    assert LTI(resamples=0).fit(records).order == min(c.order for c in tried if best - 0.5 <= c.FIT)


def test_the_free_run_reaches_what_the_noise_allows(model):
    record = run(11, N=3000)
    (s,) = score(model, Dataset((record,)), "held-out", ["free-run"])
    ceiling = noise_ceiling(record["y"], 0.3)
    assert ceiling - 3 < s.FIT < ceiling + 1.5


def test_the_operating_point_is_an_equilibrium_of_the_machine(model):
    u0, y0 = model.operating_point.u[0, 0], model.operating_point.y[0, 0]
    gain = sum(0.2 / (1 - p) for p in POLES)
    assert y0 - 50.0 == pytest.approx(gain * (u0 - 2.0), abs=0.15)


def test_residuals_pass_on_a_held_out_record(model):
    assert residual_test(model, run(13, N=2000)).passed


@pytest.mark.slow
def test_the_spreads_are_those_of_repeated_experiments():
    """Standard deviation over 30 fresh experiments against what each of them reports."""
    found = [LTI(order=2, resamples=30).fit(Dataset((run(s, N=800),))).estimates for s in range(30)]
    for i, name in ((0, "DC gain u to y"), (1, "modulus of the slowest pole")):
        assert found[0][i].name == name
        actual = np.std([estimates[i].value for estimates in found])
        claimed = np.median([estimates[i].std for estimates in found])
        assert 0.6 < claimed / actual < 1.6
    assert found[0][0].unit == "(rad/s)/V"
    assert np.mean([e[0].value for e in found]) == pytest.approx(sum(0.2 / (1 - p) for p in POLES), rel=0.03)


def test_an_unstable_model_says_so_in_plain_words():
    model = LTI(order=2, resamples=0).fit(Dataset((run(1, N=400, poles=(1.01, 0.5), feedback=0.15, noise=0.05),)))
    assert any(note.startswith("unstable") for note in model.notes)
    assert not model.stability().stable


@pytest.mark.slow
def test_n4sid_is_warned_about_in_closed_loop_only():
    closed, opened = Dataset((run(1, feedback=0.4, N=8000),)), Dataset((run(1, N=8000),))
    with_n4sid = LTI(order=2, method=N4SID(), resamples=0)
    assert any("use PBSID" in note for note in with_n4sid.fit(closed).notes)
    assert not any("use PBSID" in note for note in with_n4sid.fit(opened).notes)
    assert not any("use PBSID" in note for note in LTI(order=2, resamples=0).fit(closed).notes)


def test_a_file_brings_the_same_model_back(model, tmp_path):
    model.save(tmp_path / "lti.json")
    record = run(5, N=200)
    np.testing.assert_array_equal(load_model(tmp_path / "lti.json").simulate(record), model.simulate(record))


def test_the_same_records_give_the_same_model(model):
    again = LTI().fit(Dataset((run(1), run(2))))
    assert [vars(e) for e in again.estimates] == [vars(e) for e in model.estimates]


def test_the_registry_names_frozen_methods():
    assert {"lti", "ilm"} <= set(METHODS)
    for method in METHODS.values():
        options = method()
        with pytest.raises(dataclasses.FrozenInstanceError):
            options.order = 3
