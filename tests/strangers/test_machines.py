"""Every stranger is the machine that it says: energies, rest, eigenvalues, order of convergence, friction that sticks."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.strangers import bench, cart_pendulum, conical_tank, crane, quarter_car, servo, two_mass
from tests.strangers.bench import Run, run
from tests.strangers.case import Hidden, _Bench, _hidden, _one_law, _tried, course, draw, keys_of, largest, setting
from tests.strangers.registry import _MODULES, MACHINES
from tests.strangers.yardstick import Tried, _repeated
from workbench.physics.controller import Playback
from workbench.simulation import Scenario, simulate

NAMES = list(MACHINES)


def nominal(machine, **changed):
    return {q.name: q.value for q in machine.plant.parameters} | changed


def held(machine, u, seconds, dt, start, acting=None, **changed):
    """The machine under constant inputs: states (N, nx) of one lane."""
    n = round(seconds / dt)
    commands = np.tile(np.array(u, float)[None, :, None], (n, 1, 1))
    done = run(machine, nominal(machine, **changed), acting or {}, np.array(start, float)[:, None], Run(dt, n, commands=commands))
    return done.states[:, :, 0]


def test_every_file_of_the_folder_is_in_the_registry():
    own = {p.stem for p in Path(__file__).parent.glob("*.py") if "STRANGER = Machine(" in p.read_text(encoding="utf-8")}
    own -= {Path(__file__).stem}
    assert own == {module.__name__.rpartition(".")[2] for module in _MODULES}
    assert len(MACHINES) == len(own) >= 14


@pytest.mark.parametrize("name", NAMES)
def test_the_plant_of_the_user_has_the_same_rates_and_outputs_as_the_stranger_without_effects(name):
    machine, random, many = MACHINES[name], np.random.default_rng(3), 50
    numbers = setting(machine, random).numbers
    around = np.abs(np.array(machine.start)) * (machine.start != np.zeros(len(machine.start))) + 0.02
    x = np.array(machine.start)[:, None] + 0.5 * around[:, None] * random.uniform(-1.0, 1.0, (len(machine.start), many))
    if name == "cylinder":
        x[2] *= 1e8
    u = np.array([random.uniform(lo, hi, many) for lo, hi in machine.lab.range])
    p = SimpleNamespace(**numbers, **dict.fromkeys([*machine.foreign, *machine.inside.values()], 0.0))
    f = SimpleNamespace(**dict.fromkeys(machine.places, 0.0))
    own = [numbers[q.name] for q in machine.plant.parameters]
    for mine, theirs in (
        (machine.rates(x, u, p, f), machine.plant.derivative(list(x), list(u), own)),
        (machine.outputs(x, p), machine.plant.output(list(x), own)),
    ):
        for got, want in zip(mine, theirs, strict=True):
            np.testing.assert_allclose(got, want, rtol=1e-10, atol=1e-10 * np.abs(want).max())


@pytest.mark.parametrize("name", NAMES)
def test_a_force_at_a_place_moves_both_alike(name):
    """What an effect of one unit adds: where a port stands in the equation, and what it stands for."""
    machine = MACHINES[name]
    x, p = np.array(machine.start)[:, None] + 0.01, SimpleNamespace(**nominal(machine), **dict.fromkeys(machine.foreign, 0.0))
    for number in machine.inside.values():
        setattr(p, number, 0.0)
    u = np.array(machine.lab.base)[:, None]
    still = dict.fromkeys(machine.places, 0.0)
    for place, where in machine.places.items():
        if f"coulomb@{place}" not in {slot.key for slot in machine.plant.slots}:
            continue
        flow = [np.array(machine.rates(x, u, p, SimpleNamespace(**(still | {place: force})))) for force in (0.0, -1.0)]
        moved = np.array(flow[1] - flow[0]).ravel() * np.tanh(x[where.speed, 0] / machine_width(machine, place))
        eta = machine.plant.effect_vector({f"coulomb@{place}": {"level": 1.0}})
        theirs = [np.array(machine.plant.derivative(x[:, 0].tolist(), u[:, 0].tolist(), None, e)) for e in (None, eta)]
        np.testing.assert_allclose(moved, theirs[1] - theirs[0], rtol=1e-9, atol=1e-12)


def machine_width(machine, place):
    """The width of the workbench's smoothed sign at a place."""
    return next(s.parameter.default for s in machine.plant.slots if s.key == f"coulomb@{place}" and s.parameter.name == "width")


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_plant_of_the_user_with_true_parameters_runs_as_the_stranger_without_effects(name):
    machine, random = MACHINES[name], np.random.default_rng(3)
    lab, dt = machine.lab, max(machine.lab.dts)
    n = round((lab.window or 6.0) / dt)
    signals = [course(random, n, dt, c, "levels") for c in lab.open]
    if not signals:  # what runs in a loop only: around the inputs of its rest
        signals = [b + 0.02 * (hi - lo) * np.sign(course(random, n, dt, bench.Course(-1, 1, (0.2, 0.5)), "levels"))
                   for b, (lo, hi) in zip(lab.base, lab.range, strict=True)]  # fmt: skip
    commands = np.zeros((n, len(lab.base), 1))
    for i in range(len(lab.base)):
        commands[:, i, 0] = course(random, n, dt, lab.free[i], "waves") if i in lab.free else signals.pop(0)
    numbers = setting(machine, random).numbers
    start = np.array(machine.start)
    mine = run(machine, numbers, {}, start[:, None], Run(dt, n, commands=commands)).measured[:, :, 0]
    plant = machine.plant.sampled(dt)
    played = {c.name: commands[:, i, 0] for i, c in enumerate(plant.inputs)}
    scenario = Scenario("twice", played, start=dict(zip(plant.state_names, start.tolist(), strict=True)))
    theirs = simulate(plant, Playback(tuple(played), dt), scenario, parameters=numbers, substeps=40)
    for i, c in enumerate(plant.outputs):
        want = theirs.experiment[c.name]
        assert np.ptp(want) > 0.0
        np.testing.assert_allclose(mine[:, i], want, atol=2e-4 * np.ptp(want), err_msg=c.name)


