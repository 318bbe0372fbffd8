"""Each law of the catalogue against its defining equation or what mechanics says of it, written out here."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from plants import POSITIONING_AXIS, WEB_WINDING, WELDING_ROBOT
from workbench.data import Channel
from workbench.errors import InputError
from workbench.physics.controller import Playback
from workbench.physics.effects import EFFECTS
from workbench.physics.effects.effect import Domain, Effect, EffectParameter, GridUnit, Named, smooth_step
from workbench.physics.effects.shaft import Shaft, Slide
from workbench.physics.effects.span import Span
from workbench.physics.parameters import Parameter
from workbench.physics.plant import Plant
from workbench.simulation import Scenario, simulate

DT = 0.02


def law(name, sizes, **at):
    effect = EFFECTS[name]
    numbers = {p.name: p.default for p in effect.parameters} | sizes
    return effect.law(Named(numbers), Named(at))


def robot(u, arm=None, seed=None, **options):
    sequences = {"u": u} if arm is None else {"u": u, "arm": arm}
    return simulate(WELDING_ROBOT, Playback(tuple(sequences), DT), Scenario("run", sequences, seed=seed), **options)


COMMAND = np.random.default_rng(4).normal(0, 2, 200).round(3)

# ---- friction ----------------------------------------------------------------------------------------------------------

FRICTION = ("coulomb", "stribeck", "asymmetric-friction", "quadratic-friction", "load-friction", "friction-jump")
anything = st.floats(-1e4, 1e4)
positive = st.floats(1e-3, 1e3)
#: Numbers for which an effect is the one that it includes.
SPECIAL = {
    ("stribeck", "coulomb"): {"level": 3.0, "speed": 1e8},
    ("asymmetric-friction", "coulomb"): {"forward": 3.0, "backward": 3.0},
    ("friction-jump", "coulomb"): {"level": 3.0, "time": 0.0},
}


@given(speed=anything, width=positive)
def test_an_effect_becomes_each_one_that_it_includes(speed, width):
    assert {(e.id, name) for e in EFFECTS.values() for name in e.includes} == set(SPECIAL)
    at = {"speed": speed, "angle": 0.0, "load": 0.0, "t": 10.0}
    for (general, special), numbers in SPECIAL.items():
        same = law(special, {"level": 3.0, "width": width}, **at)
        assert law(general, {**numbers, "width": width}, **at) == pytest.approx(same, rel=1e-6, abs=1e-9)


@given(speed=anything, load=anything, time=anything, size=st.lists(positive, min_size=2, max_size=2), shape=positive)
def test_friction_never_gives_energy(speed, load, time, size, shape):
    """torque * speed <= 0 for every law that is called friction, at any speed, load, time, size and shape."""
    for name in FRICTION:
        effect = EFFECTS[name]
        sizes = dict(zip([p.name for p in effect.sizes], size, strict=False))
        shapes = {p.name: shape for p in effect.parameters if p.shape}
        assert law(name, sizes | shapes, speed=speed, load=load, angle=0.0, t=time) * speed <= 0.0
        assert all(p.low == 0.0 for p in effect.sizes), "a size below 0 would drive the shaft"


@pytest.mark.parametrize(
    ("name", "sizes", "forward", "backward"),
    [
        ("coulomb", {"level": 2.0}, -2.0, 2.0),
        ("asymmetric-friction", {"forward": 2.0, "backward": 0.5}, -2.0, 0.5),
        ("quadratic-friction", {"coefficient": 1e-2}, -36.0, 36.0),
        ("load-friction", {"coefficient": 0.1}, -0.3, 0.3),
        ("stribeck", {"level": 2.0, "speed": 60.0}, -2.0 / np.e, 2.0 / np.e),
        ("friction-jump", {"level": 2.0, "time": 3.0}, -2.0, 2.0),
    ],
)
def test_friction_at_full_speed_either_way(name, sizes, forward, backward):
    at = {"load": 3.0, "angle": 0.0, "t": 4.0}
    assert law(name, sizes, speed=60.0, **at) == pytest.approx(forward, rel=1e-12)
    assert law(name, sizes, speed=-60.0, **at) == pytest.approx(backward, rel=1e-12)
    assert law(name, sizes, speed=0.0, **at) == 0.0


def test_equal_levels_both_ways_are_dry_friction():
    for speed in (-3.0, -0.4, 0.1, 2.0):
        at = {"speed": speed, "load": 0.0, "angle": 0.0, "t": 0.0}
        expected = law("coulomb", {"level": 2.0}, **at)
        assert law("asymmetric-friction", {"forward": 2.0, "backward": 2.0}, **at) == pytest.approx(expected, rel=1e-14)


def test_stribeck_friction_is_dry_friction_at_low_speed_and_gone_at_high():
    at = {"load": 0.0, "angle": 0.0, "t": 0.0}
    sizes = {"level": 2.0, "speed": 10.0, "width": 0.01}
    assert law("stribeck", sizes, speed=0.1, **at) == pytest.approx(-2.0, rel=2e-4)
    assert abs(law("stribeck", sizes, speed=60.0, **at)) < 1e-12


def test_a_jump_is_half_done_at_its_time_and_done_a_tenth_of_a_second_around_it():
    assert smooth_step(3.0, 3.0) == 0.5
    assert smooth_step(2.9, 3.0) < 0.02
    assert smooth_step(3.1, 3.0) > 0.98
    before, after = (law("friction-jump", {"level": 2.0, "time": 3.0}, speed=60.0, load=0.0, angle=0.0, t=t) for t in (2.0, 4.0))
    assert before == pytest.approx(0.0, abs=1e-12)
    assert after == pytest.approx(-2.0)


# ---- what turns --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "place", "per_turn"),
    [("imbalance", "shaft", 1), ("torque-ripple", "shaft", 7), ("eccentricity", "reel", 1), ("periodic-tension", "span", 0)],
)
def test_cosine_and_sine_are_an_amplitude_and_a_phase(name, place, per_turn):
    """a cos(phi) cos(n x) + a sin(phi) sin(n x) = a cos(n x - phi), for what the record's own zero of the angle may be."""
    a, phi = 0.3, 1.1
    sizes = {"cosine": a * np.cos(phi), "sine": a * np.sin(phi)}
    if name == "torque-ripple":
        sizes["order"] = per_turn
    if name == "periodic-tension":
        sizes["frequency"] = 0.4
    for x in np.linspace(-9, 9, 7):
        argument = 2 * np.pi * 0.4 * x if place == "span" else per_turn * x
        found = law(name, sizes, angle=x, speed=5.0, t=x, load=0.0, tension=1.0, stretch=0.0, stiffness=1.0, rest=1.0, state=0.0)
        expected = a * np.cos(argument - phi)
        assert (found[0] if isinstance(found, tuple) else found) == pytest.approx(expected, rel=1e-12, abs=1e-12)
        if name == "eccentricity":
            assert found[1] == pytest.approx(-5.0 * a * np.sin(argument - phi), rel=1e-12, abs=1e-12)


