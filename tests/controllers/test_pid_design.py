"""From an LPV model to a scheduled PID: bounds kept everywhere, u0 that holds the set-point, and what is refused."""

from dataclasses import replace

import control
import numpy as np
import pytest

from controllers.pid_design import Structure, design_pid
from workbench.basis import CONSTANT, PiecewiseLinear
from workbench.data import Channel
from workbench.errors import InputError
from workbench.lpv import LPVModel, OperatingPoint, Term, constant_model, load_model
from workbench.robustness.frozen import Bounds, loops_of, margins_of

pytestmark = pytest.mark.slow

DT = 0.1
INPUTS = (Channel("V1", "V", "input"), Channel("V2", "V", "input"))
OUTPUTS = (Channel("w3", "rad/s", "output"), Channel("theta", "deg", "output"))
TURNED = np.array([[2.0, 5.0], [-3.0, 1.0]]), np.array([[5.0, 2.0], [-1.0, 3.0]])  # steady gains at both ends


def machine(slow=0.8, fast=0.5, turned=TURNED) -> LPVModel:
    """Two lags behind steady gains that turn over the schedule from one matrix to another, as a winding machine's do."""
    A = np.diag([slow, fast])
    B = [(np.eye(2) - A) @ G for G in turned]
    point = OperatingPoint(CONSTANT, u=[[0.5, 0.2]], y=[[10.0, 1.0]])
    return LPVModel(
        "machine", DT, INPUTS, OUTPUTS, (Channel("r2", "m", "schedule"),), [[1.0, 2.0]], PiecewiseLinear((1.0, 2.0)),
        (Term(0), Term(1)), np.stack([A, A]), np.stack(B), np.stack([np.eye(2)] * 2), np.zeros((2, 2, 2)), point,
    )  # fmt: skip


@pytest.fixture(scope="module")
def designed():
    return design_pid(machine(), knots=3, bounds=Bounds(1.5, 1.4, 4.0), setpoint=(12.0, 0.0))


def peaks(law, model, rho, omega):
    """|S| and |T| at the plant input, max |S_ii|, and |Q|, from the definitions."""
    A, B, C, D = model.freeze(rho)
    P = np.array([C @ np.linalg.solve(np.exp(1j * w * DT) * np.eye(len(A)) - A, B) + D for w in omega])
    K = law.response(omega, rho)
    S = np.linalg.inv(np.eye(2) + K @ P)
    Q = K @ np.linalg.inv(np.eye(2) + P @ K)
    size = lambda M: np.linalg.norm(M, 2, axis=(1, 2)).max()  # noqa: E731
    return size(S), size(np.eye(2) - S), np.abs(np.einsum("wii->wi", S)).max(), size(Q)


def test_bounds_are_kept_between_all_knots_and_frequencies(designed):
    law = replace(designed.law, b=np.ones(2), c=np.ones(2))
    for rho in np.random.default_rng(1).uniform(1.0, 2.0, 25):
        S, T, alone, _ = peaks(law, machine(), rho, np.linspace(1e-3, 0.9999, 2000) * np.pi / DT)
        assert S <= 1.5
        assert T <= 1.4
        assert alone <= 1.5
    assert designed.margins.sensitivity.max() > 1.45  # what is allowed is used
    assert (designed.margins.radius < 1.0).all()


def test_its_margins_are_those_of_the_definitions(designed):
    law = replace(designed.law, b=np.ones(2), c=np.ones(2))
    rhos = [1.0, 1.37, 2.0]
    found = margins_of(designed.law, machine(), rhos)
    for i, rho in enumerate(rhos):
        S, T, alone, Q = peaks(law, machine(), rho, np.linspace(1e-4, 0.9999, 4000) * np.pi / DT)
        least = np.linalg.svd(machine().to_control(rho)(1.0).real, compute_uv=False)[-1]
        np.testing.assert_allclose(
            [found.sensitivity[i], found.complementary[i], found.loops[i].max(), found.effort[i]],
            [S, T, alone, Q * least],
            rtol=1e-3,
        )


def test_a_pole_at_the_wrong_place_is_seen(designed):
    wrong = replace(designed.law, Ki=-designed.law.Ki)
    found = margins_of(wrong, machine(), [1.5])
    assert found.radius[0] > 1.0
    assert found.broken(Bounds())[0]


def test_every_knot_comes_near_what_it_reaches_alone(designed):
    most = design_pid(machine(), knots=3, bounds=Bounds(1.5, 1.4, 4.0), objective="integral")
    assert (most.low_frequency <= most.alone * (1 + 1e-2)).all()
    assert (most.low_frequency >= 0.8 * most.alone).all()
    for rho, reached in zip(designed.knots, designed.deviation / designed.scale, strict=True):
        one = design_pid(
            machine(),
            knots=[rho],
            bounds=Bounds(1.5, 1.4, 4.0),
            scale=designed.scale,
            load=designed.loads.size,
            load_every=designed.loads.every,
        )
        assert np.linalg.norm(reached) <= 1.1 * np.linalg.norm(one.deviation[0] / designed.scale)


