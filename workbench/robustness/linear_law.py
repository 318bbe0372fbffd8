"""Laws that are linear where the schedule stands still, and whether a law answers as its linear form does."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, Protocol

import numpy as np

from workbench.errors import InputError
from workbench.lpv import LPVModel, check_schedule_from_outside, lattice
from workbench.physics.controller import Controller, Loop, schedules_of, stepped
from workbench.records import field, record
from workbench.units import check_law_units

COMPARED, SAME_ANSWER = 12, 1e-6  # samples at which law and linear form are compared; of an answer, how far they may differ
SHARES = (0.95, 0.7, 0.4, 0.02, 1e-4)  # of the room that a law has: answers that are compared; smaller ones drown in rounding
HUGE, SMALL = 1e6, (1e-6, 1e-9)  # the room of what has no limits, and shares of it besides: it may be in any unit
FEW = 3  # schedule values at which they are compared at least


@record
class Affine:
    """A law at a schedule value: x+ = A x + B (r, y) + a, u = C x + D (r, y) + o, while low <= W x + V (r, y) + w <= high."""

    A: np.ndarray = field("n n")
    B: np.ndarray = field("n i")
    a: np.ndarray = field("n")
    C: np.ndarray = field("nu n")
    D: np.ndarray = field("nu i")
    o: np.ndarray = field("nu")
    W: np.ndarray = field("k n")
    V: np.ndarray = field("k i")
    w: np.ndarray = field("k")
    low: np.ndarray = field("k", low=-np.inf)
    high: np.ndarray = field("k")


class LinearLaw(Loop, Protocol):
    """A sampled law that is linear where the schedule stands still.

    A law whose memory moves of itself, or that plans within limits, has methods `affine(rho, slope)`, `memory(state)` and
    `slopes(rho)` besides (`controllers.mpc`).
    """

    def at(self, rho: Any) -> Any:
        """python-control system from (r, y) to u less its offset; its state keeps its meaning while the schedule moves.

        r are set-points within their slew, where the law has a method `slewed` for that.
        """
        ...

    def offset(self, rho: Any) -> np.ndarray:
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
        """Between which the schedule changes the law, (2,), (ns, 2) of several variables; infinite without one."""
        ...


def affine_of(law: LinearLaw, rho: Any, slope: Any = 0.0) -> Affine:
    """The law at a schedule value that moves by `slope` a sample; without rows where nothing but its own limits ends it."""
    if hasattr(law, "affine"):
        return law.affine(rho, slope)  # type: ignore[attr-defined]
    system = law.at(rho)
    A, B, C, D = (np.asarray(M, dtype=float) for M in (system.A, system.B, system.C, system.D))
    none = np.empty(0)
    return Affine(
        A, B, np.zeros(len(A)), C, D, law.offset(rho), np.empty((0, len(A))), np.empty((0, B.shape[1])), none, none, none
    )


def slews(law: Any) -> np.ndarray:
    """Largest rates (nr,) of the set-points of a law that says what they become, by `slewed`; infinite of others."""
    return np.broadcast_to(law.slew if hasattr(law, "slewed") else np.inf, len(law.references))


LINEAR = ("at", "offset", "low", "high", "rate", "span")


def check_law(model: LPVModel, law: LinearLaw) -> None:
    """Refuse a law of other outputs or inputs, or of another schedule, than the model, and a model that schedules itself."""
    check_schedule_from_outside(model, "a frozen loop")
    for kind, names, channels in (("output", law.measured, model.outputs), ("input", law.actuated, model.inputs)):
        known = [c.name for c in channels]
        if foreign := [name for name in names if name not in known]:
            problem = f"{law.name} has the {kind}s {', '.join(names)}, the model {', '.join(known)}"
            raise InputError(problem, file=model.name, mend=f"identify a model that has {', '.join(foreign)}")
    check_law_units(law, (*model.inputs, *model.outputs, *model.schedules), model.name)
    known, own = [c.name for c in model.schedules], list(schedules_of(law))
    if own and own != known:
        problem = f"{law.name} is scheduled on {', '.join(own)}, the model on {', '.join(known) or 'nothing'}"
        raise InputError(problem, file=model.name, mend="design a law on this model, or check it on the model it was designed on")


def without_linear_form(law: Any, values: Sequence[Any] = ()) -> str:
    """Why nothing can be proved of a law on a linear model, in words; "" where its linear form is what it commands.

    `at` is not believed: at the ends and the middle of its span and at the schedule `values`, law and linear form are given the
    same samples, small ones and such as take it close to its limits, and must answer them alike. A law that is a record is asked
    without its limits; another one is led off them first, where constant errors can.
    """
    if not all(hasattr(law, name) for name in LINEAR):
        how = "is an equation of its own" if isinstance(law, Controller) else "is computed step by step"
        return f"{law.name} {how}: no linear law to prove anything of; it is checked on the plant alone"
    names = schedules_of(law)
    own = lattice(np.reshape(law.span, (-1, 2)), FEW) if names else np.empty(0)
    for rho in np.unique(np.concatenate([own, np.reshape(values, (-1, *own.shape[1:]))]), axis=0) if names else [None]:
        try:
            off = _apart_from_plan(law, rho) if hasattr(law, "affine") else _apart(_unlimited(law), rho)
        except Exception as reason:
            off = f"{type(reason).__name__}: {reason}"
        if off:
            told = ", ".join(f"{n} = {v:.4g}" for n, v in zip(names, np.ravel([] if rho is None else rho), strict=True))
            where = f" at {told}" * bool(names)
            return f"the linear form of {law.name}{where} is not its law: {off}; nothing is proved of it"
    return ""


def _unlimited(law: Any) -> Any:
    """The law without limits and slew, where it is a record that has them as numbers; else the law."""
    if not is_dataclass(law) or not {"low", "high", "rate"} <= {f.name for f in fields(law) if f.init}:
        return law
    record: Any = law
    none = np.full(len(record.actuated), np.inf)
    free = {"slew": np.full(len(record.references), np.inf)} if hasattr(record, "slewed") else {}
    return replace(record, low=-none, high=none, rate=none, **free)


def _apart(law: Any, rho: Any) -> str:
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


def _apart_from_plan(law: Any, rho: Any) -> str:
    """How a law that plans and its affine form differ where the schedule stands still and the plan keeps its limits; "" where
    they do not. It stands between its limits first, and is then given samples that take the plan close to them.
    """
    own, random = law.affine(rho), np.random.default_rng(0)
    base = _between(getattr(law, "y_low", np.full(len(law.measured), -np.inf)), getattr(law, "y_high", np.inf))
    still, state = np.concatenate([base, base]), law.init(_between(law.low, law.high))
    for _ in range(COMPARED):
        _, state = stepped(law, state, base, base, rho)
    x0 = law.memory(state)
    rows, push = own.W @ x0 + own.V @ still + own.w, random.normal(size=(COMPARED, len(still)))
    if not np.all((own.low < rows) & (rows < own.high)):
        return "its plan stays at its limits"
    x, answer, moved = np.zeros(len(x0)), [], [np.full(len(rows), 1e-300)]
    for each in push:
        answer.append(own.C @ x + own.D @ each)
        moved.append(np.abs(own.W @ x + own.V @ each))
        x = own.A @ x + own.B @ each
    room = np.minimum(own.high - rows, rows - own.low) / np.max(moved, axis=0)
    largest = float(np.min(room, initial=HUGE))
    for share in (*SHARES, *(SMALL if largest >= HUGE else ())):
        size, x, memory = share * largest, x0, state
        for k, each in enumerate(push):
            sample = still + size * each
            u, memory = stepped(law, memory, sample[: len(base)], sample[len(base) :], rho)
            expected = own.C @ x + own.D @ sample + own.o
            most = size * np.abs(answer).max(axis=0) + 1e-3 * np.abs(expected) + 1e-6
            if np.any(np.abs(u - expected) > SAME_ANSWER * most):
                return (
                    f"to samples about {size:.2g} in size it answers {u.tolist()} after {k + 1} of them, not {expected.tolist()}"
                )
            x = own.A @ x + own.B @ sample + own.a
    return ""


def _between(low: Any, high: Any) -> np.ndarray:
    """Values between limits: their middle, 1 or as much as a limit inside where there is one, else 0."""
    low, high = np.broadcast_arrays(np.asarray(low, dtype=float), np.asarray(high, dtype=float))
    found = np.zeros(len(low))
    below, above = np.isfinite(low), np.isfinite(high)
    found[below] = low[below] + np.maximum(1.0, np.abs(low[below]))
    found[above] = high[above] - np.maximum(1.0, np.abs(high[above]))
    both = below & above
    found[both] = 0.5 * (low[both] + high[both])
    return found


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
