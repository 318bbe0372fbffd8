"""What records leave open of a model's one-step error: exact boxes, the truth inside, smaller with every record."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog

from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.identification.lti import LTI
from workbench.intervals.errors import ERROR_OF, ErrorRegression, one_step_errors, open_box
from workbench.intervals.model import load_interval_model
from workbench.intervals.regressors import FIR, samples

BOUND = 0.3


def a_record(name, z, e):
    """Two regressors and an error, as one-step errors would be."""
    channels = (Channel("y", "m", "input"), Channel("u", "V", "input"), Channel(ERROR_OF + "y", "m", "output"))
    return Experiment(name, 0.1 * np.arange(len(e)), channels, np.column_stack([z, e]), 0.1)


def regression(dataset):
    return samples(FIR(1), dataset, ERROR_OF + "y", ["y", "u"])


def drawn(seed, N=200, theta=(0.2, -0.5)):
    """e(k) = theta'z(k-1) + n(k), |n| < BOUND."""
    random = np.random.default_rng(seed)
    z = random.normal(size=(N, 2)) * [3.0, 0.5]
    n = random.uniform(-BOUND, BOUND, N)
    e = n.copy()
    e[1:] += z[:-1] @ theta
    return a_record(f"r{seed}", z, e)


def test_one_parameter_is_the_meeting_of_the_intervals_of_its_samples():
    """|e - theta z| <= bound is (e -+ bound) / z: the box is from the largest lower to the smallest upper end."""
    u = np.array([1.0, -2.0, 0.5, 4.0, 0.0])
    y = np.array([1.0, -1.0, 1.0, -1.0, 1.0])  # its sign changes while u is 0 or not: theta_y is met by the last sample alone
    e = np.array([0.0, 0.7, -1.2, 0.4, 2.3])
    S = regression(Dataset((a_record("one", np.column_stack([0.0 * y + [0, 0, 0, 0, 1.0], u]), e),)))
    with pytest.raises(InputError, match="never moves"):
        open_box(S, BOUND)  # what moves at the last sample only is no regressor of any
    S = regression(Dataset((a_record("one", np.column_stack([[0.0, 0.0, 1.0, 0.0, 0.0], u * [1, 1, 0, 1, 1]]), e),)))
    box = open_box(S, BOUND)  # rows: 0.7 of u=1, -1.2 of u=-2, 0.4 of y=1, 2.3 of u=4
    low, high = max(0.7 - 0.3, (1.2 - 0.3) / 2, (2.3 - 0.3) / 4), min(0.7 + 0.3, (1.2 + 0.3) / 2, (2.3 + 0.3) / 4)
    np.testing.assert_allclose(box.centre, [0.4, 0.5 * (low + high), 0.0], atol=1e-5)
    np.testing.assert_allclose(box.radius, [0.3, 0.5 * (high - low), BOUND], atol=1e-5)


@pytest.mark.parametrize("seed", range(5))
def test_the_truth_is_in_the_box_and_the_box_is_that_of_another_solver(seed):
    S = regression(Dataset((drawn(seed),)))
    box = open_box(S, BOUND)
    assert np.all(np.abs(box.centre[:2] - [0.2, -0.5]) <= box.radius[:2])
    z = S.z[:, :2]
    for i in range(2):
        for sign in (1.0, -1.0):
            answer = linprog(
                sign * np.eye(2)[i], A_ub=np.vstack([z, -z]), b_ub=np.concatenate([S.y, -S.y]) + BOUND, bounds=(None, None)
            )
            end = box.centre[i] - sign * box.radius[i]
            assert end == pytest.approx(sign * answer.fun, abs=1e-5)
            assert sign * end <= answer.fun  # on the far side


def test_a_further_record_only_takes_away():
    boxes = [open_box(regression(Dataset(tuple(drawn(seed) for seed in range(count)))), BOUND) for count in (1, 2, 4)]
    for wide, narrow in itertools.pairwise(boxes):
        assert np.all(narrow.centre - narrow.radius >= wide.centre - wide.radius - 1e-9)
        assert np.all(narrow.centre + narrow.radius <= wide.centre + wide.radius + 1e-9)
    assert np.all(boxes[2].radius[:2] < boxes[0].radius[:2])


def test_a_bound_that_no_parameter_keeps_is_refused():
    S = regression(Dataset((drawn(1),)))
    with pytest.raises(InputError, match=r"no error model keeps the bound 0\.1"):
        open_box(S, 0.1)
    with pytest.raises(InputError, match="bound 0"):
        open_box(S, 0.0)


# ---- on a model ----------------------------------------------------------------------------------------------------