@pytest.mark.parametrize("name", NAMES)
def test_the_integration_is_of_fourth_order(name):
    machine = MACHINES[name]
    lab, n = machine.lab, 16
    start = np.array(machine.start) * 1.1 + 1e-3
    if name == "cylinder":
        start[2] = 2e5
    u = np.array([b + 0.05 * (hi - lo) for b, (lo, hi) in zip(lab.base, lab.range, strict=True)])
    if name == "two-mass":
        u, start = np.array([3.0]), np.array([5.0, 4.0, 0.1])  # the play is taken up and stays so
    ends = []
    for k in (1, 2, 4, 32):
        fine = machine._replace(fine=2 * machine.fine / k)
        ends.append(held(fine, u, n * 2 * machine.fine, 2 * machine.fine, start)[-1])
    off = [np.linalg.norm((end - ends[-1]) / (np.abs(ends[-1]) + 1e-9)) for end in ends[:-1]]
    assert off[1] < 1e-9 or off[0] / off[1] > 8.0
    assert off[2] < 1e-9 or off[1] / off[2] > 10.0


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_effect_is_neutral_at_0_and_seen_at_its_largest_size(name):
    """One lane for each effect and each foreign physics, and one with all of them at size 0."""
    machine = MACHINES[name]
    seconds, dt = 3.0 if machine.lab.settle < 10.0 else 30.0, max(machine.lab.dts)
    b = _Bench(setting(machine, np.random.default_rng(1))._replace(samples=round(seconds / dt), dt=dt, one_way=False), 1)
    quiet = b.run((), 1)
    keys, foreign = keys_of(machine), list(machine.foreign)
    tried = [_tried(_hidden(b, quiet, key, largest(b.s, quiet, key), 0.0, np.random.default_rng(2))) for key in keys]
    tried += [Tried(numbers={name: machine.foreign[name]}) for name in foreign] + [Tried()]
    variants = [(one, np.zeros(len(machine.start))) for one in tried]
    window = round(machine.lab.window / dt) or len(quiet.states)
    with np.errstate(all="ignore"):
        y = _repeated(machine, b.s.numbers, quiet, dt, variants, window)[:, :, 0]
        free = _repeated(machine, b.s.numbers, quiet, dt, variants[-1:], window)[:, :, 0]
    np.testing.assert_allclose(y[..., -1:], free, atol=1e-6 * free.std())
    moved = np.abs(y - free).max(axis=0) / (free.std(axis=0) + 1e-12)
    for key, own in zip([*keys, *foreign], moved.T, strict=False):
        # what never stands still does not stick, and what is pushed one way only never changes flanks
        assert not own.max() < 1e-3 or key.startswith(("stribeck@", "gear-backlash@")), key


