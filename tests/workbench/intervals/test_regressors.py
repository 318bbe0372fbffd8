"""Regressors of interval models: both forms are one regression, and no regressor reaches across a record or a gap."""

from itertools import product

import control
import numpy as np
import pytest

from workbench.data import Channel, Dataset, Experiment
from workbench.errors import InputError
from workbench.intervals.regressors import ARX, FIR, samples


def record_of(N, seed=0, name="a", nu=2, t=None):
    random = np.random.default_rng(seed)
    values = random.standard_normal((N, 1 + nu))
    channels = (Channel("y", role="output"), *[Channel(f"u{i + 1}", role="input") for i in range(nu)])
    return Experiment(name, np.arange(N) * 0.1 if t is None else t, channels, values, 0.1)


@pytest.mark.parametrize(("n", "delay", "bias"), [*product((1, 2, 3, 4), (0, 1), (True, False))])
def test_the_shift_form_is_the_recursion_with_the_newest_value_first(n, delay, bias):
    e = record_of(n + 6)
    S = samples(ARX(n, delta=False, bias=bias, delay=delay), e, "y", ["u1", "u2"])
    a, b = np.arange(1, n + 1) / 7, [np.arange(n + 1 - delay) + 0.5, 2.0 - np.arange(n + 1 - delay)]
    theta = np.concatenate([a, *b, [3.0] if bias else []])
    y, u = e["y"], [e["u1"], e["u2"]]
    for row, k in enumerate(S.index.astype(int)):
        expected = -sum(a[i - 1] * y[k - i] for i in range(1, n + 1)) + 3.0 * bias
        expected += sum(b[j][i - delay] * u[j][k - i] for j in range(2) for i in range(delay, n + 1))
        assert S.form.d @ S.psi[row] + theta @ S.z[row] == pytest.approx(expected, rel=1e-12, abs=1e-12)
        assert S.y[row] == y[k]
    assert S.index.tolist() == list(range(n, n + 6))


@pytest.mark.parametrize(("n", "delay", "bias"), [*product((1, 2, 3, 4), (0, 1), (True, False))])
def test_delta_and_shift_form_are_the_same_regression_with_parameters_mapped(n, delay, bias):
    e = record_of(30)
    delta, shift = (samples(ARX(n, delta=d, bias=bias, delay=delay), e, "y", ["u1", "u2"]) for d in (True, False))
    np.testing.assert_array_equal(delta.psi, shift.psi)
    assert abs(np.linalg.det(delta.form.T)) == pytest.approx(1.0)
    theta = np.random.default_rng(1).standard_normal(len(delta.form.names))
    mapped = np.linalg.solve(shift.form.T.T, delta.form.d + delta.form.T.T @ theta)
    np.testing.assert_allclose(delta.psi @ delta.form.d + delta.z @ theta, shift.z @ mapped, rtol=0, atol=1e-11)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_delta_regressors_are_differences_anchored_at_the_oldest_sample(n):
    e = record_of(20, nu=1)
    S = samples(ARX(n, bias=False), e, "y", ["u1"])
    for row, k in enumerate(S.index.astype(int)):
        powers = lambda v, j: np.diff(v[k - n : k - n + j + 1], j)[0]  # noqa: E731, B023
        expected = [-powers(e["y"], n - i) for i in range(1, n + 1)] + [powers(e["u1"], j) for j in reversed(range(n))]
        np.testing.assert_allclose(S.z[row], expected, atol=1e-12)
        # D^n y(k-n) is what is left of y(k) once the known part d'psi is taken out
        np.testing.assert_allclose(S.y[row] - S.form.d @ S.psi[row], powers(e["y"], n), atol=1e-12)


def test_delta_coefficients_of_a_transfer_function_come_out_of_its_response():
    # G(s) = (s + 2.3)/(s^2 + 6.6 s + 1.67) of [2] (9), discretised and simulated by python-control
    G = control.c2d(control.tf([1, 2.3], [1, 6.6, 1.67]), 0.05)
    u = np.sign(np.sin(np.arange(400) ** 1.3))
    y = control.forced_response(G, np.arange(400) * 0.05, u).outputs
    S = samples(ARX(2, bias=False), Experiment.from_arrays("a", 0.05, inputs={"u": u}, outputs={"y": y}), "y", ["u"])
    theta = np.linalg.lstsq(S.z, S.y - S.psi @ S.form.d, rcond=None)[0]
    # roots in D = q - 1: poles and zeros of G, each less 1
    np.testing.assert_allclose(np.sort(np.roots([1, *theta[:2]])), np.sort(G.poles().real - 1), rtol=1e-7)
    np.testing.assert_allclose(np.roots(theta[2:]), G.zeros().real - 1, rtol=1e-7)
    assert S.form.names == ("-D y(k-2)", "-y(k-2)", "D u(k-2)", "u(k-2)")


