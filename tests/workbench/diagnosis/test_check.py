"""Records that are not of the plant, or say nothing, are refused by name; records with missing physics are not."""

from dataclasses import replace

import numpy as np
import pytest

from plants import PLANTS
from studies.experiments import plan
from tests.workbench.diagnosis.cases import AXIS as SMALL_AXIS
from tests.workbench.diagnosis.cases import axis_records, robot_records, steps
from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis.check.likeness import likeness, nearest
from workbench.diagnosis.check.records import check
from workbench.errors import InputError
from workbench.physics.controller import Playback
from workbench.physics.parameters import Parameter
from workbench.physics.plant import Plant
from workbench.physics.rest import Start
from workbench.simulation import Scenario, simulate

WINDING, ROBOT, AXIS = (PLANTS[name] for name in ("web-winding", "welding-robot", "positioning-axis"))


def drawn(plant, experiment, seed=3, **options):
    """A record of the machine's plan, 30 s of it."""
    todo = plan(plant.name, experiment)
    return simulate(plant, todo.controller, todo.scenario(seed), **options).experiment.trim(stop=30.0)


@pytest.fixture(scope="module")
def winding():
    return drawn(WINDING, "prbs1")


def scaled(e, name, factor, unit=None):
    values = e.values.copy()
    values[:, e.names.index(name)] *= factor
    channels = tuple(replace(c, unit=unit) if c.name == name and unit is not None else c for c in e.channels)
    return replace(e, values=values, channels=channels)


def exchanged(e, a, b):
    values, i, j = e.values.copy(), e.names.index(a), e.names.index(b)
    values[:, [i, j]] = values[:, [j, i]]
    return replace(e, values=values)


def refused(plant, *records):
    with pytest.raises(InputError) as reason:
        check(plant, Dataset(records))
    return reason.value


# ---- what passes ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
def test_records_of_the_plant_pass_without_a_word(plant):
    names = {"web-winding": ("rbs", "rgs"), "welding-robot": ("prbs", "steps"), "positioning-axis": ("prbs", "steps")}[plant.name]
    assert check(plant, Dataset(tuple(drawn(plant, name) for name in names))) == ()


@pytest.mark.parametrize("experiment", ["prbs1", "ramp", "staircase"])
def test_missing_physics_and_a_nominal_model_that_is_off_are_no_reason_to_refuse(experiment):
    effects = {"coulomb@rewind": {"level": 0.01}, "sensor-lag@theta": {"time": 0.05}, "saturation@V2": {"limit": 4.0}}
    e = drawn(WINDING, experiment, parameters={"kT": 0.022, "kE": 250.0, "B1": 2.6e-5}, effects=effects)
    check(WINDING, Dataset((e,)))


def test_dry_friction_of_ten_times_the_usual_size_is_no_reason_to_refuse():
    check(AXIS, Dataset((drawn(AXIS, "prbs", effects={"coulomb@slide": {"level": 45.0}}),)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("records", "plant", "effect", "size"),
    [
        (robot_records, ROBOT, "saturation@u", {"limit": 0.2}),
        (robot_records, ROBOT, "dead-zone@u", {"half_width": 3.0}),
        (robot_records, ROBOT, "coulomb@rail", {"level": 2.0}),
        (axis_records, SMALL_AXIS, "saturation@F", {"limit": 20.0}),
        (axis_records, SMALL_AXIS, "coulomb@slide", {"level": 300.0}),
        (axis_records, SMALL_AXIS, "quadratic-friction@slide", {"coefficient": 3000.0}),
    ],
)
def test_an_effect_of_the_catalogue_is_never_refused_however_strong(records, plant, effect, size):
    """They look like commands up to twenty times too large; what is mended so comes out with another cause."""
    for seed in (3, 5, 6, 7, 8):
        check(plant, records(seed, {effect: size}))


@pytest.mark.parametrize(
    ("effect", "size"),
    [
        ("saturation@V2", {"limit": 1.0}),
        ("dead-zone@V1", {"half_width": 2.0}),
        ("dead-zone@V2", {"half_width": 4.0}),
        ("coulomb@unwind", {"level": 0.05}),
        ("quadratic-friction@rewind", {"coefficient": 1e-4}),
    ],
)
def test_no_strong_effect_of_the_winding_machine_is_refused(effect, size):
    """A reel that sticks looks like V1 in mV, and like no V1 at all: nothing is said of the unit."""
    notes = check(WINDING, Dataset((drawn(WINDING, "staircase", effects={effect: size}),)))
    assert any("missing physics as large" in note.sentence for note in notes)
    assert (effect == "coulomb@unwind") == any("V1: looks cut off" in str(note) for note in notes)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 120, 40))
