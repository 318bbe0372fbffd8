"""One conformance suite over every effect at every place of every plant that offers it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from plants import PLANTS as OURS
from studies.real_plants import CASCADED_TANKS, SILVERBOX
from workbench.errors import InputError
from workbench.physics.controller import Playback
from workbench.physics.effects import EFFECTS, Slide, Spring
from workbench.physics.effects.effect import GridUnit
from workbench.simulation import Scenario, simulate_batch

SPRUNG = replace(SILVERBOX, ports=(Slide("mass", "v", travel=0.5), Spring("spring")))  # it moves at some 50 m/s
PLANTS = {**OURS, "silverbox": SPRUNG, "cascaded-tanks": CASCADED_TANKS}
# a size of each effect that a technician would notice, in units of the machine: torque or force, command
FORCE = {"web-winding": 2e-3, "welding-robot": 0.3, "positioning-axis": 5.0, "silverbox": 0.01, "cascaded-tanks": 0.1}
COMMAND = {"welding-robot": 2.0, "positioning-axis": 300.0, "silverbox": 0.1}  # where the machine starts from rest
REGULAR = {
    "load-friction": 0.05, "eccentricity": 2e-4, "slip": 0.02, "nonlinear-elasticity": 0.2,
    "viscoelastic": 0.2, "periodic-tension": 0.5, "stiffness-jump": 0.2, "air-entrainment": 0.1, "platform-mass": 0.2,
    "arm-reaction": 0.2, "heating": 0.1, "sensor-nonlinearity": 1e-2, "sensor-gain": 0.02, "cubic-spring": 5.0,
    "bent-spring": 0.5, "outflow-law": -0.5,
}  # fmt: skip


@pytest.fixture(params=PLANTS.values(), ids=PLANTS)
def plant(request):
    return request.param


@cache
def scenario(plant):
    """From the equilibrium through standstill and back, twice, so that every effect shows; what moves on its own does too."""
    k, (_, u0) = np.arange(160)[:, None], plant.equilibrium()
    amplitude = np.where(u0 != 0.0, u0, COMMAND.get(plant.name, 0.0))
    u = np.where(k < 3, u0, amplitude * np.cos(2 * np.pi * (k - 3) / 80))
    return Scenario("to and fro", dict(zip(plant.input_names, u.T, strict=True)))


def runs(plant, eta, substeps=None):
    """One block or more: never the kernel for one run, so that one compilation is enough."""
    eta = np.vstack([eta, eta[-1:]])
    return simulate_batch(
        plant, Playback(plant.input_names, plant.dt), scenario(plant), effects=eta, substeps=substeps, threads=1
    )


def size_of(plant, slot):
    """A size of the parameter that shows in the runs of this file."""
    effect = slot.effect
    if not effect.regular:
        command = np.abs(scenario(plant).references.get(slot.place, np.ones(1))).max()
        noise = plant.noise.get(slot.place, 1e-4)
        unit = {GridUnit.COMMAND: command, GridUnit.IMPULSE: command * plant.dt, GridUnit.SAMPLE: plant.dt, GridUnit.NOISE: noise}
        return effect.grid[len(effect.grid) // 2] * unit[effect.grid_unit]
    if effect.id == "quadratic-friction":  # over the square of a usual speed
        return FORCE[plant.name] / {"web-winding": 100.0**2, "silverbox": 50.0**2}.get(plant.name, 0.1**2)
    return REGULAR.get(effect.id, FORCE[plant.name])


@cache
def one_at_a_time(plant):
    """Effect vectors (R, ne) that switch one size on each, and their slots; what sets in later sets in in the middle."""
    neutral = plant.effect_vector()
    for i, slot in enumerate(plant.slots):
        if slot.parameter.grid_unit is GridUnit.RECORD:
            neutral[i] = 0.5 * len(scenario(plant)) * plant.dt
    slots = [(i, slot) for i, slot in enumerate(plant.slots) if not slot.parameter.shape]
    eta = np.repeat(neutral[None], len(slots), axis=0)
    for row, (i, slot) in zip(eta, slots, strict=True):
        row[i] = size_of(plant, slot)
    return eta, [slot for _, slot in slots]


def test_every_effect_has_a_place_on_some_plant():
    assert {slot.effect.id for plant in PLANTS.values() for slot in plant.slots} == set(EFFECTS)


def test_shapes_change_nothing_while_the_sizes_are_0(plant):
    """Bit by bit, to their bounds or to a value far off."""
    neutral = plant.effect_vector()
    rows = [neutral]
    for i, slot in enumerate(plant.slots):
        if slot.parameter.shape:
            for value in (slot.parameter.low, slot.parameter.high, 3.0 * slot.parameter.default + 0.1):
                row = neutral.copy()
                row[i] = np.clip(value, max(slot.parameter.low, -1e6), min(slot.parameter.high, 1e6))
                rows.append(row)
    found = runs(plant, np.array(rows), substeps=plant.substeps)
    assert np.isfinite(found.states).all()
    for values in (found.states, found.measured, found.commands):
        assert all(np.array_equal(values[0], other) for other in values)


@pytest.mark.slow
def test_a_size_of_0_beside_all_others_in_a_block_is_still_no_effect(plant):
    """The laws of a lane that has none are computed where its neighbours need them, and must add nothing to the last bit."""
    eta, _ = one_at_a_time(plant)
    for first in range(0, len(eta), 15):
        mixed = np.vstack([plant.effect_vector()[None], eta[first : first + 15]])
        found = runs(plant, mixed, substeps=plant.substeps)
        alone = runs(plant, plant.effect_vector()[None], substeps=plant.substeps)
        delayed = any(mixed[:, i].any() for i, slot in enumerate(plant.slots) if slot.effect.id == "input-delay")
        if delayed:  # the grid of its neighbours has more points, so that the steps are others
            np.testing.assert_allclose(found.states[0], alone.states[0], rtol=1e-4, atol=1e-9)
        else:
            assert np.array_equal(found.states[0], alone.states[0])
            assert np.array_equal(found.measured[0], alone.measured[0])


def test_every_size_changes_what_is_measured(plant):
    eta, slots = one_at_a_time(plant)
    found = runs(plant, eta, substeps=60)
    nominal = runs(plant, plant.effect_vector()[None], substeps=60).measured[0]
    spread = np.ptp(nominal, axis=0)
    assert np.isfinite(found.states).all()
    silent = [str(slot) for slot, y in zip(slots, found.measured, strict=False) if (np.abs(y - nominal) / spread).max() < 1e-6]
    assert not silent


@pytest.mark.slow
def test_a_finer_integrator_changes_nothing_visible(plant):
    """Integrator error would be found as physics. Of a quantised reading a whole step may change: it is left out."""
    eta, slots = one_at_a_time(plant)
    keep = [i for i, slot in enumerate(slots) if slot.effect.id != "quantisation"]
    coarse, fine = runs(plant, eta[keep], substeps=60), runs(plant, eta[keep], substeps=120)
    noise = [plant.noise.get(name, 1e-4 * np.ptp(fine.measured[0, :, j])) for j, name in enumerate(plant.output_names)]
    error = np.abs(coarse.measured - fine.measured)[:-1] / noise
    worst = {str(slots[i]): float(e.max()) for i, e in zip(keep, error, strict=True) if e.max() > 0.1}
    assert not worst


def test_sensors_show_their_steady_state_from_the_first_sample(plant):
    """A machine at rest under every sensor effect at once: the reading stands still from the start, at the static map of it."""
    quiet = Scenario(
        "rest", {name: np.full(6, value) for name, value in zip(plant.input_names, plant.equilibrium()[1], strict=True)}
    )
    eta, q = plant.effect_vector(), plant.output(plant.equilibrium()[0])
    sizes = {"backlash": 0.02, "sensor-lag": 0.03, "sensor-resonance": 0.05, "sensor-gain": 0.1, "sensor-bias": 0.7}
    for i, slot in enumerate(plant.slots):
        if slot.effect.family == "sensor" and not slot.parameter.shape:
            eta[i] = sizes.get(slot.effect.id, 0.0)
    loop, eta = Playback(plant.input_names, plant.dt), np.repeat(eta[None], 2, axis=0)
    found = simulate_batch(plant, loop, quiet, effects=eta, threads=1).measured[0]
    np.testing.assert_allclose(found[0], 1.1 * np.array(q) + 0.7, rtol=1e-14)
    if plant.name != "web-winding":  # there the radii go on changing
        np.testing.assert_allclose(found[1:], np.broadcast_to(found[0], found[1:].shape), rtol=1e-12)


def test_every_bound_is_kept(plant):
    for slot in plant.slots:
        for value, outside in ((slot.parameter.low, -1.0), (slot.parameter.high, 1.0)):
            if np.isfinite(value):
                plant.effect_vector({slot.key: {slot.parameter.name: value}})
                beyond = value + outside * max(1.0, abs(value))
                with pytest.raises(InputError, match=f"{slot.key}:{slot.parameter.name}"):
                    plant.effect_vector({slot.key: {slot.parameter.name: beyond}})


def test_every_number_is_in_a_unit_of_this_machine(plant):
    for slot in plant.slots:
        assert "unit of" not in slot.parameter.unit, str(slot)
        assert slot.parameter.low <= slot.parameter.default <= slot.parameter.high
        if slot.parameter.grid_unit is GridUnit.ONE:
            assert all(slot.parameter.low <= value <= slot.parameter.high for value in slot.parameter.grid), str(slot)
        assert slot.place in slot.effect.sentence.format(place=slot.place)
