"""Models whose schedule is one of their own outputs (quasi-LPV): free runs, predictions, equilibria and linearisations.

    y(k)   = C(k) x(k) + D(k) (u(k) - u0) + y0        with the schedule as it was known before sample k, rho(k-1)
    x(k+1) = A(k) x(k) + B(k) (u(k) - u0)             with rho(k) = y_s(k), clipped to the span

Each equation reads the newest schedule value that is known when it is evaluated. Read in C(k) or y0 the schedule of the same
sample would make y(k) = C(y(k)) x(k) + y0(y(k)) an implicit equation; so there a term of delay d reads rho(k - max(d, 1)). This
holds for a fit, a prediction and a free run alike. Measured outputs are the schedule as long as there are any; then the model's
own are. Before the first sample the schedule is in the middle of the span.

About an equilibrium y_s = rho the schedule answers to the state, which frozen matrices leave out (hidden coupling):

    dx(k+1) = A dx + B du + sum_i H_i dy_s(k-i),    H_i = sum over terms of delay i of phi_j'(rho) (A_j x + B_j (u - u0))

and likewise with E_i in the output equation. W. Rugh, J. Shamma, "Research on gain scheduling", Automatica 36 (2000).
"""

from typing import TYPE_CHECKING

import numpy as np

from workbench.basis import Products
from workbench.data import Experiment
from workbench.errors import InputError
from workbench.records import field, record

if TYPE_CHECKING:
    from workbench.basis import Basis
    from workbench.lpv import LPVModel

MET = 1e-9  # share of the largest number in an equilibrium's equations that its solution may miss
READ = 1e-12  # share of the largest entry below which a past schedule value counts as not read
GRID = 101  # schedule values at which equilibria are looked for
TOLD = 3  # schedule values at which a note compares frozen and true poles
CHUNK = 4096  # runs that are made side by side


class OwnRuns:
    """Runs side by side of a model that is scheduled on its own output: states x (S, nx), schedules past (S, q), newest first."""

    def __init__(self, model: "LPVModel", x: np.ndarray, past: np.ndarray):
        self.model, self.x = model, x
        self.delays = np.array([term.delay for term in model.terms])
        self.functions = np.array([term.function for term in model.terms])
        self.CD, self.AB = (np.concatenate(pair, axis=2) for pair in ((model.C, model.D), (model.A, model.B)))
        self.followed, self.low, self.high = place(model), *model.span
        self.phi = model.basis(past)  # (S, q, m)
        self.point = model.operating_point.basis(past[:, 0])

    def keep(self, count: int) -> None:
        """Go on with the first `count` runs only."""
        self.x, self.phi, self.point = self.x[:count], self.phi[:count], self.point[:count]

    def step(self, u: np.ndarray) -> np.ndarray:
        """y (S, ny) of this sample under the inputs u (S, nu); the runs go on to the next sample."""
        point = self.model.operating_point
        y = self._of(self.CD, self.phi[:, np.maximum(self.delays, 1) - 1, self.functions], u) + self.point @ point.y
        rho = np.minimum(np.maximum(y[:, self.followed], self.low), self.high)
        line = np.concatenate([self.model.basis(rho)[:, None], self.phi], axis=1)
        self.point = point.basis(rho)
        self.x = self._of(self.AB, line[:, self.delays, self.functions], u)
        self.phi = line[:, :-1]
        return y

    def _of(self, M: np.ndarray, w: np.ndarray, u: np.ndarray) -> np.ndarray:
        """M(w) [x; u - u0] of every run, for terms M (nt, rows, nx + nu) and weights w (S, nt)."""
        v = np.concatenate([self.x, u - self.point @ self.model.operating_point.u], axis=1)
        return ((w @ M.reshape(len(M), -1)).reshape(len(w), *M.shape[1:]) @ v[:, :, None])[:, :, 0]