def test_a_fixed_law_pays_for_the_turning_gains(designed):
    middle = design_pid(machine(), knots=1, bounds=Bounds(1.5, 1.4, 4.0))
    assert middle.law.schedule is None
    assert middle.margins.sensitivity[0] <= 1.5
    ends = margins_of(middle.law, machine(), [1.0, 2.0])
    assert ends.sensitivity.max() > 1.5


def steady(rho, u):
    """Outputs (ny,) of the machine at rest under u."""
    A, B, C, D = machine().freeze(rho)
    return (C @ np.linalg.solve(np.eye(2) - A, B) + D) @ (u - [0.5, 0.2]) + [10.0, 1.0]


def test_the_feedforward_holds_every_setpoint_at_every_knot(designed):
    for rho in (1.0, 1.5, 2.0):
        gains = designed.law.gains_at(rho)
        for r in ([12.0, 0.0], [10.0, 1.0], [-3.0, 4.0]):
            np.testing.assert_allclose(steady(rho, gains.u0 + gains.Kr @ r), r, atol=1e-9)


@pytest.mark.parametrize("b", [0.0, 0.4, 1.0])
def test_set_point_weights_leave_the_usual_set_point_alone(b):
    """At r = y = the usual set-point the law commands what holds it, at every knot, before its integral has done anything."""
    for structure in (Structure(b=b), Structure(b=b, feedforward=False)):
        law = design_pid(machine(), knots=[1.0, 2.0], structure=structure, setpoint=(12.0, 0.5)).law
        r = np.array([12.0, 0.5])
        for rho in (1.0, 2.0):
            u, _ = law.step(law.init(), r, r, rho)
            np.testing.assert_allclose(steady(rho, u), r, atol=1e-9)


