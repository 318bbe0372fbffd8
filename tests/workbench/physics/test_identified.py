"""An identified model as a plant: the same numbers as the model's own simulation, prediction and file."""

from dataclasses import replace

import numpy as np
import pytest

from tests.workbench.diagnosis.black_box import DT, MODEL, PLANT, V1, V2, R, W, records
from workbench.basis import CONSTANT, Gaussian, PiecewiseLinear, Powers
from workbench.curves import Curve
from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis.predictor import Noise, predictor
from workbench.errors import InputError
from workbench.hammerstein import HammersteinWienerModel, Model
from workbench.lpv import LPVModel, OperatingPoint, Term, constant_model
from workbench.physics.controller import Playback
from workbench.physics.extension import extension, load_extension
from workbench.physics.identified import identified
from workbench.simulation import replay, simulate

RECORD = records(1, count=1).experiments[0]
BASES = [
    Powers([0.0, 1.0, -1.0], 0.1),
    Gaussian([0.06, 0.1, 0.14], [900.0, 900.0, 400.0], normalised=True),
    Gaussian([0.07, 0.12], [900.0, 900.0], with_constant=True),
    PiecewiseLinear([0.06, 0.09, 0.14]),
]


def before(rho: float, plant=PLANT) -> dict[str, float]:
    """The schedule has stood at its first value."""
    return dict.fromkeys((name for name in plant.state_names if "before" in name), rho)


def any_model(basis, delays=(0, 2), schedule=R) -> LPVModel:
    """Matrices of all terms drawn at random, with feedthrough and an operating point that moves with the schedule."""
    random, m = np.random.default_rng(4), len(basis.names)
    terms = tuple(Term(j, d) for j in range(m) for d in delays)
    shapes = {"A": (3, 3), "B": (3, 2), "C": (2, 3), "D": (2, 2)}
    own = {key: 0.2 * random.standard_normal((len(terms), *shape)) for key, shape in shapes.items()}
    point = OperatingPoint(basis, random.standard_normal((m, 2)), random.standard_normal((m, 2)))
    outputs = (W, Channel("T", "N", "output"))
    spans = [[0.05, 0.15]] if schedule else np.zeros((0, 2))
    return LPVModel(
        "SSM", DT, (V1, V2), outputs, (schedule,) if schedule else (), spans, basis, terms, **own, operating_point=point,
    )  # fmt: skip


def stepped(model: Model, e: Experiment) -> np.ndarray:
    """Outputs (N, ny) of the plant's equation, one sample after the other."""
    plant = identified(model)
    u = e[list(plant.input_names)]
    rho = float(e["r2"][0])
    x = np.array([before(rho, plant).get(name, 0.0) for name in plant.state_names])
    y = []
    for now in u:
        y.append(plant.output(x, None, now))
        x = x + plant.dt * np.array(plant.derivative(x, now), dtype=float)
    return np.array(y, dtype=float)


# ---- the same equation ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("basis", BASES, ids=["powers", "normalised", "gaussian", "hats"])
def test_the_plant_of_a_model_runs_free_as_the_model_does(basis):
    model = any_model(basis)
    e = replace(RECORD, channels=(*RECORD.channels, Channel("T", "N", "output")), values=RECORD.values[:, [0, 1, 2, 3, 2]])
    e = replace(e, values=np.where(np.arange(5) == 3, 1.3 * e.values - 0.02, e.values))  # beyond the span on both sides
    expected = model.simulate(e, warmup=0)
    assert np.ptp(expected, axis=0).min() > 0.1
    assert stepped(model, e) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_the_plant_of_a_model_with_curves_runs_free_as_the_model_does():
    """Any start: the first inputs are those at which it stands still, where a curve turns back the nearest."""
    core = any_model(BASES[3])
    curves = (Curve("V1", [0.0, 1.0, 2.0], [0.0, 0.4, 2.0]), Curve("V2", [0.0, 1.0, 2.0, 3.0], [0.0, 0.5, 0.3, 2.0]))
    model = HammersteinWienerModel("HW", core, curves, ("T",))
    e = replace(RECORD, channels=(*RECORD.channels, Channel("T", "N", "output")), values=RECORD.values[:, [0, 1, 2, 3, 2]])
    expected = model.shown(core.simulate(model.curved(e), warmup=0))
    assert (core.simulate(model.curved(e), warmup=0)[:, 1] < -0.01).any()
    assert stepped(model, e) == pytest.approx(expected, rel=1e-12, abs=1e-12)
    start = identified(model).start.fixed
    u0 = core.operating_point.basis(core.middle) @ core.operating_point.u
    assert {name: start[name] for name in ("V1", "V2")} == {c.input: c.nearest(v) for c, v in zip(curves, u0, strict=True)}