def runs_from(model: "LPVModel", states: np.ndarray, rho: np.ndarray, start: np.ndarray) -> OwnRuns:
    """Runs that begin at the samples `start` (S), where the schedule rho (N) is known up to the sample before each."""
    back = start[:, None] - 1 - np.arange(memory(model))
    known = np.where(start[:, None] > 0, rho[np.clip(back, 0, None)], model.span.mean())
    return OwnRuns(model, states[start], known)


def place(model: "LPVModel") -> int:
    """Which output the schedule is."""
    assert model.scheduled_output is not None
    return model.scheduled_output


def memory(model: "LPVModel") -> int:
    """Past schedule values that the model's equations read."""
    return max(1, *(term.delay for term in model.terms))


def simulated(model: "LPVModel", experiment: Experiment, states: np.ndarray) -> np.ndarray:
    """Outputs (N, ny): one step ahead up to the last of the states (n + 1, nx), which have seen y(0..n-1), from there on free."""
    u, rho, n = experiment[[c.name for c in model.inputs]], model.schedule_of(experiment), len(states) - 1
    out = np.empty((len(u), len(model.outputs)))
    out[:n] = runs_from(model, states, rho, np.arange(n)).step(u[:n])
    run = runs_from(model, states, rho, np.array([n]))
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(n, len(u)):
            out[k] = run.step(u[k : k + 1])[0]
    return out


def predicted(model: "LPVModel", experiment: Experiment, states: np.ndarray, steps: int) -> np.ndarray:
    """y(k | k - steps), (N, ny), from the predictor's states (N, nx); see `LPVModel.predict`."""
    u, rho, first = experiment[[c.name for c in model.inputs]], model.schedule_of(experiment), model.warmup
    out = np.empty((len(u), len(model.outputs)))
    for begin in range(0, len(u), CHUNK):
        start = np.arange(begin, min(begin + CHUNK, len(u)))
        runs = runs_from(model, states, rho, start)
        for ahead in range(steps):
            start = start[start + ahead < len(u)]
            runs.keep(len(start))
            y = runs.step(u[start + ahead])
            wanted = (start == first) | ((start > first) & (ahead == steps - 1)) | ((start < first) & (ahead == 0))
            out[start[wanted] + ahead] = y[wanted]
    return out


# ---- linearisation --------------------------------------------------------------------------------------------------


@record
class Equilibrium:
    """Where the model stands still at a value of its schedule: state x, inputs u and outputs y in the units of the channels."""

    rho: float
    x: np.ndarray = field("nx")
    u: np.ndarray = field("nu")
    y: np.ndarray = field("ny")


def equilibrium(model: "LPVModel", rho: float) -> Equilibrium:
    """The equilibrium at which the scheduled output is rho; of several inputs the nearest ones to u0(rho).

    Raises InputError where constant inputs hold no such output.
    """
    A, B, C, D = model.freeze(rho)
    s, phi = place(model), model.operating_point.basis(np.array(rho))
    u0, y0 = phi @ model.operating_point.u, phi @ model.operating_point.y
    left = np.block([[np.eye(len(A)) - A, -B], [C[s : s + 1], D[s : s + 1]]])
    right = np.append(np.zeros(len(A)), rho - y0[s])
    v = np.linalg.lstsq(left, right, rcond=None)[0]
    if np.abs(left @ v - right).max() > MET * max(np.abs(left).max() * np.abs(v).max(), np.abs(right).max()):
        assert model.schedule is not None
        raise InputError(
            f"no equilibrium at {model.schedule.name} = {rho:g} {model.schedule.unit}".rstrip(),
            file=model.name,
            mend="no constant input holds it there: take another value, or freeze(rho)",
        )
    x, du = v[: len(A)], v[len(A) :]
    return Equilibrium(rho, x, u0 + du, C @ x + D @ du + y0)


