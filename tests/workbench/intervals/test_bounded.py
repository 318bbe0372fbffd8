"""An LPV model plus a bound on its error: the largest error of the estimation records, at each horizon its own."""

import numpy as np
import pytest

from workbench.data import Dataset, Experiment
from workbench.identification.lti import LTI
from workbench.intervals.bounded import bounded, cover_bounded


def machine(name, seed, size=1.0, N=300):
    random = np.random.default_rng(seed)
    u = np.repeat(random.choice([-1.0, 1.0], N // 5), 5)
    y = np.zeros(N)
    for k in range(1, N):
        y[k] = 0.95 * y[k - 1] + 0.1 * u[k - 1] + 0.02 * size * random.standard_normal()
    return Experiment.from_arrays(name, 0.1, inputs={"u": u}, outputs={"y": y}, units={"y": "m"})


@pytest.fixture(scope="module")
def known():
    records = Dataset((machine("quiet", 1, 0.3), machine("loud", 2, 2.0)))
    model = LTI(order=1).fit(records)
    return model, records, bounded(model, records, "y")


def test_the_bounds_are_the_largest_errors_of_all_estimation_records(known):
    model, records, bound = known
    n = model.warmup
    steps = [np.abs(e["y"] - model.predict(e)[:, 0])[n:].max() for e in records]
    runs = [np.abs(e["y"] - model.simulate(e)[:, 0])[n:].max() for e in records]
    assert (bound.one_step, bound.free_run) == (max(steps), max(runs))
    assert bound.free_run > 1.5 * bound.one_step  # noise adds up in a free run: the two cannot be mixed up
    assert bound.unit_range == np.ptp(np.concatenate([e["y"] for e in records]))


def test_the_lines_count_what_the_band_holds(known):
    model, records, bound = known
    assert all(line.coverage == 1.0 for line in cover_bounded(bound, records, "estimation"))
    fresh = machine("fresh", 3, 4.0)
    step, run = cover_bounded(bound, (fresh,), "held-out")
    error = np.abs(fresh["y"] - model.predict(fresh)[:, 0])[model.warmup :]
    assert step.coverage == np.mean(error <= bound.one_step) < 1.0
    assert (step.horizon, step.mean_radius, run.horizon, run.mean_radius) == (
        "one-step",
        bound.one_step,
        "free-run",
        bound.free_run,
    )
    assert (step.unit, step.relative) == ("m", bound.one_step / bound.unit_range)
