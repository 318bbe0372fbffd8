"""The loop of a linear law and interval models: everything that is uncertain enters through one scalar per regression.

    x(k+1) = A x(k) + B w(k),   w_j(k) = sum_i delta_i(k) lam_i z_i(k),   z(k) = C x(k),   |delta_i(k)| <= 1

The sum is over the parameters i of regression j, and w_j is its equation error: with the law in place the machine is
A(delta) = A + B S diag(lam delta) C, S (q p) with a 1 where parameter i belongs to regression j. delta = 0 is the middle of the
boxes. Set-points, biases and input errors drive the loop but do not turn its poles: they are left out here.

    y_j(k) = row_j'psi_j(k) + w_j(k),   z of regression j = T_j psi_j(k)                  (`intervals.regressors`)
    u(k)   = law of y(k), ..                                                               (`at` of the law)

The state holds past outputs and inputs, the newest and the changes between neighbours, and the memory of the law. Some of it
may be superfluous (past inputs that a law remembers too); `balanced` makes the numbers fit for a solver all the same.
"""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from workbench.data import SAME_DT
from workbench.errors import InputError
from workbench.intervals.domains import nearest
from workbench.intervals.model import IntervalModel, Simulation
from workbench.intervals.semantics import ParameterBox
from workbench.physics.controller import Loop
from workbench.records import field, record

SEEN = 0.1  # widths of a mode's domain that a schedule value may lie outside
FLOOR = 1e-6  # of the largest reachable variance: what a direction of the state counts that nothing reaches


class LinearLaw(Loop, Protocol):
    """A sampled law that is linear where the schedule stands still."""

    def at(self, rho: float | None) -> Any:
        """python-control system from (r, y) to u."""
        ...


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
        if np.any((self.channel % 1 != 0) | (self.channel >= q)):
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

        Raises InputError where the middle is not stable.
        """
        from scipy.linalg import solve_discrete_lyapunov

        if not self.radius < 1.0:
            raise InputError(
                f"the loop is not stable in the middle of the boxes: a pole of modulus {self.radius:.6f}",
                file="UncertainLoop",
                mend="another controller, or another model",
            )
        own = self.columns @ np.ones((self.columns.shape[1], 1)) if self.lam.any() else self.B
        reached = solve_discrete_lyapunov(self.A, self.B @ self.B.T + own @ own.T)
        size = np.sqrt(np.maximum(np.diag(reached), FLOOR * np.diag(reached).max()))
        scaled = self.moved(np.diag(1.0 / size))
        weight = scaled.C.T @ np.diag(self.lam**2) @ scaled.C
        P = solve_discrete_lyapunov(scaled.A.T, weight / max(np.trace(weight), 1e-300) + np.eye(len(size)) / len(size))
        return np.linalg.cholesky(0.5 * (P + P.T)).T / size


def close(models: Sequence[IntervalModel], law: LinearLaw, rho: float | None = None) -> UncertainLoop:
    """The loop of `law` with one interval model for each output that it measures, frozen at a schedule value.

    Raises InputError where names or sample times do not fit, where no mode is known at rho, and for inputs that act at once.
    """
    models = _in_order(models, law)
    _check_schedule(models, law, rho)
    system = law.at(rho)
    nr, ny, nu = len(law.references), len(law.measured), len(law.actuated)
    Ac, Bc, Cc, Dc = (np.asarray(M, dtype=float) for M in (system.A, system.B, system.C, system.D))
    Bc, Dc = Bc[:, nr:], Dc[:, nr:]
    deepest = max(int(model.form.lags[model.form.source > 0].max(initial=0.0)) for model in models)
    past = [int((model.form.source == 0).sum()) for model in models]
    starts = np.concatenate([[0], np.cumsum(past)])  # of the past outputs; then the inputs, lag by lag; then the law
    inputs, memory = int(starts[-1]), int(starts[-1]) + nu * deepest
    n = memory + len(Ac)
    Y, C, lam, channel, names = np.zeros((ny, n)), [], [], [], []
    for j, model in enumerate(models):
        form, box = model.form, _box_at(model, rho)
        psi = np.zeros((len(form.source), n))
        for entry, (source, lag) in enumerate(zip(form.source.astype(int), form.lags.astype(int), strict=True)):
            if source == 0:
                psi[entry, starts[j] + lag - 1] = 1.0
            elif source > 0 and (at := _actuator(model, source, law)) is not None:
                psi[entry, inputs + nu * (lag - 1) + at] = 1.0
        Y[j] = (form.d + form.T.T @ box.centre) @ psi
        z = form.T @ psi
        moving = np.abs(z).max(axis=1) > 0.0
        C.append(z[moving])
        lam.append(box.radius[moving])
        channel.append(np.full(int(moving.sum()), j))
        names += [f"{model.output.name}: {form.names[i]}" for i in np.flatnonzero(moving)]
    U = Dc @ Y
    U[:, memory:] += Cc
    A, B = np.zeros((n, n)), np.zeros((n, ny))
    for j, count in enumerate(past):
        if count:
            A[starts[j]], B[starts[j], j] = Y[j], 1.0
            A[np.arange(1, count) + starts[j], np.arange(count - 1) + starts[j]] = 1.0
    if deepest:
        A[inputs : inputs + nu], B[inputs : inputs + nu] = U, Dc
        A[inputs + nu : memory, inputs : memory - nu] = np.eye(memory - inputs - nu)
    A[memory:] = Bc @ Y
    A[memory:, memory:] += Ac
    B[memory:] = Bc
    loop = UncertainLoop(A, B, np.vstack(C), np.concatenate(lam), np.concatenate(channel), tuple(names), law.dt)
    return loop.moved(_differences(past, nu, deepest, len(Ac)))


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


def _actuator(model: IntervalModel, source: int, law: LinearLaw) -> int | None:
    """Which command of the law an input of the model is; None for an input from outside."""
    name = model.inputs[source - 1].name
    return law.actuated.index(name) if name in law.actuated else None


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


def _differences(past: Sequence[int], nu: int, deepest: int, law: int) -> np.ndarray:
    """Past outputs and inputs into the newest value and the changes between neighbours."""
    from scipy.linalg import block_diag

    own = [_changes(count) for count in past if count]
    return np.asarray(block_diag(*own, *([np.kron(_changes(deepest), np.eye(nu))] if deepest else []), np.eye(law)))


def _changes(count: int) -> np.ndarray:
    return np.eye(count, k=-1) - np.diag(np.append(-1.0, np.ones(count - 1)))
