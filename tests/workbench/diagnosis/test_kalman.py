"""The filter against its textbook, python-control and the likelihood of a Gaussian vector written out."""

from dataclasses import replace

import control
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from workbench.diagnosis.kalman import Linearization, gains, likelihood, response

N, n, ny, nw = 30, 3, 2, 2
Q, R = np.array([0.3, 0.05]), np.array([0.2, 0.7])


def varying(seed=0, missing=True, added=False) -> Linearization:
    """A system that differs from sample to sample; some outputs, and once all of them, are not measured."""
    random = np.random.default_rng(seed)
    present = np.ones((N, ny), dtype=bool)
    if missing:
        present[random.random((N, ny)) < 0.2] = False
        present[11] = False
    F, G, H = (random.standard_normal(shape) for shape in ((N, n, n), (N, n, nw), (N, ny, n)))
    return Linearization(0.6 * F, G, H, present, random.exponential(0.1, (N, n)) if added else np.empty((0, 0)))


def textbook(line: Linearization, q, r):
    """Gains, innovation covariances of what was measured, and sum of log det, by matrices of the measured rows only."""
    P, K, S, log_det = np.zeros((n, n)), [], [], 0.0
    for k in range(N):
        seen = line.present[k]
        H = line.H[k][seen]
        cov = H @ P @ H.T + np.diag(r[seen] ** 2)
        gain = np.zeros((n, ny))
        gain[:, seen] = P @ H.T @ np.linalg.inv(cov)
        K.append(gain)
        S.append(cov)
        log_det += np.log(np.linalg.det(cov)) if seen.any() else 0.0
        P = line.F[k] @ (P - gain[:, seen] @ cov @ gain[:, seen].T) @ line.F[k].T + line.G[k] @ np.diag(q**2) @ line.G[k].T
        P += np.diag(line.added[k]) if line.added.size else 0.0
    return np.array(K), S, log_det


def innovations(line: Linearization, gain, y):
    """e = y - H x, x+ = F (x + gain e), from x = 0."""
    x, e = np.zeros(n), np.zeros((N, ny))
    for k in range(N):
        e[k] = np.where(line.present[k], y[k] - line.H[k] @ x, 0.0)
        x = line.F[k] @ (x + gain[k] @ e[k])
    return e


def covariance_of_outputs(line: Linearization, q, r):
    """(N ny, N ny): y = sum over the past of H Phi G w, and v."""
    wide = np.zeros((N * ny, N * nw))
    for j in range(N):
        x = line.G[j]  # what w_j has done by sample j + 1
        for k in range(j + 1, N):
            wide[k * ny : (k + 1) * ny, j * nw : (j + 1) * nw] = line.H[k] @ x
            x = line.F[k] @ x
    return wide @ np.diag(np.tile(q**2, N)) @ wide.T + np.diag(np.tile(r**2, N))


@pytest.mark.parametrize("added", [False, True])
def test_gains_and_log_determinant_are_those_of_the_textbook_where_outputs_are_missing(added):
    line = varying(added=added)
    K, _, log_det = textbook(line, Q, R)
    done = gains(line, Q, R)
    np.testing.assert_allclose(done.gain, K, rtol=1e-9, atol=1e-12)
    assert done.log_det == pytest.approx(log_det, rel=1e-10)


def test_whitening_makes_the_innovations_of_what_was_measured_unit_and_uncorrelated():
    line = varying()
    W = gains(line, Q, R).whitening
    for k, S in enumerate(textbook(line, Q, R)[1]):
        seen = line.present[k]
        own = W[k][np.ix_(seen, seen)]
        np.testing.assert_allclose(own @ S @ own.T, np.eye(seen.sum()), atol=1e-10)
        np.testing.assert_allclose(W[k][np.ix_(~seen, seen)], 0.0)  # nothing leaks into a value that is not there


def test_the_gain_of_a_constant_system_settles_at_that_of_the_riccati_equation():
    random = np.random.default_rng(3)
    F, G, H = 0.5 * random.standard_normal((n, n)), random.standard_normal((n, nw)), random.standard_normal((ny, n))
    long = 200
    line = Linearization(*(np.repeat(M[None], long, axis=0) for M in (F, G, H)), np.ones((long, ny), dtype=bool))
    L, _, _ = control.dlqe(F, G, H, np.diag(Q**2), np.diag(R**2))  # of x+ = F x + L (y - H x)
    np.testing.assert_allclose(F @ gains(line, Q, R).gain[-1], L, rtol=1e-8, atol=1e-10)


def test_variances_that_are_added_are_those_of_pushes_of_their_own():
    """To slopes and deviance alike: they are constant, whatever the pushes are."""
    line, random = varying(7, added=True), np.random.default_rng(8)
    y = random.standard_normal((N, ny))
    pushes = np.concatenate([line.G, np.array([np.diag(np.sqrt(own)) for own in line.added])], axis=2)
    wide = Linearization(line.F, pushes, line.H, line.present)
    q, old = np.append(Q, np.ones(n)), gains(wide, np.append(2.0 * Q, np.ones(n)), R)
    e = innovations(line, old.gain, y)
    one, other = likelihood(line, Q, R, old.gain, e, fading=1), likelihood(wide, q, R, old.gain, e, fading=1)
    assert one.deviance == pytest.approx(other.deviance, rel=1e-12)
    for mine, theirs in ((one.process, other.process[:nw]), (one.measurement, other.measurement), (one.decay, other.decay)):
        np.testing.assert_allclose(mine, theirs, rtol=1e-9)


