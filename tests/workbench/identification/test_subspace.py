"""PBSID and N4SID against known systems: exact recovery, open and closed loop, orders, records that must not be joined."""

import dataclasses

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workbench.data import Dataset, Experiment
from workbench.errors import InputError
from workbench.identification.subspace import N4SID, PBSID

METHODS = pytest.mark.parametrize("method", [PBSID(), N4SID()], ids=["pbsid", "n4sid"])


def rotation(radius, angle):
    return radius * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


#: A known 2x2 system of order 4 with its innovation gain; poles 0.9 exp(+-0.5 i), 0.8 exp(+-1.2 i).
A = np.block([[rotation(0.9, 0.5), np.full((2, 2), 0.1)], [np.zeros((2, 2)), rotation(0.8, 1.2)]])
B = np.array([[1.0, 0.0], [0.5, 1.0], [0.0, 0.7], [-0.6, 0.3]])
C = np.array([[1.0, 0.0, 0.5, 0.0], [0.0, 0.6, 0.0, 1.0]])
K = np.array([[0.4, 0.1], [0.1, 0.3], [0.2, 0.0], [0.0, 0.3]])
LOOP = np.array([[-0.2, 0.0], [0.4, 0.2]])  # u = r - LOOP y, closed-loop poles within 0.85
OPEN = np.zeros((2, 2))