def test_without_feedforward_u0_holds_the_usual_setpoint():
    bare = Structure(feedforward=False)
    found = design_pid(machine(), knots=[1.0, 2.0], structure=bare, setpoint=(12.0, 0.0)).law
    assert (found.Kr == 0.0).all()
    for rho in (1.0, 2.0):
        np.testing.assert_allclose(steady(rho, found.gains_at(rho).u0), [12.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(design_pid(machine(), knots=1, structure=bare).law.u0, [[0.5, 0.2]])


@pytest.mark.parametrize("allowed", [np.eye(2), [[1, 0], [1, 1]], [[1, 1], [0, 1]], [[0, 1], [1, 0]]])
def test_a_feedforward_of_some_entries_comes_as_near_as_it_can(allowed):
    """No other entries of the structure bring the outputs nearer to a set-point; those that must be 0 are."""
    rho = 1.2 if np.trace(allowed) else 1.9
    design = design_pid(machine(), knots=[rho], structure=Structure(allowed=np.array(allowed)), setpoint=(12.0, 0.5))
    Kr, scale = design.law.Kr[0], design.scale
    assert (Kr[np.array(allowed) == 0] == 0.0).all()
    A, B, C, D = machine().freeze(rho)
    gain = C @ np.linalg.solve(np.eye(2) - A, B) + D

    def missed(K):
        return np.linalg.norm((gain @ K - np.eye(2)) / scale[:, None] * scale)

    for i, j in zip(*np.nonzero(allowed), strict=True):
        for step in (-1e-3, 1e-3):
            other = Kr.copy()
            other[i, j] += step
            assert missed(other) > missed(Kr)
    np.testing.assert_allclose(steady(rho, design.law.u0[0] + Kr @ [12.0, 0.5]), [12.0, 0.5], atol=1e-9)


def test_the_feedforward_leaves_the_loop_alone(designed):
    """The same feedback with and without: margins say nothing of set-points."""
    bare = design_pid(machine(), knots=1, structure=Structure(feedforward=False)).law
    whole = design_pid(machine(), knots=1).law
    for key in ("Kp", "Ki", "Kd"):
        np.testing.assert_array_equal(getattr(bare, key), getattr(whole, key))


def test_the_law_of_one_model_is_robust_to_another(tmp_path):
    machine(slow=0.9, turned=tuple(1.6 * G for G in TURNED)).save(tmp_path / "other.json")
    other = load_model(tmp_path / "other.json")
    bounds = Bounds(1.5, 1.4, 4.0)
    lonely = design_pid(machine(), knots=1, bounds=bounds)
    assert margins_of(lonely.law, other, [1.5], bounds).sensitivity[0] > 1.5
    both = design_pid(machine(), knots=1, bounds=bounds, robust_to=(other,))
    for model in (machine(), other):
        assert margins_of(both.law, model, [1.5], bounds).sensitivity[0] <= 1.5


def test_a_model_without_schedule_and_a_law_without_derivative():
    A, B, C, D = machine().freeze(1.2)
    lti = constant_model("lti", DT, (INPUTS, OUTPUTS), (A, B, C, D), machine().operating_point)
    found = design_pid(lti, structure=Structure(derivative=False, allowed=np.array([[0, 1], [1, 1]]), low=(-1.0, 0.0), high=2.0))
    assert found.law.schedule is None
    assert (found.law.Kd == 0.0).all()
    assert found.law.Kp[0, 0, 0] == found.law.Ki[0, 0, 0] == 0.0
    np.testing.assert_array_equal(found.law.low, [-1.0, 0.0])
    assert margins_of(found.law, lti, [None]).sensitivity[0] <= 1.6


@pytest.mark.slow
def test_a_machine_that_runs_away_is_held():
    model = machine(slow=1.02)
    found = design_pid(model, knots=3)
    assert not found.margins.broken(Bounds()).any()
    for rho in (1.0, 1.3, 2.0):
        A, B, C, D = model.freeze(rho)
        loop = control.feedback(control.ss(A, B, C, D, DT), control.ss(*of_y(found.law, rho), DT))
        assert np.abs(loop.poles()).max() < 1.0


def of_y(law, rho):
    """The law from -y, as a state-space system."""
    own = law.at(rho)
    return own.A, -own.B[:, 2:], own.C, -own.D[:, 2:]


def test_bad_models_and_options_are_refused():
    with pytest.raises(InputError, match="no law was found that keeps the bounds"):
        design_pid(machine(slow=3.0), knots=1)
    dead = machine(turned=tuple(np.diag([1.0, 0.0]) @ G for G in TURNED))
    with pytest.raises(InputError, match="channel theta: no input moves it"):
        design_pid(dead)
    with pytest.raises(InputError, match="the model knows r2 from 1 to 2 m"):
        design_pid(machine(), knots=[0.5, 1.5])
    with pytest.raises(InputError, match="0 knots"):
        design_pid(machine(), knots=0)
    with pytest.raises(InputError, match="3 set-points"):
        design_pid(machine(), knots=1, setpoint=(1.0, 2.0, 3.0))
    with pytest.raises(InputError, match="other inputs, outputs, schedule or sample time"):
        design_pid(machine(), knots=1, robust_to=(replace(machine(), dt=0.2),))


def test_opened_loops_belong_to_the_sensitivities(designed):
    """L_i = 1 / S_ii - 1, S by python-control on the loop broken at the plant input."""
    omega, rho = np.array([0.1, 1.0, 5.0]), 1.3
    plant, law = machine().to_control(rho), designed.law.at(rho)
    own = control.StateSpace(law.A, -law.B[:, 2:], law.C, -law.D[:, 2:], DT)
    S = control.feedback(control.StateSpace([], [], [], np.eye(2), DT), own * plant)
    expected = [1.0 / np.diag(S(np.exp(1j * w * DT))) - 1.0 for w in omega]
    np.testing.assert_allclose(loops_of(designed.law, machine(), rho, omega), expected, rtol=1e-9)


def test_the_delay_margin_is_that_of_whole_samples(designed):
    """Loops of a slow machine with integral action alone: python-control with one more sample at a time until a pole leaves."""
    bounds = Bounds(1.2, 1.2, 4.0)
    law = design_pid(machine(slow=0.95, fast=0.9), knots=1, bounds=bounds).law
    found = margins_of(law, machine(slow=0.95, fast=0.9), [1.3], bounds).delay[0]
    answer, plant = law.at(1.3), machine(slow=0.95, fast=0.9).to_control(1.3)
    K = control.StateSpace(answer.A, -answer.B[:, 2:], answer.C, -answer.D[:, 2:], DT)
    for i in range(2):
        samples = found[i] / DT
        assert samples > 1.0
        for n, stable in ((int(np.floor(samples)), True), (int(np.ceil(samples)), False)):
            shift = [control.ss(np.eye(n, k=-1), np.eye(n, 1), np.eye(1, n, n - 1), 0.0, DT) if k == i else 1.0 for k in range(2)]
            late = control.append(*(control.ss([], [], [], [[s]], DT) if isinstance(s, float) else s for s in shift))
            poles = control.feedback(plant * late, K).poles()
            assert (np.abs(poles).max() < 1.0) == stable


def test_a_lost_loop_has_no_delay_margin(designed):
    wrong = replace(designed.law, Ki=-designed.law.Ki)
    assert (margins_of(wrong, machine(), [1.5]).delay == 0.0).all()
