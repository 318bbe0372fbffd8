"""Tubes: a scalar one by hand, trajectories that stay inside, files that lie, and loops that keep their limits."""

import json
from dataclasses import replace

import numpy as np
import pytest

from controllers import tube as module
from controllers.files import load_controller, save_controller
from controllers.mpc import MPC, design_mpc
from controllers.pid import pid
from controllers.receding import Status, Weights
from controllers.tables import mpc_matrices
from controllers.tube import design_tube, predictor_observer
from workbench.basis import CONSTANT, PiecewiseLinear
from workbench.data import Channel
from workbench.errors import InputError
from workbench.intervals.domains.shapes import Box
from workbench.intervals.model import IntervalModel, Mode, Unrefuted
from workbench.intervals.regressors import FIR
from workbench.intervals.semantics import ParameterBox
from workbench.lpv import LPVModel, OperatingPoint, Predictor, Term

pytestmark = pytest.mark.slow

DT, NAMES = 0.1, (("a", "b"), ("c", "d"), ("c_set", "d_set"))
A = np.array([[0.9, 0.1, 0.0], [-0.1, 0.8, 0.1], [0.0, 0.0, 0.6]])
B = np.array([[0.2, 0.0], [0.1, 0.3], [0.0, 0.4]])
C = np.array([[1.0, 0.0, 0.3], [0.0, 1.0, -0.2]])
K = 0.2 * C.T
U0, Y0 = np.array([0.3, -0.2]), np.array([5.0, 1.0])
LIMITS = {"y_low": [4.0, 0.0], "y_high": [6.0, 2.0], "low": [-3.0, -2.0], "high": [3.0, 3.0], "rate": [20.0, 20.0]}
WEIGHTS = Weights((1.0, 2.0), (0.3, 0.2), (0.0, 0.0))
THETA, BOUND = 0.02 * np.array([1.0, 1.0, 0.3, 0.3]), 0.005


def channels(names, role):
    return tuple(Channel(n, "V", role) for n in names)


def still() -> LPVModel:
    """Three states, two inputs and outputs, around an operating point that is not zero."""
    return LPVModel(
        "m", DT, channels(NAMES[0], "input"), channels(NAMES[1], "output"), (), np.zeros((0, 2)), CONSTANT, (Term(0),), A[None],
        B[None], C[None], np.zeros((1, 2, 2)), OperatingPoint(CONSTANT, u=[U0], y=[Y0]),
        Predictor((A - K @ C)[None], B[None], K[None]), np.diag([0.01, 0.02]),
    )  # fmt: skip


def turning() -> LPVModel:
    """The same with dynamics and gains that turn over a schedule."""
    one, two, turned = still(), 0.95 * A, B @ np.array([[0.8, -0.2], [0.3, 1.1]])
    return replace(
        one, schedules=(Channel("r2", "m", "schedule"),), spans=[[1.0, 2.0]], basis=PiecewiseLinear((1.0, 2.0)),
        terms=(Term(0), Term(1)), A=np.stack([A, two]), B=np.stack([B, turned]), C=np.stack([C, C]), D=np.zeros((2, 2, 2)),
        predictor=Predictor(np.stack([A - K @ C, two - K @ C]), np.stack([B, turned]), np.stack([K, K])),
    )  # fmt: skip


def errors(model, theta=THETA, bound=BOUND, share=1.0):
    """Boxes around no error, of every output alike: theta (4) of the last outputs and inputs, and a constant."""
    sources, found = tuple(Channel(c.name, c.unit, "input") for c in (*model.outputs, *model.inputs)), []
    for output in model.outputs:
        radius = share * np.append(theta, bound)
        mode = Mode(ParameterBox(np.zeros(5), radius), Box(-np.ones(4), np.ones(4)), (), 10, 0.1, 0.5)
        found.append(IntervalModel(
            "e", DT, sources, Channel(f"error of {output.name}", "V", "output"), None, FIR(1), Unrefuted(), 0.0, np.zeros(4), 1.0,
            (mode,),
        ))  # fmt: skip
    return tuple(found)


def fallback():
    return pid(*NAMES, DT, [0.1, 0.1], [0.2, 0.2], low=(-3.0, -2.0), high=(2.0, 3.0), rate=(8.0, 10.0))


def law(model=None, share=1.0, **options) -> MPC:
    model = model or still()
    return design_mpc(model, fallback(), errors=errors(model, share=share), **({"weights": WEIGHTS} | LIMITS | options))


@pytest.fixture(scope="module")
def fixed():
    return law()


@pytest.fixture(scope="module")
def moving():
    return law(turning())