def measured(seed, gain=1.0, N=600):
    """x+ = 0.8 x + 0.5 gain u around (u0, y0) = (1, 4), y = x + noise."""
    random = np.random.default_rng(seed)
    u, x, y = random.choice([-1.0, 1.0], N).repeat(3)[:N], 0.0, np.empty(N)
    for k in range(N):
        y[k] = x + 0.02 * random.uniform(-1, 1)
        x = 0.8 * x + 0.5 * gain * u[k]
    channels = (Channel("u", "V", "input"), Channel("y", "m", "output"))
    return Experiment(f"m{seed}", 0.1 * np.arange(N), channels, np.column_stack([u + 1.0, y + 4.0]), 0.1)


@pytest.fixture(scope="module")
def fitted():
    return LTI(order=1).fit(Dataset((measured(1), measured(2))))


def test_errors_are_those_of_the_models_own_prediction(fitted):
    e = one_step_errors(fitted, measured(3))
    own = measured(3)
    kept = slice(fitted.warmup, None)
    np.testing.assert_array_equal(e[ERROR_OF + "y"], (own["y"] - fitted.predict(own)[:, 0])[kept])
    np.testing.assert_allclose(e["u"] - own["u"][kept], e["u"][0] - own["u"][fitted.warmup], atol=1e-12)  # less one constant
    assert abs(e["u"].mean()) < 0.3


def test_the_box_holds_what_a_machine_of_another_gain_does(fitted):
    """Records of a machine whose input gain is 10 % higher: that much more of u is in the box, and no errors is not."""
    (own,) = ErrorRegression(bound=(0.05,)).fit(fitted, Dataset((measured(5, gain=1.1), measured(6, gain=1.1))))
    names = [c.name for c in own.inputs]
    box = own.modes[0].box
    at = names.index("u")
    assert abs(0.05 - box.centre[at]) <= box.radius[at]  # 0.1 of 0.5: what a volt more does within a sample
    assert abs(box.centre[at]) > box.radius[at]
    (same,) = ErrorRegression(bound=(0.05,)).fit(fitted, Dataset((measured(5), measured(6))))
    assert abs(same.modes[0].box.centre[at]) < same.modes[0].box.radius[at]


def test_every_measured_error_lies_in_the_one_step_envelope(fitted):
    records = Dataset((measured(3), measured(4)))
    (own,) = ErrorRegression().fit(fitted, records)
    for e in records:
        assert own.one_step(one_step_errors(fitted, e)).coverage == 1.0
    assert own.modes[0].box.radius[-1] == pytest.approx(
        max(np.abs(one_step_errors(fitted, e)[ERROR_OF + "y"][1:]).max() for e in records), rel=1e-12
    )


def test_a_saved_model_is_the_same(fitted, tmp_path):
    (own,) = ErrorRegression().fit(fitted, Dataset((measured(3),)))
    own.save(tmp_path / "e.json")
    again = load_interval_model(tmp_path / "e.json")
    np.testing.assert_array_equal(again.modes[0].box.radius, own.modes[0].box.radius)
    np.testing.assert_array_equal(again.modes[0].box.centre, own.modes[0].box.centre)
    assert vars(again.output) == vars(own.output)
    assert again.semantics.promise.startswith("every constant parameter")


def test_what_does_not_fit_is_refused(fitted):
    with pytest.raises(InputError, match="2 bounds for 1 outputs"):
        ErrorRegression(bound=(1.0, 2.0)).fit(fitted, Dataset((measured(3),)))
    own = measured(3)
    gap = own.t + 5.0 * (np.arange(len(own)) > 300)
    with pytest.raises(InputError, match="cut the record"):
        ErrorRegression().fit(fitted, Dataset((replace(own, t=gap),)))


def test_possible_parameters_are_refuted_by_no_sample_and_reach_the_ends_of_the_box(fitted):
    """The box's own corners are refuted; what is called possible is not, and comes to every end of the box."""
    records = Dataset((measured(3), measured(4)))
    method = ErrorRegression()
    errors = method.fit(fitted, records)
    shares = method.possible(fitted, records, errors, count=400)
    box = errors[0].modes[0].box
    S = samples(FIR(1), Dataset(tuple(one_step_errors(fitted, e) for e in records)), ERROR_OF + "y", ["y", "u"])
    z = S.z[:, :2]

    def largest(share):
        return np.abs(S.y - z @ (box.centre[:2] + share[:2] * box.radius[:2])).max()

    bound = box.radius[2]
    assert max(largest(share) for share in shares) <= bound * (1.0 + 1e-9)
    assert max(largest(np.array(corner)) for corner in itertools.product([-1.0, 1.0], repeat=2)) > 1.005 * bound
    np.testing.assert_allclose(shares[:, :2].max(axis=0), 1.0, atol=1e-3)
    np.testing.assert_allclose(shares[:, :2].min(axis=0), -1.0, atol=1e-3)
    np.testing.assert_allclose(shares[0, :2], -box.centre[:2] / box.radius[:2])  # the model as it is
    assert not shares[:, 2].any()
