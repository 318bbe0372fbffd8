import dataclasses

import numpy as np
import pytest

from workbench.basis import CONSTANT, Gaussian, Powers
from workbench.data import Channel, Dataset, Experiment
from workbench.identification.ssm import SSM
from workbench.lpv import LPVModel, OperatingPoint, Term, load_model
from workbench.physics.controller import Playback
from workbench.physics.effects.effect import Port
from workbench.physics.plant import Plant
from workbench.simulation import Scenario, simulate


def records(seed, N=500):
    random = np.random.default_rng(seed)
    u, p, y = random.normal(size=N), 1 + 0.5 * np.sin(np.arange(N) / 40), np.zeros(N)
    for k in range(2, N):
        y[k] = 0.5 * p[k - 2] * y[k - 1] + p[k - 1] * u[k - 1] + 0.3 * u[k - 2]
    y += 0.3 * random.normal(size=N)
    return Experiment.from_arrays(f"r{seed}", 0.1, inputs={"u": u}, outputs={"y": y}, schedule={"p": p})


def test_the_choice_never_looks_at_held_out_records():
    """Held-out records are shown in a sweep; noise in their place must not change what is chosen."""
    ssm, data, e = SSM(orders=(1, 2, 3), basis=Powers((0.0, 1.0))), Dataset((records(1),)), records(2)
    noise = np.random.default_rng(9).normal(size=e.values.shape)
    garbage = dataclasses.replace(e, values=np.column_stack([noise[:, :2], e["p"]]))
    alone = ssm.sweep(data).best
    for held_out in (Dataset((e,)), Dataset((garbage,))):
        best = ssm.sweep(data, held_out).best
        assert (best.order, best.support, best.mu[0]) == (alone.order, alone.support, alone.mu[0])


def bump(centres, **options):
    """x+ = (0.5 + 0.7 exp(..)) x: unstable only inside the span, stable at both ends."""
    A = np.array([[[0.7]], [[0.0]], [[0.5]]])
    zero = np.zeros((3, 1, 1))
    return LPVModel(
        "bump", 0.1, (Channel("u"),), (Channel("y"),), (Channel("p"),), [[centres[0] - 1, centres[0] + 1]],
        Gaussian(centres, np.full(2, 20.0), with_constant=True), (Term(0), Term(1), Term(2)), A, zero, zero + 1.0, zero,
        OperatingPoint(CONSTANT, np.zeros((1, 1)), np.zeros((1, 1))), **options,
    )  # fmt: skip


def test_instability_in_the_middle_of_the_span_is_found():
    found = bump([0.0, 5.0]).stability()
    assert not found.stable
    assert found.at == pytest.approx(0.0, abs=0.02)


def test_functions_that_differ_in_the_fifth_digit_keep_their_places_in_a_file(tmp_path):
    """A schedule around 300 K: the file must not tell functions apart by a rounded name."""
    model = dataclasses.replace(bump([300.01, 300.02]))
    model.save(tmp_path / "m.json")
    again = load_model(tmp_path / "m.json")
    assert again.terms[1].function == model.terms[1].function
    for rho in (299.9, 300.01, 300.4):
        np.testing.assert_array_equal(again.freeze(rho)[0], model.freeze(rho)[0])


class Clock(Port):
    """A port that offers the time of the integrator's stage."""

    family = "clock"

    def verbs(self, effects, context):
        return {"now": lambda: context.t}


@pytest.mark.slow
def test_effects_see_the_time_of_every_stage():
    plant = Plant(
        "clock", (Channel("x", "m"),), (Channel("u", "V"),), (Channel("y", "m"),), (),
        lambda x, u, p, at: {"x": 3 * at.clock.now() ** 2}, lambda x, p: {"y": x.x}, dt=0.1, ports=(Clock("clock"),), substeps=2,
    )  # fmt: skip
    run = simulate(plant, Playback(("u",), 0.1), Scenario("s", {"u": np.zeros(30)}))
    np.testing.assert_allclose(run.states["x"], (0.1 * np.arange(30)) ** 3, rtol=1e-12, atol=1e-14)
