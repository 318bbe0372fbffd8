"""The scan finds the order and the frequency that were put in, and its push is the gradient that it says."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.workbench.diagnosis.cases import AXIS, axis_records, fitted, keys_of, screened, steps
from workbench import Parameter, Plant
from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis.diagnosis import diagnose
from workbench.diagnosis.fit import _evaluate, gauss_newton
from workbench.diagnosis.kalman import response
from workbench.diagnosis.refit import _all_round, _at_own_noise, refit, start
from workbench.diagnosis.scan import PEAKS, Scan, latent_push, pushes, scan_frequencies, scan_orders, turned
from workbench.diagnosis.screen import small_sizes, variants
from workbench.physics.controller import Playback
from workbench.physics.effects import Shaft, Slide, Span
from workbench.simulation import Scenario, simulate

ORDERS = np.arange(2.0, 25.0)


def moves_of(model, place="slide"):
    """What a force at a place does in each sample, from the slots of a ripple there."""
    slots = model.predictor.plant.slots
    order = next(i for i, s in enumerate(slots) if (s.key, s.parameter.name) == (f"torque-ripple@{place}", "order"))
    return pushes(model.predictor, model.fit, order, small_sizes(model.predictor, model.fit))


def orders_of(model, place="slide"):
    return scan_orders(model.predictor, model.fit, moves_of(model, place), place, ORDERS)


def test_the_latent_push_is_the_gradient_of_half_the_squared_errors_over_a_push_at_every_sample():
    model = fitted(axis_records(1, {"coulomb@slide": {"level": 20.0}}, samples=60, start={"v": 0.3}))
    made, fit = model.predictor, model.fit
    for i, line in enumerate(made.lines):
        N, _, n = line.H.shape
        g = line.G[:, :, made.entries.index("v")]
        push = np.zeros((N, n, N))
        for k in range(N):
            push[k, :, k] = g[k]
        white = np.einsum("kij,kjc->kic", made.passes[i].whitening, response(line, made.passes[i].gain, push))
        expected = np.einsum("kic,ki->c", white, fit.errors[i])
        found = latent_push(made, fit, g, i)
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-10 * np.abs(expected).max())
        assert found[-1] == 0.0  # what happens after the last sample is not seen


def crane_records(seed, effects, samples=600):
    """A load that swings on the rope of a trolley: a force on the trolley moves both.

    M v' = F - b v + m g a + torque,   l w' = -g a - v'
    """

    def equation(x, u, p, at):
        rate = (u.F - p.b * x.v + 2.0 * 9.81 * x.a + at.trolley.torque()) / p.M
        return {"q": x.v, "v": rate, "a": x.w, "w": (-9.81 * x.a - rate) / 0.5 - p.c * x.w}

    plant = Plant(
        name="crane",
        states=(Channel("q", "m"), Channel("v", "m/s"), Channel("a", "rad"), Channel("w", "rad/s")),
        inputs=(Channel("F", "N", "input"),),
        outputs=(Channel("place", "m", "output"), Channel("swing", "rad", "output")),
        parameters=(
            Parameter("M", 3.0, "kg", tolerance=0.1),
            Parameter("b", 12.0, "N s/m", tolerance=0.2),
            Parameter("c", 0.2, "1/s", tolerance=0.3),
        ),
        equation=equation,
        measure=lambda x, p: {"place": x.q, "swing": x.a},
        dt=0.02,
        ports=(Slide("trolley", "v", travel=0.02),),
        noise={"place": 2e-4, "swing": 1e-3},
        disturbance={"F": 0.05},
    )
    made = []
    for i, own in enumerate(effects):
        scenario = Scenario(f"crane {i}", {"F": steps(samples, 3.0, 100 * seed + i, hold=25)}, seed=100 * seed + 50 + i)
        made.append(simulate(plant, Playback(("F",), plant.dt), scenario, effects=own, substeps=8).experiment)
    return plant, Dataset(tuple(made))


def swinging(order, amplitude, phases=(0.4, 2.5)):
    return [
        {"torque-ripple@trolley": {"cosine": amplitude * np.cos(q), "sine": amplitude * np.sin(q), "order": order}}
        for q in phases
    ]


@pytest.mark.parametrize("coupled", [False, True])
def test_what_a_scan_sums_up_over_a_wave_is_the_slope_of_the_squared_errors_over_the_size_of_that_ripple(coupled):
    """A scan that pushed the speed of a trolley alone, and not the load on it, was 500 times off and saw no order at all."""
    if coupled:
        plant, data = crane_records(1, swinging(7.0, 0.5))
        model, place = fitted(data, plant), "trolley"
    else:
        model, place = fitted(axis_records(3, {"torque-ripple@slide": {"cosine": 6.0, "order": 7.0}}, force=25.0)), "slide"
    made, fit = model.predictor, model.fit
    slots = [i for i, s in enumerate(made.plant.slots) if s.key == f"torque-ripple@{place}"]
    sizes = small_sizes(made, fit)
    scale, column = sizes[slots[0]], len(made.plant.states) + list(made.plant.turning).index(place)
    for i, g in enumerate(moves_of(model, place)):
        eta = np.repeat(fit.point.eta[i][None], 5, axis=0)
        eta[:, slots[2]] = 3.0
        eta[1:, slots[:2]] += scale * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        e = made.errors(i, fit.point.p[None], eta, fit.point.start[i][None])
        half = 0.5 * (e**2).sum(axis=(1, 2))
        angle = turned(made.plant, place, made.corrected(i, fit.point)[:, column])
        wave = np.exp(3j * (angle + 0.5 * np.diff(angle, append=2 * angle[-1] - angle[-2])))
        found = latent_push(made, fit, g, i) @ wave
        slopes = complex(half[1] - half[2], half[3] - half[4]) / 2.0
        assert abs(found - slopes) < 0.03 * abs(slopes)


@pytest.mark.parametrize("order", [5.0, 8.0, 14.0])
def test_a_large_ripple_of_a_coupled_machine_is_fitted_as_well_as_from_its_true_phases(order):
    """Noise levels of a model without it take a large ripple in: from its one-step estimate alone a fit ends far beside it."""
    plant, data = crane_records(2, swinging(order, 3.0))
    model = fitted(data, plant)
    sizes = small_sizes(model.predictor, model.fit)
    assert orders_of(model, "trolley").peaks[0] == order
    (score,) = screened(model, ["torque-ripple@trolley"])
    found = refit(model, score, sizes)
    own = [i for i, s in enumerate(plant.slots) if s.key == "torque-ripple@trolley"]
    assert np.hypot(*found.fit.point.eta[0, own[:2]]) == pytest.approx(3.0, rel=0.1)
    unknowns, guesses = start(model, score.best)
    first, second = (complex(*(e["torque-ripple@trolley"][name] for name in ("cosine", "sine"))) for e in swinging(order, 3.0))
    z = guesses[0]
    z[unknowns.places[-1]] = first.real, first.imag, np.angle(second / first)
    true = _at_own_noise(model.predictor, gauss_newton(model.predictor, unknowns, z, sizes), sizes)
    assert model.bic - found.bic > 0.7 * (model.bic - true.bic) > 900.0


@pytest.mark.parametrize("order", [3.0, 7.0, 12.0])
def test_the_order_that_was_put_in_is_found_over_the_angle_of_the_wheel(order):
    angles = ({"cosine": 6.0, "order": order}, {"cosine": -2.0, "sine": 5.0, "order": order})  # phases differ between records
    model = fitted(axis_records(3, [{"torque-ripple@slide": e} for e in angles], force=25.0, samples=600))
    found = orders_of(model)
    assert found.peaks[0] == order
    assert np.sort(found.statistics)[-2] < 0.5 * found.statistics.max()


@pytest.mark.parametrize(("samples", "repeated"), [(600, True), (12, False)])
def test_only_orders_that_turn_back_twice_in_a_record_are_sought(samples, repeated):
    """An arm that swings by a part of a turn shows a bend over its angle, and no wave of order 4 is told from it."""
    model = fitted(axis_records(3, force=25.0, samples=samples))
    column = len(AXIS.states)
    travel = max(np.ptp(turned(AXIS, "slide", model.predictor.corrected(i, model.fit.point)[:, column])) for i in range(2))
    found = orders_of(model)
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
    found = scan_frequencies(model.predictor, model.fit, moves_of(model))
    assert abs(found.values[np.argmax(found.statistics)] - frequency) < 0.5 / t[-1]


@pytest.mark.slow
def test_statistics_of_records_in_which_nothing_is_periodic_have_the_size_of_chance():
    models = [fitted(axis_records(4 + seed, samples=600, force=25.0)) for seed in range(4)]
    # of two records: chi squared with four degrees of freedom, so a mean of four
    orders = [orders_of(m).statistics for m in models]
    assert 3.0 < np.mean(orders) < 6.0
    assert 2.8 < np.mean([scan_frequencies(m.predictor, m.fit, moves_of(m)).statistics.mean() for m in models]) < 5.0


def test_a_record_holds_four_turns_of_the_slowest_frequency_and_two_samples_of_the_fastest():
    model = fitted(axis_records(5, samples=200))
    found = scan_frequencies(model.predictor, model.fit, moves_of(model))
    assert found.values[0] > 4.0 / (200 * AXIS.dt)
    assert found.values[-1] < 0.5 / AXIS.dt
    assert found.tries > 50  # a search among so many is to be paid for


def test_peaks_are_larger_than_their_neighbours_and_the_largest_comes_first():
    statistics = np.array([5.0, 1.0, 9.0, 8.0, 2.0, 3.0, 1.0, 4.0])
    assert Scan(1, np.arange(8.0), statistics).peaks == [2.0, 0.0, 7.0][:PEAKS]
    assert Scan(1, np.arange(3.0), np.array([1.0, 2.0, 3.0])).peaks == [2.0]
    # the flank of a slower wave is no peak
    assert Scan(1, np.arange(4.0), np.array([4.0, 3.0, 1.0, 2.0]), np.array([False, True, True, True])).peaks == [3.0]


def reel_and_strip(drum, strip, seeds=(1, 2)):
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
    for seed in seeds:
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
        found = variants(model.predictor, model.fit, keys_of(model), small_sizes(model.predictor, model.fit))
        places = dict(zip(names, ("drum", "strip"), strict=True))
        tried.append({(v.key.split("@")[0], places.get(v.key.split("@")[1], v.key.split("@")[1])) for v in found})
    assert tried[0] == tried[1]
    assert {("periodic-tension", "strip"), ("imbalance", "drum")} <= tried[1]


@pytest.mark.parametrize("records", [1, 2, 3])
def test_a_swing_with_a_frequency_of_its_own_begins_at_that_and_at_a_phase_for_every_record(records):
    """What is fitted beside the phases stood in their place: with one record, and with three, a diagnosis ended in an error."""
    plant, data = reel_and_strip("drum", "strip", range(1, records + 1))
    model = fitted(data, plant)
    sizes = small_sizes(model.predictor, model.fit)
    (score,) = screened(model, ["periodic-tension@strip"])
    unknowns, guesses = start(model, score.best)
    own, free = unknowns.places[-1], unknowns.terms[-1].free
    found = _all_round(model, unknowns, guesses[0])
    assert len(free) == 1
    for z in found:
        frequency, turns = z[own][2], z[own][3:]
        assert frequency == 0.0  # that of the scan
        assert len(turns) == records - 1
    # far nearer to a tension that swings than the scan's own step, or as near
    tried = _evaluate(model.predictor, unknowns, [guesses[0], *found], model.fit.jacobian)
    assert min(f.cost for f in tried[1:]) < 1.05 * tried[0].cost
    after = refit(model, score, sizes)
    slots = {s.parameter.name: i for i, s in enumerate(plant.slots) if s.key == "periodic-tension@strip"}
    assert after.fit.point.eta[0, slots["frequency"]] == pytest.approx(1.3, abs=0.02)
    assert np.hypot(*after.fit.point.eta[0, [slots["cosine"], slots["sine"]]]) == pytest.approx(6.0, rel=0.1)


@pytest.mark.slow
def test_a_strip_that_swings_is_named_whatever_it_is_called():
    (cause,) = diagnose(*reel_and_strip("drum", "strip")).causes
    assert cause.key == "periodic-tension@strip"
    assert cause.parameters["frequency"].value == pytest.approx(1.3, abs=0.02)