def test_a_pump_of_another_gain_is_not_taken_for_the_other_one(first):
    """Two pumps that move together, as under feedback, one of them at half or twice its gain, and one level that is measured."""
    for seed in range(first, first + 40):
        random = np.random.default_rng(seed)
        share, rates = random.uniform(0.2, 0.8, 2), np.exp(random.uniform(-1.0, 1.0, 4))
        plant = Plant(
            "two tanks",
            (Channel("h1", "cm"), Channel("h2", "cm")),
            (Channel("v1", "V", "input"), Channel("v2", "V", "input")),
            (Channel("level", "cm", "output"),),
            tuple(Parameter(f"c{k}", value, "", 0.3) for k, value in enumerate((*rates, *share))),
            lambda x, u, p, at: {
                "h1": p.c2 * p.c4 * u.v1 + p.c3 * (1.0 - p.c5) * u.v2 - p.c0 * x.h1,
                "h2": p.c3 * p.c5 * u.v2 + p.c2 * (1.0 - p.c4) * u.v1 - p.c1 * x.h2,
            },
            lambda x, p: {"level": x.h1},
            0.1,
            noise={"level": 0.01},
        )
        hold = int(random.integers(10, 100))
        common = steps(600, 1.0, 3 * seed, hold)
        pumps = {
            name: random.uniform(2.0, 5.0) + random.choice([-1.0, 1.0]) * random.uniform(0.5, 1.0) * common
            + steps(600, 0.1, 3 * seed + k, hold)
            for k, name in enumerate(("v1", "v2"), 1)
        }  # fmt: skip
        other = random.choice(["v1", "v2"])
        acting = pumps | {other: random.choice([0.5, 2.0]) * pumps[other]}
        e = simulate(plant, Playback(("v1", "v2"), 0.1), Scenario("run", acting, seed=seed)).experiment
        values = e.values.copy()
        values[:, [e.names.index(name) for name in pumps]] = np.column_stack([*pumps.values()])
        check(plant, Dataset((replace(e, values=values),)))  # refuses none


def test_a_dead_zone_that_takes_all_or_nearly_all_is_noted():
    """Records of steps that stay below 3 N, or go beyond it twice."""
    said = {seed: [str(n) for n in check(ROBOT, robot_records(seed, {"dead-zone@u": {"half_width": 3.0}}))] for seed in (6, 8)}
    assert said[6] == ["robot 0, v: moves no more than its noise: a dead zone or dry friction may take all of u"]
    assert said[8] == ["robot 0, v: follows the peaks of u only: a dead zone or dry friction may take the rest"]


def test_a_dead_channel_beside_live_ones_is_a_note(winding):
    (note,) = check(WINDING, Dataset((scaled(winding, "w1", 0.0),)))
    assert (note.record, note.channel) == ("prbs1", "w1")
    assert "constant at 0" in note.sentence


# ---- units ----------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("channel", "factor", "unit"),
    [
        ("w1", 30 / np.pi, "rpm"),
        ("w2", 180 / np.pi, "deg/s"),
        ("w3", 30 / np.pi, "rpm"),
        ("theta", np.pi / 180, "rad"),
        ("r2", 1000.0, "mm"),
        ("V1", 1000.0, "mV"),
        ("V2", 1000.0, "mV"),
    ],
)
def test_a_unit_is_told_by_its_size_although_the_header_says_another(winding, channel, factor, unit):
    reason = refused(WINDING, scaled(winding, channel, factor))
    assert f"looks like {unit}" in reason.problem
    assert channel in str(reason)
    assert f"{1 / factor:.6g}" in reason.mend


def test_a_unit_is_told_by_its_size_on_a_machine_with_missing_physics():
    e = drawn(WINDING, "prbs1", parameters={"kT": 0.022}, effects={"coulomb@rewind": {"level": 0.004}})
    assert "looks like rpm" in refused(WINDING, scaled(e, "w3", 30 / np.pi)).problem


