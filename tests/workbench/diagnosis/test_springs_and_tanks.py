"""Springs that are not linear, outflows that are not in proportion and tanks that overflow, simulated by scipy and named."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis import causes
from workbench.diagnosis.answer import Finding
from workbench.diagnosis.diagnosis import diagnose
from workbench.diagnosis.domains import shown
from workbench.errors import InputError
from workbench.physics.effects import Spring, Tank
from workbench.physics.parameters import Parameter
from workbench.physics.plant import Plant

MASS = Plant(
    name="mass on a spring",
    states=(Channel("q", "m"), Channel("v", "m/s")),
    inputs=(Channel("F", "N", "input"),),
    outputs=(Channel("q", "m", "output"),),
    parameters=(
        Parameter("m", 2.0, "kg", meaning="mass"),
        Parameter("d", 3.0, "N s/m", tolerance=0.4, meaning="damping"),
        Parameter("k", 200.0, "N/m", tolerance=0.2, meaning="stiffness"),
    ),
    equation=lambda x, u, p, at: {"q": x.v, "v": (u.F - p.k * x.q - p.d * x.v + at.spring.push(x.q)) / p.m},
    measure=lambda x, p: {"q": x.q},
    dt=0.02,
    ports=(Spring("spring"),),
)
TANK = Plant(
    name="tank",
    states=(Channel("h", "m"),),
    inputs=(Channel("pump", "l/s", "input"),),
    outputs=(Channel("h", "m", "output"),),
    parameters=(
        Parameter("A", 0.05, "m^2", tolerance=0.2, meaning="area"),
        Parameter("k", 0.8e-3, "m^2/s", tolerance=0.4, meaning="outflow by level, at 0.5 m"),
    ),
    equation=lambda x, u, p, at: {"h": (1e-3 * u.pump - p.k * x.h - (f := at.tank.flows(p.k * x.h)).outlet - f.spill) / p.A},
    measure=lambda x, p: {"h": x.h},
    dt=2.0,
    ports=(Tank("tank", "h", rest=0.5),),
)


def run(rates, start, commands, dt):
    """States (N, n) of held commands (N)."""
    found = [np.array(start, dtype=float)]
    for u in commands[:-1]:
        found.append(solve_ivp(lambda t, x, u=u: rates(x, u), (0.0, dt), found[-1], rtol=1e-9, atol=1e-12).y[:, -1])
    return np.array(found)


def oscillations(seed, cubic=0.0, square=0.0):
    random, made = np.random.default_rng(seed), []
    k, d = 200.0 * random.uniform(0.9, 1.1), 3.0 * random.uniform(0.8, 1.2)
    for i in range(2):
        F = np.repeat(random.uniform(-20.0, 20.0, 100), 8)
        q = run(lambda x, u: [x[1], (u - d * x[1] - k * x[0] - square * x[0] ** 2 - cubic * x[0] ** 3) / 2.0], [0, 0], F, 0.02)
        y = q[:, 0] + 2e-4 * random.standard_normal(len(F))
        units = {"F": "N", "q": "m"}
        made.append(Experiment.from_arrays(f"run {i}", 0.02, inputs={"F": F}, outputs={"q": y}, units=units))
    return Dataset(tuple(made))


def fillings(seed, brim=np.inf, root=True, largest=0.75):
    """A h' = q - a sqrt(h) (or - k h), and what is above the brim runs off in seconds."""
    random, made = np.random.default_rng(seed), []
    A, k = 0.05 * random.uniform(0.9, 1.1), 0.8e-3 * random.uniform(0.8, 1.2)

    def rates(x, u):
        h = max(x[0], 0.0)
        out = k * np.sqrt(0.5 * h) if root else k * h
        return [(1e-3 * u - out - 0.03 * max(h - brim, 0.0)) / A]

    for i in range(2):
        pump = np.repeat(random.uniform(0.05, largest, 16), 40)
        y = run(rates, [0.2], pump, 2.0)[:, 0] + 1e-3 * random.standard_normal(len(pump))
        units = {"pump": "l/s", "h": "m"}
        made.append(Experiment.from_arrays(f"run {i}", 2.0, inputs={"pump": pump}, outputs={"h": y}, units=units))
    return Dataset(tuple(made))


def halves(data):
    one, other = data.experiments
    return Dataset((one,)), Dataset((other,))


def the_cause(plant, data):
    found = diagnose(plant, *halves(data))
    assert found.finding is Finding.NAMED, (found.notes, found.remainder)
    (cause,) = found.causes
    assert not cause.doubt
    return cause


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("name", "number", "size"), [("cubic-spring", "cubic", 4000.0), ("bent-spring", "square", 300.0)])
def test_a_spring_that_is_not_linear_is_named_with_its_number(seed, name, number, size):
    cause = the_cause(MASS, oscillations(seed, **{number: size}))
    assert cause.key == f"{name}@spring"
    assert not cause.ties
    assert cause.parameters[number].value == pytest.approx(size, rel=0.05)
    assert cause.parameters[number].unit == f"N/m^{3 if number == 'cubic' else 2}"


@pytest.mark.parametrize("seed", range(3))
def test_a_spring_that_softens_has_a_negative_number(seed):
    cubic = the_cause(MASS, oscillations(seed, cubic=-600.0)).parameters["cubic"]
    assert cubic.value == pytest.approx(-600.0, rel=0.05)
    assert cubic.value - 50.0 < cubic.low < cubic.value < cubic.high < cubic.value + 50.0