def run(controller, sequence, r, steps, rho=None):
    """Outputs and commands of the model itself under e = sequence(k, z, y of the model), z = (y, u, 1) one sample back."""
    model, state = controller.model, controller.init(U0)
    F, Bm, Cm, _ = model.freeze(rho)
    x, z, ys, us, states = np.zeros(3), np.array([0.0, 0.0, 0.0, 0.0, 1.0]), [], [], []
    for k in range(steps):
        e = sequence(k, z, Cm @ x + Y0)
        y = Cm @ x + Y0 + e
        u, state = controller.step(state, r(k), y, rho)
        x, z = F @ x + Bm @ (u - U0) + K @ e, np.concatenate([y - Y0, u - U0, [1.0]])
        ys.append(y), us.append(u), states.append(state)
    return np.array(ys), np.array(us), states


RADIUS = np.append(THETA, BOUND)


def nature(kind, random):
    """Errors within the boxes: without memory, held for a while, of constant parameters, or towards the nearer limit."""
    held = random.choice([-1.0, 1.0], size=(2, 5))
    still = random.uniform(-1.0, 1.0, size=(2, 5))

    def chosen(k, z, y):
        nonlocal held
        if kind == "random":
            delta = random.choice([-1.0, 1.0], size=(2, 5))
        elif kind == "constant":
            delta = still
        elif kind == "greedy":
            delta = np.where(y >= [5.0, 1.0], 1.0, -1.0)[:, None] * np.sign(z)
        else:
            held = random.choice([-1.0, 1.0], size=(2, 5)) if k % 15 == 0 else held
            delta = held
        return (RADIUS * delta) @ z

    return chosen


# ---- sizes -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("nodes", [1, 2])
def test_a_scalar_tube_is_the_smallest_one(nodes):
    """x+ = a x + e, y = x + e: t_i = W (1 + 1 + a + .. + a^(i-2)), with the limit W + W / (1 - a); commands come a step later."""
    a, W, N = 0.6, np.array([0.3]), 40
    scalar = module._Nodes(np.full((nodes, 1, 1), a), np.ones((nodes, 1, 1)), np.tile([[1.0], [-0.5], [0.25]], (nodes, 1, 1)))
    X, contraction, size = np.ones((1, 1, 1)), np.array([a * (1.0 + 1e-9)]), np.array([1.0 + 1e-9])
    assert module._contracts(scalar, 0, X[0], contraction[0], size[0])
    y, u, moves = module._sizes(scalar, X, contraction, size, W, N)
    expected = W * (1.0 + np.concatenate([[0.0], np.cumsum(a ** np.arange(N - 1))]))
    assert np.all(y[:, 0] >= expected * (1.0 - 1e-14))
    np.testing.assert_allclose(y[:, 0], expected, rtol=1e-6)
    assert y[-1, 0] == pytest.approx(W[0] + W[0] / (1.0 - a), rel=1e-6)
    np.testing.assert_allclose(u[2:, 0], 0.5 * (expected[1:-1] - W), rtol=1e-6)
    np.testing.assert_allclose(moves, 0.5 * u, rtol=1e-6)
    assert not u[:2].any()


def test_an_ellipsoid_that_does_not_contract_is_not_believed():
    scalar = module._Nodes(np.full((1, 1, 1), 0.6), np.ones((1, 1, 1)), np.ones((1, 3, 1)))
    X = np.ones((1, 1))
    assert module._contracts(scalar, 0, X, 0.61, 1.01)
    assert not module._contracts(scalar, 0, X, 0.59, 1.01)
    assert not module._contracts(scalar, 0, X, 0.61, 0.99)
    assert not module._contracts(scalar, 0, -X, 0.61, 1.01)
    assert not module._contracts(scalar, 0, X, 1.0, 1.01)


def test_trajectories_stay_in_the_tube_and_the_worst_one_fills_it(fixed):
    """Deviations of a continued plan, simulated beside: A (x, u_last) under u = u_last - F (x, u_last)."""
    tube, N, random = fixed.tube, fixed.horizon, np.random.default_rng(1)
    F = tube.F[0]

    def deviations(e):
        """Of y (N, 2), u and moves under errors e (N, 2) of samples 1 .. N."""
        x, last, y, u, moves = np.zeros(3), np.zeros(2), [], [[0.0, 0.0]], [[0.0, 0.0]]
        for own in e:
            move = -F @ np.concatenate([x, last])
            y.append(C @ x + own), moves.append(move), u.append(last + move)
            x, last = A @ x + B @ (last + move) + K @ own, last + move
        return np.array(y), np.array(u[:N]), np.array(moves[:N])

    for own in (random.uniform(-1.0, 1.0, (200, N, 2)), random.choice([-1.0, 1.0], (200, N, 2))):
        for e in own * tube.error:
            for got, room in zip(deviations(e), (tube.y, tube.u, tube.moves), strict=True):
                assert np.all(np.abs(got) <= room)
    for channel in range(2):  # errors that all push the last output the same way: linear, so their signs are found one by one
        impulses = np.array(
            [[deviations(np.eye(2 * N)[2 * k + j].reshape(N, 2))[0][-1, channel] for j in range(2)] for k in range(N)]
        )
        worst = deviations(np.sign(impulses) * tube.error)[0][-1, channel]
        assert worst == pytest.approx(tube.y[-1, channel], rel=1e-6)