# ---- analytic truth ------------------------------------------------------------------------------------------------------


def test_a_pendulum_without_friction_keeps_its_energy():
    start = (0.0, 0.0, 0.5, 0.0)
    x = held(crane.STRANGER, [0.0], 10.0, 0.02, start, b=0.0, c=0.0)
    q = nominal(crane.STRANGER)
    _, v, a, w = x.T
    kinetic = 0.5 * (q["M"] + q["m"]) * v**2 + q["m"] * q["l"] * np.cos(a) * v * w + 0.5 * q["m"] * (q["l"] * w) ** 2
    energy = kinetic - q["m"] * 9.81 * q["l"] * np.cos(a)
    assert np.ptp(energy) < 1e-5 * np.ptp(kinetic)
    x = held(cart_pendulum.STRANGER, [0.0], 1.0, 0.005, (0.0, 0.0, 0.1, 0.0), b=0.0, c=0.0)
    q = nominal(cart_pendulum.STRANGER)
    _, v, a, w = x.T
    kinetic = 0.5 * (q["M"] + q["m"]) * v**2 + q["m"] * q["l"] * np.cos(a) * v * w + 2 / 3 * q["m"] * (q["l"] * w) ** 2
    energy = kinetic + q["m"] * 9.81 * q["l"] * np.cos(a)
    assert np.ptp(energy) < 1e-5 * np.ptp(kinetic)


@pytest.mark.parametrize("machine", [quarter_car.STRANGER, cart_pendulum.STRANGER], ids=lambda m: m.name)
def test_small_motion_has_the_eigenvalues_of_the_linear_machine(machine):
    """The flow of a millionth over 0.1 s against those of the matrices on paper."""
    q, nx = nominal(machine), len(machine.start)
    if machine is quarter_car.STRANGER:
        ks, cs = q["ks"], q["cs"]
        M, K = np.diag([q["ms"], q["mu"]]), np.array([[ks, -ks], [-ks, ks + q["kt"]]])
        C = np.array([[cs, -cs], [-cs, cs]])
        order = [0, 1, 2, 3]
    else:
        M = np.array([[q["M"] + q["m"], q["m"] * q["l"]], [q["m"] * q["l"], 4 / 3 * q["m"] * q["l"] ** 2]])
        K, C = np.diag([0.0, -q["m"] * 9.81 * q["l"]]), np.diag([q["b"], q["c"]])
        order = [0, 2, 1, 3]
    inverse = np.linalg.inv(M)
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ K, -inverse @ C]])
    A = A[np.ix_(order, order)]
    dt, e = 0.1, 1e-6
    finer, u = machine._replace(fine=machine.fine / 8), [0.0] * len(machine.lab.base)
    flow = np.column_stack([held(finer, u, 2 * dt, dt, e * unit)[1] / e for unit in np.eye(nx)])
    expected = np.sort_complex(np.exp(dt * np.linalg.eigvals(A)))
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(flow)), expected, rtol=1e-5, atol=1e-7)


