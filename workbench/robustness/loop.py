"""The loop of a linear law and models with bounded errors: everything that is uncertain enters through one scalar per output.

    x(k+1) = A x(k) + B w(k),   w_j(k) = sum_i delta_i(k) lam_i z_i(k),   z(k) = C x(k),   |delta_i(k)| <= 1

The sum is over the parameters i of regression j, and w_j is its equation error: with the law in place the machine is
A(delta) = A + B S diag(lam delta) C, S (q p) with a 1 where parameter i belongs to regression j. delta = 0 is the middle of the
boxes. Set-points, biases and operating points drive the loop but do not turn its poles: `close` leaves them out, `course` follows
them along a run.

    interval models        y_j(k) = row_j'psi_j(k) + w_j(k),   z of regression j = T_j psi_j(k)       (`intervals.regressors`)
    LPV model and errors   x+ = F x + G u + K y,  y = C x + e,  e_j = centre'z_j + w_j                  (`intervals.errors`)
    the law                u(k) of r(k), y(k)                                                           (its `at`)

The state holds the state of the model, past outputs and inputs, the newest and the changes between neighbours, and the memory
of the law. Some of it may be superfluous (past inputs that a law remembers too); `balanced` makes the numbers fit for a solver
all the same.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, Protocol

import numpy as np

from workbench.data import SAME_DT
from workbench.errors import InputError
from workbench.intervals.domains.choice import nearest
from workbench.intervals.errors import ERROR_OF
from workbench.intervals.model import IntervalModel, Simulation
from workbench.intervals.semantics import ParameterBox
from workbench.lpv import LPVModel, check_no_feedthrough
from workbench.physics.controller import Controller, Loop, stepped
from workbench.records import field, record
from workbench.robustness.envelopes.course import Course
from workbench.robustness.frequency import System
from workbench.robustness.rests import Rest

SEEN = 0.1  # widths of a mode's domain that a schedule value may lie outside
RATE_OF = "rate of "
FLOOR = 1e-6  # of the largest reachable variance: what a direction of the state counts that nothing reaches
LOST, ROUNDED = np.log(1e-13), 5  # of the largest number beside it: what rounding leaves of a 0; how often that is looked for
COMPARED, SAME_ANSWER = 12, 1e-6  # samples at which law and linear form are compared; of an answer, how far they may differ
SHARES = (0.95, 0.7, 0.4, 0.02, 1e-4)  # of the room that a law has: answers that are compared; smaller ones drown in rounding
HUGE, SMALL = 1e6, (1e-6, 1e-9)  # the room of what has no limits, and shares of it besides: it may be in any unit
FEW = 3  # schedule values at which they are compared at least


class LinearLaw(Loop, Protocol):
    """A sampled law that is linear where the schedule stands still."""

    def at(self, rho: float | None) -> Any:
        """python-control system from (r, y) to u less its offset; its state keeps its meaning while the schedule moves."""
        ...

    def offset(self, rho: float | None) -> np.ndarray:
        """What `at` leaves out of the command, (nu,)."""
        ...

    @property
    def low(self) -> np.ndarray:
        """Limits of the command, (nu,); `high` likewise, `rate` those of its change per second."""
        ...

    @property
    def high(self) -> np.ndarray: ...
    @property
    def rate(self) -> np.ndarray: ...
    @property
    def span(self) -> np.ndarray:
        """Between which the schedule changes the law, (2,); infinite without one."""
        ...


LINEAR = ("at", "offset", "low", "high", "rate", "span")


@record
class UncertainLoop:
    """See the module. channel (p): the column of B through which parameter i acts; parameters (p): what they are called."""

    A: np.ndarray = field("n n")
    B: np.ndarray = field("n q")
    C: np.ndarray = field("p n")
    lam: np.ndarray = field("p", low=0.0)
    channel: np.ndarray = field("p", low=0.0)
    parameters: tuple[str, ...] = ()
    dt: float = field("", unit="s", default=1.0)

    def __post_init__(self):
        q = self.B.shape[1]
        if not np.isin(self.channel, np.arange(q)).all():
            raise InputError(f"channel must be an integer from 0 to {q - 1}", file="UncertainLoop")
        if self.parameters and len(self.parameters) != len(self.lam):
            raise InputError(f"{len(self.parameters)} names for {len(self.lam)} parameters", file="UncertainLoop")

    @property
    def columns(self) -> np.ndarray:
        """b_j lam_i of every parameter, (n, p): A(delta) = A + columns diag(delta) C."""
        return self.B[:, self.channel.astype(int)] * self.lam

    def at(self, delta: np.ndarray) -> np.ndarray:
        """A(delta), (..., n, n), for delta (..., p)."""
        return self.A + (self.columns * np.asarray(delta)[..., None, :]) @ self.C

    @property
    def alive(self) -> np.ndarray:
        """Whether each parameter (p) changes anything: its radius is not 0, it acts on the state, and its z moves with it."""
        return np.any(self.columns, axis=0) & np.any(self.C, axis=1)

    def only(self, chosen: np.ndarray) -> "UncertainLoop":
        """The loop with the chosen (p) of its parameters uncertain and the others in the middle of their boxes."""
        names = tuple(name for name, own in zip(self.parameters, chosen, strict=False) if own)
        return replace(self, C=self.C[chosen], lam=self.lam[chosen], channel=self.channel[chosen], parameters=names)

    @property
    def radius(self) -> float:
        """Largest modulus of a pole in the middle of the boxes."""
        return float(np.abs(np.linalg.eigvals(self.A)).max(initial=0.0))

    def moved(self, into: np.ndarray) -> "UncertainLoop":
        """The same loop in coordinates into x."""
        back = np.linalg.inv(into)
        return UncertainLoop(into @ self.A @ back, into @ self.B, self.C @ back, self.lam, self.channel, self.parameters, self.dt)

    def balanced(self) -> "UncertainLoop":
        """In the coordinates of `balance`."""
        return self.moved(self.balance())

    def balance(self) -> np.ndarray:
        """T (n n): with T x for x, x'x is a Lyapunov function of the middle in which no direction is much larger than another.

        T x is the same whatever units states, inputs, outputs and parameters are counted in.
        Raises InputError where the middle is not stable.
        """
        from scipy.linalg import solve_discrete_lyapunov

        if not self.radius < 1.0:
            raise InputError(
                f"the loop is not stable in the middle of the boxes: a pole of modulus {self.radius:.6f}",
                file="UncertainLoop",
                mend="another controller, or another model",
            )
        n, alive = len(self.A), self.alive
        columns, C = self.columns[:, alive], self.C[alive]
        unit = units(np.block([[self.A, columns], [C, np.zeros((len(C), len(C)))]]))
        x, z = unit[:n], unit[n:]
        A, columns, C = self.A * x[:, None] / x, columns * x[:, None] / z, C * z[:, None] / x
        reached = solve_discrete_lyapunov(A, columns @ columns.T)
        most = np.diag(reached).max(initial=0.0)
        size = np.sqrt(np.maximum(np.diag(reached), FLOOR * most)) if most > 0.0 else np.ones(n)
        A, C = A * size / size[:, None], C * size
        weight = C.T @ C
        P = solve_discrete_lyapunov(A.T, weight / max(np.trace(weight), 1e-300) + np.eye(n) / n)
        return np.linalg.cholesky(0.5 * (P + P.T)).T / size * x


def units(M: np.ndarray) -> np.ndarray:
    """d (n) > 0 with d_i M_ij / d_j as near to 1 as can be: the least sum of (log |M_ij| + log d_i - log d_j)^2.

    Whoever counts x_i of x = M x in other units gets the same numbers d_i M_ij / d_j. What rounding left of a 0 does not count.
    """
    with np.errstate(divide="ignore"):
        size = np.log(np.abs(M))
    np.fill_diagonal(size, -np.inf)
    log_d = np.zeros(len(M))
    for _ in range(ROUNDED):
        i, j = np.nonzero(np.isfinite(size))
        rows = np.zeros((len(i), len(M)))
        rows[np.arange(len(i)), i], rows[np.arange(len(i)), j] = 1.0, -1.0
        log_d = np.linalg.lstsq(rows, -size[i, j], rcond=None)[0]
        scaled = size + log_d[:, None] - log_d
        largest = np.minimum(scaled.max(axis=1)[:, None], scaled.max(axis=0))
        left = np.isfinite(size) & (scaled < largest + LOST)
        if not left.any():
            break
        size[left] = -np.inf
    return np.exp(log_d)


@record
class Machine:
    """What a law is closed around: s+ = A s + Bu u + By y + a,  y = C s + c + w,  z = T s + t, at one schedule value.

    One w for each output; parameters (p), radii lam (p), channel (p): the output whose w a parameter acts through.
    """

    A: np.ndarray = field("n n")
    Bu: np.ndarray = field("n nu")
    By: np.ndarray = field("n ny")
    a: np.ndarray = field("n")
    C: np.ndarray = field("ny n")
    c: np.ndarray = field("ny")
    T: np.ndarray = field("p n")
    t: np.ndarray = field("p")
    lam: np.ndarray = field("p", low=0.0)
    channel: np.ndarray = field("p", low=0.0)
    rest: np.ndarray = field("nu")  # an input that nobody commands stays here
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    dt: float = field("", unit="s")

    def at(self, delta: np.ndarray, inputs: Sequence[str], outputs: Sequence[str]) -> System:
        """From inputs to outputs, with constant parameters delta (p)."""
        C = self.C + np.eye(len(self.C))[:, self.channel.astype(int)] @ ((self.lam * delta)[:, None] * self.T)
        B = self.Bu[:, [self.inputs.index(name) for name in inputs]]
        seen = [self.outputs.index(name) for name in outputs]
        return System(self.A + self.By @ C, B, C[seen], np.zeros((len(seen), B.shape[1])), self.dt)


@record
class DrivenLoop:
    """x+ = A x + G d + B w,  v = E x + H d + F w,  z = C x + J d;  d = (r, 1), v the outputs and the commands (`signals`)."""

    A: np.ndarray = field("n n")
    G: np.ndarray = field("n nd")
    B: np.ndarray = field("n q")
    E: np.ndarray = field("s n")
    H: np.ndarray = field("s nd")
    F: np.ndarray = field("s q")
    C: np.ndarray = field("p n")
    J: np.ndarray = field("p nd")
    lam: np.ndarray = field("p", low=0.0)
    channel: np.ndarray = field("p", low=0.0)
    parameters: tuple[str, ...]
    signals: tuple[str, ...]
    dt: float = field("", unit="s")

    @property
    def moving(self) -> np.ndarray:
        """Whether the regressor of each parameter (p) moves with the loop; the others are errors that no parameter explains."""
        return np.abs(self.C).max(axis=1, initial=0.0) > 0.0

    def quiet(self) -> "DrivenLoop":
        """Without the errors that no parameter explains: nothing but the parameters of regressors that move is uncertain."""
        return replace(self, lam=np.where(self.moving, self.lam, 0.0))

    def undriven(self) -> UncertainLoop:
        """Without what drives it, and without the parameters of regressors that do not move."""
        moving = self.moving
        names = tuple(name for name, moves in zip(self.parameters, moving, strict=True) if moves)
        return UncertainLoop(self.A, self.B, self.C[moving], self.lam[moving], self.channel[moving], names, self.dt)


def close(models: Sequence[IntervalModel], law: LinearLaw, rho: float | None = None) -> UncertainLoop:
    """The loop of `law` with one interval model for each output that it measures, frozen at a schedule value.

    Raises InputError where names or sample times do not fit, where no mode is known at rho, and for inputs that act at once.
    """
    return driven(machine_of(models, law, rho), law, rho).undriven()


def driven(machine: Machine, law: LinearLaw, rho: float | None = None) -> DrivenLoop:
    """The machine under the law at one schedule value. Raises InputError for a law of another sample time."""
    if abs(law.dt - machine.dt) > SAME_DT * machine.dt:
        mend = "design one on this model"
        raise InputError(f"{law.name} is sampled every {law.dt:g} s, the model every {machine.dt:g} s", file=law.name, mend=mend)
    system = law.at(rho)
    Ac, Bc, Cc, Dc = (np.asarray(M, dtype=float) for M in (system.A, system.B, system.C, system.D))
    nr, nc = len(law.references), len(Ac)
    y = [machine.outputs.index(name) for name in law.measured]
    u = [machine.inputs.index(name) for name in law.actuated]
    n, ny = machine.By.shape
    left = [i for i in range(len(machine.inputs)) if i not in u]
    # every signal is a row over (s, law, r, 1, w)
    s, memory = np.eye(n, n + nc + nr + 1 + ny), np.eye(nc, n + nc + nr + 1 + ny, k=n)
    r, one = np.eye(nr, n + nc + nr + 1 + ny, k=n + nc), np.eye(1, n + nc + nr + 1 + ny, k=n + nc + nr)
    outputs = machine.C @ s + np.outer(machine.c, one) + np.eye(ny, n + nc + nr + 1 + ny, k=n + nc + nr + 1)
    seen = np.vstack([r, outputs[y]])
    commands = Cc @ memory + Dc @ seen + np.outer(law.offset(rho), one)
    held = np.outer(machine.a + machine.Bu[:, left] @ machine.rest[left], one)
    after = machine.A @ s + machine.Bu[:, u] @ commands + machine.By @ outputs + held
    x, watched = np.vstack([after, Ac @ memory + Bc @ seen]), np.vstack([outputs[y], commands])
    z = machine.T @ s + np.outer(machine.t, one)
    cut = np.cumsum([n + nc, nr + 1])
    (A, G, B), (E, H, F), (C, J, _) = (np.split(rows, cut, axis=1) for rows in (x, watched, z))
    signals = (*law.measured, *law.actuated)
    return DrivenLoop(A, G, B, E, H, F, C, J, machine.lam, machine.channel, machine.parameters, signals, law.dt)


def course(loops: Sequence[DrivenLoop], references: np.ndarray, initial: np.ndarray | None = None) -> Course:
    """The loop along set-points (N, nr); one loop for all samples, or one for each.

    It begins at the rest of any machine of the boxes, under the loop of the first sample and set-points between initial (nr, 2);
    None: under the first ones. Raises InputError where the middle of the boxes has no rest there.
    """
    N, first, nr = len(references), loops[0], references.shape[1]
    ends = np.repeat(references[0][:, None], 2, axis=1) if initial is None else np.asarray(initial, dtype=float)
    if ends.shape != (nr, 2) or not np.all(ends[:, 0] <= ends[:, 1]):
        raise InputError(f"set-points before the run of shape {ends.shape}", file="course", mend=f"({nr}, 2): low <= high")
    if len(loops) not in (1, N):
        raise InputError(f"{len(loops)} loops for {N} samples", file="course", mend="one, or one for each sample")
    d = np.column_stack([references, np.ones(N)])
    mode = np.arange(N) if len(loops) == N else np.zeros(N)

    def along(key: str) -> np.ndarray:
        return np.stack([getattr(loop, key) for loop in loops])

    def driving(key: str) -> np.ndarray:
        return np.einsum("kij,kj->ki", np.broadcast_to(along(key), (N, *getattr(first, key).shape)), d)

    q = driving("G")
    if not np.abs(np.linalg.eigvals(first.A)).max(initial=0.0) < 1.0:
        problem = "the middle of the boxes does not come to rest"
        raise InputError(problem, file="course", mend="another controller, or another model")
    wide = ends[:, 1] > ends[:, 0]
    usual = np.append(np.where(wide, 0.5 * (ends[:, 0] + ends[:, 1]), ends[:, 0]), 1.0)
    half = np.nextafter(np.abs(ends - usual[:nr, None]).max(axis=1), np.inf)[wide]  # both ends are held, rounding and all
    before = Rest(first.G @ usual, first.G[:, :nr][:, wide] * half, first.J @ usual, first.J[:, :nr][:, wide] * half)
    return Course(
        A=along("A"), B=along("B"), C=along("C"), E=along("E"), F=along("F"), lam=along("lam"), channel=first.channel, mode=mode,
        q=q, g=driving("H"), f=driving("J"), start=np.linalg.solve(np.eye(len(first.A)) - first.A, before.q),
        signals=first.signals, before=before,
    )  # fmt: skip


def with_rates(loop: DrivenLoop, names: Sequence[str]) -> DrivenLoop:
    """The loop with the change per second of these commands among its signals, as "rate of ..".

    The last commands join the state.
    """
    at = [loop.signals.index(name) for name in names]
    E, H, F = (M[at] for M in (loop.E, loop.H, loop.F))
    n, m = len(loop.A), len(at)
    kept = np.eye(n, n + m)
    return replace(
        loop,
        A=np.vstack([loop.A, E]) @ kept,
        G=np.vstack([loop.G, H]),
        B=np.vstack([loop.B, F]),
        E=np.vstack([loop.E @ kept, np.hstack([E, -np.eye(m)]) / loop.dt]),
        H=np.vstack([loop.H, H / loop.dt]),
        F=np.vstack([loop.F, F / loop.dt]),
        C=loop.C @ kept,
        signals=(*loop.signals, *(f"{RATE_OF}{name}" for name in names)),
    )


def course_of(
    model: LPVModel, errors: Sequence[IntervalModel], law: LinearLaw, rho: np.ndarray, references: np.ndarray,
    *, noise: bool, rates: Sequence[str] = (), initial: np.ndarray | None = None,
) -> Course:  # fmt: skip
    """The loop of a law and a model whose errors are bounded, along a schedule (N) and set-points (N nr).

    noise: with the errors that no parameter explains. rates: commands whose change per second is watched too. initial (nr, 2):
    set-points under which the loop rests before the run, low and high; None: the first ones.
    """
    check_law(model, law)
    still = np.ptp(rho) == 0.0
    values = rho[:1] if still else rho
    loops = []
    for machine, value in zip(machines_along(model, errors, values), values, strict=True):
        loop = driven(machine, law, float(value) if law.schedule else None)
        loops.append(with_rates(loop if noise else loop.quiet(), rates))
    return course(loops, references, initial)


def machine_of(models: Sequence[IntervalModel], law: LinearLaw, rho: float | None = None) -> Machine:
    """The machine that interval models of the outputs that `law` measures describe at a schedule value."""
    models = _in_order(models, law)
    _check_schedule(models, law, rho)
    memory = _Memory([int((m.form.source == 0).sum()) for m in models], len(law.actuated), _deepest(models))
    Y, c, T, t, lam, channel, names = [], [], [], [], [], [], []
    for j, model in enumerate(models):
        form, box = model.form, _box_at(model, rho)
        psi, one = np.zeros((len(form.source), memory.size)), np.zeros(len(form.source))
        for entry, (source, lag) in enumerate(zip(form.source.astype(int), form.lags.astype(int), strict=True)):
            name = model.inputs[source - 1].name if source > 0 else ""
            if source == 0:
                psi[entry] = memory.output(j, lag)
            elif name in law.actuated:  # one from outside does not move
                psi[entry] = memory.input(law.actuated.index(name), lag)
            one[entry] = float(source < 0)
        row = form.d + form.T.T @ box.centre
        Y, c = [*Y, row @ psi], [*c, row @ one]
        T, t, lam = [*T, form.T @ psi], [*t, form.T @ one], [*lam, box.radius]
        channel.append(np.full(len(box.radius), j))
        names += [f"{model.output.name}: {name}" for name in form.names]
    A, By, Bu = memory.shift()
    nu = len(law.actuated)
    return Machine(
        A, Bu, By, np.zeros(memory.size), np.array(Y), np.array(c), np.vstack(T), np.concatenate(t), np.concatenate(lam),
        np.concatenate(channel), np.zeros(nu), tuple(law.measured), tuple(law.actuated), tuple(names), law.dt,
    )  # fmt: skip


def check_law(model: LPVModel, law: LinearLaw) -> None:
    """Refuse a law of other outputs or inputs, or of another schedule, than the model."""
    for kind, names, channels in (("output", law.measured, model.outputs), ("input", law.actuated, model.inputs)):
        known = [c.name for c in channels]
        if foreign := [name for name in names if name not in known]:
            problem = f"{law.name} has the {kind}s {', '.join(names)}, the model {', '.join(known)}"
            raise InputError(problem, file=model.name, mend=f"identify a model that has {', '.join(foreign)}")
    own = model.schedule.name if model.schedule else None
    if law.schedule and law.schedule != own:
        problem = f"{law.name} is scheduled on {law.schedule}, the model on {own or 'nothing'}"
        raise InputError(problem, file=model.name, mend="design a law on this model, or check it on the model it was designed on")


def without_linear_form(law: Any, values: Sequence[float] = ()) -> str:
    """Why nothing can be proved of a law on a linear model, in words; "" where its linear form is what it commands.

    `at` is not believed: at the ends and the middle of its span and at the schedule `values`, law and linear form are given the
    same samples, small ones and such as take it close to its limits, and must answer them alike. A law that is a record is asked
    without its limits; another one is led off them first, where constant errors can.
    """
    if not all(hasattr(law, name) for name in LINEAR):
        how = "is an equation of its own" if isinstance(law, Controller) else "is computed step by step"
        return f"{law.name} {how}: no linear law to prove anything of; it is checked on the plant alone"
    low, high = law.span
    for rho in np.union1d(np.linspace(low, high, FEW), values).tolist() if law.schedule else [None]:
        try:
            off = _apart(_unlimited(law), rho)
        except Exception as reason:
            off = f"{type(reason).__name__}: {reason}"
        if off:
            where = "" if rho is None else f" at {law.schedule} = {rho:.4g}"
            return f"the linear form of {law.name}{where} is not its law: {off}; nothing is proved of it"
    return ""


def _unlimited(law: Any) -> Any:
    """The law without limits, where it is a record that has them as numbers; else the law."""
    if not is_dataclass(law) or not {"low", "high", "rate"} <= {f.name for f in fields(law) if f.init}:
        return law
    record: Any = law
    none = np.full(len(record.actuated), np.inf)
    return replace(record, low=-none, high=none, rate=none)


def _apart(law: Any, rho: float | None) -> str:
    """How law and linear form differ where the schedule stands still; "" where they do not.

    Two runs of the law with the same first sample differ by what the linear form makes of the difference of their samples, as
    long as no limit acts; from the cold, r = y = 0 is commanded as `offset` says, within the limits.
    """
    system, random = law.at(rho), np.random.default_rng(0)
    A, B, C, D = (np.asarray(M, dtype=float) for M in (system.A, system.B, system.C, system.D))
    nr, ny, dt = len(law.references), len(law.measured), law.dt
    low, high, rate = (np.asarray(own, dtype=float) for own in (law.low, law.high, law.rate))

    def run(r: np.ndarray, y: np.ndarray) -> np.ndarray:
        state, said = law.init(), []
        for own_r, own_y in zip(r, y, strict=True):
            u, state = stepped(law, state, own_r, own_y, rho)
            said.append(u)
        return np.array(said)

    said, offset = run(np.zeros((1, nr)), np.zeros((1, ny)))[0], np.asarray(law.offset(rho), dtype=float)
    if not np.allclose(said, np.clip(offset, low, high), rtol=1e-6, atol=1e-9):
        return f"at r = y = 0 it commands {said.tolist()}, its offset is {offset.tolist()}"
    led = _led_inside(run, nr, ny, low, high, rate * dt)
    if led is None:
        return "its commands stay at their limits"
    before, room, moves = led
    push = random.normal(size=(COMPARED, nr + ny))
    push[0] = 0.0
    x, answer = np.zeros(len(A)), []
    for own in push:
        answer.append(C @ x + D @ own)
        x = A @ x + B @ own
    steps = np.abs(np.diff([np.zeros(len(low)), *answer], axis=0)).max(axis=0)
    rooms = (room, np.abs(answer).max(axis=0)), (moves, steps)
    largest = min(np.min(np.minimum(own, 1e150) / np.maximum(most, 1e-150)) for own, most in rooms)
    rest = np.repeat(before[-1:], COMPARED, axis=0)

    def answered(share: float) -> np.ndarray:
        return run(*np.split(np.vstack([before, rest + share * push]), [nr], axis=1))[len(before) :]

    plain = answered(0.0)
    for share in (*SHARES, *(SMALL if largest > HUGE else ())):
        size = share * min(largest, HUGE)
        off = np.abs(answered(size) - plain - size * np.array(answer))
        most = size * np.abs(answer).max(axis=0) + 1e-9 * np.abs(plain).max(axis=0) + 1e-12
        if np.any(off > SAME_ANSWER * most):
            return f"to samples about {size:.2g} in size it answers otherwise, by {np.max(off / most):.2g} of the answer"
    return ""


def _led_inside(
    run: Callable, nr: int, ny: int, low: np.ndarray, high: np.ndarray, move: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Samples (N, nr + ny) after which the law stays off its limits while they stand still, and the room that is left (nu,) each:
    to its limits, and for a move from one sample to the next.

    Errors of all sizes and signs, and then none: what an integral has reached stays.
    """
    for size in (0.0, *10.0 ** np.arange(-4.0, 5.0)):
        for signs in itertools.product((-1.0, 1.0), repeat=ny if size else 0):
            y = size * np.array(signs) if size else np.zeros(ny)
            for length in (0, 1, 10, 100):
                samples = np.zeros((length + 2 * COMPARED, nr + ny))
                samples[:length, nr:] = y
                u = run(*np.split(samples, [nr], axis=1))[length + COMPARED // 2 :]
                room, moves = np.minimum(u - low, high - u).min(axis=0), move - np.abs(np.diff(u, axis=0)).max(axis=0)
                if np.isfinite(u).all() and np.all(room > 0.0) and np.all(moves > 0.0):
                    most = np.finfo(float).max / 1e3
                    return samples[: length + COMPARED], np.minimum(room, most), np.minimum(moves, most)
                if not size:
                    break
    return None


def machine_with_errors(model: LPVModel, errors: Sequence[IntervalModel], rho: float | None = None) -> Machine:
    """The LPV model at a schedule value with the interval models of its one-step errors, one for each output.

    Raises InputError where they do not belong together, and for a model whose inputs act at once.
    """
    weight = model.weights(np.array([_within(model, rho)]))[0]
    return _with_errors(model, errors, weight, _within(model, rho))


def interpolated(
    machines: Sequence[Machine], nodes: Sequence[float] | np.ndarray, law: LinearLaw
) -> Callable[[float], UncertainLoop]:
    """The loop at a schedule value, of the machine linear between those at the nodes: what `lyapunov` can certify in motion."""
    rho = np.asarray(nodes, dtype=float)

    def at(value: float) -> UncertainLoop:
        i = int(np.clip(np.searchsorted(rho, value, side="right") - 1, 0, len(rho) - 2))
        share = (value - rho[i]) / (rho[i + 1] - rho[i])
        first, last = machines[i], machines[i + 1]
        numbers = {f.name: getattr(first, f.name) for f in fields(first) if isinstance(getattr(first, f.name), np.ndarray)}
        between = {name: (1.0 - share) * own + share * getattr(last, name) for name, own in numbers.items()}
        return driven(replace(first, **between), law, value).undriven()

    return at


def machines_along(model: LPVModel, errors: Sequence[IntervalModel], rho: np.ndarray) -> Iterator[Machine]:
    """The machine at every sample of a schedule rho (N); where it leaves what the model has seen the edge holds."""
    inside = np.clip(rho, *model.span)
    for value, weight in zip(inside, model.weights(inside), strict=True):
        yield _with_errors(model, errors, weight, float(value))


def _within(model: LPVModel, rho: float | None) -> float:
    """The schedule value as the model takes it. Raises InputError outside of what it has seen."""
    model.freeze(rho)
    return 0.0 if model.schedule is None or rho is None else float(np.clip(rho, *model.span))


def _with_errors(model: LPVModel, errors: Sequence[IntervalModel], weight: np.ndarray, rho: float) -> Machine:
    """The same with the weights (nt) of the terms at a sample."""
    check_no_feedthrough(model)
    known = {e.output.name: e for e in errors}
    wanted, sources = [ERROR_OF + c.name for c in model.outputs], [c.name for c in (*model.outputs, *model.inputs)]
    if model.predictor is None or sorted(known) != sorted(wanted) or len(errors) != len(wanted):
        problem = f"interval models of {', '.join(known) or 'nothing'}"
        raise InputError(problem, file=model.name, mend=f"errors of this model: {', '.join(wanted)}")
    F, G, K, C = (np.tensordot(weight, M, 1) for M in (model.predictor.F, model.predictor.G, model.predictor.K, model.C))
    phi = model.operating_point.basis(np.array([rho]))[0]
    y0, u0 = phi @ model.operating_point.y, phi @ model.operating_point.u
    ny, nu, n = len(model.outputs), len(model.inputs), model.order
    lags = max(int(e.form.lags.max()) for e in errors)
    memory = _Memory([lags] * ny, nu, lags)
    T, t, lam, channel, names = [], [], [], [], []
    through = np.zeros((ny, memory.size))  # of the middle of the boxes
    for j, name in enumerate(wanted):
        own = known[name]
        if [c.name for c in own.inputs] != sources or len(own.modes) != 1:
            raise InputError(f"{own.output.name} depends on other channels", file=own.name, mend="identify it on this model")
        form, box = own.form, own.modes[0].box
        psi, one = np.zeros((len(form.source), memory.size)), (form.source < 0).astype(float)
        for entry, (source, lag) in enumerate(zip(form.source.astype(int), form.lags.astype(int), strict=True)):
            if source > 0:
                psi[entry] = memory.output(source - 1, lag) if source <= ny else memory.input(source - 1 - ny, lag)
        through[j] = box.centre @ form.T @ psi
        T, t, lam = [*T, form.T @ psi], [*t, form.T @ one], [*lam, box.radius]
        channel.append(np.full(len(box.radius), j))
        names += [f"{name}: {entry}" for entry in form.names]
    A, By, Bu = memory.shift()
    whole = np.zeros((n + memory.size, n + memory.size))
    whole[:n, :n], whole[n:, n:] = F, A
    T = np.vstack(T)
    return Machine(
        whole, np.vstack([G, Bu]), np.vstack([K, By]), -np.concatenate([G @ u0 + K @ y0, Bu @ u0 + By @ y0]),
        np.hstack([C, through]), y0, np.hstack([np.zeros((len(T), n)), T]), np.concatenate(t), np.concatenate(lam),
        np.concatenate(channel), u0, tuple(c.name for c in model.outputs), tuple(c.name for c in model.inputs), tuple(names),
        model.dt,
    )  # fmt: skip


class _Memory:
    """past[j] past values of output j and `deepest` of nu inputs: the newest and the changes between neighbours."""

    def __init__(self, past: Sequence[int], nu: int, deepest: int):
        from scipy.linalg import block_diag

        self.past, self.nu, self.deepest = list(past), nu, deepest
        self.starts = np.concatenate([[0], np.cumsum(past)]).astype(int)
        self.size = int(self.starts[-1]) + nu * deepest
        own = [_changes(count) for count in past if count]
        into = [*own, *([np.kron(_changes(deepest), np.eye(nu))] if deepest else [])]
        self.into = np.asarray(block_diag(*into)) if into else np.zeros((0, 0))
        self.back = np.linalg.inv(self.into)

    def output(self, j: int, lag: int) -> np.ndarray:
        """y_j(k - lag) as a row over the state."""
        return self.back[self.starts[j] + lag - 1]

    def input(self, i: int, lag: int) -> np.ndarray:
        """u_i(k - lag) as a row over the state."""
        return self.back[int(self.starts[-1]) + self.nu * (lag - 1) + i]

    def shift(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, By, Bu of the state: y(k) and u(k) come in, all else moves one place on."""
        A, By, Bu = np.zeros((self.size, self.size)), np.zeros((self.size, len(self.past))), np.zeros((self.size, self.nu))
        for j, count in enumerate(self.past):
            if count:
                at = self.starts[j]
                By[at, j] = 1.0
                A[np.arange(1, count) + at, np.arange(count - 1) + at] = 1.0
        inputs = int(self.starts[-1])
        if self.deepest:
            Bu[inputs : inputs + self.nu] = np.eye(self.nu)
            A[inputs + self.nu :, inputs : self.size - self.nu] = np.eye(self.size - inputs - self.nu)
        return self.into @ A @ self.back, self.into @ By, self.into @ Bu


def _deepest(models: Sequence[IntervalModel]) -> int:
    return max(int(model.form.lags[model.form.source > 0].max(initial=0.0)) for model in models)


def _in_order(models: Sequence[IntervalModel], law: LinearLaw) -> list[IntervalModel]:
    """The models in the order of the law's measurements, checked."""
    known = {model.output.name: model for model in models}
    if len(known) < len(models):
        twice = [model.output.name for model in models]
        raise InputError(f"two interval models of one output among {', '.join(twice)}", file=law.name, mend="give one of them")
    inputs = {c.name for model in models for c in model.inputs}
    if unseen := [name for name in law.actuated if name not in inputs]:
        raise InputError(
            f"commands {', '.join(unseen)}, which moves no output of the models",
            file=law.name,
            mend=f"the models have the inputs {', '.join(sorted(inputs))}",
        )
    missing = [name for name in law.measured if name not in known]
    if missing:
        raise InputError(
            f"no interval model of {', '.join(missing)}, which {law.name} measures",
            file=law.name,
            mend=f"workbench identify --output {missing[0]} --model interval",
        )
    for model in models:
        if isinstance(model.semantics, Simulation):
            raise InputError(
                "a simulation model promises free runs and nothing about its equation, which the loop is made of",
                file=model.name,
                mend="identify with equation-error boxes",
            )
        if outputs := [c.name for c in model.inputs if c.name in known]:
            raise InputError(
                f"has {outputs[0]} as input, which is the output of another model",
                file=model.name,
                mend="identify every output from the commands alone",
            )
        if abs(model.dt - law.dt) > SAME_DT * law.dt:
            raise InputError(f"sample time {model.dt:g} s, {law.name} has {law.dt:g} s", file=model.name)
        form = model.form
        if np.any((form.source > 0) & (form.lags == 0)):
            raise InputError(
                "its inputs act within the sample in which they are commanded",
                file=model.name,
                mend="identify it with delay 1: a law commands after it has measured",
            )
    return [known[name] for name in law.measured]


def _check_schedule(models: Sequence[IntervalModel], law: LinearLaw, rho: float | None) -> None:
    """Refuse a schedule value that is missing, or that means one thing to the law and another to a model."""
    known = {model.schedule.name for model in models if model.schedule} | ({law.schedule} if law.schedule else set())
    if len(known) > 1:
        raise InputError(f"scheduled on {', '.join(sorted(known))}", file=law.name, mend="law and models share one schedule")
    if known and rho is None:
        raise InputError(f"no value of {known.pop()}", file=law.name, mend="give the schedule value to freeze at")


def _box_at(model: IntervalModel, rho: float | None) -> ParameterBox:
    """The box at a schedule value: of the mode that holds it, and where several do the smallest box around theirs."""
    boxes = [mode.box for mode in model.modes]
    if model.schedule is None:
        if len(boxes) > 1:
            raise InputError(
                f"{len(boxes)} modes that no schedule tells apart",
                file=model.name,
                mend="identify with --schedule, or with one mode",
            )
    else:
        at = np.array([[rho]], dtype=float)
        domains = [mode.domain for mode in model.modes]
        found = nearest(domains, at)
        if found.gauge[0] > SEEN:
            unit = f" {model.schedule.unit}".rstrip()
            problem = f"no mode was identified at {model.schedule.name} = {rho:g}{unit}"
            raise InputError(problem, file=model.name, mend="give records of that part of the schedule")
        held = [box for box, domain in zip(boxes, domains, strict=True) if domain.holds(at)[0]]
        boxes = held or [boxes[int(found.index[0])]]
    low = np.min([box.centre - box.radius for box in boxes], axis=0)
    high = np.max([box.centre + box.radius for box in boxes], axis=0)
    return (
        boxes[0]
        if len(boxes) == 1
        else ParameterBox(0.5 * (low + high), np.nextafter(0.5 * (high - low), np.inf) * (1.0 + 1e-15))
    )


def _changes(count: int) -> np.ndarray:
    return np.eye(count, k=-1) - np.diag(np.append(-1.0, np.ones(count - 1)))
