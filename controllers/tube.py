"""Tubes: limits tightened along the horizon, so that what a model may get wrong cannot break them.

    x(k+1) = A x(k) + B (u(k) - u0) + K e(k),   y(k) = C x(k) + y0 + e(k),   |e_j(k)| <= W_j
    W_j = sum_i theta_ji sup |z_i| + bound_j,   z: last outputs and commands, anywhere within their limits    (intervals.errors)

The state of this model is computed from what was measured: only e is unknown, and there is no error of an observer to add. Let
a plan from k go on at k + 1 as it was, but for -F (x, u_last) of what e(k + 1) moved: then it is off by A_F^(i-1) b e in
(x, u_last) after i samples, b = (K, 0), A_F the loop of (A, B) and F. So step i + 1 leaves the room of step i, and for that:

    y: t_1 = W,  t_(i+1) = t_i + sum_j W_j |C A_F^(i-1) b_j|;   commands: 0, 0, .. + sum_j W_j |(1 - F) A_F^(i-1) b_j|;   moves: F

The tube is rigid: its sizes are found once and change nothing but limits in the program, whose solution costs what it did. One
schedule value: the powers of A_F, exactly. Several: rho^2 X_j >= A_v X_j A_v', b_v b_v' <= s_j^2 X_j at all nodes v, so that
|c'A_F .. A_F b_j| <= rho^(i-1) s_j sqrt(c'X_j c) however the schedule moves among the nodes; the first steps by all sequences.
F is the regulator of the law's own weights, or of dearer moves where that leaves more of the limits.

Proved, in outward-rounded arithmetic: from a plan without slack, for every e in its bounds, the outputs of the next sample keep
their limits, and the continuation above keeps all limits for N samples, as long as the schedule goes as predicted, among nodes.
Not proved: that each sample has a plan without slack, for the last step of the continuation is beyond the plan and there is no
terminal set; schedule values between the nodes and a schedule that turns; a start in motion, before the predictor has forgotten
it. Limits of outputs stay soft in the program: a plan with slack is followed, and its status says that it is outside the tube.
Solvers keep the tightened limits to a millionth.

Source: Chisci, Rossiter, Zappa, "Systems with persistent disturbances: predictive control with restricted constraints",
Automatica 37 (2001); with ellipsoids Koehler et al., "A computationally efficient robust model predictive control framework for
uncertain nonlinear systems", IEEE TAC 66 (2021).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from controllers.observer import Observer
from workbench.errors import InputError
from workbench.intervals.arithmetic import Interval, exact, positive_definite
from workbench.intervals.errors import ERROR_OF
from workbench.intervals.model import IntervalModel
from workbench.lpv import LPVModel, check_schedule_from_outside
from workbench.records import field, record
from workbench.robustness.semidefinite import Block, maximise, symmetric

if TYPE_CHECKING:
    from controllers.mpc import MPC

SEQUENCES = 2000  # of nodes, up to which all of them are followed
SPEEDS = (0.03, 0.08, 0.15, 0.25, 0.4, 0.6)  # contraction tried: parts of the way from the slowest pole to 1
PRICES = (1.0, 10.0, 100.0, 1e3, 1e4)  # of a move, in that of the law: regulators tried
ROUNDED = 1e-9  # what stored numbers are larger by than the proof needs, so that another machine confirms them
FILTER = 0.1  # part of an error's change that the estimate of what stays of it follows in a sample
SAME = 1e-8


@record
class Tube:
    """Sizes of a tube and what proves them. theta (p): largest |theta|, acting on `source` (outputs, then inputs; -1: the 1).

    channel (p): the output that it moves. error (ny): W. rho (g): nodes, F (g, nu, nz) there; X, contraction, size by error: X_j,
    rho_j, s_j. y, u, moves: room left below each limit at every step, of outputs from step 1, of commands and moves from 0.
    """

    parameters: tuple[str, ...]
    theta: np.ndarray = field("p", low=0.0)
    source: np.ndarray = field("p", low=-1.0)
    channel: np.ndarray = field("p", low=0.0)
    error: np.ndarray = field("ny", low=0.0)
    rho: np.ndarray = field("g")
    F: np.ndarray = field("g nu nz")
    X: np.ndarray = field("ny nz nz")
    contraction: np.ndarray = field("ny", low=0.0, high=1.0)
    size: np.ndarray = field("ny", low=0.0)
    y: np.ndarray = field("N ny", low=0.0)
    u: np.ndarray = field("N nu", low=0.0)
    moves: np.ndarray = field("N nu", low=0.0)

    def check(self, law: "MPC") -> None:
        """Refuse a tube that is not proved for this law, or that takes all of a limit."""
        problem = self._broken(law)
        if problem:
            raise InputError(f"the tube is not proved: {problem}", file=law.name, mend="design the law again, with --tube")
        _check_room(law, self)

    def _broken(self, law: "MPC") -> str | None:
        nx, nu, ny, g = law.model.order, len(law.low), len(law.y_low), len(self.rho)
        if self.F.shape != (g, nu, nx + nu) or self.X.shape != (ny, nx + nu, nx + nu) or self.y.shape[0] != law.horizon:
            return "it belongs to another law"
        if not np.array_equal(self.rho, law.terminal[0]):
            return "its nodes are not those of the law"
        if not _predicts(law.observer):
            return "the observer is not the model's own predictor"
        if np.any(self.error < _errors(law, self.theta, self.source, self.channel)):
            return "errors may be larger than it says"
        nodes = _nodes(law, self.rho, self.F)
        for j, (X, contraction, size) in enumerate(zip(self.X, self.contraction, self.size, strict=True)):
            if not _contracts(nodes, j, X, contraction, size):
                return f"its ellipsoid of {law.measured[j]} does not contract"
        needed = _sizes(nodes, self.X, self.contraction, self.size, self.error, law.horizon)
        for name, own, least in zip(("outputs", "commands", "moves"), (self.y, self.u, self.moves), needed, strict=True):
            if np.any(own < least):
                return f"{name} need more room than it leaves"
        return None

    def limit(self, law: "MPC") -> np.ndarray:
        """What outputs would need with a horizon without end, (ny,): at most this."""
        nodes = _nodes(law, self.rho, self.F)
        reach = _supports(nodes, self.X)[: len(law.y_low)] * self.size * self.error
        return self.y[-1] + (reach * self.contraction ** (law.horizon - 1) / (1.0 - self.contraction)).sum(axis=1)


class _Nodes(NamedTuple):
    """A_F (g, nz, nz), b (g, nz, ny) and the rows that are watched: (g, ny + nu + nu, nz), of outputs, commands, moves."""

    A: np.ndarray
    b: np.ndarray
    rows: np.ndarray


def predictor_observer(model: LPVModel) -> Observer:
    """The model's own predictor as an observer, and beside it what stays of its errors, which set-points have to be rid of."""
    if model.predictor is None:
        raise InputError("no predictor in this model", file=model.name, mend="identify it from records")
    check_schedule_from_outside(model, "an observer")
    ny, nx = len(model.outputs), model.order
    grid = np.linspace(model.span[0], model.span[1], 11) if model.schedule else np.zeros(1)
    K = np.tensordot(_frozen(model, grid), model.predictor.K, 1)
    L = np.concatenate([np.zeros((len(grid), nx, ny)), np.broadcast_to(FILTER * np.eye(ny), (len(grid), ny, ny))], axis=1)
    return Observer(model, False, grid, L, np.concatenate([K, np.zeros((len(grid), ny, ny))], axis=1))