def test_a_declared_unit_is_refused_with_its_factor(winding):
    reason = refused(WINDING, scaled(winding, "w3", 30 / np.pi, unit="rpm"))
    assert "unit is rpm, expected rad/s" in reason.problem


def test_an_axis_in_millimetres_and_an_arm_in_degrees():
    assert "looks like mm" in refused(AXIS, scaled(drawn(AXIS, "prbs"), "q", 1000.0)).problem
    reason = refused(ROBOT, scaled(drawn(ROBOT, "prbs"), "arm", 180 / np.pi))
    assert (reason.channel, reason.problem) == ("arm", "looks like deg, expected rad")


@pytest.mark.slow
def test_with_one_input_and_one_output_both_may_be_in_another_unit():
    """The encoder of this axis states no noise: force and position are as likely to be wrong, and the mend names both."""
    for effects in ({}, {"coulomb@slide": {"level": 20.0}}):
        reason = refused(AXIS, scaled(drawn(AXIS, "prbs", effects=effects), "F", 1000.0))
        assert reason.problem == "F looks like mN, expected N, or q looks like km, expected m"
        assert "multiply F by 0.001" in reason.mend
        assert "multiply q by 1000" in reason.mend
        assert reason.mend.endswith("these records do not tell which")


@pytest.mark.slow
@pytest.mark.parametrize("effects", [{}, {"coulomb@rail": {"level": 0.2}, "arm-gravity@rail": {"sine": 0.3}}])
def test_noise_tells_a_reading_in_another_unit_from_a_command_in_another(effects):
    """1000 v under u is v under u/1000, but for the noise of v."""
    e = drawn(ROBOT, "prbs", effects=effects)
    reading, command = refused(ROBOT, scaled(e, "v", 1000.0)), refused(ROBOT, scaled(e, "u", 0.001))
    assert (reading.channel, reading.problem) == ("v", "looks like mm/s, expected m/s")
    assert reading.mend == "multiply v by 0.001 and write v [m/s] in the header"
    assert (command.channel, command.problem) == ("u", "looks like kN, expected N")
    for channel, factor in (("u", 180 / np.pi), ("v", np.pi / 180)):  # there is no such unit of a force or a speed
        (note,) = check(ROBOT, Dataset((scaled(e, channel, factor),)))
        assert note.channel == channel
    silent = replace(ROBOT, noise={})
    assert "u looks like kN, expected N, or v looks like mm/s" in refused(silent, scaled(e, "v", 1000.0)).problem


@pytest.mark.slow
@pytest.mark.parametrize("channel", ["V1", "V2", "w1", "w2", "w3", "theta", "r2"])
def test_a_reversed_sign_is_said_as_such(winding, channel):
    reason = refused(WINDING, scaled(winding, channel, -1.0))
    assert (reason.channel, reason.problem, reason.mend) == (channel, "looks reversed in sign", f"multiply {channel} by -1")


@pytest.mark.slow
@pytest.mark.parametrize(("plant", "input_", "output"), [(ROBOT, "u", "v"), (AXIS, "F", "q")], ids=["robot", "axis"])
def test_with_one_input_and_one_output_either_sign_may_be_reversed(plant, input_, output):
    e = drawn(plant, "prbs")
    for channel in (input_, output):
        reason = refused(plant, scaled(e, channel, -1.0))
        assert reason.problem == f"{input_} looks reversed in sign, or {output} looks reversed in sign"
        assert f"multiply {input_} by -1, or multiply {output} by -1" in reason.mend


@pytest.mark.slow
def test_a_voltage_a_thousand_times_too_large_or_small_is_never_taken_for_another(winding):
    for factor, unit in ((1000.0, "mV"), (0.001, "kV")):
        reason = refused(WINDING, scaled(winding, "V2", factor))
        assert (reason.channel, reason.problem) == ("V2", f"looks like {unit}, expected V")


@pytest.mark.parametrize(("factor", "said"), [(1000.0, "1000 times too large"), (0.001, "1000 times too small")])
def test_a_factor_of_no_known_unit_is_noted_with_both_readings(winding, factor, said):
    """Nobody logs an angular velocity in mrad/s, but a logger has gains."""
    (note,) = check(WINDING, Dataset((scaled(winding, "w3", factor),)))
    assert (note.record, note.channel) == ("prbs1", "w3")
    assert note.sentence.startswith(f"looks {said}: an amplifier that saturates or other missing physics as large")
    assert f"or else bring w3 to rad/s (another size of unit, times {1 / factor:g} or so)" in note.sentence


