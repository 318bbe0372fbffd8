"""One conformance suite over every plant of the registry, and a walk that finds unlisted ones."""

from pathlib import Path

import numpy as np
import pytest

import plants
from plants import PLANTS
from workbench.physics.controller import Playback
from workbench.physics.effects.effect import Named
from workbench.simulation import Scenario, simulate


@pytest.fixture(params=PLANTS.values(), ids=PLANTS)
def plant(request):
    return request.param


def points(plant, count=20, seed=1):
    """Random states, inputs, parameters, effect sizes and angles around a plant's equilibrium."""
    random = np.random.default_rng(seed)
    x0, u0 = plant.equilibrium()
    for _ in range(count):
        x = x0 * random.uniform(0.7, 1.3, len(x0)) + random.normal(0, 0.01, len(x0)) * (x0 == 0)
        u = u0 + random.normal(0, 0.3, len(u0))
        p = plant.nominal * random.uniform(0.8, 1.2, len(plant.nominal))
        eta = plant.effect_vector()
        for i, slot in enumerate(plant.slots):
            eta[i] = slot.parameter.default if slot.parameter.shape else random.uniform(0, 1e-3)
        yield x, u, p, eta, random.uniform(0, 6, len(plant.turning)), random.uniform(0, 10)


def test_numpy_and_casadi_give_the_same_derivative_and_output(plant):
    for x, u, p, eta, angle, t in points(plant):
        inner, rate = np.full(len(plant.inner), 0.3), np.full(len(plant.swinging), -0.7)
        dx, y = (np.array(v).ravel() for v in plant.traced(x, u, p, eta, angle, t, inner, rate))
        dx0 = plant.derivative(x, u, p, eta, t=t, angle=angle, inner=inner, rate=rate)
        np.testing.assert_allclose(dx0, dx, rtol=1e-11, atol=1e-9)
        np.testing.assert_allclose(plant.output(x, p), y, rtol=1e-13)


def test_compiled_step_equals_runge_kutta_in_numpy(plant):
    """The compiled engine: two samples with every effect on that needs no memory, against classic Runge-Kutta here."""
    x0, u0 = plant.equilibrium()
    sizes, eta = {}, plant.effect_vector()
    for i, slot in enumerate(plant.slots):
        if slot.effect.family not in ("actuator", "sensor") and not slot.parameter.shape:
            eta[i] = 1e-8 if slot.effect.id == "quadratic-friction" else 1e-4  # times the speed squared
            sizes.setdefault(slot.key, {})[slot.parameter.name] = eta[i]
    inputs = np.array([u0 + 0.1, u0 - 0.2, u0])
    scenario = Scenario("steps", dict(zip(plant.input_names, inputs.T, strict=True)))
    run = simulate(plant, Playback(plant.input_names, plant.dt), scenario, effects=sizes, substeps=3)

    h, nx, na = plant.dt / 3, len(x0), len(plant.turning)
    full = np.concatenate([x0, np.zeros(na + len(plant.inner))])
    turning = [plant.state_names.index(speed) for speed in plant.turning.values()]
    swinging = [plant.input_names.index(name) for name in plant.swinging]

    def rate(full, u, t):
        x, angle, inner = np.split(full, [nx, nx + na])
        dx = plant.derivative(x, u, eta=eta, t=t, angle=angle, inner=inner, rate=moved)
        return np.concatenate([dx, x[turning], plant.inner_derivative(x, u, None, eta, t, angle, inner, moved)])

    for k in range(2):
        moved = (inputs[k] - inputs[k - 1])[swinging] / plant.dt * (k > 0)
        for s in range(3):
            t = k * plant.dt + s * h
            k1 = rate(full, inputs[k], t)
            k2 = rate(full + h / 2 * k1, inputs[k], t + h / 2)
            k3 = rate(full + h / 2 * k2, inputs[k], t + h / 2)
            k4 = rate(full + h * k3, inputs[k], t + h)
            full = full + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        np.testing.assert_allclose(run.states.values[k + 1], full[: len(x0)], rtol=1e-11, atol=1e-13)


