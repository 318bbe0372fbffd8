"""Effects that a plant brings along: nothing at 0, acting at any other size, found by a diagnosis, refused where they misfit."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plants import PLANTS, WEB_WINDING, WELDING_ROBOT
from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis.answer import Finding
from workbench.diagnosis.diagnosis import diagnose
from workbench.errors import InputError
from workbench.physics import stepper
from workbench.physics.controller import Playback
from workbench.physics.effects import EFFECTS, effects_of
from workbench.physics.effects.effect import Domain, Effect, EffectParameter, GridUnit
from workbench.physics.effects.pulley import Pulley
from workbench.physics.effects.reel import Reel
from workbench.physics.effects.robot import Robot
from workbench.physics.effects.shaft import Shaft
from workbench.physics.effects.span import Span
from workbench.physics.effects.spring import Spring
from workbench.physics.effects.tank import Tank
from workbench.physics.effects.winding import Winding
from workbench.physics.kernel import SCALAR
from workbench.physics.own_effects import check_own
from workbench.physics.parameters import Parameter
from workbench.physics.plant import Plant
from workbench.simulation import Scenario, simulate


def size(name="size", unit="1", **more):
    return EffectParameter(name, unit, **more)


def effect(id, family, law, *parameters, domain=Domain.SPEED, **more):
    numbers = parameters or (size(),)
    return Effect(id, family, numbers, "Something is wrong at {place}.", "Look there.", "see the law", law, domain, **more)


def brake(e, shaft):
    share = shaft.speed / e.speed
    return -2.0 * e.peak * share / (1.0 + share**2)


BRAKE = effect(
    "eddy-brake",
    "shaft",
    brake,
    size("peak", "N m", low=0.0),
    size("speed", "rad/s", low=0.1, high=1e3, default=10.0, shape=True, grid=(3.0, 10.0, 30.0)),
)
FLYWHEEL = Plant(
    name="flywheel",
    states=(Channel("w", "rad/s"),),
    inputs=(Channel("M", "N m", "input"),),
    outputs=(Channel("w", "rad/s", "output"),),
    parameters=(
        Parameter("J", 0.02, "kg m^2", tolerance=0.1, meaning="inertia"),
        Parameter("b", 0.01, "N m s/rad", tolerance=0.3, meaning="bearing friction"),
    ),
    equation=lambda x, u, p, at: {"w": (u.M - p.b * x.w + at.wheel.torque()) / p.J},
    measure=lambda x, p: {"w": x.w},
    dt=0.05,
    ports=(Shaft("wheel", "w"),),
    noise={"w": 0.005},
    own_effects=(BRAKE,),
)


# ---- of every family ---------------------------------------------------------------------------------------------------


def rig_equation(x, u, p, at):
    stretch = 0.02 * x.w - 0.05 * x.v - at.roll.creep() * (x.T - 4.0)
    deviation = at.drum.runout()
    flows = at.sump.flows(0.2 * x.h)
    return {
        "w": (u.M - 0.1 * x.w + at.drum.torque(load=x.T)) / p.J,
        "T": 50.0 * stretch + at.web.rate(stretch, 50.0, 5.0),
        "v": (u.M - 0.3 * x.v + at.cart.force() + at.bow.push(x.v)) / at.cart.mass(1.0),
        "h": 0.5 + 0.1 * u.M - 0.2 * x.h - flows.outlet - flows.spill,
        "L": at.drum.thickness(0.1, x.w) + deviation.radius + deviation.rate,
    }


RIG = Plant(
    name="rig",
    states=(Channel("w", "rad/s"), Channel("T", "N"), Channel("v", "m/s"), Channel("L", "m"), Channel("h", "m")),
    inputs=(Channel("M", "N m", "input"), Channel("arm", "rad", "schedule")),
    outputs=(Channel("w", "rad/s", "output"), Channel("L", "m", "output")),
    parameters=(Parameter("J", 0.5, "kg m^2"),),
    equation=rig_equation,
    measure=lambda x, p: {"w": x.w, "L": x.L},
    dt=0.02,
    ports=(
        Shaft("drum", "w", loaded=True), Reel("drum", "w"), Winding("drum"), Pulley("roll"), Span("web", "T"),
        Robot("cart", "arm"), Spring("bow"), Tank("sump", "h"),
    ),
)  # fmt: skip
OF_ALL = (
    effect("spring", "shaft", lambda e, s: -e.size * s.angle, domain=Domain.ANGLE),
    effect("clutch", "shaft", lambda e, s: -e.size * s.load**2, domain=Domain.LOAD),
    effect("slack", "spring", lambda e, s: -e.size * np.tanh(s.stretch), domain=Domain.STRETCH),
    effect("valve", "tank", lambda e, s: (e.size * s.outflow, e.size * s.level), domain=Domain.HEAD),
    effect("flat", "reel", lambda e, r: (e.size * np.cos(2 * r.angle), -2 * e.size * r.speed * np.sin(2 * r.angle))),
    effect("skid", "pulley", lambda e: e.size**2),
    effect("bowing", "span", lambda e, s: (e.size * s.tension, 0.0)),
    effect("memory", "span", lambda e, s: (e.size * s.state, e.size * s.stretch - s.state), state=True),
    effect("dust", "winding", lambda e, v: e.size * np.minimum(v, 3.0)),
    effect("cable", "robot", lambda e, r: (-e.size * r.arm**2, 0.0)),
    effect("hoist", "robot", lambda e, r: (0.0, e.size * np.sin(r.arm))),
    effect("sag", "actuator", lambda e, u, t: u - e.size * u**3, domain=Domain.COMMAND),
    effect("inertia", "actuator", lambda e, m, u, dt: (u, u + e.size * (m - u)), domain=Domain.COMMAND, memories=1),
    effect("cube", "sensor", lambda e, z: z + e.size * z**3, domain=Domain.LEVEL),
    effect("mean", "sensor", lambda e, m, z0, z1, h: [z1 + e.size * (m[1] - z1), z0], domain=Domain.LEVEL, memories=2),
)


def push(plant, samples=200, **given):
    k = np.arange(samples)
    signals = {"M": 2.0 * np.sin(k / 9), "arm": 1.0 + 0.5 * np.cos(k / 15)}
    player = Playback(plant.input_names, plant.dt)
    return simulate(plant, player, Scenario("push", {n: signals[n] for n in plant.input_names}, seed=1), substeps=20, **given)


@pytest.fixture(scope="module")
def rig():
    return replace(RIG, own_effects=OF_ALL)


def test_they_join_the_catalogue_at_every_port_of_their_family(rig):
    for (family, _), offered in rig.offered.items():
        own = [e for e in OF_ALL if e.family == family]
        assert offered == effects_of(family, own)
        assert set(offered) == {*effects_of(family), *own}
        assert offered[-1] in EFFECTS.values()  # a converter or a dead time is the last that acts
    assert {slot.effect.id for slot in rig.slots} == {*EFFECTS, *(e.id for e in OF_ALL)}


def test_sizes_of_0_change_no_bit(rig):
    with_none, at_0 = push(RIG), push(rig)
    np.testing.assert_array_equal(at_0.states.values, with_none.states.values)
    np.testing.assert_array_equal(at_0.experiment.values, with_none.experiment.values)
    assert np.ptp(at_0.states.values, axis=0).min() > 0.1


@pytest.mark.slow
def test_every_one_acts_where_its_law_says(rig):
    nominal = push(rig)
    for own in OF_ALL:
        places = dict.fromkeys(slot.key for slot in rig.slots if slot.effect.id == own.id)
        run = push(rig, effects={next(iter(places)): {"size": 0.2}})
        moved = run.experiment if own.family == "sensor" else run.states
        still = nominal.experiment if own.family == "sensor" else nominal.states
        assert np.abs(moved.values - still.values).max() > 1e-5, own.id
    read = push(rig, effects={"cube@w": {"size": 0.05}, "quantisation@w": {"step": 0.5}}).experiment["w"]
    w = nominal.states["w"]
    np.testing.assert_allclose(read, 0.5 * np.round((w + 0.05 * w**3) / 0.5), atol=1e-12)  # the converter comes last


def test_every_effect_of_the_catalogue_would_be_taken_as_an_own_one():
    for plant in PLANTS.values():
        own = {e.id: replace(e, id=f"own-{e.id}") for offered in plant.offered.values() for e in offered}
        check_own(tuple(own.values()), plant.all_ports, plant.name)


def test_another_law_of_the_same_id_is_another_kernel(monkeypatch):
    """What is compiled is kept by its text: a law that was mended must not run as it was."""
    texts = []
    monkeypatch.setattr(stepper, "load_kernel", texts.append)
    mended = replace(BRAKE, law=lambda e, shaft: 0.5 * brake(e, shaft))
    for own in ((BRAKE,), (replace(BRAKE),), (mended,)):
        stepper._kernel(replace(FLYWHEEL, own_effects=own), Playback(("M",), 0.05), SCALAR)
    assert texts[0] == texts[1] != texts[2]


# ---- against an independent simulation, and in a diagnosis ---------------------------------------------------------------


def torques(seed, samples):
    random = np.random.default_rng(seed)
    return np.repeat(random.uniform(-1.0, 1.0, samples // 20 + 1), 20)[:samples]


def integrated(M, peak, critical, J=0.021, b=0.009):
    """J w' = M - b w - 2 peak w critical / (critical^2 + w^2) by solve_ivp, held torque by held torque."""
    w = [0.0]
    for held in M[:-1]:
        rate = lambda t, x, held=held: (held - b * x - 2 * peak * x * critical / (critical**2 + x * x)) / J  # noqa: E731
        w.append(solve_ivp(rate, (0.0, 0.05), w[-1:], rtol=1e-10, atol=1e-12).y[0, -1])
    return np.array(w)


