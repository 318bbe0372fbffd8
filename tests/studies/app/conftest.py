import numpy as np
import pytest

from studies.app.server import App
from studies.app.session import Session
from workbench.data import Channel, Experiment
from workbench.readers import write_csv

ORIGIN = "http://127.0.0.1:8123"


def record(path, seed, samples=600):
    """A first-order lag T = 0.5 s from U to n, driven by steps."""
    random = np.random.default_rng(seed)
    U = np.repeat(random.uniform(-5.0, 5.0, samples // 40 + 1), 40)[:samples]
    n = np.zeros(samples)
    for k in range(1, samples):
        n[k] = 0.96 * n[k - 1] + 0.04 * 3.0 * U[k - 1]
    channels = (Channel("U", "V", "input"), Channel("n", "1/min", "output"))
    values = np.column_stack([U, n + 0.02 * random.standard_normal(samples)])
    write_csv(Experiment(path.stem, 0.02 * np.arange(samples), channels, values), path)
    return path


@pytest.fixture
def session(tmp_path):
    return Session(tmp_path / "Sitzung für Müller")


@pytest.fixture
def app(session):
    return App(session, ORIGIN)


@pytest.fixture
def asked(app):
    """A browser that has opened the printed address."""
    from starlette.testclient import TestClient

    with TestClient(app.asgi, base_url=ORIGIN, headers={"X-Workbench": "1", "Origin": ORIGIN}) as client:
        client.get(f"/?token={app.token}")
        yield client
