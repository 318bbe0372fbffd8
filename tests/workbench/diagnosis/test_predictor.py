"""The predictor on the axis, where everything it does is known in matrices."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from tests.workbench.diagnosis.cases import (
    AXIS,
    READING,
    axis_by_hand,
    axis_matrices,
    axis_predictor,
    axis_records,
    noise,
)  # fmt: skip
from workbench import Parameter, Plant
from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis.predictor import UNTOLD, VISIBLE, Point, predictor
from workbench.errors import InputError
from workbench.physics.effects import Span

M, FV = AXIS.nominal


def axis_rates(memory=0.0):
    """d/dt of [q, v, angle] and of a sensor's lag, under a rate of v: (5, 5); memory is 1/time of the lag."""
    A = np.zeros((5, 5))
    A[0, 1], A[1, 1], A[2, 1], A[1, 4] = 1.0, -FV / M, 1.0, 1.0
    A[3, 0], A[3, 3] = memory, -memory
    return A


def coloured(made, level=0.05, memory=0.5):
    """The predictor with a coloured torque of that level."""
    return made.regained(made.point, replace(noise(), drift=np.array([level]), memory=memory))


def test_f_g_h_of_the_axis_are_those_of_the_matrix_exponential_and_a_coloured_push_fades_beside_them():
    line = coloured(axis_predictor(axis_records(1))).lines[0]
    exact = expm(AXIS.dt * axis_rates())
    push, still = exact[:3, 4:], np.zeros((3, 1))
    F = np.block([[exact[:3, :3], push], [np.zeros((1, 3)), np.array([[np.exp(-AXIS.dt / 0.5)]])]])
    np.testing.assert_allclose(line.F[50], F, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(line.G[50], np.block([[push, still], [0.0, 1.0]]), rtol=1e-5)
    np.testing.assert_allclose(line.H[50], [[1.0, 0.0, 0.0, 0.0]], atol=1e-9)


def test_errors_are_those_of_the_filter_that_carries_coloured_pushes_and_coloured_readings():
    """x+ = F (x + K e) + B u, e = y - H x, written out with the matrices of the axis."""
    made = axis_predictor(axis_records(7))
    levels = replace(noise(), drift=np.array([0.05]), memory=0.5, coloured=np.array([2e-4]), correlation_time=0.1)
    made = made.regained(made.point, levels)
    line, r, gain = made.lines[0], made.records[0], made.passes[0].gain
    decay = np.exp(-AXIS.dt / 0.1)
    np.testing.assert_allclose(line.H[50], [[1.0, 0.0, 0.0, 0.0, 1.0]], atol=1e-9)
    np.testing.assert_allclose(line.F[50][4], [0.0, 0.0, 0.0, 0.0, decay])
    np.testing.assert_allclose(line.F[50][:, 4], [0.0, 0.0, 0.0, 0.0, decay])
    np.testing.assert_allclose(line.G[50][4], [0.0, 0.0, 1.0])
    x, drive, e = np.zeros(5), np.zeros(5), np.zeros(len(r))
    x[: len(r.start)] = r.start
    drive[:2] = axis_matrices()[1]
    drive[2] = expm(AXIS.dt * axis_rates())[2, 4] / M
    for k, y in enumerate(r.seen[:, 0]):
        e[k] = 0.0 if np.isnan(y) else y - line.H[k, 0] @ x
        x = line.F[k] @ (x + gain[k, :, 0] * e[k]) + drive * r.u[k, 0]
    at = made.point
    errors = made.errors(0, at.p[None], at.eta[:1], at.start[:1], white=False)[0]
    np.testing.assert_allclose(errors[:, 0], e, rtol=1e-5, atol=1e-9)
    held = made.errors(0, at.p[None], at.eta[:1], at.start[:1], white=False, drift=False)[0]
    assert np.abs(held - errors).max() > READING  # without what is coloured it is another filter


def test_a_sensor_with_a_lag_is_read_by_its_memory_and_the_filter_carries_it():
    made = replace(axis_predictor(axis_records(1)), substeps=16)
    eta = np.repeat(AXIS.effect_vector({"sensor-lag@q": {"time": 0.05}})[None], 2, axis=0)
    made = made.regained(replace(made.point, eta=eta))
    exact = expm(AXIS.dt * axis_rates(1 / 0.05))
    line, lag = made.lines[0], 3
    assert len(made.carried) == 5
    np.testing.assert_allclose(line.H[50], [[0.0, 0.0, 0.0, 1.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose(line.F[50][lag, :4], exact[lag, :4], rtol=1e-2, atol=1e-6)
    np.testing.assert_allclose(line.F[50][:3, lag], 0.0, atol=1e-9)
    np.testing.assert_allclose(line.G[50][:4, :1], exact[:4, 4:], rtol=1e-2)


def test_f_follows_the_jacobian_of_the_plant_along_the_record_where_the_plant_is_not_linear():
    data = axis_records(2, {"quadratic-friction@slide": {"coefficient": 300.0}})
    made = axis_predictor(data)
    eta = np.repeat(AXIS.effect_vector({"quadratic-friction@slide": {"coefficient": 300.0}})[None], 2, axis=0)
    point = replace(made.point, eta=eta)
    made = made.regained(point, rounds=2)
    x, u = made.corrected(0, point)[:, :2], data.experiments[0][["F"]]
    wide = [np.repeat(v[None], len(x), axis=0) for v in (AXIS.nominal, eta[0])]
    A = AXIS.jacobians_of(x, u, *wide)[0]
    speeds = np.abs(x[:-1, 1])
    assert speeds.max() > 10 * speeds.min() + 0.5  # else a jacobian that is frozen would do
    for k in (int(np.argmax(speeds)), int(np.argmin(speeds))):
        # over a sample the speed itself changes a little: F is that of the whole sample
        np.testing.assert_allclose(made.lines[0].F[k][:2, :2], expm(AXIS.dt * A[k]), rtol=0.01, atol=1e-6)


def errors_at_truth(seed, levels=None):
    data = Dataset((axis_by_hand(lambda k, y: 300.0 * np.sign(np.sin(0.1 * k + seed)), seed),))
    made = axis_predictor(data)
    made = made.regained(made.point, levels or noise())
    return made.errors(0, AXIS.nominal[None], made.point.eta, np.zeros((1, 2)))[0, :, 0]


@pytest.mark.slow
def test_whitened_errors_are_white_with_unit_variance_when_the_noise_is_what_was_simulated():
    e = np.concatenate([errors_at_truth(seed) for seed in range(8)])
    N = len(e)
    assert np.mean(e**2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / N))
    lags = np.array([np.mean(e[j:] * e[:-j]) for j in range(1, 11)])
    assert np.abs(lags).max() < 4 / np.sqrt(N)
    # and neither holds for twice the push: the gain would be too large, the errors too small and coloured
    wrong = np.concatenate([errors_at_truth(seed, noise(push=2.0)) for seed in range(8)])
    assert np.mean(wrong**2) < 1 - 4 * np.sqrt(2 / N)
    assert abs(np.mean(wrong[1:] * wrong[:-1])) > 4 / np.sqrt(N)


def test_the_input_of_a_sample_does_not_touch_the_error_of_that_sample():
    made = axis_predictor(axis_records(3))
    r, at = made.records[0], (AXIS.nominal[None], made.point.eta[:1], made.point.start[:1])
    moved = r.u.copy()
    moved[40] += 500.0
    other = replace(made, records=(replace(r, u=moved), *made.records[1:]))
    change = other.errors(0, *at)[0] - made.errors(0, *at)[0]
    assert np.all(change[:41] == 0.0)
    assert abs(change[41, 0]) > 0.1


def test_hypotheses_side_by_side_give_what_each_gives_alone():
    made = axis_predictor(axis_records(4))
    random = np.random.default_rng(0)
    p = AXIS.nominal * np.exp(0.1 * random.standard_normal((3, 2)))
    eta = np.array([AXIS.effect_vector(e) for e in ({}, {"offset@F": {"level": 3.0}}, {"sensor-lag@q": {"time": 0.01}})])
    start = 0.1 * random.standard_normal((3, 2))
    together = made.errors(1, p, eta, start)
    for c in range(3):
        np.testing.assert_array_equal(together[c], made.errors(1, p[c : c + 1], eta[c : c + 1], start[c : c + 1])[0])


def test_the_errors_are_those_of_the_innovations_form_in_matrices_also_across_a_gap():
    made = axis_predictor(axis_records(5, start={"q": 0.2}))
    r = made.records[0]
    y = r.y.copy()
    y[30:60] = np.nan
    made = coloured(replace(made, records=(replace(r, y=y), made.records[1])))
    y = made.records[0].seen
    A, B = axis_matrices()
    push, fade = expm(AXIS.dt * axis_rates())[:2, 4], np.exp(-AXIS.dt / 0.5)
    start, gain = made.point.start[0], made.passes[0].gain[:, :, 0]
    x, d, expected = start.copy(), 0.0, []
    for k in range(len(r)):
        e = 0.0 if np.isnan(y[k, 0]) else y[k, 0] - x[0]
        d += gain[k, 3] * e
        x = A @ (x + gain[k, :2] * e) + B * r.u[k, 0] + push * d
        d *= fade
        expected.append(e)
    found = made.errors(0, AXIS.nominal[None], made.point.eta[:1], start[None], white=False)[0, :, 0]
    assert np.abs(gain[100:, 3]).max() > 1.0  # the coloured push takes part
    np.testing.assert_allclose(found, expected, atol=2e-8)  # 1e-4 of the noise: one integrator step a sample
    assert np.all(gain[30:60] == 0.0)
    assert made.samples == 600 - 30 - 2 * UNTOLD


def test_a_record_with_another_sample_time_is_predicted_at_its_own():
    data = axis_records(7, plant=replace(AXIS, dt=0.01))
    made = predictor(AXIS, data)
    assert made.plant.dt == 0.01
    A, _ = axis_matrices(0.01)
    np.testing.assert_allclose(made.lines[0].F[9][:2, :2], A, rtol=1e-6, atol=1e-9)


def test_the_start_is_taken_from_the_first_measured_sample_where_it_can_be_and_is_open_where_not():
    made = predictor(AXIS, axis_records(8, start={"q": 0.4, "v": -0.3}))
    q, v = made.records[0].start
    assert q == pytest.approx(0.4, abs=2e-3)
    assert v == 0.0
    assert made.records[0].scale[1] >= 0.3  # nothing measures it at once


def test_process_noise_enters_where_something_slides_or_where_an_input_acts():
    assert predictor(AXIS, axis_records(9)).entries == ("v",)
    bare = replace(AXIS, ports=(), equation=lambda x, u, p, at: {"q": x.v, "v": (u.F - p.Fv * x.v) / p.M})
    from workbench.diagnosis.starts import entry_states

    assert entry_states(bare) == (("v",), 1)


@pytest.mark.parametrize("substeps", [1, 2, 8])
def test_as_many_integrator_steps_as_the_errors_ask_for_whatever_the_plant_says(substeps):
    light = replace(AXIS, parameters=(replace(AXIS.parameters[0], value=2.0), AXIS.parameters[1]), substeps=substeps)
    data = axis_records(1, parameters={"M": 2.0}, samples=200)
    made = predictor(light, data)
    at = (light.nominal[None], made.point.eta[:1], made.point.start[:1])
    half, coarse = (replace(made, substeps=s).errors(0, *at) for s in (2 * made.substeps, made.substeps - 1))
    now = made.errors(0, *at)
    assert np.sum((now - half) ** 2) < 1.2 * VISIBLE
    assert np.sum((coarse - half) ** 2) > 0.5 * VISIBLE  # else it costs more than it must


def test_the_record_that_asks_for_most_integrator_steps_decides():
    still, moved = axis_records(1, samples=200).experiments[0], axis_records(2, samples=200).experiments[0]
    still = replace(still, values=np.column_stack([0.0 * still["F"], still["q"][0] + 0.0 * still["q"]]))
    light = replace(AXIS, parameters=(replace(AXIS.parameters[0], value=0.5), AXIS.parameters[1]), substeps=4)
    alone = predictor(light, Dataset((moved,))).substeps
    assert alone > predictor(light, Dataset((still,))).substeps
    assert predictor(light, Dataset((still, moved))).substeps == alone


def test_records_that_cannot_be_predicted_are_refused_with_their_place_and_the_mend():
    good = axis_records(1).experiments[0]
    no_force = replace(good, channels=(Channel("G", "N", "input"), good.channels[1]))
    no_output = replace(good, channels=(good.channels[0], Channel("z", "m", "output")))
    late = good.t.copy()
    late[100:] += 0.5
    for bad, says in ((no_force, "channel 'F'"), (no_output, "none of the outputs q"), (replace(good, t=late), "trim")):
        with pytest.raises(InputError, match=says) as raised:
            predictor(AXIS, Dataset((bad,)))
        assert "axis 0" in str(raised.value)


def test_a_point_holds_one_row_of_effects_and_of_starts_for_every_record():
    with pytest.raises(ValueError, match="Point"):
        Point(AXIS.nominal, np.zeros((2, 5)), np.zeros((3, 2)))


def test_the_tension_of_a_span_is_pushed_by_what_nobody_logged_whatever_its_place_is_called():
    def belt(place):
        def equation(x, u, p, at):
            rate = getattr(at, place).rate(x.v, p.k, 10.0)
            return {"v": (u.F - x.T) / p.m, "T": p.k * x.v - x.T + rate}

        return Plant(
            name="belt",
            states=(Channel("v", "m/s"), Channel("T", "N")),
            inputs=(Channel("F", "N", "input"),),
            outputs=(Channel("T", "N", "output"),),
            parameters=(Parameter("m", 2.0, "kg"), Parameter("k", 50.0, "N/m")),
            equation=equation,
            measure=lambda x, p: {"T": x.T},
            dt=0.01,
            ports=(Span(place, "T"),),
            noise={"T": 0.1},
        )

    t = 0.01 * np.arange(200)
    values = np.column_stack([np.sin(t), np.zeros(200)])
    own = Dataset((Experiment("r", t, (Channel("F", "N", "input"), Channel("T", "N", "output")), values, 0.01),))
    assert predictor(belt("web"), own).entries == predictor(belt("T"), own).entries == ("v", "T")
    assert len(predictor(belt("web"), own).noise.drift) == 1  # of what the input drives, not of the tension


def test_an_input_without_a_slope_where_the_plant_rests_drives_nothing():
    """The root of a pressure difference has none at 0: no number of noise becomes a hole."""
    plant = Plant(
        name="leak",
        states=(Channel("p", "Pa"),),
        inputs=(Channel("dp", "Pa", "input"),),
        outputs=(Channel("y", "Pa", "output"),),
        parameters=(Parameter("c", 2.0, "1", tolerance=0.1), Parameter("k", 1.0, "1/s", tolerance=0.1)),
        equation=lambda x, u, p, at: {"p": p.c * np.sign(u.dp) * np.sqrt(np.abs(u.dp)) - p.k * x.p},
        measure=lambda x, p: {"y": x.p},
        dt=0.05,
        noise={"y": 0.01},
    )
    t = 0.05 * np.arange(400)
    e = Experiment.from_arrays("r", 0.05, inputs={"dp": np.sin(t)}, outputs={"y": 0.5 * np.sin(t)})
    made = predictor(plant, Dataset((e,)))
    assert np.isfinite(made.noise.process).all()
    assert np.isfinite(made.at(made.point)[0]).all()
