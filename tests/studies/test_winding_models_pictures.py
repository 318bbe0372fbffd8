"""The curves in the report's pictures are those their captions name."""

import numpy as np
import pytest

from plants import WEB_WINDING
from plants.web_winding import frozen_machine
from studies.winding_models import true_coefficients
from workbench.lpv import load_model


@pytest.fixture
def drawn(winding_study):
    """What the study hands to the two figures that show the truth, and the model that was drawn."""
    return winding_study[3], load_model(winding_study[0] / "ssm.json")


def test_coefficient_curves_carry_the_names_of_their_signals(drawn):
    (schedule, curves), model = drawn[0]["coefficients"], drawn[1]
    B = model.freeze(schedule.values[3])[1]
    for i in range(model.order):
        for j, name in enumerate(("V1", "V2")):
            assert curves[f"{name}(k-{i + 1})"].identified[3] == pytest.approx(B[i, j])


def test_the_frozen_response_is_from_v2(drawn):
    omega, radius, curves, _ = drawn[0]["frozen"]
    A, B, C = frozen_machine(radius.values[0])
    gain = (C @ np.linalg.solve(np.exp(1j * omega[0] * WEB_WINDING.dt) * np.eye(5) - A, B))[0]
    assert curves["machine"][0][0] == pytest.approx(20 * np.log10(abs(gain[1])))
    assert abs(gain[0]) != pytest.approx(abs(gain[1]), rel=0.1)


def test_the_truth_shown_is_what_least_squares_find_in_noise():
    random = np.random.default_rng(0)
    u, noise, r2, n = random.normal(size=(60000, 2)), 0.3, 0.018, 3
    A, B, C = frozen_machine(r2)
    x, y = np.zeros(5), np.empty(len(u))
    for k in range(len(u)):
        y[k], x = (C @ x)[0], A @ x + B @ u[k]
    y += noise * random.normal(size=len(y))
    k = np.arange(n, len(u))
    past = [y[k - i] for i in range(1, n + 1)] + [u[k - i, j] for i in range(1, n + 1) for j in (0, 1)]
    found = np.linalg.lstsq(np.column_stack(past), y[n:], rcond=None)[0]
    shown = true_coefficients(np.array([r2]), n, u, noise)[0]
    np.testing.assert_allclose(shown, found, atol=0.02 * np.abs(found).max())
