"""How much faster one MPC step is than the same problem stated in CVXPY with parameters, and than do-mpc with IPOPT: medians of
times taken side by side in one run, at horizon 20. pytest -m bench"""

import time
from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest

from controllers.along import Along
from controllers.condensing import condense
from controllers.mpc import MPC, design_mpc
from controllers.nmpc import Ipopt, design_nmpc
from controllers.pid import pid
from controllers.receding import Weights, solved_by_daqp
from plants import WEB_WINDING
from workbench.basis import CONSTANT, PiecewiseLinear
from workbench.data import Channel
from workbench.lpv import LPVModel, OperatingPoint, Predictor, Term

pytestmark = pytest.mark.bench

N, DT, STEPS = 20, 0.04, 200


def model() -> LPVModel:
    """Seven states, two inputs, two outputs, gains that turn over the schedule: the size of the winding machine."""
    random = np.random.default_rng(1)
    A = np.linalg.qr(random.normal(size=(7, 7)))[0] @ np.diag(random.uniform(0.5, 0.95, 7))
    B, C = random.normal(size=(2, 7, 2)), random.normal(size=(2, 7)) * 0.5
    gain = 0.1 * A @ C.T
    inputs, outputs = (tuple(Channel(f"{role}{i}", "", role) for i in range(2)) for role in ("input", "output"))
    two = lambda M: np.stack([M, M])  # noqa: E731
    return LPVModel(
        "m", DT, inputs, outputs, (Channel("rho", "", "schedule"),), [[0.0, 1.0]], PiecewiseLinear((0.0, 1.0)),
        (Term(0), Term(1)), two(A), B, two(C), np.zeros((2, 2, 2)), OperatingPoint(CONSTANT, u=[[0.0, 0.0]], y=[[0.0, 0.0]]),
        Predictor(two(A - gain @ C), B, two(gain)), np.eye(2) * 0.01,
    )  # fmt: skip


def law() -> MPC:
    names = [tuple(f"{role}{i}" for i in range(2)) for role in ("input", "output")]
    fallback = pid(*names, tuple(f"{n}_set" for n in names[1]), DT, [0.0, 0.0], [0.1, 0.1], low=-1.0, high=1.0, rate=10.0)
    limits = {"y_low": np.full(2, -2.0), "y_high": np.full(2, 2.0)}
    return design_mpc(model(), fallback, horizon=N, weights=Weights((1.0, 1.0), (0.1, 0.1), (0.0, 0.0)), **limits)


class InCVXPY:
    """The problem of one step with states as variables; matrices, state and set-point are parameters (DPP)."""

    def __init__(self, controller: MPC):
        self.own, w = controller, controller.weights
        self.A, self.B = [cp.Parameter((7, 7)) for _ in range(N)], [cp.Parameter((7, 2)) for _ in range(N)]
        self.C = [cp.Parameter((2, 7)) for _ in range(N + 1)]
        self.x0, self.d, self.last, self.r = cp.Parameter(7), cp.Parameter(2), cp.Parameter(2), cp.Parameter(2)
        self.push, self.L, self.end = cp.Parameter((N, 7)), cp.Parameter((9, 9)), cp.Parameter(9)
        x, self.u, s = cp.Variable((N + 1, 7)), cp.Variable((N, 2)), cp.Variable(2, nonneg=True)
        cost, limits, before = 0.0, [x[0] == self.x0], self.last
        for i in range(N):
            if i:
                cost += cp.sum_squares(cp.multiply(np.sqrt(w.outputs), self.C[i] @ x[i] - self.r))
            cost += cp.sum_squares(cp.multiply(np.sqrt(w.moves), self.u[i] - before))
            y = self.C[i + 1] @ x[i + 1]
            limits += [x[i + 1] == self.A[i] @ x[i] + self.B[i] @ self.u[i] + self.push[i], y - s <= controller.y_high]
            limits += [y + s >= controller.y_low, cp.abs(self.u[i] - before) <= controller.rate * DT]
            limits += [self.u[i] >= controller.low, self.u[i] <= controller.high]
            before = self.u[i]
        cost += cp.sum_squares(self.L @ cp.hstack([x[N], self.u[N - 1]]) - self.end)
        price = w.violation * (np.sqrt(w.outputs) @ s + 0.5 * w.outputs @ cp.square(s))
        self.problem = cp.Problem(cp.Minimize(0.5 * cost + price), limits)
        assert self.problem.is_dcp(dpp=True)

    def first_move(self, along, z, last, r, target) -> np.ndarray:
        for i in range(N):
            self.A[i].value, self.B[i].value, self.C[i].value = along.matrices(i)
        self.C[N].value = along.matrices(N)[2]
        xt, ut, yt = target
        L = np.linalg.cholesky(self.own.terminal_cost(along.path[-1])).T
        self.x0.value, self.last.value, self.r.value, self.L.value = z[:7], last, yt, L
        self.push.value, self.end.value = along.pushed(np.tile(z[7:], (N, 1))), L @ np.concatenate([xt, ut])
        self.problem.solve(solver=cp.CLARABEL)
        return self.u.value[0]


