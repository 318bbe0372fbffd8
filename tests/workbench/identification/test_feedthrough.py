"""Feed-through is found where there is one, and not where a controller answers noise within the sample."""

import numpy as np
import pytest

import workbench as wb
from workbench.advice import in_a_loop
from workbench.basis import Powers
from workbench.data import Dataset, Experiment
from workbench.identification.feedthrough import acts_at_once
from workbench.identification.lti import LTI, held_by_a_loop
from workbench.identification.ssm import SSM


def experiment(seed, D, *, feedback=0.0, logged=False, noise=0.1, N=1500, schedule=False):
    """x+ = 0.8 x + u, y = p x + D u + noise, u = r - feedback y (the measured one, within the sample)."""
    random = np.random.default_rng(seed)
    r = np.repeat(random.normal(size=N // 3), 3) + 0.3 * random.normal(size=N)
    x, u, y = 0.0, np.zeros(N), np.zeros(N)
    p = 1 + 0.3 * np.sin(np.arange(N) / 200) if schedule else np.ones(N)
    for k in range(N):
        e = noise * random.normal()
        # y = p x + D u + e and u = r - feedback y, solved for u
        u[k] = (r[k] - feedback * (p[k] * x + e)) / (1 + feedback * D)
        y[k] = p[k] * x + D * u[k] + e
        x = 0.8 * x + u[k]
    return Experiment.from_arrays(
        f"seed{seed}", 0.1, inputs={"u": u}, outputs={"y": y}, references={"y_set": r} if logged else {},
        schedule={"p": p} if schedule else {},
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_open_loop_with_and_without_feedthrough(seed):
    assert acts_at_once(Dataset((experiment(seed, 2.0),)))
    assert not acts_at_once(Dataset((experiment(seed, 0.0),)))


@pytest.mark.parametrize("seed", range(4))
def test_a_controller_that_answers_noise_is_no_feedthrough(seed):
    assert not acts_at_once(Dataset((experiment(seed, 0.0, feedback=0.3, noise=0.5),)))
    assert not acts_at_once(Dataset((experiment(seed, 0.0, feedback=0.5, noise=1.5, logged=True),)))


def test_lti_and_ssm_find_the_direct_gain():
    data = Dataset((experiment(1, 2.0, noise=0.01),))
    for method in (LTI(), SSM(orders=(1, 2, 3))):
        model = method.fit(data)
        assert model.freeze(0.0)[3] == pytest.approx(2.0, abs=0.02)
        # DC gain 1/(1 - 0.8) + 2 and the pole
        G = model.to_control()
        assert G.dcgain() == pytest.approx(7.0, rel=0.01)
        assert np.abs(G.poles()).max() == pytest.approx(0.8, abs=0.01)


def test_scheduled_ssm_with_feedthrough_realises_its_recursion():
    """Noise-free: the model's free run is the record, so that the products a_i D in B stand where they belong."""
    data = Dataset((experiment(2, 1.5, noise=0.0, schedule=True),))
    model = SSM(order=2, basis=Powers((0.0, 1.0, 2.0, -1.0)), mu_factor=1.0001, feedthrough=True).fit(data)
    e = data.experiments[0]
    assert model.freeze(1.0)[3] == pytest.approx(1.5, abs=0.05)
    error = model.simulate(e)[5:, 0] - e["y"][5:]
    assert np.std(error) < 0.05 * np.std(e["y"])
    one_step = model.predict(e)[5:, 0] - e["y"][5:]
    assert np.std(one_step) < 0.03 * np.std(e["y"])


def test_a_record_too_short_to_tell_has_none():
    assert not acts_at_once(Dataset((experiment(1, 2.0, N=12),)))


def test_in_closed_loop_without_set_points_a_small_gain_is_not_enough(monkeypatch):
    """Between 2 and 10 points of FIT: open loop says feed-through, feedback says noise in the inputs."""
    from workbench.identification import feedthrough

    data = Dataset((experiment(3, 2.0),))
    monkeypatch.setattr(feedthrough.Arx, "free_fit", lambda self, _: 60.0 if self.first else 65.0)
    for closed, expected in ((False, True), (True, False)):
        found = type("Found", (), {"detected": closed})()
        monkeypatch.setattr(feedthrough, "feedback", lambda _, found=found: found)
        assert acts_at_once(data) is expected


def held(seed: int, pole: float, N=2000, dt=0.01) -> Experiment:
    """x'' = pole^2 x + u read with noise, held by a PD law about a set-point that is not logged; an oscillator for pole < 0."""
    random = np.random.default_rng(seed)
    x, v, last = 0.0, 0.0, 0.0
    u, y = np.empty(N), np.empty(N)
    r = np.repeat(0.5 * random.normal(size=N // 50), 50)
    stiff = np.sign(pole) * pole**2
    for k in range(N):
        y[k] = x + 0.002 * random.normal()
        u[k] = -60.0 * (y[k] - r[k]) - 8.0 * (y[k] - last) / dt
        last = y[k]
        for _ in range(4):
            x, v = x + 0.25 * dt * v, v + 0.25 * dt * (stiff * x - 0.5 * v + u[k])
    return Experiment.from_arrays(f"loop{seed}", dt, inputs={"u": u}, outputs={"y": y})


@pytest.mark.parametrize("seed", range(3))
def test_a_machine_that_only_its_loop_holds_is_not_taken_for_the_inverse_of_its_controller(seed):
    """Neither by a feed-through, nor by a stable model: none is handed out, and the sentence says why."""
    data, fresh = Dataset((held(seed, 5.0),)), Dataset((held(10 + seed, 5.0),))
    assert not acts_at_once(data)
    loop = held_by_a_loop(data)
    assert loop is not None
    assert not loop.stability().stable
    found = wb.identify(data, fresh, methods={"lti": LTI(order=1), "oe": wb.OutputError(order=1)})
    assert all(result.against for result in found.results)
    said = " ".join(sentence for result in found.results for sentence in result.against)
    assert "a loop around a machine that is unstable by itself" in said


@pytest.mark.parametrize("seed", range(3))
def test_a_stable_machine_in_a_loop_is_no_such_machine(seed):
    """An oscillator under the same law, and one whose noise is large."""
    data, fresh = Dataset((held(seed, -5.0),)), Dataset((held(10 + seed, -5.0),))
    found = wb.identify(data, fresh, methods={"lti": LTI(order=2)}, accept=True)
    assert not any("unstable by itself" in sentence for result in found.results for sentence in result.against)
    noisy = Dataset((experiment(seed, 0.0, feedback=0.3, noise=0.5),))
    assert held_by_a_loop(noisy) is None


@pytest.mark.parametrize("kind", ["servo", "tank", "two integrators"])
@pytest.mark.parametrize("seed", range(6))
def test_a_machine_that_integrates_is_not_unstable(kind, seed):
    """In loops of drawn gains, noise and unlogged pushes, where half of the estimated poles are beyond 1 by a little."""
    random = np.random.default_rng([seed, 9])
    N, dt, x, v, last, push = 3000, 0.01, 0.0, 0.0, 0.0, 0.0
    kp, kd, noise = random.uniform(2.0, 20.0), random.uniform(0.015, 0.3), 10.0 ** random.uniform(-4.0, -1.5)
    r, u, y = np.repeat(0.5 * random.normal(size=N // 50), 50), np.empty(N), np.empty(N)
    for k in range(N):
        y[k] = x + noise * random.normal()
        u[k] = kp * (r[k] - y[k]) - kd * (y[k] - last) / dt
        last, push = y[k], 0.95 * push + 0.1 * random.normal()
        for _ in range(4):
            rate = {"servo": -2.0 * v + 5.0 * u[k] + push, "tank": 0.0, "two integrators": 2.0 * u[k] + push}[kind]
            x, v = x + 0.25 * dt * (u[k] + push if kind == "tank" else v), v + 0.25 * dt * rate
    assert np.abs(y).max() < 100.0
    e = Experiment.from_arrays("loop", dt, inputs={"u": u}, outputs={"y": y}, references={"y_set": r})
    assert in_a_loop(e)
    assert held_by_a_loop(Dataset((e,))) is None
