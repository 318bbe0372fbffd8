"""Runs that begin anew, at every sample, from the states that a filter has found go on as the machine does: with every effect."""

from dataclasses import replace

import numpy as np
import pytest

from tests.workbench.physics.test_effects_on_plants import PLANTS, one_at_a_time, runs, scenario
from workbench.data import Dataset, Experiment
from workbench.diagnosis.gains import BEHIND, errors
from workbench.diagnosis.predictor import predictor

AHEAD = 20  # samples
STEPS = 240  # of the integrator a sample: dry friction is not softened
ROUNDED = ("quantisation",)  # a staircase is noise to a filter


def recorded(plant, measured):
    """A record without noise of the machine that `one_at_a_time` moves to and fro."""
    u = scenario(plant).references
    units = {c.name: c.unit for c in (*plant.inputs, *plant.outputs)}
    outputs = dict(zip(plant.output_names, measured.T, strict=True))
    return Experiment.from_arrays("to and fro", plant.dt, inputs=u, outputs=outputs, units=units)


@pytest.mark.slow
@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
def test_a_run_from_the_states_of_a_filter_goes_on_as_the_machine_does(plant):
    """Errors ahead are a hundredth of what the effect does to the readings, at most, though nothing else is wrong."""
    eta, slots = one_at_a_time(plant)
    nominal = runs(plant, plant.effect_vector()[None], substeps=STEPS).measured[0]
    found, wrong = runs(plant, eta, substeps=STEPS).measured, {}
    for row, slot, y in zip(eta, slots, found, strict=False):
        if slot.effect.id in ROUNDED:
            continue
        made = replace(predictor(plant, Dataset((recorded(plant, y),))), substeps=STEPS)
        start = np.array([plant.equilibrium()[0]])
        made = made.regained(replace(made.point, eta=row[None], start=start), rounds=2)
        e = errors(made, made.point, 0, f"{AHEAD * plant.dt:g}{BEHIND}")
        worst = np.nanmax(np.abs(e), axis=0) / np.maximum(np.abs(y - nominal).max(axis=0), 1e-6 * np.ptp(nominal, axis=0))
        if not worst.max() < 0.01:
            wrong[str(slot)] = float(worst.max())
    assert not wrong
