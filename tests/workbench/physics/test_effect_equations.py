"""The equation that a reader sees computes what the law of the effect does, sign by sign and number by number."""

import re

import numpy as np
import pytest

from plants import PLANTS
from workbench.physics.effects import EFFECTS
from workbench.physics.effects.effect import Named, smooth_step

FUNCTIONS = {name: getattr(np, name) for name in ("tanh", "exp", "cos", "sin", "abs", "floor", "pi")}
FUNCTIONS |= {"max": max, "min": min, "step": lambda x: smooth_step(x, 0.0)}


def computed(equation, values):
    """The left-hand sides of "a = ..., b = ..." by name, the later ones first: the earlier are written in them."""
    known = FUNCTIONS | values
    for part in reversed(re.split(r", (?=[\w']+ = )", equation)):
        left, right = part.split(" = ")
        known[_plain(left)] = eval(_plain(right), {"__builtins__": {}}, known)  # the catalogue's own text, not input
    return known


def _plain(text):
    return text.replace("^", "**").replace("''", "_second").replace("'", "_rate")


def number(name):
    """Some number for a parameter or symbol, the same each time, none of them special."""
    return 0.3 + 0.1 * (sum(map(ord, name)) % 11)


def sizes(effect):
    return {p.name: min(number(p.name), p.high) for p in effect.parameters}


SHAFT = {"v": -0.7, "phi": 0.9, "load": -1.3, "t": 0.52}
SPAN = {"k": 2.0, "e": 0.4, "T": 1.7, "rest": 1.1, "t": 0.6, "x": 0.2}


def by_law(effect, e):
    """What the law gives at the points below, by the name that it has in the equation."""
    law = effect.law
    match effect.family:
        case "shaft":
            return {"torque": law(e, Named({"speed": SHAFT["v"], "angle": SHAFT["phi"], "load": SHAFT["load"], "t": SHAFT["t"]}))}
        case "reel":
            return {"deviation": law(e, Named({"angle": 0.9, "speed": 3.0}))[0]}
        case "pulley":
            return {"slip": law(e) * 0.8}
        case "spring":
            return {"push": law(e, Named({"stretch": -0.7}))}
        case "tank":
            outlet, spill = law(e, Named({"level": 2.7, "outflow": 0.8, "rest": 1.1}))
            return {"spill": spill} if effect.id == "overflow" else {"outlet": 0.8 + outlet}
        case "span":
            at = {"stretch": SPAN["e"], "stiffness": SPAN["k"], "tension": SPAN["T"], "rest": SPAN["rest"], "t": SPAN["t"]}
            added, inner = law(e, Named(at | {"state": SPAN["x"]}))
            return {"T_rate": SPAN["k"] * SPAN["e"] + added} | ({"x_rate": inner} if effect.state else {})
        case "winding":
            return {"thickness": 2.0 * (1.0 + law(e, 0.7))}
        case "robot":
            force, change = law(e, Named({"arm": 0.4, "arm_rate": -1.2, "t": 0.7}))
            return {"mass": 5.0 * (1.0 + change)} if effect.id == "platform-mass" else {"force": force}
        case "actuator":
            return {"acting": law(e, 0.1, 1.4, 1.0)[1] if effect.memories else law(e, 1.4, 0.6)}
        case _:
            return {"reading": law(e, [0.1], 0.0, 2.3, 0.02)[0] if effect.memories else law(e, 2.3)}


POINTS = {
    "shaft": SHAFT,
    "reel": {"phi": 0.9},
    "pulley": {"T1": 0.4, "T2": 1.2},
    "spring": {"s": -0.7},
    "tank": {"level": 2.7, "outflow": 0.8, "rest": 1.1},
    "span": SPAN,
    "winding": {"s": 2.0, "v": 0.7},
    "robot": {"arm": 0.4, "arm_rate": -1.2, "t": 0.7, "m": 5.0},
    "actuator": {"u": 1.4, "t": 0.6, "before": 0.1, "dt": 1.0},
    "sensor": {"z": 2.3, "before": 0.1},
}
OF_TIME = ("input-delay", "sensor-lag", "sensor-resonance")  # no map of one moment: below


@pytest.mark.parametrize("effect", [e for e in EFFECTS.values() if e.id not in OF_TIME], ids=lambda e: e.id)
def test_the_equation_that_is_read_is_the_law_that_is_run(effect):
    own = sizes(effect)
    found = computed(effect.equation, POINTS[effect.family] | own)
    for name, value in by_law(effect, Named(own)).items():
        assert found[name] == pytest.approx(float(value), rel=1e-12), name
        assert value != 0.0


@pytest.mark.parametrize("name", ["sensor-lag", "sensor-resonance"])
def test_the_equation_of_a_slow_sensor_holds_along_a_step(name):
    """The differential equation's two sides, with derivatives from differences of the law's own run."""
    effect, h, z = EFFECTS[name], 1e-4, 1.5
    own = sizes(effect)
    m, run = [0.2] * effect.memories, []
    for _ in range(3):
        m = effect.law(Named(own), m, z, z, z, h)
        run.append(float(m[0]))
    slope, bend = (run[2] - run[0]) / (2 * h), (run[2] - 2 * run[1] + run[0]) / h**2
    values = FUNCTIONS | own | {"z": z, "reading": run[1], "reading_rate": slope, "reading_second": bend}
    left, right = (eval(_plain(side), {"__builtins__": {}}, values) for side in effect.equation.split(" = "))
    assert left == pytest.approx(right, abs=1e-5)
    assert abs(right) > 0.1


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
def test_every_symbol_of_an_equation_is_a_parameter_or_said_at_its_port(plant):
    for port in plant.all_ports:
        for effect in plant.offered[port.family, port.place]:
            words = set(re.findall(r"[A-Za-z_]\w*", effect.equation)) - {*FUNCTIONS, *(p.name for p in effect.parameters)}
            own = set(re.findall(r"(\w+)'* = ", effect.equation))
            said = set(re.findall(r"\w+", port.symbols)) | {"t", "x", "s", "m"} & own
            assert words - {"t"} <= said, f"{effect.id} at {port.place}"


def test_what_slides_has_forces_and_no_torques():
    robot, winding = PLANTS["welding-robot"], PLANTS["web-winding"]
    for plant, word in ((robot, "torque"), (winding, "force")):
        for slot in plant.slots:
            if slot.effect.family == "shaft":
                text = f"{slot.effect.sentence} {slot.effect.equation} {slot.effect.separates}"
                assert word not in text.lower().replace("friction force", ""), str(slot)
    on_rail = next(s.effect for s in robot.slots if s.key == "coulomb@rail")
    assert on_rail.sentence == "Dry friction at {place}: a constant force against the direction of motion."
    assert on_rail.equation == "force = -level * tanh(v / width)"
    assert EFFECTS["coulomb"].sentence.count("torque") == 1
