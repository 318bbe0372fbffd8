"""The control moment gyroscope, a published LPV benchmark with three schedules: free runs on a record that no choice has seen."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.signal import welch

import workbench as wb
from workbench.data import Dataset, Experiment

FOLDER = Path(__file__).parents[2].parent / "shared" / "data" / "real" / "gyroscope"


def record(name: str) -> Experiment:
    content = loadmat(FOLDER / f"{name}.mat")
    p = content["exp_p"].astype(float)
    return Experiment.from_arrays(
        name, 0.01, inputs={"i": content["exp_u"][:, 0].astype(float)}, outputs={"w4": content["exp_y"][:, 0].astype(float)},
        schedule={f"p{j + 1}": p[:, j] for j in range(p.shape[1])},
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.skipif(not FOLDER.is_dir(), reason="the shared records are not here")
def test_a_free_run_reaches_what_neural_models_do():
    """At least 98 % of the noise-free output; the noise is that of the measured one above 35 Hz, where nothing else is."""
    model = wb.LPVOutputError(order=4, degree=1).fit(Dataset((record("ML_estim"),)))
    assert model.stability(41).stable
    e = record("ML_valid")
    y, run = e["w4"][50:], model.simulate(e, warmup=50)[50:, 0]
    frequency, power = welch(e["w4"], 100.0, nperseg=1024)
    noise = 50.0 * power[(frequency > 35.0) & (frequency < 50.0)].mean()
    missed = max(np.mean((y - run) ** 2) - noise, 0.0) / (np.var(y) - noise)
    assert 100.0 * (1.0 - np.sqrt(missed)) > 98.0
