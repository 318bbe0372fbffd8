"""What a diagnosis named, cancelled by feedforward: tried on a simulation written out here, on axes drawn at random."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from controllers import ScheduledPIDDesign, compensated, load_controller, save_controller
from controllers.cancelled import Compensation
from plants import POSITIONING_AXIS
from tests.controllers.test_designs import swinging
from tests.strangers.belt import PLANT as BELT
from tests.strangers.belt import outputs, rates
from workbench.curves import Curve
from workbench.errors import InputError
from workbench.physics.linearised import linearised

DT = 0.004
AXIS = POSITIONING_AXIS.sampled(DT)
MOVED = {"q": {"low": -0.12, "high": 0.1, "rate": 0.3}}


def within(value, share):
    return {"value": value, "low": value * (1.0 - share), "high": value * (1.0 + share), "unit": ""}


def named(effect, place="slide", **numbers):
    """What a diagnosis.json holds of one cause, sizes known to 10 %, and of the axis."""
    cause = {"effect": effect, "at": place, "parameters": {key: within(value, 0.1) for key, value in numbers.items()}}
    recalibrated = {"M": within(95.0, 0.01), "Fv": within(200.0, 0.03)}
    return {"plant": AXIS.name, "causes": [cause], "recalibrated": recalibrated, "moved": MOVED}


def of(said, key):
    """What became of one cause."""
    return next(own for own in said if own.effect == key)


def path(seed, N=4000):
    """Moves and stands (N, 1) of random length; smooth."""
    random, r, k, at = np.random.default_rng([8, seed]), np.zeros(N), 0, 0.0
    while k < N:
        n, to = int(random.uniform(200, 500)), random.uniform(-0.12, 0.1)
        share = np.linspace(0.0, 1.0, n)
        whole = np.append(at + (to - at) * (share - np.sin(2.0 * np.pi * share) / (2.0 * np.pi)), np.full(60, to))
        r[k : k + len(whole)] = whole[: N - k]
        k, at = k + len(whole), to
    return r[:, None]


def error(law, r, M, Fv, friction=lambda v: 0.0, *, delay=0.0, dead=0.0, gear=0.0, play=0.0, lag=0.0, due=0.0, steps=20):
    """Root mean square of m - q in m on M q'' = F - Fv q' - friction(q'), by the midpoint rule; m as late as `due`. What arrives
    of a command comes `delay` s late, less a dead zone and the impulse that a gear's play swallows; a sensor has play or lags.
    """
    q = v = teeth = shown = lagged = 0.0
    h = DT / steps
    state, said, arriving = law.init(np.zeros(1)), [], [0.0] * round(delay / h)
    for now in r:
        said.append(q)
        shown = max(q - play, min(q + play, shown))
        (F,), state = law.step(state, now, np.array([lagged if lag else shown]))
        for _ in range(steps):
            arriving.append(F)
            force = arriving.pop(0)
            force -= np.clip(force, -dead, dead)
            before, teeth = teeth, np.clip(teeth + force * h, -0.5 * gear, 0.5 * gear)
            force -= (teeth - before) / h
            middle = v + 0.5 * h * (force - Fv * v - friction(v)) / M
            q, v = q + h * middle, v + h * (force - Fv * middle - friction(middle)) / M
            lagged += (q - lagged) * -np.expm1(-h / lag) if lag else 0.0
    m, k = law.aimed(r, np.zeros(1))[0][:, 0], np.arange(len(r))
    return float(np.sqrt(np.mean((np.interp(k - due / DT, k, m) - said) ** 2)))


def friction_of(seed):
    """An effect of the axis drawn at random, and how it acts, written out."""
    random = np.random.default_rng([9, seed])
    level, width, other, speed = random.uniform(12.0, 40.0), random.uniform(5e-4, 3e-3), random.uniform(10.0, 40.0), 0.08
    kind = ("coulomb", "asymmetric-friction", "stribeck")[seed % 3]
    if kind == "coulomb":
        return kind, {"level": level, "width": width}, lambda v: level * np.tanh(v / width)
    if kind == "asymmetric-friction":
        both = {"forward": level, "backward": other, "width": width}
        return kind, both, lambda v: (level if v > 0 else other) * np.tanh(v / width)
    fading = {"level": level, "speed": speed, "width": width}
    return kind, fading, lambda v: level * np.exp(-((v / speed) ** 2)) * np.tanh(v / width)


def designed(**options):
    """A PID on the axis with half as much viscous friction again, as a model that was identified under dry friction has it."""
    return ScheduledPIDDesign(**options).on(linearised(AXIS.with_parameters({"Fv": 300.0})))


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"paths": ("q",)}, {"reference_model": {"q": 25.0}}])
def test_friction_is_cancelled_on_machines_that_are_not_quite_those_found(options):
    law, factors = designed(**options), []
    for seed in range(12):
        random = np.random.default_rng([10, seed])
        kind, numbers, friction = friction_of(seed)
        found = {key: value * (1.0 + 0.1 * random.uniform(-1.0, 1.0)) for key, value in numbers.items()}
        better, said = compensated(law, replace(AXIS, effects={f"{kind}@slide": found}), named(kind, **found))
        assert of(said, f"{kind}@slide").done, of(said, f"{kind}@slide").sentence
        assert len(better.compensations) == 1
        np.testing.assert_allclose(better.compensations[0].motion, 1.0, atol=0.02)
        M, Fv = 95.0 * (1.0 + 0.01 * random.uniform(-1.0, 1.0)), 200.0 * (1.0 + 0.03 * random.uniform(-1.0, 1.0))
        factors.append(error(law, r := path(seed), M, Fv, friction) / error(better, r, M, Fv, friction))
        for key in ("Kp", "Ki", "Kd", "Kr", "u0", "b", "c"):
            np.testing.assert_array_equal(getattr(better, key), getattr(law, key))
    assert np.median(factors) > 8.0
    assert np.quantile(factors, 0.1) > 4.0


OTHERS = {  # effect, place, its number, from where to where it is drawn, and its name above
    "delay": ("input-delay", "F", "time", 0.004, 0.012),
    "dead": ("dead-zone", "F", "half_width", 5.0, 30.0),
    "gear": ("gear-backlash", "F", "play", 0.2, 2.0),
    "play": ("backlash", "q", "half_width", 2e-4, 2e-3),
    "lag": ("sensor-lag", "q", "time", 0.005, 0.03),
}


@pytest.mark.slow
@pytest.mark.parametrize("key", OTHERS)
def test_dead_time_play_dead_zone_and_a_slow_sensor_are_cancelled(key):
    """Size known to 10 %; also against the law whose feedforward alone was fitted."""
    effect, place, name, low, high = OTHERS[key]
    noisy = replace(AXIS, noise={"q": 2e-6})
    for seed, options in enumerate(({"paths": ("q",)}, {"reference_model": {"q": 25.0}})):
        random = np.random.default_rng([12, seed, list(OTHERS).index(key)])
        true = low * (high / low) ** random.uniform()
        found = true * (1.0 + 0.1 * random.uniform(-1.0, 1.0))
        law, content = designed(**options), named(effect, place, **{name: found})
        plant = replace(noisy, effects={f"{effect}@{place}": {name: found}})
        better, said = compensated(law, plant, content, early=bool(seed == 0))
        assert of(said, f"{effect}@{place}").done, of(said, f"{effect}@{place}").sentence
        due = next((float(own.late[0]) for own in said if own.effect == "lateness"), 0.0)
        assert due >= found * (key == "delay")
        assert due == 0.0 or seed == 0 or key == "delay"  # early, or a reference model before a dead time
        own = min(due, 1.5 * DT) * (seed == 0)
        fed = replace(better, late=own, play=0.0, inverses=())
        M, Fv = 95.0 * (1.0 + 0.01 * random.uniform(-1.0, 1.0)), 200.0 * (1.0 + 0.03 * random.uniform(-1.0, 1.0))
        after = error(better, r := path(seed), M, Fv, **{key: true}, due=due)
        assert error(law, r, M, Fv, **{key: true}) > 3.0 * after
        assert error(fed, r, M, Fv, **{key: true}, due=own) > 1.3 * after


@pytest.mark.slow
def test_friction_before_a_dead_time_are_both_cancelled():
    law, sizes, rubs = designed(paths=("q",)), {"time": 0.009}, {"level": 25.0, "width": 1e-3}
    content = named("coulomb", **rubs)
    content["causes"] += named("input-delay", "F", **sizes)["causes"]
    plant = replace(AXIS, effects={"coulomb@slide": rubs, "input-delay@F": sizes}, noise={"q": 2e-6})
    better, said = compensated(law, plant, content, early=True)
    assert [own.effect for own in said if own.done][-3:] == ["coulomb@slide", "input-delay@F", "lateness"]
    assert said[-1].late == pytest.approx([1.5 * DT + 0.009])
    true = {"friction": lambda v: 23.5 * np.tanh(v / 1e-3), "delay": 0.0085}
    after = error(better, r := path(3), 95.5, 204.0, **true, due=better.late[0])
    assert error(law, r, 95.5, 204.0, **true) > 8.0 * after
    assert error(replace(better, late=1.5 * DT), r, 95.5, 204.0, **true, due=1.5 * DT) > 1.5 * after
    tied = content | {"causes": [content["causes"][0], content["causes"][1] | {"ties": ["sensor-lag@q"]}]}
    told = of(compensated(law, plant, tied, early=True)[1], "input-delay@F").sentence
    assert told.endswith("; if it is sensor-lag@q instead, which suits the records too, outputs are there sooner")
    _, said = compensated(law, plant, content)
    assert "with --early paths are given that much early" in of(said, "input-delay@F").sentence


@pytest.mark.slow
def test_nothing_is_cancelled_that_does_not_pay():
    law = designed(paths=("q",))
    near_nothing = named("coulomb", level=20.0, width=1e-3)
    near_nothing["causes"][0]["parameters"]["level"] |= {"low": 0.0, "high": 21.0}
    rubbed = replace(AXIS, effects={"coulomb@slide": {"level": 20.0, "width": 1e-3}})
    better, every = compensated(law, rubbed, near_nothing)
    said = of(every, "coulomb@slide")
    assert not said.done
    assert "times as large" in said.sentence
    assert not better.compensations
    slight = replace(AXIS, effects={"coulomb@slide": {"level": 0.02, "width": 1e-3}})
    better, every = compensated(law, slight, named("coulomb", level=0.02, width=1e-3))
    assert "without it errors of set-points would be" in of(every, "coulomb@slide").sentence
    assert not better.compensations
    wheel = {"cosine": 5.0, "sine": 1.0}
    _, every = compensated(law, replace(AXIS, effects={"imbalance@slide": wheel}), named("imbalance", amplitude=5.1))
    assert of(every, "imbalance@slide").sentence.startswith("imbalance@slide is not cancelled: only what depends on a speed")
    content = named("coulomb", level=20.0, width=1e-3)
    for more, why in (
        ({"ties": ["dead-zone@F"]}, "the records cannot tell it from dead-zone@F"),
        (
            {"ties": ["asymmetric-friction@slide", "imbalance@slide + offset@F"]},
            "the records cannot tell it from imbalance@slide",
        ),
        ({"doubt": "it gains nothing"}, "the diagnosis is not sure of it"),
    ):
        _, every = compensated(law, rubbed, content | {"causes": [content["causes"][0] | more]})
        assert of(every, "coulomb@slide").sentence == f"coulomb@slide is not cancelled: {why}"
    _, every = compensated(law, rubbed, content | {"causes": [content["causes"][0] | {"ties": ["stribeck@slide"]}]})
    assert of(every, "coulomb@slide").done


@pytest.mark.slow
def test_a_bias_and_friction_that_began_long_ago_hide_nothing():
    """The job began with a step of the bias, and before the jump: both times friction of 22 N was worth nothing."""
    law, rubs = designed(paths=("q",)), {"level": 22.0, "width": 1e-3}
    for effects in (
        {"coulomb@slide": rubs, "sensor-bias@q": {"level": 0.05}},
        {"friction-jump@slide": rubs | {"time": 60.0}},
    ):
        key = next(iter(effects))
        content = named(key.partition("@")[0], **effects[key])
        bias = {"effect": "sensor-bias", "at": "q", "parameters": {"level": within(0.05, 0.1)}}
        content["causes"] += [bias] * (len(effects) - 1)
        better, every = compensated(law, replace(AXIS, effects=effects), content)
        assert of(every, key).done, of(every, key).sentence
        assert np.median(of(every, key).before / of(every, key).after) > 4.0
        assert [own.effect for own in better.compensations] == [key]


def test_limits_stay_within_a_saturation_that_was_named():
    """An integral that goes on to push where nothing more arrives comes back late."""
    plant = replace(AXIS, effects={"saturation@F": {"limit": 80.0}})
    content = named("saturation", "F", limit=80.0)
    law, (said,) = compensated(designed(reference_model={"q": np.inf}, low={"F": -50.0}), plant, content)
    assert (law.low.tolist(), law.high.tolist()) == ([-50.0], [80.0])
    assert said.sentence == "saturation@F: F stays from -50 to 80, where the integral does not wind up"


def test_what_cannot_be_cancelled_is_told():
    rubbed = replace(AXIS, effects={"coulomb@slide": {"level": 20.0, "width": 1e-3}})
    content = named("coulomb", level=20.0, width=1e-3)
    law, (said,) = compensated(plain := designed(reference_model={"q": np.inf}), rubbed, content)
    assert law is plain
    assert "set-points that may step have no speed: give them a reference model or a path" in said.sentence
    path = designed(paths=("q",))
    with pytest.raises(InputError, match="does not say how far and fast the outputs moved"):
        compensated(path, rubbed, {key: own for key, own in content.items() if key != "moved"})
    with pytest.raises(InputError, match="a diagnosis of web-winding"):
        compensated(path, rubbed, content | {"plant": "web-winding"})
    with pytest.raises(InputError, match="names coulomb@slide, which positioning-axis does not have"):
        compensated(path, AXIS, content)
    with pytest.raises(InputError, match=r"the law runs every 0.004 s, the plant every 0.003 s"):
        compensated(path, rubbed.sampled(0.003), content)
    with pytest.raises(InputError, match="holds no intervals"):
        compensated(path, rubbed, {"plant": "positioning-axis"})
    with pytest.raises(InputError, match="it stood still in the records"):
        compensated(path, rubbed, content | {"moved": {"q": {"low": 0.1, "high": 0.1, "rate": 0.0}}})


@pytest.fixture(scope="module")
def fed():
    """A law of the oscillator that cancels something, by hand."""
    law = ScheduledPIDDesign(paths=("y",)).on(swinging(0.4))
    curve = Curve("u", [-1.0, -0.1, 0.1, 1.0], [-0.5, -0.4, 0.4, 0.5])
    return replace(law, compensations=(Compensation("u", "coulomb@pivot", [0.0], [1.0], curve, "speed [m/s]"),))


def test_its_file_holds_it(fed, tmp_path):
    again = load_controller(save_controller(fed, tmp_path / "pid.json"))
    assert again.compensations[0].effect == "coulomb@pivot"
    random = np.random.default_rng(1)
    a, b = fed.init(), again.init()
    for _ in range(50):
        r, y = random.normal(size=(2, 1))
        (u, a), (v, b) = fed.step(a, r, y), again.step(b, r, y)
        np.testing.assert_array_equal(u, v)
    assert fed.uncompensated.compensations == ()
    assert fed.unshaped.compensations == ()


def belt_error(law, r, level, width, steps=10):
    """Root mean square of m - y, by set-point, on two drives and a belt with dry friction in both, by the midpoint rule."""
    p = SimpleNamespace(**{q.name: q.value for q in BELT.parameters}, rubber=0.0, mixer=0.0)
    x, said, h = np.zeros(3), [], law.dt / steps

    def slope(x, u):
        rubbing = SimpleNamespace(first=-level * np.tanh(x[0] / width), second=-level * np.tanh(x[1] / width))
        return np.array(rates(x, u, p, rubbing))

    state = law.init(np.zeros(2))
    for now in r:
        n1, _, B = outputs(x, p)
        said.append([n1, B])
        u, state = law.step(state, now, np.array(said[-1]))
        for _ in range(steps):
            x = x + h * slope(x + 0.5 * h * slope(x, u), u)
    return np.sqrt(np.mean((law.aimed(r, np.zeros(2))[0] - said) ** 2, axis=0))


@pytest.mark.slow
def test_friction_in_both_of_two_drives_on_a_belt_is_cancelled():
    """What one curve over one speed cancels is not asked of a second one; two inputs, two set-points, a simulation apart."""
    level, width = 0.05, 0.4
    drives = replace(
        BELT,
        outputs=(BELT.outputs[0], BELT.outputs[2]),
        measure=lambda x, p: {name: y for name, y in BELT.measure(x, p).items() if name != "n2"},
        noise={"n1": 0.5, "B": 0.2},
        effects={f"coulomb@{place}": {"level": level, "width": width} for place in ("first", "second")},
    )
    law = ScheduledPIDDesign(low={"i1": -10.0, "i2": -10.0}, high={"i1": 10.0, "i2": 10.0}).on(linearised(drives, 0.01))
    causes = [named("coulomb", place, level=level, width=width)["causes"][0] for place in ("first", "second")]
    moved = {"n1": {"low": -300.0, "high": 300.0, "rate": 600.0}, "B": {"low": -10.0, "high": 10.0, "rate": 40.0}}
    better, said = compensated(law, drives, {"plant": "belt", "causes": causes, "recalibrated": {}, "moved": moved})
    assert of(said, "coulomb@first").done
    assert {own.input for own in better.compensations} == {"i1", "i2"}
    factors = {"steps": [], "moves": []}
    for seed in range(6):
        random = np.random.default_rng([11, seed])
        true = level * (1.0 + 0.1 * random.uniform(-1.0, 1.0))
        stops = random.uniform(-1.0, 1.0, (9, 2)) * [250.0, 8.0]
        stops[0] = 0.0
        share = np.minimum(np.linspace(0.0, 1.2, 200), 1.0)[:, None]
        steps = np.repeat(stops, 200, axis=0)
        moves = np.concatenate([a + (b - a) * share**3 * (10.0 - 15.0 * share + 6.0 * share**2) for a, b in pairwise(stops)])
        for along, r in (("steps", steps), ("moves", moves)):
            factors[along].append(belt_error(law, r, true, width) / belt_error(better, r, true, width))
    assert np.median(factors["moves"], axis=0).min() > 2.0
    assert np.median(factors["steps"], axis=0).min() > 1.0
    assert np.min(list(factors.values())) > 0.98
