"""The loop of a linear law and models with bounded errors: everything that is uncertain enters through one scalar per output.

`driven` closes it at one schedule value, its state that of the machine and the memory of the law; `close` leaves out what drives
it (`uncertain`), `course` follows set-points, biases and operating points along a run.
"""

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from workbench.data import SAME_DT
from workbench.errors import InputError
from workbench.intervals.model import IntervalModel
from workbench.lpv import LPVModel
from workbench.records import field, record
from workbench.robustness.envelopes.course import Course
from workbench.robustness.linear_law import LinearLaw, affine_of, check_law, slews
from workbench.robustness.machine import Machine, machine_of, machines_along
from workbench.robustness.rests import Rest
from workbench.robustness.uncertain import UncertainLoop

RATE_OF = "rate of "
PLANNED = "planned"


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

    def undriven(self, *, still: bool = False) -> UncertainLoop:
        """Without what drives it, and without the parameters of regressors that do not move.

        still: of a schedule that stands still, also without the states that set-points alone move, which are stable and known and
        come to rest whatever the loop does, and the parameters of regressors that no other state moves (`fed_back`).
        """
        x, p = (~self.aside, self.fed_back) if still else (np.ones(len(self.A), dtype=bool), self.moving)
        names = tuple(name for name, kept in zip(self.parameters, p, strict=True) if kept)
        return UncertainLoop(self.A[np.ix_(x, x)], self.B[x], self.C[np.ix_(p, x)], self.lam[p], self.channel[p], names, self.dt)

    @property
    def fed_back(self) -> np.ndarray:
        """Whether the regressor of each parameter (p) moves with what errors reach."""
        return np.abs(self.C[:, ~self.aside]).max(axis=1, initial=0.0) > 0.0

    @property
    def aside(self) -> np.ndarray:
        """Which states (n,) neither errors nor what these reach move, where those are stable: reference models of set-points."""
        reached = self.B.any(axis=1)
        while not np.array_equal(more := reached | self.A[:, reached].any(axis=1), reached):
            reached = more
        stable = np.abs(np.linalg.eigvals(self.A[np.ix_(~reached, ~reached)])).max(initial=0.0) < 1.0
        return ~reached & stable


def close(models: Sequence[IntervalModel], law: LinearLaw, rho: float | None = None) -> UncertainLoop:
    """The loop of `law` with one interval model for each output that it measures, frozen at a schedule value.

    Raises InputError where names or sample times do not fit, where no mode is known at rho, and for inputs that act at once.
    """
    return driven(machine_of(models, law, rho), law, rho).undriven()


def driven(machine: Machine, law: LinearLaw, rho: Any = None, slope: Any = 0.0) -> DrivenLoop:
    """The machine under the law at one schedule value, which moves by `slope` a sample.

    The rows of a law that plans within limits are among its signals, as "planned ..". Raises InputError for a law of another
    sample time.
    """
    if abs(law.dt - machine.dt) > SAME_DT * machine.dt:
        mend = "design one on this model"
        raise InputError(f"{law.name} is sampled every {law.dt:g} s, the model every {machine.dt:g} s", file=law.name, mend=mend)
    own = affine_of(law, rho, slope)
    nr, nc = len(law.references), len(own.A)
    y = [machine.outputs.index(name) for name in law.measured]
    u = [machine.inputs.index(name) for name in law.actuated]
    n, ny = machine.By.shape
    left = [i for i in range(len(machine.inputs)) if i not in u]
    # every signal is a row over (s, law, r, 1, w)
    s, memory = np.eye(n, n + nc + nr + 1 + ny), np.eye(nc, n + nc + nr + 1 + ny, k=n)
    r, one = np.eye(nr, n + nc + nr + 1 + ny, k=n + nc), np.eye(1, n + nc + nr + 1 + ny, k=n + nc + nr)
    outputs = machine.C @ s + np.outer(machine.c, one) + np.eye(ny, n + nc + nr + 1 + ny, k=n + nc + nr + 1)
    seen = np.vstack([r, outputs[y]])
    commands = own.C @ memory + own.D @ seen + np.outer(own.o, one)
    planned = own.W @ memory + own.V @ seen + np.outer(own.w, one)
    held = np.outer(machine.a + machine.Bu[:, left] @ machine.rest[left], one)
    after = machine.A @ s + machine.Bu[:, u] @ commands + machine.By @ outputs + held
    x, watched = (
        np.vstack([after, own.A @ memory + own.B @ seen + np.outer(own.a, one)]),
        np.vstack([outputs[y], commands, planned]),
    )
    z = machine.T @ s + np.outer(machine.t, one)
    cut = np.cumsum([n + nc, nr + 1])
    (A, G, B), (E, H, F), (C, J, _) = (np.split(rows, cut, axis=1) for rows in (x, watched, z))
    signals = (*law.measured, *law.actuated, *(f"{PLANNED} {i}" for i in range(len(planned))))
    return DrivenLoop(A, G, B, E, H, F, C, J, machine.lam, machine.channel, machine.parameters, signals, law.dt)


