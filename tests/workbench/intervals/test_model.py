"""Interval models of records: promises kept on every sample, envelopes that hold every sequence of parameters, files."""

from fractions import Fraction

import numpy as np
import pytest

from workbench.data import Dataset, Experiment
from workbench.errors import InputError
from workbench.files import write_json
from workbench.intervals.coverage import cover
from workbench.intervals.domains.shapes import Box
from workbench.intervals.model import IntervalModel, Simulation, load_interval_model
from workbench.intervals.output_error import OutputErrorRegression
from workbench.intervals.regression import BySchedule, IntervalRegression, InTime
from workbench.intervals.regressors import ARX, FIR
from workbench.intervals.semantics import InclusionAll, InclusionExact, InclusionPaper, Overlap
from workbench.intervals.splitting import MaximumRadius

NOISE = 0.01


def plant(N, seed, *, name="a", noise=NOISE, spread=0.05, jump=False):
    """y(k) = a1(k) y(k-1) + a2 y(k-2) + b1(k) u(k-1) + b2 v(k-2), a1 and b1 anywhere in an interval (or by a slow schedule)."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.choice([-1.0, 1.0], N // 7 + 1), 7)[:N]
    v = random.standard_normal(N)
    rho = np.linspace(0.0, 1.0, N) + 0.01 * random.standard_normal(N)
    y = np.zeros(N)
    for k in range(2, N):
        a1, b1 = 1.2 + spread * random.uniform(-1, 1), 0.4 + spread * random.uniform(-1, 1) + 0.3 * rho[k]
        b1 *= -1.0 if jump and k > N // 2 else 1.0
        y[k] = a1 * y[k - 1] - 0.5 * y[k - 2] + b1 * u[k - 1] + 0.1 * v[k - 2]
    measured = y + noise * random.uniform(-1, 1, N)
    return Experiment.from_arrays(name, 0.1, inputs={"u": u, "v": v}, outputs={"y": measured}, schedule={"rho": rho})


def literal_promise(model: IntervalModel, mode, e, k):
    """By how much the envelope holds [y](k) on its worse side, in exact arithmetic, at the regressors as measured."""
    n = model.structure.memory
    F = Fraction
    columns = {name: [F(float(x)) for x in e[name][k - n : k + 1]] for name in ("y", "u", "v")}
    past = {name: values[:-1][::-1] for name, values in columns.items()}  # lag 1 first
    z = []
    if isinstance(model.structure, ARX) and model.structure.delta:
        assert n == 2
        y1, y2 = past["y"]
        base = 2 * y1 - y2
        z = [-(y1 - y2), -y2]
        for name in ("u", "v"):
            u1, u2 = past[name]
            z += [u1 - u2, u2]
    else:
        base = F(0)
        z = [-x for x in past["y"]] if isinstance(model.structure, ARX) else []
        for name in ("u", "v"):
            z += past[name]
    z.append(F(1))
    centre = base + sum(F(float(c)) * x for c, x in zip(mode.box.centre, z, strict=True))
    half = sum(F(float(r)) * abs(x) for r, x in zip(mode.box.radius, z, strict=True))
    e_y = F(float(model.output_error))
    top, bottom = columns["y"][-1] + e_y, columns["y"][-1] - e_y
    if isinstance(model.semantics, Overlap):
        top, bottom = bottom, top
    return min(centre + half - top, bottom - (centre - half))


METHODS = {
    "one box": IntervalRegression(ARX(2), output_error=NOISE, input_error=0.0),
    "shift": IntervalRegression(ARX(2, delta=False), output_error=NOISE, input_error=0.0),
    "exact regressors": IntervalRegression(ARX(2), InclusionExact(), output_error=NOISE, input_error=0.0),
    "overlap": IntervalRegression(ARX(2), Overlap(), output_error=NOISE, input_error=0.0),
    "FIR": IntervalRegression(FIR(6), output_error=NOISE, input_error=0.01),
    "along time": IntervalRegression(ARX(2), InclusionExact(), InTime(0.97, 20), 0.0, 0.0),
    "largest radius": IntervalRegression(ARX(2), InclusionExact(), InTime(0.95, 20, MaximumRadius()), 0.0, 0.0),
    "by schedule": IntervalRegression(ARX(2), partition=BySchedule(4), output_error=NOISE, input_error=0.0),
}


@pytest.fixture(scope="module")
def records():
    return Dataset((plant(400, 1, jump=True), plant(300, 2, name="b")))


@pytest.fixture(scope="module")
def models(records):
    return {name: method.fit(records) for name, method in METHODS.items()}


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_every_estimation_sample_keeps_the_promise_in_exact_arithmetic(models, records, name):
    model = models[name]
    by_name = {e.name: e for e in records}
    seen = 0
    for mode in model.modes:
        for span in mode.spans:
            for k in range(span.first, span.last + 1):
                assert literal_promise(model, mode, by_name[span.record], k) >= 0
                seen += 1
    assert seen >= sum(len(e) - model.structure.memory for e in records)


@pytest.mark.parametrize("name", [name for name in METHODS if name != "overlap"])
def test_one_step_envelopes_hold_the_estimation_records_completely(models, records, name):
    for e in records:
        envelope = models[name].one_step(e)
        assert envelope.coverage == 1.0
        assert envelope.valid == 1.0
        assert len(envelope.k) == len(e) - models[name].structure.memory


def test_modes_buy_width(models, records):
    def width(name):
        return np.mean([models[name].one_step(e).mean_radius for e in records])

    assert width("by schedule") < width("one box")
    one = IntervalRegression(ARX(2), InclusionExact(), output_error=0.0, input_error=0.0).fit(records)
    along = models["along time"]
    assert len(along.modes) > 1
    assert max(mode.mean_radius for mode in along.modes) < one.modes[0].mean_radius
    assert all(mode.precision >= 0.97 * (1 - 1e-9) for mode in along.modes if not mode.short)


def test_where_several_modes_are_valid_the_envelope_is_their_union():
    """On the edge of two schedule intervals the sample belongs to both boxes; a wrong pick of one would be too narrow."""
    model = IntervalRegression(ARX(2), partition=BySchedule(2), output_error=0.0, input_error=0.0).fit(Dataset((plant(600, 3),)))
    e = plant(600, 4)
    edge = float(model.modes[0].domain.high[0])
    assert model.modes[1].domain.low[0] == edge
    on_edge = Experiment(e.name, e.t, e.channels, np.where(np.arange(4) == 3, edge, e.values), e.dt)
    both = model.one_step(on_edge)
    inside = Experiment(e.name, e.t, e.channels, np.where(np.arange(4) == 3, edge - 1e-3, e.values), e.dt)
    first = model.one_step(inside)
    beyond = Experiment(e.name, e.t, e.channels, np.where(np.arange(4) == 3, edge + 1e-3, e.values), e.dt)
    second = model.one_step(beyond)
    np.testing.assert_array_equal(both.low, np.minimum(first.low, second.low))
    np.testing.assert_array_equal(both.high, np.maximum(first.high, second.high))


def test_outside_every_domain_the_nearest_mode_speaks_and_the_sample_is_not_known(models):
    e = plant(200, 5, name="c")
    far = Experiment(e.name, e.t, e.channels, e.values + np.array([0.0, 0.0, 0.0, 9.0]), e.dt)
    envelope = models["by schedule"].one_step(far)
    assert envelope.valid == 0.0
    assert set(envelope.mode) == {len(models["by schedule"].modes) - 1}


# ---- free run ---------------------------------------------------------------------------------------------------------


def literal_run(model: IntervalModel, e, theta, y0, u_error):
    """Outputs from sample n on by the recursion as it is written, parameters theta (K, p), inputs with errors (N, nu)."""
    n, form = model.structure.memory, model.form
    y = list(y0)
    u = e[["u", "v"]] + u_error
    for i, k in enumerate(range(n, len(e))):
        psi = np.array([
            y[k - int(lag)] if source == 0 else (1.0 if source < 0 else u[k - int(lag), int(source) - 1])
            for source, lag in zip(form.source, form.lags, strict=True)
        ])  # fmt: skip
        y.append(form.d @ psi + theta[i] @ (form.T @ psi))
    return np.array(y[n:])


@pytest.mark.parametrize("structure", [ARX(2), ARX(2, delta=False), ARX(3, delay=0), ARX(1), FIR(5)])
def test_every_sequence_of_parameters_errors_and_modes_stays_within_the_free_run(structure):
    random = np.random.default_rng(7)
    estimation, e = plant(500, 6), plant(60, 8, name="held")
    method = IntervalRegression(structure, partition=BySchedule(3), output_error=0.02, input_error=(0.01, 0.0))
    model = method.fit(Dataset((estimation,)))
    found = model.free_run(e)
    n = structure.memory
    centre = np.array([mode.box.centre for mode in model.modes])[found.mode.astype(int)]
    radius = np.array([mode.box.radius for mode in model.modes])[found.mode.astype(int)]
    widest = np.zeros(len(found.y))
    for trial in range(200):
        sign = random.choice([-1.0, 1.0], radius.shape) if trial % 2 else np.sign(random.standard_normal(radius.shape[1]))
        y0 = e["y"][:n] + 0.02 * random.choice([-1.0, 1.0], n)
        y = literal_run(model, e, centre + sign * radius, y0, np.array([0.01, 0.0]) * random.uniform(-1, 1, (len(e), 2)))
        slack = 1e-9 * np.abs(y).max()
        assert np.all(y >= found.run.low - slack)
        assert np.all(y <= found.run.high + slack)
        widest = np.maximum(widest, np.abs(y - found.run.nominal))
    assert np.all(found.run.reached_high <= found.run.high)
    assert np.mean(widest / ((found.run.high - found.run.low) / 2)) > 0.05  # the bound has to do with the runs


def test_the_worst_sequences_replay_in_the_recursion_as_it_is_written():
    model = IntervalRegression(ARX(2), partition=BySchedule(3), output_error=0.0, input_error=0.0).fit(Dataset((plant(500, 6),)))
    e = plant(80, 9, name="held")
    found = model.free_run(e)
    sequences = found.run.sequences
    for i in range(0, len(sequences.y), 3):
        at = found.mode.astype(int)
        centre = np.array([m.box.centre for m in model.modes])[at]
        radius = np.array([m.box.radius for m in model.modes])[at]
        y = literal_run(model, e, centre + sequences.delta[i] * radius, e["y"][:2], np.zeros((len(e), 2)))
        np.testing.assert_allclose(y, sequences.y[i], rtol=1e-7, atol=1e-9 * np.abs(y).max())
    assert found.run.ratio < 1 + 1e-4  # an ascent, no proof: it may stop a hair short


@pytest.mark.slow
def test_the_true_machine_runs_within_the_envelope_when_errors_are_bounded():
    """Parameters anywhere in a known interval, outputs measured with bounded errors: InclusionAll holds the true run."""
    e = plant(600, 10)
    model = IntervalRegression(ARX(2), output_error=NOISE, input_error=0.0).fit(Dataset((e,)))
    found = model.free_run(e)
    assert found.coverage == 1.0


@pytest.mark.slow
def test_a_free_run_without_schedule_follows_the_modes_of_its_own_regressors(models):
    e = plant(200, 11, name="held")
    found = models["along time"].free_run(e)
    assert found.mode.max() < len(models["along time"].modes)
    assert np.all(found.run.low <= found.run.nominal)


def stepped(seed=31, *, name="a", N=600):
    """A machine whose schedule stands still on round values: they lie on the edges of its intervals, up to rounding."""
    e = plant(N, seed, name=name, noise=0.0, spread=0.0)
    rho = np.round(np.floor(np.linspace(0, 10.999, N)) / 10, 10)
    y = np.zeros(N)
    for k in range(2, N):
        y[k] = 1.2 * y[k - 1] - 0.5 * y[k - 2] + (0.4 + rho[k]) * e["u"][k - 1]
    return Experiment.from_arrays(name, 0.1, inputs={"u": e["u"], "v": e["v"]}, outputs={"y": y}, schedule={"rho": rho})


@pytest.mark.parametrize("intervals", [3, 5, 10])
def test_a_schedule_on_the_edge_of_two_intervals_is_held_by_both(intervals):
    """np.linspace gives 0.6000000000000001: the sample must be in the box of every mode whose domain takes it."""
    e = stepped()
    model = IntervalRegression(ARX(2), InclusionExact(), BySchedule(intervals), 0.0, 0.0).fit(Dataset((e,)))
    for j, mode in enumerate(model.modes):
        held = np.flatnonzero(mode.domain.holds(e["rho"][:, None])[2:]) + 2
        listed = {k for span in mode.spans for k in range(span.first, span.last + 1)}
        assert set(held.tolist()) == listed, j
    assert model.one_step(e).coverage == 1.0
    assert model.free_run(e).coverage == 1.0


def test_the_mode_of_a_scheduled_free_run_is_that_of_the_schedule_now():
    e = plant(300, 33)
    model = IntervalRegression(ARX(2), partition=BySchedule(4), output_error=0.0, input_error=0.0).fit(Dataset((e,)))
    found = model.free_run(e)
    for i, k in enumerate(found.k.astype(int)):
        domain = model.modes[int(found.mode[i])].domain
        assert domain.low[0] - 1e-9 <= e["rho"][k] <= domain.high[0] + 1e-9
    assert found.valid == 1.0


def test_records_of_one_name_keep_their_own_schedules():
    first, second = plant(300, 41), plant(200, 42)
    second = Experiment(first.name, second.t, second.channels, second.values * np.array([1, 1, 1, -1.0]), second.dt)
    data = Dataset((first, second))
    model = IntervalRegression(ARX(2), InclusionExact(), BySchedule(4), 0.0, 0.0).fit(data)
    assert all(model.one_step(e).coverage == 1.0 for e in data)


def test_errors_of_inputs_and_outputs_reach_their_own_channels():
    """u errs, v does not: the extra term of a free run is |b_u| + radius_u at its worst, and reversing the errors changes it."""
    e = plant(300, 43)
    widths = []
    for errors in ((0.1, 0.0), (0.0, 0.1)):
        model = IntervalRegression(ARX(1), InclusionExact(), output_error=0.0, input_error=errors).fit(Dataset((e,)))
        S = model.samples_of(e)
        recursion, _ = model.recursion(S, e)
        rows = model.form.d + model.form.T.T @ model.modes[0].box.centre
        source = model.form.source
        own = np.array([errors[int(s) - 1] if s > 0 else 0.0 for s in source])
        worst = np.abs(rows) @ own + model.modes[0].box.radius @ (np.abs(model.form.T) @ own)
        assert recursion.lam[0, -1] == pytest.approx(worst, rel=1e-12)
        widths.append(worst)
    assert widths[0] != widths[1]


def test_bounds_are_rounded_outward(models, records):
    e = records.experiments[1]
    model = models["exact regressors"]
    envelope, F = model.one_step(e), Fraction
    for i in range(0, len(envelope.k), 7):
        k = int(envelope.k[i])
        slack = literal_promise(model, model.modes[0], e, k)
        top = F(float(envelope.high[i])) - F(float(e["y"][k])) - F(NOISE)
        bottom = F(float(e["y"][k])) - F(NOISE) - F(float(envelope.low[i]))
        assert min(top, bottom) >= slack


def test_what_a_free_run_counts_as_inside_is_the_width_it_reports(models):
    e = plant(200, 44, name="held")
    found = models["one box"].free_run(e)
    np.testing.assert_array_equal(found.low, found.run.low - NOISE)
    np.testing.assert_array_equal(found.high, found.run.high + NOISE)
    assert found.coverage == np.mean((found.y >= found.low) & (found.y <= found.high))
    assert found.mean_radius == pytest.approx(np.mean(found.high - found.low) / 2)


@pytest.mark.slow
def test_a_free_run_says_where_nobody_has_been(models):
    e = plant(200, 45, name="held")
    far = Experiment(e.name, e.t, e.channels, e.values + np.array([0.0, 0.0, 0.0, 9.0]), e.dt)
    assert models["by schedule"].free_run(far).valid == 0.0
    louder = Experiment(e.name, e.t, e.channels, e.values * np.array([50.0, 1.0, 1.0, 1.0]), e.dt)
    assert models["one box"].free_run(louder).valid < 0.2
    line = cover(models["by schedule"], (far,), "held-out")[1]
    assert (line.horizon, line.valid) == ("free-run", 0.0)


def test_a_gap_stops_a_free_run_and_not_the_one_step_line(models):
    e = plant(200, 46, name="held")
    t = e.t.copy()
    t[100:] += 3.0
    broken = Experiment(e.name, t, e.channels, e.values, e.dt)
    with pytest.raises(InputError, match="cannot cross a gap"):
        models["one box"].free_run(broken)
    assert [line.horizon for line in cover(models["one box"], (broken,), "held-out")] == ["one-step"]
    assert len(models["one box"].one_step(broken).k) == 196


def test_units_and_roles_are_those_of_the_model():
    e = plant(200, 47)
    metres = Experiment.from_arrays("a", 0.1, inputs={"u": e["u"]}, outputs={"y": e["y"]}, units={"y": "m"})
    model = IntervalRegression(ARX(1), output_error=0.0, input_error=0.0).fit(Dataset((metres,)))
    other = Experiment.from_arrays("b", 0.1, inputs={"u": e["u"]}, outputs={"y": 1000 * e["y"]}, units={"y": "mm"})
    with pytest.raises(InputError, match="in mm, the model has it in m"):
        model.one_step(other)
    with pytest.raises(InputError, match="is an input"):
        IntervalRegression(ARX(1)).fit(Dataset((metres,)), "u")


def test_half_a_quantum_is_the_error_of_a_quantised_input():
    e = plant(500, 48)
    coarse = Experiment.from_arrays("a", 0.1, inputs={"v": np.round(e["v"] / 0.1) * 0.1}, outputs={"y": e["y"]})
    model = IntervalRegression(ARX(1)).fit(Dataset((coarse,)))
    assert model.input_error[0] == pytest.approx(0.05, rel=1e-6)


# ---- simulation boxes ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def simulation(records):
    return OutputErrorRegression(ARX(2), output_error=NOISE).fit(records)


@pytest.mark.slow
def test_a_simulation_box_holds_every_record_in_its_free_run_and_promises_nothing_else(simulation, records):
    for e in records:
        found = simulation.free_run(e)
        assert np.all(found.run.high >= found.y + NOISE)  # the measured interval, not only the value
        assert np.all(found.run.low <= found.y - NOISE)
    assert isinstance(simulation.semantics, Simulation)
    with pytest.raises(InputError, match="no one-step envelope"):
        simulation.one_step(records.experiments[0])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [14, 15, 16])
def test_a_simulation_box_is_narrower_in_simulation_than_a_box_of_equation_errors(seed):
    e = plant(400, seed)
    data = Dataset((e,))
    simulated = OutputErrorRegression(ARX(2), output_error=NOISE).fit(data).free_run(e)
    stepped = IntervalRegression(ARX(2), output_error=NOISE, input_error=0.0).fit(data).free_run(e)
    assert simulated.mean_radius < 0.8 * stepped.mean_radius


@pytest.mark.slow
def test_the_middle_of_a_simulation_box_is_the_output_error_fit():
    """An independent optimiser on the recursion as it is written finds no better parameters."""
    from scipy.optimize import least_squares

    e = plant(250, 12, spread=0.02)
    model = OutputErrorRegression(ARX(2), output_error=NOISE).fit(Dataset((e,)))

    def error(theta):
        return literal_run(model, e, np.tile(theta, (len(e) - 2, 1)), e["y"][:2], np.zeros((len(e), 2))) - e["y"][2:]

    own = model.modes[0].box.centre
    start = own * (1 + 0.02 * np.random.default_rng(0).standard_normal(len(own)))
    other = least_squares(error, start, x_scale=np.abs(own) + 1e-3)
    assert np.sum(error(own) ** 2) <= 2 * other.cost * (1 + 1e-6)
    np.testing.assert_allclose(own, other.x, rtol=1e-3, atol=1e-4)


# ---- files, coverage, bad input -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", [*METHODS, "simulation"])
def test_a_saved_model_is_the_same_model(models, simulation, records, tmp_path, name):
    model = simulation if name == "simulation" else models[name]
    model.save(tmp_path / "m.json")
    again = load_interval_model(tmp_path / "m.json")
    e = records.experiments[1]
    np.testing.assert_array_equal(again.free_run(e, (5,)).run.high, model.free_run(e, (5,)).run.high)
    if name != "simulation":
        np.testing.assert_array_equal(again.one_step(e).low, model.one_step(e).low)
    assert again.to_dict().keys() == model.to_dict().keys()
    assert (again.semantics.name, again.notes, again.trained_on) == (model.semantics.name, model.notes, model.trained_on)


@pytest.mark.parametrize("field", ["modes", "structure", "semantics", "input_error", "version"])
def test_a_torn_model_file_is_refused_with_its_name(models, tmp_path, field):
    content = models["one box"].to_dict()
    del content[field]
    write_json(tmp_path / "m.json", content)
    with pytest.raises(InputError) as reason:
        load_interval_model(tmp_path / "m.json")
    assert str(tmp_path / "m.json") in str(reason.value)


def test_foreign_values_in_a_model_file_are_refused(models, tmp_path):
    for change in ({"semantics": "inclusion-al"}, {"modes": []}, {"dt": -1.0}, {"output_error": -1.0}):
        write_json(tmp_path / "m.json", models["one box"].to_dict() | change)
        with pytest.raises(InputError):
            load_interval_model(tmp_path / "m.json")


def test_coverage_counts_both_envelopes_and_refuses_estimation_records_as_held_out(models, records):
    held = plant(200, 21, name="held")
    lines = cover(models["one box"], (held,), "held-out")
    assert [line.horizon for line in lines] == ["one-step", "free-run"]
    envelope = models["one box"].one_step(held)
    assert lines[0].coverage == np.mean((envelope.y >= envelope.low) & (envelope.y <= envelope.high))
    assert lines[0].relative == lines[0].mean_radius / models["one box"].unit_range
    assert "held-out" in str(lines[0])
    with pytest.raises(InputError, match="made from this record"):
        cover(models["one box"], records, "held-out")


def test_errors_are_taken_from_the_records_where_nobody_gives_them(records):
    model = IntervalRegression(ARX(2)).fit(records)
    assert model.output_error > NOISE / np.sqrt(3) * 2
    assert "3 standard deviations" in model.notes[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "said"),
    [
        (IntervalRegression(output_error=-1.0), "error bound -1"),
        (IntervalRegression(input_error=(0.0, -0.1)), "error bound -0.1"),
        (IntervalRegression(input_error=(0.0, 0.1, 0.2)), "3 input errors for 2 inputs"),
        (IntervalRegression(partition=InTime(0.9, 10_000)), "10001 samples"),
        (IntervalRegression(ARX(2), partition=InTime(0.9999999, 20)), "can be reached"),
        (IntervalRegression(ARX(500)), "reaches back 500"),
        (IntervalRegression(ARX(2), InclusionPaper(), output_error=0.1), "delta form"),
    ],
)
def test_bad_input_is_refused_with_what_was_expected(records, method, said):
    with pytest.raises(InputError, match=said):
        method.fit(records)


@pytest.mark.parametrize("precision", [0.0, -0.1, 1.5])
def test_a_precision_outside_0_to_1_is_refused(precision):
    with pytest.raises(InputError, match="expected 0 < precision <= 1"):
        InTime(precision)


def test_regressors_of_zeros_are_refused():
    zero = np.zeros(100)
    e = Experiment.from_arrays("rest", 0.1, inputs={"u": zero}, outputs={"y": np.r_[np.zeros(50), np.ones(50)]})
    with pytest.raises(InputError, match="regressors"):
        IntervalRegression(ARX(2, bias=False), InclusionExact(), output_error=0.0, input_error=0.0).fit(Dataset((e,)))


def test_several_outputs_or_no_schedule_are_told_apart(records):
    e = records.experiments[0]
    with pytest.raises(InputError, match="2 outputs"):
        IntervalRegression().fit(Dataset((e.with_roles(outputs=("y", "v"), inputs=("u",)),)))
    with pytest.raises(InputError, match="no schedule"):
        IntervalRegression(partition=BySchedule(3)).fit(Dataset((e.select(["y", "u"]),)))
    still = Experiment(e.name, e.t, e.channels, np.where(np.arange(4) == 3, 0.5, e.values), e.dt)
    with pytest.raises(InputError, match="does not move"):
        IntervalRegression(partition=BySchedule(3)).fit(Dataset((still,)))


def test_schedule_intervals_with_few_samples_join_their_neighbour():
    e = plant(600, 13)
    rho = np.where(np.arange(600) < 5, 5.0, e["rho"])  # five samples far away
    odd = Experiment(e.name, e.t, e.channels, np.column_stack([e.values[:, :3], rho]), e.dt)
    model = IntervalRegression(ARX(2), partition=BySchedule(5), output_error=0.0, input_error=0.0).fit(Dataset((odd,)))
    assert 1 <= len(model.modes) < 5
    assert isinstance(model.modes[-1].domain, Box)
    assert model.modes[-1].domain.high[0] == 5.0
    assert model.one_step(odd).coverage == 1.0


def test_the_same_regime_met_twice_becomes_one_mode_only_where_the_joint_data_keep_the_precision():
    """Gain 1, gain 2, gain 1 again: the first and third are one; another regime with the same regressors stays apart."""
    random = np.random.default_rng(3)
    u = np.repeat(random.uniform(-1, 1, 300), 3)
    gain = np.where((np.arange(900) >= 300) & (np.arange(900) < 600), 2.0, 1.0)
    y = np.zeros(900)
    for k in range(1, 900):
        y[k] = 0.5 * y[k - 1] + gain[k] * u[k - 1]
    e = Experiment.from_arrays("a", 0.1, inputs={"u": u}, outputs={"y": y})
    method = IntervalRegression(ARX(1), InclusionAll(), InTime(0.999, 20), 0.0, 0.0)
    model = method.fit(Dataset((e,)))
    plain = IntervalRegression(ARX(1), InclusionAll(), InTime(0.999, 20, merge=None), 0.0, 0.0).fit(Dataset((e,)))
    assert len(plain.modes) > len(model.modes)
    gains = sorted({round(float(mode.box.centre[1]), 1) for mode in model.modes if not mode.short and mode.samples > 100})
    assert gains == [1.0, 2.0]
    together = [mode for mode in model.modes if len(mode.spans) > 1]
    assert together
    assert all(mode.precision >= 0.999 * (1 - 1e-9) for mode in together)
