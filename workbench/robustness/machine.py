"""What a law is closed around: models with bounded errors as one linear machine at a schedule value.

    interval models        y_j(k) = row_j'psi_j(k) + w_j(k),   z of regression j = T_j psi_j(k)       (`intervals.regressors`)
    LPV model and errors   x+ = F x + G u + K y,  y = C x + e,  e_j = centre'z_j + w_j                  (`intervals.errors`)

The state holds the state of the model and past outputs and inputs, the newest and the changes between neighbours. Some of it may
be superfluous; `UncertainLoop.balanced` makes the numbers fit for a solver all the same.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from workbench.data import SAME_DT
from workbench.errors import InputError
from workbench.intervals.domains.choice import nearest
from workbench.intervals.errors import ERROR_OF
from workbench.intervals.model import IntervalModel, Simulation
from workbench.intervals.semantics import ParameterBox
from workbench.lpv import LPVModel, check_no_feedthrough, check_schedule_from_outside, ends
from workbench.physics.controller import schedules_of
from workbench.records import field, record
from workbench.robustness.frequency import System
from workbench.robustness.linear_law import LinearLaw

SEEN = 0.1  # widths of a mode's domain that a schedule value may lie outside


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


def machine_with_errors(model: LPVModel, errors: Sequence[IntervalModel], rho: Any = None) -> Machine:
    """The LPV model at a schedule value with the interval models of its one-step errors, one for each output.

    Raises InputError where they do not belong together, and for a model whose inputs act at once.
    """
    inside = _within(model, rho)
    return _with_errors(model, errors, model.weights(np.array([inside]))[0], inside)


def machines_along(model: LPVModel, errors: Sequence[IntervalModel], rho: np.ndarray) -> Iterator[Machine]:
    """The machine at every sample of a schedule rho (N), or (N, ns); where it leaves what the model has seen the edge holds."""
    inside = np.clip(rho, *ends(model.spans))
    for value, weight in zip(inside, model.weights(inside), strict=True):
        yield _with_errors(model, errors, weight, value)


def _within(model: LPVModel, rho: Any) -> Any:
    """The schedule value as the model takes it. Raises InputError outside of what it has seen."""
    model.freeze(rho)
    return 0.0 if not model.schedules or rho is None else np.clip(rho, *ends(model.spans))


def _with_errors(model: LPVModel, errors: Sequence[IntervalModel], weight: np.ndarray, rho: Any) -> Machine:
    """The same with the weights (nt) of the terms at a sample."""
    check_no_feedthrough(model)
    check_schedule_from_outside(model, "a proof on the model")
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
    known = {model.schedule.name for model in models if model.schedule} | {*schedules_of(law)}
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