def test_a_schedule_that_is_an_input_needs_no_channel_of_its_own():
    model = any_model(BASES[3], schedule=V1)
    plant = identified(model)
    assert plant.input_names == plant.commanded == ("V1", "V2")
    model = replace(any_model(BASES[3], delays=(0,), schedule=V1), spans=[[-0.5, 0.5]])
    e = replace(RECORD, channels=(*RECORD.channels, Channel("T", "N", "output")), values=RECORD.values[:, [0, 1, 2, 3, 2]])
    assert stepped(model, e) == pytest.approx(model.simulate(e, warmup=0), rel=1e-12, abs=1e-12)


def test_the_compiled_run_is_the_models_own_to_rounding():
    expected = MODEL.simulate(RECORD, warmup=0)
    run = replay(PLANT, RECORD, start=before(RECORD["r2"][0]))
    assert run.experiment[["w"]] == pytest.approx(expected, rel=1e-13, abs=1e-13)
    assert "r2" in run.experiment.names


def test_more_steps_within_a_sample_change_nothing():
    runs = [replay(PLANT, RECORD, substeps=n).experiment["w"] for n in (1, 7)]
    assert runs[1] == pytest.approx(runs[0], rel=1e-13, abs=1e-13)


def test_a_model_without_schedule_needs_its_inputs_alone():
    matrices = np.array([[0.9]]), np.array([[0.1, -0.2]]), np.array([[2.0]]), np.array([[0.3, 0.0]])
    point = OperatingPoint(CONSTANT, np.array([[0.1, 0.2]]), np.array([[5.0]]))
    model = constant_model("LTI", DT, ((V1, V2), (W,)), matrices, point)
    plant = identified(model)
    assert plant.needed == ("V1", "V2")
    assert plant.state_names == ("state 1", "speed of w")  # without a predictor no noise of its own
    assert stepped(model, RECORD) == pytest.approx(model.simulate(RECORD, warmup=0), rel=1e-13)


def test_the_angle_of_a_logged_speed_is_followed():
    """Its speed is that of the sample before, so the angle is the sum of all speeds but the last."""
    made = predictor(PLANT, Dataset((RECORD,)))
    made = made.with_noise(Noise(np.array([1e-8]), made.noise.process, np.empty(0)))
    full = made.corrected(0, made.point)
    speed, angle = PLANT.state_names.index("speed of w"), len(PLANT.states) + list(PLANT.turning).index("w")
    assert full[61:, speed] == pytest.approx(RECORD["w"][60:-1], abs=1e-6)
    turned = DT * np.cumsum(RECORD["w"])
    assert full[62:, angle] - full[61, angle] == pytest.approx(turned[60:-2] - turned[59], abs=1e-5)


# ---- effects ----------------------------------------------------------------------------------------------------------------


def late(samples: int) -> Experiment:
    """The record with V1 so many samples later, at the operating point before."""
    u = RECORD["V1"]
    values = RECORD.values.copy()
    values[:, 0] = np.concatenate([np.repeat(MODEL.operating_point.u[0, 0], samples), u[: len(u) - samples]])
    return replace(RECORD, values=values)


def test_a_delay_of_whole_samples_is_the_model_on_a_shifted_input():
    run = replay(PLANT, RECORD, start=before(RECORD["r2"][0]), effects={"input-delay@V1": {"time": 2 * DT}})
    assert run.experiment[["w"]] == pytest.approx(MODEL.simulate(late(2), warmup=0), rel=1e-12, abs=1e-12)