def test_jumps_of_the_schedule_stay_in_the_tube(moving):
    tube, random = moving.tube, np.random.default_rng(2)
    nodes = module._nodes(moving, tube.rho, tube.F)
    largest = np.zeros_like(tube.y)
    for _ in range(300):
        at, state = int(random.integers(11)), np.zeros(5)
        for i in range(moving.horizon):
            e = random.choice([-1.0, 1.0], 2) * tube.error
            seen = nodes.rows[at][:2] @ state + e
            largest[i] = np.maximum(largest[i], np.abs(seen))
            state, at = nodes.A[at] @ state + nodes.b[at] @ e, int(random.integers(11))
    assert np.all(largest <= tube.y)
    assert np.all(largest[-1] > 0.5 * tube.y[-1])


def test_wider_boxes_take_more_and_none_take_nothing(fixed):
    nothing = law(share=0.0)
    for key in ("y", "u", "moves", "error"):
        half, whole, none = (getattr(own.tube, key) for own in (law(share=0.5), fixed, nothing))
        assert np.all(half <= whole)
        assert not none.any()
    np.testing.assert_allclose(law(share=0.5).tube.y, 0.5 * fixed.tube.y, rtol=1e-6)
    assert np.all(np.diff(fixed.tube.y, axis=0) > 0.0)
    assert np.all(fixed.tube.limit(fixed) >= fixed.tube.y[-1])
    assert np.all(fixed.tube.limit(fixed) < 1.05 * fixed.tube.y[-1])