def course(loops: Sequence[DrivenLoop], references: np.ndarray, initial: np.ndarray | None = None) -> Course:
    """The loop along set-points (N, nr); one loop for all samples, or one for each.

    It begins at the rest of any machine of the boxes, under the loop of the first sample and set-points between initial (nr, 2);
    None: under the first ones. Raises InputError where the middle of the boxes has no rest there.
    """
    N, first, nr, ends = len(references), loops[0], references.shape[1], _before(references, initial)
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
    before = Rest(*(part for M in (first.G, first.J, first.H) for part in (M @ usual, M[:, :nr][:, wide] * half)))
    return Course(
        A=along("A"), B=along("B"), C=along("C"), E=along("E"), F=along("F"), lam=along("lam"), channel=first.channel, mode=mode,
        q=q, g=driving("H"), f=driving("J"), start=np.linalg.solve(np.eye(len(first.A)) - first.A, before.q),
        signals=first.signals, before=before,
    )  # fmt: skip


def _before(references: np.ndarray, initial: np.ndarray | None) -> np.ndarray:
    """Between which set-points (nr, 2) the loop rests before the run: as given, or the first ones."""
    nr = references.shape[1]
    ends = np.repeat(references[0][:, None], 2, axis=1) if initial is None else np.asarray(initial, dtype=float)
    if ends.shape != (nr, 2) or not np.all(ends[:, 0] <= ends[:, 1]):
        raise InputError(f"set-points before the run of shape {ends.shape}", file="course", mend=f"({nr}, 2): low <= high")
    return ends


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
    """The loop of a law and a model whose errors are bounded, along a schedule (N), or (N ns), and set-points (N nr).

    noise: with the errors that no parameter explains. rates: commands whose change per second is watched too. initial (nr, 2):
    set-points under which the loop rests before the run, low and high; None: the first ones.
    """
    check_law(model, law)
    ends = _before(references, initial)
    if limited := [
        name for name, slew, (low, high) in zip(law.references, slews(law), ends, strict=True) if slew < np.inf and high > low
    ]:
        mend = f"give [run] initial of {limited[0]} one value, or a law without its slew"
        raise InputError(f"{limited[0]} is slewed from a set-point that is known between two values only", mend=mend)
    if np.isfinite(slews(law)).any():
        references = law.slewed(references, ends[:, 0])  # type: ignore[attr-defined]
    still = not np.ptp(rho, axis=0).any()
    values = rho[:1] if still else rho
    loops, slopes = [], law.slopes(values) if hasattr(law, "slopes") else np.zeros_like(values)  # type: ignore[attr-defined]
    for machine, value, slope in zip(machines_along(model, errors, values), values, slopes, strict=True):
        loop = driven(machine, law, value if law.schedule else None, slope)
        loops.append(with_rates(loop if noise else loop.quiet(), rates))
    return course(loops, references, ends)


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