def test_a_delay_between_samples_mixes_the_two():
    run = replay(PLANT, RECORD, start=before(RECORD["r2"][0]), effects={"input-delay@V1": {"time": 1.25 * DT}})
    one, two = (MODEL.simulate(late(n), warmup=0) for n in (1, 2))  # the model is linear in V1
    assert run.experiment[["w"]] == pytest.approx(0.75 * one + 0.25 * two, rel=1e-12, abs=1e-12)


def test_a_lag_of_a_sensor_follows_the_line_from_sample_to_sample():
    lag = 0.15
    run = replay(PLANT, RECORD, start=before(RECORD["r2"][0]), effects={"sensor-lag@w": {"time": lag}})
    rest = MODEL.operating_point.y[0]
    z = np.concatenate([rest, MODEL.simulate(RECORD, warmup=0)[:, 0]])  # it stood at the operating point before
    read = z.copy()
    for k in range(1, len(z)):
        slope = (z[k] - z[k - 1]) / DT
        end = z[k] - lag * slope
        read[k] = end + (read[k - 1] - z[k - 1] + lag * slope) * np.exp(-DT / lag)
    assert run.experiment["w"] == pytest.approx(read[1:], rel=1e-9, abs=1e-9)


def test_a_model_with_effects_is_kept_in_a_plant_file(tmp_path):
    sizes = {"offset@V2": {"level": 0.3}}
    file = extension(PLANT, "m.json", {}, sizes).save(tmp_path / "extended.json")
    again = load_extension(file).of(PLANT)
    start = before(RECORD["r2"][0])
    expected = replay(PLANT, RECORD, start=start, effects=sizes).experiment["w"]
    assert np.array_equal(replay(again, RECORD, start=start).experiment["w"], expected)


# ---- noise ------------------------------------------------------------------------------------------------------------------


def test_the_filter_of_the_plant_is_the_predictor_of_the_model():
    # without noise of the reading the only gain that the filter can find is that of the innovations form
    made = predictor(PLANT, Dataset((RECORD,)))
    made = made.with_noise(Noise(np.array([1e-8]), made.noise.process, np.empty(0)))
    at = made.point
    e = made.errors(0, at.p[None], at.eta, at.start, white=False)[0]
    expected = RECORD[["w"]] - MODEL.predict(RECORD)
    assert e[60:] == pytest.approx(expected[60:], abs=1e-6)
    assert np.std(expected[60:]) > 0.01


def test_the_plant_states_the_spread_of_the_one_step_error():
    assert PLANT.noise["w"] == pytest.approx(np.sqrt(MODEL.noise[0, 0]))
    assert PLANT.process == {"innovation of w": 1.0 / DT}


# ---- what is refused --------------------------------------------------------------------------------------------------------


def test_a_schedule_that_is_an_output_is_refused():
    with pytest.raises(InputError, match="schedule and output"):
        identified(replace(MODEL, schedules=(W,)))


def test_a_record_without_the_schedule_is_refused():
    bare = replace(RECORD, channels=RECORD.channels[:3], values=RECORD.values[:, :3])
    with pytest.raises(InputError, match="r2"):
        replay(PLANT, bare)
    with pytest.raises(InputError, match="r2"):
        predictor(PLANT, Dataset((bare,)))


def test_a_record_of_another_sample_time_is_refused():
    slow = replace(RECORD, t=2 * RECORD.t, dt=2 * DT)
    with pytest.raises(InputError, match="resample"):
        predictor(PLANT, Dataset((slow,)))
    with pytest.raises(InputError, match="resample"):
        replay(PLANT, slow)


def test_a_controller_that_reads_the_outputs_is_refused():
    from workbench.simulation import Scenario

    class Feedback(Playback):
        pass

    player = Feedback(("V1",), DT, measured=("w",))
    with pytest.raises(InputError, match="runs under given inputs, and not under"):
        simulate(PLANT, player, Scenario("closed", {"V1": np.zeros(5)}))