def test_what_has_a_phase_is_what_repeats_with_an_angle_or_a_time_nobody_set():
    assert {e.id for e in EFFECTS.values() if e.phase} == {"imbalance", "torque-ripple", "eccentricity", "periodic-tension"}


def test_a_wheel_under_a_slide_turns_once_in_its_circumference():
    """Imbalance of what carries a slide repeats every 2 pi travel metres."""
    eta = POSITIONING_AXIS.effect_vector({"imbalance@slide": {"cosine": 5.0}})
    travel = POSITIONING_AXIS.ports[0].travel
    at = [POSITIONING_AXIS.derivative([0, 0], [0], eta=eta, angle=[q])[1] for q in (0.0, np.pi * travel, 2 * np.pi * travel)]
    assert at == pytest.approx([5.0 / 95.0, -5.0 / 95.0, 5.0 / 95.0])


def test_load_friction_is_offered_only_where_the_equation_gives_the_load():
    places = {s.key for plant in (WEB_WINDING, WELDING_ROBOT, POSITIONING_AXIS) for s in plant.slots}
    assert {key for key in places if key.startswith("load")} == {f"load-friction@{q}" for q in ("unwind", "rewind", "pulley")}

    def plant(port, load):
        return Plant(
            "one", (Channel("w", "rad/s"),), (Channel("u", "N m", "input"),), (Channel("y", "rad/s", "output"),), (),
            lambda x, u, p, at: {"w": u.u + at.a.torque(**load)}, lambda x, p: {"y": x.w}, dt=0.1, ports=(port,),
        )  # fmt: skip

    for port, load, said in ((Shaft("a", "w"), {"load": 1.0}, "a load"), (Shaft("a", "w", loaded=True), {}, "no load")):
        with pytest.raises(InputError, match=rf"the equation gives {said} at 'a'(.|\n)*loaded=True"):
            plant(port, load).derivative([1.0], [0.0])