def record(seed, peak=0.3, critical=6.0, samples=500):
    M = torques(seed, samples)
    w = integrated(M, peak, critical) + np.random.default_rng(seed + 50).normal(0.0, 0.005, samples)
    channels = (Channel("M", "N m", "input"), Channel("w", "rad/s", "output"))
    return Experiment(f"run{seed}", 0.05 * np.arange(samples), channels, np.column_stack([M, w]), 0.05)


def test_a_simulation_equals_an_independent_one():
    M = torques(3, 200)
    run = simulate(
        FLYWHEEL, Playback(("M",), 0.05), Scenario("s", {"M": M}), parameters={"J": 0.021, "b": 0.009},
        effects={"eddy-brake@wheel": {"peak": 0.15, "speed": 6.0}},
    )  # fmt: skip
    np.testing.assert_allclose(run.states["w"], integrated(M, 0.15, 6.0), atol=1e-4)


@pytest.mark.slow
def test_a_diagnosis_names_it_among_the_catalogue():
    own, held = Dataset((record(1), record(2))), Dataset((record(3),))
    found = diagnose(FLYWHEEL, own, held)
    assert [c.key for c in found.causes] == ["eddy-brake@wheel"]
    assert not found.causes[0].ties
    numbers = found.causes[0].parameters
    assert numbers["peak"].low < 0.3 < numbers["peak"].high
    assert numbers["speed"].value == pytest.approx(6.0, rel=0.05)
    assert found.causes[0].separates == "Look there."
    assert any(limit.effect == "eddy-brake" for limit in found.limits)
    bare = diagnose(replace(FLYWHEEL, own_effects=()), own, held)
    assert (bare.finding, [c.key for c in bare.causes]) != (Finding.NAMED, ["eddy-brake@wheel"])