def linearised(model: "LPVModel", rho: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C, D of the linearisation about the equilibrium at rho; past schedule values that are read are states.

    Raises InputError outside the span, and where there is no equilibrium.
    """
    A, B, C, D = model.freeze(rho)
    at, s, q = equilibrium(model, rho), place(model), memory(model)
    point, rise = model.operating_point, slopes(model.operating_point.basis, rho)
    du0, dy0 = rise @ point.u, rise @ point.y
    du = at.u - point.basis(np.array(rho)) @ point.u
    H, E = np.zeros((len(A), q + 1)), np.zeros((len(C), q + 1))  # columns: d/d rho(k), d/d rho(k-1), ..
    H[:, 0], E[:, 1] = -B @ du0, dy0 - D @ du0
    bend = slopes(model.basis, rho)
    for j, term in enumerate(model.terms):
        H[:, term.delay] += bend[term.function] * (model.A[j] @ at.x + model.B[j] @ du)
        E[:, max(term.delay, 1)] += bend[term.function] * (model.C[j] @ at.x + model.D[j] @ du)
    size = max(np.abs(H).max(), np.abs(E).max(), 1e-300)
    while q and max(np.abs(H[:, q]).max(initial=0.0), np.abs(E[:, q]).max()) <= READ * size:
        q -= 1
    return _with_memory((A, B, C, D), H[:, : q + 1], E[:, 1 : q + 1], s)


def _with_memory(frozen: tuple, H: np.ndarray, E: np.ndarray, s: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The frozen matrices with the states d rho(k-1) .. d rho(k-q) and d rho(k) = d y_s(k)."""
    A, B, C, D = frozen
    q = E.shape[1]
    output = np.hstack([C, E])
    after = np.hstack([A, H[:, 1:]]) + np.outer(H[:, 0], output[s])
    shift = np.hstack([np.zeros((q, len(A))), np.eye(q, k=-1)])
    shift[:1] = output[s]
    inputs = np.vstack([B + np.outer(H[:, 0], D[s]), np.zeros((q, B.shape[1]))])
    inputs[len(A) : len(A) + min(q, 1)] = D[s]
    return np.vstack([after, shift]), inputs, output, D


def slopes(basis: "Basis", rho: float) -> np.ndarray:
    """d phi_j / d rho, (m); at a kink the slope towards larger values."""
    assert not isinstance(basis, Products)  # a schedule that is an output stands alone
    return np.array([float(value) for value in basis.slopes(rho)])


def coupling_notes(model: "LPVModel") -> tuple[str, ...]:
    """What frozen matrices leave out, by the largest pole; whether the linearised model is stable; where nothing holds it."""
    assert model.schedule is not None
    name, unit = model.schedule.name, f" {model.schedule.unit}".rstrip()
    stability, said = model.stability(GRID), []
    for rho in np.linspace(model.span[0], model.span[1], TOLD).tolist():
        if rho not in stability.unknown:
            frozen, true = (_radius(A) for A, *_ in (model.freeze(rho), linearised(model, rho)))
            said.append(f"{frozen:.4g} and {true:.4g} at {rho:.4g}{unit}")
    notes = [f"the schedule {name} is an output: free runs schedule themselves"]
    if said:
        notes.append(f"hidden coupling: modulus of the largest pole, frozen and linearised, {', '.join(said)}")
    if stability.radius >= 1.0:
        notes.append(
            f"unstable: the linearised model has spectral radius {stability.radius:.4f} at {name} = {stability.at:.4g}{unit}"
        )
    if stability.unknown:
        low, high = min(stability.unknown), max(stability.unknown)
        where = f"at {len(stability.unknown)} of {GRID} values of {name} from {low:.4g} to {high:.4g}{unit}"
        notes.append(f"no equilibrium {where}: no constant input holds it there")
    return tuple(notes)


def _radius(A: np.ndarray) -> float:
    return float(np.abs(np.linalg.eigvals(A)).max(initial=0.0))
