"""The scan finds the order and the frequency that were put in, and its push is the gradient that it says."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.workbench.diagnosis.cases import AXIS, axis_records, fitted
from workbench import Parameter, Plant
from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis.diagnosis import diagnose
from workbench.diagnosis.kalman import response
from workbench.diagnosis.scan import PEAKS, Scan, latent_push, scan_frequencies, scan_orders, turned
from workbench.diagnosis.screen import variants
from workbench.physics.effects import Shaft, Span

ORDERS = np.arange(2.0, 25.0)


def test_the_latent_push_is_the_gradient_of_half_the_squared_errors_over_a_push_at_every_sample():
    model = fitted(axis_records(1, {"coulomb@slide": {"level": 20.0}}, samples=60, start={"v": 0.3}))
    made, fit = model.predictor, model.fit
    for i, line in enumerate(made.lines):
        N, _, n = line.H.shape
        push = np.zeros((N, n, N))
        for k in range(N):
            push[k, :, k] = line.G[k, :, made.entries.index("v")]
        white = np.einsum("kij,kjc->kic", made.passes[i].whitening, response(line, made.passes[i].gain, push))
        expected = np.einsum("kic,ki->c", white, fit.errors[i])
        found = latent_push(made, fit, "v", i)
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-10 * np.abs(expected).max())
        assert found[-1] == 0.0  # what happens after the last sample is not seen


@pytest.mark.parametrize("order", [3.0, 7.0, 12.0])
def test_the_order_that_was_put_in_is_found_over_the_angle_of_the_wheel(order):
    angles = ({"cosine": 6.0, "order": order}, {"cosine": -2.0, "sine": 5.0, "order": order})  # phases differ between records
    model = fitted(axis_records(3, [{"torque-ripple@slide": e} for e in angles], force=25.0, samples=600))
    found = scan_orders(model.predictor, model.fit, "v", "slide", ORDERS)
    assert found.peaks[0] == order
    assert np.sort(found.statistics)[-2] < 0.5 * found.statistics.max()


@pytest.mark.parametrize(("samples", "repeated"), [(600, True), (12, False)])
def test_only_orders_that_turn_back_twice_in_a_record_are_sought(samples, repeated):
    """An arm that swings by a part of a turn shows a bend over its angle, and no wave of order 4 is told from it."""
    model = fitted(axis_records(3, force=25.0, samples=samples))
    column = len(AXIS.states)
    travel = max(np.ptp(turned(AXIS, "slide", model.predictor.corrected(i, model.fit.point)[:, column])) for i in range(2))
    found = scan_orders(model.predictor, model.fit, "v", "slide", ORDERS)
    waves = ORDERS * travel / (2 * np.pi)
    assert (found is not None) is repeated is bool(np.any(waves >= 1.5))
    if found:
        assert found.values.tolist() == ORDERS[waves >= 1.0].tolist()
        assert found.values[found.sought].tolist() == ORDERS[waves >= 1.5].tolist()
        assert found.tries == np.sum(waves >= 1.5)


@pytest.mark.parametrize("frequency", [0.8, 3.3, 9.0])
def test_the_frequency_that_was_put_in_is_found_within_what_the_record_resolves(frequency):
    t = AXIS.dt * np.arange(600)
    model = fitted(axis_records(3, unlogged=12 * np.cos(2 * np.pi * frequency * t + 1.0), samples=600))
    found = scan_frequencies(model.predictor, model.fit, "v")
    assert abs(found.values[np.argmax(found.statistics)] - frequency) < 0.5 / t[-1]


@pytest.mark.slow
def test_statistics_of_records_in_which_nothing_is_periodic_have_the_size_of_chance():
    models = [fitted(axis_records(4 + seed, samples=600, force=25.0)) for seed in range(4)]
    # of two records: chi squared with four degrees of freedom, so a mean of four
    orders = [scan_orders(m.predictor, m.fit, "v", "slide", ORDERS).statistics for m in models]
    assert 3.0 < np.mean(orders) < 6.0
    assert 2.8 < np.mean([scan_frequencies(m.predictor, m.fit, "v").statistics.mean() for m in models]) < 5.0


def test_a_record_holds_four_turns_of_the_slowest_frequency_and_two_samples_of_the_fastest():
    model = fitted(axis_records(5, samples=200))
    found = scan_frequencies(model.predictor, model.fit, "v")
    assert found.values[0] > 4.0 / (200 * AXIS.dt)
    assert found.values[-1] < 0.5 / AXIS.dt
    assert found.tries > 50  # a search among so many is to be paid for


def test_peaks_are_larger_than_their_neighbours_and_the_largest_comes_first():
    statistics = np.array([5.0, 1.0, 9.0, 8.0, 2.0, 3.0, 1.0, 4.0])
    assert Scan(1, np.arange(8.0), statistics).peaks == [2.0, 0.0, 7.0][:PEAKS]
    assert Scan(1, np.arange(3.0), np.array([1.0, 2.0, 3.0])).peaks == [2.0]
    # the flank of a slower wave is no peak
    assert Scan(1, np.arange(4.0), np.array([4.0, 3.0, 1.0, 2.0]), np.array([False, True, True, True])).peaks == [3.0]


def reel_and_strip(drum, strip):
    """A drum that draws a strip, and records in which the tension swings with 1.3 Hz, by hand; places are called as given."""

    def equation(x, u, p, at):
        rate = getattr(at, strip).rate(0.1 * x.w, p.k, 5.0)
        return {
            "w": (u.M - 0.1 * x.T - p.b * x.w + getattr(at, drum).torque()) / p.J,
            "T": p.k * 0.1 * x.w - p.c * x.T + rate,
        }

    plant = Plant(
        name="strip",
        states=(Channel("w", "rad/s"), Channel("T", "N")),
        inputs=(Channel("M", "N m", "input"),),
        outputs=(Channel("n", "rad/s", "output"), Channel("pull", "N", "output")),
        parameters=(
            Parameter("J", 0.02, "kg m^2", tolerance=0.2),
            Parameter("b", 0.02, "N m s/rad", tolerance=0.3),
            Parameter("k", 40.0, "N/m", tolerance=0.2),
            Parameter("c", 4.0, "1/s", tolerance=0.2),
        ),
        equation=equation,
        measure=lambda x, p: {"n": x.w, "pull": x.T},
        dt=0.01,
        ports=(Shaft(drum, "w"), Span(strip, "T")),
        noise={"n": 0.02, "pull": 0.02},
    )

    def rates(t, x, M, phase):
        swing = 6.0 * np.cos(2.0 * np.pi * 1.3 * t + phase)
        return [(M - 0.1 * x[1] - 0.02 * x[0]) / 0.02, 4.0 * x[0] - 4.0 * x[1] + swing]

    made = []
    for seed in (1, 2):
        random, x, rows = np.random.default_rng(seed), np.array([15.0, 15.0]), []
        torque = 1.8 + np.repeat(random.uniform(-0.6, 0.6, 30), 40)
        for k, M in enumerate(torque):
            rows.append(x + 0.02 * random.standard_normal(2))
            x = solve_ivp(rates, (0.01 * k, 0.01 * (k + 1)), x, args=(M, seed), rtol=1e-9).y[:, -1]
        n, pull = np.array(rows).T
        made.append(Experiment.from_arrays(f"strip {seed}", 0.01, inputs={"M": torque}, outputs={"n": n, "pull": pull}))
    return plant, Dataset(tuple(made))


def test_what_is_tried_does_not_depend_on_what_a_place_is_called():
    """A span called otherwise than its tension was never asked whether it swings: its entry was looked up by the place's name."""
    tried = []
    for names in (("w", "T"), ("drum", "strip")):
        plant, data = reel_and_strip(*names)
        model = fitted(data, plant)
        found = variants(model.predictor, model.fit, [slot.key for slot in plant.slots])
        places = dict(zip(names, ("drum", "strip"), strict=True))
        tried.append({(v.key.split("@")[0], places.get(v.key.split("@")[1], v.key.split("@")[1])) for v in found})
    assert tried[0] == tried[1]
    assert {("periodic-tension", "strip"), ("imbalance", "drum")} <= tried[1]


@pytest.mark.slow
def test_a_strip_that_swings_is_named_whatever_it_is_called():
    (cause,) = diagnose(*reel_and_strip("drum", "strip")).causes
    assert cause.key == "periodic-tension@strip"
    assert cause.parameters["frequency"].value == pytest.approx(1.3, abs=0.02)
