"""Hammerstein-Wiener models on machines simulated here: a curve before a filter, and sensors that lose the sign."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

import workbench as wb
from studies.cli import main
from workbench.curves import Curve
from workbench.data import Dataset, Experiment
from workbench.errors import InputError
from workbench.hammerstein import HammersteinWienerModel, load_hammerstein
from workbench.identification.signs import lost_signs, may_lack_signs
from workbench.metrics import fit, score

DRIVES = Path(__file__).parents[4] / "shared" / "data" / "real" / "coupled_drives"

CURVES: dict[str, Callable] = {
    "square": lambda u: u * np.abs(u),
    "fan": lambda u: np.maximum(u, 0.0) ** 2,
    "dead zone": lambda u: np.sign(u) * np.maximum(np.abs(u) - 0.3, 0.0),
    "valve": lambda u: np.sqrt(np.maximum(u + 1.0, 0.0)),
    "limits": lambda u: np.clip(u, -0.5, 0.6),
    "even": lambda u: u**2,
    "straight": lambda u: u,
}
SIGNED = ("square", "dead zone", "limits", "straight")  # of those whose output has both signs


class Machine:
    """z = num(q) / den(q) f(u) with one to three poles, y = z or |z| with noise of 2 %."""

    def __init__(self, seed: int, kind: str, *, blind: bool = False):
        self.random, self.curve, self.blind = np.random.default_rng(seed), CURVES[kind], blind
        poles: list[complex] = [np.exp(-1.0 / self.random.uniform(4.0, 30.0))]
        if self.random.random() < 0.5:
            turn, damping = 2.0 * np.pi / self.random.uniform(12.0, 60.0), self.random.uniform(0.15, 0.9)
            pair = np.exp(-damping * turn + 1j * turn * np.sqrt(1.0 - damping**2))
            poles = [pair, np.conj(pair), *poles[: self.random.integers(0, 2)]]
        self.den = np.real(np.poly(poles))
        self.num = np.concatenate([[0.0], 1.0 + 0.3 * self.random.normal(size=len(poles))])
        self.num *= self.den.sum() / self.num.sum()

    def record(self, name: str, samples: int = 1200) -> tuple[Experiment, np.ndarray]:
        """A record under steps of any height, and what its output is without noise."""
        u = np.repeat(self.random.uniform(-1.0, 1.0, samples // 15 + 1), 15)[:samples]
        z = lfilter(self.num, self.den, self.curve(u))
        shown = np.abs(z) if self.blind else z
        y = shown + 0.02 * np.std(z) * self.random.normal(size=samples)
        return Experiment.from_arrays(name, 0.05, inputs={"u": u}, outputs={"y": y}), shown

    def records(self) -> tuple[Dataset, Dataset, float]:
        """Two to fit, one held out, and the free-run FIT of the machine itself on that."""
        (a, _), (b, _), (held, shown) = (self.record(name) for name in "abc")
        return Dataset((a, b)), Dataset((held,)), fit(held["y"], shown)


def run_fit(model, held: Dataset) -> float:
    return score(model, held, "held-out", ["free-run"])[0].FIT


def straightened(curve: Curve, truth: Callable) -> float:
    """What is left of a curve after its best gain and offset on the true one, as a share of its spread."""
    u = np.linspace(-0.95, 0.95, 201)
    v, f = curve(u), truth(u)
    return float(np.std(v - np.polyval(np.polyfit(f, v, 1), f)) / np.std(v))


@pytest.fixture(scope="module")
def fan() -> tuple[Machine, Dataset, Dataset, float, HammersteinWienerModel]:
    machine = Machine(11, "fan")
    data, held, best = machine.records()
    return machine, data, held, best, wb.HammersteinWiener().fit(data)


@pytest.fixture(scope="module")
def counter() -> tuple[Dataset, Dataset, float, HammersteinWienerModel]:
    """A linear machine whose sensor counts pulses."""
    data, held, best = Machine(12, "straight", blind=True).records()
    return data, held, best, wb.HammersteinWiener(nodes=(3,)).fit(data)


def test_a_one_sided_square_is_found_and_the_run_is_as_good_as_the_machine(fan):
    machine, data, held, best, model = fan
    assert run_fit(model, held) > best - 1.5
    assert run_fit(wb.LTI(resamples=0).fit(data), held) < best - 30.0
    assert straightened(model.curves[0], machine.curve) < 0.03
    assert model.order == len(machine.den) - 1


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in CURVES if kind != "straight"])
@pytest.mark.parametrize("seed", [101, 202, 303])
def test_any_curve_before_any_filter_is_found(kind, seed):
    machine = Machine(seed, kind)
    data, held, best = machine.records()
    model = wb.HammersteinWiener().fit(data)
    assert not model.unsigned  # an even curve looks like a lost sign
    assert run_fit(model, held) > best - 3.0
    assert straightened(model.curves[0], machine.curve) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("kind", SIGNED)
@pytest.mark.parametrize("seed", [404, 505])
def test_lost_signs_are_found_beside_any_curve(kind, seed):
    data, held, best = Machine(seed, kind, blind=True).records()
    model = wb.HammersteinWiener().fit(data)
    assert model.unsigned == ("y",)
    assert run_fit(model, held) > best - 10.0  # the fit alternates: it may stop early
    assert run_fit(wb.LTI(resamples=0).fit(data), held) < 30.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_straight_machine_is_left_to_the_linear_methods(seed):
    data, *_ = Machine(seed, "straight").records()
    with pytest.raises(InputError, match="no static curve"):
        wb.HammersteinWiener().fit(data)


def test_a_sensor_without_sign_is_found_and_costs_nothing(counter):
    _, held, best, model = counter
    assert model.unsigned == ("y",)
    assert not model.curves
    assert run_fit(model, held) > best - 1.0
    assert "without its sign" in " ".join(model.notes)


def test_a_level_that_is_never_negative_has_lost_no_sign():
    """It is positive because the machine is: an input of both signs about a resting flow."""
    random = np.random.default_rng(5)
    u = np.repeat(random.uniform(-1.0, 1.0, 80), 15)
    y = lfilter([0.0, 0.05], [1.0, -0.95], u)
    y = y - y.min() + 0.01 * random.normal(size=len(y)) ** 2
    data = Dataset((Experiment.from_arrays("tank", 1.0, inputs={"u": u}, outputs={"y": y}),))
    assert may_lack_signs(data, "y")  # nothing in the readings alone speaks against it
    assert lost_signs(data, "y") is None
    assert wb.HammersteinWiener(nodes=(3,)).look(data).unsigned == ()


def test_predictions_read_nothing_that_comes_later(counter):
    """Signs follow from what was predicted before: a reading changed at k changes no prediction up to k."""
    _, held, _, model = counter
    e = held.experiments[0]
    whole = model.predict(e)
    for k in (300, 777):
        values = e.values.copy()
        values[k:, e.names.index("y")] *= 1.7
        changed = Experiment(e.name, e.t, e.channels, values, e.dt)
        np.testing.assert_array_equal(model.predict(changed)[: k + 1], whole[: k + 1])
        ahead = model.predict(changed, 10)
        np.testing.assert_array_equal(ahead[: k + 1], model.predict(e, 10)[: k + 1])
        assert not np.array_equal(ahead[k + 11 :], model.predict(e, 10)[k + 11 :])


def test_a_free_run_reads_outputs_in_its_warm_up_only(counter):
    _, held, _, model = counter
    e = held.experiments[0]
    values = e.values.copy()
    values[model.warmup :, e.names.index("y")] = 0.1
    changed = Experiment(e.name, e.t, e.channels, values, e.dt)
    np.testing.assert_array_equal(model.simulate(changed), model.simulate(e))


@pytest.mark.slow
def test_units_change_nothing(fan):
    _, data, held, _, model = fan

    def scaled(dataset: Dataset) -> Dataset:
        made = [Experiment.from_arrays(e.name, e.dt, inputs={"u": 1e4 * e["u"]}, outputs={"y": 1e-6 * e["y"]}) for e in dataset]
        return Dataset(tuple(made))

    other = wb.HammersteinWiener().fit(scaled(data))
    np.testing.assert_allclose(run_fit(other, scaled(held)), run_fit(model, held), atol=0.3)
    u = np.linspace(-0.9, 0.9, 19)
    np.testing.assert_allclose(other.curves[0](1e4 * u), 1e4 * model.curves[0](u), rtol=0, atol=2e2)


def test_each_input_has_its_own_curve():
    random = np.random.default_rng(8)
    records = []
    for name in "ab":
        u = np.stack([np.repeat(random.uniform(-1.0, 1.0, 100), n)[:1200] for n in (12, 17)], axis=1)
        first = lfilter([0.0, 0.2], [1.0, -0.8], CURVES["square"](u[:, 0]))
        second = lfilter([0.0, 0.1], [1.0, -0.9], u[:, 1])
        y = np.stack([first + 0.5 * second, second - 0.3 * first], axis=1) + 0.005 * random.normal(size=(1200, 2))
        inputs, outputs = {"u1": u[:, 0], "u2": u[:, 1]}, {"y1": y[:, 0], "y2": y[:, 1]}
        records.append(Experiment.from_arrays(name, 0.1, inputs=inputs, outputs=outputs))
    model = wb.HammersteinWiener(nodes=(9,)).fit(Dataset(tuple(records[:1])))
    curves = {curve.input: curve for curve in model.curves}
    assert straightened(curves["u1"], CURVES["square"]) < 0.03
    assert "u2" not in curves  # straight
    assert min(s.FIT for s in score(model, Dataset(tuple(records[1:])), "held-out", ["free-run"])) > 95.0


@pytest.mark.slow
def test_a_core_may_be_scheduled():
    """A fan whose gain grows with a schedule: neither a curve alone nor a schedule alone follows it."""
    random = np.random.default_rng(9)
    records = []
    for name in "abc":
        u, rho = np.repeat(random.uniform(-0.2, 1.0, 120), 15), 1.0 + np.abs(np.sin(np.arange(1800) / 250.0))
        v, z = CURVES["fan"](u), np.zeros(1800)
        for k in range(1, 1800):
            z[k] = 0.9 * z[k - 1] + 0.1 * rho[k - 1] * v[k - 1]
        y = z + 0.005 * random.normal(size=1800)
        records.append(Experiment.from_arrays(name, 0.1, inputs={"u": u}, outputs={"y": y}, schedule={"rho": rho}))
    data, held = Dataset(tuple(records[:2])), Dataset(tuple(records[2:]))
    model = wb.HammersteinWiener(core=wb.SSM(order=1)).fit(data)
    assert run_fit(model, held) > 95.0
    assert run_fit(wb.SSM(order=1).fit(data), held) < 90.0
    assert run_fit(wb.HammersteinWiener(core=wb.LTI(resamples=0)).fit(data), held) < 90.0


def test_small_motions_are_those_of_the_run(fan):
    """to_control about u = 0.5 against the difference of two runs about it."""
    *_, model = fan
    steps = {}
    for du in (-1e-3, 1e-3):
        u = np.full(400, 0.5)
        u[200:] += du
        rest = np.zeros(400)
        steps[du] = model.core.simulate(model.curved(Experiment.from_arrays("s", 0.05, inputs={"u": u}, outputs={"y": rest})))
    measured = (steps[1e-3] - steps[-1e-3])[199:, 0] / 2e-3
    system = model.to_control(u=[0.5])
    x, expected = np.zeros(model.order), []
    for _ in range(201):
        expected.append(float((system.C @ x)[0]))
        x = system.A @ x + system.B[:, 0]
    np.testing.assert_allclose(measured[1:], expected[:-1], atol=1e-9 + 1e-6 * np.abs(expected).max())


def test_a_saved_model_is_the_same_and_foreign_files_are_named(fan, tmp_path):
    *_, held, _, model = fan
    model.save(tmp_path / "hw.json")
    read = load_hammerstein(tmp_path / "hw.json")
    np.testing.assert_array_equal(read.simulate(held.experiments[0]), model.simulate(held.experiments[0]))
    assert read.notes == model.notes
    assert read.trained_on == model.trained_on
    with pytest.raises(InputError, match="behind its curves"):
        wb.load_model(tmp_path / "hw.json")
    model.core.save(tmp_path / "core.json")
    with pytest.raises(InputError, match="not a Hammerstein-Wiener model"):
        load_hammerstein(tmp_path / "core.json")


def test_an_own_record_is_not_held_out(fan):
    _, data, *_, model = fan
    with pytest.raises(InputError, match="made from this record"):
        score(model, data, "held-out")


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: wb.HammersteinWiener(nodes=(2,)), "2 nodes"),
        (lambda: Curve("u", np.array([0.0, 0.0]), np.array([0.0, 1.0])), "nodes of a curve"),
        (lambda: Curve("u", np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 0.5])).inverse(np.array(0.7)), "several u"),
    ],
)
def test_what_cannot_be_is_refused(make, said):
    with pytest.raises(InputError, match=said):
        make()


def test_a_curve_is_its_own_inverse_where_it_rises():
    curve = Curve("u", np.array([-1.0, 0.0, 2.0]), np.array([-3.0, 0.0, 1.0]))
    u = np.linspace(-2.0, 3.0, 41)
    np.testing.assert_allclose(curve.inverse(curve(u)), u, atol=1e-12)


def test_the_command_identifies_compares_and_designs(fan, tmp_path, capsys):
    _, data, held, *_ = fan
    files = []
    for e in (*data, *held):
        files.append(str(tmp_path / f"{e.name}.csv"))
        wb.write_csv(e, Path(files[-1]))
    roles = ["--inputs", "u", "--output", "y"]
    asked = ["--model", "hammerstein", "--order", "2", "--holdout", files[2], *roles, "--out", str(tmp_path / "o")]
    assert main(["identify", *files[:2], *asked]) == 0
    assert "static curve of u" in capsys.readouterr().out
    assert "Static curves" in (tmp_path / "o" / "report.html").read_text(encoding="utf-8")
    model = str(tmp_path / "o" / "hammerstein.json")
    assert main(["compare", model, "--holdout", files[2], "--out", str(tmp_path / "c")]) == 0
    assert main(["design", "pid", "--model", model, "--out", str(tmp_path / "d")]) == 0
    assert "note: the curve of u stands still from -" in capsys.readouterr().out  # a fan does not turn backwards


@pytest.mark.slow
def test_identify_speaks_of_curves_where_linear_models_do_badly(fan):
    _, data, held, *_ = fan
    found = wb.identify(data, held)
    assert set(found.models) <= {"lti", "ssm", "oe"}  # which every design takes
    assert any("--model hammerstein" in remark for remark in found.remarks)


@pytest.mark.slow
def test_of_long_records_the_beginnings_are_looked_at():
    """More data must not mean less help."""
    machine = Machine(11, "square")
    long = [machine.record(name, 3000)[0] for name in "abc"]
    remarks = wb.identify(Dataset(tuple(long[:2])), Dataset((long[2],))).remarks
    assert any("of the first 5000 of 6000 samples" in remark and "--model hammerstein" in remark for remark in remarks)


@pytest.mark.slow
def test_identify_takes_signs_where_nothing_else_follows(counter):
    data, held, best, _ = counter
    found = wb.identify(data, held)
    assert isinstance(found.model, HammersteinWienerModel)
    assert run_fit(found.model, held) > best - 1.0


@pytest.mark.slow
def test_a_pulse_counter_of_a_real_machine_is_recognised():
    if not DRIVES.is_dir():
        pytest.skip("no records of the coupled drives in ../shared/data/real")
    roles = {"inputs": "u", "outputs": "y"}
    data = wb.read(DRIVES / "run2_train.csv", DRIVES / "run3_train.csv", **roles)
    held = wb.read(DRIVES / "run2_test.csv", DRIVES / "run3_test.csv", **roles)
    model = wb.identify(data, held, accept=True).model  # on run 3 its predictor errs more than its free run, and that is said
    assert isinstance(model, HammersteinWienerModel)
    assert model.unsigned == ("y",)
    fits = [s.FIT for s in score(model, held, "held-out", ["free-run"])]
    assert fits[0] > 75.0
    assert fits[1] > 35.0


def test_an_output_that_no_input_moves_gets_no_model():
    """Noise with a long memory: curves run a little less badly than none, and both worse than the mean."""
    for seed in range(4):
        random = np.random.default_rng(seed)
        u, y = np.repeat(random.uniform(-1.0, 1.0, 40), 15), lfilter([1.0], [1.0, -0.95], random.normal(size=600))
        data = Dataset((Experiment.from_arrays("noise", 0.1, inputs={"u": u}, outputs={"y": y}),))
        with pytest.raises(InputError):
            wb.HammersteinWiener().fit(data)


@pytest.mark.slow
def test_coloured_noise_makes_few_curves():
    """A straight machine and two parts to judge by: chance favours some curve now and then, on one record of six at most."""
    claimed = 0
    for seed in range(6):
        random = np.random.default_rng(seed)
        u = np.repeat(random.uniform(-1.0, 1.0, 40), 15)
        z = lfilter([0.0, 0.1], [1.0, -0.9], u)
        y = z + 0.2 * np.std(z) * np.sqrt(1.0 - 0.9**2) * lfilter([1.0], [1.0, -0.9], random.normal(size=600))
        data = Dataset((Experiment.from_arrays("coloured", 0.1, inputs={"u": u}, outputs={"y": y}),))
        claimed += wb.HammersteinWiener().look(data).nodes > 0
    assert claimed <= 1


def test_an_input_without_need_has_no_curve():
    random = np.random.default_rng(21)
    u = np.stack([np.repeat(random.uniform(-1.0, 1.0, 100), n)[:1200] for n in (12, 17)], axis=1) * [1.0, 0.02]
    y = lfilter([0.0, 0.2], [1.0, -0.8], CURVES["square"](u[:, 0]) + u[:, 1]) + 0.01 * random.normal(size=1200)
    data = Dataset((Experiment.from_arrays("a", 0.1, inputs={"u1": u[:, 0], "u2": u[:, 1]}, outputs={"y": y}),))
    assert [curve.input for curve in wb.HammersteinWiener(nodes=(5,)).fit(data).curves] == ["u1"]


def test_rest_at_first_is_no_crash():
    """All that is looked at of a long record is 0."""
    u = np.concatenate([np.zeros(3300), np.repeat(np.random.default_rng(2).uniform(-1.0, 1.0, 380), 15)])
    y = np.abs(lfilter([0.0, 0.1], [1.0, -0.9], u))
    assert lost_signs(Dataset((Experiment.from_arrays("late", 0.1, inputs={"u": u}, outputs={"y": y}),)), "y") is None


def test_what_leaves_the_nodes_is_said_and_a_clean_sensor_is_not_too_good(fan):
    machine, data, _, _, model = fan
    u = 2.0 * np.repeat(machine.random.uniform(-1.0, 1.0, 80), 15)
    y = lfilter(machine.num, machine.den, machine.curve(u))
    wide = Dataset((Experiment.from_arrays("wide", 0.05, inputs={"u": u}, outputs={"y": y}),))
    found = wb.identify(data, wide, methods={"hammerstein": wb.HammersteinWiener(nodes=(9,))})
    assert any("goes straight on" in remark for remark in found.remarks)
    assert not found.results[0].against
    with pytest.raises(InputError, match="2 inputs"):
        model.to_control(u=[0.1, 0.2])
