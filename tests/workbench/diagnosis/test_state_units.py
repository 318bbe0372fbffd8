"""The unit of a state is its author's affair: Pa or bar, nothing that is said of a machine depends on it."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from tests.strangers.case import Kind, draw
from tests.strangers.registry import MACHINES
from workbench.data import Dataset
from workbench.diagnosis.predictor import predictor
from workbench.diagnosis.recalibrate import recalibrated
from workbench.diagnosis.refit import Model, settled
from workbench.physics.plant import Plant

pytestmark = pytest.mark.slow

INNER = [("cylinder", "pL"), ("ball-in-tube", "air"), ("propeller-arm", "w"), ("two-mass", "twist"), ("heater", "T")]


def in_units(plant: Plant, state: str, factor: float) -> Plant:
    """The same plant with `state` in a unit of 1/factor."""

    def own(x):
        return SimpleNamespace(**{n: getattr(x, n) / (factor if n == state else 1.0) for n in plant.state_names})

    def equation(x, u, p, at):
        rates = dict(plant.equation(own(x), u, p, at))
        return rates | {state: factor * rates[state]}

    def measure(x, p, *u):
        return plant.measure(own(x), p, *u)

    assert state not in plant.limits
    return replace(plant, equation=equation, measure=measure)


@cache
def records(machine: str, samples: int = 600) -> Dataset:
    drawn = draw(7, machine=machine, kind=Kind.NOTHING)
    return Dataset(tuple(e.trim(stop=(samples - 0.5) * e.dt) for e in drawn.records))


@pytest.mark.parametrize(("machine", "state"), INNER)
@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_what_is_expected_of_noise_and_starts_has_the_unit_of_the_state(machine, state, factor):
    plant, own = MACHINES[machine].plant, records(machine)
    one, other = predictor(plant, own), predictor(in_units(plant, state, factor), own)
    assert other.entries == one.entries
    by = np.array([factor if name == state else 1.0 for name in one.entries])
    assert other.expected.process == pytest.approx(by * one.expected.process, rel=1e-6)
    assert other.expected.drift == pytest.approx(by[: len(one.expected.drift)] * one.expected.drift, rel=1e-6)
    units = np.array([factor if name == state else 1.0 for name in plant.state_names])
    for a, b in zip(one.records, other.records, strict=True):
        assert b.scale == pytest.approx(units * a.scale, rel=1e-6)
        assert b.start == pytest.approx(units * a.start, rel=1e-6, abs=1e-9 * float((units * a.scale).max()))


def fitted(plant: Plant, own: Dataset) -> Model:
    made = recalibrated(predictor(plant, own), rounds=1)
    return settled(Model(made.predictor, made.fit), np.zeros(len(plant.slots)))


def test_parameters_and_noise_of_a_cylinder_in_any_unit_of_pressure():
    """From the data sheet and from other parameters, in Pa and in 0.1 MPa: one and the same likelihood and machine."""
    plant, own = MACHINES["cylinder"].plant, records("cylinder", 1500)
    moved = replace(plant, parameters=tuple(replace(q, value=q.value * (1.0 + 0.5 * q.tolerance)) for q in plant.parameters))
    first = fitted(plant, own)
    for other in (in_units(plant, "pL", 1e-5), in_units(plant, "pL", 1e3), moved):
        again = fitted(other, own)
        assert again.deviance == pytest.approx(first.deviance, abs=6.0)  # what a cause must be worth