def design_tube(law: "MPC", errors: Sequence[IntervalModel]) -> Tube:
    """The tube of a law whose observer is `predictor_observer`, under errors that `ErrorRegression` found of its model.

    Raises InputError where an error grows with something that has no limits, and where nothing is left of a limit.
    """
    _check_predictor(law.model)
    names, theta, source, channel = _open(law, errors)
    W = _errors(law, theta, source, channel) * (1.0 + ROUNDED)
    room = np.concatenate([law.y_high - law.y_low, law.high - law.low, 2.0 * law._way])
    best, least = None, np.inf
    for price in PRICES:
        F = regulators(law, price)
        nodes = _nodes(law, law.terminal[0], F)
        found = _ellipsoids(nodes, W, room)
        if found is None:
            continue
        sizes = (t * (1.0 + ROUNDED) for t in _sizes(nodes, *found, W, law.horizon))
        tube = Tube(names, theta, source, channel, W, law.terminal[0], F, *found, *sizes)
        # a command's room is there to be used, an output's is where set-points are: these count ten times
        taken = float(np.max(_taken(tube, room) * np.repeat([1.0, 0.1, 0.1], [len(W), len(law.low), len(law.low)])))
        if taken < least:
            best, least = tube, taken
    if best is None:
        raise InputError("no ellipsoid contracts at every schedule value", file=law.model.name, mend="a model of less schedule")
    _check_room(law, best)
    return best