# ---- actuators ---------------------------------------------------------------------------------------------------------


def equals_the_run_under(acting, **effect):
    sizes = {key.replace("_at_", "@").replace("_", "-"): value for key, value in effect.items()}
    run = robot(COMMAND, effects=sizes)
    assert np.array_equal(run.experiment["u"], COMMAND)  # the log keeps the command
    np.testing.assert_allclose(run.states.values, robot(acting).states.values, rtol=1e-12, atol=1e-13)
    assert not np.allclose(run.states.values, robot(COMMAND).states.values, atol=1e-6)


def test_offset_adds_to_the_command():
    equals_the_run_under(COMMAND - 0.3, offset_at_u={"level": -0.3})


def test_dead_zone_takes_its_half_width_from_every_command():
    equals_the_run_under(np.sign(COMMAND) * np.maximum(np.abs(COMMAND) - 0.7, 0.0), dead_zone_at_u={"half_width": 0.7})


def test_heating_weakens_the_drive_with_a_time_constant():
    t = DT * np.arange(len(COMMAND))
    equals_the_run_under(COMMAND * (1 - 0.4 * (1 - np.exp(-t / 1.5))), heating_at_u={"fall": 0.4, "time": 1.5})


def test_offset_acts_before_the_dead_zone_and_that_before_the_limit():
    sizes = {"saturation_at_u": {"limit": 1.0}, "dead_zone_at_u": {"half_width": 0.5}, "offset_at_u": {"level": 0.4}}
    u = COMMAND + 0.4
    equals_the_run_under(np.clip(np.sign(u) * np.maximum(np.abs(u) - 0.5, 0.0), -1.0, 1.0), **sizes)


def passed_on(command, play, dt=DT):
    """What a gear with play passes on: nothing while the impulse since the last contact is less than the play."""
    gap, acting = 0.0, []
    for u in command:
        free = (0.5 * play - gap if u > 0 else 0.5 * play + gap) / abs(u) if u else np.inf  # time to the other flank
        crossing = min(free, dt)
        gap = np.clip(gap + u * dt, -0.5 * play, 0.5 * play)
        acting.append(u * (1.0 - crossing / dt) if u else 0.0)
    return np.array(acting)


def test_gear_play_loses_the_impulse_that_crosses_the_gap():
    equals_the_run_under(passed_on(COMMAND, 0.05), gear_backlash_at_u={"play": 0.05})


def test_gear_play_loses_its_whole_size_at_each_change_of_sign_and_nothing_between():
    command = np.repeat([1.0, -1.0, 1.0], 60)
    eta = WELDING_ROBOT.effect_vector({"gear-backlash@u": {"play": 0.1}})
    gaps, lost = [0.05], []  # the teeth touch
    for u in command:
        lost.append((u - WELDING_ROBOT.drive([u, 0.0], eta, 0.0, gaps)[0]) * DT)
        gaps = WELDING_ROBOT.cross_gaps([u, 0.0], eta, 0.0, gaps)
    assert [sum(lost[i : i + 60]) for i in (0, 60, 120)] == pytest.approx([0.0, -0.1, 0.1])