def run(N, seed, noise=0.0, loop=OPEN, hold=1, offset=(0.0, 0.0, 0.0, 0.0), D=OPEN, start=0.0):
    """x+ = A x + B u + K e, y = C x + D u + e under u = r - loop y, r binary and held; e of standard deviation `noise`."""
    random = np.random.default_rng(seed)
    r = np.repeat(random.choice([-1.0, 1.0], (N // hold + 1, 2)), hold, axis=0)[:N]
    e = noise * random.standard_normal((N, 2))
    x, u, y = np.full(4, start), np.zeros((N, 2)), np.zeros((N, 2))
    for k in range(N):
        u[k] = r[k] - loop @ (C @ x + e[k])
        y[k] = C @ x + D @ u[k] + e[k]
        x = A @ x + B @ u[k] + K @ e[k]
    u, y = u + np.array(offset[:2]), y + np.array(offset[2:])
    names = {"u1": u[:, 0], "u2": u[:, 1]}, {"y1": y[:, 0], "y2": y[:, 1]}
    return Experiment.from_arrays(f"run {seed}", 0.04, inputs=names[0], outputs=names[1])


def truth(steps=60, D=OPEN):
    """Impulse response by python-control, not by the code under test; (steps, ny, nu)."""
    response = control.impulse_response(control.ss(A, B, C, D, 1.0), T=np.arange(steps))
    return np.moveaxis(response.outputs, -1, 0)


def agreement(model, steps=60):
    """Impulse-response fit in percent."""
    H = truth(steps)
    return 100 * (1 - np.linalg.norm(model.markov(steps) - H) / np.linalg.norm(H))


@METHODS
def test_noise_free_records_return_the_system(method):
    model = method.fit(Dataset((run(500, 0, start=1.0), run(400, 1, start=-2.0))))
    assert model.order == 4
    np.testing.assert_allclose(model.markov(60), truth(), atol=1e-6)
    np.testing.assert_allclose(np.sort_complex(model.poles), np.sort_complex(np.linalg.eigvals(A)), atol=1e-6)


@METHODS
def test_the_feed_through_is_found_when_asked_for(method):
    D = np.array([[0.5, 0.0], [0.2, -1.0]])
    model = dataclasses.replace(method, feedthrough=True).fit(Dataset((run(600, 0, D=D),)))
    np.testing.assert_allclose(model.markov(30), truth(30, D), atol=1e-6)


@METHODS
def test_offsets_end_up_in_the_operating_point_and_nowhere_else(method):
    # y - y0 = G(1) (u - u0) must hold for the offsets that were added: u = 3, 0 belongs to y = 100, -7 here
    offset = (3.0, 0.0, 100.0, -7.0)
    model = method.fit(Dataset((run(500, 0, offset=offset), run(400, 1, offset=offset, start=2.0))))
    np.testing.assert_allclose(model.markov(60), truth(), atol=1e-6)
    gain = C @ np.linalg.solve(np.eye(4) - A, B)
    np.testing.assert_allclose(
        model.y0 - np.array(offset[2:]), gain @ (model.u0 - np.array(offset[:2])), atol=1e-6 * np.linalg.norm(gain)
    )


@pytest.mark.slow
@METHODS
def test_open_loop_records_with_noise_half_the_signal(method):
    fits = [agreement(dataclasses.replace(method, order=4).fit(Dataset((run(2250, s, noise(OPEN)),)))) for s in range(5)]
    assert np.median(fits) > 90


def noise(loop, hold=1, level=0.5):
    """Standard deviation of e that is `level` of the outputs' own."""
    return level * float(np.std(run(4000, 99, loop=loop, hold=hold)[["y1", "y2"]]))


def test_pbsid_stands_in_closed_loop_where_n4sid_falls():
    e = noise(LOOP, hold=6)
    records = [Dataset((run(2250, seed, e, LOOP, hold=6),)) for seed in range(5)]
    assert np.median([agreement(PBSID(order=4).fit(d)) for d in records]) >= 80
    assert np.median([agreement(N4SID(order=4).fit(d)) for d in records]) < 50


@pytest.mark.slow
def test_more_data_removes_pbsids_error_and_not_n4sids():
    """Consistency: with 16 times the samples PBSID's error falls by about 4; N4SID's bias stays."""
    e = noise(LOOP, hold=6)

    def errors(method):
        return [
            np.mean([100 - agreement(method.fit(Dataset((run(N, s, e, LOOP, hold=6),)))) for s in range(3)])
            for N in (1500, 24000)
        ]

    few, many = errors(PBSID(order=4))
    assert many < 0.45 * few
    few, many = errors(N4SID(order=4))
    assert many > 0.6 * few


@pytest.mark.slow
@METHODS
@pytest.mark.parametrize("level", [0.1, 0.5])
def test_the_singular_values_show_the_order(method, level):
    orders = [method.fit(Dataset((run(2250, seed, noise(OPEN, level=level)),))).order for seed in range(5)]
    assert np.median(orders) == 4


def test_pure_noise_shows_no_order():
    random = np.random.default_rng(5)
    found = []
    for _ in range(10):
        u, y = random.standard_normal((2, 1000))
        estimate = PBSID().estimate(Dataset((Experiment.from_arrays("n", 1.0, inputs={"u": u}, outputs={"y": y}),)))
        found.append(int(np.sum(estimate.singular_values > estimate.noise_level)))
    # the level is the median of the largest: half of the draws may show one, hardly any more
    assert np.mean(found) < 2


@METHODS
def test_records_are_not_joined(method):
    """Two records whose joint would be a jump that no model explains: exact recovery shows that no window crosses it."""
    pieces = [run(150, seed, start=10.0 * (-1) ** seed) for seed in range(4)]
    np.testing.assert_allclose(method.fit(Dataset(tuple(pieces))).markov(40), truth(40), atol=1e-6)
    values = np.concatenate([p.values for p in pieces])
    joined = Experiment("joined", 0.04 * np.arange(len(values)), pieces[0].channels, values, 0.04)
    assert np.abs(dataclasses.replace(method, order=4).fit(Dataset((joined,))).markov(40) - truth(40)).max() > 1e-3


@METHODS
def test_the_innovation_model_is_a_stable_predictor_with_the_right_noise(method):
    e = noise(OPEN)
    model = dataclasses.replace(method, order=4).fit(Dataset((run(8000, 3, e),)))
    assert np.abs(np.linalg.eigvals(model.A - model.K @ model.C)).max() < 1
    np.testing.assert_allclose(model.covariance, e**2 * np.eye(2), atol=0.06 * e**2)
    # noise transfer C A^(i-1) K does not depend on the state's basis
    np.testing.assert_allclose(model.C @ model.K, C @ K, atol=0.12)
    np.testing.assert_allclose(model.C @ model.A @ model.K, C @ A @ K, atol=0.12)


@pytest.mark.slow
@METHODS
@settings(max_examples=10)
@given(scale=st.tuples(*[st.floats(-6, 6)] * 4))
def test_units_do_not_matter(method, scale):
    record = run(300, 0, 0.2)
    factor = 10.0 ** np.array(scale)
    other = dataclasses.replace(record, values=record.values * factor)
    a, b = (dataclasses.replace(method, order=4).fit(Dataset((r,))) for r in (record, other))
    np.testing.assert_allclose(
        b.markov(20),
        a.markov(20) * factor[2:, None] / factor[:2],
        rtol=1e-5,
        atol=1e-7 * np.min(factor[2:]) / np.max(factor[:2]),
    )


def test_an_integrator_is_found_and_its_operating_point_makes_sense():
    """y+ = y + 0.1 (u - 2): no y0 is an equilibrium unless u0 = 2, whatever the mean of u."""
    random = np.random.default_rng(0)
    u = 2.2 + random.standard_normal(800)
    y = np.concatenate([[0.0], np.cumsum(0.1 * (u - 2.0))[:-1]])
    model = PBSID(past=8, future=4).fit(Dataset((Experiment.from_arrays("i", 1.0, inputs={"u": u}, outputs={"y": y}),)))
    assert model.order == 1
    np.testing.assert_allclose(model.poles, 1.0, atol=1e-9)
    np.testing.assert_allclose(model.u0, 2.0, atol=1e-6)


@METHODS
def test_bad_input_names_the_mend(method):
    with pytest.raises(InputError, match="smaller windows"):
        method.fit(Dataset((run(80, 0),)))
    record = run(500, 0)
    still = dataclasses.replace(record, values=record.values * np.array([1.0, 0.0, 1.0, 1.0]))
    with pytest.raises(InputError, match=r"u2.*constant"):
        method.fit(Dataset((still,)))
    with pytest.raises(InputError, match="no inputs"):
        method.fit(Dataset((record.select(["y1", "y2"]),)))
    with pytest.raises(InputError, match="at most"):
        dataclasses.replace(method, order=30).fit(Dataset((record,)))
    with pytest.raises(InputError, match="past"):
        dataclasses.replace(method, past=5, future=10)
