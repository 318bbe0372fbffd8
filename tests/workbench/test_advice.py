"""Advice: each kind is given where it holds and only there; closed loops are found at a calibrated level."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import chirp, lfilter

from workbench.advice import advise, feedback, quantum
from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.readers import read_file

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"


def run(seed: int, gain: float, *, count: int = 1500, hold: int = 1, soft: float = 0.0) -> Experiment:
    """x+ = 1.5 x - 0.56 x- + 0.06 u / (1 + soft x^2), y = x + colour, u = d - gain y - integral: closed for gain > 0."""
    g = np.random.default_rng(seed)
    u, y = np.zeros(count), np.zeros(count)
    d = np.repeat(g.choice([-1.0, 1.0], count // hold + 1), hold)[:count]
    e = 0.3 * g.standard_normal(count)
    x = before = colour = integral = 0.0
    for k in range(count):
        colour = 0.8 * colour + e[k]
        y[k] = x + colour
        integral += 0.05 * gain * y[k]
        u[k] = d[k] - gain * y[k] - integral
        x, before = 1.5 * x - 0.56 * before + 0.06 * u[k] / (1.0 + soft * x * x), x
    return Experiment.from_arrays("run", 0.1, inputs={"u": u}, outputs={"y": y})


# held inputs and a nonlinear plant break tests that take the input's linear residual for white everywhere
@pytest.mark.parametrize(("hold", "soft"), [(1, 0.0), (5, 0.0), (5, 1.0)])
def test_open_loop_records_are_not_flagged(hold, soft):
    assert sum(feedback(run(seed, 0.0, hold=hold, soft=soft)).detected for seed in range(60)) <= 3


@pytest.mark.parametrize("hold", [1, 5])
def test_closed_loop_records_are_flagged(hold):
    assert sum(feedback(run(seed, 1.0, hold=hold)).detected for seed in range(60)) >= 58


def test_the_pair_that_closes_the_loop_is_named():
    closed, free = run(1, 1.0), run(2, 0.0)
    both = Experiment.from_arrays(
        "run", 0.1, inputs={"free": free["u"], "u": closed["u"]}, outputs={"z": free["y"], "y": closed["y"]}
    )
    found = feedback(both)
    assert (found.input, found.output) == ("u", "y")
    assert found.lag >= 1


def test_a_fixed_law_in_a_logged_set_point_is_a_closed_loop():
    g = np.random.default_rng(5)
    count = 600
    r = np.repeat(g.choice([-1.0, 1.0], count // 20), 20)
    u, y = np.zeros(count), np.zeros(count)
    for k in range(1, count):  # no noise at all: there are no innovations to answer
        y[k] = 0.9 * y[k - 1] + 0.1 * u[k - 1]
        u[k] = 2.0 * (r[k] - y[k])
    made = Experiment.from_arrays("run", 0.1, inputs={"u": u}, outputs={"y": y}, references={"y_set": r})
    assert feedback(made).detected
    idle = Experiment.from_arrays("run", 0.1, inputs={"u": run(1, 0.0)["u"][:count]}, outputs={"y": y}, references={"y_set": r})
    assert feedback(idle).law > 0.5


def test_feedback_needs_an_input_an_output_and_samples():
    record = run(1, 0.0, count=300)
    with pytest.raises(InputError, match="no input or no output"):
        feedback(record.select(["y"]))
    with pytest.raises(InputError, match="too few"):
        feedback(record.trim(stop=3.0))


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "emps").is_dir(), reason="measured data not here: expected ../shared/data/emps")
def test_the_measured_axis_is_known_to_run_in_closed_loop():
    assert feedback(read_file(DATA / "emps" / "DATA_EMPS.mat")).detected


def course(kind: str, count: int, g: np.random.Generator) -> np.ndarray:
    """An input of a laboratory (count)."""
    k, step = np.arange(count), int(g.integers(20, 200))
    match kind:
        case "coloured":
            return lfilter([1], [1, -0.95], g.standard_normal(count))
        case "multisine":  # all frequencies up to the highest, three periods
            phase = g.uniform(0, 2 * np.pi, 249)
            return np.cos(2 * np.pi * np.outer(k, np.arange(1, 250)) / 500 + phase).sum(axis=1)
        case "steps":
            return np.repeat(g.uniform(-1, 1, count // step + 1), step)[:count]
        case "smoothed steps":
            return lfilter([0.2], [1, -0.8], np.repeat(g.uniform(-1, 1, count // step + 1), step)[:count])
        case "chirp":
            return chirp(k, 0.001, count, g.uniform(0.1, 0.3))
        case _:
            return np.interp(k, np.arange(0, count + step, step), g.uniform(-1, 1, len(np.arange(0, count + step, step))))


def answer(kind: str, u: np.ndarray) -> np.ndarray:
    """What a machine makes of it (N,)."""
    match kind:
        case "lightly damped":
            return lfilter([0, 0.05], [1, -1.9, 0.96], u)
        case "integrating":
            return 0.01 * np.cumsum(u)
        case "square":
            return lfilter([0, 0.1], [1, -0.9], (u / np.std(u)) ** 2)
        case _:
            x, state = np.zeros(len(u)), 0.0
            for k in range(len(u) - 1):
                state += 0.1 * (u[k] / np.std(u) - state - 2.0 * abs(state) * state)
                x[k + 1] = state
            return x


@pytest.mark.parametrize("machine", ["lightly damped", "integrating", "square", "nonlinear"])
@pytest.mark.parametrize("kind", ["coloured", "multisine", "steps", "smoothed steps", "chirp", "ramps"])
def test_open_loop_is_not_called_feedback_whatever_the_input_and_the_machine(kind, machine):
    """A linear model misses something of them, and what it misses goes with an input that can be told from its past."""
    alarms = 0
    for seed in range(4):
        g = np.random.default_rng(seed)
        u = course(kind, 1500, g)
        x = answer(machine, u)
        drift = np.cumsum(g.standard_normal(1500))
        for noise in (0.0 * u, 0.05 * np.std(x) * g.standard_normal(1500), 0.2 * np.std(x) * drift / np.std(drift)):
            alarms += feedback(Experiment.from_arrays("open", 0.1, inputs={"u": u}, outputs={"y": x + noise})).detected
    assert alarms <= 1


@pytest.mark.parametrize("kind", ["coloured", "steps", "chirp"])
def test_a_loop_is_found_under_every_set_point(kind):
    found = 0
    for seed in range(8):
        g = np.random.default_rng(seed)
        r, colour = 0.3 * course(kind, 1500, g), lfilter([0.3], [1, -0.8], g.standard_normal(1500))
        u, y = np.zeros(1500), np.zeros(1500)
        x = before = 0.0
        for k in range(1500):
            y[k] = x + colour[k]
            u[k] = r[k] - y[k - 1]  # computed within a sample; y[-1] is 0 still
            x, before = 1.5 * x - 0.56 * before + 0.06 * u[k], x
        found += feedback(Experiment.from_arrays("closed", 0.1, inputs={"u": u}, outputs={"y": y})).detected
    assert found >= 7


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "real").is_dir(), reason="measured data not here: expected ../shared/data/real")
@pytest.mark.parametrize(
    ("file", "u", "y"),
    [("silverbox/multisine_train", "V1", "V2"), ("silverbox/arrow", "V1", "V2"), ("quarter_drone/multisine", "u", "angle"),
     ("cascaded_tanks/est", "u", "y"), ("coupled_drives/run1", "u", "y"), ("ball_and_hoop/random_a", "u", "w")],
)  # fmt: skip
def test_benchmarks_that_were_run_open_are_not_called_closed(file, u, y):
    assert not feedback(read_file(DATA / "real" / f"{file}.csv").with_roles([u], [y])).detected


# ---- the other kinds -------------------------------------------------------------------------------------------------


def kinds(*records: Experiment, order: int | None = None) -> dict[str, str]:
    """Channel by kind of advice."""
    return {found.kind: found.channel for found in advise(Dataset(records), order=order)}


def made(y: np.ndarray, unit: str = "", u: np.ndarray | None = None, **schedule: np.ndarray) -> Experiment:
    u = np.random.default_rng(9).choice([-1.0, 1.0], len(y)) if u is None else u
    return Experiment.from_arrays(
        "run", 0.1, inputs={"u": u}, outputs={"y": y}, schedule=schedule, units={"y": unit} if unit else None
    )


NOISE = np.random.default_rng(8).standard_normal(1000)
SINE = np.sin(np.arange(1000) / 30.0)


def test_a_good_record_gets_no_advice():
    assert not advise(Dataset((run(3, 0.0),)), order=4)


def test_constant_channels_are_named():
    assert kinds(made(0 * NOISE + 3.0)) == {"constant": "y"}
    assert kinds(made(NOISE, u=np.ones(1000)))["constant"] == "u"


def test_clipping_is_many_equal_samples_in_runs_at_an_end():
    assert kinds(made(np.minimum(SINE + 0.01 * NOISE, 0.8)))["clipped"] == "y"
    assert kinds(made(np.maximum(SINE + 0.01 * NOISE, -0.8)))["clipped"] == "y"
    (own,) = [own for own in advise(Dataset((made(NOISE, u=np.minimum(SINE + 0.01 * NOISE, 0.8)),))) if own.kind == "clipped"]
    assert (own.channel, own.severity) == ("u", "note")  # a command at its stop is a sound record
    assert "clipped" not in kinds(made(SINE + 0.01 * NOISE))
    assert "clipped" not in kinds(made(np.round(SINE, 1) + 0.0))  # coarse steps dwell at the ends
    assert "clipped" not in kinds(made(np.sign(NOISE)))  # switched between two levels


@pytest.mark.parametrize("step", [0.05, 1 / 64, 0.0123])
def test_the_quantum_of_a_channel_is_its_step(step):
    assert quantum(0.3 + step * np.round(SINE / step)) == pytest.approx(step, rel=1e-9)
    assert quantum(SINE) == 0.0
    few = np.random.default_rng(0).integers(-2000, 2000, 500)  # hardly two samples on one level
    assert quantum(0.3 + step * few) == pytest.approx(step, rel=1e-9)
    assert kinds(made(step * np.round(SINE / step)))["quantum"] == "y"
    fine_steps = 1e-3 * np.round(1000 * (SINE + 0.1 * NOISE))
    assert "quantum" not in kinds(made(fine_steps))  # finer than the noise: no matter


def test_single_samples_that_stand_out_are_outliers_and_steps_are_not():
    spike = SINE + 0.01 * NOISE
    spike[500] += 3.0
    assert kinds(made(spike))["outliers"] == "y"
    assert "outliers" not in kinds(made(SINE + 0.01 * NOISE + 3.0 * (np.arange(1000) > 500)))


def test_implausible_magnitudes_suggest_the_unit():
    (found,) = [a for a in advise(Dataset((made(100 + NOISE, "m"),))) if a.kind == "magnitude"]
    assert "is it in mm?" in found.sentence
    assert found.severity == "note"
    assert "magnitude" not in kinds(made(1 + 0.1 * NOISE, "m"))


def stamped(t: np.ndarray) -> Experiment:
    return Experiment("run", t, (Channel("y", "", "output"),), np.random.default_rng(1).standard_normal((len(t), 1)), 1.0)


def test_jitter_and_faults_of_the_stamps():
    t = np.arange(100.0)
    assert "jitter" not in kinds(stamped(t + 0.004 * (np.arange(100) % 2)))
    assert kinds(stamped(t + 0.05 * (np.arange(100) % 2)))["jitter"] == "t"
    for fault, bad in (("gap", t + 5.0 * (t > 50)), ("repeated", t - (t > 50)), ("backwards", t - 3.0 * (t > 50))):
        sentences = [a.sentence for a in advise(Dataset((stamped(bad),))) if a.kind == "stamps"]
        assert len(sentences) == 1
        assert fault in sentences[0]


def test_a_poor_input_is_named():
    assert kinds(made(NOISE, u=1.0 * (np.arange(1000) > 500)))["excitation"] == "u"  # one step
    assert kinds(made(NOISE, u=SINE))["excitation"] == "u"  # one sine excites two directions
    assert "excitation" not in kinds(made(NOISE))


def test_two_inputs_that_move_together_are_a_poor_input():
    u = np.random.default_rng(9).choice([-1.0, 1.0], 1000)
    twins = Experiment.from_arrays("run", 0.1, inputs={"a": u, "b": 2 * u}, outputs={"y": NOISE})
    assert kinds(twins)["excitation"] == "a, b"


def test_too_short_depends_on_the_order_asked():
    record = run(3, 0.0, count=150)
    assert "too-short" not in kinds(record, order=2)
    assert "too-short" in kinds(record, order=20)
    assert "too-short" not in kinds(record)


def test_the_span_of_the_schedule_is_that_of_all_records():
    low, high = made(NOISE, r2=np.linspace(0.05, 0.07, 1000)), made(2 * NOISE, r2=np.linspace(0.1, 0.12, 1000))
    (found,) = [a for a in advise(Dataset((low, high))) if a.kind == "schedule-span"]
    assert "from 0.05 to 0.12" in found.sentence
    assert found.severity == "note"
    (still,) = [a for a in advise(Dataset((made(NOISE, r2=0.1 + 1e-6 * NOISE),))) if a.kind == "schedule-span"]
    assert still.severity == "warning"


def test_a_held_command_is_not_clipped_at_its_largest_level():
    for seed in range(10):
        u = np.repeat(np.random.default_rng(seed).uniform(-1.0, 1.0, 60), 20)
        held = np.append(u, u[-1])[10::20]  # means over windows that meet the steps
        for x in (u, np.convolve(u, np.ones(4) / 4, "valid"), np.repeat(held, 20)):
            e = Experiment.from_arrays("a", 0.01, inputs={"u": x})
            assert not [a for a in advise(Dataset((e,))) if a.kind == "clipped"]
        clipped = np.clip(np.sin(0.05 * np.arange(1200)), -2.0, 0.8)
        assert [a.kind for a in advise(Dataset((Experiment.from_arrays("a", 0.01, outputs={"y": clipped}),)))].count(
            "clipped"
        ) == 1