@pytest.mark.parametrize("missing", [False, True])
def test_deviance_is_the_gaussian_likelihood_of_the_record_at_noise_levels_that_are_not_those_of_the_gain(missing):
    line, random = varying(1, missing), np.random.default_rng(4)
    y = random.multivariate_normal(np.zeros(N * ny), covariance_of_outputs(line, Q, R)).reshape(N, ny)
    old = gains(line, 3.0 * Q, 0.4 * R)
    e = innovations(line, old.gain, y)
    seen = line.present.ravel()
    for q, r in ((Q, R), (0.2 * Q, 1.7 * R), (np.array([1.0, 0.01]), R)):
        cov = covariance_of_outputs(line, q, r)[np.ix_(seen, seen)]
        exact = -2.0 * multivariate_normal(np.zeros(len(cov)), cov).logpdf(y.ravel()[seen]) - len(cov) * np.log(2 * np.pi)
        assert likelihood(line, q, r, old.gain, e).deviance == pytest.approx(exact, rel=1e-9)


def test_deviance_at_the_noise_levels_of_the_gain_is_that_of_its_own_innovations():
    line = varying(2)
    done = gains(line, Q, R)
    e = innovations(line, done.gain, np.random.default_rng(5).standard_normal((N, ny)))
    white = np.einsum("kij,kj->ki", done.whitening, e)
    assert likelihood(line, Q, R, done.gain, e).deviance == pytest.approx(np.sum(white**2) + done.log_det, rel=1e-10)


def test_slopes_of_the_likelihood_are_those_of_differences():
    line = varying(3)
    old = gains(line, 3.0 * Q, 0.4 * R)
    e = innovations(line, old.gain, 2.0 * np.random.default_rng(6).standard_normal((N, ny)))
    found, h = likelihood(line, Q, R, old.gain, e, fading=2), 1e-5

    def slope(up, down):
        return (up.deviance - down.deviance) / (2 * h)

    for j in range(nw):
        up, down = (np.sqrt(Q**2 + sign * h * (np.arange(nw) == j)) for sign in (1, -1))
        assert found.process[j] == pytest.approx(slope(*(likelihood(line, q, R, old.gain, e) for q in (up, down))), rel=1e-5)
    for j in range(ny):
        up, down = (np.sqrt(R**2 + sign * h * (np.arange(ny) == j)) for sign in (1, -1))
        assert found.measurement[j] == pytest.approx(slope(*(likelihood(line, Q, r, old.gain, e) for r in (up, down))), rel=1e-5)
    for j in range(2):
        own = h * np.diag(np.arange(n) == j + 1)
        up, down = (replace(line, F=line.F + sign * own) for sign in (1, -1))
        assert found.decay[j] == pytest.approx(slope(*(likelihood(x, Q, R, old.gain, e) for x in (up, down))), rel=1e-5)


def test_slopes_do_not_blow_up_where_gains_are_large():
    """Pushes a million times the readings' noise over many samples: multiplied out, the backward pass would overflow."""
    F, G, H = np.array([[1.0, 0.02], [0.0, 0.98]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    line = Linearization(*(np.repeat(M[None], 2000, axis=0) for M in (F, G, H)), np.ones((2000, 1), dtype=bool))
    e = 1e-3 * np.random.default_rng(0).standard_normal((2000, 1))
    q, r = np.array([1.0]), np.array([1e-6])
    still = np.zeros((2000, 2, 1))
    found = likelihood(line, q, r, still, e)
    up, down = (likelihood(line, q * s, r, still, e).deviance for s in (1.0 + 1e-5, 1.0 - 1e-5))
    assert 2.0 * q[0] ** 2 * found.process[0] == pytest.approx((up - down) / 2e-5, rel=1e-3)


def test_response_is_the_difference_of_two_filters_of_which_one_is_pushed_and_misread():
    line, random = varying(6), np.random.default_rng(7)
    gain = gains(line, Q, R).gain
    y, push, shift = (random.standard_normal(s) for s in ((N, ny), (N, n, 2), (N, ny, 2)))
    shift[~line.present] = 0.0

    def errors(push, shift):  # a gain is 0 where nothing was measured, whatever H says
        x, e = np.zeros(n), np.zeros((N, ny))
        for k in range(N):
            e[k] = y[k] + shift[k] - line.H[k] @ x
            x = line.F[k] @ (x + gain[k] @ e[k]) + push[k]
        return np.where(line.present, e, 0.0)

    done, quiet = response(line, gain, push, shift), errors(np.zeros((N, n)), np.zeros((N, ny)))
    for c in range(2):
        np.testing.assert_allclose(done[:, :, c], errors(push[:, :, c], shift[:, :, c]) - quiet, atol=1e-9)


def test_response_to_a_push_is_silent_until_a_sample_later():
    line = varying(8, missing=False)
    gain = gains(line, Q, R).gain
    push = np.zeros((N, n, 1))
    push[10] = 1.0
    out = response(line, gain, push)
    assert np.all(out[:11] == 0.0)
    assert np.abs(out[11]).max() > 0.1