def test_a_tube_of_nothing_changes_no_command():
    wide, quiet = law(share=0.0), lambda k, z, y: np.zeros(2)
    plain = design_mpc(still(), fallback(), weights=WEIGHTS, observer=predictor_observer(still()), **LIMITS)
    reference = lambda k: np.array([6.0, 0.0]) if k % 40 < 20 else np.array([4.2, 1.7])  # noqa: E731
    for a, b in zip(run(wide, quiet, reference, 80)[:2], run(plain, quiet, reference, 80)[:2], strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_without_a_tube_the_file_knows_of_none():
    assert "tube" not in design_mpc(still(), fallback(), weights=WEIGHTS, **LIMITS).to_dict()


# ---- loops -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["random", "held", "constant", "greedy"])
@pytest.mark.parametrize("rho", [None, 1.37])
def test_the_limits_are_kept_where_the_plain_law_breaks_them(fixed, moving, kind, rho):
    tight = fixed if rho is None else moving
    plain = design_mpc(tight.model, fallback(), weights=WEIGHTS, **LIMITS)
    random = np.random.default_rng(3)
    steps = random.choice([0.0, 1.0], size=(10, 2))
    reference = lambda k: np.where(steps[k // 20] > 0.0, LIMITS["y_high"], LIMITS["y_low"])  # noqa: E731
    over = []
    for controller in (tight, plain):
        ys, us, states = run(controller, nature(kind, np.random.default_rng(4)), reference, 120, rho)
        over.append(float(np.maximum(ys - LIMITS["y_high"], np.array(LIMITS["y_low"]) - ys).max()))
        assert all(state.status is Status.OPTIMAL for state in states)
        assert np.all((us >= controller.low) & (us <= controller.high))
    assert over[0] <= 0.0 < over[1]


def test_a_plan_that_needs_slack_says_so(fixed):
    """A machine that is pushed beyond its limit comes back, and the status tells when the tube holds again."""
    _, _, states = run(fixed, lambda k, z, y: np.array([9.0 * (k == 10), 0.0]), lambda k: np.array([5.9, 1.0]), 60)
    outside = [state.status is Status.OUTSIDE_TUBE for state in states]
    assert any(outside[10:13])
    assert not any(outside[:10])
    assert not any(outside[40:])


def test_outputs_settle_on_a_set_point_although_errors_stay(fixed):
    ys, _, _ = run(fixed, lambda k, z, y: np.array([0.04, -0.03]), lambda k: np.array([5.4, 1.3]), 200)
    np.testing.assert_allclose(ys[-1], [5.4, 1.3], atol=1e-4)


def test_a_set_point_on_the_limit_is_backed_off_by_the_room_of_the_last_step(fixed):
    ys, _, _ = run(fixed, lambda k, z, y: np.zeros(2), lambda k: np.array([6.0, 1.0]), 150)
    assert 6.0 - ys[-1, 0] == pytest.approx(fixed.tube.y[-1, 0], rel=0.02)


def test_a_measurement_that_is_missing_corrects_nothing(fixed):
    state = fixed.init(U0)
    for y in (np.array([5.2, 1.1]), np.full(2, np.nan), np.array([5.2, 1.1])):
        u, state = fixed.step(state, np.array([5.5, 1.0]), y)
        assert np.isfinite(u).all()
        assert np.isfinite(state.z).all()


def test_it_takes_over_from_a_machine_that_stands_without_a_jump(fixed):
    """The predictor of a machine that has stood for long: constant errors are in its state from the first sample on."""
    e, u = np.array([0.03, -0.02]), np.array([0.6, 0.1])
    x = np.linalg.solve(np.eye(3) - A, B @ (u - U0) + K @ e)
    y = C @ x + e + Y0
    _, state = fixed.step(fixed.init(u), y, y)
    np.testing.assert_allclose(state.z[:3], A @ x + B @ (state.u - U0) + K @ e, atol=1e-12)
    np.testing.assert_allclose(state.z[3:], e, atol=1e-12)


# ---- files -----------------------------------------------------------------------------------------------------------------


def test_a_law_with_a_tube_comes_back_and_acts_the_same(moving, tmp_path):
    again = load_controller(save_controller(moving, tmp_path / "mpc.json"))
    for key in ("error", "y", "u", "moves", "X", "F"):
        np.testing.assert_array_equal(getattr(again.tube, key), getattr(moving.tube, key))
    one, other = (run(own, nature("greedy", np.random.default_rng(5)), lambda k: np.array([6.0, 2.0]), 20, 1.2)[1]
                  for own in (moving, again))  # fmt: skip
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda c: c["tube"]["y"].__setitem__(3, [0.05, 0.05]), "outputs need more room"),
        (lambda c: c["tube"]["u"].__setitem__(5, [0.0, 0.0]), "commands need more room"),
        (lambda c: c["tube"]["moves"].__setitem__(5, [0.0, 0.0]), "moves need more room"),
        (lambda c: c["tube"].update(error=[0.01, 0.01]), "errors may be larger"),
        (lambda c: c["tube"].update(contraction=[0.1, 0.1]), "does not contract"),
        (lambda c: c["tube"]["X"][0][0].__setitem__(0, 0.0), "does not contract"),
        (lambda c: c["tube"]["F"][2][0].__setitem__(0, -3.0), "does not contract"),
        (lambda c: c["tube"].update(rho=[1.0 + 0.05 * i for i in range(11)]), "nodes are not those"),
        (lambda c: c["observer"]["L"][0][0].__setitem__(0, 0.1), "not the model's own predictor"),
        (lambda c: c.update(horizon=30), "another law"),
        (lambda c: c.update(y_high=[7.0, 2.0]), "errors may be larger"),
    ],
)
def test_a_certificate_that_was_tampered_with_is_refused(moving, tmp_path, change, problem):
    path = save_controller(moving, tmp_path / "mpc.json")
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=problem):
        load_controller(path)


def test_tables_for_other_programs_refuse_a_tube(fixed):
    with pytest.raises(InputError, match="tightened by a tube"):
        mpc_matrices(fixed)


# ---- refusals --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"share": 8.0}, "nothing is left.*wider --keep"),
        ({"y_high": [np.inf, 2.0]}, "errors grow with c, which has no limits.*--keep"),
        ({"low": [-np.inf, -2.0]}, "errors grow with a, which has no limits.*--low"),
        ({"rate": [0.05, 20.0]}, "rate of the command.*--rate"),
        ({"observer": predictor_observer(still())}, "give no observer"),
    ],
)
def test_what_has_no_tube_is_refused(options, problem):
    with pytest.raises(InputError, match=f"(?s){problem}"):
        law(**options)


def test_models_and_errors_that_do_not_belong_together_are_refused(fixed):
    other = replace(still(), predictor=Predictor((A - K @ C + 0.01)[None], B[None], K[None]))
    with pytest.raises(InputError, match="predictor is not the model corrected"):
        law(other)
    with pytest.raises(InputError, match="no predictor"):
        predictor_observer(replace(still(), predictor=None))
    with pytest.raises(InputError, match="error of c, error of d"):
        design_tube(fixed, errors(still())[:1])
    renamed = replace(errors(still())[0], inputs=tuple(Channel(n, "V", "input") for n in ("c", "d", "a", "v")))
    with pytest.raises(InputError, match="other channels"):
        design_tube(fixed, (renamed, errors(still())[1]))