def test_gear_teeth_touch_at_the_start_where_the_command_was_held():
    eta = WEB_WINDING.effect_vector({"gear-backlash@V2": {"play": 0.3}})
    assert WEB_WINDING.settle_gaps([0.0, 2.0], eta) == [0.0, 0.15]
    assert WEB_WINDING.drive([0.0, 2.0], eta, 0.0) == [0.0, 2.0]


# ---- sensors -----------------------------------------------------------------------------------------------------------


def test_static_sensor_faults_are_maps_of_the_reading():
    clean = robot(COMMAND, seed=3).experiment["v"]
    noise = clean - robot(COMMAND, seed=3).states["v1"]
    truth = clean - noise
    assert np.std(noise) > 1e-3
    for sizes, expected in (
        ({"sensor-gain@v": {"error": 0.2}}, 1.2 * truth),
        ({"sensor-bias@v": {"level": -0.4}}, truth - 0.4),
        ({"sensor-nonlinearity@v": {"curvature": 0.3, "centre": 0.5}}, truth + 0.3 * (truth - 0.5) ** 2),
        (
            {"sensor-gain@v": {"error": 0.2}, "sensor-bias@v": {"level": -0.4}, "sensor-nonlinearity@v": {"curvature": 0.3}},
            1.2 * (truth + 0.3 * truth**2) - 0.4,
        ),
    ):
        np.testing.assert_allclose(
            robot(COMMAND, seed=3, effects=sizes).experiment["v"], expected + noise, rtol=1e-12, atol=1e-14
        )


def test_a_quantised_record_holds_whole_steps_noise_and_all():
    step = 0.013
    found = robot(COMMAND, seed=3, effects={"quantisation@v": {"step": step}}).experiment["v"]
    clean = robot(COMMAND, seed=3).experiment["v"]
    np.testing.assert_allclose(found / step, np.round(found / step), atol=1e-9)
    assert np.abs(found - clean).max() <= 0.5 * step + 1e-12
    assert len(np.unique(found)) > 5


def slow_sensor(lag=0.0, resonance=0.0, damping=0.2):
    """Readings of the robot behind a lag, a resonance or both, and without: the linear equations, by matrix exponential."""
    A, B, C, _ = WELDING_ROBOT.linearize([0.0, 0.0], [0.0, 0.0])
    n = 2
    held = np.zeros((6, 6))  # x1, x2, y, y', z behind the lag, u
    held[:n, :n], held[:n, 5] = A, B[:, 0]
    if lag:
        held[4, :n], held[4, 4] = C[0] / lag, -1.0 / lag
    if resonance:
        seen = np.eye(6)[4] if lag else np.r_[C[0], np.zeros(4)]
        held[2, 3] = 1.0
        held[3] = (seen - np.eye(6)[2] - 2.0 * damping * resonance * np.eye(6)[3]) / resonance**2
    on, z, truth, plain = expm(held * DT), np.zeros(6), [], []
    for u in COMMAND:
        truth.append(z[2] if resonance else z[4])
        plain.append(C[0] @ z[:n])
        z = on @ np.r_[z[:5], u]
    return np.array(truth), np.array(plain)


@pytest.mark.parametrize(
    "sensor",
    [
        {"lag": 0.05}, {"lag": 0.003}, {"lag": 0.001}, {"resonance": 0.05}, {"resonance": 0.01, "damping": 0.49},
        {"resonance": 0.003}, {"resonance": 0.001, "damping": 0.3}, {"lag": 0.004, "resonance": 0.003},
    ],
)  # fmt: skip
@pytest.mark.parametrize("early", [0.0, 1e-9], ids=["equal steps", "a step of a nanosecond"])
def test_slow_sensors_solve_their_differential_equations_in_two_steps_a_sample(sensor, early):
    """time y' = z - y and time^2 y'' + 2 damping time y' + y = z, also where the sensor is far faster than the step.

    What a fast resonance does beyond its delay is of the order of time^2 z'': a straight line within the step has an error of
    damping * time * h * z'', and the time that is fitted is wrong by a third, within an interval of a few percent.
    """
    truth, plain = slow_sensor(**sensor)
    sizes = {"input-delay@u": {"time": early}} if early else {}
    if "lag" in sensor:
        sizes["sensor-lag@v"] = {"time": sensor["lag"]}
    if "resonance" in sensor:
        sizes["sensor-resonance@v"] = {"time": sensor["resonance"], "damping": sensor.get("damping", 0.2)}
    two, four = (np.abs(robot(COMMAND, effects=sizes, substeps=m).experiment["v"] - truth).max() for m in (2, 4))
    # behind a fast lag what the resonance sees is no parabola either
    assert two < (1e-2 if len({"lag", "resonance"} & set(sensor)) == 2 else 5e-4) * np.abs(truth - plain).max()
    if not early:
        assert four < two / 6