def test_an_open_cone_empties_as_torricelli_says():
    q = nominal(conical_tank.STRANGER)
    x = held(conical_tank.STRANGER, [0.0], 4.0, 0.1, (0.3,))[:, 0]
    t = 0.1 * np.arange(len(x))
    # pi t^2 h^2 dh = -a sqrt(2 g h) dt:  h^(5/2) falls in proportion to time
    expected = (0.3**2.5 - 2.5 * q["a"] * np.sqrt(2 * 9.81) / (np.pi * q["t"] ** 2) * t) ** 0.4
    np.testing.assert_allclose(x, expected, rtol=1e-6)


# ---- friction, amplifiers, sensors ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_shaft_that_rubs_stands_still_exactly_and_slides_with_the_level():
    dry = {"coulomb@joint": {"level": 0.2}}
    q = nominal(servo.STRANGER)
    stuck = 0.9 * 0.2 * q["R"] / q["kT"]
    assert np.abs(held(servo.STRANGER, [stuck], 1.0, 0.001, (0.0, 0.0), dry)[:, 0]).max() < 1e-12
    x = held(servo.STRANGER, [12.0], 3.0, 0.001, (0.0, 0.0), dry, G=0.0)
    steady = (12.0 * q["kT"] / q["R"] - 0.2) / (q["b"] + q["kT"] ** 2 / q["R"])
    assert x[-1, 1] == pytest.approx(steady, rel=1e-6)


@pytest.mark.slow
def test_sliding_friction_is_of_second_order_in_the_step():
    dry, ends = {"coulomb@motor": {"level": 0.1}, "stribeck@load": {"level": 0.05, "speed": 20.0}}, []
    for k in (1, 2, 4, 32):
        ends.append(held(two_mass.STRANGER._replace(fine=0.002 / k), [5.0], 0.05, 0.002, (20.0, 20.0, 0.05), dry)[-1])
    off = [np.linalg.norm((end - ends[-1]) / ends[-1]) for end in ends[:-1]]
    assert off[0] / off[1] > 3.0
    assert off[1] / off[2] > 3.0


@pytest.mark.slow
def test_friction_of_the_pendulum_acts_on_the_cart_too_and_ends_all_motion():
    x = held(
        crane.STRANGER,
        [0.0],
        30.0,
        0.02,
        (0.0, 0.0, 0.4, 0.0),
        {"coulomb@swing": {"level": 0.3}, "coulomb@trolley": {"level": 1.0}},
    )
    assert np.abs(x[-1, [1, 3]]).max() < 1e-6
    q = nominal(crane.STRANGER)
    assert abs(q["m"] * 9.81 * q["l"] * np.sin(x[-1, 2])) <= 0.3


def test_a_dead_time_of_any_length_keeps_the_integral_of_a_command():
    drive = bench._Drive({"input-delay": {"time": np.array([3.7e-3, 0.0, 12e-3])}})
    late = []
    for k in range(20):
        drive.hold(np.full(3, 1.0 if k >= 5 else 0.0), 2e-3)
        late += [drive.mean(j * 1e-3, 1e-3, 0.0, 2e-3) for j in range(2)]
    for lane, delay in enumerate((3.7, 0.0, 12.0)):
        np.testing.assert_allclose(np.array(late)[:, lane], np.clip(np.arange(40) + 1 - 10 - delay, 0.0, 1.0), atol=1e-9)


def sensed(own, z, h=1e-3):
    sensor, seen = bench._Sensor(own), []
    sensor.settle(np.array([z[0]]))
    for value in z:
        sensor.step(np.array([value]), h)
        seen.append(float(sensor.read(0.0, 0.0)[0]))
    return np.array(seen)


@pytest.mark.parametrize(
    ("own", "late"), [({"sensor-lag": {"time": 0.03}}, 0.03), ({"sensor-resonance": {"time": 0.02, "damping": 0.4}}, 0.016)]
)
def test_slow_sensors_follow_a_ramp_late_by_their_time(own, late):
    t = 1e-3 * np.arange(2001)
    assert sensed(own, 2.0 + 3.0 * t)[-1] == pytest.approx(2.0 + 3.0 * (2.0 - late), abs=1e-6)


