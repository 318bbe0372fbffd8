"""The unlogged disturbance, seen through integrators: x' = u + d, so diff(x)/dt - u is d."""

from dataclasses import replace

import numpy as np
import pytest

from plants import WEB_WINDING
from studies.experiments import web_winding_loops
from workbench.data import Channel
from workbench.errors import InputError
from workbench.physics.controller import Playback
from workbench.physics.plant import Plant
from workbench.simulation import Scenario, simulate

PLANT = Plant(
    "two-integrators",
    (Channel("a", "m"), Channel("b", "m")), (Channel("u", "V"), Channel("v", "V")), (Channel("ya", "m"), Channel("yb", "m")),
    (), lambda x, u, p, at: {"a": u.u, "b": u.v}, lambda x, p: {"ya": x.a, "yb": x.b}, dt=0.1, disturbance={"u": 0.5, "v": 0.2},
)  # fmt: skip


def disturbances(seed=None, given=None, delay=0.0):
    u = {"u": np.ones(4000), "v": np.zeros(4000)}
    effects = {"input-delay@v": {"time": delay}} if delay else {}
    run = simulate(PLANT, Playback(("u", "v"), 0.1), Scenario("s", u, seed=seed, disturbance=given or {}), effects=effects)
    np.testing.assert_array_equal(run.experiment[["u", "v"]], np.column_stack([u["u"], u["v"]]))  # the log keeps commands
    return np.diff(run.states.values, axis=0) / 0.1 - [1.0, 0.0]


@pytest.mark.slow
def test_disturbance_has_the_stated_deviation_and_its_inputs_are_independent():
    d = disturbances(seed=3)
    np.testing.assert_allclose(d.std(axis=0), [0.5, 0.2], rtol=0.06)
    assert abs(np.corrcoef(d.T)[0, 1]) < 0.06
    assert abs(np.corrcoef(d[1:, 0], d[:-1, 0])[0, 1]) < 0.06


@pytest.mark.parametrize("seed", [None, 3])
def test_a_given_disturbance_adds_to_the_drawn_one(seed):
    given = np.where(np.arange(4000) > 2000, 2.0, 0.0)
    added = disturbances(seed, {"v": given}) - disturbances(seed)
    np.testing.assert_allclose(added[:, 1], given[:-1], atol=1e-9)
    np.testing.assert_allclose(added[:, 0], 0.0, atol=1e-9)


def test_a_dead_time_belongs_to_its_own_input():
    run = simulate(
        PLANT, Playback(("u", "v"), 0.1), Scenario("s", {"u": np.ones(20), "v": np.ones(20)}),
        effects={"input-delay@v": {"time": 0.5}},
    )  # fmt: skip
    np.testing.assert_allclose(run.states["a"], 0.1 * np.arange(20), atol=1e-12)
    np.testing.assert_allclose(run.states["b"], 0.1 * np.maximum(np.arange(20) - 5, 0), atol=1e-12)


def test_a_law_that_measures_an_input_is_told_what_a_loop_needs():
    law = Playback(("u",), 0.1, schedule="v")
    with pytest.raises(InputError, match="the law measures 'v', which is an input of two-integrators") as caught:
        simulate(PLANT, law, Scenario("s", {"u": np.ones(20)}))
    assert "a state and an output" in caught.value.mend
    with pytest.raises(InputError, match="unknown measured channel"):
        simulate(PLANT, replace(law, schedule="w"), Scenario("s", {"u": np.ones(20)}))


class Asked:
    """The loops of the identification experiments, asked step by step in Python."""

    def __init__(self, law):
        self.own = law
        for name in ("name", "dt", "references", "measured", "schedule", "actuated", "init", "step"):
            setattr(self, name, getattr(law, name))


@pytest.mark.slow
@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("effects", [{}, {"input-delay@V1": {"time": 0.05}, "sensor-lag@theta": {"time": 0.1}}])
def test_a_controller_asked_step_by_step_gives_the_run_of_the_compiled_one(every, effects):
    law = replace(web_winding_loops(), dt=every * WEB_WINDING.dt)
    n = 120
    scenario = Scenario("steps", {"w3_set": 100.0 + 5.0 * (np.arange(n) > 40), "theta_set": np.zeros(n)}, seed=2)
    compiled = simulate(WEB_WINDING, law, scenario, effects=effects, bumpless=True)
    asked = simulate(WEB_WINDING, Asked(law), scenario, effects=effects, bumpless=True)
    np.testing.assert_allclose(asked.experiment.values, compiled.experiment.values, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(asked.states.values, compiled.states.values, rtol=1e-12)
    assert len(asked.memories) == len(range(0, n, every))
    assert compiled.memories == ()