@pytest.mark.slow
def test_several_outputs_in_another_unit_are_all_named(winding):
    rpm = winding
    for name in ("w1", "w2", "w3"):
        rpm = scaled(rpm, name, 30 / np.pi)
    reason = refused(WINDING, rpm)
    for name in ("w1", "w2", "w3"):
        assert f"{name} looks like rpm, expected rad/s" in reason.problem
        assert f"multiply {name} by 0.10472" in reason.mend


def test_an_arm_in_thousandths_of_a_radian_is_not_taken_for_degrees():
    reason = refused(ROBOT, scaled(drawn(ROBOT, "prbs"), "arm", 1000.0))
    assert (reason.channel, reason.problem) == ("arm", "looks like mrad, expected rad")


# ---- channels in wrong places, other machines ------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("a", "b"), [("V1", "V2"), ("w1", "w2"), ("w2", "w3"), ("w3", "theta")])
def test_channels_that_have_changed_places_are_named(winding, a, b):
    reason = refused(WINDING, exchanged(winding, a, b))
    assert f"{a} and {b} look exchanged" in reason.problem
    assert reason.mend == f"swap {a} and {b}"


def drifting(seed):
    """A mass whose place and speed are measured, and a record of one off its data sheet that an unlogged force pulls away."""
    random = np.random.default_rng(seed)
    dt, N = 10.0 ** random.uniform(-2.5, -1.0), 1500
    m, b = 10.0 ** random.uniform(-1.0, 2.0), random.uniform(0.0, 2.0)
    scale = 10.0 ** random.uniform(0.0, 3.0, 2)
    time = m / b if b * dt * N > m else dt * N / 10.0
    mass = Plant(
        name="mass",
        states=(Channel("x", "m"), Channel("v", "m/s")),
        inputs=(Channel("F", "N", "input"),),
        outputs=(Channel("place", "mm", "output"), Channel("speed", "1/min", random.choice(["output", "other"]))),
        parameters=(Parameter("m", m, "kg", tolerance=0.1), Parameter("b", b, "N s/m", tolerance=0.5)),
        equation=lambda x, u, p, at: {"x": x.v, "v": (u.F - p.b * x.v) / p.m},
        measure=lambda x, p: {"place": scale[0] * x.x, "speed": scale[1] * x.v},
        dt=dt,
        start=Start({"x": 0.0, "v": 0.0}),
        noise={"place": 1e-3 * scale[0], "speed": 1e-3 * scale[1]},
    )
    held = max(int(random.uniform(0.02, 0.3) * time / dt), 5)
    F = m / time * np.repeat(random.choice([-1.0, 1.0], N // held + 1), held)[:N]
    pull, y, v, x = 0.1 * random.standard_normal() * m / time, np.empty((N, 2)), 0.0, 0.0
    for k in range(N):
        y[k] = scale * (x, v)
        for _ in range(20):
            v += dt / 20.0 * (F[k] + pull - 1.2 * b * v) / (1.05 * m)
            x += dt / 20.0 * v
    y += 0.002 * y.std(axis=0) * random.standard_normal(y.shape)
    return mass, Experiment("moved", dt * np.arange(N), (*mass.inputs, *mass.outputs), np.column_stack([F, y]), dt)


@pytest.mark.parametrize("seed", [9, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(9))])
def test_places_and_speeds_that_have_changed_places_are_named_where_a_free_run_drifts_away(seed):
    mass, e = drifting(seed)
    check(mass, Dataset((e,)))
    assert refused(mass, exchanged(e, "place", "speed")).mend == "swap place and speed"


@pytest.mark.slow
def test_an_input_that_holds_an_output_is_refused(winding):
    assert "leaves its range at once" in refused(WINDING, exchanged(winding, "V2", "w3")).problem


def test_a_record_of_another_machine_is_refused_by_its_channels():
    reason = refused(WINDING, drawn(ROBOT, "prbs"))
    assert "has u, arm, v; web-winding needs the inputs V1, V2" in reason.problem
    assert reason.channel == "V1, V2"
    assert "is it a record of this machine?" in reason.mend


def test_a_unit_that_is_part_of_a_name_is_told_apart(winding):
    """Loggers write current_A; only the header differs from what the plant needs."""
    names = {"V1": "V1_V", "V2": "v2_V"}
    e = replace(winding, channels=tuple(replace(c, name=names.get(c.name, c.name), unit="") for c in winding.channels))
    assert refused(WINDING, e).mend == "write V1 [V] for V1_V, V2 [V] for v2_V in the header"


def test_a_larger_machine_of_the_same_channels_is_refused_by_its_range(winding):
    assert "stays within [0.01, 0.03] m" in refused(WINDING, scaled(winding, "r2", 9.0)).problem
    alike = winding["r2"] + 0.05  # another radius that grows as fast
    values = np.where(np.array(winding.names) == "r2", alike[:, None], winding.values)
    assert "stays within [0.01, 0.03] m" in refused(WINDING, replace(winding, values=values)).problem


def test_outputs_that_do_not_follow_the_inputs_are_refused():
    random = np.random.default_rng(5)
    e = drawn(ROBOT, "prbs")
    values = e.values.copy()
    values[:, e.names.index("v")] = np.convolve(random.standard_normal(len(e) + 20), np.ones(21), "valid")
    assert "follows none of v" in refused(ROBOT, replace(e, values=values)).problem


def test_an_actuator_that_is_always_at_its_limit_is_no_other_machine():
    """All that moves the output is what nobody logged: the inputs, however large, get through as a constant."""
    random = np.random.default_rng(6)
    e = drawn(ROBOT, "prbs")
    values = e.values.copy()
    at, moves = e.names.index("v"), np.convolve(random.standard_normal(len(e) + 20), np.ones(21), "valid")
    values[:, at] = 0.01 * np.std(values[:, at]) * moves / np.std(moves)
    assert any("at its limit all the time" in note.sentence for note in check(ROBOT, Dataset((replace(e, values=values),))))


# ---- records that say nothing ------------------------------------------------------------------------------------------------


def test_a_short_record_is_told_how_long_it_should_be(winding):
    reason = refused(WINDING, winding.trim(stop=4.0))
    assert "100 samples are too short" in reason.problem
    assert "at least 230 samples (9.2 s)" in reason.mend


@pytest.mark.parametrize(("factor", "unit", "mend"), [(1e3, "ms", "0.001"), (1e6, "us", "1e-06"), (1 / 3600, "h", "3600")])
@pytest.mark.parametrize("plant", [ROBOT, AXIS], ids=["robot", "axis"])
def test_time_in_another_unit_under_the_header_of_seconds_is_refused_before_anything_runs(plant, factor, unit, mend, monkeypatch):
    e = drawn(plant, "prbs")
    monkeypatch.setattr("workbench.diagnosis.runs.stepper.run", None)  # a sample of 20 s takes 1000 times as many steps
    reason = refused(plant, replace(e, t=e.t * factor, dt=e.dt * factor))
    assert (reason.file, reason.channel) == (e.name, "t")
    assert f"is its time in {unit}?" in reason.problem
    assert f"multiply the time column by {mend} " in reason.mend


@pytest.mark.parametrize(
    ("factor", "question", "mend"),
    [
        (1 / 60, "is its time in min?", "60"),
        (1.015 / 60, "is its time in min?", "60"),
        (60.0, "was its time in s, and taken for min?", "0.0166667"),
        (59.0, "was its time in s, and taken for min?", "0.0166667"),
        (3600.0, "was its time in s, and taken for h?", "0.000277778"),
    ],
)
@pytest.mark.parametrize("plant", [ROBOT, AXIS], ids=["robot", "axis"])
def test_minutes_and_hours_are_refused_before_a_channel_is_taken_for_another_unit(plant, factor, question, mend):
    """Sixty times faster a force of newtons moves what it would move in thousands: kN was said, and was an all-clear."""
    e = drawn(plant, "prbs")
    reason = refused(plant, replace(e, t=e.t * factor, dt=e.dt * factor))
    assert (reason.file, reason.channel) == (e.name, "t")
    assert reason.problem.endswith(question)
    assert f"multiply the time column by {mend} " in reason.mend


@pytest.mark.parametrize("times", [1 / 100, 1 / 63, 1 / 57, 57.0, 63.0, 250.0])
def test_a_sample_time_near_none_of_these_is_taken_as_it_is(times):
    assert AXIS.sampled(times * AXIS.dt).dt == times * AXIS.dt


@pytest.mark.slow
def test_a_slow_or_fast_logger_is_no_other_unit_of_time():
    e = drawn(ROBOT, "prbs")
    for every in (e.dt / 10, 5 * e.dt):
        t = np.arange(e.t[0], e.t[-1], every)
        values = np.column_stack([np.interp(t, e.t, column) for column in e.values.T])
        check(ROBOT, Dataset((replace(e, t=t, values=values, dt=every),)))


def test_inputs_at_rest_are_no_experiment(winding):
    t = np.arange(400) * WINDING.dt
    quiet = scaled(scaled(winding, "V1", 0.0), "V2", 0.0)
    assert "no input moves" in refused(WINDING, quiet).problem
    noise = np.random.default_rng(1).standard_normal((400, 7)) * [0.01, 0.01, 0.2, 0.2, 0.3, 0.2, 5e-6]
    channels = (*WINDING.inputs, *WINDING.outputs)
    level = [1.0, 2.0, 40.0, 100.0, 100.0, 0.0, 0.012]
    e = Experiment("rest", t, channels, noise + level + np.outer(t, [0, 0, 0, 0, 0, 0, 1e-5]), WINDING.dt)
    assert "no more than their noise" in refused(WINDING, e).problem


def test_outputs_that_are_constant_or_at_their_stops_are_all_named(winding):
    e = winding.select(["V1", "V2", "w3", "theta"])
    w3, theta = e["w3"], e["theta"]
    values = np.column_stack([e["V1"], e["V2"], np.minimum(w3, np.quantile(w3, 0.3)), np.zeros(len(theta))])
    reason = refused(WINDING, replace(e, values=values))
    assert "w3 sits at its stop" in reason.problem
    assert "70 % of the record" in reason.problem
    assert "theta is constant at 0" in reason.problem


# ---- the measure ----------------------------------------------------------------------------------------------------------


def test_the_distance_is_that_of_the_docstring():
    y = np.sin(np.linspace(0.0, 40.0, 4000))
    assert likeness(3.0 * y + 7.0, y).distance == pytest.approx(np.log(3.0))
    assert likeness(-y, y).distance == pytest.approx(4.0)
    slow = np.linspace(-50.0, 50.0, 4000)
    assert likeness(y + slow, y - slow).correlation < -0.9
    assert nearest(y + slow, y - slow).correlation > 0.9  # the fast parts are the same
    assert likeness(y, np.zeros(4000)).distance == np.inf


def test_the_channels_of_a_user_without_units_are_taken_as_they_are(winding):
    bare = replace(winding, channels=tuple(Channel(c.name, "", c.role) for c in winding.channels))
    assert check(WINDING, Dataset((bare,))) == ()


def test_an_input_that_is_not_logged_is_taken_as_0_and_said():
    """A typo in the name of the arm's angle must not read as an all-clear."""
    renamed = []
    for e in robot_records(3):
        channels = tuple(replace(c, name="angle", role="other") if c.name == "arm" else c for c in e.channels)
        renamed.append(replace(e, channels=channels))
    notes = [note for note in check(ROBOT, Dataset(tuple(renamed))) if note.channel == "arm"]
    assert len(notes) == 2
    assert "calls angle" in notes[0].sentence
    assert not [note for note in check(ROBOT, robot_records(3)) if note.channel == "arm"]


def test_outputs_that_are_not_logged_are_said(winding):
    (note,) = check(WINDING, Dataset((winding.select(["V1", "V2", "w1", "w3"]),)))
    assert str(note) == "prbs1, w2, theta, r2: not in the record: what shows there alone cannot be found"


def test_limits_of_a_state_are_not_those_of_an_output_of_its_name_in_another_unit():
    """q in m has limits, q in mm is read: a record in mm was taken for one in um."""
    plant = replace(
        SMALL_AXIS,
        limits={"q": (-1.0, 1.0)},
        outputs=(Channel("q", "mm", "output"),),
        measure=lambda x, p: {"q": 1000.0 * x.q},
        noise={"q": 0.1},
    )
    records = axis_records(3, records=1, plant=plant)
    assert plant.read_limits == {}
    assert replace(SMALL_AXIS, limits={"q": (-1.0, 1.0)}).read_limits == {"q": (-1.0, 1.0)}
    assert abs(np.median(records.experiments[0]["q"])) > 1.0  # outside of the state's numbers
    check(plant, records)