@pytest.mark.slow
def test_records_behind_a_fast_resonance_do_not_depend_on_the_step():
    machine = MACHINES["conical-tank"]
    swinging = (Hidden("sensor-resonance", "level", {"time": 0.028, "damping": 0.3}, 5.0),)

    def levels(fine, truth):
        s = setting(machine, np.random.default_rng([3, 2]))._replace(noise=(0.0,), resolution=None)
        return _Bench(s._replace(machine=machine._replace(fine=fine)), 3).run(truth, 1).measured

    clean, exact = levels(machine.fine / 8, ()), levels(machine.fine / 64, swinging)
    assert np.abs(levels(machine.fine, swinging) - exact).max() < 0.02 * np.abs(exact - clean).max()


def test_play_of_a_sensor_stands_still_after_a_reversal():
    z = 5.0 * np.sin(np.linspace(0.0, 20.0, 2000))
    seen = sensed({"backlash": {"half_width": 0.5}}, z)
    assert seen.max() == pytest.approx(z.max() - 0.5, abs=1e-3)
    assert np.abs(seen - z).max() <= 0.5 + 1e-12


def test_amplifiers_do_what_their_sentences_say():
    def acts(own, u, t=0.0):
        drive = bench._Drive(own)
        drive.hold(np.array([u]), 0.01)
        return float(drive.mean(0.0, 0.01, t, 0.01)[0])

    assert acts({"offset": {"level": 0.2}}, 1.0) == pytest.approx(1.2)
    assert acts({"dead-zone": {"half_width": 0.3}}, -1.0) == pytest.approx(-0.7)
    assert acts({"dead-zone": {"half_width": 0.3}}, 0.2) == 0.0
    assert acts({"saturation": {"limit": 0.5}}, -1.0) == -0.5
    assert acts({"heating": {"fall": 0.2, "time": 3.0}}, 1.0, 3.0) == pytest.approx(1.0 - 0.2 * (1.0 - np.exp(-1.0)))
    drive, lost = bench._Drive({"gear-backlash": {"play": 0.04}}), 0.0
    for _ in range(100):
        drive.hold(np.array([-2.0]), 1e-3)
        lost += 1e-3 * (2.0 + float(drive.mean(0.0, 1e-3, 0.0, 1e-3)[0]))
    assert lost == pytest.approx(0.04, rel=1e-9)


@pytest.mark.parametrize(
    ("keys", "one"),
    [
        (["coulomb@a", "asymmetric-friction@a"], True),
        (["asymmetric-friction@a", "offset@u", "coulomb@a"], True),
        (["coulomb@a", "asymmetric-friction@b"], False),
        (["coulomb@a", "stribeck@a"], False),
    ],
)
def test_what_no_answer_could_name_apart_is_not_hidden_together(keys, one):
    assert _one_law(keys) is one


@pytest.mark.slow
def test_sound_records_come_from_every_machine():
    for seed in range(len(MACHINES)):
        drawn = _Bench(setting(MACHINES[NAMES[seed]], np.random.default_rng([seed, 2])), seed)
        drawn.s = drawn.s._replace(samples=min(drawn.s.samples, 200))
        assert drawn.sound(drawn.run((), 2)), drawn.s.machine.name


@pytest.mark.slow
def test_the_generator_is_deterministic_by_seed():
    first, again, other = draw(19), draw(19), draw(5)
    assert first.machine == other.machine
    assert [(h.key, dict(h.parameters)) for h in first.truth] == [(h.key, dict(h.parameters)) for h in again.truth]
    for a, b, c in zip([*first.records, *first.held_out], [*again.records, *again.held_out], other.records, strict=False):
        np.testing.assert_array_equal(a.values, b.values)
        assert a.values.shape != c.values.shape or not np.array_equal(a.values, c.values)
