"""A model with one more effect, fitted from the estimate of one step: it never ends worse than the model without."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from studies.real_plants import SILVERBOX
from workbench.data import Dataset, Experiment
from workbench.diagnosis import search
from workbench.diagnosis.policy import WORTH
from workbench.diagnosis.predictor import predictor
from workbench.diagnosis.recalibrate import recalibrated
from workbench.diagnosis.refit import Model, refit
from workbench.diagnosis.search import screen_effects, small_sizes


def oscillator(seed, samples=3000):
    """m q'' = F - d q' - k q - k3 q^3, by scipy; F moves between its samples, and is taken for held.

    Nothing of the catalogue is the spring, and a model that is half a sample late has estimates that lead far off.
    """
    random, dt = np.random.default_rng(seed), SILVERBOX.dt
    t = dt * np.arange(samples)
    waves = zip(random.uniform(1.0, 200.0, 40), random.uniform(0.0, 6.3, 40), strict=True)
    u = np.sum([0.017 * np.sin(2.0 * np.pi * f * t + turn) for f, turn in waves], axis=0)
    force, k3 = CubicSpline(t, u), random.uniform(2.0, 6.0)

    def rates(t, x):
        return [x[1], (force(t) - 2e-4 * x[1] - x[0] - k3 * x[0] ** 3) / 5e-6]

    way = solve_ivp(rates, (0.0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-8, atol=1e-10).y[0]
    y = way + 3e-4 * random.standard_normal(samples)
    units = {"V1": "V", "V2": "V"}
    return Experiment.from_arrays(f"run {seed}", dt, inputs={"V1": u}, outputs={"V2": y}, units=units)


@pytest.fixture(scope="module", params=[0, 2, 4])
def model(request):
    done = recalibrated(predictor(SILVERBOX, Dataset((oscillator(request.param),))))
    return Model(done.predictor, done.fit)


def test_an_effect_never_makes_a_fit_worse(model):
    sizes = small_sizes(model.predictor, model.fit)
    keys = list(dict.fromkeys(slot.key for slot in SILVERBOX.slots))
    found = screen_effects(model, keys, sizes)
    assert len(found) > 10
    for score in found:
        assert refit(model, score, sizes).deviance < model.deviance + 0.2 * WORTH, score.key


def test_models_that_are_lost_are_compared_like_others(model):
    """An added BIC of a few vanishes beside the one of a model that ran away."""
    sizes = small_sizes(model.predictor, model.fit)
    for size in (1e16, np.inf):
        lost = replace(model, fit=replace(model.fit, errors=[np.full_like(e, np.sqrt(size)) for e in model.fit.errors]))
        assert not lost.bic < lost.bic + search.SWAP
        (kept,) = search._alike_stepped([(lost, screen_effects(model, ["offset@V1"], sizes)[0])], sizes)
        assert kept[0].bic == lost.bic