def regulators(law: "MPC", price: float) -> np.ndarray:
    """F (g, nu, nx + nu) at the nodes: u = u_last - F (x, u_last), with moves `price` times as dear as in the law."""
    dearer = replace(law, tube=None, weights=replace(law.weights, moves=law.weights.moves * price)) if price != 1.0 else law
    nu, found = len(law.low), []
    for rho, P in zip(*dearer.terminal, strict=True):
        A, B, _, _ = law.model.freeze(float(rho) if law.model.schedule else None)
        Az, Bz = _with_commands(A, B)
        S = np.diag(dearer.weights.moves + dearer.weights.inputs)
        cross = np.hstack([np.zeros((nu, len(A))), np.diag(dearer.weights.inputs)])
        F = Bz.T @ P @ Az + cross
        found.append(np.linalg.solve(S + Bz.T @ P @ Bz, F))
    return np.array(found)


def taken(law: "MPC", tube: Tube) -> np.ndarray:
    """Part of half the width between limits that the last step of a plan leaves free: outputs, commands, moves."""
    return _taken(tube, np.concatenate([law.y_high - law.y_low, law.high - law.low, 2.0 * law._way]))


def _taken(tube: Tube, room: np.ndarray) -> np.ndarray:
    return 2.0 * np.concatenate([tube.y[-1], tube.u[-1], tube.moves[-1]]) / room


def _check_room(law: "MPC", tube: Tube) -> None:
    kinds = [(name, "limits of the output", "wider --keep") for name in law.measured]
    kinds += [(name, "limits of the command", "wider --low and --high, a larger --move") for name in law.actuated]
    kinds += [(name, "rate of the command", "a larger --rate or --move") for name in law.actuated]
    for part, (name, what, mend) in zip(taken(law, tube), kinds, strict=True):
        if not part < 1.0:
            raise InputError(
                f"the tube takes {100.0 * part:.0f} % of the {what}: nothing is left", file=law.name, channel=name,
                mend=f"{mend}, records that leave less open, or a shorter --horizon",
            )  # fmt: skip


def _check_predictor(model: LPVModel) -> None:
    """Refuse a model whose predictor is not its simulation corrected by K e: then e is not all that is unknown."""
    if model.predictor is None:
        raise InputError("no predictor in this model", file=model.name, mend="identify it from records")
    grid = np.linspace(model.span[0], model.span[1], 41) if model.schedule else np.zeros(1)
    weight = _frozen(model, grid)
    A, B, C, F, G, K = (
        np.tensordot(weight, M, 1) for M in (model.A, model.B, model.C, model.predictor.F, model.predictor.G, model.predictor.K)
    )
    off = max(np.abs(A - K @ C - F).max(initial=0.0), np.abs(B - G).max(initial=0.0))
    if off > SAME * max(1.0, np.abs(A).max(initial=0.0), np.abs(B).max(initial=0.0)):
        raise InputError(
            f"its predictor is not the model corrected by its errors: they differ by {off:.2g}", file=model.name,
            mend="identify with --model ssm or lti",
        )  # fmt: skip


def _frozen(model: LPVModel, grid: np.ndarray) -> np.ndarray:
    """Weights of the terms where the schedule stands still, (g, nt)."""
    return np.concatenate([model.weights(grid[i : i + 1]) for i in range(len(grid))])


def _open(law: "MPC", errors: Sequence[IntervalModel]) -> tuple[tuple[str, ...], np.ndarray, np.ndarray, np.ndarray]:
    """Names, largest |theta|, sources and channels of what the error models leave open."""
    wanted = [ERROR_OF + name for name in law.measured]
    known = {e.output.name: e for e in errors}
    if sorted(known) != sorted(wanted) or len(errors) != len(wanted):
        raise InputError(f"interval models of {', '.join(known) or 'nothing'}", file=law.name, mend=f"give {', '.join(wanted)}")
    names, theta, source, channel = [], [], [], []
    for j, name in enumerate(wanted):
        own = known[name]
        form = own.form
        if [c.name for c in own.inputs] != [*law.measured, *law.actuated] or len(own.modes) != 1:
            raise InputError(f"{name} depends on other channels", file=own.name, mend="identify it on this model")
        if not np.array_equal(form.T, np.eye(len(form.T))) or form.d.any():
            raise InputError(f"regressors of {name} are not samples of the channels", file=own.name, mend="use ErrorRegression")
        box = own.modes[0].box
        names += [f"{name}: {parameter}" for parameter in form.names]
        theta.append(np.nextafter(np.abs(box.centre) + box.radius, np.inf) * ((box.centre != 0.0) | (box.radius != 0.0)))
        source.append(np.where(form.source > 0, form.source - 1, -1))
        channel.append(np.full(len(form.source), j))
    return tuple(names), np.concatenate(theta), np.concatenate(source), np.concatenate(channel)