# ---- what is refused ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("own", "said"),
    [
        ((replace(BRAKE, id="coulomb"),), "the catalogue has one of this id.*id of its own"),
        ((BRAKE, BRAKE), "two have this id.*id of its own"),
        ((replace(BRAKE, family="span"),), "no port of the plant is of the family 'span'.*shaft, actuator, sensor"),
        ((replace(BRAKE, domain=Domain.LOAD),), "no port gives a load.*loaded=True"),
        ((replace(BRAKE, domain=Domain.COMMAND),), "the domain COMMAND is of actuator effects"),
        ((replace(BRAKE, includes=("colomb",)),), "did you mean 'coulomb'"),
        ((replace(BRAKE, state=True),), "no state of its own"),
        ((replace(BRAKE, memories=1),), "memories = 1.*keeps none"),
        ((replace(BRAKE, sentence="At {plcae}."),), "braces that are not {place}"),
        ((effect("x", "shaft", lambda e, s: -e.size, regular=False, grid=(1.0,), grid_unit=GridUnit.NOISE),), "tried in NOISE"),
        ((effect("x", "sensor", lambda e, z: z, domain=Domain.ANGLE),), "nothing turns at w"),
        ((effect("x", "shaft", lambda e, s: 0.3 * s.speed),), "is not neutral: with sizes of 0 its law adds"),
        ((effect("x", "shaft", lambda e, s: e.size * s.sped),), "asks for 'sped'.*speed, angle"),
        ((effect("x", "shaft", lambda e, s: e.length * s.speed),), "asks for 'length'"),
        ((effect("x", "shaft", lambda e: e.size),), r"law\(e, shaft\) -> torque"),
        ((effect("x", "shaft", lambda e, s: e.size if s.speed > 0.0 else 0.0),), "ValueError.*without an `if`"),
        ((effect("x", "shaft", lambda e, s: None),), "returns nothing"),
        ((effect("x", "actuator", lambda e, u, t: e.size * u),), "is not neutral"),
        ((effect("x", "sensor", lambda e, m, z0, z1, h: [z1], memories=2),), "it keeps 1 numbers, memories=2"),
    ],
)
def test_what_a_plant_cannot_have_is_refused_with_the_mend(own, said):
    with pytest.raises(InputError, match=rf"(?s)flywheel, effect '{own[0].id}': .*{said}"):
        replace(FLYWHEEL, own_effects=own)


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ({"parameters": (size(shape=True),)}, "one number at least must be a size"),
        ({"id": "eddy brake"}, "letters, digits and hyphens"),
        ({"id": "eddy@wheel"}, "letters, digits and hyphens"),
        (
            {"parameters": (size("cosine"), size("sine"), size("width", "1", shape=True)), "phase": True},
            "1/turn or a frequency in Hz",
        ),
    ],
)
def test_an_effect_that_means_nothing_anywhere_is_refused(numbers, said):
    with pytest.raises(InputError, match=said):
        replace(BRAKE, **numbers)


def test_a_number_of_an_effect_has_a_name_and_a_default_within_its_bounds():
    with pytest.raises(InputError, match="'my size': expected a name as in Python"):
        size("my size")
    with pytest.raises(InputError, match="is 0 by default, outside"):
        size("time", "s", low=0.1, shape=True)


def test_a_machine_of_the_workbench_takes_them_on_all_its_shafts():
    mine = replace(WEB_WINDING, own_effects=(BRAKE,))
    assert {slot.place for slot in mine.slots if slot.effect is BRAKE} == {"unwind", "rewind", "pulley"}
    sliding = [slot for slot in replace(WELDING_ROBOT, own_effects=(BRAKE,)).slots if slot.effect.id == "eddy-brake"]
    assert [(s.place, s.parameter.unit) for s in sliding] == [("rail", "N"), ("rail", "m/s")]
    assert sliding[1].parameter.default == 0.01 * BRAKE.parameters[1].default