@pytest.mark.parametrize("seed", range(3))
def test_an_outflow_through_a_hole_goes_with_the_root_of_the_level(seed):
    cause = the_cause(TANK, fillings(seed, largest=0.6))
    assert cause.key == "outflow-law@tank"
    assert cause.parameters["exponent"].value == pytest.approx(-0.5, abs=0.01)


@pytest.mark.parametrize("seed", range(3))
def test_a_tank_that_overflows_is_named_with_its_brim(seed):
    cause = the_cause(TANK, fillings(seed, brim=0.5, root=False))
    assert cause.key == "overflow@tank"
    assert cause.parameters["brim"].value == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(("plant", "data"), [(MASS, oscillations), (TANK, lambda seed: fillings(seed, root=False))])
@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_named_where_nothing_is_missing(plant, data, seed):
    assert diagnose(plant, *halves(data(seed))).finding is Finding.NOTHING


def test_a_twisted_spring_has_torques_and_angles():
    (pulled,), (twisted,) = (
        [port.fitted(p) for p in effect.parameters]
        for port in (Spring("s"), Spring("s", force="N m", stretch="rad"))
        for effect in MASS.offered["spring", "spring"][:1]
    )
    assert (pulled.unit, twisted.unit) == ("N/m^3", "N m/rad^3")


def test_a_level_that_jumps_once_hides_no_brim():
    (one, other), readings = fillings(0, brim=0.5, root=False), []
    for e in (one, other):
        y = e["h"].copy()
        y[300] += 0.3
        readings.append(Experiment.from_arrays(e.name, 2.0, inputs={"pump": e["pump"]}, outputs={"h": y}, units={"pump": "l/s"}))
    found = diagnose(TANK, *halves(Dataset(tuple(readings))))
    assert "overflow@tank" in [c.key for c in found.causes]


def test_a_tank_whose_level_is_no_state_or_in_another_unit_is_refused():
    with pytest.raises(InputError, match="state 'hh'"):
        replace(TANK, ports=(Tank("tank", "hh"),))
    with pytest.raises(InputError, match=r"the level h is in m, the tank in cm"):
        replace(TANK, ports=(Tank("tank", "h", unit="cm", flow="l/min"),))
    volts = Tank("tank", "h", unit="cm", flow="l/min")
    rate, brim = (volts.fitted(p) for p in TANK.offered["tank", "tank"][1].parameters)
    assert (rate.unit, brim.unit) == ("l/min/cm", "cm")


def test_a_bias_of_a_level_may_be_the_height_of_the_outlet():
    """The root of h + 0.5 is that of a level with a bias of 0.5: no record tells them apart."""
    (slot,) = [slot for slot in TANK.slots if slot.key == "sensor-bias@h"]
    assert "Or the outlet of a tank lies lower or higher by that" in causes.sentence(TANK, slot)


def test_the_picture_of_a_spring_between_two_masses_is_over_its_stretch():
    def equation(x, u, p, at):
        twisted = p.k * (x.a - x.b) - at.shaft.push(x.a - x.b)
        return {"a": x.wa, "wa": u.M - 0.8 * x.wa - twisted, "b": x.wb, "wb": twisted - 0.8 * x.wb}

    plant = Plant(
        name="two masses",
        states=(Channel("a", "rad"), Channel("wa", "rad/s"), Channel("b", "rad"), Channel("wb", "rad/s")),
        inputs=(Channel("M", "N m", "input"),),
        outputs=(Channel("a", "rad", "output"), Channel("b", "rad", "output")),
        parameters=(Parameter("k", 100.0, "N m/rad", tolerance=0.2),),
        equation=equation,
        measure=lambda x, p: {"a": x.a, "b": x.b},
        dt=0.02,
        ports=(Spring("shaft", force="N m", stretch="rad"),),
    )
    random = np.random.default_rng(0)
    M = np.repeat(random.uniform(-15.0, 15.0, 60), 8)

    def rates(x, u):
        torque = 100.0 * (x[0] - x[2]) + 3000.0 * (x[0] - x[2]) ** 3
        return [x[1], u - 0.8 * x[1] - torque, x[3], torque - 0.8 * x[3]]

    x = run(rates, [0.0] * 4, M, 0.02)
    y = {name: x[:, j] + 1e-4 * random.standard_normal(len(M)) for name, j in (("a", 0), ("b", 2))}
    e = Experiment.from_arrays("r", 0.02, inputs={"M": M}, outputs=y, units={"M": "N m", "a": "rad", "b": "rad"})
    drawn = shown(plant, {"cubic-spring@shaft": {"cubic": 3000.0}}, "cubic-spring@shaft", Dataset((e,)))
    assert (drawn.over.name, drawn.over.unit) == ("stretch of shaft", "rad")
    np.testing.assert_allclose(np.abs(drawn.after), 3000.0 * np.abs(drawn.x) ** 3, atol=0.15 * np.abs(drawn.after).max())


def test_the_picture_of_a_lower_tank_is_not_of_the_upper_one():
    e = fillings(0).experiments[0]
    plant = replace(
        TANK,
        states=(Channel("up", "m"), Channel("h", "m")),
        equation=lambda x, u, p, at: {
            "up": (1e-3 * u.pump - p.k * x.up) / p.A,
            "h": (p.k * x.up - p.k * x.h - at.tank.flows(p.k * x.h).outlet) / p.A,
        },
    )
    drawn = shown(plant, {"outflow-law@tank": {"exponent": -0.5}}, "outflow-law@tank", Dataset((e,)))
    assert drawn.over.name == "h"
    assert "rate of h" in drawn.what.name
    assert np.abs(drawn.after).max() > 1e-5
