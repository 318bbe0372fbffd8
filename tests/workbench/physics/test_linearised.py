"""The linear model of a plant against small motions of the plant itself."""

from dataclasses import replace

import numpy as np
import pytest

from plants import POSITIONING_AXIS, WELDING_ROBOT
from tests.controllers.test_designs import free_mass
from workbench.data import Channel, Experiment
from workbench.errors import InputError
from workbench.physics.identified import identified
from workbench.physics.linearised import linearised
from workbench.physics.plant import Plant
from workbench.simulation import replay

AXIS = POSITIONING_AXIS.sampled(0.004)


def answers(plant: Plant, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Outputs (N, ny) of the plant and of its linear model, less those at rest, under the same small steps of every input."""
    model = linearised(plant)
    u0 = model.operating_point.u[0]
    random, N = np.random.default_rng(3), 300
    u = size * np.repeat(random.normal(size=(N // 20, len(u0))), 20, axis=0)
    channels = tuple(Channel(c.name, c.unit, "input") for c in plant.inputs)
    run = replay(plant, Experiment("steps", plant.dt * np.arange(N), channels, u + u0, plant.dt)).experiment
    A, B, C, D = (M[0] for M in (model.A, model.B, model.C, model.D))
    state, y = np.zeros(len(A)), []
    for now in u:
        y.append(C @ state + D @ now)
        state = A @ state + B @ now
    return run[list(plant.output_names)] - model.operating_point.y[0], np.array(y)


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"input-delay@F": {"time": 0.0031}},
        {"input-delay@F": {"time": 0.008}},
        {"input-delay@F": {"time": 0.0135}, "sensor-lag@q": {"time": 0.011}},
        {"sensor-lag@q": {"time": 0.03}, "quadratic-friction@slide": {"coefficient": 1e-3}},
        {"sensor-gain@q": {"error": 0.4}, "sensor-lag@q": {"time": 0.03}, "sensor-bias@q": {"level": 0.2}},
        {"sensor-nonlinearity@q": {"curvature": 0.01, "centre": 20.0}, "sensor-gain@q": {"error": -0.2}},
        {"offset@F": {"level": 5.0}},
    ],
)
def test_small_motions_are_those_of_the_plant(effects):
    measured, linear = answers(replace(AXIS, effects=effects), 1.0)
    assert np.abs(measured - linear).max() < 2e-5 * np.ptp(measured)


def test_friction_at_rest_has_no_slope():
    """At v = 0 the slope of a level of 22 N over 1 mm/s would be 22 000 N s/m: the axis would be taken for one that creeps."""
    rubbed = replace(AXIS, effects={"coulomb@slide": {"level": 22.0, "width": 1e-3}})
    np.testing.assert_allclose(linearised(rubbed).A, linearised(AXIS).A)


def test_it_is_sampled_as_asked_and_has_the_channels_and_noise_of_the_plant():
    model = linearised(replace(AXIS, noise={"q": 2e-6}), 0.01)
    assert (model.dt, model.inputs[0].unit, model.outputs[0].name) == (0.01, "N", "q")
    np.testing.assert_allclose(model.noise, [[4e-12]])
    M, Fv = AXIS.nominal
    np.testing.assert_allclose(model.A[0, 1, 1], np.exp(-Fv / M * 0.01))


def test_what_has_no_linear_model_is_refused():
    with pytest.raises(InputError, match="it is a model already"):
        linearised(identified(free_mass()))
    with pytest.raises(InputError, match="it moves on its own"):
        linearised(WELDING_ROBOT)
    with pytest.raises(InputError, match="sensor-resonance@q is not in the linear model"):
        linearised(replace(AXIS, effects={"sensor-resonance@q": {"time": 0.01}}))
    with pytest.raises(InputError, match="sensor-resonance@q is not in the linear model"):
        linearised(replace(AXIS, effects={"sensor-resonance@q": {"time": 0.01}}))


def test_what_nobody_controls_is_no_output_of_the_linear_model():
    """A tacho beside a position is logged, and one input cannot move both on its own."""
    tacho = Channel("w", "m/s", "other")
    both = replace(AXIS, outputs=(*AXIS.outputs, tacho), measure=lambda x, p: {"q": x.q, "w": x.v})
    own, alone = linearised(both), linearised(AXIS)
    assert [c.name for c in own.outputs] == ["q"]
    np.testing.assert_array_equal(own.C, alone.C)
    np.testing.assert_array_equal(own.A, alone.A)