def _errors(law: "MPC", theta: np.ndarray, source: np.ndarray, channel: np.ndarray) -> np.ndarray:
    """W (ny): the largest errors while all outputs and commands are within their limits, at the nodes."""
    u0, y0 = law.operating(law.terminal[0])
    middle = np.hstack([y0, u0])
    low, high = np.concatenate([law.y_low, law.low]), np.concatenate([law.y_high, law.high])
    far = np.nextafter(np.maximum(np.abs(low - middle), np.abs(high - middle)).max(axis=0), np.inf)
    W, names = np.zeros(len(law.y_low)), (*law.measured, *law.actuated)
    for size, at, j in zip(theta, source.astype(int), channel.astype(int), strict=True):
        if size > 0.0 and at >= 0 and not np.isfinite(far[at]):
            option = "--keep" if at < len(W) else "--low and --high"
            raise InputError(
                f"{law.measured[j]}: errors grow with {names[at]}, which has no limits", file=law.name, channel=names[at],
                mend=f"give {option} for {names[at]}",
            )  # fmt: skip
        W[j] += size * (far[at] if at >= 0 else 1.0) if size > 0.0 else 0.0
    return W * (1.0 + 1e-14 * len(theta))


def _with_commands(A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A and B of (x, last command), which moves of the command drive."""
    nx, nu = B.shape
    return np.block([[A, B], [np.zeros((nu, nx)), np.eye(nu)]]), np.vstack([B, np.eye(nu)])


def _nodes(law: "MPC", grid: np.ndarray, F: np.ndarray) -> _Nodes:
    model, (nx, nu) = law.model, (law.model.order, len(law.low))
    K = np.tensordot(_frozen(model, grid), model.predictor.K, 1)  # type: ignore[union-attr]
    loops, rows = [], []
    for rho, own in zip(grid, F, strict=True):
        A, B, C, _ = model.freeze(float(rho) if model.schedule else None)
        Az, Bz = _with_commands(A, B)
        loops.append(Az - Bz @ own)
        last = np.hstack([np.zeros((nu, nx)), np.eye(nu)])
        rows.append(np.vstack([np.hstack([C, np.zeros((len(C), nu))]), last - own, own]))
    return _Nodes(np.array(loops), np.concatenate([K, np.zeros((len(grid), nu, K.shape[2]))], axis=1), np.array(rows))


def _contracts(nodes: _Nodes, j: int, X: np.ndarray, contraction: float, size: float) -> bool:
    """Whether rho^2 X >= A_v X A_v' and s^2 X >= b_v b_v' at every node, and X > 0, are proved."""
    if not (contraction < 1.0 and np.array_equal(X, X.T) and positive_definite(X)):
        return False
    A = exact(nodes.A)
    moved = A @ exact(X) @ nodes.A.swapaxes(1, 2)
    if not positive_definite(exact(X) * (exact(contraction) * contraction) - moved).all():
        return False
    b = nodes.b[:, :, j]
    whole = np.broadcast_to(np.pad(X, ((0, 1), (0, 1))), (len(b), len(X) + 1, len(X) + 1)).copy()
    whole[:, :-1, -1] = whole[:, -1, :-1] = b
    low, high = whole.copy(), whole.copy()
    square = exact(size) * size
    low[:, -1, -1], high[:, -1, -1] = square.low, square.high
    return bool(positive_definite(Interval(low, high)).all())


def _supports(nodes: _Nodes, X: np.ndarray) -> np.ndarray:
    """sqrt(c'X_j c) from above, the largest over the nodes: (rows, ny)."""
    rows = nodes.rows
    squares = [((exact(rows) @ exact(own)) * rows).sum(axis=2).high.max(axis=0) for own in X]
    return np.nextafter(np.sqrt(np.maximum(np.array(squares).T, 0.0)), np.inf)


def _sizes(
    nodes: _Nodes, X: np.ndarray, contraction: np.ndarray, size: np.ndarray, W: np.ndarray, N: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Room for outputs, commands and moves (N, .) by the equations of the module, from above."""
    ny = len(W)
    nu = (nodes.rows.shape[1] - ny) // 2
    added = np.zeros((max(N - 1, 0), ny + 2 * nu))
    g, states = len(nodes.A), exact(nodes.b)
    outer = _supports(nodes, X) * size
    for i in range(N - 1):
        by_ellipsoid = outer * contraction**i
        step = by_ellipsoid
        if g ** (i + 2) <= SEQUENCES or g == 1:  # every sequence of nodes so far, each seen from every node
            reached = abs(exact(nodes.rows)[:, None] @ states).high
            step = np.minimum(by_ellipsoid, reached.max(axis=(0, 1))) if g > 1 else reached.max(axis=(0, 1))
            after = exact(nodes.A)[:, None] @ states
            shape = (-1, *nodes.b.shape[1:])
            states = Interval(after.low.reshape(shape), after.high.reshape(shape))
        added[i] = step @ W
    whole = np.vstack([np.zeros(ny + 2 * nu), np.cumsum(added, axis=0)]) * (1.0 + 1e-13 * (N + ny))
    late = np.vstack([np.zeros((1, 2 * nu)), whole[:-1, ny:]]) if N > 1 else whole[:, ny:]
    return whole[:, :ny] + np.nextafter(W, np.inf) * (W > 0.0), late[:, :nu], late[:, nu:]


def _ellipsoids(nodes: _Nodes, W: np.ndarray, room: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """X, contraction and size of every error: those proved that take least of the limits; None where there is none."""
    slowest = float(np.abs(np.linalg.eigvals(nodes.A)).max())
    if not slowest < 1.0:
        return None
    X, contraction, size = [], [], []
    for j in range(len(W)):
        best, least = None, np.inf
        for speed in SPEEDS:
            rho = slowest + speed * (1.0 - slowest)
            own = _ellipsoid(nodes, j, rho, room)
            if own is None:
                continue
            s = _size(nodes, j, own)
            if not _contracts(nodes, j, own, rho, s):
                continue
            cost = float(np.max(_supports(nodes, own[None])[:, 0] * s / (1.0 - rho) / room))
            if cost < least:
                best, least = (own, rho, s), cost
        if best is None:
            return None
        for found, value in zip((X, contraction, size), best, strict=True):
            found.append(value)
    return np.array(X), np.array(contraction), np.array(size)


def _ellipsoid(nodes: _Nodes, j: int, rho: float, room: np.ndarray) -> np.ndarray | None:
    """X >= b_v b_v' with rho^2 X >= A_v X A_v' and the least sum of (sup of a row / its room)^2; not proved."""
    from scipy.linalg import solve_discrete_lyapunov

    n, b = nodes.A.shape[1], nodes.b[:, :, j]
    # in coordinates in which what one node's disturbances reach is of size 1 in each
    middle = len(nodes.A) // 2
    spread = b.T @ b / len(b)
    floor = 1e-6 * max(float(np.trace(spread)), 1e-300) * np.eye(n)
    scale = np.sqrt(np.diag(solve_discrete_lyapunov(nodes.A[middle] / rho, spread + floor)))
    A = nodes.A * scale / scale[:, None]
    b = b / scale
    limited = np.isfinite(room)
    rows = nodes.rows[:, limited] * scale / room[limited][:, None]
    rows = rows / max(float(np.abs(rows).max(initial=0.0)), 1e-300)
    E, L = symmetric(n), int(limited.sum())
    at = np.arange(len(E))
    contraction = rho**2 * E - A[:, None] @ E @ A[:, None].swapaxes(2, 3)
    seen = np.einsum("vla,eab,vlb->vle", rows, E, rows)
    blocks = [Block(-1e-9 * np.eye(n), each, at) for each in contraction]
    blocks += [Block(-np.outer(own, own), E, at) for own in b]
    for v in range(len(A)):
        for line in range(L):
            blocks.append(Block(np.zeros((1, 1)), np.append(-seen[v, line], 1.0)[:, None, None], np.append(at, len(E) + line)))
    x = maximise(np.append(-1e-6 * np.trace(E, axis1=1, axis2=2), -np.ones(L)), blocks)
    if x is None:
        return None
    X = np.tensordot(x[: len(E)], E, 1) + 1e-9 * np.trace(np.tensordot(x[: len(E)], E, 1)) / n * np.eye(n)
    X = scale[:, None] * X * scale
    return 0.5 * (X + X.T)


def _size(nodes: _Nodes, j: int, X: np.ndarray) -> float:
    """s with s^2 X >= b_v b_v' at every node, a little larger than that needs."""
    b = nodes.b[:, :, j]
    square = float(np.max(np.einsum("vi,vi->v", b, np.linalg.solve(X, b.T).T), initial=0.0))
    return float(np.sqrt(max(square, 0.0)) * (1.0 + 1e-7)) + 1e-100


def _predicts(observer: Observer) -> bool:
    nx = observer.model.order
    return not observer.at_inputs and not observer.L[:, :nx].any()