def cases(controller):
    random = np.random.default_rng(2)
    for _ in range(STEPS):
        z, last = random.normal(size=9) * np.repeat([0.5, 0.1], [7, 2]), random.uniform(-0.8, 0.8, 2)
        yield z, last, random.normal(size=2), random.uniform(0.0, 0.9)


def test_condense_and_solve_against_cvxpy_with_parameters():
    controller = law()
    stated, ours, theirs, evaluated, apart = InCVXPY(controller), [], [], [], []
    for n, (z, last, r, rho) in enumerate(cases(controller)):
        begin = time.perf_counter()
        along = Along(controller, controller._path(rho, 1e-3))
        middle = time.perf_counter()
        program = controller._program(last, along, z, np.tile(r, (N + 1, 1)))
        answer = solved_by_daqp(program)
        end = time.perf_counter()
        if n % 10:
            continue  # the peer takes long: every tenth is compared
        target = controller._target(last, along, z, r)
        start = time.perf_counter()
        other = stated.first_move(along, z, last, r, target)
        if n:  # the first solve compiles
            theirs.append(time.perf_counter() - start)
            ours.append(end - middle)
            evaluated.append(end - begin)
            apart.append(np.abs(answer[:2] - other).max())
    solve, whole = np.median(theirs) / np.median(ours), np.median(theirs) / np.median(evaluated)
    print(
        f"\ncondense and solve {np.median(ours) * 1e6:.0f} us, p99 {np.quantile(ours, 0.99) * 1e6:.0f} us; with the model along "
        f"the schedule {np.median(evaluated) * 1e6:.0f} us; CVXPY with parameters {np.median(theirs) * 1e3:.1f} ms: "
        f"{solve:.0f} and {whole:.0f} times as fast; first moves apart by {max(apart):.1e}"
    )
    assert max(apart) < 1e-5
    assert solve > 40.0
    assert whole > 20.0


def test_a_step_in_closed_loop():
    controller = law()
    random, state, seconds = np.random.default_rng(3), controller.init(np.zeros(2)), []
    for k in range(2000):
        r, y = np.sign(np.sin(0.05 * k)) * np.ones(2), random.normal(size=2)
        begin = time.perf_counter()
        _, state = controller.step(state, r, y, 0.5)
        seconds.append(time.perf_counter() - begin)
    print(f"\nwhole step: median {np.median(seconds) * 1e3:.2f} ms, p99 {np.quantile(seconds, 0.99) * 1e3:.2f} ms")
    assert np.quantile(seconds, 0.99) < DT  # a sample of the winding machine


def test_condensing_alone():
    controller = law()
    z, last, r, rho = next(cases(controller))
    along = Along(controller, controller._path(rho, 1e-3))
    rest = (np.zeros((N, 7)), np.zeros((N + 1, 2)), z[:7].copy(), np.tile(r, (N + 1, 1)), last, (np.zeros(7), np.zeros(2)))
    weights = (controller._Q, controller._S, controller._R, controller.terminal_cost(rho))
    seconds = []
    for _ in range(2000):
        begin = time.perf_counter()
        condense(along.M, *rest, weights)
        seconds.append(time.perf_counter() - begin)
    print(f"\ncondensing: median {np.median(seconds) * 1e6:.0f} us")


