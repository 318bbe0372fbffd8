"""Springs that are not linear, outflows that are not in proportion and tanks that overflow, simulated by scipy and named."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from workbench.data import Channel, Dataset, Experiment
from workbench.diagnosis.answer import Finding
from workbench.diagnosis.diagnosis import diagnose
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
    assert the_cause(MASS, oscillations(seed, cubic=-600.0)).parameters["cubic"].value == pytest.approx(-600.0, rel=0.05)


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
        for port in (Spring("s"), Spring("s", twisted=True))
        for effect in MASS.offered["spring", "spring"][:1]
    )
    assert (pulled.unit, twisted.unit) == ("N/m^3", "N m/rad^3")