def test_a_lag_behind_play_does_not_jump_in_a_step_of_no_length():
    eta = WELDING_ROBOT.effect_vector({"backlash@v": {"half_width": 0.1}, "sensor-lag@v": {"time": 0.05}})
    kept = WELDING_ROBOT.remember([0.0] * 4, [0.5], [0.5], [0.5], 0.0, eta)
    assert kept[0] == pytest.approx(0.4)
    assert kept[1] == pytest.approx(0.0, abs=1e-12)


# ---- spans and winding -------------------------------------------------------------------------------------------------

STRING = Plant(
    "string",
    (Channel("T", "N"),),
    (Channel("e", "m/s", "input"),),
    (Channel("y", "N", "output"),),
    (Parameter("k", 50.0, "N/m"), Parameter("T0", 2.0, "N")),
    lambda x, u, p, at: {"T": p.k * u.e + at.web.rate(u.e, p.k, p.T0)},
    lambda x, p: {"y": x.T},
    dt=0.02,
    ports=(Span("web", "T"),),
)
STRETCH = 0.1 * np.sign(np.sin(np.arange(150) / 9))


def stretched(effects):
    return simulate(STRING, Playback(("e",), 0.02), Scenario("s", {"e": STRETCH}, start={"T": 2.0}), effects=effects).states["T"]


def integral(rate, start):
    """T at the samples under the held stretch; rate(t, z, e) for states z whose first is T."""
    z, found = np.array(start, dtype=float), []
    for k, e in enumerate(STRETCH):
        found.append(z[0])
        z = solve_ivp(rate, (0.02 * k, 0.02 * (k + 1)), z, args=(e,), rtol=1e-9, atol=1e-12).y[:, -1]
    return np.array(found)


def step(t, time):
    return 0.5 * (1 + np.tanh((t - time) / 0.05))


@pytest.mark.parametrize(
    ("sizes", "rate", "start"),
    [
        ({"viscoelastic@web": {"share": 0.6, "time": 0.3}},
         lambda t, z, e: [1.6 * 50 * e - z[1] / 0.3, 0.6 * 50 * e - z[1] / 0.3], [2.0, 0.0]),
        ({"nonlinear-elasticity@web": {"change": 0.4}}, lambda t, z, e: [50 * (1 + 0.4 * (z[0] - 2.0) / 2.0) * e], [2.0]),
        ({"stiffness-jump@web": {"change": -0.3, "time": 1.2}}, lambda t, z, e: [50 * (1 - 0.3 * step(t, 1.2)) * e], [2.0]),
        ({"periodic-tension@web": {"cosine": 3.0, "sine": -2.0, "frequency": 1.7}},
         lambda t, z, e: [50 * e + 3 * np.cos(2 * np.pi * 1.7 * t) - 2 * np.sin(2 * np.pi * 1.7 * t)], [2.0]),
    ],
    ids=["viscoelastic", "nonlinear", "jump", "periodic"],
)  # fmt: skip
def test_span_effects_are_their_written_equations(sizes, rate, start):
    found, expected = stretched(sizes), integral(rate, start)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert np.abs(found - stretched({})).max() > 0.05