@pytest.mark.parametrize("delay", [0, 1])
def test_an_fir_holds_inputs_alone(delay):
    e = record_of(12, nu=1)
    S = samples(FIR(4, bias=False, delay=delay), e, "y", ["u1"])
    for row, k in enumerate(S.index.astype(int)):
        np.testing.assert_array_equal(S.z[row], [e["u1"][k - i] for i in range(delay, 5)])
    assert S.index[0] == 4


@pytest.mark.parametrize("delta", [True, False])
def test_nothing_reaches_across_a_record_or_a_gap(delta):
    gap = np.arange(30) * 0.1
    gap[17:] += 3.0
    broken, whole = record_of(30, 1, "broken", t=gap), record_of(9, 2, "whole")
    S = samples(ARX(3, delta=delta), Dataset((broken, whole)), "y", ["u1", "u2"])
    assert S.records == ("broken", "broken", "whole")
    assert [S.index[S.piece == p].tolist() for p in range(3)] == [[*range(3, 17)], [*range(20, 30)], [*range(3, 9)]]
    # the first row after the gap holds samples after the gap only
    first = S.psi[S.piece == 1][0]
    np.testing.assert_array_equal(first[:3], broken["y"][[19, 18, 17]])
    np.testing.assert_array_equal(S.psi[S.piece == 2][0][3:6], whole["u1"][[2, 1, 0]])


def test_a_piece_too_short_for_a_regressor_is_left_out():
    t = np.arange(20) * 0.1
    t[3:] += 5.0
    S = samples(ARX(3), record_of(20, t=t), "y", ["u1"])
    assert S.index.tolist() == list(range(6, 20))
    assert len(S.records) == 1


@pytest.mark.parametrize("delta", [True, False])
def test_every_entry_carries_the_error_bound_of_its_channel(delta):
    S = samples(ARX(2, delta=delta, delay=0), record_of(9), "y", ["u1", "u2"], output_error=0.1, input_error=[0.2, 0.0])
    assert S.error.tolist() == [0.1, 0.1, 0.2, 0.2, 0.2, 0.0, 0.0, 0.0, 0.0]
    assert S.output_error == 0.1


def test_rows_are_chosen_with_everything_that_belongs_to_them():
    S = samples(ARX(2), record_of(20), "y", ["u1"], output_error=0.1)
    some = S.rows(slice(3, 7))
    assert len(some) == 4
    np.testing.assert_array_equal(some.z, S.z[3:7])
    np.testing.assert_array_equal(some.index, S.index[3:7])
    assert some.output_error == S.output_error


@pytest.mark.parametrize(
    ("bad", "told"),
    [
        (lambda e: samples(ARX(2), e, "y", ["u1"], output_error=-0.1), "channel y: error bound -0.1"),
        (lambda e: samples(ARX(2), e, "y", ["u1", "u2"], input_error=[0.1, np.nan]), "channel u2: error bound nan"),
        (lambda e: samples(ARX(2), e, "y", []), "name at least one input"),
        (lambda e: samples(ARX(9), e, "y", ["u1"]), "records longer than"),
        (lambda e: samples(ARX(2), e, "y", ["u3"]), "unknown channel 'u3'"),
        (lambda e: ARX(0), "order 0"),
        (lambda e: FIR(0), "order 0"),
        (lambda e: ARX(2, delay=3), "delay 3"),
        (lambda e: ARX(2, delay=-1), "delay -1"),
    ],
)
def test_bad_input_names_the_place_and_the_mend(bad, told):
    with pytest.raises(InputError, match=told):
        bad(record_of(8))


def test_one_sample_behind_the_memory_is_enough():
    assert len(samples(ARX(7), record_of(8), "y", ["u1"])) == 1
    with pytest.raises(InputError, match="7 samples without a gap"):
        samples(ARX(7), record_of(7), "y", ["u1"])