def in_do_mpc(controller: MPC, rho: float):
    """Its nearest equivalent: model frozen at rho, bounds of the commands, soft limits of the outputs; no limit of the rate."""
    do_mpc = pytest.importorskip("do_mpc", reason="pip install do-mpc")
    import casadi as ca

    along, w = Along(controller, np.full(N + 1, rho)), controller.weights
    A, B, C = along.matrices(0)
    stated = do_mpc.model.Model("discrete")
    x, u = stated.set_variable("_x", "x", (7, 1)), stated.set_variable("_u", "u", (2, 1))
    stated.set_variable("_p", "r", (2, 1))
    d = stated.set_variable("_p", "d", (2, 1))
    stated.set_rhs("x", ca.DM(A) @ x + ca.DM(B) @ (u + d))
    stated.setup()
    y, r = ca.DM(C) @ stated.x["x"], stated.p["r"]
    theirs = do_mpc.controller.MPC(stated)
    theirs.settings.n_horizon, theirs.settings.t_step, theirs.settings.store_full_solution = N, DT, False
    theirs.settings.supress_ipopt_output()
    cost = ca.sum1(ca.DM(w.outputs) * (y - r) ** 2)
    theirs.set_objective(mterm=cost, lterm=cost)
    theirs.set_rterm(u=w.moves)
    theirs.bounds["lower", "_u", "u"], theirs.bounds["upper", "_u", "u"] = controller.low, controller.high
    for i in range(2):
        for name, sign in (("high", 1.0), ("low", -1.0)):
            limit = sign * (controller.y_high if name == "high" else controller.y_low)[i]
            price = {"penalty_term_cons": w.violation, "soft_constraint": True}
            theirs.set_nl_cons(f"{name}{i}", sign * y[i], ub=float(limit), **price)
    now = theirs.get_p_template(1)
    theirs.set_p_fun(lambda _: now)
    theirs.setup()
    return theirs, now


@pytest.mark.filterwarnings("ignore")
def test_a_whole_step_against_do_mpc_with_ipopt():
    controller = law()
    theirs, now = in_do_mpc(controller, 0.5)
    ours, peer = [], []
    for n, (z, last, r, _) in enumerate(cases(controller)):
        state = controller.init(last)._replace(z=z)
        begin = time.perf_counter()
        controller.step(state, r, np.full(2, np.nan), 0.5)
        ours.append(time.perf_counter() - begin)
        if n % 10:
            continue
        now["_p", 0, "r"], now["_p", 0, "d"] = r, z[7:]
        theirs.x0, theirs.u0 = z[:7], last
        theirs.set_initial_guess()
        start = time.perf_counter()
        theirs.make_step(z[:7].reshape(-1, 1))
        if n:
            peer.append(time.perf_counter() - start)
        assert theirs.solver_stats["success"]
    own, other = 1e3 * np.median(ours[1:]), 1e3 * np.median(peer)
    print(f"\nwhole step {own:.2f} ms, do-mpc with IPOPT {other:.1f} ms: {other / own:.0f} times as fast")
    assert other > 20.0 * own


def test_a_real_time_iteration_against_ipopt_on_the_winding_machine():
    names = ("V1", "V2"), ("w3", "theta"), ("w3_set", "theta_set")
    fallback = pid(*names, 0.04, [0.0, 0.0], [0.1, 0.1], low=-2.0, high=5.0)
    ours = design_nmpc(WEB_WINDING, fallback)
    theirs, random = replace(ours, solver=Ipopt()), np.random.default_rng(4)
    x, u = WEB_WINDING.equilibrium()
    own, peer = [], []
    for k in range(11):
        at, r = x * (1.0 + 0.02 * random.normal(size=7)), np.tile([100.0, 0.0] + random.normal(size=2) * [10.0, 3.0], (N, 1))
        for law, seconds in ((ours, own), (theirs, peer)):
            begin = time.perf_counter()
            found, _ = law._planned(law.init(u), at, np.zeros(2), r)
            if k:  # the first solve builds the program
                seconds.append(time.perf_counter() - begin)
            assert found is not None
    print(f"\none iteration {1e3 * np.median(own):.1f} ms, IPOPT {1e3 * np.median(peer):.0f} ms")
    assert np.median(peer) > 20.0 * np.median(own)