class Bare:
    """Ports without effects: torque and force 0, no run-out, no creep, the mass as it is."""

    def torque(self, load=0.0):
        return 0.0

    def runout(self):
        return Named({"radius": 0.0, "rate": 0.0})

    def creep(self):
        return 0.0

    def force(self):
        return 0.0

    def mass(self, m):
        return m

    def rate(self, stretch, stiffness, rest):
        return 0.0

    def thickness(self, s, v):
        return s


def test_neutral_effects_are_exactly_no_effects(plant):
    """Every effect of the catalogue at size 0, whatever its shapes, angles and time: the bare equation to the last bit."""
    places = Named({port.place: Bare() for port in plant.ports})
    for x, u, p, _, angle, t in points(plant, 5):
        eta = plant.effect_vector()
        for i, slot in enumerate(plant.slots):
            eta[i] = 2.0 * slot.parameter.default if slot.parameter.shape else 0.0
        state, inputs = dict(zip(plant.state_names, x, strict=True)), dict(zip(plant.input_names, u, strict=True))
        numbers = dict(zip((q.name for q in plant.parameters), p, strict=True))
        bare = plant.equation(Named(state), Named(inputs), Named(numbers), places)
        found = plant.derivative(x, u, p, eta, t=t, angle=angle)
        assert [float(bare[name]) for name in plant.state_names] == [float(v) for v in found]
        assert plant.drive(u, eta, t) == list(u)
        z = np.array(plant.output(x, p), dtype=float)
        each = len(plant.memories) // len(z)
        kept = plant.remember(np.repeat(z - 1, each), z - 1, z - 0.3, z, 0.01, eta)
        assert np.array_equal(kept[each - 2 :: each], z)  # the last effect with memory keeps two numbers, the reading first
        assert np.array_equal(plant.read(kept, np.full(len(z), 0.01), eta), z + 0.01)


def test_equilibrium_stands_still(plant):
    x0, u0 = plant.equilibrium()
    rates = dict(zip(plant.state_names, plant.derivative(x0, u0), strict=True))
    scale = max(1.0, np.abs(x0).max())
    for name in plant.start.zero or plant.state_names:
        assert abs(rates[name]) < 1e-9 * scale


def test_many_equilibria_at_once_are_those_of_each(plant):
    p = np.array([parameters for _, _, parameters, *_ in points(plant, 5)])
    x, u = plant.equilibria(p)
    for i in range(5):
        np.testing.assert_allclose(np.concatenate(plant.equilibrium(p[i])), np.concatenate([x[i], u[i]]), rtol=1e-12)


def test_linearisation_is_the_derivative_of_the_equation(plant):
    x0, u0 = plant.equilibrium()
    A, B, C, D = plant.linearize(x0, u0)
    for i, step in enumerate(1e-6 * np.maximum(np.abs(x0), 1e-3)):
        d = np.zeros(len(x0))
        d[i] = step
        central = (np.array(plant.derivative(x0 + d, u0)) - plant.derivative(x0 - d, u0)) / (2 * step)
        np.testing.assert_allclose(A[:, i], central, rtol=1e-5, atol=1e-5 * np.abs(A).max())
        np.testing.assert_allclose(
            C[:, i], (np.array(plant.output(x0 + d)) - plant.output(x0 - d)) / (2 * step), rtol=1e-6, atol=1e-9
        )
    for i in range(len(u0)):
        d = np.zeros(len(u0))
        d[i] = 1e-3
        central = (np.array(plant.derivative(x0, u0 + d)) - plant.derivative(x0, u0 - d)) / 2e-3
        np.testing.assert_allclose(B[:, i], central, rtol=1e-6, atol=1e-9)
    assert not D.any()


def test_every_number_has_a_unit_and_a_meaning(plant):
    assert plant.description
    for p in plant.parameters:
        assert p.unit, p.name
        assert p.meaning, p.name
    for c in (*plant.states, *plant.inputs, *plant.outputs):
        assert c.unit, c.name


def test_every_plant_file_is_in_the_registry():
    files = {path.stem.replace("_", "-") for path in Path(plants.__file__).parent.glob("*.py")} - {"--init--"}
    assert files == set(PLANTS)
    assert all(name == plant.name for name, plant in PLANTS.items())
