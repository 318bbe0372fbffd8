"""FIT, RM and RMSE against their equations; scores on the rows they claim."""

import json

import numpy as np
import pytest

from workbench.basis import CONSTANT
from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.lpv import OperatingPoint, Predictor, constant_model
from workbench.metrics import fit, noise_ceiling, rm, rmse, score, to_json, tracking


def test_the_equations_on_numbers_worked_by_hand():
    y, ys = np.array([0.0, 2.0, 4.0, 2.0]), np.array([0.0, 2.0, 3.0, 3.0])
    # y - mean = -2 0 2 0: norms sqrt(8) and 2; error 0 0 1 -1: norms sqrt(2) and 1
    assert fit(y, ys) == pytest.approx(50.0)
    assert rm(y, ys) == pytest.approx(50.0)
    assert rmse(y, ys) == pytest.approx(np.sqrt(0.5))


def test_perfect_is_100_the_mean_is_0_and_units_do_not_matter():
    y = np.random.default_rng(0).standard_normal(50) + 7
    assert fit(y, y) == 100.0
    assert fit(y, np.full(50, y.mean())) == pytest.approx(0.0)
    ys = y + 0.1
    assert fit(1e3 * y - 5, 1e3 * ys - 5) == pytest.approx(fit(y, ys))
    assert rm(1e3 * y - 5, 1e3 * ys - 5) == pytest.approx(rm(y, ys))


def test_a_diverged_simulation_scores_minus_infinity_without_a_warning():
    y = np.arange(5.0)
    for bad in (np.inf, np.nan):
        assert fit(y, np.array([0, 1, bad, 3, 4])) == -np.inf
        assert rm(y, np.array([0, 1, bad, 3, 4])) == np.inf
    assert np.isfinite(fit(y, np.full(5, 1e200)))


@pytest.mark.parametrize("value", [3.0, 0.1, -1e9 / 3.0, 1e-200 / 3.0, 0.0])
@pytest.mark.parametrize("N", [1, 7, 10])
def test_a_constant_output_is_refused(value, N):
    """Also where the mean of equal numbers is rounded, and is none of them."""
    with pytest.raises(InputError, match="constant"):
        fit(np.full(N, value), np.zeros(N))


@pytest.mark.parametrize("shapes", [((5,), (1,)), ((5,), (4,)), ((5, 1), (5, 1))])
def test_what_is_no_pair_of_channels_is_not_compared(shapes):
    y, ys = (np.arange(float(np.prod(shape))).reshape(shape) for shape in shapes)
    for measure in (fit, rm):
        with pytest.raises(InputError, match="two channels of one length"):
            measure(y, ys)


def test_tracking_on_numbers_worked_by_hand():
    assert tracking(np.array([3.0, -4.0, 0.0, 0.0]), 0.5) == {"RMS": 2.5, "max": 4.0, "IAE": 3.5}


def test_the_noise_ceiling_is_what_the_truth_scores():
    random = np.random.default_rng(1)
    clean = np.sin(np.arange(20000) / 10)
    y = clean + 0.2 * random.standard_normal(20000)
    assert noise_ceiling(y, 0.2) == pytest.approx(fit(y, clean), abs=0.3)


def lag(a=0.9, warmup=20, gain=0.5):
    """y(k+1) = a y(k) + u(k) with an observer."""
    point = OperatingPoint(CONSTANT, np.zeros((1, 1)), np.zeros((1, 1)))
    predictor = Predictor(np.array([[[a - gain]]]), np.ones((1, 1, 1)), np.full((1, 1, 1), gain), warmup)
    channels = ((Channel("u", "V", "input"),), (Channel("y", "m", "output"),))
    matrices = [np.array([[v]]) for v in (a, 1.0, 1.0, 0.0)]
    return constant_model("lag", 0.1, channels, matrices, point, predictor=predictor)


def record_of(y, u, name="r"):
    return Dataset((Experiment.from_arrays(name, 0.1, inputs={"u": u}, outputs={"y": y}, units={"y": "m"}),))


def run(N=200, noise=0.0):
    random = np.random.default_rng(2)
    u, e = random.standard_normal((2, N))
    y = np.zeros(N)
    for k in range(N - 1):
        y[k + 1] = 0.9 * y[k] + u[k]
    return y + noise * e, u


def test_every_horizon_is_scored_on_the_same_rows_after_the_warm_up():
    y, u = run()
    y[:20] += 1e3 * (np.arange(20) < 10)  # garbage that the predictor forgets: 0.4^10 of it remains
    scores = score(lag(), record_of(y, u), "held-out", ("free-run", "one-step", 3))
    assert [s.horizon for s in scores] == ["free-run", "one-step", 3]
    assert all(s.split == "held-out" and s.output == "y" and s.unit == "m" for s in scores)
    model = lag()
    for s, ys in zip(scores, (model.simulate(record_of(y, u).experiments[0]), None, None), strict=True):
        if ys is not None:
            assert fit(y[20:], ys[20:, 0]) == s.FIT
    assert fit(y[20:], model.predict(record_of(y, u).experiments[0], 3)[20:, 0]) == scores[2].FIT


def test_white_measurement_noise_is_the_rmse_of_the_true_free_run():
    y, u = run(N=5000, noise=0.3)
    (s,) = score(lag(gain=0.02, warmup=300), record_of(y, u), "estimation", ["free-run"])
    assert pytest.approx(0.3, rel=0.05) == s.RMSE
    assert pytest.approx(noise_ceiling(y[300:], 0.3), abs=0.5) == s.FIT


def test_the_scores_file_has_the_agreed_keys_and_no_nan(tmp_path):
    y, u = run(N=1500)
    model = lag(a=3.0, warmup=2)
    scores = score(model, record_of(y, u), "held-out", ["free-run"])
    assert -np.inf == scores[0].FIT
    content = to_json([(model, "lag.json", scores)], {"seed": 1})
    text = json.loads(json.dumps(content, allow_nan=False))
    assert set(text) == {"models", "provenance"}
    assert set(text["models"][0]) == {"model", "file", "order", "scores"}
    keys = {"record", "split", "output", "horizon", "FIT", "RM", "RMSE", "unit"}
    assert set(text["models"][0]["scores"][0]) == keys
    assert text["models"][0]["scores"][0]["FIT"] is None


def test_short_records_and_strange_horizons_are_refused():
    y, u = run(N=21)
    with pytest.raises(InputError, match="warm-up"):
        score(lag(), record_of(y, u), "held-out")
    y, u = run(N=22)
    assert len(score(lag(), record_of(y, u), "held-out")) == 3  # two rows are left
    y, u = run()
    with pytest.raises(InputError, match="horizon"):
        score(lag(), record_of(y, u), "held-out", [0])