def test_a_maxwell_branch_lets_its_whole_tension_go():
    """After a stretch that is held, T falls to what the elastic web alone holds, with the time constant."""
    e = np.r_[np.full(10, 0.1), np.zeros(200)]
    sizes = {"viscoelastic@web": {"share": 0.5, "time": 0.4}}
    T = simulate(STRING, Playback(("e",), 0.02), Scenario("s", {"e": e}, start={"T": 2.0}), effects=sizes).states["T"]
    assert T[-1] == pytest.approx(2.0 + 50 * 0.1 * 0.2, rel=1e-4)
    assert (T[60] - T[-1]) / (T[40] - T[-1]) == pytest.approx(np.exp(-1.0), rel=1e-3)


def test_entrained_air_thickens_each_layer_in_proportion_to_the_surface_speed():
    x, u = WEB_WINDING.equilibrium()
    eta = WEB_WINDING.effect_vector({"air-entrainment@rewind": {"share": 0.2, "speed": 2.0}})
    i, v = WEB_WINDING.state_names.index("r2"), x[1] * x[6]
    thin, thick = WEB_WINDING.derivative(x, u)[i], WEB_WINDING.derivative(x, u, eta=eta)[i]
    assert thick / thin == pytest.approx(1 + 0.2 * v / 2.0)
    assert "air-entrainment@unwind" not in {s.key for s in WEB_WINDING.slots}


# ---- robot -------------------------------------------------------------------------------------------------------------


def test_tilt_is_a_constant_force():
    np.testing.assert_allclose(
        robot(COMMAND, effects={"rail-tilt@rail": {"level": 0.4}}).states.values, robot(COMMAND - 0.4).states.values, atol=1e-12
    )


def test_the_arm_pushes_back_with_its_rate_over_the_last_sample():
    """The first sample knows no rate: an arm that stands at 0.9 rad from the start has not swung there."""
    arm = 0.9 + 0.5 * np.sin(np.arange(200) / 11)
    rate = np.r_[0.0, np.diff(arm)] / DT
    found = robot(COMMAND, arm, effects={"arm-reaction@rail": {"coefficient": 0.3}})
    np.testing.assert_allclose(found.states.values, robot(COMMAND - 0.3 * rate).states.values, rtol=1e-9, atol=1e-12)
    still = robot(COMMAND, np.full(200, 0.9), effects={"arm-reaction@rail": {"coefficient": 0.3}})
    assert np.array_equal(still.states.values, robot(COMMAND).states.values)


# ---- records of effects ------------------------------------------------------------------------------------------------


def test_contradictory_effects_are_refused():
    def made(sizes=("level",), **options):
        return Effect("x", "shaft", tuple(EffectParameter(n, "N") for n in sizes), "{place}", "s", "f = 0", lambda e, s: 0.0,
                      Domain.SPEED, **options)  # fmt: skip

    made()
    for sizes, options, said in (
        (("level",), {"regular": False}, "a grid belongs"),
        (("level",), {"grid": (1.0,)}, "a grid belongs"),
        (("a", "b"), {"grid": (1.0,), "regular": False}, "for one size"),
        (("sine", "cosine"), {"phase": True}, "cosine and sine"),
    ):
        with pytest.raises(InputError, match=said):
            made(sizes, **options)
    with pytest.raises(InputError, match="belongs to its effect"):
        EffectParameter("level", "N", grid=(1.0,))


def test_grids_of_a_slide_are_scaled_with_its_speeds():
    width, ratio = EFFECTS["coulomb"].parameters[1], Slide("rail", "v", travel=0.02)
    fitted = ratio.fitted(width)
    assert (fitted.unit, fitted.default) == ("m/s", pytest.approx(0.02 * width.default))
    assert fitted.grid == width.grid  # shares of the largest speed, whatever its unit
    own = replace(width, grid_unit=GridUnit.ONE, grid=(0.5, 2.0))
    assert ratio.fitted(own).grid == pytest.approx((0.01, 0.04))
    assert ratio.fitted(EFFECTS["torque-ripple"].parameters[2]).grid == EFFECTS["torque-ripple"].parameters[2].grid
